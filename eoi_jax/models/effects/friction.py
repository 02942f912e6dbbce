"""Friction and drag: forces against the velocity of an output."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.models.effects.effect import (
    AbstractInternalEffect,
    AbstractTerm,
    At,
    Grid,
    Parameter,
    Seen,
    mechanical,
    turns,
)
from eoi_jax.models.plant import Plant, State


class AbstractFriction(AbstractTerm):
    """A function of the velocity.

    Of a speed that never reverses, dry friction is a constant, which is another effect; unless it
    comes to rest and sticks, which free runs tell from a constant: the sign of a measured speed
    at rest is that of its noise.
    """

    depends_on = "v"
    reverses: ClassVar[bool] = False
    sticks: ClassVar[bool] = False

    def shows(self, seen: Seen) -> bool:
        distinct = turns(seen.v) or not (self.reverses and seen.measured)
        return seen.is_speed and (distinct or (self.sticks and seen.rests))


class ViscousFriction(AbstractFriction):
    """-c v: linear damping."""

    name = "viscous_friction"
    sentence = "viscous friction, proportional to the velocity"
    joins = True
    gains = (Parameter("", "{f/v}", lower=0.0),)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.v


class CoulombFriction(AbstractFriction):
    """-c sign(v): dry friction of one level."""

    name = "coulomb_friction"
    sentence = "Coulomb (dry) friction"
    gains = (Parameter("", "{f}", lower=0.0),)
    reverses = True
    sticks = True

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.sign(at.v)


class AsymmetricFriction(AbstractFriction):
    """-c₊ for v > 0, +c₋ for v < 0: dry friction whose level depends on the direction.

    While the plant moves it cannot be distinguished from Coulomb friction of the mean level plus a
    constant offset of half the difference: the two are the same function of v.
    """

    name = "asymmetric_friction"
    sentence = "dry friction that differs between the two directions"
    gains = (Parameter("forward", "{f}", lower=0.0), Parameter("backward", "{f}", lower=0.0))
    contains = ("coulomb_friction", "constant_offset")
    reverses = True

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        forward, backward = jnp.where(at.v > 0, 1.0, 0.0), jnp.where(at.v < 0, 1.0, 0.0)
        return -gain[0] * forward + gain[1] * backward


class StribeckFriction(AbstractFriction):
    """-(F_c + F_d exp(-(v/v_s)²)) sign(v): dry friction that decreases as the velocity grows."""

    name = "stribeck_friction"
    sentence = "Stribeck friction: dry friction that is higher near rest"
    gains = (Parameter("level", "{f}", lower=0.0), Parameter("rise", "{f}", lower=0.0))
    shapes = (Parameter("velocity", "{v}", lower=0.0),)
    sticks = True
    contains = ("coulomb_friction",)

    def grid(self, seen: Seen) -> Grid:
        return np.geomspace(0.03, 1.0, 8)[:, None] * _rms(seen.v)

    def beyond(self, gains: Sequence[float] | np.ndarray) -> float:
        level, rise = gains
        return float(rise / max(level, 1e-300))

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        rise = jnp.exp(-((at.v / shape[0]) ** 2))
        return -(gain[0] + gain[1] * rise) * jnp.sign(at.v)


class QuadraticDrag(AbstractFriction):
    """-c v|v|: turbulent drag."""

    name = "quadratic_drag"
    sentence = "drag that grows with the square of the velocity"
    joins = True
    gains = (Parameter("", "{f}/({v})²", lower=0.0),)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.v * jnp.abs(at.v)


class CubicDamping(AbstractFriction):
    """-c v³."""

    name = "cubic_damping"
    sentence = "damping that grows with the cube of the velocity"
    joins = True
    rarity = 1.0
    gains = (Parameter("", "{f}/({v})³", lower=0.0),)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.v**3


class DisplacementDamping(AbstractFriction):
    """-c y² v: the nonlinear damping of van der Pol's oscillator."""

    name = "displacement_damping"
    sentence = "damping that grows with the square of the displacement"
    rarity = 2.0  # in other than mechanics it is a mere product
    gains = (Parameter("", "{f/v}/({y})²"),)
    depends_on = "y"
    only_in_free_runs = True

    def fits(self, plant: Plant, output: int) -> bool:
        kind = plant.kinds[plant.outputs[output]]
        return mechanical(plant, output) and kind in ("", "position")

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.y**2 * at.v


class InputDamping(AbstractFriction):
    """-c |u| v: a motor whose driver is open between its pulses.

    A bridge of duty u puts the supply V and the back-EMF K v on the winding for the share |u| of
    the time, and nothing else: in the mean (K V u - K² |u| v)/R. Of an input that keeps its sign it
    is the product of u and v, as of a stream that carries heat.
    """

    name = "input_damping"
    sentence = "damping in proportion to the size of the input (as of a driver open between pulses)"
    rarity = 1.0
    gains = (Parameter("", "{f/v}/({u})", lower=0.0),)
    only_in_free_runs = True

    def shows(self, seen: Seen) -> bool:
        return super().shows(seen) and turns(seen.u)

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.abs(at.u) * at.v


