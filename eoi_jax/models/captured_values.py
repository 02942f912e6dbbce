"""Numbers that a model reads from outside itself: a constant of a notebook, changed in its cell.

A program is traced from a function once, and found again by that function. With another value of a
global name the function is another model, so it gets another identity.
"""

import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import CodeType, FunctionType
from typing import Any
from weakref import WeakKeyDictionary

import jax
import numpy as np

from eoi_jax.compiler.jax_private import Tracer


@dataclass(frozen=True)
class CapturedSettings:
    """How far the values outside a function are followed."""

    depth: int = 4  # functions that call functions, lists of lists
    elements: int = 100_000  # of an array that is compared
    # Packages whose functions stay as they are.
    packages: tuple[str, ...] = ("jax", "numpy", "scipy", "equinox", "eoi_jax")


_SETTINGS = CapturedSettings()

# By function: what it reads outside, and the function that stands for it with these values.
_MODELS: WeakKeyDictionary[Callable[..., Any], dict[Any, "_Present | None"]] = WeakKeyDictionary()


class _Present:
    """A function with the values that it reads now, as an object of its own."""

    def __init__(self, function: Callable[..., Any]):
        functools.update_wrapper(self, function)
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        return self.function(*arguments)

    def __reduce__(self) -> tuple[Any, ...]:
        return with_present_values, (self.function,)


def with_present_values(function: Any) -> Any:
    """The function, or an object in its place if what it reads outside has changed since.

    Args:
        function: of a model. What is no function of the user's stays as it is.

    Returns:
        The same object for the same values.
    """
    original = function.function if isinstance(function, _Present) else function
    if not isinstance(original, FunctionType) or _is_of_package(original):
        return function
    models = _MODELS.setdefault(original, {})
    values = _values_of(original, 0)
    if values not in models:
        models[values] = _Present(original) if models else None
    return models[values] or original


def _values_of(function: FunctionType, depth: int) -> tuple[Any, ...]:
    """What a function reads outside itself, to be compared."""
    cells = function.__closure__ or ()
    names = dict.fromkeys(_names(function.__code__))
    captured = [function.__globals__[name] for name in names if name in function.__globals__]
    captured += [cell.cell_contents for cell in cells if _is_filled(cell)]
    captured += [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    return tuple(_comparable(value, depth + 1) for value in captured)


def _is_of_package(function: FunctionType) -> bool:
    """Whether it is no function of the user's."""
    return (function.__module__ or "").split(".")[0] in _SETTINGS.packages


def _names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _is_filled(cell: Any) -> bool:
    try:
        return cell.cell_contents is not None
    except ValueError:
        return False


def _comparable(value: Any, depth: int) -> Any:
    """A value by its content where it has numbers, else by its identity."""
    if isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        return type(value), repr(value)
    is_array = isinstance(value, np.ndarray | jax.Array) and not isinstance(value, Tracer)
    if is_array and value.size <= _SETTINGS.elements and value.dtype.kind in "biufc":
        return value.shape, str(value.dtype), np.asarray(value).tobytes()
    if depth < _SETTINGS.depth and isinstance(value, tuple | list):
        return type(value), tuple(_comparable(part, depth + 1) for part in value)
    if depth < _SETTINGS.depth and isinstance(value, Mapping):
        pairs = ((key, _comparable(part, depth + 1)) for key, part in value.items())
        return type(value), tuple((repr(key), part) for key, part in pairs)
    if depth < _SETTINGS.depth and isinstance(value, FunctionType):
        content = () if _is_of_package(value) else _values_of(value, depth)
        return id(value), content
    return id(value)
