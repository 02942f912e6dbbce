r"""Sums and signals of free runs: what least squares needs of a problem, and all derivatives.

One sweep over all runs gives the normal equations of all unknowns: `errors` are a small square root
of these for each run. Runs are machine code where that is possible, else scans.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.callback import borrowed, on_host
from eoi_jax.compiler.programs import jit
from eoi_jax.refinement.driven_inputs import DrivenInputs
from eoi_jax.refinement.problem import HostRuns, Problem, Unknowns, driven, widened_sums
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.sensitivity import Host, RunKernel, RunLane, RunRow


def sums(unknowns: Unknowns, problem: Problem | HostRuns) -> Float[Array, "runs size size"]:
    r"""$\sum w\,c\,c^\top$ of each run: start, then θ, then the error, all weighed."""
    if problem.start_sums is None:
        return _simulated(unknowns, problem)
    where, start_sums = problem.start_sums
    pairs = zip(jax.tree.leaves(unknowns), jax.tree.leaves(where), strict=True)
    at_start = jnp.stack([jnp.all(value == start_value) for value, start_value in pairs]).all()
    start_sums = jnp.asarray(start_sums, unknowns.theta.dtype)
    return jax.lax.cond(at_start, lambda: start_sums, lambda: _simulated(unknowns, problem))


def _simulated(unknowns: Unknowns, problem: Problem | HostRuns) -> Array:
    if isinstance(problem, Problem):
        theta = jnp.asarray(problem.theta).at[np.asarray(problem.free)].set(unknowns.theta)
        return _scanned(problem, theta, unknowns.starts)[0]
    runs, start_size = unknowns.starts.shape
    size = start_size + len(problem.lower) + 1
    shape = jax.ShapeDtypeStruct((runs, size, size), unknowns.theta.dtype)
    return on_host(_compiled_sums, shape, unknowns.theta, unknowns.starts, problem.number)


def _compiled_sums(theta: np.ndarray, starts: np.ndarray, number: np.ndarray) -> np.ndarray:
    """`sums` of the problem that was lent under this number, at values of the unknown parameters.

    Of one lane, or of several: then all has a leading axis, of length one if it is shared.
    """
    problem: Problem = borrowed(np.ravel(number)[0])
    count = len(problem.free)  # behind these are some that do nothing
    theta, spare = theta[..., :count], theta.shape[-1] - count
    if theta.ndim == 1:
        return widened_sums(_summed(problem, theta[None], starts[None])[0], spare)
    if problem.places is None:
        return widened_sums(_summed(problem, theta, starts), spare)
    lanes = zip(theta, np.broadcast_to(starts, (len(theta), *starts.shape[1:])), strict=True)
    parts = [_summed(problem, *(part[None] for part in lane)) for lane in lanes]
    return widened_sums(np.concatenate(parts), spare)


def _summed(
    problem: Problem, free: Float[np.ndarray, "lanes free"], starts: np.ndarray
) -> Float[np.ndarray, "lanes runs size size"]:
    """The sums of some lanes, which share what drives the plant."""
    theta = np.stack([problem.completed(values) for values in free])
    rows = host_rows(problem, theta[0], starts[0])
    shared = (
        np.asarray(part)[None] for part in (problem.declared, problem.scale, problem.threshold)
    )
    lanes = _lanes(theta, starts, *shared)
    return compiled_runs.summed(problem.kernel, lanes, *rows, problem.substeps)


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
    starts = jax.vmap(lambda start, declared: kernel.start(start, theta, declared))(
        values, problem.declared
    )
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
def _scanned_signals(
    problem: Problem, theta: Array, starts: Host
) -> Float[Array, "runs rows ny size"]:
    return _scanned(problem, theta, starts, "signals")[1]


@eqx.filter_custom_jvp
def errors(unknowns: Unknowns, problem: Problem | HostRuns) -> Float[Array, "runs size"]:
    """As many numbers a run as it has unknowns, and one: their squares sum up to its cost."""
    return _roots(unknowns, problem)[..., -1]


@errors.def_jvp
def _jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """The whole Jacobian in one sweep; then products with it cost next to nothing."""
    unknowns, problem = primals
    moved, _ = tangents
    start_size = unknowns.starts.shape[1]
    roots = _roots(unknowns, problem)
    product = jnp.einsum("riu,ru->ri", roots[..., :start_size], moved.starts)
    return roots[..., -1], product + jnp.einsum("riu,u->ri", roots[..., start_size:-1], moved.theta)


def _roots(unknowns: Unknowns, problem: Problem | HostRuns) -> Float[Array, "runs size size"]:
    r"""$A$ with $A^\top A$ = the sums: all that least squares needs of $[J\ r]$, in few rows."""
    square = sums(unknowns, problem)
    length = jnp.sqrt(jnp.diagonal(square, axis1=1, axis2=2))
    divisor = jnp.where(length > 0, length, 1.0)
    scaled = square / (divisor[:, :, None] * divisor[:, None, :])
    values, vectors = jnp.linalg.eigh(scaled)
    root = jnp.sqrt(jnp.maximum(values, 0.0))[:, :, None] * jnp.swapaxes(vectors, 1, 2)
    # Columns of zeros (the start of a declared internal state) end as zeros, not as rounding.
    # NaN must stay: the maximum above would hide a run that has diverged.
    bad = ~jnp.all(jnp.isfinite(square), axis=(1, 2))
    start_size = unknowns.starts.shape[1]
    bad |= ill_conditioned(
        jnp.diagonal(square, axis1=1, axis2=2)[:, start_size:], unknowns.theta, problem.power
    )
    return jnp.where(bad[:, None, None], jnp.nan, root * length[:, None, :])


def ill_conditioned(squares: Any, theta: Any, power: Any, max_share: float = 1e-3) -> Any:
    """Whether rounding of a parameter moves the outputs of a run: it has no slopes to speak of.

    So it is where a step is too long for what the model does fast: the errors of the steps are then
    fed back by its limits, and what is seen of the outputs may still look right.

    Args:
        squares: sums of squares of the derivatives with the free parameters, then of the errors,
            shape (runs, free + 1).
        theta: these parameters, shape (free,).
        power: sums of squares of the measured outputs, shape (runs,).
        max_share: of the outputs, by which rounding of a parameter may move them.
    """
    moved = squares[:, :-1] * (np.finfo(theta.dtype).eps * theta) ** 2
    return (moved > max_share**2 * (power + squares[:, -1])[:, None]).any(axis=1)
