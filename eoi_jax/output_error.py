r"""Least squares of free runs over parameters and initial states: the kernel of `refine`.

Levenberg-Marquardt (optimistix; its first steps are all but Gauss-Newton) over forward-mode
sensitivities of the fixed-step simulation, in which dry friction sticks. A run depends on no other
run's initial state, so one sweep over all runs gives all columns of the Jacobian,
and the initial states are eliminated run by run: the matrix has the shape of an arrow, and QR of
the rows of each run leaves a small triangle (Å. Björck, *Numerical Methods for Least Squares
Problems*, section 6.3).
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from eoi_jax.data.record import Record
from eoi_jax.plants.plant import Plant, State
from eoi_jax.simulate import acted, behind, drive
from eoi_jax.trajectory import Drive, frictional, trajectory
from eoi_jax.types import Scalar, Theta
from eoi_jax.validate import _initial_states, _Run, _unpack

_HEAD = 50  # samples of each run from which its initial state is guessed
_LEAST = 8  # steps of a run, at least
_DAMPING = 1e-2  # of the first step, relative to the squared length of each column
PROMISE = 1e-6  # share of the cost below which a step is not worth taking
_FLOOR = 1e-18  # mean square of weighed errors below which cost is rounding, divided by PROMISE
_SHORTEST_STEP = 1e-4  # of the trust region, relative to the first


# -- runs -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Span:
    """One run: samples `first` to `first + count` of a record, and which of them it scores."""

    record: int
    first: int
    count: int
    use: Bool[np.ndarray, " time"]


def spans_of(records: Sequence[Record], window: float | None) -> list[Span]:
    """Records cut into runs of about `window` seconds, of equal length within a record."""
    spans = []
    for i, record in enumerate(records):
        length = (len(record) - 1) * record.sample_period
        pieces = 1 if window is None else max(round(length / window), 1)
        pieces = min(pieces, max((len(record) - 1) // _LEAST, 1))
        edges = np.round(np.linspace(0, len(record) - 1, pieces + 1)).astype(int)
        scored = record.valid.copy()
        scored[: round(record.burn_in / record.sample_period)] = False
        for first, last in itertools.pairwise(edges):
            use = scored[first : last + 1].copy()
            use[-1] &= last == edges[-1]  # else it is the first one of the next run
            spans.append(Span(i, int(first), int(last - first), use))
    return spans


class Unknowns(eqx.Module):
    """Free parameters, and the initial state of each run (outputs and derivatives, then z)."""

    theta: Float[Array, " free"]
    starts: Float[Array, "runs unknowns"]


class Problem(eqx.Module):
    """All runs side by side, padded to one length; padding and what is not scored weigh nothing.

    Attributes:
        theta: all parameters; those of `free` are replaced.
        drives: what drives each run; its inputs are those before any actuator.
        whole: of a plant with actuators, what drives each record: behind them its inputs change
            with θ, and with all that came before a run. rows: steps of these, one after the other,
            that each run takes.
        declared: whether the run starts a record, where internal states are the plant's own.
        weight: 1/σ of each output where scored, else 0.
    """

    plant: Plant
    theta: Theta
    drives: Drive
    whole: tuple[Drive, ...]
    rows: Int[Array, "runs steps"]
    declared: Bool[Array, " runs"]
    y: Float[Array, "runs time ny"]
    weight: Float[Array, "runs time ny"]
    lower: Float[Array, " free"]
    upper: Float[Array, " free"]
    friction: tuple[bool, ...] = eqx.field(static=True)
    free: tuple[int, ...] = eqx.field(static=True)


def problem_of(
    plant: Plant, records: Sequence[Record], spans: Sequence[Span], substeps: int
) -> Problem:
    """The least squares of these runs, with the outputs weighed by their spread."""
    longest = max(span.count for span in spans)
    y, use = (np.zeros((len(spans), longest + 1, len(plant.outputs))) for _ in range(2))
    for i, span in enumerate(spans):
        part = slice(span.first, span.first + span.count + 1)
        y[i, : span.count + 1] = records[span.record].outputs[part]
        use[i, : span.count + 1] = span.use[:, None]
    # σ of the first fit: the spread of each output, for want of a residual.
    count = np.sum(use, axis=(0, 1))
    mean = np.sum(use * y, axis=(0, 1)) / count
    spread = np.sqrt(np.sum(use * (y - mean) ** 2, axis=(0, 1)) / count)
    free = np.flatnonzero(plant.free)
    whole = _whole(records, substeps)
    return Problem(
        plant,
        jnp.asarray(plant.theta),
        _drives(whole, spans, longest),
        () if plant.actuator is None else tuple(jax.tree.map(jnp.asarray, whole)),
        jnp.asarray(_rows(whole, spans, longest)),
        jnp.asarray([span.first == 0 for span in spans]),
        jnp.asarray(y),
        jnp.asarray(use / np.where(spread > 0, spread, 1.0)),
        jnp.asarray(np.asarray(plant.lower)[free]),
        jnp.asarray(np.asarray(plant.upper)[free]),
        frictional(plant),
        tuple(free.tolist()),
    )


def _whole(records: Sequence[Record], substeps: int) -> list[Drive]:
    return [drive(one.time, one.inputs, one.hold, substeps) for one in records]


def _rows(
    whole: Sequence[Drive], spans: Sequence[Span], count: int
) -> Int[np.ndarray, "runs steps"]:
    """Steps of each run among those of all records; beyond the end of a record its last one."""
    ends, rows = np.cumsum([len(one.time) for one in whole]), []
    for span in spans:
        n, length = whole[span.record].substeps, len(whole[span.record].time)
        index = n * span.first + np.arange(n * count)
        rows.append(ends[span.record] - length + np.minimum(index, length - 1))
    return np.stack(rows)


def _drives(whole: Sequence[Drive], spans: Sequence[Span], count: int) -> Drive:
    """What drives each run, runs first; beyond the end of a record its last step, held."""
    step = np.stack([np.asarray(whole[span.record].step) for span in spans])
    begin = np.stack([whole[one.record].time[one.first * whole[0].substeps] for one in spans])
    time = begin[:, None] + step[:, None] * np.arange(whole[0].substeps * count)
    inputs = np.concatenate([one.inputs for one in whole])[_rows(whole, spans, count)]
    return Drive(jnp.asarray(time), jnp.asarray(step), jnp.asarray(inputs), whole[0].substeps)


def guessed_starts(
    problem: Problem, records: Sequence[Record], spans: Sequence[Span], substeps: int
) -> Float[np.ndarray, "runs unknowns"]:
    """Initial states fitted to the first samples of each run, at the starting parameters."""
    count = min([_HEAD, *(span.count for span in spans)])
    run = _Run(problem.plant, problem.friction, count, substeps)
    whole = [acted(problem.plant, one) for one in _whole(records, substeps)]
    heads = _drives(whole, spans, count - 1)
    y = np.asarray(problem.y[:, :count])
    valid = np.stack([records[one.record].valid[one.first : one.first + count] for one in spans])
    with np.errstate(invalid="ignore"):  # a start that diverges is found out by the first fit
        return _initial_states(run, problem.theta, heads, y, valid)


# -- residuals and their Jacobian -------------------------------------------------------------


def start_of(plant: Plant, theta: Theta, values: Array, declared: Array) -> State:
    """Initial state from its unknowns; internal states by the plant where it declares them."""
    start = _unpack(plant, values)
    own = plant.internal_start(theta)
    return eqx.tree_at(lambda x: x.z, start, jnp.where(declared, own, start.z))


@eqx.filter_custom_jvp
def errors(unknowns: Unknowns, problem: Problem) -> Float[Array, "runs rows"]:
    """Weighed errors of all runs, zero where not scored."""
    return _errors(unknowns, problem)


def _errors(unknowns: Unknowns, problem: Problem) -> Float[Array, "runs rows"]:
    theta = problem.theta.at[np.asarray(problem.free)].set(unknowns.theta)

    def one(run: Any) -> Float[Array, " rows"]:
        driven_by, y, weight, declared, values = run
        start = start_of(problem.plant, theta, values, declared)
        y_hat = trajectory(problem.plant, theta, driven_by, start, problem.friction)[0][:, 0, :]
        return jnp.where(weight > 0, weight * (y - y_hat), 0.0).ravel()

    drives = _acted(problem, theta)
    runs = (drives, problem.y, problem.weight, problem.declared, unknowns.starts)
    if any(problem.friction):  # one after the other: then only the steps with a stop pay for it
        return jax.lax.map(one, runs)
    return jax.vmap(one)(runs)


def _acted(problem: Problem, theta: Theta) -> Drive:
    """What drives the runs behind the actuators: cut from whole records, as a function of θ."""
    if problem.plant.actuator is None:
        return problem.drives
    inputs = jnp.concatenate([behind(problem.plant, theta, one) for one in problem.whole])
    return eqx.tree_at(lambda drives: drives.inputs, problem.drives, inputs[problem.rows])


def linearised(
    unknowns: Unknowns, problem: Problem
) -> tuple[Float[Array, "runs rows"], Float[Array, "unknowns runs rows"]]:
    """Weighed errors, and their derivatives with the unknowns of each run, its start first."""

    def along(direction: Unknowns) -> tuple[Array, Array]:
        return jax.jvp(lambda at: _errors(at, problem), (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, 0))(_directions(unknowns))


def _directions(unknowns: Unknowns) -> Unknowns:
    """Each unknown by itself, starts first: those of all runs at once, which share no errors."""
    runs, own = unknowns.starts.shape
    eye = jnp.eye(own + len(unknowns.theta), dtype=unknowns.theta.dtype)
    starts = jnp.broadcast_to(eye[:, None, :own], (len(eye), runs, own))
    return Unknowns(eye[:, own:], starts)


@errors.def_jvp
def _jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """The whole Jacobian in one sweep; then products with it cost next to nothing."""
    unknowns, problem = primals
    moved, _ = tangents
    error, jacobian = linearised(unknowns, problem)
    own = unknowns.starts.shape[1]
    along = jnp.einsum("uir,iu->ir", jacobian[:own], moved.starts)
    return error, along + jnp.einsum("uir,u->ir", jacobian[own:], moved.theta)


def _columns(jacobian: Any, unknowns: Unknowns) -> Float[Array, "runs rows unknowns"]:
    """Columns of the Jacobian of each run with its own unknowns, starts first."""
    return jnp.moveaxis(jax.vmap(jacobian.mv)(_directions(unknowns)), 0, -1)


# -- the solver -------------------------------------------------------------------------------


class _Reduced(eqx.Module):
    """The linearised problem at the last accepted point, with columns of length one.

    Attributes:
        triangles: R of [J | error] of each run: its start, θ, the error.
        own, shared: lengths of the columns of starts and of θ (over all runs).
        room: how far θ may go down and up.
        promise: share of the cost that a step without damping would take away.
    """

    triangles: Float[Array, "runs size size"]
    own: Float[Array, "runs unknowns"]
    shared: Float[Array, " free"]
    room: Float[Array, "2 free"]
    promise: Scalar


class _Arrow(optx.AbstractDescent):
    """Damped least squares (Marquardt's scaling), starts eliminated run by run, bounds kept."""

    lower: Float[Array, " free"]
    upper: Float[Array, " free"]

    def init(self, y: Unknowns, f_info_struct: Any) -> _Reduced:
        """Anything of the right shape."""
        del f_info_struct
        runs, own = y.starts.shape
        size = own + len(y.theta) + 1
        one = jnp.ones((), y.theta.dtype)
        return _Reduced(
            jnp.zeros((runs, size, size), y.theta.dtype), y.starts, y.theta,
            jnp.stack([y.theta, y.theta]), one,
        )  # fmt: skip

    def query(self, y: Unknowns, f_info: Any, state: _Reduced) -> _Reduced:
        """Linearise at an accepted point."""
        del state
        own = y.starts.shape[1]
        columns, error = _columns(f_info.jac, y), f_info.residual
        # On its bound, and the cost falls beyond it: not a direction to go.
        slope = jnp.einsum("iru,ir->u", columns[..., own:], error)
        stuck = ((y.theta <= self.lower) & (slope > 0)) | ((y.theta >= self.upper) & (slope < 0))
        columns = columns.at[..., own:].multiply(jnp.where(stuck, 0.0, 1.0))
        power = jnp.sum(columns**2, axis=1)
        lengths = _length(power[:, :own]), _length(jnp.sum(power[:, own:], axis=0))
        scale = jnp.concatenate(
            [lengths[0], jnp.broadcast_to(lengths[1], (len(error), len(y.theta)))], axis=1
        )
        stacked = jnp.concatenate([columns / scale[:, None, :], error[..., None]], axis=-1)
        triangles = jnp.linalg.qr(stacked, mode="r")
        room = jnp.stack([self.lower - y.theta, self.upper - y.theta])
        _, left = _shared_step(triangles, own, jnp.asarray(1e-12, error.dtype))
        cost = jnp.sum(error**2)
        promise = (cost - left) / jnp.maximum(cost, _FLOOR * error.size)
        return _Reduced(triangles, *lengths, room, promise)

    def step(self, step_size: Scalar, state: _Reduced) -> tuple[Unknowns, optx.RESULTS]:
        """The step of damping inverse to `step_size`."""
        damping, own = _DAMPING / step_size, state.own.shape[1]
        theta, _ = _shared_step(state.triangles, own, damping)
        theta = jnp.clip(theta / state.shared, state.room[0], state.room[1])
        starts = _own_steps(state.triangles, own, damping, theta * state.shared) / state.own
        return Unknowns(theta, starts), optx.RESULTS.successful


def _length(power: Array) -> Array:
    return jnp.where(power > 0, jnp.sqrt(jnp.where(power > 0, power, 1.0)), 1.0)


def _damped(triangles: Array, own: int, damping: Scalar) -> Array:
    """R of each run with damping rows on its start."""
    rows = jnp.sqrt(damping) * jnp.eye(own, triangles.shape[-1], dtype=triangles.dtype)
    rows = jnp.broadcast_to(rows, (len(triangles), *rows.shape))
    return jnp.linalg.qr(jnp.concatenate([triangles, rows], axis=1), mode="r")


def _shared_step(triangles: Array, own: int, damping: Scalar) -> tuple[Array, Scalar]:
    """Step of scaled θ over what the starts of the runs leave, and the cost that is then left."""
    left = _damped(triangles, own, damping)[:, own:, own:]
    size = left.shape[-1] - 1
    rows = jnp.sqrt(damping) * jnp.eye(size, size + 1, dtype=left.dtype)
    whole = jnp.linalg.qr(jnp.concatenate([left.reshape(-1, size + 1), rows]), mode="r")
    step = jax.scipy.linalg.solve_triangular(whole[:size, :size], -whole[:size, size])
    return step, whole[size, size] ** 2


def _own_steps(triangles: Array, own: int, damping: Scalar, theta: Array) -> Array:
    """Steps of the scaled starts, given that of scaled θ."""
    rows = _damped(triangles, own, damping)[:, :own]
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

    def terminate(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Array, optx.RESULTS]:
        """Whether the cost is at its floor, or no step, however short, lowers it."""
        del fn, y, args, options, tags
        done = state.descent_state.promise < PROMISE
        lost = state.search_state.step_size < _SHORTEST_STEP
        return ~state.first_step & (done | lost), state.result


class Outcome(eqx.Module):
    """Where the solver ended.

    Attributes:
        unknowns: the best ones.
        error: weighed errors there. before: at the start.
        columns: derivatives of `error` with the unknowns of each run, its start first.
        promise: share of the cost that least squares still promises to take away.
        steps: simulations with sensitivities. exhausted: whether there were too few.
    """

    unknowns: Unknowns
    error: Float[Array, "runs rows"]
    columns: Float[Array, "runs rows unknowns"]
    before: Float[Array, "runs rows"]
    promise: Scalar
    steps: Array
    exhausted: Bool[Array, ""]


@eqx.filter_jit
def solve(problem: Problem, unknowns: Unknowns, max_steps: int) -> Outcome:
    """Levenberg-Marquardt from `unknowns`, compiled once for each plant and shape of the runs."""
    solver = _LevenbergMarquardt(
        0.0, 0.0, optx.max_norm, _Arrow(problem.lower, problem.upper),
        optx.ClassicalTrustRegion(high_cutoff=0.75), lambda **_: None,
    )  # fmt: skip
    found = optx.least_squares(errors, solver, unknowns, problem, max_steps=max_steps, throw=False)
    info = found.state.f_info
    return Outcome(
        found.value,
        info.residual,
        _columns(info.jac, found.value),
        errors(unknowns, problem),
        found.state.descent_state.promise,
        found.stats["num_steps"],
        found.result == optx.RESULTS.nonlinear_max_steps_reached,
    )
