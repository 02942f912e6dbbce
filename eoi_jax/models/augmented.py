"""Augmented plants: a plant with effects added is a plant; the model itself is never edited.

    y^(r) = f(t, x, ψ(u); θ) + Σ effect terms        ż = g(t, x, ψ(u); θ) + Σ effect terms

The parameters of the effects are ordinary parameters of the new plant. Their states are internal
states that follow those of the plant. Delays and lags of an input form the actuator of the plant;
static input effects act within f and g. What is connected in series (`cascade.py`) has all other
effects within it, also those that are added later.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check
from eoi_jax._types import WHERE_SET
from eoi_jax.models.actuators import are_linear, changed_inputs, have_past, keeps_steps
from eoi_jax.models.cascade import Cascade, Stage
from eoi_jax.models.effects.effect import (
    INPUT_EFFECTS,
    AbstractActuator,
    AbstractCascade,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractParameterEffect,
    AbstractTerm,
    At,
)
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.plant import Actuator, Dynamics, Plant, State
from eoi_jax.models.units import derivative_unit, quotient_unit
from eoi_jax.models.velocities import velocity_rows


@dataclass(frozen=True)
class Placed:
    """An effect at a channel of a plant, with the names of its parameters.

    Attributes:
        effect: the effect.
        channel: index of the output, the input or the internal state on which the effect acts.
        names: names of its parameters in the augmented plant, gains first.
        row: row of `State.y` that holds the velocity of the output.
        against: for an effect between two outputs, index of the output from which the displacement
            is measured; None for the displacement of a single output.
        through: index of the input whose path the effect shares as a force, on all outputs that
            the input pushes; None if the effect adds to y^(r) of its output only. Of an effect on
            an input with a driver, the index of that.
        streams: of copies in series, indices of the inputs that carry the stream.
    """

    effect: AbstractEffect
    channel: int
    names: tuple[str, ...]
    row: int = 1
    against: int | None = None
    through: int | None = None
    streams: tuple[int, ...] = field(default=(), metadata=WHERE_SET)

    @property
    def on_input(self) -> bool:
        """Whether the effect acts on an input."""
        return isinstance(self.effect, INPUT_EFFECTS)

    @property
    def on_state(self) -> bool:
        """Whether the effect acts on an internal state."""
        return isinstance(self.effect, AbstractInternalEffect)

    @property
    def output(self) -> int:
        """Index of the output in which the effect shows: 0 for inputs and internal states."""
        return 0 if self.on_input or self.on_state else self.channel

    @property
    def site(self) -> tuple[AbstractEffect, int, int | None, int | None]:
        """Effect and place, without the names of the parameters."""
        return self.effect, self.channel, self.against, self.through

    @property
    def kind_site(self) -> tuple[str, int, int | None, int | None]:
        """Kind of the effect and place, whatever its shape."""
        return self.effect.kind, *self.site[1:]

    def drives(self, u: Any) -> Any:
        """The input that it acts on, from all inputs (last axis); with its driver two columns."""
        places = self.channel if self.through is None else np.array([self.channel, self.through])
        return u[..., places]

    def coordinate(self, y: Any) -> Any:
        """The displacement for the effect, from the outputs (last axis) or their derivatives."""
        displacement = y[..., self.output]
        return displacement if self.against is None else displacement - y[..., self.against]


def place(
    plant: Plant,
    effect: AbstractEffect,
    channel: int,
    against: int | None = None,
    through: int | None = None,
) -> Placed:
    """An effect at a channel, with parameter names that the plant does not use yet.

    A name consists of the effect's and the parameter's names; for several channels and at internal
    states also of the channel, the output from which the displacement is measured, and the input
    whose path the effect shares.
    """
    if isinstance(effect, AbstractCascade):
        good = effect.fits(plant, channel)
        rule, output = f"must act on {effect.needs}", f"{plant.outputs[channel]} of {plant.name}"
        check(good, effect.name, rule, output)
    channels = effect.channels(plant)
    suffixed = len(channels) > 1 or isinstance(effect, AbstractInternalEffect)
    suffix = f"_{channels[channel]}" if suffixed else ""
    suffix += "" if against is None else f"_{channels[against]}"
    suffix += "" if through is None else f"_{plant.inputs[through]}"
    names = []
    for parameter in effect.parameters:
        name = "_".join(filter(None, (effect.name, parameter.name))) + suffix
        base, count = name, 2
        while name in plant.names:
            name, count = f"{base}_{count}", count + 1
        names.append(name)
    on_output = isinstance(effect, AbstractTerm)
    row = velocity_rows(plant.degrees)[channel] if on_output else 1
    streams = effect.streams(plant, channel) if isinstance(effect, AbstractCascade) else ()
    return Placed(effect, channel, tuple(names), row, against, through, streams)


def augmented(
    plant: Plant,
    placed: Sequence[Placed],
    values: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    idle: Mapping[str, float] | None = None,
) -> Plant:
    """The plant with effects added.

    Args:
        plant: the model without the effects.
        placed: the effects at their channels; input effects act in this order.
        values: of the effects' parameters, by their names in the augmented plant.
        bounds: for some of these parameters, in place of the bounds that the effects declare.
        idle: further parameters by name, which no function of the plant reads.

    Returns:
        A plant with the parameters of the model, followed by those of the effects.
    """
    if not placed and not idle:
        return plant
    rule = "must have no states that change at samples for effects to be added"
    check(plant.sampled is None, "plant", rule, plant.name)
    nz = len(plant.initial_internal)
    declared_names = plant.names
    placements = tuple(placed)
    states = sum(placement.effect.states for placement in placements)
    limits = {
        key: (float(low), float(high))
        for key, low, high in zip(plant.names, plant.lower, plant.upper, strict=True)
    }
    units = plant.units
    for placement in placements:
        for name, parameter in zip(placement.names, placement.effect.parameters, strict=True):
            limits[name] = (bounds or {}).get(name, parameter.bounds(float(values[name])))
            units[name] = unit(plant, placement, parameter.unit)
    added = {name: float(values[name]) for placement in placements for name in placement.names}
    added |= idle or {}
    moving = states + nz > 0
    everything = [placement.effect for placement in (*added_effects(plant), *placements)]
    cascaded = any(isinstance(effect, AbstractCascade) for effect in everything)
    following = cascaded or any(effect.follows_slope for effect in everything)
    slow = any(isinstance(placement.effect, AbstractActuator) for placement in placements)
    degrees = plant.degrees if cascaded else ()
    dynamics = _Dynamics(plant.dynamics, declared_names, placements, nz, degrees)
    followed = (dynamics, plant.degrees) if following else (None, ())
    return Plant(
        dynamics,
        {**plant.parameters, **added},
        relative_degree=plant.degrees,
        inputs=plant.inputs,
        outputs=plant.outputs,
        internal=_Internal(plant.internal, declared_names, placements, nz, *followed)
        if moving
        else None,
        internal_initial=_Start(
            plant.internal_initial, declared_names, states, _start_weights(placements)
        )
        if moving
        else None,
        bounds=limits,
        fixed=plant.fixed,
        units=units,
        kinds=dict(plant.kind_items),
        initial=plant.initial,
        name=plant.name,
        actuator=_Actuator(plant.actuator, declared_names, placements)
        if slow or plant.actuator
        else None,
    )


def acting(placed: Sequence[Placed]) -> Actuator:
    """The actuator of a plant that consists of delays and lags only.

    Args:
        placed: actuator effects, in the order in which they act on an input.
    """
    return _Actuator(None, (), tuple(placed))


def actuator_effects(plant: Plant, rule: str) -> tuple[Placed, ...]:
    """The effects that form the actuator of a plant, in the order in which they act.

    Args:
        plant: with an actuator, or without.
        rule: that the actuator must be made of effects, in words.

    Raises:
        ValueError: an actuator that is a user's function.
    """
    placed: list[Placed] = []
    actuator = plant.actuator
    while isinstance(actuator, _Actuator):
        placed += [
            placement
            for placement in actuator.placed
            if isinstance(placement.effect, AbstractActuator)
        ]
        actuator = actuator.base
    check(actuator is None, "actuator", rule, "a function of its own")
    return tuple(placed)


def added_effects(plant: Plant) -> tuple[Placed, ...]:
    """Effects that were added to a plant, the first one first."""
    placed: list[Placed] = []
    dynamics = plant.dynamics
    while isinstance(dynamics, _Dynamics):
        placed = [*dynamics.placed, *placed]
        dynamics = dynamics.base
    return tuple(placed)


def own_states(plant: Plant) -> int:
    """Number of internal states of the declared plant, without those of effects."""
    start, count = plant.internal_initial, len(plant.initial_internal)
    while isinstance(start, _Start):
        start, count = start.base, count - start.states
    return count


def slope_followers(plant: Plant) -> Float[np.ndarray, "nz ny"]:
    """By how much internal states fall when an output is set higher: differences from an output."""
    falls, first = np.zeros((len(plant.initial_internal), len(plant.outputs))), own_states(plant)
    for placement in added_effects(plant):
        states = slice(first, first + placement.effect.states)
        if placement.effect.follows_slope:
            falls[states] = placement.coordinate(np.eye(len(plant.outputs)))
        first = states.stop
    return falls


def unit(plant: Plant, placed: Placed, pattern: str) -> str:
    """The unit of an effect's parameter at its channel; "" if the plant declares no units."""
    j = placed.channel
    channel_name = placed.effect.channels(plant)[j]
    y = "" if placed.on_input else plant.units.get(channel_name, "")
    channel = j if placed.on_input else 0
    u = plant.units.get(plant.inputs[channel], "") if plant.inputs else ""
    v = derivative_unit(y, placed.row)
    if placed.through is None:
        order = 1 if placed.on_input or placed.on_state else plant.degrees[j]
        f = derivative_unit(y, order)
        quotients = derivative_unit("1", order), derivative_unit("1", order - placed.row)
    else:
        f = plant.units.get(plant.inputs[placed.through], "")
        quotients = quotient_unit(f, y), quotient_unit(f, v)
    units = {"y": y, "v": v, "f": f, "u": u, "f/y": quotients[0], "f/v": quotients[1]}
    if any(f"{{{key}}}" in pattern and not value for key, value in units.items()):
        return ""
    return pattern.format(**units)


