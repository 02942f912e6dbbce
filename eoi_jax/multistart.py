"""Several starts of a refinement: where they are drawn, and which of them leads furthest."""

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
        return _drawn(plant, int(starts))
    check(np.iterable(starts) and not isinstance(starts, str), "starts", _RULE, starts)
    points = starting_points(plant, starts)
    for i, name in enumerate(plant.names):
        outside = (points[:, i] < plant.lower[i]) | (points[:, i] > plant.upper[i])
        rule = f"must keep {name} in its bounds [{plant.lower[i]:g}, {plant.upper[i]:g}]"
        check(not outside.any(), "starts", rule, points[outside, i][:1])
    return points


def _drawn(plant: Plant, count: int) -> Float[np.ndarray, "points np"]:
    """Points around a plant's values by ratio and by sign, in which guesses are mostly wrong.

    What is zero stays zero, and what is fixed stays.
    """
    theta, draw = np.asarray(plant.theta, dtype=float), np.random.default_rng(_SEED)
    ratio = np.exp(draw.uniform(-np.log(_REACH), np.log(_REACH), (count, len(theta))))
    ratio *= draw.choice([-1.0, 1.0], ratio.shape)
    points = theta * ratio
    for inside in (-ratio, 1.0 / ratio, -1.0 / ratio):
        outside = (points < plant.lower) | (points > plant.upper)
        points = np.where(outside, theta * inside, points)
    points = np.clip(points, plant.lower, plant.upper)
    return np.where(np.asarray(plant.free), points, theta)


def best(problem: Problem, unknowns: Unknowns, points: np.ndarray) -> list[Unknowns]:
    """Where the best of several points leads, as in a tournament; none where all diverge.

    Args:
        problem: the runs.
        unknowns: of which the initial states are where all points begin.
        points: parameters, shape (points, np).
    """
    # Imported here: optimistix is heavy, and only a fit needs it.
    from eoi_jax.levenberg_marquardt import solve_many

    if not len(points):
        return []
    theta = points[:, list(problem.free)]
    starts = jnp.broadcast_to(unknowns.starts, (len(theta), *unknowns.starts.shape))
    several = Unknowns(jnp.asarray(theta), starts)
    for steps in _TOURNAMENT:
        found = solve_many(problem, several, steps)
        cost = np.where(np.isfinite(found.cost), np.asarray(found.cost), np.inf)
        kept = np.argsort(cost, kind="stable")[: -(-len(cost) // _SHARE)]
        several = jax.tree.map(lambda leaf, kept=kept: leaf[kept], found.unknowns)
    return [jax.tree.map(lambda leaf: leaf[0], several)] if np.isfinite(np.min(cost)) else []
