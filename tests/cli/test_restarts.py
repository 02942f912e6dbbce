"""A logger that was started again: its parts are records of their own."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from eoi_jax.cli import build, new_files, template
from eoi_jax.cli.commands import app
from eoi_jax.cli.config import load
from eoi_jax.compiler import jax_setup
from eoi_jax.data.inspection import inspect

H, DECAY, GAIN = 0.005, 2.0, 3.0


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def rows(samples: int, seed: int, first_ms: int) -> list[str]:
    """y' = -2 y + 3 u with a held input, in closed form from sample to sample."""
    u = np.random.default_rng(seed).uniform(-1.0, 1.0, samples // 50 + 1).repeat(50)[:samples]
    y, share = np.zeros(samples), np.exp(-DECAY * H)
    for k in range(samples - 1):
        y[k + 1] = share * y[k] + (1.0 - share) * GAIN / DECAY * u[k]
    return [f"{first_ms + 5 * k},{u[k]:.6f},{y[k]:.9f}" for k in range(samples)]


def written(folder: Path, name: str, *lengths: int) -> Path:
    lines = [row for i, n in enumerate(lengths) for row in rows(n, i, 7 if i else 51000)]
    path = folder / name
    path.write_text("\n".join(["millis,pwm,speed", *lines]) + "\n")
    return path


def drafted(folder: Path, *files: Path) -> dict:
    target = folder / "run.toml"
    target.write_text(template.checked(template.draft([inspect(f) for f in files], target), target))
    return tomllib.loads(target.read_text())


def test_a_clock_that_restarts_is_found_and_its_duration_is_that_of_the_parts(tmp_path):
    found = inspect(written(tmp_path, "log.csv", 700, 500))
    assert (found.clock.column, found.clock.factor) == ("millis", 1e-3)
    assert found.parts == ((0, 700), (700, 1200))
    assert found.clock.duration == pytest.approx((699 + 499) * H)
    assert "`parts` of [data] in a config reads the parts as records" in str(found)


def test_a_clock_of_any_name_is_found_by_its_equal_steps(tmp_path):
    path = written(tmp_path, "log.csv", 1200, 900)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(["a,b,c", *lines[1:5], *lines[4:]]))  # one stamp twice
    found = inspect(path)
    assert (found.clock.column, found.clock.repeated, found.clock.backwards[0]) == ("a", 1, 1)
    assert found.clock.why.startswith("it mostly increases, in equal steps")
    counts = np.floor(8.3 * np.arange(2100)).astype(int)  # of an encoder at constant speed
    counts[1000:] -= counts[1000]
    rows = [f"{n}{line[line.index(',') :]}" for n, line in zip(counts, lines[1:], strict=True)]
    path.write_text("\n".join(["a,b,c", *rows]))
    assert inspect(path).clock.column is None


def test_the_draft_of_one_file_holds_its_last_part_out(tmp_path):
    tables = drafted(tmp_path, written(tmp_path, "log.csv", 700, 600, 500))
    assert tables["data"]["parts"] == {"log.csv": [[0, 700], [700, 1300]]}
    assert tables["validation"] == {"parts": {"log.csv": [[1300, 1800]]}}


def test_the_draft_of_a_log_of_events_declares_the_holds_of_its_inputs(tmp_path):
    """Without them its inputs would have no value in most rows."""
    time = np.cumsum(np.random.default_rng(0).integers(1, 5, 600))
    row = np.arange(len(time))
    valve = np.where(row % 23 % 14 == 0, 50.0 + 20.0 * np.sin(row), np.nan)
    air = np.where(row % 7 == 0, 10.0 + np.sin(0.003 * time), np.nan)
    level = np.sin(0.01 * time)
    path = tmp_path / "run.csv"
    columns = {"t": time, "valve": valve, "ambient": air, "level": level}
    pd.DataFrame(columns).to_csv(path, index=False)
    text = template.draft([inspect(path)], tmp_path / "run.toml")
    (tmp_path / "run.toml").write_text(text)
    config = load(tmp_path / "run.toml")
    assert config.data is not None
    assert config.data.hold == {"valve": "zero", "ambient": "linear"}
    (record,) = build.records(config, build.plant(config, tmp_path), tmp_path)
    assert record.input_valid.mean() > 0.9


