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

import llvmlite.binding as llvm
import numpy as np

from eoi_jax.engines.lane_program import BLOCK, BOTH, CARRY, LANE, ONCE, STEP, LaneProgram, Update
from eoi_jax.engines.scalars import Node, Untranslatable, ordered
from eoi_jax.engines.subnormals import flushing

# Contraction (a b + c rounded once) is what makes C fast too. Nothing here assumes finite numbers.
_FLAGS = "contract nsz"
_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_COMPARISONS = {"lt": "olt", "le": "ole", "eq": "oeq", "ne": "une"}
_LOGIC = {"and": "and", "or": "or", "xor": "xor"}
_INTRINSICS = {
    "abs": "fabs",
    "sqrt": "sqrt",
    "floor": "floor",
    "ceil": "ceil",
    "trunc": "trunc",
    "round_even": "rint",
}
# Functions of the C library, by its names in double precision; a further f for single.
LIBRARY = {
    **{name: name for name in ("sin", "cos", "tan", "asin", "acos", "atan", "atan2")},
    **{name: name for name in ("sinh", "cosh", "tanh", "asinh", "acosh", "atanh")},
    **{name: name for name in ("exp", "exp2", "expm1", "log", "log1p", "cbrt", "pow")},
    "rem": "fmod",
}

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
    # What happens, and what is shown, is known after each step; and an odd last step is left to
    # the way of rare events, which a program without flags does not have.
    single = program.events or program.shown[0] or not program.flagged
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


def register_bytes() -> int:
    """Size of the widest register of this machine."""
    features = llvm.get_host_cpu_features()
    return 64 if features.get("avx512f") else 32 if features.get("avx") else 16


# -- text -------------------------------------------------------------------------------------


class _Text:
    """Lines of a function, with fresh names."""

    def __init__(self, real: str):
        self.lines: list[str] = []
        self.real = real
        self.declared: set[str] = set()
        self._count = 0

    def let(self, right: str) -> str:
        """A line that defines a name."""
        self._count += 1
        self.lines.append(f"  %t{self._count} = {right}")
        return f"%t{self._count}"

    def add(self, *lines: str) -> None:
        """Lines as they are."""
        self.lines.extend(lines)

    def number(self, value: float) -> str:
        """A constant as LLVM reads it: the bits of a double, exact in single precision too."""
        rounded = np.float64(np.float32(value)) if self.real == "float" else np.float64(value)
        return f"0x{rounded.view(np.uint64):016X}"

    def load(self, pointer: str, index: str | int, kind: str = "") -> str:
        """The number, or whole vector, at a place."""
        place = self.place(pointer, index)
        align = 4 if self.real == "float" else 8
        return self.let(f"load {kind or self.real}, ptr {place}, align {align}")

    def store(self, value: str, pointer: str, index: str | int, kind: str = "") -> None:
        """Write a number or vector at a place."""
        place = self.place(pointer, index)
        align = 4 if self.real == "float" else 8
        self.add(f"  store {kind or self.real} {value}, ptr {place}, align {align}")

    def place(self, pointer: str, index: str | int) -> str:
        """A place, counted in numbers."""
        return self.let(f"getelementptr {self.real}, ptr {pointer}, i64 {index}")


