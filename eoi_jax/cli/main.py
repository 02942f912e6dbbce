"""Entry point of the command ``eoi``.

The commands are imported after the handlers of the signals that end a process are set.
"""

import contextlib
import gc
import os
import sys

from eoi_jax import cli
from eoi_jax.cli.signals import INTERRUPTED, ExitCode, handle, ignore, interrupt


def main() -> None:
    """Run the command ``eoi``."""
    # Modules, traces and figures are millions of objects that stay. A collection after every 50 000
    # takes a twentieth of a discovery and saves 17 of its 430 MB; long commands still have them.
    gc.set_threshold(1_000_000)
    # As `_process.one_thread` sets it later: threads that never start need not wait for work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        try:
            with handle(interrupt):
                cli.commands.app(prog_name="eoi")
        finally:
            ignore()  # the process ends now, with its exit status
            # All objects go with the process: to search them for garbage once more takes as long
            # as a tenth of a discovery.
            gc.freeze()
    except KeyboardInterrupt:  # before a command starts
        _exit(ExitCode.INTERRUPTED, INTERRUPTED)
    except SystemExit as end:
        # A Python that an interrupt met within `exec` (as dataclasses are made) would end by SIGINT
        # here, although the interrupt was handled.
        if end.code == ExitCode.INTERRUPTED:
            _exit(ExitCode.INTERRUPTED)
        raise
    except Exception as error:  # outside `terminal.failures`, e.g. at an import
        if "--debug" in sys.argv:
            raise
        _exit(ExitCode.WRONG, f"{type(error).__name__}: {error}; --debug shows the traceback")


def _exit(code: int, message: str = "") -> None:
    with contextlib.suppress(OSError):  # stderr may be closed
        sys.stderr.write(f"eoi: {message}\n" if message else "")
        sys.stderr.flush()
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)
