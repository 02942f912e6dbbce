"""`eoi refine`: what it prints, writes and returns; what it says where there is no answer."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax._status import Status
from eoi_jax.cli import actions, html_report
from eoi_jax.cli.commands import app
from eoi_jax.cli.run_files import files_beside_run
from eoi_jax.compiler import jax_setup

SHORT = """
name = "short"
plant = "mass_spring_damper"

[refine]
substeps = 1
max_steps = 20

[simulate]
sample_period = 0.005
duration = 6.0
increments = { alpha = -20.0, beta = -2.0, rho = -0.2 }
noise = { position = 1e-4 }

[simulate.input.voltage]
kind = "random_steps"
low = -3.0
high = 3.0
holding_time = 0.5

[simulate.held_out.voltage]
kind = "random_steps"
low = -3.0
high = 3.0
holding_time = 0.5
seed = 1
"""
TRUTH = {"alpha": 154.2, "beta": 10.57, "rho": 2.367}
FILES = {
    "result.json", "report.txt", "figure.png", "config.toml", "result.npz", "report.npz",
    "report.html",
}  # fmt: skip


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


def run(*words: object):
    return CliRunner().invoke(app, ["refine", *map(str, words)])


def test_a_run_prints_its_tables_and_writes_its_files(config: Path, tmp_path: Path):
    done = run(config, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    folder = tmp_path / "runs" / "short"
    assert {path.name for path in folder.iterdir()} == FILES
    assert files_beside_run(folder) == []
    report = (folder / "report.txt").read_text()
    assert done.stdout.startswith(report)
    for part in ("refined", "95 % interval", "Held out, before:", "Held out, refined:"):
        assert part in report
    assert (folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    head, _, copied = (folder / "config.toml").read_text().partition("\n")
    assert head == f"# eoi refine {config}"
    assert copied == SHORT


def test_json_is_one_object_with_errors_and_intervals(config: Path, tmp_path: Path, undrawn):
    done = run(config, "--output", tmp_path, "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result == json.loads((tmp_path / "short" / "result.json").read_text())
    for name, value in TRUTH.items():
        low, high = result["intervals"][name]
        assert low < result["parameters"][name] < high
        # Noise-free up to 1e-4 of about 0.05 m: five standard errors leave no doubt.
        error = result["standard_errors"][name]
        assert result["parameters"][name] == pytest.approx(value, abs=5 * error)
        assert 0 < error < 0.01 * value
    # The passes came first, and were no better on the record that was fitted.
    assert result["rmse"]["position"] <= result["rmse_before"]["position"]
    assert result["identified"]["parameters"] != result["parameters"]
    errors = [result["validation"][name]["rmse"]["position"] for name in ("before", "refined")]
    assert errors == pytest.approx([1e-4, 1e-4], rel=0.1)
    table = {"window": None, "substeps": 1, "max_steps": 20, "starts": None, "rounds": 1}
    assert result["config"]["refine"] == table


def test_quiet_prints_only_the_folder(config: Path, tmp_path: Path, undrawn):
    done = run(config, "--output", tmp_path, "--quiet")
    assert done.exit_code == 0
    assert done.stdout == f"{tmp_path / 'short'}\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("substeps = 1", "sub_steps = 1", "one of window, substeps, max_steps"),
        ("substeps = 1", "substeps = 0", "`refine.substeps` must be.*>= 1"),
        ("max_steps = 20", "window = -1.0", "`refine.window` must be"),
    ],
)
def test_a_wrong_table_is_named(config: Path, tmp_path: Path, old: str, new: str, message: str):
    assert old in SHORT
    config.write_text(SHORT.replace(old, new))
    done = run(config, "--output", tmp_path / "runs")
    assert done.exit_code == 2
    assert re.search(message, done.stderr), done.stderr
    assert not (tmp_path / "runs").exists()


def test_without_an_identification_there_is_nothing_to_refine(config: Path, tmp_path: Path):
    first = SHORT.index("[simulate.input.voltage]")
    still = '[simulate.input.voltage]\nkind = "steps"\nlevels = [0.0]\nholding_time = 1.0\n'
    config.write_text(SHORT[:first].replace("noise = { position = 1e-4 }", "") + still)
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert result["error"].startswith("no estimate to refine (no_data")
    assert result["answer"].startswith("No answer: no_data: ")
    assert not (tmp_path / "runs").exists()


TANKS = """
name = "short"
plant = "cascaded_tanks"

[parameters]
nominal = { k4 = -0.05 }

[simulate]
sample_period = 4.0
duration = 1600.0
increments = { k4 = 0.1 }

