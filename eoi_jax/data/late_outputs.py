"""Outputs that were logged late beside the others: two loggers, clocks, or a filter on one channel.

A free run shows it: the measurement of such an output follows its simulation by the same time
everywhere, while the other outputs follow theirs at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_choice, real
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import fill, runs
from eoi_jax.data.uniform_spline import within_steps


@dataclass(frozen=True)
class LateOutputSettings:
    """When an output is said to be late.

    Attributes:
        longest: time by which it may be, to either side [sample periods].
        shortest_record: length of a record over that time, at least.
        ratio: of its error where the run is shifted to that without a shift, at most.
        noise: its error over the noise of its sensor, from which on it is asked.
        least: time that is one [sample periods].
        share: of the time, by which those of both halves may differ, and those of other outputs be
            off none.
        rounding: distance from a whole number of samples that is none.
        most: samples of a record that are compared, about.
    """

    longest: int = 64
    shortest_record: int = 10
    ratio: float = 0.5
    noise: float = 1.5
    least: float = 0.5
    share: float = 0.25
    rounding: float = 0.05
    most: int = 10_000


_SETTINGS = LateOutputSettings()


def without_lateness(record: Record, late: Mapping[str, Any]) -> Record:
    """The record with outputs moved to when they were so, with a note for each.

    By whole samples values stay as they are; between samples a spline of degree five gives them.
    Samples that come from beyond the ends of the record are missing.

    Args:
        record: on its uniform grid.
        late: ``{output: time}`` by which it was logged late, negative for early [s].

    Raises:
        ValueError: a name that is no output of the record, a time that is not finite or as long as
            the record.
    """
    values, notes = record.known_outputs.copy(), []
    for name, time in late.items():
        check_choice("late", name, record.output_names)
        steps = real(time) / record.sample_period
        rule = f"must be a time shorter than the record, {record.time[-1] - record.time[0]:.6g} s"
        check(bool(abs(steps) < len(record) - 1), f"late[{name}]", rule, time)
        j = record.output_names.index(name)
        values[:, j] = _shifted(values[:, j], steps)
        is_shift = abs(steps - round(steps)) < 1e-6
        source = "" if is_shift else ", with values from a spline between its samples"
        notes.append(f"`{name}` moved to {real(time):.6g} s earlier{source}.")
    if not notes:
        return record
    measured = np.isfinite(values)
    position = np.arange(len(record), dtype=float)
    new = record._changed(" ".join(notes))
    masks = np.all(measured, axis=1) & record.input_valid, record.input_valid, measured
    new._set(record.inputs, fill(position, values, position), masks, record.time,
             record.sample_period)  # fmt: skip
    return new


def _shifted(values: Float[np.ndarray, " time"], steps: float) -> Float[np.ndarray, " time"]:
    """Values at `steps` samples later, NaN where there are none.

    Args:
        values: NaN where they were not measured.
        steps: any number of samples.
    """
    first = int(np.floor(steps + 1e-6))
    fraction = max(steps - first, 0.0)
    if fraction > 1e-6:
        splined = np.full(len(values), np.nan)
        for start, stop in runs(np.isfinite(values)):
            if stop - start > 1:
                part = within_steps(values[start:stop, None], np.array([fraction]), degree=5)
                splined[start : stop - 1] = part[:, 0, 0]
        values = splined
    index = np.arange(len(values)) + first
    inside = (index >= 0) & (index < len(values))
    return np.where(inside, values[np.clip(index, 0, len(values) - 1)], np.nan)


def late_output_notes(
    records: Sequence[Record],
    residual: Sequence[Float[np.ndarray, "time ny"]],
    labels: Sequence[str],
) -> tuple[str, ...]:
    """A sentence for each output that seems to be logged late; arguments as for `late_outputs`."""
    notes = []
    for label, (time, ratio) in late_outputs(records, residual, labels).items():
        word = "late" if time > 0.0 else "early"
        notes.append(_LATE.format(label, word, f"{abs(time):.3g}", f"{time:.3g}", ratio))
    return tuple(notes)


@np.errstate(over="ignore", invalid="ignore")  # of runs that diverge
def late_outputs(
    records: Sequence[Record],
    residual: Sequence[Float[np.ndarray, "time ny"]],
    labels: Sequence[str],
) -> dict[str, tuple[float, float]]:
    """Outputs that their free runs lead by the same time, where others do not.

    The time must be the same in both halves of the records: a wrong period of an oscillation moves
    the runs as well, but more and more. It must be no other output's: else the inputs were early,
    or the plant is slower.

    Args:
        records: measured.
        residual: of free runs along them, y - ŷ, NaN where not scored.
        labels: of the outputs.

    Returns:
        By output the time by which it was logged late [s], negative for early, and its error with
        the run moved by that over its error without.
    """
    if len(labels) < 2:
        return {}
    shortest = min(len(record) for record in records)
    longest = min(_SETTINGS.longest, shortest // _SETTINGS.shortest_record)
    period = min(record.sample_period for record in records)
    noise = np.max([record.noise for record in records], axis=0)
    shifted = [_shifted_errors(records, residual, j, longest) for j in range(len(labels))]
    totals = np.array([_lateness(np.sum(parts, axis=0), longest) for parts in shifted])
    late = {}
    for j, parts in enumerate(shifted):
        powers = np.sum(parts, axis=0)
        ratio = float(np.sqrt(np.min(powers) / max(powers[longest], _TINY)))
        errors = np.concatenate([part[:, j] for part in residual])
        error = np.sqrt(np.nansum(errors**2) / max(np.count_nonzero(np.isfinite(errors)), 1))
        # A start that both outputs share is wrong for both: it tells in the first half.
        halves = np.array([_lateness(part, longest) for part in parts])
        steps = halves[np.argmin(np.min(parts, axis=1))]
        tolerance = max(_SETTINGS.least, _SETTINGS.share * abs(steps))
        if (
            ratio <= _SETTINGS.ratio
            and error > _SETTINGS.noise * noise[j]
            and _SETTINGS.least < abs(steps) < np.inf
            and np.max(np.abs(halves - steps)) <= tolerance
            and np.max(np.abs(np.delete(totals, j))) <= tolerance
        ):
            late[labels[j]] = float(steps) * period, ratio
    return late


_LATE = (
    "{0} seems to be logged {1} by {2} s beside the other outputs: moved by that, free runs have "
    "{4:.2g} of its error. A second logger, a clock or a filter of its own may do this: then read "
    "it with `late = {{ {0} = {3} }}`"
)
_TINY = float(np.finfo(float).tiny)


def _shifted_errors(
    records: Sequence[Record],
    residual: Sequence[Float[np.ndarray, "time ny"]],
    j: int,
    longest: int,
) -> Float[np.ndarray, "halves shifts"]:
    """Sums of squared errors of both halves of the records, with an output at other samples.

    Args:
        records: measured.
        residual: of free runs along them.
        j: the output.
        longest: shift to either side [samples].
    """
    powers = np.zeros((2, 2 * longest + 1))
    for record, error in zip(records, residual, strict=True):
        measured = record.known_outputs[:, j]
        run = measured - error[:, j]
        stride = max(len(record) // _SETTINGS.most, 1)
        inner = np.arange(longest, len(record) - longest, stride)
        for i in range(2 * longest + 1):
            square = (measured[inner + i - longest] - run[inner]) ** 2
            powers[:, i] += [np.nansum(half) for half in np.array_split(square, 2)]
    return powers


def _lateness(powers: Float[np.ndarray, " shifts"], longest: int) -> float:
    """Shift of the least error, by a parabola between the samples [samples]; at an end infinite."""
    best = int(np.argmin(powers))
    if best in (0, 2 * longest):
        return np.inf
    low, middle, high = powers[best - 1 : best + 2]
    steps = best - longest + 0.5 * (low - high) / max(low - 2.0 * middle + high, _TINY)
    return float(round(steps) if abs(steps - round(steps)) < _SETTINGS.rounding else steps)
