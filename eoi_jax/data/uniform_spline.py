r"""Interpolating splines of evenly spaced samples, at the same places of every step.

On even knots all steps share their weights. With the coefficients c of a spline of odd degree k and
the cardinal B-spline B of that degree, which lives on [0, k + 1], the value at the fraction f of
step j is

$$s(j + f) = \sum_{i=0}^{k} B(f + k - i)\; c_{j + i - (k-1)/2}$$

Knots are left out beside the ends (not-a-knot), where the spline is evaluated one by one.

Source: C. de Boor, *A Practical Guide to Splines* (1978), chapters IX and X.
"""

import numpy as np
from jaxtyping import Float


def within_steps(
    samples: Float[np.ndarray, "time channel"], fractions: Float[np.ndarray, " places"], degree: int
) -> Float[np.ndarray, "steps places channel"]:
    """The spline through all samples, not-a-knot: polynomials up to its degree are reproduced.

    Args:
        samples: evenly spaced.
        fractions: of each step, from 0 to 1.
        degree: 1, 3 or 5; the next lower odd one that so few samples allow.
    """
    from scipy.interpolate import BSpline, make_interp_spline  # 0.2 s of import

    count, channels = samples.shape
    steps, k = count - 1, max(one for one in (1, 3, 5) if one <= min(degree, count - 1))
    spline = make_interp_spline(np.arange(count, dtype=float), samples, k=k)
    out = np.empty((steps, len(fractions), channels))
    # Steps whose knots are even all along the B-splines that reach them.
    first, last = k + (k - 1) // 2, steps - k - (k - 1) // 2
    ends = np.r_[: min(first, steps), max(last, first) : steps] if last > first else np.r_[:steps]
    out[ends] = spline(ends[:, None] + fractions)
    if last > first:
        cardinal = BSpline.basis_element(np.arange(k + 2.0), extrapolate=False)
        weights = np.stack([np.nan_to_num(cardinal(fractions + k - i)) for i in range(k + 1)])
        low = first - (k - 1) // 2
        windows = np.lib.stride_tricks.sliding_window_view(
            spline.c[low : low + last - first + k], k + 1, axis=0
        )
        out[first:last] = np.moveaxis(windows @ weights, 1, 2)
    return out
