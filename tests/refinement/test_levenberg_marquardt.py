"""The solver: against dense least squares, from several points, by machine code and by scans."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax._status import EngineUsed
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import InputDelay
from eoi_jax.models.step_scales import LINEAR, StepScales
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.levenberg_marquardt import solve, solve_many
from eoi_jax.refinement.problem import Unknowns, guessed_starts, problem_of
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.spans import spans_of

PERIOD = 0.02


def oscillator(t, x, u, p):
    position, rate = x.y
    return (p.gain * u - p.damping * rate - p.stiffness * position) / p.mass


def plant_of(**values):
    nominal = {"gain": 1.2, "damping": 0.5, "stiffness": 9.0, "mass": 1.0, **values}
    return eoi.Plant(oscillator, nominal, 2, ("u",), ("y",), fixed=("gain",))


def runs_of(window):
    """Runs of a window [s], noise of a thousandth, from parameters that are off."""
    time = PERIOD * np.arange(501)
    record = eoi.simulate(plant_of(), time, np.sin(2.0 * time) + np.cos(7.0 * time), [0.02, -0.1])
    error = 1e-3 * np.random.default_rng(0).standard_normal((501, 1))
    record = eoi.Record(time, record.inputs, record.outputs + error, hold=record.hold)
    start, spans = plant_of(damping=0.8, mass=1.3), spans_of([record], window)
    problem = problem_of(start, [record], spans, 2)
    starts = guessed_starts(problem, [record], spans)
    return problem, Unknowns(np.asarray(start.theta)[1:], starts)


@pytest.fixture(scope="module")
def problem():
    return runs_of(5.0)


def solved(runs, unknowns, steps=50):
    return solve(runs, unknowns, signals(unknowns, runs), steps)[0]


def lanes_of(unknowns, factors):
    """The parameters times some factors, from the same initial states."""
    starts = np.broadcast_to(unknowns.starts, (len(factors), *unknowns.starts.shape))
    return Unknowns(np.asarray(factors)[:, None] * np.asarray(unknowns.theta), np.array(starts))


def test_a_full_step_is_that_of_dense_least_squares(problem):
    """Parameters that are affine move by it, and all starts, as if nothing were eliminated."""
    runs, unknowns = problem
    count = len(unknowns.theta)
    affine = replace(runs, scales=StepScales((LINEAR,) * count, ((0.0,) * count,) * count))
    rows, (count, own) = signals(unknowns, runs), unknowns.starts.shape
    dense = np.zeros((count, rows[0].reshape(-1, rows.shape[-1]).shape[0], count * own + 3))
    for i, run in enumerate(rows):
        flat = run.reshape(-1, rows.shape[-1])
        dense[i, :, i * own : (i + 1) * own], dense[i, :, -3:] = flat[:, :own], flat[:, own:-1]
    error = rows[..., -1].ravel()
    expected = -np.linalg.lstsq(dense.reshape(len(error), -1), error)[0]
    further = solved(affine, unknowns, 1).further
    np.testing.assert_allclose(further.theta - unknowns.theta, expected[-3:], rtol=1e-6)
    moved = (further.starts - unknowns.starts).ravel()
    np.testing.assert_allclose(moved, expected[:-3], rtol=1e-6, atol=1e-9)


def test_points_side_by_side_end_where_each_ends_alone(problem):
    runs, unknowns = problem
    points = lanes_of(unknowns, [0.8, 1.0, 1.1, 1.2, 1.3])
    together = solve_many(runs, points, 12)
    for i in range(5):
        alone = solve_many(runs, Unknowns(points.theta[[i]], points.starts[[i]]), 12)
        assert together.steps[i] == alone.steps[0]
        np.testing.assert_allclose(together.cost[i], alone.cost[0], rtol=1e-9)
        np.testing.assert_allclose(together.unknowns.theta[i], alone.unknowns.theta[0], rtol=1e-7)


def test_a_point_whose_runs_diverge_stops_no_other(problem):
    runs, unknowns = problem
    points = lanes_of(unknowns, [1.0, 1.0])
    points.theta[1, 0] = -1e6
    outcome = solve_many(runs, points, 12)
    assert np.isfinite(outcome.cost[0])
    assert np.isnan(outcome.cost[1])
    np.testing.assert_array_equal(outcome.unknowns.theta[1], points.theta[1])


@pytest.mark.parametrize("several", [False, True])
def test_scans_end_where_machine_code_does(problem, several):
    runs, unknowns = problem
    scanned = replace(runs, engine=EngineUsed("scan", "asked for"))
    points = lanes_of(unknowns, [1.0, 1.2] if several else [1.0])
    native, by_scan = (solve_many(one, points, 12) for one in (runs, scanned))
    np.testing.assert_array_equal(native.steps, by_scan.steps)
    np.testing.assert_allclose(native.unknowns.theta, by_scan.unknowns.theta, rtol=1e-8)


def test_runs_of_any_number_are_solved_without_a_compilation(problem):
    """In machine code, which is there after the first runs of a plant."""
    solved(*problem)
    other = runs_of(2.0)
    compiled = []

    def noted(event, duration_secs, **_):
        if heard and "backend_compile" in event:
            compiled.append(duration_secs)

    heard = True
    jax.monitoring.register_event_duration_secs_listener(noted)
    assert solved(*other).steps > 2
    jax.jit(lambda x: 3.0 * x + 1.25)(np.ones(7))
    heard = False
    assert len(compiled) == 1  # the one beside the solver


def sliding(force, seed):
    """A block under a force, against friction of 0.5: exact, with noise of an encoder."""
    time = 0.01 * np.arange(300)
    error = 1e-5 * np.random.default_rng(seed).standard_normal(300)
    position = 0.5 * (force - 0.5) * time**2 + error
    return eoi.Record(time, np.full(300, force), position, hold="zero")


def test_a_block_that_sticks_in_the_model_and_slides_in_a_record_does_not_stop_the_fit():
    """The velocity of its start does next to nothing, and would have to do all."""
    block = eoi.Plant(
        lambda t, x, u, p: p.gain * u - p.friction * jnp.sign(x.y[1]),
        {"gain": 1.0, "friction": 1.0},
        relative_degree=2,
    )
    records = tuple(sliding(force, seed) for seed, force in enumerate((0.6, 4.0, 3.0)))
    fit = refine_once(block, records, None)
    assert fit.status.ok
    assert fit.parameters == pytest.approx({"gain": 1.0, "friction": 0.5}, rel=1e-3)


def pushed_by(law, values, delay=None):
    """Runs of a mass in a bowl behind an input with steps, of a law that begins off the truth."""
    truth = eoi.Plant(lambda t, x, u, p: p.gain * u - x.y[0] - p.bend * x.y[0] ** 2,
                      {"gain": 1.0, "bend": 0.1})  # fmt: skip
    time = 0.05 * np.arange(400)
    steps = np.random.default_rng(4).uniform(-1.0, 1.0, 40).repeat(10)
    record = eoi.simulate(truth, time, steps, [0.0], hold="zero")
    plant = eoi.Plant(law, values)
    if delay is not None:
        plant = augmented(plant, [place(plant, InputDelay(), 0)], {"input_delay": delay})
    problem = problem_of(plant, [record], spans_of([record], None), 1)
    return problem, guessed_starts(problem, [record], spans_of([record], None))


def test_points_behind_a_delay_that_have_ended_leave_the_last_ones_alone():
    """The inputs of each are its own, and those of a point that has ended are not computed."""
    law = lambda t, x, u, p: p.gain * u - x.y[0]  # noqa: E731
    problem, starts = pushed_by(law, {"gain": 0.8}, 0.05)
    theta = np.array([[1.1, 0.03], [np.nan, 0.03], [0.5, 0.12]])
    together = solve_many(problem, Unknowns(theta, np.broadcast_to(starts, (3, *starts.shape))), 20)
    assert np.isnan(together.cost[1])
    for i in (0, 2):
        alone = solve_many(problem, Unknowns(theta[[i]], starts[None]), 20)
        assert alone.steps[0] == together.steps[i]
        np.testing.assert_allclose(together.unknowns.theta[i], alone.unknowns.theta[0], rtol=1e-9)


@pytest.mark.parametrize(("share", "cancels"), [(1.0, False), (1e-4, True)])
def test_parameters_that_do_nearly_the_same_cancel_in_a_step(share, cancels):
    def law(t, x, u, p):
        y = x.y[0]
        return p.gain * u - y - (p.first + p.second) * jnp.sin(y) + p.second * share * y**2

    problem, starts = pushed_by(law, {"gain": 1.0, "first": 0.02, "second": -0.02})
    outcome = solved(problem, Unknowns(np.asarray(problem.theta), starts), 0)
    assert (outcome.cancelling > 100.0) == cancels
