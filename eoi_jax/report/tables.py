"""Results as plain text in aligned columns, without colours."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax._checks import counted, percent, timed
from eoi_jax.data.record import Record
from eoi_jax.estimation.degrees_of_freedom import freedom_notes
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.algebraic_outputs import highest_derivative
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.validation import Validation
from eoi_jax.uncertainty.profile_likelihood import Profile
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty


def identification_text(result: Identification) -> str:
    """An identification as text: status, parameters, index per pass, gains and notes.

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
        f"observer  {gains_text(result.observer)}\nlow-pass  {gains_text(result.lowpass)}",
        "\n".join(f"- {line}" for line in _remarks(result, *result.reasons)),
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
        rows.append(
            (
                name,
                f"{nominal[name]:.6g}",
                f"{value:.6g}",
                error_text(result, name),
                "" if fixed else _change(nominal[name], value),
                units.get(name, ""),
            )
        )
    return rows


def error_text(result: Identification | Refinement, name: str) -> str:
    """The standard error of a parameter; that it is fixed or on a bound, where it has none."""
    plant, error = result.plant, result.standard_errors.get(name, np.nan)
    if name in plant.fixed:
        return "fixed"
    place = plant.names.index(name)
    ends = float(plant.lower[place]), float(plant.upper[place])
    if np.isnan(error) and plant.parameters[name] in ends:
        return "on its bound"
    return f"{error:.2g}"


