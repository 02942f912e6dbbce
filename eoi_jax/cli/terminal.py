"""Output of a command: the answer on stdout, progress and errors on stderr, the exit status.

Exit status: 0 answer, 1 no answer (with the reason), 2 invalid call or data, 130 interrupted.
"""

import contextlib
import json
import os
import shlex
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from eoi_jax.cli.signals import INTERRUPTED, ExitCode, handle, ignore

_PROGRESS_BARS: list[Any] = []  # on the terminal now

_DEBUG = [False]

_UsageError: Any = typer.BadParameter.__base__  # of the click that typer uses
_ClickError: Any = _UsageError.__base__

# Called with a stage of the work, the steps done, their number (None: unknown) and a remark.
ProgressCallback = Callable[[str, int, int | None, str], None]


@dataclass(frozen=True)
class Outcome:
    """The outcome of a command.

    Attributes:
        summary: the results as a JSON object, for programs.
        text: the results as text, for readers.
        place: folder or file that was written; None: nothing was written, see `complaint`.
        code: exit status.
        complaint: what is wrong if the exit status is not 0.
        replaced: a sentence on another run in whose place this one stands; empty: there was none.
    """

    summary: dict[str, Any]
    text: str = ""
    place: Path | None = None
    code: int = 0
    complaint: str = ""
    replaced: str = ""


@contextmanager
def failures(as_json: bool) -> Iterator[None]:
    """Turn an error into one sentence and status 2, an interrupt into 130, without a traceback.

    An unexpected error is reported with a request to report it; ``--debug`` re-raises it.
    Warnings are printed as a line each.

    Args:
        as_json: print the sentence as a JSON object on stdout, too.
    """
    try:
        with handle(lambda *_: _exit_interrupted(as_json)), _print_warnings():
            yield
    except (typer.Exit, typer.Abort, _ClickError):
        raise
    except KeyboardInterrupt:
        stop(ExitCode.INTERRUPTED, INTERRUPTED, as_json)
    except Exception as error:
        if is_debug():
            raise
        stop(ExitCode.WRONG, _sentence(error), as_json)


def _sentence(error: Exception) -> str:
    """The message of an error; an unexpected one asks for a report."""
    if isinstance(error, MemoryError):
        return "out of memory; use fewer columns, or a `slice` of the samples"
    equinox = sys.modules.get("equinox")  # imported if it raised the error
    is_runtime_check = equinox is not None and isinstance(error, equinox.EquinoxRuntimeError)
    if isinstance(error, ValueError | OSError) or is_runtime_check:
        return str(error)
    return (
        f"internal error ({type(error).__name__}: {error}). Please report it to the developers of "
        "eoi_jax with the output of the same command with --debug"
    )


@contextmanager
def _print_warnings() -> Iterator[None]:
    """Print each distinct warning as a line at the end, without its place in the program.

    With ``--debug`` they are printed as Python does.
    """
    if is_debug():
        yield
        return
    with warnings.catch_warnings(record=True) as caught:
        try:
            yield
        finally:
            for line in dict.fromkeys(_warning(warning) for warning in caught):
                say(f"note: {line}", err=True)


def _warning(warning: warnings.WarningMessage) -> str:
    """The message of a warning; NumPy's name an operation but not its consequence."""
    if issubclass(warning.category, RuntimeWarning) and " encountered in " in str(warning.message):
        return (
            f"some numbers left the range of double precision ({warning.message}): what depends on "
            "them is printed as inf or nan"
        )
    return str(warning.message)


def debug(enabled: bool) -> None:
    """Set whether errors are shown with their traceback.

    Args:
        enabled: false: as one sentence.
    """
    _DEBUG[0] = enabled


def is_debug() -> bool:
    """Whether errors are shown with their traceback."""
    return _DEBUG[0]


def _exit_interrupted(as_json: bool) -> None:
    """End the process after removing partly written files.

    Not by an exception, which Python drops inside a callback of the garbage collector, of which JAX
    has one, and which may be raised while the library of JAX is being loaded.
    """
    ignore()
    with contextlib.suppress(Exception):  # the terminal may be closed
        for bar in _PROGRESS_BARS:
            bar.stop()
    atomic = sys.modules.get("eoi_jax._atomic")
    if atomic is not None and hasattr(atomic, "tidy"):
        atomic.tidy()
    with contextlib.suppress(typer.Exit):
        stop(ExitCode.INTERRUPTED, INTERRUPTED, as_json)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(ExitCode.INTERRUPTED)


