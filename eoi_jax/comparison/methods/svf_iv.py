"""Instrumental variables on filtered signals, refined: SRIVC for plants in chain form."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.comparison.methods.comparator import AbstractComparator, Estimate, named
from eoi_jax.comparison.methods.filtered import (
    Equation,
    Motion,
    Response,
    equation,
    linearised,
    motion,
)
from eoi_jax.comparison.methods.svf import UNTRACED, hidden, least_squares_on, rest_note
from eoi_jax.comparison.methods.weighed import covariance, solve
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.least_squares import untraced
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import validate

_ROUNDS = 20
_SETTLED = 0.01  # standard errors that a round moves a parameter by, below which it is settled


class StateVariableInstruments(AbstractComparator):
    r"""Least squares on filtered signals cured of the noise in its regressors.

    From the estimate of `svf`, each round simulates the plant at θ from fitted initial states,
    takes as instruments Ψ the regressors of that noise-free run behind the same filters, and solves
    Σ Ψᵀ(e - ΦΔθ) = 0. The narrow filter is then the plant itself, linearised at the mean of its
    slopes along the run, whose residuals are those of y: for a linear plant with white measurement
    noise the estimate is statistically efficient (SRIVC). Where that filter does not forget within
    a record (integrators, unstable plants), the fixed one stays.

    Source: P. Young, A. Jakeman, Int. J. Control 31 (1980) 741; H. Garnier, P. Young (eds),
    *Identification of Continuous-time Models from Sampled Data*, 2008, chapter 4.
    """

    name = "svf_iv"
    description = "state-variable filter and instruments from the simulated model (SRIVC)"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Rounds of instruments from the estimate of least squares."""
        if plant.internal is not None:
            return hidden(plant)
        one = equation(plant, records)
        start, status = least_squares_on(one)
        if not status.ok:
            return Estimate(None, None, status)
        return _rounds(one, start.theta)


def _rounds(one: Equation, theta: Float[np.ndarray, " np"]) -> Estimate:
    plant, record = one.plant, one.records[0]
    memory = round(one.memory / record.sample_period)
    errors = np.zeros_like(theta)
    for number in range(1, _ROUNDS + 1):
        simulated = _instruments(one, theta)
        if simulated is None:
            return Estimate(None, None, Status("diverged", _DIVERGED.format(number)))
        response = _refilter(one, theta, simulated)
        rows = one.rows(theta, response=response)
        instruments = one.rows(theta, simulated, response)
        solved = solve(rows, instruments, plant.free)
        lost = untraced(solved.solution, plant.names, plant.free)
        if lost or not np.isfinite(solved.cost):
            return Estimate(None, None, Status("unidentifiable", UNTRACED.format("; ".join(lost))))
        errors = np.sqrt(np.diagonal(covariance(solved, rows, instruments, memory)))
        moved = np.clip(theta + solved.increment, plant.lower, plant.upper) - theta
        theta = theta + moved
        if np.all(np.abs(moved) <= np.maximum(_SETTLED * errors, 1e-9 * np.abs(theta))):
            used = "the plant itself, linearised" if response else "fixed, as the plant integrates"
            text = f"settled after {number} rounds; the filter is {used}{rest_note(plant)}"
            return Estimate(named(plant, theta), named(plant, errors), Status("converged", text))
    text = f"parameters still moved after {_ROUNDS} rounds: instruments of a poor model"
    status = Status("passes_exhausted", text)
    return Estimate(named(plant, theta), named(plant, errors), status)


def _instruments(one: Equation, theta: Float[np.ndarray, " np"]) -> list[Motion] | None:
    """The simulated plant behind W, a motion per record; None if it does not stay finite."""
    runs = validate(one.plant.with_parameters(theta), one.records, substeps=1)
    if not np.all(np.isfinite(runs.rmse)):
        return None
    return [
        motion(one.plant, measured.with_outputs(run.outputs, run.name), one.filters.wide)
        for measured, run in zip(one.records, runs.predictions, strict=True)
    ]


def _refilter(
    one: Equation, theta: Float[np.ndarray, " np"], simulated: Sequence[Motion]
) -> Response | None:
    duration = min(len(record) * record.sample_period for record in one.records)
    return linearised(one.plant, theta, simulated, duration)


_DIVERGED = (
    "the free run that gives the instruments does not stay finite in round {}: the estimate of "
    "least squares is an unstable model. Less noise, or a longer record"
)
