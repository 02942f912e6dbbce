r"""What an effect is: one thing that a model may lack, with its term, parameters and grid.

An effect adds a term to y^(r) that is linear in its *gains* and may depend nonlinearly on its
*shapes*, or it changes an input on its way into the model, or the rate of an internal state of the
model. It may carry a state of its own.
A new one is a small class:

    class CubicStiffness(AbstractTerm):
        name = "cubic_stiffness"
        sentence = "a spring whose stiffness grows with the square of the displacement"
        gains = (Parameter("", "{f}/{y}³"),)
        depends_on = "y"

        def term(self, at, gain, shape):
            return -gain[0] * at.y**3
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.compiler.programs import jit
from eoi_jax.models.plant import Plant

_TURNS = 0.01  # share of the samples

Grid = Float[np.ndarray, "grid shapes"]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: appended to the name of the effect; "" for an effect with one parameter.
        unit: with {f}, {y}, {v}, {u} for the units of y^(r), the output, its rate, the input; and
            {f/y}, {f/v} for quotients, a power of 1/s where y^(r) is a derivative of the other.
        lower, upper: where it is physical.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


class At(NamedTuple):
    """One instant, as an effect on one channel sees it.

    Attributes:
        t: time [s].
        y: the output, or the internal state that it acts on.
        v: velocity of the output: its first derivative; of relative degree one the output itself,
            a speed as far as friction is concerned.
        u: the input (of the channel, or the first one).
        z: own states of the effect, shape (states,).
    """

    t: Any
    y: Any
    v: Any
    u: Any
    z: Any


@dataclass(frozen=True)
class Seen:
    """What the records show of one channel: where grids of shape parameters come from.

    Attributes:
        y, v, u: samples of all records (those that count), of what the effect acts on.
        measured: whether `v` is the output itself, of relative degree one.
        noise: standard deviation of the noise left in `y`.
        duration: of the longest record [s].
        sample_period: h [s].
        band: frequency that holds most of y^(r) [rad/s].
        peaks: frequencies at which the residual stands out [rad/s].
        lags: at which it follows the input [s].
    """

    y: Float[np.ndarray, " samples"]
    v: Float[np.ndarray, " samples"]
    u: Float[np.ndarray, " samples"]
    measured: bool
    noise: float
    duration: float
    sample_period: float
    band: float
    peaks: Float[np.ndarray, " peaks"]
    lags: Float[np.ndarray, " lags"] = field(default_factory=lambda: np.zeros(0))


class AbstractEffect(ABC):
    """One thing that a model may lack.

    Attributes:
        name: canonical.
        sentence: completes "the model lacks …".
        gains: parameters that enter linearly.
        shapes: parameters that do not.
        states: number of own internal states; they start at zero.
        depends_on: the variable that it is drawn against: "y", "v", "u" or "t".
        contains: names of simpler effects that it can imitate exactly.
        rarity: twice the log-odds by which a twin that is more common is preferred.
    """

    name: ClassVar[str]
    sentence: ClassVar[str]
    gains: ClassVar[tuple[Parameter, ...]] = ()
    shapes: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[int] = 0
    depends_on: ClassVar[str] = "t"
    contains: ClassVar[tuple[str, ...]] = ()
    rarity: ClassVar[float] = 0.0

    def __eq__(self, other: object) -> bool:
        # By value: a model with the same effects is then compiled once.
        return type(self) is type(other) and vars(self) == vars(other)

    def __hash__(self) -> int:
        return hash((type(self), tuple(sorted(vars(self).items()))))

    def since(self, start: float) -> "AbstractEffect":
        """The effect for records that start at this time; the same where time plays no part."""
        del start
        return self

    @abstractmethod
    def channels(self, plant: Plant) -> tuple[str, ...]:
        """Names of what it may act on: the outputs, the inputs, or the internal states."""

    @property
    def kind(self) -> str:
        """Of two effects of one kind and channel only one is ever in a model."""
        return self.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Gains, then shapes."""
        return self.gains + self.shapes

    def fits(self, plant: Plant, output: int) -> bool:
        """Whether it makes sense at this output of this plant."""
        del plant, output
        return True

    def shows(self, seen: Seen) -> bool:
        """Whether it makes sense on these records."""
        del seen
        return True

    def grid(self, seen: Seen) -> Grid:
        """Shape parameters to start from, one row each; refined locally later."""
        del seen
        return np.zeros((1, 0))

    def beyond(self, gains: Sequence[float] | np.ndarray) -> float:
        """How much it adds to the simpler effect that it contains, as a share of that; or 0."""
        del gains
        return 0.0

    def rate(self, at: At, shape: Any) -> Any:
        """dz/dt of the own states, shape (states,)."""
        del shape
        return at.z


