"""A diagnosis as sentences, as a table and as a figure: no numerical work."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from eoi_jax._checks import counted, percent
from eoi_jax._status import Status
from eoi_jax.discovery.diagnosis import Cross, Diagnosis, Map
from eoi_jax.report.style import (
    ACCENT,
    BASE,
    WIDE,
    WIDTH,
    fix_theme,
    injection_unit,
    logarithmic,
    new_figure,
    series,
    text_colour,
    themed,
    with_unit,
)
from eoi_jax.report.tables import columns


def findings(diagnosis: Diagnosis, status: Status) -> tuple[str, ...]:
    """The findings of a diagnosis in sentences, the most important first.

    Args:
        diagnosis: with any `findings`, which are not used.
        status: how the estimate ended.

    Returns:
        Sentences; a single one if there is no finding.
    """
    if not np.any(np.isfinite(diagnosis.residual_rms)):
        return (f"No sample was scored, so there is nothing to diagnose. {status.message}.",)
    sentences = [] if status.ok else [f"There is no valid estimate: {status.message}."]
    for finder in (
        saturation,
        sliding,
        residual,
        delays,
        feedback,
        confounding,
        windows,
        lines,
        quantisation,
        colour,
    ):
        sentences += finder(diagnosis)
    return tuple(sentences) or (
        "No findings: noise of the records and discretisation explain the residual.",
    )


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """Findings, a table of the outputs and one of the maps.

    Args:
        diagnosis: of `diagnose`.

    Returns:
        Several lines of at most about 100 characters.
    """
    rows = [("output", "residual", "noise floor", "more than noise", "whiteness p", "unit")]
    for j, name in enumerate(diagnosis.outputs):
        rows.append(
            (
                name,
                f"{diagnosis.residual_rms[j]:.3g}",
                f"{diagnosis.noise_floor[j]:.3g}",
                "yes" if diagnosis.more_than_noise[j] else "no",
                _probability(diagnosis.whiteness[j]),
                _unit(diagnosis, j),
            )
        )
    maps = [("residual of", "against", "explained", "statistic", "p", "")]
    for residual_map in diagnosis.maps:
        values = (
            percent(residual_map.explained),
            f"{residual_map.statistic:.3g}",
            _probability(residual_map.p_value),
        )
        mark = "strongest" if _is_strongest(diagnosis, residual_map) else ""
        maps.append((residual_map.output, residual_map.variable, *values, mark))
    blocks = [
        "\n".join(f"- {line}" for line in diagnosis.findings),
        columns(rows, "<>><><"),
        columns(maps, "<<>>><") if diagnosis.maps else "",
    ]
    return "\n\n".join(block for block in blocks if block)


@themed()
def diagnosis_figure(diagnosis: Diagnosis) -> Any:
    """Maps of each residual, its correlations with the inputs, and the excitation of each window.

    Args:
        diagnosis: of `diagnose`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    rows = [
        ([residual_map for residual_map in diagnosis.maps if residual_map.output == name],
         [correlation for correlation in diagnosis.cross if correlation.output == name])
        for name in diagnosis.outputs
    ]  # fmt: skip
    width = max(max(len(maps), len(cross) + 1) for maps, cross in rows)
    figure = new_figure(max(2.4 * width + 0.8, WIDE), 4.4 * len(rows) + 1.8)
    grid = figure.add_gridspec(2 * len(rows) + 1, width)
    for j, (maps, cross) in enumerate(rows):
        first_axes = None
        for i, residual_map in enumerate(maps):
            axes = figure.add_subplot(grid[2 * j, i], sharey=first_axes)
            first_axes = first_axes or axes
            _draw_map(axes, diagnosis, residual_map, first=i == 0)
        _draw_autocorrelation(figure.add_subplot(grid[2 * j + 1, 0]), diagnosis, j)
        for i, correlation in enumerate(cross):
            _draw_cross(figure.add_subplot(grid[2 * j + 1, i + 1]), correlation)
    _draw_windows(figure.add_subplot(grid[-1, :]), diagnosis)
    return fix_theme(figure)


