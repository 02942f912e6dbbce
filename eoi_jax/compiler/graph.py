r"""Scalar programs: every component of every array a node of its own.

A step of a pass works on arrays of a few components each, most of whose products are with zeros
and ones (the unit tangents of automatic differentiation). Written out by component, such products
vanish, equal terms coincide, and what remains is the arithmetic that one would write by hand.

Folding takes 0 x = 0, which holds for finite x: a lane that has diverged may show a zero where
the arrays show NaN, but what depends on the diverged values stays NaN.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


class Untranslatable(Exception):  # noqa: N818 - an answer, not a fault of the caller
    """What a scalar program cannot express, by its name in JAX."""


@dataclass(frozen=True, eq=False, slots=True)
class Node:
    """One scalar: an operation on others, a constant, or an input.

    Attributes:
        op: name, a key of `OPERATIONS`; or ``"constant"`` or ``"input"``.
        args: what it works on.
        is_bool: whether it is true or false (all other nodes are numbers).
        value: of a constant; of an input, whatever identifies it to who made it.
        order: when it was made; arguments come before what uses them.
    """

    op: str
    args: tuple["Node", ...]
    is_bool: bool
    value: Any
    order: int


@dataclass(frozen=True)
class Operation:
    """What an operation does on NumPy arrays, and what kind of scalar comes out."""

    function: Callable
    is_bool: bool = False
    commutes: bool = False


def _sign(x: Any) -> Any:
    return np.where(np.isnan(x), x, np.sign(x))


OPERATIONS = {
    "add": Operation(np.add, commutes=True),
    "sub": Operation(np.subtract),
    "mul": Operation(np.multiply, commutes=True),
    "div": Operation(np.divide),
    "rem": Operation(np.fmod),
    "neg": Operation(np.negative),
    "abs": Operation(np.abs),
    "sign": Operation(_sign),
    "max": Operation(np.maximum, commutes=True),
    "min": Operation(np.minimum, commutes=True),
    "select": Operation(np.where),
    "lt": Operation(np.less, is_bool=True),
    "le": Operation(np.less_equal, is_bool=True),
    "eq": Operation(np.equal, is_bool=True, commutes=True),
    "ne": Operation(np.not_equal, is_bool=True, commutes=True),
    "and": Operation(np.logical_and, is_bool=True, commutes=True),
    "or": Operation(np.logical_or, is_bool=True, commutes=True),
    "xor": Operation(np.logical_xor, is_bool=True, commutes=True),
    "not": Operation(np.logical_not, is_bool=True),
    "sqrt": Operation(np.sqrt),
    "floor": Operation(np.floor),
    "ceil": Operation(np.ceil),
    "round_even": Operation(np.rint),
    "trunc": Operation(np.trunc),
    "sin": Operation(np.sin),
    "cos": Operation(np.cos),
    "tan": Operation(np.tan),
    "asin": Operation(np.arcsin),
    "acos": Operation(np.arccos),
    "atan": Operation(np.arctan),
    "atan2": Operation(np.arctan2),
    "sinh": Operation(np.sinh),
    "cosh": Operation(np.cosh),
    "tanh": Operation(np.tanh),
    "asinh": Operation(np.arcsinh),
    "acosh": Operation(np.arccosh),
    "atanh": Operation(np.arctanh),
    "exp": Operation(np.exp),
    "exp2": Operation(np.exp2),
    "expm1": Operation(np.expm1),
    "log": Operation(np.log),
    "log1p": Operation(np.log1p),
    "cbrt": Operation(np.cbrt),
    "pow": Operation(np.power),
}


@dataclass(frozen=True)
class LinearSystem:
    """A x = b that a function solves.

    Attributes:
        matrix: A, nodes of shape (n, n).
        unknown: x, an input for each component.
        right: b.
    """

    matrix: np.ndarray
    unknown: list[Node]
    right: list[Node]


@dataclass(frozen=True)
class Factor:
    """L of A = L Lᵀ, an input for each component, where it is kept for linear systems.

    Attributes:
        lower: L, zero above the diagonal.
        matrix: A, whose lower triangle counts.
        halves: solutions y of L y = b so far, inputs, with b.
    """

    lower: np.ndarray
    matrix: np.ndarray
    halves: list[tuple[list[Node], list[Node]]]


class Graph:
    """Nodes, each made once: equal operations on equal arguments are the same node.

    Attributes:
        branches: conditions on which a program takes its rarer way, in the order in which they
            were met; None where they are not collected.
        as_written: whether operands stay in their order, for formulas.
        writes_out: whether tables, and factorisations of matrices, are written out by choices among
            all their components: no formula to be read.
        systems: linear systems that were met, whose unknowns are inputs; None where they are
            solved.
        factors: Cholesky factors that were met, likewise; None where they are written out.
        named: makes nodes for a function that cannot be written out, from its name in JAX and its
            arguments; None where there is none, or it knows none.
    """

    def __init__(self, *, as_written: bool = False):
        self.as_written = as_written
        self.writes_out = True
        self.branches: list[Node] | None = None
        self.systems: list[LinearSystem] | None = None
        self.factors: list[Factor] | None = None
        self.named: Callable[[str, Sequence[np.ndarray]], np.ndarray | None] | None = None
        self._nodes: dict[tuple, Node] = {}
        self._order = itertools.count()

    def constant(self, value: Any) -> Node:
        """A number, or true or false."""
        is_bool = isinstance(value, bool | np.bool_)
        value = bool(value) if is_bool else float(value) + 0.0  # no negative zero
        return self._leaf("constant", is_bool, value)

    def input(self, value: Any, is_bool: bool = False) -> Node:
        """What has a value only when the program runs."""
        return self._leaf("input", is_bool, value)

    def make(self, op: str, *args: Node) -> Node:
        """An operation, simplified."""
        simpler = _simplify(self, op, args)
        if simpler is not None:
            return simpler
        operation = OPERATIONS[op]
        for arg in args:
            if arg.op != "constant":
                break
        else:
            with np.errstate(all="ignore"):
                return self.constant(operation.function(*(arg.value for arg in args)))
        if operation.commutes and not self.as_written and args[0].order > args[1].order:
            args = args[::-1]
        return self._operation(op, args)

    def keep(self, matrix: np.ndarray, right: list[Node]) -> LinearSystem:
        """A linear system of `systems`; equal ones are the same."""
        assert self.systems is not None
        for system in self.systems:
            if np.array_equal(system.matrix, matrix) and system.right == right:
                return system
        names = (("unknown", len(self.systems), k) for k in range(len(right)))
        system = LinearSystem(matrix, [self.input(name) for name in names], right)
        self.systems.append(system)
        return system

    def _operation(self, op: str, args: tuple[Node, ...]) -> Node:
        key = (op, *[arg.order for arg in args])
        node = self._nodes.get(key)
        if node is None:
            is_bool = args[1].is_bool if op == "select" else OPERATIONS[op].is_bool
            node = self._nodes[key] = Node(op, args, is_bool, None, next(self._order))
        return node

    def _leaf(self, op: str, is_bool: bool, value: Any) -> Node:
        # repr, because NaN does not equal itself; `is_bool`, because True equals 1.0.
        key = (op, is_bool, repr(value))
        if key not in self._nodes:
            self._nodes[key] = Node(op, (), is_bool, value, next(self._order))
        return self._nodes[key]


def topological_order(nodes: Iterable[Node]) -> list[Node]:
    """These nodes and all that they depend on, arguments first."""
    found_nodes: dict[int, Node] = {}
    open_nodes = list(nodes)
    while open_nodes:
        node = open_nodes.pop()
        if node.order not in found_nodes:
            found_nodes[node.order] = node
            open_nodes.extend(node.args)
    return [found_nodes[order] for order in sorted(found_nodes)]


def rewrite(
    nodes: Sequence[Node],
    replaced: dict[Node, Node],
    make: Callable[..., Node],
) -> list[Node]:
    """The same nodes with some replaced, and what depends on these made again.

    Args:
        nodes: what is wanted.
        replaced: the new node of each that is replaced.
        make: makes an operation, as `Graph.make` does.
    """
    new: dict[int, Node] = {node.order: replacement for node, replacement in replaced.items()}
    for node in topological_order(nodes):
        if node.order not in new:
            args = [new[arg.order] for arg in node.args]
            # `make` may choose another form of a node whose arguments stay.
            new[node.order] = make(node.op, *args) if args else node
    return [new[node.order] for node in nodes]


def evaluate(
    nodes: Sequence[Node],
    inputs: Callable[[Any], Any],
    dtype: Any,
    order: Sequence[Node] | None = None,
) -> list[Any]:
    """Values of nodes by NumPy, for inputs that are numbers or arrays of one shape.

    Args:
        nodes: what is wanted.
        inputs: from `Node.value` of an input to its value.
        dtype: of the numbers.
        order: their `topological_order`, for nodes that are evaluated often.
    """
    values: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for node in topological_order(nodes) if order is None else order:
            if node.op == "constant":
                value = node.value if node.is_bool else np.asarray(node.value, dtype)
            elif node.op == "input":
                value = inputs(node.value)
            else:
                value = OPERATIONS[node.op].function(*(values[arg.order] for arg in node.args))
            values[node.order] = value
    return [values[node.order] for node in nodes]


# -- simplification ---------------------------------------------------------------------------


def is_value(node: Node, value: float) -> bool:
    """Whether a node is this constant."""
    return node.op == "constant" and not node.is_bool and node.value == value


def _simplify(graph: Graph, op: str, args: tuple[Node, ...]) -> Node | None:
    """A simpler node of the same value; None if there is none."""
    rule = _RULES.get(op)
    return None if rule is None else rule(graph, *args)


def _add(graph: Graph, a: Node, b: Node) -> Node | None:
    if is_value(a, 0.0) or is_value(b, 0.0):
        return b if is_value(a, 0.0) else a
    if b.op == "neg":
        return graph.make("sub", a, b.args[0])
    return graph.make("sub", b, a.args[0]) if a.op == "neg" and not graph.as_written else None


def _sub(graph: Graph, a: Node, b: Node) -> Node | None:
    if is_value(b, 0.0):
        return a
    if is_value(a, 0.0):
        return graph.make("neg", b)
    if b.op == "neg":
        return graph.make("add", a, b.args[0])
    # Signs move outwards, so that what differs by its sign only is computed once.
    moves = a.op == "neg" and not graph.as_written
    return graph.make("neg", graph.make("add", a.args[0], b)) if moves else None


def _mul(graph: Graph, a: Node, b: Node) -> Node | None:
    for x, y in ((a, b), (b, a)):
        if is_value(x, 0.0):
            return x
        if is_value(x, 1.0):
            return y
        if is_value(x, -1.0):
            return graph.make("neg", y)
        if x.op == "neg":
            sides = (x.args[0], y) if x is a else (y, x.args[0])
            return graph.make("neg", graph.make("mul", *sides))
        flag = x.op == "select" and is_value(x.args[1], 1.0) and is_value(x.args[2], 0.0)
        if flag and not graph.as_written:
            return graph.make("select", x.args[0], y, x.args[2])
    return None


def _div(graph: Graph, a: Node, b: Node) -> Node | None:
    if is_value(b, 1.0) or (is_value(a, 0.0) and not is_value(b, 0.0)):
        return a
    if a.op == "neg":
        return graph.make("neg", graph.make("div", a.args[0], b))
    return graph.make("neg", graph.make("div", a, b.args[0])) if b.op == "neg" else None


def _neg(graph: Graph, a: Node) -> Node | None:
    del graph
    return a.args[0] if a.op == "neg" else None


def _select(graph: Graph, condition: Node, a: Node, b: Node) -> Node | None:
    del graph
    if condition.op == "constant":
        return a if condition.value else b
    # What is replaced by what it equals, as the search of a place in a table does (−0, NaN).
    same = condition.op == "eq" and set(condition.args) == {a, b}
    unordered = condition.op == "ne" and condition.args == (b, b)
    if same or (unordered and a.op == "constant" and np.isnan(a.value)):
        return b
    return a if a is b else None


def _logical_and(graph: Graph, a: Node, b: Node) -> Node | None:
    del graph
    for x, y in ((a, b), (b, a)):
        if x.op == "constant":
            return y if x.value else x
    return a if a is b else None


def _logical_or(graph: Graph, a: Node, b: Node) -> Node | None:
    del graph
    for x, y in ((a, b), (b, a)):
        if x.op == "constant":
            return x if x.value else y
    return a if a is b else None


_RULES: dict[str, Callable] = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "neg": _neg,
    "select": _select,
    "and": _logical_and,
    "or": _logical_or,
}
