r"""Errors of free runs over parameters and initial states, and their derivatives.

The runs of `refine`: fixed-step simulations, in which dry friction sticks, with forward-mode
sensitivities (`sensitivity.py`). A run depends on no other run's initial state, so one sweep over
all runs gives the normal equations of all unknowns. The least squares over them is in
`levenberg_marquardt.py`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.compiler.callback import borrowed, on_host
from eoi_jax.compiler.programs import jit
from eoi_jax.data.record import Record
from eoi_jax.data.windows import start_samples
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import StepScales, step_scales
from eoi_jax.refinement.driven_inputs import DrivenInputs, driven_inputs, driven_on_host
from eoi_jax.refinement.spans import Span, starts_record
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.initial_state import Run, initial_states, owned
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.sensitivity import Host, RunKernel, RunLane, RunRow
from eoi_jax.simulation.simulate import drive

CONVERGED = 1e-6  # share of the cost below which a step is not worth taking


class Unknowns(eqx.Module):
    """Free parameters, and the initial state of each run (outputs and derivatives, then z)."""

    theta: Float[Host, "*lanes free"]
    starts: Float[Host, "*lanes runs unknowns"]


class Problem(eqx.Module):
    """All runs side by side, padded to one length; what is not scored weighs nothing.

    On the host but for the tables: a fit is one call, and each array made by JAX before it would be
    another.

    Attributes:
        kernel: a run as a recursion.
        theta: all parameters; those of `free` are replaced.
        tables: rows of each run, in the order of `RunRow`; beyond its end the last one again.
        counts: rows of each run. steps: their length [s].
        record_drives: of a plant with actuators, what drives each segment: behind them its inputs
            change with θ, and with all that came before a run. places: rows of these, one segment
            after the other, that each run takes.
        declared: 1 where the run starts a record: internal states are then the plant's own, and
            what is known of the start of its outputs.
        leaders: of a plant with actuators, the run at the beginning of each segment: where an input
            was before is one of its unknowns.
        squares: sums of squares of the scored outputs of each run.
        faintest: shorter columns are no trace of a start; of its outputs and their derivatives,
            and of what its inputs were before.
        scale: 1/σ of each output. threshold: of Huber's loss, in σ; infinite for squares.
        start_sums: where a fit begins, and the sums there; None if they are not known.
        scales: on which a step moves the unknown parameters (`models/step_scales.py`).
        substeps: rows of a sample.
        engine: of the runs: machine code by `engines.free_runs`, or scans, and why.
    """

    kernel: RunKernel
    theta: Float[Host, " np"]
    tables: Float[Array, "runs rows columns"]
    counts: Int[Host, " runs"]
    steps: Float[Host, " runs"]
    record_drives: tuple[Drive, ...]
    places: Int[Host, "runs rows"] | None
    declared: Float[Host, " runs"]
    leaders: Int[Host, " segments"]
    squares: Float[Host, "runs ny"]
    faintest: Float[Host, " own"]
    scale: Float[Host, " ny"]
    threshold: Float[Host, ""]
    lower: Float[Host, " free"]
    upper: Float[Host, " free"]
    start_sums: tuple[Unknowns, Float[Host, "runs size size"]] | None
    scales: StepScales = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    engine: EngineUsed = eqx.field(static=True)

    @property
    def compiled(self) -> bool:
        """Whether the runs are machine code."""
        return self.engine == NATIVE

    @property
    def free(self) -> tuple[int, ...]:
        """Numbers of the parameters that are unknown."""
        return self.kernel.free

    def completed(self, free: Any) -> Float[np.ndarray, " np"]:
        """All parameters, with these values of the unknown ones."""
        theta = np.array(self.kernel.plant.theta, dtype=float)
        theta[list(self.free)] = np.asarray(free)
        return theta

    @property
    def power(self) -> Float[Host, " runs"]:
        """Sum of squares of the weighed outputs of each run."""
        return (self.squares * self.scale**2).sum(axis=1)

    @property
    def use(self) -> Bool[np.ndarray, "runs time ny"]:
        """Which samples are scored."""
        return _samples(self.kernel.plant, np.asarray(self.tables), self.substeps)[1]

    @property
    def y(self) -> Float[np.ndarray, "runs time ny"]:
        """Outputs; zero where not scored."""
        return _samples(self.kernel.plant, np.asarray(self.tables), self.substeps)[0]


class HostRuns(eqx.Module):
    """What a solver needs of a problem whose runs are machine code: arrays alone.

    Its compiled program then serves every plant with as many unknowns and runs.

    Attributes:
        number: by which `borrowed` gives the problem.
        scored: how many values are scored.
        power, lower, upper, faintest, start_sums, scales: of the problem.
    """

    number: Int[Host, ""]
    scored: Float[Host, ""]
    power: Float[Host, " runs"]
    lower: Float[Host, " free"]
    upper: Float[Host, " free"]
    faintest: Float[Host, " own"]
    start_sums: tuple[Unknowns, Float[Host, "runs size size"]] | None
    scales: StepScales = eqx.field(static=True)

    @classmethod
    def of(cls, problem: Problem, number: np.ndarray) -> "HostRuns":
        """Of a problem that was lent under this number."""
        return cls(
            number, np.asarray(float(np.sum(problem.use))), problem.power, problem.lower,
            problem.upper, problem.faintest, problem.start_sums, problem.scales,
        )  # fmt: skip


def scored_values(problem: Problem | HostRuns) -> Any:
    """How many values are scored."""
    if isinstance(problem, HostRuns):
        return problem.scored
    return problem.tables[..., -len(problem.scale) :].sum()


def _samples(
    plant: Plant, tables: Float[np.ndarray, "runs rows columns"], substeps: int
) -> tuple[Float[np.ndarray, "runs time ny"], Bool[np.ndarray, "runs time ny"]]:
    """Outputs, zero where not scored, and which samples are scored."""
    rows = tables[:, ::substeps]
    _, _, y, use = compiled_runs.columns(len(plant.inputs), len(plant.outputs))
    return rows[..., y], rows[..., use] > 0


def problem_of(
    plant: Plant, records: Sequence[Record], spans: Sequence[Span], substeps: int
) -> Problem:
    """The least squares of these runs, with the outputs weighed by their spread."""
    drives = _segment_drives(records, spans, substeps)
    tables = _tables(records, drives, spans)
    kernel = kernel_of(plant, "sums")
    free = np.asarray(kernel.free)
    acting = plant.actuator is not None
    # σ of the first fit: the spread of each output, for want of a residual.
    y, use = _samples(plant, tables, substeps)
    count = np.sum(use, axis=(0, 1))
    mean = np.sum(y, axis=(0, 1)) / count
    spread = np.sqrt(np.sum(use * (y - mean) ** 2, axis=(0, 1)) / count)
    return Problem(
        kernel=kernel,
        theta=np.asarray(plant.theta),
        tables=jnp.asarray(tables),
        counts=np.asarray([substeps * span.count + 1 for span in spans]),
        steps=np.asarray([float(_drive_of(drives, span).step) for span in spans]),
        record_drives=tuple(drives.values()) if acting else (),
        places=_places(drives, spans, int(plant.has_algebraic)) if acting else None,
        declared=np.asarray([float(starts_record(records, span)) for span in spans]),
        leaders=_leaders(drives, spans),
        squares=np.sum(y**2, axis=1),
        faintest=_faintest(kernel, spread, records),
        scale=_inverse(spread),
        threshold=np.asarray(np.inf),
        lower=np.asarray(plant.lower)[free],
        upper=np.asarray(plant.upper)[free],
        start_sums=None,
        scales=step_scales(plant).of(free.tolist()),
        substeps=substeps,
        engine=compiled_runs.used(kernel),
    )


def _faintest(
    kernel: RunKernel,
    spread: Float[np.ndarray, " ny"],
    records: Sequence[Record],
    trace: float = 1e-6,
    past_trace: float = 1e-4,
) -> Float[np.ndarray, " own"]:
    """Length of a column by which a start of the largest conceivable size leaves no trace.

    Else a start that a burn-in has forgotten is moved by orders of magnitude, after noise. No trace
    is a change of the outputs by `trace` of their standard deviation; by `past_trace` for a level
    of an input before the record, which a lag of next to nothing would else hide behind.
    """
    period = min(record.sample_period for record in records)
    largest = spread[list(kernel.columns)] / period ** np.asarray(kernel.rows)
    starts = trace / np.where(largest > 0, largest, np.inf)
    if kernel.plant.actuator is None:
        return starts
    internal = np.zeros(len(kernel.plant.initial_internal))
    levels = np.max([np.max(np.abs(record.inputs), axis=0) for record in records], axis=0)
    return np.concatenate([starts, internal, past_trace / np.where(levels > 0, levels, np.inf)])


def kernel_of(plant: Plant, store: str) -> RunKernel:
    """The recursion of a plant's free runs, over its free parameters."""
    rows, columns = (tuple(index.tolist()) for index in owned(plant))
    free = tuple(np.flatnonzero(plant.free).tolist())
    return RunKernel(plant, frictional(plant), free, rows, columns, store)


