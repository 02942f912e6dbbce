"""Inspection of a data file before anything is configured: its columns, its time and its signals.

Which column is the time, an input or an output is a guess, and is reported as a guess.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import RecordWarning, check, check_choice, counted, percent
from eoi_jax._display import Result
from eoi_jax.data.channel import Channel
from eoi_jax.data.cleaning import RATE, SHORTEST
from eoi_jax.data.clipping import saturations
from eoi_jax.data.column_names import (
    RATING,
    is_reference,
    unit_of_name,
)
from eoi_jax.data.column_roles import STAMPS, as_input, assign_roles
from eoi_jax.data.deadband import deadband_note
from eoi_jax.data.equal_stamps import at_distinct_stamps
from eoi_jax.data.input_holds import STAIRCASE
from eoi_jax.data.missing_codes import DECLARE, code_text, likely_codes
from eoi_jax.data.overflow import without_codes
from eoi_jax.data.readers.delimited import first_word
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.data.readers.long_form import found_clock, mixed_tags, stacked_topics
from eoi_jax.data.readers.read_record import read_table, words_among_numbers
from eoi_jax.data.readers.table import Table
from eoi_jax.data.readers.words import is_grouped
from eoi_jax.data.record import Record
from eoi_jax.data.repeats import repeat_note, rows_per_value, without_repeats
from eoi_jax.data.resampling import Real
from eoi_jax.data.standstill import standstill_notes
from eoi_jax.data.time_axis import (
    NAMED,
    Clock,
    daylight_saving,
    oldest_first,
    parts_between_restarts,
    seconds_from_first,
    stamped_rows,
)
from eoi_jax.data.wrapping import course, wrapping

_PERIODS = frozenset(["ts", "dt", "sampletime", "sampleperiod", "samplingperiod", "samplingtime"])
_RATES = frozenset(["fs", "samplerate", "samplingrate", "samplingfrequency"])


@dataclass(frozen=True)
class InspectionSettings:
    """What an inspection looks at, so that it takes seconds for a file of any size."""

    examined: int = 1_000_000  # samples of which noise, quantum and saturation are estimated
    spectrum_samples: int = 1 << 17  # samples of which the spectrum is taken
    band_power: float = 0.99  # share of a signal's power that lies in its band


_SETTINGS = InspectionSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Inspection(Result):
    """Contents of a data file, with guesses of their roles.

    `plot` shows the signals over time, their spectra, and the intervals between time stamps.

    Attributes:
        path: of the file.
        samples: number of rows of the columns in the file.
        clock: the time column, guessed.
        channels: the columns of that length.
        left_out: other contents of the file, and why they are no columns.
        notes: how the file was read.
        advice: what to check before a model is fitted.
        signals: values of the columns of numbers and dates, in float64; dates in seconds [s].
            Rows of one stamp are merged where that loses no value.
    """

    path: Path
    samples: int
    clock: Clock
    channels: tuple[Channel, ...]
    left_out: tuple[str, ...]
    notes: tuple[str, ...]
    advice: tuple[str, ...]
    signals: Mapping[str, Float[np.ndarray, " time"]]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the columns that look like inputs."""
        return tuple(channel.name for channel in self.channels if channel.role == "input")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the columns that look like outputs."""
        return tuple(channel.name for channel in self.channels if channel.role == "output")

    @property
    def references(self) -> tuple[str, ...]:
        """Names of the columns that look like references of a controller, beside an input."""
        unused = [channel.name for channel in self.channels if channel.role == "other"]
        return tuple(name for name in unused if self.inputs and is_reference(name))

    @property
    def parts(self) -> tuple[tuple[int, int], ...]:
        """Ranges of rows, first and last (excluded), between restarts of the logger."""
        if self.clock.column is None or not self.clock.backwards[0]:
            return ((0, self.samples),)
        return parts_between_restarts(self.signals[self.clock.column])

    def summary(self) -> dict[str, Any]:
        """The inspection as JSON values; numbers that are not finite become None."""
        return _plain(
            {
                "path": str(self.path),
                "samples": self.samples,
                "clock": asdict(self.clock),
                "inputs": self.inputs,
                "outputs": self.outputs,
                "channels": [asdict(channel) for channel in self.channels],
                "left_out": self.left_out,
                "notes": self.notes,
                "advice": self.advice,
            }
        )


@np.errstate(over="ignore", invalid="ignore")  # columns may hold numbers of any size
def inspect(
    path: str | Path,
    max_gigabytes: Real = MAX_GIGABYTES,
    *,
    time: str | None = None,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    sheet: str | None = None,
) -> Inspection:
    """Inspect a data file before anything is configured.

    Args:
        path: a file of a kind that `read_record` reads.
        max_gigabytes: largest unpacked size of a compressed file [1e9 bytes]; infinite for no
            limit.
        time: column of the stamps [s]; None: guessed.
        inputs: their columns; None: guessed.
        outputs: their columns; None: guessed.
        sheet: of an Excel file; None: the first that is not empty.

    Returns:
        The columns, the clock, and guesses of the roles: time [s], inputs and outputs.

    Raises:
        ValueError: a file that is missing, of an unknown kind, of another kind than its name
            says, or without a column of numbers of at least 8 rows; a column that is not in it, or
            is named in two roles.
    """
    path = Path(path)
    stored = read_table(path, max_gigabytes, sheet)
    table, unstamped = stamped_rows(oldest_first(stored))
    samples = _samples(path, table)
    codes, merged = list[str](), list[str]()
    numbers = _numbers(table, samples, codes)
    named = {"time": None if time is None else [time], "input": inputs, "output": outputs}
    _check_named(named, numbers, table)
    clock = found_clock(table, numbers, time)
    if clock.column is None:
        clock = _declared_period(table, clock)
    numbers = at_distinct_stamps(numbers, clock, merged)
    channels = [
        _channel(key, values, table, clock, numbers)
        for key, values in table.columns.items()
        if len(values) == samples
    ]
    channels = _with_named_roles(assign_roles(channels, table, clock, numbers), named)
    channels = [as_input(at, numbers, clock) if at.role == "input" else at for at in channels]
    left_out = [
        f"`{key}` of {counted(len(values), 'value')}"
        for key, values in table.columns.items()
        if len(values) != samples
    ]
    local = clock.column and table.columns[clock.column].dtype.kind == "M"
    shifts = daylight_saving(table.columns[clock.column]) if clock.column and local else []
    advice = [*shifts, *mixed_tags(table, clock.column)]
    advice += [f"`{at.name}` is no signal: {RATING}." for at in channels if at.why == RATING]
    broken = words_among_numbers(path, stored)
    if clock.sample_period is None and not broken:
        advice.append("No column looks like time: give sample_period, the seconds between samples.")
    backward = stacked_topics(numbers, clock) or _going_back(clock, shifts)
    checks = _advice(channels, clock, max(map(len, numbers.values())), backward)
    advice = (*unstamped, *broken, *codes, *merged, *advice, *checks)
    return Inspection(
        path, samples, clock, tuple(channels), (*left_out, *table.objects.values()),
        (*table.notes, *_unit_notes(channels, table)), advice, numbers,
    )  # fmt: skip


def _unit_notes(channels: Sequence[Channel], table: Table) -> list[str]:
    """Which units are no more than the ends of names."""
    ends = [f"{channel.unit} of `{channel.name}`" for channel in channels
            if channel.unit and not table.units.get(channel.name)]  # fmt: skip
    more = f" and {len(ends) - 8} more" if len(ends) > 8 else ""
    text = f"Units from the ends of the names: {', '.join(ends[:8])}{more}; nothing is converted."
    return [text] if ends else []


def _check_named(
    named: Mapping[str, Sequence[str] | None], numbers: Mapping[str, np.ndarray], table: Table
) -> None:
    """Columns whose roles the caller knows must be there, each in one role."""
    roles: dict[str, str] = {}
    for role, names in named.items():
        field = "time" if role == "time" else f"{role}s"
        for name in names or ():
            if name in table.columns and name not in numbers:
                got = f"`{name}` with {first_word(table.columns[name].tolist())!r}"
                advice = f"Choose from {', '.join(numbers)}, or leave the words out of its cells."
                check(False, field, "must be columns of numbers", got, advice)
            check_choice(field, name, tuple(numbers))
            rule = "must name columns without another role"
            check(name not in roles, field, rule, f"{name}, also {roles.get(name, '')}")
            roles[name] = role


def _with_named_roles(
    channels: Sequence[Channel], named: Mapping[str, Sequence[str] | None]
) -> list[Channel]:
    """The channels with the roles that the caller knows; none else has a role that is known."""
    roles = {name: role for role, names in named.items() for name in names or ()}
    given = {role for role, names in named.items() if names is not None}
    changed = []
    for channel in channels:
        if channel.name in roles:
            channel = replace(channel, role=roles[channel.name], why=NAMED)
        elif channel.role in given and channel.role != "time":
            channel = replace(channel, role="other", why="")
        changed.append(channel)
    return changed


def _declared_period(table: Table, clock: Clock) -> Clock:
    """The clock with the sample period that a setting, column or variable of the file holds."""
    if table.period is not None:
        setting, period = table.period
        return replace(clock, sample_period=period, why=f"`{setting}` is {period:g}")
    for key, values in table.columns.items():
        word = key.rsplit(".", 1)[-1].lower().replace("_", "")
        if values.dtype.kind not in "iuf" or word not in _PERIODS | _RATES:
            continue
        periods = np.unique(values[np.isfinite(values.astype(float))].astype(float))
        if len(periods) == 1 and periods[0] > 0:
            period = float(periods[0] if word in _PERIODS else 1.0 / periods[0])
            return replace(clock, sample_period=period, why=f"`{key}` is {periods[0]:g}")
    return clock


def _numbers(table: Table, samples: int, codes: list[str]) -> dict[str, Float[np.ndarray, " time"]]:
    """The columns of numbers and dates that have `samples` rows, in float64, shape (samples,).

    Args:
        table: the file.
        samples: rows.
        codes: to which sentences on codes of an overflow are added, and on what looks like a code
            for a missing value.
    """
    numbers = {}
    for key, values in table.columns.items():
        if len(values) != samples:
            continue
        if values.dtype.kind in "Mm":
            numbers[key] = seconds_from_first(values)
        elif values.dtype.kind in "biuf":
            column = without_codes(np.asarray(values, float)[:, None], (key,), codes)[:, 0]
            likely = likely_codes(column)
            codes += [
                _LIKELY.format(code_text(key, column, code), f"{USED_AS_MEASURED}[{code:.12g}].")
                for code in likely
            ]
            numbers[key] = np.where(np.isin(column, likely), np.nan, column)
    return numbers


# Behind the name of a column and its code; a draft has its own word on what to do.
_LIKELY = "{}: likely a code for a missing value, and left out of what is said here. {}"
USED_AS_MEASURED = f"In an input it is used as measured: {DECLARE} = "


def _samples(path: Path, table: Table) -> int:
    """The most frequent length of the columns of numbers; of two that are equal, the longer."""
    lengths = [len(values) for values in table.columns.values() if values.dtype.kind in "biufMm"]
    advice = f"It holds {', '.join(list(table.columns)[:10])}. {table.sheet_text}".strip()
    check(len(lengths) > 0, "path", "must hold a column of numbers", path, advice)
    candidates = [length for length in lengths if length >= SHORTEST]
    check(
        len(candidates) > 0,
        "path",
        f"must hold at least {SHORTEST} rows of numbers",
        f"{max(lengths)} in {path}",
        table.sheet_text,
    )
    return max(set(candidates), key=lambda n: (candidates.count(n) * min(n, 1000), n))


# -- one column ---------------------------------------------------------------------------

_KINDS = {
    "f": "numbers", "i": "whole numbers", "u": "whole numbers", "b": "truth values",
    "M": "dates", "m": "times of day", "c": "complex numbers",
}  # fmt: skip


def _channel(
    key: str,
    raw: np.ndarray,
    table: Table,
    clock: Clock,
    numbers: Mapping[str, Float[np.ndarray, " time"]],
) -> Channel:
    unit = table.units.get(key) or unit_of_name(key)
    kind = _KINDS.get(raw.dtype.kind, "text")
    if key not in numbers:
        missing = sum(value is None for value in raw.tolist())
        example = first_word(raw.tolist())
        reason = f"such as {example!r}" if example else ""
        reason += ": write numbers without thousands separators" if is_grouped(example) else ""
        return Channel(key, kind, unit, "text", reason, missing=missing)
    values = numbers[key]
    finite = np.isfinite(values)
    missing = int(np.sum(~finite))
    if not finite.any():
        return Channel(key, kind, unit, "constant", "it is empty", missing=missing)
    low, high = float(np.min(values[finite])), float(np.max(values[finite]))
    changes = float(np.mean(np.diff(values[finite]) != 0)) if finite.sum() > 1 else 0.0
    channel = Channel(key, kind, unit, "other", "", low, high, missing, changes)
    if raw.dtype.kind in "iuf":
        measured = without_codes(np.asarray(raw, float)[:, None], (key,), [])[:, 0]
        codes = likely_codes(measured)
        at_code = int(np.sum(np.isin(measured, codes)))
        channel = replace(channel, codes=codes, missing=max(missing - at_code, 0))
    if low == high:
        return replace(channel, role="constant", why="it never changes")
    if key == clock.column or kind in STAMPS:
        return channel
    wraps = wrapping(values, finite) if kind != "truth values" else None
    channel = replace(channel, wraps=wraps)
    return _measured(channel, course(values, channel.wraps), clock, numbers)


def _measured(
    channel: Channel,
    values: Float[np.ndarray, " time"],
    clock: Clock,
    numbers: Mapping[str, Float[np.ndarray, " time"]],
) -> Channel:
    """The channel with noise, quantum, saturation and band, from a record of only this channel."""
    part = slice(0, _SETTINGS.examined)
    name, rows = channel.name, rows_per_value(values[part])
    samples = without_repeats(values[:, None], (name,), [name], [])[:, 0] if rows else values
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        try:
            time = clock.factor * numbers[clock.column][part] if clock.column else None
            record = _record(time, samples[part], clock.sample_period or 1.0, name)
        except ValueError:  # too few samples for a record
            return channel
    silent = ("not finite", "Hold", *([RATE] if rows or clock.scattered else []))
    notes = tuple(note for note in record.notes if not any(text in note for text in silent))
    piles = tuple((end.level, end.share) for end in saturations(record) if end.channel == name)
    quantum = float(record.quantum[0])
    band = None
    if clock.sample_period:
        band = _band(record.bridged.outputs[:, 0], record.sample_period)
    return replace(
        channel,
        noise=float(record.noise[0]),
        quantum=quantum or None,
        saturated=piles,
        band=band,
        repeats=rows or None,
        notes=(*notes, *standstill_notes(name, values[part]), *deadband_note(name, values[part])),
    )


def _record(time: Any, values: Float[np.ndarray, " time"], period: float, name: str) -> Record:
    no_inputs = np.zeros((len(values), 0))
    if time is not None:
        try:
            return Record(time, no_inputs, values, output_names=[name])
        except ValueError:  # time that goes back: the samples are taken in the order of the file
            pass
    return Record.from_period(period, no_inputs, values, output_names=[name])


def _band(values: Float[np.ndarray, " time"], period: float) -> float | None:
    """Frequency below which 99 % of the power of the signal without its mean lies [Hz]."""
    part = values[: _SETTINGS.spectrum_samples]
    power = np.abs(np.fft.rfft((part - part.mean()) * np.hanning(len(part)))) ** 2
    total = np.cumsum(power[1:])
    if not total[-1] > 0:
        return None
    line = int(np.searchsorted(total, _SETTINGS.band_power * total[-1])) + 1
    return float(line / (len(part) * period))


# -- advice ------------------------------------------------------------------------------------


def _distinct(notes: Sequence[str]) -> list[str]:
    """Notes without repeats; what is masked besides, of a single channel, is said elsewhere."""
    shortest: dict[str, str] = {}
    for note in notes:
        start = note.partition(";")[0].removesuffix(".")
        shortest[start] = min(shortest.get(start, note), note, key=len)
    return list(shortest.values())


def _going_back(clock: Clock, shifts: Sequence[str]) -> str:
    """What to do where time goes back, beside sentences on summer time; empty where it does not."""
    count, first = clock.backwards
    if not count:
        return ""
    # Sorted by local times, the rows of an hour that came twice would alternate.
    doubled = any("an hour twice" in text for text in shifts)
    text = f"Time goes back {counted(count, 'time')}, first at row {first}, counted from 0. "
    text += "" if doubled else "If the logger started again there, "
    text += "`parts` of [data] in a config reads the parts as records of their own"
    return text + ("." if doubled else "; else sort the rows.")


def _advice(channels: Sequence[Channel], clock: Clock, samples: int, backward: str) -> list[str]:
    """Sentences on what a user should check first; `backward`: that on a time that goes back."""
    by_role = {
        role: [channel for channel in channels if channel.role == role]
        for role in ("input", "output")
    }
    advice = [backward] if backward else []
    moving = [*by_role["output"], *by_role["input"]]
    advice += [repeat_note(at.name, at.repeats) for at in by_role["output"] if at.repeats]
    if not backward:
        advice += _distinct([note for channel in moving for note in channel.notes])
    if not by_role["input"]:
        advice.append("No column looks like an input: a free system, or it must be named by hand.")
    if not by_role["output"]:
        words = [
            f"`{channel.name}`, {channel.why}" for channel in channels if channel.role == "text"
        ]
        text = f" Text, no numbers: {'; '.join(words[:5])}." if words else ""
        advice.append(f"No column looks like an output, numbers that change.{text}")
    else:
        texts = [channel for channel in channels if channel.role == "text" and channel.why]
        advice += [f"`{channel.name}` is left out: text {channel.why}." for channel in texts[:5]]
    for channel in by_role["input"]:
        if channel.band is not None and clock.sample_period:
            is_fast = not clock.scattered and (channel.changes or 0.0) > STAIRCASE
            nyquist = 0.5 / clock.sample_period
            if channel.changes is not None and channel.changes * samples < 5:
                times = counted(round(channel.changes * samples), "time")
                advice.append(f"`{channel.name}` changes {times} only: little excitation.")
            elif is_fast and channel.band > 0.5 * nyquist:
                advice.append(
                    f"`{channel.name}` moves up to half the Nyquist frequency: sample faster."
                )
    for channel in by_role["output"]:
        advice += [
            f"`{channel.name}` is saturated at {level:.6g}: {percent(share)} of the samples."
            for level, share in channel.saturated
        ]
    wraps = [(channel.name, channel.wraps) for channel in by_role["output"] if channel.wraps]
    advice += [f"`{name}` {wrap.text}: {wrap.advice(name)}." for name, wrap in wraps]
    for channel in by_role["output"]:
        if channel.quantum and channel.high is not None and channel.low is not None:
            levels = (channel.high - channel.low) / channel.quantum
            if levels < 50:
                values = counted(round(levels) + 1, "level")
                advice.append(f"`{channel.name}` takes {values} only: coarse.")
    missing = [
        f"`{channel.name}` {channel.missing}"
        for channel in channels
        if channel.role != "text" and 0 < channel.missing < samples
    ]
    if missing:
        advice.append(f"Empty or not finite: {', '.join(missing[:8])}; such samples are masked.")
    return advice


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
