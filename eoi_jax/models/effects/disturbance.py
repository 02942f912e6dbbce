"""External disturbances, which do not depend on the plant."""

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import AbstractTerm, At, Grid, Parameter, Seen


class ConstantOffset(AbstractTerm):
    """A constant force, flow or bias of the drive."""

    name = "constant_offset"
    sentence = "a constant offset"
    gains = (Parameter("", "{f}"),)
    depends_on = "t"

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] + 0.0 * at.t


@dataclass(frozen=True)
class Drift(AbstractTerm):
    """a (t - t_0): a disturbance that grows with time.

    Its value at t_0 is part of it where the model has a constant; else it starts from zero. A
    search sets t_0 to the start of the records: far from t = 0, a t would be nearly constant.

    Attributes:
        start: t_0 [s].
    """

    name = "drift"
    sentence = "a drift, linear in time"
    gains = (Parameter("", "{f}/s"),)
    depends_on = "t"

    start: float = 0.0

    def since(self, start: float) -> "Drift":
        """The drift with this start, unless a start was already set."""
        return replace(self, start=start) if self.start == 0.0 else self

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] * (at.t - self.start)


class SinusoidalDisturbance(AbstractTerm):
    """a sin(ω t) + b cos(ω t)."""

    name = "sinusoidal_disturbance"
    sentence = "a sinusoidal disturbance of one frequency"
    gains = (Parameter("sine", "{f}"), Parameter("cosine", "{f}"))
    shapes = (Parameter("frequency", "rad/s", lower=0.0),)
    depends_on = "t"

    def grid(self, seen: Seen) -> Grid:
        # A full grid would need a spacing below 1/T, so only peaks of the residual are tried.
        step = 1.5 / seen.duration
        frequencies = seen.peaks[:, None] + step * np.array([-0.5, 0.0, 0.5])
        return np.maximum(frequencies.reshape(-1, 1), step)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        phase = shape[0] * at.t
        return gain[0] * jnp.sin(phase) + gain[1] * jnp.cos(phase)
