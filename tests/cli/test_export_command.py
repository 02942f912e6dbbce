"""`eoi export`: from the folder of a run to a file."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import eoi_jax as eoi
from eoi_jax.cli.commands import app
from eoi_jax.compiler import jax_setup

CONFIG = """
name = "rig"
{plant}

[identify]
passes = 3

[simulate]
sample_period = 0.002
duration = 8.0
increments = {{ a = 5.0, b = -0.8, c = -0.2, d = -4.0 }}

[simulate.input.voltage]
kind = "square"
amplitude = 0.2
frequency = 0.25
"""
TEXT = """
[model]
outputs = ["angle"]
inputs = ["voltage"]
parameters = { a = 76.0, b = 2.5, c = 0.5, d = 103.0 }
derivatives = { angle = "rate", rate = "-a*sin(angle) - b*rate - c*sign(rate) + d*voltage" }
"""
MODULE = """
from eoi_jax import plants

def rig():
    return plants.pendulum()
"""


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def called(*arguments):
    return CliRunner().invoke(app, [str(one) for one in arguments])


@pytest.fixture(scope="module", params=["text", "library", "file"])
def run(request, tmp_path_factory, monkeypatch_module):
    folder: Path = tmp_path_factory.mktemp(request.param)
    (folder / "own.py").write_text(MODULE)
    plant = {"text": TEXT, "library": 'plant = "pendulum"', "file": 'plant = "own.py:rig"'}
    head = CONFIG.format(plant="" if request.param == "text" else plant[request.param])
    text = head + (TEXT if request.param == "text" else "")
    (folder / "rig.toml").write_text(text, encoding="utf-8")
    done = called("identify", folder / "rig.toml", "--output", folder / "runs", "--quiet")
    assert done.exit_code == 0, done.output
    return folder / "runs" / "rig"


@pytest.fixture(scope="module")
def monkeypatch_module():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jax_setup, "configure", lambda: None)
        yield


def test_the_estimate_of_a_run_is_exported(run, tmp_path):
    done = called("export", run, "--output", tmp_path / "rig.json")
    assert done.exit_code == 0, done.output
    assert done.stdout.strip() == str(tmp_path / "rig.json")
    found = eoi.load(tmp_path / "rig.json").parameters
    for name, value in {"a": 81.0, "b": 1.7, "c": 0.3, "d": 99.0}.items():
        assert found[name] == pytest.approx(value, rel=0.05)  # the record is short
    assert found["a"] != 76.0


OWN = """
from pathlib import Path
import jax.numpy as jnp
from eoi_jax import Plant

Path(__file__).with_name("was_run").touch()

def dynamics(t, x, u, p):
    (angle,), (rate,) = x.y
    return -p.a * jnp.sin(angle) - p.b * rate - p.c * jnp.sign(rate) + p.d * u

def rig():
    start = {"a": 76.0, "b": 2.5, "c": 0.5, "d": 103.0}
    return Plant(dynamics, start, 2, inputs=("voltage",), outputs=("angle",))
"""


@pytest.mark.slow
def test_a_python_file_is_run_where_it_is_trusted_only(tmp_path, monkeypatch):
    """It is found from any folder: the command names its config by where it was given."""
    (tmp_path / "configs").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "configs" / "own.py").write_text(OWN)
    config = tmp_path / "configs" / "rig.toml"
    config.write_text(CONFIG.format(plant='plant = "own.py:rig"'), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = called("identify", Path("configs") / "rig.toml", "--quiet")
    assert done.exit_code == 0, done.output
    mark = tmp_path / "configs" / "was_run"
    mark.unlink()
    run = tmp_path / "runs" / "rig"
    done = called("export", run, "--language", "c")
    assert done.exit_code == 2
    assert "whose model is a function in own.py:rig. Check this file; --trust" in done.stderr
    assert called("report", run).exit_code == 0
    assert not mark.exists()
    for place in (".", "runs/rig", "elsewhere"):
        monkeypatch.chdir(tmp_path / place)
        done = called("export", run, "--language", "c", "--trust")
        assert done.exit_code == 0, done.output
        assert mark.exists()
        mark.unlink()
        (run / "model.c").unlink()


def test_a_stored_model_is_exported_without_the_file_that_it_came_from(run, tmp_path):
    """What the config names may be gone, or be another's."""
    copy = tmp_path / "rig"
    copy.mkdir()
    for name in ("result.npz", "config.toml"):
        (copy / name).write_bytes((run / name).read_bytes())
    text = (copy / "config.toml").read_text(encoding="utf-8")
    (copy / "config.toml").write_text(text.replace("own.py:rig", "gone.py:rig"), encoding="utf-8")
    done = called("export", copy, "--language", "c")
    assert done.exit_code == 0, done.output


def test_without_a_file_it_goes_into_the_folder_of_the_run(run):
    done = called("export", run, "--language", "c")
    assert done.exit_code == 0, done.output
    assert (run / "model.c").read_text(encoding="utf-8").count("model(") == 2
    (run / "model.c").unlink()


def test_a_stored_result_is_exported_with_the_effects_found(tmp_path):
    plant = eoi.plants.level_tank()
    time = np.arange(0.0, 40.0, 0.05)
    record = eoi.simulate(plant, time, 1.0 + eoi.excitation.square(time, 0.5, 0.05))
    eoi.identify(plant, record, passes=2).save(tmp_path / "run.npz")
    done = called("export", tmp_path / "run.npz", "--language", "matlab")
    assert done.exit_code == 0, done.output
    assert "rates(1) = " in (tmp_path / "model.m").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none", "--language", "c"), "`run` must be a folder or a file that exists"),
        ((".", "--language", "c"), "`run` must be the folder of a finished run"),
        ((".",), "`--language` must be given without --output"),
        ((".", "--language", "ada"), "`--language` must be one of python, c"),
    ],
)
def test_a_wrong_call_says_what_to_do(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = called("export", *arguments)
    assert done.exit_code == 2
    assert message in done.stderr
    assert "Traceback" not in done.output


def test_a_run_without_a_result_is_refused(run, tmp_path):
    (tmp_path / "config.toml").write_text((run / "config.toml").read_text(encoding="utf-8"))
    done = called("export", tmp_path, "--language", "c")
    assert done.exit_code == 2
    assert "`run` must hold result.npz or result.json" in done.stderr
    (tmp_path / "result.json").write_text("{}")
    done = called("export", tmp_path, "--language", "c", "--trust")
    assert done.exit_code == 2
    assert "must hold a result.json that this library wrote" in done.stderr
