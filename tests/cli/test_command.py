"""The command as a process: help, completion, colours, progress, interrupts."""

import json
import os
import pty
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from eoi_jax.cli import build, exports
from eoi_jax.cli.commands import app
from eoi_jax.cli.config import load
from eoi_jax.cli.options import complete_config, complete_data
from eoi_jax.cli.terminal import progress, say, shell_word
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.simulation.export import LANGUAGES

START = [sys.executable, "-m", "eoi_jax.cli"]
COMMANDS = sorted(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
COLOUR = re.compile(r"\x1b\[[0-9;]*3[0-8][0-9;]*m")


def environment(tmp_path: Path, **more: str) -> dict[str, str]:
    known = {key: value for key, value in os.environ.items() if not key.startswith("_TYPER")}
    for key in ("NO_COLOR", "FORCE_COLOR", "PY_COLORS", "GITHUB_ACTIONS"):
        known.pop(key, None)
    cache = str(tmp_path.parent / "cache")  # one for all tests of this process
    return {**known, "EOI_CACHE": cache, "TERM": "xterm-256color", **more}


def call(tmp_path: Path, *words: str, **more: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*START, *words],
        cwd=tmp_path,
        env=environment(tmp_path, **more),
        capture_output=True,
        text=True,
        timeout=120,
    )


def on_a_terminal(tmp_path: Path, *words: str, **more: str) -> tuple[int, str]:
    """Exit status and everything that appears on a terminal of its own."""
    ours, theirs = pty.openpty()
    done = subprocess.Popen(
        [*START, *words],
        cwd=tmp_path,
        env=environment(tmp_path, **more),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    shown = b""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        if select.select([ours], [], [], 0.2)[0]:
            try:
                piece = os.read(ours, 65536)
            except OSError:  # the other side is closed
                break
            if not piece:
                break
            shown += piece
        elif done.poll() is not None:
            break
    os.close(ours)
    return done.wait(timeout=30), shown.decode(errors="replace")


@pytest.mark.parametrize("command", ["inspect", "init"])
def test_help_names_the_limit_that_readers_have(command):
    shown = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "200"}).output
    assert f"default: {MAX_GIGABYTES:g}." in shown


def test_the_version_is_that_of_the_package_and_is_read_when_it_is_asked_for(tmp_path: Path):
    code = (
        "import sys; before = set(sys.modules); import eoi_jax; "
        "assert 'importlib.metadata' not in set(sys.modules) - before; print(eoi_jax.__version__)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, env=environment(tmp_path))
    assert done.stdout.strip() == version("eoi_jax"), done.stderr
    assert version("eoi_jax") in call(tmp_path, "--version").stdout


def test_help_and_completion_do_not_import_jax(tmp_path: Path):
    """The reason why names are imported at first use; time itself depends on the machine."""
    code = (
        "import sys; from typer.testing import CliRunner; from eoi_jax.cli.commands import app; "
        "r = CliRunner().invoke(app, ['identify', '--help']); assert r.exit_code == 0, r.output; "
        "heavy = {'jax', 'numpy', 'pandas', 'matplotlib', 'eoi_jax.data'} & set(sys.modules); "
        "assert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_examples_and_takes_json_and_quiet(name: str):
    done = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "80", "NO_COLOR": "1"})
    assert done.exit_code == 0
    assert "Examples" in done.stdout
    assert f"eoi {name}" in done.stdout.partition("Examples")[2]
    assert "--json" in done.stdout
    assert "--quiet" in done.stdout
    examples = done.stdout.partition("Examples")[2].strip().splitlines()
    assert all(line.strip().startswith("eoi ") for line in examples), "one wraps at 80 columns"


def test_what_is_exported_stands_apart_from_the_other_options():
    done = CliRunner().invoke(app, ["export", "--help"], env={"COLUMNS": "80", "NO_COLOR": "1"})
    assert max(map(len, done.stdout.splitlines())) <= 80
    panels = dict(re.findall(r"╭─ ([^─]*) ─+╮\n(.*?)╰", done.stdout, re.DOTALL))
    options = {name: set(re.findall(r"│ (--[a-z]+)", text)) for name, text in panels.items()}
    assert options["Content: one of these"] == {
        *("--language", "--parameters", "--estimator", "--robot"),
    }
    assert options["With --estimator"] == {"--precision", "--data"}
    assert options["With --robot"] == {"--joint"}


