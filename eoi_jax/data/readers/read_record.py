"""Records from files: CSV and other text tables, Parquet, MAT, HDF5, NPZ, Excel.

A reader returns the columns of a file by name, each (N,). Those of a matrix variable are named
``name[0]`` … ``name[k-1]``.
"""

import difflib
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._checks import check, check_choice, check_kind, check_positive, counted, printable
from eoi_jax.data.column_names import in_other_units
from eoi_jax.data.impulses import (
    single_row_notes,
    with_impulses,
    without_amounts,
    zero_hold_of_impulses,
)
from eoi_jax.data.input_holds import HoldArgument, hold_text, read_hold
from eoi_jax.data.late_outputs import without_lateness
from eoi_jax.data.readers.archive import read_npz
from eoi_jax.data.readers.conversions import Scale, compared_columns, scaled_columns
from eoi_jax.data.readers.delimited import line_of, read_text
from eoi_jax.data.readers.excel import read_excel
from eoi_jax.data.readers.hdf5 import read_hdf5
from eoi_jax.data.readers.limits import MAX_GIGABYTES, Allowance
from eoi_jax.data.readers.long_form import mixed_tags
from eoi_jax.data.readers.matlab import read_mat
from eoi_jax.data.readers.missing import Codes, codes_by_column, without_missing
from eoi_jax.data.readers.stamps import INTERVALS, MIDNIGHTS, TIMES_OF_DAY, are_days
from eoi_jax.data.readers.table import Columns, Table, add_columns
from eoi_jax.data.readers.titles import COUNTS
from eoi_jax.data.readers.words import BEYOND, is_grouped
from eoi_jax.data.record import Record
from eoi_jax.data.repeats import without_repeats
from eoi_jax.data.resampling import Real
from eoi_jax.data.time_axis import (
    date_hints,
    daylight_saving,
    declared_unit,
    epoch_unit,
    seconds_from_first,
    unit_of_seconds,
)
from eoi_jax.data.unwrapping import checked_periods, unwrapped_channels


