"""How a process ends: exit codes, and signals: Ctrl-C, termination, hang-up of the terminal."""

import enum
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

INTERRUPTED = "interrupted; no partly written files remain"
# Windows has no SIGHUP.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class ExitCode(enum.IntEnum):
    """Exit statuses beside 0, as of a shell: 128 and the number of SIGINT where it ended."""

    NO_ANSWER = 1
    WRONG = 2
    INTERRUPTED = 130


def interrupt(number: int = signal.SIGINT, frame: FrameType | None = None) -> None:
    """Raise `KeyboardInterrupt`, as Ctrl-C does.

    Args:
        number: of the signal.
        frame: current stack frame.
    """
    del number, frame
    raise KeyboardInterrupt


@contextmanager
def handle(handler: Callable[..., Any]) -> Iterator[None]:
    """Context in which signals that end a process call a handler instead.

    A signal that is ignored stays ignored, as with `nohup` or `&` in a shell. Only the main thread
    of a process may set handlers.

    Args:
        handler: as of `signal.signal`.
    """
    previous = {}
    if threading.current_thread() is threading.main_thread():
        active = [number for number in ENDING if signal.getsignal(number) != signal.SIG_IGN]
        previous = {number: signal.signal(number, handler) for number in active}
    try:
        yield
    finally:
        for number, former in previous.items():
            signal.signal(number, former)


def ignore() -> None:
    """Ignore further signals: the process is about to end."""
    if threading.current_thread() is threading.main_thread():
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)
