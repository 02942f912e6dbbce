"""Figures of an identification, of records and of free runs: no numerical work."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax.data.cleaning import is_slow
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification
from eoi_jax.report.decimate import decimate
from eoi_jax.report.style import (
    ACCENT,
    BASE,
    WIDE,
    WIDTH,
    fix_theme,
    injection_label,
    injection_unit,
    legend_above,
    limit,
    logarithmic,
    new_figure,
    series,
    text_colour,
    themed,
    with_unit,
)
from eoi_jax.simulation.validate import Validation


@themed()
def identification_figure(result: Identification, record: int = 0) -> Any:
    """Index per pass, and the injection of the first and the best pass over time.

    The paper's figures 6, 9 and 12, one panel for each output.

    Args:
        result: of `identify`.
        record: which of the records' injections is drawn.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    outputs = result.plant.outputs
    figure = new_figure(WIDE, 3.0 + 1.9 * len(outputs))
    grid = figure.add_gridspec(1 + len(outputs), 1, height_ratios=[1.3] + [1] * len(outputs))
    _draw_index(figure.add_subplot(grid[0]), [(result, "")])
    first_panel = None
    panels = []
    for j in range(len(outputs)):
        panels.append(figure.add_subplot(grid[1 + j], sharex=first_panel))
        first_panel = panels[0]
    _draw_injections(panels, result, record)
    figure.suptitle(f"{result.plant.name}: {result.status.code}")
    return fix_theme(figure)


@themed()
def index_figure(results: Sequence[tuple[Identification, str]]) -> Any:
    """The index of each pass, the best pass marked.

    Args:
        results: of `identify`, each with its label; "" for a single result.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    figure = new_figure(WIDTH, 2.7)
    _draw_index(figure.add_subplot(), results)
    return fix_theme(figure)


@themed()
def injection_figure(result: Identification, record: int = 0) -> Any:
    """The injection of the first and of the best pass over time, a panel for each output.

    Args:
        result: of `identify`.
        record: which of the records is drawn.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    count = len(result.plant.outputs)
    figure = new_figure(WIDTH, 1.1 + 1.6 * count)
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _draw_injections(list(panels), result, record)
    return fix_theme(figure)


