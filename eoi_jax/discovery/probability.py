r"""How probable an added effect is against those that may stand in its place.

In the injection, sets s of effects are compared by the score of the search and, on held-out
records, by the likelihood of their residual; together they are v_s, twice a negative log-likelihood
with its penalty. Sets are weighted as Bayesian model averaging does it with the criterion of
Schwarz (Raftery, Sociological Methodology 25, 1995),

    P(e) = Σ_{s ∋ e} w_s / Σ_s w_s ,   w_s = exp(-v_s/2) .

In free runs models are compared in pairs: with p the probability that a rival predicts better than
the model with the effect (`judge.probability_better`),

    P(e) = 1 / (1 + Σ_rivals p/(1 - p)) ,

over models without any effect in its place, and with the one that does best there. What does the
same as a sensor's lag, and no fit has, is as probable: a second store where nothing drives the
plant, a lag of the actuator behind what the answer does to its input.

Either is a probability among the effects of the library. What is left may have a cause that the
library lacks, and an effect that takes less than that may be a part of it: with D the power that an
effect takes beside the others, and R what is left beyond the noise, its probability and those of
its rivals are multiplied by D/(D + R).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.discovery.judge import Judged, noise_level, odds
from eoi_jax.discovery.result import Rival
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import (
    ActuatorLag,
    AsymmetricFriction,
    ConstantOffset,
    SecondNode,
    SensorLag,
)
from eoi_jax.models.effects.effect import AbstractInputEffect, AbstractParameterEffect
from eoi_jax.models.placements import ends, placements, position_text
from eoi_jax.models.plant import Plant

_RULES = RULES.probability


@dataclass(frozen=True)
class Standing:
    """An effect among its rivals.

    Attributes:
        probability: of the effect, 0 … 1.
        rivals: those of which it is worth telling, the most probable first.
    """

    probability: float
    rivals: tuple[Rival, ...]

    def beside(self, removed: float, remainder: float) -> "Standing":
        """With the power that the effect takes, and that which is left beyond the noise."""
        share = 1.0 if remainder <= 0.0 else max(removed, 0.0) / (max(removed, 0.0) + remainder)
        rivals = tuple(
            replace(rival, probability=share * rival.probability) for rival in self.rivals
        )
        return Standing(share * self.probability, rivals)


@dataclass(frozen=True)
class Contest:
    """A round of a search in free runs.

    Attributes:
        origin: the model from which it began.
        chosen: the model that it ended with.
        trials: all models that were refined in it.
    """

    origin: Judged
    chosen: Judged
    trials: tuple[Judged, ...]


def standing(plant: Plant, against: Mapping[Placed | None, float]) -> Standing:
    """The standing of an effect from the odds of its rivals against it.

    Args:
        plant: that has the channels of the rivals.
        against: odds by rival; of None that there is no effect in its place.
    """
    total = 1.0 + sum(against.values())
    rivals = [
        Rival(placed.effect.name, placed.effect.form, position_of(plant, placed), value / total)
        for placed, value in against.items()
        if placed is not None and value >= _RULES.told * total
    ]
    return Standing(1.0 / total, tuple(sorted(rivals, key=lambda rival: -rival.probability)))


def position_of(plant: Plant, placed: Placed) -> str:
    """Where an effect acts, in words."""
    channels = placed.effect.channels(plant)
    return position_text(channels[placed.channel], *ends(plant, placed))


def beside_rival(
    plant: Plant, earlier_standing: Standing, rivals: Sequence[Placed], value: float
) -> Standing:
    """A standing from the injection, beside a model of free runs with other effects.

    Args:
        plant: that has the channels of the effects.
        earlier_standing: the standing of an effect of the answer.
        rivals: effects that the model has in its place.
        value: odds of the model over the answer, by its free runs.
    """
    total = 1.0 + earlier_standing.probability * value
    share = earlier_standing.probability * value / total / max(len(rivals), 1)
    named = [
        Rival(law.effect.name, law.effect.form, position_of(plant, law), share) for law in rivals
    ]
    earlier = [
        replace(rival, probability=rival.probability / total) for rival in earlier_standing.rivals
    ]
    told = [rival for rival in (*named, *earlier) if rival.probability >= _RULES.told]
    ranked = sorted(told, key=lambda rival: -rival.probability)
    return Standing(earlier_standing.probability / total, tuple(ranked))


def from_sets(
    plant: Plant,
    placed: Placed,
    chosen: Sequence[Placed],
    sets: Sequence[tuple[frozenset[Placed], float]],
    wider: Mapping[Placed, float],
) -> Standing:
    """The standing of an effect of a set that the injection justifies.

    Args:
        plant: that has the channels of the effects.
        placed: the effect.
        chosen: effects of the set, as the search has them.
        sets: effects of every set that may be the answer, and its v.
        wider: laws that contain it and gave way to it in free runs, with their odds there.
    """
    alias = {placed, *(wide for wide in chosen if reads_as(wide, placed))}
    alias |= {law for effects, _ in sets for law in effects if _is_form_of(law, placed)}
    lowest = min(value for _, value in sets)
    weights = [(effects, float(np.exp(0.5 * (lowest - value)))) for effects, value in sets]
    own = sum(weight for effects, weight in weights if effects & alias)
    against: dict[Placed | None, float] = {**wider}
    for effects, weight in weights:
        if not effects & alias:
            rivals = sorted(effects - set(chosen), key=lambda rival: rival.names)
            for rival in rivals or [None]:
                against[rival] = against.get(rival, 0.0) + weight / (own * max(len(rivals), 1))
    return standing(plant, against)


def reads_as(wide: Placed, placed: Placed) -> bool:
    """Whether an effect is read as another one at its place: a simpler law that it contains."""
    if wide.site[1:] != placed.site[1:]:
        return False
    level_and_offset = isinstance(wide.effect, AsymmetricFriction) and isinstance(
        placed.effect, ConstantOffset
    )
    return level_and_offset or placed.effect.name in wide.effect.contains


def _is_form_of(law: Placed, placed: Placed) -> bool:
    """Whether both say that the same parameter depends on the same signal."""
    both = isinstance(law.effect, AbstractParameterEffect) and law.site[1:] == placed.site[1:]
    return both and law.effect.kind == placed.effect.kind


def from_contests(
    plant: Plant, best: Judged, effects: Sequence[Placed], contests: Sequence[Contest]
) -> dict[Placed, Standing]:
    """The standings of effects that a search in free runs came to.

    An effect was chosen in one round, from the models that were refined in it. Those with other
    effects of the answer are no rivals: these were added in a later round.

    Args:
        plant: that has the channels of the effects.
        best: the answer.
        effects: of it, whose standings are asked for.
        contests: the rounds.
    """
    places = {rival.kind_site for rival in best.placed}
    remainder, standings = _power(best.error) - _power(noise_level(best.runs)), {}
    for placed in effects:
        place = placed.kind_site
        added = (contest for contest in contests if _adds(contest, placed))
        contest = next(added, None)
        if contest is None:
            continue
        chosen = contest.chosen
        against: dict[Placed | None, float] = {None: odds_of(contest.origin, chosen)}
        for trial in contest.trials:
            rivals = [rival for rival in trial.placed if rival.kind_site not in places]
            if rivals and place not in _places(trial) and not reads_as(rivals[0], placed):
                found = odds_of(trial, chosen, trial.burden - chosen.burden)
                against[rivals[0]] = max(found, against.get(rivals[0], 0.0))
        against |= dict.fromkeys(_twins(plant, placed, best.placed), 1.0)
        removed = _power(contest.origin.error) - _power(chosen.error)
        standings[placed] = standing(plant, _one_of_each_place(against)).beside(removed, remainder)
    return standings


def odds_of(rival: Judged, chosen: Judged, further: float = 0.0) -> float:
    """`odds` of a model over the chosen one, by all records on which both have free runs."""
    of_fit = (rival.fit_runs, chosen.fit_runs) if rival.fit_runs and chosen.fit_runs else None
    return odds(rival.runs, chosen.runs, further, of_fit)


def _adds(contest: Contest, placed: Placed) -> bool:
    """Whether a round added an effect, or a wider law that gave way to it in the end."""
    present = _places(contest.origin)
    return any(
        law.kind_site not in present
        and (law.kind_site == placed.kind_site or reads_as(law, placed))
        for law in contest.chosen.placed
    )


def _twins(plant: Plant, placed: Placed, present: Sequence[Placed]) -> list[Placed]:
    """What the records cannot tell from a sensor's lag, and no fit has.

    A store beside the first one has poles as free as those of the plant and its sensor. What a lag
    does to an input comes before its dead zone or curve in the library, but behind it in a drive.
    """
    if not isinstance(placed.effect, SensorLag) or len(plant.outputs) != 1:
        return []
    if not plant.inputs:
        return placements(plant, [SecondNode()])
    shaped = any(isinstance(item.effect, AbstractInputEffect) for item in present)
    return placements(plant, [ActuatorLag()]) if shaped and len(plant.inputs) == 1 else []


def _one_of_each_place(against: Mapping[Placed | None, float]) -> dict[Placed | None, float]:
    """Without further forms of a rival: that which does best stands for them."""
    best: dict[object, Placed | None] = {}
    for rival, value in against.items():
        place = rival and rival.kind_site
        if place not in best or value > against[best[place]]:
            best[place] = rival
    return {rival: against[rival] for rival in best.values()}


def _power(error: float) -> float:
    """The power of errors from the logarithm of their root mean square."""
    return float(np.exp(2.0 * error))


def _places(model: Judged) -> set[tuple]:
    return {placed.kind_site for placed in model.placed}
