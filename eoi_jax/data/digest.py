"""A short hash of arrays, by which results name the data that they were made from."""

import hashlib
from collections.abc import Iterable

import numpy as np


def digest(header: str, arrays: Iterable[np.ndarray | None]) -> str:
    """The first 16 hexadecimal digits of SHA-256 of a text and arrays.

    Args:
        header: what is no array.
        arrays: their shapes and values count; None for one that there is not.
    """
    sha = hashlib.sha256(header.encode())
    for array in arrays:
        sha.update(str(np.shape(array)).encode() if array is not None else b"none")
        sha.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return sha.hexdigest()[:16]
