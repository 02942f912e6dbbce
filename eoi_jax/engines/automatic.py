"""The engine of a sweep that names none: compiled for the CPU where that can be, else the scan."""

from dataclasses import dataclass

from eoi_jax.engines.engine import AbstractEngine, Lanes
from eoi_jax.engines.native import Native
from eoi_jax.engines.scalars import Untranslatable
from eoi_jax.engines.scan import Scan
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.passes import Steps, Sums
from eoi_jax.plants.plant import Plant


@dataclass(frozen=True)
class Automatic(AbstractEngine):
    """`Native`, and `Scan` for what it cannot translate."""

    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane by the faster engine that can."""
        try:
            return Native().run(plant, lanes, lowpass, steps, store)
        except Untranslatable:
            return Scan().run(plant, lanes, lowpass, steps, store)
