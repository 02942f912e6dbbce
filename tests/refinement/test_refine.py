"""Output-error refinement: derivatives, exact recovery, bounds, windows, failures."""

import functools
import importlib
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._checks import RecordWarning
from eoi_jax.models.augmented import augmented, place
from eoi_jax.refinement import problem as output_error
from eoi_jax.refinement.fit import _typical, fitted
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.multistart import _varied, points_of
from eoi_jax.refinement.problem import Unknowns, guessed_starts, problem_of
from eoi_jax.refinement.refine import refine, refine_once
from eoi_jax.refinement.spans import spans_of, used_window

PERIOD = 5e-3
TIME = np.arange(1001) * PERIOD
FORCE = np.sin(2.0 * TIME) + np.cos(7.0 * TIME)


def rubbing(t, x, u, p):
    position, rate = x.y
    return (u - p.viscous * rate - p.spring * position - p.dry * jnp.sign(rate)) / p.mass


RUBBING = eoi.Plant(
    rubbing,
    {"mass": 0.5, "viscous": 0.3, "spring": 4.0, "dry": 0.25},
    relative_degree=2,
    inputs=("force",),
    outputs=("position",),
)


def pushed(t, x, u, p):
    return (u - p.viscous * x.y[1] - p.spring * x.y[0]) / p.mass


MASS = eoi.Plant(
    pushed,
    {"mass": 0.5, "viscous": 0.3, "spring": 4.0},
    relative_degree=2,
    inputs=("force",),
    outputs=("position",),
)
LAGGED = augmented(MASS, [place(MASS, effects.ActuatorLag(), 0)], {"actuator_lag": 0.02})


def slowed(t, u, p):
    return effects.ActuatorLag().along(t, u[:, 0], [p.actuator_lag])[:, None]


# The same by a function, which only JAX can follow.
OWN_LAG = eoi.Plant(
    pushed,
    MASS.parameters | {"actuator_lag": 0.02},
    relative_degree=2,
    inputs=("force",),
    outputs=("position",),
    actuator=slowed,
)


def hardening(t, x, u, p):
    position, rate = x.y
    spring = p.stiffness * position + p.cubic * position**3
    return p.gain * u - p.damping * rate - spring + p.offset


VALUES = {"gain": 1.2, "damping": 0.5, "stiffness": 9.0, "cubic": 4.0, "offset": 0.1}
STIFF = {"gain": 8e3, "damping": 5.0, "stiffness": 4e4, "cubic": 3e4}
OSCILLATOR = eoi.Plant(hardening, VALUES, 2, ("u",), ("y",))


def run(plant, initial=None, noise: Any = 0.0, seed=0, count=1001):
    time = np.arange(count) * PERIOD
    force = np.sin(2.0 * time) + np.cos(7.0 * time)
    record = eoi.simulate(plant, time, force, initial, hold="linear", substeps=4)
    error = noise * np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return eoi.Record(time, force, record.outputs + error, record.name, hold="linear")


def twice(plant):
    """Ten seconds, and by themselves the first five: of 5 s are two windows and a whole record."""
    record = run(plant, count=2001)
    return [record, beginning(record, 1001)]


def beginning(record, count):
    parts = (part[:count] for part in (record.time, record.inputs, record.outputs))
    return eoi.Record(*parts, hold="linear")


def prepared(plant, records, window, substeps=4):
    spans = spans_of(records, window)
    problem = problem_of(plant, records, spans, substeps)
    theta = jnp.asarray(plant.theta)[np.asarray(problem.free)]
    starts = guessed_starts(problem, records, spans)
    return problem, Unknowns(theta, jnp.asarray(starts))


@pytest.mark.parametrize(
    ("plant", "moved"),
    [
        (RUBBING, {"mass": 0.6, "dry": 0.3}),
        (LAGGED, {"mass": 0.6, "actuator_lag": 0.03}),
        (OWN_LAG, {"mass": 0.6, "actuator_lag": 0.03}),
    ],
    ids=["dry friction", "actuator lag", "actuator of the user's own"],
)
def test_derivatives_are_finite_differences(plant, moved):
    problem, unknowns = prepared(plant, twice(plant.with_parameters(moved)), 5.0)
    assert problem.declared.tolist() == [True, False, True]
    assert problem.compiled == (plant is not OWN_LAG)
    jacobian = np.moveaxis(signals(unknowns, problem)[:, :, 0, :-1], -1, 0)
    own, free = unknowns.starts.shape[1], len(problem.free)

    def flat(x):
        moved = Unknowns(x[:free], x[free:].reshape(unknowns.starts.shape))
        return signals(moved, problem)[:, :, 0, -1]

    x = jnp.concatenate([unknowns.theta, jnp.ravel(unknowns.starts)])
    for j in range(len(x)):
        step = 1e-6 * max(abs(x[j]), 0.1)
        moved = np.eye(len(x))[j] * step
        slope = np.asarray(flat(x + moved) - flat(x - moved)) / (2 * step)
        column = np.zeros_like(slope)
        if j < free:
            column = np.asarray(jacobian[own + j])
        else:
            i, k = divmod(j - free, own)
            column[i] = jacobian[k, i]
        # Differences are off by the bend over their step, and by 1e-15 over it.
        # A run that begins behind another one has none with the level before the record.
        assert np.linalg.norm(slope - column) <= 1e-5 * np.linalg.norm(column), j


def test_a_lag_of_days_has_a_derivative_too():
    """Of a trial far out: a step of the difference by that of the simulation is its rounding."""
    problem, unknowns = prepared(LAGGED.with_parameters({"actuator_lag": 1e9}), twice(MASS), 5.0)
    assert np.all(np.isfinite(signals(unknowns, problem)))


@pytest.mark.parametrize(
    "plant", [RUBBING, LAGGED, OWN_LAG], ids=["machine code", "machine code behind a lag", "scan"]
)
def test_a_beginning_is_scored_as_in_the_whole_runs_and_the_rest_is_not(plant):
    problem, unknowns = prepared(plant, twice(plant), None)
    part = output_error.beginning(problem, 0.25)
    whole, shown = signals(unknowns, problem), signals(unknowns, part)
    for i, count in enumerate([501, 251]):
        np.testing.assert_allclose(shown[i, :count], whole[i, :count], rtol=1e-12)
        assert not np.any(shown[i, count:])
        assert part.use[i].sum() == count
        np.testing.assert_allclose(part.squares[i], np.sum(problem.y[i, :count] ** 2, axis=0))


