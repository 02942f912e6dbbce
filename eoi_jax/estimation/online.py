r"""The estimator for a loop in real time: observer, filter, recursion and alarm, sample by sample.

Each step is that of the pass (`kernel.py`) and of the recursion (12)–(13)
(`regression/recursive_least_squares.py`); nothing looks ahead.

**Missing samples.** A step that does not count (beside a missing sample, or at rest under dry
friction) has the weight zero, which `online_mask.py` finds, and empties the filter: what follows is
the pass over a record that begins there. Information, estimate and time go on, and so do internal
states, with outputs that stay at the last measurement.

**Alarm.** Of the injection r = F[m u_eq] at θ, with P its power where the model holds,

    s ← s + (h/T) w² (r²/P - s)        (the mean over the outputs)

is the power over the last T seconds, one on average. Behind what does not count, w = F[m] rises
from zero to one, and r² has more noise than w² P: as a weight, w² lets such steps count little. As
a mean of squares s is distributed like χ²/ν with ν = 2/var s degrees of freedom. As P is a mean of
squares itself, of N independent ones, the ratio has the F distribution (ν, N). Levels u standard
deviations away are crossed by a process with the memory T at the rate u² Q(u)/T (an
Ornstein–Uhlenbeck process: H. Cramér, M. Leadbetter, *Stationary and Related Stochastic Processes*
(1967), chapter 12; D. Aldous, *Probability Approximations via the Poisson Clumping Heuristic*
(1989), D10), which is set to the rate of false alarms that is asked for; the threshold is the
quantile of F with the same tail Q(u). The squares w² r² behind P are worth n = (Σw²)²/Σw⁴ equal
ones, and w r is correlated over time with the coefficients c_l, so that N = n / Σ_l c_l². Where
Σw² / Σ_l c_l² is small, P is hardly known, or s hardly moves: there is no alarm then.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from eoi_jax._checks import check, check_kind, check_positive, check_shape, real
from eoi_jax._display import text
from eoi_jax._types import Output, Scalar
from eoi_jax.compiler.jax_private import Tracer
from eoi_jax.data.input_holds import (
    TRACED_HOLDS,
    Hold,
    HoldArgument,
    held_inputs,
    read_hold,
    shared,
)
from eoi_jax.data.masks import SETTINGS
from eoi_jax.data.record import Record
from eoi_jax.estimation.defaults import velocity_noise
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.kernel import Carry, Kernel, Step
from eoi_jax.estimation.lowpass import DiscreteFilter, LowPass
from eoi_jax.estimation.observe import observe
from eoi_jax.estimation.observers.observer import AbstractObserver, gain
from eoi_jax.estimation.online_inputs import DrivenInputs, DrivenState
from eoi_jax.estimation.online_mask import MaskState, OnlineMask, StepMask
from eoi_jax.estimation.preparation import TAPER, check_observer
from eoi_jax.estimation.regression.recursive_least_squares import (
    RecursiveLeastSquares,
    RecursiveState,
)
from eoi_jax.models.check_records import check_records
from eoi_jax.models.free_starts import check_known_starts
from eoi_jax.models.plant import Plant
from eoi_jax.simulation.residual_correlation import lagged_products


@dataclass(frozen=True)
class OnlineSettings:
    """How the threshold of an alarm is found."""

    time_constants: float = 20.0  # of F, over which the injection's noise is correlated
    deviations: tuple[float, float] = (1.5, 12.0)  # u of a threshold
    min_independent: float = 10.0  # samples of full weight: P known within a factor of two (95 %)
    memory: float = 3.0  # T by default, in time constants of F: benchmarks/…/residual_alarm.py


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
        mask: of what counts.
        y, u: the last sample; of an output that is missing, the last that was not.
        inputs: of the actuators.
        kernel: of observer and filter.
        recursion: of the least squares.
        power: s of the alarm.
    """

    samples: Scalar
    mask: MaskState
    y: Output
    u: Float[Array, " nu"]
    inputs: DrivenState
    kernel: Carry
    recursion: RecursiveState
    power: Scalar


