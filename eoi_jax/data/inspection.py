"""What is in a file before anything is configured: its columns, its clock, what they look like.

Which column is the time, an input or an output is a guess, and called one.
"""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import RecordWarning, check
from eoi_jax._display import Result, text
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.clipping import saturations
from eoi_jax.data.readers.limits import MAX_GIGABYTES
from eoi_jax.data.readers.read_record import read_table
from eoi_jax.data.readers.table import Table
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import Real
from eoi_jax.data.time_axis import Clock, find_clock

_LOOKED = 1_000_000  # samples whose noise, steps and spectrum are looked at
_LINES = 1 << 17  # samples of a spectrum
_POWER = 0.99  # share of a signal's power that lies in its band
_HELD = 0.2  # share of steps that may change a held signal
_LEAP = 0.25  # of its range: a change from one sample to the next that no inertia allows

_INPUT = frozenset((
    "u", "in", "input", "inputs", "volt", "volts", "voltage", "cmd", "command", "pwm", "duty",
    "torque", "tau", "force", "ref", "reference", "referencia", "target", "setpoint", "drive",
    "control", "throttle", "pump", "valve", "heater", "power", "demand", "ctrl", "act",
    "actuator", "current", "v", "vir", "steer", "excitation",
))  # fmt: skip
_OUTPUT = frozenset((
    "y", "out", "output", "outputs", "angle", "angulo", "winkel", "pos", "position", "theta",
    "phi", "alpha", "q", "qm", "x", "level", "height", "h", "speed", "vel", "velocity", "rate",
    "omega", "rpm", "temp", "temperature", "pressure", "meas", "measured", "enc", "encoder",
    "sensor", "dist", "distance", "displacement", "response",
))  # fmt: skip
_REFERENCES = frozenset(("ref", "reference", "referencia", "target", "setpoint", "demand"))
_PERIODS = frozenset(["ts", "dt", "sampletime", "sampleperiod", "samplingperiod", "samplingtime"])
_RATES = frozenset(["fs", "samplerate", "samplingrate", "samplingfrequency"])


@dataclass(frozen=True)
class Channel:
    """One column of a file.

    Attributes:
        name: as `read_record` takes it.
        kind: what its values are: numbers, whole numbers, dates, truth values, text.
        unit: where the file says one.
        role: a guess: time, input, output, constant, text or other.
        why: for the role.
        low, high: smallest and largest value; None for text.
        missing: cells that are empty or not finite.
        changes: share of steps in which the value changes; None for text.
        noise: standard deviation of white measurement noise, estimated; see `Record.noise`. None
            of an input that is held.
        quantum: step of the values, if they are multiples of one.
        saturated: ends at which samples pile up: the level and the share of samples there.
        band: frequency below which 99 % of the power lies [Hz]; None where nothing moves.
        notes: what a record of it has to do about its time.
    """

    name: str
    kind: str
    unit: str = ""
    role: str = "other"
    why: str = ""
    low: float | None = None
    high: float | None = None
    missing: int = 0
    changes: float | None = None
    noise: float | None = None
    quantum: float | None = None
    saturated: tuple[tuple[float, float], ...] = ()
    band: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inspection(Result):
    """What is in a file; prints itself, and has a picture.

    `plot` shows signals over time, their spectra, and the distances of the stamps.

    Attributes:
        path: of the file.
        samples: rows of its columns.
        clock: its time, a guess.
        channels: its columns of that length.
        left_out: what else is in it, and why it is no column.
        notes: how it was read.
        advice: what to look at before anything is fitted.
        signals: the columns of numbers and dates themselves, in float64; dates in seconds [s].
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
        return tuple(one.name for one in self.channels if one.role == "input")

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the columns that look like outputs."""
        return tuple(one.name for one in self.channels if one.role == "output")

    def summary(self) -> dict[str, Any]:
        """Everything as values that JSON has; numbers that are not finite are None."""
        return _plain(
            {
                "path": str(self.path),
                "samples": self.samples,
                "clock": asdict(self.clock),
                "inputs": self.inputs,
                "outputs": self.outputs,
                "channels": [asdict(one) for one in self.channels],
                "left_out": self.left_out,
                "notes": self.notes,
                "advice": self.advice,
            }
        )

    def __repr__(self) -> str:
        return text(self)


