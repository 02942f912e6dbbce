"""The folder of a run: its records and model from a config, its files, its model from the files."""

import csv
import errno
import json
import re
import shlex
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._atomic import make_draft, sweep_up, tidied, write_files
from eoi_jax._checks import RecordWarning, check
from eoi_jax.cli import build
from eoi_jax.cli.config import Config
from eoi_jax.cli.config import load as load_config
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.controller import Controller
from eoi_jax.models.equations.display import equation_latex
from eoi_jax.models.plant import Plant
from eoi_jax.models.storage import has_all_functions, load, save
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import discovery_figures
from eoi_jax.report.discovery import discovery_text
from eoi_jax.report.drawing import save_figure
from eoi_jax.report.figures import identification_figure
from eoi_jax.report.free_runs import free_run_series, prediction_series, validation_runs
from eoi_jax.report.residual_correlation import residual_correlation_figure
from eoi_jax.report.saved_models import labelled
from eoi_jax.report.sweep import sweep_figure
from eoi_jax.report.time_series import time_series_figure
from eoi_jax.simulation.closed_loop import closed_loop
from eoi_jax.simulation.validation import Validation

RESULT = "result.npz"  # the result, for `eoi_jax.load`
REPORT_DATA = "report.npz"  # further data of the report
SWEEP = "sweep.json"
_RUN_FIRST = "Run `eoi identify`, `eoi refine` or `eoi discover` first, and give its folder."


@dataclass(frozen=True)
class Loop:
    """The controller of a config, for free runs.

    Attributes:
        controller: of the plant.
        records: for the fit, with the references among their inputs.
        held_out: for validation, likewise; may be empty.
    """

    controller: Controller
    records: list[Record]
    held_out: list[Record]


@dataclass(frozen=True)
class Job:
    """The model and the records of a config.

    Attributes:
        settings: the config.
        model: the plant with its nominal parameters.
        records: for the fit, with the inputs of the plant.
        held_out: for validation; may be empty.
        loop: the controller; None: the recorded inputs drive all runs.
        test: records on which a discovery chooses nothing; may be empty.
    """

    settings: Config
    model: Plant
    records: list[Record]
    held_out: list[Record]
    loop: Loop | None = None
    test: Sequence[Record] = ()


