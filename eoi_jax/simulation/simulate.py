"""Free run of a plant over time, on a record's grid, and what drives it.

Integrated by `trajectory`, or, for smooth plants, by diffrax as an independent route.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from eoi_jax._checks import (
    check,
    check_choice,
    check_count,
    check_kind,
    check_shape,
    counted,
    warn_caller,
)
from eoi_jax._types import Scalar, Theta
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.compiler.jax_setup import check_process
from eoi_jax.compiler.programs import jit
from eoi_jax.data.cleaning import SHORTEST
from eoi_jax.data.input_holds import (
    Columns,
    Hold,
    HoldArgument,
    by_hold,
    columns_by_hold,
    declared_or_suggested,
    hold_of_each,
)
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import acting_inputs, inputs_within_steps
from eoi_jax.models.actuators import are_linear, changed_inputs, have_past, keeps_steps
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.free_starts import check_no_free_start
from eoi_jax.models.jacobians import has_sampled_actuator
from eoi_jax.models.known_starts import start_by_name
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.integrator import (
    Drive,
    Internal,
    Motion,
    frictional,
    outputs_along,
)
from eoi_jax.simulation.rates import rate_of
from eoi_jax.simulation.step_size import (
    RULES,
    StepChange,
    finest_steps,
    mode_along,
    settled_steps,
)
from eoi_jax.simulation.time_jumps import time_jump

Pieces = Float[np.ndarray, "steps order nu"]


def simulate(
    plant: Plant,
    time: ArrayLike,
    inputs: ArrayLike,
    initial: Any = None,
    *,
    hold: HoldArgument = "auto",
    internal: ArrayLike | None = None,
    solver: str = "fixed",
    substeps: int | None = None,
    name: str = "simulation",
) -> Record:
    """Free run of a plant.

    Args:
        plant: the plant, with the parameters to use.
        time: uniform grid, shape (N,) [s].
        inputs: shape (N,) or (N, nu).
        initial: the outputs and their derivatives at ``time[0]``: by name, ``{"angle": 0.1}`` or
            ``{"angle": (0.1, 0.0)}``, or an array (r, ny), for one output (r,) or the output alone.
            By default, and for what is not named, the plant's known starts, and zeros. Outputs of
            relative degree 0 have none: what an array has for them is not read.
        hold: the input between samples: ``"zero"`` (held), ``"linear"``, ``"smooth"`` (quintic
            spline), or ``"auto"``: zero if it is piecewise constant, else linear. One word for all
            inputs, or one for each: by name, or in order.
        internal: internal states at ``time[0]``, shape (nz,); by default the plant's own start.
        solver: ``"fixed"`` (Runge-Kutta 4, dry friction sticks) or ``"adaptive"`` (Dormand-Prince 8
            of diffrax to a relative tolerance of 1e-10, smooth plants only).
        substeps: steps per sample, of the fixed solver. None: one, more where the fastest mode
            along the run needs them, and until half as long ones change no output by more than
            1e-4 of its spread (`step_size.py`).
        name: name of the record.

    Returns:
        Record with `time`, `inputs` and the simulated outputs. It declares the hold that was used.

    Raises:
        ValueError: a wrong shape, an unknown output, a grid that is not uniform, dry friction with
            the adaptive solver, a start that the plant declares as free and `internal` does not
            give, a trajectory that is not finite (with the first time at which it is
            not), or numbers that JAX traces, of which `rollout` makes a free run.

    Warns:
        RuntimeWarning: equations that jump with time, which steps of the library's choice do not
            resolve; a run that no steps settle, as a chaotic one, with the change by halving them.
    """
    check_process()
    check_kind("plant", plant, Plant, "a Plant")
    _check_untraced(plant, time, inputs, initial, internal)
    time = _uniform(np.asarray(time, dtype=np.float64))
    u = np.asarray(inputs, dtype=np.float64)
    u = u[:, None] if u.ndim == 1 else u
    check_shape("inputs", u, (len(time), len(plant.inputs)), "one row a sample, a column an input")
    _check_finite("inputs", u)
    check_choice("solver", solver, ("fixed", "adaptive"))
    start = State(initial_outputs(plant, initial), _internal(plant, internal))
    _check_finite("initial", start.y)
    used, _ = declared_or_suggested(hold, u, plant.inputs)
    if solver == "adaptive":
        rough = [key for key, dry in zip(plant.outputs, plant.dry_friction, strict=True) if dry]
        slow = plant.actuator is not None
        rule = 'must be "fixed" for a plant with a delay or lag of its inputs'
        check(not slow, "solver", rule, '"adaptive"')
        rule = 'must be "fixed" for a plant with dry friction'
        check(not rough, "solver", rule, f'"adaptive", and dry friction in {", ".join(rough)}')
        pieces = jnp.asarray(_input_pieces(u, used))
        y, z = _adaptive(plant, jnp.asarray(plant.theta), jnp.asarray(time), pieces, start)
        outputs = np.asarray(y, dtype=np.float64)[:, 0, :]
        if plant.has_algebraic:
            outputs = outputs_along(plant, time, State(np.asarray(y), np.asarray(z)), u)
    else:
        jump = time_jump(plant, time) if substeps is None else None
        if jump is not None:
            warn_caller(_JUMP.format(jump), RuntimeWarning)
        outputs = _fixed(plant, time, u, used, start, substeps, jump is None)
    bad = ~np.all(np.isfinite(outputs), axis=1)
    failure = f"NaN or infinity from t = {time[int(np.argmax(bad))]:g} s on"
    advice = "Either the plant is unstable, or the step is too long: try more `substeps`."
    check(not bad.any(), "simulation", "must stay finite", failure, advice)
    return Record(
        time,
        u,
        outputs,
        name,
        input_names=plant.inputs,
        output_names=plant.outputs,
        units={key: plant.units[key] for key in plant.inputs + plant.outputs if key in plant.units},
        hold=used,
    )


_JUMP = (
    "The equations jump at t = {:.6g} s: the steps do not end there, and err by up to a step of "
    'what jumps. Give more `substeps`, or `solver="adaptive"`, or write a smooth switch'
)


_UNSETTLED = (
    "Halving the steps changes {} by {:.2g} rms (spread {:.2g}), and no more of them settle it: "
    "the run is chaotic, or its equations jump. What is returned has {} a sample. For another "
    'number give `substeps`; for smooth plants there is `solver="adaptive"`'
)


def _fixed(
    plant: Plant,
    time: Float[np.ndarray, " time"],
    inputs: Float[np.ndarray, "time nu"],
    hold: Hold,
    start: State,
    substeps: int | None,
    settle: bool,
) -> Float[np.ndarray, "time ny"]:
    """Outputs by Runge-Kutta steps; to `settle` them, so many that half as long ones agree."""
    runs = _Runs(plant, time, inputs, hold, start, {})
    if substeps is not None:
        return runs.outputs(substeps)
    limit, count = finest_steps([time]), runs.by_mode()
    outputs = runs.outputs(count)
    if not (settle and np.all(np.isfinite(outputs))):
        return outputs
    settled, are_enough = settled_steps(count, limit, runs.change, RULES.simulated)
    if are_enough or 2 * count > limit:
        return runs.outputs(settled)
    size, _, spread = runs.change(count)
    worst = int(np.argmax(np.where(np.isfinite(size), size / spread, np.inf)))
    numbers = size[worst], spread[worst], counted(count, "step")
    warn_caller(_UNSETTLED.format(plant.outputs[worst], *numbers), RuntimeWarning)
    return outputs


@dataclass(frozen=True)
class _Runs:
    """Runs of one plant in steps of different length.

    Attributes:
        plant: with its parameters.
        time: grid [s].
        inputs: at its instants.
        hold: of each input.
        start: state at the first instant.
        cache: outputs by the number of steps a sample.
    """

    plant: Plant
    time: Float[np.ndarray, " time"]
    inputs: Float[np.ndarray, "time nu"]
    hold: Hold
    start: State
    cache: dict[int, Float[np.ndarray, "time ny"]]

    def outputs(self, count: int) -> Float[np.ndarray, "time ny"]:
        """Outputs in so many steps a sample."""
        if count not in self.cache:
            begun = State(self.start.y[None], self.start.z[None])
            driven_by = acted(self.plant, drive(self.time, self.inputs, self.hold, count))
            lanes = driven_by.time[None], np.asarray(driven_by.step)[None], driven_by.inputs[None]
            single = Drive(*lanes, count, driven_by.last[None])
            self.cache[count] = outputs_of(self.plant, single, begun, frictional(self.plant))[0]
        return self.cache[count]

    def by_mode(self) -> int:
        """Steps a sample that follow the fastest mode along the run."""
        count, limit = 1, finest_steps([self.time])
        while 2 * count <= limit:
            outputs = self.outputs(count)
            needed = 4 * count  # of a run that has left the finite numbers
            if np.all(np.isfinite(outputs)):
                rate = mode_along(self.plant, self.time, self.inputs, outputs)
                rate *= self.time[1] - self.time[0]
                needed = 2 ** max(int(np.ceil(np.log2(max(rate, 1e-9) / RULES.mode))), 0)
            if needed <= count:
                break
            count = min(needed, limit)
        return count

    def change(self, count: int) -> StepChange:
        """By how much half as long steps change the outputs; nothing was measured; their spread."""
        coarse, fine = self.outputs(count), self.outputs(2 * count)
        with np.errstate(all="ignore"):
            size, level = (np.sqrt(np.mean(y**2, axis=0)) for y in (fine - coarse, fine))
            spread = np.maximum(np.std(fine, axis=0), 1e-6 * level)  # at rest all is rounding
        return size, np.zeros_like(size), spread


def drive(
    time: Float[np.ndarray | Array, " time"],
    inputs: Float[np.ndarray | Array, "time nu"],
    hold: Hold,
    substeps: int = 1,
    skew: Float[np.ndarray, " nu"] | None = None,
) -> Drive:
    """Inputs on the grid of a run's steps.

    Args:
        time: uniform grid [s].
        inputs: one row a sample; JAX's arrays, also traced, with one hold, zero or linear.
        hold: ``"zero"``, ``"linear"`` or ``"smooth"``, of all inputs or of each.
        substeps: steps per sample.
        skew: time by which each input acts later than it was logged [s]; None: by none.

    Returns:
        The drive of `trajectory`.

    Raises:
        ValueError: an unknown hold, or less than one sub-step.
    """
    check_count("substeps", substeps)
    xp = jnp if isinstance(inputs, jax.Array) else np
    period = (time[-1] - time[0]) / (len(time) - 1)
    steps = (len(time) - 1) * substeps
    if skew is not None and np.any(skew):
        stages = _shifted_stages(np.asarray(inputs), skew / period, hold, substeps)
    else:
        fractions = np.linspace(0.0, 1.0, 2 * substeps + 1)  # start, middle, end, middle, end, …
        values = inputs_within_steps(inputs, fractions, hold)
        stages = xp.stack([values[:, 0:-2:2], values[:, 1:-1:2], values[:, 2::2]], axis=2)
    return Drive(
        time[0] + period / substeps * np.arange(steps),
        xp.asarray(period / substeps),
        stages.reshape(steps, 3, inputs.shape[1]),
        substeps,
        inputs[-1],
    )


def _shifted_stages(
    inputs: Float[np.ndarray, "time nu"],
    delays: Float[np.ndarray, " nu"],
    hold: Hold,
    substeps: int,
) -> Float[np.ndarray, "steps 3 nu"]:
    """Inputs that act later [samples], at the start, the middle and the end of each step."""
    points, middles = acting_inputs(inputs, [(0, len(inputs))], delays, substeps, hold)
    is_held = np.asarray(hold_of_each(hold, inputs.shape[1])) == "zero"
    ends = np.where(is_held, points[:-1], points[1:])
    return np.stack([points[:-1], middles, ends], axis=1)


def acted(plant: Plant, driven_by: Drive, theta: Theta | None = None) -> Drive:
    """The drive of a whole record behind the actuators of a plant.

    Between the steps what an actuator changes is taken to be continuous: parabolas with the means
    over the steps. A held input stays a staircase behind a delay.

    Args:
        plant: with an actuator, or without.
        driven_by: of a whole record.
        theta: parameter values, for a drive of JAX's arrays; None: the plant's, and NumPy's arrays.
    """
    if plant.actuator is None:
        return driven_by
    if theta is None:
        inputs = _actuated_by_values(plant, driven_by)
    else:
        inputs = actuated(plant, theta, driven_by)
    steps, last = len(driven_by.time), inputs[-1, 0 if plant.has_algebraic else 2]
    return Drive(driven_by.time, driven_by.step, inputs[:steps], driven_by.substeps, last)


@jit
def actuated(
    plant: Plant, theta: Theta, driven_by: Drive, past: Float[Array, " nu"] | None = None
) -> Float[Array, "steps 3 nu"]:
    """Inputs behind the actuators of a plant, for use inside other JAX code.

    Args:
        plant: with an actuator; its own parameter values are not used.
        theta: parameter values; derivatives with them are those of the actuator.
        driven_by: of a whole record, from whose start on the past of the inputs is known.
        past: level of the inputs before the record, less their first values. None: zero.

    Returns:
        The inputs of `acted`, at the start, the middle and the end of each step. If an output has
        relative degree 0, those of one step more, which its sample at the end of the run needs.
    """
    averaged = step_means(jnp, plant, driven_by)
    changed = parabolas(
        jnp, plant, lambda t, u: plant.driven(t, u, theta), averaged, driven_by.substeps, past
    )
    columns = np.array(changed_inputs(plant.actuator, len(plant.inputs)), int)
    inputs = averaged.stages.at[..., columns].set(changed)
    return inputs[: len(inputs) if plant.has_algebraic else -1]


class StepMeans(NamedTuple):
    """Inputs before the actuators of a plant, as these take them.

    Attributes:
        stages: inputs at the start, the middle and the end of each step, and of one more, which
            tells how the last one ends; (steps + 1, 3, nu).
        middles: of the steps [s], a step in front of the record first.
        means: over these steps; in front of the record that of its first step.
        is_held: which inputs are constant in each step, of those that come out of a hold held.
    """

    stages: Any
    middles: Any
    means: Any
    is_held: Any


def step_means(xp: Any, plant: Plant, driven_by: Drive) -> StepMeans:
    """What the actuators of a plant take, by NumPy or JAX.

    Args:
        xp: NumPy or JAX's.
        plant: with an actuator.
        driven_by: of a whole record.
    """
    time, inputs = xp.asarray(driven_by.time), xp.asarray(driven_by.inputs)
    middles = xp.concatenate([time[:1] - driven_by.step, time, time[-1:] + driven_by.step])
    held_on = xp.broadcast_to(xp.asarray(driven_by.last), (1, *inputs.shape[1:]))
    stages = xp.concatenate([inputs, held_on])
    first, middle, last = xp.moveaxis(stages, 1, 0)
    mean = (first + 4.0 * middle + last) / 6.0
    is_held = xp.all(first == last, axis=0)
    is_held &= np.asarray(keeps_steps(plant.actuator, len(plant.inputs)))
    means = xp.concatenate([mean[:1], mean])
    return StepMeans(stages, middles + 0.5 * driven_by.step, means, is_held)


def parabolas(
    xp: Any,
    plant: Plant,
    actuate: Callable[[Any, Any], Any],
    averaged: StepMeans,
    substeps: int,
    past: Float[Any, " nu"] | None,
) -> Float[Any, "steps 3 changed"]:
    """`changed_inputs` behind the actuators of a plant from their means over the steps.

    Args:
        xp: NumPy or JAX's.
        plant: with an actuator.
        actuate: means of the inputs over the steps behind it, from the middles of the steps and the
            means before it.
        averaged: the inputs before it.
        substeps: steps between two samples.
        past: as in `actuated`.

    Returns:
        Of one step more than the record has, at the start, the middle and the end of each.
    """
    columns = np.array(changed_inputs(plant.actuator, len(plant.inputs)), int)
    if past is None:
        mean = actuate(averaged.middles[1:], averaged.means[1:])[:, columns]
    else:  # a step more, in which an actuator is settled at that level
        means = xp.concatenate([averaged.means[:1] + past, averaged.means[1:]])
        mean = actuate(averaged.middles, means)[1:, columns]
    ends = xp.concatenate([mean[:1], 0.5 * (mean[1:] + mean[:-1]), mean[-1:]])
    begins, stops = ends[:-1], ends[1:]
    parts = xp.stack([begins, 1.5 * mean - 0.25 * (begins + stops), stops], axis=1)
    staircase = substeps > 1 and not plant.has_algebraic
    held = _staircase(xp, mean) if staircase else mean[:, None]
    return xp.where(averaged.is_held[columns], held, parts)


def _staircase(xp: Any, mean: Float[Any, "steps nu"]) -> Float[Any, "steps 3 nu"]:
    r"""Stages of a staircase whose levels last two steps of the simulation at least.

    In a step in which it changes by Δ, when a share φ of the step is over, the parabola with the
    same mean m and the same two next moments (its projection onto Legendre polynomials) has at the
    ends m + a ∓ 3 w Δ, and m - a / 2 in the middle, w = φ(1 - φ) and a = 4 (φ - 1/2) w Δ.

    Args:
        xp: NumPy or JAX's.
        mean: of the staircase over each step.
    """
    former = xp.concatenate([mean[:1], mean[:-1]])
    latter = xp.concatenate([mean[1:], mean[-1:]])
    change = latter - former
    share = (latter - mean) / xp.where(change == 0.0, 1.0, change)
    weighted = xp.maximum(share * (1.0 - share), 0.0) * change
    bend = 4.0 * (share - 0.5) * weighted
    return xp.stack(
        [mean + bend - 3.0 * weighted, mean - 0.5 * bend, mean + bend + 3.0 * weighted], axis=1
    )


def past_slopes(plant: Plant, driven_by: Drive) -> Float[np.ndarray, "steps 3 nu past"]:
    """How the inputs of `acted` change with the levels of all inputs before the record.

    Delays and lags are linear: the slopes are the same at any level. A limit of the rate has none:
    a small step is made up for at once, and says nothing of a large one.

    Args:
        plant: at its parameters.
        driven_by: of a whole record; no past of inputs matters without an actuator.
    """
    linear = np.asarray(are_linear(plant.actuator, len(plant.inputs)))
    if not has_sampled_actuator(plant):
        return linear * np.asarray(_past_slopes(plant, jnp.asarray(plant.theta), driven_by))
    theta, levels = np.asarray(plant.theta), np.eye(len(plant.inputs))
    settled = actuated_on_host(plant, theta, driven_by, 0.0 * levels[0])
    risen = np.zeros((*settled.shape, len(levels)))
    for column in np.flatnonzero(linear & np.asarray(have_past(plant.actuator, len(levels)))):
        risen[..., column] = actuated_on_host(plant, theta, driven_by, levels[column]) - settled
    return risen[: len(driven_by.time)]


@jit
def _past_slopes(plant: Plant, theta: Theta, driven_by: Drive) -> Array:
    settled = jnp.zeros(len(plant.inputs), theta.dtype)
    slopes = jax.jacfwd(lambda past: actuated(plant, theta, driven_by, past))(settled)
    return slopes[: driven_by.time.shape[0]]


def actuated_on_host(
    plant: Plant,
    theta: Float[np.ndarray, " np"],
    driven_by: Drive,
    past: Float[np.ndarray, " nu"] | None = None,
) -> Float[np.ndarray, "steps 3 nu"]:
    """`actuated` by NumPy, where `has_sampled_actuator` says so; arguments as there."""
    averaged = step_means(np, plant, driven_by)
    inputs = np.array(averaged.stages)
    changed = changed_on_host(plant, theta, averaged, driven_by.substeps, past)
    inputs[..., changed_inputs(plant.actuator, len(plant.inputs))] = changed
    return inputs[: len(inputs) if plant.has_algebraic else -1]


def changed_on_host(
    plant: Plant,
    theta: Float[np.ndarray, " np"],
    averaged: StepMeans,
    substeps: int,
    past: Float[np.ndarray, " nu"] | None,
) -> Float[np.ndarray, "steps 3 changed"]:
    """`parabolas` by NumPy, where `has_sampled_actuator` says so; arguments as there."""
    values = dict(zip(plant.names, theta.tolist(), strict=True))

    def actuate(middles: np.ndarray, mean: np.ndarray) -> np.ndarray:
        return plant.actuator.sampled(middles, mean, values)  # pyright: ignore

    return parabolas(np, plant, actuate, averaged, substeps, past)


def _actuated_by_values(plant: Plant, driven_by: Drive) -> Float[np.ndarray, "steps 3 nu"]:
    """At the plant's own parameters."""
    if has_sampled_actuator(plant):
        return actuated_on_host(plant, np.asarray(plant.theta), driven_by)
    return np.asarray(actuated(plant, jnp.asarray(plant.theta), driven_by))