@np.errstate(over="ignore", invalid="ignore")  # of numbers that are no measurement
def inspect(path: str | Path, max_gigabytes: Real = MAX_GIGABYTES) -> Inspection:
    """Look at a file before anything is configured.

    Args:
        path: a file of a kind that `read_record` knows.
        max_gigabytes: what a compressed file may unpack to [1e9 bytes]; infinite for no limit.

    Returns:
        Its columns, its clock, and guesses of what is what: time [s], inputs and outputs.

    Raises:
        ValueError: a file that is missing, of an unknown kind, not what its name says, or
            without a column of numbers of at least 8 rows.
    """
    path = Path(path)
    table = read_table(path, max_gigabytes)
    samples = _samples(path, table)
    numbers = _numbers(table, samples)
    clock = find_clock(table, numbers)
    if clock.column is None:
        clock = _said_period(table, clock)
    channels = [
        _channel(key, values, table, clock, numbers)
        for key, values in table.columns.items()
        if len(values) == samples
    ]
    channels = _with_roles(channels, table, clock, numbers)
    left_out = [
        f"`{key}` of {len(values)} values"
        for key, values in table.columns.items()
        if len(values) != samples
    ]
    advice = tuple(_advice(channels, clock, samples))
    return Inspection(
        path, samples, clock, tuple(channels), (*left_out, *table.objects.values()),
        table.notes, advice, numbers,
    )  # fmt: skip


def _said_period(table: Table, clock: Clock) -> Clock:
    """The sample period that a file without time says in a column or variable of its own."""
    for key, values in table.columns.items():
        word = key.rsplit(".", 1)[-1].lower().replace("_", "")
        if values.dtype.kind not in "iuf" or word not in _PERIODS | _RATES:
            continue
        known = np.unique(values[np.isfinite(values.astype(float))].astype(float))
        if len(known) == 1 and known[0] > 0:
            period = float(known[0] if word in _PERIODS else 1.0 / known[0])
            return replace(clock, sample_period=period, why=f"`{key}` says {known[0]:g}")
    return clock


def _numbers(table: Table, samples: int) -> dict[str, Float[np.ndarray, " time"]]:
    """The columns of numbers and dates of one length, in float64."""
    found = {}
    for key, values in table.columns.items():
        if len(values) != samples:
            continue
        if values.dtype.kind in "Mm":
            found[key] = (values - values[0]) / np.timedelta64(1, "s")
        elif values.dtype.kind in "biuf":
            found[key] = values.astype(np.float64, copy=False)
    return found


def _samples(path: Path, table: Table) -> int:
    """The length that the most columns of numbers have, and the longer one of two."""
    lengths = [len(one) for one in table.columns.values() if one.dtype.kind in "biufMm"]
    check(
        len(lengths) > 0,
        "path",
        "must hold a column of numbers",
        path,
        f"It holds {', '.join(list(table.columns)[:10])}.",
    )
    long = [one for one in lengths if one >= SHORTEST]
    check(
        len(long) > 0,
        "path",
        f"must hold at least {SHORTEST} rows of numbers",
        f"{max(lengths)} in {path}",
    )
    return max(set(long), key=lambda one: (long.count(one) * min(one, 1000), one))


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
    unit = table.units.get(key, "")
    kind = _KINDS.get(raw.dtype.kind, "text")
    if key not in numbers:
        missing = sum(value is None for value in raw.tolist())
        odd = next((value for value in raw.tolist() if isinstance(value, str)), "")
        why = f"such as {odd!r}" if odd else ""
        return Channel(key, kind, unit, "text", why, missing=missing)
    values = numbers[key]
    good = np.isfinite(values)
    missing = int(np.sum(~good))
    if not good.any():
        return Channel(key, kind, unit, "constant", "it is empty", missing=missing)
    low, high = float(np.min(values[good])), float(np.max(values[good]))
    changes = float(np.mean(np.diff(values[good]) != 0)) if good.sum() > 1 else 0.0
    known = Channel(key, kind, unit, "other", "", low, high, missing, changes)
    if low == high:
        return replace(known, role="constant", why="it never changes")
    if key == clock.column or kind in ("dates", "times of day"):
        return known
    return _measured(known, values, clock, numbers)


