"""A plant plus effects is a plant: discovery wraps a model, it never edits one.

    y^(r) = f(t, x, ψ(u); θ) + Σ effect terms        ż = g(t, x, ψ(u); θ) + Σ effect terms

The effects' own parameters are ordinary parameters of the new plant, their own states internal
states behind the plant's; identify, validate, simulate take it like any other. Delays and lags of
an input come first, as the plant's actuator; what happens to it in an instant, in f and g.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp

from eoi_jax._checks import check
from eoi_jax.models.effects.effect import (
    INPUT_EFFECTS,
    AbstractActuator,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractTerm,
    At,
)
from eoi_jax.models.plant import (
    Actuator,
    Dynamics,
    Plant,
    State,
    derivative_unit,
    parameter_type,
    quotient_unit,
    velocity_rows,
)


@dataclass(frozen=True)
class Placed:
    """One effect at one channel of a plant, with the names of its parameters there.

    Attributes:
        effect: what.
        channel: index of the output, the input or the internal state that it acts on.
        names: of its parameters, gains first, in the augmented plant.
        row: of `State.y` that holds the velocity of the output.
        against: index of the output from which its displacement is counted, of an effect between
            two of them; None for the displacement of the output itself.
        through: index of the input beside which it acts as a force, on all outputs that the input
            pushes; None where it adds to y^(r) of its output alone.
    """

    effect: AbstractEffect
    channel: int
    names: tuple[str, ...]
    row: int = 1
    against: int | None = None
    through: int | None = None

    @property
    def on_input(self) -> bool:
        """Whether it acts on an input."""
        return isinstance(self.effect, INPUT_EFFECTS)

    @property
    def on_state(self) -> bool:
        """Whether it acts on an internal state."""
        return isinstance(self.effect, AbstractInternalEffect)

    @property
    def output(self) -> int:
        """Index of the output that it shows in: of inputs and internal states the first one."""
        return 0 if self.on_input or self.on_state else self.channel

    @property
    def site(self) -> tuple[AbstractEffect, int, int | None, int | None]:
        """What it is and where, whatever its parameters are called."""
        return self.effect, self.channel, self.against, self.through

    def coordinate(self, y: Any) -> Any:
        """What it sees of the outputs (last axis), or of their derivatives."""
        own = y[..., self.output]
        return own if self.against is None else own - y[..., self.against]


def place(
    plant: Plant,
    effect: AbstractEffect,
    channel: int,
    against: int | None = None,
    through: int | None = None,
) -> Placed:
    """An effect at a channel, with parameter names that are free in the plant.

    Named as the effect and its part; with several channels, and at internal states, also as the
    channel, as the output that its displacement is counted from, and as the input beside which it
    acts.
    """
    channels = effect.channels(plant)
    several = len(channels) > 1 or isinstance(effect, AbstractInternalEffect)
    suffix = f"_{channels[channel]}" if several else ""
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
    return Placed(effect, channel, tuple(names), row, against, through)


def augmented(
    plant: Plant,
    placed: Sequence[Placed],
    values: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> Plant:
    """The plant with effects added.

    Args:
        plant: the model that lacks them.
        placed: what is added, and where; input effects act in this order.
        values: of the effects' parameters, by their placed names.
        bounds: of some of them, where the effect's own are too wide.

    Returns:
        A plant with the parameters of both, the effects' ones behind.
    """
    if not placed:
        return plant
    nz = len(plant.initial_internal)
    own = plant.names
    several = tuple(placed)
    states = sum(one.effect.states for one in several)
    limits = {
        key: (float(low), float(high))
        for key, low, high in zip(plant.names, plant.lower, plant.upper, strict=True)
    }
    units = plant.units
    for one in several:
        for name, parameter in zip(one.names, one.effect.parameters, strict=True):
            limits[name] = (bounds or {}).get(name, (parameter.lower, parameter.upper))
            units[name] = unit(plant, one, parameter.unit)
    added = {name: float(values[name]) for one in several for name in one.names}
    moving = states + nz > 0
    slow = any(isinstance(one.effect, AbstractActuator) for one in several)
    return Plant(
        _Dynamics(plant.dynamics, own, several, nz),
        {**plant.parameters, **added},
        relative_degree=plant.degrees,
        inputs=plant.inputs,
        outputs=plant.outputs,
        internal=_Internal(plant.internal, own, several, nz) if moving else None,
        internal_initial=_Start(plant.internal_initial, own, states) if moving else None,
        bounds=limits,
        fixed=plant.fixed,
        units=units,
        name=plant.name,
        actuator=_Actuator(plant.actuator, own, several) if slow or plant.actuator else None,
    )


def acting(placed: Sequence[Placed]) -> Actuator:
    """What inputs go through on their way, of delays and lags alone.

    Args:
        placed: effects that are actuators, in the order in which an input meets them.
    """
    return _Actuator(None, (), tuple(placed))


def actuators(plant: Plant) -> tuple[Placed, ...]:
    """The delays and lags that a plant's inputs go through, in the order in which they meet them.

    Raises:
        ValueError: an actuator that is a function of the user's own.
    """
    found: list[Placed] = []
    actuator = plant.actuator
    while isinstance(actuator, _Actuator):
        found += [one for one in actuator.placed if isinstance(one.effect, AbstractActuator)]
        actuator = actuator.base
    rule = "must be made of the effects input_delay and actuator_lag"
    check(actuator is None, "actuator", rule, "a function of its own")
    return tuple(found)


def own_states(plant: Plant) -> int:
    """Number of internal states that the declared plant has: without those of effects."""
    start, count = plant.internal_initial, len(plant.initial_internal)
    while isinstance(start, _Start):
        start, count = start.base, count - start.states
    return count


def unit(plant: Plant, placed: Placed, pattern: str) -> str:
    """The unit of an effect's parameter at its channel; "" where the plant declares none."""
    j = placed.channel
    own = placed.effect.channels(plant)[j]
    y = "" if placed.on_input else plant.units.get(own, "")
    channel = j if placed.on_input else 0
    u = plant.units.get(plant.inputs[channel], "") if plant.inputs else ""
    v = derivative_unit(y, placed.row)
    if placed.through is None:
        order = 1 if placed.on_input or placed.on_state else plant.degrees[j]
        f = derivative_unit(y, order)
        over = derivative_unit("1", order), derivative_unit("1", order - placed.row)
    else:
        f = plant.units.get(plant.inputs[placed.through], "")
        over = quotient_unit(f, y), quotient_unit(f, v)
    known = {"y": y, "v": v, "f": f, "u": u, "f/y": over[0], "f/v": over[1]}
    if any(f"{{{key}}}" in pattern and not value for key, value in known.items()):
        return ""
    return pattern.format(**known)


