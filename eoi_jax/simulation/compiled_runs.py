"""Free runs with sensitivities (`sensitivity.py`), compiled whole; runs and lanes on all cores.

The sums of many lanes are added up as they run. A single lane's run shows c of every sample: there
the state is of single numbers, and its derivatives with the unknowns stand side by side in a vector
(inline, as `instructions.py` has it), which takes a half to a third of the time.
"""

import functools
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.compiler.derivatives import jvp
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import AbstractLoop, shapes_of
from eoi_jax.compiler.runtime import CompiledLoop, compiled_loop, cores, numbers, run_in_threads
from eoi_jax.models.actuators import changed_inputs
from eoi_jax.models.jacobians import has_sampled_actuator
from eoi_jax.models.plant import State
from eoi_jax.simulation.sensitivity import Direction, RunCarry, RunKernel, RunLane, RunRow, added_up

Table = Float[np.ndarray, "runs rows columns"]


@dataclass(frozen=True)
class RunSettings:
    """How runs are laid out; the sums do not depend on it but for rounding."""

    min_vector: int = 4  # lanes side by side; fewer run one by one: a vector would take longer
    chunk: int = 8192  # rows of outputs at a time, because of their memory


class _StateAndSlope(eqx.Module):
    """State, and its derivative with one unknown."""

    x: State
    slope: State


@dataclass(frozen=True, eq=False)
class _OneRun(AbstractLoop):
    """What is traced of a single lane: it is the same for all, what differs is the unknown."""

    kernel: RunKernel
    lane: Direction
    run: RunLane
    step: RunRow
    dtype: np.dtype
    branches: ClassVar[bool] = True

    @property
    def fixed(self) -> tuple:
        """The plant, the lane, and the length of a step."""
        return self.kernel, self.run, jax.ShapeDtypeStruct((), self.dtype)

    def begin(self, lane: Direction, fixed: tuple) -> _StateAndSlope:
        """Before the first step."""
        kernel, run, _ = fixed
        return _StateAndSlope(*kernel.begun(run, lane))

    def advance(
        self, lane: Direction, fixed: tuple, carry: _StateAndSlope, row: RunRow
    ) -> tuple[_StateAndSlope, Any]:
        """One step, and c of its start, for each output: the error, and the part of an unknown."""
        kernel, run, h = fixed
        scored = kernel.scored(run, carry.x, carry.slope, lane, row, jvp)
        moved = kernel.moved(run, carry.x, carry.slope, lane, row, h, jvp)
        return _StateAndSlope(*moved), jnp.stack(scored, axis=1)

    def result(self, carry: _StateAndSlope) -> Any:
        """Nothing: all of it is shown."""
        del carry
        return ()


@dataclass(frozen=True, eq=False)
class _FreeRun(AbstractLoop):
    """What is traced."""

    kernel: RunKernel
    lane: RunLane
    step: RunRow
    dtype: np.dtype
    branches: ClassVar[bool] = True  # a stop of dry friction is rare, and costs two steps

    @property
    def fixed(self) -> tuple:
        """The plant and the length of a step."""
        return self.kernel, jax.ShapeDtypeStruct((), self.dtype)

    def begin(self, lane: RunLane, fixed: tuple) -> RunCarry:
        """Before the first step."""
        return fixed[0].init(lane)

    def advance(
        self, lane: RunLane, fixed: tuple, carry: RunCarry, row: RunRow
    ) -> tuple[RunCarry, Any]:
        """One step."""
        kernel, h = fixed
        return kernel.step(lane, carry, row, h)

    def result(self, carry: RunCarry) -> Any:
        """The normal equations."""
        return carry.sums


def supports(kernel: RunKernel, lanes: int = 1) -> str | None:
    """Why free runs of a plant cannot be compiled here (JAX runs any); None if they are, now.

    Args:
        kernel: the recursion.
        lanes: how many will run side by side.
    """
    plant = kernel.plant
    start_size = len(kernel.rows)
    if plant.actuator is not None:
        if not has_sampled_actuator(plant):
            return "inputs behind an actuator of the user's own"
        start_size += len(plant.inputs)  # their levels before the record
        lanes = 1  # inputs depend on the parameters: lanes share no rows, and run one by one
    if plant.internal is not None:
        theta = jax.ShapeDtypeStruct(np.shape(plant.theta), float)
        start_size += jax.eval_shape(plant.internal_start, theta).shape[0]
    try:
        if lanes == 1:
            _one_run(kernel, start_size)
        else:
            _code(kernel, start_size, lanes)
    except Untranslatable as reason:
        return str(reason)
    return None


def used(kernel: RunKernel, lanes: int = 1) -> EngineUsed:
    """Which engine free runs of a plant take, and why; arguments as of `supports`."""
    reason = supports(kernel, lanes)
    return NATIVE if reason is None else EngineUsed("scan", reason)


