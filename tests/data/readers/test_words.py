"""Words among numbers: switches, and marks of no value."""

import numpy as np
import pytest

from eoi_jax._checks import RecordWarning
from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.read_record import read_record, read_table

N = 40


def written(path, cells):
    rows = "\n".join(f"{0.1 * k:.1f},{cell},{np.sin(k):.6f}" for k, cell in enumerate(cells))
    path.write_text(f"t,u,y\n{rows}\n")
    return path


@pytest.mark.parametrize("pair", [("ON", "OFF"), ("true", "false"), ("Yes", "No")])
def test_a_switch_is_one_and_zero(tmp_path, pair):
    cells = [pair[k % 3 == 0] for k in range(N)]
    table = read_table(written(tmp_path / "run.csv", cells))
    np.testing.assert_array_equal(table.columns["u"], [float(k % 3 != 0) for k in range(N)])


def test_a_switch_that_never_moves_is_one_too(tmp_path):
    table = read_table(written(tmp_path / "run.csv", ["off"] * N))
    np.testing.assert_array_equal(table.columns["u"], np.zeros(N))


MARKS = (
    "unavailable", "Bad Input", "---", "***", "No Data", "Inp OutRange", "<null>", "Error",
    "missing", "Störung", "ungültig", "kein Wert", "Sensorfehler", "1.#INF", "-1.#IND00",
    "nan(ind)", "∞", "-∞", "[-11059] No Good Data For Calculation",
)  # fmt: skip


@pytest.mark.parametrize("mark", MARKS)
def test_marks_of_no_value_are_not_measured_and_said(tmp_path, mark):
    cells = [mark if k in (7, 20) else f"{0.5 * k}" for k in range(N)]
    path = written(tmp_path / "run.csv", cells)
    values = read_table(path).columns["u"]
    want = [np.nan if k in (7, 20) else 0.5 * k for k in range(N)]
    np.testing.assert_array_equal(values, want)
    assert any("no number in 2 cells" in note for note in read_table(path).notes)
    with pytest.warns(RecordWarning, match="2 of 40 samples are not finite"):
        record = read_record(path, time="t", inputs="y", outputs="u")
    np.testing.assert_array_equal(np.flatnonzero(~record.valid), [7, 20])


@pytest.mark.parametrize("mark", ["∞", "-∞"])
@pytest.mark.parametrize("row", [0, 1, N - 1])
def test_an_oscilloscope_beyond_its_range_does_not_move_the_header(tmp_path, mark, row):
    """Decimal commas and units in brackets above a blank line, as PicoScope writes them."""
    lines = [f"{k},5;{mark if k == row else k};{k % 3},25" for k in range(N)]
    path = tmp_path / "run.csv"
    path.write_text("Zeit;Kanal A;Kanal B\n(ms);(V);(mA)\n\n" + "\n".join(lines), "utf-8")
    table = read_table(path)
    assert table.units == {"Zeit": "ms", "Kanal A": "V", "Kanal B": "mA"}
    np.testing.assert_array_equal(table.columns["Zeit"], np.arange(N) + 0.5)
    assert np.flatnonzero(np.isnan(table.columns["Kanal A"])).tolist() == [row]


@pytest.mark.parametrize(
    "word",
    ["<0.4", "< 0.4 mg/l", ">120", "≤1e-3", "BLQ", "bloq", "LOD", "<LOD", "< LLOQ", "n.d.", "nd"],
)
def test_values_beyond_a_limit_of_detection_are_not_measured_and_what_that_does_is_said(
    tmp_path, word
):
    cells = [word if k in (0, 38, 39) else f"{4.0 * 0.9**k:.3f}" for k in range(N)]
    path = written(tmp_path / "run.csv", cells)
    table = read_table(path)
    assert list(table.columns) == ["t", "u", "y"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(table.columns["u"])), [0, 38, 39])
    said = f"`u` is beyond a limit of detection in 3 of 40 cells (`{word.lower()}`)"
    assert any(said in note and "biased" in note for note in table.notes)
    assert said in str(inspect(path))
    with pytest.warns(RecordWarning, match="3 of 40 samples are not finite"):
        record = read_record(path, time="t", inputs="y", outputs="u")
    assert any(said in note for note in record.notes)


def test_limits_with_decimal_commas(tmp_path):
    path = tmp_path / "run.csv"
    cells = ["<0,4" if k > 30 else f"{8.5 - 0.2 * k:.1f}".replace(".", ",") for k in range(N)]
    rows = (f"{k},5;{cell}" for k, cell in enumerate(cells))
    path.write_text("t;u\n" + "\n".join(rows))
    assert np.sum(np.isnan(read_table(path).columns["u"])) == 9