def test_noise_free_runs_give_the_truth():
    start = OSCILLATOR.with_parameters(0.7 * np.asarray(OSCILLATOR.theta))
    result = refine(start, run(OSCILLATOR, [0.02, -0.1]))
    assert result.status.code == "converged"
    assert str(result.status).endswith(f"any further, after {result.steps} steps in all")
    np.testing.assert_allclose(result.plant.theta, OSCILLATOR.theta, rtol=1e-7)
    assert result.rmse[0] < 1e-9 < result.before[0]
    assert result.cost < result.cost_before
    np.testing.assert_allclose(result.starts[0].y[:, 0], [0.02, -0.1], rtol=1e-6)
    assert [one.time for one in result.starts] == [0.0]
    assert "refined" in str(result)


@pytest.fixture(scope="module")
def lagged():
    """From a lag of 20 ms, and other parameters that are 30 % too small, to one of 30 ms."""
    true = LAGGED.with_parameters({"actuator_lag": 0.03})
    start = true.with_parameters({**{key: 0.7 * value for key, value in MASS.parameters.items()},
                                  "actuator_lag": 0.02})  # fmt: skip
    return true, refine(start, run(true, [0.02, -0.1]), window=1.0, substeps=4)


def test_lag_of_an_actuator_is_refined_to_the_truth(lagged):
    """In windows too: what came before a window is still on its way when it begins."""
    true, result = lagged
    assert result.status.code == "converged"
    assert result.parameters["actuator_lag"] == pytest.approx(0.03, rel=1e-7)
    np.testing.assert_allclose(result.plant.theta, true.theta, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.long
def test_lag_that_is_not_there_is_refined_to_zero():
    """Its bound, on which the lag has a slope like anywhere else."""
    true = LAGGED.with_parameters({"actuator_lag": 0.0, "mass": 0.6})
    result = refine(LAGGED, run(true, [0.02, -0.1]), window=1.0)
    assert result.status.ok
    assert 0.0 <= result.parameters["actuator_lag"] < 1e-9
    assert result.parameters["mass"] == pytest.approx(0.6, rel=1e-7)


def test_windows_start_one_after_the_other_each_from_its_own_state(lagged):
    true, result = lagged
    assert [one.time for one in result.starts] == [0, 1, 2, 3, 4]
    position = run(true, [0.02, -0.1]).outputs[:, 0]
    np.testing.assert_allclose([one.y[0, 0] for one in result.starts], position[:1000:200])
    np.testing.assert_allclose(result.starts[0].y[:, 0], [0.02, -0.1], rtol=1e-6)
    assert result.rmse[0] < 1e-9 < result.before[0]


def test_dry_friction_is_refined_to_the_truth():
    true = RUBBING.with_parameters({"mass": 0.6, "viscous": 0.4, "spring": 5.0, "dry": 0.4})
    result = refine(RUBBING, twice(true), window=5.0)
    assert result.status.ok
    # Moments of rest come and go with the parameters, so that the cost has kinks.
    np.testing.assert_allclose(result.plant.theta, true.theta, rtol=1e-4)


@pytest.mark.slow
@pytest.mark.long
def test_a_search_that_kinks_of_dry_friction_end_leaves_next_to_nothing():
    """A drift that the model lacks: at its best fit, rests begin and end as θ moves."""

    def drifting(t, x, u, p):
        return rubbing(t, x, u, p) + 0.4 * jnp.sin(0.9 * t)

    values = {**RUBBING.parameters, "dry": 0.6}
    truth = eoi.Plant(drifting, values, 2, ("force",), ("position",))
    record = run(truth, count=2001)
    found = refine(RUBBING.with_parameters({"mass": 0.6, "dry": 0.4}), record)
    assert found.status.code == "stalled"
    assert "not smooth" in found.status.message
    again = refine(found.plant, record)
    assert again.rmse**2 >= 0.999 * found.rmse**2


@pytest.mark.parametrize(("plant", "rests"), [(RUBBING, True), (OSCILLATOR, False)])
def test_only_a_plant_that_jumps_stalls_at_moments_of_rest(monkeypatch, plant, rests):
    module = importlib.import_module("eoi_jax.refinement.estimate")
    monkeypatch.setattr(module, "CONVERGED", -1.0)  # no promise is too small
    status = refine(plant, run(plant, count=300), substeps=4).status
    assert status.code == "stalled"
    assert ("moments of rest" in status.message) is rests
    assert ("`starts = 200`" in status.message) is not rests


def test_a_fit_that_stalls_far_above_what_least_squares_promises_is_looked_for(monkeypatch):
    """All do as long as they are told so: the search begins where the fit has ended."""
    module, asked = importlib.import_module("eoi_jax.refinement.searches"), []
    record, start = run(OSCILLATOR, [0.02, -0.1]), OSCILLATOR.with_parameters({"damping": 0.6})

    def best(problem, rough, unknowns, points, rounds):
        asked.append((unknowns.theta, points))
        return [Unknowns(1.01 * unknowns.theta, unknowns.starts)]

    monkeypatch.setattr(module, "best", best)
    monkeypatch.setattr(importlib.import_module("eoi_jax.refinement.refine"), "best", best)
    alone = refine(start, record)
    assert not asked  # it converged
    settings = module.SearchSettings(max_reduction=-1.0)
    monkeypatch.setattr(module, "SEARCH", settings)
    found = refine(start, record)
    ((where, points),) = asked
    np.testing.assert_allclose(where, alone.plant.theta)
    ratio = np.abs(points / alone.plant.theta)
    assert np.all((ratio >= 1.0 / 8.0) & (ratio <= 8.0))
    assert found.rmse[0] <= alone.rmse[0]
    refine(start, record, max_steps=1)
    assert len(asked) == 1  # time was up before it could stall
    refine(start, record, starts=[start.parameters])
    assert len(asked) == 2  # for the points that were given, and no more


def decaying(t, x, u, p):
    return (u[0] - p.R * x.y[0]) / p.L


COIL = eoi.Plant(decaying, {"R": 1.0, "L": 1e-6}, 1, inputs=["v"], outputs=["i"])


def switched(hold):
    """A coil of 1.2 Ω and 0.8 mH behind a staircase of volts, at 20 kHz; noise of 5 mA."""
    time, draw = np.arange(800) / 20e3, np.random.default_rng(0)
    volts = np.repeat(draw.uniform(-5.0, 5.0, 20), 40)
    truth = COIL.with_parameters({"R": 1.2, "L": 0.8e-3})
    current = eoi.simulate(truth, time, volts, hold="zero", substeps=4).outputs
    noise = 5e-3 * draw.standard_normal(current.shape)
    return eoi.Record(
        time, volts, current + noise, input_names=["v"], output_names=["i"], hold=hold
    )


def test_a_start_far_faster_than_the_sampling_is_left_or_said(monkeypatch):
    """The mode of 1 µs has died away by the next sample: no step shows where L belongs."""
    record = switched("zero")
    result = refine(COIL, record)
    assert result.status.code == "converged"
    assert abs(result.parameters["L"] - 0.8e-3) < 4.0 * result.standard_errors["L"] < 1e-5
    module = importlib.import_module("eoi_jax.refinement.searches")
    monkeypatch.setattr(module, "best", lambda *_: [])
    alone = refine(COIL, record)
    assert alone.status.code == "unidentifiable"
    assert alone.status.message.startswith("next to no trace in the outputs of L near 1.")


def test_the_hold_is_not_decided_by_a_fit_that_stalled(monkeypatch):
    """With the hold of the staircase the first fit ends where L leaves no trace, others do not."""
    module = importlib.import_module("eoi_jax.refinement.searches")
    monkeypatch.setattr(module, "faint_parameters", lambda _: ())
    result = refine(COIL, switched("auto"))
    assert result.records[0].hold == "zero"
    assert abs(result.parameters["L"] - 0.8e-3) < 4.0 * result.standard_errors["L"] < 1e-5
    (note,) = (note for note in result.notes if note.startswith("hold zero"))
    assert float(note.split("the error is ")[1].split()[0]) > 3.0  # times as large with linear
    assert result.cost_before > result.cost
    assert f"after {result.steps} steps" in result.status.message


def turning(t, x, u, p):
    angle, rate = x.y
    return -p.gravity * jnp.sin(angle) - p.damping * rate + p.gain * u


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1, 3])
def test_a_run_that_forgets_nothing_is_fitted_from_its_beginning_on(seed):
    """A pendulum that turns over five times or more: half a percent off, it turns otherwise."""
    draw, time, noise = np.random.default_rng(seed), 0.01 * np.arange(1200), 4e-3
    torque = np.repeat(draw.uniform(-0.6, 0.6, 31), 40)[: len(time)]
    states = [np.array([0.3, 0.0])]
    for u in torque[:-1]:
        states.append(
            solve_ivp(
                lambda _, s, u=u: [s[1], -60.0 * np.sin(s[0]) - s[1] + 90.0 * u],
                (0.0, 0.01), states[-1], rtol=1e-10, atol=1e-12,
            ).y[:, -1]
        )  # fmt: skip
    angle = np.array(states)[:, 0] + noise * draw.standard_normal(len(time))
    record = eoi.Record(
        time, torque, angle, input_names=("torque",), output_names=("angle",), hold="zero"
    )
    assert np.ptp(angle) > 10 * np.pi
    near = {"gravity": 60.2, "damping": 1.02, "gain": 90.4}
    pendulum = eoi.Plant(turning, near, 2, ("torque",), ("angle",))
    found = refine(pendulum, record)
    np.testing.assert_allclose(found.rmse, noise, rtol=0.05)
    errors = np.array([found.standard_errors[name] for name in found.plant.names])
    truth = np.array([60.0, 1.0, 90.0])
    assert np.all(np.abs(found.plant.theta - truth) < 4.0 * errors)
    # The valley is narrow, and this its bottom: from elsewhere in it the search ends there too.
    other = found.plant.with_parameters(2.0 * truth - found.plant.theta)
    again = refine(other, record)
    near_enough = 1e-3 if found.status.code == again.status.code == "converged" else 0.2
    assert np.all(np.abs(again.plant.theta - found.plant.theta) < near_enough * errors)
    # From points that were given it is not: the search ends in one of the many other minima.
    assert refine(pendulum, record, starts=[near]).rmse[0] > 100.0 * noise


