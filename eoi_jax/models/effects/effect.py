r"""Interfaces of effects: what a model may lack, with its term, parameters and grid.

An effect adds a term to y^(r) that is linear in its *gains* and may depend nonlinearly on its
*shapes*. Or it changes an input before it enters the model, or the rate of an internal state of the
model, or connects the model in series. It may have internal states. A new effect is a small class:

    class CubicStiffness(AbstractTerm):
        name = "cubic_stiffness"
        sentence = "a spring whose stiffness grows with the square of the displacement"
        gains = (Parameter("", "{f}/{y}³"),)
        depends_on = "y"

        def term(self, at, gain, shape):
            return -gain[0] * at.y**3
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax.compiler.programs import jit
from eoi_jax.models.captured_values import object_content
from eoi_jax.models.function_snapshot import is_of_package
from eoi_jax.models.plant import Plant
from eoi_jax.models.state_names import numbered_states

Grid = Float[np.ndarray, "grid shapes"]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: appended to the name of the effect; "" for an effect with one parameter.
        unit: template; {f}, {y}, {v}, {u} are the units of y^(r), the output, its rate, the input;
            {f/y}, {f/v} are quotients, a power of 1/s where y^(r) is a derivative of y or v.
        lower, upper: physical range.
        reach: factor by which a fit may change a positive value that it starts from.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    reach: float = np.inf

    def bounds(self, value: float) -> tuple[float, float]:
        """The range of a fit that starts from this value."""
        if value <= 0.0 or np.isinf(self.reach):
            return self.lower, self.upper
        return max(self.lower, value / self.reach), min(self.upper, value * self.reach)


class At(NamedTuple):
    """The signals at one instant, for an effect on one channel.

    Attributes:
        t: time [s].
        y: the output, or the internal state that it acts on.
        v: velocity: the first derivative of the output; for an output of relative degree one the
            output itself, which friction treats as a speed.
        u: the input (of the channel, or the first one).
        z: internal states of the effect, shape (states,).
        slope: first derivative of `y`, for effects with `follows_slope`.
        state: outputs of the plant and their derivatives, shape (r, ny).
        inputs: of the plant.
    """

    t: Any
    y: Any
    v: Any
    u: Any
    z: Any
    slope: Any = None
    state: Any = None
    inputs: Any = None


@dataclass(frozen=True)
class Seen:
    """Data of the records for one channel, from which grids of shape parameters are made.

    Attributes:
        y, v, u: the scored samples of all records for the channel that the effect acts on.
        measured: whether `v` is the output itself, of relative degree one.
        noise: standard deviation of the remaining noise in `y`.
        duration: duration of the longest record [s].
        sample_period: h [s].
        band: frequency that holds most of y^(r) [rad/s].
        peaks: frequencies of the peaks of the residual [rad/s].
        lags: lags at which the residual follows the input [s].
        kind: what the output is (`models/kinds.py`); "" where that is not known.
        wavenumbers: at which the residual repeats along the position, many periods [1/unit of y].
        measured_y: samples of the output that `y` simulates; none where `y` itself is measured.
        measured_noise: standard deviation of the noise in these, at most.
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
    kind: str = ""
    wavenumbers: Float[np.ndarray, " wavenumbers"] = field(default_factory=lambda: np.zeros(0))
    measured_y: Float[np.ndarray, " outputs"] = field(default_factory=lambda: np.zeros(0))
    measured_noise: float = 0.0

    near_rest: ClassVar[float] = 0.02  # of the largest speed: of a speed at rest
    least_rest: ClassVar[float] = 0.05  # share of the samples at rest of a speed that stops

    @property
    def rests(self) -> bool:
        """Whether the output that is simulated stays near zero, on one side of it, for a while."""
        size = np.max(np.abs(self.measured_y), initial=0.0)
        if size == 0.0:
            return False
        side = np.sign(np.median(self.measured_y))
        return bool(np.mean(side * self.measured_y <= self.near_rest * size) > self.least_rest)

    @property
    def is_speed(self) -> bool:
        """Whether `v` is a speed: by its kind, else because it takes both signs."""
        if not self.measured:
            return True
        return self.kind == "speed" if self.kind else turns(self.v)

    @property
    def is_level(self) -> bool:
        """Whether `y` may be a level: by its kind, else because it takes only one sign."""
        return self.kind == "level" if self.kind else self.keeps_sign

    @property
    def keeps_sign(self) -> bool:
        """Whether `y` takes only one sign: what is simulated, or what is measured of it.

        A model that lacks how a loss falls with the output empties what is never empty.
        """
        if not _changes_sign(self.y, self.noise):
            return True
        return len(self.measured_y) > 0 and not _changes_sign(self.measured_y, self.measured_noise)


