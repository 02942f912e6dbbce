"""Columns of an HDF5 file: each object of the file itself once, within the allowed size.

An HDF5 file may refer to other files (external links, external storage, virtual datasets), hold
cycles or several links to an object, and declare datasets larger than the disk. These are left out,
with a note.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax.data.readers.limits import Allowance
from eoi_jax.data.readers.table import Columns, Table, add_columns


def read_hdf5(path: Path, allowance: Allowance) -> Table:
    """The datasets of a file by their paths in it.

    Args:
        path: of the file.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: the file unpacks to more.
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
    """Traversal of a file that visits every object once.

    Args:
        file: the open file.
        allowance: bytes that the file may unpack to.
        notes: list to which a sentence is appended for everything that is left out.
    """

    def __init__(self, file: Any, allowance: Allowance, notes: list[str]):
        self._allowance, self._notes = allowance, notes
        self._addresses = {self._address(file)}

    def _address(self, item: Any) -> Any:
        import h5py

        info = h5py.h5o.get_info(item.id)  # pyright: ignore[reportAttributeAccessIssue]
        return info.fileno, info.addr

    def members(self, group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        """Names and objects of the members of a group.

        Args:
            group: of the file.
            prefix: of the names in notes.
        """
        import h5py

        for key in group:
            link = group.get(key, getlink=True)
            full_name = f"{prefix}{key}"
            if isinstance(link, h5py.HardLink):
                item = group[key]
                if self.is_new(item):
                    yield str(key), item
                elif not full_name.startswith("#"):
                    self._notes.append(
                        f"`{full_name}` is in the file under another name: left out."
                    )
            elif not isinstance(link, h5py.SoftLink):
                self._notes.append(f"`{full_name}` lies in another file: left out.")

    def items(self, group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        """All datasets with their paths.

        Args:
            group: at which the traversal starts.
            prefix: of the paths.
        """
        import h5py

        waiting = [(prefix, group)]
        while waiting:
            path, current = waiting.pop(0)
            for key, item in self.members(current, path):
                if isinstance(item, h5py.Group):
                    waiting.append((f"{path}{key}/", item))
                elif isinstance(item, h5py.Dataset):
                    yield f"{path}{key}", item

    def is_new(self, item: Any) -> bool:
        """Whether an object has not been visited yet; it is marked as visited.

        Args:
            item: of the file.
        """
        address = self._address(item)
        new = address not in self._addresses
        self._addresses.add(address)
        return new

    def values(self, name: str, item: Any) -> np.ndarray | None:
        """Values of a dataset; None if it is empty or its values are in another file.

        Args:
            name: of the dataset in notes.
            item: the dataset.

        Raises:
            ValueError: the dataset is larger than is allowed.
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

    def _texts(self, name: str, item: Any, piece: int = 100) -> np.ndarray | None:
        """Texts of any length; each is counted, as many may refer to the same long text.

        `piece` texts are read at a time, before they are counted.
        """
        if item.ndim != 1:
            self._notes.append(f"`{name}` holds texts in {item.ndim} axes: left out.")
            return None
        entries: list[Any] = []
        for first in range(0, len(item), piece):
            part = item[first : first + piece].tolist()
            self._allowance.take(
                sum(np.size(entry) + len(entry) for entry in part if np.ndim(entry) < 2)
            )
            entries += [entry.decode(errors="replace") if isinstance(entry, bytes) else entry
                      for entry in part]  # fmt: skip
        values = np.empty(len(entries), dtype=object)
        values[:] = entries
        return values
