r"""One pass over a record and its free-run simulation: sums for instrumental variables.

The same observer with the model at θ follows both, step by step, and both go through the same
prefilter. With w = y^(r) - f(·; θ) along each (its injection) and φ its regressors,

    e = L⁻¹[w - w̄],   ψ = L⁻¹[φ],   ζ = L⁻¹[φ̄]        (a bar marks the simulation)

L is the model linearised along the simulation, L ε = ε^(r) - Σ_i ∂f/∂y^(i) ε^(i) - ∂f/∂z z̃. To
first order w - w̄ = L (y - ȳ), so that L⁻¹ turns the noise of the highest derivative back into that
of the sensor, white again, and ζ are the sensitivities ∂ȳ/∂θ: the weights of maximum likelihood.
w̄ is the discretisation error of an exact model, and cancels the same error in w.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._types import Output, Scalar, Theta
from eoi_jax.compiler.programs import jit
from eoi_jax.estimation.kernel import Carry, Kernel, Step, Steps, step_rows
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.velocities import velocity_rows
from eoi_jax.simulation.known_direction import turn
from eoi_jax.simulation.rates import rate_of
from eoi_jax.simulation.runge_kutta import runge_kutta_step


class PairSums(eqx.Module):
    """Sums of a pass over pairs, over scored steps and for each output.

    Attributes:
        cross: Σ ζᵀψ, shape (ny, np, np).
        information: Σ ζᵀζ, shape (ny, np, np).
        rhs: Σ ζᵀe, shape (ny, np).
        square: Σ e², shape (ny,).
        count: number of scored steps, shape (ny,).
        slopes: Σ ∂ẋ/∂x of the model along the simulation over all steps in use, shape (nx, nx); x
            is the chain of derivatives, row by row, then z.
        steps: number of steps in use.
    """

    cross: Float[Array, "*runs ny np np"]
    information: Float[Array, "*runs ny np np"]
    rhs: Float[Array, "*runs ny np"]
    square: Float[Array, "*runs ny"]
    count: Float[Array, "*runs ny"]
    slopes: Float[Array, "*runs nx nx"]
    steps: Float[Array, "*runs"]


class Rows(eqx.Module):
    """e, ζ and ψ of each step and output, times the square root of the weight; 0 if not scored.

    ψ is None if not asked for.
    """

    error: Float[Array, "*steps ny"]
    zeta: Float[Array, "*steps ny np"]
    psi: Float[Array, "*steps ny np"] | None


class Simulated(eqx.Module):
    """Simulated outputs at both ends of each measured step."""

    y: Float[Array | np.ndarray, "*runs S ny"]
    y_next: Float[Array | np.ndarray, "*runs S ny"]


class _Carry(eqx.Module):
    """State of the loop: carries of both kernels (leading axis 2), the prefilter, the sums."""

    kernels: Carry
    filtered: Float[Array, "nx columns"]
    sums: PairSums


class _PairRows(eqx.Module):
    """Steps of all runs, with outputs of the measurement and of the simulation.

    Attributes:
        steps: of the measurement, with inputs behind the actuators.
        slope: derivatives of these inputs with θ; None without actuators.
        y, y_next: outputs at both ends of each step, of the measurement and its simulation.
        previous_direction: direction of each output in the step before.
    """

    steps: Steps
    slope: Float[Array | np.ndarray, "*runs S nu np"] | None
    y: Float[Array | np.ndarray, "*runs S 2 ny"]
    y_next: Float[Array | np.ndarray, "*runs S 2 ny"]
    previous_direction: Float[Array | np.ndarray, "*runs S ny"] | None

    def part(self, first: int, length: int) -> "_PairRows":
        """`length` steps from `first`; beyond the end the last step repeats, with weight zero."""
        excess = max(first + length - self.y.shape[1], 0)

        def cut(leaf: np.ndarray) -> np.ndarray:
            if leaf.ndim == 1:  # of each run
                return leaf
            rows = leaf[:, first : first + length]
            repeated = np.repeat(rows[:, -1:], excess, axis=1)
            return np.concatenate([rows, repeated], axis=1) if excess else rows

        part = jax.tree.map(cut, self)
        for weights in (part.steps.use, part.steps.score) if excess else ():
            weights[:, -excess:] = 0.0
        return part


def run_pairs(
    plant: Plant,
    observer: AbstractObserver,
    steps: Steps,
    simulated: Simulated,
    theta: Theta,
    weights: Output,
    leak: Scalar,
    previous_direction: Float[np.ndarray, "runs S ny"] | None = None,
    max_steps: int = 100_000,
    regressors: bool = False,
) -> tuple[PairSums, Rows]:
    """One pass over pairs of records.

    Args:
        plant: the model; its structure only, parameters come from `theta`.
        observer: with its gains.
        steps: of the measurement, runs on the leading axis.
        simulated: its simulation with the same inputs, masked and restarted as the measurement.
        theta: θ of this pass.
        weights: of each output in the scores, shape (ny,).
        leak: damping of L⁻¹ in addition to that of the model [1/s].
        previous_direction: of a directed plant, the direction of each output in the step before.
        max_steps: of all runs together, at a time: XLA needs several times the memory of a record.
        regressors: whether the rows hold ψ.

    Returns:
        Sums, and the rows of each step; NumPy arrays with runs on the leading axis.
    """
    pair = _Pair(plant, observer, theta, weights, leak, regressors)
    slope = None
    if plant.actuator is not None:  # of the whole record: a delay looks back
        u, slope = (np.asarray(array) for array in _driven_inputs(pair, steps))
        steps = replace(steps, u=u)
    outputs = ((steps.y, simulated.y), (steps.y_next, simulated.y_next))
    y, y_next = (np.stack([np.asarray(array) for array in arrays], axis=2) for arrays in outputs)
    pair_rows = _PairRows(jax.tree.map(np.asarray, steps), slope, y, y_next, previous_direction)
    begin = y[:, 0], y_next[:, 0], pair_rows.steps.sample_period, pair_rows.steps.z_start
    carry = _initial_carry(pair, *begin)
    runs, count = y.shape[:2]
    length, row_parts = -(-count // -(-count * runs // max_steps)), []  # parts of equal length
    for first in range(0, count, length):
        carry, rows = _run_part(pair, carry, pair_rows.part(first, length))
        row_parts.append(
            jax.tree.map(lambda leaf, end=count - first: np.asarray(leaf)[:, :end], rows)
        )
    rows = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *row_parts)
    return jax.tree.map(np.asarray, carry.sums), rows


@jit
def _driven_inputs(pair: "_Pair", steps: Steps) -> tuple[Array, Array | None]:
    """Inputs behind the actuators, and their derivatives with θ."""
    return jax.vmap(pair.kernel.inputs)(steps)


@jit
def _initial_carry(pair: "_Pair", y: Any, y_next: Any, h: Any, z_start: Any) -> _Carry:
    return jax.vmap(pair.start)(y, y_next, h, z_start)


@jit
def _run_part(pair: "_Pair", carry: _Carry, part: _PairRows) -> tuple[_Carry, Rows]:
    return jax.vmap(pair.run_part)(carry, part)


class _Pair(eqx.Module):
    """The loop over one pair; fields as in `run_pairs`."""

    plant: Plant
    observer: AbstractObserver
    theta: Theta
    weights: Output
    leak: Scalar
    regressors: bool = eqx.field(static=True)

    @property
    def kernel(self) -> Kernel:
        """Kernel of the observer, with an all-pass filter: L⁻¹ takes the place of F."""
        no_filter = DiscreteFilter(np.zeros((1, 1)), np.ones(1))
        zeros, ones = jnp.zeros_like(self.theta), jnp.ones_like(self.weights)
        return Kernel(self.plant, self.observer, no_filter, self.theta, zeros, ones, "signals")

    def start(
        self,
        y: Float[Array, "2 ny"],
        y_next: Float[Array, "2 ny"],
        h: Scalar,
        z_start: Float[Array, "nz _"] | None,
    ) -> _Carry:
        """Carry before the first step, from the outputs at its ends and z there."""
        init = jax.vmap(lambda y, y_next: self.kernel.init(y, y_next, h, z_start))
        return self._init(init(y, y_next))

    def run_part(self, carry: _Carry, part: _PairRows) -> tuple[_Carry, Rows]:
        """The loop over a part of the steps."""
        kernel, h = self.kernel, jnp.asarray(part.steps.sample_period)
        slope = None if part.slope is None else jnp.asarray(part.slope)
        steps = step_rows(part.steps, jnp.asarray(part.steps.u), slope)

        def body(carry: _Carry, row: tuple) -> tuple[_Carry, Rows]:
            step, y, y_next, previous_direction = row
            return self._step(kernel, carry, step, y, y_next, previous_direction, h)

        return jax.lax.scan(body, carry, (steps, part.y, part.y_next, part.previous_direction))

    def _init(self, kernels: Carry) -> _Carry:
        size, ny, dtype = len(self.theta), len(self.plant.outputs), self.theta.dtype
        nx = self.plant.relative_degree * ny + kernels.z.shape[1]

        def zeros(*shape: int) -> Array:
            return jnp.zeros(shape, dtype)

        square, matrix = zeros(ny), zeros(ny, size, size)
        rhs = zeros(ny, size)
        sums = PairSums(matrix, matrix, rhs, square, square, zeros(nx, nx), zeros())
        return _Carry(kernels, zeros(nx, 2 * (1 + size)), sums)

    def _step(
        self,
        kernel: Kernel,
        carry: _Carry,
        row: Step,
        y: Float[Array, "2 ny"],
        y_next: Float[Array, "2 ny"],
        previous_direction: Output | None,
        h: Scalar,
    ) -> tuple[_Carry, Rows]:
        """One step; `row` is of the measurement, `y` and `y_next` of measurement and simulation."""
        x = self._simulated_state(carry.kernels, y[1])
        slopes = self._slopes(x, row)

        def follow(kernel_carry: Carry, y: Output, y_next: Output) -> tuple[Carry, Any]:
            return kernel.step(kernel_carry, replace(row, y=y, y_next=y_next), h)

        kernels, trace = jax.vmap(follow)(carry.kernels, y, y_next)
        # Columns: w, φ of the measurement, then of the simulation.
        columns = jnp.concatenate([trace.injection[..., None], trace.Phi], axis=2)
        columns = jnp.concatenate([columns[0], columns[1]], axis=1)
        filtered = jnp.where(row.restart, 0.0, carry.filtered)
        if previous_direction is not None:
            filtered = self._across_reversal(filtered, x, row, previous_direction)
        filtered = self._prefilter(slopes, filtered, columns, h)
        sums, trace = self._add(carry, filtered[: len(self.plant.outputs)], slopes, row)
        return _Carry(kernels, filtered, sums), trace

    def _slopes(self, x: State, row: Step) -> Float[Array, "nx nx"]:
        """∂ẋ/∂x of the model at the simulated state."""
        y, z = x.y, x.z

        def rate(flat: Float[Array, " nx"]) -> Float[Array, " nx"]:
            x = State(flat[: y.size].reshape(y.shape), flat[y.size :])
            rates = rate_of(self.plant, self.theta, row.time, x, row.u)
            return jnp.concatenate([rates.y.ravel(), rates.z])

        slopes = jax.jacfwd(rate)(jnp.concatenate([y.ravel(), z]))
        # Nothing is scored beyond the end of a record, or where the model is undefined.
        return jnp.where(jnp.all(jnp.isfinite(slopes)) & jnp.any(row.use > 0), slopes, 0.0)

    def _across_reversal(
        self, filtered: Float[Array, "nx columns"], x: State, row: Step, previous_direction: Output
    ) -> Float[Array, "nx columns"]:
        """ψ and ζ continued across a reversal at rest; e is measured and needs no correction."""
        ny, columns = len(self.plant.outputs), filtered.shape[1] // 2
        factor = turn(self.plant, self.theta, row.time, x, row.u, previous_direction)
        is_sensitivity = np.arange(2 * columns) % columns > 0
        rows = ny * np.asarray(velocity_rows(self.plant.degrees)) + np.arange(ny)
        return filtered.at[rows].multiply(jnp.where(is_sensitivity, factor[:, None], 1.0))

    def _simulated_state(self, kernels: Carry, y: Output) -> State:
        """The simulated state."""
        state, z = jax.tree.map(lambda leaf: leaf[1], (kernels.observer, kernels.z))
        return State(jnp.concatenate([y[None], self.observer.rates(state)]), z)

    def _prefilter(
        self,
        slopes: Float[Array, "nx nx"],
        filtered: Float[Array, "nx columns"],
        columns: Float[Array, "ny columns"],
        h: Scalar,
    ) -> Float[Array, "nx columns"]:
        """L⁻¹ over a Runge–Kutta step, over which all of L is held."""
        ny = len(self.plant.outputs)
        size = self.plant.relative_degree * ny
        is_highest = (
            np.arange(self.plant.relative_degree)[:, None] == np.asarray(self.plant.degrees) - 1
        )
        entry = jnp.where(is_highest[:, :, None], columns[None], 0.0).reshape(size, -1)
        entry = jnp.pad(entry, ((0, len(filtered) - size), (0, 0)))

        def rate(x: Array, _: None) -> Array:
            # Not as a matrix product: a loop that calls a library for one is far slower.
            slope = sum(slopes[:, k, None] * x[k] for k in range(len(filtered)))
            return slope - self.leak * x + entry

        return runge_kutta_step(rate, filtered, h, (None, None, None))[0]

    def _add(
        self,
        carry: _Carry,
        filtered: Float[Array, "ny columns"],
        slopes: Float[Array, "nx nx"],
        row: Step,
    ) -> tuple[PairSums, Rows]:
        columns, previous = filtered.shape[1] // 2, carry.sums
        error = filtered[:, 0] - filtered[:, columns]
        psi, zeta = filtered[:, 1:columns], filtered[:, columns + 1 :]
        weighted = row.score[:, None] * zeta
        sums = PairSums(
            previous.cross + weighted[:, :, None] * psi[:, None, :],
            previous.information + weighted[:, :, None] * zeta[:, None, :],
            previous.rhs + weighted * error[:, None],
            previous.square + row.score * error**2,
            previous.count + row.score,
            previous.slopes + slopes,
            previous.steps + jnp.any(row.use > 0),
        )
        root = jnp.sqrt(self.weights * row.score)
        kept = root[:, None] * psi if self.regressors else None
        return sums, Rows(root * error, root[:, None] * zeta, kept)


def sum_over_runs(sums: PairSums) -> Any:
    """Sums over all runs, as NumPy arrays."""
    return jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums)
