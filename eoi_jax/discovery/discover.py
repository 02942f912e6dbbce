r"""Find the effects that a model lacks from its residual, and add them.

1. `identify` the declared model; the remaining injection is the residual.
2. Every effect of the library, at every point of its shape grid, becomes columns of a regression
   on the modes of y^(r) - f (`cosine_modes`, `candidates`).
3. `search` finds the set of effects that the residual justifies, all declared parameters free.
4. An effect that increases the held-out error is refused, and so is a set whose residual contains a
   product of signals: the missing effect is then not in the library (`set_tests`).
5. The set is added (`augmented`) and all parameters are fitted again; the search is repeated from
   that model until no further set is justified (`round`, `in_injection`).
6. Free runs on held-out records, before and after; at the end on test records (`unseen_records`).
7. Where that gives no answer, the declared model is refined and effects are searched in its free
   runs (`free_run_search`); an answer that leaves more than noise there is questioned, refined and
   extended (`in_free_runs`), and curves are tried (`curves`).
8. On request, refinement by output error, with effects that only the free runs show; without it
   where nothing is missing and the passes are biased (`refined`).
9. Where an answer leaves more than noise, records are compared: offsets, or parameters, that differ
   from one to the next (`remainder`).
10. Without held-out records an answer that is open is searched again, with the end of each record
   held out (`own_judge`).
11. Where inputs rest with noise, an answer is searched again with each at the mean of its rests
   (`resting_inputs`).
12. An output that was logged late beside the others is moved, where that explains more
   (`moved_outputs`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from eoi_jax._checks import check, check_count, real
from eoi_jax._process import memory_returned, one_thread
from eoi_jax.data.clipping import clipped_notes
from eoi_jax.data.deadband import deadband_notes
from eoi_jax.data.late_outputs import late_output_notes
from eoi_jax.data.record import Record
from eoi_jax.data.record_notes import record_notes, same_record_notes
from eoi_jax.data.resampling import Real
from eoi_jax.discovery.additions import fit_notes
from eoi_jax.discovery.curves import misses_a_law, with_curves
from eoi_jax.discovery.doubts import (
    leaves_more,
    leaves_open,
    may_be_rate,
    misses_widely,
    noisy_log_notes,
    unless_inputs_are_noisy,
)
from eoi_jax.discovery.hold_choice import Searched, with_best_hold, with_held_inputs
from eoi_jax.discovery.in_free_runs import (
    unless_refined_is_better,
    with_free_runs,
    with_further_effects,
    with_rate_in_place,
)
from eoi_jax.discovery.in_injection import (
    STAGES,
    Progress,
    failed,
    judged_by_free_runs,
    search_injection,
    unresolved_models,
    without_search,
)
from eoi_jax.discovery.input_influence import input_notes
from eoi_jax.discovery.moved_outputs import better_of, is_all_that_is_missing, with_moved_outputs
from eoi_jax.discovery.own_judge import divided, needs_judge, with_own_judge
from eoi_jax.discovery.refined import refined_answer, with_hint, without_bias
from eoi_jax.discovery.remainder import (
    changes_in_time,
    partial_where_more_is_left,
    with_differences,
    with_differing_parameters,
    with_doubts,
    with_long_misses,
    with_poor_fit,
)
from eoi_jax.discovery.requested import (
    chain_notes,
    names_with_place,
    notes_without_place,
    requested,
    with_requested,
)
from eoi_jax.discovery.resting_inputs import with_rests
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.scattered_samples import unless_samples_are_met
from eoi_jax.discovery.sensor_in_place import may_be_sensor, with_sensor_in_place
from eoi_jax.discovery.stated_starts import with_stated_starts
from eoi_jax.discovery.task import Task
from eoi_jax.discovery.unseen_records import with_test_errors
from eoi_jax.estimation.common_factors import without_common_factors
from eoi_jax.estimation.defaults import short_record_notes, too_short
from eoi_jax.estimation.hold import hold_indices
from eoi_jax.estimation.holdout import (
    check_runs,
    held_out_records,
    scorable_records,
)
from eoi_jax.estimation.identify import estimate, trial_fit
from eoi_jax.estimation.kept_signs import reversed_notes
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.preparation import PreparedRecords, prepare_records
from eoi_jax.models.check_records import check_records, unit_notes
from eoi_jax.models.effects import (
    InputRate,
    ParameterDependence,
    couplings,
    input_actions,
    input_products,
    rare,
    wider,
)
from eoi_jax.models.effects.dependence import foreign_dependences, parameter_dependences
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant

_RULES = RULES.answer


@memory_returned()
@one_thread()
def discover(
    plant: Plant,
    records: Record | Sequence[Record],
    validation: Record | Sequence[Record] | Real | None = None,
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
            `records`, and the answer says so; where these leave it open, the last three tenths of
            each record are held out, of several that are too short for that three tenths of the
            records, and a note says that.
        effects: to try, as names or objects; by default all of `eoi_jax.effects.standard()` and
            actions of inputs that no equation has; where these leave the residual unexplained,
            beside them `eoi_jax.effects.rare()`, `couplings(plant)`, `input_actions(plant)` and, on
            signals that the equation does not have, `parameter_dependences(plant, records)`.
        lowpass: F of the fits; chosen from the records if left out.
        alpha: level of false alarms: the chance that a model which lacks nothing gets an effect.
        most: effects that one round of the search may add at most.
        window: length of re-initialised free runs [s]; by default a tenth of a record.
        refine: whether the answer is then refined by output error (`refine`), and what only its
            free run shows is added (`remaining`): what the injection hardly sees may be most of
            that error. Additions, and a fit to short runs in place of whole records, are kept
            where all free runs on held-out data get better by more than a hundredth, a mere
            refinement where none gets worse by one. Takes longer. Without it a model that lacks
            nothing is refined where that shows its passes to be biased; a note says so.
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
    if isinstance(validation, Real):
        check(0.0 < validation < 1.0, "validation", "must lie in (0, 1) as a share", validation)
        parts = [record.split(1.0 - float(validation)) for record in fit_records]
        fit_records, validation = (
            tuple(record for record, _ in parts),
            [record for _, record in parts],
        )
    held_out = held_out_records(plant, fit_records, validation)
    asked = [effects] if isinstance(effects, str) else effects
    tried_effects = requested(plant, asked, fit_records)
    rare_effects = () if effects is not None else (
        *rare(),
        *couplings(plant),
        *(action for action in input_actions(plant) if action not in tried_effects),
        *foreign_dependences(plant, fit_records),
    )  # fmt: skip
    fitting = names_with_place(plant, tried_effects)
    check(0.0 < real(alpha) < 1.0, "alpha", "must lie in (0, 1)", alpha, "0.01 is a common choice.")
    most = check_count("most", most)
    fit_records, lost = scorable_records(plant, "records", fit_records, window, not held_out)
    held_out, lost_too = scorable_records(plant, "validation", held_out, window, True)
    runs = *lost, *lost_too, *check_runs(plant, fit_records, held_out, window)
    read = *fit_records, *held_out
    unseen = held_out_records(plant, read, test, "test")
    progress = callback or _no_progress
    progress("fitting the declared model", 0, STAGES)
    search = _Search(
        plant, lowpass, tried_effects, rare_effects, alpha, most, window, refine,
        effects is not None, progress,
    )  # fmt: skip
    discovery = search.discovered(fit_records, held_out)
    if needs_judge(discovery, fit_records):
        parts = divided(plant, fit_records, window)
        discovery = with_own_judge(discovery, parts, search.discovered)
    unplaced_notes = chain_notes(discovery)
    if effects is not None:
        unplaced_notes += notes_without_place(tried_effects, fitting, discovery)
    measured = *_notes_on_channels(discovery, fit_records), *record_notes((*read, *unseen))
    measured += *clipped_notes(read), *deadband_notes(read), *unit_notes(plant, read)
    measured += tuple(same_record_notes(fit_records))
    notes = *fit_notes(plant, discovery.added, discovery.found), *unplaced_notes, *runs, *measured
    discovery = replace(discovery, notes=(*discovery.notes, *notes))
    discovery = discovery if effects is None else with_requested(discovery, tried_effects)
    return with_test_errors(discovery, unseen, fit_records, window) if unseen else discovery


def _notes_on_channels(discovery: Discovery, fitted: tuple[Record, ...]) -> tuple[str, ...]:
    """Sentences on inputs and outputs that free runs, and the estimate, show as logged wrongly."""
    notes = tuple(noisy_log_notes(discovery))
    if (runs := discovery.after) is not None:
        notes = *notes, *late_output_notes(runs.records, runs.residual, runs.outputs)
    if discovery.found.status.fits:
        of_inputs = input_notes(discovery, fitted)
        notes = *of_inputs, *reversed_notes(discovery.declared.nominal, discovery.found), *notes
    return notes


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
        is_moved: whether outputs that were logged late are moved.
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
    is_moved: bool = False

    def discovered(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Discovery:
        """The answer, on records without the noise of inputs at rest where that predicts better.

        Args:
            records: to fit and to search, as given.
            held_out: that judge, as given.
        """
        discovery = self._compared(records, held_out)
        return with_rests(discovery, self._compared, records, held_out)

    def _compared(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Discovery:
        """The answer, on records whose hold is chosen where it is not declared."""
        discovery = self._explained(records, held_out)
        discovery = with_poor_fit(partial_where_more_is_left(discovery))
        discovery = with_long_misses(discovery, self.refine)
        discovery = with_stated_starts(discovery, records)
        noted = with_differences(discovery, records)
        if noted.status is not discovery.status:
            return noted
        self.progress("comparing the records", 2 + _RULES.rounds, STAGES)
        return with_differing_parameters(noted, records, self.effects, self.alpha)

    def _explained(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Discovery:
        """What explains these records, whose hold is chosen; what it leaves is not asked."""
        indices = hold_indices(self.plant, records, trial_fit, self.lowpass)
        if indices is None:
            search, searched = self, self.on(records, held_out)
        else:
            search = replace(self, lowpass=indices.lowpass)
            searched = with_best_hold(search.on, records, held_out, indices)
        moved = search._with_moved_outputs(searched.discovery, records, held_out)
        if moved is not None and is_all_that_is_missing(moved):
            return moved
        discovery = search.in_free_runs(searched, records, held_out)
        discovery = with_held_inputs(discovery, search.answered, records, held_out)
        return better_of(moved, discovery)

    def _with_moved_outputs(
        self, discovery: Discovery, records: tuple[Record, ...], held_out: tuple[Record, ...]
    ) -> Discovery | None:
        """The answer on records whose late outputs are moved; None where none seems to be late."""
        if self.is_moved:
            return None
        search = replace(self, is_moved=True)._explained
        return with_moved_outputs(discovery, search, records, held_out)

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
        discovery = unless_inputs_are_noisy(searched.discovery)
        discovery = unless_samples_are_met(discovery, records, self.lowpass)
        start = min(float(record.time[0]) for record in records)
        of_plant = input_products(self.plant) + couplings(self.plant) + input_actions(self.plant)
        dependences = (law for law in self.rare if isinstance(law, ParameterDependence))
        further = () if self.named else (*wider(), *of_plant, *dependences)
        effects = [effect.since(start) for effect in dict.fromkeys((*self.effects, *further))]
        changing = self._changing_in_time(discovery, records, held_out)
        if changing and changing.status.code == "complete" and not leaves_more(changing):
            if not leaves_open(changing):
                return changing
            self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
            return with_free_runs(
                changing, records, held_out, effects, searched.partial, self.lowpass, self.alpha
            )
        if leaves_more(discovery):
            discovery = unless_refined_is_better(discovery, records)
        is_open = leaves_open(discovery)
        if is_open or misses_widely(discovery):
            self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
            discovery = with_free_runs(
                discovery, records, held_out, effects, searched.partial, self.lowpass, self.alpha
            )
        else:
            rates = [effect for effect in effects if isinstance(effect, InputRate)]
            discovery = self._late_otherwise(discovery, records, held_out, rates)
        discovery = self._with_curves(replace(searched, discovery=discovery).with_lead, records)
        if not is_open and leaves_more(discovery):
            self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
            named, settings = discovery, (effects, self.lowpass, self.alpha)
            discovery = with_further_effects(named, records, held_out, *settings)
            if len(discovery.added) > len(named.added):
                discovery = self._with_curves(discovery, records)
        if changing is None or discovery.status.code != "unexplained":
            return discovery
        if not leaves_more(changing):
            return changing
        self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
        settings = effects, self.lowpass, self.alpha
        return with_further_effects(changing, records, held_out, *settings)

    def _changing_in_time(
        self, discovery: Discovery, records: tuple[Record, ...], held_out: tuple[Record, ...]
    ) -> Discovery | None:
        """An answer with a parameter that changes with time; None where there is none.

        What wears, fouls or warms up changes a parameter. It is tried where the residual of the
        injection, which no effect explains, depends on time most, or is mostly that of parameters
        which change with time; held-out records must confirm it. The hold of the inputs is chosen
        with it: under the wrong one of the answer at hand it explains less.
        """
        if self.named or not (held_out and changes_in_time(discovery)):
            return None
        laws = (law for law in parameter_dependences(self.plant, records) if not law.signals)
        search = replace(self, effects=tuple(laws), rare=(), named=True)
        answer = search._explained(records, held_out)
        return answer if answer.added and answer.status.code in ("complete", "partial") else None

    def _late_otherwise(
        self,
        discovery: Discovery,
        records: tuple[Record, ...],
        held_out: tuple[Record, ...],
        rates: Sequence[InputRate],
    ) -> Discovery:
        """The answer, with what the injection does not try in place of lags and delays of inputs.

        A lag of the sensor, or else a response to the rate of an input.
        """
        if may_be_sensor(discovery) and not self.named:
            self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
            outcome = with_sensor_in_place(discovery, records, held_out, self.lowpass)
            if outcome is not discovery:
                return outcome
        if may_be_rate(discovery):
            self.progress("searching in free runs", 2 + _RULES.rounds, STAGES)
            for rate in rates:
                discovery = with_rate_in_place(
                    discovery, records, held_out, rate, self.lowpass, self.alpha
                )
        return discovery

    def _with_curves(self, discovery: Discovery, records: tuple[Record, ...]) -> Discovery:
        """The answer, with curves where these predict far better, or as well as many laws."""
        if self.named or not misses_a_law(discovery):
            return discovery
        self.progress("fitting curves in free runs", 2 + _RULES.rounds, STAGES)
        return with_curves(discovery, records, self.lowpass)

    def on(self, records: tuple[Record, ...], held_out: tuple[Record, ...]) -> Searched:
        """What is found on these records.

        Args:
            records: to fit and to search.
            held_out: that judge.
        """
        self.progress("fitting the declared model", 0, STAGES)
        prepared, records, short_notes = _informative_records(self.plant, records, self.lowpass)
        start = min(float(record.time[0]) for record in records)
        effects, rare_effects = (
            tuple(effect.since(start) for effect in group if not effect.only_in_free_runs)
            for group in (self.effects, self.rare)
        )
        declared = estimate(self.plant, prepared, passes=_RULES.passes)
        if declared.status.code in ("no_data", "diverged"):
            return Searched(failed(declared, held_out, records))
        determined = without_common_factors(self.plant, declared.common_factors)
        if determined is not self.plant:
            searched = replace(self, plant=determined).on(records, held_out)
            factors = declared.common_factors
            discovery = replace(searched.discovery, common_factors=factors)
            return replace(searched, discovery=discovery)
        task = Task(
            self.plant, prepared, records, held_out, effects, declared, self.alpha, self.most,
            self.window, len({effect.kind for effect in (*effects, *rare_effects)
                              if isinstance(effect, ParameterDependence)}),
        )  # fmt: skip
        resolved = declared.status.code != "undersampled"
        if resolved:
            searched = search_injection(task, rare_effects, self.progress)
        else:
            searched = Searched(without_search(task, self.progress))
        discovery = searched.discovery
        answered_so_far = discovery.status.code in ("complete", "nothing_missing")
        if answered_so_far and (self.refine or not resolved):
            self.progress("refining, and what free runs lack", 2 + _RULES.rounds, STAGES)
            discovery = refined_answer(task, discovery, effects if self.named else None)
        else:
            discovery = with_hint(task, without_bias(task, discovery))
        if not resolved:
            discovery = judged_by_free_runs(discovery)
            if discovery.status.code == "unexplained":
                partial = unresolved_models(task, rare_effects, self.progress)
                searched = replace(searched, partial=partial)
        discovery = with_doubts(discovery, self.refine)
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