def test_the_step_is_halved_while_its_error_shows_in_the_estimate():
    """Four steps a radian of its resonance."""
    stiff = OSCILLATOR.with_parameters(STIFF)
    time = np.arange(2001) * PERIOD
    force = np.repeat(np.random.default_rng(3).normal(size=201), 10)[: len(time)]
    exact = eoi.simulate(stiff, time, force, hold="zero", substeps=64)
    noise = 1e-4 * np.random.default_rng(4).standard_normal(exact.outputs.shape)
    record = eoi.Record(time, force, exact.outputs + noise, hold="zero")
    coarse, found = (refine(stiff, record, substeps=count) for count in (4, None))
    assert found.substeps > 4

    def worst(result):
        errors = [abs(result.parameters[name] - stiff.parameters[name])
                  / found.standard_errors[name] for name in stiff.names]  # fmt: skip
        return max(errors)

    assert worst(found) < 4.0 < worst(coarse)


def test_long_steps_are_not_kept_because_they_fit_better():
    """Four steps a sample made this record; their error is no property of the plant."""
    stiff = OSCILLATOR.with_parameters(STIFF)
    force = np.repeat(np.random.default_rng(3).normal(size=101), 10)[:1001]
    record = eoi.simulate(stiff, TIME, force, hold="zero", substeps=4)
    found = refine(stiff.with_parameters({"stiffness": 3.9e4}), record)
    assert found.substeps > 4
    same_steps = refine(stiff.with_parameters({"stiffness": 3.9e4}), record, substeps=4)
    assert same_steps.parameters["stiffness"] == pytest.approx(4e4, rel=1e-8)
    assert found.parameters["stiffness"] == pytest.approx(4e4, rel=1e-3)
    assert found.rmse[0] > same_steps.rmse[0]


def test_the_callback_hears_of_every_step():
    heard = []
    found = refine(
        MASS.with_parameters({"mass": 0.6}), run(MASS), substeps=4, max_steps=20,
        callback=lambda number, most: heard.append((number, most)),
    )  # fmt: skip
    assert found.status.ok
    assert [number for number, _ in heard] == list(range(found.steps + 1))
    assert {most for _, most in heard} == {20}


def test_estimates_scatter_as_their_standard_errors_say():
    """White noise: the sandwich is then the classical covariance, on average."""
    off = []
    for seed in range(12):
        result = refine(OSCILLATOR, run(OSCILLATOR, [0.02, -0.1], 1e-4, seed))
        assert result.rmse[0] == pytest.approx(1e-4, rel=0.1)
        errors_of = np.asarray(list(result.standard_errors.values()))
        off.append((np.asarray(result.plant.theta) - OSCILLATOR.theta) / errors_of)
    # 60 values, Student's t with some forty degrees of freedom, mean square 1.05; five parameters
    # of one run go together, so the bounds are wide.
    assert 0.4 < np.mean(np.square(off)) < 2.5


