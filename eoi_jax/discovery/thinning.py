"""Signals along a record averaged as the r-th difference sees them, and thinned to a band."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def thinning(step: float) -> Float[np.ndarray, "factor 4"]:
    """Cubic B-splines over the samples between two nodes, four nodes to a band's quarter period.

    A power of two, so that records of many bands share their compiled kernels.
    """
    factor = 2 ** max(int(np.floor(np.log2(max(np.pi / (4.0 * step), 1.0)))), 0)
    x = (np.arange(factor) + 0.5) / factor
    parts = [(1.0 - x) ** 3, 3.0 * x**3 - 6.0 * x**2 + 4.0, 1.0 + 3.0 * x * (1.0 + x - x**2), x**3]
    return np.stack(parts, axis=1) / 6.0


def thinned(values: Any, weight: Any, kernel: Any) -> Any:
    """Weighted signals (last axis: samples) on coarse nodes, by cubic B-splines.

    Measurement noise above the band, which differences raise as ω^2r, is damped as ω^-8.

    NumPy's arrays stay with NumPy: XLA would compile every operation for every length of record.
    """
    xp = jnp if isinstance(values, jax.Array) else np
    factor = kernel.shape[0]
    weighted = values * weight
    before = [(0, 0)] * (weighted.ndim - 1)
    padded = xp.pad(weighted, [*before, (0, -weighted.shape[-1] % factor)])
    blocks = padded.reshape(*padded.shape[:-1], -1, factor) @ kernel
    shifted = [xp.pad(blocks[..., i], [*before, (i, 3 - i)]) for i in range(4)]
    return shifted[0] + shifted[1] + shifted[2] + shifted[3]


def averaging(degree: int) -> Float[np.ndarray, " taps"]:
    """Weights of f in the middles of steps that the r-th difference of y averages over.

    The B-spline of order r has the variance r/12 (in steps); binomial weights corrected to that
    variance are exact to fourth order in h.
    """
    binomial = np.ones(1)
    for _ in range(degree - 1):
        binomial = np.convolve(binomial, [0.5, 0.5])
    c = ((degree - 1) / 4.0 - degree / 12.0) / 2.0
    return np.convolve(binomial, [-c, 1.0 + 2.0 * c, -c])


def averaged(degree: int, values: Array | np.ndarray) -> Any:
    """Moving average of signals (last axis: steps) as the r-th difference sees them."""
    taps = averaging(degree)
    size = values.shape[-1] - len(taps) + 1
    return sum(tap * values[..., i : i + size] for i, tap in enumerate(taps))  # type: ignore
