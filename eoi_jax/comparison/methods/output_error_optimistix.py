r"""Output error by another solver: `rollout` of the public interface, fitted by optimistix.

The criterion is that of `refine`,
$\sum_i \sum_k \|y_i[k] - \hat y_i[k; \theta, x_i]\|^2 / \sigma^2$ over the free parameters and the
initial state of each record. Sensitivities, weights and the solver are others: two codes that agree
have found a minimum of it.

The solver knows no bounds. Parameters with bounds are functions of unknowns without any, as in
MINUIT: a sine between two bounds, a hyperbola above or below one. No run ever leaves the bounds,
and an estimate on one is at finite unknowns, other than with a logistic function. The slope is zero
there, so that the last digits come slowly: what has come to its bound is held there in a next fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._status import Status
from eoi_jax.comparison.methods.comparator import (
    AbstractComparator,
    Estimate,
    named,
    not_applicable,
)
from eoi_jax.compiler.programs import jit
from eoi_jax.data.input_holds import TRACED_HOLDS
from eoi_jax.data.masks import scored_samples
from eoi_jax.data.record import Record
from eoi_jax.data.windows import start_samples
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.start_weights import start_weights
from eoi_jax.simulation.initial_state import Run, initial_states, known_starts, owned
from eoi_jax.simulation.integrator import Drive, frictional
from eoi_jax.simulation.rollout import rollout
from eoi_jax.simulation.simulate import drive
from eoi_jax.simulation.step_size import choose_steps


@dataclass(frozen=True)
class OptimistixSettings:
    """Numbers of the fit.

    Attributes:
        max_steps: of the solver in each fit.
        fits: with other weights of the outputs or more parameters held on their bounds, at most.
        bound_distance: of a parameter from its bound, over its size, that is none.
        weight_tolerance: relative change of the weights below which they have settled.
        min_distance: of an unknown from its bound at the start, where the solver sees no slope.
        min_residual: σ of an output without error, over its spread.
        min_trace: smallest singular value of derivatives of length one that is a trace.
        min_share: of a parameter in a direction without a trace, from which on it is named.
    """

    max_steps: int = 256
    fits: int = 8
    bound_distance: float = 1e-6
    weight_tolerance: float = 0.02
    min_distance: float = 0.1
    min_residual: float = 1e-9
    min_trace: float = 1e-7
    min_share: float = 0.1


_SETTINGS = OptimistixSettings()


class OptimistixOutputError(AbstractComparator):
    """`output_error` by `optimistix.LevenbergMarquardt` over `rollout`: an independent check.

    Steps per sample are those of the fastest mode at the nominal values. Outputs are weighed by the
    rms of their residuals.

    Source: L. Ljung, *System Identification*, 2nd ed., section 3.2; bounds: F. James, M. Roos,
    *Minuit*, Computer Physics Communications 10 (1975); solver: https://docs.kidger.site/optimistix
    """

    name = "output_error_optimistix"
    description = "output error by optimistix over the public `rollout`, from the nominal values"

    def estimate(self, plant: Plant, records: Sequence[Record]) -> Estimate:
        """Levenberg-Marquardt of optimistix from the nominal values."""
        reason = _not_covered(plant, records)
        if reason:
            return not_applicable(reason)
        is_scored = np.any([np.any(scored_samples(one), axis=0) for one in records], axis=0)
        if not np.all(is_scored):
            return Estimate(None, None, Status("no_data", _NO_DATA))
        return _fitted(_Runs.of(plant, records))


_NO_DATA = "an output has no sample to score: it is masked, or records are shorter than the burn-in"


def _not_covered(plant: Plant, records: Sequence[Record]) -> str:
    """What `rollout` cannot simulate as `refine` does; empty where it can."""
    if plant.actuator is not None:
        return "levels of the inputs before the record, behind a delay or lag, are not estimated"
    if plant.sampled is not None:
        return "internal states that change at samples only are not simulated"
    if start_weights(plant.internal_initial):
        return "internal states of effects that start at any value are not estimated"
    if np.any(plant.free_internal):
        return "free starts of internal states are not estimated"
    for record in records:
        if record.hold not in TRACED_HOLDS:
            return f"`rollout` holds all inputs zero or linear, and {record.name} has {record.hold}"
        if np.any(record.skew):
            return f"inputs of {record.name} act earlier or later than they were logged"
        if not np.all(record.input_valid):
            return f"inputs of {record.name} have gaps"
    if len({record.hold for record in records}) > 1:
        return "records have different holds"
    return ""


@dataclass(frozen=True)
class _Model:
    """What a compiled program takes as constant: the plant, equal where its numbers are, and steps.

    A plant within it is of NumPy's arrays also where JAX traces: its own values decide what sticks.
    """

    structure: Any
    leaves: tuple[tuple[float, ...], ...]
    hold: str
    substeps: int

    @classmethod
    def of(cls, plant: Plant, hold: str, substeps: int) -> "_Model":
        """With the plant's numbers as tuples."""
        leaves, structure = jax.tree.flatten(plant)
        return cls(structure, tuple(tuple(np.asarray(x).tolist()) for x in leaves), hold, substeps)

    @property
    def plant(self) -> Plant:
        """The plant."""
        return jax.tree.unflatten(self.structure, [np.asarray(leaf) for leaf in self.leaves])


