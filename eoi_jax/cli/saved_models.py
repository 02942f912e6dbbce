"""Actions on saved models: `eoi validate`, `predict` and `compare`, free runs on other data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eoi_jax._atomic import write_folder
from eoi_jax._checks import check, check_choice
from eoi_jax.cli import build, run_files, run_folder
from eoi_jax.cli.config import Config, LawTable, load
from eoi_jax.cli.new_files import dates_of_zero, planned_inputs, records_of_files
from eoi_jax.cli.summary import comparison_summary, prediction_summary, validation_summary
from eoi_jax.cli.terminal import Outcome, ProgressCallback
from eoi_jax.compiler import jax_setup
from eoi_jax.data.holds import made_alike, skew_text
from eoi_jax.data.input_holds import hold_text
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.estimation.holdout import longest_start
from eoi_jax.models.check_records import check_inputs
from eoi_jax.models.controller import Controller
from eoi_jax.models.free_starts import free_start_names, internal_starts
from eoi_jax.models.plant import Plant
from eoi_jax.report.saved_models import (
    correlation_text,
    judgement_text,
    largest_correlations,
    models_text,
)
from eoi_jax.simulation.simulate import simulate
from eoi_jax.simulation.validate import validate as free_runs
from eoi_jax.simulation.validate import validated_alike
from eoi_jax.simulation.validation import FittedModel, Validation

_FOLDERS = "must be two folders of runs or more, before the data files"
_NO_LOOP = "[controller] is not in the loop: the recorded inputs drive all models"
_PLANNED = "[controller] is not in the loop: the planned inputs drive the model"
_GIVE_FILES = "Give data files behind the runs."


def validate(
    run: Path,
    files: Sequence[Path],
    output: Path,
    trust: bool,
    progress: ProgressCallback | None,
) -> Outcome:
    """Judge the model of a run on data files, by free runs.

    Args:
        run: folder of a run.
        files: data files with the columns of its config.
        output: folder in which a folder with table, figures and JSON object is written.
        trust: whether a Python file that the config names may be executed.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: not the folder of a run, or files that are not of the same columns.
    """
    folder, result, settings = _opened(run, output, "validate", trust, progress)
    plant = _plant(result)
    with run_folder.quiet_records():
        records = records_of_files(settings, plant, files)
        controller = _controller(settings, plant, run, records, trust)
        _report_stage(progress, "free runs")
        full_runs = free_runs(result, records, controller=controller)
        windows = _in_windows(result, records, full_runs, controller)
    rows = largest_correlations(full_runs)
    notes = [*_fitted_notes([(run, result)], records), *_predicted_notes(records)]
    text = judgement_text(f"{run}: {plant.name}", full_runs, windows, rows)
    text = "\n\n".join([text, *(f"Note: {note}" for note in notes)])
    summary = validation_summary(settings.name, run, full_runs, windows, rows, notes)
    _report_stage(progress, "drawing")
    dates = dates_of_zero(settings, plant, files)
    parts = ("validate", [("free run", full_runs)], summary, text, dates)
    write = run_folder.write_free_runs
    write_folder(folder, lambda draft: write(draft, *parts), run_files.files_of_run)
    return Outcome(summary, text, folder)


def _opened(
    run: Path, output: Path, command: str, trust: bool, progress: ProgressCallback | None
) -> tuple[Path, Any, Config]:
    """Where a command writes, and the stored result and the config of its run."""
    jax_setup.configure()
    folder = output / f"{_name(run)}.{command}"
    run_folder.check_place(folder, "RUN")
    run_files.check_replaceable(folder, command)
    _report_stage(progress, "reading")
    return folder, *_saved(run, trust)


def _predicted_notes(records: Sequence[Record]) -> list[str]:
    """How many samples of a record, before or behind all measured ones, are predicted only."""
    notes = []
    for record in records:
        (measured,) = np.nonzero(np.any(record.output_valid, axis=1))
        count = len(record) - (int(np.ptp(measured)) + 1 if len(measured) else 0)
        if count:
            share = f"{count} of {len(record)} samples of {record.name} are predicted only"
            notes.append(f"{share}, as no output is measured there: see prediction.csv.")
    return notes


def predict(
    run: Path,
    file: Path,
    initial: Sequence[str],
    output: Path,
    trust: bool,
    progress: ProgressCallback | None,
) -> Outcome:
    """Predict the outputs of the model of a run from the planned inputs in a file.

    Args:
        run: folder of a run.
        file: data file with the inputs of its config; outputs in its first sample are the start.
        initial: ``NAME=VALUE``, or ``NAME=VALUE,RATE``, of outputs at the start, and of internal
            states that the model declares as free there.
        output: folder in which a folder with numbers, figure and JSON object is written.
        trust: whether a Python file that the config names may be executed.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: not the folder of a run, a file without an input, an output whose start is
            neither given nor measured nor declared, or a simulation that diverges.
    """
    folder, result, settings = _opened(run, output, "predict", trust, progress)
    plant = _plant(result)
    stated = _given_starts(initial, plant)
    with run_folder.quiet_records():
        record, measured = planned_inputs(settings, plant, file)
        check_inputs(plant, record)
        fitted = getattr(result, "records", ())
        (record,) = made_alike((record,), fitted, fitted)
        start, sources = _starts(plant, stated, measured)
        _report_stage(progress, "simulation")
        names = {"hold": record.hold, "name": record.name}
        first = {name: values[0] for name, values in stated.items()}
        internal = internal_starts(plant, first, "--initial", _FREE_START)
        prediction = simulate(plant, record.time, record.inputs, start, internal=internal, **names)
    notes = _prediction_notes(plant, record, start)
    begun = [f"{name} {first[name]:g}" for name in free_start_names(plant)]
    notes += [f"--initial gives the start of {', '.join(begun)}"] * bool(begun)
    notes += [_PLANNED] * (settings.controller is not None)
    text = f"{len(record)} samples of {record.name} predicted by {run}, every "
    text += f"{record.sample_period:g} s; the outputs start from {sources}."
    text = "\n\n".join([text, *(f"Note: {note}" for note in notes)])
    summary = prediction_summary(settings.name, run, record, start, notes)
    _report_stage(progress, "drawing")
    parts = (prediction, summary, text, *dates_of_zero(settings, plant, [file]))
    write = run_folder.write_prediction
    write_folder(folder, lambda draft: write(draft, *parts), run_files.files_of_run)
    return Outcome(summary, text, folder)


# A free run of `validate` estimates what no one knows of the start.
_HISTORY = (
    "If it is not known, put rows with measured outputs before the plan, leave the outputs of the "
    "plan empty, and call `eoi validate`: it estimates the start from them."
)
_FREE_START = f"Add --initial {{}}=VALUE. {_HISTORY}"


def _given_starts(words: Sequence[str], plant: Plant) -> dict[str, tuple[float, ...]]:
    """The starts of outputs and free internal states that ``--initial`` gives, by name."""
    starts, free = {}, free_start_names(plant)
    for word in words:
        name, sign, text = word.rpartition("=")
        if sign:
            check_choice("--initial", name, (*plant.outputs, *free))
        try:
            starts[name] = tuple(float(number) for number in text.split(","))
        except ValueError:
            sign = ""
        if name in free and len(starts.get(name, ())) != 1:
            sign = ""
        rule = "must be NAME=VALUE, or NAME=VALUE,RATE, with numbers"
        check(bool(sign), "--initial", rule, word, f"Write {plant.outputs[0]}=1.5.")
    return starts


def _starts(
    plant: Plant, stated: Mapping[str, tuple[float, ...]], measured: Mapping[str, float]
) -> tuple[dict[str, tuple[float | None, ...]], str]:
    """Outputs at the start: as given, else measured, else declared; and a text on all of them."""
    starts: dict[str, tuple[float | None, ...]] = {}
    texts, missing = [], []
    for name, degree in zip(plant.outputs, plant.degrees, strict=True):
        declared = plant.initial.get(name, (None,))
        if name in stated:
            starts[name], source = stated[name], "--initial"
        elif not degree:  # a function of the states
            continue
        elif name in measured:
            starts[name], source = (measured[name], *declared[1:]), "measured"
        else:
            starts[name], source = declared, "declared by the model"
        if starts[name][0] is None:
            missing.append(name)
            continue
        unit = plant.units.get(name, "")
        values = ", ".join(f"{value:.6g}" for value in starts[name] if value is not None)
        texts.append(f"{name} {values}{f' {unit}' if unit else ''} ({source})")
    rule = "must give the outputs at the start where the file does not measure them"
    advice = f"Add {' '.join(f'--initial {name}=VALUE' for name in missing)}. {_HISTORY}"
    check(not missing, "--initial", rule, f"nothing for {', '.join(missing)}", advice)
    return starts, ", ".join(texts) or "their states, as the model declares these"


def _prediction_notes(
    plant: Plant, record: Record, start: Mapping[str, Sequence[float | None]]
) -> list[str]:
    """What is assumed of the time before the file, and of states that nothing tells."""
    notes = []
    resting = [
        name
        for name, degree in zip(plant.outputs, plant.degrees, strict=True)
        if sum(value is not None for value in start.get(name, ())) < degree
    ]
    if resting:
        notes.append(f"derivatives of {', '.join(resting)} that are not known start at 0")
    if not all(plant.free_internal):
        notes.append("internal states start as the model declares them")
    if plant.actuator is not None:
        notes.append("before the file, the inputs of delays and lags are taken as at its start")
    if np.any(record.skew):
        skew = skew_text(record, record.skew)
        notes.append(f"the fit says that {skew}: the prediction leaves this out")
    return notes


def compare(
    paths: Sequence[Path], output: Path, trust: bool, progress: ProgressCallback | None
) -> Outcome:
    """Compare the models of several runs on the same records, by free runs.

    Args:
        paths: folders of runs, then data files; without a file the records are those that the
            first run held out. Files are read with the columns of the first run's config.
        output: folder in which a folder with table, figures and JSON object is written.
        trust: whether a Python file that a config names may be executed.
        progress: called with the progress of the work.

    Returns:
        The outcome.

    Raises:
        ValueError: fewer than two runs, channels that differ, or no records.
    """
    jax_setup.configure()
    runs = [path for path in paths if path.is_dir()]
    files = [path for path in paths if not path.is_dir()]
    check(len(runs) > 1, "RUN", _FOLDERS, ", ".join(map(str, runs)) or "none")
    labels, folder = _labels(runs), output / f"{_name(runs[0])}.compare"
    run_folder.check_place(folder, "RUN")
    run_files.check_replaceable(folder, "compare")
    _report_stage(progress, "reading")
    saved = [_saved(run, trust) for run in runs]
    plants = [_plant(result) for result, _ in saved]
    for run, plant in zip(runs, plants, strict=True):
        rule = f"must have inputs and outputs of {runs[0]}: {_channels(plants[0])}"
        equal = _channels(plant) == _channels(plants[0])
        check(equal, "RUN", rule, f"{run} with {_channels(plant)}")
    with run_folder.quiet_records():
        records = _common_records(runs[0], files, saved[0][1], plants[0])
        _report_stage(progress, "free runs")
        validations = validated_alike([result for result, _ in saved], records)
    named = list(zip(labels, validations, strict=True))
    correlations = [largest_correlations(validation) for validation in validations]
    texts = [models_text(named)]
    texts += [
        f"{name}\n{correlation_text(rows)}"
        for (name, _), rows in zip(named, correlations, strict=True)
    ]
    notes = [] if files else [_held_out_note(runs[0], records[0])]
    notes += _fitted_notes([(run, result) for run, (result, _) in zip(runs, saved, strict=True)],
                           records)  # fmt: skip
    notes += [_NO_LOOP] * any(settings.controller is not None for _, settings in saved)
    texts += [f"Note: {note}" for note in notes]
    summary = comparison_summary(runs, validations, correlations, notes)
    text = "\n\n".join(texts)
    _report_stage(progress, "drawing")
    parts = ("compare", named, summary, text)
    write = run_folder.write_free_runs
    write_folder(folder, lambda draft: write(draft, *parts), run_files.files_of_run)
    return Outcome(summary, text, folder)


def _report_stage(progress: ProgressCallback | None, stage: str) -> None:
    if progress is not None:
        progress(stage, 0, None, "")


def _name(run: Path) -> str:
    """The name of a run: that of its folder, also of ``.``."""
    return run.resolve().name


def _labels(runs: Sequence[Path]) -> list[str]:
    """The names of the runs, with so many folders before them that no two are the same."""
    parts = [run.resolve().parts for run in runs]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(part[-count:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    check(False, "RUN", "must be different runs", ", ".join(map(str, runs)))
    return []  # not reached


def _saved(run: Path, trust: bool) -> tuple[Any, Config]:
    """The result of a run, and its config."""
    rule = "must be the folder of a run"
    check(not run.is_file(), "RUN", rule, run, "Runs are in runs/<name>/.")
    return run_folder.result_of_run(run, trust), load(run / "config.toml")


def _plant(result: Plant | FittedModel) -> Plant:
    return result if isinstance(result, Plant) else result.plant


def _channels(plant: Plant) -> str:
    return ", ".join((*plant.inputs, *plant.outputs))


def _controller(
    settings: Config, plant: Plant, run: Path, records: Sequence[Record], trust: bool
) -> Controller | None:
    """The controller of the config; its law is executed where it is trusted only."""
    if isinstance(settings.controller, LawTable):
        rule, value = "must hold its complete model", f"{run}, whose controller is a function in "
        advice = "Check this file; --trust executes it."
        check(trust, "RUN", rule, value + settings.controller.law, advice)
    folder = run_folder.folder_of(run / "config.toml")
    return build.controller(settings, plant, folder, records[0].sample_period)


def _in_windows(
    result: Plant | FittedModel,
    records: Sequence[Record],
    full_runs: Validation,
    controller: Controller | None,
) -> Validation | None:
    """Free runs over a tenth of the records; None where they are so already, or none fits."""
    if full_runs.window is not None:
        return None
    length = window_length(records, 2 * longest_start(_plant(result), records))
    if length is None:
        return None
    return free_runs(result, records, window=length, controller=controller)


def _fitted_notes(results: Sequence[tuple[Path, Any]], records: Sequence[Record]) -> list[str]:
    """Which records, or parts of them, a model was fitted to: their errors are no test of it."""
    notes = []
    for run, result in results:
        names = [
            record.name
            for record in records
            if any(_share_samples(record, fitted) for fitted in getattr(result, "records", ()))
        ]
        if names:
            text = f"{', '.join(names[:4])}{', …' if len(names) > 4 else ''}"
            text = f"{run} was fitted to samples of {text}: errors there do not say how well it "
            notes.append(text + "predicts; judge it on other data")
    return notes


def _share_samples(record: Record, fitted: Record, smallest: int = 8) -> bool:
    """Whether outputs of two records are the same at all times that both have, so many at least."""
    if record.outputs.shape[1] != fitted.outputs.shape[1]:
        return False
    period = record.sample_period
    ticks, fitted_ticks = np.rint(record.time / period), np.rint(fitted.time / period)
    _, rows, fitted_rows = np.intersect1d(ticks, fitted_ticks, return_indices=True)
    valid = record.valid[rows] & fitted.valid[fitted_rows]
    outputs = record.outputs[rows][valid]
    moves = len(outputs) >= smallest and bool(np.ptp(outputs, axis=0).any())
    return moves and np.array_equal(outputs, fitted.outputs[fitted_rows][valid])


def _held_out_note(first: Path, record: Record) -> str:
    """Whose records these are, and how their inputs act."""
    skew = f" ({skew_text(record, record.skew)})" if np.any(record.skew) else ""
    hold = hold_text(record.hold, record.input_names)
    held = f", with the hold of that run, {hold}{skew}" if record.input_names else ""
    return (
        f"no data file is given: the records are those that {first} held out{held}. It may have "
        "chosen its model on them; new data files are fairer"
    )


def _common_records(
    first: Path, files: Sequence[Path], settings: Config, plant: Plant
) -> tuple[Record, ...]:
    """The records of the files, else those that the first run held out; without references."""
    if not files:
        records = run_folder.held_out_of_run(first)
        rule = "must have held-out records where no data file is given"
        check(len(records) > 0, "RUN", rule, first, _GIVE_FILES)
        return records
    records = records_of_files(settings, plant, files)
    references = records[0].input_names[len(plant.inputs) :]
    if not references:
        return tuple(records)
    return tuple(record.without_inputs(*references) for record in records)
