r"""How errors of an estimated start grow along a record: whether a whole free run says anything.

The start of a run is known from its first samples only. With the model linearised along the
measured signals, $\Phi_k$ from the start to sample k and $C$ the outputs over their spread, $n$
samples of equally large noise leave the start with the covariance
$P = (\sum_{k<n} \Phi_k^\top C^\top C \Phi_k)^{-1}$, and the free run at sample k with an error of
$g_k = (C \Phi_k P \Phi_k^\top C^\top)^{1/2}$ times the noise. Of a stable plant g stays below about
one; it grows with $e^{\lambda t}$ of an unstable mode, and with time of an integrator. Errors of
the parameters enter later and grow in the same way. Where g is large a free run is lost, and
windows are as long as g stays small.

Derivation: variance of a prediction by linear least squares, L. Ljung, *System Identification*,
2nd ed., appendix II; $\Phi$ is the transition matrix of W. J. Rugh, *Linear System Theory*, ch. 3.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.linalg import expm

from eoi_jax._checks import counted
from eoi_jax.compiler.pointwise import along
from eoi_jax.data.record import Record
from eoi_jax.data.windows import start_samples
from eoi_jax.models.jacobians import driven
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.rates import rate_of


@dataclass(frozen=True)
class GrowthRules:
    """When free runs are cut into windows, and into which.

    Attributes:
        lost: error of a free run over the spread of its output, from which on it says nothing.
        growing: errors over the noise that the start of a run ends with, from which on the run is
            one in which errors grow. Of a stable plant they stay below about one.
        window: the same at the end of a window. From there on the error of the start is more than
            what is estimated from; longer runs are sharper, but forgive less.
        settled: change of the length of windows, relative, that is not worth another fit.
        instants: number of samples of a record at which the model is linearised.
        starts: runs along a record by which growth is judged.
        steps: lengths of a run at which it is looked at, about.
        quantile: over these runs; the plant need not be as unstable everywhere.
        exponent: length of a window at most, and of a record at least that is cut into windows, in
            time constants of the fastest unstable mode: an error grows by e⁴ = 55. With many
            samples a time constant starts are known so well that g alone would allow more, but
            errors of the parameters grow too.
        fewest: samples of a window at least, times the number of states.
        head: share of a window from which its start is estimated where it is judged.
        extension: factor by which windows of a fit are longer at its end: parameters are then near
            enough for errors that grow by e⁸, and late samples tell more of them.
        hopeless: growth in whole runs from which on no fit of them is tried where they are lost:
            their cost is then full of minima, and its slopes are lost in rounding.
        risen: rms residual, relative, by which longer windows show that the model is not exact.
        unseen: share of the information of a start below which a direction of it leaves no trace.
        returning: time constants of the slowest mode, in a record, from which on the plant returns:
            an unknown constant force has then moved it by 98 % of what it ever will.
    """

    lost: float = 1.0
    growing: float = 10.0
    window: float = 3.0
    settled: float = 0.5
    instants: int = 500
    starts: int = 16
    steps: int = 2000
    quantile: float = 0.9
    exponent: float = 4.0
    fewest: float = 4.0
    head: float = 0.5
    extension: float = 2.0
    hopeless: float = 1e6
    risen: float = 0.02
    unseen: float = 1e-10
    returning: float = 4.0


RULES = GrowthRules()


@dataclass(frozen=True)
class ErrorGrowth:
    """How far a model can be simulated from an estimated start.

    Attributes:
        largest: error over the noise that the start of a whole run ends with, at most.
        window: length [s] of runs in which it stays small; infinite if it does in all.
        rate: of the fastest unstable mode [1/s]; 0 where errors do not grow.
        shortest: length of the shortest windows [s].
    """

    largest: float
    window: float
    rate: float = 0.0
    shortest: float = 0.0

    @property
    def growing(self) -> bool:
        """Whether errors of a start grow so that a whole free run may be lost by them."""
        return not self.largest < RULES.growing

    @property
    def leaves_no_window(self) -> bool:
        """Whether errors of a start grow beyond any use in the shortest windows, too."""
        return bool(self.rate * self.shortest > np.log(RULES.hopeless))

    def cuts(self, records: Sequence[Record]) -> bool:
        """Whether windows of this length cut some record into several."""
        return any(len(record) * record.sample_period > 1.5 * self.window for record in records)


def error_growth(
    plant: Plant, records: Sequence[Record], initial_samples: int | None = None
) -> ErrorGrowth:
    """Growth along the record where it is the largest.

    Args:
        plant: with its parameter values.
        records: of its inputs and outputs; internal states are where the plant starts them.
        initial_samples: from which a start is estimated; None: as `validate` does by default.
    """
    growths = [_along(plant, record.bridged, initial_samples) for record in records]
    states = sum(plant.degrees) + len(plant.initial_internal)
    shortest = RULES.fewest * states * max(record.sample_period for record in records)
    return ErrorGrowth(
        max(growth.largest for growth in growths),
        max(min(growth.window for growth in growths), shortest),
        max(growth.rate for growth in growths),
        shortest,
    )


def returns(plant: Plant, records: Sequence[Record]) -> bool:
    """Whether what the model lacks displaces a plant by so much, and no further.

    Its whole free runs then show what is missing, however large their errors are. An integrator,
    or a time constant as long as the records, sums up what is missing from the start to the end.

    Args:
        plant: with its parameter values.
        records: of its inputs and outputs.
    """
    for record in records:
        bridged = record.bridged
        index = np.linspace(0, len(bridged) - 1, RULES.instants).astype(int)
        slopes, _ = _linearised(plant, bridged, index)
        if not np.all(np.isfinite(slopes)):
            return False
        slowest = np.min(np.abs(np.linalg.eigvals(slopes)), axis=1)
        duration = len(bridged) * bridged.sample_period
        if np.median(slowest) * duration < RULES.returning:
            return False
    return True


def window_head(window: float, plant: Plant, records: Sequence[Record]) -> int:
    """Samples from which the start of a window is estimated, none of which is scored.

    As many in all records: a share of the window, or of the shortest run where a record, or what
    lies between two gaps of its inputs, is shorter than the window.

    Args:
        window: its length [s].
        plant: to judge.
        records: on these.
    """
    runs = [max(stop - start for start, stop in record.input_segments()) for record in records]
    count = min(window / max(record.sample_period for record in records), *runs)
    return max(round(RULES.head * count), plant.rows + len(plant.initial_internal) + 1)


def is_lost(error: Float[np.ndarray, " ny"], spread: Float[np.ndarray, " ny"]) -> bool:
    """Whether free runs say nothing of some output.

    Args:
        error: rms of y − ŷ; not finite where a run diverges.
        spread: standard deviation of y.
    """
    return not bool(np.all(error < RULES.lost * spread))


def restarted(count: int, growth: ErrorGrowth, subject: str, window: float | None = None) -> str:
    """A sentence on runs in windows, and why.

    Args:
        count: number of runs.
        growth: of errors in whole runs.
        subject: what is done with the runs, for example "Fitted".
        window: length of the runs [s]; None: as the growth asks for.
    """
    size = f"grows to {growth.largest:.2g} times the noise" if growth.growing else "ends it"
    return (
        f"{subject} in {counted(count, 'window')} of {window or growth.window:.3g} s, each from a "
        "state of its own: the plant is unstable, and a whole free run says nothing, for the "
        f"error of its start {size}."
    )


def _along(plant: Plant, record: Record, initial_samples: int | None) -> ErrorGrowth:
    count, period = len(record), record.sample_period
    head = min(initial_samples or start_samples(record, plant.rows), count)
    index = np.linspace(0, count - 1, RULES.instants).astype(int)
    slopes, outputs = _linearised(plant, record, index)
    spread = np.std(record.outputs, axis=0)
    rows = outputs / np.where(spread > 0, spread, 1.0)[:, None]
    if not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(rows))):
        return ErrorGrowth(0.0, np.inf)
    rates = np.max(np.linalg.eigvals(slopes).real, axis=1)
    if np.quantile(rates, RULES.quantile) * count * period < RULES.exponent:
        return ErrorGrowth(0.0, np.inf)  # an integrator too: whole runs can be fitted
    nearest = np.minimum(np.searchsorted(index, np.arange(count)), len(index) - 1)
    firsts = np.unique(np.linspace(0, max(count - 2 * head, 0), RULES.starts).astype(int))
    with np.errstate(over="ignore", invalid="ignore"):
        lags, growth = _grown(slopes, rows, nearest, firsts, head, period)
    (beyond,) = np.nonzero(~(growth <= RULES.window))
    window = lags[beyond[0]] * period if len(beyond) else np.inf
    fastest = float(np.quantile(rates, RULES.quantile))
    if fastest > 0:
        window = min(window, RULES.exponent / fastest)
    largest = float(np.max(np.where(np.isfinite(growth), growth, np.inf)))
    return ErrorGrowth(largest, float(window), max(fastest, 0.0))


def _grown(
    slopes: Float[np.ndarray, "instants states states"],
    rows: Float[np.ndarray, "instants ny states"],
    nearest: np.ndarray,
    firsts: np.ndarray,
    head: int,
    period: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Lags [samples] of a run, and g there: of the worst output, a quantile over the runs.

    Args:
        slopes: Jacobians of the rates at some instants.
        rows: of the outputs over their spread.
        nearest: instant of each sample.
        firsts: first samples of the runs.
        head: samples from which their starts are estimated.
        period: of the samples [s].
    """
    count, size = len(nearest), slopes.shape[1]
    stride = max((count - head) // RULES.steps, 1)
    one, several = expm(slopes * period), expm(slopes * (period * stride))
    # States in units of what they do to the outputs in a head: the information is then regular.
    transition = np.broadcast_to(np.eye(size), (len(firsts), size, size))
    seen = []
    for k in range(head):
        at = nearest[np.minimum(firsts + k, count - 1)]
        seen.append(rows[at] @ transition)
        transition = one[at] @ transition
    stacked = np.concatenate(seen, axis=1)
    length = np.linalg.norm(stacked, axis=1)
    length = np.where(length > 0, length, 1.0)
    information = np.swapaxes(stacked, 1, 2) @ stacked / (length[:, :, None] * length[:, None, :])
    values, vectors = np.linalg.eigh(information)
    traced = values > RULES.unseen * values[:, -1:]
    root = vectors * np.where(traced, 1.0 / np.sqrt(np.where(traced, values, 1.0)), 0.0)[:, None]
    transition = transition @ (root / length[:, :, None])
    lags, growth = [], []
    for lag in range(head, count - firsts[0], stride):
        running = firsts + lag < count
        at = nearest[firsts[running] + lag]
        error = np.linalg.norm(rows[at] @ transition[running], axis=2)
        lags.append(lag)
        growth.append(np.quantile(np.max(error, axis=1), RULES.quantile))
        if not np.isfinite(growth[-1]):
            break
        transition[running] = several[at] @ transition[running]
    return np.asarray(lags), np.asarray(growth)


def _linearised(
    plant: Plant, record: Record, index: np.ndarray
) -> tuple[Float[np.ndarray, "instants states states"], Float[np.ndarray, "instants ny states"]]:
    """Jacobians of dx/dt and of the outputs with the states, along measured signals."""
    signals = [record.outputs]
    for _ in range(1, plant.relative_degree):
        signals.append(np.gradient(signals[-1], record.sample_period, axis=0))
    acted_inputs = np.asarray(driven(plant, record.time, record.inputs))
    rows = record.time[index], np.stack(signals, axis=1)[index], acted_inputs[index]
    slopes, outputs = along(_slopes, ("fixed", "rows"), plant, rows)
    states = [row * len(plant.outputs) + j
              for j, degree in enumerate(plant.degrees) for row in range(degree)]  # fmt: skip
    states += list(range(plant.rows * len(plant.outputs), slopes.shape[1]))
    return slopes[:, states][:, :, states], outputs[:, :, states]


def _slopes(plant: Plant, row: tuple[Any, ...]) -> tuple[Array, Array]:
    """Jacobians of dx/dt and y with x: outputs with their derivatives first, then z."""
    t, y, u = row
    theta = jnp.asarray(plant.theta)

    def rate(x: Array) -> tuple[Array, Array]:
        state = State(jnp.reshape(x[: y.size], y.shape), x[y.size :])
        slope = rate_of(plant, theta, t, state, u)
        flat = jnp.concatenate([jnp.ravel(slope.y), slope.z])
        return flat, plant.output(t, state, u, theta)

    return jax.jacfwd(rate)(jnp.concatenate([jnp.ravel(y), plant.internal_start(theta)]))
