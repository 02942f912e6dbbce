"""What an answer leaves of the records, and whether that differs from one to the next.

Records of different days differ in what was not recorded: the temperature around, a load, a slope,
the zero of a sensor. A model that all of them share cannot have that; an offset of its own in each
record can say so, or parameters of its own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from eoi_jax._status import Status
from eoi_jax.data.holds import with_hold
from eoi_jax.data.record import Record
from eoi_jax.data.windows import window_length
from eoi_jax.discovery.acceptance import labels_of
from eoi_jax.discovery.confirm import beyond_noise, is_undecided, or_input
from eoi_jax.discovery.diagnose import diagnose
from eoi_jax.discovery.doubts import telling_runs
from eoi_jax.discovery.drift import drift_of_parameters
from eoi_jax.discovery.judge import error_ratio
from eoi_jax.discovery.own_offsets import OwnOffsets, with_own_offsets
from eoi_jax.discovery.own_parameters import OwnFits
from eoi_jax.discovery.remarks import FitNote, RecordNote, is_on_fit
from eoi_jax.discovery.result import Discovery
from eoi_jax.discovery.rules import RULES
from eoi_jax.estimation.holdout import longest_start
from eoi_jax.models.augmented import Placed, augmented, place
from eoi_jax.models.effects import ConstantOffset
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.record_check import record_names, values_by_record
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.result import Refinement
from eoi_jax.simulation.validate import whole_and_windows
from eoi_jax.simulation.validation import Validation

_RULES = RULES.differences


def with_doubts(discovery: Discovery, refined: bool) -> Discovery:
    """An answer that nothing is missing, with what its free runs say against that.

    Of outputs that are functions of the states no free runs are searched that could answer.

    Args:
        discovery: the answer of the injection.
        refined: whether the answer was refined.
    """
    if discovery.status.code != "nothing_missing":
        return discovery
    doubts = beyond_noise(discovery.windows_after, "", discovery.after, discovery.plant)
    if doubts and discovery.plant.has_algebraic:
        return replace(discovery, status=Status("unexplained", doubts[0]))
    suggestion = "" if refined else _REFINE_HINT
    notes = (FitNote(doubt + suggestion) for doubt in doubts)
    return replace(discovery, notes=(*discovery.notes, *notes))


def partial_where_more_is_left(discovery: Discovery) -> Discovery:
    """An answer is partial where free runs miss by more, too: what it says is not what they lack.

    So it is where it takes less of the residual than is asked for, or where the errors of free runs
    on held-out records fall by less than what confirms an effect. Elsewhere a note says how much
    they still miss by; of outputs that are functions of the states, for which no free runs are
    searched that could answer, an answer is partial where long ones miss by as much, too.
    """
    status, runs = discovery.status, discovery.windows_after or discovery.after
    if status.code != "complete" or not discovery.added or discovery.in_sample or runs is None:
        return discovery
    excesses = beyond_noise(runs, or_input(_MORE_MISSING, runs), discovery.after, discovery.plant)
    if not excesses:
        return discovery
    before = discovery.before if discovery.windows_after is None else discovery.windows_before
    unimproved = before is not None and error_ratio(runs, before) > RULES.answer.confirmed
    if discovery.explained >= RULES.answer.explained and not unimproved:
        discovery = replace(discovery, notes=(*discovery.notes, *map(FitNote, excesses)))
        if not (
            discovery.plant.has_algebraic and beyond_noise(discovery.after, plant=discovery.plant)
        ):
            return discovery
    left = f"{_MORE_LEFT}, hardly less than before" if unimproved else _MORE_LEFT
    return replace(discovery, status=Status("partial", f"{status.message}; {left}"))


def with_long_misses(discovery: Discovery, refined: bool) -> Discovery:
    """An answer whose free runs are noise in windows, with a note where whole ones miss by more.

    Errors of passes that are within their ± add up in whole runs, as a phase does that drifts.

    Args:
        discovery: the answer.
        refined: whether the answer was refined.
    """
    windows, whole, plant = discovery.windows_after, discovery.after, discovery.plant
    answers = discovery.status.code in ("complete", "nothing_missing")
    if refined or not answers or discovery.base is not None or windows is None or whole is None:
        return discovery
    if beyond_noise(windows, plant=plant) or not (
        excesses := beyond_noise(whole, _LONG_MISSES, plant=plant)
    ):
        return discovery
    return replace(discovery, notes=(*discovery.notes, *map(FitNote, excesses)))


def with_poor_fit(discovery: Discovery) -> Discovery:
    """An answer that nothing is missing, which says where its free runs predict hardly anything.

    So it is of records that are noise, and of a sample far off, whose size is that of the noise.
    """
    runs = telling_runs(discovery)
    if discovery.status.code != "nothing_missing" or runs is None:
        return discovery
    poor = np.flatnonzero(~(runs.nrmse <= RULES.questions.poor)).tolist()
    if not poor:
        return _undecided(discovery, runs)
    fits = " and ".join(f"{runs.outputs[j]} (fit {runs.fit[j]:.3g} %)" for j in poor)
    message = f"{discovery.status.message}; {_POOR.format(fits)}"
    return replace(discovery, status=Status("nothing_missing", message))


def _undecided(discovery: Discovery, runs: Validation) -> Discovery:
    """An answer that nothing is missing, that says where few samples tell neither noise nor motion.

    Args:
        discovery: the answer.
        runs: that tell.
    """
    outputs = np.flatnonzero(is_undecided(runs)).tolist()
    if not outputs:
        return discovery
    fits = " and ".join(f"{runs.outputs[j]} (fit {runs.fit[j]:.3g} %)" for j in outputs)
    message = f"{discovery.status.message}; {_UNDECIDED.format(fits)}"
    return replace(discovery, status=Status("nothing_missing", message))


def changes_in_time(discovery: Discovery) -> bool:
    """Whether a residual that no effect explains depends on time more than on any signal.

    Or half of it is that of parameters which change with time, more than any map shows.
    """
    if discovery.status.code != "unexplained" or discovery.diagnosis is None:
        return False
    maps = [item for item in discovery.diagnosis.strongest if item is not None]
    if any(item.variable == "time" for item in maps):
        return True
    limit = max([RULES.answer.half, *(item.explained for item in maps)])
    return drift_of_parameters(discovery.found, discovery.diagnosis.level) > limit


def with_differences(discovery: Discovery, records: Sequence[Record]) -> Discovery:
    """An answer that leaves something, with a note where an offset of each record takes most of it.

    Args:
        discovery: the answer.
        records: of the fit, as given.
    """
    runs, judging = discovery.windows_after, discovery.held_out
    fitted = discovery.found.status.fits and not discovery.plant.has_algebraic
    asked = ("partial", "unexplained") if not discovery.added else ("partial", "complete")
    if discovery.status.code not in asked or runs is None or not fitted:
        return discovery
    fit_records = with_hold(tuple(records), judging[0].hold, judging[0].skew)
    denied = _without_stand_ins(discovery, fit_records)
    if denied is not discovery:
        return denied
    if discovery.status.code == "complete":
        return discovery
    compared = fit_records if discovery.in_sample else (*fit_records, *judging)
    if not 2 <= len(compared) <= _RULES.most:
        return discovery
    notes = [
        note
        for output in range(len(discovery.plant.outputs))
        if (note := _offsets(discovery.plant, output, compared, runs.window))
    ]
    return replace(discovery, notes=(*discovery.notes, *notes))


def _without_stand_ins(discovery: Discovery, records: tuple[Record, ...]) -> Discovery:
    """The discovery without effects that stand in for an offset of each record of the fit.

    With offsets the declared model must leave as much less than the answer as confirms an effect: a
    law that is right leaves no more than they do.
    """
    if not discovery.added or not 2 <= len(records) <= _RULES.most:
        return discovery
    declared, runs = discovery.declared.plant, discovery.windows_after
    lengths = (None,) if runs is None else (runs.window, None)
    answers = [refine_once(discovery.plant, records, length) for length in lengths]
    for output, degree in enumerate(declared.degrees):
        if not degree or not all(fit.status.fits for fit in answers):
            continue
        shifted = [with_own_offsets(declared, output, records, length) for length in lengths]
        fits = [fit for fit in shifted if fit is not None and fit.deviation > _RULES.deviations]
        if len(fits) < len(lengths):
            continue
        pairs = zip(fits, answers, strict=True)
        falls = [np.log(fit.refinement.rmse / answer.rmse) for fit, answer in pairs]
        ratio = float(np.exp(np.mean(falls)))
        if ratio < RULES.answer.confirmed:
            return _denied(discovery, records, fits[-1], declared.outputs[output], ratio)
    return discovery


def _denied(
    discovery: Discovery,
    records: tuple[Record, ...],
    shifted: OwnOffsets,
    output: str,
    ratio: float,
) -> Discovery:
    """The declared model in place of an answer, with a note on the offsets of the records."""
    fit, declared, names = shifted.refinement, discovery.declared, record_names(records)

    def formatted(parameters: Iterable[str]) -> list[str]:
        values, errors = fit.parameters, fit.standard_errors
        return [f"{values[name]:.4g} ± {errors[name]:.1g}" for name in parameters]

    labels = [names[number] for number in shifted.records]
    of_records = "; ".join(map(" in ".join, zip(formatted(shifted.names), labels, strict=True)))
    free = [name for name in declared.plant.names if name not in declared.plant.fixed]
    parameters = ", ".join(map(" = ".join, zip(free, formatted(free), strict=True)))
    suffix = "" if 0 in shifted.records else f", beside {names[0]}"
    note = _SHIFTED.format(
        output, ratio, " and ".join(discovery.effects), of_records, suffix, parameters
    )
    return _declared_alone(discovery, records, note)


def with_differing_parameters(
    discovery: Discovery,
    records: Sequence[Record],
    effects: Sequence[AbstractEffect],
    level: float,
) -> Discovery:
    """The declared model in place of an answer, where each record has parameters of its own.

    Only where the answer leaves more than noise.

    Args:
        discovery: the answer.
        records: of the fit, as given.
        effects: that may be missing in all of them.
        level: of significance.
    """
    runs, judging, answer = discovery.windows_after, discovery.held_out, discovery.found
    is_left = discovery.status.code in ("partial", "unexplained") or (
        discovery.status.code == "complete" and bool(beyond_noise(runs, plant=discovery.plant))
    )
    if not is_left or runs is None or not answer.status.fits or discovery.plant.has_algebraic:
        return discovery
    fit_records = with_hold(tuple(records), judging[0].hold, judging[0].skew)
    if not 2 <= len(fit_records) <= RULES.own_parameters.most or runs.window is None:
        return discovery
    fits = OwnFits.of(discovery.declared.nominal, fit_records, runs.window, effects, level)
    separate = fits.differing_from(discovery.plant)
    if separate is None:
        return discovery
    effects_text = f" with {labels_of(separate.placed)}" if separate.placed else ""
    *earlier, last = separate.differing
    names = f"{', '.join(earlier)} and {last}" if earlier else last
    verb = "differ" if earlier else "differs"
    denied = _declared_alone(
        discovery, records, _ASK.format(names, effects_text, separate.ratio, verb)
    )
    values = (
        RecordNote(_VALUES.format(name, values_by_record(separate.fits, name, fit_records)))
        for name in separate.differing
    )
    return replace(denied, notes=(*denied.notes, *values))


def _declared_alone(discovery: Discovery, records: Sequence[Record], reason: str) -> Discovery:
    """The declared model in place of an answer: ``"unexplained"``, for this reason."""
    declared, runs = discovery.declared, (discovery.before, discovery.windows_before)
    if discovery.base is not None and runs[0] is not None:  # they are those of the refined model
        plant, judging = declared.plant, discovery.held_out
        window = window_length(judging, 2 * longest_start(plant, judging))
        runs = whole_and_windows(plant, judging, window, runs[0].window)
    return replace(
        discovery, effects=(), added=(), ambiguous_with=(), advice="", explained=0.0,
        before=runs[0], windows_before=runs[1], after=runs[0], windows_after=runs[1], base=None,
        found=declared, plant=declared.plant, status=Status("unexplained", reason), lead=None,
        notes=tuple(note for note in discovery.notes if not is_on_fit(note)),
        diagnosis=diagnose(declared, records),
    )  # fmt: skip


def _offsets(
    plant: Plant, output: int, records: tuple[Record, ...], window: float | None
) -> FitNote | None:
    """A sentence on the offsets of the records at an output; None where they differ by little.

    All other parameters stay. The errors of free runs with an offset of its own in each record must
    be lower than those with a common one by as much as confirms an effect.
    """
    placed = place(plant, ConstantOffset(), output)
    model = augmented(plant, (placed,), {placed.names[0]: 0.0}).declared_anew(fixed=plant.names)
    common = refine_once(model, records, window)
    single_fits = [refine_once(model, (record,), window) for record in records]
    if not all(fit.status.fits for fit in (common, *single_fits)):
        return None
    sizes = [record.output_valid[:, output].sum() for record in records]
    power = np.average([fit.rmse[output] ** 2 for fit in single_fits], weights=sizes)
    ratio = float(np.sqrt(power) / common.rmse[output])
    if not ratio < RULES.answer.confirmed or not _differ(single_fits, placed):
        return None
    (name,) = placed.names
    values = ", ".join(
        f"{fit.parameters[name]:.3g} ± {fit.standard_errors[name]:.1g} in {record}"
        for fit, record in zip(single_fits, record_names(records), strict=True)
    )
    return FitNote(_DIFFER.format(plant.outputs[output], ratio, values))


def _differ(fits: Sequence[Refinement], placed: Placed) -> bool:
    """Whether the offsets of some fits differ by far more than their standard errors."""
    (name,) = placed.names
    values, errors = np.array([(fit.parameters[name], fit.standard_errors[name]) for fit in fits]).T
    if not np.all(np.isfinite(errors) & (errors > 0.0)):  # a record does not tell its offset
        return False
    mean = np.average(values, weights=errors**-2.0)
    return bool(np.sum(((values - mean) / errors) ** 2) > _RULES.deviations**2 * len(fits))


_POOR = (
    "but free runs predict {} hardly better than a constant does, so that this says little: look "
    "at the records for samples far off, and for motion beyond the noise"
)
_UNDECIDED = (
    "but samples so few and far apart show the noise from above alone: what free runs of {} miss "
    "by may be motion that the model lacks"
)
_REFINE_HINT = ". `refine=True` looks for it in the free runs"
_LONG_MISSES = (
    ", those in windows do not: small errors of the parameters add up in whole runs, to which "
    "`refine=True` fits them"
)
_MORE_LEFT = "free runs on the held-out records miss by more than noise"
_MORE_MISSING = ": something smaller than the added effects is missing, too"
_SHIFTED = (
    "the records differ in a constant at {}: with an offset of its own in each, free runs of the "
    "declared model have {:.2g} of the error that {} leaves ({}{}). What differs between them is "
    "not in the model: record it as an input, or remove it from the data. With these offsets {}"
)
_ASK = (
    "the records ask for different parameters: each by itself is described by the declared model{1}"
    ", with {2:.2g} of the error in free runs that common parameters or the effects tried leave. "
    "Between them {0} {3}. What changes is not in the model: write it into the equations and give "
    "it as an input with a value in each record (a load, a ballast), or ask `discover` of each "
    "record by itself"
)
_VALUES = "{} differs between the records: {}"
_DIFFER = (
    "the records differ in a constant at {}: with an offset of its own in each, free runs have "
    "{:.2g} of the error that one offset for all leaves ({}). What differs between them is not in "
    "the model: record it as an input, or remove it from the data"
)
