"""A diagnosis in sentences, as a table and as a figure: no numerical work."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from eoi_jax._status import Status
from eoi_jax.discovery.diagnosis import Cross, Diagnosis, Map
from eoi_jax.report.style import (
    AFTER,
    BEFORE,
    WIDE,
    WIDTH,
    finished,
    injection_unit,
    ink,
    logarithmic,
    new,
    series,
    styled,
    with_unit,
)
from eoi_jax.report.tables import columns

_BELOW_NOISE = 0.5  # of the noise is quantisation: the noise is called that


def findings(diagnosis: Diagnosis, status: Status) -> tuple[str, ...]:
    """What the numbers of a diagnosis say, the most important first.

    Args:
        diagnosis: its own `findings` are not read.
        status: how the estimate ended.

    Returns:
        Sentences; one alone if nothing was found.
    """
    if not np.any(np.isfinite(diagnosis.residual_rms)):
        return (f"Nothing was scored, so there is nothing to diagnose. {status.message}.",)
    found = [] if status.ok else [f"The estimate is not one: {status.message}."]
    for part in (
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
        found += part(diagnosis)
    return tuple(found) or (
        "Nothing found: the residual is what the noise of the records and discretisation leave.",
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
    for one in diagnosis.maps:
        shown = (f"{100 * one.explained:.2g} %", f"{one.statistic:.3g}", _probability(one.p_value))
        strong = "strongest" if _is_strongest(diagnosis, one) else ""
        maps.append((one.output, one.variable, *shown, strong))
    blocks = [
        "\n".join(f"- {line}" for line in diagnosis.findings),
        columns(rows, "<>><><"),
        columns(maps, "<<>>><") if diagnosis.maps else "",
    ]
    return "\n\n".join(block for block in blocks if block)


@styled()
def diagnosis_figure(diagnosis: Diagnosis) -> Any:
    """Maps of each residual, its correlations with the inputs, and the excitation of each window.

    Args:
        diagnosis: of `diagnose`.

    Returns:
        A `matplotlib.figure.Figure`; save it with ``figure.savefig(path)``.
    """
    rows = [
        ([one for one in diagnosis.maps if one.output == name],
         [one for one in diagnosis.cross if one.output == name])
        for name in diagnosis.outputs
    ]  # fmt: skip
    width = max(max(len(maps), len(cross) + 1) for maps, cross in rows)
    figure = new(max(2.4 * width + 0.8, WIDE), 4.4 * len(rows) + 1.8)
    grid = figure.add_gridspec(2 * len(rows) + 1, width)
    for j, (maps, cross) in enumerate(rows):
        shared = None
        for i, one in enumerate(maps):
            axes = figure.add_subplot(grid[2 * j, i], sharey=shared)
            shared = shared or axes
            _draw_map(axes, diagnosis, one, first=i == 0)
        _draw_autocorrelation(figure.add_subplot(grid[2 * j + 1, 0]), diagnosis, j)
        for i, one in enumerate(cross):
            _draw_cross(figure.add_subplot(grid[2 * j + 1, i + 1]), one)
    _draw_windows(figure.add_subplot(grid[-1, :]), diagnosis)
    return finished(figure)


@styled()
def map_figure(diagnosis: Diagnosis, output: str) -> Any:
    """The residual of one output against everything, two maps in a row, the strongest marked.

    Args:
        diagnosis: of `diagnose`, with maps.
        output: its name.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    maps = [one for one in diagnosis.maps if one.output == output]
    rows = -(-len(maps) // 2)
    figure = new(WIDTH, 0.3 + 1.9 * rows)
    panels = figure.subplots(rows, 2, sharey=True, squeeze=False)
    for i, one in enumerate(maps):
        _draw_map(panels.flat[i], diagnosis, one, first=i % 2 == 0)
    for axes in panels.ravel()[len(maps) :]:
        axes.set_visible(False)
    return finished(figure)


# -- sentences -------------------------------------------------------------------------------


def residual(diagnosis: Diagnosis) -> Iterator[str]:
    """What the residual is, and where it lives."""
    for j, name in enumerate(diagnosis.outputs):
        rms, floor = diagnosis.residual_rms[j], diagnosis.noise_floor[j]
        unit = spaced(_unit(diagnosis, j))
        strongest = diagnosis.strongest[j]
        where = "its maps prove no dependence on what was measured"
        if strongest is not None:
            where = (
                f"it depends most on {strongest.variable}, whose bins explain "
                f"{100 * strongest.explained:.2g} % of its power "
                f"(p {_probability(strongest.p_value)})"
            )
        mean, error = diagnosis.offset[j], diagnosis.offset_error[j]
        if diagnosis.more_than_noise[j]:
            yield (
                f"The residual of {name} is more than noise: {rms:.3g}{unit} rms, of which the "
                f"noise explains {floor:.3g}; {where}."
            )
        elif strongest is not None:
            size = f"within the noise in size ({rms:.3g}{unit})"
            yield f"The residual of {name} is {size}, but {where}."
        if abs(mean) > max(4.0 * error, diagnosis.method_floor[j]):
            yield f"The residual of {name} has a mean of {mean:.3g} ± {error:.2g}{unit}."


def delays(diagnosis: Diagnosis) -> Iterator[str]:
    """Inputs that act late."""
    for one in diagnosis.cross:
        if np.isfinite(one.delay):
            yield (
                f"{one.input} seems to act on {one.output} late, by about {one.delay:.3g} s: the "
                "residual is what such a delay (or a lag of the actuator) leaves."
            )


def feedback(diagnosis: Diagnosis) -> Iterator[str]:
    """Inputs that are computed from an output."""
    for one in diagnosis.cross:
        if one.feedback:
            yield (
                f"{one.input} seems to be computed from {one.output}: inputs still to come are "
                f"correlated with the residual (p {_probability(one.future_p_value)}). Under "
                "feedback, noise biases the estimate."
            )


def saturation(diagnosis: Diagnosis) -> Iterator[str]:
    """Channels that stop at a limit."""
    for one in diagnosis.saturation:
        unit = spaced(diagnosis.units.get(one.channel, ""))
        yield (
            f"{one.channel} of {one.record} stops at {one.level:.6g}{unit}, where {one.share:.2g} "
            "of its samples lie: it saturates. Mask those samples, or model the limit."
        )


def sliding(diagnosis: Diagnosis) -> Iterator[str]:
    """Observers that lose the sliding mode."""
    for name, share in zip(diagnosis.outputs, diagnosis.sliding_fraction, strict=True):
        if share < 0.9:
            yield (
                f"The observer of {name} slides in only {share:.0%} of the scored steps: its "
                "injection is not the model's error elsewhere. Raise its relay."
            )


def confounding(diagnosis: Diagnosis) -> Iterator[str]:
    """Parameters that cannot be told apart."""
    for one in diagnosis.confounded:
        yield (
            f"{one.first} and {one.second} are confounded: their estimates are correlated by "
            f"{one.correlation:.4f}. Fix one, or excite the plant so that they differ."
        )
    if diagnosis.worst_combination:
        yield f"The data say least about {diagnosis.worst_combination}."


def windows(diagnosis: Diagnosis) -> Iterator[str]:
    """Stretches in which the plant hardly moves."""
    poor = [one for one in diagnosis.windows if one.poor]
    if poor:
        shown = ", ".join(f"{one.record} {one.start:.4g}–{one.stop:.4g} s" for one in poor[:4])
        more = f" and {len(poor) - 4} more" if len(poor) > 4 else ""
        share = f"{len(poor)} of {len(diagnosis.windows)} windows"
        yield (
            f"Without excitation in {share} ({shown}{more}): the plant hardly moves, and "
            "they say next to nothing."
        )


def lines(diagnosis: Diagnosis) -> Iterator[str]:
    """Outputs with a hum."""
    for one in diagnosis.lines:
        unit = spaced(diagnosis.units.get(one.output, ""))
        yield (
            f"{one.output} of {one.record} holds a line at {one.frequency:.4g} rad/s "
            f"({one.frequency / (2.0 * np.pi):.4g} Hz) of {one.rms:.2g}{unit} rms that no input "
            "drives: a hum of its sensor, or a vibration. It makes "
            f"{one.share:.0%} of the residual."
        )


def quantisation(diagnosis: Diagnosis) -> Iterator[str]:
    """Outputs whose noise is steps."""
    for name, noise, step in zip(
        diagnosis.outputs, diagnosis.noise, diagnosis.quantum, strict=True
    ):
        if step / np.sqrt(12.0) > _BELOW_NOISE * noise > 0:
            unit = spaced(diagnosis.units.get(name, ""))
            yield (
                f"{name} is quantised in steps of {step:.4g}{unit}, which make most of its noise "
                f"({noise:.3g}): that is not white while the signal moves slowly."
            )


def colour(diagnosis: Diagnosis) -> Iterator[str]:
    """Residuals of the noise's size that are not white."""
    for j, name in enumerate(diagnosis.outputs):
        if not diagnosis.white[j] and not diagnosis.more_than_noise[j]:
            yield (
                f"The residual of {name} is within the noise in size, but not as white noise would "
                f"leave it (p {_probability(diagnosis.whiteness[j])}): the noise is coloured, or "
                "something small is missing."
            )


def _is_strongest(diagnosis: Diagnosis, one: Map) -> bool:
    return any(
        best is not None and (best.output, best.variable) == (one.output, one.variable)
        for best in diagnosis.strongest
    )


def _unit(diagnosis: Diagnosis, j: int) -> str:
    return injection_unit(diagnosis.units.get(diagnosis.outputs[j]), diagnosis.degrees[j])


def spaced(unit: str) -> str:
    """A unit with a space before it; empty for none."""
    return f" {unit}" if unit else ""


def _probability(value: float) -> str:
    if not np.isfinite(value):
        return "–"
    return f"{value:.2g}" if value >= 1e-4 else "< 1e-4"


# -- panels ----------------------------------------------------------------------------------


def _draw_map(axes: Any, diagnosis: Diagnosis, one: Map, first: bool) -> None:
    colour = series(AFTER if _is_strongest(diagnosis, one) else BEFORE)
    low, high = one.mean - one.band, one.mean + one.band
    axes.fill_between(one.centre, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(one.centre, one.mean, ".-", color=colour)
    axes.axhline(0.0, color=ink(), linewidth=0.5)
    unit = diagnosis.units.get(one.variable, "s" if one.variable == "time" else "")
    axes.set_xlabel(with_unit(one.variable, unit))
    strongest = ": the strongest" if _is_strongest(diagnosis, one) else ""
    axes.set_title(f"explains {100 * one.explained:.2g} %{strongest}")
    if first:
        unit = _unit(diagnosis, diagnosis.outputs.index(one.output))
        axes.set_ylabel(f"residual of\n{with_unit(one.output, unit)}")
    else:
        axes.tick_params(labelleft=False)


def _stem(axes: Any, x: np.ndarray, y: np.ndarray) -> None:
    axes.vlines(x, 0.0, y, color=series(BEFORE), linewidth=1.0)
    axes.plot(x, y, ".", color=series(BEFORE))
    axes.axhline(0.0, color=ink(), linewidth=0.5)


def _draw_autocorrelation(axes: Any, diagnosis: Diagnosis, j: int) -> None:
    values = diagnosis.autocorrelation[j]
    _stem(axes, np.arange(1, len(values) + 1), values)
    axes.set_xlabel("lag [thinned samples]")
    axes.set_ylabel("autocorrelation,\nwhitened")
    axes.set_title(f"whiteness p {_probability(diagnosis.whiteness[j])}")


def _draw_cross(axes: Any, one: Cross) -> None:
    _stem(axes, one.lags, one.correlation)
    axes.axvline(0.0, color=ink(), linewidth=0.5)
    axes.set_xlabel(f"residual after {one.input} [s]")
    axes.set_title(f"cross-correlation p {_probability(one.p_value)}")


def _draw_windows(axes: Any, diagnosis: Diagnosis) -> None:
    number = np.arange(1, len(diagnosis.windows) + 1)
    poor = np.asarray([one.poor for one in diagnosis.windows], dtype=bool)
    # From one frequency at a time to a rich signal it spans decades; none at all has no logarithm.
    values = np.asarray([max(one.excitation, 1e-9) for one in diagnosis.windows])
    axes.plot(number[~poor], values[~poor], "o", color=series(BEFORE))
    axes.plot(number[poor], values[poor], "o", color=series(AFTER))
    logarithmic(axes.yaxis)
    axes.axhline(max(diagnosis.excitation, 1e-9), color=ink(), linewidth=0.8, linestyle="--")
    axes.set_xlabel("window (dashed: all together; second colour: the plant hardly moves)")
    axes.set_ylabel("excitation")