[simulate.input.pump]
kind = "random_steps"
low = 1.0
high = 5.0
holding_time = 40.0
"""


@pytest.mark.slow
@pytest.mark.long
def test_drawn_starts_go_on_where_the_passes_have_no_answer(config: Path, tmp_path: Path):
    # Few steps: with more, rounding decides whether the search comes back from there.
    config.write_text(TANKS + "\n[refine]\nmax_steps = 5\n")
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    error = json.loads(done.stdout)["error"]
    assert error.startswith("no estimate to refine (unidentifiable")
    assert "; from the nominal values: unidentifiable: " in error
    assert error.endswith("`starts = 200` under [refine] tries that many points around the nominal "
                          "values")  # fmt: skip
    config.write_text(TANKS + "\n[refine]\nstarts = 200\n")
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["status"]["code"] in ("converged", "stalled", "passes_exhausted")
    assert result["parameters"]["k4"] == pytest.approx(0.05, rel=0.01)
    assert {path.name for path in (tmp_path / "runs" / "short").iterdir()} == FILES


STEP = """
name = "short"
[model]
inputs = ["u"]
outputs = ["y"]
parameters = { T = 2.0, lag = 0.3 }
input_lag = { u = "lag" }
[model.derivatives]
y = "(u - y)/T"
[data]
files = ["step.csv"]
time = "t"
inputs = ["u"]
outputs = ["y"]
"""


@pytest.mark.slow
def test_nominal_values_are_refined_where_the_passes_do_not_end(config: Path, tmp_path: Path):
    """A step response that begins with its step: passes see a constant input behind no lag."""
    time = np.arange(400) * 0.05
    y = 1.0 - (3.0 * np.exp(-time / 3.0) - 0.7 * np.exp(-time / 0.7)) / 2.3
    y += 1e-3 * np.random.default_rng(0).standard_normal(400)
    table = np.stack([time, np.ones(400), y], axis=1)
    np.savetxt(config.parent / "step.csv", table, delimiter=",", header="t,u,y", comments="")
    config.write_text(STEP)
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["parameters"]["T"] == pytest.approx(3.0, rel=0.01)
    assert result["parameters"]["lag"] == pytest.approx(0.7, rel=0.03)
    assert any("refined from the nominal values" in note for note in result["notes"])


CULTURE = """
name = "culture"
[model]
inputs = ["D"]
outputs = ["X", "S"]
parameters = { mu = 0.3, K = 2.0, Y = 0.6, feed = 18.0 }
[model.derivatives]
X = "mu*S/(K + S)*X - D*X"
S = "-mu*S/(K + S)*X/Y + D*(feed - S)"
[data]
files = ["run.csv"]
time = "t"
[validation]
files = ["test.csv"]
"""


def grown(path: Path, seed: int, samples: int) -> None:
    """A culture with held dilution: mu = 0.5, K = 1, Y = 0.5, feed = 20; 1 % of noise, slow."""
    draw = np.random.default_rng(seed)
    rows, x, level = [], np.array([2.0, 5.0]), 0.1
    for i in range(samples):
        level = draw.uniform(0.0, 0.25) if i % 16 == 0 else level
        noisy = x[0] * (1.0 + 0.01 * draw.standard_normal()), x[1] + 0.03 * draw.standard_normal()
        rows.append([0.25 * i, level, *noisy])

        def rates(t, x, dilution=level):
            growth = 0.5 * x[1] / (1.0 + x[1]) * x[0]
            return [growth - dilution * x[0], dilution * (20.0 - x[1]) - growth / 0.5]

        x = solve_ivp(rates, (0.0, 0.25), x, rtol=1e-8, atol=1e-10).y[:, -1]
    np.savetxt(path, rows, delimiter=",", header="t,D,X,S", comments="")


@pytest.mark.slow
@pytest.mark.long
def test_what_noise_hides_from_the_passes_free_runs_tell(config, tmp_path):
    """It leads them astray, and across the pole of S/(K + S)."""
    grown(config.parent / "run.csv", 66, 160)
    grown(config.parent / "test.csv", 67, 130)
    config.write_text(CULTURE)
    arguments = [str(config), "--output", str(tmp_path / "runs"), "--json"]
    done = CliRunner().invoke(app, ["identify", *arguments])
    assert any("worse than a constant" in note for note in json.loads(done.stdout)["notes"])
    result = json.loads(run(*arguments).stdout)
    for name, value in {"mu": 0.5, "K": 1.0, "Y": 0.5, "feed": 20.0}.items():
        assert result["parameters"][name] == pytest.approx(value, rel=0.05)


LOOSE = """
name = "short"

