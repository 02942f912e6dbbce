"""Figures of a discovery: no numerical work beyond the means of bins."""

from typing import Any

import numpy as np

from eoi_jax.discovery.result import Added, Discovery
from eoi_jax.models.plant import derivative_unit, velocity_rows
from eoi_jax.report.decimate import decimate
from eoi_jax.report.figures import draw_free_runs, free_run_height
from eoi_jax.report.style import (
    AFTER,
    BEFORE,
    WIDE,
    WIDTH,
    finished,
    injected,
    ink,
    legend_above,
    new,
    series,
    styled,
    with_unit,
)

_BINS = 40
_BESIDE = 2  # maps in a row


@styled()
def discovery_figure(discovery: Discovery) -> Any:
    """Residual over time, residual against what it depends on, free run: one figure.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    outputs, rows = len(discovery.plant.outputs), -(-len(_maps(discovery)) // _BESIDE)
    heights = [1.0 + 1.4 * outputs, 0.5 + 2.5 * rows, free_run_height(outputs)]
    figure = new(WIDE, sum(heights))
    grid = figure.add_gridspec(3, 1, height_ratios=heights)
    _draw_residuals(figure.add_subfigure(grid[0]), discovery)
    _draw_maps(figure.add_subfigure(grid[1]), discovery)
    _draw_free_run(figure.add_subfigure(grid[2]), discovery)
    figure.suptitle(f"{discovery.plant.name}: {_found(discovery)}")
    return finished(figure)


@styled()
def residual_figure(discovery: Discovery) -> Any:
    """The residual before and after over time, a panel for each output.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    figure = new(WIDTH, 1.1 + 1.6 * len(discovery.plant.outputs))
    _draw_residuals(figure, discovery)
    return finished(figure)


@styled()
def effect_figure(discovery: Discovery) -> Any:
    """The residual before against the variable that each effect depends on, the effect in it.

    Where nothing was found: against every variable.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    maps = _maps(discovery)
    rows = -(-len(maps) // _BESIDE)
    figure = new(WIDTH, 0.7 + (2.1 if len(maps) > 1 else 2.6) * rows)
    _draw_maps(figure, discovery)
    return finished(figure)


@styled()
def free_run_figure(discovery: Discovery) -> Any:
    """Free runs before and after on a held-out record against its measurement.

    Args:
        discovery: of `discover`, with free runs.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    figure = new(WIDTH, free_run_height(len(discovery.plant.outputs)))
    _draw_free_run(figure, discovery)
    return finished(figure)


def discovery_figures(discovery: Discovery) -> dict[str, Any]:
    """The three parts of `discovery_figure`, a figure each; arguments as there.

    Args:
        discovery: of `discover`.

    Returns:
        Figures by name: ``residual`` before and after over time; ``effect``, the residual before
        against the variable that each effect depends on (against every variable where nothing was
        found); ``free_run``, against the measurement, with its error.
    """
    return {name: draw(discovery) for name, draw in PARTS.items()}


PARTS = {"residual": residual_figure, "effect": effect_figure, "free_run": free_run_figure}


def _found(discovery: Discovery) -> str:
    names = [name.replace("_", " ") for name in discovery.effects]
    return " + ".join(names) or discovery.status.code.replace("_", " ")


def _pair(discovery: Discovery, before: Any, after: Any) -> list[tuple[Any, str, str]]:
    """What is drawn with its colour and label; one curve where nothing was added."""
    if not discovery.added:
        return [(before, series(BEFORE), "declared model")]
    return [(before, series(BEFORE), "before"), (after, series(AFTER), "after")]


def _draw_residuals(figure: Any, discovery: Discovery, record: int = 0) -> None:
    before = discovery.declared
    curves = _pair(discovery, before, discovery.found)
    panels = figure.subplots(len(before.plant.outputs), 1, sharex=True, squeeze=False)[:, 0]
    for j, axes in enumerate(panels):
        for result, colour, label in curves:
            time = np.asarray(result.records[record].time)
            values = np.asarray(result.residual[record])[:, j]
            shown = decimate(time[: len(values)], values)
            axes.plot(*shown, color=colour, linewidth=0.8, label=label)
        axes.set_ylabel(injected("residual", before.plant, j))
    legend_above(panels[0])
    panels[-1].set_xlabel("time [s]")


# -- the residual against variables -----------------------------------------------------------


