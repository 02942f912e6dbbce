"""An orthonormal basis of the span of some columns."""

import numpy as np
from jaxtyping import Float


def orthonormal(
    columns: Float[np.ndarray, "rows columns"], tolerance: float
) -> Float[np.ndarray, "rows rank"]:
    """Left singular vectors of the columns, scaled to length one first.

    Args:
        columns: of any norms; zero columns are left out.
        tolerance: singular value, over the largest, below which a direction is rounding.
    """
    size = np.linalg.norm(columns, axis=0)
    vectors, values, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return vectors[:, values > tolerance * np.max(values, initial=0.0)]