class _Coordinates(eqx.Module):
    """Free parameters as functions of unknowns without bounds, zero at the start.

    With x = origin + step · unknown: lower + (upper - lower)(1 + sin x)/2 between two bounds,
    bound ± size (√(1 + x²) - 1) beyond a single one, size · x without any. A unit of an unknown
    moves the parameter by its size, to first order, and by less near a bound.
    """

    lower: Float[Any, " free"]
    upper: Float[Any, " free"]
    has_lower: Bool[Any, " free"]
    has_upper: Bool[Any, " free"]
    size: Float[Any, " free"]
    origin: Float[Any, " free"]
    step: Float[Any, " free"]

    @classmethod
    def of(cls, plant: Plant) -> "_Coordinates":
        """Those of a plant at its nominal values, off their bounds by so much that they move."""
        free = plant.free > 0
        theta, lower, upper = (
            np.asarray(part, float)[free] for part in (plant.theta, plant.lower, plant.upper)
        )
        size = np.where(theta != 0, np.abs(theta), 1.0)
        has_lower, has_upper = np.isfinite(lower), np.isfinite(upper)
        lower, upper = np.where(has_lower, lower, 0.0), np.where(has_upper, upper, 0.0)
        closed, far = has_lower & has_upper, _SETTINGS.min_distance
        span = np.where(closed, 0.5 * (upper - lower), 1.0)
        most = 0.5 * np.pi - far
        angle = np.clip(np.arcsin(np.where(closed, (theta - lower) / span - 1.0, 0.0)), -most, most)
        distance = np.where(has_lower, theta - lower, np.where(has_upper, upper - theta, 0.0))
        root = np.maximum(np.sqrt((1.0 + distance / size) ** 2 - 1.0), far)
        excess = np.where(has_lower, root, np.where(has_upper, -root, theta / size))
        origin = np.where(closed, angle, excess)
        slope = np.where(has_lower | has_upper, size * root / np.sqrt(1.0 + root**2), size)
        slope = np.where(closed, span * np.cos(angle), slope)
        step = np.minimum(size / slope, 1.0)
        return cls(lower, upper, has_lower, has_upper, size, origin, step)

    def on_bounds(self, theta: Float[np.ndarray, " free"]) -> "_Coordinates":
        """With the parameters held that are on a bound: whatever their unknowns, they stay."""
        margin = _SETTINGS.bound_distance * self.size
        is_low = self.has_lower & (theta - self.lower <= margin)
        is_high = self.has_upper & (self.upper - theta <= margin)
        angle = np.where(is_low, -0.5 * np.pi, 0.5 * np.pi) * (self.has_lower & self.has_upper)
        is_held = is_low | is_high
        origin, step = np.where(is_held, angle, self.origin), np.where(is_held, 0.0, self.step)
        return replace(self, origin=origin, step=step)

    def theta(self, unknowns: Float[Array, " free"]) -> Float[Array, " free"]:
        """The parameters."""
        x = self.origin + self.step * unknowns
        between = self.lower + 0.5 * (self.upper - self.lower) * (1.0 + jnp.sin(x))
        excess = self.size * (jnp.sqrt(1.0 + x**2) - 1.0)
        above = jnp.where(self.has_upper, between, self.lower + excess)
        below = jnp.where(self.has_upper, self.upper - excess, self.size * x)
        return jnp.where(self.has_lower, above, below)