def columns(nu: int, ny: int) -> tuple[slice, slice, slice, slice]:
    """Where a table of `RunRow` has its parts: time, inputs at three instants, outputs, weights.

    Behind actuators derivatives of the inputs follow, with θ and with their levels before.
    """
    edges = [0, *itertools.accumulate((1, 3 * nu, ny, ny))]
    time, inputs, y, use = (slice(*pair) for pair in itertools.pairwise(edges))
    return time, inputs, y, use


def summed(
    kernel: RunKernel,
    lanes: RunLane,
    tables: Table,
    steps: Float[np.ndarray, " runs"],
    counts: Int[np.ndarray, " runs"],
    substeps: int = 1,
    single: "LaneCode | None" = None,
) -> Float[np.ndarray, "lanes runs size size"]:
    """Normal equations of every run, from every lane's parameters.

    Args:
        kernel: the recursion; its plant's own parameter values are not used.
        lanes: leading axes (lanes, runs) on each part.
        tables: of each run, padded to one length.
        steps: their length, of each run [s].
        counts: rows of each run that are not padding.
        substeps: rows in each sample, of which the first alone may be scored.
        single: code of a single lane, where that is there already.

    Raises:
        Untranslatable: what `supports` says.
    """
    lane_count, runs = lanes.theta.shape[:2]
    if lane_count == 1:
        code = single or LaneCode.of(kernel, lanes.start.shape[2])
        lane = _OneLane(code, lanes, tables, steps, counts)
        return np.stack(lane.map_runs(lambda run: lane.sums(run, substeps)))[None]
    code = _code(kernel, lanes.start.shape[2], lane_count)
    jobs = [
        _Job(code, kernel, lanes, tables, steps, counts, run, part)
        for run in range(runs)
        for part in _parts(lane_count, code.places.width, runs)
    ]
    sums = np.empty((lane_count, runs, *code.program.result.shape))
    waiting = iter(jobs)

    def work() -> None:
        for job in waiting:  # threads take from one iterator
            sums[job.lane_range, job.run] = job.sums()

    run_in_threads(work, min(cores(), len(jobs)))
    return sums


