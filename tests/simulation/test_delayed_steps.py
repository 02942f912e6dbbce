"""Held inputs behind a delay that is no whole number of steps of the simulation."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import InputDelay
from eoi_jax.models.library import Plant
from eoi_jax.simulation.simulate import simulate

PERIOD, LAG = 0.05, 0.4
TIME = PERIOD * np.arange(120)
LEVELS = np.repeat(np.random.default_rng(3).uniform(0.0, 1.0, 40), 3)


def response(drive: np.ndarray, delay: float) -> np.ndarray:
    """LAG y' = u(t - delay) - y from steady state, as a sum of step responses."""
    late = TIME[:, None] - TIME[1:] - delay
    risen = 1.0 - np.exp(-np.maximum(late, 0.0) / LAG)
    return drive[0] + risen @ np.diff(drive)


def simulated(delay: float, power: int) -> np.ndarray:
    plant = Plant(lambda t, x, u, p: (u**power - x.y[0]) / p.lag, {"lag": LAG})
    late = augmented(plant, [place(plant, InputDelay(), 0)], {"input_delay": delay})
    start = {"y": (LEVELS[0] ** power,)}
    return simulate(late, TIME, LEVELS, start, hold="zero", substeps=4).outputs[:, 0]


@pytest.mark.parametrize("delay", [0.1, 0.085, 0.0875, 0.0923, 0.003])
def test_a_linear_plant_behind_a_delay_is_exact(delay):
    np.testing.assert_allclose(simulated(delay, 1), response(LEVELS, delay), atol=1e-7)


@pytest.mark.parametrize("delay", [0.1, 0.0875])
def test_whole_steps_of_delay_keep_a_nonlinear_drive_exact(delay):
    np.testing.assert_allclose(simulated(delay, 2), response(LEVELS**2, delay), atol=1e-7)


def test_a_nonlinear_drive_errs_by_what_a_step_that_changes_spreads():
    # The square of a parabola in place of a step: w - w² (5 - 8 w) of its square, w = φ (1 - φ).
    delay, share = 0.09, 0.2
    error = np.max(np.abs(simulated(delay, 2) - response(LEVELS**2, delay)))
    weight = share * (1.0 - share)
    step = np.max(np.diff(LEVELS) ** 2) * PERIOD / 4.0 / LAG
    assert error < 2.0 * (weight - weight**2 * (5.0 - 8.0 * weight)) * step


def test_refinement_tells_a_delay_of_whole_samples_beside_a_quadratic_drive():
    plant = Plant(lambda t, x, u, p: (p.gain * u**2 - x.y[0]) / p.lag, {"gain": 0.9, "lag": 0.5})
    late = augmented(plant, [place(plant, InputDelay(), 0)], {"input_delay": 0.11})
    y = response(LEVELS**2, 0.1) + np.random.default_rng(4).normal(0.0, 1e-4, len(TIME))
    fit = eoi.refine(late, eoi.Record(TIME, LEVELS, y, hold="zero"), substeps=4)
    assert abs(fit.parameters["input_delay"] - 0.1) < 4.0 * fit.standard_errors["input_delay"]
    assert fit.rmse[0] < 1.1e-4
