"""Columns of an HDF5 file: what is in the file itself, each object once, no more than is allowed.

Such a file may name other files (external links, external storage, virtual datasets), hold loops
and the same object many times, and say that a dataset is larger than the disk: all of that is left
out, with a sentence.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.table import Columns, Table, add_columns

_PIECE = 100  # texts that are read at a time


def read_hdf5(path: Path, allowance: Allowance) -> Table:
    """The datasets of a file by their paths in it.

    Args:
        path: of the file.
        allowance: bytes that it may unpack to.

    Raises:
        ValueError: it unpacks to more.
    """
    import h5py

    columns: Columns = {}
    notes: list[str] = []
    with h5py.File(path, "r") as file:
        walk = Walk(file, allowance, notes)
        for key, item in walk.items(file, ""):
            if not key.startswith("#"):
                values = walk.values(key, item)
                if values is not None:
                    add_columns(columns, notes, key, values)
    return Table(columns, notes=tuple(notes))


class Walk:
    """A way through a file that comes by every object once.

    Args:
        file: that is open.
        allowance: bytes that it may unpack to.
        notes: that get a sentence on whatever is left out.
    """

    def __init__(self, file: Any, allowance: Allowance, notes: list[str]):
        self._allowance, self._notes = allowance, notes
        self._seen = {self._address(file)}

    def _address(self, item: Any) -> Any:
        import h5py

        found = h5py.h5o.get_info(item.id)  # pyright: ignore[reportAttributeAccessIssue]
        return found.fileno, found.addr

    def members(self, group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        """What lies in a group itself: name and object.

        Args:
            group: of the file.
            prefix: of the names in sentences.
        """
        import h5py

        for key in group:
            link = group.get(key, getlink=True)
            whole = f"{prefix}{key}"
            if isinstance(link, h5py.HardLink):
                item = group[key]
                if self.is_new(item):
                    yield str(key), item
                elif not whole.startswith("#"):
                    self._notes.append(f"`{whole}` is in the file under another name: left out.")
            elif not isinstance(link, h5py.SoftLink):
                self._notes.append(f"`{whole}` lies in another file: left out.")

    def items(self, group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        """All datasets, by their paths.

        Args:
            group: where to begin.
            prefix: of the paths.
        """
        import h5py

        waiting = [(prefix, group)]
        while waiting:
            path, here = waiting.pop(0)
            for key, item in self.members(here, path):
                if isinstance(item, h5py.Group):
                    waiting.append((f"{path}{key}/", item))
                elif isinstance(item, h5py.Dataset):
                    yield f"{path}{key}", item

    def is_new(self, item: Any) -> bool:
        """Whether an object was not met before; from now on it was.

        Args:
            item: of the file.
        """
        address = self._address(item)
        new = address not in self._seen
        self._seen.add(address)
        return new

    def values(self, name: str, item: Any) -> np.ndarray | None:
        """What a dataset holds; None where that is elsewhere, or nothing.

        Args:
            name: for the sentence on it.
            item: the dataset.

        Raises:
            ValueError: it is larger than what is allowed.
        """
        import h5py

        if item.is_virtual or item.external:
            self._notes.append(f"`{name}` lies in another file: left out.")
            return None
        if item.shape is None:
            return None
        self._allowance.take(float(np.prod(np.asarray(item.shape, float))) * item.dtype.itemsize)
        if item.dtype.kind == "O" and h5py.check_ref_dtype(item.dtype) is None:
            return self._texts(name, item)
        return np.asarray(item[()])

    def _texts(self, name: str, item: Any) -> np.ndarray | None:
        """Entries of any length; many may be the same long one, so each is counted."""
        if item.ndim != 1:
            self._notes.append(f"`{name}` holds texts in {item.ndim} axes: left out.")
            return None
        found: list[Any] = []
        for first in range(0, len(item), _PIECE):
            part = item[first : first + _PIECE].tolist()
            self._allowance.take(sum(np.size(one) + len(one) for one in part if np.ndim(one) < 2))
            found += [one.decode(errors="replace") if isinstance(one, bytes) else one
                      for one in part]  # fmt: skip
        values = np.empty(len(found), dtype=object)
        values[:] = found
        return values
