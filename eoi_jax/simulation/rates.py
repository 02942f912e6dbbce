"""What the parts of an integration step share: slopes, inputs within a step, a zero within it."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._types import Flags, Input, Output, Scalar, Theta
from eoi_jax.models.plant import Plant, State

Fraction = Scalar | float


def rate_of(plant: Plant, theta: Theta, t: Scalar, x: State, u: Input) -> State:
    """dx/dt: a chain of integrators for each output, with f at its end."""
    f = plant.derivative(t, x, u, theta)
    shifted = jnp.concatenate([x.y[1:], jnp.zeros_like(x.y[:1])])
    last = np.arange(x.y.shape[0])[:, None] == np.asarray(plant.degrees)[None, :] - 1
    y = jnp.where(last, f[None, :], shifted)
    return State(y, plant.internal_rate(t, x, u, theta))


def added(x: State, scale: Fraction, slope: State) -> State:
    """x + scale · slope."""
    return State(x.y + scale * slope.y, x.z + scale * slope.z)


def scaled(scale: Fraction, x: State) -> State:
    """scale · x."""
    return State(scale * x.y, scale * x.z)


def input_within(inputs: Float[Array, "3 nu"], fraction: Fraction) -> Input:
    """Inputs at a fraction of a step: a parabola, exact for held and linear inputs.

    Args:
        inputs: at the start, the middle and the end of the step.
        fraction: of the step.
    """
    first, middle, last = inputs
    slope = 4.0 * middle - 3.0 * first - last
    return first + fraction * (slope + fraction * (2.0 * (first - 2.0 * middle + last)))


def first_zero(v0: Output, dv: Output, v1: Output, direction: Output, stops: Flags) -> Output:
    """Where the parabola v0 + dv σ + (v1 − v0 − dv) σ² falls through zero, σ in [0, 1].

    `dv` is the initial slope over the whole length. 1 where an output does not stop.
    """
    # Seen in the direction of motion: starts at v0 ≥ 0, ends below zero, so one root lies between.
    v0, dv, v1 = direction * v0, direction * dv, direction * v1
    bend = v1 - v0 - dv
    root = jnp.sqrt(jnp.where(stops, jnp.maximum(dv * dv - 4.0 * bend * v0, 0.0), 1.0))
    # The form of the root that does not cancel; each has a divisor ≠ 0 where it is used.
    rising = stops & (dv > 0)
    falling = stops & ~rising & (v0 > 0)
    late = (dv + root) / jnp.where(rising, -2.0 * bend, 1.0)
    early = 2.0 * v0 / jnp.where(falling, root - dv, 1.0)
    zero = jnp.where(rising, late, jnp.where(falling, early, 0.0))
    return jnp.where(stops, jnp.clip(zero, 0.0, 1.0), 1.0)
