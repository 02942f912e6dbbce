"""Functions of the user's as they are when their plant is made, with all that they read outside.

A constant of a notebook, an attribute of an object, the weights of a network: what a function reads
besides its arguments may change at any time, and JAX reads it whenever it traces the function. So
that all programs of a plant have the same values, the function is traced once, and this trace
stands for it. Of one function, traces that compute the same are equal: what was compiled for one
serves the others.

A helper under `jax.jit` is read once by JAX itself, whatever it reads outside.
"""

import functools
from collections.abc import Callable, Hashable
from types import FunctionType
from typing import Any

import jax
import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax.compiler.jax_private import jaxpr_as_fun, operations_of, with_own_constants
from eoi_jax.compiler.programs import fingerprint
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.traced_shapes import stacked, traced

# Packages whose functions read nothing that changes.
_PACKAGES = ("jax", "jaxlib", "numpy", "eoi_jax")


def is_of_package(function: Any) -> bool:
    """Whether a function, or the class of a callable object, is no user's."""
    named = function if isinstance(function, FunctionType | type) else type(function)
    modules = (getattr(function, "__module__", None), named.__module__)
    return any((module or "").split(".")[0] in _PACKAGES for module in modules)


class FunctionSnapshot:
    """A function of arrays that computes what another did when it was read.

    It is equal to one of the same function with the same equations and constants.
    """

    def __init__(
        self,
        field: str,
        function: Callable[..., Any],
        arguments: tuple[Any, ...],
        names: tuple[str, ...],
        layout: str = "",
    ):
        """Read the function.

        Args:
            field: of the plant, for messages.
            function: of trees of arrays; returns what is an array to `jnp.asarray`.
            arguments: all but the last one, shapes and types in place of arrays.
            names: of the parameters, which are the last argument.
            layout: as of `traced_shape`.

        Raises:
            ValueError: as `traced_shape`.
        """
        functools.update_wrapper(self, function, updated=())
        self.field, self.function = field, function
        self._arguments, self._names, self._layout = arguments, names, layout
        self._arithmetic = jnp.result_type(float)
        leaves, structure = self._as_read()
        trace = self._trace(leaves, structure)
        self._traces = {_signature(leaves, structure): trace}
        self._equations = _digest(trace)

    def __call__(self, *arguments: Any) -> Any:
        """Evaluate what was read, for arguments of these shapes and types."""
        leaves, structure = jax.tree.flatten(arguments)
        leaves = [leaf if isinstance(leaf, jax.Array) else jnp.asarray(leaf) for leaf in leaves]
        signature = _signature(leaves, structure)
        if signature not in self._traces:
            self._traces[signature] = self._trace(leaves, structure)
            self._check_unchanged()
        return jaxpr_as_fun(self._traces[signature])(*leaves)[0]

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, FunctionSnapshot)
            and self.function is other.function
            and self._equations == other._equations
        )

    def __hash__(self) -> int:
        return hash(self._equations)

    def __getattr__(self, name: str) -> Any:
        # What a function declares about itself, such as the names of its states.
        if name.startswith("_") or name == "function":
            raise AttributeError(name)
        return getattr(self.function, name)

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = (self._arguments, self._names, self._layout)
        return FunctionSnapshot, (self.field, self.function, *arguments)

    def _as_read(self) -> tuple[list[Any], Any]:
        """Leaves and structure of the arguments with which the function was read."""
        number = jax.ShapeDtypeStruct((), self._arithmetic)
        p = parameter_type(self._names)(*[number] * len(self._names))
        return jax.tree.flatten((*self._arguments, p))

    def _trace(self, leaves: list[Any], structure: Any) -> Any:
        def call(*leaves: Any) -> jax.Array:
            returned = self.function(*jax.tree.unflatten(structure, leaves))
            return stacked(self.field, self.function, returned, self._layout)

        shapes = [jax.ShapeDtypeStruct(jnp.shape(leaf), leaf.dtype) for leaf in leaves]
        closed = traced(self.field, self.function, call, *shapes, layout=self._layout)
        return with_own_constants(closed)

    def _check_unchanged(self) -> None:
        """Check that a trace that was taken later has the values of the first one."""
        if jnp.result_type(float) != self._arithmetic:  # another precision is another program
            return
        leaves, structure = self._as_read()
        digest = _digest(self._trace(leaves, structure))
        # A function that makes a new callback each time it is traced is equal to nothing.
        good = digest == self._equations or digest != _digest(self._trace(leaves, structure))
        rule = "must read the same values outside itself as when its plant was made"
        name = getattr(self.function, "__name__", type(self.function).__name__)
        check(good, self.field, rule, name, "Make the plant anew.")


def _signature(leaves: list[Any], structure: Any) -> Hashable:
    return structure, tuple((jnp.shape(leaf), leaf.dtype) for leaf in leaves)


def _digest(trace: Any) -> str:
    """Of what is computed, with the derivatives that the author of a function gave."""
    names = operations_of(trace.jaxpr)
    if "custom_jvp_call" not in names or any(name.startswith("custom_vjp") for name in names):
        return fingerprint(trace)
    shapes = [jax.ShapeDtypeStruct(aval.shape, aval.dtype) for aval in trace.in_avals]
    run = jaxpr_as_fun(trace)

    def tangents(*leaves: Any) -> Any:
        return jax.jvp(run, leaves, leaves)

    return fingerprint(trace) + fingerprint(jax.make_jaxpr(tangents)(*shapes))
