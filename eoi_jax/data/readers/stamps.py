"""Dates and times of day in the columns of a text table."""

import re
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from eoi_jax._checks import counted
from eoi_jax.data.readers.table import Columns

# How notes on such columns go on behind their names.
TIMES_OF_DAY, INTERVALS, MIDNIGHTS = "holds times of day", "holds intervals", "has 24:00"
_CLOCK = r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?\s*([AaPp][Mm])?"
# English and German, whole or abbreviated; the first three letters tell.
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "mrz": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6,
    "jul": 7, "aug": 8, "sep": 9, "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
_MONTH = rf"(?:{'|'.join(_MONTHS)})[a-zä]{{0,6}}"
_NAMED = re.compile(rf"(\d{{1,2}})[-/. ]+({_MONTH})[-/. ]+(\d{{4}}|\d{{2}})(?!\d)", re.IGNORECASE)
# Hours ahead of UTC; those of America as RFC 5322 has them.
_ZONES = {
    "UTC": 0, "GMT": 0, "WET": 0, "WEST": 1, "CET": 1, "MET": 1, "MEZ": 1, "CEST": 2, "MEST": 2,
    "MESZ": 2, "EET": 2, "OEZ": 2, "EEST": 3, "OESZ": 3, "MSK": 3, "EST": -5, "EDT": -4,
    "CST": -6, "CDT": -5, "MST": -7, "MDT": -6, "PST": -8, "PDT": -7,
}  # fmt: skip
_ZONE = r"\s+(?![AaPp][Mm]$)([A-Za-z]{2,5})$"
_DATE = re.compile(
    rf"(\d{{4}}[-/.]\d{{1,2}}[-/.]\d{{1,2}}|\d{{1,2}}[-/.]\d{{1,2}}[-/.]\d{{2,4}}|{_NAMED.pattern})"
    rf"([T\s]+{_CLOCK}({_ZONE})?)?\s*(Z|[+-]\d{{2}}(:?\d{{2}})?)?$",
    re.IGNORECASE,
)
_TIME_OF_DAY = re.compile(rf"{_CLOCK}$")
# Start and end of an interval, as meters and markets write it: 05.01.2026 00:15 - 00:30.
_INTERVAL = re.compile(
    rf"(?P<start>.*{_CLOCK})\s+[-–]\s+(\S+[T\s]+)?{_CLOCK}(?P<zone>{_ZONE})?$", re.IGNORECASE
)
_MIDNIGHT = r"(?<![\d:.])24(:00(?::00(?:[.,]0+)?)?)(?![\d:])"  # the end of a day, ISO 8601-1:2004
_HALF_DAY, _DAY = np.timedelta64(12, "h"), np.timedelta64(1, "D")


def is_stamp(cell: str) -> bool:
    """Whether a cell holds a date or a time of day.

    Args:
        cell: without spaces around it.
    """
    cell = _start(cell)
    return bool(_DATE.match(cell) or _TIME_OF_DAY.match(cell))


def _start(cell: str) -> str:
    """A stamp, of an interval that at which it starts."""
    interval = _INTERVAL.match(cell)
    return interval["start"] + (interval["zone"] or "") if interval else cell


def read_stamps(key: str, values: Any, first: str, notes: list[str]) -> np.ndarray:
    """A column of text as dates (datetime64) or times of day (timedelta64), else as it is.

    Args:
        key: name of the column.
        values: a pandas series; missing where a cell is empty.
        first: the first cell, which holds a date or a time of day.
        notes: to which a sentence is appended.
    """
    if _start(first) != first:
        notes.append(f"`{key}` {INTERVALS}, such as {first!r}: each counts at its start.")
        values, first = values.map(lambda cell: _start(str(cell).strip()), "ignore"), _start(first)
    if _DATE.match(first):
        return _dates(key, values, first, notes)
    return _times_of_day(key, values, notes)


