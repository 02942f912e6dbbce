r"""Errors in variables: a bias correction by instrumental variables.

Least squares on F[φ], with φ along the noisy output, is biased: the noise of φ is correlated with
that of u_eq. Regressors of a free-run simulation of the model, on the record's inputs, are not;
as instruments ζ they give

    Σ ζᵀψ Δθ = Σ ζᵀe

(`instrument_kernel.py` defines ζ, ψ and e; `regression/instrumental.py` solves it). The simulation
is repeated at the new θ until Δθ is small against its standard error. The first θ is the estimate
of the plain iteration; initial states are fitted to the first samples of each run (`validate`), and
affect the instruments only. Where a free run over the whole record departs from it (unstable or
chaotic plants, incomplete models), it restarts in windows; there noise reaches the instruments
through the initial states.

Source: P. C. Young, A. Jakeman, Int. J. Control 29 (1979) 1 (refined instrumental variables);
T. Söderström, P. Stoica, *Instrumental Variable Methods for System Identification* (1983).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import counted
from eoi_jax.data.masks import over_samples
from eoi_jax.data.record import Record
from eoi_jax.estimation.defaults import too_short
from eoi_jax.estimation.instrument_kernel import PairSums, Rows, Simulated, run_pairs, sum_over_runs
from eoi_jax.estimation.iteration import Iteration, group_by_sample, mean, sample_counts
from eoi_jax.estimation.kernel import Steps, Sums
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.preparation import PreparedRecords, prepare_steps, smoothed, step_inputs
from eoi_jax.estimation.regression.instrumental import within_bounds
from eoi_jax.estimation.regression.robust_covariance import long_run
from eoi_jax.estimation.regression.sample_rows import SampleRows, sample_rows
from eoi_jax.estimation.within_samples import resampled
from eoi_jax.models.jacobians import state_slopes
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import REACHES, frictional
from eoi_jax.simulation.known_direction import directed
from eoi_jax.simulation.validate import judged_runs


@dataclass(frozen=True)
class InstrumentalSettings:
    """Numbers of the iteration with instrumental variables, and of the decision to use them."""

    tolerance: float = 0.05  # Δθ over its standard error, below which the iteration ends
    max_error: float = 0.5  # of a free run that follows the record, over the spread of y
    windows: tuple[int, ...] = (1, 4, 16, 64)  # of a record; tried until the runs follow it
    # Samples to which a run's initial state is fitted: the first number that spans the memory of F.
    start_samples: tuple[int, ...] = (50, 100, 200, 400, 800)
    max_start_share: float = 0.25  # of a window, that these samples take
    min_memories: float = 10.0  # time constants of the prefilter in a record
    # Over which weights rise [time constants of F]: a sharp edge cuts second differences of the
    # noise apart, and excites L⁻¹, whose memory may be long.
    taper: float = 10.0
    min_noise: float = 1e-5  # over the rms of an output; a smaller estimate may be signal
    min_sliding: float = 0.9  # share of scored steps in sliding mode: a saturated relay is not u_eq
    # Share of the residual's power that measurement noise predicts: below this range the model
    # lacks something, above it the noise estimate contains signal.
    noise_shares: tuple[float, float] = (0.1, 4.0)
    # Index at the corrected estimate over that of least squares, the smallest there is: little
    # above one where noise biased the latter, large where the instruments follow a model that
    # lacks something.
    max_index_ratio: float = 4.0
    slope_samples: int = 200  # at which slopes of the model are taken
    noise_frequencies: int = 4096  # at which its spectrum is taken, from zero to Nyquist


_SETTINGS = InstrumentalSettings()


@dataclass(frozen=True)
class InstrumentalEstimate:
    """Estimate by instrumental variables.

    Attributes:
        theta: shape (np,).
        covariance: shape (np, np).
        degrees_of_freedom: of each variance, shape (np,).
        passes: number of iterations.
        windows: into which each record was cut.
        bound: which parameters ended on a bound, shape (np,).
        rows: of its last pass by sample, if asked for.
    """

    theta: Float[np.ndarray, " np"]
    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"]
    passes: int
    windows: int
    bound: Bool[np.ndarray, " np"]
    rows: SampleRows | None = None


def instrumental_estimate(
    plant: Plant,
    records: Sequence[Record],
    prepared: PreparedRecords,
    observer: AbstractObserver,
    max_iterations: int = 8,
    by_sample: bool = False,
) -> InstrumentalEstimate | str:
    """Iterate with instrumental variables, from the plain estimate.

    Args:
        plant: with the plain estimate.
        records: as measured.
        prepared: the same records, prepared for the plain passes.
        observer: of the plain passes.
        max_iterations: of which the first has weights that are a guess.
        by_sample: whether the rows are kept.

    Returns:
        The estimate, or the reason why there is none.
    """
    theta, runs = np.array(plant.theta, dtype=float), None
    weights = 1.0 / np.maximum(_spread(records), np.finfo(float).tiny) ** 2
    leak, pairs = 0.0, None
    for iteration in range(1, max_iterations + 1):
        model = plant.with_parameters(theta)
        runs = _simulate_runs(model, records, prepared, runs)
        if isinstance(runs, str):
            return runs
        pairs = _pair(model, runs, prepared, observer, pairs)
        sums, rows = _run_pass(pairs, observer, theta, weights, leak)
        required_leak = _required_leak(plant, sums, runs)
        if required_leak > leak:  # known only after a pass, which is then repeated
            leak = 1.2 * required_leak  # with a margin for the next passes
            sums, rows = _run_pass(pairs, observer, theta, weights, leak)
        increment, inverse = _solve(model, sums, weights)
        if not (np.all(np.isfinite(increment)) and np.all(np.isfinite(inverse))):
            return "its instruments do not determine the parameters"
        theta = np.clip(theta + increment, plant.lower, plant.upper)
        power = sums.square / np.maximum(sums.count, 1.0)
        if np.any(power > _spread(records) ** 2):
            return _ERRORS_GROW
        weights = 1.0 / np.maximum(power, 1e-24 * _spread(records) ** 2 + np.finfo(float).tiny)
        if iteration == 1:
            continue
        covariance, freedom = _covariance(rows, pairs.steps, prepared.substeps, runs.owner, inverse)
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        if np.all(np.abs(increment) <= _SETTINGS.tolerance * errors + 1e-9 * np.abs(theta)):
            on_bound = (theta == plant.lower) | (theta == plant.upper)
            bound = on_bound & ~np.any(inverse, axis=1) & (np.asarray(plant.free) > 0)
            rows_by_sample = None
            if by_sample:
                _, rows = _run_pass(pairs, observer, theta, weights, leak, regressors=True)
                held = bound | (np.asarray(plant.free) == 0.0)
                rows_by_sample = _rows_by_sample(rows, pairs.steps, prepared.substeps, runs, held)
            return InstrumentalEstimate(
                theta, covariance, freedom, iteration, runs.windows, bound, rows_by_sample
            )
    return f"they did not converge within {counted(max_iterations, 'pass')}"


def correct_bias(
    plant: Plant,
    iteration: Iteration,
    records: Sequence[Record],
    prepared: PreparedRecords,
    observer: AbstractObserver,
    requested: bool,
    by_sample: bool = False,
) -> tuple[InstrumentalEstimate | None, tuple[str, ...]]:
    """Instrumental variables where requested, or where noise biases the plain estimate.

    Args:
        plant: with the plain estimate.
        iteration: of the plain estimate, a single lane.
        records: as measured.
        prepared: the same records, prepared for the plain passes.
        observer: of the plain passes.
        requested: whether to use them whatever the noise.
        by_sample: whether the estimate has its rows.

    Returns:
        The estimate, or None; and what was chosen and why.
    """
    if plant.has_algebraic:
        unbiased = not (requested or any(plant.degrees))  # regressors of the model's own states
        return None, () if unbiased else (f"no instrumental variables: {_ALGEBRAIC}",)
    used, records, prepared = _long_enough(records, prepared)
    reason = "requested"
    if not requested:
        level = float(np.max([_noise_level(record) for record in records]))
        sliding = np.min(mean(iteration.sums.sliding[0], iteration.sums.count[0]))
        if level < _SETTINGS.min_noise or sliding < _SETTINGS.min_sliding:
            return None, ()
        lowest, highest = _SETTINGS.noise_shares
        if not lowest <= noise_in_residual(plant, iteration, records, prepared) <= highest:
            return None, ()
        reason = (
            f"measurement noise, {level:.2g} of the output's rms, explains the remaining injection"
        )
    corrected = instrumental_estimate(plant, records, prepared, observer, by_sample=by_sample)
    if isinstance(corrected, str):
        return None, (f"no instrumental variables, though {reason}: {corrected}",)
    if corrected.rows is not None:
        rows = replace(corrected.rows, record=np.asarray(used)[corrected.rows.record])
        corrected = replace(corrected, rows=rows)
    text = f"instrumental variables in {counted(corrected.passes, 'pass')}"
    if corrected.windows > 1:
        text += f", runs restarted {counted(corrected.windows - 1, 'time')} a record"
    return corrected, (f"{text}: {reason}",)


def refusal(
    before: Float[np.ndarray, " ny"],
    sums: Sums,
    outputs: Sequence[str],
    settings: InstrumentalSettings = _SETTINGS,
) -> str:
    """Why an estimate by instrumental variables is not used; "" if it is.

    Args:
        before: index of the plain estimate.
        sums: of a pass at that by instrumental variables, of one lane.
        outputs: names.
        settings: with the largest ratio.
    """
    ratio = mean(sums.square, sums.weight) / np.where(before > 0, before, np.inf)
    worst = int(np.argmax(ratio))
    if ratio[worst] <= settings.max_index_ratio:
        return ""
    return _INDEX_RISES.format(outputs[worst], ratio[worst])


_INDEX_RISES = (
    "no instrumental variables: with them the index of {} is {:.3g} times as large, so that the "
    "model lacks more than noise hides"
)


def _long_enough(
    records: Sequence[Record], prepared: PreparedRecords
) -> tuple[list[int], Sequence[Record], PreparedRecords]:
    """Which records are not too short for filter and free run, one of which would fail all."""
    is_short = too_short(records, prepared.lowpass.cutoff)
    used = [i for i, excluded in enumerate(is_short) if not excluded]
    if not any(is_short):
        return used, records, prepared

    def selected(items: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(item for item, excluded in zip(items, is_short, strict=True) if not excluded)

    return used, selected(records), replace(
        prepared, records=selected(prepared.records), fine=selected(prepared.fine),
        inputs=selected(prepared.inputs), velocity_noise=selected(prepared.velocity_noise),
    )  # fmt: skip


def _spread(records: Sequence[Record]) -> Float[np.ndarray, " ny"]:
    variances = [over_samples(record, partial(np.var, axis=0)) for record in records]
    return np.sqrt(np.mean(variances, axis=0))


_ALGEBRAIC = (
    "an output of relative degree 0 has no differential equation whose inverse makes its noise "
    "white; `refine` is not biased"
)

# -- the simulated records --------------------------------------------------------------------


@dataclass(frozen=True)
class _SimulatedRuns:
    """Records and their free runs, cut into the windows in which the runs restart.

    Attributes:
        measured: records, smoothed and resampled.
        simulated: free runs at the sampling rate.
        windows: number of windows of each record.
        owner: index of the record of each window.
    """

    measured: tuple[Record, ...]
    simulated: tuple[Record, ...]
    windows: int
    owner: tuple[int, ...]


def _simulate_runs(
    plant: Plant,
    records: Sequence[Record],
    prepared: PreparedRecords,
    previous: _SimulatedRuns | None,
) -> _SimulatedRuns | str:
    """Free runs that follow the records, in as many windows as before, at first in the fewest."""
    for count in _SETTINGS.windows if previous is None else (previous.windows,):
        simulated, pieces, owner, follows = [], [], [], True
        for i, record in enumerate(records):
            length = -(-len(record) // count)
            head = _start_length(record, length, prepared)
            if count > 1 and head is None:
                return _RUNS_DEPART
            window = None if count == 1 else length * record.sample_period
            try:
                if REACHES in frictional(plant):
                    return _FRICTION_ACTS_ON_OTHERS
                head = head or _SETTINGS.start_samples[0]
                run = judged_runs(plant, record, head, window)
            except ValueError as error:  # dry friction that cannot be simulated, a short record
                return f"its free run cannot be made: {error}"
            follows &= bool(np.max(run.nrmse) < _SETTINGS.max_error)
            for first in range(0, len(record), length):
                samples = slice(first, first + length)
                pieces.append((record, samples))
                owner.append(i)
                simulated.append(run.predictions[0].without_inputs().part(*_ends(record, samples)))
        if follows and previous is not None:
            return _SimulatedRuns(previous.measured, tuple(simulated), count, previous.owner)
        if follows:
            measured = tuple(
                _measured(plant, record.bridged.part(*_ends(record, samples)), prepared)
                for record, samples in pieces
            )
            return _SimulatedRuns(measured, tuple(simulated), count, tuple(owner))
    return _RUNS_DEPART


def _ends(record: Record, samples: slice) -> tuple[int, int]:
    """First sample and last sample, plus one, of a slice of a record."""
    start, stop, _ = samples.indices(len(record))
    return start, stop


def _start_length(record: Record, length: int, prepared: PreparedRecords) -> int | None:
    """Number of samples to which a run's initial state is fitted; None if a window has too few."""
    required = prepared.lowpass.memory / record.sample_period
    longest = _SETTINGS.max_start_share * length
    allowed = [count for count in _SETTINGS.start_samples if count <= longest]
    return min(
        (count for count in allowed if count >= required), default=max(allowed, default=None)
    )


