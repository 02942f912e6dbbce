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
    (note,) = [note for note in fit.notes if "counted in the other direction" in note]
    assert note.startswith("all parameters (kV, kA)")
    assert note.endswith("check the signs of u, y")
    right = verb(motor(start=start), measured(2.4, 0.5, 0.0, 60))
    assert not any("other direction" in note for note in right.notes)


def test_a_discovery_says_that_all_signs_are_reversed(record):
    found = eoi.discover(motor(), record, validation=0.3, effects=["constant_offset"])
    assert sum("counted in the other direction" in note for note in found.notes) == 1


@pytest.mark.parametrize(("gain", "lag"), [(2.4, 20.0), (-2.4, -5.0), (2.4, 0.5)])
def test_refinement_gets_to_a_divisor_from_far_off_and_either_sign(gain, lag):
    """Three seconds of a motor that moves at the start: far off, 1/kA is next to nothing."""
    short = measured(gain, lag, 3.0, 10)
    fits = [eoi.refine(motor(start=start), short) for start in (0.1, 4.0, -4.0)]
    for fit in fits:
        assert fit.status.code == "converged"
        assert abs(fit.parameters["kA"] - lag) < 4.0 * fit.standard_errors["kA"]
        assert fit.parameters["kA"] == pytest.approx(fits[0].parameters["kA"], rel=1e-3)


@pytest.mark.parametrize("bounds", [(0.0, None), (0.0, 10.0), (-0.1, 10.0)])
def test_a_note_says_where_bounds_keep_a_divisor_from_its_sign(bounds, record):
    fit = eoi.identify(motor({"kA": bounds}), record)
    assert 0.0 < fit.parameters["kA"] <= 10.0
    (note,) = [note for note in fit.notes if "keep it positive" in note]
    assert "ask for about -0." in note
    assert "check the signs of u, y" in note


def test_a_sign_that_the_bounds_admit_is_found(record):
    fit = eoi.identify(motor({"kA": (-10.0, 10.0)}), record)
    assert fit.parameters["kA"] == pytest.approx(LAG, rel=0.02)
    assert not any("keep it" in note for note in fit.notes)


def test_refinement_says_so_too(record):
    fit = eoi.refine(motor({"kA": (0.05, 2.0), "kV": (-9.0, 9.0)}), record)
    assert fit.parameters["kA"] > 0.0
    assert any("the bounds of kA keep it positive" in note for note in fit.notes)


def test_nothing_is_said_of_a_divisor_that_is_right_or_only_far_off(record):
    for start, bounds in ((-0.4, (None, 0.0)), (-0.01, (None, -1e-3))):
        fit = eoi.identify(motor({"kA": bounds}, start), record)
        assert fit.parameters["kA"] == pytest.approx(LAG, rel=0.02)
        assert not any("keep it" in note for note in fit.notes)


def cell(volts=5e-4):
    """A voltage behind two pairs of R and C, 4 s and 150 s, with a held current in closed form."""
    draw = np.random.default_rng(341)
    current = np.repeat(draw.choice([0.0, 0.0, 2.0, 4.0], 12), 300)
    voltage = 3.5 - 0.02 * current
    for resistance, capacity in ((0.012, 350.0), (0.02, 7500.0)):
        decay = np.exp(-1.0 / (resistance * capacity))
        voltage -= lfilter([0.0, resistance * (1.0 - decay)], [1.0, -decay], current)
    voltage += volts * draw.standard_normal(len(current))
    return eoi.Record(np.arange(3600.0), current, voltage, "run", hold="zero")


def test_a_divisor_that_passes_through_infinity_and_comes_back_is_within_its_bounds():
    bounds: dict[str, tuple[float | None, float | None]] = {}
    bounds |= dict.fromkeys(("R0", "R1", "R2"), (0.0, 1.0))
    bounds |= dict.fromkeys(("C1", "C2"), (1.0, 1e6))
    plant = eoi.plant_from_text(
        {"v1": "(I - v1/R1)/C1", "v2": "(I - v2/R2)/C2"},
        {"R0": 0.01, "R1": 0.01, "C1": 1000.0, "R2": 0.01, "C2": 10000.0}, ["V"], ["I"],
        output={"V": "3.5 - R0*I - v1 - v2"}, initial={"v1": 0.0, "v2": 0.0}, bounds=bounds,
    )  # fmt: skip
    fit = eoi.identify(plant, cell())
    true = {"R0": 0.02, "R1": 0.012, "C1": 350.0, "R2": 0.02, "C2": 7500.0}
    assert fit.parameters == pytest.approx(true, rel=0.02)
    assert fit.nominal.parameters == plant.parameters
    assert not any("ran off" in note or "keep it" in note for note in fit.notes)