def _without_colons(
    key: str, values: np.ndarray, notes: list[str], fewest: int = 8, even: float = 0.9
) -> np.ndarray:
    """Numbers hhmmss.ss, as NMEA 0183 has them, as times of day (timedelta64); others as they are.

    They have no minute and no second of 60 or more, and as times of day more of their steps forward
    are of the usual length than as numbers, which jump behind each minute. Some restarts are let
    pass, as at midnight.

    Args:
        key: name of the column.
        values: of the column.
        notes: to which a sentence is appended.
        fewest: steps forward.
        even: share of them that must be of the usual length, within a half.
    """
    if values.dtype.kind not in "iuf":
        return values
    numbers = values.astype(np.float64)
    is_number = np.isfinite(numbers)
    minutes, seconds = np.floor(numbers / 100.0) % 100.0, numbers % 100.0
    good = (numbers >= 0) & (numbers < 240000) & (minutes < 60) & (seconds < 60)
    if not np.all(good[is_number]):
        return values
    elapsed = 3600.0 * np.floor(numbers / 10000.0) + 60.0 * minutes + seconds
    steps = np.diff(elapsed[is_number])
    is_forward = steps > 0
    if np.sum(is_forward) < fewest or np.sum(steps < 0) > 0.01 * len(steps):
        return values
    as_numbers, as_times = (
        float(np.mean(np.abs(forward / np.median(forward) - 1.0) <= 0.5))
        for forward in (np.diff(numbers[is_number])[is_forward], steps[is_forward])
    )
    if as_times <= max(as_numbers, even):
        return values
    notes.append(f"`{key}` {TIMES_OF_DAY} as numbers hhmmss.")
    stamps = np.full(len(numbers), np.timedelta64("NaT", "ns"))
    stamps[is_number] = np.rint(1e6 * elapsed[is_number]).astype("timedelta64[us]")
    return stamps


def on_their_days(columns: Columns, units: Mapping[str, str], notes: list[str]) -> Columns:
    """The columns with times of day as dates where another column has the days, else over midnight.

    The days are those of the nearest column of dates alone that has one for each time of day, and a
    later one after midnight. Without such a column a time of day that is much earlier than the one
    before it is of the next day. A column without a unit may hold them as numbers hhmmss.

    Args:
        columns: of one length.
        units: by column, where the file gives them.
        notes: to which a sentence on each column of times of day is appended.
    """
    keys, combined = list(columns), dict(columns)
    for key in [key for key in keys if key not in units]:
        combined[key] = _without_colons(key, columns[key], notes)
    columns = dict(combined)
    for i, key in enumerate(keys):
        if columns[key].dtype.kind != "m":
            continue
        dates = [j for j, name in enumerate(keys) if are_days(columns[name])]
        dates = [keys[j] for j in sorted(dates, key=lambda j: abs(i - j))]
        days = next((date for date in dates if _fit(columns[date], columns[key])), None)
        if days is not None:
            combined[key] = columns[days] + columns[key]
            notes.append(f"`{key}` {TIMES_OF_DAY}: combined with the dates of `{days}`.")
            continue
        combined[key], nights = _over_midnights(columns[key])
        text = f"`{key}` {TIMES_OF_DAY}, read as elapsed time"
        text += f", over {counted(nights, 'midnight')}" if nights else ""
        why = f"; the dates of `{dates[0]}` are not those of these times" if dates else ""
        notes.append(f"{text}{why}.")
    return combined


def are_days(stamps: np.ndarray) -> bool:
    """Whether a column holds dates without a time of day.

    Args:
        stamps: the column, of any type.
    """
    return stamps.dtype.kind == "M" and bool(
        np.all(np.isnat(stamps) | (stamps == stamps.astype("datetime64[D]")))
    )


