"""Inputs that act earlier than they were logged: their channel is late, also by many samples."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.hold import keeps_direction, longest_lead

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
    """Behind u = r - k y, in gusts that no channel shows: inputs to come tell the motion to come."""
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
