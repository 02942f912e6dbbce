"""Coefficients that depend on a signal: which are tried, what they do, and how they are written."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.result import Added
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects.dependence import foreign_dependences
from eoi_jax.models.effects.signals import Signal
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.placements import placements
from eoi_jax.models.storage import load, save

H = 0.02
TEMPERATURE = Signal("temperature", 1, None)


def motor(**arguments):
    return eoi.plant_from_text(
        {"speed": "k*voltage - d*speed"}, {"k": 2.0, "d": 1.5}, ["speed"],
        ["voltage", "temperature"],
        units={"speed": "rad/s", "voltage": "V", "temperature": "°C"}, **arguments,
    )  # fmt: skip


def record(samples: int = 400) -> eoi.Record:
    draw = np.random.default_rng(3)
    voltage = np.repeat(draw.uniform(-10.0, 10.0, samples // 10), 10)
    temperature = 40.0 + 20.0 * np.sin(np.linspace(0.0, 9.0, samples))
    time = H * np.arange(samples)
    inputs = np.stack([voltage, temperature], axis=1)
    return eoi.Record(time, inputs, draw.uniform(-5.0, 5.0, samples),
                      input_names=("voltage", "temperature"), output_names="speed")  # fmt: skip


def dependence(law: str = "exponential", unit: str = "°C") -> effects.ParameterDependence:
    return effects.ParameterDependence("d", "speed", (TEMPERATURE,), 40.0, 20.0, unit, law)


def slower(
    law: str = "exponential", value: float = -0.02, unit: str = "°C"
) -> tuple[eoi.Plant, Placed]:
    placed = place(motor(), dependence(law, unit), 0)
    return augmented(motor(), [placed], dict.fromkeys(placed.names, value)), placed


def derivative(plant: eoi.Plant, speed: float, voltage: float, temperature: float) -> float:
    state = eoi.State(jnp.array([[speed]]), jnp.zeros(0))
    u = jnp.array([voltage, temperature])
    return float(plant.derivative(jnp.zeros(()), state, u, jnp.asarray(plant.theta))[0])


LAWS = {
    "exponential": np.exp(-0.02 * 15.0),
    "Arrhenius": np.exp(-0.02 * 313.15**2 * (1.0 / 313.15 - 1.0 / 328.15)),
    "linear": 1.0 - 0.02 * 15.0,
    "power": (55.0 / 40.0) ** (-0.02 * 40.0),
}


@pytest.mark.parametrize(("law", "factor"), LAWS.items())
def test_the_parameter_is_replaced_in_the_equation(law, factor):
    unit = "m" if law == "power" else "°C"
    plant, placed = slower(law, unit=unit)
    assert placed.names == ("parameter_dependence_d_temperature",)
    assert derivative(plant, 3.0, 2.0, 55.0) == pytest.approx(4.0 - 1.5 * factor * 3.0, rel=1e-6)
    # At the centre the parameter is what it was.
    assert derivative(plant, 3.0, 2.0, 40.0) == pytest.approx(derivative(motor(), 3.0, 2.0, 40.0))
    assert plant.units[placed.names[0]] == f"1/{unit}"


def test_to_first_order_it_is_the_sensitivity_times_the_centred_signal():
    plant, _ = slower(value=0.0)
    point = jnp.zeros(()), eoi.State(jnp.array([[3.0]]), jnp.zeros(0)), jnp.array([2.0, 55.0])
    slopes = plant.regressor(*point, jnp.asarray(plant.theta))[0]
    assert slopes[2] == pytest.approx(float(slopes[1]) * 1.5 * 15.0, rel=1e-6)


def test_all_forms_agree_to_first_order_and_have_one_kind():
    for unit in ("°C", "m"):
        forms = dependence(unit=unit).forms
        values = [derivative(slower(form.form_of_law, 0.02, unit)[0], 3.0, 2.0, 40.1)
                  for form in forms]  # fmt: skip
        change = 0.02 * 0.1 * -4.5
        assert np.array(values) + 0.5 == pytest.approx(change, rel=3e-3)
        assert {form.kind for form in forms} == {"parameter_dependence d temperature"}
        chain = [forms[0]]
        while form := chain[-1].next_form():
            chain.append(form)
        assert tuple(chain) == forms


def test_a_form_is_one_that_the_signal_may_have():
    assert [form.form_of_law for form in dependence().forms] == [
        "exponential", "Arrhenius", "linear"
    ]  # fmt: skip
    assert [form.form_of_law for form in dependence(unit="m").forms] == [
        "exponential", "linear", "power"
    ]  # fmt: skip
    with pytest.raises(ValueError, match="one that its signal may have"):
        dependence("Arrhenius", "m")
    with pytest.raises(ValueError, match="form_of_law"):
        dependence("cubic")


def test_an_even_law_is_of_a_signal_that_takes_both_signs():
    """The force factor of a coil that leaves its magnet: b (1 + a x²) in both equations."""
    coil = eoi.plant_from_text(
        {"i": "(u - r*i - b*v)/l", "x": "v", "v": "b*i - k*x - c*v"},
        {"r": 4.0, "b": 5.0, "l": 0.01, "k": 900.0, "c": 3.0}, ["i", "x"], ["u"],
        units={"x": "mm"},
    )  # fmt: skip
    draw = np.random.default_rng(0)
    data = eoi.Record(H * np.arange(300), draw.normal(size=300), draw.normal(size=(300, 2)),
                      output_names=("i", "x"), input_names="u")  # fmt: skip
    laws = {law.form: law for law in effects.parameter_dependences(coil, [data], most=99)}
    even = laws["b of x, even"]
    assert even.forms == (even,)
    placed = place(coil, even, 0)
    bent = augmented(coil, [placed], dict.fromkeys(placed.names, -0.05))
    assert bent.units[placed.names[0]] == "1/mm²"
    assert even.law(-0.05) == "b·(1 - 0.05·x²)"
    state = eoi.State(jnp.array([[2.0, 1.5], [0.0, 0.4]]), jnp.zeros(0))
    rates = bent.derivative(jnp.zeros(()), state, jnp.array([9.0]), jnp.asarray(bent.theta))
    force = 5.0 * (1.0 - 0.05 * 1.5**2)
    wanted = [(9.0 - 8.0 - force * 0.4) / 0.01, force * 2.0 - 900.0 * 1.5 - 3.0 * 0.4]
    np.testing.assert_allclose(rates, wanted, rtol=1e-6)
    # k (1 + a x²) x is a cubic spring.
    assert "k of x, even" not in laws
    shifted = eoi.Record(data.time, data.inputs, data.outputs + np.array([0.0, 9.0]),
                         output_names=("i", "x"), input_names="u")  # fmt: skip
    assert "b of x, even" not in names(coil, shifted)
    with pytest.raises(ValueError, match="one that its signal may have"):
        dependence("even")


def names(plant: eoi.Plant, *records: eoi.Record) -> set[str]:
    return {effect.form for effect in effects.parameter_dependences(plant, records)}


def test_laws_of_a_single_signal_are_not_dependences():
    """d·speed² is a quadratic drag, k·voltage² a quadratic input."""
    found = names(motor(), record())
    assert {"d of temperature", "k of temperature", "d of t", "k of t"} <= found
    assert {"d of speed", "k of voltage"}.isdisjoint(found)


def test_a_signal_that_rests_changes_nothing():
    moving = record()
    inputs = np.stack([moving.inputs[:, 0], np.full(len(moving), 25.0)], axis=1)
    still = eoi.Record(moving.time, inputs, moving.outputs,
                       input_names=moving.input_names, output_names="speed")  # fmt: skip
    assert not {name for name in names(motor(), still) if "temperature" in name}


def test_parameters_that_do_the_same_are_one():
    plant = eoi.plant_from_text({"y": "g*k*u - y"}, {"g": 1.0, "k": 2.0}, ["y"], ["u", "w"])
    draw = np.random.default_rng(1)
    data = eoi.Record(H * np.arange(200), draw.uniform(1.0, 2.0, (200, 2)), draw.uniform(size=200),
                      input_names=("u", "w"), output_names="y")  # fmt: skip
    found = names(plant, data)
    assert "g of w" in found
    assert "k of w" not in found


def test_there_are_as_many_as_asked_for_at_most_and_each_has_one_place():
    several = effects.parameter_dependences(motor(), [record()], most=3)
    assert len(several) == 3
    assert [placed.channel for placed in placements(motor(), several)] == [0, 0, 0]
    other = eoi.plant_from_text({"y": "u - a*y"}, {"a": 1.0}, ["y"], ["u"])
    assert placements(other, several) == []


def test_signals_that_the_equation_does_not_have_come_first():
    """What the others do, products and curves do as well: they are the ones to leave out."""
    first = effects.parameter_dependences(motor(), [record()], most=2)
    assert [effect.form for effect in first] == ["k of temperature", "d of temperature"]
    assert foreign_dependences(motor(), [record()]) == first


def test_the_centre_is_a_plain_number_in_the_middle_of_the_records():
    found = {effect.form: effect for effect in effects.parameter_dependences(motor(), [record()])}
    effect, temperature = found["d of temperature"], record().inputs[:, 1]
    assert effect.center == round(effect.center, 1)
    assert effect.center == pytest.approx(np.mean(temperature), abs=0.1)
    assert effect.reach == pytest.approx(np.max(np.abs(temperature - effect.center)))
    low, high = effect.shapes[0].lower, effect.shapes[0].upper
    assert np.exp(high * effect.reach) < 25.0
    assert low == -high


def test_a_parameter_of_an_internal_state_is_replaced_there():
    plant = eoi.plant_from_text(
        {"y": "z - y", "z": "u - a*z"}, {"a": 2.0}, ["y"], ["u", "w"], initial={"z": 1.0}
    )
    effect = effects.ParameterDependence("a", "y", (Signal("w", 1, None),), 0.0, 1.0)
    placed = place(plant, effect, 0)
    changed = augmented(plant, [placed], {placed.names[0]: 1.0})
    state = eoi.State(jnp.array([[0.0]]), jnp.array([3.0]))
    args = jnp.zeros(()), state, jnp.array([0.0, 0.5]), jnp.asarray(changed.theta)
    assert changed.internal_rate(*args) == pytest.approx([-2.0 * np.exp(0.5) * 3.0], rel=1e-6)


def test_it_stands_in_the_equation_in_place_of_the_parameter():
    _, placed = slower()
    added = Added(
        dependence(), "speed", dict.fromkeys(placed.names, -0.02), {}, dependence().sentence
    )
    text = equation_text(motor(), [added])
    name = placed.names[0]
    assert text == f"speed' = k·voltage - d·exp({name}·(temperature - 40))·speed"
    assert "1.5·exp(-0.02·(temperature - 40))·speed" in equation_text(motor(), [added],
                                                                       numeric=True)  # fmt: skip


def test_its_law_says_over_which_distance_it_doubles():
    assert dependence().law(-0.02) == "d·exp(-0.02·(temperature - 40)), which halves over 34.7 °C"
    assert dependence("linear").law(0.02) == "d·(1 + 0.02·(temperature - 40))"
    assert dependence("power", "m").law(0.02) == "d·(temperature/40)^0.8"
    assert dependence("Arrhenius").law(0.02) == (
        "d·exp(1961.3 K·(1/313.15 - 1/(temperature + 273.15)))"
    )


@pytest.mark.parametrize("law", ["exponential", "Arrhenius", "linear"])
def test_a_plant_with_it_is_stored(law, tmp_path):
    plant, _ = slower(law)
    save(plant, tmp_path / "plant.npz")
    assert derivative(load(tmp_path / "plant.npz"), 3.0, 2.0, 55.0) == derivative(
        plant, 3.0, 2.0, 55.0
    )


def test_free_runs_have_a_slope_with_it():
    """Refinement finds it from a third of its size."""
    truth, placed = slower()
    data = eoi.simulate(truth, record().time, record().inputs, [0.0])
    fit = eoi.refine(truth.with_parameters({placed.names[0]: -0.007, "d": 1.2}), data)
    assert fit.parameters[placed.names[0]] == pytest.approx(-0.02, rel=1e-3)
    assert fit.parameters["d"] == pytest.approx(1.5, rel=1e-3)
