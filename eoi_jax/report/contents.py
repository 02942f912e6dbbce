"""What the report of a run says and shows, from what its folder holds: no numerical work."""

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
from eoi_jax.report.tables import parameter_rows, quantity, refined_rows, validation_rows
from eoi_jax.simulation.validate import Validation
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

_MOST = 3  # outputs whose maps and tiles are shown one by one


@dataclass(frozen=True)
class Tile:
    """One number that matters, with what it is and what to compare it with."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Table:
    """Cells below a header; `numeric` are the columns that stand right."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: tuple[int, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class Shown:
    """A figure with its title and how to read it; `figure` draws it."""

    name: str
    title: str
    caption: str
    figure: Callable[[], Any]


@dataclass(frozen=True)
class Contents:
    """The parts of a report that differ between kinds of runs.

    Attributes:
        tiles, tables, shown, checks: in the order of the page; `beneath` are tables at its end.
        notes: sentences.
        added: whether the equation holds terms that were added.
    """

    tiles: tuple[Tile, ...]
    tables: tuple[Table, ...]
    shown: tuple[Shown, ...]
    beneath: tuple[Table, ...] = ()
    checks: tuple[Check, ...] = ()
    notes: tuple[str, ...] = ()
    added: bool = field(default=False)


def discovery_contents(result: Discovery, beside: Mapping[str, Any]) -> Contents:
    """The report of `discover`.

    Args:
        result: of the run; its model need not be there.
        beside: ``diagnosis`` of the fit that the run ends with.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    tables = []
    if result.added:
        rows = discovery.change_rows(result)
        tables.append(_table("Parameters before and after", rows, (1, 2, 3, 4, 5)))
    else:
        tables.append(_table("Parameters", parameter_rows(result.declared), (1, 2, 3, 4)))
    rows = discovery.error_rows(result)
    title = "Errors before and after" if result.added else "Errors"
    tables.append(_table(title, rows, (1, 2, 3) if result.added else (1,)))
    others = discovery.candidate_rows(result)
    beneath: tuple[Table, ...] = ()
    if others:
        text = "" if not result.ambiguous_with else (
            f"These records do not tell the answer from {', '.join(result.ambiguous_with)}. "
            f"{result.advice}"
        )  # fmt: skip
        beneath = (_table("What else was tried", others, (2, 3), text),)
    diagnosis: Diagnosis = beside["diagnosis"]
    return Contents(
        _discovery_tiles(result),
        tuple(tables),
        (*_discovery_shown(result), *_maps(diagnosis)),
        beneath,
        health(diagnosis, searched=True),
        tuple(filter(None, [discovery.lead(result), *result.notes])),
        added=bool(result.added),
    )


def identification_contents(result: Identification, beside: Mapping[str, Any]) -> Contents:
    """The report of `identify`.

    Args:
        result: of the run.
        beside: its ``diagnosis``, and ``validation`` on held-out records or None.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    validation: Validation | None = beside["validation"]
    tables = [_table("Parameters", parameter_rows(result), (1, 2, 3, 4))]
    if validation is not None:
        tables.append(
            _table("Free run on held-out records", validation_rows(validation), (1, 2, 3))
        )
    tiles = [
        Tile(f"Left of {name}", f"{100 * left:.2g} %", "of what the observer had to explain")
        for name, left in zip(result.plant.outputs, result.unexplained, strict=True)
    ]
    tiles = [*_fits(validation), *tiles][: 2 * _MOST]
    shown = [_data(result.records), _injection(result), _index([(result, "")])]
    if validation is not None:
        shown.append(_free_run(partial(figures.validation_figure, validation), "the estimate"))
    shown += _estimates(uncertainty(result), result.nominal.parameters)
    shown += _maps(beside["diagnosis"])
    notes = (*result.reasons, *result.notes)
    checks = health(beside["diagnosis"])
    return Contents(tuple(tiles), tuple(tables), tuple(shown), (), checks, notes)


def refinement_contents(result: Refinement, beside: Mapping[str, Any]) -> Contents:
    """The report of `refine`.

    Args:
        result: of the run.
        beside: ``start`` (the identification it went on from) with its ``diagnosis``; ``before``
            and ``after``, free runs on held-out records or None.

    Returns:
        Tiles, tables, figures, health checks and notes.
    """
    start: Identification = beside["start"]
    units = result.plant.units
    tiles = [
        Tile(
            f"Free-run error of {name}",
            quantity(after, units.get(name, "")),
            f"before {quantity(before, units.get(name, ''))}",
        )
        for name, before, after in zip(
            result.plant.outputs, result.before, result.rmse, strict=True
        )
    ]
    tables = [_table("Parameters before and after", refined_rows(result), (1, 2, 3))]
    for called, one in (("before", beside["before"]), ("refined", beside["after"])):
        if one is not None:
            title = f"Free run on held-out records, {called}"
            tables.append(_table(title, validation_rows(one), (1, 2, 3)))
    shown = [_data(start.records)]
    if result.records:
        runs = partial(estimate_figures.refined_runs_figure, result)
        shown.append(_free_run(runs, "both estimates"))
    if beside["after"] is not None:
        held_out = partial(figures.validation_figure, beside["after"])
        shown.append(_free_run(held_out, "the refined estimate", "held_out"))
    shown += _estimates(uncertainty(result), result.nominal.parameters)
    shown += [_index([(start, "")]), _injection(start)]
    return Contents(
        tuple(tiles),
        tuple(tables),
        tuple(shown),
        (),
        health(beside["diagnosis"]),
        tuple(result.notes),
    )


