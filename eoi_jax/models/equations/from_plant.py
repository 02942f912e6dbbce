"""A plant's functions as formulas, whatever they are written in.

JAX traces a function to scalar operations on the plant's signals and parameters, in the order in
which they were written; operations become trees, and what stands for one thing is one again: a
power, a guarded root, a clip.
"""

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check
from eoi_jax.compiler.graph import Graph, Node, Untranslatable, is_value, topological_order
from eoi_jax.compiler.trace import translate
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.expression import (
    Call,
    Expression,
    Number,
    Operation,
    Symbol,
    parts_of,
)
from eoi_jax.models.plant import Plant, State


@dataclass(frozen=True)
class FormulaSettings:
    """How long a formula may be."""

    stored_depth: int = 25  # levels in a file; deeper ones are hard to read, and to parse
    stored_size: int = 60  # parts in a file, for the same reason; two of them make a formula
    shown_depth: int = 100  # levels of one that is shown
    shown_size: int = 400  # parts of one that is shown
    whole_size: int = 60  # parts up to which it is shown without names for what it repeats
    repeated_size: int = 5  # parts from which on what it repeats has a name then
    most_parts: int = 1500  # of all that is shown of a model


_SETTINGS = FormulaSettings()


class SymbolicPlant:
    """A plant whose signals and parameters are names.

    Attributes:
        plant: which.
        graph: owner of all nodes.
        y: nodes of the outputs and their derivatives, zero where an output does not have them.
        theta, z, inputs: a node for each name.
    """

    def __init__(
        self, plant: Plant, names: Sequence[str] | None = None, states: Sequence[str] | None = None
    ):
        """The symbols.

        Args:
            plant: any.
            names: of the parameters; None: of the plant.
            states: names of internal states; None: of the plant.
        """
        self.plant = plant
        self.graph = Graph(as_written=True)
        names = plant.names if names is None else names
        self.theta = [self.graph.input(Symbol(name, parameter=True)) for name in names]
        self.inputs = [self.graph.input(Symbol(name)) for name in plant.inputs]
        self.y = np.empty((plant.rows, len(plant.outputs)), object)
        for i, j in np.ndindex(self.y.shape):
            owned = i < plant.degrees[j]
            symbol = Symbol(plant.outputs[j], i)
            self.y[i, j] = self.graph.input(symbol) if owned else self.graph.constant(0.0)
        states = internal_names(plant) if states is None else states
        self.z = [self.graph.input(Symbol(name)) for name in states]

    def nodes(
        self, function: Callable[..., Any], inputs: Sequence[Node] | None = None
    ) -> list[Node]:
        """What a function computes, component by component.

        Args:
            function: of t, the state, inputs and all parameters as an array.
            inputs: in place of the plant's.

        Raises:
            Untranslatable: an operation that is no arithmetic on components.
        """

        def of_arrays(t: Any, y: Any, z: Any, u: Any, theta: Any) -> list[Any]:
            return [jnp.ravel(jnp.asarray(function(t, State(y, z), u, theta)))]

        time = np.asarray(self.graph.input(Symbol("t")), object)
        driven = self.inputs if inputs is None else inputs
        arguments = [time, self.y, *map(_row, (self.z, driven, self.theta))]
        dtype = jnp.result_type(float)
        shapes = [jax.ShapeDtypeStruct(array.shape, dtype) for array in arguments]
        (nodes,) = translate(self.graph, of_arrays, shapes, arguments)
        return list(nodes)

    def formulas(self, function: Callable[..., Any]) -> list[Expression] | None:
        """What a function computes, to be read; None where there is no formula, or a long one.

        Args:
            function: as for `nodes`.
        """
        self.graph.writes_out = False
        try:
            nodes = self.nodes(function)
        except Untranslatable:
            return None
        finally:
            self.graph.writes_out = True
        if not all(
            np.isfinite(node.value) for node in topological_order(nodes) if node.op == "constant"
        ):
            return None
        forms = _Forms(nodes)
        trees = forms.trees()
        return None if any(forms.is_long(node) for node in nodes) else trees


def _row(nodes: Sequence[Node]) -> np.ndarray:
    row = np.empty(len(nodes), object)
    row[:] = nodes
    return row


def shared_formulas(
    nodes: Sequence[Node], names: Iterator[str], *, flags: bool = False
) -> tuple[list[Expression], list[tuple[Symbol, Expression]]]:
    """Formulas of nodes, where what several of them share, or what is deep, has a name.

    Args:
        nodes: what is wanted.
        names: for what is shared.
        flags: whether what is true or false may have a name too.

    Returns:
        The formulas, and the named parts, each using earlier ones only.
    """
    forms = _Forms(nodes)
    return forms.trees(names, flags), forms.definitions


