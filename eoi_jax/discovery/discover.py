r"""Close the loop: find the residual, trace it to an effect that the model lacks, add it.

1. `identify` the declared model; what is left of the injection is what it lacks.
2. Every effect of the library, at every point of its shape grid, becomes columns of a regression
   on the modes of y^(r) - f (`modes`, `candidates`).
3. `search` finds the set of effects that the residual justifies, all declared parameters free.
4. An effect that makes the held-out error worse is refused, and a set that leaves a product of
   signals behind: what is hidden is then no effect of the library (`rounds`).
5. The set is added (`augment`), and everything is fitted again by the estimator; then the search
   starts once more from there, until nothing is justified.
6. Free runs on records that the fit did not see, before and after.
7. Where it is asked for, output error, and what only the free runs show (`polish`).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from eoi_jax._blas import one_thread
from eoi_jax._checks import check, check_choice, check_count, check_kind, real
from eoi_jax._status import Status
from eoi_jax.data.record import Record
from eoi_jax.discovery.acceptance import answered, explained, judged, names_of, unless_denied
from eoi_jax.discovery.confirm import as_good, beyond_noise, confirmed, holds
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.parsimony import simpler
from eoi_jax.discovery.ranking import ends, ranking
from eoi_jax.discovery.refined import polished
from eoi_jax.discovery.refit import (
    SEARCHED,
    free_runs,
    not_simulated,
    on_bounds,
    refitted,
    window_of,
)
from eoi_jax.discovery.result import Added, Discovery, PartialExplanation
from eoi_jax.discovery.rivals import advice, ambiguous, unrivalled
from eoi_jax.discovery.round import Round, Task, read_friction
from eoi_jax.discovery.side_by_side import concurrently
from eoi_jax.estimation.covariance import Certainty
from eoi_jax.estimation.defaults import short_record_notes, too_short
from eoi_jax.estimation.holdout import check_runs, held_out_records, resting_outputs
from eoi_jax.estimation.identify import Identification, estimate
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import PreparedRecords, prepare_records
from eoi_jax.models.augmented import Placed
from eoi_jax.models.check_records import check_records
from eoi_jax.models.effects import rare, standard
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.placements import placements
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import FreeRuns

_PASSES = 30  # of the declared model at most: what it lacks is looked for where it has converged
_ROUNDS = 3
_STAGES = _ROUNDS + 3
_WHOLLY, _RARE = 0.95, 2  # likewise where an effect is rare, and how many there may be then
_END = 1e-3  # of a range of shapes: as near as this to its end

Step = tuple[Plant, tuple[Placed, ...], tuple[Round, ...]]  # a model, what is in it, how it came
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
            where these leave the residual unexplained `eoi_jax.effects.rare()` beside them.
        lowpass: F of the fits; chosen from the records if left out.
        alpha: level of false alarms: the chance that a model which lacks nothing gets an effect.
        most: effects that one round of the search may add at most.
        window: length of re-initialised free runs [s]; by default a tenth of a record.
        refine: whether the answer is then refined by output error (`refine`), and what only its
            free run shows is added (`remaining`): what the injection hardly sees may be most of
            that error. Additions, and a fit to short runs in place of whole records, are kept
            where all free runs on held-out data get better by more than a hundredth, a mere
            refinement where none gets worse by one. Takes longer.
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
    several = check_records(plant, records)
    if isinstance(validation, float | int):
        check(0.0 < validation < 1.0, "validation", "must lie in (0, 1) as a share", validation)
        parts = [one.split(1.0 - validation) for one in several]
        several, validation = tuple(one for one, _ in parts), [one for _, one in parts]
    held = held_out_records(plant, several, validation)
    tried = _effects([effects] if isinstance(effects, str) else effects)
    spare = rare() if effects is None else ()
    fitting = _fitting(plant, tried)
    check(0.0 < real(alpha) < 1.0, "alpha", "must lie in (0, 1)", alpha, "0.01 is a common choice.")
    most = check_count("most", most)
    runs = check_runs(plant, several, held, window)
    progress = callback or _untold
    progress("fitting the declared model", 0, _STAGES)
    prepared, several, brief = _telling(plant, several, lowpass)
    start = min(float(one.time[0]) for one in several)
    tried, spare = (tuple(one.since(start) for one in part) for part in (tried, spare))
    declared = estimate(plant, prepared, passes=_PASSES)
    if declared.status.code in ("no_data", "diverged"):
        return _failed(declared, held, several)
    task = Task(plant, prepared, several, held, tried, declared, alpha, most, window)
    found = _run(task, spare, progress)
    if refine and found.status.code in ("explained", "nothing_missing"):
        progress("refining, and what free runs lack", 2 + _ROUNDS, _STAGES)
        found = _polished(task, found, None if effects is None else tried)
    found = _doubted(task, found, refine)
    unfit = [] if effects is None else _unfit(tried, fitting, found)
    return replace(found, notes=(*brief, *found.notes, *unfit, *runs))


def _telling(
    plant: Plant, records: tuple[Record, ...], lowpass: LowPass | None
) -> tuple[PreparedRecords, tuple[Record, ...], list[str]]:
    """Records made ready, without those too short to tell anything beside the others."""
    prepared = prepare_records(plant, records, lowpass)
    cutoff = prepared.lowpass.cutoff
    left = short_record_notes(records, cutoff, "left out")
    if left:
        each = zip(records, too_short(records, cutoff), strict=True)
        records = tuple(one for one, short in each if not short)
        prepared = prepare_records(plant, records, lowpass)
    return prepared, records, left


def _doubted(task: Task, found: Discovery, refined: bool) -> Discovery:
    """With a note where nothing seems to be missing, and free runs say otherwise."""
    if found.status.code != "nothing_missing":
        return found
    doubts = beyond_noise(found.windows_after, task.held or task.records)
    further = "" if refined else _SEEN_THERE
    return replace(found, notes=(*found.notes, *(one + further for one in doubts)))


def _untold(stage: str, done: int, stages: int) -> None:
    del stage, done, stages


def _run(task: Task, spare: Sequence[AbstractEffect], progress: Progress) -> Discovery:
    """Rounds of search and refit, then the free runs.

    What is so rare that it would only cast doubt on an answer may be one where there is none: then
    the spare effects are tried too. Not as one patch of several.
    """
    # The search does not wait for the free runs before it.
    with concurrently(task.threads, lambda: free_runs(task, task.declared.plant)) as before:
        steps, rounds = _searched(task, progress)
        if not rounds[0].base.output_power > 0.0:
            none = _NO_SAMPLE if len(rounds[0].base.target) else _NO_MODE
            reason = none.format(task.declared.lowpass.cutoff)
            lost = replace(task.declared, status=Status("no_data", reason))
            return _failed(lost, task.held, task.records)
        progress("fitting again, free runs", 1 + _ROUNDS, _STAGES)
        found = _answer(task, steps, rounds, before())
    if found.status.code != "unexplained":
        return found
    if placements(task.plant, spare):
        wider = replace(task, effects=(*task.effects, *spare))
        more = _answer(wider, *_searched(wider, progress, rounds[0]), before())
        named = any(one.effect in spare for one in more.added) and len(more.added) <= _RARE
        if named and more.explained >= _WHOLLY:
            return more
    return replace(found, lead=_lead(task, steps, rounds, before()))


def _searched(
    task: Task, progress: Progress, earlier: Round | None = None
) -> tuple[list[Step], list[Round]]:
    """Rounds of search and refit until nothing is justified; the steps are those that added.

    An earlier round of the declared model lends the first one what it has computed.
    """
    model, placed, rounds, steps = task.declared.plant, [], [], []
    for i in range(_ROUNDS):
        progress(f"searching, round {i + 1}", 1 + i, _STAGES)
        one = Round(task, model, placed, rounds[-1] if rounds else earlier)
        if not len(one.base.target):
            return [], [one]
        one.search(rounds[0].found.lacking if rounds else one.lacking)
        rounds.append(one)
        if not one.chosen.atoms:
            break
        added = read_friction(model, one.kept)
        placed += list(added)
        model = one.augmented(added)
        steps.append((model, tuple(placed), tuple(rounds)))
        if one.exhausted:
            break
    return steps, rounds


def _polished(task: Task, found: Discovery, effects: Sequence[AbstractEffect] | None) -> Discovery:
    """Refined, with what only free runs show."""
    records = task.held or task.records
    assert found.after is not None
    before = found.after, found.windows_after
    better = polished(found.plant, task.records, records, before, window_of(task, records), effects)
    if isinstance(better, str):
        return replace(found, notes=(*found.notes, better))
    # What was said of the estimate before does not hold any more.
    stale = (SEARCHED, _REFITTED, _HARDLY)
    stale += tuple(on_bounds(task.plant, found.plant))
    notes = [one for one in found.notes if not one.startswith(stale)]
    notes += on_bounds(task.plant, better.refinement.plant)
    short = better.refinement.window
    length = "" if short is None else f" over windows of {short:.3g} s"
    notes.append(f"refined{length}: {better.refinement.status}")
    if better.placed:
        names = " and ".join(one.replace("_", " ") for one in names_of(better.placed))
        notes.append(f"found in the free run alone: {names}")
    result = better.refinement
    # One pass, for the injection that is left; parameters and errors are those of the refinement.
    one = estimate(result.plant, task.prepared, passes=1)
    fit = replace(
        one, parameters=result.parameters, information=result.information, plant=result.plant,
        certainty=Certainty(result.covariance, result.degrees_of_freedom, result.standard_errors),
        status=result.status,
    )  # fmt: skip
    kept = [replace(one, parameters={name: result.parameters[name] for name in one.parameters},
                    standard_errors={name: result.standard_errors[name] for name in one.parameters})
            for one in found.added]  # fmt: skip
    added = [*kept, *(_added(task.plant, fit, one) for one in better.placed)]
    notes += _vague(added)
    unseen = found.status.code == "nothing_missing" and better.placed
    return replace(
        found, status=Status("explained", _UNSEEN) if unseen else found.status,
        effects=tuple(dict.fromkeys(one.effect.name for one in added)), added=tuple(added),
        after=better.runs[0], windows_after=better.runs[1], found=fit, plant=result.plant,
        notes=tuple(notes),
    )  # fmt: skip


def _plainest(
    task: Task, placed: tuple[Placed, ...], found: Identification, runs: FreeRuns, first: Round
) -> tuple[tuple[Placed, ...], Identification, FreeRuns]:
    """With a simpler law in place of one that contains it, where free runs are as good with it."""
    for one, plain, fewer in simpler(task.plant, found, placed, task.effects):
        refit = estimate(plain, task.prepared)
        theirs = free_runs(task, refit.plant)
        if refit.status.ok and as_good(theirs, runs):
            first.refused[one] = "in free runs no better than a simpler law"
            return _plainest(task, fewer, refit, theirs, first)
    return placed, found, runs


def _effects(effects: Sequence[AbstractEffect | str] | None) -> tuple[AbstractEffect, ...]:
    library = standard()
    if effects is None:
        return library
    check_kind("effects", effects, Sequence, "a list of names or effects")
    check(len(effects) > 0, "effects", "must name at least one effect", "none")
    chosen: list[AbstractEffect] = []
    names = sorted({one.name for one in library})
    for one in effects:
        if isinstance(one, str):
            check_choice("effects", one, names)
            chosen += [other for other in library if other.name == one]
        else:
            check_kind("effects", one, AbstractEffect, "names or effects")
            chosen.append(one)
    return tuple(chosen)


def _fitting(plant: Plant, tried: Sequence[AbstractEffect]) -> set[str]:
    """Names of the effects that have a place in a plant."""
    names = dict.fromkeys(one.name for one in tried)
    fitting = {one.effect.name for one in placements(plant, tried)}
    degrees = ", ".join(
        f"{key} of relative degree {one}"
        for key, one in zip(plant.outputs, plant.degrees, strict=True)
    )
    check(len(fitting) > 0, "effects", f"must hold one that fits {plant.name}", ", ".join(names),
          f"It has {degrees}. Leave `effects` out to try all that fit.")  # fmt: skip
    return fitting


def _unfit(tried: Sequence[AbstractEffect], fitting: set[str], found: Discovery) -> list[str]:
    """A note for each effect that was asked for and had no place."""
    looked = {one.effect for one in found.ranking} or fitting
    notes = []
    for name in dict.fromkeys(one.name for one in tried):
        if name not in looked:
            why = _NOTHING_SHOWS if name in fitting else _NO_PLACE
            notes.append(why.format(name, found.declared.nominal.name))
    return notes


# -- the answer -------------------------------------------------------------------------------


def _answer(
    task: Task, steps: Sequence[Step], rounds: Sequence[Round], before: FreeRuns
) -> Discovery:
    """From the rounds of the search to what the user reads; a last step may be refused."""
    notes = _notes(task)
    placed: tuple[Placed, ...] = steps[-1][1] if steps else ()
    share, left, quiet = explained(rounds)
    alone = bool(task.held) and unrivalled(rounds[0])
    status = unless_denied(judged(placed, share, left, quiet), rounds[0])
    found, after = task.declared, before
    for model, placed, done in reversed(steps):
        share, left, quiet = explained(rounds if placed is steps[-1][1] else done)
        verdict = judged(placed, share, left, quiet, alone)
        if verdict.code != "explained":
            break
        refusal = not_simulated(model)
        if refusal:
            notes.append(_UNCHECKED.format(" and ".join(names_of(placed)), share, refusal))
            rounds[0].refused.update(dict.fromkeys(placed, "its free run cannot be simulated"))
            status = Status("unexplained", _NO_RUN)
            continue
        refit = refitted(task, model, notes)
        if not refit.status.ok:
            notes.append(f"{_REFITTED} {refit.status}")
        runs = free_runs(task, refit.plant)
        if judged(placed, share, left, quiet) != verdict and not confirmed(before, runs):
            break
        if holds(before, runs):
            status, wide = verdict, placed
            placed, found, after = _plainest(task, placed, refit, runs, rounds[0])
            if placed != wide:
                notes.append(_WIDER.format(" and ".join(names_of(wide)), share))
                share, status = _by_plain(task, placed, found, rounds)
            break
        notes.append(_REFUSED.format(" and ".join(names_of(placed))))
        rounds[0].refused.update(dict.fromkeys(placed, "held-out free run gets worse"))
        status = Status("unexplained", _WORSE)
    kept = placed if found is not task.declared else ()
    added = tuple(_added(task.plant, found, one) for one in kept)
    others = ambiguous(rounds[0], names_of(kept)) if kept else ()
    return Discovery(
        effects=names_of(kept),
        added=added,
        ranking=ranking(task.plant, rounds, kept),
        ambiguous_with=others,
        advice=advice(rounds[0], others),
        explained=share if kept else 0.0,
        before=before[0],
        after=after[0],
        windows_before=before[1],
        windows_after=after[1],
        declared=task.declared,
        found=found,
        plant=found.plant,
        status=status,
        notes=(*notes, *_at_ends(found, kept, rounds), *_vague(added)),
        in_sample=not task.held,
        held_out=task.held or task.records,
        # What remains unexplained is looked at with the tests that need no hypothesis.
        diagnosis=diagnose(task.declared, task.records) if status.code == "unexplained" else None,
    )


def _lead(
    task: Task, steps: Sequence[Step], rounds: Sequence[Round], before: FreeRuns
) -> PartialExplanation | None:
    """The last set that free runs get better with, though it takes too little to be an answer."""
    for model, placed, done in reversed(steps):
        if not_simulated(model):
            continue
        found = refitted(task, model, [])
        runs = free_runs(task, found.plant)
        if found.status.ok and holds(before, runs):
            share, _, _ = explained(rounds if placed is steps[-1][1] else done)
            added = tuple(_added(task.plant, found, one) for one in placed)
            return PartialExplanation(added, share, found, *runs)
    return None


def _vague(added: Sequence[Added]) -> list[str]:
    """Effects of which no parameter is known to half of its size."""

    def vague(one: Added) -> bool:
        pairs = ((abs(one.parameters[name]), error) for name, error in one.standard_errors.items())
        return all(error > 0.5 * value for value, error in pairs)

    return [
        f"{_HARDLY} {one.effect.name.replace('_', ' ')}: every parameter of it has a standard "
        "error above half of its value"
        for one in added
        if vague(one)
    ]


def _by_plain(
    task: Task, placed: tuple[Placed, ...], found: Identification, rounds: Sequence[Round]
) -> tuple[float, Status]:
    """What a simpler set takes of the residual, in place of the one that was found."""
    share, left, _ = explained(rounds, Round(task, found.plant, placed, rounds[-1]))
    return share, answered(share, left)


_NO_SAMPLE = (
    "no sample of the records counts: motion is hidden in noise at the cut-off {:.4g} rad/s, or "
    "the plant rests all the time. Give a `lowpass` with a lower cut-off, or records with more "
    "motion"
)
_NO_MODE = (
    "the records are too short for the cut-off {:.4g} rad/s: no frequency that they tell apart "
    "lies below it. Give a `lowpass` with a higher cut-off, or longer records"
)
_UNSEEN = "the injection shows nothing beyond the noise, but free runs do: it was found in these"
_SEEN_THERE = ". `refine=True` looks for it in the free runs"
_NO_PLACE = "{} was not tried: no output, input or internal state of {} is of its kind"
_NOTHING_SHOWS = "{} was not tried: nothing in the records of {} is of its kind"
_REFITTED = "the refit of the augmented model ended as"
_HARDLY = "the records hardly tell the size of"
_WORSE = "the effects that fit the records make the free run on other data worse"
_WIDER = "{} would take {:.1%} of the residual's power, and do no better in free runs"
_AT_END = "{} is at the end of what was searched, {:.4g}: {} ones may do as well or better"
_NO_RUN = "the effects that fit the records cannot be confirmed: no free run has them"
_UNCHECKED = "refused: {} takes {:.1%} of the residual's power, but has no free run: {}"
_REFUSED = "refused: {} makes the free run worse or diverge on the records of `validation`"


def _notes(task: Task) -> list[str]:
    notes = resting_outputs(task.held, task.records)
    if not task.held:
        notes.append(
            "no held-out record: errors are in-sample, and no effect was refused for being worse "
            "on other data. Give `validation`: records, or a share of these such as 0.3"
        )
    return notes


def _added(plant: Plant, found: Identification, one: Placed) -> Added:
    channels = one.effect.channels(plant)
    return Added(
        one.effect,
        channels[one.channel],
        {name: found.parameters[name] for name in one.names},
        {name: found.standard_errors[name] for name in one.names},
        one.effect.sentence,
        *ends(plant, one),
    )


def _at_ends(found: Identification, kept: Sequence[Placed], rounds: Sequence[Round]) -> list[str]:
    """A note for each declared parameter on a bound, and each shape that ended with its grid."""
    spans = {placed: span for one in rounds for placed, span in one.found.spans.items()}
    notes = on_bounds(rounds[0].task.plant, found.plant)
    for one in kept:
        if one not in spans:
            continue
        names = one.names[len(one.effect.gains) :]
        for name, low, high in zip(names, spans[one].low, spans[one].high, strict=True):
            value, close = found.parameters[name], _END * (high - low)
            if value <= low + close:
                notes.append(_AT_END.format(name, value, "smaller"))
            if value >= high - close:
                notes.append(_AT_END.format(name, value, "larger"))
    return notes


def _failed(
    declared: Identification, held: tuple[Record, ...], records: tuple[Record, ...]
) -> Discovery:
    """The declared model could not be fitted: its status is the answer."""
    nothing = (None, None)
    return Discovery(
        (), (), (), (), "", 0.0, *nothing, *nothing, declared, declared, declared.plant,
        declared.status, (), not held, held or records,
    )  # fmt: skip
