"""Parameters over time: text, and signals over time for figures and charts."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.estimation.parameter_history import ParameterHistory
from eoi_jax.report.style import ACCENT, with_unit
from eoi_jax.report.tables import columns
from eoi_jax.report.time_series import Panel, Signal, TimeSeries, time_series_figure


@dataclass(frozen=True)
class HistoryLayout:
    """What is drawn of parameters over time."""

    deviate: float = 1.96  # of a 95 % interval
    shown: float = 5.0  # standard error over the smallest one, up to which the axis shows it
    records: int = 3  # along which parameters are drawn in a report


LAYOUT = HistoryLayout()


def history_text(history: ParameterHistory) -> str:
    """A line for each parameter with its last estimate, and which are not constant.

    Args:
        history: of `identify(…, recursive=True)`.
    """
    rows = [("parameter", "last estimate", "± std. error", "unit")]
    last, errors = history.values[-1][-1], history.standard_errors[-1][-1]
    for name, value, error, unit in zip(history.names, last, errors, history.units, strict=True):
        rows.append((name, f"{value:.6g}", f"{error:.2g}", unit))
    sentences = [drift.sentence for drift in history.drifts] or [CONSTANT]
    return "\n".join([columns(rows, "<>><"), *(f"- {sentence}" for sentence in sentences)])


CONSTANT = "no parameter is seen to change along the records"


def history_figure(history: ParameterHistory, record: int = 0) -> Any:
    """Each estimated parameter over time with its 95 % interval.

    Args:
        history: of `identify(…, recursive=True)`.
        record: which of the records.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    return time_series_figure(history_series(history, record))


def history_series(history: ParameterHistory, record: int = 0, data_hash: str = "") -> TimeSeries:
    """Each estimated parameter over time with its 95 % interval, a panel for each.

    Args:
        history: of `identify(…, recursive=True)`.
        record: which of the records.
        data_hash: of that record.
    """
    values, errors = history.values[record], history.standard_errors[record]
    panels = []
    for i, (name, unit) in enumerate(zip(history.names, history.units, strict=True)):
        value, error = values[:, i], errors[:, i]
        if np.all(error == 0.0):  # fixed
            continue
        with np.errstate(invalid="ignore"):
            band = np.where(np.isfinite(error), LAYOUT.deviate * error, np.nan)
        lines = (
            Signal("lower end of 95 %", value - band, 0, 0.6),
            Signal("upper end of 95 %", value + band, 0, 0.6),
            Signal("estimate so far", value, ACCENT),
        )
        panels.append(Panel(with_unit(name, unit), lines, 1.6, _range(value, error)))
    return TimeSeries(np.asarray(history.time[record]), tuple(panels), data_hash)


def _range(
    value: Float[np.ndarray, " time"], error: Float[np.ndarray, " time"]
) -> tuple[float, float] | None:
    """Of the intervals that are not much wider than the narrowest: the first are very wide."""
    finite = np.isfinite(value) & np.isfinite(error)
    if not np.any(finite):
        return None
    selected = finite & (error <= LAYOUT.shown * np.min(error[finite]))
    low = float(np.min((value - LAYOUT.deviate * error)[selected]))
    high = float(np.max((value + LAYOUT.deviate * error)[selected]))
    margin = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
    return low - margin, high + margin
