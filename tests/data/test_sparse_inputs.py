"""Inputs that are logged only when they change, or seldom."""

import re
import warnings
from typing import Any

import numpy as np
import pytest

import eoi_jax as eoi

H, N = 0.1, 400
TIME = H * np.arange(N)
LEVELS = np.repeat(np.sin(7.0 * np.arange(N // 20)), 20)  # of a valve, changed every 20 samples
SLOPE = np.interp(TIME, TIME[::8], np.cos(TIME[::8]))  # of the weather, logged at every 8th sample
Y = np.cos(0.5 * TIME)
HOLDS = {"valve": "zero", "weather": "linear"}


def seldom(values, step, first=0):
    """The values at every so many samples, and none in between."""
    rows = (np.arange(N) - first) % step == 0
    return np.where(rows, values, np.nan)


def record_of(u, hold, rows: Any = slice(None), time=TIME):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eoi.RecordWarning)
        names = ["valve", "weather"][: np.atleast_2d(u.T).shape[0]]
        return eoi.Record(time[rows], u[rows], Y[rows], input_names=names, hold=hold)


BOTH = np.c_[seldom(LEVELS, 20), seldom(SLOPE, 8)]


def test_inputs_follow_their_declared_hold_between_entries():
    record = record_of(BOTH, HOLDS)
    np.testing.assert_allclose(record.inputs[:393], np.c_[LEVELS, SLOPE][:393], atol=1e-12)
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), np.arange(393, N))
    text = " ".join(record.notes)
    assert "`valve` has 20 values in 400 rows: kept from each to the next" in text
    assert "`weather` has 50 values in 400 rows: linear in between" in text


@pytest.mark.parametrize("stamps", ["regular", "uneven"])
def test_rows_without_a_change_may_be_missing(stamps):
    rows = np.ones(N, bool)
    rows[50:55] = rows[121:124] = False  # up to the entry at 124 of none
    rows[200:260] = False  # the logger was off
    time = TIME + (0.02 * np.sin(3.0 * np.arange(N)) if stamps == "uneven" else 0.0)
    record = record_of(BOTH[:, :1], "zero", rows, time)
    unknown = record.time[~record.input_valid]
    assert 19.9 < unknown.min() < 20.1
    assert 25.8 < unknown.max() < 26.1
    known = record.input_valid & (np.abs(np.rint(record.time / H) % 20 - 10) < 9)
    expected = LEVELS[np.rint(record.time[known] / H).astype(int)]
    np.testing.assert_allclose(record.inputs[known, 0], expected, atol=1e-12)


def test_nothing_is_known_before_the_first_entry_and_in_a_hole_of_a_line():
    weather = seldom(SLOPE, 8, first=5)
    weather[100:250] = np.nan
    record = record_of(weather, "linear")
    unknown = np.flatnonzero(~record.input_valid)
    np.testing.assert_array_equal(unknown, [*range(5), *range(94, 253), *range(398, N)])


def test_an_undeclared_hold_fills_nothing_in_and_a_note_says_what_to_declare():
    record = record_of(BOTH[:, 0], "auto")
    assert record.input_valid.sum() == 20
    text = " ".join(record.notes)
    assert "`valve` has 20 values in 400 rows: unknown in between" in text
    assert "declare its `hold`" in text


def test_inputs_that_are_never_known_together_are_named_with_what_to_declare():
    with pytest.raises(ValueError, match=r"row .* got 0 such rows \(valve has 20, .*`hold`"):
        record_of(np.c_[seldom(LEVELS, 20), seldom(SLOPE, 8, first=1)], "auto")


def test_an_input_that_is_missing_now_and_then_is_not_filled_in():
    valve = LEVELS.copy()
    valve[100:150] = np.nan  # a fault of the logger
    record = record_of(valve, "zero")
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), np.arange(100, 150))


@pytest.mark.filterwarnings("ignore::eoi_jax.RecordWarning")
def test_what_scores_no_sample_advises_to_declare_the_hold_of_a_seldom_input():
    """An input at every 4th sample, an output at others."""
    plant = eoi.plant_from_text(
        {"a": "weather - p*a + b", "b": "q*a - b"}, {"p": 1.0, "q": 1.0}, ["a", "b"], ["weather"]
    )

    def logged(step, name, gain=1.0):
        y = gain * np.c_[Y, np.where(np.arange(N) % 2 == 1, Y, np.nan)]
        names = {"input_names": ("weather",), "output_names": ("a", "b")}
        return eoi.Record(TIME, seldom(SLOPE, step), y, name, **names)

    record = logged(4, "log")
    advice = "In log all inputs are known together at 100 samples alone.*`hold`"
    with pytest.raises(ValueError, match=f"measured at the same time.*{advice}"):
        eoi.identify(plant, record)
    with pytest.raises(ValueError, match=f"must have known inputs.*{advice}"):
        eoi.refine(plant, logged(1, "full", 2.0), validation=record)
    assert re.search(advice, eoi.refine(plant, record).status.message)


def test_an_input_follows_its_hold_in_the_rows_of_other_channels():
    """Five rows of the input for two of the output, and a hole of a second."""
    own = np.arange(N) % 7 < 5
    valve = np.where(own, LEVELS, np.nan)
    valve[200:220] = np.nan
    record = record_of(valve, "zero")
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), np.arange(200, 220))
    held = LEVELS.copy()
    for k in range(1, N):
        held[k] = held[k] if own[k] else held[k - 1]
    known = record.input_valid
    np.testing.assert_array_equal(record.inputs[known, 0], held[known])
    assert f"`valve` has {np.isfinite(valve).sum()} values in 400 rows: kept" in record.notes[0]
    undeclared = " ".join(record_of(valve, "auto").notes)
    assert "unknown in between. Where an input is logged only when it changes, seldom" in undeclared
