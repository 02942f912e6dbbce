r"""Output-error refinement: the free run itself is fitted to the measured outputs.

$\min_{\theta, x_1 \dots x_m} \sum_i \sum_k \|y_i[k] - \hat y_i[k; \theta, x_i]\|^2 / \sigma^2$ over
the free parameters and the initial state of every run, $\sigma_j$ the rms residual of output j.
A run is a whole record or a window of one (multiple shooting without continuity): short runs are
easy to fit and forgive what the model lacks, long ones use the most of a model that lacks nothing.

Here is how fits follow each other. Runs and sensitivities are in `problem.py`, the solver in
`levenberg_marquardt.py`, one fit in `fit.py`, what is answered in `estimate.py`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import check, check_count, check_positive
from eoi_jax._process import one_thread
from eoi_jax._status import FitNote, Status
from eoi_jax.data.holds import (
    made_alike,
    skew_text,
    undeclared_hold,
    with_hold,
)
from eoi_jax.data.input_holds import hold_text
from eoi_jax.data.late_outputs import late_output_notes
from eoi_jax.data.record import Record
from eoi_jax.estimation.holdout import held_out_records
from eoi_jax.estimation.identify import Identification, identify
from eoi_jax.estimation.kept_signs import without_runaways
from eoi_jax.models.check_records import check_records
from eoi_jax.models.controller import Controller
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.estimate import (
    ALL_DIVERGED,
    DIVERGED,
    compared_with,
    no_data,
    notes_on_runs,
    refinement_of,
    unanswered,
    with_steps,
)
from eoi_jax.refinement.first_runs import first_runs, first_settled_runs, stepped
from eoi_jax.refinement.fit import (
    Effort,
    Fit,
    differentiable_at,
    fitted,
    lowest,
    rms,
    unweighed,
    watching,
)
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.from_passes import refined_from
from eoi_jax.refinement.holds import compared_holds, is_better
from eoi_jax.refinement.in_loop import refined_in_loop
from eoi_jax.refinement.multistart import best, points_of
from eoi_jax.refinement.problem import (
    CONVERGED,
    Outcome,
    Unknowns,
    beginning,
    weighed,
)
from eoi_jax.refinement.record_check import with_record_check
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.searches import SEARCH, in_longer_steps, search_around
from eoi_jax.refinement.skew import fit_with_skew, mean_error
from eoi_jax.refinement.spans import Span, spans_of, used_window
from eoi_jax.refinement.start_check import with_free_starts, with_start_check
from eoi_jax.refinement.windowed import lost_growth, settled, worse
from eoi_jax.simulation.error_growth import ErrorGrowth
from eoi_jax.simulation.step_size import RULES, choose_steps, finest_steps
from eoi_jax.simulation.validate import validated_alike
from eoi_jax.simulation.validation import Validation


@dataclass(frozen=True)
class RefinementSettings:
    """How fits follow each other."""

    halvings: int = 3  # of windows that nobody asked for, where runs in them diverge at the start
    lost: float = 1e3  # error of a single fit over the spread of the output that is no answer
    beginnings: tuple[float, ...] = (0.125, 0.25, 0.5)  # shares of runs in which errors grow
    # Mean square of the errors in the first of these shares, over that of the whole runs, below
    # which errors grow in a run. Set with measured records in view: 1.3 in a stall at kinks of dry
    # friction (emps), 0.01 and far less in wrong minima of pendulums and of an oscillator.
    max_beginning_error: float = 0.3


_SETTINGS = RefinementSettings()


_WORSE = (
    "the refined parameters make {} on the held-out records worse ({}), so those of the start "
    "stay: the model lacks something that the parameters would make up for. Ask `discover`, or fit "
    "shorter runs with `window`"
)
_MODE = (
    "there the model has an unstable mode with a time constant of {:.2g} s, and errors of a start "
    "grow beyond any use even in runs of {:.2g} s"
)
_FROM_PASSES = (
    "No run can be simulated from the start ({}): the fit began at the estimate of passes"
)
_NO_WINDOW = (
    "no run can be simulated from the starting parameters ({}), and passes over the records lead "
    "to none that do better: start from other parameters (`starts = 200` tries so many around "
    "them), or bound those that make the mode so fast"
)
_SCORED = "must have a sample behind the burn-in and where the inputs are known"
_WHERE = "Take such an output out of the model, or fill in the inputs where they are certain."


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
    validation: Record | Sequence[Record] | None = None,
    callback: Callable[[int, int], None] | None = None,
    controller: Controller | None = None,
) -> Refinement:
    """Refine a plant's parameters by the error of its free runs.

    Where records do not declare the hold of their inputs, the one of each input that fits best is
    used, and inputs that a logger reads a part of a sample period before or after the outputs are
    shifted; notes give the evidence. Held-out records are taken to be made alike.

    Args:
        plant: the model with the parameters to start from, or an identification. Where its passes
            did not come to an end, hold a parameter, or simulate the records worse than the nominal
            values, these are refined as well; the better fit is the answer, and a note says which.
        records: one or several; masked samples and a record's burn-in are not scored, each output
            by itself. Where an input is unknown the run ends, and another one starts behind it.
        window: length of each run [s], about: every record is cut into runs of equal length, of a
            few samples at least; the answer has the length that was used. The state is estimated
            anew at the start of each. None: whole records; where these say nothing at the start,
            for the plant is unstable, windows over which errors of their starts stay small
            (`simulation/error_growth.py`), and a note says so; where they do not even in the
            shortest ones, the fit begins at the estimate of `identify`. Infinite: whole records in
            any case. With `starts` runs are whole where nothing is said.
        substeps: steps of the simulation per sample; one does where the sampling is fine. None:
            four, more where the fastest mode of the plant needs them (`simulation/step_size.py`),
            and twice as many as long as their error would show in the estimate.
        max_steps: of the solver in each fit, each one simulation with its sensitivities.
        starts: further points to start from, run side by side: dicts of parameters, rows
            (starts, np), or how many are drawn around the plant's values: each times a factor of
            1/8 to 8, of either sign where the bounds allow it. All get a few steps, the better
            ones more, the best one the rest; the answer is never worse than without them. None:
            the plant's values. If the solver stalls from there, or has used up its steps and least
            squares promises a hundredth of the cost or more, and errors grow in the runs, it begins
            again: their first eighth is fitted, then a quarter and a half of them. Where it then
            stalls and least squares still promises so much, or a parameter leaves next to no trace
            there, four rounds of 64 points around follow.
        rounds: how often so many points are followed. From the second time on they are drawn
            around the best one so far: some parameters anew, the others moved a little, each by
            itself or along what the records hardly tell. Where that stands still for five rounds
            the search begins anew; the last fifth of the rounds is again the best one's. For models
            of several parts (a start far off in all of them needs a hundred) and rugged costs.
        huber: errors beyond so many standard deviations count by their size, not by its square,
            so that outliers do not rule (1.345 costs 5 % of the efficiency where there are none);
            the standard deviation is then 1.4826 times the median of the sizes. None: squares.
        validation: held-out records. Where their free runs (in windows, where `validate` takes
            these) are worse by the estimate than by the start, the start is the answer, with the
            status ``"start_kept"``. None: nothing is held out.
        callback: called with the number of the solver's steps done and `max_steps`, from 0 again
            where weights or steps are settled anew; the solver is compiled with it.
        controller: drives inputs of the plant by the simulated outputs, in all runs, so that whole
            ones of an unstable plant stay near the record. The recorded input serves to check that
            it is the controller of the record (`simulation/closed_loop.py`). None: the recorded
            input drives the plant.

    Returns:
        The estimate, never worse than its start on these runs. Look at `status` first. At the
        start of a record internal states are those that the plant declares (a function of its
        parameters, if it says so); at the start of a later window they are estimated. Behind delays
        and lags of inputs, their levels before the record are estimated.

    Raises:
        ValueError: arguments or records that do not fit the plant, held-out records that share
            samples with the others, dry friction that cannot be
            simulated, a controller that does not reproduce the recorded input, or that plant or
            records cannot be simulated with.

    Source:
        Output-error method: L. Ljung, *System Identification*, 2nd ed., section 3.2; elimination of
        what enters one block only: Å. Björck, *Numerical Methods for Least Squares Problems*,
        section 6.3; loss: P. J. Huber, *Robust Statistics*, section 7.8; covariance:
        `estimation/regression/robust_covariance.py`.
    """
    fit = partial(refine, substeps=substeps, max_steps=max_steps, huber=huber, callback=callback)
    fully = partial(fit, window=window, starts=starts, rounds=rounds)
    if isinstance(plant, Identification):
        again = partial(fully, records=records, validation=validation, controller=controller)
        return refined_from(plant, again, controller is not None)
    nominal = plant
    if controller is not None:
        open_loop = fit if window is None and starts is None else None
        return refined_in_loop(fully, nominal, records, validation, controller, open_loop)
    records = check_records(nominal, records)
    held_out = held_out_records(nominal, records, validation)
    if window is not None and window != np.inf:
        check_positive("window", window)
    max_steps = check_count("max_steps", max_steps)
    if huber is not None:
        check_positive("huber", huber)
    points = points_of(nominal, starts)
    rounds = check_count("rounds", rounds)
    check(rounds == 1 or len(points) > 0, "rounds", "must be 1 without `starts`", rounds,
          "Say how many points each round draws, for example `starts=200`.")  # fmt: skip
    question = _Question(window, substeps, Effort(max_steps, watching(callback, max_steps)), points,
                         starts is not None, rounds, huber)  # fmt: skip
    return _answered(nominal, records, held_out, question)


def refine_once(
    plant: Plant,
    records: tuple[Record, ...],
    window: float | None,
    substeps: int | None = None,
    max_steps: int = 20,
) -> Refinement:
    """A single fit from the plant's values: no other hold, start or beginning is tried.

    Args:
        plant: with the parameters to start from.
        records: whose hold is declared, or taken as it is.
        window: length of each run [s]; None: whole records.
        substeps: steps of the simulation per sample. None: as the fastest mode needs
            them there and, where that is faster, at the end.
        max_steps: of the solver.

    Returns:
        Its status is ``"diverged"`` where the runs at the start are not finite. Where parameters
        stay open it says which, and not what they have in common: that takes as long as the fit.
    """
    spans = spans_of(records, window)
    window = used_window(records, spans, window)
    problem, unknowns, sensitivities = first_runs(plant, records, spans, substeps)
    error = unweighed(problem, sensitivities)
    if not np.all(np.isfinite(error)):
        return unanswered(plant, records, window, Status("diverged", DIVERGED))
    effort = Effort(max_steps, None)
    fit = fitted(problem, unknowns, sensitivities, error, effort, None)
    if substeps is None:
        fit = _followed(fit, records, spans, effort)
    spread = 1.0 / np.asarray(problem.scale)
    if not fit.differentiable or np.any(rms(fit.error, fit.use) > _SETTINGS.lost * spread):
        return unanswered(plant, records, window, Status("diverged", DIVERGED))
    return refinement_of(fit, records, spans, window, is_trial=True)


@dataclass(frozen=True)
class _Question:
    """Arguments of `refine`, checked.

    Attributes:
        window: length of runs; None: whole records, or what the growth of errors asks for.
        points: further starts. many_starts: whether the caller asked for any.
        from_passes: whether passes have estimated the start already.
        is_trial: whether the fit is compared with others of the same steps, and none begins anew.
    """

    window: float | None
    substeps: int | None
    effort: Effort
    points: Float[np.ndarray, "starts np"]
    many_starts: bool
    rounds: int
    huber: float | None
    from_passes: bool = False
    is_trial: bool = False


def _answered(
    nominal: Plant, records: tuple[Record, ...], held_out: tuple[Record, ...], question: _Question
) -> Refinement:
    """The answer of `refine`: in windows that hold, checked, and judged on the held-out records."""
    result, complete = _with_best_hold(nominal, records, question)
    for _ in range(_SETTINGS.halvings):
        if complete or question.window is not None or result.window is None:
            break
        shorter = replace(question, window=0.5 * result.window)
        result, complete = _with_best_hold(nominal, records, shorter)
    if question.window is None and result.window is not None:
        result = settled(result, partial(_again, question, nominal))
    if not result.status.fits:
        return result
    single = replace(question, points=question.points[:0], many_starts=False, rounds=1)
    single = replace(single, window=result.window if question.window is None else question.window)

    def refit(model: Plant) -> Refinement:
        return _with_best_hold(model, records, single)[0]

    def cost(refined: Refinement) -> float:
        return refined.cost

    shared = notes_on_runs(result)
    as_they_are = partial(_refined, question=replace(single, is_trial=True))
    result = with_start_check(without_runaways(nominal, result, refit, cost), as_they_are)
    result = with_free_starts(with_record_check(result, as_they_are))
    lateness = late_output_notes(result.records, result.residual, result.plant.outputs)
    result = replace(result, notes=(*result.notes, *map(FitNote, lateness)))
    if not result.status.ok or not held_out:
        return result
    held_out = made_alike(held_out, records, result.records)
    initial, refined = validated_alike((nominal, result.plant), held_out)
    if not worse(initial, refined):
        return result
    return _start_kept(nominal, replace(result, notes=shared), question, initial, refined)


def _with_best_hold(
    plant: Plant, records: tuple[Record, ...], question: _Question
) -> tuple[Refinement, bool]:
    """The refinement with the hold and skew of the inputs that fit best, where none is declared.

    First with the hold that the samples suggest. From that estimate the others are tried; where one
    fits clearly better, so may the first from there, which had stalled: then all are tried again
    from its new estimate. Else all begins again with the better one. Then shifts of the inputs are
    tried. Also, whether there is an estimate with each hold.
    """
    rule = undeclared_hold(records)
    if rule is None:
        result = _refined(plant, records, question)
        return result, result.status.fits
    result = _refined(plant, with_hold(records, rule), question)
    if not result.status.fits:
        return result, False
    # The same runs for all, or their errors could not be compared.
    question = replace(question, window=result.window)
    single = replace(
        question, points=question.points[:0], many_starts=False, rounds=1, is_trial=True
    )
    compared = partial(compared_holds, plant, records, rule, partial(_refined, question=single))
    choice, fits = compared(result)
    if choice.best != rule:
        repeated = _refined(fits[choice.best].plant, with_hold(records, rule), single)
        if repeated.status.fits and is_better(repeated, result):
            result = _again(question, plant, result, repeated.plant, question.window or np.inf)
            choice, fits = compared(result)
    if choice.best != rule:
        repeated = _from_the_start(plant, fits[choice.best], question)
        if repeated.status.fits:
            result = repeated
        else:
            choice = replace(choice, best=rule)
    complete = bool(np.all(np.isfinite(list(choice.values.values()))))
    evidence = choice.evidence("the error")
    skewed = fit_with_skew(result, records, choice.best, partial(_refined, question=single))
    if skewed is not None:
        ratio = mean_error(result) / skewed.error
        hold = f"hold {hold_text(skewed.hold, records[0].input_names)}"
        evidence = evidence if skewed.hold == choice.best else (hold,)
        text = skew_text(records[0], skewed.delays)
        evidence += (f"{text}: without this shift the error is {ratio:.3g} times as large",)
        result = _from_the_start(plant, skewed.fit, question)
    return replace(result, notes=(*result.notes, *evidence)), complete


def _from_the_start(plant: Plant, fit: Refinement, question: _Question) -> Refinement:
    """The fit of the same records from where the first fit began; `fit` itself if that is better.

    Only then it is compared with that start as well.
    """
    repeated = _refined(plant, fit.records, question)
    if repeated.status.fits and not is_better(fit, repeated):
        return repeated
    return _again(question, plant, fit, fit.plant, question.window or np.inf)


def _again(
    question: _Question, nominal: Plant, first: Refinement, plant: Plant, window: float
) -> Refinement:
    """A fit that follows the first one, from `plant`, compared with where the first one began."""
    question = replace(question, window=window)
    result = _refined(plant, first.records, question)
    if not result.status.ok:
        return result
    spans = spans_of(result.records, window)
    problem, _, sensitivities = first_runs(nominal, result.records, spans, question.substeps)
    error = unweighed(problem, sensitivities)
    result = compared_with(result, nominal, error, problem.use, spans)
    return with_steps(result, first.steps)


def _start_kept(
    nominal: Plant,
    result: Refinement,
    question: _Question,
    initial: Validation,
    fitted_runs: Validation,
) -> Refinement:
    """The start as the answer, with the certainty that the runs of a fit give it.

    Args:
        nominal: the start.
        result: of the fit, with the notes that hold for the start as well.
        question: asked of `refine`.
        initial: free runs of the start on held-out records.
        fitted_runs: those of the fit.
    """
    spans = spans_of(result.records, result.window)
    problem, unknowns, sensitivities = first_runs(nominal, result.records, spans, question.substeps)
    error = unweighed(problem, sensitivities)
    weights = weighed(problem, rms(error, problem.use))
    sensitivities = sensitivities * np.asarray(weights.scale / problem.scale)[:, None]
    zero = jnp.asarray(0.0)
    outcome = Outcome(unknowns, unknowns, np.asarray(np.nan), zero, zero, jnp.asarray(0),
                      jnp.asarray(False))  # fmt: skip
    fit = Fit(weights, sensitivities, error, outcome, result.steps, 1)
    start = refinement_of(fit, result.records, spans, result.window)
    changes = [f"{name} {old:.3g} → {new:.3g}" for name, old, new in
               zip(nominal.outputs, initial.rmse, fitted_runs.rmse, strict=True)]  # fmt: skip
    runs = (
        "free runs"
        if fitted_runs.window is None
        else f"free runs in windows of {fitted_runs.window:.3g} s"
    )
    status = Status("start_kept", _WORSE.format(runs, ", ".join(changes)))
    return replace(start, status=status, notes=(*dict.fromkeys((*start.notes, *result.notes)),))


def _refined(nominal: Plant, records: tuple[Record, ...], question: _Question) -> Refinement:
    """The refinement of records whose hold is declared."""
    substeps, effort, huber = question.substeps, question.effort, question.huber
    spans = spans_of(records, question.window)
    window = used_window(records, spans, question.window)
    if not any(np.any(span.use) for span in spans):
        return unanswered(nominal, records, window, Status("no_data", no_data(records)))
    scored = np.any([np.any(span.use, axis=0) for span in spans], axis=0)
    for name, any_scored in zip(nominal.outputs, scored, strict=True):
        check(bool(any_scored), f"records.outputs[{name}]", _SCORED, "none", _WHERE)
    problem, unknowns, sensitivities = first_runs(nominal, records, spans, substeps)
    initial_error = unweighed(problem, sensitivities)
    if question.window is None and not question.many_starts and nominal.sampled is None:
        growth = lost_growth(nominal, records, rms(initial_error, problem.use), problem)
        if growth is not None and growth.leaves_no_window:
            result = _from_passes(nominal, records, question, growth)
            if not result.status.fits:
                return result
            return compared_with(result, nominal, initial_error, problem.use, spans)
        if growth is not None:
            return _refined(nominal, records, replace(question, window=growth.window))
    begun = [(unknowns, sensitivities)] if np.all(np.isfinite(initial_error)) else []
    if len(question.points):
        rough = in_longer_steps(problem, records, spans, unknowns, initial_error)
        further = best(problem, rough, unknowns, question.points, question.rounds)
        begun += [(point, signals(point, problem)) for point in further]
    fits = [fitted(problem, *start, initial_error, effort, huber) for start in begun]
    if not fits:
        reason = ALL_DIVERGED.format(len(question.points)) if question.many_starts else DIVERGED
        reason += f". {choose_steps(nominal, records).note}".removesuffix(". ")
        return unanswered(nominal, records, window, Status("diverged", reason))
    if not question.many_starts:
        fits = [_grown(fits[0], begun[0][0], effort, huber)]
    if substeps is None:
        finer = [_finer(fit, records, spans, effort, huber) for fit in fits]
        fits = [fit for fit, _ in finer]
        alone = not (question.many_starts or question.is_trial)
        if alone and not finer[0][1]:
            fits = [_renewed(fits[0], nominal, records, spans, problem.substeps, effort, huber)]
    if not question.many_starts:
        fits += search_around(fits[0], records, spans, effort, huber)
    result = refinement_of(lowest(fits, huber), records, spans, window)
    note = choose_steps(result.plant, records).note if substeps is None else ""
    return replace(result, notes=(*result.notes, note)) if note else result


def _from_passes(
    nominal: Plant, records: tuple[Record, ...], question: _Question, growth: ErrorGrowth
) -> Refinement:
    """From the estimate of passes, which simulate nothing, where no window holds the start."""
    mode = _MODE.format(1.0 / growth.rate, growth.shortest)
    if not question.from_passes:
        passes = identify(nominal, records)
        if passes.status.fits:
            repeated = replace(question, from_passes=True)
            result = _refined(passes.plant, records, repeated)
            if not result.status.fits:
                return unanswered(nominal, records, None, result.status)
            return replace(result, notes=(*result.notes, _FROM_PASSES.format(mode)))
    reason = _NO_WINDOW.format(mode)
    return unanswered(nominal, records, None, Status("diverged", reason))


def _grown(fit: Fit, unknowns: Unknowns, effort: Effort, huber: float | None) -> Fit:
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
    threshold = SEARCH.max_reduction if bool(fit.outcome.exhausted) else CONVERGED
    if predicted_reduction < threshold or not fit.differentiable or not _growing(fit):
        return fit
    for share in (*_SETTINGS.beginnings, 1.0):
        problem = fit.problem if share == 1.0 else beginning(fit.problem, share)
        sensitivities = signals(unknowns, problem)
        if not differentiable_at(problem, unknowns, sensitivities):
            return replace(fit, steps=steps)
        grown = fitted(problem, unknowns, sensitivities, fit.initial_error, effort, huber)
        unknowns, steps = grown.outcome.unknowns, steps + grown.steps
    better = lowest([fit, grown], huber)
    return replace(better, steps=steps)


def _growing(fit: Fit) -> bool:
    """Whether errors are small at the beginning of the runs and grow in them."""
    error, use = fit.sensitivities[..., -1], fit.use
    lengths = (np.asarray(fit.problem.counts) - 1) / fit.problem.substeps
    ends = _SETTINGS.beginnings[0] * lengths
    first = (np.arange(use.shape[1]) <= ends[:, None])[..., None] & use
    beginning, overall = (
        np.sum(np.where(part, error, 0.0) ** 2) / max(np.sum(part), 1) for part in (first, use)
    )
    return bool(beginning < _SETTINGS.max_beginning_error * overall)


def _finer(
    fit: Fit,
    records: Sequence[Record],
    spans: Sequence[Span],
    effort: Effort,
    huber: float | None,
) -> tuple[Fit, bool]:
    r"""Shorter steps, as long as the error of the longer ones shows in the estimate.

    An error e of the simulation moves θ, in units of its standard error, by up to
    $\sqrt{N}\,\mathrm{rms}(e) / \mathrm{rms}(r)$: noise averages out over N samples, e does not.
    The shorter steps stay whether they fit better or not: what long ones fit better is their own
    error. Steps are halved, or as short as the fastest mode at the estimate needs them. Also,
    whether runs agree in the end: what shows in an estimate without noise need not show in them.
    """
    limit, settled = finest_steps(records), False
    for _ in range(RULES.halvings):
        old, unknowns = fit.problem, fit.outcome.unknowns
        estimate = old.kernel.plant.with_parameters(old.completed(unknowns.theta))
        count = max(2 * old.substeps, choose_steps(estimate, records).count)
        if not fit.differentiable or count > limit:
            break
        problem = stepped(old, records, spans, count)
        sensitivities = signals(unknowns, problem)
        step_error = rms(unweighed(problem, sensitivities) - fit.error, fit.use)
        samples, size = np.sqrt(np.sum(fit.use, axis=(0, 1))), rms(fit.error, fit.use)
        measured = rms(np.where(fit.use, old.y, 0.0), fit.use)
        visible = np.maximum(RULES.visible * size, RULES.resolution * measured)
        settled = bool(np.all(step_error <= visible))
        if np.all(samples * step_error <= size):
            return fit, True
        finer = fitted(problem, unknowns, sensitivities, fit.initial_error, effort, huber)
        if not finer.differentiable:
            break
        fit = replace(finer, steps=fit.steps + finer.steps)
    return fit, settled


def _followed(fit: Fit, records: Sequence[Record], spans: Sequence[Span], effort: Effort) -> Fit:
    """A fit in steps that follow the fastest mode at its end: anew from there, where they did not.

    A mode that is faster than the steps grows by their error, which seems to tell how fast it is:
    the fit ends at the limit of stability, with a small standard error. Where a fit runs from there
    to a faster mode yet, the records do not tell how fast that is: its runs are only simulated in
    the steps that it needs, for the standard errors.
    """
    for anew in (True, False):
        problem, unknowns = fit.problem, fit.outcome.unknowns
        plant = problem.kernel.plant.with_parameters(problem.completed(unknowns.theta))
        count = choose_steps(plant, records).count
        if not fit.differentiable or count <= problem.substeps:
            break
        finer = stepped(problem, records, spans, count)
        followed = replace(fit, problem=finer, sensitivities=signals(unknowns, finer))
        if anew and followed.differentiable:
            start = unknowns, followed.sensitivities, fit.initial_error
            refit = fitted(finer, *start, effort, None)
            followed = replace(refit, steps=fit.steps + refit.steps)
        fit = followed
    return fit


def _renewed(
    fit: Fit,
    nominal: Plant,
    records: Sequence[Record],
    spans: Sequence[Span],
    substeps: int,
    effort: Effort,
    huber: float | None,
) -> Fit:
    """A fit whose steps never became short enough, anew from its start if they were too long there.

    Where a run meets a fast mode that the measured signals do not show, such a fit follows the
    error of its steps, to where shorter ones lead nowhere.
    """
    begun = first_settled_runs(nominal, records, spans, substeps)
    if begun is None:
        return fit
    problem, unknowns, sensitivities = begun
    initial_error = unweighed(problem, sensitivities)
    renewed = fitted(problem, unknowns, sensitivities, initial_error, effort, huber)
    renewed, _ = _finer(_grown(renewed, unknowns, effort, huber), records, spans, effort, huber)
    return replace(renewed, steps=fit.steps + renewed.steps)
