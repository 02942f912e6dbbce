r"""Forward-mode derivatives of scalar programs (A. Griewank, A. Walther, *Evaluating Derivatives*).

`jax.jvp` traces a function with its derivative, several times as many operations as the function
alone has. Of a scalar program each node is visited once, by the rules below, and where a tangent is
zero nothing is made. Roots have the derivative zero where it has no bound, as in `roots.py`.

    y, slopes = jvp(function, (x, theta), (x_tangent, theta_tangent))

inside a function that becomes a scalar program (`trace.py`) says where a derivative is wanted.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np

from eoi_jax.compiler.graph import Graph, Node, Untranslatable, is_value, topological_order
from eoi_jax.compiler.jax_private import Primitive, operations_of

# What the author of a function says of its derivative, and what JAX differentiates in fewer steps
# than its scalar program has.
_BY_JAX = {
    "custom_jvp_call",
    "custom_vjp_call",
    "custom_vjp_call_jaxpr",
    "stop_gradient",
    "custom_linear_solve",
    "lu",
    "cholesky",
    "triangular_solve",
    "clamp",
}

JVP = Primitive("scalar_program_jvp")
JVP.multiple_results = True


@JVP.def_abstract_eval
def _shapes(*operands: Any, jaxpr: Any) -> list[Any]:
    del operands
    return [variable.aval for variable in jaxpr.outvars] * 2


def jvp(function: Callable, primals: tuple, tangents: tuple) -> tuple[Any, Any]:
    """As `jax.jvp`, inside a function that becomes a scalar program; arguments as there."""
    leaves, structure = jax.tree.flatten(primals)
    result: list[Any] = []

    def flat(*leaves: Any) -> list[Any]:
        values, tree = jax.tree.flatten(function(*jax.tree.unflatten(structure, leaves)))
        result[:] = [tree]
        return values

    closed = jax.make_jaxpr(flat)(*leaves)
    if differentiated_by_jax(closed.jaxpr):
        return jax.jvp(function, primals, tangents)
    slopes = jax.tree.leaves(tangents)
    values = JVP.bind(*closed.consts, *leaves, *slopes, jaxpr=closed.jaxpr)
    count = len(values) // 2
    return tuple(jax.tree.unflatten(result[0], part) for part in (values[:count], values[count:]))


def differentiated_by_jax(jaxpr: Any) -> bool:
    """Whether a traced function has a part whose derivative is JAX's to take."""
    return bool(operations_of(jaxpr) & _BY_JAX)


def derivatives(
    graph: Graph,
    nodes: Sequence[Node],
    tangents: Sequence[tuple[Node, Node]],
    constant: Sequence[Node] = (),
) -> list[Node]:
    """Derivatives of nodes in one direction.

    Args:
        graph: owner of all nodes.
        nodes: what is differentiated.
        tangents: the inputs with which it changes, each with its derivative in that direction.
        constant: what else the nodes were made of; it must not depend on those inputs.

    Raises:
        Untranslatable: a tangent of what is no input, or two of one; constants that depend on one.
    """
    seeds = dict(moving := [pair for pair in tangents if not is_value(pair[1], 0.0)])
    unfit = len(seeds) < len(moving) or any(node.op != "input" for node in seeds)
    if unfit or seeds.keys() & set(topological_order(constant)):
        raise Untranslatable("a derivative with what is no input of the program")
    zero = graph.constant(0.0)
    slopes: dict[int, Node] = {node.order: tangent for node, tangent in seeds.items()}
    for node in topological_order(nodes):
        if node.order in slopes:
            continue
        parts = [slopes[arg.order] for arg in node.args]
        is_zero = node.is_bool or node.op in _STEPS or all(is_value(part, 0.0) for part in parts)
        slopes[node.order] = zero if is_zero else _RULES[node.op](_Terms(graph), node, *parts)
    return [slopes[node.order] for node in nodes]


# -- rules ------------------------------------------------------------------------------------

_STEPS = {"sign", "floor", "ceil", "round_even", "trunc", "constant", "input"}


class _Terms:
    """Arithmetic on nodes and numbers."""

    def __init__(self, graph: Graph):
        self._graph = graph

    def __getattr__(self, op: str) -> Callable[..., Node]:
        return functools.partial(self._make, op)

    def _make(self, op: str, *args: Node | float) -> Node:
        nodes = (arg if isinstance(arg, Node) else self._graph.constant(arg) for arg in args)
        return self._graph.make(op, *nodes)

    def product(self, factor: Callable[[], Node], part: Node) -> Node:
        """Zero, without its factor, where the tangent is zero."""
        return part if is_value(part, 0.0) else self.mul(factor(), part)


def _slope(factor: Callable[[_Terms, Node, Node], Node]) -> Callable[..., Node]:
    """Of a function of one argument, by its slope, from the argument and the value."""
    return lambda terms, node, part: terms.mul(factor(terms, node.args[0], node), part)


