"""Plan of free runs along a record: windows, starts, and the samples that are scored."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

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
        available, need: largest number of valid samples at any start, and number required.
        late, lost: windows that start late, or not at all, for lack of valid samples.
    """

    starts: tuple[int, ...]
    predicted: tuple[range, ...]
    steps: int
    score: Bool[np.ndarray, " time"]
    available: int
    need: int
    late: int
    lost: int


def plan(
    record: Record,
    initial_samples: int,
    window: float | None,
    required: int,
    valid_share: float = 0.5,
) -> Plan:
    """Free runs along a record: a single one, or one for each window.

    The state at a start is estimated from the valid ones of the first `initial_samples` samples. A
    run with too few of them starts at the next valid sample that has enough; a window without such
    a sample has no run.

    Args:
        record: along which the runs are planned.
        initial_samples: number from which a state is estimated; they are not scored.
        window: length of each run [s]; None for a single run.
        required: number of valid samples that a state needs.
        valid_share: of the most valid samples at any start; a run with fewer starts later.
    """
    total = len(record)
    count = total - 1 if window is None else min(round(window / record.sample_period), total - 1)
    head = min(initial_samples, count + 1)
    valid_count = np.concatenate([[0], np.cumsum(record.valid)])
    valid_ahead = valid_count[head:] - valid_count[:-head]  # of the next `head` samples
    available = int(np.max(valid_ahead))
    need = max(int(np.ceil(valid_share * available)), required)
    possible = (valid_ahead >= need) & record.valid[: len(valid_ahead)]
    starts, predicted, late, lost, score = [], [], 0, 0, np.zeros(total, dtype=bool)
    for first in range(0, total - 1, count):
        # The last window reaches back, so that all have the same length and run together.
        start = min(first, total - 1 - count)
        # A window ends before the first sample of the next; the last includes the last sample.
        stop = start + count + (start + count == total - 1)
        if valid_ahead[start] < need:
            (offsets,) = np.nonzero(possible[start : max(stop - head, start)])
            if not len(offsets):
                lost += 1
                continue
            late, start = late + 1, start + int(offsets[0])
        starts.append(start)
        predicted.append(range(max(first, start), stop))
        score[max(first, start + initial_samples) : stop] = True
    score[: max(initial_samples, transient_samples(record))] = False
    return Plan(tuple(starts), tuple(predicted), count, score, available, need, late, lost)


def late_starts(record: Record, runs: Plan, initial_samples: int, single: bool) -> list[str]:
    """Notes on samples that are not scored, as no state can be estimated at a planned start."""
    reason = f"fewer than {runs.need} of the first {initial_samples} samples are valid"
    if single and runs.late:
        begun = record.time[runs.starts[0]]
        return [f"The free run on {record.name} starts at t = {begun:g} s: before, {reason}."]
    count, notes = len(runs.starts) + runs.lost, []
    if runs.late:
        notes.append(
            f"{runs.late} of {count} windows on {record.name} start late: at first {reason}."
        )
    if runs.lost:
        notes.append(f"{runs.lost} of {count} windows on {record.name} are not scored: {reason}.")
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
