"""Noise in the log of a force that rests between the hits of a hammer."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.resting_inputs import at_rest

TIME = 1e-3 * np.arange(3000)
TRUTH = {"m": 3.0, "c": 8.0, "k": 3.0 * (2.0 * np.pi * 20.0) ** 2}
MASS = eoi.plant_from_text(
    {"y": "v", "v": "(1e6*F - c*v - k*y)/m"}, TRUTH, outputs=["y"], inputs=["F"], units={"F": "N"}
)
NOMINAL = MASS.with_parameters({"m": 2.6, "c": 10.0, "k": 4e4})
GATES = ["input_dead_zone", "input_asymmetry", "constant_offset"]


def record(seed, noise=0.3, zone=0.0, acts=False):
    """Hits of 6 ms; the scatter of the force acts on the mass, or is noise of the log."""
    draw = np.random.default_rng(seed)
    hits = [(draw.uniform(100.0, 200.0), start) for start in (0.05, 1.1, 2.0)]
    force = sum(a * np.sin(np.pi * np.clip((TIME - t) / 0.006, 0.0, 1.0)) ** 2 for a, t in hits)
    log = force + noise * draw.standard_normal(len(TIME))
    acting = log if acts else force
    acting = np.sign(acting) * np.maximum(np.abs(acting) - zone, 0.0)
    y = eoi.simulate(MASS, TIME, acting, hold="linear").outputs
    y = y + 0.5 * draw.standard_normal(y.shape)
    return eoi.Record(TIME, log, y, input_names="F", output_names="y", hold="linear")


def test_noise_at_rest_is_no_dead_zone():
    found = eoi.discover(NOMINAL, [record(0), record(1)], record(2), GATES)
    assert found.status.code == "nothing_missing"
    deviation = found.found.standard_errors["m"]
    assert abs(found.plant.parameters["m"] - TRUTH["m"]) < 3.0 * deviation < 0.05
    (note,) = (note for note in found.notes if "at rest they scatter, F by 0.3" in note)
    assert "which let less of the noise through" in note


def test_a_dead_zone_above_the_noise_is_found():
    records = [record(seed, zone=20.0) for seed in range(3)]
    found = eoi.discover(NOMINAL, records[:2], records[2], GATES)
    assert found.effects == ("input_dead_zone",)
    assert found.plant.parameters["input_dead_zone"] == pytest.approx(20.0, abs=1.0)


def test_scatter_that_acts_stays():
    records = [record(seed, acts=True) for seed in range(3)]
    found = eoi.discover(NOMINAL, records[:2], records[2], GATES)
    assert found.status.code == "nothing_missing"
    assert not any("at rest they scatter" in note for note in found.notes)


def test_rests_end_before_the_feet_of_a_hit():
    hit = np.abs(record(0, noise=0.0).inputs[:, 0]) > 1e-9
    one = record(0)
    (quiet,) = at_rest([one])
    changed = quiet.inputs[:, 0] != one.inputs[:, 0]
    assert np.mean(changed) > 0.9
    assert not np.any(changed & hit)
    assert abs(quiet.inputs[500, 0]) < 0.05


@pytest.mark.parametrize("kind", ["random", "smooth", "without noise"])
def test_an_input_that_does_not_rest_with_noise_stays(kind):
    u = {
        "random": np.random.default_rng(0).standard_normal(3000),
        "smooth": np.sin(7.0 * TIME) + np.sin(2.0 * TIME),
        "without noise": (TIME > 2.0) * 1.0,
    }[kind]
    one = eoi.Record(TIME, u, np.zeros(3000))
    assert at_rest([one]) == (one,)
