"""What a file holds before anything is chosen: columns by name, and what it says of them."""

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
        units: by column, where the file says them.
        notes: sentences on how the file was read.
        objects: what is in the file and cannot be read: by name, why and what to do.
        time: the column that the file itself calls its time.
        inputs: the columns that it calls inputs.
        outputs: the columns that it calls outputs.
    """

    columns: Columns
    units: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    objects: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()


def add_columns(columns: Columns, notes: list[str], key: str, values: np.ndarray) -> None:
    """Scalars, vectors and matrices; samples run along a matrix's longer axis.

    Args:
        columns: that get one more, or the columns of a matrix, each by its number.
        notes: that get a sentence where an array is left out.
        key: its name.
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
