"""Figures of a discovery: no numerical work beyond the means of bins."""

from typing import Any

import numpy as np

from eoi_jax.discovery.result import Added, Discovery
from eoi_jax.models.effects import AbstractParameterEffect
from eoi_jax.models.units import derivative_unit
from eoi_jax.models.velocities import velocity_rows
from eoi_jax.report.free_runs import FreeRuns, free_run_series, record_title, validation_runs
from eoi_jax.report.style import (
    ACCENT,
    BASE,
    WIDE,
    WIDTH,
    fix_theme,
    injection_label,
    new_figure,
    series,
    text_colour,
    themed,
    with_unit,
)
from eoi_jax.report.time_series import (
    Panel,
    Signal,
    TimeSeries,
    draw_time_series,
    time_series_figure,
)


@themed()
def discovery_figure(discovery: Discovery) -> Any:
    """Residual over time, residual against the variables of the effects, free run: one figure.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    rows, _ = _layout(_maps(discovery))
    residual, runs = residual_series(discovery), free_runs(discovery)
    comparison = None if runs is None else free_run_series(runs)
    heights = [residual.height, 0.5 + 2.5 * rows, comparison.height if comparison else 1.0]
    figure = new_figure(WIDE, sum(heights), nested=True)
    grid = figure.add_gridspec(3, 1, height_ratios=heights)
    draw_time_series(figure.add_subfigure(grid[0]), residual)
    _draw_maps(figure.add_subfigure(grid[1]), discovery)
    lowest = figure.add_subfigure(grid[2])
    if comparison is None:
        lowest.subplots().set_title("no free run")
    else:
        draw_time_series(lowest, comparison)
    figure.suptitle(f"{discovery.plant.name}: {_title(discovery)}")
    return fix_theme(figure)


def residual_figure(discovery: Discovery) -> Any:
    """Residual before and after over time, a panel for each output.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    return time_series_figure(residual_series(discovery))


@themed()
def effect_figure(discovery: Discovery) -> Any:
    """Residual before against the variable that each effect depends on, with the effect.

    Without effects: against every variable.

    Args:
        discovery: of `discover`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    maps = _maps(discovery)
    rows, _ = _layout(maps)
    figure = new_figure(WIDTH, 0.7 + (2.1 if len(maps) > 1 else 2.6) * rows, nested=True)
    _draw_maps(figure, discovery)
    return fix_theme(figure)


def free_run_figure(discovery: Discovery) -> Any:
    """Free runs before and after on a held-out record against its measurement.

    Args:
        discovery: of `discover`, with free runs.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    runs = free_runs(discovery)
    return _without_runs() if runs is None else time_series_figure(free_run_series(runs))


@themed()
def _without_runs() -> Any:
    figure = new_figure(WIDTH, 1.0)
    figure.subplots().set_title("no free run")
    return fix_theme(figure)


def discovery_figures(discovery: Discovery) -> dict[str, Any]:
    """The three parts of `discovery_figure`, each as a figure.

    Args:
        discovery: of `discover`.

    Returns:
        Figures by name: ``residual`` before and after over time; ``effect``, the residual before
        against the variable that each effect depends on (against every variable without effects);
        ``free_run``, against the measurement, with its error.
    """
    return {name: draw(discovery) for name, draw in PARTS.items()}


PARTS = {"residual": residual_figure, "effect": effect_figure, "free_run": free_run_figure}


def _title(discovery: Discovery) -> str:
    names = [name.replace("_", " ") for name in discovery.effects]
    return " + ".join(names) or discovery.status.code.replace("_", " ")


def residual_series(discovery: Discovery, record: int = 0) -> TimeSeries:
    """Residual before and after over time, a panel for each output.

    Args:
        discovery: of `discover`.
        record: which of the records of the fit.
    """
    declared = discovery.declared
    fits = [(declared, BASE, "before"), (discovery.found, ACCENT, "after")]
    if not discovery.changed:
        fits = [(declared, BASE, "declared model")]
    panels = []
    for j in range(len(declared.plant.outputs)):
        lines = [
            Signal(label, np.asarray(fit.residual[record])[:, j], colour, 0.8)
            for fit, colour, label in fits
        ]
        panels.append(Panel(injection_label("residual", declared.plant, j), tuple(lines), 1.6))
    used = declared.records[record]
    return TimeSeries(np.asarray(used.time), tuple(panels), used.data_hash)


# -- the residual against variables -----------------------------------------------------------


def _maps(discovery: Discovery) -> list[tuple[str, str, str]]:
    """Output, variable, and reference output ("" for none) of each panel.

    The variables that the effects depend on; without effects all variables.
    """
    outputs = discovery.plant.outputs
    maps = []
    for added in discovery.added:
        output = added.output if added.output in outputs else outputs[0]
        maps.append((output, _variable(discovery, added, output), added.against))
    if not maps:
        variables = ("y", "v", "t") if discovery.plant.degrees[0] > 1 else ("y", "t")
        maps = [(outputs[0], name, "") for name in (*variables, *discovery.plant.inputs)]
    return list(dict.fromkeys(maps))


