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
    sums, size = along(_shifted, ("fixed", "rows"), plant, _signals(plant, points))
    sums, size = sums[:, channel], size[:, channel]
    return bool(np.any(size > 0.0) and np.all(sums <= 1e3 * np.finfo(size.dtype).eps * size))


def subtracts_output(plant: Plant, channel: int, points: int = 16) -> bool:
    """Whether f takes an input from the first output before it does anything else with it.

    Then f is a function of their difference, and apart from that one of the output: a servo under a
    weight. What the input adds does not change where both grow by as much: ∂f/∂u + ∂f/∂y is free of
    u. It is not where the level of one tank fills another one.

    Args:
        plant: with its parameter values.
        channel: index of the input.
        points: at so many of them; those at which f has no derivatives tell nothing.
    """
    sums, size = along(_bent, ("fixed", "rows"), plant, _signals(plant, points))
    sums, size = sums[:, channel], size[:, channel]
    clear = np.isfinite(sums) & np.isfinite(size)
    return bool(np.all(sums[clear] <= 1e3 * np.finfo(size.dtype).eps * size[clear]))


def _signals(plant: Plant, points: int) -> tuple[Any, ...]:
    """Any points: a difference shows at each."""
    draw = np.random.default_rng(0)
    y = draw.uniform(-1.0, 1.0, (points, plant.rows, len(plant.outputs)))
    u = draw.uniform(-1.0, 1.0, (points, len(plant.inputs)))
    return np.zeros(points), y, u


def _bent(plant: Plant, point: tuple[Any, ...]) -> tuple[Any, Any]:
    """|∂²f/∂u² + ∂²f/∂u∂y| of each input, added up over f, and the sizes of the two terms."""
    t, y, u = point
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def derivative(y: Any, u: Any) -> Any:
        return plant.derivative(t, State(y, z), u, theta)

    by_inputs = jax.jacfwd(derivative, argnums=1)
    own = jnp.diagonal(jax.jacfwd(by_inputs, argnums=1)(y, u), axis1=1, axis2=2)
    mixed = jax.jacfwd(by_inputs)(y, u)[:, :, 0, 0]
    return (
        jnp.sum(jnp.abs(own + mixed), axis=0),
        jnp.sum(jnp.abs(own) + jnp.abs(mixed), axis=0),
    )


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
