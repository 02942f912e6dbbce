"""The command on models whose outputs are functions of the states."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from output_cases import ACCELEROMETER, BATTERY, battery_record, shaken
from typer.testing import CliRunner

from eoi_jax.cli import build
from eoi_jax.cli import config as configs
from eoi_jax.cli.commands import app
from eoi_jax.compiler import jax_setup

CELL = """
name = "battery"
[model]
inputs = ["current"]
outputs = ["voltage"]
parameters = { R0 = 0.02, R1 = 0.03, C1 = 1000.0, Q = 7000.0 }
units = { voltage = "V" }
[model.derivatives]
soc = "-current/Q"
v1 = "(current - v1/R1)/C1"
[model.output]
voltage = "3.4 + 0.7*soc - R0*current - v1"
[model.initial]
soc = 0.8
v1 = 0.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["current"]
outputs = ["voltage"]
hold = "zero"
[validation]
files = ["test.csv"]
"""
MASS = """
name = "accelerometer"
[model]
inputs = ["base"]
outputs = ["acc"]
parameters = { m = 3.0, b = 3.0, k = 80.0 }
fixed = ["m"]
[model.derivatives]
x = "vx"
vx = "(-b*vx - k*(x - base))/m"
[model.output]
acc = "(-b*vx - k*(x - base))/m"
[model.initial]
x = 0.0
vx = 0.0
[data]
files = ["run.csv"]
time = "t"
inputs = ["base"]
outputs = ["acc"]
hold = "linear"
[validation]
files = ["test.csv"]
"""


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def eoi(*arguments: object):
    return CliRunner().invoke(app, [str(one) for one in arguments])


def written(folder: Path, text: str, record_of, names: tuple[str, str]) -> Path:
    for name, seed in (("run", 1), ("test", 2)):
        record = record_of(seed)
        table = np.column_stack([record.time, record.inputs, record.outputs])
        header = ",".join(["t", *names])
        np.savetxt(folder / f"{name}.csv", table, "%.17g", ",", header=header, comments="")
    path = folder / "run.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("text", "record_of", "names", "truth"),
    [
        (CELL, battery_record, ("current", "voltage"), BATTERY),
        (CELL.replace("[model.output]", "[model.definitions]"), battery_record,
         ("current", "voltage"), BATTERY),
        (MASS, shaken, ("base", "acc"), ACCELEROMETER),
    ],
    ids=["battery", "battery by definition", "accelerometer"],
)  # fmt: skip
def test_a_config_is_identified(tmp_path, text, record_of, names, truth):
    path = written(tmp_path, text, record_of, names)
    done = eoi("identify", path, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    name = tomllib.loads(text)["name"]
    result = json.loads((tmp_path / "runs" / name / "result.json").read_text("utf-8"))
    assert "of the output remains unexplained" in result["answer"]
    for key, value in truth.items():
        np.testing.assert_allclose(result["parameters"][key], value, rtol=0.02)


@pytest.mark.slow
def test_a_model_is_refined_and_exported(tmp_path):
    path = written(tmp_path, CELL, battery_record, ("current", "voltage"))
    done = eoi("refine", path, "--output", tmp_path / "runs")
    assert done.exit_code == 0, done.output
    target = tmp_path / "cell.py"
    done = eoi("export", tmp_path / "runs" / "battery", "--output", target)
    assert done.exit_code == 0, done.output
    assert "def cell_outputs(t, states, inputs):" in target.read_text("utf-8")


def test_a_config_simulates_such_an_output_from_the_start_of_the_model(tmp_path):
    simulated = CELL[: CELL.index("[data]")] + (
        "[simulate]\nsample_period = 1.0\nduration = 30.0\ntruth = { R0 = 0.02 }\n"
        '[simulate.input.current]\nkind = "square"\namplitude = 1.0\nfrequency = 0.05\n'
    )
    (tmp_path / "run.toml").write_text(simulated)
    config = configs.load(tmp_path / "run.toml")
    plant = build.plant(config, tmp_path)
    (record,) = build.records(config, plant, tmp_path)
    want = 3.4 + 0.56 - 0.02 * record.inputs[0, 0]
    np.testing.assert_allclose(record.outputs[0, 0], want, rtol=1e-12)
    (tmp_path / "run.toml").write_text(simulated + "[simulate.initial]\nvoltage = 3.0\n")
    config = configs.load(tmp_path / "run.toml")
    with pytest.raises(ValueError, match=r"`simulate.initial.voltage` must have at most 0 .*these "
                       r"start in \[model\]"):  # fmt: skip
        build.records(config, plant, tmp_path)
    (tmp_path / "run.toml").write_text(simulated.replace("soc = 0.8", 'soc = "free"'))
    config = configs.load(tmp_path / "run.toml")
    free = build.plant(config, tmp_path)
    with pytest.raises(ValueError, match=r"`simulate.initial` must give soc.*\] soc = VALUE"):
        build.records(config, free, tmp_path)
    given = (tmp_path / "run.toml").read_text() + "[simulate.initial]\nsoc = 0.8\n"
    (tmp_path / "run.toml").write_text(given)
    (again,) = build.records(configs.load(tmp_path / "run.toml"), free, tmp_path)
    np.testing.assert_array_equal(again.outputs, record.outputs)
