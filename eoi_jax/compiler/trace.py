r"""A function of arrays, traced by JAX, as a scalar program.

Its jaxpr is evaluated on NumPy arrays of nodes: arithmetic makes nodes, component by component,
and whatever only moves components (slices, reshapes, concatenations) moves nodes and leaves no
trace. A loop of known length is written out; one whose length depends on the data cannot be.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from eoi_jax.compiler import indexing
from eoi_jax.compiler.derivatives import JVP, derivatives
from eoi_jax.compiler.graph import OPERATIONS, Graph, Node, Untranslatable
from eoi_jax.compiler.jax_private import (
    CALLS,
    ClosedJaxpr,
    Literal,
    branches_of,
    called,
    operations_of,
    product_part,
    scan_parts,
    solving_part,
)
from eoi_jax.compiler.linear_algebra import cholesky, lu, triangular_solve
from eoi_jax.compiler.lookup import MOST_UNROLLED, choose, constants, is_constant, looked_up


def constant_nodes(graph: Graph, value: Any) -> np.ndarray:
    """An array of constants."""
    array = np.asarray(value)
    if array.dtype.kind not in "fbiu":
        raise Untranslatable(f"numbers of type {array.dtype}")
    nodes = np.empty(array.shape, object)
    nodes.ravel()[:] = [graph.constant(value) for value in array.ravel()]
    return nodes


def translate(
    graph: Graph, function: Callable, shapes: Sequence[jax.ShapeDtypeStruct], inputs: Sequence
) -> list[np.ndarray]:
    """A function of arrays, traced, on nodes.

    Args:
        graph: owner of all nodes.
        function: of as many arrays as there are shapes; returns a list of arrays.
        shapes: of its arguments.
        inputs: arguments as arrays of nodes.

    Returns:
        Its results as arrays of nodes.

    Raises:
        Untranslatable: an operation that is no arithmetic on components known in advance.
    """
    return translated(graph, jax.make_jaxpr(function)(*shapes), inputs)


def translated(graph: Graph, closed: ClosedJaxpr, inputs: Sequence) -> list[np.ndarray]:
    """The same of a function that is traced already."""
    with np.errstate(all="ignore"):  # of constants that are folded
        return _run(graph, closed, inputs)


def _run(graph: Graph, closed: ClosedJaxpr, inputs: Sequence[np.ndarray]) -> list[np.ndarray]:
    fixed = [constant_nodes(graph, value) for value in closed.consts]
    return _evaluated(graph, closed.jaxpr, fixed, inputs)


def _evaluated(
    graph: Graph, jaxpr: Any, fixed: Sequence[np.ndarray], inputs: Sequence[np.ndarray]
) -> list[np.ndarray]:
    variables = (*jaxpr.constvars, *jaxpr.invars)
    values: dict[Any, np.ndarray] = dict(zip(variables, (*fixed, *inputs), strict=True))

    def read(atom: Any) -> np.ndarray:
        return constant_nodes(graph, atom.val) if isinstance(atom, Literal) else values[atom]

    for equation in jaxpr.eqns:
        results = _equation(graph, equation, [read(atom) for atom in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _equation(graph: Graph, equation: Any, args: list[np.ndarray]) -> list[np.ndarray]:
    name, params = equation.primitive.name, equation.params
    if (function := called(equation)) is not None:
        return _called(graph, function, params.get("name", ""), args)
    if name in _ARRAY_RULES:
        return _ARRAY_RULES[name](graph, params, *args)
    shape = equation.outvars[0].aval.shape
    if name in _MOVES:
        moved = _MOVES[name](params, *args)
    elif name in ("gather", "dynamic_slice") and not all(is_constant(arg) for arg in args[1:]):
        moved = looked_up(graph, equation, *args)
    elif name in _INDEXED:
        moved = _indexed(equation, args)
    elif name in _ARRAYS:
        moved = _ARRAYS[name](graph, equation, *args)
    elif name in _COMPONENTS:
        component = functools.partial(_COMPONENTS[name], graph, equation)
        moved = np.frompyfunc(component, len(args), 1)(*args)
    else:
        raise Untranslatable(name)
    result = np.empty(shape, object)
    result[...] = moved
    return [result]


def _called(
    graph: Graph, function: ClosedJaxpr, name: str, args: list[np.ndarray]
) -> list[np.ndarray]:
    """What a function gives; by its name, where it cannot be written out and has one to be read."""
    if graph.named is None:
        return _run(graph, function, args)
    count = len(graph.systems or [])
    try:
        return _run(graph, function, args)
    except Untranslatable:
        result = graph.named(name, args)
        if result is None:
            raise
        if graph.systems is not None:
            del graph.systems[count:]
        return [result]


def _scan(graph: Graph, params: dict, *args: np.ndarray) -> list[np.ndarray]:
    """A loop of known length, written out."""
    loop = scan_parts(params)
    length, consts, carries = loop.length, loop.constants, loop.carries
    if length > MOST_UNROLLED:
        raise Untranslatable(f"scan of {length} turns (more than {MOST_UNROLLED})")
    fixed, carry, rows = (
        args[:consts],
        list(args[consts : consts + carries]),
        args[consts:][carries:],
    )
    turns = range(length - 1, -1, -1) if loop.reverse else range(length)
    stacked: dict[int, list[np.ndarray]] = {}
    for k in turns:
        row = [np.asarray(array[k], object) for array in rows]
        results = _run(graph, loop.body, [*fixed, *carry, *row])
        carry, stacked[k] = results[:carries], results[carries:]
    parts = zip(*(stacked[k] for k in range(length)), strict=True)
    return carry + [np.stack(part) for part in parts]


def _cond(graph: Graph, params: dict, index: np.ndarray, *args: np.ndarray) -> list[np.ndarray]:
    """All branches, and of their results the right one: branches have no other effect."""
    chosen = _flag_of(graph, index.item())
    outer, branches = graph.branches, []
    for i, branch in enumerate(branches_of(params)):
        graph.branches = None if outer is None else []
        branches.append(_run(graph, branch, args))
        if outer is not None and i == 1 and chosen.is_bool:
            # Inside a branch that is not taken nothing happens.
            inner = [graph.make("and", chosen, branch) for branch in graph.branches or []]
            outer.extend([chosen, *inner])
    graph.branches = outer
    results = []
    for ways in zip(*branches, strict=True):
        array = np.empty(ways[0].shape, object)
        for at in np.ndindex(array.shape):
            array[at] = choose(graph, chosen, *(values[at] for values in ways))
        results.append(array)
    return results


def _flag_of(graph: Graph, node: Node) -> Node:
    """The flag that was made a number to choose between two branches."""
    plain = node.op == "select" and node.args[1:] == (graph.constant(1.0), graph.constant(0.0))
    return node.args[0] if plain else node


def _split(graph: Graph, params: dict, array: np.ndarray) -> list[np.ndarray]:
    del graph
    ends = np.cumsum([int(size) for size in params["sizes"]])[:-1]
    return np.split(array, ends, axis=params["axis"])


def _unstack(graph: Graph, params: dict, array: np.ndarray) -> list[np.ndarray]:
    del graph
    return [np.asarray(part, object) for part in np.moveaxis(array, params["axis"], 0)]


def _platform(graph: Graph, params: dict) -> list[np.ndarray]:
    """Which of several forms of a function is meant for the CPU."""
    fits = [names is None or "cpu" in names for names in params["platforms"]]
    return [constant_nodes(graph, fits.index(True))]


def _linear_solve(graph: Graph, params: dict, *args: np.ndarray) -> list[np.ndarray]:
    """A x = b by the function that solves it; those for other derivatives are not needed."""
    if graph.systems is None:
        return _run(graph, *solving_part(params, args))
    product, factors, right = product_part(params, args)
    if all(node.op == "constant" for array in factors for node in array.flat):
        return _run(graph, *solving_part(params, args))
    count = sum(array.size for array in right)
    matrix = np.empty((count, count), object)
    for k, unit in enumerate(np.eye(count)):  # A column by column: its product with each unit
        parts = _shaped(constant_nodes(graph, unit), right)
        columns = _run(graph, product, [*factors, *parts])
        matrix[:, k] = [node for column in columns for node in column.flat]
    sides = [node for array in right for node in array.flat]
    flat = np.empty(count, object)
    flat[:] = graph.keep(matrix, sides).unknown
    return _shaped(flat, right)


def _shaped(flat: np.ndarray, like: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Components one after the other as arrays of the shapes of others."""
    ends = np.cumsum([array.size for array in like])[:-1]
    parts = np.split(flat, ends)
    return [part.reshape(array.shape) for part, array in zip(parts, like, strict=True)]


