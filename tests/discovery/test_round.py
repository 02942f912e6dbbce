"""One round of discovery: at which frequencies a sinusoid is tried, how dry friction is read."""

import os
from types import SimpleNamespace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import regression, task
from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.cosine_modes import ModalRecord, modal_record
from eoi_jax.discovery.noise_spectrum import expected_power
from eoi_jax.discovery.regression import Fit
from eoi_jax.discovery.round import read_friction
from eoi_jax.discovery.round_start import in_step
from eoi_jax.models.augmented import place

TIME = np.arange(0.0, 40.0, 0.01)


def free(t, x, u, p):
    """ÿ = b u."""
    return p.gain * u


def moved(position: np.ndarray) -> list[ModalRecord]:
    plant = eoi.Plant(free, {"gain": 1.0}, 2, inputs=("force",), outputs=("position",))
    return [modal_record(plant, eoi.Record(TIME, 0.0 * TIME, position), 20.0)]


def strokes(period: float) -> np.ndarray:
    """To and fro, alike in both directions: odd harmonics only."""
    phase = 2.0 * np.pi * TIME / period
    return np.sin(phase) - np.sin(3.0 * phase) / 9.0 + np.sin(5.0 * phase) / 25.0


def test_a_repeated_motion_has_all_its_harmonics_in_step():
    motion, base = moved(strokes(5.0)), 2.0 * np.pi / 5.0
    # The even ones are not in the motion, but in any friction that differs between directions.
    assert all(in_step(motion, harmonic * base) for harmonic in (1, 2, 3, 4))


def test_other_frequencies_are_not_in_step_with_a_repeated_motion():
    motion, base = moved(strokes(5.0)), 2.0 * np.pi / 5.0
    assert not any(in_step(motion, share * base) for share in (0.61, 1.37, 2.42, 3.71))


def test_nothing_is_in_step_with_a_motion_that_never_repeats():
    noise = np.random.default_rng(3).standard_normal(len(TIME))
    motion = moved(np.convolve(noise, np.hanning(80), "same"))
    assert not any(in_step(motion, omega) for omega in (0.0, 0.7, 2.0, 5.0, 9.0))


def test_friction_beside_an_input_is_read_as_a_level_and_an_offset_there():
    """Two nearly equal levels of one force are a level and an offset of the same force."""
    plant = eoi.Plant(lambda t, x, u, p: p.gain * u[0] * np.array([1.0, -0.5]), {"gain": 1.0}, 2,
                      inputs=("force",), outputs=("cart", "load"))  # fmt: skip
    one = place(plant, effects.AsymmetricFriction(), 0, None, 0)
    fit = Fit(
        (CandidateColumns(one, (), np.zeros((1, 2))),), np.array([1.2, 1.0]), np.zeros(1), 0.0, True
    )
    added = read_friction(plant, fit)
    assert {placed.names[0]: values[0] for placed, values in added.items()} == {
        "coulomb_friction_cart_force": pytest.approx(1.1),
        "constant_offset_cart_force": pytest.approx(-0.1),
    }
    assert all(placed.through == 0 for placed in added)


def test_an_output_at_rest_has_some_power_all_the_same():
    """Errors are divided by it."""
    rest = np.zeros(5)
    assert np.all(expected_power(rest, rest, np.zeros(5, int)) > 0.0)


@pytest.mark.parametrize(("waiting", "threads"), [(True, 0), (False, os.cpu_count())])
def test_models_that_xla_waits_for_are_evaluated_by_one_thread(monkeypatch, waiting, threads):
    monkeypatch.setattr(task, "waits", lambda plant: waiting)
    assert task.Task.threads.func(SimpleNamespace(plant=None)) == threads


def test_settling_evaluates_no_point_twice(monkeypatch):
    """Its errors and its slopes come from one evaluation of the model."""
    speed = np.sin(TIME) - 0.5 * np.cos(0.3 * TIME)
    plant = eoi.Plant(
        lambda t, x, u, p: p.gain * u - p.loss * x.y[0] + x.z[0], {"gain": 2.0, "loss": 1.0},
        inputs=("force",), outputs=("speed",),
        internal=lambda t, x, u, p: -p.loss * x.z[0] + u, internal_initial=[0.0],
    )  # fmt: skip
    stretches = [modal_record(plant, eoi.Record(TIME, np.cos(TIME), speed), 20.0)]
    points, rows = [], regression.model_rows

    def counted(model, stretches):
        points.append(tuple(np.asarray(model.theta).tolist()))
        return rows(model, stretches)

    monkeypatch.setattr(regression, "model_rows", counted)
    power = np.ones(rows(plant, stretches)[0].shape[1])
    regression.settled(plant, stretches, power, np.array([1.0, 0.5]))
    assert len(points) > 4
    assert len(points) == len(set(points))
