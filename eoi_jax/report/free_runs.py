"""Free runs against the measurement, with their errors, and the detail where these are largest."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from eoi_jax._types import Mask
from eoi_jax.data.cleaning import is_slow
from eoi_jax.data.record import Record
from eoi_jax.report.style import ACCENT, BASE, with_unit
from eoi_jax.report.time_series import Panel, Signal, TimeSeries
from eoi_jax.simulation.validation import Validation


class Run(NamedTuple):
    """A free run with its label and the number of its colour."""

    outputs: Float[np.ndarray, "time ny"]
    colour: int
    label: str


@dataclass(frozen=True)
class FreeRuns:
    """Free runs of one or several models along a record.

    Attributes:
        record: the measurement; of a result without its records the prediction.
        runs: outputs (N, ny) of each, the answer last.
        outputs: names.
        units: by name.
        title: label of the record.
        measured: whether the outputs of the record are measurements.
    """

    record: Record
    runs: tuple[Run, ...]
    outputs: tuple[str, ...]
    units: dict[str, str]
    title: str
    measured: bool = True


def validation_runs(*results: tuple[Validation, str], record: int = 0) -> FreeRuns:
    """The free runs of one or several validations on the same records.

    Args:
        results: of `validate`, each with its label; the answer last.
        record: which of the records.
    """
    last = results[-1][0]
    runs = tuple(
        Run(result.predictions[record].known_outputs, BASE + i, label)
        for i, (result, label) in enumerate(results)
    )
    measured = last.records[record] if last.records else None
    reference = measured or last.predictions[record]
    units = dict(zip(last.outputs, last.units, strict=True))
    return FreeRuns(reference, runs, last.outputs, units, reference.name, measured is not None)


def free_run_series(content: FreeRuns, max_range: float = 3.0) -> TimeSeries:
    """Free runs over the measurement, and below each output their errors.

    Args:
        content: the runs.
        max_range: half ranges of the measurement to which the panels are clipped: a run that
            diverges must not flatten the other curves.
    """
    panels = []
    for j, name in enumerate(content.outputs):
        unit = content.units.get(name)
        mask = content.record.output_valid[:, j] & content.measured
        y = np.where(mask, content.record.outputs[:, j], np.nan)
        slow = is_slow(mask)  # no line: few samples have a neighbour
        courses = [run.outputs[:, j] for run in content.runs]
        if slow:
            courses = [_joined(course, content.record.input_valid) for course in courses]
        runs = [
            Signal(run.label, course, run.colour, 1.0)
            for run, course in zip(content.runs, courses, strict=True)
        ]
        errors = [
            Signal(run.label, y - run.outputs[:, j], run.colour, dots=slow) for run in content.runs
        ]
        upper_limits = lower_limits = None
        if np.any(mask):
            runs.insert(0, Signal("measured", y, None, 2.0, dots=slow))
            mean = float(np.nanmean(y))
            size = max_range * float(np.nanmax(np.abs(y - mean)))
            size = max(size, _reach_beyond(courses[-1], mask, mean))
            if size > 0:  # of a constant measurement nothing is clipped
                upper_limits, lower_limits = (mean - size, mean + size), (-size, size)
        panels += [
            Panel(with_unit(name, unit), tuple(runs), 1.54, upper_limits),
            Panel(with_unit("error", unit), tuple(errors), 0.96, lower_limits),
        ]
    time = np.asarray(content.record.time)
    return TimeSeries(time, tuple(panels), content.record.data_hash, f"time [s], {content.title}")


def prediction_series(record: Record) -> TimeSeries:
    """Predicted outputs of a simulation, and the inputs that drive it below them, a panel each.

    Args:
        record: of `simulate`.
    """
    signals = [Signal("predicted", channel, BASE, 1.0) for channel in record.outputs.T]
    signals += [
        Signal("input", channel, ACCENT, held=hold == "zero")
        for channel, hold in zip(record.inputs.T, record.holds, strict=True)
    ]
    names = (*record.output_names, *record.input_names)
    panels = tuple(
        Panel(with_unit(name, record.units.get(name)), (signal,), 1.25)
        for name, signal in zip(names, signals, strict=True)
    )
    label = f"time [s], {record.name}"
    return TimeSeries(np.asarray(record.time), panels, record.data_hash, label, legend=False)


def _reach_beyond(course: Float[np.ndarray, " time"], measured: Mask, mean: float) -> float:
    """How far a run goes from a level before the first and behind the last measured sample.

    There it is a prediction only, and no measurement is flattened by it.
    """
    (samples,) = np.nonzero(measured)
    tails = np.concatenate([course[: samples[0]], course[samples[-1] + 1 :]])
    distances = np.abs(tails[np.isfinite(tails)] - mean)
    return float(np.max(distances, initial=0.0))


def _joined(course: Float[np.ndarray, " time"], simulated: Mask) -> Float[np.ndarray, " time"]:
    """Straight lines between the values of a run that is known at samples only, no run between.

    Args:
        course: of an output; NaN where it was not measured.
        simulated: where all inputs are known: elsewhere no run goes on.
    """
    (samples,) = np.nonzero(np.isfinite(course))
    if not samples.size:
        return course
    place = np.arange(len(course))
    lines = np.interp(place, samples, course[samples])
    inside = (place >= samples[0]) & (place <= samples[-1]) & simulated
    return np.where(inside, lines, course)


# -- detail -----------------------------------------------------------------------------------


def worst_window(
    content: FreeRuns, duration: float = 1.0, fewest: int = 50, most: int = 1000
) -> slice | None:
    """Samples of the window in which the error of the answer has most power.

    Errors of several outputs are added as shares of the range of the measurement.

    Args:
        content: the runs, the answer last.
        duration: of the window [s].
        fewest: samples of the window, whatever its duration: enough to see a shape.
        most: samples of the window, no more than a panel can show.

    Returns:
        None where no error is known, or where the window would be half of the record.
    """
    size = int(np.clip(round(duration / content.record.sample_period), fewest, most))
    y = content.record.known_outputs
    if not content.measured or 2 * size > len(y):
        return None
    valid = content.record.output_valid
    spread = np.array(
        [
            np.ptp(channel[mask]) if np.any(mask) else 0.0
            for channel, mask in zip(content.record.outputs.T, valid.T, strict=True)
        ]
    )
    relative = (y - content.runs[-1].outputs) / np.where(spread > 0, spread, 1.0)
    finite = np.where(np.isfinite(relative), np.clip(relative, -1e6, 1e6), 0.0)
    power = np.sum(finite**2, axis=1)
    if not np.any(power):
        return None
    total = np.concatenate([[0.0], np.cumsum(power)])
    start = int(np.argmax(total[size:] - total[:-size]))
    return slice(start, start + size)


def worst_series(content: FreeRuns) -> TimeSeries | None:
    """`free_run_series` of the `worst_window`, with every sample; None without such a window."""
    window = worst_window(content)
    if window is None:
        return None
    complete = free_run_series(content)
    panels = tuple(
        replace(
            panel,
            signals=tuple(replace(line, values=line.values[window]) for line in panel.signals),
        )
        for panel in complete.panels
    )
    detail = f"{complete.record} detail"
    return replace(complete, time=complete.time[window], panels=panels, record=detail)


def record_title(record: Record) -> str:
    """``record run 1``; of the default name, and of one that says that it is a record, the name.

    Args:
        record: with its name.
    """
    return record.name if record.name.startswith("record") else f"record {record.name}"
