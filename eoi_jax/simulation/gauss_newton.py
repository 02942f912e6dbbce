"""Gauss-Newton with halved steps, of one least-squares problem or of many side by side.

At a point the errors are linearised; the step is the solution of that linear least squares. Taken
is the longest of the step, a half of it, a quarter, … that lowers the cost. A problem ends where
its step promises, or brings, next to nothing.

Source: J. Nocedal, S. J. Wright, *Numerical Optimization*, 2nd ed., sections 3.1 (backtracking)
and 10.3 (Gauss-Newton).
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable


@runtime_checkable
class Point(Protocol):
    """Where a problem is: its variables, and whatever else belongs to them."""

    @property
    def cost(self) -> float:
        """What is minimised; infinite where the errors are not finite."""
        ...


P = TypeVar("P", bound=Point)


@dataclass(frozen=True)
class Descent(Generic[P]):
    """Where the problems ended.

    Attributes:
        points: the best one of each problem.
        rounds: linearisations of the problem that took the most of them.
        exhausted: numbers of the problems for which there were too few rounds.
    """

    points: list[P]
    rounds: int
    exhausted: list[int]


def gauss_newton(
    points: Sequence[P],
    linearise: Callable[[list[P]], Sequence[tuple[Any, float]]],
    evaluate: Callable[[list[P], list[Any]], Sequence[Iterable[P]]],
    smallest_fall: float,
    max_rounds: int,
) -> Descent[P]:
    """Descend from points of several problems until none gets any lower to speak of.

    Args:
        points: to start from, one of each problem.
        linearise: for each of some points the step of linear least squares, and by how much that
            predicts the cost to fall; zero where there is no step.
        evaluate: for each of some points and their steps the points at the step, at a half of it,
            and so on. Of an iterator only as many are asked for as are needed.
        smallest_fall: fall of the cost, relative to it, below which a problem ends.
        max_rounds: rounds, each of one linearisation.
    """
    best = list(points)
    active = [i for i, point in enumerate(best) if math.isfinite(point.cost)]
    rounds = 0
    while active and rounds < max_rounds:
        rounds += 1
        proposals = zip(active, linearise([best[i] for i in active]), strict=True)
        steps = {i: step for i, (step, fall) in proposals if fall > smallest_fall * best[i].cost}
        trial_steps = evaluate([best[i] for i in steps], list(steps.values())) if steps else []
        active = []
        for i, trials in zip(steps, trial_steps, strict=True):
            cost = best[i].cost
            lower = next((trial for trial in trials if trial.cost < cost), best[i])
            best[i] = lower
            if cost - lower.cost > smallest_fall * cost:
                active.append(i)
    return Descent(best, rounds, active)
