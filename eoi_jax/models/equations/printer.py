"""Small formulas, and how they are written: as plain text and in LaTeX."""

import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eoi_jax.models.equations.expression import Call as Call
from eoi_jax.models.equations.expression import Expression as Expression
from eoi_jax.models.equations.expression import Number as Number
from eoi_jax.models.equations.expression import Operation as Operation
from eoi_jax.models.equations.expression import Symbol as Symbol

# How tightly an operation binds.
_COMPARISON, _SUM, _PRODUCT, _POWER, _ATOM = range(5)


@dataclass(frozen=True)
class _Notation:
    """What differs between text and LaTeX."""

    symbol: Callable[[Symbol], str]
    number: Callable[[float], str]
    product: Callable[[str, str], str]
    power: Callable[[str, str], str]
    quotient: str | None
    call: Callable[[str, list[str]], str]
    brackets: tuple[str, str]


def text(expression: Expression, values: Mapping[str, float]) -> str:
    """As one line of text.

    Args:
        expression: what to write.
        values: of parameters that are to be shown as numbers.
    """
    return _write(_valued(expression, values), _TEXT)[0]


def latex(expression: Expression, values: Mapping[str, float]) -> str:
    """In LaTeX, for mathematics mode; arguments as in `text`."""
    return _write(_valued(expression, values), _LATEX)[0]


def _valued(expression: Expression, values: Mapping[str, float]) -> Expression:
    match expression:
        case Symbol(name=name, parameter=True) if name in values:
            return Number(values[name])
        case Operation(left=left, right=right):
            return replace(expression, left=_valued(left, values), right=_valued(right, values))
        case Call(arguments=arguments):
            return replace(expression, arguments=tuple(_valued(one, values) for one in arguments))
    return expression


def _write(expression: Expression, how: _Notation) -> tuple[str, int]:
    """What is written, and how tightly it binds."""
    match expression:
        case Number(value=value):
            return how.number(value), _ATOM if value >= 0 else _SUM
        case Symbol():
            return how.symbol(expression), _ATOM
        case Call(name=name, arguments=arguments):
            return how.call(name, [_write(one, how)[0] for one in arguments]), _ATOM
        case Operation(sign="+" | "-"):
            return _sum(expression, how), _SUM
        case Operation(sign="*", left=left, right=right):
            first = _within(left, how, _PRODUCT)
            return how.product(first, _within(right, how, _POWER)), _PRODUCT
        case Operation(sign="/", left=left, right=right):
            if how.quotient is not None:
                over, under = _write(left, how)[0], _write(right, how)[0]
                return how.quotient % (over, under), _POWER
            return f"{_within(left, how, _PRODUCT)}/{_within(right, how, _POWER)}", _PRODUCT
        case Operation(sign="^", left=left, right=right):
            return how.power(_within(left, how, _ATOM), _write(right, how)[0]), _POWER
        case Operation(sign=sign, left=left, right=right):
            return f"{_write(left, how)[0]} {sign} {_write(right, how)[0]}", _COMPARISON
    raise TypeError(expression)


def _within(expression: Expression, how: _Notation, binding: int) -> str:
    """An operand, in brackets where it binds less tightly than what it stands in."""
    written, own = _write(expression, how)
    return written if own >= binding else how.brackets[0] + written + how.brackets[1]


def _sum(expression: Expression, how: _Notation) -> str:
    shown = ""
    for negative, term in _terms(expression, False):
        sign = "-" if negative else "+"
        written = _within(term, how, _PRODUCT)
        if shown:
            shown += f" {sign} {written}"
        else:
            shown = ("-" if negative else "") + written
    return shown or how.number(0.0)


def _terms(expression: Expression, negative: bool) -> list[tuple[bool, Expression]]:
    """The terms of a sum, each with whether it is taken away; signs of values are drawn out."""
    match expression:
        case Operation(sign="+" | "-" as sign, left=left, right=right):
            first = [] if left == Number(0.0) else _terms(left, negative)
            return first + _terms(right, negative != (sign == "-"))
        case Number(value=value) if value < 0:
            return [(not negative, Number(-value))]
        case Operation(sign="*" | "/", left=left):
            # -(-3·y), (-a)·y: the sign of the first factor is the sign of the term.
            ((inner, first),) = terms if len(terms := _terms(left, False)) == 1 else [(False, left)]
            return [(negative != inner, replace(expression, left=first))]
    return [(negative, expression)]


# -- values -----------------------------------------------------------------------------------

_COMMON = (
    "sin",
    "cos",
    "tan",
    "exp",
    "log",
    "sqrt",
    "sign",
    "sinh",
    "cosh",
    "tanh",
    "abs",
    "where",
)
_FUNCTIONS: dict[str, Callable[..., Any]] = {name: getattr(np, name) for name in _COMMON} | {
    "clip": np.clip,
    "maximum": np.maximum,
    "minimum": np.minimum,
    "atan": np.arctan,
    "atan2": np.arctan2,
}
_OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "^": operator.pow,
    "<": operator.lt,
    "≤": operator.le,
    ">": operator.gt,
    "≥": operator.ge,
}


