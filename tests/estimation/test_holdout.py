"""Which records may be held out."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.holdout import (
    INITIAL,
    _count_common_samples,
    check_runs,
    held_out_records,
    scorable_records,
)

TIME = 0.01 * np.arange(1000)


def free(t, x, u, p):
    return p.b * u - p.c * x.y[0]


PLANT = eoi.Plant(free, {"b": 1.0, "c": 1.0}, 1)


def run(seed: int, start: float = 0.0) -> eoi.Record:
    draw = np.random.default_rng(seed)
    return eoi.Record(start + TIME, draw.normal(size=1000), draw.normal(size=1000), f"run {seed}")


def moved(record: eoi.Record, by: float) -> eoi.Record:
    """The same signals at another time."""
    return eoi.Record(record.time + by, record.inputs, record.outputs, "later")


@pytest.mark.parametrize(
    ("fit", "held", "count"),
    [
        (run(1), run(1)[200:600], 350),
        (run(1)[200:600], run(1), 400),
        (run(1)[:600], run(1)[400:], 150),
        (run(1), moved(run(1), 1e-6)[200:600], 350),
    ],
)
def test_a_part_of_a_record_of_the_fit_is_not_held_out(fit, held, count):
    with pytest.raises(ValueError, match=f"must not hold samples that the fit sees, got {count}"):
        held_out_records(PLANT, [run(2), fit], held)


def test_a_refinement_is_not_judged_on_records_of_its_fit():
    with pytest.raises(ValueError, match=r"`validation\[run 1\]` must not be one of the re"):
        eoi.refine(PLANT, [run(2), run(1)], validation=run(1))


@pytest.mark.parametrize(
    "held",
    [
        run(2),
        run(1)[600:],
        run(1)[550:],  # the first 50 start its free run, and are not scored
        moved(run(1), 1.0),  # a plant in a steady motion may well repeat it
        moved(run(1), 4e-3),
        eoi.Record(TIME, run(1).inputs, run(2).outputs),
        eoi.Record(2.0 * TIME, run(1).inputs, run(1).outputs),
    ],
)
def test_other_samples_are_held_out(held):
    assert held_out_records(PLANT, [run(1)[:600]], held) == (held,)


def test_two_runs_that_rest_at_first_are_two():
    rest = np.zeros(1000)
    fit = eoi.Record(TIME, rest, rest, "rest")
    later = eoi.Record(TIME[500:], rest[500:], rest[500:], "rest too")
    assert held_out_records(PLANT, [fit], later) == (later,)


def test_several_may_come_from_a_generator():
    held = run(2), run(3)
    assert held_out_records(PLANT, [run(1)], (one for one in held)) == held
    assert (
        held_out_records(PLANT, [run(1)], iter(())) == held_out_records(PLANT, [run(1)], None) == ()
    )


def gaps(record: eoi.Record) -> eoi.Record:
    """One sample of 60 is left."""
    y = np.where(np.arange(len(record)) % 60 == 0, record.outputs[:, 0], np.nan)
    with pytest.warns(eoi.RecordWarning):
        return eoi.Record(record.time, record.inputs, y, "gaps")


def settling(record: eoi.Record) -> eoi.Record:
    """Forty samples, all of them within the burn-in."""
    part = record[:40]
    return eoi.Record(part.time, part.inputs, part.outputs, part.name, hold="zero", burn_in=9.0)


@pytest.mark.parametrize(
    ("held", "window", "message"),
    [
        ([settling(run(2))], None, r"its free run, got 40 samples \(0.4 s\), 40 of them valid and"),
        ([settling(run(2))], None, r"`validation\[run 2\]` must have valid samples after the 13"),
        ([], None, r"`records\[run 1\]` must have valid samples after the 13"),
        ([gaps(run(2))], 0.55, r"of 0.55 s, got 1000 samples \(10 s\), 17 of them valid"),
    ],
)  # fmt: skip
def test_records_of_which_no_free_run_can_be_made_are_named(held, window, message):
    short = run(1) if held else settling(run(1))
    with pytest.raises(ValueError, match=message):
        check_runs(PLANT, [short], held, window)


@pytest.mark.parametrize(
    ("window", "message"),
    [
        (0.5, r"`window` must be longer than 0\.5 s, the 50 samples of run"),
        (-1.0, r"`window` must be positive and finite, got -1\.0\. It is a time"),
    ],
)
def test_a_window_is_longer_than_its_start(window, message):
    with pytest.raises(ValueError, match=message):
        scorable_records(PLANT, "records", (run(1),), window, whole=False)


def test_a_record_that_cannot_be_scored_is_left_out_where_another_one_can():
    short, full = settling(run(1)), run(2)
    kept, (note,) = scorable_records(PLANT, "records", (short, full), None, whole=True)
    assert kept == (full,)
    assert note.startswith("left out: `records[run 1]` must have valid samples after the 13")
    assert scorable_records(PLANT, "records", (short,), None, whole=True) == ((short,), [])
    assert scorable_records(PLANT, "records", (full,), None, whole=True) == ((full,), [])


def test_runs_that_start_late_are_told_of_the_records_that_judge():
    record = run(2)
    y = record.outputs[:, 0].copy()
    y[:60] = np.nan
    with pytest.warns(eoi.RecordWarning):
        late = eoi.Record(TIME, record.inputs, y, "late")
    whole, windows = check_runs(PLANT, [run(1)], [late], None)
    assert whole.startswith("The free run on late starts at t = 0.6 s")
    assert windows.startswith("1 of 10 windows on late is not scored: fewer than 25 of")
    assert check_runs(PLANT, [late], [run(1)], None) == []


def test_a_window_that_is_no_part_of_a_record_is_told():
    (note,) = check_runs(PLANT, [run(1)], [run(2)], 100.0)
    assert note.startswith("`window` of 100 s is no part of run 2, of 10 s")
    assert check_runs(PLANT, [run(1)], [run(2)], 5.0) == []
    assert check_runs(PLANT, [run(1)[:40]], [run(2)], None) == []  # it need not judge


def test_notes_of_the_runs_are_in_the_answer_and_their_errors_come_before_the_fit():
    record = eoi.simulate(PLANT, TIME, np.sin(3.0 * TIME), hold="linear")
    other = eoi.simulate(PLANT, TIME, np.cos(2.0 * TIME), hold="linear", name="other")
    few = "constant_offset"
    found = eoi.discover(PLANT, record, other, few, window=100.0)
    assert any("is no part of other" in one for one in found.notes)
    stages = []
    with pytest.raises(ValueError, match=r"`validation\[other\]` must have valid samples"):
        eoi.discover(
            PLANT, record, settling(other), few, callback=lambda *told: stages.append(told)
        )
    assert stages == []


def test_a_cut_off_below_all_that_the_records_tell_is_said():
    record = eoi.simulate(PLANT, TIME, np.sin(3.0 * TIME), hold="linear")
    found = eoi.discover(PLANT, record, lowpass=eoi.LowPass(1e-3))
    assert found.status.code == "no_data"
    assert found.status.message.startswith("the records are too short for the cut-off 0.001 rad/s")


def test_a_gap_in_either_hides_no_common_samples():
    time = 0.01 * np.arange(400)
    y = np.cumsum(np.random.default_rng(0).standard_normal(400))
    holes = [np.where((np.arange(400) // 5) % 20 == place, np.nan, y) for place in (7, 12)]
    with pytest.warns(eoi.RecordWarning):
        one, other = (eoi.Record(time, np.sin(time), y) for y in holes)
    both = np.isfinite(holes[0] + holes[1])
    assert _count_common_samples(one, other) == np.sum(both[INITIAL:])
