"""One look for all figures: a sheet for both themes, the roles of its colours, labels, legends.

The theme of a figure is that of what surrounds it: dark where matplotlib's own style is dark (such
as ``matplotlib.style.use("dark_background")``), else light.
"""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from eoi_jax.models.plant import Plant, derivative_unit

_LONGEST = 34  # characters of a name in a figure
_DARK = 0.5  # mean of a page's red, green and blue below which it is a dark one
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")

WIDTH = 5.4  # [inch] of a figure of the report: fits a phone, and twice beside itself a desk
WIDE = 10.0  # [inch] of a figure that stands alone

BEFORE, AFTER = 0, 1  # numbers of the series: the declared model, and what was found


@functools.cache
def sheet(dark: bool) -> Any:
    """Settings of matplotlib for one theme.

    Args:
        dark: which.

    Returns:
        For `matplotlib.rc_context`.
    """
    from matplotlib import rc_params_from_file

    folder = Path(__file__).parent
    files = (folder / f"{name}.mplstyle" for name in ("base", "dark" if dark else "light"))
    parts = (rc_params_from_file(file, use_default_template=False) for file in files)
    return MappingProxyType({key: value for part in parts for key, value in part.items()})


@contextmanager
def styled() -> Iterator[None]:
    """The sheet of the theme around it; as ``@styled()`` before a function that draws a figure."""
    from matplotlib import rc_context, rcParams
    from matplotlib.colors import to_rgb

    dark = float(np.mean(to_rgb(rcParams["figure.facecolor"]))) < _DARK
    with rc_context(sheet(dark)):
        yield


def finished(figure: Any) -> Any:
    """The same figure, which now keeps its theme wherever it is shown."""
    for axes in figure.axes:
        _keep_ticks(axes)
    return figure


def _keep_ticks(axes: Any) -> None:
    """Ticks are made when they are drawn, by the settings of then: those of now are handed on."""
    from matplotlib import rcParams

    rc: Any = rcParams  # whose keys a type checker knows one by one
    for which in ("x", "y"):
        axes.tick_params(
            axis=which,
            which="both",
            color=rc[f"{which}tick.color"],
            labelcolor=rc[f"{which}tick.labelcolor"],
            labelsize=rc[f"{which}tick.labelsize"],
            width=rc[f"{which}tick.major.width"],
            grid_color=rc["grid.color"],
            grid_linewidth=rc["grid.linewidth"],
        )
        axes.tick_params(axis=which, which="major", length=rc[f"{which}tick.major.size"])


def new(width: float, height: float) -> Any:
    """An empty figure [inch], which no window of matplotlib's knows of."""
    from matplotlib.figure import Figure  # slow to import, and needed by nothing else

    return Figure(figsize=(width, height), layout="constrained")


def ink() -> str:
    """The colour of text, of a measurement, of a first pass."""
    from matplotlib import rcParams

    return rcParams["text.color"]


def series(number: int) -> str:
    """The colour of a series, counted from 0; after the last the first comes again."""
    from matplotlib import rcParams

    colours = rcParams["axes.prop_cycle"].by_key()["color"]
    colour = colours[number % len(colours)]
    return colour if colour.startswith("#") else f"#{colour}"


# -- axes -------------------------------------------------------------------------------------


def logarithmic(axis: Any) -> None:
    """Powers of ten on an axis, in characters: the sheet has switched mathematics off.

    Args:
        axis: ``axes.xaxis`` or ``axes.yaxis``.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    setter = axis.axes.set_xscale if axis.axis_name == "x" else axis.axes.set_yscale
    setter("log")
    axis.set_major_locator(LogLocator(numticks=7))
    axis.set_major_formatter(FuncFormatter(lambda value, _: power(value)))
    axis.set_minor_formatter(NullFormatter())


def power(value: float) -> str:
    """``0.001`` as 10⁻³; what lies between powers, and 1 to 100, as a number."""
    if value <= 0:
        return ""
    exponent = np.log10(value)
    if abs(exponent - np.rint(exponent)) > 1e-6 or 0 <= np.rint(exponent) <= 2:
        return f"{value:.4g}"
    return "10" + str(int(np.rint(exponent))).translate(_RAISED)


def legend_above(axes: Any, columns: int = 3) -> None:
    """Above the panel: wherever it stood inside, it would hide data."""
    place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
    axes.legend(ncols=columns, **place)


def limit(axes: Any, low: float, high: float) -> None:
    """At most these ends of the vertical axis, so that one curve cannot flatten the rest."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low), min(top, high))


# -- labels -----------------------------------------------------------------------------------


def with_unit(name: str, unit: str | None) -> str:
    """``angle [rad]``; without a unit, or where a column's name holds it already, the name."""
    if not unit or f"[{unit}]" in name:
        return shortened(name)
    return f"{shortened(name)} [{shortened(unit)}]"


def shortened(name: str) -> str:
    """A name as it fits beside a panel: a long one ends in an ellipsis."""
    return name if len(name) <= _LONGEST else f"{name[: _LONGEST - 1]}…"


def injection_unit(unit: str | None, degree: int) -> str:
    """The unit of y^(r), e.g. m/s² for a position; empty if the output has none."""
    return derivative_unit(unit, degree)


def injected(what: str, plant: Plant, j: int) -> str:
    """``residual of position [m/s²]`` in two lines, for output `j`."""
    name = plant.outputs[j]
    unit = injection_unit(plant.units.get(name), plant.degrees[j])
    return f"{what} of\n{with_unit(name, unit)}"
