"""Cells of a text table: numbers, stamps, and those without a value."""

import csv
import re

from eoi_jax.data.readers.stamps import is_stamp

# Cells without a value, as spreadsheets (in English and German), pandas and people write them.
NO_VALUE = (
    "", "nan", "NaN", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "n.a.", "N.A.",
    "k.A.", "k. A.", "#DIV/0!", "#VALUE!", "#REF!", "#NUM!", "#NAME?", "#NULL!", "#WERT!", "#NV",
    "#BEZUG!", "#ZAHL!",
)  # fmt: skip
EMPTY = {word.lower() for word in NO_VALUE}
POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?$|[+-]?inf(inity)?$", re.IGNORECASE)
_OVER_RANGE = ("∞", "+∞", "-∞")
COMMA = re.compile(r"[+-]?(\d+,\d+|,\d+)([eE][+-]?\d+)?$")


def as_number(cell: str) -> float:
    """The number in a cell, with either decimal mark; NaN where there is none.

    Args:
        cell: without spaces around it.
    """
    is_number = POINT.match(cell) or COMMA.match(cell)
    return float(cell.replace(",", ".").upper().replace("D", "E")) if is_number else float("nan")


def is_value(cell: str) -> bool:
    """Whether a cell holds a number or a stamp, or is one without a value.

    Args:
        cell: of a text table.
    """
    text = cell.strip()
    is_mark = text.lower() in EMPTY or text in _OVER_RANGE
    return is_mark or bool(POINT.match(text) or COMMA.match(text)) or is_stamp(text)


def trimmed(cells: list[str]) -> list[str]:
    """The cells without those at the end that are empty.

    Args:
        cells: of a row.
    """
    cells = list(cells)
    while cells and not cells[-1]:
        cells.pop()
    return cells


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of a line, without spaces around them.

    Args:
        line: of a text table.
        separator: between the cells; empty for spaces.
    """
    if not separator:
        return line.split()
    rows = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(rows)]
