"""The action of `eoi export`: a model, its parameters, its estimator, a robot description."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eoi_jax._checks import check, check_choice
from eoi_jax.cli import build, run_folder
from eoi_jax.cli.config import load
from eoi_jax.cli.terminal import Outcome
from eoi_jax.compiler import jax_setup
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.online import online_estimator
from eoi_jax.estimation.online_export import export_estimator
from eoi_jax.models.plant import Plant
from eoi_jax.report.parameter_export import export_parameters
from eoi_jax.report.parameters import LEVEL
from eoi_jax.report.provenance import json_values
from eoi_jax.report.robot_export import export_robot
from eoi_jax.simulation.export import LANGUAGES, suffix_of
from eoi_jax.simulation.export import export as export_model
from eoi_jax.uncertainty.uncertainty import Uncertainty

# A comma in front of the next attribute; others stand between the arguments of a function.
_NEXT = re.compile(r",(?=\s*\w+\s*=(?!=))")


def export(run: Path, language: str | None, target: Path | None, trust: bool = False) -> Outcome:
    """Export the model of a run to another tool.

    Args:
        run: folder of a run, or a file with a model.
        language: one of `LANGUAGES`; None: given by the suffix of `target`.
        target: the file to write; None: ``model.*`` in the folder of the run.
        trust: whether the Python file that defines the model of the run may be executed.

    Returns:
        The outcome.

    Raises:
        ValueError: neither language nor target, no model, or one that the language cannot express.
    """
    jax_setup.configure()
    if target is None:
        rule, advice = "must be given without --output", f"Choose from {', '.join(LANGUAGES)}."
        check(language is not None, "--language", rule, "nothing", advice)
        check_choice("--language", str(language), LANGUAGES)
        target = (run if run.is_dir() else run.parent) / f"model{suffix_of(str(language))}"
    path = export_model(run_folder.result_of_run(run, trust), target, language)
    return Outcome({"model": str(path)}, str(path), path)


def check_single(options: Mapping[str, object]) -> None:
    """Check that one content is asked for: a model, its parameters, an estimator, or a robot.

    Args:
        options: what each option was given.

    Raises:
        ValueError: several were given.
    """
    entries = [name for name, value in options.items() if value]
    check(
        len(entries) < 2, entries[0] if entries else "", "must stand alone", " and ".join(entries)
    )


def check_precision(precision: str | None, estimator: bool) -> None:
    """Check that only an estimator is asked for in a precision.

    Args:
        precision: as given.
        estimator: whether an estimator is asked for.

    Raises:
        ValueError: another content, which is in double precision.
    """
    rule, advice = "must be given with --estimator", "All other files are in double precision."
    check(precision is None or estimator, "--precision", rule, precision, advice)


def estimator(
    run: Path, target: Path | None, precision: str, data: Path | None, trust: bool = False
) -> Outcome:
    """Export the estimator of a run for a loop in real time, as C.

    Args:
        run: folder of a run of `eoi identify` or `eoi discover`.
        target: the file to write; None: ``estimator.c`` in the folder of the run.
        precision: ``"double"`` or ``"single"``.
        data: folder of measured files; None: that of the run's config.
        trust: whether a Python file that the config names may be executed.

    Returns:
        The outcome.

    Raises:
        ValueError: a run without passes, or what `online_estimator` and `export_estimator` refuse.
    """
    jax_setup.configure()
    rule = "must be the folder of a run of `eoi identify` or `eoi discover`"
    check(run.is_dir(), "run", rule, run)
    result = run_folder.result_of_run(run, trust)
    fit = result.found if isinstance(result, Discovery) else result
    check(isinstance(fit, Identification), "run", rule, run)
    config = run / "config.toml"
    with run_folder.quiet_records():
        records = build.records(load(config), fit.nominal, run_folder.folder_of(config), data)
    made = online_estimator(fit, [_driven(fit.plant, record) for record in records])
    path = export_estimator(made, target or run / "estimator.c", precision)
    return Outcome({"estimator": str(path)}, str(path), path)


def _driven(plant: Plant, record: Record) -> Record:
    """The record without the references of a controller, which stand behind the inputs."""
    references = record.input_names[len(plant.inputs) :]
    return record.without_inputs(*references) if references else record


def parameters(run: Path, target: Path | None, trust: bool = False) -> Outcome:
    """Export the parameters of a run with their errors and intervals.

    Args:
        run: folder of a run, or a file with a result or a model.
        target: the file to write; None: ``parameters.json`` in the folder of the run.
        trust: whether the Python file that defines the model of the run may be executed.

    Returns:
        The outcome.

    Raises:
        ValueError: a target of another kind, no result, or one without an answer.
    """
    jax_setup.configure()
    target = target or (run if run.is_dir() else run.parent) / "parameters.json"
    path = export_parameters(run_folder.result_of_run(run, trust), target)
    return Outcome({"parameters": str(path)}, str(path), path)


def robot(
    run: Path, source: Path | None, joints: Sequence[str], target: Path | None, trust: bool = False
) -> Outcome:
    """Export a robot description whose joints have the identified values of a run.

    Args:
        run: folder of a run, or a file with a result or a model.
        source: URDF or MJCF file.
        joints: ``joint:attribute=formula,attribute=formula`` of each joint.
        target: the file to write, which does not exist.
        trust: whether the Python file that defines the model of the run may be executed.

    Returns:
        The outcome: a table of the values.

    Raises:
        ValueError: what `export_robot` refuses, or a joint that is not written as above.
    """
    jax_setup.configure()
    check(source is not None, "--robot", "must be given with --joint", "nothing")
    check(target is not None, "--output", "must be given with --robot", "nothing")
    mapped = _joint_map(joints)
    written = export_robot(run_folder.result_of_run(run, trust), str(source), str(target), mapped)
    summary = {"robot": str(target), "level": LEVEL, "values": _values(written)}
    text = f"{written}\n\n{target}"
    return Outcome(json_values({**summary, "notes": written.unclear}), text, target)


def _joint_map(joints: Sequence[str]) -> dict[str, dict[str, str]]:
    rule = "must be joint:attribute=formula, as in shoulder:damping=b,friction=c"
    check(len(joints) > 0, "--joint", rule, "nothing")
    mapped: dict[str, dict[str, str]] = {}
    for text in joints:
        for number, part in enumerate(_NEXT.split(text)):
            head, equals, formula = part.partition("=")
            name, colon, attribute = head.rpartition(":") if number == 0 else (name, ":", head)
            attribute = attribute.strip()
            good = bool(equals and colon and name and attribute and formula.strip())
            check(good, "--joint", rule, text)
            attributes = mapped.setdefault(name, {})
            check(attribute not in attributes, "--joint", "must set an attribute once", text)
            attributes[attribute] = formula.strip()
    return mapped


def _values(written: Uncertainty) -> dict[str, dict[str, Any]]:
    errors, intervals = written.standard_errors, written.intervals(LEVEL)
    return {
        name: {
            "value": value,
            "standard_error": errors[name],
            "low": intervals[name][0],
            "high": intervals[name][1],
            "unit": written.units[name],
        }
        for name, value in written.parameters.items()
    }
