r"""Find effects by what they do to free runs, where the injection alone gives no answer.

The injection weighs a missing effect by its force, the free run by its consequences; a base whose
parameters are biased hides right effects from both. The search:

1. The base: the declared model refined by output error, over whole records and over short runs,
   from the estimate of the passes and from nominal values, with each hold of the inputs that is
   possible; of these the one with the smallest free-run errors on the records that judge.
2. Candidates: the effects, and pairs, of which a score test of the base says most (`remaining`),
   and the set that the injection came to; an offset, a loss with an offset, both with a spring, and
   cells in series, in any case; laws that are like a term of the declared model, in its place
   (`free_run_candidates.py`, `replacements.py`).
3. Each of the first few is added, and all parameters are refined again; of an effect with several
   forms also the further ones, as long as they fit better, and of one of which the score test has
   several maxima (the wave number of a ripple) from each. Of a pair one may be enough; an effect
   whose parameter runs off becomes the law in which it ends.
4. The judge: the free-run errors on records that no fit has seen, whole and in windows. The best
   candidate stays where their mean logarithm falls enough, and the paired difference over blocks of
   these records exceeds its own standard error by enough; one that takes the place of an effect of
   the round before, where it does so over the model before that. Then from 2, until none does, and
   once more from what is left without the effects that the model can be without.
5. What can be left out again without a larger error is left out; of the ways in which the records
   may have been made that with the smallest errors of the answer is taken, and of its fits over
   long and over short runs that which is better on all records, whole and in windows, or in the
   mean and in neither worse by more than chance.

Disturbances in time are not tried: they stand in for what the library lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from eoi_jax.data.holds import SETTINGS
from eoi_jax.data.record import Record
from eoi_jax.discovery.additions import has_size, size_is_known
from eoi_jax.discovery.free_run_candidates import Model, candidates, has_dependence
from eoi_jax.discovery.judge import (
    Judge,
    Judged,
    errors_of_each,
    mean_error,
)
from eoi_jax.discovery.probability import Contest
from eoi_jax.discovery.refit import not_simulated
from eoi_jax.discovery.replacements import replaced_terms, replacements, turned_terms
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import (
    Drift,
    SinusoidalDisturbance,
)
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.error_growth import is_lost, returns
from eoi_jax.simulation.sensor_noise import is_exact
from eoi_jax.simulation.step_size import choose_steps

_RULES = RULES.free_runs

RecordPair = tuple[tuple[Record, ...], tuple[Record, ...]]  # to fit, and to judge


@dataclass(frozen=True)
class FreeRunAnswer:
    """What the search came to.

    Attributes:
        base: the declared model, refined.
        fits: of the model with the effects that stayed, over long and over short runs, what
            predicts best first; the base where no effect did.
        records: of the fit, in the variant that predicts best.
        judge: on the others.
        share: of the samples, in which effects were searched.
        rounds: of the search.
        better_base: whether it predicts otherwise than before it was refined, and not worse by more
            than chance on all records: it is what fits those of the fit best.
    """

    base: Judged
    fits: tuple[Judged, ...]
    records: tuple[Record, ...]
    judge: Judge
    better_base: bool
    share: float
    rounds: tuple[Contest, ...] = ()

    @property
    def judging(self) -> tuple[Record, ...]:
        """Records that no fit has seen."""
        return self.judge.records

    @property
    def best(self) -> Judged:
        """The model with the effects that stayed, which is judged; the base where none did."""
        return self.fits[0]

    @cached_property
    def final(self) -> Judged:
        """Of the fits of that model the judged one, unless another is better on all records.

        Between fits of the same parameters the records of the fit tell as much as the few that
        judge: it must predict them better together, whole and in windows, or in the mean, and in
        neither worse by more than chance. None is taken that predicts these worse than the base.
        """
        judge = replace(self.judge, records=(*self.records, *self.judging))
        final, runs = self.best, None
        for fit in self.fits[1:]:
            if fit.error < self.base.error:
                runs = runs or judge.runs(final.refinement.plant)
                trial = judge.runs(fit.refinement.plant)
                pairs = zip(errors_of_each(trial), errors_of_each(runs), strict=True)
                if all(new < old for new, old in pairs) or judge.averages_better(trial, runs):
                    final, runs = fit, trial
        return final


def search_free_runs(
    starts: Sequence[Plant],
    variants: Sequence[RecordPair],
    effects: Sequence[AbstractEffect],
    further: Sequence[Model] = (),
    rival: Plant | None = None,
    level: float = 0.01,
    present: tuple[Placed, ...] = (),
) -> FreeRunAnswer | None:
    """Search from the declared model, or from one that explains the injection.

    Args:
        starts: the model at the values to refine it from, nominal ones last.
        variants: records to fit, and records that the fit does not see, once for each way in which
            they may have been made (the hold of their inputs); as they were taken so far first.
        effects: to try.
        further: models that have effects already; they are tried in the first round.
        rival: an answer with a disturbance in time. That describes the records in which it was seen
            and predicts others only by chance: it must be better by more than that.
        level: of significance of the score test, for all tries together.
        present: effects in the model that explain the injection, and stay.

    Returns:
        None where the model has no fit, the records are too short to judge, or the rival stays.
    """
    tried = [effect for effect in effects if not isinstance(effect, Drift | SinusoidalDisturbance)]
    judge = Judge.of(variants[0][1], starts[0])
    if judge is None:
        return None
    searches = _begun(starts, variants, judge, present)
    if searches and all(search.is_lost for search in searches):
        searches = _begun(starts, variants, judge.without_whole_runs(), present)
    if not searches:
        return None
    search = _most_likely(searches)
    best, rounds = search.base, []
    for number in range(1 if present else _RULES.most):
        if all(is_exact(run) for run in best.runs if run):
            break
        # What short runs do not show or fit a whole one may, and the other way about.
        models = [
            (plant, placed, origin)
            for origin in (search.bases if number == 0 and not present else (best,))
            for plant, placed in candidates(origin, tried, level, explained=bool(present))
        ]
        if number == 0 and not present:
            models += [(*candidate, best) for candidate in further if not _in_time(candidate[1])]
            models += [
                (plant.with_parameters(starts[-1].parameters), placed, best)
                for plant, placed, origin in models
                if origin is best
            ]
        if number == 0:
            models += [(*model, best) for model in replacements(best, tried)]
        trials = [trial for model in models if (trial := search.fitted(*model)) is not None]
        trials += search.further_forms(trials)
        accepted = [trial for trial in trials if search.accepts(trial, best, rounds)]
        if not accepted:
            # What stood in for an effect that is found beside it may have hidden another one.
            lean = search.leanest(best)
            if lean is best:
                break
            best = lean
            continue
        chosen = search.judge.plainest_of_all(trials, search.answers(accepted) or accepted)
        rounds.append(Contest(best, chosen, tuple(trials)))
        best = chosen
    search, best = _made_best(searches, search, search.leanest(best))
    while not (fits := search.settled(best)):
        best = rounds.pop().origin
    if rival is not None and search.judge.prefers(search.judge.runs(rival), fits[0].runs):
        return None
    return replace(search.answer(fits, starts[0]), rounds=tuple(rounds))


@dataclass(frozen=True)
class Search:
    """A search on records that were made in one way.

    Attributes:
        records: to fit.
        searched: those of them, or the part of a long one, in which effects are searched.
        judge: on the others.
        bases: the declared model, refined over whole records, over windows; the better one first.
    """

    records: tuple[Record, ...]
    searched: tuple[Record, ...]
    judge: Judge
    bases: tuple[Judged, ...]

    @property
    def base(self) -> Judged:
        """The better one."""
        return self.bases[0]

    @classmethod
    def begun(
        cls,
        starts: Sequence[Plant],
        records: tuple[Record, ...],
        judge: Judge,
        present: tuple[Placed, ...] = (),
    ) -> "Search | None":
        """With the best base of each length of runs; None without a fit."""
        bases: list[Judged] = []
        searched = portion(records, starts[0])
        for window in (judge.longest, judge.window):
            fits = [_fitted(start, present, searched, window, judge) for start in starts]
            fits = [fit for fit in fits if fit is not None]
            bases += [min(fits, key=lambda fit: fit.error)] if fits else []
        ordered = sorted(bases, key=lambda fit: fit.error)
        return cls(records, searched, judge, tuple(ordered)) if bases else None

    @property
    def is_lost(self) -> bool:
        """Whether whole free runs of the declared model say nothing, however it is refined."""
        errors = [base.runs[0].nrmse for base in self.bases]
        if self.judge.longest is not None:
            return False
        if not all(is_lost(error, np.ones_like(error)) for error in errors):
            return False
        return not returns(self.base.refinement.plant, self.judge.records)

    def answer(self, fits: Sequence[Judged], start: Plant) -> FreeRunAnswer:
        """What the search came to, with these fits of its model, from this declared model."""
        base = self.base if self.searched is self.records else self.settled(self.base)[0]
        fits = tuple(fits) if self.further(fits[0]) else (base,)
        better = self._predicts_better(base, start)
        share = _count(self.searched) / _count(self.records)
        return FreeRunAnswer(base, fits, self.records, self.judge, better, share)

    def _predicts_better(self, base: Judged, start: Plant) -> bool:
        """Whether the refined model predicts otherwise than that of the passes, and no worse.

        Both have the same parameters: the records of the fit count as much as those that judge,
        of which a few that move slowly may prefer either by chance.
        """
        if self.judge.is_same(mean_error(self.judge.runs(start)), base.error):
            return False
        judge = Judge.of((*self.searched, *self.judge.records), start) or self.judge
        return not judge.prefers(judge.runs(start), judge.runs(base.refinement.plant))

    def accepts(self, trial: Judged, best: Judged, rounds: Sequence[Contest]) -> bool:
        """Whether a model is better than the best one by more than chance, or takes its place."""
        if self.judge.prefers(trial.runs, best.runs):
            return True
        return bool(rounds) and self.judge.replaces(trial, best, rounds[-1].origin)

    def answers(self, models: Sequence[Judged]) -> list[Judged]:
        """Models whose errors are lower than those of the base by as much as makes an answer."""
        limit = self.base.error + np.log(RULES.answer.confirmed)
        return [model for model in models if model.error < limit]

    def further(self, model: Judged) -> tuple[Placed, ...]:
        """Effects of a model that the base has not."""
        return tuple(placed for placed in model.placed if placed not in self.base.placed)

    def fitted(self, plant: Plant, placed: tuple[Placed, ...], best: Judged) -> Judged | None:
        """A model refined over runs as those of the best one so far, and judged.

        Without effects whose size is not told: earlier ones stood in for the new one, and of two
        new ones one may be enough. None where it has no free run or no fit, or where the records do
        not tell the size of any new one, unless that has become the law in which it ends.
        """
        if not_simulated(plant):
            return None
        window = best.refinement.window
        trial = _fitted(plant, (*best.placed, *placed), self.searched, window, self.judge)
        while trial is not None and (unknown := self._of_unknown_size(trial)):
            if all(item in unknown for item in trial.placed if item in placed):
                return self._in_the_limit(trial, unknown)
            trial = self.with_only([item for item in trial.placed if item not in unknown], trial)
        return None if trial is None else self._without_turned(trial)

    def _in_the_limit(self, model: Judged, unknown: Sequence[Placed]) -> Judged | None:
        """A model with the laws in which effects end whose parameters run off.

        The thrust of a propeller is k u|u|: beside it b u is next to nothing, and of b (u + q u|u|)
        only the product b q is told.
        """
        plant, placed = self.base.refinement.plant, []
        for item in model.placed:
            if item not in unknown:
                placed.append(item)
            elif (law := item.effect.limit()) is not None:
                placed.append(place(plant, law, item.channel))
            else:
                return None
        trial = self.with_only(placed, model)
        return None if trial is None or self._of_unknown_size(trial) else trial

    def _tells_parameters(self, model: Judged) -> bool:
        """Whether the records tell some parameter that they told of the declared model alone.

        Else effects have made a part of it so fast, or so large, that only ratios are left.
        """
        base, fit = self.base.refinement, model.refinement
        if not self.further(model):
            return True
        names = [name for name in base.plant.names if _is_sized(name, base)]
        names = [name for name in names if name not in fit.plant.fixed]
        return not names or any(_is_sized(name, fit) for name in names)

    def _without_turned(self, model: Judged) -> Judged:
        """A model without the declared terms whose place its effects have taken.

        Cells in series have no parameter: nothing would be left where they turn all terms. A term
        without which the records that judge are predicted worse stays: a level that is measured
        from anywhere may have either sign.
        """
        names, plant = turned_terms(self.base, model), model.refinement.plant
        if not names or {*names, *plant.fixed} == set(plant.names):
            return model
        plant = plant.declared_anew(dict.fromkeys(names, 0.0), fixed=names)
        fit = _fitted(plant, model.placed, self.searched, model.refinement.window, self.judge)
        if fit is None or self._of_unknown_size(fit) or self.judge.needs(model, fit):
            return model
        return fit

    def _of_unknown_size(self, model: Judged) -> list[Placed]:
        """Effects of a model of which the records do not tell the size."""
        return [item for item in self.further(model) if not has_size(item, model.refinement)]

    def further_forms(self, trials: Sequence[Judged]) -> list[Judged]:
        """The best model that has an effect of several forms, in the form that fits best.

        And the best one with a dependence of a parameter, which is such an effect.
        """
        groups = ([trial for trial in trials if has_dependence(trial.placed) == depends]
                  for depends in (False, True))  # fmt: skip
        return [trial for group in groups for trial in self._in_best_form(group)]

    def _in_best_form(self, trials: Sequence[Judged]) -> list[Judged]:
        candidates = [trial for trial in trials if self._next_forms(trial) is not None]
        best = first = min(candidates, key=lambda trial: trial.error, default=None)
        while best is not None and (placed := self._next_forms(best)) is not None:
            trial = self.with_only(placed, best)
            if trial is None or trial.refinement.cost >= best.refinement.cost:
                break
            best = trial
        return [] if best is None or best is first else [best]

    def _next_forms(self, model: Judged) -> tuple[Placed, ...] | None:
        """Effects of a model in their next forms, where these fit; None where none has any."""
        forms = [None if item in self.base.placed or item.channel == item.through
                 else item.effect.next_form() for item in model.placed]  # fmt: skip
        if not any(forms):
            return None
        plant, values, following = self.base.refinement.plant, model.refinement.parameters, []
        for item, form in zip(model.placed, forms, strict=True):
            # One may fit only where another one is: a stream through cells may be a product.
            if form is not None:
                if not form.fits(plant, item.channel):  # a fit may have turned the stream round
                    return None
                item = place(plant, form, item.channel, item.against, item.through)
            if item not in self.base.placed:
                missing = dict.fromkeys(item.names, 0.0)
                plant = augmented(plant, (item,), missing | values)
            following.append(item)
        return tuple(following)

    def with_only(
        self, placed: Sequence[Placed], model: Judged, opened: bool = False
    ) -> Judged | None:
        """The base with these effects, refined from the values of a model that has them.

        Without the declared terms that it is without, unless these are opened again.
        """
        base, values = self.base, model.refinement.parameters
        declared = base.refinement.plant
        declared = declared.with_parameters({name: values[name] for name in declared.names})
        further = tuple(item for item in placed if item not in base.placed)
        values = dict.fromkeys((name for item in further for name in item.names), 0.0) | values
        plant, effects = augmented(declared, further, values), (*base.placed, *further)
        fixed = () if opened else replaced_terms(declared, model.refinement.plant)
        if further and fixed:
            plant = plant.declared_anew(fixed=fixed)
        return _fitted(plant, effects, self.searched, model.refinement.window, self.judge)

    def _opened(self, placed: Sequence[Placed], model: Judged) -> Judged | None:
        """`with_only`, with the declared terms again that effects without a place now had turned.

        A term stays left out where it does not lower the errors, or where the records do not tell
        the size of an effect beside it: that one is in its place.
        """
        fit = self.with_only(placed, model)
        if fit is None or not replaced_terms(self.base.refinement.plant, fit.refinement.plant):
            return fit
        trial = self.with_only(placed, fit, opened=True)
        if trial is None or self._of_unknown_size(trial):
            return fit
        trial = self._without_turned(trial)
        return trial if self.judge.needs(trial, fit) else fit

    def leanest(self, best: Judged) -> Judged:
        """The model without the effects that it can be without, largest ones first."""
        further = self.further(best)
        if len(further) < 2:
            return best
        leaner = []
        for effect in further:
            fit = self._opened([item for item in further if item is not effect], best)
            if fit is not None and not self.judge.needs(best, fit):
                leaner.append(fit)
        if not leaner:
            return best
        return self.leanest(min(leaner, key=lambda fit: (fit.size, fit.error)))

    def settled(self, best: Judged) -> list[Judged]:
        """The model, and it refined over both lengths of runs; what predicts better first.

        None where the fits then tell no parameter any more, as it did: the last effect goes.
        """
        fits = over_both(best.refinement.plant, best.placed, self.records, self.judge)
        ended = [fit for fit in fits if fit.refinement.status.ok]
        fits = [fit for fit in ended if self._tells_parameters(fit)]
        if ended and not fits and self._tells_parameters(best):
            return []
        return sorted([best, *(fits or ended)], key=lambda fit: fit.error)


def refined(
    plant: Plant, placed: tuple[Placed, ...], records: tuple[Record, ...], judge: Judge
) -> Judged | None:
    """A model refined over the length of runs that predicts better; None where there is no fit.

    Args:
        plant: to refine from its values.
        placed: effects that were added to the declared model in it.
        records: to fit.
        judge: of the fits.
    """
    fits = over_both(plant, placed, records, judge)
    return best_of([fit for fit in fits if fit.refinement.status.ok])


def over_both(
    plant: Plant, placed: tuple[Placed, ...], records: tuple[Record, ...], judge: Judge
) -> list[Judged]:
    """A model refined over the long runs and over the short ones of its judge."""
    windows = judge.longest, judge.window
    fits = [_fitted(plant, placed, records, window, judge) for window in windows]
    return [fit for fit in fits if fit is not None]


def best_of(fits: Sequence[Judged]) -> Judged | None:
    """What predicts best; None of none."""
    return min(fits, key=lambda fit: fit.error, default=None)


def _fitted(
    plant: Plant,
    placed: tuple[Placed, ...],
    records: tuple[Record, ...],
    window: float | None,
    judge: Judge,
) -> Judged | None:
    """A model refined and judged; None where there is no fit, or where no run tells its start."""
    if plant.rows + np.sum(plant.open_internal) >= judge.head:
        return None
    refinement = refine_once(plant, records, window)
    if not refinement.status.fits:
        return None
    return Judged(refinement, placed, judge.runs(refinement.plant))


def portion(records: tuple[Record, ...], plant: Plant) -> tuple[Record, ...]:
    """As many of the records as may be searched, evenly chosen; the beginning of a long one.

    Args:
        records: to fit.
        plant: the declared model, whose runs with their derivatives take time for each state,
            parameter and step.
    """
    states = plant.rows * len(plant.outputs) + len(plant.open_internal)
    signals = states * (1 + len(plant.names) - len(plant.fixed) + states)
    steps = choose_steps(plant, records).count
    most = min(_RULES.samples // len(plant.outputs), _RULES.work // (steps * max(signals, 1)))
    if _count(records) <= most:
        return records
    for count in range(len(records) - 1, 0, -1):
        places = np.linspace(0, len(records) - 1, count).round().astype(int)
        chosen = tuple(records[i] for i in places)
        if _count(chosen) <= most:
            return chosen
    return (records[0][:most],)


def _count(records: tuple[Record, ...]) -> int:
    return sum(len(record) for record in records)


def _most_likely(searches: Sequence[Search]) -> Search:
    """The search whose base predicts best, of those that the records of the fit do not refute.

    Costs are compared at the same length of runs.
    """
    lowest: dict[float | None, float] = {}
    for search in searches:
        for base in search.bases:
            fit = base.refinement
            lowest[fit.window] = min(lowest.get(fit.window, np.inf), fit.cost)
    likely = [
        search
        for search in searches
        if any(
            base.refinement.cost < lowest[base.refinement.window] + _RULES.same_cost
            for base in search.bases
        )
    ]
    return min(likely, key=lambda search: search.base.error)


def _is_sized(name: str, fit: Refinement) -> bool:
    """Whether a fit tells the size of a parameter that it estimates."""
    return name not in fit.plant.fixed and size_is_known(
        [name], fit.parameters, fit.standard_errors
    )


def _in_time(placed: Sequence[Placed]) -> bool:
    """Whether one of some effects is a disturbance in time."""
    return any(isinstance(item.effect, Drift | SinusoidalDisturbance) for item in placed)


def _begun(
    starts: Sequence[Plant],
    variants: Sequence[RecordPair],
    judge: Judge,
    present: tuple[Placed, ...],
) -> list[Search]:
    """Searches on records made in each way, judged alike."""
    searches = [
        Search.begun(starts, records, replace(judge, records=judging), present)
        for records, judging in variants
    ]
    return [search for search in searches if search is not None]


def _made_best(searches: Sequence[Search], search: Search, best: Judged) -> tuple[Search, Judged]:
    """The answer on records made in the way in which it predicts best, with their search.

    The hold was chosen for the declared model: what that lacks can look like another hold.
    """
    pairs = [(search, best)]
    variants = [variant for variant in searches if variant is not search]
    for variant in variants if search.further(best) else ():
        model = best.refinement.plant, best.placed
        trials = over_both(*model, variant.searched, variant.judge)
        trial = best_of(trials)
        if trial is not None and (
            variant.judge.needs(trial, best) or _fits_better(trials, best, variant)
        ):
            pairs.append((variant, variant.leanest(trial)))
    return min(pairs, key=lambda pair: pair[1].error)


def _fits_better(trials: Sequence[Judged], best: Judged, variant: Search) -> bool:
    """Whether a model fits records made in another way better by more than chance, and predicts so.

    Its parameters are the same ones, so that the likelihood of all samples decides: a hold that is
    wrong by half a sample may raise errors by half a hundredth, and make a time constant a third
    too small.
    """
    comparable = [trial for trial in trials if trial.refinement.window == best.refinement.window]
    gains = [
        _count(variant.searched) * (best.refinement.cost - trial.refinement.cost)
        for trial in comparable
        if trial.error < best.error
    ]
    return max(gains, default=0.0) > SETTINGS.evidence
