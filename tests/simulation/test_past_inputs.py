"""Inputs behind lags and delays that were at another level before the record."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import ActuatorLag, RateLimit
from eoi_jax.models.equations.text_model import plant_from_text
from eoi_jax.refinement.problem import kernel_of
from eoi_jax.simulation.simulate import acted, actuated, actuated_on_host, drive, past_slopes

SLOW, LAG, NOISE = 3.0, 0.7, 1e-3


def _plant(**parameters):
    return plant_from_text(
        derivatives={"y": "(u - y)/T"},
        parameters={"T": SLOW, "lag": LAG, **parameters},
        inputs=("u",),
        outputs=("y",),
        input_lag={"u": "lag"},
    )


def _step_response(seed):
    """Of both lags in series, from rest; the input is already on at the first sample."""
    time = np.arange(400) * 0.05
    parts = SLOW * np.exp(-time / SLOW) - LAG * np.exp(-time / LAG)
    y = 1.0 - parts / (SLOW - LAG)
    y += NOISE * np.random.default_rng(seed).standard_normal(len(y))
    return eoi.Record(
        time, np.ones(len(y)), y, hold="zero", input_names=("u",), output_names=("y",)
    )


def test_a_step_response_that_begins_with_its_step_is_simulated():
    judged = eoi.validate(_plant(), _step_response(1))
    assert judged.rmse[0] < 1.1 * NOISE


def test_a_step_response_that_begins_with_its_step_is_refined():
    refined = eoi.refine(_plant(T=2.0, lag=0.3), [_step_response(2), _step_response(3)])
    assert refined.status.ok
    for name, value in {"T": SLOW, "lag": LAG}.items():
        error = refined.standard_errors[name]
        assert error < 0.01 * value
        assert refined.parameters[name] == pytest.approx(value, abs=4.0 * error)


def test_inputs_behind_a_known_lag_have_no_derivatives_and_the_rest_is_refined():
    plant = _plant(T=2.0).declared_anew(fixed=("lag",))
    assert kernel_of(_plant(), "sums").acting == (1,)
    assert kernel_of(plant, "sums").acting == ()
    refined = eoi.refine(plant, [_step_response(2), _step_response(3)])
    error = refined.standard_errors["T"]
    assert error < 0.01 * SLOW
    assert refined.parameters["T"] == pytest.approx(SLOW, abs=4.0 * error)
    assert refined.parameters["lag"] == LAG


def test_levels_before_the_record_fade_behind_a_lag_and_pass_behind_a_delay():
    time = np.arange(40) * 0.1
    plant = _plant()
    driven_by = drive(time, np.ones((40, 1)), "zero")
    slopes = past_slopes(plant, driven_by)[:, 0, 0, 0]
    # the input at the start of a step is the mean over the steps around it, (h/T)²/6 larger
    assert slopes[5:] == pytest.approx(np.exp(-time[5:-1] / LAG), rel=1.05 * (0.1 / LAG) ** 2 / 6)
    moved = actuated(plant, jnp.asarray(plant.theta), driven_by, jnp.asarray([-1.0]))
    settled = acted(plant, driven_by)
    assert np.asarray(moved)[:, 0, 0] == pytest.approx(settled.inputs[:, 0, 0] - slopes)
    late = plant_from_text(
        derivatives={"y": "(u - y)/T"},
        parameters={"T": 3.0, "late": 0.35},
        inputs=("u",),
        outputs=("y",),
        input_delay={"u": "late"},
    )
    means = np.mean(past_slopes(late, driven_by)[:, [0, 1, 1, 2], 0, 0], axis=1)
    assert means[:2] == pytest.approx(1.0)
    assert means[6:] == pytest.approx(0.0)


def test_numpy_gives_the_inputs_behind_actuators_and_their_slopes_as_jax_does():
    plant, time = _plant(), np.arange(60) * 0.1
    driven_by = drive(time, np.cumsum(np.sin(time))[:, None], "linear")
    theta, level = jnp.asarray(plant.theta), jnp.asarray([0.7])

    def behind(past):
        return actuated(plant, theta, driven_by, past)

    found = actuated_on_host(plant, np.asarray(plant.theta), driven_by, np.asarray(level))
    np.testing.assert_allclose(found, behind(level), rtol=1e-12, atol=1e-12)
    inputs = acted(plant, driven_by).inputs
    np.testing.assert_allclose(inputs, actuated(plant, theta, driven_by), rtol=1e-12, atol=1e-12)
    wanted = jax.jacfwd(behind)(level)
    np.testing.assert_allclose(past_slopes(plant, driven_by), wanted, atol=1e-12)


OMEGA, ZETA, LIMIT = 12.0, 0.7, 2.0


def _servo(t, x, u, p):
    del t
    return p.omega**2 * (u - x.y[0]) - 2.0 * p.zeta * p.omega * x.y[1]


def _ramped_steps(seed):
    """A servo whose target, in steps of random height, is ramped at `LIMIT` by its controller.

    The first step comes within the first sample: the mean of the input there is neither level.
    """
    random, period, each = np.random.default_rng(seed), 0.02, 40
    heights = np.append(1.2, random.uniform(-1.5, 1.5, 7))
    instants = each * period * np.arange(len(heights)) + 0.4 * period * np.eye(len(heights))[0]
    targets, ramps = [], [(0.0, 0.0, 0.0)]
    for instant, height in zip(instants, heights, strict=True):
        start, begin, end = ramps[-1]
        reached = begin + np.clip(end - begin, *(np.array([-1.0, 1.0]) * LIMIT * (instant - start)))
        ramps.append((instant, reached, height))

    def target(t):
        start, begin, end = next(ramp for ramp in ramps[::-1] if ramp[0] <= t)
        return begin + np.clip(end - begin, -LIMIT * (t - start), LIMIT * (t - start))

    def rates(t, x):
        return [x[1], OMEGA**2 * (target(t) - x[0]) - 2.0 * ZETA * OMEGA * x[1]]

    time = period * np.arange(each * len(heights))
    run = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], t_eval=time, max_step=period, rtol=1e-8)
    for t in time:
        parts = np.append(t + period * (np.arange(50) + 0.5) / 50, t + period)[:-1]
        levels = np.concatenate([[0.0], heights])[np.searchsorted(instants, parts, side="right")]
        targets.append(np.mean(levels))
    y = run.y[0] + 1e-3 * random.standard_normal(len(time))
    return eoi.Record(time, targets, y, hold="zero", input_names=("u",), output_names=("y",))


@pytest.mark.parametrize("nominal", [6.0, 12.0, 20.0])
def test_level_before_a_limit_of_the_rate_is_no_extrapolation(nominal):
    """Extrapolated from a unit of it, levels of thousands and speeds to match fitted the head."""
    plant = eoi.Plant(_servo, {"omega": nominal, "zeta": ZETA}, 2, ("u",), ("y",))
    at = place(plant, RateLimit(), 0)
    plant = augmented(plant, (at,), {at.names[0]: 2.5})
    record = _ramped_steps(1)[:120]
    driven_by = drive(np.asarray(record.time), np.asarray(record.inputs), "zero")
    assert not np.any(past_slopes(plant, driven_by))
    refined = eoi.refine(plant, record)
    assert refined.status.code == "converged"
    assert refined.parameters["rate_limit"] == pytest.approx(LIMIT, rel=2e-3)
    assert refined.parameters["omega"] == pytest.approx(OMEGA, rel=2e-3)


def test_an_input_that_no_actuator_changes_passes_as_it_is():
    """At the kinks of a linear hold, too, where parabolas through means are no straight lines."""
    two = eoi.Plant(
        lambda t, x, u, p: p.a * (u[0] + u[1] - x.y[0]), {"a": 0.5}, 1, inputs=("u", "w")
    )
    placed = place(two, ActuatorLag(), 0)
    lagged = augmented(two, [placed], {placed.names[0]: 0.3})
    time = np.arange(30) * 0.1
    signals = np.random.default_rng(0).standard_normal((30, 2))
    driven_by = drive(time, signals, "linear", 4)
    inputs = np.asarray(acted(lagged, driven_by).inputs)
    np.testing.assert_array_equal(inputs[..., 1], np.asarray(driven_by.inputs)[..., 1])
    assert not np.allclose(inputs[..., 0], np.asarray(driven_by.inputs)[..., 0])
    theta = jnp.asarray(lagged.theta)
    np.testing.assert_allclose(inputs, actuated(lagged, theta, driven_by), rtol=1e-12, atol=1e-12)
