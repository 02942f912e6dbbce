r"""What small forces do to a simulated trajectory.

A step of `integrator.py` along the trajectory, $x_{k+1} = \Phi_k(x_k, w_k)$ with a force $w$ added
to each $y^{(r)}$ (at the start, the middle and the end of the step) and $w = 0$: to first order, a
small force moves the state by

(1) $\delta_{k+1} = A_k \delta_k + B_k w_k$, $A_k = \partial\Phi_k/\partial x$,
    $B_k = \partial\Phi_k/\partial w$, from $\delta_0 = 0$.

$A_k$ and $B_k$ belong to the trajectory and not to the force: they are found once, by
forward-mode differentiation through the stops of dry friction. Over a sample of n steps the force
is a parabola, $w_k = L_k W$ with $W$ at its start, middle and end, so that (1) holds from sample to
sample with

(2) $A = A_n \cdots A_1$, $B = \sum_k A_n \cdots A_{k+1} B_k L_k$,

and that is all that goes one after the other, for many forces at once.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.pointwise import slopes_along
from eoi_jax.compiler.programs import jit
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.integrator import advanced, frictional
from eoi_jax.simulation.known_direction import OwnInputs


@dataclass(frozen=True)
class _Pushed:
    """f of a plant with a force on each output, given as further inputs."""

    base: Any
    inputs: int

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        f = jnp.asarray(self.base(t, x, u[: self.inputs], p))
        return jnp.reshape(f, (x.y.shape[1],)) + u[self.inputs :]


def _pushed(plant: Plant) -> Plant:
    count = len(plant.inputs)
    limits = zip(plant.names, plant.lower, plant.upper, strict=True)
    return Plant(
        _Pushed(plant.dynamics, count),
        plant.parameters,
        relative_degree=plant.degrees,
        inputs=(*plant.inputs, *(f"force on {key}" for key in plant.outputs)),
        outputs=plant.outputs,
        internal=OwnInputs(plant.internal, count) if plant.internal else None,
        internal_initial=plant.internal_initial if plant.internal else None,
        bounds={key: (float(low), float(high)) for key, low, high in limits},
        fixed=plant.fixed,
        name=plant.name,
    )


@dataclass(frozen=True)
class Response:
    """Equation (1) from sample to sample along some runs of one length, n states.

    Attributes:
        free: A of each sample, shape (runs, samples, n, n).
        forced: B, for a force on each output, shape (runs, samples, n, 3, ny).
    """

    free: Float[Array, "runs samples n n"]
    forced: Float[Array, "runs samples n 3 ny"]

    def to(
        self, forces: Float[np.ndarray, "runs samples 3 forces"], output: int, width: int = 16
    ) -> Float[np.ndarray, "runs samples+1 ny forces"]:
        """How far some forces on an output move all outputs, at every sample and after the last.

        Args:
            forces: at the start, the middle and the end of each sample, in the unit of y^(r).
            output: number of the output on which they act.
            width: forces that go side by side; so many always, for one kernel serves all.
        """
        kernel, count, ny = self.forced[..., output], forces.shape[-1], self.forced.shape[-1]
        parts = []
        for first in range(0, count, width):
            part = forces[..., first : first + width]
            room = [(0, 0)] * 3 + [(0, width - part.shape[-1])]
            parts.append(np.asarray(_moved(self.free, kernel, np.pad(part, room)))[:, :, :ny])
        return np.concatenate(parts, axis=-1)[..., :count]


def response_of(
    plant: Plant,
    time: Float[np.ndarray, "runs rows"],
    inputs: Float[np.ndarray, "runs rows 3 nu"],
    y: Float[np.ndarray, "runs rows r ny"],
    z: Float[np.ndarray, "runs rows nz"],
    steps: Float[np.ndarray, " runs"],
    substeps: int,
) -> Response:
    """The response along simulated runs.

    Args:
        plant: with the parameter values of the runs; without actuators.
        time: start of each step [s].
        inputs: at its start, middle and end.
        y: outputs and their derivatives at its start.
        z: internal states there.
        steps: length of a step of each run [s].
        substeps: steps of a sample.
    """
    shape = np.shape(time)
    parts = (time, inputs, y, z, np.broadcast_to(np.reshape(steps, (-1, 1)), shape))
    rows = [np.reshape(array, (np.size(time), *np.shape(array)[2:])) for array in parts]
    slopes = _slopes(_pushed(plant), frictional(plant), *rows)
    free, forced = (array.reshape(*shape, *array.shape[1:]) for array in slopes)
    return Response(*_by_sample(free, forced, substeps))


def _slopes(
    plant: Plant,
    friction: tuple[int, ...],
    time: np.ndarray,
    inputs: np.ndarray,
    y: np.ndarray,
    z: np.ndarray,
    steps: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """A and B of every step."""
    ny = len(plant.outputs)
    x = np.concatenate([y.reshape(len(y), -1), z, np.zeros((len(y), 3 * ny))], axis=1)
    axes = ("fixed", "rows", "rows")
    slopes = slopes_along(_Flow(friction), axes, 2, plant, (time, inputs, steps), x)
    free, forced = np.split(slopes, [-3 * ny], axis=2)
    return free, forced.reshape(*free.shape[:2], 3, ny)


@dataclass(frozen=True)
class _Flow:
    """The state after a step, from that at its start and the forces on it.

    Attributes:
        friction: which outputs stick, see `integrator.frictional`.
    """

    friction: tuple[int, ...]

    def __call__(self, plant: Plant, row: tuple[Any, ...], moved: Array) -> Array:
        (t, u, h), ny = row, len(plant.outputs)
        size = plant.rows * ny
        start = State(jnp.reshape(moved[:size], (plant.rows, ny)), moved[size : -3 * ny])
        inputs = jnp.concatenate([u, jnp.reshape(moved[-3 * ny :], (3, ny))], axis=1)
        end = advanced(plant, jnp.asarray(plant.theta), t, h, inputs, start, self.friction)
        return jnp.concatenate([end.y.ravel(), end.z])


@jit
def _by_sample(free: Array, forced: Array, substeps: int) -> tuple[Array, Array]:
    """Equation (2)."""
    stages = (np.arange(substeps)[:, None] + np.array([0.0, 0.5, 1.0])) / substeps
    parabola = np.stack(
        [(1.0 - stages) * (1.0 - 2.0 * stages), 4.0 * stages * (1.0 - stages),
         stages * (2.0 * stages - 1.0)], axis=-1
    )  # fmt: skip

    def by_step(array: Array) -> Array:
        runs, rows, *shape = array.shape
        split = jnp.reshape(array, (runs, rows // substeps, substeps, *shape))
        return jnp.moveaxis(split, 2, 0)

    def step(product: tuple[Array, Array], row: tuple[Array, ...]) -> tuple[Any, None]:
        (a, b), (transition, push, weights) = product, row
        b = jnp.einsum("ktmn,ktnsj->ktmsj", transition, b) + jnp.einsum(
            "ktnij,is->ktnsj", push, weights
        )
        return (_product(transition, a), b), None

    free, forced = by_step(free), by_step(forced)
    start = jnp.broadcast_to(jnp.eye(free.shape[-1]), free[0].shape), jnp.zeros_like(forced[0])
    # Two at a time, of which most runs have few. All at once, XLA needs seconds from 50 on, and
    # overflows its stack at a thousand.
    product, _ = jax.lax.scan(step, start, (free, forced, jnp.asarray(parabola)), unroll=2)
    return product


@jit
def _moved(free: Array, forced: Array, forces: Array) -> Array:
    """Equation (1), at every sample and after the last."""

    def step(moved: Array, sample: tuple[Array, Array]) -> tuple[Array, Array]:
        moved = _product(sample[0], moved) + sample[1]
        return moved, moved

    pushes = jnp.einsum("ktns,ktsc->tknc", forced, forces)
    start = jnp.zeros(pushes.shape[1:])
    _, moved = jax.lax.scan(step, start, (jnp.moveaxis(free, 1, 0), pushes))
    return jnp.moveaxis(jnp.concatenate([start[None], moved]), 0, 1)


def _product(first: Array, right: Array) -> Array:
    """Of small matrices, many of them: sums of products, which fuse; BLAS calls do not."""
    return jnp.sum(first[..., :, :, None] * right[..., None, :, :], axis=-2)
