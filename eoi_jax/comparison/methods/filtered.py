r"""The model's equation between filtered signals, for state-variable filter methods.

Offline a filter can have zero phase, so that derivatives stay aligned with y. Two are used:

1. a wide one, W, on y and u alike; splines through W[y] give y, ẏ, …, y^(r), the arguments of f;
2. a narrow one, L, on both sides of the equation: L[m y^(r)] = L[m f(W y, …; θ)].

For a plant that is linear in y and u, W commutes with it and nothing is lost; for any other W must
be wide against the plant's motion. m is 0 where the equation does not hold (gaps, ends of a
segment, dry friction near rest), and rises smoothly from there: a factor m on both sides keeps the
regression exact. L is a zero-phase Butterworth filter, or the plant itself, linearised
(Young's refined method): residuals are then those of y.

Source: H. Garnier, P. Young (eds), *Identification of Continuous-time Models from Sampled Data*,
2008, chapters 1 and 4; M. Gautier, A. Janot, P.-O. Vandanjon, IEEE Trans. Control Systems
Technology 21 (2013) 428, for both filters on robots.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.programs import jit
from eoi_jax.data.masks import constant, moving, tapered
from eoi_jax.data.record import Record
from eoi_jax.data.resampling import low_pass
from eoi_jax.estimation.defaults import check_runs_of_samples, default_lowpass, velocity_noise
from eoi_jax.estimation.preparation import TAPER
from eoi_jax.estimation.within_samples import resampled
from eoi_jax.models.jacobians import state_slopes
from eoi_jax.models.plant import Plant, State

Samples = Float[np.ndarray, "time ny"]


@dataclass(frozen=True)
class FilterSettings:
    """Numbers by which the filters are chosen and used."""

    cutoff_ratio: float = 5.0  # of W to L, in whose band W is then flat to 1e-5
    max_cutoff: float = 0.5  # of W, over the Nyquist frequency with sub-steps
    margin: float = 4.0  # at the ends of a segment, where W lacks data [time constants of W]
    min_decay: float = 5.0  # of the linearised plant over a record [time constants]


_SETTINGS = FilterSettings()


@dataclass(frozen=True)
class Motion:
    """One record, filtered by W.

    Attributes:
        time: of the samples [s].
        y: outputs and their derivatives below the relative degree, the arguments of f.
        highest: y^(r) of each output.
        u: inputs.
    """

    time: Float[np.ndarray, " time"]
    y: Float[np.ndarray, "time r ny"]
    highest: Samples
    u: Float[np.ndarray, "time nu"]


@dataclass(frozen=True)
class Filters:
    """Cut-offs of L and W [rad/s], and steps per sample that W needs, chosen from the records."""

    narrow: float
    wide: float
    substeps: int


def default_filters(plant: Plant, records: Sequence[Record]) -> Filters:
    """L with the default cut-off of the paper's F, W five times as wide.

    Records that are too coarse for W get sub-steps: harmonics of a nonlinear motion lie beyond
    their Nyquist frequency, and a filter that removes them distorts f.
    """
    check_runs_of_samples(records)
    narrow = default_lowpass(plant, records)[0].cutoff
    wide = _SETTINGS.cutoff_ratio * narrow
    nyquist = np.pi / max(record.sample_period for record in records)
    return Filters(narrow, wide, int(np.ceil(wide / (_SETTINGS.max_cutoff * nyquist))))


def motion(plant: Plant, record: Record, wide: float) -> Motion:
    """Outputs with their derivatives, and inputs, filtered by the zero-phase filter W.

    Args:
        plant: whose relative degrees count.
        record: measured, or a simulation of one.
        wide: cut-off of W [rad/s].
    """
    from scipy.interpolate import make_interp_spline

    smooth = record.smooth(wide)
    degrees = np.asarray(plant.degrees)
    rows = np.zeros((plant.relative_degree + 1, *record.outputs.shape))
    for start, stop in record.segments():
        degree = max(k for k in (1, 3, 5) if k < max(stop - start, 2))
        if stop - start < 2:
            continue
        index = np.arange(stop - start, dtype=float)
        spline = make_interp_spline(index, smooth.outputs[start:stop], k=degree)
        for i in range(len(rows)):
            if i <= degree:
                rows[i, start:stop] = spline(index, nu=i) / record.sample_period**i
    highest = np.take_along_axis(rows, degrees[None, None, :], axis=0)[0]
    owned = np.arange(plant.relative_degree)[:, None, None] < degrees
    y = np.moveaxis(np.where(owned, rows[:-1], 0.0), 0, 1)
    return Motion(np.asarray(record.time), y, highest, np.asarray(smooth.inputs))


def usable(plant: Plant, record: Record, signals: Motion, filters: Filters) -> Samples:
    """m: 1 where the equation holds, 0 where not, with smooth edges."""
    h = record.sample_period
    noise = velocity_noise(plant.degrees, record, filters.wide)
    resting = ~moving(plant.degrees, signals.y[:, 0], h, noise)
    resting = np.concatenate([resting[:1], resting]) | np.concatenate([resting, resting[-1:]])
    good = np.repeat(record.valid[:, None], record.outputs.shape[1], axis=1)
    good &= ~(resting @ plant.jumps.T) & ~constant(record)
    margin = round(_SETTINGS.margin / (filters.wide * h))
    for start, stop in record.segments():
        good[start : start + margin] = good[max(stop - margin, 0) : stop] = False
    return tapered(good.astype(float), TAPER / (filters.narrow * h))


@jit
def model_and_slopes(
    plant: Plant,
    time: Float[Array, " time"],
    y: Float[Array, "time r ny"],
    u: Float[Array, "time nu"],
    theta: Float[Array, " np"],
) -> tuple[Float[Array, "time ny"], Float[Array, "time ny np"]]:
    """f and ∂f/∂θ at every sample, for plants without internal states.

    Args:
        plant: the equations; its parameter values are not used.
        time: of the samples [s].
        y: outputs and their derivatives.
        u: inputs, before any actuator.
        theta: parameter values.
    """

    def f(theta: Float[Array, " np"]) -> Float[Array, "time ny"]:
        driven = plant.driven(time, u, theta)
        no_internal_states = jnp.zeros(0, theta.dtype)
        return jax.vmap(
            lambda t, y, u: plant.derivative(t, State(y, no_internal_states), u, theta)
        )(time, y, driven)

    return f(theta), jax.jacfwd(f)(theta)


# -- both sides of the regression ---------------------------------------------------------------


@dataclass(frozen=True)
class Rows:
    """Both sides of L[m (y^(r) - f)] = L[m φ] Δθ, all samples of each record.

    Attributes:
        phi: L[m φ], one array (N, ny, np) per record.
        error: L[m (y^(r) - f)], one array (N, ny) per record.
        highest: rms of L[m y^(r)], shape (ny,).
    """

    phi: list[np.ndarray]
    error: list[np.ndarray]
    highest: Float[np.ndarray, " ny"]


@dataclass(frozen=True)
class Equation:
    """A plant's equation along records with sub-steps; what does not depend on θ is stored."""

    plant: Plant
    records: tuple[Record, ...]
    filters: Filters
    motions: list[Motion]
    masks: list[np.ndarray]

    @property
    def memory(self) -> float:
        """Memory of L [s]."""
        return 10.0 / self.filters.narrow

    def rows(
        self,
        theta: Float[np.ndarray, " np"],
        motions: Sequence[Motion] | None = None,
        response: "Response | None" = None,
    ) -> Rows:
        """Both sides at θ.

        Args:
            theta: parameter values.
            motions: of each record; default: the measured ones.
            response: to use in place of the narrow filter.
        """
        phi, error, highest = [], [], []
        for i, signals in enumerate(motions or self.motions):
            arrays = (jnp.asarray(array) for array in (signals.time, signals.y, signals.u, theta))
            f, slope = (np.asarray(array) for array in model_and_slopes(self.plant, *arrays))
            sides = np.concatenate(
                [slope, (signals.highest - f)[..., None], signals.highest[..., None]], axis=2
            )
            sides = self._filtered(i, self.masks[i][:, :, None] * sides, response)
            phi.append(sides[..., :-2])
            error.append(sides[..., -2])
            highest.append(sides[..., -1])
        power = np.mean(np.concatenate(highest) ** 2, axis=0)
        return Rows(phi, error, np.sqrt(power))

    def _filtered(
        self, i: int, sides: Float[np.ndarray, "time ny columns"], response: "Response | None"
    ) -> Float[np.ndarray, "time ny columns"]:
        record = self.records[i]
        if response is not None:
            return response.applied(sides, record.sample_period)
        share = self.filters.narrow * record.sample_period / np.pi
        flat = low_pass(sides.reshape(len(sides), -1), share)
        return flat.reshape(sides.shape)


