"""Refinement of unstable plants in windows, and starts that held-out records prefer."""

import functools
import importlib

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.refinement.fit import fitted
from tests.simulation.test_error_growth import NOISE, balanced, second_order

TRUTH = {"a": 25.0, "b": 1.0, "c": 4.0}
WRONG = {"a": 20.0, "b": 0.6, "c": 5.0}


@pytest.fixture(scope="module")
def refined():
    return eoi.refine(second_order(**WRONG), balanced())


def test_an_unstable_plant_is_refined_in_windows(refined):
    assert refined.status.code == "converged"
    assert refined.window is not None
    assert refined.window > 4.0 / 4.5  # longer at the end than four time constants
    assert refined.rmse[0] < 1.05 * NOISE
    for name, value in TRUTH.items():
        assert abs(refined.parameters[name] - value) < 4.0 * refined.standard_errors[name]
        assert refined.standard_errors[name] < 1e-3 * value


def test_the_note_says_why_and_how_many_starts(refined):
    (note,) = [note for note in refined.notes if note.startswith("Fitted in")]
    assert f"{len(refined.starts)} windows of {refined.window:.3g} s" in note


def test_it_is_compared_with_where_it_began(refined):
    assert refined.nominal.parameters == WRONG
    assert refined.before[0] > 10.0 * refined.rmse[0]


@pytest.mark.slow
def test_a_model_that_is_not_exact_keeps_its_short_windows():
    # An acceleration that no parameter explains, as large as 30 times the noise of the output.
    record = balanced()
    disturbed = record.with_outputs(
        record.outputs + 0.03 * np.sin(1.7 * record.time)[:, None], record.name
    )
    short = eoi.refine(second_order(**TRUTH), disturbed)
    assert short.window is not None
    assert short.window < 4.0 / 4.0


def test_a_stable_plant_is_refined_over_whole_records_however_wrong_its_start_is():
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(40), 20)
    truth = second_order(a=-25.0)
    record = eoi.simulate(truth, 0.01 * np.arange(800), u)
    found = eoi.refine(second_order(a=-40.0, b=0.3), record)
    assert found.window is None
    assert found.parameters["a"] == pytest.approx(-25.0, rel=1e-6)


@pytest.mark.slow
def test_a_start_that_held_out_records_prefer_is_kept():
    start = second_order(**WRONG)
    rng = np.random.default_rng(3)
    time, u = 0.01 * np.arange(800), np.repeat(rng.standard_normal(40), 20)
    fitted, held_out = (eoi.simulate(second_order(a=a), time, u) for a in (-25.0, -30.0))
    start = second_order(a=-30.0)
    kept = eoi.refine(start, fitted, validation=held_out)
    assert kept.status.code == "start_kept"
    assert kept.status.ok
    assert kept.parameters == start.parameters
    assert "held-out records worse" in kept.status.message
    assert np.all(np.isfinite(list(kept.standard_errors.values())))
    better = eoi.refine(start, fitted, validation=eoi.simulate(second_order(a=-25.0), time, -u))
    assert better.parameters["a"] == pytest.approx(-25.0, rel=1e-6)


def tank_record():
    time = 5e-3 * np.arange(1200)
    u = 6.0 + 3.0 * np.sin(0.7 * time) + np.sin(3.0 * time)
    return eoi.simulate(eoi.plants.level_tank(true=True), time, u, initial=0.2, hold="linear",
                        substeps=4)  # fmt: skip


def test_a_start_that_no_window_holds_begins_at_the_estimate_of_passes():
    # An inflow that grows with the level: e-fold within a microsecond, 1/5000 of a sample.
    wild = eoi.plants.level_tank().with_parameters({"alpha": -1e5, "beta": -1e3})
    refined = eoi.refine(wild, tank_record())
    assert refined.parameters == pytest.approx(
        eoi.plants.level_tank(true=True).parameters, rel=1e-5
    )
    assert refined.window is None
    assert refined.nominal.parameters == wild.parameters
    assert refined.before[0] > 1e3
    (note,) = [note for note in refined.notes if note.startswith("No run can be simulated")]
    assert "an unstable mode with a time constant of" in note


def test_where_passes_lead_nowhere_either_it_is_refused_with_what_to_do():
    plant = eoi.Plant(
        lambda t, x, u, p: p.a * x.y[0] + p.b * u[0], {"a": 1e5, "b": 1.0}, fixed=("a",)
    )
    record = tank_record()
    refined = eoi.refine(plant, record)
    assert refined.status.code == "diverged"
    assert "passes over the records lead to none that do better" in refined.status.message
    assert refined.parameters == plant.parameters


def test_a_start_that_is_kept_has_no_advice_on_the_fit_that_is_not(monkeypatch):
    module = importlib.import_module("eoi_jax.refinement.refine")
    monkeypatch.setattr(module, "fitted", functools.partial(fitted, reweightings=0))
    u = np.repeat(np.random.default_rng(3).standard_normal(20), 20)
    ours, held_out = (
        eoi.simulate(second_order(a=a), 0.01 * np.arange(400), u) for a in (-25.0, -30.0)
    )
    start = second_order(a=-30.0).declared_anew(bounds={"a": (-32.0, -26.0)})
    found = eoi.refine(start, ours, huber=1.345)
    assert any("a ended on its bound" in note for note in found.notes)
    assert any("refine again from here" in note for note in found.notes)
    kept = eoi.refine(start, ours, huber=1.345, validation=held_out)
    assert kept.status.code == "start_kept"
    assert kept.parameters == start.parameters
    assert not any("bound" in note or "refine again" in note for note in kept.notes)
