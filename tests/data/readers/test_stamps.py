"""Dates and times of day as historians and loggers write them."""

import numpy as np
import pandas as pd
import pytest

from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.read_record import read_record, read_table

SIGNAL = np.sin(0.2 * np.arange(400))


def written(path, stamps, form, head="Date;Time"):
    rows = [f"{text};{y:.4f}" for text, y in zip(stamps.strftime(form), SIGNAL, strict=False)]
    path.write_text("\n".join([f"{head};y", *rows]) + "\n")
    return path


def over_a_weekend():
    stamps = pd.date_range("2025-11-27 20:00", periods=400, freq="15min")
    return stamps[(stamps.day != 29) & (stamps.day != 30)]


@pytest.mark.parametrize("form", ["%Y-%m-%d;%H:%M:%S", "%d.%m.%y;%H:%M", "%m/%d/%Y;%I:%M:%S %p"])
def test_times_of_day_are_of_the_dates_beside_them(tmp_path, form):
    stamps = over_a_weekend()
    path = written(tmp_path / "run.csv", stamps, form)
    inspection = inspect(path)
    assert inspection.clock.column == "Time"
    assert inspection.clock.gaps == (1, 2 * 86400 + 900.0)
    record = read_record(path, "Time", (), "y")
    expected = (stamps[-1] - stamps[0]) / pd.Timedelta("1s")
    assert record.time[-1] == expected
    assert record.valid.sum() == len(stamps)
    assert "combined with the dates of `Date`" in " ".join(record.notes)


def test_dates_that_are_not_those_of_the_times_are_not_used(tmp_path):
    stamps = pd.date_range("2025-11-27 20:00", periods=100, freq="15min")
    path = written(tmp_path / "run.csv", stamps, "2025-11-20;%H:%M")  # of a calibration
    record = read_record(path, "Time", (), "y")
    np.testing.assert_allclose(record.time, 900.0 * np.arange(100))
    assert "the dates of `Date` are not those of these times" in " ".join(record.notes)


def test_summer_time_is_seen_in_two_columns(tmp_path):
    local = pd.date_range("2025-10-25 20:00", periods=100, freq="15min", tz="Europe/Berlin")
    path = written(tmp_path / "run.csv", local, "%d.%m.%Y;%H:%M")
    assert "have an hour twice" in " ".join(inspect(path).advice)
    with pytest.raises(ValueError, match=r"`time\[Time\]` must increase, .* daylight saving time"):
        read_record(path, "Time", (), "y")


def test_days_are_no_clock_beside_times(tmp_path):
    path = written(tmp_path / "run.csv", over_a_weekend(), "%Y-%m-%d;%H:%M")
    with pytest.raises(ValueError, match=r"days, each several times. Name the .* times: Time"):
        read_record(path, "Date", (), "y")


def test_columns_of_dates_and_times_stay_what_they_are_alone(tmp_path):
    stamps = pd.date_range("2025-11-27", periods=100, freq="D")
    path = written(tmp_path / "run.csv", stamps, "%Y-%m-%d", head="Date")
    assert read_table(path).columns["Date"].dtype.kind == "M"
    assert read_record(path, "Date", (), "y").sample_period == 86400.0


@pytest.mark.parametrize(
    "form", ["%d-%b-%y %H:%M:%S", "%d-%b-%Y %H:%M:%S.0", "%d %B %Y %H:%M", "%d-%b-%Y %I:%M:%S %p"]
)
@pytest.mark.parametrize("german", [False, True])
def test_months_may_have_names(tmp_path, form, german):
    stamps = pd.date_range("2025-09-27", periods=100, freq="25h20min")
    path = written(tmp_path / "run.csv", stamps, form, head="Timestamp")
    words = {"Oct": "Okt", "Dec": "Dez"} if german else {}
    text = path.read_text()
    for english, word in words.items():
        text = text.replace(english, word)
    path.write_text(text)
    record = read_record(path, "Timestamp", (), "y")
    np.testing.assert_allclose(record.time, 91200.0 * np.arange(100))


