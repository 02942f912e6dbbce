"""The time column of a table, its unit and its regularity: guesses, with reasons.

No data are changed here; `Record` handles jitter and gaps.
"""

import itertools
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax.data.column_names import is_temperature, role_of_name
from eoi_jax.data.readers.table import Table
from eoi_jax.data.resampling import GridSettings, uniform_grid

_NAMES = re.compile(
    r"(t|utc|time|times|tempo|tiempo|temps|zeit|stamps?|timestamps?|clock|date|datetime|elapsed|"
    r"sec|secs|seconds?|s|ms|us|µs|millis|micros|zeitstempel|uhrzeit|datum)$",
    re.IGNORECASE,
)
_ENDS_IN_TIME = re.compile(r"(time|zeit|temps|tiempo|tempo)$", re.IGNORECASE)
_COUNTERS = re.compile(r"(|\d+|index|idx|i|k|n|no|nr|row|sample|samples|unnamed.*)$", re.IGNORECASE)
_UNITS = {
    "s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3,
    "milliseconds": 1e-3, "millis": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "usec": 1e-6,
    "microseconds": 1e-6, "micros": 1e-6, "ns": 1e-9, "nanoseconds": 1e-9, "min": 60.0,
    "mins": 60.0, "minute": 60.0, "minutes": 60.0, "minuten": 60.0, "h": 3600.0, "hr": 3600.0,
    "hrs": 3600.0, "hour": 3600.0, "hours": 3600.0, "stunden": 3600.0, "d": 86400.0, "day": 86400.0,
    "days": 86400.0, "tage": 86400.0, "week": 604800.0, "weeks": 604800.0, "wochen": 604800.0,
}  # fmt: skip
NAMED = "named by the caller"
# Units since 1970, the smallest value of each, and its seconds, for dates from 2001 to 2065.
_EPOCHS = (("seconds", 1e9, 1.0), ("ms", 1e12, 1e-3), ("µs", 1e15, 1e-6), ("ns", 1e18, 1e-9))
# Days since 1900 and since the year 0, for dates from 1998 to 2099.
_DAYS = (("a spreadsheet", 36000.0, 73000.0), ("MATLAB", 729000.0, 767000.0))


@dataclass(frozen=True)
class Clock:
    """The time of a table.

    Attributes:
        column: name of the time column; None if no column looks like time.
        factor: seconds in a unit of the column.
        why: reasons for both, in a sentence.
        sample_period: of the uniform grid of the stamps, their median spacing where they have none
            [s]; None without a column.
        duration: from the first stamp to the last [s]; where time goes back, of its parts together.
        spacing: smallest and largest spacing [s].
        jitter: standard deviation of the spacings, without gaps, divided by the period.
        gaps: number of spacings of more than 2.5 periods, and the longest [s].
        repeated: number of stamps equal to the previous stamp.
        backwards: number of stamps smaller than the previous stamp, and the index of the first.
        others: further columns that might be the time.
        scattered: the stamps have no usual spacing: jitter is that of a clock without one, and no
            spacing is a gap.
    """

    column: str | None
    factor: float = 1.0
    why: str = "no column increases from row to row"
    sample_period: float | None = None
    duration: float | None = None
    spacing: tuple[float, float] | None = None
    jitter: float | None = None
    gaps: tuple[int, float] = (0, 0.0)
    repeated: int = 0
    backwards: tuple[int, int | None] = (0, None)
    others: tuple[str, ...] = ()
    scattered: bool = False


def declared_unit(column: str, unit: str) -> tuple[str, float] | None:
    """The unit of time that a column has by its file or its name, with its seconds; None: neither.

    Args:
        column: as ``time_ms`` or ``ms``.
        unit: as the file gives it; empty if it gives none.
    """
    text = column.rsplit(".", 1)[-1].rsplit("/", 1)[-1]
    words = (unit.strip().lower(), text.rpartition("_")[2].lower())
    return next(((word, _UNITS[word]) for word in words if word in _UNITS), None)


def unit_of_seconds(seconds: float) -> str:
    """The unit of time of so many seconds; "" if there is none.

    Args:
        seconds: in the unit.
    """
    units = (
        unit for unit in ("s", "ms", "µs", "min", "h", "d") if np.isclose(_UNITS[unit], seconds)
    )
    return next(units, "")


