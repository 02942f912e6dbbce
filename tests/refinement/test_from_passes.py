"""Refinement of an identification, and of its nominal values where these may lead further."""

from dataclasses import replace

import numpy as np
import pytest
from found import discovery

import eoi_jax as eoi
from eoi_jax._status import Status
from eoi_jax.refinement.from_passes import is_refuted

TRUTH = {"T": 0.2, "K": 3.0}


def low_pass(parameters) -> eoi.Plant:
    return eoi.Plant(lambda t, x, u, p: (p.K * u - x.y[0]) / p.T, parameters, 1, name="low pass")


@pytest.fixture(scope="module")
def record() -> eoi.Record:
    draw, period = np.random.default_rng(3), 0.02
    u, y = np.repeat(draw.uniform(-1.0, 1.0, 30), 10), np.zeros(300)
    for k in range(299):
        y[k + 1] = 3.0 * u[k] + (y[k] - 3.0 * u[k]) * np.exp(-period / 0.2)
    y += 1e-3 * draw.standard_normal(300)
    return eoi.Record.from_period(period, u, y, hold="zero")


@pytest.fixture(scope="module")
def passes(record) -> eoi.Identification:
    return eoi.identify(low_pass({"T": 0.3, "K": 2.0}), record)


def with_held(passes: eoi.Identification, value: float) -> eoi.Identification:
    """As if the passes had held T there."""
    plant = passes.plant.declared_anew({"T": value}, fixed=["T"])
    return replace(passes, plant=plant, parameters=plant.parameters)


def test_what_only_the_passes_fixed_is_free_where_that_fits_better(passes, record):
    held_out = record.with_outputs(record.outputs + 1e-4, "held out")
    found = eoi.refine(with_held(passes, 1.0), record, validation=held_out)
    assert found.status.code == "converged"
    assert not found.plant.fixed
    for name, value in TRUTH.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.01)
    assert "refined from the nominal values, with T free" in found.notes[-1]


def test_what_the_passes_hold_stays_where_that_fits_as_well_and_a_note_says_why(passes, record):
    found = eoi.refine(with_held(passes, 0.2), record)
    assert found.plant.fixed == ("T",)
    assert found.notes[-1].startswith("T stays at 0.2, where the passes hold it")


def test_the_nominal_values_are_refined_too_where_the_passes_did_not_end(passes, record):
    astray = replace(passes, status=Status("stalled", ""), plant=low_pass({"T": 0.2, "K": -4.0}))
    assert "the passes ended as stalled" in eoi.refine(astray, record, max_steps=1).notes[-1]
    found = eoi.refine(passes, record)
    assert not any("refined from" in note for note in found.notes)


def test_an_estimate_that_simulates_its_records_worse_than_the_nominal_values_is_refuted():
    start = discovery().declared
    astray = start.plant.with_parameters({"spring": 10.0 * start.parameters["spring"]})
    assert not is_refuted(start)
    assert is_refuted(replace(start, plant=astray))
