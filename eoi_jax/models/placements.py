"""Places where an effect can act on a plant: outputs, inputs, internal states, pairs of outputs."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from eoi_jax.models.augmented import Placed, added_effects, own_states, place
from eoi_jax.models.effects.effect import (
    INPUT_EFFECTS,
    AbstractActuator,
    AbstractEffect,
    AbstractInternalEffect,
    AbstractParameterEffect,
    AbstractTerm,
)
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import used_inputs


def position_text(channel: str, against: str = "", through: str = "") -> str:
    """Where an effect acts, in words: ``x1``, ``x1 towards x2``, ``x1 beside force``.

    Args:
        channel: the output, input or internal state.
        against: the reference of its displacement; "" for none.
        through: the input together with which it acts; "" for none.
    """
    if against:
        return f"{channel} towards {against}"
    return f"{channel} beside {through}" if through else channel


def ends(plant: Plant, placed: Placed) -> tuple[str, str]:
    """Names of an effect's reference output and of the input that it acts with; "" for none."""
    return (
        "" if placed.against is None else plant.outputs[placed.against],
        "" if placed.through is None else plant.inputs[placed.through],
    )


def placed_label(plant: Plant, placed: Placed) -> str:
    """An effect as no other candidate of the plant is called: ``end_stop (above) at x1``."""
    return f"{placed.effect.label}{place_text(plant, placed)}"


def place_text(plant: Plant, placed: Placed) -> str:
    """Where an effect acts, as the end of a phrase; "" where there is one place only."""
    channels, pair = placed.effect.channels(plant), ends(plant, placed)
    place = position_text(channels[placed.channel], *pair)
    return f" at {place}" if len(channels) > 1 or placed.on_state or any(pair) else ""


def placements(plant: Plant, effects: Sequence[AbstractEffect]) -> list[Placed]:
    """Every effect at every channel to which it applies.

    A parameter depends once on a signal. An input that only changes parameters is no actuator.
    """
    placed, coupled = [], plant.coupled
    dependences = [item.effect for item in added_effects(plant)
                   if isinstance(item.effect, AbstractParameterEffect)]  # fmt: skip
    kinds = {effect.kind for effect in dependences}
    drives = _drives(plant) if dependences else np.ones(len(plant.inputs), dtype=bool)
    for effect in effects:
        if effect.kind in kinds:
            continue
        if isinstance(effect, INPUT_EFFECTS):
            drivers = [(i, j) for i, j in _drivers(plant, effect)
                       if drives[i] and effect.fits(plant, i)]  # fmt: skip
            placed += [place(plant, effect, i, None, j) for i, j in drivers]
        else:
            inner = isinstance(effect, AbstractInternalEffect)
            count = own_states(plant) if inner else len(plant.outputs)
            placed += [place(plant, effect, j) for j in range(count) if _fits(plant, effect, j)]
            placed += [place(plant, effect, *pair) for pair in _joints(plant, effect)]
            placed += [place(plant, effect, j, None, i) for j, i in _forces(plant, effect, coupled)]
    return placed


def _drives(plant: Plant) -> Bool[np.ndarray, " nu"]:
    """Which inputs do more in a plant than to change parameters."""
    slopes = {
        name: 0.0
        for item in added_effects(plant)
        if isinstance(item.effect, AbstractParameterEffect)
        for name in item.names
    }
    return np.any(used_inputs(plant.with_parameters(slopes)), axis=0)


def _drivers(plant: Plant, effect: AbstractEffect) -> list[tuple[int, int | None]]:
    """Each input with each one that may drive an effect on it; with None where none does."""
    count = len(plant.inputs)
    if isinstance(effect, AbstractActuator) and effect.has_driver:
        pairs = itertools.product(range(count), repeat=2)
        return [(i, j) for i, j in pairs if i != j or effect.drives_itself]
    return [(i, None) for i in range(count)]


def _fits(plant: Plant, effect: AbstractEffect, channel: int) -> bool:
    """Whether an effect may act at an output or an internal state.

    An output of relative degree 0 is no state and has no velocity: what depends on them is an
    effect of a state, which it shows, and not of the output.
    """
    on_output = isinstance(effect, AbstractTerm)
    stateless = on_output and plant.degrees[channel] == 0 and effect.depends_on in ("y", "v")
    return not stateless and effect.fits(plant, channel)


def _joints(plant: Plant, effect: AbstractEffect) -> list[tuple[int, int]]:
    """Ordered pairs of outputs of the same kind between which an effect may act.

    The effect pushes both apart; its size depends on the mass of each, so each has a separate gain.
    """
    if not (isinstance(effect, AbstractTerm) and effect.joins):
        return []
    kinds = [
        (degree, plant.units.get(name))
        for degree, name in zip(plant.degrees, plant.outputs, strict=True)
    ]
    return [
        (i, j)
        for i, j in itertools.permutations(range(len(kinds)), 2)
        if kinds[i] == kinds[j] and _fits(plant, effect, i)
    ]


def _forces(
    plant: Plant, effect: AbstractEffect, coupled: Bool[np.ndarray, "ny nu"]
) -> list[tuple[int, int]]:
    """Pairs of an output and an input whose path an effect may share as a force.

    With masses coupled by inertia an input pushes several of them, and so does friction of a mass.
    """
    if not isinstance(effect, AbstractTerm):
        return []
    return [(j, i) for j, i in np.argwhere(coupled).tolist() if effect.fits(plant, j)]
