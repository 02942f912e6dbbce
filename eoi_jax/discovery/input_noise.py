r"""What the noise of a logged input lets free runs of a right model miss by.

A torque that is computed from a current, or a flow that is measured, has noise in the log that
never acted. A random excitation looks the same, and did act. Two things tell them apart: an input
that is held at levels scatters about the mean of each, $u = \bar u + s$; and with $\hat y$ the
free run and $\bar{\hat y}$ that with $\bar u$ in place of u, what the records show on a level
beside a parabola in time,

$$ y - \bar{\hat y} = a (\hat y - \bar{\hat y}) + e, $$

has a = 1 where the scatter acted, and a = 0 where it is noise of the log. Only where a is below one
half by more than chance is it noise. Free runs with as much noise again, drawn at random, then
differ from those without by what the noise of the log makes them miss by.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs as runs_of
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import runs_in
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class InputNoiseSettings:
    """When an input is held at levels with noise, and how often noise is drawn."""

    step: float = 6.0  # between means of `shortest` samples, in their standard deviations
    shortest: int = 8  # samples of a level, to tell its mean and its parabola
    fewest: int = 5  # levels of a record
    covered: float = 0.5  # share of its samples on levels, at least
    share: float = 0.1  # of the input's power that is scatter, at most
    white: float = 0.7  # mean square of differences over twice the variance; 1 of white noise
    deviations: float = 3.0  # by which a is below one half, in its standard errors
    draws: int = 4  # of noise: the mean square is then known to a third
    # Square of the errors over that of what noise in the records themselves makes: parameters that
    # were fitted to inputs as noisy err by about as much again.
    fitted: float = 2.0


_SETTINGS = InputNoiseSettings()

Levels = list[tuple[int, int]]


def error_of_input_noise(plant: Plant, run: Validation) -> Float[np.ndarray, " ny"]:
    """Root mean square of what noise in the log of inputs makes free runs miss by [unit of y].

    Args:
        plant: the model, with its estimate.
        run: its free runs, on records that no fit has seen.

    Returns:
        Zero where inputs are not seen to be noisy.
    """
    square = np.zeros(len(run.outputs))
    if run.in_loop or not run.scored_at:
        return square
    levels = [[_levels(column) for column in record.inputs.T] for record in run.records]
    if not any(any(of_record) for of_record in levels) or not _is_noise(plant, run, levels):
        return square
    draw = np.random.default_rng(0)
    for _ in range(_SETTINGS.draws):
        records = [_with_noise(*pair, draw) for pair in zip(run.records, levels, strict=True)]
        square += _distance_squared(run, _again(plant, records, run)) / _SETTINGS.draws
    return np.sqrt(_SETTINGS.fitted * square)


def white_deviation(values: Float[np.ndarray, " time"]) -> float:
    """Standard deviation of white noise, of whose differences most are those of the values."""
    return float(np.median(np.abs(np.diff(values)))) / 0.6745 / np.sqrt(2.0)


def _levels(values: Float[np.ndarray, " time"]) -> Levels:
    """Parts (start, stop) of an input that stands at a level but for white noise; none without."""
    count = _SETTINGS.shortest
    if len(values) < 2 * count:
        return []
    deviation = white_deviation(values)
    if not 0.0 < deviation**2 < _SETTINGS.share * np.var(values):
        return []
    means = np.mean(sliding_window_view(values, count), axis=1)
    jumps = np.zeros(len(values) + 1)
    jumps[count : len(values) - count + 1] = np.abs(means[count:] - means[:-count])
    largest = np.max(sliding_window_view(np.pad(jumps, count), 2 * count + 1), axis=1)
    limit = _SETTINGS.step * deviation * np.sqrt(2.0 / count)
    ends = np.flatnonzero((jumps > limit) & (jumps == largest)).tolist()
    parts = [
        (start, stop)
        for start, stop in pairwise([0, *ends, len(values)])
        if stop - start >= count and is_white(values[start:stop])
    ]
    covered = sum(stop - start for start, stop in parts)
    is_held = len(parts) >= _SETTINGS.fewest and covered >= _SETTINGS.covered * len(values)
    return parts if is_held else []


def is_white(part: Float[np.ndarray, " samples"]) -> bool:
    """Whether differences have the variance of white noise (J. von Neumann's ratio)."""
    variance = float(np.var(part, ddof=1))
    return bool(np.mean(np.diff(part) ** 2) > 2.0 * _SETTINGS.white * variance > 0.0)


def _is_noise(plant: Plant, run: Validation, levels: Sequence[Sequence[Levels]]) -> bool:
    """Whether some output is seen not to follow the scatter about the levels."""
    records = [_at_levels(*pair) for pair in zip(run.records, levels, strict=True)]
    level_run = _again(plant, records, run)
    products: list[list[tuple[float, float, float]]] = [[] for _ in run.outputs]
    for index, record in enumerate(run.records):
        both = [part for column in levels[index] for part in column]
        level = level_run.predictions[index].outputs
        response = run.predictions[index].outputs - level
        error = record.outputs - level
        for j, place in _places(record, run.scored_at[index], both):
            d, e = (_beside_parabola(signal[place, j]) for signal in (response, error))
            products[j].append((float(d @ d), float(e @ d), float(e @ e)))
    return any(map(_follows_not, products))


def _places(
    record: Record, scored: Bool[np.ndarray, " time"], levels: Levels
) -> Iterator[tuple[int, slice]]:
    """Output and samples of each part of a level that one free run scores."""
    for j, valid in enumerate(record.output_valid.T):
        for start, stop in levels:
            for first, last in runs_of((valid & scored)[start:stop]):
                if last - first >= _SETTINGS.shortest:
                    yield j, slice(start + first, start + last)


def _beside_parabola(signal: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
    t = np.linspace(-1.0, 1.0, len(signal))
    basis, _ = np.linalg.qr(np.stack([np.ones_like(t), t, t**2], axis=1))
    return signal - basis @ (basis.T @ signal)


def _follows_not(products: Sequence[tuple[float, float, float]]) -> bool:
    """Whether a is below one half by more than chance, the parts of levels being independent."""
    if len(products) < _SETTINGS.fewest:
        return False
    square, product, _ = np.asarray(products).T
    if not square.sum() > 0.0:
        return False
    slope = product.sum() / square.sum()
    error = np.sqrt(np.sum((product - slope * square) ** 2)) / square.sum()
    return bool(slope + _SETTINGS.deviations * error < 0.5)


def _at_levels(record: Record, levels: Sequence[Levels]) -> Record:
    inputs = record.inputs.copy()
    for j, parts in enumerate(levels):
        for start, stop in parts:
            inputs[start:stop, j] = np.mean(inputs[start:stop, j])
    return record.with_inputs(inputs, record.input_names, record.skew, record.hold)


def _with_noise(record: Record, levels: Sequence[Levels], draw: np.random.Generator) -> Record:
    inputs = record.inputs.copy()
    for j, parts in enumerate(levels):
        if parts:
            power = np.mean([np.var(inputs[start:stop, j], ddof=1) for start, stop in parts])
            inputs[:, j] += np.sqrt(power) * draw.standard_normal(len(inputs))
    return record.with_inputs(inputs, record.input_names, record.skew, record.hold)


def _again(plant: Plant, records: Sequence[Record], run: Validation) -> Validation:
    return runs_in(run.window, plant, records, run.substeps or None)


def _distance_squared(first: Validation, second: Validation) -> Float[np.ndarray, " ny"]:
    """Mean square difference of two predictions of the same runs."""
    squares, counts = np.zeros(len(first.outputs)), np.zeros(len(first.outputs))
    pairs = zip(first.predictions, second.predictions, strict=True)
    for record, predicted, scored in zip(first.records, pairs, first.scored_at, strict=True):
        counted = record.output_valid & scored[:, None]
        change = predicted[0].outputs - predicted[1].outputs
        squares += np.sum(np.where(counted, change**2, 0.0), axis=0)
        counts += np.sum(counted, axis=0)
    return squares / np.maximum(counts, 1.0)
