"""The free runs of a plan, each from its own initial state.

The first samples of a window tell the state of a store that is not measured, or a run along the
whole record does: the first ones where something unknown moved it, the long run where errors of the
model are slow, for then few samples fit almost any state. Which of both holds in a window, the
other windows of the record decide: that with which they are predicted better.
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
    states_of,
    window_starts,
    with_past,
)
from eoi_jax.simulation.integrator import Drive


def planned_runs(
    run: Run,
    record: Record,
    record_drive: Drive,
    runs: Plan,
    past: np.ndarray | None,
    begins: Bool[np.ndarray, " runs"],
    values: Starts | None,
) -> tuple[Float[np.ndarray, "runs time ny"], Starts, list[str]]:
    """Outputs of the runs, their initial values, and notes on known starts.

    Args:
        run: what all runs share.
        record: that is simulated.
        record_drive: what drives it, behind the plant's actuators.
        runs: their plan.
        past: how the inputs of all steps change with their levels before the record
            (`past_slopes`), of a plant with delays or lags of inputs.
        begins: which runs begin with the record.
        values: initial ones; None: they are estimated.
    """
    if not runs.starts:
        return np.zeros((0, runs.steps + 1, record.outputs.shape[1])), np.zeros((0, 0)), []
    course = _Along(record, record_drive, past)
    heads = course.heads(runs.starts, runs.head)
    if values is None:
        carried = _carried(run, course, runs, begins)
        head_starts, record_starts = window_starts(run, *heads, begins, carried)
        values = _chosen(run, course, runs, head_starts, record_starts)
    declared = values if past is None else None  # without levels before the record
    notes = contradicted_start(run, *heads[:3], declared, begins, record.name)
    return _outputs(run, course, runs, values), values, notes


@dataclass(frozen=True)
class _Along:
    """A record, what drives it, and how that changes with the inputs before the record."""

    record: Record
    drive: Drive
    past: np.ndarray | None

    def heads(
        self, starts: Sequence[int], count: int
    ) -> tuple[Drive, np.ndarray, np.ndarray, np.ndarray | None]:
        """The first `count` samples of runs: drive, outputs, which are valid, change with past."""
        samples = np.asarray(starts)[:, None] + np.arange(count)
        y, valid = self.record.outputs[samples], self.record.output_valid[samples]
        return _parts(self.drive, starts, count - 1), y, valid, self._past(starts, count - 1)

    def drives(self, starts: Sequence[int], steps: int, values: Starts) -> Drive:
        """What drives runs of so many samples' steps that start with these values."""
        drives, past = _parts(self.drive, starts, steps), self._past(starts, steps)
        return drives if past is None else with_past(drives, past, values)

    def _past(self, starts: Sequence[int], steps: int) -> np.ndarray | None:
        return None if self.past is None else self.past[_steps(self.drive, starts, steps)]


def _outputs(
    run: Run, course: _Along, runs: Plan, values: Starts
) -> Float[np.ndarray, "runs time ny"]:
    drives = course.drives(runs.starts, runs.steps, values)
    return outputs_of(run.plant, drives, states_of(run, values), run.friction)


def _chosen(
    run: Run, course: _Along, runs: Plan, head_starts: Starts, record_starts: Starts
) -> Starts:
    """For each window the starts with which the other windows of the record are predicted better.

    So no window has a part in how it is started itself.
    """
    if len(runs.starts) < 2 or np.array_equal(head_starts, record_starts, equal_nan=True):
        return head_starts
    errors = [_errors(run, course, runs, values) for values in (head_starts, record_starts)]
    head_error, record_error = (np.sum(e, axis=0) - e for e in errors)
    return np.where((record_error < head_error)[:, None], record_starts, head_starts)


def _errors(run: Run, course: _Along, runs: Plan, values: Starts) -> Float[np.ndarray, " runs"]:
    """Squared errors of runs behind their first samples, of each output by its own spread."""
    outputs, record = _outputs(run, course, runs, values), course.record
    spread = np.std(record.outputs, axis=0)
    sums = []
    for start, samples, y_hat in zip(runs.starts, runs.predicted, outputs, strict=True):
        part = slice(max(samples.start, start + runs.head), samples.stop)
        counts = record.output_valid[part]
        with np.errstate(over="ignore", invalid="ignore"):
            error = record.outputs[part] - y_hat[part.start - start : part.stop - start]
            sums.append(np.sum(np.where(counts, error / np.where(spread > 0, spread, 1.0), 0) ** 2))
    largest = np.sqrt(np.finfo(float).max)  # of runs that diverge; sums of it stay finite
    return np.nan_to_num(np.asarray(sums), nan=largest, posinf=largest).clip(max=largest)


def _carried(
    run: Run, course: _Along, runs: Plan, begins: Bool[np.ndarray, " runs"]
) -> State | None:
    """States where the runs start, of a single run along the record.

    That one starts from all samples of the first run. None of a plant without internal states that
    may start at any value, or without further runs.
    """
    if len(runs.starts) < 2 or not np.any(run.plant.open_internal):
        return None
    first = runs.starts[:1]
    values = initial_states(run, *course.heads(first, runs.steps + 1), begins[:1])
    drives = course.drives(first, runs.starts[-1] - first[0], values)
    x = states_along(run.plant, drives, states_of(run, values), run.friction)
    steps = run.substeps * (np.asarray(runs.starts) - first[0])
    return State(x.y[0, steps], x.z[0, steps])


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
