r"""A sorted loop as code of the machine, by way of LLVM: one vector instruction for several lanes.

One writer serves one lane and many. Its loop goes through the rows for one vector of lanes after
the other, with all that it carries in variables that LLVM keeps in registers:

    for each vector of lanes:  read carries
        for each row:  compute, update
        write carries

What all lanes share of a row comes to them in one of two ways:

    from a row  a loop before, of single numbers (the same writer), has left it there; for many
                vectors, of which each would compute it again
    inline      single numbers beside the vector's, carried in registers too; for one vector: the
                two wait for each other hardly at all, and nothing goes through memory

Memory is the host's. A vector's numbers lie together, one row of `width` lanes for each carry and
each of the lane's constants, so that all offsets are fixed when the code is written.

LLVM is that of `llvmlite`, which Numba brings along. Writing its language directly leaves the
precision of every operation and the width of the vectors to us, and compiles in tenths of a second,
because there are no types to infer.
"""

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.compiler.graph import Node
from eoi_jax.compiler.llvm import (
    Scope,
    Text,
    as_flag,
    as_number,
    begin,
    end,
    module,
    register_bytes,
)
from eoi_jax.compiler.loop import BLOCK, FIXED, LANE, LANE_ROW, Body, LaneProgram, Path


@dataclass(frozen=True)
class Layout:
    """Where things lie.

    Attributes:
        inline: whether what lanes share is computed beside them, else read from a row.
        width: lanes in one vector.
        rows: of a vector's block of memory; carries first, then the lane's constants.
        carries: row of each carry of the lanes, by its number.
        constants: row of each constant of a lane.
        scalars: place of each carry that all lanes share, by its number.
        fixed: place of each fixed number.
        columns: numbers in a row of the table that the loop goes through.
    """

    inline: bool
    width: int
    rows: int
    carries: dict[int, int]
    constants: dict[Node, int]
    scalars: dict[int, int]
    fixed: dict[Node, int]
    columns: int


def layout(
    program: LaneProgram, columns: int, dtype: Any, lanes: int | None = None, inline: bool = False
) -> Layout:
    """Where a program's numbers lie.

    Args:
        program: sorted.
        columns: numbers in a row of the table.
        dtype: of all numbers.
        lanes: in one vector; what fills a register if None.
        inline: whether what lanes share is computed beside them; they then fill one vector.
    """
    count = len(program.lane_carries)
    rows = count + len(program.lane_constants)
    return Layout(
        inline=inline,
        # Of two registers for each number most would lie in memory: a pass carries dozens.
        width=lanes or register_bytes() // np.dtype(dtype).itemsize,
        # Odd: vectors a power of two apart would compete for the same lines of the cache.
        rows=rows + 1 - rows % 2,
        carries={i: row for row, i in enumerate(program.lane_carries)},
        constants={node: count + row for row, node in enumerate(program.lane_constants)},
        scalars={i: place for place, i in enumerate(program.shared_carries)},
        fixed={node: place for place, node in enumerate(program.fixed)},
        columns=columns,
    )


def width_for(lanes: int, dtype: Any) -> int:
    """Numbers of a vector for so many lanes: a power of two, which LLVM splits into registers."""
    register_numbers = register_bytes() // np.dtype(dtype).itemsize
    return max(register_numbers, 1 << (lanes - 1).bit_length())


def output_places(program: LaneProgram, body: Body, width: int) -> list[slice]:
    """Where a row of outputs has each: a vector, or a single number if all lanes share it."""
    pairs = zip(body.common.outputs, body.general.outputs, strict=True)
    by_lane = [any(program.level(node) & LANE for node in pair) for pair in pairs]
    ends = np.cumsum([0, *(width if differs else 1 for differs in by_lane)])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def source(program: LaneProgram, memory: Layout, dtype: Any) -> str:
    """All loops in LLVM's language: `lanes`, and `shared` before it where they read rows."""
    text = Text("float" if np.dtype(dtype) == np.float32 else "double")
    if memory.inline:
        _Loop(text, "lanes", program, program.whole_body, memory, memory.columns).write()
    else:
        _Loop(text, "shared", program, program.shared_body, memory, memory.columns).write()
        _Loop(text, "lanes", program, program.lane_body, memory, len(program.shared)).write()
    return module(text)


# Vectors come from a counter, so that no thread waits for Python or for a slower one.
_DEFINITION = (
    "define void @{name}(ptr noalias %memory, ptr noalias %next, i64 %vectors, "
    "ptr noalias readonly %rows, ptr noalias %scalars, ptr noalias readonly %fixed, "
    "ptr noalias readonly %flags, ptr noalias readonly %blocks, "
    "ptr noalias readonly %block_values, i64 %block_count, "
    "ptr noalias %outputs, i64 %count) #0 {{"
)
_NEXT_VECTOR = """  br label %vector
vector:
  %number = atomicrmw add ptr %next, i64 1 monotonic
  %vector.more = icmp slt i64 %number, %vectors
  br i1 %vector.more, label %vector.body, label %vector.out
vector.body:"""
_NEXT_ROW = """  store i64 0, ptr %row.at
  br label %row
row:
  %row.k = load i64, ptr %row.at
  %row.more = icmp slt i64 %row.k, %count
  br i1 %row.more, label %row.body, label %row.out
row.body:"""