def test_outliers_do_not_rule_huber_s_loss():
    """Five samples in a hundred are off by a hundred times the noise, all to one side."""
    record = run(OSCILLATOR, [0.02, -0.1], 1e-4)
    draw = np.random.default_rng(1)
    struck = draw.random(len(record)) < 0.05
    outputs = record.outputs + 1e-2 * struck[:, None]
    spoilt = eoi.Record(record.time, record.inputs, outputs, hold="linear")
    squares, robust = refine(OSCILLATOR, spoilt), refine(OSCILLATOR, spoilt, huber=1.345)
    clean = refine(OSCILLATOR, record)
    off = [np.asarray(one.plant.theta) - OSCILLATOR.theta for one in (squares, robust, clean)]
    errors = np.asarray(list(clean.standard_errors.values()))
    assert robust.status.ok
    # The offset of the model takes what five outliers in a hundred push: 0.05 · 1.345 σ / 0.95.
    assert np.max(np.abs(off[1]) / errors) < 6.0
    assert np.max(np.abs(off[0])) > 20.0 * np.max(np.abs(off[1]))


def test_weights_that_did_not_settle_are_said(monkeypatch):
    record = run(OSCILLATOR, [0.02, -0.1], 1e-4)
    struck = np.random.default_rng(1).random(len(record)) < 0.05
    outputs = record.outputs + 1e-2 * struck[:, None]
    spoilt = eoi.Record(record.time, record.inputs, outputs, hold="linear")
    module = importlib.import_module("eoi_jax.refinement.refine")
    monkeypatch.setattr(module, "fitted", functools.partial(fitted, reweightings=0))
    (note,) = refine(OSCILLATOR, spoilt, huber=1.345).notes
    # From the spread of the struck samples to that of the others, which is a hundredth.
    assert "the weights of the outputs still changed by" in note
    assert "after 1 fit;" in note
    assert refine(OSCILLATOR, spoilt).notes == ()  # one output: squares have no weights


def test_without_outliers_huber_s_loss_costs_little():
    record = run(OSCILLATOR, [0.02, -0.1], 1e-4, seed=3)
    squares, robust = refine(OSCILLATOR, record), refine(OSCILLATOR, record, huber=1.345)
    errors = np.asarray(list(squares.standard_errors.values()))
    apart = np.asarray(robust.plant.theta) - np.asarray(squares.plant.theta)
    # The two estimates differ by √(1/0.95 - 1) = 0.23 standard errors, one standard deviation.
    assert np.max(np.abs(apart) / errors) < 1.0


@pytest.mark.slow
def test_the_best_of_several_starts_is_found_where_one_alone_is_lost():
    """A frequency three times too high is in another valley of the cost."""
    record = run(OSCILLATOR, [0.02, -0.1])
    lost = OSCILLATOR.with_parameters({"stiffness": 40.0, "gain": 0.3})
    alone = refine(lost, record, starts=[lost.parameters])
    draw = np.random.default_rng(0)
    points = np.asarray(OSCILLATOR.theta) * draw.uniform(0.2, 3.0, (30, 5))
    found = refine(lost, record, starts=points)
    assert alone.rmse[0] > 1e-2
    np.testing.assert_allclose(found.plant.theta, OSCILLATOR.theta, rtol=1e-6)
    # Without any points the valley is found from the beginning of the run.
    np.testing.assert_allclose(refine(lost, record).plant.theta, OSCILLATOR.theta, rtol=1e-6)
    assert found.before == alone.before  # of the plant as given


@pytest.mark.slow
@pytest.mark.long
def test_so_many_starts_are_drawn_around_a_plant_where_a_wrong_sign_leaves_no_trace():
    """The upper tank runs dry, and its rates say nothing any more."""
    true = eoi.plants.cascaded_tanks(reference=True)
    time, draw = 4.0 * np.arange(601), np.random.default_rng(0)
    pump = np.repeat(draw.uniform(1.0, 5.0, 76), 8)[:601, None]
    record = eoi.simulate(true, time, pump, initial=[5.0])
    lost = true.with_parameters({"k1": 0.03, "k3": 0.2, "k4": -0.1, "upper_initial": 4.0})
    stuck = refine(lost, record, substeps=1, starts=[lost.parameters])
    assert stuck.rmse[0] > 0.1 * np.std(record.outputs)
    for starts in (100, None):  # without any it searches where it stalls, far above its promise
        found = refine(lost, record, substeps=1, starts=starts)
        np.testing.assert_allclose(found.plant.theta, true.theta, rtol=1e-4)
        np.testing.assert_array_equal(found.nominal.theta, lost.theta)  # the plant as given


def spring_with_stops(t, x, u, p):
    (y,), (v,) = x.y
    stops = jnp.maximum(y - p.right, 0.0) - jnp.maximum(-y - p.left, 0.0)
    return p.gain * u - p.damping * v - p.stiffness * y - p.hard * stops


@pytest.mark.slow
@pytest.mark.long
def test_further_rounds_find_what_a_few_points_at_once_do_not():
    """Where a stop lies leaves no trace until the spring between the stops is about right."""
    values = {"gain": 1.0, "damping": 0.5, "stiffness": 16.0, "hard": 80.0, "right": 0.06,
              "left": 0.1}  # fmt: skip
    true = eoi.Plant(spring_with_stops, values, 2)
    time = 0.02 * np.arange(751)
    drive = eoi.excitation.multisine(time, 3.0, (0.2, 2.0), 12, seed=0)
    record = eoi.simulate(true, time, drive, substeps=2)
    noise = 1e-4 * np.random.default_rng(0).standard_normal((751, 1))
    record = eoi.Record(time, record.inputs, record.outputs + noise, hold=record.hold)
    found = {1: 0, 20: 0}
    for seed in range(4):
        far = 1.0 + np.random.default_rng(seed).uniform(-2.0, 2.0, 6)
        lost = true.with_parameters(far * np.asarray(true.theta))
        for rounds in found:
            one = refine(lost, record, substeps=2, starts=20, rounds=rounds)
            found[rounds] += bool(one.rmse[0] < 1.2e-4)
    assert found[20] >= 3
    assert found[20] > found[1]


