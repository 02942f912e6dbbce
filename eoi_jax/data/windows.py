"""Where free runs start and end, what of them is scored, and how long short ones are."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.data.masks import transient_samples
from eoi_jax.data.record import Record

_SHARE = 0.1  # of the shortest record
_HALF = 0.5  # of the most valid samples that any start has: with fewer a run starts later


def window_length(records: Sequence[Record], fewest: int) -> float | None:
    """A tenth of the shortest record, and samples enough of the most coarsely sampled one.

    In seconds: records of one set may have different sample periods.

    Args:
        records: that are run through.
        fewest: samples of a window, at least.

    Returns:
        Length of a window [s]; None where that is more than half of the shortest record.
    """
    shortest = min(records, key=lambda one: len(one) * one.sample_period)
    period = shortest.sample_period
    coarsest = max(one.sample_period for one in records)
    window = max(round(_SHARE * len(shortest)) * period, fewest * coarsest)
    return None if window > len(shortest) // 2 * period else window


@dataclass(frozen=True)
class Plan:
    """The free runs along one record, all of the same number of steps.

    Attributes:
        starts: sample at which each run starts.
        shown: samples of the record that it predicts.
        steps: of each run; one that starts late goes on beyond what it predicts.
        score: samples that count, valid or not.
        most, need: valid samples that the best start has, and that a start must have.
        late, lost: windows that start later, or not at all, for want of valid samples.
    """

    starts: tuple[int, ...]
    shown: tuple[range, ...]
    steps: int
    score: Bool[np.ndarray, " time"]
    most: int
    need: int
    late: int
    lost: int


def plan(record: Record, initial_samples: int, window: float | None, least: int) -> Plan:
    """Runs along a record, one or one a window.

    The state at a start is estimated from the valid ones of its first samples. Where too few of
    them are, the run starts at the next valid sample from which enough are; where its window has
    none, there is no run.

    Args:
        record: to run through.
        initial_samples: from which a state is estimated; they are not scored.
        window: length of each run [s]; None for one run.
        least: valid samples that a state needs.
    """
    total = len(record)
    count = total - 1 if window is None else min(round(window / record.sample_period), total - 1)
    head = min(initial_samples, count + 1)
    known = np.concatenate([[0], np.cumsum(record.valid)])
    seen = known[head:] - known[:-head]  # from each sample on
    most = int(np.max(seen))
    need = max(int(np.ceil(_HALF * most)), least)
    later = (seen >= need) & record.valid[: len(seen)]
    starts, shown, late, lost, score = [], [], 0, 0, np.zeros(total, dtype=bool)
    for first in range(0, total - 1, count):
        # The last window reaches back, so that all have one length and run together.
        start = min(first, total - 1 - count)
        # A window ends before the first sample of the next one; the last one has its own end.
        stop = start + count + (start + count == total - 1)
        if seen[start] < need:
            (places,) = np.nonzero(later[start : max(stop - head, start)])
            if not len(places):
                lost += 1
                continue
            late, start = late + 1, start + int(places[0])
        starts.append(start)
        shown.append(range(max(first, start), stop))
        score[max(first, start + initial_samples) : stop] = True
    score[: max(initial_samples, transient_samples(record))] = False
    return Plan(tuple(starts), tuple(shown), count, score, most, need, late, lost)


def late_starts(record: Record, runs: Plan, initial_samples: int, whole: bool) -> list[str]:
    """What is not scored because a state cannot be estimated where a run should start."""
    few = f"fewer than {runs.need} of the first {initial_samples} samples are valid"
    if whole and runs.late:
        begun = record.time[runs.starts[0]]
        return [f"The free run on {record.name} starts at t = {begun:g} s: before, {few}."]
    count, told = len(runs.starts) + runs.lost, []
    if runs.late:
        told.append(f"{runs.late} of {count} windows on {record.name} start late: at first {few}.")
    if runs.lost:
        told.append(f"{runs.lost} of {count} windows on {record.name} are not scored: {few}.")
    return told


def joined(
    values: Float[np.ndarray, "time ny"], known: Bool[np.ndarray, " time"]
) -> Float[np.ndarray, "time ny"]:
    """Straight lines over samples that no run predicts, so that what is shown is finite there."""
    if known.all() or not known.any():
        return values
    index = np.arange(len(values))
    lines = [np.interp(index, index[known], one[known]) for one in values.T]
    return np.where(known[:, None], values, np.stack(lines, axis=1))