def completed(tmp_path: Path, words: str) -> set[str]:
    """What the tab key offers behind these words, as bash asks for it."""
    position = str(len(words.split(" ")) - 1)
    more = {"_EOI_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": position}
    return set(call(tmp_path, **more).stdout.split())


def test_a_shell_completes_commands_configs_and_data_files(tmp_path: Path):
    (tmp_path / "rig.toml").write_text("")
    (tmp_path / "run.csv").write_text("")
    (tmp_path / "notes.doc").write_text("")
    (tmp_path / "more").mkdir()

    assert {"identify", "inspect", "init"} <= completed(tmp_path, "eoi i")
    assert completed(tmp_path, "eoi init run.csv --output ") == {"rig.toml", "more/"}
    assert completed(tmp_path, "eoi inspect r") == {"run.csv"}
    shown = call(
        tmp_path, "--show-completion", "bash", _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1"
    )
    assert "_EOI_COMPLETE" in shown.stdout


def test_a_shell_completes_the_languages_of_export(tmp_path: Path):
    assert completed(tmp_path, "eoi export runs/emps --language ") == set(LANGUAGES)
    assert completed(tmp_path, "eoi export runs/emps --language m") == {"matlab"}


def test_a_shell_completes_built_in_configs_that_no_folder_hides(tmp_path: Path):
    (tmp_path / "pendulum").mkdir()
    (tmp_path / "pens.toml").write_text("")
    offered = completed(tmp_path, "eoi identify pen")
    assert offered == {"pendulum/", "pens.toml", "pendulum_lab", "pendulum_sweep"}
    assert {"level_tank", "emps", "pens.toml"} <= completed(tmp_path, "eoi discover ")


def test_completion_of_a_folder_that_is_not_there_is_empty(tmp_path: Path):
    assert complete_config(str(tmp_path / "none" / "x")) == []
    (tmp_path / "a.csv.gz").write_text("")
    assert complete_data(f"{tmp_path}/a") == [f"{tmp_path}/a.csv.gz"]


def test_colours_appear_on_a_terminal_only_and_no_color_is_honoured(tmp_path: Path):
    status, shown = on_a_terminal(tmp_path, "identify", "--help")
    assert status == 0
    assert COLOUR.search(shown)
    status, shown = on_a_terminal(tmp_path, "identify", "--help", NO_COLOR="1")
    assert status == 0
    assert "Examples" in shown
    assert not COLOUR.search(shown)
    assert "\x1b" not in call(tmp_path, "identify", "--help").stdout


CONFIG = """
name = "rig"
plant = "pendulum"

[observer]
kind = "second_order"
c1 = 17.5
c2 = 57.25
c3 = 30.0

[lowpass]
cutoff = 90.0

[simulate]
sample_period = 0.002
duration = 10.0
increments = { a = 5.0, b = -0.8, c = -0.2, d = -4.0 }

[simulate.input.voltage]
kind = "square"
amplitude = 0.2
frequency = 0.25
"""