def readable_formulas(
    nodes: Sequence[Node], names: Iterator[str]
) -> tuple[list[Expression], list[tuple[Symbol, Expression]]] | None:
    """Formulas to be read: whole if they are short, else what they repeat has a name.

    Args:
        nodes: what is wanted.
        names: for what is repeated.

    Returns:
        As of `shared_formulas`; None where a name or a constant is none of a formula, or parts are
        too many to be read.
    """
    for node in topological_order(nodes):
        if node.op == "constant" and not np.isfinite(node.value):
            return None
        if node.op == "input" and not isinstance(node.value, Symbol | Call):
            return None
    forms = _Forms(nodes)
    trees = forms.trees()
    if all(forms.size[node.order] <= _SETTINGS.whole_size for node in nodes):
        return trees, []
    forms = _Forms(nodes)
    size, depth, repeated = _SETTINGS.shown_size, _SETTINGS.shown_depth, _SETTINGS.repeated_size
    trees = forms.trees(names, limits=(size, depth, repeated))
    parts = sum(map(_count, (*trees, *(tree for _, tree in forms.definitions))))
    return (trees, forms.definitions) if parts <= _SETTINGS.most_parts else None


def _count(tree: Expression) -> int:
    """Parts of a tree."""
    return 1 + sum(map(_count, parts_of(tree)))


def named_function(graph: Graph, name: str, args: Sequence[np.ndarray]) -> np.ndarray | None:
    """Nodes for a table, as a function of where it is looked up; None for any other function.

    Args:
        graph: owner of the nodes.
        name: of the function in JAX.
        args: its arguments.
    """
    if name.strip("_") != "interp":
        return None
    places, *tables = args
    values = [node for table in tables for node in table.flat if node.op != "constant"]
    result = np.empty(places.shape, object)
    for at in np.ndindex(places.shape):
        nodes = [places[at], *values]
        inputs = (node for node in topological_order(nodes) if node.op == "input")
        if not all(isinstance(node.value, Symbol | Call) for node in inputs):
            return None
        result[at] = graph.input(Call("interp", tuple(_Forms(nodes).trees())))
    return result


def unused_names(reserved: Collection[str]) -> Iterator[str]:
    """Names w1, w2, … for parts of formulas.

    Args:
        reserved: names that mean something else.
    """
    reserved = set(reserved)
    return (name for i in itertools.count(1) if (name := f"w{i}") not in reserved)


def plain_formulas(nodes: Sequence[Node]) -> list[Expression]:
    """Formulas of nodes, nothing shared.

    Args:
        nodes: what is wanted.
    """
    return _Forms(nodes).trees()


# -- from nodes to trees ----------------------------------------------------------------------

_SIGNS = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "pow": "^",
    "and": "and",
    "or": "or",
    "lt": "<",
    "le": "≤",
    "eq": "=",
    "ne": "≠",
}
_MIRRORED = {"<": ">", "≤": "≥"}
_RENAMED = {"round_even": "round"}
_SHORT = ("neg", "sign", "abs")  # of a name: as short as a name for it


