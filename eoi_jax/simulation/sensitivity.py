r"""Free runs with their forward sensitivities, as a recursion that adds up normal equations.

With unknowns $\vartheta$ (the start of the run, then the free parameters) and
$S = \partial x/\partial\vartheta$, a step $x_{k+1} = \Phi_k(x_k; \theta)$ of `integrator.py` gives

$S_{k+1} = \frac{\partial\Phi_k}{\partial x} S_k + \frac{\partial\Phi_k}{\partial\vartheta}$

by forward-mode differentiation, through every stop of dry friction. With the weighed error
$r = (y - \hat y)/\sigma$ of a scored output and
$c = (-\partial\hat y/\partial\vartheta/\sigma, r)$, the sums are $\sum w\,c\,c^\top$:
information, gradient and cost, and no trajectory is stored.
The weights are those of Huber's loss (P. J. Huber, *Robust Statistics*, section 7.8):
$w = 1$ up to $|r| = \kappa$, $\kappa/|r|$ beyond.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._types import Scalar
from eoi_jax.compiler.pointwise import along
from eoi_jax.models.actuators import changed_inputs
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.start_weights import proportional_starts, starts_anywhere
from eoi_jax.simulation.integrator import advanced, output_of

Host = Array | np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)  # not a module: made in each step of a fit
class RunLane:
    """What differs between lanes; every array may have a leading axis (lanes,).

    Attributes:
        theta: all parameters, shape (np,).
        start: unknowns of the initial state: outputs and derivatives, then z, then, behind
            actuators, levels of the inputs before the record, shape (own,).
        declared: 1 where the run begins a record: z then starts as the plant declares, and what is
            known of the start of the outputs has no slope; 0 where `start` says how.
        scale: 1/σ of each output, shape (ny,).
        threshold: κ of Huber's loss; infinite for squares.
    """

    theta: Any
    start: Any
    declared: Any
    scale: Any
    threshold: Any


class RunRow(eqx.Module):
    """A step: when, with which inputs, and what was measured at its start.

    Attributes:
        time: of its start [s].
        inputs: at its start, middle and end, shape (3, nu).
        y: outputs at its start, anything finite where not scored.
        use: 1 where scored, 0 where not; shape (ny,).
        slope: derivatives of the inputs that actuators change with `RunKernel.acting` at the lane's
            own values; None without actuators.
        past: derivatives of these inputs with the levels of all before the record; likewise.
    """

    time: Float[Host, "*steps"]
    inputs: Float[Host, "*steps 3 nu"]
    y: Float[Host, "*steps ny"]
    use: Float[Host, "*steps ny"]
    slope: Float[Host, "*steps 3 changed acting"] | None = None
    past: Float[Host, "*steps 3 changed nu"] | None = None


class Direction(eqx.Module):
    """Of one unknown, or of several (a leading axis).

    Attributes:
        start: in the initial state, shape (own,).
        theta: in all parameters, shape (np,).
    """

    start: Float[Host, "*unknowns own"]
    theta: Float[Host, "*unknowns np"]


class RunCarry(eqx.Module):
    """State, its derivatives with the unknowns (a leading axis), and the sums."""

    x: State
    slopes: State
    sums: Float[Array, "size size"]


class RunKernel(eqx.Module):
    """The recursion of one lane.

    Attributes:
        plant: the equations.
        friction: which outputs stick.
        free: numbers of the parameters that are unknown.
        rows, columns: of `State.y` that are states, in the order of `RunLane.start`.
        store: ``"sums"`` adds up the normal equations; ``"signals"`` shows c instead.
    """

    plant: Plant
    friction: tuple[int, ...] = eqx.field(static=True)
    free: tuple[int, ...] = eqx.field(static=True)
    rows: tuple[int, ...] = eqx.field(static=True)
    columns: tuple[int, ...] = eqx.field(static=True)
    store: str = eqx.field(static=True)

    @property
    def acting(self) -> tuple[int, ...]:
        """Numbers of the unknown parameters that may move the inputs behind actuators."""
        shapes = getattr(self.plant.actuator, "shapes", None)  # None: of an actuator of the user's
        return tuple(i for i in self.free if shapes is None or self.plant.names[i] in shapes)

    def start(self, values: Host, theta: Host, declared: Any) -> State:
        """Initial state from its unknowns; internal states by the plant where it declares them."""
        count = len(self.rows)
        empty = jnp.zeros((self.plant.rows, len(self.plant.outputs)), values.dtype)
        places = (np.asarray(part, dtype=int) for part in (self.rows, self.columns))
        y = empty.at[tuple(places)].set(values[:count])
        z = self.plant.internal_start(jnp.asarray(theta))
        as_declared = declared > 0
        initial = self.plant.internal_initial
        anywhere = starts_anywhere(initial, z.size)
        if np.any(anywhere):
            as_declared = as_declared & ~anywhere
        if self.plant.sampled is not None:  # those start as declared in every run
            sampled = np.arange(z.size) >= z.size - self.plant.sampled.size
            as_declared = as_declared | sampled
        z = jnp.where(as_declared, z, values[count : count + z.size])
        if np.any(anywhere):
            places, leaders, weights = proportional_starts(initial, z.size)
            z = z.at[places].set(weights * z[leaders])
        return State(y, z)

    def started(self, values: Host, theta: Host, declared: Host) -> State:
        """Initial states of several runs, a leading axis, as NumPy arrays."""
        return along(_start, ("fixed", "rows", "fixed"), self, (values, declared), theta)

    def directions(self, start_size: int) -> Direction:
        """Of each unknown; so many are in the start."""
        size = start_size + len(self.free)
        theta = np.zeros((size, len(self.plant.names)))
        theta[start_size + np.arange(len(self.free)), list(self.free)] = 1.0
        return Direction(np.eye(size, start_size), theta)

    def init(self, lane: RunLane) -> RunCarry:
        """Before the first step."""
        direction = self.directions(lane.start.shape[0])
        x, slopes = jax.vmap(partial(self.begun, lane), out_axes=(None, 0))(direction)
        size = len(direction.theta) + 1
        return RunCarry(x, slopes, jnp.zeros((size, size), jnp.asarray(lane.theta).dtype))

    def begun(self, lane: RunLane, direction: Direction) -> tuple[State, State]:
        """State before the first step, and its derivative in one direction."""
        values, theta = jnp.asarray(lane.start), jnp.asarray(lane.theta)

        def start(values: Array, theta: Array) -> State:
            return self.start(values, theta, lane.declared)

        tangents = [jnp.asarray(part, theta.dtype) for part in (direction.start, direction.theta)]
        if self.plant.start_items:
            fixed = np.zeros(values.shape)
            fixed[: len(self.rows)] = np.isfinite(self.plant.known_start[self.rows, self.columns])
            tangents[0] = tangents[0] * (1.0 - lane.declared * jnp.asarray(fixed, theta.dtype))
        return jax.jvp(start, (values, theta), tuple(tangents))

    def step(self, lane: RunLane, carry: RunCarry, row: RunRow, h: Scalar) -> tuple[RunCarry, Any]:
        """Score the sample at the start of a step, then take it; also what is shown."""
        c_rows = self._scored(lane, carry, row)
        sums = carry.sums
        if self.store == "sums":
            sums, c_rows = sums + self._square(lane, c_rows), ()

        def moved(slope: State, direction: Direction) -> tuple[State, State]:
            return self.moved(lane, carry.x, slope, direction, row, h)

        direction = self.directions(lane.start.shape[0])
        x, slopes = jax.vmap(moved, out_axes=(None, 0))(carry.slopes, direction)
        return RunCarry(x, slopes, sums), c_rows

    def moved(
        self,
        lane: RunLane,
        x: State,
        slope: State,
        direction: Direction,
        row: RunRow,
        h: Scalar,
        jvp: Callable = jax.jvp,
    ) -> tuple[State, State]:
        """State after a step, and its derivative in one direction, by `jvp`."""
        theta, time, u = (jnp.asarray(part) for part in (lane.theta, row.time, row.inputs))

        def flow(x: State, moved: Array, inputs: Array) -> State:
            return advanced(self.plant, moved, time, h, inputs, x, self.friction)

        change = None if row.slope is None else self._input_change(row, direction)
        return _derived(flow, (x, theta, u), slope, direction, change, jvp)

    def run(self, lane: RunLane, rows: RunRow, h: Scalar) -> tuple[Array, Any]:
        """A whole run by `lax.scan`: the sums, and what each row shows."""

        def step(carry: RunCarry, row: RunRow) -> tuple[RunCarry, Any]:
            return self.step(lane, carry, row, h)

        last, c_rows = jax.lax.scan(step, self.init(lane), rows)
        return last.sums, c_rows

    def _scored(self, lane: RunLane, carry: RunCarry, row: RunRow) -> Float[Array, "ny size"]:
        """c of each output."""
        error, columns = jax.vmap(
            lambda slope, direction: self.scored(lane, carry.x, slope, direction, row),
            out_axes=(None, 1),
        )(carry.slopes, self.directions(lane.start.shape[0]))
        return jnp.concatenate([columns, error[:, None]], axis=1)

    def scored(
        self,
        lane: RunLane,
        x: State,
        slope: State,
        direction: Direction,
        row: RunRow,
        jvp: Callable = jax.jvp,
    ) -> tuple[Float[Array, " ny"], Float[Array, " ny"]]:
        """The error and the part of c in one direction, of each output; zero where not scored."""
        weight, used = jnp.asarray(lane.scale), row.use > 0
        y_hat, moved = self._outputs(lane, x, slope, direction, row, jvp)
        error, part = weight * (row.y - y_hat), -weight * moved
        return jnp.where(used, error, 0.0), jnp.where(used, part, 0.0)

    def _outputs(
        self,
        lane: RunLane,
        x: State,
        slope: State,
        direction: Direction,
        row: RunRow,
        jvp: Callable,
    ) -> tuple[Float[Array, " ny"], Float[Array, " ny"]]:
        """Outputs at the start of a step, and their derivatives in one direction."""
        if not self.plant.has_algebraic:
            return x.y[0], slope.y[0]
        theta, u = jnp.asarray(lane.theta), jnp.asarray(row.inputs)[0]

        def outputs(x: State, moved: Array, inputs: Array) -> Array:
            time = jnp.asarray(row.time)
            return output_of(self.plant, moved, time, x, inputs, self.friction)

        change = None if row.slope is None else self._input_change(row, direction)[0]
        return _derived(outputs, (x, theta, u), slope, direction, change, jvp)

    def _input_change(self, row: RunRow, direction: Direction) -> Float[Array, "3 nu"]:
        """How the inputs behind actuators change in one direction."""
        assert row.slope is not None
        assert row.past is not None
        slope, past = jnp.asarray(row.slope), jnp.asarray(row.past)
        levels = jnp.asarray(direction.start)[-past.shape[-1] :]
        theta = jnp.asarray(direction.theta)[np.asarray(self.acting, int)]
        change = slope @ theta + past @ levels
        nu = len(self.plant.inputs)
        columns = dict(zip(changed_inputs(self.plant.actuator, nu), change.T, strict=True))
        still = jnp.zeros_like(change[:, 0])
        return jnp.stack([columns.get(i, still) for i in range(nu)], axis=1)

    def _square(self, lane: RunLane, scored: Array) -> Float[Array, "size size"]:
        """Σ w c cᵀ over the outputs; in its corner the loss, so that it is the cost."""
        weight, excess = _huber(jnp, scored[:, -1], lane.threshold)
        square = (weight[:, None] * scored).T @ scored
        return square.at[-1, -1].add(jnp.sum(excess))


def _start(kernel: RunKernel, row: tuple[Any, Any], theta: Any) -> State:
    values, declared = row
    return kernel.start(values, theta, declared)


def _derived(
    function: Callable,
    primals: tuple[State, Array, Array],
    slope: State,
    direction: Direction,
    change: Array | None,
    jvp: Callable,
) -> tuple[Any, Any]:
    """A function of state, parameters and inputs, and its derivative in one direction.

    `change` is that of the inputs, behind actuators; None: they do not depend on the unknowns.
    """
    x, theta, u = primals
    tangents = slope, jnp.asarray(direction.theta, theta.dtype)
    if change is None:
        return jvp(lambda x, theta: function(x, theta, u), (x, theta), tangents)
    return jvp(function, primals, (*tangents, change))


def added_up(
    rows: Float[np.ndarray, "*runs rows size"], threshold: float, error: int = -1
) -> Float[np.ndarray, "*runs size size"]:
    """The sums of rows c that are known.

    Args:
        rows: of any samples and outputs.
        threshold: κ of Huber's loss.
        error: the column of the errors.
    """
    errors = rows[..., error]
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
        if not np.any(np.abs(errors) > threshold):
            return np.swapaxes(rows, -1, -2) @ rows
        weight, excess = _huber(np, errors, threshold)
        sums = np.swapaxes(weight[..., None] * rows, -1, -2) @ rows
        sums[..., error, error] += np.sum(excess, axis=-1)
    return sums


def _huber(xp: Any, error: Any, threshold: Any) -> tuple[Any, Any]:
    """Weight of each error, and what its loss is beyond the square weighed so; by NumPy or JAX."""
    far = xp.abs(error) > threshold
    size = xp.where(far, xp.abs(error), 1.0)
    weight = xp.where(far, threshold / size, 1.0)
    return weight, xp.where(far, threshold * (size - threshold), 0.0)
