"""Check of the sizes and the depth of a MAT file of version 5 before its matrices are built.

Such a file is a sequence of elements, each a tag (kind, size) and its bytes, padded to eight. A
matrix is an element of further elements: flags, dimensions, a name, then its values or, for a cell
or a structure, further matrices. A compressed element holds a single matrix. A reader allocates
what the dimensions of a matrix say, so these are counted.

Source: MathWorks, MAT-File Format, R2024a, chapter 1.
"""

import enum
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np

from eoi_jax.data.readers.limits import PIECE, Allowance

_KINDS = {
    *range(1, 8),
    9,
    *range(12, 19),
}  # a reader may index its table of kinds out of range with others

Read = Callable[[int], bytes]


class _Kind(enum.IntEnum):
    """Kinds of elements that are looked into."""

    INT32 = 5
    MATRIX = 14
    COMPRESSED = 15


def check_sizes(path: Path, allowance: Allowance) -> None:
    """Refuse a file that would fill the memory, or the stack, of its reader.

    Args:
        path: of the file; files of other versions are not checked.
        allowance: bytes that the file may unpack to.

    Raises:
        ValueError: more bytes than are allowed, or matrices that are nested too deeply.
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
            if kind == _Kind.COMPRESSED:
                stream = _Unpacked(file, size, allowance)
                _scan(stream.read, order, allowance)
                stream.skip_remaining()
            elif kind == _Kind.MATRIX:
                _matrix(file.read, order, size, allowance)
            file.seek(end)


def _scan(read: Read, order: str, allowance: Allowance) -> None:
    tag = read(8)
    if len(tag) == 8:
        kind, size = struct.unpack(f"{order}II", tag)
        if kind == _Kind.MATRIX:
            _matrix(read, order, size, allowance)


def _matrix(
    read: Read,
    order: str,
    size: int,
    allowance: Allowance,
    max_depth: int = 100,
    max_axes: int = 64,
) -> None:
    """Scan the elements of a matrix and of the matrices within it.

    At most `max_depth` of them are nested, so that no reader runs out of stack, and the dimensions
    have at most `max_axes` axes, as in NumPy.
    """
    ends = [size]  # of the open matrices [bytes from the start of the outermost]
    place = 0
    number = 0  # of the element within its matrix
    while ends and len(tag := read(8)) == 8:
        place += 8
        kind, length = struct.unpack(f"{order}II", tag)
        inline = b""
        if kind >> 16:  # a short element, within its tag
            inline, kind, length = tag[4 : 4 + (kind >> 16)], kind & 0xFFFF, 0
        if kind == _Kind.MATRIX and length:
            ends.append(place + length)
            number = 0
            if len(ends) > max_depth:
                raise ValueError("its structures or cells are nested too deeply")
            continue
        if kind not in _KINDS:
            raise ValueError("it holds an element of an unknown type")
        number += 1
        padded = length + -length % 8
        if kind == _Kind.INT32 and number == 2 and length <= 4 * max_axes:
            content = inline or read(padded)[:length]
            axes = np.frombuffer(content[: len(content) // 4 * 4], f"{order}i4").astype(float)
            allowance.take(8.0 * float(np.prod(np.maximum(axes, 0.0))))
        else:
            _skip(read, padded)
        place += padded
        while ends and place >= ends[-1]:
            ends.pop()


def _skip(read: Read, size: int) -> None:
    while size > 0 and (piece := read(min(size, PIECE))):
        size -= len(piece)


class _Unpacked:
    """Contents of a compressed element, unpacked piece by piece."""

    def __init__(self, file: BinaryIO, size: int, allowance: Allowance):
        self._file, self._packed, self._allowance = file, size, allowance
        self._inflate, self._buffer = zlib.decompressobj(), bytearray()

    def read(self, size: int) -> bytes:
        """Read bytes, like `read` of a file.

        Args:
            size: number of bytes; fewer are returned at the end.
        """
        while len(self._buffer) < size and not self._inflate.eof:
            packed = self._inflate.unconsumed_tail
            if not packed:
                packed = self._file.read(min(self._packed, PIECE))
                self._packed -= len(packed)
                if not packed:
                    break
            piece = self._inflate.decompress(packed, PIECE)
            self._allowance.take(len(piece))
            self._buffer += piece
        part = bytes(self._buffer[:size])
        del self._buffer[:size]
        return part

    def skip_remaining(self) -> None:
        """Unpack the remaining bytes to count them."""
        while self.read(PIECE):
            pass