# -- starts ------------------------------------------------------------------------------


def _check_untraced(*arguments: Any) -> None:
    traced = [leaf for leaf in jax.tree.leaves(arguments) if isinstance(leaf, Tracer)]
    rule = "must get numbers, as it returns a record"
    advice = "In `jit`, `grad` or `vmap`, use `rollout(plant, theta, x0, u, h)`."
    check(not traced, "simulate", rule, "numbers that JAX traces", advice)


def _check_finite(name: str, value: np.ndarray) -> None:
    check(bool(np.all(np.isfinite(value))), name, "must be finite", "NaN or infinity")


def _uniform(time: np.ndarray) -> Float[np.ndarray, " time"]:
    rule = f"must be a line of at least {SHORTEST} samples"
    check(time.ndim == 1 and len(time) >= SHORTEST, "time", rule, f"shape {time.shape}")
    _check_finite("time", time)
    period = (time[-1] - time[0]) / (len(time) - 1)
    check(period > 0, "time", "must increase", f"{time[0]:g} to {time[-1]:g}")
    deviation = np.abs(time - (time[0] + period * np.arange(len(time))))
    worst, index = np.max(deviation) / period, int(np.argmax(deviation))
    failure = f"a sample {worst:.3g} periods off, at index {index}"
    advice = "Resample the inputs onto a uniform grid."
    check(bool(worst <= 1e-3), "time", "must be a uniform grid", failure, advice)
    return time


