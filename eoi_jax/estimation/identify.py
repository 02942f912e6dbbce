r"""The estimator: passes over the records, the one with the smallest index is the answer.

Section 4 of the paper, around the compiled pass of `kernel.py`: `iteration.py` is its rule.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._blas import one_thread
from eoi_jax._checks import check_count
from eoi_jax._display import Result
from eoi_jax._status import NOT_RECORDED, EngineUsed, Status
from eoi_jax.data.masks import constant
from eoi_jax.data.record import Record
from eoi_jax.estimation.covariance import Certainty, Deferred, settled
from eoi_jax.estimation.defaults import brief_notes, default_observer, default_transient
from eoi_jax.estimation.engines.single import OnePass, alone
from eoi_jax.estimation.instrumental_variables import Instrumented, cured
from eoi_jax.estimation.iteration import Iterations, Pass, by_sample, iterate, mean, sample_counts
from eoi_jax.estimation.kernel import Steps, Sums, Trace
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.preparation import (
    TAPER,
    Ready,
    check_observer,
    check_preparation,
    prepare,
    ready,
)
from eoi_jax.estimation.regression.least_squares import standard_errors, untraced
from eoi_jax.estimation.regression.robust_covariance import long_run
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant

# Up to so many values every pass stores its signals, which are wanted of the first and the best:
# a second kernel that stores nothing, and the best pass once more, would take longer.
_SHORT = 10_000_000
_KEPT = 4_000_000  # values, up to which a result keeps what its standard errors are made from
# The injection over time is shown where the filter's memory holds at least this share that counts.
_SHARE = 0.5


@dataclass(frozen=True)
class Identification(Result):
    """Estimate, its evidence, and how it came about.

    `plot` shows index per pass, and injection of the first and the best pass.

    Attributes:
        parameters: estimate by name.
        index: P of each pass and output, eq. (14), shape (passes, ny).
        increments: Δθ of each pass, shape (passes, np); that of the last pass is not applied.
        parameter_history: θ of each pass, shape (passes, np).
        best_pass: row of `index` whose θ is the estimate, but for `correction`.
        correction: what instrumental variables moved the estimate by from there, shape (np,); zeros
            where they were not used. Least squares minimises P and they do not: their P, that of
            `injection`, is a little larger, and no row of `index`.
        plant: with the estimate as parameters; `nominal` is the plant as given.
        injection: F[u_eq] at the estimate, one array (N, ny) per record, NaN where not scored.
        first_injection: that of the first pass.
        residual: F[u_eq] - F[φ] Δθ of the best pass; F[u_eq] with instruments, which leave no Δθ.
        sliding_fraction: share of scored steps in sliding at the estimate, shape (ny,).
        unexplained: rms of the best injection over that of the observed y^(r), shape (ny,).
        status: how it ended.
        observer, lowpass: as used; `reasons` says why, where they were chosen.
        notes: what was done to the records, and health warnings.
        records: as used (resampled, smoothed); sub-steps are not kept.
        certainty: covariance and standard errors, worked out when one of them is first asked for.
        information: Σ φᵀφ at the estimate over the outputs as they were weighed, shape (np, np).
        engine: that ran the passes, and why where it was not the fast one.
    """

    parameters: dict[str, float]
    index: Float[np.ndarray, "passes ny"]
    increments: Float[np.ndarray, "passes np"]
    parameter_history: Float[np.ndarray, "passes np"]
    best_pass: int
    correction: Float[np.ndarray, " np"]
    plant: Plant
    nominal: Plant
    injection: list[np.ndarray]
    first_injection: list[np.ndarray]
    residual: list[np.ndarray]
    sliding_fraction: Float[np.ndarray, " ny"]
    unexplained: Float[np.ndarray, " ny"]
    status: Status
    observer: AbstractObserver
    lowpass: LowPass
    reasons: tuple[str, ...]
    notes: tuple[str, ...]
    records: tuple[Record, ...]
    certainty: Certainty | Deferred
    information: Float[np.ndarray, "np np"] | None = None
    engine: EngineUsed = NOT_RECORDED

    @property
    def standard_errors(self) -> dict[str, float]:
        """By name; they know that filtered residuals are coloured (`regression/long_run.py`).

        They know nothing of bias: without instruments, that from noise in the regressors. NaN for a
        parameter that ended on its bound, beside which the errors of the others hold; infinite for
        one that the data leave open, alone or in a combination without a trace; 0 for a fixed one.
        """
        return settled(self.certainty).standard_errors

    @property
    def covariance(self) -> Float[np.ndarray, "np np"]:
        """Of the parameters, shape (np, np)."""
        return settled(self.certainty).covariance

    @property
    def degrees_of_freedom(self) -> Float[np.ndarray, " np"] | None:
        """Of the variance of each parameter, shape (np,)."""
        return settled(self.certainty).degrees_of_freedom


@one_thread()
def identify(
    plant: Plant,
    records: Record | Sequence[Record],
    observer: AbstractObserver | None = None,
    lowpass: LowPass | None = None,
    passes: int = 10,
    *,
    transient: float | None = None,
    substeps: int | None = None,
    smoothing: float | bool | None = None,
    instruments: bool | None = None,
    callback: Callable[[int, int, np.ndarray], None] | None = None,
) -> Identification:
    r"""Estimate a plant's parameters from measured records.

    Args:
        plant: the model with its nominal parameters θ_0.
        records: one or several; all enter one estimate.
        observer: chosen from the records if left out (implicit form).
        lowpass: F of eq. (19); its cut-off is chosen from the records if left out.
        passes: how many at most; fewer when the index no longer falls.
        transient: time at the start of each record that is not scored [s]; by default ten time
            constants of F, or the record's `burn_in` if that is longer.
        substeps: run on a record interpolated this many times finer (quintic spline); chosen
            by default so that the step is short against the band of F, 1 for the explicit form.
        smoothing: zero-phase cut-off [rad/s] applied to outputs and inputs alike; False for
            none; by default chosen when the measurement noise hides the velocity.
        instruments: whether passes with instrumental variables follow
            (`instrumental_variables.py`), whose estimate neither measurement noise nor the
            discretisation biases; False is the paper's method. By default they do where the
            records are noisy and that noise is what the plain passes leave unexplained.
        callback: called after each pass with its number from 1, `passes` and its index (ny,).

    Returns:
        The estimate. Look at `status` first.

    Raises:
        ValueError: arguments or records that do not fit; the message says which and what to do.

    Source:
        Section 4 of the paper; the discretisation is that of the observer.
    """
    several = check_records(plant, records)
    passes = check_count("passes", passes)
    check_preparation(transient, substeps, smoothing)
    if observer is not None:
        check_observer(plant, observer)
    explicit = observer is not None and observer.scheme == "explicit"
    prepared = ready(plant, several, lowpass, smoothing, substeps, explicit)
    # The explicit form is the paper's; in single precision second differences show rounding.
    coarse = explicit or jnp.result_type(float) != jnp.float64
    if instruments is False or (instruments is None and coarse):
        return estimate(plant, prepared, observer, passes, transient, callback)

    def cure(found: Plant, one: Pass, used: AbstractObserver) -> tuple:
        return cured(found, one, several, prepared, used, bool(instruments))

    return estimate(plant, prepared, observer, passes, transient, callback, cure)


Cure = Callable[[Plant, Pass, AbstractObserver], tuple[Instrumented | None, tuple[str, ...]]]


def estimate(
    plant: Plant,
    prepared: Ready,
    observer: AbstractObserver | None = None,
    passes: int = 10,
    transient: float | None = None,
    callback: Callable[[int, int, np.ndarray], None] | None = None,
    cure: Cure | None = None,
) -> Identification:
    """`identify` on records that are ready: several models of the same outputs may share them.

    Args:
        plant: the model with its nominal parameters.
        prepared: the records.
        observer: in the form that they were made ready for.
        passes: how many at most.
        transient: time at the start of each record that is not scored [s].
        callback: called after each pass.
        cure: of bias, from the plant with the estimate and its pass: another estimate, and why.
    """
    lowpass, fine, explicit = prepared.lowpass, prepared.fine, prepared.explicit
    reasons = prepared.reasons
    if observer is None:
        observer, chosen = default_observer(
            plant, fine, prepared.inputs, lowpass.cutoff, prepared.substeps
        )
        reasons += chosen
    if transient is None:
        transient = default_transient(prepared.records, lowpass, explicit)
    steps = prepare(
        plant,
        fine,
        prepared.inputs,
        len(np.atleast_2d(np.asarray(observer.kernel))[0]),
        transient,
        lowpass.memory,
        prepared.velocity_noise,
        explicit,
        TAPER / lowpass.cutoff,
    )
    filters = _stacked([lowpass.discretise(record.sample_period) for record in fine])
    notes = [f"{record.name}: {note}" for record in prepared.records for note in record.notes]
    notes += brief_notes(prepared.records, lowpass.cutoff, _BRIEF)
    notes += _precision_note()
    run = alone(plant, observer, filters, steps)
    driver = _Driver(plant, observer, run, steps, prepared.substeps, passes, callback, cure)
    return driver.run(prepared.records, lowpass, reasons, tuple(notes))


@dataclass
class _Driver:
    """One lane of `iterate`, and what is kept of it."""

    plant: Plant
    observer: AbstractObserver
    one_pass: OnePass
    steps: Steps
    substeps: int
    passes: int
    callback: Callable[[int, int, np.ndarray], None] | None
    cure: Cure | None

    def run(
        self, records: tuple[Record, ...], lowpass: LowPass, reasons: tuple, notes: tuple
    ) -> Identification:
        done, first, trace = self._iterate(records)
        one, number, status = done.best, int(done.best_pass[0]), self._status(done, records)
        theta, increment = one.theta[0], one.increment[0]
        better = None
        if self.cure is not None and status.ok:
            # It takes far longer than one pass more.
            trace = None if self._size > _KEPT else trace
            better, why = self.cure(self.plant.with_parameters(theta), one, self.observer)
            reasons += why
        bound = one.bound[0] if better is None else better.bound
        if better is not None:
            theta, increment = better.theta, np.zeros_like(theta)
        if trace is None or better is not None:
            sums, trace = self._pass(theta, "signals")
        else:
            sums = jax.tree.map(lambda leaf: leaf[0], one.sums)
        left = np.asarray(trace.injection - trace.Phi @ increment)
        information = np.einsum("j,jab->ab", one.weights[0], sums.information)
        plant = self.plant.with_parameters(theta)
        power, observed = (mean(part, sums.weight) for part in (sums.square, sums.observed_square))
        sliding = mean(sums.sliding, sums.count)
        taken = slice(int(done.passes[0]))
        return Identification(
            parameters=plant.parameters,
            index=done.index[0, taken],
            increments=done.increment[0, taken],
            parameter_history=done.theta[0, taken],
            best_pass=number,
            correction=theta - one.theta[0],
            plant=plant,
            nominal=self.plant,
            injection=self._per_sample(trace.injection, trace.weight, records),
            first_injection=first,
            residual=self._per_sample(left, trace.weight, records),
            sliding_fraction=sliding,
            unexplained=np.sqrt(power / np.where(observed > 0, observed, 1.0)),
            status=status,
            observer=self.observer,
            lowpass=lowpass,
            reasons=reasons,
            notes=notes + _sliding_note(self.plant, sliding) + bound_notes(plant, bound),
            records=records,
            certainty=self._certain(one, trace, left, better, status, information),
            information=information,
            engine=self.one_pass.used,
        )

    def _certain(
        self,
        one: Pass,
        trace: Trace,
        left: np.ndarray,
        better: Instrumented | None,
        status: Status,
        information: np.ndarray,
    ) -> Certainty | Deferred:
        plant, steps = self.plant, self.steps
        if better is None:
            rows = np.asarray(trace.Phi), left, steps.use, steps.score, self.substeps
            bound, known = one.bound[0], partial(_covariance, plant, one, *rows)
        else:
            bound = better.bound
            known = partial(tuple, (better.covariance, better.degrees_of_freedom))
        certain = Deferred(partial(_certainty, plant, known, bound, status, information))
        # What it is made from takes room until somebody asks.
        return certain.found if self._size > _KEPT else certain

    @property
    def _size(self) -> int:
        """Numbers in the signals of a pass."""
        return self.steps.use.size * (2 + len(self.plant.names))

    def _iterate(
        self, records: tuple[Record, ...]
    ) -> tuple[Iterations, list[np.ndarray], Trace | None]:
        """All passes, the injection of the first, and the signals of the best if they were kept."""
        first: list[np.ndarray] = []
        last = best = None
        long = self._size > _SHORT

        def run(which: Any, theta: np.ndarray, number: int) -> Sums:
            nonlocal last
            del which
            last = None  # or there would be those of three passes
            sums, last = self._pass(theta[0], "nothing" if long and number else "signals")
            if number == 0:
                first.extend(self._per_sample(last.injection, last.weight, records))
            return jax.tree.map(lambda leaf: leaf[None], sums)

        def watch(number: int, index: np.ndarray, lowest: np.ndarray) -> None:
            nonlocal best
            best = last if lowest[0] else best
            if self.callback is not None:
                self.callback(number + 1, self.passes, index[0])

        start = np.asarray(self.plant.theta, dtype=float)[None]
        return iterate(run, self.plant, start, self.passes, watch), first, best

    def _pass(self, theta: np.ndarray, store: str) -> tuple[Sums, Any]:
        sums, trace = self.one_pass(theta, store)
        return jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums), trace

    def _per_sample(
        self, values: Any, weight: Any, records: tuple[Record, ...]
    ) -> list[np.ndarray]:
        """F[m·]/F[m] as (N, ny) per record; NaN where not scored or where little of F is left."""
        arrays = []
        for i, record in enumerate(records):
            # A step belongs to the sample that ends it, the last of its sub-steps.
            ends = slice(self.substeps - 1, (len(record) - 1) * self.substeps, self.substeps)
            share = np.asarray(weight)[i, ends]
            scored = (np.asarray(self.steps.score)[i, ends] > 0) & (share > _SHARE)
            mean = np.asarray(values)[i, ends] / np.where(scored, share, 1.0)
            arrays.append(
                np.concatenate(
                    [np.full((1, mean.shape[1]), np.nan), np.where(scored, mean, np.nan)]
                )
            )
        return arrays

    def _status(self, done: Iterations, records: tuple[Record, ...]) -> Status:
        code, number, passes = str(done.codes[0]), int(done.best_pass[0]) + 1, int(done.passes[0])
        if code == "no_data":
            still = all(np.all(constant(record)) for record in records)
            names = ", ".join(self.plant.outputs)
            return Status(code, _STILL.format(names) if still else _NO_DATA)
        if code == "diverged":
            return Status(code, _DIVERGED)
        if code == "unidentifiable":
            solution = jax.tree.map(lambda leaf: leaf[0], done.best.solution)
            lost = untraced(solution, self.plant.names, self.plant.free)
            return Status(code, _UNTRACED.format("; ".join(lost)))
        if passes == 1:
            return Status(code, "one pass only: the nominal values were scored")
        messages = {
            "passes_exhausted": _MORE.format(number),
            "converged": f"the index is smallest in pass {number} of {passes}",
            "stalled": _STALLED.format(number, float(done.best.promise[0]))
            + (_OBSERVED if self.plant.is_affine else _BENT),
        }
        return Status(code, messages[code])


@one_thread()
def _certainty(
    plant: Plant,
    known: Callable[[], tuple[np.ndarray, np.ndarray]],
    bound: Bool[np.ndarray, " np"],
    status: Status,
    information: Float[np.ndarray, "np np"],
) -> Certainty:
    covariance, freedom = known()
    covariance = np.where(bound | bound[:, None], np.nan, covariance)
    errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    if status.code not in ("no_data", "diverged"):
        errors = standard_errors(covariance, information, np.where(bound, 0.0, plant.free))
    named = zip(plant.names, errors, strict=True)
    return Certainty(covariance, freedom, {name: float(error) for name, error in named})


def _covariance(
    plant: Plant, one: Pass, Phi: np.ndarray, left: np.ndarray, use: Any, score: Any, substeps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Of the estimate of least squares, with its degrees of freedom; NaN without an answer."""
    inverse, free = np.asarray(one.solution.inverse[0]), np.asarray(plant.free)
    root = np.sqrt(one.weights[0] * np.asarray(score))
    parts = _counted(root, left), _counted(root[..., None], Phi)
    error, rows = (by_sample(part, use, substeps) for part in parts)
    rows *= np.where(one.bound[0], 0.0, 1.0)  # of what is on its bound no score sums to zero
    scores = np.einsum("sj,sja->sa", error, rows)
    if not (np.all(np.isfinite(scores)) and np.any(inverse)):
        return np.where(np.outer(free, free) > 0, np.nan, 0.0), np.zeros(len(free))
    return long_run(scores, rows, inverse, sample_counts(use, substeps).tolist())


