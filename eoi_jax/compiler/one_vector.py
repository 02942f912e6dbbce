"""A lane program whose lanes fill one vector, as one loop that keeps all it carries in registers.

What all lanes share is computed beside it, in single numbers. The two wait for each other hardly at
all, where the two loops of `instructions.py` go through the record one after the other, and read
and write what they carry in every step.
"""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from eoi_jax.compiler.graph import Node
from eoi_jax.compiler.instructions import Layout
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
from eoi_jax.compiler.loop import BOTH, LANE, LaneProgram, Update

_DEFINITION = (
    "define void @whole(ptr noalias readonly %record, ptr noalias readonly %fixed, "
    "ptr noalias %carries, ptr noalias %memory, ptr noalias %shown, i64 %count) #0 {"
)


def width_for(lanes: int, dtype: Any) -> int:
    """Numbers of a vector for so many lanes: a power of two, which LLVM splits into registers."""
    least = register_bytes() // np.dtype(dtype).itemsize
    return max(least, 1 << (lanes - 1).bit_length())


def shown_places(program: LaneProgram, where: Layout) -> list[slice]:
    """Where a row of what is shown has each number: a vector, or one if all lanes share it."""
    pairs = zip(*program.shown, strict=True)
    own = [any(program.level(one) & LANE for one in pair) for pair in pairs]
    sizes = [where.width if each else 1 for each in own]
    ends = np.cumsum([0, *sizes])
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]


def source(program: LaneProgram, where: Layout, dtype: Any) -> str:
    """The loop in LLVM's language."""
    text = Text("float" if np.dtype(dtype) == np.float32 else "double")
    _OneVector(text, program, where).write()
    return module(text)


class _OneVector:
    """Lines of the loop: one scope for single numbers, one for vectors."""

    def __init__(self, text: Text, program: LaneProgram, where: Layout):
        self._text, self._program, self._where = text, program, where
        # Constants alone are known to be numbers: nobody looks at what the lanes share.
        self._single = Scope(text, 1, self._outside_single, lambda node: node.op == "constant")
        self._vector = Scope(
            text, where.width, self._outside_vector, lambda node: node.op == "constant"
        )
        self._row, self._carried = "", {}

    def write(self) -> None:
        """The whole function."""
        text, program, where = self._text, self._program, self._where
        begin(text, _DEFINITION)
        self._begin()
        loop(text, "step", "entry", "%count")
        self._row = text.place("%record", text.let(f"mul i64 %step.k, {where.columns}"))
        for i in self._places():
            self._carried[i] = text.let(f"load {self._kind(i)}, ptr %c{i}")
        usual = [*program.plain_steps, *program.plain]
        if not program.events:
            self._stored(usual, program.shown[0])
        else:
            # The usual way is computed before the branch: the other one uses much of it.
            self._values(usual, program.shown[0])
            text.add(f"  br i1 {self._any_event()}, label %event, label %usual", "usual:")
            self._stored(usual, program.shown[0])
            text.add("  br label %step.end", "event:")
            self._stored([*program.step_updates, *program.rare], program.shown[1])
        loop_end(text, "step")
        for i, (pointer, place) in self._places().items():
            kind = self._kind(i)
            text.store(text.let(f"load {kind}, ptr %c{i}"), pointer, place, kind)
        end(text)

    def _begin(self) -> None:
        """Carries in variables of the function, which LLVM keeps in registers."""
        text = self._text
        for i, (pointer, place) in self._places().items():
            kind = self._kind(i)
            text.add(f"  %c{i} = alloca {kind}")
            text.add(f"  store {kind} {text.load(pointer, place, kind)}, ptr %c{i}")
        text.add("  br label %step")

    def _places(self) -> dict[int, tuple[str, int]]:
        """Where each carried number lies between two calls."""
        where = self._where
        single = {i: ("%carries", place) for i, place in where.steps.items()}
        return single | {i: ("%memory", row * where.width) for i, row in where.carries.items()}

    def _kind(self, carry: int) -> str:
        return self._single.real if carry in self._where.steps else self._vector.real

    def _values(
        self, updates: Sequence[Update], shown: Sequence[Node]
    ) -> tuple[list[str], list[str]]:
        """Of updates and of what is shown, each as wide as its place."""
        text, steps = self._text, self._where.steps
        new = [(self._single if one.carry in steps else self._vector, one.node) for one in updates]
        places = shown_places(self._program, self._where)
        scopes = [self._single if one.stop - one.start == 1 else self._vector for one in places]
        out = [
            as_number(scope, text, node, scope.value(node))
            for scope, node in zip(scopes, shown, strict=True)
        ]
        return [scope.value(node) for scope, node in new], out

    def _outside_single(self, node: Node) -> str | None:
        text, where = self._text, self._where
        if node in where.fixed:
            return as_flag(self._single, text, node, text.load("%fixed", where.fixed[node]))
        if node.op != "input":
            return None
        group, i = node.value
        return text.load(self._row, i) if group == "step" else self._carried[i]

    def _outside_vector(self, node: Node) -> str | None:
        text, level = self._text, self._program.level(node)
        if level == BOTH:
            return self._carried[node.value[1]] if node.op == "input" else None
        if level == LANE:
            place = self._where.own[node] * self._where.width
            return as_flag(self._vector, text, node, text.load("%memory", place, self._vector.real))
        return self._vector.spread(self._single.value(node), "i1" if node.is_bool else text.real)

    def _any_event(self) -> str:
        """Whether anything happens; to all lanes alike, or this loop does not serve."""
        flags = [self._single.value(one) for one in self._program.events]
        found = flags[0]
        for flag in flags[1:]:
            found = self._text.let(f"or i1 {found}, {flag}")
        return found

    def _stored(self, updates: Sequence[Update], shown: Sequence[Node]) -> None:
        text, places = self._text, shown_places(self._program, self._where)
        new, out = self._values(updates, shown)
        line = text.place("%shown", text.let(f"mul i64 %step.k, {places[-1].stop}"))
        for value, place in zip(out, places, strict=True):
            wide = place.stop - place.start > 1
            text.store(value, line, place.start, (self._vector if wide else self._single).real)
        for one, value in zip(updates, new, strict=True):
            text.add(f"  store {self._kind(one.carry)} {value}, ptr %c{one.carry}")