class _Scope:
    """Operations on scalars (width 1) or vectors; `outside` gives what is not computed here."""

    def __init__(
        self,
        text: _Text,
        width: int,
        outside: Callable[[Node], str | None],
        never_nan: Callable[[Node], bool],
    ):
        self._text, self._width, self._outside = text, width, outside
        self._never_nan = never_nan
        self._names: dict[Node, str] = {}
        self.real = self._kind(text.real)
        self.flag = self._kind("i1")

    def _kind(self, one: str) -> str:
        return one if self._width == 1 else f"<{self._width} x {one}>"

    def constant(self, value: Any) -> str:
        """A constant in every lane."""
        flag = isinstance(value, bool)
        one = str(value).lower() if flag else self._text.number(value)
        if self._width == 1:
            return one
        kind = "i1" if flag else self._text.real
        return "<" + ", ".join([f"{kind} {one}"] * self._width) + ">"

    def spread(self, one: str, kind: str) -> str:
        """A scalar in every lane."""
        if self._width == 1:
            return one
        vector = f"<{self._width} x {kind}>"
        first = self._text.let(f"insertelement {vector} poison, {kind} {one}, i64 0")
        zeros = f"<{self._width} x i32> zeroinitializer"
        return self._text.let(f"shufflevector {vector} {first}, {vector} poison, {zeros}")

    def value(self, wanted: Node) -> str:
        """The name of a node's value; computes it where that has not been done."""
        waiting = [wanted]
        while waiting:
            node = waiting[-1]
            if node not in self._names:
                name = self.constant(node.value) if node.op == "constant" else self._outside(node)
                if name is None:
                    missing = [arg for arg in node.args if arg not in self._names]
                    if missing:
                        waiting.extend(reversed(missing))
                        continue
                    name = self._operation(node)
                self._names[node] = name
            waiting.pop()
        return self._names[wanted]

    def _operation(self, node: Node) -> str:
        let, op, real = self._text.let, node.op, self.real
        args = [self._names[arg] for arg in node.args]
        if op in _ARITHMETIC:
            return let(f"{_ARITHMETIC[op]} {_FLAGS} {real} {args[0]}, {args[1]}")
        if op in _COMPARISONS:
            return let(f"fcmp {_COMPARISONS[op]} {real} {args[0]}, {args[1]}")
        if op in _LOGIC:
            return let(f"{_LOGIC[op]} {self.flag} {args[0]}, {args[1]}")
        if op == "not":
            return let(f"xor {self.flag} {args[0]}, {self.constant(True)}")
        if op == "neg":
            return let(f"fneg {_FLAGS} {real} {args[0]}")
        if op == "select":
            kind = self.flag if node.is_bool else real
            return let(f"select {self.flag} {args[0]}, {kind} {args[1]}, {kind} {args[2]}")
        if op in _INTRINSICS:
            return self._intrinsic(_INTRINSICS[op], args)
        if op in ("max", "min"):
            return self._extreme(node, args)
        if op == "sign":
            return self._sign(args[0])
        if op in LIBRARY:
            return self._library(op, args)
        raise Untranslatable(op)

    def _intrinsic(self, name: str, args: list[str]) -> str:
        real = self.real
        short = "f32" if self._text.real == "float" else "f64"
        short = short if self._width == 1 else f"v{self._width}{short}"
        kinds = ", ".join([real] * len(args))
        self._text.declared.add(f"declare {real} @llvm.{name}.{short}({kinds})")
        given = ", ".join(f"{real} {arg}" for arg in args)
        return self._text.let(f"call {_FLAGS} {real} @llvm.{name}.{short}({given})")

    def _extreme(self, node: Node, args: list[str]) -> str:
        """The larger or smaller; NaN if either is."""
        for one, other in ((0, 1), (1, 0)):
            if self._never_nan(node.args[one]):  # a comparison with NaN fails: NaN is taken
                order = "ogt" if node.op == "max" else "olt"
                which = self._text.let(f"fcmp {order} {self.real} {args[one]}, {args[other]}")
                pair = f"{self.real} {args[one]}, {self.real} {args[other]}"
                return self._text.let(f"select {self.flag} {which}, {pair}")
        return self._intrinsic("maximum" if node.op == "max" else "minimum", args)

    def _sign(self, x: str) -> str:
        one = self._intrinsic("copysign", [self.constant(1.0), x])
        away = self._text.let(f"fcmp one {self.real} {x}, {self.constant(0.0)}")
        # Neither above nor below: zero or NaN, which stay.
        return self._text.let(f"select {self.flag} {away}, {self.real} {one}, {self.real} {x}")

    def _library(self, op: str, args: list[str]) -> str:
        one = self._text.real
        name = LIBRARY[op] + ("f" if one == "float" else "")
        kinds = ", ".join([one] * len(args))
        self._text.declared.add(f"declare {one} @{name}({kinds}) nounwind willreturn memory(none)")
        if self._width == 1:
            return self._text.let(f"call {one} @{name}({', '.join(f'{one} {x}' for x in args)})")
        out = "poison"
        for i in range(self._width):
            each = [self._text.let(f"extractelement {self.real} {x}, i64 {i}") for x in args]
            done = self._text.let(f"call {one} @{name}({', '.join(f'{one} {x}' for x in each)})")
            out = self._text.let(f"insertelement {self.real} {out}, {one} {done}, i64 {i}")
        return out


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
    "ptr noalias %shown, i64 %count) #0 {"
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


def _begin(text: _Text, definition: str) -> None:
    text.add(definition, "entry:", flushing().begin)


def _end(text: _Text) -> None:
    text.add(flushing().end, "  ret void", "}")


def _loop(text: _Text, name: str, before: str, count: str) -> None:
    text.add(
        f"{name}:",
        f"  %{name}.k = phi i64 [ 0, %{before} ], [ %{name}.next, %{name}.end ]",
        f"  %{name}.more = icmp slt i64 %{name}.k, {count}",
        f"  br i1 %{name}.more, label %{name}.body, label %{name}.out",
        f"{name}.body:",
    )


def _loop_end(text: _Text, name: str) -> None:
    text.add(
        f"  br label %{name}.end",
        f"{name}.end:",
        f"  %{name}.next = add i64 %{name}.k, 1",
        f"  br label %{name}",
        f"{name}.out:",
    )


def _as_flag(scope: _Scope, text: _Text, node: Node, number: str) -> str:
    """Flags lie in memory as numbers."""
    if not node.is_bool:
        return number
    return text.let(f"fcmp une {scope.real} {number}, {scope.constant(0.0)}")


def _as_number(scope: _Scope, text: _Text, node: Node, value: str) -> str:
    if not node.is_bool:
        return value
    pair = f"{scope.real} {scope.constant(1.0)}, {scope.real} {scope.constant(0.0)}"
    return text.let(f"select {scope.flag} {value}, {pair}")


