r"""Errors of a sensor that do the same as a disturbance of the equation behind it.

With y = x + s(t) of what is measured, and f affine in y and its derivatives,

    y^(r) = f(y, ẏ, …) + s^(r) - Σ_i ∂f/∂y^(i) s^(i) .

A zero that is off by s is a constant -∂f/∂y s, however f depends on the derivatives; a drift is a
drift and a constant; a sinusoid is one of the same frequency.
"""

import numpy as np
from jaxtyping import Float

from eoi_jax.models.augmented import added_effects
from eoi_jax.models.effects import ConstantOffset, Drift, SinusoidalDisturbance
from eoi_jax.models.jacobians import Points, derivatives, state_slopes
from eoi_jax.models.plant import Plant


def sensor_errors(plant: Plant, points: Points) -> dict[str, float]:
    """By name of an added disturbance, the size of the error of the sensor that does the same.

    Args:
        plant: with effects, at its estimate.
        points: of a record, between which f is tested; inputs before any actuator.

    Returns:
        A zero [unit of y], a drift [unit of y/s], an amplitude [unit of y]. None of a plant with
        several outputs or internal states, nor where f is not affine there or has no stiffness.
    """
    if len(plant.outputs) != 1 or plant.internal is not None or plant.has_algebraic:
        return {}
    sizes = {}
    for placed in added_effects(plant):
        effect, values = placed.effect, [plant.parameters[name] for name in placed.names]
        if isinstance(effect, ConstantOffset | Drift):
            stiffness = -_slopes(plant, points, 1 if isinstance(effect, ConstantOffset) else None)
            if abs(stiffness[0]) > 0.0:  # NaN where f is not affine
                sizes[effect.name] = float(values[0] / stiffness[0])
        elif isinstance(effect, SinusoidalDisturbance):
            slopes, s = _slopes(plant, points), 1j * values[2]
            response = abs(s**plant.rows - slopes @ s ** np.arange(plant.rows))
            if response > 0.0:
                sizes[effect.name] = float(np.hypot(values[0], values[1]) / response)
    return sizes


def _slopes(
    plant: Plant, points: Points, rows: int | None = None, rounding: float = 1e-8
) -> Float[np.ndarray, " rows"]:
    """∂f/∂y, ∂f/∂ẏ, … of the first rows of `State.y`, in which f is affine; NaN where it is not.

    Args:
        plant: the plant.
        points: between which f is tested.
        rows: None: all.
        rounding: share of the largest value below which a difference is one of rounding.
    """
    time, y, u = points
    slopes = state_slopes(plant, time, y, u)[:, 0, :rows, 0]
    moved = np.array(y)
    moved[:, :rows] = np.roll(y[:, :rows], 1, axis=0)
    f, f_moved = derivatives(plant, time, y, u)[:, 0], derivatives(plant, time, moved, u)[:, 0]
    mean = np.mean(slopes, axis=0)
    error = f_moved - f - (moved - y)[:, :rows, 0] @ mean
    largest = np.max(np.abs([f, f_moved]))
    constant = np.all(np.ptp(slopes, axis=0) <= rounding * np.abs(mean))
    affine = constant and np.all(np.abs(error) <= rounding * largest)
    return np.where(affine, mean, np.nan)
