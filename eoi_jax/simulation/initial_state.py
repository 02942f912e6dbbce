"""Initial states of free runs: least squares of each run over its first samples.

Outputs and their derivatives start from local polynomials, or where the plant knows them; internal
states from where the model declares them, if it does, or in a window from where a run along the
whole record has them: a few samples say little of a slow store that is not measured
(`planned_runs.py` decides where they count). Delays and lags of inputs start as if these had always
been at their first values. Gauss-Newton with halved steps (`simulation/gauss_newton.py`) goes on
from there; the derivatives of the errors are differences, for one of the simulation would take
longer to compile than all else.
All runs are simulated side by side.

Outputs count by the noise of their sensors first, then by what the fit leaves of each where that is
more, until their weights settle: a noisy speed does not spoil the start of an exact encoder, and an
output that the model misses does not rule the start.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.data.cleaning import channel_groups
from eoi_jax.models.augmented import slope_followers
from eoi_jax.models.plant import Plant, State
from eoi_jax.models.start_weights import proportional_starts
from eoi_jax.simulation.chained_runs import Chain
from eoi_jax.simulation.gauss_newton import gauss_newton
from eoi_jax.simulation.integrator import Drive

Samples = Float[np.ndarray, "time ny"]
Starts = Float[np.ndarray, "runs unknowns"]
Trials = Float[np.ndarray, "runs trials unknowns"]


@dataclass(frozen=True)
class InitialStateSettings:
    """Numbers of the least squares."""

    max_rounds: int = 20  # of Gauss-Newton; a linear plant needs one
    trials: int = 5  # starts; and lengths of a step, each half of the one before
    difference: float = 1e-6  # step of derivatives, over the size of the variable
    min_reduction: float = 1e-5  # of the squared error, relative: less is 0.02 standard errors
    level: float = 0.005  # of significance, from which on internal states are fitted
    past: float = 1e-3  # share of a level before the record below which a run does not see it
    rounding: float = 1e-9  # errors, over the spread of an output, that are none
    turns: int = 3  # in which an output and a difference from it settle: the second is near
    weighings: int = 8  # fits with other weights of the outputs, at most
    settled: float = 0.2  # relative change of the weights, which then costs 1 % of the accuracy


_SETTINGS = InitialStateSettings()


@dataclass(frozen=True)
class Run:
    """What all runs share."""

    plant: Plant
    friction: tuple[int, ...]
    substeps: int

    @cached_property
    def internal(self) -> int:
        """Number of internal states."""
        return len(self.plant.initial_internal)

    @cached_property
    def owned(self) -> tuple[np.ndarray, np.ndarray]:
        """`owned` of the plant."""
        return owned(self.plant)

    @cached_property
    def proportional(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`proportional_starts` of the plant."""
        return proportional_starts(self.plant.internal_initial, self.internal)

    @cached_property
    def chain(self) -> Chain:
        """Simulates the runs."""
        return Chain(self.plant, self.friction)


def initial_states(
    run: Run,
    heads: Drive,
    y: Float[np.ndarray, "runs time ny"],
    valid: Bool[np.ndarray, "runs time ny"],
    noise: Float[np.ndarray, "runs ny"],
    past: Float[np.ndarray, "runs steps 3 nu past"] | None = None,
    begins: Bool[np.ndarray, " runs"] | None = None,
    owners: Int[np.ndarray, " runs"] | None = None,
) -> Starts:
    """Least squares of each free run over its first samples, by Gauss-Newton.

    Args:
        run: what all runs share.
        heads: what drives the first samples of each run.
        y: outputs there.
        valid: which of them were measured.
        noise: standard deviation of the noise of their sensors (`Record.noise`).
        past: how the inputs there change with their levels before the record (`past_slopes`), of
            a plant with delays or lags of inputs.
        begins: which runs begin with their record: known starts of the plant hold there. None: no
            run does.
        owners: number of the record of each run, in rising order: outputs count alike in the runs
            of one record. None: all are of one.

    Returns:
        Outputs and their derivatives, then z, then the levels before the record, less the first
        values of the inputs.
    """
    return window_starts(run, heads, y, valid, noise, past, begins, None, owners)[0]


