"""Functions of one instant, evaluated along a record by NumPy.

A model or an effect at one instant is a scalar program (`graph.py`) of a few dozen
operations, and along the samples of a record each of them is one call of NumPy. XLA would compile
every such function for every length of record, which takes longer than most records take.

    forces = along(force, ("fixed", "rows"), theta, (time, y))  # as `jax.vmap`, with named axes

    slopes = slopes_along(force, ("fixed", "rows"), 0, theta, (time, y))  # ∂force/∂θ

Rows are taken in blocks, so that what is computed on the way stays in the processor's cache.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.derivatives import derivatives, differentiated_by_jax
from eoi_jax.compiler.graph import OPERATIONS, Graph, Node, Untranslatable, topological_order
from eoi_jax.compiler.jit import cached_translation
from eoi_jax.compiler.programs import jit
from eoi_jax.compiler.trace import translate, translated

# Leading axes that the arrays of an argument may have.
AXES = {"fixed": 0, "rows": 1, "grid": 1, "grid rows": 2}

Kind = tuple[tuple[int, ...], str]  # shape and kind of type of a leaf

Read = Callable[[tuple[int, int]], Any]  # a component of a leaf


def along(function: Callable, axes: tuple[str, ...], *args: Any) -> Any:
    """Evaluate a function at every row of a record, and at every point of a grid if there is one.

    Args:
        function: of one tree of arrays for each argument, gives a tree of arrays; hashable, and
            equal to what computes the same.
        axes: of each argument, the leading axes that its arrays have: ``"fixed"`` for none,
            ``"rows"``, ``"grid"``, or ``"grid rows"``.
        args: trees of arrays.

    Returns:
        The function's result as NumPy arrays, with leading axes (rows,), or (grid, rows) where an
        argument has a grid.
    """
    return Along(function, axes, *args)(slice(None))


def slopes_along(
    function: Callable, axes: tuple[str, ...], argument: int, *args: Any
) -> np.ndarray:
    """The Jacobian of a function with one of its arguments, at every row; as of `jax.jacfwd`.

    The derivative is that of the scalar program, which takes a fraction of the time that JAX takes
    to trace one, but where JAX must take it (`derivatives.py`).

    Args:
        function: as of `along`, with one array as its result.
        axes: as of `along`.
        argument: number of the argument, which is one array.
        args: trees of arrays.

    Returns:
        Leading axes as of `along`, then those of the result, then those of the argument.
    """
    return along(_Jacobian(function, argument), axes, *args)


@dataclass(frozen=True)
class _Jacobian:
    """The derivative of a function of one array with an argument that is one."""

    function: Callable
    argument: int

    def __call__(self, *args: Any) -> Any:
        """By JAX."""
        return jax.jacfwd(self.function, self.argument)(*args)


class Along:
    """A function along a record, evaluated at any rows; arguments as in `along`.

    Attributes:
        rows: of the record.
        grid: points of the grid; None without one.
    """

    def __init__(self, function: Callable, axes: tuple[str, ...], *args: Any):
        self._function, self._axes, self._args = function, axes, args
        self.rows, self.grid = _length(axes, args, "rows"), _length(axes, args, "grid")
        dtype = np.dtype(jnp.result_type(float))
        leaves, structures = zip(*(jax.tree.flatten(arg) for arg in args), strict=True)
        pairs = [
            (leaf, axis)
            for argument_leaves, axis in zip(leaves, axes, strict=True)
            for leaf in argument_leaves
        ]
        kinds = tuple((np.shape(leaf)[AXES[axis] :], leaf.dtype.kind) for leaf, axis in pairs)
        try:
            self._program = _program(function, structures, kinds, dtype)
        except Untranslatable:
            self._program = None
        else:
            self._columns = [_columns(leaf, axis, dtype) for leaf, axis in pairs]

    def __call__(self, part: slice, block_size: int = 131072) -> Any:
        """The result at some rows, as from `along`.

        `block_size` is how many numbers of an intermediate result there are at a time: a mebibyte.
        """
        if self._program is None:
            return jax.tree.map(
                lambda leaf: leaf[part] if self.grid is None else leaf[:, part], self._by_xla
            )
        rows = range(self.rows)[part]
        lead = (len(rows),) if self.grid is None else (self.grid, len(rows))
        result = np.empty((len(self._program.outputs), *lead), self._program.dtype)
        step = max(block_size // max(self.grid or 1, 1), 1)
        with np.errstate(all="ignore"):
            for first in range(0, len(rows), step):
                last = min(first + step, len(rows))
                block = slice(rows.start + first, rows.start + last)
                values = self._program.values(functools.partial(self._read, block))
                for component, value in zip(result, values, strict=True):
                    component[..., first:last] = value
        return self._program.tree(result)

    def _read(self, block: slice, at: tuple[int, int]) -> Any:
        """One input at some rows, in a shape that broadcasts with the other inputs."""
        leaf, component = at
        by_rows, columns = self._columns[leaf]
        return columns[component][..., block] if by_rows else columns[component]

    @functools.cached_property
    def _by_xla(self) -> Any:
        """The result at all rows, for a function that a scalar program cannot express."""
        return jax.tree.map(np.asarray, _compiled(self._function, self._axes, self._args))


@jit
def _compiled(function: Callable, axes: tuple[str, ...], args: tuple) -> Any:
    def at_point(*args: Any) -> Any:
        return jax.vmap(function, [0 if "rows" in axis else None for axis in axes])(*args)

    args = jax.tree.map(jnp.asarray, args)
    gridded = ["grid" in axis for axis in axes]
    if not any(gridded):
        return at_point(*args)

    def at(point: list) -> Any:
        coordinates = iter(point)
        pairs = zip(args, gridded, strict=True)
        return at_point(*(next(coordinates) if moves else arg for arg, moves in pairs))

    # `vmap` over the grid would repeat at each point what does not depend on it.
    return jax.lax.map(at, list(itertools.compress(args, gridded)))


def _length(axes: tuple[str, ...], args: tuple, name: str) -> Any:
    """Length of a leading axis; None if no argument has it."""
    for tree, axis in zip(args, axes, strict=True):
        leaves = jax.tree.leaves(tree)
        if name in axis and leaves:
            return np.shape(leaves[0])[axis.split().index(name)]
    return None


def _columns(leaf: Any, axis: str, dtype: Any) -> tuple[bool, np.ndarray]:
    """Whether a leaf has rows, and its components in front; of a grid alone each (grid, 1)."""
    array, count = np.asarray(leaf, dtype), AXES[axis]
    columns = np.moveaxis(array.reshape(*array.shape[:count], -1), -1, 0)
    return "rows" in axis, columns[..., None] if axis == "grid" else columns


# -- the program --------------------------------------------------------------------------


@dataclass(frozen=True)
class _Step:
    """One operation: places of its result and arguments, and of results last used by it."""

    function: Callable
    place: int
    args: tuple[int, ...]
    released: tuple[int, ...]


@dataclass(frozen=True)
class _Program:
    """Operations in order of execution.

    Attributes:
        steps: the operations.
        inputs: what is read from the arguments, by place: a leaf and its component.
        constants: by place.
        outputs: places of the results, component by component.
        structure, shapes: of the tree of results.
        dtype: of all numbers.
    """

    steps: tuple[_Step, ...]
    inputs: dict[int, tuple[int, int]]
    constants: dict[int, Any]
    outputs: tuple[int, ...]
    structure: Any
    shapes: tuple[tuple[int, ...], ...]
    dtype: Any

    def values(self, read: Read) -> Iterator[Any]:
        """The components of the results; `read` gives the value of an input."""
        values = self.constants | {place: read(at) for place, at in self.inputs.items()}
        for step in self.steps:
            values[step.place] = step.function(*[values[arg] for arg in step.args])
            for place in step.released:
                del values[place]
        return (values[place] for place in self.outputs)

    def tree(self, components: np.ndarray) -> Any:
        """The results with their leading axes in front: views of all components."""
        leaves, first = [], 0
        for shape in self.shapes:
            last = first + math.prod(shape)
            leaf = components[first:last].reshape(*shape, *components.shape[1:])
            axes = range(len(shape))
            leaves.append(np.moveaxis(leaf, axes, range(-len(shape), 0)) if shape else leaf)
            first = last
        return jax.tree.unflatten(self.structure, leaves)


@functools.partial(cached_translation, maxsize=256)  # of some ten kilobytes each
def _program(
    function: Callable,
    structures: tuple,
    kinds: tuple[Kind, ...],
    dtype: Any,
) -> _Program:
    """Trace a function and put its operations in order, once."""
    if any(kind not in "fb" for _, kind in kinds):
        raise Untranslatable("arguments of integer type")
    graph, structure = Graph(), None
    counts = [arg_structure.num_leaves for arg_structure in structures]
    shapes = [jax.ShapeDtypeStruct(shape, dtype if kind == "f" else bool) for shape, kind in kinds]
    inputs = [_inputs(graph, leaf, shape) for leaf, shape in enumerate(shapes)]
    results: list[tuple[int, ...]] = []

    def flat(function: Callable, *leaves: Any) -> list:
        nonlocal structure
        iterator = iter(leaves)
        parts = [list(itertools.islice(iterator, count)) for count in counts]
        trees = [
            jax.tree.unflatten(arg_structure, part)
            for arg_structure, part in zip(structures, parts, strict=True)
        ]
        arrays, structure = jax.tree.flatten(function(*trees))
        results[:] = [jnp.shape(array) for array in arrays]
        return arrays

    with jax.enable_x64(dtype == np.float64):
        if isinstance(function, _Jacobian):
            closed = jax.make_jaxpr(functools.partial(flat, function.function))(*shapes)
            if differentiated_by_jax(closed.jaxpr):
                arrays = translate(graph, functools.partial(flat, function), shapes, inputs)
            else:
                place = sum(counts[: function.argument])
                arrays = [_jacobian(graph, translated(graph, closed, inputs)[0], inputs[place])]
                results[:] = [arrays[0].shape]
        else:
            arrays = translate(graph, functools.partial(flat, function), shapes, inputs)
    outputs = [node for array in arrays for node in array.ravel()]
    needed = topological_order(outputs)
    return _Program(
        steps=_steps(needed, outputs),
        inputs={node.order: node.value for node in needed if node.op == "input"},
        constants={node.order: _number(node, dtype) for node in needed if node.op == "constant"},
        outputs=tuple(node.order for node in outputs),
        structure=structure,
        shapes=tuple(results),
        dtype=dtype,
    )


def _jacobian(graph: Graph, values: np.ndarray, argument: np.ndarray) -> np.ndarray:
    """Derivatives of nodes with inputs."""
    slopes = np.empty((values.size, argument.size), object)
    for k, node in enumerate(argument.ravel()):
        slopes[:, k] = derivatives(graph, values.ravel().tolist(), [(node, graph.constant(1.0))])
    return slopes.reshape(*values.shape, *argument.shape)


def _steps(nodes: Sequence[Node], outputs: Sequence[Node]) -> tuple[_Step, ...]:
    """The operations among some nodes, and the results that each is the last to use."""
    last = {arg.order: node.order for node in nodes for arg in node.args}
    output_orders = {node.order for node in outputs}
    steps = []
    for node in nodes:
        if node.args:
            released = {
                arg.order for arg in node.args if arg.args and last[arg.order] == node.order
            }
            places = tuple(arg.order for arg in node.args)
            function = OPERATIONS[node.op].function
            steps.append(_Step(function, node.order, places, tuple(released - output_orders)))
    return tuple(steps)


def _number(node: Node, dtype: Any) -> Any:
    return node.value if node.is_bool else np.asarray(node.value, dtype)[()]


def _inputs(graph: Graph, leaf: int, shape: jax.ShapeDtypeStruct) -> np.ndarray:
    """A leaf as an array of inputs; flags come as numbers."""
    nodes = np.empty(shape.shape, object)
    for component, where in enumerate(np.ndindex(shape.shape)):
        node = graph.input((leaf, component))
        nodes[where] = graph.make("ne", node, graph.constant(0.0)) if shape.dtype == bool else node
    return nodes
