"""Arrays of an ``.npz`` file: sizes are checked before unpacking, and no code is run."""

import math
from pathlib import Path
from typing import Any
from zipfile import ZipFile, is_zipfile

import numpy as np
from numpy.lib import format as npy

from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.table import Columns, Table, add_columns


def read_arrays(path: Path, allowance: Allowance) -> dict[str, np.ndarray | None]:
    """The arrays of an archive as `numpy.savez` writes it.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.

    Returns:
        Arrays by name; None for an array of Python objects, which could only be read by running
        code from the file.

    Raises:
        ValueError: no archive of arrays, a damaged archive, or more bytes than are allowed.
    """
    if not is_zipfile(path):
        raise ValueError("it is no archive of arrays, as `numpy.savez` writes it")
    allowance.take_archive(path)
    with ZipFile(path) as archive:
        members = [member for member in archive.infolist() if not member.is_dir()]
        return {member.filename.removesuffix(".npy"): _array(archive, member) for member in members}


def read_npz(path: Path, allowance: Allowance) -> Table:
    """The columns of an archive of arrays.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: those of `read_arrays`, or nothing but Python objects.
    """
    columns: Columns = {}
    notes: list[str] = []
    objects: dict[str, str] = {}
    for key, values in read_arrays(path, allowance).items():
        if values is None:  # reading it would run code from the file
            objects[key] = f"`{key}` holds Python objects; save it as an array of numbers."
        else:
            add_columns(columns, notes, key, values)
    if objects and not columns:
        raise ValueError(" ".join(objects.values()))
    return Table(columns, notes=tuple(notes), objects=objects)


def _array(archive: ZipFile, member: Any) -> np.ndarray | None:
    with archive.open(member) as stream:
        version = npy.read_magic(stream)
        reader = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, _, dtype = reader(stream)
    if dtype.hasobject:
        return None
    size = math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or size > member.file_size:
        raise ValueError(f"`{member.filename}` declares a larger size than it has")
    with archive.open(member) as stream:
        return npy.read_array(stream, allow_pickle=False)
