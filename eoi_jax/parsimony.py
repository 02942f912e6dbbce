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
from eoi_jax.validate import FreeRuns

_AS_GOOD = 1.01  # error of the simpler law over that of the wider one, up to which it is preferred


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


def as_good(plain: FreeRuns, wide: FreeRuns) -> bool:
    """Whether neither whole nor short free runs of the simpler model miss by more.

    By the geometric mean over the outputs: a fit anew moves all of them a little.
    """
    pairs = [(one, other) for one, other in zip(plain, wide, strict=True) if one and other]
    ratios = [np.maximum(one.rmse, 1e-300) / np.maximum(other.rmse, 1e-300) for one, other in pairs]
    return all(bool(np.mean(np.log(ratio)) <= np.log(_AS_GOOD)) for ratio in ratios)