@pytest.mark.parametrize(
    "word", ["<high", "blq?x", "nde", "lode", "20.3 ?", "OL", "open", "[12] on"]
)
def test_what_is_no_limit_stays_text(tmp_path, word):
    path = written(tmp_path / "run.csv", [word if k == 9 else f"{k}" for k in range(N)])
    assert read_table(path).columns["u"].dtype.kind == "O"


@pytest.mark.parametrize(
    "word",
    ["#DIV/0!", "#VALUE!", "#WERT!", "#NV", "#REF!", "#NUM!", "#BEZUG!", "n.a.", "k.A.", "#N/A"],
)
@pytest.mark.parametrize("rows", [(0, 1), (7, 20)])
@pytest.mark.parametrize("separator", [",", ";"])
def test_the_words_of_a_spreadsheet_are_no_values(tmp_path, word, rows, separator):
    cells = [word if k in rows else f"{0.5 * k:.1f}" for k in range(N)]
    path = written(tmp_path / "run.csv", cells)
    if separator == ";":
        path.write_text(path.read_text().replace(",", ";").replace(".", ",").replace(
            word.replace(".", ","), word))  # fmt: skip
    table = read_table(path)
    assert list(table.columns) == ["t", "u", "y"]
    want = [np.nan if k in rows else 0.5 * k for k in range(N)]
    np.testing.assert_array_equal(table.columns["u"], want)
    found = inspect(path)
    (channel,) = (channel for channel in found.channels if channel.name == "u")
    assert channel.missing == 2
    assert "Empty or not finite: `u` 2; such samples are masked." in found.advice


def test_an_inspection_names_the_word_that_makes_a_column_text(tmp_path):
    path = written(tmp_path / "run.csv", ["torn" if k == 9 else f"{k}" for k in range(N)])
    assert "`u` is left out: text such as 'torn'." in inspect(path).advice


def test_numbers_with_their_unit_in_every_cell_are_numbers(tmp_path):
    path = written(tmp_path / "run.csv", [f"{0.5 * k} °C" if k != 5 else "" for k in range(N)])
    table = read_table(path)
    want = [np.nan if k == 5 else 0.5 * k for k in range(N)]
    np.testing.assert_array_equal(table.columns["u"], want)
    assert table.units["u"] == "°C"


def test_cells_with_different_units_are_refused(tmp_path):
    path = written(tmp_path / "run.csv", [f"{k} {'mV' if k % 2 else 'V'}" for k in range(N)])
    with pytest.raises(ValueError, match="`u` must be a numeric column"):
        read_record(path, time="t", inputs="u", outputs="y")


@pytest.mark.parametrize(
    ("cell", "advice"),
    [
        ('"1,072.51"', "Write numbers without thousands separators"),
        ('"1.072,51"', "Write numbers without thousands separators"),
        ("1'072.51", "Write numbers without thousands separators"),
        ("Average", "give it by `missing`; where for a line that is no sample, leave the line"),
    ],
)
def test_a_cell_that_is_no_number_comes_with_what_to_do(tmp_path, cell, advice):
    path = written(tmp_path / "run.csv", [cell if k == 9 else f"{k}" for k in range(N)])
    with pytest.raises(ValueError, match=rf"`u` must be a numeric column.*line 11\. .*{advice}"):
        read_record(path, time="t", inputs="u", outputs="y")


@pytest.mark.parametrize("mark", ["7,5", "---", ""])
def test_a_point_between_decimal_commas_is_never_taken_for_a_decimal_point(tmp_path, mark):
    """A cell 1.000 is a thousand there, or one: the column is refused, the others are read."""
    rows = [f"{k},5;{mark if k == 3 else '1.000' if k == 9 else k};{k},25" for k in range(N)]
    path = tmp_path / "run.csv"
    path.write_text("t;u;y\n" + "\n".join(rows))
    with pytest.raises(
        ValueError, match=r"`u` holds '1.000' in a table with decimal commas: write"
    ):
        read_record(path, time="t", inputs="u", outputs="y")
    assert len(read_record(path, time="t", outputs="y").time) == N
    assert any("`u` holds '1.000'" in text for text in inspect(path).left_out)


@pytest.mark.parametrize(
    "cells",
    [
        ["on" if k % 2 else "left" for k in range(N)],  # of no switch
        ["on" if k % 2 else "1.5" for k in range(N)],  # a switch or a number?
        ["torn" if k == 9 else f"{k}" for k in range(N)],  # a word that means nothing
    ],
)
def test_other_words_are_refused(tmp_path, cells):
    path = written(tmp_path / "run.csv", cells)
    with pytest.raises(ValueError, match="`u` must be a numeric column"):
        read_record(path, time="t", inputs="u", outputs="y")