def find_clock(
    table: Table, numbers: Mapping[str, Float[np.ndarray, " time"]], column: str | None = None
) -> Clock:
    """The column that is most likely the time.

    Args:
        table: contents of the file.
        numbers: its columns of numbers and dates, in float64.
        column: the time as the caller says; None: the most likely one.
    """
    if column is not None:
        factor, unit_reason = _unit(column, numbers[column], table)
        values = numbers[column] * factor
        return _clock_of(column, values, factor, f"{NAMED}; {unit_reason}", ())
    scores = {key: _score(key, values, table) for key, values in numbers.items()}
    likely = sorted((key for key in scores if scores[key] > 0), key=lambda key: -scores[key])
    if not likely:
        return Clock(None)
    highest = likely[0]
    likely = _steadiest_first(likely, numbers, table)
    column, values = likely[0], numbers[likely[0]]
    dates = table.columns[column].dtype.kind in "Mm"
    factor, unit_reason = _unit(column, values, table)
    name_reason = "the file says so" if column == table.time else _reason(column, values, dates)
    name_reason += "" if column == highest else f"; unlike `{highest}`, it never goes back"
    if _runs_evenly(column, values, table):  # a signal that rises throughout is no second clock
        likely = [key for key in likely if _runs_evenly(key, numbers[key], table)]
    return _clock_of(
        column, values * factor, factor, f"{name_reason}; {unit_reason}", tuple(likely[1:4])
    )


def _steadiest_first(
    likely: list[str], numbers: Mapping[str, Float[np.ndarray, " time"]], table: Table
) -> list[str]:
    """The candidates; where the first goes back, as the time of a step, a total time before it.

    That has dates or is called a time, never goes back, and increases at as many rows or more.
    """
    first = np.diff(numbers[likely[0]])
    if likely[0] == table.time or not np.any(first < 0):
        return likely
    for key in likely[1:]:
        steps = np.diff(numbers[key])
        is_clock = table.columns[key].dtype.kind in "Mm" or _means_time(key, table)
        if is_clock and np.all(steps >= 0) and np.sum(steps > 0) >= np.sum(first > 0):
            return [key, *(name for name in likely if name != key)]
    return likely


def _means_time(key: str, table: Table) -> bool:
    """Whether a column is called a time, as `Test_Time` too, or has a unit of time in its file."""
    unit = table.units.get(key, "").strip().lower()
    return is_called_time(key) or bool(_ENDS_IN_TIME.search(_stem(key))) or unit in _UNITS


def is_called_time(key: str) -> bool:
    """Whether the name of a column is that of a time.

    Args:
        key: the name.
    """
    return bool(_NAMES.match(_stem(key)))


def _runs_evenly(key: str, values: Float[np.ndarray, " time"], table: Table) -> bool:
    """Whether a column is called a time, or ticks evenly and is not called a signal."""
    dates = table.columns[key].dtype.kind in "Mm"
    if key == table.time or dates or _means_time(key, table):
        return True
    return not role_of_name(key) and _ticks(np.diff(values))


def _score(
    key: str, values: Float[np.ndarray, " time"], table: Table, most_rows: float = 50.0
) -> float:
    """Score of a column as time, with so many rows a stamp at most; 0: it cannot be time."""
    dates = table.columns[key].dtype.kind in "Mm"
    steps = np.diff(values)
    if not (len(steps) and np.all(np.isfinite(values))):
        return 0.0
    forward = float(np.mean(steps > 0))
    backward = float(np.mean(steps < 0))
    named = is_called_time(key)
    # A clock with restarts or repeats is accepted by its name or type, or where it ticks evenly;
    # where it never falls, with as many rows a stamp as a log with a row for each topic has.
    grows = forward > 0.5 and backward < 0.01 if named or dates else forward == 1.0
    grows = grows or ((named or dates) and backward == 0 and forward * most_rows >= 1.0)
    means_time = _means_time(key, table)
    grows = grows or (means_time and forward > 0.5 and len(parts_between_restarts(values)) > 1)
    if not grows and not _ticks(steps):
        return 0.0
    unit_steps = bool(np.all(steps == 1.0))
    median = float(np.median(steps))
    regular = float(np.mean(np.abs(steps - median) < 0.5 * abs(median)))
    counter = unit_steps and bool(_COUNTERS.match(_stem(key)))
    evidence = 8.0 * (key == table.time) + 4.0 * dates + (3.0 if named else 1.0 * means_time)
    return 1.0 + evidence + regular - 1.5 * counter