def weighed(
    problem: Problem, sigma: Float[np.ndarray, " ny"], threshold: float = np.inf
) -> Problem:
    """With other weights."""
    return replace(problem, scale=_inverse(sigma), threshold=np.asarray(float(threshold)))


def beginning(problem: Problem, share: float) -> Problem:
    """The first part of every run: later samples are not scored, nor simulated by machine code."""
    plant, n = problem.kernel.plant, problem.substeps
    counts = n * np.maximum(np.round(share * (problem.counts - 1) / n), 1).astype(int) + 1
    tables = np.array(problem.tables)
    _, _, y, use = compiled_runs.columns(len(plant.inputs), len(plant.outputs))
    for table, count in zip(tables, counts, strict=True):
        table[count:, y] = table[count:, use] = 0.0
    squares = np.sum(_samples(plant, tables, n)[0] ** 2, axis=1)
    return replace(problem, counts=counts, tables=jnp.asarray(tables), squares=squares)


def _inverse(sigma: Float[np.ndarray, " ny"]) -> Float[np.ndarray, " ny"]:
    """1/σ; an output without spread counts as it is."""
    return 1.0 / np.where(sigma > 0, sigma, 1.0)


# What drives each segment of each record; by record and first sample.
Drives = dict[tuple[int, int], Drive]


