"""The results of a run as one JSON object, with the provenance of its data and versions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from eoi_jax.cli.run_folder import Job
from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.equations.display import equation_latex, equation_lines, equation_text
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.discovery import answer, strengths
from eoi_jax.report.provenance import describe_record, json_values, versions
from eoi_jax.report.saved_models import LargestCorrelation
from eoi_jax.report.sweep import gain_names, statuses
from eoi_jax.report.tables import identification_answer, refinement_answer
from eoi_jax.simulation.validation import Validation
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

SUMMARY_FORMAT = 1


def identification_summary(
    job: Job, result: Identification, validation: Validation | None
) -> dict[str, Any]:
    """An identification as one JSON object.

    Args:
        job: model and records of the config.
        result: of `identify`.
        validation: on the held-out records, if there are any.
    """
    summary = {
        **_head(job, "identify", identification_answer(result, validation)),
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
        "common_factors": [_fields(factor) for factor in result.common_factors],
        "drifts": [_fields(drift) for drift in result.history.drifts] if result.history else [],
        "validation": None if validation is None else _errors(validation),
    }
    return json_values({**summary, **_provenance(job, result.records)})


def discovery_summary(job: Job, result: Discovery) -> dict[str, Any]:
    """A discovery as one JSON object.

    Args:
        job: model and records of the config.
        result: of `discover`.
    """
    declared, added, fitted = result.declared.nominal, result.added, result.declared_part
    summary = {
        **_head(job, "discover", answer(result)),
        "status": _status(result),
        "effects": result.effects,
        "added": _added(added),
        "at_input": _at_input(result),
        "ranking": [_fields(evidence) for evidence in result.ranking],
        "ambiguous_with": result.ambiguous_with,
        "advice": result.advice,
        "explained": result.explained,
        "in_sample": result.in_sample,
        **{
            name: None if getattr(result, name) is None else _errors(getattr(result, name))
            for prefix in ("", "test_")
            for name in (
                f"{prefix}{run}" for run in ("before", "after", "windows_before", "windows_after")
            )
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
        "common_factors": [_fields(factor) for factor in result.common_factors],
    }
    return json_values({**summary, **_provenance(job, result.found.records)})


def refinement_summary(
    job: Job,
    start: Identification,
    initial_run: Validation | None,
    result: Refinement,
    refined_run: Validation | None,
) -> dict[str, Any]:
    """A refinement as one JSON object.

    Args:
        job: model and records of the config.
        start: of `identify`, from which it started.
        initial_run: its free run on the held-out records, if there are any.
        result: of `refine`.
        refined_run: its free run on the held-out records, if there are any.
    """
    summary = {
        **_head(job, "refine", refinement_answer(result, refined_run)),
        "status": _status(result),
        "parameters": result.parameters,
        "standard_errors": result.standard_errors,
        **(_uncertainties(uncertainty(result)) if result.status.ok else {}),
        "nominal": job.model.parameters,
        "units": result.plant.units,
        "outputs": result.plant.outputs,
        "equation": _equation(result.plant, ()),
        "rmse": dict(zip(result.plant.outputs, result.rmse, strict=True)),
        "rmse_before": dict(zip(result.plant.outputs, result.before, strict=True)),
        "starts": [_fields(start_point) for start_point in result.starts],
        "steps": result.steps,
        "window": result.window,
        "in_loop": result.in_loop,
        "notes": result.notes,
        "engine": _fields(result.engine),
        "common_factors": [_fields(factor) for factor in result.common_factors],
        "identified": {"status": _status(start), **_fit(start)},
        "validation": {
            name: None if validation is None else _errors(validation)
            for name, validation in (("before", initial_run), ("refined", refined_run))
        },
    }
    return json_values({**summary, **_provenance(job, result.records)})


def _uncertainties(estimate: Uncertainty) -> dict[str, Any]:
    return {
        "intervals": estimate.intervals(),
        "correlation": estimate.correlation,
        "degrees_of_freedom": dict(
            zip(estimate.parameters, estimate.degrees_of_freedom.tolist(), strict=True)
        ),
        "unclear": estimate.unclear,
    }


def sweep_summary(job: Job, result: Any, best: Any) -> dict[str, Any]:
    """A sweep as one JSON object.

    Args:
        job: model and records of the config.
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
        "name": job.settings.name,
        "finished": bool(result.attrs["finished"]),
        "lanes": int(result["status"].size),
        "statuses": statuses(result),
        "engine": result.attrs["engine"],
        "float32_error": {
            key: value for key, value in result.attrs.items() if str(key).startswith("float32")
        },
        "best": lane,
    }
    return json_values({**summary, **_provenance(job)})