def _ticks(
    steps: np.ndarray, most_repeats: float = 0.1, most_restarts: float = 1e-3, width: float = 0.01
) -> bool:
    """Whether nearly all steps forward are of the same length, between few repeats and restarts."""
    forward = steps[steps > 0]
    if len(forward) < (1.0 - most_repeats) * len(steps):
        return False
    is_even = np.abs(forward - np.median(forward)) < width * np.median(forward)
    return float(np.mean(is_even)) > 0.95 and float(np.mean(steps < 0)) < most_restarts


def _stem(key: str) -> str:
    """The name without unit and path: ``time [ms]``, ``log.time_ms`` → ``time``."""
    text = re.sub(r"\s*[\[(].*?[\])]\s*$", "", key.rsplit(".", 1)[-1].rsplit("/", 1)[-1]).strip()
    head, _, tail = text.rpartition("_")
    return head if head and tail.lower() in _UNITS else text


def _reason(column: str, values: Float[np.ndarray, " time"], dates: bool) -> str:
    if dates:
        return "it holds dates or times of day"
    is_rising = np.all(np.diff(values) > 0)
    if is_called_time(column):
        return f"it {'' if is_rising else 'mostly '}increases, and its name says so"
    return "it increases throughout" if is_rising else "it mostly increases, in equal steps"


def _unit(column: str, values: Float[np.ndarray, " time"], table: Table) -> tuple[float, str]:
    """Seconds in a unit of the column, and the reason."""
    if table.columns[column].dtype.kind in "Mm":
        return 1.0, "read in seconds from the first"
    declared = declared_unit(column, table.units.get(column, ""))
    if declared is not None:
        return declared[1], f"in {declared[0]}, as the file says"
    first, step = float(values[0]), float(np.median(np.diff(values)))
    for word, low, factor in _EPOCHS:
        if low <= first < 3.0 * low and step * factor < 1e4:
            return factor, f"its size is that of {word} since 1970"
    program = _dates_in_days(values)
    if program:
        return 86400.0, f"its size is that of the dates of {program}, in days"
    whole_numbers = bool(np.all(values == np.rint(values)))
    short, long = np.quantile(np.diff(values), [0.1, 0.9])
    if whole_numbers and 0.0 < GridSettings.scatter * short <= long and step > 1.0:
        return 1.0, "whole numbers, uneven as those of samples taken by hand: taken as seconds"
    if whole_numbers and step > 0 and step % 60.0 == 0:
        return 1.0, f"whole numbers {step / 60.0:g} minutes apart are taken as seconds"
    if whole_numbers and step > 1.0 and _warms(table):
        unit, factor = ("s", 1.0) if step < 60.0 else ("ms", 1e-3)
        return factor, f"whole numbers {step:g} apart beside a temperature are taken as {unit}"
    if whole_numbers and step >= 1000.0:
        return 1e-6, f"whole numbers {step:g} apart are taken as µs, which is a guess"
    if whole_numbers and step > 1.0:
        return 1e-3, f"whole numbers {step:g} apart are taken as ms, which is a guess"
    if whole_numbers:
        return 1.0, "it counts by ones: if these are samples, not seconds, give sample_period"
    return 1.0, "taken as seconds"


def _warms(table: Table) -> bool:
    """Whether a table has temperatures and no other output, by names and units: it is slow."""
    answers = {
        is_temperature(name, table.units.get(name, ""))
        for name in table.columns
        if is_temperature(name, table.units.get(name, "")) or role_of_name(name) == "output"
    }
    return answers == {True}


def _clock_of(
    column: str,
    stamps: Float[np.ndarray, " time"],
    factor: float,
    why: str,
    others: tuple[str, ...],
) -> Clock:
    steps = np.diff(stamps)
    forward = steps[steps > 0]
    period, scattered = float(np.median(forward)), False
    if len(forward) == len(steps):
        with suppress(ValueError):  # of pauses that dominate
            grid = uniform_grid(stamps)
            period, scattered = period if grid.scattered else grid.sample_period, grid.scattered
    gaps = (forward > GridSettings.gap * period) & (not scattered)
    backward = np.flatnonzero(steps < 0)
    regular = forward[~gaps]
    return Clock(
        column,
        factor,
        why,
        period,
        float(np.sum(forward) if len(backward) else stamps[-1] - stamps[0]),
        (float(steps.min()), float(steps.max())),
        float(np.sqrt(np.mean((regular - period) ** 2)) / period),
        (int(gaps.sum()), float(forward.max()) if gaps.any() else 0.0),
        int(np.sum(steps == 0)),
        (len(backward), int(backward[0]) + 1 if len(backward) else None),
        others,
        scattered,
    )


