"""`eoi export`: from the folder of a run to a file."""

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

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


def test_a_language_of_two_files_is_chosen_by_its_name(run, tmp_path):
    done = called("export", run, "--language", "idnlgrey", "--output", tmp_path / "rig.m")
    assert done.exit_code == 0, done.output
    assert {path.name for path in tmp_path.iterdir()} == {"rig.m", "rig_idnlgrey.m"}


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


# -- parameters, and joints of robots ---------------------------------------------------------

ARM = """
name = "arm"

[model]
outputs = ["shoulder", "elbow"]
inputs = ["torque1", "torque2"]
parameters = { J1 = 0.4, b1 = 0.2, c1 = 0.1, J2 = 0.1, b2 = 0.5, k2 = 2.0 }
fixed = ["J1"]

[model.units]
shoulder = "rad"
elbow = "rad"
torque1 = "N m"
torque2 = "N m"
J1 = "kg m²"
b1 = "N m s/rad"
c1 = "N m"
J2 = "kg m²"
b2 = "1/s"
k2 = "1/s²"

[model.derivatives]
shoulder = "rate1"
rate1 = "(torque1 - b1*rate1 - c1*sign(rate1))/J1"
elbow = "rate2"
rate2 = "torque2/J2 - b2*rate2 - k2*elbow"

[identify]
passes = 3

[simulate]
sample_period = 0.005
duration = 5.0
increments = { b1 = 0.1, c1 = 0.05, J2 = 0.02, b2 = 0.5, k2 = 0.5 }

[simulate.input.torque1]
kind = "square"
amplitude = 0.6
frequency = 0.4

[simulate.input.torque2]
kind = "square"
amplitude = 0.3
frequency = 0.3
"""
URDF = """<?xml version="1.0"?>
<robot name="arm">
  <!-- two joints -->
  <link name="base"/>
  <link name="upper"/>
  <link name="lower"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="10" velocity="5"/>
    <dynamics damping="0.1" friction="0.0"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/>
    <child link="lower"/>
    <axis xyz="0 0 1"/>
  </joint>
</robot>
"""
MJCF = """<mujoco model="arm">
  <default><default class="stiff"><joint stiffness="9" damping="0.2"/></default></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 0 1"/>
      <geom type="capsule" size="0.02" fromto="0 0 0 0.3 0 0"/>
      <body name="lower" pos="0.3 0 0">
        <joint class="stiff" name="elbow" axis="0 0 1"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
TRUE = {"J1": 0.4, "b1": 0.3, "c1": 0.15, "J2": 0.12, "b2": 1.0, "k2": 2.5}


@pytest.fixture(scope="module")
def arm(tmp_path_factory, monkeypatch_module):
    """The folder of a run of a two-joint arm."""
    folder: Path = tmp_path_factory.mktemp("arm")
    (folder / "arm.toml").write_text(ARM, encoding="utf-8")
    done = called("identify", folder / "arm.toml", "--output", folder, "--quiet")
    assert done.exit_code == 0, done.output
    return folder / "arm"


def test_parameters_are_exported_as_json_and_csv(arm, tmp_path):
    done = called("export", arm, "--parameters")
    assert done.exit_code == 0, done.output
    content = json.loads((arm / "parameters.json").read_text(encoding="utf-8"))
    summary = json.loads((arm / "result.json").read_text(encoding="utf-8"))
    for name, row in content["parameters"].items():
        assert row["value"] == summary["parameters"][name] == pytest.approx(TRUE[name], rel=1e-3)
        assert row["standard_error"] == summary["standard_errors"][name]
    assert content["records"] == summary["records"]
    assert content["versions"] == summary["versions"]
    done = called("export", arm, "--parameters", "--output", tmp_path / "p.csv", "--json")
    assert json.loads(done.stdout) == {"parameters": str(tmp_path / "p.csv")}
    with (tmp_path / "p.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["name"]: row for row in csv.DictReader(file)}
    assert {name: float(row["value"]) for name, row in rows.items()} == summary["parameters"]


def robot(folder, text, name):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_joints_of_a_urdf_get_the_identified_values(arm, tmp_path):
    source = robot(tmp_path, URDF, "arm.urdf")
    done = called(
        "export", arm, "--robot", source, "--joint", "shoulder:damping=b1,friction=c1",
        "--joint", "elbow:damping=max(b2*J2, 0)", "--output", tmp_path / "new.urdf",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert lines[1].startswith("shoulder.damping")
    assert lines[1].endswith("N m s/rad")
    assert lines[-1] == str(tmp_path / "new.urdf")
    before, after = URDF.splitlines(), (tmp_path / "new.urdf").read_text().splitlines()
    assert len(after) == len(before) + 1
    assert sum(line not in before for line in after) == 2
    joints = {
        joint.get("name"): {key: float(value) for key, value in dynamics.attrib.items()}
        for joint in ElementTree.parse(tmp_path / "new.urdf").getroot().iter("joint")
        for dynamics in joint.iter("dynamics")
    }
    assert joints["shoulder"] == pytest.approx({"damping": 0.3, "friction": 0.15}, rel=1e-3)
    assert joints["elbow"] == pytest.approx({"damping": 0.12}, rel=1e-3)


def test_joints_of_an_mjcf_override_their_default_class(arm, tmp_path):
    source = robot(tmp_path, MJCF, "arm.xml")
    done = called(
        "export", arm, "--robot", source, "--output", tmp_path / "new.xml", "--json", "--joint",
        "shoulder:damping=b1, frictionloss=c1, armature=J1", "--joint", "elbow:stiffness=k2*J2",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    joints = {
        joint.get("name"): joint.attrib
        for joint in ElementTree.parse(tmp_path / "new.xml").getroot().iter("joint")
    }
    assert float(joints["elbow"]["stiffness"]) == answer["values"]["elbow.stiffness"]["value"]
    assert answer["values"]["elbow.stiffness"]["value"] == pytest.approx(0.3, rel=1e-3)
    assert answer["values"]["elbow.stiffness"]["standard_error"] > 0.0
    assert answer["values"]["shoulder.armature"]["unit"] == "kg m²"
    assert float(joints["shoulder"]["frictionloss"]) == pytest.approx(0.15, rel=1e-3)
    assert joints["elbow"]["class"] == "stiff"
    assert joints[None]["stiffness"] == "9"
    assert answer["notes"] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--joint", "shoulder:damping=b1"), "`--robot` must be given with --joint, got nothing"),
        (("--robot", "arm.urdf"), "`--output` must be given with --robot, got nothing"),
        (("--robot", "arm.urdf", "--output", "new.urdf"), "`--joint` must be joint:attribute="),
        (("--parameters", "--robot", "arm.urdf"), "`--parameters` must stand alone, got --param"),
        (("--language", "c", "--parameters"), "`--language` must stand alone, got --language and"),
        (("--parameters", "--output", "p.txt"), "`path` must end in .json or .csv, got p.txt"),
    ],
)
def test_options_that_do_not_go_together_are_refused(arm, options, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot(tmp_path, URDF, "arm.urdf")
    done = called("export", arm, *options)
    assert done.exit_code == 2
    assert message in done.stderr


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ("shoulder", "`--joint` must be joint:attribute=formula, as in shoulder:damping=b,fri"),
        ("damping=b1", "`--joint` must be joint:attribute=formula"),
        ("shoulder:damping=", "`--joint` must be joint:attribute=formula"),
        ("shoulder:damping=b1,damping=b1", "`--joint` must set an attribute once, got shoulder:d"),
        ("wrist:damping=b1", "`joints` must be one of shoulder, elbow, got 'wrist'"),
        ("shoulder:armature=J1", "`joints[shoulder]` must have attributes of URDF: damping"),
        ("shoulder:damping=b3", "must use declared names, got b3"),
        ("shoulder:damping=b2", "`joints[shoulder].damping` must be in N m s/rad, got b2 with b2"),
        ("shoulder:friction=-c1", "`joints[shoulder].friction` must not be negative, got -0.1"),
    ],
)
def test_a_wrong_joint_is_refused_and_nothing_is_written(arm, joint, message, tmp_path):
    source = robot(tmp_path, URDF, "arm.urdf")
    target = tmp_path / "new.urdf"
    done = called("export", arm, "--robot", source, "--joint", joint, "--output", target)
    assert done.exit_code == 2
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert not target.exists()


# -- the estimator ------------------------------------------------------------------------------


def test_the_estimator_of_a_run_is_written_as_c(run):
    done = called("export", run, "--estimator", "--precision", "single", "--json")
    assert done.exit_code == 0, done.stderr
    path = Path(json.loads(done.stdout)["estimator"])
    assert path == run / "estimator.c"
    text = path.read_text()
    assert "in single precision" in text
    assert "void estimator_step(" in text


def test_an_estimator_stands_alone_and_has_a_precision(run):
    done = called("export", run, "--estimator", "--parameters")
    assert done.exit_code == 2
    assert "must stand alone" in done.stderr
    done = called("export", run, "--language", "c", "--precision", "single")
    assert done.exit_code == 2
    assert "`--precision` must be given with --estimator, got single. All other" in done.stderr
    done = called("export", run, "--estimator", "--precision", "half")
    assert done.exit_code == 2
    assert "`precision` must be" in done.stderr
