"""A channel that changes all the time and once stands exactly still, as where a sensor has frozen.

A signal that rests, stops at a limit or is held stands still as well: that is why the values before
and behind must change at most steps, why it must happen once, and why it is a question.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.resampling import runs


@dataclass(frozen=True)
class StandstillSettings:
    """When a channel stands still as it never does otherwise."""

    shortest: int = 30  # samples
    contrast: float = 5.0  # times as long as any other run of equal values, at least
    around: int = 30  # samples before and behind it, of which
    moving: float = 0.5  # this share of the steps must change the value


_SETTINGS = StandstillSettings()


def standstill_notes(name: str, values: Float[np.ndarray, " samples"]) -> list[str]:
    """A question about the run of equal values that no other of the channel comes near to.

    Args:
        name: of the channel.
        values: NaN where a cell is empty.
    """
    rows = np.flatnonzero(np.isfinite(values))
    finite = values[rows]
    equal = sorted(runs(np.diff(finite) == 0), key=lambda run: run[0] - run[1])
    if not equal:
        return []
    start, stop = equal[0][0], equal[0][1] + 1  # the samples of the longest run
    second = equal[1][1] - equal[1][0] + 1 if equal[1:] else 1
    if stop - start < max(_SETTINGS.shortest, _SETTINGS.contrast * second):
        return []
    sides = (finite[max(start - _SETTINGS.around, 0) : start], finite[stop:][: _SETTINGS.around])
    if min(map(len, sides)) < _SETTINGS.around:
        return []
    is_moving = all(np.mean(np.diff(side) != 0) >= _SETTINGS.moving for side in sides)
    at_rest = finite[start] in (0.0, finite.min(), finite.max())  # or at a limit
    if at_rest or not is_moving:
        return []
    first, last = rows[start], rows[stop - 1]
    sentence = f"`{name}` is {finite[start]:.6g} from row {first} to {last}, counted from 0, and "
    sentence += "moves before and behind: if its sensor was frozen, empty these cells to mask them."
    return [sentence]
