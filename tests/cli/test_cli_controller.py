"""The table [controller]: free runs of the command with the controller in the loop."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli import build, run_folder
from eoi_jax.cli import config as configs
from eoi_jax.cli.commands import app
from eoi_jax.compiler import jax_setup
from tests.simulation.closed_loops import PERIOD, TRUTH, measured

CONFIG = """
name = "rig"
[model]
inputs = ["current"]
outputs = ["position"]
parameters = { a = 20.0, b = 0.6, c = 5.0 }
units = { position = "m", current = "A" }
[model.derivatives]
position = "v"
v = "a*position - b*v + c*current"

[controller]
kind = "pid"
proportional = 18.0
integral = 10.0
derivative = 3.0
filter_time = 0.03

[data]
files = ["run.csv"]
time = "t"
inputs = ["amps"]
outputs = ["gap"]
references = ["wanted"]
hold = "zero"
[validation]
files = ["test.csv"]
"""
# The same law, which the command reads from a file.
LAW = """
import math

import jax.numpy as jnp

number = 3

def law(t, r, y, s):
    error = r[0] - y[0]
    slope = (0.03 * s[2] + error - s[1]) / (0.03 + 0.01)
    u = 18.0 * error + 10.0 * s[0] + 3.0 * slope
    return u, jnp.stack([s[0] + 0.01 * error, error, slope])

def fails(t, r, y, s):
    return math.cos(r[0])
"""
PID = CONFIG[CONFIG.index('kind = "pid"') : CONFIG.index("[data]")]
CUSTOM = 'kind = "law"\nlaw = "mine.py:law"\nreference = "r"\nstates = 3\n\n'
SAMPLES = 700
IN_LOOP = "Simulated with the controller in the loop. It reproduces the recorded amps of {} to"


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """A config, changed in places, with two records and the file of a law."""
    text = CONFIG
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    for seed, name in ((1, "run"), (2, "test")):
        record = measured(seed, count=SAMPLES, noise=1e-3)
        table = np.column_stack([record.time, record.inputs, record.outputs])
        header = "t,amps,wanted,gap"
        path = folder / f"{name}.csv"
        np.savetxt(path, table, fmt="%.17g", delimiter=",", header=header, comments="")
    (folder / "mine.py").write_text(LAW)
    path = folder / "rig.toml"
    path.write_text(text)
    return path


def run(command: str, config: Path, *words: object):
    runs = str(config.parent / "runs")
    return CliRunner().invoke(app, [command, str(config), "--output", runs, *map(str, words)])


def refined(config: Path) -> dict:
    done = run("refine", config, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


def near_truth(result: dict) -> None:
    for name, value in TRUTH.items():
        error = result["standard_errors"][name]
        assert abs(result["parameters"][name] - value) < 4.0 * error
        assert error < 2e-3 * value


@pytest.mark.slow
def test_an_identification_is_judged_in_the_loop(tmp_path: Path):
    done = run("identify", written(tmp_path, ('hold = "zero"\n', "")), "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["validation"]["in_loop"]
    assert result["validation"]["notes"][-1].startswith(IN_LOOP.format("test"))
    assert result["notes"][-1].startswith("hold zero for all inputs: [controller] holds them")
    report = (tmp_path / "runs" / "rig" / "report.html").read_text()
    assert IN_LOOP.format("test") in report


def test_a_refinement_has_the_controller_in_the_loop_and_says_so(tmp_path: Path):
    config = written(tmp_path)
    result = refined(config)
    near_truth(result)
    assert result["window"] is None
    assert result["in_loop"]
    assert result["validation"]["refined"]["in_loop"]
    assert result["validation"]["refined"]["rmse"]["position"] < 1.2e-3
    assert result["config"]["controller"]["kind"] == "pid"
    folder = tmp_path / "runs" / "rig"
    report = (folder / "report.txt").read_text()
    assert f"- {IN_LOOP.format('run')} every digit." in report
    assert f"Note: {IN_LOOP.format('test')} every digit." in report
    assert IN_LOOP.format("run") in (folder / "report.html").read_text()


def test_the_config_of_a_run_can_be_run_again_from_its_folder(tmp_path: Path):
    """The file of a law and the records are beside the original."""
    config = written(tmp_path, (PID, CUSTOM))
    copy = tmp_path / "runs" / "rig" / "config.toml"
    results = []
    for path in (config, copy):
        words = ["identify", str(path), "--output", str(tmp_path / "runs"), "--json"]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, done.output
        results.append(json.loads(done.stdout))
    first, again = results
    assert again["validation"]["in_loop"]
    assert again["parameters"] == first["parameters"]
    assert copy.read_text().startswith(f"# eoi identify {copy}\n# eoi identify {config}\n")
    assert run_folder.folder_of(copy) == tmp_path  # of the copy of a copy


@pytest.mark.parametrize("folder", ["a rig", "it's"])
@pytest.mark.parametrize("quoted", [True, False])
def test_a_config_in_a_folder_that_is_quoted_for_the_shell_is_found(tmp_path, folder, quoted):
    """Earlier versions wrote it without quotation marks."""
    original = tmp_path / folder / "rig.toml"
    original.parent.mkdir()
    original.touch()
    copy = tmp_path / "runs" / "rig" / "config.toml"
    copy.parent.mkdir(parents=True)
    (copy.parent / "result.json").touch()
    name = shlex.quote(str(original)) if quoted else str(original)
    copy.write_text(f"# eoi identify {name} --passes 3\n")
    assert run_folder.folder_of(copy) == original.parent


@pytest.mark.parametrize("command", ["identify", "sweep"])
def test_where_nothing_is_simulated_in_the_loop_a_note_says_so(tmp_path: Path, command: str):
    config = written(tmp_path, ('[validation]\nfiles = ["test.csv"]\n', ""))
    done = run(command, config, "--json")
    assert done.exit_code == 0, done.output
    note = json.loads(done.stdout)["notes"][-1]
    assert note.startswith("[controller] is not in the loop: the recorded inputs drive")


def test_a_discovery_says_that_the_recorded_inputs_drive_it(tmp_path: Path):
    effects = '[discover]\neffects = ["cubic_stiffness"]\n\n[data]'
    done = run("discover", written(tmp_path, ("[data]", effects)), "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["status"]["code"] == "nothing_missing"
    assert result["notes"][-1].startswith("[controller] is not in the loop")
    assert result["notes"][-1] in (tmp_path / "runs" / "rig" / "report.txt").read_text()


def built(config: Path) -> eoi.Controller | None:
    settings = configs.load(config)
    model = build.plant(settings, config.parent)
    return build.controller(settings, model, config.parent, PERIOD)


def test_all_fields_of_a_pid_controller_reach_it(tmp_path: Path):
    fields = """kind = "pid"
