"""Excel files: one sheet, read as a text table; by default the first that is not empty."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.parsers import expat
from zipfile import ZipFile

from eoi_jax.data.readers.delimited import read_lines
from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.table import Table


def read_excel(path: Path, allowance: Allowance, sheet: str | None = None) -> Table:
    """The table of a sheet; names and units are detected as in a text table.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.
        sheet: its name; None: the first that is not empty.

    Raises:
        ValueError: the file is damaged, unpacks to more than is allowed, or lacks the sheet.
    """
    import pandas as pd

    allowance.take_archive(path)
    _check_extent(path, allowance)
    try:
        sheets = pd.read_excel(path, sheet_name=None, header=None)
    except ImportError as failure:
        raise ValueError(
            "reading it needs openpyxl: pip install 'eoi_jax[excel]', or export it as .csv"
        ) from failure
    filled = [name for name, cells in sheets.items() if not cells.empty]
    if sheet is not None and sheet not in filled:
        listed = ", ".join(f"`{name}`" for name in filled) or "none"
        raise ValueError(f"it has no sheet `{sheet}` that holds anything; those that do: {listed}")
    if not filled:
        return Table({})
    name = filled[0] if sheet is None else sheet
    names = (name, *(key for key in filled if key != name))
    choice = Table({}, sheets=names).sheet_text
    try:
        table = read_lines(sheets[name].to_csv(sep=";", header=False, index=False), ";")
    except ValueError as failure:
        raise ValueError(f"{failure}. {choice}".strip()) from failure
    note = choice or f"Read from the sheet `{name}`."
    return replace(table, sheets=names, notes=(note, *table.notes))


def _check_extent(path: Path, allowance: Allowance, cell_size: int = 64) -> None:
    """Count the memory of the sheets: each is the rectangle up to its last row and column.

    A cell takes `cell_size` bytes in memory, filled or not.
    """
    with ZipFile(path) as archive:
        for member in archive.namelist():
            if member.endswith(".xml"):
                with archive.open(member) as stream:
                    rows, columns = _extent(stream)
                allowance.take(float(cell_size) * rows * columns)


def _extent(stream: Any) -> tuple[int, int]:
    """The last row and the last column that a part of the file names."""
    last = {"row": 0, "column": 0}

    def on_start(name: str, attributes: dict[str, str]) -> None:
        place = attributes.get("r", "")
        if name.rpartition(":")[2] in ("row", "c") and place:
            letters = place.rstrip("0123456789")
            last["row"] = max(last["row"], int(place[len(letters) :] or 0))
            last["column"] = max(last["column"], _number(letters))

    parser = expat.ParserCreate()
    parser.StartElementHandler = on_start
    parser.ParseFile(stream)
    return last["row"], last["column"]


def _number(letters: str) -> int:
    """Number of a column from its letters A … Z, AA, …."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + ord(letter) - ord("A") + 1
    return number
