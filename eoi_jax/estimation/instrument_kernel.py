r"""One pass over a record and its simulation side by side: what instrumental variables need.

Both are followed by the same observer with the model at θ, step by step, and both go through the
same prefilter. With w = y^(r) - f(·; θ) along each (its injection) and φ its regressors,

    e = L⁻¹[w - w̄],   ψ = L⁻¹[φ],   ζ = L⁻¹[φ̄]        (a bar marks the simulation)

L is the model linearised along the simulation, L ε = ε^(r) - Σ_i ∂f/∂y^(i) ε^(i) - ∂f/∂z z̃. To
first order w - w̄ = L (y - ȳ), so that L⁻¹ turns the noise of the highest derivative back into that
of the sensor, white again, and ζ are the sensitivities ∂ȳ/∂θ: the weights of maximum likelihood.
w̄ is what the discretisation leaves of a model without any error, and cancels that in w as well.
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
from eoi_jax.simulation.integrator import rate_of
from eoi_jax.simulation.known_direction import turn
from eoi_jax.simulation.runge_kutta import runge_kutta_step

_AT_ONCE = 100_000  # steps of all runs


class PairSums(eqx.Module):
    """What a pass over pairs adds up, over scored steps and for each output.

    Attributes:
        cross: Σ ζᵀψ, shape (ny, np, np). information: Σ ζᵀζ, likewise.
        rhs: Σ ζᵀe, shape (ny, np). square: Σ e², shape (ny,). count: steps.
        slopes: Σ ∂ẋ/∂x of the model along the simulation, over all steps that are used, whose
            number is `steps`; x is the chain of derivatives, row by row, then z.
    """

    cross: Float[Array, "*runs ny np np"]
    information: Float[Array, "*runs ny np np"]
    rhs: Float[Array, "*runs ny np"]
    square: Float[Array, "*runs ny"]
    count: Float[Array, "*runs ny"]
    slopes: Float[Array, "*runs nx nx"]
    steps: Float[Array, "*runs"]


class Rows(eqx.Module):
    """e and ζ of each step and output, times the root of their weight; zero where not scored."""

    error: Float[Array, "*steps ny"]
    zeta: Float[Array, "*steps ny np"]


class Simulated(eqx.Module):
    """The simulation beside the measured steps: outputs at both ends of each."""

    y: Float[Array | np.ndarray, "*runs S ny"]
    y_next: Float[Array | np.ndarray, "*runs S ny"]


class _Carry(eqx.Module):
    """Of the loop: both kernels (leading axis 2), the prefilter, sums."""

    kernels: Carry
    filtered: Float[Array, "nx columns"]
    sums: PairSums


class _Stretch(eqx.Module):
    """Some steps of all runs: of the measurement, and both ends of each of both records.

    Attributes:
        steps: of the measurement, inputs behind the actuators. slope: their derivatives with θ.
        y, y_next: of the measurement and its simulation.
        before: directions of the step before each.
    """

    steps: Steps
    slope: Float[Array | np.ndarray, "*runs S nu np"] | None
    y: Float[Array | np.ndarray, "*runs S 2 ny"]
    y_next: Float[Array | np.ndarray, "*runs S 2 ny"]
    before: Float[Array | np.ndarray, "*runs S ny"] | None

    def part(self, first: int, length: int) -> "_Stretch":
        """So many steps; behind the last one they repeat it, and count for nothing."""
        missing = max(first + length - self.y.shape[1], 0)

        def cut(leaf: np.ndarray) -> np.ndarray:
            if leaf.ndim == 1:  # of each run
                return leaf
            own = leaf[:, first : first + length]
            held = np.repeat(own[:, -1:], missing, axis=1)
            return np.concatenate([own, held], axis=1) if missing else own

        part = jax.tree.map(cut, self)
        for weights in (part.steps.use, part.steps.score) if missing else ():
            weights[:, -missing:] = 0.0
        return part


def run_pairs(
    plant: Plant,
    observer: AbstractObserver,
    steps: Steps,
    simulated: Simulated,
    theta: Theta,
    weights: Output,
    leak: Scalar,
    before: Float[np.ndarray, "runs S ny"] | None = None,
) -> tuple[PairSums, Rows]:
    """One pass over pairs of records.

    Args:
        plant: the model; its structure only, parameters come from `theta`.
        observer: with its gains.
        steps: of the measurement, runs on the leading axis.
        simulated: its simulation, with the same inputs; counted, and started anew, where that is.
        theta: θ of this pass.
        weights: of each output in the scores, shape (ny,).
        leak: by which L⁻¹ is damped more than the model is [1/s].
        before: of a directed plant, the directions of the step before each.

    Returns:
        Sums, and each step's rows; NumPy arrays, runs on the leading axis.
    """
    pair = _Pair(plant, observer, theta, weights, leak)
    slope = None
    if plant.actuator is not None:  # of the whole record: a delay looks back
        u, slope = (np.asarray(one) for one in _driven(pair, steps))
        steps = replace(steps, u=u)
    ends = ((steps.y, simulated.y), (steps.y_next, simulated.y_next))
    y, y_next = (np.stack([np.asarray(one) for one in both], axis=2) for both in ends)
    whole = _Stretch(jax.tree.map(np.asarray, steps), slope, y, y_next, before)
    carry = _started(pair, y[:, 0], y_next[:, 0], whole.steps.sample_period)
    # What XLA makes of a record takes several times its room: in parts, all of one length.
    runs, count = y.shape[:2]
    length, shown = -(-count // -(-count * runs // _AT_ONCE)), []
    for first in range(0, count, length):
        carry, rows = _through(pair, carry, whole.part(first, length))
        shown.append(jax.tree.map(lambda leaf, end=count - first: np.asarray(leaf)[:, :end], rows))
    rows = jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *shown)
    return jax.tree.map(np.asarray, carry.sums), rows


@jit
def _driven(pair: "_Pair", steps: Steps) -> tuple[Array, Array | None]:
    """Inputs behind the actuators, and their derivatives with θ."""
    return jax.vmap(pair.kernel.inputs)(steps)


@jit
def _started(pair: "_Pair", y: Any, y_next: Any, h: Any) -> _Carry:
    return jax.vmap(pair.start)(y, y_next, h)


@jit
def _through(pair: "_Pair", carry: _Carry, part: _Stretch) -> tuple[_Carry, Rows]:
    return jax.vmap(pair.through)(carry, part)


class _Pair(eqx.Module):
    """The loop over one pair; fields as in `run_pairs`."""

    plant: Plant
    observer: AbstractObserver
    theta: Theta
    weights: Output
    leak: Scalar

    @property
    def kernel(self) -> Kernel:
        """Of an observer; F passes all, L⁻¹ takes its place."""
        through = DiscreteFilter(np.zeros((1, 1)), np.ones(1))
        zeros, ones = jnp.zeros_like(self.theta), jnp.ones_like(self.weights)
        return Kernel(self.plant, self.observer, through, self.theta, zeros, ones, "signals")

    def start(self, y: Float[Array, "2 ny"], y_next: Float[Array, "2 ny"], h: Scalar) -> _Carry:
        """Before the first step, whose ends are given."""
        return self._init(jax.vmap(lambda y, y_next: self.kernel.init(y, y_next, h))(y, y_next))

    def through(self, carry: _Carry, part: _Stretch) -> tuple[_Carry, Rows]:
        """Some steps."""
        kernel, h = self.kernel, jnp.asarray(part.steps.sample_period)
        slope = None if part.slope is None else jnp.asarray(part.slope)
        now = step_rows(part.steps, jnp.asarray(part.steps.u), slope)

        def body(carry: _Carry, row: tuple) -> tuple[_Carry, Rows]:
            step, y, y_next, before = row
            return self._step(kernel, carry, step, y, y_next, before, h)

        return jax.lax.scan(body, carry, (now, part.y, part.y_next, part.before))

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
        now: Step,
        y: Float[Array, "2 ny"],
        y_next: Float[Array, "2 ny"],
        before: Output | None,
        h: Scalar,
    ) -> tuple[_Carry, Rows]:
        """`now` is the measurement's; `y` and `y_next` are of both."""
        x = self._simulated(carry.kernels, y[1])
        slopes = self._slopes(x, now)

        def followed(old: Carry, y: Output, y_next: Output) -> tuple[Carry, Any]:
            return kernel.step(old, replace(now, y=y, y_next=y_next), h)

        kernels, shown = jax.vmap(followed)(carry.kernels, y, y_next)
        # Columns: w, φ of the measurement, then of the simulation.
        columns = jnp.concatenate([shown.injection[..., None], shown.Phi], axis=2)
        columns = jnp.concatenate([columns[0], columns[1]], axis=1)
        filtered = jnp.where(now.restart, 0.0, carry.filtered)
        if before is not None:
            filtered = self._turned(filtered, x, now, before)
        filtered = self._prefilter(slopes, filtered, columns, h)
        sums, shown = self._add(carry, filtered[: len(self.plant.outputs)], slopes, now)
        return _Carry(kernels, filtered, sums), shown

    def _slopes(self, x: State, now: Step) -> Float[Array, "nx nx"]:
        """∂ẋ/∂x of the model where the simulation is."""
        y, z = x.y, x.z

        def rate(flat: Float[Array, " nx"]) -> Float[Array, " nx"]:
            x = State(flat[: y.size].reshape(y.shape), flat[y.size :])
            rates = rate_of(self.plant, self.theta, now.time, x, now.u)
            return jnp.concatenate([rates.y.ravel(), rates.z])

        slopes = jax.jacfwd(rate)(jnp.concatenate([y.ravel(), z]))
        # Beyond the end of a record, or where the model is undefined, nothing is scored.
        return jnp.where(jnp.all(jnp.isfinite(slopes)) & jnp.any(now.use > 0), slopes, 0.0)

    def _turned(
        self, filtered: Float[Array, "nx columns"], x: State, now: Step, before: Output
    ) -> Float[Array, "nx columns"]:
        """ψ and ζ across a moment of rest; e is measured, and needs no help."""
        ny, half = len(self.plant.outputs), filtered.shape[1] // 2
        factor = turn(self.plant, self.theta, now.time, x, now.u, before)
        derived = np.arange(2 * half) % half > 0
        rates = filtered[ny : 2 * ny]
        rates = jnp.where(derived, factor[:, None] * rates, rates)
        return filtered.at[ny : 2 * ny].set(rates)

    def _simulated(self, kernels: Carry, y: Output) -> State:
        """Where the simulation is."""
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
        last = np.arange(self.plant.relative_degree)[:, None] == np.asarray(self.plant.degrees) - 1
        entry = jnp.where(last[:, :, None], columns[None], 0.0).reshape(size, -1)
        entry = jnp.pad(entry, ((0, len(filtered) - size), (0, 0)))

        def rate(x: Array, _: None) -> Array:
            # Not as a matrix product: a loop that calls a library for one is far slower.
            moved = sum(slopes[:, k, None] * x[k] for k in range(len(filtered)))
            return moved - self.leak * x + entry

        return runge_kutta_step(rate, filtered, h, (None, None, None))[0]

    def _add(
        self,
        carry: _Carry,
        filtered: Float[Array, "ny columns"],
        slopes: Float[Array, "nx nx"],
        now: Step,
    ) -> tuple[PairSums, Rows]:
        half, old = filtered.shape[1] // 2, carry.sums
        error = filtered[:, 0] - filtered[:, half]
        psi, zeta = filtered[:, 1:half], filtered[:, half + 1 :]
        weighted = now.score[:, None] * zeta
        sums = PairSums(
            old.cross + weighted[:, :, None] * psi[:, None, :],
            old.information + weighted[:, :, None] * zeta[:, None, :],
            old.rhs + weighted * error[:, None],
            old.square + now.score * error**2,
            old.count + now.score,
            old.slopes + slopes,
            old.steps + jnp.any(now.use > 0),
        )
        root = jnp.sqrt(self.weights * now.score)
        return sums, Rows(root * error, root[:, None] * zeta)


def together(sums: PairSums) -> Any:
    """Sums over all runs, as NumPy arrays."""
    return jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums)
