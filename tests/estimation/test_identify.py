"""The estimator from record to parameters: what it recovers, how it ends, what it refuses."""

from importlib import import_module
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import (
    coupled_mass_matrices,
    grid,
    held_response,
    motor_matrices,
    moved_chain,
    moved_level,
    moved_load,
    moved_mass_spring,
    moved_pendulum,
    three_mass_matrices,
)
from scipy.integrate import solve_ivp

from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification, SignalSettings, estimate
from eoi_jax.estimation.identify import identify as identify_by_default
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import (
    FirstOrder,
    HighOrder,
    PerOutput,
    SecondOrder,
    SuperTwisting,
)
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.library import (
    Plant,
    level_tank,
    mass_spring_damper,
    pendulum,
    three_mass_spring_damper,
)
from eoi_jax.simulation.simulate import simulate
from eoi_jax.uncertainty.uncertainty import uncertainty

H = 2e-3
SAMPLES = 2001
TRUE = mass_spring_damper(true=True).parameters
NOMINAL = mass_spring_damper()
OBSERVER = SecondOrder(20.0, 100.0, 500.0)
LOWPASS = LowPass(40.0)


def identify(*args: Any, substeps=2, **kwargs: Any) -> Identification:
    """With few sub-steps: the default takes as many as the best accuracy asks for."""
    return identify_by_default(*args, substeps=substeps, **kwargs)


def swaying(samples=SAMPLES, h=H, noise=0.0, seed=0, **kwargs):
    """The mass on its spring, moved as prescribed; white noise in parts of the rms of y."""
    u, y = moved_mass_spring(grid(samples, h), TRUE)
    draw = np.random.default_rng(seed)
    y = y + noise * np.sqrt(np.mean(y**2)) * draw.standard_normal(samples)
    return Record.from_period(h, u, y, hold="smooth", **kwargs)


def recovered(got, truth, rel):
    """Every parameter within a relative tolerance; the run ended with an answer."""
    assert got.status.ok, str(got.status)
    for name, value in truth.items():
        assert got.parameters[name] == pytest.approx(value, rel=rel), name


@pytest.fixture(scope="module")
def swung():
    """One estimate that many tests look at."""
    seen = []
    record = swaying()
    got = identify(NOMINAL, record, OBSERVER, LOWPASS, callback=lambda *args: seen.append(args))
    return SimpleNamespace(got=got, record=record, calls=seen)


# -- the plants of the paper ----------------------------------------------------------------


def test_mass_spring_damper_is_recovered(swung):
    # h² (12 rad/s)²/8 = 7e-5 of the fastest motion, times a few.
    recovered(swung.got, TRUE, 5e-4)
    assert swung.got.status.code == "converged"


def test_mass_spring_damper_is_recovered_with_chosen_gains():
    got = identify_by_default(NOMINAL, swaying())
    recovered(got, TRUE, 5e-5)  # sub-steps leave less than the h² above
    for chosen in ("cut-off ", "position: relay ", "sub-steps a sample"):
        assert any(chosen in reason for reason in got.reasons), chosen


def test_level_tank_is_recovered():
    plant = level_tank(true=True)
    u, y = moved_level(grid(2001, 5e-3), plant.parameters)
    got = identify(level_tank(), Record.from_period(5e-3, u, y, hold="smooth"))
    recovered(got, plant.parameters, 1e-4)  # h² (4 rad/s)²/8 = 5e-5