def test_progress_is_drawn_on_a_terminal_and_quiet_draws_nothing(tmp_path: Path):
    (tmp_path / "rig.toml").write_text(CONFIG)
    status, shown = on_a_terminal(tmp_path, "identify", "rig.toml", COLUMNS="120")
    assert status == 0, shown
    assert "pass" in shown
    assert re.search(r"\d+/10.*left", shown)  # of the passes asked for, with the time left
    assert "estimate" in shown
    *_, last = re.finditer(r"\d+/10", shown)
    assert "\x1b[2K" in shown[last.end() : shown.index("estimate")]  # it is wiped out at the end
    with progress(enabled=False) as shown:
        assert shown is None


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The time that help takes [s]."""
    folder, began = tmp_path_factory.mktemp("help"), time.perf_counter()
    subprocess.run([*START, "--help"], env=environment(folder), capture_output=True, check=True)
    return time.perf_counter() - began


@pytest.mark.parametrize(
    ("wait", "number"),
    [
        (0.1, signal.SIGINT),
        (1.5, signal.SIGTERM),
        (1.5, signal.SIGHUP),
        (3.0, signal.SIGINT),
        (5.0, signal.SIGTERM),
    ],
)
def test_a_signal_ends_with_130_and_leaves_no_half_written_run(
    tmp_path: Path, unit: float, wait: float, number: signal.Signals
):
    """At some times, counted in the time that help takes: machines differ, and their load."""
    (tmp_path / "rig.toml").write_text(CONFIG)
    run = subprocess.Popen(
        [*START, "identify", "rig.toml"],
        cwd=tmp_path,
        env=environment(tmp_path),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(wait * unit)
    run.send_signal(number)
    out, err = run.communicate(timeout=60)
    left = sorted(path.name for path in tmp_path.glob("runs/*"))
    if run.returncode == 0:  # it was done before
        assert left == ["rig"]
        return
    if wait > 1.0:  # before, Python itself may still be starting
        assert run.returncode == 130, err
        # Nothing to say where no command has begun.
        assert err in ("", "eoi: interrupted; no partly written files remain\n")
    assert out == ""
    assert left == []


def test_a_signal_that_is_ignored_stays_so(tmp_path: Path):
    """`nohup` asks for that."""
    code = (
        "import signal; from eoi_jax.cli.signals import handle, ENDING; "
        "signal.signal(signal.SIGINT, signal.default_int_handler); "  # a shell's `&` ignores it
        "signal.signal(signal.SIGHUP, signal.SIG_IGN); "
        "heard = []; "
        "manager = handle(lambda number, _: heard.append(number)); manager.__enter__(); "
        "[signal.raise_signal(one) for one in ENDING]; "
        "assert heard == [signal.SIGINT, signal.SIGTERM], heard; "
        "manager.__exit__(None, None, None); "
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_interrupt_while_a_class_is_made_ends_with_130(tmp_path: Path):
    """`python -m` itself would end by SIGINT: it remembers an interrupt that `exec` met."""
    code = (
        "import sys; from eoi_jax.cli import commands, main\n"
        "def app(prog_name):\n"
        "    try: exec('raise KeyboardInterrupt')\n"
        "    except KeyboardInterrupt: sys.exit(130)\n"
        "commands.app = app; main.main()"
    )
    (tmp_path / "interrupted.py").write_text(code)
    done = subprocess.run(
        [sys.executable, "-m", "interrupted"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_an_error_that_nobody_foresaw_is_one_sentence(tmp_path: Path, monkeypatch):
    def fail(*_):
        raise KeyError("lost")

    monkeypatch.setattr(exports, "export", fail)
    words = ["export", str(tmp_path), "--language", "c"]
    done = CliRunner().invoke(app, words)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr == (
        "eoi: internal error (KeyError: 'lost'). Please report it to the developers of "
        "eoi_jax with the output of the same command with --debug\n"
    )
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 2
    assert "(KeyError: 'lost')" in json.loads(done.stdout)["error"]
    for debugged in (["--debug", *words], [*words, "--debug"]):
        assert isinstance(CliRunner().invoke(app, debugged).exception, KeyError)
    monkeypatch.setattr(exports, "export", lambda *_: (_ for _ in ()).throw(MemoryError()))
    assert "eoi: out of memory" in CliRunner().invoke(app, words).stderr


def test_an_error_before_any_command_is_one_sentence_too(tmp_path: Path):
    code = (
        "import sys; sys.modules['eoi_jax.cli.commands'] = None; "
        "from eoi_jax.cli.main import main; main()"
    )
    for more, said in (([], "ModuleNotFoundError"), (["--debug"], "Traceback")):
        done = subprocess.run([sys.executable, "-c", code, *more], capture_output=True, text=True)
        assert said in done.stderr
        if not more:
            assert (done.returncode, done.stderr.count("\n")) == (2, 1)


def test_an_answer_that_nobody_reads_is_an_answer_all_the_same(tmp_path: Path):
    (tmp_path / "run.csv").write_text(
        "\n".join(["t,u,y", *(f"{k},{k % 3},{k}" for k in range(99))])
    )
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run(
        [*START, "inspect", "run.csv"], cwd=tmp_path, env=environment(tmp_path), stdout=theirs,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    os.close(theirs)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "runs" / "run.inspect" / "inspect.json").is_file()


def test_what_a_terminal_would_obey_is_shown_instead(capsys):
    say("a\x1b[31mb\x07\x9b\u202ec\ud800 ä\n\td")
    assert capsys.readouterr().out == "a\\x1b[31mb\\x07\\x9b\\u202ec\\ud800 ä\n\td\n"


# -- inspect and init -----------------------------------------------------------------------


def motor(path: Path, samples: int = 2000) -> Path:
    """A driven, damped oscillator in a table with decimal commas."""
    h, levels = 0.01, np.random.default_rng(1).uniform(-3, 3, samples // 50 + 1)
    t, u = h * np.arange(samples), levels[np.arange(samples) // 50]
    state, rows = np.zeros(2), []
    step = np.linalg.inv(np.eye(2) - h * np.array([[0.0, 1.0], [-30.0, -2.0]]))
    for now, drive in zip(t, u, strict=True):
        rows.append(f"{now:.2f};{drive:.4f};{state[0]:.6f}".replace(".", ","))
        state = step @ (state + h * np.array([0.0, 15.0 * drive]))
    path.write_text("\n".join(["time [s];voltage [V];angle [rad]", *rows]), encoding="utf-8")
    return path


def test_inspect_tells_what_is_in_a_file_and_draws_it(tmp_path: Path):
    file = motor(tmp_path / "motor.csv")
    done = CliRunner().invoke(
        app, ["inspect", str(file), "--output", str(tmp_path / "runs"), "--json"]
    )
    assert done.exit_code == 0, done.output
    folder = tmp_path / "runs" / "motor.inspect"
    assert {path.name for path in folder.iterdir()} == {
        "inspect.json",
        "inspect.txt",
        "inspect.png",
    }
    assert (folder / "inspect.png").read_bytes().startswith(b"\x89PNG")
    text = (folder / "inspect.txt").read_text()
    for part in ("every 0.01 s", "voltage [V] input", "angle [rad] output", "decimal commas"):
        assert part in text
    told = json.loads(done.stdout)
    assert told == json.loads((folder / "inspect.json").read_text())
    assert told["clock"]["sample_period"] == pytest.approx(0.01)
    assert (told["inputs"], told["outputs"]) == (["voltage [V]"], ["angle [rad]"])


def test_inspect_takes_the_column_of_time(tmp_path: Path):
    rows = "\n".join(f"{k},{0.5 * k},{np.sin(0.1 * k):.4f}" for k in range(60))
    (tmp_path / "run.csv").write_text(f"t,instant,y\n{rows}\n")
    call = ["inspect", str(tmp_path / "run.csv"), "--output", str(tmp_path / "runs"), "--json"]
    done = CliRunner().invoke(app, [*call, "--time", "instant"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["clock"]["column"] == "instant"


def test_init_writes_a_config_that_identifies_the_file_as_it_is(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("EOI_DATA", raising=False)
    monkeypatch.setattr("eoi_jax.compiler.jax_setup.configure", lambda: None)
    motor(tmp_path / "motor.csv")
    done = CliRunner().invoke(app, ["init", "motor.csv"])
    assert done.exit_code == 0, done.output
    assert "next: eoi identify motor.toml" in done.stdout
    done = CliRunner().invoke(app, ["identify", "motor.toml", "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    # The stiffness of the discrete oscillator is that of its continuous twin within a few percent.
    values = sorted(abs(one) for one in result["parameters"].values())
    assert values[-1] == pytest.approx(30.0, rel=0.2)
    (fit,) = result["validation"]["fit"].values()
    assert fit > 80
    again = CliRunner().invoke(app, ["init", "motor.csv"])
    assert again.exit_code == 2
    assert "--force" in again.stderr
    over = CliRunner().invoke(app, ["init", "motor.csv", "--force", "--output", "motor.csv"])
    assert "`--output` must not be a data file, got motor.csv" in over.stderr
    assert (
        CliRunner().invoke(app, ["init", "motor.csv", "--force", "--quiet"]).stdout
        == "motor.toml\n"
    )
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_a_store_with_a_nonlinear_leak_is_drafted_as_of_first_order(tmp_path: Path, monkeypatch):
    """A linear model explains half of its rate; columns are named as a unit and as a function."""
    monkeypatch.chdir(tmp_path)
    h, levels = 0.01, np.random.default_rng(1).uniform(-3, 3, 40)
    state, rows = 0.0, ["time [s];drive (1/min);max"]
    for k, drive in enumerate(levels.repeat(50)):
        rows.append(f"{h * k:.2f};{drive:.4f};{state:.6f}")
        for _ in range(10):
            state += 0.1 * h * 20.0 * (drive - 30.0 * state**3)
    (tmp_path / "tank.csv").write_text("\n".join(rows))
    done = CliRunner().invoke(app, ["init", "tank.csv"])
    assert done.exit_code == 0, done.output
    model = build.plant(load(tmp_path / "tank.toml"), tmp_path)
    assert (model.inputs, model.outputs, model.degrees) == (("drive",), ("max_",), (1,))


def test_the_next_command_is_quoted_and_names_the_file_that_was_written(
    tmp_path: Path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    motor(tmp_path / "my rig's run.csv")
    done = CliRunner().invoke(app, ["init", "my rig's run.csv", "--output", "new rig/first.toml"])
    assert done.exit_code == 0, done.output
    command = shlex.split(done.stdout.partition("next: ")[2])
    assert command == ["eoi", "identify", "new rig/first.toml"]
    comment = Path(command[-1]).read_text().splitlines()[1]
    assert shlex.split(comment.removeprefix("#")) == command


def test_a_path_is_a_word_of_the_shell():
    assert shell_word(Path("my rig.toml")) == "'my rig.toml'"
    assert shell_word(Path("-x.toml")) == "./-x.toml"  # no option


def test_init_takes_several_files_and_the_names_of_columns(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a.csv", "b.csv"):
        motor(tmp_path / name)
    columns = ["--inputs", "angle [rad]", "--outputs", "voltage [V]"]
    done = CliRunner().invoke(app, ["init", "a.csv", "b.csv", *columns, "--json"])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert (answer["inputs"], answer["outputs"]) == (["angle [rad]"], ["voltage [V]"])
    text = (tmp_path / "a.toml").read_text()
    assert 'files = ["b.csv"]' in text[text.index("[validation]") :]
    done = CliRunner().invoke(app, ["init", "a.csv", "--force", "--time", "clock"])
    assert done.exit_code == 2
    assert "`time` must be one of" in done.stderr


def test_init_keeps_instrument_tags_and_names_the_output_that_it_leaves_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    u = np.repeat(np.random.default_rng(0).choice([0.0, 1.0], 20), 20)
    y = np.zeros((len(u), 2))
    for k in range(len(u) - 1):
        y[k + 1] = y[k] + np.array([0.05, 0.02]) * (u[k] - y[k])
    table = np.column_stack([np.arange(len(u)), u, y])
    header = "t [s],YC101.OUT,TIC101.PV,TIC102.PV"
    np.savetxt("run.csv", table, delimiter=",", header=header, comments="")
    tags = ["--inputs", "YC101.OUT", "--outputs", "TIC101.PV,TIC102.PV"]
    done = CliRunner().invoke(app, ["init", "run.csv", *tags])
    assert done.exit_code == 0, done.output
    assert "one output, `TIC101.PV`. `TIC102.PV` may be outputs too" in done.stdout
    text = Path("run.toml").read_text()
    assert 'outputs = ["TIC101_PV"]' in text
    assert 'inputs = ["YC101_OUT"]' in text


@pytest.mark.parametrize("command", ["inspect", "init"])
def test_a_file_that_cannot_be_read_is_one_sentence(command: str, tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    for name in ("run.csv", "none.csv"):
        done = CliRunner().invoke(app, [command, name])
        assert done.exit_code == 2
        assert len(done.stderr.strip().splitlines()) == 1
        assert name in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["run.csv"]


def test_a_fit_of_which_nothing_is_known_is_no_answer(tmp_path: Path, monkeypatch):
    """Sines of two frequencies: the input has nothing to do with the output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eoi_jax.compiler.jax_setup.configure", lambda: None)
    angle = 2.0 * np.pi * np.arange(400) / 400
    columns = np.stack([0.1 * np.arange(400), np.sin(7 * angle), np.sin(12 * angle)], axis=1)
    np.savetxt("drift.csv", columns, delimiter=",", header="t,u,y", comments="")
    Path("drift.toml").write_text(
        'name = "drift"\n[model]\noutputs = ["y"]\ninputs = ["u"]\n[model.derivatives]\n'
        'y = "g*u"\n[model.parameters]\ng = 0.0\n[data]\nfiles = ["drift.csv"]\ntime = "t"\n'
        'inputs = ["u"]\noutputs = ["y"]\n'
    )
    done = CliRunner().invoke(app, ["identify", "drift.toml", "--json"])
    assert done.exit_code == 1, done.output
    assert "no parameter has a standard error below its value" in done.stderr
    assert json.loads(done.stdout)["status"]["code"] == "undetermined"
    assert (tmp_path / "runs" / "drift" / "result.json").exists()
