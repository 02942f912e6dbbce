"""The parameters of any estimate with errors, intervals and units: of tables and of files."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax._checks import check_kind
from eoi_jax.discovery.result import Discovery
from eoi_jax.estimation.identify import Identification
from eoi_jax.models.augmented import actuator_effects, added_effects
from eoi_jax.models.input_strength import input_strengths
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.result import Refinement
from eoi_jax.uncertainty.uncertainty import Uncertainty, uncertainty

LEVEL = 0.95  # of the intervals
ESTIMATES = (Identification, Refinement, Discovery, Uncertainty, Plant)


@dataclass(frozen=True)
class AtInput:
    """A parameter of an effect in the unit of the input that drives the model.

    Attributes:
        input: its name.
        value, standard_error: [unit].
        unit: of the input; "" where unknown.
    """

    input: str
    value: float
    standard_error: float
    unit: str


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter with what is known of it.

    Attributes:
        name: in the plant.
        value, standard_error: [unit]; 0 where it is fixed, NaN where the error is not known,
            infinite where the data leave the parameter open.
        low, high: ends of the interval at `LEVEL`; NaN where the error is not known.
        unit: "" where unknown.
        estimated: False where it is fixed.
        effect: canonical name of the effect that it belongs to; "" for one of the declared model.
        at_input: its strength at the input, if it has one.
    """

    name: str
    value: float
    standard_error: float
    low: float
    high: float
    unit: str
    estimated: bool
    effect: str = ""
    at_input: AtInput | None = None


def fit_of(result: Any) -> Any:
    """The fit behind a result: that of the augmented model, of a discovery; else the result.

    Args:
        result: with an estimate.

    Raises:
        ValueError: a result without an estimate.
    """
    check_kind("result", result, ESTIMATES, "a Plant or a result with an estimate")
    return result.found if isinstance(result, Discovery) else result


def estimate_of(result: Any) -> Uncertainty:
    """The estimates of a result with their covariance; that of a plant is not known.

    Args:
        result: a `Plant`, or of `identify`, `refine`, `discover`, `uncertainty` or `bootstrap`.

    Raises:
        ValueError: a result without an estimate, or without an answer.
    """
    fit = fit_of(result)
    if isinstance(fit, Uncertainty):
        return fit
    return without_covariance(fit) if isinstance(fit, Plant) else uncertainty(fit)


def without_covariance(plant: Plant) -> Uncertainty:
    """The parameters of a plant, of whose errors nothing is known.

    Args:
        plant: any.
    """
    count = len(plant.names)
    unknown = np.diag(np.where(np.asarray(plant.free) > 0, np.nan, 0.0))
    units = {name: unit for name, unit in plant.units.items() if name in plant.names}
    freedom, untraced = np.full(count, np.inf), np.zeros((count, 0))
    return Uncertainty(dict(plant.parameters), unknown, freedom, untraced, (), units)


def plant_of(result: Any) -> Plant | None:
    """The plant with the estimate; None of quantities that belong to none.

    Args:
        result: with an estimate.
    """
    fit = fit_of(result)
    return fit if isinstance(fit, Plant) else getattr(fit, "plant", None)


def parameter_estimates(result: Any, uncertainty: Uncertainty) -> tuple[ParameterEstimate, ...]:
    """The parameters of a result, in its order.

    Args:
        result: with an estimate.
        uncertainty: its estimates with their covariance.
    """
    plant = plant_of(result)
    effects = dict(_effects(plant)) if plant else {}
    at_inputs = {row.parameter: row for row in input_strengths(plant)} if plant else {}
    errors, intervals, rows = uncertainty.standard_errors, uncertainty.intervals(LEVEL), []
    for name, value in uncertainty.parameters.items():
        strength, at_input = at_inputs.get(name), None
        if strength is not None:
            sizes = value * strength.factor, errors[name] * abs(strength.factor)
            at_input = AtInput(strength.input, *sizes, strength.unit)
        row = ParameterEstimate(
            name,
            float(value),
            errors[name],
            *intervals[name],
            uncertainty.units.get(name, ""),
            errors[name] != 0 if plant is None else name not in plant.fixed,
            effects.get(name, ""),
            at_input,
        )
        rows.append(row)
    return tuple(rows)


def _effects(plant: Plant) -> Iterator[tuple[str, str]]:
    """Name of each parameter of an effect, and that of the effect."""
    try:
        on_inputs = actuator_effects(plant, "must be made of effects")
    except ValueError:  # a function of the user, whose parameters are the declared model's
        on_inputs = ()
    for placed in (*added_effects(plant), *on_inputs):
        for name in placed.names:
            yield name, placed.effect.name
