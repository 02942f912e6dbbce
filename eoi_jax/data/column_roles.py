"""Guesses of which column is an input and which an output: from the file, its names, its values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import percent
from eoi_jax.data.channel import Channel
from eoi_jax.data.cleaning import RATE
from eoi_jax.data.column_names import (
    RATING,
    is_called_rate,
    rates_samples,
    role_of_name,
    separate_drives,
    separate_references,
)
from eoi_jax.data.impulses import single_row_notes
from eoi_jax.data.input_holds import STAIRCASE
from eoi_jax.data.readers.table import Table
from eoi_jax.data.sparse_inputs import between_entries, has_entries, is_seldom
from eoi_jax.data.time_axis import Clock, numbers_runs
from eoi_jax.data.wrapping import course

SMOOTH = "it moves smoothly"  # of an output that nothing but its values says to be one
STAMPS = ("dates", "times of day")  # kinds of values that are times


@dataclass(frozen=True)
class RoleSettings:
    """What tells an input by its values."""

    max_motion: float = 0.25  # share of the range: a mass moves less from one sample to the next
    # Of a signal that is held between rare changes, the changes that are larger than 1.5 quanta:
    # from this share on they are levels that somebody set, not a coarse sensor's.
    set_levels: float = 0.5
    # Of a log of events, standard deviation of the rows between two entries over their mean, and
    # the share of the entries that differ from the former one.
    uneven: float = 0.1
    new_values: float = 0.9


_SETTINGS = RoleSettings()


def assign_roles(
    channels: Sequence[Channel],
    table: Table,
    clock: Clock,
    numbers: Mapping[str, Float[np.ndarray, " time"]],
) -> list[Channel]:
    """The channels with roles guessed from the file, the names and the changes of the values.

    Args:
        channels: of all columns.
        table: the file, which may declare roles.
        clock: its time.
        numbers: values by column.
    """
    clocked = [
        replace(channel, role="time", why=clock.why) if channel.name == clock.column else channel
        for channel in channels
    ]
    declared = {**dict.fromkeys(table.inputs, "input"), **dict.fromkeys(table.outputs, "output")}
    roles, ratings = {}, {}
    for channel in clocked:
        if channel.name in declared:
            roles[channel.name] = (declared[channel.name], "the file says so")
        elif channel.kind in STAMPS or numbers_runs(
            numbers.get(channel.name), numbers.get(clock.column or "")
        ):
            continue
        elif (
            channel.role == "other" and channel.name in numbers and channel.name not in clock.others
        ):
            if rates_samples(channel.name, numbers, numbers[channel.name]):
                ratings[channel.name] = "other", RATING
                continue
            values = course(numbers[channel.name], channel.wraps)
            role, why = _role(channel, values, _by_events(values, clock))
            wraps = f"; it {channel.wraps.text}" if channel.wraps and role == "output" else ""
            roles[channel.name] = role, why + wraps
    moving = [key for key, (role, _) in roles.items() if role != "other"]
    undecided = [key for key, (role, _) in roles.items() if role == "other"]
    if len(undecided) == 1 and moving and not any(roles[key][0] == "output" for key in moving):
        roles[undecided[0]] = ("output", "it is the only column left")
    elif undecided and not moving:  # t, u, y is the usual order
        first = undecided[:1] if len(undecided) > 1 else []
        roles |= dict.fromkeys(first, ("input", "it comes first; there is no other evidence"))
        roles |= dict.fromkeys(
            undecided[len(first) :], ("output", "there is no evidence of its role")
        )
    separate_drives(roles, {at.name: at.saturated[0][0] for at in channels if at.saturated})
    held = {at.name for at in channels if _is_held(at) or _is_switched(numbers.get(at.name))}
    separate_references(roles, held)
    roles |= ratings
    return [
        replace(channel, role=roles[channel.name][0], why=roles[channel.name][1])
        if channel.name in roles
        else channel
        for channel in clocked
    ]


def as_input(
    channel: Channel, numbers: Mapping[str, Float[np.ndarray, " time"]], clock: Clock
) -> Channel:
    """An input without what is said of outputs only: noise of jumps, scores at rare entries.

    Args:
        channel: in the role of an input.
        numbers: values by column.
        clock: of the file.
    """
    values = numbers.get(channel.name)
    if values is None:
        return channel
    seldom: list[str] = []
    stamps = numbers[clock.column] if clock.column else np.arange(len(values), dtype=float)
    if np.all(np.diff(stamps) > 0):
        between_entries(stamps, values[:, None], (channel.name,), "auto", seldom)
        units = {channel.name: channel.unit}
        seldom += single_row_notes(stamps, values[:, None], [channel.name], units)
    others = (note for note in channel.notes if RATE not in note)
    channel = replace(channel, notes=(*others, *seldom))
    # The differences of a held signal measure its jumps, not its noise.
    jumps = _is_held(channel) or _is_switched(values) or _by_events(values, clock)
    return replace(channel, noise=None) if jumps else channel


def _is_held(channel: Channel) -> bool:
    return channel.changes is not None and channel.changes <= STAIRCASE


def _is_switched(values: Float[np.ndarray, " time"] | None) -> bool:
    """Whether a column is zero in more than half of its rows, and goes there from other levels."""
    if values is None:
        return False
    entered = values[np.isfinite(values)]
    steps, value_range = np.abs(np.diff(entered)), np.ptp(entered) if len(entered) else 0.0
    is_zero = 2 * int(np.sum(entered == 0.0)) > len(entered)
    return bool(is_zero and value_range > 0 and steps.max() > _SETTINGS.max_motion * value_range)


def hold_of_entries(values: Float[np.ndarray, " time"]) -> str:
    """A guess of the hold of an input that has entries in some rows: zero where they jump.

    Args:
        values: NaN between the entries.

    Returns:
        ``"zero"`` or ``"linear"``; "" where nearly all rows have an entry.
    """
    measured = np.isfinite(values)
    if not has_entries(measured):
        return ""
    steps = np.abs(np.diff(values[measured]))
    return "zero" if steps.max() > _SETTINGS.max_motion * np.ptp(values[measured]) else "linear"


def _by_events(values: Float[np.ndarray, " time"], clock: Clock) -> bool:
    """Whether a file has rows where something happened, and this column entries where it changed.

    A slow sensor, such as a laboratory, has entries at even distances, or rows that are even.
    """
    measured = np.isfinite(values)
    if not is_seldom(measured):
        return False
    rows, changes = np.diff(np.flatnonzero(measured)), np.diff(values[measured])
    uneven = (clock.jitter or 0.0, float(np.std(rows) / np.mean(rows)))
    is_new = float(np.mean(changes != 0)) >= _SETTINGS.new_values
    return is_new and min(uneven) > _SETTINGS.uneven


def _role(channel: Channel, values: Float[np.ndarray, " time"], by_events: bool) -> tuple[str, str]:
    (measured,) = np.nonzero(np.isfinite(values))
    # Between entries of events nothing is known of a course: the values themselves are compared.
    steps = np.abs(np.diff(values[measured])) / (1 if by_events else np.diff(measured))
    value_range = float(np.ptp(values[measured]))
    jump = float(steps.max()) / value_range if len(steps) and value_range > 0 else 0.0
    staircase = _is_held(channel)
    name_role = role_of_name(channel.name)
    # A rate is one of turning, which is measured, or that of a pump, which is on and off.
    is_switched = is_called_rate(channel.name) and _is_switched(values)
    called_output = name_role == "output" and not is_switched
    if name_role == "input":
        manner = ", and is held between changes" if staircase else ""
        return "input", f"its name says so{manner}"
    if jump > _SETTINGS.max_motion and (staircase or not called_output):
        if by_events:
            jumps = f"jumps by {100 * jump:.0f} % of its range from an entry to the next"
            return "input", f"it has entries where it changes, and {jumps}"
        manner = "is held and jumps" if staircase else "jumps"
        manner = "is zero in most rows and jumps" if is_switched else manner
        return "input", f"it {manner} by {100 * jump:.0f} % of its range in one sample"
    if called_output:
        return "output", "its name says so"
    if staircase and _is_set(steps, channel.quantum):
        return "input", "it is held between levels that are more than a step of its values apart"
    if jump <= _SETTINGS.max_motion and channel.changes and channel.changes > STAIRCASE:
        return "output", f"{SMOOTH}, at most {percent(jump)} of its range in one sample"
    return "other", "there is no evidence of its role"


def _is_set(steps: Float[np.ndarray, " steps"], quantum: float | None) -> bool:
    """Whether a staircase goes from level to level, and not by the steps of a coarse sensor."""
    changes = steps[steps > 0]
    if quantum is None or len(changes) == 0:
        return False
    return float(np.mean(changes > 1.5 * quantum)) > _SETTINGS.set_levels