def equation(plant: Plant, records: Sequence[Record]) -> Equation:
    """The equation along records, with filters by default.

    Args:
        plant: without internal states.
        records: checked against the plant.
    """
    records = [record.bridged for record in records]
    filters = default_filters(plant, records)
    records = [resampled(plant, record, filters.substeps) for record in records]
    motions = [motion(plant, record, filters.wide) for record in records]
    masks = [
        usable(plant, record, signals, filters)
        for record, signals in zip(records, motions, strict=True)
    ]
    return Equation(plant, tuple(records), filters, motions, masks)


# -- the plant, linearised, as a filter ---------------------------------------------------------


@dataclass(frozen=True)
class Response:
    r"""$C (sI - A)^{-1} B$ from y^(r) to y of a plant linearised at the mean of its slopes.

    Attributes:
        transition: A, shape (n, n); states are outputs and their derivatives, output by output.
        degrees: of the outputs.
    """

    transition: Float[np.ndarray, "n n"]
    degrees: tuple[int, ...]

    def applied(
        self, sides: Float[np.ndarray, "time ny columns"], sample_period: float
    ) -> Float[np.ndarray, "time ny columns"]:
        """Signals filtered causally from rest, without circular wrap-around."""
        from scipy.fft import next_fast_len

        count, n = len(sides), len(self.transition)
        length = int(next_fast_len(2 * count, real=True) or 2 * count)
        ends = np.cumsum(self.degrees)
        omega = 2.0 * np.pi * np.fft.rfftfreq(length, sample_period)
        entry = np.zeros((n, len(ends)))
        entry[ends - 1, np.arange(len(ends))] = 1.0
        system = 1j * omega[:, None, None] * np.eye(n) - self.transition
        gain = np.linalg.solve(system, np.broadcast_to(entry, (len(omega), *entry.shape)))
        gain = gain[:, ends - np.asarray(self.degrees)]
        spectrum = gain @ np.fft.rfft(sides, length, axis=0)
        return np.fft.irfft(spectrum, length, axis=0)[:count]


def linearised(
    plant: Plant, theta: Float[np.ndarray, " np"], motions: Sequence[Motion], duration: float
) -> Response | None:
    """The plant as a filter, at the mean of ∂f/∂x along its motion.

    Args:
        plant: the equations.
        theta: parameter values.
        motions: along which the mean is taken.
        duration: of the shortest record [s].

    Returns:
        None where it does not decay within a record: an integrator would sum up offsets.
    """
    model = plant.with_parameters(theta)
    slopes = [np.mean(state_slopes(model, m.time, m.y, m.u), axis=0) for m in motions]
    pairs = [(i, j) for j, degree in enumerate(plant.degrees) for i in range(degree)]
    transition = np.eye(len(pairs), k=1)
    last = np.cumsum(plant.degrees) - 1
    mean = np.mean(slopes, axis=0)
    for j, row in enumerate(last):
        transition[row] = [mean[j, i, k] for i, k in pairs]
    if not np.all(np.isfinite(transition)):
        return None
    slowest = -np.max(np.linalg.eigvals(transition).real)
    decays = slowest * duration > _SETTINGS.min_decay
    return Response(transition, plant.degrees) if decays else None
