r"""The hold and the skew of the inputs by the passes: those with the smallest index (14).

The logarithm of the index is that of the likelihood of a white injection. The power of the
injection is a parabola in a small delay of an input, so three fits find its minimum.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.holds import (
    SETTINGS,
    best_hold,
    evidence,
    least_of_parabola,
    skew_text,
    undeclared_hold,
    with_hold,
)
from eoi_jax.data.input_holds import HOLDS
from eoi_jax.data.record import Record
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import PreparedRecords, prepare_records
from eoi_jax.models.plant import Plant

IndexOf = Callable[[Plant, PreparedRecords, int], float]


@dataclass(frozen=True)
class HoldIndices:
    """The index (14) of the declared model with each hold, on one filter.

    Attributes:
        by_hold: geometric mean over the outputs; infinite where there is no estimate.
        rule: the hold that the samples of the inputs suggest.
        lowpass: the filter.
    """

    by_hold: dict[str, float]
    rule: str
    lowpass: LowPass

    @property
    def best(self) -> str:
        """The hold with the smallest index; that of the rule where it is hardly larger."""
        return best_hold(self.by_hold, self.rule)

    @property
    def possible(self) -> tuple[str, ...]:
        """Holds that are not refuted, the best one first; linear and smooth are often the same."""
        smallest = self.by_hold[self.best]
        holds = sorted(self.by_hold, key=lambda hold: (hold != self.best, self.by_hold[hold]))
        kept: list[str] = []
        for hold in holds:
            index = self.by_hold[hold]
            refuted = not index <= SETTINGS.refuted * smallest
            same = hold != "zero" and any(
                abs(np.log(index / self.by_hold[other])) <= SETTINGS.same
                for other in kept
                if other != "zero"
            )
            if not refuted and not same:
                kept.append(hold)
        return tuple(kept) or (self.rule,)

    @property
    def evidence(self) -> tuple[str, ...]:
        """The ratios as a sentence."""
        return evidence("the index", self.by_hold, self.best)


def hold_indices(
    plant: Plant, records: Sequence[Record], index_of: IndexOf, lowpass: LowPass | None = None
) -> HoldIndices | None:
    """The index with each hold.

    Args:
        plant: with its nominal parameters.
        records: checked against the plant; one logger is taken to have made all of them.
        index_of: fits the plant to prepared records in a few passes, and gives the index; infinite
            where there is no estimate.
        lowpass: F of the fits; None: chosen from the records.

    Returns:
        None where every record declares its hold, or the plant has no inputs.
    """
    rule = undeclared_hold(records)
    if rule is None:
        return None
    indices: dict[str, float] = {}
    for hold in (rule, *(hold for hold in HOLDS if hold != rule)):
        prepared = prepare_records(plant, with_hold(records, hold), lowpass)
        lowpass = prepared.lowpass  # indices of different filters cannot be compared
        indices[hold] = index_of(plant, prepared, SETTINGS.passes)
    assert lowpass is not None
    return HoldIndices(indices, rule, lowpass)


@dataclass(frozen=True)
class Skew:
    """How far the inputs are from the outputs in the log.

    Attributes:
        hold: of the inputs, with which the delays were found.
        delays: by which each input acts later than it was logged, shape (nu,) [s].
        index: with them; infinite where they were not found by it.
        ratio: of the index without them to that with them; None as well.
    """

    hold: str
    delays: Float[np.ndarray, " nu"]
    index: float = np.inf
    ratio: float | None = None

    def evidence(self, record: Record) -> str:
        """The delays in one of the records, and the ratio, as a sentence."""
        text = skew_text(record, self.delays)
        if self.ratio is None:
            return f"{text}: a delay this short is taken for one of the logger"
        return f"{text}: without this shift the index is {self.ratio:.3g} times as large"


def best_skew(
    plant: Plant, records: Sequence[Record], hold: str, index_of: IndexOf, lowpass: LowPass
) -> Skew | None:
    """The hold and the skew with the smallest index, where the inputs have any skew.

    A held input that acts early and one that goes on and acts late are nearly the same, so all
    holds are tried once the best one without a skew has shown some.

    Args:
        plant: with its nominal parameters.
        records: as they were read.
        hold: that fits best without a skew.
        index_of: as for `hold_indices`.
        lowpass: F of the fits.
    """
    first = channel_skew(plant, records, hold, index_of, lowpass)
    if first is None:
        return None
    others = [channel_skew(plant, records, other, index_of, lowpass)
              for other in HOLDS if other != hold]  # fmt: skip
    found = [first, *(skew for skew in others if skew is not None)]
    best = min(found, key=lambda skew: skew.index)
    return best if _clearly_smaller(best.index, first.index, records, lowpass) else first


def _clearly_smaller(
    index: float, other: float, records: Sequence[Record], lowpass: LowPass
) -> bool:
    """Whether an index is smaller by more than chance, and by enough to matter.

    In a band of ω_c there are ω_c T / π independent values in the time T, and their number times
    the logarithm of the ratio is twice the gain in log-likelihood.
    """
    if not index < (1.0 - SETTINGS.least_fall) * other:
        return False
    duration = sum(len(record) * record.sample_period for record in records)
    gain = lowpass.cutoff * duration / np.pi * np.log(other / index)
    return bool(gain >= SETTINGS.evidence)


def channel_skew(
    plant: Plant, records: Sequence[Record], hold: str, index_of: IndexOf, lowpass: LowPass
) -> Skew | None:
    """The skew of the inputs with the smallest index, one input after the other.

    Args:
        plant: with its nominal parameters.
        records: as they were read; those that declare their hold are not shifted.
        hold: of the other ones.
        index_of: as for `hold_indices`.
        lowpass: F of the fits.

    Returns:
        None where no shift within a sample period lowers the index clearly: what acts later than
        that is a delay of the plant.
    """

    def index(delays: Float[np.ndarray, " nu"]) -> float:
        shifted = with_hold(records, hold, delays)
        return index_of(plant, prepare_records(plant, shifted, lowpass), SETTINGS.passes)

    period = min(record.sample_period for record in records)
    delays = np.zeros(records[0].inputs.shape[1])
    without = smallest = index(delays)
    for step in SETTINGS.trial_skews:
        for shift in period * step * np.eye(len(delays)):
            values = index(delays - shift), smallest, index(delays + shift)
            place = least_of_parabola(values)
            if place is None:
                continue
            trial = delays + place * shift
            within = np.max(np.abs(trial)) <= period
            if within and (value := index(trial)) < smallest:
                delays, smallest = trial, value
        if not np.any(delays):
            return None
    seen = np.max(np.abs(delays)) >= SETTINGS.least_skew * period
    if not seen or not _clearly_smaller(smallest, without, records, lowpass):
        return None
    return Skew(hold, delays, smallest, without / smallest)


def decided(
    plant: Plant, records: Sequence[Record], index_of: IndexOf, lowpass: LowPass | None = None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records with the hold and the skew that the model fits best, and the evidence as sentences.

    Arguments are those of `hold_indices`.
    """
    indices = hold_indices(plant, records, index_of, lowpass)
    if indices is None or not np.isfinite(indices.by_hold[indices.best]):
        return tuple(records), ()
    skew = best_skew(plant, records, indices.best, index_of, indices.lowpass)
    if skew is None:
        return with_hold(records, indices.best), indices.evidence
    shifted = with_hold(records, skew.hold, skew.delays)
    notes = indices.evidence if skew.hold == indices.best else (f"hold {skew.hold}",)
    return shifted, (*notes, skew.evidence(records[0]))
