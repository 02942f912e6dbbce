"""Flows out of a tank whose level is the output."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.effects.effect import AbstractTerm, At, Grid, Parameter, Seen, quantiles
from eoi_jax.plants.plant import Plant


class Leak(AbstractTerm):
    """-k y: an outflow proportional to the level."""

    name = "leak"
    sentence = "a leak: an outflow proportional to the level"
    gains = (Parameter("", "1/s", lower=0.0),)
    depends_on = "y"
    form = ("- {0}·{y}", r"- {0}\,{y}")

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y


class Overflow(AbstractTerm):
    """-k (y - L) above the level L."""

    name = "overflow"
    sentence = "an overflow: an outflow above a level"
    gains = (Parameter("rate", "1/s", lower=0.0),)
    shapes = (Parameter("level", "{y}"),)
    depends_on = "y"
    form = ("- {0}·max({y} - {1}, 0)", r"- {0}\max({y} - {1}, 0)")

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1

    def grid(self, seen: Seen) -> Grid:
        shares = [0.2, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.985]
        return quantiles(seen.y, np.array(shares).tolist())

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.maximum(at.y - shape[0], 0.0)