def _start_weights(placed: tuple[Placed, ...]) -> tuple[float | None, ...]:
    """Of the states of some effects; () where none has any."""
    weights = itertools.chain.from_iterable(
        placement.effect.start_weights
        if isinstance(placement.effect, AbstractCascade)
        else (None,) * placement.effect.states
        for placement in placed
    )
    stated = tuple(weights)
    return stated if any(weight is not None for weight in stated) else ()


@dataclass(frozen=True)
class _Dynamics:
    """f of the augmented plant; equal (and compiled once) for equal plants and effects."""

    base: Dynamics
    names: tuple[str, ...]
    placed: tuple[Placed, ...]
    nz: int
    degrees: tuple[int, ...] = field(default=(), metadata=WHERE_SET)  # where there is a cascade

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        return self.cascade(t, p).slopes(x, u) if self.degrees else self.direct(t, x, u, p)

    def direct(self, t: Any, x: State, u: Any, p: Any) -> Any:
        """f without what is connected in series."""
        changed = _forced(self, t, x, _inputs(self, t, x, u, p), u, p)
        base = self.base.direct if isinstance(self.base, _Dynamics) else self.base
        f = jnp.asarray(base(t, State(x.y, x.z[: self.nz]), changed, _parameters(self, t, x, u, p)))
        f = jnp.reshape(f, (x.y.shape[1],))
        for placement, z in _split_states(self.placed, x.z[self.nz :]):
            if placement.through is not None:
                continue
            if isinstance(placement.effect, AbstractTerm | AbstractInternalEffect):
                gain, shape = split_parameters(placement, p)
                f = f.at[placement.output].add(
                    placement.effect.term(instant(placement, t, x, u, z), gain, shape)
                )
        return f

    def cascade(self, t: Any, p: Any) -> Cascade:
        """What is connected in series, here and in the model that was augmented."""

        def derivative(x: State, u: Any) -> Any:
            return self.direct(t, x, u, p)

        return Cascade.of(derivative, self._stages(p, self.degrees))

    def _stages(self, p: Any, degrees: tuple[int, ...]) -> list[Stage]:
        stages = self.base._stages(p, degrees) if isinstance(self.base, _Dynamics) else []
        first = self.nz
        for placement in self.placed:
            states, j = slice(first, first + placement.effect.states), placement.channel
            first = states.stop
            if isinstance(placement.effect, AbstractCascade):
                _, shape = split_parameters(placement, p)
                stage = Stage(placement.effect, j, degrees[j], placement.streams, states, shape)
                stages.append(stage)
        return stages


