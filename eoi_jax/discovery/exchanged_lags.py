r"""Two lags in series, of which a fit has taken the slow one for that of the sensor.

Behind a linear plant of first order,

    ẏ = f(y, u),   a = -∂f/∂y,

a lag L of a sensor or of an actuator commutes with it. The records are the same with 1/(a L) of f
and with a lag of 1/a. A plant without a loss that the records show has L → ∞, of which they tell no
size; exchanged they tell that of the lag, and leave open the loss.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.models.augmented import Placed
from eoi_jax.models.effects import ActuatorLag, SensorLag
from eoi_jax.models.jacobians import Points, derivatives, points_of, state_slopes
from eoi_jax.models.plant import Plant

_INSTANTS = 200  # of each record, at which both plants are compared
_EVALUATIONS = 200  # of f, at most
_LINEAR = 1e-3  # largest relative change of a along a record, and of f that is not met


def exchanged(
    declared: Plant, placed: Placed, lag: float, records: Sequence[Record]
) -> Mapping[str, float] | None:
    """Values with which the plant has the slow lag, and the effect the fast one.

    Args:
        declared: the plant without the effect, with its values.
        placed: the lag; any other effect has none to exchange.
        lag: its value [s].
        records: along which the plant is linear.

    Returns:
        Parameters of the plant and of the effect by name; None where the plant is not linear, has
        other states or several inputs before one lag, is the slower one, or where its parameters
        cannot take the change.
    """
    if not commutes(declared, placed):
        return None
    points = [points_of(record, 1, _INSTANTS) for record in records]
    slopes = np.concatenate([state_slopes(declared, *at).ravel() for at in points])
    loss = -float(np.mean(slopes))
    if not (np.ptp(slopes) <= _LINEAR * abs(loss) and 1.0 < loss * lag < np.inf):
        return None
    values = _scaled(declared, points, 1.0 / (loss * lag))
    return None if values is None else {**values, placed.names[0]: 1.0 / loss}


def commutes(plant: Plant, placed: Placed) -> bool:
    """Whether an effect is a lag in series with a plant of one output, of first order.

    Args:
        plant: without it.
        placed: the effect.
    """
    if plant.degrees != (1,) or plant.internal:
        return False
    if isinstance(placed.effect, SensorLag):
        return True
    return isinstance(placed.effect, ActuatorLag) and len(plant.inputs) == 1


def _scaled(plant: Plant, points: Sequence[Points], share: float) -> dict[str, float] | None:
    """Values of the parameters with which f has this share of what it has; None without any."""
    from scipy.optimize import least_squares  # only needed here

    names = [name for name in plant.names if name not in plant.fixed]
    free = [plant.names.index(name) for name in names]

    def slope(plant: Plant) -> Float[np.ndarray, " samples"]:
        return np.concatenate([derivatives(plant, *at).ravel() for at in points])

    target = share * slope(plant)
    size = float(np.linalg.norm(target))
    if not 0.0 < size < np.inf:
        return None
    start = np.array([plant.parameters[name] for name in names])

    def error(x: Float[np.ndarray, " free"]) -> Float[np.ndarray, " samples"]:
        values = dict(zip(names, x.tolist(), strict=True))
        return np.nan_to_num((slope(plant.with_parameters(values)) - target) / size, nan=1.0)

    bounds = np.asarray(plant.lower)[free], np.asarray(plant.upper)[free]
    scale = np.where(start == 0.0, 1.0, np.abs(start))
    fit = least_squares(error, start, bounds=bounds, x_scale=scale, max_nfev=_EVALUATIONS)
    if not np.linalg.norm(fit.fun) <= _LINEAR:
        return None
    return {**plant.parameters, **dict(zip(names, fit.x.tolist(), strict=True))}