class _Unknowns(eqx.Module):
    """What the solver moves, zero at the start, each in units of its size."""

    theta: Float[Any, "*rows free"]
    starts: Float[Any, "*rows records states"]


class _Runs(eqx.Module):
    """Free runs of all records side by side; behind its end each goes on with its last inputs.

    Attributes:
        model: the equations.
        nominal: values of all parameters; those that are fixed keep them.
        coordinates: of the free parameters.
        y: outputs.
        u: inputs.
        use: which samples are scored.
        periods: sample periods [s].
        times: of the first samples [s].
        starts: initial states from the first samples, outputs and their derivatives, then z.
        sizes: of these; zero where a start is known.
        is_declared: whether z starts as the plant declares.
    """

    model: _Model = eqx.field(static=True)
    nominal: Float[Any, " np"]
    coordinates: _Coordinates
    y: Float[Any, "records time ny"]
    u: Float[Any, "records time nu"]
    use: Bool[Any, "records time ny"]
    periods: Float[Any, " records"]
    times: Float[Any, " records"]
    starts: Float[Any, "records states"]
    sizes: Float[Any, "records states"]
    is_declared: Bool[Any, " records"]

    @classmethod
    def of(cls, plant: Plant, records: Sequence[Record]) -> "_Runs":
        """The runs of these records in steps for the fastest mode at the nominal values."""
        substeps, longest = choose_steps(plant, records).count, max(map(len, records))

        def padded(rows: np.ndarray, mode: Any = "edge") -> np.ndarray:
            return np.pad(rows, ((0, longest - len(rows)), (0, 0)), mode)

        starts, sizes = zip(*(_start(plant, r, substeps) for r in records), strict=True)
        return cls(
            _Model.of(plant, str(records[0].hold), substeps),
            np.asarray(plant.theta, float),
            _Coordinates.of(plant),
            np.stack([padded(record.outputs) for record in records]),
            np.stack([padded(record.inputs) for record in records]),
            np.stack([padded(scored_samples(record), "constant") for record in records]),
            np.asarray([record.sample_period for record in records]),
            np.asarray([float(record.time[0]) for record in records]),
            np.stack(starts),
            np.stack(sizes),
            np.asarray([not record.continues for record in records]),
        )

    def theta(self, unknowns: _Unknowns) -> Float[Array, " np"]:
        """All parameters."""
        free = np.flatnonzero(self.model.plant.free)
        return jnp.asarray(self.nominal).at[free].set(self.coordinates.theta(unknowns.theta))

    def errors(self, unknowns: _Unknowns) -> Float[Array, "records time ny"]:
        """y - ŷ; zero where not scored."""
        theta, values = self.theta(unknowns), self.starts + self.sizes * unknowns.starts
        runs = self.u, values, self.is_declared, self.periods, self.times
        y_hat = jax.vmap(lambda *run: self._outputs(theta, *run))(*map(jnp.asarray, runs))
        return jnp.where(self.use, self.y - y_hat, 0.0)

    def _outputs(
        self, theta: Array, u: Array, values: Array, is_declared: Array, h: Array, t0: Array
    ) -> Float[Array, "time ny"]:
        model, plant = self.model, self.model.plant
        rows, columns = owned(plant)
        y = jnp.zeros((plant.rows, len(plant.outputs)), values.dtype)
        y, z = y.at[rows, columns].set(values[: len(rows)]), values[len(rows) :]
        start = State(y, jnp.where(is_declared, plant.internal_start(theta), z))
        settings = {"hold": model.hold, "substeps": model.substeps}
        return rollout(plant, theta, start, u, h, t0=t0, **settings).y[:, 0]


