"""A plant plus effects is a plant like any other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, own_states, place, unit
from eoi_jax.models.effects.effect import AbstractTerm, Parameter


def spring(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.b * u


def two_carts(t, x, u, p):
    (first, second), rates = x.y
    pull = p.k * (second - first)
    return jnp.stack([pull + u[0], -pull + u[1]]) - p.c * rates


def delayed(t, x, u, p):
    return x.z[0] - p.c * x.y[1]


def follower(t, x, u, p):
    return (p.b * u - x.z) / p.lag


MASS = eoi.Plant(
    spring,
    {"k": 20.0, "c": 0.8, "b": 2.0},
    relative_degree=2,
    bounds={"c": (0.0, 9.0)},
    fixed=("b",),
    units={"k": "1/s²", "u": "V", "y": "m"},
    name="one mass",
)
CARTS = eoi.Plant(
    two_carts,
    {"k": 3.0, "c": 0.1},
    relative_degree=2,
    inputs=("left", "right"),
    outputs=("first", "second"),
)
LAGGED = eoi.Plant(
    delayed,
    {"c": 0.5, "b": 2.0, "lag": 0.3},
    relative_degree=2,
    internal=follower,
    internal_initial=[0.7],
)


def at(plant: eoi.Plant, y, u, z=()):
    theta = jnp.asarray(plant.theta)
    state = eoi.State(jnp.asarray(y, dtype=float), jnp.asarray(z, dtype=float))
    return plant.derivative(jnp.asarray(0.5), state, jnp.asarray(u, dtype=float), theta), theta


def with_effects(plant: eoi.Plant, *several: tuple[eoi.effects.AbstractEffect, int, dict]):
    placed, values = [], {}
    for effect, channel, own in several:
        placed.append(place(plant, effect, channel))
        values |= own
    return augmented(plant, placed, values)


def test_nothing_added_is_the_same_plant():
    assert augmented(MASS, [], {}) is MASS


def test_augmented_plant_keeps_what_was_declared():
    new = with_effects(MASS, (effects.CoulombFriction(), 0, {"coulomb_friction": 0.5}))
    assert new.parameters == {**MASS.parameters, "coulomb_friction": 0.5}
    assert new.fixed == ("b",)
    assert (new.lower[1], new.upper[1]) == (0.0, 9.0)
    assert (new.lower[3], new.upper[3]) == (0.0, np.inf)
    assert new.units == {**MASS.units, "coulomb_friction": "m/s²"}
    assert (new.inputs, new.outputs, new.name) == (MASS.inputs, MASS.outputs, "one mass")
    assert new.dry_friction == (True,)
    assert new.internal is None


def test_term_is_added_to_the_declared_model():
    new = with_effects(MASS, (effects.CubicStiffness(), 0, {"cubic_stiffness": 5.0}))
    old, _ = at(MASS, [[0.3], [1.0]], [2.0])
    assert at(new, [[0.3], [1.0]], [2.0])[0] == pytest.approx(float(old[0]) - 5.0 * 0.3**3)


def test_parameters_are_named_by_effect_part_and_channel():
    assert place(MASS, effects.CoulombFriction(), 0).names == ("coulomb_friction",)
    assert place(MASS, effects.EndStop(), 0).names == ("end_stop_stiffness", "end_stop_position")
    assert place(CARTS, effects.CoulombFriction(), 1).names == ("coulomb_friction_second",)
    assert place(CARTS, effects.InputDelay(), 0).names == ("input_delay_left",)


def test_spring_between_two_outputs_acts_on_one_by_their_difference():
    placed = place(CARTS, effects.CubicStiffness(), 0, against=1)
    assert placed.names == ("cubic_stiffness_first_second",)
    new = augmented(CARTS, [placed], {"cubic_stiffness_first_second": 5.0})
    state = [[0.3, 0.1], [0.0, 0.0]]
    more = at(new, state, [0.0, 0.0])[0] - at(CARTS, state, [0.0, 0.0])[0]
    np.testing.assert_allclose(more, [-5.0 * 0.2**3, 0.0], atol=1e-15)


def test_damper_between_two_outputs_acts_by_the_difference_of_their_rates():
    placed = place(CARTS, effects.ViscousFriction(), 1, against=0)
    new = augmented(CARTS, [placed], {"viscous_friction_second_first": 2.0})
    state = [[0.3, 0.1], [0.5, -0.2]]
    more = at(new, state, [0.0, 0.0])[0] - at(CARTS, state, [0.0, 0.0])[0]
    np.testing.assert_allclose(more, [0.0, -2.0 * (-0.2 - 0.5)], atol=1e-15)


def test_name_that_is_taken_gets_a_number():
    new = with_effects(MASS, (effects.ConstantOffset(), 0, {"constant_offset": 1.0}))
    again = place(new, effects.ConstantOffset(), 0)
    assert again.names == ("constant_offset_2",)
    third = augmented(new, [again], {"constant_offset_2": 2.0})
    assert place(third, effects.ConstantOffset(), 0).names == ("constant_offset_3",)
    assert at(third, [[0.0], [0.0]], [0.0])[0] == pytest.approx(3.0)


def test_effect_acts_on_its_own_channel():
    new = with_effects(
        CARTS,
        (effects.ConstantOffset(), 1, {"constant_offset_second": 0.7}),
        (effects.InputSaturation(), 0, {"input_saturation_left": 1.0}),
    )
    rest = [[0.0, 0.0], [0.0, 0.0]]
    np.testing.assert_allclose(at(new, rest, [3.0, 3.0])[0], [1.0, 3.7])
    np.testing.assert_allclose(at(CARTS, rest, [3.0, 3.0])[0], [3.0, 3.0])


def test_input_effects_act_in_their_order():
    dead = (effects.InputDeadZone(), 0, {"input_dead_zone": 0.5})
    clip = (effects.InputSaturation(), 0, {"input_saturation": 1.0})
    rest = [[0.0], [0.0]]
    assert at(with_effects(MASS, dead, clip), rest, [3.0])[0] == pytest.approx(2.0 * 1.0)
    assert at(with_effects(MASS, clip, dead), rest, [3.0])[0] == pytest.approx(2.0 * 0.5)


def test_term_sees_the_input_as_recorded():
    """An input effect is between the record and the plant; terms are beside both."""

    class InputForce(AbstractTerm):
        name = "input_force"
        sentence = "a force with the input"
        gains = (Parameter("", "{f}/{u}"),)
        depends_on = "u"

        def term(self, at, gain, shape):
            return gain[0] * at.u

    new = with_effects(
        MASS,
        (effects.InputSaturation(), 0, {"input_saturation": 1.0}),
        (InputForce(), 0, {"input_force": 1.0}),
    )
    assert at(new, [[0.0], [0.0]], [3.0])[0] == pytest.approx(2.0 * 1.0 + 3.0)


def test_states_of_effects_stand_behind_those_of_the_plant():
    zone, loop = effects.InputDeadZone(), effects.Hysteresis()
    new = with_effects(
        LAGGED,
        (loop, 0, dict(zip(place(LAGGED, loop, 0).names, (2.0, 0.1, 0.5), strict=True))),
        (zone, 0, {"input_dead_zone": 1.5}),
    )
    y, u, z = [[0.1], [1.0]], [3.0], [0.4, 0.25]
    value, theta = at(new, y, u, z)
    np.testing.assert_allclose(new.internal_start(theta), [0.7, 0.0])
    assert value == pytest.approx(0.4 - 0.5 * 1.0 - 2.0 * 0.25)
    state = eoi.State(jnp.asarray(y), jnp.asarray(z))
    rates = new.internal_rate(jnp.asarray(0.0), state, jnp.asarray(u), theta)
    # The plant's own state is driven by the changed input.
    own, bouc_wen = (2.0 * 1.5 - 0.4) / 0.3, (1.0 - 0.25) / 0.1
    np.testing.assert_allclose(rates, [own, bouc_wen])


def test_delay_and_lag_are_actuators_of_the_plant_and_come_one_after_the_other():
    time, h = 0.05 + 0.1 * np.arange(40), 0.1
    u = np.where(time > 1.0, 1.0, 0.0)[:, None]
    lagged = with_effects(LAGGED, (effects.ActuatorLag(), 0, {"actuator_lag": 0.2}))
    both = with_effects(lagged, (effects.InputDelay(), 0, {"input_delay": 0.5}))
    assert len(both.internal_start(jnp.asarray(both.theta))) == 1
    assert not both.is_affine
    late = np.asarray(both.driven(jnp.asarray(time), jnp.asarray(u), jnp.asarray(both.theta)))
    since = np.maximum(time + 0.5 * h - 1.5, 0.0)
    before = np.maximum(since - h, 0.0)
    # Mean over each step of 1 - exp(-(t - 1.5)/T).
    mean = 1.0 - 0.2 / h * (np.exp(-before / 0.2) - np.exp(-since / 0.2))
    np.testing.assert_allclose(late[:, 0], np.where(since > 1e-9, mean, 0.0), atol=1e-12)


def test_effects_can_be_added_to_an_augmented_plant():
    once = with_effects(LAGGED, (effects.InputDeadZone(), 0, {"input_dead_zone": 0.2}))
    twice = with_effects(once, (effects.ConstantOffset(), 0, {"constant_offset": 0.3}))
    y, u, z = [[0.1], [1.0]], [3.0], [0.4]
    assert at(twice, y, u, z)[0] == pytest.approx(float(at(once, y, u, z)[0][0]) + 0.3)
    assert twice.parameters == {**once.parameters, "constant_offset": 0.3}


def test_plant_without_inputs_takes_effects():
    free = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 4.0}, relative_degree=2, inputs=())
    new = with_effects(free, (effects.CoulombFriction(), 0, {"coulomb_friction": 0.5}))
    assert at(new, [[1.0], [2.0]], [])[0] == pytest.approx(-4.5)


def test_spill_leaves_the_state_and_its_share_reaches_the_first_output():
    plant = eoi.Plant(
        lambda t, x, u, p: p.k * (x.z[1] - x.y[0]),
        {"k": 0.5},
        internal=lambda t, x, u, p: jnp.stack([u[0] - p.k * x.z[0], p.k * (x.z[0] - x.z[1])]),
        internal_initial=(0.0, 0.0),
    )
    spill = effects.InternalOverflow()
    first = {"overflow_share_z1": 0.25, "overflow_rate_z1": 2.0, "overflow_level_z1": 0.5}
    zone = effects.InputDeadZone()
    new = with_effects(plant, (zone, 0, {"input_dead_zone": 0.75}), (spill, 0, first))
    assert (own_states(plant), own_states(new)) == (2, 2)
    theta = jnp.asarray(new.theta)
    for level, lost in ((0.3, 0.0), (0.8, 0.6)):
        state = eoi.State(jnp.zeros((1, 1)), jnp.array([level, 0.2]))
        f = new.derivative(jnp.zeros(()), state, jnp.ones(1), theta)
        np.testing.assert_allclose(f, [0.1 + 0.25 * lost], atol=1e-12)
        rates = new.internal_rate(jnp.zeros(()), state, jnp.ones(1), theta)
        own = [0.25 - 0.5 * level - lost, 0.5 * (level - 0.2)]
        np.testing.assert_allclose(rates, own, atol=1e-12)


def test_bounds_of_an_effect_can_be_narrowed():
    placed = place(MASS, effects.InputDelay(), 0)
    new = augmented(MASS, [placed], {"input_delay": 0.1}, {"input_delay": (0.05, 0.3)})
    assert (new.lower[-1], new.upper[-1]) == (0.05, 0.3)


def test_a_second_store_follows_an_output_of_degree_one_beside_one_of_degree_two():
    def joint(t, x, u, p):
        return jnp.stack([x.y[0, 1] - p.spring * x.y[0, 0], u[0] - p.loss * x.y[0, 1]])

    plant = eoi.Plant(joint, {"spring": 4.0, "loss": 0.5}, (2, 1), ("u",), ("angle", "heat"))
    placed = place(plant, effects.SecondNode(), 1)
    stored = augmented(plant, [placed], dict(zip(placed.names, (0.3, 0.2), strict=True)))
    state = eoi.State(jnp.array([[0.1, 2.0], [7.0, 0.0]]), jnp.array([-0.4]))
    rate = stored.internal_rate(jnp.zeros(()), state, jnp.array([3.0]), jnp.asarray(stored.theta))
    heat_rate = 3.0 - 0.5 * 2.0 + 0.3 * -0.4
    np.testing.assert_allclose(rate, [-0.2 * -0.4 - heat_rate], rtol=1e-12)


@pytest.mark.parametrize(
    ("effect", "units"),
    [
        (effects.ViscousFriction(), ["1/s"]),
        (effects.CubicStiffness(), ["m/s²/(m)³"]),
        (effects.StribeckFriction(), ["m/s²", "m/s²", "m/s"]),
        (effects.PositionRipple(), ["m/s²", "m/s²", "1/m"]),
        (effects.InputDeadZone(), ["V"]),
        (effects.InputDelay(), ["s"]),
        (effects.Drift(), ["m/s²/s"]),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_units_follow_from_those_of_the_channel(effect, units):
    placed = place(MASS, effect, 0)
    assert [unit(MASS, placed, one.unit) for one in effect.parameters] == units


VISCOUS = {
    "a speed": ({"y": "rad/s"}, 1, None, "1/s"),
    "a position": ({"y": "m"}, 2, None, "1/s"),
    "a position of degree three": ({"y": "m"}, 3, None, "1/s²"),
    "a position without a unit": ({}, 3, None, "1/s²"),
    "a force": ({"y": "m", "u": "N"}, 2, 0, "N/(m/s)"),
    "a push of the speed's own kind": ({"y": "m", "u": "m/s²"}, 2, 0, "1/s"),
    "a force without a unit": ({"y": "m"}, 2, 0, ""),
}


@pytest.mark.parametrize(("units", "degree", "through", "text"), VISCOUS.values(), ids=VISCOUS)
@pytest.mark.parametrize("effect", [effects.ViscousFriction(), effects.AsymmetricViscousFriction()])
def test_viscous_friction_is_in_the_unit_of_what_it_adds_to_over_the_velocity(
    effect, units, degree, through, text
):
    plant = eoi.Plant(lambda t, x, u, p: p.k * u[0] - x.y[0], {"k": 1.0}, degree, units=units)
    placed = place(plant, effect, 0, None, through)
    assert unit(plant, placed, effect.gains[0].unit) == text


LOWER = {"end_stop_lower_stiffness": 4.0, "end_stop_lower_position": -0.2}


def test_equal_augmented_plants_are_compiled_once():
    several = (effects.EndStop(-1), 0, LOWER)
    upper = {name.replace("lower_", ""): value for name, value in LOWER.items()}
    other = (effects.EndStop(+1), 0, upper)
    traced = []

    @jax.jit
    def value(plant, y):
        traced.append(1)
        return plant.derivative(y[0, 0], eoi.State(y, jnp.zeros(0)), jnp.zeros(1), plant.theta)

    y = jnp.asarray([[-1.0], [0.0]])
    first, second = (value(with_effects(MASS, several), y) for _ in range(2))
    assert len(traced) == 1
    assert float(first[0]) == float(second[0])
    value(with_effects(MASS, other), y)
    assert len(traced) == 2


def test_augmented_plant_runs_and_is_validated_like_any_other():
    new = with_effects(
        eoi.plants.mass_spring_damper(), (effects.InputDelay(), 0, {"input_delay": 0.1})
    )
    time = 1e-2 * np.arange(400)
    drive = eoi.excitation.multisine(time, 1.0, (0.5, 3.0), 5, seed=1)
    record = eoi.simulate(new, time, drive, substeps=4)
    checked = eoi.validate(new, record)
    assert checked.rmse[0] < 1e-6 * np.std(record.outputs)
