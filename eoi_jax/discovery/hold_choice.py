"""The hold of the inputs under which the final model of a discovery fits best.

What the declared model lacks may hide the hold, and a wrong hold looks like a delay or a lag of the
input. So the hold is decided with the effects in the model, not before.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from eoi_jax.data.holds import evidence, with_hold
from eoi_jax.data.record import Record
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.hold import HoldIndices
from eoi_jax.estimation.identify import declared_index, mean_index
from eoi_jax.estimation.preparation import prepare_records

Records = tuple[Record, ...]


@dataclass(frozen=True)
class HoldRules:
    """How final models under different holds are compared.

    Attributes:
        same: relative difference of their indices that counts as none.
        passes: of the fit of a final model with another hold.
        stand_ins: effects that a wrong hold takes the shape of.
    """

    same: float = 0.02
    passes: int = 4
    stand_ins: tuple[str, ...] = ("input_delay", "actuator_lag")


_RULES = HoldRules()


def with_best_hold(
    search: Callable[[Records, Records], Discovery],
    records: Records,
    held_out: Records,
    indices: HoldIndices,
) -> Discovery:
    """The answer with the hold under which the final model fits best, and a note on the evidence.

    The search runs with the hold that the declared model fits best. It runs with another one that
    the declared model does not refute if the final model fits as well with it, or has an effect
    that may stand for it. The smallest index decides; of nearly equal ones the answer that
    explains, with fewest effects.

    Args:
        search: the discovery on records to fit and records that judge, on the filter of `indices`.
        records: to fit.
        held_out: that judge.
        indices: of the declared model.
    """
    first, *others = indices.possible
    answer = search(with_hold(records, first), with_hold(held_out, first))
    if not answer.found.status.ok:  # with any hold
        return answer
    answers, index = {first: answer}, {first: mean_index(answer.found)}
    in_doubt = bool(set(answer.effects) & set(_RULES.stand_ins))
    for hold in others:
        index[hold] = _refitted_index(answer, with_hold(records, hold), indices)
        if in_doubt or index[hold] <= (1.0 + _RULES.same) * index[first]:
            answers[hold] = search(with_hold(records, hold), with_hold(held_out, hold))
            index[hold] = mean_index(answers[hold].found)
    smallest = min(index[hold] for hold in answers)

    def order(hold: str) -> tuple:
        return (
            not index[hold] <= (1.0 + _RULES.same) * smallest,
            answers[hold].status.code == "unexplained",
            len(answers[hold].added),
            hold != indices.best,
        )

    chosen = min(answers, key=order)
    note = indices.evidence
    if others:
        note = evidence("the index of the final model", index, chosen)
    return replace(answers[chosen], notes=(*note, *answers[chosen].notes))


def _refitted_index(answer: Discovery, records: Records, indices: HoldIndices) -> float:
    """The index of the final model, fitted again with another hold on the same filter."""
    prepared = prepare_records(answer.plant, records, indices.lowpass)
    return declared_index(answer.plant, prepared, _RULES.passes)
