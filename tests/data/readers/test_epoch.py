"""Stamps since 1970 in a file."""

import numpy as np
import pandas as pd
import pytest

import eoi_jax as eoi
from eoi_jax.data.inspection import inspect


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e-3), ("µs", 1e-6)])
def test_stamps_that_cannot_be_seconds_are_refused_with_their_scale(tmp_path, unit, factor):
    path = tmp_path / "log.csv"
    stamps = np.round((1.7e9 + 0.05 * np.arange(100)) / factor)
    rows = "".join(f"{stamp:.0f},{k % 7},{k % 5}\n" for k, stamp in enumerate(stamps))
    path.write_text("t,u,y\n" + rows)
    rule = rf"`time\[t\]` must be in seconds, got 1\.7e\+1\d\. .*{unit} since 1970: give `scale` "
    with pytest.raises(ValueError, match=rule + rf"\{{t: {factor:g}\}}"):
        eoi.read_record(path, time="t", inputs=["u"], outputs=["y"])
    record = eoi.read_record(path, time="t", inputs=["u"], outputs=["y"], scale={"t": factor})
    assert record.sample_period == pytest.approx(0.05)


def test_seconds_since_1970_are_read_as_they_are(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{1.7e9 + 2 * k:.0f},{k % 7},{k % 5}\n" for k in range(100))
    path.write_text("t,u,y\n" + rows)
    record = eoi.read_record(path, time="t", inputs=["u"], outputs=["y"])
    assert record.sample_period == pytest.approx(2.0)


@pytest.mark.parametrize(("first", "program"), [(45300.0, "a spreadsheet"), (739000.0, "MATLAB")])
def test_dates_in_days_are_told_where_they_are_read_in_seconds(tmp_path, first, program):
    path = tmp_path / "log.csv"
    days = first + np.arange(100) / 1440.0  # a minute each
    rows = "".join(f"{day:.9f},{k % 7},{k % 5}\n" for k, day in enumerate(days))
    path.write_text("t,u,y\n" + rows)
    record = eoi.read_record(path, "t", "u", "y")
    assert any(f"dates of {program} in days" in note for note in record.notes)
    record = eoi.read_record(path, "t", "u", "y", scale={"t": 86400})
    assert record.sample_period == pytest.approx(60.0)
    assert not any("in days" in note for note in record.notes)
    assert inspect(path).clock.sample_period == pytest.approx(60.0, rel=1e-4)
    path.write_text("t [s],u,y\n" + rows)
    assert not any("in days" in note for note in eoi.read_record(path, "t [s]", "u", "y").notes)


def test_local_dates_that_have_an_hour_twice_are_refused_with_the_reason(tmp_path):
    path = tmp_path / "log.csv"
    local = pd.date_range("2024-10-26", periods=200, freq="15min", tz="Europe/Berlin")

    def written(form):
        rows = "".join(f"{stamp},{k % 7},{k % 5}\n" for k, stamp in enumerate(local.strftime(form)))
        path.write_text("t,u,y\n" + rows)

    written("%Y-%m-%d %H:%M")
    with pytest.raises(ValueError, match=r"`time\[t\]` must increase, .* daylight saving time"):
        eoi.read_record(path, time="t", inputs=["u"], outputs=["y"])
    part = eoi.read_record(path, time="t", inputs=["u"], outputs=["y"], slice=(0, 100))
    assert part.sample_period == 900.0  # before the clock is put back
    written("%Y-%m-%d %H:%M%z")
    record = eoi.read_record(path, time="t", inputs=["u"], outputs=["y"])
    np.testing.assert_allclose(record.time, 900.0 * np.arange(200))
