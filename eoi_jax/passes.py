r"""One pass over a record: observer, filter, normal equations and index in one compiled loop.

Per step k → k+1 (section 4 of the paper, steps of one iteration):
1. the observer follows y with the model at θ and shows y^(r) as it observes it;
2. u_eq = observed - f, f at the middle of the step, averaged as the observer averages;
3. F[u_eq] and F[φ], the same filter (19) on both;
4. Σ φᵀφ, Σ φᵀu_eq (11), the sum of squares of the index (14), samples in sliding.

Nothing is stored per sample unless asked. A step that must not count (a gap, dry friction at
rest) enters F on *both* sides with weight zero: F[m u_eq] = F[m φ] Δθ holds for any mask m, so no
margin is needed around it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.observers.observer import AbstractObserver
from eoi_jax.plants.plant import Plant, State
from eoi_jax.types import Output, Regressor, Scalar, Theta


class Steps(eqx.Module):
    """One record as a kernel reads it: S = N - 1 steps between its samples.

    Attributes:
        time: middle of each step [s], shape (S,).
        y, y_next: outputs at both ends of each step, shape (S, ny).
        u: inputs during each step, shape (S, nu).
        use: 1 where model and measurement belong together, shape (S, ny).
        score: 1 where least squares and index count the step, shape (S, ny).
        restart: where the observer starts anew (first step, first step after a gap).
        start_rates: rough rates to start with, shape (rates, ny).
        block_weight: of each step's scores in its block, for the covariance.
        block_end: last step of each block.
        sample_period: h [s].
    """

    time: Float[Array | np.ndarray, "*batch S"]
    y: Float[Array | np.ndarray, "*batch S ny"]
    y_next: Float[Array | np.ndarray, "*batch S ny"]
    u: Float[Array | np.ndarray, "*batch S nu"]
    use: Float[Array | np.ndarray, "*batch S ny"]
    score: Float[Array | np.ndarray, "*batch S ny"]
    restart: Bool[Array | np.ndarray, "*batch S"]
    block_weight: Float[Array | np.ndarray, "*batch S"]
    block_end: Bool[Array | np.ndarray, "*batch S"]
    sample_period: Float[Array | np.ndarray, "*batch"]


# Steps that are treated together: within one only the observer goes step by step; model, filter and
# sums are a few matrix products. Larger ones cost more in the filter, smaller ones in overhead.
_BLOCK = 64


class Sums(eqx.Module):
    """What a pass adds up, over scored steps and for each output.

    `weight` is the sum of F[m]², the power that a unit injection would have had.
    """

    information: Float[Array, "ny np np"]
    rhs: Float[Array, "ny np"]
    square: Float[Array, " ny"]
    observed_square: Float[Array, " ny"]
    weight: Float[Array, " ny"]
    count: Float[Array, " ny"]
    sliding: Float[Array, " ny"]
    meat: Float[Array, "np np"]


class Trace(eqx.Module):
    """What a pass stores when asked: for each step, at its end.

    All of it is filtered with the mask m inside, F[m u_eq], F[m φ] Δθ, F[m φ]; divided by
    `weight` = F[m] it is a weighted mean over the filter's memory.
    """

    injection: Float[Array, "*steps ny"]
    explained: Float[Array, "*steps ny"]
    weight: Float[Array, "*steps ny"]
    Phi: Float[Array, "*steps ny np"] | None


class _Follow(eqx.Module):
    """What one step hands to the next."""

    observer: Any
    z: Float[Array, " nz"]
    sensitivity: Float[Array, "nz np"]


class _Seen(eqx.Module):
    """What one step shows: the observation, and the internal states in its middle."""

    observed: Output
    rates: Float[Array, "rates ny"]
    sliding: Float[Array, " ny"]
    z: Float[Array, " nz"]
    sensitivity: Float[Array, "nz np"]


class _Carry(eqx.Module):
    """What one block of steps hands to the next."""

    follow: _Follow
    history: tuple[Float[Array, "taps ny"], Float[Array, "taps ny np"]]
    filtered: Float[Array, "order ny columns"]
    scores: Float[Array, " np"]
    sums: Sums


class _Response(eqx.Module):
    """A filter over a block of steps: what signals inside it and the state before it give."""

    inside: Float[Array, "block block"]
    before: Float[Array, "block order"]
    last_inside: Float[Array, "order block"]
    last_before: Float[Array, "order order"]

    def __call__(
        self, state: Float[Array, "order *signal"], values: Float[Array, "block *signal"]
    ) -> tuple[Float[Array, "order *signal"], Float[Array, "block *signal"]]:
        """State behind the block, and the output along it."""
        x, v = state.reshape(state.shape[0], -1), values.reshape(values.shape[0], -1)
        last = self.last_before @ x + self.last_inside @ v
        along = self.before @ x + self.inside @ v
        return last.reshape(state.shape), along.reshape(values.shape)


def _response(lowpass: DiscreteFilter, size: int) -> _Response:
    """x[k+1] = A x[k] + b v[k] with output x₀[k+1], unrolled over `size` steps."""
    a, b = jnp.asarray(lowpass.transition), jnp.asarray(lowpass.entry)
    _, powers = jax.lax.scan(lambda p, _: (a @ p, p), jnp.eye(len(b), dtype=a.dtype), None, size)
    impulse = powers @ b  # (size, order): A^k b
    lag = np.arange(size)[:, None] - np.arange(size)[None, :]
    inside = jnp.where(lag >= 0, impulse[np.maximum(lag, 0), 0], 0.0)
    return _Response(inside, powers[:, 0] @ a, impulse[::-1].T, a @ powers[-1])


@eqx.filter_jit
def run_pass(
    plant: Plant,
    observer: AbstractObserver,
    lowpass: DiscreteFilter,
    steps: Steps,
    theta: Theta,
    increment: Theta | None = None,
    weights: Output | None = None,
    store: str = "nothing",
) -> tuple[Sums, Trace | None]:
    """One pass over a batch of records (leading axis on `lowpass` and `steps`).

    Args:
        plant: the model; its structure only, parameters come from `theta`.
        observer: with its gains.
        lowpass: the sampled filter of each record.
        steps: the records, padded to one length with `use` = `score` = 0.
        theta: θ of this pass.
        increment: Δθ with which `Trace.explained` = F[φ] Δθ and the scores are formed; or zero.
        weights: of each output in the scores, shape (ny,); or one.
        store: ``"nothing"``, ``"signals"`` (injection and explained part), or
            ``"regressors"`` (F[φ] too).

    Returns:
        Sums and traces, each with the records as leading axis.
    """
    increment = jnp.zeros_like(theta) if increment is None else increment
    weights = jnp.ones(len(plant.outputs), theta.dtype) if weights is None else weights

    def one(lowpass: DiscreteFilter, steps: Steps) -> tuple[Sums, Trace | None]:
        kernel = _Kernel(plant, observer, lowpass, theta, increment, weights, store)
        return kernel.run(steps)

    return jax.vmap(one)(lowpass, steps)


class _Kernel(eqx.Module):
    """The scan of one record; fields as in `run_pass`."""

    plant: Plant
    observer: AbstractObserver
    lowpass: DiscreteFilter
    theta: Theta
    increment: Theta
    weights: Output
    store: str = eqx.field(static=True)

    def run(self, steps: Steps) -> tuple[Sums, Trace | None]:
        h = jnp.asarray(steps.sample_period)
        response = _response(self.lowpass, _BLOCK)
        last, stored = jax.lax.scan(
            lambda carry, rows: self._block(carry, rows, response, h),
            self._init(steps, h),
            _in_blocks(steps),
        )
        if stored is None:
            return last.sums, None
        stored = stored.reshape(-1, *stored.shape[2:])[: steps.time.shape[0]]
        phi = stored[..., 3:] if self.store == "regressors" else None
        return last.sums, Trace(stored[..., 0], stored[..., 1], stored[..., 2], phi)

    def _init(self, steps: Steps, h: Scalar) -> _Carry:
        ny, size = len(self.plant.outputs), self.theta.shape[0]
        zeros, dtype = jnp.zeros, self.theta.dtype
        z, sensitivity = _value_and_jacobian(
            lambda shift: self.plant.internal_start(self.theta + shift), size, dtype
        )
        taps = _kernel_weights(self.observer, ny).shape[0]
        each = zeros(ny, dtype)
        phi = zeros((ny, size), dtype)
        sums = Sums(
            zeros((ny, size, size), dtype),
            phi,
            each,
            each,
            each,
            each,
            each,
            zeros((size, size), dtype),
        )
        return _Carry(
            _Follow(self._start(steps.y[0], steps.y_next[0], h), z, sensitivity),
            (zeros((taps - 1, ny), dtype), zeros((taps - 1, ny, size), dtype)),
            zeros((self.lowpass.entry.shape[0], ny, size + 3), dtype),
            zeros(size, dtype),
            sums,
        )

    def _start(self, y: Any, y_next: Any, h: Scalar) -> Any:
        """Start on the measurement, with its first increment as velocity."""
        rows = self.plant.relative_degree - 1
        rates = jnp.zeros((rows, y.shape[0]), self.theta.dtype)
        if rows:
            rates = rates.at[0].set((y_next - y) / h)
        return self.observer.init(jnp.asarray(y, self.theta.dtype), rates)

    def _block(
        self, carry: _Carry, rows: tuple, response: _Response, h: Scalar
    ) -> tuple[_Carry, Array | None]:
        """A block of steps: only what must be is done one step after another."""
        t, y, y_next, u, use, score, restart, *block = rows
        position = y if self.observer.scheme == "explicit" else 0.5 * (y + y_next)
        follow, seen = jax.lax.scan(
            lambda follow, row: self._step(follow, row, h),
            carry.follow,
            (t, position, y, y_next, u, restart),
        )
        f, phi = jax.vmap(self._model)(t, position, seen, u)
        (f, phi), history = self._averaged(carry.history, (f, phi))
        injection = seen.observed - f
        columns = [injection[..., None], seen.observed[..., None], jnp.ones_like(f)[..., None], phi]
        signals = jnp.concatenate(columns, axis=-1)
        # A model that is undefined where it does not count (√ of a negative level) must not spread.
        signals = jnp.where(use[..., None] > 0, use[..., None] * signals, 0.0)
        filtered, along = response(carry.filtered, signals)
        sums, scores, stored = self._add(carry, along, seen.sliding, score, *block)
        return _Carry(follow, history, filtered, scores, sums), stored

    def _step(self, follow: _Follow, row: tuple, h: Scalar) -> tuple[_Follow, _Seen]:
        """The observer, and the internal states that the measurement drives."""
        t, position, y, y_next, u, restart = row
        state = jax.tree.map(
            lambda new, old: jnp.where(restart, new, old),
            self._start(y, y_next, h),
            follow.observer,
        )
        rates = self.observer.rates(state)
        middle, sensitivity, z, sensitivity_next = self._internal(follow, t, position, u, rates, h)
        predicted = State(jnp.concatenate([position[None], rates]), middle)
        drift = self.plant.derivative(t, predicted, u, self.theta)
        state, seen = self.observer.step(state, y, y_next, drift, h)
        sliding = seen.sliding.astype(self.theta.dtype)
        shown = _Seen(seen.observed, seen.rates, sliding, middle, sensitivity)
        return _Follow(state, z, sensitivity_next), shown

    def _internal(
        self, follow: _Follow, t: Scalar, position: Output, u: Array, rates: Array, h: Scalar
    ) -> tuple[Array, Array, Array, Array]:
        """z in the middle and at the end of the step (Runge–Kutta of order four), with ∂z/∂θ."""
        if self.plant.internal is None:
            return follow.z, follow.sensitivity, follow.z, follow.sensitivity
        y = jnp.concatenate([position[None], rates])

        def ends(shift: Theta) -> tuple[Array, Array]:
            theta = self.theta + shift
            z = follow.z + follow.sensitivity @ shift

            def rate(z: Array) -> Array:
                return self.plant.internal_rate(t, State(y, z), u, theta)

            first = rate(z)
            second = rate(z + 0.5 * h * first)
            third = rate(z + 0.5 * h * second)
            fourth = rate(z + h * third)
            end = z + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
            # Cubic through both ends; the slope at the end is nearly `fourth`.
            return 0.5 * (z + end) + h / 8.0 * (first - fourth), end

        (middle, end), jacobian = _value_and_jacobian(ends, self.theta.shape[0], self.theta.dtype)
        return middle, jacobian[0], end, jacobian[1]

    def _model(
        self, t: Scalar, position: Output, seen: _Seen, u: Array
    ) -> tuple[Output, Regressor]:
        """f and φ = df/dθ, total: through the internal states too."""
        y = jnp.concatenate([position[None], seen.rates])

        def shifted(shift: Theta) -> Output:
            x = State(y, seen.z + seen.sensitivity @ shift)
            return self.plant.derivative(t, x, u, self.theta + shift)

        return _value_and_jacobian(shifted, self.theta.shape[0], self.theta.dtype)

    def _averaged(self, history: tuple, model: tuple) -> tuple[tuple, tuple]:
        """The observer's own moving average, on model and regressors; and what the next needs."""
        weights = _kernel_weights(self.observer, len(self.plant.outputs))
        f, phi = (jnp.concatenate(both) for both in zip(history, model, strict=True))
        size, last = len(model[0]), len(weights) - 1
        lagged = [(w, slice(last - i, last - i + size)) for i, w in enumerate(weights)]
        averages = (
            sum(w * f[part] for w, part in lagged),
            sum(w[:, None] * phi[part] for w, part in lagged),
        )
        return averages, (f[size:], phi[size:])

    def _add(
        self,
        carry: _Carry,
        along: Float[Array, "block ny columns"],
        sliding: Float[Array, "block ny"],
        score: Float[Array, "block ny"],
        weight_in_block: Float[Array, " block"],
        block_end: Bool[Array, " block"],
    ) -> tuple[Sums, Float[Array, " np"], Array | None]:
        injection, observed, weight, phi = *jnp.moveaxis(along[..., :3], -1, 0), along[..., 3:]
        old, scores, meat = carry.sums, carry.scores, carry.sums.meat
        weighted = score[..., None] * phi
        explained = phi @ self.increment
        if self.store != "nothing":
            rest = weight_in_block[:, None] * self.weights * (injection - explained)
            blocks, scores = _block_sums(
                scores, jnp.einsum("kj,kja->ka", rest, weighted), block_end
            )
            meat = meat + blocks.T @ blocks
        sums = Sums(
            old.information + jnp.einsum("kja,kjb->jab", weighted, phi),
            old.rhs + jnp.einsum("kja,kj->ja", weighted, injection),
            old.square + jnp.sum(score * injection**2, axis=0),
            old.observed_square + jnp.sum(score * observed**2, axis=0),
            old.weight + jnp.sum(score * weight**2, axis=0),
            old.count + jnp.sum(score, axis=0),
            old.sliding + jnp.sum(score * sliding, axis=0),
            meat,
        )
        if self.store == "nothing":
            return sums, scores, None
        shown = jnp.stack([injection, explained, weight], axis=-1)
        if self.store == "regressors":
            shown = jnp.concatenate([shown, phi], axis=-1)
        return sums, scores, shown


