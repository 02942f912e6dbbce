r"""Linear recursions along a record, as triangular systems of a few bands.

What a recursive filter does, $y_i = r_i - \sum_{d \ge 1} b_d\,y_{i-d}$, is forward substitution in
a banded system; LAPACK has that (`dtbtrs`), at two nanoseconds a sample, and is there already where
`scipy.signal` would take half a second to import.
"""

import numpy as np
from jaxtyping import Float

Columns = Float[np.ndarray, "rows columns"]


def substituted(bands: Float[np.ndarray, "band period"], right: Columns) -> Columns:
    r"""$y_i = r_i - \sum_{d \ge 1} b_{d,\,(i-d) \bmod m}\,y_{i-d}$, nothing before the first row.

    Args:
        bands: b; the diagonal, d = 0, is taken to be one. Those of a column repeat after m columns.
        right: r, a multiple of m rows.

    Returns:
        y.
    """
    from scipy.linalg import get_lapack_funcs  # 0.1 s of import

    right = np.asarray(right, float)
    if not right.size:
        return right.copy()
    tiled = np.asfortranarray(np.tile(bands, len(right) // bands.shape[1]))
    (solve,) = get_lapack_funcs(("tbtrs",), (tiled,))
    return solve(tiled, right, uplo="L", diag="U")[0]


def states(
    transition: Float[np.ndarray, "order order"],
    entry: Float[np.ndarray, " order"],
    inputs: Columns,
    start: Float[np.ndarray, "order columns"] | None = None,
) -> Float[np.ndarray, "rows order columns"]:
    r"""$x_{k+1} = A x_k + b u_k$, for several inputs: the state after each of them.

    Args:
        transition: A.
        entry: b.
        inputs: u, one column for each recursion.
        start: x before the first input; zero if left out.
    """
    order = len(transition)
    bands = np.zeros((2 * order, order))
    for i in range(order):
        for j in range(order):
            bands[order + i - j, j] = -transition[i, j]
    right = inputs[:, None, :] * entry[:, None]
    if start is not None and len(right):
        right[0] += transition @ start
    rows = right.reshape(len(right) * order, inputs.shape[1])
    return substituted(bands, rows).reshape(right.shape)
