"""Long signals reduced to the points that a plot can show, with their peaks."""

import numpy as np
from jaxtyping import Float, Int


def decimate(
    time: Float[np.ndarray, " time"], values: Float[np.ndarray, " time"], columns: int = 1000
) -> tuple[Float[np.ndarray, " drawn"], Float[np.ndarray, " drawn"]]:
    """The smallest and the largest value of each of `columns` intervals, so that peaks remain.

    Args:
        time: stamps [s].
        values: the signal; NaN is ignored in an interval that has other values.
        columns: number of intervals; the default is one per pixel of a figure 1000 px wide.

    Returns:
        Time and values of at most ``2 * columns`` points, in time order.
    """
    size = -(-len(values) // columns)
    if size <= 2:
        return time, values
    index = extremes(values, size)
    return time[index], values[index]


def extremes(values: Float[np.ndarray, " time"], size: int) -> Int[np.ndarray, " drawn"]:
    """Where the smallest and the largest value of each interval of `size` samples are.

    Args:
        values: the signal; NaN is ignored in an interval that has other values.
        size: samples of an interval; the last one may be shorter.

    Returns:
        Two indices for each interval, in time order.
    """
    blocks = np.pad(values, (0, -len(values) % size), mode="edge").reshape(-1, size)
    low = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    offsets = np.arange(len(blocks)) * size
    index = np.sort(np.stack([offsets + low, offsets + high], axis=1), axis=1).ravel()
    return np.minimum(index, len(values) - 1)
