"""What the public sets share: where they are, how their tables become records, how they are split.

Each set is a folder of CSV files, with the columns that its case names, in the folder that EOI_SETS
names (by default `sets` beside the repository); its README has the hand fits.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

import eoi_jax as eoi
from benchmarks.common import ROOT
from benchmarks.measured.campaign_cases import Parts, Rig

Rows = tuple[int, int]  # first row, and the one behind the last
Runs = tuple[tuple[str, Rows], ...]  # names of files, with their rows


@dataclass(frozen=True)
class FoundSet:
    """A case, and where its set can be had.

    Attributes:
        rig: declared model, records and errors of the hand fits, from the folder of the sets.
        source: what it is, and its public address.
        aside: not to be opened before the end.
    """

    rig: Callable[[Path], Rig]
    source: str
    aside: bool = False


def sets_directory() -> Path:
    """Folder of the found sets: $EOI_SETS, else beside the repository."""
    return Path(os.environ.get("EOI_SETS") or ROOT.parent / "sets")


def table(path: Path) -> Mapping[str, np.ndarray]:
    """Columns by name; empty cells are NaN."""
    data = np.genfromtxt(path, delimiter=",", names=True)
    return {name: data[name] for name in data.dtype.names or ()}


def records(
    plant: eoi.Plant,
    columns: Mapping[str, np.ndarray],
    parts: Sequence[Sequence[Rows]],
    time_unit: float = 1.0,
) -> Parts:
    """Rows of a table as records of three parts; channels are columns with the plant's names."""

    def channels(names: Sequence[str], cut: slice) -> np.ndarray:
        chosen = [columns[name][cut] for name in names]
        return np.stack(chosen, 1) if chosen else np.zeros((len(columns["time"][cut]), 0))

    def record(rows: Rows) -> eoi.Record:
        cut = slice(*rows)
        return eoi.Record(
            columns["time"][cut] / time_unit, channels(plant.inputs, cut),
            channels(plant.outputs, cut), f"rows {rows[0]} to {rows[1]}",
            input_names=plant.inputs, output_names=plant.outputs,
            units={name: plant.units[name] for name in (*plant.inputs, *plant.outputs)},
        )  # fmt: skip

    first, second, third = (tuple(record(rows) for rows in part) for part in parts)
    return first, second, third


def runs(
    plant: eoi.Plant, folder: Path, parts: tuple[Runs, Runs, Runs], time_unit: float = 1.0
) -> Parts:
    """Records from several files of a folder."""

    def record(name: str, rows: Rows) -> eoi.Record:
        return records(plant, table(folder / f"{name}.csv"), ((rows,),) * 3, time_unit)[0][0]

    first, second, third = (tuple(record(*run) for run in part) for part in parts)
    return first, second, third


def quarters(count: int, first: int = 0) -> tuple[tuple[Rows], tuple[Rows], tuple[Rows]]:
    """A half to estimate, a quarter held out, a quarter untouched."""
    cuts = [first + int((count - first) * share) for share in (0.0, 0.5, 0.75, 1.0)]
    first_half, third, fourth = pairwise(cuts)
    return (first_half,), (third,), (fourth,)
