"""Correlation of free-run errors with themselves and with the inputs, with bounds."""

from typing import Any

import numpy as np

from eoi_jax.report.decimate import decimate
from eoi_jax.report.free_runs import FreeRuns
from eoi_jax.report.style import (
    WIDTH,
    fix_theme,
    new_figure,
    series,
    shortened,
    text_colour,
    themed,
)
from eoi_jax.simulation.residual_correlation import error_correlation


@themed()
def residual_correlation_figure(content: FreeRuns, max_channels: int = 3) -> Any:
    """Autocorrelation of each error, and its correlation with each input, with 99 % bounds.

    Args:
        content: free runs with their measurement.
        max_channels: outputs, and inputs, that have panels.

    Returns:
        A `matplotlib.figure.Figure`; the bounds are those of the last run.
    """
    outputs = content.outputs[:max_channels]
    inputs = content.record.input_names[:max_channels]
    count = len(outputs) * (1 + len(inputs))
    columns = min(count, 2)
    rows = -(-count // columns)
    figure = new_figure(WIDTH, 0.6 + 1.9 * rows, nested=True)
    panels = iter(figure.subplots(rows, columns, squeeze=False).ravel())
    first = None
    for j, output in enumerate(outputs):
        axes = next(panels)
        first = first or axes
        _draw(axes, content, j, None)
        title = "autocorrelation" if len(outputs) == 1 else f"{output}: autocorrelation"
        axes.set_title(shortened(title))
        for k, name in enumerate(inputs):
            axes = next(panels)
            _draw(axes, content, j, k)
            axes.set_title(shortened(f"with {name}" if len(outputs) == 1 else f"{output}, {name}"))
    for axes in panels:
        axes.set_visible(False)
    handles, labels = first.get_legend_handles_labels()  # type: ignore[union-attr]
    figure.legend(handles, labels, loc="outside upper right", ncols=3)
    return fix_theme(figure)


def _draw(axes: Any, content: FreeRuns, j: int, k: int | None) -> None:
    """One correlation of output `j`: with itself, or with input `k`."""
    bound = np.nan
    for run in content.runs:
        function, period = error_correlation(content.record, run.outputs, j, k)
        lags = function.lags * period
        points = decimate(lags, function.values)
        axes.plot(*points, color=series(run.colour), linewidth=0.9, label=run.label)
        bound = function.bound
    axes.axhspan(-bound, bound, color=text_colour(), alpha=0.15, linewidth=0, label="99 % bounds")
    axes.axhline(0.0, color=text_colour(), linewidth=0.5)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel("lag [s]")
