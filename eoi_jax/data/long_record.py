"""Records too long for memory, read piece by piece from a memory-mapped or chunked file."""

import hashlib
import mmap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np

from eoi_jax._checks import check, check_choice, check_positive, timed
from eoi_jax.data.input_holds import HOLDS, Hold, HoldArgument, suggested_hold
from eoi_jax.data.record import Record

_SHORTEST = 1000  # samples of a piece, and of a place that the hash and the hold depend on


class LongRecord(Sequence[Record]):
    """A long, uniformly sampled record as a sequence of overlapping records of `piece` samples.

    Only the piece that a pass needs is in memory. Each piece starts `overlap` samples early; these
    are its burn-in. Every sample is scored once, after observer and filter have settled.

    Args:
        sample_period: h [s].
        inputs: (N,) or (N, nu): an object that is sliced like an array and reads from disk then,
            such as `numpy.memmap`, a dataset of h5py or an array of zarr.
        outputs: (N,) or (N, ny), likewise.
        piece: number of samples of a piece.
        overlap: number of samples by which a piece starts early; not less than the transient.
        name: name of the record.
        input_names: as in `Record`.
        output_names: as in `Record`.
        units: ``{name: unit}``.
        hold: the input between two samples; ``"auto"`` is decided once for all pieces, from
            places all along the record.

    Raises:
        ValueError: lengths that differ, a record shorter than the shortest piece, an unknown hold.
    """

    def __init__(
        self,
        sample_period: float,
        inputs: Any,
        outputs: Any,
        piece: int = 500_000,
        overlap: int = 20_000,
        name: str = "long record",
        *,
        input_names: Sequence[str] | None = None,
        output_names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
        hold: HoldArgument = "auto",
    ):
        check_positive("sample_period", sample_period, "It is in seconds.")
        if isinstance(hold, str):
            check_choice("hold", hold, ("auto", *HOLDS))
        lengths = {name: signal.shape[0] for name, signal in (("u", inputs), ("y", outputs))}
        check(
            lengths["u"] == lengths["y"],
            "inputs",
            f"must be as long as the outputs, {timed(lengths['y'], sample_period)}",
            lengths["u"],
        )
        check(lengths["y"] >= _SHORTEST, "outputs", f"must hold {_SHORTEST} samples", lengths["y"])
        check(piece >= _SHORTEST, "piece", f"must be at least {_SHORTEST} samples", piece)
        check(0 <= overlap <= piece, "overlap", "must be from 0 to the length of a piece", overlap)
        self.sample_period, self.inputs, self.outputs = float(sample_period), inputs, outputs
        self.piece, self.overlap, self.name = piece, overlap, name
        self.input_names, self.output_names = input_names, output_names
        self.units = units
        self.hold: HoldArgument = self._suggested_hold() if hold == "auto" else hold

    @property
    def samples(self) -> int:
        """N."""
        return int(self.outputs.shape[0])

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return self.samples * self.sample_period

    @property
    def data_hash(self) -> str:
        """Sixteen hexadecimal digits that depend on the length and on values all along it."""
        digest = hashlib.sha256(f"{self.samples} {self.sample_period} {self.piece}".encode())
        for start, stop in self._places():
            for values in (self.inputs, self.outputs):
                digest.update(_read(values, start, stop).tobytes())
        return digest.hexdigest()[:16]

    @property
    def content_hash(self) -> str:
        """Sixteen hexadecimal digits that also depend on overlap and hold, as estimates do."""
        content = f"{self.data_hash} {self.overlap} {self.hold}"
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def __len__(self) -> int:
        # A remainder too short for a piece is part of the last piece.
        return max((self.samples - 1) // self.piece + (self._remainder >= _SHORTEST), 1)

    def _places(self, count: int = 64) -> list[tuple[int, int]]:
        """Up to `count` ranges (start, stop) all along the record, or one: read in a moment."""
        if self.samples <= count * _SHORTEST:
            return [(0, self.samples)]
        starts = np.linspace(0, self.samples - _SHORTEST, count).astype(int).tolist()
        return [(start, start + _SHORTEST) for start in starts]

    def _suggested_hold(self) -> Hold:
        """The hold of the inputs, by the rule of `Record`."""
        u = np.concatenate([_read(self.inputs, *place) for place in self._places()])
        u = u.reshape(len(u), -1)
        names = [str(j) for j in range(u.shape[1])]
        return suggested_hold(u[np.all(np.isfinite(u), axis=1)], names)[0]

    @property
    def _remainder(self) -> int:
        return (self.samples - 1) % self.piece

    @overload
    def __getitem__(self, index: int) -> Record: ...
    @overload
    def __getitem__(self, index: slice) -> Sequence[Record]: ...
    def __getitem__(self, index: int | slice) -> Record | Sequence[Record]:
        """A piece, read now; a list of them for a slice."""
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        number = range(len(self))[index]
        start = max(number * self.piece - self.overlap, 0)
        last = number == len(self) - 1
        # A piece shares its last sample with the next, so that no step between two is lost.
        stop = self.samples if last else (number + 1) * self.piece + 1
        burn_in = (number * self.piece - start) * self.sample_period
        return Record(
            self.sample_period * np.arange(start, stop),
            _read(self.inputs, start, stop),
            _read(self.outputs, start, stop),
            f"{self.name}[{number}]",
            input_names=self.input_names,
            output_names=self.output_names,
            units=self.units,
            hold=self.hold,
            burn_in=burn_in,
        )

    def __iter__(self) -> Iterator[Record]:
        return (self[i] for i in range(len(self)))


def _read(values: Any, start: int, stop: int) -> np.ndarray:
    """Samples as numbers in memory.

    Pages of a memory map stay resident as long as the map exists, so each piece opens a new map.
    """
    mapped = isinstance(values, np.memmap) and isinstance(values.base, mmap.mmap)
    if not mapped or not values.flags.c_contiguous or values.filename is None:
        return np.array(values[start:stop], dtype=float)
    row = values.dtype.itemsize * int(np.prod(values.shape[1:]))
    view = np.memmap(
        Path(values.filename),
        dtype=values.dtype,
        mode="r",
        offset=values.offset + start * row,
        shape=(stop - start, *values.shape[1:]),
    )
    return np.array(view, dtype=float)
