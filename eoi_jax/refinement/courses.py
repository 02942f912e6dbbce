"""Free runs of a refinement at every sample, also between those at which outputs were measured."""

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.free_run_sums import outputs
from eoi_jax.refinement.problem import Problem, Unknowns, guessed_starts, problem_of
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.spans import spans_of

Course = Float[np.ndarray, "time ny"]


def courses(result: Refinement, record: int = 0) -> tuple[Course, Course] | None:
    """Outputs at the starting point, and with the estimate, at every sample of a record.

    The runs are those of the fit: `residual` has the same ones where samples were scored.

    Args:
        result: of `refine`, with its records.
        record: which of them.

    Returns:
        Two arrays (N, ny), NaN where no run is; None of runs in a closed loop, whose controller the
        result does not hold.
    """
    if result.in_loop:
        return None
    records = result.records
    spans = spans_of(records, result.window)

    def course_of(plant: Plant, estimated: bool) -> Course:
        problem = problem_of(plant, records, spans, result.substeps)
        starts = (
            _estimated_starts(result, problem)
            if estimated
            else guessed_starts(problem, records, spans)
        )
        theta = np.asarray(plant.theta)[list(problem.free)]
        y_hat, course = outputs(Unknowns(theta, starts), problem), _empty(records[record])
        for span, run in zip(spans, y_hat, strict=True):
            if span.record == record:  # the sample at which two runs meet is of the later one
                course[span.first : span.first + span.count + 1] = run[: span.count + 1]
        return course

    with np.errstate(all="ignore"):  # of a run that diverges
        return course_of(result.nominal, estimated=False), course_of(result.plant, estimated=True)


def _empty(record: Record) -> Course:
    return np.full(record.outputs.shape, np.nan)


def _estimated_starts(result: Refinement, problem: Problem) -> Float[np.ndarray, "runs own"]:
    kernel = problem.kernel
    return np.stack([start.unknowns(kernel.rows, kernel.columns) for start in result.starts])
