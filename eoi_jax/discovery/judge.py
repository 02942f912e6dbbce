"""The judge of models: paired free-run errors on held-out records, whole runs and windows.

Two models are compared block by block. The mean of the differences over their standard error says
whether one predicts better by more than chance; Student's t with as many degrees of freedom as
blocks, less one, gives the probability of it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.data.windows import steps_behind, steps_between_samples
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import PRODUCTS
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.error_growth import window_head
from eoi_jax.simulation.sensor_noise import sensor_noise, shows_noise
from eoi_jax.simulation.validate import FreeRuns, growth_that_rules, judged_runs
from eoi_jax.simulation.validation import Validation

_RULES = RULES.judge


@dataclass(frozen=True)
class Judged:
    """A refined model with its free runs on the records that judge.

    Attributes:
        refinement: of the model with `placed` in it.
        placed: effects that were added to the declared model.
        runs: whole runs, and runs in windows.
        fit_runs: the same on the records of the fit; None where these are too short to judge.
    """

    refinement: Refinement
    placed: tuple[Placed, ...]
    runs: FreeRuns
    fit_runs: FreeRuns | None = None

    @cached_property
    def error(self) -> float:
        """Mean logarithm of the normalised errors of all outputs, whole and in windows."""
        return mean_error(self.runs)

    @cached_property
    def error_of_all(self) -> float:
        """The mean of `error` and the same on the records of the fit.

        Records that judge are often few: of many models one may predict these by chance that is far
        from those of the fit.
        """
        if self.fit_runs is None:
            return self.error
        return 0.5 * (self.error + mean_error(self.fit_runs))

    @property
    def short_runs(self) -> Validation:
        """Those in windows; whole ones of records too short for these."""
        return self.runs[1] or self.runs[0]

    @property
    def size(self) -> int:
        """Parameters of its effects, less those whose terms they replace."""
        effects = sum(len(effect.names) for effect in self.placed)
        return effects - len(self.refinement.plant.fixed)

    @property
    def burden(self) -> float:
        """Number of its effects; rarity and further parameters of wide laws count as effects."""
        return sum(1.0 + at.effect.rarity + _further_parameters(at) for at in self.placed)


@dataclass(frozen=True)
class Judge:
    """Records on which models are compared.

    Attributes:
        records: that no fit has seen.
        window: length of short runs [s]; None: whole runs alone, of records too short for others.
        head: samples at the start of each, not scored.
        whole_head: the same of whole runs.
        longest: length of the long runs [s]; None: whole records.
        of_fit: the same for the records of the fit; None where these are too short, or not asked.
    """

    records: tuple[Record, ...]
    window: float | None
    head: int
    whole_head: int
    longest: float | None = None
    of_fit: "Judge | None" = None

    @classmethod
    def of(cls, records: tuple[Record, ...], plant: Plant) -> "Judge | None":
        """The judge of a model and of what is added to it; None with records too short for that.

        Windows are long enough for motion beyond the noise, and to know their starts; of whole runs
        a block of samples for each derivative tells it, for the error of a velocity grows. Of an
        unstable plant a whole run says nothing where it misses by much: the error of its start
        grows. Windows in which it stays small are then the long runs.

        Args:
            records: that judge.
            plant: the declared model, fitted.
        """
        step = steps_between_samples(records)
        shortest, segment = _samples(records, step)
        fewest = max(_RULES.min_window, min(_RULES.min_window * plant.rows, shortest // 3))
        if segment < min(fewest, shortest) or shortest < _RULES.fewest:
            return None
        block = shortest // _RULES.blocks + 3
        whole_head = min(_RULES.start, plant.rows * block, shortest // 3, segment // 2)
        whole_head = _steps_with(records, whole_head, step)
        if 2 * fewest > shortest:
            return cls(records, None, whole_head, whole_head)
        whole = judged_runs(plant, records, whole_head)
        noise = sensor_noise(whole)
        moving = [
            parts
            for parts in _RULES.windows
            if _moves(records, round(shortest // parts * step), noise)
        ]
        count = max(shortest // max(moving, default=min(_RULES.windows)), fewest)
        if 2 * count > shortest:
            return None
        period = step * records[0].sample_period
        head = min(_RULES.start, count // 3, segment // 2)
        judge = cls(records, count * period, round(head * step), whole_head)
        growth = growth_that_rules(plant, whole, limit=_RULES.misled)
        if growth is None:
            return judge
        longest = max(growth.window, 2.0 * _RULES.min_window * period)
        count = min(count, round(0.5 * longest / period))
        head = min(head, count // 3)
        return cls(
            records, count * period, round(head * step),
            window_head(longest, plant, records), longest,
        )  # fmt: skip

    @property
    def lengths(self) -> tuple[float | None, ...]:
        """Lengths of the runs that models are refined over [s]; None of whole records."""
        return tuple(dict.fromkeys((self.longest, self.window)))

    @property
    def shortest_head(self) -> int:
        """Samples that tell the start of a run, at least, also on the records of the fit."""
        heads = [self.head, self.whole_head]
        return min(heads if self.of_fit is None else [*heads, self.of_fit.shortest_head])

    def without_whole_runs(self) -> "Judge":
        """A judge by two lengths of windows, for models of which whole runs say nothing."""
        if self.window is None:
            return self
        return replace(self, longest=2.0 * self.window, whole_head=self.head)

    def runs(self, plant: Plant, steps: int | None = None) -> FreeRuns:
        """Free runs of a model: long ones, and short ones in as many steps.

        Args:
            plant: the model.
            steps: per sample; None: until half as long ones agree, or there would be too many.
        """
        long_runs = judged_runs(
            plant, self.records, self.whole_head, self.longest, steps, _RULES.steps
        )
        if self.window is None:
            return long_runs, None
        steps = long_runs.substeps
        return long_runs, judged_runs(plant, self.records, self.head, self.window, steps)

    def judged(self, refinement: Refinement, placed: tuple[Placed, ...]) -> Judged:
        """A refined model with its free runs, on both kinds of records in as short steps."""
        plant, runs, of_fit = refinement.plant, self.runs(refinement.plant), self.of_fit
        if of_fit is None:
            return Judged(refinement, placed, runs)
        periods = [[record.sample_period for record in judge.records] for judge in (self, of_fit)]
        steps = math.ceil(runs[0].substeps * max(periods[1]) / min(periods[0]))
        return Judged(refinement, placed, runs, of_fit.runs(plant, steps))

    def prefers(self, trial: FreeRuns, best: FreeRuns) -> bool:
        """Whether the free runs of a model are better than another's by more than chance."""
        if mean_error(best) - mean_error(trial) < _RULES.min_fall:
            return False
        deviations = deviations_of(trial, best)
        return bool(max(deviations) > _RULES.min_deviations > -min(deviations))

    def replaces(self, trial: Judged, best: Judged, origin: Judged) -> bool:
        """Whether a model takes the place of one that was chosen before it.

        Neither contains the other, and both came from the same one: that it lacks something is
        known. Of the two the smaller error decides, by as much as makes each further effect stay.
        """
        if set(best.placed) <= set(trial.placed):
            return False
        further = max(trial.burden - best.burden, 1.0)
        lower = best.error - trial.error >= _RULES.min_fall * further
        return lower and self.prefers(trial.runs, origin.runs)

    def is_as_good(self, trial: FreeRuns, best: FreeRuns) -> bool:
        """Whether the errors of a model are no larger than another's."""
        return mean_error(trial) < mean_error(best) + _RULES.same_error

    def is_same(self, first: float, second: float) -> bool:
        """Whether two mean errors differ by what counts as none."""
        return abs(first - second) <= _RULES.same_error

    def needs(self, model: Judged, leaner: Judged) -> bool:
        """Whether a model is better than one with fewer effects by what makes an effect stay."""
        return leaner.error >= model.error + _RULES.min_fall

    def plainest(self, trials: Sequence[Judged]) -> Judged:
        """The model with the fewest effects among those that are as good as the best one.

        On all records, and on those that judge. Of as many effects that with the fewest parameters:
        an end stop imitates an offset. Each further effect must be better by as much as decides, a
        rare one as often as it is rare, and a law that contains a simpler one for each of its
        further parameters. A product, which names no cause, must predict better than
        laws by more than chance.
        """

        def penalty(trial: Judged) -> float:
            return _RULES.min_fall * trial.burden

        def weighed(trial: Judged) -> float:
            return trial.error_of_all + penalty(trial)

        best = min(trials, key=weighed)
        limits = weighed(best), best.error + penalty(best)
        as_good = [
            trial
            for trial in trials
            if weighed(trial) < limits[0] + _RULES.min_fall
            and trial.error + penalty(trial) < limits[1] + _RULES.min_fall
        ]
        plainest = min(as_good, key=lambda trial: (len(trial.placed), trial.size, weighed(trial)))
        laws = [trial for trial in trials if products_in(trial) < products_in(plainest)]
        if not laws or self.prefers(plainest.runs, min(laws, key=weighed).runs):
            return plainest
        return self.plainest(laws)

    def plainest_of_all(self, trials: Sequence[Judged], accepted: Sequence[Judged]) -> Judged:
        """The plainest of the accepted models, or one with fewer parameters that is as good.

        That the model before lacks something one accepted model shows. A plainer one as good, whose
        errors fall by hardly less than two standard errors, must not leave its place to a wider.
        """
        chosen = self.plainest(accepted)
        plainer = [
            trial
            for trial in trials
            if trial.size < chosen.size
            and trial.error_of_all < chosen.error_of_all + _RULES.same_error
        ]
        return self.plainest([chosen, *plainer])


