"""Refinement in windows, of unstable plants, whose whole free runs say nothing.

Where whole runs are lost at the parameters from which a fit starts, and errors of the start grow in
them (`simulation/error_growth.py`), the fit takes runs over which these errors stay small. At its
estimate the question is asked again: errors may grow less there, or whole runs may be near enough
to be fitted, which uses more of the record.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.fit import rms
from eoi_jax.refinement.problem import Problem
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.error_growth import (
    RULES,
    ErrorGrowth,
    error_growth,
    is_lost,
    restarted,
    window_head,
)
from eoi_jax.simulation.validate import judged_runs
from eoi_jax.simulation.validation import Validation

# A refinement of the records of a result from a plant, in runs of a length [s], infinite for whole
# records.
Refine = Callable[[Refinement, Plant, float], Refinement]


def lost_growth(
    plant: Plant, records: Sequence[Record], rmse: Float[np.ndarray, " ny"], problem: Problem
) -> ErrorGrowth | None:
    """Growth of errors in whole runs that say nothing; None where they do, or errors do not grow.

    Args:
        plant: where the fit starts.
        records: of the fit.
        rmse: of the whole runs there.
        problem: these runs.
    """
    y, use = problem.y, problem.use
    deviation = np.where(use, y - np.sum(y, axis=(0, 1)) / np.sum(use, axis=(0, 1)), 0.0)
    if not is_lost(rmse, rms(deviation, use)):
        return None
    growth = error_growth(plant, records)
    return growth if growth.growing and growth.cuts(records) else None


def settled(result: Refinement, refit: Refine) -> Refinement:
    """The answer to a fit in windows that nobody asked for: asked again at its estimate.

    Args:
        result: the fit in windows.
        refit: another fit.

    Returns:
        The fit of whole runs where these are not lost at the estimate and windows do not contradict
        it, else that in windows, of another length where the estimate asks for it. A note says so.
    """
    if not result.status.ok or result.window is None:
        return result
    growth = error_growth(result.plant, result.records)
    full = _of_full_runs(result, refit, growth)
    if full is not None:
        return full
    if growth.growing and abs(np.log(growth.window / result.window)) > np.log1p(RULES.settled):
        other = refit(result, result.plant, growth.window)
        result = other if other.status.ok else result
    longer = _extended(result, refit)
    if growth.largest <= RULES.hopeless:
        while longer is not result:
            result, longer = longer, _extended(longer, refit)
        full = _of_full_runs(result, refit, growth)
        if full is not None:
            return full
    result = longer
    note = restarted(len(result.starts), growth, "Fitted", result.window)
    return replace(result, notes=(*result.notes, note))


def _extended(result: Refinement, refit: Refine) -> Refinement:
    """The fit in longer windows, where the model follows these as well."""
    longer = refit(result, result.plant, RULES.extension * (result.window or np.inf))
    if not longer.status.ok or longer.window is None:
        return result
    return longer if _follows(longer, result) else result


def _follows(longer: Refinement, shorter: Refinement) -> bool:
    """Whether the model follows longer runs as well as shorter ones."""
    with np.errstate(divide="ignore", invalid="ignore"):
        risen = np.log(_residual(longer) / _residual(shorter))
    return bool(np.all(risen <= np.log1p(RULES.risen)))


def _residual(result: Refinement) -> Float[np.ndarray, " ny"]:
    """Standard deviation of the residuals: what the starts of the runs have taken is made good."""
    plant = result.plant
    scored = np.sum([np.sum(np.isfinite(part)) for part in result.residual])
    unknowns = (sum(plant.degrees) + len(plant.initial_internal)) * len(result.starts)
    return result.rmse / np.sqrt(max(1.0 - unknowns / scored, np.finfo(float).eps))


def _of_full_runs(result: Refinement, refit: Refine, growth: ErrorGrowth) -> Refinement | None:
    """The fit of whole runs from an estimate in windows; None where it is none, or is worse."""
    records = result.records
    runs = judged_runs(result.plant, records)
    lost = is_lost(runs.nrmse, np.ones_like(runs.nrmse))
    if lost and growth.largest > RULES.hopeless:
        return None
    full = refit(result, result.plant, np.inf)
    if not full.status.ok or (lost and not _follows(full, result)):
        return None
    window = result.window or np.inf
    head = window_head(window, result.plant, records)
    old, new = (judged_runs(plant, records, head, window) for plant in (result.plant, full.plant))
    return None if worse(old, new) else full


def worse(before: Validation, after: Validation, negligible: float = 0.01) -> bool:
    """Whether free runs have become worse by more than `negligible`, geometric mean of the outputs.

    Args:
        before: errors of some runs.
        after: of the same runs by another model.
        negligible: relative change that noise explains.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        change = np.mean(np.log(after.rmse + 1e-300) - np.log(before.rmse + 1e-300))
    return not bool(change <= negligible)
