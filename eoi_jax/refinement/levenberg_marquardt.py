r"""Levenberg-Marquardt for many runs that share parameters and start each on its start_size.

Its first steps are all but Gauss-Newton. Each run is given by a small square root of its normal
equations. The Jacobian has the shape of an arrow: the initial states are eliminated run by run, for
QR of the rows of each run leaves a small triangle (Å. Björck, *Numerical Methods for Least Squares
Problems*, section 6.3). The trust region widens and narrows as in N. I. M. Gould, D. Orban,
A. Sartenaer and Ph. L. Toint, *Sensitivity of trust-region algorithms to their parameters*, 4OR 3,
2005.

All of it is NumPy, over a leading axis of lanes: points that are followed side by side. The
matrices are small, and the runs are called, not compiled in: no program depends on how many runs or
unknowns there are.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.models.step_scales import coordinates, linear_step, scaled_step, shortened
from eoi_jax.refinement.free_run_sums import lane_code, roots, signals, sums
from eoi_jax.refinement.problem import CONVERGED, Outcome, Problem, Unknowns
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.sensitivity import added_up

Watch = Callable[[Any, Any], None]


@dataclass(frozen=True)
class LevenbergMarquardtSettings:
    """Numbers of the solver; damping is relative to the squared length of each column."""

    initial_damping: float = 1e-2  # of the first step
    min_damping: float = 1e-12  # of a full step: enough for what leaves no trace
    # Shares of the predicted reduction from which on a step is taken, and the region is widened;
    # factors by which its size, the inverse of the damping, grows and shrinks.
    acceptance: float = 0.01
    widening: float = 0.75
    growth: float = 3.5
    shrinkage: float = 0.25
    min_step: float = 1e-4  # size of the trust region at which it gives up, relative to the first
    cost_floor: float = 1e-18  # mean square of weighed errors that is rounding, over `CONVERGED`
    # Kinks of dry friction: steps keep being taken that lower the cost by next to nothing, and by
    # little of what they promise. A step is poor if it lowers the cost by less than both shares.
    poor_reduction: float = 3e-4  # of the cost
    poor_ratio: float = 0.1  # of the predicted reduction
    max_poor_steps: int = 3  # in a row; they end the search


_SETTINGS = LevenbergMarquardtSettings()

Rows = Float[np.ndarray, "lanes runs size size"]
Lanes = Float[np.ndarray, " lanes"]
Free = Float[np.ndarray, "lanes free"]


@dataclass(frozen=True)
class _Reduced:
    """The linearised problem of each lane at its last accepted point, columns no longer than one.

    Attributes:
        theta, starts: that point.
        rows: the roots there: of each run, columns of its start, θ and the error.
        triangles: R of these rows, with θ on its scales.
        start_lengths, lengths: lengths of the columns of starts, at least typical ones, and of θ
            (over all runs).
        predicted_reduction: share of the cost that a step without damping would take away.
        cancelling: what a single parameter does in that step, over what all of it does, at most.
        cost: there.
    """

    theta: Free
    starts: Float[np.ndarray, "lanes runs own"]
    rows: Rows
    triangles: Rows
    start_lengths: Float[np.ndarray, "lanes runs own"]
    lengths: Free
    predicted_reduction: Lanes
    cancelling: Lanes
    cost: Lanes


@dataclass(frozen=True)
class _Search:
    """Where the search of each lane is.

    Attributes:
        reduced: the problem at the last accepted point.
        size: of the trust region, relative to the first. widest: the largest so far.
        poor: accepted steps in a row that lowered the cost by next to nothing.
        steps: simulations with sensitivities so far.
    """

    reduced: _Reduced
    size: Lanes
    widest: Lanes
    poor: Int[np.ndarray, " lanes"]
    steps: Int[np.ndarray, " lanes"]

    @property
    def lost(self) -> Bool[np.ndarray, " lanes"]:
        """Whether no step lowers the cost to speak of."""
        return (self.size < _SETTINGS.min_step) | (self.poor >= _SETTINGS.max_poor_steps)

    def ended(self, max_steps: int) -> Bool[np.ndarray, " lanes"]:
        """Whether the cost is at its floor, no step lowers it to speak of, or time is up."""
        converged = self.reduced.predicted_reduction < CONVERGED
        return converged | self.lost | (self.steps >= max_steps)


@dataclass(frozen=True)
class _Arrow:
    """Damped least squares (Marquardt's scaling), starts eliminated run by run, bounds kept.

    Marquardt's steps are the same on any scale of a parameter; what they move is not. Parameters
    that multiply a divisor are damped as the products that they are (`step_scales.py`): as the
    divisor grows, its own column and theirs become one.
    """

    problem: Problem
    start_size: int  # unknowns of the start of a run
    scored: int

    @classmethod
    def of(cls, problem: Problem, unknowns: Unknowns) -> "_Arrow":
        return cls(problem, unknowns.starts.shape[-1], int(np.sum(problem.use)))

    def linearised(self, at: Unknowns, rows: Rows) -> _Reduced:
        """The problem at a point, whose roots are given."""
        problem, start_size, theta = self.problem, self.start_size, np.asarray(at.theta)
        columns, error = rows[..., :-1].copy(), rows[..., -1]
        # On its bound, and the cost falls beyond it: not a direction to go.
        slope = np.einsum("lrnu,lrn->lu", columns[..., start_size:], error)
        stuck = (theta <= problem.lower) & (slope > 0) | (theta >= problem.upper) & (slope < 0)
        columns[..., start_size:] *= np.where(stuck, 0.0, 1.0)[:, None, None]
        if not problem.scales.trivial:
            columns[..., start_size:] = (
                columns[..., start_size:] @ coordinates(theta, problem.scales)[:, None]
            )
        power = np.sum(columns**2, axis=2)
        traced = (
            power[..., :start_size]
            > np.pad(problem.faintest, (0, start_size - len(problem.faintest))) ** 2
        )
        columns[..., :start_size] *= traced[:, :, None]
        start_lengths = _length(_at_least_typical(np.where(traced, power[..., :start_size], 0.0)))
        lengths = _length(np.sum(power[..., start_size:], axis=1))
        columns[..., :start_size] /= start_lengths[:, :, None]
        columns[..., start_size:] /= lengths[:, None, None]
        triangles = _triangle(np.concatenate([columns, error[..., None]], axis=-1))
        damping = np.full(len(theta), _SETTINGS.min_damping)
        step, remaining_cost = _shared_step(
            _damped(triangles, start_size, damping), start_size, damping
        )
        cost = np.sum(error**2, axis=(1, 2))
        floor = _SETTINGS.cost_floor * self.scored
        predicted_reduction = (cost - remaining_cost) / np.maximum(cost, floor)
        change = np.sqrt(np.maximum(cost - remaining_cost, floor))
        cancelling = np.max(np.abs(step), axis=1, initial=0.0) / change
        return _Reduced(theta, np.asarray(at.starts), rows, triangles, start_lengths, lengths,
                        predicted_reduction, cancelling, cost)  # fmt: skip

    def stepped(self, reduced: _Reduced, size: Lanes) -> Unknowns:
        """Where the step of damping inverse to `size` leads."""
        scales, at = self.problem.scales, reduced.theta
        damping = _SETTINGS.initial_damping / size
        rows = _damped(reduced.triangles, self.start_size, damping)
        step = _shared_step(rows, self.start_size, damping)[0] / reduced.lengths
        if not scales.trivial:
            products = coordinates(at, scales)
            step = shortened(at, (products @ step[..., None])[..., 0], scales)
            step = scaled_step(at, step, scales)
        step = linear = np.clip(step, self.problem.lower - at, self.problem.upper - at)
        if not scales.trivial:
            linear = linear_step(at, step, scales)
            # (I - C)⁻¹ = I + C, for no product multiplies another: C² = 0.
            linear = 2.0 * linear - (products @ linear[..., None])[..., 0]
        own_steps = _own_steps(rows[..., : self.start_size, :], linear * reduced.lengths)
        return Unknowns(at + step, reduced.starts + own_steps / reduced.start_lengths)

    def begun(self, unknowns: Unknowns, rows: Rows) -> _Search:
        """Before the first step, with the roots there."""
        lanes = len(unknowns.theta)
        unit, zeros = np.ones(lanes), np.zeros(lanes, int)
        return _Search(self.linearised(unknowns, rows), unit, unit, zeros, zeros + 1)

    def moved(self, search: _Search, trial: Unknowns, rows: Rows, patient: bool) -> _Search:
        """With the trial step of each lane taken, or a smaller trust region.

        To the patient no step is poor that leaves the trust region wider than ever: along a narrow
        valley the first damping allows next to no progress, and the region must widen by orders of
        magnitude before there is any. Of many searches side by side most are lost anyway, and all
        would wait for them.
        """
        old, size = search.reduced, search.size
        new = self.linearised(trial, rows)
        predicted, change = self._predicted(old, trial), 0.5 * (new.cost - old.cost)
        accepted = change <= _SETTINGS.acceptance * predicted
        good = (change < _SETTINGS.widening * predicted) & (predicted < 0)
        size = size * np.where(accepted, np.where(good, _SETTINGS.growth, 1.0), _SETTINGS.shrinkage)
        lowered = 1.0 - new.cost / old.cost
        poor = lowered < _SETTINGS.poor_reduction
        poor &= lowered < _SETTINGS.poor_ratio * old.predicted_reduction
        count = np.where(accepted, np.where(poor, search.poor + 1, 0), search.poor)
        if patient:
            count = np.where(size > search.widest, 0, count)
        widest = np.maximum(size, search.widest)
        return _Search(_chosen(accepted, new, old), size, widest, count, search.steps + 1)

    def _predicted(self, reduced: _Reduced, trial: Unknowns) -> Lanes:
        """Change of half of the cost that the linearised problem expects of a step."""
        start_size, rows = self.start_size, reduced.rows
        starts, theta = trial.starts - reduced.starts, trial.theta - reduced.theta
        moved = np.einsum("lrnu,lru->lrn", rows[..., :start_size], starts) + rows[..., -1]
        moved += np.einsum("lrnu,lu->lrn", rows[..., start_size:-1], theta)
        return 0.5 * (np.sum(moved**2, axis=(1, 2)) - reduced.cost)


def _chosen(flags: Bool[np.ndarray, " lanes"], first: Any, second: Any) -> Any:
    """Of each lane the first or the second of two dataclasses of arrays."""
    chosen = {}
    for field in fields(first):
        pair = getattr(first, field.name), getattr(second, field.name)
        if isinstance(pair[0], np.ndarray):
            flag = flags.reshape(-1, *[1] * (pair[0].ndim - 1))
            chosen[field.name] = np.where(flag, *pair)
        else:
            chosen[field.name] = _chosen(flags, *pair)
    return type(first)(**chosen)


def _length(power: np.ndarray) -> np.ndarray:
    """Of columns with these sums of squares; one for columns of zeros."""
    return np.sqrt(np.where(power > 0, power, 1.0))


def _at_least_typical(power: Float[np.ndarray, "lanes runs own"]) -> np.ndarray:
    """Of the columns of the starts, no less than the median over the runs in which there are any.

    In a run that sticks at once its first velocity does next to nothing, and a step that is damped
    by its own column alone would throw it far away from where it does so.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of what leaves no trace in any run
        typical = np.nanmedian(np.where(power > 0, power, np.nan), axis=1, keepdims=True)
    return np.where(power > 0, np.fmax(power, typical), power)


def _triangle(rows: np.ndarray) -> np.ndarray:
    """R of QR, of each matrix of a stack."""
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _damped(triangles: Rows, start_size: int, damping: Lanes) -> Rows:
    """R of each run with damping rows on its start."""
    rows = np.sqrt(damping)[:, None, None, None] * np.eye(start_size, triangles.shape[-1])
    rows = np.broadcast_to(rows, (*triangles.shape[:2], *rows.shape[2:]))
    return _triangle(np.concatenate([triangles, rows], axis=2))


def _shared_step(damped: Rows, start_size: int, damping: Lanes) -> tuple[Free, Lanes]:
    """Step of scaled θ over what the starts of the runs leave, and the cost that is then left."""
    corners = damped[..., start_size:, start_size:]
    lanes, size = len(corners), corners.shape[-1] - 1
    rows = np.sqrt(damping)[:, None, None] * np.eye(size, size + 1)
    stacked = np.concatenate([corners.reshape(lanes, -1, size + 1), rows], axis=1)
    triangle = _triangle(stacked)
    step = _solved(triangle[:, :size, :size], -triangle[:, :size, size])
    return step, triangle[:, size, size] ** 2


def _own_steps(rows: np.ndarray, theta: Free) -> Float[np.ndarray, "lanes runs own"]:
    """Steps of the scaled starts, given that of scaled θ."""
    start_size = rows.shape[-2]
    rhs = (rows[..., start_size:-1] @ theta[:, None, :, None])[..., 0] + rows[..., -1]
    return _solved(rows[..., :start_size], -rhs)


def _solved(triangles: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solutions of upper triangular systems, by substitution."""
    solution = np.zeros_like(right)
    for i in reversed(range(right.shape[-1])):
        inner = np.einsum("...j,...j->...", triangles[..., i, i + 1 :], solution[..., i + 1 :])
        solution[..., i] = (right[..., i] - inner) / triangles[..., i, i]
    return solution


def solve(
    problem: Problem,
    unknowns: Unknowns,
    sensitivities: Float[np.ndarray, "runs time ny size"],
    max_steps: int,
    watch: Watch | None = None,
) -> tuple[Outcome, Float[np.ndarray, "runs time ny size"]]:
    """Levenberg-Marquardt from `unknowns`.

    Where it converges a full step follows. `CONVERGED` of the cost is little, but of N samples
    up to √(10⁻⁶ N) standard errors, far along a narrow valley; and the signals there are wanted
    anyway.

    Args:
        problem: the runs.
        unknowns: to start from.
        sensitivities: `signals` there, so that they need not be simulated again.
        max_steps: at most.
        watch: called with the number of steps done, from 0, and half of the cost.

    Returns:
        Where it ended, and the signals there.
    """
    first = _sums(sensitivities, problem)[None]
    lanes = Unknowns(np.asarray(unknowns.theta)[None], np.asarray(unknowns.starts)[None])
    outcome = _search(problem, lanes, first, max_steps, watch, patient=True).lane(0)
    if float(outcome.predicted_reduction) < CONVERGED:
        further = signals(outcome.further, problem)
        cost = np.sum(_sums(further, problem)[:, -1, -1])
        if cost <= float(outcome.cost):
            return replace(outcome, unknowns=outcome.further, cost=np.asarray(cost)), further
    return outcome, signals(outcome.unknowns, problem)


def _sums(sensitivities: np.ndarray, problem: Problem) -> Float[np.ndarray, "runs size size"]:
    rows = sensitivities.reshape(len(sensitivities), -1, sensitivities.shape[-1])
    return added_up(rows, float(problem.threshold))


def solve_many(problem: Problem, unknowns: Unknowns, max_steps: int) -> Outcome:
    """The same from several points side by side (a leading axis), until the last one has ended."""
    if problem.compiled:
        problem = replace(problem, engine=compiled_runs.used(problem.kernel, len(unknowns.theta)))
    lanes = Unknowns(np.asarray(unknowns.theta), np.asarray(unknowns.starts))
    return _search(problem, lanes, None, max_steps, None, patient=False)


def _search(
    problem: Problem,
    unknowns: Unknowns,
    first_sums: Rows | None,
    max_steps: int,
    watch: Watch | None,
    patient: bool,
) -> Outcome:
    arrow, code = _Arrow.of(problem, unknowns), lane_code(problem, *unknowns.starts.shape[::2])
    with np.errstate(all="ignore"):  # of a run that diverges
        if watch is not None:
            watch(0, 0.0)
        square = sums(unknowns, problem, code) if first_sums is None else first_sums
        search = arrow.begun(unknowns, roots(square, unknowns.theta, problem.power))
        while True:
            if watch is not None:
                watch(search.steps[0], 0.5 * search.reduced.cost[0])
            ended = search.ended(max_steps)
            if np.all(ended):
                break
            trial = arrow.stepped(search.reduced, search.size)
            rows = roots(sums(trial, problem, code, ended), trial.theta, problem.power)
            search = _chosen(ended, search, arrow.moved(search, trial, rows, patient))
        full = np.full(len(ended), _SETTINGS.initial_damping / _SETTINGS.min_damping)
        further = arrow.stepped(search.reduced, full)
    reduced = search.reduced
    return Outcome(
        Unknowns(reduced.theta, reduced.starts),
        further,
        reduced.cost,
        reduced.predicted_reduction,
        reduced.cancelling,
        search.steps,
        (search.steps >= max_steps) & ~search.lost,
    )
