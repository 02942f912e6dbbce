"""What the user sees: an answer on stdout, progress and refusals on stderr, the exit status.

Exit status: 0 an answer, 1 no answer (says why), 2 a wrong call, config or data, 130 interrupted.
"""

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

NO_ANSWER, WRONG, INTERRUPTED = 1, 2, 130

_INTERRUPTED = "interrupted; nothing half-written is left"
_AGAIN = 0.5  # seconds; cleaning up takes less
_BARS: list[Any] = []  # that are on the terminal now

_WrongCall: Any = typer.BadParameter.__base__  # whichever click it is that typer is built on

# A stage of the work, how much of it is done, how much there is (None: unknown), a remark.
Shown = Callable[[str, int, int | None, str], None]


@contextmanager
def failures(as_json: bool) -> Iterator[None]:
    """A user's mistake ends in one sentence and status 2, an interrupt in 130: no traceback.

    Args:
        as_json: print the sentence as an object on stdout, too.
    """
    try:
        with _handled(lambda *_: _leave(as_json)):
            yield
    except (ValueError, OSError) as error:
        stop(WRONG, str(error), as_json)
    except MemoryError:
        stop(WRONG, "out of memory; take fewer columns, or a `slice` of the samples", as_json)
    except RuntimeError as error:
        import equinox as eqx  # raised by it, so that it is loaded already

        if not isinstance(error, eqx.EquinoxRuntimeError):
            raise
        stop(WRONG, str(error), as_json)
    except KeyboardInterrupt:
        stop(INTERRUPTED, _INTERRUPTED, as_json)


def _leave(as_json: bool) -> None:
    """End the process here: nothing that is half written stays.

    Not by an exception, which Python drops inside a callback of the garbage collector, of which JAX
    has one, and which can meet JAX's library while that is being loaded.
    """
    for bar in _BARS:
        bar.stop()
    unfinished = sys.modules.get("eoi_jax.unfinished")
    if unfinished is not None and hasattr(unfinished, "tidy"):
        unfinished.tidy()
    with contextlib.suppress(typer.Exit):
        stop(INTERRUPTED, _INTERRUPTED, as_json)
    sys.stdout.flush()
    os._exit(INTERRUPTED)


@contextmanager
def heard() -> Iterator[None]:
    """Ctrl-C as an exception, for work that keeps what it has done; raised until it is heard."""
    again: list[threading.Timer] = []

    def interrupt(*_: Any) -> None:
        again.append(threading.Timer(_AGAIN, signal.raise_signal, [signal.SIGINT]))
        again[-1].daemon = True
        again[-1].start()
        raise KeyboardInterrupt

    def unheard(what: Any) -> None:
        if not isinstance(what.exc_value, KeyboardInterrupt):
            sys.__unraisablehook__(what)

    hook, sys.unraisablehook = sys.unraisablehook, unheard
    try:
        with _handled(interrupt):
            yield
    finally:
        for one in again:
            one.cancel()
        sys.unraisablehook = hook


@contextmanager
def _handled(handler: Callable[..., None]) -> Iterator[None]:
    """Ctrl-C goes to `handler`; only the main thread of a process may say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def stop(code: int, message: str, as_json: bool, summary: dict[str, Any] | None = None) -> NoReturn:
    """End with a sentence on stderr.

    Args:
        code: exit status.
        message: the sentence.
        as_json: print one object on stdout, too.
        summary: further keys of that object.
    """
    typer.echo(f"eoi: {message}", err=True)
    if as_json:
        typer.echo(json.dumps({"error": message, **(summary or {})}, allow_nan=False))
    raise typer.Exit(code)


class Commands(TyperGroup):
    """The commands; of a wrong call, too, a program that asked for JSON gets its object."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read what stands before the command.

        Args:
            ctx: of the call.
            args: its words.
        """
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
            typer.echo(json.dumps({"error": error.format_message()}, allow_nan=False))
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
        typer.echo(json.dumps(ending.summary, allow_nan=False))
    elif quiet:
        typer.echo(ending.place)
    elif ending.place.is_dir():
        files = ", ".join(sorted(path.name for path in ending.place.iterdir()))
        typer.echo(f"{ending.text}\n\n{ending.place}/: {files}")
    else:
        typer.echo(ending.text)
    if ending.code:
        typer.echo(f"eoi: {ending.complaint}", err=True)
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
