"""The functions of a plant: read once, and checked, so that a wrong shape is reported here."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax.models.function_snapshot import FunctionSnapshot, is_of_package
from eoi_jax.models.index_bounds import check_indices
from eoi_jax.models.traced_equations import evaluated
from eoi_jax.models.traced_shapes import SCALARS, traced_shape


def read_functions(
    plant: Any, state: Callable, actuator_steps: int = 97
) -> tuple[Any, Any, Any, Any]:
    """f, g, the start of z and the actuator, with snapshots in place of the user's functions.

    Args:
        plant: with all its fields, the functions as the user wrote them.
        state: makes x of y and z.
        actuator_steps: with which an actuator is read: at so many it shows what it does later.

    Raises:
        ValueError: a function that does not run, reads elements that are not there, or returns
            another shape than it must.
    """
    nu, theta = len(plant.inputs), _shape(len(plant.names))
    names = plant.names
    initial = _read("internal_initial", plant.internal_initial, (), names)
    start = jax.eval_shape(plant.internal_start, theta)
    x = state(_shape(plant.rows, len(plant.outputs)), _shape(*start.shape))
    layout = (
        f"`x.y` has shape {x.y.shape}: rows are outputs and their derivatives, columns outputs."
    )
    layout += f" `u` has shape {(nu,)}, `x.z` shape {start.shape}."
    rates = []
    for field, function in (("dynamics", plant.dynamics), ("internal", plant.internal)):
        if function is not None:
            check_indices(field, function, plant, state, theta, start.shape)
            function = _read(field, function, (_shape(), x, _shape(nu)), names, layout)
            _check_rate(field, plant, _returned(field, function, names, x, nu), start.shape)
        rates.append(function)
    line = (_shape(actuator_steps), _shape(actuator_steps, nu))
    actuator = _read("actuator", plant.actuator, line, names)
    if actuator is not None:

        def act(t: Any, u: Any, theta: Any) -> Any:
            return actuator(t, u, plant.named(theta))

        driven = traced_shape("actuator", actuator, act, *line, theta)
        rule = "must return as many inputs as it gets, a row for each step"
        size = line[1].shape
        check(driven == size, "actuator", rule, f"shape {driven} for {size}")
    return *rates, initial, actuator


def _read(
    field: str, function: Any, arguments: tuple[Any, ...], names: tuple[str, ...], layout: str = ""
) -> Any:
    """A snapshot of a user's function; what is none, or was read before, as it is."""
    if not callable(function) or is_of_package(function):
        return function
    return FunctionSnapshot(field, function, arguments, names, layout)


def _returned(
    field: str, function: Any, names: tuple[str, ...], x: Any, inputs: int
) -> tuple[int, ...]:
    """Shape of what f or g returns."""

    def call(theta: Any, z: Any) -> Any:
        point = type(x)(jnp.zeros(x.y.shape), z)
        return evaluated(function, names, jnp.zeros(()), point, jnp.zeros((inputs,)), theta)

    return traced_shape(field, function, call, _shape(len(names)), x.z)


def _check_rate(field: str, plant: Any, shape: tuple[int, ...], start: tuple[int, ...]) -> None:
    """Check the shape of what f or g returns."""
    if field == "internal":
        good = shape == start or (start == (1,) and shape == ())
        rule = f"must return the shape of `internal_initial` {start}"
        check(good, field, rule, f"shape {shape}")
        return
    ny = len(plant.outputs)
    lower = "The lower ones follow from the highest: return that of each output, not each state."
    rule = f"must return shape ({ny},), one value for each of the outputs "
    good = shape == (ny,) or (ny == 1 and shape == ())
    advice = lower if shape[:1] == (sum(plant.degrees),) else ""
    advice = SCALARS if shape == (ny, 1) else advice
    check(good, field, rule + ", ".join(plant.outputs), f"shape {shape}", advice)


def _shape(*axes: int) -> jax.ShapeDtypeStruct:
    """Of an array of the type in which JAX computes."""
    return jax.ShapeDtypeStruct(axes, jnp.result_type(float))
