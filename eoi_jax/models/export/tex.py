"""A model in LaTeX: the equations, and a table of the parameters."""

from collections.abc import Mapping

from eoi_jax.models.equations.expression import Call, Expression, Number, Operation, Symbol
from eoi_jax.models.equations.printer import escaped, latex
from eoi_jax.models.export.names import comment, identifiers
from eoi_jax.models.export.program import Program

_SIGNS = {"≤": r"\le", "≥": r"\ge", "≠": r"\ne"}


def latex_text(model: Program, version: str) -> str:
    """A piece of a document that uses ``amsmath``.

    Args:
        model: what to write.
        version: of this package.
    """
    names = identifiers(model, as_text=True)
    parameters = {one.name: latex(Symbol(names[one.symbol]), {}) for one, _ in model.parameters}
    # Derivatives of an output are shown by dots, not by names of their own.
    shown = {symbol: Symbol(name) for symbol, name in names.items()}
    shown |= {
        one.symbol: Symbol(names[Symbol(one.symbol.name)], one.symbol.order) for one in model.states
    }
    lines = [f"{_written(symbol, shown)} &= {_written(tree, shown)}"
             for symbol, tree in model.definitions]  # fmt: skip
    for one, tree in zip(model.states, model.rates, strict=True):
        own = shown[one.symbol]
        if tree != Symbol(one.symbol.name, one.symbol.order + 1):  # else the next of its chain
            left = latex(Symbol(own.name, own.order + 1), {})
            lines.append(f"{left} &= {_written(tree, shown)}")
    for source, late in model.delays.items():
        own, times = latex(shown[Symbol(source)], {}), " + ".join(parameters[one] for one in late)
        lines.append(rf"&\text{{with }} {own} \text{{ taken at }} t - ({times})")
    lines += [rf"&\text{{set-valued at }} {_written(symbol, shown)} = 0" for symbol in model.rough]
    rows = [
        f"${parameters[one.name]}$ & ${latex(Number(value), {})}$ & {_unit(one.unit)} \\\\"
        for one, value in model.parameters
    ]
    parts = [
        f"% Written by eoi_jax {version}. Needs amsmath.",
        *(r"\[", r"\begin{aligned}", " \\\\\n".join(lines), r"\end{aligned}", r"\]", ""),
        *(r"\begin{tabular}{lrl}", *rows, r"\end{tabular}"),
    ]
    return "\n".join(parts) + "\n"


def _unit(unit: str) -> str:
    return escaped(comment(unit.replace("\\", "/")))


def _written(expression: Expression, shown: Mapping[Symbol, Symbol]) -> str:
    return latex(_readable(expression, shown), {})


def _readable(expression: Expression, shown: Mapping[Symbol, Symbol]) -> Expression:
    """With the names and signs that are shown."""
    match expression:
        case Symbol():
            return shown[expression]
        case Operation(sign="and" | "or" as sign, left=left, right=right):
            return Call(sign, (_readable(left, shown), _readable(right, shown)))
        case Operation(sign=sign, left=left, right=right):
            sides = _readable(left, shown), _readable(right, shown)
            return Operation(_SIGNS.get(sign, sign), *sides)
        case Call(name=name, arguments=arguments):
            parts = tuple(_readable(one, shown) for one in arguments)
            return Call("sqrt" if name == "plain_root" else name, parts)
    return expression
