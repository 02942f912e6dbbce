"""An effect that contains a simpler one must do better in free runs, not in the residual alone.

The residual of a few samples around rest is all that tells Stribeck friction from dry friction of
one level: a spike narrower than the motion of one sample fits what the smoothing of the states
does there. A free run has no smoothed states, and says whether the wider law is worth anything.
Asymmetric friction, read as a level and an offset, contains the level alone.
"""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from eoi_jax.estimation.identify import Identification
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import ConstantOffset, CoulombFriction
from eoi_jax.models.effects.effect import AbstractEffect, AbstractTerm
from eoi_jax.models.plant import Plant

# An offset beside dry friction is none within so many standard errors, or below this share of it.
_SURE, _SHARE = 2.0, 1e-2


def simpler(
    declared: Plant,
    found: Identification,
    placed: Sequence[Placed],
    library: Sequence[AbstractEffect],
) -> Iterator[tuple[Placed, Plant, tuple[Placed, ...]]]:
    """Each effect that contains a single other one; the model with that in its place.

    Args:
        declared: the plant without effects.
        found: the estimate with them.
        placed: the effects.
        library: where the simpler ones are.
    """
    for i, one in enumerate(placed):
        others = (*placed[:i], *placed[i + 1 :])
        if _is_no_offset(found, one, others):
            yield one, _rebuilt(declared, found.plant, others, {}), others
        for effect in library:
            if isinstance(effect, AbstractTerm) and one.effect.contains == (effect.name,):
                plain = place(declared, effect, one.channel, one.against, one.through)
                if plain.site not in {other.site for other in others}:
                    new = (*placed[:i], plain, *placed[i + 1 :])
                    names = dict(zip(plain.names, one.names, strict=False))  # gains for gains
                    yield one, _rebuilt(declared, found.plant, new, names), new


def _is_no_offset(found: Identification, one: Placed, others: Sequence[Placed]) -> bool:
    """Whether it is an offset beside dry friction that may as well be zero."""
    if not isinstance(one.effect, ConstantOffset):
        return False
    (name,) = one.names
    value, error = abs(found.parameters[name]), found.standard_errors[name]
    levels = [
        found.parameters[other.names[0]]
        for other in others
        if isinstance(other.effect, CoulombFriction) and other.site[1:] == one.site[1:]
    ]
    return any(value < max(_SURE * error, _SHARE * level) for level in levels)


def _rebuilt(
    declared: Plant, whole: Plant, placed: Sequence[Placed], names: Mapping[str, str]
) -> Plant:
    """The plant with other effects, from the values that it has, some under other names."""
    values = whole.parameters
    values |= {new: values[old] for new, old in names.items()}
    pairs = zip(whole.lower, whole.upper, strict=True)
    bounds = {
        name: (float(low), float(high))
        for name, (low, high) in zip(whole.names, pairs, strict=True)
    }
    plant = augmented(declared, placed, values, bounds)
    return plant.with_parameters(np.array([values[name] for name in plant.names]))
