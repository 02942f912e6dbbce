"""Text tables: detection of separator, decimal mark, header, units and first row of data.

The separator is the one with which most cells are numbers. The data start at the first row that
has the form of the rows further down, with the rows straight above it that hold a word among
their values; the row above them holds the names. A row of units and lines before the header are
recognised in the same way.
"""

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
from eoi_jax.data.readers.cells import (
    COMMA,
    EMPTY,
    NO_VALUE,
    POINT,
    as_number,
    is_value,
    split_cells,
    trimmed,
)
from eoi_jax.data.readers.limits import PIECE, Allowance
from eoi_jax.data.readers.stamps import is_stamp, on_their_days, read_stamps, zone_problem
from eoi_jax.data.readers.table import Columns, Table
from eoi_jax.data.readers.titles import (
    COUNTS,
    Titles,
    are_units,
    names_before_slashes,
    read_titles,
    units_in_names,
)
from eoi_jax.data.readers.words import without_unit, without_words

_SEPARATORS = (";", "\t", ",", "|", "")  # "" for spaces
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
    titles: Titles
    notes: tuple[str, ...]


def read_text(path: Path, allowance: Allowance) -> Table:
    """The columns of a text file, numbers as float64, dates as datetime64, others as text.

    Args:
        path: .csv, .tsv, .txt, .dat, .mpt, .lvm, also with .gz.
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
    """The first lines behind those that the file declares, from which the layout is detected."""
    lines_read = iter(stream)
    first = list(islice(lines_read, lines))
    return first + list(islice(lines_read, _declared_lines(first)))


def _declared_lines(lines: Sequence[str], first: int = 10) -> int:
    """Number of lines up to the names, as EC-Lab writes it into one of the first; else zero."""
    matches = (re.match(r"Nb header lines\s*:\s*(\d{1,6})\s*$", line) for line in lines[:first])
    return next((int(match[1]) for match in matches if match), 0)


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
                na_values=list(NO_VALUE),
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
    titles, names = layout.titles, layout.titles.names
    while len(names) < frame.shape[1] > 1 and bool(frame.iloc[:, -1].isna().all()):
        frame = frame.iloc[:, :-1]  # rows that end in a separator
    keys, units = _keys(titles, frame.shape[1], notes)
    settings = [] if names else _columns_of_settings(frame)
    if settings:
        listed = ", ".join(map(str, settings))
        notes.append(f"Columns {listed} hold settings of an instrument, no samples: left out.")
    columns: Columns = {}
    objects: dict[str, str] = {}
    for i, key in enumerate(keys):
        if i in settings:
            continue
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
    units = {key: unit for key, unit in {**units_in_names(keys), **units}.items() if unit}
    columns = on_their_days(columns, units, notes)
    if titles.count and keys[0] in columns and columns[keys[0]].dtype.kind in "iuf":
        columns[keys[0]] = _counted_time(titles.count, keys[0], columns[keys[0]], notes)
    return Table(columns, units, tuple(notes), objects, period=titles.period)


def _keys(titles: Titles, count: int, notes: list[str]) -> tuple[list[str], dict[str, str]]:
    """Names of so many columns, their numbers where the header does not fit; and units by name."""
    names = list(titles.names)
    if len(names) == count + 1 and names[-1].lower() == "comment":
        names.pop()  # of a LabVIEW measurement without any
    fits = len(names) == count
    slashes = names_before_slashes(names) if fits else {}
    keys = [slashes[name][0] if name in slashes else name for name in names]
    keys = [key or str(i) for i, key in enumerate(keys if fits else [""] * count)]
    repeated = [key for key, number in Counter(keys).items() if number > 1]
    if repeated:
        names_text = ", ".join(repeated[:5])
        raise ValueError(f"its header repeats a name: {names_text}; give each column its own name")
    if names and not fits:
        what = f"{counted(len(names), 'name')} for {counted(count, 'column')}"
        notes.append(f"The header has {what}: left out, and the columns are numbered from 0.")
    if slashes:
        pairs = [f"`{full}` is `{name}`" for full, (name, _) in slashes.items()]
        notes.append(f"Units behind a slash are no part of the names: {', '.join(pairs[:20])}.")
    units = {key: unit for key, unit in zip(keys, titles.units, strict=False) if unit and fits}
    return keys, units | dict(slashes.values())


def _counted_time(
    count: tuple[float, float], key: str, numbers: np.ndarray, notes: list[str]
) -> np.ndarray:
    """The time [s] of samples by their numbers."""
    start, increment = count
    notes.append(
        f"`{key}` {COUNTS}: read as {start:g} + {increment:g} `{key}`, the time in "
        "seconds by `Start` and `Increment` of the file."
    )
    return start + increment * numbers


def _columns_of_settings(frame: Any) -> list[int]:
    """The columns of words that are empty in the second half of the rows, and empty ones beside."""
    is_empty = frame.isna().all()
    ends_empty = frame.iloc[len(frame) // 2 :].isna().all()
    words = [i for i in frame.columns if frame[i].dtype.kind == "O" and ends_empty[i]]
    return [i for i in frame.columns if i in words or is_empty[i]] if words else []


def first_word(cells: Iterable[Any]) -> str:
    """The first text that is no number among cells; else the first text, or an empty one.

    Args:
        cells: of a column of text.
    """
    texts = [cell for cell in cells if isinstance(cell, str)]
    numbers = (bool(POINT.match(text.strip()) or COMMA.match(text.strip())) for text in texts)
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
    return cell.replace(",", ".") if isinstance(cell, str) and COMMA.match(cell.strip()) else cell


# -- layout -------------------------------------------------------------------------------


def _layout(lines: Sequence[str], separator: str | None = None) -> _Layout:
    """Separator if it is not known, decimal mark, first row of data, names and units."""
    filled = [(i, line) for i, line in enumerate(lines) if line.strip()]
    remarks = [(i, line) for i, line in filled if line.lstrip()[0] in "%#"]
    body = [(i, line) for i, line in filled if line.lstrip()[0] not in "%#"]
    if not body:
        raise ValueError("it holds no data")
    declared = sum(i < _declared_lines(lines) for i, _ in body)
    middle = declared if len(body) // 2 < declared < len(body) else len(body) // 2
    sample = [line for _, line in body[middle:]]
    if separator is None:
        separator = max(_SEPARATORS, key=lambda mark: _score(sample, mark))
    rows = [(i, split_cells(line, separator)) for i, line in body]
    width, value_columns = _value_columns([cells for _, cells in rows[middle:]])
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
    commas = sum(bool(COMMA.match(cell)) for cells in data for cell in cells)
    points = sum("." in cell and bool(POINT.match(cell)) for cells in data for cell in cells)
    if commas > points:
        decimal = ","
        notes.append("Numbers are written with decimal commas.")
    header = [cells for _, cells in rows[:start] if len(trimmed(cells)) > 0]
    if header:
        keyed = all(len(cells) > 1 and not cells[0] for cells in data)
        titles = read_titles(header, width, keyed)
    else:
        titles = _commented([line for i, line in remarks if i < rows[start][0]], separator)
    if len(header) > titles.lines:
        lines = counted(len(header) - titles.lines, "line")
        notes.append(f"Skipped before the header: {lines}.")
    if not titles.names:
        notes.append("There is no line of names: the columns are numbered from 0.")
    return _Layout(separator, decimal, rows[start][0], titles, (*notes, *titles.notes))


def _commented(remarks: Sequence[str], separator: str) -> Titles:
    """The names in the last line of remarks above the data."""
    if not remarks:
        return Titles()
    text = remarks[-1].strip().lstrip("%#").strip()
    cells = split_cells(text, separator if separator in text else "")
    return Titles(tuple(trimmed(cells)))


def _score(lines: Sequence[str], separator: str) -> tuple[float, bool]:
    """Share of cells that are values in rows of equal width; then whether rows have several."""
    rows = [split_cells(line, separator) for line in lines]
    counts = Counter(len(row) for row in rows)
    width, frequency = counts.most_common(1)[0]
    cells = [cell for row in rows for cell in row]
    values = sum(is_value(cell) for cell in cells) / max(len(cells), 1)
    return values * frequency / len(rows), width > 1


def _value_columns(rows: Sequence[list[str]]) -> tuple[int, list[bool]]:
    """Number of cells of a row of data, and which of them hold values."""
    counts = Counter(len(row) for row in rows)
    width = max(counts, key=lambda count: (counts[count], -count))
    full_rows = [row for row in rows if len(row) == width]
    return width, [
        2 * sum(is_value(row[j]) for row in full_rows) > len(full_rows) for j in range(width)
    ]


def _is_data_row(cells: list[str], width: int, value_columns: list[bool]) -> bool:
    """Whether a row has values in the columns in which the rows of data have them."""
    if all(is_value(cell) for cell in cells if cell) and any(cells):
        return True  # a row of numbers is data; the reader reports a wrong number of cells
    filled = len(cells) == width and any(value_columns) and any(cells)
    return filled and all(
        is_value(cell) or not cell
        for cell, is_value_column in zip(cells, value_columns, strict=True)
        if is_value_column
    )


def _has_data(rows: Sequence[list[str]], start: int, width: int, value_columns: list[bool]) -> bool:
    """Whether the row above the first row of data is one too, with words in some of its cells.

    No header and no units have a date or a time of day in the first column of values where the
    row below has one, or a number there and numbers in at least half of these columns, if these
    increase to the row below (the first that differs) or stand below a row of names. None has
    numbers in all columns that are not empty in the second half of the rows: words beside them are
    settings.
    """
    cells, below = rows[start - 1], rows[start]
    columns = [j for j in range(width) if value_columns[j]]
    if len(cells) != width or len(below) != width or not columns:
        return False
    full_rows = [row for row in rows[len(rows) // 2 :] if len(row) == width]
    columns_filled = [j for j in columns if any(row[j] for row in full_rows)]
    if columns_filled and not any(np.isnan(as_number(cells[j])) for j in columns_filled):
        return True
    first, next_first = cells[columns[0]], below[columns[0]]
    if is_stamp(first) and is_stamp(next_first):
        return True
    values = sum(is_value(cells[j]) and cells[j].lower() not in EMPTY for j in columns)
    if 2 * values < len(columns) or np.isnan(as_number(first)):
        return False
    steps = [as_number(below[j]) - as_number(cells[j]) for j in columns]
    changes = [step for step in steps if np.isfinite(step) and step != 0.0]
    under_names = start > 1 and _are_names(rows[start - 2], width)
    return (bool(changes) and changes[0] > 0.0) or (under_names and not are_units(cells))


def _are_names(cells: list[str], width: int) -> bool:
    """Whether a row has a name without a value for each column."""
    return len(set(cells)) == len(cells) == width and not any(map(is_value, cells))
