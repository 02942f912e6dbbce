"""Unwrapping: the course of a counter or an angle that starts again at the end of its range."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_choice, counted, real
from eoi_jax.data.resampling import fill

TURNS_UNKNOWN = "the number of turns is not known"  # in each note that has to be repeated


def checked_periods(
    periods: Mapping[str, Any] | None, names: Sequence[str], interpolated: object = None
) -> dict[str, float]:
    """Periods by channel as numbers.

    Args:
        periods: by name.
        names: of the channels there are.
        interpolated: what a record keeps of its samples if its values are no longer these.

    Raises:
        ValueError: an unknown channel, a period that is not positive and finite, values that lie
            between samples.
    """
    rule = "must come before samples are interpolated or smoothed"
    advice = "Use `unwrap` of `read_record`, or `numpy.unwrap` on the values of the record."
    check(interpolated is None, "unwrapped", rule, "a record on another grid", advice)
    checked = {}
    for name, period in dict(periods or {}).items():
        check_choice("unwrap", name, tuple(names))
        value = real(period)
        advice = "It is by how much the channel jumps back, such as 4096 counts or 360 degrees."
        rule = "must be a period > 0 in the unit of the channel"
        check(bool(0 < value < np.inf), f"unwrap[{name}]", rule, period, advice)
        checked[name] = value
    return checked


def check_range(
    name: str, values: Float[np.ndarray, " n"], period: float, tolerance: float = 0.02
) -> None:
    """Check that a channel lies within one period, as it does before it is unwrapped.

    Args:
        name: of the channel.
        values: measured.
        period: in their unit.
        tolerance: share of the period by which noise at the ends may widen the range.

    Raises:
        ValueError: the period is smaller than the range of the channel.
    """
    finite = values[np.isfinite(values)]
    value_range = float(np.ptp(finite)) if len(finite) else 0.0
    rule = f"must be at least the range of the channel, {value_range:.6g}"
    advice = "It counts in the unit after `scale`; a channel that was unwrapped needs none."
    good = value_range <= (1.0 + tolerance) * period
    check(good, f"unwrap[{name}]", rule, f"{period:.6g}", advice)


def unwrapped(
    values: Float[np.ndarray, " n"],
    mask: Bool[np.ndarray, " n"],
    period: float,
    stamps: Float[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, " n"], int]:
    """A channel without its jumps by whole periods.

    Each measured sample is moved by whole periods to within half a period of the one before. Where
    the channel was not measured it is interpolated linearly.

    Args:
        values: within one period.
        mask: where they were measured.
        period: in their unit.
        stamps: of the samples, in any unit; None: they are equally far apart.

    Returns:
        The values, and the number of gaps across which the channel, as fast as elsewhere, may have
        moved by half a period or more, so that the number of turns in them is not known.
    """
    axis = np.arange(len(values), dtype=float)
    position, measured = (axis if stamps is None else stamps)[mask], values[mask]
    turns = -np.cumsum(np.round(np.diff(measured) / period))
    course = measured + period * np.concatenate([[0.0], turns])
    spacing = np.diff(position)
    step = np.abs(np.diff(course))
    usual = float(np.median(spacing)) if len(spacing) else 1.0
    is_gap = spacing > 1.5 * usual
    fastest = float(np.max(step[~is_gap], initial=0.0))
    doubtful = int(np.sum(is_gap & (fastest * spacing >= 0.5 * period * usual)))
    whole = np.full(len(values), np.nan)
    whole[mask] = course
    return (whole if np.all(mask) else fill(axis, whole[:, None], axis)[:, 0]), doubtful


def unwrapping_note(name: str, period: float, doubtful: int) -> str:
    """What was done to a channel, and across which gaps it is a guess.

    Args:
        name: of the channel.
        period: in its unit.
        doubtful: number of gaps, of `unwrapped`.
    """
    note = f"`{name}` unwrapped with a period of {period:.10g}."
    if not doubtful:
        return note
    return (
        f"{note} Across {counted(doubtful, 'gap')} {TURNS_UNKNOWN}, and the nearest is taken: "
        "read the parts between the gaps as records of their own."
    )


def unwrapped_channels(
    signals: Float[np.ndarray, "n c"],
    masks: Bool[np.ndarray, " n"] | Bool[np.ndarray, "n c"],
    names: Sequence[str],
    periods: Mapping[str, float],
    stamps: Float[np.ndarray, " n"] | None = None,
) -> tuple[Float[np.ndarray, "n c"], list[str]]:
    """Several channels, those with a period unwrapped, and a note for each of these.

    Args:
        signals: of the channels.
        masks: where all were measured, or each was.
        names: of each.
        periods: of `checked_periods`; other names are of other channels.
        stamps: of the samples; None: they are equally far apart.

    Raises:
        ValueError: a period smaller than the range of its channel.
    """
    result, notes = np.array(signals), []
    for j, name in enumerate(names):
        if name in periods:
            mask, period = masks if masks.ndim == 1 else masks[:, j], periods[name]
            check_range(name, signals[mask, j], period)
            result[:, j], doubtful = unwrapped(signals[:, j], mask, period, stamps)
            notes.append(unwrapping_note(name, period, doubtful))
    return result, notes
