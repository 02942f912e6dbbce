"""Parameters of a plant: their names, their bounds, and the type of `p`."""

import keyword
from collections import namedtuple
from collections.abc import Mapping
from typing import Any, SupportsFloat

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, check_choice, real
from eoi_jax.compiler.jax_private import Tracer

_TYPES: dict[tuple[str, ...], Any] = {}


class UnknownParameterError(AttributeError, ValueError):
    """A model reads a parameter that its plant does not declare."""


def parameter_type(names: tuple[str, ...]) -> Any:
    """The type of `p` for these names: attributes in order."""
    # A single class for a tuple of names, as jit compares pytree types by identity.
    if names not in _TYPES:
        kind: Any = namedtuple("Parameters", names)
        kind.__getattr__ = _unknown
        _TYPES[names] = kind
    return _TYPES[names]


def _unknown(p: Any, name: str) -> Any:
    try:
        check_choice(f"p.{name}", name, p._fields)
    except ValueError as error:
        raise UnknownParameterError(str(error), name=name, obj=p) from None


def replaced(names: tuple[str, ...], theta: Any, values: Mapping[str, Any]) -> Any:
    """Parameter values with those of a dict in their place; JAX's array where one is traced.

    Args:
        names: of all parameters.
        theta: their values, shape (np,).
        values: by name.

    Raises:
        ValueError: an unknown name, a value that is no number.
    """
    for key, value in values.items():
        check_choice("parameters", key, names)
        number = isinstance(value, SupportsFloat) and np.ndim(value) == 0  # type: ignore[arg-type]
        check(number, f"parameters[{key}]", "must be a number", repr(value))
    parts = [values.get(key, old) for key, old in zip(names, theta, strict=True)]
    if any(isinstance(part, Tracer) for part in parts):
        return jnp.stack([jnp.asarray(part, float) for part in parts])
    array = np.asarray([float(part) for part in parts])
    array.flags.writeable = False
    return array


def limits_of(name: str, pair: Any) -> tuple[float, float]:
    """Check and convert the bounds of a parameter."""
    values = [real(limit) for limit in pair] if np.iterable(pair) else []
    good = len(values) == 2 and not np.any(np.isnan(values))
    check(good, f"bounds[{name}]", "must be (lower, upper)", pair, "Use ±inf where there is none.")
    return values[0], values[1]


def check_names(names: tuple[str, ...], fixed: tuple[str, ...], bounds: Mapping[str, Any]) -> None:
    """Check the names of parameters, and that those of `fixed` and `bounds` are among them.

    Args:
        names: of all parameters.
        fixed: of those that are not estimated.
        bounds: by name.

    Raises:
        ValueError: no name, one that is no identifier, an unknown one, no parameter to estimate.
    """
    check(len(names) > 0, "parameters", "must name at least one parameter", "none")
    for key in names:
        good = key.isidentifier() and not keyword.iskeyword(key) and not key.startswith("_")
        check(
            good,
            "parameters",
            "must have names that are Python identifiers without an underscore in front",
            repr(key),
            "The model reads them as `p.name`.",
        )
    for key in fixed:
        check_choice("fixed", key, names)
    for key in bounds:
        check_choice("bounds", key, names)
    check(
        len(set(fixed)) < len(names),
        "fixed",
        "must leave a parameter to estimate",
        ", ".join(fixed),
    )