def _draw_index(axes: Any, results: Sequence[tuple[Identification, str]]) -> None:
    first = results[0][0]
    names, units = first.plant.outputs, first.plant.units
    single = len(names) == 1
    marked = []
    for k, (result, caption) in enumerate(results):
        passes = np.arange(1, len(result.index) + 1)
        for j, name in enumerate(names):
            unit = injection_unit(units.get(name), result.plant.degrees[j])
            label = caption or with_unit(name, f"({unit})²" if unit else "")
            colour = series(k if caption and single else j)
            line_style = "--" if k and not single else "-"
            axes.plot(passes, result.index[:, j], "o", ls=line_style, color=colour, label=label)
            marked.append((result.best_pass + 1, result.index[result.best_pass, j], colour))
    for best, value, colour in marked:
        axes.plot(best, value, "o", ms=10, mfc="none", mec=colour)
    logarithmic(axes.yaxis)
    axes.plot([], [], "o", ms=10, mfc="none", mec=text_colour(), label="best")
    count = max(len(result.index) for result, _ in results)
    axes.set_xticks(range(1, count + 1, max(count // 10, 1)))
    axes.set_xlim(0.7, count + 0.3)
    axes.set_xlabel("pass")
    unit = injection_unit(units.get(names[0]), first.plant.degrees[0])
    axes.set_ylabel(with_unit("index P", f"({unit})²" if unit and results[0][1] else ""))
    legend_above(axes)


def _draw_injections(panels: Sequence[Any], result: Identification, record: int) -> None:
    time = np.asarray(result.records[record].time)
    curves = (
        (result.first_injection, text_colour(), "pass 1"),
        (result.injection, series(ACCENT), f"pass {result.best_pass + 1} (best)"),
    )
    for j, axes in enumerate(panels):
        for injection, colour, label in curves:
            values = np.asarray(injection[record])[:, j]
            points = decimate(time[: len(values)], values)
            axes.plot(*points, color=colour, linewidth=0.9, label=label)
        axes.set_ylabel(injection_label("injection", result.plant, j))
        scored = np.flatnonzero(np.isfinite(np.asarray(result.injection[record])[:, j]))
        if np.any(np.diff(scored) > 1):  # the transient at the start is not a gap
            axes.set_title("gaps: not scored")
        axes.tick_params(labelbottom=j == len(panels) - 1)
    legend_above(panels[0])
    panels[-1].set_xlabel("time [s]")


# -- records ----------------------------------------------------------------------------------


@themed()
def record_figure(record: Record) -> Any:
    """Outputs and inputs over time, a panel each; masked samples are not drawn.

    Args:
        record: the record to draw.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    outputs = list(zip(record.output_names, record.outputs.T, strict=True))
    inputs = list(zip(record.input_names, record.inputs.T, strict=True))
    figure = new_figure(WIDTH, 0.8 + 1.25 * (len(outputs) + len(inputs)))
    panels = figure.subplots(len(outputs) + len(inputs), 1, sharex=True, squeeze=False)[:, 0]
    for i, (axes, (name, channel)) in enumerate(zip(panels, [*outputs, *inputs], strict=True)):
        is_input = i >= len(outputs)
        mask = record.input_valid if is_input else record.output_valid[:, i]
        points = decimate(record.time, np.where(mask, channel, np.nan))
        stepped = is_input and record.holds[i - len(outputs)] == "zero"
        axes.plot(
            *points,
            color=series(ACCENT) if is_input else text_colour(),
            linewidth=0.9,
            drawstyle="steps-post" if stepped else "default",
        )
        axes.set_ylabel(with_unit(name, record.units.get(name)))
    panels[0].set_title(f"{record.name}: outputs and inputs" if inputs else record.name)
    panels[-1].set_xlabel("time [s]")
    return fix_theme(figure)


# -- free runs --------------------------------------------------------------------------------


@themed()
def validation_figure(result: Validation, record: int = 0) -> Any:
    """Free run against the measurement, and its error, two panels for each output.

    Args:
        result: of `validate`; without its records only the free run is drawn.
        record: which of the records is drawn.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    prediction = result.predictions[record]
    measured = result.records[record] if result.records else None
    units = dict(zip(result.outputs, result.units, strict=True))
    runs = [(simulated_outputs(prediction), series(BASE), "free run")]
    figure = new_figure(WIDTH, free_run_height(len(result.outputs)))
    has_measurement = measured is not None
    draw_free_runs(
        figure,
        result.outputs,
        units,
        measured or prediction,
        runs,
        measured_outputs=has_measurement,
    )
    return fix_theme(figure)


def simulated_outputs(prediction: Record) -> np.ndarray:
    """Outputs of a free run, NaN where an unknown input interrupts it, (N, ny)."""
    return np.where(prediction.output_valid, prediction.outputs, np.nan)


def free_run_height(outputs: int) -> float:
    """Height of a figure of free runs [inch]."""
    return 1.0 + 2.5 * outputs


def draw_free_runs(
    figure: Any,
    outputs: Sequence[str],
    units: dict[str, str],
    measured: Record,
    runs: Sequence[tuple[np.ndarray, str, str]],
    title: str = "",
    measured_outputs: bool = True,
    max_range: float = 3.0,
) -> None:
    """Free runs and their errors over time, two panels for each output.

    Args:
        figure: a figure or a subfigure.
        outputs: names.
        units: by name.
        measured: the record; only its time is used without `measured_outputs`.
        runs: outputs (N, ny), colour and label of each free run.
        title: label of the record; "" for its name.
        measured_outputs: whether the outputs of the record are measurements.
        max_range: half ranges of the measurement to which the panels are clipped: a run that
            diverges must not flatten the other curves.
    """
    ratios = [1.6, 1.0] * len(outputs)
    panels = figure.subplots(2 * len(outputs), 1, sharex=True, height_ratios=ratios)
    for j, name in enumerate(outputs):
        upper, lower = panels[2 * j], panels[2 * j + 1]
        upper.set_ylabel(with_unit(name, units.get(name)))
        lower.set_ylabel(with_unit("error", units.get(name)))
        time = np.asarray(measured.time)
        mask = measured.output_valid[:, j] & measured_outputs
        y = np.where(mask, measured.outputs[:, j], np.nan)
        slow = is_slow(mask)  # no line: few samples have a neighbour
        marker, line = (".", "none") if slow else ("none", "-")
        shown = mask if slow else slice(None)
        if measured_outputs:
            points = decimate(time[shown], y[shown])
            upper.plot(
                *points,
                color=text_colour(),
                linewidth=2.0,
                marker=marker,
                linestyle=line,
                label="measured",
            )
        for prediction, colour, label in runs:
            y_hat = prediction[:, j]
            upper.plot(*decimate(time, y_hat), color=colour, linewidth=1.0, label=label)
            points = decimate(time[shown], (y - y_hat)[shown])
            lower.plot(*points, color=colour, linewidth=0.9, marker=marker, linestyle=line)
        if measured_outputs:
            mean = np.nanmean(y)
            size = max_range * np.nanmax(np.abs(y - mean))
            limit(upper, mean - size, mean + size)
            limit(lower, -size, size)
    legend_above(panels[0])
    # Not as a title, which the legend would overlap.
    panels[-1].set_xlabel(f"time [s], {title or measured.name}")
