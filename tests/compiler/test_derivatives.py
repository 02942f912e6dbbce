"""Derivatives of scalar programs are those of `jax.jvp`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler import derivatives
from eoi_jax.compiler.graph import OPERATIONS, Graph, Untranslatable, evaluate
from eoi_jax.compiler.trace import translate

SHAPES = [jax.ShapeDtypeStruct((3,), float)] * 2
FUNCTIONS = {
    "sum": lambda x: x[0] + 2.0 * x[1] - x[2],
    "product": lambda x: x[0] * x[1] * x[2],
    "quotient": lambda x: x[0] / (x[1] * x[1] + 1.0),
    "remainder": lambda x: jnp.fmod(5.0 * x[0], x[1] + 3.0),
    "absolute": lambda x: jnp.abs(x[0]) + jnp.abs(-x[1]),
    "larger": lambda x: jnp.maximum(x[0], x[1]) + jnp.minimum(x[1], 0.5),
    "choice": lambda x: jnp.where(x[0] > x[1], x[0] ** 2, x[1] * x[2]),
    "root": lambda x: jnp.sqrt(1.0 + x[0] ** 2) + jnp.cbrt(x[1] + 3.0),
    "trigonometric": lambda x: jnp.sin(x[0]) * jnp.cos(x[1]) + jnp.tan(0.3 * x[2]),
    "inverse": lambda x: jnp.arcsin(x[0] / 4) + jnp.arccos(x[1] / 4) + jnp.arctan(x[2]),
    "angle": lambda x: jnp.arctan2(x[0], x[1]),
    "hyperbolic": lambda x: jnp.sinh(x[0]) + jnp.cosh(x[1]) + jnp.tanh(x[2]),
    "inverse hyperbolic": lambda x: (
        jnp.arcsinh(x[0]) + jnp.arccosh(4.0 + x[1]) + jnp.arctanh(x[2] / 4)
    ),
    "exponential": lambda x: jnp.exp(x[0]) + jnp.exp2(x[1]) + jnp.expm1(x[2]),
    "logarithm": lambda x: jnp.log(x[0] + 4.0) + jnp.log1p(x[1] / 4) + jnp.log2(x[2] + 4.0),
    "power": lambda x: (x[0] + 4.0) ** x[1] + (x[2] + 4.0) ** 1.7 + x[0] ** 3 + x[1] ** -2,
    "steps": lambda x: jnp.sign(x[0]) * x[1] + jnp.floor(3 * x[1]) + jnp.ceil(x[2]) * x[0],
    "matrix": lambda x: jnp.sum(jnp.outer(x, x) @ x),
    "branch": lambda x: jax.lax.cond(x[0] > 0, lambda: x[1] ** 2, lambda: x[2]),
    "solved": lambda x: jnp.linalg.solve(jnp.diag(x**2 + 1.0) + 0.1, x)[0],
    "told by its author": lambda x: jax.nn.relu(x[0]) * x[1],
    "held": lambda x: jax.lax.stop_gradient(x[0]) * x[1],
    "clamped": lambda x: jax.lax.clamp(0.0, x[0], 1.0) + x[1],
}


def both(function, by=derivatives.jvp):
    """Value and derivative of a function, as a scalar program evaluated by NumPy."""
    graph = Graph()
    inputs = [
        np.array([graph.input((group, i)) for i in range(3)], dtype=object) for group in range(2)
    ]

    def flat(x, moved):
        return [jnp.asarray(part) for part in by(function, (x,), (moved,))]

    arrays = translate(graph, flat, SHAPES, inputs)
    nodes = [array.item() for array in arrays]
    return lambda x, moved: evaluate(nodes, lambda at: (x, moved)[at[0]][at[1]], float)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_they_equal_those_of_jax(name):
    function, rng = FUNCTIONS[name], np.random.default_rng(3)
    program = both(function)
    for x in [*rng.normal(size=(20, 3)), np.array([1.0, 1.0, -2.0]), np.array([0.0, 0.5, 0.0])]:
        moved = rng.normal(size=3)
        expected = jax.jvp(function, (x,), (moved,))
        np.testing.assert_allclose(program(x, moved), expected, rtol=1e-12, atol=1e-14)


def test_what_does_not_change_costs_nothing():
    """The tangent of a constant is no node: a program with three zeros is that of the value."""
    graph = Graph()
    x = np.array([graph.input(i) for i in range(3)], dtype=object)

    def flat(x):
        return list(derivatives.jvp(lambda x: jnp.sin(x[0]) * x[1], (x,), (jnp.zeros(3),)))

    _, slope = translate(graph, flat, SHAPES[:1], [x])
    assert slope.item() is graph.constant(0.0)


def test_a_function_in_a_function_sees_what_surrounds_it():
    """Constants of the inner one may be values of the outer one."""

    def outer(x, moved):
        k = x[2] ** 2
        return derivatives.jvp(lambda v: k * jnp.sin(v), (x[0],), (moved[0],))

    graph = Graph()
    inputs = [
        np.array([graph.input((group, i)) for i in range(3)], dtype=object) for group in range(2)
    ]
    arrays = translate(graph, lambda *args: list(outer(*args)), SHAPES, inputs)
    x, moved = np.array([0.3, 1.0, 2.0]), np.array([0.5, 1.0, 1.0])
    values = evaluate(
        [array.item() for array in arrays], lambda at: (x, moved)[at[0]][at[1]], float
    )
    np.testing.assert_allclose(values, [4 * np.sin(0.3), 4 * np.cos(0.3) * 0.5])


@pytest.mark.parametrize("wrong", ["no input", "twice", "depends"])
def test_a_derivative_that_cannot_be_found_so_is_refused(wrong):
    """Where it would be wrong it is none: the caller takes another way."""

    def flat(x, moved):
        point = {"no input": x[0] * x[1], "twice": x[0], "depends": x[0]}[wrong]
        factor = 2.0 * x[0] if wrong == "depends" else x[1]
        other = x[0] if wrong == "twice" else x[2]
        return list(
            derivatives.jvp(lambda v, w: factor * v * w, (point, other), (moved[0], moved[1]))
        )

    graph = Graph()
    inputs = [
        np.array([graph.input((group, i)) for i in range(3)], dtype=object) for group in range(2)
    ]
    with pytest.raises(Untranslatable, match="derivative with what is no input"):
        translate(graph, flat, SHAPES, inputs)


def test_every_operation_has_a_rule():
    """An operation that is added without one would be found by a user."""
    numbers = {
        name
        for name, operation in OPERATIONS.items()
        if not operation.is_bool and name not in derivatives._STEPS
    }
    assert numbers == derivatives._RULES.keys()