def _further_parameters(placed: Placed) -> int:
    """Parameters of a law beyond the one of a simpler law that it contains; 0 without such."""
    return len(placed.names) - 1 if placed.effect.contains else 0


def products_in(model: Judged) -> int:
    """How many of its effects are products of signals."""
    return sum(isinstance(at.effect, PRODUCTS) for at in model.placed)


def _samples(records: Sequence[Record], step: float) -> tuple[int, int]:
    """Samples of the shortest record, and of the shortest of their longest parts of known inputs.

    Args:
        records: that judge.
        step: of the grid from a sample to the next.
    """
    parts = [max(stop - start for start, stop in record.input_segments()) for record in records]
    return int(min(map(len, records)) / step), int(min(parts) / step)


def _steps_with(records: Sequence[Record], count: int, step: float) -> int:
    """Steps of the grid up to the sample that follows so many at the start of each record, at most.

    Args:
        records: that judge.
        count: of samples of each output.
        step: of the grid from a sample to the next, on average.
    """
    columns = [valid for record in records for valid in record.output_valid.T]
    ends = [steps_behind(valid, count) for valid in columns if np.sum(valid) > count]
    return min(round(count * step), max([count, *ends]))


def _moves(records: Sequence[Record], count: int, noise: Float[np.ndarray, " ny"]) -> bool:
    """Whether outputs move by more than their noise in windows of so many samples."""
    for record in records:
        outputs = record.known_outputs
        windows = [outputs[at : at + count] for at in range(0, len(outputs) - count + 1, count)]
        measured = [part for part in windows if np.all(np.any(np.isfinite(part), axis=0))]
        if not measured:
            return False
        spread = np.sqrt(np.mean([np.nanvar(part, axis=0) for part in measured], axis=0))
        if np.any(spread < _RULES.motion * noise):
            return False
    return True


