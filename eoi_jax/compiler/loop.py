r"""A loop over the rows of a table, the same for many lanes, sorted by what depends on what.

What a node depends on decides how often it must be computed, and where (in compilers: binding-time
analysis, and motion of code out of loops):

    nothing but what is fixed    once, by the host
    the lane                     once a lane, by the host
    the row                      once a row, for all lanes together
    both                         for each lane and row: the arithmetic that counts

Carried values are of the kind that their own updates are; those that only the rows move are carried
once for all lanes, and those that never move are constants.

A writer (`instructions.py` for LLVM; one for Pallas is in `estimation/engines/`) gets a sorted loop
as `Body`s: what lanes share in a loop that leaves a row of it behind for the loop of the lanes, or
both in one loop.
"""

import abc
import dataclasses
import functools
import itertools
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import numpy as np

from eoi_jax.compiler.graph import Graph, Node, Untranslatable, rewrite, topological_order
from eoi_jax.compiler.trace import constant_nodes, translate, translated

FIXED, LANE, ROW, LANE_ROW = 0, 1, 2, 3  # bits: differs between lanes; changes with the row
CARRY, BLOCK = "carry", "block"
# By the name of each group of inputs; a group's members are numbered in the order of its leaves.
_LEVELS = {"fixed": FIXED, "lane": LANE, "row": ROW, BLOCK: LANE_ROW}


@dataclass(frozen=True)
class Path:
    """What is computed of one row on one way through it.

    Attributes:
        scalars, vectors: the next value of each carry of the body, in their order.
        outputs: what is written for the row.
    """

    scalars: tuple[Node, ...]
    vectors: tuple[Node, ...]
    outputs: tuple[Node, ...]


@dataclass(frozen=True)
class Body:
    """What a loop computes of each row.

    Attributes:
        scalars, vectors: numbers of the carries that all lanes share, and that each lane has.
        common: the path where no flag is set and nothing happens. general: that of any row.
        events: what may happen in a row; each as it is if none before it did.
        flagged: whether rows have flags.
        columns: place of each node that a row holds in it.
    """

    scalars: tuple[int, ...]
    vectors: tuple[int, ...]
    common: Path
    general: Path
    events: tuple[Node, ...]
    flagged: bool
    columns: dict[Node, int]

    @property
    def nodes(self) -> tuple[Node, ...]:
        """All that is computed."""
        paths = (self.common, self.general)
        parts = ((*path.scalars, *path.vectors, *path.outputs) for path in paths)
        return (*itertools.chain.from_iterable(parts), *self.events)


@dataclass(frozen=True)
class LaneProgram:
    """A loop, sorted by how often its parts are computed.

    Attributes:
        initial: of each carried number before the first row; depends on `fixed` and `lane`.
        representatives: for each carried number, the first one that always equals it.
        lane_carries, shared_carries: those carried for each lane, and once for all.
        common, general: as in `Body`, of all that is carried and put out.
        events: what may happen to a lane in a row, found where the program branches; each as
            it is if none before it did.
        flagged: whether there are flags.
        shared: what lanes need of each row.
        fixed: what is needed that is the same in all rows and lanes.
        lane_constants: what lanes need that is the same in all rows.
        result: what is wanted, with the numbers of the carries in place of values.
        level: how often a node is computed: `FIXED`, `LANE`, `ROW` or `LANE_ROW`.
    """

    initial: tuple[Node, ...]
    representatives: tuple[int, ...]
    lane_carries: tuple[int, ...]
    shared_carries: tuple[int, ...]
    common: Path
    general: Path
    events: tuple[Node, ...]
    flagged: bool
    shared: tuple[Node, ...]
    fixed: tuple[Node, ...]
    lane_constants: tuple[Node, ...]
    result: Any
    level: Callable[[Node], int]

    @functools.cached_property
    def first_row(self) -> tuple[tuple[Node, ...], ...]:
        """What is evaluated for a run: carries and constants of lanes, what is fixed, carries."""
        lanes, shared = (
            tuple(self.initial[i] for i in carries)
            for carries in (self.lane_carries, self.shared_carries)
        )
        return lanes, self.lane_constants, self.fixed, shared

    @functools.cached_property
    def first_order(self) -> list[Node]:
        """All nodes of `first_row`, arguments first."""
        return topological_order(itertools.chain(*self.first_row))

    @functools.cached_property
    def shared_body(self) -> Body:
        """What all lanes share: its outputs are the rows of `lane_body`."""
        path = Path(self.general.scalars, (), self.shared)
        columns = inputs_of([*path.scalars, *path.outputs], "row")
        return Body(self.shared_carries, (), path, path, (), False, columns)

    @functools.cached_property
    def lane_body(self) -> Body:
        """What each lane has for itself."""
        common, general = (
            dataclasses.replace(path, scalars=()) for path in (self.common, self.general)
        )
        columns = {node: column for column, node in enumerate(self.shared)}
        return Body((), self.lane_carries, common, general, self.events, self.flagged, columns)

    @functools.cached_property
    def whole_body(self) -> Body:
        """Both in one loop."""
        body = Body(
            self.shared_carries, self.lane_carries, self.common, self.general,
            self.events, self.flagged, {},
        )  # fmt: skip
        return dataclasses.replace(body, columns=inputs_of(body.nodes, "row"))


