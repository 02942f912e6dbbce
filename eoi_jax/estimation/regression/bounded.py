r"""Least squares within bounds, from normal equations, by block principal pivoting.

    min ½ Δθᵀ A Δθ − bᵀΔθ   subject to   low ≤ Δθ ≤ high

The set of parameters on their bounds is changed until the others, solved for again, lie inside and
the cost would fall only beyond each active bound (Karush-Kuhn-Tucker). All violations are exchanged
at once, which usually takes two or three turns. Where that cycles, only the last violation is
exchanged, which cannot cycle except in directions without information: after `release_turns` no
parameter is released from its bound any more.

Source: L. Portugal, J. Júdice, L. Vicente, Mathematics of Computation 63 (1994) 625 (block
principal pivoting; one at a time by K. Murty).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

Rows = Float[np.ndarray, "lanes np"]
# Returns Δθ for right-hand sides, with only the parameters of the mask free.
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
    block_turns: int = 10,
    release_turns: int = 100,
) -> tuple[Rows, Int[np.ndarray, "lanes np"]]:
    """Least squares within bounds, for many lanes at once.

    Args:
        solve: least squares without bounds.
        information: A.
        rhs: b.
        increment: its solution without bounds.
        room: smallest and largest Δθ.
        block_turns: turns in which all violations are exchanged at once; two or three are usual.
        release_turns: turns in which bounds may be released, so that it ends.

    Returns:
        Δθ, and on which bound each parameter lies: -1 the lower, 1 the upper, 0 none.
    """
    low, high = room
    side, turn = np.zeros(increment.shape, int), 0
    while True:
        with np.errstate(invalid="ignore"):  # a lane that is not finite
            slope = rhs - np.einsum("lab,lb->la", information, increment)
        inward = (side * slope < 0.0) & (turn < release_turns)
        leaves = (side == 0) & ((increment < low) | (increment > high))
        if not np.any(inward | leaves):
            return increment, side
        if turn >= block_turns:
            last = np.cumsum((inward | leaves)[:, ::-1], axis=1)[:, ::-1] == 1
            inward, leaves = inward & last, leaves & last
        side = np.where(leaves, np.where(increment > high, 1, -1), np.where(inward, 0, side))
        moved = np.where(side > 0, high, np.where(side < 0, low, 0.0))
        with np.errstate(invalid="ignore"):
            remainder = rhs - np.einsum("lab,lb->la", information, moved)
        increment, turn = moved + solve(remainder, side == 0), turn + 1