def test_three_masses_are_recovered():
    plant, h, samples = three_mass_spring_damper(true=True), 1e-3, 6001
    draw = np.random.default_rng(3)
    u = np.repeat(draw.choice([-1.0, 1.0], samples // 20 + 1), 20)[:samples, None]
    states = held_response(*three_mass_matrices(plant.parameters), u, h)
    record = Record.from_period(h, u, states[:, :3], hold="zero")
    got = identify(three_mass_spring_damper(), record, passes=3)
    # h² ω²/8 with modes up to 45 rad/s: 3e-4, and the small b3, b4 stand beside b2.
    recovered(got, plant.parameters, 2e-2)
    assert np.all(got.sliding_fraction == 1.0)


def test_pendulum_with_dry_friction_is_recovered():
    plant = pendulum(true=True)
    u, y = moved_pendulum(grid(8001, 1e-3), plant.parameters)
    got = identify(pendulum(), Record.from_period(1e-3, u, y, hold="linear"), passes=4, substeps=1)
    recovered(got, plant.parameters, 1e-3)


# -- every structure of a plant ---------------------------------------------------------------


def coupled_masses(t, x, u, p):
    (y1, y2), (v1, v2) = x.y
    return jnp.stack([-p.k * (y1 - y2) - p.d * v1 + u[0], p.k * (y1 - y2) - p.d * v2])


def test_parameters_shared_between_outputs_are_recovered():
    truth = {"k": 40.0, "d": 0.8}
    h, t = 2e-3, grid(SAMPLES, 2e-3)
    u = np.sign(np.sin(5.0 * t))[:, None]
    y = held_response(*coupled_mass_matrices(truth), u, h)[:, :2]
    plant = Plant(coupled_masses, {"k": 30.0, "d": 0.1}, 2, outputs=("y1", "y2"))
    recovered(identify(plant, Record.from_period(h, u, y, hold="zero")), truth, 2e-3)


def load(t, x, u, p):
    return (u - p.b * x.y[1] - p.k * x.y[0]) / p.m


def test_parameters_that_enter_nonlinearly_are_recovered():
    truth = {"m": 2.0, "b": 3.0, "k": 150.0}
    u, y = moved_load(grid(SAMPLES, H), truth)
    plant = Plant(load, {"m": 3.0, "b": 1.0, "k": 100.0}, 2, bounds={"m": (0.1, np.inf)})
    assert not plant.is_affine
    got = identify(plant, Record.from_period(H, u, y, hold="smooth"))
    recovered(got, truth, 5e-4)
    assert got.best_pass >= 1


@pytest.fixture(scope="module")
def stopped() -> Record:
    """A mass that meets an end stop."""
    t = 0.01 * np.arange(2000)
    pushes = np.repeat(np.random.default_rng(3).uniform(-10.0, 10.0, 67), 30)[:2000]
    return simulate(STOPPED, t, 20.0 * np.sin(2.0 * t) + pushes, hold="zero", substeps=8)


def end_stop(t, x, u, p):
    (y,), (v,) = x.y
    return -p.k * y - p.d * v - p.s * jnp.maximum(y - p.gap, 0.0) + u[0]


STOPPED = Plant(end_stop, {"k": 4.0, "d": 1.0, "s": 200.0, "gap": 3.0}, 2)


@pytest.mark.parametrize("unit", [0.2, 1.0, 1e3])
def test_an_end_stop_is_found_from_a_gap_too_wide_whatever_the_unit(stopped, unit):
    """The same run with lengths in another unit: the same passes, scaled."""
    record = Record(stopped.time, unit * stopped.inputs, unit * stopped.outputs, hold="zero")
    start = STOPPED.with_parameters({"k": 3.0, "s": 120.0, "gap": 3.5 * unit})
    got = identify_by_default(start, record, instruments=False)
    assert got.status.code == "converged"
    # Between samples the contact begins: h = 0.01 beside 14 rad/s.
    truth = {"k": 4.0, "d": 1.0, "s": 200.0, "gap": 3.0 * unit}
    recovered(got, truth, 1e-3)


def lower_tank(t, x, u, p):
    return p.k2 * jnp.sqrt(x.z) - p.k3 * jnp.sqrt(x.y[0])


def upper_tank(t, x, u, p):
    return -p.k1 * jnp.sqrt(x.z) + p.k4 * u


def test_two_tanks_with_only_the_lower_level_measured_are_recovered():
    """The unit of the upper level is free; k2, held, chooses it."""
    truth = {"k1": 0.5, "k3": 0.6, "k4": 0.3, "z0": 1.5}
    h, samples = 0.02, SAMPLES

    def pump(t):
        return 2.0 + np.sin(0.7 * t) + 0.5 * np.sin(1.9 * t)

    def rates(t, levels):
        upper, lower = np.sqrt(levels)
        return [-0.5 * upper + 0.3 * pump(t), 0.4 * upper - 0.6 * lower]

    t = grid(samples, h)
    run: Any = solve_ivp(rates, (0.0, t[-1]), [1.5, 1.0], "DOP853", t, rtol=1e-11, atol=1e-12)
    plant = Plant(
        lower_tank,
        {"k1": 0.6, "k2": 0.4, "k3": 0.5, "k4": 0.4, "z0": 1.2},
        internal=upper_tank,
        internal_initial=lambda p: jnp.stack([p.z0]),
        fixed=("k2",),
    )
    got = identify(plant, Record.from_period(h, pump(t), run.y[1], hold="smooth"))
    recovered(got, truth, 2e-3)
    assert got.parameters["k2"] == 0.4
    assert got.standard_errors["k2"] == 0.0


def jerk(t, x, u, p):
    y, rate, acceleration = x.y
    return -p.a * acceleration - p.b * rate - p.c * y + p.d * u


def test_relative_degree_three_is_recovered():
    truth = {"a": 8.0, "b": 60.0, "c": 90.0, "d": 30.0}
    u, y = moved_chain(grid(SAMPLES, H), truth)
    plant = Plant(jerk, {"a": 5.0, "b": 40.0, "c": 50.0, "d": 20.0}, 3)
    got = identify(plant, Record.from_period(H, u, y, hold="smooth"))
    recovered(got, truth, 5e-3)
    assert isinstance(got.observer, HighOrder)


def motor(t, x, u, p):
    current, speed = x.y[0, 0], x.y[1, 1]
    return jnp.stack([-p.R * current - p.K * speed + u[0], p.T * current - p.d * speed])


MOTOR = Plant(motor, {"R": 3.0, "K": 0.5, "T": 8.0, "d": 0.5}, (1, 2), outputs=("current", "angle"))


def test_relative_degrees_one_and_two_together_are_recovered():
    truth = {"R": 5.0, "K": 0.8, "T": 12.0, "d": 1.5}
    u = np.sign(np.sin(4.0 * grid(SAMPLES, H)))[:, None]
    y = held_response(*motor_matrices(truth), u, H)[:, :2]
    got = identify(MOTOR, Record.from_period(H, u, y, hold="zero"))
    recovered(got, truth, 2e-3)
    assert isinstance(got.observer, PerOutput)
    assert got.observer.relative_degree == (1, 2)


def test_records_of_different_length_and_period_make_one_estimate():
    slow = swaying(1200, 2e-3, noise=1e-4, name="slow")
    records = [slow, swaying(1600, 1e-3, noise=1e-5, seed=1, name="fast")]
    got = identify(NOMINAL, records, OBSERVER, LOWPASS, smoothing=False)
    recovered(got, TRUE, 2e-3)
    assert [len(one) for one in got.residual] == [1200, 1600]
    assert [len(one) for one in got.injection] == [1200, 1600]
    alone = identify(NOMINAL, slow, OBSERVER, LOWPASS, smoothing=False)
    for name, value in got.standard_errors.items():
        assert value < alone.standard_errors[name]  # two say more than one


def test_records_ready_for_one_model_serve_another_of_the_same_outputs():
    """Dry friction is masked as the model that is estimated asks, not as the first one did."""
    record = swaying(noise=1e-3)
    smooth, rough = NOMINAL, pendulum()
    prepared = prepare_records(smooth, (record,))
    plain = identify_by_default(smooth, record, instruments=False)
    assert estimate(smooth, prepared).parameters == plain.parameters
    alone = identify_by_default(rough, record, lowpass=prepared.lowpass, instruments=False)
    shared = estimate(rough, prepared)
    assert shared.parameters == alone.parameters
    scored = [np.isfinite(one.residual[0]).sum() for one in (shared, estimate(smooth, prepared))]
    assert scored[0] < scored[1]


def test_substeps_reduce_the_error_of_discretisation():
    record, errors = swaying(401, 1e-2), []
    for substeps in (1, 5):
        got = identify(NOMINAL, record, OBSERVER, LOWPASS, substeps=substeps, passes=2)
        errors.append([abs(got.parameters[name] / value - 1.0) for name, value in TRUE.items()])
        assert len(got.residual[0]) == len(record)  # sub-steps stay inside
    # The order is two: 25 in theory, less what the spline leaves.
    assert np.all(np.array(errors[0]) > 10.0 * np.array(errors[1]))


@pytest.mark.parametrize(
    "observer",
    [SuperTwisting(500.0), HighOrder(500.0, 2), SecondOrder(20.0, 100.0, np.array([500.0]))],
    ids=["super-twisting", "high order", "one gain an output"],
)
def test_every_observer_of_degree_two_gives_the_same_estimate(observer, swung):
    got = identify(NOMINAL, swung.record, observer, LOWPASS, passes=2)
    # All are the second difference of y in sliding; they differ in the rate by O(h²).
    recovered(got, swung.got.parameters, 2e-4)


def test_published_explicit_form_lowers_the_index_but_ends_above_the_implicit_one(swung):
    explicit = SecondOrder(20.0, 100.0, 20.0, scheme="explicit")
    got = identify(NOMINAL, swaying(40_001, 1e-4), explicit, LowPass(20.0), substeps=1)
    assert got.index[got.best_pass, 0] < 0.1 * got.index[0, 0]
    assert got.index[got.best_pass, 0] > 1e3 * swung.got.index.min()


# -- the iteration ----------------------------------------------------------------------------


def test_the_estimate_is_the_pass_with_the_smallest_index(swung):
    got = swung.got
    assert got.best_pass == np.argmin(got.index[:, 0])
    np.testing.assert_array_equal(
        list(got.parameters.values()), got.parameter_history[got.best_pass]
    )
    assert got.plant.parameters == got.parameters
    assert got.nominal.parameters == NOMINAL.parameters


def test_the_estimate_is_nominal_plus_the_increments_before_the_best_pass(swung):
    got = swung.got
    total = NOMINAL.theta + got.increments[: got.best_pass].sum(axis=0)
    np.testing.assert_allclose(list(got.parameters.values()), total, rtol=1e-13)
    assert len(got.index) < 10  # passes that would change nothing are not run


def test_several_outputs_are_weighed_by_their_index():
    """best_pass is the smallest Σ log P: the unit of an output must not decide."""
    truth = {"k": 40.0, "d": 0.8}
    h, t = 2e-3, grid(SAMPLES, 2e-3)
    u = np.sign(np.sin(5.0 * t))[:, None]
    y = held_response(*coupled_mass_matrices(truth), u, h)[:, :2]
    y += 1e-6 * np.random.default_rng(0).standard_normal(y.shape)
    plant = Plant(coupled_masses, {"k": 30.0, "d": 0.1}, 2, outputs=("y1", "y2"))
    got = identify(plant, Record.from_period(h, u, y, hold="zero"), smoothing=False)
    assert got.index.shape[1] == 2
    assert got.best_pass == np.argmin(np.log(got.index).sum(axis=1))


def test_callback_is_called_after_each_pass(swung):
    numbers, totals, indices = zip(*swung.calls, strict=True)
    assert numbers == tuple(range(1, len(swung.got.index) + 1))
    assert set(totals) == {10}
    np.testing.assert_array_equal(np.stack(indices), swung.got.index)


def test_injection_and_residual_are_nan_where_nothing_is_scored(swung):
    got, record = swung.got, swung.record
    for arrays in (got.injection, got.first_injection, got.residual):
        assert len(arrays) == 1
        assert arrays[0].shape == (len(record), 1)
    scored = ~np.isnan(got.injection[0][:, 0])
    np.testing.assert_array_equal(scored, ~np.isnan(got.residual[0][:, 0]))
    start = np.argmax(scored)
    # Ten time constants of F by default; a step belongs to the sample that ends it.
    assert start == round(10.0 / LOWPASS.cutoff / H) + 1
    assert np.all(scored[start:])
    # Eq. (14) from the stored injection, which keeps one of two sub-steps.
    assert np.nanmean(got.injection[0] ** 2) == pytest.approx(got.index[got.best_pass, 0], rel=1e-2)
    assert np.nanmean(got.first_injection[0] ** 2) == pytest.approx(got.index[0, 0], rel=1e-2)
    # Least squares lowers it, but for rounding where nothing is left to lower.
    assert np.nanmean(got.residual[0] ** 2) <= np.nanmean(got.injection[0] ** 2) * (1.0 + 1e-9)


def test_a_record_too_long_to_keep_its_signals_gives_the_same(swung):
    """Then passes in between store nothing, and the best one is run once more."""
    prepared = prepare_records(NOMINAL, (swung.record,), LOWPASS, substeps=2)
    got = estimate(NOMINAL, prepared, OBSERVER, settings=SignalSettings(max_stored=0))
    want = swung.got
    assert want.best_pass > 0
    for name in ("index", "injection", "first_injection", "residual", "covariance", "information"):
        mine, theirs = (np.asarray(getattr(one, name)) for one in (got, want))
        np.testing.assert_allclose(
            mine, theirs, rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(theirs)), err_msg=name
        )


def test_a_regressor_without_bound_where_nothing_is_scored_costs_no_standard_error():
    weights = np.array([[0.0, 1.0, 2.0]]).T
    got = import_module("eoi_jax.estimation.covariance").weighted(
        weights, np.array([[np.inf, 3.0, np.nan]]).T
    )
    np.testing.assert_array_equal(got[:, 0], [0.0, 3.0, np.nan])  # where it counts it stays


def test_burn_in_of_the_record_is_not_scored():
    got = identify(NOMINAL, swaying(burn_in=1.0), OBSERVER, LOWPASS, passes=1)
    assert np.argmax(~np.isnan(got.injection[0][:, 0])) == round(1.0 / H) + 1


def test_bounds_are_kept():
    truth = {"m": 2.0, "b": 3.0, "k": 150.0}
    u, y = moved_load(grid(SAMPLES, H), truth)
    bounds = {"m": (0.1, np.inf), "b": (3.5, 10.0)}
    plant = Plant(load, {"m": 3.0, "b": 5.0, "k": 100.0}, 2, bounds=bounds)
    got = identify(plant, Record.from_period(H, u, y, hold="smooth"), OBSERVER, LOWPASS)
    assert np.all(got.parameter_history[:, 1] >= 3.5)
    assert got.parameters["b"] == 3.5


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_parameter_on_its_bound_leaves_the_others_where_fixing_it_there_does(noise):
    limit = 1.05 * TRUE["beta"]
    at = {"lowpass": LOWPASS, "instruments": False, "smoothing": False}
    bounds = {"beta": (limit, np.inf)}
    start = {**NOMINAL.parameters, "beta": 1.2 * TRUE["beta"]}
    bounded = Plant(NOMINAL.dynamics, start, 2, bounds=bounds)
    fixed = Plant(NOMINAL.dynamics, {**start, "beta": limit}, 2, fixed=("beta",))
    record = swaying(noise=noise)
    got, want = (identify(one, record, OBSERVER, **at) for one in (bounded, fixed))
    assert got.status.code == want.status.code == "converged"
    assert got.parameters["beta"] == limit
    assert got.parameters == pytest.approx(want.parameters, rel=1e-9)
    np.testing.assert_allclose(got.index[got.best_pass], want.index[want.best_pass], rtol=1e-9)
    assert got.notes[-1] == f"beta ended on its bound, {limit:g}"
    assert np.isnan(got.standard_errors.pop("beta"))
    want.standard_errors.pop("beta")
    assert got.standard_errors == pytest.approx(want.standard_errors, rel=1e-6)


def test_bounds_that_are_not_reached_change_nothing(swung):
    bounds = {"beta": (0.5 * TRUE["beta"], 2.0 * TRUE["beta"])}
    plant = NOMINAL.declared_anew(bounds=bounds)
    got = identify(plant, swung.record, OBSERVER, LOWPASS)
    assert got.parameters == swung.got.parameters
    assert got.standard_errors == swung.got.standard_errors
    assert got.notes == swung.got.notes


def test_fixed_parameters_keep_their_value():
    plant = Plant(load, {"m": 2.0, "b": 2.0, "k": 100.0}, 2, fixed=("m", "b"))
    u, y = moved_load(grid(SAMPLES, H), {"m": 2.0, "b": 2.0, "k": 150.0})
    got = identify(plant, Record.from_period(H, u, y, hold="smooth"), OBSERVER, LOWPASS)
    recovered(got, {"k": 150.0}, 5e-4)
    np.testing.assert_array_equal(got.parameter_history[:, :2], 2.0)
    np.testing.assert_array_equal(got.increments[:, :2], 0.0)
    assert got.standard_errors["m"] == 0.0


@pytest.mark.parametrize(
    "start",
    [
        0.0,
        pytest.param(1e-14),
    ],
)
def test_a_nominal_value_near_zero_is_as_good_as_zero(start):
    got = identify(NOMINAL.with_parameters({"beta": start}), swaying(), OBSERVER, LOWPASS)
    recovered(got, TRUE, 5e-4)


def test_a_second_estimate_does_not_retrace_the_model():
    traced = []

    def dynamics(t, x, u, p):
        if isinstance(p.a, Tracer):
            traced.append(True)
        return -p.a * x.y[0] - p.b * x.y[1] + p.c * u

    plant = Plant(dynamics, {"a": 100.0, "b": 5.0, "c": 1.0}, 2)
    identify(plant, swaying(), OBSERVER, LOWPASS, passes=2)
    count = len(traced)
    other = plant.with_parameters({"a": 120.0})
    identify(other, swaying(noise=1e-6), SecondOrder(10.0, 50.0, 800.0), LowPass(30.0), passes=2)
    assert len(traced) == count


# -- how it can end ---------------------------------------------------------------------------


def test_status_says_that_the_passes_did_not_suffice():
    one = identify(NOMINAL, swaying(), OBSERVER, LOWPASS, passes=1)
    assert one.status.code == "passes_exhausted"
    assert one.status.ok
    assert "the nominal values were scored" in one.status.message
    assert one.parameters == NOMINAL.parameters
    two = identify(NOMINAL, swaying(), OBSERVER, LOWPASS, passes=2)
    assert two.status.code == "converged"  # one least squares suffices for an affine model
    recovered(two, TRUE, 5e-4)


def tuned(t, x, u, p):
    return p.rho * u - p.beta * x.y[1] - p.omega**2 * x.y[0]


def test_status_says_that_a_nonlinear_model_needs_more_passes():
    omega = TRUE["alpha"] ** 0.5
    start = {"omega": 3.0 * omega, "beta": TRUE["beta"], "rho": TRUE["rho"]}
    far = Plant(tuned, start, 2)
    few = identify(far, swaying(), OBSERVER, LOWPASS, passes=2)
    assert few.status.code == "passes_exhausted"
    assert "allow more passes" in few.status.message
    enough = identify(far, swaying(), OBSERVER, LOWPASS, passes=30)
    assert enough.status.code == "converged"
    assert enough.parameters["omega"] == pytest.approx(omega, rel=1e-3)


def test_status_names_a_parameter_that_never_enters():
    def dynamics(t, x, u, p):
        return -p.alpha * x.y[0] - p.beta * x.y[1] + p.rho * u + 0.0 * p.ghost

    plant = Plant(dynamics, {**NOMINAL.parameters, "ghost": 7.0}, 2)
    got = identify(plant, swaying(), OBSERVER, LOWPASS)
    assert got.status.code == "unidentifiable"
    assert not got.status.ok
    assert "no trace in the data of ghost:" in got.status.message
    for name, value in TRUE.items():  # the rest is right all the same
        assert got.parameters[name] == pytest.approx(value, rel=5e-4)
    assert got.parameters["ghost"] == 7.0
    assert got.standard_errors.pop("ghost") == np.inf
    assert all(0.0 < error < np.inf for error in got.standard_errors.values())


def test_status_names_a_combination_that_leaves_no_trace():
    def dynamics(t, x, u, p):
        return -(p.stiffness + p.gravity) * x.y[0] - p.beta * x.y[1] + p.rho * u

    start = {"stiffness": 100.0, "gravity": 20.0, "beta": 5.0, "rho": 2.0}
    got = identify(Plant(dynamics, start, 2), swaying(), OBSERVER, LOWPASS)
    assert got.status.code == "unidentifiable"
    assert "stiffness" in got.status.message
    assert "gravity" in got.status.message
    assert "beta" not in got.status.message
    total = got.parameters["stiffness"] + got.parameters["gravity"]
    assert total == pytest.approx(TRUE["alpha"], rel=5e-4)
    known = uncertainty(got).standard_errors
    assert known["stiffness"] == known["gravity"] == np.inf
    assert got.standard_errors == known
    assert " inf " in str(got)


def test_status_says_that_a_plant_at_rest_gives_no_data():
    u = np.sin(grid(8001, 1e-3))
    record = Record.from_period(1e-3, u, np.full(8001, 0.2), hold="linear")
    got = identify(pendulum(), record, OBSERVER, LOWPASS)
    assert got.status.code == "no_data"
    assert "constant throughout" in got.status.message
    assert got.parameters == pendulum().parameters
    assert np.all(np.isnan(got.injection[0]))


def test_status_says_that_dry_friction_holds_a_noisy_plant():
    noise = 1e-5 * np.random.default_rng(0).standard_normal(8001)
    record = Record.from_period(1e-3, np.sin(grid(8001, 1e-3)), 0.2 + noise, hold="linear")
    got = identify(pendulum(), record, OBSERVER, LOWPASS)
    assert got.status.code == "no_data"
    assert "stands still" in got.status.message


def test_status_says_that_the_transient_is_longer_than_the_record():
    got = identify(NOMINAL, swaying(), OBSERVER, LOWPASS, transient=100.0)
    assert got.status.code == "no_data"
    assert "shorter than the transient" in got.status.message


def test_status_says_that_the_model_is_not_finite():
    def dynamics(t, x, u, p):
        return -p.a * jnp.log(x.y[0]) + u

    got = identify(Plant(dynamics, {"a": 1.0}, 2), swaying(), OBSERVER, LOWPASS)
    assert got.status.code == "diverged"
    assert "not finite" in got.status.message
    assert got.parameters == {"a": 1.0}


def test_a_bound_without_slopes_is_not_where_it_ends():
    """f in √(a + 10⁴), so far off that the first step ends on a = -10⁴, where ∂f/∂a is infinite."""

    def rooted(t, x, u, p):
        return -jnp.sqrt(p.a + 1e4) * x.y[0] - p.beta * x.y[1] + p.rho * u[0]

    start = {"a": 16.0 * TRUE["alpha"] ** 2 - 1e4, "beta": TRUE["beta"], "rho": TRUE["rho"]}
    plant = Plant(rooted, start, 2, bounds={"a": (-1e4, np.inf)})
    got = identify(plant, swaying(), OBSERVER, LOWPASS, passes=20)
    assert np.nanmin(got.parameter_history[:, 0]) == -1e4
    recovered(got, {"a": TRUE["alpha"] ** 2 - 1e4, "beta": TRUE["beta"], "rho": TRUE["rho"]}, 2e-3)


def test_a_parameter_that_may_not_be_negative_stays_positive():
    """f in √a, so far off that a step on a linear scale would end below zero."""

    def rooted(t, x, u, p):
        return -jnp.sqrt(p.a) * x.y[0] - p.beta * x.y[1] + p.rho * u[0]

    start = {"a": 16.0 * TRUE["alpha"] ** 2, "beta": TRUE["beta"], "rho": TRUE["rho"]}
    plant = Plant(rooted, start, 2, bounds={"a": (0.0, np.inf)})
    got = identify(plant, swaying(), OBSERVER, LOWPASS)
    assert np.nanmin(got.parameter_history[:, 0]) > 0.5 * TRUE["alpha"] ** 2
    recovered(got, {"a": TRUE["alpha"] ** 2, "beta": TRUE["beta"], "rho": TRUE["rho"]}, 1e-3)


def test_single_precision_is_said():
    with jax.enable_x64(False), pytest.warns(RuntimeWarning, match="single precision"):
        got = identify(NOMINAL, swaying(1001, 4e-3), OBSERVER, LOWPASS, passes=2)
    assert any("single precision" in note for note in got.notes)
    recovered(got, TRUE, 0.05)


def test_a_relay_too_small_is_noted():
    got = identify(NOMINAL, swaying(), SecondOrder(20.0, 100.0, 1e-3), LOWPASS, passes=1)
    assert got.sliding_fraction[0] < 0.1
    assert any("Raise its gain" in note for note in got.notes)


# -- noise ------------------------------------------------------------------------------------


def test_standard_errors_cover_the_truth_under_noise():
    """Sub-steps keep the bias below the spread; without smoothing, noise is white as measured."""
    errors, claimed = [], []
    for seed in range(40):
        got = identify(
            NOMINAL,
            swaying(noise=1e-4, seed=seed),
            OBSERVER,
            LOWPASS,
            passes=2,
            smoothing=False,
            substeps=4,
            instruments=False,
        )
        errors.append([got.parameters[name] - value for name, value in TRUE.items()])
        claimed.append([got.standard_errors[name] for name in TRUE])
    inside = np.mean(np.abs(errors) < 2.0 * np.array(claimed), axis=0)
    assert np.all(inside >= 0.8)  # 95 % less 4 σ of a count of 40
    ratio = np.mean(claimed, axis=0) / np.std(errors, axis=0)
    # Blocks cut differences of the noise apart that cancel over the record: 3 times too large here.
    assert np.all((ratio > 0.7) & (ratio < 4.0))


def test_standard_errors_of_a_record_of_one_block_do_not_claim_certainty():
    record = swaying(150, noise=1e-3)  # 0.3 s; blocks of 3 memories of F are longer
    got = identify(NOMINAL, record, OBSERVER, LOWPASS, smoothing=False, transient=0.1)
    for name, error in got.standard_errors.items():
        assert not error < 1e-6 * TRUE[name]  # large or NaN, not tiny


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_of_1e_4_costs_less_than_a_percent_with_chosen_gains(seed):
    got = identify_by_default(NOMINAL, swaying(noise=1e-4, seed=seed))
    recovered(got, TRUE, 0.01)
    assert got.sliding_fraction[0] > 0.99


# -- wrong calls ------------------------------------------------------------------------------


def test_units_must_agree():
    record = swaying(output_names="position", units={"position": "mm"})
    message = r"`records\[record\].outputs\[position\]` must be in the plant's unit .*'m', got 'mm'"
    with pytest.raises(ValueError, match=message):
        identify(NOMINAL, record)


@pytest.mark.parametrize("unit", ["m", None])
def test_units_that_agree_or_are_missing_pass(unit):
    units = {} if unit is None else {"position": unit}
    record = swaying(output_names="position", units=units)
    assert identify(NOMINAL, record, OBSERVER, LOWPASS, passes=1).status.ok


def two_channels(names=("current", "angle")):
    t = grid(200, H)
    y = np.stack([np.sin(t), np.cos(t)], axis=1)
    return Record.from_period(H, np.sin(t), y, output_names=names)


@pytest.mark.parametrize(
    ("plant", "record", "message"),
    [
        (NOMINAL, two_channels(), r"outputs` must have 1 channel \(position\) .* got 2 \(current"),
        (MOTOR, swaying(200), r"outputs` must have 2 channels \(current, angle\)"),
        (MOTOR, two_channels(("angle", "current")), r"must come in the plant's order \(current, a"),
    ],
    ids=["too many", "too few", "order"],
)
def test_channels_must_be_those_of_the_plant(plant, record, message):
    with pytest.raises(ValueError, match=message):
        identify(plant, record)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"records": []}, "`records` must hold at least one record"),
        ({"passes": 0}, "`passes` must be an integer ≥ 1, got 0"),
        ({"passes": -2}, "`passes` must be an integer ≥ 1, got -2"),
        ({"substeps": 0}, "`substeps` must be an integer ≥ 1, got 0"),
        (
            {"observer": FirstOrder(1.0)},
            r"`observer` must have the relative degree .*FirstOrder of",
        ),
        ({"observer": HighOrder(1.0, 3)}, r"HighOrder of \(3,\)\. Leave it out"),
        (
            {"observer": SecondOrder(1.0, 1.0, np.ones(2))},
            r"`observer.c3` must be one number or 1, one an output, got shape \(2,\)",
        ),
        pytest.param({"smoothing": -1.0}, "smoothing|cutoff"),
        pytest.param({"smoothing": True}, "smoothing"),
        pytest.param({"observer": PerOutput((SecondOrder(1.0, 1.0, 1.0),) * 2)}, "`observer`"),
        pytest.param({"transient": np.nan}, "`transient`"),
    ],
)
def test_wrong_calls_name_field_rule_and_value(change, message):
    call: Any = {"plant": NOMINAL, "records": swaying(200)} | change
    with pytest.raises(ValueError, match=message):
        identify(**call)


