r"""Output-error refinement: the free run itself is fitted to the measured outputs.

$\min_{\theta, x_1 \dots x_m} \sum_i \sum_k \|y_i[k] - \hat y_i[k; \theta, x_i]\|^2 / \sigma^2$ over
the free parameters and the initial state of every run, $\sigma_j$ the rms residual of output j.
A run is a whole record or a window of one (multiple shooting without continuity): short runs are
easy to fit and forgive what the model lacks, long ones use the most of a model that lacks nothing.

Runs and sensitivities are in `problem.py`, the solver in `levenberg_marquardt.py`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._blas import one_thread
from eoi_jax._checks import check, check_count, check_positive
from eoi_jax._status import Status
from eoi_jax.compiler.programs import jit
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.regression.least_squares import least_squares, standard_errors, untraced
from eoi_jax.estimation.regression.orthonormal import orthonormal
from eoi_jax.estimation.regression.robust_covariance import long_run
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant, State
from eoi_jax.refinement.levenberg_marquardt import solve
from eoi_jax.refinement.multistart import best, points_of
from eoi_jax.refinement.problem import (
    CONVERGED,
    Outcome,
    Problem,
    Span,
    Unknowns,
    beginning,
    guessed_starts,
    ill_conditioned,
    problem_of,
    signals,
    spans_of,
    used_window,
    weighed,
)
from eoi_jax.refinement.result import Refinement, Start
from eoi_jax.simulation.sensitivity import Host, RunKernel

_ROUNDS = 4  # fits, each weighing the outputs by the residuals of the one before
_SETTLED = 0.02  # relative change of these weights that is none
_COARSE, _FINEST = 4, 32  # steps of the simulation per sample, where none are asked for
_SUFFERS = 1e-3  # relative rise of the cost
_LONGER, _NEGLIGIBLE = 4, 0.1  # times the step; largest error of such steps, over the residual
# Share of the cost that least squares promises where the solver stalls, from which on it is looked
# for; points and rounds of that search.
_PROMISED, _POINTS, _SEARCH_ROUNDS = 0.01, 64, 4
_SHARES = (0.125, 0.25, 0.5)  # of the runs, that are fitted before the whole ones
# Mean square of the errors in the first of these shares, over that of the whole runs, below which
# errors grow in a run. Set with measured records in view: 1.3 in a stall at kinks of dry friction
# (emps), 0.01 and far less in wrong minima of pendulums and of an oscillator.
_GROWING = 0.3


@one_thread()
def refine(
    plant: Plant | Identification,
    records: Record | Sequence[Record],
    *,
    window: float | None = None,
    substeps: int | None = None,
    max_steps: int = 50,
    starts: Any = None,
    rounds: int = 1,
    huber: float | None = None,
    callback: Callable[[int, int], None] | None = None,
) -> Refinement:
    """Refine a plant's parameters by the error of its free runs.

    Args:
        plant: the model with the parameters to start from, or an identification.
        records: one or several; masked samples and a record's burn-in are not scored.
        window: length of each run [s], about: every record is cut into runs of equal length, of a
            few samples at least; the answer has the length that was used. The state is estimated
            anew at the start of each. None: whole records.
        substeps: steps of the simulation per sample; one does where the sampling is fine. None:
            four, more where the plant is too fast for them, and twice as many as long as their
            error would show in the estimate and the fit does not suffer.
        max_steps: of the solver in each fit, each one simulation with its sensitivities.
        starts: further points to start from, run side by side: dicts of parameters, rows
            (starts, np), or how many are drawn around the plant's values: each times a factor of
            1/8 to 8, of either sign where the bounds allow it. All get a few steps, the better
            ones more, the best one the rest; the answer is never worse than without them. None:
            the plant's values. If the solver stalls from there, or has used up its steps and least
            squares promises a hundredth of the cost or more, and errors grow in the runs, it begins
            again: their first eighth is fitted, then a quarter and a half of them. Where it then
            stalls and least squares still promises so much, four rounds of 64 points around follow.
        rounds: how often so many points are followed. From the second time on they are drawn
            around the best one so far: some parameters anew, the others moved a little, each by
            itself or along what the records hardly tell. Where that stands still for five rounds
            the search begins anew; the last fifth of the rounds is again the best one's. For models
            of several parts (a start far off in all of them needs a hundred) and rugged costs.
        huber: errors beyond so many standard deviations count by their size, not by its square,
            so that outliers do not rule (1.345 costs 5 % of the efficiency where there are none);
            the standard deviation is then 1.4826 times the median of the sizes. None: squares.
        callback: called with the number of the solver's steps done and `max_steps`, from 0 again
            where weights or steps are settled anew; the solver is compiled with it.

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
        section 6.3; loss: P. J. Huber, *Robust Statistics*, section 7.8; covariance:
        `estimation/regression/robust_covariance.py`.
    """
    nominal = plant.plant if isinstance(plant, Identification) else plant
    records = check_records(nominal, records)
    if window is not None:
        check_positive("window", window)
    max_steps = check_count("max_steps", max_steps)
    if huber is not None:
        check_positive("huber", huber)
    points = points_of(nominal, starts)
    rounds = check_count("rounds", rounds)
    check(rounds == 1 or len(points) > 0, "rounds", "must be 1 without `starts`", rounds,
          "Say how many points each round draws, for example `starts=200`.")  # fmt: skip
    spans = spans_of(records, window)
    window = used_window(records, spans, window)
    if not any(np.any(span.use) for span in spans):
        return _unanswered(nominal, records, window, Status("no_data", _NO_DATA))
    problem, unknowns, sensitivities = _begun(nominal, records, spans, substeps)
    initial_error = _unweighed(problem, sensitivities)
    begun = [(unknowns, sensitivities)] if np.all(np.isfinite(initial_error)) else []
    effort = _Effort(max_steps, _watch(callback, max_steps))
    if len(points):
        rough = _rougher(problem, records, spans, unknowns, initial_error)
        further = best(problem, rough, unknowns, points, rounds)
        begun += [(point, signals(point, problem)) for point in further]
    fits = [_fitted(problem, *start, initial_error, effort, huber) for start in begun]
    if not fits:
        reason = _DIVERGED if starts is None else _ALL_DIVERGED.format(len(points))
        return _unanswered(nominal, records, window, Status("diverged", reason))
    if starts is None:
        fits = [_grown(fits[0], begun[0][0], effort, huber)]
    if substeps is None:
        fits = [_finer(fit, records, spans, effort, huber) for fit in fits]
    if starts is None:
        fits += _search_around(fits[0], records, spans, effort, huber)
    fit = _lowest(fits, huber)
    return _refinement(fit, records, spans, window)


def _begun(
    nominal: Plant, records: Sequence[Record], spans: Sequence[Span], substeps: int | None
) -> tuple[Problem, Unknowns, Float[np.ndarray, "runs time ny size"]]:
    """The free runs at the plant's own values, and their signals.

    Where no number of steps is asked for, so few that these runs have derivatives.
    """
    first, count = None, _COARSE if substeps is None else substeps
    while True:
        problem = problem_of(nominal, records, spans, count)
        unknowns = Unknowns(
            np.asarray(nominal.theta)[list(problem.free)],
            guessed_starts(problem, records, spans),
        )
        sensitivities = signals(unknowns, problem)
        candidate = problem, unknowns, sensitivities
        first, count = first or candidate, 2 * count
        if _smooth(problem, unknowns, sensitivities):
            return candidate
        if substeps is not None or count > _FINEST:
            return first


@dataclass(frozen=True)
class _Effort:
    """How many steps the solver may take, and who is told of them."""

    max_steps: int
    watch: Callable[[Any, Any], None] | None


def _watch(
    callback: Callable[[int, int], None] | None, max_steps: int
) -> Callable[[Any, Any], None] | None:
    if callback is None:
        return None
    report = callback
    return lambda number, _: report(int(number), max_steps)


def _fitted(
    problem: Problem,
    unknowns: Unknowns,
    sensitivities: Float[np.ndarray, "runs time ny size"],
    initial_error: Float[np.ndarray, "runs time ny"],
    effort: _Effort,
    huber: float | None,
) -> "_Fit":
    """Fits until the outputs are weighed by their residuals (one output: a single fit).

    Each lowers the cost under weights that were the best ones before: for squares, alternating
    minimisation of the likelihood over the unknowns and σ, which never goes up.
    """
    steps = 0
    for _ in range(1 + _ROUNDS):
        outcome, sensitivities = solve(
            problem, unknowns, sensitivities, effort.max_steps, effort.watch
        )
        if effort.watch is not None:
            jax.effects_barrier()  # all progress is reported before the next fit
        unknowns, steps = outcome.unknowns, steps + int(outcome.steps)
        fit = _Fit(problem, sensitivities, initial_error, outcome, steps)
        # An output without any error would weigh infinitely.
        sigma = np.maximum(fit.sigma(huber), 1e-9 * np.max(np.abs(problem.y), axis=(0, 1)))
        ratio = np.where(sigma > 0, sigma, 1.0) * np.asarray(problem.scale)
        # Squares know no scale: only the ratios of the outputs count.
        extremes = (np.max(ratio), np.min(ratio) if huber is None else 1.0)
        if max(extremes) < (1.0 + _SETTLED) * min(extremes):
            break
        reweighed = weighed(problem, sigma, np.inf if huber is None else huber)
        problem, sensitivities = (
            reweighed,
            sensitivities * np.asarray(reweighed.scale / problem.scale)[:, None],
        )
    else:
        fit = replace(fit, unsettled=float(max(extremes) / min(extremes) - 1.0))
    return fit


def _rougher(
    problem: Problem,
    records: Sequence[Record],
    spans: Sequence[Span],
    unknowns: Unknowns,
    initial_error: Float[np.ndarray, "runs time ny"],
) -> Problem:
    """Longer steps, by which most starts are sorted out, if their error hardly shows at the first.

    Itself where they do not do, or the first start, whose errors are `initial_error`, diverges.
    """
    if problem.substeps == 1 or not np.all(np.isfinite(initial_error)):
        return problem
    substeps = max(problem.substeps // _LONGER, 1)
    rough = _stepped(problem, records, spans, substeps)
    sensitivities = signals(unknowns, rough)
    negligible = _rms(
        _unweighed(rough, sensitivities) - initial_error, problem.use
    ) <= _NEGLIGIBLE * _rms(initial_error, problem.use)
    return rough if np.all(negligible) and _smooth(rough, unknowns, sensitivities) else problem


def _stepped(
    problem: Problem, records: Sequence[Record], spans: Sequence[Span], substeps: int
) -> Problem:
    """The same runs and weights with other steps."""
    stepped = problem_of(problem.kernel.plant, records, spans, substeps)
    return weighed(stepped, 1.0 / np.asarray(problem.scale), float(problem.threshold))


def _lowest(fits: Sequence["_Fit"], huber: float | None) -> "_Fit":
    """That of the lowest cost, among those that have derivatives where there are any."""
    return min(fits, key=lambda fit: (not fit.differentiable, _cost(fit.sigma(huber))))


def _grown(fit: "_Fit", unknowns: Unknowns, effort: _Effort, huber: float | None) -> "_Fit":
    """A fit that missed, of runs in which errors grow: anew, from their beginnings on.

    It stalled, or used up its steps where least squares still promises much. In a chaotic run (a
    pendulum that turns over) small errors of the start grow without end: the cost of a long run is
    then full of minima beside the best one, and that of its beginning is not. Each fit begins where
    the one of half the length ended, in the same valley (H. Voss, J. Timmer, J. Kurths, Int. J.
    Bifurcation and Chaos 14 (2004) 1905, on these minima).

    Args:
        fit: of the whole runs.
        unknowns: where it began.
        effort: for each fit.
        huber: as of `refine`.

    Returns:
        The better one; with the steps of all.
    """
    predicted_reduction, steps = float(fit.outcome.predicted_reduction), fit.steps
    threshold = _PROMISED if bool(fit.outcome.exhausted) else CONVERGED
    if predicted_reduction < threshold or not fit.differentiable or not _growing(fit):
        return fit
    for share in (*_SHARES, 1.0):
        problem = fit.problem if share == 1.0 else beginning(fit.problem, share)
        sensitivities = signals(unknowns, problem)
        if not _smooth(problem, unknowns, sensitivities):
            return replace(fit, steps=steps)
        grown = _fitted(problem, unknowns, sensitivities, fit.initial_error, effort, huber)
        unknowns, steps = grown.outcome.unknowns, steps + grown.steps
    better = _lowest([fit, grown], huber)
    return replace(better, steps=steps)


def _growing(fit: "_Fit") -> bool:
    """Whether errors are small at the beginning of the runs and grow in them."""
    error, use = fit.sensitivities[..., -1], fit.use
    lengths = (np.asarray(fit.problem.counts) - 1) / fit.problem.substeps
    first = (np.arange(use.shape[1]) <= _SHARES[0] * lengths[:, None])[..., None] & use
    beginning, overall = (
        np.sum(np.where(part, error, 0.0) ** 2) / max(np.sum(part), 1) for part in (first, use)
    )
    return bool(beginning < _GROWING * overall)


def _search_around(
    fit: "_Fit",
    records: Sequence[Record],
    spans: Sequence[Span],
    effort: _Effort,
    huber: float | None,
) -> list["_Fit"]:
    """From points around a fit that stalled at a kink, far above what least squares promises."""
    outcome, problem = fit.outcome, fit.problem
    if (
        float(outcome.predicted_reduction) < _PROMISED
        or bool(outcome.exhausted)
        or not fit.differentiable
    ):
        return []
    theta = problem.completed(outcome.unknowns.theta)
    points = points_of(problem.kernel.plant.with_parameters(theta), _POINTS)
    rough = _rougher(problem, records, spans, outcome.unknowns, fit.error)
    starts = best(problem, rough, outcome.unknowns, points, _SEARCH_ROUNDS)
    fits = [
        _fitted(problem, start, signals(start, problem), fit.initial_error, effort, huber)
        for start in starts
    ]
    return [replace(start, steps=fit.steps + start.steps) for start in fits]


def _finer(
    fit: "_Fit",
    records: Sequence[Record],
    spans: Sequence[Span],
    effort: _Effort,
    huber: float | None,
) -> "_Fit":
    r"""Half the step, as long as its error shows in the estimate.

    An error e of the simulation moves θ, in units of its standard error, by up to
    $\sqrt{N}\,\mathrm{rms}(e) / \mathrm{rms}(r)$: noise averages out over N samples, e does not.
    Records that were simulated with coarse steps themselves fit worse with finer ones.
    """
    while fit.differentiable and fit.problem.substeps < _FINEST:
        old, unknowns = fit.problem, fit.outcome.unknowns
        problem = _stepped(old, records, spans, 2 * old.substeps)
        sensitivities = signals(unknowns, problem)
        step_error = _unweighed(problem, sensitivities) - fit.error
        count, rms = np.sqrt(np.sum(fit.use, axis=(0, 1))), _rms(fit.error, fit.use)
        if np.all(count * _rms(step_error, fit.use) <= rms):
            break
        finer = _fitted(problem, unknowns, sensitivities, fit.initial_error, effort, huber)
        suffers = _cost(_rms(finer.error, fit.use)) > _cost(rms) + _SUFFERS
        if suffers or not finer.differentiable:
            break
        fit = replace(finer, steps=fit.steps + finer.steps)
    return fit


@dataclass(frozen=True)
class _Fit:
    """The last fit.

    Attributes:
        problem: with the weights of this fit.
        sensitivities: `signals` where it ended.
        initial_error: errors at the very start.
        outcome: of the solver.
        steps: of all fits.
        unsettled: relative change of the weights of the outputs that was left.
    """

    problem: Problem
    sensitivities: Float[np.ndarray, "runs time ny size"]
    initial_error: Float[np.ndarray, "runs time ny"]
    outcome: Outcome
    steps: int
    unsettled: float = 0.0

    @property
    def use(self) -> Bool[np.ndarray, "runs time ny"]:
        """Which samples are scored."""
        return self.problem.use

    @property
    def error(self) -> Float[np.ndarray, "runs time ny"]:
        """y - ŷ; zero where not scored."""
        return _unweighed(self.problem, self.sensitivities)

    def sigma(self, huber: float | None) -> Float[np.ndarray, " ny"]:
        """Standard deviation of each output's errors, of which those few beyond `huber` are not."""
        return (_rms if huber is None else _typical)(self.error, self.use)

    @cached_property
    def differentiable(self) -> bool:
        """Whether the free runs have derivatives to speak of where the fit ended."""
        return _smooth(self.problem, self.outcome.unknowns, self.sensitivities)


