"""Starts of internal states that a plant leaves open: how they are declared, and who needs them."""

import jax.numpy as jnp
import numpy as np
import pytest
from free_start_cases import BATTERY, NOISE, cell, run

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import Relaxation
from eoi_jax.models.export.program import program

FREE = {"soc": "free(0.5)", "v1": 0.0}


@pytest.fixture(scope="module")
def runs():
    return [run(1, 0.9), run(2, 0.6)]


def test_each_record_starts_where_it_did(runs):
    """As `nlgreyest` with `findstates`: two runs from 90 % and 60 %."""
    fit = eoi.refine(cell(FREE), runs)
    assert fit.rmse[0] < 1.05 * NOISE
    assert fit.parameters["Q"] == pytest.approx(BATTERY["Q"], rel=0.01)
    np.testing.assert_allclose([start.z for start in fit.starts], [[0.9, 0], [0.6, 0]], atol=2e-3)
    (note,) = [note for note in fit.notes if "free starts" in note]
    assert note.startswith("free starts of the records: from 0.9 soc 0.")
    assert not any("known start" in note for note in fit.notes)
    validation = eoi.validate(fit, run(3, 0.3))
    assert validation.rmse[0] < 1.1 * NOISE
    assert eoi.validate(fit, run(3, 0.3), window=300.0).rmse[0] < 1.2 * NOISE


def test_a_stated_start_that_does_not_hold_names_the_way(runs):
    fit = eoi.refine(cell({"soc": 0.8, "v1": 0.0}), runs)
    (note,) = [note for note in fit.notes if "known start" in note]
    assert "from 0.9 soc 0.9" in note
    assert 'declare it free (`soc = "free"` in `initial`, or None in `internal_initial`)' in note
    assert "leave it out" not in note


def rate(t, x, u, p):
    return -p.k * x.z


def shown(t, x, u, p):
    return x.z[0] + x.z[1]


def decay(starts=(None, 0.5)):
    return eoi.Plant(shown, {"k": 1.0}, 0, (), ("y",), internal=rate, internal_initial=starts)


def test_a_number_that_is_left_out_is_free_in_python():
    plant = decay()
    np.testing.assert_array_equal(plant.free_internal, [True, False])
    np.testing.assert_array_equal(plant.initial_internal, [0.0, 0.5])
    time = np.arange(200) * 0.02
    falling = eoi.Record(time, np.zeros((200, 0)), 2.5 * np.exp(-1.3 * time), output_names=("y",))
    fit = eoi.refine(plant, falling)
    np.testing.assert_allclose(fit.starts[0].z, [2.0, 0.5], rtol=1e-6)
    assert fit.parameters["k"] == pytest.approx(1.3)


def test_effects_leave_the_free_starts_of_the_model():
    plant = cell(FREE)
    placed = place(plant, Relaxation(), 0)
    with_pair = augmented(plant, [placed], dict.fromkeys(placed.names, 0.1))
    np.testing.assert_array_equal(with_pair.free_internal, [True, False, False])


def test_a_saved_result_has_its_free_starts(runs, tmp_path):
    for plant, record in ((cell(FREE), runs[0]), (decay(), None)):
        if record is None:
            record = eoi.simulate(plant, np.arange(50) * 0.1, np.zeros((50, 0)), internal=[1, 1])
        eoi.refine(plant, record).save(tmp_path / "fit.npz")
        loaded = eoi.load(tmp_path / "fit.npz", plant=plant)
        np.testing.assert_array_equal(loaded.plant.free_internal, plant.free_internal)
        assert loaded.plant.internal_initial == plant.internal_initial


def test_exports_say_that_a_start_must_be_set(tmp_path):
    plant = cell(FREE)
    assert program(plant).free_starts
    eoi.export(plant, tmp_path / "cell.py")
    assert "start free, set it: 0.5 is a guess" in (tmp_path / "cell.py").read_text()
    eoi.export(plant, tmp_path / "cell.m", "idnlgrey")
    script = (tmp_path / "cell_idnlgrey.m").read_text()
    assert "'Fixed', {{false, true}}" in script or "{false; true}" in script
    eoi.export(plant, tmp_path / "cell.json")
    assert eoi.load(tmp_path / "cell.json").internal_initial == plant.internal_initial
    eoi.export(decay(), tmp_path / "decay.json")
    loaded = eoi.load(tmp_path / "decay.json")
    np.testing.assert_array_equal(loaded.free_internal, [True, False])


def test_a_parameter_may_be_called_free():
    plant = eoi.plant_from_text({"z": "-z"}, {"free": 0.7}, ["y"], output={"y": "z"},
                                initial={"z": "free"})  # fmt: skip
    assert not plant.free_internal[0]
    assert plant.initial_internal[0] == 0.7


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"soc": 0.8}, '`model.initial` must have the internal state v1, .*v1 = "free"'),
        ({"soc": "free(Q)", "v1": 0.0}, "`model.initial.soc` must have a number in brackets.*Q"),
        ({"soc": np.nan, "v1": 0.0}, "`model.initial.soc` must be a number, a text .*None"),
        ({"soc": "free(1", "v1": "free()"}, "`model.initial.v1` must have a number in brackets"),
    ],
)
def test_what_is_no_start_is_named(initial, message):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        cell(initial)


def test_an_output_is_free_without_a_number():
    rates = {"angle": "rate", "rate": "-a*angle"}
    plant = eoi.plant_from_text(rates, {"a": 1.0}, ["angle"], initial={"rate": "free"})
    assert not plant.start_items
    with pytest.raises(ValueError, match=r"`model.initial.rate` must be free without"):
        eoi.plant_from_text(rates, {"a": 1.0}, ["angle"], initial={"rate": "free(1)"})


def test_starts_that_are_no_numbers_are_named():
    for starts in ([0.0, np.nan], [None, np.inf]):
        with pytest.raises(ValueError, match="`internal_initial` must hold finite numbers"):
            decay(starts)


def test_where_nothing_is_estimated_a_value_is_asked_for():
    plant, time = cell(FREE), np.arange(50.0)
    with pytest.raises(ValueError, match=r"`internal` must give .*nothing for soc.*2 values, as"):
        eoi.simulate(plant, time, np.zeros(50))
    assert eoi.simulate(plant, time, np.zeros(50), internal=[0.5, 0.0]).outputs[0, 0] == 3.75
    with pytest.raises(ValueError, match=r"`x0` must give .*State"):
        eoi.rollout(plant, None, None, jnp.zeros(50), 1.0)
    observer, record = eoi.observers.Measurement(), run(1, 0.8, samples=120)
    for call in (
        lambda: eoi.observe(plant, observer, None, 1.0, record.outputs, record.inputs),
        lambda: eoi.sweep(plant, record),
        lambda: eoi.OnlineEstimator(plant, observer, eoi.LowPass(0.5), 1.0),
    ):
        with pytest.raises(ValueError, match=r"`plant` must give .*soc. Declare a value"):
            call()
