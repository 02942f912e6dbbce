"""Files beside those of a config, with the same columns: records, or planned inputs only."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from eoi_jax._checks import check
from eoi_jax.cli.build import read_file, records_of_table
from eoi_jax.cli.config import Config, DataTable
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.inspection import inspect
from eoi_jax.data.readers.conversions import factor_and_offset
from eoi_jax.data.readers.missing import codes_by_column, without_missing
from eoi_jax.data.readers.read_record import read_table
from eoi_jax.data.record import Record
from eoi_jax.data.time_axis import parts_between_restarts
from eoi_jax.models.plant import Plant
from eoi_jax.models.units import units_agree


def records_of_files(config: Config, model: Plant, files: Sequence[Path]) -> list[Record]:
    """Records of other files of the same columns as those of the config.

    Columns, units, scale, hold and burn-in are those of [validation], else of [data]; a `slice` is
    that of its own files, and where the logger was started again a file is several records. Of a
    simulated run the columns are called as the plant's channels.

    Args:
        config: the tables.
        model: the plant.
        files: paths of data files.

    Raises:
        ValueError: a file that does not exist, or lacks a column, and the errors of `read_record`.
    """
    table = _table_of_files(config, model, files, model.outputs)
    parts = {} if table.time is None else {name: _parts(name, table) for name in table.files}
    table = msgspec.structs.replace(table, parts=parts)
    return records_of_table(table, "data", model, config.controller, Path(), None)


def dates_of_zero(config: Config, model: Plant, files: Sequence[Path]) -> list[tuple[str, Any]]:
    """The column of time of each record of `records_of_files`, and the date of its time zero.

    Args:
        config: the tables.
        model: the plant.
        files: paths of data files.

    Returns:
        A name and a `numpy.datetime64` for each record, in UTC where the file has offsets; an empty
        name where stamps are no dates, or have a `scale`.
    """
    table, dates = _table_of_files(config, model, files, None), list[tuple[str, Any]]()
    clock = table.time or ""
    for name in table.files:
        stamps = read_table(Path(name), table.max_gigabytes, table.sheet).columns.get(clock)
        date = None
        if stamps is not None and stamps.dtype.kind == "M" and clock not in table.scale:
            date = stamps[np.argmin(np.isnat(stamps))]
        dates += [(clock if date is not None else "", date)] * max(len(_parts(name, table)), 1)
    return dates


def planned_inputs(config: Config, model: Plant, file: Path) -> tuple[Record, dict[str, float]]:
    """The inputs of the plant in a file that need not have its outputs, and what it has of these.

    Columns, units, scale and hold are those of `records_of_files`. References are not read.

    Args:
        config: the tables.
        model: the plant.
        file: path of a data file.

    Returns:
        A record whose only output is the column of time, which stands where no output is measured;
        and by name the outputs that the file has in its first sample [unit after `scale`].

    Raises:
        ValueError: a file that does not exist, or lacks an input at some sample, no column of time,
            an output in another unit than the plant's, and the errors of `read_record`.
    """
    table = _table_of_files(config, model, [file], None)
    rule = "must be given where a file has no outputs, for a prediction"
    advice = "Add it to the table and to the file."
    check(table.time is not None, "data.time", rule, "none", advice)
    assert table.time is not None
    inputs, hold = table.inputs or model.inputs, table.hold
    if isinstance(hold, dict):
        hold = {key: word for key, word in hold.items() if key in inputs}
    elif config.controller is not None and hold == "auto":
        hold = "zero"
    _check_rows(table, file)
    measured = _first_outputs(table, model, file)
    columns = (table.time, *inputs)
    options = {
        name: {key: value for key, value in getattr(table, name).items() if key in columns}
        for name in ("scale", "units", "unwrap")
    }
    chosen = {
        name: tuple(key for key in getattr(table, name) if key in columns)
        for name in ("empty_repeats", "impulses")
    }
    if isinstance(table.missing, dict):
        options["missing"] = {key: code for key, code in table.missing.items() if key in columns}
    read = {"inputs": inputs, "outputs": (table.time,), "references": (), "burn_in": 0.0}
    read |= {"mask_faults": False, "late": {}, **chosen}
    table = msgspec.structs.replace(table, **read, **options)
    record = read_file(file, table, "data", {"hold": hold})
    gaps = np.flatnonzero(~record.input_valid)
    count = len(gaps)
    begin = f", first at t = {record.time[gaps[0]]:g} s" if count else ""
    value = f"{count} of {len(record)} without{begin}"
    advice = "Fill them in: a prediction needs the inputs from its start to its end."
    check(not count, "FILE", f"must have {', '.join(inputs)} at all samples", value, advice)
    return record, measured


def _table_of_files(
    config: Config, model: Plant, files: Sequence[Path], outputs: tuple[str, ...] | None
) -> DataTable:
    """What a config says of files, for others of the same columns; without `parts` and `slice`.

    Args:
        config: the tables.
        model: the plant.
        files: paths of data files.
        outputs: their columns in files of a simulated run, which has no table; None: unknown.

    Raises:
        ValueError: a file that does not exist.
    """
    for path in files:
        check(path.is_file(), "FILE", "must be a data file that exists", path)
    table = config.validation or config.data
    names = tuple(str(path.absolute()) for path in files)
    if table is None:
        clock = inspect(files[0], inputs=model.inputs, outputs=outputs).clock.column
        table = DataTable(names, model.inputs, model.outputs, time=clock)
    if any(path.suffix.lower() != ".xlsx" for path in files):
        table = msgspec.structs.replace(table, sheet=None)
    return msgspec.structs.replace(table, files=names, slice=None, parts={})


def _parts(path: str, table: DataTable) -> tuple[tuple[int, int], ...]:
    """Samples between restarts of the logger; none where time goes on, or is not in the file."""
    stamps = read_table(Path(path), table.max_gigabytes, table.sheet).columns.get(table.time or "")
    if stamps is None or stamps.dtype.kind not in "iufMm":
        return ()
    parts = parts_between_restarts(stamps)
    return parts if parts != ((0, len(stamps)),) else ()


def _check_rows(table: DataTable, file: Path) -> None:
    """A plan of few rows is one that more rows say as well: a record needs some."""
    stamps = read_table(file, table.max_gigabytes, table.sheet).columns.get(table.time or "")
    count = SHORTEST if stamps is None else len(stamps)
    rule = f"must have at least {SHORTEST} rows"
    advice = "Add rows between these, with the inputs that act there: what was set stays as it is, "
    advice += "what is given at an instant (`impulses`) is 0."
    check(count >= SHORTEST, "FILE", rule, f"{count} in {file}", advice)


def _first_outputs(table: DataTable, model: Plant, file: Path) -> dict[str, float]:
    """The outputs that a file has in its first sample, by name."""
    content, first = read_table(file, table.max_gigabytes, table.sheet), {}
    stamps = content.columns.get(table.time or "")
    row = -1 if stamps is not None and stamps.dtype.kind != "O" and stamps[0] > stamps[-1] else 0
    columns = table.outputs or model.outputs
    missing = table.missing
    if isinstance(missing, dict):
        missing = {key: code for key, code in missing.items() if key in columns}
    codes = codes_by_column(missing, columns)
    for name, column in zip(model.outputs, columns, strict=True):
        values = content.columns.get(column)
        if values is not None:
            values = without_missing(column, values, codes.get(column, ()), [])
        if values is None or values.dtype.kind not in "iuf" or not np.isfinite(values[row]):
            continue
        unit, expected = content.units.get(column, ""), model.units.get(name, "")
        converted = column in table.scale or column in table.units
        rule = f"must be in the plant's unit for `{name}`, {expected!r}"
        advice = "Convert the column, or name the right one."
        agree = converted or not expected or units_agree(unit, expected) is not False
        check(agree, f"FILE[{column}]", rule, f"{unit!r} in {file}", advice)
        factor, offset = factor_and_offset(f"scale[{column}]", table.scale.get(column, 1.0))
        first[name] = factor * float(values[row]) + offset
    return first
