"""Figures of results. No numerical work here beyond picking the points that are drawn."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.discovery import Added, Discovery
from eoi_jax.identify import Identification
from eoi_jax.profile import Profile
from eoi_jax.refinement import Refinement
from eoi_jax.uncertainty import uncertainty

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
    if j == 0:
        _legend_above(axes)
    scored = np.flatnonzero(np.isfinite(np.asarray(result.injection[record])[:, j]))
    if np.any(np.diff(scored) > 1):  # the transient at the start is no gap
        axes.set_title("gaps: not scored", loc="left", fontsize=9)


def _injection_unit(unit: str | None, degree: int) -> str:
    """The unit of y^(r), e.g. m/s² for a position; empty if the output has none."""
    power = {1: "", 2: "²", 3: "³"}.get(degree, f"^{degree}")
    return f"{unit}/s{power}" if unit else ""


# -- what a discovery found -------------------------------------------------------------------

_BEFORE, _AFTER, _MEASURED = "#0072B2", "#D55E00", "#000000"
_BINS = 40


def discovery_figure(discovery: Discovery) -> Any:
    """Residual over time, residual against what it depends on, free run: one figure.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 10), dpi=100, layout="constrained")
    grid = figure.add_gridspec(3, 1, height_ratios=[1, 1.2, 1.5])
    _draw_residuals(figure.add_subfigure(grid[0]), discovery)
    _draw_maps(figure.add_subfigure(grid[1]), discovery)
    _draw_free_run(figure.add_subfigure(grid[2]), discovery)
    figure.suptitle(f"{discovery.plant.name}: {_found(discovery)}", fontsize=13)
    return figure


def discovery_figures(discovery: Discovery) -> dict[str, Any]:
    """The three parts of `discovery_figure`, a figure each; arguments as there.

    Args:
        discovery: of `discover`.

    Returns:
        Figures by name: ``residual`` before and after over time; ``effect``, the residual before
        against the variable that each effect depends on (against every variable where nothing was
        found); ``free_run``, against the measurement, with its error.
    """
    from matplotlib.figure import Figure

    def new() -> Any:
        figure = Figure(figsize=(10, 5), dpi=100, layout="constrained")
        figure.suptitle(f"{discovery.plant.name}: {_found(discovery)}", fontsize=13)
        return figure

    figures = {"residual": new(), "effect": new(), "free_run": new()}
    _draw_residuals(figures["residual"], discovery)
    _draw_maps(figures["effect"], discovery)
    _draw_free_run(figures["free_run"], discovery)
    return figures


def _found(discovery: Discovery) -> str:
    names = [name.replace("_", " ") for name in discovery.effects]
    return " + ".join(names) or discovery.status.code.replace("_", " ")


def _pair(discovery: Discovery, before: Any, after: Any) -> list[tuple[Any, str, str]]:
    """What is drawn with its colour and label; one curve where nothing was added."""
    if not discovery.added:
        return [(before, _BEFORE, "declared model")]
    return [(before, _BEFORE, "before"), (after, _AFTER, "after")]


def _draw_residuals(figure: Any, discovery: Discovery, record: int = 0) -> None:
    """The residual before and after over time, a panel for each output."""
    before = discovery.declared
    curves = _pair(discovery, before, discovery.found)
    outputs = before.plant.outputs
    panels = figure.subplots(len(outputs), 1, sharex=True, squeeze=False)[:, 0]
    for j, axes in enumerate(panels):
        for result, colour, label in curves:
            time = np.asarray(result.records[record].time)
            values = np.asarray(result.residual[record])[:, j]
            shown = decimate(time[: len(values)], values)
            axes.plot(*shown, color=colour, linewidth=0.8, label=label)
        axes.set_ylabel(_residual_label(before, j))
        axes.grid(alpha=0.3)
    _legend_above(panels[0])
    panels[-1].set_xlabel("time [s]")


def _draw_maps(figure: Any, discovery: Discovery) -> None:
    """The residual before against variables; what the added effects took away through it."""
    maps = [
        (
            one.output if one.output in discovery.plant.outputs else discovery.plant.outputs[0],
            _variable(discovery, one),
        )
        for one in discovery.added
    ]
    if not maps:
        output = discovery.plant.outputs[0]
        maps = [(output, name) for name in ("y", "v", "t", *discovery.plant.inputs)]
    maps = list(dict.fromkeys(maps))
    panels = figure.subplots(1, len(maps), squeeze=False)[0]
    for axes, (output, name) in zip(panels, maps, strict=True):
        _draw_map(axes, discovery, discovery.plant.outputs.index(output), name)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower right", fontsize=9, ncols=2, frameon=False)


def _variable(discovery: Discovery, added: Added) -> str:
    """What an effect is drawn against: y, v, t, or the name of an input."""
    if added.effect.depends_on != "u":
        return added.effect.depends_on
    inputs = discovery.plant.inputs
    return added.output if added.output in inputs else inputs[0]