def inputs_of(nodes: Iterable[Node], group: str) -> dict[Node, int]:
    """The inputs of one group on which nodes depend, and their numbers in it."""
    inputs = (node for node in topological_order(nodes) if node.op == "input")
    return {node: node.value[1] for node in inputs if node.value[0] == group}


class AbstractLoop(abc.ABC):
    """A recursion over the rows of a table, the same for every lane; its trees hold shapes only.

    A dataclass without an `__eq__` beside this one: a program depends on all of its fields.

    Attributes:
        lane: one lane.
        step: what a step reads, one row.
        dtype: of all numbers.
        flags: names of the row's parts that are set in few rows only.
        branches: whether the code branches where `lax.cond` does, because it seldom goes there.
    """

    lane: Any
    step: Any
    dtype: np.dtype
    flags: ClassVar[tuple[str, ...]] = ()
    branches: ClassVar[bool] = False

    @property
    def row(self) -> Any:
        """One row."""
        return self.step

    @property
    def by_block(self) -> bool:
        """Whether the last number of a row differs between lanes, and is the same in a block."""
        return False

    @property
    @abc.abstractmethod
    def fixed(self) -> Any:
        """What all lanes and rows share."""

    @abc.abstractmethod
    def begin(self, lane: Any, fixed: Any) -> Any:
        """What is carried before the first row."""

    @abc.abstractmethod
    def advance(self, lane: Any, fixed: Any, carry: Any, row: Any) -> tuple[Any, Any]:
        """What is carried after a row, and what is put out for it."""

    @abc.abstractmethod
    def result(self, carry: Any) -> Any:
        """What is wanted in the end."""

    @functools.cached_property
    def key(self) -> tuple:
        """Equal if one program serves both."""
        fields = [getattr(self, field.name) for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        words = [isinstance(value, str | np.dtype) for value in fields]
        trees = [value for value, word in zip(fields, words, strict=True) if not word]
        return _traced_key(trees, *itertools.compress(fields, words))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def _traced_key(trees: Any, *words: Any) -> tuple:
    """What a program depends on: shapes, and the numbers that are known."""
    leaves, structure = jax.tree.flatten(trees)
    values = tuple(
        leaf if isinstance(leaf, jax.ShapeDtypeStruct) else np.asarray(leaf).tobytes()
        for leaf in leaves
    )
    return structure, values, *words


def shapes_of(tree: Any, dtype: Any, skip: int = 0) -> Any:
    """A tree with its real numbers given by shape and type only, its flags too.

    Args:
        tree: of arrays; whole numbers stay as they are.
        dtype: that real numbers take.
        skip: leading axes to leave out.
    """

    def shape(leaf: Any) -> Any:
        array = np.asarray(leaf)
        if array.dtype.kind not in "fb":
            return array
        kind = dtype if array.dtype.kind == "f" else array.dtype
        return jax.ShapeDtypeStruct(array.shape[skip:], kind)

    return jax.tree.map(shape, tree)


def lane_program(loop: AbstractLoop) -> LaneProgram:
    """Trace a loop and sort it.

    Raises:
        Untranslatable: the loop does what a scalar program cannot.
    """
    graph = Graph()
    with jax.enable_x64(loop.dtype == np.float64):
        initial, step, flags, result = _traced(graph, loop)
    step, _, carried = _merge_carries(graph.make, graph, initial, step)
    # Terms that differ in the order of their factors only are found equal in the second round.
    make = _Lowering(graph, Levels(carried))
    step, representatives, carried = _merge_carries(make, graph, initial, step.rewrite({}, make))
    level = Levels(carried)
    make = _Lowering(graph, level)
    unset = {flag: graph.constant(False) for flag in flags}
    quiet, events = _without_events(graph, step.rewrite(unset, make), make)
    order = _Order(tuple(representatives), tuple(carried), level)
    return _sort(tuple(initial), step, quiet, tuple(events), bool(flags), order, result)


@dataclass(frozen=True)
class _Step:
    """What is computed of a row.

    Attributes:
        updated: each carried number after it.
        outputs: what is put out.
        events: where it branches.
    """

    updated: list[Node]
    outputs: list[Node]
    events: list[Node]

    def rewrite(self, replaced: dict[Node, Node], make: Callable[..., Node]) -> "_Step":
        """With some nodes replaced."""
        new = rewrite([*self.updated, *self.outputs, *self.events], replaced, make)
        first, second = len(self.updated), len(self.updated) + len(self.outputs)
        return _Step(new[:first], new[first:second], new[second:])


def _without_events(
    graph: Graph, step: _Step, make: Callable[..., Node]
) -> tuple[_Step, list[Node]]:
    """A step in which nothing happens, and what must be false for that."""
    excluded: list[Node] = []
    while any(event.op != "constant" for event in step.events):
        event = next(event for event in step.events if event.op != "constant")
        excluded.append(event)
        step = step.rewrite({event: graph.constant(False)}, make)
    return step, excluded


def _traced(graph: Graph, loop: AbstractLoop) -> tuple[list[Node], _Step, list[Node], Any]:
    """Carried numbers at first, a step, flags of rare rows, places of the result."""
    begin, carry = jax.make_jaxpr(loop.begin, return_shape=True)(loop.lane, loop.fixed)
    if any(leaf.dtype != loop.dtype for leaf in jax.tree.leaves(carry)):
        raise Untranslatable("a carry of another type than the lanes")
    lane, fixed = _inputs(graph, "lane", loop.lane), _inputs(graph, "fixed", loop.fixed)
    row, carry_inputs = _inputs(graph, "row", loop.row), _inputs(graph, CARRY, carry)
    if loop.by_block:  # the last of a row's leaves
        row[-1] = _inputs(graph, BLOCK, jax.tree.leaves(loop.row)[-1])[0]
    initial = [
        node for array in translated(graph, begin, [*lane, *fixed]) for node in array.ravel()
    ]
    trees = (loop.lane, loop.fixed, carry, loop.row)
    graph.branches = [] if loop.branches else None
    after = _translated(graph, loop.advance, trees, [*lane, *fixed, *carry_inputs, *row])
    names = [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(loop.row)]
    flags = [row[names.index(name)].item() for name in loop.flags]
    places = [np.vectorize(lambda node: node.value[1], otypes=[int])(leaf) for leaf in carry_inputs]
    count = len(initial)
    return (
        initial,
        _Step(after[:count], after[count:], graph.branches or []),
        flags,
        loop.result(jax.tree.unflatten(jax.tree.structure(carry), places)),
    )


def _inputs(graph: Graph, group: str, tree: Any) -> list[np.ndarray]:
    """The leaves of a tree of shapes as arrays of inputs, numbered through."""
    arrays, count = [], 0
    for leaf in jax.tree.leaves(tree):
        if not isinstance(leaf, jax.ShapeDtypeStruct):
            arrays.append(constant_nodes(graph, leaf))
            continue
        array = np.empty(leaf.shape, object)
        for index in np.ndindex(leaf.shape):
            node = graph.input((group, count))
            # Flags come as numbers.
            flag = leaf.dtype == bool
            array[index] = graph.make("ne", node, graph.constant(0.0)) if flag else node
            count += 1
        arrays.append(array)
    return arrays


def _translated(graph: Graph, function: Callable, trees: tuple, inputs: list) -> list[Node]:
    leaves, structure = jax.tree.flatten(trees)

    def flat(*leaves: Any) -> list:
        return jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))

    arrays = translate(graph, flat, leaves, inputs)
    return [node for array in arrays for node in array.ravel()]


