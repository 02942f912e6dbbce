r"""The right sides of a plant's equations, to be read.

Where a model solves a linear system for its accelerations (`solve`, `inv` or `cho_solve` of a mass
matrix), the system is what its author wrote down, $M(q)\,\ddot q = b$, and is kept; its solution
would be pages long. A long formula gets names for what it repeats, as in a paper.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import numpy as np

from eoi_jax.compiler.derivatives import derivatives
from eoi_jax.compiler.graph import (
    Graph,
    LinearSystem,
    Node,
    Untranslatable,
    is_value,
    rewrite,
    topological_order,
)
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.expression import Expression, Symbol
from eoi_jax.models.equations.from_plant import (
    SymbolicPlant,
    named_function,
    readable_formulas,
    unused_names,
)
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class MatrixEquation:
    """M x = b.

    Attributes:
        matrix: M, row by row.
        unknown: x: derivatives of outputs, or names for a solution.
        right: b.
    """

    matrix: tuple[tuple[Expression, ...], ...]
    unknown: tuple[Symbol, ...]
    right: tuple[Expression, ...]


@dataclass(frozen=True)
class RightSides:
    """What the equations of a plant say.

    Attributes:
        f: y^(r) of each output; None where a matrix equation gives it.
        g: rates of the internal states.
        coupled: matrix equations.
        definitions: named parts of all these, each using earlier ones only.
    """

    f: tuple[Expression | None, ...]
    g: tuple[Expression, ...]
    coupled: tuple[MatrixEquation, ...] = ()
    definitions: tuple[tuple[Symbol, Expression], ...] = ()


def right_sides(plant: Plant, extended: Collection[int] = ()) -> RightSides | None:
    """f and g of a plant as formulas.

    Args:
        plant: any.
        extended: outputs to whose y^(r) something else is added; a matrix equation then gives names
            that stand in their equations.

    Returns:
        None where there is no formula, or none that can be read.
    """
    kept = _right_sides(plant, extended, keeps_factors=True)
    # A Cholesky factor may be of use itself: it is then written out.
    return kept or _right_sides(plant, extended, keeps_factors=False)


def _right_sides(plant: Plant, extended: Collection[int], keeps_factors: bool) -> RightSides | None:
    symbolic = SymbolicPlant(plant)
    graph = symbolic.graph
    graph.writes_out, graph.systems = False, []
    graph.factors = [] if keeps_factors else None
    graph.named = partial(named_function, graph)
    try:
        f = symbolic.nodes(plant.derivative)
        g = symbolic.nodes(plant.internal_rate) if plant.internal is not None else []
    except Untranslatable:
        return None
    states = internal_names(plant)
    free = unused_names((*plant.names, *plant.inputs, *plant.outputs, *states))
    derived = [Symbol(name, n) for name, n in zip(plant.outputs, plant.degrees, strict=True)]
    sides = _Sides(graph, f, g, derived, extended, free)
    for system in graph.systems:
        for copies in _copies(system):
            sides.add(system, copies)
    return sides.right_sides()


def _copies(system: LinearSystem) -> list[list[list[int]]]:
    """Components that depend on each other, those of equal matrices together: columns of A⁻¹."""
    size = len(system.unknown)
    linked = np.reshape([not is_value(node, 0.0) for node in system.matrix.flat], (size, size))
    reached = np.linalg.matrix_power(linked | linked.T | np.eye(size, dtype=bool), size) > 0
    blocks: dict[tuple, list[list[int]]] = {}
    for row in {tuple(np.flatnonzero(row).tolist()): None for row in reached}:
        block = list(row)
        key = tuple(node.order for node in system.matrix[np.ix_(block, block)].flat)
        blocks.setdefault(key, []).append(block)
    return list(blocks.values())


class _Sides:
    """Right sides as nodes, with the systems that are kept as equations."""

    def __init__(
        self,
        graph: Graph,
        f: Sequence[Node],
        g: Sequence[Node],
        derived: Sequence[Symbol],
        extended: Collection[int],
        names: Iterator[str],
    ):
        self._graph, self._g, self._derived, self._names = graph, list(g), derived, names
        self._f: list[Node | None] = list(f)
        self._extended = extended
        self._equations: list[tuple[np.ndarray, list[Symbol], list[Node]]] = []
        self._solved: dict[Node, Node] = {}

    def add(self, system: LinearSystem, copies: list[list[int]]) -> None:
        """Keep a matrix with its right sides."""
        matrix = system.matrix[np.ix_(copies[0], copies[0])]
        unknown = [[system.unknown[k] for k in block] for block in copies]
        right = [[system.right[k] for k in block] for block in copies]
        if len(matrix) == 1:
            for (x,), (b,) in zip(unknown, right, strict=True):
                self._solved[x] = self._graph.make("div", b, matrix[0, 0])
            return
        matched = self._matched(unknown)
        if matched is None:
            for x, b in zip(unknown, right, strict=True):
                symbols = [Symbol(next(self._names)) for _ in x]
                self._solve(x, symbols)
                self._equations.append((matrix, symbols, b))
            return
        rows, weights = matched
        mixed = [
            reduce(self._maker("add"), map(self._maker("mul"), column, weights))
            for column in zip(*right, strict=True)
        ]
        symbols = [self._derived[j] for j in rows]
        if any(j in self._extended for j in rows):
            symbols = [Symbol(next(self._names)) for _ in rows]
        for j, symbol in zip(rows, symbols, strict=True):
            named = symbol != self._derived[j]
            self._f[j] = self._graph.input(symbol) if named else None
        if len(unknown) == 1:
            self._solve(unknown[0], symbols)
        self._equations.append((matrix, symbols, mixed))

    def _maker(self, op: str) -> Callable[[Node, Node], Node]:
        return lambda a, b: self._graph.make(op, a, b)

    def _solve(self, unknown: Sequence[Node], symbols: Sequence[Symbol]) -> None:
        for x, symbol in zip(unknown, symbols, strict=True):
            self._solved[x] = self._graph.input(symbol)

    def _matched(self, unknown: list[list[Node]]) -> tuple[list[int], list[Node]] | None:
        """The output of each row, and the weights w of Σ w_k x_k, the same of all, that these are.

        The solutions x_k are of one matrix with several right sides. None where outputs are not
        such a sum each, or something else depends on the solutions as well.
        """
        graph, everything = self._graph, {node for block in unknown for node in block}
        unit, zero = graph.constant(1.0), graph.constant(0.0)
        depends = [
            j
            for j, node in enumerate(self._f)
            if node is not None and everything & set(topological_order([node]))
        ]
        sums = [node for j in depends if (node := self._f[j]) is not None]
        slopes = np.empty((len(unknown), len(unknown[0]), len(depends)), object)
        for k, i in np.ndindex(slopes.shape[:2]):
            slopes[k, i] = derivatives(graph, sums, [(unknown[k][i], unit)])
        rests = rewrite(sums, dict.fromkeys(everything, zero), graph.make)
        outputs: dict[int, int] = {}
        weights: list[Node] | None = None
        for column, (j, rest) in enumerate(zip(depends, rests, strict=True)):
            rows = [
                i
                for i in range(slopes.shape[1])
                if not all(is_value(node, 0.0) for node in slopes[:, i, column])
            ]
            if len(rows) != 1 or rows[0] in outputs or not is_value(rest, 0.0):
                if len(unknown) > 1:
                    return None
                continue  # shows the one solution, by its name
            factors = list(slopes[:, rows[0], column])
            if weights is not None and factors != weights:
                return None
            weights, outputs[rows[0]] = factors, j
        if weights is None or len(outputs) < slopes.shape[1]:
            return None
        single = len(unknown) == 1
        elsewhere = [] if single else [*self._g, *self._other_nodes()]
        if (single and weights != [unit]) or everything & set(
            topological_order([*weights, *elsewhere])
        ):
            return None
        return [outputs[i] for i in range(slopes.shape[1])], weights

    def _other_nodes(self) -> list[Node]:
        """Nodes of all other systems."""
        systems = self._graph.systems or []
        return [node for system in systems for node in (*system.matrix.flat, *system.right)]

    def right_sides(self) -> RightSides | None:
        """As formulas."""
        f = [node for node in self._f if node is not None]
        entries = [[*matrix.flat, *right] for matrix, _, right in self._equations]
        nodes = [*f, *self._g, *(node for part in entries for node in part)]
        for _ in self._graph.systems or []:  # one may need the solution of another
            nodes = rewrite(nodes, self._solved, self._graph.make)
        formulas = readable_formulas(nodes, self._names)
        if formulas is None:
            return None
        trees, definitions = iter(formulas[0]), tuple(formulas[1])
        f_trees = tuple(None if node is None else next(trees) for node in self._f)
        g_trees = tuple(next(trees) for _ in self._g)
        coupled = []
        for _, unknown, _ in self._equations:
            size = len(unknown)
            matrix = tuple(tuple(next(trees) for _ in range(size)) for _ in range(size))
            right = tuple(next(trees) for _ in range(size))
            coupled.append(MatrixEquation(matrix, tuple(unknown), right))
        return RightSides(f_trees, g_trees, tuple(coupled), definitions)
