"""Inputs of free runs behind delays and lags, and their derivatives with all unknowns."""

from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.sensitivity import Host
from eoi_jax.simulation.simulate import actuated


class DrivenInputs(eqx.Module):
    """Inputs of all runs behind the actuators, and their derivatives.

    Attributes:
        inputs: at the start, the middle and the end of each step.
        slope: with θ.
        past: with the levels before the record, of the first run of each segment; zero for others.
    """

    inputs: Float[Array, "runs rows 3 nu"]
    slope: Float[Array, "runs rows 3 nu np"]
    past: Float[Array, "runs rows 3 nu nu"]


def driven_inputs(
    plant: Plant,
    theta: Array,
    record_drives: Sequence[Drive],
    levels: Host,
    places: Int[Array, "runs rows"],
    leaders: Int[Host, " segments"],
) -> DrivenInputs:
    """Inputs behind the actuators of a plant.

    Args:
        plant: with actuators; its own parameter values are not used.
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
    past = jax.jacfwd(with_one_level)(levels[0])[places]
    leads = jnp.zeros(len(past)).at[leaders].set(1.0)
    return DrivenInputs(inputs[places], slope[places], leads[:, None, None, None, None] * past)


def _with_slope(function: Callable[[Array], Array], theta: Array) -> tuple[Array, Array]:
    """A function of θ and its derivative, evaluated once."""

    def twice(theta: Array) -> tuple[Array, Array]:
        value = function(theta)
        return value, value

    slope, value = jax.jacfwd(twice, has_aux=True)(theta)
    return value, slope
