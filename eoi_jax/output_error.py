r"""Errors of free runs over parameters and initial states, and their derivatives.

The runs of `refine`: fixed-step simulations, in which dry friction sticks, with forward-mode
sensitivities. A run depends on no other run's initial state, so one sweep over all runs gives all
columns of the Jacobian. The least squares over them is in `levenberg_marquardt.py`.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax.data.record import Record
from eoi_jax.plants.plant import Plant, State
from eoi_jax.simulate import acted, behind, drive
from eoi_jax.trajectory import Drive, frictional, trajectory
from eoi_jax.types import Scalar, Theta
from eoi_jax.validate import Run, initial_states, unpacked

_HEAD = 50  # samples of each run from which its initial state is guessed
PROMISE = 1e-6  # share of the cost below which a step is not worth taking
_LEAST = 8  # steps of a run, at least


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
    run = Run(problem.plant, problem.friction, count, substeps)
    whole = [acted(problem.plant, one) for one in _whole(records, substeps)]
    heads = _drives(whole, spans, count - 1)
    y = np.asarray(problem.y[:, :count])
    valid = np.stack([records[one.record].valid[one.first : one.first + count] for one in spans])
    with np.errstate(invalid="ignore"):  # a start that diverges is found out by the first fit
        return initial_states(run, problem.theta, heads, y, valid)


# -- residuals and their Jacobian -------------------------------------------------------------


def start_of(plant: Plant, theta: Theta, values: Array, declared: Array) -> State:
    """Initial state from its unknowns; internal states by the plant where it declares them."""
    start = unpacked(plant, values)
    own = plant.internal_start(theta)
    return eqx.tree_at(lambda x: x.z, start, jnp.where(declared, own, start.z))


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


@eqx.filter_jit  # traced once, wherever a solver asks for it
def linearised(
    unknowns: Unknowns, problem: Problem
) -> tuple[Float[Array, "runs rows"], Float[Array, "unknowns runs rows"]]:
    """Weighed errors, and their derivatives with the unknowns of each run, its start first."""

    def slope(along: Array) -> tuple[Array, Array]:
        moved = direction(unknowns, along)
        return jax.jvp(lambda at: _errors(at, problem), (unknowns,), (moved,))

    return jax.vmap(slope, out_axes=(None, 0))(each(unknowns))


def each(unknowns: Unknowns) -> Float[Array, "unknowns unknowns"]:
    """Directions along each unknown of a run alone, start first."""
    return jnp.eye(unknowns.starts.shape[1] + len(unknowns.theta), dtype=unknowns.theta.dtype)


def direction(unknowns: Unknowns, along: Float[Array, " unknowns"]) -> Unknowns:
    """A direction of one run's unknowns, start first, in all runs at once: none sees another."""
    own = unknowns.starts.shape[1]
    return Unknowns(along[own:], jnp.broadcast_to(along[:own], unknowns.starts.shape))


@eqx.filter_custom_jvp
def errors(unknowns: Unknowns, problem: Problem) -> Float[Array, "runs rows"]:
    """Weighed errors of all runs, zero where not scored."""
    return _errors(unknowns, problem)


@errors.def_jvp
def _jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """The whole Jacobian in one sweep; then products with it cost next to nothing."""
    unknowns, problem = primals
    moved, _ = tangents
    error, jacobian = linearised(unknowns, problem)
    own = unknowns.starts.shape[1]
    along = jnp.einsum("uir,iu->ir", jacobian[:own], moved.starts)
    return error, along + jnp.einsum("uir,u->ir", jacobian[own:], moved.theta)


class Outcome(eqx.Module):
    """Where the solver ended.

    Attributes:
        unknowns: the best ones.
        error: weighed errors there.
        columns: derivatives of `error` with the unknowns of each run, its start first.
        promise: share of the cost that least squares still promises to take away.
        steps: simulations with sensitivities. exhausted: whether there were too few.
    """

    unknowns: Unknowns
    error: Float[Array, "runs rows"]
    columns: Float[Array, "runs rows unknowns"]
    promise: Scalar
    steps: Int[Array, ""]
    exhausted: Bool[Array, ""]
