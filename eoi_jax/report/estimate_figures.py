"""Figures of estimates: free runs before and after, intervals, correlation, profiles."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eoi_jax.refinement.result import Refinement
from eoi_jax.report.figures import draw_free_runs, free_run_height
from eoi_jax.report.style import (
    AFTER,
    BEFORE,
    WIDE,
    WIDTH,
    finished,
    ink,
    legend_above,
    new,
    series,
    styled,
    with_unit,
)
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

_PER_ROW = 6  # parameters, in a figure that stands alone
_NEAR = 4.0  # half widths of the interval within which the starting value is drawn to scale
_NAMED = 12  # parameters whose correlations are written into the figure
_DEEPEST = 0.65  # opacity of a correlation of one: its number stays readable


@styled()
def refinement_figure(result: Refinement, record: int = 0) -> Any:
    """Measured against free run before and after, what is left, and parameters with intervals.

    Args:
        result: of `refine`; one that did not keep its records shows its parameters only.
        record: which of the records is drawn.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    outputs = result.plant.outputs if result.records else ()
    free = _free(result)
    rows = -(-len(free) // _PER_ROW)
    heights = [free_run_height(len(outputs)) if outputs else 1e-3, 0.4 + 1.9 * rows]
    figure = new(WIDE, 0.4 + sum(heights))
    grid = figure.add_gridspec(2, 1, height_ratios=heights)
    if outputs:
        _draw_refined_runs(figure.add_subfigure(grid[0]), result, record)
    lower = figure.add_subfigure(grid[1])
    _draw_intervals(lower, uncertainty(result), free, result.nominal.parameters, _PER_ROW)
    lower.suptitle("parameters with 95 % intervals", x=0.01, ha="left", fontsize="medium")
    figure.suptitle(f"{result.plant.name}: {result.status.code}")
    return finished(figure)


@styled()
def refined_runs_figure(result: Refinement, record: int = 0) -> Any:
    """Measured against free run before and after.

    Args:
        result: of `refine`, with its records.
        record: which of them is drawn.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    figure = new(WIDTH, free_run_height(len(result.plant.outputs)))
    _draw_refined_runs(figure, result, record)
    return finished(figure)


def _free(result: Any) -> list[str]:
    return [name for name in result.parameters if name not in result.plant.fixed]


def _draw_refined_runs(figure: Any, result: Refinement, record: int) -> None:
    measured, plant = result.records[record], result.plant
    residuals = [(result.residual[record], series(AFTER), "refined")]
    if result.residual_before:
        residuals.insert(0, (result.residual_before[record], series(BEFORE), "before"))
    runs = [(measured.outputs - one, colour, label) for one, colour, label in residuals]
    which = f"record {measured.name}"
    draw_free_runs(figure, plant.outputs, plant.units, measured, runs, which)


# -- intervals and correlation -----------------------------------------------------------------


@styled()
def uncertainty_figure(known: Uncertainty, before: Mapping[str, float] | None = None) -> Any:
    """A panel for each free parameter with its 95 % interval, and the correlation of all.

    Args:
        known: of `uncertainty` or `bootstrap`.
        before: values to compare with.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(known)
    rows = -(-len(names) // _PER_ROW)
    heights = [0.4 + 1.9 * rows, 1.2 + 0.34 * len(names)]
    figure = new(WIDE, sum(heights))
    grid = figure.add_gridspec(2, 1, height_ratios=heights)
    upper = figure.add_subfigure(grid[0])
    _draw_intervals(upper, known, names, before or {}, _PER_ROW)
    upper.suptitle("parameters with 95 % intervals", x=0.01, ha="left", fontsize="medium")
    _draw_correlation(figure.add_subfigure(grid[1]), known, names)
    return finished(figure)


@styled()
def interval_figure(
    known: Uncertainty, before: Mapping[str, float] | None = None, per_row: int = 3
) -> Any:
    """A small panel for each free parameter with its 95 % interval.

    Args:
        known: of `uncertainty` or `bootstrap`.
        before: values to compare with.
        per_row: panels beside each other.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(known)
    figure = new(WIDTH, 0.2 + 1.7 * -(-len(names) // per_row))
    _draw_intervals(figure, known, names, before or {}, per_row)
    return finished(figure)


@styled()
def correlation_figure(known: Uncertainty) -> Any:
    """Correlation of the estimates, as colours and, of up to a dozen, as numbers.

    Args:
        known: of `uncertainty` or `bootstrap`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(known)
    figure = new(WIDTH, min(1.4 + 0.42 * len(names), 5.0))
    _draw_correlation(figure, known, names)
    return finished(figure)


def _estimated(known: Uncertainty) -> list[str]:
    errors = known.standard_errors
    return [name for name in known.parameters if errors[name] != 0] or list(known.parameters)


def _draw_intervals(
    figure: Any,
    known: Uncertainty,
    names: Sequence[str],
    before: Mapping[str, float],
    per_row: int,
) -> None:
    """A small panel each, scaled to its interval: parameters differ in size by many decades."""
    intervals = known.intervals()
    rows = -(-len(names) // per_row)
    panels = figure.subplots(rows, per_row, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        low, high = intervals[name]
        value = known.parameters[name]
        half = 0.5 * (high - low)
        bar = [[value - low], [high - value]] if np.isfinite(half) else None
        axes.errorbar(0.0, value, bar, fmt="o", capsize=5, color=series(AFTER), lw=1.6)
        if not np.isfinite(half):
            axes.text(0.5, 0.9, "no finite interval", transform=axes.transAxes, ha="center")
        if name in before:
            if not half * _NEAR < abs(before[name] - value):
                axes.plot(0.0, before[name], "x", color=series(BEFORE))
            axes.text(0.97, 0.03, f"before {before[name]:.5g}", color=series(BEFORE), ha="right",
                      fontsize="small", transform=axes.transAxes)  # fmt: skip
        unit = known.units.get(name)
        axes.set_title(f"{name}\n[{unit}]" if unit else name, fontsize="small")
        axes.set_xlim(-1.0, 1.0)
        axes.set_xticks([])
        axes.margins(y=0.4)
        axes.locator_params(axis="y", nbins=4)
    for axes in panels[len(names) :]:
        axes.set_visible(False)


def _draw_correlation(figure: Any, known: Uncertainty, names: Sequence[str]) -> None:
    """A square each, the stronger the colour the stronger the correlation."""
    from matplotlib.patches import Rectangle

    places = [list(known.parameters).index(name) for name in names]
    matrix = known.correlation[np.ix_(places, places)]
    axes = figure.subplots()
    for i, j in np.argwhere(np.isfinite(matrix)):
        # Not a colour map: one colour and how much of it, which any page can show on its own.
        colour = series(AFTER if matrix[i, j] > 0 else BEFORE)
        alpha = _DEEPEST * abs(matrix[i, j])
        axes.add_patch(Rectangle((j, i), 1.0, 1.0, facecolor=colour, alpha=alpha, linewidth=0))
        if len(names) <= _NAMED:
            size = "x-small" if len(names) > 7 else "small"
            axes.text(j + 0.5, i + 0.5, f"{matrix[i, j]:.2f}", ha="center", va="center",
                      fontsize=size)  # fmt: skip
    axes.set_xlim(0, len(names))
    axes.set_ylim(len(names), 0)
    axes.grid(visible=False)
    ticks = np.arange(len(names)) + 0.5
    axes.set_xticks(ticks, names, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(ticks, names)
    axes.set_aspect("equal")
    axes.tick_params(length=0)
    for place, (words, number) in enumerate((("positive", AFTER), ("negative", BEFORE))):
        axes.add_patch(Rectangle((0, 0), 0, 0, facecolor=series(number), alpha=_DEEPEST,
                                 label=words, zorder=place))  # fmt: skip
    legend_above(axes)


# -- one parameter ----------------------------------------------------------------------------


@styled()
def profile_figure(result: Profile) -> Any:
    """The profile of a parameter, with the parabola that its standard error stands for.

    Args:
        result: of `profile`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    figure = new(WIDTH, 3.2)
    axes = figure.add_subplot()
    fine = np.linspace(result.values[0], result.values[-1], 200)
    parabola = ((fine - result.estimate) / result.standard_error) ** 2
    axes.plot(fine, parabola, color=series(BEFORE), lw=0.9, label="by the standard error")
    axes.plot(result.values, result.statistic, "o-", color=series(AFTER), label="profile")
    axes.axhline(result.threshold, color=ink(), linestyle="--", linewidth=0.8,
                 label=f"{100 * result.level:.4g} %")  # fmt: skip
    for end in result.interval:
        if np.isfinite(end):
            axes.axvline(end, color=series(AFTER), linewidth=0.8, alpha=0.6)
    axes.set_ylim(0.0, 3.0 * result.threshold)
    axes.set_xlabel(with_unit(result.name, result.unit))
    axes.set_ylabel("2 Δ log-likelihood")
    legend_above(axes)
    return finished(figure)
