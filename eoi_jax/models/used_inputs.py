"""Inputs that the equations of a plant have, and how, found by probing."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from eoi_jax.compiler.pointwise import along
from eoi_jax.models.actuators import are_linear
from eoi_jax.models.plant import Plant, State


def used_inputs(plant: Plant, points: int = 16) -> Bool[np.ndarray, "ny nu"]:
    """Which inputs the highest derivative of each output depends on; all that a state depends on.

    An input that drives an internal state of the plant acts on outputs through it.

    Args:
        plant: with its parameter values.
        points: at so many of them it is probed.
    """
    if not plant.inputs:
        return np.zeros((len(plant.outputs), 0), dtype=bool)
    direct, inner = along(_slopes, ("fixed", "rows"), plant, _points(plant, points))
    # A slope that is no number is one all the same.
    return np.any(direct != 0.0, axis=0) | np.any(inner != 0.0, axis=(0, 1))


def affine_inputs(plant: Plant, points: int = 16) -> Bool[np.ndarray, " nu"]:
    """In which inputs the plant is affine, whatever its state, with an actuator that is linear.

    Arguments are those of `used_inputs`. Two that stand in a product are no such inputs.
    """
    if not plant.inputs:
        return np.zeros(0, dtype=bool)
    t, y, u = _points(plant, points)
    first, second = (
        np.concatenate(along(_slopes, ("fixed", "rows"), plant, (t, y, inputs)), axis=1)
        for inputs in (u, -0.3 * u[::-1])
    )
    with np.errstate(invalid="ignore"):
        equal = np.abs(first - second) <= 1e-9 * np.maximum(np.abs(first), np.abs(second))
    affine = np.all(equal | (np.isnan(first) & np.isnan(second)), axis=(0, 1))
    return affine & np.asarray(are_linear(plant.actuator, len(plant.inputs)))


def product_inputs(plant: Plant, points: int = 16) -> Bool[np.ndarray, "ny nu"]:
    """Which inputs stand in the equation of an output in products with other signals alone.

    A term that is proportional to such an input is none that the equation has: the voltage that a
    diode takes in a converter, whose duty multiplies its voltages and currents. What an input does
    to a state of the plant is not asked.

    Arguments are those of `used_inputs`.
    """
    multiplied = np.zeros((len(plant.outputs), len(plant.inputs)), dtype=bool)
    t, y, u = _points(plant, points)
    for k in range(len(plant.inputs)):
        single = np.where(np.arange(len(plant.inputs)) == k, u, 0.0)
        slopes, _ = along(_slopes, ("fixed", "rows"), plant, (t, 0.0 * y, single))
        multiplied[:, k] = np.all(slopes[..., k] == 0.0, axis=0)
    return multiplied & used_inputs(plant, points)


def _points(plant: Plant, points: int) -> tuple[Any, Any, Any]:
    """Time, outputs and inputs at any points: an input that is not there shows at none."""
    draw = np.random.default_rng(0)
    y = draw.uniform(0.1, 1.0, (points, plant.rows, len(plant.outputs)))
    y *= 10.0 ** draw.uniform(-1.0, 3.0, (points, 1, 1))
    u = draw.uniform(0.1, 1.0, (points, len(plant.inputs)))
    u *= 10.0 ** draw.uniform(-1.0, 3.0, (points, 1))
    return np.zeros(points), y, u


def _slopes(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """∂f/∂u, shape (ny, nu), and ∂g/∂u, shape (nz, nu)."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    x = State(y, plant.internal_start(theta))
    inner = jnp.zeros((0, len(u)))
    if plant.internal is not None:
        inner = jax.jacfwd(lambda u: plant.internal_rate(t, x, u, theta))(u)
    return plant.input_slopes(t, x, u, theta), inner
