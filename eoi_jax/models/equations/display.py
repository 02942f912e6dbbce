"""A model's equations as text and LaTeX: the declared part from its source, effects from their own.

The declared part is a Python function. Its source is read, not run: local names are replaced by
what they stand for, so that ``angle, rate = x.y`` turns ``-p.b * rate`` into ``-b·angle'``. What
cannot be read is shown as f(…) with the names of what it may depend on.
"""

import ast
import inspect
import itertools
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from tokenize import TokenError
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.pointwise import along
from eoi_jax.models.effects import INPUT_EFFECTS, AbstractInternalEffect
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.printer import (
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
    evaluate,
    latex,
    name_latex,
    text,
)
from eoi_jax.models.equations.system import TextDynamics, TextInternal
from eoi_jax.models.plant import Plant, State, parameter_type, velocity_rows


def equation_text(plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False) -> str:
    """The equations of a declared plant and of what was added to it, a line for each.

    Args:
        plant: as declared, with the parameter values that `numeric` shows.
        added: what was found: each has `effect`, `output` (or the input) and `parameters`.
        numeric: values instead of names.

    Returns:
        ``angle'' = -a·sin(angle) - b·angle' + d·voltage - coulomb_friction·sign(angle')``; effects
        of an input, and states of the model's own, are lines under it.
    """
    values = plant.parameters if numeric else {}
    names = [_prime(name, r) for name, r in zip(plant.outputs, plant.degrees, strict=True)]
    rights = [text(one, values) for one in declared(plant)]
    terms, changes = _effects(plant, added, numeric, False)
    lines = [
        " ".join([f"{left} = {right}", *terms.get(output, ())])
        for left, right, output in zip(names, rights, plant.outputs, strict=True)
    ]
    inner = [
        " ".join([f"{_prime(name, 1)} = {text(one, values)}", *terms.get(name, ())])
        for name, one in _internal(plant)
    ]
    return "\n".join([*lines, *inner, *(f"with {change}" for change in changes)])


def equation_latex(plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False) -> str:
    r"""The same as the body of an ``aligned`` environment; arguments as in `equation_text`."""
    parts, changes = equation_lines(plant, added, numeric=numeric)
    lines = [" ".join([f"{left} &= {right}", *terms]) for left, right, terms in parts]
    lines += [rf"&\text{{with }} {change}" for change in changes]
    return "\\begin{aligned}\n" + " \\\\\n".join(lines) + "\n\\end{aligned}"


def equation_lines(
    plant: Plant, added: Sequence[Any] = (), *, numeric: bool = False
) -> tuple[list[tuple[str, str, list[str]]], list[str]]:
    """The equations in LaTeX, with what was added apart; arguments as in `equation_text`.

    Returns:
        Left side, declared right side and the terms that were added, of each equation; then what
        happens to inputs.
    """
    values = plant.parameters if numeric else {}
    rights = [latex(one, values) for one in declared(plant)]
    terms, changes = _effects(plant, added, numeric, True)
    outputs = zip(plant.outputs, plant.degrees, rights, strict=True)
    lines = [
        (latex(Symbol(output, degree), {}), right, terms.get(output, []))
        for output, degree, right in outputs
    ]
    for name, one in _internal(plant):
        lines.append((latex(Symbol(name, 1), {}), latex(one, values), terms.get(name, [])))
    return lines, changes


def _prime(name: str, order: int) -> str:
    return text(Symbol(name, order), {})


# -- the effects ------------------------------------------------------------------------------


