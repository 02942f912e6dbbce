"""Internal states of an effect, simulated along the signals of a record.

The loop is compiled for a vector of shapes if the effect can be translated; otherwise it is a
`lax.scan`.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import AbstractLoop, shapes_of
from eoi_jax.compiler.programs import jit
from eoi_jax.compiler.runtime import compiled_loop
from eoi_jax.discovery.cosine_modes import integrated, moved_through
from eoi_jax.models.effects.effect import AbstractEffect, At, Grid

_LANES = 16  # shapes in one vector: one program for grids of any size
_CHUNK = 4096  # steps per chunk

Signals = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # time, output, velocity, input


class _EffectStates(eqx.Module):
    """An effect, by its value."""

    effect: AbstractEffect = eqx.field(static=True)

    def rate(self, z: Any, row: Any, shape: Any) -> Any:
        """dz/dt."""
        t, y, v, u = row
        return jnp.reshape(self.effect.rate(At(t, y, v, u, z), shape), (self.effect.states,))


class _Row(eqx.Module):
    """Signals in the middle of a step, and their change over it."""

    middle: Any
    change: Any


def states_along(
    effect: AbstractEffect, shapes: Grid, signals: Signals, change: Signals, h: float
) -> Float[np.ndarray, "grid S states"]:
    """The states in the middle of each step, from zero at the start of the record.

    Args:
        effect: an effect with or without states.
        shapes: values of its shape parameters, (grid, shapes).
        signals: in the middle of each step, each (S,).
        change: of each signal over the step.
        h: length of a step [s].
    """
    steps = len(signals[0])
    if not effect.states:
        return np.zeros((len(shapes), steps, 0))
    dtype = np.dtype(jnp.result_type(float))
    scalars = tuple(np.zeros(()) for _ in signals)
    equation, lane, step = shapes_of(
        (_EffectStates(effect), shapes[0], _Row(scalars, scalars)), dtype
    )
    try:
        code = compiled_loop(
            _StateLoop(equation, lane, step, dtype), 2 * len(signals), _LANES, True
        )
    except Untranslatable:
        return np.asarray(_by_xla(effect, shapes, signals, change, np.asarray(h)))
    rows = np.stack([*signals, *change], axis=1).astype(dtype)
    trajectories = np.empty((len(shapes), steps, effect.states), dtype)
    for first in range(0, len(shapes), _LANES):
        lanes = shapes[first : first + _LANES]
        simulation, begin = code.begin(np.asarray(lanes.T, dtype), np.asarray([h], dtype)), 0
        for chunk in simulation.outputs(rows, _CHUNK):
            for i, place in enumerate(code.outputs):
                part = chunk[:, place][:, : len(lanes)]
                trajectories[first : first + len(lanes), begin : begin + len(chunk), i] = part.T
            begin += len(chunk)
    return trajectories


@dataclass(frozen=True, eq=False)
class _StateLoop(AbstractLoop):
    """The loop to be compiled; each lane has one shape."""

    equation: _EffectStates
    lane: Any
    step: _Row
    dtype: np.dtype

    @property
    def fixed(self) -> Any:
        """The length of a step."""
        return jax.ShapeDtypeStruct((), self.dtype)

    def begin(self, lane: Any, fixed: Any) -> Any:
        """Zero."""
        del lane, fixed
        return jnp.zeros(self.equation.effect.states, self.dtype)

    def advance(self, lane: Any, fixed: Any, carry: Any, row: _Row) -> tuple[Any, Any]:
        """The states at the end of a step, and those in its middle as output."""
        signals = row.middle, row.change
        return moved_through(
            lambda z, instant: self.equation.rate(z, instant, lane), carry, signals, fixed
        )

    def result(self, carry: Any) -> Any:
        """Nothing: the states are outputs of the steps."""
        del carry
        return ()


@jit
def _by_xla(
    effect: AbstractEffect, shapes: Any, signals: tuple, change: tuple, h: Any
) -> Float[Array, "grid S states"]:
    equation = _EffectStates(effect)

    def simulate(shape: Array) -> Array:
        start = jnp.zeros(effect.states, shape.dtype)
        return integrated(lambda z, row: equation.rate(z, row, shape), start, signals, change, h)

    return jax.vmap(simulate)(jnp.asarray(shapes))
