"""Contents of the report of a run, from the files of its folder: no numerical work."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from eoi_jax._checks import percent
from eoi_jax.discovery.diagnosis import Diagnosis
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.degrees_of_freedom import freedom_notes
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.algebraic_outputs import highest_derivative
from eoi_jax.refinement.result import Refinement
from eoi_jax.report import diagnosis as diagnoses
from eoi_jax.report import discovery, discovery_figures, estimate_figures, figures
from eoi_jax.report.free_runs import FreeRuns, free_run_series, validation_runs, worst_series
from eoi_jax.report.health import Check, health
from eoi_jax.report.parameter_history import CONSTANT, LAYOUT, history_series
from eoi_jax.report.residual_correlation import residual_correlation_figure
from eoi_jax.report.tables import (
    parameter_rows,
    quantity,
    refined_rows,
    validation_rows,
)
from eoi_jax.report.time_series import TimeSeries, time_series_figure
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validation import Validation
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
    """A figure with its title and a caption.

    Attributes:
        name, title, caption: of the figure; the name is unique in the page.
        figure: draws it.
        chart: signals over time that the page also shows as an interactive chart, if any.
    """

    name: str
    title: str
    caption: str
    figure: Callable[[], Any]
    chart: Callable[[], TimeSeries] | None = None


@dataclass(frozen=True)
class Contents:
    """The parts of a report that differ between kinds of runs.

    Attributes:
        tiles, tables, figures, checks: in the order of the page.
        final_tables: tables at the end of the page.
        notes: sentences.
        added: whether the equation contains terms that were added.
        badge: the free-run error over the noise of the sensor; "" where one is unknown.
    """

    tiles: tuple[Tile, ...]
    tables: tuple[Table, ...]
    figures: tuple[ReportFigure, ...]
    final_tables: tuple[Table, ...] = ()
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()
    added: bool = False
    badge: str = ""


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
    rows = discovery.probability_rows(result)
    if rows:
        tables.append(_table("Probability of each effect", rows, (0,), _PROBABILITY))
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
        health(diagnosis, searched=result.status.code, explained=result.explained),
        tuple(filter(None, [discovery.lead(result), *freedom_notes(result.found), *result.notes])),
        added=bool(result.added),
        badge=_error_over_noise(discovery.compared_runs(result)[1], in_sample=result.in_sample),
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
    ratio = f"injection over {highest_derivative(result.plant.degrees)}"
    tiles = [
        Tile(
            f"Unexplained in {name}",
            percent(share) if share <= 1.0 else f"{share:.3g} times all",
            ratio,
        )
        for name, share in zip(result.plant.outputs, result.unexplained, strict=True)
    ]
    tiles = [*_fits(validation), *tiles][: 2 * _MAX_OUTPUTS]
    report_figures = []
    if validation is not None:
        report_figures += _free_runs(validation_runs((validation, "free run")), "the estimate")
    report_figures += [_data(result.records), _injection(result), _index([(result, "")])]
    report_figures += _estimates(uncertainty(result), result.nominal.parameters)
    report_figures += _over_records(result)
    report_figures += _maps(extra["diagnosis"])
    of_runs = validation.notes if validation is not None else ()
    notes = (*result.reasons, *freedom_notes(result), *result.notes, *of_runs)
    checks = health(extra["diagnosis"])
    return Contents(
        tuple(tiles), tuple(tables), tuple(report_figures), (), checks, notes,
        badge=_error_over_noise(validation),
    )  # fmt: skip


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
    report_figures = []
    if result.records:
        runs = estimate_figures.refined_runs(result)
        report_figures += _free_runs(runs, "both estimates")
    held_out = [(run, label) for run, label in ((extra["before"], "before"),
                (extra["after"], "refined")) if run is not None]  # fmt: skip
    if held_out:
        runs = validation_runs(*held_out)
        report_figures += _free_runs(runs, "both estimates on held-out data", "held_out")
    report_figures.append(_data(start.records))
    report_figures += _estimates(uncertainty(result), result.nominal.parameters)
    report_figures += [_index([(start, "")]), _injection(start)]
    return Contents(
        tuple(tiles),
        tuple(tables),
        tuple(report_figures),
        (),
        health(extra["diagnosis"]),
        result.notes,
        badge=_error_over_noise(extra["after"]),
    )


_PROBABILITY = (
    "Of each effect, against the others of the library in its place, and against something else "
    "where more than noise is left."
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
    effects = ", ".join(
        discovery.possibly(added, discovery.described(result, added)) for added in result.added
    )
    tiles.append(Tile("Added", effects or "nothing"))
    return tuple(tiles)


def _error_over_noise(
    run: Validation | None,
    in_sample: bool = False,
    smallest: float = 1e-9,
    largest: float = 1e4,
) -> str:
    """The largest ratio of a free-run error to the noise of its sensor, in words.

    Noise below `smallest` of the signal is that of rounding, not of a sensor; above `largest` the
    number tells nothing more. No error is less than the noise, which the run bounds.
    """
    if run is None or not run.records or not np.all(np.isfinite(run.rmse)):
        return ""
    noise = sensor_noise(run)
    spread = run.rmse / np.maximum(run.nrmse, 1e-300)
    if not np.all(noise > smallest * spread):
        return ""
    ratio = float(np.max(run.rmse / noise))
    number = f"{ratio:.2g}" if ratio < 100 else f"{ratio:.0f}"
    if ratio > largest:
        number = f"more than {largest:.0f}"
    data = "in-sample" if in_sample else "held-out"
    return f"{data} error {number} × sensor noise"


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
    report_figures = []
    runs = discovery_figures.free_runs(result)
    if runs is not None:
        final_model = "augmented" if result.added else "refined"
        models = (
            f"the declared and the {final_model} model" if result.changed else "the declared model"
        )
        report_figures += _free_runs(runs, models)
    report_figures += [
        ReportFigure("effect", against, effect,
              partial(discovery_figures.effect_figure, result)),
        _over_time("residual", "Residual over time",
              "The equivalent injection less the part that other parameters could explain.",
              partial(discovery_figures.residual_series, result)),
    ]  # fmt: skip
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
    content = partial(figures.record_series, records[0])
    return _over_time(name, f"Data, {use}", caption, content)


def _over_time(
    name: str, title: str, caption: str, content: Callable[[], TimeSeries]
) -> ReportFigure:
    """Signals over time: a figure, and a chart in its place where the page runs its script."""
    return ReportFigure(name, title, caption, lambda: time_series_figure(content()), content)


def _injection(result: Identification) -> ReportFigure:
    caption = "The model error at the nominal parameters, and the remaining error in the best pass."
    content = partial(figures.injection_series, result)
    return _over_time("injection", "Injection of the first and best pass", caption, content)


def _over_records(result: Identification) -> list[ReportFigure]:
    """Parameters over time along each record, where they were asked for."""
    history, report_figures = result.history, []
    if history is None:
        return []
    remembered = 1.0 / (1.0 - history.forgetting) if history.forgetting < 1.0 else 0.0
    past = f"about the last {remembered:.0f} samples" if remembered else "all samples so far"
    changes = [drift.sentence for drift in history.drifts] or [CONSTANT]
    caption = f"Recursive least squares, eqs. (12) and (13), from {past}: {'. '.join(changes)}."
    for i, record in enumerate(result.records[: LAYOUT.records]):
        name = "history" if i == 0 else f"history_{i + 1}"
        content = partial(history_series, history, i, record.data_hash)
        title = f"Parameters over time, {record.name}"
        report_figures.append(_over_time(name, title, caption, content))
    return report_figures


def _index(results: Sequence[tuple[Identification, str]]) -> ReportFigure:
    caption = (
        "Power of the injection, eq. (14); the pass with the smallest index gives the estimate."
    )
    return ReportFigure(
        "index", "Index of each pass", caption, partial(figures.index_figure, results)
    )


def _free_runs(runs: FreeRuns, subject: str, name: str = "free_run") -> list[ReportFigure]:
    """The whole run, the window of its largest error, and the correlation of the errors."""
    suffix = ", held out" if name == "held_out" else ""
    caption = f"Simulation of {subject} without feedback from the measurement, and its error."
    title = f"Free run against measurement{suffix}"
    report_figures = [_over_time(name, title, caption, partial(free_run_series, runs))]
    detail = worst_series(runs)
    if detail is not None:
        seconds = f"{detail.time[-1] - detail.time[0] + runs.record.sample_period:.3g}"
        title = f"The worst second{suffix}" if seconds == "1" else f"The worst {seconds} s{suffix}"
        caption = f"Detail from {detail.time[0]:.5g} s, where the error of the answer is largest."
        report_figures.append(_over_time(f"{name}_worst", title, caption, lambda: detail))
    if runs.measured and len(runs.record) > 1:
        caption = (
            "Correlation of the error with itself and with each input, with 99 % bounds. Within "
            "them the error is like white noise and independent of the input. A small error may "
            "exceed them: they judge the form of the error, not its size."
        )
        title = f"Correlation of the free-run error{suffix}"
        figure = partial(residual_correlation_figure, runs)
        report_figures.append(ReportFigure(f"{name}_correlation", title, caption, figure))
    return report_figures


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
