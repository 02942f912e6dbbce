"""Loops of few lanes in one vector: what they refuse, wide ones, records in pieces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax import plants
from eoi_jax.compiler import one_vector
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.runtime import few_lanes
from eoi_jax.estimation.engines import Lanes, single
from eoi_jax.estimation.engines.native import pass_of
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import SecondOrder
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.problem import kernel_of
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.sensitivity import RunLane, RunRow

PERIOD, COUNT = 5e-3, 700
TIME = np.arange(COUNT) * PERIOD
TERMS = [f"c{i}" for i in range(19)]


def waves(t, x, u, p):
    """Nineteen parameters, of which each has a slope of its own."""
    return u[0] - 2.0 * x.y[0] + sum(c * jnp.sin(0.3 * i * t) for i, c in enumerate(p))


def run_of(plant, start):
    """A lane, the table of its only run, and its rows."""
    y, use = np.cos(3.0 * TIME), np.arange(COUNT) % 5 > 0
    u = np.sin(4.0 * TIME)[:, None] * np.ones(3)
    table = np.column_stack([TIME, u, y, use])
    lane = RunLane(
        np.asarray(plant.theta), np.array(start), np.zeros(()), np.full(1, 2.0), np.asarray(np.inf)
    )
    return lane, table, RunRow(TIME, u[..., None], y[:, None], 1.0 * use[:, None])


def shown(plant, lane, table):
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[None, None], lane)
    ends = np.array([PERIOD]), np.array([len(table)])
    return compiled_runs.signals(kernel_of(plant, "signals"), one, table[None], *ends, 1)[0]


WIDE = Plant(waves, dict.fromkeys(TERMS, 0.5), 1, ("u",), ("y",))


def test_more_unknowns_than_a_register_holds_are_those_of_the_scan():
    lane, table, rows = run_of(WIDE, [0.3])
    assert one_vector.width_for(20, float) == 32
    _, expected = kernel_of(WIDE, "signals").run(lane, rows, jnp.asarray(PERIOD))
    np.testing.assert_allclose(shown(WIDE, lane, table), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 64, COUNT, COUNT + 1])
def test_a_record_may_go_through_in_pieces(monkeypatch, rows):
    plant = plants.pendulum()  # it sticks and leaves
    lane, table, _ = run_of(plant, [0.1, 0.0])
    whole = shown(plant, lane, table)
    monkeypatch.setattr(compiled_runs, "_CHUNK", rows)
    np.testing.assert_array_equal(shown(plant, lane, table), whole)


def steps_of(u):
    ones, first = np.ones((COUNT, 1)), np.arange(COUNT) == 0
    y = np.sin(2.0 * np.arange(COUNT + 1) * PERIOD)[:, None]
    last, period = first[::-1], np.asarray(PERIOD)
    return Steps(TIME, y[:-1], y[1:], u, ones, ones, first, ones[:, 0], last, period)


def test_flags_are_refused():
    plant, observer = plants.mass_spring_damper(), SecondOrder(20.0, 100.0, 500.0)
    gains = jax.tree.map(lambda leaf: np.asarray(leaf)[None], observer)
    lanes = Lanes(gains, np.asarray(plant.theta)[None], np.zeros((1, 3)), np.ones((1, 1)))
    steps = steps_of(np.sin(TIME)[:, None])
    what, columns = pass_of(plant, lanes, LowPass(40.0).discretise(PERIOD), steps, "signals")
    with pytest.raises(Untranslatable, match="flags"):
        few_lanes(what, columns, 1)


def test_branches_that_lanes_take_each_for_itself_are_refused():
    """Dry friction stops lanes of other parameters at other times."""
    kernel = kernel_of(plants.pendulum(), "sums")
    dtype, (lane, row) = np.dtype(float), compiled_runs._shapes(4, 2, 1, 1)
    what = compiled_runs._FreeRun(compiled_runs.shapes_of(kernel, dtype), lane, row, dtype)
    with pytest.raises(Untranslatable, match="branches"):
        few_lanes(what, 6, 4)


@pytest.mark.parametrize("store", ["nothing", "signals"])
def test_a_parameter_that_is_no_number_leaves_none(store):
    plant, observer = plants.mass_spring_damper(), SecondOrder(20.0, 100.0, 500.0)
    steps, one = steps_of(np.sin(TIME)[:, None]), LowPass(40.0).discretise(PERIOD)
    several, filters = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (steps, one))
    run = single.alone(plant, observer, filters, several)
    theta = np.asarray(plant.theta)
    good, _ = run(theta, store)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(good))
    bad, _ = run(np.array([theta[0], np.nan, theta[2]]), store)
    assert np.all(np.isnan(bad.square))
    assert np.all(np.isnan(bad.information))
