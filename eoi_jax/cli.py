"""The command ``eoi``: a config in; a table, figures and a JSON file out.

Exit status: 0 an answer, 1 no answer (says why), 2 a wrong call, config or data, 130 interrupted.
"""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Annotated, Any, NoReturn

import equinox as eqx
import msgspec
import numpy as np
import typer

from eoi_jax import backend, build, runs
from eoi_jax import config as configs
from eoi_jax.batch.best import best
from eoi_jax.checks import check
from eoi_jax.discover import discover as run_discovery
from eoi_jax.discovery import Discovery
from eoi_jax.identify import Identification
from eoi_jax.identify import identify as run_passes
from eoi_jax.refine import refine as run_refinement
from eoi_jax.refinement import Refinement
from eoi_jax.report.discovery import answer, discovery_text
from eoi_jax.report.sweep import sweep_text
from eoi_jax.report.tables import identification_text, refinement_text
from eoi_jax.sweep import sweep as run_sweep
from eoi_jax.validate import Validation, validate

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

_NO_ANSWER, _WRONG, _INTERRUPTED = 1, 2, 130
# Ends of a discovery that are worth a folder.
_ANSWERS = ("explained", "nothing_missing", "unexplained")


def main() -> None:
    """The entry point of the ``eoi`` command."""
    app()


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"eoi_jax {version_of('eoi_jax')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Identify a plant, and find what its model lacks, from the equivalent output injection."""
    del version


Source = Annotated[Path | None, typer.Argument(help="TOML file; left out: the built-in pendulum.")]
Data = Annotated[
    Path | None,
    typer.Option(help="Folder of measured files; else $EOI_DATA, else the config's folder."),
]
Output = Annotated[Path, typer.Option(help="Folder that the run's folder goes into.")]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print only the run's folder.")]
_RUNS = Path("runs")


@app.command()
def identify(
    config: Source = None,
    data: Data = None,
    output: Output = _RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
    passes: Annotated[int | None, typer.Option(min=1, help="Instead of the config's.")] = None,
) -> None:
    """Identify a plant's parameters from simulated or measured records."""
    with _failures(as_json):
        backend.configure()
        source = config or _default_config("pendulum")
        _check_output(output)
        given = runs.job(_settings(source, passes), source.parent, data)
        with _progress(not quiet) as callback, runs.quiet_records():
            result, validation = _identified(given, callback)
        summary = runs.identification_summary(given, result, validation)
        if not result.status.ok:
            _stop(_NO_ANSWER, f"no answer ({result.status})", as_json, summary)
        folder = output / given.settings.name
        option = "" if passes is None else f" --passes {passes}"
        text = _with_command(f"eoi identify {source}{option}", source)
        runs.publish(folder, lambda draft: runs.write_identification(draft, result, summary, text))
    lines = [identification_text(result), "" if validation is None else str(validation)]
    _show(folder, "\n\n".join(filter(None, lines)), summary, as_json, quiet)


