"""A motor with a load behind an elastic shaft; the speed of the motor alone is measured."""

from typing import Any

import jax.numpy as jnp

import eoi_jax as eoi


def motor(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    del t
    twist, load = x.z
    return p.b * u - p.c * x.y[0] - p.k * twist - p.d * (x.y[0] - load)


def shaft(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """Twist, and the speed of the load: resonant at √(r k), driven by the measured speed."""
    del t, u
    (speed,), (twist, load) = x.y[0], x.z
    return jnp.stack([speed - load, p.r * (p.k * twist + p.d * (speed - load))])


def elastic_drive(**parameters: float) -> eoi.Plant:
    """The plant with these values of b, c, k, d and r."""
    return eoi.Plant(motor, parameters, 1, internal=shaft, internal_initial=(0.0, 0.0))
