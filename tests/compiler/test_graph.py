"""Scalar programs: the same values as JAX's, fewer operations, and a name for what they cannot."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.compiler.graph import Graph, Untranslatable, evaluate, topological_order
from eoi_jax.compiler.programs import jit
from eoi_jax.compiler.trace import translate

DRAW = np.random.default_rng(3)
X = DRAW.uniform(0.2, 0.9, (3, 4))
Y = DRAW.uniform(-0.9, -0.2, (3, 4))


def program(function, *arrays):
    """Nodes of the results of a function of arrays, its graph, and what its inputs stand for."""
    graph, inputs, values = Graph(), [], []
    for array in arrays:
        nodes = np.empty(array.shape, object)
        for at in np.ndindex(array.shape):
            nodes[at] = graph.input(len(values))
            values.append(array[at])
        inputs.append(nodes)
    shapes = [jax.ShapeDtypeStruct(array.shape, array.dtype) for array in arrays]
    return graph, translate(graph, lambda *a: [function(*a)], shapes, inputs)[0], values


def operations(nodes):
    """How many of each kind a program computes."""
    names = [node.op for node in topological_order(np.ravel(nodes)) if node.args]
    return {name: names.count(name) for name in names}


@jax.custom_jvp
def cubed(x):
    return x * x * x


cubed.defjvp(lambda primal, tangent: (cubed(*primal), 3.0 * primal[0] ** 2 * tangent[0]))


def newton(x):
    return jax.lax.fori_loop(0, 6, lambda _, r: 0.5 * (r + x / r), jnp.ones_like(x))


def rows_summed(x):
    def turn(total, row):
        return total + row, total * row

    return jnp.concatenate([part.reshape(-1) for part in jax.lax.scan(turn, x[0], x[1:])])


FUNCTIONS = {
    "arithmetic": lambda x, y: (x + y) * (x - y) / (x + 2.0) - (-x) * 3.0,
    "powers": lambda x, y: x**3 + x**-2 + jnp.abs(y) ** x + x**0 + jnp.square(y),
    "signs": lambda x, y: jnp.sign(y) * x + jnp.abs(y) + jnp.sign(x * 0.0),
    "roots": lambda x, y: jnp.sqrt(x) + jax.lax.rsqrt(x) + jnp.cbrt(y),
    "waves": lambda x, y: jnp.sin(x) + jnp.cos(y) + jnp.tan(x) + jnp.arctan2(y, x) + jnp.sinc(x),
    "inverse waves": lambda x, y: jnp.arcsin(x) + jnp.arccos(y) + jnp.arctan(y),
    "hyperbolic": lambda x, y: jnp.tanh(y) + jnp.sinh(x) + jnp.cosh(y) + jnp.arctanh(x),
    "exponentials": lambda x, y: jnp.exp(y) + jnp.log(x) + jnp.expm1(x) + jnp.log1p(x) + 2.0**x,
    "rounding": lambda x, y: (
        jnp.floor(3 * y) + jnp.ceil(x) + jnp.round(5 * x) + jnp.trunc(4 * y) + (7 * x) % 2.0
    ),
    "choices": lambda x, y: jnp.where((x > 0.5) & ~(y > -0.4) | (x == y), x, y),
    "limits": lambda x, y: jnp.clip(y, -0.5, -0.3) + jnp.maximum(x, 0.5) + jnp.minimum(x, -y),
    "logistic": lambda x, y: jax.nn.sigmoid(x) + jax.nn.relu(y) + jnp.isfinite(x),
    "shapes": lambda x, y: jnp.concatenate([x.T, y.reshape(4, 3)], 1)[::2, None, 1:5][..., ::-1],
    "stacks": lambda x, y: jnp.stack([x, y], 1).swapaxes(0, 2) + jnp.ones((1, 2, 1)),
    "places": lambda x, y: x[jnp.array([2, 0])][:, jnp.array([1, 1, 3])] + y[1, 2],
    "written places": lambda x, y: x.at[1].set(y[0]).at[:, 2].add(y[:, 1]),
    "pads": lambda x, y: jnp.pad(x, ((0, 1), (2, 0))) + 1.0,
    "slices": lambda x, y: jax.lax.dynamic_slice(x, (1, 1), (2, 2)) + jnp.roll(y, 1)[:2, :2],
    "sums": lambda x, y: jnp.sum(x, 0) + jnp.max(y, 0) + jnp.min(x, 0) + jnp.prod(y, 0),
    "flags": lambda x, y: jnp.where(jnp.any(x > 0.8, 0) | jnp.all(y < -0.3, 0), 1.0, 0.0),
    "running sums": lambda x, y: jnp.cumsum(x, 1) + jnp.cumsum(y[::-1], 0),
    "products": lambda x, y: x @ y.T + jnp.einsum("ij,kj->ik", x, y) + jnp.outer(x[:, 0], y[:, 1]),
    "empty products": lambda x, y: x[:, :0] @ y[:, :0].T + x[:, :3],
    "spread": lambda x, y: jnp.tile(x, (1, 2)) + jnp.eye(3) @ jnp.repeat(y, 2, 1),
    "branches": lambda x, y: jax.lax.cond(x[0, 0] > 0.5, jnp.sin, jnp.cos, y),
    "many branches": lambda x, y: jax.lax.switch(1, [jnp.sin, jnp.cos, jnp.tan], y) + x,
    "written-out loop": lambda x, y: newton(x) + y,
    "written-out scan": lambda x, y: rows_summed(x) + rows_summed(y),
    "own derivative": lambda x, y: cubed(x) + jax.jvp(cubed, (x,), (y,))[1],
    "linear systems": lambda x, y: jnp.linalg.solve(x[:, :3], y) + jnp.linalg.inv(y[:, 1:]) @ x,
    "a system whose rows change places": lambda x, y: jnp.linalg.solve(
        jnp.fliplr(jnp.eye(3)) * x[0, 0], y
    ),
    "transposed system": lambda x, y: jax.scipy.linalg.solve_triangular(
        x[:, :3], y, trans=1, lower=True
    ),
    "systems from the right": lambda x, y: jax.lax.linalg.triangular_solve(x[:, :3], y.T),
    "positive definite": lambda x, y: jax.scipy.linalg.cho_solve(
        jax.scipy.linalg.cho_factor(x @ x.T + jnp.eye(3)), y
    ),
    "Cholesky": lambda x, y: jax.jacfwd(lambda a: jnp.linalg.cholesky(a @ a.T + jnp.eye(3)))(x),
    "derivative of a solution": lambda x, y: jax.jacfwd(
        lambda a: jnp.linalg.solve(a[:, :3], y[:, 0])
    )(x),
    "determinants": lambda x, y: (
        jnp.linalg.det(x[:, :3]) + jnp.linalg.det(jnp.outer(x[0], y[0]) + jnp.eye(4))
    ),
    "exponential": lambda x, y: jax.scipy.linalg.expm(x[:2, :2]),
    "looked up": lambda x, y: x[jnp.int32(4 * x[0, 0])] + y[:, jnp.int32(4 * x[:, 1])][0, 0],
    "looked up beyond": lambda x, y: jnp.take(x[0], jnp.int32(9 * x[1])) + y[0],
    "looked up beyond, with a value": lambda x, y: (
        x[0].at[jnp.int32(9 * x[1])].get(mode="fill", fill_value=2.5) + y[0]
    ),
    "whole numbers looked up beyond": lambda x, y: (
        1.0 * jnp.take(jnp.arange(3), jnp.int32(9 * x[1])) + y[0]
    ),
    "a curve": lambda x, y: jnp.interp(3.0 * x, jnp.array([0.5, 1.0, 2.5]), y[:, 0]),
    "jacobian": lambda x, y: jax.jacfwd(lambda a: jnp.sin(a[0]) * a[1] + y[0])(x),
}


@pytest.mark.parametrize("name", list(FUNCTIONS))
def test_values_are_those_of_jax(name):
    _, nodes, values = program(FUNCTIONS[name], X, Y)
    flat = evaluate(list(nodes.flat), lambda i: values[i], np.float64)
    got = np.array([float(one) for one in flat]).reshape(nodes.shape)
    # Both compute the same operations; a library's sine or power may differ in its last digits.
    np.testing.assert_allclose(got, jit(FUNCTIONS[name])(X, Y), rtol=1e-13, atol=1e-15)


def test_not_a_number_stays_one():
    _, nodes, _ = program(lambda x: jnp.sign(x) + jnp.maximum(x, 1.0), X)
    spoilt = evaluate(list(nodes.flat), lambda i: np.nan, np.float64)
    assert np.all(np.isnan(spoilt))


def test_tangents_of_other_parameters_vanish():
    """∂/∂θ of θ₀ sin x + θ₁ x³ is (sin x, x³): one sine and two products, nothing else."""

    def model(theta, x):
        return theta[0] * jnp.sin(x[0]) + theta[1] * x[0] ** 3

    _, nodes, _ = program(lambda theta, x: jax.jacfwd(model)(theta, x), np.ones(2), np.ones(1))
    assert operations(nodes) == {"sin": 1, "mul": 2}


def test_equal_terms_are_one_node():
    _, nodes, _ = program(lambda x: jnp.stack([x[0] * x[1], x[1] * x[0], -x[0] * -x[1]]), X[0])
    assert nodes[0] is nodes[1] is nodes[2]


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (lambda x: jax.lax.while_loop(lambda v: v[0, 0] < 1.0, lambda v: 2.0 * v, x), "while"),
        (lambda x: jnp.sort(x), "sort"),
        (lambda x: x[jnp.int32(x[0, 0]), jnp.int32(x[0, 1])], "along several axes"),
        (lambda x: jnp.arange(65.0)[jnp.int32(x[0, 0])], "over 64"),
        (lambda x: jnp.linalg.inv(jnp.eye(9) * x[0, 0]), "a matrix of 9 x 9"),
        (lambda x: jnp.linalg.eigvalsh(x[:, :3]), "eigh"),
        (lambda x: jax.lax.fori_loop(0, 1000, lambda _, v: 0.5 * v, x), "scan of 1000 turns"),
        (lambda x: x[0].at[jnp.array([1, 1])].add(1.0), "twice at one place"),
        (lambda x: (x + 1j).real, "complex"),
    ],
)
def test_what_cannot_be_translated_has_a_name(function, name):
    with pytest.raises(Untranslatable, match=name):
        program(function, X)
