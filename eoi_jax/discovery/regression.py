"""One set of effects fitted to the modes: least squares, and Gauss–Newton on the shapes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.discovery.candidates import CandidateColumns
from eoi_jax.discovery.cosine_modes import ModalRecord, model_rows
from eoi_jax.estimation.regression.bounded import bounded, leaves_bounds
from eoi_jax.models.augmented import Placed
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.gauss_newton import gauss_newton

_STEPS = 6  # largest number of Gauss–Newton steps
_STEP = 1e-3  # of the numerical derivative, in units of the distance on the grid
_TOLERANCE = 1e-3  # relative decrease of the cost below which Gauss–Newton stops
_EVALUATIONS = 40  # largest number of evaluations in `settled`
_LARGE = 1e6  # weighted error that replaces one that is not finite
_TRACE = 1e-12  # share of the largest eigenvalue below which a direction is not identifiable
_POINTS = 3  # grid points on each side of a shape in its refinement

Theta = Float[np.ndarray, " np"]
Free = Float[np.ndarray, " free"]
Rows = Float[np.ndarray, " rows"]
Shapes = Float[np.ndarray, " shapes"]
Make = Callable[[Placed, np.ndarray], list[CandidateColumns]]
# For each effect with shapes: candidates with each shape perturbed; empty if not evaluable.
Neighbours = dict[Placed, list[CandidateColumns]]


@dataclass(frozen=True)
class Base:
    """The declared model along the records, and the noise expected in each mode.

    Attributes:
        target: y^(r) - f at the declared parameters.
        columns: ∂f/∂θ of the free parameters, shape (rows, free).
        free: indices of the free parameters among all parameters.
        noise, local: N and Y of `noise_spectrum`.
        output: index of the output of each row.
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
        """Σ |R|² over modes, each weighted by its signal-to-noise ratio (Wiener) and its output."""
        return float(np.sum(self.output_weight * self._signal * residual**2))

    @property
    def noise_power(self) -> float:
        """Contribution of measurement noise to `signal_power`."""
        return float(np.sum(self.output_weight * self._signal * self.noise))

    @property
    def output_power(self) -> float:
        """`signal_power` of y^(r) itself."""
        return self.signal_power(np.sqrt(self.local))

    @cached_property
    def output_weight(self) -> Rows:
        """Weight (1 - N/P)²/P of the output of each mode: powers then add, whatever their units.

        P and N are the powers of y^(r) and of its noise in an output, with the weights of its
        modes. A residual counts in proportion to its own output, and one that is noise hardly.
        """
        return self._per_output(
            _relative_weight, self._signal * self.local, self._signal * self.noise
        )

    @cached_property
    def output_level(self) -> Rows:
        """Mean power of y^(r) in the output of each mode: the S of a first fit, flat in each."""
        return self._per_output(_level, self.local)

    def _per_output(self, value: Callable[..., float], *powers: Rows) -> Rows:
        """A number of the modes of each output, at all of them."""
        result = np.zeros_like(self.local)
        for j in np.unique(self.output):
            modes = self.output == j
            result[modes] = value(*(power[modes] for power in powers))
        return result

    @property
    def _signal(self) -> Rows:
        local = np.maximum(self.local, 1e-300)
        return np.clip(1.0 - self.noise / local, 0.0, 1.0) ** 2


@dataclass(frozen=True)
class Fit:
    """The fit of a set of effects.

    Attributes:
        atoms: the effects added; those that change the declared part come first.
        theta: increments of the free declared parameters, then gains.
        residual: modes of the residual.
        cost: Σ |R|²/S.
        physical: whether every gain lies in its physical range.
    """

    atoms: tuple[CandidateColumns, ...]
    theta: Float[np.ndarray, " columns"]
    residual: Rows
    cost: float
    physical: bool

    @property
    def keys(self) -> frozenset:
        """The effects of the set, with their places."""
        return frozenset(atom.placed for atom in self.atoms)

    @property
    def gains(self) -> tuple[Float[np.ndarray, " gains"], ...]:
        """Gains of each effect."""
        return _gains(self.atoms, self.theta)

    @property
    def values(self) -> dict[Placed, tuple[float, ...]]:
        """Parameters of each effect, gains first."""
        return {
            atom.placed: (*(float(gain) for gain in gains), *atom.shape)
            for atom, gains in zip(self.atoms, self.gains, strict=True)
        }


