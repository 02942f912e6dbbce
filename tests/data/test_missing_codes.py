"""Codes for missing values, such as -999: said where they are likely, read where declared."""

import warnings

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.cli import actions
from eoi_jax.cli.config import load
from eoi_jax.data.inspection import inspect
from eoi_jax.data.missing_codes import likely_codes

N = 400
T = 0.5 * np.arange(N)
RNG = np.random.default_rng(1)
AIR = 8.0 + 5.0 * np.sin(0.03 * T) + 0.05 * RNG.standard_normal(N)
ROOM = 20.0 + np.cos(0.05 * T) + 0.01 * RNG.standard_normal(N)
ROWS = [100, 101, 250]


def spoilt(signal, code, rows=ROWS):
    changed = signal.copy()
    changed[rows] = code
    return changed


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "house.csv"
    table = np.column_stack([T, spoilt(AIR, -999.0), ROOM])
    header = "time,outdoor,room_temp"
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.10g")
    return path


@pytest.mark.parametrize("code", [-999.0, -9999.0, -999.25, 9999.0, 999.9, 32767.0, -32768.0])
def test_codes_side_by_side_in_an_output_are_masked_and_said(code):
    said = f"`room` is {code:.12g} in 3 samples, outside of all others .*: masked"
    with pytest.warns(eoi.RecordWarning, match=said.replace(".25", r"\.25")):
        record = eoi.Record(T, AIR, spoilt(ROOM, code), output_names=["room"])
    assert np.flatnonzero(~record.output_valid[:, 0]).tolist() == ROWS
    with pytest.warns(eoi.RecordWarning, match="likely a code .* used as if measured"):
        kept = eoi.Record(T, AIR, spoilt(ROOM, code), mask_faults=False)
    assert kept.output_valid.all()


def test_codes_in_an_input_are_used_and_said_with_what_to_do():
    with pytest.warns(eoi.RecordWarning, match="likely a code"):
        record = eoi.Record(T, spoilt(AIR, -999.0), ROOM, input_names=["outdoor"])
    assert record.input_valid.all()
    assert record.inputs[100, 0] == -999.0
    assert any("declare it by `missing` = [-999]" in note for note in record.notes)


@pytest.mark.parametrize(
    "values",
    [
        np.linspace(0.0, 999.0, N),  # the end of what was measured
        np.where(T > 50.0, 999.0, 0.0),  # a switch
        np.clip(40000.0 * np.sin(0.1 * T), -32768.0, 32767.0),  # clipped
        spoilt(AIR, 21.0),  # no code
        np.where(T < 195.0, np.nan, -999.0),  # nothing to compare it with
    ],
)
def test_numbers_of_the_range_are_values(values):
    assert likely_codes(values) == ()


def test_several_codes_are_told_apart_and_a_negative_one_of_a_power_too():
    both = spoilt(spoilt(AIR, -999.0), -9999.0, [7])
    assert likely_codes(both) == (-9999.0, -999.0)
    assert likely_codes(spoilt(100.0 * np.arange(float(N)), -999.0)) == (-999.0,)


@pytest.mark.parametrize("missing", [-999, [-999], {"outdoor": [-999, "bad"]}, ["-999"]])
def test_declared_codes_are_missing(log, missing):
    with pytest.warns(eoi.RecordWarning):
        record = eoi.read_record(log, "time", "outdoor", "room_temp", missing=missing)
    assert np.flatnonzero(~record.input_valid).tolist() == ROWS[:2]  # a single one is interpolated
    assert record.inputs.min() > 0.0
    said = "`outdoor` has no value in 3 cells (`-999`), as `missing` says."
    assert any(said in note for note in record.notes)


def test_declared_words_are_missing_beside_known_ones(tmp_path):
    path = tmp_path / "run.csv"
    cells = ["Sensor 7?!" if k == 9 else "Bad" if k == 12 else f"{21 + 0.5 * k}" for k in range(40)]
    path.write_text("t,u,y\n" + "".join(f"{k},{k % 7},{cell}\n" for k, cell in enumerate(cells)))
    with pytest.raises(ValueError, match="no value of a signal, give it by `missing`"):
        eoi.read_record(path, "t", "u", "y")
    with pytest.warns(eoi.RecordWarning, match="2 of 40 samples are not finite"):
        record = eoi.read_record(path, "t", "u", "y", missing={"y": "sensor 7?!"})
    assert np.flatnonzero(~record.output_valid[:, 0]).tolist() == [9, 12]


def test_wrong_declarations_are_refused(log):
    read = log, "time", "outdoor", "room_temp"
    with pytest.raises(ValueError, match="`missing` must be one of outdoor, room_temp, got"):
        eoi.read_record(*read, missing={"wind": -999})
    with pytest.raises(ValueError, match=r"`missing\[outdoor\]` must be finite numbers and words"):
        eoi.read_record(*read, missing={"outdoor": float("nan")})


def test_an_inspection_looks_at_a_column_without_its_codes(log):
    found = inspect(log)
    (outdoor,) = [channel for channel in found.channels if channel.name == "outdoor"]
    assert (outdoor.codes, outdoor.missing) == ((-999.0,), 0)
    assert outdoor.low == pytest.approx(AIR.min())
    assert found.advice[0].startswith("`outdoor` is -999 in 3 samples, outside of all others")
    assert "declare it by `missing` = [-999]" in found.advice[0]
    assert not any("sample faster" in line for line in found.advice)


def test_a_draft_declares_them_and_its_run_reads_them_so(log, tmp_path):
    outcome = actions.init([log], tmp_path / "house.toml", False)
    assert "left out of what is said here. The draft declares it." in outcome.text
    data = load(tmp_path / "house.toml").data
    assert data is not None
    assert data.missing == {"outdoor": (-999.0,)}


def test_a_config_takes_one_code_for_all_columns(log, tmp_path):
    path = tmp_path / "run.toml"
    text = f'name = "r"\nplant = "servo"\n[data]\nfiles = ["{log.name}"]\nmissing = {{}}\n'
    for value, want in (("-999", -999.0), ('[-999, "Bad"]', (-999.0, "Bad"))):
        path.write_text(text.format(value))
        data = load(path).data
        assert data is not None
        assert data.missing == want


def test_records_without_codes_give_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        eoi.Record(T, AIR, ROOM)
