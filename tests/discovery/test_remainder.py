"""What an answer leaves: partial where free runs miss by more, and records that differ."""

import re
from dataclasses import replace

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.own_offsets import with_own_offsets
from eoi_jax.discovery.own_parameters import OwnFits
from eoi_jax.discovery.remainder import _differ, with_long_misses
from eoi_jax.discovery.remarks import RecordNote
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import ConstantOffset, QuadraticDrag
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.validate import judged_runs

GAIN, LOSS, H = 0.01, 0.005, 5.0
PLANT = eoi.Plant(
    lambda t, x, u, p: p.b * u[0] - p.k * (x.y[0] - 20.0), {"b": 0.02, "k": 0.004}, 1,
    inputs=("power",), outputs=("temperature",),
)  # fmt: skip


def warmed(ambient, seed, name="record", samples=800):
    """T' = GAIN·P - LOSS·(T - ambient), exact between its samples."""
    draw = np.random.default_rng(seed)
    power = np.repeat(20.0 + 30.0 * draw.uniform(0.0, 1.0, samples // 40), 40)
    y, level, decay = np.empty(samples), ambient, np.exp(-LOSS * H)
    for i in range(samples):
        y[i] = level
        end = ambient + GAIN / LOSS * power[i]
        level = end + (level - end) * decay
    y += 2e-3 * np.std(y) * draw.standard_normal(samples)
    return eoi.Record(
        H * np.arange(samples), power, y, name, hold="zero",
        input_names=("power",), output_names=("temperature",),
    )  # fmt: skip


def differences(found):
    return [note for note in found.notes if note.startswith("the records differ")]


@pytest.mark.slow
def test_an_offset_that_held_out_records_do_not_have_is_no_complete_answer():
    """The temperature around is another one on the second day, and was not recorded."""
    found = eoi.discover(PLANT, warmed(18.0, 1, "Monday"), validation=warmed(27.0, 2, "Friday"))
    assert found.status.code == "partial"
    assert "hardly less than before" in found.status.message
    (note,) = differences(found)
    assert "at temperature" in note
    assert "in Monday, 0.045" in note
    assert "in Friday)" in note


@pytest.mark.slow
def test_records_that_differ_are_told_where_nothing_is_found():
    days = [warmed(ambient, seed) for seed, ambient in enumerate((18.0, 27.0, 22.0))]
    found = eoi.discover(PLANT, days[:2], validation=days[2])
    assert found.status.code == "unexplained"
    assert "the records ask for different parameters" in found.status.message
    (note,) = (note for note in found.notes if "differs between the records" in note)
    assert note.startswith("constant_offset differs")
    assert "in record 2" in note


@pytest.mark.slow
def test_an_offset_that_all_records_have_is_complete_and_no_difference():
    days = [warmed(24.0, seed) for seed in (3, 4)]
    found = eoi.discover(PLANT, days[0], validation=days[1])
    assert found.status.code == "complete"
    assert not differences(found)


@pytest.mark.slow
def test_nothing_missing_says_where_free_runs_predict_hardly_anything():
    """Three samples far off, side by side, look like noise of that size."""
    fitted, held = warmed(20.0, 1), warmed(20.0, 2)
    found = eoi.discover(PLANT, fitted, held, [QuadraticDrag()])
    assert found.status.code == "nothing_missing"
    assert "than a constant" not in found.status.message
    outputs = held.outputs.copy()
    outputs[300:303] = 1e15
    spoilt = eoi.Record(held.time, held.inputs, outputs, "spoilt", hold="zero",
                        input_names=held.input_names, output_names=held.output_names)  # fmt: skip
    found = eoi.discover(PLANT, fitted, spoilt, [QuadraticDrag()])
    assert found.status.code == "nothing_missing"
    message = (
        r"but free runs predict temperature \(fit -?[\d.e+-]+ %\) hardly better than a constant"
    )
    assert re.search(message, found.status.message)


def test_whole_runs_that_miss_are_told_where_windows_do_not():
    found = eoi.discover(PLANT, warmed(20.0, 5), warmed(20.0, 6), ["quadratic_drag"])
    assert found.status.code == "nothing_missing"
    assert found.notes == with_long_misses(found, refined=False).notes
    values = found.plant.parameters
    wrong = found.plant.with_parameters({"k": 1.02 * values["k"], "b": 1.02 * values["b"]})
    drifting = replace(found, after=judged_runs(wrong, found.held_out))
    note = with_long_misses(drifting, refined=False).notes[-1]
    assert re.match(r"free runs of temperature miss by .* times the noise of its sensor", note)
    assert note.endswith("in whole runs, to which `refine=True` fits them")
    assert with_long_misses(drifting, refined=True).notes == found.notes


def test_offsets_that_no_record_tells_do_not_differ():
    placed = place(PLANT, ConstantOffset(), 0)
    (name,) = placed.names
    true = PLANT.with_parameters({"b": GAIN, "k": LOSS})
    model = augmented(true, (placed,), {name: 0.0}).declared_anew(fixed=PLANT.names)
    fits = [
        refine_once(model, (warmed(ambient, seed, samples=200),), None)
        for seed, ambient in enumerate((18.0, 27.0))
    ]
    assert _differ(fits, placed)
    for error in (np.inf, 0.0, np.nan):
        open_fits = [replace(fit, standard_errors={name: error}) for fit in fits]
        assert not _differ(open_fits, placed)


ROAD = eoi.Plant(
    lambda t, x, u, p: -(p.f0 + p.f2 * x.y[0] ** 2) / 1500.0, {"f0": 150.0, "f2": 0.3}, 1,
    inputs=(), outputs=("v",), bounds={"f0": (0.0, 1e4), "f2": (0.0, 100.0)}, units={"v": "m/s"},
)  # fmt: skip


def coasting(slope, seed, speed):
    """A car that rolls out on a slope: v' = -(170 + 0.42 v²)/1500 - g·slope, exactly."""
    time = 0.2 * np.arange(500)
    c, level = 0.42 / 1500.0, 170.0 / 1500.0 + 9.81 * slope
    end = np.sqrt(level / c)
    v = end * np.tan(np.arctan(speed / end) - np.sqrt(level * c) * time)
    noise = 0.03 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record(time, np.zeros((500, 0)), v + noise, f"run {seed}", output_names=("v",))


@pytest.mark.slow
@pytest.mark.long
def test_a_store_does_not_stand_in_for_a_slope_of_each_run():
    up, down, third = coasting(0.004, 1, 30.0), coasting(-0.004, 2, 28.0), coasting(0.004, 3, 29.0)
    found = eoi.discover(ROAD, [up, down], validation=third)
    assert found.status.code == "unexplained"
    assert "the records differ in a constant at v" in found.status.message
    assert not found.effects
    assert found.base is None
    assert found.after is not None
    assert found.before is found.after
    np.testing.assert_allclose(found.after.rmse, judged_runs(found.plant, third).rmse)
    assert not any("errors before are those" in note for note in found.notes)
    own = with_own_offsets(ROAD, 0, (up, down), None)
    assert own is not None
    assert own.records == (1,)  # f0 is that of the first
    errors = own.refinement.standard_errors
    truth = {"f0": 170.0 + 9.81 * 0.004 * 1500.0, "f2": 0.42, own.names[0]: 9.81 * 0.008}
    for name, value in truth.items():
        assert abs(own.refinement.parameters[name] - value) < 5.0 * errors[name]


def test_offsets_of_records_that_are_alike_do_not_differ():
    first, second = coasting(0.0, 4, 30.0), coasting(0.0, 5, 25.0)
    own = with_own_offsets(ROAD, 0, (first, second), None)
    assert own is not None
    assert own.deviation < 5.0
    powered = with_own_offsets(PLANT, 0, (warmed(18.0, 1), warmed(27.0, 2)), None)
    assert powered is not None
    assert powered.deviation > 20.0


@pytest.mark.slow
def test_outputs_that_stay_at_an_end_of_their_range_are_told():
    day = warmed(18.0, 7)
    ceiling = np.quantile(day.outputs, 0.9)
    full = day.with_outputs(np.minimum(day.outputs, ceiling), "full")
    found = eoi.discover(PLANT, full, validation=0.3, effects=["constant_offset"])
    told = [note for note in found.notes if "an end of its range" in note]
    assert told
    assert all("temperature stays at" in note for note in told)


def moved(mass, seed, resistance=1.0):
    """mass·v' = 2·u - resistance·v - 0.8·v|v|: exact to far below the noise."""
    draw, substeps, samples = np.random.default_rng(seed), 20, 500
    force, h = np.repeat(draw.uniform(-2.0, 3.0, samples // 20), 20), 0.05 / 20
    v, speeds = 0.0, []
    for level in force:
        speeds.append(v)
        for _ in range(substeps):
            v += h * (2.0 * level - resistance * v - 0.8 * v * abs(v)) / mass
    noise = 2e-3 * draw.standard_normal(samples)
    return eoi.Record(
        0.05 * np.arange(samples), force, np.array(speeds) + noise, f"{mass:g} kg", hold="zero",
        input_names=("force",), output_names=("v",),
    )  # fmt: skip


DRIVEN = eoi.Plant(
    lambda t, x, u, p: p.gain * u[0] - p.loss * x.y[0], {"gain": 1.0, "loss": 1.0}, 1,
    inputs=("force",), outputs=("v",), units={"v": "m/s", "force": "N"},
)  # fmt: skip


@pytest.mark.slow
def test_records_with_another_load_each_are_told_with_their_parameters():
    """A drag is missing in all records, and the mass is another one in each."""
    records = [moved(1.0, 1), moved(2.0, 2), moved(3.0, 3)]
    found = eoi.discover(DRIVEN, records, validation=moved(1.5, 4))
    assert found.status.code == "unexplained"
    assert "the records ask for different parameters" in found.status.message
    assert "declared model with quadratic_drag" in found.status.message
    assert not found.effects
    assert "records ask for different parameters" in str(found).splitlines()[0]
    notes = [note for note in found.notes if isinstance(note, RecordNote)]
    assert [note.split()[0] for note in notes] == ["gain", "loss", "quadratic_drag"]
    values = [float(part.split(" ±")[0]) for part in notes[0].split(": ")[1].split(", ")]
    np.testing.assert_allclose(values, [2.0, 1.0, 2.0 / 3.0], rtol=0.02)
    assert all(f"{mass} kg" in notes[0] for mass in (1, 2, 3))


def test_records_whose_parameters_are_alike_ask_for_no_others():
    records = moved(1.0, 1), moved(1.0, 2)
    fits = OwnFits.of(DRIVEN, records, 5.0, [QuadraticDrag()], 0.01)
    assert fits.differing_from(DRIVEN) is None  # which lacks the drag
    other = OwnFits.of(DRIVEN, (moved(1.0, 1), moved(2.0, 2)), 5.0, [QuadraticDrag()], 0.01)
    own = other.differing_from(DRIVEN)
    assert own is not None
    assert own.differing == ("gain", "loss", "quadratic_drag")
    assert own.ratio < 0.1


def test_records_that_no_effect_describes_ask_for_no_others():
    records = moved(1.0, 1), moved(2.0, 2)
    fits = OwnFits.of(DRIVEN, records, 5.0, [ConstantOffset()], 0.01)
    assert fits.differing_from(DRIVEN) is None
