"""What the user sees: an answer on stdout, progress and refusals on stderr, the exit status.

Exit status: 0 an answer, 1 no answer (says why), 2 a wrong call, config or data, 130 interrupted.
"""

import contextlib
import json
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from eoi_jax.cli.signals import handled, ignore

NO_ANSWER, WRONG, INTERRUPTED = 1, 2, 130

_INTERRUPTED = "interrupted; nothing half-written is left"
_AGAIN = 0.5  # seconds; cleaning up takes less
_BARS: list[Any] = []  # that are on the terminal now

_DEBUGGED = [False]

_WrongCall: Any = typer.BadParameter.__base__  # whichever click it is that typer is built on
_ClickError: Any = _WrongCall.__base__

# A stage of the work, how much of it is done, how much there is (None: unknown), a remark.
Shown = Callable[[str, int, int | None, str], None]


@contextmanager
def failures(as_json: bool) -> Iterator[None]:
    """A user's mistake ends in one sentence and status 2, an interrupt in 130: no traceback.

    What nobody foresaw ends so, too, and asks to be reported; ``--debug`` lets it through.
    Warnings are a line each.

    Args:
        as_json: print the sentence as an object on stdout, too.
    """
    try:
        with handled(lambda *_: _leave(as_json)), _warnings_said():
            yield
    except (typer.Exit, typer.Abort, _ClickError):
        raise
    except KeyboardInterrupt:
        stop(INTERRUPTED, _INTERRUPTED, as_json)
    except Exception as error:
        if debugged():
            raise
        stop(WRONG, _sentence(error), as_json)


def _sentence(error: Exception) -> str:
    """What an error says to a user: as it stands where it is foreseen."""
    if isinstance(error, MemoryError):
        return "out of memory; take fewer columns, or a `slice` of the samples"
    equinox = sys.modules.get("equinox")  # loaded where it raised
    of_data = equinox is not None and isinstance(error, equinox.EquinoxRuntimeError)
    if isinstance(error, ValueError | OSError) or of_data:
        return str(error)
    return (
        f"an error that should not be ({type(error).__name__}: {error}). Please report it to the "
        "developers of eoi_jax, with what the same command and --debug show"
    )


@contextmanager
def _warnings_said() -> Iterator[None]:
    """Warnings as a line each, at the end and once, without the place in the program.

    ``--debug`` shows them as Python does.
    """
    if debugged():
        yield
        return
    with warnings.catch_warnings(record=True) as caught:
        try:
            yield
        finally:
            for line in dict.fromkeys(_warning(one) for one in caught):
                say(f"note: {line}", err=True)


def _warning(one: warnings.WarningMessage) -> str:
    """What a warning says to a user; NumPy's name an operation, and not what came of it."""
    if issubclass(one.category, RuntimeWarning) and " encountered in " in str(one.message):
        return (
            f"some numbers left the range of double precision ({one.message}): what depends on "
            "them is shown as inf or nan"
        )
    return str(one.message)


def debug(wanted: bool) -> None:
    """Say whether errors are shown with their traceback.

    Args:
        wanted: false where one sentence is enough.
    """
    _DEBUGGED[0] = wanted


def debugged() -> bool:
    """Whether errors are shown with their traceback."""
    return _DEBUGGED[0]


def _leave(as_json: bool) -> None:
    """End the process here: nothing that is half written stays.

    Not by an exception, which Python drops inside a callback of the garbage collector, of which JAX
    has one, and which can meet JAX's library while that is being loaded.
    """
    ignore()
    with contextlib.suppress(Exception):  # the terminal may be closed
        for bar in _BARS:
            bar.stop()
    unfinished = sys.modules.get("eoi_jax._atomic")
    if unfinished is not None and hasattr(unfinished, "tidy"):
        unfinished.tidy()
    with contextlib.suppress(typer.Exit):
        stop(INTERRUPTED, _INTERRUPTED, as_json)
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(INTERRUPTED)


