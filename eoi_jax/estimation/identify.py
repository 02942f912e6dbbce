r"""The estimator of section 4 of the paper: iterate, and take θ of the smallest index.

Read on in `iteration.py` (the iteration and its stopping rule), then in `kernel.py` (one pass over
a record: observer of section 3, filter, normal equations, index).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check_count
from eoi_jax._display import Result
from eoi_jax._process import one_thread
from eoi_jax._status import NOT_RECORDED, EngineUsed, Status
from eoi_jax.data.clipping import clipped_notes
from eoi_jax.data.deadband import deadband_notes
from eoi_jax.data.holds import SETTINGS as HOLD_SETTINGS
from eoi_jax.data.record import Record
from eoi_jax.data.record_notes import record_notes, same_record_notes
from eoi_jax.data.wrapped_outputs import wrapped_notes
from eoi_jax.estimation.common_factors import CommonFactor, common_factors
from eoi_jax.estimation.covariance import (
    Certainty,
    DeferredCertainty,
    certainty_of_estimate,
    computed,
    least_squares_covariance,
    weighted,
)
from eoi_jax.estimation.defaults import (
    default_observer,
    default_substeps,
    default_transient,
    precision_notes,
    short_record_notes,
)
from eoi_jax.estimation.engines.single import OnePass, single_pass
from eoi_jax.estimation.free_starts import pass_start_notes, settled_starts
from eoi_jax.estimation.hold import decided, geometric_mean
from eoi_jax.estimation.instrumental_variables import (
    InstrumentalEstimate,
    correct_bias,
    refusal,
)
from eoi_jax.estimation.iteration import (
    Iteration,
    IterationHistory,
    iterate,
    mean,
)
from eoi_jax.estimation.kept_signs import without_runaways
from eoi_jax.estimation.kernel import Steps, Sums, Trace
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.outcome import outcome, sliding_notes
from eoi_jax.estimation.parameter_history import (
    ParameterHistory,
    check_forgetting,
    parameter_history,
)
from eoi_jax.estimation.part_estimates import Part, prepared_parts, with_own_drifts
from eoi_jax.estimation.preparation import (
    TAPER,
    PreparedRecords,
    at_samples,
    check_common_samples,
    check_observer,
    check_preparation,
    prepare_records,
    prepare_steps,
)
from eoi_jax.estimation.regression.sample_rows import sample_rows
from eoi_jax.estimation.undersampled import resolved
from eoi_jax.models.check_records import check_records, unit_notes
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class SignalSettings:
    """Up to which number of values signals are stored, and for which samples they are given."""

    # By every pass. They are needed of the first and the best pass only, but a second kernel that
    # stores nothing and a repeated pass take longer.
    max_stored: int = 10_000_000
    max_deferred: int = 4_000_000  # by a result, to compute its covariance when asked
    min_weight: float = 0.5  # share of the filter's memory that must count, at a sample


@dataclass(frozen=True, eq=False, repr=False)
class Identification(Result):
    """The estimate of `identify`, with its iterations and its uncertainty.

    `plot` shows the index of each iteration, and the injection of the first and the best one.

    Attributes:
        parameters: estimate by name.
        index: P of each iteration and output, eq. (14), shape (passes, ny).
        increments: Δθ of each iteration, shape (passes, np); the last one is not applied.
        parameter_history: θ of each iteration, shape (passes, np).
        best_pass: row of `index` whose θ is the estimate, but for `correction`.
        correction: change of the estimate by instrumental variables, shape (np,); zeros where they
            were not used. Least squares minimises P and they do not: their P, that of `injection`,
            is a little larger, and is not a row of `index`.
        plant: with the estimate as parameters.
        nominal: the plant as it was passed to `identify`.
        injection: F[u_eq] at the estimate, one array (N, ny) per record, NaN where not scored.
        first_injection: F[u_eq] of the first iteration.
        residual: F[u_eq] - F[φ] Δθ of the best iteration; F[u_eq] with instrumental variables.
        sliding_fraction: share of scored steps in sliding mode at the estimate, shape (ny,).
        unexplained: rms of `injection` over that of the observed y^(r), shape (ny,).
        status: how it ended.
        observer: as used.
        lowpass: F, as used.
        reasons: why observer, filter, sub-steps, … were chosen, where the caller did not.
        notes: changes to the records, and warnings.
        records: as used (resampled, smoothed), without sub-steps.
        certainty: covariance and standard errors, computed when they are first read.
        information: Σ φᵀφ at the estimate, summed over the weighted outputs, shape (np, np).
        engine: the engine of the passes, and why it was not the fastest.
        common_factors: parameters that no record tells apart, where the estimate leaves some open.
        history: parameters over time, of `recursive=True`.
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
    certainty: Certainty | DeferredCertainty
    information: Float[np.ndarray, "np np"] | None = None
    engine: EngineUsed = NOT_RECORDED
    common_factors: tuple[CommonFactor, ...] = ()
    history: ParameterHistory | None = None

    @property
    def standard_errors(self) -> dict[str, float]:
        """By name, for coloured residuals (`regression/robust_covariance.py`).

        Bias is not included, such as that from noise in the regressors without instrumental
        variables. NaN for a parameter on its bound, at which the others' errors hold; infinite for
        one that the data do not determine, by itself or in a combination; 0 for a fixed one.
        """
        return computed(self.certainty).standard_errors

    @property
    def covariance(self) -> Float[np.ndarray, "np np"]:
        """Of the parameters, shape (np, np)."""
        return computed(self.certainty).covariance

    @property
    def degrees_of_freedom(self) -> Float[np.ndarray, " np"] | None:
        """Of the variance of each parameter, shape (np,)."""
        return computed(self.certainty).degrees_of_freedom


