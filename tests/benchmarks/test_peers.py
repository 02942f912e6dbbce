"""Outside peers of `statistics/comparators.py` see the same plants, and may be absent."""

import math
import sys

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks import independent
from benchmarks.statistics import comparator_cases, peers

CASES = {one.plant.name: one for one in comparator_cases.cases()}


@pytest.fixture(scope="module")
def record() -> eoi.Record:
    return CASES["mass, spring and damper"].record(1, 1e-3)


@pytest.mark.parametrize("name", CASES)
def test_peers_have_the_plants_own_equations(name: str):
    plant = CASES[name].truth
    f = peers.equations(name, math.sin, math.sqrt)
    rng = np.random.default_rng(1)
    y, v, u = rng.uniform(0.2, 1.0, len(plant.outputs)), rng.uniform(0.2, 1.0, 3), 0.7
    rows = [y, v[: len(y)]][: plant.relative_degree]
    x = eoi.State(jnp.asarray(np.stack(rows)), jnp.zeros(0))
    own = plant.derivative(jnp.asarray(0.0), x, jnp.asarray([u]), jnp.asarray(plant.theta))
    theirs = f(y, v[: len(y)], u, np.asarray(plant.theta), 1.0)
    np.testing.assert_allclose(theirs, own, rtol=1e-12)


def test_pysindy_finds_the_linear_plant(record: eoi.Record):
    pytest.importorskip("pysindy")
    case = CASES["mass, spring and damper"]
    found = peers.PySindy().estimate(case.plant, [record])
    assert found.parameters is not None
    share = [found.parameters[key] / true - 1.0 for key, true in case.truth.parameters.items()]
    assert np.max(np.abs(share)) < 2e-2  # a regression on smoothed differences


def test_an_absent_peer_is_a_row_that_says_so(record: eoi.Record, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    plant = CASES["mass, spring and damper"].plant
    found = eoi.compare(plant, record, methods=[peers.Casadi()])
    assert found["casadi"].status.code == "failed"
    assert "ModuleNotFoundError" in found["casadi"].status.message
    assert "casadi" in found["casadi"].status.message


def test_two_simulators_of_the_duffing_oscillator_agree():
    case = CASES["Duffing oscillator"]
    time, u = case.time[:600], case.drive(case.time, 1)[:600]
    y = independent.duffing(case.truth.parameters, time, u, "zero")
    own = eoi.simulate(case.truth, time, u, hold="zero", substeps=64).outputs
    # Runge-Kutta at 64 steps a sample: (0.7/64)⁴/120 a radian, over some 400 of them.
    assert np.max(np.abs(y - own)) < 5e-9
