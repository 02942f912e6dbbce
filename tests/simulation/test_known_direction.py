"""A plant whose dry friction is told the direction of each velocity from outside."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.compiler.programs import jit
from eoi_jax.simulation.known_direction import directed, turn

VALUES = {"c": 0.5, "q": 0.7, "b": 2.0}
GRIP = 9.0


def rubbing(t, x, u, p):
    rate = x.y[1]
    return p.b * u - p.c * jnp.sign(rate) - p.q * rate * jnp.abs(rate)


PLANT = eoi.Plant(rubbing, VALUES, 2)
DIRECTED = directed(PLANT, (1,))


@jit
def followed(rate, push, way):
    u = jnp.stack([push, way, jnp.asarray(GRIP)])
    x = eoi.State(jnp.stack([jnp.zeros(1), rate[None]]), jnp.zeros(0))
    return DIRECTED.derivative(jnp.asarray(0.0), x, u, jnp.asarray(PLANT.theta))[0]


@jit
def turned(c, push, before, way):
    u = jnp.stack([push, way, jnp.asarray(GRIP)])
    x = eoi.State(jnp.zeros((2, 1)), jnp.zeros(0))
    theta = jnp.stack([c, jnp.asarray(0.7), jnp.asarray(2.0)])
    return turn(DIRECTED, theta, jnp.asarray(0.0), x, u, before[None])[0]


@pytest.mark.parametrize(
    ("rate", "way", "expected"),
    [
        (0.3, 1.0, 2.0 * 1.5 - 0.5 - 0.7 * 0.09),
        (-0.3, -1.0, 2.0 * 1.5 + 0.5 + 0.7 * 0.09),
        (-0.3, 1.0, 2.0 * 1.5 - 0.5),  # beyond rest: as at rest, and its slope there
        (0.3, 0.0, -GRIP * 0.3),  # it sticks: the velocity is drawn to zero
    ],
)
def test_friction_acts_in_the_direction_that_it_is_told(rate, way, expected):
    found = float(followed(*map(np.asarray, (rate, 1.5, way))))
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("c", "before", "way", "expected"),
    [
        (0.5, 1.0, -1.0, (-2.0 + 0.5) / (-2.0 - 0.5)),  # a⁺/a⁻
        (-0.5, 1.0, -1.0, 1.0),  # never faster back than it came
        (3.0, 1.0, -1.0, 0.0),
        (0.5, 1.0, 1.0, 1.0),
        (0.5, 0.0, 1.0, 1.0),
        (0.5, 1.0, 0.0, 0.0),  # it sticks
    ],
)
def test_a_moment_of_rest_changes_sensitivities_of_the_velocity(c, before, way, expected):
    found = float(turned(*map(np.asarray, (c, -1.0, before, way))))
    assert found == pytest.approx(expected, rel=1e-12)


def test_outputs_that_go_on_keep_their_velocity_while_another_one_rests():
    """An angle beside its speed, both of relative degree one: the angle acts on the speed."""

    def both(t, x, u, p):
        angle, speed = x.y[0]
        return jnp.stack([speed, p.b * u[0] - p.q * angle - p.c * jnp.sign(speed)])

    plant = directed(eoi.Plant(both, VALUES, (1, 1), ("u",), ("angle", "speed")), (0, 1))
    x = eoi.State(jnp.asarray([[-2.0, 0.0]]), jnp.zeros(0))
    u = jnp.asarray([-1.0, 1.0, -1.0, GRIP])
    theta, previous = jnp.asarray(plant.theta), jnp.asarray([1.0, 1.0])
    factors = turn(plant, theta, jnp.asarray(0.0), x, u, previous)
    np.testing.assert_allclose(factors, [1.0, (-2.0 + 1.4 + 0.5) / (-2.0 + 1.4 - 0.5)], rtol=1e-9)
