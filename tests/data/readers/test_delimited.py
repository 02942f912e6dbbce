"""Text tables as people have them: each is read rightly, or refused with a sentence."""

import re
import sys
import warnings
import zipfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.read_record import read_record, read_table

N = 40
T = 0.01 * np.arange(N)
U = np.sign(np.sin(20 * T))
Y = np.round(np.sin(3 * T), 6)


def rows(separator=",", comma=False, end="\n", stamps=T):
    lines = [
        f"{t:.2f}{separator}{u:g}{separator}{y:.6f}" for t, u, y in zip(stamps, U, Y, strict=True)
    ]
    text = end.join(lines) + end
    return text.replace(".", ",") if comma else text


def check_columns(table, names=("t", "u", "y")):
    assert tuple(table.columns) == names
    for key, values in zip(names, (T, U, Y), strict=True):
        np.testing.assert_allclose(table.columns[key], values, atol=1e-12)


CASES = {
    "semicolons and decimal commas": ("t;u;y\n" + rows(";", comma=True), "utf-8"),
    "tabs and decimal commas": ("t\tu\ty\n" + rows("\t", comma=True), "utf-8"),
    "spaces and decimal commas": ("t u y\n" + rows("  ", comma=True), "utf-8"),
    "bars": ("t|u|y\n" + rows("|"), "utf-8"),
    "a byte-order mark": ("t,u,y\n" + rows(), "utf-8-sig"),
    "UTF-16 of a spreadsheet": ("t\tu\ty\n" + rows("\t"), "utf-16"),
    "line ends of Windows": ("t,u,y\r\n" + rows(end="\r\n"), "utf-8"),
    "blank lines and a trailing separator": ("\n\nt,u,y,\n" + rows().replace("\n", ",\n"), "utf-8"),
    "a preamble": (
        "Logger 3000\nChannels,2\nRate,100\n\nt,u,y\n" + rows(), "utf-8",
    ),
    "a row of units": ("t,u,y\ns,V,rad\n" + rows(), "utf-8"),
    "a row of units in brackets": ("t;u;y\n[s];[V];[rad]\n" + rows(";"), "utf-8"),
    "remarks": ("# a rig\n% t u y\n" + rows(" "), "utf-8"),
    "quotes around numbers": (
        '"t";"u";"y"\n' + re.sub(r"([^;\n]+)", r'"\1"', rows(";", comma=True)), "utf-8",
    ),
    "quoted decimal commas between commas": (
        "t,u,y\n" + re.sub(r"([^;\n]+)", r'"\1"', rows(";", comma=True)).replace(";", ","), "utf-8",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_a_table_is_read_whatever_it_is_written_like(tmp_path, case):
    text, encoding = CASES[case]
    path = tmp_path / "run.csv"
    path.write_bytes(text.encode(encoding))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_columns(read_table(path))


def test_units_come_from_their_row_or_from_the_names(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t,u,y\n[s],[V],[rad]\n" + rows())
    assert read_table(path).units == {"t": "s", "u": "V", "y": "rad"}
    path.write_text("t,u,y\n[s],[V],[V]\n" + rows())  # units may repeat, names may not
    assert read_table(path).units == {"t": "s", "u": "V", "y": "V"}
    path.write_text("t,t,y\nt,u,y\n" + rows())
    assert list(read_table(path).columns) == ["t", "u", "y"]
    path.write_text("t [ms],u (V),y[2]\n" + rows())
    assert read_table(path).units == {"t [ms]": "ms", "u (V)": "V"}


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (("valve [1]", "p [bar(g)]"), {"valve [1]": "1", "p [bar(g)]": "bar(g)"}),
        (("motor [1]", "motor [2]"), {}),  # their numbers
        (("q[1]", "y"), {}),
        (("q [3]", "y"), {}),
    ],
)
def test_a_number_in_brackets_is_a_unit_if_it_may_be_none_of_several(tmp_path, names, units):
    path = tmp_path / "run.csv"
    path.write_text(",".join(("t", *names)) + "\n" + rows())
    assert read_table(path).units == units


def test_skipped_lines_and_decimal_commas_are_said(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Logger 3000\n\nt;u;y\n" + rows(";", comma=True))
    notes = " ".join(read_table(path).notes)
    assert "Skipped before the header: 1 line." in notes
    assert "decimal commas" in notes


@pytest.mark.parametrize(
    ("line", "columns", "said"),
    [
        ("{0};{1};{2}", (np.arange(30.0), np.arange(30.0) % 3, np.arange(30.0) ** 2), False),
        ("{0},5;{1};{2}", (np.arange(30) + 0.5, np.arange(30.0) % 3, np.arange(30.0) ** 2), True),
        ("{0},5;{1},25;{2}.25", (np.arange(30) + 0.5, np.arange(30) % 3 + 0.25, None), True),
        ("{0};{1},5;{2}.25", (np.arange(30.0), None, np.arange(30) ** 2 + 0.25), False),  # a tie
        ("{0}.5;{1},5;{2}.25", (np.arange(30) + 0.5, None, np.arange(30) ** 2 + 0.25), False),
    ],
)
def test_the_decimal_mark_is_that_of_most_cells_and_a_point_on_a_tie(tmp_path, line, columns, said):
    """Cells with the other mark are words, which a record refuses; None here."""
    path = tmp_path / "run.csv"
    text = "\n".join(line.format(k, k % 3, k * k) for k in range(30))
    path.write_text("t;u;y\n" + text)
    table = read_table(path)
    assert any("decimal commas" in note for note in table.notes) is said
    for values, want in zip(table.columns.values(), columns, strict=True):
        if want is None:
            assert values.dtype.kind not in "iuf"
        else:
            np.testing.assert_array_equal(values, want)


def test_an_umlaut_of_windows_is_read(tmp_path):
    path = tmp_path / "run.csv"
    path.write_bytes(("t,u,y [°]\n" + rows()).encode("cp1252"))
    check_columns(read_table(path), ("t", "u", "y [°]"))


def test_a_column_without_a_name_is_called_by_its_number(tmp_path):
    path = tmp_path / "run.csv"
    pd.DataFrame({"u": U, "y": Y}, index=T).to_csv(path)
    check_columns(read_table(path), ("0", "u", "y"))


def test_columns_of_words_stay_and_others_are_read(tmp_path):
    path = tmp_path / "run.csv"
    lines = rows().splitlines()
    lines = [f"{line},{'left' if k % 2 else 'right'}" for k, line in enumerate(lines)]
    path.write_text("t,u,y,state\n" + "\n".join(lines))
    table = read_table(path)
    assert list(table.columns["state"][:2]) == ["right", "left"]
    np.testing.assert_allclose(table.columns["y"], Y, atol=1e-12)
    path.write_text("\n".join(lines))  # without a header: no row is lost to it
    assert len(read_table(path).columns["0"]) == N


@pytest.mark.parametrize("words", ["Start", "1.000,0", "12:00 h"])
@pytest.mark.parametrize("first", ["01.05.2024 00:{0:02d}", "{0}", "0,{0:02d}"])
@pytest.mark.parametrize("count", [1, 12])
def test_words_in_the_first_rows_do_not_move_the_header(tmp_path, words, first, count):
    lines = [f"{first.format(k)};{k % 3};{words if k < count else f'{k},5'}" for k in range(30)]
    path = tmp_path / "run.csv"
    path.write_text("Logger 3000;;\nt;u;y\n;V;m\n" + "\n".join(lines))
    table = read_table(path)
    assert (*table.columns, len(table.columns["u"])) == ("t", "u", "y", 30)
    assert table.units == {"u": "V", "y": "m"}
    with pytest.raises(ValueError, match=rf"`y` must be a numeric .*, got '{words}' in line 4\."):
        read_record(path, "t", "u", "y")


@pytest.mark.parametrize("head", ["t,0,1", "0,1,y", "n,u,y\n1,1,m", "start,1.5,2.5"])
def test_numbers_may_be_names_and_units(tmp_path, head):
    path = tmp_path / "run.csv"
    path.write_text(head + "\n" + rows())
    check_columns(read_table(path), tuple(head.splitlines()[0].split(",")))


@pytest.mark.parametrize("key", ["1,", "S1,", "1,1,", ""])
@pytest.mark.parametrize("word", [".", "<0.5", "BLQ", "torn"])
@pytest.mark.parametrize("first", ["0", "0.0", "2.5"])
def test_a_first_row_with_a_word_for_a_value_is_no_row_of_units(tmp_path, key, word, first):
    path = tmp_path / "run.csv"
    stamps = [first, *map(str, np.arange(3.0, 15.0))]
    values = [word, *map(str, np.arange(12) % 5 + 0.25)]
    lines = [f"{key}{t},{y}" for t, y in zip(stamps, values, strict=True)]
    names = ["subject", "group"][: key.count(",")]
    path.write_text("\n".join([",".join([*names, "t", "y"]), *lines]))
    table = read_table(path)
    assert tuple(table.columns) == (*names, "t", "y")
    assert not table.units
    assert table.columns["t"][0] == float(first)
    if word != "torn":
        assert np.isnan(table.columns["y"][0])
        return
    with pytest.raises(ValueError, match=rf"`y` must be a numeric .*, got '{word}' in line 2\."):
        read_record(path, "t", (), "y")


def test_one_odd_cell_is_named_with_its_line_whatever_the_decimal_mark(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t;u;y\n" + rows(";", comma=True).replace("0,05;", "0,05;error", 1))
    with pytest.raises(
        ValueError, match=r"`u` must be a numeric column of .*, got 'error1' in line 7"
    ):
        read_record(path, "t", "u", "y")


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%fZ", "%d.%m.%Y %H:%M:%S,%f",
     "%d/%m/%Y %H:%M:%S.%f", "%m/%d/%Y %H:%M:%S.%f"],
)  # fmt: skip
def test_dates_count_in_seconds_from_the_first(tmp_path, form):
    # Over the end of a day after the twelfth: day and month cannot be taken for each other.
    stamps = pd.Timestamp("2024-05-30 23:59:59.800") + pd.to_timedelta(T, unit="s")
    path = tmp_path / "run.csv"
    lines = [f"{t.strftime(form)};{u:g};{y:.6f}" for t, u, y in zip(stamps, U, Y, strict=True)]
    path.write_text("when;u;y\n" + "\n".join(lines))
    record = read_record(path, "when", "u", "y")
    np.testing.assert_allclose(record.time, T, atol=1e-6)
    assert record.sample_period == pytest.approx(0.01)


def test_days_and_months_are_taken_so_that_time_increases(tmp_path):
    days = pd.date_range("2024-03-01", "2024-03-12", freq="6h")
    path = tmp_path / "run.csv"
    lines = [f"{day.strftime('%d/%m/%Y %H:%M')},{k % 3}" for k, day in enumerate(days)]
    path.write_text("when,y\n" + "\n".join(lines))
    record = read_record(path, "when", (), "y")
    assert record.sample_period == pytest.approx(6 * 3600)
    assert "order day, month" in " ".join(read_table(path).notes)


def test_times_of_day_go_on_over_midnight(tmp_path):
    seconds = (23 * 3600 + 59 * 60 + 50 + np.arange(N)) % 86400
    path = tmp_path / "run.csv"
    lines = [
        f"{s // 3600:02d}:{s // 60 % 60:02d}:{s % 60:02d},{y:.6f}"
        for s, y in zip(seconds, Y, strict=True)
    ]
    path.write_text("clock,y\n" + "\n".join(lines))
    np.testing.assert_allclose(read_record(path, "clock", (), "y").time, np.arange(N), atol=1e-9)
    assert "over 1 midnight" in " ".join(read_table(path).notes)


@pytest.mark.parametrize(("back", "nights"), [(11.5, 0), (12.5, 1)])
def test_a_clock_that_is_set_back_by_less_than_half_a_day_is_over_no_midnight(
    tmp_path, back, nights
):
    hours = [20.0, 20.5, 20.5 - back, 21.0 - back, *(21.0 - back + 0.1 * np.arange(1, 20))]
    path = tmp_path / "run.csv"
    lines = [f"{int(one)}:{round(60 * (one % 1)):02d}:00,{k}" for k, one in enumerate(hours)]
    path.write_text("clock,y\n" + "\n".join(lines))
    table = read_table(path)
    elapsed = (table.columns["clock"] - table.columns["clock"][0]).astype(float) / 3.6e12
    np.testing.assert_allclose(elapsed, np.array(hours) - 20.0 + 24.0 * nights * (
        np.arange(len(hours)) > 1), atol=1e-9)  # fmt: skip
    assert ("midnight" in " ".join(table.notes)) == bool(nights)


def dated(count, form="%d.%m.%Y %H:%M"):
    stamps = pd.date_range("2024-05-01 23:50", periods=count, freq="min")
    values = np.sin(0.2 * np.arange(count))
    return [f"{stamp.strftime(form)};{y:.4f}" for stamp, y in zip(stamps, values, strict=True)]


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%H:%M:%S"])
@pytest.mark.parametrize("end", [";", ";\n;\n\n;"])
def test_empty_rows_at_the_end_are_no_samples(tmp_path, form, end):
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["when;y", *dated(N, form), end]))
    table = read_table(path)
    assert len(table.columns["y"]) == len(table.columns["when"]) == N
    assert "Left out at the end: " in " ".join(table.notes)
    assert len(read_record(path, "when", (), "y").time) == N
    assert inspect(path).clock.column == "when"


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M", "%H:%M:%S"])
@pytest.mark.parametrize(("cell", "row"), [("Mittelwert", N), ("", 12), ("", 0), ("#NV", 5)])
def test_a_row_without_a_stamp_is_named_with_its_line_and_its_clock_stays(
    tmp_path, form, cell, row
):
    path = tmp_path / "run.csv"
    lines = dated(N, form)
    lines.insert(row, f"{cell};0.5")
    path.write_text("\n".join(["when;y", *lines]))
    with pytest.raises(
        ValueError,
        match=rf"`time\[when\]` must have a stamp in all rows .*, got none in line {row + 2}\.",
    ):
        read_record(path, "when", (), "y")
    if row in (0, N):
        rows = (1, None) if row == 0 else (0, N)
        assert len(read_record(path, "when", (), "y", slice=rows).time) == N
    found = inspect(path)
    assert (found.clock.column, found.outputs, found.samples) == ("when", ("y",), N)
    assert found.clock.sample_period == 60.0
    assert found.clock.backwards[0] == 0
    assert f"`when` has no stamp in row {row}, counted from 0" in found.advice[0]
    said = f"no stamp where it holds '{cell}' in row {row}" in " ".join(found.notes)
    assert said == (cell == "Mittelwert")


