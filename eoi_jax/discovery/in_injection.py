"""The answer that the injection gives: rounds of search and refit, then held-out free runs.

A round adds the set of effects that the residual of its model justifies (`round.py`); rounds end
where no further set is justified. The last set that held-out free runs do not refuse is the answer,
with simpler laws where these do as well.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.discovery.acceptance import (
    answered,
    denied,
    explained,
    judged,
    labels_of,
    names_of,
    remaining_power,
)
from eoi_jax.discovery.additions import added_effect, has_size, uncertain_effects
from eoi_jax.discovery.confirm import beyond_noise, confirmed, holds
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.hold_choice import Searched
from eoi_jax.discovery.judge import error_ratio
from eoi_jax.discovery.parsimony import Wider, with_simpler_laws
from eoi_jax.discovery.probability import Standing
from eoi_jax.discovery.ranking import ranking
from eoi_jax.discovery.refit import free_runs, not_simulated, on_bounds, refitted, runs_that_tell
from eoi_jax.discovery.remarks import FREE_RUN, NO_FREE_RUN, SIMPLER_LAW, FitNote, GridNote, Refusal
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation
from eoi_jax.discovery.rivals import advice, ambiguous, standings, unrivalled
from eoi_jax.discovery.round import RoundResult, read_friction, search_round
from eoi_jax.discovery.round_start import RoundStart
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.side_by_side import concurrently
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.holdout import resting_outputs
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.augmented import Placed, added_effects
from eoi_jax.models.effects import ParameterDependence
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import FreeRuns, whole_and_windows

_RULES = RULES.answer
STAGES = _RULES.rounds + 3

Progress = Callable[[str, int, int], None]


class Step(NamedTuple):
    """A model with the effects that rounds added, and the rounds up to it."""

    model: Plant
    placed: tuple[Placed, ...]
    rounds: tuple[RoundResult, ...]


def search_injection(
    task: Task, rare_effects: Sequence[AbstractEffect], progress: Progress
) -> Searched:
    """Rounds of search and refit, then the free runs.

    Rare effects would only make an answer ambiguous. They are tried if there is no answer without
    them, and accepted only in a set of few effects that explains nearly all. Of outputs that are
    functions of the states, of which free runs are not searched, they are tried where an answer
    leaves more than noise in free runs, too, and accepted where none is left with them.
    """
    # The search does not wait for the free runs before it.
    with concurrently(task.threads, lambda: free_runs(task, task.declared.plant)) as runs_before:
        start = RoundStart(task, task.declared.plant)
        if not start.base.output_power > 0.0:
            message = _NO_SAMPLE if len(start.base.target) else _NO_MODE
            reason = message.format(task.declared.lowpass.cutoff)
            no_data = replace(task.declared, status=Status("no_data", reason))
            return Searched(failed(no_data, task.held_out, task.records))
        steps, rounds = _searched(start, progress)
        task, steps, rounds = _with_forms(start, steps, rounds, progress)
        progress("fitting again, free runs", 1 + _RULES.rounds, STAGES)
        discovery = _answer(task, steps, rounds, runs_before())
    # Of outputs that are functions of the states, free runs are not searched where they contradict.
    misses_by_more = bool(beyond_noise(discovery.windows_after, plant=discovery.plant))
    denied_by_runs = task.plant.has_algebraic and misses_by_more
    quiet = discovery.status.code == "nothing_missing"
    is_open = discovery.status.code == "unexplained" or (quiet and denied_by_runs)
    if not is_open:
        rare_effects = _rare_beside(discovery, rare_effects)
    if rare_effects and placements(task.plant, rare_effects):
        for rare_discovery in _with_rare(start, rare_effects, progress, rounds[0], runs_before()):
            if _takes_place(rare_discovery, None if is_open else discovery, rare_effects):
                return Searched(_with_candidates_of(discovery, rare_discovery))
    if quiet or not is_open:
        return Searched(discovery)
    partial = tuple(step[:2] for step in reversed(steps) if not not_simulated(step.model))
    return Searched(discovery, partial, lambda answer: _lead(task, steps, rounds, answer))


def _rare_beside(
    discovery: Discovery, effects: Sequence[AbstractEffect]
) -> tuple[AbstractEffect, ...]:
    """Dependences of parameters that are tried beside an answer which leaves more than noise.

    Most of the residual may have another cause, and what is left be a coefficient that changes. Or
    an action of the signal stands in for it: where what that multiplies varies little it does the
    same. Of outputs that are functions of the states all are tried: no search in free runs follows.
    """
    runs = discovery.windows_after or discovery.after
    if discovery.in_sample or not discovery.added or not beyond_noise(runs, plant=discovery.plant):
        return ()
    if discovery.plant.has_algebraic:
        return tuple(effects)
    return tuple(effect for effect in effects if isinstance(effect, ParameterDependence))


def _takes_place(
    rare_discovery: Discovery, rival: Discovery | None, effects: Sequence[AbstractEffect]
) -> bool:
    """Whether an answer with rare effects is one, in the place of another answer if there is one.

    In its place held-out free runs must confirm it. How much of the injection it explains does not
    matter where these miss by no more than noise, of outputs that are functions of the states.
    """
    added = [item.effect for item in rare_discovery.added]
    named = any(isinstance(item, ParameterDependence) or item in effects for item in added)
    share, most = _RULES.rare_share, max(_RULES.rare_most, len(rare_discovery.plant.outputs))
    if rival is not None:
        share, most = max(share, rival.explained), max(most, len(rival.added) + 1)
        before, after = (answer.windows_after or answer.after for answer in (rival, rare_discovery))
        if before is None or after is None or error_ratio(after, before) >= _RULES.confirmed:
            return False
    explains = rare_discovery.explained >= share or _reaches_noise(rare_discovery)
    return named and len(added) <= most and explains


def _reaches_noise(discovery: Discovery) -> bool:
    """Whether effects take from held-out free runs all that is more than noise, and they have more.

    Of outputs that are functions of the states: else free runs are searched.
    """
    if discovery.in_sample or not discovery.plant.has_algebraic:
        return False
    declared_runs = discovery.windows_before or discovery.before
    runs = discovery.windows_after or discovery.after
    lacks = bool(beyond_noise(declared_runs, plant=discovery.declared.plant))
    return lacks and not beyond_noise(runs, plant=discovery.plant)


def _with_rare(
    start: RoundStart,
    rare_effects: Sequence[AbstractEffect],
    progress: Progress,
    earlier: RoundResult,
    prior: FreeRuns,
) -> Iterator[Discovery]:
    """Answers where rare effects are tried, too; first of them alone, if that leaves only noise.

    Beside others they share what they explain, and what leaves no more than noise needs no other.
    """
    task = start.task
    for library in [(), task.effects] if task.plant.has_algebraic else [task.effects]:
        rare_start = RoundStart(replace(task, effects=(*library, *rare_effects)), start.model)
        searched = _searched(rare_start, progress, earlier)
        answer = _answer(*_with_forms(rare_start, *searched, progress), prior)
        if library or _reaches_noise(answer):
            yield answer


def _with_candidates_of(earlier: Discovery, discovery: Discovery) -> Discovery:
    """A discovery with the evidence of an earlier one for what it did not try itself."""
    labels = {(row.label, row.output) for row in discovery.ranking}
    rows = [row for row in earlier.ranking if (row.label, row.output) not in labels]
    return replace(discovery, ranking=(*discovery.ranking, *rows))


def _with_forms(
    start: RoundStart, steps: list[Step], rounds: list[RoundResult], progress: Progress
) -> tuple[Task, list[Step], list[RoundResult]]:
    """The rounds of a search; searched again with all forms of the dependences that explain.

    Forms of one dependence differ less than most dependences do. Those that come near are rivals.
    """
    task, (best, *sets) = start.task, rounds[0].ranked.sets
    power, placed = start.base.signal_power, [*best.keys, *(steps[-1].placed if steps else ())]
    for fit in sets:
        if power(fit.residual) < RULES.search.forms * power(best.residual):
            placed += fit.keys
    explaining = {item.effect for item in placed}
    chosen = [effect.forms for effect in task.effects
              if isinstance(effect, ParameterDependence) and effect in explaining]  # fmt: skip
    forms = set(chain.from_iterable(chosen))
    if forms <= set(task.effects):
        return task, steps, rounds
    other = [effect for effect in task.effects if not isinstance(effect, ParameterDependence)]
    task = replace(task, effects=(*other, *chain.from_iterable(chosen)))
    return task, *_searched(RoundStart(task, start.model), progress, rounds[0])


def without_search(task: Task, progress: Progress) -> Discovery:
    """The declared model alone, whose injection is no evidence: the passes do not resolve it."""
    discovery = search_injection(replace(task, effects=()), (), progress).discovery
    if discovery.status.code == "no_data":
        return discovery
    return replace(discovery, status=Status("nothing_missing", _UNRESOLVED), lead=None)


def unresolved_models(
    task: Task, rare_effects: Sequence[AbstractEffect], progress: Progress
) -> tuple[tuple[Plant, tuple[Placed, ...]], ...]:
    """Models with sets that the injection would justify, if the passes resolved the declared model.

    They are no answers, but may be tried in free runs: along runs that go astray, a score test says
    nothing of what is missing.
    """
    searched = search_injection(task, rare_effects, progress)
    answer = searched.discovery
    placed = added_effects(answer.plant)[len(added_effects(task.plant)) :]
    return (*([(answer.plant, placed)] if placed else []), *searched.partial)


def judged_by_free_runs(discovery: Discovery) -> Discovery:
    """Whether free runs alone show something that no effect explains."""
    doubts = beyond_noise(discovery.windows_after, "", discovery.after, discovery.plant)
    if discovery.status.code != "nothing_missing" or not doubts:
        return discovery
    return replace(discovery, status=Status("unexplained", f"{_UNRESOLVED}, and {doubts[0]}"))


def _searched(
    start: RoundStart, progress: Progress, earlier: RoundResult | None = None
) -> tuple[list[Step], list[RoundResult]]:
    """Rounds of search and refit until no set is justified; a step is a round that added effects.

    The first round reuses the columns of an earlier round of the declared model.
    """
    rounds, steps = [], []
    for i in range(_RULES.rounds):
        progress(f"searching, round {i + 1}", 1 + i, STAGES)
        if not len(start.base.target):
            break
        lacking = rounds[0].ranked.scores.problem.lacking if rounds else start.lacking
        current = search_round(start, lacking, rounds[-1] if rounds else earlier)
        rounds.append(current)
        if not current.chosen.atoms:
            break
        added = read_friction(start.model, current.bounded_fit)
        start = RoundStart(start.task, current.augmented(added), (*start.placed, *added))
        steps.append(Step(start.model, start.placed, tuple(rounds)))
        if current.exhausted:
            break
    return steps, rounds


# -- the answer -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Chosen:
    """What the rounds of the search come to, held-out free runs included.

    Attributes:
        placed: effects of the answer; none where it has none.
        fit: with them; that of the declared model without any.
        prior: free runs of the declared model. runs: of the fit, of the same lengths.
        status: of the answer. share: of the residual's power above the noise that they explain.
        remainder: power of the residual that is left beyond the noise.
        wider: laws that gave way to simpler ones. refused: why other effects are not in it.
        notes: on what was refused and on the fit.
        denied: a set that only the held-out records refuse.
    """

    placed: tuple[Placed, ...]
    fit: Identification
    prior: FreeRuns
    runs: FreeRuns
    status: Status
    share: float
    remainder: float
    wider: Wider
    refused: dict[Placed, Refusal]
    notes: tuple[str, ...]
    denied: tuple[Placed, ...]


def _chosen(
    task: Task, steps: Sequence[Step], rounds: Sequence[RoundResult], prior: FreeRuns
) -> _Chosen:
    """The last step of the search that free runs on held-out records do not refuse."""
    first, notes, refused = rounds[0], [], dict(rounds[0].decision.refused)
    degrees = task.plant.degrees
    share, residual_ratio, quiet = explained(rounds)
    tried, placed = bool(first.candidates or task.held_out), steps[-1].placed if steps else ()
    status, denied_set = judged(placed, share, residual_ratio, quiet, degrees, tried=tried), ()
    if status.code == "unexplained" and (denial := denied(first)) is not None:
        denied_set, status = denial
    unrivalled_effect = bool(task.held_out) and unrivalled(first)
    for model, placed, step_rounds in reversed(steps):
        share, residual_ratio, quiet = explained(
            rounds if placed is steps[-1].placed else step_rounds
        )
        verdict = judged(placed, share, residual_ratio, quiet, degrees, unrivalled_effect)
        if verdict.code != "complete":
            break
        refusal = not_simulated(model)
        if refusal:
            notes.append(_UNCHECKED.format(labels_of(placed), share, refusal))
            refused |= dict.fromkeys(placed, NO_FREE_RUN)
            status = Status("unexplained", _NOT_SIMULATED)
            continue
        refit, refit_notes = refitted(task, model)
        notes += refit_notes
        if not refit.status.ok:
            notes.append(FitNote(_REFIT_STATUS.format(refit.status)))
        runs = free_runs(task, refit.plant)
        plain, fit, plain_runs, wider = with_simpler_laws(task, placed, refit, runs)
        if unsized := [item for item in plain if not has_size(item, fit)]:
            notes.append(_UNSIZED.format(labels_of(placed), share, labels_of(unsized)))
            status = Status("unexplained", _NO_SIZE)
            continue
        strict = judged(placed, share, residual_ratio, quiet, degrees)
        if strict != verdict and not confirmed(prior, runs):
            break
        if holds(prior, runs):
            runs = plain_runs
            refused |= dict.fromkeys(wider, SIMPLER_LAW)
            if plain != placed:
                notes.append(_WIDER_LAW.format(labels_of(placed), share))
                share, verdict = _share_of_simpler(task, plain, fit, rounds)
            remainder = remaining_power(rounds, share, quiet)
            prior, runs = runs_that_tell(task, fit.plant, prior, runs)
            return _Chosen(plain, fit, prior, runs, verdict, share, remainder, wider, refused,
                           tuple(notes), ())  # fmt: skip
        notes.append(_REFUSED.format(labels_of(placed)))
        refused |= dict.fromkeys(placed, FREE_RUN)
        status = Status("unexplained", _FREE_RUN_WORSE)
    return _Chosen(
        (), task.declared, prior, prior, status, 0.0, 0.0, {}, refused, tuple(notes), denied_set
    )  # fmt: skip


def _answer(
    task: Task, steps: Sequence[Step], rounds: Sequence[RoundResult], prior: FreeRuns
) -> Discovery:
    """The discovery from the rounds of the search; the last steps may be refused."""
    chosen = _chosen(task, steps, rounds, prior)
    placed, fit = chosen.placed, chosen.fit
    added = _added(task, fit, standings(rounds, placed, chosen.wider, chosen.remainder))
    rivals = ambiguous(rounds[0].ranked, rounds[0].chosen, names_of(placed)) if placed else ()
    notes = *_notes(task), *chosen.notes, *_bound_and_grid_notes(fit, placed, rounds)
    unexplained = chosen.status.code == "unexplained"
    return Discovery(
        effects=names_of(placed),
        added=added,
        ranking=ranking(task.plant, rounds, placed, chosen.refused),
        ambiguous_with=rivals,
        advice=advice(rounds[0], rivals),
        explained=chosen.share,
        before=chosen.prior[0],
        after=chosen.runs[0],
        windows_before=chosen.prior[1],
        windows_after=chosen.runs[1],
        declared=task.declared,
        found=fit,
        plant=fit.plant,
        status=chosen.status,
        notes=(*notes, *uncertain_effects(added)),
        in_sample=not task.held_out,
        held_out=task.held_out or task.records,
        denied=names_of(chosen.denied),
        # An unexplained residual is examined with the tests that need no hypothesis.
        diagnosis=diagnose(task.declared, task.records) if unexplained else None,
    )


def _added(
    task: Task, fit: Identification, effects: Mapping[Placed, Standing | None]
) -> tuple[Added, ...]:
    return tuple(added_effect(task.plant, fit, *effect) for effect in effects.items())


def _lead(
    task: Task, steps: Sequence[Step], rounds: Sequence[RoundResult], answer: Discovery
) -> PartialExplanation | None:
    """The last set that improves the free runs, though it explains too little to be an answer.

    It is compared with the free runs of the answer before any effect: the declared model may have
    been refined. The records tell the size of each of its effects.
    """
    if answer.before is None:
        return None
    short = answer.windows_before
    lengths = None if short is None else short.window, answer.before.window
    for model, placed, step_rounds in reversed(steps):
        if not_simulated(model):
            continue
        refit, _ = refitted(task, model)
        if not (refit.status.ok and all(has_size(item, refit) for item in placed)):
            continue
        runs = whole_and_windows(refit.plant, answer.held_out, *lengths)
        if holds((answer.before, short), runs):
            share, _, _ = explained(rounds if placed is steps[-1].placed else step_rounds)
            added = _added(task, refit, dict.fromkeys(placed))
            return PartialExplanation(added, share, refit, *runs)
    return None


def _share_of_simpler(
    task: Task,
    placed: tuple[Placed, ...],
    simple_fit: Identification,
    rounds: Sequence[RoundResult],
) -> tuple[float, Status]:
    """Share of the residual that a simpler set explains, and the status of that answer."""
    share, relative_residual, _ = explained(rounds, RoundStart(task, simple_fit.plant, placed))
    return share, answered(share, relative_residual, task.plant.degrees)


_NO_SAMPLE = (
    "no sample of the records counts: motion is hidden in noise at the cut-off {:.4g} rad/s, or "
    "the plant rests all the time. Give a `lowpass` with a lower cut-off, or records with more "
    "motion"
)
_NO_MODE = (
    "the records are too short for the cut-off {:.4g} rad/s: no frequency that they tell apart "
    "lies below it. Give a `lowpass` with a higher cut-off, or longer records"
)
_UNRESOLVED = (
    "the plant has a mode faster than the sampling, of which the injection is no evidence; judged "
    "by free runs of the refined model"
)
_FREE_RUN_WORSE = "the effects that fit the records make the free run on other data worse"
_REFIT_STATUS = "the refit of the augmented model ended as {}"
_AT_GRID_END = "{} is at the end of what was searched, {:.4g}: {} ones may do as well or better"
_WIDER_LAW = "{} would take {:.1%} of the residual's power, and do no better in free runs"
_NOT_SIMULATED = "the effects that fit the records cannot be confirmed: no free run has them"
_NO_SIZE = "the records do not tell the size of the effects that fit them"
_UNSIZED = (
    "refused: {} would take {:.1%} of the residual's power, but the records do not tell the size "
    "of {}"
)
_UNCHECKED = "refused: {} would take {:.1%} of the residual's power, but there is no free run: {}"
_REFUSED = "refused: {} would make free runs on the records of `validation` worse or diverge"


def _notes(task: Task) -> list[str]:
    notes = resting_outputs(task.held_out, task.records)
    if not task.held_out:
        notes.append(
            "no held-out record: errors are in-sample, and no effect was refused for being worse "
            "on other data. Give `validation`: records, or a share of these such as 0.3 (in a "
            "config a table `[validation]`)"
        )
    return notes


def _bound_and_grid_notes(
    fit: Identification, placed_effects: Sequence[Placed], rounds: Sequence[RoundResult]
) -> list[str]:
    """A note for each declared parameter on a bound, and each shape at an end of its grid."""
    spans = {
        placed: span for step in rounds for placed, span in step.ranked.scores.problem.spans.items()
    }
    notes = on_bounds(rounds[0].start.task.plant, fit.plant)
    for placed in placed_effects:
        if placed not in spans:
            continue
        names = placed.names[len(placed.effect.gains) :]
        for name, low, high in zip(names, spans[placed].low, spans[placed].high, strict=True):
            value = fit.parameters[name]
            side = beyond_grid(value, fit.standard_errors[name], float(low), float(high))
            notes += [GridNote(_AT_GRID_END.format(name, value, side))] if side else []
    return notes


def beyond_grid(value: float, error: float, low: float, high: float) -> str:
    """Whether ``"smaller"`` or ``"larger"`` shapes than were searched may do as well; or ``""``.

    The fit is not held to the grid: one that tells the shape from the end, by two standard errors,
    has found its best value.

    Args:
        value: of the shape.
        error: its standard error; infinite or NaN where there is none.
        low: the smaller end of the grid.
        high: the larger one.
    """
    close = min(_RULES.end * (high - low), 2.0 * error)
    if value <= low + close:
        return "smaller"
    return "larger" if value >= high - close else ""


def failed(
    declared: Identification, held_out: tuple[Record, ...], records: tuple[Record, ...]
) -> Discovery:
    """The discovery if the declared model could not be fitted: its status is the answer."""
    nothing = (None, None)
    return Discovery(
        (), (), (), (), "", 0.0, *nothing, *nothing, declared, declared, declared.plant,
        declared.status, (), not held_out, held_out or records,
    )  # fmt: skip
