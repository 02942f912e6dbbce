"""Models that a search in free runs tries, on records that were made in one way.

Each is refined over runs as those of the best model so far, and judged. An effect of several forms
comes in that which fits best; what the records do not tell the size of goes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.holds import SETTINGS
from eoi_jax.data.record import Record
from eoi_jax.discovery.additions import has_size, size_is_known, smallest_values
from eoi_jax.discovery.exchanged_lags import exchanged
from eoi_jax.discovery.free_run_candidates import has_dependence
from eoi_jax.discovery.judge import (
    Judge,
    Judged,
    deviations_of,
    jointly_preferred,
    mean_error,
)
from eoi_jax.discovery.parsimony import limit_of, plainer
from eoi_jax.discovery.probability import Contest
from eoi_jax.discovery.refit import not_simulated
from eoi_jax.discovery.replacements import fixed_shapes, replaced_terms, turned_terms
from eoi_jax.discovery.rules import RULES
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.error_growth import is_lost, returns
from eoi_jax.simulation.step_size import choose_steps

_RULES = RULES.free_runs


@dataclass(frozen=True)
class Search:
    """A search on records that were made in one way.

    Attributes:
        records: to fit.
        searched: those of them, or the part of a long one, in which effects are searched.
        judge: on the others.
        bases: the declared model, refined over whole records, over windows; the better one first.
        ends_alike: whether it was refined from several starts, and from each to the same errors.
    """

    records: tuple[Record, ...]
    searched: tuple[Record, ...]
    judge: Judge
    bases: tuple[Judged, ...]
    ends_alike: bool = False

    @property
    def base(self) -> Judged:
        """The better one."""
        return self.bases[0]

    @property
    def settled_base(self) -> Judged:
        """The better one, refined on all records where a part of them was searched."""
        return self.base if self.searched is self.records else self.settled(self.base) or self.base

    @classmethod
    def begun(
        cls,
        starts: Sequence[Plant],
        records: tuple[Record, ...],
        judge: Judge,
        present: tuple[Placed, ...] = (),
    ) -> "Search | None":
        """With the best base of each length of runs; None without a fit."""
        bases: list[Judged] = []
        searched, agree = portion(records, starts[0]), len(starts) > 1
        judge = replace(judge, of_fit=Judge.of(searched, starts[0]))
        for window in judge.lengths:
            ends = [_fitted(start, present, searched, window, judge) for start in starts]
            fits = [fit for fit in ends if fit is not None]
            bases += [min(fits, key=lambda fit: fit.error_of_all)] if fits else []
            agree &= len(fits) == len(ends)
            agree &= all(judge.is_same(fit.error, bases[-1].error) for fit in fits)
        ordered = sorted(bases, key=lambda fit: fit.error)
        return cls(records, searched, judge, tuple(ordered), agree) if bases else None

    def made_with(self, records: tuple[Record, ...], judging: tuple[Record, ...]) -> "Search":
        """The search on the same records, made in another way; its bases are as they were."""
        searched = portion(records, self.base.refinement.plant)
        judge = replace(self.judge, records=judging)
        if judge.of_fit is not None:
            judge = replace(judge, of_fit=replace(judge.of_fit, records=searched))
        return replace(self, records=records, searched=searched, judge=judge)

    @property
    def is_lost(self) -> bool:
        """Whether whole free runs of the declared model say nothing, however it is refined."""
        errors = [base.runs[0].nrmse for base in self.bases]
        if self.judge.longest is not None:
            return False
        if not all(is_lost(error, np.ones_like(error)) for error in errors):
            return False
        return not returns(self.base.refinement.plant, self.judge.records)

    def predicts_better(self, base: Judged, start: Plant) -> bool:
        """Whether the refined model predicts otherwise than that of the passes, and no worse.

        Both have the same parameters: the records of the fit count as much as those that judge,
        of which a few that move slowly may prefer either by chance.
        """
        if self.judge.is_same(mean_error(self.judge.runs(start)), base.error):
            return False
        judge = self._judge_of_all(start)
        return not judge.prefers(judge.runs(start), judge.runs(base.refinement.plant))

    def predicts_all_better(self, base: Judged, start: Plant) -> bool:
        """The same, where it predicts all records together otherwise."""
        judge = self._judge_of_all(start)
        before, after = judge.runs(start), judge.runs(base.refinement.plant)
        is_same = judge.is_same(mean_error(before), mean_error(after))
        return not is_same and not judge.prefers(before, after)

    def _judge_of_all(self, start: Plant) -> Judge:
        """On the records of the fit and on those that judge."""
        return Judge.of((*self.searched, *self.judge.records), start) or self.judge

    def accepts(self, trial: Judged, best: Judged, rounds: Sequence[Contest]) -> bool:
        """Whether a model is better than the best one by more than chance, or takes its place.

        The records of the fit must show that too: held-out ones are often few, and of many models
        that are tried one may describe these by chance. What both show together is enough.
        """
        held_out = trial.runs, best.runs
        if self.judge.prefers(*held_out) and self.is_shown_by_fit(trial, best):
            return True
        if rounds and self.judge.replaces(trial, best, rounds[-1].origin):
            return self.is_shown_by_fit(trial, rounds[-1].origin)
        if trial.fit_runs is None or best.fit_runs is None:
            return False
        return jointly_preferred([held_out, (trial.fit_runs, best.fit_runs)])

    def is_shown_by_fit(self, trial: Judged, best: Judged) -> bool:
        """Whether the records of the fit show that a model is better, in long or in short runs.

        Or that their errors fall by a third in the mean: what a lag or a store does is over in a
        few blocks, of which no mean over blocks tells much.
        """
        if trial.fit_runs is None or best.fit_runs is None:
            return True
        fall = mean_error(best.fit_runs) - mean_error(trial.fit_runs)
        if fall > -np.log(RULES.answer.confirmed):
            return True
        deviations = deviations_of(trial.fit_runs, best.fit_runs)
        return max(deviations) > RULES.judge.min_deviations

    def answers(self, models: Sequence[Judged]) -> list[Judged]:
        """Models whose errors are lower than those of the base by as much as makes an answer."""
        limit = self.base.error + np.log(RULES.answer.confirmed)
        return [model for model in models if model.error < limit]

    def further(self, model: Judged) -> tuple[Placed, ...]:
        """Effects of a model that the base has not."""
        return tuple(placed for placed in model.placed if placed not in self.base.placed)

    def fitted(self, plant: Plant, placed: tuple[Placed, ...], best: Judged) -> Judged | None:
        """A model refined over runs as those of the best one so far, and judged.

        Without effects whose size is not told: earlier ones stood in for the new one, and of two
        new ones one may be enough. A shape without a trace beside the other parameters, like the
        surroundings of a radiation beside those of the model, keeps its start. None where it has no
        free run or no fit, or where the records do not tell the size of any new one, unless that
        has become the law in which it ends.
        """
        if not_simulated(plant):
            return None
        effects, runs = (*best.placed, *placed), (self.searched, best.refinement.window, self.judge)
        trial = _fitted(plant, effects, *runs)
        if trial is not None and (lost := _lost_shapes(trial, placed)):
            trial = _fitted(plant.declared_anew(fixed=lost), effects, *runs)
        while trial is not None and (unknown := self.of_unknown_size(trial)):
            if all(item in unknown for item in trial.placed if item in placed):
                return self._exchanged(trial, unknown) or self._in_the_limit(trial, unknown)
            trial = self.with_only([item for item in trial.placed if item not in unknown], trial)
        return None if trial is None else self._without_turned(trial)

    def _exchanged(self, model: Judged, unknown: Sequence[Placed]) -> Judged | None:
        """A model with a lag that runs off and the lag of the plant exchanged, if that has a size.

        A small loss that few records tell belongs to the plant, and not to a sensor.
        """
        values = model.refinement.parameters
        for item in unknown:
            remaining = [effect for effect in self.further(model) if effect is not item]
            base = self.base.refinement.plant
            base = base.with_parameters({name: values[name] for name in base.names})
            plant = augmented(base, remaining, values)
            fast = exchanged(plant, item, values[item.names[0]], self.searched)
            if fast is None:
                continue
            plant = model.refinement.plant.with_parameters({**values, **fast})
            runs = self.searched, model.refinement.window, self.judge
            trial = _fitted(plant, model.placed, *runs)
            if trial is not None and not self.of_unknown_size(trial):
                return trial
        return None

    def _in_the_limit(self, model: Judged, unknown: Sequence[Placed]) -> Judged | None:
        """A model with the laws in which effects end whose parameters run off.

        The thrust of a propeller is k u|u|: beside it b u is next to nothing, and of b (u + q u|u|)
        only the product b q is told.
        """
        plant, placed = self.base.refinement.plant, []
        for item in model.placed:
            if item not in unknown:
                placed.append(item)
            elif (end := limit_of(plant, item)) is not None:
                placed.append(end)
            else:
                return None
        # Of what ran off the values say nothing: else from those of the base.
        trials = (self.with_only(placed, start) for start in (model, self.base))
        sized = (trial for trial in trials if trial and not self.of_unknown_size(trial))
        return next(sized, None)

    def narrowed(
        self, model: Judged, effects: Sequence[AbstractEffect], ended: bool = False
    ) -> Judged:
        """A model with laws in place of wider ones that contain them, or end in them.

        Where it is as good: the score test of a base that never stops says little of what makes it
        stop, and a power of the speed imitates dry friction.

        Args:
            model: with effects.
            effects: that may take their places.
            ended: whether only laws go of which a parameter is on a bound.
        """
        for item in self.further(model):
            laws = plainer(self.base.refinement.plant, item, effects)
            for plain in laws if not ended or _is_on_bound(item, model) else ():
                remaining = [effect for effect in model.placed if effect is not item]
                if plain.kind_site in {effect.kind_site for effect in remaining}:
                    continue
                fit = self.with_only([*remaining, plain], model)
                if fit is None or self.of_unknown_size(fit) or self.judge.needs(model, fit):
                    continue
                return self.narrowed(fit, effects, ended)
        return model

    def _tells_parameters(self, model: Judged) -> bool:
        """Whether the records tell some parameter that they told of the declared model alone.

        Else effects have made a part of it so fast, or so large, that only ratios are left.
        """
        base, fit = self.base.refinement, model.refinement
        if not self.further(model):
            return True
        names = [name for name in base.plant.names if _is_sized(name, base)]
        names = [name for name in names if name not in fit.plant.fixed]
        return not names or any(_is_sized(name, fit) for name in names)

    def _without_turned(self, model: Judged) -> Judged:
        """A model without the declared terms whose place its effects have taken.

        Cells in series have no parameter: nothing would be left where they turn all terms. A term
        without which the records that judge are predicted worse stays: a level that is measured
        from anywhere may have either sign.
        """
        names, plant = turned_terms(self.base, model), model.refinement.plant
        if not names or {*names, *plant.fixed} == set(plant.names):
            return model
        plant = plant.declared_anew(dict.fromkeys(names, 0.0), fixed=names)
        fit = _fitted(plant, model.placed, self.searched, model.refinement.window, self.judge)
        if fit is None or self.of_unknown_size(fit) or self.judge.needs(model, fit):
            return model
        return fit

    def of_unknown_size(self, model: Judged) -> list[Placed]:
        """Effects of a model of which the records do not tell the size, or not the shape."""
        fit = model.refinement
        return [
            item
            for item in self.further(model)
            if not has_size(item, fit)
            or not item.effect.is_seen([fit.parameters[name] for name in item.names],
                                       _reach(item, self.searched))
        ]  # fmt: skip

    def further_forms(self, trials: Sequence[Judged]) -> list[Judged]:
        """The best model that has an effect of several forms, in the form that fits best.

        And the best one with a dependence of a parameter, which is such an effect.
        """
        groups = ([trial for trial in trials if has_dependence(trial.placed) == depends]
                  for depends in (False, True))  # fmt: skip
        return [trial for group in groups for trial in self._in_best_form(group)]

    def _in_best_form(self, trials: Sequence[Judged]) -> list[Judged]:
        candidates = [trial for trial in trials if self._next_forms(trial) is not None]
        best = first = min(candidates, key=lambda trial: trial.error, default=None)
        while best is not None and (placed := self._next_forms(best)) is not None:
            trial = self.with_only(placed, best)
            if trial is None or trial.refinement.cost >= best.refinement.cost:
                break
            best = trial
        return [] if best is None or best is first else [best]

    def _next_forms(self, model: Judged) -> tuple[Placed, ...] | None:
        """Effects of a model in their next forms, where these fit; None where none has any."""
        forms = [None if item in self.base.placed or item.channel == item.through
                 else item.effect.next_form() for item in model.placed]  # fmt: skip
        if not any(forms):
            return None
        plant, values, following = self.base.refinement.plant, model.refinement.parameters, []
        for item, form in zip(model.placed, forms, strict=True):
            # One may fit only where another one is: a stream through cells may be a product.
            if form is not None:
                if not form.fits(plant, item.channel):  # a fit may have turned the stream round
                    return None
                item = place(plant, form, item.channel, item.against, item.through)
            if item not in self.base.placed:
                plant = augmented(plant, (item,), smallest_values(item) | values)
            following.append(item)
        return tuple(following)

    def with_only(
        self, placed: Sequence[Placed], model: Judged, opened: bool = False
    ) -> Judged | None:
        """The base with these effects, refined from the values of a model that has them.

        Without the declared terms that it is without, unless these are opened again.
        """
        base, values = self.base, model.refinement.parameters
        declared = base.refinement.plant
        declared = declared.with_parameters({name: values[name] for name in declared.names})
        further = tuple(item for item in placed if item not in base.placed)
        for item in further:
            values = smallest_values(item) | values
        plant, effects = augmented(declared, further, values), (*base.placed, *further)
        fixed = () if opened else replaced_terms(declared, model.refinement.plant)
        fixed = (*fixed, *fixed_shapes(model.refinement.plant, further))
        if further and fixed:
            plant = plant.declared_anew(fixed=fixed)
        return _fitted(plant, effects, self.searched, model.refinement.window, self.judge)

    def _opened(self, placed: Sequence[Placed], model: Judged) -> Judged | None:
        """`with_only`, with the declared terms again that effects without a place now had turned.

        A term stays left out where it does not lower the errors, or where the records do not tell
        the size of an effect beside it: that one is in its place.
        """
        fit = self.with_only(placed, model)
        if fit is None or not replaced_terms(self.base.refinement.plant, fit.refinement.plant):
            return fit
        trial = self.with_only(placed, fit, opened=True)
        if trial is None or self.of_unknown_size(trial):
            return fit
        trial = self._without_turned(trial)
        return trial if self.judge.needs(trial, fit) else fit

    def leanest(self, best: Judged) -> Judged:
        """The model without the effects that it can be without, largest ones first.

        What is left must be shown by the records of the fit.
        """
        further = self.further(best)
        if len(further) < 2:
            return best
        leaner = []
        for effect in further:
            fit = self._opened([item for item in further if item is not effect], best)
            if fit is None or self._needs(best, fit):
                continue
            if self.is_shown_by_fit(fit, self.base):
                leaner.append(fit)
        if not leaner:
            return best
        return self.leanest(min(leaner, key=lambda fit: (fit.size, fit.error)))

    def _needs(self, model: Judged, leaner: Judged) -> bool:
        """Whether a model is better than a leaner one, held out or on all records in the mean."""
        if self.judge.needs(model, leaner):
            return True
        further = max(model.size - leaner.size, 1)
        return leaner.error_of_all - model.error_of_all >= RULES.judge.min_fall * further

    def refitted(self, model: Judged) -> Judged | None:
        """A model of records made in another way, refined on these over runs as long."""
        runs = self.searched, model.refinement.window, self.judge
        return _fitted(model.refinement.plant, model.placed, *runs)

    def is_better_made(self, trial: Judged, best: Judged) -> bool:
        """Whether a model fits these records better by more than chance than those it came from.

        Its parameters are the same ones, so that the likelihood of all samples decides: a hold that
        is wrong by half a sample may raise errors by half a hundredth, and make a time constant a
        third too small. The records that judge are fewer; they must not tell against it.
        """
        gain = count_of(self.searched) * (best.refinement.cost - trial.refinement.cost)
        return gain > SETTINGS.evidence and not self.judge.needs(best, trial)

    def settled(self, best: Judged) -> Judged | None:
        """The model refined on all records, over the length of runs that predicts all of them best.

        As it was where that is hardly better, unless only a part of them was searched. None where
        the fits then tell no parameter any more, as it did: the last effect goes.
        """
        fits = over_both(best.refinement.plant, best.placed, self.records, self.judge)
        ended = [fit for fit in fits if fit.refinement.status.ok]
        determined = [fit for fit in ended if self._tells_parameters(fit)]
        if ended and not determined and self._tells_parameters(best):
            return None
        trial = min(determined or ended, key=lambda fit: fit.error_of_all, default=best)
        is_better = trial.error_of_all < best.error_of_all - RULES.judge.min_fall
        return trial if is_better or self.searched is not self.records else best


def refined(
    plant: Plant, placed: tuple[Placed, ...], records: tuple[Record, ...], judge: Judge
) -> Judged | None:
    """A model refined over the length of runs that predicts better; None where there is no fit.

    Args:
        plant: to refine from its values.
        placed: effects that were added to the declared model in it.
        records: to fit.
        judge: of the fits.
    """
    fits = over_both(plant, placed, records, judge)
    return best_of([fit for fit in fits if fit.refinement.status.ok])


def over_both(
    plant: Plant, placed: tuple[Placed, ...], records: tuple[Record, ...], judge: Judge
) -> list[Judged]:
    """A model refined over the long runs and over the short ones of its judge."""
    fits = [_fitted(plant, placed, records, window, judge) for window in judge.lengths]
    return [fit for fit in fits if fit is not None]


def best_of(fits: Sequence[Judged]) -> Judged | None:
    """What predicts best; None of none."""
    return min(fits, key=lambda fit: fit.error, default=None)


def _fitted(
    plant: Plant,
    placed: tuple[Placed, ...],
    records: tuple[Record, ...],
    window: float | None,
    judge: Judge,
) -> Judged | None:
    """A model refined and judged; None where there is no fit, or where no run tells its start."""
    if plant.rows + sum(plant.open_internal) >= judge.shortest_head:
        return None
    most = _RULES.stepped // count_of(records)
    most = min(max(most, _RULES.fewest_steps), _RULES.steps)
    refinement = refine_once(plant, records, window, max_steps=most)
    if not refinement.status.fits:
        return None
    return judge.judged(refinement, placed)


def portion(records: tuple[Record, ...], plant: Plant) -> tuple[Record, ...]:
    """As many of the records as may be searched, evenly chosen; the beginning of a long one.

    Args:
        records: to fit.
        plant: the declared model, whose runs with their derivatives take time for each state,
            parameter and step.
    """
    work = work_per_sample(records, plant)
    most = min(_RULES.samples // len(plant.outputs), _RULES.work // work)
    if count_of(records) <= most:
        return records
    for number in range(len(records) - 1, 0, -1):
        places = np.linspace(0, len(records) - 1, number).round().astype(int)
        chosen = tuple(records[i] for i in places)
        if count_of(chosen) <= most:
            return chosen
    return (records[0][:most],)


def work_per_sample(records: tuple[Record, ...], plant: Plant) -> int:
    """Steps of a simulation in a sample, times states with their derivatives."""
    states = plant.rows * len(plant.outputs) + len(plant.open_internal)
    signals = states * (1 + len(plant.names) - len(plant.fixed) + states)
    return choose_steps(plant, records).count * max(signals, 1)


def count_of(records: tuple[Record, ...]) -> int:
    """Number of samples."""
    return sum(len(record) for record in records)


def _reach(placed: Placed, records: tuple[Record, ...]) -> float:
    """Largest less smallest value of the output that an effect acts on; of the time if of that."""
    if placed.effect.depends_on == "t":
        return max(float(record.time[-1] - record.time[0]) for record in records)
    outputs = np.concatenate([record.known_outputs for record in records])
    signal = outputs[:, placed.output]
    if placed.against is not None:
        signal = signal - outputs[:, placed.against]
    return float(np.nanmax(signal) - np.nanmin(signal))


def _lost_shapes(model: Judged, placed: Sequence[Placed]) -> tuple[str, ...]:
    """Shapes of effects that only together with a parameter of the model leave a trace.

    Of an effect that says something else: one without any trace goes.
    """
    lost = {name for name, error in model.refinement.standard_errors.items() if np.isposinf(error)}
    if lost <= {name for item in model.placed for name in item.names}:
        return ()
    effects = [item for item in placed if not lost.issuperset(item.names)]
    shapes = [name for item in effects for name in item.names[len(item.effect.gains) :]]
    return tuple(name for name in shapes if name in lost)


def _is_on_bound(placed: Placed, model: Judged) -> bool:
    """Whether a parameter of an effect is on a bound."""
    values = model.refinement.parameters
    return any(
        values[name] in (parameter.lower, parameter.upper)
        for name, parameter in zip(placed.names, placed.effect.parameters, strict=True)
    )


def _is_sized(name: str, fit: Refinement) -> bool:
    """Whether a fit tells the size of a parameter that it estimates."""
    return name not in fit.plant.fixed and size_is_known(
        [name], fit.parameters, fit.standard_errors
    )
