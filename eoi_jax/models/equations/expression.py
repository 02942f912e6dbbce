"""Small formulas as trees, and what they are worth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True)
class Number:
    """A value."""

    value: float


@dataclass(frozen=True)
class Symbol:
    """A name, or a derivative of one in time.

    Attributes:
        name: of a channel, a state or a parameter.
        order: of the derivative.
        parameter: whether a value may stand in its place.
    """

    name: str
    order: int = 0
    parameter: bool = False


@dataclass(frozen=True)
class Operation:
    """lhs sign rhs; a change of sign is 0 - rhs.

    Attributes:
        sign: ``+ - * / ^``, or one that says true or false: ``< ≤ > ≥ = ≠ and or``.
        lhs, rhs: operands.
    """

    sign: str
    lhs: "Expression"
    rhs: "Expression"


@dataclass(frozen=True)
class Call:
    """A function of some arguments."""

    name: str
    arguments: tuple["Expression", ...]


Expression: TypeAlias = Number | Symbol | Operation | Call

COMPARISONS = ("<", "≤", ">", "≥", "=", "≠")


def is_flag(expression: Expression) -> bool:
    """Whether it is true or false, and no number."""
    match expression:
        case Operation(sign=sign):
            return sign in (*COMPARISONS, "and", "or")
        case Call(name="not"):
            return True
    return False


def parts_of(expression: Expression) -> tuple[Expression, ...]:
    """Operands or arguments.

    Args:
        expression: any.
    """
    match expression:
        case Operation(lhs=lhs, rhs=rhs):
            return lhs, rhs
        case Call(arguments=arguments):
            return arguments
    return ()


def symbols_of(expression: Expression) -> set[Symbol]:
    """Symbols of a formula.

    Args:
        expression: any.
    """
    if isinstance(expression, Symbol):
        return {expression}
    return set().union(*map(symbols_of, parts_of(expression)))


def functions_of(expression: Expression) -> set[str]:
    """Names of the functions that a formula calls.

    Args:
        expression: any.
    """
    called = {expression.name} if isinstance(expression, Call) else set()
    return called.union(*map(functions_of, parts_of(expression)))


def substituted(expression: Expression, values: Mapping[Symbol, Expression]) -> Expression:
    """The same with expressions in the place of some symbols.

    Args:
        expression: any.
        values: of the symbols; they are put in as they are.
    """
    match expression:
        case Symbol():
            return values.get(expression, expression)
        case Operation(sign, lhs, rhs):
            return Operation(sign, substituted(lhs, values), substituted(rhs, values))
        case Call(name, arguments):
            return Call(name, tuple(substituted(part, values) for part in arguments))
    return expression


def cancelled(expression: Expression) -> Expression:
    """The same formula without what is added and subtracted in one sum.

    Args:
        expression: any.
    """
    match expression:
        case Operation(sign="+" | "-"):
            terms: list[tuple[bool, Expression]] = []
            for minus, term in _terms(expression, False):
                opposite = (not minus, term)
                if opposite in terms:
                    terms.remove(opposite)
                else:
                    terms.append((minus, term))
            total: Expression = Number(0.0)
            for minus, term in sorted(terms, key=lambda item: item[0]):
                is_first = total == Number(0.0) and not minus
                total = term if is_first else Operation("-" if minus else "+", total, term)
            return total
        case Operation(sign=sign, lhs=lhs, rhs=rhs):
            return Operation(sign, cancelled(lhs), cancelled(rhs))
        case Call(name=name, arguments=arguments):
            return Call(name, tuple(map(cancelled, arguments)))
    return expression


def _terms(expression: Expression, minus: bool) -> list[tuple[bool, Expression]]:
    """Terms of a sum, each with whether it is subtracted."""
    match expression:
        case Number(value=0.0):
            return []
        case Operation(sign="+" | "-", lhs=lhs, rhs=rhs):
            subtracted = minus != (expression.sign == "-")
            return [*_terms(lhs, minus), *_terms(rhs, subtracted)]
    inner = cancelled(expression)
    return [(minus, inner)]


# -- what functions are worth -----------------------------------------------------------------


@dataclass(frozen=True)
class Function:
    """A function that a formula may name.

    Attributes:
        min_arguments, max_arguments: how many arguments it takes.
        value: of an array module (`numpy` or `jax.numpy`) and the arguments.
    """

    min_arguments: int
    max_arguments: int
    value: Callable[..., Any]


def _scalar_function(name: str, count: int = 1) -> Function:
    return Function(count, count, lambda m, *args: getattr(m, name)(*args))


def _root(m: Any, x: Any) -> Any:
    # The inner `where` keeps the derivative of the branch not taken finite.
    wet = x > 0
    return m.where(wet, m.sqrt(m.where(wet, x, 1.0)), 0.0)


def _joined(name: str) -> Function:
    def value(m: Any, first: Any, *arguments: Any) -> Any:
        for argument in arguments:
            first = getattr(m, name)(first, argument)
        return first

    return Function(2, 8, value)


# `sqrt` is 0 where its argument is not positive, with derivative 0: an empty tank has no outflow,
# and noise that takes its level below zero makes no NaN.
FUNCTIONS: dict[str, Function] = {
    **{name: _scalar_function(name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{
        name: _scalar_function(name)
        for name in ("exp", "expm1", "log", "log1p", "cbrt", "abs", "sign")
    },
    **{name: _scalar_function(name) for name in ("floor", "ceil", "trunc")},
    **{
        f"a{name}": _scalar_function(f"arc{name}")
        for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")
    },
    "sqrt": Function(1, 1, _root),
    "round": _scalar_function("rint"),
    "atan2": _scalar_function("arctan2", 2),
    "rem": _scalar_function("fmod", 2),
    "min": _joined("minimum"),
    "max": _joined("maximum"),
    "clip": Function(3, 3, lambda m, x, low, high: m.minimum(m.maximum(x, low), high)),
    "where": _scalar_function("where", 3),
}

_OPERATIONS: dict[str, Callable[[Any, Any, Any], Any]] = {
    "+": lambda m, a, b: m.add(a, b),
    "-": lambda m, a, b: m.subtract(a, b),
    "*": lambda m, a, b: m.multiply(a, b),
    "/": lambda m, a, b: m.divide(a, b),
    "^": lambda m, a, b: m.power(a, b),
    "<": lambda m, a, b: m.less(a, b),
    "≤": lambda m, a, b: m.less_equal(a, b),
    ">": lambda m, a, b: m.greater(a, b),
    "≥": lambda m, a, b: m.greater_equal(a, b),
    "=": lambda m, a, b: m.equal(a, b),
    "≠": lambda m, a, b: m.not_equal(a, b),
    "and": lambda m, a, b: m.logical_and(a, b),
    "or": lambda m, a, b: m.logical_or(a, b),
}


def value_of(expression: Expression, values: Mapping[Symbol, Any], m: Any) -> Any:
    """What a formula is worth.

    Args:
        expression: any whose functions are in `FUNCTIONS`.
        values: of its symbols.
        m: `numpy` or `jax.numpy`.
    """
    match expression:
        case Number(value=value):
            return value
        case Symbol():
            return values[expression]
        case Operation(sign="-", lhs=Number(value=0.0), rhs=rhs):
            return m.negative(value_of(rhs, values, m))
        case Operation(sign="^", lhs=lhs, rhs=Number(value=power)) if power == int(power):
            return value_of(lhs, values, m) ** int(power)
        case Operation(sign=sign, lhs=lhs, rhs=rhs):
            return _OPERATIONS[sign](m, value_of(lhs, values, m), value_of(rhs, values, m))
        case Call(name="not", arguments=(inner,)):
            return m.logical_not(value_of(inner, values, m))
        case Call(name=name, arguments=arguments):
            return FUNCTIONS[name].value(
                m, *(value_of(argument, values, m) for argument in arguments)
            )
    raise TypeError(expression)
