"""Checks and cleaning of the arguments of a record, and their transfer to the uniform grid.

Every function that changes data appends a sentence to its argument `notes`.
"""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax._checks import (
    RecordWarning,
    check,
    check_choice,
    check_kind,
    counted,
    is_or_are,
    timed,
    warn_caller,
)
from eoi_jax._types import Inputs, Mask, OutputMask, Outputs, Signals, TimeAxis
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.data.glitches import without_faults
from eoi_jax.data.input_holds import SELDOM, Hold, hold_of_each
from eoi_jax.data.missing_codes import input_code_notes, without_output_codes
from eoi_jax.data.noise import white_noise
from eoi_jax.data.resampling import (
    Grid,
    GridSettings,
    Segments,
    covered,
    fill,
    holes,
    inputs_on_grid,
    lost_between,
    own_period,
    own_segments,
    runs,
    sample_segments,
    spline,
)

RATE = "is measured every"  # of a note on an output with a rate of its own
SHORTEST = 8  # samples: a quintic spline takes six, an eighth difference nine
SLOW = 1.5  # samples between two of an output, on average, from which on it has its own rate
LONGEST_HELD = 2  # missing samples of a held input that is the same before and after them

_UNKNOWN = "Inputs are unknown at {} in {}: free runs start again after each."
_NO_OUTPUT = (
    "Leave out the records in which it was not measured, or fit them with a model whose outputs "
    "are those that were: others may be internal states."
)

Names: TypeAlias = Sequence[str] | None
InputsOf: TypeAlias = Callable[[Hold], Float[np.ndarray, "points nu"]]
# Inputs with a hold, outputs, where all inputs are known, and where each output was measured.
OnGrid: TypeAlias = tuple[
    InputsOf,
    Float[np.ndarray, "points ny"],
    Bool[np.ndarray, " points"],
    Bool[np.ndarray, "points ny"],
]


def _numbers(name: str, values: Any, limit: float = 1e150) -> np.ndarray:
    """A float64 copy; masked elements of a masked array become NaN.

    Args:
        name: of the argument.
        values: its elements.
        limit: size of a number from which sums of squares may overflow.
    """
    array = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    check(array.dtype.kind not in "cMm", name, "must be real numbers", f"dtype {array.dtype}")
    try:
        array = np.ma.filled(array.astype(np.float64), np.nan)
    except (TypeError, ValueError) as failure:
        check(False, name, "must hold numbers only", failure)
    finite = array[np.isfinite(array)]
    largest = float(np.max(np.abs(finite), initial=0.0))
    advice = "Its square must be a number, too: give a `scale`, or drop such samples."
    check(largest < limit, name, f"must be below {limit:g} in size", largest, advice)
    return np.array(array)


def check_untraced(*signals: Any) -> None:
    """A record holds numbers, not what JAX traces in the place of numbers."""
    traced = any(isinstance(signal, Tracer) for signal in signals)
    rule, advice = "must get numbers", "In `jit`, `grad` or `vmap`, use `observe` or `rollout`."
    check(not traced, "Record", rule, "numbers that JAX traces", advice)


def read_stamps(time: Any) -> TimeAxis:
    """Stamps in seconds, finite; whether they increase is not checked here."""
    array = _without_zone(np.asarray(time))
    if array.dtype.kind in "Mm" and array.size:
        array = (array - array.ravel()[0]) / np.timedelta64(1, "s")
    stamps = _numbers("time", array)
    check(
        stamps.ndim == 1,
        "time",
        "must have shape (N,)",
        f"shape {stamps.shape}",
        "Use Record.from_period where only the sample period is known.",
    )
    bad = np.flatnonzero(~np.isfinite(stamps))
    check(
        not bad.size,
        "time",
        "must be finite",
        f"{stamps[bad[0]]} at index {bad[0]}" if bad.size else "",
        "Drop that row, or use Record.from_period.",
    )
    return stamps


