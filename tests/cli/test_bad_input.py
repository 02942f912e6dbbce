"""Every mistake a user can make ends in one sentence, the right status, and no file."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eoi_jax.cli import actions
from eoi_jax.cli.commands import app
from eoi_jax.compiler import jax_setup
from eoi_jax.estimation import sweep as sweeps

CONFIG = """
name = "run"
plant = "mass_spring_damper"

[observer]
kind = "second_order"
c1 = 20.0
c2 = 100.0
c3 = 5000.0

[lowpass]
cutoff = 50.0

[data]
files = ["record.csv"]
time = "t"
inputs = ["u"]
outputs = ["y"]
"""


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def columns(samples: int = 2000) -> dict[str, np.ndarray]:
    t = 0.005 * np.arange(samples)
    return {"t": t, "u": np.sign(np.sin(3.0 * t)), "y": 0.01 * np.sin(3.0 * t)}


def prepared(folder: Path, *changes: tuple[str, str], **replaced: np.ndarray) -> Path:
    """A folder with a config, changed in places, and its record, with some columns replaced."""
    text = CONFIG
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    table = {**columns(), **replaced}
    rows = zip(*table.values(), strict=True)
    lines = [",".join(str(float(value)) for value in row) for row in rows]
    (folder / "record.csv").write_text("\n".join([",".join(table), *lines]))
    path = folder / "config.toml"
    path.write_text(text)
    return path


def refused(path: Path, status: int, *said: str) -> None:
    """`eoi identify` ends with `status`, says each of `said`, and leaves no file."""
    output = path.parent / "runs"
    done = CliRunner().invoke(app, ["identify", str(path), "--output", str(output)])
    assert done.exit_code == status, done.output
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    for part in said:
        assert part in done.stderr
    assert not output.exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("[lowpass]\ncutoff", "[lowpass]\ncut_off"), ("[lowpass]", "'cut_off'", "`cutoff`")),
        (("c3 = 5000.0", "c3 = 0.0"), ("`observer.c3`", "> 0", "0.0")),
        (("c1 = 20.0", "c1 = -20.0"), ("`observer.c1`", "> 0", "-20.0")),
        (('time = "t"', "sample_period = -0.005"), ("`data.sample_period`", "> 0", "-0.005")),
        (('"mass_spring_damper"', '"mas_spring_damper"'), ("`plant`", "`mass_spring_damper`")),
        (("cutoff = 50.0", 'cutoff = "low"'), ("`lowpass.cutoff`", "a number", "'low'")),
        (('inputs = ["u"]', 'inputs = ["force"]'), ("force", "u")),
        (('time = "t"\n', ""), ("time", "sample_period")),
        (('["record.csv"]', '["absent.csv"]'), ("`data.files`", "absent.csv", "--data")),
        (('["record.csv"]', "[]"), ("files",)),
        (('outputs = ["y"]', 'outputs = ["y"]\nunits = { y = "mm" }'), ("'m'", "'mm'")),
        (('outputs = ["y"]', 'outputs = ["y"]\nslice = [0, 1]'), ("at least 8", "1")),
    ],
)
def test_a_wrong_config_is_refused_with_status_2(
    tmp_path: Path, change: tuple[str, str], said: tuple[str, ...]
):
    refused(prepared(tmp_path, change), 2, *said)


def test_an_output_of_nan_is_refused(tmp_path: Path):
    refused(prepared(tmp_path, y=np.full(2000, np.nan)), 2, "y", "finite")


def test_a_record_of_one_sample_is_refused(tmp_path: Path):
    one = {key: values[:1] for key, values in columns().items()}
    refused(prepared(tmp_path, **one), 2, "at least 8", "1")


def test_a_file_that_is_not_what_its_name_says_is_refused(tmp_path: Path):
    path = prepared(tmp_path, ("record.csv", "record.mat"))
    (tmp_path / "record.mat").write_text("no MATLAB file")
    refused(path, 2, "record.mat")


def test_a_file_of_an_unknown_kind_is_refused(tmp_path: Path):
    path = prepared(tmp_path, ("record.csv", "record.xyz"))
    (tmp_path / "record.xyz").write_text("")
    refused(path, 2, "record.xyz", ".csv")


def test_an_output_folder_that_is_a_file_is_refused(tmp_path: Path):
    path = prepared(tmp_path)
    (tmp_path / "file").write_text("")
    done = CliRunner().invoke(app, ["identify", str(path), "--output", str(tmp_path / "file")])
    assert done.exit_code == 2
    assert "`--output` must be a folder" in done.stderr


@pytest.fixture
def no_work(monkeypatch: pytest.MonkeyPatch):
    """A command that gets as far as its work fails."""
    works = [(actions, name) for name in ("run_passes", "run_discovery", "inspect_file")]
    for module, name in (*works, (sweeps.sweep, "sweep")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("it began to work"))


@pytest.mark.parametrize("command", ["identify", "discover", "refine", "sweep", "inspect", "init"])
def test_an_output_folder_that_cannot_be_made_is_noticed_before_the_work(
    command: str, tmp_path: Path, no_work: None
):
    path = prepared(tmp_path)
    if command in ("inspect", "init"):
        path = path.with_name("record.csv")
    (tmp_path / "file").write_text("")
    place = tmp_path / "file" / "new" / "run.toml"
    done = CliRunner().invoke(app, [command, str(path), "--output", str(place)])
    assert done.exit_code == 2
    assert "`--output` must be a folder that can be created and written" in done.stderr
    assert f"({tmp_path / 'file'} is a file), got {place.parent}" in done.stderr
    assert {one.name for one in tmp_path.iterdir()} == {"config.toml", "record.csv", "file"}


def test_a_name_too_long_for_a_folder_is_noticed_before_the_work(tmp_path: Path, no_work: None):
    path = prepared(tmp_path, ('name = "run"', f'name = "{300 * "n"}"'))
    refused(path, 2, "`name` must be short enough for a folder", "nnn")
    file = tmp_path / f"{245 * 'n'}.csv"
    (tmp_path / "record.csv").rename(file)
    done = CliRunner().invoke(app, ["inspect", str(file), "--output", str(tmp_path / "runs")])
    assert "`file` must be short enough for a folder" in done.stderr
    assert not (tmp_path / "runs").exists()


def test_constant_input_and_output_give_no_answer_and_say_why(tmp_path: Path):
    still = prepared(tmp_path, u=np.zeros(2000), y=np.full(2000, 0.01))
    refused(still, 1, "no answer", "no_data", "position", "constant throughout")


def test_with_json_a_refusal_is_one_object_too(tmp_path: Path):
    path = prepared(tmp_path, ("c3 = 5000.0", "c3 = 0.0"))
    done = CliRunner().invoke(app, ["identify", str(path), "--json"])
    assert done.exit_code == 2
    assert "`observer.c3`" in json.loads(done.stdout)["error"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("identify --nope --json", "No such option: --nope"),
        ("identify --passes 0 --json", "Invalid value for '--passes'"),
        ("discover --json a.toml b.toml", "unexpected extra argument"),
        ("inspect --json", "Missing argument"),
        ("--nope identify --json", "No such option: --nope"),
        ("identfy --json", "No such command 'identfy'"),
    ],
)
def test_with_json_a_wrong_call_is_one_object_too(words: str, said: str):
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code == 2
    assert said in json.loads(done.stdout)["error"]
    assert done.stderr
    plain = CliRunner().invoke(app, [word for word in words.split() if word != "--json"])
    assert (plain.exit_code, plain.stdout) == (2, "")


@pytest.mark.parametrize(
    "arguments", [["identify", "--passes", "0"], ["identify", "--pases", "3"], ["idenify"]]
)
def test_a_wrong_call_is_refused_with_status_2(arguments: list[str]):
    assert CliRunner().invoke(app, arguments).exit_code == 2


def test_the_process_itself_ends_with_status_2_and_no_traceback(tmp_path: Path):
    path = prepared(tmp_path, ("c3 = 5000.0", "c33 = 5000.0"))
    done = subprocess.run(
        [sys.executable, "-c", "from eoi_jax.cli.main import main; main()", "identify", path.name],
        cwd=tmp_path,
        env={**os.environ, "EOI_CACHE": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stdout == ""
    sentence = (
        "eoi: `a key of [observer]` must be one of kind, c1, c2, c3, scheme, got 'c33'. "
        "Did you mean `c3`?\n"
    )
    assert done.stderr == sentence
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("ending", ["sys.exit(0)", "raise SystemExit", "raise RuntimeError('no')"])
def test_a_plant_file_that_ends_the_program_is_an_error(tmp_path: Path, ending: str):
    path = prepared(tmp_path, ('"mass_spring_damper"', '"own.py:rig"'))
    (tmp_path / "own.py").write_text(f"import sys\nprint('noise')\n{ending}\n")
    done = CliRunner().invoke(app, ["identify", str(path), "--output", str(tmp_path / "runs")])
    assert (done.exit_code, done.stdout) == (2, "")
    assert '`plant` must be "file.py:object" that runs, got own.py:rig' in done.stderr
    assert not (tmp_path / "runs").exists()


def test_brackets_without_end_and_names_that_are_none_are_refused(tmp_path: Path):
    path = prepared(tmp_path, ('["record.csv"]', f'["{"x" * 5000}"]'))
    refused(path, 2, "`data.files`")
    path.write_text(f"x = {'[' * 5000}{']' * 5000}")
    refused(path, 2, "`config` must be a TOML file", "nested too deeply")
    path.write_text("[" + ".".join("a" * 3000) + "]")
    refused(path, 2, "`config` must have at most 20 levels of nested tables and lists")
    path.write_text(f"x = {'[' * 21}{']' * 21}")
    refused(path, 2, "`config` must have at most 20 levels of nested tables and lists")
    path = prepared(tmp_path, ('name = "run"', r'name = "run\n"'))
    refused(path, 2, "`name`", r"'run\n'")


@pytest.mark.parametrize("name", [b"r\xff\xfen.csv", b"a\x1b[31m\nb.csv"])
def test_a_file_whose_name_is_no_text_is_inspected(tmp_path: Path, name: bytes):
    rows = zip(*columns(200).values(), strict=True)
    path = tmp_path / os.fsdecode(name)
    path.write_text("\n".join(["t,u,y", *(",".join(map(str, row)) for row in rows)]))
    words = ["inspect", str(path), "--output", str(tmp_path / "runs"), "--json"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["samples"] == 200
    (folder,) = (tmp_path / "runs").iterdir()
    assert json.loads((folder / "inspect.json").read_text())["path"] == str(path)
    done = CliRunner().invoke(app, ["init", str(path), "--output", str(tmp_path / "a.toml")])
    if b"\xff" in name:
        assert done.exit_code == 2
        assert "`file` must have a name in Unicode" in done.stderr
        assert not (tmp_path / "a.toml").exists()