def test_errors_are_worked_out_once_and_where_somebody_asks(monkeypatch):
    """An estimate is often but the start of another one."""
    module, calls = import_module("eoi_jax.estimation.covariance"), []
    long_run = module.long_run
    monkeypatch.setattr(module, "long_run", lambda *args: calls.append(1) or long_run(*args))
    result = identify(NOMINAL, swaying(noise=1e-3), OBSERVER, LOWPASS, instruments=False)
    assert not calls
    assert all(error > 0 for error in result.standard_errors.values())
    variances = np.square(list(result.standard_errors.values()))
    np.testing.assert_allclose(np.diagonal(result.covariance), variances, rtol=1e-12)
    assert len(calls) == 1


def test_a_long_record_is_not_kept_until_somebody_asks(monkeypatch):
    module, calls = import_module("eoi_jax.estimation.covariance"), []
    long_run = module.long_run
    monkeypatch.setattr(module, "long_run", lambda *args: calls.append(1) or long_run(*args))
    prepared = prepare_records(NOMINAL, (swaying(noise=1e-3),), LOWPASS, substeps=2)
    estimate(NOMINAL, prepared, OBSERVER, settings=SignalSettings(max_deferred=100))
    assert len(calls) == 1


def test_passes_that_go_in_a_circle_are_not_told_to_go_on():
    """A synchronous machine at a constant current of its q axis: its d axis tells nothing of Ld."""

    def machine(t, x, u, p):
        ((d, q),) = x.y
        lost = p.R * x.y[0]
        return jnp.stack([(u[0] - lost[0] + u[2] * p.Lq * q) / p.Ld,
                          (u[1] - lost[1] - u[2] * (p.Ld * d + p.psi)) / p.Lq])  # fmt: skip

    draw = np.random.default_rng(0)
    speed = np.repeat(draw.uniform(100.0, 400.0, 6), 500)
    volts = np.column_stack([-speed * 4.5e-3 * 3.0, speed * 0.08 + 0.5 * 3.0, speed])
    start = {"R": 0.4, "Ld": 2.5e-3, "Lq": 4e-3, "psi": 0.07}
    plant = Plant(machine, start, (1, 1), inputs=("vd", "vq", "we"), outputs=("id", "iq"))
    currents = np.array([0.0, 3.0]) + 0.02 * draw.standard_normal((3000, 2))
    record = Record(1e-4 * np.arange(3000), volts, currents, hold="zero",
                        input_names=plant.inputs, output_names=plant.outputs)  # fmt: skip
    found = identify(plant, record, passes=10)
    assert found.status.code == "passes_exhausted"
    assert "rises and falls from pass to pass" in found.status.message
    assert "Use `refine`" in found.status.message
