"""What is in a file, as a table and as a picture."""

from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import printable
from eoi_jax.data.inspection import Channel, Inspection
from eoi_jax.report.figures import decimate
from eoi_jax.report.tables import columns

_ROWS = 40  # of the table
_PANELS = 6  # of the figure
_COLOURS = {"input": "#D55E00", "output": "#0072B2"}
_LINES = 1 << 17


def inspection_text(found: Inspection) -> str:
    """The clock, a line for each column, what was read and how, and what to look at.

    Args:
        found: of `inspect`.

    Returns:
        Several lines of at most about 100 characters.
    """
    blocks = [f"{printable(str(found.path))}: {found.samples} rows, {len(found.channels)} columns"]
    blocks.append(_clock_text(found))
    rows = [("column", "looks like", "unit", "min", "max", "missing", "noise", "step", "band")]
    ranks = ("time", "input", "output", "other", "constant", "text")
    ordered = sorted(found.channels, key=lambda one: ranks.index(one.role))
    rows += [_row(one) for one in ordered[:_ROWS]]
    table = columns(rows, "<<<>>>>>>")
    if len(ordered) > _ROWS:
        table += f"\nand {len(ordered) - _ROWS} more: --json lists them all"
    blocks.append(table)
    guesses = [one for one in ordered if one.role in ("input", "output")][:12]
    if guesses:
        why = "\n".join(f"  {one.name} {one.role}: {one.why}" for one in guesses)
        blocks.append(f"Guesses, from what the columns look like:\n{why}")
    notes = [*found.notes, *(f"Left out: {one}" for one in found.left_out[:8])]
    if len(found.left_out) > 8:
        notes.append(f"Left out: {len(found.left_out) - 8} more")
    blocks.append("\n".join(f"- {line}" for line in (*notes, *found.advice)))
    return "\n\n".join(block for block in blocks if block)


def _clock_text(found: Inspection) -> str:
    clock = found.clock
    if clock.sample_period is None:
        return f"time: none; {clock.why}"
    if clock.column is None or clock.spacing is None:
        return f"time: none; every {clock.sample_period:g} s ({clock.why})"
    period, (low, high) = clock.sample_period, clock.spacing
    scale = "" if clock.factor == 1.0 else f", {clock.factor:g} s a unit"
    lines = [
        f"time: `{clock.column}`{scale} ({clock.why})",
        f"  every {period:.6g} s ({1 / period:.6g} Hz) for {clock.duration:.6g} s",
        f"  stamps {low:.4g} to {high:.4g} s apart, jitter {100 * (clock.jitter or 0.0):.2g} %",
        f"  {clock.gaps[0]} gaps, {clock.repeated} repeated, {clock.backwards[0]} backwards",
    ]
    if clock.others:
        lines.append(f"  might be it, too: {', '.join(clock.others)}")
    return "\n".join(lines)


def _row(one: Channel) -> tuple[str, ...]:
    def shown(value: float | None, digits: int = 4) -> str:
        return "" if value is None else f"{value:.{digits}g}"

    looks = one.role if one.role != "other" else one.kind
    band = "" if one.band is None else f"{one.band:.3g} Hz"
    noise, step = shown(one.noise, 2), shown(one.quantum, 3)
    name = one.name if len(one.name) <= 32 else f"{one.name[:31]}…"
    return (name, looks, one.unit, shown(one.low), shown(one.high), str(one.missing or ""),
            noise, step, band)  # fmt: skip


def inspection_figure(found: Inspection) -> Any:
    """Signals over time beside their spectra, and below the distances between the stamps.

    Args:
        found: of `inspect`.

    Returns:
        A `matplotlib.figure.Figure`.
    """
    from matplotlib.figure import Figure

    shown = [one for one in found.channels if one.role in _COLOURS]
    shown += [one for one in found.channels if one.role == "other" and one.name in found.signals]
    shown = sorted(shown, key=lambda one: one.role != "output")[:_PANELS]
    clock, count, numbers = found.clock, len(shown), found.signals
    stamped = clock.column is not None
    seconds = clock.sample_period is not None
    time = (
        clock.factor * numbers[clock.column]
        if clock.column
        else np.arange(found.samples) * (clock.sample_period or 1.0)
    )
    rows = count + stamped
    figure = Figure(figsize=(10, 1.0 + 1.8 * max(rows, 1)), dpi=100, layout="constrained")
    grid = figure.subplots(max(rows, 1), 2, squeeze=False, width_ratios=[2.6, 1])
    for axes, one in zip(grid, shown, strict=False):
        _draw_signal(axes[0], time, numbers[one.name], one)
        _draw_spectrum(axes[1], numbers[one.name], clock.sample_period or 1.0, one)
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
    more = sum(one.role in ("input", "output", "other") for one in found.channels) - count
    title = printable(found.path.name) + (f" ({more} more columns)" if more > 0 else "")
    figure.suptitle(title, fontsize=12, parse_math=False)
    return figure


def _draw_signal(
    axes: Any, time: Float[np.ndarray, " time"], values: Float[np.ndarray, " time"], one: Channel
) -> None:
    colour = _COLOURS.get(one.role, "#666666")
    if np.any(np.diff(time) < 0):
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
    axes.plot(*decimate(time, values), color=colour, linewidth=0.8)
    unit = f" [{one.unit}]" if one.unit and one.unit not in one.name else ""
    axes.set_ylabel(f"{one.name[:24]}{unit}", parse_math=False)
    label = one.role if one.role in _COLOURS else "?"
    axes.annotate(
        f"{label}?" if label != "?" else "?", (0.005, 0.97), xycoords="axes fraction", va="top",
        fontsize=8, color=colour,
    )  # fmt: skip
    axes.grid(visible=True, alpha=0.3)


def _draw_spectrum(
    axes: Any, values: Float[np.ndarray, " time"], period: float, one: Channel
) -> None:
    """Amplitude over frequency; the noise's level as a line, the band as a mark."""
    part = values[:_LINES]
    part = np.where(np.isfinite(part), part, np.nanmean(part) if np.isfinite(part).any() else 0.0)
    window = np.hanning(len(part))
    lines = np.abs(np.fft.rfft((part - part.mean()) * window))[1:] * 2 / max(window.sum(), 1.0)
    frequency = np.arange(1, len(lines) + 1) / (len(part) * period)
    edges = np.unique(np.geomspace(1, len(lines) + 1, 400).astype(int)) - 1
    peaks = np.maximum.reduceat(lines, edges[edges < len(lines)])
    colour = _COLOURS.get(one.role, "#666666")
    positive = peaks > 0
    if not positive.any():
        axes.set_axis_off()
        return
    axes.loglog(frequency[edges[edges < len(lines)]][positive], peaks[positive],
                color=colour, linewidth=0.8)  # fmt: skip
    if one.noise:
        level = one.noise * 2 * np.sqrt(np.sum(window**2)) / window.sum()
        axes.axhline(level, color="#000000", linewidth=0.8, linestyle=":")
    if one.band:
        axes.axvline(one.band, color="#000000", linewidth=0.8, linestyle="--")
    axes.grid(visible=True, alpha=0.3)


def _draw_steps(axes: Any, time: Float[np.ndarray, " time"], period: float) -> None:
    """Distances of neighbouring stamps, over time and as a histogram."""
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
