"""The command: what it prints, writes and returns; a run is written whole or not at all."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eoi_jax import _atomic
from eoi_jax._atomic import write_folder
from eoi_jax._status import Status
from eoi_jax.cli import actions, build, html_report
from eoi_jax.cli import config as configs
from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import files_beside_run
from eoi_jax.compiler import jax_setup
from eoi_jax.data.record import Record

SHORT = """
name = "short"
plant = "pendulum"

[identify]
passes = 4

[simulate]
sample_period = 0.002
duration = 8.0
increments = { a = 5.0, b = -0.8, c = -0.2, d = -4.0 }

[simulate.input.voltage]
kind = "square"
amplitude = 0.2
frequency = 0.25
"""
TRUTH = {"a": 81.0, "b": 1.7, "c": 0.3}
FILES = {"result.json", "figure.png", "config.toml", "result.npz", "report.npz", "report.html"}


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(SHORT)
    return path


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch):
    """Without the page, which another test of the same run has."""
    monkeypatch.setattr(html_report, "write_report", lambda folder: folder)


def eoi(*arguments: object):
    return CliRunner().invoke(app, [str(one) for one in arguments])


def test_a_run_prints_its_table_and_writes_its_files(config: Path, tmp_path: Path):
    done = eoi("identify", config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    folder = tmp_path / "runs" / "short"
    assert {path.name for path in folder.iterdir()} == FILES
    assert files_beside_run(folder) == []  # the next run replaces all of them
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["short"]
    assert "estimate" in done.stdout
    assert "P(angle)" in done.stdout
    assert str(folder) in done.stdout
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    head, _, copied = (folder / "config.toml").read_text().partition("\n")
    assert head == f"# eoi identify {config}"
    assert copied == SHORT


def test_json_is_one_object_that_holds_what_a_program_needs(config: Path, tmp_path: Path, undrawn):
    done = eoi("identify", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result == json.loads((tmp_path / "runs" / "short" / "result.json").read_text())
    for name, value in TRUTH.items():  # 2 ms is coarse for an 81 rad²/s² pendulum: 1 %
        assert result["parameters"][name] == pytest.approx(value, rel=0.01)
    assert set(result["versions"]) == {"eoi_jax", "jax", "numpy", "python"}
    assert len(result["index"]) == len(result["increments"]) <= 4
    assert result["index"][result["best_pass"] - 1] == min(result["index"])
    assert result["config"]["simulate"]["input"]["voltage"]["kind"] == "square"
    assert len(result["records"][0]["hash"]) == 16
    assert result["status"]["code"] in ("converged", "passes_exhausted")
    assert result["validation"] is None


@pytest.mark.slow
@pytest.mark.parametrize("command", [actions.identify, actions.discover, actions.refine])
def test_every_kind_of_work_is_shown_from_nothing_on(config: Path, tmp_path: Path, command):
    seen: dict[str, list[tuple[int, int | None]]] = {}

    def shown(kind: str, done: int, total: int | None, text: str) -> None:
        assert isinstance(text, str)
        seen.setdefault(kind, []).append((done, total))

    passes = (2, False) if command is actions.identify else ()
    command(config, None, tmp_path / "runs", *passes, shown)
    assert next(iter(seen)) == "reading"
    for steps in seen.values():
        done = [one for one, _ in steps]
        assert done[0] == 0
        assert all(total is None or one <= total for one, total in steps)


def test_an_inspection_is_shown_from_nothing_on(tmp_path: Path):
    record = Record(0.01 * np.arange(300), np.ones(300), np.sin(np.arange(300.0)))
    write_csv(tmp_path / "run.csv", record)
    seen = []
    actions.inspect(tmp_path / "run.csv", tmp_path / "runs", lambda *told: seen.append(told))
    assert seen == [("reading", 0, None, ""), ("drawing", 0, None, "")]


def test_quiet_prints_only_the_folder(config: Path, tmp_path: Path, undrawn):
    done = eoi("identify", config, "--output", tmp_path / "runs", "--quiet")
    assert done.exit_code == 0
    assert done.stdout == f"{tmp_path / 'runs' / 'short'}\n"


def test_passes_of_the_call_replace_those_of_the_config(config: Path, tmp_path: Path, undrawn):
    done = eoi("identify", config, "--output", tmp_path / "runs", "--json", "--passes", 1)
    result = json.loads(done.stdout)
    assert len(result["index"]) == 1
    assert result["config"]["identify"]["passes"] == 1
    written = (tmp_path / "runs" / "short" / "config.toml").read_text()
    assert written.startswith(f"# eoi identify {config} --passes 1\n")


def test_parameters_over_time_are_written_where_asked_for(config: Path, tmp_path: Path):
    runs = tmp_path / "runs"
    done = eoi("identify", config, "--output", runs, "--json", "--recursive")
    result = json.loads(done.stdout)
    assert result["drifts"] == []
    lines = (runs / "short" / "history.csv").read_text().splitlines()
    assert lines[0].startswith("sample,record,time,")
    last = dict(zip(lines[0].split(","), lines[-1].split(","), strict=True))
    for name, value in result["parameters"].items():
        end = (
            value
            + result["increments"][result["best_pass"] - 1][list(result["parameters"]).index(name)]
        )
        np.testing.assert_allclose(float(last[name]), end, rtol=1e-6)
    assert (runs / "short" / "history.png").stat().st_size > 10_000
    assert files_beside_run(runs / "short") == []
    assert eoi("report", runs / "short").exit_code == 0
    assert "Parameters over time" in (runs / "short" / "report.html").read_text()
    written = (runs / "short" / "config.toml").read_text()
    assert written.startswith(f"# eoi identify {config} --recursive\n")


def test_forgetting_without_recursion_is_refused(config: Path, tmp_path: Path):
    config.write_text(config.read_text().replace("[identify]", "[identify]\nforgetting = 0.99"))
    done = eoi("identify", config, "--output", tmp_path / "runs")
    assert done.exit_code == 2
    assert "`identify.recursive` must be true where `forgetting` is below 1" in done.stderr


def test_a_held_out_record_is_validated(config: Path, tmp_path: Path):
    settings = configs.load(config)
    (record,) = build.records(settings, build.plant(settings, tmp_path), tmp_path)
    write_csv(tmp_path / "record.csv", record)
    simulate = SHORT.index("[simulate]")
    config.write_text(SHORT[:simulate] + MEASURED)
    done = eoi("identify", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    # The record is noise-free and the free run starts from an estimated state.
    assert result["validation"]["fit"]["angle"] > 98
    assert [one["samples"] for one in result["held_out_records"]] == [2000]


MEASURED = """
[data]
files = ["record.csv"]
time = "time"
inputs = ["voltage"]
outputs = ["angle"]
units = { voltage = "V", angle = "rad" }

