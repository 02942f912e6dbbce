r"""Is what the model leaves over more than noise, and where does it live?

Under the null hypothesis (the model is right, the measurement noise n is white) the residual is
known up to its size. It is not white: with the model linearised along the record it is

    e = F[n^(r) - Σ_m (∂f/∂y^(m)) n^(m)],        spectrum |F|² |(iω)^r - Σ_m a_m (iω)^m|² σ² h

Differentiated r times, white noise is negatively correlated (rising as ω^2r), and F makes
neighbours alike. Both are undone before anything is tested: the residual is *thinned* to two
samples per half period of the cut-off (a step of π/2ω_c), and *whitened* by the linear prediction
that this known spectrum gives. What comes out is white under the null hypothesis, and its size
does not matter. Where the noise is not what is to be told apart (maps), errors of means know of
any correlation (Newey and West).

**Sources.** Ljung and Box, Biometrika 65 (1978) 297; Box and Jenkins, *Time Series Analysis*
(whitening before cross-correlation); Newey and West, Econometrica 55 (1987) 703; Ljung, *System
Identification*, ch. 16 (residual tests, feedback).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax.checks import check
from eoi_jax.data.record import Record
from eoi_jax.data.resample import low_pass_noise
from eoi_jax.identify import Identification
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.passes import run_pass
from eoi_jax.plants.plant import Plant, State
from eoi_jax.prepare import check_records, prepare
from eoi_jax.regression.least_squares import Solution, least_squares, untraced
from eoi_jax.tuning import default_substeps, rate_noise

PerOutput = Float[np.ndarray, " ny"]

_LEVEL = 0.01
_MARGIN = 1.05  # residual over floor (rms) below which the noise estimate itself is in doubt
_CLEAR = 3.0  # noise over what discretisation leaves, from which it alone has a colour
_ORDER = 12  # of the linear predictions that whiten: two memories of F and more
_LAGS = 20  # that are tested, in thinned samples
_FEWEST = 50  # thinned samples for a test
_FORETOLD = 0.3  # correlation with inputs to come from which feedback is suspected
_SHOWN = 0.01  # of the residual's power that a map must explain to be named
_DELAYS = 32  # that are tried, up to one period of the cut-off
_BINS = 20
_WINDOWS = 20
_ALIKE = 0.95  # correlation of two estimates from which they are called confounded
_POOR = 0.01  # of the whole record's excitation, below which a window has none
_UNEVEN = 100.0  # standard error of the worst combination over that of the best
_SLIDING = 0.9
_LEVELS = 500  # of a channel's range: how exactly a value repeats at a stop
_PILE = 10.0  # samples at the extreme over those at the levels next to it


@dataclass(frozen=True)
class Cross:
    """The residual of one output against one input, both whitened.

    Attributes:
        output, input: names.
        lags: [s]; positive where the residual follows the input, in steps of the thinning.
        correlation: at each lag; ± 1.96 / √samples is its 95 % band without a relation.
        p_value: that the largest at lags ≥ 0 is chance, corrected for the number of lags.
        lag: at which it is largest [s].
        future_p_value: the same for lags < 0: inputs that follow the residual.
        delay: by which the input seems to act late [s]; NaN without evidence.
        feedback: whether the input seems to be computed from the output.
    """

    output: str
    input: str
    lags: Float[np.ndarray, " lag"]
    correlation: Float[np.ndarray, " lag"]
    p_value: float
    lag: float
    future_p_value: float
    delay: float
    feedback: bool


@dataclass(frozen=True)
class Map:
    """The residual of one output in bins of equal count of one variable.

    The variable went through the filter F as the residual did, so both belong to one instant.

    Attributes:
        output: whose residual [unit of y^(r)].
        variable: a name; with ′ for each derivative, or ``"time"``.
        centre: mean of the variable in each bin.
        mean: of the residual.
        band: half width of its 95 % band, for coloured residuals.
        statistic: Wald statistic over its degrees of freedom: one if all bins are alike.
        p_value: that all bins are alike.
        explained: share of the residual's power that the bins' means hold.
    """

    output: str
    variable: str
    centre: Float[np.ndarray, " bin"]
    mean: Float[np.ndarray, " bin"]
    band: Float[np.ndarray, " bin"]
    statistic: float
    p_value: float
    explained: float


@dataclass(frozen=True)
class Window:
    """What one stretch of a record says about the parameters.

    Attributes:
        record: name. start, stop: [s].
        excitation: smallest eigenvalue of the information per sample, for parameters scaled so
            that each alone has one over all records; 0 without scored samples.
        poor: whether it is below a hundredth of that of all records together.
    """

    record: str
    start: float
    stop: float
    excitation: float
    poor: bool


@dataclass(frozen=True)
class Confounded:
    """Two parameters whose estimates the data hardly tell apart."""

    first: str
    second: str
    correlation: float


@dataclass(frozen=True)
class Saturation:
    """Samples of a channel piled up at its smallest or largest value."""

    record: str
    channel: str
    level: float
    share: float


@dataclass(frozen=True)
class Diagnosis:
    """What the residual of an estimate tells.

    Attributes:
        findings: sentences, the most important first.
        outputs, inputs: names; `units` by name, `degrees` r of each output.
        level: of significance of every test.
        residual_rms: [unit of y^(r)]; NaN where nothing was scored.
        noise_floor: rms that the record's noise leaves in a residual.
        method_floor: rms that the discretisation may leave.
        more_than_noise: whether the residual is above both.
        whiteness: p-value of the Ljung-Box test of the thinned and whitened residual.
        white: whether that is above `level`, or no test was possible.
        autocorrelation: of the thinned and whitened residual, at lags 1, 2, …
        thinning: samples of each record per thinned sample.
        offset, offset_error: mean of the residual and its standard error.
        cross: one for each output and input.
        maps: for each output against y, its derivatives, u and time.
        strongest: for each output the map that explains most of the residual's power among those
            that are significant, or None.
        excitation: smallest eigenvalue over all records, as in `Window`.
        windows: the records in stretches.
        confounded: pairs of parameters.
        worst_combination: of parameters, in words; "" if all are about equally certain.
        sliding_fraction: share of scored steps in sliding.
        saturation: of inputs and outputs.
        noise, quantum: of each output, the largest over the records [unit of y].
    """

    findings: tuple[str, ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]
    units: dict[str, str]
    degrees: tuple[int, ...]
    level: float
    residual_rms: PerOutput
    noise_floor: PerOutput
    method_floor: PerOutput
    more_than_noise: Bool[np.ndarray, " ny"]
    whiteness: PerOutput
    white: Bool[np.ndarray, " ny"]
    autocorrelation: Float[np.ndarray, "ny lag"]
    thinning: tuple[int, ...]
    offset: PerOutput
    offset_error: PerOutput
    cross: tuple[Cross, ...]
    maps: tuple[Map, ...]
    strongest: tuple[Map | None, ...]
    excitation: float
    windows: tuple[Window, ...]
    confounded: tuple[Confounded, ...]
    worst_combination: str
    sliding_fraction: PerOutput
    saturation: tuple[Saturation, ...]
    noise: PerOutput
    quantum: PerOutput

    def __str__(self) -> str:
        from eoi_jax.report.diagnosis import diagnosis_text

        return diagnosis_text(self)

    def plot(self) -> Any:
        """Maps, correlations and excitation: a matplotlib figure."""
        from eoi_jax.report.diagnosis import diagnosis_figure

        return diagnosis_figure(self)

    def save(self, path: str | Path) -> None:
        """Write to one `.npz` file that `eoi_jax.load` reads back; nothing in it is pickled."""
        from eoi_jax.store import save

        save(self, path)


def diagnose(
    identification: Identification,
    records: Record | Sequence[Record] | None = None,
    *,
    level: float = _LEVEL,
) -> Diagnosis:
    """Whether the residual of an estimate is more than noise, where it lives, what may be wrong.

    Args:
        identification: result of `identify`.
        records: as they were measured, to look for saturation and quantisation; by default those
            of the identification, in which smoothing hides both.
        level: of significance, the chance of a false alarm of each test.

    Returns:
        The evidence; `findings` says it in sentences.

    Raises:
        ValueError: a level outside (0, 0.5), records that do not fit the plant.
    """
    check(0.0 < level < 0.5, "level", "must lie in (0, 0.5)", level)
    plant = identification.plant
    measured = identification.records if records is None else check_records(plant, records)
    views, method_floor = _views(identification)
    excitation, windows, solution = _excitation(identification, views)
    draft = Diagnosis(
        findings=(),
        outputs=plant.outputs,
        inputs=plant.inputs,
        units=plant.units,
        degrees=plant.degrees,
        level=float(level),
        **_residual_tests(plant, views, method_floor, level),
        excitation=excitation,
        windows=windows,
        confounded=_confounded(identification, solution),
        worst_combination=_worst_combination(plant, solution),
        sliding_fraction=identification.sliding_fraction,
        saturation=tuple(one for record in measured for one in _saturations(record)),
        noise=np.max([_raw_noise(record) for record in measured], axis=0),
        quantum=np.max([record.quantum for record in measured], axis=0),
    )
    from eoi_jax.report.diagnosis import findings

    return replace(draft, findings=findings(draft, identification.status))


# -- the signals that the tests need ---------------------------------------------------------


class _View(NamedTuple):
    """One record as the tests see it; n thinned samples of N.

    Attributes:
        residual: (N, ny), NaN where not scored.
        Phi: F[φ], (N, ny, np).
        thin: samples per thinned one.
        variables: F of y, its derivatives and u, and time, thinned, (n, variables).
        inputs: F[u], thinned, (n, nu).
        delays: that are tried [samples].
        late: F[f(u late) - f(u)], thinned, (n, ny, nu, delays).
        null: autocovariance of the residual under the null hypothesis at thinned lags, (ny, lags).
        alike: samples per independent one in its mean square, (ny,).
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
    alike: np.ndarray

    def thinned(self, j: int) -> Float[np.ndarray, " n"]:
        """The residual of output j, thinned."""
        return self.residual[:: self.thin, j]


