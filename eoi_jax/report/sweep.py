"""A sweep as text and as a figure."""

from typing import Any

import numpy as np

from eoi_jax._checks import counted
from eoi_jax.estimation.iteration import FEWEST_BLOCKS
from eoi_jax.report.style import ACCENT, fix_theme, logarithmic, new_figure, series, themed
from eoi_jax.report.tables import columns

_LABELS = {"cutoff": "cut-off [rad/s]"}
_ON_BOUND = "a value on a bound has none"
_SHORT = (
    f"{{}} of the length that the filter remembers, and {FEWEST_BLOCKS} are needed; `identify` has "
    "another estimate"
)


def statuses(sweep: Any) -> dict[str, int]:
    """Number of lanes with each status."""
    names = sweep["status"].attrs["flag_meanings"].split()
    values, counts = np.unique(sweep["status"].values, return_counts=True)
    return {names[value]: int(count) for value, count in zip(values, counts, strict=True)}


def gain_names(sweep: Any) -> list[str]:
    """Coordinates along ``observer`` that are gains."""
    names = [str(name) for name, values in sweep.coords.items() if "observer" in values.dims]
    return [name for name in names if name not in ("observer", "kind")]


def sweep_text(sweep: Any, best: Any) -> str:
    """Number of lanes with each status, and the best lane.

    Args:
        sweep: of `eoi_jax.sweep`.
        best: of `eoi_jax.best`; None if no lane has an answer.
    """
    lanes = sweep["status"].size
    counts = ", ".join(f"{count} {name}" for name, count in statuses(sweep).items())
    sections = [f"{sweep.attrs['plant']}: {counted(lanes, 'lane')}: {counts}"]
    if best is None:
        return sections[0]
    rows = [("", "best")]
    rows += [(name, _value(best[name])) for name in ("kind", *gain_names(sweep)) if name in best]
    rows += [(_LABELS[name], _value(best[name])) for name in _LABELS if name in best.coords]
    if best.sizes["record"] and sweep.sizes["start"] > 1:
        rows.append(("start", str(int(best["start"]))))
    rows.append(("score", f"{float(best['score']):.6g}"))
    sections += [columns(rows, "<<"), f"score: {best.attrs['criterion']}", _estimates(best)]
    return "\n\n".join(sections)


def _value(coordinate: Any) -> str:
    values = np.atleast_1d(coordinate.values)
    texts = [str(value) if values.dtype.kind in "US" else f"{value:.6g}" for value in values]
    return " ".join(texts)


def _estimates(best: Any) -> str:
    """Estimate and standard error of each parameter, a row for each record."""
    names = [str(name) for name in best["parameter"].values]
    resampled = best.sizes["resample"] > 1
    rows = [("record", *(f"{name} ± std. error" for name in names))]
    notes = ["±: standard deviation over the resamples"] if resampled else []
    for record in best["record"].values:
        estimate = best.sel(record=record)
        values = estimate["parameters"].sel(resample=0).values
        if resampled:
            resamples = estimate["parameters"].sel(resample=slice(1, None))
            errors = resamples.std("resample").values
        else:
            errors = estimate["standard_error"].sel(resample=0).values
        pairs = list(zip(values, errors, strict=True))
        rows.append((str(record), *(_with_deviation(*pair) for pair in pairs)))
        if unknown := [name for name, error in zip(names, errors, strict=True) if np.isnan(error)]:
            blocks = int(estimate["blocks"].sel(resample=0))
            reason = (
                _ON_BOUND if blocks >= FEWEST_BLOCKS else _SHORT.format(counted(blocks, "block"))
            )
            notes.append(f"{record}: no standard error of {' and '.join(unknown)}: {reason}")
    return "\n".join([columns(rows, "<" + ">" * len(names)), *notes])


def _with_deviation(value: float, error: float) -> str:
    """A value with its standard error, if that is known."""
    return f"{value:.6g}" if np.isnan(error) else f"{value:.6g} ± {error:.2g}"


@themed()
def sweep_figure(sweep: Any, best: Any = None, max_gains: int = 5) -> Any:
    """The common index of every lane against each gain that varies, one panel each.

    Args:
        sweep: of `eoi_jax.sweep`.
        best: of `eoi_jax.best`; its lane is marked.
        max_gains: gains in the figure; each has a panel of 3.2 inch.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    lanes = sweep.sel(resample=0)
    index = lanes["common_index"].where(lanes["ok"])
    varying = [name for name in gain_names(sweep) if len(_finite(sweep[name].values)) > 1]
    varying += ["cutoff"] if "cutoff" in sweep.coords and sweep.sizes["lowpass"] > 1 else []
    names = varying[:max_gains] or ["observer"]
    rows = sweep.sizes["output"]
    figure = new_figure(3.2 * len(names) + 1.2, 3.0 * rows + 0.6, nested=True)
    panels = figure.subplots(rows, len(names), squeeze=False, sharey="row")
    scatters = [
        _scatter(panel, sweep, index.isel(output=j), name, j)
        for j in range(rows)
        for panel, name in zip(panels[j], names, strict=True)
    ]
    for j, output in enumerate(sweep["output"].values):
        panels[j, 0].set_ylabel(f"common index of {output}")
    for j, i in np.ndindex(rows, len(names)) if best is not None else ():
        _mark(panels[j, i], best, names[i], j)
    if "cutoff" in varying:
        figure.colorbar(scatters[0], ax=panels, label=_LABELS["cutoff"])
    figure.suptitle(f"{sweep.attrs['plant']}: {counted(index.isel(output=0).size, 'lane')}")
    return fix_theme(figure)


def _finite(values: np.ndarray) -> np.ndarray:
    """The finite values, sorted and without duplicates."""
    return np.unique(values[np.isfinite(values)])


def _mark(panel: Any, best: Any, name: str, j: int) -> None:
    """A ring around the best lane for each record."""
    if name not in best.coords and name not in best:
        return
    value = best[name].isel(output=j) if "output" in best[name].dims else best[name]
    index = best["common_index"].isel(output=j).sel(resample=0)
    x, y = (np.ravel(array.broadcast_like(index).values) for array in (value, index))
    ring = {"mfc": "none", "mec": series(ACCENT), "ms": 11.0, "mew": 1.8, "ls": "none"}
    panel.plot(x, y, "o", **ring)


def _scatter(panel: Any, sweep: Any, index: Any, name: str, j: int, max_ticks: int = 6) -> Any:
    """The lanes in one panel; up to `max_ticks` values have a tick each."""
    gain = sweep[name].isel(output=j) if "output" in sweep[name].dims else sweep[name]
    filters = sweep["cutoff" if "cutoff" in sweep.coords else "lowpass"]
    x, y, colour = (
        np.ravel(array.broadcast_like(index).transpose(*index.dims).values)
        for array in (gain, index, filters)
    )
    scatter = panel.scatter(x, y, c=colour, s=9, cmap="viridis", alpha=0.7, linewidths=0)
    if name != "observer":
        logarithmic(panel.xaxis)
    ticks = _finite(x)
    if len(ticks) <= max_ticks:
        panel.set_xticks(ticks, [f"{value:.3g}" for value in ticks])
        panel.set_xticks([], minor=True)
    logarithmic(panel.yaxis)
    panel.set_xlabel(_LABELS.get(name, name))
    return scatter
