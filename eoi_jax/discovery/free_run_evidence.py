"""What the records of the fit, and long runs, say of an answer that free runs came to."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.discovery.additions import has_size
from eoi_jax.discovery.free_run_search import FreeRunAnswer
from eoi_jax.discovery.free_run_trials import refined
from eoi_jax.discovery.judge import (
    Judged,
    deviations_of,
    error_ratio,
    least_error_ratio,
    only_otherwise,
    ratio_beyond_noise,
)
from eoi_jax.discovery.remarks import FitNote
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.plant import Plant


def lost_on_held_out(answer: FreeRunAnswer) -> list[str]:
    """A sentence where free runs of every length miss held-out records by more than these move.

    By more than those of the fit move, where that is more. Of two models of which neither says
    anything of a record one is nearer to it by chance. Records of another place or speed, which the
    fit has not seen, look so: then the sentence says it.
    """
    errors = [answer.errors_over_motion(run) for run in answer.best.runs if run is not None]
    if not all(np.all(~(error <= RULES.questions.useless)) for error in errors):
        return []
    seen, judging = (_ranges(records) for records in (answer.records, answer.judging))
    first = answer.judging[0]
    apart = [
        f"{key} is {low:.4g} to {high:.4g} {first.units.get(key, '')}".rstrip()
        + f" there, {fitted[0]:.4g} to {fitted[1]:.4g} in the fit"
        for key, (low, high), fitted in zip(first.output_names, judging, seen, strict=True)
        if low > fitted[1] or high < fitted[0]
    ]
    return [FitNote("; ".join([_LOST, *apart]))]


def _ranges(records: Sequence[Record]) -> list[tuple[float, float]]:
    """Of each output, over all records."""
    measured = [record.known_outputs for record in records]
    together = np.concatenate(measured)
    lows, highs = np.nanmin(together, axis=0), np.nanmax(together, axis=0)
    return list(zip(lows.tolist(), highs.tolist(), strict=True))


def long_run_ratio(answer: FreeRunAnswer) -> float:
    """Ratio of the errors of long runs with and without the effects, where short ones tell nothing.

    Short runs start anew so often that effects may hardly change them: what they miss by is noise,
    and cannot fall. Long runs are then asked, on the records that judge and on those of the fit,
    and the larger ratio counts, of what exceeds the noise of the sensors. Infinite without short
    runs, where effects could lower the errors of these enough to be confirmed, or where they grow;
    and where the errors of long runs fall by no more than chance on the records of the fit: those
    of a plant that integrates wander, and a part of one record may have most of them.
    """
    best, base = answer.best.runs, answer.base.runs
    if best[1] is None or base[1] is None:
        return np.inf
    fitted, fitted_base = answer.best.fit_runs, answer.base.fit_runs
    tells = least_error_ratio(best[1], base[1]) < RULES.answer.confirmed
    grows = np.log(error_ratio(best[1], base[1])) > RULES.judge.same_error
    if tells or grows or fitted is None or fitted_base is None:
        return np.inf
    if not answer.judge.prefers((fitted[0], None), (fitted_base[0], None)):
        return np.inf
    on_fit = ratio_beyond_noise(fitted[0], fitted_base[0])
    return max(ratio_beyond_noise(best[0], base[0]), on_fit)


def shown_by_all(answer: FreeRunAnswer) -> bool:
    """Whether the records that judge and those of the fit together confirm an answer.

    Each show it by more than chance, and the mean of both falls is what confirms an effect.
    """
    best, base = answer.best, answer.base
    if best.fit_runs is None or base.fit_runs is None:
        return False
    pairs = (best.runs, base.runs), (best.fit_runs, base.fit_runs)
    if any(max(deviations_of(*pair)) < RULES.judge.min_deviations for pair in pairs):
        return False
    fall = base.error_of_all - best.error_of_all
    return bool(best.error < base.error and fall > -np.log(RULES.answer.confirmed))


def without_stand_ins(
    answer: FreeRunAnswer, model: Judged, declared: Plant, doubted: Sequence[Placed]
) -> Judged:
    """A model without effects of the explanation that it does not need any more.

    They stood in for what free runs found beside them, or for parameters that the passes biased:
    the model does not tell their size, or the injection was not sure of them. All stay where the
    records that judge are predicted worse without them.

    Args:
        answer: what the search came to.
        model: its base or its best one.
        declared: without effects.
        doubted: effects of the explanation that the injection is not sure of.
    """
    values = model.refinement.parameters
    plant = declared.with_parameters({name: values[name] for name in declared.names})

    def leaner(stay: tuple[Placed, ...], model: Judged) -> Judged:
        if len(stay) in (0, len(model.placed)):
            return model
        trial = refined(augmented(plant, stay, values), stay, answer.records, answer.judge)
        as_good = trial is not None and answer.judge.is_as_good(trial.runs, model.runs)
        return trial if trial is not None and as_good else model

    explained, fit = answer.base.placed, model.refinement
    has_further = len(model.placed) > len(explained)
    told = tuple(at for at in model.placed if at not in explained or has_size(at, fit))
    model = leaner(told, model)
    for effect in doubted if has_further else ():
        model = leaner(tuple(at for at in model.placed if at != effect), model)
    return model


def contradicted_by_fit(answer: FreeRunAnswer) -> bool:
    """Whether the records of the fit could confirm the effects of an answer, and do not.

    There the model predicts otherwise than the base, by as much as would lower the errors enough if
    it were true, and hardly better.
    """
    base, best = (model.refinement.plant for model in (answer.base, answer.best))
    judge = answer.judge.of_fit
    return judge is not None and only_otherwise(judge, best, base)


def surpasses(answer: FreeRunAnswer, plant: Plant, placed: Sequence[Placed]) -> bool:
    """Whether an answer predicts better than a plant with other effects, by more than chance.

    Of that plant the fit counts that the search has refined, if it came to it.
    """
    sites = {at.site for at in placed}
    searched = [
        trial.runs
        for contest in answer.rounds
        for trial in contest.trials
        if {at.site for at in trial.placed} == sites
    ]
    return all(
        answer.judge.prefers(answer.best.runs, runs)
        for runs in searched or [answer.judge.runs(plant)]
    )


_LOST = (
    "free runs of no model predict the held-out records better than a constant does, which says "
    "nothing of effects"
)