def read_record(
    path: str | Path,
    time: str | int | None = None,
    inputs: str | int | Sequence[str | int] = (),
    outputs: str | int | Sequence[str | int] = (),
    name: str | None = None,
    sample_period: Real | None = None,
    scale: Mapping[str, Scale] | Mapping[int, Scale] | None = None,
    units: Mapping[str, str] | Mapping[int, str] | None = None,
    hold: HoldArgument = "auto",
    burn_in: Real = 0.0,
    slice: tuple[int, int | None] | None = None,
    renames: Mapping[str, str] | Mapping[int, str] | None = None,
    max_gigabytes: Real = MAX_GIGABYTES,
    unwrap: Mapping[str, Real] | Mapping[int, Real] | None = None,
    mask_faults: bool = True,
    sheet: str | None = None,
    empty_repeats: str | int | Sequence[str | int] = (),
    missing: Codes | Mapping[str, Codes] | Mapping[int, Codes] = (),
    late: Mapping[str, Real] | Mapping[int, Real] | None = None,
    impulses: str | int | Sequence[str | int] = (),
) -> Record:
    """A record from named columns of a file.

    Known files: .csv, .tsv, .txt, .dat, .mpt, .lvm (also with .gz; comma, semicolon, tab, bar or
    spaces; decimal points or commas; a header line, which may start with % or #, a line of units
    below it, or none: columns are then called ``0``, ``1``, …, or by the numbers 0, 1, …; a unit
    behind a slash, as in ``I/mA``, is no part of the name), .parquet, .mat
    (any version), .h5, .hdf5, .npz, .xlsx (with openpyxl). Structures and groups are reached as
    ``structure.field`` in .mat and ``group/name`` in .h5; column 2 of a matrix as ``name[2]``,
    counted from 0. Columns of dates and times of day count in seconds from the first; times of day
    are of the dates in another column, if there is one.

    A file that declares its inputs, outputs and time, as an `iddata` in a .mat file does, needs no
    names: ``read_record("run.mat")``. Its `InterSample` is then the hold; with names of columns it
    is not read.

    Args:
        path: the file.
        time: column of the stamps [s, after `scale`]; without it, `sample_period` is needed.
        inputs: columns of the inputs; none for a free system.
        outputs: columns of the outputs.
        name: of the record; default: the file's name.
        sample_period: time between samples [s].
        scale: ``{column: factor}``, e.g. ``{"tempo_ms": 1e-3}``, or ``{column: [factor, offset]}``,
            e.g. ``{"T_F": [0.5556, -17.78]}`` from °F to °C.
        units: ``{column: unit}`` after scaling, for tables and figures, and to be those of the
            model; of a column that is neither named here nor scaled, the unit in the file must not
            be another one of the same quantity, and no other temperature of one that has a factor
            without an offset.
        hold: of the inputs, as in `Record`; where they differ, by column. By default what the file
            declares, if it does.
        burn_in: time at the start that is not scored [s], as in `Record`.
        slice: ``(start, stop)``, the range of samples that is read; stop may be None. Time stays as
            it is in the file, or counts from the file's first sample.
        renames: ``{column: name in the record}``.
        max_gigabytes: largest unpacked size of a compressed file [1e9 bytes]; infinite for no
            limit.
        unwrap: ``{column: period}`` of counters and angles that start again at the end of their
            range, in the unit after `scale`: ``{"encoder": 4096}``. See `Record.unwrapped`.
        mask_faults: whether samples that leave the course of an output alone are masked, as in
            `Record`.
        sheet: of an Excel file; None: the first that is not empty.
        empty_repeats: columns whose last value is repeated until the next one comes, as in merged
            logs of a slower sensor: a cell with the value of the one before is a missing sample.
        missing: what stands for no value in the cells of inputs and outputs, before `scale`:
            ``[-999, "Inp OutRange"]`` in all of them, or by column ``{"outdoor": -999}``. The case
            of letters does not matter.
        late: ``{output: time}`` by which a column was logged late beside the others [s], as by a
            second logger or a clock of its own; negative: early. It is moved by that, and what
            comes from beyond the ends of the record is missing.
        impulses: inputs whose values are amounts given at the instant of their row, such as doses:
            each becomes a rate, the amount over the sample period, for the one step behind its row,
            in the unit of the column per unit of time. Their hold is zero, and an empty cell is no
            amount.

    Returns:
        The record, with `notes` on the changes made to the data.

    Raises:
        ValueError: a file that is missing, of an unknown kind or of another kind than its name
            says; a column that is unknown, not numeric or of a different length; no stamps and no
            sample period; a `scale`, `units`, `unwrap`, `renames`, `empty_repeats`, `missing` or
            `late` for a column that is not read; one of `impulses` that is no input, or has another
            hold than zero; none of the other inputs beside them; a code of `missing` that is no
            finite number and no word; a period that is not positive or is smaller than the range of
            its column; a time of `late` as long as the record; a file that unpacks to more than
            `max_gigabytes`; and the errors of `Record`.
    """
    path = Path(path)
    table = read_table(path, max_gigabytes, sheet)
    roles = (time, sample_period, inputs, outputs)
    is_declared = table.outputs and all(option in (None, ()) for option in roles)
    if is_declared:
        time, inputs, outputs = table.time, table.inputs, table.outputs
        scale, units = _declared(table) if (scale, units) == (None, None) else (scale, units)
    hold, hold_notes = _declared_hold(table, hold) if is_declared else (hold, [])
    clock = _clock(time, sample_period)
    u_columns, y_columns = _column_names("inputs", inputs), _column_names("outputs", outputs)
    selected, hints = _pick(path, table, clock, u_columns, y_columns, missing)
    scales = _options_by_column("scale", scale, selected)
    selected, factors = scaled_columns(selected, scales)
    rows = _rows(slice, count := len(selected[y_columns[0]]))
    if clock is not None:
        _check_stamps(path, table, clock, selected[clock], rows)
        if clock not in factors:
            _check_seconds(clock, table, selected[clock])
    unit_names = _options_by_column("units", units, selected)
    labels = {key: key for key in selected} | _options_by_column("renames", renames, selected)
    stamps = float(sample_period or 0) * np.arange(count) if clock is None else selected[clock]
    hints = [*_date_notes(clock, table, selected, rows, clock in factors), *hints]
    signals, notes = _signals(selected, u_columns + y_columns, stamps, rows, unwrap, empty_repeats)
    at_once, u_names = _column_names("impulses", impulses), [labels[key] for key in u_columns]
    signals, amounts = without_amounts(signals, u_columns, at_once, notes)
    notes += single_row_notes(stamps[rows], signals, u_columns, table.units)
    hold = zero_hold_of_impulses(_renamed(hold, labels), u_names, [u_names[j] for j in amounts])
    record = Record(
        stamps[rows], signals[:, : len(u_columns)], signals[:, len(u_columns) :],
        _stem(path) if name is None else name, input_names=u_names, mask_faults=mask_faults,
        output_names=[labels[key] for key in y_columns], hold=hold, burn_in=burn_in,
        units={"time" if key == clock else labels[key]: unit for key, unit in unit_names.items()},
    )  # fmt: skip
    record = _moved(record, late, {key: labels[key] for key in y_columns})
    keys = compared_columns((*u_columns, *y_columns), scales, unit_names, table.units)
    record._assign({"notes": (*record.notes, *hints, *hold_notes, *notes)})
    record = _with_file_units(record, {key: labels[key] for key in keys}, table, clock, factors)
    return with_impulses(record, stamps[rows], amounts)


