"""Checksums that tell which chunks of a sweep's store are intact.

The mark of a chunk, in the array ``done``, is a digest of its arrays, its place and the sweep; 0
where there is none. A chunk that is missing, truncated, corrupted or swapped with another no longer
agrees with its mark.
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
    """Condition of a chunk: not written yet, as it was written, or damaged."""

    ABSENT = "absent"
    INTACT = "intact"
    DAMAGED = "damaged"


def digest(sweep: str, place: Place, arrays: Mapping[str, np.ndarray]) -> np.uint64:
    """The mark of a chunk.

    Args:
        sweep: fingerprint of the sweep.
        place: of the chunk in the grid of chunks.
        arrays: of the chunk by name, of the types of the store.

    Returns:
        64 bits of a cryptographic hash; never 0.
    """
    hasher = hashlib.blake2b(repr((sweep, tuple(place))).encode(), digest_size=8)
    for name in sorted(arrays):
        values = arrays[name]
        if (
            values.dtype.kind == "f"
        ):  # signs of NaN: lost in a chunk of NaN only, which is not stored
            values = np.where(np.isnan(values), np.nan, values)
        hasher.update(name.encode() + np.ascontiguousarray(values).tobytes())
    return np.uint64(int.from_bytes(hasher.digest(), "little") or 1)


class Chunks:
    """The chunks of an open store.

    Args:
        root: the group.
        names: of the arrays over the lanes.
        sweep: fingerprint of the sweep of the store.
        folder: of the store; None in memory.
    """

    def __init__(self, root: Any, names: Sequence[str], sweep: str, folder: Path | None):
        self._arrays = {name: root[name] for name in names}
        self._marks = root["done"]
        self._sweep, self._folder = sweep, folder
        first = self._arrays[names[0]]
        rank = len(self._marks.shape)
        self._shape, self._steps = first.shape[:rank], first.chunks[:rank]

    def __iter__(self) -> Iterator[Place]:
        """Places of all chunks."""
        return itertools.product(*(range(n) for n in self._marks.shape))

    def region(self, place: Place) -> tuple[slice, ...]:
        """Range of a chunk along each dimension of the lanes."""
        return tuple(
            slice(i * step, min((i + 1) * step, n))
            for i, step, n in zip(place, self._steps, self._shape, strict=True)
        )

    def files(self, place: Place) -> dict[str, Path]:
        """Files of a chunk by array, its mark under ``done``; empty for a store in memory."""
        if self._folder is None:
            return {}
        paths = {}
        for name, array in {"done": self._marks, **self._arrays}.items():
            coordinates = (*place, *[0] * (len(array.shape) - len(place)))
            paths[name] = self._folder / name / array.metadata.encode_chunk_key(coordinates)
        return paths

    def read(self, place: Place) -> dict[str, np.ndarray]:
        """Arrays of a chunk by name; raises any exception of Zarr if it cannot be read."""
        region = self.region(place)
        return {name: np.asarray(array[region]) for name, array in self._arrays.items()}

    def condition(self, place: Place) -> Condition:
        """Whether a chunk can be read, and agrees with its mark."""
        # Zarr takes a folder in the place of a file for a chunk that was never written.
        if any(path.is_dir() for path in self.files(place).values()):
            return Condition.DAMAGED
        try:
            mark, arrays = np.uint64(self._marks[place]), self.read(place)
        except Exception:  # of the disk, a codec or Zarr: they have no common class
            return Condition.DAMAGED
        if mark == 0:
            return Condition.ABSENT
        is_intact = mark == digest(self._sweep, place, arrays)
        return Condition.INTACT if is_intact else Condition.DAMAGED
