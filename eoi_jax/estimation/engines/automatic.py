"""The engine of a sweep that names none: compiled for the CPU where that can be, else the scan."""

from dataclasses import dataclass

from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.estimation.engines.engine import AbstractEngine, Lanes
from eoi_jax.estimation.engines.native import Native
from eoi_jax.estimation.engines.pallas import OneKernel
from eoi_jax.estimation.engines.scan import Scan
from eoi_jax.estimation.kernel import Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant

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
