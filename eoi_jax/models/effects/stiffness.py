"""Forces that depend on the position of an output."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import (
    AbstractTerm,
    At,
    Grid,
    Parameter,
    Seen,
    mechanical,
    quantiles,
)
from eoi_jax.models.plant import Plant
from eoi_jax.models.units import same_unit

# At angles below this [rad] sin(y) is y - y³/6 to within one per cent: a spring.
_SMALL_ANGLE = 0.8


class LinearStiffness(AbstractTerm):
    """-k y: a spring."""

    name = "linear_stiffness"
    sentence = "a linear spring"
    joins = True
    gains = (Parameter("", "{f}/{y}"),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y


class QuadraticStiffness(AbstractTerm):
    """-k y²: a spring that differs between tension and compression."""

    name = "quadratic_stiffness"
    sentence = "a spring force with the square of the displacement (pull and push differ)"
    joins = True
    rarity = 1.0
    gains = (Parameter("", "{f}/({y})²"),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y**2


class CubicStiffness(AbstractTerm):
    """-k y³: a hardening (k > 0) or softening spring."""

    name = "cubic_stiffness"
    sentence = "cubic stiffness: a spring that hardens or softens with displacement"
    joins = True
    rarity = 1.0
    gains = (Parameter("", "{f}/({y})³"),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y**3


@dataclass(frozen=True)
class AbstractGravity(AbstractTerm):
    """A force that gravity has at an angle y.

    Attributes:
        degrees: whether y is in degrees: this form fits outputs with the unit "deg", "degree",
            "degrees" or "°", the form in radians all others.
    """

    rarity = 2.0  # at small angles it is a linear spring, or a constant offset
    gains = (Parameter("", "{f}"),)
    depends_on = "y"

    degrees: bool = False

    def fits(self, plant: Plant, output: int) -> bool:
        in_degrees = same_unit(plant.units.get(plant.outputs[output], ""), "deg")
        return mechanical(plant, output) and in_degrees == self.degrees

    def grid(self, seen: Seen) -> Grid:
        return np.zeros((1 if np.max(np.abs(self._angle(seen.y))) > _SMALL_ANGLE else 0, 0))

    def _angle(self, y: Any) -> Any:
        """The angle in radians."""
        return y * (np.pi / 180.0) if self.degrees else y


class Gravity(AbstractGravity):
    """-g sin(y), y an angle.

    Attributes:
        degrees: whether y is in degrees: this form fits outputs with the unit "deg", "degree",
            "degrees" or "°", the form in radians all others.
    """

    name = "gravity"
    sentence = "gravity: a force with the sine of the position"

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.sin(self._angle(at.y))


class GravityTilt(AbstractGravity):
    """c cos(y): gravity that pulls at the zero of the angle, too.

    Of a base that is tilted, or an angle sensor whose zero is not the vertical by δ: in place of
    g sin(y) gravity is g sin(y - δ), and c = g sin(δ).

    Attributes:
        degrees: as of `Gravity`.
    """

    name = "gravity_tilt"
    sentence = "gravity at the zero of the angle (a tilted base, or a sensor whose zero is off)"

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] * jnp.cos(self._angle(at.y))


class PositionRipple(AbstractTerm):
    """a sin(κ y) + b cos(κ y): cogging, a force periodic in the position."""

    name = "position_ripple"
    sentence = "a ripple over the position (cogging)"
    gains = (Parameter("sine", "{f}"), Parameter("cosine", "{f}"))
    shapes = (Parameter("wavenumber", "1/{y}", lower=0.0),)
    depends_on = "y"
    shortest: ClassVar[float] = 4.0 * np.pi  # two periods over the range: fewer look like a spring

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def grid(self, seen: Seen) -> Grid:
        # Neighbours on the grid differ by less than a radian at the ends of the range.
        phases = np.arange(self.shortest, 25.0 * 2.0 * np.pi, 1.6)
        # A ripple with a wavelength near the noise would be fitted to the noise.
        reach = np.ptp(seen.y) or 1.0
        resolved = phases * seen.noise < 0.3 * reach
        resolved[0] = True
        # Of many periods only wavenumbers that the residual shows, and their first harmonics.
        harmonics = np.outer(seen.wavenumbers, [1.0, 2.0]).ravel()
        fine = harmonics[harmonics * reach > phases[-1]]
        return np.concatenate([phases[resolved] / reach, fine])[:, None]

    def is_seen(self, values: Sequence[float], reach: float) -> bool:
        return values[-1] * reach > self.shortest - 0.8  # half a step of the grid

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        phase = shape[0] * at.y
        return gain[0] * jnp.sin(phase) + gain[1] * jnp.cos(phase)


@dataclass(frozen=True)
class EndStop(AbstractTerm):
    """-k (y - s) beyond s: contact on one side.

    Attributes:
        side: +1 for a stop above, -1 for one below.
    """

    name = "end_stop"
    sentence = "an end stop: contact on one side"
    joins = True
    depends_on = "y"

    side: int = 1

    @property
    def kind(self) -> str:
        """The side is part of the kind: a model may have a stop at each end."""
        return f"{self.name} {self.side:+d}"

    @property
    def form(self) -> str:
        """At which end of the range it is."""
        return "above" if self.side > 0 else "below"

    @property
    def gains(self) -> tuple[Parameter, ...]:
        """Stiffness."""
        return (Parameter(f"{self._end}stiffness", "{f}/{y}", lower=0.0),)

    @property
    def shapes(self) -> tuple[Parameter, ...]:
        """Position."""
        return (Parameter(f"{self._end}position", "{y}"),)

    @property
    def _end(self) -> str:
        """Prefix of the parameter names, which distinguishes a stop below from one above."""
        return "lower_" if self.side < 0 else ""

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def grid(self, seen: Seen) -> Grid:
        shares = np.array([0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.985, 0.995])
        return quantiles(seen.y, shares if self.side > 0 else 1.0 - shares)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * self.side * jnp.maximum(self.side * (at.y - shape[0]), 0.0)


class FreePlay(AbstractTerm):
    """k clip(y, -g, g): the declared spring does not act inside a gap.

    Together with a declared spring of stiffness k the total is -k times the dead zone of y.
    """

    name = "free_play"
    sentence = "a spring that acts beyond a gap only: free play, or stops at both ends"
    joins = True
    gains = (Parameter("stiffness", "{f}/{y}", lower=0.0),)
    shapes = (Parameter("gap", "{y}", lower=0.0),)
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output)

    def grid(self, seen: Seen) -> Grid:
        return np.geomspace(0.03, 0.9, 12)[:, None] * np.max(np.abs(seen.y))

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return gain[0] * jnp.clip(at.y, -shape[0], shape[0])