def evaluate(expression: Expression, values: Mapping[Symbol, float]) -> float | None:
    """The value of a formula, or None where it holds a function that is not a common one.

    Args:
        expression: what to work out.
        values: of its symbols.
    """
    match expression:
        case Number(value=value):
            return value
        case Symbol(name="pi"):
            return float(np.pi)
        case Symbol():
            return values[expression]
        case Operation(sign=sign, left=left, right=right):
            function, parts = _OPERATORS[sign], (left, right)
        case Call(name=name, arguments=parts):
            function = _FUNCTIONS.get(name)
    arguments = [evaluate(one, values) for one in parts]
    if function is None or any(one is None for one in arguments):
        return None
    return float(function(*arguments))


# -- text -------------------------------------------------------------------------------------

_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def _text_symbol(symbol: Symbol) -> str:
    return ("π" if symbol.name == "pi" else symbol.name) + "'" * symbol.order


def _text_number(value: float) -> str:
    return f"{value:.5g}"


def _text_power(base: str, exponent: str) -> str:
    whole = re.fullmatch(r"-?\d+", exponent)
    if whole:
        return base + exponent.translate(_RAISED)
    return f"{base}^{exponent}" if re.fullmatch(r"[\w.]+", exponent) else f"{base}^({exponent})"


def _text_call(name: str, arguments: list[str]) -> str:
    return f"|{arguments[0]}|" if name == "abs" else f"{name}({', '.join(arguments)})"


_TEXT = _Notation(
    _text_symbol,
    _text_number,
    lambda left, right: f"{left}·{right}",
    _text_power,
    None,
    _text_call,
    ("(", ")"),
)

# -- LaTeX ------------------------------------------------------------------------------------

_GREEK = (
    *("alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "kappa", "lambda"),
    *("mu", "nu", "xi", "pi", "rho", "sigma", "tau", "phi", "chi", "psi", "omega"),
)
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{one: f"\\{one}" for one in "{}$&#%_"},
}
_KNOWN = ("sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh", "max", "min")


def escaped(text: str) -> str:
    """A text for LaTeX outside of mathematics: nothing in it is a command, or ends the line.

    Args:
        text: any.
    """
    return "".join(_SPECIAL.get(one, one if one.isprintable() else " ") for one in text)


def name_latex(name: str) -> str:
    """A name in LaTeX: ``alpha`` as α, ``a2`` and ``position_1`` with a subscript.

    Args:
        name: an identifier; any other text is set as it stands.
    """
    if not re.fullmatch(r"\w+", name):
        return rf"\text{{{escaped(name)}}}"
    parts = re.fullmatch(r"(.*?[^\d_])_?(\d+)", name)
    base, subscript = (parts[1], f"_{{{parts[2]}}}") if parts else (name, "")
    if base in _GREEK:
        return rf"\{base}{subscript}"
    if len(base) == 1:
        return base + subscript
    return rf"\mathrm{{{base.replace('_', chr(92) + '_')}}}{subscript}"


def _latex_symbol(symbol: Symbol) -> str:
    base = name_latex(symbol.name)
    dots = {0: "%s", 1: r"\dot{%s}", 2: r"\ddot{%s}"}
    return dots.get(symbol.order, rf"%s^{{({symbol.order})}}") % base


def _latex_number(value: float) -> str:
    mantissa, _, exponent = f"{value:.5g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def _latex_product(left: str, right: str) -> str:
    # Two numbers side by side would read as one.
    return rf"{left} \cdot {right}" if right[:1].isdigit() else rf"{left}\,{right}"


def _latex_call(name: str, arguments: list[str]) -> str:
    if name == "abs":
        return rf"\left|{arguments[0]}\right|"
    if name == "sqrt":
        return rf"\sqrt{{{arguments[0]}}}"
    if name == "where" and len(arguments) == 3:
        condition, first, second = arguments
        ways = rf"{first} & {condition} \\ {second} & \text{{otherwise}}"
        return rf"\begin{{cases}} {ways} \end{{cases}}"
    head = (
        rf"\{name}" if name in _KNOWN else rf"\operatorname{{{name.replace('_', chr(92) + '_')}}}"
    )
    return rf"{head}\left({', '.join(arguments)}\right)"


_LATEX = _Notation(
    _latex_symbol,
    _latex_number,
    _latex_product,
    lambda base, exponent: f"{base}^{{{exponent}}}",
    r"\frac{%s}{%s}",
    _latex_call,
    (r"\left(", r"\right)"),
)
