"""How internal states start in free runs, where a plant or its effects say so.

A start that the plant declares as free is estimated, of each run by itself. A state of an effect
with the weight one starts anywhere in every run, the next ones by their weights in proportion to
it. Any other state starts as the plant declares where a run begins with its record, else anywhere.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True)
class PartlyFree:
    """Internal states at the start of a record, some of them free.

    Attributes:
        values: of all; of a free one, where its search begins.
        free: which are estimated, of each record by itself.
    """

    values: tuple[float, ...]
    free: tuple[bool, ...]

    def __call__(self, p: Any) -> Any:
        """Internal states, shape (nz,)."""
        return jnp.asarray(self.values, jnp.result_type(*p))


def free_starts(initial: Any, count: int) -> Bool[np.ndarray, " nz"]:
    """Which internal states the plant declares as free at the start of a record.

    Args:
        initial: `Plant.internal_initial`.
        count: of all internal states; those of effects, the last ones, are not declared.
    """
    while hasattr(initial, "base"):  # with effects
        initial = initial.base
    declared = getattr(initial, "free", ())
    return np.asarray([*declared, *[False] * (count - len(declared))], dtype=bool)


def start_weights(initial: Any) -> tuple[float | None, ...]:
    """Weights of the last internal states; those before them have none.

    Args:
        initial: `Plant.internal_initial`.
    """
    return getattr(initial, "weights", ())


def starts_anywhere(initial: Any, count: int) -> Bool[np.ndarray, " nz"]:
    """Which internal states never start as the plant declares.

    Args:
        initial: `Plant.internal_initial`.
        count: of all internal states.
    """
    weights = start_weights(initial)
    places = free_starts(initial, count)
    places[count - len(weights) :] |= np.asarray([weight is not None for weight in weights], bool)
    return places


def open_starts(initial: Any, count: int, sampled: int) -> Bool[np.ndarray, " nz"]:
    """Which internal states may start at any value where a run begins within a record.

    Args:
        initial: `Plant.internal_initial`.
        count: of all internal states.
        sampled: so many, the last ones, change at samples only.
    """
    free = np.ones(count, dtype=bool)
    free[proportional_starts(initial, count)[0]] = False
    free[count - sampled :] = False
    return free


def proportional_starts(
    initial: Any, count: int
) -> tuple[Int[np.ndarray, " some"], Int[np.ndarray, " some"], Float[np.ndarray, " some"]]:
    """Internal states that start in proportion to another: places, those of the other, weights.

    Args:
        initial: `Plant.internal_initial`.
        count: of all internal states.
    """
    weights = start_weights(initial)
    rows, leader = [], 0
    for place, weight in enumerate(weights, count - len(weights)):
        if weight == 1.0:
            leader = place
        elif weight is not None:
            rows.append((place, leader, weight))
    places, leaders, shares = np.reshape(rows, (-1, 3)).T
    return places.astype(int), leaders.astype(int), shares
