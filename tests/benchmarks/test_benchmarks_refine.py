"""Slices of `benchmarks/speed/refine_speed.py` and `benchmarks/statistics/random_starts.py`."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.measured import refine_cases
from benchmarks.speed import refine_rivals as rivals
from benchmarks.statistics import random_starts

STARTS = 10
NUMBA = pytest.mark.skipif(importlib.util.find_spec("numba") is None, reason="Numba is absent")


@pytest.fixture(scope="module")
def silverbox(data_directory: Path):
    return refine_cases.silverbox(data_directory)


@NUMBA
def test_the_rival_and_refine_end_at_one_optimum_of_the_silverbox(silverbox):
    plant, record = silverbox
    steps = 4
    ours = eoi.refine(plant, record, substeps=steps)
    theirs = rivals.fit(rivals.silverbox(), plant.parameters, record, steps, ("lm", 1e-8))
    # Two integrators of one rule and step, and one minimum: costs differ by what the solvers leave.
    assert float(ours.rmse[0]) ** 2 == pytest.approx(theirs.cost, rel=1e-4)
    errors = np.asarray(list(ours.standard_errors.values()))
    apart = np.asarray(list(ours.parameters.values())) - list(theirs.parameters.values())
    assert np.all(np.abs(apart) < 0.1 * errors)


@NUMBA
def test_the_rival_sticks_where_friction_holds_and_stops_where_it_should():
    """A mass that is pushed, coasts to a stop and stays: its way in closed form."""
    force, dry, pushed, h = 5.0, 2.0, 0.1, 1e-3
    u = np.zeros((400, 3))
    u[: round(pushed / h)] = force
    out = rivals.emps()(np.array([1.0, 0.0, dry, 0.0]), 0.0, 0.0, u, h, 1)
    speed = (force - dry) * pushed
    way = 0.5 * speed * pushed + 0.5 * speed**2 / dry
    # Constant accelerations: Runge-Kutta and the stop inside a step are exact, up to rounding.
    assert out[-1] == pytest.approx(way, rel=1e-9)
    assert np.ptp(out[round((pushed + speed / dry) / h) + 1 :]) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["level tank", "mass, spring and damper"])
def test_passes_and_refinement_reach_the_optimum_from_anywhere(name: str, monkeypatch):
    monkeypatch.setattr(random_starts, "SIDE", STARTS)
    (case,) = [one for one in random_starts.simulated() if one.name == name]
    result = random_starts.found(case, STARTS, STARTS)
    assert np.all(result.reached(result.polished))
    # Noise of 1e-3 of rms(y): parameters within a few thousandths of the truth.
    apart = np.abs(result.polished.theta / case.centre - 1.0)
    assert np.max(apart) < 5e-3
    # The starts are far: output error alone misses from some.
    assert not np.all(result.reached(result.alone))


def test_starts_keep_the_bounds_and_what_is_fixed(data_directory: Path):
    case = random_starts.measured()[-1]
    rows, names = case.rows(200), case.plant.names
    assert np.all(rows >= np.asarray(case.plant.lower))
    assert np.all(rows[:, names.index("k2")] == 0.05)
    assert np.min(rows[:, names.index("k1")]) < 0.0
    assert np.all(np.abs(rows - case.centre) <= 2.0 * np.abs(case.centre) * (1 + 1e-12))