def _views(identification: Identification) -> tuple[list[_View], PerOutput]:
    """All records as the tests need them, and the floor that the discretisation sets."""
    plant, lowpass = identification.plant, identification.lowpass
    explicit = identification.observer.scheme == "explicit"
    records = identification.records
    substeps = 1 if explicit else default_substeps(records, lowpass.cutoff)[0]
    sums, Phi = _regressors(identification, substeps)
    observed = np.sqrt(sums.observed_square / np.maximum(sums.weight, 1e-300))
    step = lowpass.cutoff * max(record.sample_period for record in records) / substeps
    views = []
    for record, residual, phi in zip(records, identification.residual, Phi, strict=True):
        h = record.sample_period
        thin = max(round(0.5 * np.pi / (lowpass.cutoff * h)), 1)
        time, states, inputs = _along(plant, record)
        null, alike = _null_covariance(
            _noise_moments(plant, time, states, inputs),
            _raw_noise(record),
            _gain(lowpass, record, substeps, thin),
            thin,
        )
        flat = np.concatenate([*_owned(plant, states), inputs], axis=1)
        filtered = _filtered(lowpass.discretise(h), flat - flat[0]) + flat[0]
        kept = np.concatenate([flat[:1], filtered])[::thin]
        furthest = max(2.0 * np.pi / (lowpass.cutoff * h), 2.0)
        delays = np.linspace(1.0, furthest, _DELAYS).round().astype(int)
        views.append(
            _View(
                record,
                np.asarray(residual),
                phi,
                thin,
                np.concatenate([kept, record.time[::thin, None]], axis=1),
                kept[:, flat.shape[1] - len(plant.inputs) :],
                delays,
                _late(plant, lowpass.discretise(h), time, states, inputs, delays, thin),
                null,
                alike,
            )
        )
    return views, step**2 / 6.0 * observed


