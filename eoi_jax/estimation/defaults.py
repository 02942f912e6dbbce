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
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.record import Record
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, HighOrder, PerOutput, SecondOrder
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.jacobians import derivatives
from eoi_jax.models.plant import Plant

_NOISE_SHARE = 1e-3  # rms of the noise in F[y^(r)] over that of the signal
_CHANCE = 1e-3  # that white noise shows a signal in any bin of a record
_SHARED = 35.0 / 18.0  # bins of a Hann window that carry as much as one alone: 1 + 2 (4/9 + 1/36)
_FLOOR_ERROR = 3.0 * np.sqrt(7.26)  # of σ² over 1/√n: three standard deviations, 8th difference
_NEIGHBOURS, _RATIO = 8, 0.05  # bins on each side that are averaged: fixed, and per bin
# A line: bins on each side that hold it (Hann), and its mean over that of its neighbours; the same
# of an input, from which on that drives it; share of an output's power from which on it is motion.
_LINE_WIDTH, _LINE, _DRIVEN, _MOTION = 2, 8.0, 3.0, 1e-2
_ROUNDED = 1e-12  # share of the power below which sums over a few bins are rounding
_CUTOFFS = 200  # that are tried
_BAND = 5e-3  # width of a band of frequencies in which a filter is taken to be flat, relative
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
    longest = max(_longest_run(record) for record in records)
    check(
        longest >= SHORTEST,
        "records",
        f"must hold a run of at least {SHORTEST} valid samples one after the other",
        f"{longest} at most: values are missing in between",
        "With two sensors of different rates keep the rows in which both have a value, or fill in "
        "the slower one; or use `refine`, which scores the samples that are there.",
    )


def _longest_run(record: Record) -> int:
    return max(stop - start for start, stop in record.segments())


def _torn(record: Record) -> bool:
    return _longest_run(record) < SHORTEST


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
    spectra: Sequence["Spectrum"], records: Sequence[Record], order: int
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