[validation]
files = ["record.csv"]
slice = [500, 2500]
"""


def write_csv(path: Path, record: Record) -> None:
    rows = zip(record.time, record.inputs[:, 0], record.outputs[:, 0], strict=True)
    lines = [",".join(repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join(["time,voltage,angle", *lines]))


def test_what_is_masked_in_a_held_out_record_is_told(config: Path, tmp_path: Path, undrawn):
    settings = configs.load(config)
    (record,) = build.records(settings, build.plant(settings, tmp_path), tmp_path)
    write_csv(tmp_path / "record.csv", record)
    rows = (tmp_path / "record.csv").read_text().splitlines()
    for row in (900, 901):
        rows[row] = rows[row].rpartition(",")[0] + ",n/a"
    (tmp_path / "later.csv").write_text("\n".join(rows))
    fitted, _, held_out = MEASURED.partition("[validation]")
    held_out = f"[validation]{held_out}".replace("record.csv", "later.csv")
    config.write_text(SHORT[: SHORT.index("[simulate]")] + fitted + held_out)
    done = eoi("identify", config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    assert "- later: 2 of 2000 samples are not finite (`angle` 2): masked\n" in done.stdout


def test_an_identification_without_an_answer_says_so(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    whole = actions.run_passes

    def diverged(*arguments, **options):
        found = whole(*arguments, **options)
        status = Status("diverged", "it does not stay finite")
        return replace(found, status=status, unexplained=np.full(1, np.nan))

    monkeypatch.setattr(actions, "run_passes", diverged)
    done = eoi("identify", config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert result["error"] == "no answer (diverged: it does not stay finite)"
    assert result["answer"] == "No answer: diverged: it does not stay finite"
    assert not (tmp_path / "runs").exists()


# -- all or nothing ---------------------------------------------------------------------------


def test_a_run_is_replaced_only_by_a_whole_new_one(tmp_path: Path):
    folder = tmp_path / "runs" / "one"

    def fill(draft: Path) -> None:
        (draft / "new").write_text("new")

    def fail(draft: Path) -> None:
        (draft / "half").write_text("half")
        raise KeyboardInterrupt

    folder.mkdir(parents=True)
    (folder / "old").write_text("old")
    with pytest.raises(KeyboardInterrupt):
        write_folder(folder, fail)
    assert [path.name for path in folder.iterdir()] == ["old"]
    write_folder(folder, fill, lambda folder: ["old"])
    assert [path.name for path in folder.iterdir()] == ["new"]
    assert [path.name for path in folder.parent.iterdir()] == ["one"]


def test_a_run_in_place_of_that_of_another_command_says_so(config: Path, tmp_path: Path, undrawn):
    output = ("--output", tmp_path / "runs")
    told = []
    for arguments in (("identify", config), ("refine", config), ("refine", config)):
        result = eoi(*arguments, *output)
        assert result.exit_code == 0, result.output
        told.append([line for line in result.stdout.splitlines() if "It replaced" in line])
        (tmp_path / "runs" / "short" / "notes.txt").write_text("mine")
    (name,) = (path.name for path in (tmp_path / "runs").iterdir() if "." not in path.name)
    kept = tmp_path / "runs" / f"{name}.identify"
    identified = f"It replaced the run of `eoi identify {config}`; that is now in {kept}/."
    identified += f" Of no run, and still in {kept.with_name('short')}/: notes.txt."
    assert told == [[], [identified], []]
    assert (kept / "config.toml").read_text().startswith("# eoi identify")
    assert not (kept / "notes.txt").exists()
    assert (tmp_path / "runs" / "short" / "notes.txt").read_text() == "mine"
    assert eoi("report", kept).exit_code == 0
    result = eoi("identify", config, *output, "--json")
    assert "It replaced" not in result.stdout


def test_an_old_run_returns_if_the_exchange_itself_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    folder = tmp_path / "one"
    folder.mkdir()
    (folder / "old").write_text("old")
    rename = Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self.name == "new":
            raise OSError("disk full")
        return rename(self, target)

    monkeypatch.setattr(_atomic, "_exchange", lambda *_: False)
    monkeypatch.setattr(Path, "rename", refuse)
    with pytest.raises(OSError, match="disk full"):
        write_folder(folder, lambda draft: None)
    assert [path.name for path in folder.iterdir()] == ["old"]
    assert [path.name for path in tmp_path.iterdir()] == ["one"]


def test_an_interrupt_ends_with_130_and_leaves_nothing(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(actions, "run_passes", interrupted)
    done = eoi("identify", config, "--output", tmp_path / "runs")
    assert done.exit_code == 130
    assert "no partly written files remain" in done.stderr
    assert not (tmp_path / "runs").exists()


# -- as a process -----------------------------------------------------------------------------


@pytest.mark.slow
def test_the_installed_command_runs_the_built_in_pendulum_in_an_empty_folder(tmp_path: Path):
    environment = {**os.environ, "EOI_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", "from eoi_jax.cli.main import main; main()", "identify", "--json"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    # Within 0.2 % of each increment of Table 9.
    for name, increment in {"a": 5.0, "b": -0.8, "c": -0.2, "d": -4.0}.items():
        change = result["parameters"][name] - result["nominal"][name]
        assert change == pytest.approx(increment, rel=2e-3)
    assert {path.name for path in (tmp_path / "runs" / "pendulum").iterdir()} == FILES
    assert any("no config was given: this is the built-in ex" in note for note in result["notes"])
    assert done.stderr == ""


def test_a_config_has_the_sheet_that_was_chosen(tmp_path: Path):
    pytest.importorskip("openpyxl", reason="openpyxl is not installed")
    pd = pytest.importorskip("pandas")
    time = 0.01 * np.arange(300)
    path, target = tmp_path / "rig.xlsx", tmp_path / "rig.toml"
    with pd.ExcelWriter(path) as book:
        pd.DataFrame(["A protocol"]).to_excel(book, sheet_name="Info", index=False, header=False)
        for name, size in (("First run", 1.0), ("Second run", 2.0)):
            columns = {"t": time, "u": np.sign(np.sin(9 * time)), "y": size * np.sin(3 * time)}
            pd.DataFrame(columns).to_excel(book, sheet_name=name, index=False)
    assert "`sheet` chooses another: `First run`" in eoi("inspect", path).output
    result = eoi("inspect", path, "--sheet", "First run", "--output", tmp_path)
    assert result.exit_code == 0, result.output
    result = eoi("init", path, "--sheet", "First run", "--output", target)
    assert result.exit_code == 0, result.output
    target.write_text(target.read_text() + '\n[test]\nsheet = "Second run"\nslice = [0, 300]\n')
    settings = configs.load(target)
    model = build.plant(settings, tmp_path)
    (fitted,) = build.records(settings, model, tmp_path, None)
    (unseen,) = build.unseen_records(settings, model, tmp_path, None)
    assert np.max(fitted.outputs) == pytest.approx(1.0, abs=1e-3)
    assert np.max(unseen.outputs) == pytest.approx(2.0, abs=1e-3)


def test_version_is_printed():
    done = eoi("--version")
    assert done.exit_code == 0
    assert done.stdout.startswith("eoi_jax 0.")


def test_the_command_lists_its_verbs():
    command = typer.main.get_command(app)
    assert "identify" in command.commands  # type: ignore[attr-defined]
