"""Which chunks of a sweep's store are whole: each bears a mark made of its numbers.

The mark of a chunk, in the array ``done``, is a digest of all that its arrays hold, of its place
and of the sweep; 0 where there is none. Whatever became of a chunk on the disk (missing, cut off,
garbled, exchanged with another's), it no longer agrees with its mark.
"""

import hashlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

Place = tuple[int, ...]


class Condition(Enum):
    """Of a chunk: not there yet, there and as it was written, or neither."""

    ABSENT = "absent"
    WHOLE = "whole"
    DAMAGED = "damaged"


def digest(sweep: str, place: Place, arrays: Mapping[str, np.ndarray]) -> np.uint64:
    """The mark of a chunk.

    Args:
        sweep: fingerprint of the sweep.
        place: of the chunk in the grid of chunks.
        arrays: what it holds by name, of the types of the store.

    Returns:
        64 bits of a cryptographic hash; never 0.
    """
    whole = hashlib.blake2b(repr((sweep, tuple(place))).encode(), digest_size=8)
    for name in sorted(arrays):
        values = arrays[name]
        if values.dtype.kind == "f":  # a chunk of NaN alone is not stored: its signs get lost
            values = np.where(np.isnan(values), np.nan, values)
        whole.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return np.uint64(int.from_bytes(whole.digest(), "little") or 1)


class Chunks:
    """The chunks of an opened store.

    Args:
        root: the group.
        names: of the arrays over the lanes.
        sweep: fingerprint of the sweep that it must belong to.
        folder: of the store; None in memory.
    """

    def __init__(self, root: Any, names: Sequence[str], sweep: str, folder: Path | None):
        self._arrays = {name: root[name] for name in names}
        self._done = root["done"]
        self._sweep, self._folder = sweep, folder
        first = self._arrays[names[0]]
        rank = len(self._done.shape)
        self._shape, self._steps = first.shape[:rank], first.chunks[:rank]

    def __iter__(self) -> Iterator[Place]:
        """Places of all chunks."""
        return itertools.product(*(range(n) for n in self._done.shape))

    def region(self, place: Place) -> tuple[slice, ...]:
        """What a chunk covers of the dimensions of the lanes."""
        return tuple(
            slice(i * step, min((i + 1) * step, n))
            for i, step, n in zip(place, self._steps, self._shape, strict=True)
        )

    def files(self, place: Place) -> dict[str, Path]:
        """Of a chunk by name of the array, its mark under ``done``; none of a store in memory."""
        if self._folder is None:
            return {}
        found = {}
        for name, array in {"done": self._done, **self._arrays}.items():
            coordinates = (*place, *[0] * (len(array.shape) - len(place)))
            found[name] = self._folder / name / array.metadata.encode_chunk_key(coordinates)
        return found

    def read(self, place: Place) -> dict[str, np.ndarray]:
        """What a chunk holds by name; whatever Zarr raises where it cannot be read."""
        region = self.region(place)
        return {name: np.asarray(array[region]) for name, array in self._arrays.items()}

    def condition(self, place: Place) -> Condition:
        """Whether a chunk can be read, and is what its mark stands for."""
        # To Zarr a folder in the place of a file is no chunk, so one that was never written.
        if any(path.is_dir() for path in self.files(place).values()):
            return Condition.DAMAGED
        try:
            mark, arrays = np.uint64(self._done[place]), self.read(place)
        except Exception:  # of the disk, of a codec, of Zarr: they have no class in common
            return Condition.DAMAGED
        if mark == 0:
            return Condition.ABSENT
        whole = mark == digest(self._sweep, place, arrays)
        return Condition.WHOLE if whole else Condition.DAMAGED
