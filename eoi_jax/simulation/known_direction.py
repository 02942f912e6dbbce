"""Dry friction whose direction is known: from a simulation, not from a noisy velocity's sign.

A plant with dry friction moves up, moves down, or sticks. Progress which, for every step, its f is
smooth: beyond rest it goes on as it was (to first order), and at rest reaction holds it: as a
damper that a motion dies in, so that an error of the velocity from before does not outlast the
stop. No step has to be left out, and noise changes no sign.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._types import Input, Output, Scalar, Theta
from eoi_jax.models.plant import REST_SPEED, Actuator, Dynamics, Plant, State
from eoi_jax.models.velocities import velocity_of, with_velocity


@dataclass(frozen=True)
class _Directed:
    """f, given the direction of each output behind the inputs; equal for equal plants."""

    base: Dynamics
    degrees: tuple[int, ...]
    friction: tuple[int, ...]

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        ny, flags = len(self.friction), np.asarray(self.friction) > 0
        inputs, directions, grip = u[: -ny - 1], u[-ny - 1 : -1], u[-1]
        rate = velocity_of(x.y, self.degrees)
        limited = jnp.where(flags, directions * jnp.maximum(directions * rate, REST_SPEED), rate)

        def f(rate: Any) -> Any:
            moved = State(with_velocity(x.y, rate, self.degrees), x.z)
            value = self.base(t, moved, inputs, p)
            return jnp.reshape(jnp.asarray(value), (ny,))

        value, correction = jax.jvp(f, (limited,), (rate - limited,))
        return jnp.where(flags & (directions == 0), -grip * rate, value + correction)


@dataclass(frozen=True)
class OwnInputs:
    """g of a plant that was given more inputs: it reads the first ones, its own, alone."""

    base: Dynamics
    count: int

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        """What g gives."""
        return self.base(t, x, u[: self.count], p)


@dataclass(frozen=True)
class _Actuated:
    """Actuators act on the inputs alone."""

    base: Actuator
    count: int

    def __call__(self, t: Any, u: Any, p: Any) -> Any:
        return jnp.concatenate([self.base(t, u[:, : self.count], p), u[:, self.count :]], axis=1)


def directed(plant: Plant, friction: tuple[int, ...]) -> Plant:
    """The plant with more inputs: of each output +1 moving up, −1 moving down, 0 at rest; the grip.

    The grip is the damping of an output at rest [1/s].

    Args:
        plant: with relative degree 2, or 1, wherever `friction` is true.
        friction: which outputs have dry friction, on themselves alone.
    """
    count = len(plant.inputs)
    start = plant.internal_initial
    return Plant(
        _Directed(plant.dynamics, plant.degrees, friction),
        plant.parameters,
        plant.degrees,
        (*plant.inputs, *(f"direction of {name}" for name in plant.outputs), "grip"),
        plant.outputs,
        plant.internal and OwnInputs(plant.internal, count),
        start if plant.internal else None,
        {
            name: (low, high)
            for name, low, high in zip(
                plant.names, plant.lower.tolist(), plant.upper.tolist(), strict=True
            )
        },
        plant.fixed,
        plant.units,
        plant.name,
        plant.actuator and _Actuated(plant.actuator, count),
    )


def turn(
    plant: Plant, theta: Theta, t: Scalar, x: State, u: Input, previous: Output
) -> Float[Array, " ny"]:
    """What a moment of rest does to sensitivities of each velocity.

    A rest that comes δt later has moved the velocity by δv = -a⁻ δt, and leaves it moved by a⁺ δt:
    derivatives of the velocity change by the factor a⁺/a⁻, zero where the plant sticks.

    Args:
        plant: a directed one.
        theta: its parameters.
        t: time of the step [s].
        x: state at its start.
        u: inputs of the step, with directions and grip.
        previous: directions of the step before.

    Returns:
        That factor, 1 where an output goes on in its direction or leaves rest.

    Source: M. di Bernardo et al., *Piecewise-smooth Dynamical Systems*, section 2.5 (saltation).
    """
    ny = previous.shape[0]
    directions = u[-ny - 1 : -1]
    velocity = jnp.where(previous == directions, velocity_of(x.y, plant.degrees), 0.0)
    at_rest = State(with_velocity(x.y, velocity, plant.degrees), x.z)
    old, new = (
        plant.derivative(t, at_rest, u.at[-ny - 1 : -1].set(direction), theta)
        for direction in (previous, directions)
    )
    # Friction slows a motion down: it never turns back faster than it came.
    ratio = jnp.clip(new / jnp.where(old == 0, 1.0, old), 0.0, 1.0)
    return jnp.where(
        (previous == 0) | (previous == directions), 1.0, jnp.where(directions == 0, 0.0, ratio)
    )