def _moved(record: Record, late: Mapping[Any, Any] | None, labels: Mapping[str, str]) -> Record:
    """The record with columns moved by which they were logged late.

    Args:
        record: of the file.
        late: time by column [s].
        labels: names of the outputs, by column.
    """
    times = _options_by_column("late", late, labels)
    return without_lateness(record, {labels[key]: time for key, time in times.items()})


# -- choosing columns ---------------------------------------------------------------------


def _column_name(field: str, column: str | int) -> str:
    """Name of a column; a column without a name is named by its number."""
    check_kind(field, column, (str, int, np.integer), "the name of a column, or its number")
    return printable(str(column))


def _column_names(field: str, argument: str | int | Sequence[str | int]) -> list[str]:
    columns = [argument] if isinstance(argument, str | int | np.integer) else list(argument)
    return [_column_name(field, column) for column in columns]


def _declared(table: Table) -> tuple[dict[str, float], dict[str, str]]:
    """Factor of the time, and units of the channels, as the file declares them."""
    unit = table.units.get(table.time or "", "")
    seconds = declared_unit("", unit)
    advice = "Name the columns of time, inputs and outputs, and its `scale`."
    check(not unit or seconds is not None, "time", "must be in a known unit", unit, advice)
    factors = {table.time: seconds[1]} if table.time and seconds else {}
    channels = (*table.inputs, *table.outputs)
    return factors, {key: table.units[key] for key in channels if table.units.get(key)}


def _renamed(hold: HoldArgument, labels: Mapping[str, str]) -> HoldArgument:
    """A hold by column as one by the names of these in the record."""
    if not isinstance(hold, Mapping):
        return hold
    return {labels[key]: word for key, word in _options_by_column("hold", hold, labels).items()}


def _declared_hold(table: Table, hold: HoldArgument) -> tuple[HoldArgument, list[str]]:
    """The hold that the caller gives, else that of the file, if it says one, with a note."""
    if hold != "auto" or not table.holds:
        return hold, []
    words = hold_text(read_hold(table.holds, table.inputs), table.inputs)
    return table.holds, [f"Hold {words}, as the file says. If it is another one, give `hold`."]


