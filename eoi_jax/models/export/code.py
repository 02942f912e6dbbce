"""Formulas as code: what C, MATLAB, Python and the grammar of text models have in common."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from eoi_jax.models.equations.expression import Call, Expression, Number, Operation, Symbol

# How tightly an operation binds, in all these languages alike.
_LOGIC, _COMPARISON, _SUM, _PRODUCT, _POWER, _ATOM = range(6)


@dataclass(frozen=True)
class Language:
    """What differs between languages.

    Attributes:
        power: as a template of base and exponent.
        power_is_call: whether that is a call, and no sign between the two.
        functions: templates by name; the others are called by their own name.
        signs: of comparisons and logic that are not the formula's own.
        logic: how ``and``, ``or`` (with two operands) and ``not`` are written, as templates.
        number: how a number is written.
    """

    power: str
    power_is_call: bool
    functions: Mapping[str, str]
    signs: Mapping[str, str]
    logic: Mapping[str, str]
    number: Callable[[float], str] = repr


def written(expression: Expression, names: Mapping[Symbol, str], language: Language) -> str:
    """A formula as code.

    Args:
        expression: what to write.
        names: of its symbols.
        language: how.
    """
    return _write(expression, names, language)[0]


def functions_of(expression: Expression) -> set[str]:
    """Names of the functions that a formula calls.

    Args:
        expression: any.
    """
    match expression:
        case Operation(left=left, right=right):
            return functions_of(left) | functions_of(right)
        case Call(name=name, arguments=arguments):
            return {name}.union(*map(functions_of, arguments))
    return set()


def symbols_of(expression: Expression) -> set[Symbol]:
    """Symbols of a formula.

    Args:
        expression: any.
    """
    match expression:
        case Symbol():
            return {expression}
        case Operation(left=left, right=right):
            return symbols_of(left) | symbols_of(right)
        case Call(arguments=arguments):
            return set().union(*map(symbols_of, arguments))
    return set()


def _write(expression: Expression, names: Mapping[Symbol, str], how: Language) -> tuple[str, int]:
    """What is written, and how tightly it binds."""

    def inside(one: Expression, binding: int) -> str:
        text, own = _write(one, names, how)
        return text if own >= binding else f"({text})"

    match expression:
        case Number(value=value):
            return how.number(value), _ATOM if value >= 0 else _SUM
        case Symbol():
            return names[expression], _ATOM
        case Operation(sign="+" | "-"):
            return _sum(expression, inside), _SUM
        case Operation(sign="*" | "/" as sign, left=left, right=right):
            # (a*b)*c as it is, a*(b*c) in brackets: rounding is that of the model.
            return f"{inside(left, _PRODUCT)}{sign}{inside(right, _POWER)}", _PRODUCT
        case Operation(sign="^", left=left, right=right):
            whole = isinstance(right, Number) and right.value == int(right.value)
            if how.power_is_call:
                return how.power.format(inside(left, _LOGIC), inside(right, _LOGIC)), _ATOM
            exponent = str(int(right.value)) if whole else inside(right, _ATOM)  # type: ignore[union-attr]
            return how.power.format(inside(left, _ATOM), exponent), _POWER
        case Operation(sign="and" | "or" as sign, left=left, right=right):
            sides = inside(left, _COMPARISON), inside(right, _COMPARISON)
            return how.logic[sign].format(*sides), _LOGIC
        case Operation(sign=sign, left=left, right=right):
            sign = how.signs.get(sign, sign)
            return f"{inside(left, _SUM)} {sign} {inside(right, _SUM)}", _COMPARISON
        case Call(name="not", arguments=(inner,)):
            return how.logic["not"].format(inside(inner, _ATOM)), _LOGIC
        case Call(name=name, arguments=arguments):
            texts = [inside(one, _LOGIC) for one in arguments]
            template = how.functions.get(name)
            return template.format(*texts) if template else f"{name}({', '.join(texts)})", _ATOM
    raise TypeError(expression)


def _sum(expression: Expression, inside: Callable[[Expression, int], str]) -> str:
    text = ""
    for negative, term in _terms(expression, False):
        shown = inside(term, _PRODUCT)
        if text:
            text += f" {'-' if negative else '+'} {shown}"
        else:
            text = f"-{shown}" if negative else shown
    return text


def _terms(expression: Expression, negative: bool) -> list[tuple[bool, Expression]]:
    """The terms of a sum, each with whether it is taken away; changes of sign are exact."""
    match expression:
        case Operation(sign="+" | "-" as sign, left=left, right=right):
            first = [] if left == Number(0.0) else _terms(left, negative)
            return first + _terms(right, negative != (sign == "-"))
        case Number(value=value) if value < 0:
            return [(not negative, Number(-value))]
    return [(negative, expression)]
