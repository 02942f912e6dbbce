"""A run of the command: what it takes from a config, what it says as JSON, what it writes."""

import json
import os
import platform
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import msgspec
import numpy as np

from eoi_jax import build
from eoi_jax import config as configs
from eoi_jax.checks import RecordWarning
from eoi_jax.data.record import Record
from eoi_jax.diagnose import diagnose
from eoi_jax.discovery import Discovery
from eoi_jax.identify import Identification
from eoi_jax.inspection import Inspection
from eoi_jax.plants.plant import Plant
from eoi_jax.refinement import Refinement
from eoi_jax.report.discovery import answer, discovery_text
from eoi_jax.report.equation import equation_latex, equation_lines, equation_text
from eoi_jax.report.sweep import gain_names, statuses, sweep_figure
from eoi_jax.report.tables import identification_answer, refinement_answer
from eoi_jax.store import save
from eoi_jax.uncertainty import Uncertainty, uncertainty
from eoi_jax.unfinished import tidied
from eoi_jax.validate import Validation

RESULT = "result.npz"  # the run's result, for `eoi_jax.load`
BESIDE = "report.npz"  # what its report shows beside that
SWEEP = "sweep.json"
SUMMARY_FORMAT = 1


@dataclass(frozen=True)
class Job:
    """What a config stands for.

    Attributes:
        settings: its tables.
        model: the plant with its nominal parameters.
        records: to identify from.
        held_out: not used by the fit; may be empty.
    """

    settings: configs.Config
    model: Plant
    records: list[Record]
    held_out: list[Record]


