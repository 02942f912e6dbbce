"""Instants at which the equations of a plant jump with time, found by bisection.

A step of an explicit rule takes f at its start, its middle and its end: of a jump between them it
knows no better, and errs by a part of the step times the jump, of first order in the step.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.compiler.pointwise import along
from eoi_jax.models.plant import Plant, State


def time_jump(
    plant: Plant,
    time: Float[np.ndarray, " time"],
    bisections: int = 30,
    share: float = 0.5,
    smallest: float = 1e-6,
) -> float | None:
    """The first instant at which an equation jumps with time alone, whatever the state.

    Args:
        plant: with its parameter values.
        time: grid, between whose instants it is looked for [s].
        bisections: of each interval; in the last of them a smooth term changes by a billionth.
        share: of the change over an interval that is left if it is a jump.
        smallest: jump that counts, over the largest of all terms.

    Returns:
        The instant [s]; None where all equations are smooth in time.
    """
    low, high = time[:-1], time[1:]
    rates_low, rates_high = _rates(plant, low), _rates(plant, high)
    change = np.abs(rates_high - rates_low)
    if not np.any(change > 0.0):
        return None
    for _ in range(bisections):
        middle = 0.5 * (low + high)
        rates = _rates(plant, middle)
        rise_low, rise_high = (
            np.max(np.abs(part), axis=1) for part in (rates - rates_low, rates_high - rates)
        )
        in_lower = rise_low >= rise_high
        low, high = np.where(in_lower, low, middle), np.where(in_lower, middle, high)
        rates_low = np.where(in_lower[:, None], rates_low, rates)
        rates_high = np.where(in_lower[:, None], rates, rates_high)
    remaining = np.max(np.abs(rates_high - rates_low), axis=1)
    # Of a whole period in each interval nothing changes but by rounding.
    floor = np.maximum(share * np.max(change, axis=1), smallest * np.max(np.abs(rates_low)))
    jumps = remaining > floor
    return float(high[np.argmax(jumps)]) if np.any(jumps) else None


def _rates(plant: Plant, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n equations"]:
    """f and g at a state and inputs of no special relation."""
    draw = np.random.default_rng(0)
    y = draw.uniform(0.5, 1.5, (plant.rows, len(plant.outputs)))
    z = draw.uniform(0.5, 1.5, len(plant.initial_internal))
    u = draw.uniform(0.5, 1.5, len(plant.inputs))
    return np.asarray(
        along(_equations, ("fixed", "rows", "fixed", "fixed", "fixed"), plant, time, y, z, u)
    )


def _equations(plant: Plant, t: Any, y: Any, z: Any, u: Any) -> Any:
    theta, x = jnp.asarray(plant.theta), State(y, z)
    f = jnp.reshape(plant.derivative(t, x, u, theta), (-1,))
    return jnp.concatenate([f, jnp.reshape(plant.internal_rate(t, x, u, theta), (-1,))])
