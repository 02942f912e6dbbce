"""From a file to a record: CSV and other text tables, Parquet, MAT, HDF5, NPZ, Excel.

A reader turns a file into columns by name, each (N,) or, for a matrix variable, (N, k). Its
columns are then reached as ``name[0]`` … ``name[k-1]``.
"""

import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax.checks import check, check_choice, check_kind, check_positive
from eoi_jax.data.mat_file import add_columns, read_mat
from eoi_jax.data.record import Record
from eoi_jax.data.resample import Real
from eoi_jax.data.table import Columns, Table
from eoi_jax.data.text_table import line_of, read_lines, read_text


def read_record(
    path: str | Path,
    time: str | int | None = None,
    inputs: str | int | Sequence[str | int] = (),
    outputs: str | int | Sequence[str | int] = (),
    name: str | None = None,
    sample_period: Real | None = None,
    scale: Mapping[str, Real] | Mapping[int, Real] | None = None,
    units: Mapping[str, str] | Mapping[int, str] | None = None,
    hold: str = "auto",
    burn_in: Real = 0.0,
    slice: tuple[int, int | None] | None = None,
    renames: Mapping[str, str] | Mapping[int, str] | None = None,
) -> Record:
    """A record from named columns of a file.

    Known files: .csv, .tsv, .txt, .dat (also with .gz; comma, semicolon, tab, bar or spaces;
    decimal points or commas; a header line, which may start with % or #, a line of units below it,
    or none: columns are then called ``0``, ``1``, …, or by the numbers 0, 1, …), .parquet, .mat
    (any version), .h5, .hdf5, .npz, .xlsx (with openpyxl). Structures and groups are reached as
    ``structure.field`` in .mat and ``group/name`` in .h5; column 2 of a matrix as ``name[2]``,
    counted from 0. Columns of dates and times of day count in seconds from the first.

    Args:
        path: the file.
        time: column of the stamps [s, after `scale`]; without it, `sample_period` is needed.
        inputs: columns of the inputs; none for a free system.
        outputs: columns of the outputs.
        name: of the record; default: the file's name.
        sample_period: time between samples [s].
        scale: ``{column: factor}``, e.g. ``{"tempo_ms": 1e-3}``.
        units: ``{column: unit}`` after scaling, for tables and figures.
        hold: of the inputs, as in `Record`.
        burn_in: time at the start that is not to be scored [s], as in `Record`.
        slice: ``(start, stop)``, the only samples to be taken; stop may be None. Time stays as it
            is in the file, or counts from the file's first sample.
        renames: ``{column: name in the record}``.

    Returns:
        The record, with `notes` on whatever was done to it.

    Raises:
        ValueError: a file that is missing, of an unknown kind or not what its name says; a column
            that is unknown, not numeric or of another length; no stamps and no sample period;
            a `scale`, `units` or `renames` for a column that is not read; whatever `Record` finds.
    """
    path = Path(path)
    _known_suffix(path)
    _check_clock(time, sample_period)
    table = read_table(path)
    columns = table.columns
    clock = None if time is None else _named("time", time)
    u_columns, y_columns = _all_named("inputs", inputs), _all_named("outputs", outputs)
    check(
        len(y_columns) > 0,
        "outputs",
        "must name at least one column",
        "none",
        f"Columns present: {_listed(columns)}.",
    )
    picked = _pick(path, table, clock, u_columns, y_columns)
    factors = _by_name("scale", scale, picked)
    for key, factor in factors.items():
        good = bool(np.isfinite(factor)) and factor != 0
        check(good, f"scale[{key}]", "must be finite and not zero", factor)
        picked[key] = picked[key] * float(factor)
    count = len(picked[y_columns[0]])
    rows = _rows(slice, count)
    new_names, known_units = _by_name("renames", renames, picked), _by_name("units", units, picked)
    labels = {key: new_names.get(key, key) for key in picked}
    stamps = float(sample_period or 0) * np.arange(count) if clock is None else picked[clock]
    return Record(
        stamps[rows],
        _matrix(picked, u_columns, count)[rows],
        _matrix(picked, y_columns, count)[rows],
        _stem(path) if name is None else name,
        input_names=[labels[key] for key in u_columns],
        output_names=[labels[key] for key in y_columns],
        units={"time" if key == clock else labels[key]: unit for key, unit in known_units.items()},
        hold=hold,
        burn_in=burn_in,
    )