class AbstractTerm(AbstractEffect):
    """An effect that adds a term to y^(r) of one output.

    Attributes:
        joins: whether it may also act between two outputs of one kind, as a spring from one mass
            to another does: `At.y` and `At.v` are then those of one output less the other's.
    """

    joins: ClassVar[bool] = False

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.outputs

    @abstractmethod
    def term(self, at: At, gain: Any, shape: Any) -> Any:
        """What it adds to y^(r) [its unit], linear in `gain`."""


class AbstractInputEffect(AbstractEffect):
    """An effect that changes one input on its way into the model."""

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.inputs

    @abstractmethod
    def changed(self, at: At, shape: Any) -> Any:
        """The input that the model gets instead of `at.u`."""


class AbstractActuator(AbstractEffect):
    """An effect that one input goes through before anything else: known from past inputs alone."""

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.inputs

    @abstractmethod
    def along(self, time: Any, u: Any, shape: Any) -> Any:
        """What comes of the input along a whole record.

        Args:
            time: middle of each step, shape (S,), uniform [s].
            u: mean of the input over each step, shape (S,).
            shape: the shape parameters.

        Returns:
            Mean of what the model gets over each step, shape (S,).
        """

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, " S"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        """`along` of measured arrays, for several shapes; an effect that knows how uses NumPy."""
        return np.asarray(_sampled(self, time, u, shapes))


@jit
def _sampled(effect: AbstractActuator, time: Any, u: Any, shapes: Any) -> Any:
    return jax.vmap(lambda shape: effect.along(time, u, shape))(jnp.asarray(shapes))


# What acts on an input, in whichever way.
INPUT_EFFECTS = (AbstractInputEffect, AbstractActuator)


class AbstractInternalEffect(AbstractEffect):
    """An effect that changes the rate of one internal state, and what of it reaches y^(r).

    Nobody measures that state: it is followed by the model. What it loses may enter the first
    output, linear in the gains.
    """

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return internal_names(plant)

    @abstractmethod
    def change(self, at: At, shape: Any) -> Any:
        """What it adds to dz/dt of the state `at.y`."""

    @abstractmethod
    def term(self, at: At, gain: Any, shape: Any) -> Any:
        """What it adds to y^(r) of the first output [its unit], linear in `gain`."""


def internal_names(plant: Plant) -> tuple[str, ...]:
    """Names of a plant's internal states: its own (`internal.states`), else z, or z1, z2, …."""
    names = getattr(plant.internal, "states", None)
    if isinstance(names, tuple):
        return names
    count = len(plant.initial_internal)
    return ("z",) if count == 1 else tuple(f"z{i + 1}" for i in range(count))


def mechanical(plant: Plant, output: int) -> bool:
    """Whether the output is a position: its velocity is a state."""
    return plant.degrees[output] >= 2


def turns(values: Float[np.ndarray, " samples"]) -> bool:
    """Whether a signal goes both ways, as a speed does and a level does not."""
    return bool(min(np.mean(values > 0), np.mean(values < 0)) > _TURNS)


def quantiles(values: Float[np.ndarray, " samples"], shares: Any) -> Grid:
    """Values below which these shares of the samples lie, as a grid of one shape parameter."""
    return np.unique(np.quantile(values, shares))[:, None]