def signals(
    kernel: RunKernel,
    lane: RunLane,
    tables: Table,
    steps: Float[np.ndarray, " runs"],
    counts: Int[np.ndarray, " runs"],
    substeps: int,
    settings: RunSettings = RunSettings(),
) -> Float[np.ndarray, "runs samples ny size"]:
    """c of every sample of one lane's runs: minus the slopes of ŷ, and the error, weighed.

    Args:
        kernel: the recursion.
        lane: leading axes (1, runs) on each part.
        tables: as in `summed`, like `steps` and `counts`; zero beyond a run's end.
        steps: their length, of each run [s].
        counts: rows of each run that are not padding.
        substeps: rows in each sample.
        settings: of the memory.
    """
    code = LaneCode.of(kernel, lane.start.shape[2])
    single = _OneLane(code, lane, tables, steps, counts, settings)
    samples = -(-tables.shape[1] // substeps)
    values = np.zeros((len(tables), samples, len(kernel.plant.outputs), code.size))

    def write(run: int) -> None:
        last = 0
        for blocks in single.blocks(run, substeps):
            part = slice(last, last + len(blocks[0]))
            last = part.stop
            for j, block in enumerate(blocks):
                values[run, part, j, :-1], values[run, part, j, -1] = block[:, 1:], block[:, 0]

    single.map_runs(write)
    return values


@dataclass(frozen=True)
class LaneCode:
    """Code for the runs of a single lane, and the numbers that are the same in all of them.

    Attributes:
        code: of a run.
        plant: numbers of the plant.
        directions: of each unknown.
    """

    code: CompiledLoop
    plant: np.ndarray
    directions: np.ndarray

    @classmethod
    def of(cls, kernel: RunKernel, start_size: int) -> "LaneCode":
        """Of a recursion with so many unknowns in the start of a run.

        Raises:
            Untranslatable: what `supports` says.
        """
        directions = numbers(kernel.directions(start_size), float, skip=1).T
        return cls(_one_run(kernel, start_size), numbers(kernel, float), directions)

    @property
    def size(self) -> int:
        """Of the normal equations: the unknowns and the error."""
        return self.directions.shape[1] + 1


class _OneLane:
    """All runs of a single lane."""

    def __init__(
        self,
        code: LaneCode,
        lane: RunLane,
        tables: Table,
        steps: np.ndarray,
        counts: np.ndarray,
        settings: RunSettings = RunSettings(),
    ):
        self._threshold, self._chunk = np.asarray(lane.threshold)[0], settings.chunk
        self.size, self._outputs = code.size, code.code.outputs
        self._tables, self._counts = tables, counts
        # In the order of the loop's `fixed`: plant, lane and the length of a step.
        runs, plant = len(tables), code.plant
        parts = [np.asarray(leaf, float)[0].reshape(runs, -1) for leaf in jax.tree.leaves(lane)]
        plants = np.broadcast_to(plant, (runs, len(plant)))
        fixed = np.concatenate([plants, *parts, np.reshape(steps, (runs, 1))], axis=1)
        self._begun = code.code.begin_each(code.directions, fixed)

    def map_runs(self, job: Callable[[int], Any]) -> list[Any]:
        """What a job gives for each run."""
        runs = len(self._tables)
        results, waiting = [None] * runs, iter(range(runs))

        def work() -> None:
            for run in waiting:  # threads take from one iterator
                results[run] = job(run)

        run_in_threads(work, min(cores(), runs))
        return results

    @np.errstate(over="ignore", invalid="ignore")  # of runs that diverge: the sums show it
    def sums(self, run: int, substeps: int) -> Float[np.ndarray, "size size"]:
        """The normal equations; nothing is kept of the samples."""
        threshold, total = float(self._threshold[run]), np.zeros((self.size, self.size))
        for blocks in self.blocks(run, substeps):
            for block in blocks:
                total += added_up(block, threshold, error=0)
        return np.roll(total, -1, axis=(0, 1))

    def blocks(self, run: int, substeps: int) -> Iterator[list[Float[np.ndarray, "samples size"]]]:
        """c of some samples after the other, the error first: views of what is written over."""
        rows = np.ascontiguousarray(self._tables[run, : self._counts[run]], float)
        begun, count = self._begun[run], max(self._chunk // substeps, 1) * substeps
        first = [place.start for place in self._outputs[::2]]
        for outputs in begun.outputs(rows, count):
            yield [outputs[::substeps, at : at + self.size] for at in first]


def _one_run(kernel: RunKernel, start_size: int) -> CompiledLoop:
    dtype, plant = np.dtype(float), kernel.plant
    nu, ny = len(plant.inputs), len(plant.outputs)
    changed = len(changed_inputs(plant.actuator, nu))
    counts = None if plant.actuator is None else (changed, len(kernel.acting))
    run, step = _shapes(len(plant.names), start_size, nu, ny, counts)
    directions = kernel.directions(start_size)
    lane = shapes_of(directions, dtype, skip=1)
    loop = _OneRun(shapes_of(kernel, dtype), lane, run, step, dtype)
    width = sum(np.prod(leaf.shape, dtype=int) for leaf in jax.tree.leaves(step))
    code = compiled_loop(loop, int(width), len(directions.theta), True)
    if any(place.stop - place.start < len(directions.theta) for place in code.outputs[1::2]):
        raise Untranslatable("an output that no unknown moves")
    return code


def _code(
    kernel: RunKernel, start_size: int, lanes: int, settings: RunSettings = RunSettings()
) -> CompiledLoop:
    dtype, plant = np.dtype(float), kernel.plant
    nu, ny = len(plant.inputs), len(plant.outputs)
    loop = _FreeRun(shapes_of(kernel, dtype), *_shapes(len(plant.names), start_size, nu, ny), dtype)
    return compiled_loop(loop, 1 + 3 * nu + 2 * ny, 1 if lanes < settings.min_vector else None)


@functools.cache
def _shapes(
    size: int, start_size: int, nu: int, ny: int, counts: tuple[int, int] | None = None
) -> tuple[RunLane, RunRow]:
    """Of a lane and a row; behind actuators so many inputs move with so many parameters."""
    scalar = np.zeros(())
    lane = RunLane(np.zeros(size), np.zeros(start_size), scalar, np.zeros(ny), scalar)
    row = RunRow(scalar, np.zeros((3, nu)), np.zeros(ny), np.zeros(ny))
    if counts is not None:
        changed, acting = counts
        shapes = (3, changed, acting), (3, changed, nu)
        row = replace(row, slope=np.zeros(shapes[0]), past=np.zeros(shapes[1]))
    return shapes_of((lane, row), np.dtype(float))


def _parts(lanes: int, width: int, runs: int) -> list[slice]:
    """Lanes for each job: whole vectors, so many that there is a job for every core."""
    vectors = -(-lanes // width)
    pieces = min(vectors, max(1, -(-cores() // runs)))
    edges = width * np.round(np.linspace(0, vectors, pieces + 1)).astype(int)
    return [slice(int(a), min(int(b), lanes)) for a, b in itertools.pairwise(edges)]


class _Job:
    """Some lanes of one run, with their memory."""

    def __init__(
        self,
        code: CompiledLoop,
        kernel: RunKernel,
        lanes: RunLane,
        tables: Table,
        steps: np.ndarray,
        counts: np.ndarray,
        run: int,
        lane_range: slice,
    ):
        self.run, self.lane_range = run, lane_range
        self._rows = np.ascontiguousarray(tables[run, : counts[run]], float)
        lane_values = jax.tree.map(lambda leaf: np.asarray(leaf)[lane_range, run], lanes)
        fixed = numbers((kernel, float(steps[run])), float)
        self._run = code.begin(numbers(lane_values, float, skip=1).T, fixed)

    def sums(self) -> np.ndarray:
        """The normal equations of the lanes."""
        self._run.advance(self._rows)
        return self._run.result()