@dataclass(frozen=True)
class _Internal:
    """g of the augmented plant."""

    base: Dynamics | None
    names: tuple[str, ...]
    placed: tuple[Placed, ...]
    nz: int
    dynamics: _Dynamics | None = field(default=None, metadata=WHERE_SET)  # where effects follow it
    degrees: tuple[int, ...] = field(default=(), metadata=WHERE_SET)  # likewise

    @property
    def states(self) -> tuple[str, ...] | None:
        """Names of the first internal states; None if the declared plant does not name its own."""
        return getattr(self.base, "states", None)

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        dynamics = self.dynamics
        if dynamics is None or not dynamics.degrees:

            def highest() -> Any:
                assert dynamics is not None
                return dynamics(t, x, u, p)

            return self.direct(t, x, u, p, lambda: self._first_derivatives(x, highest))
        cascade = dynamics.cascade(t, p)
        inner = cascade.model_state(x)

        def slopes() -> Any:
            return self._first_derivatives(inner, lambda: cascade.slopes_inside(inner, u))

        return cascade.with_rates(self.direct(t, inner, u, p, slopes), x, u)

    def _first_derivatives(self, x: State, highest: Callable[[], Any]) -> Any:
        """First derivatives of the outputs; `highest` gives those of the order r of each."""
        if x.y.shape[0] == 1:
            return highest()
        if 1 not in self.degrees:
            return x.y[1]
        return jnp.where(np.asarray(self.degrees) == 1, highest(), x.y[1])

    def direct(self, t: Any, x: State, u: Any, p: Any, slopes: Callable[[], Any]) -> Any:
        """g without what is connected in series, whose states stand still.

        Args:
            t: time [s].
            x: state in front of all sensors.
            u: inputs.
            p: parameters.
            slopes: gives the first derivatives of the outputs there.
        """
        rates = []
        if self.base is not None:
            changed = _inputs(self, t, x, u, p)
            inner, named = State(x.y, x.z[: self.nz]), _parameters(self, t, x, u, p)
            if isinstance(self.base, _Internal):
                rate = self.base.direct(t, inner, changed, named, slopes)
            else:
                rate = self.base(t, inner, changed, named)
            rate = jnp.reshape(jnp.asarray(rate), (self.nz,))
            for placement in self.placed:
                if isinstance(placement.effect, AbstractInternalEffect):
                    at, (_, shape) = (
                        instant(placement, t, x, u, x.z[:0]),
                        split_parameters(placement, p),
                    )
                    rate = rate.at[placement.channel].add(placement.effect.change(at, shape))
            rates.append(rate)
        at_input = u
        for placement, z in _split_states(self.placed, x.z[self.nz :]):
            _, shape = split_parameters(placement, p)
            at = instant(placement, t, x, at_input, z)
            if placement.effect.follows_slope:
                at = at._replace(slope=placement.coordinate(slopes()))
            if isinstance(placement.effect, AbstractCascade):
                rates.append(jnp.zeros_like(z))
            elif placement.effect.states:
                rates.append(
                    jnp.reshape(placement.effect.rate(at, shape), (placement.effect.states,))
                )
            if isinstance(placement.effect, AbstractInputEffect):
                at_input = at_input.at[placement.channel].set(placement.effect.changed(at, shape))
        return jnp.concatenate(rates)


