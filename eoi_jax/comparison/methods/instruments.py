"""The iteration of the paper, then instrumental variables."""

from collections.abc import Sequence

from eoi_jax.comparison.methods.comparator import AbstractComparator, Estimate
from eoi_jax.comparison.methods.plain import answer
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import identify
from eoi_jax.models.plant import Plant


class Instruments(AbstractComparator):
    """`identify` with instrumental variables, whatever the noise."""

    name = "instruments"
    description = "the paper's passes, then instrumental variables of a simulated record"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Observer and filter by default."""
        return answer(identify(plant, records, instruments=True))
