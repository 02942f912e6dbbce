"""The command ``eoi``: a config in, a table, a figure and a JSON file out.

Exit status: 0 an answer, 1 no answer (says why), 2 a wrong call, config or data, 130 interrupted.
"""

import json
import platform
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Annotated, Any, NoReturn

import equinox as eqx
import jax
import msgspec
import numpy as np
import typer

from eoi_jax import backend, build
from eoi_jax import config as configs
from eoi_jax.checks import RecordWarning, check
from eoi_jax.data.record import Record
from eoi_jax.identify import Identification
from eoi_jax.identify import identify as run_passes
from eoi_jax.report.tables import identification_text
from eoi_jax.validate import Validation, validate

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

_NO_ANSWER, _WRONG, _INTERRUPTED = 1, 2, 130


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
    """Identify the parameters of a plant from the equivalent output injection."""
    del version


@app.command()
def identify(
    config: Annotated[
        Path | None, typer.Argument(help="TOML file; left out: the built-in pendulum.")
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder of measured files; else $EOI_DATA, else the config's folder."),
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder that the run's folder goes into.")] = Path(
        "runs"
    ),
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print only the run's folder.")] = False,
    passes: Annotated[int | None, typer.Option(min=1, help="Instead of the config's.")] = None,
) -> None:
    """Identify a plant's parameters from simulated or measured records."""
    with _failures(as_json):
        backend.configure()
        source = config or _default_config()
        check(not output.exists() or output.is_dir(), "--output", "must be a folder", output)
        settings = _settings(source, passes)
        with _progress(not quiet) as callback:
            result, validation, summary = _answer(settings, source, data, callback)
        if not result.status.ok:
            _stop(_NO_ANSWER, f"no answer ({result.status})", as_json, summary)
        folder = output / settings.name
        _publish(folder, lambda draft: _write(draft, result, summary, source, passes))
    if as_json:
        typer.echo(json.dumps(summary, allow_nan=False))
    elif quiet:
        typer.echo(folder)
    else:
        lines = [identification_text(result), "" if validation is None else str(validation)]
        typer.echo("\n\n".join(filter(None, lines)))
        typer.echo(f"\n{folder}/: result.json, figure.png, config.toml")


# -- the run ----------------------------------------------------------------------------------


def _default_config() -> Path:
    """The pendulum's config: inside an installed package, beside it in a source tree."""
    package = Path(__file__).parent
    candidates = [package / "configs", package.parent / "configs"]
    return next((one for one in candidates if one.is_dir()), candidates[0]) / "pendulum.toml"


def _settings(source: Path, passes: int | None) -> configs.Config:
    settings = configs.load(source)
    if passes is None:
        return settings
    table = msgspec.structs.replace(settings.identify, passes=passes)
    return msgspec.structs.replace(settings, identify=table)


def _answer(
    settings: configs.Config,
    source: Path,
    data: Path | None,
    callback: Callable[[int, int, Any], None] | None,
) -> tuple[Identification, Validation | None, dict[str, Any]]:
    """Records, passes, held-out error; and everything as one JSON object."""
    with warnings.catch_warnings():
        # What was done to a record is in its notes, and the notes are in the result.
        warnings.simplefilter("ignore", RecordWarning)
        model = build.plant(settings, source.parent)
        records = build.records(settings, model, source.parent, data)
        held_out = build.validation_records(settings, model, source.parent, data)
        table = settings.identify
        result = run_passes(
            model,
            records,
            build.observer(settings),
            build.lowpass(settings),
            table.passes,
            transient=table.transient,
            substeps=table.substeps,
            smoothing=table.smoothing,
            callback=callback,
        )
        known = result.status.ok and held_out
        validation = validate(result.plant, held_out) if known else None
    return result, validation, _summary(settings, result, records, held_out, validation)


def _summary(
    settings: configs.Config,
    result: Identification,
    records: list[Record],
    held_out: list[Record],
    validation: Validation | None,
) -> dict[str, Any]:
    summary = {
        "name": settings.name,
        "status": {"code": result.status.code, "message": result.status.message},
        "parameters": result.parameters,
        "standard_errors": result.standard_errors,
        "nominal": result.nominal.parameters,
        "units": result.plant.units,
        "outputs": result.plant.outputs,
        "index": result.index,
        "increments": result.increments,
        "best_pass": result.best_pass + 1,
        "sliding_fraction": result.sliding_fraction,
        "observer": result.observer,
        "lowpass": result.lowpass,
        "reasons": result.reasons,
        "notes": result.notes,
        "records": [_described(record) for record in records],
        "held_out_records": [_described(record) for record in held_out],
        "validation": None if validation is None else _errors(validation),
        "config": msgspec.to_builtins(settings),
        "versions": _versions(),
    }
    return _plain(summary)


def _errors(validation: Validation) -> dict[str, Any]:
    """Free-run errors by output."""
    by_output = {
        error: dict(zip(validation.outputs, getattr(validation, error), strict=True))
        for error in ("rmse", "nrmse", "fit")
    }
    return {**by_output, "scored": validation.scored, "notes": validation.notes}


def _described(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "samples": len(record.time),
        "sample_period": record.sample_period,
        "hash": record.data_hash,
        "notes": record.notes,
    }


def _versions() -> dict[str, str]:
    return {
        "eoi_jax": version_of("eoi_jax"),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def _plain(value: Any) -> Any:
    """JSON's own types; a number that JSON does not have (NaN, infinity) becomes null."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, eqx.Module):
        return {"kind": type(value).__name__, **_plain(vars(value))}
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return _plain(np.asarray(value).tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


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


# -- what is written --------------------------------------------------------------------------


def _write(
    folder: Path, result: Identification, summary: dict[str, Any], source: Path, passes: int | None
) -> None:
    from eoi_jax.report.figures import identification_figure

    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
    (folder / "result.json").write_text(text + "\n", encoding="utf-8")
    identification_figure(result).savefig(folder / "figure.png")
    option = "" if passes is None else f" --passes {passes}"
    config = source.read_text(encoding="utf-8")
    (folder / "config.toml").write_text(
        f"# eoi identify {source}{option}\n{config}", encoding="utf-8"
    )


def _publish(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make `folder` by `fill`, all or nothing; one that is there is replaced at the very end."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    new, old = draft / "new", draft / "old"
    try:
        new.mkdir()
        fill(new)
        if folder.exists():
            folder.rename(old)
        new.rename(folder)
    finally:
        if old.exists() and not folder.exists():
            old.rename(folder)
        shutil.rmtree(draft, ignore_errors=True)
