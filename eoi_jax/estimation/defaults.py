r"""Default gains, filter and sub-steps, read off the records, with the reason in words.

**Filter.** Least squares on F[y^(r)] is disturbed by the measurement noise that F lets through,
whose density grows as ω^2r. The cut-off is the highest at which that noise stays below a
thousandth of F[y^(r)] (both rms), yet at least the frequency that halves the power of y^(r), so
that the plant's own dynamics stay inside, and at most the one below which 99 % of it lies. Lines
that no input has (hum, vibration) count neither as dynamics nor as what noise is held against. One
pole more than the derivatives that are taken bounds the noise at any sampling rate. Records too
short for that, beside longer ones, have no say: what their spectra show is their length.

**Relay.** It is set well above all that it may have to inject, so that the implicit observer stays
in sliding; in the implicit form a large relay costs nothing (no chatter), and what noise it lets
through, the filter removes.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._checks import check
from eoi_jax.compiler.programs import jit
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.masks import longest_run
from eoi_jax.data.record import Record
from eoi_jax.data.spectrum import Spectrum, spectrum
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, HighOrder, PerOutput, SecondOrder
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant, State

_NOISE_SHARE = 1e-3  # rms of the noise in F[y^(r)] over that of the signal
_NOISY_RATE = 0.01  # noise of the velocity over the velocity, rms, that calls for smoothing
_SMOOTH_BAND = 5.0  # of the smoothing over the cut-off of F
_FINE = 0.012  # cut-off times step
_MOST_SUBSTEPS = 20
_MOST_SAMPLES = 2_000_000  # beyond this the memory of a sub-stepped record would show
# A record below both has no say: its length in time constants of F, and over the longest one.
_TELLS, _SHORT = 20.0, 0.1
_RELAY = 2.0  # relay over the largest injection foreseen


def default_lowpass(plant: Plant, records: Sequence[Record]) -> tuple[LowPass, str]:
    """The filter (19) for these records, and the reason for its cut-off."""
    order = plant.relative_degree + 1

    @functools.cache
    def several(i: int) -> list[Spectrum]:
        return [spectrum(records[i], j, degree) for j, degree in enumerate(plant.degrees)]

    def chosen(brief: Sequence[bool]) -> tuple[float, str]:
        kept = [i for i, short in enumerate(brief) if not short]
        spectra = [one for i in kept for one in several(i)]
        return _cutoff(spectra, [records[i] for i in kept], order)

    shortest = too_short(records, 0.0)
    cutoff, reason = chosen(shortest)
    brief = too_short(records, cutoff)
    if brief != shortest:
        cutoff, reason = chosen(brief)
    return LowPass(cutoff, order), f"cut-off {cutoff:.4g} rad/s, order {order}: {reason}"


def too_short(records: Sequence[Record], cutoff: float) -> tuple[bool, ...]:
    """Which records are too short, or torn, beside others, to have a say in what is chosen.

    Args:
        records: of one estimate.
        cutoff: of F [rad/s]; 0 for whatever F.
    """
    lengths = [record.sample_period * len(record) for record in records]
    least = _SHORT * max(lengths)
    torn = [_torn(record) for record in records]
    return tuple(
        (gone and not all(torn)) or (one < least and one * cutoff < _TELLS)
        for gone, one in zip(torn, lengths, strict=True)
    )


def check_runs_of_samples(records: Sequence[Record]) -> None:
    """Differences are taken between samples that follow each other.

    Args:
        records: of one estimate.

    Raises:
        ValueError: no record with a run of valid samples that is long enough.
    """
    longest = max(_run_length(record) for record in records)
    check(
        longest >= SHORTEST,
        "records",
        f"must hold a run of at least {SHORTEST} valid samples one after the other",
        f"{longest} at most: values are missing in between",
        "With two sensors of different rates keep the rows in which both have a value, or fill in "
        "the slower one; or use `refine`, which scores the samples that are there.",
    )


def _run_length(record: Record) -> int:
    first, stop = longest_run(record)
    return stop - first


def _torn(record: Record) -> bool:
    return _run_length(record) < SHORTEST


def brief_notes(records: Sequence[Record], cutoff: float, what: str) -> list[str]:
    """A sentence for each of these.

    Args:
        records: of one estimate.
        cutoff: of F [rad/s].
        what: is done with them.
    """

    def why(one: Record) -> str:
        if _torn(one):
            return f"no {SHORTEST} valid samples follow each other"
        return (
            f"{one.sample_period * len(one):.3g} s are too short beside the other records, less "
            f"than {_TELLS:g} time constants of the filter"
        )

    brief = too_short(records, cutoff)
    return [f"{one.name}: {why(one)}: {what}" for i, one in enumerate(records) if brief[i]]


def _cutoff(
    spectra: Sequence[Spectrum], records: Sequence[Record], order: int
) -> tuple[float, str]:
    """Cut-off [rad/s] for records with these spectra of y^(r), and the reason."""
    half = max(one.below(0.5, one.own) for one in spectra)
    most = max(one.below(0.99, one.signal) for one in spectra)
    quiet = min(one.quiet_cutoff(_NOISE_SHARE, order) for one in spectra)
    choices = {
        f"the highest with noise below {_NOISE_SHARE:g} of the filtered highest derivative": quiet,
        "below it lie 99 % of the power of the highest derivative": most,
    }
    reason = min(choices, key=lambda key: choices[key])
    cutoff = choices[reason]
    duration = max(record.sample_period * len(record) for record in records)
    period = max(record.sample_period for record in records)
    for why, limit, bound in (
        ("below it lies half of the power of the highest derivative", max, half),
        ("twenty over the record's length", max, 20.0 / duration),
        ("a tenth of the sampling rate", min, 0.2 * np.pi / period),
    ):
        if limit(cutoff, bound) != cutoff:
            reason, cutoff = why, bound
    return cutoff, reason


def default_observer(
    plant: Plant,
    records: Sequence[Record],
    inputs: Sequence[Float[np.ndarray, "_ nu"]],
    cutoff: float,
    substeps: int = 1,
) -> tuple[AbstractObserver, tuple[str, ...]]:
    """An implicit observer for each relative degree of the plant, and the reasons for its gains.

    Args:
        plant: at its nominal parameters.
        records: with sub-steps.
        inputs: in the middle of each of their steps.
        cutoff: of F [rad/s].
        substeps: per sample.
    """
    needed = _largest_injection(plant, records, inputs)
    chosen, reasons = [], []
    for j, degree in enumerate(plant.degrees):
        relay = _RELAY * float(needed[j])
        period = min(record.sample_period for record in records)
        noise = max(float(record.noise[j]) for record in records)
        ratio = (substeps * period) ** degree * relay / noise if noise > 0 else np.inf
        # A first-order observer integrates its relay: it must reach the injection in one step.
        what = "delta" if degree == 1 else "relay"
        value = 2.0 * relay / period if degree == 1 else relay
        reasons.append(
            f"{plant.outputs[j]}: {what} {value:.3g}, {_RELAY:g} times the largest injection "
            f"foreseen at the nominal parameters ({needed[j]:.3g}); its reach over one sample is "
            f"{ratio:.3g} times the measurement noise"
        )
        chosen.append(value)
    return _build(plant.degrees, np.asarray(chosen), cutoff), tuple(reasons)


def default_smoothing(
    plant: Plant, records: Sequence[Record], cutoff: float
) -> tuple[float | bool, list[str]]:
    """Zero-phase cut-off [rad/s] for records whose noise hides the velocity, else False; and why.

    A model sees the velocity before the filter F does: sign(ẏ) or ẏ|ẏ| of a noisy velocity is
    wrong in the mean, and no filter behind it can mend that.
    """
    smoothing = _SMOOTH_BAND * cutoff
    brief = too_short(records, cutoff)
    telling = [one for one, short in zip(records, brief, strict=True) if not short]
    moving = np.asarray(plant.degrees) > 1
    noisy = False
    for record in telling:
        rates = np.diff(record.outputs, axis=0) / record.sample_period
        rms = np.sqrt(np.mean(rates**2, axis=0))
        noisy |= bool(np.any((rate_noise(record, False) > _NOISY_RATE * rms) & moving))
    if not noisy or smoothing > 0.9 * min(np.pi / record.sample_period for record in records):
        return False, []
    before, after = (
        max(float(np.max(rate_noise(record, one))) for record in telling)
        for one in (False, smoothing)
    )
    reason = (
        f"smoothed at {smoothing:.4g} rad/s, outputs and inputs alike, zero phase: the noise of "
        f"the velocity falls from {before:.2g} to {after:.2g}"
    )
    return smoothing, [reason]


def rate_noise(record: Record, smoothing: float | bool) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the noise in a velocity taken over one step [unit of y / s].

    White noise σ per sample gives √2 σ/h; behind a zero-phase low-pass of cut-off ω it gives
    σ √(h ω³/3π).
    """
    h = record.sample_period
    if smoothing:
        return record.noise * np.sqrt(h * float(smoothing) ** 3 / (3.0 * np.pi))
    return np.sqrt(2.0) * record.noise / h