# -- choosing columns ---------------------------------------------------------------------


def _named(field: str, column: str | int) -> str:
    """A column's name; columns without one are called by their numbers."""
    check_kind(field, column, (str, int, np.integer), "the name of a column, or its number")
    return str(column)


def _all_named(field: str, given: str | int | Sequence[str | int]) -> list[str]:
    several = [given] if isinstance(given, str | int | np.integer) else list(given)
    return [_named(field, one) for one in several]


def _by_name(field: str, given: Mapping[Any, Any] | None, picked: Columns) -> dict[str, Any]:
    """What is said of some of the columns that are read."""
    named = {_named(field, key): value for key, value in (given or {}).items()}
    for key in named:
        check_choice(field, key, tuple(picked))
    return named


def _pick(
    path: Path, table: Table, time: str | None, u_columns: list[str], y_columns: list[str]
) -> Columns:
    """The columns asked for, as float64 of equal length."""
    fields = [("time", time)] if time is not None else []
    fields += [("inputs", key) for key in u_columns] + [("outputs", key) for key in y_columns]
    picked = {key: _numeric(path, key, _column(path, table, field, key)) for field, key in fields}
    lengths = {key: len(values) for key, values in picked.items()}
    check(
        len(set(lengths.values())) == 1,
        ", ".join(lengths),
        f"must be equally long in {path}",
        ", ".join(f"{key} {length}" for key, length in lengths.items()),
    )
    return picked


def _matrix(picked: Columns, keys: list[str], count: int) -> np.ndarray:
    return np.stack([picked[key] for key in keys], axis=1) if keys else np.zeros((count, 0))


def _column(path: Path, table: Table, field: str, key: str) -> np.ndarray:
    columns = table.columns
    if path.suffix.lower() == ".mat" and key not in columns:
        key = key.replace("/", ".")  # as in the HDF5 file that a new MAT file is
    if key in columns:
        values = columns[key]
        check(
            values.ndim == 1,
            field,
            f"must name one column of {path}",
            f"`{key}` of shape {values.shape}",
            f"Write {key}[0] for the first one.",
        )
        return values
    match = re.fullmatch(r"(.+)\[(\d+)\]", key)
    if match and match[1] in columns:
        matrix = columns[match[1]]
        wide = matrix.shape[1] if matrix.ndim == 2 else 1
        check(
            int(match[2]) < wide,
            field,
            f"must be below {match[1]}[{wide}], the number of columns of `{match[1]}` in {path}",
            key,
        )
        return matrix.reshape(len(matrix), wide)[:, int(match[2])]
    owner = next((one for one in table.objects if f"{key}.".startswith(f"{one}.")), None)
    check(
        owner is None,
        field,
        f"must be readable in {path}",
        f"`{key}`",
        table.objects.get(owner or "", ""),
    )
    import difflib

    close = difflib.get_close_matches(key, columns, n=1, cutoff=0.4)
    hint = f" Did you mean `{close[0]}`?" if close else ""
    check(
        False,
        field,
        f"must be a column of {path} (present: {_listed(columns)})",
        f"`{key}`",
        hint.strip(),
    )
    raise AssertionError


