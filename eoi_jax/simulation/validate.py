"""Free-run error of a plant on records: what simulation alone, without feedback of y, gets right.

The initial state (outputs, their derivatives, internal states) is part of no model: it is
estimated from the first samples of each run, by least squares of the free run over them
(Gauss-Newton, started from a local polynomial). Those samples are not
scored.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax._blas import one_thread
from eoi_jax._checks import check, check_count, check_positive
from eoi_jax._display import Result
from eoi_jax.data.record import Record
from eoi_jax.data.windows import joined, late_starts, plan
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.simulate import acted, drive

PerOutput = Float[np.ndarray, " ny"]
Samples = Float[np.ndarray, "time ny"]
Starts = Float[np.ndarray, "runs unknowns"]
Trials = Float[np.ndarray, "runs trials unknowns"]

_ROUNDS = 20  # Gauss-Newton steps; a linear plant needs one
_DIFFERENCE = 1e-6  # step of derivatives, over the size of the variable
_TRIALS = 5  # starts; and lengths of a step, each half of the one before, tried at once
_ENOUGH = 1e-5  # relative fall of the squared error below which they end: 0.02 standard errors


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
    substeps: int = 4,
) -> Validation:
    """Simulate a plant along records and compare.

    Masked samples are run through on their interpolated inputs, and are not scored. A run whose
    first samples are masked starts later, as soon as enough are valid, and says so in a note.

    Args:
        plant: the model with the parameters to judge.
        records: one or several; a record's burn-in is not scored.
        initial_samples: samples at the start of each run from which its initial state is estimated;
            they are not scored.
        window: length of each run [s]; the state is then estimated anew at the start of every
            window. None: one run through the whole record, the harder test.
        substeps: steps of the simulation per sample; four are exact enough even for a record
            sampled ten times per period of its resonance.

    Returns:
        Errors over all scored samples of all records, and predictions over all samples.

    Raises:
        ValueError: no record, channels or units that are not the plant's, too few samples, a
            window not longer than the initial samples.
    """
    records = check_records(plant, records)
    for record in records:
        _check_record(plant, record, initial_samples, window)
    run = Run(plant, frictional(plant), initial_samples, substeps)
    notes: list[str] = []
    predicted, scored = [], []
    for record in records:
        prediction, score = _predict(run, record, window, notes)
        predicted.append(prediction)
        scored.append(score & record.valid)
    y = np.concatenate([record.outputs[keep] for record, keep in zip(records, scored, strict=True)])
    y_hat = np.concatenate([part[keep] for part, keep in zip(predicted, scored, strict=True)])
    rmse, nrmse, fit = _errors(y, y_hat)
    return Validation(
        rmse,
        nrmse,
        fit,
        tuple(_record(record, part) for record, part in zip(records, predicted, strict=True)),
        len(y),
        plant.outputs,
        tuple(plant.units.get(key, "") for key in plant.outputs),
        tuple(notes),
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
    whole = validate(plant, records)
    return whole, None if window is None else validate(plant, records, window=window)


def _check_record(plant: Plant, record: Record, initial_samples: int, window: float | None) -> None:
    unknowns = plant.relative_degree + len(plant.initial_internal)
    check_count("initial_samples", initial_samples)
    check(
        initial_samples > unknowns,
        "initial_samples",
        f"must exceed {unknowns}, the number of initial values of an output",
        initial_samples,
    )
    skipped = max(initial_samples, round(record.burn_in / record.sample_period))
    kept = int(np.sum(record.valid[skipped:]))
    rule = f"must have valid samples after the first {skipped}, which are not scored"
    check(kept > 0, f"record {record.name}", rule, f"{len(record)} samples",
          "Lower `initial_samples`, or the record's burn-in.")  # fmt: skip
    if window is not None:
        check_positive("window", window)
        count = round(window / record.sample_period)
        rule = f"must be longer than {initial_samples} samples, which start each run"
        check(count > initial_samples, "window", rule, f"{count} samples")
    runs = plan(record, initial_samples, window, plant.relative_degree)
    rule = f"must have {runs.need} valid samples among {initial_samples}, from which a free run "
    rule += "starts, and others that follow in it"
    check(bool(np.any(runs.score & record.valid)), f"record {record.name}", rule,
          f"{runs.most} at most", "Raise `initial_samples`, or the window, or leave it out."
          )  # fmt: skip


# -- runs ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """What all runs share."""

    plant: Plant
    friction: tuple[int, ...]
    initial_samples: int
    substeps: int


def _predict(
    run: Run, record: Record, window: float | None, notes: list[str]
) -> tuple[Samples, Bool[np.ndarray, " time"]]:
    """Free runs along a record, one or one a window: prediction, and which samples count."""
    runs = plan(record, run.initial_samples, window, run.plant.relative_degree)
    prediction = np.full(record.outputs.shape, np.nan)
    known = np.zeros(len(record), dtype=bool)
    whole = acted(run.plant, drive(record.time, record.inputs, record.hold, run.substeps))
    diverged = None
    for start, shown, y_hat in zip(
        runs.starts,
        runs.shown,
        _free_runs(run, record, whole, runs.starts, runs.steps),
        strict=True,
    ):
        bad = ~np.all(np.isfinite(y_hat[: shown.stop - start]), axis=1)
        if bad.any() and diverged is None:
            diverged = record.time[start + int(np.argmax(bad))]
        part = slice(shown.start, shown.stop)
        prediction[part], known[part] = y_hat[shown.start - start : shown.stop - start], True
    if diverged is not None:
        notes.append(
            f"The free run on {record.name} diverges: it is not finite from t = {diverged:g} s on."
        )
    notes += late_starts(record, runs, run.initial_samples, window is None)
    return joined(prediction, known), runs.score


def _free_runs(
    run: Run, record: Record, whole: Drive, starts: Sequence[int], count: int
) -> Float[np.ndarray, "runs time ny"]:
    """Runs of `count` steps from samples `starts`, each from its own estimated initial state."""
    first = min(run.initial_samples, count + 1)
    seen = np.asarray(starts)[:, None] + np.arange(first)
    head = _parts(whole, starts, first - 1)
    values = initial_states(run, head, record.outputs[seen], record.valid[seen])
    begun = _unpacked(run.plant, values)
    return outputs_of(run.plant, _parts(whole, starts, count), begun, run.friction)


def _parts(whole: Drive, starts: Sequence[int], count: int) -> Drive:
    """What drives each run, runs first."""
    n = whole.substeps
    steps = n * np.asarray(starts)[:, None] + np.arange(n * count)
    # A run that starts late ends beyond the record, where nothing of it is looked at.
    steps = np.minimum(steps, len(whole.time) - 1)
    period = np.full(len(starts), whole.step)
    return Drive(whole.time[steps], period, whole.inputs[steps], n)


# -- the initial state --------------------------------------------------------------------


def initial_states(
    run: Run, heads: Drive, y: Float[np.ndarray, "runs time ny"], valid: np.ndarray
) -> Starts:
    """Least squares of each free run over its first samples, by damped Gauss-Newton."""
    period = float(heads.step[0]) * heads.substeps
    z = run.plant.initial_internal
    starts = np.stack(
        [_polynomial_starts(run.plant, *one, period) for one in zip(y, valid, strict=True)]
    )
    starts = np.concatenate([starts, np.broadcast_to(z, (*starts.shape[:2], len(z)))], axis=-1)
    own = np.arange(starts.shape[-1]) < starts.shape[-1] - len(z)
    spread = np.sqrt(np.mean(np.var(y, axis=1), axis=0))
    fit = _Heads(run, heads, y, valid, period, np.where(spread > 0, spread, 1.0))
    cost, values = _descend(fit, starts, own)
    if len(z):
        # Internal states stay where the model starts them, unless the first samples tell (BIC):
        # from a few noisy ones they would come out anywhere.
        freed, moved = _descend(fit, values[:, None], np.ones_like(own))
        count = np.maximum(np.sum(valid, axis=1) * y.shape[2], 2)
        tell = freed < cost * np.exp(-2.0 * len(z) * np.log(count) / count)
        values = np.where(tell[:, None], moved, values)
    return values


def _descend(
    fit: "_Heads", starts: Trials, free: Bool[np.ndarray, " unknowns"]
) -> tuple[Float[np.ndarray, " runs"], Starts]:
    """Damped Gauss-Newton over some of the unknowns, each run from its best start.

    Returns:
        The squared error of each run, and its values.
    """
    runs = np.arange(len(starts))
    costs, errors = fit.errors(starts)
    best = np.argmin(costs, axis=1)
    cost, error, values = costs[runs, best], errors[runs, best], starts[runs, best]
    left = np.flatnonzero(np.isfinite(cost))  # those that are not at their end
    if not len(left):
        return cost, values
    slopes = fit.part(left).slopes(values[left], error[left], free)
    for _ in range(_ROUNDS):
        steps = np.zeros_like(values[left])  # where the slopes are not known nothing helps
        further = np.zeros(len(left), bool)
        for i in np.flatnonzero(np.all(np.isfinite(slopes), axis=(1, 2))):
            steps[i, free], promise = _least_squares(slopes[i], error[left[i]])
            further[i] = promise > _ENOUGH * cost[left[i]]
        left, steps = left[further], steps[further]
        if not len(left):
            break
        some = fit.part(left)
        trials = values[left, None] + steps[:, None] * 0.5 ** np.arange(_TRIALS)[:, None]
        costs, errors, slopes = some.tried(trials, free)
        best = np.argmax(costs < cost[left, None], axis=1)  # the longest step that helps
        at = np.arange(len(left)), best
        fall = cost[left] - costs[at]
        further = fall > _ENOUGH * cost[left]
        for old, several in ((cost, costs), (error, errors), (values, trials)):
            old[left[fall > 0.0]] = several[at][fall > 0.0]
        (shorter,) = np.nonzero(further & (best > 0))
        if len(shorter):
            which = left[shorter]
            slopes[shorter] = fit.part(which).slopes(values[which], error[which], free)
        left, slopes = left[further], slopes[further]
    return cost, values


@dataclass(frozen=True)
class _Heads:
    """The first samples of all runs, to which start states are fitted."""

    run: Run
    heads: Drive
    y: Float[np.ndarray, "runs time ny"]
    valid: Bool[np.ndarray, "runs time"]
    period: float
    spread: Float[np.ndarray, " ny"]

    def part(self, which: Int[np.ndarray, " some"]) -> "_Heads":
        """Of some runs alone."""
        if len(which) == len(self.y):
            return self
        return replace(self, heads=self._driving(which), y=self.y[which], valid=self.valid[which])

    def _driving(self, runs: Int[np.ndarray, " some"]) -> Drive:
        """What drives some of the runs; on the host, where another number is no compilation."""
        heads = self.heads
        time, step, inputs = (
            np.asarray(one)[runs] for one in (heads.time, heads.step, heads.inputs)
        )
        return Drive(time, step, inputs, heads.substeps)

    def errors(self, values: Trials) -> tuple[np.ndarray, Float[np.ndarray, "runs trials rows"]]:
        """Squared error of each trial, infinite where it diverges, and the errors.

        Each output counts by its own spread: metres and radians add up to nothing.
        """
        out = self._simulated(values)
        error = np.where(self.valid[:, None, :, None], self.y[:, None] - out, 0.0) / self.spread
        error = error.reshape(*values.shape[:2], -1)
        with np.errstate(over="ignore", invalid="ignore"):
            cost = np.sum(error**2, axis=-1)
        return np.where(np.isfinite(cost), cost, np.inf), error

    def slopes(
        self, values: Starts, error: Float[np.ndarray, "runs rows"], free: np.ndarray
    ) -> Float[np.ndarray, "runs rows free"]:
        """Minus the derivatives of the errors with the free initial values.

        By differences: a derivative of the simulation would take longer to compile than all else.
        """
        _, errors = self.errors(self._moved(values, free))
        return self._slopes(values, error, errors, free)

    def tried(
        self, trials: Trials, free: np.ndarray
    ) -> tuple[np.ndarray, Float[np.ndarray, "runs trials rows"], np.ndarray]:
        """`errors` of all trials, and in the same call the slopes at the first of each run."""
        first, count = trials[:, 0], trials.shape[1]
        costs, errors = self.errors(np.concatenate([trials, self._moved(first, free)], axis=1))
        slopes = self._slopes(first, errors[:, 0], errors[:, count:], free)
        return costs[:, :count], errors[:, :count], slopes

    def _moved(self, values: Starts, free: np.ndarray) -> Trials:
        return values[:, None] + np.eye(values.shape[1])[free] * self._small(values)[:, None]

    def _slopes(
        self, values: Starts, error: np.ndarray, errors: np.ndarray, free: np.ndarray
    ) -> Float[np.ndarray, "runs rows free"]:
        with np.errstate(over="ignore", invalid="ignore"):
            change = np.moveaxis(error[:, None] - errors, 1, 2)
            return change / self._small(values)[:, None, free]

    def _small(self, values: Starts) -> Starts:
        """Steps of the differences: a small share of what each initial value is measured by."""
        z = np.abs(values[:, self._reach.shape[1] :])
        return _DIFFERENCE * np.concatenate([self._reach, np.where(z > 0, z, 1.0)], axis=1)

    @cached_property
    def _reach(self) -> Starts:
        """How far outputs and their derivatives move in each run."""
        rows, columns = owned(self.run.plant)
        reach = np.ptp(self.y, axis=1) + 1e-3 * np.max(np.abs(self.y), axis=1)
        reach = np.where(reach > 0, reach, 1.0)[:, columns]
        return reach / (self.y.shape[1] * self.period) ** rows

    def _simulated(self, values: Trials) -> Float[np.ndarray, "runs trials time ny"]:
        run = self.run
        lanes = values.reshape(-1, values.shape[-1])
        owner = np.repeat(np.arange(len(values)), values.shape[1])
        begun = _unpacked(run.plant, lanes)
        out = outputs_of(run.plant, self._driving(owner), begun, run.friction)
        return out.reshape(*values.shape[:2], *out.shape[1:])


def owned(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of `State.y` that are states of a plant, output by output."""
    pairs = [(i, j) for j, degree in enumerate(plant.degrees) for i in range(degree)]
    rows, columns = np.asarray(pairs).T
    return rows, columns


