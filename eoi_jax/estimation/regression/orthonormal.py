"""Columns and directions that carry information; the others are rounding."""

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


def informative_directions(
    information: Float[np.ndarray, "np np"], rounding: float = 1e-12
) -> tuple[Float[np.ndarray, "np k"], Float[np.ndarray, " k"]]:
    """Directions of θ that an information matrix says something of, and its eigenvalues there.

    Args:
        information: scaled to a diagonal of one first; zero for what takes no part.
        rounding: eigenvalue of it, over the largest, that is zero.
    """
    length = np.sqrt(np.maximum(np.diagonal(information), 0.0))
    unscale = np.where(length > 0, 1.0 / np.where(length > 0, length, 1.0), 0.0)
    values, vectors = np.linalg.eigh(information * np.outer(unscale, unscale))
    informative = values > rounding * max(float(values[-1]), 0.0)
    return vectors[:, informative] * unscale[:, None], values[informative]
