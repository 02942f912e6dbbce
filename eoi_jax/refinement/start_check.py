"""Known starts that the records contradict: the fit beside one in which they are free."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.robust_covariance import correlation_time
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.free_starts import free_start_names, starts_text
from eoi_jax.models.known_starts import contradiction
from eoi_jax.models.plant import Plant
from eoi_jax.models.start_weights import starts_anywhere
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.spans import spans_of, starts_record
from eoi_jax.simulation.initial_state import owned


@dataclass(frozen=True)
class StartCheckSettings:
    """When the records contradict a known start."""

    chance: float = 1e-4  # of so much better a fit where the known starts are right


_SETTINGS = StartCheckSettings()


def with_start_check(
    result: Refinement, refit: Callable[[Plant, tuple[Record, ...]], Refinement]
) -> Refinement:
    """A refinement, with a note where it fits better than by chance with its known starts free.

    Known are those of outputs that the plant declares, and those of internal states; they stay. Of
    N residuals only N over their correlation time are independent: the likelihood ratio of these is
    χ² with as many degrees of freedom as there are known starts.

    Args:
        result: with a fit.
        refit: makes another one from a plant along records, in runs of the same length.
    """
    plant, records = result.plant, result.records
    begins, count = _beginnings(result), stated_starts(plant)
    if not count or not begins:
        return result
    continuing = tuple(record.continuing() for record in records)
    freed = refit(plant, continuing)
    if not freed.status.fits or freed.window != result.window:
        return result
    independent = min(independent_residuals(freed, j) for j in range(len(plant.outputs)))
    if (
        chance_of_ratio(independent * (result.cost - freed.cost), count * len(begins))
        >= _SETTINGS.chance
    ):
        return result
    # From a wrong start parameters may have gone where a free one does not bring them back.
    retry = refit(result.nominal, continuing)
    if retry.status.fits and retry.window == freed.window and retry.cost < freed.cost:
        freed = retry
    values = [(freed.starts[i].record, freed.starts[i].y[owned(plant)]) for i in begins]
    internal = [_internal(plant, freed.starts[i].z, result.starts[i].z) for i in begins]
    return replace(result, notes=(*result.notes, contradiction(plant, values, internal)))


def stated_starts(plant: Plant) -> int:
    """Number of starts that a plant states: of outputs, of their derivatives, of internal states.

    Args:
        plant: as it is declared.
    """
    return int(np.sum(np.isfinite(plant.known_start)) + np.sum(_declared(plant)))


def with_free_starts(result: Refinement) -> Refinement:
    """A refinement, with a note on the estimates of starts that the plant leaves open."""
    if not free_start_names(result.plant):
        return result
    begins = _beginnings(result)
    names = [result.starts[i].record for i in begins]
    text = starts_text(result.plant, names, [result.starts[i].z for i in begins])
    return replace(result, notes=(*result.notes, f"free starts of the records: {text}"))


def _beginnings(result: Refinement) -> list[int]:
    """Runs that begin with their record."""
    spans = spans_of(result.records, result.window)
    return [i for i, span in enumerate(spans) if starts_record(result.records, span)]


def _internal(plant: Plant, free: np.ndarray, declared: np.ndarray) -> list:
    """Name of each internal state whose start is declared, what fits it, what is declared."""
    states = zip(internal_names(plant), free, declared, strict=True)
    return [state for state, is_known in zip(states, _declared(plant), strict=True) if is_known]


def _declared(plant: Plant) -> np.ndarray:
    """Which internal states start as the plant declares, and could start elsewhere."""
    anywhere = starts_anywhere(plant.internal_initial, len(plant.open_internal))
    return plant.open_internal & ~anywhere


def independent_residuals(result: Refinement, output: int) -> float:
    """How many of the residuals of an output are as good as independent.

    Args:
        result: with its residuals.
        output: index.
    """
    errors = [part[np.isfinite(part[:, output]), output] for part in result.residual]
    lengths = [len(part) for part in errors if len(part) > 1]
    stacked = np.concatenate([part for part in errors if len(part) > 1])
    return len(stacked) / max(correlation_time(stacked[:, None], lengths), 1.0)


def chance_of_ratio(ratio: float, count: int) -> float:
    """Probability of a larger likelihood ratio, χ² of so many degrees of freedom.

    Args:
        ratio: twice its logarithm.
        count: degrees of freedom.
    """
    from scipy.special import chdtrc

    return float(chdtrc(count, max(ratio, 0.0))) if count else 1.0