_FRICTION_ACTS_ON_OTHERS = (
    "dry friction acts on another output by inertia, where a stuck one leaves its reaction"
)
_ERRORS_GROW = (
    "errors grow along its free runs, as where a pendulum turns over, until they are larger than "
    "the outputs"
)
_RUNS_DEPART = "the free run of the model departs from the records, even in short windows"


@dataclass(frozen=True)
class _PairedSteps:
    """Input of a pass over pairs: the model, the measured steps and the simulated outputs."""

    plant: Plant
    steps: Steps
    simulated: Simulated
    previous_direction: Float[np.ndarray, "runs S ny"] | None


def _pair(
    plant: Plant,
    runs: _SimulatedRuns,
    prepared: PreparedRecords,
    observer: AbstractObserver,
    previous: _PairedSteps | None,
) -> _PairedSteps:
    """Both records with the choices of `prepare_records`; the measured steps are made only once."""
    friction = frictional(plant)
    has_friction = any(friction)
    model = directed(plant, friction) if has_friction else plant
    if previous is None:
        steps = _measured_steps(plant, model, runs, prepared, observer)
    else:
        steps = previous.steps
    shape = np.shape(steps.y)
    y, y_next = np.zeros(shape), np.zeros(shape)
    directions = np.zeros((*shape[:2], shape[2] + 1)) if has_friction else None
    for i, run in enumerate(runs.simulated):
        outputs = _prepared(plant, run, prepared).outputs
        count = len(outputs) - 1
        for target, values in ((y, outputs[:-1]), (y_next, outputs[1:])):
            target[i, :count], target[i, count:] = values, values[-1]
        if directions is not None:
            moved = _directions(plant.degrees, run.outputs, friction)
            steps_of_run = np.repeat(moved, prepared.substeps, axis=0)
            directions[i, :count, :-1], directions[i, count:, :-1] = steps_of_run, steps_of_run[-1]
            directions[i, :, -1] = _speed(run)
    simulation = Simulated(y, y_next)
    if directions is None:
        return _PairedSteps(model, steps, simulation, None)
    inputs = np.asarray(steps.u)[..., : len(plant.inputs)]
    steps = replace(steps, u=np.concatenate([inputs, directions], axis=2))
    directions = directions[..., :-1]
    return _PairedSteps(
        model, steps, simulation, np.concatenate([directions[:, :1], directions[:, :-1]], axis=1)
    )


