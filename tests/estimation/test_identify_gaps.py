"""Passes beside what was not measured: outputs at their own rates, gaps of single channels."""

import numpy as np
import pytest
from two_rates import CHAIN, SIGMA, START, TRUE, H, record_of, signals, without

import eoi_jax as eoi
from eoi_jax.estimation.defaults import default_lowpass
from eoi_jax.estimation.preparation import entering, prepare_steps, step_inputs
from eoi_jax.models.jacobians import entering_outputs

TIME, FEED, Y = signals()
INDEX = np.arange(len(TIME))
OPTIONS = {"taps": 1, "transient": 1.0, "memory": 1.0, "explicit": False, "taper": 0.0}


def steps_of(plant, record):
    noise = [np.zeros(len(plant.outputs))]
    return prepare_steps(plant, [record], [step_inputs(record, False)], velocity_noise=noise,
                         **OPTIONS)  # fmt: skip


@pytest.mark.parametrize("step", [2, 4, 12])
def test_an_output_with_its_own_rate_is_estimated_from(step):
    record = record_of(TIME, FEED, without(Y, INDEX % step != 0, 1))
    result = eoi.identify(START, record)
    assert result.status.ok
    for name, value in TRUE.items():
        assert result.parameters[name] == pytest.approx(value, rel=0.05)
    assert any(f"`b` is measured every {step} samples" in note for note in result.notes)


def test_irregular_multiples_are_estimated_from():
    rng = np.random.default_rng(0)
    kept = np.cumsum(rng.integers(2, 5, len(TIME)))
    missing = ~np.isin(INDEX, kept)
    result = eoi.identify(START, record_of(TIME, FEED, without(Y, missing, 1)))
    for name, value in TRUE.items():
        assert result.parameters[name] == pytest.approx(value, rel=0.05)


def test_the_cut_off_keeps_to_the_band_of_the_slowest_output():
    record = record_of(TIME, FEED, without(Y, INDEX % 40 != 0, 1)).bridged
    lowpass, reason = default_lowpass(CHAIN, [record])
    assert lowpass.cutoff == pytest.approx(0.2 * np.pi / (40 * H))
    assert reason.endswith("a tenth of the sampling rate of the slowest output")


def test_what_enters_an_equation_is_felt_by_its_absence():
    u = FEED[:-1, None]
    enters = entering_outputs(CHAIN, TIME[:-1], Y[:-1], u)
    np.testing.assert_array_equal(enters, [[True, False], [True, True]])
    assert entering(CHAIN, [record_of(TIME, FEED, Y)], [u]) is None  # all are valid alike


def test_a_gap_of_an_output_is_out_where_it_enters():
    first, second = (steps_of(CHAIN, record_of(TIME, FEED, without(Y, slice(600, 640), channel)))
                     for channel in (0, 1))  # fmt: skip
    gap = slice(600, 639)
    np.testing.assert_array_equal(np.any(first.use[0, gap] > 0, axis=0), [False, False])
    np.testing.assert_array_equal(np.all(second.use[0, gap] > 0, axis=0), [True, False])


def test_internal_states_behind_a_gap_of_the_input_are_a_guess_for_the_transient():
    lagged = eoi.plant_from_text(
        {"y": "z - k*y", "z": "u - z"}, {"k": 0.5}, ["y"], ["u"], initial={"z": 0.0}
    )
    u = without(FEED, slice(600, 640))
    with pytest.warns(eoi.RecordWarning):
        record = eoi.Record(TIME, u, Y[:, 0], hold="zero", input_names=["u"], output_names=["y"])
    scored = steps_of(lagged, record).score[0, :, 0] > 0
    transient = round(OPTIONS["transient"] / H)
    assert not scored[599 : 640 + transient].any()
    assert scored[640 + transient :].all()


def test_equations_without_a_common_sample_are_named():
    y = without(without(Y, slice(0, 700), 0), slice(600, None), 1)
    with pytest.raises(ValueError, match=r"`records.outputs\[b\]` must be measured at the same"):
        eoi.identify(START, record_of(TIME, FEED, y))


def test_half_of_the_samples_are_half_of_the_information():
    """The power of the noise in the index says it: no weight is needed beside 1/P."""
    noisy = Y + 10.0 * SIGMA * np.random.default_rng(5).standard_normal(Y.shape)
    slow, whole = (eoi.identify(CHAIN, record_of(TIME, FEED, y), lowpass=eoi.LowPass(2.0, 2))
                   for y in (without(noisy, INDEX % 4 != 0, 1), noisy))  # fmt: skip
    # A quarter of the samples: four times the density of the noise, less what the spline takes off.
    assert slow.index[-1, 1] / whole.index[-1, 1] == pytest.approx(4.0, rel=0.3)
    ratio = slow.standard_errors["k2"] / whole.standard_errors["k2"]
    assert ratio == pytest.approx(2.0, rel=0.4)  # each from some ten cosines
    for name, value in TRUE.items():
        assert abs(slow.parameters[name] - value) < 4.0 * slow.standard_errors[name]


def test_nothing_is_missing_at_two_rates():
    time, feed, y = signals(seed=1)
    records = [record_of(TIME, FEED, without(Y, INDEX % 12 != 0, 1), "run"),
               record_of(time, feed, without(y, INDEX % 12 != 0, 1), "test")]  # fmt: skip
    found = eoi.discover(START, records[0], records[1])
    assert found.status.code == "nothing_missing"
    assert found.after is not None
    np.testing.assert_allclose(found.after.rmse, SIGMA, rtol=0.3)
