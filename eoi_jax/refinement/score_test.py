r"""What a small force does to the free runs of a refined model, beside its own unknowns.

A small force $w$ added to $y^{(r)}$ moves the free run by $\hat y_w$, the solution of the equation
linearised along it, $\delta^{(r)} = \partial_x f\,\delta + w$ (`linear_response.py`). With $w$ the
term of an effect along the simulated states, at unit gain, and all that the parameters and the
initial states can do taken out of $\hat y_w$ and of the residual $r$, least squares of $r$ on
$\hat y_w$ gives the gain and the share of the residual that it explains. With a share s,
$-n \log(1 - s)$ is χ², n the number of independent samples: all of them over the correlation time
Σ ρ² of what is left (M. S. Bartlett). Of a sensor behind the output $\hat y_w$ is what it
changes of the free run itself, and the gain is near one.

**Source.** C. R. Rao, Proc. Cambridge Phil. Soc. 44 (1948) 50 (score test).
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.compiler.pointwise import along, slopes_along
from eoi_jax.data.record import Record
from eoi_jax.estimation.regression.robust_covariance import correlation_time
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractCascade,
    AbstractEffect,
    AbstractInputEffect,
    AbstractParameterEffect,
    AbstractTerm,
    Seen,
)
from eoi_jax.models.effects.instants import ChangedInput, UnitTerms
from eoi_jax.models.plant import Plant, State
from eoi_jax.refinement.free_run_sums import signals
from eoi_jax.refinement.own_unknowns import OwnUnknowns
from eoi_jax.refinement.problem import Problem, Unknowns, driven, problem_of, weighed
from eoi_jax.refinement.result import Refinement
from eoi_jax.refinement.spans import Span, spans_of
from eoi_jax.simulation.chained_runs import states_along
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.linear_response import Response, response_of

Columns = Float[np.ndarray, "rows columns"]


@dataclass(frozen=True)
class ScoreTestSettings:
    """Numbers of the test."""

    peaks: int = 5  # frequencies of the residual at which a sinusoid is tried
    # Singular value, over the largest, of columns of which one follows from the others.
    rank_tolerance: float = 1e-8
    # Gain of a changed input, by least squares, between which it is nominated; 1 is the change as
    # it is. The refined gain of the plant is too small by as much as the missing effect weakens the
    # input: a damper that yields asked for 10. Set with that record (mr_damper) in view; 2 before.
    min_change: float = 0.5
    max_change: float = 20.0
    min_new: float = 1e-6  # share of a column's power that the model's own unknowns must leave


_SETTINGS = ScoreTestSettings()


@dataclass(frozen=True)
class Candidate:
    """One effect or two, each at its best shape.

    Attributes:
        placed: the effects and their channels.
        values: of their parameters, by their names in an augmented plant.
        share: of the residual's power that they explain beside the model's own parameters.
        significance: probability of as much by chance, times the number of tries; at most 1.
    """

    placed: tuple[Placed, ...]
    values: dict[str, float]
    share: float
    significance: float

    @property
    def names(self) -> tuple[str, ...]:
        """Canonical names of the effects."""
        return tuple(placed.effect.name for placed in self.placed)


@dataclass(frozen=True)
class LinearisedRuns:
    """The free runs of the refined model, and what its own unknowns leave of their errors.

    Attributes:
        plant: the refined one.
        problem: its runs.
        stages: times, inputs, y (runs, samples, 3, r, ny) and z (runs, samples, 3, nz) of each
            run at the start, the middle and the end of each sample.
        unknowns: what the model's own unknowns can do to the errors.
        residual: r less these.
        records: of the runs.
        response: of the runs, to small forces.
    """

    plant: Plant
    problem: Problem
    stages: tuple[Any, ...]
    unknowns: OwnUnknowns
    residual: Float[np.ndarray, " rows"]
    records: tuple[Record, ...]
    response: Response

    @classmethod
    def of(
        cls, refinement: Refinement, records: Sequence[Record], spans: Sequence[Span], substeps: int
    ) -> "LinearisedRuns":
        """Of a refinement."""
        plant = refinement.plant
        problem = weighed(problem_of(plant, records, spans, substeps), refinement.rmse)
        kernel = problem.kernel
        starts = [start.unknowns(kernel.rows, kernel.columns) for start in refinement.starts]
        theta = jnp.asarray(plant.theta)[np.asarray(kernel.free)]
        unknowns = Unknowns(theta, jnp.asarray(np.stack(starts)))
        sensitivities = _flat(signals(unknowns, problem))
        size = unknowns.starts.shape[1]
        space = OwnUnknowns.of(sensitivities[..., :-1], size, _SETTINGS.rank_tolerance)
        residual = space.removed_from(sensitivities[..., -1].reshape(-1, 1))[:, 0]
        time, inputs, y, z = _steps(problem, unknowns)
        response = response_of(
            plant, time, inputs, y[:, :-1], z[:, :-1], np.asarray(problem.steps), substeps
        )
        stages = _stages(problem, inputs, y, z)
        return cls(plant, problem, stages, space, residual, tuple(records), response)

    @classmethod
    def from_refinement(cls, refinement: Refinement) -> "LinearisedRuns":
        """Of a refinement, along the runs that it was fitted to."""
        records = refinement.records
        spans = spans_of(records, refinement.window)
        return cls.of(refinement, records, spans, refinement.substeps)

    def signal_statistics(self, placed: Placed) -> Seen:
        """What the grids of shapes start from."""
        _, u, y, _ = self.stages
        rows = (0, min(placed.row, y.shape[-2] - 1))
        level, rate = (placed.coordinate(y[..., row, :]).ravel() for row in rows)
        drive = placed.channel if placed.through is None else placed.through
        channel = u[..., drive if placed.on_input else 0] if u.shape[-1] else 0.0 * level
        period = max(record.sample_period for record in self.records)
        moving = np.std(level) or 1.0
        band = float(np.std(rate) / moving) if y.shape[-2] > 1 else 1.0 / (10.0 * period)
        duration = max(float(record.time[-1] - record.time[0]) for record in self.records)
        j = placed.output
        measured = [record.outputs[record.output_valid[:, j], j] for record in self.records]
        noise = max(float(record.noise[j]) for record in self.records)
        rmse = 1.0 / max(float(np.asarray(self.problem.scale)[j]), np.finfo(float).tiny)
        return Seen(
            level, rate, np.ravel(channel), placed.row == 0, 0.0, duration, period,
            band or 1.0 / duration, self._peaks(period),
            kind=self.plant.kinds[self.plant.outputs[j]],
            measured_y=np.concatenate(measured), measured_noise=min(noise, rmse),
        )  # fmt: skip

    def _peaks(self, period: float) -> Float[np.ndarray, " peaks"]:
        """Frequencies at which the residual stands out [rad/s]."""
        power = np.abs(np.fft.rfft(self.residual))[1:] ** 2
        best = np.argsort(power)[::-1][: _SETTINGS.peaks]
        ny = len(self.plant.outputs)
        return 2.0 * np.pi * (best + 1) / (len(self.residual) / ny * period)

    def tries(self, placed: Placed) -> list["Try"]:
        """An effect at every shape of its grid, where it says something that is new."""
        statistics = self.signal_statistics(placed)
        if not placed.effect.shows(statistics):
            return []
        grid = np.asarray(placed.effect.grid(statistics), dtype=float)
        if _is_behind(placed.effect):
            columns = self._sensed(placed, grid)
        else:
            forces = self.forces(placed, grid)
            if not forces:
                return []
            columns = self._columns(forces)
        power = np.sum(columns**2, axis=0)
        with np.errstate(invalid="ignore"):  # of shapes that overflow: they say nothing
            columns = self.unknowns.removed_from(columns)
            remaining_power = np.sum(columns**2, axis=0)
        new = np.isfinite(remaining_power) & (remaining_power > _SETTINGS.min_new * power)
        count = columns.shape[1] // len(grid)
        parts = [slice(i * count, (i + 1) * count) for i in range(len(grid))]
        of_level = self.is_stepped(placed)
        return [Try(placed, shape, columns[:, part], of_level)
                for shape, part in zip(grid, parts, strict=True) if np.all(new[part])]  # fmt: skip

    def pair_shares(self, tries: Sequence["Try"]) -> Float[np.ndarray, "tries tries"]:
        """Share of the residual's power that each two of them explain; 0 below the diagonal.

        And of two forms of an effect at one channel, of which a model contains one.
        """
        shares = np.zeros((len(tries), len(tries)))
        if not tries:
            return shares
        stacked = np.concatenate([attempt.columns for attempt in tries], axis=1)
        square, products = stacked.T @ stacked, stacked.T @ self.residual
        size = np.sqrt(np.diagonal(square))
        square, products = square / np.outer(size, size), products / size
        counts = np.array([attempt.columns.shape[1] for attempt in tries])
        first = np.cumsum(counts) - counts
        i, j = np.triu_indices(len(tries), 1)
        sites = [attempt.placed.kind_site for attempt in tries]
        number = np.array([sites.index(site) for site in sites])
        for sizes in sorted(
            set(itertools.product(counts, counts))
        ):  # all pairs of one size at once
            same_size = (number[i] != number[j]) & (counts[i] == sizes[0]) & (counts[j] == sizes[1])
            column_numbers = np.concatenate(
                [first[attempt[same_size], None] + np.arange(count)
                 for attempt, count in zip((i, j), sizes, strict=True)], axis=1
            )  # fmt: skip
            part = square[column_numbers[:, :, None], column_numbers[:, None, :]]
            inverse = np.linalg.pinv(part, rcond=1e-6, hermitian=True)
            shares[i[same_size], j[same_size]] = np.einsum(
                "pa,pab,pb->p", products[column_numbers], inverse, products[column_numbers]
            )
        return shares / self._power

    def share(self, tries: Sequence["Try"]) -> float | None:
        """Share of the residual's power that some effects explain; None where not physical then."""
        gains, explained = self._fitted(tries)
        return None if self._named(tries, gains) is None else explained / self._power

    def candidate(self, tries: Sequence["Try"], number_of_tries: int) -> Candidate | None:
        """Least squares of the residual on some effects; None where they are not physical then."""
        gains, explained = self._fitted(tries)
        values = self._named(tries, gains)
        if values is None:
            return None
        share = explained / self._power
        after = self.residual - np.concatenate([t.columns for t in tries], axis=1) @ gains
        count = sum(max(len(attempt.placed.effect.parameters), 1) for attempt in tries)
        chance = _chance(share, after, len(self.plant.outputs), count)
        placed = tuple(attempt.placed for attempt in tries)
        return Candidate(placed, values, share, min(number_of_tries * chance, 1.0))

    @cached_property
    def _power(self) -> float:
        """Sum of the squares of the residual."""
        return float(self.residual @ self.residual)

    def _fitted(self, tries: Sequence["Try"]) -> tuple[Float[np.ndarray, " gains"], float]:
        """Gains by least squares, and the sum of squares that they take from the residual."""
        columns = [attempt.columns for attempt in tries]
        square = np.block([[one.T @ other for other in columns] for one in columns])
        products = np.concatenate([one.T @ self.residual for one in columns])
        gains = np.linalg.pinv(square, rcond=1e-12, hermitian=True) @ products
        return gains, float(gains @ products)

    def _named(
        self, tries: Sequence["Try"], gains: Float[np.ndarray, " gains"]
    ) -> dict[str, float] | None:
        """Parameters of these gains by name; None where they are not physical."""
        values: dict[str, float] = {}
        for attempt in tries:
            own_gains, gains = gains[: attempt.columns.shape[1]], gains[attempt.columns.shape[1] :]
            if not attempt.physical(own_gains):
                return None
            values |= attempt.named(own_gains)
        return values

    def forces(self, placed: Placed, grid: np.ndarray) -> list[np.ndarray]:
        """What the effect adds to y^(r) along the runs, (runs, samples, 3, ny).

        Of each shape of a grid, for each gain.
        """
        if isinstance(placed.effect, AbstractParameterEffect | AbstractCascade):
            return self._with_changed_model(placed, grid)
        if not isinstance(placed.effect, AbstractTerm):
            return [self._changed(placed, shape) for shape in grid]
        if not len(grid):
            return []
        t, u, y, _ = self.stages
        effect = placed.effect
        has_rate = placed.row < y.shape[-2]
        rate = placed.coordinate(y[..., placed.row, :]) if has_rate else 0.0 * t
        level = placed.coordinate(y[..., 0, :])
        channel = u[..., 0] if u.shape[-1] else 0.0 * t
        signals = tuple(np.ravel(signal) for signal in (t, level, rate, channel))
        states = np.zeros((len(grid), t.size, 0))
        if effect.states:
            period = float(np.mean(t[:, 0, 2] - t[:, 0, 0]))
            courses = [
                np.asarray(effect.states_along(level, rate, period, shape)) for shape in grid
            ]
            states = np.moveaxis(np.reshape(courses, (len(grid), effect.states, -1)), 1, 2)
        rows = signals, (_as_rows(y), _as_rows(u))
        terms = along(UnitTerms(effect), ("rows", "grid", "grid rows"), rows, grid, states)
        terms = np.moveaxis(terms, 1, 2).reshape(-1, *t.shape, 1)
        return list(terms * self._pushes(placed))

    def _pushes(self, placed: Placed) -> np.ndarray:
        """What one unit of an effect adds to y^(r) of each output, (runs, samples, 3, ny)."""
        if placed.through is None:
            return np.arange(len(self.plant.outputs)) == placed.output
        return _pushed(self.plant, self.stages, placed.through)

    def _changed(self, placed: Placed, shape: np.ndarray) -> np.ndarray:
        """f with the changed input less f."""
        t, u, y, z = self.stages
        effect, i = placed.effect, placed.channel
        new = np.array(u)
        if self.is_stepped(placed):
            new[..., i] += self._late_step(placed, shape)[..., None]
        elif isinstance(effect, AbstractActuator):
            mean = (u[..., 0, :] + 4.0 * u[..., 1, :] + u[..., 2, :]) / 6.0
            for run, drives in enumerate(placed.drives(mean)):
                late = effect.sampled(t[run, :, 1], drives, np.reshape(shape, (1, -1)))[0]
                new[run, ..., i] += (late - mean[run, :, i])[:, None]
        else:
            assert isinstance(effect, AbstractInputEffect)
            along_runs = (t, y[..., 0, 0], y[..., min(1, y.shape[-2] - 1), 0], u[..., i])
            signals = tuple(np.ravel(signal) for signal in along_runs)
            axes = ("rows", "fixed", "fixed")
            changed = along(ChangedInput(effect), axes, signals, shape, np.zeros(0))
            new[..., i] = changed.reshape(t.shape)
        return _drift(self.plant, t, new, y, z) - self._unchanged

    def is_stepped(self, placed: Placed) -> bool:
        """Whether an actuator acts on an input that stands still: it may have risen before.

        A step response that begins with its step tells of a lag as well as another one does. Its
        gain is then the level of the input before the records, less that in them.
        """
        effect = placed.effect
        linear = isinstance(effect, AbstractActuator) and effect.is_linear and not effect.has_driver
        return linear and bool(self._still[placed.channel])

    @cached_property
    def _still(self) -> Bool[np.ndarray, " nu"]:
        """Which inputs stand still along each run."""
        return ~np.any(np.ptp(self.stages[1], axis=(1, 2)), axis=0)

    def _late_step(self, placed: Placed, shape: np.ndarray) -> Float[np.ndarray, "runs samples"]:
        """What is left behind an actuator of a unit level before each record."""
        assert isinstance(placed.effect, AbstractActuator)
        t, left = self.stages[0], np.zeros(self.stages[0].shape[:2])
        for run in np.flatnonzero(np.asarray(self.problem.declared)):
            middles = t[run, :, 1]
            times = np.concatenate([2.0 * middles[:1] - middles[1:2], middles])
            level = np.concatenate([[1.0], np.zeros(len(middles))])
            left[run] = placed.effect.sampled(times, level, np.reshape(shape, (1, -1)))[0, 1:]
        return left

    def _with_changed_model(self, placed: Placed, grid: np.ndarray) -> list[np.ndarray]:
        """f of a changed model less f; none where that changes internal states, too."""
        start = dict(zip(placed.names, grid[-1].tolist(), strict=True))
        plant = augmented(self.plant, [placed], start)
        rates, new_rates = (_inner_rates(model, *self.stages) for model in (self.plant, plant))
        if not np.array_equal(rates, new_rates):
            return []
        count = len(self.plant.names)
        thetas = (np.concatenate([plant.theta[:count], shape]) for shape in grid)
        drifts = (_drift(plant.with_parameters(theta), *self.stages) for theta in thetas)
        return [drift - self._unchanged for drift in drifts]

    def contribution(self, name: str) -> np.ndarray:
        """What a parameter of the plant adds to y^(r), beside zero, (runs, samples, 3, ny)."""
        reduced = self.plant.with_parameters({name: 0.0})
        with np.errstate(all="ignore"):
            return self._unchanged - _drift(reduced, *self.stages)

    @cached_property
    def _unchanged(self) -> np.ndarray:
        """f of the plant along the runs."""
        return _drift(self.plant, *self.stages)

    def _sensed(self, placed: Placed, grid: np.ndarray) -> Columns:
        """What a sensor behind the output does to it at each shape, weighed."""
        assert isinstance(placed.effect, AbstractCascade)
        t, _, y, _ = self.stages
        j, period = placed.channel, float(np.mean(t[:, 0, 2] - t[:, 0, 0]))
        y = np.concatenate([y[..., 0, 0, j], y[:, -1:, 2, 0, j]], axis=1)
        scale, use = np.asarray(self.problem.scale), self.problem.use
        columns = np.zeros((*use.shape, len(grid)))
        for k, shape in enumerate(grid):
            columns[..., j, k] = placed.effect.outputs_along(y, period, shape) - y
        columns = np.where(use[..., None], scale[:, None] * columns, 0.0)
        return columns.reshape(-1, len(grid))

    def _columns(self, forces: Sequence[np.ndarray]) -> Columns:
        """Weighed slopes of all outputs with the gains of some forces."""
        stacked = np.stack(forces, axis=-1)
        pushed = np.flatnonzero(np.any(stacked, axis=(0, 1, 2, 4))).tolist() or [0]
        moved = sum(self.response.to(stacked[..., k, :], k) for k in pushed)
        scale, use = np.asarray(self.problem.scale)[:, None], self.problem.use[..., None]
        return np.where(use, scale * moved, 0.0).reshape(-1, len(forces))