@dataclass(frozen=True)
class _Actuator:
    """The actuator of the augmented plant: the new effects, then the plant's actuator."""

    base: Actuator | None
    names: tuple[str, ...]
    placed: tuple[Placed, ...]

    def keeps_steps(self, count: int) -> tuple[bool, ...]:
        """Which of the inputs, if held, come out held."""
        return self._all_have("keeps_steps", keeps_steps(self.base, count))

    def are_linear(self, count: int) -> tuple[bool, ...]:
        """In which of the inputs it is linear."""
        return self._all_have("is_linear", are_linear(self.base, count))

    def have_past(self, count: int) -> tuple[bool, ...]:
        """Which of the inputs may act later than they came."""
        acting = {
            column
            for placement in self.placed
            if isinstance(placement.effect, AbstractActuator)
            for column in (placement.channel, placement.through)
        }
        return tuple(flag or i in acting for i, flag in enumerate(have_past(self.base, count)))

    def changed_inputs(self, count: int) -> tuple[int, ...]:
        """Numbers of the inputs that come out other than they went in."""
        changed = {
            placement.channel
            for placement in self.placed
            if isinstance(placement.effect, AbstractActuator)
        }
        return tuple(sorted(changed.union(changed_inputs(self.base, count))))

    def _all_have(self, attribute: str, base: tuple[bool, ...]) -> tuple[bool, ...]:
        """On which inputs the plant's actuator and all new ones have an attribute."""
        without = {
            placement.channel
            for placement in self.placed
            if isinstance(placement.effect, AbstractActuator)
            and not getattr(placement.effect, attribute)
        }
        return tuple(flag and i not in without for i, flag in enumerate(base))

    @property
    def shapes(self) -> tuple[str, ...] | None:
        """Names of all its parameters; None where a part of it is a function of the user's."""
        base = () if self.base is None else getattr(self.base, "shapes", None)
        own = [
            placed.names for placed in self.placed if isinstance(placed.effect, AbstractActuator)
        ]
        return None if base is None else tuple(itertools.chain(base, *own))

    def sampled(
        self, t: Float[np.ndarray, " S"], u: Float[np.ndarray, "S nu"], values: Mapping[str, float]
    ) -> Float[np.ndarray, "S nu"]:
        """As by a call, of measured arrays: NumPy alone, where `shapes` says which values it needs.

        Args:
            t: middles of the steps [s].
            u: means of the inputs over them.
            values: of its parameters, by name.
        """
        for placement in self.placed:
            if isinstance(placement.effect, AbstractActuator):
                shape = np.array([[values[name] for name in placement.names]])
                u = np.array(u)
                u[:, placement.channel] = placement.effect.sampled(t, placement.drives(u), shape)[0]
        return u if self.base is None else self.base.sampled(t, u, values)

    def __call__(self, t: Any, u: Any, p: Any) -> Any:
        for placement in self.placed:
            if isinstance(placement.effect, AbstractActuator):
                _, shape = split_parameters(placement, p)
                u = u.at[:, placement.channel].set(
                    placement.effect.along(t, placement.drives(u), shape)
                )
        return u if self.base is None else self.base(t, u, _declared_parameters(self.names, p))


