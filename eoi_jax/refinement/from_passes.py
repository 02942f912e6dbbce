"""Refinement of what passes estimate, and of the nominal values where these may lead further.

Passes do not simulate. Where they did not come to an end, hold a parameter that ran off in them, or
end where the free runs of their own records are worse than with the nominal values, a fit of free
runs from their estimate may end in a minimum that the one from the nominal values does not meet.
"""

from collections.abc import Callable
from dataclasses import replace

from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.runaway import is_as_good
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.windowed import worse
from eoi_jax.simulation.validate import validated_alike

# Statuses of passes that came to an end.
_ENDED = ("converged", "undersampled")
_UNENDED = "refined from the {}: the passes ended as {}"
_REFUTED = (
    "refined from the {}: free runs of the estimate of the passes are worse than those of the "
    "nominal values"
)
_FREED = (
    "refined from the nominal values, with {} free: the fit is better than where the passes hold it"
)
_HELD = (
    "{} stays at {:.3g}, where the passes hold it: free, from the nominal values, it fits no better"
)


def refined_from(
    start: Identification, fit: Callable[[Plant], Refinement], in_loop: bool
) -> Refinement:
    """The better refinement of the two where both are asked for, with a note on which it is.

    Args:
        start: estimate of passes.
        fit: refinement of a plant.
        in_loop: whether a controller drives the runs: the plant alone is not simulated.
    """
    runaways = [name for name in start.plant.fixed if name not in start.nominal.fixed]
    ended = start.status.code in _ENDED
    refuted = ended and not runaways and not in_loop and is_refuted(start)
    begin = {"estimate of the passes": start.plant} if start.status.fits else {}
    if not ended or runaways or refuted:
        begin["nominal values"] = start.nominal
    fits = {name: fit(plant) for name, plant in begin.items()}
    name, result = min(fits.items(), key=lambda item: (not item[1].status.ok, item[1].cost))
    first = fits.get("estimate of the passes")
    if runaways and first is not None and first.status.ok and is_as_good(first.cost, result.cost):
        name, result = "estimate of the passes", first
    notes = []
    if not ended:
        notes.append(_UNENDED.format(name, start.status.code))
    elif runaways and result is not first:
        notes.append(_FREED.format(" and ".join(runaways)))
    elif refuted:
        notes.append(_REFUTED.format(name))
    if runaways and result is first:
        notes += [_HELD.format(key, start.parameters[key]) for key in runaways]
    return replace(result, notes=(*result.notes, *notes)) if notes else result


def is_refuted(start: Identification) -> bool:
    """Whether an estimate of the passes simulates its own records worse than the nominal values.

    Noise that hides the motion, or a pole of the equations between the two, leads passes astray.
    """
    nominal_runs, runs = validated_alike((start.nominal, start.plant), start.records)
    return worse(nominal_runs, runs)
