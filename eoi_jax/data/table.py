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
        columns: by name, each (N,) or, for a matrix variable, (N, k).
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
