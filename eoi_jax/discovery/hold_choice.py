"""The hold and the skew of the inputs under which the final model of a discovery fits best.

What the declared model lacks may hide them, and a wrong hold or a skew looks like a delay or a lag
of the input. So they are decided with the effects in the model, not before.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool

from eoi_jax.data.holds import SETTINGS, HoldChoice, undeclared_hold, with_hold
from eoi_jax.data.input_holds import Hold, held_inputs, hold_of_each, hold_text, shared
from eoi_jax.data.record import Record
from eoi_jax.discovery.judge import mean_error
from eoi_jax.discovery.remarks import HoldNote
from eoi_jax.discovery.result import Discovery, PartialExplanation
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.hold import HoldIndices, Skew, best_skew, numerical_power
from eoi_jax.estimation.identify import Identification, estimate, trial_fit
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.augmented import Placed
from eoi_jax.models.plant import Plant

Records = tuple[Record, ...]


_RULES = RULES.holds
_EXPLAINS = ("complete", "partial", "nothing_missing")  # codes of an answer


@dataclass(frozen=True)
class Searched:
    """What a search in the injection came to.

    Attributes:
        discovery: its answer.
        partial: models with the sets that the residual justifies, each with its effects, the last
            one first, where none explains enough of it; with the values of the search.
        lead: the first of these, fitted again, that improves on the free runs of a discovery before
            any effect; None without one.
    """

    discovery: Discovery
    partial: tuple[tuple[Plant, tuple[Placed, ...]], ...] = ()
    lead: Callable[[Discovery], PartialExplanation | None] = lambda _: None

    @property
    def with_lead(self) -> Discovery:
        """The answer, with the set that comes nearest where there is none."""
        lead = self.discovery.lead
        if lead is None and self.discovery.status.code == "unexplained":
            lead = self.lead(self.discovery)
        return replace(self.discovery, lead=lead)


@dataclass(frozen=True)
class _Trial:
    """A search under a hold and a skew.

    Attributes:
        hold: zero, linear or smooth, of all inputs or of each.
        search: what it came to.
        records: to fit, with that hold and skew.
        indices: of the declared model.
        skew: of the inputs; None: they are where they were logged.
    """

    hold: Hold
    search: Searched
    records: Records
    indices: HoldIndices
    skew: Skew | None = None

    @property
    def answer(self) -> Discovery:
        return self.search.discovery

    @property
    def changed_from_rule(self) -> int:
        """How many inputs have another hold than their samples suggest."""
        count = len(self.indices.choice.names)
        words = (hold_of_each(hold, count) for hold in (self.hold, self.indices.rule))
        return sum(word != suggested for word, suggested in zip(*words, strict=True))

    @cached_property
    def fit(self) -> Identification:
        """Of the final model, by as many passes with every hold.

        An affine model is fitted by one, whose index another one lowers: observers follow a model
        that is known.
        """
        return _refitted(self.answer, self.records, self.indices)


def with_best_hold(
    search: Callable[[Records, Records], Searched],
    records: Records,
    held_out: Records,
    indices: HoldIndices,
) -> Searched:
    """The answer with the hold under which the final model fits best, and a note on the evidence.

    The search runs with the hold that the declared model fits best. It runs with another one that
    the declared model does not refute if the final model fits as well with it, or with any other
    one if it has an effect that may stand for it. It runs on shifted inputs if the final model fits
    clearly better with them, or has an effect that may stand for the shift (`_takes_place`). The
    smallest index decides; of nearly equal ones the answer that explains, with fewest effects.

    Args:
        search: the discovery on records to fit and records that judge, on the filter of `indices`.
        records: to fit.
        held_out: that judge.
        indices: of the declared model.
    """

    def searched(hold: Hold, skew: Skew | None = None) -> _Trial:
        delays = None if skew is None else skew.delays
        fitted = with_hold(records, hold, delays)
        return _Trial(
            hold, search(fitted, with_hold(held_out, hold, delays)), fitted, indices, skew
        )

    first, *alternatives = indices.possible
    best = searched(first)
    if not best.answer.found.status.ok:  # with any hold
        return best.search
    if _stand_ins(best.answer):  # what the declared model refutes it may refute for what it lacks
        tried = indices.choice.values
        alternatives = sorted((hold for hold in tried if hold != first), key=tried.__getitem__)
    fits = {first: best.fit if alternatives else best.answer.found}
    for hold in alternatives:
        fits[hold] = _refitted(best.answer, with_hold(records, hold), indices)
    trials = [best]
    for hold in _worth_a_search(best, fits):
        trials.append(searched(hold))
        fits[hold] = trials[-1].fit
    best = _best(trials)
    notes = indices.evidence
    if alternatives:
        powers = dict(zip(fits, _powers(list(fits.values())), strict=True))
        choice = HoldChoice(best.hold, powers, indices.choice.names)
        notes = choice.evidence("the index of the final model")
        if best.hold == indices.best:  # what the declared model alone refutes
            refuted = [j for j in range(len(choice.names)) if not choice.alternatives(j)]
            notes += indices.choice.evidence("the index of the declared model", refuted)
    for skew in _possible_skews(best, records, indices):
        shifted = searched(skew.hold, skew)
        if _takes_place(shifted, best):
            corrected = _corrected_lead(shifted, skew, records)
            if corrected is not None:
                trial = searched(corrected.hold, corrected)
                if _takes_place(trial, shifted):
                    shifted, skew = trial, corrected
            hold = hold_text(skew.hold, records[0].input_names)
            notes = notes if skew.hold == best.hold else (f"hold {hold}",)
            best, notes = shifted, (*notes, skew.evidence(records[0]))
            break
    answer = replace(best.answer, notes=(*map(HoldNote, notes), *best.answer.notes))
    return replace(best.search, discovery=answer)


def with_held_inputs(
    discovery: Discovery,
    answered: Callable[[Records, Records], Discovery],
    records: Records,
    held_out: Records,
) -> Discovery:
    """The answer, or that with held inputs where it has a delay of half a sample.

    Held inputs act half a sample later than what goes on between samples. The injection may explain
    the latter with such a delay and further effects, and leave the former to the search in free
    runs, which then is not asked. Of both answers that with smaller errors on held-out records
    counts; where they are alike that with fewer effects.

    Args:
        discovery: the answer.
        answered: gives that on records to fit and records that judge.
        records: to fit, as given.
        held_out: that judge, as given.
    """
    if undeclared_hold(records) is None or discovery.in_sample:
        return discovery
    names, period = records[0].input_names, records[0].sample_period
    delays, words = _stand_ins(discovery), hold_of_each(discovery.held_out[0].hold, len(names))
    samples = [delays.get(name, 0.0) / period for name in discovery.declared.nominal.inputs]
    half_samples = [abs(delay - 0.5) < _RULES.half for delay in samples]
    zeros = ["zero" if late else word for late, word in zip(half_samples, words, strict=True)]
    if zeros == list(words):
        return discovery
    parts = (with_hold(part, shared(zeros)) for part in (records, held_out))
    rival = answered(*parts)
    growth = _growth(discovery, rival)
    if rival.status.code not in _EXPLAINS or growth is None:
        return discovery
    fewer = len(rival.added) < len(discovery.added)
    # An effect that lowers them by less would be left out elsewhere.
    if growth >= (RULES.judge.min_fall if fewer else -RULES.judge.min_fall):
        return discovery
    better = "errors as small, with fewer effects, as" if fewer else "smaller errors than"
    holds = (hold_text(shared(part), names) for part in (zeros, words))
    text = HoldNote(_HELD.format(better, *holds))
    return replace(rival, notes=(text, *rival.notes))


def _worth_a_search(best: _Trial, fits: dict[Hold, Identification]) -> list[Hold]:
    """Holds with which the search may give another answer, in the order of the fits.

    Args:
        best: the search with the first of the holds.
        fits: of its final model with each hold.
    """
    names = best.answer.declared.nominal.inputs
    first, *alternatives = fits
    powers = {}
    for hold in alternatives:  # in pairs: of all at once few samples may be scored by each
        power, smallest = _powers([fits[hold], best.fit])
        powers[hold] = power / smallest
    words = hold_of_each(first, len(names))
    doubted = _stand_ins(best.answer)
    worth = []
    for hold in alternatives:
        changed = [name for name, old, new in
                   zip(names, words, hold_of_each(hold, len(names)), strict=True)
                   if old != new]  # fmt: skip
        single_input = len(names) > 1 and not isinstance(hold, str)
        margin = 1.0 - _RULES.better if single_input else 1.0 + _RULES.same
        if set(changed) & set(doubted) or powers[hold] <= margin:
            worth.append(hold)
    closest = sorted(worth, key=lambda hold: powers[hold])[: _RULES.searches]
    return [hold for hold in worth if hold in closest]


def _stand_ins(answer: Discovery) -> dict[str, float]:
    """Times of delays and lags that a hold or a skew may explain, by the plant's input [s].

    Of a response to the rate of an input the lag less the lead.
    """
    times = {
        added.output: tuple(added.parameters.values())
        for added in answer.added
        if added.effect.name in _RULES.stand_ins
    }
    return {name: lag - sum(leads) for name, (*leads, lag) in times.items()}


def _best(trials: Sequence[_Trial]) -> _Trial:
    """The one with the smallest index; of nearly equal ones the simplest answer that explains.

    Of such answers the one whose hold the samples suggest. Effects may make up for a hold that is
    wrong, and lower the index further: where free runs with fewer of them are as good, these stay.
    """
    if len(trials) == 1:
        return trials[0]
    powers = _powers([trial.fit for trial in trials])

    def order(place: int) -> tuple:
        answer = trials[place].answer
        return (
            not powers[place] <= (1.0 + _RULES.same) * min(powers),
            answer.status.code == "unexplained",
            len(answer.added),
            trials[place].changed_from_rule,
            place,
        )

    best = trials[min(range(len(trials)), key=order)]
    plainer = [trial for trial in trials if _is_plainer(trial.answer, best.answer)]
    return min(plainer, key=lambda trial: len(trial.answer.added), default=best)


def _takes_place(shifted: _Trial, best: _Trial) -> bool:
    """Whether inputs are shifted: the final model fits clearly better, or needs fewer effects.

    Passes take the mean of an input over a step: behind a dead zone or a limit, where jumps of the
    input are spread, the index may be smaller, or larger, with inputs at another time. So they stay
    where they are if free runs miss by half as much again, and are shifted for fewer effects if
    free runs are as good.
    """
    old, new = best.answer, shifted.answer
    fewer = len(new.added) < len(old.added)
    new_power, old_power = _powers([shifted.fit, best.fit])
    fits = fewer or new_power < (1.0 - _RULES.same) * old_power
    fits = bool(fits and _best([best, shifted]) is shifted)
    growth = _growth(old, new)
    if growth is None:
        return fits
    if _is_plainer(new, old):
        return True
    return bool(fits and growth <= -np.log(RULES.answer.confirmed))


def _is_plainer(new: Discovery, old: Discovery) -> bool:
    """Whether an answer explains with fewer effects, and its free runs are as good."""
    growth = _growth(old, new)
    if growth is None or new.status.code not in _EXPLAINS:
        return False
    return len(new.added) < len(old.added) and growth < RULES.judge.min_fall


def _growth(old: Discovery, new: Discovery) -> float | None:
    """By how much the mean log error of free runs grows; None where an answer has none."""
    if old.after is None or new.after is None:
        return None
    after = mean_error((new.after, new.windows_after))
    return after - mean_error((old.after, old.windows_after))


def _possible_skews(best: _Trial, records: Records, indices: HoldIndices) -> list[Skew]:
    """Holds and delays of the inputs that may explain the final model's delay or lag, or error."""
    periods = _stand_ins(best.answer)
    period = records[0].sample_period
    if not periods:
        skew = best_skew(best.answer.plant, records, best.hold, trial_fit, indices.lowpass)
        return [] if skew is None else [skew]
    if max(periods.values()) > _RULES.longest * period:
        return []
    names = best.answer.declared.nominal.inputs
    delays = np.asarray([periods.get(name, 0.0) for name in names])
    makings = [(best.hold, delays)]
    is_held = np.asarray(held_inputs(best.hold, len(names)))
    late = (delays > 0) & ~is_held
    if np.any(late):  # what was held acts half a sample later than what goes on
        words = hold_of_each(best.hold, len(names))
        held = shared(["zero" if j else word for j, word in zip(late, words, strict=True)])
        makings.append((held, delays - 0.5 * period * late))
    return [
        Skew(hold, trial)
        for hold, trial in makings
        if _RULES.shortest * period < np.max(np.abs(trial)) <= period
    ]