@dataclass(frozen=True)
class _Dynamics:
    """f of the augmented plant; equal (and compiled once) for equal plants and effects."""

    base: Dynamics
    names: tuple[str, ...]
    placed: tuple[Placed, ...]
    nz: int

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        changed = _forced(self, t, x, _inputs(self, t, x, u, p), u, p)
        f = jnp.asarray(self.base(t, State(x.y, x.z[: self.nz]), changed, _own(self.names, p)))
        f = jnp.reshape(f, (x.y.shape[1],))
        for one, z in _own_states(self.placed, x.z[self.nz :]):
            if one.through is not None:
                continue
            if isinstance(one.effect, AbstractTerm | AbstractInternalEffect):
                gain, shape = _parameters(one, p)
                f = f.at[one.output].add(one.effect.term(_at(one, t, x, u, z), gain, shape))
        return f


@dataclass(frozen=True)
class _Internal:
    """g of the augmented plant."""

    base: Dynamics | None
    names: tuple[str, ...]
    placed: tuple[Placed, ...]
    nz: int

    @property
    def states(self) -> tuple[str, ...] | None:
        """Names of the internal states, where the declared plant has names for its own."""
        own = getattr(self.base, "states", None)
        count = self.nz + sum(one.effect.states for one in self.placed)
        return None if own is None else own + tuple(f"z{i + 1}" for i in range(self.nz, count))

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        rates = []
        if self.base is not None:
            changed = _inputs(self, t, x, u, p)
            rate = self.base(t, State(x.y, x.z[: self.nz]), changed, _own(self.names, p))
            rate = jnp.reshape(jnp.asarray(rate), (self.nz,))
            for one in self.placed:
                if isinstance(one.effect, AbstractInternalEffect):
                    at, (_, shape) = _at(one, t, x, u, x.z[:0]), _parameters(one, p)
                    rate = rate.at[one.channel].add(one.effect.change(at, shape))
            rates.append(rate)
        at_input = u
        for one, z in _own_states(self.placed, x.z[self.nz :]):
            _, shape = _parameters(one, p)
            at = _at(one, t, x, at_input, z)
            if one.effect.states:
                rates.append(jnp.reshape(one.effect.rate(at, shape), (one.effect.states,)))
            if isinstance(one.effect, AbstractInputEffect):
                at_input = at_input.at[one.channel].set(one.effect.changed(at, shape))
        return jnp.concatenate(rates)


