"""Jaxprs evaluated number by number: every kind of operation against JAX itself."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.engines.components import Components, constant, evaluate

X = np.linspace(-1.5, 1.7, 6).reshape(2, 3)
Y = np.array([[0.3, -2.0, 0.0], [1.0, 4.0, -0.7]])


def eagerly(primitive, numbers, params):
    """Arithmetic on single numbers that are not known while tracing, as far as `evaluate` sees."""
    return primitive.bind(*(jnp.asarray(number) for number in numbers), **params)


def unknown(value) -> Components:
    array = jnp.asarray(value)
    return Components(array.shape, tuple(array.ravel()))


def numbers_of(function, *operands) -> list[Components]:
    jaxpr = jax.make_jaxpr(function)(*operands)
    return evaluate(jaxpr, [unknown(one) for one in operands], eagerly)


def newton(x):
    return jax.lax.fori_loop(0, 3, lambda k, r: 0.5 * (r + x / r) + 0.0 * k, 1.0 + x)


def counted(x):
    """A loop that stays a while loop, whose end is known all the same."""
    return jax.lax.while_loop(lambda c: c[0] < 3, lambda c: (c[0] + 1, c[1] * x), (0, x))[1]


def running(x):
    return jax.lax.scan(lambda c, row: (c + row, c * row), jnp.zeros(3), x, reverse=True)


def branched(x):
    cases = [lambda x: x + 1.0, lambda x: x * 3.0, lambda x: -x]
    return jax.lax.switch(jnp.where(x[0, 0] > 0, 2, 1) - 1, cases, x)


FUNCTIONS: dict[str, Any] = {
    "arithmetic": lambda x, y: jnp.where(x > y, x * y - 2.0 * x, jnp.sin(y) / (2.0 + x)),
    "powers and roots": lambda x, y: x**3 + jnp.sqrt(jnp.abs(y)) + jnp.abs(y) ** 0.3,
    "clip and sign": lambda x, y: jnp.clip(x, -1.0, y + 3.0) * jnp.sign(y),
    "products": lambda x, y: (x @ y.T, jnp.outer(x[0], y[1]), jnp.einsum("ij,kj->ikj", x, y)),
    "sums": lambda x, y: (x.sum(), y.sum(0), (x * y).max(1), jnp.prod(x, axis=0)),
    "slices": lambda x, y: (x[:, 1:], y[::-1], x[..., None], jnp.concatenate([x, y], 1).T),
    "stacks": lambda x, y: (jnp.stack([x, y]), jnp.pad(x, ((1, 0), (0, 2))), *x.T),
    "indices": lambda x, y: (x[jnp.array([1, 0, 1])], x.at[1].set(y[0]), x.at[0, 2].set(5.0)),
    "loops": lambda x, y: (newton(jnp.abs(x)), counted(y), running(x)),
    "branches": lambda x, y: (branched(x), branched(y), branched(-x)),
    "derivatives": lambda x, y: jax.jacfwd(lambda p: jnp.tanh(p @ x) * y[0])(y[:, 0]),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numbers_equal_arrays(name: str):
    function = FUNCTIONS[name]
    got = numbers_of(function, X, Y)
    want = jax.tree.leaves(function(jnp.asarray(X), jnp.asarray(Y)))
    for one, array in zip(got, want, strict=True):
        assert one.shape == array.shape
        found = np.asarray([float(item) for item in one.items]).reshape(one.shape)
        np.testing.assert_allclose(found, array, rtol=1e-14, atol=1e-15)


def test_zeros_and_ones_leave_no_arithmetic():
    """The Jacobian of a product with a constant matrix is that matrix: nothing to compute."""
    matrix = np.array([[2.0, 0.0], [0.0, -1.0]])
    jaxpr = jax.make_jaxpr(jax.jacfwd(lambda p: matrix @ p))(np.ones(2))
    (jacobian,) = evaluate(jaxpr, [unknown(np.ones(2))], eagerly)
    assert jacobian.known
    np.testing.assert_array_equal(jacobian.array(), matrix)


def test_what_is_known_is_computed_while_tracing():
    def never(primitive, numbers, params):
        raise AssertionError(primitive)

    jaxpr = jax.make_jaxpr(FUNCTIONS["arithmetic"])(X, Y)
    (value,) = evaluate(jaxpr, [constant(X), constant(Y)], never)
    np.testing.assert_allclose(value.array(), FUNCTIONS["arithmetic"](X, Y), rtol=1e-15)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda x: jnp.sort(x), "no rule for the operation `sort`"),
        (lambda x: x[jnp.argmax(x[:, 0])], "no rule for the operation `argmax`"),
        (lambda x: x[(x[0, 0] > 0).astype(int)], "at an index that is not known"),
        (
            lambda x: jax.lax.while_loop(lambda c: c[0, 0] < 3.0, lambda c: c + 1.0, x),
            "a loop whose end depends on the data",
        ),
    ],
)
def test_what_has_no_rule_is_named(function, message: str):
    with pytest.raises(NotImplementedError, match=message):
        numbers_of(function, X)
