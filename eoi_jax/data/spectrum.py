"""Power of an output over frequency: what the plant moves, what comes from elsewhere, and noise.

Taken over the longest run of valid samples, behind a Hann window. Lines that no input has (hum,
vibration) are no motion of the plant. An output with a rate of its own is bridged, and its spectrum
ends at the Nyquist frequency of that rate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.masks import longest_run
from eoi_jax.data.record import Record


@dataclass(frozen=True)
class SpectrumSettings:
    """How signal, lines and noise are told apart in a spectrum behind a Hann window."""

    chance: float = 1e-3  # that white noise shows a signal in any bin of a record
    shared_bins: float = 35.0 / 18.0  # that carry as much as one alone: 1 + 2 (4/9 + 1/36)
    floor_error: float = 3.0 * 7.26**0.5  # of σ² over 1/√n: three deviations of an 8th difference
    neighbours: int = 8  # bins that are averaged on each side
    neighbour_ratio: float = 0.05  # further ones for each bin: a fixed ratio of frequencies
    line_width: int = 2  # bins on each side that hold a line
    line_ratio: float = 8.0  # mean of a line over that of its neighbours
    driven_ratio: float = 3.0  # the same of an input, from which on that drives the line
    motion_share: float = 1e-2  # of an output's power from which on a line is motion
    rounding: float = 1e-12  # share of the power below which sums over a few bins are rounding
    cutoffs: int = 200  # that are tried
    band_width: float = 5e-3  # of frequencies in which a filter is taken to be flat, relative


_SETTINGS = SpectrumSettings()


@dataclass(frozen=True)
class Spectrum:
    """Power of y^(r) over frequency, in any one unit.

    Attributes:
        omega: frequencies, evenly spaced [rad/s].
        signal: power of the signal at each, 0 where it is lost in the noise.
        motion: power of the plant's motion at each, 0 in lines of other sources.
        noise: expected power of the measurement noise at each.
    """

    omega: Float[np.ndarray, " frequency"]
    signal: Float[np.ndarray, " frequency"]
    motion: Float[np.ndarray, " frequency"]
    noise: Float[np.ndarray, " frequency"]

    def frequency_below(self, share: float, power: Float[np.ndarray, " frequency"]) -> float:
        """Frequency below which this share of a power lies [rad/s]; 0 for zero power."""
        total = np.cumsum(power)
        if total[-1] <= 0:
            return 0.0
        return float(self.omega[np.searchsorted(total, share * total[-1])])

    def quiet_cutoff(self, share: float, order: int) -> float:
        """Highest cut-off [rad/s] whose filter passes noise below `share` of the motion (rms)."""
        cutoffs = np.geomspace(self.omega[1], self.omega[-1], _SETTINGS.cutoffs)
        omega, signal, noise = self._bands()
        # (ω/cut-off)^2r as a quotient: so many powers would take longer than a pass.
        top, bottom = (
            (frequencies / self.omega[-1]) ** (2 * order) for frequencies in (omega, cutoffs)
        )
        gain = bottom[:, None] / (bottom[:, None] + top)
        quiet = cutoffs[gain @ noise <= share**2 * (gain @ signal)]
        return float(quiet[-1]) if len(quiet) else 0.0

    def _bands(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean frequency, motion and noise of bands so narrow that a filter is flat in each."""
        edges = np.geomspace(
            1.0, len(self.omega), round(np.log(len(self.omega)) / _SETTINGS.band_width)
        )
        first = np.unique(np.append(0, edges[:-1].astype(int)))
        sums = (np.add.reduceat(column, first) for column in (self.omega, self.motion, self.noise))
        omega, signal, noise = sums
        return omega / np.diff(np.append(first, len(self.omega))), signal, noise


def spectrum(record: Record, output: int, degree: int) -> Spectrum:
    """Spectrum of the derivative of one output, over the longest run of valid samples."""
    omega, power, foreign, window = _periodogram(record.bridged, output)
    floor = _floor(record, output, window)
    derivative = omega ** (2 * degree)
    signal, motion = (
        np.where(_exceeds_noise(spectral_power, floor, len(window)), spectral_power, 0.0)
        * derivative
        for spectral_power in (power, np.where(foreign, 0.0, power))
    )
    return Spectrum(omega, signal, motion, floor * derivative)


