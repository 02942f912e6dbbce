"""Cells that hold no value as the caller says: numbers such as -999, words such as Inp OutRange."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np

from eoi_jax._checks import check, check_choice, check_kind, counted
from eoi_jax.data.readers.words import without_words
from eoi_jax.data.resampling import Real

Code: TypeAlias = Real | str
Codes: TypeAlias = Code | Sequence[Code]


def codes_by_column(
    missing: Codes | Mapping[str, Codes] | Mapping[int, Codes], columns: Sequence[str]
) -> dict[str, tuple[Code, ...]]:
    """The codes of each column.

    Args:
        missing: for all columns, or by column; a single one may stand without a list.
        columns: inputs and outputs that are read.

    Raises:
        ValueError: a column that is not read; a code that is neither a finite number nor a word.
    """
    table = missing if isinstance(missing, Mapping) else dict.fromkeys(columns, missing)
    codes = {str(key): _listed(f"missing[{key}]", value) for key, value in table.items()}
    for key in codes:
        check_choice("missing", key, tuple(columns))
    return codes


def _listed(field: str, codes: Codes) -> tuple[Code, ...]:
    listed = (codes,) if isinstance(codes, Code) else tuple(codes)
    for code in listed:
        check_kind(field, code, (str, int, float, np.integer, np.floating), "a number or a word")
        good = bool(code.strip()) if isinstance(code, str) else bool(np.isfinite(code))
        check(good, field, "must be finite numbers and words that are not empty", repr(code))
    return listed


def without_missing(
    key: str, cells: np.ndarray, codes: Sequence[Code], notes: list[str]
) -> np.ndarray:
    """A column with NaN in place of its codes; one of text as numbers, if it holds no other word.

    Args:
        key: name of the column.
        cells: numbers, or objects; None where a cell is empty.
        codes: numbers as the file has them, and words; the case of letters does not matter.
        notes: to which a sentence on the codes is appended.
    """
    if not codes or cells.dtype.kind not in "biufO":
        return cells
    numbers = [number for number in map(_number, codes) if np.isfinite(number)]
    words = {str(code).strip().lower() for code in codes}
    if cells.dtype.kind == "O":
        is_code = np.asarray([_is_code(cell, numbers, words) for cell in cells], dtype=bool)
        names = [str(cell).strip() for cell in cells[is_code]]
        cells = cells.copy()
        cells[is_code] = None
        cells = without_words(key, cells, notes)
    else:
        is_code = np.isin(cells, numbers)
        names = [f"{float(cell):.12g}" for cell in cells[is_code]]
        cells = np.where(is_code, np.nan, cells)
    if names:
        listed = ", ".join(f"`{name}`" for name in list(Counter(names))[:5])
        count = counted(len(names), "cell")
        notes.append(f"`{key}` has no value in {count} ({listed}), as `missing` says.")
    return cells


def _is_code(cell: object, numbers: Sequence[float], words: set[str]) -> bool:
    text = str(cell).strip().lower()
    return text in words or (cell is not None and _number(text) in numbers)


def _number(text: object) -> float:
    """The number that a text is; NaN where it is none."""
    try:
        return float(str(text))
    except ValueError:
        return float("nan")
