r"""The estimator for a loop in real time: observer, filter, recursion and alarm, sample by sample.

Each step is that of the pass (`kernel.py`) and of the recursion (12)–(13)
(`regression/recursive_least_squares.py`); nothing looks ahead. The weight of a step that follows a
start, or rest under dry friction, rises as in `data/masks.py`; towards rest, which only the next
samples show, it does not fall in advance.

**Alarm.** Of the injection r = F[u_eq] at θ, with P its power where the model holds (14),

    s ← s + (h/T) (r²/P - s)        (the mean over the outputs)

is the power over the last T seconds, one on average. As a mean of squares it is distributed like
χ²/ν with ν = 2/var s degrees of freedom. As P is a mean of squares itself, of N independent ones,
the ratio has the F distribution (ν, N). Levels u standard deviations away are crossed by a process
with the memory T at the rate u² Q(u)/T (an Ornstein–Uhlenbeck process: H. Cramér, M. Leadbetter,
*Stationary and Related Stochastic Processes* (1967), chapter 12; D. Aldous, *Probability
Approximations via the Poisson Clumping Heuristic* (1989), D10), which is set to the rate of false
alarms that is asked for; the threshold is the quantile of F with the same tail Q(u).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax._checks import check, check_kind, check_positive, check_shape, real
from eoi_jax._types import Output, Scalar
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.data.masks import SETTINGS as MASK_SETTINGS
from eoi_jax.data.masks import direction_of_motion
from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.kernel import Carry, Kernel, Step
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observe import ObserverPass, observe
from eoi_jax.estimation.observers.observer import AbstractObserver, gain
from eoi_jax.estimation.preparation import TAPER, check_observer
from eoi_jax.estimation.regression.recursive_least_squares import (
    RecursiveLeastSquares,
    RecursiveState,
)
from eoi_jax.models.check_records import check_records
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.residual_correlation import lagged_products


@dataclass(frozen=True)
class OnlineSettings:
    """How long steps are counted, and how the threshold of an alarm is found."""

    ages: float = 1e9  # steps, beyond which they are no longer counted
    time_constants: float = 20.0  # of F, over which the injection's noise is correlated
    deviations: tuple[float, float] = (1.5, 12.0)  # u of a threshold


_SETTINGS = OnlineSettings()


class Alarm(eqx.Module):
    """When the injection is more than noise; `online_estimator` makes one.

    Args:
        power: P of each output where the model holds, shape (ny,).
        memory: T [s].
        threshold: of s, above which the alarm is on.

    Raises:
        ValueError: a power, a memory or a threshold that is not positive.
    """

    power: Float[Array | np.ndarray, " ny"]
    memory: Any
    threshold: Any

    def __init__(self, power: Any, memory: Any, threshold: Any):
        for name, value, advice in (
            ("power", power, "It is the mean square of an output's injection."),
            ("memory", memory, "It is a time in seconds."),
            ("threshold", threshold, "Where the model holds, the power is 1 on average."),
        ):
            if not isinstance(value, Tracer):
                check_positive(name, value, advice)
        self.power, self.memory, self.threshold = gain(power), memory, threshold


class OnlineState(eqx.Module):
    """State between two samples.

    Attributes:
        samples: number so far.
        direction: of motion of each output in the last step, 0 where uncertain, shape (ny,).
        moving: steps since each output was last at rest, shape (ny,).
        scored: steps since each last had no weight, shape (ny,).
        y, u: the last sample.
        kernel: of observer and filter.
        recursion: of the least squares.
        power: s of the alarm.
    """

    samples: Scalar
    direction: Output
    moving: Output
    scored: Output
    y: Output
    u: Float[Array, " nu"]
    kernel: Carry
    recursion: RecursiveState
    power: Scalar


class OnlineEstimate(eqx.Module):
    """What a sample adds.

    Attributes:
        parameters: θ + Δ̂, shape (np,).
        injection: F[u_eq] at θ, shape (ny,).
        power: s, the injection's power over that of its noise; zero without an alarm.
        alarm: 1 where it is above the threshold.
    """

    parameters: Float[Array, " np"]
    injection: Output
    power: Scalar
    alarm: Scalar


class OnlineEstimator(eqx.Module):
    """Observer, filter and recursive least squares, one sample at a time: `init` and `step`.

    Pure functions of arrays, for `jit`, `vmap` and `lax.scan`; `export_estimator` writes them as C.

    Args:
        plant: the model; delays and lags of inputs are not supported.
        observer: with its gains.
        lowpass: F.
        sample_period: h [s].
        theta: parameters at which the observer runs; by default those of the plant.
        forgetting: λ of the recursion.
        weights: of the outputs, the inverse of their index up to a factor, shape (ny,).
        transient: time at the start that does not count [s]; by default ten time constants of F.
        noise: standard deviation of the noise of each output, by which a velocity with dry friction
            counts as zero.
        hold: of the inputs between samples: ``"zero"`` or ``"linear"``.
        alarm: by default none.

    Raises:
        ValueError: a plant with delays or lags, arguments that do not match it, an alarm with
            another number of outputs or a memory shorter than the sample period.
    """

    plant: Plant
    observer: AbstractObserver
    lowpass: DiscreteFilter
    theta: Float[Array | np.ndarray, " np"]
    sample_period: float
    recursion: RecursiveLeastSquares
    weights: Float[Array | np.ndarray, " ny"]
    transient: float
    taper: float
    velocity_noise: Float[Array | np.ndarray, " ny"]
    hold: str = eqx.field(static=True)
    alarm: Alarm | None
    jumps: tuple[tuple[bool, ...], ...] = eqx.field(static=True)

    def __init__(
        self,
        plant: Plant,
        observer: AbstractObserver,
        lowpass: LowPass,
        sample_period: float,
        theta: Any = None,
        *,
        forgetting: float = 1.0,
        weights: Any = None,
        transient: float | None = None,
        noise: Any = 0.0,
        hold: str = "zero",
        alarm: Alarm | None = None,
    ):
        check_kind("plant", plant, Plant, "a Plant")
        check_observer(plant, observer)
        rule = "must be a model without delays or lags of its inputs, and without sampled states"
        advice = "Give the estimator inputs that are delayed already, or a lag as a state."
        check(plant.actuator is None and plant.sampled is None, "plant", rule, plant.name, advice)
        h, ny = real(sample_period), len(plant.outputs)
        check(h > 0, "sample_period", "must be positive [s]", sample_period)
        check(hold in ("zero", "linear"), "hold", 'must be "zero" or "linear"', hold)
        self.plant, self.observer, self.hold = plant, observer, hold
        self.lowpass, self.sample_period = lowpass.discretise(h), h
        self.theta = np.asarray(plant.theta if theta is None else theta, float)
        check_shape("theta", self.theta, (len(plant.names),), "one number a parameter")
        self.recursion = RecursiveLeastSquares(forgetting, compensated=True)
        self.weights = np.ones(ny) if weights is None else np.asarray(weights, float)
        check_shape("weights", self.weights, (ny,), "one number an output")
        slowest = 10.0 / real(lowpass.cutoff) + (1.0 if observer.scheme == "explicit" else 0.0)
        self.transient = slowest if transient is None else real(transient)
        self.taper = TAPER / real(lowpass.cutoff) / h
        speed = np.where(np.asarray(plant.degrees) == 1, 1.0, np.sqrt(2.0) / h)
        self.velocity_noise = np.broadcast_to(np.asarray(noise, float), ny) * speed
        self.alarm = _checked_alarm(alarm, ny, h)
        self.jumps = tuple(map(tuple, plant.jumps.tolist()))

    @property
    def kernel(self) -> Kernel:
        """Observer and filter."""
        theta, ones = jnp.asarray(self.theta), jnp.ones(len(self.plant.outputs))
        parts = self.plant, self.observer, self.lowpass, theta
        return Kernel(*parts, jnp.zeros_like(theta), ones, "signals")

    def init(self) -> OnlineState:
        """State without a sample."""
        ny, nu = len(self.plant.outputs), len(self.plant.inputs)
        y, h = jnp.zeros(ny), jnp.asarray(self.sample_period)
        return OnlineState(
            jnp.zeros(()),
            y,
            jnp.full(ny, _SETTINGS.ages),
            y,
            y,
            jnp.zeros(nu),
            self.kernel.init(y, y, h),
            self.recursion.init(len(self.plant.names)),
            jnp.ones(()),
        )

    def step(self, state: OnlineState, y: Any, u: Any) -> tuple[OnlineState, OnlineEstimate]:
        """One sample.

        Args:
            state: before it.
            y: outputs, measured at the sample, shape (ny,).
            u: inputs from the sample on, shape (nu,).

        Returns:
            The state after the sample, and what is known then.

        Raises:
            ValueError: outputs or inputs of another shape.
        """
        y, u = jnp.asarray(y, float), jnp.asarray(u, float)
        check_shape("y", y, (len(self.plant.outputs),), "one number an output")
        check_shape("u", u, (len(self.plant.inputs),), "one number an input")
        number, h = state.samples - 1.0, jnp.asarray(self.sample_period)  # number of the step
        direction, moving = self._motion(state, y)
        usable, since, use = jnp.ones(y.shape, bool), state.scored, jnp.ones(y.shape)
        if any(self.plant.degrees):
            usable = (moving >= self._taps) & (number >= self._taps + MASK_SETTINGS.settling)
            since = jnp.where(usable, jnp.minimum(state.scored + 1.0, _SETTINGS.ages), 0.0)
            length = jnp.maximum(self.taper, 1.0)
            use = 0.5 - 0.5 * jnp.cos(jnp.pi * jnp.minimum(since, length) / length)
        score = (usable & (number >= jnp.round(self.transient / h))).astype(float)
        explicit = self.observer.scheme == "explicit"
        middle = state.u if explicit or self.hold == "zero" else 0.5 * (state.u + u)
        row = Step(
            u=middle,
            slope=None,
            time=h * (number + (0.0 if explicit else 0.5)),
            y=state.y,
            y_next=y,
            use=use,
            score=score,
            restart=number == 0.0,
            block_weight=jnp.zeros(()),
            block_end=jnp.zeros((), bool),
            u_start=state.u if self.plant.has_algebraic else None,
        )
        kernel, trace = self.kernel.step(state.kernel, row, h)
        weights = score * jnp.asarray(self.weights)
        recursion, _ = self.recursion.step(state.recursion, trace.Phi, trace.injection, weights)
        power = self._power(state.power, trace.injection, trace.weight, score)
        begun = state.samples > 0.0  # the first sample ends no step

        def updated(new: Array, old: Array) -> Array:
            return jnp.where(begun, new, old)

        after = OnlineState(
            state.samples + 1.0,
            updated(direction, state.direction),
            updated(moving, state.moving),
            updated(since, state.scored),
            y,
            u,
            jax.tree.map(updated, kernel, state.kernel),
            jax.tree.map(updated, recursion, state.recursion),
            updated(power, state.power),
        )
        threshold = np.inf if self.alarm is None else self.alarm.threshold
        estimate = OnlineEstimate(
            jnp.asarray(self.theta) + after.recursion.increment,
            jnp.where(begun, trace.injection, 0.0),
            after.power if self.alarm is not None else jnp.zeros(()),
            (after.power > threshold).astype(float),
        )
        return after, estimate

    @property
    def _taps(self) -> int:
        return np.atleast_2d(np.asarray(self.observer.kernel)).shape[1]

    def _motion(self, state: OnlineState, y: Output) -> tuple[Output, Output]:
        """Direction of each output, and steps since it, or one that acts on it, was at rest."""
        jumps = np.asarray(self.jumps)
        if not np.any(jumps):
            return state.direction, jnp.full(y.shape, _SETTINGS.ages)
        spread = jnp.asarray(self.velocity_noise)
        direction = direction_of_motion(self.plant.degrees, state.y, y, self.sample_period, spread)
        previous = jnp.where(state.samples == 1.0, direction, state.direction)
        resting = (direction == 0.0) | (direction != previous)
        stopped = jnp.stack([jnp.any(jnp.where(row, resting, False)) for row in jumps])
        ages = jnp.minimum(state.moving + 1.0, _SETTINGS.ages)
        return direction, jnp.where(stopped, 0.0, ages)

    def _power(self, power: Scalar, injection: Output, weight: Output, score: Output) -> Scalar:
        """The injection's power over that of its noise, over the memory of the alarm."""
        if self.alarm is None:
            return power
        share = self.sample_period / self.alarm.memory
        mean = injection / jnp.where(weight > 0.0, weight, 1.0)
        ratios = mean**2 / jnp.asarray(self.alarm.power)
        count = jnp.sum(score)
        latest = jnp.sum(score * ratios) / jnp.where(count > 0.0, count, 1.0)
        return jnp.where(count > 0.0, power + share * (latest - power), power)


