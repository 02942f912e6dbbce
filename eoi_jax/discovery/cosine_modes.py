r"""The missing acceleration (or flow) of a record as cosine modes, and models along the record.

In sliding mode, an implicit observer gives y^(r) as the r-th difference quotient of the
measurement. Its equivalent injection is this minus the model, averaged over the same samples.
Discovery needs it for hundreds of candidate terms, so the low-pass F of eq. (19) is replaced here
by projections on cosines,

    ⟨c_k, m (y^(r) - f)⟩ ,   c_k(t) = cos(ω_k t), ω_k = π k / T up to the band,

which is again the same linear operation on both sides. The modes are limited to the band by
construction and, for stationary noise, nearly independent of each other: measurement noise has the
power σ²h ω^2r in mode k. m is the weight of a sample: 0 in gaps and where the plant is at rest.

The average of f over a step is taken to fourth order in h, so that no fine sub-steps are needed.
States of the model are taken from a smoothed copy of the outputs (the noise in φ, not that in
y^(r), biases least squares); y^(r) itself is taken from the outputs as measured.

An output of relative degree 0 belongs to a sample: the model is evaluated at the start of a step,
with the input that holds from there on (as in `kernel.py`), and only samples have a weight.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import comb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from eoi_jax.compiler.pointwise import Along
from eoi_jax.compiler.programs import jit
from eoi_jax.data.masks import consecutive, moving, tapered, valid_steps
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import runs
from eoi_jax.data.spectrum import Spectrum, spectrum
from eoi_jax.discovery.rules import RULES
from eoi_jax.discovery.thinning import averaged, averaged_and_thinned, averaging, thinned, thinning
from eoi_jax.estimation.defaults import output_noise, velocity_noise
from eoi_jax.estimation.preparation import entering
from eoi_jax.estimation.within_samples import resampled
from eoi_jax.models.jacobians import Values, internal_response, state_slopes
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.start_weights import free_starts
from eoi_jax.simulation.runge_kutta import middle_of_step, runge_kutta_step

_FINE = 0.7  # band times step
_MOST_SUBSTEPS = 8
_RULES = RULES.modes
_AXES = ("fixed", "rows", "grid rows")  # of the arguments of a model

Rows = Float[np.ndarray, "*batch modes"]


@dataclass(frozen=True)
class ModalRecord:
    """One record prepared for the evaluation of models along it, S steps of h seconds.

    Attributes:
        time: middle of each step [s], shape (S,).
        y: outputs and their rates there, smoothed, shape (S, r, ny).
        u: inputs there, shape (S, nu).
        change: change of `time`, `y` and `u` from the start of each step to its end.
        staircase: whether each input is constant over each step, shape (nu,).
        highest: y^(r) by differences, weighted and thinned (`thinned`), one array an output.
        weight: m at the instants of y^(r), one array (S - r - 1,) an output.
        kernel: kernel of the thinning, shape (factor, 4).
        sample_period: h [s].
        omega: frequencies of the modes used [rad/s].
        indices: indices of the modes used among all modes.
        noise: expected power of the measurement noise in each mode, shape (modes, ny).
        state_noise: standard deviation of the remaining noise of the smoothed outputs, shape (ny,).
        duration: duration of the record [s].
        original_period: sample period of the record before sub-steps [s].
        u_start: inputs that hold from the start of each step on, shape (S, nu); None if no output
            has relative degree 0.
        z_start: internal states at the start, where their start is free; None where none is.
        start_modes: of each output, what these starts move, orthonormal, shape (modes, directions):
            `rows` leave it out.
    """

    time: Float[np.ndarray, " S"]
    y: Float[np.ndarray, "S r ny"]
    u: Float[np.ndarray, "S nu"]
    change: tuple[np.ndarray, np.ndarray, np.ndarray]
    staircase: Bool[np.ndarray, " nu"]
    highest: tuple[np.ndarray, ...]
    weight: tuple[np.ndarray, ...]
    kernel: Float[np.ndarray, "factor taps"]
    sample_period: float
    omega: Float[np.ndarray, " modes"]
    indices: Int[np.ndarray, " modes"]
    noise: Float[np.ndarray, "modes ny"]
    state_noise: Float[np.ndarray, " ny"]
    duration: float
    original_period: float
    u_start: Float[np.ndarray, "S nu"] | None = None
    z_start: Float[np.ndarray, " nz"] | None = None
    start_modes: tuple[np.ndarray, ...] = ()

    def at(self, degree: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Time, outputs and inputs at which an output of this degree is evaluated, step by step."""
        if degree > 0:
            return self.time, self.y, self.u
        assert self.u_start is not None
        time, y, _ = self.change
        return self.time - 0.5 * time, self.y - 0.5 * y, self.u_start

    def at_starts(
        self, inputs: Float[np.ndarray, "grid S nu"], smoothed: int | None = None
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Means over each step, and values at its start, of others than the recorded inputs.

        Args:
            inputs: in the middle of each step; over it, if they are held.
            smoothed: the one that is not held any more, though the record's is.
        """
        if self.u_start is None:
            return None
        change = inputs - self.u
        before = np.concatenate([change[:, :1], change[:, :-1]], axis=1)
        start = self.u_start + 0.5 * (before + change)
        is_smooth = np.arange(inputs.shape[2]) == smoothed
        earlier = np.concatenate([inputs[:, :1], inputs[:, :-1]], axis=1)
        held = np.where(is_smooth, 0.5 * (earlier + inputs), inputs)
        return inputs, np.where(self.staircase, held, start)

    def rows(self, thin: Float[np.ndarray, "*batch nodes"], j: int) -> Rows:
        """Modes of weighted and thinned signals of output j, in the unit of y^(r) times √s.

        What free starts of internal states can move is left out, of the model and of all that it
        may lack.
        """
        from scipy.fft import dct  # only discovery needs it

        modes = np.asarray(dct(np.asarray(thin), norm="ortho", axis=-1, workers=-1))
        rows = modes[..., self.indices] * np.sqrt(self.sample_period / len(self.kernel))
        if not self.start_modes:
            return rows
        return rows - (rows @ self.start_modes[j]) @ self.start_modes[j].T


def motion(record: ModalRecord, j: int, degree: int) -> Rows:
    """Modes of y^(r) of output j; of relative degree 0 those of y without its mean.

    What a model may miss by is measured by how far an output moves, not by its level: that of a
    battery is a hundred times as large.
    """
    highest = record.highest[j]
    if degree == 0:
        level = thinned(np.ones_like(record.weight[j]), record.weight[j], record.kernel)
        highest = highest - level * np.sum(highest) / max(np.sum(level), np.finfo(float).tiny)
    return record.rows(highest, j)


def modal_record(plant: Plant, record: Record, band: float) -> ModalRecord:
    """A record prepared for modes up to `band` [rad/s].

    Args:
        plant: the model; its relative degrees determine y^(r).
        record: as measured.
        band: highest frequency of the modes; at most half of the Nyquist frequency of the slowest
            output is used.
    """
    record = record.bridged
    band = min(band, 0.5 * np.pi / float(np.max(record.output_periods)))
    substeps = int(np.ceil(band * record.sample_period / _FINE))
    substeps = max(1, min(substeps, _MOST_SUBSTEPS)) if any(plant.degrees) else 1
    cutoff = smoothing_cutoff(plant, record)
    raw = resampled(plant, record, substeps)
    smoothed = record if cutoff is None else record.without_inputs().smooth(cutoff)
    smooth = raw if cutoff is None else smoothed.resample(substeps)
    h = raw.sample_period
    time, y, u = raw.time[:-1] + 0.5 * h, _states(plant, smooth), raw.midpoint_inputs()
    slopes = state_slopes(plant, time, y, u)
    internal = partial(internal_response, plant, time, y, u)
    noise = velocity_noise(plant.degrees, record, cutoff or False)
    good = _usable(plant, raw, smooth, noise, band, entering(plant, [raw], [u]))
    weight = _weights(plant, record, smooth, good, h, band)
    if plant.has_algebraic:
        weight = _at_samples(plant, weight, substeps)
    kernel = thinning(band * h)
    highest = tuple(
        thinned(np.diff(raw.outputs[:, j], degree)[1:-1] / h**degree, weight[j], kernel)
        for j, degree in enumerate(plant.degrees)
    )
    indices, omega = _modes(min(len(signal) for signal in highest), len(kernel) * h, band)
    staircase = np.asarray([hold == "zero" for hold in record.holds], dtype=bool)
    rise = np.diff(raw.inputs, axis=0) if plant.has_algebraic else np.gradient(u, axis=0)
    change = (
        np.full_like(time, h),
        np.gradient(y, axis=0),
        np.where(staircase, 0.0, rise),
    )
    return ModalRecord(
        time,
        y,
        u,
        change,
        staircase,
        highest,
        weight,
        kernel,
        h,
        omega,
        indices,
        _noise(plant, record, np.asarray(slopes), internal, h, weight, omega, len(kernel)),
        smoothed.noise,
        h * len(raw),
        record.sample_period,
        raw.inputs[:-1] if plant.has_algebraic else None,
    )


def _at_samples(
    plant: Plant, weight: tuple[np.ndarray, ...], substeps: int
) -> tuple[np.ndarray, ...]:
    """Weights of outputs of relative degree 0 at samples only, of the same sum."""
    return tuple(
        part if degree else part * substeps * ((np.arange(len(part)) + 1) % substeps == 0)
        for part, degree in zip(weight, plant.degrees, strict=True)
    )


def informative_band(plant: Plant, records: Sequence[Record]) -> float:
    """Half the frequency up to which modes of y^(r) are informative [rad/s].

    The filter F has the same gain at all frequencies below its cut-off, so noise limits the cut-off
    early. Modes are weighted one by one: they are used up to the frequency where the noise is as
    large as y^(r), or to twice the frequency below which nearly all the power of y^(r) lies.
    """
    spectra = [spectrum(record, j, r) for record in records for j, r in enumerate(plant.degrees)]
    return max(min(s.frequency_below(_RULES.power, s.motion), 0.5 * _crossing(s)) for s in spectra)


def _crossing(density: Spectrum) -> float:
    """Frequency above which noise exceeds the signal in a spectrum [rad/s]."""
    removed, passed = np.sum(density.motion) - np.cumsum(density.motion), np.cumsum(density.noise)
    return float(density.omega[int(np.argmin(removed + passed))])


def smoothing_cutoff(plant: Plant, record: Record) -> float | None:
    """Cut-off of the smoothing of the states [rad/s]; None: no smoothing.

    At the cut-off, smoothing removes as much of the states as of the noise. But a state far above
    its noise must pass almost unchanged, because the part that the filter removes appears in the
    residual. The highest derivative among the states is the one that noise disturbs most.
    """
    cutoffs = []
    for j, degree in enumerate(plant.degrees):
        if degree == 0:
            continue
        density = spectrum(record, j, degree - 1)
        positive = density.motion > 0.0
        allowed = density.noise[positive] / density.motion[positive] + _RULES.lost**2
        unchanged = density.omega[positive] * allowed ** (-0.5 / _RULES.slope)
        cutoffs += [_RULES.quiet * _crossing(density), float(np.max(unchanged, initial=0.0))]
    cutoff = max(cutoffs, default=0.0)
    return cutoff if 0.0 < cutoff < 0.8 * np.pi / record.sample_period else None


def _usable(
    plant: Plant, raw: Record, smooth: Record, noise: Any, band: float, enters: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Steps that are used: measured, and not at rest, where friction would be only a reaction.

    Returns:
        A mask that excludes every moment of rest, and one that excludes only long ones.
    """
    good = valid_steps(raw, enters)
    resting = ~moving(plant.degrees, smooth.outputs, smooth.sample_period, noise)
    resting &= ~plant.algebraic
    shortest = int(_RULES.shortest_rest / (band * raw.sample_period))
    resting_long = np.stack([_long_runs(flags, shortest) for flags in resting.T], axis=1)
    coupled = plant.coupled
    friction = plant.jumps | np.eye(len(plant.outputs), dtype=bool) | (coupled @ coupled.T)
    return good & ~(resting @ friction.T), good & ~(resting_long @ friction.T)


def _weights(
    plant: Plant,
    record: Record,
    smooth: Record,
    good: tuple[np.ndarray, np.ndarray],
    h: float,
    band: float,
) -> tuple[np.ndarray, ...]:
    """Weight of each sample of y^(r), one array an output.

    While the plant rests, even for a moment, dry friction does not follow the model. But excluding
    moments of rest lets the noise of y^(r), which is large at high frequency, leak into all modes
    through the edges. They are excluded if the leaked noise is below the floor of the modes, and if
    most of the weight remains: a slow free oscillation changes direction too often for that.
    """
    ends = max(_RULES.ends / (band * h), _RULES.least_end * len(good[0]))
    weights = []
    for j, degree in enumerate(plant.degrees):
        usable = (consecutive(mask[:, [j]], degree + 2)[degree + 1 :] for mask in good)
        sharp, soft = (
            tapered(mask.astype(float), rise)[:, 0] * _ends(len(mask), ends)
            for mask, rise in zip(
                usable, (_RULES.sharp / (band * h), _RULES.soft / (band * h)), strict=True
            )
        )
        size = np.std(np.diff(smooth.outputs[:, j], degree)) / h**degree
        leak = record.noise[j] * np.sqrt(np.mean(np.diff(sharp, degree) ** 2)) / h**degree
        leak *= np.sqrt(record.output_periods[j] * band / np.pi)
        sufficient = np.sum(sharp) > (1.0 - _RULES.most_lost) * np.sum(soft)
        weights.append(sharp if sufficient and leak < _RULES.leak * size else soft)
    return tuple(weights)


def _long_runs(flags: np.ndarray, shortest: int) -> np.ndarray:
    """Flags that stay set for at least `shortest` steps."""
    long = np.zeros_like(flags)
    for start, stop in runs(flags):
        long[start:stop] = stop - start >= shortest
    return long


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
    owned = np.arange(plant.rows)[:, None] < np.asarray(plant.degrees)
    return np.stack(rows, axis=1) * owned


def _modes(nodes: int, spacing: float, band: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the modes that are used, and their frequencies."""
    count = min(int(band * spacing * nodes / np.pi), nodes)
    low, high = np.arange(min(count, _RULES.low)), np.arange(_RULES.low, count)
    if len(high) > _RULES.high:
        high = np.unique(np.round(np.linspace(_RULES.low, count - 1, _RULES.high)).astype(int))
    indices = np.concatenate([low, high])
    return indices, np.pi * indices / (spacing * nodes)


def _noise(
    plant: Plant,
    record: Record,
    slopes: Float[np.ndarray, "S ny r ny"],
    internal: Callable[[np.ndarray], np.ndarray],
    h: float,
    weight: tuple[np.ndarray, ...],
    omega: np.ndarray,
    factor: int,
) -> Float[np.ndarray, "modes ny"]:
    r"""Power of the measurement noise n in each mode.

    It enters y^(r) and, through the states, the model: n^(r) - Σ ∂f/∂y^(m) n^(m), and what it does
    to internal states. Where the slopes vary along the record, their mean acts as a filter, and
    their variance acts as white noise.
    """
    gain = np.sinc(omega * factor * h / (2.0 * np.pi)) ** 8
    slopes = np.where(np.isfinite(slopes), slopes, 0.0)
    s = 1j * 2.0 * np.sin(0.5 * omega * h) / h
    ringing = internal(s)
    noise, sigma = np.zeros((len(omega), len(plant.outputs))), output_noise(plant, record)
    for j, degree in enumerate(plant.degrees):
        for k in range(len(plant.outputs)):
            density = record.output_periods[k] * sigma[k] ** 2
            mean, scatter = slopes[:, j, :, k].mean(axis=0), slopes[:, j, :, k].var(axis=0)
            derivative = s**degree if j == k else 0.0 * s
            filtered = derivative - sum(mean[m] * s**m for m in range(len(mean)))
            filtered = filtered - ringing[:, j, k]
            spread = sum(scatter[m] * np.abs(s) ** (2 * m) for m in range(len(mean)))
            noise[:, j] += density * (np.abs(filtered) ** 2 + spread)
        noise[:, j] *= np.mean(weight[j] ** 2)
        # Leakage through the edges of the weights: n times their derivatives (partial integration).
        density = record.output_periods[j] * sigma[j] ** 2
        for k in range(1, degree + 1):
            edge = np.mean(np.diff(weight[j], k) ** 2) / h ** (2 * k)
            noise[:, j] += density * comb(degree, k) ** 2 * edge * np.abs(s) ** (2 * (degree - k))
        noise[:, j] *= gain
    return noise


# -- models along a record ----------------------------------------------------------------


@jit
def model_along(
    plant: Plant,
    theta: Float[Values, " np"],
    signals: tuple,
    inputs: tuple,
    change: tuple,
    thin: tuple,
    h: Float[Values, ""],
    begin: Float[Values, " nz"] | None = None,
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """f and ∂f/∂θ along a record (`time`, `y`), thinned, for several inputs (grid, S, nu).

    `change` is that of the `ModalRecord`, `thin` its weights and kernel, `inputs` are those in the
    middle of each step and those of `ModalRecord.at_starts`, `begin` is its `z_start`.

    Returns:
        For each output f, shape (grid, nodes), and ∂f/∂θ, shape (grid, np, nodes). Derivatives
        are total: through internal states too.
    """
    (time, y), (weights, kernel) = signals, thin

    def f(theta: Array, drives: tuple[Array, tuple[Array, Array] | None]) -> tuple[Array, ...]:
        u, at_starts = drives
        u = plant.driven(time, u, theta)
        z_start, z = _internal(plant, theta, (time, y, u), change, h, begin)
        along = jax.vmap(lambda t, y, z, u: plant.derivative(t, State(y, z), u, theta))
        values = along(time, y, z, u)
        if at_starts is not None:
            start, y_start = time - 0.5 * change[0], y - 0.5 * change[1]
            u_start = plant.driven_at_starts(time, *at_starts, theta)
            at_start = along(start, y_start, z_start, u_start)
            values = jnp.where(plant.algebraic, at_start, values)
        return tuple(
            thinned(averaged(r, values[:, j]), weights[j], kernel)
            for j, r in enumerate(plant.degrees)
        )

    def value_and_slopes(u: Any) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        def value_twice(theta: Array) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
            value = f(theta, u)
            return value, value

        jacobian, value = jax.jacfwd(value_twice, has_aux=True)(theta)
        return value, tuple(part.T for part in jacobian)

    recursive = plant.internal is not None or plant.actuator is not None
    return map_inputs(value_and_slopes, jax.tree.map(jnp.asarray, inputs), recursive)


def _recursive_along(
    plant: Plant, record: ModalRecord, inputs: tuple[np.ndarray, Any]
) -> tuple[Any, Any]:
    """`model_along` of a plant with internal states, or behind an actuator."""
    h, thin = np.asarray(record.sample_period), (record.weight, record.kernel)
    signals, change = (record.time, record.y), record.change
    return model_along(plant, plant.theta, signals, inputs, change, thin, h, record.z_start)


def _static_along(
    plant: Plant, record: ModalRecord, inputs: tuple[np.ndarray, Any]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """`model_along` of a plant without internal states: each instant is evaluated separately."""
    f, phi = [], []
    for j, degree in enumerate(plant.degrees):
        u = inputs[0] if degree else inputs[1][1]
        row = Along(_Output(j), _AXES, plant, record.at(degree)[:2], u)

        def values(part: slice, row: Along = row) -> Float[np.ndarray, "grid values part"]:
            return np.moveaxis(row(part), 2, 1)

        batch = len(inputs[0]), 1 + len(plant.names)
        nodes = averaged_and_thinned(values, batch, degree, record.weight[j], record.kernel)
        f.append(nodes[:, 0])
        phi.append(nodes[:, 1:])
    return f, phi


@dataclass(frozen=True)
class _Output:
    """f of one output at one instant, followed by ∂f/∂θ."""

    output: int

    def __call__(self, plant: Plant, row: tuple, u: Array) -> Float[Array, " values"]:
        (t, y), z = row, jnp.zeros(0)

        def value_twice(theta: Array) -> tuple[Array, Array]:
            f = plant.derivative(t, State(y, z), u, theta)[self.output]
            return f, f

        slopes, f = jax.jacfwd(value_twice, has_aux=True)(plant.theta)
        return jnp.concatenate([f[None], slopes])


def map_inputs(function: Callable[[Any], Any], inputs: Any, recursive: bool) -> Any:
    """A function of each of several inputs (leading axis), evaluated one after the other.

    Under `vmap` XLA would evaluate for each input what is the same for all. But a recursion over
    the steps takes hardly longer for several inputs, and is vectorised.
    """
    return jax.vmap(function)(inputs) if recursive else jax.lax.map(function, inputs)


def _internal(
    plant: Plant, theta: Array, rows: tuple, change: tuple, h: Any, begin: Any
) -> tuple[Array, Array]:
    """Internal states at the start and in the middle of each step, driven by the measurement."""
    start = plant.internal_start(theta)
    if begin is not None:
        # Of the model that the record was prepared for: states of effects are added behind its own.
        count = len(begin)
        free = free_starts(plant.internal_initial, start.size)[:count]
        start = start.at[:count].set(jnp.where(free, begin, start[:count]))
    if plant.internal is None:
        none = jnp.zeros((rows[0].shape[0], 0), theta.dtype)
        return none, none

    def rate(z: Array, row: tuple) -> Array:
        t, y, u = row
        return plant.internal_rate(t, State(y, z), u, theta)

    def step(z: Array, row: tuple) -> tuple[Array, tuple[Array, Array]]:
        end, middle = moved_through(rate, z, row, h)
        return end, (z, middle)

    return jax.lax.scan(step, start, (rows, change))[1]


def internal_along(plant: Plant, record: ModalRecord) -> Float[np.ndarray, "S nz"]:
    """Internal states of a plant in the middle of each step, at its parameters."""
    theta = jnp.asarray(plant.theta)
    h = jnp.asarray(record.sample_period)
    u = plant.driven(jnp.asarray(record.time), jnp.asarray(record.u), theta)
    rows = record.time, record.y, u
    return np.asarray(_internal(plant, theta, rows, record.change, h, record.z_start)[1])


def integrated(
    rate: Callable[[Array, tuple], Array], start: Array, rows: tuple, change: tuple, h: Any
) -> Float[Array, "S nz"]:
    """States in the middle of each Runge–Kutta step.

    Args:
        rate: dz/dt of z and of one row.
        start: z at the start.
        rows: signals in the middle of each step.
        change: their change over the step; a staircase would excite fast states.
        h: step [s].
    """
    return jax.lax.scan(lambda z, row: moved_through(rate, z, row, h), start, (rows, change))[1]


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
    start = jax.tree.map(lambda value, step: value - 0.5 * step, middle, change)
    stop = jax.tree.map(lambda value, step: value + 0.5 * step, middle, change)
    end, slopes = runge_kutta_step(rate, z, h, (start, middle, stop))
    return end, middle_of_step(z, end, slopes, h)


def model_rows(
    plant: Plant,
    stretches: Sequence[ModalRecord],
    inputs: Sequence[np.ndarray] | None = None,
    smoothed: int | None = None,
) -> tuple[Float[np.ndarray, "grid rows"], Float[np.ndarray, "grid rows np"]]:
    """y^(r) - f and ∂f/∂θ as modes, concatenated over all records and outputs.

    Args:
        plant: evaluated at its parameters.
        stretches: the prepared records.
        inputs: for each record several inputs, shape (grid, S, nu), instead of the recorded one.
        smoothed: the input among them that is not held any more, though the record's is.
    """
    errors, slopes = [], []
    recursive = plant.internal is not None or plant.actuator is not None
    for i, record in enumerate(stretches):
        u = record.u[None] if inputs is None else inputs[i]
        at_starts = record.at_starts(u, smoothed)
        if np.any(record.staircase) and any(plant.degrees):
            u = np.where(record.staircase, _as_averaged(u, max(plant.degrees)), u)
        f, phi = (_recursive_along if recursive else _static_along)(plant, record, (u, at_starts))
        for j in range(len(plant.outputs)):
            errors.append(record.rows(record.highest[j] - np.asarray(f[j]), j))
            slopes.append(record.rows(np.asarray(phi[j]), j))
    return np.concatenate(errors, axis=-1), np.moveaxis(np.concatenate(slopes, axis=-1), 1, 2)


def _as_averaged(u: np.ndarray, degree: int) -> np.ndarray:
    """Samples whose fourth-order average is the average of the given staircase."""
    c = -averaging(degree)[0] * 2 ** (degree - 1)
    samples = np.array(u)
    samples[..., 1:-1, :] += c * np.diff(u, 2, axis=-2)
    return samples
