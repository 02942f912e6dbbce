"""A function of the host in the middle of code that JAX compiles."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np

from eoi_jax.compiler.jax_private import BUFFER_CALLBACK

_objects: dict[int, Any] = {}  # what functions of the host may ask for, while it is lent
_numbers = itertools.count()


@contextmanager
def lent(value: Any) -> Iterator[np.ndarray]:
    """A number by which a function of the host finds an object: `borrowed`.

    A number is an argument like any other, so that the compiled program around the function does
    not depend on the object: one serves all plants.
    """
    number = next(_numbers)
    _objects[number] = value
    try:
        yield np.asarray(number)
    finally:
        del _objects[number]


def borrowed(number: Any) -> Any:
    """The object that was lent under this number."""
    return _objects[int(number)]


def on_host(function: Callable[..., np.ndarray], result: jax.ShapeDtypeStruct, *args: Any) -> Any:
    """What a function of NumPy arrays gives, which must not keep them.

    Args:
        function: under `vmap` all arrays of its arguments, and what it gives, have one more leading
            axis; it is of length one where an argument does not differ.
        result: what it gives.
        args: trees of arrays.
    """

    def converted(*parts: Any) -> np.ndarray:
        return function(*jax.tree.map(np.asarray, parts))

    def written(context: Any, buffer: Any, *parts: Any) -> None:
        del context
        with np.errstate(over="ignore"):  # in single precision, of what diverges
            np.asarray(buffer)[...] = converted(*parts)

    # On the CPU it reads the arrays where they lie: to copy them takes longer than many a function.
    if BUFFER_CALLBACK is not None and jax.default_backend() == "cpu":
        return BUFFER_CALLBACK(written, result, vmap_method="expand_dims")(*args)
    return jax.pure_callback(converted, result, *args, vmap_method="expand_dims")