def test_a_first_row_with_a_word_of_a_historian_is_no_header(tmp_path):
    stamps = pd.date_range("2025-11-27", periods=50, freq="5min")
    path = written(tmp_path / "run.csv", stamps, "%d-%b-%y %H:%M:%S;5.5", head="Timestamp;T")
    path.write_text(path.read_text().replace("5.5", "Pt Created", 1).replace(".", ","))
    table = read_table(path)
    assert tuple(table.columns) == ("Timestamp", "T", "y")
    assert len(table.columns["T"]) == 50
    assert np.isnan(table.columns["T"]).sum() == 1


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S", "%Y-%m-%d %H:%M", "%d-%b-%y %H:%M"])
@pytest.mark.parametrize("words", [("CEST", "CET"), ("MESZ", "MEZ")])
def test_the_name_of_a_time_zone_is_its_offset(tmp_path, form, words):
    local = pd.date_range("2025-10-25", periods=200, freq="15min", tz="Europe/Berlin")
    path = written(tmp_path / "run.csv", local, f"{form} %Z", head="Zeit")
    path.write_text(path.read_text().replace("CEST", words[0]).replace("CET", words[1]))
    record = read_record(path, "Zeit", (), "y")
    np.testing.assert_allclose(record.time, 900.0 * np.arange(200))
    assert f"{words[0]} (+02:00), {words[1]} (+01:00)" in " ".join(read_table(path).notes)


def test_a_word_behind_all_times_does_not_matter(tmp_path):
    stamps = pd.date_range("2025-10-25", periods=50, freq="15min")
    path = written(tmp_path / "run.csv", stamps, "%d.%m.%Y %H:%M Uhr", head="Zeit")
    assert read_record(path, "Zeit", (), "y").sample_period == 900.0
    assert "`Zeit` has `UHR` behind all its times: left out" in " ".join(read_table(path).notes)


@pytest.mark.parametrize(
    ("words", "message"),
    [(("", " UTC"), r"a time zone in some rows only \(`UTC`\)"),
     ((" AAT", " BBT"), "the time zones `AAT`, `BBT`")],
)  # fmt: skip
def test_time_zones_that_cannot_be_told_are_named(tmp_path, words, message):
    stamps = pd.date_range("2025-10-25", periods=50, freq="15min")
    path = written(tmp_path / "run.csv", stamps, "%Y-%m-%d %H:%M", head="Zeit")
    rows = path.read_text().replace(";y", ":y", 1).split(";")
    ends = [words[0] if k < 20 else words[1] for k in range(50)]
    text = "".join(f"{row}{end};" for row, end in zip(rows, ends, strict=False)) + rows[-1]
    path.write_text(text.replace(":y", ";y", 1))
    with pytest.raises(ValueError, match=f"`time` must be readable .* {message}: .* offset"):
        read_record(path, "Zeit", (), "y")


def test_names_that_do_not_fit_the_columns_are_told(tmp_path):
    path = tmp_path / "run.txt"
    path.write_text("t y\n" + "".join(f"{k} {k % 7} {k % 5}\n" for k in range(50)))
    assert "has 2 names for 3 columns: left out" in " ".join(read_table(path).notes)


@pytest.mark.parametrize("period", [0.1, 1.0, 60.0])
@pytest.mark.parametrize("start", [0.0, 45210.0, 86300.0])  # the last one passes midnight
def test_times_of_day_as_numbers_are_recognised(tmp_path, period, start):
    elapsed = period * np.arange(1500)
    day = np.round(start + elapsed, 1) % 86400
    cells = [f"{t // 3600:02.0f}{t % 3600 // 60:02.0f}{t % 60:04.1f}" for t in day]
    cells[7] = ""  # without a fix
    path = tmp_path / "nmea.csv"
    lines = [f"{cell},{k % 7},{k % 5}" for k, cell in enumerate(cells)]
    path.write_text("\n".join(["UTC,u,y", *lines]))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["u"], np.arange(1500) % 7)
    assert inspect(path).clock.column == "UTC"
    path.write_text("\n".join(["UTC,u,y", *lines[:7], *lines[8:]]))
    record = read_record(path, "UTC", "u", "y")
    assert record.sample_period == pytest.approx(period)
    assert record.time[-1] == pytest.approx(elapsed[-1])
    assert any("`UTC` holds times of day as numbers hhmmss." in note for note in record.notes)


