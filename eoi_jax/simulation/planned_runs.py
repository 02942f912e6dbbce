"""The free runs of a plan, each from its own initial state.

The first samples of a window tell the state of a store that is not measured, or a run along the
whole record does: the first ones where something unknown moved it, the long run where errors of the
model are slow, for then few samples fit almost any state. Which of both holds in a window, the
other windows of the record decide: that with which they are predicted better.

Starts of all records are fitted side by side, each by the samples of its own record.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.data.record import Record
from eoi_jax.data.windows import Plan
from eoi_jax.models.plant import State
from eoi_jax.simulation.chained_runs import outputs_of, states_along
from eoi_jax.simulation.contradicted_start import contradicted_start
from eoi_jax.simulation.initial_state import (
    Run,
    Starts,
    initial_states,
    moving_pairs,
    states_of,
    window_starts,
    with_past,
)
from eoi_jax.simulation.integrator import Drive

# Of the first samples of some runs: what drives them, outputs, which are valid, the noise of the
# sensors, change with the past.
Heads = tuple[Drive, np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]


@dataclass(frozen=True)
class Course:
    """A record with the runs along it.

    Attributes:
        record: that is simulated.
        drive: what drives it, behind the plant's actuators.
        past: how the inputs of all steps change with their levels before the record
            (`past_slopes`), of a plant with delays or lags of inputs.
        runs: their plan.
        begins: which runs begin with the record.
    """

    record: Record
    drive: Drive
    past: np.ndarray | None
    runs: Plan
    begins: Bool[np.ndarray, " runs"]

    def heads(self, starts: Sequence[int], count: int) -> Heads:
        """The first `count` samples of runs."""
        samples = np.asarray(starts)[:, None] + np.arange(count)
        y, valid = self.record.outputs[samples], self.record.output_valid[samples]
        noise = np.broadcast_to(self.record.noise, (len(starts), y.shape[-1]))
        return _parts(self.drive, starts, count - 1), y, valid, noise, self._past(starts, count - 1)

    def drives(self, starts: Sequence[int], steps: int, values: Starts) -> Drive:
        """What drives runs of so many samples' steps that start with these values."""
        drives, past = _parts(self.drive, starts, steps), self._past(starts, steps)
        return drives if past is None else with_past(drives, past, values, moving_pairs(past))

    def _past(self, starts: Sequence[int], steps: int) -> np.ndarray | None:
        return None if self.past is None else self.past[_steps(self.drive, starts, steps)]


def planned_runs(
    run: Run, course: Course, values: Starts
) -> tuple[Float[np.ndarray, "runs time ny"], list[str]]:
    """Outputs of the runs along a record, and notes on known starts.

    Args:
        run: what all runs share.
        course: the record.
        values: initial ones of the runs (`estimated_starts`).
    """
    runs = course.runs
    if not runs.starts:
        return np.zeros((0, runs.steps + 1, course.record.outputs.shape[1])), []
    heads = course.heads(runs.starts, runs.head)[:4]
    declared = values if course.past is None else None  # without levels before the record
    notes = contradicted_start(run, *heads, declared, course.begins, course.record.name)
    return _outputs(run, course, values), notes


def estimated_starts(run: Run, courses: Sequence[Course]) -> list[Starts]:
    """Initial values of the runs along some records.

    Args:
        run: what all runs share.
        courses: the records.
    """
    starts: list[Starts] = [np.zeros((0, 0))] * len(courses)
    alike: dict[tuple, list[int]] = {}
    for i, course in enumerate(courses):
        runs, several = course.runs, len(course.runs.starts) > 1
        if runs.starts:
            key = runs.head, float(course.drive.step), runs.steps if several else None
            alike.setdefault(key, []).append(i)
    for group in alike.values():
        for i, values in zip(group, _fitted(run, [courses[i] for i in group]), strict=True):
            starts[i] = values
    return starts


def _fitted(run: Run, courses: Sequence[Course]) -> list[Starts]:
    """Initial values of the runs along records with equally long first samples and windows."""
    parts = [course.heads(course.runs.starts, course.runs.head) for course in courses]
    begins = np.concatenate([course.begins for course in courses])
    owners = np.repeat(np.arange(len(parts)), [len(part[1]) for part in parts])
    heads, carried = _joined(parts), _carried(run, courses)

    def by_record(by_spread: bool) -> list[Starts]:
        fits = window_starts(run, *heads, begins, carried, owners, by_spread)
        pairs = zip(*(np.split(fit, np.flatnonzero(np.diff(owners)) + 1) for fit in fits),
                    strict=True)  # fmt: skip
        return [_chosen(run, *pair) for pair in zip(courses, pairs, strict=True)]

    starts = by_record(by_spread=False)
    if len(run.plant.outputs) == 1:
        return starts
    others = by_record(by_spread=True)
    return [_likelier(run, *item) for item in zip(courses, starts, others, strict=True)]