def _without_zone(stamps: np.ndarray) -> np.ndarray:
    """Dates of Python or pandas as datetime64, those of a time zone in UTC; others as they are."""
    dates = stamps.dtype == object and all(isinstance(stamp, datetime) for stamp in stamps.flat)
    if not dates or not stamps.size:
        return stamps
    zoned = [stamp.tzinfo is not None for stamp in stamps.flat]
    check(all(zoned) or not any(zoned), "time", "must have a time zone at each date or at none",
          f"{counted(sum(zoned), 'date')} of {len(zoned)} with one")  # fmt: skip
    naive = [stamp.astimezone(UTC).replace(tzinfo=None) for stamp in stamps.flat]
    naive = naive if any(zoned) else list(stamps.flat)
    return np.asarray(naive, dtype="datetime64[us]").reshape(stamps.shape)


_NO_INPUT = (
    "For a system without input write `Record(time, np.zeros((len(time), 0)), outputs)`, and "
    "`inputs=()` in its `Plant`."
)


def read_signals(name: str, values: Any) -> Signals:
    """Signals as (N, channels), possibly with NaN."""
    advice = "" if name == "inputs" else "Inputs come before outputs. "
    check(values is not None, name, "must be an array", None, advice + _NO_INPUT)
    array = _numbers(name, values)
    letter = name[0].replace("i", "u").replace("o", "y")
    check(
        array.ndim in (1, 2),
        name,
        f"must have shape (N,) or (N, n{letter})",
        f"shape {array.shape}",
    )
    return array[:, None] if array.ndim == 1 else array


def check_lengths(stamps: np.ndarray, u: np.ndarray, y: np.ndarray) -> None:
    """Check equal lengths, the smallest length, and that there is an output."""
    rows = ", ".join([
        counted(len(stamps), "stamp"), counted(len(u), "input row"), counted(len(y), "output row"),
    ])  # fmt: skip
    check(
        len(u) == len(y) == len(stamps),
        "time, inputs, outputs",
        "must be equally long",
        rows,
        _NO_INPUT if not len(u) else "Samples run along the first axis.",
    )
    check(len(stamps) >= SHORTEST, "time", f"must have at least {SHORTEST} samples", len(stamps))
    check(y.shape[1] > 0, "outputs", "must have at least one channel", f"shape {y.shape}")


def channel_names(
    field: str, declared: Names, values: Any, count: int, letter: str
) -> tuple[str, ...]:
    """The declared names, else those of a pandas object, else numbered names."""
    if declared is None:
        labels = getattr(values, "columns", None)  # a pandas frame
        labels = [getattr(values, "name", None)] if labels is None else list(labels)
        if len(labels) == count and all(isinstance(label, str) for label in labels):
            return tuple(str(label) for label in labels)
        return numbered_names(letter, count)
    names = (declared,) if isinstance(declared, str) else tuple(declared)
    check(len(names) == count, field, f"must name {counted(count, 'channel')}", names)
    return names


def numbered_names(letter: str, count: int) -> tuple[str, ...]:
    """Names of channels that have none: u, or u1, u2, …."""
    return (letter,) if count == 1 else tuple(f"{letter}{i + 1}" for i in range(count))


def check_labels(u_names: tuple[str, ...], y_names: tuple[str, ...], units: dict[str, str]) -> None:
    """Check that names are unique and that units belong to a channel or to time."""
    names = (*u_names, *y_names)
    check(
        len(set(names)) == len(names), "input_names, output_names", "must differ", ", ".join(names)
    )
    for key in units:
        check_choice("units", key, ("time", *names))