def _regressors(
    identification: Identification, substeps: int
) -> tuple[Any, list[Float[np.ndarray, "time ny np"]]]:
    """Sums of a pass at the estimate, and F[φ] at the samples of each record."""
    plant, lowpass = identification.plant, identification.lowpass
    observer, records = identification.observer, identification.records
    explicit = observer.scheme == "explicit"
    fine = tuple(record.resample(substeps) for record in records)
    noise = []
    for record in records:
        smoothing = _smoothing(record)
        share = 1.0 if smoothing is None else low_pass_noise(_share(record, smoothing))
        noise.append(rate_noise(record, smoothing or False) / share)
    steps = prepare(
        plant,
        fine,
        len(np.atleast_2d(np.asarray(observer.kernel))[0]),
        0.0,
        lowpass.memory,
        noise,
        explicit,
        2.0 / lowpass.cutoff,
    )
    sampled = [lowpass.discretise(record.sample_period) for record in fine]
    filters = jax.tree.map(lambda *leaves: np.stack(leaves), *sampled)
    sums, trace = run_pass(
        plant, observer, filters, steps, jnp.asarray(plant.theta), store="regressors"
    )
    sums = jax.tree.map(lambda leaf: np.sum(np.asarray(leaf), axis=0), sums)
    arrays = []
    for i, record in enumerate(records):
        ends = slice(substeps - 1, (len(record) - 1) * substeps, substeps)
        Phi = np.asarray(trace.Phi[i, ends])  # type: ignore[union-attr]
        arrays.append(np.concatenate([np.full_like(Phi[:1], np.nan), Phi]))
    return sums, arrays


