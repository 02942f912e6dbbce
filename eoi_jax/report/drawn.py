"""Figures that cost no answer: one that fails is left out, and said."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from eoi_jax._checks import FigureWarning

_T = TypeVar("_T")


def drawn(name: str, make: Callable[[], _T]) -> _T | None:
    """What a function draws; None where that fails.

    Args:
        name: of the figure, for the warning.
        make: draws it, whatever it may raise.

    Warns:
        FigureWarning: it could not be drawn, and why.
    """
    try:
        return make()
    except Exception as error:  # of a library of many hundred thousand lines
        reason = f"{type(error).__name__}: {error}".strip()
        warnings.warn(
            f"the figure `{name}` cannot be drawn and is left out ({reason}); all else is there",
            FigureWarning,
            stacklevel=2,
        )
        return None


def save_drawn(path: Path, make: Callable[[], Any]) -> None:
    """Write a figure to a file named after it, or leave it out; arguments as of `drawn`.

    Args:
        path: of the file.
        make: returns the figure.
    """

    def save() -> bool:
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import

        figure = make()
        # Not `savefig`, which draws everything once more, only to lay it out.
        FigureCanvasAgg(figure).print_png(path)
        return True

    if not drawn(path.stem, save):
        path.unlink(missing_ok=True)
