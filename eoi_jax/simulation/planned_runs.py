"""The free runs of a plan, each from its own initial state."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.data.record import Record
from eoi_jax.data.windows import Plan
from eoi_jax.models.plant import State
from eoi_jax.simulation.chained_runs import outputs_of, states_along
from eoi_jax.simulation.contradicted_start import contradicted_start
from eoi_jax.simulation.initial_state import Run, Starts, initial_states, states_of, with_past
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
    along = _Along(record, record_drive, past)
    heads = along.heads(runs.starts, runs.head)
    if values is None:
        carried = _carried(run, along, runs, begins)
        values = initial_states(run, *heads, begins, carried)
    declared = values if past is None else None  # without levels before the record
    notes = contradicted_start(run, *heads[:3], declared, begins, record.name)
    drives = along.drives(runs.starts, runs.steps, values)
    outputs = outputs_of(run.plant, drives, states_of(run.plant, values), run.friction)
    return outputs, values, notes


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


def _carried(
    run: Run, along: _Along, runs: Plan, begins: Bool[np.ndarray, " runs"]
) -> State | None:
    """States where the runs start, of a single run along the record.

    That one starts from all samples of the first run. None of a plant without internal states that
    may start at any value, or without further runs.
    """
    if len(runs.starts) < 2 or not np.any(run.plant.open_internal):
        return None
    first = runs.starts[:1]
    values = initial_states(run, *along.heads(first, runs.steps + 1), begins[:1])
    drives = along.drives(first, runs.starts[-1] - first[0], values)
    x = states_along(run.plant, drives, states_of(run.plant, values), run.friction)
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
