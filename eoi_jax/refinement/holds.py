"""The hold of the inputs by free runs: that with the smallest error, of those that are tried."""

import numpy as np

from eoi_jax.data.holds import HoldChoice, chosen_hold, clearly_smaller, with_hold
from eoi_jax.data.input_holds import Hold
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.skew import Fit, mean_error, scored_samples


def compared_holds(
    plant: Plant, records: tuple[Record, ...], rule: Hold, fit: Fit, first: Refinement
) -> tuple[HoldChoice, dict[Hold, Refinement]]:
    """The hold that fits best, and the fits with each, from that with the hold of the rule.

    Args:
        plant: with the parameters at which all began.
        records: as they were read; those that declare their hold keep it.
        rule: the hold that the samples suggest.
        fit: refines a plant, from its parameters, on records.
        first: the refinement with the hold of the rule.
    """
    fits, count = {rule: first}, scored_samples(first)

    def error(hold: Hold) -> float:
        if hold not in fits:
            trial = with_hold(records, hold)
            fits[hold] = fit(first.plant, trial)
            if not fits[hold].status.fits:  # the estimate with a wrong hold may be worse
                fits[hold] = fit(plant, trial)
        return mean_error(fits[hold]) if fits[hold].status.fits else np.inf

    def better(error: float, reference: float) -> bool:
        return clearly_smaller(error**2, reference**2, count)

    return chosen_hold(error, rule, records, better), fits


def is_better(fit: Refinement, reference: Refinement) -> bool:
    """Whether the error of a fit is smaller than that of another one by enough to matter."""
    return clearly_smaller(mean_error(fit), mean_error(reference), np.inf)