def test_rounds_are_drawn_around_the_best_so_far_within_the_bounds():
    bounds = {"damping": (0.0, 2.0)}
    values = VALUES | {"cubic": 0.0}
    plant = eoi.Plant(hardening, values, 2, ("u",), ("y",), bounds=bounds, fixed=("offset",))
    best = np.array([1.5, 1.0, 1e9, 3.0, 0.1])
    points = _varied(plant, best, np.zeros((5, 5)), 500, np.random.default_rng(0))
    assert np.all((points >= plant.lower) & (points <= plant.upper))
    np.testing.assert_array_equal(points[:, 4], 0.1)  # fixed
    assert np.max(np.abs(points[:, 2])) <= 8.0 * abs(VALUES["stiffness"])  # had run away
    assert 0.3 < np.mean(points[:, 0] == 1.5) < 0.7  # those moved along nothing stay too
    assert np.all(points[:, 3] > 0.0)  # began at zero, where nothing is to be drawn around
    for wrong in (0, -1):
        with pytest.raises(ValueError, match=rf"`rounds` must be an integer ≥ 1, got {wrong}"):
            refine(plant, run(OSCILLATOR), starts=10, rounds=wrong)
    with pytest.raises(ValueError, match=r"`rounds` must be 1 without `starts`, got 3\. Say how"):
        refine(plant, run(OSCILLATOR), rounds=3)


def test_drawn_starts_keep_to_bounds_and_leave_what_is_fixed_or_zero():
    values = {"gain": 1.2, "damping": 0.5, "stiffness": -9.0, "cubic": 4.0, "offset": 0.0}
    bounds = {"damping": (0.0, 2.0), "stiffness": (-40.0, np.inf)}
    plant = eoi.Plant(hardening, values, 2, ("u",), ("y",), bounds=bounds, fixed=("cubic",))
    points = points_of(plant, 500)
    assert np.all((points >= plant.lower) & (points <= plant.upper))
    np.testing.assert_array_equal(points[:, 3:], [[4.0, 0.0]] * 500)
    ratio = points[:, 0] / 1.2
    assert 1 / 8 <= np.min(np.abs(ratio)) < 1 / 6
    assert 6 < np.max(np.abs(ratio)) <= 8
    assert 0.4 < np.mean(ratio > 0) < 0.6
    assert 0 < np.min(points[:, 1]) < np.max(points[:, 1]) < 2.0
    np.testing.assert_array_equal(points_of(plant, 500), points)
    for wrong in (0, 2.5, "many"):
        with pytest.raises(ValueError, match=rf"`starts` must be points .* drawn: .*{wrong}"):
            points_of(plant, wrong)


def test_further_starts_never_make_the_answer_worse_and_may_all_be_lost():
    record = run(OSCILLATOR, [0.02, -0.1], 1e-3)
    far = [{"stiffness": 60.0, "gain": -3.0}, {"stiffness": 30.0, "damping": 5.0}]
    alone, helped = refine(OSCILLATOR, record), refine(OSCILLATOR, record, starts=far)
    assert helped.cost <= alone.cost
    lost = refine(OSCILLATOR, record, starts=[{"damping": -1e4}] * 2)
    np.testing.assert_array_equal(lost.plant.theta, alone.plant.theta)


def test_starts_are_named_or_rows_within_the_bounds():
    bounded = eoi.Plant(hardening, VALUES, 2, ("u",), ("y",), bounds={"damping": (0.0, 2.0)})
    record = run(OSCILLATOR)
    with pytest.raises(ValueError, match=r"`starts` must keep damping in its bounds \[0, 2\]"):
        refine(bounded, record, starts=[{"damping": 3.0}])
    with pytest.raises(ValueError, match=r"`starts\[0\]`"):
        refine(bounded, record, starts=[[1.0]])


@pytest.mark.parametrize("window", [1e-4, 0.03, 0.1, 0.37, 1.7, 2.0, 4.0, 9.0])
def test_the_window_that_was_used_cuts_records_alike(window):
    several = [beginning(run(MASS, count=2001), count) for count in (2001, 1000, 1337)]
    spans = spans_of(several, window)
    used = used_window(several, spans, window)
    again = spans_of(several, used)
    assert [(one.record, one.first, one.count) for one in again] == [
        (one.record, one.first, one.count) for one in spans
    ]
    if used is not None:
        lengths = [one.count * PERIOD for one in spans]
        assert min(lengths) - PERIOD <= used <= max(lengths) + PERIOD


@pytest.mark.slow
def test_the_answer_has_the_window_that_was_used():
    record = run(MASS, noise=1e-4)
    few = refine(MASS, record, window=1e-3, max_steps=1)
    assert few.window == pytest.approx(1000 / 125 * PERIOD)  # eight steps at least
    assert f"125 runs, windows of {few.window:g} s" in str(few)
    assert refine(MASS, record, window=1.0, max_steps=1).window == 1.0
    whole = refine(MASS, record, window=1e3, max_steps=1)
    assert whole.window is None
    assert "1 run, whole records" in str(whole)


def test_a_parameter_on_its_bound_leaves_the_others_at_their_best():
    record = run(OSCILLATOR, [0.02, -0.1])
    values = VALUES | {"damping": 0.3, "stiffness": 8.0}
    start = eoi.Plant(hardening, values, 2, ("u",), ("y",), bounds={"damping": (0.1, 0.35)})
    result = refine(start, record)
    assert result.parameters["damping"] == 0.35
    assert np.isnan(result.standard_errors["damping"])
    (few, note) = result.notes
    assert "degrees of freedom" in few
    assert note == "damping ended on its bound, 0.35"
    assert eoi.uncertainty(result).unclear[0].startswith(note)
    assert 0.0 < result.standard_errors["stiffness"] < 1.0

    def cost(values, start):
        free = run(OSCILLATOR.with_parameters(values), start)
        return np.sum((free.outputs - record.outputs) ** 2)

    values, start = np.asarray(result.plant.theta), result.starts[0].y[:, 0]
    here, eye = cost(values, start), np.eye(7)
    assert here == pytest.approx(len(TIME) * result.rmse[0] ** 2, rel=1e-9)
    inwards = {}
    for j, move in enumerate(1e-3 * eye * np.abs([*values, *start])):
        below, above = (cost(values + sign * move[:5], start + sign * move[5:]) for sign in (-1, 1))
        inwards[j] = below - above
        if j != 1:  # lowest here: the parabola through the three falls no further
            assert (below - above) ** 2 / (8.0 * (below + above - 2.0 * here)) < 1e-5 * here, j
    assert inwards[1] > 0.0  # more damping would be better still


def test_masked_samples_and_burn_in_are_not_scored():
    record = run(OSCILLATOR, [0.02, -0.1])
    spoilt = record.outputs.copy()
    spoilt[:100] += 1.0
    spoilt[400:420] = np.nan
    with pytest.warns(RecordWarning):
        record = eoi.Record(TIME, FORCE, spoilt, hold="linear", burn_in=0.5)
    start = OSCILLATOR.with_parameters({"stiffness": 8.0})
    result = refine(start, record)
    np.testing.assert_allclose(result.plant.theta, OSCILLATOR.theta, rtol=1e-6)
    missing = np.isnan(result.residual[0][:, 0])
    assert missing[:100].all()
    assert missing[400:420].all()
    assert not missing[100:399].any()
    assert not missing[421:].any()


