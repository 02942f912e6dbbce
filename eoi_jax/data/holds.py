"""Holds of inputs that no record declares: the rule, the alternatives, and how one is chosen.

What drives the plant between two samples is not in the samples: a converter held the last value, or
the input went on. Against the samples the two differ by a delay of half a sample, which a model
takes for physics. So what fits decides: the index in an identification, the free run's error in a
refinement or a validation. Channels that a logger reads one after another are apart by a part of a
sample period as well (their skew), and what fits decides that too.

Inputs of one record may be made in different ways. From the best hold that all of them share, or
that their samples suggest, the hold of one input after another is changed as long as that fits
clearly better: 2 nu fits a round in place of 3^nu.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.input_holds import (
    HOLDS,
    Hold,
    held_inputs,
    hold_of_each,
    hold_text,
    shared,
)
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
        earliest: by which an input may act earlier than it was logged, as one may that is held for
            a sample and read behind the outputs [samples]. Beyond, it was logged late.
        least_lead: ratio of the index, or of the power of the errors, with a shift up to `earliest`
            to that with an input that was logged later than that, from which on it counts: what
            a model lacks may be smaller with inputs to come. Set with a robot's joints in view
            whose dry friction and spring were not declared.
        share: of a lead, over which a response to the rate of the input in its place is smoothed to
            begin with; the lead over the times of a store in its place.
        longest_lead: of an input that was logged late [samples].
        shortest_record: of those that are asked for such a lead [leads].
        instants: of a record, at which the gain of an input is compared with the declared one.
        evidence: twice the gain in log-likelihood from which on a skew is found, or the hold that
            goes with it is another one, or an input has another hold than the others: 3.5
            standard deviations.
        numerical: share of the highest derivative, as of the default sub-steps at the cut-off,
            below which an injection is an error of the discretisation.
    """

    passes: int = 4
    continuations: int = 3
    least_fall: float = 0.02
    refuted: float = 3.0
    same: float = 5e-3
    trial_skews: tuple[float, ...] = (0.5, 0.1)
    least_skew: float = 0.05
    earliest: float = 1.5
    least_lead: float = 3.0
    share: float = 0.3
    longest_lead: float = 64.0
    shortest_record: float = 10.0
    instants: int = 200
    evidence: float = 12.0
    numerical: float = 2.4e-5


SETTINGS = HoldSettings()


def undeclared_hold(records: Sequence[Record]) -> Hold | None:
    """The hold that the samples suggest; None where all records declare theirs, or no input moves.

    One logger is taken to have made all records: each input is judged in the first one in which it
    moves.
    """
    undeclared = [record for record in records if not record.hold_declared]
    if not moving_inputs(records):
        return None
    if isinstance(undeclared[0].hold, str) and len({record.hold for record in undeclared}) == 1:
        return undeclared[0].hold
    words = []
    for j in range(records[0].inputs.shape[1]):
        moving = (record for record in undeclared if moves(record, j))
        words.append(next(moving, undeclared[0]).holds[j])
    return shared(words)


def moving_inputs(records: Sequence[Record]) -> tuple[int, ...]:
    """Inputs that change in some record with an undeclared hold: only their hold matters."""
    undeclared = [record for record in records if not record.hold_declared]
    return tuple(
        j
        for j in range(records[0].inputs.shape[1])
        if any(moves(record, j) for record in undeclared)
    )


def moves(record: Record, j: int) -> bool:
    """Whether an input changes in a record.

    Args:
        record: with the input.
        j: its index.
    """
    samples = record.inputs[record.input_valid, j]
    return bool(np.any(samples != samples[0])) if samples.size else False


def with_hold(
    records: Sequence[Record], hold: Hold, delays: Float[np.ndarray, " nu"] | None = None
) -> tuple[Record, ...]:
    """The records with this hold, but for those that declare theirs.

    Args:
        records: as they were read.
        hold: zero, linear or smooth, of all inputs or of each.
        delays: by which the inputs act later than they were logged [s].
    """
    changed = []
    for record in records:
        if not record.hold_declared:
            record = record.with_hold(hold)
            record = record if delays is None else record.with_delayed_inputs(delays)
        changed.append(record)
    return tuple(changed)


def made_alike(
    records: Sequence[Record], read: Sequence[Record], used: Sequence[Record]
) -> tuple[Record, ...]:
    """Records with the hold and the skew that a fit has found for others of the same logger.

    Args:
        records: of which those are changed that do not declare their hold.
        read: the records of the fit, as they were read.
        used: the same ones, as the fit used them, without those that it left out.
    """
    if not used:  # a fit without an answer
        return tuple(records)
    declared = {record.name for record in read if record.hold_declared}
    undeclared = [record for record in used if record.name not in declared]
    example = (*undeclared, used[0])[0]
    return with_hold(records, example.logged_hold, example.skew)


def least_of_parabola(values: Sequence[float]) -> float | None:
    """Place of the minimum of the parabola through three values at -1, 0 and 1; None without one.

    Args:
        values: of which none needs to be finite.
    """
    before, middle, after = values
    bend = before + after - 2.0 * middle
    return 0.5 * (before - after) / bend if np.isfinite(bend) and bend > 0.0 else None


def best_hold(values: Mapping[Hold, float], rule: Hold) -> Hold:
    """The hold with the smallest value; that of the rule where it is hardly larger."""
    best = min(values, key=lambda hold: values[hold])
    return best if values[best] < (1.0 - SETTINGS.least_fall) * values[rule] else rule


