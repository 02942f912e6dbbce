"""Inputs of free runs behind delays and lags, and their derivatives with all unknowns."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from eoi_jax.models.actuators import changed_inputs, have_past
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.sensitivity import Host
from eoi_jax.simulation.simulate import (
    actuated,
    changed_on_host,
    step_means,
)


class DrivenInputs(eqx.Module):
    """Inputs of all runs behind the actuators, and their derivatives.

    Attributes:
        inputs: at the start, the middle and the end of each step.
        slope: of `changed_inputs` with the parameters that may move them.
        past: of the same with the levels before the record of all inputs, of the first run of each
            segment; zero for others.
    """

    inputs: Float[Host, "runs rows 3 nu"]
    slope: Float[Host, "runs rows 3 changed acting"]
    past: Float[Host, "runs rows 3 changed nu"]


def driven_inputs(
    plant: Plant,
    acting: Sequence[int],
    theta: Array,
    record_drives: Sequence[Drive],
    levels: Host,
    places: Int[Array, "runs rows"],
    leaders: Int[Host, " segments"],
) -> DrivenInputs:
    """Inputs behind the actuators of a plant.

    Args:
        plant: with actuators; its own parameter values are not used.
        acting: numbers of the parameters with which derivatives are taken.
        theta: all parameters.
        record_drives: what drives each segment.
        levels: of the inputs before each segment, less their first values, (segments, nu).
        places: rows of all segments, one after the other, that each run takes.
        leaders: the first run of each segment.
    """
    levels = jnp.asarray(levels)

    def inputs_of_all(theta: Array, levels: Array) -> Array:
        parts = zip(record_drives, levels, strict=True)
        return jnp.concatenate([actuated(plant, theta, part, level) for part, level in parts])

    def with_one_level(level: Array) -> Array:  # no segment sees that of another
        return inputs_of_all(theta, jnp.broadcast_to(level, levels.shape))

    inputs, slope = _with_slope(lambda theta: inputs_of_all(theta, levels), theta)
    changed = np.array(changed_inputs(plant.actuator, len(plant.inputs)), int)
    past = jax.jacfwd(with_one_level)(levels[0])[places][..., changed, :]
    leads = jnp.zeros(len(past)).at[leaders].set(1.0)
    slope = slope[..., changed, :][..., np.asarray(acting, int)]
    return DrivenInputs(inputs[places], slope[places], leads[:, None, None, None, None] * past)


def driven_on_host(
    plant: Plant,
    acting: Sequence[int],
    theta: Float[np.ndarray, " np"],
    record_drives: Sequence[Drive],
    levels: Float[np.ndarray, "segments nu"],
    places: Int[np.ndarray, "runs rows"],
    leaders: Int[np.ndarray, " segments"],
) -> DrivenInputs:
    """The same by NumPy, for an actuator of effects of the library; arguments as before.

    Derivatives with time constants and delays are differences: a delay is linear between samples,
    and a lag is smooth.
    """
    means = [step_means(np, plant, part) for part in record_drives]
    ends = None if plant.has_algebraic else -1

    def acted_at(theta: np.ndarray, levels: np.ndarray) -> np.ndarray:
        parts = zip(record_drives, means, levels, strict=True)
        return np.concatenate(
            [
                changed_on_host(plant, theta, averaged, part.substeps, level)[:ends]
                for part, averaged, level in parts
            ]
        )

    changed = acted_at(theta, levels)
    inputs = np.concatenate([averaged.stages[:ends] for averaged in means])[places]
    inputs[..., changed_inputs(plant.actuator, len(plant.inputs))] = changed[places]
    slope = np.empty((*places.shape, *changed.shape[1:], len(acting)))
    for column, i in enumerate(acting):

        def moved(value: float, i: int = i) -> np.ndarray:
            return acted_at(_with(theta, i, value), levels)

        slope[..., column] = _difference(moved, theta[i], record_drives)[places]
    past = np.zeros((*places.shape, *changed.shape[1:], levels.shape[-1]))
    for column in np.flatnonzero(have_past(plant.actuator, levels.shape[-1])).tolist():
        change = _change(record_drives, column)
        risen = _with_level(lambda past: acted_at(theta, past), levels, column, change)
        past[leaders, ..., column] = risen[places[leaders]]
    return DrivenInputs(inputs, slope, past)


def _with(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    changed = np.array(array, dtype=float)
    changed[place] = value
    return changed


def _change(record_drives: Sequence[Drive], column: int, share: float = 0.1) -> float:
    """Change of the level of an input for differences: a `share` of its range; 1 without one.

    A limit of the rate makes up for a small one within a step, and has no derivative there.
    """
    starts = [np.asarray(part.inputs)[:, 0, column] for part in record_drives]
    reach = max(map(np.max, starts)) - min(map(np.min, starts))
    return float(share * reach) or 1.0


def _with_level(
    function: Callable[[np.ndarray], np.ndarray],
    levels: Float[np.ndarray, "segments nu"],
    column: int,
    change: float,
) -> np.ndarray:
    """Derivative with the level of one input before each segment, by a central difference."""
    place = slice(None), column
    high, low = (_with(levels, place, levels[place] + step) for step in (change, -change))
    return (function(high) - function(low)) / (2.0 * change)


def _difference(
    function: Callable[[float], np.ndarray],
    value: float,
    record_drives: Sequence[Drive],
    step: float = 1e-5,
) -> np.ndarray:
    """Derivative with a time [s], by a difference of `step` times the steps of the simulation.

    Central, but from zero on forward: there is no negative time. Of a time far longer than those
    steps it is a larger one, beside which rounding is small.
    """
    shortest = np.sqrt(np.finfo(float).eps) * abs(value)
    change = max(step * min(float(part.step) for part in record_drives), shortest)
    below = max(value - change, 0.0) if value >= 0.0 else value - change
    return (function(value + change) - function(below)) / (value + change - below)


def _with_slope(function: Callable[[Array], Array], theta: Array) -> tuple[Array, Array]:
    """A function of θ and its derivative, evaluated once."""

    def twice(theta: Array) -> tuple[Array, Array]:
        value = function(theta)
        return value, value

    slope, value = jax.jacfwd(twice, has_aux=True)(theta)
    return value, slope