def _corrected_lead(shifted: _Trial, skew: Skew, records: Records) -> Skew | None:
    """The skew of an input that was logged late, of the model with the effects found with it.

    What the model lacked before has moved it. None where it stays.
    """
    period = records[0].sample_period
    if not shifted.answer.added or np.min(skew.delays) >= -SETTINGS.earliest * period:
        return None
    lowpass, plant = shifted.indices.lowpass, shifted.answer.plant
    corrected = best_skew(plant, records, skew.hold, trial_fit, lowpass)
    if corrected is None:
        return None
    moved = np.max(np.abs(corrected.delays - skew.delays)) >= SETTINGS.least_skew * period
    return corrected if moved else None


def _refitted(answer: Discovery, records: Records, indices: HoldIndices) -> Identification:
    """The final model, fitted again with another hold on the same filter."""
    prepared = prepare_records(answer.plant, records, indices.lowpass)
    return estimate(answer.plant, prepared, passes=SETTINGS.passes)


def _powers(fits: Sequence[Identification]) -> list[float]:
    """Power of the injection of each fit, on samples that all of them score.

    Geometric mean over the outputs, not below `numerical_power`; infinite without an estimate.
    Indices count each fit's own samples: behind a gap those of a plant with a lag begin later.
    """
    good = [fit for fit in fits if fit.status.ok]
    if not good:
        return [float("inf")] * len(fits)
    common = np.all([np.isfinite(np.concatenate(fit.injection)) for fit in good], axis=0)
    values = iter([_power(fit, common) for fit in good])
    return [next(values) if fit.status.ok else float("inf") for fit in fits]


def _power(fit: Identification, common: Bool[np.ndarray, "samples ny"]) -> float:
    injection = np.concatenate(fit.injection)
    least = numerical_power(fit)
    means = [max(np.mean(injection[use, j] ** 2), least[j])
             for j, use in enumerate(common.T) if np.any(use)]  # fmt: skip
    return float(np.exp(np.mean(np.log(np.maximum(means, 1e-300))))) if means else float("inf")


_HELD = "hold {1}: free runs on the held-out records have {0} with {2} and half a sample of delay"
