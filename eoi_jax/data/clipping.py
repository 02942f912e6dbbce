"""Saturation of measured channels: samples that pile up at the smallest or largest value."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import percent
from eoi_jax.data.record import Record

AT_END = "an end of its range"  # what a note says of an output that stays there


@dataclass(frozen=True)
class ClippingSettings:
    """What counts as a pile of samples at the end of a channel's range."""

    levels: int = 500  # into which the range is divided
    end_levels: int = 25  # next to the end, that are compared
    min_occupied: int = 6  # of them with samples; with fewer the channel is a staircase
    pile_ratio: float = 10.0  # of the samples at the end to those of a level next to it
    told: float = 0.01  # share of an output's samples at its end from which on a fit mentions it
    # Noise over the range, and above a quantum, from which on an output at rest shows it.
    noise: float = 1e-5


_SETTINGS = ClippingSettings()


@dataclass(frozen=True)
class Saturation:
    """Samples of a channel piled up at its smallest or largest value."""

    record: str
    channel: str
    level: float
    share: float


def saturations(record: Record) -> list[Saturation]:
    """Every end of a channel at which samples pile up.

    An input that is zero for long is off, as the sun at night: no end of its range. An output that
    has not moved since its record began rests, as a drive below its dry friction.

    Args:
        record: as measured; smoothing rounds the ends off.

    Returns:
        A saturation for each such end, inputs first.
    """
    known = np.repeat(record.input_valid[:, None], len(record.input_names), axis=1)
    channels = [
        *zip(record.input_names, record.inputs.T, known.T, strict=True),
        *zip(record.output_names, record.outputs.T, record.output_valid.T, strict=True),
    ]
    levels = np.stack([record.noise, record.quantum], axis=1).tolist()
    scatter = dict(zip(record.output_names, levels, strict=True))
    piles = []
    for name, channel, mask in channels:
        values = channel[mask]
        moving = values if name in record.input_names else _behind_rest(values, *scatter[name])
        for side in (1.0, -1.0):
            share = _pile(side * moving) * len(moving) / len(values)
            if share:
                level = float(side * np.max(side * values))
                if level or name not in record.input_names:
                    piles.append(Saturation(record.name, name, level, share))
    return piles


def clipped_notes(records: Sequence[Record]) -> list[str]:
    """A sentence for each end of an output at which it stays, which a fit takes for its motion.

    Args:
        records: as measured.
    """
    notes = []
    for record in records:
        pairs = zip(record.outputs.T, record.output_valid.T, strict=True)
        values = [channel[mask] for channel, mask in pairs]
        # A sensor that ends shows one value there; to look for it costs next to nothing.
        if not any(_share_at_ends(channel) >= _SETTINGS.told for channel in values):
            continue
        notes += [
            f"{end.record}: {end.channel} stays at {end.level:.4g}, {AT_END}, in "
            f"{percent(end.share)} of its samples: if its sensor ends there, leave these empty"
            for end in saturations(record)
            if end.channel in record.output_names and end.share >= _SETTINGS.told
        ]
    return notes


def _share_at_ends(values: Float[np.ndarray, " n"]) -> float:
    """Share of the samples at the largest or the smallest value, whichever has more."""
    if not len(values):
        return 0.0
    return float(max(np.mean(values == np.max(values)), np.mean(values == np.min(values))))


def _behind_rest(
    values: Float[np.ndarray, " n"], noise: float, quantum: float
) -> Float[np.ndarray, " moving"]:
    """The samples of an output from the last one of those that stay at its first value.

    All of them where it stays there without the noise that it has elsewhere: its sensor ends there.
    """
    value_range = float(np.ptp(values))
    moved = np.abs(values - values[0]) > value_range / _SETTINGS.levels
    first = int(np.argmax(moved))
    is_quiet = first > 0 and np.mean(values[:first] == values[0]) > 0.5
    if is_quiet and noise > max(quantum, _SETTINGS.noise * value_range):
        return values
    return values[max(first - 1, 0) :]


def _pile(values: Float[np.ndarray, " n"]) -> float:
    """Share of samples at the largest value if they pile up there, else 0.

    A clipped signal has far more samples at its end than at the levels next to it, and no more at
    those than further in. A signal that turns at its end (a sine) or settles there has many samples
    at the levels next to it as well; a staircase of few levels has none.
    """
    value_range = float(np.ptp(values))
    if value_range <= 0:
        return 0.0
    width = max(value_range / _SETTINGS.levels, float(np.min(np.diff(np.unique(values)))))
    level = ((np.max(values) - values) / width + 0.5).astype(int)
    end = _SETTINGS.end_levels
    counts = np.bincount(level[level <= end], minlength=end + 1)
    pile, adjacent, inner = counts[0], np.sum(counts[1:4]), np.mean(counts[4:])
    staircase = np.sum(counts[1:] > 0) < _SETTINGS.min_occupied or value_range < 2 * end * width
    lingers = adjacent > 6.0 * inner + 3.0 * np.sqrt(3.0 * inner + 1.0) and adjacent > 0.1 * pile
    if staircase or lingers or pile < _SETTINGS.pile_ratio * max(adjacent / 3.0, inner, 1.0):
        return 0.0
    return float(pile / len(values))
