"""Effects in place of a term of the declared model: drag with the square, no viscous friction.

And a loss together with an offset, which go beside its terms.

Along a record the effect and the term may be nearly in proportion. The records of the fit then do
not tell one from the other, nor the size of the effect beside the term; but elsewhere both predict
otherwise. With the effect in place of the term the model has as many parameters as before.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.additions import size_is_known, smallest_values
from eoi_jax.discovery.judge import Judged
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed, added_effects, augmented
from eoi_jax.models.effects import PRODUCTS, ConstantOffset, Leak, LinearStiffness, ViscousFriction
from eoi_jax.models.effects.effect import AbstractEffect, AbstractTerm
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.score_test import LinearisedRuns

_RULES = RULES.free_runs
_SAME = 1.0 - 1e-6  # likeness of a law that the term is itself

Model = tuple[Plant, tuple[Placed, ...]]  # with effects in it, and these
Term = Float[np.ndarray, "runs samples 3 ny"]


def replacements(model: Judged, effects: Sequence[AbstractEffect]) -> list[Model]:
    """Models with an effect in place of a term, which its parameter at zero leaves out.

    Effects of one gain are tried that have most in common with a term along the free runs; those
    first that have more. Losses with offsets follow.

    Args:
        model: refined; what was added to it stays.
        effects: to try.
    """
    plant, runs = model.refinement.plant, LinearisedRuns.from_refinement(model.refinement)
    added = [name for placed in added_effects(plant) for name in placed.names]
    present = {placed.site for placed in model.placed}
    laws = [law for law in placements(plant, effects)
            if _is_law(law) and law.site not in present]  # fmt: skip
    models: list[tuple[float, Model]] = []
    for name, low, high in zip(plant.names, plant.lower, plant.upper, strict=True):
        if name in (*added, *plant.fixed) or not low <= 0.0 <= high:
            continue
        term = runs.contribution(name)
        if not np.all(np.isfinite(term)):
            continue
        for likeness, law, gain in _substitutes(term, laws, runs):
            whole = augmented(plant, (law,), {law.names[0]: gain})
            models.append((likeness, (whole.declared_anew({name: 0.0}, fixed=(name,)), (law,))))
    models.sort(key=lambda item: -item[0])
    replaced = [model for _, model in models[: _RULES.tried]]
    return replaced + _losses_with_offsets(plant, runs, effects)


def _losses_with_offsets(
    plant: Plant, runs: LinearisedRuns, effects: Sequence[AbstractEffect]
) -> list[Model]:
    """Models with a loss and an offset: a leak to a constant level, a damped motion; with a spring.

    Heat goes to the neighbours, to the ground, to a store so large that it stays as it is. From a
    leak alone the level would be the zero of the scale, and from an offset alone the time constants
    would stay: a score test, which holds them, shows neither. What is pushed to one side moves away
    without a friction that holds it back, and a friction alone does not bring it back: free runs of
    a model without both say nothing of its gain, and a score test of that model nothing of either.
    """
    kinds = {kind: [effect for effect in effects if isinstance(effect, kind)]
             for kind in (ConstantOffset, LinearStiffness, Leak, ViscousFriction)}  # fmt: skip
    offsets, springs = (
        {at.output: at for at in placements(plant, kinds[kind])}
        for kind in (ConstantOffset, LinearStiffness)
    )
    losses: dict[int, Placed] = {}
    for loss in placements(plant, [*kinds[Leak], *kinds[ViscousFriction]]):
        if loss.output in offsets and runs.tries(loss):  # none of what the model has already
            losses.setdefault(loss.output, loss)
    sets = [(loss, offsets[output]) for output, loss in losses.items()]
    sets += [(*pair, springs[pair[0].output]) for pair in sets
             if pair[0].output in springs and runs.tries(springs[pair[0].output])]  # fmt: skip
    return [(augmented(plant, placed, _start(placed, runs)), placed) for placed in sets]


def _start(placed: Sequence[Placed], runs: LinearisedRuns) -> dict[str, float]:
    """Where a fit with a loss and an offset begins: a leak to the mean level, of a slow time.

    From none at all a step may end on its bound, and stay there.
    """
    values = {name: value for at in placed for name, value in smallest_values(at).items()}
    loss, offset = placed[:2]
    if isinstance(loss.effect, Leak):
        seen = runs.signal_statistics(loss)
        values[loss.names[0]] = _RULES.slow / seen.duration
        values[offset.names[0]] = values[loss.names[0]] * float(np.mean(seen.measured_y))
    return values


def replaced_terms(declared: Plant, plant: Plant) -> tuple[str, ...]:
    """Parameters of a declared model whose terms an effect has replaced in another one."""
    free = [name for name in declared.names if name not in declared.fixed]
    return tuple(name for name in plant.fixed if name in free)


def fixed_shapes(plant: Plant, placed: Sequence[Placed]) -> tuple[str, ...]:
    """Parameters of effects that are fixed in a plant, for no run tells them."""
    return tuple(name for item in placed for name in item.names if name in plant.fixed)


def turned_terms(base: Judged, model: Judged) -> tuple[str, ...]:
    """Declared parameters whose sign effects have turned, to a value that may as well be zero.

    Beside such an effect the records tell little of the term: a bit of noise makes a damping
    negative, and the rest unstable. The effect has taken its place. The base must know the sign.

    Args:
        base: without the effects.
        model: with them.
    """
    plant, plain_fit, fit = base.refinement.plant, base.refinement, model.refinement
    limits = dict(zip(plant.names, zip(plant.lower, plant.upper, strict=True), strict=True))
    added = [name for placed in added_effects(plant) for name in placed.names]
    names = [name for name in plant.names if name not in (*added, *fit.plant.fixed)]
    return tuple(
        name
        for name in names
        if plain_fit.parameters[name] * fit.parameters[name] < 0.0
        and limits[name][0] <= 0.0 <= limits[name][1]
        and size_is_known((name,), plain_fit.parameters, plain_fit.standard_errors)
        and not size_is_known((name,), fit.parameters, fit.standard_errors)
    )


def _substitutes(
    term: Term, laws: Sequence[Placed], runs: LinearisedRuns
) -> list[tuple[float, Placed, float]]:
    """Laws that have most in common with a term: how much, and their gains by least squares."""
    ranked = []
    for law in laws:
        force = runs.forces(law, np.zeros((1, 0)))[0]
        gain = float(np.sum(term * force) / max(np.sum(force**2), np.finfo(float).tiny))
        likeness = gain * np.sum(term * force) / max(np.sum(term**2), np.finfo(float).tiny)
        lower, upper = law.effect.parameters[0].lower, law.effect.parameters[0].upper
        if _RULES.likeness < likeness < _SAME and lower <= gain <= upper:
            ranked.append((likeness, law, gain))
    ranked.sort(key=lambda item: -item[0])
    return ranked[: _RULES.replacing]


def _is_law(placed: Placed) -> bool:
    """Whether it is a term of one gain, which names a cause."""
    effect = placed.effect
    if not isinstance(effect, AbstractTerm) or isinstance(effect, PRODUCTS):
        return False
    return len(effect.parameters) == len(effect.gains) == 1 and effect.states == 0
