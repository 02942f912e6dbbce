"""One thread of NumPy's and SciPy's BLAS, as long as the library computes.

Its matrices are small: to wake a second thread takes longer than they do, and beside other work the
threads wait for each other, which doubles the time of an estimate.
"""

import functools
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from threadpoolctl import ThreadpoolController


@contextmanager
def one_thread() -> Iterator[None]:
    """In the main thread: OpenBLAS takes such orders from no other one."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    with _pools().limit(limits=1, user_api="blas"):
        yield


@functools.cache
def _pools() -> ThreadpoolController:
    """What is loaded now; looking for it takes milliseconds."""
    import scipy.linalg  # noqa: F401  it brings a BLAS of its own

    return ThreadpoolController()