[model]
outputs = ["y"]
inputs = ["u"]
parameters = { J = 0.5, K = 5.0, b = 1.0, k = 20.0 }
[model.derivatives]
y = "v"
v = "(K*u - b*v - k*y)/J"

[simulate]
sample_period = 0.01
duration = 20.0
increments = { b = 0.3 }

[simulate.input.u]
kind = "random_steps"
low = -1.0
high = 1.0
holding_time = 0.4
"""


def test_a_common_factor_is_said_with_what_to_fix_and_not_to_start_elsewhere(
    config: Path, tmp_path: Path
):
    config.write_text(LOOSE)
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert result["error"].startswith("no estimate to refine (unidentifiable: J, K, b and k have")
    assert result["error"].endswith('fix J (`fixed = ["J"]`))')
    (factor,) = result["common_factors"]
    assert factor == {
        "parameters": ["J", "K", "b", "k"],
        "combinations": ["K/J", "b/J", "k/J"],
        "fix": ["J"],
        "switches": False,
    }


def test_a_refinement_without_an_answer_says_why(config: Path, tmp_path: Path, monkeypatch):
    whole = actions.run_refinement

    def diverged(*args, **options):
        return replace(
            whole(*args, **options), status=Status("diverged", "it does not stay finite")
        )

    monkeypatch.setattr(actions, "run_refinement", diverged)
    done = run(config, "--output", tmp_path / "runs", "--json")
    assert done.exit_code == 1
    result = json.loads(done.stdout)
    assert result["error"] == "no answer (diverged: it does not stay finite)"
    assert result["answer"] == "No answer: diverged: it does not stay finite"
    assert result["validation"]["before"]["rmse"]["position"] > 0
    assert result["validation"]["refined"] is None
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
@pytest.mark.long
def test_the_installed_command_refines_the_built_in_pendulum(tmp_path: Path):
    environment = {**os.environ, "EOI_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", "from eoi_jax.cli.main import main; main()", "refine", "--json"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=180,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    # Noise-free, and the simulator is the one that made the record.
    for name, value in {"a": 81.0, "b": 1.7, "c": 0.3, "d": 99.0}.items():
        assert result["parameters"][name] == pytest.approx(value, rel=1e-8)
    assert {path.name for path in (tmp_path / "runs" / "pendulum").iterdir()} == FILES
    assert done.stderr == ""


@pytest.mark.slow
@pytest.mark.long
def test_files_of_one_logger_are_judged_as_they_were_made(tmp_path: Path):
    """A flow goes on, and a valve acts 0.4 samples late in both files; no hold is said."""
    h, late, count = 0.25, 0.1, 800
    rate, gain = 0.5, 0.8
    for seed, name in ((1, "run.csv"), (2, "test.csv")):
        rng = np.random.default_rng(seed)
        time, valve = h * np.arange(count), rng.uniform(-3.0, 3.0, count)
        flow = np.sin(time + seed) + np.sin(0.61 * time)
        response = [np.imag(rate * np.exp(1j * (w * time + p)) / (1j * w + rate))
                    for w, p in ((1.0, seed), (0.61, 0.0))]  # fmt: skip
        level = np.zeros(count)  # of the valve alone
        for k in range(count - 1):
            before, after = valve[max(k - 1, 0)], valve[k]
            middle = level[k] + (1.0 - np.exp(-rate * late)) * (gain * before / rate - level[k])
            level[k + 1] = middle + (1.0 - np.exp(-rate * (h - late))) * (
                gain * after / rate - middle
            )
        y = sum(response) + level + 2e-3 * rng.standard_normal(count)
        table = np.c_[time, flow, valve, y]
        np.savetxt(tmp_path / name, table, delimiter=",", header="t,flow,valve,y", comments="")
    path = tmp_path / "tank.toml"
    path.write_text("""
name = "tank"
[model]
inputs = ["flow", "valve"]
outputs = ["y"]
parameters = { rate = 0.4, gain = 1.0 }
[model.derivatives]
y = "rate*(flow - y) + gain*valve"
[data]
files = ["run.csv"]
time = "t"
inputs = ["flow", "valve"]
outputs = ["y"]
[validation]
files = ["test.csv"]
""")
    done = run(path, "--json", "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert any("hold zero for valve" in note for note in answer["notes"])
    assert any(note.startswith("valve leads the outputs by 0.1 s") for note in answer["notes"])
    assert answer["parameters"]["gain"] == pytest.approx(gain, rel=2e-3)
    held_out = eoi.load(tmp_path / "runs" / "tank" / "report.npz")
    assert held_out["after"].rmse[0] < 1.1 * 2e-3
    assert held_out["after"].records[0].skew[1] == pytest.approx(late, rel=0.02)