def _numeric(path: Path, key: str, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind in "Mm":  # seconds from the first stamp
        return (values - values[0]) / np.timedelta64(1, "s")
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    for row, value in enumerate(values.tolist()):
        try:
            float("nan" if value is None else value)
        except (TypeError, ValueError):
            is_text = _READERS[_known_suffix(path)] is read_text
            where = f"line {line_of(path, row)}" if is_text else f"row {row}, counted from 0"
            check(False, key, f"must be a numeric column of {path}", f"{value!r} in {where}")
    return np.asarray([np.nan if value is None else value for value in values], dtype=np.float64)


def _check_clock(time: str | int | None, sample_period: Real | None) -> None:
    check(
        (time is None) != (sample_period is None),
        "time, sample_period",
        "must be given one and not the other",
        f"time={time}, sample_period={sample_period}",
        "Name the column of the stamps, or give the time between samples in seconds.",
    )
    if sample_period is not None:
        check_positive("sample_period", sample_period)


def _rows(chosen: tuple[int, int | None] | None, count: int) -> slice:
    start, stop = (0, None) if chosen is None else chosen
    good = 0 <= start < (count if stop is None else min(stop, count))
    check(
        good and (stop is None or stop <= count),
        "slice",
        f"must be (start, stop) with 0 ≤ start < stop ≤ {count}, the number of samples",
        chosen,
    )
    return slice(start, stop)


def _listed(columns: Columns) -> str:
    names = list(columns)
    shown = ", ".join(names[:30]) or "none"
    return shown + (f" and {len(names) - 30} more" if len(names) > 30 else "")


# -- files --------------------------------------------------------------------------------


def _known_suffix(path: Path) -> str:
    check(path.is_file(), "path", "must be an existing file", path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] == ".gz":
        suffixes.pop()
    suffix = suffixes[-1] if suffixes else ""
    known = ", ".join(_READERS)
    check(suffix in _READERS, "path", f"must end in {known} (text also with .gz)", path.name)
    return suffix


def read_table(path: str | Path) -> Table:
    """Everything that is in a file, before anything is chosen from it.

    Args:
        path: a file of a kind that `read_record` knows.

    Raises:
        ValueError: a file that is missing, of an unknown kind or not what its name says.
    """
    path = Path(path)
    suffix = _known_suffix(path)
    try:
        table = _READERS[suffix](path)
    except MemoryError:
        raise
    except Exception as failure:  # each library raises its own kinds for a damaged file
        cause = str(failure).splitlines()[0] if str(failure) else type(failure).__name__
        check(False, "path", f"must be a readable {suffix} file", path, f"The reader says: {cause}")
        raise
    check(bool(table.columns), "path", "must hold columns", path)
    return table


def _stem(path: Path) -> str:
    stem = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(stem).stem


def _read_parquet(path: Path) -> Table:
    import pandas as pd

    table = pd.read_parquet(path)
    return Table({str(key): table[key].to_numpy() for key in table.columns})


def _read_excel(path: Path) -> Table:
    import pandas as pd

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
    # As text, so that its titles and units are found as those of a text table are.
    table = read_lines(first.to_csv(sep=";", header=False, index=False))
    others = f", the first of {len(filled)} that hold anything" if len(filled) > 1 else ""
    return replace(table, notes=(f"Read from the sheet `{name}`{others}.", *table.notes))


def _read_hdf5(path: Path) -> Table:
    import h5py

    columns: Columns = {}
    notes: list[str] = []

    def visit(key: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not key.startswith("#"):
            add_columns(columns, notes, key, np.asarray(item[()]))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return Table(columns, notes=tuple(notes))


def _read_npz(path: Path) -> Table:
    columns: Columns = {}
    notes: list[str] = []
    objects: dict[str, str] = {}
    if not zipfile.is_zipfile(path):
        raise ValueError("it is no archive of arrays, as `numpy.savez` writes it")
    with np.load(path, allow_pickle=False) as file:
        for key in file.files:
            try:
                add_columns(columns, notes, key, file[key])
            except ValueError:  # NumPy would have to run what is in the file
                objects[key] = f"`{key}` holds Python objects; save it as an array of numbers."
    if objects and not columns:
        raise ValueError(" ".join(objects.values()))
    return Table(columns, notes=tuple(notes), objects=objects)


_READERS: dict[str, Callable[[Path], Table]] = {
    ".csv": read_text,
    ".tsv": read_text,
    ".txt": read_text,
    ".dat": read_text,
    ".parquet": _read_parquet,
    ".mat": read_mat,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".npz": _read_npz,
    ".xlsx": _read_excel,
}
