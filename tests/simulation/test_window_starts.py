"""Windows of a model with a store that is not measured: where that store starts in each of them."""

import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.simulation.validate import judged_runs

GAIN, AMBIENT, TAU, EXCHANGE, RATE = 0.44, 20.0, 50.0, 0.01, 0.011
PERIOD, NOISE = 2.0, 0.2
PLATE = eoi.Plant(
    lambda t, x, u, p: p.k * u - (x.y[0] - p.ambient) / p.tau + p.a * x.z[0],
    {"k": GAIN, "ambient": AMBIENT, "tau": TAU, "a": EXCHANGE, "b": RATE},
    inputs=("voltage",), outputs=("temperature",),
    internal=lambda t, x, u, p: -p.b * x.z[0]
    - (p.k * u - (x.y[0] - p.ambient) / p.tau + p.a * x.z[0]),
    internal_initial=[0.0],
)  # fmt: skip


def heated(samples, seed):
    """Temperatures of plate and housing at held voltages, by the matrix exponential, with noise."""
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(3.0, 9.0, -(-samples // 40)), 40)[:samples]
    rates = [[-1.0 / TAU - EXCHANGE, EXCHANGE], [RATE, -RATE]]
    drive = [[AMBIENT / TAU, GAIN], [0.0, 0.0]]
    step = expm(PERIOD * np.block([[np.array(rates), np.array(drive)], [np.zeros((2, 4))]]))
    x, y = np.array([60.0, 60.0]), np.zeros(samples)
    for i in range(samples):
        y[i] = x[0]
        x = step[:2, :2] @ x + step[:2, 2:] @ [1.0, voltage[i]]
    y += NOISE * rng.standard_normal(samples)
    return eoi.Record.from_period(PERIOD, voltage, y, hold="zero")


@pytest.mark.parametrize("seed", range(3))
def test_short_windows_of_the_true_model_miss_by_little_more_than_the_noise(seed):
    """Five noisy samples tell the temperature of the plate to NOISE/√5, of the housing nothing."""
    runs = judged_runs(PLATE, heated(400, seed), initial_samples=6, window=20 * PERIOD)
    assert runs.rmse[0] < 1.2 * NOISE


def test_a_window_whose_first_samples_tell_the_state_of_the_store_starts_there():
    """A store that something unknown heats in the middle of the record: no run along it knows."""
    part = heated(200, 0)
    inputs, outputs = (np.concatenate([values] * 2) for values in (part.inputs, part.outputs))
    jumped = eoi.Record.from_period(PERIOD, inputs, outputs, hold="zero")
    runs = judged_runs(PLATE, jumped, initial_samples=60, window=100 * PERIOD)
    assert runs.rmse[0] < 1.5 * NOISE


def test_where_a_run_along_the_record_diverges_windows_start_as_the_model_says():
    unstable = eoi.Plant(
        lambda t, x, u, p: p.a * x.z[0] ** 3 + u, {"a": 1.0}, inputs=("u",), outputs=("y",),
        internal=lambda t, x, u, p: x.y[0] + x.z[0], internal_initial=[0.0],
    )  # fmt: skip
    swing = 0.1 * np.sin(0.02 * np.arange(2000))
    record = eoi.Record.from_period(0.01, np.ones(2000), swing, hold="zero")
    assert not np.isfinite(judged_runs(unstable, record).rmse[0])
    assert np.isfinite(judged_runs(unstable, record, window=0.6).rmse[0])
