"""Columns that repeat each value until the next one comes, as merged logs have of slower sensors.

A GPS with 5 values a second in rows 0.01 s apart changes in every 20th row. Between them the stored
value is old: a fit takes its age for a delay, and its equal errors for little noise. What tells:
the values change by many levels or not at all, and the rows between two changes are about as many
each time. A coarse sensor changes by single levels, one that is stored with a deadband at irregular
times (`deadband.py`), and what rests between moves changes many times in a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check_choice, counted
from eoi_jax._types import OutputMask, Outputs, Signals
from eoi_jax.data.noise import quanta

REPEATS = "repeats its value in the others"  # of a note on such a column


@dataclass(frozen=True)
class RepeatSettings:
    """What of the rows between changes shows repeated values."""

    fewest: int = 20  # changes of the value
    rows: float = 1.5  # between two changes, on average, at least
    longest: float = 0.1  # share of the distances that is left out: the signal was at rest
    scatter: float = 0.4  # of the others over their mean, at most
    one_level: float = 1.5  # quanta up to which a change is by one level
    single: float = 0.3  # share of the changes that may be by one level


_SETTINGS = RepeatSettings()


def rows_per_value(values: Float[np.ndarray, " samples"]) -> float:
    """Mean number of rows for which a column keeps a value until the next one comes.

    Args:
        values: NaN where a cell is empty.

    Returns:
        That number, without the times at which the signal is at rest; 0 where values are not kept.
    """
    (filled,) = np.nonzero(np.isfinite(values))
    steps = np.diff(values[filled])
    changes = np.abs(steps[steps != 0.0])
    if len(changes) < _SETTINGS.fewest or len(changes) * _SETTINGS.rows > len(steps):
        return 0.0
    distances = np.sort(np.diff(np.flatnonzero(steps)))
    usual = distances[: len(distances) - int(_SETTINGS.longest * len(distances))]
    mean = float(np.mean(usual))
    if mean < _SETTINGS.rows or np.std(usual) > _SETTINGS.scatter * mean:
        return 0.0
    quantum = float(quanta(values[filled, None], np.ones((len(filled), 1), bool))[0])
    by_one_level = float(np.mean(changes <= _SETTINGS.one_level * quantum))
    return mean if by_one_level <= _SETTINGS.single else 0.0


def repeat_note(name: str, rows: float) -> str:
    """The sentence on a channel that keeps its values until the next one comes.

    Args:
        name: of the channel.
        rows: of `rows_per_value`.
    """
    return _REPEATED.format(name, rows)


def repeat_notes(names: Sequence[str], values: Outputs, measured: OutputMask) -> list[str]:
    """The sentence on each channel that keeps its values until the next one comes.

    Args:
        names: of the channels.
        values: one column each.
        measured: which of them count.
    """
    columns = np.where(measured, values, np.nan).T
    rows = [rows_per_value(column) for column in columns]
    return [repeat_note(name, mean) for name, mean in zip(names, rows, strict=True) if mean]


def without_repeats(
    signals: Signals, names: Sequence[str], chosen: Sequence[str], notes: list[str]
) -> Signals:
    """Signals with NaN where a chosen channel has the value of the cell before; a note counts them.

    Args:
        signals: one row a sample.
        names: of the channels.
        chosen: names of those whose repeats are no samples.
        notes: to which a sentence on each chosen channel is added.

    Raises:
        ValueError: a name that is none of the channels.
    """
    emptied = np.array(signals)
    for name in chosen:
        check_choice("empty_repeats", name, tuple(names))
        column = emptied[:, list(names).index(name)]
        (filled,) = np.nonzero(np.isfinite(column))
        repeats = filled[1:][np.diff(column[filled]) == 0.0]
        column[repeats] = np.nan
        count = counted(len(filled), "value")
        notes.append(f"`{name}`: {len(repeats)} of {count} repeat the one before: left out.")
    return emptied


_REPEATED = (
    f"`{{}}` changes once in {{:.3g}} rows and {REPEATS}: it looks like a slower "
    "sensor whose last value is stored until the next one comes. Such values are old, which fits "
    "take for a delay. Name it in `empty_repeats` (of `read_record` or [data]), which makes the "
    "repeats missing samples, or leave these cells empty (NaN)."
)
