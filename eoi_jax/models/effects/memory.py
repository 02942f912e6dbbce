"""Forces with memory."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import AbstractTerm, At, Grid, Parameter, Seen, mechanical
from eoi_jax.models.plant import Plant


class Hysteresis(AbstractTerm):
    r"""Bouc–Wen: -k z, δ dz/dt = v - β |v| z - (1 - β) v |z|.

    z runs between -1 and 1: a spring k/δ for small motion that yields at the force k. δ is the
    yield displacement, β the share of hysteresis in the loop's shape.

    Source: Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249, n = 1, with the state scaled to one.
    """

    name = "hysteresis"
    sentence = "hysteresis (Bouc–Wen): a spring that yields"
    gains = (Parameter("force", "{f}", lower=0.0),)
    shapes = (
        Parameter("displacement", "{y}", lower=0.0),
        Parameter("share", "1", lower=0.0, upper=1.5),
    )
    states = 1
    depends_on = "y"
    contains = ("coulomb_friction",)

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def grid(self, seen: Seen) -> Grid:
        reach = 0.5 * np.ptp(seen.y)
        sizes, shares = np.geomspace(0.03, 1.5, 7) * reach, np.array([0.4, 0.8])
        return np.stack(np.meshgrid(sizes, shares, indexing="ij"), axis=-1).reshape(-1, 2)

    def rate(self, at: At, shape: Any) -> Any:
        size, share = shape
        return (at.v - share * jnp.abs(at.v) * at.z - (1.0 - share) * at.v * jnp.abs(at.z)) / size

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.z[0]
