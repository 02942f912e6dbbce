"""Drawing that may fail: a figure with an error is omitted with a warning."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from eoi_jax._checks import FigureWarning

_T = TypeVar("_T")


def draw_or_warn(name: str, make: Callable[[], _T]) -> _T | None:
    """Call a function that draws; None where it raises an error.

    Args:
        name: of the figure, for the warning.
        make: draws the figure; it may raise any exception.

    Warns:
        FigureWarning: the figure could not be drawn, with the reason.
    """
    try:
        return make()
    except Exception as error:  # of any kind: a figure must not cost the result
        reason = f"{type(error).__name__}: {error}".strip()
        warnings.warn(
            f"the figure `{name}` cannot be drawn and is omitted ({reason}); "
            "the result is complete",
            FigureWarning,
            stacklevel=2,
        )
        return None


def save_figure(path: Path, make: Callable[[], Any]) -> None:
    """Write a figure to a file, or omit it with a warning as `draw_or_warn` does.

    Args:
        path: of the file.
        make: returns the figure.
    """

    def save() -> bool:
        from matplotlib.backends.backend_agg import FigureCanvasAgg  # slow to import

        figure = make()
        # Not `savefig`, which draws the figure a second time only to lay it out.
        FigureCanvasAgg(figure).print_png(path)
        return True

    if not draw_or_warn(path.stem, save):
        path.unlink(missing_ok=True)
