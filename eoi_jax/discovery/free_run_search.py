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
4. The judge: the free-run errors on records that no fit has seen, whole and in windows. A
   candidate is accepted where their mean logarithm falls enough, and the paired difference over
   blocks of these records exceeds its own standard error by enough, and does so on the records of
   the fit; or where both together show it that do not alone; one that takes the place of an effect
   of the round before, where it does so over the model before that. Of these the best on both
   stays. Then from 2, on records made in the way that fits the model best now, until none does, and
   once more from what is left without the effects that the model can be without.
5. What can be left out again without a larger error is left out; of the ways in which the records
   may have been made that which makes the answer most likely is taken, and of its fits over long
   and over short runs that which is better on all records.

Disturbances in time are not tried: they stand in for what the library lacks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.discovery.free_run_candidates import Model, candidates
from eoi_jax.discovery.free_run_trials import Search, count_of
from eoi_jax.discovery.judge import Judge, Judged, products_in
from eoi_jax.discovery.probability import Contest
from eoi_jax.discovery.replacements import replacements
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import Drift, SinusoidalDisturbance
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.error_growth import is_lost
from eoi_jax.simulation.sensor_noise import is_exact
from eoi_jax.simulation.validation import Validation

_RULES = RULES.free_runs

RecordPair = tuple[tuple[Record, ...], tuple[Record, ...]]  # to fit, and to judge
Course = tuple[Judged, Sequence[Contest]]  # what rounds came to, and these