def _draw_map(axes: Any, discovery: Discovery, j: int, name: str) -> None:
    before = discovery.declared
    variable = _values(before, j, name)
    residual = np.concatenate([part[:, j] for part in before.residual])
    taken = residual - np.concatenate([part[:, j] for part in discovery.found.residual])
    # Where the plant sticks only the model without friction is scored: what both score is shown.
    good = np.isfinite(variable) & np.isfinite(taken)
    order = np.argsort(variable[good])
    bins = np.array_split(np.flatnonzero(good)[order], _BINS)
    centre = np.array([np.mean(variable[one]) for one in bins])
    # Every sample is too many points, and hides where most of them are.
    low, high = np.array([np.quantile(residual[one], (0.1, 0.9)) for one in bins]).T
    means = [np.mean(residual[one]) for one in bins]
    axes.fill_between(centre, low, high, color=_BEFORE, alpha=0.15, linewidth=0)
    axes.plot(
        centre,
        means,
        "o",
        color=_BEFORE,
        markersize=4,
        label="residual of the declared model: mean, band of 80 %",
    )
    if discovery.added:
        fitted = [np.mean(taken[one]) for one in bins]
        axes.plot(centre, fitted, color=_AFTER, label="taken away by the effects")
    axes.axhline(0.0, color=_MEASURED, linewidth=0.6)
    axes.set_xlabel(_variable_label(before, j, name))
    if axes.get_subplotspec().is_first_col():
        axes.set_ylabel(_residual_label(before, j))
    axes.grid(alpha=0.3)


def _values(result: Any, j: int, name: str) -> np.ndarray:
    """A variable along all records, as late as the filter makes the residual."""
    late = 1.0 / (result.lowpass.cutoff * np.sin(0.5 * np.pi / result.lowpass.order))
    parts = []
    for record in result.records:
        if name == "t":
            parts.append(np.asarray(record.time))
            continue
        if name in result.plant.inputs:
            values = record.inputs[:, result.plant.inputs.index(name)]
        else:
            values = record.outputs[:, j]
        if name == "v":
            values = np.gradient(values, record.sample_period)
        parts.append(np.interp(record.time - late, record.time, values))
    return np.concatenate(parts)


def _draw_free_run(figure: Any, discovery: Discovery, record: int = 0) -> None:
    """Free runs before and after on a record against its measurement, and their errors."""
    outputs = discovery.plant.outputs
    panels = figure.subplots(2, len(outputs), sharex=True, squeeze=False, height_ratios=[1.6, 1])
    runs = _pair(discovery, discovery.before, discovery.after)
    given = discovery.held_out
    for j, (upper, lower) in enumerate(panels.T):
        unit = discovery.plant.units.get(outputs[j], "")
        upper.set_ylabel(outputs[j] + (f" [{unit}]" if unit else ""))
        lower.set_ylabel("error" + (f" [{unit}]" if unit else ""))
        lower.set_xlabel("time [s]")
        upper.grid(alpha=0.3)
        lower.grid(alpha=0.3)
        if discovery.before is None:
            upper.set_title("no free run to show", loc="left", fontsize=9)
            continue
        _draw_runs(upper, lower, given[record], [(one.predictions[record].outputs, colour, label)
                                                 for one, colour, label in runs], j)  # fmt: skip
        what = "in-sample" if discovery.in_sample else "held-out"
        title = f"free run, {what} record {given[record].name}"
        upper.set_title(title, loc="left", fontsize=9)
        if j == len(outputs) - 1:
            _legend_above(upper)


def _draw_runs(upper: Any, lower: Any, measured: Record, runs: Sequence[Any], j: int) -> None:
    time = np.asarray(measured.time)
    y = np.where(measured.valid, measured.outputs[:, j], np.nan)
    upper.plot(*decimate(time, y), color=_MEASURED, linewidth=1.6, label="measured")
    for prediction, colour, label in runs:
        y_hat = prediction[:, j]
        upper.plot(*decimate(time, y_hat), color=colour, linewidth=0.9, label=label)
        lower.plot(*decimate(time, y - y_hat), color=colour, linewidth=0.9)
    # A run that diverges would hide the rest.
    middle, reach = np.nanmean(y), np.nanmax(np.abs(y - np.nanmean(y)))
    _limit(upper, middle - 3 * reach, middle + 3 * reach)
    _limit(lower, -3 * reach, 3 * reach)


# -- what a refinement changed -----------------------------------------------------------------

_PER_ROW = 6  # parameters
_NEAR = 4.0  # half widths of the interval within which the starting value is drawn to scale


