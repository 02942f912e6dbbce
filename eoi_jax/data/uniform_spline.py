r"""Interpolating splines of evenly spaced samples, at the same places of every step.

On even knots all steps share their weights. With the coefficients c of a spline of odd degree k and
the cardinal B-spline B of that degree, which lives on [0, k + 1], the value at the fraction f of
step j is

$$s(j + f) = \sum_{i=0}^{k} B(f + k - i)\; c_{j + i - (k-1)/2}$$

The samples fix c but for k − 1 modes, $z^j$ and $z^{-j}$ with the (k − 1)/2 poles z of the filter
that interpolates; so many knots beside each end are left out (not-a-knot), where the k-th
derivative, and with it the difference of c of order k + 1, then has no jump.

Sources: C. de Boor, *A Practical Guide to Splines* (1978), chapters IX and X; M. Unser, IEEE Signal
Processing Magazine 16 (1999) 22 (filter and poles).
"""

import numpy as np
from jaxtyping import Float

_POLES = {
    3: (np.sqrt(3.0) - 2.0,),
    5: tuple(
        np.sqrt(67.5 + sign * np.sqrt(4436.25)) - sign * np.sqrt(26.25) - 6.5 for sign in (-1, 1)
    ),
}
_FAR = 64  # samples from an end at which nothing is left of a mode


def within_steps(
    samples: Float[np.ndarray, "time channel"], fractions: Float[np.ndarray, " places"], degree: int
) -> Float[np.ndarray, "steps places channel"]:
    """The spline through all samples, not-a-knot: polynomials up to its degree are reproduced.

    Args:
        samples: evenly spaced.
        fractions: of each step, from 0 to 1.
        degree: 1, 3 or 5; the next lower odd one that so few samples allow.
    """
    count, channels = samples.shape
    k = max(one for one in (1, 3, 5) if one <= min(degree, count - 1))
    coefficients = samples if k == 1 else _coefficients(samples, k)
    windows = np.lib.stride_tricks.sliding_window_view(coefficients, k + 1, axis=0)
    # Copied into rows: one product of two matrices, not one for each step.
    values = np.reshape(windows, (-1, k + 1)) @ _weights(fractions, k)
    return np.moveaxis(values.reshape(count - 1, channels, len(fractions)), 1, 2)


def _coefficients(
    samples: Float[np.ndarray, "time channel"], degree: int
) -> Float[np.ndarray, "coefficients channel"]:
    """c, from (k − 1)/2 before the first sample to as many behind the last."""
    from scipy.ndimage import spline_filter1d  # 0.1 s of import

    more = (degree - 1) // 2
    inner = spline_filter1d(samples, degree, axis=0, mode="mirror")
    whole = np.concatenate([inner[more:0:-1], inner, inner[-2 : -2 - more : -1]])
    modes, near = np.zeros((len(whole), 2 * more)), min(len(whole), _FAR)
    modes[:near, :more] = np.asarray(_POLES[degree]) ** np.arange(near)[:, None]
    modes[:, more:] = modes[::-1, :more]
    ends = np.r_[: degree + 1 + more], np.r_[-degree - 1 - more : 0]
    jumps = [np.diff(np.stack([one[end] for end in ends]), degree + 1, axis=1).reshape(2 * more, -1)
             for one in (modes, whole)]  # fmt: skip
    return whole - modes @ np.linalg.solve(*jumps)


def _weights(
    fractions: Float[np.ndarray, " places"], degree: int
) -> Float[np.ndarray, "weights places"]:
    """B(f + k - i), by the recursion over the degree."""
    weights = np.ones((1, len(fractions)))
    for k in range(1, degree + 1):
        i, none = np.arange(k + 1)[:, None], np.zeros((1, len(fractions)))
        rising = (fractions + k - i) * np.concatenate([none, weights])
        weights = (rising + (1.0 + i - fractions) * np.concatenate([weights, none])) / k
    return weights
