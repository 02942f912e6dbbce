r"""The jaxpr of one lane, evaluated number by number: no array is left but the lanes.

In a kernel a lane is a thread and its numbers are registers: there are no small arrays. So every
array of the jaxpr becomes a tuple of its numbers, `Components`. Arithmetic is applied to each of
them; what only moves numbers (slices, transposes, concatenations) happens while tracing and costs
nothing; loops whose end is known are unrolled.

What a number is, and what arithmetic does with it, is the caller's: `apply` binds a primitive to
vectors of lanes, for instance. Numbers known while tracing are NumPy scalars. Exact zeros and ones
drop out of sums and products, so that derivatives are as sparse as the model; 0 · x is 0 even
where x is not finite.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

Number = Any  # a NumPy scalar, or whatever `Apply` takes and returns
Apply = Callable[[Any, Sequence[Number], dict], Number]


class Components(NamedTuple):
    """An array as its numbers, in C order."""

    shape: tuple[int, ...]
    items: tuple[Number, ...]

    @property
    def numbering(self) -> np.ndarray:
        """Which item stands where."""
        return np.arange(len(self.items)).reshape(self.shape)

    @property
    def known(self) -> bool:
        """Whether all numbers are known while tracing."""
        return all(isinstance(item, np.generic) for item in self.items)

    def array(self) -> np.ndarray:
        """The array of known numbers."""
        return np.asarray(self.items).reshape(self.shape)


def constant(value: Any) -> Components:
    """An array that is known while tracing."""
    array = np.asarray(value)
    return Components(array.shape, tuple(array.ravel()))


def evaluate(jaxpr: ClosedJaxpr, values: Sequence[Components], apply: Apply) -> list[Components]:
    """The outputs of a jaxpr.

    Args:
        jaxpr: of one lane.
        values: its inputs.
        apply: arithmetic, ``apply(primitive, numbers, parameters)``, one number for each operand;
            never called with known numbers only.

    Raises:
        NotImplementedError: an operation without a rule, a loop whose end is not known.
    """
    known: dict[Any, Components] = {}

    def read(atom: Any) -> Components:
        if isinstance(atom, Literal):
            return constant(np.asarray(atom.val, atom.aval.dtype))  # type: ignore[attr-defined]
        return known[atom]

    consts = [constant(value) for value in jaxpr.consts]
    known.update(zip(jaxpr.jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.jaxpr.invars, values, strict=True))
    for equation in jaxpr.jaxpr.eqns:
        results = _equation(equation, [read(atom) for atom in equation.invars], apply)
        known.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.jaxpr.outvars]


def _equation(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    name = equation.primitive.name
    if name in _ELEMENTWISE:
        return [_elementwise(equation, values, apply)]
    if name in _STRUCTURES:
        return _STRUCTURES[name](equation, values, apply)
    if name in _CALLS:
        inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        inner = inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, [])
        return evaluate(inner, values, apply)
    if name in _MOVES:
        return [_moved(values, lambda numbers: _MOVES[name](equation.params, *numbers))]
    if all(value.known for value in values):
        return _eager(equation, [value.array() for value in values])
    if name in _INDEXED:
        return [_indexed(equation, values)]
    raise NotImplementedError(f"no rule for the operation `{name}` on single numbers")


# -- arithmetic -------------------------------------------------------------------------------

_ELEMENTWISE = frozenset((
    "abs", "acos", "acosh", "add", "add_any", "and", "asin", "asinh", "atan", "atan2", "atanh",
    "cbrt", "ceil", "clamp", "convert_element_type", "cos", "cosh", "div", "eq", "erf", "exp",
    "exp2", "expm1", "floor", "ge", "gt", "integer_pow", "is_finite", "le", "log", "log1p",
    "logistic", "lt", "max", "min", "mul", "ne", "neg", "not", "or", "pow", "rem", "round",
    "rsqrt", "select_n", "sign", "sin", "sinh", "sqrt", "square", "sub", "tan", "tanh", "xor",
))  # fmt: skip

# What derivatives are full of; the rest of what is known goes through JAX.
_ON_KNOWN: dict[str, Callable] = {
    "add": np.add,
    "add_any": np.add,
    "and": np.logical_and,
    "eq": np.equal,
    "mul": np.multiply,
    "neg": np.negative,
    "sub": np.subtract,
}


def _elementwise(equation: Any, values: list[Components], apply: Apply) -> Components:
    shape = equation.outvars[0].aval.shape
    # Operands may have axes of length one, and a predicate or a bound may be a scalar.
    columns = [_taken(value, np.broadcast_to(value.numbering, shape)).items for value in values]
    if all(value.known for value in values) and equation.primitive.name not in _ON_KNOWN:
        return _eager(equation, [value.array() for value in values])[0]
    items = (
        _number(equation.primitive, operands, equation.params, apply)
        for operands in zip(*columns, strict=True)
    )
    return Components(shape, tuple(items))


def _number(primitive: Any, operands: tuple[Number, ...], params: dict, apply: Apply) -> Number:
    if all(isinstance(one, np.generic) for one in operands):
        if primitive.name in _ON_KNOWN:
            return _ON_KNOWN[primitive.name](*operands)
        with jax.ensure_compile_time_eval():
            return np.asarray(primitive.bind(*operands, **params))[()]
    if primitive.name == "add_any":  # what derivatives call an addition
        primitive = jax.lax.add_p
    simpler = _simpler(primitive.name, operands)
    return apply(primitive, operands, params) if simpler is None else simpler


def _simpler(name: str, operands: tuple[Number, ...]) -> Number | None:
    """Without arithmetic, if that is possible."""

    def is_number(one: Number, value: Any) -> bool:
        return isinstance(one, np.generic) and bool(one == value)

    if name in ("mul", "add"):
        for one, other in (operands, operands[::-1]):
            if is_number(one, 0):
                return one if name == "mul" else other
            if is_number(one, 1) and name == "mul":
                return other
    if name == "sub" and is_number(operands[1], 0):
        return operands[0]
    if name == "div" and (is_number(operands[0], 0) or is_number(operands[1], 1)):
        return operands[0]
    if name == "select_n":
        if isinstance(operands[0], np.generic):
            return operands[1 + int(operands[0])]
        first = operands[1]
        known = isinstance(first, np.generic)
        if all(case is first or (known and is_number(case, first)) for case in operands[2:]):
            return first
    return None


def _eager(equation: Any, arrays: Sequence[np.ndarray]) -> list[Components]:
    """What is known is computed now."""
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*arrays, **equation.params)
    return [
        constant(one) for one in (results if equation.primitive.multiple_results else [results])
    ]


# -- moves ------------------------------------------------------------------------------------


def _spread(params: dict, numbers: np.ndarray) -> np.ndarray:
    shape = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], numbers.shape, strict=True):
        shape[axis] = size
    return np.broadcast_to(numbers.reshape(shape), params["shape"])


def _slice(params: dict, numbers: np.ndarray) -> np.ndarray:
    strides = params["strides"] or (1,) * numbers.ndim
    limits = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return numbers[tuple(slice(*limit) for limit in limits)]


_MOVES: dict[str, Callable[..., np.ndarray]] = {
    "broadcast_in_dim": _spread,
    "copy": lambda _, numbers: numbers,
    "concatenate": lambda params, *parts: np.concatenate(parts, params["dimension"]),
    "expand_dims": lambda params, numbers: np.expand_dims(numbers, params["dimensions"]),
    "reshape": lambda params, numbers: numbers.reshape(params["new_sizes"]),
    "rev": lambda params, numbers: np.flip(numbers, params["dimensions"]),
    "slice": _slice,
    "squeeze": lambda params, numbers: np.squeeze(numbers, tuple(params["dimensions"])),
    "stack": lambda params, *parts: np.stack(parts, params["axis"]),
    "transpose": lambda params, numbers: np.transpose(numbers, params["permutation"]),
}

# Moves along indices that must be known: how many operands come before the indices and after.
_INDEXED = {"dynamic_slice": 1, "dynamic_update_slice": 2, "gather": 1, "pad": 2, "scatter": 1}


def _moved(values: Sequence[Components], move: Callable[[list[np.ndarray]], Any]) -> Components:
    """Let `move` act on consecutive numbers, and put the items where these end up."""
    numbers, count = [], 0
    for value in values:
        numbers.append(value.numbering + count)
        count += len(value.items)
    where = np.asarray(move(numbers))
    items = [item for value in values for item in value.items]
    if where.size and (where.min() < 0 or where.max() >= count):
        raise NotImplementedError("an index out of bounds")
    return Components(where.shape, tuple(items[int(k)] for k in where.ravel()))


def _indexed(equation: Any, values: list[Components]) -> Components:
    first = _INDEXED[equation.primitive.name]
    last = first + 1 if equation.primitive.name == "scatter" else len(values)
    indices = values[first:last]
    if not all(value.known for value in indices):
        raise NotImplementedError(f"`{equation.primitive.name}` at an index that is not known")

    def move(numbers: list[np.ndarray]) -> np.ndarray:
        data = [one.astype(np.int32) for one in numbers]
        operands = data[:first] + [value.array() for value in indices] + data[first:]
        with jax.ensure_compile_time_eval():
            return np.asarray(equation.primitive.bind(*operands, **equation.params))

    return _moved(values[:first] + values[last:], move)


def _taken(value: Components, where: np.ndarray) -> Components:
    return Components(where.shape, tuple(value.items[int(k)] for k in where.ravel()))


def _split(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    del apply
    sizes, axis = equation.params["sizes"], equation.params["axis"]
    parts = np.split(values[0].numbering, np.cumsum(sizes)[:-1], axis)
    return [_taken(values[0], part) for part in parts]


def _unstack(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    del apply
    rows = np.moveaxis(values[0].numbering, equation.params["axis"], 0)
    return [_taken(values[0], row) for row in rows]


# -- sums -------------------------------------------------------------------------------------

_REDUCED = {
    "reduce_and": jax.lax.and_p,
    "reduce_max": jax.lax.max_p,
    "reduce_min": jax.lax.min_p,
    "reduce_or": jax.lax.or_p,
    "reduce_prod": jax.lax.mul_p,
    "reduce_sum": jax.lax.add_p,
}


def _reduce(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    value, axes = values[0], tuple(equation.params["axes"])
    shape = equation.outvars[0].aval.shape
    length = int(np.prod([value.shape[axis] for axis in axes], dtype=int))
    if not length:
        return _eager(equation, [np.zeros(value.shape, equation.invars[0].aval.dtype)])
    rows = np.moveaxis(value.numbering, axes, range(-len(axes), 0)).reshape(-1, length)
    primitive = _REDUCED[equation.primitive.name]

    def both(one: Number, other: Number) -> Number:
        return _number(primitive, (one, other), {}, apply)

    items = (functools.reduce(both, (value.items[int(k)] for k in row)) for row in rows)
    return [Components(shape, tuple(items))]


def _dot(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    contracted, batch = equation.params["dimension_numbers"]
    aval = equation.outvars[0].aval
    length = int(np.prod([values[0].shape[axis] for axis in contracted[0]], dtype=int))
    count = int(np.prod([values[0].shape[axis] for axis in batch[0]], dtype=int))

    def rows(value: Components, over: tuple[int, ...], along: tuple[int, ...]) -> np.ndarray:
        free = [axis for axis in range(len(value.shape)) if axis not in (*over, *along)]
        order = np.transpose(value.numbering, (*over, *free, *along))
        width = int(np.prod([value.shape[axis] for axis in free], dtype=int))
        return order.reshape(count, width, length)

    def product(left: np.ndarray, right: np.ndarray) -> Number:
        total = np.zeros((), aval.dtype)[()]
        for i, j in zip(left, right, strict=True):
            pair = values[0].items[int(i)], values[1].items[int(j)]
            term = _number(jax.lax.mul_p, pair, {}, apply)
            total = _number(jax.lax.add_p, (total, term), {}, apply)
        return total

    lefts, rights = (rows(values[i], batch[i], contracted[i]) for i in (0, 1))
    items = (product(a, b) for n in range(count) for a in lefts[n] for b in rights[n])
    return [Components(aval.shape, tuple(items))]


# -- calls, loops and branches ----------------------------------------------------------------

_CALLS = ("jit", "pjit", "closed_call", "custom_jvp_call", "custom_vjp_call", "checkpoint")


def _scan(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    params = equation.params
    first, carried = params["num_consts"], params["num_carry"]
    consts, carry, rows = values[:first], values[first : first + carried], values[first + carried :]
    order = range(params["length"])[:: -1 if params["reverse"] else 1]
    shown: dict[int, list[Components]] = {}
    for k in order:
        now = [_taken(row, row.numbering[k]) for row in rows]
        results = evaluate(params["jaxpr"], [*consts, *carry, *now], apply)
        carry, shown[k] = results[:carried], results[carried:]
    stacked = [
        Components(one.aval.shape, tuple(item for k in sorted(shown) for item in shown[k][j].items))
        for j, one in enumerate(equation.outvars[carried:])
    ]
    return [*carry, *stacked]


def _while(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    params = equation.params
    first = params["cond_nconsts"]
    second = first + params["body_nconsts"]
    carry = values[second:]
    while True:
        going = evaluate(params["cond_jaxpr"], [*values[:first], *carry], apply)[0]
        if not going.known:
            raise NotImplementedError("a loop whose end depends on the data")
        if not going.items[0]:
            return carry
        carry = evaluate(params["body_jaxpr"], [*values[first:second], *carry], apply)


def _cond(equation: Any, values: list[Components], apply: Apply) -> list[Components]:
    index, branches = values[0].items[0], equation.params["branches"]
    if isinstance(index, np.generic):
        return evaluate(branches[min(max(int(index), 0), len(branches) - 1)], values[1:], apply)
    results = evaluate(branches[0], values[1:], apply)
    dtype = equation.invars[0].aval.dtype
    # Lanes may differ in the branch that they take, so all are computed.
    for i, branch in enumerate(branches[1:], 1):
        other = evaluate(branch, values[1:], apply)
        here = _number(jax.lax.ge_p, (index, np.asarray(i, dtype)[()]), {}, apply)
        results = [
            Components(
                one.shape,
                tuple(
                    _number(jax.lax.select_n_p, (here, *pair), {}, apply)
                    for pair in zip(one.items, two.items, strict=True)
                ),
            )
            for one, two in zip(results, other, strict=True)
        ]
    return results


_STRUCTURES: dict[str, Callable[..., list[Components]]] = {
    **dict.fromkeys(_REDUCED, _reduce),
    "cond": _cond,
    "dot_general": _dot,
    "scan": _scan,
    "split": _split,
    "unstack": _unstack,
    "while": _while,
}
