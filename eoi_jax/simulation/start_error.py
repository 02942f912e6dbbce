r"""How many samples a free run needs for its start, so that its error does not rule the run.

The start x₀ is the least-squares fit to the first h samples, each output over the standard
deviation of its errors. With the derivatives J of these with x₀, S the first h rows of J, and
errors ε of variance 1, the start errs by $S^+ \varepsilon$, and the run at the time t by

$\sigma_t^2 = J_t S^+ (S^+)^\top J_t^\top$.

Where what is wrong at the start dies out, or stays as it is, that is a fraction of 1. Where it
grows or swings on (a pendulum near its upper rest, an oscillator that is sampled finely, so that
fifty samples are little of a period), it may be many times 1: a true model then looks wrong. More
samples of the record, up to a third, are then spent on the start: if the model, started anew,
leaves there no more than it leaves in the first ones. Where it leaves more, it lacks something, and
a start fitted to more of that is no better.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.data.windows import driven_parts, plan
from eoi_jax.simulation.chained_runs import outputs_of
from eoi_jax.simulation.initial_state import Run, initial_states, known_starts, owned, states_of
from eoi_jax.simulation.integrator import Drive
from eoi_jax.simulation.simulate import acted, drive


@dataclass(frozen=True)
class StartErrorSettings:
    """When a run is given more samples for its start.

    Attributes:
        largest: rms of σ_t over the run; it then adds a thirtieth to the error.
        share: of a record that its start may take.
        reach: samples that are simulated, over those of the usual start; what comes later is taken
            to be as in their last quarter.
        difference: step of the derivatives, over the size of an output.
        noise: smallest standard deviation of the errors, over the size of an output.
        scatter: standard deviations by which that of the errors may seem to grow with more samples.
    """

    largest: float = 0.25
    share: float = 1.0 / 3.0
    reach: int = 40
    difference: float = 1e-6
    noise: float = 1e-9
    scatter: float = 3.0


_SETTINGS = StartErrorSettings()


def sufficient_start(run: Run, record: Record, head: int) -> int:
    """Samples from which the start of the free run on a record is well enough known.

    Args:
        run: what all runs share.
        record: along which it goes, at hold and steps of the run.
        head: samples that are usual.

    Returns:
        `head`, or it doubled until the error of the start is small in the run. `head` too where a
        third of the record is not enough, or where the model leaves more in more samples.
    """
    first, part = max(driven_parts(record), key=lambda numbered: len(numbered[1]))
    reach = min(len(part), _SETTINGS.reach * head)
    candidates = _doubled(head, _SETTINGS.share * min(len(part), reach))
    runs = plan(part, head, None, run.plant.rows)
    unknown = owned(run.plant)[0].size + np.sum(run.plant.free_internal)
    if len(candidates) < 2 or not runs.starts or not unknown:
        return head
    begin = runs.starts[0]
    part = part[begin : min(begin + reach, len(part))]
    begins = first + begin == 0 and not record.continues
    slopes = _slopes(run, part, head, begins)
    for count in candidates:
        if _start_error(slopes, part.output_valid, count, len(record)) <= _SETTINGS.largest:
            quiet = count == head or _as_quiet(run, part, head, count, begins)
            return count if quiet else head
    return head


def _as_quiet(run: Run, part: Record, head: int, count: int, begins: bool) -> bool:
    """Whether the model leaves no more in `count` samples than in the first ones."""
    usual, more = (_begun(run, part, samples, begins).noise for samples in (head, count))
    limit = 1.0 + _SETTINGS.scatter / np.sqrt(2.0 * head)
    return bool(np.all(more <= limit * np.maximum(usual, _SETTINGS.noise * np.std(part.outputs))))


def _doubled(head: int, most: float) -> list[int]:
    counts = [head]
    while 2 * counts[-1] <= most:
        counts.append(2 * counts[-1])
    return counts


@dataclass(frozen=True)
class _Begun:
    """A start fitted to the first samples.

    Attributes:
        drive: of the whole run.
        values: unknowns of the start, shape (1, unknowns).
        noise: standard deviation of what is left in these samples, in the unit of each output.
    """

    drive: Drive
    values: Float[np.ndarray, "1 unknowns"]
    noise: Float[np.ndarray, " ny"]


def _begun(run: Run, part: Record, head: int, begins: bool) -> _Begun:
    run_drive = acted(run.plant, drive(part.time, part.inputs, part.hold, run.substeps, part.skew))
    first = _lanes(run_drive, 1, run.substeps * (head - 1))
    y, valid = part.outputs[:head], part.output_valid[:head]
    noise, begin = part.noise[None], np.asarray([begins])
    values = initial_states(run, first, y[None], valid[None], noise, begins=begin)
    outputs = outputs_of(run.plant, first, states_of(run, values), run.friction)[0]
    degrees = np.maximum(np.sum(valid, axis=0) - run.plant.rows, 1)
    with np.errstate(all="ignore"):  # of a run that diverges
        squares = np.sum(np.where(valid, y - outputs, 0.0) ** 2, axis=0)
    return _Begun(run_drive, values, np.sqrt(squares / degrees))


def _slopes(
    run: Run, part: Record, head: int, begins: bool
) -> Float[np.ndarray, "time ny unknowns"]:
    """Derivatives of the outputs, each over its errors in the first samples, with their start."""
    begun = _begun(run, part, head, begins)
    spread = np.std(part.outputs[:head], axis=0)
    spread = np.where(spread > 0, spread, 1.0)
    rows, columns = owned(run.plant)
    steps = _SETTINGS.difference * spread[columns] / (part.sample_period * head) ** rows
    fixed = known_starts(run.plant, np.asarray([begins]), begun.values.shape)
    if fixed is not None:  # without an error
        steps = np.where(np.isfinite(fixed[0, : len(steps)]), 0.0, steps)
    (free,) = np.nonzero(run.plant.free_internal)
    places = np.concatenate([np.arange(len(steps)), len(steps) + free])
    size = np.abs(begun.values[0, places[len(steps) :]])
    steps = np.concatenate([steps, _SETTINGS.difference * np.where(size > 0, size, 1.0)])
    moved = np.repeat(begun.values, len(steps) + 1, axis=0)
    moved[1 + np.arange(len(steps)), places] += steps
    driving = _lanes(begun.drive, len(moved), len(begun.drive.time))
    outputs = outputs_of(run.plant, driving, states_of(run, moved), run.friction)
    with np.errstate(all="ignore"):  # of a run that diverges
        change = np.moveaxis(outputs[1:] - outputs[0], 0, -1) / _SETTINGS.difference
        floor = np.maximum(part.noise, _SETTINGS.noise * spread)
        return change / np.maximum(begun.noise, floor)[:, None]


def _lanes(run_drive: Drive, lanes: int, steps: int) -> Drive:
    """The first steps of a drive, so many times side by side."""
    time, inputs = np.asarray(run_drive.time)[:steps], np.asarray(run_drive.inputs)[:steps]
    last = np.asarray(run_drive.following)[steps - 1]
    step = np.asarray(run_drive.step)
    arrays = (np.repeat(array[None], lanes, axis=0) for array in (time, step, inputs, last))
    time, step, inputs, last = arrays
    return Drive(time, step, inputs, run_drive.substeps, last)


def _start_error(
    slopes: Float[np.ndarray, "time ny unknowns"],
    valid: np.ndarray,
    count: int,
    samples: int,
) -> float:
    """Rms of σ_t over the run behind its start; of the worst output.

    Args:
        slopes: as `_slopes` gives them.
        valid: which samples were measured.
        count: samples of the start.
        samples: of the whole record.
    """
    if not np.all(np.isfinite(slopes)):
        return np.inf
    start = np.where(valid[:count, :, None], slopes[:count], 0.0).reshape(-1, slopes.shape[-1])
    length = np.linalg.norm(start, axis=0)
    scale = np.where(length > 0, length, 1.0)
    inverse = np.linalg.pinv(start / scale, rcond=1e-8)
    covariance = inverse @ inverse.T
    behind = slopes[count:] / scale
    squares = np.einsum("tju,uv,tjv->tj", behind, covariance, behind)
    squares = np.maximum(squares, 0.0)  # by rounding, of a start that the run has forgotten
    late = np.mean(squares[-max(len(squares) // 4, 1) :], axis=0)
    total = np.sum(squares, axis=0) + max(samples - count - len(squares), 0) * late
    return float(np.sqrt(np.max(total / max(samples - count, 1))))


def sufficient_starts(run: Run, records: Sequence[Record], heads: Sequence[int]) -> list[int]:
    """`sufficient_start` of each record."""
    return [
        sufficient_start(run, record, head) for record, head in zip(records, heads, strict=True)
    ]