def _likelier(run: Run, course: Course, first: Starts, second: Starts) -> Starts:
    """The starts with which the runs of a record are likelier.

    By the likelihood of normal errors whose variances are those of the runs, and at least those of
    the noise of the sensors.
    """
    if np.allclose(first, second, atol=0.0, equal_nan=True):
        return first
    noise = course.record.noise**2
    powers = [np.sum(_errors(run, course, values), axis=0) for values in (first, second)]
    count = max(sum(part.stop - part.start for part in _scored(course.runs)), 1)
    costs = [np.sum(np.log(np.maximum(power / count, noise))) for power in powers]
    return second if costs[1] < costs[0] else first


def _joined(parts: Sequence[Heads]) -> Heads:
    """The first samples of the runs of several records, side by side."""
    drives, outputs, masks, noise, pasts = zip(*parts, strict=True)
    time, step, inputs, last = (
        np.concatenate(arrays)
        for arrays in zip(*((d.time, d.step, d.inputs, d.last) for d in drives), strict=True)
    )
    driving = Drive(time, step, inputs, drives[0].substeps, last)
    past = [part for part in pasts if part is not None]
    joined_past = np.concatenate(past) if past else None
    y, valid, levels = (np.concatenate(part) for part in (outputs, masks, noise))
    return driving, y, valid, levels, joined_past


def _outputs(run: Run, course: Course, values: Starts) -> Float[np.ndarray, "runs time ny"]:
    drives = course.drives(course.runs.starts, course.runs.steps, values)
    return outputs_of(run.plant, drives, states_of(run, values), run.friction)


def _chosen(run: Run, course: Course, fits: tuple[Starts, Starts]) -> Starts:
    """For each window the starts with which the other windows of the record are predicted better.

    So no window has a part in how it is started itself.

    Args:
        run: what all runs share.
        course: the record.
        fits: to the first samples, and with internal states of a run along the record.
    """
    head_starts, record_starts = fits
    if len(head_starts) < 2 or np.array_equal(head_starts, record_starts, equal_nan=True):
        return head_starts
    spread = np.std(course.record.outputs, axis=0)
    weights = np.where(spread > 0, spread, 1.0) ** -2.0
    errors = [_errors(run, course, values) @ weights for values in fits]
    head_error, record_error = (np.sum(e, axis=0) - e for e in errors)
    return np.where((record_error < head_error)[:, None], record_starts, head_starts)


def _scored(runs: Plan) -> list[slice]:
    """Samples of each run behind its first ones."""
    pairs = zip(runs.starts, runs.predicted, strict=True)
    return [slice(max(part.start, start + runs.head), part.stop) for start, part in pairs]


def _errors(run: Run, course: Course, values: Starts) -> Float[np.ndarray, "runs ny"]:
    """Sums of the squared errors of runs behind their first samples."""
    outputs, record, runs = _outputs(run, course, values), course.record, course.runs
    sums = []
    for start, part, y_hat in zip(runs.starts, _scored(runs), outputs, strict=True):
        counts = record.output_valid[part]
        with np.errstate(over="ignore", invalid="ignore"):
            error = record.outputs[part] - y_hat[part.start - start : part.stop - start]
            sums.append(np.sum(np.where(counts, error, 0.0) ** 2, axis=0))
    largest = np.sqrt(np.finfo(float).max)  # of runs that diverge; sums of it stay finite
    return np.nan_to_num(np.asarray(sums), nan=largest, posinf=largest).clip(max=largest)


def _carried(run: Run, courses: Sequence[Course]) -> State | None:
    """States where the runs start, of a single run along each record.

    That one starts from all samples of the first run. None of a plant without internal states that
    may start at any value, or without further runs.
    """
    if len(courses[0].runs.starts) < 2 or not np.any(run.plant.open_internal):
        return None
    parts = [course.heads(course.runs.starts[:1], course.runs.steps + 1) for course in courses]
    begins = np.asarray([course.begins[0] for course in courses])
    values = initial_states(run, *_joined(parts), begins, np.arange(len(courses)))
    y, z = [], []
    for course, begun in zip(courses, values[:, None], strict=True):
        # A run that starts late may do so after the last one, which reaches back.
        first, last = course.runs.starts[0], max(course.runs.starts)
        drives = course.drives([first], last - first, begun)
        x = states_along(run.plant, drives, states_of(run, begun), run.friction)
        steps = run.substeps * (np.asarray(course.runs.starts) - first)
        y.append(x.y[0, steps])
        z.append(x.z[0, steps])
    return State(np.concatenate(y), np.concatenate(z))


def _steps(record_drive: Drive, starts: Sequence[int], count: int) -> Int[np.ndarray, "runs steps"]:
    """Steps of each run; a late one ends beyond the record, where nothing is looked at."""
    n = record_drive.substeps
    steps = n * np.asarray(starts)[:, None] + np.arange(n * count)
    return np.minimum(steps, len(record_drive.time) - 1)


def _parts(record_drive: Drive, starts: Sequence[int], count: int) -> Drive:
    """What drives each run, runs first."""
    n, steps = record_drive.substeps, _steps(record_drive, starts, count)
    period = np.full(len(starts), record_drive.step)
    last = record_drive.following[steps[:, -1]]
    return Drive(record_drive.time[steps], period, record_drive.inputs[steps], n, last)