def _limits(table: Table, columns: Iterable[str]) -> list[str]:
    """Notes on values of these columns beyond a limit of detection."""
    starts = tuple(f"`{key}` {BEYOND}" for key in columns)
    return [note for note in table.notes if note.startswith(starts)]


def _with_file_units(
    record: Record,
    labels: Mapping[str, str],
    table: Table,
    clock: str | None,
    factors: Mapping[str, float],
) -> Record:
    """The record with the units in its file of these columns, whose names in it are `labels`.

    And with that in which its time counts after `scale`, where its file tells.
    """
    units = {label: table.units[key] for key, label in labels.items() if table.units.get(key)}
    if clock is not None:
        declared = declared_unit(clock, table.units.get(clock, ""))
        is_dated = table.columns[clock].dtype.kind in "Mm" if clock in table.columns else False
        seconds = 1.0 if is_dated else declared[1] if declared else 0.0
        unit = unit_of_seconds(seconds / factors.get(clock, 1.0))
        units |= {"time": unit} if unit else {}
    return record._assign({"file_units": units or None})


def _options_by_column(
    field: str, option: Mapping[Any, Any] | None, picked: Mapping[str, Any]
) -> dict[str, Any]:
    """The values of an option by column; each column must be among those that are read."""
    values = {_column_name(field, key): value for key, value in (option or {}).items()}
    for key in values:
        check_choice(field, key, tuple(picked))
    return values


def _signals(
    selected: Columns,
    keys: Sequence[str],
    stamps: np.ndarray,
    rows: slice,
    unwrap: Mapping[Any, Any] | None,
    empty_repeats: str | int | Sequence[str | int],
) -> tuple[np.ndarray, list[str]]:
    """Inputs and outputs, and notes: without repeats, and unwrapped before a grid divides jumps."""
    periods = {_column_name("unwrap", key): period for key, period in (unwrap or {}).items()}
    periods = checked_periods(periods, keys)
    signals, notes = np.stack([selected[key][rows] for key in keys], axis=1), []
    repeating = _column_names("empty_repeats", empty_repeats)
    signals = without_repeats(signals, keys, repeating, notes)
    measured = np.isfinite(signals)
    course, turns = unwrapped_channels(signals, measured, keys, periods, stamps[rows])
    return np.where(measured, course, signals), [*turns, *notes]


def _pick(
    path: Path, table: Table, time: str | None, u_columns: list[str], y_columns: list[str],
    missing: Codes | Mapping[str, Codes] | Mapping[int, Codes],
) -> tuple[Columns, list[str]]:  # fmt: skip
    """The selected columns, as float64 of equal length, and notes on cells that hold no number."""
    present = f"Columns present: {_listed(table.columns)}."
    check(len(y_columns) > 0, "outputs", "must name at least one column", "none", present)
    codes, notes = codes_by_column(missing, u_columns + y_columns), list[str]()
    fields = [("time", time)] if time is not None else []
    fields += [("inputs", key) for key in u_columns] + [("outputs", key) for key in y_columns]
    picked = {key: _column(path, table, field, key) for field, key in fields}
    for key, cells in picked.items():
        cells = without_missing(key, cells, codes.get(key, ()), notes)
        picked[key] = _numeric(path, key, cells)
    lengths = {key: len(values) for key, values in picked.items()}
    check(
        len(set(lengths.values())) == 1,
        ", ".join(lengths),
        f"must be equally long in {path}",
        ", ".join(f"{key} {length}" for key, length in lengths.items()),
    )
    return picked, [*_limits(table, picked), *notes]