@dataclass(frozen=True)
class Spectrum:
    """Power of y^(r) over frequency, in any one unit.

    Attributes:
        omega: frequencies, evenly spaced [rad/s].
        signal: power of the signal at each, 0 where it is lost in the noise.
        own: of these what is the plant's motion, 0 in lines that come from elsewhere.
        noise: expected power of the measurement noise at each.
    """

    omega: Float[np.ndarray, " frequency"]
    signal: Float[np.ndarray, " frequency"]
    own: Float[np.ndarray, " frequency"]
    noise: Float[np.ndarray, " frequency"]

    def below(self, share: float, power: Float[np.ndarray, " frequency"]) -> float:
        """Frequency below which this share of a power lies [rad/s]; 0 without any."""
        total = np.cumsum(power)
        if total[-1] <= 0:
            return 0.0
        return float(self.omega[np.searchsorted(total, share * total[-1])])

    def quiet_cutoff(self, share: float, order: int) -> float:
        """Highest cut-off [rad/s] whose filter passes noise below `share` of the motion (rms)."""
        cutoffs = np.geomspace(self.omega[1], self.omega[-1], _CUTOFFS)
        omega, signal, noise = self._bands()
        # (ω/cut-off)^2r as a quotient: so many powers would take longer than a pass.
        top, bottom = ((one / self.omega[-1]) ** (2 * order) for one in (omega, cutoffs))
        gain = bottom[:, None] / (bottom[:, None] + top)
        quiet = cutoffs[gain @ noise <= share**2 * (gain @ signal)]
        return float(quiet[-1]) if len(quiet) else 0.0

    def _bands(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean frequency, motion and noise of bands so narrow that a filter is flat in each."""
        edges = np.geomspace(1.0, len(self.omega), round(np.log(len(self.omega)) / _BAND))
        first = np.unique(np.append(0, edges[:-1].astype(int)))
        sums = (np.add.reduceat(one, first) for one in (self.omega, self.own, self.noise))
        omega, signal, noise = sums
        return omega / np.diff(np.append(first, len(self.omega))), signal, noise


def spectrum(record: Record, output: int, degree: int) -> Spectrum:
    """Spectrum of the derivative of one output, over the longest run of valid samples."""
    omega, power, foreign, window = _periodogram(record, output)
    floor = np.sum(window**2) * float(record.noise[output]) ** 2  # expected |FFT|² of white noise
    derivative = omega ** (2 * degree)
    signal, own = (
        np.where(_above(one, floor, len(window)), one, 0.0) * derivative
        for one in (power, np.where(foreign, 0.0, power))
    )
    return Spectrum(omega, signal, own, floor * derivative)


def foreign_lines(record: Record, output: int) -> list[tuple[float, float]]:
    """Lines of an output that no input drives and that are no part of the motion.

    Args:
        record: of which the longest run of valid samples counts.
        output: its index.

    Returns:
        Frequency [rad/s] and rms [unit of y] of each, in their order; none where no input moves.
    """
    if _torn(record):
        return []
    omega, power, foreign, window = _periodogram(record, output)
    floor = np.sum(window**2) * float(record.noise[output]) ** 2
    edges = np.flatnonzero(np.diff(np.concatenate([[0], foreign.astype(int), [0]])))
    found = []
    for first, last in edges.reshape(-1, 2):
        held = power[first:last]
        size = max(np.sum(held) - len(held) * floor, 0.0)
        rms = np.sqrt(2.0 * size / (len(window) * np.sum(window**2)))
        found.append((float(held @ omega[first:last] / np.sum(held)), float(rms)))
    return found


def _periodogram(
    record: Record, output: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, |FFT|² of an output, which bins are lines from elsewhere, and the window."""
    start, stop = max(record.segments(), key=lambda one: one[1] - one[0])
    window = np.hanning(stop - start)
    power = _power(record.outputs[start:stop, output], window)
    omega = 2.0 * np.pi * np.fft.rfftfreq(stop - start, record.sample_period)
    lines = _lines(power, _LINE)
    if np.any(lines):
        moving = [u for u in record.inputs[start:stop].T if np.ptp(u) > 0.0]
        lines = _foreign(power, lines, [_power(u, window) for u in moving]) & bool(moving)
    return omega, power, lines, window


def _power(
    signal: Float[np.ndarray, " time"], window: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " frequency"]:
    """|FFT|² of what a straight line leaves."""
    middle = np.arange(len(signal)) - 0.5 * (len(signal) - 1)
    slope = middle @ signal / (middle @ middle)
    return np.abs(np.fft.rfft(window * (signal - np.mean(signal) - slope * middle))) ** 2


def _foreign(
    power: Float[np.ndarray, " frequency"],
    lines: Bool[np.ndarray, " frequency"],
    inputs: Sequence[Float[np.ndarray, " frequency"]],
) -> Bool[np.ndarray, " frequency"]:
    """Bins of lines that no input drives and that are no part of the motion: hum, vibration.

    A line of a thousandth of the motion can hold most of the power of its highest derivative, and
    says nothing about where the dynamics of the plant lie.
    """
    for u in inputs:
        lines = lines & ~_lines(u, _DRIVEN)
    held, _ = _within(power, _LINE_WIDTH)
    lines = lines & (held < _MOTION * np.sum(power)) & (held > _ROUNDED * np.sum(power))
    return _within(lines.astype(float), _LINE_WIDTH)[0] > 0.0


def _lines(power: Float[np.ndarray, " frequency"], ratio: float) -> Bool[np.ndarray, " frequency"]:
    """Where the mean of a few bins is so many times that of their neighbours, near and far.

    A free motion that decays within the record has skirts, which the near ones show.
    """
    line, narrow = _within(power, _LINE_WIDTH)
    around = [_within(power, reach) for reach in (_NEIGHBOURS, _reach(power))]
    above = [line * (wide - narrow) > ratio * narrow * (whole - line) for whole, wide in around]
    return above[0] & above[1]


def _reach(power: Float[np.ndarray, " frequency"]) -> np.ndarray:
    """Bins on each side of each one that count as neighbours."""
    return _NEIGHBOURS + (_RATIO * np.arange(len(power))).astype(int)


def _within(power: Float[np.ndarray, " frequency"], reach: Any) -> tuple[np.ndarray, np.ndarray]:
    """Sum over so many bins on each side of each one, and how many these are."""
    bins, total = np.arange(len(power)), np.concatenate([[0.0], np.cumsum(power)])
    first, last = np.maximum(bins - reach, 0), np.minimum(bins + reach + 1, len(power))
    return total[last] - total[first], last - first


def _above(
    power: Float[np.ndarray, " frequency"], floor: float, samples: int
) -> Bool[np.ndarray, " frequency"]:
    r"""Where the power, averaged over neighbours, is more than white noise gives by chance.

    The average spans a fixed ratio of frequencies: single bins at high frequency, which ω^2r weighs
    most, are many, and one of them exceeds its expectation manifold in every record. Over its
    expectation the mean of m bins is distributed as χ²/ν with ν = 2m/`_SHARED`, whose quantile is
    $(1 - 2/9ν + z \sqrt{2/9ν})^3$. The floor itself is an estimate.

    Source: Wilson and Hilferty, PNAS 17 (1931) 684.
    """
    total, count = _within(power, _reach(power))
    spread = _SHARED / (9.0 * count)  # 2/9ν
    z = NormalDist().inv_cdf(1.0 - _CHANCE / len(power))
    highest = (1.0 - spread + z * np.sqrt(spread)) ** 3 * (1.0 + _FLOOR_ERROR / np.sqrt(samples))
    return total / count > highest * floor


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
    return derivatives(plant, record.time[:-1], states, inputs)
