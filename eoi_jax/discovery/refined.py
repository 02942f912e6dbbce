r"""Refine a discovered model by output error, and add effects that only its free run shows.

The injection weights a missing effect by its force, the free run by its consequences: a small force
of constant sign is negligible in the injection, but causes most of the free run's error. The steps:

1. `refine` the model on the records of the fit.
2. `remaining`: find the most significant effect, or two, that the free run lacks; add and refine.
   Repeat while there is one and the held-out free runs, whole and in windows, improve. A law that
   it contains takes its place where these are as good.
3. `refine` the best model over short runs: the error of an incomplete model accumulates over a long
   run and biases its parameters, and a long run that loses its phase is not informative.

The model with the lowest of these errors is kept. The first refinement, which adds nothing, only
must not be worse than the discovered model: at the noise level both are equal, and the refinement
is the better estimate. An addition, and a fit to short runs in place of whole ones, must reduce
these errors by more than a hundredth.

All that is on request. Unasked, a model that lacks nothing is refined where passes are biased by
noise, or by samples far apart, and free runs show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.discovery.acceptance import labels_of
from eoi_jax.discovery.additions import added_effect, as_fit, uncertain_effects
from eoi_jax.discovery.free_run_trials import Search, count_of, portion
from eoi_jax.discovery.judge import Judge, probability_better
from eoi_jax.discovery.parsimony import plainer
from eoi_jax.discovery.probability import Standing
from eoi_jax.discovery.refit import on_bounds, window_of
from eoi_jax.discovery.remarks import FitNote, is_on_fit
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.preparation import PreparedRecords
from eoi_jax.estimation.runaway import is_as_good
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects import rare, standard
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine, refine_once
from eoi_jax.refinement.remaining import remaining
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.validate import FreeRuns, whole_and_windows

_RULES = RULES.refinement


@dataclass(frozen=True)
class Polished:
    """The model that was kept.

    Attributes:
        refinement: its refinement.
        placed: the added effects, in the order of their addition.
        runs: its free runs on the held-out records.
    """

    refinement: Refinement
    placed: tuple[Placed, ...]
    runs: FreeRuns


def refined_answer(
    task: Task, discovery: Discovery, effects: Sequence[AbstractEffect] | None
) -> Discovery:
    """The refined discovery, with the effects that only free runs show."""
    records = task.held_out or task.records
    assert discovery.after is not None
    initial = discovery.after, discovery.windows_after
    better = polished(
        discovery.plant, task.records, records, initial, window_of(task, records), effects
    )
    if isinstance(better, str):
        return replace(discovery, notes=(*discovery.notes, better))
    notes = [note for note in discovery.notes if not is_on_fit(note)]
    notes += on_bounds(task.plant, better.refinement.plant)
    short = better.refinement.window
    length = "" if short is None else f" over windows of {short:.3g} s"
    notes.append(f"refined{length}: {better.refinement.status}")
    if better.placed:
        notes.append(f"found in the free run alone: {labels_of(better.placed).replace('_', ' ')}")
    result = better.refinement
    fit = as_fit(task.prepared, result)
    refined_effects = [
        replace(
            addition,
            parameters={name: result.parameters[name] for name in addition.parameters},
            standard_errors={name: result.standard_errors[name] for name in addition.parameters},
        )
        for addition in discovery.added
    ]
    chance = probability_better(better.runs, initial)
    sure = Standing(chance, ()) if task.held_out else None
    further = [added_effect(task.plant, fit, placed, sure) for placed in better.placed]
    added = [*refined_effects, *further]
    notes += uncertain_effects(added)
    unseen = discovery.status.code == "nothing_missing" and better.placed
    return replace(
        discovery, status=Status("complete", _ONLY_FREE_RUN) if unseen else discovery.status,
        effects=tuple(dict.fromkeys(addition.effect.name for addition in added)),
        added=tuple(added),
        after=better.runs[0], windows_after=better.runs[1], found=fit, plant=result.plant,
        notes=tuple(notes),
    )  # fmt: skip


def without_bias(task: Task, discovery: Discovery) -> Discovery:
    """An answer that nothing is missing, refined where its parameters are not those of free runs.

    Noise in the regressors and samples far apart bias the passes, which their residual does not
    show. Both estimates are of the same parameters: the refined one, which fits best, is the answer
    where all records together are predicted otherwise, and not worse by more than chance.
    """
    records, plant = task.held_out or task.records, discovery.plant
    if discovery.status.code != "nothing_missing" or discovery.after is None:
        return discovery
    judge = Judge.of(records, plant)
    if judge is None or _is_settled(plant, portion(task.records, plant), judge):
        return discovery
    search = Search.begun([plant], task.records, judge)
    if search is None:
        return discovery
    base = search.settled_base
    result = base.refinement
    if not (result.status.ok and search.predicts_all_better(base, plant)):
        return discovery
    return refined_passes(discovery, result, task.prepared)


def refined_passes(
    discovery: Discovery, result: Refinement, prepared: PreparedRecords
) -> Discovery:
    """An answer with the declared model refined in place of the fit of the passes.

    Args:
        discovery: the answer, of which there are free runs.
        result: the refinement.
        prepared: records of the fit.
    """
    assert discovery.after is not None
    short = discovery.windows_after
    lengths = None if short is None else short.window, discovery.after.window
    runs = whole_and_windows(result.plant, discovery.held_out, *lengths)
    notes = [note for note in discovery.notes if not is_on_fit(note)]
    notes += [*on_bounds(discovery.declared.nominal, result.plant), FitNote(_UNBIASED)]
    return replace(
        discovery, after=runs[0], windows_after=runs[1], found=as_fit(prepared, result),
        plant=result.plant, notes=tuple(notes),
    )  # fmt: skip


def best_refinement(starts: Sequence[Plant], records: Sequence[Record]) -> Refinement:
    """The best of the refinements from each start.

    Of those that fit as well that from the last start: where parts of a plant may change places,
    as two stores in a row, the nominal values say which is which.

    Args:
        starts: the model at the values to refine it from, nominal ones last.
        records: to fit.
    """
    fits = [refine(start, records) for start in starts]
    best = min(fits, key=lambda fit: (not fit.status.ok, fit.window is not None, fit.cost))
    last = fits[-1]
    is_alike = last.status.ok and last.window == best.window
    return last if is_alike and is_as_good(last.cost, best.cost) else best


def with_hint(task: Task, discovery: Discovery) -> Discovery:
    """An answer that nothing is missing, with a note on an effect that only free runs hint at.

    A small force of constant sign is lost in the noise of the injection, and is seen in free runs.
    The score test of these knows no actuators, and no outputs that are functions of the states.
    """
    plant = discovery.plant
    is_known = plant.actuator is None and not plant.has_algebraic and plant.sampled is None
    if discovery.status.code != "nothing_missing" or discovery.after is None or not is_known:
        return discovery
    if count_of(task.records) > _RULES.hint_samples:
        return discovery
    fit = refine_once(plant, portion(task.records, plant), None)
    missing = remaining(fit, level=_RULES.hint).best if fit.status.ok else None
    if missing is None:
        return discovery
    note = FitNote(_HINT.format(labels_of(missing.placed), missing.significance))
    return replace(discovery, notes=(*discovery.notes, note))


def _is_settled(plant: Plant, records: tuple[Record, ...], judge: Judge) -> bool:
    """Whether a refinement ends after a few steps, no parameter beyond its standard errors.

    Over long runs and over short ones: in either it may end in a wrong minimum next to the start.
    """
    for window in judge.lengths:
        fit = refine_once(plant, records, window, max_steps=_RULES.first_steps)
        moves = np.subtract(list(fit.parameters.values()), list(plant.parameters.values()))
        limits = RULES.judge.min_deviations * np.array(list(fit.standard_errors.values()))
        if fit.status.code != "converged" or np.any(np.abs(moves) > limits):
            return False
    return True


def polished(
    plant: Plant,
    records: Sequence[Record],
    validation: Sequence[Record],
    initial: FreeRuns,
    window: float | None,
    effects: Sequence[AbstractEffect] | None = None,
) -> Polished | str:
    """Refine a model, and add the effects that its free run lacks.

    Args:
        plant: the plant with the estimate of the passes.
        records: the records of the fit.
        validation: the records on which models are compared.
        initial: free runs of `plant` on `validation`.
        window: length of re-initialised free runs [s]; None if the records are too short for them.
        effects: candidate effects; those of `remaining` by default.

    Returns:
        The model that was kept, or the reason why there is none.
    """
    longest = initial[0].window
    long_run_fit = _over_whole_runs(plant, records, validation, initial, window, effects)
    if window is None:
        return long_run_fit
    start, runs, placed, allowed_change = plant, initial, (), _RULES.negligible
    if isinstance(long_run_fit, Polished):
        start, runs, placed, allowed_change = (
            long_run_fit.refinement.plant,
            long_run_fit.runs,
            long_run_fit.placed,
            -_RULES.negligible,
        )
    refinement = refine(start, records, window=window)
    short_run_fit = Polished(
        refinement, placed, whole_and_windows(refinement.plant, validation, window, longest)
    )
    return (
        short_run_fit
        if refinement.status.ok and _changes_less_than(runs, short_run_fit.runs, allowed_change)
        else long_run_fit
    )


def _over_whole_runs(
    plant: Plant,
    records: Sequence[Record],
    validation: Sequence[Record],
    initial: FreeRuns,
    window: float | None,
    effects: Sequence[AbstractEffect] | None,
) -> Polished | str:
    best: Polished | None = None
    declared, longest = plant, initial[0].window
    placed: tuple[Placed, ...] = ()
    for iteration in range(1 + _RULES.additions):
        refinement = refine(plant, records)
        if not refinement.status.ok:
            return best or f"not refined: {refinement.status}"
        runs = whole_and_windows(refinement.plant, validation, window, longest)
        allowed = -_RULES.negligible if placed else _RULES.negligible
        if _changes_less_than(initial if best is None else best.runs, runs, allowed):
            best = Polished(refinement, placed, runs)
            best = _with_plainer_laws(best, declared, records, validation, effects)
            refinement, placed = best.refinement, best.placed
        elif placed:  # the addition does not improve the held-out free runs
            break
        # `remaining` knows no actuators, and no outputs that are functions of the states.
        if iteration == _RULES.additions or plant.actuator is not None or plant.has_algebraic:
            break
        missing = remaining(refinement, effects).best
        if missing is None:
            break
        plant, placed = (
            augmented(refinement.plant, missing.placed, missing.values),
            (*placed, *missing.placed),
        )
    return best or "not refined: that makes free runs worse on the records that judge"


def _with_plainer_laws(
    model: Polished,
    declared: Plant,
    records: Sequence[Record],
    validation: Sequence[Record],
    effects: Sequence[AbstractEffect] | None,
) -> Polished:
    """A model with laws that its further effects contain in their places, where it is as good.

    Args:
        model: refined with further effects.
        declared: the plant without these.
        records: of the fit.
        validation: on which models are compared.
        effects: among which laws are looked for; those of `remaining` by default.
    """
    library = (*standard(), *rare()) if effects is None else effects
    long_runs, short_runs = model.runs
    lengths = None if short_runs is None else short_runs.window, long_runs.window
    for i, wide in enumerate(model.placed):
        for law in plainer(declared, wide, library):
            values = dict(model.refinement.parameters)
            values |= {new: values[old] for new, old in zip(law.names, wide.names, strict=False)}
            placed = (*model.placed[:i], law, *model.placed[i + 1 :])
            base = declared.with_parameters({name: values[name] for name in declared.names})
            refinement = refine(augmented(base, placed, values), records)
            runs = whole_and_windows(refinement.plant, validation, *lengths)
            if refinement.status.ok and _changes_less_than(model.runs, runs, _RULES.negligible):
                trial = Polished(refinement, placed, runs)
                return _with_plainer_laws(trial, declared, records, validation, effects)
    return model


def _changes_less_than(initial: FreeRuns, after: FreeRuns, limit: float) -> bool:
    """Whether the logarithms of all errors, whole and in windows, change by less than `limit`.

    Of several outputs the mean counts.
    """
    pairs = [(old, new) for old, new in zip(initial, after, strict=True) if old and new]
    return all(
        float(np.mean(np.log(np.maximum(new.rmse, 1e-300) / np.maximum(old.rmse, 1e-300)))) < limit
        for old, new in pairs
    )


_HINT = (
    "within their noise, free runs of the refined model hint at {} (p {:.1g}): `refine=True` adds "
    "it where that predicts better"
)
_UNBIASED = (
    "refined by the error of its free runs: noise in the outputs, or samples far apart, may bias "
    "the passes, whose parameters and errors are those before"
)
_ONLY_FREE_RUN = (
    "the injection shows nothing beyond the noise, but free runs do: it was found in these"
)
