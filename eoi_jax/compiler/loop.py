r"""The pass of one lane as a scalar program, each node computed as rarely as its inputs allow.

What a node depends on decides how often it must be computed, and where:

    nothing but h and F      once, by the host
    the lane (θ, gains)      once a lane, by the host
    the sample               once a step, for all lanes together
    both                     for each lane and step: the arithmetic that counts

Carried values are of the kind that their own updates are; those that only the record moves (the
filtered input, its sums) are carried once for all lanes, and those that never move are constants.
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

from eoi_jax.compiler.graph import Graph, Node, Untranslatable, ordered, rewritten
from eoi_jax.compiler.trace import nodes_of, translated

ONCE, LANE, STEP, BOTH = 0, 1, 2, 3  # bits: differs between lanes; changes with the step
CARRY, BLOCK = "carry", "block"
# By the name of each group of inputs; a group's members are numbered in the order of its leaves.
_LEVELS = {"fixed": ONCE, "lane": LANE, "step": STEP, BLOCK: BOTH}


@dataclass(frozen=True)
class Update:
    """The next value of one carried number."""

    carry: int
    node: Node


@dataclass(frozen=True)
class LaneProgram:
    """A pass, sorted by how often its parts are computed.

    Attributes:
        initial: of each carried number before the first step; depends on `fixed` and `lane`.
        same: as which carried number each one always is.
        lane_carries, step_carries: those carried for each lane, and once for all.
        step_updates: of the carries that all lanes share, in any step; `plain_steps` where nothing
            happens.
        plain, rare: updates of the lanes' carries in a step in which no flag is set and nothing
            happens, and in any.
        events: what may happen to a lane in a step, found where the program branches; each as
            it is if none before it did.
        flagged: whether there are flags.
        shown: what each step shows of each lane where nothing happens, and in any step.
        shared: what lanes need of each step.
        fixed: what is needed that is the same in all steps and lanes.
        own: what lanes need that is the same in all steps.
        sums: the pass's sums, with the numbers of the carries in place of values.
        level: how often a node is computed: `ONCE`, `LANE`, `STEP` or `BOTH`.
    """

    initial: tuple[Node, ...]
    same: tuple[int, ...]
    lane_carries: tuple[int, ...]
    step_carries: tuple[int, ...]
    step_updates: tuple[Update, ...]
    plain_steps: tuple[Update, ...]
    plain: tuple[Update, ...]
    rare: tuple[Update, ...]
    events: tuple[Node, ...]
    flagged: bool
    shown: tuple[tuple[Node, ...], tuple[Node, ...]]
    shared: tuple[Node, ...]
    fixed: tuple[Node, ...]
    own: tuple[Node, ...]
    sums: Any
    level: Callable[[Node], int]


class AbstractLoop(abc.ABC):
    """A recursion over the rows of a record, the same for every lane; its trees hold shapes only.

    A dataclass without an `__eq__` of its own: all of its fields are what a program depends on.

    Attributes:
        lane: one lane.
        dtype: of all numbers.
        flags: names of the row's parts that are set in few rows only.
        branches: whether the code branches where `lax.cond` does, because it seldom goes there.
    """

    lane: Any
    dtype: np.dtype
    flags: ClassVar[tuple[str, ...]] = ()
    branches: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def row(self) -> Any:
        """One row."""

    @property
    def by_block(self) -> bool:
        """Whether the last number of a row is the lane's own in each block."""
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
        """What is carried after a row, and what is shown of it."""

    @abc.abstractmethod
    def result(self, carry: Any) -> Any:
        """What is wanted in the end."""

    @functools.cached_property
    def key(self) -> tuple:
        """Equal if one program serves both."""
        fields = [getattr(self, field.name) for field in dataclasses.fields(self)]  # type: ignore[arg-type]
        words = [isinstance(one, str | np.dtype) for one in fields]
        trees = [one for one, word in zip(fields, words, strict=True) if not word]
        return _traced_key(trees, *itertools.compress(fields, words))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def _traced_key(trees: Any, *other: Any) -> tuple:
    """What a program depends on: shapes, and the numbers that are known."""
    leaves, structure = jax.tree.flatten(trees)
    known = tuple(
        leaf if isinstance(leaf, jax.ShapeDtypeStruct) else np.asarray(leaf).tobytes()
        for leaf in leaves
    )
    return structure, known, *other


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


def lane_program(what: AbstractLoop) -> LaneProgram:
    """Trace a loop and sort it.

    Raises:
        Untranslatable: the plant or the observer does what a scalar program cannot.
    """
    graph = Graph()
    with jax.enable_x64(what.dtype == np.float64):
        initial, traced, flags, sums = _traced(graph, what)
    traced, _, carried = _levelled(graph.make, graph, initial, traced)
    # Terms that differ in the order of their factors only are found equal in the second round.
    make = _Lowering(graph, Levels(carried))
    traced, same, carried = _levelled(make, graph, initial, traced.rewritten({}, make))
    level = Levels(carried)
    make = _Lowering(graph, level)
    unset = {flag: graph.constant(False) for flag in flags}
    quiet, events = _without_events(graph, traced.rewritten(unset, make), make)
    return _sorted(initial, traced, quiet, events, bool(flags), same, carried, level, sums)


