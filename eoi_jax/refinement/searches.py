"""Searches from many points: how they are sorted out, and that around a fit which stalled."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.refinement.first_runs import stepped
from eoi_jax.refinement.fit import (
    Effort,
    Fit,
    differentiable_at,
    faint_parameters,
    fitted,
    rms,
    unweighed,
)
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.multistart import best, points_of
from eoi_jax.refinement.problem import Problem, Unknowns
from eoi_jax.refinement.spans import Span


@dataclass(frozen=True)
class SearchSettings:
    """When a search from many points follows a fit, and how."""

    rough_step: int = 4  # of the simulations that sort out starting points, times that of the fit
    max_rough_error: float = 0.1  # of such steps, over the residual
    # Share of the cost; where the solver stalls and least squares predicts more, a search follows.
    max_reduction: float = 0.01
    # What single parameters do in a step, over what is left of it, above which it promises nothing.
    # Set with measured records in view: 200 of two quadratic inputs of a heat exchanger.
    max_cancelling: float = 50.0
    search_points: int = 64
    search_rounds: int = 4


SEARCH = SearchSettings()


def in_longer_steps(
    problem: Problem,
    records: Sequence[Record],
    spans: Sequence[Span],
    unknowns: Unknowns,
    initial_error: Float[np.ndarray, "runs time ny"],
) -> Problem:
    """Longer steps, by which most starts are sorted out, if their error hardly shows at the first.

    Itself where they do not do, or the first start, whose errors are `initial_error`, diverges.
    """
    if problem.substeps == 1 or not np.all(np.isfinite(initial_error)):
        return problem
    substeps = max(problem.substeps // SEARCH.rough_step, 1)
    rough = stepped(problem, records, spans, substeps)
    sensitivities = signals(unknowns, rough)
    step_error = rms(unweighed(rough, sensitivities) - initial_error, problem.use)
    negligible = step_error <= SEARCH.max_rough_error * rms(initial_error, problem.use)
    return (
        rough
        if np.all(negligible) and differentiable_at(rough, unknowns, sensitivities)
        else problem
    )


def search_around(
    fit: Fit,
    records: Sequence[Record],
    spans: Sequence[Span],
    effort: Effort,
    huber: float | None,
) -> list[Fit]:
    """From points around a fit that stalled at a kink, far above what least squares promises.

    Where two parameters do nearly the same, least squares trades them for each other far beyond
    where the runs are straight in them, and what it promises there is not to be had. Also from
    around one that ended where a parameter leaves next to no trace.
    """
    outcome, problem = fit.outcome, fit.problem
    stalled = (
        float(outcome.predicted_reduction) >= SEARCH.max_reduction
        and float(outcome.cancelling) <= SEARCH.max_cancelling
        and not bool(outcome.exhausted)
    )
    if not fit.differentiable or not (stalled or faint_parameters(fit)):
        return []
    theta = problem.completed(outcome.unknowns.theta)
    centre = problem.kernel.plant.with_parameters(theta)
    points = points_of(centre, SEARCH.search_points)
    rough = in_longer_steps(problem, records, spans, outcome.unknowns, fit.error)
    starts = best(problem, rough, outcome.unknowns, points, SEARCH.search_rounds)
    fits = [
        fitted(problem, start, signals(start, problem), fit.initial_error, effort, huber)
        for start in starts
    ]
    return [replace(start, steps=fit.steps + start.steps) for start in fits]
