"""[model.output]: outputs that are functions of the states, as text."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from output_cases import accelerometer, battery

from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.equations.text_model import (
    ModelTable,
    model_json,
    plant_from_json,
    plant_from_text,
    plant_of,
)
from eoi_jax.models.plant import State

CELL: dict[str, Any] = {
    "derivatives": {"soc": "-current/Q", "v1": "(current - v1/R1)/C1"},
    "parameters": {"R0": 0.03, "R1": 0.02, "C1": 1500.0, "Q": 7200.0},
    "outputs": ("voltage",),
    "inputs": ("current",),
    "output": {"voltage": "3.4 + 0.7*soc - R0*current - v1"},
    "initial": {"soc": 0.8, "v1": 0.0},
}
MASS: dict[str, Any] = {
    "derivatives": {"x": "vx", "vx": "(-b*vx - k*(x - base))/m"},
    "parameters": {"m": 3.0, "b": 4.0, "k": 100.0},
    "outputs": ("acc",),
    "inputs": ("base",),
    "output": {"acc": "(-b*vx - k*(x - base))/m"},
    "initial": {"x": 0.0, "vx": 0.0},
}


@pytest.mark.parametrize(("table", "plant"), [(CELL, battery()), (MASS, accelerometer())])
def test_text_is_the_plant_that_functions_make(table, plant):
    text: Any = plant_from_text(**table)
    assert (text.degrees, text.names) == (plant.degrees, plant.names)
    np.testing.assert_array_equal(text.initial_internal, plant.initial_internal)
    x = State(jnp.zeros((1, 1)), jnp.asarray([0.3, -0.2]))
    at = jnp.asarray(0.0), x, jnp.asarray([1.5]), jnp.asarray(plant.theta)
    np.testing.assert_allclose(text.output(*at), plant.output(*at), rtol=1e-14)
    np.testing.assert_allclose(text.internal_rate(*at), plant.internal_rate(*at), rtol=1e-14)


def test_a_definition_with_the_name_of_an_output_is_its_equation():
    as_definition = {**CELL, "definitions": CELL["output"], "output": {}}
    plant: Any = plant_from_text(**as_definition)
    assert plant.degrees == (0,)
    assert plant.dynamics == plant_from_text(**CELL).dynamics  # type: ignore[attr-defined]


def test_other_equations_may_use_the_name_of_such_an_output():
    heated = {
        **CELL,
        "derivatives": {**CELL["derivatives"], "heat": "current*(3.4 + 0.7*soc - voltage)"},
        "output": {**CELL["output"], "warmth": "c*heat"},
        "outputs": ("voltage", "warmth"),
        "parameters": {**CELL["parameters"], "c": 0.1},
        "initial": {**CELL["initial"], "heat": 0.0},
    }
    plant: Any = plant_from_text(**heated)
    x = State(jnp.zeros((1, 2)), jnp.asarray([0.5, 0.01, 3.0]))
    at = jnp.asarray(0.0), x, jnp.asarray([2.0]), jnp.asarray(plant.theta)
    np.testing.assert_allclose(plant.internal_rate(*at)[2], 2.0 * (0.03 * 2.0 + 0.01), rtol=1e-12)
    np.testing.assert_allclose(plant.output(*at), [3.4 + 0.35 - 0.06 - 0.01, 0.3], rtol=1e-12)


def test_states_beside_functions_of_them():
    plant: Any = plant_from_text(
        {"x": "v", "v": "-k*x + u"},
        {"k": 2.0},
        ("x", "force"),
        ("u",),
        output={"force": "-k*x"},
    )
    assert (plant.degrees, plant.dynamics.equations.states) == ((2, 0), ())


def test_an_equation_needs_no_state():
    plant: Any = plant_from_text({}, {"a": 1.0, "b": 2.0}, ("y",), ("u",), output={"y": "a + b*u"})
    assert plant.is_affine


def test_equations_are_shown_without_a_derivative():
    plant = plant_from_text(**CELL)
    first = equation_text(plant).splitlines()[0]
    assert first == "voltage = 3.4 + 0.7·soc - R0·current - v1"
    assert equation_latex(plant).splitlines()[1].startswith(r"\mathrm{voltage} &= 3.4")
    assert equation_text(battery()).splitlines()[0].startswith("voltage = ")


def test_a_model_goes_to_json_and_back():
    table = ModelTable(**CELL)
    again: Any = plant_from_json(model_json(table, "0"))
    assert again.dynamics == plant_of(table, "model").dynamics  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"output": {"soc": "v1", **CELL["output"]}},
            r"`model.output` must not have a name of `derivatives`, got 'soc'. An output either",
        ),
        (
            {"output": {"voltage": "3.4 - 0.1*voltage - v1 + soc - R0*current"}},
            "`model.output.voltage` must not depend on itself, got .*Solve the equation",
        ),
        (
            {"output": {"voltage": "w + soc"}, "definitions": {"w": "R0*voltage - v1"}},
            "`model.output` must not go in a circle, got ",
        ),
        (
            {"output": {**CELL["output"], "power": "v1"}},
            r"`model.output` must have outputs only \(voltage\), got 'power'",
        ),
        (
            {"output": {}},
            r"`model.derivatives` must have voltage, got soc, v1. .*\[model.output\]: voltage = ",
        ),
        (
            {"derivatives": {**CELL["derivatives"], "current": "slope"}},
            (
                "`model.derivatives` must not have the input current: what is recorded has no "
                "equation, got 'current'. An equation that needs the derivative of an input cannot"
            ),
        ),
        (
            {"output": {"voltage": "3.4 + 0.7*soc - R0*current' - v1"}},
            "That of an input is not known: an equation that needs one cannot be written",
        ),
        (
            {"output": {"voltage": "3.4 + 0.7*soc - R0*current"}},
            "`model.parameters.R1` must be used",
        ),
    ],
)
def test_mistakes_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        plant_from_text(**{**CELL, **change})


def test_an_acceleration_that_is_given_the_rate_of_the_position_is_refused():
    derivatives = {**MASS["derivatives"], "acc": "vx"}
    with pytest.raises(ValueError, match=r"`model.derivatives.acc` must not have the derivative of "
                       r"the state x, .* write it under \[model.output\]: acc = "):  # fmt: skip
        plant_from_text(**{**MASS, "derivatives": derivatives, "output": {}})