def test_a_time_in_numbers_may_lack_a_stamp_too(tmp_path):
    path = tmp_path / "run.csv"
    lines = rows().splitlines()
    path.write_text("\n".join(["t,u,y", *lines[:9], ",1,0.5", *lines[9:]]))
    with pytest.raises(
        ValueError, match=r"`time\[t\]` must have a stamp .*, got none in line 11\."
    ):
        read_record(path, "t", "u", "y")
    assert inspect(path).clock.column == "t"


def test_dates_are_no_inputs_and_no_outputs(tmp_path):
    path = tmp_path / "run.csv"
    lines = [f"{0.1 * k:.1f};{k % 28 + 1:02d}.05.2024;{np.sin(0.2 * k):.4f}" for k in range(60)]
    path.write_text("\n".join(["t;calibrated;y", *lines]))
    found = inspect(path)
    assert (found.clock.column, found.inputs, found.outputs) == ("t", (), ("y",))


def test_what_begins_like_dates_and_is_not_is_said(tmp_path):
    path = tmp_path / "run.csv"
    cells = ["2024-05-01", "10:00"]
    for cell in cells:
        lines = [cell if k < 15 else f"unknown {k}" for k in range(N)]
        path.write_text("when,y\n" + "\n".join(f"{a},{b}" for a, b in zip(lines, Y, strict=True)))
        assert "something else further down" in " ".join(read_table(path).notes)
        with pytest.raises(ValueError, match="`when` must be a numeric column"):
            read_record(path, "when", (), "y")


