r"""Errors of free runs over parameters and initial states, and their derivatives.

The runs of `refine`: fixed-step simulations, in which dry friction sticks, with forward-mode
sensitivities (`sensitivity.py`). A run depends on no other run's initial state, so one sweep over
all runs gives the normal equations of all unknowns. The least squares over them is in
`levenberg_marquardt.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.data.record import Record
from eoi_jax.data.windows import start_samples
from eoi_jax.models.actuators import are_linear, changed_inputs
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import StepScales, step_scales
from eoi_jax.refinement.driven_inputs import DrivenInputs, driven_inputs, driven_on_host
from eoi_jax.refinement.spans import Span, starts_record
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.initial_state import Run, initial_states, owned
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.sensitivity import Host, RunKernel
from eoi_jax.simulation.simulate import drive

CONVERGED = 1e-6  # share of the cost below which a step is not worth taking


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)  # not a module: made in each step of a fit
class Unknowns:
    """Free parameters, and the initial state of each run (outputs and derivatives, then z).

    Attributes:
        theta: shape (free,), or of several lanes (lanes, free).
        starts: shape (runs, unknowns), or (lanes, runs, unknowns).
    """

    theta: Any
    starts: Any


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
        noise = np.stack([records[span.record].noise for span in spans])
        return initial_states(run, heads, y, valid, noise, past, begins)


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
        linear = np.asarray(are_linear(plant.actuator, nu))
        driving = _driven(problem, problem.theta, settled)
        inputs, risen = (np.asarray(part)[:, rows] for part in (driving.inputs, driving.past))
        past = np.zeros((*inputs[:, :-1].shape, nu))
        past[..., changed_inputs(plant.actuator, nu), :] = linear * risen[:, :-1]
    times, steps = head[:, :-1, time][..., 0], np.asarray(problem.steps)
    return Drive(times, steps, inputs[:, :-1], problem.substeps, inputs[:, -1, 0]), past


def driven(problem: Problem, theta: Host, starts: Host) -> DrivenInputs:
    """Inputs of the runs behind the actuators; levels before each segment are those in `starts`."""
    nu = len(problem.kernel.plant.inputs)
    if problem.compiled:
        return _driven(problem, np.asarray(theta), np.asarray(starts)[problem.leaders, -nu:])
    return _driven(problem, theta, jnp.asarray(starts)[problem.leaders, -nu:])


def _driven(problem: Problem, theta: Host, levels: Host) -> DrivenInputs:
    kernel, drives = problem.kernel, problem.record_drives
    if problem.compiled:
        places = np.asarray(problem.places)
        host = np.asarray(theta), drives, np.asarray(levels), places, np.asarray(problem.leaders)
        return driven_on_host(kernel.plant, kernel.acting, *host)
    places, theta = jnp.asarray(problem.places), jnp.asarray(theta)
    return driven_inputs(
        kernel.plant, kernel.acting, theta, drives, levels, places, problem.leaders
    )


class Outcome(eqx.Module):
    """Where the solver ended.

    Attributes:
        unknowns: the best ones.
        further: a step without damping from there.
        cost: at `unknowns`, with the weights of the problem.
        predicted_reduction: share of the cost by which a step of least squares would lower it.
        cancelling: what a single parameter does in that step, over what all of it does, at most.
        steps: simulations with sensitivities. exhausted: whether there were too few.
    """

    unknowns: Unknowns
    further: Unknowns
    cost: Float[Host, "*lanes"]
    predicted_reduction: Float[Host, "*lanes"]
    cancelling: Float[Host, "*lanes"]
    steps: Int[Host, "*lanes"]
    exhausted: Bool[Host, "*lanes"]

    def lane(self, number: int) -> "Outcome":
        """One lane of several."""
        return jax.tree.map(lambda leaf: np.asarray(leaf[number]), self)
