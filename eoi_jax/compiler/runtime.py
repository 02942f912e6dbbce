"""Runs of compiled loops: their memory, and the functions of `instructions.py` that work on it."""

import ctypes
import functools
import itertools
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.compiler.graph import Node, evaluate
from eoi_jax.compiler.instructions import Layout, layout, output_places, source, width_for
from eoi_jax.compiler.jit import cached_translation, machine_code
from eoi_jax.compiler.loop import AbstractLoop, LaneProgram, lane_program

_POINTER, _INTEGER = ctypes.c_void_p, ctypes.c_int64
_FUNCTION = ctypes.CFUNCTYPE(
    None, _POINTER, _POINTER, _INTEGER, *[_POINTER] * 6, _INTEGER, _POINTER, _INTEGER
)


@dataclass(frozen=True)
class RowFlags:
    """What is rare in the rows of a table, and what differs between its blocks.

    Attributes:
        flags: where a flag of the loop is set.
        blocks: number of the block of each row; None where nothing differs between them.
        values: of each lane in each block, the last number of a row; None like `blocks`.
    """

    flags: Bool[np.ndarray, " rows"]
    blocks: Int[np.ndarray, " rows"] | None = None
    values: Float[np.ndarray, "lanes blocks"] | None = None


@dataclass(frozen=True)
class CompiledLoop:
    """A loop as code of this machine.

    Attributes:
        program: what it computes. places: of its numbers in memory.
        outputs: where each lies in a row of outputs; one column if all lanes share it.
        lanes: the loop of the lanes.
        shared: that of what lanes share, whose outputs are the rows of `lanes`; None if inline.
        dtype: of all numbers.
        owner: of the code's memory.
    """

    program: LaneProgram
    places: Layout
    outputs: list[slice]
    lanes: Callable
    shared: Callable | None
    dtype: Any
    owner: Any

    def begin(
        self, lanes: Float[np.ndarray, "numbers lanes"], fixed: Float[np.ndarray, " shared"]
    ) -> "Run":
        """Before the first row.

        Args:
            lanes: numbers of each, in the order of the loop's `lane`.
            fixed: what all lanes and rows share, in the order of the loop's `fixed`.
        """
        return self.begin_each(lanes, fixed[None])[0]

    def begin_each(
        self, lanes: Float[np.ndarray, "numbers lanes"], fixed: Float[np.ndarray, "runs shared"]
    ) -> list["Run"]:
        """Several runs before their first rows, with what is fixed in each; else as `begin`."""
        program, places, dtype = self.program, self.places, self.dtype
        runs, count = len(fixed), lanes.shape[1]
        groups = {"lane": lanes[:, None], "fixed": fixed.T[..., None]}

        nodes = list(itertools.chain(*program.first_row))
        found = iter(
            evaluate(nodes, lambda place: groups[place[0]][place[1]], dtype, program.first_order)
        )

        def table(part: Sequence[Node], lanes: int, spare: int = 0) -> np.ndarray:
            """Values of a part, shape (runs, nodes, lanes)."""
            values = np.zeros((runs, len(part) + spare, lanes), dtype)
            for i, value in enumerate(itertools.islice(found, len(part))):
                values[:, i] = value
            return values

        carries, constants = (table(part, count) for part in program.first_row[:2])
        # Never empty: they have an address.
        shared, scalars = (table(part, 1, spare=1)[..., 0] for part in program.first_row[2:])
        spoilt = np.any(np.isnan(constants), axis=1)
        rows = np.concatenate([carries, constants], axis=1)
        vectors = -(-count // places.width)
        # Beyond the last lane it is repeated: any numbers do, but these cost no slow path.
        padding = np.minimum(np.arange(vectors * places.width), count - 1)
        lines = rows[..., padding].reshape(*rows.shape[:2], vectors, places.width)
        begun = []
        for run in range(runs):
            memory = _aligned((vectors, places.rows, places.width), dtype)
            memory[:, : rows.shape[1]] = np.moveaxis(lines[run], 0, 1)
            begun.append(Run(self, count, shared[run], scalars[run], memory, spoilt[run], padding))
        return begun


@cached_translation
def compiled_loop(
    loop: AbstractLoop, columns: int, lanes: int | None = None, inline: bool = False
) -> CompiledLoop:
    """Trace, sort and compile a loop, once.

    Args:
        loop: what is traced.
        columns: numbers in a row of its table.
        lanes: in one vector; what fills a register if None.
        inline: whether what lanes share is computed beside them; the lanes, `lanes` at most, then
            fill one vector.

    Raises:
        Untranslatable: what a scalar program cannot express; whatever else fails.
    """
    program = cached_program(loop)
    if inline:
        lanes = width_for(lanes or 1, loop.dtype)
    places = layout(program, columns, loop.dtype, lanes, inline)
    # Of lanes one by one like operations side by side become vectors; in vectors there are none.
    owner = machine_code(source(program, places, loop.dtype), slp=not inline)
    body = program.whole_body if inline else program.lane_body
    names = ("lanes",) if inline else ("lanes", "shared")
    functions = [_FUNCTION(owner.get_function_address(name)) for name in names]
    outputs = output_places(program, body, places.width)
    return CompiledLoop(program, places, outputs, functions[0],
                        None if inline else functions[1], loop.dtype, owner)  # fmt: skip


@cached_translation
def cached_program(loop: AbstractLoop) -> LaneProgram:
    """Traced and sorted, once; the same for vectors of any width."""
    return lane_program(loop)


@dataclass(frozen=True)
class Run:
    """A compiled loop on its way through a table.

    Attributes:
        code: that runs.
        lanes: how many.
        fixed: what all lanes and rows share.
        scalars, memory: what is carried for all lanes, and for each.
        spoilt: lanes with a NaN among their constants: a comparison with NaN is false, so that what
            the loop makes of it may look like a number.
        padding: which lane each place of all vectors is for.
    """

    code: CompiledLoop
    lanes: int
    fixed: np.ndarray
    scalars: np.ndarray
    memory: np.ndarray
    spoilt: Bool[np.ndarray, " lanes"]
    padding: Int[np.ndarray, " places"]

    def advance(
        self,
        rows: Float[np.ndarray, "rows columns"],
        rare: RowFlags | None = None,
        threads: int = 1,
        chunk_size: int = 500_000,
    ) -> None:
        """Through the rows of a table; for loops without outputs.

        Args:
            rows: as the loop reads them, one after the other in memory.
            rare: of these rows; None for a loop without flags.
            threads: among which the lanes are divided.
            chunk_size: bytes of what the lanes share of the rows, at a time: half a second cache.
        """
        code, total = self.code, len(rows)
        width = max(len(code.program.shared), 1)
        count = max(1, chunk_size // (width * code.dtype.itemsize))
        shared = _aligned((min(count, total), width), code.dtype)
        rows = np.ascontiguousarray(rows, code.dtype)
        flags, blocks, values = self._flags(rare, total)
        for first in range(0, total, count):
            block = slice(first, min(first + count, total))
            if code.shared is not None:
                self._call(code.shared, rows[block], shared)
            next_tile = np.zeros(1, np.int64)  # like the others it lives until all threads are done
            visible_rows = rows[block] if code.shared is None else shared[: block.stop - first]
            job = self._job(next_tile, flags[block], blocks[block], values, visible_rows)
            run_in_threads(job, min(threads, len(self.memory)))

    def outputs(
        self, rows: np.ndarray, count: int, buffer: np.ndarray | None = None
    ) -> Iterator[np.ndarray]:
        """Through the rows of a table, so many at a time; for inline loops without flags.

        Args:
            rows: as the loop reads them, one after the other in memory.
            count: at a time.
            buffer: where all outputs go, as many rows or more; None for one array of `count` rows,
                which is written over and over.

        Returns:
            Outputs, in the columns of `CompiledLoop.outputs`.
        """
        width = self.code.outputs[-1].stop
        reused = buffer is None
        if buffer is None:
            buffer = _aligned((min(count, len(rows)), width), self.code.dtype)
        for first in range(0, len(rows), count):
            block_rows = min(count, len(rows) - first)
            written = buffer[:block_rows] if reused else buffer[first : first + block_rows]
            self._call(self.code.lanes, rows[first : first + block_rows], written)
            yield written

    def carried(self, number: Any) -> Any:
        """A carried number: of each lane, or a single one that they share."""
        program, places = self.code.program, self.code.places
        i = program.representatives[number]
        if i in places.carries:
            return self.memory[:, places.carries[i]].reshape(-1)[: self.lanes]
        return self.scalars[places.scalars[i]] if i in places.scalars else program.initial[i].value

    def result(self) -> Any:
        """What the loop wants in the end, the lanes as leading axis; NaN for those spoilt."""
        return jax.tree.map(self._gathered, self.code.program.result)

    def _gathered(self, places: np.ndarray) -> np.ndarray:
        values = np.empty((self.lanes, *places.shape), self.code.dtype)
        for index in np.ndindex(places.shape):
            values[(slice(None), *index)] = self.carried(places[index])
        values[self.spoilt] = np.nan
        return values

    def _flags(
        self, rare: RowFlags | None, total: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whether each row has a flag, the block of each row, values of the blocks."""
        no_blocks, nowhere = np.zeros((1, 1)), np.zeros(total, np.int64)
        if rare is None:
            return np.zeros(total, np.uint8), nowhere, no_blocks
        flags = rare.flags.astype(np.uint8)
        if rare.values is None or rare.blocks is None:
            return flags, nowhere, no_blocks
        values = np.asarray(rare.values, self.code.dtype)
        lines = values[self.padding].reshape(-1, self.code.places.width, values.shape[1])
        by_vector = _aligned((len(lines), values.shape[1], self.code.places.width), lines.dtype)
        by_vector[...] = lines.transpose(0, 2, 1)
        blocks = np.minimum(rare.blocks, values.shape[1] - 1)
        return flags, blocks.astype(np.int64), by_vector

    def _call(self, function: Callable, rows: np.ndarray, result: np.ndarray) -> None:
        """A loop without flags over a vector, or none, in this thread."""
        next_tile = np.zeros(1, np.int64)
        pointers = [array.ctypes.data for array in (rows, self.scalars, self.fixed)]
        function(
            self.memory.ctypes.data, next_tile.ctypes.data, 1, *pointers,
            None, None, None, 0, result.ctypes.data, len(rows),
        )  # fmt: skip

    def _job(
        self,
        next_tile: np.ndarray,
        flags: np.ndarray,
        blocks: np.ndarray,
        values: np.ndarray,
        rows: np.ndarray,
    ) -> Callable[[], None]:
        """The loop of the lanes, for several threads to call; it works on the caller's arrays."""
        arrays = rows, self.scalars, self.fixed, flags, blocks, values
        return functools.partial(
            self.code.lanes,
            self.memory.ctypes.data,
            next_tile.ctypes.data,
            len(self.memory),
            *(array.ctypes.data for array in arrays),
            values.shape[1],
            None,
            len(rows),
        )


def numbers(tree: Any, dtype: Any, skip: int = 0) -> np.ndarray:
    """The real numbers and flags of a tree in the order in which `shapes_of` counts them."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    flat = [
        array.astype(dtype).reshape(*array.shape[:skip], -1)
        for array in arrays
        if array.dtype.kind in "fb"
    ]
    return np.concatenate(flat, axis=-1)


def _aligned(shape: tuple[int, ...], dtype: Any, line: int = 64) -> np.ndarray:
    """Zeros that begin with a line of the cache, the bytes that it moves at a time."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + line, np.uint8)
    start = -raw.ctypes.data % line
    return raw[start : start + size].view(dtype).reshape(shape)


# -- threads ----------------------------------------------------------------------------------


def cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_in_threads(job: Callable[[], None], threads: int) -> None:
    """The same call in several threads; compiled code runs without Python's lock."""
    pending = [_pool(threads - 1).submit(job) for _ in range(threads - 1)] if threads > 1 else []
    job()
    for call in pending:
        call.result()


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")


if hasattr(os, "register_at_fork"):  # threads do not come along
    os.register_at_fork(after_in_child=_pool.cache_clear)