def mean_error(runs: FreeRuns) -> float:
    """Mean logarithm of the normalised errors of all outputs, whole and in windows."""
    sizes = [np.nan_to_num(run.nrmse, nan=np.inf) for run in runs if run is not None]
    return float(np.mean(np.log(np.clip(sizes, np.finfo(float).tiny, _RULES.largest_error))))


def error_ratio(trial: Validation, rival: Validation) -> float:
    """The error of a model over that of another one on the same runs, geometric mean of outputs."""
    return float(np.exp(mean_error((trial, None)) - mean_error((rival, None))))


def ratio_beyond_noise(trial: Validation, rival: Validation) -> float:
    """`error_ratio` of what exceeds the noise of the sensors, where the samples show that noise.

    Errors E of a model are its own errors and, independent of them, the noise: E² less σ² is the
    square of the former, told down to the share of σ² to which that is known.
    """
    noise = np.where(shows_noise(trial), sensor_noise(trial, rival), 0.0) ** 2
    least, largest = _RULES.noise_known * noise + np.finfo(float).tiny, np.finfo(float).max
    squares = [np.clip(run.rmse**2 - noise, least, largest) for run in (trial, rival)]
    return float(np.exp(0.5 * np.mean(np.log(squares[0]) - np.log(squares[1]))))


def least_error_ratio(trial: Validation, rival: Validation) -> float:
    """What `error_ratio` would be if the model were true.

    The errors E of the other one would then be noise and, independent of that, the difference D of
    both predictions: √(1 - D²/E²).
    """
    squares, counts = np.zeros(len(trial.outputs)), np.zeros(len(trial.outputs))
    pairs = zip(trial.predictions, rival.predictions, strict=True)
    for record, (first, second), scored in zip(trial.records, pairs, trial.scored_at, strict=True):
        counted = record.output_valid & scored[:, None]
        squares += np.sum(np.where(counted, (first.outputs - second.outputs) ** 2, 0.0), axis=0)
        counts += np.sum(counted, axis=0)
    tiny = np.finfo(float).tiny
    noise = np.clip(1.0 - squares / np.maximum(counts * rival.rmse**2, tiny), tiny, 1.0)
    return float(np.exp(0.5 * np.mean(np.log(noise))))


