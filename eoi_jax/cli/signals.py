"""Signals that end a process: Ctrl-C, a request to end, a terminal that is closed."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

# Windows knows no SIGHUP.
ENDING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


def interrupt(number: int = signal.SIGINT, frame: FrameType | None = None) -> None:
    """Raise what Ctrl-C raises.

    Args:
        number: of the signal.
        frame: that it came in.
    """
    del number, frame
    raise KeyboardInterrupt


@contextmanager
def handled(handler: Callable[..., Any]) -> Iterator[None]:
    """Have every signal that ends a process call a handler instead.

    A signal that is ignored stays so: `nohup` and a shell's `&` ask for that. Only the main thread
    of a process may say any of this.

    Args:
        handler: as of `signal.signal`.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        heard = [one for one in ENDING if signal.getsignal(one) != signal.SIG_IGN]
        before = {one: signal.signal(one, handler) for one in heard}
    try:
        yield
    finally:
        for one, former in before.items():
            signal.signal(one, former)


def ignore() -> None:
    """Let no further signal in: the process is about to end."""
    if threading.current_thread() is threading.main_thread():
        for one in ENDING:
            signal.signal(one, signal.SIG_IGN)
