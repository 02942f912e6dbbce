r"""The index of a pass, eq. (14): the power of the equivalent output injection.

    P = (1/N) Σ |F[u_eq]_n|²        (14)

The paper divides by N + 1 while it sums N samples; N makes P the mean square that it is meant
to be. Only samples that are scored count: after the transient, not in a gap, not stuck.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float


def index(
    square_sum: Float[Array, "*channel"], count: Float[Array, "*channel"]
) -> Float[Array, "*channel"]:
    """P from the sum of squares and the number of scored samples [unit of y^(r), squared].

    Without a scored sample it is NaN: no evidence is not a perfect fit.
    """
    return jnp.where(count > 0, square_sum / jnp.maximum(count, 1.0), jnp.nan)