def two_lags(t, x, u, p):
    return jnp.stack([(u[0] - x.y[0, 0]) / p.first, (x.y[0, 0] - x.y[0, 1]) / p.second])


def test_records_of_any_length_and_outputs_of_any_size_share_one_estimate():
    """The second output has noise of its own, a thousand times larger: it hardly weighs."""
    plant = eoi.Plant(two_lags, {"first": 0.4, "second": 0.2}, 1, ("u",), ("a", "b"))
    true = plant.with_parameters({"first": 0.3, "second": 0.3})
    noise = np.array([1e-5, 1e-2])
    records = [
        beginning(run(true, None, noise, seed), count) for seed, count in enumerate((1001, 400))
    ]
    result = refine(plant, records)
    assert result.status.ok
    np.testing.assert_allclose(result.rmse, noise, rtol=0.1)
    for name, value in true.parameters.items():
        assert abs(result.parameters[name] - value) < 4.0 * result.standard_errors[name]
    assert result.standard_errors["first"] < 1e-2 * result.standard_errors["second"]
    assert [len(one) for one in result.residual] == [1001, 400]


def filling(t, x, u, p):
    return p.gain * x.z[0] - x.y[0, 0]


def rising(t, x, u, p):
    return u - p.rate * x.z


@pytest.fixture(scope="module")
def internals():
    plant = eoi.Plant(
        filling, {"gain": 1.0, "rate": 2.0, "begin": 0.5}, 1, ("u",), ("y",),
        internal=rising, internal_initial=lambda p: jnp.reshape(p.begin, (1,)), fixed=("gain",),
    )  # fmt: skip
    true = plant.with_parameters({"rate": 1.0, "begin": 1.5})
    return true, refine(plant, run(true), window=1.0)


def test_internal_states_start_as_declared_and_freely_in_later_windows(internals):
    true, result = internals
    np.testing.assert_allclose(result.plant.theta, true.theta, rtol=1e-5)
    assert result.starts[0].z[0] == result.parameters["begin"]
    assert len(result.starts) == 5
    z = np.asarray([one.z[0] for one in result.starts])
    # The response to the input, from the equation itself, is what the start does not explain.
    times, decay = TIME[:801], np.exp(-TIME[:801])
    forced = decay * np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (
        FORCE[1:801] / decay[1:] + FORCE[:800] / decay[:-1]))])  # fmt: skip
    np.testing.assert_allclose(z, (1.5 * decay + forced)[::200], rtol=1e-3)


@pytest.mark.parametrize("seed", [1, 3])
def test_declared_starts_of_internal_states_do_not_hide_the_minimum(seed):
    """Their columns are zeros: rounding in their place promised gains that no step could keep."""

    def measured(t, x, u, p):
        return p.fast * (x.z[0] - x.y[0, 0])

    def before_it(t, x, u, p):
        return jnp.stack([p.slow * (x.z[1] - x.z[0]), 3.0 * (p.gain * u[0] - x.z[1])])

    cascade = eoi.Plant(
        measured, {"fast": 15.0, "slow": 2.0, "gain": 2.0}, 1, ("u",), ("y",),
        internal=before_it, internal_initial=[0.0, 0.0],
    )  # fmt: skip
    times = 5e-3 * np.arange(2001)
    force = np.sin(2.0 * times) + np.cos(7.0 * times)
    clean = eoi.simulate(cascade, times, force, hold="linear").outputs
    noise = 1e-2 * np.random.default_rng(seed).standard_normal(clean.shape)
    start = cascade.with_parameters({"fast": 10.0, "slow": 1.0, "gain": 1.0})
    result = refine(start, eoi.Record(times, force, clean + noise, hold="linear"))
    assert result.status.code == "converged"
    assert result.steps < 20
    for name, error in result.standard_errors.items():
        assert abs(result.parameters[name] - cascade.parameters[name]) < 4.0 * error


def test_fixed_parameters_are_kept(internals):
    _, result = internals
    assert result.parameters["gain"] == 1.0
    assert result.standard_errors["gain"] == 0.0
    assert "fixed" in str(result)


def growing(t, x, u, p):
    return p.rate * x.y[0] ** 3 + jnp.sqrt(p.a) * p.b * u


def grower(**fixed):
    return eoi.Plant(growing, {"rate": 1.0, "a": 1.0, "b": 1.0}, 1, ("u",), ("y",),
                     bounds={"a": (0.0, 9.0)}, fixed=tuple(fixed))  # fmt: skip


@pytest.fixture(scope="module")
def faded():
    return run(grower().with_parameters({"rate": -2.0}))


@pytest.mark.slow
def test_a_start_that_diverges_is_said_and_shorter_runs_fit(faded):
    plant = grower()
    result = refine(plant, faded)
    assert result.status.code == "diverged"
    assert "window" in result.status.message
    assert "starts = 200" in result.status.message
    assert result.parameters == plant.parameters
    several = refine(plant, faded, starts=[{"rate": 0.8}, {"rate": 0.9}])
    assert several.status.code == "diverged"
    assert "nor from the 2 other starts" in several.status.message
    assert "starts = 200" not in several.status.message
    shorter = refine(grower(a=True), faded, window=0.2)
    assert shorter.status.ok
    np.testing.assert_allclose(shorter.plant.theta, [-2.0, 1.0, 1.0], rtol=1e-6)


def test_parameters_that_cannot_be_told_apart_are_named(faded):
    result = refine(grower().with_parameters({"rate": -1.5, "a": 1.5}), faded)
    assert result.status.code == "unidentifiable"
    assert "a" in result.status.message.split(":")[0]
    assert "b" in result.status.message.split(":")[0]
    assert result.rmse[0] < 1e-6
    assert result.standard_errors["a"] == result.standard_errors["b"] == np.inf
    assert result.standard_errors == eoi.uncertainty(result).standard_errors


def test_a_start_without_derivatives_is_said(faded):
    def turned(t, x, u, p):
        return p.rate * x.y[0] ** 3 + jnp.arccos(1.0 - p.a) * u

    values, bounds = {"rate": -2.0, "a": 0.0}, {"a": (0.0, 2.0)}
    result = refine(eoi.Plant(turned, values, 1, ("u",), ("y",), bounds=bounds), faded)
    assert result.status.code == "diverged"
    assert "derivatives" in result.status.message
    assert np.isnan(result.standard_errors["rate"])


