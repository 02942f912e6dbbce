"""Refinement beside what was not measured."""

import numpy as np
import pytest
from two_rates import CHAIN, START, TRUE, record_of, signals, without

import eoi_jax as eoi
from eoi_jax.effects import ActuatorLag
from eoi_jax.models.augmented import augmented, place

TIME, FEED, Y = signals()
GAP = slice(500, 540)


@pytest.fixture(scope="module")
def whole():
    return eoi.refine(START, record_of(TIME, FEED, Y))


@pytest.mark.slow
@pytest.mark.parametrize("window", [None, 10.0])
def test_a_gap_in_the_input_leaves_two_records(window):
    gap = record_of(TIME, without(FEED, GAP), Y)
    parts = slice(0, GAP.start), slice(GAP.stop, None)
    cut = [record_of(TIME[part], FEED[part], Y[part], f"part {part.start}") for part in parts]
    result, expected = (eoi.refine(START, records, window=window) for records in (gap, cut))
    for name in TRUE:
        assert result.parameters[name] == pytest.approx(expected.parameters[name], rel=1e-9)
    np.testing.assert_allclose(result.rmse, expected.rmse, rtol=1e-9)
    assert len(result.starts) == len(expected.starts)
    np.testing.assert_array_equal(np.isnan(result.residual[0][GAP]), True)
    assert any("Inputs of run are unknown in gaps" in note for note in result.notes)


def test_half_of_the_samples_are_half_of_the_information(whole):
    """k2 is seen in b alone: with half of its samples its standard error grows by √2."""
    missing = np.random.default_rng(1).random(len(TIME)) < 0.5
    half = eoi.refine(START, record_of(TIME, FEED, without(Y, missing, 1)))
    ratio = half.standard_errors["k2"] / whole.standard_errors["k2"]
    # Both are estimates, from some ten cosines each.
    assert ratio == pytest.approx(np.sqrt(2.0), rel=0.35)
    information = [np.diagonal(np.asarray(result.information))[1] for result in (half, whole)]
    scaled = [size * result.rmse[1] ** 2 / whole.rmse[1] ** 2
              for size, result in zip(information, (half, whole), strict=True)]  # fmt: skip
    assert scaled[0] / scaled[1] == pytest.approx(0.5, rel=0.1)
    for name, value in TRUE.items():
        assert abs(half.parameters[name] - value) < 4.0 * half.standard_errors[name]


def test_outputs_that_are_never_measured_together_are_fitted_on_their_own_samples(whole):
    index, y = np.arange(len(TIME)), Y
    y = without(without(y, index % 2 != 0, 0), index % 2 != 1, 1)
    result = eoi.refine(START, record_of(TIME, FEED, y))
    scored = ~np.isnan(result.residual[0])
    np.testing.assert_array_equal(scored, ~np.isnan(y))
    for name in TRUE:
        difference = result.parameters[name] - whole.parameters[name]
        assert abs(difference) < 4.0 * result.standard_errors[name]


def test_an_output_without_a_scored_sample_is_named():
    names = {"input_names": ["feed"], "output_names": ["a", "b"], "hold": "zero"}
    y = without(Y, slice(20, None), 1)
    with pytest.warns(eoi.RecordWarning):
        late = eoi.Record(TIME, FEED, y, "late", burn_in=2.0, **names)
    with pytest.raises(ValueError, match=r"`records.outputs\[b\]` must have a sample behind"):
        eoi.refine(CHAIN, late)


@pytest.mark.slow
def test_a_lag_of_the_input_begins_again_behind_a_gap():
    """What was on its way when the input was lost is unknown, as at the start of a record."""
    lagged = augmented(CHAIN, [place(CHAIN, ActuatorLag(), 0)], {"actuator_lag": 0.3})
    gap = record_of(TIME, without(FEED, GAP), Y)
    parts = slice(0, GAP.start), slice(GAP.stop, None)
    cut = [record_of(TIME[part], FEED[part], Y[part], f"part {part.start}") for part in parts]
    errors = [eoi.validate(lagged, records).rmse for records in (gap, cut)]
    np.testing.assert_allclose(*errors, rtol=1e-12)
    result, expected = (eoi.refine(lagged, records) for records in (gap, cut))
    np.testing.assert_allclose(result.plant.theta, expected.plant.theta, rtol=1e-7)
