r"""A discovered model refined by output error, with what only its free run shows.

The injection weighs what is missing by its force, the free run by its consequences: a small force
that always pushes one way is next to nothing in the one, and most of the error in the other. So:

1. `refine` the model on the records of the fit.
2. `remaining`: the most significant effect of those that the free run lacks, or two; add it, refine
   again; as long as there is one and held-out free runs, whole and in windows, get better by it.
3. `refine` what was kept over short runs: what a model still lacks adds up over a long one and
   bends its parameters, and a long run that loses its phase tells nothing.

What is kept is the model with the lowest of these errors. The first refinement, which adds nothing,
must only not be worse than what was discovered: at the noise both are equal, and it is the better
estimate. What is added, and short runs in place of whole ones, must be worth more than a hundredth
of these errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.remaining import remaining
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.validate import FreeRuns, whole_and_windows

_MOST = 3  # times that something is added, at most
_SAME = 0.01  # relative change of an error that is none


@dataclass(frozen=True)
class Polished:
    """The model that was kept.

    Attributes:
        refinement: of it.
        placed: what was added on the way, in this order.
        runs: on the held-out records.
    """

    refinement: Refinement
    placed: tuple[Placed, ...]
    runs: FreeRuns


def polished(
    plant: Plant,
    records: Sequence[Record],
    held: Sequence[Record],
    before: FreeRuns,
    window: float | None,
    effects: Sequence[AbstractEffect] | None = None,
) -> Polished | str:
    """Refine a model, and add what its free run lacks.

    Args:
        plant: with the estimate of the passes.
        records: to fit to.
        held: to judge on.
        before: free runs of `plant` on these.
        window: of re-initialised free runs [s]; None where records are too short for them.
        effects: to try; those of `remaining` by default.

    Returns:
        The model that was kept, or why there is none.
    """
    whole = _over_whole_runs(plant, records, held, before, window, effects)
    if window is None:
        return whole
    start, runs, placed, most = plant, before, (), _SAME
    if isinstance(whole, Polished):
        start, runs, placed, most = whole.refinement.plant, whole.runs, whole.placed, -_SAME
    one = refine(start, records, window=window)
    short = Polished(one, placed, whole_and_windows(one.plant, held, window))
    return short if one.status.ok and _better(runs, short.runs, most) else whole


def _over_whole_runs(
    plant: Plant,
    records: Sequence[Record],
    held: Sequence[Record],
    before: FreeRuns,
    window: float | None,
    effects: Sequence[AbstractEffect] | None,
) -> Polished | str:
    kept: Polished | None = None
    placed: tuple[Placed, ...] = ()
    for turn in range(1 + _MOST):
        one = refine(plant, records)
        if not one.status.ok:
            return kept or f"not refined: {one.status}"
        runs = whole_and_windows(one.plant, held, window)
        if _better(before if kept is None else kept.runs, runs, -_SAME if placed else _SAME):
            kept = Polished(one, placed, runs)
        elif placed:  # held-out records refuse it
            break
        if turn == _MOST or plant.actuator is not None:  # `remaining` knows no actuators
            break
        left = remaining(one, effects).best
        if left is None:
            break
        plant, placed = augmented(one.plant, left.placed, left.values), (*placed, *left.placed)
    return kept or "not refined: that makes free runs worse on the records that judge"


def _better(before: FreeRuns, after: FreeRuns, most: float) -> bool:
    """Whether the errors of all free runs, whole and in windows, change by less than `most`.

    In their logarithms, of several outputs the mean.
    """
    pairs = [(old, new) for old, new in zip(before, after, strict=True) if old and new]
    return all(
        float(np.mean(np.log(np.maximum(new.rmse, 1e-300) / np.maximum(old.rmse, 1e-300)))) < most
        for old, new in pairs
    )
