"""An effect that contains a simpler one must do better in free runs, not in the residual alone.

The residual of a few samples around rest is all that tells Stribeck friction from dry friction of
one level: a spike narrower than the motion of one sample fits what the smoothing of the states
does there. A free run has no smoothed states, and says whether the wider law is worth anything.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from eoi_jax.augment import Placed, augmented, place
from eoi_jax.effects.effect import AbstractEffect, AbstractTerm
from eoi_jax.plants.plant import Plant


def simpler(
    declared: Plant, whole: Plant, placed: Sequence[Placed], library: Sequence[AbstractEffect]
) -> Iterator[tuple[Placed, Plant, tuple[Placed, ...]]]:
    """Each effect that contains a single other one; the model with that in its place.

    Args:
        declared: the plant without effects.
        whole: the plant with them.
        placed: the effects.
        library: where the simpler ones are.
    """
    for i, one in enumerate(placed):
        for effect in library:
            if isinstance(effect, AbstractTerm) and one.effect.contains == (effect.name,):
                plain = place(declared, effect, one.channel, one.against, one.through)
                others = (*placed[:i], *placed[i + 1 :])
                if plain.site not in {other.site for other in others}:
                    new = (*placed[:i], plain, *placed[i + 1 :])
                    yield one, _replaced(declared, whole, new, (one, plain)), new


def _replaced(
    declared: Plant, whole: Plant, placed: Sequence[Placed], exchanged: tuple[Placed, Placed]
) -> Plant:
    """The plant with other effects, from the values that it has: first gains for first gains."""
    old, new = exchanged
    values = whole.parameters
    values |= dict(zip(new.names, (values[name] for name in old.names), strict=False))
    pairs = zip(whole.lower, whole.upper, strict=True)
    bounds = {
        name: (float(low), float(high))
        for name, (low, high) in zip(whole.names, pairs, strict=True)
    }
    plant = augmented(declared, placed, values, bounds)
    return plant.with_parameters(np.array([values[name] for name in plant.names]))
