"""Contents of the report of a run, from the files of its folder: no numerical work."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import diagnosis as diagnoses
from eoi_jax.report import discovery, discovery_figures, estimate_figures, figures
from eoi_jax.report.health import Check, health
from eoi_jax.report.tables import (
    highest_derivative,
    parameter_rows,
    quantity,
    refined_rows,
    validation_rows,
)
from eoi_jax.simulation.validate import Validation
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

_MAX_OUTPUTS = 3  # outputs with maps and tiles of their own


@dataclass(frozen=True)
class Tile:
    """A key number with its label and a note, e.g. the value to compare it with."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Table:
    """Cells below a header; `numeric` are the right-aligned columns."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class ReportFigure:
    """A figure with its title and a caption; `figure` draws it."""

    name: str
    title: str
    caption: str
    figure: Callable[[], Any]


@dataclass(frozen=True)
class Contents:
    """The parts of a report that differ between kinds of runs.

    Attributes:
        tiles, tables, figures, checks: in the order of the page.
        final_tables: tables at the end of the page.
        notes: sentences.
        added: whether the equation contains terms that were added.
    """

    tiles: tuple[Tile, ...]
    tables: tuple[Table, ...]
    figures: tuple[ReportFigure, ...]
    final_tables: tuple[Table, ...] = ()
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()
    added: bool = field(default=False)


def discovery_contents(result: Discovery, extra: Mapping[str, Any]) -> Contents:
    """The report of `discover`.

    Args:
        result: of the run, with or without its model.
        extra: the ``diagnosis`` of the final fit.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    tables = []
    if result.changed:
        rows = discovery.change_rows(result)
        tables.append(_table("Parameters before and after", rows, (1, 2, 3, 4, 5)))
    else:
        tables.append(_table("Parameters", parameter_rows(result.declared), (1, 2, 3, 4)))
    tables += [
        _table(f"Points of {rows[0][1]}", rows, (0, 1, 2)) for rows in discovery.curve_rows(result)
    ]
    rows = discovery.error_rows(result)
    title = "Errors before and after" if result.changed else "Errors"
    tables.append(_table(title, rows, (1, 2, 3) if result.changed else (1,)))
    rows = discovery.candidate_rows(result)
    final_tables: tuple[Table, ...] = ()
    if rows:
        text = "" if not result.ambiguous_with else (
            "These records support equally well: "
            f"{', '.join(result.ambiguous_with)}. "
            f"{result.advice}"
        )  # fmt: skip
        final_tables = (_table("Other candidates", rows, (2, 3), text),)
    diagnosis: Diagnosis = extra["diagnosis"]
    return Contents(
        _discovery_tiles(result),
        tuple(tables),
        (*_discovery_figures(result), *_maps(diagnosis)),
        final_tables,
        health(diagnosis, searched=True),
        tuple(filter(None, [discovery.lead(result), *result.notes])),
        added=bool(result.added),
    )