def _checked_alarm(alarm: Alarm | None, ny: int, h: float) -> Alarm | None:
    if alarm is None:
        return None
    check_kind("alarm", alarm, Alarm, "an Alarm or None")
    check_shape("alarm.power", alarm.power, (ny,), "one number an output")
    if not isinstance(alarm.memory, Tracer):
        rule = f"must be at least a sample period, {h:g} s"
        check(real(alarm.memory) >= h, "alarm.memory", rule, alarm.memory)
    return alarm


def online_estimator(
    result: Identification,
    records: Record | Sequence[Record],
    *,
    forgetting: float = 1.0,
    memory: float = 0.5,
    false_alarms: float = 1.0 / 3600.0,
) -> OnlineEstimator:
    """The estimator of an identification, for a loop in real time with the records' sampling.

    Args:
        result: of `identify`: model, observer and filter.
        records: as measured, all with one sample period; their injection is what is left where the
            model holds, so that the alarm asks whether there is more. Inputs are held between the
            samples where all records hold them, else they go in straight lines: nothing that needs
            the next samples, as a smooth input does, is known in real time (`hold` says which).
        forgetting: λ of the recursion: it remembers about 1/(1 - λ) samples.
        memory: time over which the alarm takes the injection's power [s].
        false_alarms: rate of false alarms [1/s], for Gaussian noise; by default one an hour.

    Returns:
        The estimator; its `alarm` has the power of the noise and the threshold.

    Raises:
        ValueError: no estimate, records of several sample periods or none that count, a plant with
            delays or lags, a rate that is not positive, a memory shorter than the sample period.
    """
    check_kind("result", result, Identification, "a result of `identify`")
    rule = "must have an estimate"
    check(result.status.fits, "result", rule, str(result.status))
    check(real(memory) > 0, "memory", "must be positive [s]", memory)
    check(real(false_alarms) > 0, "false_alarms", "must be positive [1/s]", false_alarms)
    plant = result.plant
    used = check_records(plant, records)
    periods = sorted({record.sample_period for record in used})
    equal = np.allclose(periods, periods[0], rtol=1e-9)
    check(equal, "records", "must have one sample period", periods)
    held = all(hold == "zero" for record in used for hold in record.holds)
    hold = "zero" if held else "linear"
    passes = [
        observe(
            plant, result.observer, None, record.sample_period, record.outputs, record.inputs,
            lowpass=result.lowpass, hold=hold, noise=record.noise, valid=record.output_valid,
        )
        for record in used
    ]  # fmt: skip
    injections = [_mean_injection(part) for part in passes]
    scores = [np.asarray(part.score) > 0 for part in passes]
    counts = np.sum([np.sum(score, axis=0) for score in scores], axis=0).astype(float)
    check(np.all(counts > 1), "records", "must have samples that count", counts.tolist())
    power = np.sum([np.sum(part**2, axis=0) for part in injections], axis=0) / counts
    lags = int(np.ceil(_SETTINGS.time_constants / (result.lowpass.cutoff * periods[0])))
    correlation = _correlation(injections, lags) / (counts * power)
    threshold = _threshold(correlation, counts, periods[0], real(memory), real(false_alarms))
    alarm = Alarm(power, real(memory), threshold)
    return OnlineEstimator(
        plant,
        result.observer,
        result.lowpass,
        periods[0],
        forgetting=forgetting,
        weights=np.min(power) / power,
        noise=np.max([record.noise for record in used], axis=0),
        hold=hold,
        alarm=alarm,
    )


