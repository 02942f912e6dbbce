"""The refit of a set of effects by the estimator, and its free runs on held-out records."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.remarks import FitNote
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.side_by_side import concurrently
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.holdout import longest_start
from eoi_jax.estimation.identify import Identification, bound_notes, estimate
from eoi_jax.models.augmented import added_effects
from eoi_jax.models.effects import InputDelay
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import frictional
from eoi_jax.simulation.validate import (
    FreeRuns,
    growth_that_rules,
    runs_in,
    whole_and_windows,
)

_ON_BOUND = ": what it would take beyond stays unexplained"
_SEARCHED = FitNote("parameters are those of the search: in free runs better than the refit's")
_AT_SAMPLES = (
    "{} at a multiple of the sample period: in free runs better than the estimate next to it, with "
    "which the outputs would show each jump of the input a sample late"
)


def refitted(task: Task, model: Plant) -> tuple[Identification, tuple[str, ...]]:
    """Fit all parameters again with the estimator, starting from the result of the search.

    The estimator's passes average over a step what the modes treat to fourth order, and smooth the
    inputs like the outputs if the noise requires it; an input effect does not commute with that
    smoothing. So the result that is better in short free runs on the records of the fit is kept.
    An output that shows jumps of a held input at once, a hair behind a multiple of the sample
    period, would show each of them a sample late: delays near one are also tried at it.

    Args:
        task: the constants of the discovery.
        model: the augmented plant, with the parameters of the search.

    Returns:
        The fit, and a note where the parameters of the search, or delays at multiples of the sample
        period, are better: the fit is then one pass that evaluates them.
    """
    window = window_of(task, task.records)
    bounded = bool(np.all((model.lower <= model.theta) & (model.theta <= model.upper)))
    if window is None or not bounded:
        return estimate(model, task.prepared), ()

    def error(plant: Plant) -> float:
        return float(np.sum(np.log(runs_in(window, plant, task.records).rmse + 1e-300)))

    with concurrently(task.threads, lambda: error(model)) as searched_error:
        refit = estimate(model, task.prepared)
        search_error, refit_error = searched_error(), error(refit.plant)
    answer, notes = refit, ()
    if search_error < refit_error:
        searched = estimate(model, task.prepared, passes=1)
        answer, notes = replace(searched, status=refit.status), (_SEARCHED,)
    delays = _delays_at_samples(answer, task.records)
    shifted = answer.plant.with_parameters(answer.parameters | delays)
    if not (delays and error(shifted) < min(search_error, refit_error)):
        return answer, notes
    evaluated = estimate(shifted, task.prepared, passes=1)
    note = FitNote(_AT_SAMPLES.format(" and ".join(delays)))
    return replace(evaluated, status=answer.status), (*notes, note)


def _delays_at_samples(fit: Identification, records: Sequence[Record]) -> dict[str, float]:
    """Delays of held inputs at the nearest multiples of the sample period, less the inputs' skew.

    Those within their errors of a multiple, of a plant whose outputs show their inputs at once.
    """
    plant, period = fit.plant, records[0].sample_period
    if not plant.has_algebraic or any(record.sample_period != period for record in records):
        return {}
    delays = {}
    for placed in added_effects(plant):
        if not isinstance(placed.effect, InputDelay) or records[0].holds[placed.channel] != "zero":
            continue
        (name,) = placed.names
        skew = float(records[0].skew[placed.channel])
        nearest = round((fit.parameters[name] + skew) / period) * period - skew
        distance = abs(fit.parameters[name] - nearest)
        if nearest > 0.0 and distance < RULES.judge.min_deviations * fit.standard_errors[name]:
            delays[name] = nearest
    return delays


def on_bounds(declared: Plant, plant: Plant) -> list[str]:
    """A note for each declared parameter that is on a bound.

    Args:
        declared: the plant without effects.
        plant: the plant with the effects.
    """
    theta = np.asarray(plant.theta)
    bound = (theta == np.asarray(plant.lower)) | (theta == np.asarray(plant.upper))
    bound &= np.arange(len(bound)) < len(declared.names)
    bound &= np.asarray(plant.free) > 0
    return [FitNote(note + _ON_BOUND) for note in bound_notes(plant, bound)]


def not_simulated(plant: Plant) -> str:
    """Why a plant has no free runs; "" if it has them."""
    try:
        frictional(plant)
    except ValueError as error:
        return str(error)
    return ""


def window_of(task: Task, records: Sequence[Record]) -> float | None:
    """Length of short free runs [s]; None where the records are too short."""
    if task.window is not None:
        return task.window
    return window_length(records, 2 * longest_start(task.plant, records))


def free_runs(task: Task, plant: Plant) -> FreeRuns:
    """Long and short free runs on the held-out records, or without any on those of the fit.

    Long ones are through whole records, but for unstable plants.
    """
    records, longest = task.held_out or task.records, task.longest
    window = window_of(task, records)
    if longest is None and plant is task.declared.plant:
        short = None if window is None else runs_in(window, plant, records)
        return task.whole_runs, short
    return whole_and_windows(plant, records, window, longest)


def runs_that_tell(
    task: Task, plant: Plant, prior: FreeRuns, runs: FreeRuns
) -> tuple[FreeRuns, FreeRuns]:
    """Free runs of the declared model and of another, alike.

    A stable model may lack what makes the plant unstable or chaotic: whole runs of the right model
    are then lost, as errors of their starts grow. Long runs are through windows in which they stay
    small, for both models.

    Args:
        task: the constants of the discovery.
        plant: the other model.
        prior: free runs of the declared model.
        runs: of the other one, of the same lengths.
    """
    if runs[0].window is not None:
        return prior, runs
    growth = growth_that_rules(plant, runs[0], limit=RULES.judge.misled)
    if growth is None:
        return prior, runs
    records = task.held_out or task.records
    lengths = window_of(task, records), growth.window
    return (
        whole_and_windows(task.declared.plant, records, *lengths),
        whole_and_windows(plant, records, *lengths),
    )