def fitted(base: Base, atoms: Sequence[CandidateColumns], power: Rows) -> Fit:
    """Weighted least squares of the declared parameters and the gains.

    Args:
        base: the declared model.
        atoms: the set; at most one of them changes the declared part of the model.
        power: S of each mode.
    """
    ordered = tuple(sorted(atoms, key=lambda atom: atom.target is None))
    target, matrix = system(base, ordered)
    weight = 1.0 / np.sqrt(power)
    if not np.all(np.isfinite(matrix)):  # the term overflows at this shape
        return Fit(ordered, np.zeros(matrix.shape[1]), target, np.inf, False)
    theta = solve(matrix * weight[:, None], target * weight)
    residual = target - matrix @ theta
    cost = float(np.sum(residual**2 / power))
    return Fit(ordered, theta, residual, cost, _physical(ordered, theta))


def within_bounds(base: Base, fit: Fit, power: Rows) -> Fit:
    """The fit with all parameters within their bounds; the same fit if they already are.

    The search does not bound the declared parameters, so that no effect compensates for a bound.
    The model built from the answer must respect the bounds.

    Args:
        base: the declared model.
        fit: the fit of the set.
        power: S of each mode.
    """
    parameters = [gain for atom in fit.atoms for gain in atom.placed.effect.gains]
    room = base.room or (np.full(len(base.free), -np.inf), np.full(len(base.free), np.inf))
    low = np.append(room[0], [gain.lower for gain in parameters])[None]
    high = np.append(room[1], [gain.upper for gain in parameters])[None]
    if not leaves_bounds(fit.theta[None], (low, high)):
        return fit
    target, matrix = system(base, fit.atoms)
    weighed = matrix / np.sqrt(power)[:, None]
    gram, right = (weighed.T @ weighed)[None], (weighed.T @ (target / np.sqrt(power)))[None]

    def solved(
        right: Float[np.ndarray, "1 columns"], unbounded: Bool[np.ndarray, "1 columns"]
    ) -> Float[np.ndarray, "1 columns"]:
        mask = unbounded[0]
        return solve_normal(gram * np.outer(mask, mask), right * mask)

    theta = bounded(solved, gram, right, fit.theta[None], (low, high))[0][0]
    residual = target - matrix @ theta
    cost = float(np.sum(residual**2 / power))
    return Fit(fit.atoms, theta, residual, cost, _physical(fit.atoms, theta))


def system(
    base: Base, atoms: Sequence[CandidateColumns]
) -> tuple[Rows, Float[np.ndarray, "rows columns"]]:
    """Target and columns of the least-squares problem of a set."""
    target, columns = base.target, base.columns
    if atoms and atoms[0].target is not None:
        assert atoms[0].slopes is not None
        target, columns = atoms[0].target, atoms[0].slopes[:, base.free]
    return target, np.concatenate([columns, *(atom.columns for atom in atoms)], axis=1)


