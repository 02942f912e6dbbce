r"""Sums and signals of free runs: what least squares needs of a problem, and all derivatives.

One sweep over all runs gives the normal equations of all unknowns, and a small square root of these
for each run. Runs are machine code where that is possible, else scans.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.compiler.programs import jit
from eoi_jax.refinement.driven_inputs import DrivenInputs
from eoi_jax.refinement.problem import Problem, Unknowns, driven
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.compiled_runs import LaneCode
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.sensitivity import Host, RunKernel, RunLane, RunRow


def lane_code(problem: Problem, lanes: int, start_size: int) -> LaneCode | None:
    """Code of runs that are evaluated one lane at a time; None of others.

    Args:
        problem: the runs.
        lanes: how many.
        start_size: unknowns of the start of a run.
    """
    if problem.compiled and (lanes == 1 or problem.places is not None):
        return LaneCode.of(problem.kernel, start_size)
    return None


def sums(
    unknowns: Unknowns,
    problem: Problem,
    code: LaneCode | None = None,
    ended: Bool[np.ndarray, " lanes"] | None = None,
) -> Float[np.ndarray, "lanes runs size size"]:
    r"""$\sum w\,c\,c^\top$ of each run: start, then θ, then the error, all weighed.

    Args:
        unknowns: of one lane or several, a leading axis.
        problem: the runs.
        code: `lane_code`, where that is there already.
        ended: lanes whose sums are not needed; they are NaN where lanes run one at a time.
    """
    theta, starts = np.asarray(unknowns.theta), np.asarray(unknowns.starts)
    if not problem.compiled:
        theta = jnp.asarray(np.stack([problem.completed(values) for values in theta]))
        return np.asarray(_scanned_sums(problem, theta, jnp.asarray(starts)), float)
    if problem.places is None:
        return _summed(problem, code, theta, starts)
    lanes = np.arange(len(theta)) if ended is None else np.flatnonzero(~ended)
    parts = [_summed(problem, code, theta[i, None], starts[i, None])[0] for i in lanes]
    square = np.full((len(theta), *parts[0].shape), np.nan)
    square[lanes] = parts
    return square


def _summed(
    problem: Problem,
    code: LaneCode | None,
    free: Float[np.ndarray, "lanes free"],
    starts: np.ndarray,
) -> Float[np.ndarray, "lanes runs size size"]:
    """The sums of some lanes, which share what drives the plant."""
    theta = np.stack([problem.completed(values) for values in free])
    rows = host_rows(problem, theta[0], starts[0])
    shared = (
        np.asarray(part)[None] for part in (problem.declared, problem.scale, problem.threshold)
    )
    lanes = _lanes(theta, starts, *shared)
    return compiled_runs.summed(problem.kernel, lanes, *rows, problem.substeps, code)


def host_rows(
    problem: Problem, theta: np.ndarray, starts: np.ndarray
) -> tuple[Float[np.ndarray, "runs rows columns"], np.ndarray, np.ndarray]:
    """Rows, steps and counts of compiled runs; behind actuators as these parameters make them."""
    tables, steps, counts = map(np.asarray, (problem.tables, problem.steps, problem.counts))
    if problem.places is not None:
        tables = _acted_tables(problem.kernel, tables, driven(problem, theta, starts))
    return tables, steps, counts


def _acted_tables(
    kernel: RunKernel, tables: np.ndarray, driving: DrivenInputs
) -> Float[np.ndarray, "runs rows columns"]:
    """Rows of all runs with their inputs behind the actuators, and how these change."""
    nu, ny = len(kernel.plant.inputs), len(kernel.plant.outputs)
    _, inputs, _, use = compiled_runs.columns(nu, ny)
    sizes = [leaf[0, 0].size for leaf in (driving.slope, driving.past)]
    acted = np.empty((*tables.shape[:2], use.stop + sum(sizes)))
    acted[..., : use.stop] = tables
    acted[..., inputs] = np.reshape(driving.inputs, (*tables.shape[:2], 3 * nu))
    places = np.split(acted[..., use.stop :], sizes[:1], axis=-1)
    for place, leaf in zip(places, (driving.slope, driving.past), strict=True):
        place[...] = np.reshape(leaf, place.shape)
    return acted


def _lanes(
    theta: np.ndarray,
    starts: np.ndarray,
    declared: np.ndarray,
    scale: np.ndarray,
    threshold: np.ndarray,
) -> RunLane:
    """Leading axes (lanes, runs) on each part; given are (lanes,), or one if it is shared."""

    def spread(array: np.ndarray) -> np.ndarray:
        return np.broadcast_to(array, (*starts.shape[:2], *array.shape[2:]))

    return RunLane(
        spread(theta[:, None]),
        starts,
        spread(declared),
        spread(scale[:, None]),
        spread(threshold[:, None]),
    )


def _scanned(
    problem: Problem, theta: Array, starts: Host, store: str = "sums"
) -> tuple[Array, Any]:
    """All runs, each by a scan: sums, and what their rows show."""
    kernel = replace(problem.kernel, store=store)
    plant, tables = kernel.plant, problem.tables
    ny, nu = len(plant.outputs), len(plant.inputs)
    time, inputs, y, use = (
        tables[..., simulate_run] for simulate_run in compiled_runs.columns(nu, ny)
    )
    inputs, slope, past = inputs.reshape(*inputs.shape[:2], 3, nu), None, None
    if problem.places is not None:
        driving = driven(problem, theta, starts)
        inputs, slope, past = driving.inputs, driving.slope, driving.past

    def simulate_run(run: Any) -> Any:
        start, declared, rows, h = run
        lane = RunLane(theta, start, declared, problem.scale, problem.threshold)
        return kernel.run(lane, rows, h)

    rows = RunRow(time[..., 0], inputs, y, use, slope, past)
    runs = (starts, problem.declared, rows, problem.steps)
    # One after the other with dry friction: then only the steps with a stop pay for it.
    return jax.lax.map(simulate_run, runs) if any(kernel.friction) else jax.vmap(simulate_run)(runs)


def signals(unknowns: Unknowns, problem: Problem) -> Float[np.ndarray, "runs time ny size"]:
    """c of every sample: derivatives of the weighed errors, start first, and the errors."""
    theta = problem.completed(unknowns.theta)
    if not problem.compiled:
        rows = _scanned_signals(problem, jnp.asarray(theta), unknowns.starts)
        return np.asarray(rows)[:, :: problem.substeps]
    lanes = theta, unknowns.starts, problem.declared, problem.scale, problem.threshold
    lane = _lanes(*(np.asarray(part)[None] for part in lanes))
    rows = host_rows(problem, theta, np.asarray(unknowns.starts))
    return compiled_runs.signals(problem.kernel, lane, *rows, problem.substeps)


def outputs(unknowns: Unknowns, problem: Problem) -> Float[np.ndarray, "runs time ny"]:
    """ŷ of every sample, without derivatives; anything beyond the end of a run."""
    kernel, theta = problem.kernel, problem.completed(unknowns.theta)
    plant, values = kernel.plant.with_parameters(theta), np.asarray(unknowns.starts)
    tables, steps, _ = host_rows(problem, theta, values)
    nu, ny = len(plant.inputs), len(plant.outputs)
    time, inputs, _, _ = compiled_runs.columns(nu, ny)
    drivers = tables[..., inputs].reshape(*tables.shape[:2], 3, nu)
    starts = kernel.started(values, theta, problem.declared)
    y_hat = np.empty((len(tables), (tables.shape[1] - 1) // problem.substeps + 1, ny))
    for step in np.unique(steps):  # a loop has one
        runs = np.flatnonzero(steps == step)
        drive = Drive(
            tables[runs, :-1, time.start],
            steps[runs],
            drivers[runs, :-1],
            problem.substeps,
            drivers[runs, -1, 0],
        )
        begun = jax.tree.map(lambda leaf, runs=runs: np.asarray(leaf)[runs], starts)
        y_hat[runs] = outputs_of(plant, drive, begun, kernel.friction)
    return y_hat


@jit
def _scanned_sums(problem: Problem, theta: Array, starts: Array) -> Array:
    if len(theta) == 1:
        return _scanned(problem, theta[0], starts[0])[0][None]
    return jax.vmap(lambda theta, starts: _scanned(problem, theta, starts)[0])(theta, starts)


@jit
def _scanned_signals(
    problem: Problem, theta: Array, starts: Host
) -> Float[Array, "runs rows ny size"]:
    return _scanned(problem, theta, starts, "signals")[1]


def roots(
    square: Float[np.ndarray, "lanes runs size size"],
    theta: Float[Host, "lanes free"],
    power: Float[Host, " runs"],
) -> Float[np.ndarray, "lanes runs size size"]:
    r"""$A$ with $A^\top A$ = the sums: all that least squares needs of $[J\ r]$, in few rows.

    NaN where a run has diverged, or has no slopes to speak of.

    Args:
        square: the sums.
        theta: where.
        power: sum of squares of the measured outputs of each run.
    """
    theta, power, free = np.asarray(theta), np.asarray(power), theta.shape[-1]
    squares = np.diagonal(square, axis1=-2, axis2=-1)
    bad = ~np.all(np.isfinite(square), axis=(-2, -1))
    bad |= ill_conditioned(squares[..., -1 - free :], theta[:, None], power)
    length = np.where(squares > 0, np.sqrt(squares), 1.0)
    scaled = square / (length[..., :, None] * length[..., None, :])
    scaled = np.where(bad[..., None, None], 0.0, scaled)  # LAPACK takes no NaN
    values, vectors = np.linalg.eigh(scaled)
    root = np.sqrt(np.maximum(values, 0.0))[..., None] * np.swapaxes(vectors, -1, -2)
    # Columns of zeros (the start of a declared internal state) end as zeros, not as rounding.
    length = np.where(squares > 0, length, 0.0)
    return np.where(bad[..., None, None], np.nan, root * length[..., None, :])


def ill_conditioned(
    squares: Float[np.ndarray, "*lanes runs columns"],
    theta: Float[np.ndarray, "..."],
    power: Float[Host, " runs"],
    max_share: float = 1e-3,
) -> Bool[np.ndarray, "*lanes runs"]:
    """Whether rounding of a parameter moves the outputs of a run: it has no slopes to speak of.

    So it is where a step is too long for what the model does fast: the errors of the steps are then
    fed back by its limits, and what is seen of the outputs may still look right.

    Args:
        squares: sums of squares of the derivatives with the free parameters, then of the errors,
            shape (…, runs, free + 1).
        theta: these parameters, shape (…, free).
        power: sums of squares of the measured outputs, shape (runs,).
        max_share: of the outputs, by which rounding of a parameter may move them.
    """
    moved = squares[..., :-1] * (np.finfo(squares.dtype).eps * theta) ** 2
    return (moved > max_share**2 * (power + squares[..., -1])[..., None]).any(axis=-1)