@dataclass(frozen=True)
class Try:
    """An effect at one shape: what its gains do to the errors beside the model's own unknowns.

    Attributes:
        placed: the effect.
        shape: values of its shapes.
        columns: of the errors, with each gain.
        of_level: whether the gain is a level of the input before the records, of either sign.
    """

    placed: Placed
    shape: Float[np.ndarray, " shapes"]
    columns: Columns
    of_level: bool = False

    def named(self, gains: np.ndarray) -> dict[str, float]:
        """Its parameters."""
        values = [*(gains if self.placed.effect.gains else ()), *self.shape]
        return dict(zip(self.placed.names, (float(value) for value in values), strict=True))

    def physical(self, gains: np.ndarray) -> bool:
        """Whether all parameters are within their ranges, and a changed input has a likely gain."""
        effect = self.placed.effect
        values = self.named(gains).values()
        pairs = zip(values, effect.parameters, strict=True)
        allowed = all(parameter.lower <= value <= parameter.upper for value, parameter in pairs)
        if effect.gains or self.of_level:
            return allowed
        return allowed and bool(_SETTINGS.min_change < gains[0] < _SETTINGS.max_change)


def _is_behind(effect: AbstractEffect) -> bool:
    """Whether an effect changes what is measured of a free run, by a formula."""
    formula = AbstractCascade.outputs_along
    return isinstance(effect, AbstractCascade) and type(effect).outputs_along is not formula


