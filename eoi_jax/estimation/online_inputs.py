"""Delays and lags of inputs sample by sample, with the derivatives of `Kernel.inputs`.

What acts on an input is a chain of effects, each with a memory of fixed length: the last inputs of
a delay, the state of a lag. A memory m and its input u move with the parameters θ behind them, so
that a step of an effect is that of

    m + (∂m/∂θ) δ,    u + (∂u/∂θ) δ,    θ + δ

and its derivative with δ. Before the record all inputs were as in its first step.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check
from eoi_jax.models.actuators import keeps_steps
from eoi_jax.models.augmented import actuator_effects
from eoi_jax.models.effects.effect import AbstractActuator
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Stage:
    """One effect of the chain.

    Attributes:
        effect: which.
        channel: index of its input.
        shapes: indices of its shape parameters in θ.
        size: of its memory.
        moving: directions along which its memory moves.
        directions: those along which its result does.
    """

    effect: AbstractActuator
    channel: int
    shapes: tuple[int, ...]
    size: int
    moving: tuple[int, ...]
    directions: tuple[int, ...]


class Memory(eqx.Module):
    """Of one effect.

    Attributes:
        values: shape (size,).
        slopes: their derivatives, shape (size, moving).
    """

    values: Float[Array, " size"]
    slopes: Float[Array, "size moving"]


class DrivenState(eqx.Module):
    """State of `DrivenInputs` between two steps.

    Attributes:
        memories: of all effects.
        starts: likewise, for inputs at the starts of the steps that are no means over them.
        last: means over the last step behind the actuators, with their derivatives, for inputs that
            are. Both are None where nothing asks for them.
    """

    memories: tuple[Memory, ...]
    starts: tuple[Memory, ...] | None = None
    last: tuple[Float[Array, " nu"], Float[Array, "nu directions"]] | None = None


class StepInputs(eqx.Module):
    """Inputs of one step behind the actuators; fields as in `kernel.Step`."""

    u: Float[Array, " nu"]
    slope: Float[Array, "nu directions"] | None
    u_start: Float[Array, " nu"] | None
    slope_start: Float[Array, "nu directions"] | None


class DrivenInputs(eqx.Module):
    """Inputs behind the actuators of a plant, as `init` and `step`; without actuators as they are.

    Args:
        plant: with its actuators.
        theta: parameter values, numbers: the lengths of delays in samples are theirs.
        sample_period: h [s].
        columns: directions of the derivatives, unit vectors, shape (np, directions).
        zero_holds: which inputs are held over the steps.

    Raises:
        ValueError: an actuator that is a user's function, or an effect without `step`.
    """

    stages: tuple[Stage, ...] = eqx.field(static=True)
    columns: Float[np.ndarray | Array, "np directions"]
    has_starts: bool = eqx.field(static=True)
    zero_holds: tuple[bool, ...] = eqx.field(static=True)
    staircases: tuple[bool, ...] = eqx.field(static=True)

    def __init__(
        self,
        plant: Plant,
        theta: np.ndarray,
        sample_period: float,
        columns: np.ndarray,
        zero_holds: tuple[bool, ...],
    ):
        rule = "must be made of delays and lags (`effects.InputDelay`, …) to run sample by sample"
        stages: list[Stage] = []
        reached: list[tuple[int, ...]] = [()] * len(plant.inputs)
        for placed in actuator_effects(plant, rule):
            effect = placed.effect
            assert isinstance(effect, AbstractActuator)
            single = "must act on one input alone to run sample by sample"
            check(placed.through is None, f"effect {effect.name}", single, "one with a driver")
            shapes = tuple(plant.names.index(name) for name in placed.names)
            upstream = reached[placed.channel]
            directions = np.flatnonzero(np.any(columns[list(shapes)], axis=0)).tolist()
            directions = (*upstream, *directions)
            moving = upstream if effect.keeps_inputs else directions
            size = effect.memory(sample_period, theta[list(shapes)])
            stages.append(Stage(effect, placed.channel, shapes, size, moving, directions))
            reached[placed.channel] = directions
        self.stages, self.columns = tuple(stages), columns
        self.has_starts, self.zero_holds = plant.has_algebraic, zero_holds
        self.staircases = keeps_steps(plant.actuator, len(plant.inputs))

    def init(self) -> DrivenState:
        """Before the first step, which sets all of it."""
        memories = tuple(
            Memory(jnp.zeros(stage.size), jnp.zeros((stage.size, len(stage.moving))))
            for stage in self.stages
        )
        if not self.stages or not self.has_starts:
            return DrivenState(memories)
        nu = len(self.zero_holds)
        last = jnp.zeros(nu), jnp.zeros((nu, self.columns.shape[1]))
        starts = None if all(self.zero_holds) else memories
        return DrivenState(memories, starts, last if any(self.zero_holds) else None)

    def step(
        self,
        state: DrivenState,
        first: Bool[Array, ""],
        u: Float[Array, " nu"],
        u_start: Float[Array, " nu"],
        theta: Float[Array, " np"],
        h: Any,
    ) -> tuple[DrivenState, StepInputs]:
        """One step, as `Plant.driven` and `Plant.driven_at_starts` along a record.

        Args:
            state: before it.
            first: whether it is the first one.
            u: means of the inputs over it.
            u_start: inputs at its start.
            theta: parameter values.
            h: sample period [s].
        """
        if not self.stages:
            return state, StepInputs(u, None, u_start if self.has_starts else None, None)
        memories, means, slopes = self._along(state.memories, first, u, theta, h)
        if not self.has_starts:
            return DrivenState(memories), StepInputs(means, slopes, None, None)
        starts, at_start = None, (means, slopes)
        if state.starts is not None:
            starts, *at_start = self._along(state.starts, first, u_start, theta, h)
        if state.last is None:
            return DrivenState(memories, starts), StepInputs(means, slopes, *at_start)
        # A held input stays held behind a delay, and is continuous behind a lag.
        stairs, constant = np.asarray(self.staircases), np.asarray(self.zero_holds)

        def started(stairs: Any, constant: Any, mean: Array, last: Array, moving: Array) -> Array:
            between = 0.5 * (jnp.where(first, mean, last) + mean)
            return jnp.where(constant, jnp.where(stairs, mean, between), moving)

        u_begin = started(stairs, constant, means, state.last[0], at_start[0])
        columns = stairs[:, None], constant[:, None]
        slope_begin = started(*columns, slopes, state.last[1], at_start[1])
        state = DrivenState(memories, starts, (means, slopes))
        return state, StepInputs(means, slopes, u_begin, slope_begin)

    def _along(
        self,
        memories: tuple[Memory, ...],
        first: Bool[Array, ""],
        u: Float[Array, " nu"],
        theta: Float[Array, " np"],
        h: Any,
    ) -> tuple[tuple[Memory, ...], Float[Array, " nu"], Float[Array, "nu directions"]]:
        """Memories after a step, the inputs behind all effects, and their derivatives."""
        columns, new = jnp.asarray(self.columns), []
        slopes = jnp.zeros((u.shape[0], columns.shape[1]))
        for stage, memory in zip(self.stages, memories, strict=True):
            j, directions = stage.channel, np.asarray(stage.directions, int)
            fixed = jnp.zeros((stage.size, len(directions) - len(stage.moving)))
            memory_slopes = jnp.concatenate([jnp.where(first, 0.0, memory.slopes), fixed], axis=1)
            values = jnp.where(first, u[j], memory.values)
            parts = values, memory_slopes, u[j], slopes[j, directions]
            shapes = np.asarray(stage.shapes, int)
            shape = theta[shapes], columns[shapes][:, directions]
            (values, mean), (memory_slopes, slope) = _stepped(stage.effect, parts, shape, h)
            new.append(Memory(values, memory_slopes[:, : len(stage.moving)]))
            u, slopes = u.at[j].set(mean), slopes.at[j, directions].set(slope)
        return tuple(new), u, slopes


def _stepped(
    effect: AbstractActuator, parts: Sequence[Array], shape: tuple[Array, Array], h: Any
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Memory and result of a step, and their derivatives along the directions.

    Args:
        effect: which.
        parts: memory and input, each followed by its derivatives.
        shape: its parameters and their derivatives.
        h: sample period [s].
    """
    memory, memory_slopes, u, slope = parts

    def step_twice(shift: Array) -> tuple[Any, Any]:
        shifted = shape[0] + shape[1] @ shift
        result = effect.step(memory + memory_slopes @ shift, u + slope @ shift, h, shifted)
        return result, result

    jacobian, result = jax.jacfwd(step_twice, has_aux=True)(jnp.zeros(shape[1].shape[1]))
    return result, jacobian