@themed()
def map_figure(diagnosis: Diagnosis, output: str) -> Any:
    """The residual of an output against each variable, two maps in a row, the strongest marked.

    Args:
        diagnosis: of `diagnose`, with maps.
        output: its name.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    maps = [residual_map for residual_map in diagnosis.maps if residual_map.output == output]
    rows = -(-len(maps) // 2)
    figure = new_figure(WIDTH, 0.3 + 1.9 * rows)
    panels = figure.subplots(rows, 2, sharey=True, squeeze=False)
    for i, residual_map in enumerate(maps):
        _draw_map(panels.flat[i], diagnosis, residual_map, first=i % 2 == 0)
    for axes in panels.ravel()[len(maps) :]:
        axes.set_visible(False)
    return fix_theme(figure)


# -- sentences -------------------------------------------------------------------------------


def residual(diagnosis: Diagnosis) -> Iterator[str]:
    """Size of the residual, and the variable that it depends on most."""
    for j, name in enumerate(diagnosis.outputs):
        rms, floor = diagnosis.residual_rms[j], diagnosis.noise_floor[j]
        unit = with_space(_unit(diagnosis, j))
        strongest = diagnosis.strongest[j]
        dependence = "no dependence on a measured variable is significant"
        if strongest is not None:
            dependence = (
                f"it depends most on {strongest.variable}, whose bins explain "
                f"{percent(strongest.explained)} of its power "
                f"(p {_probability(strongest.p_value)})"
            )
        mean, error = diagnosis.offset[j], diagnosis.offset_error[j]
        if diagnosis.more_than_noise[j]:
            yield (
                f"The residual of {name} is more than noise: {rms:.3g}{unit} rms, of which the "
                f"noise explains {floor:.3g}; {dependence}."
            )
        elif strongest is not None:
            size = f"within the noise in size ({rms:.3g}{unit})"
            yield f"The residual of {name} is {size}, but {dependence}."
        if abs(mean) > max(4.0 * error, diagnosis.method_floor[j]):
            yield f"The residual of {name} has a mean of {mean:.3g} ± {error:.2g}{unit}."


def delays(diagnosis: Diagnosis) -> Iterator[str]:
    """Inputs that act with a delay."""
    for cross in diagnosis.cross:
        if np.isfinite(cross.delay):
            yield (
                f"{cross.input} seems to act on {cross.output} with a delay of about "
                f"{cross.delay:.3g} s: the residual has the form that a delay (or a lag of the "
                "actuator) causes."
            )


def feedback(diagnosis: Diagnosis) -> Iterator[str]:
    """Inputs that are computed from an output."""
    for cross in diagnosis.cross:
        if cross.feedback:
            yield (
                f"{cross.input} seems to be computed from {cross.output}: its future values "
                f"are correlated with the residual (p {_probability(cross.future_p_value)}). "
                "Under feedback, noise biases the estimate."
            )


def saturation(diagnosis: Diagnosis) -> Iterator[str]:
    """Channels that saturate."""
    for limit in diagnosis.saturation:
        unit = with_space(diagnosis.units.get(limit.channel, ""))
        yield (
            f"{limit.channel} of {limit.record} saturates: it stops at {limit.level:.6g}{unit}, "
            f"where {percent(limit.share)} of its samples lie. "
            + (_INPUT_AT_LIMIT if limit.channel in diagnosis.inputs else _OUTPUT_AT_LIMIT)
        )


_OUTPUT_AT_LIMIT = "Mask those samples, or model the limit."
_INPUT_AT_LIMIT = (
    "If that is what acts, as the output of a controller at its limit, nothing is wrong; if its "
    "sensor ends there, what acts is not known."
)


def sliding(diagnosis: Diagnosis) -> Iterator[str]:
    """Observers that leave sliding mode."""
    for name, share in zip(diagnosis.outputs, diagnosis.sliding_fraction, strict=True):
        if share < 0.9:
            yield (
                f"The observer of {name} is in sliding mode in only {share:.0%} of the scored "
                "steps: elsewhere its injection is not the model error. Increase its relay gain."
            )


def confounding(diagnosis: Diagnosis) -> Iterator[str]:
    """Parameters that cannot be distinguished."""
    for pair in diagnosis.confounded:
        yield (
            f"{pair.first} and {pair.second} are confounded: their estimates are correlated by "
            f"{pair.correlation:.4f}. Fix one, or excite the plant so that they differ."
        )
    if diagnosis.worst_combination:
        yield f"The least certain combination of parameters is {diagnosis.worst_combination}."


def windows(diagnosis: Diagnosis) -> Iterator[str]:
    """Windows with little excitation."""
    poor = [window for window in diagnosis.windows if window.poor]
    if poor:
        intervals = ", ".join(
            f"{window.record} {window.start:.4g}–{window.stop:.4g} s" for window in poor[:4]
        )
        remainder = f" and {len(poor) - 4} more" if len(poor) > 4 else ""
        share = f"{len(poor)} of {counted(len(diagnosis.windows), 'window')}"
        yield (
            f"There is no excitation in {share} ({intervals}{remainder}): the plant hardly moves, "
            "and they carry almost no information."
        )


def lines(diagnosis: Diagnosis) -> Iterator[str]:
    """Outputs with a spectral line that no input drives."""
    for line in diagnosis.lines:
        unit = with_space(diagnosis.units.get(line.output, ""))
        yield (
            f"{line.output} of {line.record} contains a line at {line.frequency:.4g} rad/s "
            f"({line.frequency / (2.0 * np.pi):.4g} Hz) of {line.rms:.2g}{unit} rms that no input "
            "drives: hum of the sensor, or a vibration. It makes up "
            f"{line.share:.0%} of the residual."
        )


def quantisation(diagnosis: Diagnosis, share: float = 0.5) -> Iterator[str]:
    """Outputs with more than this share of quantisation in the standard deviation of the noise."""
    for name, noise, step in zip(
        diagnosis.outputs, diagnosis.noise, diagnosis.quantum, strict=True
    ):
        if step / np.sqrt(12.0) > share * noise > 0:
            unit = with_space(diagnosis.units.get(name, ""))
            yield (
                f"{name} is quantised in steps of {step:.4g}{unit}, which cause most of its noise "
                f"({noise:.3g}); it is not white while the signal changes slowly."
            )


def colour(diagnosis: Diagnosis) -> Iterator[str]:
    """Residuals that are as small as the noise but not white."""
    for j, name in enumerate(diagnosis.outputs):
        if not diagnosis.white[j] and not diagnosis.more_than_noise[j]:
            yield (
                f"The residual of {name} is within the noise in size, but it is not white "
                f"(p {_probability(diagnosis.whiteness[j])}): the noise is coloured, or the model "
                "lacks a small effect."
            )


def _is_strongest(diagnosis: Diagnosis, residual_map: Map) -> bool:
    return any(
        best is not None
        and (best.output, best.variable) == (residual_map.output, residual_map.variable)
        for best in diagnosis.strongest
    )


def _unit(diagnosis: Diagnosis, j: int) -> str:
    return injection_unit(diagnosis.units.get(diagnosis.outputs[j]), diagnosis.degrees[j])


def with_space(unit: str) -> str:
    """A unit with a space before it; empty without a unit."""
    return f" {unit}" if unit else ""


def _probability(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.2g}" if value >= 1e-4 else "< 1e-4"


# -- panels ----------------------------------------------------------------------------------


def _draw_map(axes: Any, diagnosis: Diagnosis, residual_map: Map, first: bool) -> None:
    colour = series(ACCENT if _is_strongest(diagnosis, residual_map) else BASE)
    low, high = residual_map.mean - residual_map.band, residual_map.mean + residual_map.band
    axes.fill_between(residual_map.centre, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(residual_map.centre, residual_map.mean, ".-", color=colour)
    axes.axhline(0.0, color=text_colour(), linewidth=0.5)
    unit = diagnosis.units.get(
        residual_map.variable, "s" if residual_map.variable == "time" else ""
    )
    axes.set_xlabel(with_unit(residual_map.variable, unit))
    strongest = ": the strongest" if _is_strongest(diagnosis, residual_map) else ""
    axes.set_title(f"explains {percent(residual_map.explained)}{strongest}")
    if first:
        unit = _unit(diagnosis, diagnosis.outputs.index(residual_map.output))
        axes.set_ylabel(f"residual of\n{with_unit(residual_map.output, unit)}")
    else:
        axes.tick_params(labelleft=False)


def _stem(axes: Any, x: np.ndarray, y: np.ndarray) -> None:
    axes.vlines(x, 0.0, y, color=series(BASE), linewidth=1.0)
    axes.plot(x, y, ".", color=series(BASE))
    axes.axhline(0.0, color=text_colour(), linewidth=0.5)


def _draw_autocorrelation(axes: Any, diagnosis: Diagnosis, j: int) -> None:
    values = diagnosis.autocorrelation[j]
    _stem(axes, np.arange(1, len(values) + 1), values)
    axes.set_xlabel("lag [thinned samples]")
    axes.set_ylabel("autocorrelation,\nwhitened")
    axes.set_title(f"whiteness p {_probability(diagnosis.whiteness[j])}")


def _draw_cross(axes: Any, correlation: Cross) -> None:
    _stem(axes, correlation.lags, correlation.correlation)
    axes.axvline(0.0, color=text_colour(), linewidth=0.5)
    axes.set_xlabel(f"residual after {correlation.input} [s]")
    axes.set_title(f"cross-correlation p {_probability(correlation.p_value)}")


def _draw_windows(axes: Any, diagnosis: Diagnosis) -> None:
    number = np.arange(1, len(diagnosis.windows) + 1)
    poor = np.asarray([window.poor for window in diagnosis.windows], dtype=bool)
    # Excitation spans decades; zero has no logarithm.
    values = np.asarray([max(window.excitation, 1e-9) for window in diagnosis.windows])
    axes.plot(number[~poor], values[~poor], "o", color=series(BASE))
    axes.plot(number[poor], values[poor], "o", color=series(ACCENT))
    logarithmic(axes.yaxis)
    axes.axhline(
        max(diagnosis.excitation, 1e-9), color=text_colour(), linewidth=0.8, linestyle="--"
    )
    axes.set_xlabel("window (dashed: all records; second colour: little excitation)")
    axes.set_ylabel("excitation")