def _jvp(graph: Graph, params: dict, *args: np.ndarray) -> list[np.ndarray]:
    """A function and its derivative, for which `derivatives.jvp` stands."""
    jaxpr = params["jaxpr"]
    first, second = np.cumsum([len(jaxpr.constvars), len(jaxpr.invars)])
    fixed, primals, moved = args[:first], args[first:second], args[second:]
    results = _evaluated(graph, jaxpr, fixed, primals)
    pairs = zip(primals, moved, strict=True)
    tangents = [pair for x, dx in pairs for pair in zip(x.ravel(), dx.ravel(), strict=True)]
    flat = [node for array in results for node in array.ravel()]
    fixed_nodes = [node for array in fixed for node in array.ravel()]
    slopes = np.empty(len(flat), object)
    slopes[:] = derivatives(graph, flat, tangents, fixed_nodes)
    return [*results, *_shaped(slopes, results)]


_ARRAY_RULES: dict[str, Callable] = {
    JVP.name: _jvp,
    "custom_linear_solve": _linear_solve,
    "lu": lu,
    "cholesky": cholesky,
    "triangular_solve": triangular_solve,
    "platform_index": _platform,
    "scan": _scan,
    "cond": _cond,
    "split": _split,
    "unstack": _unstack,
}


# -- components moved, known in advance -------------------------------------------------------


