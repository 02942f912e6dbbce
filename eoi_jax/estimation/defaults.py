r"""Default gains, filter, smoothing and sub-steps, chosen from the records, each with its reason.

**Filter.** Least squares on F[y^(r)] is disturbed by the measurement noise that F lets through,
whose density grows as ω^2r. The cut-off is the highest at which that noise stays below a
thousandth of F[y^(r)] (both rms), yet at least the frequency that halves the power of y^(r), so
that the plant's dynamics stay inside, and at most the one below which 99 % of it lies. Spectral
lines that no input has (hum, vibration) are not part of y^(r) here. One pole more than the number
of derivatives bounds the noise at any sampling rate. Records that are much shorter than others are
not used: their spectra show mainly their length. Outputs of relative degree 0 are not
differentiated and ask for no filter: where there are no others, F passes all that it can.

**Relay.** It is set well above the largest injection that it may need, so that the implicit
observer stays in sliding mode; in the implicit form a large relay does not chatter, and the filter
removes the noise that it passes.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from eoi_jax._checks import check, warn_caller
from eoi_jax.data.cleaning import SHORTEST, SLOW
from eoi_jax.data.masks import longest_run, valid_steps
from eoi_jax.data.noise import white_noise
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs
from eoi_jax.data.spectrum import Spectrum, spectrum
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import (
    FirstOrder,
    HighOrder,
    Measurement,
    PerOutput,
    SecondOrder,
)
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.jacobians import derivatives
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import affine_inputs
from eoi_jax.simulation.step_size import RULES as STEP_RULES
from eoi_jax.simulation.step_size import fastest_mode


@dataclass(frozen=True)
class DefaultRules:
    """Numbers by which the defaults are chosen."""

    max_noise: float = 1e-3  # rms of the noise in F[y^(r)] over that of the signal
    max_velocity_noise: float = 0.01  # rms over that of the velocity; smoothed if it is larger
    smoothing_ratio: float = 5.0  # cut-off of the smoothing over that of F
    max_step: float = 0.012  # cut-off [rad/s] times step [s]
    max_substeps: int = 20  # per sample
    max_samples: int = 2_000_000  # of a record with sub-steps, because of its memory
    # |λh| of the fastest mode of the internal states, with inputs that move within a step: an error
    # of 1e-4 of that mode.
    max_mode: float = 0.05
    # A record below both is not used.
    min_time_constants: float = 20.0  # of F, in the length of a record
    min_length_ratio: float = 0.1  # of its length to that of the longest record
    relay_ratio: float = 2.0  # of the relay to the largest injection foreseen
    leak: float = 1.0  # of a first-order observer, whose relay is integrated [1/s]


_RULES = DefaultRules()


def default_lowpass(plant: Plant, records: Sequence[Record]) -> tuple[LowPass, str]:
    """The filter (19) for these records, and the reason for its cut-off."""
    order = plant.relative_degree + 1
    if not any(plant.degrees):
        cutoff = 0.2 * np.pi / max(record.sample_period for record in records)
        return LowPass(
            cutoff, order
        ), f"cut-off {cutoff:.4g} rad/s, order {order}: {_NO_DERIVATIVE}"

    @functools.cache
    def spectra_of(i: int) -> list[Spectrum]:
        pairs = enumerate(plant.degrees)
        return [spectrum(records[i], j, degree) for j, degree in pairs if degree]

    def choose_cutoff(is_short: Sequence[bool]) -> tuple[float, str]:
        used = [i for i, excluded in enumerate(is_short) if not excluded]
        spectra = [output_spectrum for i in used for output_spectrum in spectra_of(i)]
        return _cutoff(spectra, [records[i] for i in used], order)

    shortest = too_short(records, 0.0)
    cutoff, reason = choose_cutoff(shortest)
    is_short = too_short(records, cutoff)
    if is_short != shortest:
        cutoff, reason = choose_cutoff(is_short)
    return LowPass(cutoff, order), f"cut-off {cutoff:.4g} rad/s, order {order}: {reason}"


_NO_DERIVATIVE = "a tenth of the sampling rate, as no output is differentiated"


def too_short(records: Sequence[Record], cutoff: float) -> tuple[bool, ...]:
    """Which records are too short, or have too many gaps, to be used for choices.

    Args:
        records: of one estimate.
        cutoff: of F [rad/s]; 0 for any F.
    """
    lengths = [record.sample_period * len(record) for record in records]
    shortest = _RULES.min_length_ratio * max(lengths)
    torn = [_torn(record) for record in records]
    return tuple(
        (is_torn and not all(torn))
        or (length < shortest and length * cutoff < _RULES.min_time_constants)
        for is_torn, length in zip(torn, lengths, strict=True)
    )


def check_runs_of_samples(records: Sequence[Record]) -> None:
    """Check that differences between consecutive samples of each output can be taken.

    Args:
        records: of one estimate, bridged.

    Raises:
        ValueError: no record with a run of valid samples that is long enough.
    """
    runs = np.stack([_run_lengths(record) for record in records])
    output = int(np.argmin(np.max(runs, axis=0)))
    longest = int(np.max(runs[:, output]))
    check(
        longest >= SHORTEST,
        "records",
        f"must hold a run of at least {SHORTEST} valid samples one after the other of each output",
        f"{longest} at most of {records[0].output_names[output]}: values are missing in between",
        "Use `refine`, which scores the samples that are there.",
    )


def _run_lengths(record: Record) -> Int[np.ndarray, " ny"]:
    """Samples of each output that follow each other, at most."""
    ends = [longest_run(record, j) for j in range(record.outputs.shape[1])]
    return np.asarray([stop - first for first, stop in ends])


def _torn(record: Record) -> bool:
    return bool(np.min(_run_lengths(record.bridged)) < SHORTEST)


def short_record_notes(records: Sequence[Record], cutoff: float, consequence: str) -> list[str]:
    """One sentence for each record that is too short (`too_short`).

    Args:
        records: of one estimate.
        cutoff: of F [rad/s].
        consequence: end of the sentence.
    """

    def reason(record: Record) -> str:
        if _torn(record):
            return f"no {SHORTEST} valid samples follow each other"
        duration = record.sample_period * len(record)
        return (
            f"{duration:.3g} s are too short beside the other records, less than "
            f"{_RULES.min_time_constants:g} time constants of the filter"
        )

    is_short = too_short(records, cutoff)
    return [
        f"{record.name}: {reason(record)}: {consequence}"
        for i, record in enumerate(records)
        if is_short[i]
    ]


def _cutoff(
    spectra: Sequence[Spectrum], records: Sequence[Record], order: int
) -> tuple[float, str]:
    """Cut-off [rad/s] for records with these spectra of y^(r), and the reason."""
    half_power = max(
        output_spectrum.frequency_below(0.5, output_spectrum.motion) for output_spectrum in spectra
    )
    highest = max(
        output_spectrum.frequency_below(0.99, output_spectrum.signal) for output_spectrum in spectra
    )
    share = _RULES.max_noise
    quiet = min(output_spectrum.quiet_cutoff(share, order) for output_spectrum in spectra)
    choices = {
        f"the highest with noise below {share:g} of the filtered highest derivative": quiet,
        "below it lie 99 % of the power of the highest derivative": highest,
    }
    reason = min(choices, key=lambda key: choices[key])
    cutoff = choices[reason]
    duration = max(record.sample_period * len(record) for record in records)
    # F acts on all equations, in which the slowest output may stand.
    period = max(float(np.max(record.output_periods)) for record in records)
    slow = any(np.max(record.output_periods) > SLOW * record.sample_period for record in records)
    rate = "a tenth of the sampling rate" + (" of the slowest output" if slow else "")
    for bound_reason, limit, bound in (
        ("below it lies half of the power of the highest derivative", max, half_power),
        ("twenty over the record's length", max, 20.0 / duration),
        (rate, min, 0.2 * np.pi / period),
    ):
        if limit(cutoff, bound) != cutoff:
            reason, cutoff = bound_reason, bound
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
    injection = _largest_injection(plant, records, inputs)
    gains, reasons, relay_ratio = [], [], _RULES.relay_ratio
    for j, degree in enumerate(plant.degrees):
        if degree == 0:
            gains.append(0.0)
            continue
        relay = relay_ratio * float(injection[j])
        period = min(record.sample_period for record in records)
        noise = max(float(record.noise[j]) for record in records)
        ratio = (substeps * period) ** degree * relay / noise if noise > 0 else np.inf
        # A first-order observer integrates its relay with a leak: it must reach the injection in
        # one step, h δ/(1 + h T), also where the step h is longer than 1/T.
        gain = "delta" if degree == 1 else "relay"
        value = 2.0 * relay * (1.0 / period + _RULES.leak) if degree == 1 else relay
        reach = ", which injects in one step" if degree == 1 else ","
        reasons.append(
            f"{plant.outputs[j]}: {gain} {value:.3g}{reach} {relay_ratio:g} times the largest "
            f"injection foreseen at the nominal parameters ({injection[j]:.3g}); its reach over "
            f"one sample is {ratio:.3g} times the measurement noise"
        )
        gains.append(value)
    return _build(plant.degrees, np.asarray(gains), cutoff), tuple(reasons)


def default_smoothing(
    plant: Plant, records: Sequence[Record], cutoff: float
) -> tuple[float | bool, list[str]]:
    """Zero-phase cut-off [rad/s] for records whose noise hides the velocity, else False; and why.

    The model reads the velocity before the filter F: sign(ẏ) or ẏ|ẏ| of a noisy velocity has a
    bias that no filter behind it can remove.
    """
    if plant.has_algebraic:  # smoothed beside its input, a jump of y is no jump of u any more
        return False, []
    smoothing = _RULES.smoothing_ratio * cutoff
    is_short = too_short(records, cutoff)
    used_records = [
        record for record, excluded in zip(records, is_short, strict=True) if not excluded
    ]
    has_velocity = np.asarray(plant.degrees) > 1
    noisy = False
    for record in used_records:
        rates = np.diff(record.outputs, axis=0) / record.sample_period
        rms = np.sqrt(np.mean(rates**2, axis=0))
        limit = _RULES.max_velocity_noise * rms
        noisy |= bool(np.any((rate_noise(record, False) > limit) & has_velocity))
    if not noisy or smoothing > 0.9 * min(np.pi / record.sample_period for record in records):
        return False, []
    raw_noise, smoothed_noise = (
        max(float(np.max(rate_noise(record, cutoff))) for record in used_records)
        for cutoff in (False, smoothing)
    )
    reason = (
        f"smoothed at {smoothing:.4g} rad/s, {_smoothed_channels(plant)}, zero phase: the noise of "
        f"the velocity falls from {raw_noise:.2g} to {smoothed_noise:.2g}"
    )
    return smoothing, [reason]


def _smoothed_channels(plant: Plant) -> str:
    raw = [
        name for name, affine in zip(plant.inputs, affine_inputs(plant), strict=True) if not affine
    ]
    if not raw:
        return "outputs and inputs alike"
    return f"outputs, and inputs but for those in which the model is not affine ({', '.join(raw)})"


def output_noise(
    plant: Plant, record: Record, fewest: int = 200, shortest: int = 12
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the white noise of each output [unit of y].

    An output of relative degree 0 may jump with a held input, and jumps are no noise: differences
    are taken between them where that leaves enough samples.

    Args:
        plant: with its relative degrees.
        record: measured.
        fewest: samples in all stretches with a constant input.
        shortest: samples of such a stretch.
    """
    held = record.inputs[:, [hold == "zero" for hold in record.holds]]
    if not plant.has_algebraic or (record.holds and not held.shape[1]):
        return record.noise
    still = np.all(held[1:] == held[:-1], axis=1)
    stretches = [(i, j) for i, j in runs(record.valid, still) if j - i >= shortest]
    if sum(stop - start for start, stop in stretches) < fewest:
        return record.noise
    steady = np.maximum(white_noise(record.outputs, stretches), record.quantum / np.sqrt(12.0))
    return np.where(plant.algebraic, np.minimum(steady, record.noise), record.noise)


