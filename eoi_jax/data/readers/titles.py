"""Names and units of the columns of a text table, from the lines above its data.

The last line above the data has the names, or the units below the names. Instruments write their
settings above, each behind its key: `Vertical Units,V,A`. Some are units, labels, or the time
between samples.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.readers.cells import as_number, trimmed
from eoi_jax.data.time_axis import declared_unit, is_called_time

COUNTS = "counts the samples"  # how the note on such a column goes on behind its name
# Units as instruments spell them out; none of stamps and numbers of records (TOA5).
_SYMBOLS = {
    "volt": "V", "volts": "V", "millivolt": "mV", "millivolts": "mV", "amp": "A", "amps": "A",
    "ampere": "A", "amperes": "A", "milliampere": "mA", "watt": "W", "watts": "W", "ohm": "Ω",
    "ohms": "Ω", "hertz": "Hz", "second": "s", "seconds": "s", "deg c": "°C", "ts": "", "rn": "",
}  # fmt: skip
_CHANNEL_UNITS = re.compile(r"(v|y|vertical|)[ _]?units?([ _]label)?$", re.IGNORECASE)
_TIME_UNIT = re.compile(r"(h|x|horizontal)[ _]?units?([ _]label)?$", re.IGNORECASE)
_LABELS = re.compile(r"labels?$", re.IGNORECASE)
_TRACES = re.compile(r"(trace|channel|signal) ?names?$", re.IGNORECASE)
_PERIOD = re.compile(
    r"sampl(e|ing)[ _](interval|period)|h[ _]?resolution|delta[ _]x|x[ _]?increment", re.IGNORECASE
)

# How a logger made its values of the samples of an interval, below their units (TOA5).
_PROCESSES = frozenset(("avg", "max", "med", "min", "mom", "smp", "std", "tot", ""))
_PREFIXED = r"[kMGmµμunp]?(?:V|A|W|Ω|Ohm|Hz|F|H|C|S|T|N|J|K|g|m|s|bar|Pa|Ah|Wh|rad)"
_FACTOR = rf"(?:{_PREFIXED}|°C|°F|°|deg|%|min|h|rpm|cm|hPa)(?:[²³]|\^?-?[123])?"
_UNIT = re.compile(rf"{_FACTOR}(?:[.·*/]{_FACTOR})*")


@dataclass(frozen=True)
class Titles:
    """What the lines above the data say of the columns.

    Attributes:
        names: of the columns from the first on; empty where there are none.
        units: of the same columns, empty where a column has none.
        lines: number of lines that the names and units take.
        count: time of sample 0 and between samples [s], where the first column counts the samples.
        period: the setting that gives the time between samples, and that time [s].
        notes: sentences on labels.
    """

    names: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    lines: int = 0
    count: tuple[float, float] | None = None
    period: tuple[str, float] | None = None
    notes: tuple[str, ...] = ()


def read_titles(header: Sequence[list[str]], width: int, keyed: bool) -> Titles:
    """The names and units in the rows above the data.

    Args:
        header: rows with a cell at least, the last one right above the data.
        width: cells of a row of data.
        keyed: whether the first column of the data is empty, below the keys of the settings.
    """
    rows = [trimmed(cells) for cells in header]
    if len(rows) > 2 and _PROCESSES.issuperset(cell.lower() for cell in rows[-1]):
        rows.pop()
    titles = _counted(rows) or (_traces(rows) if keyed else None) or _last_rows(rows, width)
    settings = {row[0]: row[1:] for row in rows if row[1:] and tuple(row) != titles.names}
    period = _period(settings)
    if not any(titles.units):
        titles = replace(titles, units=_units_of_settings(settings, titles.names))
    symbols = tuple(_SYMBOLS.get(unit.lower(), unit) for unit in titles.units)
    notes = _labels(settings, titles.names)
    return replace(titles, units=symbols, period=period, notes=notes)


def _last_rows(rows: Sequence[list[str]], width: int) -> Titles:
    """Names in the last row, or in the one above it if the last may hold their units."""
    upper, last = rows[-2] if len(rows) > 1 else [], rows[-1]
    if (
        len(upper) in (width, width - 1)
        and all(upper)
        and len(set(upper)) == len(upper) >= len(last)
        and are_units(last)
        and not _are_names(last, upper)
    ):
        return Titles(tuple(upper), tuple(cell.strip("[]() ") for cell in last), 2)
    return Titles(tuple(last), (), 1)


def _are_names(cells: list[str], upper: list[str]) -> bool:
    """Whether a row begins with a name of time, has no unit, and stands below no such name."""
    is_time = is_called_time(cells[0]) and declared_unit("", cells[0]) is None
    has_unit = any(_UNIT.fullmatch(cell.strip("[]() ")) for cell in cells[1:])
    return is_time and not has_unit and not is_called_time(upper[0])


def _counted(rows: Sequence[list[str]]) -> Titles | None:
    """Names and units above columns of which the first counts samples; None where they are not.

    Rigol oscilloscopes write `X, …, Start, Increment` above `Sequence, …, -0.002, 2e-6`.
    """
    upper, last = rows[-2] if len(rows) > 1 else [], rows[-1]
    if [cell.lower() for cell in upper[-2:]] != ["start", "increment"] or len(upper) != len(last):
        return None
    start, increment = map(as_number, last[-2:])
    if not (np.isfinite(start) and increment > 0):
        return None
    return Titles(tuple(upper[:-2]), ("s", *last[1:-2]), 2, (start, increment))


def _traces(rows: Sequence[list[str]]) -> Titles | None:
    """Names behind the key of the traces, above a first column that is empty."""
    names = next((cells[1:] for cells in rows if _TRACES.match(cells[0])), None)
    return None if names is None else Titles(("", *names), (), 1)


def _units_of_settings(settings: dict[str, list[str]], names: Sequence[str]) -> tuple[str, ...]:
    """Units of the columns as settings give them; none where they are not as many."""
    units = next((cells for key, cells in settings.items() if _CHANNEL_UNITS.match(key)), [])
    good = len(units) in (len(names) - 1, len(names) - 2) and all(units)
    return (_unit_of_time(settings) if names[0] else "", *units) if good else ()


def _unit_of_time(settings: dict[str, list[str]]) -> str:
    return next((cells[0] for key, cells in settings.items() if _TIME_UNIT.match(key)), "")


def _labels(settings: dict[str, list[str]], names: Sequence[str]) -> tuple[str, ...]:
    """A sentence on the labels that somebody gave the channels."""
    labels = next((cells for key, cells in settings.items() if _LABELS.match(key)), [])
    pairs = [(name, label) for name, label in zip(names[1:], labels, strict=False) if label]
    listed = ", ".join(f"`{name}` is {label}" for name, label in pairs if name != label)
    return (f"Labels in the file: {listed}.",) if listed else ()


def _period(settings: dict[str, list[str]]) -> tuple[str, float] | None:
    """The setting that gives one time between samples for all channels, and that time [s]."""
    unit = declared_unit("", _unit_of_time(settings) or "s")
    if unit is None:  # a spectrum, over frequencies
        return None
    for key, cells in settings.items():
        values = {as_number(cell) for cell in cells if cell}
        if _PERIOD.match(key) and len(values) == 1 and min(values) > 0:
            return key, unit[1] * values.pop()
    return None


def are_units(cells: Sequence[str]) -> bool:
    """Whether a row may hold units: short texts without spaces, possibly in brackets.

    Of numbers only 1 is a unit, and none that something is less than.

    Args:
        cells: of the row.
    """
    filled = [cell.strip("[]()") for cell in cells if cell]
    return bool(filled) and all(
        len(cell) <= 12
        and (" " not in cell or cell.lower() in _SYMBOLS)
        and (cell == "1" or np.isnan(as_number(cell.lstrip("<>≤≥="))))
        for cell in filled
    )


_BRACKETED = re.compile(r"(.*\S)(\s*)[\[(]\s*([^\[\]()]{1,12}?(?:\([ag]\))?)\s*[\])]$")


def units_in_names(names: Sequence[str]) -> dict[str, str]:
    """Units within the names: ``voltage [V]``, ``angle (rad)``, ``p [bar(g)]``.

    A number is none but 1 behind a space, where no further name has another one there.

    Args:
        names: of the columns.
    """
    matches = {name: match for name in names if (match := _BRACKETED.match(name))}
    numbered = Counter(match[1] for match in matches.values() if match[3].isdigit())
    return {
        name: match[3]
        for name, match in matches.items()
        if not match[3].isdigit() or ((match[3], numbered[match[1]]) == ("1", 1) and match[2])
    }


_EITHER_UNIT = "V/mA"  # of `control/V/mA`, which EC-Lab writes for a voltage or a current


def names_before_slashes(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Names and units of columns that are called by quantity and unit: ``I/mA``, ``U / V``.

    A slash may also be that of a path: at least two names must have a unit behind their first one,
    and all names must differ without.

    Args:
        names: of the columns.

    Returns:
        Name and unit by full name, without those that have none.
    """
    split: dict[str, tuple[str, str]] = {}
    for name in names:
        quantity, end = (part.strip() for part in name.partition("/")[::2])
        if quantity and _UNIT.fullmatch(end):
            split[name] = quantity, "" if end == _EITHER_UNIT else end
    short = {split[name][0] if name in split else name for name in names}
    return split if len(split) > 1 and len(short) == len(names) else {}