def _segment_drives(records: Sequence[Record], spans: Sequence[Span], substeps: int) -> Drives:
    """What drives each segment with a run: nothing in it depends on inputs outside."""
    drives: Drives = {}
    for span in spans:
        part, record = slice(*span.segment), records[span.record]
        key = (span.record, span.segment[0])
        if key not in drives:
            drives[key] = drive(
                record.time[part], record.inputs[part], record.hold, substeps, record.skew
            )
    return drives


def _drive_of(drives: Drives, span: Span) -> Drive:
    return drives[span.record, span.segment[0]]


def _tables(
    records: Sequence[Record], drives: Drives, spans: Sequence[Span]
) -> Float[np.ndarray, "runs rows columns"]:
    """Rows of every run; a last row scores its last sample."""
    n, longest = _drive_of(drives, spans[0]).substeps, max(span.count for span in spans)
    nu, ny = records[0].inputs.shape[1], records[0].outputs.shape[1]
    time, inputs, y, use = compiled_runs.columns(nu, ny)
    # Written in place: the tables are the largest arrays of a fit.
    tables = np.zeros((len(spans), n * longest + 1, use.stop))
    for table, span in zip(tables, spans, strict=True):
        record, record_drive = records[span.record], _drive_of(drives, span)
        first, count = n * (span.first - span.segment[0]), n * span.count
        last = min(first + count, len(record_drive.time) - 1)
        rows, steps = table[:count], slice(first, first + count)
        rows[:, time] = record_drive.time[steps, None]
        rows[:, inputs] = np.reshape(record_drive.inputs[steps], (count, 3 * nu))
        is_last = last == first + count
        end = record.time[span.segment[1] - 1]
        table[count:, time] = record_drive.time[last] if is_last else end
        after = record_drive.inputs[last] if is_last else (record_drive.last,) * 3
        table[count:, inputs] = np.ravel(after)
        samples, part = table[: count + 1 : n], slice(span.first, span.first + span.count + 1)
        samples[:, y] = np.where(span.use, record.outputs[part], 0.0)
        samples[:, use] = span.use
    return tables


def _leaders(drives: Drives, spans: Sequence[Span]) -> Int[np.ndarray, " segments"]:
    """The first run of each segment."""
    keys = [(span.record, span.segment[0]) for span in spans]
    return np.asarray([keys.index(key) for key in drives])


def _places(drives: Drives, spans: Sequence[Span], beyond: int) -> Int[np.ndarray, "runs rows"]:
    """Rows of each run among those of all segments; beyond the end of a segment its last one.

    Args:
        drives: of the segments.
        spans: runs.
        beyond: rows that `actuated` gives beyond the steps of a segment.
    """
    lengths = [len(part.time) + beyond for part in drives.values()]
    ends = dict(zip(drives, np.cumsum(lengths), strict=True))
    longest, rows = max(span.count for span in spans), []
    for span in spans:
        segment_drive, first = _drive_of(drives, span), span.first - span.segment[0]
        n, length = segment_drive.substeps, len(segment_drive.time) + beyond
        index = np.minimum(n * first + np.arange(n * longest + 1), length - 1)
        rows.append(ends[span.record, span.segment[0]] - length + index)
    return np.stack(rows)


