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
    expected = (stamps[-1] - stamps[0]).total_seconds()
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
