"""Saturation, seen in the record alone: samples that pile up at a channel's end."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record

_LEVELS = 500  # of a channel's range: how exactly a value repeats at a stop
_NEAR = 25  # levels next to the end that are looked at
_FEW = 6  # of them that must be taken, or the channel is a staircase
_PILE = 10.0  # samples at the extreme over those at the levels next to it


@dataclass(frozen=True)
class Saturation:
    """Samples of a channel piled up at its smallest or largest value."""

    record: str
    channel: str
    level: float
    share: float


def saturations(record: Record) -> list[Saturation]:
    """Every end of a channel at which samples pile up.

    Args:
        record: as measured; smoothing rounds the ends off.

    Returns:
        One for each end, inputs first.
    """
    channels = [
        *zip(record.input_names, record.inputs.T, strict=True),
        *zip(record.output_names, record.outputs.T, strict=True),
    ]
    found = []
    for name, channel in channels:
        values = channel[record.valid]
        for side in (1.0, -1.0):
            share = _pile(side * values)
            if share:
                level = float(side * np.max(side * values))
                found.append(Saturation(record.name, name, level, share))
    return found


def _pile(values: Float[np.ndarray, " n"]) -> float:
    """Share of samples at the largest value if they pile up there, else 0.

    Cut off, a signal is at its end far more often than just short of it, where it is no more often
    than a little further in. A signal that turns there (a sine) or settles there lingers on the
    way as well; one with few levels (a staircase) has nothing in between.
    """
    reach = float(np.ptp(values))
    if reach <= 0:
        return 0.0
    width = max(reach / _LEVELS, float(np.min(np.diff(np.unique(values)))))
    level = ((np.max(values) - values) / width + 0.5).astype(int)
    counts = np.bincount(level[level <= _NEAR], minlength=_NEAR + 1)
    pile, beside, further = counts[0], np.sum(counts[1:4]), np.mean(counts[4:])
    staircase = np.sum(counts[1:] > 0) < _FEW or reach < 2 * _NEAR * width
    lingers = beside > 6.0 * further + 3.0 * np.sqrt(3.0 * further + 1.0) and beside > 0.1 * pile
    if staircase or lingers or pile < _PILE * max(beside / 3.0, further, 1.0):
        return 0.0
    return float(pile / len(values))