def initial_outputs(plant: Plant, initial: Any, xp: Any = np) -> Float[Any, "r ny"]:
    """Outputs and their derivatives at the start of a run, as in `State.y`.

    Args:
        plant: with its relative degrees.
        initial: as of `simulate`.
        xp: NumPy, or JAX's for traced numbers.

    Raises:
        ValueError: a wrong shape, an unknown output, or no numbers.
    """
    r, ny = plant.rows, len(plant.outputs)
    table = np.nan_to_num(plant.known_start)
    if isinstance(initial, Mapping):
        initial = start_by_name(initial, plant.outputs, plant.degrees, table)
    try:
        value = xp.asarray(table if initial is None else initial, float)
    except (TypeError, ValueError):
        rule = f"must be numbers of shape ({r}, {ny}) or a dict by output"
        check(False, "initial", rule, initial, f"Write {{{plant.outputs[0]!r}: (value, rate, …)}}.")
        raise
    if ny == 1 and value.shape == ():
        value = xp.concatenate([value[None], xp.zeros(r - 1)])
    if ny == 1 and value.shape == (r,):
        value = value[:, None]
    check_shape("initial", value, (r, ny), "the outputs, then each of their derivatives")
    owned = np.arange(r)[:, None] < np.asarray(plant.degrees)
    return xp.where(owned, value, 0.0)


