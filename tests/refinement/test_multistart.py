"""The search from several starts: where it goes next, and that it begins anew where it is stuck."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.refinement import multistart
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.multistart import _standard_steps, _varied, best
from eoi_jax.refinement.problem import Unknowns, guessed_starts, problem_of, weighed
from eoi_jax.refinement.searches import in_longer_steps
from eoi_jax.refinement.spans import spans_of

PERIOD, NOISE = 0.02, 1e-3


def swinging(t, x, u, p):
    position, rate = x.y
    return p.gain * u - p.damping * rate - p.stiffness * position + p.idle * 0.0


VALUES = {"gain": 1.2, "damping": 0.5, "stiffness": 9.0, "idle": 2.0}
PLANT = eoi.Plant(swinging, VALUES, 2, ("u",), ("y",))


@pytest.fixture(scope="module")
def problem():
    """Two windows of ten seconds, noise of a few thousandths."""
    time = PERIOD * np.arange(1001)
    record = eoi.simulate(PLANT, time, np.sin(2.0 * time) + np.cos(7.0 * time), [0.02, -0.1])
    error = NOISE * np.random.default_rng(0).standard_normal((1001, 1))
    record = eoi.Record(time, record.inputs, record.outputs + error, hold=record.hold)
    spans = spans_of([record], 10.0)
    problem = problem_of(PLANT, [record], spans, 2)
    starts = jnp.asarray(guessed_starts(problem, [record], spans))
    return problem, Unknowns(jnp.asarray(PLANT.theta), starts)


def least(problem, unknowns, theta):
    """Sum of squares once the initial states have followed θ: the model is linear in them."""
    moved = Unknowns(jnp.asarray(theta), unknowns.starts)
    total = 0.0
    for one in signals(moved, problem):
        rows = one.reshape(-1, one.shape[-1])
        own = rows[:, : unknowns.starts.shape[1]]
        total += np.sum((rows[:, -1] - own @ np.linalg.lstsq(own, rows[:, -1])[0]) ** 2)
    return total


def test_errors_grow_alike_along_steps_of_one_standard_error(problem):
    runs, unknowns = problem
    steps, theta = _standard_steps(runs, unknowns), np.asarray(unknowns.theta)
    np.testing.assert_array_equal(steps[3], 0.0)  # leaves no trace
    count, lowest = np.sum(runs.use), least(runs, unknowns, theta)
    for step in steps.T[:3]:
        around = [least(runs, unknowns, theta + sign * 0.1 * step) for sign in (1.0, -1.0)]
        # 0.1² of the variance of one error, to the second order.
        assert np.mean(around) - lowest == pytest.approx(0.01 * lowest / count, rel=0.05)


def test_no_step_of_one_standard_error_more_than_doubles_a_parameter(problem):
    runs, unknowns = problem
    far = Unknowns(unknowns.theta * jnp.asarray([1.0, 1.0, 5.0, 1.0]), unknowns.starts + 10.0)
    steps = _standard_steps(runs, far)
    assert np.max(np.abs(steps) / np.abs(np.asarray(far.theta))[:, None]) <= 1.0 + 1e-12


def test_a_run_that_diverges_tells_no_direction(problem):
    runs, unknowns = problem
    lost = Unknowns(unknowns.theta * jnp.asarray([1.0, -1e5, 1.0, 1.0]), unknowns.starts)
    np.testing.assert_array_equal(_standard_steps(runs, lost), np.zeros((4, 4)))


def test_parameters_without_a_trace_tell_no_direction():
    """A mass at rest that nothing pushes."""
    time = PERIOD * np.arange(101)
    record = eoi.Record(time, np.zeros(101), np.zeros(101))
    spans = spans_of([record], None)
    runs = problem_of(PLANT, [record], spans, 1)
    still = Unknowns(jnp.asarray(PLANT.theta), jnp.zeros((1, 2)))
    np.testing.assert_array_equal(_standard_steps(runs, still), np.zeros((4, 4)))


def test_points_move_along_what_is_given_and_stay_finite():
    along = np.zeros((4, 4))
    along[:2, 0] = 1.0, -1.0
    draw = np.random.default_rng(0)
    points = _varied(PLANT, np.asarray(PLANT.theta), along, 2000, draw)
    moved = points - np.asarray(PLANT.theta)
    both = (moved[:, 0] != 0.0) & (np.abs(moved[:, 0] + moved[:, 1]) < 1e-9)
    assert 0.1 < np.mean(both) < 0.4
    assert np.max(np.abs(moved[both, 0])) > 5.0
    zero = PLANT.with_parameters({"damping": 0.0})  # nothing to be drawn around
    wild = _varied(zero, np.asarray(PLANT.theta), np.full((4, 4), 1e308), 200, draw)
    assert np.all(np.isfinite(wild))


def test_a_search_that_stands_still_begins_anew_and_ends_at_the_best_one(problem, monkeypatch):
    """Valleys made up, one for each attempt, that no search leaves: the third is the deepest."""
    runs, unknowns = problem
    depth, around, reach = {1.2: 5.0, 10.0: 6.0, 20.0: 3.0, 30.0: 4.0}, [], []

    def drawn(plant, count, draw, ratio):
        reach.append(ratio)
        return np.tile([10.0 * len(reach), 0.5, 9.0, 2.0], (count, 1))

    def varied(plant, now, along, count, draw):
        around.append(now[0])
        return np.tile(now, (count, 1))

    def tournament(problem, rough, theta, starts, stages):
        cost = depth.get(float(theta[0, 0]), 9.0)
        return multistart._Candidate(Unknowns(jnp.asarray(theta[0]), unknowns.starts), cost)

    monkeypatch.setattr(multistart, "_drawn", drawn)
    monkeypatch.setattr(multistart, "_varied", varied)
    monkeypatch.setattr(multistart, "_tournament", tournament)
    points = np.tile(np.asarray(PLANT.theta), (7, 1))
    (found,) = best(runs, runs, unknowns, points, 40)
    assert float(found.theta[0]) == 20.0
    assert around[:5] == [1.2] * 5  # five rounds without a gain
    assert around[5:15] == [10.0] * 5 + [20.0] * 5
    assert around[-8:] == [20.0] * 8  # the last fifth
    assert reach[:3] == [64.0, 8.0, 64.0]
    assert len(around) + len(reach) == 39
    around.clear()
    assert float(best(runs, runs, unknowns, points, 6)[0].theta[0]) == pytest.approx(1.2)
    assert around == [1.2] * 5  # too few rounds for another attempt


def test_where_all_points_diverge_there_is_none(problem):
    runs, unknowns = problem
    lost = Unknowns(unknowns.theta * jnp.asarray([1.0, -1e5, 1.0, 1.0]), unknowns.starts)
    points = np.tile([1.2, -1e5, 9.0, 2.0], (3, 1))
    assert best(runs, runs, lost, points) == []
    assert best(runs, runs, lost, points[:0], 3) == []


def errors_at(runs, unknowns):
    return signals(unknowns, runs)[..., -1] / np.asarray(runs.scale)


def test_longer_steps_sort_starts_out_where_their_error_hardly_shows():
    """A quarter of the steps; not where these go unstable, nor where the first start diverges."""
    time = PERIOD * np.arange(501)
    record = eoi.simulate(PLANT, time, np.sin(2.0 * time), [0.02, -0.1])
    spans = spans_of([record], None)

    def steps(stiffness, start=0.0):
        plant = PLANT.with_parameters({"stiffness": stiffness})
        runs = problem_of(plant, [record], spans, 8)
        unknowns = Unknowns(jnp.asarray(plant.theta), jnp.full((1, 2), start))
        return in_longer_steps(runs, [record], spans, unknowns, errors_at(runs, unknowns)).substeps

    assert steps(20.0) == 2
    assert steps(2e5) == 8  # 4.5 rad of its resonance in a longer step, 1.1 in a short one
    assert steps(-1e6) == 8


def test_longer_steps_weigh_the_outputs_as_the_fit_does():
    """Outliers too: else the points would be sorted out by another cost."""
    time = PERIOD * np.arange(101)
    record = eoi.simulate(PLANT, time, np.sin(2.0 * time), [0.02, -0.1])
    spans = spans_of([record], None)
    runs = weighed(problem_of(PLANT, [record], spans, 8), np.array([0.05]), 1.345)
    unknowns = Unknowns(jnp.asarray(PLANT.theta), jnp.zeros((1, 2)))
    rough = in_longer_steps(runs, [record], spans, unknowns, errors_at(runs, unknowns))
    assert rough.substeps == 2
    assert (rough.scale[0], rough.threshold) == (pytest.approx(20.0), 1.345)


def test_one_step_a_sample_is_not_made_longer():
    time = PERIOD * np.arange(101)
    record = eoi.simulate(PLANT, time, np.sin(2.0 * time))
    spans = spans_of([record], None)
    runs = problem_of(PLANT, [record], spans, 1)
    unknowns = Unknowns(jnp.asarray(PLANT.theta), jnp.zeros((1, 2)))
    assert in_longer_steps(runs, [record], spans, unknowns, errors_at(runs, unknowns)) is runs


def test_points_take_their_first_steps_in_longer_ones_and_end_in_short_ones(problem, monkeypatch):
    runs, unknowns = problem
    rough, seen, solve_many = replace(runs), [], multistart.solve_many

    def watched(one, several, steps):
        seen.append((one is rough, len(several.theta), steps))
        return solve_many(runs, several, steps)

    monkeypatch.setattr(multistart, "solve_many", watched)
    points = np.tile(np.asarray(PLANT.theta), (20, 1))
    best(runs, rough, unknowns, points)
    assert seen == [(True, 20, 8), (False, 3, 8)]
    seen.clear()
    best(runs, rough, unknowns, points, 2)
    assert seen[3:6] == [(True, 1, 16), (False, 1, 8), (False, 1, 24)]  # where all begin
    assert [one for one in seen if one[1] > 1] == 2 * [(True, 20, 16), (False, 3, 8)]


@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_steps_of_one_standard_error_do_not_depend_on_the_unit_of_the_output(problem, unit):
    runs, unknowns = problem
    steps = _standard_steps(runs, unknowns)
    scaled = replace(runs, scale=np.asarray(runs.scale) * unit)
    np.testing.assert_allclose(_standard_steps(scaled, unknowns), steps, rtol=1e-6)
