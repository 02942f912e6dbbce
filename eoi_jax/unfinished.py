"""What has to be undone where the process ends at once: files and folders that are half written."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_UNDO: list[Callable[[], None]] = []


@contextmanager
def tidied(undo: Callable[[], None]) -> Iterator[None]:
    """Call `undo` at the end, whether that is reached or the process is interrupted before.

    Args:
        undo: takes away what is half written; may be called twice.
    """
    _UNDO.append(undo)
    try:
        yield
    finally:
        undo()
        _UNDO.remove(undo)


def tidy() -> None:
    """Undo all that is half written, for a process that ends without going back to it."""
    for undo in reversed(_UNDO):
        undo()
