"""A model in LaTeX: the equations, and a table of the parameters."""

from collections.abc import Sequence
from dataclasses import replace

from eoi_jax.models.equations.expression import Number, Symbol
from eoi_jax.models.equations.printer import LATEX, escaped, written
from eoi_jax.models.export.names import comment, identifiers
from eoi_jax.models.export.program import Program


def latex_text(
    model: Program, version: str, equations: Sequence[tuple[str, str]] | None = None
) -> str:
    """A piece of a document that uses ``amsmath``.

    Args:
        model: what to write.
        version: of this package.
        equations: left and right sides in LaTeX, where the model's formulas are not to be read, as
            solutions of linear systems; None: those formulas.
    """
    names = identifiers(model, as_text=True)
    # Derivatives of an output are shown by dots, not by names of their own.
    states = {variable.symbol for variable in model.states}

    def symbol_latex(symbol: Symbol) -> str:
        base, order = (Symbol(symbol.name), symbol.order) if symbol in states else (symbol, 0)
        return LATEX.symbol(Symbol(names[base], order))

    notation = replace(LATEX, symbol=symbol_latex)
    parameters = {variable.name: symbol_latex(variable.symbol) for variable, _ in model.parameters}
    if equations is None:
        equations = [
            (symbol_latex(symbol), written(tree, notation))
            for symbol, tree in (*model.definitions, *model.output_definitions)
        ]
        for variable, tree in zip(model.states, model.rates, strict=True):
            base, order = Symbol(variable.symbol.name), variable.symbol.order + 1
            if tree != Symbol(base.name, order):  # else the next of its chain
                lhs = LATEX.symbol(Symbol(names[base], order))
                equations.append((lhs, written(tree, notation)))
        for variable, tree in zip(model.outputs, model.output_formulas, strict=True):
            equations.append((symbol_latex(variable.symbol), written(tree, notation)))
    lines = [f"{lhs} &= {rhs}" for lhs, rhs in equations]
    for source, delays in model.delays.items():
        delayed, times = symbol_latex(Symbol(source)), " + ".join(parameters[d] for d in delays)
        lines.append(rf"&\text{{with }} {delayed} \text{{ taken at }} t - ({times})")
    for source, limits in model.limits.items():
        limited = symbol_latex(Symbol(source))
        lines += [rf"&\text{{{_LIMITED[kind]} }} {limited} \text{{: }} {parameters[name]}"
                  for kind, name in limits]  # fmt: skip
    lines += [rf"&\text{{set-valued at }} {symbol_latex(symbol)} = 0" for symbol in model.rough]
    rows = [
        f"${parameters[variable.name]}$ & ${written(Number(value), LATEX)}$ & "
        f"{_unit(variable.unit)} \\\\"
        for variable, value in model.parameters
    ]
    parts = [
        f"% Written by eoi_jax {version}. Needs amsmath.",
        *(r"\[", r"\begin{aligned}", " \\\\\n".join(lines), r"\end{aligned}", r"\]", ""),
        *(r"\begin{tabular}{lrl}", *rows, r"\end{tabular}"),
    ]
    return "\n".join(parts) + "\n"


_LIMITED = {"rate_limit": "limit of the rate of", "input_play": "play before"}


def _unit(unit: str) -> str:
    return escaped(comment(unit.replace("\\", "/")))