class OnlineEstimate(eqx.Module):
    """What a sample adds.

    Attributes:
        parameters: θ + Δ̂, shape (np,); fixed ones as they are.
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
    Without missing samples injection and estimate are those of `observe` and `recursive` over the
    record, except beside rest under dry friction, where weights do not fall in advance.

    Args:
        plant: the model. Delays and lags of its inputs (effects or those of text models) run at
            `theta`, and before the first sample all inputs are taken to be as there. If they are
            not fixed, the recursion estimates them to first order, as `identify` does in one pass.
        observer: with its gains.
        lowpass: F.
        sample_period: h [s].
        theta: parameters at which the observer runs; by default those of the plant. The recursion
            estimates all but those that the plant has fixed.
        forgetting: λ of the recursion.
        weights: of the outputs, the inverse of their index up to a factor, shape (ny,).
        transient: time at the start that does not count [s], and behind missing samples where the
            plant has internal states, delays or lags, or the observer is explicit; by default ten
            time constants of F, and one second more for an explicit observer.
        noise: standard deviation of the noise of each output, by which a velocity with dry friction
            counts as zero.
        hold: of the inputs between samples: ``"zero"`` or ``"linear"``, of all inputs, of each in
            order, or by name.
        alarm: by default none.

    Raises:
        ValueError: a plant whose states change at samples, or start anywhere, or with an actuator
            that is a function of its own, arguments that do not match it, an alarm with another
            number of outputs or a memory shorter than the sample period.
    """

    plant: Plant
    observer: AbstractObserver
    lowpass: DiscreteFilter
    theta: Float[Array | np.ndarray, " np"]
    sample_period: float
    inputs: DrivenInputs
    recursion: RecursiveLeastSquares
    weights: Float[Array | np.ndarray, " ny"]
    mask: OnlineMask
    hold: Hold = eqx.field(static=True)
    alarm: Alarm | None

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
        hold: HoldArgument = "zero",
        alarm: Alarm | None = None,
    ):
        check_kind("plant", plant, Plant, "a Plant")
        check_observer(plant, observer)
        rule = "must have no states that change at samples: observers do not follow them"
        check(plant.sampled is None, "plant", rule, plant.name)
        check_known_starts(plant)
        h, ny = real(sample_period), len(plant.outputs)
        check(h > 0, "sample_period", "must be positive [s]", sample_period)
        self.plant, self.observer = plant, observer
        self.hold = read_hold(hold, plant.inputs, automatic=False, words=TRACED_HOLDS)
        self.lowpass, self.sample_period = lowpass.discretise(h), h
        self.theta = np.asarray(plant.theta if theta is None else theta, float)
        check_shape("theta", self.theta, (len(plant.names),), "one number a parameter")
        self.inputs = DrivenInputs(plant, self.theta, h, self.columns, self._zero_holds)
        self.recursion = RecursiveLeastSquares(forgetting, compensated=True)
        self.weights = np.ones(ny) if weights is None else np.asarray(weights, float)
        check_shape("weights", self.weights, (ny,), "one number an output")
        slowest = 10.0 / real(lowpass.cutoff) + (1.0 if observer.scheme == "explicit" else 0.0)
        skipped = (slowest if transient is None else real(transient)) / h
        speed = np.where(np.asarray(plant.degrees) == 1, 1.0, np.sqrt(2.0) / h)
        spread = np.broadcast_to(np.asarray(noise, float), ny) * speed
        self.mask = OnlineMask(plant, observer, skipped, TAPER / real(lowpass.cutoff) / h, spread)
        self.alarm = _checked_alarm(alarm, ny, h)

    def __str__(self) -> str:
        """A table of several lines."""
        return text(self)

    @property
    def kernel(self) -> Kernel:
        """Observer and filter."""
        theta, ones = jnp.asarray(self.theta), jnp.ones(len(self.plant.outputs))
        parts = self.plant, self.observer, self.lowpass, theta
        return Kernel(*parts, jnp.zeros_like(theta), ones, "signals", jnp.asarray(self.columns))

    @property
    def _zero_holds(self) -> tuple[bool, ...]:
        """Which inputs are constant over a step; an explicit observer takes all of them so."""
        count = len(self.plant.inputs)
        return held_inputs("zero" if self.observer.scheme == "explicit" else self.hold, count)

    @property
    def columns(self) -> Float[np.ndarray, "np free"]:
        """Directions of the parameters that are estimated: all but the fixed ones."""
        return np.eye(len(self.plant.names))[:, np.asarray(self.plant.free) > 0]

    def init(self) -> OnlineState:
        """State without a sample."""
        ny, nu = len(self.plant.outputs), len(self.plant.inputs)
        y, h = jnp.zeros(ny), jnp.asarray(self.sample_period)
        return OnlineState(
            jnp.zeros(()),
            self.mask.init(jnp.zeros(ny, bool)),
            y,
            jnp.zeros(nu),
            self.inputs.init(),
            self.kernel.init(y, y, h),
            self.recursion.init(self.columns.shape[1]),
            jnp.ones(()),
        )

    def step(self, state: OnlineState, y: Any, u: Any) -> tuple[OnlineState, OnlineEstimate]:
        """One sample.

        Args:
            state: before it.
            y: outputs, measured at the sample, shape (ny,); NaN (or infinite) where one is missing.
                Steps beside it then add nothing, of any output: it may stand in every equation.
            u: inputs from the sample on, shape (nu,). One that is NaN keeps its last value, and the
                sample counts as missing.

        Returns:
            The state after the sample, and what is known then.

        Raises:
            ValueError: outputs or inputs of another shape.
        """
        y, u = jnp.asarray(y, float), jnp.asarray(u, float)
        check_shape("y", y, (len(self.plant.outputs),), "one number an output")
        check_shape("u", u, (len(self.plant.inputs),), "one number an input")
        measured = _is_number(y) & jnp.all(_is_number(u))
        y, u = jnp.where(measured, y, state.y), jnp.where(_is_number(u), u, state.u)
        number, h = state.samples - 1.0, jnp.asarray(self.sample_period)  # number of the step
        mask, counts = self.mask.step(state.mask, number, h, state.y, y, measured)
        explicit = self.observer.scheme == "explicit"
        middle = jnp.where(np.array(self._zero_holds, bool), state.u, 0.5 * (state.u + u))
        inputs, driven = self.inputs.step(
            state.inputs, number == 0.0, middle, state.u, jnp.asarray(self.theta), h
        )
        row = Step(
            u=driven.u,
            slope=driven.slope,
            time=h * (number + (0.0 if explicit else 0.5)),
            y=state.y,
            y_next=y,
            use=counts.use,
            score=counts.score,
            restart=counts.restart,
            block_weight=jnp.zeros(()),
            block_end=jnp.zeros((), bool),
            u_start=driven.u_start,
            slope_start=driven.slope_start,
        )
        kernel, trace = self.kernel.step(_emptied(state.kernel, counts), row, h)
        weights = counts.score * jnp.asarray(self.weights)
        recursion, _ = self.recursion.step(state.recursion, trace.Phi, trace.injection, weights)
        power = self._power(state.power, trace.injection, trace.weight, counts.score)
        begun = state.samples > 0.0  # the first sample ends no step

        def updated(new: Array, old: Array) -> Array:
            return jnp.where(begun, new, old)

        after = OnlineState(
            state.samples + 1.0,
            jax.tree.map(updated, mask, self.mask.init(measured)),
            y,
            u,
            inputs,
            jax.tree.map(updated, kernel, state.kernel),
            jax.tree.map(updated, recursion, state.recursion),
            updated(power, state.power),
        )
        zero = jnp.zeros(())
        alarm = zero if self.alarm is None else (after.power > self.alarm.threshold).astype(float)
        estimate = OnlineEstimate(
            jnp.asarray(self.theta) + jnp.asarray(self.columns) @ after.recursion.increment,
            jnp.where(begun, trace.injection, 0.0),
            zero if self.alarm is None else after.power,
            alarm,
        )
        return after, estimate

    def _power(self, power: Scalar, injection: Output, weight: Output, score: Output) -> Scalar:
        """The injection's power over that of its noise, over the memory of the alarm."""
        if self.alarm is None:
            return power
        share = self.sample_period / self.alarm.memory
        excess = injection**2 / jnp.asarray(self.alarm.power) - power
        return power + share * jnp.mean(score * weight**2 * excess)


