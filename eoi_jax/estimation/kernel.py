r"""One pass over a record: observer, filter, normal equations and index in one loop.

For each step k → k+1 of the record (sections 3 and 4 of the paper):

1. the observer follows y with the model at θ, and gives an estimate of y^(r) (section 3);
2. u_eq = observed - f, with f at the middle of the step, averaged as the observer averages;
3. F[u_eq] and F[φ], with the same filter (19) on both;
4. the sums Σ φᵀφ and Σ φᵀu_eq of (11), the sum of squares of the index (14), and the number of
   samples in sliding mode.

An output of relative degree 0 is no derivative, and no mean over a step: an input that jumps at a
sample (the drop R i of a battery) would be averaged over the jump. It is, at a sample,

    y[k] = f(t_k, x_k, u(t_k⁺); θ)

where t_k⁺ is just after the jump of a held input: what a logger records that sets the input and
reads the outputs in one turn. So the step k → k+1 compares y[k] with f at its start. There z is the
kernel's z_k, other outputs are the y[k] measured, and their rates the means of those in the middles
of both steps around it, ẏ(t_k) = (ẏ[k-½] + ẏ[k+½])/2 + O(h²). The injection is y - f, the regressor
the total derivative φ = ∂f/∂θ + (∂f/∂z)(∂z/∂θ). Between samples, at sub-steps, there is nothing to
compare: these have the weight zero on both sides.

No sample is stored unless asked for. A step that must not count (a gap, dry friction at rest)
enters F on *both* sides with weight zero: F[m u_eq] = F[m φ] Δθ holds for any mask m, so that no
margin is needed around it.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check
from eoi_jax._types import Output, Regressor, Scalar, Theta
from eoi_jax.compiler.programs import jit
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.estimation.observers.observer import AbstractObserver, Observation
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.start_weights import free_starts
from eoi_jax.simulation.runge_kutta import middle_of_step, runge_kutta_step


class Steps(eqx.Module):
    """One record as the kernel reads it: S = N - 1 steps between its samples.

    Attributes:
        time: middle of each step [s], shape (S,).
        y, y_next: outputs at both ends of each step, shape (S, ny).
        u: inputs during each step, shape (S, nu).
        use: 1 where model and measurement belong together, shape (S, ny).
        score: 1 where least squares and index count the step, shape (S, ny).
        restart: where the observer is initialised again (first step, first step after a gap).
        block_weight: weight of each step's scores in its block, for the covariance.
        block_end: whether a step is the last of its block.
        sample_period: h [s].
        u_start: inputs that hold from the start of each step on, shape (S, nu); None if no output
            has relative degree 0.
        z_start: internal states at the start of the record at θ = 0, and their derivatives with θ,
            shape (nz, 1 + np), of which those count that the plant declares as free; None where it
            declares all.
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
    u_start: Float[Array | np.ndarray, "*batch S nu"] | None = None
    z_start: Float[Array | np.ndarray, "*batch nz columns"] | None = None

    @property
    def begin(self) -> tuple[Any, ...]:
        """Of one record, what `Kernel.init` begins with: both ends of the first step, z there."""
        return self.y[0], self.y_next[0], self.z_start


class Sums(eqx.Module):
    """Sums of a pass over the scored steps, for each output.

    Attributes:
        information: Σ φᵀφ.
        rhs: Σ φᵀ u_eq.
        square: Σ u_eq².
        observed_square: Σ (observed y^(r))².
        weight: Σ F[m]², the power of an injection of one.
        count: number of scored steps.
        sliding: number of scored steps in sliding mode.
        meat: of the sandwich covariance, Σ over blocks of the outer products of their scores.
    """

    information: Float[Array | np.ndarray, "ny np np"]
    rhs: Float[Array | np.ndarray, "ny np"]
    square: Float[Array | np.ndarray, " ny"]
    observed_square: Float[Array | np.ndarray, " ny"]
    weight: Float[Array | np.ndarray, " ny"]
    count: Float[Array | np.ndarray, " ny"]
    sliding: Float[Array | np.ndarray, " ny"]
    meat: Float[Array | np.ndarray, "np np"]


