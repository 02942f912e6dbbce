"""Channels that wrap: counters and angles that start again at the other end of their range.

From one sample to the next such a channel moves a little, or jumps back by nearly its period. A
jump is a wrap if the channel goes on behind it as it went before, or if noise takes it across both
ends of a usual range, as a heading about north. What goes from level to level, such as a square
wave, rests or turns at its jumps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import counted
from eoi_jax.data.unwrapping import unwrapped


@dataclass(frozen=True)
class WrappingSettings:
    """What counts as a wrap, and what as a period."""

    jump: float = 0.5  # share of the range from which on a step from sample to sample is a jump
    motion: float = 0.45  # share of the range that no other step exceeds
    fast: float = 0.3  # share of the period from which on the direction of a step is in doubt
    moves: int = 6  # before a jump and behind it, that show how the channel moves there
    least_moves: int = 3  # of them
    straight: float = 0.5  # of the way of these moves: how far they must lead on
    directed: float = 0.8  # share of the jumps at which it must move on as before
    equal: float = 0.05  # of the period: by which most jumps may differ, with the motion in them
    near: float = 0.01  # of the period: how far the estimate may lie from a usual one
    precise: float = 1e-3  # the same for a counter that moves evenly: its periods lie closer
    examined: int = 1000  # jumps
    widened: float = 0.02  # of the period: range of the channel beyond it, by noise
    hovering: int = 3  # different values at each end, of a channel that noise takes across them
    at_ends: float = 0.5  # share of its samples at its largest and smallest value; more: clipped
    turns: int = 3  # jumps from which on a period that is not usual is mentioned
    # Of angles and of counters; a counter of whole numbers also wraps at a power of two.
    angles: tuple[float, ...] = (360.0, 2.0 * np.pi, 180.0, np.pi)
    counts: tuple[float, ...] = (1.0, 2.0, 2.5, 3.6, 4.0, 5.0, 6.0, 8.0)  # times a power of ten
    fewest_counts: float = 200.0


_SETTINGS = WrappingSettings()

JUMPS = "a fit takes the jumps for motion"  # in each note


@dataclass(frozen=True)
class Wrapping:
    """How a channel wraps.

    Attributes:
        period: by which it jumps back, in its unit.
        times: number of its jumps.
        usual: whether the period is one of an angle or of a counter; else it may be the height of
            a saw-tooth.
        motion: largest step between two samples without the jumps, as a share of the period.
    """

    period: float
    times: int
    usual: bool
    motion: float

    @property
    def text(self) -> str:
        """What the channel does: a sentence without its subject."""
        times = counted(self.times, "time")
        if not self.usual:
            return f"jumps {times} by about {self.period:.4g}, nearly its range, and goes on"
        doubt = ""
        if self.motion > _SETTINGS.fast:
            doubt = (
                f"; it moves by up to {100 * self.motion:.0f} % of that from sample to sample, "
                "and from 50 % on its direction is not known: sample faster"
            )
        return f"wraps {times} with a period of {period_text(self.period)}{doubt}"

    def advice(self, name: str) -> str:
        """What to do about it.

        Args:
            name: of the channel.
        """
        period = period_text(self.period) if self.usual else f"{self.period:.4g}"
        in_words = "" if self.usual else ", if it is a counter or an angle that wraps"
        ways = f'unwrap = {{ "{name}" = {period} }} in [data], or `record.unwrapped`'
        return f"{JUMPS}; write {ways}{in_words}"


def period_text(period: float) -> str:
    """A period as a config has it; it is positive."""
    return f"{period:.0f}" if period == round(period) else f"{period:.10g}"


def wrapping(values: Float[np.ndarray, " n"], mask: Bool[np.ndarray, " n"]) -> Wrapping | None:
    """Whether a channel wraps; None: it does not.

    Args:
        values: of the channel.
        mask: where they were measured; a step is one between samples that are not further apart
            than usual.
    """
    position, measured = np.flatnonzero(mask), values[mask]
    value_range = float(np.ptp(measured)) if len(measured) > 2 else 0.0
    if not 0.0 < value_range < np.inf:
        return None
    step, spacing = np.diff(measured), np.diff(position)
    adjacent = spacing <= np.median(spacing)
    is_jump = adjacent & (np.abs(step) > _SETTINGS.jump * value_range)
    motion = float(np.max(np.abs(step[adjacent & ~is_jump]), initial=0.0))
    times = int(np.sum(is_jump))
    if not times or motion > _SETTINGS.motion * value_range:
        return None
    moved, goes_on = _at_the_jumps(step, is_jump, adjacent)
    period, usual = _period(measured, moved, motion)
    is_equal = np.abs(moved - period) <= _SETTINGS.equal * period
    if np.mean(is_equal) < _SETTINGS.directed or value_range > (1 + _SETTINGS.widened) * period:
        return None
    turned, _ = unwrapped(measured, np.ones(len(measured), bool), period)
    turns = usual and times > 1 and float(np.ptp(turned)) > value_range
    turned_step = np.abs(np.diff(turned))
    hovers = usual and times > 1 and motion >= np.median(turned_step[is_jump])
    hovers = hovers and _hovers(measured, period)
    if np.mean(goes_on) < _SETTINGS.directed and not (turns or hovers):
        return None
    if not usual and times < _SETTINGS.turns:
        return None
    largest = float(np.max(turned_step[adjacent]))
    return Wrapping(period, times, usual, largest / period)


def _hovers(values: Float[np.ndarray, " n"], period: float) -> bool:
    """Whether a channel is within one period, up to both ends of it, and not clipped there.

    A switch has one value at each end, and noise takes it beyond them.

    Args:
        values: of a channel that jumps by its period.
        period: a usual one.
    """
    lowest, highest = float(np.min(values)), float(np.max(values))
    is_within = any(start <= lowest and highest <= start + period for start in (0.0, -0.5 * period))
    upper = values > lowest + 0.5 * period
    different = min(len(np.unique(values[upper])), len(np.unique(values[~upper])))
    at_ends = float(np.mean((values == lowest) | (values == highest)))
    return is_within and different >= _SETTINGS.hovering and at_ends <= _SETTINGS.at_ends


def course(values: Float[np.ndarray, " n"], wraps: Wrapping | None) -> Float[np.ndarray, " n"]:
    """The values of a channel, unwrapped where its period is a usual one.

    Args:
        values: of the channel; those that are not finite stay so.
        wraps: how it wraps; None: it does not.
    """
    if wraps is None or not wraps.usual:
        return values
    finite = np.isfinite(values)
    return np.where(finite, unwrapped(values, finite, wraps.period)[0], values)


def _at_the_jumps(
    step: Float[np.ndarray, " steps"],
    is_jump: Bool[np.ndarray, " steps"],
    adjacent: Bool[np.ndarray, " steps"],
) -> tuple[Float[np.ndarray, " jumps"], Bool[np.ndarray, " jumps"]]:
    """The period that each jump shows, and whether the channel goes on behind it as before.

    Of a wrap at the upper end the jump goes down, and the steps around it go up: the period is the
    jump and the step that it hides.
    """
    jumps = np.flatnonzero(is_jump)
    chosen = np.linspace(0, len(jumps) - 1, min(len(jumps), _SETTINGS.examined)).astype(int)
    jumps = jumps[chosen]
    direction = -np.sign(step[jumps])
    usable = adjacent & ~is_jump
    hidden = np.zeros((len(jumps), 2))
    for column, shift in enumerate((-1, 1)):
        neighbour = np.clip(jumps + shift, 0, len(step) - 1)
        hidden[:, column] = np.where(usable[neighbour], direction * step[neighbour], np.nan)
    finite = np.isfinite(hidden)
    total = np.sum(np.where(finite, hidden, 0.0), axis=1)
    hidden_step = np.maximum(total / np.maximum(finite.sum(axis=1), 1), 0.0)
    # What a coarse channel does in between is to rest: the steps that count are its moves.
    moves = np.flatnonzero(usable & (step != 0.0))
    at = np.searchsorted(moves, jumps)
    sides = [
        (np.maximum(at - _SETTINGS.moves, 0), at),
        (at, np.minimum(at + _SETTINGS.moves, len(moves))),
    ]
    sums, paths = (
        np.concatenate([[0.0], np.cumsum(part)]) for part in (step[moves], np.abs(step[moves]))
    )
    goes_on = np.ones(len(jumps), bool)
    for first, last in sides:
        progress, path = direction * (sums[last] - sums[first]), paths[last] - paths[first]
        goes_on &= (last - first >= _SETTINGS.least_moves) & (progress >= _SETTINGS.straight * path)
    return np.abs(step[jumps]) + hidden_step, goes_on


def _period(
    values: Float[np.ndarray, " n"], moved: Float[np.ndarray, " jumps"], motion: float
) -> tuple[float, bool]:
    """The period, and whether it is a usual one, which is then taken exactly."""
    estimate, value_range = float(np.median(moved)), float(np.ptp(values))
    is_whole = bool(np.all(values == np.round(values)))
    candidates = np.asarray(_usual_periods(is_whole, estimate))
    tolerance = _SETTINGS.near * estimate
    if is_whole:
        spread = 1.5 * float(np.median(np.abs(moved - estimate)))
        spread = max(3.0 * spread / np.sqrt(len(moved)), motion / len(moved), 1.0)
        tolerance = min(max(spread, _SETTINGS.precise * estimate), tolerance)
    nearest = float(candidates[np.argmin(np.abs(candidates - estimate))])
    if abs(nearest - estimate) <= tolerance:
        return nearest, True
    # Noise that takes a channel across its ends and back hides how it moves; its range is full.
    larger = candidates[candidates >= value_range]
    if len(larger) and np.min(larger) <= (1.0 + _SETTINGS.near) * value_range:
        return float(np.min(larger)), True
    return estimate, False


def _usual_periods(is_whole: bool, estimate: float) -> list[float]:
    """Periods of angles, and of counters for whole numbers."""
    candidates = [*_SETTINGS.angles]
    if is_whole:
        candidates = [angle for angle in candidates if angle == round(angle)]
        candidates += [2.0**power for power in range(4, 33)]
        decade = 10.0 ** np.floor(np.log10(estimate))
        rounds = [head * decade for head in (*_SETTINGS.counts, 10.0)]
        candidates += [value for value in rounds if value >= _SETTINGS.fewest_counts]
    return candidates


def wrap_notes(
    names: Sequence[str], values: Float[np.ndarray, "n c"], masks: Bool[np.ndarray, "n c"]
) -> list[str]:
    """A sentence for each channel that wraps, and what to write.

    Args:
        names: of the channels.
        values: of each.
        masks: where each was measured.
    """
    notes = []
    for name, column, mask in zip(names, values.T, masks.T, strict=True):
        wraps = wrapping(column, mask)
        if wraps is not None:
            notes.append(f"`{name}` {wraps.text}: {wraps.advice(name)}")
    return notes
