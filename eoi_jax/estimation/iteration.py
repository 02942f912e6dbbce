r"""The iteration of section 4 of the paper, for many lanes at once.

A lane is one estimate: pass i runs its observer with θ_i, recovers the equivalent injection, solves
(11) for Δθ_i, scores P_i (14), and updates θ_{i+1} = θ_i + Δθ_i. The estimate is the θ_k whose pass
has the smallest index, θ_0 + Σ_{j<k} Δθ_j; P need not converge. Lanes do not know of each other: a
lane that ends, or goes wrong, leaves the rest as they are.

Outputs with different units are weighed by 1/P_j, the index of each: the weights of maximum
likelihood when each output has noise of its own. The smallest index is then that of Σ_j log P_j.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.estimation.kernel import Steps, Sums
from eoi_jax.estimation.regression.bounded import bounded, outside
from eoi_jax.estimation.regression.index import index as index_of
from eoi_jax.estimation.regression.least_squares import Solution, least_squares
from eoi_jax.models.plant import Plant

# A pass must lower Σ log P by this share to count as progress; two in a row without end the run.
PROGRESS = 1e-2
_PATIENCE = 2
# An increment whose effect is below this share of the observed derivative changes nothing.
_ROUNDING = 1e-10
# A model that is not affine in θ: first Levenberg damping (of columns scaled to one) after a pass
# that went wrong, the least before the full step is tried again (where it overshot once it mostly
# does so again), and how many such passes in a row end the run.
_DAMPING = 0.1
_LIGHT = 3e-3
_RETRIES = 5
_BESIDE = 64.0  # rounding errors of a bound within which a parameter is on it

Thetas = Float[np.ndarray, "lanes np"]
Watch = Callable[[int, np.ndarray, np.ndarray], None]
Run = Callable[[Int[np.ndarray, " some"], Float[np.ndarray, "some np"], int], Sums]


class Pass(eqx.Module):
    """One pass of every lane, and where it leads.

    Attributes:
        theta: at which it ran, shape (lanes, np).
        sums: that it added up.
        index: P, shape (lanes, ny).
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
        """Σ_j log P_j over the outputs that were scored; the smallest is the best pass.

        Infinite without slopes to go on from: a parameter on a bound where f has none.
        """
        scored = self.sums.count != 0  # NaN, too: a lane that went wrong is no perfect fit
        power = np.where(scored, self.index, 1.0)
        finite = np.all(np.isfinite(power), axis=1)
        finite &= np.all(np.isfinite(self.sums.information), axis=(1, 2, 3))
        safe = np.where(np.isfinite(power), power, 1.0)
        logs = np.log(np.maximum(safe, np.finfo(float).tiny))
        return np.where(finite, np.sum(logs, axis=1), np.inf)

    @property
    def promise(self) -> Float[np.ndarray, " lanes"]:
        """Share of the index that Δθ takes away if φ does not change: Δθᵀ Σφᵀu_eq / Σu_eq²."""
        gain = np.einsum("lj,lja,la->l", self.weights, self.sums.rhs, self.increment)
        power = np.einsum("lj,lj->l", self.weights, self.sums.square)
        return gain / np.maximum(power, np.finfo(float).tiny)

    @property
    def settled(self) -> Bool[np.ndarray, " lanes"]:
        """Whether Δθ moves F[f] by less than rounding shows in F[y^(r)]; no lost lane's."""
        with np.errstate(invalid="ignore"):  # a regressor without bound and no step
            moved = np.abs(self.increment) * self.solution.scale
        size = np.sqrt(np.einsum("lj,lj->l", self.weights, self.sums.observed_square))
        return np.all(moved <= _ROUNDING * size[:, None], axis=1)

    @property
    def lost(self) -> Bool[np.ndarray, " lanes"]:
        """Whether some direction of θ left no trace."""
        return ~np.all(np.asarray(self.solution.identified), axis=1)