class Trace(eqx.Module):
    """Filtered signals of a pass, at the end of each step; stored if asked for.

    The mask m is inside the filter, F[m u_eq] and F[m φ]; divided by `weight` = F[m] they are
    weighted means over the filter's memory.
    """

    injection: Float[Array | np.ndarray, "*steps ny"]
    weight: Float[Array | np.ndarray, "*steps ny"]
    Phi: Float[Array | np.ndarray, "*steps ny np"]


class Signals(eqx.Module):
    """What passes F, in a step, or its states with a leading axis (order,).

    Each is an array of its own: as columns of one array XLA computes the model again for every
    column, whenever lanes of a `vmap` share parameters or gains.

    Attributes:
        injection: m u_eq with the mask m.
        observed: m times the observed y^(r).
        weight: m.
        phi: m φ.
    """

    injection: Float[Array, "*order ny"]
    observed: Float[Array, "*order ny"]
    weight: Float[Array, "*order ny"]
    phi: Float[Array, "*order ny np"]


class Step(eqx.Module):
    """One step of a record as the loop reads it, or all steps with a leading axis.

    Fields that are not listed are those of `Steps`.

    Attributes:
        u: inputs behind the actuators, shape (nu,).
        slope: their derivative with θ, shape (nu, np); None without actuators.
        u_start, slope_start: as in `Steps`, and the derivative with θ.
        emphasis: factor on `score`, such as how often a bootstrap drew the step.
    """

    u: Float[Array, "*steps nu"]
    slope: Float[Array, "*steps nu np"] | None
    time: Float[Array, "*steps"]
    y: Float[Array, "*steps ny"]
    y_next: Float[Array, "*steps ny"]
    use: Float[Array, "*steps ny"]
    score: Float[Array, "*steps ny"]
    restart: Bool[Array, "*steps"]
    block_weight: Float[Array, "*steps"]
    block_end: Bool[Array, "*steps"]
    u_start: Float[Array, "*steps nu"] | None = None
    slope_start: Float[Array, "*steps nu np"] | None = None
    emphasis: Float[Array, "*steps"] | None = None


class Carry(eqx.Module):
    """State of the loop between two steps.

    Attributes:
        observer: its state.
        z, sensitivity: internal states and ∂z/∂θ.
        history: f and φ of the last steps, for the moving average.
        filtered: state of F.
        block: scores of the block so far.
        sums: so far.
        rates: in the middle of the last step; None if no output of relative degree 0 needs them.
    """

    observer: Any
    z: Float[Array, " nz"]
    sensitivity: Float[Array, "nz np"]
    history: tuple[tuple[Output, Regressor], ...]
    filtered: Signals
    block: Float[Array, " np"]
    sums: Sums
    rates: Float[Array, "rates ny"] | None = None


Shift = Float[Array, " directions"]
Shifted = Callable[[Shift], Any]  # a quantity, such as the inputs, as a function of a shift of θ


