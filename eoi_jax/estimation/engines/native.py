"""The engine of CPUs: the loop compiled whole, as C would be, and lanes spread over the cores.

The step of the pass is traced for one lane (`graph.py`), sorted by what depends on what
(`loop.py`) and written for LLVM (`instructions.py`). Here it is compiled, kept, and run.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.graph import Untranslatable, evaluated
from eoi_jax.compiler.jit import (
    LINE,
    Compiled,
    aligned,
    copied,
    cores,
    numbers,
    spread,
    together,
    translated,
)
from eoi_jax.compiler.loop import shapes_of
from eoi_jax.estimation.engines.engine import AbstractEngine, Lanes
from eoi_jax.estimation.engines.pass_loop import Pass
from eoi_jax.estimation.kernel import Step, Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant

_TILE_BYTES = 24_000  # of lanes that step together: half of a first-level cache
_CHUNK_BYTES = 16_000_000  # of what the lanes share of the record, at a time
# Between tiles: what a core fetches ahead of its own it would take from the core that writes there.
# At 0, 1, 4 and 8 kB two cores are 1.4, 1.3, 1.6 and 1.9 times as fast as one.
_APART = 8192 + LINE


@dataclass(frozen=True)
class Native(AbstractEngine):
    """Lanes as vectors of a compiled loop, in tiles on all cores.

    About ten times as fast as the scan, and compiled in half a second. Code is kept for the life
    of the process, and on disk where JAX keeps its own (`eoi_jax.configure(cache=True)`).

    Attributes:
        threads: how many cores to use; all that this process may use if None.
    """

    threads: int | None = None

    def supports(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> str | None:
        """Why a pass cannot be run here (`Scan` runs any); None if it can.

        Args:
            plant: as in `run`, like all others.
            lanes: one is enough.
            lowpass: F.
            steps: of one record.
            store: what is added up.

        Returns:
            What is not supported, by its name in JAX.
        """
        try:
            translated(*pass_of(plant, lanes, lowpass, steps, store))
        except Untranslatable as reason:
            return str(reason)
        return None

    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane; compiled once for all numbers of lanes and steps.

        A lane with a NaN among its gains or parameters has NaN in all its sums.

        Raises:
            Untranslatable: what `supports` says.
        """
        what, columns = pass_of(plant, lanes, lowpass, steps, store)
        run = PassRun(translated(what, columns), what, lanes, self.threads or cores())
        run.go(plant, lowpass, steps, rows_of(steps, what.dtype))
        return run.sums()


# -- what is compiled -------------------------------------------------------------------------


def pass_of(
    plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str
) -> tuple[Pass, int]:
    """What is traced, and the number of columns of the record; arguments as of `Native.run`.

    Raises:
        Untranslatable: inputs behind an actuator.
    """
    if plant.actuator is not None:
        raise Untranslatable("inputs behind an actuator")
    dtype = np.dtype(lanes.theta.dtype)
    columns = [np.asarray(getattr(steps, name)) for name in _step_names()]
    shapes = shapes_of(columns, dtype, skip=1)
    if lanes.emphasis is not None:
        shapes.append(jax.ShapeDtypeStruct((), dtype))
    step = jax.tree.unflatten(_step_structure(lanes.emphasis is not None), shapes)
    lane = shapes_of(lanes.without_emphasis(), dtype, skip=1)
    what = Pass(shapes_of(plant, dtype), lane, shapes_of(lowpass, dtype), step, store, dtype)
    return what, sum(int(np.prod(column.shape[1:])) for column in columns)


@functools.cache
def _step_structure(emphasis: bool) -> Any:
    """A step whose inputs are the record's own."""

    def step() -> Step:
        one, flag = jnp.zeros(()), jnp.zeros((), bool)
        some = one[None]
        last = one if emphasis else None
        return Step(some, None, one, some, some, some, some, flag, one, flag, last)

    return jax.tree.structure(jax.eval_shape(step))


@functools.cache
def _step_names() -> list[str]:
    """Of its parts that are taken from `Steps` as they are, in the order of the leaves."""
    structure = _step_structure(False)
    step = jax.tree.unflatten(structure, range(structure.num_leaves))
    return [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(step)]


def rows_of(steps: Steps, dtype: Any) -> np.ndarray:
    """What is read of each step of one record, shape (S, columns)."""
    parts = [np.asarray(getattr(steps, name)) for name in _step_names()]
    columns = [part.reshape(len(part), -1) for part in parts]
    return np.concatenate(columns, axis=1, dtype=dtype, casting="unsafe")


# -- one run ----------------------------------------------------------------------------------


