"""The report of a run as one HTML page that needs nothing but itself."""

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from eoi_jax.report.contents import Contents, Shown
from eoi_jax.report.drawn import drawn
from eoi_jax.report.mathml import equation_mathml
from eoi_jax.report.svg import inline, variables

# Besides the figures' own colours: cards, small text, a badge that is well and one that is not.
_LIGHT = {"--card": "#f4f6f8", "--muted": "#5a636f", "--good": "#0b6b4b", "--attention": "#a94400"}
_DARK = {"--card": "#1e232a", "--muted": "#a3abb7", "--good": "#5fd0a5", "--attention": "#f5a15f"}


def page(
    summary: Mapping[str, Any], contents: Contents, command: str, config: str, verb: str
) -> str:
    """The whole page.

    Args:
        summary: the run's JSON object.
        contents: what differs between kinds of runs.
        command: that repeats the run.
        config: text of its config.
        verb: of the command.

    Returns:
        HTML; every name and unit in it is text, and it asks nothing of a network.
    """
    from jinja2 import Environment, PackageLoader
    from markupsafe import Markup

    templates = Environment(loader=PackageLoader("eoi_jax.report"), autoescape=True)
    templates.filters["prose"] = _prose
    loader = templates.loader
    assert loader is not None
    script, style = (loader.get_source(templates, f"page.{kind}")[0] for kind in ("js", "css"))
    # Only the page's own script may run, whatever a name tries.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    equation = summary.get("equation")
    figures, lost = _figures(contents.shown)
    parts = {
        "name": summary["name"],
        "verb": verb,
        "status": summary["status"]["code"].replace("_", " "),
        "ok": summary["status"]["code"] != "unexplained",
        "answer": summary["answer"],
        "tiles": contents.tiles,
        "tables": contents.tables,
        "beneath": contents.beneath,
        "checks": contents.checks,
        "notes": (*contents.notes, *lost),
        "added": contents.added,
        "equations": [Markup(one) for one in _equations(equation)],
        "equation_title": "The model with what it lacked" if contents.added else "The model",
        "figures": figures,
        "records": _records(summary),
        "versions": summary["versions"],
        "command": command,
        "config": config,
    }
    return templates.get_template("page.html").render(
        page=parts,
        style=Markup(style),
        script=Markup(script),
        script_hash=f"sha256-{digest}",
        light=Markup(_rules({**variables(dark=False), **_LIGHT})),
        dark=Markup(_rules({**variables(dark=True), **_DARK})),
    )


def _figures(shown: Sequence[Shown]) -> tuple[list[dict[str, Any]], list[str]]:
    """Those that can be drawn, and a sentence for each that cannot."""
    from markupsafe import Markup

    figures, lost = [], []
    for one in shown:
        svg = drawn(
            one.name, lambda one=one: inline(one.figure(), one.name.replace("_", ""), one.title)
        )
        if svg is None:
            lost.append(f"The figure `{one.title}` could not be drawn and is left out.")
            continue
        parts = {"name": one.name, "title": one.title, "caption": one.caption}
        figures.append({**parts, "svg": Markup(svg)})
    return figures, lost


def _prose(text: str) -> Any:
    """`Code` between backquotes, and numbers that stay with their units."""
    from markupsafe import Markup, escape

    tied = re.sub(r"(?<=[\d±]) (?=\S)", "\u00a0", text)
    parts = re.split(r"`([^`]+)`", tied)
    marked = [
        Markup("<code>{}</code>").format(one) if i % 2 else escape(one)
        for i, one in enumerate(parts)
    ]
    return Markup("").join(marked)


def _rules(values: Mapping[str, str]) -> str:
    return " ".join(f"{name}: {value};" for name, value in values.items())


def _equations(equation: Mapping[str, Any] | None) -> list[str]:
    """With names, then with values; as plain text where a browser could not set them."""
    from markupsafe import Markup

    found: list[str] = []
    if equation is None:
        return found
    for kind, plain in (("names", "text"), ("values", "values")):
        formula = equation_mathml(equation["lines"][kind], equation["changes"][kind])
        found.append(formula or Markup("<pre>{}</pre>").format(equation[plain]))
    return found


def _records(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    kinds = (("the fit", "records"), ("held out", "held_out_records"))
    return [
        (one["name"], used, f"{one['samples']}", f"{one['sample_period']:.6g}", one["hash"])
        for used, key in kinds
        for one in summary[key]
    ]
