"""Angles in degrees where a function takes radians."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.check_records import check_records

TIME = np.arange(200) * 0.01


def _record(**units):
    return eoi.Record(
        TIME,
        np.zeros((200, 1)),
        np.sin(TIME),
        input_names=("torque",),
        output_names=("angle",),
        units=units,
    )


def _plant(rate, **units):
    return eoi.Plant(
        lambda t, x, u, p: rate(x.y[0, 0], p) + u[0],
        parameters={"G": 3.0, "k": 0.02},
        relative_degree=2,
        inputs=("torque",),
        outputs=("angle",),
        units=units,
        name="arm",
    )


@pytest.mark.parametrize(
    "rate",
    [
        lambda q, p: -p.G * jnp.sin(q),
        lambda q, p: -p.G * jnp.cos(q - p.k),
        lambda q, p: -p.G * jnp.tan(q / 2),
        lambda q, p: -p.G * jnp.sin(1.0 - 2.0 * q),
    ],
)
def test_functions_of_angles_in_degrees_are_refused(rate):
    name = r"`model.units\[angle\]` must be rad, of which (sin|cos|tan) is taken in .*arm.*got deg"
    with pytest.raises(ValueError, match=name + r".*(sin|cos|tan)\(angle\*pi/180\)"):
        check_records(_plant(rate, angle="deg"), _record())
    with pytest.raises(ValueError, match=name):  # where only the record says so
        check_records(_plant(rate), _record(angle="deg"))
    check_records(_plant(rate, angle="rad"), _record())
    check_records(_plant(rate), _record())


@pytest.mark.parametrize(
    "rate",
    [
        lambda q, p: -p.G * jnp.sin(jnp.deg2rad(q)),
        lambda q, p: -p.G * jnp.sin(q * jnp.pi / 180 - p.k),
        lambda q, p: -p.G * jnp.sin(p.k * q),  # the factor is a parameter
        lambda q, p: -p.G * q + jnp.sin(p.k),
    ],
)
def test_converted_angles_are_accepted(rate):
    check_records(_plant(rate, angle="deg"), _record())


def test_internal_states_are_searched_too():
    plant = eoi.Plant(
        lambda t, x, u, p: x.z[0],
        parameters={"k": 1.0},
        inputs=("torque",),
        outputs=("angle",),
        internal=lambda t, x, u, p: -p.k * jnp.sin(x.y[0]) + u,
        internal_initial=(0.0,),
        units={"angle": "°"},
    )
    with pytest.raises(ValueError, match="must be rad, of which sin is taken"):
        check_records(plant, _record())