def clearly_smaller(power: float, reference: float, count: float | int) -> bool:
    """Whether a power is smaller by more than chance, and by enough to matter.

    Args:
        power: mean square of what a model leaves.
        reference: the same of another model.
        count: independent values in the mean. Their number times the logarithm of the ratio is
            twice the gain in log-likelihood.
    """
    if not power < (1.0 - SETTINGS.least_fall) * reference:
        return False
    with np.errstate(divide="ignore"):
        return bool(count * np.log(reference / power) >= SETTINGS.evidence)


def evidence(quantity: str, values: Mapping[Hold, float], best: Hold) -> tuple[str, ...]:
    """``"hold zero: the index is 39 times as large with linear, 40 times as large with smooth"``.

    Args:
        quantity: what was compared, as "the index".
        values: by hold, of all inputs.
        best: the hold that was chosen.

    Returns:
        One sentence; none where its value is 0 or not finite, so that there is no ratio.
    """
    if not 0.0 < values[best] < float("inf"):
        return ()
    ratios = {
        hold: values[hold] / values[best] for hold in HOLDS if hold in values and hold != best
    }
    return (f"hold {best}: {quantity} is {_ratios_text(ratios)}",)


def _ratios_text(ratios: Mapping[str, float]) -> str:
    """Values with other holds over that with the best one, by hold."""
    if all(abs(np.log(ratio)) < SETTINGS.least_fall for ratio in ratios.values()):
        return f"the same within {100 * SETTINGS.least_fall:g} % with the others"
    return ", ".join(f"{ratio:.3g} times as large with {hold}" for hold, ratio in ratios.items())


@dataclass(frozen=True)
class HoldChoice:
    """The hold of each input that fits best, and how well those fit that were compared.

    Attributes:
        best: the hold.
        values: of what was compared, by hold: the smaller, the better.
        names: of the inputs.
    """

    best: Hold
    values: dict[Hold, float]
    names: tuple[str, ...]

    def alternatives(self, j: int) -> dict[str, float]:
        """Values with another word for one input, by that word, as far as they were compared."""
        count = len(self.names)
        chosen = hold_of_each(self.best, count)[j]
        holds = {word: with_word(self.best, j, word, count) for word in HOLDS if word != chosen}
        return {word: self.values[hold] for word, hold in holds.items() if hold in self.values}

    def evidence(self, quantity: str, inputs: Sequence[int] | None = None) -> tuple[str, ...]:
        """A sentence for each input that was compared, or one for all of them.

        Args:
            quantity: what was compared, as "the index".
            inputs: of which the sentences are; None: of all.
        """
        smallest, words = self.values[self.best], hold_of_each(self.best, len(self.names))
        if not 0.0 < smallest < float("inf"):
            return ()
        sentences = []
        for j in range(len(self.names)) if inputs is None else inputs:
            word, alternatives = words[j], self.alternatives(j)
            ratios = {hold: value / smallest for hold, value in alternatives.items()}
            if not ratios:
                continue
            text = _ratios_text(ratios)
            sentences.append(f"hold {word} for {self.names[j]}: {quantity} is {text}")
        if inputs is not None or (len(self.names) > 1 and sentences):
            return tuple(sentences)
        if isinstance(self.best, str):
            return evidence(quantity, self.values, self.best)
        return (f"hold {hold_text(self.best, self.names)}",)


def with_word(hold: Hold, j: int, word: str, count: int) -> Hold:
    """A hold of `count` inputs with another word for input j."""
    words = list(hold_of_each(hold, count))
    words[j] = word
    return shared(words)


def chosen_hold(
    value_of: Callable[[Hold], float],
    rule: Hold,
    records: Sequence[Record],
    better: Callable[[float, float], bool],
) -> HoldChoice:
    """The hold that fits best: of all inputs, then of one after another.

    What looks like a staircase stays held unless that fits clearly worse. In each round every input
    is tried with every other hold; the changes that fit better follow each other in the order of
    what they gain, so that the order of the inputs does not matter.

    Args:
        value_of: of a hold: the smaller, the better; infinite where there is no estimate.
        rule: the hold that the samples suggest.
        records: to fit.
        better: whether the first value is smaller than the second by enough to change an input's
            hold.
    """
    names = records[0].input_names
    values: dict[Hold, float] = {}

    def value(hold: Hold) -> float:
        if hold not in values:
            values[hold] = value_of(hold)
        return values[hold]

    for hold in (rule, *HOLDS):
        value(hold)
    best = best_hold(values, rule)
    inputs = moving_inputs(records)
    for j in inputs if len(inputs) > 1 else ():
        hold = with_word(best, j, hold_of_each(rule, len(names))[j], len(names))
        if held_inputs(hold, len(names))[j] and not better(values[best], value(hold)):
            best = hold
    while len(inputs) > 1:
        start, changed = best, set()
        changes = [(j, word) for j in inputs for word in HOLDS]
        trials = {(j, word): value(with_word(start, j, word, len(names))) for j, word in changes}
        for j, word in sorted(changes, key=lambda change: trials[change]):
            if j in changed or not better(trials[j, word], values[start]):
                continue
            hold = with_word(best, j, word, len(names))
            if better(value(hold), values[best]):
                best = hold
                changed.add(j)
        if best == start:
            break
    return HoldChoice(best, values, names)


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
