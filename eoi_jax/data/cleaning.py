"""What comes into a record: checks, names, and the way onto the uniform grid.

Every function that changes something appends a sentence to the `notes` it is given.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax._checks import check, check_choice
from eoi_jax._types import Mask, Signals, TimeAxis
from eoi_jax.data.noise import white_noise
from eoi_jax.data.resampling import (
    GAP,
    Grid,
    Segments,
    covered,
    fill,
    held_means,
    hold_inputs,
    runs,
    sample_segments,
    spline,
)

SHORTEST = 8  # samples: a quintic spline takes six, an eighth difference nine
_LARGEST = 1e150
STAIRCASE = 0.2  # share of steps that may change a held input's value
_DEGREE = 3  # of the spline through outputs that lie between grid points

Names: TypeAlias = Sequence[str] | None
Inputs: TypeAlias = Float[np.ndarray, "time nu"]
Outputs: TypeAlias = Float[np.ndarray, "time ny"]
OnGrid: TypeAlias = tuple[
    Float[np.ndarray, "points nu"], Float[np.ndarray, "points ny"], Bool[np.ndarray, " points"]
]


def _numbers(name: str, values: Any) -> np.ndarray:
    """A float64 copy; what is masked in a masked array becomes NaN."""
    array = values if isinstance(values, np.ma.MaskedArray) else np.asarray(values)
    check(array.dtype.kind not in "cMm", name, "must be real numbers", f"dtype {array.dtype}")
    try:
        array = np.ma.filled(array.astype(np.float64), np.nan)
    except (TypeError, ValueError) as failure:
        check(False, name, "must hold numbers only", failure)
    finite = array[np.isfinite(array)]
    largest = float(np.max(np.abs(finite), initial=0.0))
    advice = "Its square must be a number, too: give a `scale`, or drop such samples."
    check(largest < _LARGEST, name, f"must be below {_LARGEST:g} in size", largest, advice)
    return np.array(array)


def read_stamps(time: Any) -> TimeAxis:
    """Stamps in seconds, finite, not yet known to increase."""
    array = np.asarray(time)
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


def read_signals(name: str, values: Any) -> Signals:
    """Signals as (N, channels), possibly with NaN."""
    check(
        values is not None,
        name,
        "must be an array",
        None,
        "Give np.zeros((N, 0)) for a system without input." if name == "inputs" else "",
    )
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
    """Equally long, long enough, and something to observe."""
    rows = f"{len(stamps)} stamps, {len(u)} input rows, {len(y)} output rows"
    check(
        len(u) == len(y) == len(stamps),
        "time, inputs, outputs",
        "must be equally long",
        rows,
        "Samples run along the first axis.",
    )
    check(len(stamps) >= SHORTEST, "time", f"must have at least {SHORTEST} samples", len(stamps))
    check(y.shape[1] > 0, "outputs", "must have at least one channel", f"shape {y.shape}")


def channel_names(
    field: str, given: Names, values: Any, count: int, letter: str
) -> tuple[str, ...]:
    """Names as given, as a pandas object carries them, or numbered."""
    if given is None:
        labels = getattr(values, "columns", None)  # a pandas frame
        labels = [getattr(values, "name", None)] if labels is None else list(labels)
        if len(labels) == count and all(isinstance(label, str) for label in labels):
            return tuple(str(label) for label in labels)
        return (letter,) if count == 1 else tuple(f"{letter}{i + 1}" for i in range(count))
    names = (given,) if isinstance(given, str) else tuple(given)
    check(len(names) == count, field, f"must name {count} channels", names)
    return names


def check_labels(u_names: tuple[str, ...], y_names: tuple[str, ...], units: dict[str, str]) -> None:
    """Every name once, every unit for a known name."""
    names = (*u_names, *y_names)
    check(
        len(set(names)) == len(names), "input_names, output_names", "must differ", ", ".join(names)
    )
    for key in units:
        check_choice("units", key, ("time", *names))


def drop_repeats(
    stamps: TimeAxis, u: Inputs, y: Outputs, notes: list[str]
) -> tuple[Float[np.ndarray, " kept"], Float[np.ndarray, "kept nu"], Float[np.ndarray, "kept ny"]]:
    """Strictly increasing stamps: exact repeats are dropped, anything else is an error."""
    spacing = np.diff(stamps)
    check(
        bool(np.any(spacing != 0)),
        "time",
        "must not be constant",
        f"{stamps[0]} s throughout",
        "A sample period of zero has no meaning.",
    )
    back = np.flatnonzero(spacing < 0)
    if back.size:
        i = int(back[0]) + 1
        check(
            False,
            "time",
            "must increase",
            f"{stamps[i]} s at index {i} after {stamps[i - 1]} s",
            "Sort the rows, or split the record where time restarts.",
        )
    again = np.flatnonzero(spacing == 0) + 1
    if not again.size:
        return stamps, u, y
    rows = np.hstack([u, y])
    before, after = rows[again - 1], rows[again]
    same = np.all((before == after) | (np.isnan(before) & np.isnan(after)), axis=1)
    if not same.all():
        i = int(again[np.flatnonzero(~same)[0]])
        check(
            False,
            "time",
            "must not repeat with different values",
            f"{stamps[i]} s at index {i - 1} and at index {i}",
            "If the clock is too coarse, use Record.from_period.",
        )
    keep = np.concatenate([[True], spacing > 0])
    notes.append(
        f"{again.size} of {stamps.size} stamps repeat the one before with equal values "
        "and were dropped."
    )
    check(
        int(keep.sum()) >= SHORTEST,
        "time",
        f"must have at least {SHORTEST} different stamps",
        int(keep.sum()),
    )
    return stamps[keep], u[keep], y[keep]


def finite_rows(names: tuple[str, ...], rows: Signals, notes: list[str]) -> Mask:
    """Which samples are finite in every channel."""
    finite = np.isfinite(rows)
    for key, column in zip(names, finite.T, strict=True):
        check(bool(column.any()), key, "must hold a finite value", "NaN or infinity throughout")
    good = np.asarray(finite.all(axis=1))
    if not good.all():
        bad = [
            f"`{key}` {(~column).sum()}"
            for key, column in zip(names, finite.T, strict=True)
            if not column.all()
        ]
        notes.append(
            f"{(~good).sum()} of {good.size} samples are not finite ({', '.join(bad)}): masked."
        )
    check(
        int(good.sum()) >= SHORTEST,
        "inputs, outputs",
        f"must have at least {SHORTEST} samples that are finite in every channel",
        int(good.sum()),
    )
    return good


def choose_hold(u: Signals, hold: str) -> tuple[str, list[str]]:
    """The hold of the inputs and, where it was not given, why."""
    if hold != "auto":
        return hold, []
    if not u.shape[1]:
        return "zero", []
    share = float(np.max(np.mean(np.diff(u, axis=0) != 0, axis=0)))
    hold = "zero" if share <= STAIRCASE else "linear"
    rule = "at most" if hold == "zero" else "more than"
    why = (
        f"Hold taken as {hold}: {100 * share:.3g} % of the steps change an input's value, "
        f"{rule} {100 * STAIRCASE:.0f} %."
    )
    return hold, [why]


def place(
    grid: Grid, index: Int[np.ndarray, " time"], u: Inputs, y: Outputs, good: Mask, notes: list[str]
) -> OnGrid:
    """Samples that lie on the grid: copied, and holes filled."""
    count = grid.time.size
    valid = np.zeros(count, dtype=bool)
    valid[index] = good
    if count > index.size:
        notes.append(
            f"{count - index.size} of {count} samples are missing from the uniform grid "
            f"of {grid.sample_period:g} s: masked."
        )
    if valid.all():
        return u, y, valid
    query = np.arange(count, dtype=float)
    position = index.astype(float)
    return fill(position, u, query), fill(position, y, query), valid


def interpolate(
    grid: Grid, stamps: TimeAxis, u: Inputs, y: Outputs, good: Mask, hold: str, notes: list[str]
) -> OnGrid:
    """Samples between grid points: interpolated, segment by segment."""
    h = grid.sample_period
    position, query, segments = _between(grid, stamps, good)
    valid = covered(position, segments, query)
    spacing = np.diff(stamps)
    gaps = int(np.sum(spacing > GAP * h))
    masked = f"; {gaps} gaps, {(~valid).sum()} grid points masked" if not valid.all() else ""
    held = "their means over each step (held)" if hold == "zero" else f"their hold ({hold})"
    notes.append(
        f"Stamps are {spacing.min():.4g} to {spacing.max():.4g} s apart: resampled from "
        f"{stamps.size} samples to {query.size} at {h:g} s, outputs by a cubic spline, inputs by "
        f"{held}{masked}."
    )
    u_known = fill(position, u, position)
    if hold == "zero":
        inputs = held_means(position, u_known, query.size)
    else:
        inputs = hold_inputs(position, u_known, segments, query, hold)
    return inputs, spline(position, y, segments, query, _DEGREE), valid


def interpolated_noise(
    grid: Grid,
    stamps: TimeAxis,
    y: Float[np.ndarray, "points ny"],
    good: Mask,
    valid: Bool[np.ndarray, " points"],
    quanta: Float[np.ndarray, " ny"],
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the noise that the samples had before they were interpolated.

    Args:
        grid: onto which.
        stamps: of the samples.
        y: interpolated.
        good: of the samples.
        valid: of what was interpolated.
        quanta: steps of the samples; their noise is at least that of these.
    """
    white = np.random.default_rng(0).standard_normal((stamps.size, 1))
    position, query, segments = _between(grid, stamps, good)
    passed = spline(position, white, segments, query, _DEGREE)
    return np.maximum(white_noise(y, runs(valid), passed), quanta / np.sqrt(12.0))


def _between(
    grid: Grid, stamps: TimeAxis, good: Mask
) -> tuple[TimeAxis, Float[np.ndarray, " points"], Segments]:
    """Samples and grid points, both in steps of the grid, and runs of samples without a gap."""
    position = (stamps - grid.time[0]) / grid.sample_period
    query = np.arange(grid.time.size, dtype=float)
    return position, query, sample_segments(stamps, good, grid.sample_period)