def scored_samples(
    u_names: tuple[str, ...],
    y_names: tuple[str, ...],
    u: Inputs,
    y: Outputs,
    mask_faults: bool,
    notes: list[str],
) -> tuple[Mask, OutputMask]:
    """Rows in which all inputs are finite; samples of each output that are, and no faults."""
    check_kind("mask_faults", mask_faults, bool, "True or False")
    names, finite = (*u_names, *y_names), np.isfinite(np.hstack([u, y]))
    _note_not_finite(names, y_names, finite, notes)
    u_good = np.asarray(finite[:, : len(u_names)].all(axis=1))
    y_good = finite[:, len(u_names) :]
    input_code_notes(u, u_names, notes)
    y_good = without_output_codes(y, y_good, mask_faults, y_names, notes)
    if mask_faults:
        y_good = without_faults(y, y_good, u, y_names, notes)
    used = np.hstack([finite[:, : len(u_names)], y_good])
    counts = {key: int(column.sum()) for key, column in zip(names, used.T, strict=True)}
    fewest = min(counts, key=lambda key: counts[key])
    check(
        counts[fewest] >= SHORTEST,
        "inputs, outputs",
        f"must have at least {SHORTEST} finite samples of every channel",
        f"{counts[fewest]} of {fewest}",
        _NO_OUTPUT if fewest in y_names else SELDOM,
    )
    rows = int(u_good.sum())
    listed = ", ".join(f"{key} has {counts[key]}" for key in u_names)
    check(rows >= SHORTEST, "inputs", f"must have values in the same row at least {SHORTEST} times",
          f"{counted(rows, 'such row')} ({listed})", SELDOM)  # fmt: skip
    return u_good, y_good


def _note_not_finite(
    names: tuple[str, ...], y_names: tuple[str, ...], finite: OutputMask, notes: list[str]
) -> None:
    """Say how many samples are not finite, but of outputs with a rate of their own."""
    for key, column in zip(names, finite.T, strict=True):
        advice = _NO_OUTPUT if key in y_names else "Write 0 where nothing acted."
        value = "NaN or infinity throughout"
        check(bool(column.any()), key, "must hold a finite value", value, advice)
    bad = {
        key: ~column
        for key, column in zip(names, finite.T, strict=True)
        if not (column.all() or (key in y_names and is_slow(column)))
    }
    if bad:
        rows = np.any(list(bad.values()), axis=0)
        listed = ", ".join(f"`{key}` {column.sum()}" for key, column in bad.items())
        share = f"{rows.sum()} of {counted(len(rows), 'sample')} {is_or_are(rows.sum())}"
        notes.append(f"{share} not finite ({listed}): masked.")


def replaced_outputs(
    name: str,
    channels: tuple[str, ...],
    outputs: Outputs,
    simulated: Mask | None,
    sample_period: float,
) -> tuple[Outputs, OutputMask, list[str]]:
    """Outputs in place of those of a record, with what is not finite masked as in a new record.

    Args:
        name: of the record.
        channels: names of the outputs.
        outputs: on the grid of the record.
        simulated: where there are any; None: everywhere.
        sample_period: of the grid [s].

    Returns:
        Finite outputs, where each counts as measured, and notes.

    Raises:
        ValueError: an output with fewer than 8 finite values.

    Warns:
        RecordWarning: each of the notes.
    """
    rows = np.ones(len(outputs), bool) if simulated is None else simulated
    measured, notes = np.repeat(rows[:, None], outputs.shape[1], axis=1), []
    finite = np.isfinite(outputs)
    if np.all(finite | ~measured):
        return outputs, measured, notes
    _note_not_finite(channels, channels, finite[rows], notes)
    measured &= finite
    counts = measured.sum(axis=0)
    value = f"{np.min(counts)} of {channels[int(np.argmin(counts))]}"
    rule = f"must have at least {SHORTEST} finite samples of every channel"
    check(np.min(counts) >= SHORTEST, "outputs", rule, value, _NO_OUTPUT)
    rate_notes(channels, measured, sample_period, notes)
    for note in notes:
        warn_caller(f"Record `{name}`: {note}", RecordWarning)
    position = np.arange(len(outputs), dtype=float)
    return fill(position, np.where(finite, outputs, np.nan), position), measured, notes


def is_slow(measured: Mask) -> bool:
    """Whether an output is measured less often than the record is sampled: every second sample."""
    return own_period(np.flatnonzero(measured).astype(float)) >= SLOW


