"""Records of which each has parameters of its own, where common ones leave more than noise.

Loads, ballast and gears may change from one record to the next. A model with common parameters then
misses all of them, and effects that nothing has lower its errors. Here each record is fitted by
itself: the declared model, then the effect that lowers the errors of all most, as long as they are
not described. Where they are, and the same model with common parameters is as far off as the
answer, the records ask for different parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.discovery.free_run_trials import work_per_sample
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.regression.robust_covariance import correlation_time
from eoi_jax.models.augmented import Placed, added_effects, augmented
from eoi_jax.models.effects import PRODUCTS, Drift, ParameterDependence, SinusoidalDisturbance
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.record_check import differing_parameters, mean_ratio, pooled_errors
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.remaining import Remaining, remaining
from eoi_jax.refinement.result import Refinement

_RULES = RULES.own_parameters
# These name no cause, or explain any motion of a single record.
_STAND_INS = (*PRODUCTS, Drift, ParameterDependence, SinusoidalDisturbance)

Fits = tuple[Refinement, ...]  # of one model, one for each record


@dataclass(frozen=True)
class OwnParameters:
    """A model with parameters of its own in each record.

    Attributes:
        fits: one for each record.
        placed: effects in the model, beside those that are declared.
        ratio: error over that of the answer, or of the same model with common parameters, whichever
            leaves less: free runs in windows, geometric mean of the outputs.
        differing: names of the parameters that differ from record to record.
    """

    fits: Fits
    placed: tuple[Placed, ...]
    ratio: float
    differing: tuple[str, ...]


@dataclass(frozen=True)
class OwnFits:
    """Fits of records by themselves.

    Attributes:
        declared: the model, at the values to start from.
        records: beginnings of those of the fit, several.
        window: length of the runs [s].
        effects: to try in the model.
        level: of significance.
    """

    declared: Plant
    records: tuple[Record, ...]
    window: float
    effects: tuple[AbstractEffect, ...]
    level: float

    @classmethod
    def of(
        cls,
        declared: Plant,
        records: tuple[Record, ...],
        window: float,
        effects: Sequence[AbstractEffect],
        level: float,
    ) -> "OwnFits":
        """With the effects that name a cause, and so much of each record as takes little time."""
        causes = tuple(effect for effect in effects if not isinstance(effect, _STAND_INS))
        count = _RULES.work // (len(records) * work_per_sample(records, declared))
        beginnings = []
        for record in records:
            fewest = int(_RULES.windows * window / record.sample_period) + 1
            beginnings.append(record[: max(count, fewest)])
        return cls(declared, tuple(beginnings), window, causes, level)

    def differing_from(self, answer: Plant) -> OwnParameters | None:
        """The fits, where the records ask for different parameters; else None.

        None where common parameters do as well, where a record by itself is not described to
        (nearly) its noise, or where no parameter differs by far more than its standard errors.

        Args:
            answer: a model with common parameters, refined here over the same runs.
        """
        joint = self._refined(answer, self.records)
        if not joint.status.fits or not self._is_left(joint):
            return None
        fits = self._described()
        if fits is None:
            return None
        model = fits[0].plant
        starts = [model.with_parameters(fit.parameters) for fit in fits[: _RULES.starts]]
        common = [joint, *(self._refined(plant, self.records) for plant in starts)]
        errors = pooled_errors(fits, self.records)
        ratios = [mean_ratio(errors, fit.rmse) for fit in common if fit.status.fits]
        ratio = max(ratios)
        differing = differing_parameters(fits, _RULES.deviations)
        if not (ratio < _RULES.ratio and differing):
            return None
        if self._chance(fits, ratio) > self.level:
            return None
        placed = added_effects(model)[len(added_effects(self.declared)) :]
        return OwnParameters(fits, placed, ratio, differing)

    def _is_left(self, joint: Refinement) -> bool:
        """Whether a fit with common parameters leaves so much that errors could fall to a third."""
        noise = np.max([record.noise for record in self.records], axis=0)
        return mean_ratio(noise, joint.rmse) < _RULES.ratio

    def _described(self) -> Fits | None:
        """Fits of the model that describes each record; None where none does."""
        fits = self._fitted([self.declared] * len(self.records))
        for _ in range(_RULES.effects):
            if fits is None or all(map(_is_described, fits, self.records)):
                break
            fits = self._with_effect(fits)
        if fits is None or not all(map(_is_described, fits, self.records)):
            return None
        return fits

    def _with_effect(self, fits: Fits) -> Fits | None:
        """The fits with the effect that lowers the errors of all records most."""
        if not all(fit.status.ok for fit in fits):
            return None
        tests = [remaining(fit, self.effects, level=self.level) for fit in fits]
        trials = [
            self._fitted([
                augmented(fit.plant, (placed,), _values(test, placed))
                for fit, test in zip(fits, tests, strict=True)
            ])
            for placed in _most_likely(tests)
        ]  # fmt: skip
        return min((trial for trial in trials if trial), key=self._cost, default=None)

    def _fitted(self, starts: Sequence[Plant]) -> Fits | None:
        """A model fitted to each record, from its start and from the best fit of all.

        What does not stop, or stops too often, does not come to the law that holds.
        """
        pairs = list(zip(starts, self.records, strict=True))
        fits = [self._refined(plant, (record,)) for plant, record in pairs]
        ended = [fit for fit in fits if fit.status.fits]
        if not ended:
            return None
        best = min(ended, key=lambda fit: _misfit(fit))
        for number, (plant, record) in enumerate(pairs):
            if fits[number] is best or _is_described(fits[number], record):
                continue
            trial = self._refined(plant.with_parameters(best.parameters), (record,))
            if trial.status.fits and not trial.cost >= fits[number].cost:
                fits[number] = trial
        return tuple(fits) if all(fit.status.fits for fit in fits) else None

    def _refined(self, plant: Plant, records: tuple[Record, ...]) -> Refinement:
        return refine_once(plant, records, self.window, max_steps=_RULES.steps)

    def _cost(self, fits: Fits) -> float:
        """Mean logarithm of the errors, and what each parameter must lower them by."""
        errors = np.log(pooled_errors(fits, self.records))
        return float(np.mean(errors)) + RULES.judge.min_fall * len(fits[0].plant.names)

    def _chance(self, fits: Fits, ratio: float) -> float:
        """Probability of such errors by chance: likelihood ratio of the independent samples."""
        from scipy.special import chdtrc

        residuals = [fit.residual[0] for fit in fits]
        scored = [part[np.all(np.isfinite(part), axis=1)] for part in residuals]
        scored = [part for part in scored if len(part) > 1]
        if not scored:
            return 1.0
        stacked = np.concatenate(scored)
        independent = len(stacked) / correlation_time(stacked, [len(part) for part in scored])
        parameters = (len(fits) - 1) * int(np.sum(fits[0].plant.free))
        ny = stacked.shape[1]
        return float(chdtrc(parameters, -2.0 * ny * independent * np.log(ratio)))


def _most_likely(tests: Sequence[Remaining]) -> list[Placed]:
    """The effects that take most of the errors of all records, by their score tests."""
    logs: dict[Placed, list[float]] = {}
    for test in tests:
        for item in test.ranking:
            logs.setdefault(item.placed[0], []).append(np.log(max(1.0 - item.share, _TINY)))
    complete = [placed for placed, values in logs.items() if len(values) == len(tests)]
    return sorted(complete, key=lambda placed: sum(logs[placed]))[: _RULES.trials]


def _values(test: Remaining, placed: Placed) -> dict[str, float]:
    """Parameters of an effect, as the score test of a record says."""
    return next(item.values for item in test.ranking if item.placed == (placed,))


def _is_described(fit: Refinement, record: Record) -> bool:
    """Whether the free runs of a record miss by (nearly) its noise, or by next to nothing."""
    if not fit.status.fits:
        return False
    limit = np.maximum(RULES.answer.noise * record.noise, _RULES.small * _spread(record))
    return bool(np.all(fit.rmse <= limit))


def _misfit(fit: Refinement) -> float:
    """Error over the spread of the outputs, geometric mean."""
    return float(np.mean(np.log(np.maximum(fit.rmse, _TINY) / _spread(fit.records[0]))))


def _spread(record: Record) -> Float[np.ndarray, " ny"]:
    return np.maximum(np.nanstd(record.known_outputs, axis=0), _TINY)


_TINY = float(np.finfo(float).tiny)