def _fit(days: np.ndarray, clock: np.ndarray) -> bool:
    """Whether a column of dates has those of times of day: one for each, another after midnight."""
    stamped = ~np.isnat(clock)
    days, clock = days[stamped], clock[stamped]
    if np.any(np.isnat(days)) or np.any(clock > _DAY):
        return False
    return not np.any((np.diff(clock) < -_HALF_DAY) & (np.diff(days) == np.timedelta64(0)))


def _over_midnights(clock: np.ndarray) -> tuple[np.ndarray, int]:
    """Times of day that go on over midnight, and how often they pass it."""
    elapsed = clock.copy()
    (stamped,) = np.nonzero(~np.isnat(clock))
    nights = np.cumsum(np.diff(clock[stamped], prepend=clock[stamped[:1]]) < -_HALF_DAY)
    elapsed[stamped] += nights * _DAY
    return elapsed, int(nights[-1])


def _dates(key: str, values: Any, first: str, notes: list[str]) -> np.ndarray:
    """Instants as datetime64; day before month where points separate them or nothing else fits."""
    texts = values.astype("string").str.replace(r"(\d),(\d)", r"\1.\2", regex=True).str.strip()
    texts = _with_offsets(key, texts, notes)
    named = _NAMED.match(first)
    if named:
        texts, first = texts.str.replace(_NAMED, _with_number, regex=True), _with_number(named)
    texts, is_next_day = _without_midnights(key, texts, notes)
    first = re.sub(_MIDNIGHT, r"00\1", first)
    candidates = _date_orders(texts, first, is_next_day)
    if not candidates:
        texts = _without_words(key, texts, _DATE, notes)
        candidates = _date_orders(texts, first, is_next_day)
    if candidates:  # the order with fewest reversals and the shortest span
        _, _, day_first, stamps = min(candidates, key=lambda candidate: candidate[:3])
        year_first = bool(re.match(r"\d{4}", first))
        order = "year, month, day" if year_first else "day, month" if day_first else "month, day"
        notes.append(f"`{key}` holds dates, read in the order {order}.")
        return stamps.dt.tz_localize(None).to_numpy().astype("datetime64[ns]")
    notes.append(f"`{key}` begins with a date, but holds something else further down.")
    return values.astype(object).to_numpy()


def _with_number(date: re.Match[str]) -> str:
    """A date with the number of its month in place of the name."""
    return f"{date[1]}.{_MONTHS[date[2][:3].lower()]}.{date[3]}"


def _zones(texts: Any) -> tuple[list[str], bool]:
    """The words behind dates and times, in capitals, and whether each date has one."""
    if not texts.str.contains(r"[A-Za-z]{2}$").any():  # fast, for most files
        return [], True
    words = texts.str.extract(_ZONE, expand=False).str.upper()
    if words.isna().all():
        return [], True
    dates = texts.str.match(_DATE).fillna(False)
    return list(words[dates].dropna().unique()), bool(words[dates].notna().all())


def zone_problem(key: str, values: Any) -> str:
    """Why the time zones of a column of dates cannot be told; empty if they can, or it has none.

    Args:
        key: name of the column.
        values: a pandas series; missing where a cell is empty.
    """
    texts = values.dropna()
    first = str(texts.iloc[0]).strip() if len(texts) else ""
    if not _DATE.match(first):
        return ""
    words, everywhere = _zones(texts.astype("string").str.strip())
    if everywhere and (len(words) < 2 or set(words) <= _ZONES.keys()):
        return ""
    zones = ", ".join(f"`{word}`" for word in words[:5])
    zones = f"the time zones {zones}" if everywhere else f"a time zone in some rows only ({zones})"
    return f"`{key}` has {zones}: give each time its offset, such as +01:00, or give all in UTC."