@dataclass(frozen=True)
class _Actuator:
    """What inputs go through before f and g: the new effects, then the plant's own."""

    base: Actuator | None
    names: tuple[str, ...]
    placed: tuple[Placed, ...]

    def __call__(self, t: Any, u: Any, p: Any) -> Any:
        for one in self.placed:
            if isinstance(one.effect, AbstractActuator):
                _, shape = _parameters(one, p)
                u = u.at[:, one.channel].set(one.effect.along(t, u[:, one.channel], shape))
        return u if self.base is None else self.base(t, u, _own(self.names, p))


@dataclass(frozen=True)
class _Start:
    """Internal states at the start: the plant's own, then zeros."""

    base: Any
    names: tuple[str, ...]
    states: int

    def __call__(self, p: Any) -> Any:
        own = self.base(_own(self.names, p)) if callable(self.base) else self.base
        own = jnp.reshape(jnp.asarray(own, dtype=jnp.result_type(float)), (-1,))
        return jnp.concatenate([own, jnp.zeros(self.states, own.dtype)])


def _own(names: tuple[str, ...], p: Any) -> Any:
    """The declared model's parameters, as it knows them."""
    return parameter_type(names)(*(getattr(p, name) for name in names))


def _inputs(model: _Dynamics | _Internal, t: Any, x: State, u: Any, p: Any) -> Any:
    for one, z in _own_states(model.placed, x.z[model.nz :]):
        if isinstance(one.effect, AbstractInputEffect):
            _, shape = _parameters(one, p)
            u = u.at[one.channel].set(one.effect.changed(_at(one, t, x, u, z), shape))
    return u


def _forced(model: _Dynamics, t: Any, x: State, inputs: Any, u: Any, p: Any) -> Any:
    """Inputs with the forces beside them; an effect sees the inputs u as they are measured."""
    for one, z in _own_states(model.placed, x.z[model.nz :]):
        if isinstance(one.effect, AbstractTerm) and one.through is not None:
            gain, shape = _parameters(one, p)
            force = one.effect.term(_at(one, t, x, u, z), gain, shape)
            inputs = inputs.at[one.through].add(force)
    return inputs


def _own_states(placed: tuple[Placed, ...], z: Any) -> list[tuple[Placed, Any]]:
    parts, first = [], 0
    for one in placed:
        parts.append((one, z[first : first + one.effect.states]))
        first += one.effect.states
    return parts


def _parameters(one: Placed, p: Any) -> tuple[list[Any], list[Any]]:
    values = [getattr(p, name) for name in one.names]
    count = len(one.effect.gains)
    return values[:count], values[count:]


def _at(one: Placed, t: Any, x: State, u: Any, z: Any) -> At:
    y = one.coordinate(x.y)
    rate = y[one.row] if one.row < x.y.shape[0] else jnp.zeros_like(y[0])
    # A plant may have no input at all.
    own = u[one.channel if one.on_input else 0] if u.shape[0] else jnp.zeros_like(y[0])
    return At(t, x.z[one.channel] if one.on_state else y[0], rate, own, z)