@dataclass(frozen=True)
class _Start:
    """Internal states at the start: those of the plant, then zeros.

    Attributes:
        cascades: of the effects' states, `AbstractCascade.start_weights`; None of other effects.
    """

    base: Any
    names: tuple[str, ...]
    states: int
    cascades: tuple[float | None, ...] = field(default=(), metadata=WHERE_SET)

    @property
    def weights(self) -> tuple[float | None, ...]:
        """As of `start_weights`."""
        return (*getattr(self.base, "weights", ()), *(self.cascades or (None,) * self.states))

    def __call__(self, p: Any) -> Any:
        declared = (
            self.base(_declared_parameters(self.names, p)) if callable(self.base) else self.base
        )
        declared = jnp.reshape(jnp.asarray(declared, dtype=jnp.result_type(float)), (-1,))
        return jnp.concatenate([declared, jnp.zeros(self.states, declared.dtype)])


def _declared_parameters(names: tuple[str, ...], p: Any) -> Any:
    """The parameters of the declared model, by name."""
    return parameter_type(names)(*(getattr(p, name) for name in names))


def _inputs(model: _Dynamics | _Internal, t: Any, x: State, u: Any, p: Any) -> Any:
    for placement, z in _split_states(model.placed, x.z[model.nz :]):
        if isinstance(placement.effect, AbstractInputEffect):
            _, shape = split_parameters(placement, p)
            u = u.at[placement.channel].set(
                placement.effect.changed(instant(placement, t, x, u, z), shape)
            )
    return u


