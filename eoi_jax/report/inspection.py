"""The contents of a data file as a table and as a figure."""

from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import counted, percent, printable
from eoi_jax.data.channel import Channel
from eoi_jax.data.inspection import Inspection, InspectionSettings
from eoi_jax.data.repeats import without_repeats
from eoi_jax.data.resampling import fill
from eoi_jax.report.decimate import decimate
from eoi_jax.report.tables import columns

_COLOURS = {"input": "#D55E00", "output": "#0072B2"}


def inspection_text(inspection: Inspection, max_rows: int = 40) -> str:
    """The time axis, a line for each column, how the file was read, and advice.

    Args:
        inspection: of `inspect`.
        max_rows: columns of the file in the table.

    Returns:
        Several lines of at most about 100 characters.
    """
    size = ", ".join(
        [counted(inspection.samples, "row"), counted(len(inspection.channels), "column")]
    )
    blocks = [f"{printable(str(inspection.path))}: {size}", _clock_text(inspection)]
    rows = [("column", "looks like", "unit", "min", "max", "missing", "noise", "step", "band")]
    ranks = ("time", "input", "output", "other", "constant", "text")
    ordered = sorted(inspection.channels, key=lambda channel: ranks.index(channel.role))
    rows += [_row(channel) for channel in ordered[:max_rows]]
    table = columns(rows, "<<<>>>>>>")
    if len(ordered) > max_rows:
        table += f"\nand {counted(len(ordered) - max_rows, 'more column')}: --json lists all"
    blocks.append(table)
    guesses = [channel for channel in ordered if channel.role in ("input", "output")][:12]
    if guesses:
        reasons = "\n".join(f"  {guess.name} {guess.role}: {guess.why}" for guess in guesses)
        blocks.append(f"Guesses from the values and names of the columns:\n{reasons}")
    notes = [*inspection.notes, *(f"Omitted: {line}" for line in inspection.left_out[:8])]
    if len(inspection.left_out) > 8:
        notes.append(f"Omitted: {len(inspection.left_out) - 8} more")
    blocks.append("\n".join(f"- {line}" for line in (*notes, *inspection.advice)))
    return "\n\n".join(block for block in blocks if block)


def _clock_text(inspection: Inspection) -> str:
    clock = inspection.clock
    if clock.sample_period is None:
        return f"time: none; {clock.why}"
    if clock.column is None or clock.spacing is None:
        return f"time: none; every {clock.sample_period:g} s ({clock.why})"
    period, (low, high) = clock.sample_period, clock.spacing
    scale = "" if clock.factor == 1.0 else f", {clock.factor:g} s per unit"
    counts = f"{clock.repeated} repeated, {clock.backwards[0]} backwards"
    lines = [f"time: `{clock.column}`{scale} ({clock.why})"]
    if clock.scattered:
        lines += [f"  no usual spacing, for {clock.duration:.6g} s", f"  {counts}"]
    else:
        lines += [
            f"  every {period:.6g} s ({1 / period:.6g} Hz) for {clock.duration:.6g} s",
            f"  stamps {low:.4g} to {high:.4g} s apart, jitter {percent(clock.jitter or 0.0)}",
            f"  {counted(clock.gaps[0], 'gap')}, {counts}",
        ]
    if clock.others:
        lines.append(f"  other candidates: {', '.join(clock.others)}")
    return "\n".join(lines)


def _row(channel: Channel) -> tuple[str, ...]:
    def number(value: float | None, digits: int = 4) -> str:
        return "" if value is None else f"{value:.{digits}g}"

    role = channel.role if channel.role != "other" else channel.kind
    band = "" if channel.band is None else f"{channel.band:.3g} Hz"
    noise, step = number(channel.noise, 2), number(channel.quantum, 3)
    name = channel.name if len(channel.name) <= 32 else f"{channel.name[:31]}…"
    limits = number(channel.low), number(channel.high)
    return (name, role, channel.unit, *limits, str(channel.missing or ""), noise, step, band)