@contextmanager
def quiet_records() -> Iterator[None]:
    """Suppress warnings about records: they are in the notes of the result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        yield


def job(settings: Config, folder: Path, data: Path | None) -> Job:
    """The plant and the records of a config.

    Args:
        settings: the config.
        folder: of the config.
        data: folder of measured files; None: `folder`, else $EOI_DATA.

    Raises:
        ValueError: files or names of the config do not exist or do not match, a controller that is
            not that of the records.
    """
    with quiet_records():
        model = build.plant(settings, folder)
        records = build.records(settings, model, folder, data)
        held_out = build.validation_records(settings, model, folder, data)
        test = build.unseen_records(settings, model, folder, data)
    controller = build.controller(settings, model, folder, records[0].sample_period)
    if controller is None:
        return Job(settings, model, records, held_out, test=test)
    originals = list(closed_loop(model, [*records, *held_out, *test], controller).originals)
    loop, count, chosen = Loop(controller, records, held_out), len(records), len(originals)
    chosen -= len(test)
    held_out, test = originals[count:chosen], originals[chosen:]
    return Job(settings, model, originals[:count], held_out, loop, test)


def check_place(folder: Path, field: str) -> None:
    """Check that the folder of a run can be written, by creating and removing a draft.

    Leftovers of processes that were killed are removed or restored.

    Args:
        folder: of the run, in that of ``--output``; it is not changed.
        field: the field that gives its name.

    Raises:
        ValueError: it cannot be created or written.
    """
    folder = folder.resolve() if folder.is_symlink() else folder  # which is written, not the link
    created: list[Path] = []

    def undo() -> None:
        for path in reversed(created):
            with suppress(OSError):
                path.rmdir()

    with tidied(undo):
        for path in (*reversed(folder.parents), folder):
            try:
                if path is folder:
                    sweep_up(folder.parent)
                    created.append(make_draft(folder))
                elif not path.is_dir():
                    created.append(path)
                    path.mkdir()
            except OSError as error:
                too_long = path is folder and error.errno == errno.ENAMETOOLONG
                check(
                    not too_long,
                    field,
                    "must be short enough for a folder name",
                    folder.name,
                )
                is_file = isinstance(error, FileExistsError)
                cause = f"{path} is a file" if is_file else error.strerror
                rule = f"must be a folder that can be created and written ({cause})"
                check(False, "--output", rule, folder.parent)


# -- as files ---------------------------------------------------------------------------------


def write_identification(
    folder: Path,
    result: Identification,
    validation: Validation | None,
    summary: dict[str, Any],
    config: str,
) -> None:
    """`result.json`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Parameters over time, where asked for, as `history.csv` and `history.png`.

    Args:
        folder: an empty folder.
        result: of `identify`.
        validation: on the held-out records, if there are any.
        summary: of `identification_summary`.
        config: text of the config below the command of the run.
    """
    _write_json(folder / "result.json", summary)
    save_figure(folder / "figure.png", lambda: identification_figure(result))
    result.save(folder / RESULT)
    save({"diagnosis": diagnose(result), "validation": validation}, folder / REPORT_DATA)
    if result.history is not None:
        _write(folder / "history.csv", result.history.to_pandas().to_csv())
        save_figure(folder / "history.png", result.history.plot)
    _write(folder / "config.toml", config)


def write_refinement(
    folder: Path,
    result: Refinement,
    extra: dict[str, Any],
    summary: dict[str, Any],
    text: str,
    config: str,
) -> None:
    """`result.json`, `report.txt`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Args:
        folder: an empty folder.
        result: of `refine`.
        extra: ``start``, the identification that it started from; ``before`` and ``after``, free
            runs on the held-out records, or None.
        summary: of `refinement_summary`.
        text: of `refinement_text`.
        config: text of the config below the command of the run.
    """
    _write_json(folder / "result.json", summary)
    _write(folder / "report.txt", text + "\n")
    save_figure(folder / "figure.png", result.plot)
    result.save(folder / RESULT)
    save({**extra, "diagnosis": diagnose(extra["start"])}, folder / REPORT_DATA)
    _write(folder / "config.toml", config)


def write_discovery(folder: Path, result: Discovery, summary: dict[str, Any], config: str) -> None:
    """`discovery.json`, `report.txt`, `equation.tex`, three figures, two `.npz`, `config.toml`.

    Args:
        folder: an empty folder.
        result: of `discover`.
        summary: of `discovery_summary`.
        config: text of the config below the command of the run.
    """
    _write_json(folder / "discovery.json", summary)
    _write(folder / "report.txt", discovery_text(result) + "\n")
    model = result.declared_part
    forms = (equation_latex(model, result.added, numeric=numeric) for numeric in (False, True))
    tex = "\n\n".join(f"\\[\n{form}\n\\]" for form in forms)
    _write(folder / "equation.tex", tex + "\n")
    for name, draw in discovery_figures.PARTS.items():
        save_figure(folder / f"{name}.png", partial(draw, result))
    result.save(folder / RESULT)
    diagnosis = (
        result.diagnosis if result.diagnosis and not result.added else diagnose(result.found)
    )
    save({"diagnosis": diagnosis}, folder / REPORT_DATA)
    _write(folder / "config.toml", config)


def write_sweep(
    folder: Path, result: Any, best: Any, summary: dict[str, Any], text: str, config: str
) -> None:
    """`sweep.json`, `report.txt`, `figure.png` and `config.toml` in the folder of a sweep.

    Args:
        folder: of the run, with the store; each file is written all or nothing.
        result: of `sweep`.
        best: its best lane, or None.
        summary: of `sweep_summary`.
        text: of `sweep_text`.
        config: text of the config below the command of the run.
    """

    def fill(draft: Path) -> None:
        _write_json(draft / SWEEP, summary)
        _write(draft / "report.txt", text + "\n")
        save_figure(draft / "figure.png", lambda: sweep_figure(result, best))
        _write(draft / "config.toml", config)

    write_files(folder, SWEEP, fill)


def write_inspection(
    folder: Path, inspection: Inspection, summary: dict[str, Any], text: str
) -> None:
    """`inspect.json`, `inspect.txt` and `inspect.png`.

    Args:
        folder: an empty folder.
        inspection: of `inspect`.
        summary: of its method `summary`.
        text: of `inspection_text`.
    """
    _write_json(folder / "inspect.json", summary)
    _write(folder / "inspect.txt", text + "\n")
    save_figure(folder / "inspect.png", inspection.plot)


def write_free_runs(
    folder: Path,
    name: str,
    runs: Sequence[tuple[str, Validation]],
    summary: dict[str, Any],
    text: str,
    dates: Sequence[tuple[str, Any]] = (),
) -> None:
    """``<name>.json``, ``<name>.txt``, and for each record ``<name>.png``, ``correlation.png``.

    Of a single model also ``prediction.csv``: time [s] and outputs of its free run at all samples,
    measured or not; empty where an input is unknown; and the dates of the file, in its last column.

    Args:
        folder: an empty folder.
        name: of the command.
        runs: name of each model, and its free runs on the same records.
        summary: of `validation_summary` or `comparison_summary`.
        text: its table.
        dates: of time zero of each record, with the names of their columns, as of `dates_of_zero`.
    """
    _write_json(folder / f"{name}.json", summary)
    _write(folder / f"{name}.txt", text + "\n")
    for i in range(len(runs[0][1].predictions)):
        suffix = f"_{i + 1}" if i else ""
        content = validation_runs(*labelled(runs), record=i)
        series = free_run_series(content)
        save_figure(folder / f"{name}{suffix}.png", partial(time_series_figure, series))
        correlation = partial(residual_correlation_figure, content)
        save_figure(folder / f"correlation{suffix}.png", correlation)
        if len(runs) == 1:
            result, path = runs[0][1], folder / f"prediction{suffix}.csv"
            channels = list(zip(result.outputs, result.units, strict=True))
            prediction = result.predictions[i]
            date = dates[i] if dates else ("", None)
            _write_columns(path, prediction, channels, prediction.known_outputs, date)


def write_prediction(
    folder: Path, record: Record, summary: dict[str, Any], text: str, date: tuple[str, Any]
) -> None:
    """`predict.json`, `predict.txt`, `prediction.csv` and `prediction.png`.

    Args:
        folder: an empty folder.
        record: of `simulate`.
        summary: of `prediction_summary`.
        text: what was predicted, and from where.
        date: name of the column of time, and the date of time zero, as of `dates_of_zero`.
    """
    _write_json(folder / "predict.json", summary)
    _write(folder / "predict.txt", text + "\n")
    columns = np.column_stack([record.inputs, record.outputs])
    names = (*record.input_names, *record.output_names)
    pairs = [(name, record.units.get(name, "")) for name in names]
    _write_columns(folder / "prediction.csv", record, pairs, columns, date)
    series = prediction_series(record)
    save_figure(folder / "prediction.png", partial(time_series_figure, series))


def _write_columns(
    path: Path,
    record: Record,
    channels: Sequence[tuple[str, str]],
    columns: np.ndarray,
    date: tuple[str, Any],
) -> None:
    """Time of a record and columns (N, n), whose names and units are `channels`; empty for NaN.

    Behind them the stamps as dates, if the file has dates.
    """
    names = ["time [s]", *(f"{name} [{unit}]" if unit else name for name, unit in channels)]
    rows = np.column_stack([record.time, columns])
    lines = [["" if np.isnan(value) else f"{value:.10g}" for value in row] for row in rows]
    key, zero = date
    if key:
        elapsed = np.rint(1e3 * record.time).astype("timedelta64[ms]")
        stamps = np.datetime_as_string(zero.astype("datetime64[ms]") + elapsed)
        names.append(key)
        lines = [[*line, stamp] for line, stamp in zip(lines, stamps.tolist(), strict=True)]
    with path.open("w", encoding="utf-8", errors="backslashreplace", newline="") as file:
        csv.writer(file).writerows([names, *lines])


def _write_json(path: Path, summary: dict[str, Any]) -> None:
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
    _write(path, text + "\n")


def _write(path: Path, text: str) -> None:
    """Write in UTF-8; invalid characters, as in a file name, as escapes."""
    path.write_text(text, encoding="utf-8", errors="backslashreplace")


# -- from files -------------------------------------------------------------------------------


def result_of_run(run: Path, trust: bool = False) -> Any:
    """The stored result of a run, with its model; or the plant, where only that is stored.

    It is read from the stored result. Only a function in a Python file is not stored.

    Args:
        run: its folder, or a file: a saved result, or a model exported as JSON.
        trust: whether such a Python file, named in the config of the run, may be executed.

    Returns:
        An `Identification`, `Refinement` or `Discovery`, or the plant with its estimate.

    Raises:
        ValueError: no such run, an interrupted run, files that were edited, or a model in a Python
            file that is missing or not trusted.
    """
    if not run.exists():
        sweep_up(run.parent)  # restores a run whose replacement was interrupted
    default = Path("runs") / run
    advice = f"Did you mean {default}?" if default.is_dir() else _RUN_FIRST
    check(run.exists(), "run", "must be a folder or a file that exists", run, advice)
    if run.is_file():
        return _with_model(load(run), run)
    config = run / "config.toml"
    check(config.is_file(), "run", "must be the folder of a finished run", run, _RUN_FIRST)
    stored = run / RESULT
    if stored.is_file():
        result = _with_model(load(stored), stored)
        if has_all_functions(_model_of(result)):
            return result
        return _with_model(load(stored, plant=_declared(config, trust)), stored)
    summary = run / "result.json"
    rule = "must hold result.npz or result.json"
    check(summary.is_file(), "run", rule, run, "A sweep has no single model. " + _RUN_FIRST)
    declared = _declared(config, trust)
    try:
        values = json.loads(summary.read_text(encoding="utf-8"))["parameters"]
        return declared.with_parameters({name: float(value) for name, value in values.items()})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"`run` must hold a result.json that this library wrote: {error}"
        ) from None


def held_out_of_run(run: Path) -> tuple[Record, ...]:
    """The records on which a run judged its answer, as stored; empty where none were held out.

    Args:
        run: its folder, or a saved result, which has none.
    """
    result = load(run / RESULT) if (run / RESULT).is_file() else None
    if isinstance(result, Discovery):
        return () if result.in_sample else result.held_out
    extra = load(run / REPORT_DATA) if (run / REPORT_DATA).is_file() else {}
    stored = extra.get("validation") or extra.get("after")
    return stored.records if isinstance(stored, Validation) else ()


def _model_of(result: Any) -> Any:
    return result if isinstance(result, Plant) else getattr(result, "plant", None)


def _with_model(result: Any, path: Path) -> Any:
    check(isinstance(_model_of(result), Plant), "run", "must contain a model", path)
    return result


def _declared(copy: Path, trust: bool) -> Plant:
    """The declared model; a Python file is relative to the original of the copied config."""
    settings = load_config(copy)
    check(
        trust or ":" not in (settings.plant or ""),
        "run",
        "must hold its complete model",
        f"{copy.parent}, whose model is a function in {settings.plant}",
        "Check this file; --trust executes it.",
    )
    return build.plant(settings, folder_of(copy))


def folder_of(config: Path) -> Path:
    """The folder to which the files that a config names are relative.

    That of the config; of the copy in the folder of a run, that of the original, named by the
    command in its first line relative to the working folder of that time. It is looked for in the
    parents of the folder of the run, as by default, and in the current one. The copy of a copy has
    two such lines.

    Args:
        config: its path.
    """
    if not _is_run(config.parent):
        return config.parent
    bases = (*config.resolve().parents, Path.cwd())
    for line in config.read_text(encoding="utf-8-sig").splitlines():
        named = _configs_of_command(line)
        if not named:
            break
        for original in (base / name for base in bases for name in named):
            if original.is_file() and not _is_run(original.parent):
                return original.parent
    return config.parent


def _configs_of_command(line: str) -> list[str]:
    """The config that a command line names: quoted for the shell, or as earlier versions wrote."""
    command = re.match(r"# eoi \w+ (.*\.toml)", line)
    if command is None:
        return []
    with suppress(ValueError):  # a quotation mark without another
        return [shlex.split(line[1:])[2], command[1]]
    return [command[1]]


def _is_run(folder: Path) -> bool:
    return any((folder / name).is_file() for name in (RESULT, "result.json", SWEEP))
