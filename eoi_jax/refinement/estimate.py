"""From the last fit to what `refine` returns: estimate, covariance, status."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import counted, percent
from eoi_jax._status import FitNote, Status
from eoi_jax.data.clipping import clipped_notes
from eoi_jax.data.deadband import deadband_notes
from eoi_jax.data.masks import hold_advice
from eoi_jax.data.record import Record
from eoi_jax.data.record_notes import biasing_notes, same_record_notes
from eoi_jax.data.windows import restart_notes
from eoi_jax.data.wrapped_outputs import wrapped_notes
from eoi_jax.estimation.common_factors import CommonFactor, common_factors
from eoi_jax.estimation.degrees_of_freedom import freedom_notes
from eoi_jax.estimation.regression.least_squares import least_squares, standard_errors, untraced
from eoi_jax.estimation.regression.orthonormal import orthonormal
from eoi_jax.estimation.regression.robust_covariance import covariance_of_estimate
from eoi_jax.models.check_records import unit_notes
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.fit import Fit, faint_parameters, log_cost, rms
from eoi_jax.refinement.problem import CONVERGED
from eoi_jax.refinement.result import Refinement, Start
from eoi_jax.refinement.spans import FEWEST_STEPS, Span
from eoi_jax.simulation.state_jumps import state_jumps


def refinement_of(
    fit: Fit,
    records: Sequence[Record],
    spans: Sequence[Span],
    window: float | None,
    is_trial: bool = False,
) -> Refinement:
    """What `refine` returns.

    Args:
        fit: the last one.
        records: as given.
        spans: runs on them.
        window: length of the runs [s].
        is_trial: whether nobody asks which common factors leave parameters open.
    """
    problem, nominal = fit.problem, fit.problem.kernel.plant
    theta = problem.completed(fit.outcome.unknowns.theta)
    plant, error = nominal.with_parameters(theta), fit.error
    rmse, rmse_before = rms(error, fit.use), rms(fit.initial_error, fit.use)
    bound = [name for i, name in enumerate(plant.names) if i in problem.free
             and theta[i] in (plant.lower[i], plant.upper[i])]  # fmt: skip
    certainty = _certainty(fit, plant, bound, spans)
    factors = common_factors(nominal) if certainty.lost and not is_trial else ()
    errors = np.sqrt(np.diagonal(certainty.covariance))
    if fit.differentiable:
        within_bounds = np.asarray([float(name not in bound) for name in plant.names]) * plant.free
        errors = standard_errors(certainty.covariance, certainty.information, within_bounds)
    result = Refinement(
        plant.parameters,
        {name: float(value) for name, value in zip(plant.names, errors, strict=True)},
        certainty.covariance,
        plant,
        nominal,
        _starts(fit, plant, records, spans),
        rmse,
        rmse_before,
        log_cost(rmse),
        log_cost(rmse_before),
        _per_sample(error, fit.use, records, spans),
        fit.steps,
        window,
        _status(fit, certainty.lost, factors, () if is_trial else faint_parameters(fit)),
        (
            *(FitNote(_ON_BOUND.format(name, plant.parameters[name])) for name in bound),
            *_unsettled(fit),
            *clipped_notes(records),
            *deadband_notes(records),
            *biasing_notes(records),
            *same_record_notes(records),
            *wrapped_notes(records),
            *unit_notes(nominal, records),
            *_restarts(records, spans),
        ),
        certainty.information,
        certainty.freedom,
        tuple(_per_sample(fit.initial_error, fit.use, records, spans)),
        tuple(records),
        problem.substeps,
        problem.engine,
        factors,
    )
    of_errors = (FitNote(note) for note in freedom_notes(result))
    return replace(result, notes=(*of_errors, *result.notes))


def compared_with(
    result: Refinement,
    nominal: Plant,
    error: Float[np.ndarray, "runs time ny"],
    use: Bool[np.ndarray, "runs time ny"],
    spans: Sequence[Span],
) -> Refinement:
    """A result compared with another starting point.

    Args:
        result: of the last of several fits.
        nominal: where the first of them began.
        error: y - ŷ of the runs there; not finite where they diverge.
        use: which samples are scored.
        spans: the runs.
    """
    before = np.nan_to_num(rms(error, use), nan=np.inf, posinf=np.inf)
    residual = tuple(_per_sample(error, use, result.records, spans))
    return replace(
        result,
        nominal=nominal,
        before=before,
        cost_before=log_cost(before),
        residual_before=residual,
    )


def with_steps(result: Refinement, steps: int) -> Refinement:
    """A result with the steps of fits before it counted."""
    total = result.steps + steps
    converged = result.status.code == "converged"
    return replace(result, steps=total, status=_converged(total) if converged else result.status)


def _converged(steps: int) -> Status:
    of_all = counted(steps, "step")
    return Status("converged", f"no step lowers the cost any further, after {of_all} in all")


def _unsettled(fit: Fit) -> tuple[str, ...]:
    if not fit.unsettled > 0 or not np.isfinite(fit.unsettled):
        return ()
    change = f"{percent(fit.unsettled)} after {counted(fit.fits, 'fit')}"
    return (FitNote(_UNSETTLED.format(change)),)


def notes_on_runs(result: Refinement) -> tuple[str, ...]:
    """Notes that hold for its runs whatever the parameters are: not of bounds and weights."""
    return tuple(note for note in result.notes if not isinstance(note, FitNote))


def _restarts(records: Sequence[Record], spans: Sequence[Span]) -> list[str]:
    """Notes on runs that start again after gaps in the inputs."""
    notes = []
    for i, record in enumerate(records):
        starts = {span.segment for span in spans if span.record == i}
        notes += restart_notes(record, len(starts), FEWEST_STEPS + 1)
    return notes


def _per_sample(
    error: np.ndarray, use: np.ndarray, records: Sequence[Record], spans: Sequence[Span]
) -> list[np.ndarray]:
    """One array for each record, NaN where not scored."""
    residuals = [np.full(record.outputs.shape, np.nan) for record in records]
    for span, run_error, keep in zip(spans, error, use, strict=True):
        (index,) = np.nonzero(np.any(keep, axis=1))
        scored = np.where(keep[index], run_error[index], np.nan)
        residuals[span.record][span.first + index] = scored
    return residuals


def _starts(
    fit: Fit, plant: Plant, records: Sequence[Record], spans: Sequence[Span]
) -> tuple[Start, ...]:
    unknowns, theta = fit.outcome.unknowns, np.asarray(plant.theta)
    x = fit.problem.kernel.started(unknowns.starts, theta, fit.problem.declared)
    past: Sequence[np.ndarray | None] = [None] * len(spans)
    if fit.problem.places is not None:
        past = list(np.asarray(unknowns.starts)[:, -len(plant.inputs) :])
    return tuple(
        Start(records[span.record].name, float(records[span.record].time[span.first]), y, z, levels)
        for span, y, z, levels in zip(spans, x.y, x.z, past, strict=True)
    )


@dataclass(frozen=True)
class _Certainty:
    """How well the fit knows its parameters.

    Attributes:
        covariance: shape (np, np); NaN where there are no derivatives, or on a bound.
        information: beside that of the initial states, which are estimated too; (np, np).
        freedom: degrees of freedom of each variance, shape (np,).
        lost: combinations of parameters without a trace.
    """

    covariance: Float[np.ndarray, "np np"]
    information: Float[np.ndarray, "np np"]
    freedom: Float[np.ndarray, " np"]
    lost: list[str]


def _certainty(fit: Fit, plant: Plant, bound: Sequence[str], spans: Sequence[Span]) -> _Certainty:
    """Sandwich of the information and the long-run covariance of the scores."""
    size, free = len(plant.names), list(fit.problem.free)
    covariance, information = np.zeros((size, size)), np.zeros((size, size))
    freedom = np.full(size, np.inf)
    if not fit.differentiable:
        covariance[np.ix_(free, free)] = np.nan
        return _Certainty(covariance, information, freedom, [])
    names = [plant.names[i] for i in free]
    loose = np.asarray([float(name not in bound) for name in names])
    start_size = fit.sensitivities.shape[-1] - 1 - len(free)
    rows, scores, sizes = zip(
        *(
            _run_scores(run[: span.count + 1], start_size, float(fit.problem.threshold))
            for run, span in zip(fit.sensitivities, spans, strict=True)
        ),
        strict=True,
    )
    # Windows of one record are its parts, and no independent ones.
    lengths = np.bincount([run.record for run in spans], [len(run) for run in scores]).astype(int)
    rows, scores = np.concatenate(rows) * loose, np.concatenate(scores) * loose
    flat = rows.reshape(-1, len(names))
    square = flat.T @ flat
    solution = least_squares(square, np.zeros(len(names)), loose)
    small, small_freedom = covariance_of_estimate(
        scores,
        rows,
        np.asarray(solution.inverse),
        lengths.tolist(),
        _residuals(fit),
        sum(sizes) + int(np.sum(loose)),
    )
    freedom[free] = small_freedom
    small[loose == 0] = small[:, loose == 0] = np.nan
    covariance[np.ix_(free, free)], information[np.ix_(free, free)] = small, square
    return _Certainty(covariance, information, freedom, untraced(solution, names, loose))


def _residuals(fit: Fit) -> list[np.ndarray]:
    """Residual of each output of each run, (samples,), over its rms; NaN where not scored."""
    scaled = np.where(fit.use, fit.error / np.maximum(rms(fit.error, fit.use), 1e-300), np.nan)
    return [run[:, j] for run in scaled for j in range(run.shape[1])]


def _run_scores(
    sensitivities: Float[np.ndarray, "time ny size"], start_size: int, threshold: float
) -> tuple[Float[np.ndarray, "time ny free"], Float[np.ndarray, "time free"], int]:
    """Rows and scores of one run, in what its initial state leaves of the columns of θ.

    Beside them the number of initial values that were fitted.
    """
    rows = sensitivities.reshape(-1, sensitivities.shape[-1])
    starts, theta, error = rows[:, :start_size], rows[:, start_size:-1], rows[:, -1]
    own_space = orthonormal(starts, 1e-10)
    projected = theta - own_space @ (own_space.T @ theta)
    inliers = projected * (np.abs(error) <= threshold)[:, None]
    score = projected * np.clip(error, -threshold, threshold)[:, None]
    shape = *sensitivities.shape[:2], projected.shape[1]
    return inliers.reshape(shape), np.sum(score.reshape(shape), axis=1), own_space.shape[1]


def _status(
    fit: Fit, lost: Sequence[str], factors: Sequence[CommonFactor], faint: Sequence[str]
) -> Status:
    outcome, predicted_reduction = fit.outcome, float(fit.outcome.predicted_reduction)
    if not fit.differentiable:
        return Status("diverged", _ROUGH)
    if lost:
        sentences = [factor.sentence for factor in factors]
        if len(lost) > sum(len(factor.fix) for factor in factors):
            sentences.append(_UNTRACED.format("; ".join(lost)))
        return Status("unidentifiable", ". ".join(sentences))
    if faint:
        theta = fit.problem.completed(outcome.unknowns.theta)
        plant = fit.problem.kernel.plant.with_parameters(theta)
        values = ", ".join(f"{name} near {plant.parameters[name]:.3g}" for name in faint)
        return Status("unidentifiable", _FAINT.format(values))
    if predicted_reduction < CONVERGED:
        return _converged(fit.steps)
    if bool(outcome.exhausted):
        return Status("passes_exhausted", _MORE_STEPS.format(predicted_reduction))
    plant = fit.problem.kernel.plant
    cause = _KINKS if np.any(plant.jumps) or state_jumps(plant) else _FAR_FROM_LINEAR
    return Status("stalled", _STALLED.format(predicted_reduction) + cause)


def unanswered(
    plant: Plant, records: Sequence[Record], window: float | None, status: Status
) -> Refinement:
    """The starting point, unchanged, and why."""
    size, unknown = len(plant.names), np.full(len(plant.outputs), np.nan)
    return Refinement(
        plant.parameters, dict.fromkeys(plant.names, np.nan), np.full((size, size), np.nan),
        plant, plant, (), unknown, unknown, np.nan, np.nan,
        [np.full(record.outputs.shape, np.nan) for record in records], 0, window, status, (),
    )  # fmt: skip


_ON_BOUND = "{} ended on its bound, {:g}"
_UNSETTLED = "the weights of the outputs still changed by {}; refine again from here"


def no_data(records: Sequence[Record]) -> str:
    """Why nothing can be scored, and what to do."""
    advice = hold_advice(records)
    return f"{_NO_DATA}. {advice}" if advice else _NO_DATA


_NO_DATA = "no sample is left to score: the records are masked, or shorter than their burn-in"
DIVERGED = (
    "the free run from the starting parameters does not stay finite: start from other parameters "
    "(`starts = 200` tries so many around them), or fit shorter runs with `window`. A power with a "
    "fraction, x**0.7, is no number below zero: of a state that reaches zero write max(x, 0)**0.7"
)
ALL_DIVERGED = (
    "no free run stays finite, neither from the starting parameters nor from the {} other starts: "
    "fit shorter runs with `window`, or start nearer to what the plant does"
)
_ROUGH = (
    "the free run has no derivatives where the fit ended: a function of the model has none there "
    "(an arcsine at one), or the steps are too long for what is fast in it, so that the last digit "
    "of a parameter decides. Keep its parameters off there with `bounds`, or ask for more "
    "`substeps`"
)
_UNTRACED = (
    "no trace in the outputs of {}: such a change leaves every free run as it is. Fix one of the "
    "parameters, or excite the plant so that they differ"
)
_FAINT = (
    "next to no trace in the outputs of {}: the fit cannot tell where it belongs. A mode faster "
    "than the sampling hides what sets it: start from the estimate of `identify`, or from many "
    "points (`starts = 200`), or fix the parameter"
)
_MORE_STEPS = "least squares promises to lower the cost by {:.2g} more: allow more `max_steps`"
_STALLED = "no step lowers the cost, though least squares promises {:.2g} of it: "
_KINKS = (
    "the free run is not smooth in its parameters there (moments of rest that come and go, limits "
    "just met or just missed). Fit shorter runs with `window` if the promise is large"
)
_FAR_FROM_LINEAR = (
    "the free run is far from linear in its parameters there, and the minimum may not be the "
    "lowest one. Start from the estimate of `identify`, or from many points (`starts = 200`), or "
    "fit shorter runs with `window`"
)