def _is_number(values: Array) -> Bool[Array, " channels"]:
    """Neither NaN nor infinite."""
    return jnp.abs(values) <= jnp.finfo(values.dtype).max


def _emptied(kernel: Carry, counts: StepMask) -> Carry:
    """The filter without what it remembers, of outputs that do not count."""

    def emptied(state: Array) -> Array:
        usable = counts.usable.reshape(-1, *(1,) * (state.ndim - 2))
        return jnp.where(usable, state, 0.0)

    filtered = jax.tree.map(emptied, kernel.filtered)
    return eqx.tree_at(lambda carry: carry.filtered, kernel, filtered)


def _checked_alarm(alarm: Alarm | None, ny: int, h: float) -> Alarm | None:
    if alarm is None:
        return None
    check_kind("alarm", alarm, Alarm, "an Alarm or None")
    check_shape("alarm.power", alarm.power, (ny,), "one number an output")
    if not isinstance(alarm.memory, Tracer):
        _check_memory("alarm.memory", real(alarm.memory), h)
    return alarm


def _check_memory(name: str, memory: float, h: float) -> None:
    check(memory >= h, name, f"must be at least a sample period, {h:g} s", memory)


def online_estimator(
    result: Identification,
    records: Record | Sequence[Record],
    *,
    forgetting: float = 1.0,
    memory: float | None = None,
    false_alarms: float | None = 1.0 / 3600.0,
) -> OnlineEstimator:
    """The estimator of an identification, for a loop in real time with the records' sampling.

    Args:
        result: of `identify`: model, observer and filter.
        records: as measured, all with one sample period; their injection is what is left where the
            model holds, so that the alarm asks whether there is more. An input is held between the
            samples where all records hold it, else it goes in straight lines: nothing that needs
            the next samples, as a smooth input does, is known in real time (`hold` says which).
        forgetting: λ of the recursion: it remembers about 1/(1 - λ) samples.
        memory: time over which the alarm takes the injection's power [s]; None: three time
            constants of the filter, 3/ω_c, and no less than the sample period.
        false_alarms: rate of false alarms [1/s], for Gaussian noise; by default one an hour. None:
            an estimator without an alarm.

    Returns:
        The estimator; its `alarm` has the power of the noise and the threshold.

    Raises:
        ValueError: no estimate, records of several sample periods or none that count, too few
            independent samples for an alarm, what `OnlineEstimator` refuses, a rate that is not
            positive, a memory shorter than the sample period.
    """
    check_kind("result", result, Identification, "a result of `identify`")
    rule = "must have an estimate"
    check(result.status.fits, "result", rule, str(result.status))
    check(memory is None or real(memory) > 0, "memory", "must be positive [s]", memory)
    rate = None if false_alarms is None else real(false_alarms)
    check(rate is None or rate > 0, "false_alarms", "must be positive [1/s]", false_alarms)
    plant = result.plant
    used = check_records(plant, records)
    periods = sorted({record.sample_period for record in used})
    equal = np.allclose(periods, periods[0], rtol=1e-9)
    check(equal, "records", "must have one sample period", periods)
    usual = _SETTINGS.memory / real(result.lowpass.cutoff)
    memory = max(usual, periods[0]) if memory is None else real(memory)
    _check_memory("memory", memory, periods[0])
    hold = _hold_of_all(used)
    passes = [
        observe(
            plant, result.observer, None, record.sample_period, record.outputs, record.inputs,
            lowpass=result.lowpass, hold=hold, noise=record.noise, valid=record.output_valid,
        )
        for record in used
    ]  # fmt: skip
    scores = np.concatenate([np.asarray(part.score) for part in passes])
    lost = _lost_steps(plant, used, scores)
    check(np.all(np.sum(scores, axis=0) > 1), "records", _COUNTS, lost, _FEWER_LOST)
    weights = [np.asarray(part.score * part.weight) for part in passes]
    injections = [
        weight * np.asarray(part.injection) for weight, part in zip(weights, passes, strict=True)
    ]
    power = _sum_of_powers(injections, 2) / _sum_of_powers(weights, 2)
    alarm = None
    if rate is not None:
        lags = int(np.ceil(_SETTINGS.time_constants / (result.lowpass.cutoff * periods[0])))
        correlation = _correlation(injections, lags) / _sum_of_powers(injections, 2)
        independent = _checked_independent(correlation, weights, lost)
        threshold = _threshold(correlation, independent, periods[0], memory, rate)
        alarm = Alarm(power, memory, threshold)
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


