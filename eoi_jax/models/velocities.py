"""Velocities of outputs among their derivatives: where friction acts."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._types import Output


def velocity_rows(degrees: Sequence[int]) -> tuple[int, ...]:
    """Row of `State.y` that holds the velocity of each output.

    It is the first derivative of a position; for dry friction an output of relative degree one
    counts as a speed. One of relative degree zero has none: its rows are zero.
    """
    return tuple(min(max(degree - 1, 0), 1) for degree in degrees)


def velocity_of(y: Float[Array, "r ny"], degrees: Sequence[int]) -> Output:
    """The velocity of each output, out of `State.y`."""
    rows = np.asarray(velocity_rows(degrees))
    return y[rows[0]] if np.all(rows == rows[0]) else jnp.where(rows == 1, y[1], y[0])


def with_velocity(
    y: Float[Array, "r ny"], velocity: Output, degrees: Sequence[int]
) -> Float[Array, "r ny"]:
    """`State.y` with the velocities replaced."""
    rows = np.asarray(velocity_rows(degrees))
    if np.all(rows == rows[0]):
        return y.at[rows[0]].set(velocity)
    return jnp.where(np.arange(len(y))[:, None] == rows, velocity, y)