@dataclass(frozen=True)
class _Traced:
    """What a step computes.

    Attributes:
        updated: each carried number after it.
        shown: what it shows.
        events: where it branches.
    """

    updated: list[Node]
    shown: list[Node]
    events: list[Node]

    def rewritten(self, known: dict[Node, Node], make: Callable[..., Node]) -> "_Traced":
        """With some nodes replaced."""
        new = rewritten([*self.updated, *self.shown, *self.events], known, make)
        count, shown = len(self.updated), len(self.shown)
        return _Traced(new[:count], new[count : count + shown], new[count + shown :])


def _without_events(
    graph: Graph, traced: _Traced, make: Callable[..., Node]
) -> tuple[_Traced, list[Node]]:
    """A step in which nothing happens, and what must be found false for that."""
    found: list[Node] = []
    left = traced
    while any(event.op != "constant" for event in left.events):
        event = next(event for event in left.events if event.op != "constant")
        found.append(event)
        left = left.rewritten({event: graph.constant(False)}, make)
    return left, found


def _traced(graph: Graph, what: AbstractLoop) -> tuple[list[Node], _Traced, list[Node], Any]:
    """Carried numbers at first, a step, flags of rare events, places of the result."""
    carry = jax.eval_shape(what.begin, what.lane, what.fixed)
    if any(leaf.dtype != what.dtype for leaf in jax.tree.leaves(carry)):
        raise Untranslatable("a carry of another type than the lanes")
    lane, fixed = _inputs(graph, "lane", what.lane), _inputs(graph, "fixed", what.fixed)
    row, before = _inputs(graph, "step", what.row), _inputs(graph, CARRY, carry)
    if what.by_block:  # the last of a row's leaves
        row[-1] = _inputs(graph, BLOCK, jax.tree.leaves(what.row)[-1])[0]
    initial = _translated(graph, what.begin, (what.lane, what.fixed), [*lane, *fixed])
    trees = (what.lane, what.fixed, carry, what.row)
    graph.branches = [] if what.branches else None
    after = _translated(graph, what.advance, trees, [*lane, *fixed, *before, *row])
    names = [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(what.row)]
    flags = [row[names.index(name)].item() for name in what.flags]
    places = [np.vectorize(lambda node: node.value[1], otypes=[int])(one) for one in before]
    count = len(initial)
    return (
        initial,
        _Traced(after[:count], after[count:], graph.branches or []),
        flags,
        what.result(jax.tree.unflatten(jax.tree.structure(carry), places)),
    )


def _inputs(graph: Graph, group: str, tree: Any) -> list[np.ndarray]:
    """The leaves of a tree of shapes as arrays of inputs, numbered through."""
    out, count = [], 0
    for leaf in jax.tree.leaves(tree):
        if not isinstance(leaf, jax.ShapeDtypeStruct):
            out.append(nodes_of(graph, leaf))
            continue
        array = np.empty(leaf.shape, object)
        for where in np.ndindex(leaf.shape):
            node = graph.input((group, count))
            # Flags come as numbers.
            flag = leaf.dtype == bool
            array[where] = graph.make("ne", node, graph.constant(0.0)) if flag else node
            count += 1
        out.append(array)
    return out


def _translated(graph: Graph, function: Callable, trees: tuple, inputs: list) -> list[Node]:
    leaves, structure = jax.tree.flatten(trees)

    def flat(*leaves: Any) -> list:
        return jax.tree.leaves(function(*jax.tree.unflatten(structure, leaves)))

    out = translated(graph, flat, leaves, inputs)
    return [node for array in out for node in array.ravel()]


def _levelled(
    make: Callable[..., Node], graph: Graph, initial: list[Node], traced: _Traced
) -> tuple[_Traced, list[int], list[int]]:
    """A step, as which other each carried number always is, and how often each is computed.

    Start from the most hopeful answer: carried numbers that begin alike stay alike, those that
    begin with a constant keep it, and only the first value decides how often they are computed.
    Give way where an update contradicts that, until none does.
    """
    inputs = [graph.input((CARRY, i)) for i in range(len(initial))]
    same = [initial.index(node) for node in initial]
    still = [node.op == "constant" for node in initial]
    carried = [Levels([])(node) for node in initial]
    while True:
        known = {
            own: start if rests else inputs[other]
            for own, start, rests, other in zip(inputs, initial, still, same, strict=True)
        }
        new = rewritten(traced.updated, known, make)
        level, before = Levels(carried), (same, still, carried)
        still = [was and node is at for was, node, at in zip(still, new, initial, strict=True)]
        kinds = list(zip(same, new, strict=True))
        same = [kinds.index(kind) for kind in kinds]
        carried = [
            ONCE if rests else old | level(node) | STEP
            for rests, old, node in zip(still, carried, new, strict=True)
        ]
        if (same, still, carried) == before:
            return traced.rewritten(known, make), same, carried


