"""A set of effects fitted again by the estimator, and its free runs on records that judge."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.round import Task
from eoi_jax.discovery.side_by_side import aside
from eoi_jax.estimation.holdout import INITIAL
from eoi_jax.estimation.identify import Identification, bound_notes, estimate
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.integrator import frictional
from eoi_jax.simulation.validate import FreeRuns, validate, whole_and_windows

_BEYOND = ": what it would take beyond stays unexplained"
SEARCHED = "parameters are those of the search: in free runs better than the refit's"


def refitted(task: Task, model: Plant, notes: list[str]) -> Identification:
    """Everything fitted again by the estimator, from where the search ended.

    Its passes average over a step what the modes treat to fourth order, and smooth the inputs
    with the outputs where noise asks for it, which an input effect does not commute with. So
    the better of both in short free runs on the records of the fit is kept.

    Args:
        task: what is fixed.
        model: the augmented plant, with the parameters of the search.
        notes: gets a sentence where these are kept; the fit is then one pass that scores them.
    """
    window = window_of(task, task.records)
    bounded = bool(np.all((model.lower <= model.theta) & (model.theta <= model.upper)))
    if window is None or not bounded:
        return estimate(model, task.prepared)

    def error(plant: Plant) -> float:
        return float(np.sum(np.log(validate(plant, task.records, window=window).rmse + 1e-300)))

    with aside(task.threads, lambda: error(model)) as searched:
        found = estimate(model, task.prepared)
        ours, theirs = searched(), error(found.plant)
    if not ours < theirs:
        return found
    notes.append(SEARCHED)
    return replace(estimate(model, task.prepared, passes=1), status=found.status)


def on_bounds(declared: Plant, plant: Plant) -> list[str]:
    """A note for each declared parameter that is on a bound.

    Args:
        declared: the plant without effects.
        plant: with the answer.
    """
    theta = np.asarray(plant.theta)
    bound = (theta == np.asarray(plant.lower)) | (theta == np.asarray(plant.upper))
    bound &= np.arange(len(bound)) < len(declared.names)
    bound &= np.asarray(plant.free) > 0
    return [note + _BEYOND for note in bound_notes(plant, bound)]


def not_simulated(plant: Plant) -> str:
    """Why a plant has no free runs; nothing where it has."""
    try:
        frictional(plant)
    except ValueError as error:
        return str(error)
    return ""


def window_of(task: Task, records: Sequence[Record]) -> float | None:
    """Length of short free runs [s]; None where the records are too short."""
    if task.window is not None:
        return task.window
    return window_length(records, 2 * INITIAL)


def free_runs(task: Task, plant: Plant) -> FreeRuns:
    """Whole and short ones, on the held-out records, or on those of the fit without any."""
    records = task.held or task.records
    return whole_and_windows(plant, records, window_of(task, records))
