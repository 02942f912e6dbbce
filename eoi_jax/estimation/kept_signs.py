"""Signs: divisors that their bounds keep from that of the records, and estimates of the other one.

Where 1/θ has to change its sign, θ passes through infinity (`models/step_scales.py`). A bound
forbids it: the estimate then ends on a bound away from zero, or runs off to where 1/θ is next to
nothing, and the fit looks like any other. Whether it is so is asked of a fit without the bound.

Without bounds a sensor of the wrong sign is fitted as well as one of the right sign, by parameters
that all have the other sign than what they were declared with.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eoi_jax.estimation.runaway import held_runaways
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import RECIPROCAL, step_scales


@dataclass(frozen=True)
class KeptSignSettings:
    """When a divisor is tried without its bounds, and when signs are told."""

    deviations: float = 3.0  # standard errors from zero, at which a sign is that of the records
    min_ratio: float = 10.0  # to the nominal value: guesses are mostly nearer
    min_fall: float = 1e-2  # of the logarithm of the index or of the mean square error


_SETTINGS = KeptSignSettings()

_KEPT = (
    "the bounds of {name} keep it {sign}, and the records ask for about {value:.3g}: there the fit "
    "is better, while within the bounds 1/{name} runs to zero. An input or a sensor may count in "
    "the other direction: check the signs of {channels}, or take the bounds of {name} away"
)

_REVERSED = (
    "all parameters ({names}) have come out with the other sign than they started with, as if an "
    "input or an output counted in the other direction: check the signs of {channels}"
)


def without_runaways(
    plant: Plant, fit: Any, refit: Callable[[Plant], Any], cost: Callable[[Any], float]
) -> Any:
    """An estimate with parameters that ran off held, and notes on wrong signs.

    Where the fit without bounds is better and lies within them, it has only passed through infinity
    and come back: it is the answer.

    Args:
        plant: with the nominal parameters.
        fit: an `Identification` or a `Refinement` of it, with a fit.
        refit: makes another one from a plant without these bounds.
        cost: logarithm of what a fit minimises.
    """
    fit = held_runaways(plant, fit, refit, cost)
    if reversals := reversed_notes(plant, fit):
        return replace(fit, notes=(*fit.notes, *reversals))
    divisors = _divisors(plant)
    names = [name for name in divisors if _is_large(plant, name, fit.parameters[name])]
    if not names:
        return fit
    unbounded = refit(plant.declared_anew(bounds=dict.fromkeys(divisors, (-np.inf, np.inf))))
    if not unbounded.status.ok or not cost(unbounded) < cost(fit) - _SETTINGS.min_fall:
        return fit
    values = np.asarray(list(unbounded.parameters.values()))
    if np.all((plant.lower <= values) & (values <= plant.upper)):
        bounded = refit(plant.with_parameters(unbounded.parameters))
        is_better = bounded.status.ok and cost(bounded) < cost(fit) - _SETTINGS.min_fall
        return replace(bounded, nominal=plant) if is_better else fit
    notes = []
    for name in names:
        value = unbounded.parameters[name]
        if value * plant.parameters[name] < 0:
            sign = "positive" if plant.parameters[name] > 0 else "negative"
            notes.append(_KEPT.format(name=name, sign=sign, value=value, channels=_channels(plant)))
    return replace(fit, notes=(*fit.notes, *notes)) if notes else fit


def _channels(plant: Plant) -> str:
    return ", ".join((*plant.inputs, *plant.outputs))


def reversed_notes(plant: Plant, fit: Any) -> tuple[str, ...]:
    """A sentence where two parameters or more, and all that are free, are sure of the other sign.

    Args:
        plant: with the nominal parameters.
        fit: an `Identification` or a `Refinement` of it, with a fit.
    """
    names = [name for name in plant.names if name not in plant.fixed]
    pairs = [(plant.parameters[name], fit.parameters[name]) for name in names]
    if len(names) < 2 or not all(start * value < 0.0 for start, value in pairs):
        return ()
    errors = (_SETTINGS.deviations * fit.standard_errors[name] for name in names)
    if not all(abs(value) > error for (_, value), error in zip(pairs, errors, strict=True)):
        return ()
    return (_REVERSED.format(names=", ".join(names), channels=_channels(plant)),)


def _divisors(plant: Plant) -> list[str]:
    """Free parameters whose reciprocal keeps its sign, by a bound."""
    scales = step_scales(plant).scales
    return [
        name
        for name, scale in zip(plant.names, scales, strict=True)
        if scale == RECIPROCAL and name not in plant.fixed
    ]


def _is_large(plant: Plant, name: str, value: float) -> bool:
    """Whether an estimate is on the bound of the largest size, or far beyond its nominal value."""
    i = plant.names.index(name)
    outer = plant.upper[i] if plant.parameters[name] > 0 else plant.lower[i]
    return bool(value == outer) or abs(value) >= _SETTINGS.min_ratio * abs(plant.parameters[name])