def _smooth(problem: Problem, unknowns: Unknowns, sensitivities: np.ndarray) -> bool:
    """Whether free runs have derivatives to speak of; `sensitivities` are their signals."""
    if not np.all(np.isfinite(sensitivities)):
        return False
    theta = np.asarray(unknowns.theta)
    with np.errstate(over="ignore"):
        sums = np.einsum("rtjc,rtjc->rc", sensitivities, sensitivities)
    return not np.any(ill_conditioned(sums[:, -1 - len(theta) :], theta, problem.power))


def _unweighed(problem: Problem, sensitivities: np.ndarray) -> Float[np.ndarray, "runs time ny"]:
    return sensitivities[..., -1] / np.asarray(problem.scale)


def _rms(error: np.ndarray, use: np.ndarray) -> Float[np.ndarray, " ny"]:
    with np.errstate(over="ignore"):
        return np.sqrt(np.sum(error**2, axis=(0, 1)) / np.sum(use, axis=(0, 1)))


def _typical(error: np.ndarray, use: np.ndarray) -> Float[np.ndarray, " ny"]:
    """σ of normal errors with this median size: outliers hardly move it."""
    sizes = np.where(use, np.abs(error), np.nan)
    return 1.4826 * np.nanmedian(sizes, axis=(0, 1))


