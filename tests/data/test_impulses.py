"""Inputs that are amounts given at the instant of their row: their integral is the amount."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.cli.template import draft
from eoi_jax.data.column_names import is_per_time
from eoi_jax.data.impulses import SINGLE_ROWS
from eoi_jax.data.record_notes import biasing_notes

# Rows by hand, with a dose of 200 mg each 8 h; the decay is exact: V = 10 L, k = 0.3/h.
TIMES = [0.5, 1, 2, 4, 6, 10, 12, 14, 20, 23, 24.25, 25, 26, 28, 32, 36]
DOSES = {0.0: 200.0, 8.0: 200.0, 24.0: 200.0}


def concentration(time: float) -> float:
    return sum(dose / 10.0 * np.exp(-0.3 * (time - at)) for at, dose in DOSES.items() if at <= time)


def table(path: Path, times: Sequence[float], zero: str = "0", unit: str = "mg") -> Path:
    rows = [(at, "", f"{dose:g}") for at, dose in DOSES.items()]
    rows += [(at, f"{concentration(at):.5g}", zero) for at in times]
    lines = [f"{at:.9g},{y},{u}" for at, y, u in sorted(rows)]
    path.write_text("\n".join([f"time [h],conc [mg/L],amt [{unit}]", *lines]) + "\n")
    return path


def read(path: Path, hours: float = 3600.0, **options: Any) -> eoi.Record:
    columns = {"time": "time [h]", "inputs": ["amt [mg]"], "outputs": ["conc [mg/L]"]}
    options = {"impulses": ["amt [mg]"], "scale": {"time [h]": hours}, **columns, **options}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", eoi.RecordWarning)
        return eoi.read_record(path, **options)


def given(record: eoi.Record) -> np.ndarray:
    return record.sample_period * record.inputs.sum(axis=0)


def test_the_integral_is_the_amount_whatever_the_spacing_of_the_rows(tmp_path: Path) -> None:
    record = read(table(tmp_path / "a.csv", TIMES))
    (steps,) = np.nonzero(record.inputs[:, 0])
    np.testing.assert_allclose(record.time[steps] / 3600.0, list(DOSES))
    np.testing.assert_allclose(record.inputs[steps, 0], 200.0 / record.sample_period)
    assert (record.hold, record.hold_declared) == ("zero", True)
    assert any("3 amounts, 600 in all" in note for note in record.notes)


def test_volume_and_rate_are_those_of_the_doses(tmp_path: Path) -> None:
    record = read(table(tmp_path / "a.csv", TIMES), hours=1.0)
    plant = eoi.plant_from_text(
        {"conc": "-k*conc + amt/V"}, {"k": 1.0, "V": 3.0}, ["conc"], ["amt"],
        units={"amt": "mg/h", "conc": "mg/L"},
    )  # fmt: skip
    found = eoi.refine(plant, record).parameters
    # A dose acts over a step of 0.25 h, half of it late: exp(0.3/h · 0.125 h) at the most.
    np.testing.assert_allclose([found["k"], found["V"]], [0.3, 10.0], rtol=0.05)


def test_units_are_those_of_the_column_per_time(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", TIMES)
    assert read(path).units["amt [mg]"] == "mg/s"
    assert read(path, hours=1.0).units["amt [mg]"] == "mg/h"
    assert read(path, units={"amt [mg]": "µg"}).units["amt [mg]"] == "µg/s"
    plant = eoi.plant_from_text(
        {"conc": "-k*conc + amt/V"}, {"k": 1.0, "V": 3.0}, ["conc"], ["amt"], units={"amt": "mg"}
    )
    with pytest.raises(ValueError, match="must be in the plant's unit for `amt`, 'mg', got 'mg/s'"):
        eoi.refine(plant, read(path))


def test_an_empty_cell_is_no_dose(tmp_path: Path) -> None:
    record = read(table(tmp_path / "a.csv", TIMES, zero=""))
    np.testing.assert_allclose(given(record), 600.0)
    assert record.input_valid.all()
    assert any("`amt [mg]` is empty in 16 cells: no amount there" in note for note in record.notes)


def test_amounts_of_one_stamp_add_up_beside_a_measured_row(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", [*TIMES, 8.0])
    path.write_text(path.read_text().replace("24,,200\n", "24,,150\n24,,50\n"))
    record = read(path)
    np.testing.assert_allclose(given(record), 600.0)
    assert int(np.sum(record.inputs != 0)) == 3
    assert any("Amounts of one stamp are added up: 1 to" in note for note in record.notes)


def test_an_amount_between_grid_points_acts_in_its_step(tmp_path: Path) -> None:
    times = np.arange(0.0, 40.0, 0.5) + np.random.default_rng(0).uniform(-0.1, 0.1, 80)
    record = read(table(tmp_path / "a.csv", [at for at in times.tolist() if at > 0.01]))
    np.testing.assert_allclose(given(record), 600.0)
    (steps,) = np.nonzero(record.inputs[:, 0])
    late = np.array(list(DOSES)) * 3600.0 - record.time[steps]
    assert np.all((late[1:] >= 0) & (late[1:] < record.sample_period))
    assert any("with an amount are between the points of the grid" in note for note in record.notes)


def test_other_inputs_have_their_own_hold(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", TIMES)
    lines = path.read_text().splitlines()
    lines = [f"{lines[0]},warmth", *(f"{line},{i % 7}" for i, line in enumerate(lines[1:]))]
    path.write_text("\n".join(lines))
    names = ["amt [mg]", "warmth"]
    assert read(path, inputs=names, hold={"warmth": "linear"}).hold == ("zero", "linear")
    assert read(path, inputs=names, hold="smooth").hold == ("zero", "smooth")
    with pytest.raises(ValueError, match="`hold` must be declared for inputs beside those of"):
        read(path, inputs=names)


def test_what_is_no_input_or_not_held_is_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", TIMES)
    with pytest.raises(ValueError, match=r"`impulses` must be .*amt \[mg\]"):
        read(path, impulses=["conc [mg/L]"])
    rule = r"`hold\[amt \[mg\]\]` must be zero, or left out, for an input of `impulses`, got linear"
    for hold in ("linear", {"amt [mg]": "linear"}):
        with pytest.raises(ValueError, match=rule):
            read(path, hold=hold)


def test_amounts_that_are_not_declared_are_told(tmp_path: Path) -> None:
    path = table(tmp_path / "a.csv", TIMES)
    record = read(path, impulses=(), hold="zero")
    note = next(note for note in record.notes if SINGLE_ROWS in note)
    assert 'declare `impulses` = ["amt [mg]"]; if a rate, write the row' in note
    inspection = eoi.inspect(path)
    assert note in inspection.advice
    with pytest.warns(eoi.RecordWarning):
        text = draft([inspection], tmp_path / "a.toml")
    assert '# impulses = ["amt [mg]"]' in text


def test_rates_and_even_rows_are_not_told(tmp_path: Path) -> None:
    rate = table(tmp_path / "rate.csv", TIMES, unit="mg/h")
    even = table(tmp_path / "even.csv", [at for at in range(40) if at not in DOSES])
    for path, column in ((rate, "amt [mg/h]"), (even, "amt [mg]")):
        notes = read(path, inputs=[column], impulses=(), hold="zero").notes
        assert not any(SINGLE_ROWS in note for note in notes)


@pytest.mark.parametrize("unit", ["mg/h", "l/min", "m³ h⁻¹", "g s^-1", "m/s²", "drops per min"])
def test_a_unit_per_time_is_that_of_a_rate(unit: str) -> None:
    assert is_per_time(unit)


@pytest.mark.parametrize("unit", ["mg", "", "mg/L", "min", "kg/m3", "mol/hl"])
def test_a_unit_of_an_amount_is_none(unit: str) -> None:
    assert not is_per_time(unit)


def test_a_fit_says_it_once_of_records_that_are_alike(tmp_path: Path) -> None:
    paths = [table(tmp_path / f"{name}.csv", TIMES) for name in "ab"]
    notes = biasing_notes([read(path, impulses=(), hold="zero") for path in paths])
    assert len(notes) == 1
    assert notes[0].startswith("a: `amt [mg]` is not zero in single rows")
    assert notes[0].endswith("; alike in b")