class AbstractEffect(ABC):
    """One thing that a model may lack.

    Attributes:
        name: canonical name.
        sentence: completes "the model lacks …".
        gains: parameters that enter linearly.
        shapes: parameters that do not.
        states: number of internal states of the effect; they start at zero.
        depends_on: the variable that it is plotted against: "y", "v", "u" or "t".
        contains: names of simpler effects that are special cases of it.
        rarity: twice the log-odds by which a more common effect of the same fit is preferred.
        follows_slope: whether its internal states follow `At.slope`.
        only_in_free_runs: whether `discover` tries it in free runs alone, and not in the injection.
        record_needs: what `shows` asks of the records, for messages; "" where it asks nothing.
    """

    name: ClassVar[str]
    sentence: ClassVar[str]
    gains: ClassVar[tuple[Parameter, ...]] = ()
    shapes: ClassVar[tuple[Parameter, ...]] = ()
    states: int = 0
    depends_on: ClassVar[str] = "t"
    contains: ClassVar[tuple[str, ...]] = ()
    rarity: ClassVar[float] = 0.0
    follows_slope: ClassVar[bool] = False
    only_in_free_runs: ClassVar[bool] = False
    record_needs: ClassVar[str] = ""

    def __eq__(self, other: object) -> bool:
        # Equality by value, so that models with equal effects are compiled once.
        if type(self) is not type(other):
            return False
        if is_of_package(type(self)):
            return vars(self) == vars(other)
        return object_content(self) == object_content(other)

    def __hash__(self) -> int:
        if is_of_package(type(self)):
            return hash((type(self), tuple(sorted(vars(self).items()))))
        return hash(object_content(self))

    def next_form(self) -> "AbstractEffect | None":
        """What a fit goes on to where this one fits; None for an effect of a single form."""
        return None

    def further_starts(self, values: Sequence[float]) -> list[tuple[float, ...]]:
        """Where fits also begin that a score test nominated with these parameters.

        Args:
            values: gains, then shapes.
        """
        del values
        return []

    def is_seen(self, values: Sequence[float], reach: float) -> bool:
        """Whether a signal tells it from a law without its shape.

        Args:
            values: gains, then shapes.
            reach: largest less smallest value of the signal that it depends on.
        """
        del values, reach
        return True

    def limit(self, kind: str = "") -> "AbstractEffect | None":
        """What it becomes where a parameter runs off; None where that is no law.

        Args:
            kind: what the output that it acts on is (`models/kinds.py`).
        """
        del kind
        return None

    def since(self, start: float) -> "AbstractEffect":
        """The effect for records that start at this time; unchanged unless it depends on time."""
        del start
        return self

    @abstractmethod
    def channels(self, plant: Plant) -> tuple[str, ...]:
        """Names of the outputs, inputs or internal states that it may act on."""

    @property
    def kind(self) -> str:
        """A model contains at most one effect of each kind and channel."""
        return self.name

    @property
    def form(self) -> str:
        """Which of the effects of this name it is, in a word; "" where there is one."""
        return ""

    @property
    def label(self) -> str:
        """Name and form, as in tables: ``end_stop (above)``."""
        return labelled(self.name, self.form)

    @property
    def words(self) -> str:
        """The label in a sentence: ``end stop (above)``; signals in its form keep their names."""
        return labelled(self.name.replace("_", " "), self.form)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Gains, then shapes."""
        return self.gains + self.shapes

    def fits(self, plant: Plant, output: int) -> bool:
        """Whether it is meaningful for this output of this plant; on inputs: for this input."""
        del plant, output
        return True

    def shows(self, seen: Seen) -> bool:
        """Whether it is meaningful for these records."""
        del seen
        return True

    def grid(self, seen: Seen) -> Grid:
        """Initial values of the shape parameters, one row each; they are refined locally."""
        del seen
        return np.zeros((1, 0))

    def beyond(self, gains: Sequence[float] | np.ndarray) -> float:
        """Its excess over the simpler effect that it contains, as a share of that; or 0."""
        del gains
        return 0.0

    def rate(self, at: At, shape: Any) -> Any:
        """dz/dt of the internal states of the effect, shape (states,)."""
        del shape
        return at.z


class AbstractTerm(AbstractEffect):
    """An effect that adds a term to y^(r) of one output.

    Attributes:
        joins: whether it may also act between two outputs of one kind, like a spring between two
            masses: `At.y` and `At.v` are then the differences between the two outputs.
    """

    joins: ClassVar[bool] = False

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.outputs

    @abstractmethod
    def term(self, at: At, gain: Any, shape: Any) -> Any:
        """The contribution to y^(r) [its unit], linear in `gain`."""

    def states_along(
        self,
        y: Float[np.ndarray, "runs S 3"],
        v: Float[np.ndarray, "runs S 3"],
        period: float,
        shape: np.ndarray,
    ) -> Float[np.ndarray, "states runs S 3"] | None:
        """Internal states along runs, for a score test of free runs; None where it has no formula.

        Args:
            y: the output at the start, the middle and the end of each sample.
            v: the velocity, of an output of relative degree one that itself.
            period: of the samples [s].
            shape: the shape parameters.
        """
        del y, v, period, shape
        return None


class AbstractInputEffect(AbstractEffect):
    """An effect that changes one input before it enters the model."""

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.inputs

    def shows(self, seen: Seen) -> bool:
        """Whether a law of an input alone differs from a line: one of two levels shows no other."""
        return self.depends_on != "u" or _has_three_levels(seen.u)

    @abstractmethod
    def changed(self, at: At, shape: Any) -> Any:
        """The input of the model, which replaces `at.u`."""


class AbstractActuator(AbstractEffect):
    """An effect that acts on one input first and depends on its past values only.

    Attributes:
        keeps_steps: whether a held input comes out held, as from a delay; else as a continuous one.
        keeps_inputs: whether its memory is past inputs alone, whatever the shape; else it follows.
        is_linear: whether it is linear in its input, near enough: what a unit of the level before a
            record changes then tells what any level does.
        has_driver: whether the past of an input drives it: `along` and `sampled` then get two
            columns, shape (S, 2), the input that it acts on and its driver.
        drives_itself: whether its driver may be the input that it acts on.
    """

    keeps_steps: ClassVar[bool] = False
    keeps_inputs: ClassVar[bool] = False
    is_linear: ClassVar[bool] = True
    has_driver: ClassVar[bool] = False
    drives_itself: bool = False

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.inputs

    @abstractmethod
    def along(self, time: Any, u: Any, shape: Any) -> Any:
        """The input of the model along a record.

        Args:
            time: middle of each step, shape (S,), uniform [s].
            u: mean of the input over each step, shape (S,); with its driver, shape (S, 2).
            shape: the shape parameters.

        Returns:
            Mean of the input of the model over each step, shape (S,).
        """

    def sampled(
        self, time: Float[np.ndarray, " S"], u: Float[np.ndarray, "S *driver"], shapes: Grid
    ) -> Float[np.ndarray, "grid S"]:
        """`along` of measured arrays for several shapes; subclasses may override it with NumPy."""
        return np.asarray(_sampled(self, time, u, shapes))

    def memory(self, period: float, shape: Any) -> int:
        """Number of values that `step` remembers; all are u where the input was always u.

        Args:
            period: of the steps [s].
            shape: the shape parameters, numbers.
        """
        del period, shape
        rule = "must have `memory` and `step` to run sample by sample"
        check(False, self.name, rule, type(self).__name__)
        return 0

    def step(self, memory: Any, u: Any, period: Any, shape: Any) -> tuple[Any, Any]:
        """One step of `along`, for a record that is not known in advance.

        Args:
            memory: before it, shape (memory,).
            u: mean of the input over the step.
            period: of the steps [s].
            shape: the shape parameters.

        Returns:
            The memory after it, and the mean of the input of the model over the step.
        """
        del period, shape
        return memory, u


@jit
def _sampled(effect: AbstractActuator, time: Any, u: Any, shapes: Any) -> Any:
    return jax.vmap(lambda shape: effect.along(time, u, shape))(jnp.asarray(shapes))


# All interfaces of effects on an input.
INPUT_EFFECTS = (AbstractInputEffect, AbstractActuator)


class AbstractInternalEffect(AbstractEffect):
    """An effect that changes the rate of one internal state, with a contribution to y^(r).

    The state is not measured; the model simulates it. What it loses may enter the first output,
    linear in the gains.
    """

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return internal_names(plant)

    @abstractmethod
    def change(self, at: At, shape: Any) -> Any:
        """The contribution to dz/dt of the state `at.y`."""

    @abstractmethod
    def term(self, at: At, gain: Any, shape: Any) -> Any:
        """The contribution to y^(r) of the first output [its unit], linear in `gain`."""


class AbstractParameterEffect(AbstractEffect):
    """An effect that replaces a parameter in the equations of the model.

    Attributes:
        parameter: name of the parameter.
        acts_on: the output in whose equation it stands; the first one of several, or of all where
            it stands in that of an internal state.
        signals: of the plant, on which it depends; () for time.
    """

    parameter: str
    acts_on: str
    signals: tuple[Any, ...]

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.outputs

    def fits(self, plant: Plant, output: int) -> bool:
        """At one output, of a plant that has the parameter."""
        return plant.outputs[output] == self.acts_on and self.parameter in plant.names

    @abstractmethod
    def factor(self, at: At, shape: Any) -> Any:
        """What stands in place of the parameter, over it."""


def labelled(name: str, form: str) -> str:
    """A canonical name with the form of the effect, if it has several."""
    return f"{name} ({form})" if form else name


class AbstractCascade(AbstractEffect):
    """An effect that connects the model of an output in series, with copies of it or with a sensor.

    Attributes:
        behind_output: whether it stands behind the output, as a sensor does: all other effects are
            then within it.
        needs: on what it must act, in words.
    """

    behind_output: ClassVar[bool] = False
    needs: ClassVar[str] = ""

    def channels(self, plant: Plant) -> tuple[str, ...]:
        return plant.outputs

    def streams(self, plant: Plant, output: int) -> tuple[int, ...]:
        """Indices of the inputs that carry a stream from one copy into the next; () for none."""
        del plant, output
        return ()

    @property
    def start_weights(self) -> tuple[float, ...]:
        """How its states start in a run: one with the weight one anywhere.

        Others start in proportion to the last one before them with the weight one.
        """
        return (1.0,) * self.states

    def outputs_along(
        self, y: Float[np.ndarray, "runs time"], period: float, shape: np.ndarray
    ) -> Float[np.ndarray, "runs time"] | None:
        """The measured output along runs, for a score test of free runs; None without a formula.

        Args:
            y: the output of the model at the samples.
            period: of the samples [s].
            shape: the shape parameters.
        """
        del y, period, shape
        return None

    def model_output(self, y: Any, z: Any, shape: Any) -> Any:
        """The output of the model with its derivatives, shape (r,), behind which it stands.

        Args:
            y: the measured output with its derivatives, shape (r,).
            z: internal states of the effect, shape (states,).
            shape: the shape parameters.
        """
        del z, shape
        return y

    @abstractmethod
    def slope(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        """The highest derivative of the measured output.

        Args:
            model: y^(r) of the model at its output with derivatives, shape (r,), and with the
                stream, or (False) where it stands still.
            y: the measured output with its derivatives, shape (r,).
            z: internal states of the effect, shape (states,).
            shape: the shape parameters.
        """

    def rates(self, model: Callable[[Any, bool], Any], y: Any, z: Any, shape: Any) -> Any:
        """dz/dt of the internal states, shape (states,); nothing where it has none.

        Args:
            model: as of `slope`.
            y: the measured output with its derivatives, shape (r,).
            z: internal states of the effect, shape (states,).
            shape: the shape parameters.
        """
        del model, y, shape
        return z


def internal_names(plant: Plant, added: int = 0) -> tuple[str, ...]:
    """Names of a plant's internal states: `internal.states` as far as defined, else numbered.

    Args:
        plant: any.
        added: number of states of effects behind its own.
    """
    named = getattr(plant.internal, "states", None) or ()
    count = len(plant.initial_internal) - len(named) + added
    taken = {*plant.names, *plant.inputs, *plant.outputs, *named}
    return (*named, *numbered_states(taken, len(named), count))


def mechanical(plant: Plant, output: int) -> bool:
    """Whether the output is a position: its velocity is a state."""
    return plant.degrees[output] >= 2


def sticks(plant: Plant, output: int) -> bool:
    """Whether dry friction acts on the output, or with its velocity."""
    return bool(plant.jumps[output].any() or plant.jumps[:, output].any())


def turns(values: Float[np.ndarray, " samples"], share: float = 0.01) -> bool:
    """Whether a signal takes both signs, like a speed and unlike a level.

    Args:
        values: of the signal.
        share: of the samples that must have each sign; fewer are noise around zero.
    """
    return bool(min(np.mean(values > 0), np.mean(values < 0)) > share)


def _has_three_levels(values: Float[np.ndarray, " samples"]) -> bool:
    """Whether a signal takes more than two values, apart from rounding."""
    rounding = 1e-9 * np.max(np.abs(values), initial=0.0)
    ends = np.min(values, initial=np.inf), np.max(values, initial=-np.inf)
    return bool(np.any(np.min([np.abs(values - end) for end in ends], axis=0) > rounding))


def _changes_sign(
    values: Float[np.ndarray, " samples"], noise: float, times: float = 3.0, share: float = 0.1
) -> bool:
    """Whether a signal takes both signs beyond noise around zero.

    Args:
        values: of the signal.
        noise: its standard deviation, at most.
        times: so many of it, of which normal noise exceeds a sample of a thousand.
        share: of the largest size, that is taken for noise: where samples are far apart the noise
            that is read off them is motion.
    """
    size = float(np.max(np.abs(values), initial=0.0))
    edge = min(times * noise, share * size)
    return turns(np.where(np.abs(values) <= edge, 0.0, values))


def quantiles(values: Float[np.ndarray, " samples"], shares: Any) -> Grid:
    """Quantiles of the samples, as a grid of one shape parameter."""
    return np.unique(np.quantile(values, shares))[:, None]
