"""Several starts of a refinement: where they are drawn, and which of them leads furthest.

One round draws all points anew. Further rounds keep what was found: each point is the best one so
far with some of its parameters drawn anew and the others moved a little, over several scales. So
parts of a model are found one after the other, and an optimum is left that is one of few samples
only. Where that stands still the search begins anew, for a wrong part may hold all others; the last
rounds are again those of the best one of all. Stochastic local search: H. Hoos, T. Stützle,
*Stochastic Local Search* (2004), chapters 2 (iterated local search) and 4 (restarts).
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax.estimation.preparation import starting_points
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.levenberg_marquardt import solve_many
from eoi_jax.refinement.problem import Problem, Unknowns


@dataclass(frozen=True)
class MultistartSettings:
    """Numbers of the search from several points."""

    seed: int = 0  # of the points of the first round; that of further rounds is one more
    max_ratio: float = 8.0  # of drawn parameters to the plant's values
    # Steps of the solver for all points of a round, then for those that are left.
    single_stages: tuple[int, ...] = (8, 8)  # of a single round
    stages: tuple[int, ...] = (16, 8, 24)  # where further rounds begin at the best point
    reduction: int = 8  # factor by which each stage lowers the number of points
    # Further rounds: parameters are drawn anew, or moved, at random between the limits.
    redrawn_shares: tuple[float, ...] = (0.1, 0.25, 0.5)  # of the parameters, one of these
    spread: tuple[float, float] = (0.02, 1.0)  # of the logarithm of the others
    valley_steps: tuple[float, float] = (0.3, 30.0)  # where runs hardly tell [standard errors]
    min_singular: float = 1e-9  # value over the largest, at which such steps are no longer
    max_drift: float = 1e3  # ratio to the plant's values beyond which a parameter has run away
    min_reduction: float = 0.01  # of the cost in a round, as a share of it; less is a standstill
    patience: int = 5  # rounds of standstill in a row, after which the search begins anew
    final_share: float = 0.2  # of the rounds, at the end, that are those of the best point of all


_SETTINGS = MultistartSettings()
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
        return _drawn(plant, int(starts), np.random.default_rng(_SETTINGS.seed))
    check(np.iterable(starts) and not isinstance(starts, str), "starts", _RULE, starts)
    points = starting_points(plant, starts)
    for i, name in enumerate(plant.names):
        out_of_bounds = (points[:, i] < plant.lower[i]) | (points[:, i] > plant.upper[i])
        rule = f"must keep {name} in its bounds [{plant.lower[i]:g}, {plant.upper[i]:g}]"
        check(not out_of_bounds.any(), "starts", rule, points[out_of_bounds, i][:1])
    return points


def _drawn(
    plant: Plant, count: int, draw: np.random.Generator, reach: float = _SETTINGS.max_ratio
) -> Float[np.ndarray, "points np"]:
    """Points around a plant's values by ratio and by sign, in which guesses are mostly wrong.

    What is zero stays zero, and what is fixed stays.
    """
    theta = np.asarray(plant.theta, dtype=float)
    ratio = _scales(draw, (1.0 / reach, reach), (count, len(theta)))
    ratio *= draw.choice([-1.0, 1.0], ratio.shape)
    points = theta * ratio
    for factor in (-ratio, 1.0 / ratio, -1.0 / ratio):
        out_of_bounds = (points < plant.lower) | (points > plant.upper)
        points = np.where(out_of_bounds, theta * factor, points)
    points = np.clip(points, plant.lower, plant.upper)
    return np.where(np.asarray(plant.free), points, theta)


def _scales(
    draw: np.random.Generator, limits: tuple[float, float], shape: tuple[int, int]
) -> Float[np.ndarray, "points each"]:
    """As likely in each octave between the limits."""
    return np.exp(draw.uniform(np.log(limits[0]), np.log(limits[1]), shape))


def _varied(
    plant: Plant,
    best: Float[np.ndarray, " np"],
    standard_steps: Float[np.ndarray, "np np"],
    count: int,
    draw: np.random.Generator,
) -> Float[np.ndarray, "points np"]:
    """Points around the best one so far, for a further round; what began at zero is moved only.

    Args:
        plant: with the values that parameters are drawn around.
        best: the best ones so far.
        standard_steps: of `_standard_steps`.
        count: points.
        draw: of chance.
    """
    drawn, nominal = _drawn(plant, count, draw), np.abs(np.asarray(plant.theta))
    kinds = draw.choice(["stay", "separate", "valley"], (count, 1))
    limits = _SETTINGS.spread, _SETTINGS.valley_steps
    spread, far = (_scales(draw, pair, (count, 1)) for pair in limits)
    normal = draw.standard_normal(drawn.shape)
    points = best * np.exp(np.where(kinds == "separate", spread, 0.0) * normal)
    with np.errstate(over="ignore", invalid="ignore"):
        points += np.where(kinds == "valley", far, 0.0) * (normal @ standard_steps.T)
    chance = draw.uniform(size=drawn.shape)
    chosen = chance < draw.choice(_SETTINGS.redrawn_shares, (count, 1))
    lost = np.abs(best) > _SETTINGS.max_drift * nominal
    run_away = lost | ~np.isfinite(points)
    points = np.where((chosen | run_away) & (nominal > 0), drawn, points)
    stays = (np.asarray(plant.free) == 0) | ~np.isfinite(points)
    return np.where(stays, best, np.clip(points, plant.lower, plant.upper))


def _standard_steps(problem: Problem, unknowns: Unknowns) -> Float[np.ndarray, "free free"]:
    """Columns of steps of θ, one standard error each, that the initial states follow.

    The errors grow alike along all of them: they are long where the runs hardly tell parameters
    apart, so that an optimum lies far along a valley; but no longer than what doubles a parameter.
    Zeros where a run diverges, or no parameter leaves a trace.
    """
    sensitivities, theta = signals(unknowns, problem), np.asarray(unknowns.theta)
    start_size, error = sensitivities.shape[-1] - 1 - len(theta), sensitivities[..., -1]
    with np.errstate(over="ignore"):
        sigma = np.sqrt(np.sum(error**2) / np.sum(problem.use))
    nowhere = np.zeros((len(theta), len(theta)))
    if not np.all(np.isfinite(sensitivities)) or not np.isfinite(sigma):
        return nowhere
    # What the columns of a run's initial state leave of the others: the corner of its triangle.
    roots = [
        np.linalg.qr(run.reshape(-1, run.shape[-1])).R[start_size:, start_size:-1]
        for run in sensitivities
    ]
    rows = np.concatenate(roots)
    lengths = np.linalg.norm(rows, axis=0)
    if not np.any(lengths > 0.0):
        return nowhere
    lengths = np.where(lengths > 0.0, lengths, np.inf)  # what leaves no trace stays
    _, values, across = np.linalg.svd(rows / lengths, full_matrices=False)
    values = np.maximum(values, _SETTINGS.min_singular * values[0])
    steps = sigma * (across.T / values) / lengths[:, None]
    size = np.where(theta == 0.0, np.inf, np.abs(theta))
    return steps / np.maximum(np.max(np.abs(steps) / size[:, None], axis=0), 1.0)


class _Candidate(NamedTuple):
    """Where a search has come to, and the cost there."""

    unknowns: Unknowns
    cost: float


def best(
    problem: Problem, rough: Problem, unknowns: Unknowns, points: np.ndarray, rounds: int = 1
) -> list[Unknowns]:
    """Where the best of several points leads; none where all diverge.

    Args:
        problem: the runs; further points are drawn around the values of its plant.
        rough: the same in longer steps, or itself: where all points take their first steps.
        unknowns: of which the initial states are where all points begin. With further rounds its
            parameters are a point too.
        points: parameters, shape (points, np).
        rounds: how often so many points are followed.
    """
    if not len(points):
        return []
    plant, free = problem.kernel.plant, list(problem.free)
    draw = np.random.default_rng(_SETTINGS.seed + 1)
    stages = _SETTINGS.single_stages if rounds == 1 else _SETTINGS.stages

    def followed(theta: np.ndarray, starts: Any) -> _Candidate:
        diverged = _Candidate(unknowns, np.inf)  # stays the best one where all diverge
        return _better(diverged, _tournament(problem, rough, theta, starts, stages))

    current = followed(points[:, free], unknowns.starts)
    if rounds > 1:
        current = _better(current, followed(np.asarray(unknowns.theta)[None], unknowns.starts))
    champion, stalled, attempts = current, 0, 1
    last = int(rounds * _SETTINGS.final_share)
    for remaining in range(rounds - 1, 0, -1):
        if remaining == last:
            current = champion
        if stalled >= _SETTINGS.patience and remaining > last:
            # In turn near the plant's values and far from them.
            reach = _SETTINGS.max_ratio ** (1 + attempts % 2)
            theta = _drawn(plant, len(points), draw, reach)
            current, stalled, attempts = followed(theta[:, free], unknowns.starts), 0, attempts + 1
        else:
            theta = problem.completed(current.unknowns.theta)
            standard_steps = np.zeros((len(theta), len(theta)))
            standard_steps[np.ix_(free, free)] = _standard_steps(problem, current.unknowns)
            varied = _varied(plant, theta, standard_steps, len(points), draw)
            candidate = followed(varied[:, free], current.unknowns.starts)
            target = (1.0 - _SETTINGS.min_reduction) * current.cost
            stalled = 0 if candidate.cost < target else stalled + 1
            current = _better(current, candidate)
        champion = _better(champion, current)
    return [champion.unknowns] if np.isfinite(champion.cost) else []


def _better(first: _Candidate, second: _Candidate) -> _Candidate:
    return min(first, second, key=lambda candidate: candidate.cost)


def _tournament(
    problem: Problem,
    rough: Problem,
    theta: Float[np.ndarray, "points free"],
    initial: Any,
    stages: tuple[int, ...],
) -> _Candidate:
    """All points followed a few steps, the better ones some more: the best.

    Args:
        problem: the runs.
        rough: of the first stage.
        theta: the points.
        initial: initial states at which all begin.
        stages: steps of the solver, after each of which all but one of `reduction` are dropped.
    """
    starts = np.broadcast_to(np.asarray(initial), (len(theta), *initial.shape))
    points, cost = Unknowns(np.asarray(theta), starts), np.full(len(theta), np.inf)
    for stage, steps in enumerate(stages):
        outcome = solve_many(problem if stage else rough, points, steps)
        cost = np.where(np.isfinite(outcome.cost), np.asarray(outcome.cost), np.inf)
        survivors = np.argsort(cost, kind="stable")[: -(-len(cost) // _SETTINGS.reduction)]
        points = jax.tree.map(
            lambda leaf, survivors=survivors: np.asarray(leaf)[survivors], outcome.unknowns
        )
    return _Candidate(jax.tree.map(lambda leaf: leaf[0], points), float(np.min(cost)))
