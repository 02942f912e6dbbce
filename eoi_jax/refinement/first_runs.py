"""The free runs that a fit begins with: their starts, and how many steps they take."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.fit import differentiable_at, rms
from eoi_jax.refinement.free_run_sums import outputs, signals
from eoi_jax.refinement.problem import Problem, Unknowns, guessed_starts, problem_of, weighed
from eoi_jax.refinement.spans import Span
from eoi_jax.simulation.step_size import (
    RULES,
    StepChange,
    choose_steps,
    finest_steps,
    settled_steps,
)

# A problem, where its search begins, and `signals` there.
FirstRuns = tuple[Problem, Unknowns, Float[np.ndarray, "runs time ny size"]]


def first_runs(
    nominal: Plant, records: Sequence[Record], spans: Sequence[Span], substeps: int | None
) -> FirstRuns:
    """The free runs at the plant's own values, and their signals.

    Where no number of steps is asked for, as the fastest mode there needs them, and so many that
    these runs have derivatives.
    """
    first = None
    count = choose_steps(nominal, records).count if substeps is None else substeps
    most = min(count * 2**RULES.halvings, finest_steps(records))
    while True:
        problem, unknowns = _guessed(nominal, records, spans, count)
        sensitivities = signals(unknowns, problem)
        candidate = problem, unknowns, sensitivities
        first, count = first or candidate, 2 * count
        if differentiable_at(problem, unknowns, sensitivities):
            return candidate
        if substeps is not None or count > most:
            return first


def first_settled_runs(
    nominal: Plant, records: Sequence[Record], spans: Sequence[Span], count: int
) -> FirstRuns | None:
    """`first_runs` in more steps than `count`, that half as long ones agree with.

    Returns:
        None where so many do, or no number does that there may be.
    """

    def change(count: int) -> StepChange:
        problem, unknowns = _guessed(nominal, records, spans, count)
        finer = stepped(problem, records, spans, 2 * count)
        fine, use = outputs(unknowns, finer), problem.use
        with np.errstate(all="ignore"):
            step_error, error = fine - outputs(unknowns, problem), fine - problem.y
            parts = (np.where(use, part, 0.0) for part in (step_error, error, problem.y))
            size, residual, measured = (rms(part, use) for part in parts)
            return size, residual, measured

    limit = finest_steps(records)
    settled, are_short = settled_steps(count, limit, change)
    if not are_short or settled == count:
        return None
    for finer in (settled * 2**halvings for halvings in range(RULES.halvings + 1)):
        problem, unknowns, sensitivities = first_runs(nominal, records, spans, finer)
        if differentiable_at(problem, unknowns, sensitivities):
            return problem, unknowns, sensitivities
        if 2 * finer > limit:
            break
    return None


def _guessed(
    nominal: Plant, records: Sequence[Record], spans: Sequence[Span], count: int
) -> tuple[Problem, Unknowns]:
    """The runs in so many steps per sample, and their guessed starts."""
    problem = problem_of(nominal, records, spans, count)
    theta = np.asarray(nominal.theta)[list(problem.free)]
    return problem, Unknowns(theta, guessed_starts(problem, records, spans))


def stepped(
    problem: Problem, records: Sequence[Record], spans: Sequence[Span], substeps: int
) -> Problem:
    """The same runs and weights with other steps."""
    other = problem_of(problem.kernel.plant, records, spans, substeps)
    return weighed(other, 1.0 / np.asarray(problem.scale), float(problem.threshold))
