"""Signals along a record averaged as the r-th difference sees them, and thinned to a band."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_NUMBERS = 131072  # at a time: what is computed on the way stays in the processor's cache


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
    blocks = _blocks(xp, values * weight, kernel)
    before = [(0, 0)] * (blocks.ndim - 2)
    shifted = [xp.pad(blocks[..., i], [*before, (i, 3 - i)]) for i in range(4)]
    return shifted[0] + shifted[1] + shifted[2] + shifted[3]


def averaged_and_thinned(
    values: Callable[[slice], Float[np.ndarray, "*batch part"]],
    batch: tuple[int, ...],
    degree: int,
    weight: Float[np.ndarray, " samples"],
    kernel: Float[np.ndarray, "factor taps"],
) -> Float[np.ndarray, "*batch nodes"]:
    """`thinned` of `averaged` signals that are never there as a whole.

    Args:
        values: the signals at some steps, last axis.
        batch: lengths of the axes before it.
        degree: of the difference that averages.
        weight: of each average.
        kernel: of the thinning.
    """
    factor, beyond = len(kernel), len(averaging(degree)) - 1
    out = np.zeros((*batch, -(-len(weight) // factor) + 3))
    length = max(_NUMBERS // max(math.prod(batch), 1) // factor, 1)  # blocks
    for first in range(0, out.shape[-1] - 3, length):
        steps = slice(first * factor, min((first + length) * factor, len(weight)))
        along = averaged(degree, values(slice(steps.start, steps.stop + beyond)))
        along *= weight[steps]
        blocks = _blocks(np, along, kernel)
        for i in range(4):
            out[..., first + i : first + i + blocks.shape[-2]] += blocks[..., i]
    return out


def _blocks(xp: Any, weighted: Any, kernel: Any) -> Any:
    """What each block of samples adds to the four nodes around it."""
    factor, missing = kernel.shape[0], -weighted.shape[-1] % kernel.shape[0]
    if missing:
        weighted = xp.pad(weighted, [*[(0, 0)] * (weighted.ndim - 1), (0, missing)])
    return weighted.reshape(*weighted.shape[:-1], -1, factor) @ kernel


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
    last, half = len(taps) - 1, len(taps) // 2

    def lagged(i: int) -> Any:
        return values[..., i : i + size]

    # They are symmetric.
    out = taps[0] * (lagged(0) + lagged(last))
    for i in range(1, half):
        out += taps[i] * (lagged(i) + lagged(last - i))
    if len(taps) % 2:
        out += taps[half] * lagged(half)
    return out