def window_starts(
    run: Run,
    heads: Drive,
    y: Float[np.ndarray, "runs time ny"],
    valid: Bool[np.ndarray, "runs time ny"],
    noise: Float[np.ndarray, "runs ny"],
    past: Float[np.ndarray, "runs steps 3 nu past"] | None,
    begins: Bool[np.ndarray, " runs"] | None,
    carried: State | None,
    owners: Int[np.ndarray, " runs"] | None = None,
    by_spread: bool = False,
) -> tuple[Starts, Starts]:
    """Initial states as the first samples of each run tell them, and as a longer run has them.

    Args:
        run: as of `initial_states`, like the next six.
        heads: what drives the first samples.
        y: outputs there.
        valid: which of them were measured.
        noise: of their sensors.
        past: how the inputs there change with their levels before the record.
        begins: which runs begin with their record.
        carried: states that a run along the whole record has at each start; not finite ones do not
            count. None: there is no such run.
        owners: as of `initial_states`.
        by_spread: whether outputs count by their spread to begin with, and not by their noise: of
            outputs that contradict each other the fits may end with either one.

    Returns:
        Values as of `initial_states`: with the internal states of the longer run unless the first
        samples tell otherwise; with these whatever the first samples tell.
    """
    period = float(heads.step[0]) * heads.substeps
    z = run.plant.initial_internal
    starts = np.stack(
        [
            _polynomial_starts(run.plant, outputs, mask, period)
            for outputs, mask in zip(y, valid, strict=True)
        ]
    )
    if past is not None:
        past = np.where(
            np.max(np.abs(past), axis=(1, 2, 3), keepdims=True) < _SETTINGS.past, 0.0, past
        )
    declared = np.concatenate([z, np.zeros(0 if past is None else past.shape[-1])])
    shape = (*starts.shape[:2], len(declared))
    starts = np.concatenate([starts, np.broadcast_to(declared, shape)], axis=-1)
    measured = np.arange(starts.shape[-1]) < starts.shape[-1] - len(declared)
    fixed = known_starts(run.plant, begins, starts.shape[::2])
    if fixed is not None:
        starts = np.where(np.isfinite(fixed)[:, None], fixed[:, None], starts)
    owners = np.zeros(len(y), int) if owners is None else owners
    pairs = () if past is None else moving_pairs(past)
    spread = _spread(y, owners)
    floor = np.maximum(noise, _SETTINGS.rounding * spread)
    single = y.shape[-1] == 1  # of a single output it does not matter
    size = spread if single or by_spread else floor
    first_samples = _Heads(run, heads, y, valid, period, size, past, fixed, pairs)
    for _ in range(_SETTINGS.weighings):
        fits = _fitted(first_samples, starts, measured, carried)
        size = np.maximum(_residual_size(first_samples, fits[0], owners), floor)
        change = np.log(size / first_samples.size)
        change -= np.mean(change, axis=1, keepdims=True)  # of all outputs alike it is none
        unsettled = np.max(np.abs(change), axis=1, keepdims=True) > _SETTINGS.settled
        if not np.any(unsettled):
            break
        first_samples = replace(first_samples, size=np.where(unsettled, size, first_samples.size))
    return fits


def _spread(
    y: Float[np.ndarray, "runs time ny"], owners: Int[np.ndarray, " runs"]
) -> Float[np.ndarray, "runs ny"]:
    """Standard deviation of the outputs, of all runs of a record together."""
    variances = np.split(np.var(y, axis=1), np.flatnonzero(np.diff(owners)) + 1)
    spread = [np.sqrt(np.mean(part, axis=0)) for part in variances]
    each_run = np.repeat(spread, [len(part) for part in variances], axis=0)
    return np.where(each_run > 0, each_run, 1.0)


def _residual_size(
    heads: "_Heads",
    values: Starts,
    owners: Int[np.ndarray, " runs"],
) -> Float[np.ndarray, "runs ny"]:
    """Standard deviation of what a fit leaves of each output.

    The median over the runs of a record: some may meet what the model lacks, or diverge.

    Args:
        heads: the first samples.
        values: of the fit.
        owners: number of the record of each run.
    """
    if heads.size.shape[1] == 1:
        return heads.size
    degrees = np.sum(heads.valid, axis=1) - np.asarray(heads.run.plant.degrees)
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
        error = heads.errors(values[:, None])[1].reshape(heads.y.shape) * heads.size[:, None]
        variance = np.sum(error**2, axis=1) / np.maximum(degrees, 1)
    size = np.empty_like(heads.size)
    for owner in np.unique(owners):
        size[owners == owner] = np.sqrt(np.median(variance[owners == owner], axis=0))
    return np.where(np.isfinite(size), size, heads.size)