@dataclass(frozen=True)
class FreeRunAnswer:
    """What the search came to.

    Attributes:
        base: the declared model, refined.
        best: the model with the effects that stayed; the base where no effect did.
        records: of the fit, in the variant that predicts best.
        judge: on the others.
        share: of the samples, in which effects were searched.
        rounds: of the search.
        better_base: whether it predicts otherwise than before it was refined, and not worse by more
            than chance on all records: it is what fits those of the fit best.
    """

    base: Judged
    best: Judged
    records: tuple[Record, ...]
    judge: Judge
    better_base: bool
    share: float
    rounds: tuple[Contest, ...] = ()

    @classmethod
    def of(
        cls, search: Search, best: Judged, start: Plant, rounds: Sequence[Contest] = ()
    ) -> "FreeRunAnswer":
        """What a search came to, from this declared model."""
        base = search.settled_base
        best = best if search.further(best) else base
        better = search.predicts_better(base, start)
        share = count_of(search.searched) / count_of(search.records)
        judged = base, best, search.records, search.judge
        return cls(*judged, better, share, tuple(rounds))

    @property
    def judging(self) -> tuple[Record, ...]:
        """Records that no fit has seen."""
        return self.judge.records

    def errors_over_motion(self, runs: Validation) -> Float[np.ndarray, " ny"]:
        """Errors of the records that judge, over the larger spread of these and those of the fit.

        Where the former hardly move, a constant describes them, whatever the model is.
        """
        outputs = [record.known_outputs for record in self.records]
        spread = np.nanstd(np.concatenate(outputs), axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.fmin(runs.nrmse, runs.rmse / spread)

    @property
    def is_lost(self) -> bool:
        """Whether whole free runs say nothing of its best model either."""
        error = self.errors_over_motion(self.best.runs[0])
        return is_lost(error, np.ones_like(error))


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
    library = [
        effect for effect in effects if not isinstance(effect, Drift | SinusoidalDisturbance)
    ]
    judge = Judge.of(variants[0][1], starts[0])
    if judge is None:
        return None
    asked = starts, variants, library, level, further, rival, present
    searches = _begun(starts, variants, judge, present)
    if not searches:
        return None
    answer = _answer(searches, *asked)
    if all(search.is_lost for search in searches) and (answer is None or answer.is_lost):
        # Whole runs say nothing of any model: what they sum up is not what it lacks.
        searches = _begun(starts, variants, judge.without_whole_runs(), present)
        return _answer(searches, *asked) if searches else None
    return answer


def _answer(
    searches: Sequence[Search],
    starts: Sequence[Plant],
    variants: Sequence[RecordPair],
    effects: Sequence[AbstractEffect],
    level: float,
    further: Sequence[Model],
    rival: Plant | None,
    present: tuple[Placed, ...],
) -> FreeRunAnswer | None:
    """What searches on records made in several ways come to; None where the rival stays."""
    search = _most_likely(searches)
    trials = _first_trials(search, starts, effects, level, further, present)
    best, rounds = search.base, []
    if (contest := _round(search, trials, (best, ()), effects)) is not None:
        best, rounds = contest.chosen, [contest]
    if rounds and not present:
        search, best, rounds = _continued(searches, search, (best, rounds), effects, level)
    search, best = _made_best(searches, search, search.narrowed(search.leanest(best), effects))
    while (settled := search.settled(best)) is None or search.of_unknown_size(settled):
        best = rounds.pop().origin  # records made in another way may not tell the last effect
    # Each on records made as it was found with.
    first_judge = replace(search.judge, records=variants[0][1])
    if rival is not None and first_judge.prefers(first_judge.runs(rival), settled.runs):
        return None
    return FreeRunAnswer.of(search, settled, starts[0], rounds)


def _first_trials(
    search: Search,
    starts: Sequence[Plant],
    effects: Sequence[AbstractEffect],
    level: float,
    further: Sequence[Model],
    present: tuple[Placed, ...],
) -> list[Judged]:
    """Models of the first round: from each base, and from nominal values.

    Where the declared model came to the same end from all starts, only those are refined from
    nominal values, too, that did not converge or of which nothing was told.
    """
    best, explained = search.base, bool(present)
    if _is_exact(best):
        return []
    # What short runs do not show or fit a whole one may, and the other way about.
    models = [
        (plant, placed, origin)
        for origin in ((best,) if explained else search.bases)
        for plant, placed in candidates(origin, effects, level, explained=explained)
    ]
    if not explained:
        models += [(*candidate, best) for candidate in further if not _in_time(candidate[1])]
    fits = [search.fitted(*model) for model in models]
    if not explained:
        restarts = [
            (plant.with_parameters(starts[-1].parameters), placed, best)
            for (plant, placed, origin), fit in zip(models, fits, strict=True)
            if origin is best and not (search.ends_alike and _is_settled(fit))
        ]
        fits += [search.fitted(*model) for model in restarts]
    fits += [search.fitted(*model, best) for model in replacements(best, effects)]
    return [fit for fit in fits if fit is not None]


def _is_settled(fit: Judged | None) -> bool:
    """Whether another start would end alike: a fit that converged and tells what it is of."""
    return fit is not None and fit.refinement.status.code == "converged"


def _continued(
    searches: Sequence[Search],
    search: Search,
    course: Course,
    effects: Sequence[AbstractEffect],
    level: float,
) -> tuple[Search, Judged, list[Contest]]:
    """Further rounds, until none adds an effect; each on records made as fits its model best."""
    best, rounds = course
    for _ in range(len(rounds), _RULES.most):
        search, best = _made_better(searches, search, best)
        if _is_exact(best):
            break
        fits = [search.fitted(*model, best) for model in candidates(best, effects, level)]
        trials = [fit for fit in fits if fit is not None]
        contest = _round(search, trials, (best, rounds), effects)
        if contest is None:
            # What stood in for an effect that is found beside it may have hidden another one.
            lean = search.leanest(best)
            if lean is best:
                break
            best = lean
        else:
            best, rounds = contest.chosen, [*rounds, contest]
    return search, best, list(rounds)


def _round(
    search: Search, trials: Sequence[Judged], course: Course, effects: Sequence[AbstractEffect]
) -> Contest | None:
    """A round of a search that tries these models; None where no effect stays."""
    best, rounds = course
    trials = [*trials, *search.further_forms(trials)]
    accepted = [trial for trial in trials if search.accepts(trial, best, rounds)]
    if not accepted:
        return None
    # A plainer model as good need not be better by more than chance on records that judge.
    shown = [trial for trial in trials if search.is_shown_by_fit(trial, best)]
    chosen = search.judge.plainest_of_all(shown, search.answers(accepted) or accepted)
    plain = search.narrowed(chosen, effects, ended=True)
    rivals = [trial for trial in shown if products_in(trial) <= products_in(plain)]
    return Contest(best, plain, (*rivals, *([plain] if plain is not chosen else [])))


def _is_exact(model: Judged) -> bool:
    """Whether its errors are within the accuracy of a simulation."""
    return all(is_exact(run) for run in model.runs if run)


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


def _made_better(searches: Sequence[Search], search: Search, best: Judged) -> tuple[Search, Judged]:
    """A model on records made in the way that fits it best, from where it is.

    What the declared model lacks hides by how many samples its inputs are off: effects of the next
    round would stand in for that.
    """
    pairs = [(search, best)]
    for variant in searches:
        if variant is not search:
            trial = variant.refitted(best)
            if trial is not None and variant.is_better_made(trial, best):
                pairs.append((variant, trial))
    return min(pairs, key=lambda pair: pair[1].refinement.cost)


def _made_best(searches: Sequence[Search], search: Search, best: Judged) -> tuple[Search, Judged]:
    """The answer on records made in the way in which it predicts best, with their search.

    The hold was chosen for the declared model: what that lacks can look like another hold.
    """
    if not search.further(best):
        return search, best
    variant, trial = _made_better(searches, search, best)
    return variant, trial if trial is best else variant.leanest(trial)
