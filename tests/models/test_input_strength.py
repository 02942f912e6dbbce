"""Strengths of effects in the unit of what drives the model."""

import json

import jax.numpy as jnp
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.input_strength import input_strengths


def motor(t, x, u, p):
    return -p.c * x.y[1] + p.b * u


def squared(t, x, u, p):
    return -p.c * x.y[1] + p.b * u * u


def pushed_twice(t, x, u, p):
    return -p.c * x.y[1] + p.b * (u[0] + u[1])


def carts(t, x, u, p):
    first, second = x.y[0]
    pull = p.c * (second - first)
    return jnp.stack([pull + p.b * u[0], -pull - 2.0 * p.b * u[1]])


def plant(equation=motor, **options):
    units = dict.fromkeys(options.get("outputs", ("y",)), "rad")
    units |= dict.fromkeys(options.get("inputs", ("u",)), "V")
    return eoi.Plant(equation, {"c": 1.5, "b": 4.0}, 2, units=units, **options)


def rubbing(model, output=0):
    placed = place(model, effects.CoulombFriction(), output)
    return augmented(model, [placed], {placed.names[0]: 2.0})


def test_dry_friction_is_as_strong_as_an_input():
    """2 rad/s² of 4 rad/s² a volt."""
    (strength,) = input_strengths(rubbing(plant()))
    assert (strength.parameter, strength.input, strength.unit) == ("coulomb_friction", "u", "V")
    assert strength.factor == pytest.approx(0.25)
    assert strength.text(2.0) == "0.5 V at the input u"


def test_each_output_has_the_input_that_drives_it():
    model = plant(carts, inputs=("left", "right"), outputs=("first", "second"))
    (strength,) = input_strengths(rubbing(model, 1))
    assert (strength.input, strength.factor) == ("right", pytest.approx(-0.125))


@pytest.mark.parametrize(
    "model", [plant(squared), plant(pushed_twice, inputs=("a", "b"))], ids=["squared", "two inputs"]
)
def test_no_strength_where_no_single_input_has_a_constant_slope(model):
    assert input_strengths(rubbing(model)) == ()


def test_a_declared_model_has_no_strengths():
    assert input_strengths(plant()) == ()


def test_effects_of_other_units_have_none():
    model = plant()
    placed = [place(model, effects.CubicStiffness(), 0), place(model, effects.InputDeadZone(), 0)]
    names = [name for placement in placed for name in placement.names]
    assert input_strengths(augmented(model, placed, dict.fromkeys(names, 0.1))) == ()


def test_exported_code_tells_it_beside_the_unit(tmp_path):
    eoi.export(rubbing(plant()), tmp_path / "model.py")
    code = (tmp_path / "model.py").read_text(encoding="utf-8")
    (line,) = [line for line in code.splitlines() if line.strip().startswith("coulomb_friction =")]
    assert line.endswith("# rad/s², 0.5 V at the input u")


@pytest.mark.slow
@pytest.mark.long
def test_the_command_gives_it_in_json(tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from eoi_jax.cli.commands import app

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eoi_jax.compiler.jax_setup.configure", lambda: None)
    done = CliRunner().invoke(app, ["discover", "--json"])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    (at_input,) = answer["at_input"]
    (parameter,) = answer["added"][0]["parameters"].values()
    assert at_input["parameter"] == "coulomb_friction"
    assert 0 < at_input["standard_error"] < 0.1 * at_input["value"]
    assert parameter / at_input["value"] > 0
    assert f"{at_input['value']:.3g}"[:4] in answer["answer"]
