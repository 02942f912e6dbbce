r"""The scale on which a parameter is moved by a step of Gauss-Newton.

A step Δ of a linearised model is right where the model is linear. A parameter in which f and g are
affine is moved by Δ. One that divides is moved so that its reciprocal changes as that model says,

    1/θ' = 1/θ - Δ/θ²,

which is exact where f is affine in 1/θ, as (K u - b ẏ)/J is in J. Nothing happens to f where 1/θ
passes zero: a term vanishes and comes back with the other sign. So a divisor without bounds passes
through infinity, from one sign to the other, where the records ask for it (a sensor that counts
backwards); a bound keeps the sign. Any other that must keep its sign, by its bounds or because f is
not finite at zero, is moved on a logarithmic scale, θ' = θ exp(Δ/θ). No step of the last two
changes the size by more than a factor of eight, and none reaches zero, while a friction or a
stiffness, in which f is affine, ends on its bound of zero exactly where the records say so.

A parameter a in which f is affine may be multiplied by powers of others, as K is by 1/J: its slope
is ∂f/∂a ∝ Π θ_j^e_j. Then it is the product c = a Π θ_j^e_j that is moved on a linear scale,

    a' = (a + κ) Π (θ_j'/θ_j)^-e_j,     κ = Δ_a + a Σ e_j Δ_j/θ_j,

for the step of a would else make up for that of the linearised 1/J, which is not taken. With κ in
the place of Δ_a, a bound of zero is κ ≥ -a. Slopes with an affine parameter are affine in 1/θ_j
too: there e_j = -1, and a' changes its sign with θ_j.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.compiler.pointwise import along, slopes_along
from eoi_jax.models.plant import Plant, State

LINEAR, LOGARITHMIC, RECIPROCAL, SIGNED_RECIPROCAL = 0, 1, 2, 3


@dataclass(frozen=True)
class StepScaleSettings:
    """How scales are found, and how long a step may be."""

    max_factor: float = 8.0  # of a parameter, by one step: what a user's guess is mostly within
    probes: int = 32
    magnitudes: tuple[float, float] = (1e-2, 1e2)  # of states and inputs at the probes


_SETTINGS = StepScaleSettings()


@dataclass(frozen=True)
class StepScales:
    """How a step of a linearised model moves the parameters of a plant.

    Hashable, so that a compiled program may depend on it.

    Attributes:
        scales: of each parameter, `LINEAR`, `LOGARITHMIC`, `RECIPROCAL` (of one sign) or
            `SIGNED_RECIPROCAL`.
        exponents: e_j in the slope of each parameter (rows) with the others (columns); zero where
            it is no product of powers.
    """

    scales: tuple[int, ...]
    exponents: tuple[tuple[float, ...], ...]

    @property
    def trivial(self) -> bool:
        """Whether every parameter is moved by the step itself."""
        return not any(self.scales) and not self.coupled

    def of(self, places: Sequence[int]) -> "StepScales":
        """Those of some of the parameters."""
        rows = tuple(tuple(self.exponents[i][j] for j in places) for i in places)
        return StepScales(tuple(self.scales[i] for i in places), rows)

    @property
    def signed(self) -> bool:
        """Whether a divisor may change its sign."""
        return SIGNED_RECIPROCAL in self.scales

    @property
    def coupled(self) -> bool:
        """Whether a parameter is multiplied by powers of others."""
        return any(map(any, self.exponents))


def step_scales(plant: Plant) -> StepScales:
    """Scales and exponents of all parameters.

    Args:
        plant: at the parameters near which it is probed.
    """
    if plant.is_affine:
        count = len(plant.names)
        return StepScales((LINEAR,) * count, ((0.0,) * count,) * count)
    lower, upper = np.asarray(plant.lower), np.asarray(plant.upper)
    signed = (lower >= 0.0) | (upper <= 0.0)
    unbounded = np.isinf(lower) & np.isinf(upper)
    return _scales(*_key(plant), tuple(signed.tolist()), tuple(unbounded.tolist()))


def bent_parameters(plant: Plant) -> Bool[np.ndarray, " np"]:
    """Free parameters in which f or g is not affine while the others are constant.

    Args:
        plant: at the parameters near which it is probed.
    """
    if plant.is_affine:
        return np.zeros(len(plant.names), dtype=bool)
    return _structure(*_key(plant))[0]


def _key(plant: Plant) -> tuple[Any, tuple[float, ...], Any]:
    """What the structure of a plant depends on; the type is that of the probes."""
    theta = tuple(np.asarray(plant.theta, float).tolist())
    return jax.tree.structure(plant), theta, jnp.result_type(float)


def _plant_of(structure: Any, theta: tuple[float, ...]) -> Plant:
    """The plant without its bounds."""
    return jax.tree.unflatten(structure, [np.asarray(theta)] * structure.num_leaves)


@functools.lru_cache(maxsize=64)
def _structure(
    structure: Any, theta: tuple[float, ...], dtype: Any
) -> tuple[Bool[np.ndarray, " np"], Float[np.ndarray, "np np"]]:
    """Parameters in which f or g is bent, and the powers of these in the slopes with the others."""
    plant, values = _plant_of(structure, theta), np.asarray(theta)
    tolerance = float(np.sqrt(jnp.finfo(dtype).eps))
    free = np.flatnonzero(np.asarray(plant.free) * (values != 0)).tolist()
    nominal = _slopes(plant, values)
    doubled = {i: _slopes(plant, _moved(values, i, 2.0 * theta[i])) for i in free}
    bent = np.zeros(len(values), dtype=bool)
    for i in free:
        bent[i] = _power(nominal[..., i], doubled[i][..., i], tolerance) != 0.0
    powers = np.zeros((len(values), len(values)))
    for j in np.flatnonzero(bent).tolist():
        for i in free:
            if not bent[i]:
                power = _power(nominal[..., i], doubled[j][..., i], tolerance)
                powers[i, j] = power if np.isfinite(power) else 0.0
    return bent, powers


@functools.lru_cache(maxsize=64)
def _scales(
    structure: Any,
    theta: tuple[float, ...],
    dtype: Any,
    signed: tuple[bool, ...],
    unbounded: tuple[bool, ...],
) -> StepScales:
    """`step_scales` of a plant whose bounds leave some parameters one sign, and others free."""
    plant, values = _plant_of(structure, theta), np.asarray(theta)
    bent, powers = _structure(structure, theta, dtype)
    tolerance = float(np.sqrt(jnp.finfo(dtype).eps))
    scales = np.zeros(len(values), int)
    for i in np.flatnonzero(bent).tolist():
        if signed[i] or _is_singular(plant, values, i):
            is_divisor = _is_reciprocal(plant, values, i, tolerance)
            divisor = SIGNED_RECIPROCAL if unbounded[i] else RECIPROCAL
            scales[i] = divisor if is_divisor else LOGARITHMIC
    return StepScales(tuple(scales.tolist()), tuple(map(tuple, powers.tolist())))


def _power(nominal: np.ndarray, doubled: np.ndarray, tolerance: float) -> float:
    """The power of a parameter in a slope, from the slope where it is doubled; NaN if it is none.

    Zero also where the slope is not finite or zero at all probes.
    """
    usable = np.isfinite(nominal) & np.isfinite(doubled) & ((nominal != 0) | (doubled != 0))
    if not np.any(usable):
        return 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = doubled[usable] / nominal[usable]
        even = np.all(np.abs(ratio - ratio[0]) <= tolerance * np.abs(ratio[0]))
        return round(float(np.log2(ratio[0])), 6) + 0.0 if even and ratio[0] > 0 else np.nan


def _moved(theta: Float[np.ndarray, " np"], i: int, value: float) -> Float[np.ndarray, " np"]:
    moved = theta.copy()
    moved[i] = value
    return moved


def _rates(plant: Plant, probe: tuple[Any, ...], theta: Any) -> Any:
    """f and g at these parameters."""
    t, y, u, z = probe
    f = plant.derivative(t, State(y, z), u, theta)
    return jnp.concatenate([f, plant.internal_rate(t, State(y, z), u, theta)])


def _evaluated(plant: Plant, theta: Float[np.ndarray, " np"]) -> np.ndarray:
    """f and g at fixed pseudo-random points."""
    with np.errstate(all="ignore"):
        return along(_rates, ("fixed", "rows", "fixed"), plant, _probes(plant), theta)


def _slopes(plant: Plant, theta: Float[np.ndarray, " np"]) -> np.ndarray:
    """∂f/∂θ and ∂g/∂θ there."""
    with np.errstate(all="ignore"):
        return slopes_along(_rates, ("fixed", "rows", "fixed"), 2, plant, _probes(plant), theta)


def _probes(plant: Plant) -> tuple[np.ndarray, ...]:
    """Times, states and inputs."""
    draw = np.random.default_rng(0)
    r, ny, nu, nz = plant.rows, len(plant.outputs), len(plant.inputs), len(plant.initial_internal)
    low, high = np.log(_SETTINGS.magnitudes)
    size = _SETTINGS.probes, 1 + r * ny + nu + nz
    points = np.exp(draw.uniform(low, high, size)) * draw.choice([-1.0, 1.0], size)
    y, u, z = np.split(points[:, 1:], [r * ny, r * ny + nu], axis=1)
    return np.abs(points[:, 0]), y.reshape(-1, r, ny), u, z


def _is_singular(plant: Plant, theta: Float[np.ndarray, " np"], i: int) -> bool:
    """Whether f or g, finite at θ, is not finite where parameter i is zero."""
    nominal, at_zero = (_evaluated(plant, values) for values in (theta, _moved(theta, i, 0.0)))
    return bool(np.any(np.isfinite(nominal) & ~np.isfinite(at_zero)))


def _is_reciprocal(plant: Plant, theta: Float[np.ndarray, " np"], i: int, tolerance: float) -> bool:
    """Whether f and g are affine in the reciprocal of parameter i."""
    first, second, third = (
        _evaluated(plant, _moved(theta, i, float(theta[i]) / factor)) for factor in (1.0, 2.0, 3.0)
    )
    finite = np.isfinite(first) & np.isfinite(second) & np.isfinite(third)
    first, second, third = first[finite], second[finite], third[finite]
    bend = np.abs(first - 2.0 * second + third)
    size = np.abs(first) + np.abs(second) + np.abs(third)
    return bool(np.any(finite) and np.all(bend <= tolerance * size))


def coordinates(theta: Any, scales: StepScales, xp: Any = np) -> Any:
    """∂Δ/∂x, of steps x with κ in the place of Δ of what is multiplied; shape (…, np, np).

    Args:
        theta: parameters, shape (…, np).
        scales: of `step_scales`.
        xp: `numpy` or `jax.numpy`.
    """
    safe = xp.where(theta != 0, theta, 1.0)
    coupled = xp.asarray(scales.exponents) * theta[..., :, None] / safe[..., None, :]
    return xp.eye(theta.shape[-1]) - coupled


def scaled_step(theta: Any, step: Any, scales: StepScales, xp: Any = np) -> Any:
    """The change of the parameters by a step of the linearised model, each on its scale.

    Args:
        theta: parameters, shape (…, np).
        step: of the linearised model, shape (…, np).
        scales: of `step_scales`.
        xp: `numpy` or `jax.numpy`.
    """
    if scales.trivial:
        return step
    kinds = xp.asarray(scales.scales)
    moved = theta + _alone(theta, step, kinds, xp)
    if not scales.coupled:
        return moved - theta
    exponents = xp.asarray(scales.exponents)
    ratio = moved / xp.where(theta != 0, theta, 1.0)
    # One that changes its sign multiplies by no power, but for a divisor: by the reciprocal.
    flipped = (kinds == SIGNED_RECIPROCAL) & (ratio < 0)
    size = xp.where(flipped, -ratio, ratio)
    logarithm = xp.where(size > 0, xp.log(xp.where(size > 0, size, 1.0)), 0.0)
    relative = xp.where(size > 0, step / xp.where(theta != 0, theta, 1.0), 0.0)
    power, share = (xp.einsum("ij,...j->...i", exponents, part) for part in (logarithm, relative))
    product = (theta + step + theta * share) * _sign(flipped, exponents, xp) * xp.exp(-power)
    return xp.where(xp.any(exponents != 0, axis=-1), product, moved) - theta


def _alone(theta: Any, step: Any, scales: Any, xp: Any) -> Any:
    """The change of each parameter on its scale."""
    most = _SETTINGS.max_factor
    relative = step / xp.where(theta != 0, theta, 1.0)
    logarithmic = xp.exp(xp.clip(relative, -np.log(most), np.log(most)))
    change = 1.0 - relative  # of the reciprocal, a factor
    sign = xp.where((scales == SIGNED_RECIPROCAL) & (change < 0), -1.0, 1.0)
    reciprocal = sign / xp.clip(sign * change, 1.0 / most, most)
    factor = xp.where(scales >= RECIPROCAL, reciprocal, logarithmic)
    return xp.where((scales == LINEAR) | (theta == 0), step, theta * (factor - 1.0))


def shortened(theta: Any, step: Any, scales: StepScales, xp: Any = np) -> Any:
    """A step so short that the reciprocal of no divisor without bounds grows beyond the factor.

    Near its zero that is little of a step, and the rest of it, taken in full, would belong to a
    reciprocal that is not there yet: a search would never get away from zero.

    Args:
        theta: parameters, shape (…, np).
        step: of the linearised model, shape (…, np).
        scales: of `step_scales`.
        xp: `numpy` or `jax.numpy`.
    """
    if not scales.signed:
        return step
    most, kinds = _SETTINGS.max_factor, xp.asarray(scales.scales)
    relative = step / xp.where(theta != 0, theta, 1.0)
    longest = xp.where(relative > 0, most + 1.0, most - 1.0)
    share = longest / xp.maximum(xp.abs(relative), longest)
    share = xp.where(kinds == SIGNED_RECIPROCAL, share, 1.0)
    return step * xp.min(share, axis=-1, keepdims=True)


def linear_step(theta: Any, change: Any, scales: StepScales, xp: Any = np) -> Any:
    """The step of the linearised model of which a change is the scaled one: `scaled_step` undone.

    It says what the linearised model expects of a change, where a bound or the largest factor has
    shortened the step.

    Args:
        theta: parameters, shape (…, np).
        change: of the parameters, shape (…, np).
        scales: of `step_scales`.
        xp: `numpy` or `jax.numpy`.
    """
    if scales.trivial:
        return change
    kinds, safe = xp.asarray(scales.scales), xp.where(theta != 0, theta, 1.0)
    ratio = (theta + change) / safe
    ratio = xp.where((theta != 0) & (ratio != 0), ratio, 1.0)
    logarithm = xp.log(xp.abs(ratio))
    scaled = theta * xp.where(kinds >= RECIPROCAL, 1.0 - 1.0 / ratio, logarithm)
    uncoupled = xp.where((kinds == LINEAR) | (theta == 0), change, scaled)
    if not scales.coupled:
        return uncoupled
    exponents = xp.asarray(scales.exponents)
    flipped = (kinds == SIGNED_RECIPROCAL) & (ratio < 0)
    is_power = (ratio > 0) | flipped
    logarithm, relative = (xp.where(is_power, part, 0.0) for part in (logarithm, uncoupled / safe))
    power, share = (xp.einsum("ij,...j->...i", exponents, part) for part in (logarithm, relative))
    product = (theta + change) * _sign(flipped, exponents, xp) * xp.exp(power)
    step = product - theta - theta * share
    return xp.where(xp.any(exponents != 0, axis=-1), step, uncoupled)


def _sign(flipped: Any, exponents: Any, xp: Any) -> Any:
    """Of the powers of divisors some of which change their sign, in the slopes of all others."""
    return xp.prod(xp.where(flipped[..., None, :] & (exponents == -1.0), -1.0, 1.0), axis=-1)


def step_room(
    theta: Any, lower: Any, upper: Any, scales: StepScales
) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest steps that `scaled_step` keeps in the bounds, κ where it takes κ.

    For κ only if the bound is zero, or the others stay.
    """
    kinds = np.asarray(scales.scales)

    def room(limit: Any, beyond: float) -> np.ndarray:
        # A limit of zero, at infinity or of the other sign is not reached.
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithmic = theta * np.log(limit / theta)
            reciprocal = theta * (1.0 - theta / limit)
        scaled = np.where(kinds >= RECIPROCAL, reciprocal, logarithmic)
        reached = (np.sign(limit) * np.sign(theta) > 0) & np.isfinite(limit) & np.isfinite(scaled)
        return np.where(
            (kinds == LINEAR) | (theta == 0), limit - theta, np.where(reached, scaled, beyond)
        )

    return room(np.asarray(lower), -np.inf), room(np.asarray(upper), np.inf)