def rate_noise(record: Record, smoothing: float | bool) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the noise in a velocity taken over one step [unit of y / s].

    White noise σ per sample gives √2 σ/h; behind a zero-phase low-pass of cut-off ω it gives
    σ √(h ω³/3π), with the period h of the output.
    """
    h = record.output_periods
    if smoothing:
        return record.noise * np.sqrt(h * float(smoothing) ** 3 / (3.0 * np.pi))
    return np.sqrt(2.0) * record.noise / h


def velocity_noise(
    degrees: Sequence[int], record: Record, smoothing: float | bool
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the noise of each output's velocity over one step [unit of y / s].

    An output of relative degree one is taken as a velocity itself [unit of y].
    """
    speed = record.noise
    if smoothing:
        share = np.sqrt(record.output_periods * float(smoothing) / np.pi)
        speed = speed * np.minimum(share, 1.0)
    return np.where(np.asarray(degrees) == 1, speed, rate_noise(record, smoothing))


def default_transient(records: Sequence[Record], lowpass: LowPass, explicit: bool) -> float:
    """Ten time constants of F, at most a fifth of the shortest record in use [s].

    An explicit observer also has to reach sliding mode, which takes about a second with published
    gains.
    """
    is_short = too_short(records, lowpass.cutoff)
    pairs = zip(records, is_short, strict=True)
    shortest = min(record.sample_period * len(record) for record, excluded in pairs if not excluded)
    return min(10.0 / lowpass.cutoff + (1.0 if explicit else 0.0), 0.2 * shortest)