def _block_sums(
    before: Float[Array, " np"], scores: Float[Array, "steps np"], end: Bool[Array, " steps"]
) -> tuple[Float[Array, "steps np"], Float[Array, " np"]]:
    """Sums of scores up to each end of a block (other rows zero), and what the last block has."""
    total = before + jnp.cumsum(scores, axis=0)
    ends = jax.lax.cummax(jnp.where(end, jnp.arange(len(end)), -1))
    earlier = jnp.concatenate([-jnp.ones(1, ends.dtype), ends[:-1]])

    def at(index: Array) -> Array:
        return jnp.where(index[..., None] >= 0, total[index], 0.0)

    return jnp.where(end[:, None], total - at(earlier), 0.0), total[-1] - at(ends[-1])


def _in_blocks(steps: Steps) -> tuple:
    """The rows of a record, `_BLOCK` steps together; what fills the last block does not count."""
    count = steps.time.shape[0]
    missing = -count % _BLOCK

    def blocks(row: Array | np.ndarray, mode: str) -> Array:
        wide = jnp.pad(row, [(0, missing)] + [(0, 0)] * (row.ndim - 1), mode=mode)
        return wide.reshape(wide.shape[0] // _BLOCK, _BLOCK, *row.shape[1:])

    signals, flags = _rows(steps)[:4], _rows(steps)[4:]
    return (*(blocks(row, "edge") for row in signals), *(blocks(row, "constant") for row in flags))


def _rows(steps: Steps) -> tuple:
    return (
        steps.time,
        steps.y,
        steps.y_next,
        steps.u,
        steps.use,
        steps.score,
        steps.restart,
        steps.block_weight,
        steps.block_end,
    )


def _kernel_weights(observer: AbstractObserver, ny: int) -> Float[np.ndarray, "taps ny"]:
    weights = np.atleast_2d(np.asarray(observer.kernel, dtype=float))
    return np.broadcast_to(weights, (ny, weights.shape[1])).T


def _value_and_jacobian(function: Any, size: int, dtype: Any) -> tuple[Any, Any]:
    """Value and Jacobian at a zero shift of θ, forward mode: all parameters in one sweep."""

    def twice(shift: Theta) -> tuple[Any, Any]:
        value = function(shift)
        return value, value

    jacobian, value = jax.jacfwd(twice, has_aux=True)(jnp.zeros(size, dtype))
    return value, jacobian
