"""The report of a run as one self-contained HTML page."""

import base64
import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

from eoi_jax.report.contents import Contents, ReportFigure
from eoi_jax.report.drawing import draw_or_warn
from eoi_jax.report.mathml import equation_mathml
from eoi_jax.report.svg import inline, variables

# Colours besides those of the figures: cards, small text, badges of good and bad checks.
_LIGHT = {"--card": "#f4f6f8", "--muted": "#5a636f", "--good": "#0b6b4b", "--attention": "#a94400"}
_DARK = {"--card": "#1e232a", "--muted": "#a3abb7", "--good": "#5fd0a5", "--attention": "#f5a15f"}


def page(
    summary: Mapping[str, Any], contents: Contents, command: str, config: str, verb: str
) -> str:
    """The page of a run.

    Args:
        summary: the run's JSON object.
        contents: parts that differ between kinds of runs.
        command: the command that repeats the run.
        config: text of its config.
        verb: name of the command.

    Returns:
        HTML; names and units are escaped, and nothing is loaded from a network.
    """
    from jinja2 import Environment, PackageLoader
    from markupsafe import Markup

    templates = Environment(loader=PackageLoader("eoi_jax.report"), autoescape=True)
    templates.filters["prose"] = _prose
    loader = templates.loader
    assert loader is not None
    script, style = (loader.get_source(templates, f"page.{kind}")[0] for kind in ("js", "css"))
    # Only the script of the page may run, whatever a name contains.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    equation = summary.get("equation")
    figures, failures = _figures(contents.figures)
    values = {
        "name": summary["name"],
        "verb": verb,
        "status": summary["status"]["code"].replace("_", " "),
        "ok": summary["status"]["code"] != "unexplained",
        "answer": summary["answer"],
        "tiles": contents.tiles,
        "tables": contents.tables,
        "final_tables": contents.final_tables,
        "checks": contents.checks,
        "notes": (*contents.notes, *failures),
        "added": contents.added,
        "equations": [Markup(formula) for formula in _equations(equation)],
        "equation_title": "The augmented model" if contents.added else "The model",
        "figures": figures,
        "records": _records(summary),
        "versions": summary["versions"],
        "command": command,
        "config": config,
    }
    return templates.get_template("page.html").render(
        page=values,
        style=Markup(style),
        script=Markup(script),
        script_hash=f"sha256-{digest}",
        light=Markup(_rules({**variables(dark=False), **_LIGHT})),
        dark=Markup(_rules({**variables(dark=True), **_DARK})),
    )


def _figures(items: Sequence[ReportFigure]) -> tuple[list[dict[str, Any]], list[str]]:
    """Figures that can be drawn, and a sentence for each that cannot."""
    from markupsafe import Markup

    figures, failures = [], []
    for item in items:
        prefix = item.name.replace("_", "")
        svg = draw_or_warn(
            item.name, lambda item=item, prefix=prefix: inline(item.figure(), prefix, item.title)
        )
        if svg is None:
            failures.append(f"The figure `{item.title}` could not be drawn and is omitted.")
            continue
        texts = {"name": item.name, "title": item.title, "caption": item.caption}
        figures.append({**texts, "svg": Markup(svg)})
    return figures, failures


def _prose(text: str) -> Any:
    """HTML of a text: code between backquotes, no line break between a number and its unit."""
    from markupsafe import Markup, escape

    joined = re.sub(r"(?<=[\d±]) (?=\S)", "\u00a0", text)
    parts = re.split(r"`([^`]+)`", joined)
    marked = [
        Markup("<code>{}</code>").format(part) if i % 2 else escape(part)
        for i, part in enumerate(parts)
    ]
    return Markup("").join(marked)


def _rules(values: Mapping[str, str]) -> str:
    return " ".join(f"{name}: {value};" for name, value in values.items())


def _equations(equation: Mapping[str, Any] | None) -> list[str]:
    """The equation with names and with values; as plain text where it cannot be converted."""
    from markupsafe import Markup

    formulas: list[str] = []
    if equation is None:
        return formulas
    for kind, plain in (("names", "text"), ("values", "values")):
        formula = equation_mathml(equation["lines"][kind], equation["changes"][kind])
        formulas.append(formula or Markup("<pre>{}</pre>").format(equation[plain]))
    return formulas


def _records(summary: Mapping[str, Any]) -> list[tuple[str, ...]]:
    kinds = (("the fit", "records"), ("held out", "held_out_records"))
    return [
        (
            record["name"],
            use,
            f"{record['samples']}",
            f"{record['sample_period']:.6g}",
            record["hash"],
        )
        for use, key in kinds
        for record in summary[key]
    ]