@contextmanager
def keyboard_interrupts(interval: float = 0.5) -> Iterator[None]:
    """Raise Ctrl-C as an exception, repeatedly until it is handled: for work that is resumable.

    Args:
        interval: time until it is raised again [s]; cleaning up takes less.
    """
    timers: list[threading.Timer] = []

    def raise_interrupt(*_: Any) -> None:
        timers.append(threading.Timer(interval, signal.raise_signal, [signal.SIGINT]))
        timers[-1].daemon = True
        timers[-1].start()
        raise KeyboardInterrupt

    def report_unraisable(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(unraisable)

    hook, sys.unraisablehook = sys.unraisablehook, report_unraisable
    try:
        with handle(raise_interrupt):
            yield
    finally:
        for timer in timers:
            timer.cancel()
        sys.unraisablehook = hook


def say(text: object, err: bool = False) -> None:
    """Write a line of printable characters: no control sequences reach the terminal.

    A closed pipe, as behind ``| head``, is not an error.

    Args:
        text: the line; characters that the encoding of the terminal lacks are written as codes.
        err: write to stderr.
    """
    stream = sys.stderr if err else sys.stdout
    line = "".join(
        character if character.isprintable() or character in "\n\t" else repr(character)[1:-1]
        for character in str(text)
    )
    line = line.encode(stream.encoding or "utf-8", "backslashreplace").decode(
        stream.encoding or "utf-8", "replace"
    )
    try:
        typer.echo(line, err=err)
    except OSError:  # discard its buffer, which would be written again at the end
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def shell_word(path: Path) -> str:
    """A path as a word of a command line, quoted where the shell asks for it.

    Args:
        path: one that begins with a hyphen is no option behind ``./``.
    """
    text = str(path)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


def stop(code: int, message: str, as_json: bool, summary: dict[str, Any] | None = None) -> NoReturn:
    """Exit with a sentence on stderr.

    Args:
        code: exit status.
        message: the sentence.
        as_json: print a JSON object on stdout, too.
        summary: further keys of that object.
    """
    say(f"eoi: {message}", err=True)
    if as_json:
        say(json.dumps({"error": message, **(summary or {})}, allow_nan=False))
    raise typer.Exit(code)


class Commands(TyperGroup):
    """The commands; with --json, errors of usage are JSON objects, too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments before the command.

        Args:
            ctx: context of the call.
            args: its arguments.
        """
        requested = "--debug" in args  # before or after the command
        args = ["--debug"] * requested + [word for word in args if word != "--debug"]
        with _usage_errors_as_json("--json" in args):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Parse the arguments after the command, and run it.

        Args:
            ctx: context of the call.
        """
        with _usage_errors_as_json("--json" in ctx.args):
            return super().invoke(ctx)


@contextmanager
def _usage_errors_as_json(enabled: bool) -> Iterator[None]:
    """Print an error of usage as a JSON object on stdout, besides the message on stderr."""
    try:
        yield
    except _UsageError as error:
        if enabled:
            say(json.dumps({"error": error.format_message()}, allow_nan=False))
        raise


def show(outcome: Outcome, as_json: bool, quiet: bool) -> None:
    """Print an outcome on stdout, and exit with its status.

    Args:
        outcome: of an action.
        as_json: print only its summary, as one JSON object.
        quiet: print only the folder or the file that was written.
    """
    if outcome.place is None:
        stop(outcome.code, outcome.complaint, as_json, outcome.summary)
    if as_json:
        say(json.dumps(outcome.summary, allow_nan=False))
    elif quiet:
        say(outcome.place)
    elif outcome.place.is_dir():
        files = ", ".join(sorted(path.name for path in outcome.place.iterdir()))
        say(f"{outcome.text}\n\n{outcome.place}/: {files}")
        if outcome.replaced:
            say(outcome.replaced)
    else:
        say(outcome.text)
    if outcome.code:
        say(f"eoi: {outcome.complaint}", err=True)
        raise typer.Exit(outcome.code)


@contextmanager
def progress(enabled: bool) -> Iterator[ProgressCallback | None]:
    """A callback that shows the progress on the terminal; None without a terminal.

    Args:
        enabled: false: None in any case.
    """
    if not (enabled and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console  # only needed with a terminal
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[remark]}", markup=False),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, remark="")
        stage = "starting"

        def update(name: str, completed: int, total: int | None, remark: str) -> None:
            nonlocal stage, task
            if name != stage:  # the remaining time is that of a stage: stages differ in speed
                stage = name
                bar.remove_task(task)
                task = bar.add_task(name, total=total, remark=remark)
            bar.update(task, completed=completed, total=total, remark=remark)

        _PROGRESS_BARS.append(bar)
        try:
            yield update
        finally:
            _PROGRESS_BARS.remove(bar)