@dataclass(frozen=True)
class Span:
    """Range and spacing of the grid of an effect's shapes.

    Attributes:
        step: typical distance between neighbours on the grid, shape (shapes,).
        low, high: limits of the refinement, half a step beyond the ends of the grid, shape
            (shapes,).
        levels: sorted grid values of each shape.
    """

    step: Shapes
    low: Shapes
    high: Shapes
    levels: tuple[Float[np.ndarray, " _"], ...]

    def reach(self, shape: Shapes) -> tuple[Shapes, Shapes]:
        """Largest decrease and increase of a shape in one step: `step`, more in wide gaps."""
        decrease, increase = self.step.copy(), self.step.copy()
        for d, (levels, value) in enumerate(zip(self.levels, shape, strict=True)):
            marks = np.concatenate([[self.low[d]], levels, [self.high[d]]])
            lower_marks, upper_marks = marks[marks < value], marks[marks > value]
            decrease[d] = max(decrease[d], value - lower_marks.max() if len(lower_marks) else 0.0)
            increase[d] = max(increase[d], upper_marks.min() - value if len(upper_marks) else 0.0)
        return decrease, increase


Spans = dict[Placed, Span]


def refined(base: Base, fit: Fit, power: Rows, spans: Spans, make: Make) -> Fit:
    """The set with its shapes refined: a finer grid around each, then Gauss–Newton on all.

    Args:
        base: the declared model.
        fit: initial fit.
        power: S of each mode.
        spans: range of the grid of each effect.
        make: evaluates an effect at an array of shapes (grid, shapes).
    """
    moving = [atom.placed for atom in fit.atoms if atom.shape]
    for placed in moving:
        for d in range(len(spans[placed].step)):
            fit = _best_of_grid(base, fit, power, placed, d, spans[placed], make)
    neighbours = {
        atom.placed: _with_neighbours(atom, np.asarray(atom.shape), spans[atom.placed], make)[1]
        for atom in fit.atoms
        if atom.shape
    }
    if not moving:
        return fit

    def linearise(points: list[_ShapedFit]) -> list[tuple[Shapes, float]]:
        return [_shape_step(base, point, power, spans) for point in points]

    def evaluate(points: list[_ShapedFit], steps: list[Shapes]) -> list[list[_ShapedFit]]:
        return [
            [_at_shapes(base, point, step, power, spans, make)]
            for point, step in zip(points, steps, strict=True)
        ]

    start = _ShapedFit(fit.cost, fit, neighbours)
    return gauss_newton([start], linearise, evaluate, _TOLERANCE, _STEPS).points[0].fit


class _ShapedFit(NamedTuple):
    """The fit of a set at certain shapes.

    Attributes:
        cost: of the fit; infinite if its gains are not physical but those of the last step were.
        fit: fit of the gains and the declared parameters.
        neighbours: candidates with each shape perturbed.
    """

    cost: float
    fit: Fit
    neighbours: Neighbours


def _best_of_grid(
    base: Base, fit: Fit, power: Rows, placed: Placed, d: int, span: Span, make: Make
) -> Fit:
    """The best fit with shape d of one effect moved between its neighbours on the grid."""
    atom, remaining = _split(fit, placed)
    shapes = np.tile(np.asarray(atom.shape), (2 * _POINTS + 1, 1))
    decrease, increase = (limit[d] for limit in span.reach(np.asarray(atom.shape)))
    share = np.linspace(-1.0, 1.0, 2 * _POINTS + 1)
    shapes[:, d] += share * np.where(share < 0.0, decrease, increase)
    shapes = np.clip(shapes, span.low, span.high)
    trials = [fitted(base, [*remaining, trial], power) for trial in make(placed, shapes)]
    return min([fit, *trials], key=lambda trial: (not trial.physical, trial.cost))


def _shape_step(base: Base, point: _ShapedFit, power: Rows, spans: Spans) -> tuple[Shapes, float]:
    """Gauss–Newton step of all shapes, and the decrease of the cost that it predicts."""
    fit = point.fit
    target, matrix = system(base, fit.atoms)
    slopes = [
        column
        for atom in fit.atoms
        if atom.shape
        for column in _shape_columns(
            base, fit, atom, point.neighbours[atom.placed], _STEP * spans[atom.placed].step
        )
    ]
    weight = (1.0 / np.sqrt(power))[:, None]
    columns = np.concatenate([matrix, np.stack(slopes, axis=1)], axis=1)
    if not np.all(np.isfinite(columns)):
        return np.zeros(len(slopes)), 0.0
    solution = solve(columns * weight, target * weight[:, 0])
    predicted = float(np.sum((target - columns @ solution) ** 2 / power))
    return solution[matrix.shape[1] :], fit.cost - predicted