def _measured(
    channel: Channel,
    values: Float[np.ndarray, " time"],
    clock: Clock,
    numbers: Mapping[str, Float[np.ndarray, " time"]],
) -> Channel:
    """With noise, steps, saturation and band: those of a record of this channel alone."""
    part = slice(0, _LOOKED)
    name = "y"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)
        try:
            time = clock.factor * numbers[clock.column][part] if clock.column else None
            record = _record(time, values[part], clock.sample_period or 1.0)
        except ValueError:  # fewer than a record needs
            return channel
    notes = tuple(one for one in record.notes if "not finite" not in one and "Hold" not in one)
    piles = tuple((one.level, one.share) for one in saturations(record) if one.channel == name)
    quantum = float(record.quantum[0])
    band = _band(record.outputs[:, 0], record.sample_period) if clock.sample_period else None
    return replace(
        channel,
        noise=float(record.noise[0]),
        quantum=quantum or None,
        saturated=piles,
        band=band,
        notes=notes,
    )


def _record(time: Any, values: Float[np.ndarray, " time"], period: float) -> Record:
    none = np.zeros((len(values), 0))
    if time is not None:
        try:
            return Record(time, none, values, output_names=["y"])
        except ValueError:  # time that goes back: the samples are looked at in their order
            pass
    return Record.from_period(period, none, values, output_names=["y"])


def _band(values: Float[np.ndarray, " time"], period: float) -> float | None:
    """Frequency below which 99 % of the power of the differences from the mean lies [Hz]."""
    part = values[:_LINES]
    power = np.abs(np.fft.rfft((part - part.mean()) * np.hanning(len(part)))) ** 2
    total = np.cumsum(power[1:])
    if not total[-1] > 0:
        return None
    line = int(np.searchsorted(total, _POWER * total[-1])) + 1
    return float(line / (len(part) * period))


# -- what they look like ------------------------------------------------------------------


def _with_roles(
    channels: Sequence[Channel],
    table: Table,
    clock: Clock,
    numbers: Mapping[str, Float[np.ndarray, " time"]],
) -> list[Channel]:
    """Time, inputs and outputs guessed: from the file, the names, and how the values move."""
    known = [
        replace(one, role="time", why=clock.why) if one.name == clock.column else one
        for one in channels
    ]
    said = {**dict.fromkeys(table.inputs, "input"), **dict.fromkeys(table.outputs, "output")}
    roles = {}
    for one in known:
        if one.name in said:
            roles[one.name] = (said[one.name], "the file says so")
        elif one.role == "other" and one.name in numbers and one.name not in clock.others:
            roles[one.name] = _role(one, numbers[one.name])
    moving = [key for key, (role, _) in roles.items() if role != "other"]
    unsure = [key for key, (role, _) in roles.items() if role == "other"]
    if len(unsure) == 1 and moving and not any(roles[key][0] == "output" for key in moving):
        roles[unsure[0]] = ("output", "it is what is left")
    elif unsure and not moving:  # t, u, y is the order that most people write
        first = unsure[:1] if len(unsure) > 1 else []
        roles |= dict.fromkeys(first, ("input", "it stands first, and nothing else tells"))
        roles |= dict.fromkeys(unsure[len(first) :], ("output", "nothing tells"))
    _set_apart(roles)
    told = [
        replace(one, role=roles[one.name][0], why=roles[one.name][1]) if one.name in roles else one
        for one in known
    ]
    # Differences of a signal that is held and jumps tell its jumps, not its noise.
    return [replace(one, noise=None) if _is_held_input(one) else one for one in told]


def _is_held_input(one: Channel) -> bool:
    return one.role == "input" and one.changes is not None and one.changes <= _HELD