def _column(path: Path, table: Table, field: str, key: str) -> np.ndarray:
    columns = table.columns
    if path.suffix.lower() == ".mat" and key not in columns:
        key = key.replace("/", ".")  # a path within the HDF5 file that a MAT file of version 7.3 is
    if key in columns:
        return columns[key]
    width = sum(re.fullmatch(re.escape(key) + r"\[\d+\]", column) is not None for column in columns)
    shape = f"`{key}` of shape ({len(columns[f'{key}[0]'])}, {width})" if width else ""
    advice = f"Write {key}[0] for the first one."
    check(not width, field, f"must name one column of {path}", shape, advice)
    match = re.fullmatch(r"(.+)\[(\d+)\]", key)
    if match and (match[1] in columns or f"{match[1]}[0]" in columns):
        if match[1] in columns and int(match[2]) == 0:
            return columns[match[1]]
        width = sum(column.startswith(f"{match[1]}[") for column in columns) or 1
        rule = f"must be below {match[1]}[{width}], the number of columns of `{match[1]}` in {path}"
        check(False, field, rule, key)
    container = next((name for name in table.objects if f"{key}.".startswith(f"{name}.")), None)
    check(
        container is None,
        field,
        f"must be readable in {path}",
        f"`{key}`",
        table.objects.get(container or "", ""),
    )
    close = in_other_units(key, list(columns)) or difflib.get_close_matches(
        key, columns, n=1, cutoff=0.4
    )
    hint = f" Did you mean `{close[0]}`?" if close else ""
    check(
        False,
        field,
        f"must be a column of {path} (present: {_listed(columns)})",
        f"`{key}`",
        f"{hint} {table.sheet_text}".strip(),
    )
    raise AssertionError


def _numeric(path: Path, key: str, values: np.ndarray) -> np.ndarray:
    if values.dtype.kind in "Mm":  # seconds from the first stamp
        return seconds_from_first(values)
    if values.dtype.kind in "biuf":
        return values.astype(np.float64)
    advice = "Save its real and imaginary parts, or its size and phase, as columns of their own."
    rule = f"must be a real column of {path}"
    check(values.dtype.kind != "c", key, rule, "complex numbers", advice)
    for row, value in enumerate(values.tolist()):
        if _is_numeric(value):
            continue
        advice = "Where it stands for no value of a signal, give it by `missing`; where for a line "
        advice += "that is no sample, leave the line out."
        if is_grouped(str(value)):
            advice = "Write numbers without thousands separators."
        rule = f"must be a numeric column of {path}"
        check(False, key, rule, f"{value!r} in {_place(path, row)}", advice)
    return np.asarray([np.nan if value is None else value for value in values], dtype=np.float64)


def words_among_numbers(path: Path, table: Table, share: float = 0.1) -> list[str]:
    """Sentences on columns of numbers in which few cells, up to this share, hold a word.

    Args:
        path: of the file.
        table: as it was read.
        share: of the cells.
    """
    sentences = []
    for key, column in table.columns.items():
        if column.dtype.kind != "O":
            continue
        words = (row for row, value in enumerate(column.tolist()) if not _is_numeric(value))
        rows = list(islice(words, int(share * len(column)) + 1))  # no more tell that it is text
        if 0 < len(rows) <= share * len(column):
            more = f" and {counted(len(rows) - 1, 'cell')} more" if len(rows) > 1 else ""
            sentences.append(
                f"`{key}` holds numbers but for {column[rows[0]]!r} in {_place(path, rows[0])}"
                f"{more}: where it stands for no value of a signal, give it by `missing`; else "
                "leave the line out."
            )
    return sentences


def _is_numeric(value: Any) -> bool:
    try:
        float("nan" if value is None else value)
    except (TypeError, ValueError):
        return False
    return True


def _place(path: Path, row: int) -> str:
    """Where a row of a table stands in a file."""
    is_text = _READERS[_checked_suffix(path)] is read_text
    return f"line {line_of(path, row)}" if is_text else f"row {row}, counted from 0"


