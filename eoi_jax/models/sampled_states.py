"""Internal states that change at samples only, as a digital controller does.

They are the last states of `Plant.internal`, with a clock behind them: the time until the next
sample, which falls by one second a second and is set to the sample period at each. So a simulation
of any number of steps a sample needs no mark of its rows, and every engine runs it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax._types import Scalar


@dataclass(frozen=True)
class SampledStates:
    """The rule of internal states that change at samples only.

    Every run starts at a sample, with all of these states at zero, the clock too: they are no
    unknowns of it.

    Attributes:
        update: ``(t, x, u, p)`` → the states after the sample, shape (count,).
        count: number of these states, without the clock.
        period: time between samples [s].
    """

    update: Callable[[Any, Any, Any, Any], Any]
    count: int
    period: float

    @property
    def size(self) -> int:
        """Number of internal states that it takes: those, and the clock."""
        return self.count + 1

    def after(
        self, t: Scalar, x: Any, u: Float[Array, " nu"], p: Any, step: Scalar
    ) -> Float[Array, " nz"]:
        """Internal states from the start of a step on: new ones, if it starts at a sample.

        Args:
            t: start of the step [s].
            x: state there, before the sample.
            u: inputs there.
            p: parameters by name.
            step: length of the step [s].
        """
        first = x.z.shape[0] - self.size
        due = x.z[-1] < 0.5 * step
        values = jnp.reshape(jnp.asarray(self.update(t, x, u, p)), (self.count,))
        states = jnp.where(due, values, x.z[first:-1])
        clock = jnp.where(due, jnp.asarray(self.period, x.z.dtype), x.z[-1])
        return jnp.concatenate([x.z[:first], states, clock[None]])
