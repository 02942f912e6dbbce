"""Formulas as written: one printer, and the notations of plain text and of LaTeX.

The program languages have theirs in `models/export`; what a notation has to say is in `Notation`.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from eoi_jax.models.equations.expression import (
    COMPARISONS,
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
)

# How tightly an operation binds, in all notations alike.
LOGIC, COMPARISON, SUM, PRODUCT, POWER, ATOM = range(6)


@dataclass(frozen=True)
class Infix:
    """How an operation on two operands is written.

    Attributes:
        form: of the operands' texts.
        lhs, rhs: how tightly the operand on that side must bind to need no brackets.
        binding: how tightly the result binds.
    """

    form: Callable[[str, str], str]
    lhs: int
    rhs: int
    binding: int


@dataclass(frozen=True)
class Notation:
    """How formulas are written.

    Attributes:
        operations: by sign; sums and differences are alike everywhere.
        functions: templates of the arguments, by name; other functions are called by `head`.
        symbol: how a name is written.
        number: how a value is written.
        head: how the name of a function is written.
        brackets: around what would bind too loosely.
        for_reading: whether products are in a row, ``k·x·x`` is a power, and a number that is 1
            where a condition holds and 0 elsewhere is the condition in square brackets.
        cases: of pairs of value and condition, and of the value otherwise; None: nested calls.
    """

    operations: Mapping[str, Infix]
    functions: Mapping[str, str] = field(default_factory=dict)
    symbol: Callable[[Symbol], str] = str
    number: Callable[[float], str] = repr
    head: Callable[[str], str] = str
    brackets: tuple[str, str] = ("(", ")")
    for_reading: bool = False
    cases: Callable[[Sequence[tuple[str, str]], str], str] | None = None


def text(expression: Expression, values: Mapping[str, float]) -> str:
    """As one line of text.

    Args:
        expression: what to write.
        values: of parameters that are to be shown as numbers.
    """
    return written(valued(expression, values), TEXT)


def latex(expression: Expression, values: Mapping[str, float]) -> str:
    """In LaTeX, for mathematics mode; arguments as in `text`."""
    return written(valued(expression, values), LATEX)


def valued(expression: Expression, values: Mapping[str, float]) -> Expression:
    """A formula with values in place of parameters.

    Args:
        expression: any.
        values: by name; parameters without one stay.
    """
    match expression:
        case Symbol(name=name, parameter=True) if name in values:
            return Number(values[name])
        case Operation(lhs=lhs, rhs=rhs):
            return replace(expression, lhs=valued(lhs, values), rhs=valued(rhs, values))
        case Call(arguments=arguments):
            return replace(expression, arguments=tuple(valued(part, values) for part in arguments))
    return expression


def written(expression: Expression, notation: Notation) -> str:
    """A formula in a notation.

    Args:
        expression: what to write.
        notation: `TEXT`, `LATEX`, or that of a language.
    """
    return _write(expression, notation)[0]


def written_term(expression: Expression, notation: Notation) -> str:
    """A formula as what follows in a sum: ``- k·y``, ``+ a·sin(t) + b·cos(t)``.

    Args:
        expression: what is added.
        notation: `TEXT` or `LATEX`.
    """
    return " ".join(
        f"{'-' if negative else '+'} {_operand(term, notation, PRODUCT)}"
        for negative, term in _terms(expression, False)
    )


def _write(expression: Expression, notation: Notation) -> tuple[str, int]:
    """The text of a formula, and how tightly it binds."""
    match expression:
        case Number(value=value):
            return _number(value, notation)
        case Symbol():
            return notation.symbol(expression), ATOM
        case Operation(sign="+" | "-"):
            return _sum(expression, notation), SUM
        case Operation(sign="*" | "/") if _terms(expression, False)[0][0]:
            return _sum(expression, notation), SUM  # of one term, with a minus
        case Operation(sign="*") if notation.for_reading:
            return _infix(_with_powers(_in_a_row(expression)), notation)
        case Operation():
            return _infix(expression, notation)
        case Call(name="where"):
            return _choice(expression, notation), ATOM
        case Call(name=name, arguments=arguments):
            return _call(name, [_write(part, notation)[0] for part in arguments], notation), ATOM
    raise TypeError(expression)


def _operand(expression: Expression, notation: Notation, binding: int) -> str:
    """An operand, in brackets if it binds less tightly than the operation around it."""
    operand, tightness = _write(expression, notation)
    return (
        operand if tightness >= binding else notation.brackets[0] + operand + notation.brackets[1]
    )


def _number(value: float, notation: Notation) -> tuple[str, int]:
    digits = notation.number(value)
    if value < 0:
        return digits, SUM
    if "/" in digits:
        return digits, PRODUCT
    return digits, ATOM if re.fullmatch(r"[\w.+-]+|\\\w+", digits) else POWER


def _infix(expression: Operation, notation: Notation) -> tuple[str, int]:
    rule = notation.operations[expression.sign]
    left_operand = _operand(expression.lhs, notation, rule.lhs)
    return rule.form(left_operand, _operand(expression.rhs, notation, rule.rhs)), rule.binding


def _in_a_row(product: Operation) -> Operation:
    """a·(b·c) as (a·b)·c, which needs no brackets."""
    while isinstance(product.rhs, Operation) and product.rhs.sign == "*":
        inner = product.rhs
        product = Operation("*", Operation("*", product.lhs, inner.lhs), inner.rhs)
    return product


def _with_powers(product: Operation) -> Operation:
    """k·x·x as k·x²."""
    factor, power = product.rhs, 1
    factors: Expression = product.lhs
    while isinstance(factors, Operation) and factors.sign == "*" and factors.rhs == factor:
        factors, power = factors.lhs, power + 1
    if power == 1 or isinstance(factor, Number):
        return product
    return Operation("*", factors, Operation("^", factor, Number(float(power))))


def _call(name: str, arguments: Sequence[str], notation: Notation) -> str:
    if name in notation.functions:
        return notation.functions[name].format(*arguments)
    return (
        f"{notation.head(name)}{notation.brackets[0]}{', '.join(arguments)}{notation.brackets[1]}"
    )


def _choice(expression: Call, notation: Notation) -> str:
    condition, first, second = expression.arguments
    if notation.for_reading and (first, second) == (Number(1.0), Number(0.0)):
        return f"[{written(condition, notation)}]"
    if notation.cases is None:
        return _call("where", [written(part, notation) for part in expression.arguments], notation)
    cases: list[tuple[str, str]] = []
    last: Expression = expression
    while isinstance(last, Call) and last.name == "where":
        condition, first, last = last.arguments
        cases.append((written(first, notation), written(condition, notation)))
    return notation.cases(cases, written(last, notation))


def _sum(expression: Expression, notation: Notation) -> str:
    total = ""
    for negative, term in _terms(expression, False):
        sign = "-" if negative else "+"
        if total:
            total += f" {sign} {_operand(term, notation, PRODUCT)}"
        else:
            total = ("-" if negative else "") + _operand(term, notation, PRODUCT)
    return total


def _terms(expression: Expression, negative: bool) -> list[tuple[bool, Expression]]:
    """The terms of a sum, each with whether it is taken away; changes of sign are exact."""
    match expression:
        case Operation(sign="+" | "-" as sign, lhs=lhs, rhs=rhs):
            first = [] if lhs == Number(0.0) else _terms(lhs, negative)
            return first + _terms(rhs, negative != (sign == "-"))
        case Number(value=value) if value < 0:
            return [(not negative, Number(-value))]
        case Operation(sign="*" | "/", lhs=lhs):
            # -(-3·y), (-a)·y: the sign of the first factor is the sign of the term.
            ((inner, first),) = terms if len(terms := _terms(lhs, False)) == 1 else [(False, lhs)]
            return [(negative != inner, replace(expression, lhs=first))]
    return [(negative, expression)]


# -- program languages ------------------------------------------------------------------------


def code_notation(
    power: Infix,
    comparisons: Mapping[str, str],
    logic: Mapping[str, str],
    functions: Mapping[str, str],
) -> Notation:
    """The notation of a program language; numbers keep all their digits.

    Args:
        power: of base and exponent.
        comparisons: how ``≤ = ≠`` are written.
        logic: templates of ``and``, ``or`` and ``not``, with brackets of their own.
        functions: templates by name; other functions are called by their own name.
    """
    operations = {
        # (a*b)*c as it is, a*(b*c) in brackets: rounding is that of the model.
        "*": Infix("{}*{}".format, PRODUCT, POWER, PRODUCT),
        "/": Infix("{}/{}".format, PRODUCT, POWER, PRODUCT),
        "^": power,
        **_comparisons({sign: comparisons.get(sign, sign) for sign in COMPARISONS}),
        **{sign: Infix(logic[sign].format, COMPARISON, COMPARISON, LOGIC) for sign in _JOINING},
    }
    return Notation(operations, {**functions, "not": logic["not"]})


def power_operator(sign: str) -> Infix:
    """A power written by a sign, whole exponents without a point.

    Args:
        sign: ``"**"`` or ``"^"``.
    """
    return Infix(lambda base, n: f"{base}{sign}{n.removesuffix('.0')}", ATOM, ATOM, POWER)


_JOINING = ("and", "or")


def _comparisons(signs: Mapping[str, str]) -> dict[str, Infix]:
    return {
        sign: Infix(f"{{}} {name} {{}}".format, SUM, SUM, COMPARISON)
        for sign, name in signs.items()
    }


# -- numbers to read --------------------------------------------------------------------------


def _multiple_of_pi(
    value: float,
    denominators: tuple[int, ...] = (1, 2, 3, 4, 6, 180),
    max_numerator: int = 6,
    tolerance: float = 1e-7,
) -> tuple[int, int] | None:
    """Numerator and denominator of a value that is a simple multiple of π.

    Args:
        value: any number.
        denominators: those of angles that are written as fractions, and of one degree.
        max_numerator: largest one that is easier to read than digits.
        tolerance: relative; that of single precision.
    """
    for denominator in denominators:
        count = value / math.pi * denominator
        numerator = round(count)
        is_close = abs(count - numerator) <= tolerance * abs(count)
        if is_close and 1 <= numerator <= max_numerator:
            return numerator, denominator
    return None


def _digits(value: float) -> str:
    """Five digits; of a large number that has few more, all: a time that is counted from 1e6 s."""
    short, exact = f"{value:.5g}", f"{value:.10g}"
    is_large = abs(value) >= 1e5 and "e" not in exact
    return exact if is_large and float(exact) == value != float(short) else short


# -- text -------------------------------------------------------------------------------------

_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def _text_symbol(symbol: Symbol) -> str:
    return symbol.name + "'" * symbol.order


def _text_number(value: float) -> str:
    if (multiple := _multiple_of_pi(value)) is None:
        return _digits(value)
    count, denominator = multiple
    return ("" if count == 1 else f"{count}·") + "π" + f"/{denominator}" * (denominator > 1)


def _text_power(base: str, exponent: str) -> str:
    if re.fullmatch(r"-?\d+", exponent):
        return base + exponent.translate(_RAISED)
    return f"{base}^{exponent}" if re.fullmatch(r"[\w.]+", exponent) else f"{base}^({exponent})"


TEXT = Notation(
    operations={
        "*": Infix("{}·{}".format, PRODUCT, POWER, PRODUCT),
        "/": Infix("{}/{}".format, PRODUCT, POWER, PRODUCT),
        "^": Infix(_text_power, ATOM, LOGIC, POWER),
        **_comparisons({sign: sign for sign in COMPARISONS}),
        "and": Infix("{} and {}".format, COMPARISON, COMPARISON, LOGIC),
        "or": Infix("{} or {}".format, COMPARISON, COMPARISON, LOGIC),
    },
    functions={"abs": "|{0}|", "plain_root": "sqrt({0})", "not": "not ({0})"},
    symbol=_text_symbol,
    number=_text_number,
    for_reading=True,
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
    **{sign: f"\\{sign}" for sign in "{}$&#%_"},
}
_LATEX_FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sinh", "cosh", "tanh", "max", "min")


def escaped(text: str) -> str:
    """A text for LaTeX outside of mathematics: nothing in it is a command, or ends the line.

    Args:
        text: any.
    """
    return "".join(_SPECIAL.get(sign, sign if sign.isprintable() else " ") for sign in text)


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
    if (multiple := _multiple_of_pi(value)) is not None:
        count, denominator = multiple
        numerator = ("" if count == 1 else rf"{count}") + r"\pi"
        return rf"\frac{{{numerator}}}{{{denominator}}}" if denominator > 1 else numerator
    mantissa, _, exponent = _digits(value).partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa


def _latex_product(lhs: str, rhs: str) -> str:
    # Two numbers side by side would read as one.
    return rf"{lhs} \cdot {rhs}" if rhs[:1].isdigit() else rf"{lhs}\,{rhs}"


def _latex_head(name: str) -> str:
    if name in _LATEX_FUNCTIONS:
        return rf"\{name}"
    return name if len(name) == 1 else rf"\operatorname{{{name.replace('_', chr(92) + '_')}}}"


def _latex_cases(cases: Sequence[tuple[str, str]], default: str) -> str:
    rows = [f"{value} & {condition}" for value, condition in cases]
    rows = r" \\ ".join([*rows, rf"{default} & \text{{otherwise}}"])
    return rf"\begin{{cases}} {rows} \end{{cases}}"


LATEX = Notation(
    operations={
        "*": Infix(_latex_product, PRODUCT, POWER, PRODUCT),
        "/": Infix(r"\frac{{{}}}{{{}}}".format, LOGIC, LOGIC, POWER),
        "^": Infix("{}^{{{}}}".format, ATOM, LOGIC, POWER),
        **_comparisons({"<": "<", "≤": r"\le", ">": ">", "≥": r"\ge", "=": "=", "≠": r"\ne"}),
        "and": Infix(r"{} \wedge {}".format, COMPARISON, COMPARISON, LOGIC),
        "or": Infix(r"{} \vee {}".format, COMPARISON, COMPARISON, LOGIC),
    },
    functions={
        "abs": r"\left|{0}\right|",
        "sqrt": r"\sqrt{{{0}}}",
        "plain_root": r"\sqrt{{{0}}}",
        "not": r"\neg\left({0}\right)",
    },
    symbol=_latex_symbol,
    number=_latex_number,
    head=_latex_head,
    brackets=(r"\left(", r"\right)"),
    for_reading=True,
    cases=_latex_cases,
)
