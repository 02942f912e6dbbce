r"""Default gains and filter cut-off, read off the records, with the reason in words.

The cut-off keeps the band in which the record says something about the plant: 99 % of the power of
y^(r), counted only where it stands above the measurement noise. The relay is set well above all
that it may have to inject, so that the implicit observer stays in sliding; in the implicit form a
large relay costs nothing (no chatter), and what noise it lets through, the filter removes.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.lowpass import LowPass
from eoi_jax.observers import FirstOrder, HighOrder, PerOutput, SecondOrder
from eoi_jax.observers.observer import AbstractObserver
from eoi_jax.plants.plant import Plant, State

_POWER = 0.99  # of y^(r) below the cut-off
_ABOVE_NOISE = 10.0  # power density of a frequency that counts as signal, over that of the noise
_FINE = 0.05  # cut-off times step
_MOST_SUBSTEPS = 20
_MOST_SAMPLES = 2_000_000  # beyond this the memory of a sub-stepped record would show
_RELAY = 2.0  # relay over the largest injection foreseen


def default_lowpass(plant: Plant, records: Sequence[Record]) -> tuple[LowPass, str]:
    """The filter (19) and the reason for its cut-off."""
    bands = [
        signal_band(record, j, degree)
        for record in records
        for j, degree in enumerate(plant.degrees)
    ]
    period = max(record.sample_period for record in records)
    duration = max(record.sample_period * len(record) for record in records)
    low, high = 20.0 / duration, 0.1 * 2.0 * np.pi / period
    band = float(np.max(bands))
    cutoff = float(np.clip(band, low, high))
    bound = {
        low: " (at least 20 over the record's length)",
        high: " (a tenth of the sampling rate)",
    }
    reason = (
        f"cut-off {cutoff:.4g} rad/s: {100 * _POWER:.0f} % of the power of the highest derivative "
        f"that stands above the noise lies below {band:.4g} rad/s{bound.get(cutoff, '')}"
    )
    return LowPass(cutoff), reason


def default_observer(
    plant: Plant, records: Sequence[Record], cutoff: float
) -> tuple[AbstractObserver, tuple[str, ...]]:
    """An implicit observer for each relative degree of the plant, and the reasons for its gains."""
    needed = _largest_injection(plant, records)
    chosen, reasons = [], []
    for j, degree in enumerate(plant.degrees):
        relay = _RELAY * float(needed[j])
        period = min(record.sample_period for record in records)
        noise = max(float(record.noise[j]) for record in records)
        ratio = period**degree * relay / noise if noise > 0 else np.inf
        # A first-order observer integrates its relay: it must reach the injection in one step.
        what = "delta" if degree == 1 else "relay"
        value = 2.0 * relay / period if degree == 1 else relay
        reasons.append(
            f"{plant.outputs[j]}: {what} {value:.3g}, {_RELAY:g} times the largest injection "
            f"foreseen at the nominal parameters ({needed[j]:.3g}); its reach over one step is "
            f"{ratio:.3g} times the measurement noise"
        )
        chosen.append(value)
    return _build(plant.degrees, np.asarray(chosen), cutoff), tuple(reasons)


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
    def one(degree: int, value: Float[np.ndarray, "..."]) -> AbstractObserver:
        if degree == 1:
            return FirstOrder(delta=value)
        if degree == 2:
            # Error dynamics (10) without its relay: two poles at the cut-off, damping 0.7.
            return SecondOrder(c1=1.4 * cutoff, c2=cutoff**2, c3=value)
        return HighOrder(bound=value, degree=degree)

    if len(set(degrees)) == 1:
        return one(degrees[0], gains)
    return PerOutput(tuple(one(degree, gains[j]) for j, degree in enumerate(degrees)))


def signal_band(record: Record, output: int, degree: int) -> float:
    """Frequency [rad/s] below which 99 % of the noise-free power of y^(degree) lies."""
    start, stop = max(record.segments(), key=lambda one: one[1] - one[0])
    y = record.outputs[start:stop, output]
    h, n = record.sample_period, stop - start
    line = np.polynomial.polynomial.polyfit(np.arange(n), y, 1)
    window = np.hanning(n)
    spectrum = np.abs(np.fft.rfft(window * (y - line[0] - line[1] * np.arange(n)))) ** 2
    omega = 2.0 * np.pi * np.fft.rfftfreq(n, h)
    floor = np.sum(window**2) * float(record.noise[output]) ** 2  # expected |FFT|² of white noise
    power = np.where(spectrum > _ABOVE_NOISE * floor, spectrum, 0.0) * omega ** (2 * degree)
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0.0
    return float(omega[np.searchsorted(total, _POWER * total[-1])])


def _largest_injection(plant: Plant, records: Sequence[Record]) -> Float[np.ndarray, " ny"]:
    """Bound on |y^(r) - f| at the nominal parameters: what differences show plus what f says."""
    bounds = []
    for record in records:
        h, valid = record.sample_period, record.valid
        model = np.abs(np.asarray(_model_along(plant, record)))[valid[:-1] & valid[1:]]
        bound = np.max(np.where(np.isfinite(model), model, 0.0), axis=0, initial=0.0)
        for j, degree in enumerate(plant.degrees):
            good = np.convolve(valid, np.ones(degree + 1), "valid") > degree
            size = np.abs(np.diff(record.outputs[:, j], degree)) / h**degree
            bound[j] += np.max(size, where=good, initial=0.0)
        bounds.append(bound)
    return np.maximum(np.max(bounds, axis=0), 1e-12)


def _model_along(plant: Plant, record: Record) -> Float[np.ndarray, "steps ny"]:
    """f at the nominal parameters along the measured outputs and their differences."""
    h, r = record.sample_period, plant.relative_degree
    rows = [0.5 * (record.outputs[1:] + record.outputs[:-1])]
    for degree in range(1, r):
        rate = np.diff(record.outputs, degree, axis=0) / h**degree
        rows.append(np.pad(rate, ((0, len(rows[0]) - len(rate)), (0, 0)), mode="edge"))
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def at(t, y, u):
        return plant.derivative(t, State(y, z), u, theta)

    states = np.stack(rows, axis=1)
    return jax.jit(jax.vmap(at))(record.time[:-1], states, record.midpoint_inputs())