def _start(
    plant: Plant, record: Record, substeps: int
) -> tuple[Float[np.ndarray, " states"], Float[np.ndarray, " states"]]:
    """Initial state of a record from its first samples, and the sizes of what is unknown of it."""
    count = min(start_samples(record, plant.rows), len(record))
    head = drive(record.time[:count], record.inputs[:count], record.hold, substeps)
    lane = Drive(head.time[None], np.asarray(head.step)[None], np.asarray(head.inputs)[None],
                 substeps, np.asarray(head.last)[None])  # fmt: skip
    y, valid = record.outputs[None, :count], record.output_valid[None, :count]
    begins = np.asarray([not record.continues])
    run = Run(plant, frictional(plant), substeps)
    values = initial_states(run, lane, y, valid, record.noise[None], begins=begins)
    rows, columns = owned(plant)
    spread = _spread(record.outputs, record.output_valid)
    reach = spread[columns] / (count * record.sample_period) ** rows
    z = np.abs(values[0, len(rows) :]) * ~begins
    sizes = np.concatenate([np.where(reach > 0, reach, 1.0), np.where(z > 0, z, ~begins)])
    fixed = known_starts(plant, begins, values.shape)
    if fixed is not None:
        sizes = np.where(np.isfinite(fixed[0]), 0.0, sizes)
    return values[0], sizes


class _Solution(eqx.Module):
    """Where the solver ended: unknowns, parameters, y - ŷ, ∂(weighed y - ŷ)/∂(unknowns)."""

    unknowns: _Unknowns
    theta: Float[Array, " np"]
    errors: Float[Array, "records time ny"]
    columns: _Unknowns
    is_converged: Bool[Array, ""]
    is_exhausted: Bool[Array, ""]


@jit
def _solved(runs: _Runs, begin: _Unknowns, weights: Float[Any, " ny"]) -> _Solution:
    """Least squares with these weights, 1/σ of each output."""
    import optimistix

    def residual(unknowns: _Unknowns, runs: _Runs) -> tuple[Array, Array]:
        errors = runs.errors(unknowns)
        return jnp.ravel(errors * weights), errors

    solver = optimistix.LevenbergMarquardt(rtol=_tolerance(), atol=_tolerance())
    begin = jax.tree.map(jnp.asarray, begin)
    solution = optimistix.least_squares(
        residual, solver, begin, runs, has_aux=True, max_steps=_SETTINGS.max_steps, throw=False
    )
    results, end = optimistix.RESULTS, solution.value
    return _Solution(
        end,
        runs.theta(end),
        solution.aux,
        jax.jacfwd(lambda unknowns: residual(unknowns, runs)[0])(end),
        solution.result == results.successful,
        solution.result == results.nonlinear_max_steps_reached,
    )