@dataclass(frozen=True)
class RestartSettings:
    """When a clock that goes back is that of a logger that was started again."""

    most_parts: int = 20  # more: the rows are not sorted, unless each part begins as the first did
    same_start: float = 0.1  # of the span of a part, within which the next one begins as it did
    shortest: int = 100  # samples that are a record of its own, or half of what parts usually have
    fewest: int = 8  # samples of a record


def parts_between_restarts(
    stamps: np.ndarray, settings: RestartSettings = RestartSettings()
) -> tuple[tuple[int, int], ...]:
    """Ranges of rows, first and last (excluded), in which time does not go back.

    Short ones are left out. All rows are one range where time never goes back, or too often.

    Args:
        stamps: as they stand in a file, numbers or dates.
        settings: what is a restart.
    """
    steps = np.diff(stamps)
    restarts = np.flatnonzero(steps < np.zeros(1, steps.dtype)) + 1
    ranges = list(itertools.pairwise([0, *restarts.tolist(), len(stamps)]))
    usual = 0.5 * float(np.median([b - a for a, b in ranges]))
    shortest = max(settings.fewest, min(settings.shortest, usual))
    long = tuple((a, b) for a, b in ranges if b - a >= shortest)
    spans = np.asarray([stamps[b - 1] - stamps[a] for a, b in ranges[:-1]])
    moved = np.abs(stamps[restarts] - stamps[[a for a, _ in ranges[:-1]]])
    sorted_rows = len(ranges) <= settings.most_parts or bool(
        np.all(moved <= settings.same_start * spans)
    )
    return long if long and sorted_rows else ((0, len(stamps)),)


def _dates_in_days(values: np.ndarray) -> str:
    """The program whose dates have such sizes and steps; empty if none has."""
    first, step = float(values[0]), float(np.median(np.diff(values)))
    sizes = (program for program, low, high in _DAYS if low < first < high)
    return next(sizes, "") if 0 < step < 0.5 else ""


def date_hints(column: str, stamps: np.ndarray) -> list[str]:
    """A sentence on stamps that are read as seconds, and look like dates in days.

    Args:
        column: of the clock.
        stamps: as they stand in a file.
    """
    program = _dates_in_days(stamps) if len(stamps) > 1 else ""
    if not program:
        return []
    looks = f"`{column}` is read in seconds; stamps from {stamps[0]:.10g} on look like dates of"
    return [f"{looks} {program} in days: if they are, give `scale` {{{column!r}: 86400}}."]


def numbers_runs(values: np.ndarray | None, stamps: np.ndarray | None) -> bool:
    """Whether a column changes where the time goes back, and nowhere else: a number of the run.

    Args:
        values: of the column; None where they are no numbers.
        stamps: of the clock; None where there is none.
    """
    if values is None or stamps is None or len(values) != len(stamps):
        return False
    backwards = np.diff(stamps) < 0
    return bool(backwards.any()) and np.array_equal(np.diff(values) != 0, backwards)


def oldest_first(table: Table) -> Table:
    """The table, its rows turned round where a clock runs backwards throughout."""
    for key, values in table.columns.items():
        clock = values.dtype.kind in "Mm" or is_called_time(key)
        if not clock or values.dtype.kind not in "Mmiuf" or len(values) < 2:
            continue
        steps = np.diff(values)
        zero = np.zeros(1, steps.dtype)
        if np.all(steps <= zero) and np.any(steps < zero):
            columns = {name: column[::-1] for name, column in table.columns.items()}
            note = f"`{key}` has the newest sample first: the rows are read from the last one on."
            return replace(table, columns=columns, notes=(*table.notes, note))
    return table