def only_otherwise(judge: Judge, trial: Plant, rival: Plant) -> bool:
    """Whether a model predicts the records of a judge otherwise than another one, hardly better."""
    pairs = zip(judge.runs(trial), judge.runs(rival), strict=True)
    ratios = [
        (error_ratio(new, old), least_error_ratio(new, old)) for new, old in pairs if new and old
    ]
    reached, attainable = np.exp(np.mean(np.log(ratios), axis=0))
    return bool(attainable < RULES.answer.confirmed <= reached)


def errors_of_each(runs: FreeRuns) -> list[float]:
    """Mean errors of long runs, and of short ones."""
    return [mean_error((run, None)) for run in runs if run]


def noise_level(runs: FreeRuns) -> float:
    """What the mean error would be if the errors were the noise of the sensors."""
    levels = []
    for run in runs:
        if run is not None:
            noise = sensor_noise(run)
            measured = np.isfinite(run.rmse) & (run.rmse > 0.0)
            levels.append(
                noise * np.divide(run.nrmse, run.rmse, np.zeros(noise.shape), where=measured)
            )
    return float(np.mean(np.log(np.maximum(levels, np.finfo(float).tiny))))


def odds(
    rival: FreeRuns,
    chosen: FreeRuns,
    further: float = 0.0,
    of_fit: tuple[FreeRuns, FreeRuns] | None = None,
) -> float:
    """Odds that a rival predicts better than a model that was chosen.

    A model that leaves more than noise is not the true one, and what it lacks may make either a
    little better, on all blocks alike: by as much as makes an effect stay, for the share of what it
    leaves that is no noise.

    Args:
        rival: free runs of the rival.
        chosen: those of the model, on the same records.
        further: burden of the rival beyond that of the model: it must be better by as much as makes
            so many effects stay.
        of_fit: free runs of both on the records of the fit, which then count as much.
    """
    noise = np.exp(2.0 * (noise_level(chosen) - mean_error(chosen)))
    unexplained = _RULES.min_fall * float(np.sqrt(max(1.0 - noise, 0.0)))
    margin = _RULES.min_fall * max(further, 0.0)
    better = probability_better(rival, chosen, margin, unexplained, of_fit)
    largest = RULES.probability.largest_odds
    return float(min(better / max(1.0 - better, 1.0 / largest), largest))


def probability_better(
    first: FreeRuns,
    second: FreeRuns,
    margin: float = 0.0,
    shared_error: float = 0.0,
    of_fit: tuple[FreeRuns, FreeRuns] | None = None,
) -> float:
    """Probability that a model predicts better than another, by the mean error of their free runs.

    The standard error of the difference is that of a mean over the blocks of the held-out records,
    to first order (delta method).

    Args:
        first: free runs of the model.
        second: those of the other one, on the same records.
        margin: difference of mean errors by which the first must be better.
        shared_error: standard error of what all blocks have in common.
        of_fit: free runs of both on the records of the fit: then the mean of both falls counts.
    """
    from scipy.special import stdtr  # only discovery needs it

    falls, variances, blocks = [], [], []
    for runs in [(first, second), *([of_fit] if of_fit else [])]:
        pairs = [(run, rival_run) for run, rival_run in zip(*runs, strict=True)
                 if run and rival_run]  # fmt: skip
        models = zip(*pairs, strict=True)
        diverges = [any(np.isinf(run.rmse).any() for run in model) for model in models]
        if diverges[0] != diverges[1]:
            return float(diverges[1])
        parts = [_log_fall(rival_run, run) for run, rival_run in pairs]
        falls.append(np.mean([fall for fall, _ in parts]))
        counting = np.any([_block_sums(run)[1] > 0 for run, _ in pairs], axis=(0, 2))
        influence = np.mean([part for _, part in parts], axis=0)[counting]
        variances.append(np.var(influence, ddof=1) / len(influence))
        blocks.append(len(influence))
    error = np.hypot(np.sqrt(np.sum(variances)) / len(falls), shared_error)
    fall = float(np.mean(falls)) - margin
    return float(stdtr(sum(blocks) - len(blocks), fall / max(error, np.finfo(float).tiny)))


