"""Rows of one stamp that fill different cells are merged; topics below each other are told."""

import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.cli import actions
from eoi_jax.data.inspection import inspect

N = 400
TIME = 0.05 * np.arange(N)
U = np.repeat(np.random.default_rng(5).uniform(0.0, 9.0, N // 20), 20).round(2)
Y = np.sin(0.3 * TIME).round(4) + 10.0
MERGED = "Rows of one stamp that fill different cells, as of topics with a row each, are merged"


def rows(order, topic=""):
    """Lines of a log with a row for each topic: numbers of the sample and of the topic."""
    names = (("drive", "throttle", "speed"), ("gps", "speed", "throttle"))
    lines = []
    for k, j in order:
        cells = f"{U[k]:g}," if j == 0 else f",{Y[k]:g}"
        lines.append(f"{TIME[k]:.2f},{names[j][0] + ',' if topic else ''}{cells}")
    return f"time,{topic}throttle,speed\n" + "\n".join(lines) + "\n"


JOINED = [(k, j) for k in range(N) for j in range(2)]
STACKED = [(k, j) for j in range(2) for k in range(N)]


def test_rows_that_complete_each_other_are_one_sample():
    stamps, u, y = np.repeat(TIME, 2), np.full((2 * N, 1), np.nan), np.full((2 * N, 1), np.nan)
    u[::2, 0], y[1::2, 0] = U, Y
    with pytest.warns(eoi.RecordWarning, match=f"{MERGED}: 400 of 800"):
        record = eoi.Record(stamps, u, y)
    np.testing.assert_array_equal(record.time, TIME)
    np.testing.assert_array_equal(record.inputs[:, 0], U)
    np.testing.assert_array_equal(record.outputs[:, 0], Y)
    assert record.valid.all()


def test_two_values_of_a_channel_at_one_stamp_are_refused_with_their_rows():
    stamps, y = np.repeat(TIME, 3), np.repeat(Y, 3)
    y[1::3] = np.nan
    y[32] += 0.1
    rule = "must not repeat with different values, got 0.5 s at index 30 and at index 32"
    with pytest.raises(ValueError, match=rule):
        eoi.Record(stamps, np.zeros((3 * N, 0)), y)


@pytest.mark.parametrize("topic", ["", "topic,"])
def test_a_log_with_a_row_for_each_topic_is_read_inspected_and_drafted(tmp_path, topic):
    path = tmp_path / "log.csv"
    path.write_text(rows(JOINED, topic))
    with pytest.warns(eoi.RecordWarning, match=MERGED):
        record = eoi.read_record(path, "time", "throttle", "speed")
    assert len(record) == N
    assert record.valid.all()
    found = inspect(path)
    assert found.clock.column == "time"
    assert (found.inputs, found.outputs, found.samples) == (("throttle",), ("speed",), 2 * N)
    assert f"{MERGED}: 400 of 800 with the row before." in found.advice
    assert not any(channel.missing for channel in found.channels)
    text = actions.init([path], tmp_path / "log.toml", False).text
    assert "masked" not in text
    assert "slice = [0, 560]" in (tmp_path / "log.toml").read_text()


def test_topics_below_each_other_are_told_with_what_to_do(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(rows(STACKED))
    told = r"\(throttle from row 0; speed from row 400, .*Sort the rows, as `sort_values\('time'\)`"
    with pytest.raises(ValueError, match=f"`file` must have its rows in the order of time.*{told}"):
        actions.init([path], tmp_path / "log.toml", False)
    (line,) = (line for line in inspect(path).advice if "Time goes back" in line)
    assert "topics are one below the other" in line


def test_a_logger_that_was_started_again_has_no_topics_below_each_other(tmp_path):
    path = tmp_path / "log.csv"
    lines = [f"{TIME[k % N]:.2f},{U[k % N]:g},{Y[k % N]:g}" for k in range(2 * N)]
    path.write_text("time,throttle,speed\n" + "\n".join(lines) + "\n")
    assert any("If the logger started again there" in line for line in inspect(path).advice)
