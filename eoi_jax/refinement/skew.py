r"""The skew of the inputs by free runs: channels that a logger reads one after another.

An input that acts later by τ than it was logged moves the errors e of the free runs by
$e(\tau) \approx e + D\tau$, D by differences of runs with the input shifted both ways. In what the
parameters and the starts of the runs can do with it taken out, least squares gives τ and the power
that it takes away: a step of Gauss and Newton for the price of 2 nu + 1 simulations. Where that is
clear, all is refined with the inputs shifted, and the error of that fit decides.

An input that acts later by more than a sample period is delayed by the plant; one that acts
earlier than it was logged was logged late, by however much.

A held input that acts early and one that goes on and acts late are nearly the same, so an input
with a skew is also tried with its other holds, half a sample earlier or later. What the samples
suggest counts where no other one fits clearly better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.holds import (
    SETTINGS,
    clearly_smaller,
    moving_inputs,
    undeclared_hold,
    with_hold,
    with_word,
)
from eoi_jax.data.input_holds import HOLDS, Hold, hold_of_each
from eoi_jax.data.record import Record
from eoi_jax.estimation.hold import faster_plants, keeps_direction, longest_lead
from eoi_jax.estimation.regression.orthonormal import orthonormal
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.problem import Problem, Unknowns, problem_of, weighed
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.spans import spans_of

Delays = Float[np.ndarray, " nu"]
Fit = Callable[[Plant, tuple[Record, ...]], Refinement]


@dataclass(frozen=True)
class FreeRunSkewSettings:
    """How a skew is found.

    Attributes:
        shift: of an input, to either side, for the slopes of the errors [sample periods].
        steps: of Gauss and Newton, at most.
        late_steps: the same of an input that was logged late by more than a sample.
        leads: of an input that was logged late, that are tried.
        noise: errors over the noise of the sensors, from which on they are.
        rank_tolerance: singular value of the columns of the unknowns, over the largest, below which
            a direction is rounding.
    """

    shift: float = 0.25
    steps: int = 3
    late_steps: int = 12
    leads: int = 14
    noise: float = 1.5
    rank_tolerance: float = 1e-8


_SETTINGS = FreeRunSkewSettings()


@dataclass(frozen=True)
class SkewedFit:
    """A refinement with shifted inputs.

    Attributes:
        fit: of the records with this hold and these delays.
        hold: of the inputs.
        delays: by which each input acts later than it was logged [s].
    """

    fit: Refinement
    hold: Hold
    delays: Delays

    @property
    def error(self) -> float:
        """Geometric mean over the outputs."""
        return mean_error(self.fit)


def mean_error(result: Refinement) -> float:
    """Geometric mean over the outputs of the errors of the runs."""
    return float(np.exp(np.mean(np.log(np.maximum(result.rmse, 1e-300)))))


def scored_samples(result: Refinement) -> int:
    """Number of scored samples, their mean over the outputs."""
    count = sum(int(np.sum(np.isfinite(part))) for part in result.residual)
    return max(count // len(result.plant.outputs), 1)


def fit_with_skew(
    result: Refinement, records: tuple[Record, ...], hold: Hold, fit: Fit
) -> SkewedFit | None:
    """The refinement on shifted inputs, where they have a skew that lowers the error clearly.

    Args:
        result: the refinement with the hold that fits best without a skew.
        records: as they were read; those that declare their hold are not shifted.
        hold: of the other ones.
        fit: refines a plant, from its parameters, on records.
    """
    count, inputs = scored_samples(result), moving_inputs(records)
    if not inputs:
        return None

    def better(trial: SkewedFit, reference: SkewedFit) -> bool:
        return clearly_smaller(trial.error**2, reference.error**2, count)

    plain = SkewedFit(result, hold, np.zeros(records[0].inputs.shape[1]))
    best = _shifted(plain, records, fit, inputs)
    if _leaves_more_than_noise(best.fit):
        late = [trial for j in inputs if (trial := _logged_late(plain, records, fit, j))]
        best = min([best, *late], key=lambda trial: trial.error)
    if best is plain:
        return None
    period = min(record.sample_period for record in records)
    rule = hold_of_each(undeclared_hold(records) or hold, len(best.delays))
    for j in np.flatnonzero(best.delays).tolist():
        words = hold_of_each(best.hold, len(best.delays))
        trials = []
        for word in HOLDS:
            if word == words[j]:
                continue
            delays = best.delays.copy()
            delays[j] += 0.5 * period * (int(words[j] == "zero") - int(word == "zero"))
            if delays[j] > period:
                continue
            changed = with_word(best.hold, j, word, len(words))
            refined = fit(best.fit.plant, with_hold(records, changed, delays))
            if refined.status.fits:
                trial = SkewedFit(refined, changed, delays)
                trials.append(_shifted(trial, records, fit, (j,)))
        candidates = [best, *trials]
        closest = min(candidates, key=lambda trial: trial.error)
        if better(closest, best):
            best = closest
        for trial in candidates:
            if hold_of_each(trial.hold, len(words))[j] == rule[j] and not better(best, trial):
                best = trial
    seen = np.max(np.abs(best.delays)) >= SETTINGS.least_skew * period
    for j in np.flatnonzero(best.delays < -SETTINGS.earliest * period).tolist():
        falls = best.error**2 * SETTINGS.least_lead < plain.error**2
        seen = seen and falls and keeps_direction(result.plant, best.fit.plant, records, j)
        seen = seen and not _answers_early(best, records, fit, j)
    return best if seen and better(best, plain) else None


def _answers_early(best: SkewedFit, records: tuple[Record, ...], fit: Fit, j: int) -> bool:
    """Whether the plant without a lead, but with a faster part, leaves no larger errors."""
    logged = with_hold(
        records, best.hold, np.where(np.arange(len(best.delays)) == j, 0.0, best.delays)
    )
    models = faster_plants(best.fit.plant, j, -float(best.delays[j]))
    fits = [refined for model in models if (refined := fit(model, logged)).status.fits]
    return any(mean_error(refined) <= best.error for refined in fits)


def _shifted(
    start: SkewedFit, records: tuple[Record, ...], fit: Fit, inputs: Sequence[int]
) -> SkewedFit:
    """A fit whose inputs are shifted as long as the error falls clearly; itself if it does not."""
    best = start
    period = min(record.sample_period for record in records)
    longest = longest_lead(records)
    count = scored_samples(start.fit)
    for number in range(_SETTINGS.late_steps):
        if number >= _SETTINGS.steps and np.min(best.delays) >= -SETTINGS.earliest * period:
            break
        step = _predicted_skew(best, records, inputs)
        if step is None or np.max(best.delays + step) > period:
            break
        if np.min(best.delays + step) < -longest:
            break
        delays = best.delays + step
        refined = fit(best.fit.plant, with_hold(records, best.hold, delays))
        trial = SkewedFit(refined, best.hold, delays) if refined.status.fits else best
        if not clearly_smaller(trial.error**2, best.error**2, count):
            break
        best = trial
    return best


def _leaves_more_than_noise(result: Refinement) -> bool:
    noise = np.max([record.noise for record in result.records], axis=0)
    return bool(np.any(result.rmse > _SETTINGS.noise * noise))


def _logged_late(
    start: SkewedFit, records: tuple[Record, ...], fit: Fit, j: int
) -> SkewedFit | None:
    """A fit with an input that was logged late, by as much as leaves the least of linearised runs.

    A lead of many samples is too far for a step of Gauss and Newton, and that of an input that acts
    on an output at once leaves no slope between samples. None where none takes two
    thirds of the power.
    """
    result, plant = start.fit, start.fit.plant
    spans = spans_of(result.records, result.window)
    period = min(record.sample_period for record in records)
    longest = longest_lead(records) / period
    leads = np.unique(np.geomspace(1.0, max(longest, 1.0), _SETTINGS.leads).round())
    powers = {}
    for lead in (0.0, *leads):
        delays = np.where(np.arange(len(start.delays)) == j, -lead * period, start.delays)
        shifted = with_hold(records, start.hold, delays)
        problem = weighed(problem_of(plant, shifted, spans, result.substeps), result.rmse)
        unknowns = _unknowns_of(result, problem)
        columns = signals(unknowns, problem)
        if np.all(np.isfinite(columns)):
            rows = _without_unknowns(columns, unknowns.starts.shape[1], 1)
            powers[lead] = float(np.sum(rows**2)), delays
    power, delays = min(powers.values(), key=lambda item: item[0], default=(np.inf, None))
    if delays is None or 0.0 not in powers or power * SETTINGS.least_lead > powers[0.0][0]:
        return None
    refined = fit(plant, with_hold(records, start.hold, delays))
    if not refined.status.fits:
        return None
    return _shifted(SkewedFit(refined, start.hold, delays), records, fit, (j,))


def _predicted_skew(
    start: SkewedFit, records: tuple[Record, ...], inputs: Sequence[int]
) -> Delays | None:
    """Further delays by which the power of the errors falls most; None if it does not fall clearly.

    Args:
        start: the fit with the delays so far.
        records: as they were read.
        inputs: that may be shifted.
    """
    result, plant = start.fit, start.fit.plant
    spans = spans_of(result.records, result.window)
    shift = _SETTINGS.shift * min(record.sample_period for record in records)

    def problem(delays: Delays) -> Problem:
        shifted = with_hold(records, start.hold, delays)
        return weighed(problem_of(plant, shifted, spans, result.substeps), result.rmse)

    unshifted = problem(start.delays)
    unknowns = _unknowns_of(result, unshifted)
    columns = signals(unknowns, unshifted)
    slopes = []
    for j in inputs:
        move = shift * (np.arange(len(start.delays)) == j)
        later, earlier = (
            signals(unknowns, problem(start.delays + sign * move))[..., -1] for sign in (1.0, -1.0)
        )
        slopes.append((later - earlier) / (2.0 * shift))
    joined = np.concatenate([columns[..., :-1], np.stack(slopes, axis=-1), columns[..., -1:]], -1)
    if not np.all(np.isfinite(joined)):
        return None
    rows = _without_unknowns(joined, unknowns.starts.shape[1], len(inputs) + 1)
    step = np.zeros(len(start.delays))
    step[list(inputs)] = _least_squares(rows[:, :-1], rows[:, -1], scored_samples(result))
    return step if np.any(step) else None


def _unknowns_of(result: Refinement, problem: Problem) -> Unknowns:
    """Free parameters and the starts of all runs, as they were refined."""
    rows, columns = list(problem.kernel.rows), list(problem.kernel.columns)
    starts = [start.unknowns(rows, columns) for start in result.starts]
    return Unknowns(np.asarray(result.plant.theta)[list(problem.free)], np.stack(starts))


def _without_unknowns(
    columns: Float[np.ndarray, "runs time ny size"], start_size: int, count: int
) -> Float[np.ndarray, "rows count"]:
    """The last `count` columns, less what the starts of each run and the parameters can do."""
    tolerance, parts = _SETTINGS.rank_tolerance, []
    for run in columns:
        rows = run.reshape(-1, run.shape[-1])
        basis = orthonormal(rows[:, :start_size], tolerance)
        slopes = rows[:, start_size:]
        parts.append(slopes - basis @ (basis.T @ slopes))
    rows = np.concatenate(parts)
    basis = orthonormal(rows[:, :-count], tolerance)
    return rows[:, -count:] - basis @ (basis.T @ rows[:, -count:])


def _least_squares(
    slopes: Float[np.ndarray, "rows inputs"], error: Float[np.ndarray, " rows"], count: int
) -> Float[np.ndarray, " inputs"]:
    """Delays that lower the power of the error, clearly each: zeros where they do not."""
    inputs = list(range(slopes.shape[1]))
    delays = np.zeros(len(inputs))
    while inputs:
        chosen = slopes[:, inputs]
        values = np.linalg.lstsq(chosen, -error, rcond=_SETTINGS.rank_tolerance)[0]
        after = float(np.sum((error + chosen @ values) ** 2))
        rises = []
        for j in range(len(inputs)):  # what the error loses without one of them
            fewer = np.delete(chosen, j, axis=1)
            refitted = np.linalg.lstsq(fewer, -error, rcond=_SETTINGS.rank_tolerance)[0]
            rises.append(float(np.sum((error + fewer @ refitted) ** 2)))
        weakest = int(np.argmin(rises))
        if clearly_smaller(after, rises[weakest], count):
            delays[inputs] = values
            return delays
        inputs.pop(weakest)
    return delays
