"""Results as plain text: aligned columns, no colours, so that they read the same everywhere."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax.estimation.identify import Identification
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.validate import Validation
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty


def identification_text(result: Identification) -> str:
    """The whole result: status, parameters, index per pass, gains and notes.

    Args:
        result: of `identify`.

    Returns:
        Several lines of at most about 100 characters.
    """
    blocks = [
        f"{result.plant.name}: {result.status}",
        parameter_table(result),
        index_table(result),
        health_table(result),
        f"observer  {_gains(result.observer)}\nlow-pass  {_gains(result.lowpass)}",
        "\n".join(f"- {line}" for line in (*result.reasons, *result.notes, *result.engine.notes)),
    ]
    return "\n\n".join(block for block in blocks if block)


def parameter_table(result: Identification) -> str:
    """A line for each parameter: nominal, estimate, standard error, change [%], unit."""
    return columns(parameter_rows(result), "<>>>><")


def parameter_rows(result: Identification) -> list[tuple[str, ...]]:
    """The cells of `parameter_table`, the header first."""
    nominal, units = result.nominal.parameters, result.plant.units
    rows = [("parameter", "nominal", "estimate", "± std. error", "change", "unit")]
    for name, value in result.parameters.items():
        fixed = name in result.plant.fixed
        error = result.standard_errors.get(name, np.nan)
        rows.append(
            (
                name,
                f"{nominal[name]:.6g}",
                f"{value:.6g}",
                "fixed" if fixed else f"{error:.2g}",
                "" if fixed else _change(nominal[name], value),
                units.get(name, ""),
            )
        )
    return rows


def uncertainty_text(result: Uncertainty, level: float = 0.95) -> str:
    """A line for each parameter with its error and interval; then what cannot be told apart.

    Args:
        result: of `uncertainty`.
        level: of the intervals.
    """
    rows = [("parameter", "estimate", "± std. error", f"{100 * level:.4g} % interval", "", "unit")]
    errors, intervals = result.standard_errors, result.intervals(level)
    for name, value in result.parameters.items():
        low, high = intervals[name]
        unit = result.units.get(name, "")
        if errors[name] == 0:
            rows.append((name, f"{value:.6g}", "fixed", "", "", unit))
        else:
            ends = f"{low:.6g}", f"{high:.6g}"
            rows.append((name, f"{value:.6g}", f"{errors[name]:.2g}", *ends, unit))
    return "\n".join([columns(rows, "<>>>><"), *(f"- {line}" for line in result.unclear)])


def refined_rows(result: Refinement) -> list[tuple[str, ...]]:
    """A row for each parameter before and after its refinement, the header first."""
    rows = [("parameter", "before", "refined", "± std. error", "unit")]
    for name, value in result.parameters.items():
        fixed = name in result.plant.fixed
        error = "fixed" if fixed else f"{result.standard_errors[name]:.2g}"
        before = f"{result.nominal.parameters[name]:.6g}"
        rows.append((name, before, f"{value:.6g}", error, result.plant.units.get(name, "")))
    return rows


def validation_rows(result: Validation) -> list[tuple[str, ...]]:
    """A row for each output with the errors of its free run, the header first."""
    rows = [("output", "rmse", "rmse / std. deviation", "fit [%]", "unit")]
    values = zip(result.outputs, result.rmse, result.nrmse, result.fit, result.units, strict=True)
    for name, rmse, nrmse, fit, unit in values:
        rows.append((name, f"{rmse:.5g}", f"{nrmse:.4f}", f"{fit:.2f}", unit))
    return rows


def identification_answer(result: Identification, validation: Validation | None = None) -> str:
    """How an identification ended, in one sentence.

    Args:
        result: of `identify`.
        validation: on held-out records, if there are any.
    """
    if not result.status.ok:
        return f"No answer: {result.status}"
    count = sum(name not in result.plant.fixed for name in result.parameters)
    samples = sum(len(record) for record in result.records)
    many = f"{count} parameter{'s' if count != 1 else ''}"
    left = 100 * float(np.max(result.unexplained))
    start = (
        f"{many} of {result.plant.name} identified from {samples} samples in pass "
        f"{result.best_pass + 1} of {len(result.index)}; {left:.2g} % of the highest derivative "
        "is left unexplained"
    )
    if validation is None or not np.all(np.isfinite(validation.rmse)):
        return f"{start}."
    return f"{start}, and the free run fits held-out data by {np.min(validation.fit):.4g} %."


def refinement_answer(result: Refinement, after: Validation | None = None) -> str:
    """What a refinement changed, or why it has no answer, in one sentence.

    Args:
        result: of `refine`.
        after: its free run on held-out records, if there are any.
    """
    if not result.status.ok:
        return f"No answer: {result.status}"
    units = result.plant.units
    parts = [
        f"{quantity(old, units.get(name, ''))} before, {quantity(new, units.get(name, ''))} after"
        + (f" ({name})" if len(result.rmse) > 1 else "")
        for name, old, new in zip(result.plant.outputs, result.before, result.rmse, strict=True)
    ]
    end = ""
    if after is not None and np.all(np.isfinite(after.rmse)):
        end = f"; held-out data are fitted by {np.min(after.fit):.4g} %"
    return f"Refined: free-run error of {result.plant.name} {'; '.join(parts)}{end}."


def refinement_text(
    result: Refinement, before: Validation | None = None, after: Validation | None = None
) -> str:
    """The whole result: parameters before and after, intervals, errors of the free runs.

    Args:
        result: of `refine`.
        before: held-out free run with the parameters that it started from, if there is one.
        after: with the refined ones.
    """
    blocks = [str(result), str(uncertainty(result))]
    for name, one in (("before", before), ("refined", after)):
        if one is not None:
            blocks.append(f"Held out, {name}:\n{one}")
    return "\n\n".join(blocks)


def index_table(result: Identification) -> str:
    """The index P of eq. (14) and the increments of each pass, as in the paper's tables.

    Passes count from 1. ``*`` marks the smallest index: the estimate is the nominal value plus
    the increments of the passes *before* it.
    """
    outputs, names = result.plant.outputs, result.plant.names
    rows = [("pass", *(f"P({name})" for name in outputs), *(f"Δ{name}" for name in names))]
    for row, (index, increments) in enumerate(zip(result.index, result.increments, strict=True)):
        mark = "*" if row == result.best_pass else ""
        rows.append(
            (
                f"{row + 1}{mark or ' '}",
                *(f"{value:.4g}" for value in index),
                *(f"{value:.4g}" if np.isfinite(value) else "-" for value in increments),
            )
        )
    return "\n\n".join(columns(part, ">" * len(part[0])) for part in _narrow(rows, len(outputs)))


def health_table(result: Identification) -> str:
    """For each output the share of steps in sliding, and the injection left over y^(r) [%]."""
    rows = [("output", "in sliding", "unexplained")]
    for name, sliding, left in zip(
        result.plant.outputs, result.sliding_fraction, result.unexplained, strict=True
    ):
        rows.append((name, f"{100 * sliding:.4g} %", f"{100 * left:.2g} %"))
    return columns(rows, "<>>")


def _gains(module: Any) -> str:
    """An observer or a filter as its name and gains: ``SecondOrder(c1 17.5, c2 57.2, …)``."""
    shown = []
    for name, value in vars(module).items():
        if isinstance(value, tuple) and value and not np.isscalar(value[0]):
            shown += [_gains(one) for one in value]
        elif isinstance(value, str):
            shown.append(value)
        else:
            numbers = " ".join(f"{one:.4g}" for one in np.atleast_1d(np.asarray(value, float)))
            shown.append(f"{name} {numbers}")
    return f"{type(module).__name__}({', '.join(shown)})"


def _change(nominal: float, value: float) -> str:
    return f"{100 * (value - nominal) / abs(nominal):+.2f} %" if nominal else "new"


def _narrow(rows: list[tuple[str, ...]], outputs: int) -> list[list[tuple[str, ...]]]:
    """Tables of about eight columns; the number of the pass stands in each."""
    head, step = 1 + outputs, max(7 - outputs, 3)
    parts = [[row[: head + step] for row in rows]]
    for start in range(head + step, len(rows[0]), 7):
        parts.append([(row[0], *row[start : start + 7]) for row in rows])
    return parts


def columns(rows: Sequence[Sequence[str]], sides: str) -> str:
    """Rows padded to common widths.

    Args:
        rows: cells, the header first.
        sides: < or > for each column, where its cells stand.
    """
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(row, sides, widths, strict=True)
        ).rstrip()
        for row in rows
    ]
    return "\n".join(lines)


_SMALL = 1e-5  # below that an error has an exponent

# Units that take a prefix, and the prefixes.
_PREFIXED = ("m", "s", "V", "A", "N", "rad", "N m", "N·m", "Pa", "W")
_PREFIXES = ((1e-6, "µ"), (1e-3, "m"), (1.0, ""), (1e3, "k"))


def quantity(value: float, unit: str) -> str:
    """A value with its unit, to three digits, with a prefix: 0.0064 m as ``6.4 mm``.

    Args:
        value: finite.
        unit: only a plain SI unit takes a prefix; "" for none.
    """
    value = float(value)
    if unit not in _PREFIXED or value == 0.0:
        return f"{value:.3g} {unit}".rstrip()
    fitting = [one for one in _PREFIXES if abs(value) >= 0.9995 * one[0]]
    factor, prefix = fitting[-1] if fitting else _PREFIXES[0]
    return f"{value / factor:.3g} {prefix}{unit}"


def with_error(value: float, error: float) -> str:
    """``20.42 ± 0.08``: as many digits as the error leaves, five at most.

    Args:
        value: the estimate.
        error: its standard error; NaN or 0 where it is not known, and then is not shown.
    """
    if not (np.isfinite(error) and error > 0 and np.isfinite(value)):
        return f"{value:.5g}"
    size = np.floor(np.log10(max(abs(value), error)))
    digits = int(min(4 - size, 1 - np.floor(np.log10(error))))
    if digits < 0 or digits > 8:
        return f"{value:.4g} ± {error:.2g}"
    shown = f"{error:.2g}"
    if error >= _SMALL:  # "9.3e-05" would not be read as a small part of the number before it
        shown = np.format_float_positional(float(shown), trim="-")
    return f"{value:.{digits}f} ± {shown}"


def refinement_table(result: Refinement) -> str:
    """Parameters before and after, errors of the runs, and notes."""
    wide = max(len(name) for name in result.parameters)
    units, old = result.plant.units, result.nominal.parameters
    lines = [
        f"{result.plant.name}: {result.status}",
        f"{'parameter':<{wide}}  {'before':>11}  {'refined':>11}  {'± std. error':>12}  unit",
    ]
    for name, value in result.parameters.items():
        fixed = name in result.plant.fixed
        error = "fixed" if fixed else f"{result.standard_errors[name]:.2g}"
        row = f"{name:<{wide}}  {old[name]:>11.6g}  {value:>11.6g}  {error:>12}"
        lines.append(f"{row}  {units.get(name, '')}".rstrip())
    length = "whole records" if result.window is None else f"windows of {result.window:g} s"
    lines.append(f"rmse of {len(result.starts)} run(s), {length}:")
    for name, old_rmse, rmse in zip(result.plant.outputs, result.before, result.rmse, strict=True):
        lines.append(f"  {name}: {old_rmse:.5g} → {rmse:.5g} {units.get(name, '')}".rstrip())
    return "\n".join([*lines, *(f"- {note}" for note in (*result.notes, *result.engine.notes))])


def validation_text(result: Validation) -> str:
    """Errors of the free run, a line for each output; then notes."""
    wide = max(len("output"), *(len(key) for key in result.outputs))
    lines = [
        f"Free run, {len(result.predictions)} record(s), {result.scored} samples scored",
        f"{'output':<{wide}}  {'rmse':>11}  {'nrmse':>8}  {'fit [%]':>8}  unit",
    ]
    rows = zip(result.outputs, result.rmse, result.nrmse, result.fit, result.units, strict=True)
    lines += [
        f"{key:<{wide}}  {rmse:>11.5g}  {nrmse:>8.4f}  {fit:>8.2f}  {unit}".rstrip()
        for key, rmse, nrmse, fit, unit in rows
    ]
    return "\n".join([*lines, *(f"Note: {note}" for note in result.notes)])


def profile_text(result: Profile) -> str:
    """Interval and effective number of samples; then notes."""
    low, high = result.interval
    lines = [
        f"{result.name}: {result.estimate:.6g}, {100 * result.level:.4g} % interval "
        f"{low:.6g} … {high:.6g} {result.unit}".rstrip(),
        f"profile of {len(result.values)} points, {result.samples:.3g} effective samples",
    ]
    return "\n".join([*lines, *(f"- {note}" for note in result.notes)])
