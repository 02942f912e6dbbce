"""Plan of free runs along a record: windows, starts, and the samples that are scored."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import counted, is_or_are, timed
from eoi_jax.data.masks import transient_samples
from eoi_jax.data.record import Record


def window_length(records: Sequence[Record], fewest: int, share: float = 0.1) -> float | None:
    """A share of the shortest record, but at least `fewest` samples of the coarsest record.

    The length is in seconds, as records of one data set may have different sample periods.

    Args:
        records: the data set.
        fewest: smallest number of samples of a window.
        share: of the shortest record; a free run over a tenth of it drifts little.

    Returns:
        Length of a window [s]; None where that is more than half of the shortest record.
    """
    shortest = min(records, key=lambda record: len(record) * record.sample_period)
    period = shortest.sample_period
    coarsest = max(record.sample_period for record in records)
    window = max(round(share * len(shortest)) * period, fewest * coarsest)
    return None if window > len(shortest) // 2 * period else window


@dataclass(frozen=True)
class Plan:
    """The free runs along one record, all of the same number of steps.

    Attributes:
        starts: sample at which each run starts.
        predicted: samples of the record that each run predicts.
        steps: number of steps of each run; a late run continues past its predicted samples.
        score: samples that are scored, valid or not.
        available, need: largest number of valid samples of an output at any start, and number
            required, of the output with the fewest.
        late, lost: windows that start late, or not at all, for lack of valid samples.
        head: samples from which a state is estimated.
    """

    starts: tuple[int, ...]
    predicted: tuple[range, ...]
    steps: int
    score: Bool[np.ndarray, " time"]
    available: int
    need: int
    late: int
    lost: int
    head: int


def plan(
    record: Record,
    initial_samples: int,
    window: float | None,
    required: int,
    valid_share: float = 0.5,
) -> Plan:
    """Free runs along a record: a single one, or one for each window.

    The state at a start is estimated from the valid ones of the first `initial_samples` samples. A
    run with too few of them of any output starts at the next valid sample that has enough; a window
    without such a sample has no run.

    Args:
        record: along which the runs are planned; its inputs are known throughout (`driven_parts`).
        initial_samples: number from which a state is estimated; they are not scored.
        window: length of each run [s]; None for a single run.
        required: number of valid samples that a state needs.
        valid_share: of the most valid samples at any start; a run with fewer starts later.
    """
    total = len(record)
    count = total - 1 if window is None else min(round(window / record.sample_period), total - 1)
    head = min(initial_samples, count + 1)
    valid_count = np.cumsum(record.output_valid, axis=0)
    valid_count = np.concatenate([np.zeros_like(valid_count[:1]), valid_count])
    valid_by_output = valid_count[head:] - valid_count[:-head]  # of the next `head` samples
    most = np.max(valid_by_output, axis=0)
    needs = np.maximum(np.ceil(valid_share * most).astype(int), required)
    fewest = int(np.argmin(most - needs))
    available, need = int(most[fewest]), int(needs[fewest])
    sufficient = np.all(valid_by_output >= needs, axis=1)
    possible = sufficient & np.any(record.output_valid[: len(sufficient)], axis=1)
    starts, predicted, late, lost, score = [], [], 0, 0, np.zeros(total, dtype=bool)
    for first in range(0, total - 1, count):
        # The last window reaches back, so that all have the same length and run together.
        start = min(first, total - 1 - count)
        # A window ends before the first sample of the next; the last includes the last sample.
        stop = start + count + (start + count == total - 1)
        if not sufficient[start]:
            (offsets,) = np.nonzero(possible[start : max(stop - head, start)])
            if not len(offsets):
                lost += 1
                continue
            late, start = late + 1, start + int(offsets[0])
        starts.append(start)
        predicted.append(range(max(first, start), stop))
        score[max(first, start + initial_samples) : stop] = True
    score[: max(initial_samples, transient_samples(record))] = False
    return Plan(tuple(starts), tuple(predicted), count, score, available, need, late, lost, head)


def steps_between_samples(records: Sequence[Record]) -> float:
    """Steps of the grid from a sample to the next of the output that is measured most often.

    Args:
        records: the data set.

    Returns:
        At least 1: what it is where some output is measured at every step.
    """
    periods = [np.min(record.output_periods) / record.sample_period for record in records]
    return max(1.0, float(np.max(np.round(periods, 6))))


def start_samples(record: Record, required: int, usual: int = 50, share: float = 1 / 3) -> int:
    """Samples from which the state at the start of a run is estimated.

    Args:
        record: along which the run is.
        required: samples of each output that a state needs.
        usual: so many samples where the record is long enough.
        share: of a short record, or of its longest part with known inputs.

    Returns:
        `usual`, less in a short record, but three times as many as are required and three; on a
        grid that is finer than the samples, the steps in which there are so many, also where they
        lie closer together at the start; more where an output is measured so rarely that fewer than
        one more than the required ones would lie among them.
    """
    longest = max((stop - start for start, stop in record.input_segments()), default=len(record))
    step = steps_between_samples([record])
    count = step * min(usual, max(int(share * longest / step), 3 * required + 3))
    periods = np.round(record.output_periods / record.sample_period, 6)
    count = max(count, (required + 1) * np.max(periods))
    ends = [
        steps_behind(valid, min(usual, max(int(share * np.sum(valid)), 3 * required + 3)))
        for valid in record.output_valid.T
    ]
    return int(np.ceil(min(count, max(ends))))


def steps_behind(valid: Bool[np.ndarray, " time"], count: int) -> int:
    """Steps of the grid up to the sample that follows so many; all where no more are measured.

    Args:
        valid: where an output was measured.
        count: of its samples.
    """
    (places,) = np.nonzero(valid)
    return int(places[count]) if count < len(places) else len(valid)


def driven_parts(record: Record, shortest: int = 2) -> list[tuple[int, Record]]:
    """Parts of a record in which all inputs are known, with the first sample of each.

    Nothing is simulated on inputs that nobody has measured: each part is a record of its own.

    Args:
        record: any; itself where its inputs are known throughout.
        shortest: samples of a part that is worth a run; others are left out.
    """
    segments = record.input_segments()
    if segments == [(0, len(record))]:
        return [(0, record)]
    return [
        (start, record.part(start, stop)) for start, stop in segments if stop - start >= shortest
    ]


def restart_notes(record: Record, parts: int, shortest: int) -> list[str]:
    """A note on runs that start again behind gaps in the inputs, and on what is too short for one.

    Args:
        record: along which the runs are.
        parts: number of parts with a run.
        shortest: samples of a part that is long enough for one.
    """
    segments = record.input_segments()
    if segments == [(0, len(record))]:
        return []
    unscored = len(segments) - parts
    text = f"Inputs of {record.name} are unknown in gaps, behind which free runs start again: "
    text += f"{counted(parts, 'part')} with a start of "
    text += "its own" if parts == 1 else "their own"
    if unscored:
        text += f"; {counted(unscored, 'other')} {is_or_are(unscored)} not scored, shorter than "
        text += timed(shortest, record.sample_period)
    return [f"{text}."]


def late_starts(record: Record, runs: Plan, initial_samples: int, single: bool) -> list[str]:
    """Notes on samples that are not scored, as no state can be estimated at a planned start."""
    first = timed(initial_samples, record.sample_period)
    reason = f"fewer than {runs.need} of the first {first} are valid"
    if single and runs.late:
        begun = record.time[runs.starts[0]]
        return [f"The free run on {record.name} starts at t = {begun:g} s: before, {reason}."]
    count, notes = len(runs.starts) + runs.lost, []
    if runs.late:
        notes.append(
            f"{runs.late} of {counted(count, 'window')} on {record.name} "
            f"{'starts' if runs.late == 1 else 'start'} late: at first {reason}."
        )
    if runs.lost:
        notes.append(
            f"{runs.lost} of {counted(count, 'window')} on {record.name} {is_or_are(runs.lost)} "
            f"not scored: {reason}."
        )
    return notes


def joined(
    values: Float[np.ndarray, "time ny"], predicted: Bool[np.ndarray, " time"]
) -> Float[np.ndarray, "time ny"]:
    """The values, interpolated linearly over samples that no run predicts."""
    if predicted.all() or not predicted.any():
        return values
    index = np.arange(len(values))
    lines = [np.interp(index, index[predicted], channel[predicted]) for channel in values.T]
    return np.where(predicted[:, None], values, np.stack(lines, axis=1))
