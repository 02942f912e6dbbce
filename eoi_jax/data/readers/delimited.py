"""Text tables: detection of separator, decimal mark, header, units and first row of data.

The separator is the one with which most cells are numbers. The data start at the first row that
has the form of the rows further down, with the rows straight above it that hold a word among
their values; the row above them holds the names. A row of units and lines before the header are
recognised in the same way.
"""

import csv
import gzip
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._checks import counted
from eoi_jax.data.readers.limits import PIECE, Allowance
from eoi_jax.data.readers.stamps import is_stamp, on_their_days, read_stamps, zone_problem
from eoi_jax.data.readers.table import Columns, Table
from eoi_jax.data.readers.words import without_unit, without_words

_SEPARATORS = (";", "\t", ",", "|", "")  # "" for spaces
# Cells without a value, as spreadsheets (in English and German), pandas and people write them.
_NO_VALUE = (
    "", "nan", "NaN", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "n.a.", "N.A.",
    "k.A.", "k. A.", "#DIV/0!", "#VALUE!", "#REF!", "#NUM!", "#NAME?", "#NULL!", "#WERT!", "#NV",
    "#BEZUG!", "#ZAHL!",
)  # fmt: skip
_EMPTY = {word.lower() for word in _NO_VALUE}
_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?$|[+-]?inf(inity)?$", re.IGNORECASE)
_OVER_RANGE = ("∞", "+∞", "-∞")
_COMMA = re.compile(r"[+-]?(\d+,\d+|,\d+)([eE][+-]?\d+)?$")
# First bytes of files that are not text, whatever their name.
_KINDS = (
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"PK\x03\x04", "a zip archive, as of a spreadsheet (.xlsx)"),
    (b"\xd0\xcf\x11\xe0", "an old Excel file (.xls)"),
    (b"\x1f\x8b", "compressed by gzip (.gz)"),
    (b"\x89HDF", "an HDF5 file (.h5)"),
    (b"PAR1", "a Parquet file (.parquet)"),
    (b"MATLAB", "a MATLAB file (.mat)"),
    (b"\x93NUMPY", "a NumPy array (.npy)"),
    (b"SQLite", "an SQLite database"),
)


@dataclass(frozen=True)
class _Layout:
    """Format of a text table."""

    separator: str
    decimal: str
    start: int  # line at which the data start
    names: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]


def read_text(path: Path, allowance: Allowance) -> Table:
    """The columns of a text file, numbers as float64, dates as datetime64, others as text.

    Args:
        path: .csv, .tsv, .txt, .dat, also with .gz.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: a file that is not text, holds no data, repeats a name, or unpacks to more than
            is allowed.
    """
    if _is_compressed(path):
        _check_size(path, allowance)
    first = _first_bytes(path)
    kind = next((name for mark, name in _KINDS if first.startswith(mark)), None)
    if kind is not None:
        raise ValueError(
            f"it is {kind}, not text; give it the ending it should have, or export it as text"
        )
    encoding = _encoding(first)
    with _open_text(path, encoding) as stream:
        return _read(path, _head(stream), encoding)


def line_of(path: Path, row: int) -> int:
    """Line number, from 1, of a row of the table in a text file; blank lines hold no row.

    Args:
        path: as in `read_text`.
        row: counted from 0.
    """
    with _open_text(path, _encoding(_first_bytes(path))) as stream:
        head = _head(stream)
        layout = _layout([line.rstrip("\r\n") for line in head])
        blanks = " \r\n" if layout.separator == "\t" else None
        numbered = islice(enumerate(chain(head, stream), 1), layout.start, None)
        filled = (number for number, line in numbered if line.strip(blanks))
        return next(islice(filled, row, None))


def _first_bytes(path: Path) -> bytes:
    with gzip.open(path, "rb") if _is_compressed(path) else path.open("rb") as stream:
        return stream.read(4096)


def _open_text(path: Path, encoding: str) -> Any:
    opener = gzip.open if _is_compressed(path) else open
    return opener(path, "rt", encoding=encoding, errors="replace", newline=None)


def _check_size(path: Path, allowance: Allowance) -> None:
    with gzip.open(path, "rb") as stream:
        while piece := stream.read(PIECE):
            allowance.take(len(piece))


def _is_compressed(path: Path) -> bool:
    return path.suffix.lower() == ".gz"


def read_lines(text: str, separator: str) -> Table:
    """The columns of a text table in memory.

    Args:
        text: the table.
        separator: between its cells.
    """
    return _read(io.StringIO(text), _head(io.StringIO(text)), "utf-8", separator)