def _at_shapes(
    base: Base, point: _ShapedFit, step: Shapes, power: Rows, spans: Spans, make: Make
) -> _ShapedFit:
    """The set after a step of its shapes, limited to their grids; gains by least squares."""
    fit = point.fit
    moved, neighbours, first = {atom.placed: atom for atom in fit.atoms}, dict(point.neighbours), 0
    for atom in [member for member in fit.atoms if member.shape]:
        span, last = spans[atom.placed], first + len(atom.shape)
        shape = np.asarray(atom.shape)
        decrease, increase = span.reach(shape)
        new = np.clip(shape + np.clip(step[first:last], -decrease, increase), span.low, span.high)
        moved[atom.placed], neighbours[atom.placed] = _with_neighbours(atom, new, span, make)
        first = last
    new_fit = fitted(base, list(moved.values()), power)
    allowed = new_fit.physical or not fit.physical
    return _ShapedFit(new_fit.cost if allowed else np.inf, new_fit, neighbours)


def _with_neighbours(
    atom: CandidateColumns, shape: Shapes, span: Span, make: Make
) -> tuple[CandidateColumns, list[CandidateColumns]]:
    """An effect at a new shape, and with each of its shapes perturbed, in one call.

    If one of these cannot be evaluated, the effect is returned unchanged, without neighbours.
    """
    candidates = make(
        atom.placed, np.concatenate([shape[None], shape + np.diag(_STEP * span.step)])
    )
    return (candidates[0], candidates[1:]) if len(candidates) == 1 + len(shape) else (atom, [])


def _shape_columns(
    base: Base, fit: Fit, atom: CandidateColumns, neighbours: list[CandidateColumns], step: Shapes
) -> list[Rows]:
    """∂f/∂s of the set for each shape s of one effect; gains and declared parameters are fixed."""
    if not neighbours:
        return [np.zeros_like(base.target) for _ in step]
    gains = _gains(fit.atoms, fit.theta)[fit.atoms.index(atom)]
    columns = []
    for neighbour, increment in zip(neighbours, step, strict=True):
        change = (neighbour.columns - atom.columns) @ gains
        if atom.target is not None:
            assert neighbour.target is not None
            (_, perturbed), (_, nominal) = system(base, [neighbour]), system(base, [atom])
            declared = slice(len(base.free))
            change += atom.target - neighbour.target
            change += (perturbed - nominal)[:, declared] @ fit.theta[declared]
        columns.append(change / increment)
    return columns