def _maps(discovery: Discovery) -> list[tuple[str, str, str]]:
    """Output, variable, and what it is counted from, of each panel.

    What an effect depends on, or all there is.
    """
    outputs = discovery.plant.outputs
    maps = [
        (
            one.output if one.output in outputs else outputs[0],
            _variable(discovery, one),
            one.against,
        )
        for one in discovery.added
    ]
    if not maps:
        known = ("y", "v", "t") if discovery.plant.degrees[0] > 1 else ("y", "t")
        maps = [(outputs[0], name, "") for name in (*known, *discovery.plant.inputs)]
    return list(dict.fromkeys(maps))


def _draw_maps(figure: Any, discovery: Discovery) -> None:
    """The residual before against variables; what the added effects took away through it."""
    maps = _maps(discovery)
    beside = min(len(maps), _BESIDE)
    rows = -(-len(maps) // beside)
    panels = figure.subplots(rows, beside, squeeze=False)
    for axes, (output, name, against) in zip(panels.ravel(), maps, strict=False):
        _draw_map(axes, discovery, discovery.plant.outputs.index(output), name, against)
    for axes in panels.ravel()[len(maps) :]:
        axes.set_visible(False)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)


def _variable(discovery: Discovery, added: Added) -> str:
    """What an effect is drawn against: y, v, t, or the name of an input."""
    if added.effect.depends_on != "u":
        return added.effect.depends_on
    inputs = discovery.plant.inputs
    return added.output if added.output in inputs else inputs[0]


def _draw_map(axes: Any, discovery: Discovery, j: int, name: str, against: str) -> None:
    before = discovery.declared
    variable = _values(before, j, name)
    if against:
        variable = variable - _values(before, before.plant.outputs.index(against), name)
    residual = np.concatenate([part[:, j] for part in before.residual])
    taken = residual - np.concatenate([part[:, j] for part in discovery.found.residual])
    # Where the plant sticks only the model without friction is scored: what both score is shown.
    good = np.isfinite(variable) & np.isfinite(taken)
    order = np.argsort(variable[good])
    bins = np.array_split(np.flatnonzero(good)[order], int(np.clip(np.sum(good), 1, _BINS)))
    if not np.any(good):
        axes.text(0.5, 0.5, "no sample to show", transform=axes.transAxes, ha="center")
        bins = []
    centre = np.array([np.mean(variable[one]) for one in bins])
    # Every sample is too many points, and hides where most of them are.
    low, high = np.reshape([np.quantile(residual[one], (0.1, 0.9)) for one in bins], (-1, 2)).T
    means = [np.mean(residual[one]) for one in bins]
    axes.fill_between(centre, low, high, color=series(BEFORE), alpha=0.18, linewidth=0)
    label = "residual before: mean, band of 80 %"
    axes.plot(centre, means, "o", color=series(BEFORE), markersize=4, label=label)
    if discovery.added:
        fitted = [np.mean(taken[one]) for one in bins]
        axes.plot(centre, fitted, color=series(AFTER), lw=1.6, label="taken away by the effects")
    axes.axhline(0.0, color=ink(), linewidth=0.5)
    axes.locator_params(axis="x", nbins=5)  # panels beside each other are narrow
    axes.set_xlabel(_variable_label(before, j, name, against))
    if axes.get_subplotspec().is_first_col():
        axes.set_ylabel(injected("residual", before.plant, j))


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
        if _derived(result, j, name):
            values = np.gradient(values, record.sample_period)
        parts.append(np.interp(record.time - late, record.time, values))
    return np.concatenate(parts)


def _variable_label(result: Any, j: int, name: str, against: str) -> str:
    if name == "t":
        return "time [s]"
    own = name if name in result.plant.inputs else result.plant.outputs[j]
    unit = result.plant.units.get(own, "")
    derived = _derived(result, j, name)
    what = f"{own} - {against}" if against else own
    label = f"rate of {what}" if derived else what
    return with_unit(label, derivative_unit(unit, 1) if derived else unit)


def _derived(result: Any, j: int, name: str) -> bool:
    """Whether a velocity is a derivative of the output, which is none itself."""
    return name == "v" and velocity_rows(result.plant.degrees)[j] == 1


# -- the free run -----------------------------------------------------------------------------


def _draw_free_run(figure: Any, discovery: Discovery, record: int = 0) -> None:
    """Free runs before and after on a record against its measurement, and their errors."""
    plant = discovery.plant
    if discovery.before is None:
        figure.subplots().set_title("no free run to show")
        return
    runs = [
        (one.predictions[record].outputs, colour, label)
        for one, colour, label in _pair(discovery, discovery.before, discovery.after)
    ]
    measured = discovery.held_out[record]
    what = "in-sample" if discovery.in_sample else "held-out"
    which = f"{what} record {measured.name}"
    draw_free_runs(figure, plant.outputs, plant.units, measured, runs, which)
