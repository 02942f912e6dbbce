"""Figures of results. No numerical work here beyond picking the points that are drawn."""

from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.identify import Identification

# Okabe and Ito's palette, told apart by colour-blind readers; black and vermilion for the
# first and the best pass, the paper's black and red.
_FIRST, _BEST = "#000000", "#D55E00"
_OUTPUTS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#F0E442")
# Two points per pixel column of a figure 1000 px wide.
_COLUMNS = 1000


def identification_figure(result: Identification, record: int = 0) -> Any:
    """Index per pass, and the injection of the first and the best pass over time.

    The paper's figures 6, 9 and 12, one panel for each output.

    Args:
        result: of `identify`.
        record: which of the records' injections is drawn.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    from matplotlib.figure import Figure  # slow to import, and needed by nothing else

    outputs = result.plant.outputs
    figure = Figure(figsize=(10, 3.2 + 2.1 * len(outputs)), dpi=100, layout="constrained")
    grid = figure.add_gridspec(1 + len(outputs), 1, height_ratios=[1.3] + [1] * len(outputs))
    _draw_index(figure.add_subplot(grid[0]), result)
    shared = None
    for j in range(len(outputs)):
        axes = figure.add_subplot(grid[1 + j], sharex=shared)
        shared = shared or axes
        _draw_injection(axes, result, record, j)
        axes.tick_params(labelbottom=j == len(outputs) - 1)
    axes.set_xlabel("time [s]")
    figure.suptitle(f"{result.plant.name}: {result.status.code}", fontsize=13)
    return figure


def decimate(
    time: Float[np.ndarray, " time"], values: Float[np.ndarray, " time"], columns: int = _COLUMNS
) -> tuple[Float[np.ndarray, " drawn"], Float[np.ndarray, " drawn"]]:
    """The smallest and the largest value of each of `columns` stretches, so that peaks stay.

    Args:
        time: stamps.
        values: the signal; NaN is left out of a stretch, and stays where it is all there is.
        columns: stretches.

    Returns:
        Time and values of at most ``2 * columns`` points, in order of time.
    """
    size = -(-len(values) // columns)
    if size <= 2:
        return time, values
    blocks = np.pad(values, (0, -len(values) % size), mode="edge").reshape(-1, size)
    low = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    starts = np.arange(len(blocks)) * size
    picked = np.sort(np.stack([starts + low, starts + high], axis=1), axis=1).ravel()
    picked = np.minimum(picked, len(values) - 1)
    return time[picked], values[picked]


def _draw_index(axes: Any, result: Identification) -> None:
    passes = np.arange(1, len(result.index) + 1)
    units = result.plant.units
    for j, name in enumerate(result.plant.outputs):
        unit = _injection_unit(units.get(name), result.plant.degrees[j])
        label = f"{name} [({unit})²]" if unit else name
        colour = _OUTPUTS[j % len(_OUTPUTS)]
        axes.semilogy(passes, result.index[:, j], "o-", color=colour, label=label)
    best = result.best_pass + 1
    axes.axvline(best, color=_BEST, linestyle="--", linewidth=1, label=f"best: pass {best}")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_xlabel("pass")
    axes.set_ylabel("index P")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=9)


def _draw_injection(axes: Any, result: Identification, record: int, j: int) -> None:
    time = np.asarray(result.records[record].time)
    curves = (
        (result.first_injection, _FIRST, "pass 1"),
        (result.injection, _BEST, f"pass {result.best_pass + 1} (best)"),
    )
    for injection, colour, label in curves:
        values = np.asarray(injection[record])[:, j]
        axes.plot(*decimate(time[: len(values)], values), color=colour, linewidth=0.9, label=label)
    name = result.plant.outputs[j]
    unit = _injection_unit(result.plant.units.get(name), result.plant.degrees[j])
    axes.set_ylabel(f"injection of\n{name}" + (f" [{unit}]" if unit else ""))
    axes.grid(alpha=0.3)
    if j == 0:  # above the panel: wherever it stood inside, it would hide data
        place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
        axes.legend(fontsize=9, ncols=2, frameon=False, **place)
    scored = np.flatnonzero(np.isfinite(np.asarray(result.injection[record])[:, j]))
    if np.any(np.diff(scored) > 1):  # the transient at the start is no gap
        axes.set_title("gaps: not scored", loc="left", fontsize=9)


def _injection_unit(unit: str | None, degree: int) -> str:
    """The unit of y^(r), e.g. m/s² for a position; empty if the output has none."""
    power = {1: "", 2: "²", 3: "³"}.get(degree, f"^{degree}")
    return f"{unit}/s{power}" if unit else ""
