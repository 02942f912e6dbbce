"""What a model lacks whose internal states start anywhere, and starts that do not hold."""

import numpy as np
import pytest
from free_start_cases import NOISE, cell, run
from output_cases import BATTERY

import eoi_jax as eoi
from eoi_jax.discovery.cosine_modes import modal_record, model_rows
from eoi_jax.discovery.free_start_modes import with_free_starts
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import Relaxation

ANYWHERE = {"soc": None, "v1": None}


def test_nothing_is_missing_but_the_start():
    found = eoi.discover(cell(ANYWHERE), [run(1, 0.9), run(2, 0.6)], validation=run(3, 0.5))
    assert found.status.code == "nothing_missing"
    assert found.after is not None
    assert found.after.rmse[0] < 1.1 * NOISE


def test_a_drift_is_told_from_the_start():
    lacking = 2e-5
    runs = [run(1, 0.9, lacking), run(2, 0.6, lacking)]
    found = eoi.discover(cell(ANYWHERE), runs, validation=run(3, 0.5, lacking))
    assert found.effects == ("drift",)
    assert found.plant.parameters["drift"] == pytest.approx(lacking, rel=0.1)


@pytest.mark.slow
def test_a_stated_start_that_does_not_hold_is_said_with_what_fits():
    stated = {"soc": 0.8, "v1": 0.0}
    found = eoi.discover(cell(stated), [run(1, 0.9), run(2, 0.6)], validation=run(3, 0.5))
    assert found.status.code == "unexplained"
    (note,) = [note for note in found.notes if "known start" in note]
    assert "from 0.9 soc 0.9" in note
    assert "from 0.6 soc 0." in note
    assert "declare it free" in note


def test_a_stated_start_that_dies_out_is_said_where_free_ones_leave_noise():
    """Within 30 of 600 s: of the error of the whole record free starts take less than half."""

    def polarised(seed, volts):
        record = run(seed, 0.8, samples=600)
        rest = volts * np.exp(-record.time / (BATTERY["R1"] * BATTERY["C1"]))
        return record.with_outputs(record.outputs - rest[:, None], record.name)

    runs = [polarised(1, 0.006), polarised(2, 0.008)]
    found = eoi.discover(cell({"soc": 0.8, "v1": 0.0}), runs, validation=polarised(3, 0.01))
    assert found.status.code == "unexplained"
    (note,) = [note for note in found.notes if "known start" in note]
    assert "v1 0.00" in note


def test_effects_with_states_of_their_own_stand_behind_free_starts():
    """Of gain zero a relaxation changes no mode, though the model has one state more."""
    plant, record = cell({"soc": None, "v1": 0.0}), run(1, 0.9)
    prepared = with_free_starts(plant, modal_record(plant, record, 0.5), record)
    placed = place(plant, Relaxation(), 0)
    wider = augmented(plant, [placed], dict(zip(placed.names, (0.0, 60.0), strict=True)))
    modes, expected = (model_rows(model, [prepared])[0] for model in (wider, plant))
    np.testing.assert_allclose(modes, expected, rtol=1e-9, atol=1e-12)
