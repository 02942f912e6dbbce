"""A figure as SVG that takes its colours from the page that it stands in."""

import io
import re
from html import escape
from typing import Any

from eoi_jax.report.style import power, sheet

_DECIMALS = 2  # of coordinates; a unit is about a pixel
_PLAIN = ("text.color", "axes.edgecolor", "grid.color", "figure.facecolor")
_NAMES = ("ink", "edge", "grid", "page")


def variables(dark: bool) -> dict[str, str]:
    """Colours of a theme as variables of a page: ``--ink``, ``--s0`` for the first series, ….

    Args:
        dark: which theme.

    Returns:
        Colours (``#rrggbb``) by name.
    """
    settings = sheet(dark)
    colours = [settings[key] for key in _PLAIN]
    named = dict(zip((f"--{name}" for name in _NAMES), colours, strict=True))
    cycle = settings["axes.prop_cycle"].by_key()["color"]
    named |= {f"--s{i}": colour for i, colour in enumerate(cycle)}
    return {name: f"#{colour.removeprefix('#').lower()}" for name, colour in named.items()}


def inline(figure: Any, name: str, title: str) -> str:
    """A light figure as an element of a page; text stays text.

    Args:
        figure: drawn under the light sheet.
        name: makes its identifiers unique in the page; letters and digits.
        title: read out by screen readers.

    Returns:
        One ``<svg>`` element.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    file = io.StringIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        for part in (figure, *figure.subfigs, *figure.axes):
            part.patch.set_visible(False)
        # Not `savefig`, which draws everything once more, only to lay it out.
        FigureCanvasSVG(figure).print_svg(file, metadata=metadata)
    drawn = file.getvalue()
    drawn = drawn[drawn.index("<svg") :]
    drawn = re.sub(r"<metadata>.*?</metadata>", "", drawn, flags=re.DOTALL)
    drawn = re.sub(r' id="', f' id="{name}-', drawn)
    drawn = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", drawn)
    drawn = re.sub(r' (d|x|y)="[^"]*"', _rounded, drawn)
    drawn = re.sub(r"'DejaVu Sans'(, [^;\"]+)?, sans-serif", "sans-serif", drawn)
    for variable, colour in variables(dark=False).items():
        drawn = drawn.replace(colour, f"var({variable})")
    # The factor that matplotlib sets above an axis, as it is written by hand.
    drawn = re.sub(r">1e([−-]?\d+)<", _factor, drawn)
    view = re.search(r'viewBox="[^"]*"', drawn)
    head = f'<svg role="img" aria-label="{escape(title)}" {view[0] if view else ""}'
    head += ' xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return re.sub(r"<svg[^>]*>", lambda _: head, drawn, count=1).strip()


def _factor(offset: re.Match[str]) -> str:
    return f">×{power(float('1e' + offset[1].replace('−', '-')))}<"


def _rounded(attribute: re.Match[str]) -> str:
    return re.sub(
        r"-?\d+\.\d{3,}", lambda one: f"{float(one[0]):.{_DECIMALS}f}".rstrip("0").rstrip("."),
        attribute[0],
    )  # fmt: skip
