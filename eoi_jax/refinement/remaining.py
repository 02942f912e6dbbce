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
from eoi_jax.data.holds import made_alike
from eoi_jax.data.record import Record
from eoi_jax.estimation.holdout import check_scored_records, held_out_records
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects import ConstantOffset, rare, standard
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.score_test import Candidate, LinearisedRuns, Try, is_tested
from eoi_jax.refinement.spans import spans_of
from eoi_jax.simulation.validate import judged_runs
from eoi_jax.simulation.validation import Validation

_DIGITS = 7  # of a share; what follows is rounding of least squares


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


@dataclass(frozen=True, eq=False, repr=False)
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
        further_shapes: effects of the ranking at other shapes, where the share that they explain
            has another maximum: the ripple of a drive at another wave number. By their share.
    """

    plant: Plant
    ranking: tuple[Candidate, ...]
    pairs: tuple[Candidate, ...]
    rmse: Float[np.ndarray, " ny"]
    level: float
    held_out: Validation | None = None
    trials: tuple[Trial, ...] = ()
    further_shapes: tuple[Candidate, ...] = ()

    @property
    def answer(self) -> Trial | None:
        """Of the trials that lower the held-out error the one that lowers it most."""
        if self.held_out is None:
            return None
        lower = [(_relative(trial.held_out, self.held_out), trial) for trial in self.trials
                 if trial.refinement.status.ok]  # fmt: skip
        ratio, best = min(lower, key=lambda trial: trial[0], default=(1.0, None))
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
        singles, pairs = (
            sorted((candidate for candidate in ranking if candidate.significance < self.level),
                   key=lambda candidate: candidate.significance)
            for ranking in (self.ranking, self.pairs)
        )  # fmt: skip
        if singles and pairs and 1.0 - pairs[0].share >= 0.5 * (1.0 - singles[0].share):
            return (singles[0], pairs[0], *singles[1:], *pairs[1:])
        return (*pairs[:1], *singles, *pairs[1:])

    def with_best(self) -> Plant:
        """The plant with the best effects in it: refined, where held-out records have judged it."""
        if self.answer is not None:
            return self.answer.refinement.plant
        best = self.best
        return self.plant if best is None else augmented(self.plant, best.placed, best.values)


def _relative(validation: Validation, reference: Validation) -> float:
    """Geometric mean of the errors of all outputs over those of another model."""
    tiny = np.finfo(float).tiny
    ratio = np.maximum(validation.rmse, tiny) / np.maximum(reference.rmse, tiny)
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
            without a score test are passed over: hysteresis, cells in series, those of internal
            states.
        validation: records that were not used: the model is then refined with each of the most
            significant answers, and that answer is best which lowers the free-run error on these.
        level: of significance, for all tries together.
        substeps: steps of the simulation per sample; those of the refinement if None.

    Returns:
        The ranking. What is at its head is an answer to "what would lower this error", not yet a
        cause: records that were not used (`validation`) refuse what only fits better.

    Raises:
        ValueError: a refinement without an answer, of a plant with an output of relative degree 0,
            or with a controller in the loop; records of `validation` that do not fit the plant,
            that the fit has seen, or that are too short.

    Source:
        C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50 (score test); M. S. Bartlett (independent
        samples of coloured residuals).
    """
    check_kind("refinement", refinement, Refinement, "what `refine` returned")
    plant, records = refinement.plant, refinement.records
    check(refinement.status.ok, "refinement", "must have an answer", str(refinement.status))
    check(0.0 < real(level) < 1.0, "level", "must lie in (0, 1)", level)
    check(not refinement.in_loop, "refinement", "must be of runs that the recorded input drives",
          "one with the controller in the loop", "Refine in windows without it.")  # fmt: skip
    algebraic = [name for name, on in zip(plant.outputs, plant.algebraic, strict=True) if on]
    check(not algebraic, "refinement", "must be of a plant whose outputs are all states",
          f"{', '.join(algebraic)} of relative degree 0",
          "`discover` tries effects on such outputs.")  # fmt: skip
    validation_records = held_out_records(plant, records, validation)
    check_scored_records(plant, "validation", validation_records)
    validation_records = made_alike(validation_records, records, records)
    chosen = (*standard(), *rare()) if effects is None else tuple(effects)
    start = min(float(effect.time[0]) for effect in records)
    chosen = tuple(effect.since(start) for effect in chosen)
    spans = spans_of(records, refinement.window)
    substeps = refinement.substeps if substeps is None else substeps
    runs = LinearisedRuns.of(refinement, records, spans, substeps)
    placed_effects = [effect for effect in placements(plant, chosen) if is_tested(effect.effect)]
    tries = _told_from_offsets([effect for item in placed_effects for effect in runs.tries(item)])
    shares = [runs.share((effect,)) for effect in tries]
    ranking = [runs.candidate((effect,), len(tries)) for effect in _best(tries, shares)]
    maxima = [runs.candidate((effect,), len(tries)) for effect in _further_maxima(tries, shares)]
    result = Remaining(
        plant, _ranked(ranking), _pairs(runs, tries, shares), refinement.rmse, level,
        further_shapes=_by_share(maxima),
    )  # fmt: skip
    if not validation_records:
        return result
    trials = _trials(refinement, result.significant, validation_records, substeps)
    return replace(result, held_out=judged_runs(plant, validation_records), trials=trials)


