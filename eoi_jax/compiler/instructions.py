r"""A lane program as code of the machine, by way of LLVM: one vector instruction for several lanes.

Two functions. `steps` goes through the samples and writes what all lanes share, one row a step;
`lanes` goes through the samples for a tile of lanes, whose carries stay in the core's first cache:

    every few steps:  read their shared rows
        for each vector of lanes in the tile:  read carries, compute, write those that changed

Memory is the host's. A vector's numbers lie together, one row of `width` lanes for each carry and
each of the lane's own constants, so that all offsets are known when the code is written.

LLVM is that of `llvmlite`, which Numba brings along. Writing its language directly keeps the
precision of every operation and the width of the vectors in our hands, and compiles in tenths of
a second, because there are no types to infer.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.compiler.graph import Node, ordered
from eoi_jax.compiler.llvm import (
    Scope,
    Text,
    as_flag,
    as_number,
    begin,
    end,
    loop,
    loop_end,
    module,
    register_bytes,
)
from eoi_jax.compiler.loop import BLOCK, BOTH, CARRY, LANE, ONCE, STEP, LaneProgram, Update

# Two registers for each number: the arithmetic of one fills the waiting times of the other. Two
# steps before a sum goes back to memory: half the traffic. More of either fills no more of them.
_REGISTERS, TOGETHER = 2, 2


@dataclass(frozen=True)
class Layout:
    """Where things lie.

    Attributes:
        width: lanes in one vector.
        rows: of a vector's block of memory; carries first, then the lane's own constants.
        carries: row of each carry, by its number.
        own: row of each of the lane's constants.
        shared: column of each shared number in a step's row.
        fixed: place of each fixed number.
        steps: place of each carry that all lanes share, by its number.
        columns: numbers of a step in the record.
        together: steps between one reading and writing of carries, where no flag is set.
    """

    width: int
    rows: int
    carries: dict[int, int]
    own: dict[Node, int]
    shared: dict[Node, int]
    fixed: dict[Node, int]
    steps: dict[int, int]
    columns: int
    together: int


def layout(program: LaneProgram, columns: int, dtype: Any, width: int | None = None) -> Layout:
    """Where a program's numbers lie.

    Args:
        program: sorted.
        columns: numbers in a row of the record.
        dtype: of all numbers.
        width: lanes in one vector; what fills two registers if None.
    """
    count = len(program.lane_carries)
    # What happens is known after each step; and an odd last step is left to the way of rare events,
    # which a program without flags does not have.
    single = program.events or not program.flagged
    rows = count + len(program.own)
    return Layout(
        width=width or _REGISTERS * register_bytes() // np.dtype(dtype).itemsize,
        # Odd: rows of vectors a power of two apart would compete for the same lines of the cache.
        rows=rows + 1 - rows % 2,
        carries={i: row for row, i in enumerate(program.lane_carries)},
        own={node: count + row for row, node in enumerate(program.own)},
        shared={node: column for column, node in enumerate(program.shared)},
        fixed={node: place for place, node in enumerate(program.fixed)},
        steps={i: place for place, i in enumerate(program.step_carries)},
        columns=columns,
        together=1 if single else TOGETHER,
    )


# -- the two functions ------------------------------------------------------------------------

_STEPS = (
    "define void @steps(ptr noalias readonly %record, ptr noalias readonly %fixed, "
    "ptr noalias %carries, ptr noalias %shared, i64 %count) #0 {"
)
_LANES = (
    "define void @lanes(ptr noalias %memory, i64 %vectors, i64 %size, i64 %stride, "
    "ptr noalias %taken, "
    "ptr noalias readonly %shared, ptr noalias readonly %rares, ptr noalias readonly %fixed, "
    "ptr noalias readonly %emphasis, ptr noalias readonly %block, i64 %blocks, "
    "i64 %count) #0 {"
)
# Threads take tiles from one counter, so that none waits for Python or for a slower one.
_TILE = """  br label %tile
tile:
  %number = atomicrmw add ptr %taken, i64 1 monotonic
  %first = mul i64 %number, %size
  %left = sub i64 %vectors, %first
  %any = icmp sgt i64 %left, 0
  br i1 %any, label %tile.body, label %tile.out
