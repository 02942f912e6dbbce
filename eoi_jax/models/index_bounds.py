"""Indices of x and u that are out of bounds, which JAX would move to the nearest element."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, counted
from eoi_jax.models.function_snapshot import is_of_package
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.traced_equations import has_hash
from eoi_jax.models.traced_shapes import line_of


class OutOfBoundsError(IndexError):
    """An index that an array does not have; the text is the element, such as ``x.y[1]``."""


class Bounded(np.ndarray):
    """An array that refuses an index that is out of its bounds, as JAX's do not.

    Attributes:
        label: what the array is called in a model.
    """

    label = ""

    def __array_finalize__(self, source: Any) -> None:
        """A row, and what is computed from an array, keep its name."""
        self.label = getattr(source, "label", "")

    def __getitem__(self, key: Any) -> Any:
        """The element.

        Raises:
            OutOfBoundsError: there is none.
        """
        keys = ", ".join(map(str, key if isinstance(key, tuple) else (key,)))
        element = f"{self.label}[{keys}]"
        try:
            part = super().__getitem__(key)
        except IndexError as error:
            if "out of bounds" in str(error):
                raise OutOfBoundsError(element) from error
            raise
        if isinstance(part, Bounded):
            part.label = element
        return part


def check_indices(
    field: str, function: Any, plant: Any, state: Callable, theta: Any, internal: tuple[int, ...]
) -> None:
    """Check that f or g reads no element of x and u that they do not have.

    It is traced once more, with `Bounded` arrays for x and u. What these cannot do, being NumPy's,
    is no fault of the function: its trace by JAX is what counts.

    Args:
        field: name of the function, as the user wrote it.
        function: of t, x, u, p.
        plant: whose function it is.
        state: makes x of y and z.
        theta: shape and type of the parameters.
        internal: shape of the internal states.

    Raises:
        ValueError: an element that is not there.
    """
    shape = plant.rows, len(plant.outputs)
    sizes = shape if plant.relative_degree else (), internal, (len(plant.inputs),)
    # What a user's function reads outside itself may have changed.
    cached = is_of_package(function) and has_hash(function)
    trace = _trace if cached else _trace.__wrapped__
    try:
        trace(function, plant.names, state, shape, *sizes, theta.dtype)
    except OutOfBoundsError as error:
        element = str(error)
        value = element + line_of(function, error)
        rule = "must read elements that are there, for others JAX takes the nearest"
        is_row = element.count("[") == 1 and "axis 0" in str(error.__cause__)
        check(False, field, rule, value, _advice(element, plant, is_row))


@functools.lru_cache(maxsize=64)
def _trace(
    function: Any,
    names: tuple[str, ...],
    state: Callable,
    shape: tuple[int, int],
    outputs: tuple[int, ...],
    internal: tuple[int, ...],
    inputs: tuple[int, ...],
    dtype: Any,
) -> None:
    """Trace a function once with bounded arrays, as equal equations are traced once elsewhere."""
    # What depends on outputs of degree 0, which are no states, has a message of its own.
    y = _bounded("x.y", outputs, dtype) if outputs else jnp.ones(shape)
    x = state(y, _bounded("x.z", internal, dtype))
    u = _bounded("u", inputs, dtype)

    def call(theta: Any) -> jax.Array:
        return jnp.asarray(function(np.ones((), dtype), x, u, parameter_type(names)(*theta)))

    try:
        with np.errstate(all="ignore"):
            jax.eval_shape(call, jax.ShapeDtypeStruct((len(names),), dtype))
    except OutOfBoundsError:
        raise
    except Exception:
        return  # what arrays of NumPy cannot do


def _bounded(label: str, shape: tuple[int, ...], dtype: Any) -> Bounded:
    """Ones that refuse an index that is out of bounds."""
    ones = np.ones(shape, dtype).view(Bounded)
    ones.label = label
    return ones


def _advice(element: str, plant: Any, is_row: bool) -> str:
    """What the model has, and what to write."""
    if element.startswith("u["):
        count = counted(len(plant.inputs), "input")
        listed = f"{count} ({', '.join(plant.inputs)})" if plant.inputs else "no input"
        inventory = f"The model has {listed}"
        return f"{inventory}: name all that it reads in `inputs`."
    if element.startswith("x.z["):
        inventory = f"The model has {counted(len(plant.initial_internal), 'internal state')}"
        return f"{inventory}, as many as `internal_initial` has values."
    rows, columns = counted(plant.rows, "row"), counted(len(plant.outputs), "column")
    inventory = (
        f"`x.y` has {rows} (the outputs and their derivatives below `relative_degree`, which is "
        f"{plant.rows}) and {columns} ({', '.join(plant.outputs)})."
    )
    higher = f" For a model of the next derivative write `relative_degree={plant.rows + 1}`."
    return inventory + higher * is_row