def _unpacked(plant: Plant, values: Starts) -> State:
    """States of which `values` are what is unknown: outputs and derivatives, then z."""
    rows, columns = owned(plant)
    y = np.zeros((len(values), plant.relative_degree, len(plant.outputs)))
    y[:, rows, columns] = values[:, : len(rows)]
    return State(y, values[:, len(rows) :])


def _polynomial_starts(
    plant: Plant, y: Samples, valid: Bool[np.ndarray, " time"], period: float
) -> Float[np.ndarray, "trials owned"]:
    """Outputs and derivatives at the first sample, from polynomials over 1, ½, ¼, … of the head.

    A long stretch averages noise, a short one follows fast motion: the free run decides later.
    The last one is repeated where the head is too short for more.
    """
    degree = plant.relative_degree + 1
    rows, columns = owned(plant)
    factorial = np.cumprod([1.0, *range(1, degree + 1)])
    (known,) = np.nonzero(valid)
    starts, count = [], len(known)
    while count >= min(degree + 1, len(known)) and count > 0 and len(starts) < _TRIALS:
        index = known[:count]
        # Time in units of the stretch: the columns are then of one size.
        reach = max(float(index[-1]), 1.0)
        powers = np.vander(index / reach, min(degree, count - 1) + 1, increasing=True)
        coefficients = np.zeros((degree + 1, y.shape[1]))
        coefficients[: powers.shape[1]] = np.linalg.lstsq(powers, y[index], rcond=None)[0]
        scale = (factorial / (reach * period) ** np.arange(degree + 1))[:, None]
        starts.append((coefficients * scale)[rows, columns])
        count //= 2
    starts = starts or [np.zeros(len(rows))]
    return np.stack([*starts, *[starts[-1]] * (_TRIALS - len(starts))])


def _least_squares(
    jacobian: Float[np.ndarray, "rows unknowns"], error: Float[np.ndarray, " rows"]
) -> tuple[Float[np.ndarray, " unknowns"], float]:
    """Least-squares step on scaled columns, and the squared error that it promises to take away.

    What leaves no trace in y is left where it is.
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0, size, 1.0)
    step = np.linalg.lstsq(jacobian / size, error, rcond=1e-8)[0] / size
    return step, float(step @ (jacobian.T @ error))


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
    shown = np.clip(np.where(np.isfinite(prediction), prediction, np.inf), middle - bound,
                    middle + bound)  # fmt: skip
    return record.with_outputs(shown, f"{record.name} (free run)")