BiasCorrection = Callable[
    [Plant, Iteration, AbstractObserver], tuple[InstrumentalEstimate | None, tuple[str, ...]]
]


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
    recursive: bool = False,
    forgetting: float = 1.0,
    callback: Callable[[int, int, np.ndarray], None] | None = None,
) -> Identification:
    r"""Estimate a plant's parameters from measured records.

    Args:
        plant: the model with its nominal parameters θ_0.
        records: one or several; all enter one estimate.
        observer: with its gains; by default an implicit one, chosen from the records.
        lowpass: F of eq. (19); by default with a cut-off chosen from the records.
        passes: largest number of iterations; fewer where the index no longer falls.
        transient: time at the start of each record that is not scored [s]; by default ten time
            constants of F, or the record's `burn_in` if that is longer.
        substeps: steps per sample, on a quintic spline through the record; by default as many as
            make the step short against the band of F, or, where all outputs are functions of the
            states, against the fastest mode of the internal states; 1 for the explicit form.
        smoothing: cut-off [rad/s] of a zero-phase filter on outputs, and inputs in which the model
            is affine, some times that of `lowpass`; False for none; by default chosen where the
            measurement noise hides the velocity.
        instruments: whether iterations with instrumental variables follow
            (`instrumental_variables.py`), whose estimate is not biased by measurement noise or
            discretisation; False is the paper's method. By default they follow where the records
            are noisy and that noise explains the remaining injection.
        recursive: whether the least squares of the estimate also run recursively, eqs. (12) and
            (13): `history` then has the parameters over time with their standard errors, and says
            which are not constant. The records follow each other in their order.
        forgetting: λ of the recursion, by which the weight of past samples falls with each sample:
            it remembers about 1/(1 - λ) of them. 1: all, so that it ends at the estimate (plus
            the increment of its pass).
        callback: called after each iteration with its number from 1, `passes` and its index (ny,).

    Returns:
        The estimate. Look at `status` first.

    Raises:
        ValueError: arguments or records that do not fit; the message says which and what to do.

    Source:
        Section 4 of the paper; the discretisation is that of the observer.
    """
    checked = check_records(plant, records)
    passes = check_count("passes", passes)
    check_preparation(transient, substeps, smoothing)
    factor = check_forgetting(recursive, forgetting) if recursive or forgetting != 1.0 else None
    if observer is not None:
        check_observer(plant, observer)
    explicit = observer is not None and observer.scheme == "explicit"
    checked, evidence = decided(plant, checked, trial_fit, lowpass)
    measured = *clipped_notes(checked), *deadband_notes(checked), *wrapped_notes(checked, False)

    def prepare(model: Plant) -> PreparedRecords:
        fresh = prepare_records(model, checked, lowpass, smoothing, substeps, explicit)
        reasons = *evidence, *fresh.reasons, *measured, *unit_notes(plant, checked)
        return replace(fresh, reasons=reasons)

    prepared = prepare(plant)
    # The explicit form is the paper's method; in single precision second differences are rounding.
    plain_only = explicit or jnp.result_type(float) != jnp.float64
    plain = plain_only if instruments is None else not instruments

    correction = partial(_correction, plain, bool(instruments), recursive)

    def refit(model: Plant) -> Identification:
        return estimate(
            model, prepared, observer, passes, transient, callback,
            correction(prepared, checked), forgetting=factor,
        )  # fmt: skip

    fit = refit(plant)
    if substeps is None and not explicit and fit.status.fits:
        wanted, _ = default_substeps(fit.plant, prepared.records, prepared.lowpass.cutoff)
        if wanted >= 2 * prepared.substeps:
            prepared = prepare(fit.plant)
            fit = replace(refit(fit.plant), nominal=plant)
    if not fit.status.fits:
        return fit
    fit = without_runaways(plant, fit, refit, lambda result: float(np.log(mean_index(result))))
    if transient is None:
        transient = default_transient(prepared.records, prepared.lowpass, explicit)
    by_parts = partial(_fit_of_parts, fit, prepared, checked, passes, transient, correction)
    return with_own_drifts(fit, transient, by_parts)


