"""Saved models on records: errors, fit, and correlation of the errors, as tables."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from eoi_jax._checks import counted
from eoi_jax.report.style import shortened
from eoi_jax.report.tables import columns, validation_text
from eoi_jax.simulation.residual_correlation import error_correlation
from eoi_jax.simulation.validation import Validation


class LargestCorrelation(NamedTuple):
    """The largest correlation of the error of a free run over all lags.

    Attributes:
        record: name.
        output: name of the output of the error.
        input: name of the input; None: the error with itself.
        value: with its sign, −1 … 1; NaN where a signal is constant.
        lag: [s]; positive where the error follows the input.
        bound: that independent signals exceed at 1 % of the lags.
        share_outside: share of the lags at which |value| exceeds the bound, 0 … 1.
    """

    record: str
    output: str
    input: str | None
    value: float
    lag: float
    bound: float
    share_outside: float

    @property
    def is_inside(self) -> bool | None:
        """Whether no lag exceeds the bound; None where a signal is constant, or the bound is 1."""
        return None if self.is_open or np.isnan(self.value) else not abs(self.value) > self.bound

    @property
    def is_open(self) -> bool:
        """Whether no correlation can exceed the bound, which is 1 or more of so few samples."""
        return bool(self.bound >= 1.0)


def largest_correlations(result: Validation) -> list[LargestCorrelation]:
    """For each record and output the correlation of the error with itself and with each input.

    Args:
        result: of `validate`, with its records.
    """
    rows = []
    for record, prediction in zip(result.records, result.predictions, strict=True):
        outputs = prediction.known_outputs
        for j, output in enumerate(result.outputs):
            for k in (None, *range(len(record.input_names))):
                function, period = error_correlation(record, outputs, j, k)
                sizes = np.abs(function.values)
                has_values = bool(np.any(np.isfinite(sizes)))
                peak = int(np.nanargmax(sizes)) if has_values else 0
                rows.append(
                    LargestCorrelation(
                        record.name,
                        output,
                        None if k is None else record.input_names[k],
                        float(function.values[peak]),
                        float(function.lags[peak]) * period if has_values else np.nan,
                        function.bound,
                        float(np.mean(sizes > function.bound)) if has_values else np.nan,
                    )
                )
    return rows


def correlation_text(rows: Sequence[LargestCorrelation]) -> str:
    """A line for each correlation: largest value, its lag, the bound, inside or outside.

    Args:
        rows: of `largest_correlations`.
    """
    has_records = len({row.record for row in rows}) > 1
    head = ("error of", "with", "largest", "lag [s]", "99 % bound", "lags outside", "")
    table: list[tuple[str, ...]] = [("record", *head) if has_records else head]
    for row in rows:
        numbers = ("", "", "", "", "one is constant: no correlation")
        if row.is_open:
            numbers = ("", "", "", "", "too few samples to tell: the bound is above 1")
        if row.is_inside is not None:
            numbers = (
                f"{row.value:+.3f}",
                f"{row.lag:.4g}",
                f"± {row.bound:.3f}",
                f"{100 * row.share_outside:.3g} %",
                "inside" if row.is_inside else "outside",
            )
        cells = (row.output, "itself" if row.input is None else row.input, *numbers)
        table.append((row.record, *cells) if has_records else cells)
    legend = "1 % of the lags are outside by chance where the model lacks nothing"
    alignments = f"{'<' * has_records}<<>>>><"
    return f"Correlation of the errors\n{columns(table, alignments)}\n{legend}"


def judgement_text(
    name: str, full_runs: Validation, windows: Validation | None, rows: Sequence[LargestCorrelation]
) -> str:
    """A saved model on new records: errors of free runs, and their correlation.

    Args:
        name: of the model.
        full_runs: free runs along whole records.
        windows: the same in windows; None: there are none.
        rows: of `largest_correlations`.
    """
    blocks = [name, validation_text(full_runs)]
    blocks += [] if windows is None else [validation_text(windows)]
    return "\n\n".join([*blocks, correlation_text(rows)])


def models_text(runs: Sequence[tuple[str, Validation]]) -> str:
    """Fit and error of several models on the same records, a line for each model and output.

    Args:
        runs: name of each model, and its free runs.
    """
    first = runs[0][1]
    rows = [("model", "output", "fit [%]", "rmse", "unit")]
    for j, output in enumerate(first.outputs):
        for name, run in runs:
            cells = (f"{run.fit[j]:.2f}", f"{run.rmse[j]:.5g}", first.units[j])
            rows.append((name, output, *cells))
    length = "whole records" if first.window is None else f"windows of {first.window:g} s"
    records = counted(len(first.records), "record")
    head = f"Free runs of {counted(len(runs), 'model')} on {records}, {length}"
    notes = dict.fromkeys(f"Note: {name}: {note}" for name, run in runs for note in run.notes)
    return "\n".join([head, columns(rows, "<<>><"), *notes])


def labelled(runs: Sequence[tuple[str, Validation]]) -> list[tuple[Validation, str]]:
    """Free runs, each labelled by its model and its fit per cent, for a figure.

    Args:
        runs: name of each model, and its free runs.
    """
    return [
        (run, f"{shortened(name)}: {', '.join(f'{value:.2f}' for value in run.fit)} %")
        for name, run in runs
    ]