def default_substeps(
    plant: Plant, records: Sequence[Record], cutoff: float
) -> tuple[int, list[str]]:
    """Sub-steps per sample that make the step short, and why.

    For outputs that are differentiated, against the band of F: model and measurement are averaged
    over a step by kernels that agree to second order, and the error at the frequency ω is a share
    (ω h)²/6 of the highest derivative. Where all outputs are functions of the states (relative
    degree 0), against the fastest mode of the internal states.

    Args:
        plant: with its parameter values.
        records: as measured.
        cutoff: of F [rad/s].
    """
    if not any(plant.degrees):
        return _mode_substeps(plant, records)
    period = max(record.sample_period for record in records)
    substeps = _limited(cutoff * period / _RULES.max_step, records)
    if substeps == 1:
        return 1, []
    error = (cutoff * period / substeps) ** 2 / 6.0
    reason = (
        f"{substeps} sub-steps a sample: the discretisation error at the cut-off falls from "
        f"{substeps**2 * error:.2g} to {error:.2g} of the highest derivative"
    )
    return substeps, [reason]


def _mode_substeps(plant: Plant, records: Sequence[Record]) -> tuple[int, list[str]]:
    """Sub-steps per sample that follow the fastest mode λ of the internal states, and why.

    A step takes its inputs as constant. Of those that move within it, λ passes on all but a share
    (λh)²/24; of those that are held, a step of the Runge-Kutta rule misses (λh)⁵/120.
    """
    if plant.internal is None:
        return 1, []
    rates = [fastest_mode(plant, record) for record in records]
    shares = [rate * record.sample_period for rate, record in zip(rates, records, strict=True)]
    fastest = int(np.argmax(shares))
    constant = plant.actuator is None and all(set(record.holds) <= {"zero"} for record in records)
    longest = STEP_RULES.mode if constant else _RULES.max_mode
    substeps = _limited(shares[fastest] / longest, records)
    if substeps == 1:
        return 1, []
    errors = [
        (share**5 / 120.0 if constant else share**2 / 24.0)
        for share in (shares[fastest], shares[fastest] / substeps)
    ]
    reason = (
        f"{substeps} sub-steps a sample: the discretisation error at the fastest mode of the "
        f"internal states, {rates[fastest]:.4g} rad/s, falls from {errors[0]:.2g} to "
        f"{errors[1]:.2g}"
    )
    return substeps, [reason]