def _measured_steps(
    plant: Plant,
    model: Plant,
    runs: _SimulatedRuns,
    prepared: PreparedRecords,
    observer: AbstractObserver,
) -> Steps:
    """The records as steps; those that count in the plain passes count here too."""
    inputs = [step_inputs(record, prepared.explicit) for record in runs.measured]
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    shortest = min(len(record) * record.sample_period for record in runs.measured)
    noise = [np.zeros(len(model.outputs))] * len(runs.measured)
    taper = min(_SETTINGS.taper / prepared.lowpass.cutoff, shortest / _SETTINGS.min_memories)
    memory, explicit = prepared.lowpass.memory, prepared.explicit
    return prepare_steps(model, runs.measured, inputs, taps, 0.0, memory, noise, explicit, taper,
                         undirected=plant)  # fmt: skip


def _directions(
    degrees: Sequence[int], outputs: Float[np.ndarray, "time ny"], friction: Sequence[int]
) -> Float[np.ndarray, "steps ny"]:
    """Direction of each output in each step, 0 at rest, where a run repeats its output exactly.

    It is always 1 without dry friction, where no motion turns abruptly.
    """
    moved, speed = np.diff(outputs, axis=0), outputs[1:] + outputs[:-1]
    direction = np.sign(np.where(np.asarray(degrees) == 1, speed, moved))
    return np.where(np.asarray(friction) > 0, direction, 1.0)