# -- the answer -------------------------------------------------------------------------------


def _refinement(
    fit: _Fit, records: Sequence[Record], spans: Sequence[Span], window: float | None
) -> Refinement:
    problem, nominal = fit.problem, fit.problem.kernel.plant
    theta = problem.completed(fit.outcome.unknowns.theta)
    plant, error = nominal.with_parameters(theta), fit.error
    rmse, rmse_before = _rms(error, fit.use), _rms(fit.initial_error, fit.use)
    bound = [name for i, name in enumerate(plant.names) if i in problem.free
             and theta[i] in (plant.lower[i], plant.upper[i])]  # fmt: skip
    certainty = _certainty(fit, plant, bound, spans)
    errors = np.sqrt(np.diagonal(certainty.covariance))
    if fit.differentiable:
        within_bounds = np.asarray([float(name not in bound) for name in plant.names]) * plant.free
        errors = standard_errors(certainty.covariance, certainty.information, within_bounds)
    return Refinement(
        plant.parameters,
        {name: float(value) for name, value in zip(plant.names, errors, strict=True)},
        certainty.covariance,
        plant,
        nominal,
        _starts(fit, plant, records, spans),
        rmse,
        rmse_before,
        _cost(rmse),
        _cost(rmse_before),
        _per_sample(error, fit.use, records, spans),
        fit.steps,
        window,
        _status(fit, certainty.lost),
        (
            *(f"{name} ended on its bound, {plant.parameters[name]:g}" for name in bound),
            *_unsettled(fit),
        ),
        certainty.information,
        certainty.freedom,
        tuple(_per_sample(fit.initial_error, fit.use, records, spans)),
        tuple(records),
        problem.substeps,
        problem.engine,
    )


