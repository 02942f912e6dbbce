r"""A Runge-Kutta step that is cut where the equations jump with the state.

Between two jumps the equations are those of the side on which a piece of the step begins, also a
little beyond the border (`with_signs`). If $g(x)$, what is compared, has changed its sign at the
end of the piece, the piece is cut at the crossing: the zero of the parabola through g at both ends
and its slope at the start, sharpened by one Newton step; the rest has the equations of the other
side.

The instant of crossing depends on state and parameters, and that derivative is part of the step's:
$dt = -dg/\dot g$, with which a perturbation $\delta x$ becomes

$\delta x^+ = \delta x^- + (f^+ - f^-)\,\frac{\nabla g\,\delta x^-}{\dot g^-}.$

**Source.** R. I. Leine and H. Nijmeijer, *Dynamics and Bifurcations of Non-Smooth Mechanical
Systems* (2004), chapter 7 (saltation matrix); Hairer, Nørsett, Wanner, *Solving Ordinary
Differential Equations I*, section II.6 (event location).
"""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from eoi_jax._types import Scalar, Theta
from eoi_jax.compiler.comparisons import comparisons, with_signs
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.rates import Fraction, added, first_zero, input_within, rate_of
from eoi_jax.simulation.runge_kutta import runge_kutta_step

Signs = Float[Array, " jumps"]
Progress = tuple[State, Scalar, Signs]  # state, fraction of the step that is done, sides


class SwitchedStep(eqx.Module):
    """What stays the same within a step.

    Attributes:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        time: start of the step [s].
        step: its length [s].
        inputs: at its start, middle and end.
        jumps: numbers of the comparisons, see `state_jumps`.
    """

    plant: Plant
    theta: Theta
    time: Scalar
    step: Scalar
    inputs: Float[Array, "3 nu"]
    jumps: tuple[int, ...] = eqx.field(static=True)

    def advanced(self, x: State, cuts: int = 2) -> State:
        """The state at the end of the step.

        Args:
            x: at its start.
            cuts: at most: in and out again.
        """
        start = jnp.zeros_like(self.step)
        progress = x, start, self._compared(x, start)[1]

        def piece(progress: Progress, may_cut: Array) -> tuple[Progress, None]:
            # The first piece always runs; the others where the one before ended at a jump.
            move = partial(_until_jump, self, *progress, may_cut)
            return lax.cond(progress[1] < 1.0, move, lambda: progress), None

        return lax.scan(piece, progress, jnp.arange(cuts + 1) < cuts)[0][0]

    def advance(self, x: State, start: Fraction, end: Fraction, signs: Signs) -> State:
        """A Runge-Kutta step between two fractions of the step, on fixed sides."""
        fractions = (start, 0.5 * (start + end), end)

        def rate(x: State, fraction: Fraction) -> State:
            return _rate(self, x, fraction, signs)

        return runge_kutta_step(rate, x, (end - start) * self.step, fractions)[0]

    def undecided(self, x: State, start: Fraction) -> State:
        """The state at the end of the step with the equations as they are."""

        def rate(x: State, fraction: Fraction) -> State:
            return self.slopes(x, *self.instant(fraction))

        fractions = (start, 0.5 * (start + 1.0), jnp.ones_like(self.step))
        return runge_kutta_step(rate, x, (1.0 - start) * self.step, fractions)[0]

    def differences(self, x: State, fraction: Fraction) -> Signs:
        """What is compared: g of each jump."""
        return self._compared(x, fraction)[0]

    def differences_along(
        self, x: State, fraction: Scalar, signs: Signs
    ) -> tuple[Signs, Signs, State]:
        """g, its slope over the whole step along the motion, and dx/dt."""
        slope = _rate(self, x, fraction, signs)

        def moved(share: Scalar) -> Signs:
            return self.differences(added(x, (share - fraction) * self.step, slope), share)

        return *jax.jvp(moved, (fraction,), (jnp.ones_like(fraction),)), slope

    def slopes(self, x: State, t: Scalar, u: Any) -> State:
        """dx/dt with the equations as they are."""
        return rate_of(self.plant, self.theta, t, x, u)

    def instant(self, fraction: Fraction) -> tuple[Scalar, Any]:
        """Time and inputs."""
        return self.time + fraction * self.step, input_within(self.inputs, fraction)

    def _compared(self, x: State, fraction: Fraction) -> tuple[Signs, Signs]:
        numbers = np.asarray(self.jumps)
        differences, signs = comparisons(self.slopes, x, *self.instant(fraction))
        return differences[numbers], signs[numbers]


@jax.jit  # traced once for all stages
def _rate(problem: SwitchedStep, x: State, fraction: Fraction, signs: Signs) -> State:
    return with_signs(problem.slopes, problem.jumps, signs, x, *problem.instant(fraction))


def _until_jump(
    problem: SwitchedStep, x: State, fraction: Scalar, signs: Signs, may_cut: Array
) -> Progress:
    """Advance from a fraction of the step to the first jump, or to the end of the step."""
    full = jnp.ones_like(fraction)
    end_state = problem.advance(x, fraction, full, signs)
    end = problem.differences(end_state, full)
    crosses = signs * end < 0

    def cut() -> Progress:
        start, slope, _ = problem.differences_along(x, fraction, signs)
        first = first_zero(start, (1.0 - fraction) * slope, end, signs, crosses)
        instant = fraction + (1.0 - fraction) * jnp.min(first)
        crossed = crosses & (first == jnp.min(first))
        state = problem.advance(x, fraction, instant, signs)
        state, instant = _land(problem, state, instant, signs, crossed)
        return state, instant, jnp.where(crossed, -signs, signs)

    def finish() -> Progress:
        # No number beyond the border: the root of a level that is less than zero.
        finite = jnp.all(jnp.isfinite(end_state.y)) & jnp.all(jnp.isfinite(end_state.z))
        undecided = partial(problem.undecided, x, fraction)
        return lax.cond(finite, lambda: end_state, undecided), full, signs

    return lax.cond(may_cut & jnp.any(crosses), cut, finish)


def _land(
    problem: SwitchedStep, x: State, instant: Scalar, signs: Signs, crossed: Array
) -> tuple[State, Scalar]:
    """One Newton step in time onto the exact instant of the jump."""
    g, slope, rate = problem.differences_along(x, instant, signs)
    earlier = np.tri(len(crossed), k=-1, dtype=bool)
    first = crossed & ~jnp.any(earlier & crossed, axis=1)
    value, change = (jnp.sum(jnp.where(first, part, 0.0)) for part in (g, slope))
    shift = jnp.where(change == 0, 0.0, -value / jnp.where(change == 0, 1.0, change))
    # Where the border is grazed g has next to no slope: never leave the step.
    shift = jnp.clip(shift, -instant, 1.0 - instant)
    return added(x, shift * problem.step, rate), instant + shift
