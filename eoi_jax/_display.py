"""Printing, drawing, saving of results, and tables: what `report/` and the storage implement.

A result is data and independent of tables, figures and files: `str(result)`, `result.plot()`,
`result.to_pandas()`, `result.to_xarray()` and `result.save(path)` call the functions here, which
dispatch on the class of the result.
"""

import importlib
from collections.abc import Callable
from functools import cache, singledispatch
from pathlib import Path
from typing import Any

_MODULES: list[str] = []


def register_in(*modules: str) -> None:
    """Declare modules that register implementations; they are imported at the first use of one.

    Args:
        modules: full names of the modules.
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
        """Register an implementation for a class and its subclasses.

        Args:
            kind: class of the first argument.
            implementation: function with the same arguments.
        """
        self._implementations.register(kind, implementation)

    def __call__(self, result: Any, *arguments: Any) -> Any:
        _import_registrations()
        return self._implementations(result, *arguments)


@_ByClass
def text(result: Any) -> str:
    """A result as a text table; its class if no table is registered for it."""
    return object.__repr__(result)


@_ByClass
def figure(result: Any) -> Any:
    """A result as a matplotlib figure."""
    raise TypeError(f"no figure is registered for {type(result).__name__}")


@_ByClass
def data_frame(result: Any) -> Any:
    """A result as a `pandas.DataFrame`."""
    raise TypeError(f"no data frame is registered for {type(result).__name__}")


@_ByClass
def dataset(result: Any) -> Any:
    """A result as an `xarray.Dataset`; its data frame where none is registered for its class."""
    return data_frame(result).to_xarray()


@_ByClass
def save(result: Any, path: str | Path) -> None:
    """Save a result to a file."""
    raise TypeError(f"{type(result).__name__} cannot be saved to {path}")


@_ByClass
def findings(result: Any, status: Any) -> tuple[str, ...]:
    """Sentences that interpret the numbers of a result."""
    raise TypeError(f"no findings are registered for {type(result).__name__}, {status}")


class Result:
    """Base class of all results: they print, plot and save themselves, and become tables.

    A result is equal to itself only: compare numbers, of a record its `content_hash`. Their `repr`
    is the table too, as a notebook shows it.
    """

    def __repr__(self) -> str:
        return text(self)

    def __str__(self) -> str:
        """A table of several lines."""
        return text(self)

    def plot(self) -> Any:
        """Draw the result as a matplotlib figure."""
        return figure(self)

    def to_pandas(self) -> Any:
        """The numbers of its table as a `pandas.DataFrame`; what holds for all rows in `attrs`."""
        return data_frame(self)

    def to_xarray(self) -> Any:
        """The same numbers, and the signals that it holds, as an `xarray.Dataset`."""
        return dataset(self)

    def save(self, path: str | Path) -> None:
        """Write the result to an `.npz` file without pickle; `eoi_jax.load` reads it."""
        save(self, path)
