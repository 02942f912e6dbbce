"""The report of a run as one self-contained HTML page."""

import base64
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

from eoi_jax.report.charts import chart_data
from eoi_jax.report.contents import Contents, ReportFigure
from eoi_jax.report.drawing import draw_or_warn
from eoi_jax.report.mathml import equation_mathml
from eoi_jax.report.svg import inline, variables

# What the status codes tell, and whether that is good; other codes need attention.
_BADGES = {
    "complete": ("good", "complete"),
    "nothing_missing": ("good", "nothing missing"),
    "partial": ("note", "partial: more than noise is left"),
    "converged": ("good", "converged"),
}
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
    figures, failures = _figures(contents.figures)
    charts = _charts(contents.figures, {figure["name"] for figure in figures})
    script, style = _code(charts is not None)
    # Only the script of the page may run, whatever a name contains.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    equation = summary.get("equation")
    values = {
        "name": summary["name"],
        "verb": verb,
        **_outcome(summary),
        "badge": contents.badge,
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
        charts=Markup(_json(charts)) if charts else "",
        script=Markup(script),
        script_hash=f"sha256-{digest}",
        light=Markup(_rules({**variables(dark=False), **_LIGHT})),
        dark=Markup(_rules({**variables(dark=True), **_DARK})),
    )


def _outcome(summary: Mapping[str, Any]) -> dict[str, str]:
    """The answer, its badge, and what the status says beyond the answer."""
    code, message = summary["status"]["code"], summary["status"].get("message", "")
    state, label = _BADGES.get(code, ("attention", code.replace("_", " ")))
    if message in summary["answer"]:
        message = ""
    message = message[:1].upper() + message[1:]
    if message and not message.endswith("."):
        message += "."
    return {"answer": summary["answer"], "status": label, "state": state, "message": message}


def _code(with_charts: bool) -> tuple[str, str]:
    """The script and the style of the page, with uPlot where it has charts."""
    templates = files("eoi_jax.report") / "templates"
    library = files("eoi_jax.report") / "uplot"
    scripts, styles = [templates / "page.js"], [templates / "page.css"]
    if with_charts:
        scripts += [library / "uPlot.iife.min.js", templates / "charts.js"]
        styles.insert(0, library / "uPlot.min.css")
    script, style = (
        "\n".join(file.read_text(encoding="utf-8") for file in parts) for parts in (scripts, styles)
    )
    return script, style


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


def _charts(items: Sequence[ReportFigure], drawn: set[str]) -> dict[str, Any] | None:
    """Data of the charts; a chart that fails leaves its figure."""
    charts = {}
    for item in items:
        if item.chart is not None and item.name in drawn:
            content = draw_or_warn(item.name, item.chart)
            if content is not None:
                charts[item.name] = content
    return chart_data(charts)


def _json(data: Mapping[str, Any]) -> str:
    """JSON within a `script` element, which no text in it can end."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.replace("<", "\\u003c")


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
