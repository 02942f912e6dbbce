"""Time series as compact JSON for the charts of the page.

A signal is stored as integers of 16 bits over its range (five digits), in base64. Of a long signal
the smallest and the largest value of each interval are stored, so that no peak is lost; the browser
reduces them further to what its pixels can show, and shows all of them where it is zoomed.
"""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.report.decimate import extremes
from eoi_jax.report.time_series import Panel, Signal, TimeSeries


@dataclass(frozen=True)
class ChartLimits:
    """What is embedded in a page.

    Attributes:
        values: of all signals together; 2.7 bytes each.
        smallest: values of a signal, however many signals there are.
        excess: shares of the largest range of a panel beyond it that are still stored.
    """

    values: int = 1_000_000
    smallest: int = 4000
    excess: float = 1.0


_LIMITS = ChartLimits()


def chart_data(
    charts: Mapping[str, TimeSeries], limits: ChartLimits = _LIMITS
) -> dict[str, Any] | None:
    """The charts of a page, in the types of JSON.

    Args:
        charts: by the name of their figure.
        limits: of the size.

    Returns:
        ``signals``, each stored once, and ``charts``, which refer to them; None without charts.
    """
    if not charts:
        return None
    count = sum(len(panel.signals) for chart in charts.values() for panel in chart.panels)
    share = max(limits.values // count, limits.smallest)
    signals: dict[tuple[str, float, float], int] = {}
    entries = {}
    for name, chart in charts.items():
        time = chart.time
        size = -(-2 * len(time) // share) if len(time) > share else 1
        entries[name] = {
            "record": chart.record,
            "start": float(time[0]),
            "step": float(time[-1] - time[0]) / max(len(time) - 1, 1),
            "count": len(time),
            "size": size,
            "label": chart.label,
            "panels": [
                _panel(panel, len(time), size, limits.excess, signals) for panel in chart.panels
            ],
        }
    stored = [{"data": data, "low": low, "unit": unit} for data, low, unit in signals]
    return {"signals": stored, "charts": entries}


def _panel(
    panel: Panel, count: int, size: int, excess: float, stored: dict[tuple[str, float, float], int]
) -> dict[str, Any]:
    lowest, highest = panel.limits or (-np.inf, np.inf)
    margin = excess * (highest - lowest)
    lines = []
    for signal in panel.signals:
        values = np.full(count, np.nan)
        values[: len(signal.values)] = signal.values
        # A run that diverges ends where it has left the panel: it would take all the digits.
        values[(values < lowest - margin) | (values > highest + margin)] = np.nan
        encoded = _encoded(values if size == 1 else values[extremes(values, size)])
        lines.append({**_look(signal), "signal": stored.setdefault(encoded, len(stored))})
    return {
        "label": " ".join(panel.label.split("\n")),
        "title": panel.title,
        "limits": panel.limits,
        "height": panel.height,
        "signals": lines,
    }


def _look(signal: Signal) -> dict[str, Any]:
    colour = "--ink" if signal.colour is None else f"--s{signal.colour}"
    return {
        "label": signal.label, "colour": colour, "width": signal.width,
        "dots": signal.dots, "held": signal.held,
    }  # fmt: skip


def _encoded(
    values: np.ndarray, largest: int = 32767, missing: int = -32768
) -> tuple[str, float, float]:
    """Integers in base64, the value of the smallest one, and the step between two of them."""
    finite = np.isfinite(values)
    low, high = (np.min(values[finite]), np.max(values[finite])) if np.any(finite) else (0.0, 0.0)
    unit = float(high / (2 * largest) - low / (2 * largest)) or 1.0
    codes = np.full(len(values), missing, dtype="<i2")
    codes[finite] = np.rint((values[finite] - low) / unit) - largest
    return base64.b64encode(codes.tobytes()).decode(), float(low), unit
