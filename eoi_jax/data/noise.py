r"""White measurement noise, read off the differences of a record.

The d-th difference of white noise has the variance $\binom{2d}{d}\sigma^2$, and removes the signal
the better the higher d and the faster the sampling. Signal that is left adds to the estimate, so
the smallest over d = 2 … 8 is taken.

**Interpolated samples** are means of their neighbours, and have lost most of the noise at the
highest frequencies, which is what these differences look at; at all others it is still there. So
the differences are compared with those of white noise that went through the same interpolation.

Source: Rice, Ann. Statist. 12 (1984) 1215, with higher differences.
"""

from collections.abc import Sequence
from math import comb

import numpy as np
from jaxtyping import Float

_ORDERS = range(2, 9)

Channels = Float[np.ndarray, "time channel"]


def white_noise(
    values: Channels,
    segments: Sequence[tuple[int, int]],
    passed: Float[np.ndarray, "time 1"] | None = None,
) -> Float[np.ndarray, " channel"]:
    """Standard deviation of the white noise of each channel; zero where no segment has three.

    Args:
        values: one row a sample.
        segments: runs (start, stop) of samples that count.
        passed: noise of standard deviation one that went through the same interpolation; None
            where the samples are as they were measured.
    """
    estimates = []
    for order in _ORDERS:
        power = _power(values, segments, order)
        if power is None:
            continue
        one = comb(2 * order, order) if passed is None else _power(passed, segments, order)
        estimates.append(np.sqrt(power / one))
    return np.min(estimates, axis=0) if estimates else np.zeros(values.shape[1])


def _power(
    values: Channels, segments: Sequence[tuple[int, int]], order: int
) -> Float[np.ndarray, " channel"] | None:
    """Mean square of the differences; None where all segments are shorter than these."""
    pieces = [np.diff(values[first:last], n=order, axis=0) for first, last in segments]
    differences = np.concatenate(pieces)
    return np.mean(differences**2, axis=0) if len(differences) else None
