r"""The index of a pass, eq. (14): the power of the equivalent output injection.

    P = (1/N) Σ |F[u_eq]_n|²        (14)

The paper divides by N + 1 while it sums N samples; N makes P the mean square that it is meant
to be. Only samples that are scored count: after the transient, not in a gap, not stuck.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Host = Array | np.ndarray


def index(square_sum: Float[Host, "*channel"], weight: Float[Host, "*channel"]) -> Any:
    """P from the sum of squares [unit of y^(r), squared].

    Args:
        square_sum: Σ |F[m u_eq]|², m the weight of each sample (0 in a gap or at rest).
        weight: Σ F[m]² over the same samples: their number, where nothing is left out.

    Returns:
        P, (*channel); without a scored sample NaN, for no evidence is not a perfect fit. NumPy's
        arrays stay with NumPy.
    """
    xp = jnp if isinstance(square_sum, jax.Array) else np
    return xp.where(weight > 0, square_sum / xp.where(weight > 0, weight, 1.0), xp.nan)
