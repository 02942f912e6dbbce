"""Loops of few lanes in one vector, what they share inline: wide ones, records in pieces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax import plants
from eoi_jax.compiler.instructions import width_for
from eoi_jax.compiler.runtime import RowFlags, compiled_loop, numbers
from eoi_jax.estimation.engines import Lanes, single
from eoi_jax.estimation.engines.native import pass_of, rows_of
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


def shown(plant, lane, table, *settings):
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[None, None], lane)
    ends = np.array([PERIOD]), np.array([len(table)])
    kernel = kernel_of(plant, "signals")
    return compiled_runs.signals(kernel, one, table[None], *ends, 1, *settings)[0]


WIDE = Plant(waves, dict.fromkeys(TERMS, 0.5), 1, ("u",), ("y",))


def test_more_unknowns_than_a_register_holds_are_those_of_the_scan():
    lane, table, rows = run_of(WIDE, [0.3])
    assert width_for(20, float) == 32
    _, expected = kernel_of(WIDE, "signals").run(lane, rows, jnp.asarray(PERIOD))
    np.testing.assert_allclose(shown(WIDE, lane, table), expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 64, COUNT, COUNT + 1])
def test_a_record_may_go_through_in_pieces(rows):
    plant = plants.pendulum()  # it sticks and leaves
    lane, table, _ = run_of(plant, [0.1, 0.0])
    whole = shown(plant, lane, table)
    settings = compiled_runs.RunSettings(chunk=rows)
    np.testing.assert_array_equal(shown(plant, lane, table, settings), whole)


def steps_of(u):
    ones, first = np.ones((COUNT, 1)), np.arange(COUNT) == 0
    y = np.sin(2.0 * np.arange(COUNT + 1) * PERIOD)[:, None]
    last, period = first[::-1], np.asarray(PERIOD)
    return Steps(TIME, y[:-1], y[1:], u, ones, ones, first, ones[:, 0], last, period)


def test_a_loop_that_branches_for_each_lane_sums_the_same_inline():
    """Dry friction stops lanes of other parameters at other times."""
    plant = plants.pendulum()
    kernel = kernel_of(plant, "sums")
    dtype, (lane, row) = np.dtype(float), compiled_runs._shapes(4, 2, 1, 1)
    loop = compiled_runs._FreeRun(compiled_runs.shapes_of(kernel, dtype), lane, row, dtype)
    one, table, _ = run_of(plant, [0.1, 0.0])
    scale = np.linspace(0.8, 1.2, 5)
    lanes = np.stack([numbers(one, float)] * 5, axis=1)
    lanes[:4] *= scale
    fixed = numbers((kernel, PERIOD), float)
    by_row = compiled_loop(loop, 6).begin(lanes, fixed)
    by_row.advance(table)
    inline = compiled_loop(loop, 6, 5, True).begin(lanes, fixed)
    inline.advance(table)
    assert np.ptp(by_row.result()[:, 0, 0]) > 0
    np.testing.assert_allclose(inline.result(), by_row.result(), rtol=1e-9, atol=1e-12)


def test_a_loop_with_flags_sums_the_same_inline():
    plant, observer = plants.mass_spring_damper(), SecondOrder(20.0, 100.0, 500.0)
    gains = jax.tree.map(lambda leaf: np.full(3, leaf), observer)
    theta = np.linspace(0.9, 1.1, 3)[:, None] * np.asarray(plant.theta)
    lanes = Lanes(gains, theta, np.zeros((3, 3)), np.ones((3, 1)))
    steps, lowpass = steps_of(np.sin(TIME)[:, None]), LowPass(40.0).discretise(PERIOD)
    loop, columns = pass_of(plant, lanes, lowpass, steps, "nothing")
    fixed = numbers((plant, lowpass, steps.sample_period, steps.y[0], steps.y_next[0]), float)
    sums = []
    for arguments in ((loop, columns), (loop, columns, 3, True)):
        run = compiled_loop(*arguments).begin(numbers(lanes, float, skip=1).T, fixed)
        run.advance(rows_of(steps, float), RowFlags(np.asarray(steps.restart)))
        sums.append(run.result())
    by_row, inline = sums
    assert np.all(by_row.square > 0)
    for one, other in zip(jax.tree.leaves(inline), jax.tree.leaves(by_row), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * np.max(np.abs(other)))


@pytest.mark.parametrize("store", ["nothing", "signals"])
def test_a_parameter_that_is_no_number_leaves_none(store):
    plant, observer = plants.mass_spring_damper(), SecondOrder(20.0, 100.0, 500.0)
    steps, one = steps_of(np.sin(TIME)[:, None]), LowPass(40.0).discretise(PERIOD)
    several, filters = jax.tree.map(lambda leaf: np.asarray(leaf)[None], (steps, one))
    run = single.single_pass(plant, observer, filters, several)
    theta = np.asarray(plant.theta)
    good, _ = run(theta, store)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(good))
    bad, _ = run(np.array([theta[0], np.nan, theta[2]]), store)
    assert np.all(np.isnan(bad.square))
    assert np.all(np.isnan(bad.information))