@dataclass(frozen=True)
class Iterations:
    """Every lane's passes; NaN after its last.

    Attributes:
        theta: of each pass, shape (lanes, passes, np).
        index: P of each pass, shape (lanes, passes, ny).
        increment: Δθ of each pass, shape (lanes, passes, np); that of the last is not applied.
        passes: how many each lane took, shape (lanes,).
        best_pass: the one of the smallest index, shape (lanes,).
        best: that pass.
        seen: whether the first pass scored anything, shape (lanes,).
    """

    theta: Float[np.ndarray, "lanes passes np"]
    index: Float[np.ndarray, "lanes passes ny"]
    increment: Float[np.ndarray, "lanes passes np"]
    passes: Int[np.ndarray, " lanes"]
    best_pass: Int[np.ndarray, " lanes"]
    best: Pass
    seen: Bool[np.ndarray, " lanes"]

    @property
    def codes(self) -> np.ndarray:
        """How each lane ended: codes of `results.Status`, shape (lanes,)."""
        promise = self.best.promise
        spent = self.passes == self.index.shape[1]
        ends = (
            (~self.seen, "no_data"),
            (~np.isfinite(self.best.cost), "diverged"),
            (self.best.lost, "unidentifiable"),
            (self.passes == 1, "passes_exhausted"),
            ((promise > PROGRESS) & spent, "passes_exhausted"),
            (promise <= PROGRESS, "converged"),
        )
        return np.select([one for one, _ in ends], [name for _, name in ends], "stalled")


def iterate(
    run: Run, plant: Plant, start: Thetas, passes: int, watch: Watch | None = None
) -> Iterations:
    """Passes until the index no longer falls.

    Args:
        run: one pass: of which lanes, at which θ, the number of the pass from 0; its sums.
        plant: whose bounds hold, and whose fixed parameters stay.
        start: θ_0, shape (lanes, np).
        passes: how many at most.
        watch: called after each pass with its number from 0, its index (lanes, ny), and for which
            lanes it is the best so far.
    """
    lanes, affine = len(start), plant.is_affine
    every, theta, active = np.arange(lanes), start, np.ones(lanes, bool)
    stale, damping, count = np.zeros(lanes, int), np.zeros(lanes), np.zeros(lanes, int)
    now = reference = least = seen = None
    best_pass, history = np.zeros(lanes, int), []
    for number in range(passes):
        which = every[active]
        sums = run(which, theta[which], number)
        now = _placed(now, which, sums)
        one = _solve(plant, theta, now, np.zeros(lanes))
        if reference is None or least is None:
            reference, least, seen = one, one, np.any(sums.count != 0, axis=1)
        better = active & ((number == 0) | (one.cost < reference.cost - PROGRESS))
        worse = active & ~better & (one.cost > reference.cost) & (not affine)
        stale = np.where(better, 0, stale + active)
        eased = np.where(damping > _LIGHT, damping / 10.0, 0.0)
        damping = np.where(better, eased, damping)
        # Gauss–Newton overshot: from the best pass again, a shorter step.
        damping = np.where(worse, np.maximum(10.0 * damping, _DAMPING), damping)
        damped = (better | worse) & (damping > 0)
        if np.any(damped):
            base = _chosen(worse, reference, one)
            again = _solve(plant, base.theta, base.sums, damping)
            moved = again.increment + base.theta - theta
            increment = np.where(damped[:, None], moved, one.increment)
            one = replace(one, increment=increment)
        lower = active & ((number == 0) | (one.cost < least.cost))
        if watch is not None:
            watch(number, one.index, lower)
        reference, least = _chosen(better, one, reference), _chosen(lower, one, least)
        best_pass = np.where(lower, number, best_pass)
        count += active
        history.append([np.where(active[:, None], v, np.nan) for v in _shown(one)])
        finite = np.all(np.isfinite(one.increment), axis=1)
        limit = np.where(damping == 0.0, _PATIENCE, _RETRIES)
        active = active & ~one.settled & (stale < limit) & finite
        if not np.any(active):
            break
        theta = np.where(active[:, None], theta + one.increment, theta)
    assert least is not None
    assert seen is not None
    shown = [_stretched(np.stack(part, axis=1), passes) for part in zip(*history, strict=True)]
    theta, index, increment = shown
    return Iterations(theta, index, increment, count, best_pass, least, seen)


