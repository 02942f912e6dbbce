"""Least squares from normal equations: known answers, scaling, and what data do not say."""

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.estimation.regression import (
    index,
    least_squares,
    untraced,
)

NAMES = ("a", "b", "c", "d")
TRUE = np.array([1.5, -0.7, 20.0, 0.3])


def regressors(samples=300, seed=0):
    return np.random.default_rng(seed).standard_normal((samples, 2, 4))


def solve(Phi, target, free=None):
    """Normal equations of stacked regressors, solved by the library."""
    free = np.ones(Phi.shape[-1]) if free is None else np.asarray(free)
    rows, values = Phi.reshape(-1, Phi.shape[-1]), target.reshape(-1)
    return least_squares(
        jnp.asarray(rows.T @ rows), jnp.asarray(rows.T @ values), jnp.asarray(free)
    )


def noisy(Phi, seed=1):
    return Phi @ TRUE + 0.1 * np.random.default_rng(seed).standard_normal(Phi.shape[:-1])


def test_normal_equations_equal_a_factorisation_of_the_regressors():
    Phi = regressors()
    target = noisy(Phi)
    want, *_ = np.linalg.lstsq(Phi.reshape(-1, 4), target.reshape(-1))
    np.testing.assert_allclose(solve(Phi, target).increment, want, rtol=1e-10)


def test_inverse_is_that_of_the_information_matrix():
    Phi = regressors()
    rows = Phi.reshape(-1, 4)
    got = solve(Phi, noisy(Phi))
    np.testing.assert_allclose(got.inverse, np.linalg.inv(rows.T @ rows), rtol=1e-9, atol=1e-15)
    assert untraced(got, NAMES, np.ones(4)) == []


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_a_parameter_does_not_change_its_estimate(unit):
    Phi = regressors()
    target = noisy(Phi)
    other = Phi * np.array([1.0, 1.0, 1.0 / unit, 1.0])  # c counted in units `unit` times smaller
    plain, scaled = solve(Phi, target), solve(other, target)
    factor = np.array([1.0, 1.0, unit, 1.0])
    np.testing.assert_allclose(scaled.increment / factor, plain.increment, rtol=1e-10)
    np.testing.assert_allclose(scaled.eigenvalues, plain.eigenvalues, rtol=1e-10)


def test_a_parameter_without_trace_is_named_and_keeps_its_value():
    Phi = regressors()
    Phi[..., 1] = 0.0
    got = solve(Phi, Phi @ TRUE)
    assert untraced(got, NAMES, np.ones(4)) == ["b"]
    np.testing.assert_allclose(got.increment, TRUE * [1, 0, 1, 1], rtol=1e-10, atol=1e-11)
    assert got.inverse[1, 1] < 1e-20


def test_a_combination_without_trace_is_named_and_the_rest_is_right():
    """φ_d = 2 φ_b: only b + 2 d shows, and (2, -1) in (b, d) leaves the data as they are."""
    Phi = regressors()
    Phi[..., 3] = 2.0 * Phi[..., 1]
    got = solve(Phi, Phi @ TRUE)
    (lost,) = untraced(got, NAMES, np.ones(4))
    weights = {term.split("·")[1]: float(term.split("·")[0]) for term in lost.split()}
    assert set(weights) == {"b", "d"}
    assert weights["b"] / weights["d"] == pytest.approx(-2.0)
    np.testing.assert_allclose(np.asarray(got.increment)[[0, 2]], TRUE[[0, 2]], rtol=1e-9)
    seen = got.increment[1] + 2.0 * got.increment[3]
    np.testing.assert_allclose(seen, TRUE[1] + 2.0 * TRUE[3], rtol=1e-9)
    assert np.sum(~np.asarray(got.identified)) == 1


def test_nothing_at_all_is_named_parameter_by_parameter():
    Phi = np.zeros((10, 2, 4))
    got = solve(Phi, np.ones((10, 2)))
    assert sorted(untraced(got, NAMES, np.ones(4))) == list(NAMES)
    np.testing.assert_array_equal(got.increment, 0.0)


def test_fixed_parameters_get_zero_and_are_not_called_lost():
    Phi = regressors()
    free = np.array([1.0, 0.0, 1.0, 0.0])
    target = Phi @ (TRUE * free)
    got = solve(Phi, target, free)
    np.testing.assert_allclose(got.increment, TRUE * free, rtol=1e-10, atol=1e-14)
    np.testing.assert_array_equal(np.asarray(got.increment)[free == 0], 0.0)
    np.testing.assert_array_equal(np.asarray(got.inverse)[free == 0], 0.0)
    assert untraced(got, NAMES, free) == []


def test_each_lost_combination_is_named_once_beside_fixed_parameters():
    """Fixed parameters and lost combinations share the null space: they must not mix."""
    Phi = regressors()
    Phi[..., 2] = 3.0 * Phi[..., 0]
    free = np.array([1.0, 0.0, 1.0, 0.0])
    got = solve(Phi, Phi @ TRUE, free)
    lost = untraced(got, NAMES, free)
    assert len(lost) == 1
    assert "a" in lost[0]
    assert "c" in lost[0]


def test_index_is_the_mean_square():
    np.testing.assert_allclose(index(jnp.array([8.0, 3.0]), jnp.array([4.0, 1.0])), [2.0, 3.0])


def test_index_without_samples_is_nan():
    got = index(jnp.array([0.0, 3.0]), jnp.array([0.0, 1.0]))
    assert np.isnan(got[0])
    assert got[1] == 3.0
