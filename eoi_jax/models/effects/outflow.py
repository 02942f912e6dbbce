"""What flows out of a store whose level, temperature or charge is the output, or not measured."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import (
    AbstractInternalEffect,
    AbstractTerm,
    At,
    Grid,
    Parameter,
    Seen,
    quantiles,
)
from eoi_jax.models.effects.friction import CoulombFriction
from eoi_jax.models.plant import Plant

_CELSIUS = ("°C", "degC", "C")
_ZERO_CELSIUS = 273.15  # K


def _levels(
    seen: Seen,
    shares: tuple[float, ...] = (0.2, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.985),
) -> Grid:
    """Levels below which these shares of the samples lie: close together where tanks overflow."""
    return quantiles(seen.y, shares)


class Leak(AbstractTerm):
    """-k y: an outflow proportional to the level."""

    name = "leak"
    sentence = "a leak: an outflow proportional to the level"
    gains = (Parameter("", "{f/y}", lower=0.0),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1

    def shows(self, seen: Seen) -> bool:
        if seen.kind == "speed":
            return False  # it is viscous friction, whatever the signs
        return not seen.measured or seen.keeps_sign

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y


class Overflow(AbstractTerm):
    """-k (y - L) above the level L."""

    name = "overflow"
    sentence = "an overflow: an outflow above a level"
    gains = (Parameter("rate", "{f/y}", lower=0.0),)
    shapes = (Parameter("level", "{y}"),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[output] == 1

    def shows(self, seen: Seen) -> bool:
        return seen.is_level

    def grid(self, seen: Seen) -> Grid:
        return _levels(seen)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.maximum(at.y - shape[0], 0.0)


@dataclass(frozen=True)
class Radiation(AbstractTerm):
    """-k ((T/100)⁴ - (T0/100)⁴), T and T0 absolute: what a hot body radiates to its surroundings.

    Attributes:
        celsius: whether y is in degrees Celsius: this form fits outputs with the unit "°C", "degC"
            or "C", the other one those with the unit "K".

    Source:
        Stefan-Boltzmann law; the hundredth of the temperature is usual in engineering.
    """

    name = "radiation"
    sentence = "radiation of heat, with the fourth power of the temperature"
    gains = (Parameter("coefficient", "{f}", lower=0.0),)
    shapes = (Parameter("ambient", "{y}"),)
    depends_on = "y"
    only_in_free_runs = True

    celsius: bool = False

    def fits(self, plant: Plant, output: int) -> bool:
        unit = plant.units.get(plant.outputs[output])
        return plant.degrees[output] == 1 and unit in (_CELSIUS if self.celsius else ("K",))

    def grid(self, seen: Seen) -> Grid:
        # A model that lacks it starts anywhere.
        y = seen.measured_y if len(seen.measured_y) else seen.y
        return quantiles(y, (0.0, 0.1, 0.3, 0.6))

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        zero = _ZERO_CELSIUS if self.celsius else 0.0
        return -gain[0] * (((at.y + zero) / 100.0) ** 4 - ((shape[0] + zero) / 100.0) ** 4)


class PowerLoss(AbstractTerm):
    """-k |y|^n sign(y): a loss that grows with a power of the output.

    Convection of a hot body, recombination of charges, an outlet of a tank, creep of what is under
    stress (Norton's law). A current is no store that empties so.
    """

    name = "power_loss"
    sentence = "a loss that grows with a power of the output"
    gains = (Parameter("coefficient", "", lower=0.0),)
    shapes = (Parameter("exponent", "1", lower=0.1),)
    depends_on = "y"
    only_in_free_runs = True
    record_needs = "an output of one sign, apart from noise"

    def fits(self, plant: Plant, output: int) -> bool:
        kind = plant.kinds[plant.outputs[output]]
        return plant.degrees[output] == 1 and kind != "current"

    def shows(self, seen: Seen) -> bool:
        return seen.keeps_sign

    def limit(self, kind: str = "") -> CoulombFriction | None:
        """Of a speed dry friction, where the exponent goes to zero."""
        return CoulombFriction() if kind == "speed" else None

    def grid(self, seen: Seen) -> Grid:
        return np.array([[0.5], [1.5], [2.0], [2.5], [3.0], [4.0]])

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        size = jnp.maximum(jnp.abs(at.y), np.finfo(float).tiny)  # has a slope in n at zero
        return -gain[0] * size ** shape[0] * jnp.sign(at.y)


class SaturatingLoss(AbstractTerm):
    """-k y/(h + |y|): a loss that saturates, half of its largest value at |y| = h.

    An uptake by an enzyme or by cells, elimination of a drug, adsorption on a surface. Small
    outputs are lost in proportion, large ones at the rate k.

    Source:
        L. Michaelis, M. L. Menten, Die Kinetik der Invertinwirkung, Biochemische Zeitschrift 49,
        1913; of growth: J. Monod, Annual Review of Microbiology 3, 1949.
    """

    name = "saturating_loss"
    sentence = "a loss that saturates (Michaelis-Menten kinetics)"
    gains = (Parameter("rate", "{f}", lower=0.0),)
    shapes = (Parameter("half", "{y}", lower=0.0),)
    depends_on = "y"
    only_in_free_runs = True
    record_needs = "an output of one sign, apart from noise"

    def fits(self, plant: Plant, output: int) -> bool:
        """Of an amount of something: where the kind is known, a concentration or a flow."""
        kind = plant.kinds[plant.outputs[output]]
        return plant.degrees[output] == 1 and kind in ("", "concentration", "flow")

    def shows(self, seen: Seen) -> bool:
        return seen.keeps_sign  # of both signs it is friction

    def grid(self, seen: Seen) -> Grid:
        return np.nanmedian(np.abs(seen.y)) * np.array([[0.1], [0.3], [1.0], [3.0]])

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y / (shape[0] + jnp.abs(at.y))


@dataclass(frozen=True)
class InternalOverflow(AbstractInternalEffect):
    """An overflow of a tank whose level z is not measured: dz/dt loses k max(z - L, 0).

    A share of the overflow may enter the tank whose level is the first output, which gains
    s k max(z - L, 0). z has its own unit, so s is in output per z and may exceed one. A brim is a
    hard stop: a large k keeps z at L. Source: the two tanks of M. Schoukens, P. Mattsson,
    T. Wigren, J.-P. Noël, *Cascaded tanks benchmark combining soft and hard nonlinearities*, 2016.

    Attributes:
        caught: whether the first output receives a share; otherwise the overflow is lost.
    """

    name = "overflow"
    sentence = "an overflow: an outflow above a level"
    shapes = (Parameter("rate", "1/s", lower=0.0), Parameter("level", "{y}"))
    depends_on = "y"

    caught: bool = True

    @property
    def form(self) -> str:
        """What becomes of it."""
        return "caught" if self.caught else "lost"

    @property
    def gains(self) -> tuple[Parameter, ...]:
        """The share that enters the first output."""
        return (Parameter("share", "1", lower=0.0),) if self.caught else ()

    def fits(self, plant: Plant, output: int) -> bool:
        return plant.degrees[0] == 1

    def grid(self, seen: Seen) -> Grid:
        rates = seen.band * np.array([0.6, 2.0, 7.0])
        levels = _levels(seen)[:, 0]
        return np.stack([np.repeat(rates, len(levels)), np.tile(levels, len(rates))], axis=1)

    def change(self, at: At, shape: Any) -> Any:
        return -shape[0] * jnp.maximum(at.y - shape[1], 0.0)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * self.change(at, shape) if self.caught else 0.0
