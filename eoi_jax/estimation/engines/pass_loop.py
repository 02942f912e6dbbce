"""The pass over a record as a loop that can be compiled for many lanes."""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import numpy as np

from eoi_jax.compiler.loop import AbstractLoop
from eoi_jax.estimation.engines.engine import Lanes
from eoi_jax.estimation.kernel import Carry, Step
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant


@dataclass(frozen=True, eq=False)
class Pass(AbstractLoop):
    """What is traced: trees whose numbers are given by shape and type only (`shapes_of`).

    Two of them are equal if one program serves both.

    Attributes:
        plant, lowpass: as the pass uses them.
        lane: one lane; its emphasis is that of `step`.
        step: one step of the record.
        store: as in `run_pass`.
        dtype: of all numbers.
        z_start: of `Steps`.
    """

    plant: Plant
    lane: Lanes
    lowpass: DiscreteFilter
    step: Step
    store: str
    dtype: np.dtype
    z_start: Any = None
    flags: ClassVar[tuple[str, ...]] = ("restart", "block_end")

    @property
    def fixed(self) -> tuple:
        """What all lanes and steps share: plant, F, h, and `Steps.begin`."""
        scalar = jax.ShapeDtypeStruct((), self.dtype)
        return self.plant, self.lowpass, scalar, self.step.y, self.step.y_next, self.z_start

    @property
    def by_block(self) -> bool:
        """Whether each lane has an emphasis."""
        return self.step.emphasis is not None

    def begin(self, lane: Lanes, fixed: tuple) -> Carry:
        """Before the first step."""
        plant, lowpass, h, y, y_next, z_start = fixed
        return lane.kernel(plant, lowpass, self.store).init(y, y_next, h, z_start)

    def advance(self, lane: Lanes, fixed: tuple, carry: Carry, row: Step) -> tuple[Carry, Any]:
        """One step, and the signals of a trace where the pass stores them."""
        plant, lowpass, h, *_ = fixed
        return lane.kernel(plant, lowpass, self.store).step(carry, row, h)

    def result(self, carry: Carry) -> Any:
        """What is wanted after the last step."""
        return carry.sums
