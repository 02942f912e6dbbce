"""The contents of a file: columns by name, with units, notes and declared roles."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

Columns: TypeAlias = dict[str, np.ndarray]


@dataclass(frozen=True)
class Table:
    """The columns of a file.

    Attributes:
        columns: by name, each of shape (N,); those of a matrix ``m`` are ``m[0]``, ``m[1]``, ….
        units: by column, where the file gives them.
        notes: sentences on how the file was read.
        objects: by name, the reason why an object cannot be read and what to do.
        time: the column that the file declares as time.
        inputs: the columns that the file declares as inputs.
        outputs: the columns that the file declares as outputs.
        holds: of all declared inputs, where the file gives them (`input_holds.HOLDS`).
        period: the setting of the file that gives the time between samples, and that time [s].
        sheets: of an Excel file, those that hold anything; the one that was read comes first.
    """

    columns: Columns
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    objects: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    holds: Mapping[str, str] = field(default_factory=dict)
    sheets: tuple[str, ...] = ()
    period: tuple[str, float] | None = None

    @property
    def sheet_text(self) -> str:
        """Which sheet of a file with several was read, and how to choose another; else empty."""
        if len(self.sheets) < 2:
            return ""
        listed = ", ".join(f"`{name}`" for name in self.sheets[1:20])
        return f"Read from the sheet `{self.sheets[0]}`; `sheet` chooses another: {listed}."


def add_columns(columns: Columns, notes: list[str], key: str, values: np.ndarray) -> None:
    """Add the columns of a scalar, vector or matrix; samples run along the longer axis of a matrix.

    Args:
        columns: to which the array is added, a matrix as a column for each number.
        notes: to which a sentence is appended if the array is left out.
        key: name of the array.
        values: the array.
    """
    if values.dtype.names is not None:  # a table whose rows are structures
        for name in values.dtype.names:
            add_columns(columns, notes, f"{key}.{name}", values[name])
        return
    values = np.atleast_1d(np.squeeze(values))
    if values.dtype.kind == "S":
        values = np.char.decode(values, errors="replace")
    if values.dtype.kind not in "biufcMmUO":
        notes.append(f"`{key}` is of the type {values.dtype}: left out.")
    elif values.ndim == 1:
        columns[key] = values
    elif values.ndim == 2:
        rows = values.T if values.shape[0] < values.shape[1] else values
        columns |= {f"{key}[{j}]": rows[:, j] for j in range(rows.shape[1])}
    else:
        notes.append(f"`{key}` of shape {values.shape} has more than two axes: left out.")
