"""An orthonormal basis of what some columns span."""

import numpy as np
from jaxtyping import Float


def orthonormal(
    columns: Float[np.ndarray, "rows columns"], least: float
) -> Float[np.ndarray, "rows rank"]:
    """Left singular vectors of the columns, scaled to length one first.

    Args:
        columns: of any lengths; zeros span nothing.
        least: singular value, over the largest, below which a direction is rounding.
    """
    size = np.linalg.norm(columns, axis=0)
    left, values, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return left[:, values > least * np.max(values, initial=0.0)]