def _internal(plant: Plant, internal: ArrayLike | None) -> Float[np.ndarray, " nz"]:
    start = plant.initial_internal
    if internal is None:
        advice = f"Give {counted(len(start), 'value')}, as {', '.join(internal_names(plant))}."
        check_no_free_start(plant, "internal", advice)
        return start
    value = np.atleast_1d(np.asarray(internal, dtype=np.float64))
    check_shape("internal", value, start.shape, "one value an internal state")
    _check_finite("internal", value)
    return value


# -- the independent route ----------------------------------------------------------------


def _input_pieces(samples: Float[np.ndarray, "time nu"], hold: Hold) -> Pieces:
    """The input within each step: a polynomial in the fraction of the step, lowest power first."""
    places = {"zero": 1, "linear": 2, "smooth": 6}
    order = max(places[word] for word, _ in columns_by_hold(hold))

    def pieces(word: str, columns: Columns) -> np.ndarray:
        fractions = np.linspace(0.0, 1.0, places[word])
        values = inputs_within_steps(samples[:, columns], fractions, word)
        powers = np.linalg.inv(np.vander(fractions, increasing=True))
        polynomials = np.einsum("pf,kfu->kpu", powers, values)
        return np.pad(polynomials, ((0, 0), (0, order - places[word]), (0, 0)))

    return by_hold(hold, samples, pieces)


@jit
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
        return rate_of(plant, theta, t, x, powers @ piece)

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