def _write_steps(text: _Text, program: LaneProgram, where: Layout) -> None:
    _begin(text, _STEPS)
    text.add("  br label %step")
    _loop(text, "step", "entry", "%count")
    row = text.let(f"mul i64 %step.k, {where.columns}")
    row = text.place("%record", row)

    def outside(node: Node) -> str | None:
        if node in where.fixed:
            return _as_flag(scope, text, node, text.load("%fixed", where.fixed[node]))
        if node.op == "input":
            group, i = node.value
            return text.load(row, i) if group == "step" else text.load("%carries", where.steps[i])
        return None

    scope = _Scope(text, 1, outside, lambda node: node.op == "constant")
    target = text.let(f"mul i64 %step.k, {len(where.shared)}")
    target = text.place("%shared", target)
    for node, column in where.shared.items():
        text.store(_as_number(scope, text, node, scope.value(node)), target, column)
    new = [(update, scope.value(update.node)) for update in program.step_updates]
    for update, value in new:
        text.store(value, "%carries", where.steps[update.carry])
    _loop_end(text, "step")
    _end(text)


def _write_lanes(text: _Text, program: LaneProgram, where: Layout) -> None:
    ways = (
        [("plain", where.together), ("rare", 1)] if program.flagged else [("plain", where.together)]
    )
    ends = ", ".join(f"[ %{name}.after, %{name}.out ]" for name, _ in ways)
    _begin(text, _LANES)
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
        _loop(text, name, f"{name}.head", "%own")
        _VectorSteps(text, program, where, name, rows).write()
        _loop_end(text, name)
        text.add(f"  %{name}.after = add i64 %step.k, {steps}", "  br label %step")
    text.add("step.out:", "  br label %tile", "tile.out:")
    _end(text)


class _VectorSteps:
    """Some steps of one vector of lanes: one scope for each step, one for what they share."""

    def __init__(
        self, text: _Text, program: LaneProgram, where: Layout, name: str, rows: Sequence[str]
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
            self._stored(rare if way else usual, self._program.shown[way])
            return
        # The usual way is computed before the branch: the other one uses much of it.
        for node in (*(one.node for one in usual), *self._program.shown[0]):
            self._each[0].value(node)
        self._text.add(f"  br i1 {self._any_event()}, label %event, label %usual", "usual:")
        self._stored(usual, self._program.shown[0])
        self._text.add(f"  br label %{self._name}.end", "event:")
        self._stored(rare, self._program.shown[1])

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

    def _stored(self, updates: Sequence[Update], shown: Sequence[Node]) -> None:
        scope, width = self._each[-1], self._where.width
        # What is stored as it was read needs no line.
        changed = [one for one in updates if one.node.value != (CARRY, one.carry)]
        nodes = ordered([*(one.node for one in changed), *shown])
        old = {node.value[1] for node in nodes if node.op == "input" and node.value[0] == CARRY}
        out = [_as_number(scope, self._text, node, scope.value(node)) for node in shown]
        for update in changed:
            value = scope.value(update.node)
            if update.carry in old:  # others may still want what is about to be overwritten
                self._carry(0, update.carry)
            place = self._where.carries[update.carry] * width
            self._text.store(value, self._base, place, self._always.real)
        if out:
            self._show(out)

    def _show(self, out: Sequence[str]) -> None:
        """One line of vectors for each step and vector of lanes."""
        let, width = self._text.let, self._where.width
        line = let("mul i64 %step.k, %vectors")
        vector = let(f"add i64 %first, {self._vector}")
        line = let(f"add i64 {line}, {vector}")
        start = self._text.place("%shown", let(f"mul i64 {line}, {len(out) * width}"))
        for i, value in enumerate(out):
            self._text.store(value, start, i * width, self._always.real)

    def _scope(self, outside: Callable[[Node], str | None]) -> _Scope:
        def never_nan(node: Node) -> bool:
            # The host answers for lanes with a NaN of their own.
            return self._program.level(node) in (ONCE, LANE)

        return _Scope(self._text, self._where.width, outside, never_nan)

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
            return _as_flag(self._always, self._text, node, number)
        return self._spread(node, self._text.load("%fixed", self._where.fixed[node]))

    def _spread(self, node: Node, number: str) -> str:
        number = self._always.spread(number, self._text.real)
        return _as_flag(self._always, self._text, node, number)

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
    text = _Text("float" if np.dtype(dtype) == np.float32 else "double")
    _write_steps(text, program, where)
    _write_lanes(text, program, where)
    text.declared.update(flushing().declarations)
    bits = 8 * register_bytes()
    # The stack aligned to whole registers: what spills to it is read often.
    attributes = (
        f'nounwind alignstack={register_bytes()} "prefer-vector-width"="{bits}" '
        f'"min-legal-vector-width"="{bits}"'
    )
    return "\n".join(
        [*text.lines, *sorted(text.declared), f"attributes #0 = {{ {attributes} }}", ""]
    )