def _unsettled(fit: _Fit) -> tuple[str, ...]:
    if not fit.unsettled > 0 or not np.isfinite(fit.unsettled):
        return ()
    change = f"{100 * fit.unsettled:.2g} % after {1 + _ROUNDS} fits"
    return (f"the weights of the outputs still changed by {change}; refine again from here",)


def _per_sample(
    error: np.ndarray, use: np.ndarray, records: Sequence[Record], spans: Sequence[Span]
) -> list[np.ndarray]:
    """One array for each record, NaN where not scored."""
    residuals = [np.full(record.outputs.shape, np.nan) for record in records]
    for span, run_error, keep in zip(spans, error, use, strict=True):
        (index,) = np.nonzero(np.any(keep, axis=1))
        residuals[span.record][span.first + index] = run_error[index]
    return residuals


def _cost(rmse: np.ndarray) -> float:
    return float(2.0 * np.sum(np.log(np.maximum(rmse, np.finfo(float).tiny))))


def _starts(
    fit: _Fit, plant: Plant, records: Sequence[Record], spans: Sequence[Span]
) -> tuple[Start, ...]:
    unknowns, theta = fit.outcome.unknowns, np.asarray(plant.theta)
    x = _started(fit.problem.kernel, unknowns.starts, theta, fit.problem.declared)
    x = jax.tree.map(np.asarray, x)
    return tuple(
        Start(records[span.record].name, float(records[span.record].time[span.first]), y, z)
        for span, y, z in zip(spans, x.y, x.z, strict=True)
    )


