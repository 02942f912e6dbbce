"""What an inspection says of one column of a file."""

from dataclasses import dataclass

from eoi_jax.data.wrapping import Wrapping


@dataclass(frozen=True)
class Channel:
    """One column of a file.

    Attributes:
        name: as `read_record` takes it.
        kind: kind of the values: numbers, whole numbers, dates, truth values, text.
        unit: as the file gives it, or empty.
        role: guessed role: time, input, output, constant, text or other.
        why: reason for the role.
        low, high: smallest and largest value; None for text.
        missing: number of cells that are empty or not finite.
        changes: share of steps in which the value changes; None for text.
        noise: estimated standard deviation of white measurement noise; see `Record.noise`. None
            for an input that is held. Of a column that repeats its values, noise and band are those
            of the values without the repeats.
        quantum: step of the values, if they are multiples of one step.
        saturated: level and share of samples of each end at which samples pile up.
        wraps: how it wraps, as a counter or an angle does; None: it does not. Noise, quantum,
            saturation and band are then those of the unwrapped values.
        band: frequency below which 99 % of the power lies [Hz]; None for a constant signal.
        repeats: mean number of rows for which it keeps a value until the next one comes; None: it
            does not.
        codes: values that look like codes for a missing value; the other attributes are those of
            the column without them.
        notes: what a record of this column does about the time stamps, and where it may be frozen.
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
    wraps: Wrapping | None = None
    repeats: float | None = None
    codes: tuple[float, ...] = ()