def _fitted(
    heads: "_Heads", starts: Trials, measured: Bool[np.ndarray, " unknowns"], carried: State | None
) -> tuple[Starts, Starts]:
    """`window_starts` with some weights of the outputs."""
    plant = heads.run.plant
    estimated, internal = measured.copy(), slice(int(np.sum(measured)), None)
    estimated[internal][: heads.run.internal] = plant.free_internal
    cost, values = _descend(heads, starts, estimated)
    decided = not np.any(plant.open_internal & ~plant.free_internal)
    if decided and heads.past is None and (carried is None or not np.any(plant.open_internal)):
        return values, values
    return _with_internal(heads, _Fit(cost, values), starts, measured, carried)


class _Fit(NamedTuple):
    """Squared error over the first samples, and initial values, of each run."""

    cost: Float[np.ndarray, " runs"]
    values: Starts


def _with_internal(
    heads: "_Heads",
    fit: _Fit,
    starts: Trials,
    measured: Bool[np.ndarray, " unknowns"],
    carried: State | None,
) -> tuple[Starts, Starts]:
    """Initial values with those of internal states, and with levels before the record.

    Internal states are where the model starts them, or where a run along the record has them, and
    inputs have always been at their first values, unless the first samples tell (F-test): from a
    few noisy ones, or of a model that lacks something, they would come out anywhere.

    Args:
        heads: the first samples.
        fit: with internal states where the model starts them.
        starts: of that fit.
        measured: which unknowns are outputs and their derivatives.
        carried: as of `window_starts`.

    Returns:
        As of `window_starts`.
    """
    from scipy.special import fdtri  # only plants with internal states need it

    opened = np.zeros(len(measured), dtype=bool)
    first = int(np.sum(measured))
    internal = slice(first, first + heads.run.internal)
    opened[internal] = heads.run.plant.open_internal
    unknown = np.sum(opened)
    if heads.past is not None:
        unknown = unknown + np.sum(np.any(heads.past != 0, axis=(1, 2, 3)), axis=1)
    rest = np.maximum(np.sum(heads.valid, axis=(1, 2)) - first - unknown, 1)
    told = 1.0 / (1.0 + unknown * fdtri(unknown, rest, 1.0 - _SETTINGS.level) / rest)
    cost, values = fit
    going_on = values
    if carried is not None:
        carried_fit, follows = _with_carried(heads, starts, measured, opened[internal], carried)
        going_on = np.where(follows[:, None], carried_fit.values, values)
        goes_on = told * carried_fit.cost <= cost
        cost = np.where(goes_on, carried_fit.cost, cost)
        values = np.where(goes_on[:, None], carried_fit.values, values)
    free = measured | opened
    free[internal.stop :] = True
    freed_cost, freed_values = _descend(heads, values[:, None], free)
    begun = np.where((freed_cost < told * cost)[:, None], freed_values, values)
    return begun, begun if carried is None else going_on


def _with_carried(
    heads: "_Heads",
    starts: Trials,
    measured: Bool[np.ndarray, " unknowns"],
    opened: Bool[np.ndarray, " nz"],
    carried: State,
) -> tuple[_Fit, Bool[np.ndarray, " runs"]]:
    """Outputs fitted beside the internal states of a longer run, and which runs have such ones.

    A difference from an output changes with where that starts, which is known with these states
    only: both settle in turn.

    Args:
        heads: the first samples.
        starts: of the fit.
        measured: which unknowns are outputs and their derivatives.
        opened: which internal states may start at any value.
        carried: states of the longer run, where each run starts.
    """
    falls, moved, z = slope_followers(heads.run.plant), np.array(starts), carried.z
    first = int(np.sum(measured))
    internal = slice(first, first + heads.run.internal)
    for _ in range(_SETTINGS.turns if np.any(falls) else 1):
        usable = opened & np.all(np.isfinite(z), axis=1, keepdims=True)
        moved[..., internal] = np.where(usable[:, None], z[:, None], starts[..., internal])
        fit = _Fit(*_descend(heads, moved, measured))
        with np.errstate(invalid="ignore", over="ignore"):  # of a run that diverges
            risen = states_of(heads.run, fit.values).y[:, 0] - carried.y[:, 0]
            z = carried.z - risen @ falls.T
    return fit, np.isfinite(fit.cost) & np.any(usable, axis=1)


