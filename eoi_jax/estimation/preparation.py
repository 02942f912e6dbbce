"""Preparation of records for passes: filter, sub-steps, and which steps count.

The kernel reads one rectangular batch of steps, made here on the host. `prepare_records` does what
depends on the records only, once for all models of the same outputs; `prepare_steps` does the rest,
for each model.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._checks import check, check_count, check_kind, real
from eoi_jax.data.masks import (
    beyond_starts,
    hold_advice,
    tapered,
    transient_samples,
    usable_steps,
    valid_steps,
)
from eoi_jax.data.record import Record
from eoi_jax.estimation.defaults import (
    check_runs_of_samples,
    default_lowpass,
    default_smoothing,
    default_substeps,
    velocity_noise,
)
from eoi_jax.estimation.free_starts import first_starts
from eoi_jax.estimation.kernel import Steps
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.estimation.observers.per_output import PerOutput
from eoi_jax.estimation.within_samples import follows_model, resampled
from eoi_jax.models.jacobians import entering_outputs
from eoi_jax.models.plant import Plant
from eoi_jax.models.used_inputs import affine_inputs

# Weights rise over this many time constants of F beside steps that do not count.
TAPER = 2.0


def starting_points(plant: Plant, starts: Any) -> Float[np.ndarray, "starts np"]:
    """θ_0 of every start.

    Args:
        plant: the model.
        starts: dicts of parameters, the others nominal, or rows (starts, np); None for the nominal.

    Raises:
        ValueError: no start, an unknown name, a row of wrong length, a value that is not finite.
    """
    if starts is None:
        return np.asarray(plant.theta, dtype=float)[None]
    if isinstance(starts, Mapping):
        starts = [starts]
    check_kind("starts", starts, Iterable, "dicts of parameters, or rows")
    rows = [
        np.asarray(plant.with_parameters(start).theta, dtype=float)
        if isinstance(start, Mapping)
        else _row(start)
        for start in starts
    ]
    check(len(rows) > 0, "starts", "must hold at least one starting point", "none: that is no lane")
    for i, row in enumerate(rows):
        check(
            row.shape == (len(plant.names),) and bool(np.all(np.isfinite(row))),
            f"starts[{i}]",
            f"must give finite values of {', '.join(plant.names)}",
            row,
        )
    return np.stack(rows)


def _row(start: Any) -> Float[np.ndarray, "..."]:
    try:
        return np.asarray(start, dtype=float)
    except (TypeError, ValueError) as error:
        rule = "must be dicts of parameters, or rows of numbers"
        raise ValueError(f"`starts` {rule}, got {start!r}.") from error


def check_observer(plant: Plant, observer: AbstractObserver) -> None:
    """Check that an observer matches the plant's outputs.

    Args:
        plant: with its relative degrees.
        observer: with its gains.

    Raises:
        ValueError: not an observer, one for an output of relative degree 0, another relative
            degree, a gain that is neither one number nor one per output.
    """
    description = "an observer with its gains, such as `SecondOrder(c1, c2, c3)`"
    check_kind("observer", observer, AbstractObserver, description)
    observer_degrees = np.atleast_1d(observer.relative_degree)
    degrees = (
        np.repeat(observer_degrees, len(plant.degrees))
        if len(observer_degrees) == 1
        else observer_degrees
    )
    for name, degree, of_observer in zip(plant.outputs, plant.degrees, degrees, strict=False):
        check(
            degree > 0 or of_observer == 0,
            "observer",
            f"must be left out for {name}, a function of the states (relative degree 0), which "
            "takes none",
            type(observer).__name__,
            "Put `Measurement()` in its place in `PerOutput`, or leave the observer out.",
        )
    check(
        tuple(degrees) == plant.degrees,
        "observer",
        f"must have the relative degree of the plant's outputs, {plant.degrees}",
        f"{type(observer).__name__} of {tuple(int(degree) for degree in degrees)}",
        "Leave it out to have one chosen; `PerOutput` mixes several.",
    )
    parts = observer.observers if isinstance(observer, PerOutput) else (observer,)
    size = len(plant.outputs) if len(parts) == 1 else 1
    for part in parts:
        for name, value in vars(part).items():
            check(
                not isinstance(value, np.ndarray | jax.Array) or np.shape(value) in ((), (size,)),
                f"observer.{name}",
                f"must be one number or {size}, one an output",
                f"shape {np.shape(value)}",
            )


def check_preparation(transient: Any, substeps: Any, smoothing: Any) -> None:
    """Check the choices for the preparation of records; None where they are left to the library.

    Args:
        transient: time not scored at the start of each record [s].
        substeps: per sample.
        smoothing: cut-off [rad/s], False for none.

    Raises:
        ValueError: a transient that is not a time, sub-steps that are not a count, a smoothing that
            is not a cut-off (True is none).
    """
    is_valid = transient is None or 0.0 <= real(transient) < np.inf
    check(is_valid, "transient", "must be a time ≥ 0 in seconds", transient)
    if substeps is not None:
        check_count("substeps", substeps)
    # Not `in (None, False)`: comparing an array gives no single truth value.
    is_valid = smoothing is None or smoothing is False
    is_valid = is_valid or (smoothing is not True and 0.0 < real(smoothing) < np.inf)
    check(is_valid, "smoothing", "must be a cut-off > 0 in rad/s, or False", smoothing)


@dataclass(frozen=True)
class PreparedRecords:
    """Records prepared for passes of any model with the same outputs.

    Attributes:
        records: bridged (`Record.bridged`), and smoothed if `smoothing` is not False.
        fine: the same with sub-steps.
        inputs: during each step of `fine`, one array (S, nu) per record.
        velocity_noise: as `defaults.velocity_noise`, per record.
        lowpass: F.
        substeps: per sample.
        smoothing: its cut-off [rad/s], False for none.
        explicit: whether for an observer in explicit form.
        reasons: why filter, smoothing and sub-steps were chosen.
    """

    records: tuple[Record, ...]
    fine: tuple[Record, ...]
    inputs: tuple[Float[np.ndarray, "_ nu"], ...]
    velocity_noise: tuple[Float[np.ndarray, " ny"], ...]
    lowpass: LowPass
    substeps: int
    smoothing: float | bool
    explicit: bool
    reasons: tuple[str, ...]

    def follows(self, plant: Plant) -> bool:
        """Whether a model says how outputs move between the samples (`within_samples.py`)."""
        if self.smoothing or self.substeps == 1:
            return False
        return any(follows_model(plant, record) for record in self.records)

    def interpolated_by(self, plant: Plant) -> "PreparedRecords":
        """The same with outputs between the samples as this model moves, at its parameters."""
        if not self.follows(plant):
            return self
        fine = (resampled(plant, record, self.substeps) for record in self.records)
        return replace(self, fine=tuple(fine))


def prepare_records(
    plant: Plant,
    records: tuple[Record, ...],
    lowpass: LowPass | None = None,
    smoothing: float | bool | None = None,
    substeps: int | None = None,
    explicit: bool = False,
) -> PreparedRecords:
    """Choose filter, smoothing and sub-steps where they are None, and apply them.

    Args:
        plant: with its relative degrees.
        records: checked against the plant.
        lowpass: F.
        smoothing: its cut-off [rad/s], False for none.
        substeps: per sample.
        explicit: whether for an observer in explicit form.
    """
    reasons: list[str] = []
    rule = "must have no states that change at samples: passes do not follow them"
    check(plant.sampled is None, "plant", rule, plant.name, "Ask `refine`.")
    check(
        not (smoothing and plant.has_algebraic),
        "smoothing",
        "must be False where an output is a function of the states (relative degree 0): smoothed, "
        "it no longer belongs to the input at the same instant",
        smoothing,
    )
    records = tuple(record.bridged for record in records)
    check_kind("lowpass", lowpass, (LowPass, NoneType), "a filter `LowPass(cutoff, order)`")
    check_runs_of_samples(records)
    if lowpass is None:
        lowpass, reason = default_lowpass(plant, records)
        reasons.append(reason)
    if smoothing is None:
        smoothing, reason = default_smoothing(plant, records, lowpass.cutoff)
        reasons += reason
    noise = tuple(velocity_noise(plant.degrees, record, smoothing) for record in records)
    if smoothing:
        records = tuple(smoothed(plant, record, smoothing) for record in records)
    if substeps is None:
        substeps, reason = (1, []) if explicit else default_substeps(plant, records, lowpass.cutoff)
        reasons += reason
    fine = tuple(record.resample(substeps) for record in records)
    inputs = tuple(step_inputs(record, explicit) for record in fine)
    prepared = PreparedRecords(
        records, fine, inputs, noise, lowpass, substeps, smoothing, explicit, tuple(reasons)
    )
    return prepared.interpolated_by(plant)


def smoothed(plant: Plant, record: Record, cutoff: float) -> Record:
    """Outputs behind a zero-phase low-pass, and with them the inputs in which the plant is affine.

    Those the plant passes on as the filter does. Of any other the filtered square, say, is not the
    square of what is filtered, nor the filtered ramp that of a limited rate: it stays as it is, and
    F, far below the cut-off, sees no difference.

    Args:
        plant: the model.
        record: with its inputs, or without any.
        cutoff: as of `Record.smooth`.
    """
    pairs = zip(record.input_names, affine_inputs(plant), strict=False)
    return record.smooth(cutoff, [name for name, affine in pairs if affine])


def step_inputs(record: Record, explicit: bool) -> Float[np.ndarray, "steps nu"]:
    """The inputs as an observer reads them: at the start of each step, or in its middle."""
    return record.inputs[:-1] if explicit else record.midpoint_inputs()


def prepare_steps(
    plant: Plant,
    records: Sequence[Record],
    inputs: Sequence[Float[np.ndarray, "_ nu"]],
    taps: int,
    transient: float,
    memory: float,
    velocity_noise: Sequence[Float[np.ndarray, " ny"]],
    explicit: bool,
    taper: float,
    duration: float | None = None,
    substeps: int = 1,
    undirected: Plant | None = None,
    z_start: Float[np.ndarray, "records nz _"] | None = None,
) -> Steps:
    """The batch of steps for `run_pass`, padded to the longest record.

    Args:
        plant: whose dry friction decides which steps count.
        records: uniformly sampled.
        inputs: during each step, see `step_inputs`.
        taps: length of the observer's moving average [steps].
        transient: time not scored at the start of each record [s].
        memory: of the filter [s]; scores further apart are independent.
        velocity_noise: as `defaults.velocity_noise`, per record.
        explicit: whether the observer reaches sliding slowly (then each gap costs a transient).
        taper: time over which weights rise from zero next to a step that does not count [s].
        duration: of all records of the estimate [s], if these are only part of them.
        substeps: steps per sample; outputs of relative degree 0 count at samples only.
        undirected: the plant of the records, if `plant` has further inputs.
        z_start: as of `Steps`; None: by free runs over the first samples, where starts are free.
    """
    length = max(len(record) for record in records) - 1
    enters = entering(plant, records, inputs)
    jumps = plant.jumps  # probed once, however many records there are
    total = duration or sum(len(record) * record.sample_period for record in records)
    block = _block_duration(total, memory)
    batch: list[np.ndarray] = []
    for i, (record, u, noise) in enumerate(zip(records, inputs, velocity_noise, strict=True)):
        h = record.sample_period
        usable, restart = usable_steps(record, taps, plant.degrees, jumps, noise, enters=enters)
        use = tapered(usable.astype(float), taper / h)
        if plant.has_algebraic and substeps > 1:
            # As much weight in all as the steps of other outputs.
            at_sample = substeps * (np.arange(len(use)) % substeps == 0)[:, None]
            use = np.where(plant.algebraic, at_sample * use, use)
        usable[: transient_samples(record, transient)] = False
        if plant.internal is not None or plant.actuator is not None:
            # Where they are behind a gap of the inputs is a guess, as at the start of the record.
            usable &= beyond_starts(_driven_again(record), round(transient / h))[:, None]
        if explicit:
            usable &= beyond_starts(restart, round(transient / h))[:, None]
        score = usable.astype(float)
        signals = (
            record.time[:-1] + (0.0 if explicit else 0.5 * h),
            record.outputs[:-1],
            record.outputs[1:],
            u,
            *([record.inputs[:-1]] if plant.has_algebraic else []),
        )
        weights = use, score, restart, *_blocks(len(use), max(round(block / h), 1))
        arrays = *signals, *weights
        # Written in place: these are the largest arrays of an estimate.
        batch = batch or [np.zeros((len(records), length, *a.shape[1:]), a.dtype) for a in arrays]
        for target, values in zip(batch, arrays, strict=True):
            target[i, : len(values)] = values
        # Padding repeats the last values, so that no model is evaluated outside the data.
        for target, values in zip(batch, signals, strict=False):
            target[i, len(values) :] = values[-1]
    periods = np.asarray([record.sample_period for record in records])
    u_start = batch.pop(4) if plant.has_algebraic else None
    z_start = first_starts(undirected or plant, records) if z_start is None else z_start
    return Steps(*batch, periods, u_start, z_start)  # type: ignore[call-arg]


def at_samples(
    plant: Plant, values: Float[np.ndarray, "steps ny *columns"]
) -> Float[np.ndarray, "time ny *columns"]:
    """Values of steps at the samples that they belong to, NaN at the one that is left over.

    A step belongs to the sample that ends it; of an output of relative degree 0, to the one that
    begins it.

    Args:
        plant: with its relative degrees.
        values: of the last sub-step of every sample but the first.
    """
    missing = np.full_like(values[:1], np.nan)
    at_ends = np.concatenate([missing, values])
    if plant.has_algebraic:
        at_starts = np.concatenate([values, missing])
        at_ends[:, plant.algebraic] = at_starts[:, plant.algebraic]
    return at_ends


def _block_duration(
    total: float, memory: float, memories: float = 3.0, min_blocks: int = 10, max_blocks: int = 50
) -> float:
    """Length of a block of scores [s]: many for a steady covariance, none shorter than the memory.

    It is so many `memories` of the filter, if `total`, all records, has a number of blocks between
    these limits.
    """
    return max(min(memories * memory, total / min_blocks), total / max_blocks, memory)


def entering(
    plant: Plant, records: Sequence[Record], inputs: Sequence[Float[np.ndarray, "_ nu"]]
) -> Bool[np.ndarray, "ny ny"] | None:
    """Whether output j enters the equation of output i, at [i, j]; None where all are valid alike.

    Args:
        plant: the model.
        records: uniformly sampled.
        inputs: during each of their steps.
    """
    if all(np.all(record.output_valid == record.output_valid[:, :1]) for record in records):
        return None
    if plant.internal is not None:  # which any of them may move
        return np.ones((len(plant.outputs),) * 2, dtype=bool)
    return np.any(
        [entering_outputs(plant, record.time[:-1], record.outputs[:-1], u)
         for record, u in zip(records, inputs, strict=True)], axis=0
    )  # fmt: skip


def check_common_samples(
    plant: Plant, records: Sequence[Record], inputs: Sequence[Float[np.ndarray, "_ nu"]]
) -> None:
    """Check that every equation has steps in which all that stands in it was measured.

    Args:
        plant: the model.
        records: uniformly sampled.
        inputs: during each of their steps.

    Raises:
        ValueError: an output that is never valid together with those in its equation.
    """
    enters = entering(plant, records, inputs)
    if enters is None:
        return
    valid = np.any([np.any(valid_steps(record, enters), axis=0) for record in records], axis=0)
    for i, name in enumerate(plant.outputs):
        partners = [other for j, other in enumerate(plant.outputs) if enters[i, j] and j != i]
        check(
            bool(valid[i]),
            f"records.outputs[{name}]",
            f"must be measured at the same time as what stands in its equation: "
            f"{', '.join(partners)}",
            "no such step",
            hold_advice(records)
            or "Use `refine`, which scores the samples of each output by itself.",
        )


def _driven_again(record: Record) -> Bool[np.ndarray, " steps"]:
    """The first step behind each gap of the inputs."""
    known = record.input_valid[:-1] & record.input_valid[1:]
    return known & np.concatenate([[False], ~known[:-1]])


def _blocks(
    steps: int, length: int
) -> tuple[Float[np.ndarray, " steps"], Bool[np.ndarray, " steps"]]:
    """Weight of each step in its block, and where blocks end; an incomplete last block has none.

    The mean square of block sums estimates the spectrum of the scores at frequency zero. White
    measurement noise, differenced, has almost no power there but much at higher frequencies, which
    would leak over the edges of the blocks: they are windowed (Hann, mean square one).
    """
    length = min(length, steps)
    phase = (np.arange(steps) % length + 0.5) / length
    weights = np.sqrt(8.0 / 3.0) * np.sin(np.pi * phase) ** 2
    weights[steps - steps % length :] = 0.0
    ends = (np.arange(steps) + 1) % length == 0
    return weights, ends