@dataclass(frozen=True)
class Tally:
    """How many steps and blocks of scores an estimate has.

    Attributes:
        scored: steps that least squares counts.
        inside: those of them in complete blocks.
        weighed: all steps in complete blocks.
        blocks: complete ones.
    """

    scored: int = 0
    inside: int = 0
    weighed: int = 0
    blocks: int = 0

    @property
    def complete(self) -> int:
        """Blocks, as many as the scored steps would fill."""
        return int(self.inside / max(self.weighed, 1) * self.blocks)

    def plus(self, steps: Steps) -> "Tally":
        """With the steps of one or several more records."""
        scored = np.any(np.asarray(steps.score) > 0, axis=-1)
        weighed = np.asarray(steps.block_weight) > 0
        return Tally(
            self.scored + int(np.sum(scored)),
            self.inside + int(np.sum(scored & weighed)),
            self.weighed + int(np.sum(weighed)),
            self.blocks + int(np.sum(steps.block_end)),
        )


def by_sample(
    values: Float[np.ndarray, "records S ny ..."], use: Any, substeps: int
) -> Float[np.ndarray, "samples rows ..."]:
    """What each step has, record after record without the padding, a sample's steps together.

    Args:
        values: by record, step and output.
        use: of `passes.Steps`.
        substeps: steps of a sample.

    Returns:
        By sample; its rows are the outputs in all of its steps. What happens within a sample is far
        faster than any cosine of `long_run`.
    """
    ends = substeps * sample_counts(use, substeps)
    parts = [one[:end] for one, end in zip(values, ends, strict=True)]
    whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
    return whole.reshape(-1, substeps * values.shape[2], *values.shape[3:])


