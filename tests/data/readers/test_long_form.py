"""Rows of several tags below each other are told from other times that do not increase."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.read_record import read_record

STAMPS = pd.date_range("2025-11-29", periods=100, freq="5min")
SIGNAL = np.sin(0.2 * np.arange(100))


def long_form(path, order, tags=("level", "valve"), ascending=True, stamps: Any = STAMPS):
    frames = [
        pd.DataFrame({"Time": stamps[k :: k + 1], "Tag": tag, "Value": SIGNAL[k :: k + 1] + k})
        for k, tag in enumerate(tags)
    ]
    frame = pd.concat(frames).sort_values(order, kind="stable", ascending=ascending)
    frame.to_csv(path, index=False)
    return path


@pytest.mark.parametrize(
    ("order", "ascending"), [(["Time", "Tag"], True), (["Tag", "Time"], True), (["Time"], False)]
)
def test_rows_of_several_tags_are_told_with_what_to_do(tmp_path, order, ascending):
    path = long_form(tmp_path / "log.csv", order, ascending=ascending)
    said = r"The rows of 2 tags are mixed, which `Tag` tells apart \(.*: give each a column .*pivot"
    with pytest.raises(ValueError, match=rf"`time\[Time\]` must be the clock of one .* {said}"):
        read_record(path, "Time", (), "Value")
    assert "rows of 2 tags are mixed" in " ".join(inspect(path).advice)


def test_tags_of_several_subjects_are_told_too(tmp_path):
    """Here time neither increases in most rows nor begins anew with each tag."""
    path = tmp_path / "study.csv"
    rows = [(k, t, tag) for k in (1, 2) for t in range(12) for tag in ("glucose", "insulin")]
    frame = pd.DataFrame(rows, columns=["id", "time", "variable"])
    frame.assign(value=np.sin(np.arange(len(rows)))).to_csv(path, index=False)
    said = r"pivot\(index=\['id', 'time'\], columns='variable', values=…\)"
    with pytest.raises(ValueError, match=said):
        read_record(path, "time", (), "value")
    inspection = inspect(path)
    assert inspection.clock.column == "time"
    assert inspection.clock.why.startswith("its name says so, and it repeats between tags")
    assert inspection.inputs == ()
    assert any("2 tags are mixed" in advice for advice in inspection.advice)


def test_rows_of_a_single_tag_may_be_read(tmp_path):
    path = long_form(tmp_path / "log.csv", ["Tag", "Time"])
    assert len(read_record(path, "Time", (), "Value", slice=(0, 100))) == 100


def test_runs_that_begin_at_zero_are_no_tags(tmp_path):
    path = long_form(tmp_path / "log.csv", ["Tag", "Time"], stamps=np.arange(100.0))
    assert "mixed" not in " ".join(inspect(path).advice)
    with pytest.raises(ValueError, match=r"`time` must increase.*`parts`"):
        read_record(path, "Time", (), "Value")


def test_an_hour_twice_is_no_tag_of_its_own(tmp_path):
    path = tmp_path / "log.csv"
    local = pd.date_range("2025-10-25", periods=200, freq="15min", tz="Europe/Berlin")
    text = local.strftime("%Y-%m-%d %H:%M")
    season = ["summer" if stamp.dst() else "winter" for stamp in local]
    pd.DataFrame({"t": text, "season": season, "y": np.sin(0.1 * np.arange(200))}).to_csv(path)
    with pytest.raises(ValueError, match="daylight saving time"):
        read_record(path, "t", (), "y")


@pytest.mark.parametrize(("name", "is_tag"), [("TagName", True), ("Tag", False)])
def test_stamps_of_changes_need_not_repeat(tmp_path, name, is_tag):
    path = tmp_path / "log.csv"
    tags = np.where(np.arange(100) % 3 == 0, "level", "valve")
    pd.DataFrame({"t": 0.1 * np.arange(100), name: tags, "Value": SIGNAL}).to_csv(path, index=False)
    assert ("tags are mixed" in " ".join(inspect(path).advice)) == is_tag