def _fitted(runs: _Runs) -> Estimate:
    """Fits until the outputs are weighed by their residuals, and what is on a bound is held."""
    plant = runs.model.plant
    spread = _positive(_spread(runs.y, runs.use))
    weights, smallest = 1.0 / spread, _SETTINGS.min_residual * spread
    begin = _Unknowns(np.zeros(len(runs.coordinates.size)), np.zeros(runs.starts.shape))
    for _ in range(_SETTINGS.fits):
        solution = jax.tree.map(np.asarray, _solved(runs, begin, weights))
        is_end = solution.is_converged or solution.is_exhausted
        if not (is_end and np.all(np.isfinite(solution.errors))):
            return Estimate(None, None, Status("diverged", _DIVERGED))
        squares, counts = np.sum(solution.errors**2, axis=(0, 1)), np.sum(runs.use, axis=(0, 1))
        sigma = np.maximum(np.sqrt(squares / counts), smallest)
        ratios = sigma * weights  # squares know no scale: only the ratios of the outputs count
        is_settled = np.max(ratios) <= (1.0 + _SETTINGS.weight_tolerance) * np.min(ratios)
        coordinates = runs.coordinates.on_bounds(solution.theta[plant.free > 0])
        if is_settled and np.array_equal(coordinates.step, runs.coordinates.step):
            break
        begin, runs = solution.unknowns, replace(runs, coordinates=coordinates)
        weights = weights if is_settled else 1.0 / sigma
    is_held = coordinates.step == 0
    lost = _untraced(plant, solution.columns, is_held)
    if lost:
        return Estimate(None, None, Status("unidentifiable", _UNTRACED.format(", ".join(lost))))
    names = np.asarray(plant.names)[plant.free > 0][is_held]
    note = f"; on a bound: {', '.join(names)}" if len(names) else ""
    status = Status("converged", _CONVERGED.format(_tolerance()) + note)
    if solution.is_exhausted:
        text = f"the cost still fell after {_SETTINGS.max_steps} steps of the solver{note}"
        status = Status("passes_exhausted", text)
    theta = np.clip(solution.theta, plant.lower, plant.upper)
    return Estimate(named(plant, theta), None, status)


_DIVERGED = (
    "the free run from the nominal values does not stay finite, or no step from there lowers its "
    "error: start from other values"
)
_UNTRACED = (
    "no trace in the outputs of a change of {}: fix one of them, or excite the plant so that they "
    "differ"
)
_CONVERGED = "no step changes the cost or an unknown by more than {:.2g} of it"


def _spread(
    y: Float[np.ndarray, "*records time ny"], use: Bool[np.ndarray, "*records time ny"]
) -> Float[np.ndarray, " ny"]:
    """Standard deviation of each output over the samples in use."""
    axes = tuple(range(y.ndim - 1))
    count, samples = np.maximum(np.sum(use, axes), 1), np.where(use, y, 0.0)
    mean = np.sum(samples, axes) / count
    return np.sqrt(np.sum(np.where(use, samples - mean, 0.0) ** 2, axes) / count)


def _positive(values: np.ndarray) -> np.ndarray:
    """With ones in place of zeros."""
    return np.where(values > 0, values, 1.0)


def _untraced(plant: Plant, columns: _Unknowns, on_bound: np.ndarray) -> list[str]:
    """Parameters of combinations that the initial states can make up for, or that change nothing.

    Args:
        plant: of the fit.
        columns: derivatives of the weighed errors.
        on_bound: which free parameters have no derivative, for they are on a bound.
    """
    if np.all(on_bound):
        return []
    free = np.asarray(plant.names)[plant.free > 0][~on_bound]
    theta = columns.theta[:, ~on_bound]
    starts = columns.starts.reshape(len(theta), -1)
    starts = starts / _positive(np.linalg.norm(starts, axis=0))
    theta = theta / _positive(np.linalg.norm(theta, axis=0))
    remainder = theta - starts @ np.linalg.lstsq(starts, theta, rcond=_tolerance())[0]
    _, sizes, directions = np.linalg.svd(remainder, full_matrices=False)
    weak = np.abs(directions[sizes < _SETTINGS.min_trace])
    return free[np.any(weak > _SETTINGS.min_share, axis=0)].tolist()


def _tolerance() -> float:
    """Half of the digits of a number."""
    return float(np.sqrt(jnp.finfo(jnp.result_type(float)).eps))