def _check_stamps(path: Path, table: Table, clock: str, stamps: np.ndarray, rows: slice) -> None:
    """All rows that are read must have a stamp, of one table."""
    missing = rows.start + np.flatnonzero(~np.isfinite(stamps[rows]))
    if len(missing):
        more = f", and in {len(missing) - 1} more" if len(missing) > 1 else ""
        got = f"none in {_place(path, int(missing[0]))}{more}"
        advice = "Take lines that are no sample out, or leave them out by `slice`."
        check(False, f"time[{clock}]", f"must have a stamp in all rows of {path}", got, advice)
    mixed = " ".join(mixed_tags(table, clock, rows))
    rule = f"must be the clock of one set of signals in {path}"
    check(not mixed, f"time[{clock}]", rule, "stamps of several tags", mixed)


def _clock(time: str | int | None, sample_period: Real | None) -> str | None:
    """Name of the column of the stamps; None where a sample period is given instead."""
    check(
        (time is None) != (sample_period is None),
        "time, sample_period",
        "must not be both given or both omitted",
        f"time={time}, sample_period={sample_period}",
        "Name the column of the stamps, or give the time between samples in seconds.",
    )
    if sample_period is not None:
        check_positive("sample_period", sample_period)
    return None if time is None else _column_name("time", time)


def _check_seconds(clock: str, table: Table, stamps: np.ndarray) -> None:
    declared = declared_unit(clock, table.units.get(clock, ""))
    dates = clock in table.columns and table.columns[clock].dtype.kind in "Mm"
    if declared is not None and not dates:
        advice = (
            f"Give `scale` {{{clock!r}: {declared[1]:g}}}; or 1, if it is in seconds after all "
        )
        advice += f"or the model counts time in {declared[0]}, its rates per {declared[0]}."
        rule = "must be in seconds"
        check(declared[1] == 1.0, f"time[{clock}]", rule, f"a column in {declared[0]}", advice)
    unit = epoch_unit(stamps)
    if unit is not None:
        advice = f"These seem to be {unit[0]} since 1970: give `scale` {{{clock}: {unit[1]:g}}}."
        check(False, f"time[{clock}]", "must be in seconds", f"{stamps[0]:.10g}", advice)


def _date_notes(
    clock: str | None, table: Table, picked: Columns, rows: slice, scaled: bool
) -> list[str]:
    """Sentences on dates in days, days of times of day, counted samples and an hour left out.

    Dates with an hour twice, and days where another column has the times, are refused.
    """
    if clock is None:
        return []
    stamps = picked[clock][rows]
    starts = tuple(f"`{clock}` {text}" for text in (TIMES_OF_DAY, INTERVALS, MIDNIGHTS, COUNTS))
    said = [note for note in table.notes if note.startswith(starts)]
    if table.columns[clock].dtype.kind != "M":
        in_seconds = scaled or declared_unit(clock, table.units.get(clock, "")) is not None
        return said if in_seconds else [*said, *date_hints(clock, stamps)]
    dates = {key: values for key, values in table.columns.items() if values.dtype.kind == "M"}
    times = [key for key, values in dates.items() if not are_days(values)]
    twice = are_days(dates[clock]) and bool(np.any(np.diff(stamps) == 0))
    advice = f"Name the column that has the times: {' or '.join(times)}."
    check(not (twice and times), f"time[{clock}]", "must increase", "days, each several times",
          advice)  # fmt: skip
    shifts = daylight_saving(dates[clock][rows])
    goes_back = bool(np.any(np.diff(stamps) < 0)) and bool(shifts)
    check(not goes_back, f"time[{clock}]", "must increase", "an hour twice", " ".join(shifts))
    return [*said, *shifts]


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
    text = ", ".join(names[:30]) or "none"
    return text + (f" and {len(names) - 30} more" if len(names) > 30 else "")


# -- files --------------------------------------------------------------------------------


def _checked_suffix(path: Path) -> str:
    check(path.is_file(), "path", "must be an existing file", path)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] == ".gz":
        suffixes.pop()
    suffix = suffixes[-1] if suffixes else ""
    suffixes_read = ", ".join(_READERS)
    check(
        suffix in _READERS, "path", f"must end in {suffixes_read} (text also with .gz)", path.name
    )
    return suffix