def settled(model: Plant, stretches: Sequence[ModalRecord], power: Rows, start: Theta) -> Plant:
    """All free parameters of a model by damped Gauss–Newton on the modes, within their bounds.

    A set is fitted with columns taken at the declared parameters. If these act through internal
    states, the columns depend on them, and the linear step is too long or too short.

    Args:
        model: with the parameters at which the columns were taken.
        stretches: the records as modes.
        power: S of each mode.
        start: estimate of the linear fit, shape (np,); the best point on the line to it is taken.
    """
    from scipy.optimize import least_squares  # only needed with internal states

    free, weight = np.flatnonzero(model.free), 1.0 / np.sqrt(power)
    low, high = np.asarray(model.lower)[free], np.asarray(model.upper)[free]
    theta = np.asarray(model.theta)
    scale = np.maximum(np.abs(theta), np.abs(start))[free]
    scale = np.where(scale > 0, scale, 1.0)

    def moved(x: Free) -> Plant:
        new = theta.copy()
        new[free] = np.clip(x * scale, low, high)
        return model.with_parameters(new)

    evaluated: dict[bytes, tuple[Rows, Float[np.ndarray, "rows free"]]] = {}

    def errors_and_slopes(x: Free) -> tuple[Rows, Float[np.ndarray, "rows free"]]:
        if x.tobytes() not in evaluated:  # errors and slopes of a point are asked for in turn
            target, slopes = model_rows(moved(x), stretches)
            error, slope = target[0] * weight, -slopes[0][:, free] * scale * weight[:, None]
            error = np.clip(np.nan_to_num(error, nan=_LARGE), -_LARGE, _LARGE)
            evaluated[x.tobytes()] = error, np.nan_to_num(slope)
        return evaluated[x.tobytes()]

    steps = [theta[free] + share * (start - theta)[free] for share in (1.0, 0.5, 0.25, 0.0)]
    candidates = [np.clip(values, low, high) / scale for values in steps]
    first = min(candidates, key=lambda x: float(np.sum(errors_and_slopes(x)[0] ** 2)))
    answer = least_squares(
        lambda x: errors_and_slopes(x)[0],
        first,
        lambda x: errors_and_slopes(x)[1],  # type: ignore[arg-type]
        (low / scale, high / scale),
        x_scale="jac",
        max_nfev=_EVALUATIONS,
    )
    return moved(answer.x)


def _relative_weight(signal: Rows, noise: Rows) -> float:
    """(1 - N/P)²/P of an output; 0 without a signal."""
    power = float(np.sum(signal))
    return (1.0 - float(np.sum(noise)) / power) ** 2 / power if power > 0.0 else 0.0


def _level(local: Rows) -> float:
    """Mean power of an output; 1 of one at rest, which has no scale."""
    return float(np.mean(local)) or 1.0


def _split(fit: Fit, placed: Placed) -> tuple[CandidateColumns, list[CandidateColumns]]:
    selected = next(atom for atom in fit.atoms if atom.placed == placed)
    return selected, [atom for atom in fit.atoms if atom.placed != placed]


def _gains(atoms: Sequence[CandidateColumns], theta: np.ndarray) -> tuple[np.ndarray, ...]:
    widths = [atom.columns.shape[1] for atom in atoms]
    first = len(theta) - sum(widths)
    values = []
    for width in widths:
        values.append(theta[first : first + width])
        first += width
    return tuple(values)


def _physical(atoms: Sequence[CandidateColumns], theta: np.ndarray) -> bool:
    return all(
        parameter.lower <= value <= parameter.upper
        for atom, gains in zip(atoms, _gains(atoms, theta), strict=True)
        for parameter, value in zip(atom.placed.effect.gains, gains, strict=True)
    )


def solve(matrix: Float[np.ndarray, "rows columns"], target: Rows) -> Float[np.ndarray, " columns"]:
    """Least squares by normal equations; directions that are not identifiable are set to zero."""
    return solve_normal(matrix.T @ matrix, matrix.T @ target)


def solve_normal(
    gram: Float[np.ndarray, "*batch columns columns"], right: Float[np.ndarray, "*batch columns"]
) -> Float[np.ndarray, "*batch columns"]:
    """Batch of normal equations, each solved in its identifiable directions."""
    basis = eigenbasis(gram)
    coordinates = np.swapaxes(basis, -1, -2) @ right[..., None]
    return (basis @ coordinates)[..., 0]


def eigenbasis(
    gram: Float[np.ndarray, "*batch columns columns"],
) -> Float[np.ndarray, "*batch columns columns"]:
    """B with BᵀGB = 1 in the identifiable directions, and columns of zeros for the others."""
    square = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(square > 0, square, 1.0))
    values, vectors = np.linalg.eigh(gram / (scale[..., :, None] * scale[..., None, :]))
    good = values > _TRACE * values[..., -1:]
    inverse = np.where(good, 1.0 / np.sqrt(np.where(good, values, 1.0)), 0.0)
    return vectors * inverse[..., None, :] / scale[..., :, None]