def _speed(record: Record) -> float:
    """Typical frequency of a motion [rad/s]: rms velocity over spread of the fastest output."""
    rates = np.diff(record.outputs, axis=0) / record.sample_period
    spread = np.std(record.outputs, axis=0)
    return float(np.max(np.sqrt(np.mean(rates**2, axis=0)) / np.where(spread > 0, spread, np.inf)))


def _measured(plant: Plant, record: Record, prepared: PreparedRecords) -> Record:
    if prepared.follows(plant):
        return resampled(plant, record, prepared.substeps)
    return _prepared(plant, record, prepared)


def _prepared(plant: Plant, record: Record, prepared: PreparedRecords) -> Record:
    if prepared.smoothing:
        record = smoothed(plant, record, prepared.smoothing)
    return record.resample(prepared.substeps)


# -- one pass ---------------------------------------------------------------------------------


def _run_pass(
    pairs: _PairedSteps,
    observer: AbstractObserver,
    theta: Float[np.ndarray, " np"],
    weights: Float[np.ndarray, " ny"],
    leak: float,
    regressors: bool = False,
) -> tuple[PairSums, Rows]:
    """Sums over all runs, and the rows of each step, with ψ if asked for."""
    parameters, output_weights, damping = (jnp.asarray(array) for array in (theta, weights, leak))
    inputs = pairs.steps, pairs.simulated
    sums, rows = run_pairs(
        pairs.plant,
        observer,
        *inputs,
        parameters,
        output_weights,
        damping,
        pairs.previous_direction,
        regressors=regressors,
    )
    return sum_over_runs(sums), rows


