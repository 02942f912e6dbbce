"""The plant, gains, effects and records that the tables of a config describe."""

import contextlib
import difflib
import functools
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from eoi_jax._checks import check, check_choice, counted
from eoi_jax.cli.config import (
    ChirpTable,
    Config,
    DataTable,
    LawTable,
    MultisineTable,
    PidTable,
    PrbsTable,
    RandomStepsTable,
    RangeTable,
    SimulateTable,
    SquareTable,
    StepsTable,
    SweepTable,
)
from eoi_jax.data import excitation
from eoi_jax.data.readers.read_record import read_record, read_table
from eoi_jax.data.record import Record
from eoi_jax.discovery.requested import named_effects
from eoi_jax.estimation import observers
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.models import library as plants
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.controller import Controller
from eoi_jax.models.effects import AbstractEffect, standard
from eoi_jax.models.equations.text_model import plant_of
from eoi_jax.models.free_starts import free_start_names, internal_starts
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.simulate import simulate

DATA_VARIABLE = "EOI_DATA"

_PLANTS: dict[str, Callable[[], Plant]] = {
    factory.__name__: factory
    for factory in (
        plants.level_tank,
        plants.mass_spring_damper,
        plants.three_mass_spring_damper,
        plants.pendulum,
        plants.positioning_system,
        plants.duffing_oscillator,
        plants.cascaded_tanks,
        plants.propeller_arm,
    )
}


def plant(config: Config, folder: Path) -> Plant:
    """The model with its nominal parameters, bounds and fixed names.

    Args:
        config: the tables.
        folder: of the config; the file of a plant is relative to it.

    Raises:
        ValueError: unknown plant or parameter, value outside its bounds, or a file with an error.
    """
    base = _base(config, folder)
    table = config.parameters
    for field in ("nominal", "bounds"):
        for key in getattr(table, field):
            check_choice(f"parameters.{field}", key, base.names)
    return base.declared_anew(table.nominal, table.bounds, table.fixed)


def _base(config: Config, folder: Path) -> Plant:
    """The declared plant: of the config, of a file beside it, or of the library."""
    if config.model is not None:
        return plant_of(config.model, config.name)
    assert config.plant is not None
    if ":" in config.plant:
        return _plant_from_file(config.plant, folder)
    check_choice("plant", config.plant, _PLANTS)
    return _PLANTS[config.plant]()


def _plant_from_file(reference: str, folder: Path) -> Plant:
    def plant_of_item(item: Any) -> Any:
        return item() if callable(item) and not isinstance(item, Plant) else item

    rule = 'must be "file.py:object"'
    plant = _from_file("plant", rule, reference, folder, plant_of_item)
    rule += " where the object is a Plant or a function that returns one"
    check(isinstance(plant, Plant), "plant", rule, reference)
    return plant


def _from_file(
    field: str, rule: str, reference: str, folder: Path, converted: Callable[[Any], Any]
) -> Any:
    """An object of a Python file, converted; `converted` gets None where the file has none."""
    file, _, name = reference.rpartition(":")
    path = folder / file
    check(path.is_file(), field, f"{rule} with a file that exists", path)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    check(spec is not None, field, f"{rule} with a Python file", path)
    module = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]
    try:
        with contextlib.redirect_stdout(sys.stderr):  # stdout is for results
            spec.loader.exec_module(module)  # type: ignore[union-attr]
            return converted(getattr(module, name, None))
    # Any error of the user's code, `SystemExit` included, is an error of the config.
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}".rstrip(".")
        raise ValueError(f"`{field}` {rule} that runs, got {reference}: {reason}.") from error


