"""Inputs that the equations of a plant have, found by probing."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from eoi_jax.compiler.pointwise import along
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
    draw = np.random.default_rng(0)  # any points: an input that is not there shows at none
    y = draw.uniform(0.1, 1.0, (points, plant.rows, len(plant.outputs)))
    y *= 10.0 ** draw.uniform(-1.0, 3.0, (points, 1, 1))
    u = draw.uniform(0.1, 1.0, (points, len(plant.inputs)))
    u *= 10.0 ** draw.uniform(-1.0, 3.0, (points, 1))
    direct, inner = along(_slopes, ("fixed", "rows"), plant, (np.zeros(points), y, u))
    # A slope that is no number is one all the same.
    return np.any(direct != 0.0, axis=0) | np.any(inner != 0.0, axis=(0, 1))


def _slopes(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """∂f/∂u, shape (ny, nu), and ∂g/∂u, shape (nz, nu)."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    x = State(y, plant.internal_start(theta))
    inner = jnp.zeros((0, len(u)))
    if plant.internal is not None:
        inner = jax.jacfwd(lambda u: plant.internal_rate(t, x, u, theta))(u)
    return plant.input_slopes(t, x, u, theta), inner
