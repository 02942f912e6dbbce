"""Outputs that are functions of the states: what a plant says of them, and what it refuses."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from output_cases import accelerometer, battery, mixed

from eoi_jax.models.plant import Plant, State


def curve(t, x, u, p):
    return p.a + p.b * u[0] + p.c * u[0] ** 2


CURVE = {"a": 1.0, "b": 2.0, "c": 3.0}


def test_a_plant_knows_which_outputs_are_functions_of_the_states():
    cell, both = battery(), mixed()
    assert (cell.degrees, cell.relative_degree, cell.rows, cell.has_algebraic) == ((0,), 0, 1, True)
    assert (both.degrees, both.relative_degree, both.rows) == ((2, 0), 2, 2)
    np.testing.assert_array_equal(both.algebraic, [False, True])
    assert both.dry_friction == (False, False)


def test_outputs_are_states_or_the_function_of_them():
    both = mixed(gain=2.0)
    y = jnp.asarray([[0.1, 0.0], [-0.3, 0.0]])
    u, theta = jnp.asarray([0.05]), jnp.asarray(both.theta)
    got = both.output(jnp.asarray(0.0), State(y, jnp.zeros(0)), u, theta)
    np.testing.assert_allclose(got, [0.1, 2.0 * (4.0 * 0.3 - 100.0 * 0.05) / 3.0], rtol=1e-12)


def test_a_static_curve_is_affine_and_a_cell_is_not():
    assert Plant(curve, CURVE, relative_degree=0).is_affine
    assert not battery().is_affine


def test_an_acceleration_shows_where_dry_friction_of_another_output_jumps():
    def rubbing(t, x, u, p):
        a = u[0] - p.c * jnp.sign(x.y[1, 0])
        return jnp.stack([a, a])

    plant: Any = Plant(rubbing, {"c": 1.0}, relative_degree=(2, 0), outputs=("x", "acc"))
    assert plant.dry_friction == (True, False)
    np.testing.assert_array_equal(plant.jumps, [[True, False], [True, False]])


def reads_itself(t, x, u, p):
    return p.a + 0.5 * x.y[0, 0]


def spring_of_a_sensor(t, x, u, p):
    return jnp.stack([-p.a * x.y[0, 1] + u[0], p.b * x.y[0, 0]])


def read_by_a_state(t, x, u, p):
    return x.y[0, 0] - p.a * x.z


def nothing(t, x, u, p):
    return 2.0 * u[0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"dynamics": reads_itself, "parameters": {"a": 1.0}},
            (
                "`relative_degree` must be 1 or more for an output that the model reads; with 0, y "
                "is no state, got 0, and itself depends on y. Write out the formula"
            ),
        ),
        (
            {
                "dynamics": spring_of_a_sensor,
                "parameters": {"a": 1.0, "b": 1.0},
                "relative_degree": (2, 0),
                "outputs": ("x", "s"),
            },
            "with 0, s is no state, got 0, and x depends on s",
        ),
        (
            {
                "dynamics": lambda t, x, u, p: p.a * x.z[0],
                "parameters": {"a": 1.0},
                "internal": read_by_a_state,
                "internal_initial": (0.0,),
            },
            "with 0, y is no state, got 0, and an internal state depends on y",
        ),
        (
            {"dynamics": nothing, "parameters": {"a": 1.0}},
            (
                "`dynamics` must give an output y that depends on a state or a parameter, got a "
                "function of the inputs and of the time alone"
            ),
        ),
        (
            {"dynamics": curve, "parameters": CURVE, "relative_degree": -1},
            (
                "`relative_degree` must be an integer ≥ 0, or 1 of them, one an output, got -1. 0 "
                "is an output that is a function of the states"
            ),
        ),
    ],
)
def test_what_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Plant(**{"relative_degree": 0, **arguments})


def test_two_sensors_of_one_state():
    def sensors(t, x, u, p):
        return jnp.stack([x.z[0], p.scale * x.z[1]])

    def motion(t, x, u, p):
        return jnp.stack([x.z[1], u[0] - p.b * x.z[1]])

    plant: Any = Plant(
        sensors,
        {"b": 1.0, "scale": 0.5},
        relative_degree=0,
        outputs=("position", "speed"),
        internal=motion,
        internal_initial=lambda p: (0.1, 0.2 * p.b),
    )
    np.testing.assert_allclose(plant.initial_internal, [0.1, 0.2])
    x = State(jnp.zeros((1, 2)), jnp.asarray([3.0, 4.0]))
    got = plant.output(jnp.asarray(0.0), x, jnp.zeros(1), jnp.asarray(plant.theta))
    np.testing.assert_allclose(got, [3.0, 2.0])
    assert accelerometer().declared_anew(parameters={"k": 80.0}).degrees == (0,)


def test_an_output_may_depend_on_differences_of_states_alone():
    """Of a body on a wheel, both at rest: equal moves of all states change no spring."""

    def body(t, x, u, p):
        return p.spring * (x.z[1] - x.z[0])

    def motion(t, x, u, p):
        return jnp.stack([0.0 * u[0], u[0] - x.z[1]])

    plant = Plant(
        body, {"spring": 2.0}, 0, internal=motion, internal_initial=lambda p: jnp.zeros(2)
    )
    assert plant.degrees == (0,)
