"""Free-run error of a plant on records: what simulation alone, without feedback of y, gets right.

The initial state (outputs, their derivatives, internal states) is part of no model: it is
estimated from the first samples of each run (`initial_state.py`), which are not scored.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._blas import one_thread
from eoi_jax._checks import check, check_count, check_positive
from eoi_jax._display import Result
from eoi_jax.data.holds import best_hold, ratios_to, undeclared_hold, with_hold
from eoi_jax.data.masks import scored_samples, transient_samples
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import HOLDS
from eoi_jax.data.windows import joined, late_starts, plan
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.initial_state import Run, initial_states, states_of
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.simulate import acted, drive
from eoi_jax.simulation.step_size import RULES, StepChoice, choose_steps, finest_steps

PerOutput = Float[np.ndarray, " ny"]
Samples = Float[np.ndarray, "time ny"]


@dataclass(frozen=True)
class Validation(Result):
    """Free-run errors, each of shape (ny,), over the scored samples of all records.

    `plot` shows free run against the measurement, and its error.

    Attributes:
        rmse: root mean square of y − ŷ [unit of y]; infinite if a run diverges.
        nrmse: `rmse` over the standard deviation of y.
        fit: 100 (1 − ‖y − ŷ‖ / ‖y − mean y‖) [%].
        predictions: ŷ, one record for each one given.
        scored: number of scored samples.
        outputs: names.
        units: of the outputs, "" where unknown.
        notes: sentences on what limits the numbers.
        records: that it was judged on.
    """

    rmse: PerOutput
    nrmse: PerOutput
    fit: PerOutput
    predictions: tuple[Record, ...]
    scored: int
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]
    records: tuple[Record, ...] = ()


@one_thread()
def validate(
    plant: Plant,
    records: Record | Sequence[Record],
    *,
    initial_samples: int = 50,
    window: float | None = None,
    substeps: int | None = None,
) -> Validation:
    """Simulate a plant along records and compare.

    Where records do not declare the hold of their inputs, the one with the smallest error is used,
    and a note gives the evidence.

    Masked samples are run through on their interpolated inputs, and are not scored. A run whose
    first samples are masked starts later, as soon as enough are valid, and says so in a note.

    Args:
        plant: the model with the parameters to judge.
        records: one or several; a record's burn-in is not scored.
        initial_samples: samples at the start of each run from which its initial state is estimated;
            they are not scored.
        window: length of each run [s]; the state is then estimated anew at the start of every
            window. None: one run through the whole record, the harder test.
        substeps: steps of the simulation per sample. None: four, more where the fastest mode of the
            plant needs them, and twice as many as long as their error would show in the residual
            (`step_size.py`).

    Returns:
        Errors over all scored samples of all records, and predictions over all samples.

    Raises:
        ValueError: no record, channels or units that are not the plant's, too few samples, a
            window not longer than the initial samples.
    """
    records = check_records(plant, records)
    for record in records:
        _check_record(plant, record, initial_samples, window)
    judge = partial(_judged, plant, initial_samples, window, substeps)
    rule = undeclared_hold(records)
    if rule is None:
        return judge(records)
    runs = {hold: judge(with_hold(records, hold)) for hold in HOLDS}
    with np.errstate(divide="ignore"):
        errors = {hold: float(np.exp(np.mean(np.log(run.rmse)))) for hold, run in runs.items()}
    best = best_hold(errors, rule)
    note = f"hold {best}: the error is {ratios_to(errors, best)}"
    return replace(runs[best], notes=(*runs[best].notes, note))


def _judged(
    plant: Plant,
    initial_samples: int,
    window: float | None,
    substeps: int | None,
    records: tuple[Record, ...],
) -> Validation:
    """The free runs of records whose hold is declared."""
    choice = choose_steps(plant, records) if substeps is None else StepChoice(substeps, 0.0)
    run = Run(plant, frictional(plant), initial_samples, choice.count)
    prediction = _Prediction.of(run, records, window)
    if not choice.exact:
        prediction = _halved(prediction, run, records, window)
    notes = [choice.note, *itertools.chain.from_iterable(prediction.notes)]
    y, y_hat = prediction.samples(records)
    rmse, nrmse, fit = _errors(y, y_hat)
    return Validation(
        rmse,
        nrmse,
        fit,
        tuple(map(_record, records, prediction.outputs)),
        len(y),
        plant.outputs,
        tuple(plant.units.get(key, "") for key in plant.outputs),
        tuple(filter(None, notes)),
        records,
    )


FreeRuns = tuple[Validation, Validation | None]  # whole, in windows


def whole_and_windows(plant: Plant, records: Sequence[Record], window: float | None) -> FreeRuns:
    """Both kinds of free runs: long ones of a lightly damped plant are ruled by drift of phase.

    Args:
        plant: to judge.
        records: on these.
        window: length of re-initialised runs [s]; None where the records are too short for any.
    """
    full_runs = validate(plant, records)
    return full_runs, None if window is None else validate(plant, records, window=window)


def _check_record(plant: Plant, record: Record, initial_samples: int, window: float | None) -> None:
    unknowns = plant.rows + len(plant.initial_internal)
    check_count("initial_samples", initial_samples)
    check(
        initial_samples > unknowns,
        "initial_samples",
        f"must exceed {unknowns}, the number of initial values of an output",
        initial_samples,
    )
    unscored = max(initial_samples, transient_samples(record))
    rule = f"must have valid samples after the first {unscored}, which are not scored"
    good = bool(np.any(scored_samples(record, unscored)))
    check(good, f"record {record.name}", rule, f"{len(record)} samples",
          "Lower `initial_samples`, or the record's burn-in.")  # fmt: skip
    if window is not None:
        check_positive("window", window)
        count = round(window / record.sample_period)
        rule = f"must be longer than {initial_samples} samples, which start each run"
        check(count > initial_samples, "window", rule, f"{count} samples")
    runs = plan(record, initial_samples, window, plant.rows)
    rule = f"must have {runs.need} valid samples among {initial_samples}, from which a free run "
    rule += "starts, and others that follow in it"
    check(bool(np.any(runs.score & record.valid)), f"record {record.name}", rule,
          f"{runs.available} at most", "Raise `initial_samples`, or the window, or leave it out."
          )  # fmt: skip


# -- runs ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Prediction:
    """Free runs along all records, one or one a window.

    Attributes:
        outputs: of each record, shape (N, ny). scored: which samples count, shape (N,).
        notes: sentences on each record.
    """

    outputs: tuple[np.ndarray, ...]
    scored: tuple[np.ndarray, ...]
    notes: tuple[list[str], ...]

    @classmethod
    def of(cls, run: Run, records: Sequence[Record], window: float | None) -> "_Prediction":
        """The runs of these records."""
        parts = [_predict(run, record, window) for record in records]
        return cls(*zip(*parts, strict=True))

    def samples(self, records: Sequence[Record]) -> tuple[Samples, Samples]:
        """Measured and predicted outputs where both count, one record after the other."""
        keep = [score & record.valid for score, record in zip(self.scored, records, strict=True)]
        y = [record.outputs[use] for record, use in zip(records, keep, strict=True)]
        y_hat = [part[use] for part, use in zip(self.outputs, keep, strict=True)]
        return np.concatenate(y), np.concatenate(y_hat)

    def agrees_with(self, finer: "_Prediction", records: Sequence[Record]) -> bool:
        """Whether shorter steps change the outputs by less than what would show in the residual."""
        (y, coarse), (_, fine) = self.samples(records), finer.samples(records)
        with np.errstate(all="ignore"):
            change = np.sqrt(np.mean((fine - coarse) ** 2, axis=0))
            residual = np.sqrt(np.mean((y - fine) ** 2, axis=0))
        return bool(np.all(change <= RULES.visible * residual))


def _halved(
    prediction: _Prediction, run: Run, records: Sequence[Record], window: float | None
) -> _Prediction:
    """The runs with the longest steps that half as long ones agree with."""
    most = min(run.substeps * 2**RULES.halvings, finest_steps(records) // 2)
    while run.substeps <= most:
        run = replace(run, substeps=2 * run.substeps)
        finer = _Prediction.of(run, records, window)
        if prediction.agrees_with(finer, records):
            break
        prediction = finer
    return prediction


def _predict(
    run: Run, record: Record, window: float | None
) -> tuple[Samples, Bool[np.ndarray, " time"], list[str]]:
    """Free runs along a record: prediction, which samples count, and notes."""
    notes = []
    runs = plan(record, run.initial_samples, window, run.plant.rows)
    prediction = np.full(record.outputs.shape, np.nan)
    predicted = np.zeros(len(record), dtype=bool)
    record_drive = acted(run.plant, drive(record.time, record.inputs, record.hold, run.substeps))
    diverged = None
    for start, sample_range, y_hat in zip(
        runs.starts,
        runs.predicted,
        _free_runs(run, record, record_drive, runs.starts, runs.steps),
        strict=True,
    ):
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
    notes += late_starts(record, runs, run.initial_samples, window is None)
    return joined(prediction, predicted), runs.score, notes


def _free_runs(
    run: Run, record: Record, record_drive: Drive, starts: Sequence[int], count: int
) -> Float[np.ndarray, "runs time ny"]:
    """Runs of `count` steps from samples `starts`, each from its own estimated initial state."""
    first = min(run.initial_samples, count + 1)
    first_samples = np.asarray(starts)[:, None] + np.arange(first)
    head = _parts(record_drive, starts, first - 1)
    values = initial_states(run, head, record.outputs[first_samples], record.valid[first_samples])
    begun = states_of(run.plant, values)
    return outputs_of(run.plant, _parts(record_drive, starts, count), begun, run.friction)


def _parts(record_drive: Drive, starts: Sequence[int], count: int) -> Drive:
    """What drives each run, runs first."""
    n = record_drive.substeps
    steps = n * np.asarray(starts)[:, None] + np.arange(n * count)
    # A run that starts late ends beyond the record, where nothing of it is looked at.
    steps = np.minimum(steps, len(record_drive.time) - 1)
    period = np.full(len(starts), record_drive.step)
    last = record_drive.following[steps[:, -1]]
    return Drive(record_drive.time[steps], period, record_drive.inputs[steps], n, last)


# -- scores -------------------------------------------------------------------------------


def _errors(y: Samples, y_hat: Samples) -> tuple[PerOutput, PerOutput, PerOutput]:
    finite = np.all(np.isfinite(y_hat), axis=0)
    error = np.where(finite, y - np.where(finite, y_hat, 0.0), 0.0)
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        rmse = np.where(finite, np.sqrt(np.mean(error**2, axis=0)), np.inf)
        # A constant output leaves nothing to explain: any error is infinitely large beside it.
        nrmse = np.where(rmse > 0, rmse / np.std(y, axis=0), 0.0)
    return rmse, nrmse, 100.0 * (1.0 - nrmse)


def _record(record: Record, prediction: Samples) -> Record:
    """The prediction as a record; a diverged one is kept within what a figure can show."""
    middle, reach = np.mean(record.outputs, axis=0), np.ptp(record.outputs, axis=0) + 1e-300
    bound = 1e3 * reach
    bounded = np.clip(np.where(np.isfinite(prediction), prediction, np.inf), middle - bound,
                    middle + bound)  # fmt: skip
    return record.with_outputs(bounded, f"{record.name} (free run)")
