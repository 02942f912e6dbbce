"""Loops of few lanes, all in one vector (`one_vector.py`), and their runs."""

import ctypes
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.compiler import one_vector
from eoi_jax.compiler.graph import Node, Untranslatable, evaluated
from eoi_jax.compiler.instructions import Layout, layout
from eoi_jax.compiler.jit import aligned, engine_of, program_of, spread
from eoi_jax.compiler.loop import LANE, AbstractLoop, LaneProgram
from eoi_jax.compiler.translation import kept_translation


@dataclass(frozen=True)
class FewLanes:
    """A loop as code of this machine.

    Attributes:
        program: what it computes. where: its numbers lie.
        shown: where each number lies in a row of what is shown; one column if all lanes share it.
        go: the function of `one_vector.py`.
        dtype: of all numbers.
        owner: of the code's memory.
    """

    program: LaneProgram
    where: Layout
    shown: list[slice]
    go: Callable
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
        program, where, dtype = self.program, self.where, self.dtype
        groups, count = {"lane": lanes, "fixed": fixed}, lanes.shape[1]

        def known(nodes: Sequence[Node]) -> list[Any]:
            return evaluated(nodes, lambda at: groups[at[0]][at[1]], dtype)

        memory = aligned((where.rows, where.width), dtype)
        values = known([*(program.initial[i] for i in program.lane_carries), *program.own])
        memory[: len(values), :count] = spread(values, count, dtype)
        carries = [program.initial[i] for i in program.step_carries]
        # Never empty: they have an address.
        shared, carried = (np.array([*known(one), 0.0], dtype) for one in (program.fixed, carries))
        return Run(self, count, shared, carried, memory)


@dataclass(frozen=True)
class Run:
    """One of them over one record.

    Attributes:
        code: that runs.
        lanes: how many.
        fixed: what all lanes and rows share.
        carries, memory: what is carried for all lanes, and for each.
    """

    code: FewLanes
    lanes: int
    fixed: np.ndarray
    carries: np.ndarray
    memory: np.ndarray

    def through(
        self, rows: np.ndarray, count: int, out: np.ndarray | None = None
    ) -> Iterator[np.ndarray]:
        """Through the rows of a record, so many at a time.

        Args:
            rows: as the loop reads them, one after the other in memory.
            count: at a time.
            out: where all that they show goes, as many rows or more; None for one array of `count`
                rows, which is written over and over.

        Returns:
            What they show, in the columns of `FewLanes.shown`.
        """
        width = self.code.shown[-1].stop
        kept = aligned((min(count, len(rows)), width), self.code.dtype) if out is None else out
        arrays = rows, self.fixed, self.carries, self.memory
        start, *others = (one.ctypes.data for one in arrays)
        for first in range(0, len(rows), count):
            now = min(count, len(rows) - first)
            shown = kept[:now] if out is None else kept[first : first + now]
            self.code.go(start + first * rows.strides[0], *others, shown.ctypes.data, now)
            yield shown

    def carried(self, number: Any) -> Any:
        """A carried number: of each lane, or the one that they share."""
        program, where = self.code.program, self.code.where
        i = program.same[number]
        if i in where.carries:
            return self.memory[where.carries[i], : self.lanes]
        return self.carries[where.steps[i]] if i in where.steps else program.initial[i].value


@kept_translation
def few_lanes(what: AbstractLoop, columns: int, lanes: int) -> FewLanes:
    """Trace, sort and compile a loop for so many lanes at most, once.

    Args:
        what: the loop.
        columns: numbers in a row of its record.
        lanes: that fill the vector.

    Raises:
        Untranslatable: what a scalar program cannot express; flags, or branches that lanes take
            each for itself.
    """
    program = program_of(what)
    if program.flagged or any(program.level(one) & LANE for one in program.events):
        raise Untranslatable("flags, or branches of the lanes")
    where = layout(program, columns, what.dtype, one_vector.width_for(lanes, what.dtype))
    # Side by side is what the vectors are for: LLVM finds no more of it.
    engine = engine_of(one_vector.source(program, where, what.dtype), slp=False)
    kind = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 5, ctypes.c_int64)
    go = kind(engine.get_function_address("whole"))
    shown = one_vector.shown_places(program, where)
    return FewLanes(program, where, shown, go, what.dtype, engine)
