"""Output error from the nominal values, as toolboxes fit a grey-box model."""

from collections.abc import Sequence

import numpy as np

from eoi_jax.comparison.methods.comparator import AbstractComparator, Estimate
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import Refinement, refine


class OutputError(AbstractComparator):
    """`refine` from the nominal parameters, as `tfest` and `nlgreyest` of MATLAB start.

    Source: L. Ljung, *System Identification*, 2nd ed., section 3.2.
    """

    name = "output_error"
    description = "output error (free runs fitted) straight from the nominal values"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """`refine` from the nominal parameters."""
        return refinement_answer(refine(plant, records, window=np.inf))  # whole records


def refinement_answer(result: Refinement) -> Estimate:
    """A refinement as a comparator's answer."""
    if not result.status.ok:
        return Estimate(None, None, result.status)
    return Estimate(result.parameters, result.standard_errors, result.status)
