"""The discovery that follows from a search in free runs, where the injection leaves it open."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.holds import undeclared_hold, with_hold
from eoi_jax.data.input_holds import HOLDS, hold_text
from eoi_jax.data.record import Record
from eoi_jax.discovery.acceptance import labels_of, names_of
from eoi_jax.discovery.additions import (
    added_effect,
    as_fit,
    has_size,
    smallest_values,
    uncertain_effects,
)
from eoi_jax.discovery.confirm import beyond_noise
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.doubts import (
    bends_factor,
    may_be_motion,
    may_be_rate,
    may_be_store,
    stands_in,
)
from eoi_jax.discovery.expected_error import error_over_noise, misses
from eoi_jax.discovery.free_run_candidates import Model
from eoi_jax.discovery.free_run_evidence import (
    contradicted_by_fit,
    long_run_ratio,
    lost_on_held_out,
    shown_by_all,
    surpasses,
    without_stand_ins,
)
from eoi_jax.discovery.free_run_search import FreeRunAnswer, RecordPair, search_free_runs
from eoi_jax.discovery.free_run_trials import Search, refined
from eoi_jax.discovery.judge import Judge, Judged, mean_error
from eoi_jax.discovery.probability import Standing, beside_rival, from_contests, odds_of
from eoi_jax.discovery.refit import on_bounds
from eoi_jax.discovery.remarks import FitNote, GridNote, HoldNote, Reason, is_on_fit
from eoi_jax.discovery.replacements import fixed_shapes, replaced_terms
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation
from eoi_jax.discovery.rivals import experiments
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.holdout import resting_outputs
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.augmented import Placed, added_effects, augmented, place
from eoi_jax.models.effects import (
    PRODUCTS,
    ActuatorLag,
    InputDelay,
    InputProduct,
    InputRate,
    Product,
)
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.sensor_noise import sensor_noise
from eoi_jax.simulation.validate import whole_and_windows

_RULES = RULES.questions


def with_free_runs(
    discovery: Discovery,
    records: tuple[Record, ...],
    held_out: tuple[Record, ...],
    effects: Sequence[AbstractEffect],
    partial: Sequence[Model],
    lowpass: LowPass | None,
    alpha: float,
) -> Discovery:
    """The discovery, with what lowers the error of free runs on held-out records.

    Args:
        discovery: the answer so far.
        records: to fit, as given.
        held_out: that judge, as given.
        effects: to try.
        partial: models with effects that do not explain enough of the injection.
        lowpass: F of the fits; None: chosen from the records.
        alpha: level of significance of the score test.
    """
    plant, variants = discovery.declared.nominal, _variants(discovery, records, held_out)
    rival = discovery.plant if discovery.added else None
    further = list(partial)
    if rival is not None:
        further.append((rival, placed_effects(discovery)))
    starts = [discovery.declared.plant, plant]
    answer = search_free_runs(starts, variants, effects, further, rival, alpha)
    if answer is None:
        return discovery
    justified = rival is not None and not stands_in(discovery.added)
    is_store, is_motion = may_be_store(discovery.added), may_be_motion(discovery)
    value = _odds(discovery, answer) if is_motion else 0.0
    doubted = is_store or is_motion or bends_factor(discovery) or may_be_rate(discovery)
    # Of a change in time, or of a kink, it is enough that the other model is more probable.
    is_likely = value * RULES.probability.likely > 1.0 - RULES.probability.likely
    replaced = is_likely or surpasses(answer, discovery.plant, placed_effects(discovery))
    if justified and doubted and not replaced:
        return _with_rivals(discovery, answer.best, value)
    outcome = answered(discovery, answer, effects, lowpass)
    if justified and contradicts_injection(outcome, discovery):
        return _with_rivals(discovery, answer.best, value)
    return outcome


def with_rate_in_place(
    discovery: Discovery,
    records: tuple[Record, ...],
    held_out: tuple[Record, ...],
    rate: InputRate,
    lowpass: LowPass | None,
    alpha: float,
) -> Discovery:
    """The discovery, with a response to the rate of an input where that predicts better than a lag.

    Or than a delay, or both: what is late by as much to first order is tried in their place.

    Args:
        discovery: the answer so far, which explains the injection with a delay or a lag.
        records: to fit, as given.
        held_out: that judge, as given.
        rate: to try.
        lowpass: F of the fits; None: chosen from the records.
        alpha: level of significance of the score test.
    """
    declared, values = discovery.declared.nominal, discovery.plant.parameters
    plant = declared.with_parameters({name: values[name] for name in declared.names})
    placed: list[Placed] = []
    for item in placed_effects(discovery):
        if not isinstance(item.effect, ActuatorLag | InputDelay):
            placed.append(item)
            continue
        (late,) = (values[name] for name in item.names)
        law = place(plant, rate, item.channel)
        if law not in placed:
            placed.append(law)
            values |= smallest_values(law)
        lead, lag = law.names
        values[lead] -= late
        values[lag] += late if isinstance(item.effect, ActuatorLag) else 0.5 * late  # H. Padé
    model = augmented(plant, placed, values), tuple(placed)
    effects = rate, *(item.effect for item in placed if item.effect != rate)
    return with_free_runs(discovery, records, held_out, effects, [model], lowpass, alpha)


def _odds(discovery: Discovery, answer: FreeRunAnswer) -> float:
    """Odds of the model that free runs came to over an answer that was tried among others."""
    placed, best = placed_effects(discovery), answer.best
    trials = [trial for contest in answer.rounds for trial in contest.trials]
    own = [trial for trial in trials if trial.placed == placed]
    if not own or best.placed == placed:
        return 0.0
    chosen = min(own, key=lambda trial: trial.error)
    return odds_of(best, chosen, best.burden - chosen.burden)


def _with_rivals(discovery: Discovery, best: Judged, value: float) -> Discovery:
    """The discovery with the model of free runs as a rival, which predicts no better for certain.

    Args:
        discovery: the answer so far, which explains the injection.
        best: the model.
        value: its odds over the answer.
    """
    plant, placed = discovery.declared.nominal, placed_effects(discovery)
    rivals = [law for law in best.placed if law not in placed]
    standings, added = _standings_of(discovery), []
    for item, law in zip(discovery.added, placed, strict=True):
        if value and rivals and law in standings and law not in best.placed:
            standing = beside_rival(plant, standings[law], rivals, value)
            item = replace(item, probability=standing.probability, rivals=standing.rivals)
        added.append(item)
    labels = [rival.effect for item in added for rival in item.alternatives]
    labels = [name for name in labels if name not in discovery.effects]
    names = tuple(dict.fromkeys((*discovery.ambiguous_with, *labels)))
    advice = discovery.advice or experiments(plant, added, names)
    return replace(discovery, added=tuple(added), ambiguous_with=names, advice=advice)


def contradicts_injection(outcome: Discovery, justified: Discovery) -> bool:
    """Whether an answer leaves far more of the injection than one that the injection justifies.

    What is missing explains both. Effects that lower the errors of free runs alone stand in for
    what these show of it.
    """
    old, new = (fit.index[fit.best_pass] for fit in (justified.found, outcome.found))
    return bool(np.any(new > _RULES.contradicted * old))


def placed_effects(discovery: Discovery) -> tuple[Placed, ...]:
    """The effects of an answer at their places in its plant; those that are declared apart."""
    return added_effects(discovery.plant)[len(added_effects(discovery.declared.nominal)) :]


def _variants(
    discovery: Discovery, records: tuple[Record, ...], held_out: tuple[Record, ...]
) -> list[RecordPair]:
    """Records to fit and to judge, made as the answer so far has it, then in each other way."""
    settled = discovery.held_out[0]
    # A skew belongs to the hold that it was found with: zero, to others, is half a sample of delay.
    makings = [(settled.hold, settled.skew)]
    if undeclared_hold(records) is not None:
        skewed = np.any(settled.skew)
        makings += [(hold, None) for hold in HOLDS if skewed or hold != settled.hold]
    return [
        (with_hold(records, hold, skew), with_hold(held_out, hold, skew)) for hold, skew in makings
    ]


def begun_search(discovery: Discovery, records: tuple[Record, ...]) -> Search | None:
    """A search with the declared model refined, on records made as the answer has them.

    Args:
        discovery: the answer so far.
        records: to fit, as given.

    Returns:
        None where the model has no fit, or the held-out records are too short to judge.
    """
    declared, judging = discovery.declared, discovery.held_out
    fitted = with_hold(records, judging[0].hold, judging[0].skew)
    judge = Judge.of(judging, declared.plant)
    return judge and Search.begun([declared.plant, declared.nominal], fitted, judge)


def unless_refined_is_better(discovery: Discovery, records: tuple[Record, ...]) -> Discovery:
    """The discovery without its effects, where the declared model predicts better when refined.

    The injection of a model whose parameters are biased may be explained by an effect that makes up
    for the bias. Effects of which the refined answer does not tell the size give way to a model
    that predicts as well.

    Args:
        discovery: the answer so far, which explains the injection.
        records: to fit, as given.
    """
    search, declared = begun_search(discovery, records), discovery.declared
    if search is None:
        return discovery
    judge, placed = replace(search.judge, of_fit=None), placed_effects(discovery)
    named = refined(discovery.plant, placed, search.records, judge)
    runs = [judge.runs(discovery.plant)] + ([named.runs] if named else [])
    plain, rival = search.base.runs, min(runs, key=mean_error)
    fit = named.refinement if named else discovery.found
    known = all(has_size(at, fit) for at in placed)
    if not (judge.prefers(plain, rival) or (not known and judge.is_as_good(plain, rival))):
        return discovery
    reason = _AS_GOOD.format(" and ".join(discovery.effects))
    return replace(
        discovery, effects=(), added=(), ambiguous_with=(), advice="", explained=0.0,
        after=discovery.before, windows_after=discovery.windows_before,
        found=declared, plant=declared.plant, status=Status("unexplained", reason),
        notes=(*_not_on_fit(discovery), f"refused: {reason}"),
        diagnosis=diagnose(declared, records),
    )  # fmt: skip


def with_further_effects(
    discovery: Discovery,
    records: tuple[Record, ...],
    held_out: tuple[Record, ...],
    effects: Sequence[AbstractEffect],
    lowpass: LowPass | None,
    alpha: float,
) -> Discovery:
    """The discovery refined, with effects that only free runs show beside its own.

    Effects are added where they lower the errors of the refined answer as much as what confirms an
    effect elsewhere, products only where they leave no more than noise; the answer is refined where
    that lowers them by more than chance. Where an injection hardly resolves a fast mode, it does
    not tell holds apart: the likelihood of free runs decides. A skew of the inputs may stand for a
    lag: then records are also taken as they were logged, each in a search of its own.

    Args:
        discovery: the answer so far, which explains the injection.
        records: to fit, as given.
        held_out: that judge, as given.
        effects: to try.
        lowpass: F of the fits; None: chosen from the records.
        alpha: level of significance of the score test.
    """
    plant, variants = discovery.plant, _variants(discovery, records, held_out)
    is_skewed = np.any(discovery.held_out[0].skew)
    searches = [[variant] for variant in variants] if is_skewed else [variants]
    present = placed_effects(discovery)
    answers = [search_free_runs([plant], search, effects, (), None, alpha, present)
               for search in searches]  # fmt: skip
    answers = [answer for answer in answers if answer is not None]
    if not answers:
        return discovery
    base = min((answer.base for answer in answers), key=lambda model: model.error)
    answer = min(answers, key=lambda answer: answer.best.error)
    model, ratio = answer.best, float(np.exp(answer.best.error - base.error))
    further = model.placed[len(present) :]
    hints = []
    confirms = bool(further) and ratio < RULES.answer.confirmed
    is_product = any(isinstance(at.effect, PRODUCTS) for at in further)
    if confirms and is_product and beyond_noise(model.short_runs, plant=model.refinement.plant):
        # It names no cause, and would take its share of those that are named.
        hints = [_HINT.format(" and ".join(_signals_of(plant, at) for at in further), ratio)]
    if hints or not confirms:
        answer = answers[0]
        model, further = answer.base, ()
        if not answer.better_base:
            return replace(discovery, notes=(*discovery.notes, *hints))
    sure = RULES.probability.sure
    doubted = [at for at, item in zip(present, discovery.added, strict=True)
               if item.probability is not None and item.probability < sure]  # fmt: skip
    model = without_stand_ins(answer, model, discovery.declared.nominal, doubted)
    fit = _fit_of(discovery, answer, model, lowpass)
    long_runs, short_runs = discovery.before, discovery.windows_after
    assert long_runs is not None
    window = None if short_runs is None else short_runs.window
    added = _added(discovery, answer, fit, model)
    runs = whole_and_windows(fit.plant, answer.judging, window, long_runs.window)
    searched = [note for note in discovery.notes if isinstance(note, GridNote)]
    notes = [*_lasting(discovery, answer, model.placed), *searched, *hints]
    notes += [] if discovery.base is None else [_REFINED]
    notes.append(_FURTHER.format(labels_of(further), ratio) if further else _BETTER)
    notes += _replaced(discovery, fit.plant, further)
    if gone := labels_of([at for at in present if at not in model.placed]):
        notes.append(_STOOD_IN.format(gone))
    return replace(
        discovery, effects=names_of(model.placed), added=added,
        after=runs[0], windows_after=runs[1], found=fit, plant=fit.plant, held_out=answer.judging,
        notes=(*notes, *_portion_note(answer), *on_bounds(discovery.declared.nominal, fit.plant),
               *uncertain_effects(added)),
    )  # fmt: skip


def _signals_of(plant: Plant, placed: Placed) -> str:
    """A product by its signals, any other effect by its name."""
    effect, output = placed.effect, plant.outputs[placed.output]
    if isinstance(effect, Product):
        signals = {"y": output, "v": f"{output}'", "u": (*plant.inputs, "u")[0]}
        return "the product of " + " and ".join(signals[key] for key in effect.factors)
    if isinstance(effect, InputProduct):
        return "the product of " + " and ".join(signal.symbol for signal in effect.signals)
    return effect.words


def answered(
    discovery: Discovery,
    answer: FreeRunAnswer,
    effects: Sequence[AbstractEffect],
    lowpass: LowPass | None,
) -> Discovery:
    """The discovery with the model that the search came to, where that is an answer.

    It must lower the errors as much as what confirms an effect elsewhere (`confirm.py`): part of an
    effect that the library lacks can lower them a little, too. Where it lowers those of the
    held-out records less, but by more than chance, long runs alone count where short ones tell
    nothing of it; or the mean over these and the records of the fit. A product names no
    cause, and is chosen of many: the records of the fit must confirm it, if they can. Where no
    model says anything of the held-out records, their errors confirm none. Else it is the lead, and
    the declared model is refined unless that raises them by more than chance; where that leaves no
    more than noise, nothing is shown to be missing, and there is no lead.

    Args:
        discovery: the answer so far.
        answer: what the search came to.
        effects: that were tried in it.
        lowpass: F of the fits; None: chosen from the records.
    """
    base, best = answer.base, answer.best
    ratio = float(np.exp(best.error - base.error))
    confirms = ratio < RULES.answer.confirmed
    notes: list[str] = []
    if best.placed and not confirms:
        ratio_of_long = long_run_ratio(answer)
        confirms = ratio_of_long < RULES.answer.confirmed
        notes = [FitNote(_LONG_RUNS.format(ratio_of_long))]
    if best.placed and not confirms and shown_by_all(answer):
        confirms = True
        notes = [FitNote(_ALL.format(float(np.exp(best.error_of_all - base.error_of_all))))]
    if any(isinstance(at.effect, PRODUCTS) for at in best.placed):
        confirms = confirms and not contradicted_by_fit(answer)
    lost = lost_on_held_out(answer)
    # Else a product has been a rival of the answer, and has lost.
    without_product = not any(isinstance(effect, PRODUCTS) for effect in effects)
    imitates = without_product and _imitates(discovery, best)
    if best.placed and confirms and not lost and not imitates:
        names = labels_of(best.placed)
        excess = misses(best)
        code, text = ("partial", _PARTIAL) if excess else ("complete", _COMPLETE)
        size = () if excess else (error_over_noise(best),)
        status = Status(code, text.format(names, ratio, *size))
        outcome = replace(discovery, status=status, lead=None)
        outcome = _with_model(outcome, answer, best, lowpass)
        return replace(outcome, notes=(*outcome.notes, *notes))
    if discovery.added:
        return discovery
    lead = None
    if best.placed:
        fit = _fit_of(discovery, answer, best, lowpass)
        added = _added(discovery, answer, fit, best)
        lead = PartialExplanation(added, 1.0 - ratio**2, fit, *best.runs)
    excess = bool(misses(base)) or _tells_of_motion(lead, base)
    if answer.better_base or (lead is None and not excess and _is_noise(answer)):
        # What the injection said of the model as it was is said of no other one; where samples are
        # far apart it is an error of what lies between them.
        nothing = Status("nothing_missing", _NOTHING_MISSING.format(error_over_noise(base)))
        status = Status("unexplained", _NOT_EXPLAINED) if excess else nothing
        outcome = replace(discovery, status=status, lead=lead)
        discovery = _with_model(outcome, answer, base, lowpass)
        if lead is not None and not excess:
            # Of what is within the noise a part that confirms nothing shows nothing to be missing.
            lead, hint = None, FitNote(_WITHIN_NOISE.format(labels_of(best.placed), ratio))
            lost = [*lost, hint]
    return replace(discovery, lead=lead, notes=(*discovery.notes, *lost))


def _is_noise(answer: FreeRunAnswer) -> bool:
    """Whether the base misses records that judge, and move, by their noise in all runs."""
    if resting_outputs(answer.judging, answer.records):
        return False
    runs = [run for run in answer.base.runs if run is not None]
    return all(np.all(run.rmse <= _RULES.silent * sensor_noise(run)) for run in runs)


def _tells_of_motion(lead: PartialExplanation | None, base: Judged) -> bool:
    """Whether there is a lead beside a model that a constant is better than.

    What is read as the noise of such records may be motion.
    """
    return lead is not None and bool(np.any(base.short_runs.nrmse > _RULES.useless))


def _with_model(
    discovery: Discovery, answer: FreeRunAnswer, model: Judged, lowpass: LowPass | None
) -> Discovery:
    """The discovery with this model as its answer, on the records that predict best."""
    base, plant = answer.base, discovery.declared.nominal
    fit = _fit_of(discovery, answer, model, lowpass)
    added = _added(discovery, answer, fit, model)
    rivals = [rival.effect for item in added for rival in item.alternatives]
    names = tuple(dict.fromkeys(name for name in rivals if name not in names_of(model.placed)))
    notes = [*_lasting(discovery, answer, model.placed), _REFINED, *_portion_note(answer)]
    notes += _replaced(discovery, fit.plant, model.placed)
    return replace(
        discovery, effects=names_of(model.placed), added=added,
        ambiguous_with=names, advice=experiments(plant, added, names),
        explained=1.0 - float(np.exp(2.0 * (model.error - base.error))) if added else 0.0,
        before=base.runs[0], windows_before=base.runs[1],
        after=model.runs[0], windows_after=model.runs[1],
        found=fit, plant=fit.plant, held_out=answer.judging, base=base.refinement.plant,
        notes=(*notes, *on_bounds(plant, fit.plant), *uncertain_effects(added)),
    )  # fmt: skip


def _lasting(discovery: Discovery, answer: FreeRunAnswer, placed: Sequence[Placed]) -> list[str]:
    """Notes that hold for another fit as well, and how its records were made if that differs.

    What refused an effect in the injection does not hold where free runs came to that effect.
    """
    settled, judging = discovery.held_out[0], answer.judging[0]
    same_hold = settled.hold == judging.hold and np.array_equal(settled.skew, judging.skew)
    labels = labels_of(placed), *(item.effect.label for item in placed)
    withdrawn = tuple(f"refused: {label} " for label in labels if label)
    notes = [note for note in _not_on_fit(discovery) if not note.startswith(withdrawn)]
    if same_hold:
        return notes
    hold = _HOLD.format(hold_text(judging.hold, judging.input_names))
    return [*(note for note in notes if not isinstance(note, HoldNote)), HoldNote(hold)]


def _not_on_fit(discovery: Discovery) -> list[str]:
    """Notes that hold whatever the parameters are."""
    return [note for note in discovery.notes if not is_on_fit(note)]


def _portion_note(answer: FreeRunAnswer) -> list[str]:
    return [] if answer.share == 1.0 else [_PORTION.format(100.0 * answer.share)]


def _replaced(discovery: Discovery, plant: Plant, placed: Sequence[Placed]) -> list[str]:
    """A note on each declared parameter whose term an effect has replaced, and on fixed shapes."""
    names = replaced_terms(discovery.declared.nominal, plant)
    values, shapes = plant.parameters, fixed_shapes(plant, placed)
    return [
        *(FitNote(_REPLACED.format(name, labels_of(placed))) for name in names),
        *(FitNote(_FIXED.format(name, f"{values[name]:.4g}")) for name in shapes),
    ]


def _fit_of(
    discovery: Discovery, answer: FreeRunAnswer, model: Judged, lowpass: LowPass | None
) -> Identification:
    prepared = prepare_records(discovery.declared.nominal, answer.records, lowpass)
    return as_fit(prepared, model.refinement)


def _added(
    discovery: Discovery, answer: FreeRunAnswer, fit: Identification, model: Judged
) -> tuple[Added, ...]:
    """Effects of the model with their standings: from this search, else as they were added."""
    plant = discovery.declared.nominal
    sure = from_contests(plant, model, model.placed, answer.rounds)
    sure = {**_standings_of(discovery), **sure}
    return tuple(added_effect(plant, fit, placed, sure.get(placed)) for placed in model.placed)


def _standings_of(discovery: Discovery) -> dict[Placed, Standing]:
    """The standings of the effects of an answer."""
    items = {(item.effect, tuple(item.parameters)): item for item in discovery.added}
    pairs = ((placed, items[placed.effect, placed.names]) for placed in placed_effects(discovery))
    return {
        placed: Standing(item.probability, item.rivals)
        for placed, item in pairs
        if item.probability is not None
    }


def _imitates(discovery: Discovery, best: Judged) -> bool:
    """Whether a product of signals refuted an effect in the injection, and none is in the model."""
    refuted = {item.effect for item in discovery.ranking if item.reason == Reason.PRODUCT}
    names = set(names_of(best.placed))
    return bool(names & refuted) and Product.name not in names


_HOLD = "hold {}: of those that are possible the one with the smallest errors on held-out records"
_REFINED = FitNote(
    "the declared model was refined by the error of its free runs, and effects were searched in "
    "these; errors before are those of the refined declared model, parameters before those of the "
    "passes"
)
_AS_GOOD = (
    "{} would explain the injection, but without it the declared model, refined, predicts held-out "
    "records as well"
)
_HINT = (
    "more than noise is left in free runs on the held-out records: with {} beside the answer their "
    "errors would have {:.3g} of those of the refined answer; it names no cause, and is not added"
)
_FURTHER = (
    "{} found in free runs, beside what explains the injection: with it the errors on the held-out "
    "records have {:.3g} of those of the answer without it, refined"
)
_STOOD_IN = (
    "left out: {}, part of what explained the injection; refined in free runs, the model predicts "
    "the held-out records as well without it"
)
_BETTER = (
    "the answer was refined by the error of its free runs: on the held-out records they are "
    "smaller by more than chance"
)
_PORTION = (
    "effects were searched in {:.3g} % of the samples, to save time; all of them refined the model"
)
_REPLACED = (
    "{} is fixed at 0: with {} in place of its term the model predicts the held-out records better"
)
_FIXED = (
    "{} is fixed at {}: another value, with other values of the declared parameters, leaves every "
    "free run as it is"
)
_LONG_RUNS = (
    "in short runs the predictions with and without it hardly differ: long runs decide, whose "
    "errors beyond the noise have {:.3g} of those of the refined declared model or less, also on "
    "the records of the fit"
)
_ALL = (
    "the held-out records and those of the fit each show it by more than chance, and over both "
    "errors have {:.3g} of those of the refined declared model"
)
_NOT_EXPLAINED = (
    "refined, the declared model misses the held-out records by more than noise or chance in free "
    "runs, and none of the tested effects, of which disturbances in time are not tried in these, "
    "lowers these errors by a third"
)
_WITHIN_NOISE = (
    "with {} the errors on the held-out records would have {:.3g} of those of the refined declared "
    "model: that confirms no effect, and both are within the noise"
)
_NOTHING_MISSING = "refined, the declared model misses the held-out records by {} in free runs"
_PARTIAL = (
    "with {} free runs on the held-out records have {:.3g} of the error of the refined declared "
    "model (geometric mean of the errors of all outputs, in long runs and in windows); more than "
    "noise is left"
)
_COMPLETE = (
    "with {} free runs on the held-out records have {:.3g} of the error of the refined declared "
    "model (geometric mean of the errors of all outputs, in long runs and in windows), and miss by "
    "{}"
)
