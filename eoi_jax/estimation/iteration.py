r"""The iteration of section 4 of the paper, for many lanes at once.

A lane is one estimate. Iteration i

1. runs the observer with θ_i and recovers the equivalent injection u_eq (one pass, `kernel.py`);
2. computes the index P_i, eq. (14);
3. solves the least squares (11) for Δθ_i;
4. updates θ_{i+1} = θ_i + Δθ_i.

The estimate is the θ_k with the smallest index, θ_0 + Σ_{j<k} Δθ_j; P need not converge. Lanes are
independent: one that ends or diverges does not affect the others.

Outputs are weighted by 1/P_j, the inverse of their index: the maximum-likelihood weights when each
output has independent noise, whatever the units. The smallest index is then that of Σ_j log P_j.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.estimation.kernel import Steps, Sums
from eoi_jax.estimation.regression.bounded import bounded, leaves_bounds
from eoi_jax.estimation.regression.index import index as index_of
from eoi_jax.estimation.regression.least_squares import Solution, least_squares
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import coordinates, scaled_step, step_room, step_scales

FEWEST_BLOCKS = 3  # of scores, that give a covariance

Thetas = Float[np.ndarray, "lanes np"]
Watch = Callable[[int, np.ndarray, np.ndarray], None]
Run = Callable[[Int[np.ndarray, " running"], Float[np.ndarray, "running np"], int], Sums]


@dataclass(frozen=True)
class IterationSettings:
    """When the iteration ends, and how a model that is not affine in θ is damped (Levenberg)."""

    min_progress: float = 1e-2  # decrease of Σ log P; share of P that Δθ is predicted to explain
    patience: int = 2  # iterations in a row without progress that end the run
    damped_patience: int = 5  # the same while steps are damped
    initial_damping: float = 0.1  # of columns scaled to one, after an iteration that overshot
    min_damping: float = 3e-3  # below it the full step is tried: it often overshoots again
    damping_factor: float = 10.0  # by which damping grows when a step overshoots, and falls else
    rounding: float = 1e-10  # effect of an increment that is none, over the observed derivative
    index_floor: float = 1e-24  # P over the mean square of y^(r), below which it is rounding
    bound_rounding: float = 64.0  # distance to a bound of a parameter on it, in rounding errors


_SETTINGS = IterationSettings()


class Iteration(eqx.Module):
    """One iteration of every lane.

    Attributes:
        theta: θ of its pass, shape (lanes, np).
        sums: of its pass.
        index: P, eq. (14), shape (lanes, ny).
        weights: of the outputs, shape (lanes, ny).
        solution: of (11); its inverse is that of the parameters that are not on a bound.
        increment: Δθ within the bounds, shape (lanes, np).
        bound: which parameters are on a bound beyond which the index would fall, (lanes, np).
    """

    theta: Thetas
    sums: Sums
    index: Float[np.ndarray, "lanes ny"]
    weights: Float[np.ndarray, "lanes ny"]
    solution: Solution
    increment: Thetas
    bound: Bool[np.ndarray, "lanes np"]

    @property
    def cost(self) -> Float[np.ndarray, " lanes"]:
        """Σ_j log P_j over the scored outputs; the best iteration has the smallest.

        Infinite where the information matrix is not finite, as on a bound where f has no slope.
        """
        scored = self.sums.count != 0  # NaN too: a lane that diverged is no perfect fit
        power = np.where(scored, self.index, 1.0)
        finite = np.all(np.isfinite(power), axis=1)
        finite &= np.all(np.isfinite(self.sums.information), axis=(1, 2, 3))
        safe = np.where(np.isfinite(power), power, 1.0)
        logs = np.log(np.maximum(safe, np.finfo(float).tiny))
        return np.where(finite, np.sum(logs, axis=1), np.inf)

    @property
    def predicted_reduction(self) -> Float[np.ndarray, " lanes"]:
        """Share of the index that least squares explains if φ does not change.

        Of the full step of (11) within the bounds, Δθᵀ Σφᵀu_eq / Σu_eq²: one that is damped, or cut
        to the largest change of a parameter, falls short of what there is to gain.
        """
        step = np.asarray(self.solution.increment)
        gain = np.einsum("lj,lja,la->l", self.weights, self.sums.rhs, step)
        power = np.einsum("lj,lj->l", self.weights, self.sums.square)
        return gain / np.maximum(power, np.finfo(float).tiny)

    @property
    def is_stationary(self) -> Bool[np.ndarray, " lanes"]:
        """Whether Δθ moves F[f] by less than rounding errors of F[y^(r)]; False if not finite."""
        with np.errstate(invalid="ignore"):  # an infinite regressor times a zero increment
            moved = np.abs(self.increment) * self.solution.scale
        size = np.sqrt(np.einsum("lj,lj->l", self.weights, self.sums.observed_square))
        return np.all(moved <= _SETTINGS.rounding * size[:, None], axis=1)

    @property
    def is_rank_deficient(self) -> Bool[np.ndarray, " lanes"]:
        """Whether the data carry no information about some direction of θ."""
        return ~np.all(np.asarray(self.solution.identified), axis=1)


@dataclass(frozen=True)
class IterationHistory:
    """The iterations of every lane; NaN after its last.

    Attributes:
        theta: of each iteration, shape (lanes, passes, np).
        index: P of each iteration, shape (lanes, passes, ny).
        increment: Δθ of each, shape (lanes, passes, np); that of the last is not applied.
        passes: number of iterations of each lane, shape (lanes,).
        best_pass: the iteration with the smallest index, shape (lanes,).
        best: that iteration.
        has_data: whether the first iteration scored any sample, shape (lanes,).
    """

    theta: Float[np.ndarray, "lanes passes np"]
    index: Float[np.ndarray, "lanes passes ny"]
    increment: Float[np.ndarray, "lanes passes np"]
    passes: Int[np.ndarray, " lanes"]
    best_pass: Int[np.ndarray, " lanes"]
    best: Iteration
    has_data: Bool[np.ndarray, " lanes"]

    @property
    def _falls_at_the_end(self) -> np.ndarray:
        """Whether the last of three or more passes made progress, whatever was to be expected."""
        rows = np.arange(len(self.passes))
        with np.errstate(divide="ignore", invalid="ignore"):
            cost = np.sum(np.log(self.index), axis=2)
            last, earlier = (cost[rows, np.maximum(self.passes - k, 0)] for k in (1, 2))
            return (self.passes > 2) & (earlier - last > _SETTINGS.min_progress)

    @property
    def codes(self) -> np.ndarray:
        """How each lane ended: codes of `_status.Status`, shape (lanes,)."""
        predicted = self.best.predicted_reduction
        used_all = self.passes == self.index.shape[1]
        unfinished = (predicted > _SETTINGS.min_progress) | self._falls_at_the_end
        outcomes = (
            (~self.has_data, "no_data"),
            (~np.isfinite(self.best.cost), "diverged"),
            (self.best.is_rank_deficient, "unidentifiable"),
            (self.passes == 1, "passes_exhausted"),
            (unfinished & used_all, "passes_exhausted"),
            (predicted <= _SETTINGS.min_progress, "converged"),
        )
        return np.select(
            [condition for condition, _ in outcomes], [name for _, name in outcomes], "stalled"
        )


def iterate(
    run: Run, plant: Plant, start: Thetas, passes: int, watch: Watch | None = None
) -> IterationHistory:
    """Iterate until the index no longer falls.

    Args:
        run: runs one pass; gets the indices of its lanes, their θ and the number of the iteration
            from 0, and returns their sums.
        plant: whose bounds and fixed parameters hold.
        start: θ_0, shape (lanes, np).
        passes: largest number of iterations.
        watch: called after each iteration with its number from 0, its index (lanes, ny), and for
            which lanes it is the best so far.
    """
    lanes, affine = np.arange(len(start)), plant.is_affine
    theta, active, damping = start, np.ones(len(start), bool), np.zeros(len(start))
    stale, count, best_pass = (np.zeros(len(start), int) for _ in range(3))
    awaited, divided = np.zeros(len(start), bool), not step_scales(plant).trivial
    sums = reference = best = has_data = None
    factor, history = _SETTINGS.damping_factor, []
    for number in range(passes):
        running = lanes[active]
        new_sums = run(running, theta[running], number)
        sums = _updated(sums, running, new_sums)
        current = _solve(plant, theta, sums, np.zeros(len(start)))
        if reference is None or best is None:
            reference, best, has_data = current, current, np.any(new_sums.count != 0, axis=1)
        lost = _loses_a_trace(plant, reference, current)
        current = replace(current, index=np.where(lost[:, None], np.inf, current.index))
        is_lower = current.cost < reference.cost - _SETTINGS.min_progress
        better = active & ((number == 0) | is_lower)
        worse = active & ~better & (current.cost > reference.cost) & (not affine)
        # A divisor that is right at last makes the others wrong for one step, by as much as it was:
        # a step is an overshoot where the next full one does not make up for it (the watchdog of
        # R. Chamberlain et al., Mathematical Programming Study 16 (1982) 1).
        may_wait = ~awaited & (damping == 0.0) & np.isfinite(current.cost) & divided
        awaited = worse & may_wait
        overshot = worse & ~awaited
        stale = np.where(better, 0, stale + (active & ~awaited))
        reduced = np.where(damping > _SETTINGS.min_damping, damping / factor, 0.0)
        damping = np.where(better, reduced, damping)
        # Gauss–Newton overshot: take a shorter step from the best iteration.
        raised = np.maximum(factor * damping, _SETTINGS.initial_damping)
        damping = np.where(overshot, raised, damping)
        is_damped = (better | overshot) & (damping > 0)
        if np.any(is_damped):
            origin = _selected(overshot, reference, current)
            damped_step = _solve(plant, origin.theta, origin.sums, damping)
            moved = damped_step.increment + origin.theta - theta
            increment = np.where(is_damped[:, None], moved, current.increment)
            current = replace(current, increment=increment)
        is_lowest = active & ((number == 0) | (current.cost < best.cost))
        if watch is not None:
            watch(number, current.index, is_lowest)
        reference, best = _selected(better, current, reference), _selected(is_lowest, current, best)
        best_pass = np.where(is_lowest, number, best_pass)
        count += active
        values = current.theta, current.index, current.increment
        history.append([np.where(active[:, None], array, np.nan) for array in values])
        finite = np.all(np.isfinite(current.increment), axis=1)
        limit = np.where(damping == 0.0, _SETTINGS.patience, _SETTINGS.damped_patience)
        active = active & ~current.is_stationary & (stale < limit) & finite
        if not np.any(active):
            break
        theta = np.where(active[:, None], theta + current.increment, theta)
    assert best is not None
    assert has_data is not None
    arrays = [_padded(np.stack(part, axis=1), passes) for part in zip(*history, strict=True)]
    theta, index, increment = arrays
    return IterationHistory(theta, index, increment, count, best_pass, best, has_data)


@dataclass(frozen=True)
class BlockCounts:
    """Number of steps and of blocks of scores of an estimate.

    Attributes:
        scored: steps that least squares counts.
        scored_in_blocks: scored steps in complete blocks.
        steps_in_blocks: all steps in complete blocks.
        blocks: complete blocks.
    """

    scored: int = 0
    scored_in_blocks: int = 0
    steps_in_blocks: int = 0
    blocks: int = 0

    @property
    def complete_blocks(self) -> int:
        """Number of blocks that the scored steps would fill."""
        return int(self.scored_in_blocks / max(self.steps_in_blocks, 1) * self.blocks)

    def plus(self, steps: Steps) -> "BlockCounts":
        """The counts including the steps of more records."""
        scored = np.any(np.asarray(steps.score) > 0, axis=-1)
        in_block = np.asarray(steps.block_weight) > 0
        return BlockCounts(
            self.scored + int(np.sum(scored)),
            self.scored_in_blocks + int(np.sum(scored & in_block)),
            self.steps_in_blocks + int(np.sum(in_block)),
            self.blocks + int(np.sum(steps.block_end)),
        )


def group_by_sample(
    values: Float[np.ndarray, "records S ny ..."], use: Any, substeps: int
) -> Float[np.ndarray, "samples rows ..."]:
    """Values of all steps, grouped by sample, record after record without the padding.

    Args:
        values: by record, step and output.
        use: of `kernel.Steps`.
        substeps: steps per sample.

    Returns:
        One group per sample; its rows are the outputs in all of its steps, since variations within
        a sample are far faster than any cosine of `long_run`.
    """
    stops = substeps * sample_counts(use, substeps)
    parts = [array[:end] for array, end in zip(values, stops, strict=True)]
    joined = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return joined.reshape(-1, substeps * values.shape[2], *values.shape[3:])


def sample_counts(use: Any, substeps: int) -> Int[np.ndarray, " records"]:
    """Number of samples of each record up to the last that counts, as in `group_by_sample`."""
    used = np.any(np.asarray(use) > 0, axis=-1)
    ends = used.shape[1] - np.argmax(used[:, ::-1], axis=1)
    return np.where(np.any(used, axis=1), -(-ends // substeps), 0)


def sandwich(
    free: Float[np.ndarray, " np"],
    estimate: Iteration,
    meat: Float[np.ndarray, "lanes np np"],
    counts: BlockCounts,
) -> Float[np.ndarray, "lanes np np"]:
    r"""Sandwich covariance [Σφᵀφ]⁻¹ S [Σφᵀφ]⁻¹ of each lane.

    S comes from sums of φᵀr over blocks that are longer than the memory of F.
    NaN on a bound, and where the records hold fewer than `FEWEST_BLOCKS`.

    Args:
        free: 1 for an estimated parameter.
        estimate: the iteration of the estimate.
        meat: S, of a pass with the increment and the weights of that iteration.
        counts: of all records of the estimate.
    """
    inverse = np.asarray(estimate.solution.inverse)
    blocks = counts.complete_blocks
    if blocks < FEWEST_BLOCKS:
        unavailable = np.where(np.outer(free, free) > 0, np.nan, 0.0)
        return np.broadcast_to(unavailable, meat.shape)
    # One block less: at the estimate the scores of all samples sum to zero.
    scale = counts.scored / counts.scored_in_blocks * blocks / (blocks - 1)
    on_bound = estimate.bound[:, :, None] | estimate.bound[:, None, :]
    return np.where(on_bound, np.nan, scale * inverse @ meat @ inverse)


def _loses_a_trace(plant: Plant, before: Iteration, after: Iteration) -> Bool[np.ndarray, " lanes"]:
    """Whether a step has ended on a bound where a parameter has no trace any more.

    A root's derivative is zero where it reaches zero (`compiler/roots.py`): no step leads away.
    """
    traces = [
        np.einsum("ljaa->la", np.asarray(iteration.sums.information))
        for iteration in (before, after)
    ]
    on_bound = (after.theta == plant.lower) | (after.theta == plant.upper)
    return np.any(on_bound & (traces[0] > 0.0) & (traces[1] == 0.0), axis=1)


def _padded(values: np.ndarray, passes: int) -> np.ndarray:
    missing = passes - values.shape[1]
    return np.pad(values, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)


def _updated(old: Sums | None, running: Int[np.ndarray, " some"], new: Sums) -> Sums:
    """Sums of all lanes, with those of the running lanes replaced."""
    if old is None:
        return jax.tree.map(np.asarray, new)

    def leaf(old: np.ndarray, new: Any) -> np.ndarray:
        updated = old.copy()
        updated[running] = new
        return updated

    return jax.tree.map(leaf, old, new)


def _selected(
    mask: Bool[np.ndarray, " lanes"], chosen: Iteration, alternative: Iteration
) -> Iteration:
    """Lane by lane: the first iteration where the mask is true, else the second."""
    if np.all(mask) or np.all(~mask):
        return chosen if np.all(mask) else alternative

    def leaf(a: Any, b: Any) -> np.ndarray:
        return np.where(mask.reshape(-1, *(1,) * (np.ndim(a) - 1)), a, b)

    return jax.tree.map(leaf, chosen, alternative)


def _solve(
    plant: Plant, theta: Thetas, sums: Sums, damping: Float[np.ndarray, " lanes"]
) -> Iteration:
    """Index (14) and Δθ of (11), from the sums of a pass of every lane."""
    theta = _snapped_to_bounds(plant, theta)
    power = np.asarray(index_of(sums.square, sums.weight))
    size = mean(sums.observed_square, sums.weight)
    # An index below rounding errors has no meaning; the floor also keeps the weights finite.
    floor = np.maximum(_SETTINGS.index_floor * size, np.finfo(float).tiny)
    weights = np.where(np.isfinite(power), 1.0 / np.maximum(power, floor), 0.0)
    weights = weights / np.maximum(np.max(weights, axis=1, keepdims=True), np.finfo(float).tiny)
    information = np.einsum("lj,ljab->lab", weights, sums.information)
    rhs = np.einsum("lj,lja->la", weights, sums.rhs)
    solution = least_squares(information, rhs, plant.free, damping)
    scales = step_scales(plant)
    solution, bound = _solve_within_bounds(plant, theta, solution, information, rhs, damping)
    with np.errstate(all="ignore"):  # of lanes that are not finite
        moved = theta + scaled_step(theta, np.asarray(solution.increment), scales)
    moved = np.clip(moved, plant.lower, plant.upper)
    return Iteration(theta, sums, power, weights, solution, moved - theta, bound)


def _solve_within_bounds(
    plant: Plant,
    theta: Thetas,
    solution: Solution,
    information: Float[np.ndarray, "lanes np np"],
    rhs: Thetas,
    damping: Float[np.ndarray, " lanes"],
) -> tuple[Solution, Bool[np.ndarray, "lanes np"]]:
    """The solution within the bounds, and which parameters stay on a bound.

    Parameters that would leave their bounds are put on them and the others solved for again:
    clipping without that would leave the others fitted to a model that the bounds exclude.
    """
    lower, upper, free = (np.asarray(array) for array in (plant.lower, plant.upper, plant.free))
    scales = step_scales(plant)
    room = step_room(theta, lower, upper, scales)
    unbounded, steps = np.asarray(solution.increment), None
    if not scales.trivial:  # in the coordinates in which the bounds are
        steps = coordinates(theta, scales)
        unbounded = np.linalg.solve(steps, unbounded[..., None])[..., 0]
    if not leaves_bounds(unbounded, room):
        return solution, np.zeros(theta.shape, bool)
    square, right, size = information, rhs, np.asarray(solution.scale)
    if steps is not None:
        square = np.swapaxes(steps, 1, 2) @ information @ steps
        right = np.einsum("lab,la->lb", steps, rhs)
        size = np.sqrt(np.maximum(np.diagonal(square, axis1=1, axis2=2), 0.0))

    def solve(rhs: Thetas, is_free: Bool[np.ndarray, "lanes np"]) -> Thetas:
        return np.asarray(least_squares(square, rhs, free * is_free, damping).increment)

    damped = damping[:, None, None] * np.eye(len(free)) * size[:, :, None] ** 2
    increment, side = bounded(solve, square + damped, right, unbounded, room)
    if steps is not None:
        increment = np.einsum("lab,lb->la", steps, increment)
    bound = ((side < 0) & (theta == lower)) | ((side > 0) & (theta == upper))
    inverse = np.asarray(least_squares(information, rhs, free * ~bound, damping).inverse)
    inverse = np.where(np.any(bound, axis=1)[:, None, None], inverse, solution.inverse)
    leaves = (increment, inverse)
    return eqx.tree_at(lambda leaf: (leaf.increment, leaf.inverse), solution, leaves), bound


def _snapped_to_bounds(plant: Plant, theta: Thetas) -> Thetas:
    """θ with parameters that are on a bound but for rounding put exactly on it."""
    for bound in (plant.lower, plant.upper):
        finite = np.where(np.isfinite(bound), bound, np.nan)
        rounding = _SETTINGS.bound_rounding * np.finfo(float).eps * np.abs(finite)
        at_bound = np.abs(theta - finite) <= rounding
        theta = np.where(at_bound, finite, theta)
    return theta


def mean(total: Any, weight: Any) -> np.ndarray:
    """Total over weight; 0 where the weight is 0."""
    weight = np.asarray(weight)
    return np.where(weight > 0, np.asarray(total) / np.where(weight > 0, weight, 1.0), 0.0)