def test_thousands_of_columns_are_read(tmp_path):
    values = np.arange(20 * 3000).reshape(20, 3000) / 7
    path = tmp_path / "run.csv"
    np.savetxt(
        path, values, delimiter=",", header=",".join(f"c{i}" for i in range(3000)), comments=""
    )
    table = read_table(path)
    assert len(table.columns) == 3000
    np.testing.assert_allclose(table.columns["c2999"], values[:, 2999])


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (b"\x89PNG\r\n", "a PNG picture"), (b"PK\x03\x04", "spreadsheet"), (b"%PDF-1.4", "a PDF"),
        (b"\xd0\xcf\x11\xe0", "an old Excel file"), (b"PAR1", "a Parquet file"),
        (b"\x89HDF\r\n", "an HDF5 file"), (b"MATLAB 5.0 MAT-file", "a MATLAB file"),
        (b"\x1f\x8b\x08\x00", "compressed by gzip"), (b"\xff\xd8\xff\xe0", "a JPEG picture"),
    ],
)  # fmt: skip
def test_a_file_of_another_kind_is_called_by_its_kind(tmp_path, start, kind):
    path = tmp_path / "run.csv"
    path.write_bytes(start + bytes(200))
    with pytest.raises(ValueError, match=f"must be a readable .csv file, got .*run.csv.*{kind}"):
        read_table(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it holds no data"),
        ("\n\n", "it holds no data"),
        ("t,u,y\n", "it holds no data: one line of text only"),
        ("t,u,u,y,y\n1,2,3,4,5\n", "repeats a name: u, y; give each column its own"),
        ("t,u,y\n" + "1,2,3\n" * 9 + "1,2,3,4,5\n", "The reader says"),
    ],
)
def test_a_damaged_table_is_named(tmp_path, text, message):
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=message):
        read_record(path, "t", "u", "y")


