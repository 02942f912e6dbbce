import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import make_interp_spline
from scipy.linalg import expm

from eoi_jax._checks import RecordWarning
from eoi_jax.data.record import Record

N = 400
TIME = 0.01 * np.arange(N)


def sine_record(**options) -> Record:
    return Record(TIME, np.cos(3 * TIME), np.sin(3 * TIME), **options)


# -- what comes in ------------------------------------------------------------------------


def test_a_regular_record_is_taken_as_it_is_and_nothing_is_warned():
    u, y = np.cos(TIME), np.c_[np.sin(TIME), TIME]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = Record(TIME, u, y, "run 1", hold="linear", units={"u": "V", "y2": "m"})
    np.testing.assert_allclose(record.time, TIME, atol=1e-12)
    np.testing.assert_array_equal(record.inputs, u[:, None])
    np.testing.assert_array_equal(record.outputs, y)
    assert record.valid.all()
    assert record.sample_period == 0.01
    assert len(record) == N
    assert record.notes == ()
    assert (record.input_names, record.output_names) == (("u",), ("y1", "y2"))


def test_records_are_frozen_and_leave_the_caller_s_arrays_alone():
    y = np.sin(TIME)
    record = Record(TIME, y, y)
    y[0] = 5.0
    assert record.outputs[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        record.outputs[0] = 1.0
    with pytest.raises(AttributeError):
        record.name = "other"  # type: ignore[misc]


def test_pandas_jax_lists_integers_and_booleans_become_float64():
    frame = pd.DataFrame({"t": TIME, "volt": np.arange(N) % 3, "on": np.arange(N) % 2 == 0})
    record = Record(frame.t, frame[["volt", "on"]], frame.volt.to_numpy().astype("uint8"))
    assert record.input_names == ("volt", "on")
    assert record.output_names == ("y",)
    assert record.inputs.dtype == record.outputs.dtype == np.float64


def test_names_come_from_pandas_and_may_be_given():
    frame = pd.DataFrame({"t": TIME, "volt": TIME, "angle": TIME})
    record = Record(frame.t, frame.volt, frame.angle)
    assert (record.input_names, record.output_names) == (("volt",), ("angle",))
    record = Record(frame.t, frame.volt, frame.angle, input_names=["a"], output_names="b")
    assert (record.input_names, record.output_names) == (("a",), ("b",))
    record = Record(list(TIME), jnp.asarray(TIME), [str(value) for value in TIME])
    np.testing.assert_allclose(record.outputs[:, 0], TIME)


def test_scattered_samples_keep_their_instants_and_inputs_their_hold():
    t = np.array([0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0, 12.0])
    record = Record(t, t**2, np.exp(-t), hold="linear")
    np.testing.assert_allclose(record.time[record.output_valid[:, 0]], t, atol=1e-12)
    np.testing.assert_array_equal(record.outputs[record.output_valid], np.exp(-t))
    np.testing.assert_allclose(record.inputs[:, 0], np.interp(record.time, t, t**2), atol=1e-9)
    assert record.input_valid.all()
    held = Record(t, t**2, np.exp(-t), hold="zero")
    last = np.searchsorted(t, held.time + 1e-6, side="right") - 1
    np.testing.assert_array_equal(held.inputs[:, 0], t[last] ** 2)


def test_a_note_says_what_becomes_of_scattered_stamps_of_too_many_digits():
    t = np.append(600 * np.arange(5), [3600, 3611, 7201, 14402, 28803, 57604, 86400])
    said = "on a grid of 4.32.* s, which has every one of them, moved by up to 2 s"
    with pytest.warns(RecordWarning, match=said):
        Record(t, np.zeros((len(t), 0)), np.exp(-t / 2e4))
    t[6] = 3601
    advice = "No spacing .*, and samples far from others are lost by resampling: round the stamps"
    with pytest.raises(ValueError, match=f"at least 8 valid samples, got 6. {advice}"):
        Record(t, np.zeros((len(t), 0)), np.exp(-t / 2e4))
    t = np.sort(np.append(1300 * np.arange(12), [3901, 28803, 57604, 86400]))
    with pytest.warns(RecordWarning, match=f"resampled from 16 .* {advice}"):
        Record(t, np.zeros((len(t), 0)), np.exp(-t / 2e4))


@pytest.mark.parametrize(
    ("form", "said"), [("M", "28 to 31 d apart.* on a grid of 1 d"), ("Y", "in steps of 86400 s")]
)
def test_values_of_months_and_years_stay_as_they_are(form, said):
    values = np.arange(30) % 2 + 0.1 * np.cos(np.arange(30))
    dates = np.arange("1950", "1990", dtype=f"datetime64[{form}]")[:30].astype("datetime64[D]")
    record = Record(dates, np.zeros((30, 0)), values)
    np.testing.assert_array_equal(record.outputs[record.output_valid], values)
    assert re.search(said, " ".join(record.notes))


def seldom(count):
    """A column with so many entries in its first rows."""
    return np.where(np.arange(N) < count, TIME, np.nan)


@pytest.mark.parametrize(
    ("inputs", "outputs", "said"),
    [
        (TIME, np.c_[TIME, seldom(0)], "`y2` must hold a finite value.* Leave out the records in"),
        (TIME, np.c_[TIME, seldom(4)], "got 4 of y2. .*may be internal states"),
        (seldom(0), TIME, "`u` must hold a finite value.*Write 0 where nothing acted"),
        (seldom(4), TIME, "got 4 of u. .*declare its `hold`"),
    ],
)
def test_channels_with_too_few_samples_are_refused_with_what_to_do(inputs, outputs, said):
    with pytest.raises(ValueError, match=said):
        Record(TIME, inputs, outputs)


def test_replicates_are_refused_with_what_to_do():
    with pytest.raises(ValueError, match="Of replicates at one instant give the means, or each"):
        Record(np.repeat(TIME, 3), np.zeros((3 * N, 0)), np.random.default_rng(0).random(3 * N))


def with_a_hole():
    """Stamps now and then, once nothing for nine hours; the input changes in between."""
    rows = np.random.default_rng(1).random(400) > 0.4
    rows[200:236] = False
    rows[[0, 199, 236, 399]] = True
    t = 900.0 * np.flatnonzero(rows)
    return t, np.where(t < 900.0 * 220, 2.0, 4.0), np.sin(t / 20_000.0)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_an_input_is_unknown_in_a_hole_between_scattered_samples(hold):
    t, u, y = with_a_hole()
    record = Record(t, u, y, hold=hold)
    unknown = (record.time > 199 * 900.0 + 1.0) & (record.time < 236 * 900.0 - 1.0)
    np.testing.assert_array_equal(record.input_valid, ~unknown)
    assert (
        "Inputs are unknown at 33300 s in 1 gap: free runs start again after each." in record.notes
    )
    # Behind a hole with the same values nothing tells that an input has changed.
    assert Record(t, np.full_like(u, 2.0), y, hold=hold).input_valid.all()


@pytest.mark.parametrize("form", [list, pd.DatetimeIndex, pd.Series])
def test_dates_with_a_time_zone_count_through_the_end_of_summer_time(form):
    stamps = pd.date_range("2024-10-26", periods=200, freq="15min", tz="Europe/Berlin")
    stamps = [stamp.to_pydatetime() for stamp in stamps] if form is list else form(stamps)
    values = np.sin(np.arange(200))
    np.testing.assert_allclose(Record(stamps, values, values).time, 900.0 * np.arange(200))


def test_dates_with_and_without_a_time_zone_are_refused():
    stamps = list(pd.date_range("2024-10-26", periods=20, freq="1h"))
    stamps[3] = stamps[3].tz_localize("UTC")
    with pytest.raises(ValueError, match="`time` must have a time zone at each date or at none"):
        Record(stamps, TIME[:20], TIME[:20])


def test_datetimes_count_in_seconds_from_the_first():
    stamps = pd.date_range("2024-05-01 12:00", periods=N, freq="10ms").to_numpy()
    record = Record(stamps, TIME, TIME)
    np.testing.assert_allclose(record.time, TIME, atol=1e-9)


def test_rows_with_the_newest_first_are_turned_round():
    record = Record(TIME, np.sin(TIME), np.cos(TIME))
    turned = Record(TIME[::-1], np.sin(TIME[::-1]), np.cos(TIME[::-1]))
    np.testing.assert_array_equal(turned.time, record.time)
    np.testing.assert_array_equal(turned.inputs, record.inputs)
    np.testing.assert_array_equal(turned.outputs, record.outputs)
    assert any("newest sample comes first" in note for note in turned.notes)


def test_a_system_without_input_has_inputs_of_no_columns():
    record = Record(TIME, np.zeros((N, 0)), np.sin(TIME))
    assert record.inputs.shape == (N, 0)
    assert record.resample(3).inputs.shape == (3 * N - 2, 0)
    assert record.smooth(20).inputs.shape == (N, 0)
    assert record.midpoint_inputs().shape == (N - 1, 0)


def test_samples_that_are_not_finite_are_masked_filled_and_said():
    u, y = np.cos(TIME), np.c_[np.sin(TIME), 2 * TIME]
    u[10], y[20:23, 1], y[-1, 0] = np.inf, np.nan, np.nan
    with pytest.warns(
        RecordWarning, match=r"5 of 400 samples are not finite \(`u` 1, `y1` 1, `y2` 3\)"
    ):
        record = Record(TIME, u, y)
    assert np.flatnonzero(~record.valid).tolist() == [10, 20, 21, 22, N - 1]
    np.testing.assert_allclose(record.outputs[:, 1], 2 * TIME, atol=1e-12)  # lines are kept
    assert record.outputs[21, 0] == np.sin(TIME[21])  # the good channel keeps its value
    assert np.isfinite(record.inputs).all()
    assert len(record) == N
    assert any("masked" in note for note in record.notes)
    assert record.segments() == [(0, 10), (11, 20), (23, N - 1)]


def test_what_a_masked_array_hides_stays_hidden():
    y = np.ma.MaskedArray(np.sin(TIME), mask=np.arange(N) == 7)
    with pytest.warns(RecordWarning, match="1 of 400 samples is not finite"):
        record = Record(TIME, TIME, y)
    assert not record.valid[7]


def test_missing_samples_of_a_regular_clock_are_masked_and_nothing_is_resampled():
    keep = np.delete(np.arange(N), [50, 51, 200])
    y = np.random.default_rng(0).normal(size=N)
    with pytest.warns(RecordWarning, match=r"3 samples \(0.03 s\) of 400 are missing"):
        record = Record(TIME[keep], y[keep], y[keep])
    assert np.flatnonzero(~record.valid).tolist() == [50, 51, 200]
    np.testing.assert_array_equal(record.outputs[record.valid, 0], y[keep])


def test_repeated_stamps_with_equal_values_are_dropped_and_said():
    rows = np.sort(np.r_[np.arange(N), 5, 6, 6])
    y = np.sin(TIME)
    y[6] = np.nan  # two missing values are equal
    with pytest.warns(RecordWarning) as caught:
        record = Record(TIME[rows], TIME[rows], y[rows])
    assert len(record) == N
    assert "were dropped: 3 of 403" in str(caught[0].message)
    assert any("repeat" in note for note in record.notes)


@given(
    seed=st.integers(0, 10_000),
    jitter=st.floats(0.01, 0.2),
    hold=st.sampled_from(["linear", "smooth"]),
)
@settings(max_examples=25, deadline=None, derandomize=True)
def test_jittered_cubics_are_resampled_exactly(seed, jitter, hold):
    rng = np.random.default_rng(seed)
    t = 0.01 * (np.arange(60) + jitter * rng.uniform(-1, 1, 60))
    coefficients = rng.uniform(-1, 1, 4)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        record = Record(t, t, np.polyval(coefficients, t), hold=hold)
    assert any("resampled" in note for note in record.notes)
    expected = np.polyval(coefficients, record.time)
    np.testing.assert_allclose(record.outputs[:, 0], expected, atol=1e-10)
    np.testing.assert_allclose(record.inputs[:, 0], record.time, atol=1e-10)
    np.testing.assert_allclose(np.diff(record.time), record.sample_period, rtol=1e-9)


def test_a_jittered_rig_is_resampled_and_its_gaps_are_masked():
    rng = np.random.default_rng(0)
    spacing = rng.choice([0.007, 0.009, 0.01, 0.01, 0.01, 0.011, 0.014], 3000)
    spacing[1500] = 0.125
    spacing[700] = 0.019  # one late sample is no gap
    t = np.concatenate([[0], np.cumsum(spacing)])
    with pytest.warns(
        RecordWarning, match="0.007 to 0.125 s apart: resampled from 3001 .* 1 gap, "
    ):
        record = Record(t, np.sin(t), np.sin(2 * t))
    assert record.sample_period == 0.01
    inside = (record.time > t[1500] + 1e-5) & (record.time < t[1501] - 1e-5)
    np.testing.assert_array_equal(record.valid, ~inside)
    # Cubic spline at a spacing of up to 19 ms: (2 · 0.019)⁴ · 5/384.
    error = record.outputs[record.valid, 0] - np.sin(2 * record.time[record.valid])
    assert np.max(np.abs(error)) < 5e-8


def test_a_held_input_enters_a_jittered_record_by_its_mean_over_each_step():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(500) + rng.uniform(-2e-3, 2e-3, 500)
    u = np.repeat([0.0, 1.0, -2.0, 5.0, 1.0], 100)
    with pytest.warns(RecordWarning, match="inputs by their hold"):
        record = Record(t, u, np.sin(t))
    assert record.hold == "zero"
    between = ~np.isin(record.inputs, [0.0, 1.0, -2.0, 5.0])
    assert 1 <= np.sum(between) <= 4  # a level lasts a hundred samples, and changes four times
    # What an integrator behind the input would do, at every instant of the grid.
    held = np.append(0.0, np.cumsum(u[:-1] * np.diff(t)))
    after = np.append(0.0, record.sample_period * np.cumsum(record.inputs[:-1, 0]))
    np.testing.assert_allclose(after, np.interp(record.time, t, held), atol=5e-5)


def test_stamps_with_a_jitter_of_the_clock_do_not_move_a_held_input():
    """A grid point just before a stamp is in the step of that stamp, not in the one before."""
    rng = np.random.default_rng(1)
    t = 0.01 * (np.arange(800) + 0.02 * rng.standard_normal(800))
    u = rng.standard_normal(800)
    with pytest.warns(RecordWarning, match="resampled"):
        record = Record(t, u, np.sin(t), hold="zero")
    nearest = np.round(record.time / 0.01).astype(int)
    np.testing.assert_allclose(record.sample_period, 0.01, rtol=1e-5)  # of the clock's mean rate
    apart = record.inputs[:, 0] - u[nearest]
    assert np.sqrt(np.mean(apart**2)) < 0.1  # of the input's rms; a step late would be 1.4


@pytest.mark.parametrize("jitter", [0.02, 0.1, 0.3])
def test_the_noise_of_a_jittered_record_is_that_of_its_samples(jitter):
    """Interpolation takes a third of it at the highest frequencies, and nothing at the others."""
    rng = np.random.default_rng(2)
    t = 0.01 * (np.arange(4000) + jitter * rng.uniform(-1, 1, 4000))
    y = np.sin(t)[:, None] + [0.01, 0.0] * rng.standard_normal((4000, 2))
    y[:, 1] = 0.1 * np.round(y[:, 1] / 0.1)
    with pytest.warns(RecordWarning, match="resampled"):
        record = Record(t, t, y)
    assert record.noise[0] == pytest.approx(0.01, rel=0.05)
    assert record.noise[1] >= 0.0288  # of its steps
    assert record[:1000].noise[0] == record.noise[0]  # of all samples


def test_nan_in_a_jittered_record_masks_the_grid_points_around_it():
    rng = np.random.default_rng(0)
    t = 0.01 * np.arange(200) + rng.uniform(-1e-3, 1e-3, 200)
    y = np.sin(t)
    y[100] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(t, t, y)
    inside = (record.time > t[99] + 1e-5) & (record.time < t[101] - 1e-5)
    np.testing.assert_array_equal(record.valid, ~inside)
    assert 1 <= inside.sum() <= 2


@pytest.mark.parametrize(
    ("u", "hold"),
    [
        (np.repeat(np.arange(40.0), 10), "zero"),
        (np.ones(N), "zero"),
        (np.sin(TIME), "linear"),
        (np.c_[np.ones(N), np.sin(TIME)], "linear"),
    ],
)
def test_the_hold_is_zero_where_every_input_is_a_staircase(u, hold):
    record = Record(TIME, u, np.sin(TIME))
    assert record.hold == hold
    assert record.notes[-1].startswith(f"Hold taken as {hold}: ")
    assert Record(TIME, u, np.sin(TIME), hold="smooth").hold == "smooth"


def test_from_period_counts_from_zero():
    record = Record.from_period(4, np.ones(20), np.arange(20))
    np.testing.assert_array_equal(record.time, 4.0 * np.arange(20))
    assert record.sample_period == 4.0


Y = np.sin(TIME)


def changed(index, value, array=TIME):
    new = np.array(array)
    new[index] = value
    return new


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Record([0.0], [1.0], [1.0]), "`time` must have at least 8 samples, got 1"),
        (lambda: Record([], [], []), "`time` must have at least 8 samples, got 0"),
        (lambda: Record(TIME[:, None], Y, Y), r"`time` must have shape \(N,\), got .*\(400, 1\)"),
        (lambda: Record(changed(5, np.nan), Y, Y), "`time` must be finite, got nan at index 5"),
        (lambda: Record(changed(5, np.inf), Y, Y), "`time` must be finite, got inf at index 5"),
        (lambda: Record(changed(50, 0.1), Y, Y), "`time` .* 0.1 s at index 50 after 0.49 s. Sort"),
        (lambda: Record(changed(5, 0.04), Y, Y), "not repeat .*, got 0.04 s at index 4 and at"),
        (lambda: Record(np.ones(N), Y, Y), "`time` must not be constant, got 1.0 s throughout"),
        (lambda: Record(np.arange(12) // 3, [0] * 12, [1] * 12), "8 different stamps, got 4"),
        (lambda: Record(TIME, Y, np.zeros((N, 1, 1))), r"`outputs` .* \(N,\) or \(N, ny\), got"),
        (lambda: Record(TIME, np.float64(1), Y), r"`inputs` must have shape \(N,\) or \(N, nu\)"),
        (lambda: Record(TIME, Y[:-1], Y), "must be equally long, got 400 stamps, 399 input rows"),
        (lambda: Record(TIME, Y[None], Y), "equally long, .* Samples run along the first axis"),
        (lambda: Record(TIME, [], Y), r"equally long, .* For a system without input write `Re"),
        (lambda: Record(TIME, None, Y), r"`inputs` must be an array, got None. For a system wi"),
        (lambda: Record(TIME, Y), r"`outputs` must be .* None. Inputs come before outputs. For"),
        (lambda: Record(TIME, Y, np.zeros((N, 0))), "`outputs` must have at least one channel"),
        (lambda: Record(TIME, Y, np.full(N, np.nan)), "`y` must hold a finite value, got NaN"),
        (lambda: Record(TIME, Y, np.where(TIME < 0.045, Y, np.nan)), "every channel, got 5"),
        (lambda: Record(TIME, ["a"] * N, Y), "`inputs` must hold numbers only, got .*'a'"),
        (lambda: Record(TIME, Y, Y * 1j), "`outputs` must be real numbers, got dtype complex128"),
        (lambda: sine_record(hold="foh"), "`hold` must be one of auto, zero, .*, got 'foh'"),
        (lambda: sine_record(burn_in=-1), "`burn_in` must be a time ≥ 0 in seconds, got -1"),
        (lambda: sine_record(input_names=["a", "b"]), "`input_names` must name 1 channel, got"),
        (lambda: sine_record(output_names=["u"]), "output_names` must differ, got u, u"),
        (lambda: sine_record(units={"volt": "V"}), "`units` must be one of time, u, y, got 'volt'"),
        (lambda: Record.from_period(-1, Y, Y), "`sample_period` must be positive .*got -1"),
        (lambda: Record.from_period(np.nan, Y, Y), "`sample_period` must be positive and finite"),
        (lambda: sine_record()[5], r"`record\[…\]` must be sliced, got 5"),
        (lambda: sine_record()[::2], r"`record\[…\]` must be sliced without a step, got 2"),
        (lambda: sine_record()[5:5], r"at least 8 valid samples, got 0 in \[5:5\] of 400"),
        (lambda: sine_record().split(1.0), r"`fraction` must lie in \(0, 1\), got 1.0"),
        (lambda: sine_record().split(0.001), "must keep at least 8 valid samples"),
        (lambda: sine_record().resample(0), "`substeps` must be an integer ≥ 1, got 0"),
        (lambda: sine_record().smooth(400), r"`cutoff` must lie in \(0, 314.159\) rad/s"),
        (lambda: sine_record().smooth(np.nan), "`cutoff` must lie in"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_with_its_rule_and_value(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def in_bursts(count: int) -> np.ndarray:
    """Eight samples every 2 ms, then a pause of 7 ms, as of a logger that writes."""
    return np.cumsum(np.tile([2, 2, 2, 2, 2, 2, 2, 7], count)) / 1e3


def by_turns(count: int) -> np.ndarray:
    """Samples 10 and 30 ms apart by turns: two tasks that read one sensor."""
    return np.cumsum(np.tile([10, 30], count)) / 1e3


@pytest.mark.parametrize("stamps", [in_bursts(20), by_turns(80)])
def test_where_a_tenth_of_the_spacings_would_be_gaps_there_are_none(stamps):
    """No sample is moved, no input is unknown, and a part is taken as the whole is."""
    y = np.cos(5.0 * stamps)
    record = Record(stamps, np.sin(stamps), y, hold="linear")
    assert record.input_segments() == [(0, len(record))]
    np.testing.assert_allclose(record.time[record.output_valid[:, 0]], stamps, atol=1e-9)
    np.testing.assert_array_equal(record.outputs[record.output_valid], y)
    part = Record(stamps[40:100], np.sin(stamps[40:100]), y[40:100], hold="linear")
    assert part.sample_period == pytest.approx(record.sample_period)
    assert len(part.input_segments()) == 1


def test_a_clock_whose_samples_never_touch_the_grid_is_an_error():
    # Bursts of two samples: every third spacing is a gap, and few grid points are covered. A grid
    # that has every sample would need a step of a part of the smallest spacing.
    spacing = np.tile([0.9, 1.0, 3.333], 4) + 1e-2 * np.sqrt(np.arange(12))
    spacing[4] = 1e-3
    t = np.cumsum(spacing)
    with pytest.raises(ValueError, match="`outputs` must have at least 8 valid samples, got "):
        Record(t, t, t)


# -- parts --------------------------------------------------------------------------------


@given(a=st.integers(0, N - 8), length=st.integers(8, N), b=st.integers(0, N))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_slices_are_those_samples(a, length, b):
    record = sine_record(name="run", units={"u": "V"}, hold="linear", burn_in=1.0)
    part = record[a : a + length]
    np.testing.assert_array_equal(part.time, record.time[a : a + length])
    np.testing.assert_array_equal(part.outputs, record.outputs[a : a + length])
    assert (part.name, part.units, part.hold) == ("run", {"u": "V"}, "linear")
    assert part.sample_period == record.sample_period
    assert part.burn_in == pytest.approx(max(1.0 - 0.01 * a, 0.0))
    if length < N and 8 <= b <= len(part) - 8:
        np.testing.assert_array_equal(part[b:].time, record.time[a + b : a + length])


@given(fraction=st.floats(0.03, 0.97))
@settings(max_examples=20, deadline=None, derandomize=True)
def test_splitting_loses_no_sample(fraction):
    record = sine_record()
    first, second = record.split(fraction)
    assert len(first) == round(fraction * N)
    np.testing.assert_array_equal(np.concatenate([first.time, second.time]), record.time)
    np.testing.assert_array_equal(np.concatenate([first.inputs, second.inputs]), record.inputs)


def test_negative_and_open_slices_work_as_for_lists():
    record = sine_record()
    assert len(record[-100:]) == 100
    assert len(record[:-100]) == N - 100
    assert len(record[300:10_000]) == 100


# -- between the samples ------------------------------------------------------------------


def test_substeps_keep_the_samples_and_follow_the_signal():
    record = sine_record(hold="smooth", burn_in=0.5)
    fine = record.resample(5)
    assert fine.sample_period == pytest.approx(0.002)
    assert len(fine) == 5 * (N - 1) + 1
    assert fine.burn_in == 0.5
    np.testing.assert_allclose(fine.outputs[::5], record.outputs, atol=1e-12)
    # Quintic not-a-knot: (ωh)⁶ = 7e-10 times a constant that is largest at the ends.
    np.testing.assert_allclose(fine.outputs[:, 0], np.sin(3 * fine.time), atol=1e-10)
    np.testing.assert_allclose(fine.inputs[:, 0], np.cos(3 * fine.time), atol=1e-10)
    assert "Sub-stepped by 5" in fine.notes[-1]
    assert record.resample(1) is record


def test_substeps_hold_or_interpolate_the_input():
    record = Record(TIME, TIME, TIME, hold="zero").resample(2)
    np.testing.assert_array_equal(record.inputs[1::2], record.inputs[:-1:2])
    record = Record(TIME, TIME, TIME, hold="linear").resample(2)
    np.testing.assert_allclose(record.inputs[:, 0], record.time, atol=1e-12)


def test_substeps_are_valid_between_valid_samples_only():
    y = np.sin(TIME)
    y[100] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(TIME, TIME, y)
    fine = record.resample(4)
    assert np.flatnonzero(~fine.valid).tolist() == list(range(397, 404))


@pytest.mark.parametrize("hold", ["zero", "linear", "smooth"])
def test_midpoint_inputs_follow_the_hold(hold):
    record = sine_record(hold=hold)
    u, middle = record.inputs, record.midpoint_inputs()
    assert middle.shape == (N - 1, 1)
    exact = np.cos(3 * (TIME[:-1] + 0.005))[:, None]
    expected = {"zero": u[:-1], "linear": 0.5 * (u[1:] + u[:-1]), "smooth": exact}[hold]
    np.testing.assert_allclose(middle, expected, atol=1e-10)


def held_oscillator(h: float, count: int) -> tuple[Record, float, float]:
    """ÿ + d ẏ + k y = u under a held binary input, solved exactly."""
    d, k = 3.0, 225.0
    u = np.random.default_rng(0).choice([-1.0, 1.0], count // 5).repeat(5)
    step = expm(h * np.array([[0, 1, 0], [-k, -d, 1], [0, 0, 0]]))
    x, y = np.zeros(2), np.zeros(count)
    for i in range(count):
        y[i] = x[0]
        x = step[:2, :2] @ x + step[:2, 2] * u[i]
    return Record.from_period(h, u, y), d, k


def test_other_outputs_keep_instants_and_inputs_and_forget_noise_and_notes():
    record = sine_record(name="run", burn_in=0.1).smooth(20.0)
    new = record.with_outputs(np.zeros((N, 1)), "prediction")
    assert (new.name, new.notes, new.burn_in, new.hold) == ("prediction", (), 0.1, "smooth")
    np.testing.assert_array_equal(new.inputs, record.inputs)
    np.testing.assert_array_equal(new.time, record.time)
    assert new.valid.all()
    assert new.noise == 0.0
    assert np.all(record.noise > 0.0)


def test_other_outputs_that_are_not_finite_are_masked_as_in_a_new_record():
    record = sine_record(name="run")
    y = np.array(record.outputs)
    y[50], y[60:63] = np.inf, np.nan
    note = f"4 of {N} samples are not finite (`y` 4): masked."
    with pytest.warns(RecordWarning, match=re.escape(f"Record `holes`: {note}")):
        new = record.with_outputs(y, "holes")
    with pytest.warns(RecordWarning):
        made = Record(record.time, record.inputs, y, mask_faults=False, hold=record.hold)
    assert new.notes == (note,)
    np.testing.assert_array_equal(new.outputs, made.outputs)
    np.testing.assert_array_equal(new.output_valid, made.output_valid)
    np.testing.assert_array_equal(new.valid, made.valid)
    assert new.data_hash == made.data_hash
    with pytest.raises(ValueError, match="`y` must hold a finite value, got NaN or infinity thr"):
        record.with_outputs(np.nan * y, "none")
    y[7:] = np.nan
    rule = "`outputs` must have at least 8 finite samples of every channel, got 7 of y"
    with pytest.raises(ValueError, match=rule):
        record.with_outputs(y, "few")


def test_smoothing_the_outputs_alone_gives_the_same_outputs_and_noise():
    record = sine_record()
    alone, both = record.without_inputs().smooth(20.0), record.smooth(20.0)
    assert alone.inputs.shape == (N, 0)
    np.testing.assert_array_equal(alone.resample(3).outputs, both.resample(3).outputs)
    np.testing.assert_array_equal(alone.noise, both.noise)


def test_smoothing_leaves_the_plant_between_input_and_output_unchanged():
    record, d, k = held_oscillator(0.01, 3000)
    assert record.hold == "zero"
    smooth = record.smooth(40)
    assert smooth.hold == "smooth"
    y = make_interp_spline(smooth.time, smooth.outputs[:, 0], k=5)
    seen = y(smooth.time, 2) + d * y(smooth.time, 1) + k * y(smooth.time)
    middle = slice(200, -200)  # the filter's ends
    error = np.std((seen - smooth.inputs[:, 0])[middle]) / np.std(seen[middle])
    # The levels themselves, half a sample off, would be 0.1 away, the neighbours' mean 0.005.
    assert error < 1e-4


def test_inputs_that_are_not_smoothed_stay_as_they_are_with_their_hold():
    u = np.sign(np.c_[np.sin(TIME), np.cos(TIME)])
    record = Record(TIME, u, np.sin(TIME), input_names=["valve", "fan"], hold="zero")
    smooth, whole = record.smooth(20.0, ["fan"]), record.smooth(20.0)
    assert smooth.holds == ("zero", "smooth")
    np.testing.assert_array_equal(smooth.inputs[:, 0], u[:, 0])
    np.testing.assert_array_equal(smooth.inputs[:, 1], whole.inputs[:, 1])
    np.testing.assert_array_equal(smooth.outputs, whole.outputs)
    assert smooth.notes[-1].startswith("Outputs, fan smoothed by the same zero-phase low-pass")
    assert record.smooth(20.0, []).notes[-1].startswith("Outputs smoothed")
    told = "held inputs are smooth behind it"
    assert told in smooth.notes[-1]
    assert told not in record.smooth(20.0, []).notes[-1]
    assert smooth.logged_hold == "zero"
    with pytest.raises(ValueError, match="`inputs` must be one of valve, fan"):
        record.smooth(20.0, ["pump"])


def test_smoothing_does_not_mix_segments():
    y = np.where(TIME < 2, 0.0, 1.0)
    y[200] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(TIME, TIME, y)
    smooth = record.smooth(10)
    np.testing.assert_allclose(smooth.outputs[:200, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(smooth.outputs[201:, 0], 1.0, atol=1e-12)
    assert smooth.outputs[200, 0] == pytest.approx(0.5)
    assert not smooth.valid[200]
    assert "smoothed" in smooth.notes[-1]


# -- what it shows ------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [1e-4, 1e-2, 1.0])
def test_noise_is_estimated_under_a_sampled_sine(sigma):
    t = 0.01 * np.arange(20_000)
    rng = np.random.default_rng(1)
    record = Record(t, t, np.sin(3 * t) + sigma * rng.normal(size=t.size))
    # An eighth difference of N samples has a relative standard deviation of about 1.7/√N;
    # the least of seven estimates lies below their mean.
    assert record.noise[0] == pytest.approx(sigma, rel=0.04)


def test_noise_of_a_noise_free_sine_is_rounding():
    assert sine_record().noise[0] < 1e-9


def test_noise_does_not_see_the_jump_across_a_gap():
    y = np.where(TIME < 2, 0.0, 1e3) + 1e-3 * np.random.default_rng(0).normal(size=N)
    y[200] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(TIME, TIME, y)
    assert record.noise[0] == pytest.approx(1e-3, rel=0.2)


def test_noise_is_remembered_through_substeps_and_reduced_by_smoothing():
    t = 0.01 * np.arange(20_000)
    noise = 1e-3 * np.random.default_rng(1).normal(size=t.size)
    record = Record(t, t, 0.1 * t + noise)
    assert record.resample(3).noise[0] == record.noise[0]
    smooth = record.smooth(30)
    left = np.std(smooth.outputs[500:-500, 0] - 0.1 * t[500:-500])
    # The filter leaves about 2000 independent samples: 1.6 %, and as much from the estimate.
    assert smooth.noise[0] == pytest.approx(left, rel=0.06)


def test_what_smoothed_a_record_goes_along_with_it():
    smooth = sine_record().smooth(40).smooth(20.0)
    assert sine_record().smoothed == ()
    parts = (smooth[10:], smooth.split(0.5)[1], smooth.resample(2), smooth.without_inputs())
    assert [one.smoothed for one in (smooth, *parts)] == [(40.0, 20.0)] * 5
    assert smooth.with_outputs(smooth.outputs, "simulated").smoothed == ()


def test_smoothing_twice_leaves_the_noise_that_both_filters_let_through():
    """Where the second one is wide it takes next to nothing: not its share of white noise."""
    t = 0.01 * np.arange(20_000)
    noise = 1e-3 * np.random.default_rng(1).normal(size=t.size)
    smooth = Record(t, t, 0.1 * t + noise).smooth(30).smooth(60)
    left = np.std(smooth.outputs[500:-500, 0] - 0.1 * t[500:-500])
    assert smooth.noise[0] == pytest.approx(left, rel=0.06)  # as of one filter, above
    assert smooth.noise[0] / smooth.noise_left == pytest.approx(1e-3, rel=0.04)


def test_the_quantum_of_a_quantised_signal_is_found():
    step = 2 * np.pi / 2048
    y = np.c_[np.round(np.sin(TIME) / step) * step, np.sin(TIME), np.ones(N)]
    record = Record(TIME, TIME, y)
    np.testing.assert_allclose(record.quantum, [step, 0.0, 0.0], rtol=1e-9)
    np.testing.assert_allclose(record.resample(2).quantum, record.quantum)
    assert np.all(record.smooth(20).quantum == 0)


def test_a_slice_has_its_own_noise_whether_or_not_that_of_the_whole_was_asked_for():
    t = 1e-3 * np.arange(4000)
    noise = np.where(t < 2.0, 1e-3, 1e-5) * np.random.default_rng(1).normal(size=t.size)
    asked, fresh = Record(t, t, 0.1 * t + noise), Record(t, t, 0.1 * t + noise)
    assert asked.noise[0] == pytest.approx(7e-4, rel=0.1)
    assert asked.quantum[0] == 0.0
    assert asked[2000:].noise[0] == fresh[2000:].noise[0] == pytest.approx(1e-5, rel=0.1)


def test_quantised_noise_is_a_twelfth_of_the_step_squared_when_the_signal_moves():
    t = 0.001 * np.arange(20_000)
    y = np.round(np.sin(20 * t) / 1e-3) * 1e-3  # twenty steps a sample
    record = Record(t, t, y)
    assert record.noise[0] == pytest.approx(1e-3 / np.sqrt(12), rel=0.1)
    assert record.quantum[0] == pytest.approx(1e-3)


def test_the_hash_follows_the_data_and_nothing_else():
    record = sine_record()
    assert record.data_hash == sine_record(name="other").data_hash
    assert len(record.data_hash) == 16
    other = Record(TIME, np.cos(3 * TIME), changed(3, 1e-9, np.sin(3 * TIME)))
    assert other.data_hash != record.data_hash
    assert record[:-1].data_hash != record.data_hash


def test_the_hash_of_the_content_follows_how_the_samples_are_read_too():
    """Each of these is another estimate from the same values."""
    record = sine_record(hold="zero")
    assert record.content_hash == sine_record(name="other", hold="zero").content_hash
    fine = sine_record(hold="smooth").resample(2)
    others = (
        sine_record(hold="linear"),
        sine_record(hold="zero", burn_in=0.5),
        fine,
        Record(
            fine.time, fine.inputs, fine.outputs, hold="smooth"
        ),  # middles and noise are its own
    )
    assert len({one.content_hash for one in (record, *others)}) == 5
    assert others[0].data_hash == others[1].data_hash == record.data_hash
    assert others[2].data_hash == others[3].data_hash


def test_a_record_prints_its_channels_and_notes():
    shown = str(sine_record(name="run 1", units={"y": "rad"}, burn_in=0.5))
    assert "Record `run 1`: 400 samples, 4 s, every 0.01 s (100 Hz)" in shown
    assert "y [rad]" in shown
    assert "burn-in 0.5 s" in shown
    assert "Hold taken as linear" in shown


def test_a_record_plots_each_channel_and_leaves_its_masked_samples_out():
    y = np.c_[np.sin(TIME), np.cos(TIME)]
    y[7, 0] = np.nan
    with pytest.warns(RecordWarning):
        record = Record(TIME, np.ones(N), y, units={"y2": "m"})
    axes = record.plot().get_axes()
    assert [axis.get_ylabel() for axis in axes] == ["y1", "y2 [m]", "u"]
    assert np.isnan(axes[0].lines[0].get_ydata()[7])
    assert not np.any(np.isnan(axes[1].lines[0].get_ydata()))  # y2 was measured throughout


def test_a_warning_stands_at_the_line_that_made_the_record():
    y = np.sin(np.arange(50.0))
    y[7] = np.nan
    with pytest.warns(RecordWarning) as caught:
        Record.from_period(0.1, np.zeros(50), y)
    assert {warning.filename for warning in caught} == {__file__}


def test_a_record_of_traced_numbers_says_what_takes_them():
    time = 0.01 * np.arange(50)
    message = r"`Record` must get numbers, got numbers that JAX traces\. .* use `observe` or `roll"
    with pytest.raises(ValueError, match=message):
        jax.jit(lambda y: Record(time, time, y).outputs)(jnp.asarray(time))