@contextmanager
def quiet_records() -> Iterator[None]:
    """No warnings about records: what was done to one is in its notes, and those in the result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        yield


def job(settings: configs.Config, folder: Path, data: Path | None) -> Job:
    """The plant and the records of a config.

    Args:
        settings: what was loaded.
        folder: of the config.
        data: folder of measured files; None: `folder`, else $EOI_DATA.

    Raises:
        ValueError: what the config names does not exist or does not fit.
    """
    with quiet_records():
        model = build.plant(settings, folder)
        return Job(
            settings,
            model,
            build.records(settings, model, folder, data),
            build.validation_records(settings, model, folder, data),
        )


# -- as JSON ----------------------------------------------------------------------------------


def identification_summary(
    given: Job, result: Identification, validation: Validation | None
) -> dict[str, Any]:
    """An identification as one JSON object.

    Args:
        given: what was asked.
        result: of `identify`.
        validation: on the held-out records, if there are any.
    """
    summary = {
        **_head(given, "identify", identification_answer(result, validation)),
        "status": _status(result),
        **_fit(result),
        "nominal": result.nominal.parameters,
        "units": result.plant.units,
        "outputs": result.plant.outputs,
        "equation": _equation(result.plant, ()),
        "increments": result.increments,
        "observer": result.observer,
        "lowpass": result.lowpass,
        "reasons": result.reasons,
        "notes": result.notes,
        "validation": None if validation is None else _errors(validation),
    }
    return _plain({**summary, **_provenance(given)})


def discovery_summary(given: Job, result: Discovery) -> dict[str, Any]:
    """A discovery as one JSON object.

    Args:
        given: what was asked.
        result: of `discover`.
    """
    declared, added, fitted = result.declared.nominal, result.added, _declared(result)
    summary = {
        **_head(given, "discover", answer(result)),
        "status": _status(result),
        "effects": result.effects,
        "added": [{**_fields(one), "effect": one.effect.name} for one in added],
        "ranking": [_fields(one) for one in result.ranking],
        "ambiguous_with": result.ambiguous_with,
        "advice": result.advice,
        "explained": result.explained,
        "in_sample": result.in_sample,
        **{
            name: None if getattr(result, name) is None else _errors(getattr(result, name))
            for name in ("before", "after", "windows_before", "windows_after")
        },
        "parameters": result.plant.parameters,
        "standard_errors": result.found.standard_errors,
        "nominal": declared.parameters,
        "units": result.plant.units,
        "outputs": declared.outputs,
        "declared": _fit(result.declared),
        "found": _fit(result.found),
        "observer": result.found.observer,
        "lowpass": result.found.lowpass,
        "equation": _equation(fitted, added),
        "findings": result.diagnosis.findings if result.diagnosis else (),
        "notes": result.notes,
    }
    return _plain({**summary, **_provenance(given)})


def refinement_summary(
    given: Job,
    start: Identification,
    before: Validation | None,
    result: Refinement,
    after: Validation | None,
) -> dict[str, Any]:
    """A refinement as one JSON object.

    Args:
        given: what was asked.
        start: of `identify`, from which it went on.
        before: of that one on the held-out records, if there are any.
        result: of `refine`.
        after: of that one on the held-out records.
    """
    summary = {
        **_head(given, "refine", refinement_answer(result, after)),
        "status": _status(result),
        "parameters": result.parameters,
        "standard_errors": result.standard_errors,
        **(_sure(uncertainty(result)) if result.status.ok else {}),
        "nominal": given.model.parameters,
        "units": result.plant.units,
        "outputs": result.plant.outputs,
        "equation": _equation(result.plant, ()),
        "rmse": dict(zip(result.plant.outputs, result.rmse, strict=True)),
        "rmse_before": dict(zip(result.plant.outputs, result.before, strict=True)),
        "starts": [_fields(one) for one in result.starts],
        "steps": result.steps,
        "window": result.window,
        "notes": result.notes,
        "identified": {"status": _status(start), **_fit(start)},
        "validation": {
            name: None if one is None else _errors(one)
            for name, one in (("before", before), ("refined", after))
        },
    }
    return _plain({**summary, **_provenance(given)})


def _sure(known: Uncertainty) -> dict[str, Any]:
    return {
        "intervals": known.intervals(),
        "correlation": known.correlation,
        "degrees_of_freedom": dict(
            zip(known.parameters, known.degrees_of_freedom.tolist(), strict=True)
        ),
        "unclear": known.unclear,
    }


def sweep_summary(given: Job, result: Any, best: Any) -> dict[str, Any]:
    """A sweep as one JSON object.

    Args:
        given: what was asked.
        result: of `sweep`.
        best: its best lane, if any lane has an answer.
    """
    lane = None
    if best is not None:
        gains = {name: best[name].values for name in ("kind", *gain_names(result)) if name in best}
        names = [str(name) for name in best["parameter"].values]
        estimates = {
            str(record): {
                key: dict(zip(names, best[key].sel(record=record, resample=0).values, strict=True))
                for key in ("parameters", "standard_error")
            }
            for record in best["record"].values
        }
        cutoff = best["cutoff"].values if "cutoff" in best.coords else None
        lane = {
            "criterion": best.attrs["criterion"],
            "score": float(best["score"]),
            "observer": gains,
            "cutoff": cutoff,
            "start": int(best["start"]),
            "records": estimates,
        }
    summary = {
        "name": given.settings.name,
        "finished": bool(result.attrs["finished"]),
        "lanes": int(result["status"].size),
        "statuses": statuses(result),
        "engine": result.attrs["engine"],
        "float32_error": {
            key: value for key, value in result.attrs.items() if str(key).startswith("float32")
        },
        "best": lane,
    }
    return _plain({**summary, **_provenance(given)})


def _head(given: Job, kind: str, sentence: str) -> dict[str, Any]:
    return {
        "format": SUMMARY_FORMAT,
        "kind": kind,
        "name": given.settings.name,
        "answer": sentence,
    }


def _equation(model: Plant, added: Sequence[Any]) -> dict[str, Any]:
    """The equations in every form; their lines, with what was added apart, in LaTeX."""
    names, values = (equation_lines(model, added, numeric=one) for one in (False, True))
    return {
        "text": equation_text(model, added),
        "values": equation_text(model, added, numeric=True),
        "latex": equation_latex(model, added),
        "lines": {"names": names[0], "values": values[0]},
        "changes": {"names": names[1], "values": values[1]},
    }


def _declared(result: Discovery) -> Plant:
    """The declared model with its parameters as they are beside the effects."""
    model = result.declared.nominal
    return model.with_parameters({name: result.plant.parameters[name] for name in model.names})


def _status(result: Any) -> dict[str, str]:
    return {"code": result.status.code, "message": result.status.message}


def _fields(row: Any) -> dict[str, Any]:
    return dict(vars(row))


def _fit(result: Identification) -> dict[str, Any]:
    return {
        "parameters": result.parameters,
        "standard_errors": result.standard_errors,
        "index": result.index,
        "best_pass": result.best_pass + 1,
        "sliding_fraction": result.sliding_fraction,
    }


def _errors(validation: Validation) -> dict[str, Any]:
    """Free-run errors by output."""
    by_output = {
        error: dict(zip(validation.outputs, getattr(validation, error), strict=True))
        for error in ("rmse", "nrmse", "fit")
    }
    return {**by_output, "scored": validation.scored, "notes": validation.notes}


def _provenance(given: Job) -> dict[str, Any]:
    """From which data, by which versions, asked how."""
    return {
        "records": [_described(record) for record in given.records],
        "held_out_records": [_described(record) for record in given.held_out],
        "config": msgspec.to_builtins(given.settings),
        "versions": {
            "eoi_jax": version_of("eoi_jax"),
            "jax": jax.__version__,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
    }


def _described(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "samples": len(record.time),
        "sample_period": record.sample_period,
        "hash": record.data_hash,
        "notes": record.notes,
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


# -- as files ---------------------------------------------------------------------------------


def write_identification(
    folder: Path,
    result: Identification,
    validation: Validation | None,
    summary: dict[str, Any],
    config: str,
) -> None:
    """`result.json`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Args:
        folder: an empty one.
        result: of `identify`.
        validation: on the held-out records, if there are any.
        summary: of `identification_summary`.
        config: text of the config, with the command that was given above it.
    """
    from eoi_jax.report.figures import identification_figure

    _write_json(folder / "result.json", summary)
    identification_figure(result).savefig(folder / "figure.png")
    result.save(folder / RESULT)
    save({"diagnosis": diagnose(result), "validation": validation}, folder / BESIDE)
    (folder / "config.toml").write_text(config, encoding="utf-8")


def write_refinement(
    folder: Path,
    result: Refinement,
    beside: dict[str, Any],
    summary: dict[str, Any],
    text: str,
    config: str,
) -> None:
    """`result.json`, `report.txt`, `figure.png`, `result.npz`, `report.npz` and `config.toml`.

    Args:
        folder: an empty one.
        result: of `refine`.
        beside: ``start``, the identification it went on from; ``before`` and ``after``, free runs
            on the held-out records, or None.
        summary: of `refinement_summary`.
        text: of `refinement_text`.
        config: text of the config, with the command that was given above it.
    """
    _write_json(folder / "result.json", summary)
    (folder / "report.txt").write_text(text + "\n", encoding="utf-8")
    result.plot().savefig(folder / "figure.png")
    result.save(folder / RESULT)
    save({**beside, "diagnosis": diagnose(beside["start"])}, folder / BESIDE)
    (folder / "config.toml").write_text(config, encoding="utf-8")


def write_discovery(folder: Path, result: Discovery, summary: dict[str, Any], config: str) -> None:
    """`discovery.json`, `report.txt`, `equation.tex`, three figures, two `.npz`, `config.toml`.

    Args:
        folder: an empty one.
        result: of `discover`.
        summary: of `discovery_summary`.
        config: text of the config, with the command that was given above it.
    """
    from eoi_jax.report.discovery_figures import discovery_figures

    _write_json(folder / "discovery.json", summary)
    (folder / "report.txt").write_text(discovery_text(result) + "\n", encoding="utf-8")
    model = _declared(result)
    forms = (equation_latex(model, result.added, numeric=one) for one in (False, True))
    tex = "\n\n".join(f"\\[\n{form}\n\\]" for form in forms)
    (folder / "equation.tex").write_text(tex + "\n", encoding="utf-8")
    for name, figure in discovery_figures(result).items():
        figure.savefig(folder / f"{name}.png")
    result.save(folder / RESULT)
    last = result.diagnosis if result.diagnosis and not result.added else diagnose(result.found)
    save({"diagnosis": last}, folder / BESIDE)
    (folder / "config.toml").write_text(config, encoding="utf-8")


def write_sweep(
    folder: Path, result: Any, best: Any, summary: dict[str, Any], text: str, config: str
) -> None:
    """`sweep.json`, `report.txt`, `figure.png` and `config.toml`, beside the store of a sweep.

    Args:
        folder: the run's, which holds the store already.
        result: of `sweep`.
        best: its best lane, or None.
        summary: of `sweep_summary`.
        text: of `sweep_text`.
        config: text of the config, with the command that was given above it.
    """
    _write_json(folder / SWEEP, summary)
    (folder / "report.txt").write_text(text + "\n", encoding="utf-8")
    sweep_figure(result, best).savefig(folder / "figure.png")
    (folder / "config.toml").write_text(config, encoding="utf-8")


def write_inspection(folder: Path, found: Inspection, summary: dict[str, Any], text: str) -> None:
    """`inspect.json`, `inspect.txt` and `inspect.png`.

    Args:
        folder: an empty one.
        found: of `inspect`.
        summary: of its `summary`.
        text: for a reader.
    """
    _write_json(folder / "inspect.json", summary)
    (folder / "inspect.txt").write_text(text + "\n", encoding="utf-8")
    found.plot().savefig(folder / "inspect.png")


def replace_file(path: Path, text: str) -> None:
    """Write a file, all or nothing.

    Args:
        path: of the file; its folder is made.
        text: what goes into it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.draft")
    with tidied(lambda: draft.unlink(missing_ok=True)):
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)


def _write_json(path: Path, summary: dict[str, Any]) -> None:
    text = json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


def publish(folder: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder, all or nothing; one that is there is replaced at the very end.

    Args:
        folder: the run's.
        fill: writes into the empty folder that it is given.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = folder.with_name(f".{folder.name}-{os.getpid()}")
    new, old = draft / "new", draft / "old"

    def undo() -> None:
        if old.exists() and not folder.exists():
            old.rename(folder)
        shutil.rmtree(draft, ignore_errors=True)

    with tidied(undo):
        new.mkdir(parents=True)
        fill(new)
        if folder.exists():
            folder.rename(old)
        new.rename(folder)
