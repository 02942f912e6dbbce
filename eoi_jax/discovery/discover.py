r"""Find the effects that a model lacks from its residual, and add them.

1. `identify` the declared model; the remaining injection is the residual.
2. Every effect of the library, at every point of its shape grid, becomes columns of a regression
   on the modes of y^(r) - f (`cosine_modes`, `candidates`).
3. `search` finds the set of effects that the residual justifies, all declared parameters free.
4. An effect that increases the held-out error is refused, and so is a set whose residual contains a
   product of signals: the missing effect is then not in the library (`round`).
5. The set is added (`augmented`) and all parameters are fitted again; the search is repeated from
   that model until no further set is justified.
6. Free runs on held-out records, before and after; at the end on test records (`unseen_records`).
7. Where that gives no answer, the declared model is refined and effects are searched in its free
   runs (`free_run_search`); an answer that leaves more than noise there is questioned, refined and
   extended (`in_free_runs`), and curves are tried (`curves`).
8. On request, refinement by output error, with effects that only the free runs show (`refined`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from eoi_jax._blas import one_thread
from eoi_jax._checks import check, check_count, real
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
from eoi_jax.discovery.additions import added_effect, has_size, sensor_notes, uncertain_effects
from eoi_jax.discovery.confirm import beyond_noise, confirmed, holds
from eoi_jax.discovery.curves import misses_a_law, with_curves
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.hold_choice import Searched, with_best_hold, with_held_inputs
from eoi_jax.discovery.in_free_runs import (
    leaves_more,
    leaves_open,
    misses_widely,
    unless_refined_is_better,
    with_free_runs,
    with_further_effects,
)
from eoi_jax.discovery.parsimony import Wider, with_simpler_laws
from eoi_jax.discovery.probability import Standing
from eoi_jax.discovery.ranking import ranking
from eoi_jax.discovery.refined import refined_answer
from eoi_jax.discovery.refit import free_runs, not_simulated, on_bounds, refitted, runs_that_tell
from eoi_jax.discovery.remainder import (
    partial_where_more_is_left,
    with_differences,
    with_doubts,
)
from eoi_jax.discovery.remarks import (
    FREE_RUN,
    NO_FREE_RUN,
    SIMPLER_LAW,
    FitNote,
    GridNote,
    Refusal,
)
from eoi_jax.discovery.requested import names_with_place, notes_without_place, requested
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation
from eoi_jax.discovery.rivals import advice, ambiguous, standings, unrivalled
from eoi_jax.discovery.round import Round, Task, read_friction
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.side_by_side import concurrently
from eoi_jax.discovery.unseen_records import with_test_errors
from eoi_jax.estimation.common_factors import without_common_factors
from eoi_jax.estimation.defaults import short_record_notes, too_short
from eoi_jax.estimation.hold import hold_indices
from eoi_jax.estimation.holdout import check_runs, held_out_records, resting_outputs
from eoi_jax.estimation.identify import Identification, declared_index, estimate
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import PreparedRecords, prepare_records
from eoi_jax.models.augmented import Placed
from eoi_jax.models.check_records import check_records
from eoi_jax.models.effects import couplings, input_products, rare, wider
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import FreeRuns

_RULES = RULES.answer
_STAGES = _RULES.rounds + 3

Step = tuple[
    Plant, tuple[Placed, ...], tuple[Round, ...]
]  # a model, its effects, the rounds up to it
Progress = Callable[[str, int, int], None]


@one_thread()
def discover(
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | float | None = None,
    effects: str | Sequence[AbstractEffect | str] | None = None,
    *,
    lowpass: LowPass | None = None,
    alpha: float = 0.01,
    most: int = 3,
    window: float | None = None,
    refine: bool = False,
    test: Record | Sequence[Record] | None = None,
    callback: Progress | None = None,
) -> Discovery:
    """Find what a model lacks, and add it.

    Args:
        plant: the declared model, with nominal parameters.
        records: to fit and to search; all of them together.
        validation: records that the fit does not see, for the errors before and after; or the
            share of each record that is held out at its end. Without them the errors are those on
            `records`, and the answer says so.
        effects: to try, as names or objects; by default all of `eoi_jax.effects.standard()`, and
            where these leave the residual unexplained `eoi_jax.effects.rare()` and, with several
            outputs, `eoi_jax.effects.couplings(plant)` beside them.
        lowpass: F of the fits; chosen from the records if left out.
        alpha: level of false alarms: the chance that a model which lacks nothing gets an effect.
        most: effects that one round of the search may add at most.
        window: length of re-initialised free runs [s]; by default a tenth of a record.
        refine: whether the answer is then refined by output error (`refine`), and what only its
            free run shows is added (`remaining`): what the injection hardly sees may be most of
            that error. Additions, and a fit to short runs in place of whole records, are kept
            where all free runs on held-out data get better by more than a hundredth, a mere
            refinement where none gets worse by one. Takes longer.
        test: records that nothing chooses on, for errors that may be published: `validation`
            decides which effects stay, so that its errors are a little too good.
        callback: called at each stage with what is done now, how many stages are over, and how
            many there are at most.

    Returns:
        The effects, the augmented plant, evidence for every candidate, errors before and after.

    Raises:
        ValueError: arguments or records that do not fit; the message says which and what to do.

    Source:
        Equations (1)-(14) of the paper for the residual; the search over effects, its score and its
        tests are our own and stand in `search.py`, `cosine_modes.py` and `noise_spectrum.py`.
    """
    fit_records = check_records(plant, records)
    if isinstance(validation, float | int):
        check(0.0 < validation < 1.0, "validation", "must lie in (0, 1) as a share", validation)
        parts = [record.split(1.0 - validation) for record in fit_records]
        fit_records, validation = (
            tuple(record for record, _ in parts),
            [record for _, record in parts],
        )
    held_out = held_out_records(plant, fit_records, validation)
    tried_effects = requested(plant, [effects] if isinstance(effects, str) else effects)
    rare_effects = (*rare(), *couplings(plant)) if effects is None else ()
    fitting = names_with_place(plant, tried_effects)
    check(0.0 < real(alpha) < 1.0, "alpha", "must lie in (0, 1)", alpha, "0.01 is a common choice.")
    most = check_count("most", most)
    runs = check_runs(plant, fit_records, held_out, window)
    unseen = held_out_records(plant, (*fit_records, *held_out), test, "test")
    progress = callback or _no_progress
    progress("fitting the declared model", 0, _STAGES)
    search = _Search(
        plant, lowpass, tried_effects, rare_effects, alpha, most, window, refine,
        effects is not None, progress,
    )  # fmt: skip
    indices = hold_indices(plant, fit_records, declared_index, lowpass)
    if indices is None:
        searched = search.on(fit_records, held_out)
    else:
        search = replace(search, lowpass=indices.lowpass)
        searched = with_best_hold(search.on, fit_records, held_out, indices)
    discovery = search.in_free_runs(searched, fit_records, held_out)
    discovery = with_held_inputs(discovery, search.answered, fit_records, held_out)
    discovery = with_differences(partial_where_more_is_left(discovery), fit_records)
    unplaced_notes = (
        [] if effects is None else notes_without_place(tried_effects, fitting, discovery)
    )
    notes = *sensor_notes(plant, discovery.added), *unplaced_notes, *runs
    discovery = replace(discovery, notes=(*discovery.notes, *notes))
    return with_test_errors(discovery, unseen, fit_records, window) if unseen else discovery


@dataclass(frozen=True)
class _Search:
    """What `discover` is asked, without the records.

    Attributes:
        plant: the declared model, with nominal parameters.
        lowpass: F; None: chosen from the records.
        effects: that are tried. rare: that are tried where these leave the residual unexplained.
        alpha, most, window, refine: arguments of `discover`.
        named: whether the caller named the effects.
        progress: callback.
    """

    plant: Plant
    lowpass: LowPass | None
    effects: tuple[AbstractEffect, ...]
    rare: tuple[AbstractEffect, ...]
    alpha: float
    most: int
    window: float | None
    refine: bool
    named: bool
    progress: Progress

    def answered(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Discovery:
        """What the injection and free runs say of these records, whose hold is as it is."""
        return self.in_free_runs(self.on(records, held_out), records, held_out)

    def in_free_runs(
        self, searched: Searched, records: tuple[Record, ...], held_out: tuple[Record, ...]
    ) -> Discovery:
        """The answer, with what free runs show where the injection leaves it open, or in part.

        Args:
            searched: what a search in the injection came to.
            records: to fit, as given.
            held_out: that judge, as given.
        """
        discovery, start = searched.discovery, min(float(record.time[0]) for record in records)
        of_plant = input_products(self.plant) + couplings(self.plant)
        further = () if self.named else (*wider(), *of_plant)
        effects = [effect.since(start) for effect in (*self.effects, *further)]
        if leaves_more(discovery):
            discovery = unless_refined_is_better(discovery, records)
        is_open = leaves_open(discovery)
        if is_open or misses_widely(discovery):
            self.progress("searching in free runs", 2 + _RULES.rounds, _STAGES)
            discovery = with_free_runs(
                discovery, records, held_out, effects, searched.partial, self.lowpass, self.alpha
            )
        discovery = self._with_curves(replace(searched, discovery=discovery).with_lead, records)
        if not is_open and leaves_more(discovery):
            self.progress("searching in free runs", 2 + _RULES.rounds, _STAGES)
            named, settings = discovery, (effects, self.lowpass, self.alpha)
            discovery = with_further_effects(named, records, held_out, *settings)
            if len(discovery.added) > len(named.added):
                discovery = self._with_curves(discovery, records)
        return discovery

    def _with_curves(self, discovery: Discovery, records: tuple[Record, ...]) -> Discovery:
        """The answer, with curves where these predict far better, or as well as many laws."""
        if self.named or not misses_a_law(discovery):
            return discovery
        self.progress("fitting curves in free runs", 2 + _RULES.rounds, _STAGES)
        return with_curves(discovery, records, self.lowpass)

    def on(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Searched:
        """What is found on these records.

        Args:
            records: to fit and to search.
            held_out: that judge.
        """
        self.progress("fitting the declared model", 0, _STAGES)
        prepared, records, short_notes = _informative_records(self.plant, records, self.lowpass)
        start = min(float(record.time[0]) for record in records)
        effects, rare_effects = (
            tuple(effect.since(start) for effect in group if not effect.only_in_free_runs)
            for group in (self.effects, self.rare)
        )
        declared = estimate(self.plant, prepared, passes=_RULES.passes)
        if declared.status.code in ("no_data", "diverged"):
            return Searched(_failed(declared, held_out, records))
        determined = without_common_factors(self.plant, declared.common_factors)
        if determined is not self.plant:
            searched = replace(self, plant=determined).on(records, held_out)
            factors = declared.common_factors
            discovery = replace(searched.discovery, common_factors=factors)
            return replace(searched, discovery=discovery)
        task = Task(
            self.plant, prepared, records, held_out, effects, declared, self.alpha, self.most,
            self.window,
        )  # fmt: skip
        resolved = declared.status.code != "undersampled"
        if resolved:
            searched = _run(task, rare_effects, self.progress)
        else:
            searched = Searched(_without_search(task, self.progress))
        discovery = searched.discovery
        answered_so_far = discovery.status.code in ("complete", "nothing_missing")
        if answered_so_far and (self.refine or not resolved):
            self.progress("refining, and what free runs lack", 2 + _RULES.rounds, _STAGES)
            discovery = refined_answer(task, discovery, effects if self.named else None)
        if not resolved:
            discovery = _judged_by_free_runs(task, discovery)
        discovery = with_doubts(discovery, records, self.refine)
        discovery = replace(discovery, notes=(*short_notes, *discovery.notes))
        return replace(searched, discovery=discovery)


def _informative_records(
    plant: Plant, records: tuple[Record, ...], lowpass: LowPass | None
) -> tuple[PreparedRecords, tuple[Record, ...], list[str]]:
    """Prepared records, without those too short to be informative beside the others."""
    prepared = prepare_records(plant, records, lowpass)
    cutoff = prepared.lowpass.cutoff
    notes = short_record_notes(records, cutoff, "left out")
    if notes:
        pairs = zip(records, too_short(records, cutoff), strict=True)
        records = tuple(record for record, short in pairs if not short)
        prepared = prepare_records(plant, records, lowpass)
    return prepared, records, notes


def _no_progress(stage: str, done: int, stages: int) -> None:
    del stage, done, stages


def _run(task: Task, rare_effects: Sequence[AbstractEffect], progress: Progress) -> Searched:
    """Rounds of search and refit, then the free runs.

    Rare effects would only make an answer ambiguous. They are tried if there is no answer without
    them, and accepted only in a set of few effects that explains nearly all.
    """
    # The search does not wait for the free runs before it.
    with concurrently(task.threads, lambda: free_runs(task, task.declared.plant)) as runs_before:
        steps, rounds = _searched(task, progress)
        if not rounds[0].base.output_power > 0.0:
            message = _NO_SAMPLE if len(rounds[0].base.target) else _NO_MODE
            reason = message.format(task.declared.lowpass.cutoff)
            no_data = replace(task.declared, status=Status("no_data", reason))
            return Searched(_failed(no_data, task.held_out, task.records))
        progress("fitting again, free runs", 1 + _RULES.rounds, _STAGES)
        discovery = _answer(task, steps, rounds, runs_before())
    # Of outputs that are functions of the states, free runs are not searched where they contradict.
    runs, judging = discovery.windows_after, task.held_out or task.records
    denied_by_runs = task.plant.has_algebraic and bool(beyond_noise(runs, judging))
    quiet = discovery.status.code == "nothing_missing"
    if discovery.status.code != "unexplained" and not (quiet and denied_by_runs):
        return Searched(discovery)
    if placements(task.plant, rare_effects):
        wider = replace(task, effects=(*task.effects, *rare_effects))
        rare_discovery = _answer(wider, *_searched(wider, progress, rounds[0]), runs_before())
        effects = [added.effect for added in rare_discovery.added]
        named = any(effect in rare_effects for effect in effects)
        few = len(effects) <= max(_RULES.rare_most, len(task.plant.outputs))
        if named and few and rare_discovery.explained >= _RULES.rare_share:
            return Searched(rare_discovery)
    if quiet:
        return Searched(discovery)
    partial = tuple(step[:2] for step in reversed(steps) if not not_simulated(step[0]))
    return Searched(discovery, partial, lambda: _lead(task, steps, rounds, runs_before()))


def _without_search(task: Task, progress: Progress) -> Discovery:
    """The declared model alone, whose injection is no evidence: the passes do not resolve it."""
    discovery = _run(replace(task, effects=()), (), progress).discovery
    if discovery.status.code == "no_data":
        return discovery
    return replace(discovery, status=Status("nothing_missing", _UNRESOLVED), lead=None)


def _judged_by_free_runs(task: Task, discovery: Discovery) -> Discovery:
    """Whether free runs alone show something that no effect explains."""
    doubts = beyond_noise(discovery.windows_after, task.held_out or task.records)
    if discovery.status.code != "nothing_missing" or not doubts:
        return discovery
    return replace(discovery, status=Status("unexplained", f"{_UNRESOLVED}, and {doubts[0]}"))


def _searched(
    task: Task, progress: Progress, earlier: Round | None = None
) -> tuple[list[Step], list[Round]]:
    """Rounds of search and refit until no set is justified; a step is a round that added effects.

    The first round reuses the columns of an earlier round of the declared model.
    """
    model, placed, rounds, steps = task.declared.plant, [], [], []
    for i in range(_RULES.rounds):
        progress(f"searching, round {i + 1}", 1 + i, _STAGES)
        current = Round(task, model, placed, rounds[-1] if rounds else earlier)
        if not len(current.base.target):
            return [], [current]
        current.search(rounds[0].candidate_search.lacking if rounds else current.lacking)
        rounds.append(current)
        if not current.chosen.atoms:
            break
        added = read_friction(model, current.bounded_fit)
        placed += list(added)
        model = current.augmented(added)
        steps.append((model, tuple(placed), tuple(rounds)))
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


def _chosen(task: Task, steps: Sequence[Step], rounds: Sequence[Round], prior: FreeRuns) -> _Chosen:
    """The last step of the search that free runs on held-out records do not refuse."""
    first, notes, refused = rounds[0], [], dict(rounds[0].refused)
    share, residual_ratio, quiet = explained(rounds)
    status, denied_set = judged(steps[-1][1] if steps else (), share, residual_ratio, quiet), ()
    if status.code == "unexplained" and (denial := denied(first)) is not None:
        denied_set, status = denial
    unrivalled_effect = bool(task.held_out) and unrivalled(first)
    for model, placed, step_rounds in reversed(steps):
        share, residual_ratio, quiet = explained(rounds if placed is steps[-1][1] else step_rounds)
        verdict = judged(placed, share, residual_ratio, quiet, unrivalled_effect)
        if verdict.code != "complete":
            break
        refusal = not_simulated(model)
        if refusal:
            notes.append(_UNCHECKED.format(labels_of(placed), share, refusal))
            refused |= dict.fromkeys(placed, NO_FREE_RUN)
            status = Status("unexplained", _NOT_SIMULATED)
            continue
        refit = refitted(task, model, notes)
        if not refit.status.ok:
            notes.append(FitNote(_REFIT_STATUS.format(refit.status)))
        runs = free_runs(task, refit.plant)
        plain, fit, plain_runs, wider = with_simpler_laws(task, placed, refit, runs)
        if unsized := [item for item in plain if not has_size(item, fit)]:
            notes.append(_UNSIZED.format(labels_of(placed), share, labels_of(unsized)))
            status = Status("unexplained", _NO_SIZE)
            continue
        if judged(placed, share, residual_ratio, quiet) != verdict and not confirmed(prior, runs):
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
    task: Task, steps: Sequence[Step], rounds: Sequence[Round], prior: FreeRuns
) -> Discovery:
    """The discovery from the rounds of the search; the last steps may be refused."""
    chosen = _chosen(task, steps, rounds, prior)
    placed, fit = chosen.placed, chosen.fit
    added = _added(task, fit, standings(rounds, placed, chosen.wider, chosen.remainder))
    rivals = ambiguous(rounds[0], names_of(placed)) if placed else ()
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
    task: Task, steps: Sequence[Step], rounds: Sequence[Round], prior: FreeRuns
) -> PartialExplanation | None:
    """The last set that improves the free runs, though it explains too little to be an answer."""
    for model, placed, step_rounds in reversed(steps):
        if not_simulated(model):
            continue
        refit = refitted(task, model, [])
        runs = free_runs(task, refit.plant)
        if refit.status.ok and holds(prior, runs):
            share, _, _ = explained(rounds if placed is steps[-1][1] else step_rounds)
            added = _added(task, refit, dict.fromkeys(placed))
            return PartialExplanation(added, share, refit, *runs)
    return None


def _share_of_simpler(
    task: Task, placed: tuple[Placed, ...], simple_fit: Identification, rounds: Sequence[Round]
) -> tuple[float, Status]:
    """Share of the residual that a simpler set explains, and the status of that answer."""
    share, relative_residual, _ = explained(
        rounds, Round(task, simple_fit.plant, placed, rounds[-1])
    )
    return share, answered(share, relative_residual)


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
    "refused: {} takes {:.1%} of the residual's power, but the records do not tell the size of {}"
)
_UNCHECKED = "refused: {} takes {:.1%} of the residual's power, but has no free run: {}"
_REFUSED = "refused: {} makes the free run worse or diverge on the records of `validation`"


def _notes(task: Task) -> list[str]:
    notes = resting_outputs(task.held_out, task.records)
    if not task.held_out:
        notes.append(
            "no held-out record: errors are in-sample, and no effect was refused for being worse "
            "on other data. Give `validation`: records, or a share of these such as 0.3"
        )
    return notes


def _bound_and_grid_notes(
    fit: Identification, placed_effects: Sequence[Placed], rounds: Sequence[Round]
) -> list[str]:
    """A note for each declared parameter on a bound, and each shape at an end of its grid."""
    spans = {
        placed: span for step in rounds for placed, span in step.candidate_search.spans.items()
    }
    notes = on_bounds(rounds[0].task.plant, fit.plant)
    for placed in placed_effects:
        if placed not in spans:
            continue
        names = placed.names[len(placed.effect.gains) :]
        for name, low, high in zip(names, spans[placed].low, spans[placed].high, strict=True):
            value, close = fit.parameters[name], _RULES.end * (high - low)
            if value <= low + close:
                notes.append(GridNote(_AT_GRID_END.format(name, value, "smaller")))
            if value >= high - close:
                notes.append(GridNote(_AT_GRID_END.format(name, value, "larger")))
    return notes


def _failed(
    declared: Identification, held_out: tuple[Record, ...], records: tuple[Record, ...]
) -> Discovery:
    """The discovery if the declared model could not be fitted: its status is the answer."""
    nothing = (None, None)
    return Discovery(
        (), (), (), (), "", 0.0, *nothing, *nothing, declared, declared, declared.plant,
        declared.status, (), not held_out, held_out or records,
    )  # fmt: skip