def _layout(maps: list[tuple[str, str, str]], max_columns: int = 2) -> tuple[int, int]:
    """Rows and columns of panels, of which `max_columns` fit side by side."""
    columns = min(len(maps), max_columns)
    return -(-len(maps) // columns), columns


def _draw_maps(figure: Any, discovery: Discovery) -> None:
    """The residual before against variables, and the part of it that the added effects explain."""
    maps = _maps(discovery)
    panels = figure.subplots(*_layout(maps), squeeze=False)
    for axes, (output, name, against) in zip(panels.ravel(), maps, strict=False):
        _draw_map(axes, discovery, discovery.plant.outputs.index(output), name, against)
    for axes in panels.ravel()[len(maps) :]:
        axes.set_visible(False)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)


def _variable(discovery: Discovery, added: Added, output: str) -> str:
    """The variable of an effect: y, v, t, or the name of an input.

    The velocity of an output that is one itself is y: one panel shows both.
    """
    if isinstance(added.effect, AbstractParameterEffect):
        return next((signal.name for signal in added.effect.signals if signal.row is None), "t")
    variable = added.effect.depends_on
    if variable == "v" and not _derived(discovery, discovery.plant.outputs.index(output), "v"):
        return "y"
    if variable != "u":
        return variable
    inputs = discovery.plant.inputs
    return added.output if added.output in inputs else inputs[0]


def _draw_map(
    axes: Any, discovery: Discovery, j: int, name: str, against: str, max_bins: int = 40
) -> None:
    """One map; means are taken over `max_bins` bins, as many dots as a narrow panel can show."""
    declared = discovery.declared
    variable = _values(declared, j, name)
    if against:
        variable = variable - _values(declared, declared.plant.outputs.index(against), name)
    residual = np.concatenate([part[:, j] for part in declared.residual])
    explained = residual - np.concatenate([part[:, j] for part in discovery.found.residual])
    # Where the plant sticks only the model without friction is scored: use samples that both score.
    scored = np.isfinite(variable) & np.isfinite(explained)
    order = np.argsort(variable[scored])
    bins = np.array_split(np.flatnonzero(scored)[order], int(np.clip(np.sum(scored), 1, max_bins)))
    if not np.any(scored):
        axes.text(0.5, 0.5, "no samples", transform=axes.transAxes, ha="center")
        bins = []
    centre = np.array([np.mean(variable[indices]) for indices in bins])
    # Drawing every sample would hide where most of them are.
    low, high = np.reshape(
        [np.quantile(residual[indices], (0.1, 0.9)) for indices in bins], (-1, 2)
    ).T
    means = [np.mean(residual[indices]) for indices in bins]
    axes.fill_between(centre, low, high, color=series(BASE), alpha=0.18, linewidth=0)
    label = "residual before: mean and 80 % band"
    axes.plot(centre, means, "o", color=series(BASE), markersize=4, label=label)
    if discovery.added:
        fitted = [np.mean(explained[indices]) for indices in bins]
        axes.plot(centre, fitted, color=series(ACCENT), lw=1.6, label="explained by the effects")
    axes.axhline(0.0, color=text_colour(), linewidth=0.5)
    axes.locator_params(axis="x", nbins=5)  # panels side by side are narrow
    axes.set_xlabel(_variable_label(declared, j, name, against))
    if axes.get_subplotspec().is_first_col():
        axes.set_ylabel(injection_label("residual", declared.plant, j))


def _values(result: Any, j: int, name: str) -> np.ndarray:
    """A variable over all records, delayed as the filter delays the residual."""
    delay = 1.0 / (result.lowpass.cutoff * np.sin(0.5 * np.pi / result.lowpass.order))
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
        parts.append(np.interp(record.time - delay, record.time, values))
    return np.concatenate(parts)


def _variable_label(result: Any, j: int, name: str, against: str) -> str:
    if name == "t":
        return "time [s]"
    channel = name if name in result.plant.inputs else result.plant.outputs[j]
    unit = result.plant.units.get(channel, "")
    derived = _derived(result, j, name)
    variable = f"{channel} - {against}" if against else channel
    label = f"rate of {variable}" if derived else variable
    return with_unit(label, derivative_unit(unit, 1) if derived else unit)


def _derived(result: Any, j: int, name: str) -> bool:
    """Whether the velocity is the derivative of the output, which is not a velocity itself."""
    return name == "v" and velocity_rows(result.plant.degrees)[j] == 1


# -- the free run -----------------------------------------------------------------------------


def free_runs(discovery: Discovery, record: int = 0) -> FreeRuns | None:
    """Free runs before and after on a held-out record; None where none was possible.

    Args:
        discovery: of `discover`.
        record: which of the held-out records.
    """
    if discovery.before is None or discovery.after is None:
        return None
    results = [(discovery.before, "before"), (discovery.after, "after")]
    if not discovery.changed:
        results = [(discovery.before, "declared model")]
    runs = validation_runs(*results, record=record)
    data = "in-sample" if discovery.in_sample else "held-out"
    measured = discovery.held_out[record]
    title = f"{data} {record_title(measured)}"
    plant = discovery.plant
    return FreeRuns(measured, runs.runs, plant.outputs, plant.units, title)
