"""Products of named inputs: where they fit, what they add, how they are found."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects, plants
from eoi_jax.models.augmented import augmented
from eoi_jax.models.placements import placements

H = 2.0
SUPPLY, RATE, LOSS = 60.0, 0.02, 0.01


def warmed(t, x, u, p):
    """What brings heat in is declared, what the stream carries out is not."""
    return p.a * u[-1] - p.k * (x.y[0] - p.T0)


def vessel(inputs):
    start = {"a": 1.0, "k": 0.02, "T0": 20.0}
    return eoi.Plant(warmed, start, 1, inputs=inputs, outputs=("T",))


def exchanger(seed, inputs, samples=1500):
    """T' = RATE·flow·(SUPPLY - T) - LOSS·(T - 20), exact between its samples; a lamp is idle."""
    draw = np.random.default_rng(seed)
    flow = np.repeat(0.3 + 1.5 * draw.uniform(0.0, 1.0, samples // 30), 30)
    y, level = np.empty(samples), 25.0
    for k in range(samples):
        y[k] = level
        total = RATE * flow[k] + LOSS
        end = (RATE * flow[k] * SUPPLY + LOSS * 20.0) / total
        level = end + (level - end) * np.exp(-total * H)
    y += 2e-3 * np.std(y) * draw.standard_normal(samples)
    u = np.stack([0.5 + 0.0 * flow, flow], axis=1)[:, -len(inputs) :]
    return eoi.Record(H * np.arange(samples), u, y, input_names=inputs, output_names=("T",))


def test_a_plant_of_a_single_input_has_none():
    assert effects.input_products(plants.pendulum()) == ()


def test_further_inputs_act_with_their_output_and_in_pairs():
    plant = eoi.Plant(
        lambda t, x, u, p: jnp.stack([p.a * u[0], p.a * u[1] - x.y[1, 1]]), {"a": 1.0}, (1, 2),
        inputs=("p", "q", "r"), outputs=("x", "y"),
    )  # fmt: skip
    forms = {}
    for placed in placements(plant, effects.input_products(plant)):
        assert isinstance(placed.effect, effects.InputProduct)
        forms.setdefault(plant.outputs[placed.channel], set()).add(placed.effect.form)
    pairs = {"p·q", "p·r", "q·r"}
    assert forms == {"x": {"q·x", "r·x", *pairs}, "y": {"q·y", "q·y'", "r·y", "r·y'", *pairs}}


def test_a_product_adds_what_its_name_says():
    plant = vessel(("lamp", "flow"))
    (first, pair) = placements(plant, effects.input_products(plant))
    assert (first.names, pair.names) == (("product_flow_T",), ("product_lamp_flow",))
    state = eoi.State(jnp.array([[30.0]]), jnp.zeros(0))
    args = jnp.zeros(()), state, jnp.array([2.0, 3.0])
    before, by_output, by_input = (
        float(model.derivative(*args, jnp.asarray(model.theta))[0])
        for model in (
            plant,
            augmented(plant, [first], {"product_flow_T": -0.1}),
            augmented(plant, [pair], {"product_lamp_flow": -0.1}),
        )
    )
    assert by_output - before == pytest.approx(-9.0)
    assert by_input - before == pytest.approx(-0.6)


@pytest.mark.slow
@pytest.mark.parametrize("inputs", [("flow",), ("lamp", "flow")], ids=["alone", "second"])
def test_heat_that_a_stream_carries_out_is_found(inputs):
    """By a single input, cells in series of the product are tried too: they need its stream."""
    found = eoi.discover(vessel(inputs), exchanger(1, inputs), validation=exchanger(2, inputs))
    form = "u·y" if len(inputs) == 1 else "flow·T"
    assert [added.label for added in found.added] == [f"product ({form})"]
    (value,) = found.added[0].parameters.values()
    assert value == pytest.approx(-RATE, rel=2e-3)
    assert found.status.code == "complete"


def test_an_input_acts_where_no_equation_has_it():
    plant = eoi.plant_from_text(
        {"x": "p - a*x + 0*r", "y": "q*y - z", "z": "s - z"}, {"a": 1.0}, ["x", "y"],
        ["p", "q", "r", "s"], initial={"z": 0.0},
    )  # fmt: skip
    forms = {(plant.outputs[placed.channel], placed.effect.form)
             for placed in placements(plant, effects.input_actions(plant))}  # fmt: skip
    assert forms == {("x", "q"), ("x", "r"), ("y", "p"), ("y", "r")}
    assert effects.input_actions(plants.pendulum()) == ()


def test_an_action_adds_a_multiple_of_its_input():
    plant = vessel(("lamp", "flow"))
    (lamp,) = placements(plant, effects.input_actions(plant))
    assert lamp.names == ("input_action_lamp",)
    warmer = augmented(plant, [lamp], {"input_action_lamp": 0.5})
    args = jnp.zeros(()), eoi.State(jnp.array([[30.0]]), jnp.zeros(0)), jnp.array([2.0, 3.0])
    values = [model.derivative(*args, jnp.asarray(model.theta))[0] for model in (plant, warmer)]
    assert values[1] - values[0] == pytest.approx(1.0)


def sunny(seed, samples=600):
    """T' = heat + 0.4·sun - 0.02·(T - 5), held inputs: exact between its samples."""
    draw = np.random.default_rng(seed)
    heat, sun = (np.repeat(draw.uniform(0.0, 1.0, samples // n), n) for n in (20, 15))
    y, level = np.empty(samples), 20.0
    for k in range(samples):
        y[k] = level
        end = (heat[k] + 0.4 * sun[k] + 0.02 * 5.0) / 0.02
        level = end + (level - end) * np.exp(-0.02 * H)
    y += 2e-3 * np.std(y) * draw.standard_normal(samples)
    names = {"input_names": ("heat", "sun"), "output_names": ("T",)}
    return eoi.Record(
        H * np.arange(samples), np.stack([heat, sun], axis=1), y, hold="zero", **names
    )


@pytest.mark.slow
def test_an_input_that_the_model_leaves_out_is_found():
    room = eoi.plant_from_text(
        {"T": "g*heat - k*(T - T0)"}, {"g": 0.7, "k": 0.03, "T0": 8.0}, ["T"], ["heat", "sun"]
    )
    found = eoi.discover(room, sunny(1), validation=sunny(2))
    assert (found.status.code, found.effects) == ("complete", ("input_action",))
    assert found.plant.parameters["input_action_sun"] == pytest.approx(0.4, rel=0.02)
    assert found.plant.parameters["T0"] == pytest.approx(5.0, rel=0.05)