def foreign_lines(record: Record, output: int) -> list[tuple[float, float]]:
    """Lines of an output that no input drives and that are no part of the motion.

    Args:
        record: of which the longest run of valid samples counts.
        output: its index.

    Returns:
        Frequency [rad/s] and rms [unit of y] of each, in their order; none where no input moves.
    """
    record = record.bridged
    first, stop = longest_run(record, output)
    if stop - first < SHORTEST:
        return []
    omega, power, foreign, window = _periodogram(record, output)
    floor = _floor(record, output, window)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], foreign.astype(int), [0]])))
    lines = []
    for first, last in edges.reshape(-1, 2):
        line_power = power[first:last]
        size = max(np.sum(line_power) - len(line_power) * floor, 0.0)
        rms = np.sqrt(2.0 * size / (len(window) * np.sum(window**2)))
        lines.append((float(line_power @ omega[first:last] / np.sum(line_power)), float(rms)))
    return lines


def _floor(record: Record, output: int, window: np.ndarray) -> float:
    """Expected |FFT|² of the white noise of an output; of its own rate it is in a narrower band."""
    density = float(record.output_periods[output]) / record.sample_period
    return float(np.sum(window**2) * float(record.noise[output]) ** 2 * density)


def _periodogram(
    record: Record, output: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies, |FFT|² of an output, which bins are lines from elsewhere, and the window."""
    start, stop = longest_run(record, output)
    window = np.hanning(stop - start)
    power = _power(record.outputs[start:stop, output], window)
    omega = 2.0 * np.pi * np.fft.rfftfreq(stop - start, record.sample_period)
    lines = _lines(power, _SETTINGS.line_ratio)
    if np.any(lines):
        moving = [u for u in record.inputs[start:stop].T if np.ptp(u) > 0.0]
        lines = _foreign(power, lines, [_power(u, window) for u in moving]) & bool(moving)
    period = float(record.output_periods[output])
    if period > record.sample_period:
        within = slice(max(int(np.sum(omega <= np.pi / period)), 2))
        omega, power, lines = omega[within], power[within], lines[within]
    return omega, power, lines, window


def _power(
    signal: Float[np.ndarray, " time"], window: Float[np.ndarray, " time"]
) -> Float[np.ndarray, " frequency"]:
    """|FFT|² of a signal without its straight line."""
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
        lines = lines & ~_lines(u, _SETTINGS.driven_ratio)
    line_power, _ = _neighbour_sums(power, _SETTINGS.line_width)
    lines = (
        lines
        & (line_power < _SETTINGS.motion_share * np.sum(power))
        & (line_power > _SETTINGS.rounding * np.sum(power))
    )
    return _neighbour_sums(lines.astype(float), _SETTINGS.line_width)[0] > 0.0


def _lines(power: Float[np.ndarray, " frequency"], ratio: float) -> Bool[np.ndarray, " frequency"]:
    """Where the mean of a few bins is so many times that of their neighbours, near and far.

    A free motion that decays within the record has skirts, which the near ones show.
    """
    line, narrow = _neighbour_sums(power, _SETTINGS.line_width)
    neighbourhoods = [
        _neighbour_sums(power, reach) for reach in (_SETTINGS.neighbours, _reach(power))
    ]
    exceeds = [
        line * (wide - narrow) > ratio * narrow * (total - line) for total, wide in neighbourhoods
    ]
    return exceeds[0] & exceeds[1]


def _reach(power: Float[np.ndarray, " frequency"]) -> np.ndarray:
    """Neighbouring bins on each side of each bin."""
    return _SETTINGS.neighbours + (_SETTINGS.neighbour_ratio * np.arange(len(power))).astype(int)


def _neighbour_sums(
    power: Float[np.ndarray, " frequency"], reach: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Sum of each bin and of `reach` bins on each side, and the number of bins summed."""
    bins, total = np.arange(len(power)), np.concatenate([[0.0], np.cumsum(power)])
    first, last = np.maximum(bins - reach, 0), np.minimum(bins + reach + 1, len(power))
    return total[last] - total[first], last - first


def _exceeds_noise(
    power: Float[np.ndarray, " frequency"], floor: float, samples: int
) -> Bool[np.ndarray, " frequency"]:
    r"""Where the power, averaged over neighbours, is more than white noise gives by chance.

    The average spans a fixed ratio of frequencies: single bins at high frequency, which ω^2r weighs
    most, are many, and one of them exceeds its expectation manifold in every record. Over its
    expectation the mean of m bins is distributed as χ²/ν, ν = 2m / `shared_bins`, whose quantile is
    $(1 - 2/9ν + z \sqrt{2/9ν})^3$. The floor itself is an estimate.

    Source: Wilson and Hilferty, PNAS 17 (1931) 684.
    """
    total, count = _neighbour_sums(power, _reach(power))
    spread = _SETTINGS.shared_bins / (9.0 * count)  # 2/9ν
    z = NormalDist().inv_cdf(1.0 - _SETTINGS.chance / len(power))
    highest = (1.0 - spread + z * np.sqrt(spread)) ** 3 * (
        1.0 + _SETTINGS.floor_error / np.sqrt(samples)
    )
    return total / count > highest * floor