def _broadcast(params: dict, array: np.ndarray) -> np.ndarray:
    shape = np.ones(len(params["shape"]), int)
    shape[list(params["broadcast_dimensions"])] = array.shape
    return np.broadcast_to(array.reshape(shape), params["shape"])


def _slice(params: dict, array: np.ndarray) -> np.ndarray:
    strides = params["strides"] or (1,) * array.ndim
    limits = zip(params["start_indices"], params["limit_indices"], strides, strict=True)
    return array[tuple(slice(*limit) for limit in limits)]


def _unchanged(params: dict, array: np.ndarray) -> np.ndarray:
    del params
    return array


_MOVES: dict[str, Callable] = {
    "broadcast_in_dim": _broadcast,
    "slice": _slice,
    "reshape": lambda params, array: array.reshape(params["new_sizes"]),
    "squeeze": lambda params, array: np.squeeze(array, tuple(params["dimensions"])),
    "expand_dims": lambda params, array: np.expand_dims(array, tuple(params["dimensions"])),
    "transpose": lambda params, array: array.transpose(params["permutation"]),
    "rev": lambda params, array: np.flip(array, params["dimensions"]),
    "stack": lambda params, *arrays: np.stack(arrays, params["axis"]),
    "concatenate": lambda params, *arrays: np.concatenate(arrays, params["dimension"]),
    "tile": lambda params, array: np.tile(array, params["reps"]),
    "copy": _unchanged,
    "copy_p": _unchanged,
    "stop_gradient": _unchanged,
    "optimization_barrier": _unchanged,
}

# Operands from there on say where, or are parts of the first operand's kind before it.
_INDEXED = {
    "gather": (0,),
    "scatter": (0, 2),
    "dynamic_slice": (0,),
    "dynamic_update_slice": (0, 1),
    "pad": (0, 1),
}


def _indexed(equation: Any, args: list[np.ndarray]) -> np.ndarray:
    """Which component ends where: told by running numbers in place of components."""
    name = equation.primitive.name
    movable = _INDEXED[name]
    flat, operands = [], []
    for i, (array, atom) in enumerate(zip(args, equation.invars, strict=True)):
        if i in movable:
            first = len(flat)
            flat.extend(array.ravel())
            operands.append(np.arange(first, len(flat), dtype=np.int32).reshape(array.shape))
        else:
            operands.append(constants(name, array, atom))
    places = getattr(indexing, name)(equation.params, *operands)
    if not np.all((places >= 0) & (places < len(flat))):
        raise Untranslatable(f"{name} beyond its array")
    components = np.empty(len(flat), object)
    components[:] = flat
    return components[places]


def _scatter_add(
    graph: Graph, equation: Any, array: np.ndarray, where: np.ndarray, added: np.ndarray
) -> np.ndarray:
    numbers = np.arange(added.size, dtype=np.int32).reshape(added.shape)
    nowhere = np.full(array.shape, -1, np.int32)
    places = constants("scatter-add", where, equation.invars[1])
    hits = indexing.scatter(equation.params, nowhere, places, numbers)
    result, flat = array.copy(), added.ravel()
    if np.sum(hits >= 0) != added.size:
        raise Untranslatable("scatter-add beyond its array, or twice at one place")
    for at in np.ndindex(hits.shape):
        if hits[at] >= 0:
            result[at] = graph.make("add", array.item(at), flat.item(hits[at]))
    return result


