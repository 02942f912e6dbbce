"""Results as pandas and xarray objects, for `.to_pandas()` and `.to_xarray()`.

A data frame has the rows of the table that the result prints, as numbers. A dataset has the same
numbers by name and, of results that hold them, the signals: those of all records follow each other
along ``sample``, with the coordinates ``time`` [s] and ``record``.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from eoi_jax.comparison.result import Comparison
from eoi_jax.data.inspection import Inspection
from eoi_jax.data.record import Record
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.parameter_history import ParameterHistory
from eoi_jax.refinement.remaining import Remaining
from eoi_jax.refinement.result import Refinement
from eoi_jax.report.parameters import (
    LEVEL,
    estimate_of,
    parameter_estimates,
    without_covariance,
)
from eoi_jax.simulation.validation import Validation
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty

_SAMPLES = ("sample", "output")


def _frame(names: Sequence[str], rows: Iterable[Sequence[Any]], attributes: dict[str, Any]) -> Any:
    """A data frame of rows, with the first of its columns as index."""
    import pandas as pd

    frame = pd.DataFrame(list(rows), columns=pd.Index(names)).set_index(names[0])
    frame.attrs.update(attributes)
    return frame


def parameter_frame(result: Identification | Refinement | Uncertainty) -> Any:
    """A row for each parameter: estimate, standard error, interval, unit, effect.

    Args:
        result: with an estimate; without an answer its errors are NaN.
    """
    attributes: dict[str, Any] = {"level": LEVEL}
    if isinstance(result, Uncertainty):
        known = result
    else:
        attributes |= {"model": result.plant.name, "status": result.status.code}
        known = estimate_of(result) if result.status.fits else without_covariance(result.plant)
    names = ("parameter", "estimate", "standard_error", "low", "high", "unit", "estimated")
    rows = [
        (row.name, row.value, row.standard_error, row.low, row.high, row.unit, row.estimated,
         row.effect)
        for row in parameter_estimates(result, known)
    ]  # fmt: skip
    frame = _frame((*names, "effect"), rows, attributes)
    if not isinstance(result, Uncertainty):
        nominal = result.nominal.parameters
        frame.insert(0, "nominal", [nominal.get(name, np.nan) for name in frame.index])
    return frame


def history_frame(result: ParameterHistory) -> Any:
    """A row for each sample: record, time [s], the estimates so far and their standard errors.

    Args:
        result: of `identify(…, recursive=True)`; estimates are NaN as long as they are open.
    """
    errors = [f"standard_error[{name}]" for name in result.names]
    signals = zip(result.records, result.time, result.values, result.standard_errors, strict=True)
    rows = (
        (k, record, *row)
        for record, *arrays in signals
        for k, row in enumerate(np.column_stack(arrays))
    )
    units = dict(zip(result.names, result.units, strict=True))
    attributes = {"forgetting": result.forgetting, "units": units}
    return _frame(("sample", "record", "time", *result.names, *errors), rows, attributes)


def validation_frame(result: Validation) -> Any:
    """A row for each output with the errors of its free runs.

    Args:
        result: of `validate`.
    """
    rows = zip(result.outputs, result.rmse, result.nrmse, result.fit, result.units, strict=True)
    attributes = {"scored": result.scored, "window": result.window}
    return _frame(("output", "rmse", "nrmse", "fit", "unit"), rows, attributes)


def discovery_frame(result: Discovery) -> Any:
    """A row for each effect that was tried, the best first, with its evidence by itself.

    Args:
        result: of `discover`.
    """
    added = {(addition.label, addition.position) for addition in result.added}
    rows = []
    for rank, candidate in enumerate(result.ranking, 1):
        label, place = candidate.label, candidate.position
        is_added = (label, place) in added
        # Evidence is of an effect by itself; one that was added acts together with others.
        remark = f"by itself: {candidate.remark}" * (candidate.remark != "")
        evidence = candidate.explained, candidate.score, remark if is_added else candidate.remark
        rows.append((rank, label, place, is_added, *evidence))
    names = ("rank", "effect", "at", "added", "explained", "score", "remark")
    attributes = {"status": result.status.code, "explained": result.explained}
    return _frame(names, rows, attributes)


def remaining_frame(result: Remaining) -> Any:
    """A row for each effect and each pair of two that was tried, with its share of the error.

    Args:
        result: of `remaining`.
    """
    rows = [
        (" + ".join(candidate.names), candidate.share, candidate.significance,
         candidate.significance < result.level)
        for candidate in (*result.ranking, *result.pairs)
    ]  # fmt: skip
    names = ("candidate", "share", "significance", "significant")
    return _frame(names, rows, {"level": result.level})


def comparison_frame(result: Comparison) -> Any:
    """A row for each method: its scores, and its parameters.

    Args:
        result: of `compare`.
    """
    scores, parameters, rows = ("rmse", "windows", "index"), result.plant.names, []
    for entry in result.entries:
        values = entry.parameters or {}
        rows.append((
            entry.method, entry.status.code, entry.seconds, entry.first_seconds,
            *(float(value) for score in scores for value in getattr(entry, score)),
            *(values.get(name, np.nan) for name in parameters),
        ))  # fmt: skip
    names = ["method", "status", "seconds", "first_seconds"]
    names += [f"{score}[{output}]" for score in scores for output in result.plant.outputs]
    names += [f"parameters[{name}]" for name in parameters]
    return _frame(names, rows, {"held_out": result.held_out, "window": result.window})


def diagnosis_frame(result: Diagnosis) -> Any:
    """A row for each output: its residual against the noise.

    Args:
        result: of `diagnose`.
    """
    names = ("residual_rms", "noise_floor", "method_floor", "more_than_noise", "whiteness")
    names += ("white", "offset", "offset_error", "sliding_fraction")
    rows = zip(result.outputs, *(getattr(result, name) for name in names), strict=True)
    attributes = {"level": result.level, "findings": result.findings}
    return _frame(("output", *names), rows, attributes)


def profile_frame(result: Profile) -> Any:
    """A row for each value at which the parameter was held: the statistic.

    Args:
        result: of `profile`.
    """
    names = ("name", "estimate", "standard_error", "threshold", "level", "interval", "unit")
    attributes = {name: getattr(result, name) for name in names}
    rows = zip(result.values, result.statistic, strict=True)
    return _frame(("value", "statistic"), rows, attributes)


def inspection_frame(result: Inspection) -> Any:
    """A row for each column of the file.

    Args:
        result: of `inspect`.
    """
    names = ("kind", "unit", "role", "low", "high", "missing", "noise", "quantum", "band")
    rows = [
        (channel.name, *(getattr(channel, name) for name in names)) for channel in result.channels
    ]
    attributes = {"path": str(result.path), "samples": result.samples}
    return _frame(("column", *names), rows, attributes)


# -- datasets ---------------------------------------------------------------------------------


def identification_dataset(result: Identification) -> Any:
    """Parameters, the passes, and injection and residual over the samples of all records.

    Args:
        result: of `identify`.
    """
    passes = {
        "index": (("pass", "output"), result.index),
        "increments": (("pass", "parameter"), result.increments),
        "parameter_history": (("pass", "parameter"), result.parameter_history),
        "sliding_fraction": ("output", result.sliding_fraction),
        "unexplained": ("output", result.unexplained),
    }
    signals = {
        name: (_SAMPLES, np.concatenate(getattr(result, name)))
        for name in ("injection", "first_injection", "residual")
    }
    dataset = parameter_frame(result).to_xarray().assign({**passes, **signals})
    count = np.arange(1, 1 + len(result.index))
    return _over_samples(dataset, result.records, result.plant.outputs).assign_coords(
        {"pass": count}
    )


def refinement_dataset(result: Refinement) -> Any:
    """Parameters, and the errors of the free runs over the samples of all records.

    Args:
        result: of `refine`.
    """
    dataset = parameter_frame(result).to_xarray().assign(rmse=("output", result.rmse))
    if not result.records:
        return dataset.assign_coords(output=list(result.plant.outputs))
    dataset = dataset.assign(residual=(_SAMPLES, np.concatenate(result.residual)))
    return _over_samples(dataset, result.records, result.plant.outputs)


def validation_dataset(result: Validation) -> Any:
    """Errors, and measured and simulated outputs over the samples of all records.

    Args:
        result: of `validate`.
    """
    dataset = validation_frame(result).to_xarray()
    if not result.records:
        return dataset
    pairs = (("measured", result.records), ("simulated", result.predictions))
    signals = {
        name: (_SAMPLES, np.concatenate([record.known_outputs for record in records]))
        for name, records in pairs
    }
    return _over_samples(dataset.assign(signals), result.records, result.outputs)


def _over_samples(dataset: Any, records: Sequence[Record], outputs: Sequence[str]) -> Any:
    """With the coordinates of its samples and outputs."""
    times = np.concatenate([record.time for record in records])
    names = np.repeat([record.name for record in records], [len(record) for record in records])
    coordinates = {
        "output": list(outputs),
        "time": ("sample", times, {"units": "s"}),
        "record": ("sample", names),
    }
    return dataset.assign_coords(coordinates)