def rate_notes(
    names: tuple[str, ...], measured: OutputMask, sample_period: float, notes: list[str]
) -> None:
    """Say which outputs have a rate of their own.

    Args:
        names: of the outputs.
        measured: where each was measured.
        sample_period: of the grid [s].
        notes: of the record.
    """
    for key, column in zip(names, measured.T, strict=True):
        if not is_slow(column):
            continue
        position = np.flatnonzero(column).astype(float)
        period = own_period(position)
        holes = len(own_segments(position)) - 1
        text = f"`{key}` {RATE} {period:.3g} samples ({period * sample_period:.3g} s): "
        text += "free runs are scored there, passes interpolate between by a cubic spline"
        notes.append(f"{text}; {counted(holes, 'gap')}." if holes else f"{text}.")


def known_inputs(
    names: tuple[str, ...],
    inputs: Inputs,
    inputs_known: Mask,
    hold: Hold,
    sample_period: float,
    notes: list[str],
) -> Mask:
    """Where all inputs are known: as measured, or because a short gap leaves no doubt.

    That is a gap of one or two samples of a held input with the same value on both sides, and a
    single sample of a linear or smooth one between two that were measured, which is interpolated.

    Args:
        names: of the inputs; without inputs nothing is unknown.
        inputs: on the grid, filled in linearly.
        inputs_known: where all of them were measured.
        hold: between the samples.
        sample_period: of the grid [s].
        notes: of the record; a sentence where a value is interpolated.
    """
    if not names:
        return np.ones_like(inputs_known)
    complete, interpolated = inputs_known.copy(), 0
    is_held = np.asarray(hold_of_each(hold, len(names))) == "zero"
    for start, stop in runs(~inputs_known):
        if start == 0 or stop == len(inputs_known):
            continue
        same = bool(np.all((inputs[start - 1] == inputs[stop])[is_held]))
        longest = LONGEST_HELD if np.all(is_held) else 1
        complete[start:stop] = same and stop - start <= longest
        interpolated += int(complete[start] and not np.all(is_held))
    if interpolated:
        notes.append(
            f"Inputs are interpolated at {counted(interpolated, 'single missing sample')}, between "
            "two that were measured."
        )
    missing = runs(~complete)
    inner = [(start, stop) for start, stop in missing if start > 0 and stop < len(inputs_known)]
    if inner:
        listed = timed((~complete).sum(), sample_period)
        notes.append(_UNKNOWN.format(listed, counted(len(missing), "gap")))
    return complete


def place(
    grid: Grid,
    index: Int[np.ndarray, " time"],
    u: Inputs,
    y: Outputs,
    good: tuple[Mask, OutputMask],
    notes: list[str],
    reach: float = 0.0,
) -> OnGrid:
    """Samples that lie on the grid are copied; missing ones are filled in and masked.

    Between stamps without a usual spacing nothing is missing: inputs follow their hold. So they do
    in gaps up to `reach` [s].
    """
    count = grid.time.size
    if grid.scattered:
        return _scattered(grid, index, u, y, good, notes)
    inputs_known, measured = np.zeros(count, dtype=bool), np.zeros((count, y.shape[1]), dtype=bool)
    inputs_known[index], measured[index] = good
    if count > index.size:
        notes.append(
            f"{timed(count - index.size, grid.sample_period)} of {count} "
            f"{is_or_are(count - index.size)} missing from the uniform grid of "
            f"{grid.sample_period:g} s: masked."
        )
    if inputs_known.all() and measured.all():
        return _without_hold(u), y, inputs_known, measured
    query = np.arange(count, dtype=float)
    position = index.astype(float)
    outputs = fill(position, y, query)
    if not reach:
        return _without_hold(fill(position, u, query)), outputs, inputs_known, measured
    segments = runs(good[0], grid.sample_period * np.diff(index) <= reach)
    inputs_of = partial(inputs_on_grid, position, u, segments, query)
    return inputs_of, outputs, covered(position, segments, query), measured