_COUNTS = "must have steps that count"
_FEWER_LOST = (
    "Less noise, faster motions or a longer sample period leave more of them: the velocity of one "
    "step has the noise √2 σ/h."
)
_MORE_SAMPLES = (
    "Give longer records or more of them, or take `false_alarms=None`, an estimator without an "
    f"alarm. {_FEWER_LOST}"
)


def _hold_of_all(records: Sequence[Record]) -> Hold:
    """The hold of each input in real time."""
    holds = zip(*(record.holds for record in records), strict=True)
    return shared(["zero" if set(words) == {"zero"} else "linear" for words in holds])


def _lost_steps(
    plant: Plant, records: Sequence[Record], scores: Float[np.ndarray, "steps ny"]
) -> str:
    """Share of the steps that count, of the output with the fewest, and what the others lack."""
    shares = np.mean(scores, axis=0)
    output = int(np.argmin(shares))
    text = f"{shares[output]:.2g} of the steps of {plant.outputs[output]} count"
    rubbing = np.flatnonzero(np.asarray(plant.jumps)[output])
    if not rubbing.size:
        return f"{text}, behind the transient and gaps"
    noise = np.max([velocity_noise(plant.degrees, record, False) for record in records], axis=0)
    speeds = " and ".join(
        f"{SETTINGS.certainty * noise[j]:.2g} of {plant.outputs[j]}" for j in rubbing
    )
    return (
        f"{text}, those away from velocities below {speeds}, "
        f"{SETTINGS.certainty:g} standard deviations of their noise, where the direction of dry "
        "friction is not certain"
    )


