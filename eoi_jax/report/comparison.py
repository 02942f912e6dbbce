"""A comparison of methods as text and as a figure."""

from typing import Any

import numpy as np

from eoi_jax._checks import counted, percent
from eoi_jax.comparison.result import Comparison, Entry
from eoi_jax.report.style import WIDE, fix_theme, logarithmic, new_figure, series, themed, with_unit
from eoi_jax.report.tables import columns, with_error


def comparison_text(result: Comparison) -> str:
    """Scores, parameters, and how each method ended.

    Args:
        result: of `compare`.
    """
    outputs = result.plant.outputs
    data = "held-out records" if result.held_out else "the records of the fit"
    endings = "\n".join(f"- {entry.method}: {entry.status}" for entry in result.entries)
    windows = (
        "not computed"
        if result.window is None
        else f"initial state re-estimated every {result.window:g} s"
    )
    legend = (
        f"rmse: free runs on {data}; windows: {windows}\n"
        "P: index of eq. (14), with the same observer and filter for all methods\n"
        "time: of the second call; first: of the first call, which may include compilation"
    )
    sections = [
        f"{result.plant.name}: {counted(len(result.entries), 'method')}",
        _scores(result, outputs),
        _parameters(result),
        endings,
        legend,
        "\n".join(f"Note: {note}" for note in result.notes),
    ]
    return "\n\n".join(section for section in sections if section)


def _scores(result: Comparison, outputs: tuple[str, ...]) -> str:
    """A row for each method; with several outputs, a further table for each score."""
    scores = (("rmse", "rmse"), ("windows", "windows"), ("P", "index"))
    truth = ["worst error"] if result.truth is not None else []
    score_columns = [name for name, _ in scores] if len(outputs) == 1 else []
    rows = [("method", "status", *truth, *score_columns, "time [s]", "first [s]")]
    for entry in result.entries:
        worst = [percent(worst_error(entry), 3)] if truth else []
        values = [f"{getattr(entry, field)[0]:.4g}" for _, field in scores] if score_columns else []
        times = (f"{entry.seconds:.2g}", f"{entry.first_seconds:.2g}")
        rows.append((entry.method, entry.status.code, *worst, *values, *times))
    tables = [_dash_columns(rows, "<<")]
    if not score_columns:
        for name, field in scores:
            cells = [
                (entry.method, *(f"{value:.4g}" for value in getattr(entry, field)))
                for entry in result.entries
            ]
            tables.append(_dash_columns([(name, *outputs), *cells], "<"))
    return "\n\n".join(tables)


def _dash_columns(rows: list[tuple[str, ...]], alignment: str) -> str:
    """Columns with a dash for NaN; those beyond `alignment` are right-aligned."""
    rows = [tuple("-" if cell in ("nan", "nan %") else cell for cell in row) for row in rows]
    return columns(rows, alignment + ">" * (len(rows[0]) - len(alignment)))


def worst_error(entry: Entry) -> float:
    """Largest relative error of a parameter; NaN without an answer or true values."""
    if not entry.errors:
        return np.nan
    return max(abs(value) for value in entry.errors.values())


def _parameters(result: Comparison, width: int = 6) -> str:
    """Nominal values, true values and each method's estimate, `width` parameters side by side."""
    names, tables = result.plant.names, []
    for start in range(0, len(names), width):
        group = names[start : start + width]
        rows = [("parameter", *group)]
        rows.append(("nominal", *(f"{result.plant.parameters[name]:.6g}" for name in group)))
        if result.truth is not None:
            true = (result.truth.get(name) for name in group)
            rows.append(("truth", *("" if value is None else f"{value:.6g}" for value in true)))
        for entry in result.entries:
            if entry.parameters is not None:
                errors = entry.standard_errors or {}
                pairs = ((entry.parameters[name], errors.get(name, np.nan)) for name in group)
                rows.append((entry.method, *(with_error(*pair) for pair in pairs)))
        tables.append(columns(rows, "<" + ">" * len(group)))
    return "\n\n".join(tables)


@themed()
def comparison_figure(result: Comparison) -> Any:
    """Points on logarithmic axes: worst parameter error (with true values), held-out error, time.

    Args:
        result: of `compare`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    rmse = np.array([entry.rmse for entry in result.entries])
    units = [result.plant.units.get(name, "") for name in result.plant.outputs]
    panels = []
    if result.truth is not None:
        errors = np.array([[100 * worst_error(entry)] for entry in result.entries])
        panels.append(("worst parameter error [%]", errors, [""]))
    data = "held out" if result.held_out else "fitted records"
    unit = units[0] if len(set(units)) == 1 else ""
    panels.append((with_unit(f"free-run rmse, {data}", unit), rmse, list(result.plant.outputs)))
    seconds = np.array([[entry.seconds] for entry in result.entries])
    panels.append(("time, compiled [s]", seconds, [""]))
    height = 1.6 + 0.4 * len(result.entries)
    figure = new_figure(max(3.2 * len(panels) + 1.5, WIDE), height)
    first_axes = None
    for i, (title, values, labels) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), i + 1, sharey=first_axes)
        first_axes = first_axes or axes
        _draw(axes, title, values, labels)
        axes.tick_params(labelleft=i == 0)
    axes = figure.axes[0]
    axes.set_yticks(range(len(result.entries)), [entry.method for entry in result.entries])
    axes.invert_yaxis()
    figure.suptitle(result.plant.name)
    return fix_theme(figure)


def _draw(axes: Any, title: str, values: np.ndarray, labels: list[str]) -> None:
    """Points, since bars have no base on a logarithmic axis; "none" where there is no value."""
    rows, count = values.shape
    drawable = np.isfinite(values) & (values > 0)
    for j in range(count):
        height = np.arange(rows) + 0.18 * (j - 0.5 * (count - 1))
        mask = drawable[:, j]
        axes.plot(values[mask, j], height[mask], "o", color=series(j), label=labels[j])
    logarithmic(axes.xaxis)
    if np.any(drawable):  # full decades, whose labels do not overlap
        ends = np.log10([np.min(values[drawable]), np.max(values[drawable])])
        axes.set_xlim(10.0 ** np.floor(ends[0] - 0.05), 10.0 ** np.ceil(ends[1] + 0.05))
    for row in np.flatnonzero(~np.any(drawable, axis=1)):
        place = axes.get_yaxis_transform()
        axes.text(0.5, row, "none", transform=place, ha="center", va="center", alpha=0.6)
    axes.set_ylim(-0.6, rows - 0.4)
    axes.set_title(title)
    if count > 1:
        axes.legend()
