"""The noise that free runs bound: records sampled slowly, and fast, beside the motion."""

import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.simulation.sensor_noise import is_exact, sensor_noise
from eoi_jax.simulation.validate import judged_runs

NOISE = 0.02


def simulated(rates, push, period, seed, count=2000, noise=NOISE):
    """First state of a linear plant at inputs held over one to six samples, exact; with noise."""
    random, size = np.random.default_rng(seed), len(rates)
    inputs = np.repeat(random.standard_normal(count), random.integers(1, 7, count))[:count]
    step = expm(period * np.block([[rates, push[:, None]], [np.zeros((1, size + 1))]]))
    x, y = np.zeros(size), np.zeros(count)
    for i in range(count):
        y[i] = x[0]
        x = step[:size, :size] @ x + step[:size, size] * inputs[i]
    y += noise * random.standard_normal(count)
    return eoi.Record.from_period(period, inputs, y, hold="zero")


def first_order(seed, period):
    """Time constant 1 s."""
    plant = eoi.Plant(lambda t, x, u, p: p.b * u - p.a * x.y[0], {"a": 1.0, "b": 1.0}, 1)
    return plant, simulated(np.array([[-1.0]]), np.array([1.0]), period, seed)


def second_order(seed, period):
    """A spring of 1 rad/s, lightly damped."""
    plant = eoi.Plant(
        lambda t, x, u, p: u - p.k * x.y[0] - p.c * x.y[1], {"k": 1.0, "c": 0.3}, 2
    )  # fmt: skip
    rates = np.array([[0.0, 1.0], [-1.0, -0.3]])
    return plant, simulated(rates, np.array([0.0, 1.0]), period, seed)


SLOW = [(first_order, 0.3), (second_order, 2.0)]


@pytest.mark.parametrize(("made", "period"), SLOW)
@pytest.mark.parametrize("seed", range(3))
def test_of_records_sampled_slowly_free_runs_show_the_noise(made, period, seed):
    """A sample in a third of the time constant, or in two radians: differences show motion."""
    plant, record = made(seed, period)
    assert record.noise[0] > 2.0 * NOISE
    for window in (None, 100.0 * period):
        noise = sensor_noise(judged_runs(plant, record, window=window))
        assert noise[0] == pytest.approx(NOISE, rel=0.1)


@pytest.mark.parametrize(("made", "period"), SLOW)
def test_a_model_that_is_off_bounds_the_noise_from_above(made, period):
    """Its errors are smaller than the motion, or slower: differences of them show less of it."""
    plant, record = made(1, period)
    name = plant.names[0]
    off = plant.with_parameters({name: 1.1 * plant.parameters[name]})
    runs = judged_runs(off, record)
    noise = sensor_noise(runs)[0]
    assert runs.rmse[0] > 2.0 * NOISE
    assert 0.95 * NOISE < noise < 0.7 * record.noise[0]
    assert sensor_noise(runs, None, judged_runs(plant, record))[0] < noise


@pytest.mark.parametrize("made", [first_order, second_order])
@pytest.mark.parametrize("gain", [1.0, 1.3])
def test_of_records_sampled_fast_nothing_changes(made, gain):
    plant, record = made(2, period=0.002)
    runs = judged_runs(plant.with_parameters({plant.names[0]: gain}), record)
    assert sensor_noise(runs)[0] == pytest.approx(record.noise[0], rel=1e-12)


def test_the_bound_is_not_below_rounding_and_not_above_what_differences_show():
    plant, record = first_order(3, period=0.3)
    rounded = record.with_outputs(np.round(record.outputs, 1), "rounded")
    step = 0.1 / np.sqrt(12.0)
    assert sensor_noise(judged_runs(plant, rounded))[0] >= step * (1.0 - 1e-9)
    still = plant.with_parameters({"b": 0.0})
    assert sensor_noise(judged_runs(still, record))[0] <= record.noise[0]


def test_what_a_simulation_errs_by_is_no_motion():
    """30 000 samples without noise: the true model leaves what steps and rounding add up to."""
    rates, push = np.array([[0.0, 1.0], [-40.0, -1.0]]), np.array([0.0, 1.0])
    plant = eoi.Plant(lambda t, x, u, p: p.b * u - 40.0 * x.y[0] - x.y[1], {"b": 1.0}, 2)
    record = simulated(rates, push, period=1e-3, seed=4, count=30_000, noise=0.0)
    runs = judged_runs(plant, record)
    assert 0.0 < runs.rmse[0] < sensor_noise(runs)[0] < 1.01e-7 * np.std(record.outputs)
    assert is_exact(runs)
    assert is_exact(judged_runs(plant.with_parameters({"b": 1.0 + 1e-8}), record))
    assert not is_exact(judged_runs(plant.with_parameters({"b": 1.0 + 1e-6}), record))


def test_of_few_errors_no_order_of_differences_is_small_by_chance():
    """Of a dozen errors some order would show less than a third of the noise every few records."""
    plant, _ = first_order(0, 0.3)
    rates, push = np.array([[-1.0]]), np.array([1.0])
    records = [simulated(rates, push, 0.3, seed, count=16) for seed in range(40)]
    noises = [sensor_noise(judged_runs(plant, record, 4))[0] for record in records]
    assert min(noises) > NOISE / 3.0
    assert np.median(noises) == pytest.approx(NOISE, rel=0.25)
