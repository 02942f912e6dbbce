"""Free-run error of a plant on records: what simulation alone, without feedback of y, gets right.

The initial state (outputs, their derivatives, internal states, and where inputs behind delays and
lags were before the record) is part of no model: it is estimated from the first samples of each run
(`initial_state.py`), which are not scored.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_count, check_positive, counted, timed
from eoi_jax._process import one_thread
from eoi_jax.data.cleaning import channel_groups
from eoi_jax.data.holds import (
    chosen_hold,
    clearly_smaller,
    made_alike,
    undeclared_hold,
    with_hold,
)
from eoi_jax.data.input_holds import Hold
from eoi_jax.data.late_outputs import late_output_notes
from eoi_jax.data.masks import hold_advice, scored_samples, transient_samples, unscored_notes
from eoi_jax.data.record import Record
from eoi_jax.data.windows import (
    Plan,
    driven_parts,
    joined,
    late_starts,
    plan,
    restart_notes,
    start_samples,
)
from eoi_jax.models.check_records import check_records, unit_notes
from eoi_jax.models.controller import Controller
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.closed_loop import closed_loop
from eoi_jax.simulation.error_growth import (
    ErrorGrowth,
    error_growth,
    is_lost,
    restarted,
    window_head,
)
from eoi_jax.simulation.initial_state import Run, Starts
from eoi_jax.simulation.integrator import frictional
from eoi_jax.simulation.planned_runs import Course, estimated_starts, planned_runs
from eoi_jax.simulation.simulate import acted, drive, past_slopes
from eoi_jax.simulation.start_error import sufficient_starts
from eoi_jax.simulation.step_size import (
    RULES,
    StepChange,
    StepChoice,
    choose_steps,
    finest_steps,
    settled_steps,
)
from eoi_jax.simulation.validation import FittedModel, Validation

PerOutput = Float[np.ndarray, " ny"]
Samples = Float[np.ndarray, "time ny"]


@one_thread()
def validate(
    plant: Plant | FittedModel,
    records: Record | Sequence[Record],
    *,
    initial_samples: int | None = None,
    window: float | None = None,
    substeps: int | None = None,
    controller: Controller | None = None,
) -> Validation:
    """Simulate a plant along records and compare.

    Of a plant that is unstable a free run through a whole record may say nothing: the
    error of its start grows until it is larger than the output. Such a plant is judged in windows
    over which this error stays a few times the noise (`error_growth.py`); a note says so, and how
    many starts there are.

    Where records do not declare the hold of their inputs, the one with the smallest error is used,
    and a note gives the evidence.

    Each output is scored at the samples at which it was measured. Where an input is unknown the run
    ends, and another one starts behind it, from its own estimated state; parts that are too short
    for that are not scored. A run whose first samples are masked starts later, as soon as enough
    are valid. A record without such a run is not scored where another one is. All of it stands in
    the notes.

    Args:
        plant: the model with the parameters to judge; or a result of `identify`, `refine` or
            `discover`: its model, and records that do not declare the hold of their inputs are
            then taken as made like those of its fit, with the same hold and skew.
        records: one or several; a record's burn-in is not scored.
        initial_samples: samples at the start of each run from which its initial state is estimated;
            they are not scored. None: fifty, a third of a record of less than 150 samples; more
            where an output is measured rarely, and, without windows, where the error of a start
            from so few samples would rule the run (`start_error.py`).
        window: length of each run [s]; the state is then estimated anew at the start of every
            window. None: one run through the whole record, the harder test, or windows where that
            is lost as the error of the start grows. Infinite: one run in any case.
        substeps: steps of the simulation per sample. None: four, more where the fastest mode of the
            plant needs them, and twice as many as long as their error would show in the residual
            (`step_size.py`).
        controller: drives inputs of the plant by the simulated outputs: whole runs of an unstable
            plant then stay near the record. The recorded input serves to check that it is the
            controller of the record (`closed_loop.py`). None: the recorded input drives the plant.

    Returns:
        Errors over all scored samples of all records, and predictions over all samples.

    Raises:
        ValueError: no record, channels or units that are not the plant's, too few samples in all, a
            window not longer than the initial samples, a controller that does not reproduce the
            recorded input, or that plant or records cannot be simulated with.
    """
    if isinstance(plant, FittedModel):
        fitted = plant.records
        records = made_alike(check_records(plant.plant, records), fitted, fitted)
        plant = plant.plant
    if controller is not None:
        loop = closed_loop(plant, records, controller)
        closed_runs = validate(loop.plant, loop.records, initial_samples=initial_samples,
                               window=window, substeps=substeps)  # fmt: skip
        return replace(
            closed_runs,
            predictions=loop.predictions(closed_runs.predictions),
            notes=(*closed_runs.notes, loop.note),
            records=loop.originals,
            in_loop=True,
        )
    if window is not None:
        length = None if window == np.inf else window
        return _with_late_outputs(judged_runs(plant, records, initial_samples, length, substeps))
    full_runs = judged_runs(plant, records, initial_samples, None, substeps)
    growth = growth_that_rules(plant, full_runs, initial_samples)
    if growth is None:
        return _with_late_outputs(full_runs)
    if initial_samples is None:
        initial_samples = window_head(growth.window, plant, full_runs.records)
    runs = judged_runs(plant, records, initial_samples, growth.window, substeps)
    starts = sum(-(-(len(record) - 1) // round(growth.window / record.sample_period))
                 for record in runs.records)  # fmt: skip
    runs = replace(runs, notes=(*runs.notes, restarted(starts, growth, "Judged")))
    return _with_late_outputs(runs)


def _with_late_outputs(runs: Validation) -> Validation:
    """The runs, with a note on outputs that seem to be logged late beside the others."""
    lateness = late_output_notes(runs.records, runs.residual, runs.outputs)
    return replace(runs, notes=(*runs.notes, *lateness))


def growth_that_rules(
    plant: Plant, full_runs: Validation, initial_samples: int | None = None, limit: float = 1.0
) -> ErrorGrowth | None:
    """How errors of a start grow, where they rule whole free runs; None where these can be judged.

    Args:
        plant: that was simulated.
        full_runs: its free runs through whole records.
        initial_samples: from which they started; None: as many as `validate` takes.
        limit: error over the spread of an output, up to which a whole run says something.
    """
    errors = full_runs.nrmse
    if plant.sampled is not None or not is_lost(errors, np.full_like(errors, limit)):
        return None  # the growth of errors is that of the plant without its controller
    growth = error_growth(plant, full_runs.records, initial_samples)
    return growth if growth.growing and growth.cuts(full_runs.records) else None


def validated_alike(
    models: Sequence[Plant | FittedModel], records: Record | Sequence[Record]
) -> list[Validation]:
    """`validate` of several models of one plant, all in the shortest of the windows that they need.

    Args:
        models: to compare; plants, or results of `identify`, `refine` or `discover`.
        records: on these.
    """
    runs = [validate(model, records) for model in models]
    windows = {run.window for run in runs}
    if len(windows) == 1:
        return runs
    shortest = min(window for window in windows if window is not None)
    plant = models[0] if isinstance(models[0], Plant) else models[0].plant
    head = window_head(shortest, plant, runs[0].records)
    return [
        run
        if run.window == shortest
        else validate(model, records, window=shortest, initial_samples=head)
        for model, run in zip(models, runs, strict=True)
    ]


def judged_runs(
    plant: Plant,
    records: Record | Sequence[Record],
    initial_samples: int | None = None,
    window: float | None = None,
    substeps: int | None = None,
    total_steps: int = RULES.total,
) -> Validation:
    """`validate` in runs of exactly this length, None for whole records: what can be compared.

    Args:
        plant: the model with the parameters to judge.
        records: one or several.
        initial_samples: as of `validate`.
        window: length of each run [s]; None: whole records.
        substeps: as of `validate`.
        total_steps: that all records together may take.
    """
    records = check_records(plant, records)
    for record in records:
        _check_lengths(plant, record, initial_samples, window)
    check_scored = partial(_check_record, plant, initial_samples, window)
    unscored = unscored_notes(records, check_scored)
    judge = partial(_judged, plant, initial_samples, window, substeps, total_steps)
    rule = undeclared_hold(records)
    if rule is None:
        single = judge(records)
        return replace(single, notes=(*single.notes, *unscored))
    runs: dict[Hold, Validation] = {}

    def error(hold: Hold) -> float:
        runs[hold] = judge(with_hold(records, hold))
        with np.errstate(divide="ignore"):
            return float(np.exp(np.mean(np.log(runs[hold].rmse))))

    def better(error: float, reference: float) -> bool:
        return clearly_smaller(error**2, reference**2, runs[rule].scored)

    choice = chosen_hold(error, rule, records, better)
    best = runs[choice.best]
    return replace(best, notes=(*best.notes, *unscored, *choice.evidence("the error")))


def _judged(
    plant: Plant,
    initial_samples: int | None,
    window: float | None,
    substeps: int | None,
    total_steps: int,
    records: tuple[Record, ...],
) -> Validation:
    """The free runs of records whose hold is declared."""
    choice = choose_steps(plant, records, total_steps) if substeps is None else StepChoice(substeps)
    heads = [_head(plant, record, initial_samples) for record in records]
    run = Run(plant, frictional(plant), choice.count)
    if initial_samples is None and window is None:
        heads = sufficient_starts(run, records, heads)
    pieces = _pieces(plant, records, heads, window)
    prediction, count = _Prediction.of(run, records, pieces), choice.count
    if substeps is None:
        limit = finest_steps(records, total_steps)
        prediction, count = _halved(prediction, run, records, pieces, limit)
    notes = [choice.note, *_start_notes(records, pieces, heads, window), *prediction.notes]
    notes += unit_notes(plant, records)
    samples = prediction.samples(records)
    for name, counts in zip(plant.outputs, samples[2].T, strict=True):
        check(bool(np.any(counts)), f"records.outputs[{name}]",
              "must have a sample that is scored, behind the start of a free run", "none",
              "Give longer records, or take that output out of the model.")  # fmt: skip
    rmse, nrmse, fit = _errors(*samples)
    return Validation(
        rmse,
        nrmse,
        fit,
        tuple(map(_record, records, prediction.outputs, prediction.simulated)),
        len(samples[0]),
        plant.outputs,
        tuple(plant.units.get(key, "") for key in plant.outputs),
        tuple(filter(None, notes)),
        records,
        window,
        scored_at=prediction.scored,
        substeps=count,
    )


FreeRuns = tuple[Validation, Validation | None]  # whole, in windows


def whole_and_windows(
    plant: Plant,
    records: Sequence[Record],
    window: float | None,
    longest: float | None = None,
) -> FreeRuns:
    """Both kinds of free runs: long ones of a lightly damped plant are ruled by drift of phase.

    Args:
        plant: to judge.
        records: on these.
        window: length of re-initialised runs [s]; None where the records are too short for any.
        longest: the same of the long runs, of an unstable plant; None: whole records. Short ones
            are then half as long at most.

    Returns:
        Long and short runs; None for these where a window holds no more than a start takes.
    """
    if longest is None:
        return judged_runs(plant, records), _short_runs(plant, records, window)
    short = longest if window is None else window
    lengths = longest, min(short, 0.5 * longest)
    pairs = [(window_head(length, plant, records), length) for length in lengths]
    long_runs, short_runs = (judged_runs(plant, records, *pair) for pair in pairs)
    return long_runs, short_runs


def _short_runs(plant: Plant, records: Sequence[Record], window: float | None) -> Validation | None:
    """Runs in windows; None where these hold no more than a start takes."""
    if window is None:
        return None
    count = round(window / max(record.sample_period for record in records))
    head = _window_starts(plant, records, window) or 0
    return runs_in(window, plant, records) if head < count else None


def runs_in(
    window: float | None,
    plant: Plant,
    records: Sequence[Record],
    substeps: int | None = None,
) -> Validation:
    """Runs of this length, None for whole records, each from as many samples as it has for a start.

    Args:
        window: length of the runs [s].
        plant: to judge.
        records: on these.
        substeps: as of `validate`.
    """
    return judged_runs(plant, records, _window_starts(plant, records, window), window, substeps)


def _window_starts(plant: Plant, records: Sequence[Record], window: float | None) -> int | None:
    """Samples of the start of a window: None for as many as by default, a share of short ones."""
    if window is None:
        return None
    count = round(window / max(record.sample_period for record in records))
    fits = all(start_samples(record, plant.rows) < count for record in records)
    return None if fits else window_head(window, plant, records)


def _head(plant: Plant, record: Record, initial_samples: int | None) -> int:
    """Samples that start each run on a record."""
    if initial_samples is None:
        return start_samples(record, plant.rows)
    return initial_samples


def _check_lengths(
    plant: Plant, record: Record, initial_samples: int | None, window: float | None
) -> None:
    """Check the samples that start a run, and the window, on a record."""
    unknowns = plant.rows + int(np.sum(plant.open_internal))
    if initial_samples is not None:
        check_count("initial_samples", initial_samples)
    head = _head(plant, record, initial_samples)
    rule = f"must exceed {unknowns}, the number of initial values of an output"
    if np.any(plant.open_internal):
        rule += " and of internal states, whose declared values are checked there too"
    check(head > unknowns, "initial_samples", rule, head)
    if window is not None:
        check_positive("window", window)
        count = round(window / record.sample_period)
        rule = f"must be longer than {timed(head, record.sample_period)}, which start each run"
        check(count > head, "window", rule, timed(count, record.sample_period))


def _check_record(
    plant: Plant, initial_samples: int | None, window: float | None, record: Record
) -> None:
    """Check that a run on a record is scored."""
    head = _head(plant, record, initial_samples)
    unscored = max(head, transient_samples(record))
    period = record.sample_period
    first = timed(unscored, period)
    rule = f"must have valid samples after the first {first}, which are not scored"
    good = bool(np.any(scored_samples(record, unscored)))
    check(good, f"record {record.name}", rule, timed(len(record), period),
          "Lower `initial_samples`, or the record's burn-in.")  # fmt: skip
    longest = max(stop - start for start, stop in record.input_segments())
    check(
        longest > head,
        f"record {record.name}",
        f"must have known inputs for more than {timed(head, period)}, from which a free run starts",
        f"{timed(longest, period)} at most between two gaps",
        hold_advice([record])
        or "Fill in the inputs where they are certain, or lower `initial_samples`.",
    )
    parts = [part for _, part in driven_parts(record, head + 1)]
    runs = [plan(part, head, window, plant.rows) for part in parts]
    most = max(runs, key=lambda part_runs: part_runs.available - part_runs.need)
    rule = (
        f"must have {counted(most.need, 'valid sample')} among {timed(head, period)}, from which "
    )
    rule += "a free run starts, and others that follow in it"
    scored = [np.any(part_runs.score[:, None] & part.output_valid, axis=0)
              for part_runs, part in zip(runs, parts, strict=True)]  # fmt: skip
    check(bool(np.any(scored)), f"record {record.name}", rule,
          f"{most.available} at most", "Raise `initial_samples`, or the window, or leave it out."
          )  # fmt: skip


# -- runs ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Piece:
    """The runs on a part of a record in which all inputs are known.

    Attributes:
        owner: index of the record. first: its sample at which the part begins.
        part: the samples. plan: the runs along them.
    """

    owner: int
    first: int
    part: Record
    plan: Plan


def _pieces(
    plant: Plant, records: Sequence[Record], heads: Sequence[int], window: float | None
) -> list[_Piece]:
    """All parts of all records with runs; a part that has no sample after its start has none."""
    return [
        _Piece(owner, first, part, plan(part, head, window, plant.rows))
        for owner, (record, head) in enumerate(zip(records, heads, strict=True))
        for first, part in driven_parts(record, head + 1)
    ]


def _start_notes(
    records: Sequence[Record],
    pieces: Sequence[_Piece],
    heads: Sequence[int],
    window: float | None,
) -> list[str]:
    notes = []
    for owner, (record, head) in enumerate(zip(records, heads, strict=True)):
        own = [piece for piece in pieces if piece.owner == owner]
        notes += restart_notes(record, len(own), head + 1)
        for piece in own:
            notes += late_starts(piece.part, piece.plan, head, window is None)
    return notes


@dataclass(frozen=True)
class _Prediction:
    """Free runs along all records, one or one a window.

    Attributes:
        outputs: of each record, shape (N, ny). scored: which samples count, shape (N,).
        simulated: which were simulated, shape (N,). notes: on runs that diverge.
        starts: initial values of the runs of each piece.
    """

    outputs: tuple[np.ndarray, ...]
    scored: tuple[np.ndarray, ...]
    simulated: tuple[np.ndarray, ...]
    notes: tuple[str, ...]
    starts: tuple[np.ndarray, ...]

    @classmethod
    def of(
        cls,
        run: Run,
        records: Sequence[Record],
        pieces: Sequence[_Piece],
        starts: Sequence[Starts] | None = None,
    ) -> "_Prediction":
        """The runs of these records, from given initial values or from estimated ones."""
        outputs = [np.full(record.outputs.shape, np.nan) for record in records]
        scored = [np.zeros(len(record), dtype=bool) for record in records]
        simulated = [np.zeros(len(record), dtype=bool) for record in records]
        notes, courses = [], [_course(run, piece) for piece in pieces]
        begun = estimated_starts(run, courses) if starts is None else starts
        for piece, course, values in zip(pieces, courses, begun, strict=True):
            samples = slice(piece.first, piece.first + len(piece.part))
            prediction, note = _predict(run, course, values)
            outputs[piece.owner][samples] = prediction
            scored[piece.owner][samples] = piece.plan.score
            simulated[piece.owner][samples] = True
            notes += note
        outputs = [joined(*arrays) for arrays in zip(outputs, simulated, strict=True)]
        return cls(tuple(outputs), tuple(scored), tuple(simulated), tuple(notes), tuple(begun))

    def samples(
        self, records: Sequence[Record]
    ) -> tuple[Samples, Samples, Bool[np.ndarray, "time ny"]]:
        """Measured and predicted outputs where one counts, and which; one record after the other.

        Args:
            records: that were simulated.
        """
        masks = [score[:, None] & record.output_valid
                 for score, record in zip(self.scored, records, strict=True)]  # fmt: skip
        keep = [np.any(mask, axis=1) for mask in masks]
        y = [record.outputs[use] for record, use in zip(records, keep, strict=True)]
        y_hat = [part[use] for part, use in zip(self.outputs, keep, strict=True)]
        counts = [mask[use] for mask, use in zip(masks, keep, strict=True)]
        return np.concatenate(y), np.concatenate(y_hat), np.concatenate(counts)

    def diverges(self, records: Sequence[Record]) -> bool:
        """Whether outputs that count leave the finite numbers."""
        _, outputs, counts = self.samples(records)
        return not np.all(np.isfinite(outputs) | ~counts)

    def change_to(self, finer: "_Prediction", records: Sequence[Record]) -> StepChange:
        """By how much shorter steps change the outputs, their residual, and what was measured."""
        (y, coarse, counts), (_, fine, _) = self.samples(records), finer.samples(records)
        with np.errstate(all="ignore"):
            return _rms(fine - coarse, counts), _rms(y - fine, counts), _rms(y, counts)


def _halved(
    prediction: _Prediction,
    run: Run,
    records: Sequence[Record],
    pieces: Sequence[_Piece],
    limit: int,
) -> tuple[_Prediction, int]:
    """The runs with the longest steps that half as long ones agree with, and their number a sample.

    First all from the same states, which are then estimated anew with these steps: for each length
    of a step that would take longest. Runs that diverge, in far shorter steps from the same states
    as well, stay as they are.
    """

    def settled(first: _Prediction, count: int) -> tuple[int, bool]:
        predictions = {count: first}

        def with_steps(count: int) -> _Prediction:
            if count not in predictions:
                finer = replace(run, substeps=count)
                predictions[count] = _Prediction.of(finer, records, pieces, first.starts)
            return predictions[count]

        def change(count: int) -> StepChange:
            return with_steps(count).change_to(with_steps(2 * count), records)

        shortest = min(2 ** (RULES.halvings + 1) * count, limit)
        if first.diverges(records) and with_steps(shortest).diverges(records):
            return count, False
        return settled_steps(count, limit, change)

    count, are_enough = settled(prediction, run.substeps)
    while count != run.substeps:
        run = replace(run, substeps=count)
        prediction = _Prediction.of(run, records, pieces)
        if not are_enough:
            break
        count, are_enough = settled(prediction, count)
    return prediction, count


def _course(run: Run, piece: _Piece) -> Course:
    """What drives the runs along a part of a record."""
    part = piece.part
    driven_by = drive(part.time, part.inputs, part.hold, run.substeps, part.skew)
    past = None if run.plant.actuator is None else past_slopes(run.plant, driven_by)
    begins = np.asarray(piece.plan.starts) + piece.first == 0
    begins &= not part.continues
    return Course(part, acted(run.plant, driven_by), past, piece.plan, begins)


def _predict(run: Run, course: Course, values: Starts) -> tuple[Samples, list[str]]:
    """Free runs along a part of a record: prediction, notes, also if one diverges."""
    record, runs, diverged = course.record, course.runs, None
    prediction = np.full(record.outputs.shape, np.nan)
    predicted = np.zeros(len(record), dtype=bool)
    free_runs, notes = planned_runs(run, course, values)
    for start, sample_range, y_hat in zip(runs.starts, runs.predicted, free_runs, strict=True):
        bad = ~np.all(np.isfinite(y_hat[: sample_range.stop - start]), axis=1)
        if bad.any() and diverged is None:
            diverged = record.time[start + int(np.argmax(bad))]
        part = slice(sample_range.start, sample_range.stop)
        prediction[part], predicted[part] = (
            y_hat[sample_range.start - start : sample_range.stop - start],
            True,
        )
    if diverged is not None:
        notes.append(
            f"The free run on {record.name} diverges: it is not finite from t = {diverged:g} s on."
        )
    return joined(prediction, predicted), notes


# -- scores -------------------------------------------------------------------------------


def _errors(
    y: Samples, y_hat: Samples, counts: Bool[np.ndarray, "time ny"]
) -> tuple[PerOutput, PerOutput, PerOutput]:
    finite = np.all(np.isfinite(y_hat) | ~counts, axis=0)
    error = np.where(finite & counts, y - np.where(finite & counts, y_hat, 0.0), 0.0)
    spread = np.zeros(len(finite))
    for columns, mask in channel_groups(counts):
        spread[columns] = np.std(y[mask, columns], axis=0) if np.any(mask) else np.nan
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        rmse = np.where(finite, _rms(error, counts), np.inf)
        # A constant output leaves nothing to explain: any error is infinitely large beside it.
        nrmse = np.where(rmse > 0, rmse / spread, 0.0)
    return rmse, nrmse, 100.0 * (1.0 - nrmse)


def _rms(values: Samples, counts: Bool[np.ndarray, "time ny"]) -> PerOutput:
    """Root mean square of each output over the samples that count; NaN where none does."""
    rms = np.full(values.shape[1], np.nan)
    for columns, mask in channel_groups(counts):
        if np.any(mask):
            rms[columns] = np.sqrt(np.mean(values[mask, columns] ** 2, axis=0))
    return rms


def _record(
    record: Record, prediction: Samples, simulated: Bool[np.ndarray, " time"] | None = None
) -> Record:
    """The prediction as a record; a diverged one is kept within what a figure can show."""
    middle, reach = np.mean(record.outputs, axis=0), np.ptp(record.outputs, axis=0) + 1e-300
    bound = 1e3 * reach
    bounded = np.clip(np.where(np.isfinite(prediction), prediction, np.inf), middle - bound,
                    middle + bound)  # fmt: skip
    return record.with_outputs(bounded, f"{record.name} (free run)", simulated)
