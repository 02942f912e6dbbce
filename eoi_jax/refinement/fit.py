"""One fit of the free runs: solved anew until the outputs are weighed by their residuals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.refinement.free_run_sums import ill_conditioned
from eoi_jax.refinement.levenberg_marquardt import solve
from eoi_jax.refinement.problem import Outcome, Problem, Unknowns, weighed


@dataclass(frozen=True)
class Effort:
    """How many steps the solver may take, and who is told of them."""

    max_steps: int
    watch: Callable[[Any, Any], None] | None


def watching(
    callback: Callable[[int, int], None] | None, max_steps: int
) -> Callable[[Any, Any], None] | None:
    """What the solver calls to report its steps."""
    if callback is None:
        return None
    report = callback
    return lambda number, _: report(int(number), max_steps)


@dataclass(frozen=True)
class Fit:
    """The last fit.

    Attributes:
        problem: with the weights of this fit.
        sensitivities: `signals` where it ended.
        initial_error: errors at the very start.
        outcome: of the solver.
        steps: of all fits.
        fits: each with other weights of the outputs.
        unsettled: relative change of the weights of the outputs that was left.
    """

    problem: Problem
    sensitivities: Float[np.ndarray, "runs time ny size"]
    initial_error: Float[np.ndarray, "runs time ny"]
    outcome: Outcome
    steps: int
    fits: int
    unsettled: float = 0.0

    @property
    def use(self) -> Bool[np.ndarray, "runs time ny"]:
        """Which samples are scored."""
        return self.problem.use

    @property
    def error(self) -> Float[np.ndarray, "runs time ny"]:
        """y - ŷ; zero where not scored."""
        return unweighed(self.problem, self.sensitivities)

    def sigma(self, huber: float | None) -> Float[np.ndarray, " ny"]:
        """Standard deviation of each output's errors, of which those few beyond `huber` are not."""
        return (rms if huber is None else _typical)(self.error, self.use)

    @cached_property
    def differentiable(self) -> bool:
        """Whether the free runs have derivatives to speak of where the fit ended."""
        return differentiable_at(self.problem, self.outcome.unknowns, self.sensitivities)


def faint_parameters(fit: Fit, share: float = 1e-3) -> tuple[str, ...]:
    """Parameters that leave next to no trace where a fit ended.

    A change by all of its value, or by that of the start, moves the runs by less than this share of
    what chance does, as that of a time constant far below the sample period: no step shows where it
    belongs. A parameter that begins at zero has no such size.
    """
    problem, theta = fit.problem, np.asarray(fit.outcome.unknowns.theta)
    plant, rows = problem.kernel.plant, fit.sensitivities
    sizes = np.maximum(np.abs(plant.theta[list(problem.free)]), np.abs(theta))
    power = np.sum(rows[..., -1 - len(theta) :] ** 2, axis=(0, 1, 2))
    chance = np.sqrt(power[-1] / np.sum(fit.use))
    traces = sizes * np.sqrt(power[:-1])
    faint = (traces > 0) & (traces < share * chance)
    return tuple(plant.names[i] for i, flag in zip(problem.free, faint, strict=True) if flag)


def fitted(
    problem: Problem,
    unknowns: Unknowns,
    sensitivities: Float[np.ndarray, "runs time ny size"],
    initial_error: Float[np.ndarray, "runs time ny"],
    effort: Effort,
    huber: float | None,
    reweightings: int = 4,
    tolerance: float = 0.02,
) -> Fit:
    """Fits until the outputs are weighed by their residuals (one output: a single fit).

    Each lowers the cost under weights that were the best ones before: for squares, alternating
    minimisation of the likelihood over the unknowns and σ, which never goes up. There are at most
    so many further fits as `reweightings`, until weights change by less than `tolerance` of them.
    """
    steps = 0
    for count in range(1, 2 + reweightings):
        outcome, sensitivities = solve(
            problem, unknowns, sensitivities, effort.max_steps, effort.watch
        )
        if effort.watch is not None:
            jax.effects_barrier()  # all progress is reported before the next fit
        unknowns, steps = outcome.unknowns, steps + int(outcome.steps)
        fit = Fit(problem, sensitivities, initial_error, outcome, steps, count)
        # An output without any error would weigh infinitely.
        sigma = np.maximum(fit.sigma(huber), 1e-9 * np.max(np.abs(problem.y), axis=(0, 1)))
        ratio = np.where(sigma > 0, sigma, 1.0) * np.asarray(problem.scale)
        # Squares know no scale: only the ratios of the outputs count.
        extremes = (np.max(ratio), np.min(ratio) if huber is None else 1.0)
        if max(extremes) < (1.0 + tolerance) * min(extremes):
            break
        reweighed = weighed(problem, sigma, np.inf if huber is None else huber)
        problem, sensitivities = (
            reweighed,
            sensitivities * np.asarray(reweighed.scale / problem.scale)[:, None],
        )
    else:
        fit = replace(fit, unsettled=float(max(extremes) / min(extremes) - 1.0))
    return fit


def lowest(fits: Sequence[Fit], huber: float | None) -> Fit:
    """That of the lowest cost, among those that have derivatives where there are any."""
    return min(fits, key=lambda fit: (not fit.differentiable, log_cost(fit.sigma(huber))))


def differentiable_at(problem: Problem, unknowns: Unknowns, sensitivities: np.ndarray) -> bool:
    """Whether free runs have derivatives to speak of; `sensitivities` are their signals."""
    if not np.all(np.isfinite(sensitivities)):
        return False
    theta = np.asarray(unknowns.theta)
    with np.errstate(over="ignore"):
        sums = np.einsum("rtjc,rtjc->rc", sensitivities, sensitivities)
    return not np.any(ill_conditioned(sums[:, -1 - len(theta) :], theta, problem.power))


def unweighed(problem: Problem, sensitivities: np.ndarray) -> Float[np.ndarray, "runs time ny"]:
    """y - ŷ in the unit of y, out of `signals`; zero where not scored."""
    return sensitivities[..., -1] / np.asarray(problem.scale)


def rms(error: np.ndarray, use: np.ndarray) -> Float[np.ndarray, " ny"]:
    """Root mean square of each output's errors over the samples in use."""
    with np.errstate(over="ignore"):
        return np.sqrt(np.sum(error**2, axis=(0, 1)) / np.sum(use, axis=(0, 1)))


def _typical(error: np.ndarray, use: np.ndarray) -> Float[np.ndarray, " ny"]:
    """σ of normal errors with this median size: outliers hardly move it."""
    sizes = np.where(use, np.abs(error), np.nan)
    return 1.4826 * np.nanmedian(sizes, axis=(0, 1))


def log_cost(rmse: np.ndarray) -> float:
    """Σ_j log rmse_j², which a fit minimises."""
    return float(2.0 * np.sum(np.log(np.maximum(rmse, np.finfo(float).tiny))))