def _head(stream: Iterable[str], lines: int = 200) -> list[str]:
    """The first lines, from which the layout is detected."""
    return list(islice(stream, lines))


def _frame(source: Any, layout: _Layout, encoding: str) -> Any:
    """All cells as a `pandas.DataFrame`."""
    import pandas as pd  # heavy; only files need it

    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", pd.errors.DtypeWarning
        )  # such a column is named if asked for
        try:
            return pd.read_csv(
                source,
                header=None,
                skiprows=layout.start,
                sep=layout.separator or r"\s+",
                skipinitialspace=True,
                decimal=layout.decimal,
                encoding=encoding,
                encoding_errors="replace",
                na_values=list(_NO_VALUE),
            )
        except pd.errors.ParserError as failure:
            raise _too_long(failure) from None


def _too_long(failure: ValueError) -> ValueError:
    """What the parser says, of a line with too many cells with what to do."""
    match = re.search(r"Expected (\d+) fields in line (\d+), saw (\d+)", str(failure))
    if match is None:
        return failure
    usual, line, cells = match.groups()
    return ValueError(
        f"line {line} has {cells} cells, the lines before it {usual}; where two lines have run "
        "together, or a text holds the separator, mend that line or leave it out"
    )


def _encoding(first: bytes) -> str:
    if first.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if b"\0" in first:
        raise ValueError("it is not text")
    for cut in range(4):  # the piece may end within a character
        try:
            first[: len(first) - cut].decode("utf-8")
            return "utf-8-sig"
        except UnicodeDecodeError:
            continue
    return "cp1252"  # degree signs and umlauts of Windows


def _read(source: Any, lines: Sequence[str], encoding: str, separator: str | None = None) -> Table:
    layout = _layout([line.rstrip("\r\n") for line in lines], separator)
    frame = _frame(source, layout, encoding)
    notes = list(layout.notes)
    filled = np.flatnonzero(frame.notna().any(axis=1).to_numpy())
    empty = len(frame) - int(filled[-1]) - 1 if len(filled) else 0
    if empty:
        frame = frame.iloc[: len(frame) - empty].infer_objects()
        notes.append(f"Left out at the end: {counted(empty, 'empty row')}.")
    names = list(layout.names)
    while len(names) < frame.shape[1] > 1 and bool(frame.iloc[:, -1].isna().all()):
        frame = frame.iloc[:, :-1]  # rows that end in a separator
    fits = len(names) == frame.shape[1]
    keys = names if fits else [str(i) for i in range(frame.shape[1])]
    keys = [key or str(i) for i, key in enumerate(keys)]
    repeated = [key for key, count in Counter(keys).items() if count > 1]
    if repeated:
        names_text = ", ".join(repeated[:5])
        raise ValueError(f"its header repeats a name: {names_text}; give each column its own name")
    if names and not fits:
        what = f"{counted(len(names), 'name')} for {counted(frame.shape[1], 'column')}"
        notes.append(f"The header has {what}: left out, and the columns are numbered from 0.")
    units = {key: unit for key, unit in zip(keys, layout.units, strict=False) if unit and fits}
    columns: Columns = {}
    objects: dict[str, str] = {}
    for i, key in enumerate(keys):
        grouped = _thousands(frame[i]) if layout.decimal == "," else ""
        if grouped:
            objects[key] = (
                f"`{key}` holds {grouped!r} in a table with decimal commas: write numbers without "
                "thousands separators, and with decimal commas throughout."
            )
            continue
        problem = zone_problem(key, frame[i])
        if problem:
            objects[key] = problem
            continue
        columns[key] = _column(key, frame[i], layout.decimal, notes)
        if columns[key].dtype.kind == "O":
            columns[key], unit = without_unit(columns[key])
            units |= {key: unit} if unit else {}
    units = {**_named_units(keys), **units}
    columns = on_their_days(columns, units, notes)
    return Table(columns, units, tuple(notes), objects)


def first_word(cells: Iterable[Any]) -> str:
    """The first text that is no number among cells; else the first text, or an empty one.

    Args:
        cells: of a column of text.
    """
    texts = [cell for cell in cells if isinstance(cell, str)]
    numbers = (bool(_POINT.match(text.strip()) or _COMMA.match(text.strip())) for text in texts)
    words = (text for text, is_number in zip(texts, numbers, strict=True) if not is_number)
    return next(words, texts[0] if texts else "")


