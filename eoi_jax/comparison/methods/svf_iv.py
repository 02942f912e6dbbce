"""Refined instrumental variables on filtered signals: SRIVC for plants in chain form."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import counted
from eoi_jax._status import Status
from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    algebraic_answer,
    named,
)
from eoi_jax.comparison.methods.filtered import (
    Equation,
    Motion,
    Response,
    equation,
    linearised,
    motion,
)
from eoi_jax.comparison.methods.svf import (
    UNTRACED,
    hidden_states_answer,
    least_squares_on,
    rest_note,
)
from eoi_jax.comparison.methods.weighed import covariance, solve
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.least_squares import untraced
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.validate import judged_runs


class StateVariableInstruments(AbstractComparator):
    r"""Least squares on filtered signals, corrected for the noise in its regressors.

    From the estimate of `svf`, each round simulates the plant at θ from fitted initial states,
    takes as instruments Ψ the regressors of that noise-free run with the same filters, and solves
    Σ Ψᵀ(e - ΦΔθ) = 0. The narrow filter is then the plant itself, linearised at the mean of its
    slopes along the run, so that residuals are those of y: for a linear plant with white
    measurement noise the estimate is statistically efficient (SRIVC). Where that filter does not
    decay within a record (integrators, unstable plants), the fixed filter is used.

    Source: P. Young, A. Jakeman, Int. J. Control 31 (1980) 741; H. Garnier, P. Young (eds),
    *Identification of Continuous-time Models from Sampled Data*, 2008, chapter 4.
    """

    name = "svf_iv"
    description = "state-variable filter and instruments from the simulated model (SRIVC)"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Rounds of instruments from the estimate of least squares."""
        refused = algebraic_answer(plant)
        if refused is not None:
            return refused
        if plant.internal is not None:
            return hidden_states_answer(plant)
        filtered = equation(plant, records)
        start, status = least_squares_on(filtered)
        if not status.ok:
            return Estimate(None, None, status)
        return _rounds(filtered, start.theta)


def _rounds(
    filtered: Equation,
    theta: Float[np.ndarray, " np"],
    max_rounds: int = 20,
    tolerance: float = 0.01,
) -> Estimate:
    """Rounds of instruments, until θ changes by less than `tolerance` of its standard errors."""
    plant, record = filtered.plant, filtered.records[0]
    memory = round(filtered.memory / record.sample_period)
    errors = np.zeros_like(theta)
    for number in range(1, max_rounds + 1):
        simulated = _instruments(filtered, theta)
        if simulated is None:
            return Estimate(None, None, Status("diverged", _DIVERGED.format(number)))
        response = _refilter(filtered, theta, simulated)
        rows = filtered.rows(theta, response=response)
        instruments = filtered.rows(theta, simulated, response)
        solved = solve(rows, instruments, plant.free)
        lost = untraced(solved.solution, plant.names, plant.free)
        if lost or not np.isfinite(solved.cost):
            return Estimate(None, None, Status("unidentifiable", UNTRACED.format("; ".join(lost))))
        errors = np.sqrt(np.diagonal(covariance(solved, rows, instruments, memory)))
        moved = np.clip(theta + solved.increment, plant.lower, plant.upper) - theta
        theta = theta + moved
        if np.all(np.abs(moved) <= np.maximum(tolerance * errors, 1e-9 * np.abs(theta))):
            used = "the plant itself, linearised" if response else "fixed, as the plant integrates"
            rounds = counted(number, "round")
            text = f"settled after {rounds}; the filter is {used}{rest_note(plant)}"
            return Estimate(named(plant, theta), named(plant, errors), Status("converged", text))
    rounds = counted(max_rounds, "round")
    text = f"parameters still moved after {rounds}: instruments of a poor model"
    status = Status("passes_exhausted", text)
    return Estimate(named(plant, theta), named(plant, errors), status)


def _instruments(filtered: Equation, theta: Float[np.ndarray, " np"]) -> list[Motion] | None:
    """The simulated plant filtered by W, a motion per record; None if it does not stay finite."""
    runs = judged_runs(filtered.plant.with_parameters(theta), filtered.records, substeps=1)
    if not np.all(np.isfinite(runs.rmse)):
        return None
    return [
        motion(filtered.plant, measured.with_outputs(run.outputs, run.name), filtered.filters.wide)
        for measured, run in zip(filtered.records, runs.predictions, strict=True)
    ]


def _refilter(
    filtered: Equation, theta: Float[np.ndarray, " np"], simulated: Sequence[Motion]
) -> Response | None:
    duration = min(len(record) * record.sample_period for record in filtered.records)
    return linearised(filtered.plant, theta, simulated, duration)


_DIVERGED = (
    "the free run that gives the instruments does not stay finite in round {}: the estimate of "
    "least squares is an unstable model. Less noise, or a longer record"
)
