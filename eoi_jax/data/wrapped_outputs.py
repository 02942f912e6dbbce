"""Outputs of records that wrap and are not unwrapped, which a fit takes for their motion."""

from collections.abc import Sequence

from eoi_jax.data.record import Record
from eoi_jax.data.unwrapping import TURNS_UNKNOWN
from eoi_jax.data.wrapping import JUMPS, wrap_notes


def wrapped_notes(records: Sequence[Record], repeated: bool = True) -> list[str]:
    """A sentence for each output that wraps, or was unwrapped across gaps that are too long.

    Args:
        records: as measured. Of one that was brought onto a uniform grid the jumps are no longer
            between two samples: what was found before is in its notes.
        repeated: whether what stands in the notes of a record is repeated.
    """
    notes = []
    for record in records:
        sentences = [note for note in record.notes if JUMPS in note or TURNS_UNKNOWN in note]
        if sentences and not repeated:
            continue
        signals = record.outputs, record.output_valid
        sentences = sentences or wrap_notes(record.output_names, *signals)
        notes += [f"{record.name}: {sentence}" for sentence in sentences]
    return notes
