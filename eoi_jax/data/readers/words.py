"""Words in a column of numbers: switches that are logged as ON and OFF, and marks of no value."""

import re
from collections import Counter

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
    "configure", "fault", "i/o timeout", "intf shut", "invalid", "no data", "no result",
    "no sample", "no value", "nodata", "not available", "not connect", "offline", "over range",
    "overflow", "overrange", "pt created", "scan off", "scan timeout", "shutdown", "timeout",
    "unavailable", "under range", "unknown",
}  # fmt: skip
_MARKS = re.compile(r"[-–*?#.=_]+$")


def without_words(key: str, cells: np.ndarray, notes: list[str]) -> np.ndarray:
    """A column of text as numbers, if its words are those of a switch or marks of no value.

    Args:
        key: name of the column.
        cells: of the type object; None where a cell is empty.
        notes: to which a sentence on the words is appended.

    Returns:
        Numbers, NaN for marks of no value; the cells as they are where another word stands in one.
    """
    texts = [str(cell).strip().lower() for cell in cells]
    words = Counter(text for text in texts if not _is_number(text))
    empty = sum(words.pop(text, 0) for text in ("none", "nan", ""))
    marks = {word: number for word, number in words.items() if _is_mark(word)}
    states = words.keys() - marks.keys()
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
    missing = dict.fromkeys((*marks, "none", ""), np.nan)
    return np.asarray([(missing | switch).get(text, text) for text in texts], dtype=np.float64)


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
    return word in _NO_VALUE or bool(_MARKS.match(word))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return text != "nan"