def _mean_injection(part: ObserverPass) -> Float[np.ndarray, "S ny"]:
    """F[m u_eq]/F[m] where it counts, else 0."""
    weight = np.asarray(part.weight)
    counts = (np.asarray(part.score) > 0) & (weight > 0)
    return np.where(counts, np.asarray(part.injection) / np.where(counts, weight, 1.0), 0.0)


def _correlation(
    signals: Sequence[Float[np.ndarray, "time ny"]], lags: int
) -> Float[np.ndarray, "lags ny"]:
    """Σ r_k r_(k+l), l = 0 … lags, of all signals together."""
    total = np.zeros((lags + 1, signals[0].shape[1]))
    for signal in signals:
        kept = min(lags + 1, len(signal))
        for j, channel in enumerate(signal.T):
            total[:kept, j] += lagged_products(channel, channel)[:kept]
    return total


def _threshold(
    correlation: Float[np.ndarray, "lags ny"],
    counts: Float[np.ndarray, " ny"],
    period: float,
    memory: float,
    rate: float,
) -> float:
    """Of s, for a rate of false alarms; equations in the docstring of the module."""
    from scipy.optimize import root_scalar
    from scipy.stats import f, norm

    share = period / memory
    squares = 2.0 * correlation**2
    decay = (1.0 - share) ** np.arange(len(squares))[:, None]
    twice = np.where(np.arange(len(squares)) == 0, 1.0, 2.0)[:, None]
    variances = share / (2.0 - share) * np.sum(twice * decay * squares, axis=0)
    variance = np.sum(variances) / len(variances) ** 2
    independent = np.sum(counts / (0.5 * np.sum(twice * squares, axis=0)))

    def excess(deviation: float) -> float:
        return float(2.0 * np.log(deviation) + norm.logsf(deviation) - np.log(rate * memory))

    low, high = _SETTINGS.deviations
    deviation = low if excess(low) <= 0.0 else float(root_scalar(excess, bracket=(low, high)).root)
    return float(f.isf(norm.sf(deviation), 2.0 / variance, independent))
