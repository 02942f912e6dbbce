"""A comparison of methods as text and as a figure."""

from typing import Any

import numpy as np

from eoi_jax.comparison.compare import Comparison, Entry
from eoi_jax.report.style import WIDE, finished, logarithmic, new, series, styled, with_unit
from eoi_jax.report.tables import columns, with_error

_COLUMNS = 6  # parameters side by side


def comparison_text(result: Comparison) -> str:
    """Scores, parameters, and how each method ended.

    Args:
        result: of `compare`.
    """
    outputs = result.plant.outputs
    where = "held-out records" if result.held_out else "the records of the fit"
    ended = "\n".join(f"- {one.method}: {one.status}" for one in result.entries)
    every = "-" if result.window is None else f"{result.window:g} s"
    legend = (
        f"rmse: free runs on {where}; windows: state estimated anew every {every}\n"
        "P: eq. (14), the same observer and filter for all\n"
        "time: a second call; first: compiles what no method before it has"
    )
    parts = [
        f"{result.plant.name}: {len(result.entries)} methods",
        _scores(result, outputs),
        _parameters(result),
        ended,
        legend,
        "\n".join(f"Note: {note}" for note in result.notes),
    ]
    return "\n\n".join(part for part in parts if part)


def _scores(result: Comparison, outputs: tuple[str, ...]) -> str:
    """A row for each method; of several outputs, a table for each score."""
    scores = (("rmse", "rmse"), ("windows", "windows"), ("P", "index"))
    truth = ["worst error"] if result.truth is not None else []
    beside = [name for name, _ in scores] if len(outputs) == 1 else []
    rows = [("method", "status", *truth, *beside, "time [s]", "first [s]")]
    for one in result.entries:
        worst = [f"{100 * worst_error(one):.3g} %"] if truth else []
        values = [f"{getattr(one, field)[0]:.4g}" for _, field in scores] if beside else []
        times = (f"{one.seconds:.2g}", f"{one.first_seconds:.2g}")
        rows.append((one.method, one.status.code, *worst, *values, *times))
    tables = [_dashed(rows, "<<")]
    if not beside:
        for name, field in scores:
            shown = [(e.method, *(f"{v:.4g}" for v in getattr(e, field))) for e in result.entries]
            tables.append(_dashed([(name, *outputs), *shown], "<"))
    return "\n\n".join(tables)


def _dashed(rows: list[tuple[str, ...]], sides: str) -> str:
    """Columns with a dash for what is not known; those after `sides` stand right."""
    rows = [tuple("-" if cell in ("nan", "nan %") else cell for cell in row) for row in rows]
    return columns(rows, sides + ">" * (len(rows[0]) - len(sides)))


def worst_error(entry: Entry) -> float:
    """Largest relative error of a parameter; NaN without an answer or a truth."""
    if not entry.errors:
        return np.nan
    return max(abs(value) for value in entry.errors.values())


def _parameters(result: Comparison) -> str:
    """Rows for the nominal values, the truth and each method's estimate; a few columns a table."""
    names, parts = result.plant.names, []
    for first in range(0, len(names), _COLUMNS):
        some = names[first : first + _COLUMNS]
        rows = [("parameter", *some)]
        rows.append(("nominal", *(f"{result.plant.parameters[name]:.6g}" for name in some)))
        if result.truth is not None:
            true = (result.truth.get(name) for name in some)
            rows.append(("truth", *("" if one is None else f"{one:.6g}" for one in true)))
        for one in result.entries:
            if one.parameters is not None:
                known = one.standard_errors or {}
                pairs = ((one.parameters[name], known.get(name, np.nan)) for name in some)
                rows.append((one.method, *(with_error(*pair) for pair in pairs)))
        parts.append(columns(rows, "<" + ">" * len(some)))
    return "\n\n".join(parts)


@styled()
def comparison_figure(result: Comparison) -> Any:
    """Bars on logarithmic axes: worst parameter error (with a truth), held-out error, time.

    Args:
        result: of `compare`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    spread = np.array([one.rmse for one in result.entries])
    units = [result.plant.units.get(name, "") for name in result.plant.outputs]
    panels = []
    if result.truth is not None:
        errors = np.array([[100 * worst_error(one)] for one in result.entries])
        panels.append(("worst parameter error [%]", errors, [""]))
    where = "held out" if result.held_out else "fitted records"
    unit = units[0] if len(set(units)) == 1 else ""
    panels.append((with_unit(f"free-run rmse, {where}", unit), spread, list(result.plant.outputs)))
    seconds = np.array([[one.seconds] for one in result.entries])
    panels.append(("time, compiled [s]", seconds, [""]))
    height = 1.6 + 0.4 * len(result.entries)
    figure = new(max(3.2 * len(panels) + 1.5, WIDE), height)
    shared = None
    for i, (title, values, labels) in enumerate(panels):
        axes = figure.add_subplot(1, len(panels), i + 1, sharey=shared)
        shared = shared or axes
        _draw(axes, title, values, labels)
        axes.tick_params(labelleft=i == 0)
    axes = figure.axes[0]
    axes.set_yticks(range(len(result.entries)), [one.method for one in result.entries])
    axes.invert_yaxis()
    figure.suptitle(result.plant.name)
    return finished(figure)


def _draw(axes: Any, title: str, values: np.ndarray, labels: list[str]) -> None:
    """Points, for bars have no foot on a logarithmic axis; what has no value is said."""
    rows, count = values.shape
    shown = np.isfinite(values) & (values > 0)
    for j in range(count):
        at = np.arange(rows) + 0.18 * (j - 0.5 * (count - 1))
        keep = shown[:, j]
        axes.plot(values[keep, j], at[keep], "o", color=series(j), label=labels[j])
    logarithmic(axes.xaxis)
    if np.any(shown):  # whole decades: labels between them would run into each other
        ends = np.log10([np.min(values[shown]), np.max(values[shown])])
        axes.set_xlim(10.0 ** np.floor(ends[0] - 0.05), 10.0 ** np.ceil(ends[1] + 0.05))
    for row in np.flatnonzero(~np.any(shown, axis=1)):
        place = axes.get_yaxis_transform()
        axes.text(0.5, row, "none", transform=place, ha="center", va="center", alpha=0.6)
    axes.set_ylim(-0.6, rows - 0.4)
    axes.set_title(title)
    if count > 1:
        axes.legend()
