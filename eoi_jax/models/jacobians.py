"""How a plant's highest derivative depends on its outputs and inputs, along measured signals."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.programs import jit
from eoi_jax.models.plant import Plant, State

# Arrays of the host go into kernels as they are: to hand each over first takes a kernel of its own.
Values = Array | np.ndarray


@jit(static=())
def state_slopes(plant: Plant, time: Values, y: Values, u: Values) -> Float[Array, "S ny r ny"]:
    """∂f/∂y, ∂f/∂ẏ, … at every instant, with the internal states where they start.

    Args:
        plant: at its parameters.
        time: (S,) [s].
        y: outputs and their derivatives, (S, r, ny).
        u: inputs before any actuator, (S, nu).
    """
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def one(t: Array, y: Array, u: Array) -> Array:
        return jax.jacfwd(lambda y: plant.derivative(t, State(y, z), u, theta))(y)

    time, u = jnp.asarray(time), jnp.asarray(u)
    return jax.vmap(one)(time, jnp.asarray(y), plant.driven(time, u, theta))


@jit(static=("i",))
def input_slopes(plant: Plant, time: Values, y: Values, u: Values, i: int) -> Float[Array, "S ny"]:
    """∂f/∂u_i at every instant, of inputs as they come out of any actuator; else as above."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def one(t: Array, y: Array, u: Array) -> Array:
        return plant.input_slopes(t, State(y, z), u, theta)[:, i]

    time, u = jnp.asarray(time), jnp.asarray(u)
    return jax.vmap(one)(time, jnp.asarray(y), plant.driven(time, u, theta))
