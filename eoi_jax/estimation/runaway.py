"""Parameters that run off: any value beyond some point fits as well.

F tanh(k v) is dry friction from some k on, and a record that cannot resolve the slope at rest says
of k only that it is large. An estimate then ends anywhere out there, where rounding or noise put
it; with its own error the others' may lose theirs, and a simulation becomes stiff for nothing. So
such a parameter is held at the value nearest to the nominal one, in steps of a factor, with which
the fit is as good, and the others are estimated beside it.
"""

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import bent_parameters


@dataclass(frozen=True)
class RunawaySettings:
    """When a parameter has run off, and how it is brought back."""

    min_ratio: float = 10.0  # to the nominal value, or of it: guesses are mostly nearer
    min_relative_error: float = 1.0  # standard error over the value: its size is not known
    step: float = 10.0  # ratio of the values at which it is tried to be held
    max_rise: float = 1e-2  # of the logarithm of the index or of the mean square error


_SETTINGS = RunawaySettings()


def runaways(
    plant: Plant, values: Mapping[str, float], errors: Callable[[], Mapping[str, float]]
) -> tuple[str, ...]:
    """Names of the parameters that ran off.

    A parameter in which the equations are affine cannot: it is as large as the records say, or
    they leave it open.

    Args:
        plant: with the nominal parameters.
        values: the estimate.
        errors: its standard errors, asked for only if some parameter is far from its nominal value.
    """
    if plant.is_affine:
        return ()
    ratio = np.abs(np.asarray(list(values.values()))) / np.maximum(np.abs(plant.theta), 1e-300)
    far = (ratio >= _SETTINGS.min_ratio) | (ratio <= 1.0 / _SETTINGS.min_ratio)
    if not np.any(far):
        return ()
    far &= bent_parameters(plant)
    if not np.any(far):
        return ()
    known = errors()
    return tuple(
        name
        for name, is_far in zip(plant.names, far, strict=True)
        if is_far and known[name] >= _SETTINGS.min_relative_error * abs(values[name])
    )


def held_runaways(
    plant: Plant,
    fit: Any,
    refit: Callable[[Plant], Any],
    cost: Callable[[Any], float],
) -> Any:
    """An estimate with the parameters that ran off held, or the estimate itself.

    Args:
        plant: with the nominal parameters.
        fit: an `Identification` or a `Refinement` of it, with a fit.
        refit: makes another one from a plant in which they are fixed.
        cost: logarithm of what a fit minimises.
    """
    if fit.common_factors:
        return fit
    values = fit.parameters
    names = runaways(plant, values, lambda: fit.standard_errors)
    if not names or len(names) == int(np.sum(plant.free)):
        return fit
    refitted, fixed_values = fit, dict(values)
    ends = dict(zip(plant.names, zip(plant.lower, plant.upper, strict=True), strict=True))
    for count in itertools.count(1):
        fixed_values = {
            name: float(np.clip(_towards(plant.parameters[name], values[name], count), *ends[name]))
            for name in names
        }
        is_last = all(fixed_values[name] == values[name] for name in names)
        refitted = refit(plant.declared_anew({**values, **fixed_values}, fixed=names))
        as_good = is_last or is_as_good(cost(refitted), cost(fit))
        if refitted.status.ok and as_good:
            break
        if is_last:
            return fit
    notes = [
        _RAN_OFF.format(name, values[name], plant.parameters[name], _side(plant, name, values),
                        fixed_values[name])
        for name in names
    ]  # fmt: skip
    return replace(refitted, nominal=plant, notes=(*refitted.notes, *notes))


def is_as_good(held: float, free: float) -> bool:
    """Whether a fit with parameters held is as good as one with them free, by their `cost`."""
    return held <= free + _SETTINGS.max_rise


_RAN_OFF = (
    "{} ran off to {:.3g} from {:.3g}, and any {} value fits as well: it is held at {:.3g}, and "
    "the errors of the others hold beside it"
)


def _side(plant: Plant, name: str, values: Mapping[str, float]) -> str:
    return "larger" if abs(values[name]) > abs(plant.parameters[name]) else "smaller"


def _towards(nominal: float, value: float, count: int) -> float:
    """The value `count` steps from the nominal one, not beyond the estimate."""
    size = abs(nominal) * _SETTINGS.step ** (count if abs(value) > abs(nominal) else -count)
    beyond = size >= abs(value) if abs(value) > abs(nominal) else size <= abs(value)
    return value if beyond else float(np.copysign(size, value))