class _Forms:
    """Trees of nodes.

    Attributes:
        roots: the nodes that are wanted.
        varies: whether a node depends on more than parameters and constants.
        size, depth: parts and levels of a node's tree.
        definitions: of the names that were given.
    """

    def __init__(self, roots: Sequence[Node]):
        self.roots = roots
        self.varies: dict[int, bool] = {}
        self.size: dict[int, int] = {}
        self.depth: dict[int, int] = {}
        self.definitions: list[tuple[Symbol, Expression]] = []
        for node in topological_order(roots):
            is_signal = node.op == "input" and not getattr(node.value, "parameter", False)
            self.varies[node.order] = is_signal or any(self.varies[arg.order] for arg in node.args)

    def is_long(self, node: Node) -> bool:
        """Whether a node's tree is too long to be read."""
        size, depth = self.size[node.order], self.depth[node.order]
        return size > _SETTINGS.shown_size or depth > _SETTINGS.shown_depth

    def trees(
        self,
        names: Iterator[str] | None = None,
        flags: bool = False,
        limits: tuple[int, int, int] = (_SETTINGS.stored_size, _SETTINGS.stored_depth, 2),
    ) -> list[Expression]:
        """Trees of the roots; with names for what they share, flags only if wanted.

        Parts beyond the first two limits (size, depth) have a name too, shared ones below the third
        have none.
        """
        uses = self._uses()
        trees: dict[int, Expression] = {}
        for node in topological_order(self.roots):
            if node.order not in uses:
                continue
            kind, args = self._form(node)
            tree = self._tree(node, kind, args, [trees[arg.order] for arg in args])
            depth = 1 + max((self.depth[arg.order] for arg in args), default=0)
            simple = not args or (kind in _SHORT and not self._form(args[0])[1])
            shared = uses[node.order] > 1 and not simple
            size = 1 + sum(self.size[arg.order] for arg in args)
            deep = size > limits[0] or depth > limits[1]
            shared &= size >= limits[2]
            if names is not None and (shared or deep) and (flags or not node.is_bool):
                self.definitions.append((Symbol(next(names)), tree))
                tree, depth, size = self.definitions[-1][0], 1, 1
            trees[node.order], self.depth[node.order], self.size[node.order] = tree, depth, size
        return [trees[node.order] for node in self.roots]

    def _uses(self) -> dict[int, int]:
        uses: dict[int, int] = {}
        open_nodes, visited = list(self.roots), set()
        while open_nodes:
            node = open_nodes.pop()
            uses[node.order] = uses.get(node.order, 0) + 1
            if node.order not in visited:
                visited.add(node.order)
                open_nodes.extend(self._form(node)[1])
        return uses

    def _form(self, node: Node) -> tuple[str, tuple[Node, ...]]:
        """Kind of operation in a formula, and its operands."""
        if node.op == "mul":
            base, power = _power(node)
            if power > 1:
                return f"power {power}", (base,)
        if node.op == "min":
            for inner, high in (node.args, node.args[::-1]):
                if inner.op == "max" and not self.varies[high.order]:
                    value, low = sorted(inner.args, key=lambda arg: not self.varies[arg.order])
                    if self.varies[value.order] and not self.varies[low.order]:
                        return "clip", (value, low, high)
        if node.op == "select" and (base := _guarded(node)) is not None:
            return "root", (base,)
        return node.op, node.args

    def _tree(
        self, node: Node, kind: str, args: Sequence[Node], parts: list[Expression]
    ) -> Expression:
        match kind:
            case "input":
                return node.value
            case "constant":
                return _constant(node)
            case "neg":
                return _negative(parts[0])
            case "root":
                return Call("sqrt", (parts[0],))
            case "sqrt":  # not a number below zero, unlike the root of a text model
                return Call("plain_root", (parts[0],))
            case "exp2":
                return Operation("^", Number(2.0), parts[0])
            case "xor":
                a, b = parts
                return Operation(
                    "or", Operation("and", a, _negated(b)), Operation("and", _negated(a), b)
                )
            case "select" if node.is_bool:
                condition, a, b = parts
                return Operation(
                    "or", Operation("and", condition, a), Operation("and", _negated(condition), b)
                )
            case "select":
                return Call("where", tuple(parts))
            case "eq" | "ne" if args[1].is_bool and args[1].op == "constant":
                return parts[0] if args[1].value == (kind == "eq") else _negated(parts[0])
            case "lt" | "le":
                return self._comparison(_SIGNS[kind], args, parts)
        if kind.startswith("power "):
            return Operation("^", parts[0], Number(float(kind.split()[1])))
        if kind in _SIGNS:
            return _arranged(_SIGNS[kind], *parts)
        return Call(_RENAMED.get(kind, kind), tuple(_without_minus(part) for part in parts))

    def _comparison(
        self, sign: str, args: Sequence[Node], parts: Sequence[Expression]
    ) -> Expression:
        """A comparison with the varying operand first: v > 0 for 0 < v."""
        lhs, rhs = parts
        first, second = (self.varies[arg.order] for arg in args)
        if second and not first:
            return Operation(_MIRRORED[sign], rhs, lhs)
        return Operation(sign, lhs, rhs)


def _power(node: Node) -> tuple[Node, int]:
    """A product of equal factors as one of them and their number."""
    if node.op != "mul":
        return node, 1
    (first, m), (second, n) = _power(node.args[0]), _power(node.args[1])
    return (first, m + n) if first is second else (node, 1)


def _guarded(node: Node) -> Node | None:
    """The argument of a square root that is 0 for negative values; None for another choice."""
    wet, first, second = node.args
    if (
        first.op == "sqrt"
        and is_value(second, 0.0)
        and wet.op == "lt"
        and is_value(wet.args[0], 0.0)
    ):
        inner, x = first.args[0], wet.args[1]
        if inner is x or (inner.op == "select" and inner.args[:2] == (wet, x)):
            return x
    return None


def _arranged(sign: str, lhs: Expression, rhs: Expression) -> Expression:
    """An operation in usual form: 2·k for k·2, -(2·k) for k·(-2), of the same value."""
    if sign == "*" and isinstance(rhs, Number):
        lhs, rhs = rhs, lhs
    if sign == "*" and isinstance(lhs, Number) and lhs.value < 0:
        return _negative(Operation("*", Number(-lhs.value), rhs))
    return Operation(sign, lhs, rhs)


def _negative(expression: Expression) -> Expression:
    return Operation("-", Number(0.0), expression)


def _without_minus(expression: Expression) -> Expression:
    """max(b - a, 0) for max(-(a - b), 0)."""
    match expression:
        case Operation("-", Number(0.0), Operation("-", lhs, rhs)) if lhs != Number(0.0):
            return Operation("-", rhs, lhs)
    return expression


def _negated(flag: Expression) -> Expression:
    return Call("not", (flag,))


def _constant(node: Node) -> Expression:
    if node.is_bool:
        return Operation("<", Number(0.0), Number(1.0 if node.value else -1.0))
    rule = "must hold finite constants to be exported"
    check(bool(np.isfinite(node.value)), "plant", rule, node.value)
    return Number(node.value)