def test_the_draft_of_two_files_holds_the_last_file_out(tmp_path):
    files = written(tmp_path, "a.csv", 700, 600), written(tmp_path, "b.csv", 500)
    tables = drafted(tmp_path, *files)
    assert tables["data"]["parts"] == {"a.csv": [[0, 700], [700, 1300]]}
    assert tables["validation"] == {"files": ["b.csv"]}
    tables = drafted(tmp_path, *files[::-1])
    assert "parts" not in tables["data"]
    assert tables["validation"]["parts"] == {"a.csv": [[0, 700], [700, 1300]]}


def test_a_part_that_is_too_short_is_left_out(tmp_path):
    tables = drafted(tmp_path, written(tmp_path, "log.csv", 40, 600))
    assert tables["data"]["slice"] == [40, 460]
    assert tables["validation"]["slice"] == [460, 640]


def test_an_estimate_from_parts_is_that_of_the_system(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, "log.csv", 1200, 900, 800)
    assert CliRunner().invoke(app, ["init", "log.csv"]).exit_code == 0
    done = CliRunner().invoke(app, ["identify", "log.toml", "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert [record["name"] for record in found["records"]] == ["log, part 1", "log, part 2"]
    assert found["parameters"]["decay"] == pytest.approx(DECAY, rel=1e-3)
    assert found["parameters"]["gain"] == pytest.approx(GAIN, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("parts =", "slice = [0, 9]\nparts ="), "`data.slice` must be left out where `parts`"),
        (('parts = { "log.csv"', 'parts = { "lag.csv"'), "`data.parts` must be one of log.csv"),
        (("parts =", "# parts ="), r"`time` must increase, got .*, or `parts` .*log\.csv\."),
    ],
)
def test_wrong_parts_are_named(tmp_path, change, message):
    drafted(tmp_path, written(tmp_path, "log.csv", 700, 600, 500))
    path = tmp_path / "run.toml"
    path.write_text(path.read_text().replace(*change, 1))
    config = load(path)
    plant = build.plant(config, tmp_path)
    with pytest.raises(ValueError, match=message):
        build.records(config, plant, tmp_path)


def test_held_out_files_take_over_only_parts_of_their_own(tmp_path):
    drafted(tmp_path, written(tmp_path, "a.csv", 700, 600), written(tmp_path, "b.csv", 500))
    config = load(tmp_path / "run.toml")
    plant = build.plant(config, tmp_path)
    assert [len(record) for record in build.records(config, plant, tmp_path)] == [700, 600]
    assert [len(record) for record in build.validation_records(config, plant, tmp_path)] == [500]


def test_new_data_of_a_saved_model_are_divided_where_the_logger_restarts(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    drafted(tmp_path, written(tmp_path, "a.csv", 700), written(tmp_path, "b.csv", 500))
    config = load(tmp_path / "run.toml")
    plant = build.plant(config, tmp_path)
    new = [written(tmp_path, "new.csv", 400, 30, 300), tmp_path / "a.csv"]
    found = new_files.records_of_files(config, plant, new)
    assert [record.name for record in found] == ["new, part 1", "new, part 2", "a"]
    assert [len(record) for record in found] == [400, 300, 700]


def test_a_draft_without_a_clock_asks_for_the_sample_period_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = written(tmp_path, "log.csv", 300).read_text().splitlines()
    (tmp_path / "log.csv").write_text("\n".join(line.partition(",")[2] for line in lines))
    done = CliRunner().invoke(app, ["init", "log.csv"])
    said = "next: insert the sample_period [s], which the file does not tell, then eoi identify"
    assert said in " ".join(done.output.split())
    first = (tmp_path / "log.toml").read_text().splitlines()[0]
    assert first.endswith("from log.csv: insert the sample_period below, then run:")
