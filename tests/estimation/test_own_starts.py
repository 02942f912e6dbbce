"""Passes of plants whose internal states start anywhere."""

import numpy as np
import pytest
from free_start_cases import BATTERY, cell, run

import eoi_jax as eoi
from eoi_jax.estimation.free_starts import OwnStarts, first_starts


def test_the_estimate_is_that_of_known_starts():
    """From parameters that are a third off, with which no head of a record tells its start."""
    runs = [run(1, 0.9), run(2, 0.6)]
    fit = eoi.identify(cell({"soc": "free", "v1": "free"}), runs)
    for name, value in BATTERY.items():
        assert fit.parameters[name] == pytest.approx(value, rel=0.02)
    (note,) = [note for note in fit.notes if "free starts" in note]
    assert "from 0.9 soc 0.9" in note or "from 0.9 soc 0.89" in note
    assert eoi.refine(fit, runs).status.ok


def test_starts_are_parameters_of_their_record():
    plant = cell({"soc": "free(0.5)", "v1": 0.0}, **BATTERY)
    runs = [run(1, 0.9, samples=240), run(2, 0.6, samples=240)]
    begun = OwnStarts.begun(plant, runs)
    assert begun.plant.names[4:] == ("soc_start_1", "soc_start_2")
    np.testing.assert_allclose(begun.plant.theta[4:], [0.9, 0.6], atol=2e-3)
    maps = begun.of_parameters
    np.testing.assert_array_equal(maps[1] @ [1.0, *begun.plant.theta], [begun.plant.theta[5], 0.0])
    constant = begun.constant(np.asarray(begun.plant.theta))
    first = first_starts(plant, runs)
    assert first is not None
    np.testing.assert_allclose(constant, first, atol=1e-12)
    assert first_starts(cell({"soc": 0.5, "v1": 0.0}), runs) is None


def test_a_store_behind_a_noisy_output_starts_anywhere():
    """Two stores of heat, of which the first is measured; with instrumental variables."""
    time = 0.02 * np.arange(1500)
    flow = eoi.excitation.square(time, 1.0, 0.2)
    equations = {"hot": "a*(core - hot) + flow", "core": "b*(hot - core) - core"}
    plant = eoi.plant_from_text(equations, {"a": 2.0, "b": 1.0}, ["hot"], ["flow"],
                                initial={"core": "free"})  # fmt: skip
    true, runs = plant.with_parameters({"a": 3.0, "b": 0.5}), []
    for seed, core in enumerate((4.0, -2.0)):
        run = eoi.simulate(true, time, flow, {"hot": 1.0}, internal=[core], hold="zero")
        noise = 5e-3 * np.random.default_rng(seed).standard_normal(run.outputs.shape)
        runs.append(run.with_outputs(run.outputs + noise, f"run{seed}"))
    fit = eoi.identify(plant, runs, instruments=True)
    assert fit.parameters["a"] == pytest.approx(3.0, rel=0.03)
    assert fit.parameters["b"] == pytest.approx(0.5, rel=0.05)
    refined = eoi.refine(fit, runs)
    np.testing.assert_allclose([start.z[0] for start in refined.starts], [4.0, -2.0], atol=0.02)