class _Loop:
    """Lines of one loop: two scopes, of single numbers and of vectors."""

    def __init__(
        self,
        text: Text,
        name: str,
        program: LaneProgram,
        body: Body,
        memory: Layout,
        columns: int,
    ):
        self._text, self._name, self._columns = text, name, columns
        self._program, self._body, self._layout = program, body, memory
        self._places = output_places(program, body, memory.width)
        self._scalar, self._vector = self._scopes()
        self._fixed: dict[Node, tuple[str, str]] = {}
        self._constants: dict[Node, str] = {}
        self._table_row = ""
        self._carried: dict[int, str] = {}
        self._numbers: dict[Node, str] = {}
        paths = (
            zip((*body.scalars, *body.vectors), (*path.scalars, *path.vectors), strict=True)
            for path in (body.common, body.general)
        )
        self._common, self._general = map(dict, paths)

    def write(self) -> None:
        """The whole function."""
        text, body = self._text, self._body
        begin(text, _DEFINITION.format(name=self._name))
        for i in self._common:
            text.add(f"  %c{i} = alloca {self._kind(i)}")
        text.add("  %row.at = alloca i64", *_NEXT_VECTOR.split("\n"))
        self._read_memory()
        text.add(*_NEXT_ROW.split("\n"))
        self._carried = {i: text.let(f"load {self._kind(i)}, ptr %c{i}") for i in self._common}
        self._table_row = text.place("%rows", text.let(f"mul i64 %row.k, {self._columns}"))
        if body.flagged:
            flag = text.let("getelementptr i8, ptr %flags, i64 %row.k")
            flag = text.let(f"icmp ne i8 {text.let(f'load i8, ptr {flag}')}, 0")
            text.add(f"  br i1 {flag}, label %flagged, label %common", "common:")
        self._write_common()
        if body.flagged:
            text.add("flagged:")
            # Names of the common path do not hold here, for it does not come before.
            self._scalar, self._vector = self._scopes()
            self._numbers = {}
            self._write_path(body.general, self._general)
            self._next_row()
        text.add("row.out:")
        self._write_memory()
        text.add("  br label %vector", "vector.out:")
        end(text)

    def _write_common(self) -> None:
        """What is computed where no flag is set, and where something happens all the same."""
        text, body = self._text, self._body
        if not body.events:
            self._write_path(body.common, self._common)
            self._next_row()
            return
        # The common path is computed before the branch: the general one uses much of it.
        self._computed(body.common, self._common)
        event = self._any_event()
        text.add(f"  br i1 {event}, label %event, label %usual", "usual:")
        self._write_path(body.common, self._common)
        self._next_row()
        text.add("event:")
        self._write_path(body.general, self._general)
        self._next_row()

    def _next_row(self) -> None:
        after = self._text.let("add i64 %row.k, 1")
        self._text.add(f"  store i64 {after}, ptr %row.at", "  br label %row")

    def _scopes(self) -> tuple[Scope, Scope]:
        """Of single numbers and of vectors."""
        never_nan = _is_constant if self._layout.inline else self._same_in_all_rows
        scalar = Scope(self._text, 1, self._outside_scalar, _is_constant)
        return scalar, Scope(self._text, self._layout.width, self._outside_vector, never_nan)

    # -- memory -------------------------------------------------------------------------------

    def _kind(self, carry: int) -> str:
        return self._scope(carry).real

    def _memory_places(self) -> dict[int, tuple[str, int]]:
        """Where each carried number lies between two calls."""
        memory = self._layout
        scalars = {i: ("%scalars", memory.scalars[i]) for i in self._body.scalars}
        vectors = {i: ("%vector.at", memory.carries[i] * memory.width) for i in self._body.vectors}
        return scalars | vectors

    def _read_memory(self) -> None:
        """Carries, and what stays the same in all rows."""
        text, memory = self._text, self._layout
        scalar, vector = self._scalar, self._vector
        offset = text.let(f"mul i64 %number, {memory.rows * memory.width}")
        text.add(f"  %vector.at = getelementptr {text.real}, ptr %memory, i64 {offset}")
        for i, (pointer, place) in self._memory_places().items():
            kind = self._kind(i)
            text.add(f"  store {kind} {text.load(pointer, place, kind)}, ptr %c{i}")
        for node, place in memory.fixed.items():
            number = text.load("%fixed", place)
            wide = as_flag(vector, text, node, vector.spread(number, text.real))
            self._fixed[node] = as_flag(scalar, text, node, number), wide
        if self._body.vectors:
            for node, row in memory.constants.items():
                number = text.load("%vector.at", row * memory.width, vector.real)
                self._constants[node] = as_flag(vector, text, node, number)

    def _write_memory(self) -> None:
        text = self._text
        for i, (pointer, place) in self._memory_places().items():
            kind = self._kind(i)
            text.store(text.let(f"load {kind}, ptr %c{i}"), pointer, place, kind)

    # -- values -------------------------------------------------------------------------------

    def _scope(self, carry: int) -> Scope:
        return self._scalar if carry in self._body.scalars else self._vector

    def _computed(self, path: Path, carries: dict[int, Node]) -> tuple[dict[int, str], list[str]]:
        """Names of the carries after a row, and of its outputs, each as wide as its place."""
        outputs = []
        for place, node in zip(self._places, path.outputs, strict=True):
            scope = self._vector if place.stop - place.start > 1 else self._scalar
            outputs.append(as_number(scope, self._text, node, scope.value(node)))
        return {i: self._scope(i).value(node) for i, node in carries.items()}, outputs

    def _write_path(self, path: Path, carries: dict[int, Node]) -> None:
        """Outputs of a row, and what is carried after it."""
        text = self._text
        new, outputs = self._computed(path, carries)
        if outputs:
            # Outputs of one vector lie behind those of the vector before.
            first = text.let("mul i64 %number, %count")
            row = text.let(f"add i64 {first}, %row.k")
            line = text.place("%outputs", text.let(f"mul i64 {row}, {self._places[-1].stop}"))
            for value, place in zip(outputs, self._places, strict=True):
                wide = place.stop - place.start > 1
                scope = self._vector if wide else self._scalar
                text.store(value, line, place.start, scope.real)
        for i, value in new.items():
            text.add(f"  store {self._kind(i)} {value}, ptr %c{i}")

    def _any_event(self) -> str:
        """Whether anything happens to any lane of the vector."""
        text, program, width = self._text, self._program, self._layout.width
        by_lane = [event for event in self._body.events if program.level(event) & LANE]
        shared = [event for event in self._body.events if not program.level(event) & LANE]
        flags = [self._scalar.value(event) for event in shared]
        if by_lane:
            scope = self._vector
            flag = self._any_flag(scope.flag, [scope.value(event) for event in by_lane])
            if width > 1:
                name = f"@llvm.vector.reduce.or.v{width}i1"
                text.declared.add(f"declare i1 {name}({scope.flag})")
                flag = text.let(f"call i1 {name}({scope.flag} {flag})")
            flags.append(flag)
        return self._any_flag("i1", flags)

    def _any_flag(self, kind: str, flags: Sequence[str]) -> str:
        return functools.reduce(lambda a, b: self._text.let(f"or {kind} {a}, {b}"), flags)

    # -- what a scope does not compute itself -------------------------------------------------

    def _same_in_all_rows(self, node: Node) -> bool:
        """The host answers for lanes with a NaN of their own."""
        return self._program.level(node) in (FIXED, LANE)

    def _number(self, node: Node) -> str:
        """What a row holds, as it is there."""
        if node not in self._numbers:
            self._numbers[node] = self._text.load(self._table_row, self._body.columns[node])
        return self._numbers[node]

    def _outside_scalar(self, node: Node) -> str | None:
        if node in self._fixed:
            return self._fixed[node][0]
        if node in self._body.columns:
            return as_flag(self._scalar, self._text, node, self._number(node))
        return self._carried[node.value[1]] if node.op == "input" else None

    def _outside_vector(self, node: Node) -> str | None:
        scope, text, level = self._vector, self._text, self._program.level(node)
        if level == LANE_ROW:
            if node.op != "input":
                return None
            group, i = node.value
            return self._block_value() if group == BLOCK else self._carried[i]
        if level == LANE:
            return self._constants[node]
        if node in self._fixed:
            return self._fixed[node][1]
        if node in self._body.columns:  # a comparison of vectors is quicker than a flag spread
            number = scope.spread(self._number(node), text.real)
            return as_flag(scope, text, node, number)
        return scope.spread(self._scalar.value(node), "i1" if node.is_bool else text.real)

    def _block_value(self) -> str:
        """Of this vector's lanes, in the block of this row."""
        let, width = self._text.let, self._layout.width
        block = let("getelementptr i64, ptr %blocks, i64 %row.k")
        block = let(f"load i64, ptr {block}")
        line = let(f"add i64 {let('mul i64 %number, %block_count')}, {block}")
        line = let(f"mul i64 {line}, {width}")
        return self._text.load("%block_values", line, self._vector.real)


def _is_constant(node: Node) -> bool:
    """Of these alone it is certain that they are no NaN, where nobody looks at the numbers."""
    return node.op == "constant"
