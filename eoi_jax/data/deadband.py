"""Outputs that were stored where they moved by more than a deadband, and exported as last stored.

A historian that compresses stores few values, and an export at a fixed rate repeats the last one.
Such values are late by up to a deadband, which a fit takes for dynamics, and repeated errors are no
noise. What tells: many values are repeated, for times of any length, and no change is smaller than
the deadband, though there are levels between. A coarse sensor changes by single levels, a
slow one at regular times, and what rests between moves changes many times in a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import percent
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs


@dataclass(frozen=True)
class DeadbandSettings:
    """What of the steps between samples shows a deadband."""

    fewest: int = 50  # changes of the value
    repeated: float = 0.2  # share of the steps that repeat the value, at least
    followed: float = 0.15  # runs of repeated values for a change, at least
    scatter: float = 0.5  # of the times between changes over their mean, at least
    smaller: float = 0.02  # share of the changes that may be smaller, as those stored once an hour
    close: float = 0.3  # share of the changes of at most twice the deadband, at least
    levels: float = 1.9  # deadband over the distance of the levels, at least
    multiples: float = 0.9  # share of the changes by multiples of the smallest: these are levels
    tolerance: float = 0.1  # by which such a multiple is off, as where rounding splits a level


_SETTINGS = DeadbandSettings()


def deadband_note(name: str, values: Float[np.ndarray, " samples"]) -> list[str]:
    """A sentence where a channel looks as if it had been stored with a deadband.

    Args:
        name: of the channel.
        values: NaN where a cell is empty.
    """
    finite = values[np.isfinite(values)]
    steps = np.abs(np.diff(finite))
    changes = steps[steps > 0.0]
    if len(changes) < _SETTINGS.fewest:
        return []
    share = 1.0 - len(changes) / len(steps)
    followed = len(runs(steps == 0.0)) / len(changes)
    times = np.diff(np.flatnonzero(steps))
    if share < _SETTINGS.repeated or followed < _SETTINGS.followed:
        return []
    band = float(np.quantile(changes, _SETTINGS.smaller, method="higher"))
    level = float(np.median(np.diff(np.unique(np.round(finite / band, 6))))) * band
    close = np.mean((changes >= 0.999 * band) & (changes <= 2.001 * band))
    is_multiple = np.abs(changes / band - np.rint(changes / band)) <= _SETTINGS.tolerance
    irregular = np.std(times) >= _SETTINGS.scatter * np.mean(times)
    if not irregular or close < _SETTINGS.close or band < _SETTINGS.levels * level:
        return []
    if np.mean(is_multiple) > _SETTINGS.multiples:
        return []
    return [_DEADBAND.format(name, percent(share), band, level)]


def deadband_notes(records: Sequence[Record]) -> list[str]:
    """The sentence of each output that looks as if it had been stored with a deadband.

    Args:
        records: as measured.
    """
    return [
        f"{record.name}: {note}"
        for record in records
        for name, values in zip(record.output_names, record.known_outputs.T, strict=True)
        for note in deadband_note(name, values)
    ]


_DEADBAND = (
    "`{}` repeats its value in {} of the steps and else changes by {:.3g} or more, though it has "
    "values {:.2g} apart: it looks stored with a deadband, as by a historian, and exported as the "
    "last value, which biases fits and their errors. Export the stored events alone, with empty "
    "cells between, or record without deadband and compression"
)