def validation_summary(
    name: str,
    run: Path,
    full_runs: Validation,
    windows: Validation | None,
    correlations: Sequence[LargestCorrelation],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """A saved model on data files as one JSON object.

    Args:
        name: of the run.
        run: its folder.
        full_runs: free runs along whole records.
        windows: the same in windows, if there are any.
        correlations: of the errors.
        notes: on the records.
    """
    return json_values(
        {
            "format": SUMMARY_FORMAT,
            "kind": "validate",
            "name": name,
            "run": str(run),
            "validation": _errors(full_runs),
            "windows": None if windows is None else _errors(windows),
            "correlations": _correlations(correlations),
            "notes": list(notes),
            "records": [describe_record(record) for record in full_runs.records],
            "versions": versions(),
        }
    )


def prediction_summary(
    name: str, run: Path, record: Record, initial: Mapping[str, Any], notes: Sequence[str]
) -> dict[str, Any]:
    """A prediction from planned inputs as one JSON object; the numbers are in `prediction.csv`.

    Args:
        name: of the run.
        run: its folder.
        record: the inputs, as they were read.
        initial: outputs at the start, and their derivatives as far as known, by name.
        notes: on the start and the inputs.
    """
    return json_values(
        {
            "format": SUMMARY_FORMAT,
            "kind": "predict",
            "name": name,
            "run": str(run),
            "initial": dict(initial),
            "notes": list(notes),
            "records": [describe_record(record)],
            "versions": versions(),
        }
    )


def comparison_summary(
    runs: Sequence[Path],
    validations: Sequence[Validation],
    correlations: Sequence[Sequence[LargestCorrelation]],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Several saved models on the same records as one JSON object.

    Args:
        runs: folder of each.
        validations: its free runs.
        correlations: of its errors.
        notes: on the records and the comparison.
    """
    models = [
        {"run": str(run), "validation": _errors(validation), "correlations": _correlations(rows)}
        for run, validation, rows in zip(runs, validations, correlations, strict=True)
    ]
    return json_values(
        {
            "format": SUMMARY_FORMAT,
            "kind": "compare",
            "models": models,
            "notes": list(notes),
            "records": [describe_record(record) for record in validations[0].records],
            "versions": versions(),
        }
    )


def _correlations(rows: Sequence[LargestCorrelation]) -> list[dict[str, Any]]:
    return [{**row._asdict(), "inside": row.is_inside} for row in rows]


def _head(job: Job, kind: str, sentence: str) -> dict[str, Any]:
    return {
        "format": SUMMARY_FORMAT,
        "kind": kind,
        "name": job.settings.name,
        "answer": sentence,
    }


def _equation(model: Plant, added: Sequence[Any]) -> dict[str, Any]:
    """The equations in every form; their lines in LaTeX, with added terms as separate items."""
    names, values = (equation_lines(model, added, numeric=numeric) for numeric in (False, True))
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


def _added(effects: Sequence[Added]) -> list[dict[str, Any]]:
    return [
        {
            **_fields(added),
            "effect": added.effect.name,
            "form": _fields(added.effect),
            "rivals": [_fields(rival) for rival in added.rivals],
        }
        for added in effects
    ]


def _at_input(result: Discovery) -> list[dict[str, Any]]:
    """Strengths of effects in the unit of the input that drives the model."""
    return [
        {
            "parameter": name,
            "input": strength.input,
            "value": value,
            "standard_error": error,
            "unit": strength.unit,
        }
        for name, (strength, value, error) in strengths(result).items()
    ]


def _lead(lead: PartialExplanation | None) -> dict[str, Any] | None:
    if lead is None:
        return None
    runs = {"after": lead.after, "windows_after": lead.windows_after}
    return {
        "added": _added(lead.added),
        "explained": lead.explained,
        **_fit(lead.found),
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
    return {
        **by_output,
        "scored": validation.scored,
        "window": validation.window,
        "in_loop": validation.in_loop,
        "notes": validation.notes,
    }


def _provenance(job: Job, used: Sequence[Record] = ()) -> dict[str, Any]:
    """The data, the versions and the config of the results.

    Args:
        job: with the records as they were read.
        used: those of the fit, with the hold that it has found; none: as they were read.
    """
    kinds = {"records": job.records, "held_out_records": job.held_out, "test_records": job.test}
    by_kind = {key: made_alike(records, job.records, used) for key, records in kinds.items()}
    return {
        **{key: [*map(describe_record, records)] for key, records in by_kind.items()},
        "config": msgspec.to_builtins(job.settings),
        "versions": versions(),
    }
