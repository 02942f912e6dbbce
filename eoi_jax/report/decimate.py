"""Long signals with fewer points, and all of their peaks."""

import numpy as np
from jaxtyping import Float

# Two points per pixel column of a figure 1000 px wide.
_COLUMNS = 1000


def decimate(
    time: Float[np.ndarray, " time"], values: Float[np.ndarray, " time"], columns: int = _COLUMNS
) -> tuple[Float[np.ndarray, " drawn"], Float[np.ndarray, " drawn"]]:
    """The smallest and the largest value of each of `columns` stretches, so that peaks stay.

    Args:
        time: stamps [s].
        values: the signal; NaN is left out of a stretch, and stays where it is all there is.
        columns: stretches.

    Returns:
        Time and values of at most ``2 * columns`` points, in order of time.
    """
    size = -(-len(values) // columns)
    if size <= 2:
        return time, values
    blocks = np.pad(values, (0, -len(values) % size), mode="edge").reshape(-1, size)
    low = np.where(np.isnan(blocks), np.inf, blocks).argmin(axis=1)
    high = np.where(np.isnan(blocks), -np.inf, blocks).argmax(axis=1)
    starts = np.arange(len(blocks)) * size
    picked = np.sort(np.stack([starts + low, starts + high], axis=1), axis=1).ravel()
    picked = np.minimum(picked, len(values) - 1)
    return time[picked], values[picked]
