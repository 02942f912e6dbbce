"""Covariance from coloured scores: against what is known of AR(1), and of resonances."""

import numpy as np
import pytest
from scipy.signal import lfilter

from eoi_jax.regression.long_run import correlation_time, long_run
from eoi_jax.uncertainty import student

TRIALS = 600
SIGMA = np.sqrt(0.95 * 0.05 / TRIALS)


def ar1(a: float, count: int, rng: np.random.Generator) -> np.ndarray:
    white = rng.standard_normal(count + 400)
    return np.asarray(lfilter([1.0], [1.0, -a], white))[400:]


def resonant(count: int, rng: np.random.Generator, damping: float = 0.02) -> np.ndarray:
    """Noise through an oscillator of twenty samples a period."""
    pole = np.exp(-damping + 2j * np.pi / 20)
    coefficients = [1.0, -2.0 * pole.real, abs(pole) ** 2]
    return np.asarray(lfilter([1.0], coefficients, rng.standard_normal(count + 1000)))[1000:]


def covered(phi: np.ndarray, error: np.ndarray) -> tuple[bool, bool]:
    """Whether the interval of a least-squares slope holds the truth: by `long_run`, and naively."""
    inverse = 1.0 / np.sum(phi**2)
    slope = inverse * np.sum(phi * error)
    residual = error - slope * phi
    covariance, freedom = long_run((phi * residual)[:, None], np.asarray([[inverse]]))
    naive = np.sqrt(inverse * np.mean(residual**2))
    half = student(0.95, freedom) * np.sqrt(covariance[0, 0])
    return bool(abs(slope) < half), bool(abs(slope) < 1.96 * naive)


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_mean_of_ar1_noise_is_covered(a: float):
    rng = np.random.default_rng(0)
    share, naive = np.mean(
        [covered(np.ones(1000), ar1(a, 1000, rng)) for _ in range(TRIALS)], axis=0
    )
    assert abs(share - 0.95) < 3 * SIGMA
    if a == 0.9:  # nineteen times the variance that white noise would have
        assert naive < 0.5


def test_slope_is_covered_where_regressor_and_residual_share_a_resonance():
    """Half of the score's power lies at twice the frequency: the reason for `_PEAKS`."""
    rng = np.random.default_rng(0)
    shares = [covered(resonant(2000, rng), resonant(2000, rng)) for _ in range(TRIALS)]
    share, naive = np.mean(shares, axis=0)
    # 2000 samples are 40 decay times of 50: what bias the spectrum's bend leaves is below 2 %.
    assert 0.95 - 0.02 - 3 * SIGMA < share < 0.95 + 3 * SIGMA
    assert naive < 0.7


def test_correlation_time_is_that_of_closed_form():
    rng = np.random.default_rng(0)
    for a in (0.0, 0.5, 0.9):
        # Σ a^(2|l|) = (1 + a²)/(1 - a²)
        time = np.mean([correlation_time(ar1(a, 5000, rng)[:, None]) for _ in range(50)])
        assert time == pytest.approx((1 + a**2) / (1 - a**2), rel=0.05)


def test_the_most_correlated_column_counts_and_scale_does_not():
    rng = np.random.default_rng(0)
    slow, fast = ar1(0.95, 3000, rng), ar1(0.0, 3000, rng)
    both = np.stack([slow, 1e6 * fast, np.zeros(3000)], axis=1)
    assert correlation_time(both) == pytest.approx(correlation_time(slow[:, None]), rel=1e-9)


def test_white_scores_give_the_textbook_covariance():
    rng = np.random.default_rng(0)
    phi = rng.standard_normal((20_000, 2)) @ np.asarray([[1.0, 0.6], [0.0, 0.5]])
    inverse = np.linalg.inv(phi.T @ phi)
    covariance, freedom = long_run(phi * rng.standard_normal((20_000, 1)), inverse)
    # Over a hundred cosines: 1/√(2·100) of each error, three sigma.
    assert freedom > 100
    np.testing.assert_allclose(covariance, inverse, rtol=0.4)
    assert np.sqrt(np.diagonal(covariance)) == pytest.approx(np.sqrt(np.diagonal(inverse)), rel=0.2)


def test_scores_of_zero_leave_no_doubt_and_too_few_leave_much():
    covariance, freedom = long_run(np.zeros((100, 2)), np.eye(2))
    np.testing.assert_array_equal(covariance, 0.0)
    assert freedom == np.inf
    slow = np.cos(np.pi * np.arange(100) / 99.0)[:, None]  # half a period is all there is
    assert long_run(slow, np.eye(1))[1] == 2.0