def _along(
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


def _owned(
    plant: Plant, states: Float[np.ndarray, "steps r ny"]
) -> list[Float[np.ndarray, "steps 1"]]:
    """Outputs and those derivatives that are states of the model."""
    return [states[:, m, [j]] for j, degree in enumerate(plant.degrees) for m in range(degree)]


def _variable_names(plant: Plant) -> list[str]:
    """In the order of `_View.variables`."""
    outputs = zip(plant.outputs, plant.degrees, strict=True)
    states = [name + "′" * m for name, degree in outputs for m in range(degree)]
    return [*states, *plant.inputs, "time"]


@eqx.filter_jit
def _scan(lowpass: DiscreteFilter, columns: Float[Array, "steps c"]) -> Float[Array, "steps c"]:
    def step(state: Any, row: Any) -> tuple[Any, Any]:
        state = lowpass.step(state, row)
        return state, state[0]

    start = jnp.zeros((lowpass.entry.shape[0], columns.shape[1]), columns.dtype)
    return jax.lax.scan(step, start, columns)[1]


def _filtered(
    lowpass: DiscreteFilter, columns: Float[np.ndarray, "steps c"]
) -> Float[np.ndarray, "steps c"]:
    """F of each column."""
    return np.asarray(_scan(lowpass, jnp.asarray(columns)))


@eqx.filter_jit
def _change(plant: Plant, time: Any, states: Any, inputs: Any, others: Any) -> Any:
    """f with other inputs less f, at every step: others (variant, steps, nu)."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def one(t: Any, y: Any, u: Any, other: Any) -> Any:
        x = State(y, z)
        return plant.derivative(t, x, other, theta) - plant.derivative(t, x, u, theta)

    along = jax.vmap(one)
    return jax.vmap(lambda other: along(time, states, inputs, other))(others)


def _late(
    plant: Plant,
    lowpass: DiscreteFilter,
    time: Float[np.ndarray, " steps"],
    states: Float[np.ndarray, "steps r ny"],
    inputs: Float[np.ndarray, "steps nu"],
    delays: Int[np.ndarray, " delays"],
    thin: int,
) -> Float[np.ndarray, "n ny nu delays"]:
    """F of what the model would change by if one of its inputs came late."""
    late, index = [], np.arange(len(inputs))
    for k in range(inputs.shape[1]):
        others = np.repeat(inputs[None], len(delays), axis=0)
        for row, delay in zip(others, delays, strict=True):
            row[:, k] = inputs[np.maximum(index - delay, 0), k]
        change = np.asarray(_change(plant, time, states, inputs, others))
        columns = np.moveaxis(np.nan_to_num(change), 0, -1).reshape(len(index), -1)
        filtered = _filtered(lowpass, columns)
        filtered = np.concatenate([np.zeros_like(filtered[:1]), filtered])[::thin]
        late.append(filtered.reshape(len(filtered), -1, len(delays)))
    empty = np.zeros((len(index) // thin + 1, len(plant.outputs), 0, len(delays)))
    return np.stack(late, axis=2) if late else empty


# -- the null hypothesis ---------------------------------------------------------------------


def _smoothing(record: Record) -> float | None:
    """Cut-off of the smoothing that a record went through [rad/s], from what it says itself."""
    found = [re.search(r"zero-phase low-pass, (\S+) rad/s", note) for note in record.notes]
    cutoffs = [float(one.group(1)) for one in found if one]
    return min(cutoffs) if cutoffs else None


def _share(record: Record, cutoff: float) -> float:
    """A cut-off as a fraction of the Nyquist frequency."""
    return cutoff * record.sample_period / np.pi


def _raw_noise(record: Record) -> PerOutput:
    """Standard deviation of the white noise, before any smoothing [unit of y]."""
    smoothing = _smoothing(record)
    left = 1.0 if smoothing is None else low_pass_noise(_share(record, smoothing))
    return record.noise / left


def _noise_moments(
    plant: Plant,
    time: Float[np.ndarray, " steps"],
    states: Float[np.ndarray, "steps r ny"],
    inputs: Float[np.ndarray, "steps nu"],
) -> Float[np.ndarray, "ny ny r1 r1"]:
    """Mean of c cᵀ, where Σ_m c_m n^(m) is what noise n in output j adds to residual i.

    c is one at the degree of output i = j, less ∂f_i/∂y_j^(m); taken at up to 400 samples.
    """
    picked = np.linspace(0, len(time) - 1, min(len(time), 400)).astype(int)
    slopes = np.asarray(_slopes(plant, time[picked], states[picked], inputs[picked]))
    ny, r = len(plant.outputs), plant.relative_degree
    c = np.zeros((len(picked), ny, ny, r + 1))
    c[..., :r] = -np.swapaxes(np.nan_to_num(slopes, posinf=0.0, neginf=0.0), 2, 3)
    c[:, np.arange(ny), np.arange(ny), np.asarray(plant.degrees)] += 1.0
    return np.mean(c[..., :, None] * c[..., None, :], axis=0)


@eqx.filter_jit
def _slopes(plant: Plant, time: Any, states: Any, inputs: Any) -> Any:
    """∂f/∂y at every sample, (samples, ny, r, ny)."""
    theta = jnp.asarray(plant.theta)
    z = plant.internal_start(theta)

    def one(t: Any, y: Any, u: Any) -> Any:
        return jax.jacfwd(lambda value: plant.derivative(t, State(value, z), u, theta))(y)

    return jax.vmap(one)(time, states, inputs)


class _Gain(NamedTuple):
    """Derivative operator and |F|² (with smoothing) on the grid of a real FFT."""

    derivative: np.ndarray
    power: np.ndarray


def _gain(lowpass: Any, record: Record, substeps: int, thin: int) -> _Gain:
    h = record.sample_period
    size = 2 ** int(np.ceil(np.log2(max(8 * thin * (_ORDER + 1), 4096))))
    omega = 2.0 * np.pi * np.fft.rfftfreq(size, h)
    fine = h / substeps
    sampled = lowpass.discretise(fine)
    z = np.exp(1j * omega * fine)[:, None, None]
    matrix = z * np.eye(lowpass.order) - np.asarray(sampled.transition)
    response = np.linalg.solve(matrix, np.asarray(sampled.entry)[:, None])[:, 0, 0]
    power = np.abs(response) ** 2
    smoothing = _smoothing(record)
    if smoothing is not None:  # Butterworth of order four, forward and backward
        warped = np.tan(np.minimum(0.5 * omega * h, 1.55)) / np.tan(0.5 * smoothing * h)
        power = power / (1.0 + warped**8) ** 2
    return _Gain(2j * np.sin(0.5 * omega * fine) / fine, power)


def _null_covariance(
    moments: Float[np.ndarray, "ny ny r1 r1"], noise: PerOutput, gain: _Gain, thin: int
) -> tuple[Float[np.ndarray, "ny lags"], PerOutput]:
    """Autocovariance of the residual that white noise leaves, at thinned lags 0 … `_ORDER`.

    Also how many samples make one independent one in the mean square, Σ_k (R_k / R_0)².
    """
    mixed = np.einsum("ijab,j->iab", moments, noise**2)
    powers = gain.derivative[:, None] ** np.arange(moments.shape[-1])
    density = np.einsum("wa,iab,wb->iw", powers.conj(), mixed, powers).real * gain.power
    covariance = np.fft.irfft(np.maximum(density, 0.0), axis=1)
    zero = np.maximum(covariance[:, :1], np.finfo(float).tiny)
    alike = np.sum((covariance / zero) ** 2, axis=1)
    return covariance[:, : thin * (_ORDER + 1) : thin], np.maximum(alike, 1.0)


def _prediction(covariance: Float[np.ndarray, " lags"]) -> Float[np.ndarray, " order"]:
    """Linear prediction from the last `_ORDER` samples, from an autocovariance."""
    from scipy.linalg import solve_toeplitz

    if covariance[0] <= 0:
        return np.zeros(len(covariance) - 1)
    scaled = covariance / covariance[0]
    first = scaled[:-1].copy()
    first[0] += 1e-9  # a spectrum with zeros has no exact prediction
    return solve_toeplitz(first, scaled[1:])


def _whitened(
    values: Float[np.ndarray, " n"], prediction: Float[np.ndarray, " order"]
) -> Float[np.ndarray, " n"]:
    """Each sample less its prediction; NaN where a sample that this needs is missing."""
    white = values.copy()
    white[: len(prediction)] = np.nan
    for lag, weight in enumerate(prediction, start=1):
        white[lag:] -= weight * values[:-lag]
    return white


# -- tests -----------------------------------------------------------------------------------


def _residual_tests(
    plant: Plant, views: Sequence[_View], method_floor: PerOutput, level: float
) -> dict[str, Any]:
    """Every field of `Diagnosis` that the residual decides."""
    ny = len(plant.outputs)
    rms, floor, excess = np.stack([_size(views, j) for j in range(ny)], axis=1)
    more = (excess > _upper(level)) & (rms > _MARGIN * np.hypot(floor, method_floor))
    # The discretisation's error is small but not white: where it shows, colour says nothing.
    testable = more | (floor > _CLEAR * method_floor)
    whites = [[_white(view, j) for view in views] for j in range(ny)]
    correlations, whiteness = zip(*(_ljung_box(parts) for parts in whites), strict=True)
    whiteness = np.where(testable, whiteness, np.nan)
    offsets = [_offset(views, j) for j in range(ny)]
    maps = [_maps(plant, views, j) for j in range(ny)]
    strongest = [_strongest(maps[j], level, rms[j], method_floor[j]) for j in range(ny)]
    cross = []
    for j in range(ny):
        for k in range(len(plant.inputs)):
            late = _delay(views, j, k, level) if more[j] else (np.nan, 0.0)
            unexplained = 1.0 - (floor[j] / rms[j]) ** 2 if more[j] else np.inf
            delay = late[0] if late[1] > 0.5 * unexplained else np.nan
            white = whites[j] if testable[j] else [np.full_like(one, np.nan) for one in whites[j]]
            cross.append(_cross(plant, views, white, (j, k), delay, level))
    return {
        "residual_rms": rms,
        "noise_floor": floor,
        "method_floor": method_floor,
        "more_than_noise": more,
        "whiteness": whiteness,
        "white": ~(whiteness < level),
        "autocorrelation": np.stack(correlations),
        "thinning": tuple(view.thin for view in views),
        "offset": np.asarray([one[0] for one in offsets]),
        "offset_error": np.asarray([one[1] for one in offsets]),
        "cross": tuple(cross),
        "maps": tuple(one for several in maps for one in several),
        "strongest": tuple(strongest),
    }


def _upper(level: float) -> float:
    """Standard deviations that chance exceeds with probability `level`."""
    from scipy.special import ndtri

    return float(-ndtri(level))


def _size(views: Sequence[_View], j: int) -> tuple[float, float, float]:
    """Rms of the residual, its floor, and by how many deviations of chance it is above that."""
    square = floor = spread = count = 0.0

    def estimated(view: _View) -> float:
        """Of the noise itself: the eighth difference of n samples says as much as n / 3.6 of them.

        C(32, 16) / C(16, 8)² = 3.63, Σ ρ² of the eighth difference of white noise.
        """
        return 3.63 / len(view.record)

    for view in views:
        e = view.residual[:, j]
        scored = np.isfinite(e)
        square += float(np.sum(e[scored] ** 2))
        floor += float(np.sum(scored) * view.null[j, 0])
        part = float(np.sum(scored) * view.null[j, 0])
        spread += 2.0 * part**2 * (view.alike[j] / max(np.sum(scored), 1) + estimated(view))
        count += float(np.sum(scored))
    if not count:
        return np.nan, np.nan, np.nan
    above = (square - floor) / np.sqrt(max(spread, np.finfo(float).tiny))
    return np.sqrt(square / count), np.sqrt(floor / count), above


def _white(view: _View, j: int) -> Float[np.ndarray, " n"]:
    """The thinned residual, whitened and over its deviation under the null hypothesis."""
    prediction = _prediction(view.null[j])
    left = view.null[j, 0] - prediction @ view.null[j, 1:]
    return _whitened(view.thinned(j), prediction) / np.sqrt(max(left, np.finfo(float).tiny))


def _products(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]], lags: Sequence[int]
) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]:
    """Mean of a(t) b(t - lag) over all records, over the root of both powers; and its samples."""
    sums, counts = np.zeros(len(lags)), np.zeros(len(lags))
    powers = [
        sum(float(np.nansum(pair[i] ** 2)) for pair in pairs)
        / max(sum(int(np.sum(np.isfinite(pair[i]))) for pair in pairs), 1)
        for i in (0, 1)
    ]
    for a, b in pairs:
        for i, lag in enumerate(lags):
            product = a[lag:] * b[: max(len(b) - lag, 0)] if lag >= 0 else a[:lag] * b[-lag:]
            good = np.isfinite(product)
            sums[i] += np.sum(product[good])
            counts[i] += np.sum(good)
    size = np.sqrt(powers[0] * powers[1])
    return sums / np.maximum(counts, 1) / (size if size > 0 else 1.0), counts


def _ljung_box(parts: Sequence[np.ndarray]) -> tuple[Float[np.ndarray, " lag"], float]:
    """Autocorrelation of a whitened residual, and the p-value of Σ n (n + 2) / n_k ρ_k².

    Source: Ljung and Box (1978), with n_k pairs at lag k in place of n - k, for gaps.
    """
    from scipy.special import gammaincc

    total = sum(int(np.sum(np.isfinite(part))) for part in parts)
    lags = range(1, _LAGS + 1)
    rho, counts = _products([(part, part) for part in parts], lags)
    if total < _FEWEST:
        return rho, np.nan
    used = np.arange(_LAGS) < total // 5
    statistic = np.sum(((total + 2.0) / total * counts * rho**2)[used])
    return rho, float(gammaincc(0.5 * np.sum(used), 0.5 * statistic))


def _cross(
    plant: Plant,
    views: Sequence[_View],
    whites: Sequence[np.ndarray],
    pair: tuple[int, int],
    delay: float,
    level: float,
) -> Cross:
    """The whitened residual of one output against one whitened input (`pair`)."""
    j, k = pair
    pairs = list(zip(whites, _white_input([view.inputs[:, k] for view in views]), strict=True))
    lags = np.arange(-_LAGS, _LAGS + 1)
    rho, counts = _products(pairs, lags.tolist())
    step = max(view.thin * view.record.sample_period for view in views)
    past = _largest(rho, counts, lags >= 0)
    future = _largest(rho, counts, lags < 0)
    # What a model lacks follows its input; where the input repeats, it also foretells it a little.
    feedback = future[1] < level and abs(future[0]) > max(abs(past[0]), _FORETOLD)
    return Cross(
        plant.outputs[j],
        plant.inputs[k],
        lags * step,
        rho,
        past[1],
        float(lags[past[2]] * step),
        future[1],
        float(delay),
        bool(feedback),
    )


def _white_input(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """An input less its linear prediction from its own past, by least squares.

    Thirty decibels of white noise are assumed beside it: a few sines can be foretold exactly, and
    what is left of them would be rounding.
    """
    parts = [part - np.mean(part) for part in parts]
    rows = [
        np.stack([part[_ORDER - i : len(part) - i] for i in range(_ORDER + 1)], axis=1)
        for part in parts
        if len(part) > _ORDER
    ]
    if not rows:
        return list(parts)
    moments = np.sum([row.T @ row for row in rows], axis=0)
    moments = moments + 1e-3 * moments[0, 0] * np.eye(_ORDER + 1)
    if moments[0, 0] <= 0:
        return [np.full_like(part, np.nan) for part in parts]
    prediction = np.linalg.solve(moments[1:, 1:], moments[1:, 0])
    return [_whitened(part, prediction) for part in parts]


def _largest(rho: np.ndarray, counts: np.ndarray, tested: np.ndarray) -> tuple[float, float, int]:
    """Correlation of the most significant lag, its p-value over all lags tested, and its index."""
    from scipy.special import ndtr

    if np.min(counts[tested]) < _FEWEST:
        return 0.0, np.nan, int(np.argmax(tested))
    strength = np.where(tested, np.abs(rho) * np.sqrt(counts), 0.0)
    index = int(np.argmax(strength))
    chance = 2.0 * ndtr(-strength[index]) * np.sum(tested)
    return float(rho[index]), float(min(chance, 1.0)), index


def _delay(views: Sequence[_View], j: int, k: int, level: float) -> tuple[float, float]:
    """The lateness of input k that explains most of residual j [s], and the share it explains.

    F[f(u late) - f(u)] is projected off F[φ] (other parameters would have hidden a part), and
    the residual regressed on it: the right delay has the coefficient one. NaN if none fits.
    """
    from scipy.special import ndtr

    target, columns, Phi = [], [], []
    for view in views:
        e = view.thinned(j)
        scored = np.isfinite(e)
        target.append(e[scored])
        columns.append(view.late[scored, j, k])
        Phi.append(view.Phi[:: view.thin, j][scored])
    e, late, phi = np.concatenate(target), np.concatenate(columns), np.concatenate(Phi)
    if len(e) < _FEWEST or not np.any(late):
        return np.nan, 0.0
    phi = phi / np.maximum(np.linalg.norm(phi, axis=0), np.finfo(float).tiny)
    both = np.column_stack([late, e])
    both = both - phi @ np.linalg.lstsq(phi, both, rcond=1e-10)[0]
    late, e = both[:, :-1], both[:, -1]
    power = np.maximum(np.sum(late**2, axis=0), np.finfo(float).tiny)
    gain = late.T @ e / power
    explained = gain**2 * power / max(e @ e, np.finfo(float).tiny)
    fits = (gain > 0.5) & (gain < 2.0)
    if not np.any(fits):
        return np.nan, 0.0
    best = int(np.argmax(np.where(fits, explained, 0.0)))
    # Half the thinned samples count: neighbours are still alike.
    strength = np.sqrt(0.5 * len(e) * explained[best] / max(1.0 - explained[best], 1e-12))
    if 2.0 * ndtr(-strength) * len(gain) > level:
        return np.nan, 0.0
    delays = views[0].delays * views[0].record.sample_period
    if best == 0:  # far below the filter's time a delay shows by its size only
        return float(delays[0] * gain[0]), float(explained[0])
    return _peak(delays, explained, best), float(explained[best])


def _peak(x: np.ndarray, values: np.ndarray, best: int) -> float:
    """Where the parabola through the largest value and its neighbours is largest."""
    if best == len(x) - 1 or len(np.unique(x[best - 1 : best + 2])) < 3:
        return float(x[best])
    a, b, _ = np.polyfit(x[best - 1 : best + 2] - x[best], values[best - 1 : best + 2], 2)
    return float(x[best] - b / (2.0 * a)) if a < 0 else float(x[best])


class _Means(NamedTuple):
    """Means by label, and two covariances of them.

    `coloured` is estimated from the values (Newey and West, Bartlett weights), `null` is that of
    noise alone, whose autocovariance is known. What is found must be beyond both: the first knows
    of slow discrepancies, the second is exact if there is none.
    """

    mean: np.ndarray
    coloured: np.ndarray
    null: np.ndarray
    counts: np.ndarray


def _means(views: Sequence[_View], labels: Sequence[np.ndarray], bins: int, j: int) -> _Means:
    """Of the thinned residual of output j, by labels from 0 (−1: none)."""
    groups = [
        (np.nan_to_num(view.thinned(j)), one) for view, one in zip(views, labels, strict=True)
    ]
    inside = [one[:, None] == np.arange(bins) for _, one in groups]
    counts = np.sum([np.sum(one, axis=0) for one in inside], axis=0)
    mean = np.sum([e @ one for (e, _), one in zip(groups, inside, strict=True)], axis=0)
    mean = mean / np.maximum(counts, 1)
    reach = _reach(int(np.sum(counts)))
    coloured, null = np.zeros((2, bins, bins))
    for (e, _), one, view in zip(groups, inside, views, strict=True):
        one = one.astype(float)
        rows = one * (e[:, None] - mean)
        for lag in range(min(reach, len(rows) - 1) + 1):
            ends = len(rows) - lag
            part = (1.0 - lag / (reach + 1.0)) * rows[lag:].T @ rows[:ends]
            coloured += part if lag == 0 else part + part.T
            if lag <= _ORDER:
                part = view.null[j, lag] * one[lag:].T @ one[:ends]
                null += part if lag == 0 else part + part.T
    size = np.maximum(np.outer(counts, counts), 1)
    return _Means(mean, coloured / size, null / size, counts)


def _reach(total: int) -> int:
    """Lags over which values may be alike: those of the noise, more for slower discrepancies."""
    return max(_ORDER, round(0.5 * np.sqrt(total)))


def _offset(views: Sequence[_View], j: int) -> tuple[float, float]:
    """Mean of the residual and its standard error."""
    labels = [np.where(np.isfinite(view.thinned(j)), 0, -1) for view in views]
    means = _means(views, labels, 1, j)
    if not means.counts[0]:
        return np.nan, np.nan
    return float(means.mean[0]), float(np.sqrt(max(means.coloured[0, 0], means.null[0, 0])))


def _maps(plant: Plant, views: Sequence[_View], j: int) -> list[Map]:
    total = sum(int(np.sum(np.isfinite(view.thinned(j)))) for view in views)
    if total < _FEWEST:
        return []
    freedom = 1.5 * total / _reach(total)  # of a Bartlett window
    bins = int(np.clip(freedom / 8.0, 3, _BINS))
    maps = []
    for c, name in enumerate(_variable_names(plant)):
        values = [view.variables[:, c] for view in views]
        one = _map((plant.outputs[j], name), views, values, j, bins, freedom)
        maps += [one] if one else []
    return maps


def _map(
    names: tuple[str, str],
    views: Sequence[_View],
    values: Sequence[np.ndarray],
    j: int,
    bins: int,
    freedom: float,
) -> Map | None:
    """Binned means, and a Wald test that all are alike; None for a variable that stands still."""
    known = [np.isfinite(view.thinned(j)) for view in views]
    scored = np.concatenate([v[one] for one, v in zip(known, values, strict=True)])
    if np.ptp(scored) <= 1e-12 * np.max(np.abs(scored)):
        return None
    edges = np.unique(np.quantile(scored, np.linspace(0, 1, bins + 1)[1:-1]))
    used, place = np.unique(np.searchsorted(edges, scored, side="right"), return_inverse=True)
    if len(used) < 2:
        return None
    labels = [np.full(len(one), -1) for one in known]
    starts = np.cumsum([np.sum(one) for one in known])[:-1]
    for label, one, part in zip(labels, known, np.split(place, starts), strict=True):
        label[one] = part
    means = _means(views, labels, len(used), j)
    error = np.maximum(np.diagonal(means.coloured), np.diagonal(means.null))
    e = np.concatenate([view.thinned(j)[one] for view, one in zip(views, known, strict=True)])
    apart = means.mean - np.mean(e)
    power = float(np.sum(e**2))
    explained = float(np.sum(means.counts * (apart**2 - error))) / power if power > 0 else 0.0
    # Hotelling's correction for the first: that covariance is itself an estimate.
    tests = (_wald(means.mean, means.coloured, freedom), _wald(means.mean, means.null, np.inf))
    statistic, p_value = max(tests, key=lambda one: one[1])
    return Map(
        *names,
        np.bincount(place, scored) / means.counts,
        means.mean,
        1.96 * np.sqrt(error),
        statistic,
        p_value,
        max(explained, 0.0),
    )


def _wald(
    mean: Float[np.ndarray, " bin"], covariance: Float[np.ndarray, "bin bin"], freedom: float
) -> tuple[float, float]:
    """Statistic, over its degrees of freedom, and p-value that all means are alike."""
    from scipy.special import chdtrc, fdtrc

    weights = np.linalg.pinv(covariance, rcond=1e-10, hermitian=True)
    total = np.sum(weights)
    level = np.sum(weights @ mean) / total if total > 0 else 0.0
    count = len(mean) - 1
    wald = float((mean - level) @ weights @ (mean - level))
    if np.isinf(freedom):
        return wald / count, float(chdtrc(count, wald))
    left = max(freedom - count + 1.0, 1.0)
    return wald / count, float(fdtrc(count, left, wald / count * left / freedom))


def _strongest(maps: Sequence[Map], level: float, rms: float, method_floor: float) -> Map | None:
    """The map that explains most among those that chance and discretisation do not."""
    good = [
        one
        for one in maps
        if one.p_value < level / len(maps)
        and one.explained > max(_SHOWN, (method_floor / rms) ** 2)
    ]
    return max(good, key=lambda one: one.explained) if good else None


# -- parameters ------------------------------------------------------------------------------


def _excitation(
    identification: Identification, views: Sequence[_View]
) -> tuple[float, tuple[Window, ...], Solution]:
    """Excitation of all records together and of each window, and the least squares behind it."""
    index = identification.index[identification.best_pass]
    weights = np.where(np.isfinite(index) & (index > 0), 1.0 / np.where(index > 0, index, 1.0), 1.0)
    free = identification.plant.free
    stretches = [stretch for view in views for stretch in _stretches(view, weights, views)]
    total = np.sum([stretch[3] for stretch in stretches], axis=0)
    count = max(sum(stretch[4] for stretch in stretches), 1)
    solution = least_squares(jnp.asarray(total), jnp.zeros(len(free)), jnp.asarray(free))
    kept = free > 0
    scale = np.sqrt(np.maximum(np.diagonal(total)[kept], np.finfo(float).tiny) / count)

    def smallest(information: np.ndarray, samples: int) -> float:
        if not samples:
            return 0.0
        scaled = information[np.ix_(kept, kept)] / samples / np.outer(scale, scale)
        return max(float(np.linalg.eigvalsh(scaled)[0]), 0.0)

    whole = smallest(total, count)
    windows = []
    for name, start, stop, information, samples in stretches:
        one = smallest(information, samples)
        windows.append(Window(name, start, stop, one, samples == 0 or one < _POOR * whole))
    return whole, tuple(windows), solution


def _stretches(
    view: _View, weights: PerOutput, views: Sequence[_View]
) -> list[tuple[str, float, float, np.ndarray, int]]:
    """Information and scored samples of each window of a record, some twenty over all records."""
    record = view.record
    length = sum(len(one.record) * one.record.sample_period for one in views)
    shortest = 10 * view.thin  # a few independent samples
    all_scored = np.any(np.isfinite(view.residual), axis=1)
    first = int(np.argmax(all_scored))  # before it is the transient
    size = max(round(length / _WINDOWS / record.sample_period), shortest)
    count = max(round((len(record) - first) / size), 1)
    found = []
    for part in np.array_split(np.arange(first, len(record)), count):
        scored = np.isfinite(view.residual[part])
        phi = np.where(scored[:, :, None], view.Phi[part], 0.0)
        information = np.einsum("j,tja,tjb->ab", weights, phi, phi, optimize=True)
        bounds = float(record.time[part[0]]), float(record.time[part[-1]])
        found.append((record.name, *bounds, information, int(np.sum(np.any(scored, axis=1)))))
    return found


def _confounded(identification: Identification, solution: Solution) -> tuple[Confounded, ...]:
    """Pairs of estimates that are nearly one, the closest first.

    The smaller of two correlations counts: that of the estimates, which also has what the model
    lacks in it, and that of the experiment alone, of estimates from white residuals.
    """
    correlation = _correlation(np.asarray(solution.inverse))
    if np.all(np.isfinite(identification.covariance)):
        other = _correlation(identification.covariance)
        correlation = np.where(np.abs(other) < np.abs(correlation), other, correlation)
    names = identification.plant.names
    pairs = [
        Confounded(names[a], names[b], float(correlation[a, b]))
        for a in range(len(names))
        for b in range(a + 1, len(names))
        if abs(correlation[a, b]) > _ALIKE
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.correlation)))


def _correlation(covariance: Float[np.ndarray, "np np"]) -> Float[np.ndarray, "np np"]:
    error = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = np.where(error > 0, error, np.inf)
    return covariance / np.outer(known, known)


def _worst_combination(plant: Plant, solution: Solution) -> str:
    """The change of parameters that shows least in the data, if it shows far less than others."""
    eigenvalues = np.asarray(solution.eigenvalues)
    if eigenvalues[0] * _UNEVEN**2 > eigenvalues[-1] or not np.any(solution.scale):
        return ""
    first = np.arange(len(eigenvalues)) > 0
    return untraced(
        eqx.tree_at(lambda one: one.identified, solution, first), plant.names, plant.free
    )[0]


# -- what the sensors and the actuators did --------------------------------------------------


def _saturations(record: Record) -> list[Saturation]:
    channels = [
        *zip(record.input_names, record.inputs.T, strict=True),
        *zip(record.output_names, record.outputs.T, strict=True),
    ]
    found = []
    for name, channel in channels:
        values = channel[record.valid]
        for side in (1.0, -1.0):
            share = _pile(side * values)
            if share:
                level = float(side * np.max(side * values))
                found.append(Saturation(record.name, name, level, share))
    return found


def _pile(values: Float[np.ndarray, " n"]) -> float:
    """Share of samples at the largest value if they pile up there, else 0.

    Cut off, a signal is at its end far more often than just short of it, where it is no more often
    than a little further in. A signal that turns there (a sine) or settles there lingers on the
    way as well; one with few levels (a staircase) has nothing in between.
    """
    reach = float(np.ptp(values))
    if reach <= 0:
        return 0.0
    width = max(reach / _LEVELS, float(np.min(np.diff(np.unique(values)))))
    level = ((np.max(values) - values) / width + 0.5).astype(int)
    counts = np.bincount(level[level < 8], minlength=8)
    beside, further = counts[1], np.median(counts[2:7])
    few = np.sum(counts[1:7] > 0) < 4 or reach / width < 20
    lingers = beside > 2.0 * further + 3.0 * np.sqrt(further + 1.0)
    if few or lingers or counts[0] < _PILE * max(beside, further, 1):
        return 0.0
    return float(counts[0] / len(values))