def velocity_noise(
    degrees: Sequence[int], record: Record, smoothing: float | bool
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the noise in what tells how an output moves [unit of y / s].

    The velocity of a position, over one step; of relative degree one the output itself [its unit].
    """
    speed = record.noise
    if smoothing:
        speed = speed * np.sqrt(record.sample_period * float(smoothing) / np.pi)
    return np.where(np.asarray(degrees) == 1, speed, rate_noise(record, smoothing))


def default_transient(records: Sequence[Record], lowpass: LowPass, explicit: bool) -> float:
    """Ten time constants of F, at most a fifth of the shortest record that has a say [s].

    The explicit observer also has to reach its surface; published gains take about a second.
    """
    brief = too_short(records, lowpass.cutoff)
    each = zip(records, brief, strict=True)
    shortest = min(record.sample_period * len(record) for record, short in each if not short)
    return min(10.0 / lowpass.cutoff + (1.0 if explicit else 0.0), 0.2 * shortest)


def default_substeps(records: Sequence[Record], cutoff: float) -> tuple[int, list[str]]:
    """Sub-steps per sample that make the step short against the band of F, and why.

    Model and measurement are averaged over a step by kernels that agree to second order: at the
    frequency ω what is left is a share (ω h)²/6 of the highest derivative.
    """
    period = max(record.sample_period for record in records)
    longest = max(len(record) for record in records)
    wanted = int(np.ceil(cutoff * period / _FINE))
    substeps = max(min(wanted, _MOST_SUBSTEPS, _MOST_SAMPLES // longest), 1)
    if substeps == 1:
        return 1, []
    left = (cutoff * period / substeps) ** 2 / 6.0
    reason = (
        f"{substeps} sub-steps a sample: the discretisation error at the cut-off falls from "
        f"{substeps**2 * left:.2g} to {left:.2g} of the highest derivative"
    )
    return substeps, [reason]


def _build(
    degrees: tuple[int, ...], gains: Float[np.ndarray, " ny"], cutoff: float
) -> AbstractObserver:
    def one(degree: int, value: Any) -> AbstractObserver:
        if degree == 1:
            return FirstOrder(delta=value)
        if degree == 2:
            # Error dynamics (10) without its relay: two poles at the cut-off, damping 0.7.
            return SecondOrder(c1=1.4 * cutoff, c2=cutoff**2, c3=value)
        return HighOrder(bound=value, degree=degree)

    if len(set(degrees)) == 1:
        return one(degrees[0], gains)
    return PerOutput(tuple(one(degree, gains[j]) for j, degree in enumerate(degrees)))


def _largest_injection(
    plant: Plant, records: Sequence[Record], inputs: Sequence[Float[np.ndarray, "_ nu"]]
) -> Float[np.ndarray, " ny"]:
    """Bound on |y^(r) - f| at the nominal parameters: what differences show plus what f says."""
    bounds = []
    for record, u in zip(records, inputs, strict=True):
        h, valid = record.sample_period, record.valid
        model = np.abs(_model_along(plant, record, u))[valid[:-1] & valid[1:]]
        bound = np.max(np.where(np.isfinite(model), model, 0.0), axis=0, initial=0.0)
        for j, degree in enumerate(plant.degrees):
            good = np.convolve(valid, np.ones(degree + 1), "valid") > degree
            size = np.abs(np.diff(record.outputs[:, j], degree)) / h**degree
            bound[j] += np.max(size, where=good, initial=0.0)
        bounds.append(bound)
    largest = np.max(bounds, axis=0)
    return np.where(largest > 0, largest, 1.0)  # in whatever unit; nothing moves where it is zero


def _model_along(
    plant: Plant, record: Record, inputs: Float[np.ndarray, "steps nu"]
) -> Float[np.ndarray, "steps ny"]:
    """f at the nominal parameters along the measured outputs and their differences."""
    h, r = record.sample_period, plant.relative_degree
    rows = [0.5 * (record.outputs[1:] + record.outputs[:-1])]
    for degree in range(1, r):
        rate = np.diff(record.outputs, degree, axis=0) / h**degree
        rows.append(np.pad(rate, ((0, len(rows[0]) - len(rate)), (0, 0)), mode="edge"))
    states = np.stack(rows, axis=1)
    return np.asarray(_evaluate(plant, record.time[:-1], states, inputs))


@jit(static=())
def _evaluate(plant: Plant, time: Any, states: Any, inputs: Any) -> Float[Array, "steps ny"]:
    """f at every step, with the internal states where they start."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)
    u = plant.driven(jnp.asarray(time), jnp.asarray(inputs), theta)
    return jax.vmap(lambda t, y, u: plant.derivative(t, State(y, z), u, theta))(time, states, u)