def _correction(
    plain: bool,
    requested: bool,
    by_sample: bool,
    prepared: PreparedRecords,
    measured: Sequence[Record],
) -> BiasCorrection | None:
    """That of an estimate from these records; None where it is to stay plain."""

    def correct(plant: Plant, best: Iteration, observer: AbstractObserver) -> tuple:
        return correct_bias(plant, best, measured, prepared, observer, requested, by_sample)

    return None if plain else correct


def _fit_of_parts(
    fit: Identification,
    prepared: PreparedRecords,
    measured: Sequence[Record],
    passes: int,
    transient: float,
    correction: Callable[[PreparedRecords, Sequence[Record]], BiasCorrection | None],
    parts: Sequence[Part],
) -> Identification | None:
    """An estimate like that of all records, from parts of them; None where they are too short."""
    parts = [part for part in parts if part.duration(measured) > 2.0 * transient]
    if not parts:
        return None
    chosen = prepared_parts(prepared, parts)
    unscored = tuple(part.unscored for part in parts)
    cut = tuple(part.cut(measured[part.record]) for part in parts)
    corrected = None if any(unscored) else correction(chosen, cut)
    return estimate(
        fit.plant, chosen, fit.observer, passes, transient, None, corrected, unscored=unscored
    )


def trial_fit(plant: Plant, prepared: PreparedRecords, passes: int) -> Identification:
    """A fit whose index is compared with that of the same plant on records made in another way.

    Where the index still falls in the last of `passes`, as many follow: from a start far off the
    right hold may need more passes than the wrong ones until it is the better one.
    """
    fit = estimate(plant, prepared, passes=passes)
    for _ in range(HOLD_SETTINGS.continuations):
        if not (fit.status.ok and fit.best_pass == passes - 1 and _falling(fit.index)):
            break
        further = estimate(fit.plant, prepared, passes=passes)
        if not (further.status.ok and mean_index(further) < mean_index(fit)):
            break
        fit = further
    return fit


def _falling(index: Float[np.ndarray, "passes ny"]) -> bool:
    """Whether the last pass has lowered the index by more than holds must differ by."""
    share = 1.0 - HOLD_SETTINGS.least_fall
    return len(index) > 1 and geometric_mean(index[-1]) < share * geometric_mean(index[-2])