def read_table(
    path: str | Path, max_gigabytes: Real = MAX_GIGABYTES, sheet: str | None = None
) -> Table:
    """All columns of a file.

    Args:
        path: a file of a kind that `read_record` reads.
        max_gigabytes: largest unpacked size of a compressed file [1e9 bytes]; infinite for no
            limit.
        sheet: of an Excel file; None: the first that is not empty.

    Returns:
        The columns; unprintable characters in their names are replaced by escape codes.

    Raises:
        ValueError: a file that is missing, of an unknown kind or of another kind than its name
            says, or that unpacks to more than `max_gigabytes`; a sheet that it does not have.
    """
    path = Path(path)
    suffix = _checked_suffix(path)
    rule = "must be left out for a file without sheets"
    check(sheet is None or suffix == ".xlsx", "sheet", rule, f"`{sheet}` for {path}")
    allowance = Allowance(max_gigabytes)
    try:
        with warnings.catch_warnings():  # of the libraries, about damage that does not stop them
            warnings.simplefilter("ignore")
            reader = partial(read_excel, sheet=sheet) if sheet is not None else _READERS[suffix]
            table = reader(path, allowance)
    except Exception as failure:  # libraries raise errors of many classes for a damaged file
        rule = f"must be a readable {suffix} file"
        check(False, "path", rule, path, f"The reader says: {_cause(failure)}")
        raise
    check(bool(table.columns), "path", "must hold columns", path)
    return _printable(table)


def _cause(failure: Exception, length: int = 300) -> str:
    """What a library says of a damaged file: so many characters of its first line."""
    if isinstance(failure, MemoryError):
        return "it needs more memory than there is"
    if isinstance(failure, RecursionError):
        return "it is nested too deeply"
    lines = str(failure).splitlines()
    return printable(lines[0][:length]) if lines else type(failure).__name__


def _printable(table: Table) -> Table:
    """The table with printable names."""
    readable = {key: printable(key) for key in table.columns}
    changed = [name for key, name in readable.items() if name != key]
    if not changed:
        return table
    note = f"Unprintable characters in names are written as escape codes: {', '.join(changed[:5])}."
    return Table(
        {readable[key]: values for key, values in table.columns.items()},
        {readable.get(key, printable(key)): printable(unit) for key, unit in table.units.items()},
        (*map(printable, table.notes), note),
        {printable(key): printable(reason) for key, reason in table.objects.items()},
        None if table.time is None else readable.get(table.time),
        tuple(readable[key] for key in table.inputs),
        tuple(readable[key] for key in table.outputs),
        {readable[key]: hold for key, hold in table.holds.items()},
        tuple(map(printable, table.sheets)),
        table.period,
    )


def _stem(path: Path) -> str:
    stem = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(stem).stem


def _read_parquet(path: Path, allowance: Allowance) -> Table:
    import pandas as pd
    import pyarrow.parquet

    with pyarrow.parquet.ParquetFile(path) as file:
        metadata = file.metadata
        sizes = (metadata.row_group(i).total_byte_size for i in range(metadata.num_row_groups))
        # A constant column takes no space in the file, but eight bytes a row in memory.
        allowance.take(max(sum(sizes), 8.0 * metadata.num_rows * metadata.num_columns))
    table = pd.read_parquet(path)
    columns: Columns = {}
    notes: list[str] = []
    for i, key in enumerate(table.columns):
        add_columns(columns, notes, str(key), table.iloc[:, i].to_numpy())
    return Table(columns, notes=tuple(notes))


_READERS: dict[str, Callable[[Path, Allowance], Table]] = {
    ".csv": read_text,
    ".tsv": read_text,
    ".txt": read_text,
    ".dat": read_text,
    ".mpt": read_text,  # of EC-Lab
    ".lvm": read_text,  # of LabVIEW
    ".parquet": _read_parquet,
    ".mat": read_mat,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".npz": read_npz,
    ".xlsx": read_excel,
}
