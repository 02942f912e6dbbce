"""Input signals for experiments and simulations: NumPy functions of time, float64.

Every signal starts at the first stamp, whatever its time. Random signals take a seed; the same seed
gives the same signal.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax._checks import check, check_count, check_positive
from eoi_jax._types import TimeAxis
from eoi_jax.data.resampling import Real


def square(
    time: Any, amplitude: Real, frequency: Real, offset: Real = 0.0, duty: Real = 0.5
) -> TimeAxis:
    """Square wave: offset + amplitude, then offset − amplitude.

    Args:
        time: stamps (N,) [s].
        amplitude: half of the jump.
        frequency: [Hz].
        offset: mean at half duty.
        duty: share of each period spent at the upper level, in (0, 1).

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range.
    """
    tau = _elapsed(time)
    _check_finite("amplitude", amplitude)
    check_positive("frequency", frequency)
    _check_finite("offset", offset)
    check(bool(0 < duty < 1), "duty", "must lie in (0, 1)", duty)
    # The shift assigns a stamp that is rounded to just before an edge to the level after the edge.
    phase = np.mod(tau * float(frequency) + 1e-9, 1.0)
    return float(offset) + float(amplitude) * np.where(phase < duty, 1.0, -1.0)


def prbs(time: Any, amplitude: Real, switching_period: Real, seed: int) -> TimeAxis:
    """Pseudo-random binary signal: ± amplitude, drawn at random every `switching_period`.

    Args:
        time: stamps (N,) [s].
        amplitude: of both levels.
        switching_period: shortest time between two switches [s].
        seed: integer ≥ 0.

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range.
    """
    _check_finite("amplitude", amplitude)
    slot = _slot(_elapsed(time), "switching_period", switching_period)
    signs = 2.0 * _draw(seed).integers(0, 2, int(slot[-1]) + 1) - 1.0
    return float(amplitude) * signs[slot]


def chirp(time: Any, amplitude: Real, start: Real, stop: Real) -> TimeAxis:
    """Sine whose frequency changes linearly from `start` to `stop` [Hz] over the whole of `time`.

    Args:
        time: stamps (N,) [s].
        amplitude: peak value.
        start: frequency at the first stamp [Hz].
        stop: frequency at the last stamp [Hz].

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range.
    """
    tau = _elapsed(time)
    _check_finite("amplitude", amplitude)
    check_positive("start", start)
    check_positive("stop", stop)
    rate = (float(stop) - float(start)) / tau[-1]
    return float(amplitude) * np.sin(2 * np.pi * (float(start) * tau + 0.5 * rate * tau**2))


def multisine(
    time: Any, amplitude: Real, frequencies: tuple[Real, Real], components: int, seed: int
) -> TimeAxis:
    r"""Sum of cosines of equal size and random phase, $a\sqrt{2/n}\sum\cos(2\pi f_i t + \phi_i)$.

    The frequencies are spread over the band and moved to the nearest multiple of 1/duration: the
    record is exactly a period, and its rms is `amplitude`.

    Args:
        time: uniform stamps (N,) [s].
        amplitude: root mean square of the signal (not its peak).
        frequencies: band (low, high) [Hz], below half the sampling frequency.
        components: number n of cosines.
        seed: of the phases, integer ≥ 0.

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range, or more components than multiples of
            1/duration in the band.
    """
    tau = _elapsed(time)
    _check_finite("amplitude", amplitude)
    check_count("components", components)
    duration = tau[-1] * len(tau) / (len(tau) - 1)
    low, high = (float(value) for value in frequencies)
    nyquist = 0.5 * len(tau) / duration
    check(
        0 < low <= high < nyquist,
        "frequencies",
        f"must be (low, high) with 0 < low ≤ high < {nyquist:g} Hz, half the sampling frequency",
        (low, high),
    )
    rule = f"must begin at 1/duration, {1 / duration:g} Hz, or above"
    advice = "A lower frequency has no whole period in the record: begin there, or make it longer."
    check(np.rint(low * duration) >= 1, "frequencies", rule, (low, high), advice)

    def lines_of(count: int) -> TimeAxis:
        return np.rint(np.linspace(low, high, count) * duration)

    lines = lines_of(components)
    if len(np.unique(lines)) < components:
        most = int(np.rint(high * duration) - np.rint(low * duration)) + 1
        fitting = next(n for n in range(most, 0, -1) if len(np.unique(lines_of(n))) == n)
        rule = f"must fit between {low:g} and {high:g} Hz at a spacing of {1 / duration:g} Hz"
        advice = f"Take {fitting}, a wider band or a longer record."
        check(False, "components", rule, components, advice)
    phases = _draw(seed).uniform(0, 2 * np.pi, components)
    total = np.zeros_like(tau)
    for line, phase in zip(lines, phases, strict=True):  # N × n at once may not fit in memory
        total += np.cos(2 * np.pi * line / duration * tau + phase)
    return float(amplitude) * np.sqrt(2 / components) * total


def steps(time: Any, levels: Sequence[Real] | np.ndarray, holding_time: Real) -> TimeAxis:
    """Levels in sequence, each for `holding_time` [s]; the last one stays.

    Args:
        time: stamps (N,) [s].
        levels: values, in their order.
        holding_time: of each level [s].

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range.
    """
    values = np.asarray(levels, dtype=float)
    good = values.ndim == 1 and values.size > 0 and bool(np.all(np.isfinite(values)))
    check(good, "levels", "must be a list of finite numbers", levels)
    slot = _slot(_elapsed(time), "holding_time", holding_time)
    return values[np.minimum(slot, len(values) - 1)]


def random_steps(time: Any, low: Real, high: Real, holding_time: Real, seed: int) -> TimeAxis:
    """Levels drawn uniformly from [low, high], a new one every `holding_time` [s].

    Args:
        time: stamps (N,) [s].
        low: smallest level.
        high: largest level.
        holding_time: of each level [s].
        seed: integer ≥ 0.

    Returns:
        The signal at the stamps, shape (N,).

    Raises:
        ValueError: an argument out of its range.
    """
    _check_finite("low", low)
    _check_finite("high", high)
    check(bool(low < high), "low", f"must be below `high` = {high}", low)
    slot = _slot(_elapsed(time), "holding_time", holding_time)
    return _draw(seed).uniform(float(low), float(high), int(slot[-1]) + 1)[slot]


def _elapsed(time: Any) -> TimeAxis:
    stamps = np.asarray(time, dtype=float)
    check(
        stamps.ndim == 1 and stamps.size >= 2,
        "time",
        "must have shape (N,) with N ≥ 2",
        f"shape {stamps.shape}",
    )
    increasing = bool(np.all(np.isfinite(stamps)) and np.all(np.diff(stamps) > 0))
    check(increasing, "time", "must be finite and increasing", stamps)
    return stamps - stamps[0]


def _slot(tau: TimeAxis, name: str, length: Real) -> np.ndarray:
    """Number of complete intervals elapsed; a stamp rounded to just below an edge is on it."""
    check_positive(name, length)
    return np.floor(tau / float(length) + 1e-6).astype(np.int64)


def _draw(seed: int) -> np.random.Generator:
    return np.random.default_rng(check_count("seed", seed, minimum=0))


def _check_finite(name: str, value: Real) -> None:
    check(bool(np.isfinite(value)), name, "must be finite", value)
