r"""Levenberg-Marquardt for many runs that share parameters and start each on its own.

Optimistix's solver; its first steps are all but Gauss-Newton. Each run is given by a small square
root of its normal equations. The Jacobian has the shape of an arrow: the initial states are
eliminated run by run, for QR of the rows of each run leaves a small triangle (Å. Björck,
*Numerical Methods for Least Squares Problems*, section 6.3).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from eoi_jax._types import Scalar
from eoi_jax.compiler.callback import lent
from eoi_jax.compiler.programs import jit
from eoi_jax.models.step_scales import Scales, coordinates, linear_step, scaled_step, shortened
from eoi_jax.refinement.free_run_sums import errors, signals
from eoi_jax.refinement.problem import (
    CONVERGED,
    HostRuns,
    Outcome,
    Problem,
    Unknowns,
    scored_values,
)
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.sensitivity import Host, added_up

Watch = Callable[[Any, Any], None]


@dataclass(frozen=True)
class LevenbergMarquardtSettings:
    """Numbers of the solver; damping is relative to the squared length of each column."""

    initial_damping: float = 1e-2  # of the first step
    min_damping: float = 1e-12  # of a full step: enough for what leaves no trace
    widening: float = 0.75  # share of the predicted reduction from which on the region is widened
    min_step: float = 1e-4  # size of the trust region at which it gives up, relative to the first
    cost_floor: float = 1e-18  # mean square of weighed errors that is rounding, over `CONVERGED`
    # Kinks of dry friction: steps keep being taken that lower the cost by next to nothing, and by
    # little of what they promise. A step is poor if it lowers the cost by less than both shares.
    poor_reduction: float = 3e-4  # of the cost
    poor_ratio: float = 0.1  # of the predicted reduction
    max_poor_steps: int = 3  # in a row; they end the search
    # Unknown parameters are filled up to a multiple of it by some that do nothing: models with one
    # parameter more or less share a compiled program, which takes a second.
    grain: int = 4


_SETTINGS = LevenbergMarquardtSettings()


class _Reduced(eqx.Module):
    """The linearised problem at the last accepted point, with columns of length one.

    Attributes:
        triangles: R of [J | error] of each run: its start, θ, the error.
        start_lengths, shared: lengths of the columns of starts and of θ (over all runs).
        theta: there. room: how far it may go down and up.
        predicted_reduction: share of the cost that a step without damping would take away.
        cost: there. poor: accepted steps in a row that lowered it by next to nothing.
        widest: largest trust region so far.
    """

    triangles: Float[Array, "runs size size"]
    start_lengths: Float[Host, "runs unknowns"]
    shared: Float[Host, " free"]
    theta: Float[Host, " free"]
    room: Float[Array, "2 free"]
    predicted_reduction: Scalar
    cost: Scalar
    poor: Int[Array, ""]
    widest: Scalar


class _Arrow(optx.AbstractDescent):
    """Damped least squares (Marquardt's scaling), starts eliminated run by run, bounds kept.

    Marquardt's steps are the same on any scale of a parameter; what they move is not. Parameters
    that multiply a divisor are damped as the products that they are (`step_scales.py`): as the
    divisor grows, its own column and theirs become one.
    """

    lower: Float[Host, " free"]
    upper: Float[Host, " free"]
    faintest: Float[Host, " states"]
    scored: Scalar
    scales: Scales

    def init(self, y: Unknowns, f_info_struct: Any) -> _Reduced:
        """Anything of the right shape."""
        del f_info_struct
        runs, start_size = y.starts.shape
        size = start_size + len(y.theta) + 1
        unit = jnp.ones((), y.theta.dtype)
        return _Reduced(
            jnp.zeros((runs, size, size), y.theta.dtype), y.starts, y.theta, y.theta,
            jnp.stack([y.theta, y.theta]), unit, jnp.inf * unit, jnp.asarray(0), unit,
        )  # fmt: skip

    def query(self, y: Unknowns, f_info: Any, state: _Reduced) -> _Reduced:
        """Linearise at an accepted point."""
        start_size = y.starts.shape[1]
        columns, error = _columns(f_info.jac, y), f_info.residual
        # On its bound, and the cost falls beyond it: not a direction to go.
        slope = jnp.einsum("iru,ir->u", columns[..., start_size:], error)
        stuck = ((y.theta <= self.lower) & (slope > 0)) | ((y.theta >= self.upper) & (slope < 0))
        columns = columns.at[..., start_size:].multiply(jnp.where(stuck, 0.0, 1.0))
        if not self.scales.trivial:
            products = coordinates(y.theta, self.scales, jnp)
            columns = columns.at[..., start_size:].set(columns[..., start_size:] @ products)
        power = jnp.sum(columns**2, axis=1)
        faintest = jnp.pad(self.faintest, (0, start_size - len(self.faintest)))
        traced = power[:, :start_size] > faintest**2
        columns = columns.at[..., :start_size].multiply(traced[:, None, :])
        lengths = (
            _length(jnp.where(traced, power[:, :start_size], 0.0)),
            _length(jnp.sum(power[:, start_size:], axis=0)),
        )
        scale = jnp.concatenate(
            [lengths[0], jnp.broadcast_to(lengths[1], (len(error), len(y.theta)))], axis=1
        )
        stacked = jnp.concatenate([columns / scale[:, None, :], error[..., None]], axis=-1)
        triangles = jnp.linalg.qr(stacked, mode="r")
        room = jnp.stack([self.lower - y.theta, self.upper - y.theta])
        damping = jnp.asarray(_SETTINGS.min_damping, error.dtype)
        _, remaining_cost = _shared_step(
            _damped(triangles, start_size, damping), start_size, damping
        )
        cost = jnp.sum(error**2)
        floor = _SETTINGS.cost_floor * self.scored
        predicted_reduction = (cost - remaining_cost) / jnp.maximum(cost, floor)
        lowered = 1.0 - cost / state.cost  # one at the very start
        poor = lowered < _SETTINGS.poor_reduction
        poor &= lowered < _SETTINGS.poor_ratio * state.predicted_reduction
        count = jnp.where(poor, state.poor + 1, 0)
        return _Reduced(
            triangles, *lengths, y.theta, room, predicted_reduction, cost, count, state.widest
        )

    def step(self, step_size: Scalar, state: _Reduced) -> tuple[Unknowns, optx.RESULTS]:
        """The step of damping inverse to `step_size`."""
        damping = _SETTINGS.initial_damping / step_size
        start_size = state.start_lengths.shape[1]
        rows = _damped(state.triangles, start_size, damping)
        theta, _ = _shared_step(rows, start_size, damping)
        theta = theta / state.shared
        if not self.scales.trivial:
            products = coordinates(state.theta, self.scales, jnp)
            theta = shortened(state.theta, products @ theta, self.scales, jnp)
            theta = scaled_step(state.theta, theta, self.scales, jnp)
        theta = linear = jnp.clip(theta, state.room[0], state.room[1])
        if not self.scales.trivial:
            linear = linear_step(state.theta, theta, self.scales, jnp)
            linear = jnp.linalg.solve(products, linear)
        starts = _own_steps(rows[:, :start_size], linear * state.shared) / state.start_lengths
        return Unknowns(theta, starts), optx.RESULTS.successful


def _length(power: Array) -> Array:
    """Of columns with these sums of squares; one for columns of zeros."""
    return jnp.sqrt(jnp.where(power > 0, power, 1.0))


def _damped(triangles: Array, start_size: int, damping: Scalar) -> Array:
    """R of each run with damping rows on its start."""
    rows = jnp.sqrt(damping) * jnp.eye(start_size, triangles.shape[-1], dtype=triangles.dtype)
    rows = jnp.broadcast_to(rows, (len(triangles), *rows.shape))
    return jnp.linalg.qr(jnp.concatenate([triangles, rows], axis=1), mode="r")


def _shared_step(damped: Array, start_size: int, damping: Scalar) -> tuple[Array, Scalar]:
    """Step of scaled θ over what the starts of the runs leave, and the cost that is then left."""
    corners = damped[:, start_size:, start_size:]
    size = corners.shape[-1] - 1
    rows = jnp.sqrt(damping) * jnp.eye(size, size + 1, dtype=corners.dtype)
    triangle = jnp.linalg.qr(jnp.concatenate([corners.reshape(-1, size + 1), rows]), mode="r")
    step = jax.scipy.linalg.solve_triangular(triangle[:size, :size], -triangle[:size, size])
    return step, triangle[size, size] ** 2


def _own_steps(rows: Array, theta: Array) -> Array:
    """Steps of the scaled starts, given that of scaled θ."""
    start_size = rows.shape[1]
    rhs = rows[..., start_size:-1] @ theta + rows[..., -1]
    return jax.vmap(jax.scipy.linalg.solve_triangular)(rows[..., :start_size], -rhs)


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """Optimistix's Levenberg-Marquardt, ended by what a step promises, not by its length."""

    rtol: float
    atol: float
    norm: Callable[[Any], Scalar]
    descent: _Arrow
    search: optx.ClassicalTrustRegion
    verbose: Callable[..., None]
    max_steps: Int[Host, ""]
    watch: Watch | None
    patient: bool

    def step(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Any, Any, Any]:
        """One step; to the patient none is poor that leaves the trust region wider than ever.

        Along a narrow valley the first damping allows next to no progress, and the region must
        widen by orders of magnitude before there is any. Of many searches side by side most are
        lost anyway, and all would wait for them.
        """
        y, new, aux = super().step(fn, y, args, options, state, tags)
        if not self.patient:
            return y, new, aux
        reduced, size = new.descent_state, new.search_state.step_size
        poor = jnp.where(size > reduced.widest, 0, reduced.poor)
        widest = jnp.maximum(size, reduced.widest)
        reduced = replace(reduced, poor=poor, widest=widest)
        return y, eqx.tree_at(lambda state: state.descent_state, new, reduced), aux

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        """Whether the cost is at its floor, no step lowers it to speak of, or time is up."""
        del fn, y, args, options, tags
        if self.watch is not None:
            half_cost = 0.5 * jnp.sum(state.f_info.residual**2)
            jax.debug.callback(self.watch, state.num_steps, half_cost)
        converged = state.descent_state.predicted_reduction < CONVERGED
        end = converged | _lost(state) | (state.num_steps >= self.max_steps)
        return ~state.first_step & end, state.result


def _lost(state: Any) -> Array:
    short = state.search_state.step_size < _SETTINGS.min_step
    return short | (state.descent_state.poor >= _SETTINGS.max_poor_steps)


def solve(
    problem: Problem,
    unknowns: Unknowns,
    sensitivities: Float[np.ndarray, "runs time ny size"],
    max_steps: int,
    watch: Watch | None = None,
) -> tuple[Outcome, Float[np.ndarray, "runs time ny size"]]:
    """Levenberg-Marquardt from `unknowns`, compiled once for each plant and shape of the runs.

    Where it converges a full step follows. `CONVERGED` of the cost is little, but of N samples
    up to √(10⁻⁶ N) standard errors, far along a narrow valley; and the signals there are wanted
    anyway.

    Args:
        problem: the runs.
        unknowns: to start from.
        sensitivities: `signals` there, so that they need not be simulated again.
        max_steps: at most.
        watch: called with the number of steps done, from 0, and half of the cost; compiled in.

    Returns:
        Where it ended, and the signals there.
    """
    start = replace(problem, start_sums=(unknowns, _sums(sensitivities, problem)))
    with lent(problem) as number:
        runs, begun = start, unknowns
        if problem.compiled:
            spare = -len(unknowns.theta) % _SETTINGS.grain
            runs, begun = HostRuns.of(start, number).widened(spare), unknowns.widened(spare)
        outcome = jax.block_until_ready(_solve(runs, begun, np.asarray(max_steps), watch))
    outcome = outcome.narrowed(len(unknowns.theta))
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
    if problem.compiled:  # here: no program can be traced while the solver runs
        problem = replace(problem, engine=compiled_runs.used(problem.kernel, len(unknowns.theta)))
    with lent(problem) as number:
        runs = HostRuns.of(problem, number) if problem.compiled else problem
        return jax.block_until_ready(_solve_many(runs, unknowns, np.asarray(max_steps)))


@jit(static=())
def _solve_many(
    problem: Problem | HostRuns, unknowns: Unknowns, max_steps: Int[Host, ""]
) -> Outcome:
    return jax.vmap(lambda lane: _search(problem, lane, max_steps, None, patient=False))(unknowns)


@jit(static=("watch",))
def _solve(
    problem: Problem | HostRuns, unknowns: Unknowns, max_steps: Int[Host, ""], watch: Watch | None
) -> Outcome:
    return _search(problem, unknowns, max_steps, watch, patient=True)


def _search(
    problem: Problem | HostRuns,
    unknowns: Unknowns,
    max_steps: Int[Host, ""],
    watch: Watch | None,
    patient: bool,
) -> Outcome:
    solver = _LevenbergMarquardt(
        0.0, 0.0, optx.max_norm,
        _Arrow(
            problem.lower, problem.upper, problem.faintest, scored_values(problem), problem.scales
        ),
        optx.ClassicalTrustRegion(high_cutoff=_SETTINGS.widening), lambda **_: None,
        max_steps, watch, patient,
    )  # fmt: skip
    solution = optx.least_squares(errors, solver, unknowns, problem, max_steps=None, throw=False)
    steps = solution.stats["num_steps"]
    full_step = jnp.asarray(_SETTINGS.initial_damping / _SETTINGS.min_damping)
    full, _ = solver.descent.step(full_step, solution.state.descent_state)
    return Outcome(
        solution.value,
        jax.tree.map(jnp.add, solution.value, full),
        jnp.sum(solution.state.f_info.residual**2),
        solution.state.descent_state.predicted_reduction,
        steps,
        (steps >= max_steps) & ~_lost(solution.state),
    )


def _columns(jacobian: Any, unknowns: Unknowns) -> Float[Array, "runs rows unknowns"]:
    """Columns of the Jacobian of each run with its own unknowns, starts first."""
    columns = jax.vmap(lambda vector: jacobian.mv(_direction(unknowns, vector)))(
        _unit_directions(unknowns)
    )
    return jnp.moveaxis(columns, 0, -1)


def _unit_directions(unknowns: Unknowns) -> Float[Array, "unknowns unknowns"]:
    """Directions along each unknown of a run alone, start first."""
    return jnp.eye(unknowns.starts.shape[1] + len(unknowns.theta), dtype=unknowns.theta.dtype)


def _direction(unknowns: Unknowns, vector: Float[Array, " unknowns"]) -> Unknowns:
    """A direction of one run's unknowns, start first, in all runs at once: none sees another."""
    start_size = unknowns.starts.shape[1]
    return Unknowns(
        vector[start_size:], jnp.broadcast_to(vector[:start_size], unknowns.starts.shape)
    )
