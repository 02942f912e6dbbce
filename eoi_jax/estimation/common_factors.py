r"""Parameters of which no record tells more than some combinations: common factors.

    J ÿ = K u - b ẏ - k y        is the same equation with 2J, 2K, 2b and 2k.

A change d of the parameters leaves every output as it is where, at every instant, state and input,

    ∂f/∂θ d + ∂f/∂z w = 0       ∂g/∂θ d + ∂g/∂z w - ∂w/∂z g = 0       ∂z₀/∂θ d = w(z₀)

for some motion w of the internal states, which nobody measures. Here w = diag(ζ) z + η: internal
states may be scaled and shifted, as those of an electrical or a chemical model in other units. All
this is linear in (d, ζ, η), so that the changes are the null space of a matrix with a row for each
equation and probe. Probes are fixed pseudo-random points, so that it is the equations that are
judged and not the motion of a record: more motion tells no more.

Source: P. J. Olver, *Applications of Lie Groups to Differential Equations*, section 2.3 (the
condition of invariance); for identifiability: J. W. T. Yates, N. D. Evans, M. J. Chappell,
Automatica 45 (2009) 2585.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax._checks import is_or_are
from eoi_jax.compiler.pointwise import along, slopes_along
from eoi_jax.estimation.regression.identifiability import (
    groups_of,
    identifiable_combinations,
    reduced,
)
from eoi_jax.models.affine import affine_parameters
from eoi_jax.models.plant import Plant, State


@dataclass(frozen=True)
class CommonFactorSettings:
    """How the equations are probed."""

    seed: int = 0
    probes: int = 96
    # Of each coordinate, on either side of zero: every usual unit, and what saturates.
    magnitudes: tuple[float, float] = (1e-4, 1e3)
    beyond: tuple[float, float] = (0.5, 3.0)  # over the size of a parameter, which may be a limit
    spread: tuple[float, float] = (0.8, 1.25)  # factors of the parameters
    max_rounding: float = 1e4  # of the smallest singular value over the largest, in roundings
    tolerance: float = 1e-3  # of exponents that stand for whole numbers


_SETTINGS = CommonFactorSettings()


_SWITCHES = (
    "it stands in a condition alone, which jumps, so that a small change of it changes no output; "
    "write a delay of an input (`input_delay`) or a smooth switch, as 0.5*(1 + tanh((t - t0)/w))"
)


@dataclass(frozen=True)
class CommonFactor:
    """Parameters that no record determines, each by itself.

    Attributes:
        parameters: names.
        combinations: of them that records determine, such as ``("K/J", "b/J")``; empty where no
            products and no sums of small whole weights are.
        fix: a parameter with which, fixed, the equations determine the others; of several such
            changes one for each.
        switches: whether the equations depend on it in a condition alone, as ``t > delay``: every
            derivative is zero, though outputs change.
    """

    parameters: tuple[str, ...]
    combinations: tuple[str, ...]
    fix: tuple[str, ...]
    switches: bool = False

    @property
    def sentence(self) -> str:
        """What is wrong, and what to do about it."""
        names = listed(self.parameters)
        advice = f"fix {listed(self.fix)} (`fixed = {_quoted(self.fix)}`)"
        if self.switches:
            return f"no derivative by {names}: {_SWITCHES}, or {advice}"
        if not self.combinations and len(self.parameters) == len(self.fix):
            return f"no trace in the data of {names}: no output depends on it, {advice}"
        text = f"{names} have a common factor and cannot be told apart by any record"
        if self.combinations:
            verb = is_or_are(len(self.combinations))
            text = f"{text}, only {listed(self.combinations)} {verb} determined"
        return f"{text}: {advice}"


def common_factors(plant: Plant) -> tuple[CommonFactor, ...]:
    """The common factors of the free parameters of a plant, from its equations alone.

    Args:
        plant: at any values of its parameters.

    Returns:
        One for each group of parameters that share changes which leave all outputs as they are.
    """
    theta = _probe_parameters(plant)
    changes = _null_space(_conditions(plant, theta), int(np.sum(plant.free)))
    if not changes.shape[1]:
        return ()
    # Divisors last: what is determined is then written over them.
    order = np.argsort(~affine_parameters(plant), kind="stable")
    order = order[np.asarray(plant.free)[order] > 0]
    rows = np.zeros((changes.shape[1], len(plant.names)))
    rows[:, np.flatnonzero(plant.free)] = changes.T
    rows, pivots = reduced(rows[:, order] / theta[order])
    rows = np.where(np.abs(rows) > _SETTINGS.tolerance, rows, 0.0)
    names = tuple(plant.names[i] for i in order)
    factors = []
    for group in groups_of(rows.T):
        directions = rows[group].T * theta[order][:, None]
        involved, combinations = identifiable_combinations(
            directions, theta[order], names, _SETTINGS.tolerance
        )
        parameters = tuple(name for name in plant.names if name in involved)
        fix = tuple(names[pivots[k]] for k in group)
        switches = len(parameters) == 1 and _switches(plant, theta, parameters[0])
        factors.append(CommonFactor(parameters, combinations, fix, switches))
    return tuple(factors)


def without_common_factors(plant: Plant, factors: Sequence[CommonFactor]) -> Plant:
    """The plant with a parameter of each common factor held at its value.

    Args:
        plant: with the values at which they are held.
        factors: its common factors.

    Returns:
        The plant itself where there are none, or where nothing would be left to estimate.
    """
    held = tuple(name for factor in factors for name in factor.fix)
    if not held or len(held) == int(np.sum(plant.free)):
        return plant
    return plant.declared_anew(fixed=held)


def _probe_parameters(plant: Plant) -> Float[np.ndarray, " np"]:
    """Values of no special relation, such as two that are equal or one that is zero."""
    theta = np.asarray(plant.theta, dtype=float)
    draw = np.random.default_rng(_SETTINGS.seed)
    spread = draw.uniform(*_SETTINGS.spread, len(theta))
    moved = np.where(theta != 0, theta, 1.0) * spread
    within = (moved >= plant.lower) & (moved <= plant.upper) & (np.asarray(plant.free) > 0)
    return np.where(within, moved, theta)


def _conditions(plant: Plant, theta: Float[np.ndarray, " np"]) -> Float[np.ndarray, "rows columns"]:
    """The matrix whose null space holds (d, ζ, η), of the free parameters."""
    nz = len(plant.initial_internal)
    rows = _rows(plant, theta, *_probes(plant, theta))
    start = np.asarray(_start_rows(plant, jnp.asarray(theta)))
    actuated = _actuator_rows(plant, theta)
    matrix = np.concatenate([rows.reshape(-1, rows.shape[-1]), start, actuated])
    columns = np.concatenate([np.asarray(plant.free) > 0, np.ones(2 * nz, bool)])
    matrix = matrix[:, columns]
    return matrix[np.all(np.isfinite(matrix), axis=1)]


def _probes(
    plant: Plant, theta: Float[np.ndarray, " np"]
) -> tuple[tuple[np.ndarray, ...], Float[np.ndarray, "probes nz"]]:
    """Times, outputs and inputs, and internal states."""
    nz = len(plant.initial_internal)
    r, ny, nu = plant.rows, len(plant.outputs), len(plant.inputs)
    draw = np.random.default_rng(_SETTINGS.seed)
    low, high = np.log(_SETTINGS.magnitudes)
    size = _SETTINGS.probes, 1 + r * ny + nu + nz
    sizes = np.abs(theta[theta != 0]) if np.any(theta) else np.ones(1)
    near = draw.choice(sizes, size) * draw.uniform(*_SETTINGS.beyond, size)
    points = np.concatenate([np.exp(draw.uniform(low, high, size)), near])
    points *= draw.choice([-1.0, 1.0], points.shape)
    time, points = np.abs(points[:, 0]), points[:, 1:]
    y, u, z = np.split(points, [r * ny, r * ny + nu], axis=1)
    return (time, y.reshape(-1, r, ny), u), z


def _switches(plant: Plant, theta: Float[np.ndarray, " np"], name: str) -> bool:
    """Whether half or twice a parameter without a derivative changes the equations."""
    axes, (probes, z) = ("fixed", "rows", "fixed", "rows"), _probes(plant, theta)
    at = plant.names.index(name)
    values = (
        np.where(np.arange(len(theta)) == at, size * theta, theta) for size in (1.0, 0.5, 2.0)
    )
    rates, *others = (along(_rates, axes, plant, probes, value, z) for value in values)
    return any(not np.array_equal(rates, moved, equal_nan=True) for moved in others)


def _rows(
    plant: Plant,
    theta: Float[np.ndarray, " np"],
    probes: tuple[np.ndarray, ...],
    z: Float[np.ndarray, "probes nz"],
) -> Float[np.ndarray, "probes equations columns"]:
    """Rows of f and g at each probe."""
    axes, args = ("fixed", "rows", "fixed", "rows"), (plant, probes, theta, z)
    by_theta, by_z = (slopes_along(_rates, axes, number, *args) for number in (2, 3))
    ny, nz = len(plant.outputs), z.shape[1]
    shifts = np.zeros((len(z), ny + nz, nz))
    shifts[:, ny + np.arange(nz), np.arange(nz)] = along(_rates, axes, *args)[:, ny:]
    return np.concatenate([by_theta, by_z * z[:, None] - shifts, by_z], axis=2)


def _rates(plant: Plant, probe: tuple[Any, ...], theta: Any, z: Any) -> Any:
    """f and g."""
    t, y, u = probe
    f = plant.derivative(t, State(y, z), u, theta)
    return jnp.concatenate([f, plant.internal_rate(t, State(y, z), u, theta)])


def _start_rows(plant: Plant, theta: Any) -> Any:
    """Rows of the start of the internal states, which changes with them, if it is not free."""
    by_theta = jax.jacfwd(plant.internal_start)(theta)
    z = plant.internal_start(theta)
    rows = jnp.concatenate([by_theta, -jnp.diag(z), -jnp.eye(len(z))], axis=1)
    return rows[~plant.free_internal]


def _actuator_rows(plant: Plant, theta: Float[np.ndarray, " np"]) -> Float[np.ndarray, "rows _"]:
    """Rows of delays and lags of the inputs, which must not change."""
    nz = len(plant.initial_internal)
    if plant.actuator is None:
        return np.zeros((0, len(theta) + 2 * nz))
    draw = np.random.default_rng(_SETTINGS.seed)
    u = jnp.asarray(draw.standard_normal((_SETTINGS.probes, len(plant.inputs))))
    # A step of a tenth of what the actuator does, whatever its unit, is among these.
    slopes = [
        np.asarray(
            jax.jacfwd(lambda p, t=t: plant.driven(t, u, p))(jnp.asarray(theta))
        ).reshape(-1, len(theta))
        for t in (step * jnp.arange(len(u)) for step in np.geomspace(1e-4, 1e2, 13))
    ]  # fmt: skip
    stacked = np.concatenate(slopes)
    return np.concatenate([stacked, np.zeros((len(stacked), 2 * nz))], axis=1)


def _null_space(matrix: Float[np.ndarray, "rows columns"], free: int) -> np.ndarray:
    """Changes of the first `free` columns that fulfil all conditions, one a column."""
    length = np.sqrt(np.sum(matrix**2, axis=0))
    scale = np.where(length > 0, length, 1.0)
    scaled = matrix / scale
    largest = np.max(np.abs(scaled), axis=1, keepdims=True)
    # Rows count alike: a probe far out must not hide another.
    scaled = scaled[largest[:, 0] > 0] / largest[largest[:, 0] > 0]
    weight = np.sqrt(np.sum(scaled**2, axis=0))
    weight = np.where(weight > 0, weight, 1.0)
    # At least as many rows as columns, so that there is a vector for each column.
    square = np.concatenate([scaled / weight, np.zeros((len(weight), len(weight)))])
    _, values, vectors = np.linalg.svd(square, full_matrices=False)
    threshold = _SETTINGS.max_rounding * np.finfo(jnp.result_type(float)).eps * values[0]
    null = (vectors[values <= threshold] / (weight * scale)).T[:free]
    # Some move internal states only, which shows in no parameter.
    basis, weights, _ = np.linalg.svd(null * scale[:free, None], full_matrices=False)
    return (
        basis[:, weights > _SETTINGS.tolerance * np.max(weights, initial=0.0)] / scale[:free, None]
    )


def listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _quoted(names: Sequence[str]) -> str:
    return "[" + ", ".join(f'"{name}"' for name in names) + "]"
