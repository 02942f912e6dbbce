r"""Trajectories of a plant: fixed-step Runge-Kutta with dry friction that sticks.

The state is integrated by the classical fourth-order Runge-Kutta rule under one `lax.scan`. Where
$f$ jumps as an output's velocity changes sign (dry friction), the velocity is never put through
the jump. Over a step each such output is moving up, moving down or stuck, and that is decided once
(a Filippov solution; event location as in Hairer, Nørsett, Wanner, *Solving Ordinary Differential
Equations I*, section II.6):

1. at rest, it sticks while $f(0^+) \le 0 \le f(0^-)$, else leaves the way the force points;
2. moving, it sees $f$ with its velocity held on its own side of zero; stuck, it does not move;
3. if its velocity would change sign, the step is cut at that instant, found from the parabola
   through the velocity at both ends and the acceleration at the start, and sharpened by one Newton
   step; its velocity is then exactly zero, and the rest of the step starts again from 1.

Masses may be coupled by inertia: the friction of one output then acts on others too. While it
sticks its friction is what keeps it at rest, between $f(0^-)$ and $f(0^+)$, and the others get
their share of the same mixture (Filippov's convex combination). Two outputs whose frictions act on
each other leave rest, or stay, as the linear complementarity problem of both has it
(`complementarity.py`).

Where f of a plant without dry friction jumps with the state, as at a contact with damping, steps
are cut as well (`switched_step.py`).

Each output can stop at most once within a step (to stop again it would have to leave with a force
that reverses within the same step, worth O(h²) of velocity), so a step has as many cuts as the
plant has outputs with dry friction, and never more.
"""

import math
from dataclasses import dataclass, field
from functools import partial, reduce
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from eoi_jax._checks import check
from eoi_jax._types import Flags, Input, Output, Scalar, Theta
from eoi_jax.compiler.pointwise import along
from eoi_jax.compiler.programs import jit
from eoi_jax.models.plant import REST_SPEED, Plant, State
from eoi_jax.models.velocities import velocity_of, velocity_rows, with_velocity
from eoi_jax.simulation.complementarity import Matrix, balanced, leaving
from eoi_jax.simulation.rates import Fraction, added, first_zero, input_within, rate_of, scaled
from eoi_jax.simulation.runge_kutta import runge_kutta_step
from eoi_jax.simulation.state_jumps import state_jumps
from eoi_jax.simulation.switched_step import SwitchedStep

_PAIR = 2  # outputs whose frictions may act on each other: `complementarity.py` balances no more
REACHES = 2  # of `frictional`: what sticks acts on other outputs too

Motion = Float[Array, "time r ny"]
Internal = Float[Array, "time nz"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)  # made thousands of times, and in a tenth of a module's time
class Drive:
    """What drives a run, on the grid of its steps; made by `simulate.drive`.

    Attributes:
        time: start of each step [s], shape (steps,).
        step: length of a step [s].
        inputs: u at the start, the middle and the end of each step, shape (steps, 3, nu).
        substeps: steps per sample.
        last: u from the end of the last step on, shape (nu,).

    Several runs of one length stand side by side on leading axes.
    """

    time: Any
    step: Any
    inputs: Any
    substeps: int = field(metadata={"static": True})
    last: Any

    @property
    def following(self) -> Any:
        """The input that holds from the end of each step on, shape (steps, nu).

        A held input jumps at the end of a step, where a sample already has the new value.
        """
        xp = np if isinstance(self.inputs, np.ndarray) else jnp
        return xp.concatenate([self.inputs[..., 1:, 0, :], self.last[..., None, :]], axis=-2)


