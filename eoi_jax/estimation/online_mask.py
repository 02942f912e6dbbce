"""Which steps of a running record count, sample by sample: `data/masks.py` without its future.

A sample is missing where it is not finite. Steps are out beside missing samples, while dry friction
holds an output at rest, and until the observer slides behind each start; the weight of those that
follow rises as there. Towards a step that is out, which only the next samples show, it does not
fall. The filter is emptied instead (`OnlineEstimator.step`), so that no sum has half of the second
difference of a measurement.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._types import Output, Scalar
from eoi_jax.data.masks import SETTINGS, direction_of_motion
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant

AGES = 1e9  # steps, beyond which they are no longer counted


class MaskState(eqx.Module):
    """State between two samples; all are numbers.

    Attributes:
        measured: 1 where the last sample of an output was measured, shape (ny,).
        direction: of motion of each output in the last step, 0 where uncertain, shape (ny,).
        complete: 1 if the last step lay between two samples of all outputs.
        started: steps since the observer started.
        steady: steps since each output, or one that acts on it, was at rest, or one was missing,
            shape (ny,).
        weighted: steps since each last had no weight, shape (ny,).
    """

    measured: Output
    direction: Output
    complete: Scalar
    started: Scalar
    steady: Output
    weighted: Output


class StepMask(eqx.Module):
    """What a step counts; fields as in `kernel.Steps`.

    Attributes:
        use: weight of model and measurement, shape (ny,).
        score: 1 where least squares and alarm count it, shape (ny,).
        usable: where `use` is not zero, shape (ny,).
        restart: whether the observer starts.
    """

    use: Output
    score: Output
    usable: Bool[Array, " ny"]
    restart: Bool[Array, ""]


class OnlineMask(eqx.Module):
    """`init` and `step` of the masks.

    Args:
        plant: whose dry friction and internal states decide.
        observer: the same.
        transient: steps at the start that do not count.
        taper: steps over which weights rise.
        velocity_noise: by which a velocity counts as zero, shape (ny,).
    """

    transient: Any
    taper: Any
    velocity_noise: Float[Array | np.ndarray, " ny"]
    degrees: tuple[int, ...] = eqx.field(static=True)
    jumps: tuple[tuple[bool, ...], ...] = eqx.field(static=True)
    taps: int = eqx.field(static=True)
    slow: bool = eqx.field(static=True)

    def __init__(
        self, plant: Plant, observer: AbstractObserver, transient: Any, taper: Any,
        velocity_noise: Any,
    ):  # fmt: skip
        self.transient, self.taper, self.velocity_noise = transient, taper, velocity_noise
        self.degrees, self.jumps = plant.degrees, tuple(map(tuple, plant.jumps.tolist()))
        self.taps = np.atleast_2d(np.asarray(observer.kernel)).shape[1]
        # Sliding is reached slowly, or a gap leaves states unknown: each start costs the transient.
        explicit = observer.scheme == "explicit"
        self.slow = explicit or plant.internal is not None or plant.actuator is not None

    def init(self, measured: Bool[Array, " ny"]) -> MaskState:
        """Before the first step.

        Args:
            measured: whether the outputs at its start were.
        """
        zeros, ages = jnp.zeros(len(self.degrees)), jnp.full(len(self.degrees), AGES)
        start = jnp.zeros(())
        return MaskState(measured.astype(float), zeros, start, start, ages, ages)

    def step(
        self, state: MaskState, number: Scalar, h: Scalar, y: Output, y_next: Output,
        measured: Bool[Array, " ny"],
    ) -> tuple[MaskState, StepMask]:  # fmt: skip
        """One step.

        Args:
            state: before it.
            number: of the step, from zero on.
            h: sample period [s].
            y: outputs at its start; where one is missing, the last that was not.
            y_next: those at its end.
            measured: whether those at its end were measured.

        Returns:
            The state after it, and what it counts.
        """
        first = number == 0.0
        if not any(self.degrees):  # a sample stands for itself, whether the next is valid or not
            usable, restart, direction = state.measured > 0.0, first, state.direction
            steady, complete = state.steady, state.complete
        else:
            good = jnp.all(measured) & jnp.all(state.measured > 0.0)
            restart = first | (good & (state.complete == 0.0))
            direction, resting = self._resting(state, first, h, y, y_next)
            steady = jnp.where(resting | ~good, 0.0, _older(state.steady))
            complete = good.astype(float)
        started = jnp.where(restart, 0.0, _older(state.started))
        if any(self.degrees):
            usable = (steady >= self.taps) & (started >= self.taps + SETTINGS.settling)
        weighted = jnp.where(usable, _older(state.weighted), 0.0)
        length = jnp.maximum(self.taper, 1.0)
        use = 0.5 - 0.5 * jnp.cos(jnp.pi * jnp.minimum(weighted, length) / length)
        scored = usable & ((started if self.slow else number) >= jnp.round(self.transient))
        after = MaskState(
            measured.astype(float), direction, complete, started, steady, weighted
        )  # fmt: skip
        return after, StepMask(use, scored.astype(float), usable, restart)

    def _resting(
        self, state: MaskState, first: Any, h: Scalar, y: Output, y_next: Output
    ) -> tuple[Output, Any]:
        """Direction of each output, and whether it, or one that acts on it, is at rest."""
        jumps = np.asarray(self.jumps)
        if not np.any(jumps):
            return state.direction, jnp.zeros(y.shape, bool)
        direction = direction_of_motion(
            self.degrees, y, y_next, h, jnp.asarray(self.velocity_noise)
        )
        previous = jnp.where(first, direction, state.direction)
        resting = (direction == 0.0) | (direction != previous)
        return direction, jnp.stack([jnp.any(jnp.where(row, resting, False)) for row in jumps])


def _older(steps: Array) -> Array:
    """A step more."""
    return jnp.minimum(steps + 1.0, AGES)
