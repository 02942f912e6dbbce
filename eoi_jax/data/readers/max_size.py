"""Largest unpacked size of a file; apart from `limits.py`, for `eoi --help` imports no NumPy."""

MAX_GIGABYTES = 4.0  # [1e9 bytes], largest unpacked size of a file
