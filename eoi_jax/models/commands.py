"""Inputs that command an output: a model knows both by their difference, the control error."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.pointwise import along
from eoi_jax.models.plant import Plant, State


def commands_output(plant: Plant, channel: int, points: int = 16) -> bool:
    """Whether f depends on an input and on the first output by their difference alone.

    Then f does not change where both grow by as much: ∂f/∂u + ∂f/∂y = 0. It is probed at the
    plant's own parameters.

    Args:
        plant: with its parameter values.
        channel: index of the input.
        points: at so many of them.
    """
    if plant.degrees[0] == 0:
        return False
    draw = np.random.default_rng(0)  # any points: a difference shows at each
    y = draw.uniform(-1.0, 1.0, (points, plant.rows, len(plant.outputs)))
    u = draw.uniform(-1.0, 1.0, (points, len(plant.inputs)))
    signals = np.zeros(points), y, u
    sums, size = along(_shifted, ("fixed", "rows"), plant, signals)
    sums, size = sums[:, channel], size[:, channel]
    return bool(np.any(size > 0.0) and np.all(sums <= 1e3 * np.finfo(size.dtype).eps * size))


def _shifted(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """|∂f/∂u + ∂f/∂y| and |∂f/∂u| of each input, added up over f; y is the first output."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def derivative(y: Any, u: Any) -> Any:
        return plant.derivative(t, State(y, z), u, theta)

    by_output = jax.jacfwd(derivative)(y, u)[:, 0, 0]
    by_inputs = jax.jacfwd(derivative, argnums=1)(y, u)
    return (
        jnp.sum(jnp.abs(by_inputs + by_output[:, None]), axis=0),
        jnp.sum(jnp.abs(by_inputs), axis=0),
    )
