r"""The index of a pass, eq. (14): the power of the equivalent output injection.

    P = (1/N) Σ |F[u_eq]_n|²        (14)

The paper divides by N + 1 while it sums N samples; N makes P the mean square that it is meant
to be. Only samples that are scored count: after the transient, not in a gap, not stuck.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax.compiler.programs import jit


@jit(static=())
def index(
    square_sum: Float[Array, "*channel"], weight: Float[Array, "*channel"]
) -> Float[Array, "*channel"]:
    """P from the sum of squares [unit of y^(r), squared].

    Args:
        square_sum: Σ |F[m u_eq]|², m the weight of each sample (0 in a gap or at rest).
        weight: Σ F[m]² over the same samples: their number, where nothing is left out.

    Returns:
        P; without a scored sample NaN, for no evidence is not a perfect fit.
    """
    return jnp.where(weight > 0, square_sum / jnp.where(weight > 0, weight, 1.0), jnp.nan)
