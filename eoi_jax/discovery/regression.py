"""One set of effects fitted to the modes: least squares, and Gauss–Newton on the shapes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.cosine_modes import ModalRecord, model_rows
from eoi_jax.estimation.regression.bounded import bounded, leaves_bounds
from eoi_jax.models.augmented import Placed
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.gauss_newton import gauss_newton

_STEPS = 6  # of Gauss–Newton
_STEP = 1e-3  # of the numerical derivative, in units of the distance on the grid
_ENOUGH = 1e-3  # relative fall of the cost below which they end
_SETTLING = 40  # evaluations of a model whose parameters are fitted once more
_FAR = 1e6  # weighted error of a model that is not finite
_TRACE = 1e-12  # of the largest eigenvalue: directions below it leave no trace
_POINTS = 3  # on each side, when neighbours on the grid are far apart

Theta = Float[np.ndarray, " np"]
Free = Float[np.ndarray, " free"]
Rows = Float[np.ndarray, " rows"]
Shapes = Float[np.ndarray, " shapes"]
Make = Callable[[Placed, np.ndarray], list[CandidateColumns]]
# Of each effect with shapes: atoms a little further on in each shape; none where there are none.
Neighbours = dict[Placed, list[CandidateColumns]]


@dataclass(frozen=True)
class Base:
    """The declared model along the records, and what is known of the noise in each mode.

    Attributes:
        target: y^(r) - f at the declared parameters.
        columns: ∂f/∂θ of the free parameters, shape (rows, free).
        free: their indices among all parameters.
        noise, local: of `noise_model`.
        output: to which each row belongs.
        room: smallest and largest increment of the free parameters; None without bounds.
    """

    target: Rows
    columns: Float[np.ndarray, "rows free"]
    free: Int[np.ndarray, " free"]
    noise: Rows
    local: Rows
    output: Int[np.ndarray, " rows"]
    room: tuple[Free, Free] | None = None

    def signal_power(self, residual: Rows) -> float:
        """Σ |R|² over modes, each weighed by how far it stands above the noise (Wiener)."""
        return float(np.sum(self._signal * residual**2))

    @property
    def noise_power(self) -> float:
        """What measurement noise alone contributes to `signal_power`."""
        return float(np.sum(self._signal * self.noise))

    @property
    def whole_power(self) -> float:
        """What y^(r) itself contributes to `signal_power`."""
        return self.signal_power(np.sqrt(self.local))

    @property
    def _signal(self) -> Rows:
        local = np.maximum(self.local, 1e-300)
        return np.clip(1.0 - self.noise / local, 0.0, 1.0) ** 2


@dataclass(frozen=True)
class Fit:
    """A set of effects, fitted.

    Attributes:
        atoms: what was added; what changes the declared part first.
        theta: increments of the free declared parameters, then gains.
        residual: as modes.
        cost: Σ |R|²/S.
        physical: whether every gain is where it is physical.
    """

    atoms: tuple[CandidateColumns, ...]
    theta: Float[np.ndarray, " columns"]
    residual: Rows
    cost: float
    physical: bool

    @property
    def keys(self) -> frozenset:
        """What the set consists of."""
        return frozenset(one.placed for one in self.atoms)

    @property
    def gains(self) -> tuple[Float[np.ndarray, " gains"], ...]:
        """Of each atom."""
        return _gains(self.atoms, self.theta)


def fitted(base: Base, atoms: Sequence[CandidateColumns], power: Rows) -> Fit:
    """Weighted least squares of the declared parameters and the gains.

    Args:
        base: the declared model.
        atoms: the set; at most one that changes the declared part of the model.
        power: S of each mode.
    """
    ordered = tuple(sorted(atoms, key=lambda one: one.target is None))
    target, matrix = system(base, ordered)
    weight = 1.0 / np.sqrt(power)
    if not np.all(np.isfinite(matrix)):  # a shape at which the term overflows is no answer
        return Fit(ordered, np.zeros(matrix.shape[1]), target, np.inf, False)
    theta = solve(matrix * weight[:, None], target * weight)
    residual = target - matrix @ theta
    cost = float(np.sum(residual**2 / power))
    return Fit(ordered, theta, residual, cost, _physical(ordered, theta))


def within_bounds(base: Base, fit: Fit, power: Rows) -> Fit:
    """A set with all parameters within their bounds; itself where they are.

    The search leaves the declared parameters free, so that no effect makes up for a bound. What the
    model can then do that is made of the answer is another matter.

    Args:
        base: the declared model.
        fit: the set.
        power: S of each mode.
    """
    gains = [one for atom in fit.atoms for one in atom.placed.effect.gains]
    room = base.room or (np.full(len(base.free), -np.inf), np.full(len(base.free), np.inf))
    low = np.append(room[0], [one.lower for one in gains])[None]
    high = np.append(room[1], [one.upper for one in gains])[None]
    if not leaves_bounds(fit.theta[None], (low, high)):
        return fit
    target, matrix = system(base, fit.atoms)
    weighed = matrix / np.sqrt(power)[:, None]
    gram, right = (weighed.T @ weighed)[None], (weighed.T @ (target / np.sqrt(power)))[None]

    def solved(
        right: Float[np.ndarray, "1 columns"], inside: Bool[np.ndarray, "1 columns"]
    ) -> Float[np.ndarray, "1 columns"]:
        mask = inside[0]
        return solve_normal(gram * np.outer(mask, mask), right * mask)

    theta = bounded(solved, gram, right, fit.theta[None], (low, high))[0][0]
    residual = target - matrix @ theta
    cost = float(np.sum(residual**2 / power))
    return Fit(fit.atoms, theta, residual, cost, _physical(fit.atoms, theta))


def system(
    base: Base, atoms: Sequence[CandidateColumns]
) -> tuple[Rows, Float[np.ndarray, "rows columns"]]:
    """Target and columns of a set."""
    target, columns = base.target, base.columns
    if atoms and atoms[0].target is not None:
        assert atoms[0].slopes is not None
        target, columns = atoms[0].target, atoms[0].slopes[:, base.free]
    return target, np.concatenate([columns, *(one.columns for one in atoms)], axis=1)


@dataclass(frozen=True)
class Span:
    """What the grid of an effect says about its shapes.

    Attributes:
        step: distance between neighbours, as a rule, shape (shapes,).
        low, high: half a step beyond the ends of the grid, shape (shapes,); refinement stays
            inside.
        levels: of each shape, in order.
    """

    step: Shapes
    low: Shapes
    high: Shapes
    levels: tuple[Float[np.ndarray, " _"], ...]

    def reach(self, shape: Shapes) -> tuple[Shapes, Shapes]:
        """How far a shape may move at once, down and up: to its neighbours where these are far."""
        down, up = self.step.copy(), self.step.copy()
        for d, (levels, value) in enumerate(zip(self.levels, shape, strict=True)):
            marks = np.concatenate([[self.low[d]], levels, [self.high[d]]])
            below, above = marks[marks < value], marks[marks > value]
            down[d] = max(down[d], value - below.max() if len(below) else 0.0)
            up[d] = max(up[d], above.min() - value if len(above) else 0.0)
        return down, up


Spans = dict[Placed, Span]


def refined(base: Base, fit: Fit, power: Rows, spans: Spans, make: Make) -> Fit:
    """The set with its shapes refined: a finer grid around each, then Gauss–Newton on all.

    Args:
        base: the declared model.
        fit: to start from.
        power: S of each mode.
        spans: of the grid of each effect.
        make: atoms of an effect at given shapes (grid, shapes).
    """
    moving = [one.placed for one in fit.atoms if one.shape]
    for placed in moving:
        for d in range(len(spans[placed].step)):
            fit = _best_of_grid(base, fit, power, placed, d, spans[placed], make)
    near = {
        one.placed: _with_neighbours(one, np.asarray(one.shape), spans[one.placed], make)[1]
        for one in fit.atoms
        if one.shape
    }
    if not moving:
        return fit

    def linearise(points: list[_Shaped]) -> list[tuple[Shapes, float]]:
        return [_shape_step(base, now, power, spans) for now in points]

    def evaluate(points: list[_Shaped], steps: list[Shapes]) -> list[list[_Shaped]]:
        return [
            [_at_shapes(base, now, step, power, spans, make)]
            for now, step in zip(points, steps, strict=True)
        ]

    start = _Shaped(fit.cost, fit, near)
    return gauss_newton([start], linearise, evaluate, _ENOUGH, _STEPS).points[0].fit


class _Shaped(NamedTuple):
    """A set at its shapes.

    Attributes:
        cost: of the fit; infinite where its gains are not physical and those before were.
        fit: of the gains and the declared parameters.
        near: atoms a little further on in each shape.
    """

    cost: float
    fit: Fit
    near: Neighbours


def _best_of_grid(
    base: Base, fit: Fit, power: Rows, placed: Placed, d: int, span: Span, make: Make
) -> Fit:
    """Shape d of one effect moved between its neighbours on the grid; the others stay."""
    one, others = _parted(fit, placed)
    shapes = np.tile(np.asarray(one.shape), (2 * _POINTS + 1, 1))
    down, up = (way[d] for way in span.reach(np.asarray(one.shape)))
    share = np.linspace(-1.0, 1.0, 2 * _POINTS + 1)
    shapes[:, d] += share * np.where(share < 0.0, down, up)
    shapes = np.clip(shapes, span.low, span.high)
    trials = [fitted(base, [*others, atom], power) for atom in make(placed, shapes)]
    return min([fit, *trials], key=lambda trial: (not trial.physical, trial.cost))


def _shape_step(base: Base, now: _Shaped, power: Rows, spans: Spans) -> tuple[Shapes, float]:
    """Step of all shapes together, and the fall of the cost that it predicts."""
    fit = now.fit
    target, matrix = system(base, fit.atoms)
    slopes = [
        column
        for one in fit.atoms
        if one.shape
        for column in _slopes(base, fit, one, now.near[one.placed], _STEP * spans[one.placed].step)
    ]
    weight = (1.0 / np.sqrt(power))[:, None]
    columns = np.concatenate([matrix, np.stack(slopes, axis=1)], axis=1)
    if not np.all(np.isfinite(columns)):
        return np.zeros(len(slopes)), 0.0
    solution = solve(columns * weight, target * weight[:, 0])
    predicted = float(np.sum((target - columns @ solution) ** 2 / power))
    return solution[matrix.shape[1] :], fit.cost - predicted


def _at_shapes(
    base: Base, now: _Shaped, step: Shapes, power: Rows, spans: Spans, make: Make
) -> _Shaped:
    """The set with its shapes moved as far as their grids allow; gains follow by least squares."""
    fit = now.fit
    moved, near, first = {one.placed: one for one in fit.atoms}, dict(now.near), 0
    for one in [atom for atom in fit.atoms if atom.shape]:
        span, last = spans[one.placed], first + len(one.shape)
        shape = np.asarray(one.shape)
        down, up = span.reach(shape)
        new = np.clip(shape + np.clip(step[first:last], -down, up), span.low, span.high)
        moved[one.placed], near[one.placed] = _with_neighbours(one, new, span, make)
        first = last
    new_fit = fitted(base, list(moved.values()), power)
    allowed = new_fit.physical or not fit.physical
    return _Shaped(new_fit.cost if allowed else np.inf, new_fit, near)


def _with_neighbours(
    one: CandidateColumns, shape: Shapes, span: Span, make: Make
) -> tuple[CandidateColumns, list[CandidateColumns]]:
    """An effect at a new shape, and a little further on in each of its shapes: in one call.

    Where one of these cannot be evaluated it stays what and where it is, without neighbours.
    """
    made = make(one.placed, np.concatenate([shape[None], shape + np.diag(_STEP * span.step)]))
    return (made[0], made[1:]) if len(made) == 1 + len(shape) else (one, [])


def _slopes(
    base: Base, fit: Fit, one: CandidateColumns, near: list[CandidateColumns], step: Shapes
) -> list[Rows]:
    """∂f/∂s of the set, for each shape s of one effect, gains and declared parameters fixed."""
    if not near:
        return [np.zeros_like(base.target) for _ in step]
    own = _gains(fit.atoms, fit.theta)[fit.atoms.index(one)]
    columns = []
    for other, small in zip(near, step, strict=True):
        change = (other.columns - one.columns) @ own
        if one.target is not None:
            assert other.target is not None
            (_, moved), (_, still) = system(base, [other]), system(base, [one])
            declared = slice(len(base.free))
            change += one.target - other.target
            change += (moved - still)[:, declared] @ fit.theta[declared]
        columns.append(change / small)
    return columns


def settled(model: Plant, stretches: Sequence[ModalRecord], power: Rows, start: Theta) -> Plant:
    """All free parameters of a model by Gauss–Newton on the modes, damped and within their bounds.

    A set is fitted on columns taken at the declared parameters. Where these act through internal
    states, columns bend with them, and the step is too long or too short.

    Args:
        model: with the parameters that the columns were taken at.
        stretches: of the records.
        power: S of each mode.
        start: where the fit of the set wants to go, shape (np,); as far as it helps it is followed.
    """
    from scipy.optimize import least_squares  # only discovery with internal states needs it

    free, weight = np.flatnonzero(model.free), 1.0 / np.sqrt(power)
    low, high = np.asarray(model.lower)[free], np.asarray(model.upper)[free]
    theta = np.asarray(model.theta)
    scale = np.maximum(np.abs(theta), np.abs(start))[free]
    scale = np.where(scale > 0, scale, 1.0)

    def moved(x: Free) -> Plant:
        new = theta.copy()
        new[free] = np.clip(x * scale, low, high)
        return model.with_parameters(new)

    def both(x: Free) -> tuple[Rows, Float[np.ndarray, "rows free"]]:
        target, slopes = model_rows(moved(x), stretches)
        error, slope = target[0] * weight, -slopes[0][:, free] * scale * weight[:, None]
        return np.clip(np.nan_to_num(error, nan=_FAR), -_FAR, _FAR), np.nan_to_num(slope)

    steps = [theta[free] + share * (start - theta)[free] for share in (1.0, 0.5, 0.25, 0.0)]
    inside = [np.clip(one, low, high) / scale for one in steps]
    first = min(inside, key=lambda x: float(np.sum(both(x)[0] ** 2)))
    answer = least_squares(
        lambda x: both(x)[0],
        first,
        lambda x: both(x)[1],  # type: ignore[arg-type]
        (low / scale, high / scale),
        x_scale="jac",
        max_nfev=_SETTLING,
    )
    return moved(answer.x)


def _parted(fit: Fit, placed: Placed) -> tuple[CandidateColumns, list[CandidateColumns]]:
    one = next(atom for atom in fit.atoms if atom.placed == placed)
    return one, [atom for atom in fit.atoms if atom.placed != placed]


def _gains(atoms: Sequence[CandidateColumns], theta: np.ndarray) -> tuple[np.ndarray, ...]:
    widths = [one.columns.shape[1] for one in atoms]
    first = len(theta) - sum(widths)
    values = []
    for width in widths:
        values.append(theta[first : first + width])
        first += width
    return tuple(values)


def _physical(atoms: Sequence[CandidateColumns], theta: np.ndarray) -> bool:
    return all(
        parameter.lower <= value <= parameter.upper
        for one, gains in zip(atoms, _gains(atoms, theta), strict=True)
        for parameter, value in zip(one.placed.effect.gains, gains, strict=True)
    )


def solve(matrix: Float[np.ndarray, "rows columns"], target: Rows) -> Float[np.ndarray, " columns"]:
    """Least squares by normal equations of scaled columns; a direction without trace is left."""
    return solve_normal(matrix.T @ matrix, matrix.T @ target)


def solve_normal(
    gram: Float[np.ndarray, "*batch columns columns"], right: Float[np.ndarray, "*batch columns"]
) -> Float[np.ndarray, "*batch columns"]:
    """Several normal equations, each solved in the directions that leave a trace."""
    basis = eigenbasis(gram)
    seen = np.swapaxes(basis, -1, -2) @ right[..., None]
    return (basis @ seen)[..., 0]


def eigenbasis(
    gram: Float[np.ndarray, "*batch columns columns"],
) -> Float[np.ndarray, "*batch columns columns"]:
    """B with BᵀGB = 1 in the directions that leave a trace, and columns of zeros for the others."""
    square = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(square > 0, square, 1.0))
    values, vectors = np.linalg.eigh(gram / (scale[..., :, None] * scale[..., None, :]))
    good = values > _TRACE * values[..., -1:]
    inverse = np.where(good, 1.0 / np.sqrt(np.where(good, values, 1.0)), 0.0)
    return vectors * inverse[..., None, :] / scale[..., :, None]