def _effects(
    plant: Plant, added: Sequence[Any], numeric: bool, in_latex: bool
) -> tuple[dict[str, list[str]], list[str]]:
    """Terms by output or internal state, and what happens to inputs."""
    write = latex if in_latex else text
    velocity = dict(zip(plant.outputs, velocity_rows(plant.degrees), strict=True))
    terms: dict[str, list[str]] = {}
    changes: list[str] = []
    for one in added:
        of_input = isinstance(one.effect, INPUT_EFFECTS)
        output = plant.outputs[0] if of_input else one.output
        drive = one.output if of_input else (plant.inputs or ("u",))[0]
        names = [_named(name, value, numeric, in_latex) for name, value in one.parameters.items()]
        ends = (output, one.against)
        shown = (one.effect.latex if in_latex else one.effect.text)(
            names,
            _difference(ends, 0, write),
            _difference(ends, velocity.get(output, 1), write),
            write(Symbol(drive), {}),
        )
        if of_input:
            changes.append(shown)
        elif one.through:
            beside = write(Symbol(one.through), {})
            arrow = r"\to" if in_latex else "→"
            changes.append(f"{beside} {arrow} {beside} {_signs(shown)}")
        else:
            terms.setdefault(output, []).append(_signs(shown))
        if isinstance(one.effect, AbstractInternalEffect) and one.effect.outer_form[in_latex]:
            outer = one.effect.outer_form[in_latex].format(*names, y=write(Symbol(output), {}))
            terms.setdefault(plant.outputs[0], []).append(_signs(outer))
    return terms, changes


def _difference(ends: tuple[str, str], order: int, write: Any) -> str:
    """A derivative of an output, less that of the one that it is counted from, if any."""
    own, other = (write(Symbol(name, order), {}) for name in ends)
    return f"({own} - {other})" if ends[1] else own


def _named(name: str, value: float, numeric: bool, in_latex: bool) -> str:
    if not numeric:
        return name_latex(name) if in_latex else name
    shown = (latex if in_latex else text)(Number(value), {})
    return f"({shown})" if value < 0 else shown


def _signs(term: str) -> str:
    """``+ (-3.2)·y`` as ``- 3.2·y``: a negative value takes the sign before it."""
    flip = {"+": "-", "-": "+"}
    return re.sub(
        r"(?<![^ ])([+-]) \(-([^()]*)\)", lambda found: f"{flip[found[1]]} {found[2]}", term
    )


# -- the declared part ------------------------------------------------------------------------


def declared(plant: Plant) -> tuple[Expression, ...]:
    """What a plant's function returns, an expression for each output.

    Args:
        plant: any; its function is read where it can be.

    Returns:
        Expressions in the names of outputs, inputs, internal states and parameters; where the
        source cannot be read, ``f(…)`` of all of them.
    """
    found = _read(plant.dynamics, plant, len(plant.outputs))
    if found is not None:
        return found
    name = "f" if len(plant.outputs) == 1 else "f{}"
    return tuple(Call(name.format(j + 1), _arguments(plant)) for j in range(len(plant.outputs)))


def _internal(plant: Plant) -> list[tuple[str, Expression]]:
    if plant.internal is None:
        return []
    states = _states(plant)
    found = _read(plant.internal, plant, len(states))
    return list(zip(states, found or [Call("g", _arguments(plant))] * len(states), strict=True))


def _states(plant: Plant) -> list[str]:
    return list(internal_names(plant))


def _arguments(plant: Plant) -> tuple[Expression, ...]:
    outputs = [
        Symbol(name, i)
        for name, degree in zip(plant.outputs, plant.degrees, strict=True)
        for i in range(degree)
    ]
    others = (*_states(plant), *plant.inputs, *plant.names)
    return (*outputs, *(Symbol(name) for name in others))


class _UnreadableError(Exception):
    """The source says something that this reader does not know."""


def _read(function: Any, plant: Plant, count: int) -> tuple[Expression, ...] | None:
    """What `function` returns, flattened; None where it cannot be read."""
    if isinstance(function, TextDynamics | TextInternal):
        text = function.equations
        trees = text.highest if isinstance(function, TextDynamics) else text.internal
        written = tuple(text.written_out(tree) for tree in trees)
        return None if None in written else written  # type: ignore[return-value]
    try:
        inner = inspect.unwrap(function)  # a decorator may have its own globals
        body, arguments = _source(inner)
        value = _Reader(plant, inner, arguments).run(body)
        flat = tuple(_flat(value))
        right = len(flat) == count and _agrees(flat, function, plant)
    except _UNREADABLE:
        return None
    return flat if right else None


