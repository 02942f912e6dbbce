"""Actions of the commands of ``eoi``: from a config to a table, figures and a JSON file.

An action prints nothing: it returns an `Outcome`, which `terminal.show` prints.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from eoi_jax import cli
from eoi_jax._atomic import link, write_file, write_folder
from eoi_jax._checks import check, counted, is_or_are
from eoi_jax._status import Status
from eoi_jax.cli import build, html_report, run_files, run_folder
from eoi_jax.cli.built_in import built_in, built_in_names
from eoi_jax.cli.config import Config, IdentifyTable, load
from eoi_jax.cli.signals import ExitCode
from eoi_jax.cli.summary import (
    discovery_summary,
    identification_summary,
    refinement_summary,
    sweep_summary,
)
from eoi_jax.cli.terminal import Outcome, ProgressCallback, shell_word
from eoi_jax.compiler import jax_setup
from eoi_jax.data.holds import made_alike
from eoi_jax.data.inspection import inspect as inspect_file
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.data.record import Record
from eoi_jax.data.record_notes import record_notes
from eoi_jax.data.wrapped_outputs import wrapped_notes
from eoi_jax.discovery.discover import discover as run_discovery
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation import sweep as sweeps
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.identify import identify as run_passes
from eoi_jax.refinement.refine import refine as run_refinement
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.discovery import answer, discovery_text
from eoi_jax.report.sweep import sweep_text
from eoi_jax.report.tables import identification_text, refinement_text
from eoi_jax.simulation.validate import validate, validated_alike
from eoi_jax.simulation.validation import Validation

_NOT_IN_LOOP = "[controller] is not in the loop: the recorded inputs drive {}"
_NOT_TESTED = "[test] is not used: `eoi validate` judges a saved model on other records"
_HOLD_ZERO = "hold zero for all inputs: [controller] holds them between samples"
_MORE_STARTS = "`starts = 200` under [refine] tries that many points around the nominal values"
_UNDETERMINED = (
    "no parameter has a standard error below its value: these records do not determine this model. "
    "Use a model with fewer parameters, or of a lower order, or records with more excitation"
)
_LOST = (
    "free runs of the estimate predict {} of the held-out records worse than a constant: do not "
    "trust it. `eoi refine` fits free runs, from the nominal values too where these are better"
)
# Built-in configs, where none is given.
_EXAMPLES = {"identify": "pendulum", "discover": "hidden_friction", "refine": "pendulum",
             "sweep": "pendulum_sweep"}  # fmt: skip
# Statuses of a discovery whose results are written.
_ANSWERS = ("complete", "partial", "nothing_missing", "unexplained")


def identify(
    config: Path | None,
    data: Path | None,
    output: Path,
    passes: int | None,
    recursive: bool,
    progress: ProgressCallback | None,
) -> Outcome:
    """Identify a plant's parameters.

    Args:
        config: TOML file; None: the built-in pendulum.
        data: folder of measured files; None: that of the config.
        output: folder in which the folder of the run is written.
        passes: number of passes; None: that of the config.
        recursive: whether parameters over time are asked for, beside the config.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: the config or the data are invalid.
    """
    changes = {} if passes is None else {"passes": passes}
    changes |= {"recursive": True} if recursive else {}
    source, job = _prepare("identify", config, data, output, progress, changes)
    with run_folder.quiet_records():
        result, validation = _identify(job, progress)
    notes = [*_example_notes(config), *_hold_notes(job.settings), *record_notes(job.held_out)]
    notes += _unseen_notes(job)
    if job.loop is not None and validation is None:
        notes.append(_NOT_IN_LOOP.format("passes, and there is no free run on held-out records"))
    if result.status.ok and validation is not None:
        names = zip(validation.outputs, validation.nrmse, strict=True)
        if lost := [name for name, error in names if error > 1.0]:
            notes.append(_LOST.format(" and ".join(lost)))
    result = replace(result, notes=(*result.notes, *notes))
    if result.status.ok and not _determined(result):
        result = replace(result, status=Status("undetermined", _UNDETERMINED))
    summary = identification_summary(job, result, validation)
    if not result.status.ok:
        complaint = _unanswered(result.status, job.records)
        return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=complaint)
    folder = output / job.settings.name
    passes_option = "" if passes is None else f" --passes {passes}"
    passes_option += " --recursive" if recursive else ""
    config_text = _with_command(f"eoi identify{_config_argument(config)}{passes_option}", source)
    replaced = _write_run(
        folder,
        lambda draft: run_folder.write_identification(
            draft, result, validation, summary, config_text
        ),
    )
    lines = [identification_text(result), "" if validation is None else str(validation)]
    text = "\n\n".join(filter(None, lines))
    if result.status.code == "undetermined":
        complaint = f"no answer ({result.status})"
        return Outcome(summary, text, folder, ExitCode.NO_ANSWER, complaint, replaced)
    return Outcome(summary, text, folder, replaced=replaced)


def _determined(result: Identification) -> bool:
    """Whether any free parameter has a standard error below its value."""
    errors = result.standard_errors
    return any(
        errors[name] < abs(value)
        for name, value in result.parameters.items()
        if name not in result.plant.fixed
    )


def discover(
    config: Path | None, data: Path | None, output: Path, progress: ProgressCallback | None
) -> Outcome:
    """Find what a plant's model lacks.

    Args:
        config: TOML file; None: the built-in example.
        data: folder of measured files; None: that of the config.
        output: folder in which the folder of the run is written.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: the config or the data are invalid.
    """
    source, job = _prepare("discover", config, data, output, progress)
    with run_folder.quiet_records():
        result = _discover(job, progress)
        result = replace(result, notes=(*result.notes, *_example_notes(config)))
    summary = discovery_summary(job, result)
    if not (result.status.ok or result.status.code in _ANSWERS):
        complaint = _unanswered(result.status, job.records)
        return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=complaint)
    folder = output / job.settings.name
    config_text = _with_command(f"eoi discover{_config_argument(config)}", source)
    parts = result, summary, config_text
    replaced = _write_run(folder, lambda draft: run_folder.write_discovery(draft, *parts))
    outcome = Outcome(summary, discovery_text(result), folder, replaced=replaced)
    if result.status.code == "unexplained":
        # The folder is written all the same: it has the maps of the residual.
        return replace(outcome, code=ExitCode.NO_ANSWER, complaint=answer(result))
    return outcome


def refine(
    config: Path | None, data: Path | None, output: Path, progress: ProgressCallback | None
) -> Outcome:
    """Identify, then minimise the free-run error.

    Args:
        config: TOML file; None: the built-in pendulum.
        data: folder of measured files; None: that of the config.
        output: folder in which the folder of the run is written.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: the config or the data are invalid.
    """
    source, job = _prepare("refine", config, data, output, progress)
    with run_folder.quiet_records():
        start, start_run = _identify(job, progress)
        if start.status.code == "no_data" or (start.common_factors and not start.status.ok):
            summary = identification_summary(job, start, start_run)
            complaint = f"no estimate to refine ({start.status})"
            return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=complaint)
        if progress is not None:
            progress("free-run fit, step", 0, None, "compiling")
        result, refined_run = _refine(job, start, progress)
        result = replace(result, notes=(*result.notes, *_example_notes(config)))
        if start_run and refined_run and start_run.window != refined_run.window:
            plants = start.plant, result.plant
            held_out = made_alike(job.held_out, job.records, result.records)
            start_run, refined_run = validated_alike(plants, held_out)
    summary = refinement_summary(job, start, start_run, result, refined_run)
    # A start that nothing speaks for: only where the fit from there came to an end it is an answer.
    alone = not start.status.ok and job.settings.refine.starts is None
    if alone and result.status.code != "converged":
        complaint = f"no estimate to refine ({start.status}); from the nominal values: "
        complaint += f"{result.status}. {_MORE_STARTS}"
        return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=complaint)
    if not result.status.ok:
        complaint = _unanswered(result.status, job.records)
        return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=complaint)
    folder = output / job.settings.name
    text = refinement_text(result, start_run, refined_run)
    config_text = _with_command(f"eoi refine{_config_argument(config)}", source)
    extra = {"start": start, "before": start_run, "after": refined_run}
    parts = (result, extra, summary, text, config_text)
    replaced = _write_run(folder, lambda draft: run_folder.write_refinement(draft, *parts))
    return Outcome(summary, text, folder, replaced=replaced)


def sweep(
    config: Path | None, data: Path | None, output: Path, part: str, progress: bool
) -> Outcome:
    """Try many gains, filters, starts and resamples.

    Args:
        config: TOML file; None: the built-in example.
        data: folder of measured files; None: that of the config.
        output: folder in which the folder of the run is written.
        part: ``i/n``: every n-th chunk, starting with the i-th.
        progress: whether a progress bar is shown.

    Returns:
        The outcome.

    Raises:
        ValueError: the config or the data are invalid.
    """
    source, job = _prepare("sweep", config, data, output, None)
    folder = output / job.settings.name
    with run_folder.quiet_records():
        result = sweeps.sweep.sweep(
            job.model,
            job.records,
            **build.sweep(job.settings, job.model),
            store=folder / "sweep.zarr",
            part=_part(part),
            progress=progress,
        )
        has_answer = bool(result["ok"].any())
        held_out = job.held_out or None
        best_lane = sweeps.best.best(result, job.model, held_out) if has_answer else None
    summary = sweep_summary(job, result, best_lane)
    text = sweep_text(result, best_lane)
    if job.loop is not None:
        note = _NOT_IN_LOOP.format("all lanes, and free runs on held-out records")
        summary["notes"] = [*_hold_notes(job.settings), note]
        text += "\n\n" + "\n".join(f"- {line}" for line in summary["notes"])
    config_text = _with_command(f"eoi sweep{_config_argument(config)}", source)
    run_folder.write_sweep(folder, result, best_lane, summary, text, config_text)
    if not result.attrs["finished"]:
        remaining = (
            f"{summary['statuses'].get('not_run', 0)} of {counted(summary['lanes'], 'lane')}"
        )
        complaint = f"interrupted with {remaining} to run; the same command continues"
        return Outcome(summary, code=ExitCode.INTERRUPTED, complaint=complaint)
    if best_lane is None:
        return Outcome(summary, code=ExitCode.NO_ANSWER, complaint=f"no answer: {text}")
    return Outcome(summary, text, folder)


def inspect(
    path: Path,
    output: Path,
    progress: ProgressCallback | None,
    max_gigabytes: float | None = None,
    sheet: str | None = None,
    time: str | None = None,
) -> Outcome:
    """Inspect a data file.

    Args:
        path: of the file.
        output: folder in which a folder with the figure is written.
        progress: called with the progress of the work.
        max_gigabytes: what a compressed file may unpack to [1e9 bytes]; None: `MAX_GIGABYTES`.
        sheet: of an Excel file; None: the first that is not empty.
        time: its column; None: guessed.

    Returns:
        The outcome.

    Raises:
        ValueError: the file cannot be read, or has no such column.
    """
    folder = output / f"{_stem(path)}.inspect"
    run_folder.check_place(folder, "file")
    run_files.check_replaceable(folder, "inspect")
    if progress is not None:
        progress("reading", 0, None, "")
    size = MAX_GIGABYTES if max_gigabytes is None else max_gigabytes
    inspection = inspect_file(path, size, time=time, sheet=sheet)
    if progress is not None:
        progress("drawing", 0, None, "")
    summary, text = inspection.summary(), str(inspection)
    parts = inspection, summary, text
    write = run_folder.write_inspection
    write_folder(folder, lambda draft: write(draft, *parts), run_files.files_of_run)
    return Outcome(summary, text, folder)


def init(
    paths: Sequence[Path],
    target: Path | None,
    force: bool,
    max_gigabytes: float | None = None,
    *,
    time: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    sheet: str | None = None,
) -> Outcome:
    """Write a config for data files that runs unchanged; its comments list every guess.

    Args:
        paths: of the data files.
        target: path of the config; None: named after the first file, in the working folder.
        force: replace an existing config.
        max_gigabytes: what a compressed file may unpack to [1e9 bytes]; None: `MAX_GIGABYTES`.
        time: its column; None: guessed.
        inputs: their columns; None: guessed.
        outputs: their columns; None: guessed.
        sheet: of Excel files; None: the first that is not empty.

    Returns:
        The outcome.

    Raises:
        ValueError: a file cannot be read or lacks a column, or the config exists already.
    """
    for path in paths:
        is_text = path.name == path.name.encode("utf-8", "replace").decode()
        check(is_text, "file", "must have a name in Unicode", path, "Rename it.")
    config_path = target or Path(f"{_stem(paths[0])}.toml")
    rule = "must not exist"
    check(
        force or not config_path.exists(), "--output", rule, config_path, "Replace it with --force."
    )
    check(not config_path.is_dir(), "--output", "must be a file", config_path)
    is_data = config_path.resolve() in {path.resolve() for path in paths}
    check(not is_data, "--output", "must not be a data file", config_path)
    run_folder.check_place(config_path, "--output")
    with run_folder.quiet_records():
        size = MAX_GIGABYTES if max_gigabytes is None else max_gigabytes
        inspections = [
            inspect_file(path, size, time=time, inputs=inputs, outputs=outputs, sheet=sheet)
            for path in paths
        ]
        inspection = inspections[0]
        draft = cli.template.draft(inspections, config_path, sheet)
        text = cli.template.checked(draft, config_path)

    def fill(new: Path) -> None:
        new.write_text(text, encoding="utf-8")

    config_path.parent.mkdir(parents=True, exist_ok=True)
    write_file(config_path, fill)
    facts = {
        "time": inspection.clock.column,
        "inputs": inspection.inputs,
        "outputs": inspection.outputs,
    }
    guesses = "\n".join(
        f"  {channel.name}: {channel.role}, {channel.why}"
        for channel in inspection.channels
        if channel.role in ("time", "input", "output")
    )
    notes = "\n".join(f"- {line}" for line in cli.template.remarks(inspection))
    is_timed = inspection.clock.sample_period is not None
    step = "" if is_timed else "insert the sample_period [s], which the file does not tell, then "
    text = (
        f"Guesses:\n{guesses}\n{notes}\n\n{config_path} written; "
        f"next: {step}eoi identify {shell_word(config_path)}"
    )
    return Outcome({"config": str(config_path), **facts}, text, config_path)


def report(run: Path) -> Outcome:
    """Regenerate the report of a run from its folder.

    Args:
        run: folder of a run.

    Returns:
        The outcome.

    Raises:
        ValueError: not the folder of a run, or an interrupted run.
    """
    path = html_report.write_report(run)
    return Outcome({"report": str(path)}, str(path), path)


def _stem(path: Path) -> str:
    name = path.name[:-3] if path.name.lower().endswith(".gz") else path.name
    return Path(name).stem


def _part(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    check(number.isdigit() and count.isdigit(), "--part", "must be i/n, such as 0/10", text)
    return int(number), int(count)


# -- the run ----------------------------------------------------------------------------------


def _prepare(
    command: str,
    config: Path | None,
    data: Path | None,
    output: Path,
    progress: ProgressCallback | None,
    changes: Mapping[str, Any] | None = None,
) -> tuple[Path, run_folder.Job]:
    """The path of the config, and its model and records."""
    jax_setup.configure()
    source = built_in(_EXAMPLES[command]) if config is None else config_file(config)
    settings = load(source)
    if changes:
        table = msgspec.structs.replace(settings.identify, **changes)
        settings = msgspec.structs.replace(settings, identify=table)
    run_folder.check_place(output / settings.name, "name")
    run_files.check_replaceable(output / settings.name, command)
    if progress is not None:
        progress("reading", 0, None, "")
    return source, run_folder.job(settings, run_folder.folder_of(source), data)


def config_file(config: Path) -> Path:
    """The file of a config that is named by it, or of a built-in one that goes by its name.

    Args:
        config: as it was typed.

    Raises:
        ValueError: neither is there.
    """
    if config.exists() or config.suffix or config.name != str(config):
        return config
    path = built_in(config.name)
    rule = f"must be a file that exists, or a built-in config: {', '.join(built_in_names())}"
    check(path.is_file(), "config", rule, config)
    return path


def _identify(
    job: run_folder.Job, progress: ProgressCallback | None
) -> tuple[Identification, Validation | None]:
    """Run the passes, and validate their estimate on the held-out records."""
    table = job.settings.identify

    def report_pass(number: int, passes: int, index: Any) -> None:
        values = "  ".join(f"{value:.3g}" for value in np.atleast_1d(index))
        assert progress is not None
        progress("pass", number, passes, f"P = {values}")

    if progress is not None:
        progress("pass", 0, None, "compiling")
    result = run_passes(
        job.model,
        job.records,
        build.observer(job.settings),
        build.lowpass(job.settings),
        table.passes,
        transient=table.transient,
        substeps=table.substeps,
        smoothing=table.smoothing,
        instruments=table.instruments,
        recursive=table.recursive,
        forgetting=table.forgetting,
        callback=None if progress is None else report_pass,
    )
    return result, _validate(result, job)


def _discover(job: run_folder.Job, progress: ProgressCallback | None) -> Discovery:
    """Run `discover`; a note names tables of the config that it does not use."""
    table = job.settings.discover

    def report_stage(stage: str, count: int, stages: int) -> None:
        assert progress is not None
        progress("discover", count, stages, stage)

    result = run_discovery(
        job.model,
        job.records,
        validation=job.held_out or None,
        effects=build.effects(job.settings, job.model, job.records),
        lowpass=build.lowpass(job.settings),
        alpha=table.alpha,
        most=table.most,
        window=table.window,
        refine=table.refine,
        test=job.test or None,
        callback=None if progress is None else report_stage,
    )
    return replace(result, notes=(*result.notes, *_unused(job.settings)))


def _unused(settings: Config) -> list[str]:
    """Notes on tables of a config that a discovery does not use, and on its hold."""
    tables = {"[observer]": settings.observer, "[identify]": settings.identify}
    names = [name for name, table in tables.items() if table not in (None, IdentifyTable())]
    verb, notes = is_or_are(len(names)), _hold_notes(settings)
    if names:
        text = f"{' and '.join(names)} {verb} not used: a discovery chooses these for every model"
        notes.append(text)
    if settings.controller is not None:
        text = "passes and free runs of a discovery. Of an unstable plant only runs in windows say "
        notes.append(_NOT_IN_LOOP.format(f"{text}anything; `eoi refine` has it in the loop"))
    return notes


def _unanswered(status: Status, records: Sequence[Record]) -> str:
    """Why there is no answer, with what a user has to know of the records."""
    return ". ".join([f"no answer ({status})", *wrapped_notes(records)])


def _example_notes(config: Path | None) -> list[str]:
    """Whose data these are where no config is given."""
    text = "no config was given: this is the built-in example. `eoi init FILE` drafts a config for "
    text += "your own data"
    return [text] if config is None else []


def _hold_notes(settings: Config) -> list[str]:
    """A note on the hold of records that do not declare it, and have a controller."""
    undeclared = settings.data is not None and settings.data.hold == "auto"
    return [_HOLD_ZERO] if settings.controller is not None and undeclared else []


def _unseen_notes(job: run_folder.Job) -> list[str]:
    """A note on test records, which only a discovery judges."""
    return [_NOT_TESTED] if job.test else []


def _refine(
    job: run_folder.Job, start: Identification, progress: ProgressCallback | None
) -> tuple[Refinement, Validation | None]:
    """Refine the estimate of the passes by output error, and validate the result."""
    table, loop = job.settings.refine, job.loop

    def report_step(number: int, limit: int) -> None:
        assert progress is not None
        progress("free-run fit, step", number, limit, "at most")

    result = run_refinement(
        start,
        (loop or job).records,
        window=table.window,
        substeps=table.substeps,
        max_steps=table.max_steps,
        starts=table.starts,
        rounds=table.rounds,
        validation=(loop or job).held_out or None,
        callback=None if progress is None else report_step,
        controller=None if loop is None else loop.controller,
    )
    notes = *_hold_notes(job.settings), *_unseen_notes(job)
    result = replace(result, notes=(*result.notes, *notes))
    return result, _validate(result, job)


def _validate(result: Identification | Refinement, job: run_folder.Job) -> Validation | None:
    """Free runs on the held-out records; None without an estimate or without such records."""
    if not (result.status.ok and job.held_out):
        return None
    if job.loop is not None:
        return validate(result.plant, job.loop.held_out, controller=job.loop.controller)
    return validate(result.plant, made_alike(job.held_out, job.records, result.records))


def _write_run(folder: Path, write: Callable[[Path], None]) -> str:
    """Write the files of a run and its report into a folder, all or nothing.

    The run of another command that stood there is kept beside it, and files that are of no run stay
    in the folder.

    Returns:
        Sentences on the run that stood there, where it was another one, and on such files; or "".
    """
    former, archive = run_files.command_of_run(folder), None

    def copy(draft: Path) -> None:
        for name in run_files.files_of_run(folder):
            link(folder / name, draft / name)

    def fill(draft: Path) -> None:
        nonlocal archive
        write(draft)
        html_report.write_report(draft)
        archive = run_files.archive_of(folder, run_files.command_of_run(draft).split()[1])
        if archive is not None:
            write_folder(archive, copy, run_files.files_of_run)

    write_folder(folder, fill, run_files.files_of_run)
    sentences = []
    if former not in ("", run_files.command_of_run(folder)):
        here = "--output names another folder"
        place = here if archive is None else f"that is now in {archive}/"
        sentences.append(f"It replaced the run of `{former}`; {place}.")
    if names := run_files.files_beside_run(folder):
        sentences.append(f"Of no run, and still in {folder}/: {run_files.listed(names)}.")
    return " ".join(sentences)


def _config_argument(config: Path | None) -> str:
    """The config in a command line; empty for the built-in one."""
    return "" if config is None else f" {shell_word(config)}"


def _with_command(command: str, source: Path) -> str:
    """The text of the config below the command that used it."""
    config = source.read_text(encoding="utf-8-sig")
    return f"# {command}\n{config}"
