"""What a computation takes of its process: one thread for BLAS, and memory that it gives back.

The matrices are small: waking a second thread takes longer than the computation. Under other load
the threads wait for each other, which doubles the time of an estimate.

What is freed the C library keeps where blocks in use lie between: 0.3 to 0.55 GB after a discovery
on 30 000 samples. The next one finds only a part of it: a process had 2.2 GB after 190 of them.
"""

import ctypes
import functools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit BLAS to a single thread; only in the main thread, as OpenBLAS allows no other."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with _pools().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _pools() -> ThreadpoolController:
    """The loaded BLAS libraries, cached, as the search takes milliseconds."""
    import scipy.linalg  # noqa: F401  SciPy loads a separate BLAS

    return ThreadpoolController()


@contextmanager
def memory_returned() -> Iterator[None]:
    """Return freed memory to the system at the end, where the C library is glibc.

    **Source.** malloc_trim(3) of the Linux manual.
    """
    try:
        yield
    finally:
        trim = _trim()
        if trim is not None:
            trim(0)


@functools.cache
def _trim() -> Callable[[int], int] | None:
    """`malloc_trim` of the C library; None where it has none."""
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # musl, macOS; Windows has no such handle
        return None
