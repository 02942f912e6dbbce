"""Simpler models to compare in free runs with a model whose effects contain simpler effects.

An effect that contains a simpler one must improve the free runs, not only the residual. Only the
residual of a few samples around rest distinguishes Stribeck friction from dry friction of one
level: a spike narrower than the motion in one sample fits the error of the smoothed states there.
A free run has no smoothed states, so it shows whether the wider law improves the model.
Asymmetric friction, read as a level and an offset, contains the level alone; so it does where free
runs came to it, and its two levels do not differ.

So it is with laws that end in simpler ones: the quadratic characteristic of an actuator, whose
linear part is lost, in the square of its input.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from eoi_jax.discovery.confirm import as_good
from eoi_jax.discovery.judge import odds
from eoi_jax.discovery.refit import free_runs, window_of
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.identify import Identification, estimate
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import ConstantOffset, CoulombFriction
from eoi_jax.models.effects.effect import AbstractEffect, AbstractTerm
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine_once
from eoi_jax.simulation.validate import FreeRuns

_RULES = RULES.answer


# Laws that gave way to simpler ones, with their odds against these in free runs.
Wider = dict[Placed, dict[Placed, float]]


def with_simpler_laws(
    task: Task, placed: tuple[Placed, ...], fit: Identification, runs: FreeRuns
) -> tuple[tuple[Placed, ...], Identification, FreeRuns, Wider]:
    """Replace effects by simpler laws that they contain, if the free runs are as good.

    Args:
        task: the constants of the discovery.
        placed: the effects.
        fit: of the model with them.
        runs: its free runs on the held-out records.

    Returns:
        Effects, fit and free runs with the simpler laws; the laws that gave way to them.
    """
    for wide, plain, simpler_set in simpler(task.plant, fit, placed, task.effects):
        refit = estimate(plain, task.prepared)
        if limit_of(task.plant, wide) is not None:
            refit = _by_free_runs(task, refit)
        simple_runs = free_runs(task, refit.plant)
        if refit.status.ok and as_good(simple_runs, runs):
            laws = dict.fromkeys({*simpler_set} - {*placed}, odds(runs, simple_runs, 1.0))
            placed, fit, runs, wider = with_simpler_laws(task, simpler_set, refit, simple_runs)
            return placed, fit, runs, {wide: laws, **wider}
    return placed, fit, runs, {}


def _by_free_runs(task: Task, fit: Identification) -> Identification:
    """A fit at the parameters with the smallest errors of free runs.

    The wide law has the parameters of the search, which treats a bent input to fourth order; passes
    take its mean over a step first.
    """
    window = window_of(task, task.records)
    refined = refine_once(fit.plant, task.records, window)
    if not refined.status.fits:
        return fit
    return replace(estimate(refined.plant, task.prepared, passes=1), status=fit.status)


def simpler(
    declared: Plant,
    estimate: Identification,
    placed: Sequence[Placed],
    library: Sequence[AbstractEffect],
) -> Iterator[tuple[Placed, Plant, tuple[Placed, ...]]]:
    """Each effect that contains exactly one simpler effect, or ends in one, with the simpler model.

    Args:
        declared: the plant without effects.
        estimate: the fit of the plant with the effects.
        placed: the effects.
        library: contains the simpler effects.

    Yields:
        The wide effect, the plant without it or with the simpler effect in its place, and the
        effects of that plant.
    """
    for i, wide in enumerate(placed):
        remaining = (*placed[:i], *placed[i + 1 :])
        if _is_negligible_offset(estimate, wide, remaining):
            yield wide, _plant_with(declared, estimate.plant, remaining, {}), remaining
        for plain in plainer(declared, wide, library):
            if plain.site not in {neighbor.site for neighbor in remaining}:
                candidate = (*placed[:i], plain, *placed[i + 1 :])
                names = dict(zip(plain.names, wide.names, strict=False))  # gains for gains
                yield wide, _plant_with(declared, estimate.plant, candidate, names), candidate


def plainer(plant: Plant, wide: Placed, library: Sequence[AbstractEffect]) -> Iterator[Placed]:
    """Laws in which an effect ends, or the first one that it contains, at its place.

    Args:
        plant: that has the channels.
        wide: the effect.
        library: contains the simpler effects.
    """
    location = wide.channel, wide.against, wide.through
    if (law := limit_of(plant, wide)) is not None and len(law.names) < len(wide.names):
        yield law
    for effect in library:
        if isinstance(effect, AbstractTerm) and wide.effect.contains[:1] == (effect.name,):
            yield place(plant, effect, *location)


def limit_of(plant: Plant, wide: Placed) -> Placed | None:
    """The law in which an effect ends where a parameter runs off, at its place."""
    kind = plant.kinds.get(wide.effect.channels(plant)[wide.channel], "")
    law = wide.effect.limit(kind)
    return None if law is None else place(plant, law, wide.channel, wide.against, wide.through)


def _is_negligible_offset(
    estimate: Identification, offset: Placed, remaining: Sequence[Placed]
) -> bool:
    """Whether an effect is a constant offset beside dry friction that is close to zero."""
    if not isinstance(offset.effect, ConstantOffset):
        return False
    (name,) = offset.names
    value, error = abs(estimate.parameters[name]), estimate.standard_errors[name]
    levels = [
        estimate.parameters[neighbor.names[0]]
        for neighbor in remaining
        if isinstance(neighbor.effect, CoulombFriction) and neighbor.site[1:] == offset.site[1:]
    ]
    return any(
        value < max(_RULES.offset_errors * error, _RULES.offset_share * level) for level in levels
    )


def _plant_with(
    declared: Plant, augmented_plant: Plant, placed: Sequence[Placed], names: Mapping[str, str]
) -> Plant:
    """The plant with a new set of effects; `names` maps new parameter names to old ones."""
    values = augmented_plant.parameters
    values |= {new: values[old] for new, old in names.items()}
    pairs = zip(augmented_plant.lower, augmented_plant.upper, strict=True)
    bounds = {
        name: (float(low), float(high))
        for name, (low, high) in zip(augmented_plant.names, pairs, strict=True)
    }
    plant = augmented(declared, placed, values, bounds)
    return plant.with_parameters(np.array([values[name] for name in plant.names]))
