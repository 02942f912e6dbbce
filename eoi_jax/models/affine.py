"""In which parameters, one at a time, the outputs of a plant are affine."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from eoi_jax.compiler.jax_private import inputs_read
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.plant import Plant, State


def affine_parameters(plant: Plant) -> Bool[np.ndarray, " np"]:
    """Parameters in which f is affine while the others are constant, such as a gain or a friction.

    The others divide, are exponents, are multiplied by themselves, or act through internal states
    or actuators. Whether a parameter is fixed does not matter.

    Args:
        plant: at any values of its parameters.

    Returns:
        One flag for each parameter, shape (np,).
    """
    return _affine_parameters(jax.tree.structure(plant), jnp.result_type(float))


@functools.lru_cache(maxsize=64)
def _affine_parameters(structure: Any, dtype: Any) -> Bool[np.ndarray, " np"]:
    # Values do not matter, only what is computed from what.
    plant: Plant = jax.tree.unflatten(structure, [np.zeros(0)] * structure.num_leaves)
    states = jax.eval_shape(plant.internal_start, jax.ShapeDtypeStruct((len(plant.names),), dtype))
    shapes = (), (plant.rows, len(plant.outputs)), states.shape, (len(plant.inputs),)
    # Scalars: of an array, what reads an element reads all of them.
    scalar, *line = (jax.ShapeDtypeStruct(shape, dtype) for shape in ((), *shapes))
    places = range(len(plant.names))
    hidden = inputs_read(jax.make_jaxpr(_hidden(plant))([scalar] * len(places), *line))
    flags = np.asarray(
        [not hidden[i] and _is_affine_in(plant, i, scalar, line) for i in places], dtype=bool
    )
    flags.flags.writeable = False
    return flags


def _hidden(plant: Plant) -> Callable:
    """What acts through internal states or actuators."""

    def hidden(values: list[Array], t: Array, y: Array, z: Array, u: Array) -> Any:
        p = parameter_type(plant.names)(*values)
        rate = None if plant.internal is None else plant.internal(t, State(y, z), u, p)
        start = plant.internal_initial(p) if callable(plant.internal_initial) else None
        acted = None if plant.actuator is None else plant.actuator(t[None], u[None], p)
        return rate, start, acted

    return hidden


def _is_affine_in(plant: Plant, i: int, scalar: Any, line: list[Any]) -> bool:
    """Whether the slope of f with a parameter does not read it."""

    def f(value: Array, values: list[Array], t: Array, y: Array, z: Array, u: Array) -> Array:
        p = parameter_type(plant.names)(*values[:i], value, *values[i:])
        return jnp.asarray(plant.dynamics(t, State(y, z), u, p))

    arguments = scalar, [scalar] * (len(plant.names) - 1), *line
    return not inputs_read(jax.make_jaxpr(jax.jacfwd(f))(*arguments))[0]
