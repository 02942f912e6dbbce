"""`eoi report`: a page anew from the run's folder alone, or a sentence on what is wrong with it."""

import dataclasses
import json
import webbrowser
from pathlib import Path

import pytest
from found import Jerk
from report_runs import discovered, explained
from typer.testing import CliRunner

from eoi_jax.cli import html_report
from eoi_jax.cli.commands import app
from eoi_jax.discovery.result import Added


def run_command(*arguments: object):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.fixture(scope="module")
def found():
    return explained()


@pytest.fixture(scope="module")
def written(found, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return discovered(tmp_path_factory.mktemp("runs") / "one", found)


@pytest.fixture
def run(written: Path, tmp_path: Path) -> Path:
    """A copy, to be spoilt."""
    folder = tmp_path / "one"
    folder.mkdir()
    for path in written.iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    return folder


@pytest.mark.slow
def test_the_page_is_made_anew_the_same_without_model_or_data(run):
    first = (run / "report.html").read_text()
    (run / "report.html").unlink()
    done = run_command("report", run)
    assert done.exit_code == 0, done.output
    assert done.stdout == f"{run / 'report.html'}\n"
    assert (run / "report.html").read_text() == first
    assert not list(run.glob("*.part"))


def test_json_says_where_the_page_is(run):
    done = run_command("report", run, "--json")
    assert json.loads(done.stdout) == {"report": str(run / "report.html")}


def test_open_shows_it_in_the_browser(run, monkeypatch: pytest.MonkeyPatch):
    shown = []
    monkeypatch.setattr(webbrowser, "open", shown.append)
    assert run_command("report", run, "--open").exit_code == 0
    assert shown == [(run / "report.html").as_uri()]


def test_what_repeats_the_run_is_in_it(run):
    page = (run / "report.html").read_text()
    summary = json.loads((run / "discovery.json").read_text())
    config = (run / "config.toml").read_text()
    assert config.startswith("# eoi discover mine.toml\n")
    assert "eoi discover mine.toml" in page
    assert "plant = &#34;mass_spring_damper&#34;" in page
    for name, number in summary["versions"].items():
        assert f"{name} {number}" in page
    for one in (*summary["records"], *summary["held_out_records"]):
        assert one["hash"] in page


def test_an_effect_of_the_users_own_needs_not_be_there(found, tmp_path):
    own = Added(Jerk(5), "position", {"jerk": 1.0}, {"jerk": 0.1}, "a jerk")
    result = dataclasses.replace(found, added=(own,), effects=("jerk",))
    assert "a jerk" in (discovered(tmp_path / "own", result) / "report.html").read_text()


def test_an_older_page_stays_where_a_new_one_cannot_be_written(run, monkeypatch):
    before = (run / "report.html").read_text()

    def full(self: Path, *arguments: object, **options: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "write_text", full)
    done = run_command("report", run)
    assert done.exit_code == 2
    assert "disk full" in done.stderr
    assert (run / "report.html").read_text() == before


def without(name: str):
    return lambda folder: (folder / name).unlink()


def changed(**entries: object):
    def change(folder: Path) -> None:
        path = folder / "discovery.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **entries}))

    return change


SPOILT = [
    (without("discovery.json"), "`RUN` must hold discovery.json or result.json"),
    (without("result.npz"), "`RUN` must hold result.npz"),
    (without("report.npz"), "`RUN` must hold report.npz"),
    (without("config.toml"), "`RUN` must hold config.toml"),
    (lambda folder: (folder / "discovery.json").write_text('{"name": "on'),
     "`RUN` must hold a complete discovery.json"),
    (lambda folder: (folder / "discovery.json").write_text("[1, 2]"),
     "`RUN` must hold a complete discovery.json"),
    (lambda folder: (folder / "discovery.json").write_bytes(b"\xff\xfe\x00"),
     "`RUN` must hold a complete discovery.json"),
    (changed(format=None), "of format none (an older version)"),
    (changed(format=99), "of format 99"),
    (changed(kind="divine"), "`RUN` must be of format"),
    (changed(versions=None), "`RUN` must hold a complete discovery.json"),
    (lambda folder: (folder / "result.npz").write_bytes(b"PK\x03\x04 half"),
     "must be a result that `save` wrote"),
    (lambda folder: (folder / "result.npz").write_bytes((folder / "report.npz").read_bytes()),
     "`RUN` must hold the result.npz of discover"),
    (lambda folder: (folder / "sweep.json").write_text("{}"), "a run of sweep"),
]  # fmt: skip


@pytest.mark.parametrize(("spoil", "message"), SPOILT, ids=[text for _, text in SPOILT])
def test_a_folder_that_is_no_whole_run_ends_with_2_and_a_sentence(run, spoil, message):
    (run / "report.html").unlink()
    spoil(run)
    done = run_command("report", run, "--json")
    assert done.exit_code == 2
    assert message in done.stderr
    assert message in json.loads(done.stdout)["error"]
    assert not (run / "report.html").exists()


@pytest.mark.parametrize("what", ["none", "a file", "an empty folder"])
def test_what_is_no_folder_of_a_run_is_said(tmp_path, what):
    path = tmp_path / "x"
    if what == "a file":
        path.write_text("")
    if what == "an empty folder":
        path.mkdir()
    done = run_command("report", path)
    assert done.exit_code == 2
    wanted = "must hold" if what == "an empty folder" else "must be the folder of a run"
    assert wanted in done.stderr
    assert str(path) in done.stderr


def test_results_stay_where_the_page_fails(found, tmp_path, monkeypatch):
    def broken(folder: Path) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(html_report, "write_report", broken)
    with pytest.raises(OSError, match="disk full"):
        discovered(tmp_path / "kept", found)
    assert (tmp_path / "kept" / "discovery.json").is_file()
