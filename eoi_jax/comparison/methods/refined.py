"""The iteration of the paper, then output error from its estimate."""

from collections.abc import Sequence

from eoi_jax.comparison.methods.comparator import AbstractComparator, Estimate
from eoi_jax.comparison.methods.output_error import refinement_answer
from eoi_jax.comparison.methods.plain import answer
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import identify
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine


class Refined(AbstractComparator):
    """`identify`, then `refine` from its estimate."""

    name = "refined"
    description = "the paper's passes, then output error from their estimate"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """`identify` for the start, then `refine`."""
        first = identify(plant, records, instruments=False)  # sufficient as a start
        if not first.status.ok:
            return answer(first)
        return refinement_answer(refine(first, records))
