"""Jacobians of a plant's highest derivatives along measured signals."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.programs import jit
from eoi_jax.models.plant import Plant, State

# Host arrays are passed to kernels directly: a conversion would run a kernel for each array.
Values = Array | np.ndarray


@jit(static=())
def state_slopes(plant: Plant, time: Values, y: Values, u: Values) -> Float[Array, "S ny r ny"]:
    """∂f/∂y, ∂f/∂ẏ, … at every instant, with the internal states at their initial values.

    Args:
        plant: with its parameter values.
        time: (S,) [s].
        y: outputs and their derivatives, (S, r, ny).
        u: inputs before any actuator, (S, nu).
    """
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def slopes_at(t: Array, y: Array, u: Array) -> Array:
        return jax.jacfwd(lambda y: plant.derivative(t, State(y, z), u, theta))(y)

    time, u = jnp.asarray(time), jnp.asarray(u)
    return jax.vmap(slopes_at)(time, jnp.asarray(y), plant.driven(time, u, theta))


@jit(static=("i",))
def input_slopes(plant: Plant, time: Values, y: Values, u: Values, i: int) -> Float[Array, "S ny"]:
    """∂f/∂u_i at every instant, for the inputs behind the actuator; arguments as above."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def slopes_at(t: Array, y: Array, u: Array) -> Array:
        return plant.input_slopes(t, State(y, z), u, theta)[:, i]

    time, u = jnp.asarray(time), jnp.asarray(u)
    return jax.vmap(slopes_at)(time, jnp.asarray(y), plant.driven(time, u, theta))