def identification_contents(result: Identification, extra: Mapping[str, Any]) -> Contents:
    """The report of `identify`.

    Args:
        result: of the run.
        extra: its ``diagnosis``, and its ``validation`` on held-out records or None.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    validation: Validation | None = extra["validation"]
    tables = [_table("Parameters", parameter_rows(result), (1, 2, 3, 4))]
    if validation is not None:
        tables.append(
            _table("Free run on held-out records", validation_rows(validation), (1, 2, 3))
        )
    ratio = f"injection over {highest_derivative(result.plant)}"
    tiles = [
        Tile(f"Unexplained in {name}", f"{100 * share:.2g} %", ratio)
        for name, share in zip(result.plant.outputs, result.unexplained, strict=True)
    ]
    tiles = [*_fits(validation), *tiles][: 2 * _MAX_OUTPUTS]
    report_figures = [_data(result.records), _injection(result), _index([(result, "")])]
    if validation is not None:
        report_figures.append(
            _free_run(partial(figures.validation_figure, validation), "the estimate")
        )
    report_figures += _estimates(uncertainty(result), result.nominal.parameters)
    report_figures += _maps(extra["diagnosis"])
    notes = (*result.reasons, *result.notes, *(validation.notes if validation is not None else ()))
    checks = health(extra["diagnosis"])
    return Contents(tuple(tiles), tuple(tables), tuple(report_figures), (), checks, notes)


def refinement_contents(result: Refinement, extra: Mapping[str, Any]) -> Contents:
    """The report of `refine`.

    Args:
        result: of the run.
        extra: ``start`` (the identification that it started from) with its ``diagnosis``;
            ``before`` and ``after``, free runs on held-out records or None.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    start: Identification = extra["start"]
    units = result.plant.units
    tiles = [
        Tile(
            f"Free-run error of {name}",
            quantity(rmse, units.get(name, "")),
            f"before {quantity(initial_rmse, units.get(name, ''))}",
        )
        for name, initial_rmse, rmse in zip(
            result.plant.outputs, result.before, result.rmse, strict=True
        )
    ]
    tables = [_table("Parameters before and after", refined_rows(result), (1, 2, 3))]
    for label, validation in (("before", extra["before"]), ("refined", extra["after"])):
        if validation is not None:
            title = f"Free run on held-out records, {label}"
            tables.append(_table(title, validation_rows(validation), (1, 2, 3)))
    report_figures = [_data(start.records)]
    if result.records:
        runs = partial(estimate_figures.refined_runs_figure, result)
        report_figures.append(_free_run(runs, "both estimates"))
    if extra["after"] is not None:
        held_out = partial(figures.validation_figure, extra["after"])
        report_figures.append(_free_run(held_out, "the refined estimate", "held_out"))
    report_figures += _estimates(uncertainty(result), result.nominal.parameters)
    report_figures += [_index([(start, "")]), _injection(start)]
    return Contents(
        tuple(tiles),
        tuple(tables),
        tuple(report_figures),
        (),
        health(extra["diagnosis"]),
        tuple(result.notes),
    )


# -- numbers ----------------------------------------------------------------------------------


def _table(
    title: str, rows: Sequence[Sequence[str]], numeric: tuple[int, ...], text: str = ""
) -> Table:
    """Rows with the header first; an empty last column is dropped."""
    cells = [tuple(row) for row in rows]
    if not any(row[-1] for row in cells[1:]):
        cells = [row[:-1] for row in cells]
    head = list(cells[0])
    if not head[0]:
        head[0] = "error"
    if not head[-1]:
        head[-1] = "remark"
    return Table(title, tuple(head), tuple(cells[1:]), numeric, text)


def _discovery_tiles(result: Discovery) -> tuple[Tile, ...]:
    tiles = []
    declared, augmented, windowed = discovery.compared_runs(result)
    if declared is not None and augmented is not None:
        data = ("same data" if result.in_sample else "held-out data") + ", windows" * windowed
        for j, name in enumerate(declared.outputs[:_MAX_OUTPUTS]):
            declared_error, augmented_error = (
                quantity(run.rmse[j], run.units[j]) if np.isfinite(run.rmse[j]) else "diverges"
                for run in (declared, augmented)
            )
            note = f"before {declared_error}" if result.changed else ""
            tiles.append(Tile(f"Free-run error of {name}, {data}", augmented_error, note))
    if result.explained > 0.0:
        share = f"{100 * result.explained:.3g} %"
        tiles.append(Tile("Explained", share, "of the residual's power above the noise"))
    effects = ", ".join(effect.sentence.partition(":")[0] for effect in result.added)
    tiles.append(Tile("Added", effects or "nothing"))
    return tuple(tiles)


def _fits(validation: Validation | None) -> list[Tile]:
    if validation is None:
        return []
    rows = zip(validation.outputs, validation.fit, validation.rmse, validation.units, strict=True)
    return [
        Tile(f"Free run of {name}, held out", f"{fit:.4g} %", f"error {quantity(rmse, unit)}")
        for name, fit, rmse, unit in rows
        if np.isfinite(rmse)
    ]


# -- figures ----------------------------------------------------------------------------------


