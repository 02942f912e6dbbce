"""What speaks against a name: rivals that explain as much, and the experiment that would tell."""

from collections.abc import Sequence

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.round import TOLD_APART, Round
from eoi_jax.models.effects.effect import AbstractEffect

_RIVAL = 0.2  # share of what an effect takes alone, from which on another one is its rival
_BEYOND = 0.5  # of an effect: what another one that contains it would add to it


def unrivalled(first: Round) -> bool:
    """Whether the effect that matters most takes, alone, far more than any other one could."""
    search, chosen = first.found, first.chosen
    if not chosen.atoms:
        return False

    def without(one: CandidateColumns) -> float:
        return search.value(search.fit([other for other in chosen.atoms if other is not one]))

    main = max(chosen.atoms, key=without).placed.effect
    empty, power = search.fit([]), search.base.signal_power
    taken: dict[bool, float] = {True: 0.0, False: 0.0}
    for fit in [*search.extended(empty), *first.sets]:
        if len(fit.atoms) == 1 and fit.physical:
            own = akin(fit.atoms[0].placed.effect, main)
            share = power(empty.residual) - power(fit.residual)
            taken[own] = max(taken[own], share)
    return taken[False] < _RIVAL * taken[True]


def akin(one: AbstractEffect, other: AbstractEffect) -> bool:
    """Whether two effects are one law with more or fewer terms: Coulomb and Stribeck friction."""
    return bool({one.name, *one.contains} & {other.name, *other.contains})


def ambiguous(first: Round, kept: Sequence[str]) -> tuple[str, ...]:
    """Names in sets no larger than the chosen one that the records support nearly as well.

    And of an effect that contains a chosen one, where what it adds to that may well be large: it
    cost more than it gained because the records hardly show it.
    """
    search, chosen, own = first.found, first.chosen, set(kept)
    names: list[str] = []
    for fit in first.sets:
        theirs = {one.placed.effect.name for one in fit.atoms}
        contained = {name for one in fit.atoms for name in one.placed.effect.contains}
        if not fit.physical or own <= theirs or len(fit.atoms) > len(chosen.atoms):
            continue
        if own <= theirs | contained:
            pairs = zip(fit.atoms, fit.gains, strict=True)
            close = any(one.placed.effect.beyond(gains) > _BEYOND for one, gains in pairs)
        else:
            close = search.value(fit) - search.value(chosen) < TOLD_APART
        if close:
            names += [name for name in sorted(theirs - own) if name not in names]
    level_and_offset = ["coulomb_friction", "constant_offset"]
    if "asymmetric_friction" in own:
        names += [name for name in level_and_offset if name not in own]
    elif own.issuperset(level_and_offset):
        names.append("asymmetric_friction")
    return tuple(dict.fromkeys(name for name in names if name not in own))


def advice(first: Round, others: Sequence[str]) -> str:
    """Which experiment tells the candidates apart, by what they depend on."""
    if not others:
        return ""
    library = {one.placed.effect.name: one.placed.effect for one in first.found.grid}
    kinds = {one.placed.effect.depends_on for one in first.chosen.atoms}
    kinds |= {library[name].depends_on for name in others if name in library}
    return " ".join(_EXPERIMENT[kind] for kind in sorted(kinds))


_EXPERIMENT = {
    "y": "Record the same input at two and at half the amplitude: then springs part.",
    "v": "Record slow and fast motion of one amplitude: friction laws then part.",
    "u": "Record the same motion with larger and smaller inputs, and both signs of them.",
    "t": "Record steps and fast changes of the input, and the same input at another time.",
}
