r"""The hold of the inputs by the passes: the one with the smallest index (14), on one filter.

The logarithm of the index is that of the likelihood of a white injection.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from eoi_jax.data.holds import SETTINGS, best_hold, evidence, undeclared_hold, with_hold
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import HOLDS
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


def decided(
    plant: Plant, records: Sequence[Record], index_of: IndexOf, lowpass: LowPass | None = None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records with the hold that the model fits best, and the evidence as a sentence.

    Arguments are those of `hold_indices`.
    """
    indices = hold_indices(plant, records, index_of, lowpass)
    if indices is None or not np.isfinite(indices.by_hold[indices.best]):
        return tuple(records), ()
    return with_hold(records, indices.best), indices.evidence
