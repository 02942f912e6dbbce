"""Comparisons in a function, read off and decided."""

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.comparisons import comparisons, with_signs


def function(x, u):
    @jax.jit
    def inner(x):
        return jnp.where(x[0] > 1.0, x[0] * u, 0.0)

    branch = jax.lax.cond(x[1] > 0.0, lambda: 1.0, lambda: 2.0)  # left as it is
    return inner(x) + jnp.sum(jnp.where(u < 5.0, 1.0, x) * jnp.sign(x)) + branch * (x[1] <= 3.0)


X, U = jnp.array([1.5, -2.0]), jnp.asarray(7.0)


def test_what_depends_on_the_state_is_read_in_order():
    differences, signs = comparisons(function, X, U)
    # x0 - 1, both of sign(x), and the one outside the branch with 3 - x1; not u < 5.
    assert {float(value) for value in differences} >= {0.5, 1.5, -2.0, 5.0}
    np.testing.assert_array_equal(signs, np.sign(differences))


def test_decided_comparisons_continue_a_function_beyond_its_jump():
    differences, signs = comparisons(function, X, U)
    every = tuple(range(len(signs)))
    assert float(with_signs(function, every, signs, X, U)) == float(function(X, U))
    first = list(map(float, differences)).index(0.5)
    low = with_signs(function, (first,), -jnp.ones(1), X, U)
    np.testing.assert_allclose(float(function(X, U) - low), 1.5 * 7.0)
    sign = list(map(float, differences)).index(-2.0)
    kept = with_signs(function, (sign,), jnp.zeros(1), X, U)
    assert float(kept) == float(function(X, U))  # zero decides no sign
