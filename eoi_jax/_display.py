"""How results are printed, drawn and kept: functions that `report/` and the store fill in.

A result is data. It knows neither tables nor figures nor files: `str(result)`, `result.plot()` and
`result.save(path)` ask the function here, which goes by the class of the result.
"""

from functools import singledispatch
from pathlib import Path
from typing import Any


@singledispatch
def text(result: Any) -> str:
    """A result as a table; its fields where no table is registered for its class."""
    return repr(result)


@singledispatch
def figure(result: Any) -> Any:
    """A result as a matplotlib figure."""
    raise TypeError(f"no figure is registered for {type(result).__name__}")


@singledispatch
def save(result: Any, path: str | Path) -> None:
    """A result in a file."""
    raise TypeError(f"{type(result).__name__} cannot be saved to {path}")


@singledispatch
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
