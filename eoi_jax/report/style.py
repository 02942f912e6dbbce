"""Style of all figures: light and dark style sheets, roles of colours, labels, legends.

A figure is dark where the current style of matplotlib is dark, e.g. after
``matplotlib.style.use("dark_background")``, else light.
"""

import functools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from eoi_jax.models.plant import Plant
from eoi_jax.models.units import derivative_unit

_SUPERSCRIPTS = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")

WIDTH = 5.4  # [inch] of a figure of the report: fits a phone, and two side by side a desktop
WIDE = 10.0  # [inch] of a figure of `.plot()`

BASE, ACCENT = 0, 1  # numbers of the series: the declared model, and the result


@functools.cache
def sheet(dark: bool) -> Any:
    """Settings of matplotlib for a theme.

    Args:
        dark: whether the theme is dark.

    Returns:
        For `matplotlib.rc_context`.
    """
    from matplotlib import rc_params_from_file

    folder = Path(__file__).parent
    files = (folder / f"{name}.mplstyle" for name in ("base", "dark" if dark else "light"))
    parts = (rc_params_from_file(file, use_default_template=False) for file in files)
    return MappingProxyType({key: value for part in parts for key, value in part.items()})


@contextmanager
def themed(threshold: float = 0.5) -> Iterator[None]:
    """Apply the sheet of the current theme; ``@themed()`` decorates functions that draw.

    Args:
        threshold: mean of red, green and blue of a background below which it is dark.
    """
    from matplotlib import rc_context, rcParams
    from matplotlib.colors import to_rgb

    dark = float(np.mean(to_rgb(rcParams["figure.facecolor"]))) < threshold
    with rc_context(sheet(dark)):
        yield


def fix_theme(figure: Any) -> Any:
    """The same figure, which keeps its theme wherever it is shown."""
    for axes in figure.axes:
        _fix_ticks(axes)
        for spine in axes.spines.values():
            spine.set_in_layout(False)  # it lies within the ticks, which are measured once then
    return figure


def _fix_ticks(axes: Any) -> None:
    """Set the ticks to the current settings: matplotlib reads those only when it draws."""
    from matplotlib import rcParams

    rc: Any = rcParams  # typed with literal keys
    for axis in ("x", "y"):
        axes.tick_params(
            axis=axis,
            which="both",
            color=rc[f"{axis}tick.color"],
            labelcolor=rc[f"{axis}tick.labelcolor"],
            labelsize=rc[f"{axis}tick.labelsize"],
            width=rc[f"{axis}tick.major.width"],
            grid_color=rc["grid.color"],
            grid_linewidth=rc["grid.linewidth"],
        )
        axes.tick_params(axis=axis, which="major", length=rc[f"{axis}tick.major.size"])


def new_figure(width: float, height: float, nested: bool = False, pad: float = 0.4) -> Any:
    """An empty figure [inch], which `pyplot` does not manage.

    Args:
        width: of the figure.
        height: of the figure.
        nested: whether it holds subfigures, panels that share an axis and lose height to it, so
            that their ticks change, or a legend or colour bar for several panels. Only then panels
            are measured and placed twice, which takes a fifth of the time of a figure.
        pad: around panels with their labels [font size].
    """
    # slow to import, and needed for figures only
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import TightLayoutEngine

    # A rectangle, that of the whole figure by default, would be reached by a second measurement.
    rect: Any = None
    layout = "constrained" if nested else TightLayoutEngine(pad=pad, h_pad=2 * pad, rect=rect)
    return Figure(figsize=(width, height), layout=layout)


def text_colour() -> str:
    """The colour of text, measurements and first passes."""
    from matplotlib import rcParams

    return rcParams["text.color"]


def series(number: int) -> str:
    """The colour of a series, counted from 0, cyclic."""
    from matplotlib import rcParams

    colours = rcParams["axes.prop_cycle"].by_key()["color"]
    colour = colours[number % len(colours)]
    return colour if colour.startswith("#") else f"#{colour}"


# -- axes -------------------------------------------------------------------------------------


def logarithmic(axis: Any) -> None:
    """A logarithmic axis with powers of ten as characters: the sheet switches mathtext off.

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
    """``0.001`` as 10⁻³; 1 to 100, and values between powers, as a number."""
    if value <= 0:
        return ""
    exponent = np.log10(value)
    if abs(exponent - np.rint(exponent)) > 1e-6 or 0 <= np.rint(exponent) <= 2:
        return f"{value:.4g}"
    return "10" + str(int(np.rint(exponent))).translate(_SUPERSCRIPTS)


def legend_above(axes: Any, columns: int = 3) -> None:
    """A legend above the panel, where it hides no data."""
    position = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
    axes.legend(ncols=columns, **position)


def limit(axes: Any, low: float, high: float) -> None:
    """Clip the vertical axis to [low, high], so that a diverging curve does not flatten others."""
    bottom, top = axes.get_ylim()
    axes.set_ylim(max(bottom, low), min(top, high))


# -- labels -----------------------------------------------------------------------------------


def with_unit(name: str, unit: str | None) -> str:
    """``angle [rad]``; the name only without a unit or where it already contains the unit."""
    if not unit or f"[{unit}]" in name:
        return shortened(name)
    return f"{shortened(name)} [{shortened(unit)}]"


def shortened(name: str, length: int = 34) -> str:
    """A name of as many characters as fit beside a panel; a longer one ends in an ellipsis."""
    return name if len(name) <= length else f"{name[: length - 1]}…"


def injection_unit(unit: str | None, degree: int) -> str:
    """The unit of y^(r), e.g. m/s² for a position; empty if the output has no unit."""
    return derivative_unit(unit, degree)


def injection_label(quantity: str, plant: Plant, j: int) -> str:
    """``residual of position [m/s²]`` in two lines, for output `j`."""
    name = plant.outputs[j]
    unit = injection_unit(plant.units.get(name), plant.degrees[j])
    return f"{quantity} of\n{with_unit(name, unit)}"
