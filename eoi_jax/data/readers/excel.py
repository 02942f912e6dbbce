"""Excel files: the first sheet that is not empty, read as a text table."""

from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.parsers import expat
from zipfile import ZipFile

from eoi_jax.data.readers.delimited import read_lines
from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.table import Table


def read_excel(path: Path, allowance: Allowance) -> Table:
    """The table of a sheet; names and units are detected as in a text table.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: the file is damaged, or unpacks to more than is allowed.
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
    filled = {name: sheet for name, sheet in sheets.items() if not sheet.empty}
    if not filled:
        return Table({})
    name, first = next(iter(filled.items()))
    table = read_lines(first.to_csv(sep=";", header=False, index=False))
    choice = f", the first of {len(filled)} that hold anything" if len(filled) > 1 else ""
    return replace(table, notes=(f"Read from the sheet `{name}`{choice}.", *table.notes))


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