def _with_offsets(key: str, texts: Any, notes: list[str]) -> Any:
    """The texts with offsets in place of the names of time zones.

    A single word that is no known zone is left out: time counts from the first stamp.
    """
    words, _ = _zones(texts)
    if not words:
        return texts
    if set(words) <= _ZONES.keys():
        offsets = {word: f"{_ZONES[word]:+03d}:00" for word in words}
        listed = ", ".join(f"{word} ({offset})" for word, offset in offsets.items())
        notes.append(f"`{key}` has times of {listed}.")
        return texts.str.replace(_ZONE, lambda word: f" {offsets[word[1].upper()]}", regex=True)
    notes.append(f"`{key}` has `{words[0]}` behind all its times: left out.")
    return texts.str.replace(_ZONE, "", regex=True)


def _without_midnights(key: str, texts: Any, notes: list[str]) -> tuple[Any, np.ndarray | None]:
    """The texts with 00:00 in place of 24:00, and where that is of the next day; None: nowhere."""
    midnights = texts.str.contains(_MIDNIGHT).fillna(False).to_numpy(bool)
    if not midnights.any():
        return texts, None
    count = counted(int(midnights.sum()), "time")
    notes.append(f"`{key}` {MIDNIGHTS} {count}: the end of a day, read as 00:00 of the next one.")
    return texts.str.replace(_MIDNIGHT, r"00\1", regex=True), midnights


def _date_orders(
    texts: Any, first: str, is_next_day: np.ndarray | None
) -> list[tuple[int, Any, bool, Any]]:
    """Reversals of time, span and stamps with each order of day and month that fits all texts."""
    import pandas as pd

    year_first = bool(re.match(r"\d{4}", first))
    candidates = []
    for day_first in [False] if year_first else [True] if "." in first[:6] else [False, True]:
        for form in (None, "mixed"):  # a common format is read much faster
            try:
                with warnings.catch_warnings():  # on the ambiguous order
                    warnings.simplefilter("ignore", UserWarning)
                    stamps = pd.to_datetime(texts, dayfirst=day_first, format=form, utc=True)
            except (ValueError, TypeError):
                continue
            if is_next_day is not None:
                stamps += pd.to_timedelta(is_next_day.astype(int), unit="D")
            reversals = int((stamps.diff().dt.total_seconds() < 0).sum())
            candidates.append((reversals, stamps.max() - stamps.min(), day_first, stamps))
            break
    return candidates


def _without_words(key: str, texts: Any, form: re.Pattern[str], notes: list[str]) -> Any:
    """The texts of a column of stamps, missing where they lack a form that most of them have."""
    odd = (texts.notna() & ~texts.str.match(form)).to_numpy(bool)
    rows = np.flatnonzero(odd)
    if not 0 < 2 * len(rows) < len(texts):
        return texts
    place = f"{texts.iloc[rows[0]]!r} in row {rows[0]}, counted from 0"
    more = f", and {len(rows) - 1} more such" if len(rows) > 1 else ""
    notes.append(f"`{key}` has no stamp where it holds {place}{more}.")
    return texts.mask(odd)


def _times_of_day(key: str, values: Any, notes: list[str]) -> np.ndarray:
    """Times since midnight as timedelta64."""
    texts = values.astype("string").str.replace(",", ".").str.strip()
    elapsed = _elapsed(texts)
    if elapsed is None:
        elapsed = _elapsed(_without_words(key, texts, _TIME_OF_DAY, notes))
    if elapsed is None:
        notes.append(f"`{key}` begins with a time of day, but holds something else further down.")
        return values.astype(object).to_numpy()
    return elapsed.astype("timedelta64[ns]")


def _elapsed(texts: Any) -> np.ndarray | None:
    """Times since midnight; None where a text is no time of day."""
    import pandas as pd

    short = texts.str.count(":") == 1
    try:
        if texts.str.contains("m", case=False).any():
            clock = pd.to_datetime("2000-01-01 " + texts, format="mixed")
            return (clock - pd.Timestamp("2000-01-01")).to_numpy()
        return pd.to_timedelta(texts.where(~short, texts + ":00")).to_numpy()
    except (ValueError, TypeError):
        return None
