r"""White measurement noise, estimated from the differences of a record; steps of its values.

The d-th difference of white noise has the variance $\binom{2d}{d}\sigma^2$. It suppresses the
signal better at a higher d and a higher sampling rate. Remaining signal increases the estimate, so
the smallest estimate over d = 2 … 8 is taken.

**Interpolated samples** are means of their neighbours. They have lost most of the noise at the
highest frequencies, which dominate these differences, but not at lower ones. So their differences
are compared with those of white noise that was interpolated in the same way.

Source: Rice, Ann. Statist. 12 (1984) 1215, with higher differences.
"""

from collections.abc import Sequence
from math import comb

import numpy as np
from jaxtyping import Bool, Float

_ORDERS = range(2, 9)

Channels = Float[np.ndarray, "time channel"]


def white_noise(
    values: Channels,
    segments: Sequence[tuple[int, int]],
    passed: Float[np.ndarray, "time 1"] | None = None,
    degrees: float = 0.0,
) -> Float[np.ndarray, " channel"]:
    """Standard deviation of the white noise of each channel; zero where no segment has three.

    Args:
        values: one row a sample.
        segments: runs (start, stop) of valid samples.
        passed: white noise of standard deviation 1, interpolated like the samples; None where the
            samples are as measured.
        degrees: of freedom, of the differences of an order, from which on it counts; the lowest
            order always does. Of few differences the smallest mean square is small by chance.
    """
    estimates = []
    for order in _ORDERS:
        power = _power(values, segments, order)
        if power is None or (estimates and _degrees(segments, order) < degrees):
            continue
        unit_power = comb(2 * order, order) if passed is None else _power(passed, segments, order)
        estimates.append(np.sqrt(power / unit_power))
    return np.min(estimates, axis=0) if estimates else np.zeros(values.shape[1])


def _power(
    values: Channels, segments: Sequence[tuple[int, int]], order: int
) -> Float[np.ndarray, " channel"] | None:
    """Mean square of the differences; None where all segments are too short for this order."""
    pieces = [np.diff(values[first:last], n=order, axis=0) for first, last in segments]
    differences = np.concatenate(pieces)
    return np.mean(differences**2, axis=0) if len(differences) else None


def _degrees(segments: Sequence[tuple[int, int]], order: int) -> float:
    r"""Degrees of freedom of the mean square of n differences of white noise.

    n over $1 + 2\sum_k \rho_k^2 = \binom{4d}{2d}/\binom{2d}{d}^2$, with their autocorrelation
    $\rho_k = (-1)^k \binom{2d}{d+k}/\binom{2d}{d}$.
    """
    count = sum(max(stop - start - order, 0) for start, stop in segments)
    return count * comb(2 * order, order) ** 2 / comb(4 * order, 2 * order)


def quanta(
    values: Channels, measured: Bool[np.ndarray, "time channel"]
) -> Float[np.ndarray, " channel"]:
    """Step of the values of each channel; 0 if they are not multiples of one step.

    Args:
        values: one row a sample.
        measured: which of them count.
    """
    pairs = zip(values.T, measured.T, strict=True)
    return np.asarray([_quantum(channel[mask]) for channel, mask in pairs])


def _quantum(values: Float[np.ndarray, " samples"]) -> float:
    levels = np.unique(values)
    steps = np.diff(levels)
    # Rounding splits a level into several nearly equal values; their differences are no steps.
    steps = steps[steps > 1e-9 * np.max(np.abs(levels), initial=0.0)]
    if not steps.size:
        return 0.0
    ratio = steps / steps.min()
    return float(steps.min()) if np.all(np.abs(ratio - np.rint(ratio)) < 0.05) else 0.0
