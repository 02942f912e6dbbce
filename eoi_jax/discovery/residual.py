r"""The thinned residual of an estimate, and its expected spectrum if it were noise alone.

Under the null hypothesis (the model is right, the measurement noise n is white) the residual is
known up to its size. It is not white. With the model linearised along the record it is

    e = F[n^(r) - Σ_m (∂f/∂y^(m)) n^(m)],        spectrum |F|² |(iω)^r - Σ_m a_m (iω)^m|² σ² h

less what n does to internal states, which the measured outputs drive (`internal_response`).

Differentiated r times, white noise is negatively correlated (its spectrum rises as ω^2r), and F
correlates neighbouring samples. Two samples per half period of the cut-off (a step of π/2ω_c) are
kept.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Complex, Float, Int

from eoi_jax.compiler.pointwise import along
from eoi_jax.data.record import Record
from eoi_jax.data.recursion import states
from eoi_jax.estimation.defaults import default_substeps, output_noise, velocity_noise
from eoi_jax.estimation.engines.single import single_pass
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.estimation.preparation import at_samples, prepare_steps, step_inputs
from eoi_jax.estimation.regression.noise_autocorrelation import ORDER
from eoi_jax.estimation.within_samples import resampled
from eoi_jax.models.jacobians import driven, internal_response, state_slopes
from eoi_jax.models.plant import Plant, State

PerOutput = Float[np.ndarray, " ny"]

_DELAYS = 32  # number of delays tested, up to one period of the cut-off
_SLOPES = 400  # samples at which the model is linearised


class View(NamedTuple):
    """One record prepared for the tests; n thinned samples of N.

    Attributes:
        residual: (N, ny), NaN where not scored.
        Phi: F[φ], (N, ny, np).
        thin: samples per thinned sample.
        variables: F of y, its derivatives and u, and time, thinned, (n, variables).
        inputs: F[u], thinned, (n, nu).
        delays: the delays tested [samples].
        late: F[f(delayed u) - f(u)], thinned, (n, ny, nu, delays).
        null: autocovariance of the residual under the null hypothesis at thinned lags, (ny, lags).
        samples_per_independent: samples per independent sample in the mean square, (ny,).
    """

    record: Record
    residual: np.ndarray
    Phi: np.ndarray
    thin: int
    variables: np.ndarray
    inputs: np.ndarray
    delays: np.ndarray
    late: np.ndarray
    null: np.ndarray
    samples_per_independent: np.ndarray

    def thinned(self, j: int) -> Float[np.ndarray, " n"]:
        """The residual of output j, thinned."""
        return self.residual[:: self.thin, j]


def views_of(identification: Identification) -> tuple[list[View], PerOutput]:
    """All records prepared for the tests, and the floor that the discretisation sets."""
    plant, lowpass = identification.plant, identification.lowpass
    explicit = identification.observer.scheme == "explicit"
    records = identification.records
    substeps = 1 if explicit else default_substeps(plant, records, lowpass.cutoff)[0]
    sums, Phi = _regressors(identification, substeps)
    observed = np.sqrt(sums.observed_square / np.maximum(sums.weight, 1e-300))
    step = lowpass.cutoff * max(record.sample_period for record in records) / substeps
    views = []
    for record, residual, phi in zip(records, identification.residual, Phi, strict=True):
        h = record.sample_period
        thin = max(round(0.5 * np.pi / (lowpass.cutoff * h)), 1)
        time, states, inputs = _measured_signals(plant, record)
        gain = _gain(lowpass, record, substeps, thin)
        null, samples_per_independent = _null_covariance(
            _noise_moments(plant, time, states, inputs),
            internal_response(plant, time, states, inputs, gain.derivative),
            # Samples that are further apart have as much noise in a narrower band.
            raw_noise(plant, record) * np.sqrt(record.output_periods / h),
            gain,
            thin,
        )
        flat = np.concatenate([*_state_columns(plant, states), inputs], axis=1)
        filtered = _filtered(lowpass.discretise(h), flat - flat[0]) + flat[0]
        thinned = np.concatenate([flat[:1], filtered])[::thin]
        max_delay = max(2.0 * np.pi / (lowpass.cutoff * h), 2.0)
        delays = np.linspace(1.0, max_delay, _DELAYS).round().astype(int)
        views.append(
            View(
                record,
                np.asarray(residual),
                phi,
                thin,
                np.concatenate([thinned, record.time[::thin, None]], axis=1),
                thinned[:, flat.shape[1] - len(plant.inputs) :],
                delays,
                _late(plant, lowpass.discretise(h), time, states, inputs, delays, thin),
                null,
                samples_per_independent,
            )
        )
    return views, np.where(plant.algebraic, 0.0, step**2 / 6.0 * observed)


def _regressors(
    identification: Identification, substeps: int
) -> tuple[Any, list[Float[np.ndarray, "time ny np"]]]:
    """Sums of one iteration at the estimate, and F[φ] at the samples of each record."""
    plant, lowpass = identification.plant, identification.lowpass
    observer, records = identification.observer, identification.records
    explicit = observer.scheme == "explicit"
    fine = tuple(resampled(plant, record, substeps) for record in records)
    noise = [
        velocity_noise(plant.degrees, record, min(record.smoothed, default=False))
        / record.noise_left
        for record in records
    ]
    steps = prepare_steps(
        plant,
        fine,
        [step_inputs(record, explicit) for record in fine],
        len(np.atleast_2d(np.asarray(observer.kernel))[0]),
        0.0,
        lowpass.memory,
        noise,
        explicit,
        2.0 / lowpass.cutoff,
        substeps=substeps,
    )
    sampled = [lowpass.discretise(record.sample_period) for record in fine]
    filters = jax.tree.map(lambda *leaves: np.stack(leaves), *sampled)
    one_pass = single_pass(plant, observer, filters, steps)
    sums, trace = one_pass(np.asarray(plant.theta), "signals")
    sums = jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums)
    arrays = []
    for i, record in enumerate(records):
        ends = slice(substeps - 1, (len(record) - 1) * substeps, substeps)
        assert trace is not None
        arrays.append(at_samples(plant, np.asarray(trace.Phi)[i, ends]))
    return sums, arrays


def _measured_signals(
    plant: Plant, record: Record
) -> tuple[
    Float[np.ndarray, " steps"], Float[np.ndarray, "steps r ny"], Float[np.ndarray, "steps nu"]
]:
    """Time, measured outputs with their central differences, and inputs, mid-step."""
    rows = [record.outputs]
    for order in range(1, plant.relative_degree):
        rate = np.gradient(rows[-1], record.sample_period, axis=0)
        rows.append(rate * (np.asarray(plant.degrees) > order))
    states = np.stack(rows, axis=1)
    time = record.time[:-1] + 0.5 * record.sample_period
    return time, 0.5 * (states[1:] + states[:-1]), record.midpoint_inputs()


def _state_columns(
    plant: Plant, states: Float[np.ndarray, "steps r ny"]
) -> list[Float[np.ndarray, "steps 1"]]:
    """Outputs and those derivatives that are states of the model."""
    return [states[:, m, [j]] for j, degree in enumerate(plant.degrees) for m in range(degree)]


def variable_names(plant: Plant) -> list[str]:
    """Names of the variables, in the order of `View.variables`."""
    outputs = zip(plant.outputs, plant.degrees, strict=True)
    states = [name + "′" * m for name, degree in outputs for m in range(degree)]
    return [*states, *plant.inputs, "time"]


def _filtered(
    lowpass: DiscreteFilter, columns: Float[np.ndarray, "steps c"]
) -> Float[np.ndarray, "steps c"]:
    """F of each column."""
    return states(np.asarray(lowpass.transition), np.asarray(lowpass.entry), columns)[:, 0]


def _changed(plant: Plant, row: tuple[Any, ...], other_input: Any) -> Any:
    """f with another input, minus f."""
    t, y, u = row
    theta = jnp.asarray(plant.theta)
    x = State(y, plant.internal_start(theta))
    return plant.derivative(t, x, other_input, theta) - plant.derivative(t, x, u, theta)


def _late(
    plant: Plant,
    lowpass: DiscreteFilter,
    time: Float[np.ndarray, " steps"],
    measured: Float[np.ndarray, "steps r ny"],
    inputs: Float[np.ndarray, "steps nu"],
    delays: Int[np.ndarray, " delays"],
    thin: int,
) -> Float[np.ndarray, "n ny nu delays"]:
    """F of the change of the model output if one of the inputs were delayed."""
    blocks, index = [], np.arange(len(inputs))
    for k in range(inputs.shape[1]):
        delayed = np.repeat(inputs[None], len(delays), axis=0)
        for row, delay in zip(delayed, delays, strict=True):
            row[:, k] = inputs[np.maximum(index - delay, 0), k]
        rows = (time, measured, driven(plant, time, inputs))
        late_inputs = np.stack([driven(plant, time, delayed_input) for delayed_input in delayed])
        change = along(_changed, ("fixed", "rows", "grid rows"), plant, rows, late_inputs)
        columns = np.moveaxis(np.nan_to_num(change), 0, -1).reshape(len(index), -1)
        filtered = _filtered(lowpass, columns)
        filtered = np.concatenate([np.zeros_like(filtered[:1]), filtered])[::thin]
        blocks.append(filtered.reshape(len(filtered), -1, len(delays)))
    empty = np.zeros((len(index) // thin + 1, len(plant.outputs), 0, len(delays)))
    return np.stack(blocks, axis=2) if blocks else empty


def raw_noise(plant: Plant, record: Record) -> PerOutput:
    """Standard deviation of the white noise, before any smoothing [unit of y]."""
    return output_noise(plant, record) / record.noise_left


def _noise_moments(
    plant: Plant,
    time: Float[np.ndarray, " steps"],
    states: Float[np.ndarray, "steps r ny"],
    inputs: Float[np.ndarray, "steps nu"],
) -> tuple[Float[np.ndarray, "ny ny r1"], Float[np.ndarray, "ny ny r1 r1"]]:
    """Means of c and of c cᵀ, where Σ_m c_m n^(m) is what noise n in output j adds to residual i.

    c is one at the degree of output i = j, minus ∂f_i/∂y_j^(m); averaged over up to 400 samples.
    """
    picked = np.linspace(0, len(time) - 1, min(len(time), _SLOPES)).astype(int)
    slopes = np.asarray(state_slopes(plant, time[picked], states[picked], inputs[picked]))
    ny, r = len(plant.outputs), plant.rows
    c = np.zeros((len(picked), ny, ny, r + 1))
    c[..., :r] = -np.swapaxes(np.nan_to_num(slopes, posinf=0.0, neginf=0.0), 2, 3)
    c[:, np.arange(ny), np.arange(ny), np.asarray(plant.degrees)] += 1.0
    return np.mean(c, axis=0), np.mean(c[..., :, None] * c[..., None, :], axis=0)


class _Gain(NamedTuple):
    """Derivative operator and |F|² (with smoothing) on the grid of a real FFT."""

    derivative: np.ndarray
    power: np.ndarray


def _gain(lowpass: Any, record: Record, substeps: int, thin: int) -> _Gain:
    h = record.sample_period
    size = 2 ** int(np.ceil(np.log2(max(8 * thin * (ORDER + 1), 4096))))
    omega = 2.0 * np.pi * np.fft.rfftfreq(size, h)
    fine = h / substeps
    sampled = lowpass.discretise(fine)
    z = np.exp(1j * omega * fine)[:, None, None]
    matrix = z * np.eye(lowpass.order) - np.asarray(sampled.transition)
    response = np.linalg.solve(matrix, np.asarray(sampled.entry)[:, None])[:, 0, 0]
    power = np.abs(response) ** 2
    for cutoff in record.smoothed:  # Butterworth of order four, forward and backward
        warped = np.tan(np.minimum(0.5 * omega * h, 1.55)) / np.tan(0.5 * cutoff * h)
        power = power / (1.0 + warped**8) ** 2
    return _Gain(2j * np.sin(0.5 * omega * fine) / fine, power)


def _null_covariance(
    moments: tuple[Float[np.ndarray, "ny ny r1"], Float[np.ndarray, "ny ny r1 r1"]],
    internal: Complex[np.ndarray, "frequencies ny ny"],
    noise: PerOutput,
    gain: _Gain,
    thin: int,
) -> tuple[Float[np.ndarray, "ny lags"], PerOutput]:
    """Autocovariance of the residual due to white noise, at thinned lags 0 … `ORDER`.

    Also the number of samples per independent sample in the mean square, Σ_k (R_k / R_0)².

    Args:
        moments: of `_noise_moments`.
        internal: what the model takes from each output through its internal states.
        noise: standard deviation in each output.
        gain: of the derivatives and the filter.
        thin: samples per lag.
    """
    mean, square = moments
    powers = gain.derivative[:, None] ** np.arange(mean.shape[-1])
    direct = np.einsum("wa,ija->wij", powers, mean)
    parts = np.einsum("wa,ijab,wb->wij", powers.conj(), square, powers).real
    parts += np.abs(internal) ** 2 - 2.0 * (direct.conj() * internal).real
    density = np.einsum("wij,j->iw", parts, noise**2) * gain.power
    covariance = np.fft.irfft(np.maximum(density, 0.0), axis=1)
    zero = np.maximum(covariance[:, :1], np.finfo(float).tiny)
    samples = np.sum((covariance / zero) ** 2, axis=1)
    return covariance[:, : thin * (ORDER + 1) : thin], np.maximum(samples, 1.0)