def _sum_of_powers(
    signals: Sequence[Float[np.ndarray, "time ny"]], power: int
) -> Float[np.ndarray, " ny"]:
    return np.sum([np.sum(signal**power, axis=0) for signal in signals], axis=0)


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


def _squares(correlation: Float[np.ndarray, "lags ny"]) -> Float[np.ndarray, "lags ny"]:
    """c_l², both signs of a lag together."""
    return np.where(np.arange(len(correlation)) == 0, 1.0, 2.0)[:, None] * correlation**2


def _independent(
    correlation: Float[np.ndarray, "lags ny"], counts: Float[np.ndarray, " ny"]
) -> float:
    """N of all outputs together, for the number n of each."""
    return float(np.sum(counts / np.sum(_squares(correlation), axis=0)))


def _checked_independent(
    correlation: Float[np.ndarray, "lags ny"],
    weights: Sequence[Float[np.ndarray, "time ny"]],
    lost: str,
) -> float:
    """N, once it is enough for an alarm; `lost` says why it may be small."""
    squares, least = _sum_of_powers(weights, 2), _SETTINGS.min_independent
    weighed = _independent(correlation, squares)
    rule = f"must hold at least {least:g} independent samples of the injection for an alarm"
    check(weighed >= least, "records", rule, f"{weighed:.2g}: {lost}", _MORE_SAMPLES)
    return _independent(correlation, squares**2 / _sum_of_powers(weights, 4))


def _threshold(
    correlation: Float[np.ndarray, "lags ny"],
    independent: float,
    period: float,
    memory: float,
    rate: float,
) -> float:
    """Of s, for a rate of false alarms; equations in the docstring of the module."""
    from scipy.optimize import root_scalar
    from scipy.stats import f, norm

    share = period / memory
    decay = (1.0 - share) ** np.arange(len(correlation))[:, None]
    variances = 2.0 * share / (2.0 - share) * np.sum(decay * _squares(correlation), axis=0)
    variance = np.sum(variances) / len(variances) ** 2

    def excess(deviation: float) -> float:
        return float(2.0 * np.log(deviation) + norm.logsf(deviation) - np.log(rate * memory))

    low, high = _SETTINGS.deviations
    deviation = low if excess(low) <= 0.0 else float(root_scalar(excess, bracket=(low, high)).root)
    return float(f.isf(norm.sf(deviation), 2.0 / variance, independent))
