"""Tables with the rows of several signals below each other, told apart by a tag."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import counted
from eoi_jax.data.readers.table import Table
from eoi_jax.data.time_axis import (
    NAMED,
    Clock,
    find_clock,
    is_called_time,
    numbers_runs,
    parts_between_restarts,
)

# Not "Tag" alone, which is a day in German.
_TAG = re.compile(r"(tag|point|signal)[ _.]?(name|id)$|signal$|variable$", re.IGNORECASE)


def mixed_tags(
    table: Table,
    clock: str | None,
    rows: slice = slice(None),
    most_tags: float = 0.125,
    fewest_repeats: float = 0.02,
    most_runs: float = 0.125,
) -> list[str]:
    """A sentence on the tags whose rows are mixed in a table, and what to do; none if none are.

    A column of text holds tags if time repeats or goes back between them, and increases from row to
    row of each; or if its name says so and they alternate, since stamps of changes need not repeat.
    Of tags one below the other, dates begin anew with each; a logger that was started again counts
    from zero. Tags with columns of their own, empty in the rows of the others, are not mixed.

    Args:
        table: contents of a file.
        clock: column of the stamps; None: there is none.
        rows: that are read.
        most_tags: of the rows; with more of them a column of text holds remarks.
        fewest_repeats: of the rows, in which time does not increase; fewer are faults of a clock,
            or an hour that is put back.
        most_runs: of the steps of a tag, at which its time goes back, as in the rows of several
            runs below each other; with more, rows are not sorted.
    """
    if clock is None or table.columns[clock].dtype.kind not in "Mmiuf":
        return []
    stamps = table.columns[clock][rows]
    backwards = len(stamps) > 1 and bool(stamps[0] > stamps[-1])
    stamps = stamps[::-1] if backwards else stamps
    steps = np.diff(stamps)
    zero = np.zeros(1, steps.dtype)
    repeats = np.sum(steps <= zero) >= max(fewest_repeats * len(steps), 1)
    restarts = stamps.dtype.kind == "M" and np.any(2 * -steps > np.ptp(stamps))
    for key, column in table.columns.items():
        is_text = column.dtype.kind == "O" and len(column) == len(table.columns[clock])
        if not (is_text and (repeats or restarts or _TAG.match(key))):
            continue
        tags = np.asarray(list(map(str, column[rows])))
        tags = tags[::-1] if backwards else tags
        names = list(dict.fromkeys(tags.tolist()))
        if _has_columns(table, clock, tags[::-1] if backwards else tags, rows):
            continue
        is_mixed = np.sum(tags[1:] != tags[:-1]) >= len(names) or restarts
        if not (is_mixed and 1 < len(names) <= most_tags * len(tags)):
            continue
        own_steps = [np.diff(stamps[tags == name]) for name in names]
        if not all(
            np.all(step != zero) and np.mean(step < zero) <= most_runs for step in own_steps
        ):
            continue
        listed = ", ".join(names[:5]) + (", …" if names[5:] else "")
        sentence = f"The rows of {counted(len(names), 'tag')} are mixed, which `{key}` tells apart "
        sentence += f"({listed}): give each a column of its own, as `pivot(index="
        index = [*_runs(table, clock), clock]
        index_text = repr(index if len(index) > 1 else clock)
        return [f"{sentence}{index_text}, columns={key!r}, values=…)` of pandas does."]
    return []


def _has_columns(table: Table, clock: str, tags: np.ndarray, rows: slice) -> bool:
    """Whether each column of numbers is filled in the rows of one tag alone."""
    columns = [
        np.isfinite(column[rows])
        for name, column in table.columns.items()
        if name != clock and column.dtype.kind in "iuf" and len(column[rows]) == len(tags)
    ]
    return bool(columns) and all(len(np.unique(tags[filled])) == 1 for filled in columns)


def stacked_topics(numbers: Mapping[str, Float[np.ndarray, " time"]], clock: Clock) -> str:
    """A sentence where topics are one below the other, each with columns of its own; else empty.

    Time begins anew with each topic, and a column has values in the rows of one of them.

    Args:
        numbers: the columns of numbers and dates, in float64.
        clock: of the table.
    """
    if clock.column is None or not clock.backwards[0]:
        return ""
    ranges = parts_between_restarts(numbers[clock.column])
    fills = {
        key: [bool(np.isfinite(values[start:stop]).any()) for start, stop in ranges]
        for key, values in numbers.items()
        if not np.isfinite(values).all()
    }
    filled = np.asarray([*fills.values()], bool).reshape(len(fills), len(ranges))
    if len(ranges) < 2 or not (np.all(filled.sum(axis=1) == 1) and np.all(filled.any(axis=0))):
        return ""
    topics = [
        f"{', '.join(key for key in fills if fills[key][i])} from row {start}"
        for i, (start, _) in enumerate(ranges[:5])
    ]
    return _STACKED.format("; ".join(topics), clock.column)


def found_clock(
    table: Table, numbers: Mapping[str, Float[np.ndarray, " time"]], column: str | None = None
) -> Clock:
    """The clock of a table; of one with mixed tags also a time that repeats between them.

    Args:
        table: contents of a file.
        numbers: its columns of numbers and dates, in float64.
        column: the time as the caller says; None: the most likely one.
    """
    clock = find_clock(table, numbers, column)
    tagged = (key for key in numbers if is_called_time(key) and mixed_tags(table, key))
    repeated = None if clock.column else next(tagged, None)
    if repeated is None:
        return clock
    clock = find_clock(table, numbers, repeated)
    why = clock.why.replace(NAMED, "its name says so, and it repeats between tags")
    return replace(clock, why=why)


def _runs(table: Table, clock: str) -> list[str]:
    """The column that numbers the runs, as of subjects: it changes where the time goes back."""
    stamps = table.columns[clock]
    columns = (name for name in table.columns if name != clock)
    numbers = (name for name in columns if table.columns[name].dtype.kind in "iuf")
    return [name for name in numbers if numbers_runs(table.columns[name], stamps)][:1]


_STACKED = (
    "Time goes back where other columns begin to be filled ({}, counted from 0): topics are one "
    "below the other. Sort the rows, as `sort_values({!r})` of pandas does; rows of one stamp are "
    "merged."
)