class _Start(NamedTuple):
    """Initial values of one run.

    Attributes:
        run: its number.
        cost: squared error over its first samples; infinite where the run diverges.
        values: of the unknowns, shape (unknowns,).
        error: over the first samples and the outputs, shape (rows,).
    """

    run: int
    cost: float
    values: Float[np.ndarray, " unknowns"]
    error: Float[np.ndarray, " rows"]


def _descend(
    heads: "_Heads", starts: Trials, free: Bool[np.ndarray, " unknowns"]
) -> tuple[Float[np.ndarray, " runs"], Starts]:
    """Gauss-Newton over some of the unknowns, each run from its best start.

    Returns:
        The squared error of each run, and its values.
    """
    costs, errors = heads.errors(starts)
    best = np.argmin(costs, axis=1)
    if not np.any(free):  # of outputs that are all functions of internal states
        each_run = np.arange(len(best))
        return costs[each_run, best], starts[each_run, best]
    points = [
        _Start(run, costs[run, i], starts[run, i], errors[run, i]) for run, i in enumerate(best)
    ]

    def linearise(points: list[_Start]) -> list[tuple[np.ndarray, float]]:
        runs, values = _runs_and_values(points)
        errors = np.stack([point.error for point in points])
        slopes = heads.part(runs).slopes(values, errors, free)
        return [_step(*pair, free) for pair in zip(errors, slopes, strict=True)]

    def evaluate(points: list[_Start], steps: list[np.ndarray]) -> list[list[_Start]]:
        # Behind the end of a table outputs show a free start no longer: the better step counts.
        count = 2 if np.any(heads.run.plant.free_internal) else 1
        lengths = 0.5 ** np.arange(_SETTINGS.trials)
        trials = [
            sorted(item, key=lambda start: start.cost)
            for item in _trials(heads, points, steps, lengths[:count])
        ]
        risen = [i for i, (best, *_) in enumerate(trials) if not best.cost < points[i].cost]
        if risen:  # only these look at shorter steps
            lengths = lengths[count:]
            again = [points[i] for i in risen], [steps[i] for i in risen]
            for i, further in zip(risen, _trials(heads, *again, lengths), strict=True):
                trials[i] += further
        return trials

    limits = _SETTINGS.min_reduction, _SETTINGS.max_rounds
    ends = gauss_newton(points, linearise, evaluate, *limits).points
    return np.asarray([end.cost for end in ends]), np.stack([end.values for end in ends])


def _trials(
    heads: "_Heads",
    points: list[_Start],
    steps: list[np.ndarray],
    lengths: Float[np.ndarray, " lengths"],
) -> list[list[_Start]]:
    """Points at shares of a step from each of some points; simulated side by side."""
    runs, values = _runs_and_values(points)
    trials = values[:, None] + np.stack(steps)[:, None] * lengths[:, None]
    costs, errors = heads.part(runs).errors(trials)
    return [
        [_Start(run, *trial) for trial in zip(*parts, strict=True)]
        for run, *parts in zip(runs, costs, trials, errors, strict=True)
    ]


def _runs_and_values(points: list[_Start]) -> tuple[Int[np.ndarray, " points"], Starts]:
    return np.asarray([point.run for point in points]), np.stack([point.values for point in points])


def _step(
    error: Float[np.ndarray, " rows"],
    slopes: Float[np.ndarray, "rows free"],
    free: Bool[np.ndarray, " unknowns"],
) -> tuple[Float[np.ndarray, " unknowns"], float]:
    """Least-squares step on scaled columns, and the fall of the squared error that it predicts.

    What leaves no trace in y stays where it is, and so does all where slopes are not known.
    """
    step = np.zeros(len(free))
    if not np.all(np.isfinite(slopes)):
        return step, 0.0
    size = np.linalg.norm(slopes, axis=0)
    size = np.where(size > 0, size, 1.0)
    step[free] = np.linalg.lstsq(slopes / size, error, rcond=1e-8)[0] / size
    return step, float(step[free] @ (slopes.T @ error))