@jit
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
        increment: Δθ of the scores φᵀ(u_eq - φ Δθ); zero by default.
        weights: of each output in the scores, shape (ny,); one by default.
        store: ``"nothing"``, ``"signals"`` (a `Trace`), or ``"scores"`` (only `Sums.meat`).

    Returns:
        Sums and traces, each with the records as leading axis.
    """
    increment = jnp.zeros_like(theta) if increment is None else increment
    weights = jnp.ones(len(plant.outputs), theta.dtype) if weights is None else weights

    def run_record(lowpass: DiscreteFilter, steps: Steps) -> tuple[Sums, Trace | None]:
        kernel = Kernel(plant, observer, lowpass, theta, increment, weights, store)
        return kernel.run(steps)

    return jax.vmap(run_record)(lowpass, steps)


def step_rows(
    steps: Steps,
    u: Array,
    slope: Array | None,
    emphasis: Array | None = None,
    u_start: Array | None = None,
    slope_start: Array | None = None,
) -> Step:
    """All steps of a record, with the inputs behind the actuators; arguments as in `Step`."""
    return Step(
        u=u,
        slope=slope,
        time=jnp.asarray(steps.time),
        y=jnp.asarray(steps.y),
        y_next=jnp.asarray(steps.y_next),
        use=jnp.asarray(steps.use),
        score=jnp.asarray(steps.score),
        restart=jnp.asarray(steps.restart),
        block_weight=jnp.asarray(steps.block_weight),
        block_end=jnp.asarray(steps.block_end),
        emphasis=emphasis,
        u_start=u_start,
        slope_start=slope_start,
    )


class Kernel(eqx.Module):
    """The loop over one record as `init` and `step`; fields as in `run_pass`.

    Attributes:
        columns: directions in θ along which the regressors are taken, shape (np, directions); by
            default the parameters themselves.
    """

    plant: Plant
    observer: AbstractObserver
    lowpass: DiscreteFilter
    theta: Theta
    increment: Theta
    weights: Output
    store: str = eqx.field(static=True)
    columns: Float[Array, "np directions"] | None = None

    def run(
        self, steps: Steps, emphasis: Float[Array, " blocks"] | None = None
    ) -> tuple[Sums, Trace | None]:
        """The whole record under `lax.scan`.

        Args:
            steps: of one record.
            emphasis: factor on the scores of each of its blocks; one by default.
        """
        h = jnp.asarray(steps.sample_period)
        rows = self.rows(steps, emphasis)
        y, y_next, z_start = jax.tree.map(jnp.asarray, steps.begin)
        start = self.init(y, y_next, h, z_start)
        last, trace = jax.lax.scan(lambda carry, row: self.step(carry, row, h), start, rows)
        return last.sums, trace

    def rows(self, steps: Steps, emphasis: Float[Array, " blocks"] | None = None) -> Step:
        """All steps of a record, each field with a leading axis (S,)."""
        factors = None
        if emphasis is not None:
            ends = jnp.asarray(steps.block_end)
            factors = emphasis[jnp.cumsum(ends) - ends]
        return step_rows(steps, *self.inputs(steps), factors, *self._inputs_at_starts(steps))

    def inputs(self, steps: Steps) -> tuple[Array, Array | None]:
        """Inputs behind the actuators, (S, nu), and their derivative with θ, (S, nu, np)."""
        return self._behind_actuators(
            self.plant.driven, jnp.asarray(steps.time), jnp.asarray(steps.u)
        )

    def _inputs_at_starts(self, steps: Steps) -> tuple[Array | None, Array | None]:
        """The same at the start of each step; None if no output has relative degree 0."""
        if steps.u_start is None:
            return None, None
        arrays = (jnp.asarray(part) for part in (steps.time, steps.u, steps.u_start))
        return self._behind_actuators(self.plant.driven_at_starts, *arrays)

    def _half_step(self, h: Scalar) -> Any:
        """From the start of a step to the instant at which the model is evaluated [s]."""
        return 0.0 if self.observer.scheme == "explicit" else 0.5 * h

    def _behind_actuators(
        self, driven: Callable[..., Array], *signals: Array
    ) -> tuple[Array, Array | None]:
        """A function of signals, the last of them the inputs, and θ; with its derivative."""
        if self.plant.actuator is None:
            return signals[-1], None
        return self._value_and_jacobian(lambda shift: driven(*signals, self._theta_at(shift)))

    def init(
        self, y: Output, y_next: Output, h: Scalar, z_start: Float[Array, "nz _"] | None = None
    ) -> Carry:
        """Carry before the first step.

        Args:
            y: outputs at the start of that step.
            y_next: outputs at its end.
            h: sample period [s].
            z_start: as in `Steps`.
        """
        ny, size, dtype = len(self.plant.outputs), self._directions, self.theta.dtype
        zeros = jnp.zeros
        z, sensitivity = self._value_and_jacobian(
            lambda shift: self._internal_start(self._theta_at(shift), z_start)
        )
        taps = _kernel_weights(self.observer, ny).shape[0]
        zero_output = zeros(ny, dtype)
        zero_phi = zeros((ny, size), dtype)
        sums = Sums(
            zeros((ny, size, size), dtype),
            zero_phi,
            zero_output,
            zero_output,
            zero_output,
            zero_output,
            zero_output,
            zeros((size, size), dtype),
        )
        return Carry(
            self._start(y, y_next, h),
            z,
            sensitivity,
            ((zero_output, zero_phi),) * (taps - 1),
            jax.tree.map(
                lambda signal: zeros((self.lowpass.entry.shape[0], *signal.shape), dtype),
                Signals(zero_output, zero_output, zero_output, zero_phi),
            ),
            zeros(size, dtype),
            sums,
            zeros((self.plant.rows - 1, ny), dtype) if self._keeps_rates else None,
        )

    def _internal_start(self, theta: Theta, z_start: Float[Array, "nz _"] | None) -> Array:
        z = self.plant.internal_start(theta)
        if z_start is None:
            return z
        free = free_starts(self.plant.internal_initial, z.size)
        return jnp.where(free, z_start[:, 0] + z_start[:, 1:] @ theta, z)

    @property
    def _keeps_rates(self) -> bool:
        """Whether an output of relative degree 0 may depend on rates of the others."""
        implicit = self.observer.scheme == "implicit"
        return self.plant.has_algebraic and self.plant.relative_degree > 1 and implicit

    def _start(self, y: Any, y_next: Any, h: Scalar) -> Any:
        """Observer state at the measurement, with its first increment as velocity."""
        rows = self.plant.rows - 1
        rates = jnp.zeros((rows, y.shape[0]), self.theta.dtype)
        if rows:
            rates = rates.at[0].set((y_next - y) / h)
        return self.observer.init(jnp.asarray(y, self.theta.dtype), rates)

    def step(self, carry: Carry, row: Step, h: Scalar) -> tuple[Carry, Any]:
        """One step of the loop.

        Args:
            carry: state before the step.
            row: the step.
            h: sample period [s].

        Returns:
            The state after the step, and its `Trace` if stored.
        """
        u, t, y, y_next = row.u, row.time, row.y, row.y_next

        def inputs_at(shift: Shift) -> Array:
            return u if row.slope is None else u + row.slope @ shift

        if self.plant.has_algebraic:  # no state: the model does not read it
            y, y_next = (jnp.where(self.plant.algebraic, 0.0, value) for value in (y, y_next))
        state = jax.tree.map(
            lambda new, previous: jnp.where(row.restart, new, previous),
            self._start(row.y, row.y_next, h),
            carry.observer,
        )
        explicit = self.observer.scheme == "explicit"
        position = y if explicit else 0.5 * (y + y_next)
        z, sensitivity, z_next, sensitivity_next = self._internal(
            carry, row, position, inputs_at, state, h
        )
        predicted = State(jnp.concatenate([position[None], self.observer.rates(state)]), z)
        drift = self.plant.derivative(t, predicted, u, self.theta)
        state, observation = self._observed(state, row, drift, h)
        f, phi = self._model(t, position, observation.rates, z, sensitivity, inputs_at)
        if self.plant.has_algebraic:
            at_start = self._model_at_start(carry, row, y, observation.rates, h)
            algebraic = self.plant.algebraic
            f = jnp.where(algebraic, at_start[0], f)
            phi = jnp.where(algebraic[:, None], at_start[1], phi)
        history = ((f, phi), *carry.history)
        f, phi = self._moving_average(history)
        signals = Signals(observation.observed - f, observation.observed, jnp.ones_like(f), phi)
        filtered = jax.tree.map(partial(self._filtered, row.use), carry.filtered, signals)
        sums, block, trace = self._accumulate(carry, filtered, observation, row)
        new = Carry(
            state,
            z_next,
            sensitivity_next,
            history[: len(carry.history)],
            filtered,
            block,
            sums,
            observation.rates if self._keeps_rates else None,
        )
        return new, trace

    def _observed(self, state: Any, row: Step, drift: Output, h: Scalar) -> tuple[Any, Observation]:
        """The observer's step; one of a user's own may return something of another kind."""
        pair = self.observer.step(state, row.y, row.y_next, drift, h)
        good = isinstance(pair, tuple) and len(pair) == 2 and isinstance(pair[1], Observation)
        field = f"{type(self.observer).__name__}.step"
        rule = "must return two values, the new state and an `Observation`"
        count = f"a tuple of {len(pair)}" if isinstance(pair, tuple) else type(pair).__name__
        check(good, field, rule, count)
        return pair

    def _model_at_start(
        self, carry: Carry, row: Step, y: Output, rates: Array, h: Scalar
    ) -> tuple[Output, Regressor]:
        """f and φ of outputs of relative degree 0, at the start of a step.

        Args:
            carry: state before the step.
            row: the step.
            y: outputs at its start, zero where they are no states.
            rates: of the observer, in the middle of the step.
            h: sample period [s].
        """
        if carry.rates is not None:
            before = jnp.where(row.restart, rates, carry.rates)
            rates = 0.5 * (before + rates)
        t = row.time - self._half_step(h)
        return self._model(t, y, rates, carry.z, carry.sensitivity, partial(_moved_start, row))

    def _internal(
        self, carry: Carry, row: Step, position: Output, u: Shifted, state: Any, h: Scalar
    ) -> tuple[Array, Array, Array, Array]:
        """z in the middle and at the end of a Runge–Kutta step, with ∂z/∂θ.

        Where an output of relative degree 0 shows z at the samples, the input rises or falls over
        the step, from its value at the start through that in the middle: steps are as long as
        samples then, and its mean alone would cost an error of h²/12 ü.
        """
        if self.plant.internal is None:
            return carry.z, carry.sensitivity, carry.z, carry.sensitivity
        y = jnp.concatenate([position[None], self.observer.rates(state)])
        instants = self._instants(row, y, u, h)

        def middle_and_end(shift: Shift) -> tuple[Array, Array]:
            theta = self._theta_at(shift)
            z = carry.z + carry.sensitivity @ shift

            def rate(z: Array, instant: tuple[Scalar, Array, Shifted]) -> Array:
                t, y, inputs = instant
                return self.plant.internal_rate(t, State(y, z), inputs(shift), theta)

            end, slopes = runge_kutta_step(rate, z, h, instants)
            return middle_of_step(z, end, slopes, h), end

        (middle, end), jacobian = self._value_and_jacobian(middle_and_end)
        return middle, jacobian[0], end, jacobian[1]

    def _instants(self, row: Step, y: Array, u: Shifted, h: Scalar) -> tuple[Any, Any, Any]:
        """Time, outputs and inputs at the start, the middle and the end of a step, for z."""
        middle = (row.time, y, u)
        if not self.plant.has_algebraic or self.observer.scheme == "explicit":
            return middle, middle, middle
        start = partial(_moved_start, row)

        def end(shift: Shift) -> Array:
            return 2.0 * u(shift) - start(shift)

        ends = []
        for t, outputs, inputs in (
            (row.time - 0.5 * h, row.y, start),
            (row.time + 0.5 * h, row.y_next, end),
        ):
            ends.append((t, y.at[0].set(jnp.where(self.plant.algebraic, 0.0, outputs)), inputs))
        return ends[0], middle, ends[1]

    def _model(
        self,
        t: Scalar,
        position: Output,
        rates: Array,
        z: Array,
        sensitivity: Array,
        u: Shifted,
    ) -> tuple[Output, Regressor]:
        """f and φ = df/dθ, total: through the internal states too."""
        y = jnp.concatenate([position[None], rates])

        def model_at(shift: Shift) -> Output:
            x = State(y, z + sensitivity @ shift)
            return self.plant.derivative(t, x, u(shift), self._theta_at(shift))

        return self._value_and_jacobian(model_at)

    def _moving_average(self, history: tuple) -> tuple[Output, Regressor]:
        """Moving average of the observer, applied to model and regressors."""
        weights = jnp.asarray(
            _kernel_weights(self.observer, len(self.plant.outputs)), self.theta.dtype
        )
        f = sum(weight * values[0] for weight, values in zip(weights, history, strict=True))
        phi = sum(
            weight[:, None] * values[1] for weight, values in zip(weights, history, strict=True)
        )
        return f, phi  # type: ignore[return-value]

    def _filtered(
        self, use: Output, state: Float[Array, "order *signal"], signal: Float[Array, "*signal"]
    ) -> Float[Array, "order *signal"]:
        """F of a signal of each output, one step further."""
        counted = use.reshape(-1, *(1,) * (signal.ndim - 1))
        # A model that is undefined at a masked step (√ of a negative level) must not spread NaN.
        return self.lowpass.step(state, jnp.where(counted > 0, counted * signal, 0.0))

    def _accumulate(
        self, carry: Carry, filtered: Signals, observation: Observation, row: Step
    ) -> tuple[Sums, Array, Any]:
        parts = filtered.injection, filtered.observed, filtered.weight, filtered.phi
        injection, observed, weight, phi = (part[0] for part in parts)
        score = row.score if row.emphasis is None else row.score * row.emphasis
        previous = carry.sums
        weighted = score[:, None] * phi
        block, meat = carry.block, previous.meat
        if self.store == "scores":
            scored_phi = row.score[:, None] * phi
            error = injection - phi @ self.increment
            block = block + row.block_weight * (self.weights * error) @ scored_phi
            # A block drawn k times counts as k blocks, not as one block of k times its size.
            repeats = 1.0 if row.emphasis is None else row.emphasis
            meat = meat + jnp.where(row.block_end, repeats * jnp.outer(block, block), 0.0)
            block = jnp.where(row.block_end, 0.0, block)
        sums = Sums(
            previous.information + weighted[:, :, None] * phi[:, None, :],
            previous.rhs + weighted * injection[:, None],
            previous.square + score * injection**2,
            previous.observed_square + score * observed**2,
            previous.weight + score * weight**2,
            previous.count + score,
            previous.sliding + score * observation.sliding,
            meat,
        )
        return sums, block, Trace(injection, weight, phi) if self.store == "signals" else None

    @property
    def _directions(self) -> int:
        return self.theta.shape[0] if self.columns is None else self.columns.shape[1]

    def _theta_at(self, shift: Shift) -> Theta:
        """θ shifted along each direction."""
        return self.theta + (shift if self.columns is None else self.columns @ shift)

    def _value_and_jacobian(self, function: Shifted) -> tuple[Any, Any]:
        """Value and Jacobian at a zero shift, forward mode: all directions in one sweep."""

        def value_twice(shift: Shift) -> tuple[Any, Any]:
            value = function(shift)
            return value, value

        zeros = jnp.zeros(self._directions, self.theta.dtype)
        jacobian, value = jax.jacfwd(value_twice, has_aux=True)(zeros)
        return value, jacobian


def _moved_start(row: Step, shift: Shift) -> Array:
    """Inputs at the start of a step, as a function of a shift of θ."""
    assert row.u_start is not None
    return row.u_start if row.slope_start is None else row.u_start + row.slope_start @ shift


def _kernel_weights(observer: AbstractObserver, ny: int) -> Float[np.ndarray, "taps ny"]:
    weights = np.atleast_2d(np.asarray(observer.kernel, dtype=float))
    return np.broadcast_to(weights, (ny, weights.shape[1])).T
