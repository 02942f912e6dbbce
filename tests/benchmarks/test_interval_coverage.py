"""A slice of the benchmark: 95 % intervals hold the truth, with coloured residuals."""

import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks import independent
from benchmarks.statistics import interval_coverage

SEEDS, SAMPLES = 40, 1000
# Three binomial sigma below 95 %, for one parameter. Intervals of half the width would have 67 %.
LEAST = 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / SEEDS)


@pytest.fixture(scope="module")
def estimates():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eoi, "configure", lambda: None)  # JAX runs already
        return interval_coverage.outcomes("one mass", "noise and force", range(SEEDS), SAMPLES)


@pytest.mark.parametrize("method", ["identify", "refine"])
def test_intervals_hold_the_truth_and_are_no_wider_than_they_must_be(estimates, method: str):
    one = estimates[method]
    assert not np.any(np.isnan(one.error))
    assert np.all(np.mean(one.covered, axis=0) >= LEAST)
    spread = np.std(one.error, axis=0)
    ratio = np.sqrt(np.mean(one.deviation**2, axis=0)) / spread
    # The spread of 40 estimates is known to 1/√80, three sigma; and few sums make errors small.
    assert np.all((ratio > 0.6) & (ratio < 1.4))
    # Three sigma of a mean of 40.
    assert np.all(np.abs(np.mean(one.error, axis=0)) < 3.0 * spread / np.sqrt(SEEDS))


def test_the_plain_loop_agrees_with_an_event_driven_simulator():
    """The pendulum with dry friction: `independent.py` solves from event to event."""
    case = interval_coverage.cases()["pendulum"]
    time = np.arange(300) * case.period
    u = 0.3 * np.sign(np.sin(4.0 * time) + 1e-9)[None]
    truth = independent.pendulum(case.plant.parameters, time, u[0], "zero")
    mine = case.simulate(case.plant.parameters, time, u)[0]
    # A step of 0.5 ms in which friction turns: 0.3 rad/s² · (0.5 ms)/9 rad/s, a few times.
    np.testing.assert_allclose(mine, truth, atol=1e-4)
    assert np.ptp(truth) > 0.3


@pytest.mark.parametrize("a", [0.0, interval_coverage.AUTOREGRESSION])
def test_noise_is_coloured_and_of_unit_size(a: float):
    noise = interval_coverage.coloured(np.random.default_rng(0), (100_000, 1), a)[:, 0]
    assert np.std(noise) == pytest.approx(1.0, rel=0.05)
    assert np.mean(noise[1:] * noise[:-1]) == pytest.approx(a, abs=0.05)
