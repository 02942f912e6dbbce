"""Several starts of a refinement: where they are drawn, and which of them leads furthest.

One round draws all points anew. Further rounds keep what was found: each point is the best one so
far with some of its parameters drawn anew and the others moved a little, over several scales. So
parts of a model are found one after the other, and an optimum is left that is one of few samples
only. Stochastic local search: H. Hoos, T. Stützle, *Stochastic Local Search* (2004), chapter 2
(iterated local search).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.checks import check
from eoi_jax.output_error import Problem, Unknowns
from eoi_jax.plants.plant import Plant
from eoi_jax.prepare import starting_points

_REACH, _SEED = 8.0, 0  # ratio of drawn points to the plant's values, at most; of these points
_TOURNAMENT = (8, 8)  # steps of the solver for all points, and for those that are left
_SHARE = 8  # one of so many is kept
# Of further rounds: shares of the parameters that are drawn anew; spread of the logarithm of the
# others, at random between; ratio to the plant's values from which on one has run away.
_ANEW, _SPREAD, _LOST = (0.1, 0.25, 0.5), (0.02, 1.0), 1e3
_RULE = "must be points (dicts of parameters, or rows), or how many are drawn: at least 1"


def points_of(plant: Plant, starts: Any) -> Float[np.ndarray, "points np"]:
    """Further points to start from, none of them outside the bounds.

    Args:
        plant: what they are for.
        starts: how many are drawn around the plant's values; or dicts of parameters, or rows
            (points, np); or None.

    Raises:
        ValueError: none, an unknown name, a value that is not finite or out of its bounds.
    """
    if starts is None:
        return np.zeros((0, len(plant.names)))
    if isinstance(starts, int | np.integer):
        check(starts >= 1, "starts", _RULE, starts)
        return _drawn(plant, int(starts), np.random.default_rng(_SEED))
    check(np.iterable(starts) and not isinstance(starts, str), "starts", _RULE, starts)
    points = starting_points(plant, starts)
    for i, name in enumerate(plant.names):
        outside = (points[:, i] < plant.lower[i]) | (points[:, i] > plant.upper[i])
        rule = f"must keep {name} in its bounds [{plant.lower[i]:g}, {plant.upper[i]:g}]"
        check(not outside.any(), "starts", rule, points[outside, i][:1])
    return points


def _drawn(plant: Plant, count: int, draw: np.random.Generator) -> Float[np.ndarray, "points np"]:
    """Points around a plant's values by ratio and by sign, in which guesses are mostly wrong.

    What is zero stays zero, and what is fixed stays.
    """
    theta = np.asarray(plant.theta, dtype=float)
    ratio = np.exp(draw.uniform(-np.log(_REACH), np.log(_REACH), (count, len(theta))))
    ratio *= draw.choice([-1.0, 1.0], ratio.shape)
    points = theta * ratio
    for inside in (-ratio, 1.0 / ratio, -1.0 / ratio):
        outside = (points < plant.lower) | (points > plant.upper)
        points = np.where(outside, theta * inside, points)
    points = np.clip(points, plant.lower, plant.upper)
    return np.where(np.asarray(plant.free), points, theta)


def _varied(
    plant: Plant, best: Float[np.ndarray, " np"], count: int, draw: np.random.Generator
) -> Float[np.ndarray, "points np"]:
    """Points around the best one so far, for a further round; what began at zero is moved only."""
    anew, nominal = _drawn(plant, count, draw), np.abs(np.asarray(plant.theta))
    low, high = np.log(_SPREAD)
    spread = np.exp(draw.uniform(low, high, (count, 1))) * draw.choice([0, 1], (count, 1))
    points = best * np.exp(spread * draw.standard_normal(anew.shape))
    chosen = draw.uniform(size=anew.shape) < draw.choice(_ANEW, (count, 1))
    lost = np.abs(best) > _LOST * nominal
    points = np.where((chosen | lost) & (nominal > 0), anew, points)
    return np.where(np.asarray(plant.free), np.clip(points, plant.lower, plant.upper), best)


def best(
    problem: Problem, unknowns: Unknowns, points: np.ndarray, rounds: int = 1
) -> list[Unknowns]:
    """Where the best of several points leads; none where all diverge.

    Args:
        problem: the runs; further points are drawn around the values of its plant.
        unknowns: of which the initial states are where all points begin. From the second round on
            its parameters count too.
        points: parameters, shape (points, np).
        rounds: how often so many points are followed.
    """
    if not len(points):
        return []
    plant, free = problem.kernel.plant, list(problem.free)
    draw = np.random.default_rng(_SEED + 1)
    found = unknowns, np.inf  # stays the best one where all diverge

    def better(found: Any, theta: np.ndarray, starts: Any) -> tuple[Unknowns, float]:
        return min(found, _tournament(problem, theta, starts), key=lambda one: one[1])

    found = better(found, points[:, free], unknowns.starts)
    if rounds > 1:
        found = better(found, np.asarray(unknowns.theta)[None], unknowns.starts)
    for _ in range(rounds - 1):
        theta = np.array(plant.theta, dtype=float)
        theta[free] = np.asarray(found[0].theta)
        varied = _varied(plant, theta, len(points), draw)
        found = better(found, varied[:, free], found[0].starts)
    return [found[0]] if np.isfinite(found[1]) else []


def _tournament(
    problem: Problem, theta: Float[np.ndarray, "points free"], own: Any
) -> tuple[Unknowns, float]:
    """All points followed a few steps, the better ones some more: the best, and its cost.

    Args:
        problem: the runs.
        theta: the points.
        own: initial states at which all begin.
    """
    # Imported here: optimistix is heavy, and only a fit needs it.
    from eoi_jax.levenberg_marquardt import solve_many

    starts = jnp.broadcast_to(own, (len(theta), *own.shape))
    several, cost = Unknowns(jnp.asarray(theta), starts), np.full(len(theta), np.inf)
    for steps in _TOURNAMENT:
        found = solve_many(problem, several, steps)
        cost = np.where(np.isfinite(found.cost), np.asarray(found.cost), np.inf)
        kept = np.argsort(cost, kind="stable")[: -(-len(cost) // _SHARE)]
        several = jax.tree.map(lambda leaf, kept=kept: leaf[kept], found.unknowns)
    return jax.tree.map(lambda leaf: leaf[0], several), float(np.min(cost))