proportional = 18
integral = 10.0
derivative = 3.0
filter_time = 0.03
offset = 0.5
limits = [-inf, 12.0]
reference = 1
output = "position"
inputs = "current"
initial = [0.5, 0, 0]
delay = 1
tolerance = 0.1

"""
    pid = eoi.Controller.pid(18.0, 10.0, 3.0, period=PERIOD, reference=1.0, filter_time=0.03,
                             offset=0.5, limits=(-np.inf, 12.0), inputs="current",
                             initial=[0.5, 0.0, 0.0], delay=1, tolerance=0.1)  # fmt: skip
    assert built(written(tmp_path, (PID, fields))) == pid


def test_a_law_of_ones_own_is_a_function_of_a_file(tmp_path: Path):
    fields = CUSTOM.rstrip() + '\ninputs = ["current"]\ndelay = 1\ntolerance = 0.1\n\n'
    law = built(written(tmp_path, (PID, fields)))
    assert law is not None
    assert law.law.__name__ == "law"
    assert (law.reference, law.inputs, law.states) == (("r",), ("current",), 3)
    assert (law.initial, law.delay, law.tolerance) == (None, 1, 0.1)


def test_a_reference_is_the_column_of_its_name_unless_the_data_say_another(tmp_path: Path):
    config = written(tmp_path, ('references = ["wanted"]\n', ""), ("amps", "current"),
                     ("filter_time = 0.03", 'filter_time = 0.03\nreference = "wanted"'),
                     ('hold = "zero"', 'hold = { current = "zero" }'))  # fmt: skip
    for name in ("run", "test"):
        path = tmp_path / f"{name}.csv"
        path.write_text(path.read_text().replace("amps", "current"))
    job = run_folder.job(configs.load(config), tmp_path, None)
    assert job.loop is not None
    assert job.loop.records[0].input_names == ("current", "wanted")
    assert job.records[0].input_names == job.held_out[0].input_names == ("current",)
    assert job.records[0].hold == "zero"


DATA = CONFIG[CONFIG.index("[data]") :]
SIMULATE = """[simulate]
sample_period = 0.01
duration = 2.0
increments = { a = 1.0 }
[simulate.input.current]
kind = "square"
amplitude = 1.0
frequency = 1.0
"""
GAIN = "proportional = 18.0"
MISTAKES = [
    ((GAIN, f"{GAIN}\ngain = 1.0"), "`a key of [controller]` must be one of kind, proportional"),
    ((GAIN, f'{GAIN}\nlaw = "mine.py:law"'), "must be one of kind, proportional, .*'law'"),
    ((CUSTOM, f"{CUSTOM.rstrip()}\n{GAIN}\n"), "must be one of kind, law, .*'proportional'"),
    (('kind = "pid"', ""), "`controller.kind` must be one of pid, law, got nothing"),
    ((GAIN, ""), "`controller.proportional` must be given, got nothing"),
    ((GAIN, 'proportional = "high"'), "`controller.proportional` must be a number, got 'high'"),
    ((GAIN, f"{GAIN}\nreference = [1.0]"), "`controller.reference` must be a number or a text"),
    ((GAIN, f"{GAIN}\nlimits = [12.0, -12.0]"), "`limits` must be (lower, upper)"),
    ((GAIN, f"{GAIN}\nlimits = [12.0]"), "`controller.limits` must be"),
    ((GAIN, f"{GAIN}\ninitial = [0.0]"), "[controller] `initial` must hold 3 finite values"),
    ((GAIN, f"{GAIN}\ndelay = -1"), "`controller.delay` must be a whole number >= 0, got -1"),
    ((GAIN, f"{GAIN}\ntolerance = 1"), "`controller.tolerance` must be a number < 1"),
    ((GAIN, f'{GAIN}\ninputs = "curent"'), "`controller.inputs` must be one of current"),
    ((GAIN, f'{GAIN}\noutput = "positon"'), "`controller.output` must be one of position"),
    ((GAIN, "proportional = 9.0"), "`controller` must reproduce the recorded input amps of run"),
    (("wanted", "target"), "`data.references` must be columns of .*gap.*, got target. Name"),
    (('["wanted"]', "[]"), "`data.references` must name 1 column, for the reference of"),
    ((GAIN, f"{GAIN}\nreference = 0.0"), "`data.references` must name 0 columns"),
    ((f"[controller]\n{PID}", ""), "`data.references` must name 0 columns"),
    (("wanted", "amps"), "`data.references` must be columns that are neither"),
    (('hold = "zero"', 'hold = "linear"'), "`records[run].hold` must be zero"),
    ((DATA, SIMULATE), "`controller` must be that of measured records, got the table [simulate]"),
    (("mine.py:law", "absent.py:law"), '`controller.law` must be "file.py:function" with a file'),
    (("mine.py:law", "mine.py:number"), "where the object is a function law(t, r, y, s), got"),
    (
        ("mine.py:law", "mine.py:fails"),
        "`controller.law` must run with t (), r (1,), y (1,), s (3,)",
    ),
]


@pytest.mark.parametrize(("change", "message"), MISTAKES, ids=[m[1][:60] for m in MISTAKES])
def test_a_mistake_is_named_with_its_rule(tmp_path: Path, change: tuple[str, str], message: str):
    base = ((PID, CUSTOM),) if change[0] in CUSTOM else ()
    config = written(tmp_path, *base, change)
    done = run("refine", config)
    assert done.exit_code == 2, done.output
    pattern = ".*".join(re.escape(part) for part in message.split(".*"))
    assert re.search(pattern, " ".join(done.stderr.split())), done.stderr
    assert not (tmp_path / "runs").exists()


def test_records_of_other_periods_are_named(tmp_path: Path):
    config = written(tmp_path)
    table = np.loadtxt(tmp_path / "test.csv", delimiter=",", skiprows=1)[::2]
    np.savetxt(tmp_path / "test.csv", table, delimiter=",", header="t,amps,wanted,gap", comments="")
    done = run("refine", config)
    assert done.exit_code == 2
    assert "`records` must have the same sample period, that of the controller" in done.stderr


def test_a_pid_controller_names_its_input_where_the_plant_has_several(tmp_path: Path):
    config = written(tmp_path, ('inputs = ["current"]', 'inputs = ["current", "push"]'),
                     ("+ c*current", "+ c*(current + push)"))  # fmt: skip
    with pytest.raises(ValueError, match=r"`controller\.inputs` must name .* current, push"):
        built(config)


# -- a drafted config -----------------------------------------------------------------------------


def drafted(folder: Path, reference: str, proportional: float = 4.0) -> Path:
    """A config drafted from the log of a motor under proportional control."""
    h, samples, state, rows = 0.01, 400, np.zeros(2), []
    levels = np.random.default_rng(1).uniform(-1.0, 1.0, samples // 50)
    step = np.linalg.inv(np.eye(2) - h * np.array([[0.0, 1.0], [0.0, -2.0]]))
    for k, wanted in enumerate(levels.repeat(50)):
        drive = proportional * (wanted - state[0])
        rows.append(f"{h * k:.2f},{wanted:.4f},{drive:.5f},{state[0]:.6f}")
        state = step @ (state + h * np.array([0.0, 15.0 * drive]))
    lines = [f"time [s],{reference},voltage [V],angle [rad]", *rows]
    (folder / "loop.csv").write_text("\n".join(lines))
    path = folder / "loop.toml"
    done = CliRunner().invoke(app, ["init", str(folder / "loop.csv"), "--output", str(path)])
    assert done.exit_code == 0, done.output
    return path


def test_a_draft_has_a_controller_for_a_column_that_looks_like_a_reference(tmp_path: Path):
    path = drafted(tmp_path, "angle setpoint [rad]")
    assert configs.load(path).controller is None
    head, mark, table = path.read_text().partition("# [controller]\n")
    assert '"angle setpoint [rad]" looks like the reference of a controller' in head
    table = (mark + table).replace("# ", "", 1).replace("\n# ", "\n").replace("= 1.0", "= 4.0")
    path.write_text(head + table)
    job = run_folder.job(configs.load(path), tmp_path, None)
    assert job.loop is not None  # it reproduces the recorded voltage
    assert job.loop.controller.reference == ("angle setpoint [rad]",)


def test_a_draft_has_no_controller_without_such_a_column(tmp_path: Path):
    assert "[controller]" not in drafted(tmp_path, "second angle [rad]").read_text()