def frictional(plant: Plant) -> tuple[int, ...]:
    """For each output, whether it sticks: dry friction at relative degree 2, or of a speed.

    Returns:
        0: it does not. 1: it does. `REACHES`: it does, and its friction acts on others as well.

    Raises:
        ValueError: a jump that this simulation does not cover: with the sign of the velocity of an
            output of higher degree, which cannot stick; or of more than two outputs that stick, in
            each other's acceleration.
    """
    jumps = plant.jumps
    flags = np.diagonal(jumps)
    rule = "must have relative degree 2 or 1 wherever f jumps with the sign of the velocity"
    for key, degree in zip(
        np.asarray(plant.outputs)[flags], np.asarray(plant.degrees)[flags], strict=True
    ):
        check(degree <= 2, "plant", rule, f"degree {degree} of output {key}")
    mutual = jumps & np.outer(flags, flags) & ~np.eye(len(flags), dtype=bool)
    struck = np.any(mutual | mutual.T, axis=0)
    # An output of relative degree 0 shows the friction of others, which does not move it.
    reaches = (np.sum(jumps[~plant.algebraic], axis=0) > 1) | struck
    if np.any(struck):
        names = ", ".join(np.asarray(plant.outputs)[reaches])
        rule = "must have no more than two outputs whose dry frictions act on each other"
        advice = "Leave the friction of one of them out."
        check(np.sum(reaches) <= _PAIR, "plant", rule, names, advice)
    return tuple(np.where(flags, np.where(reaches, REACHES, 1), 0).tolist())


def trajectory(
    plant: Plant,
    theta: Theta,
    driven_by: Drive,
    start: State,
    friction: tuple[int, ...],
    reverse: bool = False,
) -> tuple[Motion, Internal]:
    """States at every sample, for use inside other JAX code (forward-mode derivatives, `vmap`).

    Args:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        driven_by: inputs and steps, see `simulate.drive`; behind the plant's actuators, see
            `simulate.acted`.
        start: state at the first sample.
        friction: which outputs stick, see `frictional`.
        reverse: whether derivatives in reverse mode must be possible: steps are then without a loop
            of unknown length, and computed again on the way back rather than stored.

    Returns:
        Outputs with their derivatives, shape (N, r, ny), and internal states (N, nz). An output of
        relative degree 0 stands in the first row. Where the solution leaves the finite numbers, so
        do they.
    """
    one_step = _sticking_step if any(friction) else _free_step
    h = jnp.asarray(driven_by.step)

    def body(x: State, row: tuple[Scalar, Float[Array, "3 nu"]]) -> tuple[State, State]:
        t, u = row
        if reverse:
            x = advanced(plant, theta, t, h, u, x, friction)
        else:
            x = one_step(_Problem(plant, theta, t, h, u, friction), x)
        return x, x

    steps = jnp.asarray(driven_by.time), jnp.asarray(driven_by.inputs)
    _, x = lax.scan(jax.checkpoint(body, prevent_cse=False) if reverse else body, start, steps)
    samples = slice(driven_by.substeps - 1, None, driven_by.substeps)
    y, z = x.y[samples], x.z[samples]
    y, z = jnp.concatenate([start.y[None], y]), jnp.concatenate([start.z[None], z])
    if plant.has_algebraic:
        following = jnp.asarray(driven_by.following)[samples]
        inputs = jnp.concatenate([jnp.asarray(driven_by.inputs)[:1, 0], following])
        times = jnp.concatenate([steps[0][:1], steps[0][samples] + h])
        measured = jax.vmap(lambda t, y, z, u: output_of(plant, theta, t, State(y, z), u, friction))
        y = y.at[:, 0].set(measured(times, y, z, inputs))
    return y, z


free_run = jit(trajectory)


@jit  # traced and differentiated once, however many loops contain it
def advanced(
    plant: Plant,
    theta: Theta,
    time: Scalar,
    step: Scalar,
    inputs: Float[Array, "3 nu"],
    x: State,
    friction: tuple[int, ...],
) -> State:
    """The state one step later, without a loop of unknown length: for `engines`.

    Args:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        time: start of the step [s].
        step: its length [s].
        inputs: at its start, middle and end.
        x: state at its start.
        friction: which outputs stick, see `frictional`.
    """
    problem = _Problem(plant, theta, time, step, inputs, friction)
    return (_sticking_step_unrolled if any(friction) else _free_step)(problem, x)


