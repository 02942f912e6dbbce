"""Terms outside the library of effects, which discovery uses as alternatives to its answer."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from eoi_jax.models.effects.effect import AbstractTerm, At, Parameter


@dataclass(frozen=True)
class Product(AbstractTerm):
    """a v w: product of two of y, ẏ and u, as in a gain that changes with the position.

    Attributes:
        first, second: "y", "v" or "u".
    """

    first: str
    second: str

    name = "product"
    sentence = "a product of two signals"
    gains = (Parameter("", ""),)
    depends_on = "y"
    only_in_free_runs = True

    @property
    def kind(self) -> str:
        return f"{self.name} {self.first} {self.second}"

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] * getattr(at, self.first) * getattr(at, self.second)


@dataclass(frozen=True)
class ModulatedSinusoid(AbstractTerm):
    """(a sin(ω t) + b cos(ω t)) w with w = y, ẏ or u: a parameter that varies with time."""

    by: str

    name = "modulated_sinusoid"
    sentence = "a sinusoid whose amplitude follows the plant"
    gains = (Parameter("sine", ""), Parameter("cosine", ""))
    shapes = (Parameter("frequency", "rad/s", lower=0.0),)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        phase = shape[0] * at.t
        return (gain[0] * jnp.sin(phase) + gain[1] * jnp.cos(phase)) * getattr(at, self.by)