def _agrees(read: Sequence[Expression], function: Any, plant: Plant) -> bool:
    """Whether what was read has the value of the function at a point without symmetry.

    A formula that is not the model's is worse than none: two lambdas in one line, an array product.
    """
    count = itertools.count(1)
    values: dict[Symbol, float] = {Symbol("t"): 0.3}

    def some(symbols: Iterable[Symbol]) -> list[float]:
        for symbol in symbols:
            values[symbol] = 0.2 + 0.6180339887 * next(count) % 1.0
        return [values[symbol] for symbol in symbols]

    rows = range(plant.relative_degree)
    y = [some([Symbol(name, i) for name in plant.outputs]) for i in rows]
    owned = np.asarray([[float(i < r) for r in plant.degrees] for i in rows])
    z = some([Symbol(name) for name in _states(plant)])
    u = some([Symbol(name) for name in plant.inputs])
    theta = some([Symbol(name, parameter=True) for name in plant.names])
    row = (
        np.full(1, 0.3),
        np.asarray(y)[None] * owned,
        *(np.asarray([one]) for one in (z, u, theta)),
    )
    computed = along(_Called(function, plant.names), ("rows",), row)
    for expression, value in zip(read, np.ravel(np.asarray(computed)), strict=True):
        mine = evaluate(expression, values)
        if mine is not None and not np.isclose(mine, value, rtol=1e-4):
            return False
    return True


@dataclass(frozen=True)
class _Called:
    """A function of a model as one of the numbers that it gets."""

    function: Any
    names: tuple[str, ...]

    def __call__(self, row: tuple[Any, ...]) -> Any:
        t, y, z, u, theta = row
        return jnp.asarray(self.function(t, State(y, z), u, parameter_type(self.names)(*theta)))


_UNREADABLE = (
    _UnreadableError, OSError, TypeError, SyntaxError, IndexError, ValueError, KeyError,
    TokenError,  # the file is not Python: code that was run from a string
)  # fmt: skip