def inspection_figure(inspection: Inspection, max_signals: int = 6) -> Any:
    """Signals over time with their spectra, and the intervals between time stamps.

    Args:
        inspection: of `inspect`.
        max_signals: signals that are drawn, outputs first.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    from matplotlib.figure import Figure

    channels = [channel for channel in inspection.channels if channel.role in _COLOURS]
    channels += [
        channel
        for channel in inspection.channels
        if channel.role == "other" and channel.name in inspection.signals
    ]
    channels = sorted(channels, key=lambda channel: channel.role != "output")[:max_signals]
    clock, count, signals = inspection.clock, len(channels), inspection.signals
    stamped = clock.column is not None
    seconds = clock.sample_period is not None
    time = (
        clock.factor * signals[clock.column]
        if clock.column
        else np.arange(inspection.samples) * (clock.sample_period or 1.0)
    )
    rows = count + stamped
    figure = Figure(figsize=(10, 1.0 + 1.8 * max(rows, 1)), dpi=100, layout="constrained")
    grid = figure.subplots(max(rows, 1), 2, squeeze=False, width_ratios=[2.6, 1])
    for axes, channel in zip(grid, channels, strict=False):
        _draw_signal(axes[0], time, signals[channel.name], channel)
        _draw_spectrum(axes[1], signals[channel.name], clock.sample_period or 1.0, channel)
    for axes in grid[: count - 1]:
        axes[0].tick_params(labelbottom=False)
        axes[1].tick_params(labelbottom=False)
    if count:
        grid[0, 0].set_title("over time", fontsize=10)
        grid[0, 1].set_title("spectrum", fontsize=10)
        grid[count - 1, 0].set_xlabel("time [s]" if seconds else "sample")
        unit = "Hz" if seconds else "1/sample"
        marks = "dashed: 99 % of power; dotted: noise"
        grid[count - 1, 1].set_xlabel(f"frequency [{unit}]\n{marks}", fontsize=7)
    if stamped:
        _draw_steps(grid[-1], time, clock.sample_period or 1.0)
    roles = [channel.role for channel in inspection.channels]
    hidden = sum(role in ("input", "output", "other") for role in roles) - count
    title = printable(inspection.path.name) + (
        f" ({counted(hidden, 'more column')})" if hidden > 0 else ""
    )
    figure.suptitle(title, fontsize=12, parse_math=False)
    return figure


def _draw_signal(
    axes: Any,
    time: Float[np.ndarray, " time"],
    values: Float[np.ndarray, " time"],
    channel: Channel,
) -> None:
    colour = _COLOURS.get(channel.role, "#666666")
    if np.any(np.diff(time) < 0):
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
    axes.plot(*decimate(time, values), color=colour, linewidth=0.8)
    unit = f" [{channel.unit}]" if channel.unit and channel.unit not in channel.name else ""
    axes.set_ylabel(f"{channel.name[:24]}{unit}", parse_math=False)
    label = f"{channel.role}?" if channel.role in _COLOURS else "?"
    axes.annotate(
        label, (0.005, 0.97), xycoords="axes fraction", va="top", fontsize=8, color=colour
    )
    axes.grid(visible=True, alpha=0.3)


def _draw_spectrum(
    axes: Any, values: Float[np.ndarray, " time"], period: float, channel: Channel
) -> None:
    """Amplitude over frequency, with lines at the noise level and at the bandwidth."""
    part = values[: InspectionSettings.spectrum_samples]
    if channel.repeats:
        part = without_repeats(part[:, None], [channel.name], [channel.name], [])[:, 0]
    # A jump to each value between empty cells, or repeated ones, would be the comb of the gaps.
    part = fill(np.arange(len(part), dtype=float), part[:, None], np.arange(len(part), dtype=float))
    part = part[:, 0]
    window = np.hanning(len(part))
    amplitudes = np.abs(np.fft.rfft((part - part.mean()) * window))[1:] * 2 / max(window.sum(), 1.0)
    frequency = np.arange(1, len(amplitudes) + 1) / (len(part) * period)
    edges = np.unique(np.geomspace(1, len(amplitudes) + 1, 400).astype(int)) - 1
    peaks = np.maximum.reduceat(amplitudes, edges[edges < len(amplitudes)])
    colour = _COLOURS.get(channel.role, "#666666")
    positive = peaks > 0
    if not positive.any():
        axes.set_axis_off()
        return
    axes.loglog(frequency[edges[edges < len(amplitudes)]][positive], peaks[positive],
                color=colour, linewidth=0.8)  # fmt: skip
    if channel.noise:
        level = channel.noise * 2 * np.sqrt(np.sum(window**2)) / window.sum()
        axes.axhline(level, color="#000000", linewidth=0.8, linestyle=":")
    if channel.band:
        axes.axvline(channel.band, color="#000000", linewidth=0.8, linestyle="--")
    axes.grid(visible=True, alpha=0.3)


def _draw_steps(axes: Any, time: Float[np.ndarray, " time"], period: float) -> None:
    """Intervals between successive time stamps, over time and as a histogram."""
    steps = np.diff(time) / period
    axes[0].plot(*decimate(time[1:], steps), color="#000000", linewidth=0.6)
    low, high = min(float(steps.min()), 0.9), max(float(steps.max()), 1.1)
    axes[0].set_ylim(low - 0.05 * (high - low), high + 0.05 * (high - low))
    axes[0].set_ylabel("step / median")
    axes[0].set_xlabel("time [s]")
    axes[0].grid(visible=True, alpha=0.3)
    axes[1].hist(steps, bins=np.linspace(low, high, 42).tolist(), color="#666666")
    axes[1].set_yscale("log")
    axes[1].set_xlabel("step / median")
    axes[1].set_ylabel("count")