def _without_hold(inputs: Inputs) -> InputsOf:
    """Inputs that lie on the grid: their hold moves none of them."""

    def inputs_of(hold: Hold) -> Inputs:
        del hold
        return inputs

    return inputs_of


def _scattered(
    grid: Grid,
    index: Int[np.ndarray, " time"],
    u: Inputs,
    y: Outputs,
    good: tuple[Mask, OutputMask],
    notes: list[str],
) -> OnGrid:
    """Outputs where they were measured, inputs between their samples by their hold.

    Not over a hole that is far longer than the spacings around it, unless they are the same behind.
    """
    position, query = index.astype(float), np.arange(grid.time.size, dtype=float)
    spacing, u_finite = grid.sample_period * np.diff(index), fill(position, u, position)
    gaps = holes(spacing) & np.any(np.diff(u_finite, axis=0) != 0.0, axis=1)
    segments = runs(good[0], ~gaps)
    measured = np.zeros((query.size, y.shape[1]), dtype=bool)
    measured[index] = good[1]
    moved = ""
    if grid.deviation > GridSettings.tolerance:
        moved = f", moved by up to {grid.deviation * grid.sample_period:.2g} s"
    in_days = grid.sample_period == GridSettings.day
    unit, size = ("d", GridSettings.day) if in_days else ("s", 1.0)
    least, most = spacing.min() / size, spacing.max() / size
    notes.append(
        f"Stamps are {least:.4g} to {most:.4g} {unit} apart, without a usual spacing: {index.size} "
        f"samples on a grid of {grid.sample_period / size:g} {unit}, which has every one of them"
        f"{moved}."
    )
    if np.any(gaps):
        notes.append(_UNKNOWN.format(f"{spacing[gaps].sum():g} s", counted(int(gaps.sum()), "gap")))
    inputs_of = partial(inputs_on_grid, position, u, segments, query)
    return inputs_of, fill(position, y, query), covered(position, segments, query), measured


def interpolate(
    grid: Grid,
    stamps: TimeAxis,
    u: Inputs,
    y: Outputs,
    good: tuple[Mask, OutputMask],
    notes: list[str],
    reach: float = 0.0,
) -> OnGrid:
    """Samples that lie between grid points are interpolated, segment by segment.

    An output with a rate of its own is interpolated through its own samples, and counts as measured
    at the grid points next to them. Inputs follow their hold in gaps up to `reach` [s].
    """
    h = grid.sample_period
    known_rows, measured_rows = good
    position, query, segments = _grid_positions(grid, stamps, known_rows)
    if reach:
        segments = runs(known_rows, np.diff(stamps) <= max(reach, GridSettings.gap * h))
    inputs_known = covered(position, segments, query)
    outputs = np.zeros((query.size, y.shape[1]))
    measured = np.zeros((query.size, y.shape[1]), dtype=bool)
    for columns, rows in channel_groups(measured_rows):
        y_position, _, y_segments = _grid_positions(grid, stamps, rows)
        values = y[:, columns]
        if is_slow(rows):
            y_position, values = y_position[rows], values[rows]
            y_segments = own_segments(y_position)
        outputs[:, columns] = _cubic(y_position, values, y_segments, query)
        at_grid = covered(y_position, y_segments, query)
        if is_slow(rows):
            nearest = np.zeros(query.size, dtype=bool)
            nearest[np.clip(np.rint(y_position).astype(int), 0, query.size - 1)] = True
            at_grid &= nearest
        measured[:, columns] = at_grid[:, None]
    spacing = np.diff(stamps)
    gaps = int(np.sum(spacing > GridSettings.gap * h))
    dense = [column for column, rows in zip(measured.T, measured_rows.T, strict=True)
             if not is_slow(rows)]  # fmt: skip
    valid = np.all([inputs_known, *dense], axis=0)
    points = timed((~valid).sum(), h, "grid point")
    masked = "" if valid.all() else f"; {counted(gaps, 'gap')}, {points} masked"
    notes.append(
        f"Stamps are {spacing.min():.4g} to {spacing.max():.4g} s apart: resampled from "
        f"{stamps.size} samples to {query.size} at {h:g} s, outputs by a cubic spline, inputs by "
        f"their hold{masked}. {lost_between(grid, stamps)}".rstrip()
    )
    inputs_of = partial(inputs_on_grid, position, u, segments, query, averaged=True)
    return inputs_of, outputs, inputs_known, measured