def seconds_from_first(stamps: np.ndarray) -> Float[np.ndarray, " time"]:
    """Dates or times of day in seconds from the first that is known [s]; NaN where one is missing.

    Args:
        stamps: of the type datetime64 or timedelta64.
    """
    first = stamps[np.argmin(np.isnat(stamps))]  # the first of all where none is known
    return (stamps - first) / np.timedelta64(1, "s")


def stamped_rows(table: Table) -> tuple[Table, list[str]]:
    """The table without the rows in which its clock is missing, and a sentence on them.

    A clock has dates or the name of a time, is known in most rows, and never goes back.
    Where one is known in all rows, or there is none, the table stays as it is.

    Args:
        table: contents of a file.
    """
    clock, is_stamped = "", np.zeros(0, bool)
    for key, values in table.columns.items():
        dates = values.dtype.kind in "Mm"
        if not (dates or (values.dtype.kind in "iuf" and is_called_time(key))):
            continue
        stamps = seconds_from_first(values) if dates and len(values) else values
        finite = np.isfinite(stamps.astype(float))
        steps = np.diff(stamps[finite])
        if 2 * np.sum(finite) <= len(finite) or np.any(steps < 0) or not np.any(steps > 0):
            continue
        if finite.all():
            return table, []
        if not clock:
            clock, is_stamped = key, finite
    if not clock:
        return table, []
    columns = {
        name: values[is_stamped] if len(values) == len(is_stamped) else values
        for name, values in table.columns.items()
    }
    rows = np.flatnonzero(~is_stamped)
    listed = ", ".join(map(str, rows[:5])) + (f" and {len(rows) - 5} more" if rows[5:].size else "")
    sentence = f"`{clock}` has no stamp in row {listed}, counted from 0: left out here. A record "
    sentence += "needs a stamp in all its rows: take such lines out of the file."
    return replace(table, columns=columns), [sentence]


@dataclass(frozen=True)
class ClockChangeSettings:
    """When local times that leave out an hour, or have one twice, are those of clocks put anew."""

    usual: float = 0.5  # share of the spacings that are equal; of uneven ones any may be an hour
    last_hour: int = 4  # of the night
    # First and last day, month first, between which some zone puts its clocks: in the north in
    # March and from the end of September on, in the south in April and from the end of August on.
    seasons: tuple = (((3, 8), (4, 10)), ((8, 24), (11, 8)))


def daylight_saving(
    dates: np.ndarray, settings: ClockChangeSettings = ClockChangeSettings()
) -> list[str]:
    """Where local times leave out an hour or have one twice, as clocks are put forward and back.

    Most spacings must be equal: of uneven ones, as of samples taken by hand, any may be an hour
    longer. And some zone must change its clocks on that day, which it does at night.

    Args:
        dates: without a time zone, of the type datetime64.
        settings: when clocks change.
    """
    hour, steps = np.timedelta64(1, "h"), np.diff(dates)
    forward = steps[steps > np.timedelta64(0)]
    if not forward.size:
        return []
    period = np.median(forward)
    is_even = period <= hour and np.mean(forward == period) > settings.usual
    advice = "Give times in UTC, or with their offset (+01:00)."
    sentences = []
    for change, what in ((-hour, "have an hour twice"), (hour, "leave out an hour")):
        rows = np.flatnonzero(steps == period + change) + 1
        if (
            is_even
            and len(rows) == 1
            and _clocks_change(dates[rows[0] - 1 : rows[0] + 1], settings)
        ):
            place = f"at row {rows[0]}, counted from 0"
            sentences.append(f"The dates {what} {place}, as with daylight saving time. {advice}")
    return sentences


def _clocks_change(dates: np.ndarray, settings: ClockChangeSettings) -> bool:
    """Whether one of two dates is of a night in which some zone changes its clocks."""
    for date in dates.astype("datetime64[s]").tolist():
        day = date.month, date.day
        in_season = any(first <= day <= last for first, last in settings.seasons)
        if in_season and date.hour < settings.last_hour:
            return True
    return False


def epoch_unit(values: Float[np.ndarray, " time"]) -> tuple[str, float] | None:
    """Unit of stamps since 1970 that cannot be seconds, and its seconds; None if they can.

    Args:
        values: stamps as they stand in a file.
    """
    first = float(np.nanmin(values)) if np.any(np.isfinite(values)) else 0.0
    units = ((word, factor) for word, low, factor in _EPOCHS[1:] if low <= first < 3.0 * low)
    return next(units, None)