def chained(
    plant: Plant,
    theta: Theta,
    drives: Drive,
    starts: State,
    friction: tuple[int, ...],
    length_bits: int = 3,
) -> Float[np.ndarray, "runs time ny"]:
    """Outputs of several runs of one length, one after the other in one scan.

    One kernel serves a whole record and its windows; with dry friction it is also faster than runs
    side by side, of which each step would look for the stops of all.

    Args:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        drives: runs on the leading axis.
        starts: likewise.
        friction: which outputs stick, see `frictional`.
        length_bits: binary digits of the length that follow the first one; it is rounded up to
            them, here by an eighth at most, so that lengths that differ by little share a kernel.

    Returns:
        Outputs at every sample, the first one too.
    """
    runs, steps = np.shape(drives.time)
    total = runs * steps
    grain = 2 ** max(int(math.log2(total)) - length_bits, 0)
    index = np.minimum(np.arange(-(-total // grain) * grain), total - 1)
    restarts = index % steps == 0
    begun = jax.tree.map(lambda leaf: np.asarray(leaf)[index // steps], starts)
    time = np.asarray(drives.time).reshape(total)[index]
    inputs = np.asarray(drives.inputs).reshape(total, *np.shape(drives.inputs)[2:])[index]
    following = None
    if plant.has_algebraic:
        following = np.asarray(drives.following).reshape(total, -1)[index]
    y = _chained(plant, theta, time, drives.step[0], inputs, following, restarts, begun, friction)
    y = np.asarray(y)[:total].reshape(runs, steps, -1)
    first = first_outputs(plant.with_parameters(theta), drives, starts)
    return np.concatenate([first, y[:, drives.substeps - 1 :: drives.substeps]], axis=1)


def first_outputs(plant: Plant, drives: Drive, starts: State) -> Float[np.ndarray, "runs 1 ny"]:
    """Outputs at the first sample of several runs; arguments as of `outputs_along`, `chained`."""
    if not plant.has_algebraic:
        return np.asarray(starts.y)[:, :1]
    times, inputs = np.asarray(drives.time)[:, 0], np.asarray(drives.inputs)[:, 0, 0]
    return outputs_along(plant, times, starts, inputs)[:, None]


def outputs_along(
    plant: Plant,
    time: Float[np.ndarray, " S"],
    x: State,
    inputs: Float[np.ndarray, "S nu"],
) -> Float[np.ndarray, "S ny"]:
    """Outputs at several instants, at the plant's own parameters.

    Args:
        plant: the equations.
        time: the instants [s].
        x: states there, on a leading axis.
        inputs: that hold from the instants on.
    """
    theta, shown = np.asarray(plant.theta, dtype=float), _Shown(frictional(plant))
    return along(shown, ("fixed", "fixed", "rows"), plant, theta, (time, x, inputs))


@dataclass(frozen=True)
class _Shown:
    """`output_of` one row."""

    friction: tuple[int, ...]

    def __call__(self, plant: Plant, theta: Theta, row: tuple[Scalar, State, Input]) -> Output:
        t, x, u = row
        return output_of(plant, theta, t, x, u, self.friction)


def output_of(
    plant: Plant, theta: Theta, t: Scalar, x: State, u: Input | None, friction: tuple[int, ...]
) -> Output:
    """Outputs at an instant, those of relative degree 0 with the reaction of what sticks.

    An output j at rest sticks where λ f_j(0⁺) + (1 - λ) f_j(0⁻) = 0 has a λ in [0, 1]; friction is
    then that mixture of its values on both sides of rest, in all that shows it.

    Args:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        t: the instant [s].
        x: state there.
        u: inputs that hold from there on; None where no output depends on them.
        friction: which outputs stick, see `frictional`; each on its own.
    """
    y = plant.output(t, x, u, theta)
    if u is None or not plant.has_algebraic:
        return y
    velocity, moving = velocity_of(x.y, plant.degrees), y
    for j in np.flatnonzero(friction).tolist():
        above, below = (
            plant.derivative(t, State(_with_speed(plant, x.y, j, side), x.z), u, theta)
            for side in (REST_SPEED, -REST_SPEED)
        )
        jump = below[j] - above[j]
        share = jnp.clip(below[j] / jnp.where(jump == 0, 1.0, jump), 0.0, 1.0)
        reaction = share * above + (1.0 - share) * below - moving
        y = jnp.where(plant.algebraic & (velocity[j] == 0), y + reaction, y)
    return y


def _with_speed(plant: Plant, y: Any, j: int, speed: float) -> Any:
    return y.at[velocity_rows(plant.degrees)[j], j].set(speed)


@jit
def _chained(
    plant: Plant,
    theta: Theta,
    time: Any,
    step: Any,
    inputs: Any,
    following: Any,
    restarts: Any,
    begun: State,
    friction: tuple[int, ...],
) -> Float[Array, "steps ny"]:
    one_step, h = _sticking_step if any(friction) else _free_step, jnp.asarray(step)

    def body(x: State, row: tuple) -> tuple[State, Output]:
        t, u, after, restart, start = row
        x = jax.tree.map(lambda old, new: jnp.where(restart, new, old), x, start)
        x = one_step(_Problem(plant, theta, t, h, u, friction), x)
        return x, output_of(plant, theta, t + h, x, after, friction)

    rows = jax.tree.map(jnp.asarray, (time, inputs, following, restarts, begun))
    return lax.scan(body, jax.tree.map(lambda leaf: leaf[0], rows[4]), rows)[1]


# -- one step -----------------------------------------------------------------------------


class _Problem(eqx.Module):
    """What stays the same within a step."""

    plant: Plant
    theta: Theta
    time: Scalar
    step: Scalar
    inputs: Float[Array, "3 nu"]
    friction: tuple[int, ...] = eqx.field(static=True)

    @property
    def sticks(self) -> np.ndarray:
        """Whether each output does."""
        return np.asarray(self.friction) > 0

    @property
    def reaching(self) -> tuple[int, ...]:
        """Outputs whose friction acts on others."""
        return tuple(j for j, kind in enumerate(self.friction) if kind == REACHES)

    def input_at(self, fraction: Fraction) -> Input:
        """See `input_within`."""
        return input_within(self.inputs, fraction)

    def rate(self, t: Scalar, x: State, u: Input, direction: Output | None) -> State:
        """dx/dt, with outputs that stick moving only the way of `direction`."""
        if direction is None:
            return rate_of(self.plant, self.theta, t, x, u)
        frozen = self._frozen(x, direction)
        if self.reaching:
            slope = self._with_shares(t, frozen, u, direction)
        else:
            slope = rate_of(self.plant, self.theta, t, frozen, u)
        y, friction = slope.y, self.sticks
        chained = friction & (np.asarray(self.plant.degrees) > 1)
        if np.any(chained):  # and it sees the true velocity: `_frozen` is for f and g alone
            y = y.at[0].set(jnp.where(chained, x.y[1], y[0]))
        stuck = friction & (direction == 0)
        return State(self.moved(y, jnp.where(stuck, 0.0, self.velocity(y))), slope.z)

    def _with_shares(self, t: Scalar, frozen: State, u: Input, direction: Output) -> State:
        """dx/dt, with the shares of their friction that keep stuck outputs at rest."""
        mean, contributions = self.mixture(t, frozen, u, direction == 0)
        matrix, rates = self._at_reaching(mean, contributions)
        stuck = [direction[j] == 0 for j in self.reaching]
        shares = balanced(matrix, rates, stuck)
        for share, contribution in zip(shares, contributions, strict=True):
            mean = added(mean, jnp.clip(share, -1.0, 1.0), contribution)
        return mean

    def leaving(self, t: Scalar, x: State, u: Input) -> Output:
        """Which way outputs whose frictions act on each other leave rest: +1, −1, or 0."""
        velocity = self.velocity(x.y)
        matrix, rates = self._at_reaching(*self.mixture(t, x, u, velocity == 0))
        ways = leaving(matrix, rates, [velocity[j] == 0 for j in self.reaching])
        return jnp.zeros_like(velocity).at[np.asarray(self.reaching)].set(jnp.stack(ways))

    def mixture(self, t: Scalar, x: State, u: Input, free: Flags) -> tuple[State, list[State]]:
        """dx/dt in the middle between both sides of rest of outputs, and what a side changes.

        Args:
            t: time [s].
            x: state.
            u: inputs.
            free: of which outputs whose friction reaches others the velocity is put to either side.

        Returns:
            The mean over all sides, and for each such output half of what its side changes.
        """
        velocity = self.velocity(x.y)

        def rates(raised: int | None) -> State:
            moved = velocity
            for j in self.reaching:
                side = REST_SPEED if j == raised else -REST_SPEED
                moved = moved.at[j].set(jnp.where(free[j], side, velocity[j]))
            moved_state = State(self.moved(x.y, moved), x.z)
            return rate_of(self.plant, self.theta, t, moved_state, u)

        # Forces add up: what one output's side changes does not depend on the other's.
        lower = rates(None)
        contributions = [scaled(0.5, added(rates(j), -1.0, lower)) for j in self.reaching]
        return reduce(
            lambda mean, contribution: added(mean, 1.0, contribution), contributions, lower
        ), contributions

    def _at_reaching(self, mean: State, contributions: list[State]) -> tuple[Matrix, list[Scalar]]:
        """Accelerations of those outputs: what each share of friction adds, and the mean."""
        rates = self.velocity(mean.y)
        matrix = [
            [self.velocity(contribution.y)[j] for contribution in contributions]
            for j in self.reaching
        ]
        return matrix, [rates[j] for j in self.reaching]

    def _frozen(self, x: State, direction: Output) -> State:
        """`x` as f may see it: no velocity with dry friction on the wrong side of rest."""
        velocity = self.velocity(x.y)
        limited = direction * jnp.maximum(direction * velocity, REST_SPEED)
        return State(self.moved(x.y, jnp.where(self.sticks, limited, velocity)), x.z)

    def velocity(self, y: Any) -> Output:
        """Velocities, or rates of them, out of `State.y`."""
        return velocity_of(y, self.plant.degrees)

    def moved(self, y: Any, velocity: Output) -> Any:
        """`State.y` with other velocities."""
        return with_velocity(y, velocity, self.plant.degrees)


def _advance(
    problem: _Problem, x: State, start: Fraction, end: Fraction, direction: Output | None
) -> State:
    """A Runge-Kutta step between two fractions of the step, in fixed directions."""
    fractions = (start, 0.5 * (start + end), end)
    t0, t1, t2 = (problem.time + fraction * problem.step for fraction in fractions)
    u0, u1, u2 = (problem.input_at(fraction) for fraction in fractions)

    def rate(x: State, instant: tuple[Scalar, Input]) -> State:
        return _rate(problem, *instant, x, direction)

    instants = ((t0, u0), (t1, u1), (t2, u2))
    return runge_kutta_step(rate, x, (end - start) * problem.step, instants)[0]


@jit  # traced once for all stages
def _rate(problem: _Problem, t: Scalar, u: Input, x: State, direction: Output | None) -> State:
    return problem.rate(t, x, u, direction)


def _free_step(problem: _Problem, x: State) -> State:
    """A step of a plant without dry friction, cut where the equations jump with the state."""
    x, jumps = _sampled(problem, x), state_jumps(problem.plant)
    if not jumps:
        return _advance(problem, x, 0.0, 1.0, None)
    parts = problem.plant, problem.theta, problem.time, problem.step, problem.inputs
    return SwitchedStep(*parts, jumps).advanced(x)


def _sampled(problem: _Problem, x: State) -> State:
    """The state behind a sample at the start of the step, of a plant that has sampled states."""
    plant = problem.plant
    if plant.sampled is None:
        return x
    p = plant.named(problem.theta)
    return State(x.y, plant.sampled.after(problem.time, x, problem.inputs[0], p, problem.step))


# -- dry friction -------------------------------------------------------------------------


def _sticking_step(problem: _Problem, x: State) -> State:
    """A step, cut wherever an output comes to rest."""
    most_cuts = np.count_nonzero(problem.friction)

    def unfinished(progress: tuple[State, Scalar, Scalar]) -> Array:
        return progress[1] < 1.0

    def piece(progress: tuple[State, Scalar, Scalar]) -> tuple[State, Scalar, Scalar]:
        x, fraction, cuts = progress
        return *_until_stop(problem, x, fraction, cuts < most_cuts), cuts + 1.0

    # A loop, although nearly every step is one piece: the equations are then compiled once.
    start = jnp.zeros_like(problem.step)
    begun = _sampled(problem, x), start, start
    return lax.while_loop(unfinished, piece, begun)[0]


def _sticking_step_unrolled(problem: _Problem, x: State) -> State:
    """The same, piece by piece: at most one cut for each output that sticks."""
    most_cuts = np.count_nonzero(problem.friction)
    x, fraction = _sampled(problem, x), jnp.zeros_like(problem.step)
    for cuts in range(most_cuts + 1):
        piece = partial(_until_stop, problem, x, fraction, jnp.asarray(cuts < most_cuts))
        # The first piece always runs; the others where the one before ended at a stop.
        x, fraction = (
            lax.cond(fraction < 1.0, piece, partial(_unchanged, x, fraction)) if cuts else piece()
        )
    return x


def _unchanged(x: State, fraction: Scalar) -> tuple[State, Scalar]:
    return x, fraction


@jit  # as `advanced`
def _until_stop(
    problem: _Problem, x: State, fraction: Scalar, may_stop: Array
) -> tuple[State, Scalar]:
    """Advance from the fraction `done` to the first stop, or to the end of the step."""
    direction = _direction(problem, x, fraction)
    end_state = _advance(problem, x, fraction, jnp.ones_like(fraction), direction)
    start_velocity, end_velocity = problem.velocity(x.y), problem.velocity(end_state.y)
    stops = direction * end_velocity < 0

    def cut() -> tuple[State, Scalar]:
        length = (1.0 - fraction) * problem.step
        slope = problem.velocity(_slope(problem, x, fraction, direction).y)
        first = first_zero(start_velocity, length * slope, end_velocity, direction, stops)
        stop = fraction + (1.0 - fraction) * jnp.min(first)
        landed = _advance(problem, x, fraction, stop, direction)
        return _land(problem, landed, stop, direction, stops & (first == jnp.min(first)))

    def end() -> tuple[State, Scalar]:
        return _at_rest(problem, end_state, stops), jnp.ones_like(fraction)

    return lax.cond(may_stop & jnp.any(stops), cut, end)


def _direction(problem: _Problem, x: State, fraction: Scalar) -> Output:
    """+1 moving up, −1 moving down, 0 stuck (or without dry friction)."""
    t = problem.time + fraction * problem.step
    u, pair = problem.input_at(fraction), len(problem.reaching) == _PAIR
    leaving = problem.leaving(t, x, u) if pair else jnp.zeros_like(problem.velocity(x.y))
    if not pair or np.count_nonzero(problem.friction) > _PAIR:
        f_above, f_below = problem.plant.at_rest(t, x, u, problem.theta)
        separate = jnp.where(f_above > 0, 1.0, jnp.where(f_below < 0, -1.0, 0.0))
        leaving = jnp.where(pair & (np.asarray(problem.friction) == REACHES), leaving, separate)
    velocity = problem.velocity(x.y)
    moving = jnp.where(velocity == 0, leaving, jnp.sign(velocity))
    return jnp.where(problem.sticks, moving, jnp.zeros_like(moving))


def _slope(problem: _Problem, x: State, fraction: Scalar, direction: Output) -> State:
    t = problem.time + fraction * problem.step
    return _rate(problem, t, problem.input_at(fraction), x, direction)


def _land(
    problem: _Problem, x: State, at: Scalar, direction: Output, stopped: Flags
) -> tuple[State, Scalar]:
    """One Newton step in time onto the exact zero of the velocity that stops here."""
    slope = _slope(problem, x, at, direction)
    earlier = np.tri(len(stopped), k=-1, dtype=bool)
    first = stopped & ~jnp.any(earlier & stopped, axis=1)
    v, a = (jnp.sum(jnp.where(first, problem.velocity(state.y), 0.0)) for state in (x, slope))
    shift = -v / jnp.where(a == 0, 1.0, a) / problem.step
    # A grazing stop has next to no acceleration: never leave the step.
    shift = jnp.clip(jnp.where(a == 0, 0.0, shift), -at, 1.0 - at)
    return _at_rest(problem, added(x, shift * problem.step, slope), stopped), at + shift


def _at_rest(problem: _Problem, x: State, stopped: Flags) -> State:
    return State(problem.moved(x.y, jnp.where(stopped, 0.0, problem.velocity(x.y))), x.z)
