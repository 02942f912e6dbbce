r"""Levenberg-Marquardt for many runs that share parameters and start each on its own.

Optimistix's solver; its first steps are all but Gauss-Newton. Each run is given by a small square
root of its normal equations. The Jacobian has the shape of an arrow: the initial states are
eliminated run by run, for QR of the rows of each run leaves a small triangle (Å. Björck,
*Numerical Methods for Least Squares Problems*, section 6.3).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, Int

from eoi_jax._types import Scalar
from eoi_jax.compiler.programs import jit
from eoi_jax.refinement.problem import (
    PROMISE,
    Outcome,
    Problem,
    Unknowns,
    direction,
    each,
    errors,
    signals,
)
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.sensitivity import Host, added_up

_DAMPING = 1e-2  # of the first step, relative to the squared length of each column
_FLOOR = 1e-18  # mean square of weighed errors below which cost is rounding, divided by PROMISE
_SHORTEST_STEP = 1e-4  # of the trust region, relative to the first
_LEAST_DAMPING = 1e-12  # of a full step: enough for what leaves no trace
# Kinks of dry friction: steps keep being taken that lower the cost by next to nothing, and by
# little of what they promise. So many in a row end the search.
_POOR, _LITTLE, _MOST_POOR = 3e-4, 0.1, 3


Watch = Callable[[Any, Any], None]


class _Reduced(eqx.Module):
    """The linearised problem at the last accepted point, with columns of length one.

    Attributes:
        triangles: R of [J | error] of each run: its start, θ, the error.
        own, shared: lengths of the columns of starts and of θ (over all runs).
        room: how far θ may go down and up.
        promise: share of the cost that a step without damping would take away.
        cost: there. poor: accepted steps in a row that lowered it by next to nothing.
        widest: largest trust region so far.
    """

    triangles: Float[Array, "runs size size"]
    own: Float[Host, "runs unknowns"]
    shared: Float[Host, " free"]
    room: Float[Array, "2 free"]
    promise: Scalar
    cost: Scalar
    poor: Int[Array, ""]
    widest: Scalar


class _Arrow(optx.AbstractDescent):
    """Damped least squares (Marquardt's scaling), starts eliminated run by run, bounds kept."""

    lower: Float[Host, " free"]
    upper: Float[Host, " free"]
    faintest: Float[Host, " states"]
    scored: Scalar

    def init(self, y: Unknowns, f_info_struct: Any) -> _Reduced:
        """Anything of the right shape."""
        del f_info_struct
        runs, own = y.starts.shape
        size = own + len(y.theta) + 1
        one = jnp.ones((), y.theta.dtype)
        return _Reduced(
            jnp.zeros((runs, size, size), y.theta.dtype), y.starts, y.theta,
            jnp.stack([y.theta, y.theta]), one, jnp.inf * one, jnp.asarray(0), one,
        )  # fmt: skip

    def query(self, y: Unknowns, f_info: Any, state: _Reduced) -> _Reduced:
        """Linearise at an accepted point."""
        own = y.starts.shape[1]
        columns, error = _columns(f_info.jac, y), f_info.residual
        # On its bound, and the cost falls beyond it: not a direction to go.
        slope = jnp.einsum("iru,ir->u", columns[..., own:], error)
        stuck = ((y.theta <= self.lower) & (slope > 0)) | ((y.theta >= self.upper) & (slope < 0))
        columns = columns.at[..., own:].multiply(jnp.where(stuck, 0.0, 1.0))
        power = jnp.sum(columns**2, axis=1)
        faintest = jnp.pad(self.faintest, (0, own - len(self.faintest)))
        seen = power[:, :own] > faintest**2
        columns = columns.at[..., :own].multiply(seen[:, None, :])
        lengths = (
            _length(jnp.where(seen, power[:, :own], 0.0)),
            _length(jnp.sum(power[:, own:], axis=0)),
        )
        scale = jnp.concatenate(
            [lengths[0], jnp.broadcast_to(lengths[1], (len(error), len(y.theta)))], axis=1
        )
        stacked = jnp.concatenate([columns / scale[:, None, :], error[..., None]], axis=-1)
        triangles = jnp.linalg.qr(stacked, mode="r")
        room = jnp.stack([self.lower - y.theta, self.upper - y.theta])
        least = jnp.asarray(_LEAST_DAMPING, error.dtype)
        _, left = _shared_step(_damped(triangles, own, least), own, least)
        cost = jnp.sum(error**2)
        promise = (cost - left) / jnp.maximum(cost, _FLOOR * self.scored)
        lowered = 1.0 - cost / state.cost  # one at the very start
        poor = (lowered < _POOR) & (lowered < _LITTLE * state.promise)
        count = jnp.where(poor, state.poor + 1, 0)
        return _Reduced(triangles, *lengths, room, promise, cost, count, state.widest)

    def step(self, step_size: Scalar, state: _Reduced) -> tuple[Unknowns, optx.RESULTS]:
        """The step of damping inverse to `step_size`."""
        damping, own = _DAMPING / step_size, state.own.shape[1]
        rows = _damped(state.triangles, own, damping)
        theta, _ = _shared_step(rows, own, damping)
        theta = jnp.clip(theta / state.shared, state.room[0], state.room[1])
        starts = _own_steps(rows[:, :own], theta * state.shared) / state.own
        return Unknowns(theta, starts), optx.RESULTS.successful


def _length(power: Array) -> Array:
    """Of columns with these sums of squares; one for columns of zeros."""
    return jnp.sqrt(jnp.where(power > 0, power, 1.0))


def _damped(triangles: Array, own: int, damping: Scalar) -> Array:
    """R of each run with damping rows on its start."""
    rows = jnp.sqrt(damping) * jnp.eye(own, triangles.shape[-1], dtype=triangles.dtype)
    rows = jnp.broadcast_to(rows, (len(triangles), *rows.shape))
    return jnp.linalg.qr(jnp.concatenate([triangles, rows], axis=1), mode="r")


def _shared_step(damped: Array, own: int, damping: Scalar) -> tuple[Array, Scalar]:
    """Step of scaled θ over what the starts of the runs leave, and the cost that is then left."""
    left = damped[:, own:, own:]
    size = left.shape[-1] - 1
    rows = jnp.sqrt(damping) * jnp.eye(size, size + 1, dtype=left.dtype)
    whole = jnp.linalg.qr(jnp.concatenate([left.reshape(-1, size + 1), rows]), mode="r")
    step = jax.scipy.linalg.solve_triangular(whole[:size, :size], -whole[:size, size])
    return step, whole[size, size] ** 2


def _own_steps(rows: Array, theta: Array) -> Array:
    """Steps of the scaled starts, given that of scaled θ."""
    own = rows.shape[1]
    rhs = rows[..., own:-1] @ theta + rows[..., -1]
    return jax.vmap(jax.scipy.linalg.solve_triangular)(rows[..., :own], -rhs)


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """Optimistix's Levenberg-Marquardt, ended by what a step promises, not by its length."""

    rtol: float
    atol: float
    norm: Callable[[Any], Scalar]
    descent: _Arrow
    search: optx.ClassicalTrustRegion
    verbose: Callable[..., None]
    most: Int[Host, ""]
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
        return y, eqx.tree_at(lambda one: one.descent_state, new, reduced), aux

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        """Whether the cost is at its floor, no step lowers it to speak of, or time is up."""
        del fn, y, args, options, tags
        if self.watch is not None:
            half = 0.5 * jnp.sum(state.f_info.residual**2)
            jax.debug.callback(self.watch, state.num_steps, half)
        done = state.descent_state.promise < PROMISE
        end = done | _lost(state) | (state.num_steps >= self.most)
        return ~state.first_step & end, state.result


def _lost(state: Any) -> Array:
    short = state.search_state.step_size < _SHORTEST_STEP
    return short | (state.descent_state.poor >= _MOST_POOR)


def solve(
    problem: Problem,
    unknowns: Unknowns,
    shown: Float[np.ndarray, "runs time ny size"],
    max_steps: int,
    watch: Watch | None = None,
) -> tuple[Outcome, Float[np.ndarray, "runs time ny size"]]:
    """Levenberg-Marquardt from `unknowns`, compiled once for each plant and shape of the runs.

    Where it converges a full step follows. `PROMISE` of the cost is little, but of N samples up to
    √(10⁻⁶ N) standard errors, far along a narrow valley; and the signals there are wanted anyway.

    Args:
        problem: the runs.
        unknowns: to start from.
        shown: the signals there, so that they need not be simulated again.
        max_steps: at most.
        watch: called with the number of steps done, from 0, and half of the cost; compiled in.

    Returns:
        Where it ended, and the signals there.
    """
    start = replace(problem, known=(unknowns, _sums(shown, problem)))
    found = _solve(start, unknowns, np.asarray(max_steps), watch)
    if float(found.promise) < PROMISE:
        further = signals(found.further, problem)
        cost = np.sum(_sums(further, problem)[:, -1, -1])
        if cost <= float(found.cost):
            return replace(found, unknowns=found.further, cost=np.asarray(cost)), further
    return found, signals(found.unknowns, problem)


def _sums(shown: np.ndarray, problem: Problem) -> Float[np.ndarray, "runs size size"]:
    rows = shown.reshape(len(shown), -1, shown.shape[-1])
    return added_up(rows, float(problem.threshold))


def solve_many(problem: Problem, unknowns: Unknowns, max_steps: int) -> Outcome:
    """The same from several points side by side (a leading axis), until the last one has ended."""
    if problem.compiled:  # here: no program can be traced while the solver runs
        problem = replace(problem, engine=compiled_runs.used(problem.kernel, len(unknowns.theta)))
    return _solve_many(problem, unknowns, np.asarray(max_steps))


@jit(static=())
def _solve_many(problem: Problem, unknowns: Unknowns, most: Int[Host, ""]) -> Outcome:
    return jax.vmap(lambda one: _search(problem, one, most, None, patient=False))(unknowns)


@jit(static=("watch",))
def _solve(
    problem: Problem, unknowns: Unknowns, most: Int[Host, ""], watch: Watch | None
) -> Outcome:
    return _search(problem, unknowns, most, watch, patient=True)


def _search(
    problem: Problem,
    unknowns: Unknowns,
    most: Int[Host, ""],
    watch: Watch | None,
    patient: bool,
) -> Outcome:
    solver = _LevenbergMarquardt(
        0.0, 0.0, optx.max_norm,
        _Arrow(problem.lower, problem.upper, problem.faintest, _scored(problem)),
        optx.ClassicalTrustRegion(high_cutoff=0.75), lambda **_: None, most, watch,
        patient,
    )  # fmt: skip
    found = optx.least_squares(errors, solver, unknowns, problem, max_steps=None, throw=False)
    steps = found.stats["num_steps"]
    full, _ = solver.descent.step(jnp.asarray(_DAMPING / _LEAST_DAMPING), found.state.descent_state)
    return Outcome(
        found.value,
        jax.tree.map(jnp.add, found.value, full),
        jnp.sum(found.state.f_info.residual**2),
        found.state.descent_state.promise,
        steps,
        (steps >= most) & ~_lost(found.state),
    )


def _scored(problem: Problem) -> Scalar:
    """How many values are scored."""
    return jnp.sum(problem.tables[..., -len(problem.scale) :])


def _columns(jacobian: Any, unknowns: Unknowns) -> Float[Array, "runs rows unknowns"]:
    """Columns of the Jacobian of each run with its own unknowns, starts first."""
    columns = jax.vmap(lambda along: jacobian.mv(direction(unknowns, along)))(each(unknowns))
    return jnp.moveaxis(columns, 0, -1)
