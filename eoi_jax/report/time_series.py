"""Signals over time in panels with a common time axis: described once, drawn here by matplotlib.

`charts.py` writes the same description for the charts of the page.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.report.decimate import decimate
from eoi_jax.report.style import (
    WIDTH,
    fix_theme,
    legend_above,
    limit,
    new_figure,
    series,
    text_colour,
    themed,
)


@dataclass(frozen=True)
class Signal:
    """One line of a panel.

    Attributes:
        label: its name in the legend.
        values: NaN where nothing is drawn; the time after the last value is empty.
        colour: number of the series; None for the colour of text, that of measurements.
        width: of the line [pt].
        dots: whether the samples are dots without a line, e.g. of a slow sensor.
        held: whether a value holds until the next sample.
    """

    label: str
    values: Float[np.ndarray, " drawn"]
    colour: int | None = None
    width: float = 0.9
    dots: bool = False
    held: bool = False


@dataclass(frozen=True)
class Panel:
    """Signals with a common vertical axis.

    Attributes:
        label: of the vertical axis, with the unit.
        signals: in the order in which they are drawn.
        height: [inch] of a figure of the report.
        limits: the largest range of the axis; None: that of the signals.
        title: above the panel.
    """

    label: str
    signals: tuple[Signal, ...]
    height: float
    limits: tuple[float, float] | None = None
    title: str = ""


@dataclass(frozen=True)
class TimeSeries:
    """Panels, one below the other, along one record.

    Attributes:
        time: stamps of the uniform grid of all signals [s].
        panels: from top to bottom.
        record: hash of the record: charts of one record have linked time axes.
        label: of the time axis.
        legend: whether the figure has a legend above the first panel.
    """

    time: Float[np.ndarray, " time"]
    panels: tuple[Panel, ...]
    record: str
    label: str = "time [s]"
    legend: bool = True

    @property
    def height(self) -> float:
        """Height of a figure [inch]."""
        return 1.0 + sum(panel.height for panel in self.panels)


@themed()
def time_series_figure(content: TimeSeries) -> Any:
    """The panels as a figure of the report.

    Args:
        content: what is drawn.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    figure = new_figure(WIDTH, content.height, nested=len(content.panels) > 1)
    draw_time_series(figure, content)
    return fix_theme(figure)


def draw_time_series(figure: Any, content: TimeSeries) -> None:
    """Draw the panels into an empty figure or subfigure."""
    ratios = [panel.height for panel in content.panels]
    axes = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)
    draw_panels(list(axes[:, 0]), content)


def draw_panels(panels: Sequence[Any], content: TimeSeries) -> None:
    """Draw each panel into the axes that are given for it."""
    for axes, panel in zip(panels, content.panels, strict=True):
        for signal in panel.signals:
            _draw_signal(axes, content.time, signal)
        axes.set_ylabel(panel.label)
        axes.set_title(panel.title)
        if panel.limits is not None:
            limit(axes, *panel.limits)
    if content.legend:
        legend_above(panels[0])
    # Not as a title, which the legend would overlap.
    panels[-1].set_xlabel(content.label)


def _draw_signal(axes: Any, time: np.ndarray, signal: Signal) -> None:
    values = np.asarray(signal.values)
    time = time[: len(values)]
    if signal.dots:
        sampled = np.isfinite(values)
        time, values = time[sampled], values[sampled]
    axes.plot(
        *decimate(time, values),
        color=text_colour() if signal.colour is None else series(signal.colour),
        linewidth=signal.width,
        marker="." if signal.dots else "none",
        linestyle="none" if signal.dots else "-",
        drawstyle="steps-post" if signal.held else "default",
        label=signal.label,
    )
