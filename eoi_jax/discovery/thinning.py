"""Averages of signals over the samples of an r-th difference, thinned to a frequency band."""

import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_CHUNK = 131072  # values per chunk, so that intermediate results stay in the processor's cache


def thinning(step: float) -> Float[np.ndarray, "factor 4"]:
    """Cubic B-splines over the samples between two nodes, four nodes per quarter period of a band.

    The factor is a power of two, so that records with different bands share compiled kernels.
    """
    factor = 2 ** max(int(np.floor(np.log2(max(np.pi / (4.0 * step), 1.0)))), 0)
    x = (np.arange(factor) + 0.5) / factor
    splines = [
        (1.0 - x) ** 3,
        3.0 * x**3 - 6.0 * x**2 + 4.0,
        1.0 + 3.0 * x * (1.0 + x - x**2),
        x**3,
    ]
    return np.stack(splines, axis=1) / 6.0


def thinned(values: Any, weight: Any, kernel: Any) -> Any:
    """Weighted signals (last axis: samples) on coarse nodes, by cubic B-splines.

    Measurement noise above the band, which differences raise as ω^2r, is damped as ω^-8.

    NumPy arrays are processed by NumPy: XLA would compile each operation for each record length.
    """
    xp = jnp if isinstance(values, jax.Array) else np
    blocks = _blocks(xp, values * weight, kernel)
    leading_axes = [(0, 0)] * (blocks.ndim - 2)
    shifted = [xp.pad(blocks[..., i], [*leading_axes, (i, 3 - i)]) for i in range(4)]
    return shifted[0] + shifted[1] + shifted[2] + shifted[3]


def averaged_and_thinned(
    values: Callable[[slice], Float[np.ndarray, "*batch part"]],
    batch: tuple[int, ...],
    degree: int,
    weight: Float[np.ndarray, " samples"],
    kernel: Float[np.ndarray, "factor taps"],
) -> Float[np.ndarray, "*batch nodes"]:
    """`thinned` of `averaged` signals, evaluated in chunks so that memory stays small.

    Args:
        values: returns the signals at a slice of steps (last axis).
        batch: lengths of the leading axes.
        degree: order r of the difference.
        weight: weight of each average.
        kernel: kernel of the thinning.
    """
    factor, overlap = len(kernel), len(averaging(degree)) - 1
    nodes = np.zeros((*batch, -(-len(weight) // factor) + 3))
    length = max(_CHUNK // max(math.prod(batch), 1) // factor, 1)  # blocks
    for first in range(0, nodes.shape[-1] - 3, length):
        steps = slice(first * factor, min((first + length) * factor, len(weight)))
        weighted = averaged(degree, values(slice(steps.start, steps.stop + overlap)))
        weighted *= weight[steps]
        blocks = _blocks(np, weighted, kernel)
        for i in range(4):
            nodes[..., first + i : first + i + blocks.shape[-2]] += blocks[..., i]
    return nodes


def _blocks(xp: Any, weighted: Any, kernel: Any) -> Any:
    """The contribution of each block of samples to the four nodes around it."""
    factor, missing = kernel.shape[0], -weighted.shape[-1] % kernel.shape[0]
    if missing:
        weighted = xp.pad(weighted, [*[(0, 0)] * (weighted.ndim - 1), (0, missing)])
    return weighted.reshape(*weighted.shape[:-1], -1, factor) @ kernel


def averaging(degree: int) -> Float[np.ndarray, " taps"]:
    """Weights with which the r-th difference of y averages f at the middles of steps.

    The B-spline of order r has the variance r/12 (in steps); binomial weights corrected to that
    variance are exact to fourth order in h. An output of relative degree 0 is not averaged: it is
    that at the start of a step, here of the second one, so that all degrees leave out one step more
    than the difference needs.
    """
    if degree == 0:
        return np.array([0.0, 1.0])
    binomial = np.ones(1)
    for _ in range(degree - 1):
        binomial = np.convolve(binomial, [0.5, 0.5])
    c = ((degree - 1) / 4.0 - degree / 12.0) / 2.0
    return np.convolve(binomial, [-c, 1.0 + 2.0 * c, -c])


def averaged(degree: int, values: Array | np.ndarray) -> Any:
    """Moving average of signals (last axis: steps) that corresponds to the r-th difference."""
    taps = averaging(degree)
    if degree == 0:
        return values[..., 1:]
    size = values.shape[-1] - len(taps) + 1
    last, middle = len(taps) - 1, len(taps) // 2

    def lagged(i: int) -> Any:
        return values[..., i : i + size]

    # The taps are symmetric.
    average = taps[0] * (lagged(0) + lagged(last))
    for i in range(1, middle):
        average += taps[i] * (lagged(i) + lagged(last - i))
    if len(taps) % 2:
        average += taps[middle] * lagged(middle)
    return average
