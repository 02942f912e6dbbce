"""Rows with the stamp of the row before: merged where their cells agree or are empty, else refused.

A log may have a row for each topic, with equal stamps and empty cells for the others. Of such rows
no value is lost: each channel has at most one at a stamp.
"""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax._checks import check
from eoi_jax._types import Inputs, Outputs, Signals, TimeAxis
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.time_axis import Clock


def distinct_stamps(
    stamps: TimeAxis, u: Inputs, y: Outputs, notes: list[str]
) -> tuple[Float[np.ndarray, " kept"], Float[np.ndarray, "kept nu"], Float[np.ndarray, "kept ny"]]:
    """Strictly increasing stamps: rows of one stamp are merged; two values of a channel are errors.

    Rows with the newest first are turned round.

    Args:
        stamps: of the rows [s].
        u: inputs, one row a stamp; NaN where a cell is empty.
        y: outputs.
        notes: of the record; sentences on what is merged or dropped.

    Raises:
        ValueError: stamps that decrease, are all the same, or repeat with different values.
    """
    spacing = np.diff(stamps)
    if np.all(spacing <= 0) and np.any(spacing < 0):
        notes.append("The newest sample comes first: the rows are read from the last one on.")
        stamps, u, y, spacing = stamps[::-1], u[::-1], y[::-1], -spacing[::-1]
    check(
        bool(np.any(spacing != 0)),
        "time",
        "must not be constant",
        f"{stamps[0]} s throughout",
        "A sample period of zero has no meaning.",
    )
    decreases = np.flatnonzero(spacing < 0)
    if decreases.size:
        i = int(decreases[0]) + 1
        check(
            False,
            "time",
            "must increase",
            f"{stamps[i]} s at index {i} after {stamps[i - 1]} s",
            "Sort the rows, or split the record where time restarts: by `slice`, or `parts` in the "
            "config of a command, which `eoi init` writes.",
        )
    if np.all(spacing > 0):
        return stamps, u, y
    rows = np.hstack([u, y])
    first = np.flatnonzero(np.concatenate([[True], spacing > 0]))
    merged, agree = merged_rows(rows, first)
    if not agree.all():
        _refuse(stamps, rows, first, agree)
    notes += _merging(rows, spacing == 0)
    rule = f"must have at least {SHORTEST} different stamps"
    check(len(first) >= SHORTEST, "time", rule, len(first))
    return stamps[first], merged[:, : u.shape[1]], merged[:, u.shape[1] :]


def merged_rows(
    rows: Signals, first: Int[np.ndarray, " kept"]
) -> tuple[Float[np.ndarray, "kept channel"], Bool[np.ndarray, "kept channel"]]:
    """One row for the rows of each stamp, and where the filled cells of a channel agree in them.

    Args:
        rows: one column a channel; NaN where a cell is empty.
        first: index of the first row of each stamp.
    """
    smallest = np.fmin.reduceat(rows, first, axis=0)
    largest = np.fmax.reduceat(rows, first, axis=0)
    return smallest, (smallest == largest) | np.isnan(smallest)


def at_distinct_stamps(
    columns: Mapping[str, Float[np.ndarray, " time"]], clock: Clock, notes: list[str]
) -> Mapping[str, Float[np.ndarray, " kept"]]:
    """Columns of a table with one row for the rows of each stamp, where that loses no value.

    The columns with empty cells must agree in the rows of each stamp, as those of topics with a row
    each do. Others, such as a number of the row, keep their smallest value. The table stays as it
    is where its time goes back, or where there are no such columns.

    Args:
        columns: of numbers, equally long.
        clock: of the table.
        notes: to which a sentence on merged rows is added.
    """
    if clock.column is None or not clock.repeated or clock.backwards[0]:
        return columns
    first = np.flatnonzero(np.diff(columns[clock.column], prepend=-np.inf) > 0)
    rows = np.stack(list(columns.values()), axis=1)
    merged, agree = merged_rows(rows, first)
    partly = np.isnan(rows).any(axis=0) & ~np.isnan(rows).all(axis=0)
    if not partly.any() or not agree[:, partly].all():
        return columns
    notes.append(_MERGED.format(len(rows) - len(first), len(rows)))
    return dict(zip(columns, merged.T, strict=True))


def _merging(rows: Signals, repeats: Bool[np.ndarray, " steps"]) -> list[str]:
    """Sentences on the rows with the stamp of the row before: equal ones, and complements."""
    previous, current = rows[:-1][repeats], rows[1:][repeats]
    equal = np.all((previous == current) | (np.isnan(previous) & np.isnan(current)), axis=1)
    sentences = []
    if equal.any():
        sentences.append(
            "Stamps that repeat the previous stamp with equal values were dropped: "
            f"{equal.sum()} of {len(rows)}."
        )
    if not equal.all():
        sentences.append(_MERGED.format(np.sum(~equal), len(rows)))
    return sentences


def _refuse(
    stamps: TimeAxis,
    rows: Signals,
    first: Int[np.ndarray, " kept"],
    agree: Bool[np.ndarray, "kept channel"],
) -> None:
    """Raise an error on the first two rows of one stamp with different values."""
    group, channel = map(int, np.argwhere(~agree)[0])
    stop = first[group + 1] if group + 1 < len(first) else len(rows)
    values = rows[first[group] : stop, channel]
    (filled,) = np.nonzero(~np.isnan(values))
    other = filled[np.flatnonzero(values[filled] != values[filled[0]])[0]]
    i, k = int(first[group] + filled[0]), int(first[group] + other)
    check(
        False,
        "time",
        "must not repeat with different values",
        f"{stamps[i]} s at index {i} and at index {k}",
        "If the clock is too coarse, or is put back at the end of daylight saving time, give "
        "a sample period in its place (`sample_period`, or `Record.from_period`). Of "
        "replicates at one instant give the means, or each series as a record of its own; of doses "
        "name the input in `impulses`.",
    )


_MERGED = (
    "Rows of one stamp that fill different cells, as of topics with a row each, are merged: "
    "{} of {} with the row before."
)
