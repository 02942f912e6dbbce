"""Effects at one instant, as functions that are evaluated along a record (`compiler/pointwise.py`).

A row is a tree of the signals at an instant; equal effects compute the same, and share a program.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import AbstractInputEffect, AbstractTerm, At


@dataclass(frozen=True)
class UnitTerms:
    """What a term adds to y^(r), in its unit, for a unit of each of its gains: shape (gains,).

    The row has the signals t, y, v, u of `At`, then state and inputs of the plant.
    """

    effect: AbstractTerm

    def __call__(self, row: tuple[Any, ...], shape: Any, z: Any) -> Any:
        (t, y, v, u), (state, inputs) = row
        at = At(t, y, v, u, z, state=state, inputs=inputs)
        units = np.eye(len(self.effect.gains)).tolist()
        return jnp.stack([jnp.asarray(self.effect.term(at, unit, shape)) for unit in units])


@dataclass(frozen=True)
class ChangedInput:
    """The input that the model receives, in the unit of the input; the row has t, y, v, u."""

    effect: AbstractInputEffect

    def __call__(self, row: tuple[Any, ...], shape: Any, z: Any) -> Any:
        t, y, v, u = row
        return self.effect.changed(At(t, y, v, u, z), shape)
