r"""Factorisations and triangular systems of small matrices, component by component.

What `jnp.linalg.solve`, `jnp.linalg.inv` and `jnp.linalg.cholesky` of a mass matrix become: the
elimination is written out, and rows are exchanged by selection, since the pivot depends on the
data.

Source:
    G. H. Golub and C. F. Van Loan, Matrix Computations, 4th edition, Johns Hopkins University
    Press 2013, algorithms 3.1.1 (forward substitution), 3.4.1 (LU with partial pivoting), 4.2.1
    (Cholesky).
"""

import functools

import numpy as np

from eoi_jax.compiler.graph import Factor, Graph, Node, Untranslatable

MOST_ROWS = 8  # the program grows with the third power
FACTORS = "lu"  # an input in place of factors that only a kept linear system would read


def lu(graph: Graph, params: dict, matrix: np.ndarray) -> list[np.ndarray]:
    """P A = L U with partial pivoting, as `lax.linalg.lu`.

    Args:
        graph: owner of all nodes.
        params: of the operation; none is read.
        matrix: A, shape (..., n, n).

    Returns:
        L (without its ones) and U in one matrix, shape (..., n, n); row that each row was exchanged
        with, (..., n); rows of A in their new order, (..., n).

    Raises:
        Untranslatable: more than `MOST_ROWS` rows, a matrix that is not square, or where
            factorisations are not written out and linear systems not kept.
    """
    del params
    size = _size(matrix)
    if not graph.writes_out and any(node.op != "constant" for node in matrix.flat):
        if graph.systems is None:
            raise Untranslatable("lu")
        shapes = matrix.shape, matrix.shape[:-1], matrix.shape[:-1]
        return [np.full(shape, graph.input(FACTORS), object) for shape in shapes]
    factors = matrix.copy()
    pivots, order = (np.empty(matrix.shape[:-1], object) for _ in range(2))
    for at in np.ndindex(matrix.shape[:-2]):
        a = factors[at]
        rows = [graph.constant(i) for i in range(size)]
        for k in range(size):
            pivot = _largest(graph, a[k:, k])
            pivots[at][k] = _chosen(graph, pivot, [graph.constant(i) for i in range(k, size)])
            pivot_row = [_chosen(graph, pivot, list(a[k:, j])) for j in range(size)]
            row = _chosen(graph, pivot, rows[k:])
            for i, flag in enumerate(pivot, k + 1):
                for j in range(size):
                    a[i, j] = graph.make("select", flag, a[k, j], a[i, j])
                rows[i] = graph.make("select", flag, rows[k], rows[i])
            a[k], rows[k] = pivot_row, row
            for i in range(k + 1, size):
                a[i, k] = graph.make("div", a[i, k], a[k, k])
                for j in range(k + 1, size):
                    a[i, j] = _less(graph, a[i, j], a[i, k], a[k, j])
        order[at][:] = rows
    return [factors, pivots, order]


def triangular_solve(graph: Graph, params: dict, matrix: np.ndarray, right: np.ndarray) -> list:
    """X of A X = B, or of X A = B, with a triangular A, as `lax.linalg.triangular_solve`.

    Args:
        graph: owner of all nodes.
        params: of the operation.
        matrix: A, shape (..., n, n); the other triangle is not read.
        right: B, shape (..., n, m), or (..., m, n).

    Returns:
        X in a list, of the shape of B.

    Raises:
        Untranslatable: more than `MOST_ROWS` rows.
    """
    size = _size(matrix)
    lower = params["lower"] != params["transpose_a"]
    matrix = np.swapaxes(matrix, -1, -2) if params["transpose_a"] else matrix
    if not params["left_side"]:
        matrix, right, lower = (*(np.swapaxes(x, -1, -2) for x in (matrix, right)), not lower)
    if matrix.ndim == 2 and (kept := _kept_solution(graph, matrix, right, lower)) is not None:
        return [kept if params["left_side"] else kept.T]
    solution = right.copy()
    turns = range(size) if lower else range(size - 1, -1, -1)
    for at in np.ndindex(solution.shape[:-2]):
        a, x = matrix[at], solution[at]
        for column in range(x.shape[1]):
            for i in turns:
                for j in range(i) if lower else range(i + 1, size):
                    x[i, column] = _less(graph, x[i, column], a[i, j], x[j, column])
                if not params["unit_diagonal"]:
                    x[i, column] = graph.make("div", x[i, column], a[i, i])
    return [solution if params["left_side"] else np.swapaxes(solution, -1, -2)]


