r"""What a refined model still lacks, seen in its free run: a score test of every effect.

The injection (`discover`) weighs what is missing by its force, the free run by its consequences
(`score_test.py`): a damping that grows with the velocity is lost in the noise of the injection, and
is a third of the free run's error. Two effects are tried together as well, for one may hide the
other; held-out records judge what is most significant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_kind, real
from eoi_jax._display import Result
from eoi_jax.data.record import Record
from eoi_jax.estimation.holdout import check_scored_records, held_out_records
from eoi_jax.models.augmented import augmented
from eoi_jax.models.effects import rare, standard
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractEffect,
    AbstractInputEffect,
    AbstractTerm,
)
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.problem import spans_of
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.score_test import Along, Candidate, Try
from eoi_jax.simulation.validate import Validation, validate

_PAIRS = 6  # pairs that are shown
_TRIALS = 3  # significant answers that are refined with and judged on held-out records


@dataclass(frozen=True)
class Trial:
    """A significant candidate in the model, all of it refined again.

    Attributes:
        candidate: what was added.
        refinement: with it, on the same records.
        held_out: free-run error on records that neither saw.
    """

    candidate: Candidate
    refinement: Refinement
    held_out: Validation


@dataclass(frozen=True)
class Remaining(Result):
    """What is left of a refined model's error, and what would explain it.

    `plot` shows share of the error that each effect, and each pair, explains.

    Attributes:
        plant: the refined one.
        ranking: every effect that was tried, by its share.
        pairs: of two effects the best ones, by their share: one may only show beside another.
        rmse: of the free run, shape (ny,).
        level: of significance.
        held_out: error of the refined model on records that were not used; None without any.
        trials: the most significant candidates, on the same records.
    """

    plant: Plant
    ranking: tuple[Candidate, ...]
    pairs: tuple[Candidate, ...]
    rmse: Float[np.ndarray, " ny"]
    level: float
    held_out: Validation | None = None
    trials: tuple[Trial, ...] = ()

    @property
    def answer(self) -> Trial | None:
        """Of the trials that lower the held-out error the one that lowers it most."""
        if self.held_out is None:
            return None
        lower = [(_relative(one.held_out, self.held_out), one) for one in self.trials
                 if one.refinement.status.ok]  # fmt: skip
        ratio, best = min(lower, key=lambda one: one[0], default=(1.0, None))
        return best if ratio < 1.0 else None

    @property
    def best(self) -> Candidate | None:
        """The answer; where there are no held-out records, what is most significant."""
        if self.held_out is not None:
            return None if self.answer is None else self.answer.candidate
        return next(iter(self.significant), None)

    @property
    def significant(self) -> tuple[Candidate, ...]:
        """The most significant effect, or two that leave less than half of its error; others."""
        one, two = (
            sorted((each for each in several if each.significance < self.level),
                   key=lambda each: each.significance)
            for several in (self.ranking, self.pairs)
        )  # fmt: skip
        if one and two and 1.0 - two[0].share >= 0.5 * (1.0 - one[0].share):
            return (one[0], two[0], *one[1:], *two[1:])
        return (*two[:1], *one, *two[1:])

    def with_best(self) -> Plant:
        """The plant with the best effects in it: refined, where held-out records have judged it."""
        if self.answer is not None:
            return self.answer.refinement.plant
        best = self.best
        return self.plant if best is None else augmented(self.plant, best.placed, best.values)


def _relative(one: Validation, other: Validation) -> float:
    """Geometric mean of the errors of all outputs over those of another model."""
    tiny = np.finfo(float).tiny
    ratio = np.maximum(one.rmse, tiny) / np.maximum(other.rmse, tiny)
    return float(np.exp(np.mean(np.log(np.where(np.isfinite(ratio), ratio, np.inf)))))


def remaining(
    refinement: Refinement,
    effects: Sequence[AbstractEffect] | None = None,
    *,
    validation: Record | Sequence[Record] | None = None,
    level: float = 0.01,
    substeps: int | None = None,
) -> Remaining:
    """Rank what a refined model still lacks by the share of its free run's error.

    Args:
        refinement: result of `refine`, with an answer.
        effects: to try; those of `effects.standard()` and `effects.rare()`, if left out. Effects
            with states of their own, and those of internal states, are passed over.
        validation: records that were not used: the model is then refined with each of the most
            significant answers, and that answer is best which lowers the free-run error on these.
        level: of significance, for all tries together.
        substeps: steps of the simulation per sample; those of the refinement if None.

    Returns:
        The ranking. What is at its head is an answer to "what would lower this error", not yet a
        cause: records that were not used (`validation`) refuse what only fits better.

    Raises:
        ValueError: a refinement without an answer, or of a plant behind an actuator; records of
            `validation` that do not fit the plant, that the fit has seen, or that are too short.

    Source:
        C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50 (score test); M. S. Bartlett (independent
        samples of coloured residuals).
    """
    check_kind("refinement", refinement, Refinement, "what `refine` returned")
    plant, records = refinement.plant, refinement.records
    check(refinement.status.ok, "refinement", "must have an answer", str(refinement.status))
    check(0.0 < real(level) < 1.0, "level", "must lie in (0, 1)", level)
    check(plant.actuator is None, "refinement", "must be of a plant without delay or lag of inputs",
          plant.name)  # fmt: skip
    held = held_out_records(plant, records, validation)
    check_scored_records(plant, "validation", held)
    chosen = (*standard(), *rare()) if effects is None else tuple(effects)
    start = min(float(one.time[0]) for one in records)
    chosen = tuple(one.since(start) for one in chosen)
    spans = spans_of(records, refinement.window)
    substeps = refinement.substeps if substeps is None else substeps
    along = Along.of(refinement, records, spans, substeps)
    several = [one for one in placements(plant, chosen) if _tried(one.effect)]
    tries = [one for placed in several for one in along.tries(placed)]
    alone = [along.share((one,)) for one in tries]
    ranking = [along.candidate((one,), len(tries)) for one in _best(tries, alone)]
    found = Remaining(plant, _ranked(ranking), _pairs(along, tries, alone), refinement.rmse, level)
    if not held:
        return found
    trials = [_trial(refinement, one, held, substeps) for one in found.significant[:_TRIALS]]
    return replace(found, held_out=validate(plant, held), trials=tuple(trials))


def _trial(
    refinement: Refinement,
    one: Candidate,
    held: Sequence[Record],
    substeps: int,
) -> Trial:
    plant = augmented(refinement.plant, one.placed, one.values)
    again = refine(plant, refinement.records, window=refinement.window, substeps=substeps)
    return Trial(one, again, validate(again.plant, held))


def _best(tries: Sequence[Try], shares: Sequence[float | None]) -> list[Try]:
    """Of the shapes of an effect at a channel the one with the largest share."""
    best: dict[Any, tuple[float, Try]] = {}
    for one, share in zip(tries, shares, strict=True):
        if share is not None and share > best.get(one.placed, (-np.inf, None))[0]:
            best[one.placed] = share, one
    return [one for _, one in best.values()]


def _ranked(found: Sequence[Candidate | None]) -> tuple[Candidate, ...]:
    """By share; of sets with the same effects at the same channels the best one."""
    kept: dict[Any, Candidate] = {}
    for one in sorted((one for one in found if one is not None), key=lambda one: -one.share):
        kept.setdefault(tuple(each.site for each in one.placed), one)
    return tuple(kept.values())


def _pairs(
    along: Along, tries: Sequence[Try], alone: Sequence[float | None]
) -> tuple[Candidate, ...]:
    """The pairs with the largest shares."""
    linear = [one for one, share in zip(tries, alone, strict=True)
              if one.placed.effect.gains or share is not None]  # fmt: skip
    shares = along.pair_shares(linear)
    count = max(len(linear) * (len(linear) - 1) // 2, 1)
    found: dict[Any, Candidate | None] = {}
    for place in np.argsort(shares, axis=None)[::-1]:
        i, j = np.unravel_index(place, shares.shape)
        key = linear[i].placed, linear[j].placed
        if shares[i, j] == 0 or len(found) == _PAIRS:
            break
        if key not in found:
            found[key] = along.candidate((linear[i], linear[j]), count)
    return _ranked([*found.values()])


def _tried(effect: AbstractEffect) -> bool:
    known = isinstance(effect, AbstractTerm | AbstractInputEffect | AbstractActuator)
    return known and effect.states == 0