def sample_counts(use: Any, substeps: int) -> Int[np.ndarray, " records"]:
    """Samples of each record up to the last that counts: of `by_sample`."""
    used = np.any(np.asarray(use) > 0, axis=-1)
    ends = used.shape[1] - np.argmax(used[:, ::-1], axis=1)
    return np.where(np.any(used, axis=1), -(-ends // substeps), 0)


def sandwich(
    free: Float[np.ndarray, " np"], one: Pass, meat: Float[np.ndarray, "lanes np np"], tally: Tally
) -> Float[np.ndarray, "lanes np np"]:
    r"""Sandwich [Σφᵀφ]⁻¹ S [Σφᵀφ]⁻¹, S from sums of φᵀr over blocks longer than F's memory.

    NaN on a bound, and where the records hold less than three blocks: too short to tell.

    Args:
        free: 1 for an estimated parameter.
        one: pass of the estimate.
        meat: S, of a pass with the increment and the weights of that one.
        tally: of all records of the estimate.
    """
    inverse = np.asarray(one.solution.inverse)
    blocks = tally.complete
    if blocks < 3:
        unknown = np.where(np.outer(free, free) > 0, np.nan, 0.0)
        return np.broadcast_to(unknown, meat.shape)
    # One for the estimate, at which the scores of all samples sum to zero.
    scale = tally.scored / tally.inside * blocks / (blocks - 1)
    on_bound = one.bound[:, :, None] | one.bound[:, None, :]
    return np.where(on_bound, np.nan, scale * inverse @ meat @ inverse)


def _shown(one: Pass) -> tuple[np.ndarray, ...]:
    return one.theta, one.index, one.increment


def _stretched(values: np.ndarray, passes: int) -> np.ndarray:
    missing = passes - values.shape[1]
    return np.pad(values, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)


def _placed(old: Sums | None, which: Int[np.ndarray, " some"], new: Sums) -> Sums:
    """Sums of all lanes, those that ran brought up to date."""
    if old is None:
        return jax.tree.map(np.asarray, new)

    def leaf(old: np.ndarray, new: Any) -> np.ndarray:
        whole = old.copy()
        whole[which] = new
        return whole

    return jax.tree.map(leaf, old, new)


def _chosen(mask: Bool[np.ndarray, " lanes"], yes: Pass, no: Pass) -> Pass:
    """Lane by lane from one pass or the other."""
    if np.all(mask) or np.all(~mask):
        return yes if np.all(mask) else no

    def leaf(a: Any, b: Any) -> np.ndarray:
        return np.where(mask.reshape(-1, *(1,) * (np.ndim(a) - 1)), a, b)

    return jax.tree.map(leaf, yes, no)


def _solve(plant: Plant, theta: Thetas, sums: Sums, damping: Float[np.ndarray, " lanes"]) -> Pass:
    theta = _on_bounds(plant, theta)
    power = np.asarray(index_of(sums.square, sums.weight))
    size = mean(sums.observed_square, sums.weight)
    # Rounding bounds how small an index can mean anything; it also keeps weights finite.
    floor = np.maximum(1e-24 * size, np.finfo(float).tiny)
    weights = np.where(np.isfinite(power), 1.0 / np.maximum(power, floor), 0.0)
    weights = weights / np.maximum(np.max(weights, axis=1, keepdims=True), np.finfo(float).tiny)
    information = np.einsum("lj,ljab->lab", weights, sums.information)
    rhs = np.einsum("lj,lja->la", weights, sums.rhs)
    solution = least_squares(information, rhs, plant.free, damping)
    solution, bound = _within(plant, theta, solution, information, rhs, damping)
    moved = np.clip(theta + solution.increment, plant.lower, plant.upper)
    return Pass(theta, sums, power, weights, solution, moved - theta, bound)


def _within(
    plant: Plant,
    theta: Thetas,
    solution: Solution,
    information: Float[np.ndarray, "lanes np np"],
    rhs: Thetas,
    damping: Float[np.ndarray, " lanes"],
) -> tuple[Solution, Bool[np.ndarray, "lanes np"]]:
    """A solution within the bounds, and which parameters are, and stay, on one.

    What would leave its bounds is put on them and the rest solved anew: cut off alone, it would
    leave the rest where they suit a model that the bounds exclude.
    """
    lower, upper, free = (np.asarray(one) for one in (plant.lower, plant.upper, plant.free))
    room = lower - theta, upper - theta
    unbounded = np.asarray(solution.increment)
    if not outside(unbounded, room):
        return solution, np.zeros(theta.shape, bool)

    def solve(rhs: Thetas, inside: Bool[np.ndarray, "lanes np"]) -> Thetas:
        return np.asarray(least_squares(information, rhs, free * inside, damping).increment)

    damped = damping[:, None, None] * np.eye(len(free)) * solution.scale[:, :, None] ** 2
    increment, side = bounded(solve, information + damped, rhs, unbounded, room)
    bound = ((side < 0) & (theta == lower)) | ((side > 0) & (theta == upper))
    inverse = np.asarray(least_squares(information, rhs, free * ~bound, damping).inverse)
    inverse = np.where(np.any(bound, axis=1)[:, None, None], inverse, solution.inverse)
    leaves = (increment, inverse)
    return eqx.tree_at(lambda one: (one.increment, one.inverse), solution, leaves), bound


def _on_bounds(plant: Plant, theta: Thetas) -> Thetas:
    """θ with what rounding has left beside a bound put on it."""
    for bound in (plant.lower, plant.upper):
        finite = np.where(np.isfinite(bound), bound, np.nan)
        near = np.abs(theta - finite) <= _BESIDE * np.finfo(float).eps * np.abs(finite)
        theta = np.where(near, finite, theta)
    return theta


def mean(total: Any, weight: Any) -> np.ndarray:
    """Total over weight; 0 where nothing was added up."""
    weight = np.asarray(weight)
    return np.where(weight > 0, np.asarray(total) / np.where(weight > 0, weight, 1.0), 0.0)
