r"""The missing acceleration (or flow) of a record, mode by mode, and any model along the record.

In sliding, an implicit observer shows y^(r) as the r-th difference quotient of the measurement;
its equivalent injection is that less the model, averaged over the same samples (method of
`passes`). Discovery needs this for hundreds of candidate terms at once, so here the low-pass F of
eq. (19) is replaced by projections on cosines,

    ⟨c_k, m (y^(r) - f)⟩ ,   c_k(t) = cos(ω_k t), ω_k = π k / T up to the band,

again the same linear operation on both sides. The modes are "thinned to the filter's bandwidth" by
construction and, for stationary noise, nearly independent of each other: measurement noise has the
power σ²h ω^2r in mode k. m is the weight of a sample: 0 in gaps and where the plant stands still.

The average of f over a step is taken to fourth order in h, so that no fine sub-steps are needed.
States of the model are taken from a smoothed copy of the outputs (the noise in φ, not that in
y^(r), biases least squares); y^(r) itself is taken from the outputs as measured.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import comb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from eoi_jax.compiler.pointwise import Along
from eoi_jax.compiler.programs import jit
from eoi_jax.data.masks import consecutive, moving, tapered, valid_steps
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs
from eoi_jax.data.spectrum import Spectrum, spectrum
from eoi_jax.discovery.thinning import averaged, averaged_and_thinned, averaging, thinned, thinning
from eoi_jax.estimation.defaults import velocity_noise
from eoi_jax.models.jacobians import Values, state_slopes
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.runge_kutta import middle_of_step, runge_kutta_step

_FINE = 0.7  # band times step
_MOST_SUBSTEPS = 8
# Of one record: so many low modes are all used (a sinusoid shows in two of them), of those above an
# even selection, which says as much and costs less.
_LOW, _HIGH = 1000, 500
# Over the band: rise time of the weights beside samples that do not count where noise is small and
# where it is not, at the ends of a record, and the shortest rest that is left out with noise. What
# noise leaks into low modes falls with the square of the rise time.
_SHARP, _SOFT, _ENDS, _REST = 3.0, 10.0, 20.0, 6.0
_LEAK = 2e-3  # noise that the edges may let in, over y^(r), rms: the floor of `noise_model`
# Of the smoothing: its cut-off over the frequency where noise hides a state; the share that it may
# take of what stands above the noise, that floor again; its gain is 1 - (ω/cut-off)^8.
_QUIET, _LOST, _SLOPE = 1.5, 2e-3, 8
_LEAST_END = 0.01  # of the record
_MOST_LOST = 0.5  # of the weight of all samples, to moments of rest
_AXES = ("fixed", "rows", "grid rows")  # of what a model is evaluated at
_MOST_POWER = 0.99  # of y^(r), below the frequency half of the band

Rows = Float[np.ndarray, "*batch modes"]


@dataclass(frozen=True)
class ModalRecord:
    """One record as models are evaluated along it, S steps of h seconds.

    Attributes:
        time: middle of each step [s], shape (S,).
        y: outputs and their rates there, smoothed, shape (S, r, ny).
        u: inputs there, shape (S, nu).
        bend: change of `time`, `y` and `u` from the start of each step to its end.
        held: whether the inputs are constant over each step.
        highest: y^(r) by differences, weighted and thinned (`thinned`), one array an output.
        weight: m at the instants of y^(r), one array (S - r - 1,) an output.
        kernel: of the thinning, shape (factor, 4).
        sample_period: h [s].
        omega: of the modes [rad/s].
        kept: their indices among all modes.
        noise: expected power of the measurement noise in each mode, shape (modes, ny).
        state_noise: standard deviation of the noise left in the smoothed outputs, shape (ny,).
        duration: of the record [s].
        original_period: of the record before sub-steps [s].
    """

    time: Float[np.ndarray, " S"]
    y: Float[np.ndarray, "S r ny"]
    u: Float[np.ndarray, "S nu"]
    bend: tuple[np.ndarray, np.ndarray, np.ndarray]
    held: bool
    highest: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    kernel: Float[np.ndarray, "factor taps"]
    sample_period: float
    omega: Float[np.ndarray, " modes"]
    kept: Int[np.ndarray, " modes"]
    noise: Float[np.ndarray, "modes ny"]
    state_noise: Float[np.ndarray, " ny"]
    duration: float
    original_period: float

    def rows(self, thin: Float[np.ndarray, "*batch nodes"]) -> Rows:
        """Modes of signals that are weighted and thinned, in the unit of y^(r) times √s."""
        from scipy.fft import dct  # only discovery needs it

        modes = np.asarray(dct(np.asarray(thin), norm="ortho", axis=-1, workers=-1))
        return modes[..., self.kept] * np.sqrt(self.sample_period / len(self.kernel))


def stretch(plant: Plant, record: Record, band: float) -> ModalRecord:
    """A record made ready for modes up to `band` [rad/s].

    Args:
        plant: whose relative degrees count.
        record: as measured.
        band: highest frequency of the modes; at most half of the Nyquist frequency is used.
    """
    band = min(band, 0.5 * np.pi / record.sample_period)
    substeps = int(np.ceil(band * record.sample_period / _FINE))
    substeps = max(1, min(substeps, _MOST_SUBSTEPS))
    cutoff = quiet_band(plant, record)
    raw = record.resample(substeps)
    calm = record if cutoff is None else record.without_inputs().smooth(cutoff)
    smooth = raw if cutoff is None else calm.resample(substeps)
    h = raw.sample_period
    time, y, u = raw.time[:-1] + 0.5 * h, _states(plant, smooth), raw.midpoint_inputs()
    slopes = state_slopes(plant, time, y, u)
    good = _usable(plant, raw, smooth, velocity_noise(plant.degrees, record, cutoff or False), band)
    weight = _weights(plant, record, smooth, good, h, band)
    kernel = thinning(band * h)
    highest = tuple(
        thinned(np.diff(raw.outputs[:, j], degree)[1:-1] / h**degree, weight[j], kernel)
        for j, degree in enumerate(plant.degrees)
    )
    kept, omega = _modes(min(len(one) for one in highest), len(kernel) * h, band)
    held = record.hold == "zero"
    bend = (
        np.full_like(time, h),
        np.gradient(y, axis=0),
        np.zeros_like(u) if held else np.gradient(u, axis=0),
    )
    return ModalRecord(
        time,
        y,
        u,
        bend,
        held,
        highest,
        weight,
        kernel,
        h,
        omega,
        kept,
        _noise(plant, record, np.asarray(slopes), h, weight, omega, len(kernel)),
        calm.noise,
        h * len(raw),
        record.sample_period,
    )


def telling_band(plant: Plant, records: Sequence[Record]) -> float:
    """Half the frequency up to which modes of y^(r) tell something [rad/s].

    The filter F passes all below its cut-off alike, so that noise bounds it early. Modes are
    weighed one by one: they are used up to where the noise is as large as y^(r), or to twice the
    frequency below which nearly all of y^(r) lies.
    """
    several = [spectrum(one, j, r) for one in records for j, r in enumerate(plant.degrees)]
    return max(
        min(one.frequency_below(_MOST_POWER, one.motion), 0.5 * _crossing(one)) for one in several
    )


def _crossing(one: Spectrum) -> float:
    """Frequency from which on a spectrum is more noise than signal [rad/s]."""
    lost, passed = np.sum(one.motion) - np.cumsum(one.motion), np.cumsum(one.noise)
    return float(one.omega[int(np.argmin(lost + passed))])


def quiet_band(plant: Plant, record: Record) -> float | None:
    """Cut-off of the smoothing of the states [rad/s]; None: no smoothing.

    There smoothing loses as much of the states as it takes away noise. But a state far above its
    noise must come through almost whole: what the filter takes of it, the residual shows. The
    highest derivative among the states is what noise disturbs most.
    """
    best = []
    for j, degree in enumerate(plant.degrees):
        one = spectrum(record, j, degree - 1)
        seen = one.motion > 0.0
        allowed = one.noise[seen] / one.motion[seen] + _LOST**2
        whole = one.omega[seen] * allowed ** (-0.5 / _SLOPE)
        best += [_QUIET * _crossing(one), float(np.max(whole, initial=0.0))]
    cutoff = max(best)
    return cutoff if 0.0 < cutoff < 0.8 * np.pi / record.sample_period else None


def _usable(
    plant: Plant, raw: Record, smooth: Record, noise: Any, band: float
) -> tuple[np.ndarray, np.ndarray]:
    """Steps that count: measured, and not at rest, where friction would be a mere reaction.

    Returns:
        Once with every moment of rest out, once with long ones only.
    """
    good = np.repeat(valid_steps(raw)[:, None], len(plant.outputs), axis=1)
    still = ~moving(plant.degrees, smooth.outputs, smooth.sample_period, noise)
    shortest = int(_REST / (band * raw.sample_period))
    lasting = np.stack([_lasting(one, shortest) for one in still.T], axis=1)
    coupled = plant.coupled
    friction = plant.jumps | np.eye(len(plant.outputs), dtype=bool) | (coupled @ coupled.T)
    return good & ~(still @ friction.T), good & ~(lasting @ friction.T)


def _weights(
    plant: Plant,
    record: Record,
    smooth: Record,
    good: tuple[np.ndarray, np.ndarray],
    h: float,
    band: float,
) -> tuple[np.ndarray, ...]:
    """Weight of each sample of y^(r), one array an output.

    Dry friction is not what the model says while the plant rests, not even for a moment. But to cut
    moments out lets the noise of y^(r), which is large at high frequency, into all modes over the
    edges: it is done where that noise stays below what the modes have anyway, and where the rises
    beside the moments leave most of the record: a slow free oscillation turns too often for that.
    """
    ends = max(_ENDS / (band * h), _LEAST_END * len(good[0]))
    chosen = []
    for j, degree in enumerate(plant.degrees):
        usable = (consecutive(use[:, [j]], degree + 2)[degree + 1 :] for use in good)
        sharp, soft = (
            tapered(use.astype(float), rise)[:, 0] * _ends(len(use), ends)
            for use, rise in zip(usable, (_SHARP / (band * h), _SOFT / (band * h)), strict=True)
        )
        size = np.std(np.diff(smooth.outputs[:, j], degree)) / h**degree
        leak = record.noise[j] * np.sqrt(np.mean(np.diff(sharp, degree) ** 2)) / h**degree
        leak *= np.sqrt(record.sample_period * band / np.pi)
        kept = np.sum(sharp) > (1.0 - _MOST_LOST) * np.sum(soft)
        chosen.append(sharp if kept and leak < _LEAK * size else soft)
    return tuple(chosen)


def _lasting(flags: np.ndarray, shortest: int) -> np.ndarray:
    """Flags that stay up for at least so many steps."""
    kept = np.zeros_like(flags)
    for start, stop in runs(flags):
        kept[start:stop] = stop - start >= shortest
    return kept


def _ends(size: int, rise: float) -> np.ndarray:
    """Weights that rise from zero at both ends of a record."""
    index = np.arange(size)
    distance = np.minimum(index + 1, size - index)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(distance / max(rise, 1.0), 0.0, 1.0))


def _states(plant: Plant, record: Record) -> Float[np.ndarray, "S r ny"]:
    """Outputs and their rates in the middle of each step, to fourth order in h."""
    h, y = record.sample_period, record.outputs
    first, last = 2.0 * y[:1] - y[1:2], 2.0 * y[-1:] - y[-2:-1]
    wide = np.concatenate([first, y, last])
    rows = [(9.0 * (wide[1:-2] + wide[2:-1]) - wide[:-3] - wide[3:]) / 16.0]
    if plant.relative_degree > 1:
        rows.append((27.0 * (wide[2:-1] - wide[1:-2]) - wide[3:] + wide[:-3]) / (24.0 * h))
    while len(rows) < plant.relative_degree:
        rows.append(np.gradient(rows[-1], h, axis=0))
    owned = np.arange(plant.relative_degree)[:, None] < np.asarray(plant.degrees)
    return np.stack(rows, axis=1) * owned


def _modes(nodes: int, spacing: float, band: float) -> tuple[np.ndarray, np.ndarray]:
    """Which modes are used, and their frequencies."""
    count = min(int(band * spacing * nodes / np.pi), nodes)
    low, high = np.arange(min(count, _LOW)), np.arange(_LOW, count)
    if len(high) > _HIGH:
        high = np.unique(np.round(np.linspace(_LOW, count - 1, _HIGH)).astype(int))
    kept = np.concatenate([low, high])
    return kept, np.pi * kept / (spacing * nodes)


def _noise(
    plant: Plant,
    record: Record,
    slopes: Float[np.ndarray, "S ny r ny"],
    h: float,
    weight: tuple[np.ndarray, ...],
    omega: np.ndarray,
    factor: int,
) -> Float[np.ndarray, "modes ny"]:
    r"""Power of the measurement noise n in each mode.

    It enters y^(r) and, through the states, the model: n^(r) - Σ ∂f/∂y^(m) n^(m). With slopes that
    vary along the record, their mean acts as a filter and their scatter as white noise does.
    """
    gain = np.sinc(omega * factor * h / (2.0 * np.pi)) ** 8
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    s = 1j * 2.0 * np.sin(0.5 * omega * h) / h
    noise = np.zeros((len(omega), len(plant.outputs)))
    for j, degree in enumerate(plant.degrees):
        for k in range(len(plant.outputs)):
            density = record.sample_period * record.noise[k] ** 2
            mean, scatter = slopes[:, j, :, k].mean(axis=0), slopes[:, j, :, k].var(axis=0)
            own = s**degree if j == k else 0.0 * s
            filtered = own - sum(mean[m] * s**m for m in range(len(mean)))
            spread = sum(scatter[m] * np.abs(s) ** (2 * m) for m in range(len(mean)))
            noise[:, j] += density * (np.abs(filtered) ** 2 + spread)
        noise[:, j] *= np.mean(weight[j] ** 2)
        # What the edges of the weights let in: n times their derivatives, by parts.
        density = record.sample_period * record.noise[j] ** 2
        for k in range(1, degree + 1):
            edge = np.mean(np.diff(weight[j], k) ** 2) / h ** (2 * k)
            noise[:, j] += density * comb(degree, k) ** 2 * edge * np.abs(s) ** (2 * (degree - k))
        noise[:, j] *= gain
    return noise


# -- models along a stretch ---------------------------------------------------------------


@jit
def model_along(
    plant: Plant,
    theta: Float[Values, " np"],
    one: tuple,
    inputs: Values,
    bend: tuple,
    thin: tuple,
    h: Float[Values, ""],
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """f and ∂f/∂θ along a stretch (`time`, `y`), thinned, for several inputs (grid, S, nu).

    `bend` is that of the stretch, `thin` its weights and kernel.

    Returns:
        For each output f, shape (grid, nodes), and ∂f/∂θ, shape (grid, np, nodes). Derivatives
        are total: through internal states too.
    """
    (time, y), (weights, kernel) = one, thin

    def f(theta: Array, u: Array) -> tuple[Array, ...]:
        u = plant.driven(time, u, theta)
        z = _internal(plant, theta, (time, y, u), bend, h)
        values = jax.vmap(lambda t, y, z, u: plant.derivative(t, State(y, z), u, theta))(
            time, y, z, u
        )
        return tuple(
            thinned(averaged(r, values[:, j]), weights[j], kernel)
            for j, r in enumerate(plant.degrees)
        )

    def both(u: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        def twice(theta: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
            value = f(theta, u)
            return value, value

        jacobian, value = jax.jacfwd(twice, has_aux=True)(theta)
        return value, tuple(part.T for part in jacobian)

    recursive = plant.internal is not None or plant.actuator is not None
    return each_of(both, jnp.asarray(inputs), recursive)


def _recursive_along(plant: Plant, one: ModalRecord, inputs: np.ndarray) -> tuple[Any, Any]:
    """`model_along` of a plant with internal states, or behind an actuator."""
    h, thin = np.asarray(one.sample_period), (one.weight, one.kernel)
    return model_along(plant, plant.theta, (one.time, one.y), inputs, one.bend, thin, h)


def _static_along(
    plant: Plant, one: ModalRecord, inputs: Float[np.ndarray, "grid S nu"]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """`model_along` of a plant of which each instant stands for itself."""
    f, phi = [], []
    for j, degree in enumerate(plant.degrees):
        row = Along(_Output(j), _AXES, plant, (one.time, one.y), inputs)

        def values(part: slice, row: Along = row) -> Float[np.ndarray, "grid values part"]:
            return np.moveaxis(row(part), 2, 1)

        batch = len(inputs), 1 + len(plant.names)
        nodes = averaged_and_thinned(values, batch, degree, one.weight[j], one.kernel)
        f.append(nodes[:, 0])
        phi.append(nodes[:, 1:])
    return f, phi


@dataclass(frozen=True)
class _Output:
    """f of one output at one instant, and behind it ∂f/∂θ."""

    output: int

    def __call__(self, plant: Plant, row: tuple, u: Array) -> Float[Array, " values"]:
        (t, y), z = row, jnp.zeros(0)

        def both(theta: Array) -> tuple[Array, Array]:
            f = plant.derivative(t, State(y, z), u, theta)[self.output]
            return f, f

        slopes, f = jax.jacfwd(both, has_aux=True)(plant.theta)
        return jnp.concatenate([f[None], slopes])


def each_of(function: Callable[[Array], Any], several: Array, recursive: bool) -> Any:
    """A function of each of several inputs or shapes (leading axis), one after the other.

    Side by side XLA evaluates for each of them what is the same for all. A recursion over the steps
    takes hardly longer for several, and is followed side by side.
    """
    return jax.vmap(function)(several) if recursive else jax.lax.map(function, several)


def _internal(plant: Plant, theta: Array, rows: tuple, bend: tuple, h: Any) -> Array:
    """Internal states in the middle of each step, driven by the measured signals."""
    start = plant.internal_start(theta)
    if plant.internal is None:
        return jnp.zeros((rows[0].shape[0], 0), theta.dtype)

    def rate(z: Array, row: tuple) -> Array:
        t, y, u = row
        return plant.internal_rate(t, State(y, z), u, theta)

    return integrated(rate, start, rows, bend, h)


def internal_along(plant: Plant, one: ModalRecord) -> Float[np.ndarray, "S nz"]:
    """Internal states of a plant in the middle of each step, at its parameters."""
    theta = jnp.asarray(plant.theta)
    h = jnp.asarray(one.sample_period)
    u = plant.driven(jnp.asarray(one.time), jnp.asarray(one.u), theta)
    return np.asarray(_internal(plant, theta, (one.time, one.y, u), one.bend, h))


def integrated(
    rate: Callable[[Array, tuple], Array], start: Array, rows: tuple, bend: tuple, h: Any
) -> Float[Array, "S nz"]:
    """States in the middle of each Runge–Kutta step.

    Args:
        rate: dz/dt of z and of one row.
        start: z at the start.
        rows: signals in the middle of each step.
        bend: their change over the step; a staircase would excite fast states.
        h: step [s].
    """
    return jax.lax.scan(lambda z, row: moved_through(rate, z, row, h), start, (rows, bend))[1]


def moved_through(
    rate: Callable[[Array, tuple], Array], z: Array, row: tuple[tuple, tuple], h: Any
) -> tuple[Array, Array]:
    """States at the end of a step and in its middle, from those at its start (Runge–Kutta).

    Args:
        rate: dz/dt of z and of one row.
        z: at the start of the step.
        row: signals in the middle of the step, and their change over it.
        h: step [s].
    """
    middle, change = row
    before = jax.tree.map(lambda value, step: value - 0.5 * step, middle, change)
    after = jax.tree.map(lambda value, step: value + 0.5 * step, middle, change)
    end, slopes = runge_kutta_step(rate, z, h, (before, middle, after))
    return end, middle_of_step(z, end, slopes, h)


def model_rows(
    plant: Plant, stretches: Sequence[ModalRecord], inputs: Sequence[np.ndarray] | None = None
) -> tuple[Float[np.ndarray, "grid rows"], Float[np.ndarray, "grid rows np"]]:
    """y^(r) - f and ∂f/∂θ as modes, of all stretches and outputs one behind the other.

    Args:
        plant: evaluated at its parameters.
        stretches: of the records.
        inputs: for each stretch several inputs, shape (grid, S, nu), instead of the recorded one.
    """
    errors, slopes = [], []
    recursive = plant.internal is not None or plant.actuator is not None
    for i, one in enumerate(stretches):
        u = one.u[None] if inputs is None else inputs[i]
        u = _as_averaged(u, max(plant.degrees)) if one.held else u
        f, phi = (_recursive_along if recursive else _static_along)(plant, one, u)
        for j in range(len(plant.outputs)):
            errors.append(one.rows(one.highest[j] - np.asarray(f[j])))
            slopes.append(one.rows(np.asarray(phi[j])))
    return np.concatenate(errors, axis=-1), np.moveaxis(np.concatenate(slopes, axis=-1), 1, 2)


def _as_averaged(u: np.ndarray, degree: int) -> np.ndarray:
    """A staircase as the samples whose fourth-order average is the average of the staircase."""
    c = -averaging(degree)[0] * 2 ** (degree - 1)
    out = np.array(u)
    out[..., 1:-1, :] += c * np.diff(u, 2, axis=-2)
    return out
