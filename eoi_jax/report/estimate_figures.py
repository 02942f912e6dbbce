"""Figures of estimates: free runs before and after, intervals, correlation, profiles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.data.cleaning import is_slow
from eoi_jax.refinement.courses import Course, courses
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.free_runs import FreeRuns, Run, free_run_series, record_title
from eoi_jax.report.style import (
    ACCENT,
    BASE,
    WIDE,
    WIDTH,
    fix_theme,
    legend_above,
    new_figure,
    series,
    text_colour,
    themed,
    with_unit,
)
from eoi_jax.report.time_series import draw_time_series
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty


@dataclass(frozen=True)
class EstimateLayout:
    """What fits in the panels of a figure of estimates."""

    per_row: int = 6  # parameters side by side, in a figure of full width
    max_distance: float = 4.0  # half widths of an interval up to which the initial value is drawn
    max_numbered: int = 12  # parameters up to which correlations are written as numbers
    max_opacity: float = 0.65  # of a correlation of ±1, at which its number is readable


_LAYOUT = EstimateLayout()
_NARROW = EstimateLayout(per_row=3)


@themed()
def refinement_figure(result: Refinement, record: int = 0, layout: EstimateLayout = _LAYOUT) -> Any:
    """Measurement and free runs before and after, their errors, and parameters with intervals.

    Args:
        result: of `refine`; without its records only the parameters are drawn.
        record: which of the records is drawn.
        layout: of the panels.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    runs = free_run_series(refined_runs(result, record)) if result.records else None
    free = _free(result)
    rows = -(-len(free) // layout.per_row)
    heights = [runs.height if runs else 1e-3, 0.4 + 1.9 * rows]
    figure = new_figure(WIDE, 0.4 + sum(heights), nested=True)
    grid = figure.add_gridspec(2, 1, height_ratios=heights)
    if runs:
        draw_time_series(figure.add_subfigure(grid[0]), runs)
    lower = figure.add_subfigure(grid[1])
    _draw_intervals(lower, uncertainty(result), free, result.nominal.parameters, layout)
    lower.suptitle("parameters with 95 % intervals", x=0.01, ha="left", fontsize="medium")
    figure.suptitle(f"{result.plant.name}: {result.status.code}")
    return fix_theme(figure)


def _free(result: Any) -> list[str]:
    return [name for name in result.parameters if name not in result.plant.fixed]


def refined_runs(result: Refinement, record: int = 0) -> FreeRuns:
    """Free runs before and after on a record of the fit.

    Args:
        result: of `refine`, with its records.
        record: which of them.
    """
    measured, plant = result.records[record], result.plant
    residuals = [(result.residual[record], ACCENT, "refined")]
    if result.residual_before:
        residuals.insert(0, (result.residual_before[record], BASE, "before"))
    sampled = [measured.outputs - error for error, _, _ in residuals]
    if any(is_slow(mask) for mask in measured.output_valid.T) and (
        complete := courses(result, record)
    ):
        pairs = zip(sampled, complete[-len(sampled) :], strict=True)
        sampled = [_between_samples(*pair) for pair in pairs]
    runs = tuple(
        Run(run, colour, label) for run, (_, colour, label) in zip(sampled, residuals, strict=True)
    )
    return FreeRuns(measured, runs, plant.outputs, plant.units, record_title(measured))


def _between_samples(sampled: Course, course: Course, tolerance: float = 1e-3) -> Course:
    """A run at every sample; as it is stored where a run made again is another one.

    That is where both differ by more than `tolerance` of the range of the stored one: the runs of
    the starting point may have been others.
    """
    at_samples = np.isfinite(sampled)
    difference = np.where(at_samples, np.abs(course - sampled), 0.0)
    size = np.ptp(sampled[at_samples]) if np.any(at_samples) else 0.0
    is_same = bool(np.all(difference <= tolerance * size))
    return np.where(at_samples | (not is_same), sampled, course)


# -- intervals and correlation -----------------------------------------------------------------


@themed()
def uncertainty_figure(
    estimate: Uncertainty,
    initial: Mapping[str, float] | None = None,
    layout: EstimateLayout = _LAYOUT,
) -> Any:
    """A panel for each free parameter with its 95 % interval, and the correlation of all.

    Args:
        estimate: of `uncertainty` or `bootstrap`.
        initial: values to compare with.
        layout: of the panels.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(estimate)
    rows = -(-len(names) // layout.per_row)
    heights = [0.4 + 1.9 * rows, 1.2 + 0.34 * len(names)]
    figure = new_figure(WIDE, sum(heights), nested=True)
    grid = figure.add_gridspec(2, 1, height_ratios=heights)
    upper = figure.add_subfigure(grid[0])
    _draw_intervals(upper, estimate, names, initial or {}, layout)
    upper.suptitle("parameters with 95 % intervals", x=0.01, ha="left", fontsize="medium")
    _draw_correlation(figure.add_subfigure(grid[1]), estimate, names, layout)
    return fix_theme(figure)


@themed()
def interval_figure(
    estimate: Uncertainty,
    initial: Mapping[str, float] | None = None,
    layout: EstimateLayout = _NARROW,
) -> Any:
    """A small panel for each free parameter with its 95 % interval.

    Args:
        estimate: of `uncertainty` or `bootstrap`.
        initial: values to compare with.
        layout: of the panels.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(estimate)
    figure = new_figure(WIDTH, 0.2 + 1.7 * -(-len(names) // layout.per_row))
    _draw_intervals(figure, estimate, names, initial or {}, layout)
    return fix_theme(figure)


@themed()
def correlation_figure(estimate: Uncertainty, layout: EstimateLayout = _LAYOUT) -> Any:
    """Correlation of the estimates as colours and, for few parameters, as numbers.

    Args:
        estimate: of `uncertainty` or `bootstrap`.
        layout: of the panels.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    names = _estimated(estimate)
    figure = new_figure(WIDTH, min(1.4 + 0.42 * len(names), 5.0))
    _draw_correlation(figure, estimate, names, layout)
    return fix_theme(figure)


def _estimated(estimate: Uncertainty) -> list[str]:
    errors = estimate.standard_errors
    return [name for name in estimate.parameters if errors[name] != 0] or list(estimate.parameters)


def _draw_intervals(
    figure: Any,
    estimate: Uncertainty,
    names: Sequence[str],
    initial: Mapping[str, float],
    layout: EstimateLayout,
) -> None:
    """A small panel for each parameter, scaled to its interval: parameters differ by decades."""
    intervals = estimate.intervals()
    rows = -(-len(names) // layout.per_row)
    panels = figure.subplots(rows, layout.per_row, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        low, high = intervals[name]
        value = estimate.parameters[name]
        half_width = 0.5 * (high - low)
        bar = [[value - low], [high - value]] if np.isfinite(half_width) else None
        axes.errorbar(0.0, value, bar, fmt="o", capsize=5, color=series(ACCENT), lw=1.6)
        if not np.isfinite(half_width):
            axes.text(0.5, 0.9, "no finite interval", transform=axes.transAxes, ha="center")
        if name in initial:
            if not half_width * layout.max_distance < abs(initial[name] - value):
                axes.plot(0.0, initial[name], "x", color=series(BASE))
            axes.text(0.97, 0.03, f"before {initial[name]:.5g}", color=series(BASE), ha="right",
                      fontsize="small", transform=axes.transAxes)  # fmt: skip
        unit = estimate.units.get(name)
        axes.set_title(f"{name}\n[{unit}]" if unit else name, fontsize="small")
        axes.set_xlim(-1.0, 1.0)
        axes.set_xticks([])
        axes.margins(y=0.4)
        axes.locator_params(axis="y", nbins=4)
    for axes in panels[len(names) :]:
        axes.set_visible(False)


def _draw_correlation(
    figure: Any, estimate: Uncertainty, names: Sequence[str], layout: EstimateLayout
) -> None:
    """A square for each pair, its opacity proportional to the correlation."""
    from matplotlib.patches import Rectangle

    rows = [list(estimate.parameters).index(name) for name in names]
    matrix = estimate.correlation[np.ix_(rows, rows)]
    axes = figure.subplots()
    for i, j in np.argwhere(np.isfinite(matrix)):
        # Opacity rather than a colour map, so that the page can replace the colours by its theme.
        colour = series(ACCENT if matrix[i, j] > 0 else BASE)
        alpha = layout.max_opacity * abs(matrix[i, j])
        axes.add_patch(Rectangle((j, i), 1.0, 1.0, facecolor=colour, alpha=alpha, linewidth=0))
        if len(names) <= layout.max_numbered:
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
    for order, (label, number) in enumerate((("positive", ACCENT), ("negative", BASE))):
        axes.add_patch(Rectangle((0, 0), 0, 0, facecolor=series(number), alpha=layout.max_opacity,
                                 label=label, zorder=order))  # fmt: skip
    legend_above(axes)


# -- one parameter ----------------------------------------------------------------------------


@themed()
def profile_figure(result: Profile) -> Any:
    """The profile of a parameter, with the parabola given by its standard error.

    Args:
        result: of `profile`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    figure = new_figure(WIDTH, 3.2)
    axes = figure.add_subplot()
    fine = np.linspace(result.values[0], result.values[-1], 200)
    parabola = ((fine - result.estimate) / result.standard_error) ** 2
    axes.plot(fine, parabola, color=series(BASE), lw=0.9, label="from the standard error")
    axes.plot(result.values, result.statistic, "o-", color=series(ACCENT), label="profile")
    axes.axhline(result.threshold, color=text_colour(), linestyle="--", linewidth=0.8,
                 label=f"{100 * result.level:.4g} %")  # fmt: skip
    for end in result.interval:
        if np.isfinite(end):
            axes.axvline(end, color=series(ACCENT), linewidth=0.8, alpha=0.6)
    axes.set_ylim(0.0, 3.0 * result.threshold)
    axes.set_xlabel(with_unit(result.name, result.unit))
    axes.set_ylabel("2 Δ log-likelihood")
    legend_above(axes)
    return fix_theme(figure)
