"""A run takes the place of an earlier run only: no other file is replaced or removed."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import check_replaceable, files_of_run
from eoi_jax.compiler import jax_setup

RULE = "`--output` must lead to a folder in which nothing but an earlier run of the command is"
CONFIG = 'name = "rig"\nplant = "pendulum"\n\n[data]\nfiles = ["runs/rig/run1.csv"]\n'
FORMER = {"identify": "config.toml", "sweep": "config.toml", "inspect": "inspect.json",
          "validate": "validate.json", "predict": "predict.json"}  # fmt: skip


def eoi(*words: object):
    return CliRunner().invoke(app, [str(word) for word in words])


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def former_run(folder: Path, command: str, *others: str) -> Path:
    folder.mkdir()
    (folder / FORMER[command]).write_text(f"# eoi {command} rig.toml\n")
    for name in others:
        (folder / name).touch()
    return folder


@pytest.fixture
def records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of measured files that has the name of the run."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(jax_setup, "configure", lambda: None)
    folder = tmp_path / "runs" / "rig"
    folder.mkdir(parents=True)
    rows = [f"{0.01 * k},{np.sin(k)},{np.cos(0.1 * k)}" for k in range(300)]
    (folder / "run1.csv").write_text("\n".join(["time,voltage,angle", *rows]))
    (tmp_path / "rig.toml").write_text(CONFIG)
    return folder


@pytest.mark.parametrize("command", ["identify", "refine", "discover", "sweep"])
def test_a_folder_of_records_is_no_place_for_a_run(records: Path, command: str):
    done = eoi(command, "rig.toml")
    assert done.exit_code == 2
    text = f"{RULE} replaced, got runs/rig, which holds run1.csv. Give another folder with --output"
    assert text in done.stderr
    assert names(records) == ["run1.csv"]


def test_neither_is_a_file(records: Path, tmp_path: Path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "rig").write_text("mine")
    done = eoi("identify", "rig.toml", "--output", "out")
    assert done.exit_code == 2
    assert f"{RULE} replaced, got out/rig, a file." in done.stderr
    assert (tmp_path / "out" / "rig").read_text() == "mine"


@pytest.mark.parametrize("command", ["validate", "predict", "compare"])
def test_free_runs_of_a_saved_model_replace_no_file(records: Path, tmp_path: Path, command: str):
    place = tmp_path / "runs" / f"rig.{command}"
    place.mkdir()
    (place / "mine.csv").touch()
    runs = [records]
    if command == "compare":
        runs.append(tmp_path / "runs" / "other")
        runs[1].mkdir()
    done = eoi(command, *runs, records / "run1.csv")
    assert done.exit_code == 2
    assert f"{place.relative_to(tmp_path)}, which holds mine.csv" in done.stderr
    assert names(place) == ["mine.csv"]


def test_an_inspection_replaces_its_own_files(records: Path, tmp_path: Path):
    place = tmp_path / "runs" / "run1.inspect"
    place.mkdir()
    (place / "mine.csv").touch()
    done = eoi("inspect", records / "run1.csv")
    assert done.exit_code == 2
    assert "runs/run1.inspect, which holds mine.csv" in done.stderr
    (place / "mine.csv").unlink()
    (place / ".hidden").touch()
    for _ in range(2):
        assert eoi("inspect", records / "run1.csv").exit_code == 0
        (place / "mine.csv").touch()
        (place / "inspect.png").unlink()
    assert eoi("inspect", records / "run1.csv").exit_code == 0
    assert names(place) == [".hidden", "inspect.json", "inspect.png", "inspect.txt", "mine.csv"]


def test_files_beside_a_run_may_not_have_the_names_of_the_next_one(tmp_path: Path):
    run = former_run(tmp_path / "rig", "identify", "report.txt", "figure.png", "notes.txt")
    assert files_of_run(run) == ["config.toml", "figure.png"]
    check_replaceable(run, "identify")
    with pytest.raises(ValueError, match=r"which holds report\.txt"):
        check_replaceable(run, "refine")
    (run / "report.txt").unlink()
    check_replaceable(run, "refine")
    (tmp_path / "rig.identify").mkdir()
    for k in range(5):
        (tmp_path / "rig.identify" / f"{k}.csv").touch()
    with pytest.raises(
        ValueError, match=r"identify, which holds 0\.csv, 1\.csv, 2\.csv and 2 others"
    ):
        check_replaceable(run, "refine")
    check_replaceable(run, "identify")


def test_a_sweep_takes_the_place_of_a_sweep_only(tmp_path: Path):
    run = former_run(tmp_path / "rig", "identify", "figure.png")
    with pytest.raises(ValueError, match=r"which holds config\.toml, figure\.png"):
        check_replaceable(run, "sweep")
    (tmp_path / "begun" / "sweep.zarr").mkdir(parents=True)
    check_replaceable(tmp_path / "begun", "sweep")
    check_replaceable(former_run(tmp_path / "swept", "sweep", "sweep.json", "a.csv"), "sweep")
