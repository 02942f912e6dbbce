"""Holds of inputs that no record declares: the rule, the alternatives, and how one is chosen.

What drives the plant between two samples is not in the samples: a converter held the last value, or
the input went on. Against the samples the two differ by a delay of half a sample, which a model
takes for physics. So what fits decides: the index in an identification, the free run's error in a
refinement or a validation. Channels that a logger reads one after another are apart by a part of a
sample period as well (their skew), and what fits decides that too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.input_holds import HOLDS
from eoi_jax.data.record import Record


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
        trial_skews: delays of an input, and their negatives, at which the index is computed to find
            the skew of the channels, the second around what the first found [samples].
        least_skew: smaller ones are not told from none [samples].
        evidence: twice the gain in log-likelihood from which on a skew is found, or the hold that
            goes with it is another one: 3.5 standard deviations.
    """

    passes: int = 4
    continuations: int = 3
    least_fall: float = 0.02
    refuted: float = 3.0
    same: float = 5e-3
    trial_skews: tuple[float, ...] = (0.5, 0.1)
    least_skew: float = 0.05
    evidence: float = 12.0


SETTINGS = HoldSettings()


def undeclared_hold(records: Sequence[Record]) -> str | None:
    """The hold that the samples suggest; None where all records declare theirs, or have no inputs.

    One logger is taken to have made all records.
    """
    undeclared = [record.hold for record in records if not record.hold_declared]
    return undeclared[0] if undeclared and records[0].inputs.shape[1] else None


def with_hold(
    records: Sequence[Record], hold: str, delays: Float[np.ndarray, " nu"] | None = None
) -> tuple[Record, ...]:
    """The records with this hold, but for those that declare theirs.

    Args:
        records: as they were read.
        hold: zero, linear or smooth.
        delays: by which the inputs act later than they were logged [s].
    """
    changed = []
    for record in records:
        if not record.hold_declared:
            record = record.with_hold(hold)
            record = record if delays is None else record.with_delayed_inputs(delays)
        changed.append(record)
    return tuple(changed)


def least_of_parabola(values: Sequence[float]) -> float | None:
    """Place of the minimum of the parabola through three values at -1, 0 and 1; None without one.

    Args:
        values: of which none needs to be finite.
    """
    before, middle, after = values
    bend = before + after - 2.0 * middle
    return 0.5 * (before - after) / bend if np.isfinite(bend) and bend > 0.0 else None


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


def skew_text(record: Record, delays: Float[np.ndarray, " nu"]) -> str:
    """``"u leads the outputs by 0.0005 s in the log (0.5 sample periods)"``.

    Args:
        record: any of the records.
        delays: by which its inputs act later than they were logged [s].
    """
    parts = []
    for name, delay in zip(record.input_names, delays, strict=True):
        verb = "leads" if delay > 0 else "lags behind"
        share = abs(delay) / record.sample_period
        text = f"{name} {verb} the outputs by {abs(delay):.2g} s in the log ({share:.2g} sample "
        parts += [text + "periods)"] if delay else []
    return ", ".join(parts)
