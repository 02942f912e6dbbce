"""Effects between the recorded input and the plant."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.data.recursion import states
from eoi_jax.models.commands import commands_output, subtracts_output
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractInputEffect,
    At,
    Grid,
    Parameter,
    Seen,
    quantiles,
    turns,
)
from eoi_jax.models.plant import Plant

# A lag of fewer steps settles within each, by exp(-1000); the limit keeps the derivative at zero.
_SHORTEST = 1e-3


class InputDeadZone(AbstractInputEffect):
    """sign(u) max(|u| - g, 0)."""

    name = "input_dead_zone"
    sentence = "a dead zone of the input"
    rarity = 1.0  # for an input of one sign, a zone that it never enters is an offset
    shapes = (Parameter("", "{u}", lower=0.0),)
    depends_on = "u"

    def grid(self, seen: Seen) -> Grid:
        return np.geomspace(0.005, 0.8, 12)[:, None] * np.max(np.abs(seen.u))

    def changed(self, at: At, shape: Any) -> Any:
        return at.u - jnp.clip(at.u, -shape[0], shape[0])


class InputSaturation(AbstractInputEffect):
    """clip(u, -L, L)."""

    name = "input_saturation"
    sentence = "a saturation of the input"
    shapes = (Parameter("", "{u}", lower=0.0),)
    depends_on = "u"

    def grid(self, seen: Seen) -> Grid:
        shares = [0.3, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.99]
        grid = quantiles(np.abs(seen.u), shares)
        # A limit that is hardly ever met may lie far above them.
        highest = 0.5 * (grid[-1:] + np.max(np.abs(seen.u)))
        grid = np.concatenate([grid, highest[highest > grid[-1]][:, None]])
        return grid[grid[:, 0] > 0] if np.any(grid > 0) else np.ones((1, 1))

    def changed(self, at: At, shape: Any) -> Any:
        return jnp.clip(at.u, -shape[0], shape[0])


class ErrorSaturation(AbstractInputEffect):
    """y + clip(u - y, -L, L): a control error that is limited, as by the supply of a servo's drive.

    The input commands the output, in its unit. A drive that gives all it can no longer knows by how
    much the command is missed: large steps end in a motion of constant speed, or of constant power.
    """

    name = "error_saturation"
    sentence = "a saturation of the control error, input less output"
    rarity = 1.0  # one of the input, or drag, is more common
    shapes = (Parameter("", "{u}", lower=0.0),)
    only_in_free_runs = True

    def fits(self, plant: Plant, output: int) -> bool:
        """Whether the model knows the input by the control error; without units, by it alone."""
        if plant.degrees[0] == 0:
            return False
        unit, of_output = (
            plant.units.get(name) for name in (plant.inputs[output], plant.outputs[0])
        )
        if unit and of_output:
            return unit == of_output and subtracts_output(plant, output)
        return commands_output(plant, output)

    def grid(self, seen: Seen) -> Grid:
        return InputSaturation().grid(replace(seen, u=seen.u - seen.y))

    def changed(self, at: At, shape: Any) -> Any:
        return at.y + jnp.clip(at.u - at.y, -shape[0], shape[0])


@dataclass(frozen=True)
class CurrentLimit(AbstractInputEffect):
    """k v + clip(u - k v, -L, L): a drive that limits its current, u - k v over the resistance.

    With v the speed of the motor and k its back-EMF in the unit of u. Such a drive pushes with a
    constant force until the speed has caught up with the voltage.

    Attributes:
        of_position: whether the output is a position, and v its rate; else it is the speed.
    """

    of_position: bool = False

    name = "current_limit"
    sentence = "a limit of the current, input less back-EMF"
    rarity = 1.0
    shapes = (
        Parameter("back_emf", "", lower=0.0),
        Parameter("level", "{u}", lower=0.0),
    )
    only_in_free_runs = True

    @property
    def form(self) -> str:
        return "of a position" if self.of_position else "of a speed"

    def fits(self, plant: Plant, output: int) -> bool:
        """A motion, or what neither kind nor unit tells."""
        name, moving = plant.outputs[0], "position" if self.of_position else "speed"
        moves = plant.kinds[name] in (moving, plant.units.get(name, ""))  # both "" if not known
        return moves and len(plant.outputs) == 1 and plant.degrees[0] == 1 + self.of_position

    def shows(self, seen: Seen) -> bool:
        return bool(np.any(self._speed(seen)))

    def grid(self, seen: Seen) -> Grid:
        speed, rows = self._speed(seen), []
        for share in (0.25, 0.5, 0.75, 1.0):
            k = share * float(np.std(seen.u) / np.std(speed))
            rows += [
                (k, float(np.quantile(np.abs(seen.u - k * speed), q))) for q in (0.3, 0.6, 0.8, 0.9)
            ]
        return np.array(rows)

    def changed(self, at: At, shape: Any) -> Any:
        emf = shape[0] * self._speed(at)
        return emf + jnp.clip(at.u - emf, -shape[1], shape[1])

    def _speed(self, at: Any) -> Any:
        return at.v if self.of_position else at.y


class ValveFlow(AbstractInputEffect):
    """u √(1 - sign(u) y/p): flow through a valve falls with the pressure behind it.

    u opens the valve, y is the pressure that it makes and p that of the supply: Bernoulli's law of
    an orifice, √(p - sign(u) y), of a valve that connects the other side with the tank.

    Source: H. E. Merritt, Hydraulic Control Systems, Wiley 1967, section 5.2.
    """

    name = "valve_flow"
    sentence = "a valve, whose flow falls with the root of the pressure that is left"
    rarity = 1.0
    shapes = (Parameter("supply", "", lower=0.0),)
    only_in_free_runs = True

    def fits(self, plant: Plant, output: int) -> bool:
        no_pressure = plant.kinds[plant.outputs[0]] in ("temperature", "concentration", "current")
        return len(plant.outputs) == 1 and plant.degrees[0] == 1 and not no_pressure

    def grid(self, seen: Seen) -> Grid:
        size = float(np.max(np.abs(seen.y))) or 1.0
        return size * np.array([1.1, 1.5, 2.5, 5.0])[:, None]

    def changed(self, at: At, shape: Any) -> Any:
        # Not zero: the root has no slope there.
        drop = jnp.maximum(1.0 - jnp.sign(at.u) * at.y / shape[0], 1e-6)
        return at.u * jnp.sqrt(drop)


@dataclass(frozen=True)
class InputSquare(AbstractInputEffect):
    """u|u| (of the sign of u), or u²: an actuator that gives the square of its input.

    The thrust and the torque of a fan or a propeller, the force between a magnet and iron, the heat
    of a resistor. The gain of the declared model takes it in.

    Attributes:
        odd: whether it is the first form.
    """

    name = "input_square"
    sentence = "an actuator that gives the square of its input"
    depends_on = "u"
    only_in_free_runs = True

    odd: bool = True

    @property
    def form(self) -> str:
        """Whether it is an odd or an even function of u."""
        return "odd" if self.odd else "even"

    def changed(self, at: At, shape: Any) -> Any:
        return at.u * (jnp.abs(at.u) if self.odd else at.u)


@dataclass(frozen=True)
class InputQuadratic(AbstractInputEffect):
    """u + q u|u| (an actuator whose gain grows), or u + q u² (one that differs between the signs).

    Attributes:
        odd: whether it is the first form.
    """

    name = "input_quadratic"
    sentence = "an actuator with a quadratic characteristic"
    shapes = (Parameter("", "1/({u})"),)
    depends_on = "u"
    contains = (InputSquare.name,)

    odd: bool = True

    @property
    def form(self) -> str:
        """Whether it is an odd or an even function of u."""
        return "odd" if self.odd else "even"

    def limit(self, kind: str = "") -> InputSquare:
        del kind
        return InputSquare(self.odd)

    def shows(self, seen: Seen) -> bool:
        """Of an input of one sign both forms are the same: the odd one stands for both."""
        return super().shows(seen) and (self.odd or turns(seen.u))

    def grid(self, seen: Seen) -> Grid:
        size = np.array([0.003, 0.012, 0.05, 0.15, 0.4, 1.0, 4.0, 20.0, 100.0])
        size /= np.max(np.abs(seen.u)) or 1.0
        return np.concatenate([-size[4::-1], size])[:, None]

    def changed(self, at: At, shape: Any) -> Any:
        return at.u + shape[0] * at.u * (jnp.abs(at.u) if self.odd else at.u)


class InputAsymmetry(AbstractInputEffect):
    """u + q |u|: an actuator whose gain differs between the two directions.

    A cylinder whose two sides differ in area, a Peltier element that heats better than it cools, a
    bridge with unlike halves. The gains of the two directions are as 1 + q to 1 - q.
    """

    name = "input_asymmetry"
    sentence = "an actuator whose gain differs between the two directions"
    rarity = 1.0  # for an input of nearly one size it is an offset, which is more common
    shapes = (Parameter("", "1"),)
    depends_on = "u"

    def grid(self, seen: Seen) -> Grid:
        size = np.array([0.003, 0.012, 0.05, 0.15, 0.4, 1.0])
        # An input of one sign has one gain.
        return np.concatenate([-size[::-1], size])[:, None] if turns(seen.u) else np.zeros((0, 1))

    def changed(self, at: At, shape: Any) -> Any:
        return at.u + shape[0] * jnp.abs(at.u)


class InputYield(AbstractInputEffect):
    """clip(u, -L, L) + s u: what yields, with a slope beyond.

    A damper whose fluid yields, prescribed speed in and force out; a valve that is nearly open.
    """

    name = "input_yield"
    sentence = "an input that yields, with a smaller slope beyond"
    shapes = (Parameter("level", "{u}", lower=0.0), Parameter("slope", "1", lower=0.0))
    depends_on = "u"
    contains = ("input_saturation",)
    only_in_free_runs = True

    def grid(self, seen: Seen) -> Grid:
        levels = quantiles(np.abs(seen.u), [0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 0.9])[:, 0]
        levels = levels[levels > 0] if np.any(levels > 0) else np.ones(1)
        slopes = np.array([0.01, 0.03, 0.1, 0.3])
        return np.stack(np.meshgrid(levels, slopes, indexing="ij"), axis=-1).reshape(-1, 2)

    def changed(self, at: At, shape: Any) -> Any:
        return jnp.clip(at.u, -shape[0], shape[0]) + shape[1] * at.u


class ActuatorLag(AbstractActuator):
    """T dz/dt = u - z; the plant gets z, which is in steady state at the start of the record."""

    name = "actuator_lag"
    sentence = "a first-order lag of the actuator"
    shapes = (Parameter("", "s", lower=0.0),)
    depends_on = "t"

    def grid(self, seen: Seen) -> Grid:
        return lag_times(seen)

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        # Exact for a staircase: z decays towards u in each step; the mean over it is returned.
        decay, late = _lag_factors(shape[0], time[1] - time[0], jnp)
        return jax.lax.scan(lambda z, u: _lagged(z, u, decay, late), u[0], u)[1]

    def memory(self, period: float, shape: Any) -> int:
        return 1

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        state, mean = _lagged(memory[0], u, *_lag_factors(shape[0], period, jnp))
        return state[None], mean

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, " S"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        period = time[1] - time[0]
        signals = []
        for (lag,) in shapes:
            decay, late = _lag_factors(lag, period, np)
            end_of_step = states(
                np.full((1, 1), decay), np.full(1, 1.0 - decay), u[:, None], u[:1, None]
            )
            start_of_step = np.concatenate([u[:1], end_of_step[:-1, 0, 0]])
            signals.append(u + (start_of_step - u) * late)
        return np.stack(signals)


class InputRate(AbstractActuator):
    r"""u + L/T (u - z), T dz/dt = u - z: what follows the rate of the input too, smoothed over T.

    A negative L is late, as a delay of -L is to first order where T = -L/2 (H. Padé). T is no
    shorter than that: fast changes would come out larger than they go in, and the other way round,
    which inverts a controller whose output the input is.
    """

    name = "input_rate"
    sentence = "a response to the rate of the input"
    rarity = 2.0  # a second store behind a plant of first order does the same
    shapes = (Parameter("lead", "s"), Parameter("lag", "s", lower=0.0))
    depends_on = "t"
    only_in_free_runs = True

    def grid(self, seen: Seen) -> Grid:
        lags = np.unique(np.maximum(np.array([0.1, 0.5, 2.0]) / seen.band, seen.sample_period))
        leads = np.array([-2.0, -1.0, -0.5, 0.5, 1.0, 4.0])  # over the lag
        shares, lags = np.meshgrid(leads, lags, indexing="ij")
        return np.stack([shares * lags, lags], axis=-1).reshape(-1, 2)

    def is_seen(self, values: Sequence[float], reach: float) -> bool:
        """Whether no time is longer than the records: beside such a lead the input itself is lost.

        Then the gain of the model runs off to zero, and only its product with the lead is told.
        """
        return max(map(abs, values)) <= reach

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        lag = _smoothing(shape[0], shape[1], time[1] - time[0], jnp)
        return u + shape[0] / lag * (u - ActuatorLag().along(time, u, [lag]))

    def memory(self, period: float, shape: Any) -> int:
        return 1

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        lag = _smoothing(shape[0], shape[1], period, jnp)
        memory, late = ActuatorLag().step(memory, u, period, [lag])
        return memory, u + shape[0] / lag * (u - late)

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, " S"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        lags = _smoothing(shapes[:, :1], shapes[:, 1:], time[1] - time[0], np)
        return u + shapes[:, :1] / lags * (u - ActuatorLag().sampled(time, u, lags))


def _smoothing(lead: Any, lag: Any, period: Any, xp: Any) -> Any:
    """The lag of a response to the rate: not so short that fast changes are inverted and grow."""
    return xp.maximum(xp.maximum(lag, -0.5 * lead), _SHORTEST * period)


class RateLimit(AbstractActuator):
    """dz/dt = ±R until z = u: an actuator that moves no faster.

    A servo, a valve with its motor, a controller that ramps its set point. `refine` fits where z is
    at the start of a record; elsewhere it is at u, as a small step of the level before the record
    says nothing of a large one: leave out the time until it has arrived.
    """

    name = "rate_limit"
    sentence = "a limit of the rate of the actuator"
    rarity = 1.0
    shapes = (Parameter("", "{u}/s", lower=0.0),)
    depends_on = "t"
    only_in_free_runs = True
    is_linear = False

    def shows(self, seen: Seen) -> bool:
        return bool(np.ptp(seen.u))

    def grid(self, seen: Seen) -> Grid:
        return np.sort(np.ptp(seen.u) / (2.0 * lag_times(seen)), axis=0)

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        reach = shape[0] * (time[1] - time[0])
        return jax.lax.scan(lambda z, u: _ramped(z, u, reach), u[0], u)[1]

    def memory(self, period: float, shape: Any) -> int:
        return 1

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        state, mean = _ramped(memory[0], u, shape[0] * period)
        return state[None], mean


def _ramped(z: Any, u: Any, reach: Any) -> tuple[Any, Any]:
    """Where a ramp from z towards u ends after a step in which it may go so far, and its mean."""
    reach = jnp.maximum(reach, np.finfo(float).tiny)
    moved = jnp.clip(u - z, -reach, reach)
    return z + moved, z + moved * (1.0 - 0.5 * jnp.abs(moved) / reach)


class InputPlay(AbstractActuator):
    """z follows u where they are gap/2 apart, and stays within: backlash, or a valve that sticks.

    The play operator: M. A. Krasnosel'skii and A. V. Pokrovskii, Systems with Hysteresis (1989). At
    the start of the record z is at u.
    """

    name = "input_play"
    sentence = "a play of the actuator, as of a backlash or of a valve that sticks"
    rarity = 1.0
    shapes = (Parameter("", "{u}", lower=0.0),)
    depends_on = "t"
    only_in_free_runs = True
    keeps_steps = True
    is_linear = False

    def shows(self, seen: Seen) -> bool:
        return bool(np.ptp(seen.u))

    def grid(self, seen: Seen) -> Grid:
        return np.ptp(seen.u) * np.geomspace(0.01, 0.5, 10)[:, None]

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        return jax.lax.scan(lambda z, u: (_dragged(z, u, shape[0]),) * 2, u[0], u)[1]

    def memory(self, period: float, shape: Any) -> int:
        return 1

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        state = _dragged(memory[0], u, shape[0])
        return state[None], state


def _dragged(z: Any, u: Any, gap: Any) -> Any:
    """Where u takes z along, which stays where it is within half the gap."""
    return jnp.clip(z, u - 0.5 * gap, u + 0.5 * gap)


def _lag_factors(lag: Any, period: Any, xp: Any) -> tuple[Any, Any]:
    """exp(-h/T) of a lag with time constant T, and its mean over a step."""
    decay = xp.exp(-period / xp.maximum(lag, _SHORTEST * period))
    return decay, (1.0 - decay) * lag / period


def _lagged(z: Any, u: Any, decay: Any, late: Any) -> tuple[Any, Any]:
    """The state of a lag at the end of a step, and its mean over it."""
    return u + (z - u) * decay, u + (z - u) * late


@dataclass(frozen=True)
class InputModulation(AbstractActuator):
    r"""u max(1 + d z, 0), T dz/dt = w - z: a gain that the past of an input w raises or lowers.

    The ground runs off more rain when it is wet, and is dry after warm weeks; a heater, a muscle, a
    catalyst or a battery answers less after what it has done. w may be u itself, or another input
    that was recorded. z is in steady state at the start of the record. In its second form z is a
    store that both move, T dz/dt = w + s u - z: rain wets the ground that warmth dries.

    Source: A. J. Jakeman and G. M. Hornberger, Water Resour. Res. 29 (1993) 2637, whose rain is
    multiplied by an index of wetness; the form for any two inputs is our own.

    Attributes:
        shared: whether it is the second form.
    """

    name = "input_modulation"
    sentence = "a gain of an input that follows the past of an input"
    rarity = 1.0  # one of as many as there are pairs of inputs
    depends_on = "t"
    only_in_free_runs = True
    keeps_steps = True
    has_driver = True

    shared: bool = False

    @property
    def shapes(self) -> tuple[Parameter, ...]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Depth d and lag T, and the share s of u."""
        shapes = Parameter("depth", "1/({f})"), Parameter("lag", "s", lower=0.0)
        return (*shapes, Parameter("share", "({f})/({u})")) if self.shared else shapes

    @property
    def drives_itself(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """In the first form only: in the second one the share would say the same as the depth."""
        return not self.shared

    @property
    def form(self) -> str:
        """Whether both inputs move the store."""
        return "shared" if self.shared else ""

    def next_form(self) -> "InputModulation | None":
        return None if self.shared else InputModulation(shared=True)

    def grid(self, seen: Seen) -> Grid:
        lags = np.geomspace(2.0 * seen.sample_period, seen.duration / 8.0, 7)
        depths = np.array([-1.0, -0.3, 0.3, 1.0]) / (np.max(np.abs(seen.u)) or 1.0)
        grid = np.stack(np.meshgrid(depths, lags, indexing="ij"), axis=-1).reshape(-1, 2)
        return np.pad(grid, ((0, 0), (0, int(self.shared))))

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        drive = u[:, 1] + shape[2] * u[:, 0] if self.shared else u[:, 1]
        past = ActuatorLag().along(time, drive, [shape[1]])
        return u[:, 0] * jnp.maximum(1.0 + shape[0] * past, 0.0)

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, "S *driver"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        if self.shared:
            return super().sampled(time, u, shapes)
        past = ActuatorLag().sampled(time, u[:, 1], shapes[:, 1:])
        return u[:, 0] * np.maximum(1.0 + shapes[:, :1] * past, 0.0)


class InputDelay(AbstractActuator):
    """u(t - τ); before the record the input is constant at its first value."""

    name = "input_delay"
    sentence = "a delay of the input"
    shapes = (Parameter("", "s", lower=0.0),)
    depends_on = "t"
    keeps_steps = True
    keeps_inputs = True

    def grid(self, seen: Seen) -> Grid:
        # Minima of the cost over delays are narrow (a quarter period of the band): long delays are
        # taken from `lags`.
        times = lag_times(seen)
        candidates = seen.lags[:, None] + np.array([-0.5, 0.0, 0.5]) / seen.band
        return np.unique(
            np.concatenate([times, candidates[candidates > np.max(times)][:, None]]), axis=0
        )

    def along(self, time: Any, u: Any, shape: Any) -> Any:
        # Linear interpolation gives the exact means over steps of a shifted staircase.
        steps = shape[0] / (time[1] - time[0])
        whole_steps = jnp.floor(steps)
        late = jnp.arange(len(u)) - whole_steps.astype(int)
        current, previous = u[jnp.maximum(late, 0)], u[jnp.maximum(late - 1, 0)]
        return current + (steps - whole_steps) * (previous - current)

    def memory(self, period: float, shape: Any) -> int:
        return int(np.floor(shape[0] / period)) + 1

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        whole_steps = len(memory) - 1  # those of `memory`, of which the shape may have moved a bit
        inputs = jnp.concatenate([jnp.reshape(u, (1,)), memory])
        current, previous = inputs[whole_steps], inputs[whole_steps + 1]
        share = shape[0] / period - whole_steps
        return inputs[:-1], current + share * (previous - current)

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, " S"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        # A trial of a fit may be longer than any record, or no number at all.
        steps = np.minimum(shapes[:, :1] / (time[1] - time[0]), len(u))
        whole_steps = np.floor(steps)
        late = np.arange(len(u)) - np.nan_to_num(whole_steps).astype(int)
        current, previous = u[np.maximum(late, 0)], u[np.maximum(late - 1, 0)]
        return current + (steps - whole_steps) * (previous - current)


def lag_times(seen: Seen) -> Grid:
    """Times that shift the phase at the edge of the band by 0.01 to 4 rad.

    Less than half a sample depends on how the record was sampled, not on the plant.
    """
    shortest = 0.5 * seen.sample_period
    times = np.geomspace(0.01, 4.0, 11) / seen.band
    return np.unique(np.maximum(times, shortest))[:, None]
