"""Shapes of what a user's function returns, with a sentence where JAX cannot trace it."""

import traceback
from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import jax
import jax.numpy as jnp
from jax.errors import (
    ConcretizationTypeError,
    TracerArrayConversionError,
    TracerBoolConversionError,
    TracerIntegerConversionError,
)

from eoi_jax._checks import check

_UNTRACEABLE = (ConcretizationTypeError, TracerArrayConversionError, TracerIntegerConversionError)
_FAILURES = (TypeError, AttributeError, IndexError, NameError)
_ARGUMENTS = (
    "It is called with `t`, `x`, `u`, `p`: `x.y` has a row for the outputs and one for each of "
    "their derivatives, `x.z` the internal states, and parameters have their names, `p.mass`."
)

SCALARS = (
    "A row of `x.y` has an entry for each output, also of a single one, and so has `u`: "
    "`position, speed = x.y[:, 0]` and `u[0]` are scalars."
)


def traced_shape(
    field: str, function: Any, call: Callable, *arguments: Any, layout: str = ""
) -> tuple[int, ...]:
    """Shape of what a call returns, without values.

    Args:
        field: name of the function, as the user wrote it.
        function: of the user, which `call` calls.
        call: returns an array.
        arguments: of the call, arrays or their shapes.
        layout: shapes of what the function gets, for a message where these do not unpack.

    Raises:
        ValueError: the function needs the values of what it gets, or does not run.
    """
    return traced(field, function, call, *arguments, layout=layout).out_avals[0].shape


def traced(field: str, function: Any, call: Callable, *arguments: Any, layout: str = "") -> Any:
    """What a call computes, as a closed jaxpr; arguments and errors as of `traced_shape`."""
    try:
        return jax.make_jaxpr(call)(*arguments)
    except ValueError as error:
        if str(error).startswith("`"):  # of a field of its own
            raise
        value = f"{type(error).__name__}: {str(error).rstrip('.')}{line_of(function, error)}"
        returns_nothing = str(error).startswith("None is not a valid value")
        advice = "Does the function lack its `return`?" if returns_nothing else ""
        advice = layout if "values to unpack" in str(error) else advice
        check(False, field, "must run where it is called", value, advice)
        raise
    except _UNTRACEABLE as error:
        branch = isinstance(error, TracerBoolConversionError)
        used = "an `if`, `and`, `or`, `min` or `max` on one" if branch else "a function of NumPy, "
        used += "" if branch else "`math` or Python of one"
        advice = "Use `jnp.where` in its place." if branch else "Use that of `jax.numpy`, `jnp`."
        rule = "must not need the values of `t`, `x`, `u` or `p`, which JAX traces"
        check(False, field, rule, used + line_of(function, error), advice)
        raise
    except _FAILURES as error:
        value = f"{type(error).__name__}: {str(error).rstrip('.')}{line_of(function, error)}"
        advice = _ARGUMENTS if field in ("dynamics", "internal") else ""
        scalar = advice and "scalar" in str(error)  # lax.cond, lax.while_loop
        advice += " " + SCALARS if scalar else ""
        check(False, field, "must run where it is called", value, advice)
        raise


def stacked(field: str, function: Any, returned: Any, layout: str) -> jax.Array:
    """What a user's function returns as an array.

    Args:
        field: name of the function, as the user wrote it.
        function: of the user.
        returned: by it.
        layout: shapes of what f and g get; "" for other functions.

    Raises:
        ValueError: a list whose entries have different shapes.
    """
    if isinstance(returned, list | tuple) and not any(
        isinstance(entry, list | tuple) for entry in returned
    ):
        shapes = [jnp.shape(entry) for entry in returned if entry is not None]
        code = getattr(function, "__code__", None)
        file = PurePath(code.co_filename).name if code else ""
        place = f" (function in line {code.co_firstlineno} of {file})" if code else ""
        value = f"shapes {', '.join(map(str, shapes))}{place}"
        advice = f"{layout} {SCALARS}" if layout else ""
        check(len(set(shapes)) < 2, field, "must return entries of one shape", value, advice)
    return jnp.asarray(returned)


def line_of(function: Any, error: Exception) -> str:
    """In which line of the user's file an error was, in brackets; "" where that is not known.

    Args:
        function: of the user.
        error: raised in it.
    """
    code = getattr(function, "__code__", None)
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if code and frame.filename == code.co_filename]
    return f" (line {lines[-1]} of {PurePath(code.co_filename).name})" if code and lines else ""