tile.body:
  %offset = mul i64 %number, %stride
  %last = icmp slt i64 %left, %size
  %own = select i1 %last, i64 %left, i64 %size
  br label %step
"""


def _write_steps(text: Text, program: LaneProgram, where: Layout) -> None:
    begin(text, _STEPS)
    text.add("  br label %step")
    loop(text, "step", "entry", "%count")
    row = text.let(f"mul i64 %step.k, {where.columns}")
    row = text.place("%record", row)

    def outside(node: Node) -> str | None:
        if node in where.fixed:
            return as_flag(scope, text, node, text.load("%fixed", where.fixed[node]))
        if node.op == "input":
            group, i = node.value
            return text.load(row, i) if group == "step" else text.load("%carries", where.steps[i])
        return None

    scope = Scope(text, 1, outside, lambda node: node.op == "constant")
    target = text.let(f"mul i64 %step.k, {len(where.shared)}")
    target = text.place("%shared", target)
    for node, column in where.shared.items():
        text.store(as_number(scope, text, node, scope.value(node)), target, column)
    new = [(update, scope.value(update.node)) for update in program.step_updates]
    for update, value in new:
        text.store(value, "%carries", where.steps[update.carry])
    loop_end(text, "step")
    end(text)


def _write_lanes(text: Text, program: LaneProgram, where: Layout) -> None:
    ways = (
        [("plain", where.together), ("rare", 1)] if program.flagged else [("plain", where.together)]
    )
    ends = ", ".join(f"[ %{name}.after, %{name}.out ]" for name, _ in ways)
    begin(text, _LANES)
    text.add(
        _TILE,
        "step:",
        f"  %step.k = phi i64 [ 0, %tile.body ], {ends}",
        "  %step.more = icmp slt i64 %step.k, %count",
        "  br i1 %step.more, label %step.body, label %step.out",
        "step.body:",
    )
    if program.flagged:
        flag = text.let("getelementptr i8, ptr %rares, i64 %step.k")
        flag = text.let(f"load i8, ptr {flag}")
        flag = text.let(f"icmp ne i8 {flag}, 0")
        text.add(f"  br i1 {flag}, label %rare.head, label %plain.head")
    else:
        text.add("  br label %plain.head")
    for name, steps in ways:
        text.add(f"{name}.head:")
        rows = []
        for j in range(steps):
            k = text.let(f"add i64 %step.k, {j}")
            k = text.let(f"mul i64 {k}, {len(where.shared)}")
            rows.append(text.place("%shared", k))
        text.add(f"  br label %{name}")
        loop(text, name, f"{name}.head", "%own")
        _VectorSteps(text, program, where, name, rows).write()
        loop_end(text, name)
        text.add(f"  %{name}.after = add i64 %step.k, {steps}", "  br label %step")
    text.add("step.out:", "  br label %tile", "tile.out:")
    end(text)


class _VectorSteps:
    """Some steps of one vector of lanes: one scope for each step, one for what they share."""

    def __init__(
        self, text: Text, program: LaneProgram, where: Layout, name: str, rows: Sequence[str]
    ):
        self._text, self._program, self._where = text, program, where
        self._name, self._vector, self._rows = name, f"%{name}.k", rows
        self._updates = program.plain if name == "plain" else program.rare
        self._next = {one.carry: one.node for one in self._updates}
        offset = text.let(f"mul i64 {self._vector}, {where.rows * where.width}")
        self._base = text.place("%memory", text.let(f"add i64 %offset, {offset}"))
        self._always = self._scope(self._outside_steps)
        self._each = [self._scope(functools.partial(self._outside, j)) for j in range(len(rows))]
        self._first: dict[int, str] = {}

    def write(self) -> None:
        """All lines: what is needed for each carry's last value, and that value's way back."""
        usual, rare = self._program.plain, self._program.rare
        if self._name == "rare" or not self._program.events:
            way = self._name == "rare"
            self._stored(rare if way else usual)
            return
        # The usual way is computed before the branch: the other one uses much of it.
        for one in usual:
            self._each[0].value(one.node)
        self._text.add(f"  br i1 {self._any_event()}, label %event, label %usual", "usual:")
        self._stored(usual)
        self._text.add(f"  br label %{self._name}.end", "event:")
        self._stored(rare)

    def _any_event(self) -> str:
        """Whether anything happens to any lane of the vector."""
        scope, width, let = self._each[0], self._where.width, self._text.let
        flag = scope.value(self._program.events[0])
        for event in self._program.events[1:]:
            flag = let(f"or {scope.flag} {flag}, {scope.value(event)}")
        if width == 1:
            return flag
        name = f"@llvm.vector.reduce.or.v{width}i1"
        self._text.declared.add(f"declare i1 {name}({scope.flag})")
        return let(f"call i1 {name}({scope.flag} {flag})")

    def _stored(self, updates: Sequence[Update]) -> None:
        scope, width = self._each[-1], self._where.width
        # What is stored as it was read needs no line.
        changed = [one for one in updates if one.node.value != (CARRY, one.carry)]
        nodes = ordered([one.node for one in changed])
        old = {node.value[1] for node in nodes if node.op == "input" and node.value[0] == CARRY}
        for update in changed:
            value = scope.value(update.node)
            if update.carry in old:  # others may still want what is about to be overwritten
                self._carry(0, update.carry)
            place = self._where.carries[update.carry] * width
            self._text.store(value, self._base, place, self._always.real)

    def _scope(self, outside: Callable[[Node], str | None]) -> Scope:
        def never_nan(node: Node) -> bool:
            # The host answers for lanes with a NaN of their own.
            return self._program.level(node) in (ONCE, LANE)

        return Scope(self._text, self._where.width, outside, never_nan)

    def _outside(self, j: int, node: Node) -> str | None:
        """What step j does not compute itself."""
        level = self._program.level(node)
        if level == BOTH and node.op == "input":
            group, i = node.value
            return self._emphasis() if group == BLOCK else self._carry(j, i)
        if level == STEP:
            return self._spread(node, self._text.load(self._rows[j], self._where.shared[node]))
        return None if level == BOTH else self._always.value(node)

    def _outside_steps(self, node: Node) -> str:
        if self._program.level(node) == LANE:
            place = self._where.own[node] * self._where.width
            number = self._text.load(self._base, place, self._always.real)
            return as_flag(self._always, self._text, node, number)
        return self._spread(node, self._text.load("%fixed", self._where.fixed[node]))

    def _spread(self, node: Node, number: str) -> str:
        number = self._always.spread(number, self._text.real)
        return as_flag(self._always, self._text, node, number)

    def _carry(self, j: int, i: int) -> str:
        """A carried number before step j."""
        if j > 0:
            return self._each[j - 1].value(self._next[i])
        if i not in self._first:
            place = self._where.carries[i] * self._where.width
            self._first[i] = self._text.load(self._base, place, self._always.real)
        return self._first[i]

    def _emphasis(self) -> str:
        """Of this vector's lanes, in the block of this step."""
        let = self._text.let
        block = let("getelementptr i64, ptr %block, i64 %step.k")
        block = let(f"load i64, ptr {block}")
        vector = let(f"add i64 %first, {self._vector}")
        line = let(f"mul i64 {vector}, %blocks")
        line = let(f"add i64 {line}, {block}")
        line = let(f"mul i64 {line}, {self._where.width}")
        return self._text.load("%emphasis", line, self._always.real)


def source(program: LaneProgram, where: Layout, dtype: Any) -> str:
    """Both functions in LLVM's language."""
    text = Text("float" if np.dtype(dtype) == np.float32 else "double")
    _write_steps(text, program, where)
    _write_lanes(text, program, where)
    return module(text)