def controller(config: Config, model: Plant, folder: Path, period: float) -> Controller | None:
    """The controller of the table [controller]; None: there is none.

    Args:
        config: the tables.
        model: the plant that it controls.
        folder: of the config; the file of a law is relative to it.
        period: sample period of the records [s].

    Raises:
        ValueError: an output that the plant does not have, several inputs of which a PID controller
            drives none by name, a file with an error, or the errors of `Controller`.
    """
    table = config.controller
    if table is None:
        return None
    fields = msgspec.structs.asdict(table)
    if isinstance(table, LawTable):
        rule = 'must be "file.py:function"'
        law = _from_file("controller.law", rule, table.law, folder, lambda item: item)
        rule += " where the object is a function law(t, r, y, s)"
        check(callable(law), "controller.law", rule, table.law)
        make, changes = Controller, {"law": law}
    else:
        output = model.outputs[0] if table.output is None else table.output
        check_choice("controller.output", output, model.outputs)
        rule = "must name the input that a PID controller drives"
        clear = table.inputs is not None or len(model.inputs) == 1
        check(clear, "controller.inputs", rule, f"nothing for {', '.join(model.inputs)}")
        make = Controller.pid
        changes = {"period": period, "output": model.outputs.index(output)}
    try:
        return make(**{**fields, **changes})
    except ValueError as error:
        raise ValueError(f"[controller] {error}") from None


def _references(table: PidTable | LawTable | None) -> tuple[str, ...]:
    """Names of the references that a controller reads in the records."""
    if table is None or isinstance(table.reference, float | int):
        return ()
    names = table.reference
    return (names,) if isinstance(names, str) else names


_OBSERVERS = {
    "first_order": observers.FirstOrder,
    "second_order": observers.SecondOrder,
    "super_twisting": observers.SuperTwisting,
    "high_order": observers.HighOrder,
}


def observer(config: Config) -> Any:
    """The observer of the table [observer]; None: to be chosen from the records."""
    table = config.observer
    if table is None:
        return None
    kind = _OBSERVERS[str(type(table).__struct_config__.tag)]
    return kind(**msgspec.structs.asdict(table))


def sweep(config: Config, model: Plant) -> dict[str, Any]:
    """Arguments of `eoi_jax.sweep` from [sweep], [observer], [lowpass] and [identify].

    Raises:
        ValueError: gains that do not match, or an unknown parameter.
    """
    table, passes = config.sweep, config.identify
    filters: Any = lowpass(config)
    if table.cutoffs is not None:
        filters = [LowPass(cutoff, order=table.order) for cutoff in _values(table.cutoffs)]
    starts = [model.parameters, *({**model.parameters, **start} for start in table.starts)]
    return {
        "observers": _gain_sets(table, model) or observer(config),
        "lowpass": filters,
        "starts": starts,
        "resamples": table.resamples,
        "passes": passes.passes,
        "transient": passes.transient,
        "substeps": passes.substeps,
        "smoothing": passes.smoothing,
        "precision": table.precision,
        "seed": table.seed,
        "chunk": table.chunk,
    }


def _gain_sets(table: SweepTable, model: Plant) -> list[observers.GainSets]:
    sets = []
    for i, row in enumerate(table.observers):
        kind, scheme = _OBSERVERS[row.kind], row.scheme
        if row.kind == "high_order":
            kind, scheme = functools.partial(kind, degree=model.relative_degree), None
        values = {name: _values(value) for name, value in row.gains.items()}
        try:
            sets.append(observers.gains(kind, values, scheme, row.grid))
        except ValueError as error:
            raise ValueError(f"`sweep.observers[{i}].gains`: {error}") from error
    return sets


def _values(values: Any) -> Any:
    """The values of a range; a number or a list unchanged."""
    if isinstance(values, RangeTable):
        return np.geomspace(values.low, values.high, values.count)
    return values


def lowpass(config: Config) -> LowPass | None:
    """The filter of the table [lowpass]; None: to be chosen from the records."""
    table = config.lowpass
    return None if table is None else LowPass(table.cutoff, order=table.order)


def effects(
    config: Config, model: Plant, fitted: Sequence[Record]
) -> tuple[AbstractEffect, ...] | None:
    """The effects of the table [discover], in all their forms; None: all that fit the plant.

    Args:
        config: the tables.
        model: the declared plant.
        fitted: records to fit.

    Raises:
        ValueError: an unknown name, or none that the plant can have.
    """
    names = config.discover.effects
    return None if names is None else named_effects(names, model, fitted, "discover.effects")