DISSOLVING = {
    "power": "-k*max(m, 0)**(2/3)",
    "exponent is a parameter": "-k*max(m, 0)**order",
    "root": "-k*cbrt(max(m, 0))**2",
    "condition": "-k*m**(2/3) if m > 0 else 0",
}


def dissolved(rate):
    """The solid that is left, of 100: by dm/dt = -0.28 m^(2/3) gone after 50 of 90 minutes."""
    options: Any = {"outputs": ["released"], "output": {"released": "100 - m"}}
    parameters = {"k": 0.28, **({"order": 2 / 3} if "order" in rate else {})}
    fixed = ["order"] if "order" in rate else []
    return eoi.plant_from_text(
        {"m": rate}, parameters, initial={"m": 100.0}, bounds={"k": (1e-4, 10.0)}, fixed=fixed,
        **options,
    )  # fmt: skip


@pytest.mark.filterwarnings("ignore::eoi_jax._checks.RecordWarning")
@pytest.mark.parametrize("engine", ["native", "scan"])
@pytest.mark.parametrize("law", DISSOLVING)
def test_a_state_that_reaches_zero_by_a_power_below_one_is_fitted(law, engine, monkeypatch):
    if engine == "scan":
        monkeypatch.setattr(output_error.compiled_runs, "supports", lambda *_: "asked for")
    plant = dissolved(DISSOLVING[law])
    time = np.array([0.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0])
    exact = 100.0 - np.maximum(100.0 ** (1 / 3) - 0.28 * time / 3.0, 0.0) ** 3
    noise = 0.7 * np.random.default_rng(0).standard_normal(time.size)
    record = eoi.Record(time, np.zeros((10, 0)), exact + noise, output_names=["released"])
    for start in (0.1, 0.27, 0.4):
        result = refine(plant.with_parameters({"k": start}), record)
        assert result.engine.name == engine
        assert result.status.ok
        assert result.parameters["k"] == pytest.approx(0.28, abs=3.0 * result.standard_errors["k"])
        assert result.standard_errors["k"] < 0.01


def test_what_to_write_is_said_where_a_power_is_no_number():
    time = np.linspace(0.0, 90.0, 10)
    record = eoi.Record(time, np.zeros((10, 0)), np.minimum(2.0 * time, 100.0))
    result = refine(dissolved("-k*m**(2/3)"), record)
    assert result.status.code == "diverged"
    assert "write max(x, 0)**0.7" in result.status.message


def spilling(t, x, u, p):
    (level,) = x.y[0]
    return p.gain * u - p.leak * level - p.rate * jnp.maximum(level - p.edge, 0.0)


@pytest.fixture(scope="module")
def spilled():
    """A tank with an overflow of 1/3 s, sampled once a second; noise of a thousandth."""
    time, values = 1.0 * np.arange(400), {"gain": 1.0, "leak": 0.1, "rate": 3.0, "edge": 5.0}
    tank = eoi.Plant(spilling, values, 1, ("u",), ("level",))
    flow = 1.0 + 0.8 * np.sign(np.sin(0.05 * time))
    clean = eoi.simulate(tank, time, flow, initial=2.0, hold="zero", substeps=64)
    noise = 1e-2 * np.random.default_rng(0).standard_normal(clean.outputs.shape)
    return tank, eoi.Record(time, flow, clean.outputs + noise, hold="zero")


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "edge"), [(15.0, 6.0), (34.0, 6.0), (200.0, 5.0)])
def test_a_start_that_is_fast_beside_the_steps_gets_shorter_ones(spilled, rate, edge):
    """Runge-Kutta of order four is unstable from 2.8 steps a time constant on."""
    tank, record = spilled
    result = refine(tank.with_parameters({"rate": rate, "edge": edge}), record)
    assert result.status.ok
    assert abs(result.parameters["rate"] - 3.0) < 3.0 * result.standard_errors["rate"]
    assert 0.02 < result.standard_errors["rate"] < 0.1  # 0.043 of a start at the truth


def test_where_rounding_decides_over_the_run_there_are_no_derivatives_to_speak_of(spilled):
    """The outputs are finite, and within a few units of the measured ones."""
    tank, record = spilled
    result = refine(tank.with_parameters({"rate": 34.0}), record, substeps=4)
    assert result.status.code == "diverged"
    assert "last digit" in result.status.message
    assert "substeps" in result.status.message
    assert result.rmse[0] < 1.0
    assert np.isnan(result.standard_errors["rate"])


@pytest.mark.slow
@pytest.mark.long
def test_a_search_keeps_off_where_rounding_decides(spilled):
    """Along the way, too: what such slopes promise is worth nothing.

    One start in six stalls at a kink, which one it is hangs on the last digit of a sum.
    """
    tank, record = spilled
    reached = 0
    for off in np.linspace(-2e-3, 2e-3, 9):
        start = tank.with_parameters({"rate": 15.0 * (1.0 + off), "edge": 4.0})
        result = refine(start, record, substeps=4)
        assert result.status.ok
        assert np.isfinite(result.standard_errors["rate"])
        reached += abs(result.parameters["rate"] - 3.0) < 3.0 * 0.043  # of a start at the truth
    assert reached >= 6


@pytest.fixture(scope="module")
def brimming():
    """A brim of 1 ms, sampled once a second; the sensor is full just below, and never shows it.

    Two records, noise of 0.01. Steps of a quarter of a sample are 250 times as long as the time
    constant: the run does not diverge, but falls far below the brim again and again.
    """
    time, values = 1.0 * np.arange(400), {"gain": 1.0, "leak": 0.1, "rate": 1000.0, "edge": 5.0}
    tank = eoi.Plant(spilling, values, 1, ("u",), ("level",), fixed=("rate", "edge"))
    records = []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        flow = np.repeat(rng.uniform(0.0, 1.2, 40), 10)
        level = eoi.simulate(tank, time, flow, initial=2.0, hold="zero", substeps=2048).outputs
        shown = np.minimum(level + 1e-2 * rng.standard_normal(level.shape), 4.99)
        records.append(eoi.Record(time, flow, shown, hold="zero"))
    return tank, *records


def test_held_out_runs_over_a_kink_that_no_sample_shows_take_shorter_steps(brimming):
    tank, _, held_out = brimming
    exact = eoi.validate(tank, held_out, substeps=1024).rmse
    np.testing.assert_allclose(eoi.validate(tank, held_out).rmse, exact, rtol=0.02)
    assert exact[0] < 0.012
    assert eoi.validate(tank, held_out, substeps=4).rmse[0] > 100.0 * exact[0]  # the first tried


