"""Validity of each channel: known inputs, measured outputs, and outputs with their own rates."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.data.masks import longest_run, over_samples, valid_steps
from eoi_jax.data.resampling import own_period, own_segments
from eoi_jax.data.spectrum import spectrum
from eoi_jax.data.windows import driven_parts, start_samples, steps_between_samples

H, N = 0.1, 400
TIME = H * np.arange(N)
Y = np.c_[np.sin(0.5 * TIME), np.cos(0.3 * TIME)]


def record_of(u=None, y=Y, hold="linear", **options):
    u = np.cos(TIME) if u is None else u
    with pytest.warns(eoi.RecordWarning):
        return eoi.Record(TIME[: len(y)], u, y, hold=hold, **options)


def every(step, first=0, y=Y, channel=1):
    """The outputs with all but every so many samples of one channel missing."""
    slow = y.copy()
    slow[np.arange(len(y)) % step != first, channel] = np.nan
    return slow


def test_a_missing_output_leaves_the_other_and_the_inputs_as_they_are():
    y = Y.copy()
    y[50:60, 1] = np.nan
    record = record_of(y=y)
    assert record.input_valid.all()
    np.testing.assert_array_equal(np.flatnonzero(~record.output_valid[:, 1]), np.arange(50, 60))
    assert record.output_valid[:, 0].all()
    np.testing.assert_array_equal(record.valid, record.output_valid[:, 1])


def test_outputs_that_are_never_valid_together_make_a_record():
    y = every(2, 0, every(2, 1, channel=0))
    record = record_of(y=y)
    assert not record.valid.any()
    np.testing.assert_array_equal(record.output_valid.sum(axis=0), [N // 2, N // 2])
    assert record.bridged.valid[1:-1].all()


def test_a_gap_of_a_held_input_is_known_where_it_leaves_no_doubt():
    u = np.repeat([1.0, 2.0], N // 2)
    u[[50, 51, 100, 101, 102, 200]] = np.nan  # two and three samples of one level; at a step
    record = record_of(u, hold="zero")
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), [100, 101, 102, 200])
    assert [part[0] for part in driven_parts(record)] == [0, 103, 201]


@pytest.mark.parametrize("hold", ["linear", "smooth"])
def test_a_single_sample_of_another_input_is_interpolated_and_said(hold):
    u = np.cos(TIME)
    u[[50, 100, 101, 399]] = np.nan
    record = record_of(u, hold=hold)
    np.testing.assert_array_equal(np.flatnonzero(~record.input_valid), [100, 101, 399])
    assert record.inputs[50, 0] == pytest.approx(0.5 * (np.cos(4.9) + np.cos(5.1)))
    assert any("interpolated at 1 single missing sample," in note for note in record.notes)


def test_without_inputs_nothing_is_unknown():
    with pytest.warns(eoi.RecordWarning, match="missing from the uniform grid"):
        record = eoi.Record(np.delete(TIME, range(50, 90)), np.zeros((N - 40, 0)), Y[40:])
    assert record.input_valid.all()
    assert driven_parts(record) == [(0, record)]


@pytest.mark.parametrize("step", [2, 3, 12])
def test_an_output_with_its_own_rate_is_bridged_by_a_spline_through_its_samples(step):
    record = record_of(y=every(step))
    assert any(f"`y2` is measured every {step} samples" in note for note in record.notes)
    np.testing.assert_allclose(record.output_periods, [H, step * H])
    bridged = record.bridged
    last = (N - 1) // step * step
    assert bridged.valid[: last + 1].all()
    np.testing.assert_array_equal(bridged.outputs[::step, 1], Y[::step, 1])
    # The error of a cubic spline, 5/384 h⁴ max|y''''|, and a few times that at its ends.
    error = 5.0 / 384.0 * (0.3 * step * H) ** 4
    assert np.max(np.abs(bridged.outputs[: last + 1, 1] - Y[: last + 1, 1])) < 20.0 * error
    np.testing.assert_array_equal(bridged.outputs[:, 0], Y[:, 0])
    assert bridged.bridged is bridged


def test_a_hole_in_a_slow_output_is_a_gap_of_that_output_alone():
    y = every(4)
    y[100:160, 1] = np.nan
    record = record_of(y=y).bridged
    assert record.output_valid[:, 0].all()
    np.testing.assert_array_equal(np.flatnonzero(~record.output_valid[:397, 1]), range(97, 160))
    assert any("; 1 gap." in note for note in record.notes)


def test_a_record_without_missing_samples_is_its_own_bridged_record():
    record = eoi.Record(TIME, np.cos(TIME), Y)
    assert record.bridged is record
    np.testing.assert_array_equal(record.output_periods, [H, H])


def test_noise_and_quantum_are_those_of_the_samples_of_a_slow_output():
    rng = np.random.default_rng(0)
    noisy = Y + 0.01 * rng.standard_normal(Y.shape)
    noisy[:, 1] = np.round(noisy[:, 1] / 0.05) * 0.05
    record = record_of(y=every(4, y=noisy))
    whole = eoi.Record(TIME[::4], np.cos(TIME[::4]), noisy[::4])
    np.testing.assert_allclose(record.noise[1], whole.noise[1])
    np.testing.assert_allclose(record.quantum[1], 0.05)
    np.testing.assert_array_equal(record.bridged.noise, record.noise)


def test_the_spectrum_of_a_slow_output_ends_at_its_own_nyquist_frequency():
    rng = np.random.default_rng(1)
    noisy = Y + 0.01 * rng.standard_normal(Y.shape)
    slow, whole = record_of(y=every(4, y=noisy)), eoi.Record(TIME, np.cos(TIME), noisy)
    assert spectrum(slow, 1, 1).omega[-1] <= np.pi / (4 * H) < spectrum(whole, 1, 1).omega[-1]
    # A quarter of the samples: four times the density in a quarter of the band.
    levels = [np.median(spectrum(r, 1, 0).noise / len(spectrum(r, 1, 0).omega))
              for r in (slow, whole)]  # fmt: skip
    assert levels[0] * len(spectrum(slow, 1, 0).omega) == pytest.approx(
        4.0 * levels[1] * len(spectrum(whole, 1, 0).omega), rel=0.5
    )


def test_masks_survive_what_is_made_of_a_record():
    y = every(3)
    y[100:110, 0] = np.nan
    u = np.cos(TIME)
    u[200:210] = np.nan
    record = record_of(u, y)
    part = record[90:250]
    np.testing.assert_array_equal(part.input_valid, record.input_valid[90:250])
    np.testing.assert_array_equal(part.output_valid, record.output_valid[90:250])
    first, _ = record.split(0.5)
    np.testing.assert_array_equal(first.output_valid, record.output_valid[:200])
    fine = record.resample(2)
    np.testing.assert_array_equal(fine.output_valid[::2], record.bridged.output_valid)
    np.testing.assert_array_equal(fine.input_valid[::2], record.input_valid)
    smooth = record.smooth(2.0)
    np.testing.assert_array_equal(smooth.output_valid, record.bridged.output_valid)
    assert record.without_inputs().input_valid.all()
    assert record.bridged.hold == "linear"
    assert record.with_hold("smooth").bridged.hold == "smooth"
    back = eoi.record_from_pandas(eoi.record_to_pandas(record), "u", ["y1", "y2"], hold="linear")
    np.testing.assert_array_equal(back.output_valid, record.output_valid)
    np.testing.assert_array_equal(back.input_valid, record.input_valid)


def test_masks_are_saved_and_change_the_hash_only_where_they_differ(tmp_path):
    shared, single = Y.copy(), Y.copy()
    shared[100:110], single[100:110, 0] = np.nan, np.nan
    u = np.cos(TIME)
    u[100:110] = np.nan
    record = record_of(u, single)
    record.save(tmp_path / "record.npz")
    loaded = eoi.load(tmp_path / "record.npz")
    np.testing.assert_array_equal(loaded.output_valid, record.output_valid)
    np.testing.assert_array_equal(loaded.input_valid, record.input_valid)
    assert loaded.data_hash == record.data_hash != record_of(u, shared).data_hash
    assert record_of(y=single).data_hash != record.data_hash


def test_jittered_stamps_keep_the_rate_of_a_slow_output():
    rng = np.random.default_rng(2)
    stamps = TIME + rng.uniform(-0.2 * H, 0.2 * H, N)
    y = np.c_[np.sin(0.5 * stamps), np.cos(0.3 * stamps)]
    with pytest.warns(eoi.RecordWarning, match="`y2` is measured every"):
        record = eoi.Record(stamps, np.cos(stamps), every(4, y=y))
    assert record.output_periods[1] == pytest.approx(4 * H, rel=0.02)
    bridged = record.bridged
    inside = bridged.output_valid[:, 1]
    np.testing.assert_allclose(
        bridged.outputs[inside, 1], np.cos(0.3 * record.time[inside]), atol=1e-4
    )


def test_periods_and_holes_of_a_channel():
    regular = np.arange(0.0, 200.0, 5.0)
    assert own_period(regular) == 5.0
    assert own_segments(regular) == [(0, 40)]
    holed = np.delete(regular, [20, 21])
    assert own_period(holed) == pytest.approx(5.0, rel=0.06)
    assert own_segments(holed) == [(0, 20), (20, 38)]
    assert own_segments(np.delete(regular, [20])) == [(0, 39)]  # a single missing sample
    at_random = np.flatnonzero(np.random.default_rng(0).random(2000) < 0.5).astype(float)
    assert own_period(at_random) == pytest.approx(2.0, rel=0.1)
    assert len(own_segments(at_random)) <= 4


def test_a_step_counts_where_all_that_enters_the_equation_was_measured():
    y = Y.copy()
    y[50:60, 0], y[200, 1] = np.nan, np.nan
    record = record_of(y=y)
    enters = np.array([[True, False], [True, True]])  # the second follows the first
    steps = valid_steps(record, enters)
    np.testing.assert_array_equal(np.flatnonzero(~steps[:, 0]), range(49, 60))
    np.testing.assert_array_equal(np.flatnonzero(~steps[:, 1]), [*range(49, 60), 199, 200])
    np.testing.assert_array_equal(np.flatnonzero(~valid_steps(record)[:, 1]), [199, 200])
    assert longest_run(record, 0) == (60, N)
    np.testing.assert_allclose(
        over_samples(record, lambda values: np.mean(values, axis=0)), np.nanmean(y, axis=0)
    )


def test_the_start_of_a_run_is_long_enough_for_the_slowest_output():
    assert start_samples(eoi.Record(TIME, np.cos(TIME), Y), 2) == 50
    assert start_samples(record_of(y=every(40)), 2) == 120


def test_the_start_of_a_run_has_as_many_samples_on_a_finer_grid():
    """Samples 10 steps of the grid apart: a start of 50 steps would have five of them."""
    times = np.arange(0.0, 40.0, H)
    coarse = eoi.Record(times, np.cos(times), np.sin(times), hold="linear")
    y = np.full((10 * len(times) - 9, 1), np.nan)
    y[::10, 0] = np.sin(times)
    grid = 0.1 * H * np.arange(len(y))
    with pytest.warns(eoi.RecordWarning, match="is measured every 10 samples"):
        fine = eoi.Record(grid, np.cos(grid), y, hold="linear")
    assert steps_between_samples([coarse]) == 1.0
    assert steps_between_samples([fine, coarse]) == 10.0
    assert start_samples(fine, 2) == 10 * start_samples(coarse, 2) == 500


def test_an_output_with_few_samples_is_named():
    with pytest.raises(ValueError, match="at least 8 finite samples of every channel, got 5 of y2"):
        eoi.Record(TIME, np.cos(TIME), every(80))


def test_the_start_of_a_run_ends_where_samples_that_become_rarer_suffice():
    """At 0, 0.25, 0.5, 1, … 24: a start of so many mean distances had nine of the twelve."""
    times = np.array([0, 0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 24])
    record = eoi.Record(times, np.zeros((12, 0)), np.exp(-times))
    head = start_samples(record, 1)
    assert record.time[head] == 3.0  # six of them are before
    plant = eoi.plant_from_text({"y": "-k*y"}, {"k": 1.0}, ["y"])
    result = eoi.validate(plant, record)
    assert result.scored == 6
    assert "6 samples (21.25 s) scored" in str(result)