def guessed_starts(
    problem: Problem, records: Sequence[Record], spans: Sequence[Span], samples: int = 50
) -> Float[np.ndarray, "runs unknowns"]:
    """Initial states fitted to the first `samples` of each run, at the plant's own parameters."""
    kernel, substeps = problem.kernel, problem.substeps
    required = kernel.plant.rows
    longest = max(start_samples(record, required, samples) for record in records)
    count = min(longest, _common_length(spans))
    run = Run(kernel.plant, kernel.friction, substeps)
    shape = (len(spans), count, len(kernel.plant.outputs))
    y, valid = np.zeros(shape), np.zeros(shape, dtype=bool)
    for i, span in enumerate(spans):
        head = slice(span.first, span.first + count)
        record, last = records[span.record], min(count, span.segment[1] - span.first)
        y[i, :last], y[i, last:] = record.outputs[head][:last], record.outputs[span.first]
        valid[i, :last] = record.output_valid[head][:last]
    heads, past = _heads(problem, count - 1)
    with np.errstate(invalid="ignore"):  # a start that diverges is found out by the first fit
        begins = np.asarray([starts_record(records, span) for span in spans])
        return initial_states(run, heads, y, valid, past, begins)


def _common_length(spans: Sequence[Span]) -> int:
    """Length of the shortest run [steps] but for what gaps have shortened."""
    longest: dict[int, int] = {}
    for span in spans:
        longest[span.record] = max(longest.get(span.record, 0), span.count)
    # Runs of equal length differ by one by rounding.
    return min(span.count for span in spans if span.count >= longest[span.record] - 1)


def _heads(problem: Problem, count: int) -> tuple[Drive, np.ndarray | None]:
    """What drives the beginning of each run, runs first, and how that changes with the past."""
    # A row more than steps: from it on the last input of the head holds.
    plant, rows = problem.kernel.plant, slice(problem.substeps * count + 1)
    head = np.asarray(problem.tables)[:, rows]
    nu, ny = len(plant.inputs), len(plant.outputs)
    time, inputs, _, _ = compiled_runs.columns(nu, ny)
    inputs = head[..., inputs].reshape(*head.shape[:2], 3, nu)
    past = None
    if problem.places is not None:
        settled = np.zeros((len(problem.leaders), nu))
        driving = _driven(problem, problem.theta, settled)
        inputs, past = (
            np.asarray(driving.inputs)[:, rows],
            np.asarray(driving.past)[:, rows][:, :-1],
        )
    times, steps = head[:, :-1, time][..., 0], np.asarray(problem.steps)
    return Drive(times, steps, inputs[:, :-1], problem.substeps, inputs[:, -1, 0]), past


# -- sums and signals -------------------------------------------------------------------------


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
    if theta.ndim == 1:
        return _summed(problem, theta[None], starts[None])[0]
    if problem.places is None:
        return _summed(problem, theta, starts)
    lanes = zip(theta, np.broadcast_to(starts, (len(theta), *starts.shape[1:])), strict=True)
    return np.concatenate([_summed(problem, *(part[None] for part in lane)) for lane in lanes])


def _summed(
    problem: Problem, free: Float[np.ndarray, "lanes free"], starts: np.ndarray
) -> Float[np.ndarray, "lanes runs size size"]:
    """The sums of some lanes, which share what drives the plant."""
    theta = np.stack([problem.completed(values) for values in free])
    rows = host_rows(problem, theta[0], starts[0])
    shared = (part[None] for part in (problem.declared, problem.scale, problem.threshold))
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


def driven(problem: Problem, theta: Host, starts: Host) -> DrivenInputs:
    """Inputs of the runs behind the actuators; levels before each segment are those in `starts`."""
    nu = len(problem.kernel.plant.inputs)
    if problem.compiled:
        return _driven(problem, np.asarray(theta), np.asarray(starts)[problem.leaders, -nu:])
    return _driven(problem, theta, jnp.asarray(starts)[problem.leaders, -nu:])


def _driven(problem: Problem, theta: Host, levels: Host) -> DrivenInputs:
    plant, drives, leaders = problem.kernel.plant, problem.record_drives, problem.leaders
    if problem.compiled:
        places = np.asarray(problem.places)
        return driven_on_host(plant, np.asarray(theta), drives, np.asarray(levels), places, leaders)
    places = jnp.asarray(problem.places)
    return driven_inputs(plant, jnp.asarray(theta), drives, levels, places, leaders)


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


class Outcome(eqx.Module):
    """Where the solver ended.

    Attributes:
        unknowns: the best ones.
        further: a step without damping from there.
        cost: at `unknowns`, with the weights of the problem.
        predicted_reduction: share of the cost by which a step of least squares would lower it.
        steps: simulations with sensitivities. exhausted: whether there were too few.
    """

    unknowns: Unknowns
    further: Unknowns
    cost: Float[Host, "*lanes"]
    predicted_reduction: Float[Array, "*lanes"]
    steps: Int[Array, "*lanes"]
    exhausted: Bool[Array, "*lanes"]