def _discovery_figures(result: Discovery) -> list[ReportFigure]:
    declared, final = result.declared, result.found
    effect = (
        "Dots are means over bins of equally many samples. The line is the part that the added "
        "terms explain: where it passes through the dots, they explain the residual."
        if result.added
        else "Dots are means over bins of equally many samples. A trend that exceeds the noise "
        "indicates what the model lacks."
    )
    variable = "the variable of the effect" if result.added else "all variables"
    against = f"Residual against {variable}"
    pair = [(declared, "before"), (final, "after")] if result.changed else [(declared, "")]
    report_figures = [
        ReportFigure("effect", against, effect,
              partial(discovery_figures.effect_figure, result)),
        ReportFigure("residual", "Residual over time",
              "The equivalent injection less the part that other parameters could explain.",
              partial(discovery_figures.residual_figure, result)),
    ]  # fmt: skip
    if result.before is not None:
        final_model = "augmented" if result.added else "refined"
        models = (
            f"the declared and the {final_model} model" if result.changed else "the declared model"
        )
        report_figures.append(_free_run(partial(discovery_figures.free_run_figure, result), models))
    report_figures += [_injection(declared), _index(pair)]
    report_figures += _estimates(uncertainty(final), declared.parameters if result.changed else {})
    report_figures.append(_data(declared.records))
    if result.held_out and not result.in_sample:
        report_figures.append(_data(result.held_out, "held_out_data", "held out"))
    return report_figures


def _data(records: Sequence[Any], name: str = "data", use: str = "fitted") -> ReportFigure:
    count = f" The first of {len(records)} records." if len(records) > 1 else ""
    purpose = "As used by the fit" if use == "fitted" else "For validation of the fit"
    caption = f"{purpose}.{count}"
    return ReportFigure(name, f"Data, {use}", caption, partial(figures.record_figure, records[0]))


def _injection(result: Identification) -> ReportFigure:
    caption = "The model error at the nominal parameters, and the remaining error in the best pass."
    return ReportFigure("injection", "Injection of the first and best pass", caption,
                 partial(figures.injection_figure, result))  # fmt: skip


def _index(results: Sequence[tuple[Identification, str]]) -> ReportFigure:
    caption = (
        "Power of the injection, eq. (14); the pass with the smallest index gives the estimate."
    )
    return ReportFigure(
        "index", "Index of each pass", caption, partial(figures.index_figure, results)
    )


def _free_run(figure: Callable[[], Any], subject: str, name: str = "free_run") -> ReportFigure:
    caption = f"Simulation of {subject} without feedback from the measurement, and its error."
    return ReportFigure(name, "Free run against measurement", caption, figure)


def _estimates(estimate: Uncertainty, initial: Mapping[str, float]) -> list[ReportFigure]:
    if not np.any(np.isfinite(np.diagonal(estimate.covariance))):
        return []
    intervals = partial(estimate_figures.interval_figure, estimate, initial)
    report_figures = [
        ReportFigure("intervals", "Parameters with 95 % intervals",
              "Each panel has its own scale.", intervals)
    ]  # fmt: skip
    free = sum(error != 0 for error in estimate.standard_errors.values())
    if free > 1:
        caption = (
            "Near ±1 only a combination of the two parameters is determined, not each of them."
        )
        figure = partial(estimate_figures.correlation_figure, estimate)
        report_figures.append(
            ReportFigure("correlation", "Correlation of the estimates", caption, figure)
        )
    return report_figures


def _has_significant_map(diagnosis: Diagnosis) -> bool:
    """Whether a residual exceeds the noise and depends on a measured variable."""
    pairs = zip(diagnosis.strongest, diagnosis.more_than_noise, strict=True)
    return any(bool(exceeds) and strongest is not None for strongest, exceeds in pairs)


def _maps(diagnosis: Diagnosis) -> list[ReportFigure]:
    """Maps of the residual, if one is significant: maps of noise say nothing."""
    if not _has_significant_map(diagnosis):
        return []
    mapped = {residual_map.output for residual_map in diagnosis.maps}
    names = [name for name in diagnosis.outputs if name in mapped]
    return [
        ReportFigure(
            f"map{j}",
            f"Residual of {name} against all measured variables",
            "Means over bins with their 95 % band: a trend shows what the residual depends on.",
            partial(diagnoses.map_figure, diagnosis, name),
        )
        for j, name in enumerate(names[:_MAX_OUTPUTS])
    ]