class Levels:
    """How often a node must be computed, given that of the carried numbers."""

    def __init__(self, carried: list[int]):
        self._carried = carried
        self._known: dict[Node, int] = {}

    def __call__(self, node: Node) -> int:
        """One of `ONCE`, `LANE`, `STEP`, `BOTH`."""
        waiting = [node]
        while waiting:
            one = waiting[-1]
            missing = [arg for arg in one.args if arg not in self._known]
            if missing:
                waiting.extend(missing)
                continue
            if one.op == "input":
                group, i = one.value
                self._known[one] = self._carried[i] if group == CARRY else _LEVELS[group]
            else:
                levels = [self._known[arg] for arg in one.args]
                self._known[one] = functools.reduce(operator.or_, levels, ONCE)
            waiting.pop()
        return self._known[node]


class _Lowering:
    """Makes operations so that less remains for each lane and step.

    Products are joined from the rarest factor up, always in one order, so that the products of a
    symmetric matrix are the same node; what all steps or all lanes divide by is inverted once.
    """

    def __init__(self, graph: Graph, level: Levels):
        self._graph, self._level = graph, level

    def __call__(self, op: str, *args: Node) -> Node:
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
                for j, other in enumerate(b.args):
                    if k is other and self._level(k) == ONCE:
                        return self("mul", k, self(op, a.args[1 - i], b.args[1 - j]))
        return None

    def _product(self, a: Node, b: Node) -> Node:
        whole = self._graph.make("mul", a, b)
        sign, whole = (True, whole.args[0]) if whole.op == "neg" else (False, whole)
        if whole.op == "mul":
            factors = self._factors(whole)
            mixed = len({self._level(factor) for factor in factors}) > 1
            # Of more than three of one kind, some may be a square that others use.
            whole = self._joined(factors) if mixed or len(factors) == 3 else whole
        return self._graph.make("neg", whole) if sign else whole

    def _factors(self, node: Node) -> list[Node]:
        if node.op != "mul":
            return [node]
        return [factor for arg in node.args for factor in self._factors(arg)]

    def _joined(self, factors: list[Node]) -> Node:
        kinds: dict[int, list[Node]] = {ONCE: [], LANE: [], STEP: [], BOTH: []}
        for factor in sorted(factors, key=lambda one: one.order):
            kinds[self._level(factor)].append(factor)
        # What is known once joins the gains, else the sample, before it meets a lane's own.
        first = next(kind for kind in (LANE, STEP, BOTH, ONCE) if kinds[kind])
        if first != ONCE:
            kinds[first] = kinds.pop(ONCE) + kinds[first]
        rarer = [self._chain(kinds[kind]) for kind in (STEP, LANE) if kinds[kind]]
        return self._chain(rarer + kinds[BOTH] if first != ONCE else kinds[ONCE])

    def _chain(self, factors: list[Node]) -> Node:
        return functools.reduce(functools.partial(self._graph.make, "mul"), factors)


def _sorted(
    initial: list[Node],
    rare: _Traced,
    plain: _Traced,
    events: list[Node],
    flagged: bool,
    same: list[int],
    carried: list[int],
    level: Levels,
    sums: Any,
) -> LaneProgram:
    lanes, steps = (
        [i for i, one in enumerate(carried) if one == kind and same[i] == i]
        for kind in (BOTH, STEP)
    )
    step_updates, plain_steps = (
        tuple(Update(i, way.updated[i]) for i in steps) for way in (rare, plain)
    )
    plain_updates, rare_updates = (
        tuple(Update(i, way.updated[i]) for i in lanes) for way in (plain, rare)
    )
    wanted = [one.node for one in (*plain_updates, *rare_updates)]
    by_lanes = _used([*wanted, *plain.shown, *rare.shown, *events], level, BOTH)
    shared = _of(by_lanes, level, STEP)
    by_steps = _used([*(one.node for one in step_updates), *shared], level, STEP)
    return LaneProgram(
        initial=tuple(initial),
        same=tuple(same),
        lane_carries=tuple(lanes),
        step_carries=tuple(steps),
        step_updates=step_updates,
        plain_steps=plain_steps,
        plain=plain_updates,
        rare=rare_updates,
        events=tuple(events),
        flagged=flagged,
        shown=(tuple(plain.shown), tuple(rare.shown)),
        shared=shared,
        fixed=_of(by_lanes | by_steps, level, ONCE),
        own=_of(by_lanes, level, LANE),
        sums=sums,
        level=level,
    )


def _used(wanted: list[Node], level: Levels, kind: int) -> set[Node]:
    """What the nodes of one kind read, and what is wanted itself; without constants."""
    inner = [node for node in ordered(wanted) if level(node) == kind]
    read = {arg for node in inner for arg in node.args} | set(wanted)
    return {node for node in read if node.op != "constant"}


def _of(nodes: Iterable[Node], level: Levels, wanted: int) -> tuple[Node, ...]:
    found = [node for node in nodes if level(node) == wanted]
    return tuple(sorted(found, key=lambda node: node.order))
