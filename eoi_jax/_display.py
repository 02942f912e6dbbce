"""How results are printed, drawn and kept: functions that `report/` and the store fill in.

A result is data. It knows neither tables nor figures nor files: `str(result)`, `result.plot()` and
`result.save(path)` ask the function here, which goes by the class of the result.
"""

import importlib
from collections.abc import Callable
from functools import cache, singledispatch
from pathlib import Path
from typing import Any

_MODULES: list[str] = []


def register_in(*modules: str) -> None:
    """Say which modules register tables, figures and files; they are imported at the first result.

    Args:
        modules: their full names.
    """
    _MODULES.extend(modules)


@cache
def _import_registrations() -> None:
    for name in _MODULES:
        importlib.import_module(name)


class _ByClass:
    """A function with one implementation for each class of its first argument."""

    def __init__(self, default: Callable):
        self.__doc__ = default.__doc__
        self._implementations = singledispatch(default)

    def register(self, kind: type, implementation: Callable) -> None:
        """Use an implementation for a class and those that extend it.

        Args:
            kind: class of the first argument.
            implementation: with the arguments of the function.
        """
        self._implementations.register(kind, implementation)

    def __call__(self, result: Any, *arguments: Any) -> Any:
        _import_registrations()
        return self._implementations(result, *arguments)


@_ByClass
def text(result: Any) -> str:
    """A result as a table; its fields where no table is registered for its class."""
    return repr(result)


@_ByClass
def figure(result: Any) -> Any:
    """A result as a matplotlib figure."""
    raise TypeError(f"no figure is registered for {type(result).__name__}")


@_ByClass
def save(result: Any, path: str | Path) -> None:
    """A result in a file."""
    raise TypeError(f"{type(result).__name__} cannot be saved to {path}")


@_ByClass
def findings(result: Any, status: Any) -> tuple[str, ...]:
    """What the numbers of a result say, in sentences."""
    raise TypeError(f"no findings are registered for {type(result).__name__}, {status}")


class Result:
    """What every result can do."""

    def __str__(self) -> str:
        """A table of several lines."""
        return text(self)

    def plot(self) -> Any:
        """Draw it: a matplotlib figure."""
        return figure(self)

    def save(self, path: str | Path) -> None:
        """Write to one `.npz` file that `eoi_jax.load` reads back; nothing in it is pickled."""
        save(self, path)
