"""Parts of records that are estimated by themselves: the samples before and after a change.

Parameters may enter a model in any way: what one linear step from the estimate of all samples says
of a part is not that part's estimate. Its own passes say that.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from eoi_jax.data.record import Record
from eoi_jax.estimation.parameter_drift import own_drifts
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Part:
    """Samples of a record.

    Attributes:
        record: its index.
        start: first sample.
        stop: last sample, plus one.
        unscored: samples from `start` on that drive the model and are not scored.
    """

    record: int
    start: int
    stop: int
    unscored: int = 0

    def duration(self, records: Sequence[Record]) -> float:
        """Of what is scored [s]."""
        return (self.stop - self.start - self.unscored) * records[self.record].sample_period

    def cut(self, record: Record, substeps: int = 1) -> Record:
        """The part of the record, which may have sub-steps."""
        start, stop = self.start * substeps, (self.stop - 1) * substeps + 1
        return record if stop - start == len(record) else record.part(start, stop)


def prepared_parts(prepared: PreparedRecords, parts: Sequence[Part]) -> PreparedRecords:
    """Prepared records of which parts are the records.

    Args:
        prepared: all of them.
        parts: in order.
    """
    n = prepared.substeps
    return replace(
        prepared,
        records=tuple(part.cut(prepared.records[part.record]) for part in parts),
        fine=tuple(part.cut(prepared.fine[part.record], n) for part in parts),
        inputs=tuple(
            prepared.inputs[part.record][part.start * n : (part.stop - 1) * n] for part in parts
        ),
        velocity_noise=tuple(prepared.velocity_noise[part.record] for part in parts),
    )


def sides_of_change(
    plant: Plant, records: Sequence[Record], place: tuple[int, int], transient: float
) -> tuple[tuple[Part, ...], tuple[Part, ...]]:
    """The samples before and after a change, without those beside it that may belong to both.

    A change that comes as early in a record as scores do, or as late, is one from record to record.

    Args:
        plant: with internal states or actuators it must be driven from the start of a record on.
        records: as used.
        place: index of the record and of the sample in it.
        transient: time at the start of each record that is not scored [s].
    """
    parts = tuple(Part(i, 0, len(record)) for i, record in enumerate(records))
    i, sample = place
    gap, length = round(transient / records[i].sample_period), len(records[i])
    if sample <= 2 * gap and i > 0:
        return parts[:i], parts[i:]
    if sample >= length - gap and i + 1 < len(records):
        return parts[: i + 1], parts[i + 1 :]
    later = Part(i, sample, length)
    if plant.internal is not None or plant.actuator is not None:
        later = Part(i, 0, length, sample + gap)
    return (*parts[:i], Part(i, 0, max(sample - gap, 0))), (later, *parts[i + 1 :])


def with_own_drifts(
    fit: Any, transient: float, fit_of: Callable[[Sequence[Part]], Any | None]
) -> Any:
    """An `Identification` whose changes are those between estimates of the samples on both sides.

    Where a side by itself has no estimate, the changes stay as a linear step says them.

    Args:
        fit: with its history.
        transient: time at the start of each record that is not scored [s].
        fit_of: makes an estimate from parts of the records, or none.
    """
    history = fit.history
    if history is None or not history.drifts:
        return fit
    sides = sides_of_change(fit.plant, fit.records, history.drifts[0].place, transient)
    estimates = [fit_of(side) for side in sides]
    drifts = history.drifts
    if all(estimate is not None and estimate.status.ok for estimate in estimates):
        drifts = own_drifts(drifts, estimates)
    notes = (*fit.notes, *(drift.sentence for drift in drifts))
    return replace(fit, history=replace(history, drifts=drifts), notes=notes)
