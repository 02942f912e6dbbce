r"""Output-error refinement: the free run itself is fitted to the measured outputs.

$\min_{\theta, x_1 \dots x_m} \sum_i \sum_k \|y_i[k] - \hat y_i[k; \theta, x_i]\|^2 / \sigma^2$ over
the free parameters and the initial state of every run, $\sigma_j$ the rms residual of output j.
A run is a whole record or a window of one (multiple shooting without continuity): short runs are
easy to fit and forgive what the model lacks, long ones use the most of a model that lacks nothing.

Runs and sensitivities are in `output_error.py`, the solver in `levenberg_marquardt.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.checks import check, check_positive
from eoi_jax.data.record import Record
from eoi_jax.identify import Identification
from eoi_jax.output_error import (
    PROMISE,
    Outcome,
    Problem,
    Span,
    Unknowns,
    guessed_starts,
    problem_of,
    spans_of,
    start_of,
)
from eoi_jax.plants.plant import Plant
from eoi_jax.prepare import check_records
from eoi_jax.refinement import Refinement, Start
from eoi_jax.regression.least_squares import least_squares, untraced
from eoi_jax.results import Status

_ROUNDS = 4  # fits, each weighing the outputs by the residuals of the one before
_SETTLED = 0.02  # relative change of these weights that is none
_BLOCKS = 20  # parts of the records, at least, whose scores count as independent


def refine(
    plant: Plant | Identification,
    records: Record | Sequence[Record],
    *,
    window: float | None = None,
    substeps: int = 4,
    max_steps: int = 50,
) -> Refinement:
    """Refine a plant's parameters by the error of its free runs.

    Args:
        plant: the model with the parameters to start from, or an identification.
        records: one or several; masked samples and a record's burn-in are not scored.
        window: length of each run [s], about: every record is cut into runs of equal length. The
            state is estimated anew at the start of each. None: whole records.
        substeps: steps of the simulation per sample; one does where the sampling is fine.
        max_steps: of the solver, each one simulation with its sensitivities.

    Returns:
        The estimate, never worse than its start on these runs. Look at `status` first. At the
        start of a record internal states are those that the plant declares (a function of its
        parameters, if it says so); at the start of a later window they are estimated.

    Raises:
        ValueError: arguments or records that do not fit the plant, dry friction that cannot be
            simulated.

    Source:
        Output-error method: L. Ljung, *System Identification*, 2nd ed., section 3.2; elimination of
        what enters one block only: Å. Björck, *Numerical Methods for Least Squares Problems*,
        section 6.3; clustered covariance: H. White, Econometrica 48 (1980) 817.
    """
    nominal = plant.plant if isinstance(plant, Identification) else plant
    several = check_records(nominal, records)
    if window is not None:
        check_positive("window", window)
    check(isinstance(max_steps, int) and max_steps >= 1, "max_steps", "must be an integer ≥ 1",
          max_steps)  # fmt: skip
    spans = spans_of(several, window)
    if not any(np.any(span.use) for span in spans):
        return _unanswered(nominal, several, window, Status("no_data", _NO_DATA))
    problem = problem_of(nominal, several, spans, substeps)
    unknowns = Unknowns(
        jnp.asarray(nominal.theta)[np.asarray(problem.free)],
        jnp.asarray(guessed_starts(problem, several, spans, substeps)),
    )
    fit = _fitted(problem, unknowns, max_steps)
    if not np.all(np.isfinite(fit.before)):
        return _unanswered(nominal, several, window, Status("diverged", _DIVERGED))
    return _refinement(fit, several, spans, window)


def _fitted(problem: Problem, unknowns: Unknowns, max_steps: int) -> "_Fit":
    """Fits until the outputs are weighed by their residuals (one output: a single fit).

    Each lowers the sum of squares under weights that were the best ones before: alternating
    minimisation of the likelihood over the unknowns and σ, which never goes up.
    """
    # Imported here: optimistix is heavy, and only a fit needs it.
    from eoi_jax.levenberg_marquardt import solve

    # The first step is only an evaluation, by the code that is compiled for all of them.
    before = _unweighed(problem, solve(problem, unknowns, 1).error)
    one = solve(problem, unknowns, max_steps)
    fit = _Fit(problem, one, before, int(one.steps))
    if problem.y.shape[2] == 1 or not np.all(np.isfinite(fit.before)):
        return fit
    for _ in range(_ROUNDS):
        sigma = _rms(_unweighed(fit.problem, fit.outcome.error), fit.use)
        # An output without any error would weigh infinitely.
        sigma = np.maximum(sigma, 1e-9 * np.max(np.abs(np.asarray(problem.y)), axis=(0, 1)))
        weight = fit.use / np.where(sigma > 0, sigma, 1.0)
        ratio = np.max(weight, axis=(0, 1)) / np.max(np.asarray(fit.problem.weight), axis=(0, 1))
        if np.max(ratio) < (1.0 + _SETTLED) * np.min(ratio):
            break
        new = eqx.tree_at(lambda one: one.weight, problem, jnp.asarray(weight))
        one = solve(new, fit.outcome.unknowns, max_steps)
        fit = _Fit(new, one, fit.before, fit.steps + int(one.steps))
    return fit


@dataclass(frozen=True)
class _Fit:
    """The last fit, and the errors at the very start."""

    problem: Problem
    outcome: Outcome
    before: Float[np.ndarray, "runs time ny"]
    steps: int

    @property
    def use(self) -> Bool[np.ndarray, "runs time ny"]:
        """Which samples are scored."""
        return np.asarray(self.problem.weight) > 0

    @property
    def differentiable(self) -> bool:
        """Whether the free runs have derivatives where the fit ended."""
        return bool(np.all(np.isfinite(np.asarray(self.outcome.columns))))


def _unweighed(problem: Problem, error: Array) -> Float[np.ndarray, "runs time ny"]:
    weight = np.asarray(problem.weight)
    return np.reshape(np.asarray(error), weight.shape) / np.where(weight > 0, weight, 1.0)


def _rms(error: np.ndarray, use: np.ndarray) -> Float[np.ndarray, " ny"]:
    with np.errstate(over="ignore"):
        return np.sqrt(np.sum(error**2, axis=(0, 1)) / np.sum(use, axis=(0, 1)))


# -- the answer -------------------------------------------------------------------------------


def _refinement(
    fit: _Fit, records: Sequence[Record], spans: Sequence[Span], window: float | None
) -> Refinement:
    problem, nominal = fit.problem, fit.problem.plant
    theta = np.array(nominal.theta, dtype=float)
    theta[list(problem.free)] = np.asarray(fit.outcome.unknowns.theta)
    plant = nominal.with_parameters(theta)
    error = _unweighed(problem, fit.outcome.error)
    rmse, before = _rms(error, fit.use), _rms(fit.before, fit.use)
    bound = [name for i, name in enumerate(plant.names) if i in problem.free
             and theta[i] in (plant.lower[i], plant.upper[i])]  # fmt: skip
    covariance, lost = _covariance(fit, plant, bound)
    residual = [np.full(record.outputs.shape, np.nan) for record in records]
    for span, one, keep in zip(spans, error, fit.use, strict=True):
        (index,) = np.nonzero(np.any(keep, axis=1))
        residual[span.record][span.first + index] = one[index]
    errors = np.sqrt(np.diagonal(covariance))
    return Refinement(
        plant.parameters,
        {name: float(one) for name, one in zip(plant.names, errors, strict=True)},
        covariance,
        plant,
        nominal,
        _starts(fit, plant, records, spans),
        rmse,
        before,
        _cost(rmse),
        _cost(before),
        residual,
        fit.steps,
        window,
        _status(fit, lost),
        tuple(f"{name} ended on its bound, {plant.parameters[name]:g}" for name in bound),
    )


def _cost(rmse: np.ndarray) -> float:
    return float(2.0 * np.sum(np.log(np.maximum(rmse, np.finfo(float).tiny))))


def _starts(
    fit: _Fit, plant: Plant, records: Sequence[Record], spans: Sequence[Span]
) -> tuple[Start, ...]:
    theta, starts = jnp.asarray(plant.theta), []
    for i, span in enumerate(spans):
        values, declared = fit.outcome.unknowns.starts[i], fit.problem.declared[i]
        x, record = start_of(plant, theta, values, declared), records[span.record]
        starts.append(
            Start(record.name, float(record.time[span.first]), np.asarray(x.y), np.asarray(x.z))
        )
    return tuple(starts)


def _covariance(
    fit: _Fit, plant: Plant, bound: Sequence[str]
) -> tuple[Float[np.ndarray, "np np"], list[str]]:
    """Sandwich over blocks of samples, and combinations of parameters without a trace.

    NaN where there are no derivatives. The columns of θ are taken beside those of the starts,
    which are estimated too.
    """
    columns, error = np.asarray(fit.outcome.columns), np.asarray(fit.outcome.error)
    if not fit.differentiable:
        return np.full((len(plant.names), len(plant.names)), np.nan), []
    own = columns.shape[2] - len(fit.problem.free)
    names = [plant.names[i] for i in fit.problem.free]
    shared = columns[..., own:] * np.asarray([name not in bound for name in names])
    pieces = -(-_BLOCKS // len(columns))
    information, scores = np.zeros((len(names), len(names))), []
    for starts, theta, one in zip(columns[..., :own], shared, error, strict=True):
        size = np.linalg.norm(starts, axis=0)
        starts = starts / np.where(size > 0, size, 1.0)
        beside = theta - starts @ np.linalg.lstsq(starts, theta, rcond=1e-10)[0]
        information += beside.T @ beside
        scores += [np.sum(part, axis=0) for part in np.array_split(beside * one[:, None], pieces)]
    free = np.asarray([float(name not in bound) for name in names])
    solution = least_squares(jnp.asarray(information), jnp.zeros(len(names)), jnp.asarray(free))
    inverse, scores = np.asarray(solution.inverse), np.stack(scores)
    meat = scores.T @ scores * len(scores) / (len(scores) - 1)
    small = inverse @ meat @ inverse
    small[free == 0] = small[:, free == 0] = np.nan
    covariance = np.zeros((len(plant.names), len(plant.names)))
    covariance[np.ix_(fit.problem.free, fit.problem.free)] = small
    return covariance, untraced(solution, names, free)


def _status(fit: _Fit, lost: Sequence[str]) -> Status:
    outcome, promise = fit.outcome, float(fit.outcome.promise)
    if not fit.differentiable:
        return Status("diverged", _ROUGH)
    if lost:
        return Status("unidentifiable", _UNTRACED.format("; ".join(lost)))
    if promise < PROMISE:
        return Status("converged", f"no step lowers the cost any further, after {fit.steps}")
    if bool(outcome.exhausted):
        return Status("passes_exhausted", _MORE.format(promise))
    return Status("stalled", _STALLED.format(promise))


def _unanswered(
    plant: Plant, records: Sequence[Record], window: float | None, status: Status
) -> Refinement:
    """The starting point, unchanged, and why."""
    size, none = len(plant.names), np.full(len(plant.outputs), np.nan)
    return Refinement(
        plant.parameters, dict.fromkeys(plant.names, np.nan), np.full((size, size), np.nan),
        plant, plant, (), none, none, np.nan, np.nan,
        [np.full(record.outputs.shape, np.nan) for record in records], 0, window, status, (),
    )  # fmt: skip


_NO_DATA = "no sample is left to score: the records are masked, or shorter than their burn-in"
_DIVERGED = (
    "the free run from the starting parameters does not stay finite: start from other parameters, "
    "or fit shorter runs with `window`"
)
_ROUGH = (
    "the free run has derivatives that are not finite where the fit ended: a function of the model "
    "has none there (a root at zero). Keep its parameters off that point with `bounds`"
)
_UNTRACED = (
    "no trace in the outputs of {}: such a change leaves every free run as it is. Fix one of the "
    "parameters, or excite the plant so that they differ"
)
_MORE = "least squares promises to lower the cost by {:.2g} more: allow more `max_steps`"
_STALLED = (
    "no step lowers the cost, though least squares promises {:.2g} of it: the free run is not "
    "smooth in its parameters there (moments of rest that come and go). Fit shorter runs with "
    "`window` if the promise is large"
)
