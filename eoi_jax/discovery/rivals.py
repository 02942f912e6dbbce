"""Rival effects that explain as much as the chosen ones, and the experiment to tell them apart."""

from collections.abc import Iterable, Mapping, Sequence

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.probability import Standing, from_sets, reads_as
from eoi_jax.discovery.regression import Fit
from eoi_jax.discovery.result import Added
from eoi_jax.discovery.round import RoundResult
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.search import RankedSets
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import standard, wider
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant

_RULES = RULES.answer


def unrivalled(first: RoundResult) -> bool:
    """Whether the main effect explains, on its own, far more power than any unrelated effect."""
    scores, chosen = first.ranked.scores, first.chosen
    if not chosen.atoms:
        return False

    def value_without(atom: CandidateColumns) -> float:
        return scores.value(
            scores.fit([neighbor for neighbor in chosen.atoms if neighbor is not atom])
        )

    main = max(chosen.atoms, key=value_without).placed.effect
    empty, power = scores.fit([]), scores.base.signal_power
    best_power: dict[bool, float] = {True: 0.0, False: 0.0}  # by whether it is the main effect
    for fit in [*scores.extended(empty), *first.ranked.sets]:
        if len(fit.atoms) == 1 and fit.physical:
            is_main = akin(fit.atoms[0].placed.effect, main)
            explained = power(empty.residual) - power(fit.residual)
            best_power[is_main] = max(best_power[is_main], explained)
    return best_power[False] < _RULES.rival * best_power[True]


def akin(first: AbstractEffect, second: AbstractEffect) -> bool:
    """Whether one law contains the other or both share one, as Coulomb and Stribeck friction do."""
    return bool({first.name, *first.contains} & {second.name, *second.contains})


def ambiguous(ranked: RankedSets, chosen: Fit, added: Sequence[str]) -> tuple[str, ...]:
    """Names in sets no larger than the chosen one that the records support nearly as well.

    Also the name of an effect that contains a chosen one if its additional term may be large: its
    penalty exceeded its gain because the records hardly excite that term.
    """
    scores, chosen_names = ranked.scores, set(added)
    names: list[str] = []
    for fit in ranked.sets:
        fit_names = {atom.placed.effect.name for atom in fit.atoms}
        contained = {name for atom in fit.atoms for name in atom.placed.effect.contains}
        if not fit.physical or chosen_names <= fit_names or len(fit.atoms) > len(chosen.atoms):
            continue
        if chosen_names <= fit_names | contained:
            pairs = zip(fit.atoms, fit.gains, strict=True)
            close = any(atom.placed.effect.beyond(gains) > _RULES.extra for atom, gains in pairs)
        else:
            close = scores.value(fit) - scores.value(chosen) < RULES.round.told_apart
        if close:
            names += [name for name in sorted(fit_names - chosen_names) if name not in names]
    level_and_offset = ["coulomb_friction", "constant_offset"]
    if "asymmetric_friction" in chosen_names:
        names += [name for name in level_and_offset if name not in chosen_names]
    elif chosen_names.issuperset(level_and_offset):
        names.append("asymmetric_friction")
    return tuple(dict.fromkeys(name for name in names if name not in chosen_names))


def standings(
    rounds: Sequence[RoundResult],
    effects: Sequence[Placed],
    wider: Mapping[Placed, Mapping[Placed, float]],
    remainder: float,
) -> dict[Placed, Standing | None]:
    """The standings of effects that the injection justifies, each from the round that added it.

    Args:
        rounds: of the search.
        effects: of the answer.
        wider: laws that gave way to simpler ones in free runs, with their odds against these.
        remainder: power of the residual that is left beyond the noise.
    """
    plant, found = rounds[0].start.task.plant, dict.fromkeys(effects)
    for placed in effects:
        for step in rounds:
            chosen = [atom.placed for atom in step.chosen.atoms]
            alias = [law for law in chosen if law == placed or reads_as(law, placed)]
            if alias:
                laws = {law: odds[placed] for law, odds in wider.items() if placed in odds}
                placed_standing = from_sets(plant, placed, chosen, step.plausible, laws)
                found[placed] = placed_standing.beside(step.removed(alias), remainder)
                break
    return found


def advice(first: RoundResult, rival_names: Sequence[str]) -> str:
    """The experiment that distinguishes the candidates, by the signals that they depend on."""
    if not rival_names:
        return ""
    library = {
        atom.placed.effect.name: atom.placed.effect for atom in first.ranked.scores.problem.grid
    }
    kinds = {atom.placed.effect.depends_on for atom in first.chosen.atoms}
    kinds |= {library[name].depends_on for name in rival_names if name in library}
    return _experiments(first.start.task.plant, kinds)


def experiments(plant: Plant, added: Sequence[Added], rival_names: Sequence[str]) -> str:
    """The experiment that distinguishes added effects from their rivals; "" without any.

    Args:
        plant: that lacks the effects; without inputs its motion follows from where it starts.
        added: effects.
        rival_names: names of what may stand in their places.
    """
    kinds = {effect.name: effect.depends_on for effect in (*standard(), *wider())}
    signals = {item.effect.depends_on for item in added if item.alternatives}
    rival_signals = {kinds[name] for name in rival_names if name in kinds}
    return _experiments(plant, signals | rival_signals)


def _experiments(plant: Plant, kinds: Iterable[str]) -> str:
    experiment = _EXPERIMENT if plant.inputs else _WITHOUT_INPUTS
    moves = _MECHANICAL.intersection(plant.kinds.values())
    laws = "springs part" if moves else "laws of the output part"
    sentences = (experiment[kind] for kind in sorted(kinds) if kind in experiment)
    return " ".join(sentences).format(laws)


_MECHANICAL = frozenset(("position", "speed", "acceleration", "force", ""))  # "": not known
_EXPERIMENT = {
    "y": "Record the same input at two and at half the amplitude: then {}.",
    "v": "Record slow and fast motion of one amplitude: friction laws then part.",
    "u": "Record the same motion with larger and smaller inputs, and both signs of them.",
    "t": "Record steps and fast changes of the input, and the same input at another time.",
}
_WITHOUT_INPUTS = {
    "y": "Record runs that start twice and half as far from rest: then {}.",
    "v": "Record runs that start slow and runs that start fast: friction laws then part.",
    "t": "Record runs from other starting values, and from the same ones at another time.",
}