def records(config: Config, model: Plant, folder: Path, data: Path | None = None) -> list[Record]:
    """The records to identify from, simulated or read.

    The references of a controller are further inputs, after those of the plant.

    Args:
        config: the tables.
        model: the plant with its nominal parameters.
        folder: of the config.
        data: folder of measured files; None: `folder`, else $EOI_DATA.

    Raises:
        ValueError: of `simulate` or `read_record`, or a name that the plant does not have.
    """
    if config.data is not None:
        return records_of_table(config.data, "data", model, config.controller, folder, data)
    assert config.simulate is not None
    return [_simulated(config.name, config.simulate, model, "input")]


def validation_records(
    config: Config, model: Plant, folder: Path, data: Path | None = None
) -> list[Record]:
    """The held-out records of the config, if any. Arguments as in `records`."""
    table = config.simulate
    if table is not None and table.held_out:
        held_out = msgspec.structs.replace(table, seed=table.seed + 1)  # independent noise
        return [_simulated(f"{config.name}, held out", held_out, model, "held_out")]
    if config.validation is None:
        return []
    return records_of_table(config.validation, "validation", model, config.controller, folder, data)


def unseen_records(
    config: Config, model: Plant, folder: Path, data: Path | None = None
) -> list[Record]:
    """The test records of the config, if any. Arguments as in `records`."""
    if config.test is None:
        return []
    return records_of_table(config.test, "test", model, config.controller, folder, data)


def records_of_table(
    table: DataTable,
    name: str,
    model: Plant,
    loop: PidTable | LawTable | None,
    folder: Path,
    data: Path | None,
) -> list[Record]:
    """The records that a table of a config describes.

    Args:
        table: with files and columns.
        name: of the table in the config.
        model: the plant.
        loop: the controller of the config, whose references are read as inputs.
        folder: of the config.
        data: folder of measured files; None: `folder`, else $EOI_DATA.

    Raises:
        ValueError: columns that are not as many as the plant's channels, and those of
            `read_record`.
    """
    references = _references(loop)
    for field, channels, owner in (
        ("inputs", model.inputs, "the plant's"),
        ("outputs", model.outputs, "the plant's"),
        ("references", references, "the reference of [controller],"),
    ):
        if getattr(table, field) is None:
            table = msgspec.structs.replace(table, **{field: channels})
        columns = getattr(table, field)
        check(
            len(columns) == len(channels),
            f"{name}.{field}",
            f"must name {counted(len(channels), 'column')}, for {owner} "
            f"{', '.join(channels) or 'none'}",
            ", ".join(columns) or "none",
        )
    assert table.inputs is not None
    assert table.outputs is not None
    assert table.references is not None
    rule = "must be columns that are neither inputs nor outputs"
    shared = {*table.references} & {*table.inputs, *table.outputs}
    advice = "Where plant and controller read the same signal, the file needs it in two columns."
    check(not shared, f"{name}.references", rule, ", ".join(shared), advice)
    hold = "zero" if loop is not None and table.hold == "auto" else table.hold
    if isinstance(hold, dict):
        hold = {**dict.fromkeys(table.references, "zero"), **hold}
    rule = "must be left out where `parts` are given"
    check(not table.parts or table.slice is None, f"{name}.slice", rule, table.slice)
    for file in table.parts:
        check_choice(f"{name}.parts", file, table.files)
    measured = []
    for file in table.files:
        path, spans = _path_of(file, name, folder, data), table.parts.get(file) or (table.slice,)
        for number, span in enumerate(spans, 1):
            label = f"{path.name.split('.')[0]}, part {number}" if len(spans) > 1 else None
            options = {"hold": hold, "slice": span, "name": label}
            options["renames"] = dict(zip(table.references, references, strict=True))
            measured.append(read_file(path, table, name, options))
    return measured


