"""Roots have finite derivatives where they reach zero, and are those of JAX above."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from eoi_jax.compiler.graph import Graph, evaluate
from eoi_jax.compiler.pointwise import slopes_along
from eoi_jax.compiler.roots import with_safe_roots
from eoi_jax.compiler.trace import translate

ROOTS = {
    "cube root": lambda x, p: jnp.cbrt(x),
    "square root": lambda x, p: jnp.sqrt(x),
    "constant exponent": lambda x, p: jnp.power(x, 2 / 3),
    "exponent": lambda x, p: x**p,
    "reaches zero": lambda x, p: jnp.maximum(x, 0.0) ** 0.3,
    "in a branch": lambda x, p: lax.cond(x < 5.0, lambda: x**0.4, lambda: x),
    "in a loop": lambda x, p: lax.fori_loop(0, 2, lambda _, y: y * jnp.cbrt(x), x),
    "in a function": lambda x, p: jax.jit(jnp.cbrt)(x) * jax.nn.relu(p),
}


@pytest.mark.parametrize("name", ROOTS)
def test_derivatives_are_finite_at_and_below_zero(name):
    function = ROOTS[name]
    safe = with_safe_roots(function)
    points, exponent = jnp.asarray([-1.5, 0.0, 1e-3, 2.0]), jnp.asarray(0.7)
    np.testing.assert_array_equal(jax.vmap(safe, (0, None))(points, exponent),
                                  jax.vmap(function, (0, None))(points, exponent))  # fmt: skip
    for k in (0, 1):
        slopes = jax.vmap(jax.jacfwd(safe, k), (0, None))(points, exponent)
        by_rows = slopes_along(with_safe_roots(function), ("rows", "fixed"), k,
                               np.asarray(points), np.asarray(exponent))  # fmt: skip
        np.testing.assert_allclose(by_rows, slopes, rtol=1e-12)
        assert np.all(np.isfinite(slopes))
        expected = [jax.jacfwd(function, k)(x, exponent) for x in points[2:]]
        np.testing.assert_allclose(slopes[2:], expected, rtol=1e-12)


def test_whole_powers_and_poles_stay_as_they_are():
    safe = with_safe_roots(lambda x, p: x**p)
    for x, p in ((-2.0, 2.0), (-2.0, -1.0), (0.0, 1.0), (0.0, 2.0), (3.0, 0.0)):
        slope = jax.grad(safe)(x, p)
        assert slope == jax.grad(lambda x, p: x**p)(x, p)
    assert jax.grad(safe)(0.0, -0.5) == -np.inf


def test_all_orders_and_directions_of_differentiation():
    safe = with_safe_roots(lambda x: jnp.maximum(x, 0.0) ** (2 / 3))
    assert jax.grad(jax.grad(safe))(0.0) == 0.0
    assert jax.grad(jax.grad(safe))(8.0) == pytest.approx(-2 / 9 * 8.0 ** (-4 / 3))
    assert jax.jit(jax.hessian(safe))(8.0) == pytest.approx(-2 / 9 * 8.0 ** (-4 / 3))


def test_a_derivative_that_an_author_gave_is_kept():
    @jax.custom_jvp
    def clipped(x):
        return jnp.sqrt(x)

    clipped.defjvp(lambda at, change: (clipped(*at), 7.0 * change[0]))
    assert jax.grad(with_safe_roots(clipped))(0.0) == 7.0


def test_a_scalar_program_has_the_plain_operation():
    """So formulas and exported files show the power that was written."""
    graph = Graph()
    x = np.empty((), object)
    x[()] = graph.input("x")
    shape = jax.ShapeDtypeStruct((), float)
    (power,) = translate(graph, lambda x: [with_safe_roots(lambda x: x**0.3)(x)], [shape], [x])
    assert power.item().op == "pow"
    assert evaluate([power.item()], lambda _: 2.0, float) == [2.0**0.3]