_BRIEF = "filter, transient and instruments are chosen without it"
_STILL = (
    "the outputs ({}) are constant throughout, so that no parameter leaves a trace: excite the "
    "plant, or check which columns are read"
)
_NO_DATA = (
    "no sample is left to score: the record is shorter than the transient, masked, or the plant "
    "stands still throughout. Use a longer record, a shorter `transient`, or more excitation"
)
_MORE = "the index is smallest in pass {} and was still to fall: allow more passes"
_STALLED = (
    "the index is smallest in pass {}, though least squares promises to lower it by {:.0%} more: "
)
_BENT = (
    "the model is far from linear in its parameters there. Start from other nominal values, or "
    "set bounds"
)
_OBSERVED = "the observer does not show what the model lacks. Try other gains"
_DIVERGED = (
    "the model, or its slope with a parameter, is not finite along the record: check units, "
    "nominal values, and functions such as sqrt or log at the measured outputs"
)
_UNTRACED = (
    "no trace in the data of {}: such a change leaves the outputs as they are. Fix one of the "
    "parameters, or excite the plant so that they differ"
)


def bound_notes(plant: Plant, bound: Bool[np.ndarray, " np"]) -> tuple[str, ...]:
    """A sentence for each parameter on a bound.

    Args:
        plant: with the estimate.
        bound: which parameters are on one.
    """
    each = zip(plant.parameters.items(), bound, strict=True)
    return tuple(f"{name} ended on its bound, {value:g}" for (name, value), on in each if on)


def _counted(root: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Weighed, and zero where nothing counts, whatever a regressor without bound has left there."""
    with np.errstate(invalid="ignore"):
        out = root * values
    return out if np.all(np.isfinite(out)) else np.where(root > 0, out, 0.0)


def _stacked(filters: list[DiscreteFilter]) -> DiscreteFilter:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *filters)


def _precision_note() -> list[str]:
    if jnp.result_type(float) == jnp.float64:
        return []
    note = (
        "runs in single precision: differences of a finely sampled record lose most of its "
        "digits. Call `eoi_jax.configure()` first for double precision"
    )
    warnings.warn(note, RuntimeWarning, stacklevel=5)
    return [note]


def _sliding_note(plant: Plant, sliding: np.ndarray) -> tuple[str, ...]:
    low = [name for name, share in zip(plant.outputs, sliding, strict=True) if share < 0.9]
    if not low:
        return ()
    shares = ", ".join(f"{share:.0%}" for share in sliding)
    note = (
        f"in sliding only {shares} of the scored steps ({', '.join(low)}): the injection is not "
        "the model's error while the relay saturates. Raise its gain"
    )
    return (note,)
