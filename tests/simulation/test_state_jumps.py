"""Which comparisons of a plant are jumps of its equations."""

import jax.numpy as jnp
import pytest

import eoi_jax as eoi
from eoi_jax.simulation.state_jumps import state_jumps


def wall(t, x, u, p):
    q, v = x.y[:, 0]
    return u[0] - jnp.where(q > 0.1, p.a * (q - 0.1) + p.c * v, 0.0)


def elastic(t, x, u, p):
    return u[0] - jnp.where(x.y[0, 0] > 0.1, p.a * (x.y[0, 0] - 0.1), 0.0)


def ditch(t, x, u, p):
    return -jnp.where((x.y[0, 0] > 1.0) & (x.y[0, 0] < 2.0), p.a, 0.0)


def friction(t, x, u, p):
    return wall(t, x, u, p) - p.a * jnp.sign(x.y[1, 0])


def root(t, x, u, p):
    return -jnp.where(x.y[0, 0] > 0.0, jnp.sqrt(x.y[0, 0]), 0.0)


def clocked(t, x, u, p):
    return -jnp.where(t > 1.0, p.a, 0.0) - jnp.maximum(x.y[0, 0], p.c)


@pytest.mark.parametrize(
    ("equations", "jumps"),
    [
        (wall, (0,)),
        (ditch, (0, 1)),
        (lambda t, x, u, p: -p.a * jnp.sign(x.y[0, 0]), (0,)),
        (elastic, ()),
        (root, ()),
        (clocked, ()),
        (friction, ()),  # its steps end at its stops
    ],
)
def test_jumps_are_told_from_kinks(equations, jumps):
    assert state_jumps(eoi.Plant(equations, {"a": 1.0, "c": 0.0}, 2)) == jumps


def test_the_library_has_no_plant_that_jumps_with_the_state():
    for plant in (eoi.plants.cascaded_tanks(), eoi.plants.pendulum(), eoi.plants.level_tank()):
        assert state_jumps(plant) == ()
