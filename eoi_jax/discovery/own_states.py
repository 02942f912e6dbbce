"""States that an effect has of its own, along the signals of a record.

Compiled for a vector of shapes at once where that can be, and else followed by `lax.scan`.
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

_LANES = 16  # shapes in one vector: one program whatever the grid
_CHUNK = 4096  # steps at a time

Signals = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # time, output, velocity, input


class _Own(eqx.Module):
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
        effect: with or without states.
        shapes: its shape parameters, (grid, shapes).
        signals: in the middle of each step, each (S,).
        change: of each signal over the step.
        h: step [s].
    """
    steps = len(signals[0])
    if not effect.states:
        return np.zeros((len(shapes), steps, 0))
    dtype = np.dtype(jnp.result_type(float))
    scalars = tuple(np.zeros(()) for _ in signals)
    own, lane, step = shapes_of((_Own(effect), shapes[0], _Row(scalars, scalars)), dtype)
    try:
        code = compiled_loop(_States(own, lane, step, dtype), 2 * len(signals), _LANES, True)
    except Untranslatable:
        return np.asarray(_by_xla(effect, shapes, signals, change, np.asarray(h)))
    rows = np.stack([*signals, *change], axis=1).astype(dtype)
    out = np.empty((len(shapes), steps, effect.states), dtype)
    for first in range(0, len(shapes), _LANES):
        lanes = shapes[first : first + _LANES]
        begun, at = code.begin(np.asarray(lanes.T, dtype), np.asarray([h], dtype)), 0
        for shown in begun.outputs(rows, _CHUNK):
            for i, place in enumerate(code.outputs):
                part = shown[:, place][:, : len(lanes)]
                out[first : first + len(lanes), at : at + len(shown), i] = part.T
            at += len(shown)
    return out


@dataclass(frozen=True, eq=False)
class _States(AbstractLoop):
    """What is traced: a lane is a shape."""

    own: _Own
    lane: Any
    step: _Row
    dtype: np.dtype

    @property
    def row(self) -> _Row:
        """What a step reads of the record."""
        return self.step

    @property
    def fixed(self) -> Any:
        """The length of a step."""
        return jax.ShapeDtypeStruct((), self.dtype)

    def begin(self, lane: Any, fixed: Any) -> Any:
        """Zero."""
        del lane, fixed
        return jnp.zeros(self.own.effect.states, self.dtype)

    def advance(self, lane: Any, fixed: Any, carry: Any, row: _Row) -> tuple[Any, Any]:
        """The states after a step; those in its middle are shown."""
        signals = row.middle, row.change
        return moved_through(lambda z, now: self.own.rate(z, now, lane), carry, signals, fixed)

    def result(self, carry: Any) -> Any:
        """Nothing: all of it is shown."""
        del carry
        return ()


@jit
def _by_xla(
    effect: AbstractEffect, shapes: Any, signals: tuple, change: tuple, h: Any
) -> Float[Array, "grid S states"]:
    own = _Own(effect)

    def along(shape: Array) -> Array:
        start = jnp.zeros(effect.states, shape.dtype)
        return integrated(lambda z, row: own.rate(z, row, shape), start, signals, change, h)

    return jax.vmap(along)(jnp.asarray(shapes))