def _merge_carries(
    make: Callable[..., Node], graph: Graph, initial: list[Node], step: _Step
) -> tuple[_Step, list[int], list[int]]:
    """A step, the representative of each carried number, and how often each is computed.

    Start from the most hopeful answer: carried numbers that begin alike stay alike, those that
    begin with a constant keep it, and only the first value decides how often they are computed.
    Give way where an update contradicts that, until none does.
    """
    inputs = [graph.input((CARRY, i)) for i in range(len(initial))]
    leaders = [initial.index(node) for node in initial]
    constant = [node.op == "constant" for node in initial]
    carried = [Levels([])(node) for node in initial]
    replaced: dict[Node, Node] = {}
    new: list[Node] = []
    while True:
        last_replaced = replaced
        replaced = {
            node: start if stays else inputs[first]
            for node, start, stays, first in zip(inputs, initial, constant, leaders, strict=True)
        }
        if replaced != last_replaced or not new:
            new = rewrite(step.updated, replaced, make)
        level, previous_answer = Levels(carried), (leaders, constant, carried)
        constant = [
            stayed and node is start
            for stayed, node, start in zip(constant, new, initial, strict=True)
        ]
        kinds = list(zip(leaders, new, strict=True))
        leaders = [kinds.index(kind) for kind in kinds]
        carried = [
            FIXED if stays else previous | level(node) | ROW
            for stays, previous, node in zip(constant, carried, new, strict=True)
        ]
        if (leaders, constant, carried) == previous_answer:
            return step.rewrite(replaced, make), leaders, carried