def is_tested(effect: AbstractEffect) -> bool:
    """Whether a score test knows what the effect does to free runs.

    Args:
        effect: any.
    """
    if isinstance(effect, AbstractCascade):
        return _is_behind(effect) or effect.states == 0
    if isinstance(effect, AbstractTerm) and effect.states:
        return type(effect).states_along is not AbstractTerm.states_along
    known = AbstractTerm | AbstractInputEffect | AbstractActuator | AbstractParameterEffect
    return isinstance(effect, known) and effect.states == 0


def _steps(problem: Problem, unknowns: Unknowns) -> tuple[np.ndarray, ...]:
    """Start, inputs, y and z of all steps of all runs; one more state, at their end.

    Inputs are those behind the plant's delays and lags.
    """
    plant, tables = problem.kernel.plant, np.asarray(problem.tables)
    nu, h = len(plant.inputs), np.asarray(problem.steps)
    time, inputs = tables[:, :-1, 0], tables[:, :-1, 1 : 1 + 3 * nu]
    inputs = inputs.reshape(*time.shape, 3, nu)
    last = tables[:, -1, 1 : 1 + nu]
    theta, friction = np.asarray(problem.theta), problem.kernel.friction
    if problem.places is not None:
        acted = np.asarray(driven(problem, theta, unknowns.starts).inputs)
        inputs, last = acted[:, :-1], acted[:, -1, 0]
    starts = problem.kernel.started(unknowns.starts, theta, problem.declared)
    parts = []
    for i in range(len(tables)):
        run_drive = Drive(time[i], np.asarray(h[i]), inputs[i], 1, last[i])
        parts.append(_states(plant, run_drive, State(starts.y[i], starts.z[i]), friction))
    y, z = (np.stack(part) for part in zip(*parts, strict=True))
    return time, inputs, y, z


