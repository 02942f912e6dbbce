"""State-variable filter and least squares: regression on filtered derivatives."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax._checks import counted
from eoi_jax._status import Status
from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    algebraic_answer,
    named,
    not_applicable,
)
from eoi_jax.comparison.methods.filtered import Equation, Rows, equation
from eoi_jax.comparison.methods.weighed import WeightedSolution, covariance, solve
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.least_squares import untraced
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.gauss_newton import gauss_newton


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
        refused = algebraic_answer(plant)
        if refused is not None:
            return refused
        if plant.internal is not None:
            return hidden_states_answer(plant)
        filtered = equation(plant, records)
        end, status = least_squares_on(filtered)
        if not status.ok:
            return Estimate(None, None, status)
        memory = round(filtered.memory / filtered.records[0].sample_period)
        errors = np.sqrt(np.diagonal(covariance(end.solved, end.rows, end.rows, memory)))
        return Estimate(named(plant, end.theta), named(plant, errors), status)


def hidden_states_answer(plant: Plant) -> Estimate:
    """No answer, for a plant with internal states."""
    del plant
    reason = "the plant has internal states that are not measured, and a regression needs them"
    return not_applicable(reason)


@dataclass(frozen=True)
class Regression:
    """The regression at θ: its rows, and their solution there."""

    theta: Float[np.ndarray, " np"]
    rows: Rows
    solved: WeightedSolution

    @property
    def cost(self) -> float:
        """Geometric mean, over the outputs, of the power of the residuals."""
        return _mean_power(self.solved.power)


def least_squares_on(
    filtered: Equation, max_steps: int = 30, lengths: int = 20, min_reduction: float = 1e-14
) -> tuple[Regression, Status]:
    """Gauss-Newton with halved steps: where it ends, and how.

    Args:
        filtered: the equation.
        max_steps: linearisations, at most.
        lengths: of each step, at most; each is a half of the one before.
        min_reduction: relative fall of the power of the residuals below which they have settled.
    """
    plant = filtered.plant

    def at(theta: Float[np.ndarray, " np"]) -> Regression:
        rows = filtered.rows(theta)
        return Regression(theta, rows, solve(rows, rows, plant.free))

    def linearise(points: list[Regression]) -> list[tuple[np.ndarray, float]]:
        steps = [
            np.clip(point.theta + point.solved.increment, plant.lower, plant.upper) - point.theta
            for point in points
        ]
        return [
            (step, _predicted_fall(point, step)) for point, step in zip(points, steps, strict=True)
        ]

    def evaluate(points: list[Regression], steps: list[np.ndarray]) -> list[Iterator[Regression]]:
        return [
            (at(point.theta + 0.5**i * step) for i in range(lengths))
            for point, step in zip(points, steps, strict=True)
        ]

    start = at(np.asarray(plant.theta, dtype=float))
    if not any(np.any(mask > 0) for mask in filtered.masks):
        return start, Status("no_data", _NO_DATA)
    if not np.isfinite(start.cost):
        return start, Status("diverged", _DIVERGED)
    descent = gauss_newton([start], linearise, evaluate, min_reduction, max_steps)
    (end,) = descent.points
    status = _identified(plant, end.solved, descent.rounds)
    if status.ok and descent.exhausted:
        text = f"residuals still fell after {max_steps} Gauss-Newton steps"
        status = Status("passes_exhausted", text)
    return end, status


def _mean_power(power: Float[np.ndarray, " ny"]) -> float:
    logs = np.log(np.maximum(power, np.finfo(float).tiny))
    return float(np.exp(np.mean(logs))) if np.all(np.isfinite(power)) else np.inf


def _predicted_fall(point: Regression, step: Float[np.ndarray, " np"]) -> float:
    """By how much the cost falls along a step if φ does not change."""
    residuals = [
        error - phi @ step for error, phi in zip(point.rows.error, point.rows.phi, strict=True)
    ]
    return point.cost - _mean_power(np.mean(np.concatenate(residuals) ** 2, axis=0))


def _identified(plant: Plant, solved: WeightedSolution, number: int) -> Status:
    lost = untraced(solved.solution, plant.names, plant.free)
    if lost:
        return Status("unidentifiable", UNTRACED.format("; ".join(lost)))
    steps = counted(number, "step")
    return Status("converged", f"least squares settled after {steps}{rest_note(plant)}")


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
