"""Holds of inputs that no record declares: the rule, the alternatives, and how one is chosen.

What drives the plant between two samples is not in the samples: a converter held the last value, or
the input went on. Against the samples the two differ by a delay of half a sample, which a model
takes for physics. So what fits decides: the index in an identification, the free run's error in a
refinement or a validation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from eoi_jax.data.record import Record
from eoi_jax.data.resampling import HOLDS


@dataclass(frozen=True)
class HoldSettings:
    """How holds are compared.

    Attributes:
        passes: of each fit in an identification; the differences show before it has converged.
        continuations: how often as many passes follow where the index still falls.
        least_fall: smallest relative fall of the index or of the error by which another hold than
            that of the rule (a staircase was held) is preferred.
        refuted: ratio of its index to the smallest, from which on a hold is out of the question,
            whatever else the model lacks.
        same: relative difference of the indices of linear and smooth, below which one stands for
            both: inputs that are sampled finely.
    """

    passes: int = 4
    continuations: int = 3
    least_fall: float = 0.02
    refuted: float = 3.0
    same: float = 5e-3


SETTINGS = HoldSettings()


def undeclared_hold(records: Sequence[Record]) -> str | None:
    """The hold that the samples suggest; None where all records declare theirs, or have no inputs.

    One logger is taken to have made all records.
    """
    undeclared = [record.hold for record in records if not record.hold_declared]
    return undeclared[0] if undeclared and records[0].inputs.shape[1] else None


def with_hold(records: Sequence[Record], hold: str) -> tuple[Record, ...]:
    """The records with this hold, but for those that declare theirs."""
    return tuple(record if record.hold_declared else record.with_hold(hold) for record in records)


def best_hold(values: Mapping[str, float], rule: str) -> str:
    """The hold with the smallest value; that of the rule where it is hardly larger."""
    best = min(values, key=lambda hold: values[hold])
    return best if values[best] < (1.0 - SETTINGS.least_fall) * values[rule] else rule


def evidence(quantity: str, values: Mapping[str, float], best: str) -> tuple[str, ...]:
    """``"hold zero: the index is 39 times as large with linear, 40 times as large with smooth"``.

    Args:
        quantity: what was compared, as "the index".
        values: by hold.
        best: the hold that was chosen.

    Returns:
        One sentence; none where its value is 0 or not finite, so that there is no ratio.
    """
    if not 0.0 < values[best] < float("inf"):
        return ()
    others = [hold for hold in HOLDS if hold in values and hold != best]
    ratios = (f"{values[hold] / values[best]:.3g} times as large with {hold}" for hold in others)
    return (f"hold {best}: {quantity} is {', '.join(ratios)}",)