class Levels:
    """How often a node must be computed, given that of the carried numbers."""

    def __init__(self, carried: list[int]):
        self._carried = carried
        self._levels: dict[Node, int] = {}

    def __call__(self, node: Node) -> int:
        """Either of `FIXED`, `LANE`, `ROW`, `LANE_ROW`."""
        level = self._levels.get(node)
        if level is not None:
            return level
        waiting = [node]
        while waiting:
            top = waiting[-1]
            missing = [arg for arg in top.args if arg not in self._levels]
            if missing:
                waiting.extend(missing)
                continue
            if top.op == "input":
                group, i = top.value
                self._levels[top] = self._carried[i] if group == CARRY else _LEVELS[group]
            else:
                levels = [self._levels[arg] for arg in top.args]
                self._levels[top] = functools.reduce(operator.or_, levels, FIXED)
            waiting.pop()
        return self._levels[node]


class _Lowering:
    """Makes operations so that less remains for each lane and row.

    Products are joined from the rarest factor up, always in one order, so that the products of a
    symmetric matrix are the same node; what all rows or all lanes divide by is inverted once.
    """

    def __init__(self, graph: Graph, level: Levels):
        self._graph, self._level = graph, level
        self._lowered_nodes: dict[tuple, Node] = {}

    def __call__(self, op: str, *args: Node) -> Node:
        key = (op, *[arg.order for arg in args])
        node = self._lowered_nodes.get(key)
        if node is None:
            node = self._lowered_nodes[key] = self._lowered(op, *args)
        return node

    def _lowered(self, op: str, *args: Node) -> Node:
        if op == "div":
            a, b = args
            if self._level(a) & ~self._level(b) and a.op != "constant":
                return self("mul", a, self._graph.make("div", self._graph.constant(1.0), b))
        if op == "mul":
            return self._product(*args)
        if op in ("add", "sub"):
            return self._common_factor(op, *args) or self._graph.make(op, *args)
        return self._graph.make(op, *args)

    def _common_factor(self, op: str, a: Node, b: Node) -> Node | None:
        """k a ± k b = k (a ± b), for the weights of averages."""
        if a.op == b.op == "mul":
            for i, k in enumerate(a.args):
                for j, factor in enumerate(b.args):
                    if k is factor and self._level(k) == FIXED:
                        return self("mul", k, self(op, a.args[1 - i], b.args[1 - j]))
        return None

    def _product(self, a: Node, b: Node) -> Node:
        product = self._graph.make("mul", a, b)
        sign, product = (True, product.args[0]) if product.op == "neg" else (False, product)
        if product.op == "mul":
            factors = self._factors(product)
            mixed = len({self._level(factor) for factor in factors}) > 1
            # Of more than three of one kind, some may be a square that others use.
            product = self._joined(factors) if mixed or len(factors) == 3 else product
        return self._graph.make("neg", product) if sign else product

    def _factors(self, node: Node) -> list[Node]:
        if node.op != "mul":
            return [node]
        return [factor for arg in node.args for factor in self._factors(arg)]

    def _joined(self, factors: list[Node]) -> Node:
        kinds: dict[int, list[Node]] = {FIXED: [], LANE: [], ROW: [], LANE_ROW: []}
        for factor in sorted(factors, key=lambda factor: factor.order):
            kinds[self._level(factor)].append(factor)
        # What is fixed joins the lane's constants, else the row, before it meets what changes.
        first = next(kind for kind in (LANE, ROW, LANE_ROW, FIXED) if kinds[kind])
        if first != FIXED:
            kinds[first] = kinds.pop(FIXED) + kinds[first]
        rarer = [self._chain(kinds[kind]) for kind in (ROW, LANE) if kinds[kind]]
        return self._chain(rarer + kinds[LANE_ROW] if first != FIXED else kinds[FIXED])

    def _chain(self, factors: list[Node]) -> Node:
        return functools.reduce(functools.partial(self._graph.make, "mul"), factors)


