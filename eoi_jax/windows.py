"""Short free runs, whose initial state is estimated anew: how long they are."""

from collections.abc import Sequence

from eoi_jax.data.record import Record

_SHARE = 0.1  # of the shortest record


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