def test_a_spreadsheet_is_read_or_says_what_it_needs(tmp_path, monkeypatch):
    path = tmp_path / "run.xlsx"
    with zipfile.ZipFile(path, "w") as book:
        book.writestr("xl/workbook.xml", "<workbook/>")
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(ValueError, match=r"needs openpyxl: pip install 'eoi_jax\[excel\]'"):
        read_table(path)


def test_a_sheet_with_titles_units_and_dates_is_read(tmp_path):
    pytest.importorskip("openpyxl", reason="openpyxl is not installed")
    stamps = pd.Timestamp("2024-05-30 10:00") + pd.to_timedelta(T, unit="s")
    frame = pd.DataFrame({"when": stamps, "u": U, "y": Y})
    path = tmp_path / "run.xlsx"
    with pd.ExcelWriter(path) as book:
        frame.to_excel(book, sheet_name="Log", startrow=2, index=False)
        pd.DataFrame({"remark": ["a rig"]}).to_excel(book, sheet_name="Remarks")
    record = read_record(path, "when", "u", "y")
    np.testing.assert_allclose(record.time, T, atol=2e-6)
    np.testing.assert_allclose(record.outputs[:, 0], Y, atol=1e-12)
    note = "Read from the sheet `Log`; `sheet` chooses another: `Remarks`."
    assert note in read_table(path).notes


