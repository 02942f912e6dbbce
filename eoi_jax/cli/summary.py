"""What a run answers, as one JSON object, with where it came from."""

import platform
from collections.abc import Sequence
from importlib.metadata import version as version_of
from typing import Any

import equinox as eqx
import jax
import msgspec
import numpy as np

from eoi_jax.cli.run_folder import Job
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Added, Discovery, Lead
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.equations.display import equation_latex, equation_lines, equation_text
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.discovery import answer
from eoi_jax.report.sweep import gain_names, statuses
from eoi_jax.report.tables import identification_answer, refinement_answer
from eoi_jax.simulation.validate import Validation
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

SUMMARY_FORMAT = 1


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
        "engine": _fields(result.engine),
        "validation": None if validation is None else _errors(validation),
    }
    return _plain({**summary, **_provenance(given)})


def discovery_summary(given: Job, result: Discovery) -> dict[str, Any]:
    """A discovery as one JSON object.

    Args:
        given: what was asked.
        result: of `discover`.
    """
    declared, added, fitted = result.declared.nominal, result.added, result.declared_part
    summary = {
        **_head(given, "discover", answer(result)),
        "status": _status(result),
        "effects": result.effects,
        "added": _added(added),
        "ranking": [_fields(one) for one in result.ranking],
        "ambiguous_with": result.ambiguous_with,
        "advice": result.advice,
        "explained": result.explained,
        "in_sample": result.in_sample,
        **{
            name: None if getattr(result, name) is None else _errors(getattr(result, name))
            for name in ("before", "after", "windows_before", "windows_after")
        },
        "lead": _lead(result.lead),
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
        "engine": _fields(result.engine),
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
        "engine": _fields(result.engine),
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


def _status(result: Any) -> dict[str, str]:
    return {"code": result.status.code, "message": result.status.message}


def _fields(row: Any) -> dict[str, Any]:
    return dict(vars(row))


def _added(several: Sequence[Added]) -> list[dict[str, Any]]:
    return [{**_fields(one), "effect": one.effect.name} for one in several]


def _lead(one: Lead | None) -> dict[str, Any] | None:
    if one is None:
        return None
    runs = {"after": one.after, "windows_after": one.windows_after}
    return {
        "added": _added(one.added),
        "explained": one.explained,
        **_fit(one.found),
        **{name: None if run is None else _errors(run) for name, run in runs.items()},
    }


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