@pytest.mark.parametrize("start", [{}, {"gain": 0.8, "leak": 0.12}])
def test_a_fit_over_a_kink_that_no_sample_shows_takes_shorter_steps(brimming, start):
    """Without derivatives in the first steps from the truth; with wrong ones from elsewhere."""
    tank, record, held_out = brimming
    result = refine(tank.with_parameters(start), record, validation=held_out)
    assert result.status.code == "converged"
    for name in ("gain", "leak"):
        truth, error = tank.parameters[name], result.standard_errors[name]
        assert abs(result.parameters[name] - truth) < 4.0 * error
    assert result.rmse[0] < 0.012


def test_too_few_steps_are_said():
    result = refine(OSCILLATOR.with_parameters({"stiffness": 5.0}), run(OSCILLATOR), max_steps=2)
    assert result.status.code == "passes_exhausted"
    assert result.rmse[0] < result.before[0]


@pytest.mark.parametrize("burn_in", [0.5, 2.0, 4.0])
def test_a_start_that_is_forgotten_before_scoring_is_left_alone(burn_in):
    def lag(t, x, u, p):
        return p.rate * (p.gain * u[0] - x.y[0])

    plant = eoi.Plant(lag, {"rate": 15.0, "gain": 2.0})
    clean = eoi.simulate(plant, TIME, FORCE, hold="linear").outputs
    noise = 1e-2 * np.random.default_rng(0).standard_normal(clean.shape)
    record = eoi.Record(TIME, FORCE, clean + noise, hold="linear", burn_in=burn_in)
    result = refine(plant.with_parameters({"rate": 10.0, "gain": 1.0}), record)
    assert result.status.code == "converged"
    assert result.steps <= 8  # e^-60 of a start is left at the last burn-in: none for its noise
    assert abs(result.starts[0].y[0, 0]) < 5.0
    for name, error in result.standard_errors.items():
        assert abs(result.parameters[name] - plant.parameters[name]) < 4.0 * error


def test_records_without_a_scored_sample_are_said():
    record = eoi.Record(TIME, FORCE, run(OSCILLATOR).outputs, hold="linear", burn_in=10.0)
    result = refine(OSCILLATOR, record)
    assert result.status.code == "no_data"


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"window": -1.0}, "window"),
        ({"max_steps": 0}, "max_steps"),
        ({"substeps": 0}, "substeps"),
        ({"huber": 0.0}, "huber"),
    ],
)
def test_wrong_arguments_are_named(options, field):
    with pytest.raises(ValueError, match=f"`{field}`"):
        refine(OSCILLATOR, run(OSCILLATOR), **options)


def test_an_identification_is_refined_and_the_result_is_saved(tmp_path):
    start = OSCILLATOR.with_parameters({"stiffness": 8.0})
    record = run(OSCILLATOR, noise=1e-4)
    result = refine(eoi.identify(start, record), record)
    assert result.status.ok
    result.save(tmp_path / "refined.npz")
    again = eoi.load(tmp_path / "refined.npz")
    assert again.parameters == result.parameters
    assert again.status == result.status


def test_the_typical_error_is_that_of_each_output():
    draw = np.random.default_rng(2)
    error = np.array([1.0, 50.0]) * draw.standard_normal((3, 4000, 2))
    use = draw.uniform(size=error.shape) < 0.9
    error[~use] = 1e6
    np.testing.assert_allclose(_typical(error, use), [1.0, 50.0], rtol=0.05)


def test_where_a_limit_of_the_rate_starts_is_fitted():
    """A rudder on its way to its command where the record begins: 20 degrees are 8 s of it."""
    plant = eoi.Plant(
        lambda t, x, u, p: p.gain * u - x.y[0] / p.tau, {"gain": 0.5, "tau": 4.0}, inputs=("u",)
    )
    limited = [place(plant, effects.RateLimit(), 0)]
    time = 0.1 * np.arange(1000)
    command = np.where(np.sin(2.0 * np.pi * time / 37.0) >= 0.0, 20.0, -20.0)
    truth = augmented(plant, limited, {"rate_limit": 2.5})
    record = eoi.simulate(truth, time, command, [0.0], hold="zero").part(195, 1000)
    fit = eoi.refine(augmented(plant, limited, {"rate_limit": 2.0}), record)
    assert fit.parameters["rate_limit"] == pytest.approx(2.5, rel=1e-3)
    assert fit.parameters["tau"] == pytest.approx(4.0, rel=1e-3)


def test_a_contact_with_damping_is_refined_with_the_derivative_of_its_instants():
    """Without it the fit stalls, and its standard errors are several times too wide."""

    def wall(t, x, u, p):
        q, v = x.y[:, 0]
        push = jnp.where(q > 0.1, p.k * (q - 0.1) + p.d * v, 0.0)
        return 1.5 * u[0] - 1.2 * v - 13.0 * q - push

    true = {"k": 900.0, "d": 6.0}
    rig, time = eoi.Plant(wall, true, 2), 0.004 * np.arange(1000)
    inputs = 3.0 * np.round(2.0 * np.sin(3.0 * time)) / 2.0
    run = eoi.simulate(rig, time, inputs, hold="zero", substeps=16)
    noise = 2e-5 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    result = eoi.refine(
        rig.with_parameters({"k": 880.0, "d": 5.5}), run.with_outputs(run.outputs + noise, "r")
    )
    assert result.status.code == "converged"
    for name, value in true.items():
        assert abs(result.parameters[name] - value) < 3.0 * result.standard_errors[name]
        assert result.standard_errors[name] < 1e-3 * value


def test_steps_follow_a_mode_that_a_fit_has_made_fast():
    """Of a store as fast as that, whose content follows the output, only exchange/rate is told.

    In steps of the start both are told to within a tenth: at the limit of their stability.
    """
    plant = eoi.Plant(lambda t, x, u, p: p.b * u - 0.1 * x.y[0], {"b": 1.0}, 1)
    store = place(plant, effects.SecondNode(), 0)
    random, decay = np.random.default_rng(1), np.exp(-0.04)
    u = np.repeat(random.uniform(0.0, 1.0, 30), 10)
    y = lfilter([0.0, 10.0 * (1.0 - decay)], [1.0, -decay], u)
    record = eoi.Record(np.arange(300.0), u, y + 0.05 * random.standard_normal(300), hold="zero")
    start = augmented(plant, (store,), dict(zip(store.names, (0.2, 0.1), strict=True)))
    fit = refine_once(start, (record,), None, max_steps=100)
    exchange, rate = (fit.parameters[name] for name in store.names)
    assert exchange / rate == pytest.approx(1.5, rel=0.02)
    for name in store.names:
        assert fit.standard_errors[name] > 0.5 * fit.parameters[name]
