"""A record as text."""

import numpy as np

from eoi_jax._types import TimeAxis
from eoi_jax.data.holds import skew_text
from eoi_jax.data.input_holds import hold_text
from eoi_jax.data.record import Record


def _label(record: Record, key: str) -> str:
    unit = record.units.get(key)
    return f"{key} [{unit}]" if unit else key


def record_text(record: Record) -> str:
    """Length and sample period, a line for each channel, the hold of the inputs, and notes."""
    h = record.sample_period
    size = f"{len(record)} samples, {len(record) * h:.4g} s, every {h:.6g} s ({1 / h:.5g} Hz)"
    lines = [f"Record `{record.name}`: {size}"]
    rows = [("", "channel", "min", "max", "rms", "noise", "quantum")]
    known = record.input_valid
    for key, channel in zip(record.input_names, record.inputs[known].T, strict=True):
        rows.append(("input", _label(record, key), *_spread(channel), "", ""))
    for i, (noise, quantum) in enumerate(zip(record.noise, record.quantum, strict=True)):
        key, channel = record.output_names[i], record.outputs[record.output_valid[:, i], i]
        accuracy = (f"{noise:.2g}", f"{quantum:.3g}" if quantum else "–")
        rows.append(("output", _label(record, key), *_spread(channel), *accuracy))
    widths = [max(len(row[j]) for row in rows) for j in range(len(rows[0]))]
    for row in rows:
        label = f"  {row[0]:{widths[0]}}  {row[1]:{widths[1]}}"
        cells = "".join(f"  {cell:>{w}}" for cell, w in zip(row[2:], widths[2:], strict=True))
        lines.append((label + cells).rstrip())
    hold = f"hold {hold_text(record.hold, record.input_names)}"
    if np.any(record.skew):
        hold += f" ({skew_text(record, record.skew)})"
    facts = [hold] if record.input_names else []
    facts.append(f"{100 * record.valid.mean():.4g} % valid")
    if record.burn_in:
        facts.append(f"burn-in {record.burn_in:g} s")
    lines.append("  " + ", ".join(facts))
    return "\n".join([*lines, *(f"  - {note}" for note in record.notes)])


def _spread(channel: TimeAxis) -> tuple[str, str, str]:
    rms = float(np.sqrt(np.mean(channel**2)))
    return f"{channel.min():.4g}", f"{channel.max():.4g}", f"{rms:.4g}"