@dataclass(frozen=True)
class _Heads:
    """The first samples of all runs, to which start states are fitted."""

    run: Run
    heads: Drive
    y: Float[np.ndarray, "runs time ny"]
    valid: Bool[np.ndarray, "runs time ny"]
    period: float
    size: Float[np.ndarray, "runs ny"]  # of the errors of each output
    past: Float[np.ndarray, "runs steps 3 nu past"] | None = None
    fixed: Starts | None = None  # finite where an unknown stays as it is
    pairs: "Pairs" = ()  # `moving_pairs` of the past

    def part(self, runs: Int[np.ndarray, " some"]) -> "_Heads":
        """The first samples of some of the runs."""
        if len(runs) == len(self.y):
            return self
        past = None if self.past is None else self.past[runs]
        fixed = None if self.fixed is None else self.fixed[runs]
        y, valid, size = self.y[runs], self.valid[runs], self.size[runs]
        heads = self._driving(runs)
        return replace(self, heads=heads, y=y, valid=valid, size=size, past=past, fixed=fixed)

    def _driving(self, runs: Int[np.ndarray, " some"]) -> Drive:
        """What drives some of the runs; on the host, where another number is no compilation."""
        heads = self.heads
        time, step, inputs, last = (
            np.asarray(part)[runs] for part in (heads.time, heads.step, heads.inputs, heads.last)
        )
        return Drive(time, step, inputs, heads.substeps, last)

    def errors(self, values: Trials) -> tuple[np.ndarray, Float[np.ndarray, "runs trials rows"]]:
        """Squared error of each trial, infinite where it diverges, and the errors.

        Each output counts by its own size: metres and radians add up to nothing.
        """
        outputs = self._simulated(values)
        error = np.where(self.valid[:, None], self.y[:, None] - outputs, 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            error = error / self.size[:, None, None]
            error = error.reshape(*values.shape[:2], -1)
            cost = np.sum(error**2, axis=-1)
        return np.where(np.isfinite(cost), cost, np.inf), error

    def slopes(
        self, values: Starts, error: Float[np.ndarray, "runs rows"], free: np.ndarray
    ) -> Float[np.ndarray, "runs rows free"]:
        """Minus the derivatives of the errors with the free initial values.

        By differences: a derivative of the simulation would take longer to compile than all else.
        """
        _, errors = self.errors(self._moved(values, free))
        with np.errstate(over="ignore", invalid="ignore"):
            slopes = np.moveaxis(error[:, None] - errors, 1, 2) / self._small(values)[:, None, free]
        if self.fixed is None:
            return slopes
        return np.where(np.isfinite(self.fixed)[:, None, free], 0.0, slopes)  # stays where it is

    def _moved(self, values: Starts, free: np.ndarray) -> Trials:
        return values[:, None] + np.eye(values.shape[1])[free] * self._small(values)[:, None]

    def _small(self, values: Starts) -> Starts:
        """Steps of the differences: a small share of what each initial value is measured by."""
        z = np.abs(values[:, self._reach.shape[1] :])
        unit = np.ones_like(z)
        if self.past is not None:
            levels = np.max(np.abs(self.heads.inputs), axis=(1, 2))
            unit[:, -levels.shape[1] :] = np.where(levels > 0, levels, 1.0)
        size = np.concatenate([self._reach, np.where(z > 0, z, unit)], axis=1)
        return _SETTINGS.difference * size

    @cached_property
    def _reach(self) -> Starts:
        """How far outputs and their derivatives move in each run."""
        rows, columns = owned(self.run.plant)
        reach = np.ptp(self.y, axis=1) + 1e-3 * np.max(np.abs(self.y), axis=1)
        reach = np.where(reach > 0, reach, 1.0)[:, columns]
        return reach / (self.y.shape[1] * self.period) ** rows

    def _simulated(self, values: Trials) -> Float[np.ndarray, "runs trials time ny"]:
        run = self.run
        lanes = values.reshape(-1, values.shape[-1])
        owner = np.repeat(np.arange(len(values)), values.shape[1])
        starts, driving = states_of(run, lanes), self._driving(owner)
        if self.past is not None:
            driving = with_past(driving, self.past, lanes, self.pairs, owner)
        outputs = run.chain.outputs(driving, starts)
        return outputs.reshape(*values.shape[:2], *outputs.shape[1:])


def _polynomial_starts(
    plant: Plant, y: Samples, valid: Bool[np.ndarray, "time ny"], period: float
) -> Float[np.ndarray, "trials owned"]:
    """Outputs and derivatives at the first sample, from polynomials over 1, ½, ¼, … of the head.

    A long stretch averages noise, a short one follows fast motion: the free run decides later.
    The last one is repeated where the head is too short for more.
    """
    degree = plant.relative_degree + 1
    values = np.zeros((_SETTINGS.trials, degree + 1, y.shape[1]))
    for columns, mask in channel_groups(valid):
        values[..., columns] = _polynomials(y[:, columns], mask, degree, period)
    return values[:, *owned(plant)]


def _polynomials(
    y: Samples, valid: Bool[np.ndarray, " time"], degree: int, period: float
) -> Float[np.ndarray, "trials derivatives ny"]:
    """Derivatives at the first sample of outputs that share a mask; zeros where none is valid."""
    factorial = np.cumprod([1.0, *range(1, degree + 1)])
    (samples,) = np.nonzero(valid)
    starts, count, trials = [], len(samples), _SETTINGS.trials
    while count >= min(degree + 1, len(samples)) and count > 0 and len(starts) < trials:
        index = samples[:count]
        # Time in units of the stretch: the columns are then of one size.
        reach = max(float(index[-1]), 1.0)
        powers = np.vander(index / reach, min(degree, count - 1) + 1, increasing=True)
        coefficients = np.zeros((degree + 1, y.shape[1]))
        coefficients[: powers.shape[1]] = np.linalg.lstsq(powers, y[index], rcond=None)[0]
        scale = (factorial / (reach * period) ** np.arange(degree + 1))[:, None]
        starts.append(coefficients * scale)
        count //= 2
    starts = starts or [np.zeros((degree + 1, y.shape[1]))]
    return np.stack([*starts, *[starts[-1]] * (trials - len(starts))])


def owned(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of `State.y` that are states of a plant, output by output."""
    pairs = [(i, j) for j, degree in enumerate(plant.degrees) for i in range(degree)]
    rows, columns = np.asarray(pairs, dtype=int).reshape(-1, 2).T
    return rows, columns


def known_starts(
    plant: Plant, begins: Bool[np.ndarray, " runs"] | None, shape: tuple[int, int]
) -> Starts | None:
    """Known values of the unknowns of runs, NaN where an unknown is none; None if all are unknown.

    Args:
        plant: whose known starts hold where a record begins.
        begins: which runs begin with their record; None: no run does.
        shape: (runs, unknowns), outputs and their derivatives first.
    """
    if begins is None or not plant.start_items or not np.any(begins):
        return None
    values = plant.known_start[owned(plant)]
    fixed = np.full(shape, np.nan)
    fixed[:, : len(values)] = np.where(begins[:, None], values, np.nan)
    return fixed


def states_of(run: Run, values: Starts) -> State:
    """States of which `values` are the unknowns: outputs and derivatives, then z."""
    (rows, columns), (places, leaders, weights) = run.owned, run.proportional
    y = np.zeros((len(values), run.plant.rows, len(run.plant.outputs)))
    y[:, rows, columns] = values[:, : len(rows)]
    z = np.array(values[:, len(rows) : len(rows) + run.internal])
    z[:, places] = weights * z[:, leaders]
    return State(y, z)


Pairs = tuple[tuple[int, int], ...]


def with_past(
    drives: Drive,
    past: Float[np.ndarray, "runs steps 3 nu past"],
    values: Float[np.ndarray, "drives unknowns"],
    pairs: Pairs,
    owners: Int[np.ndarray, " drives"] | None = None,
) -> Drive:
    """What drives runs whose inputs were at other levels before the record.

    Args:
        drives: of each run, if the inputs have always been at their first values.
        past: how the inputs change with these levels.
        values: unknowns of each run, of which the last ones are the levels.
        pairs: as of `moving_pairs`.
        owners: the row of `past` of each drive; None: one each.
    """
    levels = values[:, -past.shape[-1] :]
    inputs = np.array(drives.inputs, dtype=float)
    for i, column in pairs:
        part = past[..., i, column]
        inputs[..., i] += (part if owners is None else part[owners]) * levels[:, column, None, None]
    return Drive(drives.time, drives.step, inputs, drives.substeps, drives.last)


def moving_pairs(past: Float[np.ndarray, "runs steps 3 nu past"]) -> Pairs:
    """Which inputs move with which levels: few of all pairs, as an actuator has one input."""
    moving = np.argwhere(np.any(past != 0.0, axis=(0, 1, 2)))
    return tuple((i, column) for i, column in moving.tolist())