def _trials(
    refinement: Refinement,
    candidates: Sequence[Candidate],
    validation_records: Sequence[Record],
    substeps: int,
    max_trials: int = 3,
) -> tuple[Trial, ...]:
    """The first `max_trials` candidates, each refined with and judged on held-out records."""
    trials, window = [], refinement.window or np.inf
    for candidate in candidates[:max_trials]:
        plant = augmented(refinement.plant, candidate.placed, candidate.values)
        fit = refine(plant, refinement.records, window=window, substeps=substeps)
        trials.append(Trial(candidate, fit, judged_runs(fit.plant, validation_records)))
    return tuple(trials)


def _told_from_offsets(tries: Sequence[Try], share: float = 0.01) -> list[Try]:
    """Without effects of inputs that do what a constant offset does, which is plainer.

    Of an input that stands still, as the temperature of a room, a square, a dead zone and a limit
    are one and the same offset. `share` is that of their power that must be something else.
    """
    offsets = [attempt.columns for attempt in tries
               if isinstance(attempt.placed.effect, ConstantOffset)]  # fmt: skip
    if not offsets:
        return list(tries)
    directions, _ = np.linalg.qr(np.concatenate(offsets, axis=1))

    def is_told(attempt: Try) -> bool:
        columns = attempt.columns
        remainder = columns - directions @ (directions.T @ columns)
        return bool(np.sum(remainder**2) > share * np.sum(columns**2))

    return [attempt for attempt in tries if not attempt.placed.on_input or is_told(attempt)]


def _best(tries: Sequence[Try], shares: Sequence[float | None]) -> list[Try]:
    """Of the shapes of an effect at a channel the one with the largest share.

    The first of those that are the same but for rounding: beside a parameter that shifts the model
    like the surroundings of a radiation, all of these are.
    """
    best: dict[Any, tuple[float, Try]] = {}
    for attempt, share in zip(tries, shares, strict=True):
        rounded = -np.inf if share is None else round(share, _DIGITS)
        if rounded > best.get(attempt.placed, (-np.inf, None))[0]:
            best[attempt.placed] = rounded, attempt
    return [attempt for _, attempt in best.values()]


def _further_maxima(
    tries: Sequence[Try], shares: Sequence[float | None], prominence: float = 0.5
) -> list[Try]:
    """Effects of one shape at the maxima of their share beside the largest one.

    Beside a maximum the share falls by `prominence` of it or more.
    """
    from scipy.signal import find_peaks  # only discovery needs it

    curves: dict[Placed, list[tuple[float, float, Try]]] = {}
    for attempt, share in zip(tries, shares, strict=True):
        if len(attempt.shape) == 1:
            curve = curves.setdefault(attempt.placed, [])
            curve.append((float(attempt.shape[0]), share or 0.0, attempt))
    maxima: list[Try] = []
    for curve in curves.values():
        curve.sort(key=lambda point: point[0])
        heights = np.array([0.0, *(share for _, share, _ in curve), 0.0])
        peaks, _ = find_peaks(heights, prominence=prominence * heights)
        maxima += [curve[peak - 1][2] for peak in peaks if peak != np.argmax(heights)]
    return maxima


def _by_share(candidates: Sequence[Candidate | None]) -> tuple[Candidate, ...]:
    """Those that are physical, by their share."""
    physical = [candidate for candidate in candidates if candidate is not None]
    return tuple(sorted(physical, key=lambda candidate: -candidate.share))


def _ranked(candidates: Sequence[Candidate | None]) -> tuple[Candidate, ...]:
    """By share; of sets with the same effects at the same channels the best one."""
    best_at: dict[Any, Candidate] = {}
    for candidate in _by_share(candidates):
        best_at.setdefault(tuple(placed.site for placed in candidate.placed), candidate)
    return tuple(best_at.values())


def _pairs(
    runs: LinearisedRuns,
    tries: Sequence[Try],
    shares_alone: Sequence[float | None],
    max_pairs: int = 6,
) -> tuple[Candidate, ...]:
    """The `max_pairs` pairs with the largest shares; of shapes that do the same the first ones."""
    linear = [attempt for attempt, share in zip(tries, shares_alone, strict=True)
              if attempt.placed.effect.gains or share is not None]  # fmt: skip
    shares = runs.pair_shares(linear)
    count = max(len(linear) * (len(linear) - 1) // 2, 1)
    candidates: dict[Any, Candidate | None] = {}
    for place in np.argsort(-np.round(shares, _DIGITS), axis=None, kind="stable"):
        i, j = np.unravel_index(place, shares.shape)
        key = linear[i].placed, linear[j].placed
        if shares[i, j] == 0 or len(candidates) == max_pairs:
            break
        if key not in candidates:
            candidates[key] = runs.candidate((linear[i], linear[j]), count)
    return _ranked([*candidates.values()])
