"""The parameters of an estimate as a file of numbers: JSON or CSV."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._checks import check
from eoi_jax.models.export.files import write_content
from eoi_jax.report.parameters import (
    LEVEL,
    AtInput,
    ParameterEstimate,
    estimate_of,
    fit_of,
    parameter_estimates,
    plant_of,
)
from eoi_jax.report.provenance import describe_record, json_values, versions

FORMAT = 1
SUFFIXES = (".json", ".csv")
_KIND = '"kind": "parameters"'
_COLUMNS = ("name", "value", "standard_error", "low", "high", "unit", "estimated", "effect")
_INPUT_COLUMNS = ("input", "value_at_input", "standard_error_at_input", "unit_at_input")


def export_parameters(result: Any, path: str | Path) -> Path:
    """Write the parameters of an estimate, those of effects among them, to a file of numbers.

    Of each parameter: its value, standard error and the ends of its 95 % interval [unit], the unit,
    whether it was estimated or fixed, the effect that it belongs to, and the strength of such an
    effect in the unit of the input that drives the model, where that is constant. JSON also has the
    name of the model, the versions, and name, size and hash of the records; CSV has a row for each
    parameter. What is not known is null in JSON, and empty in CSV.

    Args:
        result: of `identify`, `refine`, `discover`, `uncertainty` or `bootstrap`; or a `Plant`,
            which has no errors.
        path: of the file, which ends in ``.json`` or ``.csv``.

    Returns:
        The path.

    Raises:
        ValueError: a result without an estimate or without an answer, another ending, a folder that
            cannot be written, or a file in its place that holds something else.
    """
    path = Path(path)
    check(path.suffix in SUFFIXES, "path", f"must end in {' or '.join(SUFFIXES)}", path)
    rows = parameter_estimates(result, estimate_of(result))
    text = _csv(rows) if path.suffix == ".csv" else _json(result, rows)
    mark = ",".join(_COLUMNS[:3]) if path.suffix == ".csv" else _KIND
    write_content(path, text.encode(), mark.encode())
    return path


def _json(result: Any, rows: Sequence[ParameterEstimate]) -> str:
    plant, fit = plant_of(result), fit_of(result)
    records = getattr(fit, "records", ())
    content = {
        "format": FORMAT,
        "kind": "parameters",
        "model": None if plant is None else plant.name,
        "level": LEVEL,
        "parameters": {row.name: _fields(row) for row in rows},
        "records": [describe_record(record) for record in records],
        "versions": versions(),
    }
    return json.dumps(json_values(content), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _fields(row: ParameterEstimate) -> dict[str, Any]:
    fields = {name: getattr(row, name) for name in _COLUMNS[1:]}
    return {**fields, "at_input": None if row.at_input is None else dict(vars(row.at_input))}


def _csv(rows: Sequence[ParameterEstimate]) -> str:
    file = io.StringIO()
    table = csv.writer(file, lineterminator="\n")
    table.writerow((*_COLUMNS, *_INPUT_COLUMNS))
    for row in rows:
        strength = row.at_input or AtInput("", np.nan, np.nan, "")
        cells = [getattr(row, name) for name in _COLUMNS]
        cells += [strength.input, strength.value, strength.standard_error, strength.unit]
        table.writerow(_cell(value) for value in cells)
    return file.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return "" if np.isnan(value) else repr(float(value))
    return value
