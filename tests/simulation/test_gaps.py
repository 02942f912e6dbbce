"""Free runs beside what was not measured: nothing is simulated on invented input."""

import numpy as np
import pytest
from two_rates import CHAIN, SIGMA, record_of, signals, without

import eoi_jax as eoi

TIME, FEED, Y = signals()
GAP = slice(500, 540)


@pytest.fixture(scope="module")
def cut():
    """Two records, before and behind the gap."""
    parts = slice(0, GAP.start), slice(GAP.stop, None)
    return [record_of(TIME[part], FEED[part], Y[part], f"part {part.start}") for part in parts]


@pytest.mark.parametrize("window", [None, 10.0])
def test_a_gap_in_the_input_leaves_two_records(cut, window):
    gap = record_of(TIME, without(FEED, GAP), Y)
    result, parts = (eoi.validate(CHAIN, records, window=window) for records in (gap, cut))
    np.testing.assert_allclose(result.rmse, parts.rmse, rtol=1e-12)
    assert result.scored == parts.scored
    (note,) = result.notes
    assert note.startswith("Inputs of run are unknown in gaps")
    assert "2 parts with a start of their own" in note
    prediction = result.predictions[0]
    np.testing.assert_array_equal(np.flatnonzero(~prediction.valid), np.arange(500, 540))


def test_a_part_that_is_too_short_for_a_start_is_not_scored_and_said(cut):
    feed = without(FEED, GAP)
    feed[[580, 581, 582]] = np.nan  # leaves 40 samples between two gaps
    result = eoi.validate(CHAIN, record_of(TIME, feed, Y))
    assert "2 parts with a start of their own; 1 other is not scored" in result.notes[0]
    assert result.scored == sum(eoi.validate(CHAIN, part).scored for part in cut) - 43


def test_a_gap_in_an_output_alone_is_run_through():
    whole, gap = (eoi.validate(CHAIN, record_of(TIME, FEED, y))
                  for y in (Y, without(Y, GAP, 1)))  # fmt: skip
    assert gap.notes == ()
    # The noise of fewer samples differs by a little, and so do the weights of the start.
    predictions = gap.predictions[0].outputs, whole.predictions[0].outputs
    np.testing.assert_allclose(*predictions, atol=0.02 * SIGMA)
    assert gap.rmse[0] == pytest.approx(whole.rmse[0], rel=1e-3)
    error = (gap.predictions[0].outputs - Y)[50:, 1]
    kept = np.r_[0 : GAP.start - 50, GAP.stop - 50 : len(error)]
    assert gap.rmse[1] == pytest.approx(np.sqrt(np.mean(error[kept] ** 2)), rel=1e-12)


@pytest.mark.parametrize(("first", "second"), [((2, 0), (2, 1)), ((1, 0), (12, 0))])
def test_outputs_are_scored_on_their_own_samples(first, second):
    """Also where no sample has both."""
    index, y = np.arange(len(TIME)), Y
    for channel, (step, start) in enumerate((first, second)):
        y = without(y, index % step != start, channel)
    result = eoi.validate(CHAIN, record_of(TIME, FEED, y))
    np.testing.assert_allclose(result.rmse, SIGMA, rtol=0.25)


def test_rare_samples_make_the_start_longer():
    rare = record_of(TIME, FEED, without(Y, np.arange(len(TIME)) % 40 != 0, 1))
    result = eoi.validate(CHAIN, rare)
    assert result.scored == len(TIME) - 80  # two of them
    np.testing.assert_allclose(result.rmse, SIGMA, rtol=0.5)


def test_an_input_that_is_never_known_long_enough_is_named():
    feed = without(FEED, np.arange(len(TIME)) % 60 < 54)
    with pytest.raises(ValueError, match=r"known inputs for more than 6 samples .* got 6 samples"):
        eoi.validate(CHAIN, record_of(TIME, feed, Y))


def test_an_output_without_a_scored_sample_is_named():
    y = without(Y, slice(50, None), 1)
    with pytest.raises(ValueError, match=r"`records.outputs\[b\]` must have a sample that is"):
        eoi.validate(CHAIN, record_of(TIME, FEED, y))


def test_a_figure_does_not_draw_what_was_not_simulated():
    y = without(Y, np.arange(len(TIME)) % 12 != 0, 1)
    result = eoi.validate(CHAIN, record_of(TIME, without(FEED, GAP), y))
    axes = result.plot().get_axes()
    measured, run = axes[0].lines[:2]
    assert np.isfinite(np.asarray(measured.get_ydata(), float)).any()
    assert np.isnan(np.asarray(run.get_ydata(), float)).any()
    assert axes[2].lines[0].get_marker() == "."
