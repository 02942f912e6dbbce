"""Figures of an identification, of records and of validations: no numerical work."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification
from eoi_jax.report.free_runs import free_run_series, validation_runs
from eoi_jax.report.style import (
    ACCENT,
    WIDE,
    WIDTH,
    fix_theme,
    injection_label,
    injection_unit,
    legend_above,
    logarithmic,
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
    draw_panels,
    time_series_figure,
)
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class IndexScale:
    """What a figure of the index shows.

    Attributes:
        largest: index over the first finite one, up to which the axis reaches: the integral of a
            pass that runs away may be any number. Beyond it, lines leave the figure at the top.
    """

    largest: float = 1e6


_SCALE = IndexScale()


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
        panels[-1].tick_params(labelbottom=j == len(outputs) - 1)
        first_panel = panels[0]
    draw_panels(panels, injection_series(result, record))
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


def _draw_index(axes: Any, results: Sequence[tuple[Identification, str]]) -> None:
    first = results[0][0]
    names, units = first.plant.outputs, first.plant.units
    single = len(names) == 1
    marked, top = [], max(map(_largest_drawn, (result.index for result, _ in results)))
    for k, (result, caption) in enumerate(results):
        passes = np.arange(1, len(result.index) + 1)
        for j, name in enumerate(names):
            unit = injection_unit(units.get(name), result.plant.degrees[j])
            label = caption or with_unit(name, f"({unit})²" if unit else "")
            colour = series(k if caption and single else j)
            line_style = "--" if k and not single else "-"
            index = np.minimum(result.index[:, j], 10.0 * top)
            axes.plot(passes, index, "o", ls=line_style, color=colour, label=label)
            marked.append((result.best_pass + 1, result.index[result.best_pass, j], colour))
    for best, value, colour in marked:
        axes.plot(best, value, "o", ms=10, mfc="none", mec=colour)
    logarithmic(axes.yaxis)
    if any(np.any(result.index > top) for result, _ in results):
        axes.set_ylim(top=top)
    axes.plot([], [], "o", ms=10, mfc="none", mec=text_colour(), label="best")
    count = max(len(result.index) for result, _ in results)
    axes.set_xticks(range(1, count + 1, max(count // 10, 1)))
    axes.set_xlim(0.7, count + 0.3)
    axes.set_xlabel("pass")
    unit = injection_unit(units.get(names[0]), first.plant.degrees[0])
    axes.set_ylabel(with_unit("index P", f"({unit})²" if unit and results[0][1] else ""))
    legend_above(axes)


def _largest_drawn(index: Float[np.ndarray, "passes ny"]) -> float:
    """Upper end of an axis with the index of each pass; infinite where none is finite."""
    (finite,) = np.nonzero(np.all(np.isfinite(index), axis=1))
    return _SCALE.largest * float(np.max(index[finite[0]])) if len(finite) else np.inf


def injection_series(result: Identification, record: int = 0) -> TimeSeries:
    """The injection of the first and of the best pass over time, a panel for each output.

    Args:
        result: of `identify`.
        record: which of the records.
    """
    best = f"pass {result.best_pass + 1} (best)"
    first, last = (
        np.asarray(parts[record]) for parts in (result.first_injection, result.injection)
    )
    panels = []
    for j in range(len(result.plant.outputs)):
        lines = (Signal("pass 1", first[:, j]), Signal(best, last[:, j], ACCENT))
        # The transient at the start is not a gap.
        gaps = np.any(np.diff(np.flatnonzero(np.isfinite(last[:, j]))) > 1)
        label = injection_label("injection", result.plant, j)
        panels.append(Panel(label, lines, 1.6, title="gaps: not scored" if gaps else ""))
    used = result.records[record]
    return TimeSeries(np.asarray(used.time), tuple(panels), used.data_hash)


# -- records ----------------------------------------------------------------------------------


def record_figure(record: Record) -> Any:
    """Outputs and inputs over time, a panel each; masked samples are not drawn.

    Args:
        record: the record to draw.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    return time_series_figure(record_series(record))


def record_series(record: Record) -> TimeSeries:
    """Outputs and inputs over time, a panel each, NaN where they are masked.

    Args:
        record: what is drawn.
    """
    signals = [
        Signal(name, np.where(mask, channel, np.nan))
        for name, channel, mask in zip(
            record.output_names, record.outputs.T, record.output_valid.T, strict=True
        )
    ]
    signals += [
        Signal(name, np.where(record.input_valid, channel, np.nan), ACCENT, held=hold == "zero")
        for name, channel, hold in zip(
            record.input_names, record.inputs.T, record.holds, strict=True
        )
    ]
    title = f"{record.name}: outputs and inputs" if record.input_names else record.name
    panels = tuple(
        Panel(with_unit(signal.label, record.units.get(signal.label)), (signal,), 1.25,
              title=title if i == 0 else "")
        for i, signal in enumerate(signals)
    )  # fmt: skip
    return TimeSeries(np.asarray(record.time), panels, record.data_hash, legend=False)


def validation_figure(result: Validation, record: int = 0) -> Any:
    """Free run against the measurement, and its error, two panels for each output.

    Args:
        result: of `validate`; without its records only the free run is drawn.
        record: which of the records is drawn.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    runs = validation_runs((result, "free run"), record=record)
    return time_series_figure(free_run_series(runs))