def _limited(wanted: float, records: Sequence[Record]) -> int:
    """So many sub-steps, rounded up, or as many as the memory allows."""
    longest = max(len(record) for record in records)
    most = max(min(_RULES.max_substeps, _RULES.max_samples // longest), 1)
    return int(np.ceil(np.clip(wanted, 1, most)))


def _build(
    degrees: tuple[int, ...], gains: Float[np.ndarray, " ny"], cutoff: float
) -> AbstractObserver:
    def build_observer(degree: int, value: Any) -> AbstractObserver:
        if degree == 0:
            return Measurement()
        if degree == 1:
            return FirstOrder(delta=value, leak=_RULES.leak)
        if degree == 2:
            # Error dynamics (10) without its relay: two poles at the cut-off, damping 0.7.
            return SecondOrder(c1=1.4 * cutoff, c2=cutoff**2, c3=value)
        return HighOrder(bound=value, degree=degree)

    if len(set(degrees)) == 1:
        return build_observer(degrees[0], gains)
    return PerOutput(tuple(build_observer(degree, gains[j]) for j, degree in enumerate(degrees)))


def _largest_injection(
    plant: Plant, records: Sequence[Record], inputs: Sequence[Float[np.ndarray, "_ nu"]]
) -> Float[np.ndarray, " ny"]:
    """Bound on |y^(r) - f| at the nominal parameters: largest differences plus largest |f|."""
    bounds = []
    for record, u in zip(records, inputs, strict=True):
        h, steps = record.sample_period, valid_steps(record)
        model = np.abs(_model_values(plant, record, u))
        bound = np.max(np.where(np.isfinite(model) & steps, model, 0.0), axis=0, initial=0.0)
        for j, degree in enumerate(plant.degrees):
            valid = record.output_valid[:, j]
            good = np.convolve(valid, np.ones(degree + 1), "valid") > degree
            size = np.abs(np.diff(record.outputs[:, j], degree)) / h**degree
            bound[j] += np.max(size, where=good, initial=0.0)
        bounds.append(bound)
    largest = np.max(bounds, axis=0)
    return np.where(largest > 0, largest, 1.0)  # zero only if nothing moves


def _model_values(
    plant: Plant, record: Record, inputs: Float[np.ndarray, "steps nu"]
) -> Float[np.ndarray, "steps ny"]:
    """f at the nominal parameters, with differences of the measured outputs as derivatives."""
    h, r = record.sample_period, plant.rows
    rows = [0.5 * (record.outputs[1:] + record.outputs[:-1])]
    for degree in range(1, r):
        rate = np.diff(record.outputs, degree, axis=0) / h**degree
        rows.append(np.pad(rate, ((0, len(rows[0]) - len(rate)), (0, 0)), mode="edge"))
    states = np.stack(rows, axis=1)
    return derivatives(plant, record.time[:-1], states, inputs)


def precision_notes() -> list[str]:
    """A note, and a warning, where arrays are in single precision."""
    if jnp.result_type(float) == jnp.float64:
        return []
    note = (
        "runs in single precision: differences of a finely sampled record lose most of its "
        "digits. Call `eoi_jax.configure()` first for double precision"
    )
    warn_caller(note, RuntimeWarning)
    return [note]