def mean_index(fit: Identification) -> float:
    """Geometric mean over the outputs of the index of the best pass."""
    return geometric_mean(fit.index[fit.best_pass])


def estimate(
    plant: Plant,
    prepared: PreparedRecords,
    observer: AbstractObserver | None = None,
    passes: int = 10,
    transient: float | None = None,
    callback: Callable[[int, int, np.ndarray], None] | None = None,
    bias_correction: BiasCorrection | None = None,
    settings: SignalSettings = SignalSettings(),
    forgetting: float | None = None,
    course: Plant | None = None,
    z_start: Float[np.ndarray, "records nz _"] | None = None,
    unscored: Sequence[int] = (),
) -> Identification:
    """`identify` on prepared records, which several models of the same outputs may share.

    Args:
        plant: the model with its nominal parameters.
        prepared: the records.
        observer: in the form that the records were prepared for.
        passes: largest number of iterations.
        transient: time at the start of each record that is not scored [s].
        callback: called after each iteration.
        bias_correction: function of the plant with the estimate, its iteration and the observer;
            returns a corrected estimate, or None, and the reasons.
        settings: of the signals that are stored.
        forgetting: λ of the parameters over time; None: without these.
        course: model by which outputs move between the samples; None: `plant`, then the estimate.
        z_start: as of `Steps`. None: free starts are estimated first, as parameters beside those of
            the model.
        unscored: samples at the start of each record that drive the model and are not scored.
    """
    stated = observer
    prepared = prepared.interpolated_by(course or plant)
    lowpass, resampled, explicit = prepared.lowpass, prepared.fine, prepared.explicit
    reasons = prepared.reasons
    if observer is None:
        observer, chosen = default_observer(
            plant, resampled, prepared.inputs, lowpass.cutoff, prepared.substeps
        )
        reasons += chosen
    check_common_samples(plant, resampled, prepared.inputs)
    if transient is None:
        transient = default_transient(prepared.records, lowpass, explicit)
    if z_start is None:
        z_start = settled_starts(
            plant, prepared.fine, passes, lambda model, count, starts: estimate(
                model, prepared, observer, count, transient, course=plant, z_start=starts,
                unscored=unscored).plant,
        )  # fmt: skip
    steps = prepare_steps(
        plant, resampled, prepared.inputs, len(np.atleast_2d(np.asarray(observer.kernel))[0]),
        transient, lowpass.memory, prepared.velocity_noise, explicit, TAPER / lowpass.cutoff,
        substeps=prepared.substeps, z_start=z_start,
    )  # fmt: skip
    for score, count in zip(steps.score, unscored, strict=False):
        score[: count * prepared.substeps] = 0.0
    filters = _stack_filters([lowpass.discretise(record.sample_period) for record in resampled])
    notes = [*record_notes(prepared.records), *same_record_notes(prepared.records)]
    notes += pass_start_notes(plant, prepared.records, z_start)
    notes += short_record_notes(prepared.records, lowpass.cutoff, _NOT_USED_FOR)
    run = single_pass(plant, observer, filters, steps)
    again = course is None and passes > 1 and prepared.follows(plant)
    last_steps = (None, settings, None) if again else (bias_correction, settings, forgetting)
    driver = _Driver(plant, observer, run, steps, prepared.substeps, passes, callback, *last_steps)
    fit = driver.run(prepared.records, lowpass, reasons, (*notes, *precision_notes()))
    if again and fit.status.fits:
        return estimate(plant, prepared, stated, passes, transient, callback, bias_correction,
                        settings, forgetting, fit.plant, unscored=unscored)  # fmt: skip
    return fit