def _source(function: Any) -> tuple[list[ast.stmt], list[str]]:
    """Statements and names of arguments of a function or a lambda."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            return node.body, [one.arg for one in node.args.args]
        if isinstance(node, ast.Lambda):
            return [ast.Return(node.body)], [one.arg for one in node.args.args]
    raise _UnreadableError


# Parts of JAX's arrays that only arrange values.
_ARRANGING = ("stack", "array", "asarray", "concatenate", "reshape", "atleast_1d", "squeeze")
_RENAMED = {"square_root": "sqrt", "absolute": "abs", "arctan": "atan", "arctan2": "atan2"}
_OPERATIONS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "^"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "≤", ast.Gt: ">", ast.GtE: "≥"}

# A value is an expression, or a tuple of values: arrays are nested tuples.
_Value = Any


class _Reader:
    """Evaluates a function's statements with symbols in place of numbers."""

    def __init__(self, plant: Plant, function: Any, arguments: Sequence[str]):
        rows = range(plant.relative_degree)
        outputs = list(zip(plant.outputs, plant.degrees, strict=True))
        self.y = tuple(
            tuple(Symbol(name, i) if i < r else Number(0.0) for name, r in outputs) for i in rows
        )
        self.z = tuple(Symbol(name) for name in _states(plant))
        self.parameters = plant.names
        if len(arguments) != 4:
            raise _UnreadableError
        self.time, self.state, self.drive, self.named = arguments
        self.scope: dict[str, _Value] = {
            self.time: Symbol("t"),
            self.drive: tuple(Symbol(name) for name in plant.inputs),
        }
        known = inspect.getclosurevars(function)
        self.outside = {**known.globals, **known.nonlocals}

    def run(self, body: Sequence[ast.stmt]) -> _Value:
        for statement in body:
            match statement:
                case ast.Return(value=ast.expr() as value):
                    return self.value(value)
                case ast.Assign(targets=[target], value=value):
                    self.bind(target, self.value(value))
                case ast.AugAssign(target=ast.Name(id=name), op=operation, value=value):
                    new = self.operation(operation, self.scope[name], self.value(value))
                    self.scope[name] = new
                case ast.Expr(value=ast.Constant()) | ast.Delete():
                    continue
                case _:
                    raise _UnreadableError
        raise _UnreadableError

    def bind(self, target: ast.expr, value: _Value) -> None:
        if isinstance(target, ast.Name):
            self.scope[target.id] = value
        elif isinstance(target, ast.Tuple) and isinstance(value, tuple):
            for part, one in zip(target.elts, value, strict=True):
                self.bind(part, one)
        else:
            raise _UnreadableError

    def value(self, node: ast.expr) -> _Value:
        match node:
            case ast.Constant(value=int() | float() as number):
                return Number(float(number))
            case ast.Name(id=name):
                return self.name(name)
            case ast.Attribute():
                return self.attribute(node)
            case ast.UnaryOp(op=ast.USub(), operand=inner):
                return _each(lambda one: Operation("-", Number(0.0), one), self.value(inner))
            case ast.UnaryOp(op=ast.UAdd(), operand=inner):
                return self.value(inner)
            case ast.BinOp(left=left, op=operation, right=right):
                return self.operation(operation, self.value(left), self.value(right))
            case ast.Compare(left=left, ops=[compared], comparators=[right]):
                sign = _COMPARISONS[type(compared)]
                return _pairs(sign, self.value(left), self.value(right))
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return tuple(self.value(part) for part in parts)
            case ast.Subscript(value=array, slice=place):
                return self.item(self.value(array), place)
            case ast.Call(func=function, args=arguments, keywords=options):
                return self.call(function, arguments, bool(options))
        raise _UnreadableError

    def name(self, name: str) -> _Value:
        if name in self.scope:
            return self.scope[name]
        value = self.outside.get(name)
        if isinstance(value, int | float):
            return Number(float(value))
        raise _UnreadableError

    def attribute(self, node: ast.Attribute) -> _Value:
        owner = node.value.id if isinstance(node.value, ast.Name) else ""
        if owner == self.state and node.attr in ("y", "z"):
            return self.y if node.attr == "y" else self.z
        if owner == self.named and node.attr in self.parameters:
            return Symbol(node.attr, parameter=True)
        if node.attr == "pi":
            return Symbol("pi")
        raise _UnreadableError

    def operation(self, operation: ast.operator, left: _Value, right: _Value) -> _Value:
        if type(operation) not in _OPERATIONS:
            raise _UnreadableError
        return _pairs(_OPERATIONS[type(operation)], left, right)

    def item(self, array: _Value, place: ast.expr) -> _Value:
        for part in place.elts if isinstance(place, ast.Tuple) else [place]:
            index = ast.literal_eval(part)
            if not (isinstance(array, tuple) and isinstance(index, int)):
                raise _UnreadableError
            array = array[index]
        return array

    def call(self, function: ast.expr, arguments: Sequence[ast.expr], options: bool) -> _Value:
        match function:
            case ast.Attribute(attr=name) | ast.Name(id=name):
                name = _RENAMED.get(name, name)
            case _:
                raise _UnreadableError
        if name in _ARRANGING:
            return self.value(arguments[0])
        if options:
            raise _UnreadableError
        values = [self.value(one) for one in arguments]
        if len(values) == 1:
            return _each(lambda one: Call(name, (one,)), values[0])
        return Call(name, tuple(_single(one) for one in values))


def _single(value: _Value) -> Expression:
    flat = list(_flat(value))
    if len(flat) != 1:
        raise _UnreadableError
    return flat[0]


def _flat(value: _Value) -> list[Expression]:
    if not isinstance(value, tuple):
        return [value]
    return [one for part in value for one in _flat(part)]


def _each(change: Any, value: _Value) -> _Value:
    if isinstance(value, tuple):
        return tuple(_each(change, one) for one in value)
    return change(value)


def _pairs(sign: str, left: _Value, right: _Value) -> _Value:
    """An operation on two arrays, element by element; one element goes with all."""
    if isinstance(left, tuple) and isinstance(right, tuple):
        if len(left) == 1 or len(right) == 1:
            size = max(len(left), len(right))
            left, right = left * (size // len(left)), right * (size // len(right))
        return tuple(_pairs(sign, *pair) for pair in zip(left, right, strict=True))
    if isinstance(left, tuple):
        return tuple(_pairs(sign, one, right) for one in left)
    if isinstance(right, tuple):
        return tuple(_pairs(sign, left, one) for one in right)
    return Operation(sign, left, right)