@app.command()
def discover(
    config: Annotated[
        Path | None, typer.Argument(help="TOML file; left out: the built-in example.")
    ] = None,
    data: Data = None,
    output: Output = _RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Find what a plant's model lacks: name the effect, add it, compare before and after."""
    with _failures(as_json):
        backend.configure()
        source = config or _default_config("hidden_friction")
        _check_output(output)
        given = runs.job(configs.load(source), source.parent, data)
        with runs.quiet_records():
            result = _discovered(given)
        summary = runs.discovery_summary(given, result)
        if not (result.status.ok or result.status.code in _ANSWERS):
            _stop(_NO_ANSWER, f"no answer ({result.status})", as_json, summary)
        folder = output / given.settings.name
        text = _with_command(f"eoi discover {source}", source)
        runs.publish(folder, lambda draft: runs.write_discovery(draft, result, summary, text))
    _show(folder, discovery_text(result), summary, as_json, quiet)
    if result.status.code == "unexplained":
        # The maps of the residual are written all the same: they are what is known.
        typer.echo(f"eoi: {answer(result)}", err=True)
        raise typer.Exit(_NO_ANSWER)


@app.command()
def refine(
    config: Source = None,
    data: Data = None,
    output: Output = _RUNS,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Identify, then fit the free run itself: output error, with what it is sure of."""
    with _failures(as_json):
        backend.configure()
        source = config or _default_config("pendulum")
        _check_output(output)
        given = runs.job(configs.load(source), source.parent, data)
        with _progress(not quiet) as callback, runs.quiet_records():
            start, before = _identified(given, callback)
            if not start.status.ok:
                summary = runs.identification_summary(given, start, before)
                _stop(_NO_ANSWER, f"nothing to refine ({start.status})", as_json, summary)
            result, after = _refined(given, start)
        summary = runs.refinement_summary(given, start, before, result, after)
        if not result.status.ok:
            _stop(_NO_ANSWER, f"no answer ({result.status})", as_json, summary)
        folder = output / given.settings.name
        text = refinement_text(result, before, after)
        copy = _with_command(f"eoi refine {source}", source)
        runs.publish(
            folder, lambda draft: runs.write_refinement(draft, result, summary, text, copy)
        )
    _show(folder, text, summary, as_json, quiet)


@app.command()
def sweep(
    config: Annotated[
        Path | None, typer.Argument(help="TOML file; left out: the built-in example.")
    ] = None,
    data: Data = None,
    output: Output = _RUNS,
    part: Annotated[
        str, typer.Option(help="i/n: every n-th chunk from the i-th (0 … n-1), for a job array.")
    ] = "0/1",
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> None:
    """Try many gains, filters, starts and resamples; interrupted, the same command goes on."""
    with _failures(as_json):
        backend.configure()
        source = config or _default_config("pendulum_sweep")
        _check_output(output)
        given = runs.job(configs.load(source), source.parent, data)
        folder = output / given.settings.name
        with runs.quiet_records():
            result = run_sweep(
                given.model,
                given.records,
                **build.sweep(given.settings, given.model),
                store=folder / "sweep.zarr",
                part=_part(part),
                progress=not quiet and sys.stderr.isatty(),
            )
            done = bool(result["ok"].any())
            chosen = best(result, given.model, given.held_out or None) if done else None
        summary = runs.sweep_summary(given, result, chosen)
        text = sweep_text(result, chosen)
        runs.write_sweep(
            folder, result, summary, text, _with_command(f"eoi sweep {source}", source)
        )
    if not result.attrs["finished"]:
        ended = summary["statuses"].get("not_run", 0)
        message = f"interrupted with {ended} of {summary['lanes']} lanes left"
        _stop(_INTERRUPTED, f"{message}; the same command goes on from there", as_json, summary)
    if chosen is None:
        _stop(_NO_ANSWER, f"no answer: {text}", as_json, summary)
    _show(folder, text, summary, as_json, quiet)


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    check(number.isdigit() and count.isdigit(), "--part", "must be i/n, such as 0/10", text)
    return int(number), int(count)


# -- the run ----------------------------------------------------------------------------------


def _default_config(name: str) -> Path:
    """A shipped config: inside an installed package, beside it in a source tree."""
    package = Path(__file__).parent
    candidates = [package / "configs", package.parent / "configs"]
    return next((one for one in candidates if one.is_dir()), candidates[0]) / f"{name}.toml"


def _check_output(output: Path) -> None:
    check(not output.exists() or output.is_dir(), "--output", "must be a folder", output)


def _settings(source: Path, passes: int | None) -> configs.Config:
    settings = configs.load(source)
    if passes is None:
        return settings
    table = msgspec.structs.replace(settings.identify, passes=passes)
    return msgspec.structs.replace(settings, identify=table)


def _identified(
    given: runs.Job, callback: Callable[[int, int, Any], None] | None
) -> tuple[Identification, Validation | None]:
    """The passes, and the held-out error of what they end with."""
    table = given.settings.identify
    result = run_passes(
        given.model,
        given.records,
        build.observer(given.settings),
        build.lowpass(given.settings),
        table.passes,
        transient=table.transient,
        substeps=table.substeps,
        smoothing=table.smoothing,
        instruments=table.instruments,
        callback=callback,
    )
    known = result.status.ok and given.held_out
    return result, validate(result.plant, given.held_out) if known else None


def _discovered(given: runs.Job) -> Discovery:
    """Fit, search, add, fit again."""
    table = given.settings.discover
    return run_discovery(
        given.model,
        given.records,
        validation=given.held_out or None,
        effects=build.effects(given.settings),
        lowpass=build.lowpass(given.settings),
        alpha=table.alpha,
        most=table.most,
        window=table.window,
    )


def _refined(given: runs.Job, start: Identification) -> tuple[Refinement, Validation | None]:
    """Output error from the estimate of the passes on, and its held-out error."""
    table = given.settings.refine
    result = run_refinement(
        start,
        given.records,
        window=table.window,
        substeps=table.substeps,
        max_steps=table.max_steps,
    )
    known = result.status.ok and given.held_out
    return result, validate(result.plant, given.held_out) if known else None


# -- what the user sees -----------------------------------------------------------------------


@contextmanager
def _progress(show: bool) -> Iterator[Callable[[int, int, Any], None] | None]:
    """A callback that shows each pass on the terminal; None where there is no terminal."""
    if not (show and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console  # only where there is a terminal to draw on
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[index]}"),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("pass", total=None, index="reading and compiling")

        def shown(number: int, passes: int, index: Any) -> None:
            values = "  ".join(f"{value:.3g}" for value in np.atleast_1d(index))
            bar.update(task, completed=number, total=passes, index=f"P = {values}")

        yield shown


@contextmanager
def _failures(as_json: bool) -> Iterator[None]:
    """A user's mistake ends in one sentence and status 2, never in a traceback."""
    try:
        yield
    except (ValueError, OSError, eqx.EquinoxRuntimeError) as error:
        _stop(_WRONG, str(error), as_json)
    except KeyboardInterrupt:
        _stop(_INTERRUPTED, "interrupted; nothing was written", as_json)


def _stop(
    code: int, message: str, as_json: bool, summary: dict[str, Any] | None = None
) -> NoReturn:
    typer.echo(f"eoi: {message}", err=True)
    if as_json:
        typer.echo(json.dumps({"error": message, **(summary or {})}, allow_nan=False))
    raise typer.Exit(code)


def _show(folder: Path, text: str, summary: dict[str, Any], as_json: bool, quiet: bool) -> None:
    """The answer on stdout, as a reader or as a program wants it."""
    if as_json:
        typer.echo(json.dumps(summary, allow_nan=False))
    elif quiet:
        typer.echo(folder)
    else:
        files = ", ".join(sorted(path.name for path in folder.iterdir()))
        typer.echo(f"{text}\n\n{folder}/: {files}")


def _with_command(command: str, source: Path) -> str:
    """The config's text under the command that it was run by."""
    config = source.read_text(encoding="utf-8")
    return f"# {command}\n{config}"
