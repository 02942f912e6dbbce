"""One Runge-Kutta step against closed forms."""

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.simulation.runge_kutta import middle_of_step, runge_kutta_step


@pytest.mark.parametrize("h", [0.5, 0.25])
def test_linear_equation_gives_the_exponential_to_fourth_order(h):
    """x' = -x: the step multiplies x by the first five terms of exp(-h)."""
    end, _ = runge_kutta_step(lambda x, _: -x, jnp.asarray(2.0), jnp.asarray(h), (None, None, None))
    factor = 1.0 - h + h**2 / 2.0 - h**3 / 6.0 + h**4 / 24.0
    np.testing.assert_allclose(end, 2.0 * factor, rtol=1e-15)


def test_rate_of_the_signals_alone_is_integrated_by_simpsons_rule():
    """x' = u of a cubic u: exact, and so is the cubic's own slope at both ends."""
    h, x = jnp.asarray(2.0), {"a": jnp.asarray(1.0), "b": jnp.zeros(2)}
    signals = jnp.asarray(0.0), jnp.asarray(1.0), jnp.asarray(8.0)
    end, (first, last) = runge_kutta_step(
        lambda _, u: {"a": u, "b": u * jnp.ones(2)}, x, h, signals
    )
    np.testing.assert_allclose(end["a"], 5.0)
    np.testing.assert_allclose(end["b"], 4.0)
    assert (float(first["a"]), float(last["a"])) == (0.0, 8.0)


def test_middle_of_a_cubic_is_exact():
    """x = t³ over [0, 2]: 1 in the middle."""
    h, slopes = jnp.asarray(2.0), (jnp.asarray(0.0), jnp.asarray(12.0))
    middle = middle_of_step(jnp.asarray(0.0), jnp.asarray(8.0), slopes, h)
    np.testing.assert_allclose(middle, 1.0)