def read_file(path: Path, table: DataTable, name: str, options: dict[str, Any]) -> Record:
    """A record as a table says.

    Args:
        path: of the file.
        table: with its columns.
        name: of the table in the config.
        options: those of `read_record` that the table does not hold.

    Raises:
        ValueError: those of `read_record`, with the file.
    """
    assert table.inputs is not None
    assert table.outputs is not None
    assert table.references is not None
    try:
        return read_record(
            path,
            time=table.time,
            inputs=[*table.inputs, *table.references],
            outputs=list(table.outputs),
            sample_period=table.sample_period,
            scale=dict(table.scale),
            units=dict(table.units),
            unwrap=dict(table.unwrap),
            burn_in=table.burn_in,
            mask_faults=table.mask_faults,
            max_gigabytes=table.max_gigabytes,
            sheet=table.sheet,
            empty_repeats=table.empty_repeats,
            missing=table.missing,
            late=dict(table.late),
            impulses=table.impulses,
            **options,
        )
    except ValueError as error:
        _check_columns(table, name, path)
        if path.name in str(error):
            raise
        raise ValueError(f"{error} File: {path}.") from error


def _check_columns(table: DataTable, name: str, path: Path) -> None:
    """A file that could not be read as described must have the columns of the references."""
    assert table.references is not None
    if not table.references:
        return
    columns = read_table(path, table.max_gigabytes, table.sheet).columns
    rule = f"must be columns of {path} (present: {', '.join(columns)})"
    advice = "Name the column of each reference of [controller] there."
    for column in table.references:
        check(column in columns, f"{name}.references", rule, column, advice)


def _path_of(file: str, name: str, folder: Path, data: Path | None) -> Path:
    """Path of a file: in the folder `data`, else beside the config, else in $EOI_DATA."""
    variable = os.environ.get(DATA_VARIABLE)
    roots = [data] if data else [folder, *([Path(variable)] if variable else [])]
    for root in roots:
        with contextlib.suppress(OSError, ValueError):  # not a valid file name
            if (root / file).is_file():
                return root / file
    candidates = " nor ".join(str(root / file) for root in roots)
    candidates = f"neither {candidates}" if len(roots) > 1 else candidates
    advice = f"Give their folder by --data or ${DATA_VARIABLE}."
    for root in roots:
        with contextlib.suppress(OSError, ValueError):
            names = [path.name for path in (root / file).parent.iterdir()]
            close = difflib.get_close_matches(Path(file).name, names, n=1)
            advice = f"Did you mean {Path(file).with_name(close[0])}? {advice}" if close else advice
    check(False, f"{name}.files", "must be files that exist", candidates, advice)
    raise FileNotFoundError(candidates)  # not reached


# -- simulated records ------------------------------------------------------------------------

_SIGNALS: dict[type, Callable[..., Any]] = {
    SquareTable: excitation.square,
    PrbsTable: excitation.prbs,
    ChirpTable: excitation.chirp,
    MultisineTable: excitation.multisine,
    StepsTable: excitation.steps,
    RandomStepsTable: excitation.random_steps,
}


def _simulated(name: str, table: SimulateTable, model: Plant, field: str) -> Record:
    """The record simulated with the signals of a field of [simulate]."""
    drive = getattr(table, field)
    count = table.duration / table.sample_period
    check(
        count < 1e8,
        "simulate.duration",
        "must be less than 1e8 samples long",
        table.duration,
        "Choose a longer sample period.",
    )
    time = np.arange(round(count) + 1) * table.sample_period
    check(
        set(drive) == set(model.inputs),
        f"simulate.{field}",
        f"must have one table for each of the inputs {', '.join(model.inputs)}",
        ", ".join(drive) or "none",
    )
    signals = [_signal(drive[key], time, f"{field}.{key}") for key in model.inputs]
    record = simulate(
        _with_effects(table, model.with_parameters(_truth(table, model))),
        time,
        np.stack(signals, axis=1),
        initial=_initial(table, model),
        internal=_internal(table, model),
        name=name,
    )
    return _measured(record, table, model)


def _signal(table: Any, time: np.ndarray, name: str) -> np.ndarray:
    arguments = msgspec.structs.asdict(table)
    offset = arguments.pop("offset", 0.0)
    try:
        return offset + _SIGNALS[type(table)](time, **arguments)
    except ValueError as error:
        raise ValueError(f"[simulate.{name}] {error}") from None


