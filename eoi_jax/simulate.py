r"""Free run of a plant over time: fixed-step Runge-Kutta with dry friction that sticks.

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

Each output can stop at most once within a step (to stop again it would have to leave with a force
that reverses within the same step, worth O(h²) of velocity), so a step has as many cuts as the
plant has outputs with dry friction, and never more.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from eoi_jax.checks import check, check_choice, check_shape
from eoi_jax.data.ingest import SHORTEST, choose_hold
from eoi_jax.data.record import Record
from eoi_jax.data.resample import HOLDS
from eoi_jax.plants.plant import Plant, State
from eoi_jax.types import Flags, Input, Output, Scalar, Theta

# The velocity that a moving output shows to f at least, as in `Plant.at_rest`.
_REST = 1e-9

Motion = Float[Array, "time r ny"]
Internal = Float[Array, "time nz"]
Fraction = Scalar | float
Pieces = Float[np.ndarray, "steps order nu"]


class Drive(eqx.Module):
    """What drives a run, on the grid of its steps; made by `drive`.

    Attributes:
        time: start of each step [s].
        step: length of a step [s].
        inputs: u at the start, the middle and the end of each step, shape (steps, 3, nu).
        substeps: steps per sample.

    Several runs of one length stand side by side on leading axes.
    """

    time: Float[Array | np.ndarray, "*runs steps"]
    step: Float[Array | np.ndarray, "*runs"]
    inputs: Float[Array | np.ndarray, "*runs steps 3 nu"]
    substeps: int = eqx.field(static=True)


def simulate(
    plant: Plant,
    time: ArrayLike,
    inputs: ArrayLike,
    initial: Any = None,
    *,
    hold: str = "auto",
    internal: ArrayLike | None = None,
    solver: str = "fixed",
    substeps: int = 1,
    name: str = "simulation",
) -> Record:
    """Free run of a plant.

    Args:
        plant: the plant, with the parameters to use.
        time: uniform grid, shape (N,) [s].
        inputs: shape (N,) or (N, nu).
        initial: the outputs and their derivatives at ``time[0]``, shape (r, ny); for one output
            (r,) or the output alone. Zeros by default.
        hold: the input between samples: ``"zero"`` (held), ``"linear"``, ``"smooth"`` (quintic
            spline), or ``"auto"``: zero if it is piecewise constant, else linear.
        internal: internal states at ``time[0]``, shape (nz,); by default the plant's own start.
        solver: ``"fixed"`` (Runge-Kutta 4, dry friction sticks) or ``"adaptive"`` (Dormand-Prince 8
            of diffrax to a relative tolerance of 1e-10, smooth plants only).
        substeps: steps per sample, of the fixed solver.
        name: name of the record.

    Returns:
        Record with `time`, `inputs` and the simulated outputs.

    Raises:
        ValueError: a wrong shape, a grid that is not uniform, dry friction with the adaptive
            solver, or a trajectory that is not finite (with the first time at which it is not).
    """
    time = _uniform(np.asarray(time, dtype=np.float64))
    u = np.asarray(inputs, dtype=np.float64)
    u = u[:, None] if u.ndim == 1 else u
    check_shape("inputs", u, (len(time), len(plant.inputs)), "one row a sample, a column an input")
    _check_finite("inputs", u)
    check_choice("solver", solver, ("fixed", "adaptive"))
    start = State(_initial(plant, initial), _internal(plant, internal))
    check_choice("hold", hold, ("auto", *HOLDS))
    used, _ = choose_hold(u, hold)
    theta = jnp.asarray(plant.theta)
    if solver == "adaptive":
        rough = [key for key, dry in zip(plant.outputs, plant.dry_friction, strict=True) if dry]
        slow = plant.actuator is not None
        rule = 'must be "fixed" for a plant with a delay or lag of its inputs'
        check(not slow, "solver", rule, '"adaptive"')
        rule = 'must be "fixed" for a plant with dry friction'
        check(not rough, "solver", rule, f'"adaptive", and dry friction in {", ".join(rough)}')
        pieces = jnp.asarray(_input_pieces(u, used))
        y, _ = _adaptive(plant, theta, jnp.asarray(time), pieces, start)
    else:
        driven_by = acted(plant, drive(time, u, used, substeps))
        y, _ = free_run(plant, theta, driven_by, start, frictional(plant))
    outputs = np.asarray(y[:, 0, :], dtype=np.float64)
    bad = ~np.all(np.isfinite(outputs), axis=1)
    when = f"NaN or infinity from t = {time[int(np.argmax(bad))]:g} s on"
    advice = "Either the plant is unstable, or the step is too long: try more `substeps`."
    check(not bad.any(), "simulation", "must stay finite", when, advice)
    return Record(
        time,
        u,
        outputs,
        name,
        input_names=plant.inputs,
        output_names=plant.outputs,
        units={key: plant.units[key] for key in plant.inputs + plant.outputs if key in plant.units},
        hold=hold,
    )


def drive(
    time: Float[np.ndarray, " time"],
    inputs: Float[np.ndarray, "time nu"],
    hold: str,
    substeps: int = 1,
) -> Drive:
    """Inputs on the grid of a run's steps.

    Args:
        time: uniform grid [s].
        inputs: one row a sample.
        hold: ``"zero"``, ``"linear"`` or ``"smooth"``.
        substeps: steps per sample.

    Returns:
        The drive of `trajectory`.

    Raises:
        ValueError: an unknown hold, or less than one sub-step.
    """
    whole = isinstance(substeps, int | np.integer) and substeps >= 1
    check(whole, "substeps", "must be an integer ≥ 1", substeps)
    pieces = _input_pieces(inputs, hold)
    fractions = np.linspace(0.0, 1.0, 2 * substeps + 1)  # start, middle, end, middle, end, …
    powers = np.vander(fractions, pieces.shape[1], increasing=True)
    values = np.einsum("fi,kiu->kfu", powers, pieces)
    stages = np.stack([values[:, 0:-2:2], values[:, 1:-1:2], values[:, 2::2]], axis=2)
    period = (time[-1] - time[0]) / (len(time) - 1)
    steps = (len(time) - 1) * substeps
    return Drive(
        time[0] + period / substeps * np.arange(steps),
        np.asarray(period / substeps),
        stages.reshape(steps, 3, inputs.shape[1]),
        substeps,
    )


def acted(plant: Plant, driven_by: Drive) -> Drive:
    """The drive of a whole record behind the actuators of a plant, at its parameters.

    Between the steps it is taken to be continuous: parabolas with the means over the steps.
    """
    if plant.actuator is None:
        return driven_by
    inputs = _acted(plant, driven_by.time, driven_by.step, driven_by.inputs)
    return Drive(driven_by.time, driven_by.step, np.asarray(inputs), driven_by.substeps)


@eqx.filter_jit
def _acted(plant: Plant, time: Any, step: Any, inputs: Any) -> Float[Array, "steps 3 nu"]:
    first, middle, last = jnp.moveaxis(jnp.asarray(inputs), 1, 0)
    mean = (first + 4.0 * middle + last) / 6.0
    mean = plant.driven(jnp.asarray(time) + 0.5 * step, mean, jnp.asarray(plant.theta))
    ends = jnp.concatenate([mean[:1], 0.5 * (mean[1:] + mean[:-1]), mean[-1:]])
    first, last = ends[:-1], ends[1:]
    return jnp.stack([first, 1.5 * mean - 0.25 * (first + last), last], axis=1)


def frictional(plant: Plant) -> tuple[bool, ...]:
    """For each output, whether it sticks: dry friction at relative degree 2.

    Raises:
        ValueError: a jump that this simulation does not cover: with the sign of the velocity of an
            output of higher degree, which cannot stick; or in the acceleration of another output
            (masses coupled by inertia), on which a stuck one would act through its reaction.
    """
    jumps = plant.jumps
    flags = tuple(np.diagonal(jumps).tolist())
    for j, (key, degree) in enumerate(zip(plant.outputs, plant.degrees, strict=True)):
        if not flags[j]:
            continue
        rule = "must have relative degree 2 wherever f jumps with the sign of the velocity"
        check(degree == 2, "plant", rule, f"degree {degree} of output {key}")
        struck = [plant.outputs[i] for i in np.flatnonzero(jumps[:, j]) if i != j]
        rule = "must have dry friction that acts on its own output alone"
        found = f"friction of {key} in the acceleration of {', '.join(struck)}"
        advice = "Masses coupled by inertia cannot be simulated with dry friction."
        check(not struck, "plant", rule, found, advice)
    return flags


def trajectory(
    plant: Plant, theta: Theta, driven_by: Drive, start: State, friction: tuple[bool, ...]
) -> tuple[Motion, Internal]:
    """States at every sample, for use inside other JAX code (forward-mode derivatives, `vmap`).

    Args:
        plant: the equations; its own parameter values are not used.
        theta: parameter values.
        driven_by: inputs and steps, see `drive`; behind the plant's actuators, see `acted`.
        start: state at the first sample.
        friction: which outputs stick, see `frictional`.

    Returns:
        Outputs with their derivatives, shape (N, r, ny), and internal states (N, nz). Where the
        solution leaves the finite numbers, so do they.
    """
    one_step = _sticking_step if any(friction) else _smooth_step
    h = jnp.asarray(driven_by.step)

    def body(x: State, now: tuple[Scalar, Float[Array, "3 nu"]]) -> tuple[State, State]:
        t, u = now
        x = one_step(_Problem(plant, theta, t, h, u, friction), x)
        return x, x

    steps = jnp.asarray(driven_by.time), jnp.asarray(driven_by.inputs)
    _, x = lax.scan(body, start, steps)
    every = slice(driven_by.substeps - 1, None, driven_by.substeps)
    y, z = x.y[every], x.z[every]
    return jnp.concatenate([start.y[None], y]), jnp.concatenate([start.z[None], z])


# The same, compiled once for each plant and shape.
free_run = eqx.filter_jit(trajectory)


# -- one step -----------------------------------------------------------------------------


class _Problem(eqx.Module):
    """What stays the same within a step."""

    plant: Plant
    theta: Theta
    time: Scalar
    step: Scalar
    inputs: Float[Array, "3 nu"]
    friction: tuple[bool, ...] = eqx.field(static=True)

    def input_at(self, fraction: Fraction) -> Input:
        """A parabola through start, middle and end: exact for held and linear inputs."""
        first, middle, last = self.inputs
        slope = 4.0 * middle - 3.0 * first - last
        return first + fraction * (slope + fraction * (2.0 * (first - 2.0 * middle + last)))

    def rate(self, t: Scalar, x: State, u: Input, direction: Output | None) -> State:
        """dx/dt, with outputs that stick moving only the way of `direction`."""
        if direction is None:
            return _rate(self.plant, self.theta, t, x, u)
        slope = _rate(self.plant, self.theta, t, self._frozen(x, direction), u)
        # The chain sees the true velocity: `_frozen` is for f and g alone.
        y = slope.y.at[0].set(jnp.where(np.asarray(self.friction), x.y[1], slope.y[0]))
        stuck = np.asarray(self.friction) & (direction == 0)
        return State(y.at[1].set(jnp.where(stuck, 0.0, y[1])), slope.z)

    def _frozen(self, x: State, direction: Output) -> State:
        """`x` as f may see it: no velocity with dry friction on the wrong side of rest."""
        held = direction * jnp.maximum(direction * x.y[1], _REST)
        return State(x.y.at[1].set(jnp.where(np.asarray(self.friction), held, x.y[1])), x.z)


def _rate(plant: Plant, theta: Theta, t: Scalar, x: State, u: Input) -> State:
    """dx/dt: a chain of integrators for each output, with f at its end."""
    f = plant.derivative(t, x, u, theta)
    shifted = jnp.concatenate([x.y[1:], jnp.zeros_like(x.y[:1])])
    last = np.arange(x.y.shape[0])[:, None] == np.asarray(plant.degrees)[None, :] - 1
    y = jnp.where(last, f[None, :], shifted)
    return State(y, plant.internal_rate(t, x, u, theta))


def _add(x: State, scale: Fraction, slope: State) -> State:
    return State(x.y + scale * slope.y, x.z + scale * slope.z)


def _advance(
    problem: _Problem, x: State, start: Fraction, end: Fraction, direction: Output | None
) -> State:
    """One classical Runge-Kutta step between two fractions of the step, in fixed directions."""
    fractions = (start, 0.5 * (start + end), end)
    t0, t1, t2 = (problem.time + fraction * problem.step for fraction in fractions)
    u0, u1, u2 = (problem.input_at(fraction) for fraction in fractions)
    h = (end - start) * problem.step
    k1 = problem.rate(t0, x, u0, direction)
    k2 = problem.rate(t1, _add(x, 0.5 * h, k1), u1, direction)
    k3 = problem.rate(t1, _add(x, 0.5 * h, k2), u1, direction)
    k4 = problem.rate(t2, _add(x, h, k3), u2, direction)
    slope = _add(_add(_add(k1, 2.0, k2), 2.0, k3), 1.0, k4)
    return _add(x, h / 6.0, slope)


def _smooth_step(problem: _Problem, x: State) -> State:
    return _advance(problem, x, 0.0, 1.0, None)


# -- dry friction -------------------------------------------------------------------------


def _sticking_step(problem: _Problem, x: State) -> State:
    """A step, cut wherever an output comes to rest."""
    most = sum(problem.friction)

    def unfinished(now: tuple[State, Scalar, Scalar]) -> Array:
        return now[1] < 1.0

    def piece(now: tuple[State, Scalar, Scalar]) -> tuple[State, Scalar, Scalar]:
        x, done, cuts = now
        return *_until_stop(problem, x, done, cuts < most), cuts + 1.0

    # A loop, although nearly every step is one piece: the equations are then compiled once.
    start = jnp.zeros_like(problem.step)
    return lax.while_loop(unfinished, piece, (x, start, start))[0]


def _until_stop(problem: _Problem, x: State, done: Scalar, may_stop: Array) -> tuple[State, Scalar]:
    """Advance from the fraction `done` to the first stop, or to the end of the step."""
    direction = _direction(problem, x, done)
    whole = _advance(problem, x, done, jnp.ones_like(done), direction)
    stops = direction * whole.y[1] < 0

    def cut() -> tuple[State, Scalar]:
        length = (1.0 - done) * problem.step
        slope = _slope(problem, x, done, direction)
        first = _first_zero(x.y[1], length * slope.y[1], whole.y[1], direction, stops)
        to = done + (1.0 - done) * jnp.min(first)
        landed = _advance(problem, x, done, to, direction)
        return _land(problem, landed, to, direction, stops & (first == jnp.min(first)))

    def end() -> tuple[State, Scalar]:
        return _at_rest(whole, stops), jnp.ones_like(done)

    return lax.cond(may_stop & jnp.any(stops), cut, end)


def _direction(problem: _Problem, x: State, done: Scalar) -> Output:
    """+1 moving up, −1 moving down, 0 stuck (or without dry friction)."""
    t = problem.time + done * problem.step
    above, below = problem.plant.at_rest(t, x, problem.input_at(done), problem.theta)
    leaving = jnp.where(above > 0, 1.0, jnp.where(below < 0, -1.0, 0.0))
    moving = jnp.where(x.y[1] == 0, leaving, jnp.sign(x.y[1]))
    return jnp.where(np.asarray(problem.friction), moving, jnp.zeros_like(moving))


def _slope(problem: _Problem, x: State, done: Scalar, direction: Output) -> State:
    t = problem.time + done * problem.step
    return problem.rate(t, x, problem.input_at(done), direction)


def _first_zero(v0: Output, dv: Output, v1: Output, direction: Output, stops: Flags) -> Output:
    """Where the parabola v0 + dv σ + (v1 − v0 − dv) σ² falls through zero, σ in [0, 1].

    `dv` is the initial slope over the whole length. 1 where an output does not stop.
    """
    # Seen in the direction of motion: starts at v0 ≥ 0, ends below zero, so one root lies between.
    v0, dv, v1 = direction * v0, direction * dv, direction * v1
    bend = v1 - v0 - dv
    root = jnp.sqrt(jnp.where(stops, jnp.maximum(dv * dv - 4.0 * bend * v0, 0.0), 1.0))
    # The form of the root that does not cancel; each has a divisor ≠ 0 where it is used.
    rising = stops & (dv > 0)
    falling = stops & ~rising & (v0 > 0)
    late = (dv + root) / jnp.where(rising, -2.0 * bend, 1.0)
    early = 2.0 * v0 / jnp.where(falling, root - dv, 1.0)
    zero = jnp.where(rising, late, jnp.where(falling, early, 0.0))
    return jnp.where(stops, jnp.clip(zero, 0.0, 1.0), 1.0)


def _land(
    problem: _Problem, x: State, at: Scalar, direction: Output, stopped: Flags
) -> tuple[State, Scalar]:
    """One Newton step in time onto the exact zero of the velocity that stops here."""
    slope = _slope(problem, x, at, direction)
    which = jnp.argmax(stopped)
    v, a = x.y[1][which], slope.y[1][which]
    shift = -v / jnp.where(a == 0, 1.0, a) / problem.step
    # A grazing stop has next to no acceleration: never leave the step.
    shift = jnp.clip(jnp.where(a == 0, 0.0, shift), -at, 1.0 - at)
    return _at_rest(_add(x, shift * problem.step, slope), stopped), at + shift


def _at_rest(x: State, stopped: Flags) -> State:
    return State(x.y.at[1].set(jnp.where(stopped, 0.0, x.y[1])), x.z)


# -- inputs and starts --------------------------------------------------------------------


def _input_pieces(samples: Float[np.ndarray, "time nu"], hold: str) -> Pieces:
    """The input within each step: a polynomial in the fraction of the step, lowest power first."""
    check_choice("hold", hold, HOLDS)
    first = samples[:-1]
    if hold == "zero":
        return first[:, None, :]
    if hold == "linear":
        return np.stack([first, np.diff(samples, axis=0)], axis=1)
    # Imported here: only this branch needs scipy's splines.
    from scipy.interpolate import make_interp_spline

    # Counted in samples, the spline is equally well conditioned for any sample period.
    index = np.arange(len(samples), dtype=np.float64)
    degree = max(k for k in (1, 3, 5) if k < len(samples))
    spline = make_interp_spline(index, samples, k=degree)
    powers = [spline(index[:-1], nu=i) / math.factorial(i) for i in range(degree + 1)]
    return np.stack(powers, axis=1)


def _check_finite(name: str, value: np.ndarray) -> None:
    check(bool(np.all(np.isfinite(value))), name, "must be finite", "NaN or infinity")


def _uniform(time: np.ndarray) -> Float[np.ndarray, " time"]:
    rule = f"must be a line of at least {SHORTEST} samples"
    check(time.ndim == 1 and len(time) >= SHORTEST, "time", rule, f"shape {time.shape}")
    _check_finite("time", time)
    period = (time[-1] - time[0]) / (len(time) - 1)
    check(period > 0, "time", "must increase", f"{time[0]:g} to {time[-1]:g}")
    off = np.abs(time - (time[0] + period * np.arange(len(time))))
    worst = f"a sample {np.max(off) / period:.3g} periods off, at index {int(np.argmax(off))}"
    advice = "Resample the inputs onto a uniform grid."
    check(bool(np.max(off) <= 1e-3 * period), "time", "must be a uniform grid", worst, advice)
    return time


def _initial(plant: Plant, initial: Any) -> Float[Array, "r ny"]:
    r, ny = plant.relative_degree, len(plant.outputs)
    value = np.zeros((r, ny)) if initial is None else np.asarray(initial, dtype=np.float64)
    if ny == 1 and value.shape == ():
        value = np.concatenate([value[None], np.zeros(r - 1)])
    if ny == 1 and value.shape == (r,):
        value = value[:, None]
    check_shape("initial", value, (r, ny), "the outputs, then each of their derivatives")
    _check_finite("initial", value)
    owned = np.arange(r)[:, None] < np.asarray(plant.degrees)
    return jnp.asarray(np.where(owned, value, 0.0))


def _internal(plant: Plant, internal: ArrayLike | None) -> Float[Array, " nz"]:
    start = plant.internal_start(jnp.asarray(plant.theta))
    if internal is None:
        return start
    value = np.atleast_1d(np.asarray(internal, dtype=np.float64))
    check_shape("internal", value, start.shape, "one value an internal state")
    _check_finite("internal", value)
    return jnp.asarray(value)


# -- the independent route ----------------------------------------------------------------


@eqx.filter_jit
def _adaptive(
    plant: Plant,
    theta: Theta,
    time: Float[Array, " time"],
    pieces: Float[Array, "steps order nu"],
    start: State,
) -> tuple[Motion, Internal]:
    """Solve from sample to sample, so that no step of the solver crosses a kink of the input."""
    # Imported here: only this route needs it.
    import diffrax

    solver, tolerances = diffrax.Dopri8(), diffrax.PIDController(rtol=1e-10, atol=1e-12)

    def field(t: Any, x: State, args: Any) -> State:
        t0, t1, piece = args
        powers = ((t - t0) / (t1 - t0)) ** jnp.arange(piece.shape[0], dtype=piece.dtype)
        return _rate(plant, theta, t, x, powers @ piece)

    term = diffrax.ODETerm(field)

    def body(x: State, span: tuple[Scalar, Scalar, Array]) -> tuple[State, State]:
        t0, t1, piece = span
        solution = diffrax.diffeqsolve(
            term,
            solver,
            t0,
            t1,
            t1 - t0,
            x,
            args=(t0, t1, piece),
            stepsize_controller=tolerances,
            throw=False,
        )
        assert solution.ys is not None
        x = jax.tree.map(lambda leaf: leaf[-1], solution.ys)
        return x, x

    _, x = lax.scan(body, start, (time[:-1], time[1:], pieces))
    return jnp.concatenate([start.y[None], x.y]), jnp.concatenate([start.z[None], x.z])
