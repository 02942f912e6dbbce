"""Inputs that act earlier than they were logged: their channel is late, also by many samples."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.estimation.hold import Skew, keeps_direction, longest_lead

PERIOD = 0.004
TRUTH = {"damping": 4.0, "gain": 8.0}
ROLL = eoi.Plant(
    lambda t, x, u, p: -p.damping * x.y[0] + p.gain * u,
    {"damping": 3.0, "gain": 6.0}, inputs=("command",), outputs=("rate",),
)  # fmt: skip
DECAY = np.exp(-TRUTH["damping"] * PERIOD)
RESPONSE = TRUTH["gain"] * (1.0 - DECAY) / TRUTH["damping"]  # of a sample to a held input


def recorded(command, rate, late: int) -> eoi.Record:
    """With the command in the log by so many samples behind the rate."""
    logged = np.concatenate([np.full(late, command[0]), command[: len(command) - late]])
    time = PERIOD * np.arange(len(command))
    return eoi.Record(time, logged, rate, input_names=("command",), output_names=("rate",))


def flown(late: int, seed: int, samples: int = 1500) -> eoi.Record:
    """A staircase; exact from sample to sample."""
    draw = np.random.default_rng(seed)
    command = np.repeat(draw.uniform(-1.0, 1.0, samples // 60 + 1), 60)[:samples]
    rate = np.zeros(samples)
    for k in range(samples - 1):
        rate[k + 1] = DECAY * rate[k] + RESPONSE * command[k]
    return recorded(command, rate + 0.01 * draw.standard_normal(samples), late)


def controlled(seed: int, samples: int = 1500) -> eoi.Record:
    """Behind u = r - k y in gusts that are not measured: inputs to come tell the motion to come."""
    draw = np.random.default_rng(seed)
    command, rate, gust = np.zeros(samples), np.zeros(samples), 0.0
    for k in range(samples):
        reference = np.sign(np.sin(0.5 * PERIOD * k)) * 0.02
        command[k] = reference - 2.0 * (rate[k] + 0.002 * draw.standard_normal())
        gust = 0.98 * gust + 0.5 * draw.standard_normal()
        if k < samples - 1:
            rate[k + 1] = DECAY * rate[k] + RESPONSE * command[k] + PERIOD * gust
    return recorded(command, rate + 0.002 * draw.standard_normal(samples), 0)


@pytest.mark.parametrize("estimate", [eoi.identify, eoi.refine])
@pytest.mark.parametrize("late", [1, 2, 7])
def test_an_input_that_was_logged_late_is_shifted_and_said_so(estimate, late):
    fit = estimate(ROLL, flown(late, 1))
    (record,) = fit.records
    assert record.hold == "zero"
    assert record.skew / PERIOD == pytest.approx([-late], abs=0.1)
    for name, value in TRUTH.items():
        assert abs(fit.parameters[name] - value) < 4.0 * fit.standard_errors[name]
    notes = getattr(fit, "reasons", ()) or fit.notes
    assert any("command lags behind the outputs by 0.0" in note for note in map(str, notes))


def test_what_was_not_logged_late_stays():
    for estimate in (eoi.identify, eoi.refine):
        assert not np.any(estimate(ROLL, flown(0, 2)).records[0].skew)


@pytest.mark.parametrize("estimate", [eoi.identify, eoi.refine])
def test_inputs_of_a_controller_tell_the_motion_to_come_and_are_not_shifted(estimate):
    record = controlled(3)
    assert np.min(estimate(ROLL, record).records[0].skew) >= -1.5 * PERIOD


def test_a_gain_of_the_other_sign_is_that_of_a_controller():
    record = controlled(3)
    turned = ROLL.with_parameters({"gain": -6.0})
    assert keeps_direction(ROLL, ROLL.with_parameters({"gain": 9.0}), [record], 0)
    assert not keeps_direction(ROLL, turned, [record], 0)


def test_a_lead_is_a_small_part_of_every_record():
    assert longest_lead([flown(0, 1), flown(0, 1, 200)]) == pytest.approx(20 * PERIOD)
    assert longest_lead([flown(0, 1)]) == pytest.approx(64 * PERIOD)


def test_no_effect_stands_in_for_a_channel_that_was_logged_late():
    found = eoi.discover(ROLL, flown(5, 1), validation=flown(5, 2))
    assert found.effects == ()
    assert found.status.code == "nothing_missing"
    assert any("lags behind the outputs by 0.02 s" in str(note) for note in found.notes)


def swung(late: int, seed: int, samples: int = 1500) -> eoi.Record:
    """A mass on a spring with dry friction, driven by sines that were logged late; SciPy."""
    period, draw = 0.01, np.random.default_rng(seed)
    frequency, phase = draw.uniform(1.0, 12.0, 6), draw.uniform(0.0, 6.0, 6)
    time = period * np.arange(samples)

    def force(t):
        return np.sum(np.sin(np.multiply.outer(t, frequency) + phase), axis=-1)

    def rates(t, x):
        friction = 4.0 * np.tanh(x[1] / 1e-3)
        return x[1], -40.0 * x[0] - 1.5 * x[1] + 30.0 * force(t) - friction

    run = solve_ivp(
        rates, (0.0, time[-1]), (0.0, 0.0), t_eval=time, max_step=period, rtol=1e-6, atol=1e-8
    )
    noise = 2e-3 * draw.standard_normal(samples)
    return eoi.Record(time, force(time - late * period), run.y[0] + noise)


def test_a_faster_part_that_does_nearly_as_well_as_a_lead_is_told():
    record, delays = flown(5, 1), np.array([-5 * PERIOD])
    close, far = (Skew("zero", delays, 1.0, 24.0, rival).evidence(record) for rival in (1.7, 50.0))
    assert far.endswith("without this shift the index is 24 times as large")
    assert "24 times as large, and 1.7 times with a response to the rate of the input, or" in close


@pytest.mark.slow
def test_a_missing_effect_and_a_late_channel_are_both_found():
    """The effect moves the lead that the declared model shows: it is looked for again behind it."""
    mass = eoi.Plant(
        lambda t, x, u, p: -p.k * x.y[0] - p.c * x.y[1] + p.g * u[0],
        {"k": 35.0, "c": 1.0, "g": 25.0}, 2,
    )  # fmt: skip
    found = eoi.discover(mass, swung(4, 1), validation=swung(4, 2))
    assert found.effects == ("coulomb_friction",)
    assert found.held_out[0].skew == pytest.approx([-0.04], abs=5e-4)


def test_an_output_on_which_the_input_acts_at_once_shows_a_late_channel_too():
    """Between samples its errors have no slope with the delay: leads are tried one by one."""
    draw = np.random.default_rng(1)
    force = np.repeat(draw.uniform(-1.0, 1.0, 40), 25)
    spring = eoi.plant_from_text(
        {"z": "w", "w": "k*u - c*w - d*z"}, {"k": 1.5, "c": 0.5, "d": 5.0}, ["acceleration"], ["u"],
        output={"acceleration": "k*u - c*w - d*z"}, initial={"z": 0.0, "w": 0.0},
    )  # fmt: skip
    time = 0.02 * np.arange(len(force))
    levels = lambda t: force[min(int(t / 0.02 + 1e-9), len(force) - 1)]  # noqa: E731

    def rates(t, x):
        return x[1], 2.0 * levels(t) - 0.8 * x[1] - 4.0 * x[0]

    run = solve_ivp(
        rates, (0.0, time[-1]), (0.0, 0.0), t_eval=time, max_step=0.02, rtol=1e-8, atol=1e-10
    )
    measured = 2.0 * force - 0.8 * run.y[1] - 4.0 * run.y[0]
    measured = measured + 0.05 * draw.standard_normal(len(force))
    logged = np.concatenate([np.full(3, force[0]), force[:-3]])
    record = eoi.Record(time, logged, measured, output_names=("acceleration",))
    fit = eoi.refine(spring, record)
    assert fit.records[0].skew / 0.02 == pytest.approx([-3.0], abs=0.1)
    assert fit.parameters["k"] == pytest.approx(2.0, rel=0.02)


def heated(seed: int, samples: int = 3600) -> eoi.Record:
    """A winding in iron, of which the model has the winding alone; the log is true."""
    draw = np.random.default_rng(seed)
    current = np.repeat(draw.choice([0.0, 4.0, 6.0, 9.0, 12.0], samples // 300), 300)
    temperature, winding, iron = np.zeros(samples), 22.0, 22.0
    for k in range(samples):
        temperature[k] = winding
        for _ in range(4):
            flow = 2.5 * (winding - iron)
            winding += 0.25 * (0.25 * current[k] ** 2 - flow) / 120.0
            iron += 0.25 * (flow - 1.6 * (iron - 22.0)) / 900.0
    measured = temperature + 0.05 * draw.standard_normal(samples)
    logged = current + 0.02 * draw.standard_normal(samples)
    return eoi.Record(1.0 * np.arange(samples), logged, measured)


WINDING = eoi.Plant(
    lambda t, x, u, p: (0.25 * u[0] ** 2 - p.G * (x.y[0] - 22.0)) / p.C,
    {"G": 1.0, "C": 150.0}, inputs=("current",), outputs=("winding",),
)  # fmt: skip


def test_a_store_that_the_model_lacks_is_no_late_channel():
    """It makes the plant answer before the model does, at the rate of one minute of lead."""
    assert not np.any(eoi.identify(WINDING, heated(1)).records[0].skew)


def shaken(seed: int, samples: int = 2000) -> eoi.Record:
    """x'' = -c (x' - w') - k (x - w) above a moving base, in steady state."""
    draw, time = np.random.default_rng(seed), 0.002 * np.arange(samples)
    omega = 2.0 * np.pi * np.arange(0.6, 14.0, 0.7)
    waves = np.exp(1j * (np.outer(time, omega) + draw.uniform(0.0, 6.0, len(omega)))) / omega
    stiffness = 987.0 + 12.0j * omega
    base, mass = waves.sum(axis=1), (waves * stiffness / (stiffness - omega**2)).sum(axis=1)
    measured = mass.imag + 1e-4 * draw.standard_normal(samples)
    return eoi.Record(time, base.imag, measured, input_names=("w",), output_names=("x",))


def test_a_response_to_the_rate_of_the_input_is_no_late_channel():
    """c x' in place of c (x' - w'): the plant answers by c/k, of six samples, before the model."""
    mount = eoi.plant_from_text(
        {"x": "v", "v": "-c*v - k*(x - w)"}, {"c": 8.0, "k": 800.0}, ["x"], ["w"]
    )
    for estimate in (eoi.identify, eoi.refine):
        assert np.min(estimate(mount, shaken(1)).records[0].skew) >= -1.5 * 0.002