def _truth(table: SimulateTable, model: Plant) -> dict[str, float]:
    # With effects the true parameters may equal the declared ones.
    missing = not table.effects and not table.truth and not table.increments
    check(
        not missing and not (table.truth and table.increments),
        "simulate",
        "must have one of the tables `truth` and `increments`",
        "neither" if missing else "both",
    )
    for field in ("truth", "increments"):
        for key in getattr(table, field):
            check_choice(f"simulate.{field}", key, model.names)
    nominal = model.parameters
    return table.truth or {key: nominal[key] + add for key, add in table.increments.items()}


def _with_effects(table: SimulateTable, model: Plant) -> Plant:
    """The plant with the effects of [simulate]."""
    placed: list[Placed] = []
    values: dict[str, float] = {}
    for name, value in table.effects.items():
        forms = _forms("simulate.effects", name)
        fitting = placements(model, forms)
        field = f"simulate.effects.{name}"
        check(len(fitting) > 0, field, "must be an effect that fits the plant", model.name)
        parts = value if isinstance(value, dict) else {"": value}
        names = [parameter.name for parameter in fitting[0].effect.parameters]
        rule = "must be a number" if names == [""] else f"must be a table of {', '.join(names)}"
        check(set(parts) == set(names), field, rule, value)
        placed.append(fitting[0])
        values |= {key: parts[part] for key, part in zip(fitting[0].names, names, strict=True)}
    return augmented(model, placed, values)


def _forms(field: str, name: str) -> list[AbstractEffect]:
    """All effects with a canonical name."""
    library = standard()
    check_choice(field, name, dict.fromkeys(effect.name for effect in library))
    return [effect for effect in library if effect.name == name]


def _initial(table: SimulateTable, model: Plant) -> np.ndarray:
    """Outputs and their derivatives at the start, shape (r, ny)."""
    start = np.nan_to_num(model.known_start)
    free = free_start_names(model)
    for name, value in table.initial.items():
        check_choice("simulate.initial", name, (*model.outputs, *free))
        if name in free:
            continue
        values = np.atleast_1d(value)
        j = model.outputs.index(name)
        most = counted(model.degrees[j], "value")
        check(
            len(values) <= model.degrees[j],
            f"simulate.initial.{name}",
            f"must have at most {most}: the output and its derivatives",
            list(values),
            "" if model.degrees[j] else "It is a function of the states; these start in [model].",
        )
        start[: len(values), j] = values
    return start


def _internal(table: SimulateTable, model: Plant) -> np.ndarray | None:
    """Internal states at the start, of a model with free ones; those of effects start at zero."""
    starts = {name: float(np.ravel(value)[0]) for name, value in table.initial.items()}
    advice = "Write [simulate.initial] {} = VALUE."
    values = internal_starts(model, starts, "simulate.initial", advice)
    added = len(_with_effects(table, model).initial_internal) - len(values)
    return np.concatenate([values, np.zeros(added)]) if any(model.free_internal) else None


def _measured(record: Record, table: SimulateTable, model: Plant) -> Record:
    """The record as measured: with white noise, then rounded to the step of the sensor."""
    if not table.noise and not table.quantisation:
        return record
    for field in ("noise", "quantisation"):
        for key in getattr(table, field):
            check_choice(f"simulate.{field}", key, model.outputs)
    draw = np.random.default_rng(table.seed)
    outputs = np.array(record.outputs)
    for j, name in enumerate(model.outputs):
        outputs[:, j] += table.noise.get(name, 0.0) * draw.standard_normal(len(outputs))
        step = table.quantisation.get(name, 0.0)
        if step > 0:
            outputs[:, j] = step * np.round(outputs[:, j] / step)
    return Record(
        record.time,
        record.inputs,
        outputs,
        name=record.name,
        input_names=record.input_names,
        output_names=record.output_names,
        units=record.units,
        hold=record.hold,
    )
