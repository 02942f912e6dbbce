"""Known starts that the records contradict: the fit beside one in which they are free."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.estimation.regression.robust_covariance import correlation_time
from eoi_jax.models.known_starts import contradiction
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.initial_state import owned


@dataclass(frozen=True)
class StartCheckSettings:
    """When the records contradict a known start."""

    chance: float = 1e-4  # of so much better a fit where the known starts are right


_SETTINGS = StartCheckSettings()


def with_start_check(result: Refinement, refit: Callable[[Plant], Refinement]) -> Refinement:
    """A refinement, with a note where it fits better than by chance with its known starts free.

    The known starts stay. Of N residuals only N over their correlation time are independent: the
    likelihood ratio of these is χ² with as many degrees of freedom as there are known starts.

    Args:
        result: with a fit.
        refit: makes another one from a plant, on the same runs.
    """
    plant = result.plant
    is_known = np.isfinite(plant.known_start)
    if not plant.start_items or not result.starts:
        return result
    freed = refit(plant.declared_anew(initial={}))
    if not freed.status.fits:
        return result
    declared = plant.known_start[is_known]  # exactly where runs start that begin with their record
    begins = [i for i, start in enumerate(result.starts)
              if np.array_equal(start.y[is_known], declared)]  # fmt: skip
    independent = min(_independent(freed, j) for j in range(len(plant.outputs)))
    entries = int(np.sum(is_known)) * len(begins)
    if _chance(independent * (result.cost - freed.cost), entries) >= _SETTINGS.chance:
        return result
    values = [(freed.starts[i].record, freed.starts[i].y[owned(plant)]) for i in begins]
    return replace(result, notes=(*result.notes, contradiction(plant, values)))


def _independent(result: Refinement, output: int) -> float:
    """How many of the residuals of an output are as good as independent."""
    errors = [part[np.isfinite(part[:, output]), output] for part in result.residual]
    lengths = [len(part) for part in errors if len(part) > 1]
    stacked = np.concatenate([part for part in errors if len(part) > 1])
    return len(stacked) / max(correlation_time(stacked[:, None], lengths), 1.0)


def _chance(ratio: float, count: int) -> float:
    """Probability of a larger likelihood ratio, χ² of so many degrees of freedom."""
    from scipy.special import chdtrc

    return float(chdtrc(count, max(ratio, 0.0))) if count else 1.0
