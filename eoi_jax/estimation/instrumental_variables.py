r"""Errors in variables, cured: the last passes by instrumental variables.

Least squares on F[φ], with φ along the noisy output, is biased: the noise of φ is that of u_eq. The
cure is a free run of the model at θ on the record's own inputs. Its regressors know nothing of the
noise; as instruments ζ they give

    Σ ζᵀψ Δθ = Σ ζᵀe

(`instrument_kernel.py` says what ζ, ψ and e are; `regression/instrumental.py` solves it), and the
run is repeated at the new θ until Δθ is small against its standard error. θ to start with comes
from the plain passes, initial states from the first samples of a run (`validate`); they enter the
instruments alone. Where a free run over the whole record departs from it (unstable or chaotic
plants, models that lack something), runs start anew in windows, in which noise reaches the
instruments through the initial states.

Source: P. C. Young, A. Jakeman, Int. J. Control 29 (1979) 1 (refined instrumental variables);
T. Söderström, P. Stoica, *Instrumental Variable Methods for System Identification* (1983).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.data.record import Record
from eoi_jax.estimation.defaults import too_short
from eoi_jax.estimation.instrument_kernel import PairSums, Rows, Simulated, run_pairs, together
from eoi_jax.estimation.iteration import Pass, by_sample, mean, sample_counts
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.preparation import Ready, prepare, step_inputs
from eoi_jax.estimation.regression.instrumental import within_bounds
from eoi_jax.estimation.regression.robust_covariance import long_run
from eoi_jax.models.jacobians import state_slopes
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import REACHES, frictional
from eoi_jax.simulation.known_direction import directed
from eoi_jax.simulation.validate import validate

_PASSES = 8  # at most
_SETTLED = 0.05  # Δθ over its standard error below which the passes end
_DEPARTS = 0.5  # error of a free run over the spread of y above which it does not follow
_WINDOWS = (1, 4, 16, 64)  # runs that a record is cut into, until they follow
# Samples from which a run's initial state is found, the first of these that last as long as F
# remembers, and their share of a window at most.
_HEADS, _SHARE = (50, 100, 200, 400, 800), 0.25
_MEMORIES = 10.0  # of the prefilter that a record holds, at least
# Weights rise over so many time constants of F: what a start cuts off second differences of the
# noise is a kick to L⁻¹, which may remember it for long.
_TAPER = 10.0
_SOME = 200  # samples at which slopes of the model are taken
_SLIDING = 0.9  # share of the scored steps: a relay that saturates does not show the injection
_GRID = 4096  # frequencies of the noise
_NOISE = 1e-5  # of the rms of an output: below it, what differences show may be signal
# Share of the residual's power that the noise foretells: below, there is more than noise; above,
# what differences show of the record is signal.
_NOISE_SHARES = (0.1, 4.0)


@dataclass(frozen=True)
class Instrumented:
    """Estimate by instrumental variables.

    Attributes:
        theta: shape (np,).
        covariance: shape (np, np).
        degrees_of_freedom: of each variance, shape (np,).
        passes: how many it took.
        windows: runs that the longest record was cut into.
        bound: which parameters ended on a bound, shape (np,).
    """

    theta: Float[np.ndarray, " np"]
    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"]
    passes: int
    windows: int
    bound: Bool[np.ndarray, " np"]


def instrumented(
    plant: Plant, records: Sequence[Record], prepared: Ready, observer: AbstractObserver
) -> Instrumented | str:
    """Passes by instrumental variables, from the estimate of the plain ones.

    Args:
        plant: with that estimate.
        records: as measured.
        prepared: the same, as the plain passes read them.
        observer: of the plain passes.

    Returns:
        The estimate, or why there is none.
    """
    theta, runs = np.array(plant.theta, dtype=float), None
    weights = 1.0 / np.maximum(_spread(records), np.finfo(float).tiny) ** 2
    leak, pairs = 0.0, None
    for number in range(1, _PASSES + 1):
        model = plant.with_parameters(theta)
        runs = _runs(model, records, prepared, runs)
        if isinstance(runs, str):
            return runs
        pairs = _pairs(model, runs, prepared, observer, pairs)
        one, rows = _one_pass(pairs, observer, theta, weights, leak)
        needed = _leak(plant, one, runs)
        if needed > leak:  # only seen after a pass, which is then of no use
            leak = 1.2 * needed  # to spare, for the next passes
            one, rows = _one_pass(pairs, observer, theta, weights, leak)
        increment, inverse = _solved(model, one, weights)
        if not (np.all(np.isfinite(increment)) and np.all(np.isfinite(inverse))):
            return "its instruments do not determine the parameters"
        theta = np.clip(theta + increment, plant.lower, plant.upper)
        power = one.square / np.maximum(one.count, 1.0)
        weights = 1.0 / np.maximum(power, 1e-24 * _spread(records) ** 2 + np.finfo(float).tiny)
        if number == 1:  # weighed by a guess
            continue
        covariance, freedom = _covariance(rows, pairs.steps, prepared.substeps, runs.owner, inverse)
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        if np.all(np.abs(increment) <= _SETTLED * errors + 1e-9 * np.abs(theta)):
            held = (theta == plant.lower) | (theta == plant.upper)
            bound = held & ~np.any(inverse, axis=1) & (np.asarray(plant.free) > 0)
            return Instrumented(theta, covariance, freedom, number, runs.windows, bound)
    return f"its passes did not settle within {_PASSES}"


def cured(
    plant: Plant,
    one: Pass,
    records: Sequence[Record],
    prepared: Ready,
    observer: AbstractObserver,
    wanted: bool,
) -> tuple[Instrumented | None, tuple[str, ...]]:
    """Instrumental variables where they are wanted, or where the plain estimate may be biased.

    Args:
        plant: with the plain estimate.
        one: its pass, a single lane.
        records: as measured.
        prepared: the same, as the plain passes read them.
        observer: of the plain passes.
        wanted: whatever the noise.

    Returns:
        Their estimate, or none; and what was chosen and why.
    """
    records, prepared = _telling(records, prepared)
    why = "as asked for"
    if not wanted:
        level = float(np.max([_level(record) for record in records]))
        sliding = np.min(mean(one.sums.sliding[0], one.sums.count[0]))
        if level < _NOISE or sliding < _SLIDING:
            return None, ()
        least, most = _NOISE_SHARES
        if not least <= noise_in_residual(plant, one, records, prepared) <= most:
            return None, ()
        why = f"measurement noise, {level:.2g} of the output's rms, is what the plain passes leave"
    found = instrumented(plant, records, prepared, observer)
    if isinstance(found, str):
        return None, (f"no instruments, though {why}: {found}",)
    windows = (
        "" if found.windows == 1 else f", runs starting anew {found.windows - 1} times a record"
    )
    made = f"instrumental variables in {found.passes} passes{windows}"
    return found, (f"{made}: {why}",)


def _telling(records: Sequence[Record], prepared: Ready) -> tuple[Sequence[Record], Ready]:
    """Without records in which neither filter nor free run settles: one would rule out the rest."""
    brief = too_short(records, prepared.lowpass.cutoff)
    if not any(brief):
        return records, prepared

    def kept(several: Sequence[Any]) -> tuple[Any, ...]:
        return tuple(one for one, short in zip(several, brief, strict=True) if not short)

    return kept(records), replace(
        prepared, records=kept(prepared.records), fine=kept(prepared.fine),
        inputs=kept(prepared.inputs), velocity_noise=kept(prepared.velocity_noise),
    )  # fmt: skip


def _spread(records: Sequence[Record]) -> Float[np.ndarray, " ny"]:
    return np.sqrt(np.mean([np.var(one.outputs[one.valid], axis=0) for one in records], axis=0))


# -- the simulated records --------------------------------------------------------------------


@dataclass(frozen=True)
class _Runs:
    """Records beside their free runs, cut into the windows in which these start anew.

    Attributes:
        measured: made ready for a pass.
        simulated: free runs, as they come.
        windows: of each record.
        owner: index of the record that each is a window of.
    """

    measured: tuple[Record, ...]
    simulated: tuple[Record, ...]
    windows: int
    owner: tuple[int, ...]


def _runs(
    plant: Plant, records: Sequence[Record], prepared: Ready, before: _Runs | None
) -> _Runs | str:
    """Free runs that follow the records: in windows as before, or at first in as few as do."""
    for count in _WINDOWS if before is None else (before.windows,):
        simulated, parts, owner, follows = [], [], [], True
        for i, record in enumerate(records):
            length = -(-len(record) // count)
            head = _head(record, length, prepared)
            if count > 1 and head is None:
                return _AWAY
            window = None if count == 1 else length * record.sample_period
            try:
                if REACHES in frictional(plant):
                    return _REACHING
                run = validate(plant, record, window=window, initial_samples=head or _HEADS[0])
            except ValueError as error:  # dry friction that cannot be simulated, a short record
                return f"its free run cannot be made: {error}"
            follows &= bool(np.max(run.nrmse) < _DEPARTS)
            for first in range(0, len(record), length):
                part = slice(first, first + length)
                parts.append((record, part))
                owner.append(i)
                simulated.append(run.predictions[0][part].without_inputs())
        if follows and before is not None:
            return _Runs(before.measured, tuple(simulated), count, before.owner)
        if follows:
            measured = tuple(_fine(record[part], prepared) for record, part in parts)
            return _Runs(measured, tuple(simulated), count, tuple(owner))
    return _AWAY


def _head(record: Record, length: int, prepared: Ready) -> int | None:
    """Samples at the start of each run that its initial state is fitted to; None if too few."""
    wanted = prepared.lowpass.memory / record.sample_period
    possible = [count for count in _HEADS if count <= _SHARE * length]
    return min((one for one in possible if one >= wanted), default=max(possible, default=None))


_REACHING = "dry friction acts on another output by inertia, where a stuck one leaves its reaction"
_AWAY = "the free run of the model departs from the records, even in short windows"


@dataclass(frozen=True)
class _Pairs:
    """What a pass over pairs reads: the model as it is followed, the measurement and the run."""

    plant: Plant
    steps: Steps
    simulated: Simulated
    before: Float[np.ndarray, "runs S ny"] | None


def _pairs(
    plant: Plant, runs: _Runs, prepared: Ready, observer: AbstractObserver, before: _Pairs | None
) -> _Pairs:
    """Both records made ready alike, by what `ready` chose; the measurement once for all passes."""
    friction = frictional(plant)
    rubs = any(friction)
    followed = directed(plant, friction) if rubs else plant
    steps = _measured(followed, runs, prepared, observer) if before is None else before.steps
    shape = np.shape(steps.y)
    y, y_next = np.zeros(shape), np.zeros(shape)
    ways = np.zeros((*shape[:2], shape[2] + 1)) if rubs else None
    for i, simulated in enumerate(runs.simulated):
        outputs = _fine(simulated, prepared).outputs
        count = len(outputs) - 1
        for whole, part in ((y, outputs[:-1]), (y_next, outputs[1:])):
            whole[i, :count], whole[i, count:] = part, part[-1]
        if ways is not None:
            each = np.repeat(_ways(plant.degrees, simulated.outputs), prepared.substeps, axis=0)
            ways[i, :count, :-1], ways[i, count:, :-1] = each, each[-1]
            ways[i, :, -1] = _pace(simulated)
    beside = Simulated(y, y_next)
    if ways is None:
        return _Pairs(followed, steps, beside, None)
    inputs = np.asarray(steps.u)[..., : len(plant.inputs)]
    steps = replace(steps, u=np.concatenate([inputs, ways], axis=2))
    ways = ways[..., :-1]
    return _Pairs(followed, steps, beside, np.concatenate([ways[:, :1], ways[:, :-1]], axis=1))


def _measured(followed: Plant, runs: _Runs, prepared: Ready, observer: AbstractObserver) -> Steps:
    """The records as steps, which all that count in the plain passes do here too."""
    inputs = [step_inputs(one, prepared.explicit) for one in runs.measured]
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    shortest = min(len(record) * record.sample_period for record in runs.measured)
    quiet = [np.zeros(len(followed.outputs))] * len(runs.measured)
    taper = min(_TAPER / prepared.lowpass.cutoff, shortest / _MEMORIES)
    memory, explicit = prepared.lowpass.memory, prepared.explicit
    return prepare(followed, runs.measured, inputs, taps, 0.0, memory, quiet, explicit, taper)


def _ways(
    degrees: Sequence[int], outputs: Float[np.ndarray, "time ny"]
) -> Float[np.ndarray, "steps ny"]:
    """Direction of each output in each step: a run at rest repeats its output to the last digit."""
    moved, speed = np.diff(outputs, axis=0), outputs[1:] + outputs[:-1]
    return np.sign(np.where(np.asarray(degrees) == 1, speed, moved))


def _pace(record: Record) -> float:
    """How fast a plant moves [rad/s]: rms velocity over the spread of its fastest output."""
    rates = np.diff(record.outputs, axis=0) / record.sample_period
    spread = np.std(record.outputs, axis=0)
    return float(np.max(np.sqrt(np.mean(rates**2, axis=0)) / np.where(spread > 0, spread, np.inf)))


def _fine(record: Record, prepared: Ready) -> Record:
    if prepared.smoothing:
        record = record.smooth(prepared.smoothing)
    return record.resample(prepared.substeps)


# -- one pass ---------------------------------------------------------------------------------


def _one_pass(
    pairs: _Pairs,
    observer: AbstractObserver,
    theta: Float[np.ndarray, " np"],
    weights: Float[np.ndarray, " ny"],
    leak: float,
) -> tuple[PairSums, Rows]:
    """Sums over all runs, and the rows of each."""
    at, by, damping = (jnp.asarray(one) for one in (theta, weights, leak))
    both = pairs.steps, pairs.simulated
    sums, rows = run_pairs(pairs.plant, observer, *both, at, by, damping, pairs.before)
    return together(sums), rows


def _covariance(
    rows: Rows,
    steps: Steps,
    substeps: int,
    owner: Sequence[int],
    inverse: Float[np.ndarray, "np np"],
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """Of the estimate, with its degrees of freedom."""
    error, zeta = (
        by_sample(np.asarray(one), steps.use, substeps) for one in (rows.error, rows.zeta)
    )
    # Windows of one record are its parts, and no independent ones.
    lengths = np.bincount(owner, sample_counts(steps.use, substeps)).astype(int).tolist()
    return long_run(np.einsum("sj,sja->sa", error, zeta), zeta, inverse, lengths)


def _leak(plant: Plant, one: PairSums, runs: _Runs) -> float:
    """Damping with which L⁻¹ forgets within a tenth of a run, though the plant may not."""
    nz = len(one.slopes) - plant.relative_degree * len(plant.outputs)
    rows = np.arange(plant.relative_degree)[:, None] < np.asarray(plant.degrees)
    owned = np.concatenate([rows.ravel(), np.ones(nz, bool)])
    slopes = one.slopes[np.ix_(owned, owned)] / max(float(one.steps), 1.0)
    duration = min(len(record) * record.sample_period for record in runs.measured)
    slowest = float(np.max(np.linalg.eigvals(slopes).real))
    return max(slowest + _MEMORIES / duration, 0.0)


def _solved(
    plant: Plant, one: PairSums, weights: Float[np.ndarray, " ny"]
) -> tuple[Float[np.ndarray, " np"], Float[np.ndarray, "np np"]]:
    cross, information = (
        np.einsum("j,jab->ab", weights, part) for part in (one.cross, one.information)
    )
    rhs = np.einsum("j,ja->a", weights, one.rhs)
    size = (len(rhs),)
    if not all(np.all(np.isfinite(part)) for part in (cross, information, rhs)):
        return np.full(size, np.nan), np.full(size * 2, np.nan)
    room = (np.asarray(plant.lower) - plant.theta, np.asarray(plant.upper) - plant.theta)
    return within_bounds(cross, information, rhs, np.asarray(plant.free), room)


# -- whether they are worth it ----------------------------------------------------------------


def noise_in_residual(plant: Plant, one: Pass, records: Sequence[Record], prepared: Ready) -> float:
    """Share of the power of F[u_eq] that measurement noise accounts for, of the noisiest output.

    White noise n of the outputs enters u_eq as n^(r) - Σ ∂f/∂y^(i) n^(i). The share is small where
    the model lacks something: then instruments would cure the lesser evil.

    Args:
        plant: with the plain estimate.
        one: its pass, a single lane.
        records: as measured.
        prepared: the same, as the plain passes read them.
    """
    left = mean(one.sums.square[0], one.sums.weight[0])
    shares = []
    for record, smooth, u in zip(records, prepared.records, prepared.inputs, strict=True):
        powers = _noise_powers(record, prepared, plant.relative_degree)
        u = u[:: prepared.substeps]
        some = slice(None, None, max(len(u) // _SOME, 1))
        rows = [smooth.outputs]
        for _ in range(1, plant.relative_degree):
            rows.append(np.gradient(rows[-1], smooth.sample_period, axis=0))
        states = np.stack(rows, axis=1)[:-1]
        slopes = np.asarray(state_slopes(plant, smooth.time[:-1][some], states[some], u[some]))
        with np.errstate(invalid="ignore"):
            square = np.nan_to_num(np.mean(slopes**2, axis=0))
        highest = np.asarray([powers[degree, j] for j, degree in enumerate(plant.degrees)])
        shares.append(highest + np.einsum("jik,ik->j", square, powers[:-1]))
    return float(np.max(np.mean(shares, axis=0) / np.maximum(left, np.finfo(float).tiny)))


def _noise_powers(record: Record, prepared: Ready, degree: int) -> Float[np.ndarray, "rows ny"]:
    """Power of F[n], F[n'], …, F[n^(degree)] of each output's white noise n."""
    omega = np.linspace(0.0, np.pi / record.sample_period, _GRID)
    gain = 1.0 / (1.0 + (omega / prepared.lowpass.cutoff) ** (2 * prepared.lowpass.order))
    means = np.mean(gain * omega ** (2 * np.arange(degree + 1)[:, None]), axis=1)
    return means[:, None] * record.noise**2


def _level(record: Record) -> Float[np.ndarray, " ny"]:
    rms = np.sqrt(np.mean(record.outputs[record.valid] ** 2, axis=0))
    return record.noise / np.where(rms > 0, rms, np.inf)