# -- numbers ----------------------------------------------------------------------------------


def _table(
    title: str, rows: Sequence[Sequence[str]], numeric: tuple[int, ...], text: str = ""
) -> Table:
    """Rows with the header first; a last column that is empty throughout is left out."""
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
    before, after, short = discovery.told_runs(result)
    if before is not None and after is not None:
        where = ("same data" if result.in_sample else "held-out data") + ", windows" * short
        for j, name in enumerate(before.outputs[:_MOST]):
            old, new = (
                quantity(one.rmse[j], one.units[j]) if np.isfinite(one.rmse[j]) else "diverges"
                for one in (before, after)
            )
            note = f"before {old}" if result.added else ""
            tiles.append(Tile(f"Free-run error of {name}, {where}", new, note))
    if result.explained > 0.0:
        share = f"{100 * result.explained:.3g} %"
        tiles.append(Tile("Explained", share, "of the residual's power above the noise"))
    found = ", ".join(one.sentence.partition(":")[0] for one in result.added)
    tiles.append(Tile("Added", found or "nothing"))
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


def _discovery_shown(result: Discovery) -> list[Shown]:
    declared, found = result.declared, result.found
    effect = (
        "Dots are means of equally many samples. The line is what the added terms took away: where "
        "it goes through the dots, they explain the residual."
        if result.added
        else "Dots are means of equally many samples. A shape above the noise is a lead."
    )
    pair = [(declared, "before"), (found, "after")] if result.added else [(declared, "")]
    shown = [
        Shown("effect", "The residual against what it depends on", effect,
              partial(discovery_figures.effect_figure, result)),
        Shown("residual", "What the model lacks over time",
              "The injection that the observer needs, less what other parameters could do.",
              partial(discovery_figures.residual_figure, result)),
    ]  # fmt: skip
    if result.before is not None:
        which = "the declared and the augmented model" if result.added else "the declared model"
        shown.append(_free_run(partial(discovery_figures.free_run_figure, result), which))
    shown += [_injection(declared), _index(pair)]
    shown += _estimates(uncertainty(found), declared.parameters if result.added else {})
    shown.append(_data(declared.records))
    if result.held_out and not result.in_sample:
        shown.append(_data(result.held_out, "held_out_data", "held out"))
    return shown


def _data(records: Sequence[Any], name: str = "data", what: str = "fitted") -> Shown:
    more = f" The first of {len(records)} records." if len(records) > 1 else ""
    whose = "As the fit used it" if what == "fitted" else "What judges the fit"
    caption = f"{whose}.{more}"
    return Shown(name, f"Data, {what}", caption, partial(figures.record_figure, records[0]))


def _injection(result: Identification) -> Shown:
    caption = "What the model lacked at the nominal parameters, and what is left in the best pass."
    return Shown("injection", "Injection of the first and best pass", caption,
                 partial(figures.injection_figure, result))  # fmt: skip


def _index(results: Sequence[tuple[Identification, str]]) -> Shown:
    caption = "Power of the injection, eq. (14): the pass with the smallest one is the answer."
    return Shown("index", "Index of each pass", caption, partial(figures.index_figure, results))


def _free_run(figure: Callable[[], Any], whose: str, name: str = "free_run") -> Shown:
    caption = f"Simulation of {whose} without feedback from the measurement, and its error."
    return Shown(name, "Free run against measurement", caption, figure)


def _estimates(known: Uncertainty, before: Mapping[str, float]) -> list[Shown]:
    if not np.any(np.isfinite(np.diagonal(known.covariance))):
        return []
    intervals = partial(estimate_figures.interval_figure, known, before)
    shown = [
        Shown("intervals", "Parameters with 95 % intervals",
              "Each panel has a scale of its own.", intervals)
    ]  # fmt: skip
    free = sum(error != 0 for error in known.standard_errors.values())
    if free > 1:
        caption = "Near ±1 the records say only how two parameters go together, not what each is."
        figure = partial(estimate_figures.correlation_figure, known)
        shown.append(Shown("correlation", "Correlation of the estimates", caption, figure))
    return shown


def _is_a_lead(diagnosis: Diagnosis) -> bool:
    """Whether what is left depends on something, and is more than noise."""
    pairs = zip(diagnosis.strongest, diagnosis.more_than_noise, strict=True)
    return any(bool(more) and strongest is not None for strongest, more in pairs)


def _maps(diagnosis: Diagnosis) -> list[Shown]:
    """Where they are leads: maps of noise would only be looked at for nothing."""
    if not _is_a_lead(diagnosis):
        return []
    named = [one for one in diagnosis.outputs if any(m.output == one for m in diagnosis.maps)]
    return [
        Shown(
            f"map{j}",
            f"Residual of {name} against everything measured",
            "Means of bins with their 95 % band: a shape says what the model lacks depends on.",
            partial(diagnoses.map_figure, diagnosis, name),
        )
        for j, name in enumerate(named[:_MOST])
    ]
