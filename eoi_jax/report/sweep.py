"""A sweep as text and as a figure."""

from typing import Any

import numpy as np

from eoi_jax.report.style import AFTER, finished, logarithmic, new, series, styled
from eoi_jax.report.tables import columns

_LABELS = {"cutoff": "cut-off [rad/s]"}
_SHOWN = 5  # gains in the figure
_TICKS = 6  # values that are named on an axis one by one


def statuses(sweep: Any) -> dict[str, int]:
    """How many lanes ended how."""
    names = sweep["status"].attrs["flag_meanings"].split()
    values, counts = np.unique(sweep["status"].values, return_counts=True)
    return {names[value]: int(count) for value, count in zip(values, counts, strict=True)}


def gain_names(sweep: Any) -> list[str]:
    """Coordinates along ``observer`` that are gains."""
    along = [str(name) for name, one in sweep.coords.items() if "observer" in one.dims]
    return [name for name in along if name not in ("observer", "kind")]


def sweep_text(sweep: Any, best: Any) -> str:
    """How the lanes ended, and the best of them.

    Args:
        sweep: of `eoi_jax.sweep`.
        best: of `eoi_jax.best`; None if no lane has an answer.
    """
    lanes = sweep["status"].size
    ended = ", ".join(f"{count} {name}" for name, count in statuses(sweep).items())
    parts = [f"{sweep.attrs['plant']}: {lanes} lanes: {ended}"]
    if best is None:
        return parts[0]
    rows = [("", "best")]
    rows += [(name, _value(best[name])) for name in ("kind", *gain_names(sweep)) if name in best]
    rows += [(_LABELS[name], _value(best[name])) for name in _LABELS if name in best.coords]
    if best.sizes["record"] and sweep.sizes["start"] > 1:
        rows.append(("start", str(int(best["start"]))))
    rows.append(("score", f"{float(best['score']):.6g}"))
    parts += [columns(rows, "<<"), f"score: {best.attrs['criterion']}", _estimates(best)]
    return "\n\n".join(parts)


def _value(one: Any) -> str:
    values = np.atleast_1d(one.values)
    shown = [str(v) if values.dtype.kind in "US" else f"{v:.6g}" for v in values]
    return " ".join(shown)


def _estimates(best: Any) -> str:
    """Estimate and standard error of each parameter, a row for each record."""
    names = [str(name) for name in best["parameter"].values]
    resampled = best.sizes["resample"] > 1
    rows = [("record", *(f"{name} ± std. error" for name in names))]
    for record in best["record"].values:
        one = best.sel(record=record)
        values = one["parameters"].sel(resample=0).values
        if resampled:
            drawn = one["parameters"].sel(resample=slice(1, None))
            errors = drawn.std("resample").values
        else:
            errors = one["standard_error"].sel(resample=0).values
        pairs = zip(values, errors, strict=True)
        rows.append((str(record), *(f"{value:.6g} ± {error:.2g}" for value, error in pairs)))
    note = "\n± from the resamples" if resampled else ""
    return columns(rows, "<" + ">" * len(names)) + note


@styled()
def sweep_figure(sweep: Any, best: Any = None) -> Any:
    """The common index of every lane against each gain that varies, one panel each.

    Args:
        sweep: of `eoi_jax.sweep`.
        best: of `eoi_jax.best`: its lane is marked.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    one = sweep.sel(resample=0)
    index = one["common_index"].where(one["ok"])
    varying = [name for name in gain_names(sweep) if len(_finite(sweep[name].values)) > 1]
    varying += ["cutoff"] if "cutoff" in sweep.coords and sweep.sizes["lowpass"] > 1 else []
    shown = varying[:_SHOWN] or ["observer"]
    rows = sweep.sizes["output"]
    figure = new(3.2 * len(shown) + 1.2, 3.0 * rows + 0.6)
    panels = figure.subplots(rows, len(shown), squeeze=False, sharey="row")
    drawn = [
        _scatter(panel, sweep, index.isel(output=j), name, j)
        for j in range(rows)
        for panel, name in zip(panels[j], shown, strict=True)
    ]
    for j, output in enumerate(sweep["output"].values):
        panels[j, 0].set_ylabel(f"common index of {output}")
    for j, name in np.ndindex(rows, len(shown)) if best is not None else ():
        _mark(panels[j, name], best, shown[name], j)
    if "cutoff" in varying:
        figure.colorbar(drawn[0], ax=panels, label=_LABELS["cutoff"])
    figure.suptitle(f"{sweep.attrs['plant']}: {index.isel(output=0).size} lanes")
    return finished(figure)


def _finite(values: np.ndarray) -> np.ndarray:
    """Every finite value once."""
    return np.unique(values[np.isfinite(values)])


def _mark(panel: Any, best: Any, name: str, j: int) -> None:
    """A ring around the best lane, one for each record."""
    if name not in best.coords and name not in best:
        return
    place = best[name].isel(output=j) if "output" in best[name].dims else best[name]
    index = best["common_index"].isel(output=j).sel(resample=0)
    x, y = (np.ravel(one.broadcast_like(index).values) for one in (place, index))
    ring = {"mfc": "none", "mec": series(AFTER), "ms": 11.0, "mew": 1.8, "ls": "none"}
    panel.plot(x, y, "o", **ring)


def _scatter(panel: Any, sweep: Any, index: Any, name: str, j: int) -> Any:
    gain = sweep[name].isel(output=j) if "output" in sweep[name].dims else sweep[name]
    tint = sweep["cutoff" if "cutoff" in sweep.coords else "lowpass"]
    x, y, colour = (
        np.ravel(one.broadcast_like(index).transpose(*index.dims).values)
        for one in (gain, index, tint)
    )
    drawn = panel.scatter(x, y, c=colour, s=9, cmap="viridis", alpha=0.7, linewidths=0)
    if name != "observer":
        logarithmic(panel.xaxis)
    few = _finite(x)
    if len(few) <= _TICKS:
        panel.set_xticks(few, [f"{value:.3g}" for value in few])
        panel.set_xticks([], minor=True)
    logarithmic(panel.yaxis)
    panel.set_xlabel(_LABELS.get(name, name))
    return drawn