def _column(key: str, values: Any, decimal: str, notes: list[str]) -> np.ndarray:
    """A column as numbers, as dates or times of day where it holds such, else as text."""
    if values.dtype.kind in "biuf":
        return values.to_numpy()
    texts = values.dropna()
    first = str(texts.iloc[0]).strip() if len(texts) else ""
    if is_stamp(first):
        return read_stamps(key, values, first, notes)
    array = values.astype(object).where(values.notna(), None).to_numpy()
    if decimal == ",":  # a cell that is no number keeps pandas from converting the column
        array = np.asarray([_with_decimal_point(cell) for cell in array], dtype=object)
    return without_words(key, array, notes)


def _thousands(values: Any) -> str:
    """The first cell that is a whole number with thousands points, or one with a decimal point."""
    if values.dtype.kind in "biuf":
        return ""
    cells = values.dropna().astype("string").str.strip()
    return next(iter(cells[cells.str.fullmatch(r"[+-]?[1-9]\d{0,2}(\.\d{3})+")]), "")


def _with_decimal_point(cell: Any) -> Any:
    return cell.replace(",", ".") if isinstance(cell, str) and _COMMA.match(cell.strip()) else cell


# -- layout -------------------------------------------------------------------------------


def _layout(lines: Sequence[str], separator: str | None = None) -> _Layout:
    """Separator if it is not known, decimal mark, first row of data, names and units."""
    filled = [(i, line) for i, line in enumerate(lines) if line.strip()]
    remarks = [(i, line) for i, line in filled if line.lstrip()[0] in "%#"]
    body = [(i, line) for i, line in filled if line.lstrip()[0] not in "%#"]
    if not body:
        raise ValueError("it holds no data")
    sample = [line for _, line in body[len(body) // 2 :]]
    if separator is None:
        separator = max(_SEPARATORS, key=lambda mark: _score(sample, mark))
    rows = [(i, _cells(line, separator)) for i, line in body]
    width, value_columns = _value_columns([cells for _, cells in rows[len(rows) // 2 :]])
    start = next(
        (k for k, (_, cells) in enumerate(rows) if _is_data_row(cells, width, value_columns)), None
    )
    if start is None and len(rows) < 2:
        raise ValueError("it holds no data: one line of text only")
    start = 1 if start is None else start
    while start > 0 and _has_data([cells for _, cells in rows], start, width, value_columns):
        start -= 1
    notes = []
    decimal = "."
    data = [cells for _, cells in rows[start:]]
    commas = sum(bool(_COMMA.match(cell)) for cells in data for cell in cells)
    points = sum("." in cell and bool(_POINT.match(cell)) for cells in data for cell in cells)
    if commas > points:
        decimal = ","
        notes.append("Numbers are written with decimal commas.")
    header = [cells for i, cells in rows[:start] if len(_trimmed(cells)) > 0]
    names, units = _titles(header, remarks, rows[start][0], width, separator)
    used = (names is not None) + bool(units) if header else 0
    if len(header) > used and header:
        lines = counted(len(header) - used, "line")
        notes.append(f"Skipped before the header: {lines}.")
    return _Layout(separator, decimal, rows[start][0], tuple(names or ()), units, tuple(notes))


def _titles(
    header: list[list[str]],
    remarks: list[tuple[int, str]],
    first: int,
    width: int,
    separator: str,
) -> tuple[list[str] | None, tuple[str, ...]]:
    """Names and units of the columns from the rows or comment lines above the data."""
    if not header:
        preceding = [line for i, line in remarks if i < first]
        if not preceding:
            return None, ()
        text = preceding[-1].strip().lstrip("%#").strip()
        return _trimmed(_cells(text, separator if separator in text else "")), ()
    last_row, rows = _trimmed(header[-1]), [_trimmed(cells) for cells in header]
    names_above_units = len(rows) > 1 and len(rows[-2]) in (width, width - 1) and all(rows[-2])
    if (
        names_above_units
        and len(set(rows[-2])) == len(rows[-2]) >= len(last_row)
        and _are_units(last_row)
    ):
        return rows[-2], tuple(cell.strip("[]() ") for cell in last_row)
    return last_row, ()


def _are_units(cells: list[str]) -> bool:
    """Whether a row may hold units: short texts without spaces, possibly in brackets.

    Of numbers only 1 is a unit, and none that something is less than.
    """
    filled = [cell.strip("[]()") for cell in cells if cell]
    return bool(filled) and all(
        len(cell) <= 12
        and " " not in cell
        and (cell == "1" or np.isnan(_as_number(cell.lstrip("<>≤≥="))))
        for cell in filled
    )


_BRACKETED = re.compile(r"(.*\S)(\s*)[\[(]\s*([^\[\]()]{1,12}?(?:\([ag]\))?)\s*[\])]$")


def _named_units(keys: Sequence[str]) -> dict[str, str]:
    """Units within the names: ``voltage [V]``, ``angle (rad)``, ``p [bar(g)]``.

    A number is none but 1 behind a space, where no further name has another one there.
    """
    matches = {key: match for key in keys if (match := _BRACKETED.match(key))}
    numbered = Counter(match[1] for match in matches.values() if match[3].isdigit())
    return {
        key: match[3]
        for key, match in matches.items()
        if not match[3].isdigit() or ((match[3], numbered[match[1]]) == ("1", 1) and match[2])
    }


def _score(lines: Sequence[str], separator: str) -> tuple[float, bool]:
    """Share of cells that are values in rows of equal width; then whether rows have several."""
    rows = [_cells(line, separator) for line in lines]
    counts = Counter(len(row) for row in rows)
    width, frequency = counts.most_common(1)[0]
    cells = [cell for row in rows for cell in row]
    values = sum(_is_value(cell) for cell in cells) / max(len(cells), 1)
    return values * frequency / len(rows), width > 1


def _value_columns(rows: Sequence[list[str]]) -> tuple[int, list[bool]]:
    """Number of cells of a row of data, and which of them hold values."""
    counts = Counter(len(row) for row in rows)
    width = max(counts, key=lambda count: (counts[count], -count))
    full_rows = [row for row in rows if len(row) == width]
    return width, [
        2 * sum(_is_value(row[j]) for row in full_rows) > len(full_rows) for j in range(width)
    ]


def _is_data_row(cells: list[str], width: int, value_columns: list[bool]) -> bool:
    """Whether a row has values in the columns in which the rows of data have them."""
    if all(_is_value(cell) for cell in cells if cell) and any(cells):
        return True  # a row of numbers is data; the reader reports a wrong number of cells
    filled = len(cells) == width and any(value_columns) and any(cells)
    return filled and all(
        _is_value(cell) or not cell
        for cell, is_value_column in zip(cells, value_columns, strict=True)
        if is_value_column
    )


def _has_data(rows: Sequence[list[str]], start: int, width: int, value_columns: list[bool]) -> bool:
    """Whether the row above the first row of data is one too, with words in some of its cells.

    No header and no units have a date or a time of day in the first column of values where the
    row below has one, or a number there and numbers in at least half of these columns, if these
    increase to the row below (the first that differs) or stand below a row of names.
    """
    cells, below = rows[start - 1], rows[start]
    columns = [j for j in range(width) if value_columns[j]]
    if len(cells) != width or len(below) != width or not columns:
        return False
    first, next_first = cells[columns[0]], below[columns[0]]
    if is_stamp(first) and is_stamp(next_first):
        return True
    values = sum(_is_value(cells[j]) and cells[j].lower() not in _EMPTY for j in columns)
    if 2 * values < len(columns) or np.isnan(_as_number(first)):
        return False
    steps = [_as_number(below[j]) - _as_number(cells[j]) for j in columns]
    changes = [step for step in steps if np.isfinite(step) and step != 0.0]
    under_names = start > 1 and _are_names(rows[start - 2], width)
    return (bool(changes) and changes[0] > 0.0) or (under_names and not _are_units(cells))


def _are_names(cells: list[str], width: int) -> bool:
    """Whether a row has a name without a value for each column."""
    return len(set(cells)) == len(cells) == width and not any(map(_is_value, cells))


def _as_number(cell: str) -> float:
    """The number in a cell, with either decimal mark; NaN where there is none."""
    is_number = _POINT.match(cell) or _COMMA.match(cell)
    return float(cell.replace(",", ".").upper().replace("D", "E")) if is_number else float("nan")


def _is_value(cell: str) -> bool:
    text = cell.strip()
    is_mark = text.lower() in _EMPTY or text in _OVER_RANGE
    return is_mark or bool(_POINT.match(text) or _COMMA.match(text)) or is_stamp(text)


def _trimmed(cells: list[str]) -> list[str]:
    cells = list(cells)
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _cells(line: str, separator: str) -> list[str]:
    if not separator:
        return line.split()
    rows = csv.reader([line], delimiter=separator, skipinitialspace=True)
    return [cell.strip() for cell in next(rows)]
