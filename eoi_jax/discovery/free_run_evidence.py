"""What the records of the fit, and long runs, say of an answer that free runs came to."""

import numpy as np

from eoi_jax.discovery.free_run_search import FreeRunAnswer, best_of, over_both, portion
from eoi_jax.discovery.judge import (
    Judge,
    error_ratio,
    least_error_ratio,
    only_otherwise,
    ratio_beyond_noise,
)
from eoi_jax.discovery.rules import RULES


def exchanged_ratio(answer: FreeRunAnswer) -> float:
    """Ratio of the errors with and without the effects of an answer, when the parts change places.

    Both models are refined on the records that judged, and judged on those of the fit, or on the
    beginning of long ones: a few records that move slowly may prefer either by chance.
    """
    judge = Judge.of(portion(answer.records), answer.base.refinement.plant)
    if judge is None:
        return np.inf
    base, best = (
        best_of(over_both(model.refinement.plant, model.placed, answer.judging, judge))
        for model in (answer.base, answer.best)
    )
    return np.inf if base is None or best is None else float(np.exp(best.error - base.error))


def long_run_ratio(answer: FreeRunAnswer) -> float:
    """Ratio of the errors of long runs with and without the effects, where short ones tell nothing.

    Short runs start anew so often that effects may hardly change them: what they miss by is noise,
    and cannot fall. Long runs are then asked, on the records that judge and on those of the fit,
    and the larger ratio counts, of what exceeds the noise of the sensors. Infinite where effects
    could lower the errors of short runs enough to be confirmed, or where these grow.
    """
    best, base = answer.best.runs, answer.base.runs
    assert best[1] is not None
    assert base[1] is not None
    judge = Judge.of(portion(answer.records), answer.base.refinement.plant)
    tells = least_error_ratio(best[1], base[1]) < RULES.answer.confirmed
    grows = np.log(error_ratio(best[1], base[1])) > RULES.judge.same_error
    if tells or grows or judge is None:
        return np.inf
    fits = [judge.runs(model.refinement.plant)[0] for model in (answer.best, answer.base)]
    return max(ratio_beyond_noise(best[0], base[0]), ratio_beyond_noise(fits[0], fits[1]))


def contradicted_by_fit(answer: FreeRunAnswer) -> bool:
    """Whether the records of the fit could confirm the effects of an answer, and do not.

    There the model predicts otherwise than the base, by as much as would lower the errors enough if
    it were true, and hardly better.
    """
    judge = Judge.of(portion(answer.records), answer.base.refinement.plant)
    if judge is None:
        return False
    base, best = (model.refinement.plant for model in (answer.base, answer.best))
    return only_otherwise(judge, best, base)
