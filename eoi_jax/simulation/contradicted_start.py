"""A known start that the first samples of a free run contradict."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.models.known_starts import contradiction
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.initial_state import Run, Starts, initial_states, owned, states_of
from eoi_jax.simulation.integrator import Drive


@dataclass(frozen=True)
class ContradictionSettings:
    """When the first samples contradict a known start."""

    chance: float = 1e-4  # of so much smaller errors where the known start is right
    rounding: float = 1e-9  # errors, over the size of an output, that are none


_SETTINGS = ContradictionSettings()


def contradicted_start(
    run: Run,
    heads: Drive,
    y: Float[np.ndarray, "runs time ny"],
    valid: Bool[np.ndarray, "runs time ny"],
    noise: Float[np.ndarray, "runs ny"],
    values: Starts | None,
    begins: Bool[np.ndarray, " runs"],
    name: str,
) -> list[str]:
    """A note where the first samples fit better than by chance from another start.

    The likelihood ratio of independent samples is χ² with as many degrees of freedom as there are
    known values; of errors with the correlation ρ between neighbours (1 - ρ)/(1 + ρ) are
    independent (M. S. Bartlett, J. R. Stat. Soc. 98 (1935) 536).

    Args:
        run: what all runs share.
        heads: what drives the first samples of each run.
        y: outputs there.
        valid: which of them were measured.
        noise: standard deviation of the noise of their sensors.
        values: unknowns of each run, the known ones as declared; None: to be fitted here.
        begins: which run begins with its record.
        name: of the record.
    """
    if not run.plant.start_items or not np.any(begins):
        return []
    from scipy.special import chdtrc

    i = int(np.argmax(begins))
    free = initial_states(run, heads, y, valid, noise)
    if values is None:
        values = initial_states(run, heads, y, valid, noise, begins=begins)
    with np.errstate(all="ignore"):  # of a run that diverges
        declared_error, free_error = (
            np.where(valid[i], y[i] - outputs_of(run.plant, heads, states_of(run, starts),
                                                 run.friction)[i], 0.0)
            for starts in (values, free)
        )  # fmt: skip
        floor = (_SETTINGS.rounding * np.max(np.abs(y[i]), axis=0)) ** 2 * len(free_error)
        squares = [np.maximum(np.sum(error**2, axis=0), np.maximum(floor, 1e-300))
                   for error in (declared_error, free_error)]  # fmt: skip
        ratio = np.log(squares[0] / squares[1])
        neighbours = np.sum(free_error[1:] * free_error[:-1], axis=0) / squares[1]
    correlation = np.clip(neighbours, 0.0, 0.99)
    independent = np.sum(valid[i], axis=0) * (1.0 - correlation) / (1.0 + correlation)
    count = int(np.sum(np.isfinite(run.plant.known_start)))
    likelihood = float(np.sum(independent * ratio))
    if not chdtrc(count, max(likelihood, 0.0)) < _SETTINGS.chance:
        return []
    return [contradiction(run.plant, [(name, free[i, : len(owned(run.plant)[0])])])]