def _mul(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    a, b = node.args
    return terms.add(terms.mul(b, da), terms.mul(a, db))


def _div(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    return terms.div(terms.sub(da, terms.mul(node, db)), node.args[1])


def _rem(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    a, b = node.args
    return terms.sub(da, terms.product(lambda: terms.trunc(terms.div(a, b)), db))


def _larger(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    a, b = node.args
    above, below = (a, b) if node.op == "max" else (b, a)
    mean = terms.mul(0.5, terms.add(da, db))  # as JAX has it where both are equal
    return terms.select(terms.lt(below, above), da, terms.select(terms.lt(above, below), db, mean))


def _select(terms: _Terms, node: Node, flag: Node, da: Node, db: Node) -> Node:
    del flag
    return terms.select(node.args[0], da, db)


def _pow(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    a, b = node.args

    def by_base() -> Node:
        power = terms.mul(b, terms.pow(a, terms.sub(b, 1.0)))
        slope = terms.select(terms.eq(b, 0.0), 0.0, power)
        below_one = terms.select(terms.lt(b, 1.0), 0.0, slope)
        at_zero = terms.select(terms.lt(0.0, b), below_one, slope)
        return terms.select(terms.lt(0.0, a), slope, at_zero)

    def by_exponent() -> Node:
        positive = terms.lt(0.0, a)
        logarithm = terms.log(terms.select(positive, a, 1.0))
        return terms.select(positive, terms.mul(logarithm, node), 0.0)

    return terms.add(terms.product(by_base, da), terms.product(by_exponent, db))


def _atan2(terms: _Terms, node: Node, da: Node, db: Node) -> Node:
    a, b = node.args
    square = terms.add(terms.mul(a, a), terms.mul(b, b))
    return terms.sub(
        terms.product(lambda: terms.div(b, square), da),
        terms.product(lambda: terms.div(a, square), db),
    )


def _one_plus(terms: _Terms, x: Node) -> Node:
    return terms.add(1.0, terms.mul(x, x))


def _one_minus(terms: _Terms, x: Node) -> Node:
    return terms.sub(1.0, terms.mul(x, x))


_RULES: dict[str, Callable[..., Node]] = {
    "add": lambda terms, _, da, db: terms.add(da, db),
    "sub": lambda terms, _, da, db: terms.sub(da, db),
    "mul": _mul,
    "div": _div,
    "rem": _rem,
    "neg": lambda terms, _, da: terms.neg(da),
    "abs": lambda terms, node, da: terms.select(terms.lt(node.args[0], 0.0), terms.neg(da), da),
    "max": _larger,
    "min": _larger,
    "select": _select,
    "sqrt": _slope(lambda terms, x, y: terms.select(terms.lt(0.0, x), terms.div(0.5, y), 0.0)),
    "sin": _slope(lambda terms, x, _: terms.cos(x)),
    "cos": _slope(lambda terms, x, _: terms.neg(terms.sin(x))),
    "tan": _slope(lambda terms, _, y: _one_plus(terms, y)),
    "asin": _slope(lambda terms, x, _: terms.div(1.0, terms.sqrt(_one_minus(terms, x)))),
    "acos": _slope(lambda terms, x, _: terms.div(-1.0, terms.sqrt(_one_minus(terms, x)))),
    "atan": _slope(lambda terms, x, _: terms.div(1.0, _one_plus(terms, x))),
    "atan2": _atan2,
    "sinh": _slope(lambda terms, x, _: terms.cosh(x)),
    "cosh": _slope(lambda terms, x, _: terms.sinh(x)),
    "tanh": _slope(lambda terms, _, y: _one_minus(terms, y)),
    "asinh": _slope(lambda terms, x, _: terms.div(1.0, terms.sqrt(_one_plus(terms, x)))),
    "acosh": _slope(
        lambda terms, x, _: terms.div(
            1.0, terms.sqrt(terms.mul(terms.sub(x, 1.0), terms.add(x, 1.0)))
        )
    ),
    "atanh": _slope(lambda terms, x, _: terms.div(1.0, _one_minus(terms, x))),
    "exp": lambda terms, node, da: terms.mul(node, da),
    "exp2": _slope(lambda terms, _, y: terms.mul(float(np.log(2.0)), y)),
    "expm1": _slope(lambda terms, _, y: terms.add(1.0, y)),
    "log": _slope(lambda terms, x, _: terms.div(1.0, x)),
    "log1p": _slope(lambda terms, x, _: terms.div(1.0, terms.add(1.0, x))),
    "cbrt": _slope(
        lambda terms, x, y: terms.select(terms.eq(x, 0.0), 0.0, terms.div(y, terms.mul(3.0, x)))
    ),
    "pow": _pow,
}
