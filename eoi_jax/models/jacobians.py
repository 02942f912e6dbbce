"""Jacobians of a plant's highest derivatives along measured signals."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from eoi_jax.compiler.pointwise import along
from eoi_jax.compiler.programs import jit
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant, State

# Host arrays are passed to kernels directly: a conversion would run a kernel for each array.
Values = Array | np.ndarray
# Instants [s], (S,); outputs and their derivatives there, (S, r, ny); inputs, (S, nu).
Points = tuple[np.ndarray, np.ndarray, np.ndarray]


def points_of(record: Record, rows: int, count: int) -> Points:
    """Measured instants of a record, evenly chosen, with differences for derivatives of outputs.

    Args:
        record: as measured.
        rows: outputs and so many less one of their derivatives.
        count: of instants, at least, where the record has as many.
    """
    (measured,) = np.nonzero(record.valid & record.input_valid)
    chosen, motion = measured[:: max(len(measured) // count, 1)], [record.outputs]
    for _ in range(1, rows):
        motion.append(np.gradient(motion[-1], record.sample_period, axis=0))
    return record.time[chosen], np.stack(motion, axis=1)[chosen], record.inputs[chosen]


def derivatives(plant: Plant, time: Values, y: Values, u: Values) -> Float[np.ndarray, "S ny"]:
    """f at every instant, with the internal states at their initial values.

    Args:
        plant: with its parameter values.
        time: (S,) [s].
        y: outputs and their derivatives, (S, r, ny).
        u: inputs before any actuator, (S, nu).
    """
    return along(_derivative, ("fixed", "rows"), plant, (time, y, driven(plant, time, u)))


def state_slopes(
    plant: Plant, time: Values, y: Values, u: Values
) -> Float[np.ndarray, "S ny r ny"]:
    """∂f/∂y, ∂f/∂ẏ, … at every instant; arguments as of `derivatives`."""
    return along(_state_slope, ("fixed", "rows"), plant, (time, y, driven(plant, time, u)))


def input_slopes(
    plant: Plant, time: Values, y: Values, u: Values, i: int
) -> Float[np.ndarray, "S ny"]:
    """∂f/∂u_i at every instant, for the inputs behind the actuator; arguments as above."""
    rows = (time, y, driven(plant, time, u))
    return along(_input_slope, ("fixed", "rows"), plant, rows)[..., i]


def internal_response(
    plant: Plant, time: Values, y: Values, u: Values, s: Complex[np.ndarray, " frequencies"]
) -> Complex[np.ndarray, "frequencies ny ny"]:
    r"""What enters f from each output through the internal states: ∂f/∂z (sI - ∂g/∂z)⁻¹ ∂g/∂y.

    g is the rate of the internal states, which the measured outputs drive; the slopes are means
    along the record, at their initial values. A resonance rings no longer than the record: s is
    moved by one over its length, which bounds the response of an integrator too.

    Args:
        plant: as of `derivatives`, like the next three.
        time: (S,) [s].
        y: outputs and their derivatives, (S, r, ny).
        u: inputs before any actuator, (S, nu).
        s: frequencies, of the derivative as it is formed [1/s].

    Returns:
        At each frequency, in equation i from output k; zeros without internal states.
    """
    if plant.internal is None:
        return np.zeros((len(s), len(plant.outputs), len(plant.outputs)), dtype=complex)
    rows = (time, y, driven(plant, time, u))
    slopes = along(_internal_slopes, ("fixed", "rows"), plant, rows)
    by_state, free, by_output = (
        np.mean(np.nan_to_num(np.asarray(part), posinf=0.0, neginf=0.0), axis=0) for part in slopes
    )
    s = s + 1.0 / float(time[-1] - time[0])
    powers = s[:, None] ** np.arange(by_output.shape[1])
    entering = np.einsum("wm,zmk->wzk", powers, by_output)
    return by_state @ np.linalg.solve(s[:, None, None] * np.eye(len(free)) - free, entering)


def slopes_behind(
    plant: Plant, time: Values, y: Values, u: Values
) -> tuple[Float[np.ndarray, "S ny r ny"], Float[np.ndarray, "S ny nu"]]:
    """∂f/∂y, ∂f/∂ẏ, … and ∂f/∂u at every instant, of inputs behind the actuators."""
    state, by_input = (
        along(slope, ("fixed", "rows"), plant, (time, y, u))
        for slope in (_state_slope, _input_slope)
    )
    return state, by_input


def entering_outputs(
    plant: Plant, time: Values, y: np.ndarray, u: Values, instants: int = 20
) -> Bool[np.ndarray, "ny ny"]:
    """Whether output j, or a derivative of it, enters the equation of output i, at [i, j].

    It does where its absence is felt: with NaN in its place, at some instants.

    Args:
        plant: with its parameter values.
        time: (S,) [s].
        y: outputs, (S, ny).
        u: inputs before any actuator, (S, nu).
        instants: at so many of them.
    """
    chosen = np.unique(np.linspace(0, len(y) - 1, instants).astype(int))
    ny, (time, u) = y.shape[1], (np.asarray(part)[chosen] for part in (time, u))
    states = np.repeat(y[chosen, None], plant.rows, axis=1)
    enters = np.zeros((ny, ny), dtype=bool)
    for j in range(ny):
        without = states.copy()
        without[:, :, j] = np.nan
        enters[:, j] = np.any(np.isnan(derivatives(plant, time, without, u)), axis=0)
    return enters


def driven(plant: Plant, time: Values, u: Values) -> Values:
    """Inputs along a record behind the actuators of a plant, at its parameters.

    Args:
        plant: the plant.
        time: middle of each step, (S,) [s].
        u: mean over each step, (S, nu).
    """
    if plant.actuator is None:
        return u
    time, u = np.asarray(time), np.asarray(u)
    is_line = len(time) > 1 and time[1] > time[0]  # else they are instants, of which XLA makes NaN
    if is_line and has_sampled_actuator(plant):
        return plant.actuator.sampled(time, u, plant.parameters)  # pyright: ignore
    return np.asarray(_driven(plant, time, u))


def has_sampled_actuator(plant: Plant) -> bool:
    """Whether the actuators are effects of the library: NumPy evaluates them too (`sampled`)."""
    return getattr(plant.actuator, "shapes", None) is not None


@jit(static=())
def _driven(plant: Plant, time: Values, u: Values) -> Float[Array, "S nu"]:
    return plant.driven(jnp.asarray(time), jnp.asarray(u), jnp.asarray(plant.theta))


def _derivative(plant: Plant, row: tuple[Any, ...]) -> Any:
    t, y, u = row
    return plant.derivative(t, _state(plant, y), u, jnp.asarray(plant.theta))


def _state_slope(plant: Plant, row: tuple[Any, ...]) -> Any:
    t, y, u = row
    slope = jax.jacfwd(lambda y: plant.derivative(t, _state(plant, y), u, jnp.asarray(plant.theta)))
    return slope(y)


def _internal_slopes(plant: Plant, row: tuple[Any, ...]) -> Any:
    """∂f/∂z, ∂g/∂z and ∂g/∂y with the derivatives of y."""
    t, y, u = row
    theta = jnp.asarray(plant.theta)

    def rate(y: Any, z: Any) -> Any:
        return plant.internal_rate(t, State(y, z), u, theta)

    z = plant.internal_start(theta)
    by_state = jax.jacfwd(lambda z: plant.derivative(t, State(y, z), u, theta))(z)
    return by_state, jax.jacfwd(rate, 1)(y, z), jax.jacfwd(rate)(y, z)


def _input_slope(plant: Plant, row: tuple[Any, ...]) -> Any:
    t, y, u = row
    return plant.input_slopes(t, _state(plant, y), u, jnp.asarray(plant.theta))


def _state(plant: Plant, y: Any) -> State:
    return State(y, plant.internal_start(jnp.asarray(plant.theta)))