def _states(
    plant: Plant, driven_by: Drive, start: State, friction: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """y and z of a run before each step and after the last."""
    drives, starts = jax.tree.map(lambda part: np.asarray(part)[None], (driven_by, start))
    x = states_along(plant, drives, starts, friction)
    return np.asarray(x.y)[0], np.asarray(x.z)[0]


def _stages(problem: Problem, inputs: np.ndarray, *states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Times, inputs and states of all runs at the start, the middle and the end of each sample."""
    n, h = problem.substeps, np.asarray(problem.steps)[:, None, None]
    ends_before, starts_after = (
        (n - 1) // 2,
        n // 2,
    )  # steps whose ends and starts are nearest to the middle
    first = np.asarray(problem.tables)[:, :-1:n, 0, None]
    time = first + n * h * np.array([0.0, 0.5, 1.0])
    middle = inputs[:, starts_after::n, 0 if starts_after > ends_before else 1]
    u = np.stack([inputs[:, ::n, 0], middle, inputs[:, n - 1 :: n, 2]], axis=2)

    def at(values: np.ndarray) -> np.ndarray:
        ends = values[:, 1:]
        middle = 0.5 * (ends[:, ends_before::n] + values[:, starts_after:-1:n])
        return np.stack([values[:, :-1:n], middle, ends[:, n - 1 :: n]], axis=2)

    return time, u, *(at(state) for state in states)


def _rates(plant: Plant, row: tuple[Any, ...], u: Any) -> Any:
    t, y, z = row
    return plant.derivative(t, State(y, z), u, jnp.asarray(plant.theta))


def _pushed(plant: Plant, stages: tuple[np.ndarray, ...], i: int) -> np.ndarray:
    """∂f/∂u_i along runs, (runs, samples, 3, ny)."""
    t, u, y, z = map(_as_rows, stages)
    slopes = slopes_along(_rates, ("fixed", "rows", "rows"), 2, plant, (t, y, z), u)
    return slopes[..., i].reshape(*stages[0].shape, -1)


def _drift(plant: Plant, *stages: np.ndarray) -> np.ndarray:
    """f along runs, of times, inputs, y and z, (runs, samples, 3, ny)."""
    t, u, y, z = map(_as_rows, stages)
    f = along(_rates, ("fixed", "rows", "rows"), plant, (t, y, z), u)
    return f.reshape(*stages[0].shape, -1)


def _inner_rates(plant: Plant, *stages: np.ndarray) -> np.ndarray:
    """g along runs; empty without internal states."""
    if plant.internal is None:
        return np.zeros(0)
    t, u, y, z = map(_as_rows, stages)
    return along(_rates_inside, ("fixed", "rows"), plant, (t, y, z, u))


def _rates_inside(plant: Plant, row: tuple[Any, ...]) -> Any:
    t, y, z, u = row
    return plant.internal_rate(t, State(y, z), u, jnp.asarray(plant.theta))


def _as_rows(array: np.ndarray) -> np.ndarray:
    """Runs, samples and their three instants on one axis."""
    return array.reshape(math.prod(array.shape[:3]), *array.shape[3:])


def _flat(sensitivities: np.ndarray) -> Float[np.ndarray, "runs rows size"]:
    return sensitivities.reshape(len(sensitivities), -1, sensitivities.shape[-1])


def _chance(share: float, after: np.ndarray, ny: int, parameters: int) -> float:
    """Probability of as large a share by chance: likelihood ratio of the independent samples."""
    from scipy.special import chdtrc

    independent = len(after) / ny / correlation_time(after.reshape(-1, ny))
    return float(chdtrc(parameters, -independent * np.log(max(1.0 - share, 1e-300))))