def test_the_sheet_of_an_excel_file_can_be_chosen(tmp_path):
    pytest.importorskip("openpyxl", reason="openpyxl is not installed")
    path = tmp_path / "run.xlsx"
    with pd.ExcelWriter(path) as book:
        titles = pd.DataFrame(["A protocol of ours", "by two people"])
        titles.to_excel(book, sheet_name="Info", index=False, header=False)
        for number in (1, 2):
            frame = pd.DataFrame({"t": T, "u": U, "y": number * Y})
            frame.to_excel(book, sheet_name=f"Run {number}", index=False)
    others = r"Read from the sheet `Info`; `sheet` chooses another: `Run 1`, `Run 2`\."
    with pytest.raises(ValueError, match=f"It holds A protocol of ours. {others}"):
        inspect(path)
    with pytest.raises(ValueError, match=f"`time` must be a column of .*{others}"):
        read_record(path, "t", "u", "y")
    with pytest.raises(
        ValueError, match="no sheet `Run 3` that holds anything; those that do: `Info`, `Run 1`, `R"
    ):
        read_record(path, "t", "u", "y", sheet="Run 3")
    for number in (1, 2):
        outputs = read_record(path, "t", "u", "y", sheet=f"Run {number}").outputs
        np.testing.assert_allclose(outputs[:, 0], number * Y, atol=1e-12)
        assert inspect(path, sheet=f"Run {number}").outputs == ("y",)
    (tmp_path / "run.csv").write_text("t,u,y\n" + rows())
    with pytest.raises(ValueError, match="`sheet` must be left out for a file without sheets"):
        read_record(tmp_path / "run.csv", "t", "u", "y", sheet="Run 1")


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    separator=st.sampled_from([";", "\t", ",", "|", "  "]),
    comma=st.booleans(),
    header=st.booleans(),
    units=st.booleans(),
    preamble=st.sampled_from(["", "Logger 7\n\n", "# a remark\n", "Rate [Hz]: 9\nBy: me\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
    end=st.sampled_from(["\n", "\r\n"]),
    trailing=st.booleans(),
    values=st.lists(
        st.tuples(
            st.floats(-1e6, 1e6, allow_subnormal=False),
            st.integers(-10_000, 10_000),
            st.floats(-1, 1, allow_subnormal=False),
        ),
        min_size=3, max_size=12,
    ),
)  # fmt: skip
def test_no_number_is_lost_or_changed_by_the_way_a_table_is_written(
    tmp_path, separator, comma, header, units, preamble, encoding, end, trailing, values
):
    comma = comma and separator != ","
    cells = [[f"{a:.4f}", f"{b}.5", f"{c:.6e}"] for a, b, c in values]
    if comma:
        cells = [[cell.replace(".", ",") for cell in row] for row in cells]
    head = [["first", "second", "third"]] if header else []
    head += [["s", "V", "rad"]] if header and units else []
    last = separator if trailing and separator.strip() else ""
    text = preamble if header else ""
    text += "".join(separator.join(row) + last + "\n" for row in [*head, *cells])
    path = tmp_path / "run.csv"
    path.write_bytes(text.replace("\n", end).encode(encoding))
    table = read_table(path)
    assert list(table.columns) == (head[0] if header else ["0", "1", "2"])
    read = np.stack(list(table.columns.values()), axis=1)
    written = [[float(cell.replace(",", ".")) for cell in row] for row in cells]
    np.testing.assert_allclose(read, written, rtol=1e-14, atol=0)
