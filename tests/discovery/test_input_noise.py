"""Noise in the log of an input that is held at levels, and scatter that acted."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.confirm import beyond_noise, explained_by_inputs
from eoi_jax.discovery.input_noise import error_of_input_noise
from eoi_jax.simulation.validate import judged_runs

TIME, SCATTER = 0.01 * np.arange(1200), 0.15
MASS = eoi.Plant(
    lambda t, x, u, p: (u - p.b * x.y[1]) / p.J, {"J": 0.35, "b": 0.4}, 2, ("torque",), ("phi",)
)
HELD, RANDOM, SMOOTH = "levels", "random", "smooth"


def course(kind, draw):
    if kind == HELD:
        return np.repeat(draw.uniform(-5.0, 5.0, 15), 80)
    if kind == RANDOM:
        return draw.uniform(-5.0, 5.0, 1200)
    return np.sum([np.sin(f * TIME + f) for f in (0.7, 2.1, 5.3)], axis=0)


def record(seed, kind=HELD, acts=False):
    """A log of a torque with scatter, which acts on the mass or does not."""
    draw = np.random.default_rng(seed)
    torque = course(kind, draw)
    log = torque + SCATTER * draw.standard_normal(1200)
    made = eoi.simulate(MASS, TIME, log if acts else torque, hold="zero")
    phi = made.outputs + 2e-4 * draw.standard_normal((1200, 1))
    return eoi.Record(TIME, log, phi, input_names="torque", output_names="phi", hold="zero")


@pytest.mark.parametrize("seed", range(3))
def test_noise_of_a_log_is_what_free_runs_of_the_right_model_miss_by(seed):
    run = judged_runs(MASS, record(seed), window=1.2)
    assert len(beyond_noise(run)) == 1
    assert beyond_noise(run, plant=MASS) == []
    assert 0.5 < run.rmse[0] / error_of_input_noise(MASS, run)[0] < 1.5
    (told,) = explained_by_inputs(run, MASS)
    assert told.startswith("free runs in windows of phi miss by ")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("kind", "acts"), [(HELD, True), (RANDOM, False), (SMOOTH, False)])
def test_an_excitation_is_no_noise(seed, kind, acts):
    """Of a wrong model, too, whose runs miss by more than the noise of the sensor."""
    for plant in (MASS, MASS.with_parameters({"J": 0.36})):
        run = judged_runs(plant, record(seed, kind, acts), window=1.2)
        assert error_of_input_noise(plant, run)[0] == 0.0


def test_what_is_missing_beside_a_noisy_log_is_more_than_that():
    wrong = MASS.with_parameters({"J": 0.45})
    assert len(beyond_noise(judged_runs(wrong, record(0), window=1.2), plant=wrong)) == 1


def test_a_complete_model_lacks_nothing_beside_a_noisy_log():
    found = eoi.discover(MASS, record(0), record(1), ["cubic_stiffness", "position_ripple"])
    assert found.status.code == "nothing_missing"
    assert any("noise in the log of the inputs" in note for note in found.notes)