def uncertainty_text(result: Uncertainty, level: float = 0.95) -> str:
    """A line for each parameter with its error and interval; then notes on ambiguities.

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
        error = error_text(result, name)
        initial = f"{result.nominal.parameters[name]:.6g}"
        rows.append((name, initial, f"{value:.6g}", error, result.plant.units.get(name, "")))
    return rows


def validation_rows(result: Validation) -> list[tuple[str, ...]]:
    """A row for each output with the errors of its free run, the header first."""
    rows = [("output", "rmse", "rmse / std. deviation", "fit [%]", "unit")]
    values = zip(result.outputs, result.rmse, result.nrmse, result.fit, result.units, strict=True)
    for name, rmse, nrmse, fit, unit in values:
        rows.append((name, f"{rmse:.5g}", f"{nrmse:.4f}", f"{fit:.2f}", unit))
    return rows


def _mean_period(records: Sequence[Record]) -> float:
    """The sample period of records; of records that differ, the mean over their samples."""
    return float(np.average([record.sample_period for record in records],
                            weights=[len(record) for record in records]))  # fmt: skip


def identification_answer(result: Identification, validation: Validation | None = None) -> str:
    """The outcome of an identification in one sentence.

    Args:
        result: of `identify`.
        validation: on held-out records, if there are any.
    """
    if not result.status.ok:
        return f"No answer: {result.status}"
    count = sum(name not in result.plant.fixed for name in result.parameters)
    samples = timed(sum(map(len, result.records)), _mean_period(result.records))
    parameters = counted(count, "parameter")
    share, derivative = float(np.max(result.unexplained)), highest_derivative(result.plant.degrees)
    remaining = f"{percent(share)} of the {derivative} remains unexplained"
    if share > 1.0:
        remaining = f"what remains is {share:.3g} times the {derivative}: worse than no model"
    sentence = (
        f"{parameters} of {result.plant.name} identified from {samples} in pass "
        f"{result.best_pass + 1} of {len(result.index)}; {remaining}"
    )
    if validation is None or not np.all(np.isfinite(validation.rmse)):
        return f"{sentence}."
    return f"{sentence}, and {_held_out_fit(validation, 'free-run fit')}."


def _held_out_fit(validation: Validation, fit: str) -> str:
    """The worst fit; a constant output has none."""
    moving = np.isfinite(validation.fit)
    if not np.any(moving):
        return "the held-out data are constant, so that no fit can be told"
    return f"the {fit} to held-out data is {np.min(validation.fit[moving]):.4g} %"


def refinement_answer(result: Refinement, after: Validation | None = None) -> str:
    """The outcome of a refinement in one sentence.

    Args:
        result: of `refine`.
        after: its free run on held-out records, if there are any.
    """
    if not result.status.ok:
        return f"No answer: {result.status}"
    units = result.plant.units
    changes = [
        f"{quantity(initial, units.get(name, ''))} before, "
        f"{quantity(final, units.get(name, ''))} after"
        + (f" ({name})" if len(result.rmse) > 1 else "")
        for name, initial, final in zip(
            result.plant.outputs, result.before, result.rmse, strict=True
        )
    ]
    suffix = ""
    if after is not None and np.all(np.isfinite(after.rmse)):
        suffix = f"; {_held_out_fit(after, 'fit')}"
    return f"Refined: free-run error of {result.plant.name} {'; '.join(changes)}{suffix}."


def refinement_text(
    result: Refinement, initial_run: Validation | None = None, refined_run: Validation | None = None
) -> str:
    """A refinement as text: parameters before and after, intervals, free-run errors.

    Args:
        result: of `refine`.
        initial_run: held-out free run with the initial parameters, if there is one.
        refined_run: with the refined parameters.
    """
    blocks = [str(result), str(uncertainty(result))]
    for name, validation in (("before", initial_run), ("refined", refined_run)):
        if validation is not None:
            blocks.append(f"Held out, {name}:\n{validation}")
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
    return "\n\n".join(
        columns(part, ">" * len(part[0])) for part in _split_columns(rows, len(outputs))
    )


def health_table(result: Identification) -> str:
    """Share of steps in sliding mode, and of the injection that remains over y^(r).

    Where that is more than all of it the equation says less than none would.
    """
    rows = [("output", "in sliding mode", "unexplained")]
    for name, sliding, share in zip(
        result.plant.outputs, result.sliding_fraction, result.unexplained, strict=True
    ):
        text = percent(share) if share <= 1.0 else f"{share:.3g} times all, worse than no model"
        rows.append((name, f"{100 * sliding:.4g} %", text))
    return columns(rows, "<>>")


def gains_text(module: Any) -> str:
    """An observer or a filter as its name and gains: ``SecondOrder(c1 17.5, c2 57.2, …)``."""
    gains = []
    for name, value in vars(module).items():
        if isinstance(value, tuple) and value and not np.isscalar(value[0]):
            gains += [gains_text(part) for part in value]
        elif isinstance(value, str):
            gains.append(value)
        else:
            numbers = " ".join(
                f"{number:.4g}" for number in np.atleast_1d(np.asarray(value, float))
            )
            gains.append(f"{name} {numbers}")
    return f"{type(module).__name__}({', '.join(gains)})"


def _change(nominal: float, value: float) -> str:
    return f"{100 * (value - nominal) / abs(nominal):+.2f} %" if nominal else "new"


def _split_columns(rows: list[tuple[str, ...]], outputs: int) -> list[list[tuple[str, ...]]]:
    """Tables of about eight columns, each with the pass in its first column."""
    head, step = 1 + outputs, max(7 - outputs, 3)
    tables = [[row[: head + step] for row in rows]]
    for start in range(head + step, len(rows[0]), 7):
        tables.append([(row[0], *row[start : start + 7]) for row in rows])
    return tables


def columns(rows: Sequence[Sequence[str]], alignments: str) -> str:
    """Rows padded to common widths.

    Args:
        rows: cells, the header first.
        alignments: < or > for each column.
    """
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            f"{cell:{alignment}{width}}"
            for cell, alignment, width in zip(row, alignments, widths, strict=True)
        ).rstrip()
        for row in rows
    ]
    return "\n".join(lines)


# Units that take a prefix, and the prefixes with their factors.
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
    fitting = [row for row in _PREFIXES if abs(value) >= 0.9995 * row[0]]
    factor, prefix = fitting[-1] if fitting else _PREFIXES[0]
    return f"{value / factor:.3g} {prefix}{unit}"


def with_error(
    value: float,
    error: float,
    exponent_below: float = 1e-5,
    *,
    plain: tuple[int, int] = (-4, 5),
) -> str:
    """``20.42 ± 0.08``: digits that are significant with the error, five at most.

    Both stand in one format, with a common exponent where they are very small or large: 1780 ± 110,
    (1.27 ± 0.27)e-06.

    Args:
        value: the estimate.
        error: its standard error; NaN or 0, where it is not known, is not printed.
        exponent_below: an error below this is printed with an exponent; "9.3e-05" is hard to
            compare with the number before it.
        plain: powers of ten between which numbers have no common exponent.
    """
    if not (np.isfinite(error) and error > 0 and np.isfinite(value)):
        return f"{value:.5g}"
    size = int(np.floor(np.log10(max(abs(value), error))))
    if not plain[0] <= size <= plain[1]:
        return f"({with_error(value / 10.0**size, error / 10.0**size)})e{size:+03d}"
    last_digit = int(np.floor(np.log10(error))) - 1
    digits = min(max(4 - size, 0), -last_digit)
    rounded_error = f"{error:.2g}"
    if error >= exponent_below:
        rounded_error = f"{round(error, -last_digit):.{max(-last_digit, 0)}f}"
    return f"{round(value, digits):.{max(digits, 0)}f} ± {rounded_error}"


def refinement_table(result: Refinement) -> str:
    """Parameters before and after, errors of the runs, and notes."""
    width = max(len(name) for name in result.parameters)
    units, initial = result.plant.units, result.nominal.parameters
    lines = [
        f"{result.plant.name}: {result.status}",
        f"{'parameter':<{width}}  {'before':>11}  {'refined':>11}  {'± std. error':>12}  unit",
    ]
    for name, value in result.parameters.items():
        error = error_text(result, name)
        row = f"{name:<{width}}  {initial[name]:>11.6g}  {value:>11.6g}  {error:>12}"
        lines.append(f"{row}  {units.get(name, '')}".rstrip())
    length = "whole records" if result.window is None else f"windows of {result.window:g} s"
    lines.append(f"rmse of {counted(len(result.starts), 'run')}, {length}:")
    for name, initial_rmse, rmse in zip(
        result.plant.outputs, result.before, result.rmse, strict=True
    ):
        lines.append(f"  {name}: {initial_rmse:.5g} → {rmse:.5g} {units.get(name, '')}".rstrip())
    return "\n".join([*lines, *(f"- {note}" for note in _remarks(result))])


def _remarks(result: Identification | Refinement, *reasons: str) -> tuple[str, ...]:
    of_errors = freedom_notes(result) if isinstance(result, Identification) else ()
    return *reasons, *of_errors, *result.notes, *result.engine.notes


def validation_text(result: Validation) -> str:
    """Errors of the free run, a line for each output; then notes."""
    width = max(len("output"), *(len(key) for key in result.outputs))
    scored = f"{counted(result.scored, 'sample')} ({_scored_time(result):.5g} s)"
    runs = "Free run" if result.window is None else f"Free runs in windows of {result.window:g} s"
    lines = [
        f"{runs}, {counted(len(result.predictions), 'record')}, {scored} scored",
        f"{'output':<{width}}  {'rmse':>11}  {'nrmse':>8}  {'fit [%]':>8}  unit",
    ]
    rows = zip(result.outputs, result.rmse, result.nrmse, result.fit, result.units, strict=True)
    lines += [
        f"{key:<{width}}  {rmse:>11.5g}  {nrmse:>8.4f}  {fit:>8.2f}  {unit}".rstrip()
        for key, rmse, nrmse, fit, unit in rows
    ]
    return "\n".join([*lines, *(f"Note: {note}" for note in result.notes)])


def _scored_time(result: Validation) -> float:
    """Time from the first to the last sample that is measured and scored [s], of all records."""
    if not result.scored_at:  # of an earlier version
        return result.scored * _mean_period(result.predictions)
    total = 0.0
    for i, (mask, record) in enumerate(zip(result.scored_at, result.predictions, strict=True)):
        measured = np.any(result.records[i].output_valid, axis=1) if result.records else True
        (samples,) = np.nonzero(mask & measured)
        span = slice(samples[0], samples[-1] + 1) if samples.size else slice(0)
        total += float(np.sum(mask[span])) * record.sample_period
    return total


def profile_text(result: Profile) -> str:
    """Interval and effective number of samples; then notes."""
    low, high = result.interval
    points = counted(len(result.values), "point")
    lines = [
        f"{result.name}: {result.estimate:.6g}, {100 * result.level:.4g} % interval "
        f"{low:.6g} … {high:.6g} {result.unit}".rstrip(),
        f"profile of {points}, {result.samples:.3g} effective samples",
    ]
    return "\n".join([*lines, *(f"- {note}" for note in result.notes)])
