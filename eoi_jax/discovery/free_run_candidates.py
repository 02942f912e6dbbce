"""Which effects a search in free runs tries, in what order.

Those of which a score test says most; a few places are for products of signals, which name no
cause, and for dependences of a parameter.
"""

from collections import Counter
from collections.abc import Sequence

from eoi_jax.discovery.additions import smallest_values
from eoi_jax.discovery.judge import Judged
from eoi_jax.discovery.replacements import Model
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects import (
    PRODUCTS,
    ActuatorLag,
    ConstantOffset,
    CoulombFriction,
    InputDelay,
    ParameterDependence,
)
from eoi_jax.models.effects.effect import (
    INPUT_EFFECTS,
    AbstractActuator,
    AbstractCascade,
    AbstractEffect,
    AbstractTerm,
)
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.remaining import Remaining, remaining
from eoi_jax.refinement.score_test import Candidate, is_tested

_RULES = RULES.free_runs

Sites = tuple[tuple[str, int], ...]  # kinds of effects with their channels


def candidates(
    best: Judged, effects: Sequence[AbstractEffect], level: float, explained: bool = False
) -> list[Model]:
    """Models with the effects that a score test says most of, then with an offset.

    Args:
        best: refined; its effects stay.
        effects: to try.
        level: of significance of the score test, for all tries together.
        explained: whether its effects explain the injection: then fewer are tried, no offset in any
            case.
    """
    if not best.refinement.status.ok:
        return []  # of a fit without an answer no score test is one
    plant = best.refinement.plant
    offsets = [effect for effect in effects if isinstance(effect, ConstantOffset)]
    # What has no linear test: none at all would find it.
    untested = [e for e in effects if isinstance(e, AbstractCascade) and not is_tested(e)]
    tested = remaining(best.refinement, effects, level=level)
    share = _RULES.share if explained else 0.0
    items = [item for item in _nearly_best(tested.significant) if item.share >= share]
    sets = [(item.placed, item.values) for item in items]
    if not explained:
        sets += [((placed,), smallest_values(placed))
                 for placed in placements(plant, offsets)]  # fmt: skip
    certain = [((placed,), {}) for placed in placements(plant, untested)]
    if not best.placed:
        certain += _tried_first(tested, plant)
    first: dict[Sites, Model] = {}
    for placed, values in [*certain, *sets]:
        if not _repeated(best.placed, placed):
            first.setdefault(_sites_of(placed), (augmented(plant, placed, values), placed))
    # A product names no cause, and many of them do alike: they leave room for laws that do.
    # Beside an explanation they are told, and one is enough.
    models, allowed = list(first.values()), 1 if explained else _RULES.products
    products = [i for i, (_, placed) in enumerate(models) if _has_product(placed)]
    models = [model for i, model in enumerate(models) if i not in products[allowed:]]
    shapes = [(item.placed, item.values) for item in _further_shapes(tested, items)]
    # What changes the whole motion comes first, not beside what explains most of it.
    further = [*shapes[: _RULES.shapes], *([] if best.placed else _further_starts(items))]
    # There may be many dependences, too: they have room of their own.
    laws = [model for model in models if not has_dependence(model[1])]
    dependences = [model for model in models if has_dependence(model[1])]
    return [
        *_of_each_kind(laws, _RULES.tried + len(certain)),
        *dependences[: _RULES.dependences],
        *((augmented(plant, placed, values), placed) for placed, values in further),
    ]


def _of_each_kind(laws: Sequence[Model], count: int) -> list[Model]:
    """The first so many, then single ones of each kind of which fewer than two are among them.

    A lag of the drive and a loss of the output are told apart by no order: where many losses do
    alike, as an offset and a product with an input that stands still, they leave it no place. A
    product is of no kind: two of them must not leave none to a loss above a level.
    """
    chosen = list(laws[:count])
    effects = [item.effect for _, placed in chosen for item in placed]
    counts = Counter(_kind(effect) for effect in effects if not isinstance(effect, PRODUCTS))
    for model in laws[count:]:
        kind = _kind(model[1][0].effect)
        if len(model[1]) == 1 and counts[kind] < _RULES.of_a_kind:
            chosen.append(model)
            counts[kind] += 1
    return chosen


def _kind(effect: AbstractEffect) -> tuple[bool, bool]:
    """Whether it acts on an input, and whether it remembers."""
    if isinstance(effect, INPUT_EFFECTS):
        return True, isinstance(effect, AbstractActuator)
    return False, not isinstance(effect, AbstractTerm) or effect.states > 0


def _tried_first(
    tested: Remaining, plant: Plant
) -> list[tuple[tuple[Placed, ...], dict[str, float]]]:
    """A lag and a dead time, and dry friction of what moves: what is tried first by hand, too.

    A base of lower order has bent its time constants and levels to make up for a lag, and a base
    that never stops says little of what makes it stop: a score test along it says little of them. A
    second store is not among them: one that never changes is a loss to the level that a record
    begins with.
    """
    chosen = []
    for kind in (ActuatorLag, InputDelay, CoulombFriction):
        of_kind = [
            item
            for item in tested.ranking
            if type(item.placed[0].effect) is kind
            and (kind is not CoulombFriction or plant.degrees[item.placed[0].channel] > 1)
        ]
        if of_kind:
            item = max(of_kind, key=lambda item: item.share)
            chosen.append((item.placed, item.values))
    return chosen


def has_dependence(placed: Sequence[Placed]) -> bool:
    """Whether one of some effects is a dependence of a parameter."""
    return any(isinstance(item.effect, ParameterDependence) for item in placed)


def _nearly_best(significant: Sequence[Candidate]) -> list[Candidate]:
    """Candidates that leave little more than the best one; laws are compared with laws.

    A product bends as the residual does wherever the base is, and takes most of what is linearised
    there; it names no cause.
    """
    chosen = []
    for candidate in significant:
        kind = _has_product(candidate.placed)
        alike = (other.share for other in significant if _has_product(other.placed) == kind)
        if 1.0 - candidate.share <= _RULES.remainder * (1.0 - max(alike)):
            chosen.append(candidate)
    return chosen


def _further_shapes(tested: Remaining, items: Sequence[Candidate]) -> list[Candidate]:
    """Effects at other shapes that explain nearly as much, at the maxima of their share.

    Fits that begin at one shape do not come to another maximum.
    """
    shares = {item.placed: item.share for item in items}
    return [
        item
        for item in tested.further_shapes
        if item.placed in shares
        and item.significance < tested.level
        and 1.0 - item.share <= _RULES.remainder * (1.0 - shares[item.placed])
    ]


def _further_starts(
    items: Sequence[Candidate],
) -> list[tuple[tuple[Placed, ...], dict[str, float]]]:
    """Effects alone, with other values than those that the score test says."""
    single = [(item, *item.placed) for item in items if len(item.placed) == 1]
    return [
        ((placed,), dict(zip(placed.names, values, strict=True)))
        for item, placed in single
        for values in placed.effect.further_starts([item.values[name] for name in placed.names])
    ]


def _has_product(placed: Sequence[Placed]) -> bool:
    """Whether one of some effects is a product of signals."""
    return any(isinstance(item.effect, PRODUCTS) for item in placed)


def _repeated(present: Sequence[Placed], placed: Sequence[Placed]) -> bool:
    """Whether one of some effects is in the model already, at the same place."""
    places = {item.kind_site for item in present}
    return any(item.kind_site in places for item in placed)


def _sites_of(placed: Sequence[Placed]) -> Sites:
    """Kinds of effects and their channels, in any order."""
    return tuple(sorted(item.kind_site[:2] for item in placed))
