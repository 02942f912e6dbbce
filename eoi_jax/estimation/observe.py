r"""One pass over one record as a function of arrays, for use inside other JAX code.

It is the pass of `identify` and `sweep` (`kernel.py`): the same observer, filter and sums. What
those choose from records (gains, filter, sub-steps, smoothing) are arguments here, with defaults
that do not look at the data.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check, check_kind, check_positive, check_shape
from eoi_jax._types import Scalar
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.compiler.programs import jit
from eoi_jax.data.input_holds import TRACED_HOLDS, Hold, HoldArgument, read_hold
from eoi_jax.data.masks import beyond_starts, moved_steps, tapered
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import inputs_within_steps
from eoi_jax.estimation.kernel import Kernel, Steps, Sums, Trace
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.preparation import TAPER, check_observer
from eoi_jax.estimation.regression.index import index
from eoi_jax.models.free_starts import check_known_starts
from eoi_jax.models.plant import Plant

Host = Array | np.ndarray


class ObserverPass(eqx.Module):
    r"""What one pass over a record gives; its N - 1 steps S lie between the samples.

    Attributes:
        injection: $F[m\,u_{eq}]$ [unit of y^(r)], shape (S, ny); None if not asked for.
        regressors: $F[m\,\varphi]$, shape (S, ny, np); likewise.
        weight: $F[m]$ with the mask m, shape (S, ny); likewise.
        score: 1.0 where a step counts in the sums, shape (S, ny).
        information: Σ φᵀφ of eq. (11), for each output, shape (ny, np, np).
        rhs: Σ φᵀ u_eq of eq. (11), for each output, shape (ny, np).
        index: P of eq. (14), shape (ny,).
        sliding: share of the steps that count in sliding mode, shape (ny,).
    """

    injection: Any
    regressors: Any
    weight: Any
    score: Float[Host, "S ny"]
    information: Float[Host, "ny np np"]
    rhs: Float[Host, "ny np"]
    index: Float[Host, " ny"]
    sliding: Float[Host, " ny"]


def observe(
    plant: Plant,
    observer: AbstractObserver,
    theta: Any,
    h: Scalar | float,
    y: Any,
    u: Any,
    *,
    lowpass: LowPass | None = None,
    hold: HoldArgument = "zero",
    transient: Scalar | float | None = None,
    valid: Any = None,
    noise: Any = 0.0,
    signals: bool = True,
    t0: Scalar | float = 0.0,
) -> ObserverPass:
    r"""One pass over one record, a pure function of arrays: `jit`, `vmap`, `grad`, `jvp` apply.

    The observer follows y with the model at θ; the injection that it takes is what the model lacks.
    Injection and regressors φ = ∂f/∂θ pass the same filter F, and their products add up to the
    least squares (11), ``information @ Δθ = rhs``. Steps in which dry friction holds an output at
    rest have the weight zero, and so have those beside them.

    Derivatives are those of the sums with these steps. The injection of an explicit observer takes
    two values only, so that its derivative is zero: take the implicit form.

    Args:
        plant: the model. Which outputs stick is found at its own parameters.
        observer: with its gains, numbers or traced arrays.
        theta: parameter values: an array (np,) in the plant's order, a dict by name (the others are
            the plant's), or None for the plant's own.
        h: sample period [s]; where JAX traces it, its sign is not checked.
        y: outputs at the samples, shape (N, ny), for a single output (N,).
        u: inputs at the samples, shape (N, nu), for a single input (N,); (N, 0) without inputs.
        lowpass: F. By default its cut-off is a tenth of the sampling rate, 0.2 π/h [rad/s], and its
            order the highest relative degree plus one: the widest filter that `identify` takes.
            Measured records need a narrower one (`identify(…).lowpass` shows it).
        hold: inputs between samples: ``"zero"`` (held) or ``"linear"``, of all inputs, of each in
            order, or by name.
        transient: time at the start that does not count [s]; by default ten time constants of F
            (one second more for an explicit observer), at most a fifth of the record.
        valid: samples that were measured, shape (N,) or (N, ny); the others stand for a gap, or for
            the padding of a shorter record, and may hold any finite numbers. None: all.
        noise: standard deviation of the noise of each output, by which a velocity with dry friction
            counts as zero.
        signals: whether injection and regressors are given, which take S · ny · (np + 2) numbers.
        t0: time of the first sample [s].

    Returns:
        Signals, sums and index.

    Raises:
        ValueError: a wrong shape, h ≤ 0, an observer that does not match the plant, an unknown name
            or hold, or a plant whose states change at samples or start anywhere.

    Source:
        Sections 3 and 4 of the paper, eqs. (2), (11), (14) and (19).
    """
    check_kind("plant", plant, Plant, "a Plant")
    check_observer(plant, observer)
    for field, array in (("y", y), ("u", u)):
        good, advice = not isinstance(array, Record), "Give its `outputs` and `inputs`."
        check(good, field, "must be an array", "a Record", advice)
    rule = "must be a number, or one for each output"
    check(noise is not None, "noise", rule, "None", "Leave it out if it is not known.")
    if not isinstance(h, Tracer):
        check_positive("h", h, "It is the sample period in seconds.")
    hold = read_hold(hold, plant.inputs, automatic=False, words=TRACED_HOLDS)
    check_kind("lowpass", lowpass, (LowPass, type(None)), "a filter `LowPass(cutoff, order)`")
    rule = "must have no states that change at samples: passes do not follow them"
    check(plant.sampled is None, "plant", rule, plant.name)
    check_known_starts(plant)
    outputs = _columns("y", y, len(plant.outputs), "an output")
    inputs = _columns("u", u, len(plant.inputs), "an input")
    check(len(outputs) > 2, "y", "must have at least three samples", len(outputs))
    rule = f"must have as many samples as `y`, {len(outputs)}"
    check(len(inputs) == len(outputs), "u", rule, len(inputs))
    if lowpass is None:
        lowpass = LowPass(0.2 * np.pi / h, plant.relative_degree + 1)
    if transient is None:
        slowest = 10.0 / lowpass.cutoff + (1.0 if observer.scheme == "explicit" else 0.0)
        transient = jnp.minimum(slowest, 0.2 * h * len(outputs))
    theta = (plant if theta is None else plant.with_parameters(theta)).theta
    measured = jnp.ones(outputs.shape, bool) if valid is None else jnp.asarray(valid, bool)
    measured = measured[:, None] if measured.ndim == 1 else measured
    rule = f"must have shape ({len(outputs)},) or {outputs.shape}, a flag for each sample of `y`"
    good = measured.shape in (outputs.shape, (len(outputs), 1))
    check(good, "valid", rule, f"shape {measured.shape}")
    measured = jnp.broadcast_to(measured, outputs.shape)
    numbers = (theta, h, t0, transient, TAPER / lowpass.cutoff, noise)
    return _observed(
        plant,
        observer,
        lowpass.discretise(h),
        *(jnp.asarray(number, float) for number in numbers),
        outputs,
        inputs,
        measured,
        hold,
        tuple(map(tuple, plant.jumps.tolist())),
        signals,
    )


def _columns(name: str, values: Any, count: int, channel: str) -> Float[Array, "time channels"]:
    array = jnp.asarray(values, float)
    array = array[:, None] if array.ndim == 1 else array
    many = "Outputs of `rollout` are `.y[:, 0]`; several records side by side need `jax.vmap`."
    advice = many if array.ndim > 2 else ""
    check_shape(name, array, (None, count), f"one row a sample, a column {channel}", advice)
    return array


@jit
def _observed(
    plant: Plant,
    observer: AbstractObserver,
    lowpass: DiscreteFilter,
    theta: Any,
    h: Scalar,
    t0: Scalar,
    transient: Scalar,
    taper: Scalar,
    noise: Array,
    y: Float[Array, "time ny"],
    u: Float[Array, "time nu"],
    measured: Bool[Array, "time ny"],
    hold: Hold,
    jumps: tuple[tuple[bool, ...], ...],
    signals: bool,
) -> ObserverPass:
    explicit, count = observer.scheme == "explicit", len(y) - 1
    middle = u[:-1] if explicit else inputs_within_steps(u, np.full(1, 0.5), hold)[:, 0]
    use, score, restart = _weights(
        plant, observer, h, transient, taper, noise, y, measured, np.asarray(jumps)
    )
    steps = Steps(
        time=t0 + h * (jnp.arange(count) + (0.0 if explicit else 0.5)),
        y=y[:-1],
        y_next=y[1:],
        u=middle,
        use=use,
        score=score,
        restart=restart,
        block_weight=jnp.zeros(count),
        block_end=jnp.zeros(count, bool),
        sample_period=h,
        u_start=u[:-1] if plant.has_algebraic else None,
    )
    store = "signals" if signals else "nothing"
    ones = jnp.ones(len(plant.outputs))
    kernel = Kernel(plant, observer, lowpass, theta, jnp.zeros_like(theta), ones, store)
    return _result(*kernel.run(steps), score)


def _result(sums: Sums, trace: Trace | None, score: Float[Array, "S ny"]) -> ObserverPass:
    scored = jnp.where(sums.count > 0, sums.count, 1.0)
    return ObserverPass(
        None if trace is None else trace.injection,
        None if trace is None else trace.Phi,
        None if trace is None else trace.weight,
        score,
        sums.information,
        sums.rhs,
        index(sums.square, sums.weight),
        sums.sliding / scored,
    )


def _weights(
    plant: Plant,
    observer: AbstractObserver,
    h: Scalar,
    transient: Scalar,
    taper: Scalar,
    noise: Array,
    y: Float[Array, "time ny"],
    measured: Bool[Array, "time ny"],
    jumps: Bool[np.ndarray, "ny ny"],
) -> tuple[Float[Array, "S ny"], Float[Array, "S ny"], Bool[Array, " S"]]:
    """Mask and score of every step, and where the observer starts."""
    degrees, skipped = plant.degrees, jnp.round(transient / h)
    if any(degrees):
        speed = jnp.where(np.asarray(degrees) == 1, noise, np.sqrt(2.0) * noise / h)
        # Which outputs enter which equation is not asked: all must be measured.
        good = jnp.broadcast_to(jnp.all(measured, axis=1, keepdims=True), measured.shape)
        taps = np.atleast_2d(np.asarray(observer.kernel)).shape[1]
        usable, restart = moved_steps(good[1:] & good[:-1], y, h, taps, degrees, jumps, speed)
    else:
        usable, restart = measured[:-1], jnp.arange(len(y) - 1) == 0
    use = tapered(usable.astype(float), taper / h)
    gaps = observer.scheme == "explicit" or plant.internal is not None
    if gaps or plant.actuator is not None:
        # An observer that reaches sliding slowly, or internal states that a gap leaves unknown.
        usable &= beyond_starts(restart, skipped)[:, None]
    usable &= (jnp.arange(len(usable)) >= skipped)[:, None]
    return use, usable.astype(float), restart
