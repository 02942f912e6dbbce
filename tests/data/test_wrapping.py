"""Counters and angles that start again at the end of their range: found, and unwrapped."""

import re
from typing import Any

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax._checks import RecordWarning
from eoi_jax.data.inspection import inspect
from eoi_jax.data.wrapped_outputs import wrapped_notes
from eoi_jax.data.wrapping import course, wrapping

N, H = 4000, 0.01
TIME = H * np.arange(N)
RNG = np.random.default_rng(0)
TURN = 2 * np.pi
# Back and forth over several turns [rad].
ANGLE = np.cumsum(0.1 * np.sin(0.3 * TIME) + 0.05 * np.sin(1.1 * TIME) + 0.03)
COUNTS = np.floor(ANGLE * 4096 / TURN)
# It hovers about north, and noise takes it across [deg].
HEADING = np.round((3 * np.sin(0.2 * TIME) + 0.4 * RNG.standard_normal(N)) % 360, 1) % 360
SQUARE = np.where(np.sin(2 * TIME) > 0, 1.0, 0.0)
PRBS = np.repeat(RNG.choice([-1.0, 1.0], N // 20), 20)


def wraps(values, mask=None):
    values = np.asarray(values, float)
    return wrapping(values, np.ones(len(values), bool) if mask is None else mask)


def record(values, **options):
    return eoi.Record(TIME[: len(values)], PRBS[: len(values)], values, "run", **options)


@pytest.mark.parametrize(
    ("values", "period"),
    [
        (COUNTS % 4096, 4096),
        (np.floor(COUNTS / 20) % 4096, 4096),
        (np.floor(30000 * ANGLE) % 65536, 65536),
        (np.floor(1000 * ANGLE / TURN) % 1000, 1000),
        (np.degrees(ANGLE) % 360, 360),
        (np.round(np.degrees(ANGLE) % 360, 1), 360),
        (np.floor(np.degrees(ANGLE)) % 360, 360),
        (np.floor(10 * np.degrees(ANGLE)) % 3600, 3600),
        ((np.degrees(ANGLE) + 180) % 360 - 180, 360),
        (ANGLE % TURN, TURN),
        ((ANGLE + np.pi) % TURN - np.pi, TURN),
        (ANGLE % np.pi, np.pi),
        ((ANGLE + 0.05 * RNG.standard_normal(N)) % TURN, TURN),  # back and forth over the edge
        ((ANGLE / 6 + 0.05 * RNG.standard_normal(N)) % TURN, TURN),
        (ANGLE % TURN + 0.01 * RNG.standard_normal(N), TURN),  # noise behind the sensor
        (np.degrees(0.3 * np.exp(-0.05 * TIME) * np.sin(2 * TIME)) % 360, 360),  # swings at it
        (np.degrees(0.003 * np.arange(3000)) % 360, 360),  # one turn
        (HEADING, 360),
        (np.floor(HEADING), 360),
        (np.radians(HEADING) - np.pi, TURN),
        (np.floor(2 * RNG.standard_normal(N)) % 4096, 4096),
    ],
)
def test_what_wraps_is_found_with_its_period(values, period):
    found = wraps(values)
    assert found is not None
    assert found.usual
    assert found.period == pytest.approx(period, rel=1e-12)
    assert found.times == np.sum(np.abs(np.diff(values)) > 0.5 * np.ptp(values))
    assert found.motion < 0.1


def filtered(drive, pole):
    y = np.zeros(N)
    for k in range(N - 1):
        y[k + 1] = y[k] + pole * (drive[k] - y[k])
    return y


@pytest.mark.parametrize(
    "values",
    [
        SQUARE,
        360 * SQUARE,
        360 * SQUARE + RNG.standard_normal(N),
        np.round(4096 * SQUARE + 3 * RNG.standard_normal(N)),
        360 * SQUARE + 2 * TIME,
        180 * PRBS + 0.1 * RNG.standard_normal(N),
        np.repeat(RNG.uniform(0, 360, N // 50), 50),
        filtered(360 * SQUARE, 0.63),  # most of a step response in a sample
        360 * SQUARE - filtered(360 * SQUARE, 0.05),  # and what a high-pass leaves of it
        180 * np.sin(3 * TIME),  # a pendulum that swings
        np.pi * np.sin(3 * TIME) * np.exp(-0.1 * TIME),
        np.sin(2.5 * np.arange(N)),  # more than half a turn a sample
        20 + np.abs(TIME % 7 - 3.5),  # a thermostat
        np.round(0.6 * np.sin(TIME)),
        np.round(2 * np.sin(TIME)),
        RNG.standard_normal(N),
        RNG.uniform(0, 360, N),
        RNG.integers(0, 4096, N),
        np.cumsum(RNG.standard_normal(N)),
        np.where(np.arange(N) % 97, np.linspace(100, 360, N), 0.0),  # a sensor that drops out
        np.clip(np.round(4095 * SQUARE + 3 * RNG.standard_normal(N)), 0, 4095),  # from rail to rail
        255 * SQUARE,
        np.where(np.arange(N) % 97, 359 + 0.1 * np.sin(3 * TIME), 0.0),  # drops out near its end
        180 + 178 * (2 * SQUARE - 1) + 0.4 * RNG.standard_normal(N),
        np.zeros(N),
        np.zeros(1),
    ],
)
def test_what_does_not_wrap_is_left_alone(values):
    assert wraps(values) is None


def test_steps_in_noise_are_hardly_ever_taken_for_a_wrap():
    """The hardest case: a single step of 360 in white noise, whose neighbours say nothing."""
    alarms = 0
    for seed in range(300):
        noise = np.random.default_rng(seed).standard_normal(60)
        alarms += wraps(np.repeat([0.0, 360.0], 30) + noise) is not None
    assert alarms <= 6


def test_a_saw_tooth_of_any_height_is_only_a_question():
    found = wraps(ANGLE % 5.37)
    assert found is not None
    assert not found.usual
    assert found.period == pytest.approx(5.37, rel=1e-3)
    assert "by about 5.37" in found.text
    assert "if it is a counter or an angle that wraps" in found.advice("y")
    assert course(ANGLE % 5.37, found)[100] == (ANGLE % 5.37)[100]


def test_motion_of_nearly_half_a_period_a_sample_is_in_doubt():
    fast = wraps(np.floor(4096 * 0.42 * np.arange(N)) % 4096)
    assert fast is not None
    assert fast.motion == pytest.approx(0.42, abs=1e-3)
    assert "moves by up to 42 % of that from sample to sample" in fast.text
    slow = wraps(COUNTS % 4096)
    assert slow is not None
    assert "sample faster" not in slow.text


def test_a_wrap_is_seen_between_measured_samples_only():
    mask = RNG.random(N) > 0.2
    values = np.where(mask, COUNTS % 4096, 0.0)
    found = wraps(values, mask)
    assert found is not None
    assert found.period == 4096
    slow = np.arange(N) % 5 == 0  # of a rate of its own
    found = wraps(np.where(slow, COUNTS % 4096, 0.0), slow)
    assert found is not None
    assert found.period == 4096


# -- the remedy ---------------------------------------------------------------------------


@pytest.mark.parametrize(("scale", "period"), [(4096 / TURN, 4096), (180 / np.pi, 360)])
def test_the_unwrapped_record_is_the_truth(scale, period):
    truth = np.floor(scale * ANGLE)
    raw = record(truth % period, output_names=["angle"], units={"angle": "count"}, burn_in=0.1)
    whole = raw.unwrapped({"angle": period})
    shift = truth[0] - truth[0] % period
    np.testing.assert_array_equal(whole.outputs[:, 0] + shift, truth)
    assert whole.notes[-1] == f"`angle` unwrapped with a period of {period}."
    assert (whole.units, whole.hold, whole.burn_in) == (raw.units, raw.hold, raw.burn_in)
    assert whole.quantum[0] == 1
    assert whole.noise[0] < 1 < raw.noise[0]
    assert wrapped_notes([whole]) == []


def test_noise_at_the_edge_stays_noise():
    noisy = ANGLE + 0.05 * RNG.standard_normal(N)
    whole = record(noisy % TURN).unwrapped({"y": TURN}).outputs[:, 0]
    np.testing.assert_allclose(whole - whole[0], noisy - noisy[0], atol=1e-9)


def test_an_input_is_unwrapped_too_and_nothing_else_changes():
    raw = eoi.Record(TIME, np.c_[COUNTS % 4096, PRBS], ANGLE, input_names=["encoder", "pwm"])
    whole = raw.unwrapped({"encoder": 4096})
    np.testing.assert_array_equal(np.diff(whole.inputs[:, 0]), np.diff(COUNTS))
    np.testing.assert_array_equal(whole.inputs[:, 1], PRBS)
    np.testing.assert_array_equal(whole.outputs, raw.outputs)


@pytest.mark.filterwarnings("ignore::eoi_jax._checks.RecordWarning")
def test_missing_samples_are_bridged_and_long_gaps_are_said():
    raw = COUNTS % 4096
    raw[100:103] = np.nan
    whole = record(raw).unwrapped({"y": 4096})
    measured = whole.output_valid[:, 0]
    assert not measured[100:103].any()
    shift = COUNTS[0] - raw[0]
    np.testing.assert_array_equal((whole.outputs[:, 0] + shift)[measured], COUNTS[measured])
    assert np.all(np.diff(whole.outputs[98:106, 0]) > 0)
    assert not any("not known" in note for note in whole.notes)
    raw[1000:1060] = np.nan
    whole = record(raw).unwrapped({"y": 4096})
    assert whole.notes[-1].endswith(
        "Across 1 gap the number of turns is not known, and the nearest is taken: read the parts "
        "between the gaps as records of their own."
    )
    turns = (whole.outputs[1060, 0] - COUNTS[1060]) / 4096
    assert turns == round(turns)
    assert abs(whole.outputs[1060, 0] - whole.outputs[999, 0]) <= 2048
    (note,) = wrapped_notes([whole])
    assert note.startswith("run: `y` unwrapped with a period of 4096. Across 1 gap")


@pytest.mark.parametrize(
    ("periods", "message"),
    [
        ({"z": 4096}, r"`unwrap` must be one of u, y, got 'z'"),
        ({"y": 0}, r"`unwrap[y]` must be a period > 0 in the unit of the channel, got 0. It is"),
        ({"y": -1.0}, r"`unwrap[y]` must be a period > 0"),
        ({"y": np.nan}, r"`unwrap[y]` must be a period > 0"),
        ({"y": 4000}, r"`unwrap[y]` must be at least the range of the channel, 4095, got 4000. It"),
    ],
)
def test_a_wrong_period_is_named(periods, message):
    raw = record(COUNTS % 4096)
    with pytest.raises(ValueError, match=re.escape(message)):
        raw.unwrapped(periods)


def test_what_was_interpolated_cannot_be_unwrapped_any_more():
    rule = "`unwrapped` must come before samples are interpolated or smoothed, got a record"
    with pytest.raises(ValueError, match=rule):
        record(COUNTS % 4096).smooth(20.0).unwrapped({"y": 4096})


# -- what is said, and files --------------------------------------------------------------


def test_each_output_that_wraps_is_named_with_what_to_write():
    raw = record(np.c_[COUNTS % 4096, ANGLE], output_names=["encoder", "angle"])
    (note,) = wrapped_notes([raw])
    times = np.sum(np.abs(np.diff(COUNTS % 4096)) > 2048)
    assert note == (
        f"run: `encoder` wraps {times} times with a period of 4096: a fit takes the jumps for "
        'motion; write unwrap = { "encoder" = 4096 } in [data], or `record.unwrapped`'
    )


def jittered(path):
    rng = np.random.default_rng(5)
    time = np.sort(TIME + 2e-3 * rng.uniform(-1, 1, N))
    angle = np.interp(time, TIME, ANGLE)
    table = np.c_[time, PRBS, np.degrees(angle) % 360]
    np.savetxt(path, table, delimiter=",", header="t,drive,heading", comments="", fmt="%.9f")
    return angle


@pytest.mark.filterwarnings("ignore::eoi_jax._checks.RecordWarning")
def test_a_file_is_unwrapped_before_its_clock_is_made_even(tmp_path):
    angle = jittered(tmp_path / "run.csv")
    read: dict[str, Any] = {"time": "t", "inputs": "drive", "outputs": "heading"}
    whole = eoi.read_record(tmp_path / "run.csv", **read, unwrap={"heading": 360.0})
    truth = np.interp(whole.time, np.sort(TIME), ANGLE)
    turns = (np.degrees(truth) - whole.outputs[:, 0]) / 360
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=2e-3)
    assert whole.notes[-1] == "`heading` unwrapped with a period of 360."
    scaled = eoi.read_record(
        tmp_path / "run.csv", **read, scale={"heading": np.pi / 180}, unwrap={"heading": TURN}
    )
    np.testing.assert_allclose(scaled.outputs, np.radians(whole.outputs), atol=1e-9)
    raw = eoi.read_record(tmp_path / "run.csv", **read)
    (note,) = wrapped_notes([raw])
    assert note.startswith("run: `heading` wraps ")
    assert wrapped_notes([raw], repeated=False) == []
    assert len(angle) == N


def test_a_record_off_the_grid_warns_of_its_jumps(tmp_path):
    jittered(tmp_path / "run.csv")
    with pytest.warns(RecordWarning) as caught:
        eoi.read_record(tmp_path / "run.csv", "t", "drive", "heading")
    assert any("`heading` wraps" in str(warning.message) for warning in caught)


def test_a_column_that_is_not_read_cannot_be_unwrapped(tmp_path):
    jittered(tmp_path / "run.csv")
    with pytest.raises(ValueError, match=r"`unwrap` must be one of drive, heading, got 't'"):
        eoi.read_record(tmp_path / "run.csv", "t", "drive", "heading", unwrap={"t": 10})


def test_an_inspection_tells_of_the_course_and_of_the_wraps(tmp_path):
    jittered(tmp_path / "run.csv")
    inspection = inspect(tmp_path / "run.csv")
    assert inspection.outputs == ("heading",)
    (channel,) = (channel for channel in inspection.channels if channel.name == "heading")
    assert channel.wraps is not None
    assert channel.wraps.period == 360
    assert "; it wraps " in channel.why
    assert channel.band is not None
    assert channel.band < 1.0  # the course of the angle, not that of its jumps
    assert any('unwrap = { "heading" = 360 }' in line for line in inspection.advice)
    assert inspection.summary()["channels"][2]["wraps"]["usual"] is True
