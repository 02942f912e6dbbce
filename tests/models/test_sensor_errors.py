"""Errors of a sensor in whose place a disturbance of the equation does the same."""

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import ConstantOffset, CoulombFriction, Drift, SinusoidalDisturbance
from eoi_jax.models.plant import Plant
from eoi_jax.models.sensor_errors import sensor_errors

K, C = 50.0, 3.0
TIME = np.linspace(0.0, 10.0, 40)
Y = np.stack([np.sin(TIME), np.cos(TIME)], axis=1)[..., None]
POINTS = TIME, Y, np.cos(3.0 * TIME)[:, None]


def spring(t, x, u, p):
    return u - p.k * x.y[0] - p.c * x.y[1]


def progressive(t, x, u, p):
    return u - p.k * x.y[0] * (1.0 + x.y[0] ** 2) - p.c * x.y[1]


def rubbed(t, x, u, p):
    return u - p.k * x.y[0] - p.c * jnp.sign(x.y[1])


def free(t, x, u, p):
    return p.k * u - p.c * x.y[1]


def with_effect(equation, effect, *values):
    plant = Plant(equation, {"k": K, "c": C}, 2)
    placed = place(plant, effect, 0)
    return augmented(plant, (placed,), dict(zip(placed.names, values, strict=True)))


def test_sizes_are_those_of_the_closed_form():
    offset = sensor_errors(with_effect(spring, ConstantOffset(), 10.0), POINTS)
    assert offset == pytest.approx({"constant_offset": 10.0 / K})
    drift = sensor_errors(with_effect(spring, Drift(), -2.0), POINTS)
    assert drift == pytest.approx({"drift": -2.0 / K})
    omega = 9.0
    wave = sensor_errors(with_effect(spring, SinusoidalDisturbance(), 3.0, 4.0, omega), POINTS)
    size = 5.0 / np.hypot(K - omega**2, C * omega)
    assert wave == pytest.approx({"sinusoidal_disturbance": size})


def test_a_zero_asks_for_a_linear_spring_alone_and_a_drift_for_a_linear_plant():
    assert sensor_errors(with_effect(progressive, ConstantOffset(), 10.0), POINTS) == {}
    assert sensor_errors(with_effect(free, ConstantOffset(), 10.0), POINTS) == {}
    with_friction = with_effect(rubbed, ConstantOffset(), 10.0)
    assert sensor_errors(with_friction, POINTS) == pytest.approx({"constant_offset": 10.0 / K})
    assert sensor_errors(with_effect(rubbed, Drift(), 2.0), POINTS) == {}
    assert sensor_errors(with_effect(rubbed, SinusoidalDisturbance(), 1.0, 0.0, 9.0), POINTS) == {}
    assert sensor_errors(with_effect(spring, CoulombFriction(), 1.0), POINTS) == {}


def test_a_sinusoid_asks_for_no_spring():
    size = sensor_errors(with_effect(free, SinusoidalDisturbance(), 1.0, 0.0, 9.0), POINTS)
    assert size == pytest.approx({"sinusoidal_disturbance": 1.0 / np.hypot(81.0, 9.0 * C)})


def test_outputs_that_are_several_or_no_states_and_internal_states_are_left_out():
    def pair(t, x, u, p):
        return -p.k * x.y[0]

    two = Plant(pair, {"k": K}, 1, outputs=("a", "b"))
    store = Plant(lambda t, x, u, p: -p.k * x.y[0] + x.z[0], {"k": K}, 1,
                  internal=lambda t, x, u, p: x.y[0] - x.z, internal_initial=(0.0,))  # fmt: skip
    for plant in (two, store):
        placed = place(plant, ConstantOffset(), 0)
        assert sensor_errors(augmented(plant, (placed,), {placed.names[0]: 1.0}), POINTS) == {}