@pytest.mark.parametrize(
    ("name", "stamps"),
    [
        ("UTC [s]", 100.0 * np.arange(60)),
        ("time", np.arange(60.0)),
        ("time", 30.0 * np.arange(60)),
        ("time", np.append(np.arange(40.0), 100.0 + np.arange(40.0))),  # a pause
        ("time", 100.0 * np.arange(50)),
        ("level", 50.0 * np.repeat(np.arange(40), 3)),
    ],
)
def test_seconds_and_signals_are_no_times_of_day(tmp_path, name, stamps):
    path = tmp_path / "run.csv"
    path.write_text("\n".join([f"{name},y", *(f"{t},{k % 5}" for k, t in enumerate(stamps))]))
    np.testing.assert_array_equal(read_table(path).columns[name], stamps)


QUARTERS = pd.date_range("2026-01-05 00:15", periods=400, freq="15min")


@pytest.mark.parametrize("form", ["%d.%m.%Y;%H:%M", "%d.%m.%Y %H:%M", "%Y-%m-%dT%H:%M:%S"])
@pytest.mark.parametrize("separator", [";", ","])
def test_24_00_is_the_end_of_its_day(tmp_path, form, separator):
    form = form.replace(";", separator)
    stamps = [
        (day - pd.Timedelta("1h")).strftime(form).replace("23:00", "24:00")
        if (day.hour, day.minute) == (0, 0)
        else day.strftime(form)
        for day in QUARTERS
    ]
    path, head = tmp_path / "meter.csv", "Date;Time" if separator in form else "Time"
    lines = [f"{stamp}{separator}{k % 7}" for k, stamp in enumerate(stamps)]
    path.write_text("\n".join([f"{head};y".replace(";", separator), *lines]))
    table = read_table(path)
    np.testing.assert_array_equal(table.columns["Time"], QUARTERS.to_numpy())
    record = read_record(path, "Time", outputs="y")
    assert record.sample_period == 900.0
    if ";" not in form and "," not in form:
        assert "`Time` has 24:00 4 times: the end of a day, read as 00:00" in record.notes[-1]


@pytest.mark.parametrize("dash", ["-", "–"])
@pytest.mark.parametrize("end", ["%H:%M", "%d.%m.%Y %H:%M"])
@pytest.mark.parametrize(("zone", "separator"), [("", ","), (" CET", ";")])
def test_an_interval_counts_at_its_start(tmp_path, dash, end, zone, separator):
    ends = QUARTERS + pd.Timedelta("15min")
    pairs = zip(QUARTERS, ends, strict=True)
    stamps = [f"{a:%d.%m.%Y %H:%M} {dash} {b.strftime(end)}{zone}" for a, b in pairs]
    path = tmp_path / "market.csv"
    lines = [f"{stamp}{separator}{k % 7}{separator}{k % 5}" for k, stamp in enumerate(stamps)]
    path.write_text("\n".join(["Time,u,y".replace(",", separator), *lines]))
    expected = QUARTERS - pd.Timedelta("1h" if zone else "0h")
    np.testing.assert_array_equal(read_table(path).columns["Time"], expected.to_numpy())
    record = read_record(path, "Time", "u", "y")
    said = f"`Time` holds intervals, such as '{stamps[0]}': each counts at its start."
    assert any(said in note for note in record.notes)