def between_own_samples(outputs: Outputs, measured: OutputMask) -> tuple[Outputs, OutputMask]:
    """Outputs interpolated by cubic splines, each through its own samples, and where that holds.

    Args:
        outputs: on a uniform grid; samples that were measured are kept as they are.
        measured: where each output was measured.
    """
    query = np.arange(len(outputs), dtype=float)
    bridged, valid = np.array(outputs), np.array(measured)
    for j, column in enumerate(measured.T):
        position = np.flatnonzero(column).astype(float)
        segments = own_segments(position)
        values = _cubic(position, outputs[column, j : j + 1], segments, query)[:, 0]
        bridged[:, j] = np.where(column, outputs[:, j], values)
        valid[:, j] = covered(position, segments, query)
    return bridged, valid


def channel_groups(masks: OutputMask) -> list[tuple[slice, Mask]]:
    """Columns that share a mask: all of them at once, or else each by itself."""
    if np.all(masks == masks[:, :1]):
        return [(slice(None), masks[:, 0])]
    return [(slice(j, j + 1), column) for j, column in enumerate(masks.T)]


def interpolated_noise(
    grid: Grid,
    stamps: TimeAxis,
    samples: Float[np.ndarray, "stamps ny"],
    y: Float[np.ndarray, "points ny"],
    good: Bool[np.ndarray, "stamps ny"],
    valid: Bool[np.ndarray, "points ny"],
    quanta: Float[np.ndarray, " ny"],
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the measurement noise of samples before their interpolation.

    Args:
        grid: to which the samples were interpolated.
        stamps: of the samples [s].
        samples: outputs as measured.
        y: interpolated outputs.
        good: mask of the samples of each output.
        valid: mask of the grid points.
        quanta: quanta of the samples; the noise is at least that of the quantisation.
    """
    white = np.random.default_rng(0).standard_normal((stamps.size, 1))
    noise = np.zeros(y.shape[1])
    for columns, rows in channel_groups(good):
        if is_slow(rows):
            noise[columns] = own_noise(samples[:, columns], rows)
            continue
        position, query, segments = _grid_positions(grid, stamps, rows)
        filtered = _cubic(position, white, segments, query)
        covered_points = valid[:, columns][:, 0]
        noise[columns] = white_noise(y[:, columns], runs(covered_points), filtered)
    return np.maximum(noise, quanta / np.sqrt(12.0))


def own_noise(
    values: Float[np.ndarray, "samples channel"], measured: Bool[np.ndarray, " samples"]
) -> Float[np.ndarray, " channel"]:
    """White noise of channels that share a mask, from differences of consecutive samples.

    Args:
        values: one row a sample.
        measured: where they were measured; of channels with a rate of their own the measured
            samples follow each other.
    """
    if not is_slow(measured):
        return white_noise(values, runs(measured))
    position = np.flatnonzero(measured).astype(float)
    return white_noise(values[measured], own_segments(position))


def _cubic(
    position: TimeAxis,
    outputs: Outputs,
    segments: Segments,
    query: Float[np.ndarray, " points"],
) -> Float[np.ndarray, "points ny"]:
    """Outputs between their samples: a cubic follows motion and amplifies noise little."""
    return spline(position, outputs, segments, query, degree=3)


def _grid_positions(
    grid: Grid, stamps: TimeAxis, good: Mask
) -> tuple[TimeAxis, Float[np.ndarray, " points"], Segments]:
    """Positions of samples and grid points [grid steps], and runs of samples without a gap."""
    position = (stamps - grid.time[0]) / grid.sample_period
    query = np.arange(grid.time.size, dtype=float)
    return position, query, sample_segments(stamps, good, grid.sample_period)
