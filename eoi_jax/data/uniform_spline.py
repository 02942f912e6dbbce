r"""Interpolating splines of evenly spaced samples, at the same places of every step.

On even knots all steps share their weights. With the coefficients c of a spline of odd degree k and
the cardinal B-spline B of that degree, which lives on [0, k + 1], the value at the fraction f of
step j is

$$s(j + f) = \sum_{i=0}^{k} B(f + k - i)\; c_{j + i - (k-1)/2}$$

The samples determine c but for k − 1 modes, $z^j$ and $z^{-j}$ with the (k − 1)/2 poles z of the
interpolating filter. They are fixed by the not-a-knot condition: (k − 1)/2 knots next to each end
are dropped, where the k-th derivative, and so the difference of c of order k + 1, has no jump.

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


def within_steps(
    samples: Float[np.ndarray, "time channel"], fractions: Float[np.ndarray, " places"], degree: int
) -> Float[np.ndarray, "steps places channel"]:
    """The spline through all samples, not-a-knot: polynomials up to its degree are reproduced.

    Args:
        samples: evenly spaced.
        fractions: positions within each step, from 0 to 1.
        degree: 1, 3 or 5; reduced to the next lower odd degree where there are too few samples.
    """
    count, channels = samples.shape
    k = max(odd for odd in (1, 3, 5) if odd <= min(degree, count - 1))
    coefficients = samples if k == 1 else _coefficients(samples, k)
    windows = np.lib.stride_tricks.sliding_window_view(coefficients, k + 1, axis=0)
    # Copied into rows: a single matrix product instead of one for each step.
    values = np.reshape(windows, (-1, k + 1)) @ _weights(fractions, k)
    return np.moveaxis(values.reshape(count - 1, channels, len(fractions)), 1, 2)


def _coefficients(
    samples: Float[np.ndarray, "time channel"], degree: int, decay: int = 64
) -> Float[np.ndarray, "coefficients channel"]:
    """c, from (k − 1)/2 samples before the first to (k − 1)/2 after the last.

    `decay` is the number of samples from an end at which a mode has decayed to nothing.
    """
    from scipy.ndimage import spline_filter1d  # 0.1 s of import

    margin = (degree - 1) // 2
    inner = spline_filter1d(samples, degree, axis=0, mode="mirror")
    extended = np.concatenate([inner[margin:0:-1], inner, inner[-2 : -2 - margin : -1]])
    modes, reach = np.zeros((len(extended), 2 * margin)), min(len(extended), decay)
    modes[:reach, :margin] = np.asarray(_POLES[degree]) ** np.arange(reach)[:, None]
    modes[:, margin:] = modes[::-1, :margin]
    ends = np.r_[: degree + 1 + margin], np.r_[-degree - 1 - margin : 0]
    jumps = [
        np.diff(np.stack([rows[end] for end in ends]), degree + 1, axis=1).reshape(2 * margin, -1)
        for rows in (modes, extended)
    ]
    return extended - modes @ np.linalg.solve(*jumps)


def _weights(
    fractions: Float[np.ndarray, " places"], degree: int
) -> Float[np.ndarray, "weights places"]:
    """B(f + k - i), by the recursion over the degree."""
    weights = np.ones((1, len(fractions)))
    for k in range(1, degree + 1):
        i, zeros = np.arange(k + 1)[:, None], np.zeros((1, len(fractions)))
        rising = (fractions + k - i) * np.concatenate([zeros, weights])
        weights = (rising + (1.0 + i - fractions) * np.concatenate([weights, zeros])) / k
    return weights
