"""Inputs that carry a stream through the volume that an output stands for, found by probing."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.pointwise import along
from eoi_jax.models.plant import Plant, State


def stream_inputs(plant: Plant, output: int, points: int = 32) -> tuple[int, ...]:
    """Indices of the inputs u with -∂²f/∂y∂u of one output nowhere negative, and not all zero.

    A stream u renews the volume at a rate that is proportional to u: f = q(u) (inlet - y) + …. It
    is probed at the plant's own parameters.

    Args:
        plant: with its parameter values.
        output: index of an output of relative degree one.
        points: at so many of them.
    """
    draw = np.random.default_rng(0)  # any points: a product of two signals shows at each
    y = draw.uniform(0.1, 1.0, (points, plant.rows, len(plant.outputs)))
    y *= 10.0 ** draw.uniform(-1.0, 3.0, (points, 1, 1))
    u = draw.uniform(0.1, 1.0, (points, len(plant.inputs)))
    signals = np.zeros(points), y, u
    slopes, size = along(_renewed, ("fixed", "rows"), plant, signals)
    slopes, size = slopes[:, output], size[:, output]
    tolerance = 1e3 * np.finfo(size.dtype).eps * size
    streams = np.all(slopes > -tolerance, axis=0) & np.any(slopes > tolerance, axis=0)
    return tuple(np.flatnonzero(streams).tolist())


def _renewed(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """-∂²f/∂y∂u, shape (ny, nu), and the size of ∂f/∂y over that of u."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def slopes(u: Any) -> Any:
        def derivative(y: Any) -> Any:
            return plant.derivative(t, State(y, z), u, theta)

        return jnp.diagonal(jax.jacfwd(derivative)(y)[:, 0, :])

    return -jax.jacfwd(slopes)(u), jnp.abs(slopes(u))[:, None] / u