@jit(static=())
def _started(kernel: RunKernel, starts: Host, theta: Host, declared: Host) -> State:
    """The states of all windows in one call."""
    return jax.vmap(kernel.start, in_axes=(0, None, 0))(starts, theta, declared)


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


def _certainty(fit: _Fit, plant: Plant, bound: Sequence[str], spans: Sequence[Span]) -> _Certainty:
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
    rows, scores = zip(
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
    small, small_freedom = long_run(scores, rows, np.asarray(solution.inverse), lengths.tolist())
    freedom[free] = small_freedom
    small[loose == 0] = small[:, loose == 0] = np.nan
    covariance[np.ix_(free, free)], information[np.ix_(free, free)] = small, square
    return _Certainty(covariance, information, freedom, untraced(solution, names, loose))


def _run_scores(
    sensitivities: Float[np.ndarray, "time ny size"], start_size: int, threshold: float
) -> tuple[Float[np.ndarray, "time ny free"], Float[np.ndarray, "time free"]]:
    """Rows and scores of one run, in what its initial state leaves of the columns of θ."""
    rows = sensitivities.reshape(-1, sensitivities.shape[-1])
    starts, theta, error = rows[:, :start_size], rows[:, start_size:-1], rows[:, -1]
    own_space = orthonormal(starts, 1e-10)
    projected = theta - own_space @ (own_space.T @ theta)
    inliers = projected * (np.abs(error) <= threshold)[:, None]
    score = projected * np.clip(error, -threshold, threshold)[:, None]
    shape = *sensitivities.shape[:2], projected.shape[1]
    return inliers.reshape(shape), np.sum(score.reshape(shape), axis=1)


def _status(fit: _Fit, lost: Sequence[str]) -> Status:
    outcome, predicted_reduction = fit.outcome, float(fit.outcome.predicted_reduction)
    if not fit.differentiable:
        return Status("diverged", _ROUGH)
    if lost:
        return Status("unidentifiable", _UNTRACED.format("; ".join(lost)))
    if predicted_reduction < CONVERGED:
        return Status("converged", f"no step lowers the cost any further, after {fit.steps}")
    if bool(outcome.exhausted):
        return Status("passes_exhausted", _MORE_STEPS.format(predicted_reduction))
    return Status("stalled", _STALLED.format(predicted_reduction))


def _unanswered(
    plant: Plant, records: Sequence[Record], window: float | None, status: Status
) -> Refinement:
    """The starting point, unchanged, and why."""
    size, unknown = len(plant.names), np.full(len(plant.outputs), np.nan)
    return Refinement(
        plant.parameters, dict.fromkeys(plant.names, np.nan), np.full((size, size), np.nan),
        plant, plant, (), unknown, unknown, np.nan, np.nan,
        [np.full(record.outputs.shape, np.nan) for record in records], 0, window, status, (),
    )  # fmt: skip


_NO_DATA = "no sample is left to score: the records are masked, or shorter than their burn-in"
_DIVERGED = (
    "the free run from the starting parameters does not stay finite: start from other parameters "
    "(`starts = 200` tries so many around them), or fit shorter runs with `window`"
)
_ALL_DIVERGED = (
    "no free run stays finite, neither from the starting parameters nor from the {} other starts: "
    "fit shorter runs with `window`, or start nearer to what the plant does"
)
_ROUGH = (
    "the free run has no derivatives where the fit ended: a function of the model has none there "
    "(a root at zero), or the steps are too long for what is fast in it, so that the last digit of "
    "a parameter decides. Keep its parameters off there with `bounds`, or ask for more `substeps`"
)
_UNTRACED = (
    "no trace in the outputs of {}: such a change leaves every free run as it is. Fix one of the "
    "parameters, or excite the plant so that they differ"
)
_MORE_STEPS = "least squares promises to lower the cost by {:.2g} more: allow more `max_steps`"
_STALLED = (
    "no step lowers the cost, though least squares promises {:.2g} of it: the free run is not "
    "smooth in its parameters there (moments of rest that come and go, limits just met or just "
    "missed). Fit shorter runs with `window` if the promise is large"
)
