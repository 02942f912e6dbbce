"""State-variable filter and least squares: regression on filtered derivatives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._status import Status
from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    named,
    not_applicable,
)
from eoi_jax.comparison.methods.filtered import Equation, Rows, equation
from eoi_jax.comparison.methods.weighed import WeightedSolution, covariance, solve
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.least_squares import untraced
from eoi_jax.models.plant import Plant

_STEPS = 30
_SETTLED = 1e-8  # rms effect of a step over that of y^(r), below which the iteration has converged
_DAMPING = 0.1  # first damping after a Gauss-Newton step that increased the residuals


class StateVariableFilter(AbstractComparator):
    """Least squares of L[y^(r)] on L[φ], both filters without phase.

    One least squares for a plant that is affine in its parameters, Gauss-Newton on ∂f/∂θ for any
    other. Samples near rest are left out for a plant with dry friction.

    Source: H. Garnier, P. Young (eds), *Identification of Continuous-time Models from Sampled
    Data*, 2008, chapters 1 and 4; details in `filtered.py`.
    """

    name = "svf"
    description = "state-variable filter (zero phase) and least squares"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Least squares on filtered signals."""
        if plant.internal is not None:
            return hidden_states_answer(plant)
        filtered = equation(plant, records)
        fit = least_squares_on(filtered)
        if not fit.status.ok:
            return Estimate(None, None, fit.status)
        memory = round(filtered.memory / filtered.records[0].sample_period)
        errors = np.sqrt(np.diagonal(covariance(fit.solved, fit.rows, fit.rows, memory)))
        return Estimate(named(plant, fit.theta), named(plant, errors), fit.status)


def hidden_states_answer(plant: Plant) -> Estimate:
    """No answer, for a plant with internal states."""
    del plant
    reason = "the plant has internal states that are not measured, and a regression needs them"
    return not_applicable(reason)


@dataclass(frozen=True)
class Fit:
    """Result of the least squares: θ, its rows and solution, and the status."""

    theta: Float[np.ndarray, " np"]
    rows: Rows
    solved: WeightedSolution
    status: Status


def least_squares_on(filtered: Equation) -> Fit:
    """Gauss-Newton, damped where a step does not lower the residuals (Levenberg)."""
    plant = filtered.plant
    theta = np.asarray(plant.theta, dtype=float)
    rows = filtered.rows(theta)
    solved = solve(rows, rows, plant.free)
    if not any(np.any(mask > 0) for mask in filtered.masks):
        return Fit(theta, rows, solved, Status("no_data", _NO_DATA))
    if not np.isfinite(solved.cost):
        return Fit(theta, rows, solved, Status("diverged", _DIVERGED))
    damping = 0.0
    for number in range(1, _STEPS + 1):
        damped = solve(rows, rows, plant.free, damping) if damping else solved
        trial = np.clip(theta + damped.increment, plant.lower, plant.upper)
        new_rows = filtered.rows(trial)
        new = solve(new_rows, new_rows, plant.free)
        if new.cost <= solved.cost:
            change = _change(rows, trial - theta)
            theta, rows, solved = trial, new_rows, new
            damping *= 0.1 if damping > _DAMPING else 0.0
            if change < _SETTLED:
                return Fit(theta, rows, solved, _identified(plant, solved, number))
        elif _change(rows, trial - theta) < _SETTLED:  # rounding
            return Fit(theta, rows, solved, _identified(plant, solved, number))
        else:
            damping = max(10.0 * damping, _DAMPING)
    code = Status("passes_exhausted", f"residuals still fell after {_STEPS} Gauss-Newton steps")
    final = _identified(plant, solved, _STEPS)
    return Fit(theta, rows, solved, code if final.ok else final)


def _change(rows: Rows, step: Float[np.ndarray, " np"]) -> float:
    moved = np.mean(np.concatenate([phi @ step for phi in rows.phi]) ** 2, axis=0)
    return float(np.max(np.sqrt(moved) / np.where(rows.highest > 0, rows.highest, 1.0)))


def _identified(plant: Plant, solved: WeightedSolution, number: int) -> Status:
    lost = untraced(solved.solution, plant.names, plant.free)
    if lost:
        return Status("unidentifiable", UNTRACED.format("; ".join(lost)))
    return Status("converged", f"least squares settled after {number} step(s){rest_note(plant)}")


def rest_note(plant: Plant) -> str:
    """End of a sentence that says which samples were left out for dry friction."""
    return "; samples near rest were left out" if any(plant.dry_friction) else ""


UNTRACED = (
    "no trace in the filtered records of {}. Fix one of the parameters, or excite the plant so "
    "that they differ"
)
_NO_DATA = (
    "no sample is left: the records are shorter than the filters' ends, masked, or the plant "
    "stands still throughout"
)
_DIVERGED = (
    "the model is not finite along the filtered record: check units, nominal values, and functions "
    "such as sqrt or log at the measured outputs"
)
