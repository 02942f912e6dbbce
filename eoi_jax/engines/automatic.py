"""The engine of a sweep that names none: compiled for the CPU where that can be, else the scan."""

from dataclasses import dataclass

from eoi_jax.engines.engine import AbstractEngine, Lanes
from eoi_jax.engines.native import Native
from eoi_jax.engines.one_kernel import OneKernel
from eoi_jax.engines.scan import Scan
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.passes import Steps, Sums
from eoi_jax.plants.plant import Plant
from eoi_jax.results import NATIVE, EngineUsed

_NAMES = {Native: NATIVE.name, Scan: "scan", OneKernel: "one_kernel"}


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
        reason = Native().supports(plant, lanes, lowpass, steps, store)
        engine = Native() if reason is None else Scan()
        return engine.run(plant, lanes, lowpass, steps, store)


def engine_used(
    engine: AbstractEngine, plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps
) -> EngineUsed:
    """Which engine a pass runs on, and why; arguments as of `AbstractEngine.run`."""
    if not isinstance(engine, Automatic):
        return EngineUsed(_NAMES.get(type(engine), type(engine).__name__))
    reason = Native().supports(plant, lanes, lowpass, steps)
    return NATIVE if reason is None else EngineUsed("scan", reason)