def refinement_figure(result: Refinement, record: int = 0) -> Any:
    """Measured against free run before and after, what is left, and parameters with intervals.

    Args:
        result: of `refine`; one that did not keep its records shows its parameters only.
        record: which of the records is drawn.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    from matplotlib.figure import Figure

    outputs = result.plant.outputs if result.records else ()
    free = [name for name in result.parameters if name not in result.plant.fixed]
    rows = -(-len(free) // _PER_ROW)
    figure = Figure(
        figsize=(10, 1.0 + 2.8 * len(outputs) + 1.9 * rows), dpi=100, layout="constrained"
    )
    grid = figure.add_gridspec(2, 1, height_ratios=[2.8 * len(outputs) + 1e-3, 1.9 * rows])
    if outputs:
        _draw_refined_runs(figure.add_subfigure(grid[0]), result, record)
    _draw_parameters(figure.add_subfigure(grid[1]), result, free, rows)
    figure.suptitle(f"{result.plant.name}: {result.status.code}", fontsize=13)
    return figure


def _draw_refined_runs(figure: Any, result: Refinement, record: int) -> None:
    measured, units = result.records[record], result.plant.units
    residuals = [(result.residual[record], _AFTER, "refined")]
    if result.residual_before:
        residuals.insert(0, (result.residual_before[record], _BEFORE, "before"))
    runs = [(measured.outputs - one, colour, label) for one, colour, label in residuals]
    names = result.plant.outputs
    panels = figure.subplots(2 * len(names), 1, sharex=True, height_ratios=[1.5, 1] * len(names))
    for j, (name, upper, lower) in enumerate(zip(names, panels[::2], panels[1::2], strict=True)):
        _draw_runs(upper, lower, measured, runs, j)
        unit = units.get(name, "")
        upper.set_ylabel(name + (f" [{unit}]" if unit else ""))
        lower.set_ylabel("error" + (f" [{unit}]" if unit else ""))
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
    panels[0].set_title(f"free run, record {measured.name}", loc="left", fontsize=9)
    _legend_above(panels[0])
    panels[-1].set_xlabel("time [s]")


def _draw_parameters(figure: Any, result: Refinement, names: Sequence[str], rows: int) -> None:
    """A small panel each, scaled to its interval: parameters differ in size by many decades."""
    intervals = uncertainty(result).intervals()
    panels = figure.subplots(rows, _PER_ROW, squeeze=False).ravel()
    for axes, name in zip(panels, names, strict=False):
        low, high = intervals[name]
        value, before = result.parameters[name], result.nominal.parameters[name]
        half = 0.5 * (high - low)
        axes.errorbar(0.0, value, half if np.isfinite(half) else None, fmt="o", capsize=5,
                      color=_AFTER)  # fmt: skip
        if not half * _NEAR < abs(before - value):
            axes.plot(0.0, before, "x", color=_BEFORE)
        axes.text(0.97, 0.03, f"before {before:.5g}", color=_BEFORE, fontsize=8, ha="right",
                  transform=axes.transAxes)  # fmt: skip
        unit = result.plant.units.get(name, "")
        axes.set_title(name + (f" [{unit}]" if unit else ""), fontsize=9)
        axes.set_xlim(-1.0, 1.0)
        axes.set_xticks([])
        axes.margins(y=0.35)
        axes.tick_params(labelsize=8)
        axes.ticklabel_format(axis="y", useOffset=False)
        axes.grid(alpha=0.3)
    for axes in panels[len(names) :]:
        axes.set_visible(False)
    figure.suptitle("parameters with 95 % intervals", fontsize=10, x=0.01, ha="left")


def profile_figure(result: Profile) -> Any:
    """The profile of a parameter, with the parabola that its standard error stands for.

    Args:
        result: of `profile`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), dpi=100, layout="constrained")
    axes = figure.add_subplot()
    fine = np.linspace(result.values[0], result.values[-1], 200)
    parabola = ((fine - result.estimate) / result.standard_error) ** 2
    axes.plot(fine, parabola, color=_BEFORE, linewidth=0.9, label="by the standard error")
    axes.plot(result.values, result.statistic, "o-", color=_AFTER, label="profile")
    axes.axhline(result.threshold, color=_MEASURED, linestyle="--", linewidth=0.8,
                 label=f"{100 * result.level:.4g} %")  # fmt: skip
    for end in result.interval:
        if np.isfinite(end):
            axes.axvline(end, color=_AFTER, linewidth=0.8, alpha=0.6)
    axes.set_ylim(0.0, 3.0 * result.threshold)
    axes.ticklabel_format(axis="x", useOffset=False)
    axes.set_xlabel(result.name + (f" [{result.unit}]" if result.unit else ""))
    axes.set_ylabel("2 Δ log-likelihood")
    axes.grid(alpha=0.3)
    _legend_above(axes)
    return figure


# -- limits, labels, legends ------------------------------------------------------------------


def _limit(axes: Any, low: float, high: float) -> None:
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low), min(top, high))


def _residual_label(result: Any, j: int) -> str:
    name = result.plant.outputs[j]
    unit = _injection_unit(result.plant.units.get(name), result.plant.degrees[j])
    return f"residual of\n{name}" + (f" [{unit}]" if unit else "")


def _variable_label(result: Any, j: int, name: str) -> str:
    if name == "t":
        return "time [s]"
    own = name if name in result.plant.inputs else result.plant.outputs[j]
    unit = result.plant.units.get(own, "")
    label = f"rate of {own}" if name == "v" else own
    unit = f"{unit}/s" if unit and name == "v" else unit
    return label + (f" [{unit}]" if unit else "")


def _legend_above(axes: Any) -> None:
    """Above the panel: wherever it stood inside, it would hide data."""
    place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0.1}
    axes.legend(fontsize=9, ncols=3, frameon=False, **place)
