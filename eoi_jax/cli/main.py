"""The entry point of the command ``eoi``.

Its commands are imported once the signals that end a process are handled.
"""

import contextlib
import os
import sys

from eoi_jax import cli
from eoi_jax.cli.signals import handled, ignore, interrupt

_WRONG, _INTERRUPTED = 2, 130


def main() -> None:
    """The entry point of the ``eoi`` command."""
    try:
        try:
            with handled(interrupt):
                cli.commands.app(prog_name="eoi")
        finally:
            ignore()  # what is left is to end, with the status that is due
    except KeyboardInterrupt:  # before a command has begun
        _end(_INTERRUPTED, "interrupted; nothing half-written is left")
    except Exception as error:  # before a command has begun, too: `terminal.failures` is within
        if "--debug" in sys.argv:
            raise
        _end(_WRONG, f"{type(error).__name__}: {error}; --debug shows where")


def _end(code: int, message: str) -> None:
    with contextlib.suppress(OSError):  # nobody listens any more
        sys.stderr.write(f"eoi: {message}\n")
        sys.stderr.flush()
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)