def _covariance(
    rows: Rows,
    steps: Steps,
    substeps: int,
    owner: Sequence[int],
    inverse: Float[np.ndarray, "np np"],
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """Covariance of the estimate, and its degrees of freedom."""
    error, zeta = (
        group_by_sample(np.asarray(array), steps.use, substeps) for array in (rows.error, rows.zeta)
    )
    # The windows of a record are not independent of each other.
    lengths = np.bincount(owner, sample_counts(steps.use, substeps)).astype(int).tolist()
    return long_run(np.einsum("sj,sja->sa", error, zeta), zeta, inverse, lengths)


def _rows_by_sample(
    rows: Rows,
    steps: Steps,
    substeps: int,
    runs: _SimulatedRuns,
    held: Bool[np.ndarray, " np"],
) -> SampleRows:
    """The rows grouped by sample, without the columns of parameters that are held."""
    assert rows.psi is not None
    psi, zeta = (np.where(held, 0.0, np.asarray(part)) for part in (rows.psi, rows.zeta))
    first = []
    for i, owner in enumerate(runs.owner):  # of each window, those of a record in order
        own = (len(run) for run, other in zip(runs.simulated[:i], runs.owner, strict=False)
               if other == owner)  # fmt: skip
        first.append(sum(own))
    return sample_rows(np.asarray(rows.error), psi, zeta, steps.use, substeps, runs.owner, first)


def _required_leak(plant: Plant, sums: PairSums, runs: _SimulatedRuns) -> float:
    """Damping with which the memory of L⁻¹ is a tenth of a run, stable plant or not [1/s]."""
    nz = len(sums.slopes) - plant.relative_degree * len(plant.outputs)
    rows = np.arange(plant.relative_degree)[:, None] < np.asarray(plant.degrees)
    is_used = np.concatenate([rows.ravel(), np.ones(nz, bool)])
    slopes = sums.slopes[np.ix_(is_used, is_used)] / max(float(sums.steps), 1.0)
    duration = min(len(record) * record.sample_period for record in runs.measured)
    slowest = float(np.max(np.linalg.eigvals(slopes).real))
    return max(slowest + _SETTINGS.min_memories / duration, 0.0)


def _solve(
    plant: Plant, sums: PairSums, weights: Float[np.ndarray, " ny"]
) -> tuple[Float[np.ndarray, " np"], Float[np.ndarray, "np np"]]:
    cross, information = (
        np.einsum("j,jab->ab", weights, total) for total in (sums.cross, sums.information)
    )
    rhs = np.einsum("j,ja->a", weights, sums.rhs)
    size = (len(rhs),)
    if not all(np.all(np.isfinite(total)) for total in (cross, information, rhs)):
        return np.full(size, np.nan), np.full(size * 2, np.nan)
    room = (np.asarray(plant.lower) - plant.theta, np.asarray(plant.upper) - plant.theta)
    return within_bounds(cross, information, rhs, np.asarray(plant.free), room)


# -- where the plain estimate is biased -------------------------------------------------------


def noise_in_residual(
    plant: Plant, iteration: Iteration, records: Sequence[Record], prepared: PreparedRecords
) -> float:
    """Share of the power of F[u_eq] that measurement noise accounts for, of the noisiest output.

    White noise n of the outputs enters u_eq as n^(r) - Σ ∂f/∂y^(i) n^(i). The share is small where
    the model lacks something, which is then a larger error than the bias.

    Args:
        plant: with the plain estimate.
        iteration: of the plain estimate, a single lane.
        records: as measured.
        prepared: the same records, prepared for the plain passes.
    """
    power = mean(iteration.sums.square[0], iteration.sums.weight[0])
    shares = []
    for record, used_record, u in zip(records, prepared.records, prepared.inputs, strict=True):
        powers = _noise_powers(record, prepared, plant.relative_degree)
        u = u[:: prepared.substeps]
        chosen = slice(None, None, max(len(u) // _SETTINGS.slope_samples, 1))
        rows = [used_record.outputs]
        for _ in range(1, plant.relative_degree):
            rows.append(np.gradient(rows[-1], used_record.sample_period, axis=0))
        states = np.stack(rows, axis=1)[:-1]
        slopes = np.asarray(
            state_slopes(plant, used_record.time[:-1][chosen], states[chosen], u[chosen])
        )
        with np.errstate(invalid="ignore"):
            square = np.nan_to_num(np.mean(slopes**2, axis=0))
        highest = np.asarray([powers[degree, j] for j, degree in enumerate(plant.degrees)])
        shares.append(highest + np.einsum("jik,ik->j", square, powers[:-1]))
    return float(np.max(np.mean(shares, axis=0) / np.maximum(power, np.finfo(float).tiny)))


def _noise_powers(
    record: Record, prepared: PreparedRecords, degree: int
) -> Float[np.ndarray, "rows ny"]:
    """Power of F[n], F[n'], …, F[n^(degree)] of each output's white noise n."""
    omega = np.linspace(0.0, np.pi / record.sample_period, _SETTINGS.noise_frequencies)
    gain = 1.0 / (1.0 + (omega / prepared.lowpass.cutoff) ** (2 * prepared.lowpass.order))
    means = np.mean(gain * omega ** (2 * np.arange(degree + 1)[:, None]), axis=1)
    density = record.output_periods / record.sample_period  # in a narrower band
    return means[:, None] * (record.noise**2 * density)


def _noise_level(record: Record) -> Float[np.ndarray, " ny"]:
    rms = over_samples(record, lambda y: np.sqrt(np.mean(y**2, axis=0)))
    return record.noise / np.where(rms > 0, rms, np.inf)