def _log_fall(rival: Validation, trial: Validation) -> tuple[float, Float[np.ndarray, " blocks"]]:
    """Mean logarithm over outputs of an error over another, and what each block has to do with it.

    With q the squared errors of a block, n their mean number and S the mean square over all blocks:
    ½ log(S/S'), and the mean of ½ (q/S - q'/S')/n.
    """
    tiny = np.finfo(float).tiny
    old, new = _block_sums(rival), _block_sums(trial)
    squares = [
        np.sum(sums, axis=0) / np.maximum(np.sum(counts, axis=0), 1.0) + tiny
        for sums, counts in (old, new)
    ]
    falls = 0.5 * np.log(squares[0] / squares[1])
    usual = np.maximum(np.mean(new[1][np.any(new[1] > 0, axis=1)], axis=0), tiny)
    parts = 0.5 * (old[0] / squares[0] - new[0] / squares[1]) / usual
    return float(np.mean(falls)), np.mean(parts, axis=1)


def deviations_of(trial: FreeRuns, rival: FreeRuns) -> list[float]:
    """Fall of the error of long and short runs below a rival's, in its standard errors."""
    return [_deviations(*pair) for pair in zip(rival, trial, strict=True)]


def jointly_preferred(pairs: Sequence[tuple[FreeRuns, FreeRuns]]) -> bool:
    """Whether free runs of a model are better than another's by more than chance on all records.

    On each kind of records the mean error falls by what decides, and by a share of what it falls by
    on the other: what describes one kind alone is of that. In no length of runs it rises by as much
    as decides; together their deviations are those of chance hardly ever (Stouffer's sum).

    Args:
        pairs: free runs of the model and of the other one, on each kind of records.
    """
    means = [mean_error(rival) - mean_error(trial) for trial, rival in pairs]
    if min(means) < max(_RULES.min_fall, _RULES.least_share * max(means)):
        return False
    falls = [np.subtract(errors_of_each(rival), errors_of_each(trial)) for trial, rival in pairs]
    deviations = [deviations_of(*pair) for pair in pairs]
    if np.min(falls) < -_RULES.min_fall or np.min(deviations) < -_RULES.min_deviations:
        return False
    joint = sum(map(max, deviations)) / np.sqrt(len(deviations))
    return bool(joint > _RULES.min_joint_deviations)


def _deviations(rival: Validation | None, trial: Validation | None) -> float:
    """Mean fall of the error over blocks, over its standard error; ± infinite where one diverges.

    Of squares or of logarithms, whichever is larger: a few blocks may hold most of the error.
    """
    if rival is None or trial is None:
        return 0.0
    diverges = [bool(np.isinf(runs.rmse).any()) for runs in (rival, trial)]
    if any(diverges):
        return 0.0 if all(diverges) else np.inf if diverges[0] else -np.inf
    old, new = (np.nanmean(_blocks(runs) / rival.rmse**2, axis=1) for runs in (rival, trial))
    tiny = np.finfo(float).tiny
    return max(_standardised(old - new), _standardised(np.log((old + tiny) / (new + tiny))))


def _blocks(validation: Validation) -> Float[np.ndarray, "blocks ny"]:
    """Mean squared errors of the blocks of all records; NaN where no sample of an output counts."""
    sums, counts = _block_sums(validation)
    means = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return means[np.any(counts > 0, axis=1)]


def _block_sums(
    validation: Validation,
) -> tuple[Float[np.ndarray, "blocks ny"], Float[np.ndarray, "blocks ny"]]:
    """Sums of squared errors, and numbers of samples that count, of the blocks of all records."""
    sums, counts = [], []
    for error in validation.residual:
        counted = np.isfinite(error)
        square = np.where(counted, error**2, 0.0)
        parts = (np.array_split(values, _RULES.blocks) for values in (square, counted))
        for errors, counting in zip(*parts, strict=True):
            sums.append(np.sum(errors, axis=0))
            counts.append(np.sum(counting, axis=0, dtype=float))
    return np.asarray(sums), np.asarray(counts)


def _standardised(values: Float[np.ndarray, " blocks"]) -> float:
    """Mean over its standard error; 0 of a single block, which has none."""
    if len(values) < 2:
        return 0.0
    spread = float(np.std(values, ddof=1) / np.sqrt(len(values)))
    return float(np.mean(values)) / max(spread, float(np.finfo(float).tiny))
