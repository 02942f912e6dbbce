"""A motor whose encoder wraps, from the logger's file to its friction."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from eoi_jax.cli import build
from eoi_jax.cli.commands import app
from eoi_jax.cli.config import load
from eoi_jax.compiler import jax_setup

COUNTS = 4096 / (2 * np.pi)
GAIN, DAMPING, FRICTION = 0.5, 4.0, 8.0
HINT = 'wraps 17 times with a period of 4096: a fit takes the jumps for motion; write unwrap = { "e'


@pytest.fixture(autouse=True)
def configured(monkeypatch: pytest.MonkeyPatch):
    """JAX runs already in this process, set up by conftest."""
    monkeypatch.setattr(jax_setup, "configure", lambda: None)


def counted(samples: int = 2000, steps: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Command and counts of a motor with viscous and dry friction, every 10 ms."""
    pwm = np.random.default_rng(3).integers(-200, 200, samples // 50 + 1).repeat(50)[:samples]
    angle, speed, counts = 0.0, 0.0, []
    for command in pwm:
        counts.append(int(np.floor(angle * COUNTS)))
        for _ in range(steps):
            friction = DAMPING * speed + FRICTION * np.tanh(speed / 0.05)
            speed += 1e-3 * (GAIN * command - friction)
            angle += 1e-3 * speed
    return pwm, np.asarray(counts)


PWM, TRUTH = counted()


def called(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def drafted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    rows = [f"{1000 + 10 * k},{PWM[k]},{TRUTH[k] % 4096}" for k in range(len(PWM))]
    (tmp_path / "motor.csv").write_text("\n".join(["ms,pwm,encoder", *rows]) + "\n")
    monkeypatch.chdir(tmp_path)
    answer = called("init", "motor.csv")
    assert answer.exit_code == 0, answer.output
    assert "its name says so; it wraps 25 times with a period of 4096" in answer.stdout
    assert "write unwrap" not in answer.stdout  # the draft has it
    return tmp_path / "motor.toml"


def edited(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    target = path.with_name("edited.toml")
    target.write_text(text.replace(old, new))
    return target


def read(path: Path) -> list:
    settings = load(path)
    return build.records(settings, build.plant(settings, path.parent), path.parent)


UNWRAP = 'unwrap = { "encoder" = 4096.0 }'


def test_the_draft_unwraps_and_what_turns_has_no_spring(drafted: Path):
    tables = tomllib.loads(drafted.read_text())
    assert tables["data"]["unwrap"] == {"encoder": 4096.0}
    assert UNWRAP + "  # it wraps 25 times with a period of 4096" in drafted.read_text()
    model = tables["model"]
    assert model["derivatives"]["encoder"] == "encoder_rate"
    assert model["derivatives"]["encoder_rate"] == "-damping*encoder_rate + gain*pwm + offset"
    assert model["parameters"]["gain"] == pytest.approx(GAIN * COUNTS, rel=0.1)
    assert model["parameters"]["damping"] == pytest.approx(DAMPING, rel=0.15)
    settings = load(drafted)
    plant = build.plant(settings, drafted.parent)
    (fitted,) = build.records(settings, plant, drafted.parent)
    (held_out,) = build.validation_records(settings, plant, drafted.parent)
    for record, truth in ((fitted, TRUTH[:1400]), (held_out, TRUTH[1400:])):
        np.testing.assert_array_equal(np.diff(record.outputs[:, 0]), np.diff(truth))


@pytest.mark.slow
def test_gain_and_friction_of_the_motor_are_found(drafted: Path):
    answer = called("discover", drafted)
    assert answer.exit_code == 0, answer.output
    rows = {line.split()[0]: line.split() for line in answer.stdout.splitlines() if line.split()}
    assert "lacks Coulomb (dry) friction" in answer.stdout
    assert float(rows["gain"][4]) == pytest.approx(GAIN * COUNTS, rel=0.01)
    assert float(rows["damping"][4]) == pytest.approx(DAMPING, rel=0.01)
    assert float(rows["coulomb_friction"][4]) == pytest.approx(FRICTION * COUNTS, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["identify", "refine", "discover"])
def test_a_fit_says_that_its_output_wraps(drafted: Path, command: str):
    answer = called(command, edited(drafted, UNWRAP, ""))
    assert HINT in answer.output.replace("\n", " ")


def test_the_inspection_says_what_to_write(drafted: Path):
    answer = called("inspect", "motor.csv")
    assert 'unwrap = { "encoder" = 4096 } in [data]' in answer.stdout


def test_a_saw_tooth_of_any_height_is_left_commented_out(tmp_path: Path, monkeypatch):
    k = np.arange(2000)
    angle = np.cumsum(0.1 * np.sin(0.003 * k) + 0.05 * np.sin(0.011 * k) + 0.03)
    rows = [f"{0.01 * i:.2f},{np.sin(0.003 * i):.4f},{angle[i] % 5.37:.5f}" for i in k]
    (tmp_path / "saw.csv").write_text("\n".join(["time_s,u,position", *rows]) + "\n")
    monkeypatch.chdir(tmp_path)
    answer = called("init", "saw.csv")
    assert "if it is a counter or an angle that wraps" in answer.stdout
    text = (tmp_path / "saw.toml").read_text()
    assert '# unwrap = { "position" = 5.37 }' in text
    assert "unwrap" not in tomllib.loads(text)["data"]


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ('unwrap = { "encoder" = 0 }', "`data.unwrap.encoder` must be a number > 0.0, got 0."),
        ('unwrap = { "encoder" = -360.0 }', "`data.unwrap.encoder` must be a number > 0.0, got -"),
        ('unwrap = { "encoder" = "turn" }', "`data.unwrap.encoder` must be a number, got 'turn'."),
        ('unwrap = { "angle" = 360 }', "`unwrap` must be one of pwm, encoder, got 'angle'"),
        ('unwrap = { "encoder" = 1024 }', "`unwrap[encoder]` must be at least the range of the "),
    ],
)
def test_a_wrong_period_is_named_with_its_rule(drafted: Path, new: str, message: str):
    path = edited(drafted, UNWRAP, new)
    with pytest.raises(ValueError, match=re.escape(message)):
        read(path)
