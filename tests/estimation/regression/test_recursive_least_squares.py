"""Recursive least squares: the batch form after every sample, forgetting, and its derivatives."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.regression import least_squares

TRUE = np.array([1.5, -0.7, 20.0, 0.3])


def regressors(samples=300, seed=0):
    return np.random.default_rng(seed).standard_normal((samples, 2, 4))


def noisy(Phi, seed=1):
    return Phi @ TRUE + 0.1 * np.random.default_rng(seed).standard_normal(Phi.shape[:-1])


def batch(Phi, target, weights: Any = 1.0):
    """Normal equations of weighted samples, solved by the library."""
    w = np.broadcast_to(weights, target.shape)
    information = np.einsum("sj,sja,sjb->ab", w, Phi, Phi)
    return least_squares(information, np.einsum("sj,sja,sj->a", w, Phi, target), np.ones(4))


def test_its_end_is_the_batch_estimate_to_rounding():
    Phi = regressors()
    target = noisy(Phi)
    history, last = eoi.recursive(Phi, target)
    want = batch(Phi, target)
    np.testing.assert_allclose(last.increment, want.increment, rtol=1e-12)
    np.testing.assert_allclose(last.covariance, want.inverse, atol=1e-12 * np.max(want.inverse))
    np.testing.assert_array_equal(history[-1], last.increment)


def test_it_is_the_batch_estimate_after_every_sample():
    """From the second on: before, two outputs say less than four parameters need."""
    Phi = regressors(20)
    target = noisy(Phi)
    history, _ = eoi.recursive(Phi, target)
    for count in range(2, 21):
        want = batch(Phi[:count], target[:count]).increment
        np.testing.assert_allclose(history[count - 1], want, rtol=1e-9)


def test_the_gain_is_that_of_the_paper():
    """Eqs. (12) and (13), sampled: Δ̂ moves by Γ φᵀ times the innovation."""
    Phi = regressors(12)
    target = noisy(Phi)
    estimator = eoi.RecursiveLeastSquares(0.9)
    state = estimator.init(4)
    for phi, value in zip(jnp.asarray(Phi), jnp.asarray(target), strict=True):
        old = state
        state, innovation = estimator.step(state, phi, value)
        np.testing.assert_allclose(innovation, value - phi @ old.increment, rtol=1e-12)
        if np.all(np.linalg.eigvalsh(old.information) > 1e-3):
            prior = old.covariance / 0.9
            inner = np.linalg.inv(np.eye(2) + phi @ prior @ phi.T)
            covariance = prior - prior @ phi.T @ inner @ phi @ prior
            np.testing.assert_allclose(state.covariance, covariance, rtol=1e-7, atol=1e-12)
            moved = old.increment + covariance @ phi.T @ innovation
            np.testing.assert_allclose(state.increment, moved, rtol=1e-7)


def test_compensated_sums_do_not_stop_growing_in_single_precision():
    """Where a sum is 2^24 times what is added, adding changes nothing."""
    with jax.enable_x64(False):
        phi, ones = jnp.ones((1, 1)), jnp.ones(1)
        ends = []
        for compensated in (False, True):
            estimator = eoi.RecursiveLeastSquares(compensated=compensated)
            state, _ = estimator.step(estimator.init(1), 4096.0 * phi, 0.0 * ones)

            def body(k, state, estimator=estimator):
                return estimator.step(state, phi, ones)[0]

            ends.append(jax.lax.fori_loop(0, 100_000, body, state).increment)
    want = 100_000 / (4096.0**2 + 100_000)
    assert abs(ends[0][0] / want - 1.0) > 1e-3
    np.testing.assert_allclose(ends[1], want, rtol=1e-6)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_the_unit_of_a_parameter_does_not_change_its_estimate(unit):
    Phi = regressors()
    target = noisy(Phi)
    factor = np.array([1.0, 1.0, unit, 1.0])
    plain, scaled = eoi.recursive(Phi, target)[0], eoi.recursive(Phi / factor, target)[0]
    np.testing.assert_allclose(scaled[1:] / factor, plain[1:], rtol=1e-8)


def test_weights_are_those_of_weighted_least_squares_and_zeros_do_not_count():
    Phi = regressors()
    target, weights = noisy(Phi), np.random.default_rng(2).uniform(0.1, 3.0, (300, 2))
    weights[100:150] = 0.0
    history, last = eoi.recursive(Phi, target, weights)
    np.testing.assert_allclose(last.increment, batch(Phi, target, weights).increment, rtol=1e-11)
    np.testing.assert_allclose(history[149], history[99], rtol=1e-12)


def test_what_does_not_count_is_not_forgotten_by():
    Phi = regressors()
    target, counts = noisy(Phi), np.ones(300)
    counts[200:] = 0.0
    _, last = eoi.recursive(Phi, target, counts, forgetting=0.9)
    _, want = eoi.recursive(Phi[:200], target[:200], forgetting=0.9)
    np.testing.assert_allclose(last.increment, want.increment, rtol=1e-12)
    np.testing.assert_allclose(last.covariance, want.covariance, rtol=1e-12)


def test_forgetting_weighs_samples_by_their_age_and_follows_a_drift():
    Phi = regressors(600)
    drifting = TRUE * (1.0 + 0.3 * (np.arange(600) > 300))[:, None]
    target = np.einsum("sja,sa->sj", Phi, drifting)
    _, last = eoi.recursive(Phi, target, forgetting=0.95)
    ages = 0.95 ** np.arange(599, -1, -1)[:, None]
    np.testing.assert_allclose(last.increment, batch(Phi, target, ages).increment, rtol=1e-11)
    np.testing.assert_allclose(last.increment, 1.3 * TRUE, rtol=1e-6)
    assert np.max(np.abs(eoi.recursive(Phi, target)[1].increment / TRUE - 1.3)) > 0.05


def test_a_parameter_without_trace_keeps_its_value_and_has_a_large_covariance():
    Phi = regressors()
    Phi[..., 1] = 0.0
    _, last = eoi.recursive(Phi, Phi @ TRUE)
    np.testing.assert_allclose(last.increment, TRUE * [1, 0, 1, 1], rtol=1e-10)
    assert last.covariance[1, 1] > 1e6 * last.covariance[0, 0]


def test_two_regressors_that_are_the_same_share_the_estimate():
    Phi = regressors()
    Phi[..., 1] = Phi[..., 0]
    history, last = eoi.recursive(Phi, Phi @ TRUE)
    assert np.all(np.isfinite(history))
    np.testing.assert_allclose(last.increment[:2], np.full(2, 0.4), rtol=1e-4)


# -- inside JAX code ----------------------------------------------------------------------


def test_a_scan_of_the_user_is_the_whole_record():
    Phi = regressors()
    target = noisy(Phi)
    estimator = eoi.RecursiveLeastSquares(0.99)

    @jax.jit
    def run(Phi, target):
        def body(state, sample):
            state, innovation = estimator.step(state, *sample)
            return state, (state.increment, innovation)

        return jax.lax.scan(body, estimator.init(4), (Phi, target))

    last, (history, innovations) = run(jnp.asarray(Phi), jnp.asarray(target))
    want, end = eoi.recursive(Phi, target, forgetting=0.99)
    np.testing.assert_allclose(history, want, rtol=1e-9)
    np.testing.assert_allclose(last.rhs, end.rhs, rtol=1e-12)
    assert np.std(innovations[200:]) < 0.2


def test_vmap_over_factors_equals_single_runs():
    Phi = regressors(50)
    target, factors = noisy(Phi), jnp.asarray([0.8, 0.95, 1.0])
    batched = jax.jit(jax.vmap(lambda one: eoi.recursive(Phi, target, forgetting=one)[0]))(factors)
    for history, factor in zip(batched, factors.tolist(), strict=True):
        np.testing.assert_allclose(
            history, eoi.recursive(Phi, target, forgetting=factor)[0], rtol=1e-8
        )


def test_gradients_equal_differences():
    """From the first sample on, where the information has no inverse."""
    Phi = regressors(30)
    target = noisy(Phi)

    def cost(forgetting, size):
        moved = target + size * np.sin(np.arange(60.0)).reshape(30, 2)
        return jnp.mean(eoi.recursive(Phi, moved, forgetting=forgetting)[0][2:] ** 2)

    def difference(function, at, step=1e-6):
        return (function(at + step) - function(at - step)) / (2 * step)

    got = jax.jit(jax.grad(cost, (0, 1)))(0.9, 0.3)
    want = difference(lambda one: cost(one, 0.3), 0.9), difference(lambda one: cost(0.9, one), 0.3)
    np.testing.assert_allclose(got, want, rtol=1e-6)
    np.testing.assert_allclose(jax.jvp(cost, (0.9, 0.3), (1.0, 0.0))[1], got[0], rtol=1e-9)


# -- wrong calls --------------------------------------------------------------------------


@pytest.mark.parametrize("wrong", [0.0, 1.1, np.nan])
def test_a_wrong_factor_is_named(wrong):
    with pytest.raises(ValueError, match=r"`forgetting` must lie in \(0, 1\], got"):
        eoi.RecursiveLeastSquares(wrong)


def test_a_wrong_shape_is_named():
    Phi = regressors(5)
    for arguments, message in (
        ((Phi[:, 0], noisy(Phi)), r"`regressors` must have shape \(any, any, any\): samples"),
        ((Phi, noisy(Phi)[:, :1]), r"`injection` must have shape \(5, 2\)"),
        ((Phi, noisy(Phi), np.ones(4)), r"`weights` must have shape \(5, 2\)"),
    ):
        with pytest.raises(ValueError, match=message):
            eoi.recursive(*arguments)
