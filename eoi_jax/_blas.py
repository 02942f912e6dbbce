"""Single-threaded BLAS of NumPy and SciPy while the library computes.

The matrices are small: waking a second thread takes longer than the computation. Under other load
the threads wait for each other, which doubles the time of an estimate.
"""

import functools
import threading
from collections.abc import Iterator
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