# -- sorting ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Order:
    """Levels of nodes and of carried numbers; fields as in `LaneProgram`."""

    representatives: tuple[int, ...]
    carried: tuple[int, ...]
    level: Levels

    def carries(self, kind: int) -> tuple[int, ...]:
        """Those of one kind that are as no earlier one is."""
        pairs = enumerate(zip(self.carried, self.representatives, strict=True))
        return tuple(i for i, (level, first) in pairs if level == kind and first == i)


def _sort(
    initial: tuple[Node, ...],
    general: _Step,
    common: _Step,
    events: tuple[Node, ...],
    flagged: bool,
    order: _Order,
    result: Any,
) -> LaneProgram:
    lanes, shared, level = order.carries(LANE_ROW), order.carries(ROW), order.level
    paths = [
        Path(
            tuple(step.updated[i] for i in shared),
            tuple(step.updated[i] for i in lanes),
            tuple(step.outputs),
        )
        for step in (common, general)
    ]
    by_lanes = [*(node for path in paths for node in (*path.vectors, *path.outputs)), *events]
    read_by_lanes = _read(by_lanes, level, LANE_ROW)
    in_row = _of_level(read_by_lanes, level, ROW)
    read_by_rows = _read([*paths[1].scalars, *in_row], level, ROW)
    return LaneProgram(
        initial=initial,
        representatives=order.representatives,
        lane_carries=lanes,
        shared_carries=shared,
        common=paths[0],
        general=paths[1],
        events=events,
        flagged=flagged,
        shared=in_row,
        fixed=_of_level(read_by_lanes | read_by_rows, level, FIXED),
        lane_constants=_of_level(read_by_lanes, level, LANE),
        result=result,
        level=level,
    )


def _read(results: list[Node], level: Levels, kind: int) -> set[Node]:
    """What the nodes of one kind read, and the results themselves; without constants."""
    inner = [node for node in topological_order(results) if level(node) == kind]
    read = {arg for node in inner for arg in node.args} | set(results)
    return {node for node in read if node.op != "constant"}


def _of_level(nodes: Iterable[Node], level: Levels, kind: int) -> tuple[Node, ...]:
    return tuple(sorted((node for node in nodes if level(node) == kind), key=lambda n: n.order))