def _set_apart(roles: dict[str, tuple[str, str]]) -> None:
    """No reference beside the input that follows from it; and one output at least."""
    inputs = [key for key, (role, _) in roles.items() if role == "input"]
    references = [key for key in inputs if _REFERENCES & set(_words(key))]
    if len(references) < len(inputs):
        roles |= dict.fromkeys(references, ("other", "a reference, beside another input"))
        inputs = [key for key in inputs if key not in references]
    if len(inputs) > 1 and not any(role == "output" for role, _ in roles.values()):
        roles[max(inputs)] = ("output", "there must be one, and it comes last by its name")


def _words(name: str) -> list[str]:
    """The words of a name, without its path and unit: ``log.motorVoltage_2 [V]``."""
    stem = name.rsplit(".", 1)[-1].rsplit("/", 1)[-1]
    plain = re.sub(r"[\[(].*", "", stem)
    return [word.lower() for word in re.findall(r"[A-Z]?[a-zµ]+|[A-Z]+", plain)]


def _named(name: str) -> str:
    """What a name says: the first of its words that is known decides."""
    for word in _words(name):
        if word in _INPUT or word in _OUTPUT:
            return "input" if word in _INPUT else "output"
    return ""


def _role(channel: Channel, values: Float[np.ndarray, " time"]) -> tuple[str, str]:
    steps = np.abs(np.diff(values[np.isfinite(values)]))
    reach = float((channel.high or 0.0) - (channel.low or 0.0))
    leap = float(steps.max()) / reach if len(steps) and reach > 0 else 0.0
    held = channel.changes is not None and channel.changes <= _HELD
    named = _named(channel.name)
    named_out = named == "output"
    if named == "input":
        how = ", and is held between changes" if held else ""
        return "input", f"it is called so{how}"
    if leap > _LEAP and (held or not named_out):
        how = "is held and jumps" if held else "jumps"
        return "input", f"it {how} by {100 * leap:.0f} % of its range in one sample"
    if named_out:
        return "output", "it is called so"
    if leap <= _LEAP and channel.changes and channel.changes > _HELD:
        return "output", f"it moves smoothly, at most {100 * leap:.2g} % of its range in one sample"
    return "other", "nothing tells"


def _advice(channels: Sequence[Channel], clock: Clock, samples: int) -> list[str]:
    """What a user should look at first."""
    by_role = {role: [one for one in channels if one.role == role] for role in ("input", "output")}
    said = []
    if clock.sample_period is None:
        said.append("No column looks like time: give sample_period, the seconds between samples.")
    count, first = clock.backwards
    if count:
        said.append(
            f"Time goes back {count} times, first at row {first}: sort the rows, or split the "
            "record there (slice)."
        )
    moving = [*by_role["output"], *by_role["input"]]
    if not count:
        said += dict.fromkeys(note for one in moving for note in one.notes)
    if not by_role["input"]:
        said.append("No column looks like an input: a free system, or it must be named by hand.")
    for one in by_role["input"]:
        if one.band is not None and clock.sample_period:
            nyquist = 0.5 / clock.sample_period
            if one.changes is not None and one.changes * samples < 5:
                said.append(f"`{one.name}` changes {one.changes * samples:.0f} times only: little "
                            "excitation.")  # fmt: skip
            elif one.band > 0.5 * nyquist and one.changes and one.changes > _HELD:
                said.append(f"`{one.name}` moves up to half the Nyquist frequency: sample faster.")
    for one in by_role["output"]:
        said += [
            f"`{one.name}` is saturated at {level:.6g}: {100 * share:.2g} % of the samples."
            for level, share in one.saturated
        ]
    for one in by_role["output"]:
        if one.quantum and one.high is not None and one.low is not None:
            levels = (one.high - one.low) / one.quantum
            if levels < 50:
                said.append(f"`{one.name}` takes {levels + 1:.0f} levels only: coarse.")
    missing = [
        f"`{one.name}` {one.missing}" for one in channels if one.missing and one.role != "text"
    ]
    if missing:
        said.append(f"Empty or not finite: {', '.join(missing[:8])}; such samples are masked.")
    return said


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
