"""Free runs that carry on the error of their start."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi

NOISE, PERIOD, SAMPLES = 1e-3, 0.001, 6000


def _record(damping, seed, extra=0.0):
    """A pendulum that swings out; fifty samples are a fortieth of a period."""
    time = PERIOD * np.arange(SAMPLES)
    solution = solve_ivp(
        lambda t, x: [x[1], -9.0 * np.sin(x[0]) - damping * x[1] - extra * x[1] ** 3],
        (0.0, time[-1]), [2.6, 0.0], t_eval=time, rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    y = solution.y[0] + NOISE * np.random.default_rng(seed).standard_normal(SAMPLES)
    return eoi.Record(time, np.zeros((SAMPLES, 0)), y, input_names=())


def _plant(damping):
    return eoi.Plant(
        lambda t, x, u, p: -p.k * jnp.sin(x.y[0]) - p.d * x.y[1],
        parameters={"k": 9.0, "d": damping},
        relative_degree=2,
        inputs=(),
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_true_model_reaches_the_noise_in_a_run_that_carries_on_its_start(seed):
    record = _record(0.02, seed)
    answer = eoi.validate(_plant(0.02), record)
    assert answer.rmse[0] < 1.2 * NOISE
    assert SAMPLES - answer.scored > 50
    usual = eoi.validate(_plant(0.02), record, initial_samples=50)
    assert usual.scored == SAMPLES - 50
    assert usual.rmse[0] > 1.3 * answer.rmse[0]


def test_a_run_that_forgets_its_start_keeps_the_usual_one():
    time = PERIOD * np.arange(SAMPLES)
    y = np.exp(-5.0 * time) + NOISE * np.random.default_rng(0).standard_normal(SAMPLES)
    plant = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 5.0}, 1, ())
    record = eoi.Record(time, np.zeros((SAMPLES, 0)), y, input_names=())
    assert eoi.validate(plant, record).scored == SAMPLES - 50


def test_a_model_that_lacks_something_gets_no_longer_start():
    answer = eoi.validate(_plant(0.02), _record(0.02, 0, extra=5.0), window=np.inf)
    assert answer.scored == SAMPLES - 50


def test_windows_keep_the_usual_start():
    answer = eoi.validate(_plant(0.02), _record(0.02, 0), window=2.0)
    usual = eoi.validate(_plant(0.02), _record(0.02, 0), window=2.0, initial_samples=50)
    assert answer.scored == usual.scored
