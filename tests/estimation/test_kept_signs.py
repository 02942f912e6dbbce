"""A divisor whose true value has the other sign: it passes through infinity, or a note says so."""

import numpy as np
import pytest
from scipy.signal import lfilter

import eoi_jax as eoi

PERIOD, GAIN, LAG = 0.02, -2.4, -0.5  # kV and kA of a motor whose encoder counts backwards


def measured(gain, lag, start, holds):
    """V = kV v + kA dv/dt with held V, solved in closed form."""
    draw = np.random.default_rng(3)
    volts = np.repeat(draw.uniform(-6.0, 6.0, holds), 15)
    decay = np.exp(-gain / lag * PERIOD)
    speed, _ = lfilter([0.0, (1.0 - decay) / gain], [1.0, -decay], volts, zi=[start])
    speed += 5e-3 * draw.standard_normal(len(speed))
    return eoi.Record(PERIOD * np.arange(len(volts)), volts, speed, "run", hold="zero")


@pytest.fixture(scope="module")
def record():
    return measured(GAIN, LAG, 0.0, 60)


def motor(bounds=None, start=0.1):
    return eoi.plant_from_text(
        {"y": "(u - kV*y)/kA"}, {"kV": 1.0, "kA": start}, ["y"], ["u"], bounds=bounds
    )


@pytest.mark.parametrize("verb", [eoi.identify, eoi.refine])
@pytest.mark.parametrize("start", [0.1, 4.0])
def test_a_divisor_without_bounds_gets_to_the_other_sign(verb, start, record):
    fit = verb(motor(start=start), record)
    assert fit.status.code == "converged"
    for name, true in (("kV", GAIN), ("kA", LAG)):
        assert abs(fit.parameters[name] - true) < 4.0 * fit.standard_errors[name] + 1e-3 * abs(true)


@pytest.mark.parametrize(("gain", "lag"), [(2.4, 20.0), (-2.4, -5.0), (2.4, 0.5)])
def test_refinement_gets_to_a_divisor_from_far_off_and_either_sign(gain, lag):
    """Three seconds of a motor that moves at the start: far off, 1/kA is next to nothing."""
    short = measured(gain, lag, 3.0, 10)
    fits = [eoi.refine(motor(start=start), short) for start in (0.1, 4.0, -4.0)]
    for fit in fits:
        assert fit.status.code == "converged"
        assert abs(fit.parameters["kA"] - lag) < 4.0 * fit.standard_errors["kA"]
        assert fit.parameters["kA"] == pytest.approx(fits[0].parameters["kA"], rel=1e-3)


@pytest.mark.parametrize("bounds", [(0.0, None), (0.0, 10.0), (-10.0, 10.0)])
def test_a_note_says_where_bounds_keep_a_divisor_from_its_sign(bounds, record):
    fit = eoi.identify(motor({"kA": bounds}), record)
    assert 0.0 < fit.parameters["kA"] <= 10.0
    (note,) = [note for note in fit.notes if "keep it positive" in note]
    assert "ask for about -0." in note
    assert "check the signs of u, y" in note


def test_refinement_says_so_too(record):
    fit = eoi.refine(motor({"kA": (0.05, 2.0), "kV": (-9.0, 9.0)}), record)
    assert fit.parameters["kA"] > 0.0
    assert any("the bounds of kA keep it positive" in note for note in fit.notes)


def test_nothing_is_said_of_a_divisor_that_is_right_or_only_far_off(record):
    for start, bounds in ((-0.4, (None, 0.0)), (-0.01, (None, -1e-3))):
        fit = eoi.identify(motor({"kA": bounds}, start), record)
        assert fit.parameters["kA"] == pytest.approx(LAG, rel=0.02)
        assert not any("keep it" in note for note in fit.notes)