def cholesky(graph: Graph, params: dict, matrix: np.ndarray) -> list[np.ndarray]:
    """L of A = L Lᵀ, from the lower triangle of A, as `lax.linalg.cholesky`.

    Args:
        graph: owner of all nodes.
        params: of the operation; none is read.
        matrix: A, shape (..., n, n).

    Returns:
        L in a list; not a number where A is not positive definite.

    Raises:
        Untranslatable: more than `MOST_ROWS` rows, or a matrix that is not square.
    """
    del params
    size = _size(matrix)
    factor = np.full(matrix.shape, graph.constant(0.0), object)
    is_constant = all(node.op == "constant" for node in matrix.flat)
    if graph.factors is not None and matrix.ndim == 2 and not is_constant:
        for i, j in zip(*np.tril_indices(size), strict=True):
            factor[i, j] = graph.input(("factor", len(graph.factors), i, j))
        graph.factors.append(Factor(factor, matrix, []))
        return [factor]
    for at in np.ndindex(matrix.shape[:-2]):
        a, lower = matrix[at], factor[at]
        for j in range(size):
            for i in range(j, size):
                remainder = a[i, j]
                for k in range(j):
                    remainder = _less(graph, remainder, lower[i, k], lower[j, k])
                if i == j:
                    lower[i, j] = graph.make("sqrt", remainder)
                else:
                    lower[i, j] = graph.make("div", remainder, lower[j, j])
    return [factor]


def _kept_solution(
    graph: Graph, matrix: np.ndarray, right: np.ndarray, lower: bool
) -> np.ndarray | None:
    """L y = b, or Lᵀ x = y, which is A x = b, of a factor that is kept; None for another matrix."""
    for k, factor in enumerate(graph.factors or []):
        places = np.tril_indices(len(factor.lower))
        if not np.array_equal((matrix if lower else matrix.T)[places], factor.lower[places]):
            continue
        solution = np.empty(right.shape, object)
        for column in range(right.shape[1]):
            side = list(right[:, column])
            if lower:
                names = (("half", k, len(factor.halves), i) for i in range(len(side)))
                solution[:, column] = half = [graph.input(name) for name in names]
                factor.halves.append((half, side))
            else:
                known = (b for half, b in factor.halves if half == side)
                if (b := next(known, None)) is None:
                    return None
                upper = np.where(np.tri(len(b), dtype=bool), factor.matrix, factor.matrix.T)
                solution[:, column] = graph.keep(upper, b).unknown
        return solution
    return None


def _size(matrix: np.ndarray) -> int:
    rows, columns = matrix.shape[-2:]
    if rows != columns or rows > MOST_ROWS:
        raise Untranslatable(f"linear algebra with a matrix of {rows} x {columns}")
    return rows


def _less(graph: Graph, value: Node, a: Node, b: Node) -> Node:
    """value - a b."""
    return graph.make("sub", value, graph.make("mul", a, b))


def _largest(graph: Graph, column: np.ndarray) -> list[Node]:
    """For each component after the first, whether it is the first one of the largest size."""
    sizes = [graph.make("abs", node) for node in column]
    flags = []
    for i in range(1, len(sizes)):
        before = [graph.make("lt", size, sizes[i]) for size in sizes[:i]]
        after = [graph.make("le", size, sizes[i]) for size in sizes[i + 1 :]]
        flags.append(functools.reduce(functools.partial(graph.make, "and"), [*before, *after]))
    return flags


def _chosen(graph: Graph, flags: list[Node], ways: list[Node]) -> Node:
    """The way whose flag is up; the first one where none is."""
    choice = ways[0]
    for flag, way in zip(flags, ways[1:], strict=True):
        choice = graph.make("select", flag, way, choice)
    return choice