class LoadFriction(AbstractFriction):
    """-c |u| sign(v): dry friction of what carries the load that the input is.

    Gears, worms and screws, bearings, a brake: friction is in proportion to the force that they
    pass on.
    """

    name = "load_friction"
    sentence = "dry friction in proportion to the size of the input (of a gear under load)"
    rarity = 1.0
    gains = (Parameter("", "{f}/({u})", lower=0.0),)
    reverses = True
    sticks = True
    only_in_free_runs = True

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.abs(at.u) * jnp.sign(at.v)


class RateFriction(AbstractFriction):
    """-c d/dt tanh(y/w), y a speed: dry friction of a swing that a gyroscope or geophone shows.

    Where the output of degree two is a speed, its model is the law of motion differentiated. Dry
    friction -c sign(y) of that law is a jump of y' by 2 c at each turn of the motion, here over the
    width w: no record tells how narrow it is, and steps of a simulation must resolve it. A function
    of sign(y') would be friction against the acceleration.
    """

    name = "rate_friction"
    sentence = "dry friction of a motion of which the output is the speed"
    gains = (Parameter("level", "{v}", lower=0.0),)
    shapes = (Parameter("width", "{y}", lower=0.0, reach=1.5),)
    depends_on = "y"
    only_in_free_runs = True
    needs = "a speed of relative degree two"

    def fits(self, plant: Plant, output: int) -> bool:
        return mechanical(plant, output) and plant.kinds[plant.outputs[output]] == "speed"

    def shows(self, seen: Seen) -> bool:
        return turns(seen.y)

    def grid(self, seen: Seen) -> Grid:
        # A small part of the swing, and what it passes in a sample.
        return np.array([[max(0.1 * _rms(seen.y), _rms(seen.v) * seen.sample_period)]])

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * at.v / shape[0] * (1.0 - jnp.tanh(at.y / shape[0]) ** 2)


class AsymmetricViscousFriction(AbstractFriction):
    """-c|v|: viscous friction that differs between the two directions.

    Together with a viscous friction b the slope is b + c forwards and b - c backwards.
    """

    name = "asymmetric_friction"
    sentence = "viscous friction that differs between the two directions"
    joins = True
    gains = (Parameter("slope", "{f/v}"),)
    reverses = True

    @property
    def form(self) -> str:
        """Not that of dry friction."""
        return "viscous"

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        return -gain[0] * jnp.abs(at.v)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(values**2)))


class InternalFriction(AbstractInternalEffect):
    """-F tanh(z/w) in dz/dt: dry friction of a part whose speed z is not measured.

    Of the load behind an elastic shaft, the far end of a string. Nothing sticks that is not
    measured: below w the friction is viscous, and the part creeps.
    """

    name = "internal_friction"
    sentence = "dry friction of a part that is not measured"
    rarity = 1.0  # two parameters, at each such part
    shapes = (Parameter("level", "{f}", lower=0.0), Parameter("creep", "{y}", lower=0.0))
    depends_on = "y"

    def fits(self, plant: Plant, output: int) -> bool:
        """Where forces or torques move the state of a machine, by parameters of the model.

        The rate of a displacement is a speed, which no parameter changes.
        """
        moving = plant.kinds[plant.outputs[0]] in ("position", "speed") or mechanical(plant, 0)
        return moving and bool(_depends_on_parameters(plant)[output])

    def shows(self, seen: Seen) -> bool:
        return turns(seen.y)

    def grid(self, seen: Seen) -> Grid:
        speed = _rms(seen.y)
        # One speed of creep: below it the friction is stiff, and no record tells it well.
        levels = np.geomspace(0.01, 1.0, 6) * seen.band
        return speed * np.stack([levels, np.full(len(levels), 0.1)], axis=1)

    def change(self, at: At, shape: Any) -> Any:
        return -shape[0] * jnp.tanh(at.y / shape[1])

    def term(self, at: At, gain: Any, shape: Any) -> Any:
        del at, gain, shape
        return 0.0


def _depends_on_parameters(plant: Plant) -> np.ndarray:
    """Whether parameters change the rate of each internal state, at an arbitrary state."""
    draw = np.random.default_rng(0)
    y = jnp.asarray(draw.uniform(0.3, 1.0, (plant.rows, len(plant.outputs))))
    sizes = len(plant.initial_internal), len(plant.inputs)
    z, u = (jnp.asarray(draw.uniform(0.3, 1.0, size)) for size in sizes)

    def rates(theta: Any) -> Any:
        return plant.internal_rate(jnp.zeros(()), State(y, z), u, theta)

    return np.any(np.asarray(jax.jacfwd(rates)(jnp.asarray(plant.theta))) != 0.0, axis=1)
