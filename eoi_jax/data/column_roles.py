"""Guesses of which column is an input and which an output: from the file, its names, its values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import percent
from eoi_jax.data.channel import Channel
from eoi_jax.data.column_names import (
    RATING,
    rates_samples,
    role_of_name,
    separate_drives,
    separate_references,
)
from eoi_jax.data.input_holds import STAIRCASE
from eoi_jax.data.readers.table import Table
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
            role, why = _role(channel, course(numbers[channel.name], channel.wraps))
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
    separate_references(roles, {channel.name for channel in channels if _is_held(channel)})
    roles |= ratings
    labelled = [
        replace(channel, role=roles[channel.name][0], why=roles[channel.name][1])
        if channel.name in roles
        else channel
        for channel in clocked
    ]
    # The differences of a held signal measure its jumps, not its noise.
    return [
        replace(channel, noise=None) if channel.role == "input" and _is_held(channel) else channel
        for channel in labelled
    ]


def _is_held(channel: Channel) -> bool:
    return channel.changes is not None and channel.changes <= STAIRCASE


def _role(channel: Channel, values: Float[np.ndarray, " time"]) -> tuple[str, str]:
    (measured,) = np.nonzero(np.isfinite(values))
    steps = np.abs(np.diff(values[measured])) / np.diff(measured)
    value_range = float(np.ptp(values[measured]))
    jump = float(steps.max()) / value_range if len(steps) and value_range > 0 else 0.0
    staircase = _is_held(channel)
    name_role = role_of_name(channel.name)
    called_output = name_role == "output"
    if name_role == "input":
        manner = ", and is held between changes" if staircase else ""
        return "input", f"its name says so{manner}"
    if jump > _SETTINGS.max_motion and (staircase or not called_output):
        manner = "is held and jumps" if staircase else "jumps"
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