def _parameters(model: _Dynamics | _Internal, t: Any, x: State, u: Any, p: Any) -> Any:
    """The parameters of the declared model at an instant, by name."""
    values = {name: getattr(p, name) for name in model.names}
    for placement, z in _split_states(model.placed, x.z[model.nz :]):
        effect = placement.effect
        if isinstance(effect, AbstractParameterEffect):
            _, shape = split_parameters(placement, p)
            values[effect.parameter] *= effect.factor(instant(placement, t, x, u, z), shape)
    return parameter_type(model.names)(**values)


def _forced(model: _Dynamics, t: Any, x: State, inputs: Any, u: Any, p: Any) -> Any:
    """Inputs with the forces that share their paths; effects depend on the measured inputs u."""
    for placement, z in _split_states(model.placed, x.z[model.nz :]):
        if isinstance(placement.effect, AbstractTerm) and placement.through is not None:
            gain, shape = split_parameters(placement, p)
            force = placement.effect.term(instant(placement, t, x, u, z), gain, shape)
            inputs = inputs.at[placement.through].add(force)
    return inputs


def _split_states(placed: tuple[Placed, ...], z: Any) -> list[tuple[Placed, Any]]:
    parts, first = [], 0
    for placement in placed:
        parts.append((placement, z[first : first + placement.effect.states]))
        first += placement.effect.states
    return parts


def split_parameters(placement: Placed, p: Any) -> tuple[list[Any], list[Any]]:
    """Values of an effect's gains and of its shapes."""
    values = [getattr(p, name) for name in placement.names]
    count = len(placement.effect.gains)
    return values[:count], values[count:]


def instant(placement: Placed, t: Any, x: State, u: Any, z: Any) -> At:
    """What an effect depends on at its place: time, state, inputs of the plant, its own states."""
    y = placement.coordinate(x.y)
    rate = y[placement.row] if placement.row < x.y.shape[0] else jnp.zeros_like(y[0])
    # A plant may have no input at all.
    input_value = (
        u[placement.channel if placement.on_input else 0] if u.shape[0] else jnp.zeros_like(y[0])
    )
    level = x.z[placement.channel] if placement.on_state else y[0]
    return At(t, level, rate, input_value, z, state=x.y, inputs=u)
