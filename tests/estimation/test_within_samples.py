"""Outputs between the samples of plants of first order whose input is held."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax.estimation.within_samples import resampled

RATE, GAIN, STEPS = 0.2, 0.6, 10  # per sample period of one second


def stairs(samples: int, each: int, seed: int = 3) -> np.ndarray:
    """An input that changes every few samples."""
    levels = np.random.default_rng(seed).uniform(0.0, 2.0, samples // each + 1)
    return np.repeat(levels, each)[:samples]


def course(u: np.ndarray, steps: int, delay: int = 0) -> np.ndarray:
    """The exact solution of y' = GAIN u - RATE y on a grid of so many steps a sample.

    The input, held over each sample, acts `delay` steps later.
    """
    held = np.repeat(u, steps)
    late = np.concatenate([np.full(delay, u[0]), held])[: len(held)]
    decay, y = np.exp(-RATE / steps), np.empty(len(held))
    y[0] = 0.5
    for k in range(len(held) - 1):
        rest = GAIN * late[k] / RATE
        y[k + 1] = rest + (y[k] - rest) * decay
    return y[: (len(u) - 1) * steps + 1]


def lag(t, x, u, p):
    return p.gain * u - p.rate * x.y[0]


def plant(**values: float) -> eoi.Plant:
    return eoi.Plant(lag, {"gain": GAIN, "rate": RATE, **values}, 1)


def record(u: np.ndarray, y: np.ndarray, hold: str = "zero") -> eoi.Record:
    return eoi.Record(np.arange(len(u), dtype=float), u, y, hold=hold)


@pytest.mark.parametrize("each", [1, 7])
def test_outputs_between_samples_are_those_of_the_plant(each):
    u = stairs(200, each)
    exact = course(u, STEPS)
    sampled = record(u, exact[::STEPS])
    errors = {
        "plant": resampled(plant(), sampled, STEPS).outputs[:, 0] - exact,
        "spline": sampled.resample(STEPS).outputs[:, 0] - exact,
    }
    inner = slice(10 * STEPS, -10 * STEPS)
    size = {name: np.max(np.abs(error[inner])) for name, error in errors.items()}
    assert size["plant"] < 1e-4
    assert size["plant"] < 0.01 * size["spline"]


def test_samples_stay_as_measured():
    u = stairs(100, 4)
    noisy = course(u, 1) + 0.1 * np.random.default_rng(0).standard_normal(100)
    fine = resampled(plant(), record(u, noisy), STEPS)
    assert fine.outputs[::STEPS, 0] == pytest.approx(noisy, abs=1e-12)
    assert fine.noise == record(u, noisy).resample(STEPS).noise


def test_a_delay_of_a_part_of_a_sample_bends_within_it():
    u = stairs(200, 5)
    exact = course(u, STEPS, delay=4)
    delayed = eoi.Plant(
        lag, {"gain": GAIN, "rate": RATE, "late": 0.4}, 1,
        actuator=lambda t, u, p: jnp.interp(t - p.late, t, u[:, 0])[:, None],
    )  # fmt: skip
    fine = resampled(delayed, record(u, exact[::STEPS]), STEPS)
    error = np.abs(fine.outputs[:, 0] - exact)[10 * STEPS : -10 * STEPS]
    assert np.max(error) < 0.01  # the interpolated input takes a step to jump
    spline = record(u, exact[::STEPS]).resample(STEPS)
    assert np.max(error) < 0.25 * np.max(np.abs(spline.outputs[:, 0] - exact)[10 * STEPS :])


def test_what_does_not_kink_keeps_its_spline():
    u = stairs(60, 3)
    y = course(u, 1)
    chain = eoi.Plant(
        lambda t, x, u, p: jnp.stack([p.a * u[0] - x.y[0, 0], x.y[0, 0] - p.b * x.y[0, 1]]),
        {"a": 1.0, "b": 0.3}, 1, outputs=("driven", "behind"),
    )  # fmt: skip
    both = eoi.Record(np.arange(60.0), u, np.stack([y, np.cumsum(y) / 60], 1), hold="zero")
    fine, spline = resampled(chain, both, 5), both.resample(5)
    assert np.array_equal(fine.outputs[:, 1], spline.outputs[:, 1])
    assert not np.allclose(fine.outputs[:, 0], spline.outputs[:, 0])
    smooth = record(u, y, "linear")
    assert np.array_equal(resampled(plant(), smooth, 5).outputs, smooth.resample(5).outputs)


@pytest.mark.parametrize("each", [1, 3, 40])
def test_estimates_of_a_held_input_are_unbiased(each):
    # With splines: 3.3, 2.0 and -0.2 %.
    u = stairs(1500, each)
    start = plant(gain=0.8 * GAIN, rate=1.5 * RATE)
    found = eoi.identify(start, record(u, course(u, 1)))
    assert found.parameters["gain"] == pytest.approx(GAIN, rel=1e-4)
    assert found.parameters["rate"] == pytest.approx(RATE, rel=1e-4)
    assert found.nominal is start


def test_a_mode_beyond_the_samples_does_not_blow_up():
    u = stairs(100, 4)
    fine = resampled(plant(rate=50.0), record(u, course(u, 1)), STEPS)
    spread = np.ptp(course(u, 1))
    assert np.ptp(fine.outputs) < 2.0 * spread


def test_a_current_beside_a_position_follows_its_voltage():
    # i' = -0.3 i - 0.5 φ' + u,  φ'' = 0.4 i - 0.1 φ', exactly by the matrix exponential.
    a = np.array([[-0.3, 0.0, -0.5], [0.0, 0.0, 1.0], [0.4, 0.0, -0.1]])
    step = expm(np.block([[a, np.eye(3)[:, :1]], [np.zeros((1, 4))]]) / STEPS)
    u = stairs(150, 5)
    x = np.zeros((149 * STEPS + 1, 3))
    for k in range(len(x) - 1):
        x[k + 1] = (step @ np.append(x[k], u[k // STEPS]))[:3]

    def motor(t, x, u, p):
        (current, _), (_, speed) = x.y
        return jnp.stack([u[0] - p.r * current - p.k * speed, 0.4 * current - 0.1 * speed])

    plant = eoi.Plant(motor, {"r": 0.3, "k": 0.5}, (1, 2), outputs=("current", "angle"))
    sampled = eoi.Record(np.arange(150.0), u, x[::STEPS, :2], hold="zero")
    fine, spline = resampled(plant, sampled, STEPS), sampled.resample(STEPS)
    inner = slice(10 * STEPS, -10 * STEPS)
    error = np.abs(fine.outputs[inner, 0] - x[inner, 0])
    assert np.max(error) < 0.02 * np.max(np.abs(spline.outputs[inner, 0] - x[inner, 0]))
    assert np.array_equal(fine.outputs[:, 1], spline.outputs[:, 1])