# -- sums and products of components ----------------------------------------------------------


def _iota(graph: Graph, equation: Any) -> np.ndarray:
    shape, axis = equation.params["shape"], equation.params["dimension"]
    line = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return constant_nodes(graph, np.broadcast_to(line, shape))


def _dot_general(graph: Graph, equation: Any, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    (along_a, along_b), (batch_a, batch_b) = equation.params["dimension_numbers"]
    free_a = [i for i in range(a.ndim) if i not in (*along_a, *batch_a)]
    free_b = [i for i in range(b.ndim) if i not in (*along_b, *batch_b)]
    batch = [a.shape[i] for i in batch_a]
    size = math.prod(a.shape[i] for i in along_a)
    rows = a.transpose([*batch_a, *free_a, *along_a])
    columns = b.transpose([*batch_b, *free_b, *along_b])
    n, m = (math.prod(x.shape[i] for i in free) for x, free in ((a, free_a), (b, free_b)))
    rows = rows.reshape(math.prod(batch), n, 1, size)
    columns = columns.reshape(math.prod(batch), 1, m, size)
    products = np.empty((math.prod(batch), n, m, size), object)
    products[...] = np.frompyfunc(functools.partial(graph.make, "mul"), 2, 1)(rows, columns)
    shape = [*batch, *(a.shape[i] for i in free_a), *(b.shape[i] for i in free_b)]
    return _folded(graph, "add", products, (3,), graph.constant(0.0)).reshape(shape)


def _folded(graph: Graph, op: str, array: np.ndarray, axes: Sequence, start: Node) -> np.ndarray:
    """Components along some axes joined by one operation."""
    outer = [i for i in range(array.ndim) if i not in axes]
    shape = [array.shape[i] for i in outer]
    size = math.prod(array.shape[i] for i in axes)
    lines = array.transpose([*outer, *axes]).reshape(math.prod(shape), size)
    result = np.empty(len(lines), object)
    for i, line in enumerate(lines):
        result[i] = (
            functools.reduce(functools.partial(graph.make, op), line) if len(line) else start
        )
    return result.reshape(shape)


def _reduction(op: str, start: Any) -> Callable:
    def reduce(graph: Graph, equation: Any, array: np.ndarray) -> np.ndarray:
        return _folded(graph, op, array, equation.params["axes"], graph.constant(start))

    return reduce


def _running(op: str) -> Callable:
    def run(graph: Graph, equation: Any, array: np.ndarray) -> np.ndarray:
        axis, reverse = equation.params["axis"], equation.params["reverse"]
        step = np.frompyfunc(functools.partial(graph.make, op), 2, 1)
        array = np.flip(array, axis) if reverse else array
        result = step.accumulate(array, axis=axis, dtype=object) if array.size else array
        return np.flip(result, axis) if reverse else result

    return run


_ARRAYS: dict[str, Callable] = {
    "iota": _iota,
    "scatter-add": _scatter_add,
    "dot_general": _dot_general,
    "reduce_sum": _reduction("add", 0.0),
    "reduce_prod": _reduction("mul", 1.0),
    "reduce_max": _reduction("max", -np.inf),
    "reduce_min": _reduction("min", np.inf),
    "reduce_and": _reduction("and", True),
    "reduce_or": _reduction("or", False),
    "cumsum": _running("add"),
    "cumprod": _running("mul"),
    "cummax": _running("max"),
    "cummin": _running("min"),
}


# -- one component ----------------------------------------------------------------------------


def _plain(graph: Graph, equation: Any, *args: Node) -> Node:
    name = equation.primitive.name
    if any(arg.is_bool for arg in args) and not OPERATIONS[name].is_bool:
        # The library's arithmetic is on numbers; of flags, only the logical operations are.
        raise Untranslatable(f"{name} of flags")
    kind = equation.outvars[0].aval.dtype.kind
    if kind in "iu" and name == "div":
        return graph.make("trunc", graph.make("div", *args))
    if kind in "iu" and OPERATIONS[name].is_bool:
        raise Untranslatable(f"{name} of integers")
    return graph.make(name, *args)


def _converted(graph: Graph, equation: Any, node: Node) -> Node:
    kind = np.dtype(equation.params["new_dtype"]).kind
    source_kind = equation.invars[0].aval.dtype.kind
    if kind == "b":
        return node if node.is_bool else graph.make("ne", node, graph.constant(0.0))
    if kind not in "fiu":
        raise Untranslatable(f"numbers of type {equation.params['new_dtype']}")
    if node.is_bool:
        return graph.make("select", node, graph.constant(1.0), graph.constant(0.0))
    return graph.make("trunc", node) if kind in "iu" and source_kind == "f" else node


def _power(graph: Graph, equation: Any, node: Node) -> Node:
    return power(graph, node, equation.params["y"])


def power(graph: Graph, node: Node, exponent: int) -> Node:
    """A whole power by products."""
    if exponent < 0:
        return graph.make("div", graph.constant(1.0), power(graph, node, -exponent))
    if exponent == 0:
        return graph.constant(1.0)
    half_power = power(graph, node, exponent // 2)
    square = graph.make("mul", half_power, half_power)
    return graph.make("mul", square, node) if exponent % 2 else square


def _round(graph: Graph, equation: Any, node: Node) -> Node:
    if equation.params["rounding_method"] == jax.lax.RoundingMethod.TO_NEAREST_EVEN:
        return graph.make("round_even", node)
    rounded = graph.make("floor", graph.make("add", graph.make("abs", node), graph.constant(0.5)))
    return graph.make("mul", graph.make("sign", node), rounded)


def _polynomial(graph: Graph, equation: Any, node: Node, *coefficients: Node) -> Node:
    """Horner's rule; the constant coefficient comes first."""
    del equation
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = graph.make("add", coefficient, graph.make("mul", node, value))
    return value


def _clamp(graph: Graph, equation: Any, low: Node, node: Node, high: Node) -> Node:
    del equation
    return graph.make("min", graph.make("max", low, node), high)


def _select_n(graph: Graph, equation: Any, index: Node, *ways: Node) -> Node:
    del equation
    return choose(graph, index, *ways)


def _composed(*steps: str | float) -> Callable:
    """Operations on the one argument in turn; a number is a first operand."""

    def run(graph: Graph, equation: Any, node: Node) -> Node:
        del equation
        first = None
        for step in steps:
            if isinstance(step, str):
                node = graph.make(step, node) if first is None else graph.make(step, first, node)
                first = None
            else:
                first = graph.constant(step)
        return node

    return run


def _swapped(op: str) -> Callable:
    return lambda graph, _, a, b: graph.make(op, b, a)


def _finite(graph: Graph, equation: Any, node: Node) -> Node:
    del equation
    return graph.make("lt", graph.make("abs", node), graph.constant(np.inf))


_COMPONENTS: dict[str, Callable] = {
    **dict.fromkeys(set(OPERATIONS) - {"select", "trunc", "round_even"}, _plain),
    "add_any": lambda graph, _, a, b: graph.make("add", a, b),
    # Total order, which differs for NaN alone.
    "lt_to": lambda graph, _, a, b: graph.make("lt", a, b),
    "le_to": lambda graph, _, a, b: graph.make("le", a, b),
    "gt": _swapped("lt"),
    "ge": _swapped("le"),
    "integer_pow": _power,
    "polynomial": _polynomial,
    "round": _round,
    "square": lambda graph, _, a: graph.make("mul", a, a),
    **{f"safe_{op}": _composed(op) for op in ("sqrt", "cbrt")},  # of `roots.py`
    "safe_pow": lambda graph, _, a, b: graph.make("pow", a, b),
    "rsqrt": _composed("sqrt", 1.0, "div"),
    "log2": _composed("log", float(1.0 / np.log(2.0)), "mul"),
    "logistic": _composed("neg", "exp", 1.0, "add", 1.0, "div"),
    "is_finite": _finite,
    "convert_element_type": _converted,
    "clamp": _clamp,
    "select_n": _select_n,
}


def is_arithmetic(closed: ClosedJaxpr) -> bool:
    """Whether a traced function only computes and moves components.

    It then solves no equations, transforms nothing, and calls nothing outside of JAX.
    """
    return operations_of(closed.jaxpr) <= _ARITHMETIC


_ARITHMETIC = {*_COMPONENTS, *_MOVES, *_INDEXED, *_ARRAYS, *CALLS, "split", "unstack"}