@dataclass
class _Driver:
    """Runs `iterate` for one lane, and makes its result."""

    plant: Plant
    observer: AbstractObserver
    run_one_pass: OnePass
    steps: Steps
    substeps: int
    passes: int
    callback: Callable[[int, int, np.ndarray], None] | None
    bias_correction: BiasCorrection | None
    settings: SignalSettings
    forgetting: float | None

    def run(
        self, records: tuple[Record, ...], lowpass: LowPass, reasons: tuple, notes: tuple
    ) -> Identification:
        history, first_injection, trace = self._iterate(records)
        unclear = history.codes[0] == "unidentifiable"
        factors = common_factors(self.plant) if unclear else ()
        best, status = history.best, outcome(self.plant, history, records, factors)
        theta, increment = best.theta[0], best.increment[0]
        sums, corrected = jax.tree.map(lambda leaf: leaf[0], best.sums), None
        if self.bias_correction is not None and status.ok:
            # Free the memory: the correction takes far longer than repeating the pass.
            trace = None if self._signal_size > self.settings.max_deferred else trace
            corrected, correction_reasons, signals = self._corrected(best)
            reasons += correction_reasons
            if corrected is not None:
                theta, increment = corrected.theta, np.zeros_like(theta)
                sums, trace = signals
        bound = best.bound[0] if corrected is None else corrected.bound
        if trace is None:
            sums, trace = self._pass(theta, "signals")
        residual = np.asarray(trace.injection - trace.Phi @ increment)
        information = np.einsum("j,jab->ab", best.weights[0], sums.information)
        plant = self.plant.with_parameters(theta)
        power, observed_power = (
            mean(total, sums.weight) for total in (sums.square, sums.observed_square)
        )
        sliding = mean(sums.sliding, sums.count)
        completed = slice(int(history.passes[0]))
        certainty = self._make_certainty(best, trace, residual, corrected, status, information)
        over_time = self._over_time(plant, best, trace, corrected, records, certainty, status)
        return Identification(
            parameters=plant.parameters,
            index=history.index[0, completed],
            increments=history.increment[0, completed],
            parameter_history=history.theta[0, completed],
            best_pass=int(history.best_pass[0]),
            correction=theta - best.theta[0],
            plant=plant,
            nominal=self.plant,
            injection=self._per_sample(trace.injection, trace.weight, records),
            first_injection=first_injection,
            residual=self._per_sample(residual, trace.weight, records),
            sliding_fraction=sliding,
            unexplained=np.sqrt(power / np.where(observed_power > 0, observed_power, 1.0)),
            status=resolved(status, self.plant, plant, records),
            observer=self.observer,
            lowpass=lowpass,
            reasons=reasons,
            notes=(*notes, *sliding_notes(plant, sliding), *bound_notes(plant, bound)),
            records=records,
            certainty=certainty,
            information=information,
            engine=self.run_one_pass.used,
            common_factors=factors,
            history=over_time,
        )

    def _corrected(
        self, best: Iteration
    ) -> tuple[InstrumentalEstimate | None, tuple[str, ...], Any]:
        """The corrected estimate or None, the reasons, and sums and signals of a pass at it."""
        assert self.bias_correction is not None
        plant = self.plant.with_parameters(best.theta[0])
        corrected, reasons = self.bias_correction(plant, best, self.observer)
        if corrected is None:
            return None, reasons, None
        sums, trace = self._pass(corrected.theta, "signals")
        refused = refusal(best.index[0], sums, self.plant.outputs)
        return (None, (refused,), None) if refused else (corrected, reasons, (sums, trace))

    def _over_time(
        self,
        plant: Plant,
        best: Iteration,
        trace: Trace,
        corrected: InstrumentalEstimate | None,
        records: tuple[Record, ...],
        certainty: Certainty | DeferredCertainty,
        status: Status,
    ) -> ParameterHistory | None:
        """Parameters over time, if asked for and if there is an estimate."""
        if self.forgetting is None or not status.fits:
            return None
        if corrected is not None:
            rows = corrected.rows
            assert rows is not None
        else:
            steps, order = self.steps, list(range(len(records)))
            root = np.sqrt(best.weights[0] * np.asarray(steps.score))
            estimated = np.where(best.bound[0], 0.0, plant.free)
            error = weighted(root, np.asarray(trace.injection))
            phi = weighted(root[..., None], np.asarray(trace.Phi)) * estimated
            rows = sample_rows(error, phi, None, steps.use, self.substeps, order, [0] * len(order))
        errors = np.asarray(list(computed(certainty).standard_errors.values()))
        return parameter_history(plant, rows, records, errors, self.forgetting)

    def _make_certainty(
        self,
        best: Iteration,
        trace: Trace,
        residual: np.ndarray,
        corrected: InstrumentalEstimate | None,
        status: Status,
        information: np.ndarray,
    ) -> Certainty | DeferredCertainty:
        plant, steps = self.plant, self.steps
        if corrected is None:
            rows = np.asarray(trace.Phi), residual, steps.use, steps.score, self.substeps
            bound = best.bound[0]
            covariance_of = partial(least_squares_covariance, plant, best, *rows)
        else:
            bound = corrected.bound
            covariance_of = partial(tuple, (corrected.covariance, corrected.degrees_of_freedom))
        certainty = DeferredCertainty(
            partial(certainty_of_estimate, plant, covariance_of, bound, status, information)
        )
        # A deferred certainty holds the signals in memory.
        return certainty.value if self._signal_size > self.settings.max_deferred else certainty

    @property
    def _signal_size(self) -> int:
        """Number of values in the signals of a pass."""
        return self.steps.use.size * (2 + len(self.plant.names))

    def _iterate(
        self, records: tuple[Record, ...]
    ) -> tuple[IterationHistory, list[np.ndarray], Trace | None]:
        """All iterations, the injection of the first, and the best one's signals if stored."""
        first_injection: list[np.ndarray] = []
        latest = best_trace = None
        recompute = self._signal_size > self.settings.max_stored

        def run(running: Any, theta: np.ndarray, number: int) -> Sums:
            nonlocal latest
            del running
            latest = None  # frees its memory before the next pass
            sums, latest = self._pass(theta[0], "nothing" if recompute and number else "signals")
            if number == 0:
                first_injection.extend(self._per_sample(latest.injection, latest.weight, records))
            return jax.tree.map(lambda leaf: leaf[None], sums)

        def watch(number: int, index: np.ndarray, lowest: np.ndarray) -> None:
            nonlocal best_trace
            best_trace = latest if lowest[0] else best_trace
            if self.callback is not None:
                self.callback(number + 1, self.passes, index[0])

        start = np.asarray(self.plant.theta, dtype=float)[None]
        return iterate(run, self.plant, start, self.passes, watch), first_injection, best_trace

    def _pass(self, theta: np.ndarray, store: str) -> tuple[Sums, Any]:
        sums, trace = self.run_one_pass(theta, store)
        return jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums), trace

    def _per_sample(
        self, values: Any, weight: Any, records: tuple[Record, ...]
    ) -> list[np.ndarray]:
        """F[m·]/F[m] as (N, ny) per record; NaN where not scored or where F[m] is small."""
        arrays = []
        for i, record in enumerate(records):
            stops = slice(self.substeps - 1, (len(record) - 1) * self.substeps, self.substeps)
            share = np.asarray(weight)[i, stops]
            scored = (np.asarray(self.steps.score)[i, stops] > 0) & (
                share > self.settings.min_weight
            )
            average = np.asarray(values)[i, stops] / np.where(scored, share, 1.0)
            arrays.append(at_samples(self.plant, np.where(scored, average, np.nan)))
        return arrays


_NOT_USED_FOR = "filter, transient and instruments are chosen without it"


def bound_notes(plant: Plant, bound: Bool[np.ndarray, " np"]) -> tuple[str, ...]:
    """One sentence for each parameter on a bound.

    Args:
        plant: with the estimate.
        bound: which parameters are on a bound.
    """
    values = zip(plant.parameters.items(), bound, strict=True)
    return tuple(
        f"{name} ended on its bound, {value:g}"
        for (name, value), is_on_bound in values
        if is_on_bound
    )


def _stack_filters(filters: list[DiscreteFilter]) -> DiscreteFilter:
    return jax.tree.map(lambda *leaves: np.stack(leaves), *filters)
