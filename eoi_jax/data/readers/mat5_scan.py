"""Sizes and depth of a MAT file of version 5, before anything of it is built.

Such a file is a sequence of elements, each a tag (kind, size) and its bytes, padded to eight. A
matrix is an element that holds others: flags, dimensions, a name, then its values or, of a cell or
a structure, further matrices. A compressed element holds one matrix. Whoever builds a matrix
allocates what its dimensions say, so these are what is counted.

Source: MathWorks, MAT-File Format, R2024a, chapter 1.
"""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from eoi_jax.data.readers.limits import Allowance

_INT32, _MATRIX, _COMPRESSED = 5, 14, 15
_KINDS = {*range(1, 8), 9, *range(12, 19)}  # a reader may look others up beyond its own table
_DEEPEST = 100  # matrices within matrices
_PIECE = 1 << 20  # bytes
_MOST_AXES = 64

Read = Callable[[int], bytes]


def check_sizes(path: Path, allowance: Allowance) -> None:
    """Refuse a file that would fill the memory, or the stack, of its reader.

    Args:
        path: of the file; of another version than 5 nothing is checked.
        allowance: bytes that it may unpack to.

    Raises:
        ValueError: more than are allowed, or matrices that are nested too deeply.
    """
    with path.open("rb") as file:
        head = file.read(128)
        order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
        # Version 7.3 is an HDF5 file behind the same 128 bytes.
        if order is None or head[124:126] not in (b"\x00\x01", b"\x01\x00"):
            return
        while len(tag := file.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            end = file.tell() + size
            if kind == _COMPRESSED:
                stream = _Unpacked(file, size, allowance)
                _scan(stream.read, order, allowance)
                stream.read_on()
            elif kind == _MATRIX:
                _matrix(file.read, order, size, allowance)
            file.seek(end)


def _scan(read: Read, order: str, allowance: Allowance) -> None:
    tag = read(8)
    if len(tag) == 8:
        kind, size = struct.unpack(f"{order}II", tag)
        if kind == _MATRIX:
            _matrix(read, order, size, allowance)


def _matrix(read: Read, order: str, size: int, allowance: Allowance) -> None:
    """The elements of a matrix and of those within it, one after the other."""
    ends = [size]  # of the matrices that are open, counted in bytes from the outermost one's start
    place = 0
    number = 0  # of the element within its matrix
    while ends and len(tag := read(8)) == 8:
        place += 8
        kind, length = struct.unpack(f"{order}II", tag)
        within = b""
        if kind >> 16:  # a short element, within its tag
            within, kind, length = tag[4 : 4 + (kind >> 16)], kind & 0xFFFF, 0
        if kind == _MATRIX and length:
            ends.append(place + length)
            number = 0
            if len(ends) > _DEEPEST:
                raise ValueError("its structures or cells are nested too deeply")
            continue
        if kind not in _KINDS:
            raise ValueError("it holds an element of an unknown type")
        number += 1
        padded = length + -length % 8
        if kind == _INT32 and number == 2 and length <= 4 * _MOST_AXES:
            content = within or read(padded)[:length]
            axes = np.frombuffer(content[: len(content) // 4 * 4], f"{order}i4").astype(float)
            allowance.take(8.0 * float(np.prod(np.maximum(axes, 0.0))))
        else:
            _skip(read, padded)
        place += padded
        while ends and place >= ends[-1]:
            ends.pop()


def _skip(read: Read, size: int) -> None:
    while size > 0 and (piece := read(min(size, _PIECE))):
        size -= len(piece)


class _Unpacked:
    """What a compressed element holds, a piece at a time."""

    def __init__(self, file: BinaryIO, size: int, allowance: Allowance):
        self._file, self._packed, self._allowance = file, size, allowance
        self._inflate, self._buffer = zlib.decompressobj(), bytearray()

    def read(self, size: int) -> bytes:
        """As of a file.

        Args:
            size: bytes wanted; fewer at the end.
        """
        while len(self._buffer) < size and not self._inflate.eof:
            rest = self._inflate.unconsumed_tail
            if not rest:
                rest = self._file.read(min(self._packed, _PIECE))
                self._packed -= len(rest)
                if not rest:
                    break
            piece = self._inflate.decompress(rest, _PIECE)
            self._allowance.take(len(piece))
            self._buffer += piece
        part = bytes(self._buffer[:size])
        del self._buffer[:size]
        return part

    def read_on(self) -> None:
        """Unpack the rest, for its size."""
        while self.read(_PIECE):
            pass
