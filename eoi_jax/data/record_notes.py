"""What was masked, dropped or resampled in records, in few sentences however many records."""

import re
from collections.abc import Callable, Sequence

from eoi_jax._checks import counted
from eoi_jax.data.impulses import SINGLE_ROWS
from eoi_jax.data.input_holds import HOLD_TAKEN
from eoi_jax.data.record import Record
from eoi_jax.data.repeats import REPEATS


def record_notes(records: Sequence[Record]) -> list[str]:
    """The notes of records; those that differ in numbers alone are one sentence, of the first.

    What is said of a hold is left out: a fit may choose another one.

    Args:
        records: as they were read.

    Returns:
        Sentences such as ``"run 1: 7 of 360 samples are not finite (`h` 7): masked; alike in run
        2"``.
    """
    return _alike(records, lambda note: not note.startswith(HOLD_TAKEN))


def same_record_notes(records: Sequence[Record]) -> list[str]:
    """A sentence on each record that is more than once among those of a fit.

    Args:
        records: as they were read.
    """
    if len(records) < 2:
        return []
    places: dict[str, list[int]] = {}
    for place, record in enumerate(records):
        places.setdefault(record.data_hash, []).append(place)
    return [
        f"records {', '.join(str(place + 1) for place in copies)} ({records[copies[0]].name}) are "
        f"the same data, counted {len(copies)} times: the ± are too small. Leave out all but one"
        for copies in places.values()
        if len(copies) > 1
    ]


def biasing_notes(records: Sequence[Record]) -> list[str]:
    """The notes of records on what biases a fit, and is only known to who made the files.

    These are on outputs that repeat their last value until the next one comes, and on inputs that
    may be amounts.

    Args:
        records: as they were read.
    """
    return _alike(records, lambda note: REPEATS in note or SINGLE_ROWS in note)


def _alike(records: Sequence[Record], chosen: Callable[[str], bool]) -> list[str]:
    """The chosen notes; those that differ in numbers alone are one sentence."""
    alike: dict[str, dict[str, str]] = {}  # the note of each record, by the note without numbers
    for record in records:
        for note in filter(chosen, record.notes):
            form = re.sub(r"[\d.]+(e[+-]?\d+)?", "#", note)
            alike.setdefault(form, {}).setdefault(record.name, note.rstrip("."))
    return [_sentence(notes) for notes in alike.values()]


def _sentence(notes: dict[str, str]) -> str:
    """The note of the first record, and which others have one like it."""
    first, *names = notes
    sentence = f"{first}: {notes[first]}"
    if not names:
        return sentence
    records = " and ".join(names) if len(names) < 3 else counted(len(names), "other record")
    return f"{sentence}; alike in {records}"