@contextmanager
def heard() -> Iterator[None]:
    """Ctrl-C as an exception, for work that keeps what it has done; raised until it is heard."""
    again: list[threading.Timer] = []

    def raised(*_: Any) -> None:
        again.append(threading.Timer(_AGAIN, signal.raise_signal, [signal.SIGINT]))
        again[-1].daemon = True
        again[-1].start()
        raise KeyboardInterrupt

    def unheard(what: Any) -> None:
        if not isinstance(what.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(what)

    hook, sys.unraisablehook = sys.unraisablehook, unheard
    try:
        with handled(raised):
            yield
    finally:
        for one in again:
            one.cancel()
        sys.unraisablehook = hook


def say(text: object, err: bool = False) -> None:
    """Write a line for a user, of what a terminal shows and nothing that it obeys.

    Nobody may be listening, as behind ``| head``: the answer is what it is all the same.

    Args:
        text: what is said; what is no character of the terminal's encoding appears as its code.
        err: on stderr.
    """
    stream = sys.stderr if err else sys.stdout
    shown = (one if one.isprintable() or one in "\n\t" else repr(one)[1:-1] for one in str(text))
    line = "".join(shown)
    line = line.encode(stream.encoding or "utf-8", "backslashreplace").decode(
        stream.encoding or "utf-8", "replace"
    )
    try:
        typer.echo(line, err=err)
    except OSError:  # what is left in its buffer would be tried again at the end
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def stop(code: int, message: str, as_json: bool, summary: dict[str, Any] | None = None) -> NoReturn:
    """End with a sentence on stderr.

    Args:
        code: exit status.
        message: the sentence.
        as_json: print one object on stdout, too.
        summary: further keys of that object.
    """
    say(f"eoi: {message}", err=True)
    if as_json:
        say(json.dumps({"error": message, **(summary or {})}, allow_nan=False))
    raise typer.Exit(code)


class Commands(TyperGroup):
    """The commands; of a wrong call, too, a program that asked for JSON gets its object."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read what stands before the command.

        Args:
            ctx: of the call.
            args: its words.
        """
        debugged = "--debug" in args  # before the command or behind it
        args = ["--debug"] * debugged + [one for one in args if one != "--debug"]
        with _told_as_json("--json" in args):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Read what stands behind the command, and run it.

        Args:
            ctx: of the call.
        """
        with _told_as_json("--json" in ctx.args):
            return super().invoke(ctx)


@contextmanager
def _told_as_json(wanted: bool) -> Iterator[None]:
    """A wrong call as an object on stdout, beside what is said of it on stderr."""
    try:
        yield
    except _WrongCall as error:
        if wanted:
            say(json.dumps({"error": error.format_message()}, allow_nan=False))
        raise


def show(ending: Any, as_json: bool, quiet: bool) -> None:
    """The answer on stdout, as a reader or as a program wants it; then the exit status.

    Args:
        ending: an `eoi_jax.cli.Ending`.
        as_json: its summary as one object, and nothing else.
        quiet: only the folder or the file that was written.
    """
    if ending.place is None:
        stop(ending.code, ending.complaint, as_json, ending.summary)
    if as_json:
        say(json.dumps(ending.summary, allow_nan=False))
    elif quiet:
        say(ending.place)
    elif ending.place.is_dir():
        files = ", ".join(sorted(path.name for path in ending.place.iterdir()))
        say(f"{ending.text}\n\n{ending.place}/: {files}")
    else:
        say(ending.text)
    if ending.code:
        say(f"eoi: {ending.complaint}", err=True)
        raise typer.Exit(ending.code)


@contextmanager
def progress(wanted: bool) -> Iterator[Shown | None]:
    """A callback that shows the work on the terminal; None where there is no terminal.

    Args:
        wanted: false for none.
    """
    if not (wanted and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console  # only where there is a terminal to draw on
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

        def shown(name: str, done: int, total: int | None, remark: str) -> None:
            nonlocal stage, task
            if name != stage:  # the time left is that of a stage: stages differ in their speed
                stage = name
                bar.remove_task(task)
                task = bar.add_task(name, total=total, remark=remark)
            bar.update(task, completed=done, total=total, remark=remark)

        _BARS.append(bar)
        try:
            yield shown
        finally:
            _BARS.remove(bar)
