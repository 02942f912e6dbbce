r"""Least squares within bounds, from normal equations: what would leave its bounds lies on them.

    min ½ Δθᵀ A Δθ − bᵀΔθ   subject to   low ≤ Δθ ≤ high

Sets of parameters on their bounds are exchanged until the rest, solved anew, lies inside, and the
cost would fall only beyond each bound that holds one (Karush-Kuhn-Tucker). All that is wrong is
exchanged at once, which takes two or three turns as a rule. Where that cycles, only the last one
is, which cannot; but for directions that left no trace: in the end nothing is let go any more.

Source: L. Portugal, J. Júdice, L. Vicente, Mathematics of Computation 63 (1994) 625 (block
principal pivoting; one at a time by K. Murty).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

_BLOCK_TURNS, _RELEASE_TURNS = (
    10,
    100,
)  # with all exchanged at once; in which what is on a bound may leave it

Rows = Float[np.ndarray, "lanes np"]
# Δθ of right-hand sides, with only the parameters of the mask free.
Solve = Callable[[Rows, Bool[np.ndarray, "lanes np"]], Rows]


def leaves_bounds(increment: Rows, room: tuple[Rows, Rows]) -> bool:
    """Whether some Δθ leaves its room, down and up."""
    return bool(np.any((increment < room[0]) | (increment > room[1])))


def bounded(
    solve: Solve,
    information: Float[np.ndarray, "lanes np np"],
    rhs: Rows,
    increment: Rows,
    room: tuple[Rows, Rows],
) -> tuple[Rows, Int[np.ndarray, "lanes np"]]:
    """Least squares within bounds, for many lanes at once.

    Args:
        solve: least squares without bounds.
        information: A.
        rhs: b.
        increment: its solution without bounds.
        room: smallest and largest Δθ.

    Returns:
        Δθ, and on which bound each parameter lies: -1 the lower, 1 the upper, 0 none.
    """
    low, high = room
    side, turn = np.zeros(increment.shape, int), 0
    while True:
        with np.errstate(invalid="ignore"):  # a lane without an answer
            slope = rhs - np.einsum("lab,lb->la", information, increment)
        inward = (side * slope < 0.0) & (turn < _RELEASE_TURNS)
        leaves = (side == 0) & ((increment < low) | (increment > high))
        if not np.any(inward | leaves):
            return increment, side
        if turn >= _BLOCK_TURNS:
            last = np.cumsum((inward | leaves)[:, ::-1], axis=1)[:, ::-1] == 1
            inward, leaves = inward & last, leaves & last
        side = np.where(leaves, np.where(increment > high, 1, -1), np.where(inward, 0, side))
        moved = np.where(side > 0, high, np.where(side < 0, low, 0.0))
        with np.errstate(invalid="ignore"):
            remainder = rhs - np.einsum("lab,lb->la", information, moved)
        increment, turn = moved + solve(remainder, side == 0), turn + 1
