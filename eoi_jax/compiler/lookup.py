"""Components of an array at a place that depends on the data, as of a table: chosen among all."""

from typing import Any

import numpy as np
from jax.lax import GatherScatterMode

from eoi_jax.compiler import indexing
from eoi_jax.compiler.graph import Graph, Node, Untranslatable

MOST_UNROLLED = 64  # turns of a loop, places in a table


def looked_up(graph: Graph, equation: Any, array: np.ndarray, *starts: np.ndarray) -> np.ndarray:
    """Components at a place along one axis that depends on the data.

    Args:
        graph: owner of all nodes.
        equation: of `lax.gather` or `lax.dynamic_slice`.
        array: what is read.
        starts: operands that say where.

    Raises:
        Untranslatable: places along several axes, or more than `MOST_UNROLLED` of them, or where
            tables are not written out.
    """
    name, params = equation.primitive.name, equation.params
    running = np.arange(array.size, dtype=np.int32).reshape(array.shape)
    free = [i for i, start in enumerate(starts) if not is_constant(start)]
    numbers = params.get("dimension_numbers")
    axes = free if numbers is None else numbers.start_index_map
    if not graph.writes_out:
        raise Untranslatable(f"{name} at places that depend on the data")
    if len(axes) > 1 or getattr(numbers, "operand_batching_dims", ()):
        raise Untranslatable(f"{name} at places that depend on the data along several axes")
    (axis,) = axes
    count = array.shape[axis] - params["slice_sizes"][axis] + 1
    if count > MOST_UNROLLED:
        raise Untranslatable(f"{name} at places that depend on the data (over {MOST_UNROLLED})")
    fixed = [
        np.zeros(start.shape, np.int32) if i in free else constants(name, start, atom)
        for i, (start, atom) in enumerate(zip(starts, equation.invars[1:], strict=True))
    ]
    ways = []
    for place in range(count):
        fixed[free[0]] = np.full(starts[free[0]].shape, place, np.int32)
        ways.append(getattr(indexing, name)(params, running, *fixed))
    # The batch of starts lies along the axes of the result that are no offsets.
    offsets = range(ways[0].ndim) if numbers is None else numbers.offset_dims
    batch_axes = [i for i in range(ways[0].ndim) if i not in offsets]
    fills = params.get("mode") == GatherScatterMode.FILL_OR_DROP
    fill = graph.constant(_fill_value(equation)) if fills else None
    largest, flat = graph.constant(count - 1), array.ravel()
    indices = starts[free[0]].reshape([ways[0].shape[i] for i in batch_axes])
    result = np.empty(ways[0].shape, object)
    for at in np.ndindex(result.shape):
        index: Node = indices.item(*(at[i] for i in batch_axes))
        choice = choose(graph, index, *(flat.item(way[at]) for way in ways))
        low, high = index_range(index)
        if fill is not None and not 0 <= low <= high < count:
            beyond_ends = [
                graph.make("lt", index, graph.constant(0)),
                graph.make("lt", largest, index),
            ]
            choice = graph.make("select", graph.make("or", *beyond_ends), fill, choice)
        result[at] = choice
    return result


def _fill_value(equation: Any) -> float:
    """What `lax.gather` gives beyond the ends of an array: by default not a number."""
    value = equation.params["fill_value"]
    if value is None and equation.outvars[0].aval.dtype.kind != "f":
        raise Untranslatable("gather beyond a table that is not of floating-point numbers")
    return np.nan if value is None else float(value)


def index_range(node: Node) -> tuple[float, float]:
    """Bounds of an index, where it is clipped."""
    if node.op == "constant":
        return float(node.value), float(node.value)
    if node.op not in ("min", "max", "add", "sub", "select"):
        return -np.inf, np.inf
    if node.op == "select" and node.args[0].op == "lt":  # as a negative index counts from the end
        (left, _), (_, right) = (index_range(arg) for arg in node.args[0].args)
        if left >= right:
            return index_range(node.args[2])
    (low, high), (other_low, other_high) = (index_range(arg) for arg in node.args[-2:])
    match node.op:
        case "min":
            return min(low, other_low), min(high, other_high)
        case "max":
            return max(low, other_low), max(high, other_high)
        case "add":
            return low + other_low, high + other_high
        case "sub":
            return low - other_high, high - other_low
        case _:
            return min(low, other_low), max(high, other_high)


def is_constant(array: np.ndarray) -> bool:
    """Whether every component is a constant."""
    return all(node.op == "constant" for node in array.ravel())


def constants(name: str, array: np.ndarray, atom: Any) -> np.ndarray:
    """Constants as the numbers that they are."""
    if not is_constant(array):
        raise Untranslatable(f"{name} at places that depend on the data")
    values = [node.value for node in array.ravel()]
    return np.asarray(values, atom.aval.dtype).reshape(array.shape)


def choose(graph: Graph, index: Node, *ways: Node) -> Node:
    """One of several nodes: the first for an index of 0 or less, the last for all beyond.

    Args:
        graph: owner of all nodes.
        index: a number; or a flag, of two nodes.
        ways: the nodes.
    """
    if index.is_bool:
        return graph.make("select", index, ways[1], ways[0])
    choice = ways[-1]
    for i in range(len(ways) - 2, -1, -1):
        first = graph.make("le", index, graph.constant(i))
        choice = graph.make("select", first, ways[i], choice)
    return choice