class PassRun:
    """Memory of one run of a compiled pass."""

    def __init__(self, compiled: Compiled, what: Pass, lanes: Lanes, threads: int):
        self._code, self._what, self._lanes, self._threads = compiled, what, lanes, threads
        width = compiled.where.width
        self._vectors = -(-len(lanes) // width)
        self._memory = self._tiles()
        # Beyond the last lane it is repeated: any numbers do, but these cost no slow path.
        room = self._memory.shape[0] * self._memory.shape[1] * width
        self._padding = np.minimum(np.arange(room), len(lanes) - 1)
        self._carries = np.zeros(0)
        self._spoilt = np.zeros(len(lanes), bool)

    def _tiles(self) -> np.ndarray:
        """Zeros, (tiles, vectors, rows, width): tiles that fit the cache, some for every thread."""
        where, dtype = self._code.where, self._what.dtype
        block = where.rows * where.width
        tiles = -(-self._vectors // max(1, _TILE_BYTES // (block * dtype.itemsize)))
        size = -(-self._vectors // (self._threads * -(-tiles // self._threads)))
        tiles = -(-self._vectors // size)
        whole = aligned((tiles, size * block + _APART // dtype.itemsize), dtype)
        return whole[:, : size * block].reshape(tiles, size, where.rows, where.width)

    def go(
        self,
        plant: Plant,
        lowpass: DiscreteFilter,
        steps: Steps,
        rows: np.ndarray,
    ) -> None:
        """Fill the memory, and go through the record.

        Args:
            plant: as in `Native.run`, like `lowpass` and `steps`.
            lowpass: F.
            steps: of one record.
            rows: of these, by `rows_of`; the first ones only, if the others do not count.
        """
        where, dtype = self._code.where, self._what.dtype
        fixed = self._start(plant, lowpass, steps)
        rare, block, emphasis = self._events(steps)
        tiles, size = self._memory.shape[:2]
        count = max(1, _CHUNK_BYTES // (max(len(where.shared), 1) * dtype.itemsize))
        shared = aligned((min(count, len(rows)), max(len(where.shared), 1)), dtype)
        for first in range(0, len(rows), count):
            last = min(first + count, len(rows))
            self._code.steps(
                rows[first:].ctypes.data,
                fixed.ctypes.data,
                self._carries.ctypes.data,
                shared.ctypes.data,
                last - first,
            )
            now = rare[first:last].copy()
            now[max(0, len(now) - where.together + 1) :] = 1  # no pair reaches into the next chunk
            taken = np.zeros(1, np.int64)
            together(
                functools.partial(
                    self._code.lanes,
                    self._memory.ctypes.data,
                    self._vectors,
                    size,
                    self._memory.strides[0] // dtype.itemsize,
                    taken.ctypes.data,
                    shared.ctypes.data,
                    now.ctypes.data,
                    fixed.ctypes.data,
                    emphasis.ctypes.data,
                    block[first:].ctypes.data,
                    emphasis.shape[1],
                    last - first,
                ),
                min(self._threads, tiles),
            )

    def sums(self) -> Sums:
        """What has been added up."""
        return jax.tree.map(self._gathered, self._code.program.sums)

    def _gathered(self, places: np.ndarray) -> np.ndarray:
        program, where, count = self._code.program, self._code.where, len(self._lanes)
        out = np.empty((count, *places.shape), self._what.dtype)
        for at in np.ndindex(places.shape):
            i = program.same[places[at]]
            if i in where.carries:
                value = self._memory[:, :, where.carries[i]].reshape(-1)[:count]
            elif i in where.steps:
                value = self._carries[where.steps[i]]
            else:
                value = program.initial[i].value
            out[(slice(None), *at)] = value
        out[self._spoilt] = np.nan
        return out

    def _start(self, plant: Plant, lowpass: DiscreteFilter, steps: Steps) -> np.ndarray:
        """Write carries and constants of the lanes; returns what all lanes share."""
        program, dtype = self._code.program, self._what.dtype
        lane = numbers(self._lanes.without_emphasis(), dtype, skip=1).reshape(len(self._lanes), -1)
        ends = np.asarray(steps.y)[0], np.asarray(steps.y_next)[0]
        all_lanes = numbers((plant, lowpass, steps.sample_period, *ends), dtype)
        groups = {"lane": lane.T, "fixed": all_lanes}
        wanted = [*(program.initial[i] for i in program.lane_carries), *program.own]
        values = evaluated(wanted, lambda at: groups[at[0]][at[1]], dtype)
        rows = spread(values, len(self._lanes), dtype)
        self._spoilt |= np.any(np.isnan(rows[len(program.lane_carries) :]), axis=0)
        tiles, size, _, width = self._memory.shape
        lines = rows[:, self._padding].reshape(len(rows), tiles, size, width)
        self._memory[:, :, : len(rows)] = np.moveaxis(lines, 0, 2)
        carries = [program.initial[i] for i in program.step_carries]
        fixed, self._carries = (
            np.array([*evaluated(nodes, lambda at: all_lanes[at[1]], dtype), 0.0], dtype)
            for nodes in (program.fixed, carries)
        )
        return fixed

    def _events(self, steps: Steps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the next few steps hold a flag, the block of each step, the lanes' emphasis."""
        ends = np.asarray(steps.block_end)
        flags = np.asarray(steps.restart).copy()
        if self._what.store == "scores" or self._lanes.emphasis is not None:
            flags |= ends
        rare = flags.copy()
        for ahead in range(1, self._code.where.together):
            rare[:-ahead] |= flags[ahead:]
        if self._lanes.emphasis is None:
            return rare.astype(np.uint8), np.zeros(len(ends), np.int64), np.zeros((1, 1))
        emphasis = np.asarray(self._lanes.emphasis, self._what.dtype)
        block = np.minimum(np.cumsum(ends) - ends, emphasis.shape[1] - 1)
        lines = emphasis[self._padding].reshape(-1, self._code.where.width, emphasis.shape[1])
        return rare.astype(np.uint8), block.astype(np.int64), copied(lines.transpose(0, 2, 1))
