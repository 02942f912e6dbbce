"""Words in a column of numbers: switches logged as ON and OFF, marks of no value, limits."""

import re
from collections import Counter
from collections.abc import Mapping

import numpy as np

from eoi_jax._checks import counted

_SWITCHES = (
    {"on": 1.0, "off": 0.0},
    {"true": 1.0, "false": 0.0},
    {"yes": 1.0, "no": 0.0},
)
# What historians, meters and home automation write where a sensor gave nothing.
_NO_VALUE = {
    "arc off-line", "bad", "bad data", "bad input", "bad quality", "calc failed", "comm fail",
    "configure", "error", "fault", "i/o timeout", "inp outrange", "intf shut", "invalid",
    "missing", "no data", "no result", "no sample", "no value", "nodata", "not available",
    "not connect", "offline", "over range", "overflow", "overrange", "pt created", "scan off",
    "scan timeout", "shutdown", "timeout", "unavailable", "under range", "unknown", "<null>",
    "fehler", "fühlerbruch", "kein wert", "keine daten", "messfehler", "nicht verfügbar",
    "sensorfehler", "störung", "überlauf", "ungültig", "unbekannt",
}  # fmt: skip
# Beyond the range of an oscilloscope, not a number and infinity of the C library of Windows, and
# error codes of a historian with a text.
_NO_NUMBER = re.compile(
    r"[+-]?∞$|-?nan\((ind|snan)\)$|[+-]?1\.#(inf|ind|s?nan|qnan)\d*$|\[-\d{2,6}\] \S.*$"
)
_MARKS = re.compile(r"[-–*?#.=_]+$")
BEYOND = "is beyond a limit of detection"  # behind the name of a column
# What laboratories write for a value beyond a limit of detection or of quantification.
_LIMIT = r"lod|loq|lloq|uloq|mdl|mql"
_BEYOND = re.compile(
    rf"[<>≤≥]=?\s*([\d.,]+(e[+-]?\d+)?|{_LIMIT})(\s*\S{{1,8}})?$"
    rf"|({_LIMIT}|bloq|blq|bql|bdl|bld|aloq|alq|n\.?\s?d\.?)$"
)


def without_words(key: str, cells: np.ndarray, notes: list[str]) -> np.ndarray:
    """A column of text as numbers, if its words are those of a switch, of no value or of a limit.

    Args:
        key: name of the column.
        cells: of the type object; None where a cell is empty.
        notes: to which a sentence on the words is appended.

    Returns:
        Numbers, NaN for marks of no value and for values beyond a limit; the cells as they are
        where another word stands in one.
    """
    texts = [str(cell).strip().lower() for cell in cells]
    words = Counter(text for text in texts if not _is_number(text))
    empty = sum(words.pop(text, 0) for text in ("none", "nan", ""))
    marks = {word: number for word, number in words.items() if _is_mark(word)}
    limits = {word: number for word, number in words.items() if _BEYOND.match(word)}
    states = words.keys() - marks.keys() - limits.keys()
    switch = next((pair for pair in _SWITCHES if states and states <= pair.keys()), {})
    has_numbers = sum(words.values()) + empty < len(texts)
    if not words or bool(switch) == has_numbers or states - switch.keys():
        return cells
    if switch:
        listed = ", ".join(f"{word} is {value:g}" for word, value in switch.items())
        notes.append(f"`{key}` is a switch: {listed}.")
    if marks:
        listed = ", ".join(f"`{word}`" for word in list(marks)[:5])
        total = counted(sum(marks.values()), "cell")
        notes.append(f"`{key}` has no number in {total} ({listed}): taken as not measured.")
    if limits:
        notes.append(_note_on_limits(key, limits, len(texts) - empty))
    missing = dict.fromkeys((*marks, *limits, "none", ""), np.nan)
    return np.asarray([(missing | switch).get(text, text) for text in texts], dtype=np.float64)


def _note_on_limits(key: str, limits: Mapping[str, int], size: int) -> str:
    listed = ", ".join(f"`{word}`" for word in list(limits)[:5])
    return (
        f"`{key}` {BEYOND} in {sum(limits.values())} of {size} cells "
        f"({listed}): taken as not measured. That the values there are small, or large, is not "
        "used: the tail is censored, and estimates may be biased."
    )


_WITH_UNIT = re.compile(
    r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([^\d\s.,;:+*/-]\S{0,5})\s*$"
)


def without_unit(cells: np.ndarray) -> tuple[np.ndarray, str]:
    """Numbers that have the same unit behind each of them, as ``21.5 °C``, and that unit.

    Args:
        cells: of the type object; None where a cell is empty.

    Returns:
        The cells as they are, and no unit, where one has none or another one.
    """
    matches = [_WITH_UNIT.match(str(cell)) for cell in cells if cell is not None]
    units = {match[2] if match else "" for match in matches}
    if len(units) != 1 or "" in units:
        return cells, ""
    numbers = (float(match[1]) for match in matches if match)
    return np.asarray([np.nan if cell is None else next(numbers) for cell in cells]), units.pop()


_GROUPED = re.compile(r"[+-]?\d{1,3}([,.' ]\d{3})+([.,]\d*)?")


def is_grouped(text: str) -> bool:
    """Whether a cell is a number with thousands separators, as ``1,000.5`` or ``1.000,5``."""
    return _GROUPED.fullmatch(text.strip()) is not None


def _is_mark(word: str) -> bool:
    return word in _NO_VALUE or bool(_MARKS.match(word) or _NO_NUMBER.match(word))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text != "nan"
