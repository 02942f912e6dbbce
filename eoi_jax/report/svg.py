"""A figure as SVG that uses the colours of the page around it."""

import io
import re
from html import escape
from typing import Any

from eoi_jax.report.style import power, sheet

_COLOUR_SETTINGS = ("text.color", "axes.edgecolor", "grid.color", "figure.facecolor")
_COLOUR_NAMES = ("ink", "edge", "grid", "page")


def variables(dark: bool) -> dict[str, str]:
    """Colours of a theme as CSS variables: ``--ink``, ``--s0`` for the first series, ….

    Args:
        dark: whether the theme is dark.

    Returns:
        Colours (``#rrggbb``) by name.
    """
    settings = sheet(dark)
    colours = [settings[key] for key in _COLOUR_SETTINGS]
    named = dict(zip((f"--{name}" for name in _COLOUR_NAMES), colours, strict=True))
    cycle = settings["axes.prop_cycle"].by_key()["color"]
    named |= {f"--s{i}": colour for i, colour in enumerate(cycle)}
    return {name: f"#{colour.removeprefix('#').lower()}" for name, colour in named.items()}


def inline(figure: Any, name: str, title: str) -> str:
    """A figure of the light theme as an SVG element; text stays text.

    Args:
        figure: drawn under the light sheet.
        name: prefix of its identifiers, unique in the page; letters and digits.
        title: text for screen readers.

    Returns:
        One ``<svg>`` element.
    """
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    file = io.StringIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        for artist in (figure, *figure.subfigs, *figure.axes):
            artist.patch.set_visible(False)
        # Not `savefig`, which draws the figure twice to lay it out.
        FigureCanvasSVG(figure).print_svg(file, metadata=metadata)
    svg = file.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r' id="', f' id="{name}-', svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r' (d|x|y)="[^"]*"', _rounded, svg)
    svg = re.sub(r"'DejaVu Sans'(, [^;\"]+)?, sans-serif", "sans-serif", svg)
    for variable, colour in variables(dark=False).items():
        svg = svg.replace(colour, f"var({variable})")
    # The factor above an axis: ×10⁻³ instead of 1e−3.
    svg = re.sub(r">1e([−-]?\d+)<", _factor, svg)
    view = re.search(r'viewBox="[^"]*"', svg)
    head = f'<svg role="img" aria-label="{escape(title)}" {view[0] if view else ""}'
    head += ' xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink">'
    return re.sub(r"<svg[^>]*>", lambda _: head, svg, count=1).strip()


def _factor(offset: re.Match[str]) -> str:
    return f">×{power(float('1e' + offset[1].replace('−', '-')))}<"


def _rounded(attribute: re.Match[str], decimals: int = 2) -> str:
    """Coordinates of an attribute, in units of about a pixel, with so many decimals."""

    def shorten(number: re.Match[str]) -> str:
        return f"{float(number[0]):.{decimals}f}".rstrip("0").rstrip(".")

    return re.sub(r"-?\d+\.\d{3,}", shorten, attribute[0])
