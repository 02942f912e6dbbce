"""Functions in LLVM's language: lines, and operations of a scalar program.

Compiled loops take numbers below the smallest normal one for zero: what dies away ends among them,
and a core takes ten times as long for each operation on one. XLA does the same. What the caller's
arithmetic does with them stays as it was.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from eoi_jax.compiler.graph import Node, Untranslatable

try:
    import llvmlite.binding as _llvm
except Exception as error:  # its library may be missing, or not be one of this machine
    _llvm, _FAULT = None, f"LLVM cannot be loaded: {type(error).__name__}: {error}"
else:
    _FAULT = ""

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


def llvm() -> Any:
    """LLVM, as `llvmlite` binds it.

    Raises:
        Untranslatable: it cannot be loaded here.
    """
    if _llvm is None:
        raise Untranslatable(_FAULT)
    return _llvm


def register_bytes() -> int:
    """Size of the widest register of this machine."""
    features = llvm().get_host_cpu_features()
    return 64 if features.get("avx512f") else 32 if features.get("avx") else 16


class Text:
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


class Scope:
    """Operations on scalars (width 1) or vectors; `outside` gives what is not computed here."""

    def __init__(
        self,
        text: Text,
        width: int,
        read_outside: Callable[[Node], str | None],
        never_nan: Callable[[Node], bool],
    ):
        self._text, self._width, self._read_outside = text, width, read_outside
        self._never_nan = never_nan
        self._names: dict[Node, str] = {}
        self.real = self._kind(text.real)
        self.flag = self._kind("i1")

    def _kind(self, scalar: str) -> str:
        return scalar if self._width == 1 else f"<{self._width} x {scalar}>"

    def constant(self, value: Any) -> str:
        """A constant in every lane."""
        flag = isinstance(value, bool)
        number = str(value).lower() if flag else self._text.number(value)
        if self._width == 1:
            return number
        kind = "i1" if flag else self._text.real
        return "<" + ", ".join([f"{kind} {number}"] * self._width) + ">"

    def spread(self, number: str, kind: str) -> str:
        """A scalar in every lane."""
        if self._width == 1:
            return number
        vector = f"<{self._width} x {kind}>"
        first = self._text.let(f"insertelement {vector} poison, {kind} {number}, i64 0")
        zeros = f"<{self._width} x i32> zeroinitializer"
        return self._text.let(f"shufflevector {vector} {first}, {vector} poison, {zeros}")

    def value(self, wanted: Node) -> str:
        """The name of a node's value; computes it where that has not been done."""
        waiting = [wanted]
        while waiting:
            node = waiting[-1]
            if node not in self._names:
                name = (
                    self.constant(node.value) if node.op == "constant" else self._read_outside(node)
                )
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
        typed = ", ".join(f"{real} {arg}" for arg in args)
        return self._text.let(f"call {_FLAGS} {real} @llvm.{name}.{short}({typed})")

    def _extreme(self, node: Node, args: list[str]) -> str:
        """The larger or smaller; NaN if either is."""
        for i, j in ((0, 1), (1, 0)):
            if self._never_nan(node.args[i]):  # a comparison with NaN fails: NaN is taken
                order = "ogt" if node.op == "max" else "olt"
                flag = self._text.let(f"fcmp {order} {self.real} {args[i]}, {args[j]}")
                pair = f"{self.real} {args[i]}, {self.real} {args[j]}"
                return self._text.let(f"select {self.flag} {flag}, {pair}")
        return self._intrinsic("maximum" if node.op == "max" else "minimum", args)

    def _sign(self, x: str) -> str:
        unit = self._intrinsic("copysign", [self.constant(1.0), x])
        nonzero = self._text.let(f"fcmp one {self.real} {x}, {self.constant(0.0)}")
        # Neither above nor below: zero or NaN, which stay.
        return self._text.let(f"select {self.flag} {nonzero}, {self.real} {unit}, {self.real} {x}")

    def _library(self, op: str, args: list[str]) -> str:
        real, let = self._text.real, self._text.let
        name = LIBRARY[op] + ("f" if real == "float" else "")
        kinds = ", ".join([real] * len(args))
        self._text.declared.add(f"declare {real} @{name}({kinds}) nounwind willreturn memory(none)")
        if self._width == 1:
            return let(f"call {real} @{name}({', '.join(f'{real} {x}' for x in args)})")
        vector = "poison"
        for i in range(self._width):
            scalars = [let(f"extractelement {self.real} {x}, i64 {i}") for x in args]
            value = let(f"call {real} @{name}({', '.join(f'{real} {x}' for x in scalars)})")
            vector = let(f"insertelement {self.real} {vector}, {real} {value}, i64 {i}")
        return vector


# -- functions ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Flushing:
    """In LLVM's language: at the beginning and the end of a function, and what they call."""

    begin: str = ""
    end: str = ""
    declarations: tuple[str, ...] = ()


# Bits of the control register: results (15) and operands (6).
_X86 = Flushing(
    """\
  %mode = alloca i32
  %flushing = alloca i32
  call void @llvm.x86.sse.stmxcsr(ptr %mode)
  %mode.was = load i32, ptr %mode
  %mode.new = or i32 %mode.was, 32832
  store i32 %mode.new, ptr %flushing
  call void @llvm.x86.sse.ldmxcsr(ptr %flushing)""",
    "  call void @llvm.x86.sse.ldmxcsr(ptr %mode)",
    ("declare void @llvm.x86.sse.stmxcsr(ptr)", "declare void @llvm.x86.sse.ldmxcsr(ptr)"),
)
# Bit 24, both.
_ARM = Flushing(
    """\
  %mode = call i64 @llvm.aarch64.get.fpcr()
  %mode.new = or i64 %mode, 16777216
  call void @llvm.aarch64.set.fpcr(i64 %mode.new)""",
    "  call void @llvm.aarch64.set.fpcr(i64 %mode)",
    ("declare i64 @llvm.aarch64.get.fpcr()", "declare void @llvm.aarch64.set.fpcr(i64)"),
)
ARCHITECTURES = {"x86_64": _X86, "aarch64": _ARM, "arm64": _ARM}


def flushing() -> Flushing:
    """That of this machine; nothing where it is none of these."""
    return ARCHITECTURES.get(llvm().get_process_triple().split("-")[0], Flushing())


def begin(text: Text, definition: str) -> None:
    """The head of a function."""
    text.add(definition, "entry:", flushing().begin)


def end(text: Text) -> None:
    """Its last lines."""
    text.add(flushing().end, "  ret void", "}")


def as_flag(scope: Scope, text: Text, node: Node, number: str) -> str:
    """Flags lie in memory as numbers."""
    if not node.is_bool:
        return number
    return text.let(f"fcmp une {scope.real} {number}, {scope.constant(0.0)}")


def as_number(scope: Scope, text: Text, node: Node, value: str) -> str:
    """And in registers as flags."""
    if not node.is_bool:
        return value
    pair = f"{scope.real} {scope.constant(1.0)}, {scope.real} {scope.constant(0.0)}"
    return text.let(f"select {scope.flag} {value}, {pair}")


def module(text: Text) -> str:
    """All functions of a text, with what they call."""
    declared = sorted(text.declared | set(flushing().declarations))
    bits = 8 * register_bytes()
    # The stack aligned to whole registers: what spills to it is read often.
    attributes = (
        f'nounwind alignstack={register_bytes()} "prefer-vector-width"="{bits}" '
        f'"min-legal-vector-width"="{bits}"'
    )
    return "\n".join([*text.lines, *declared, f"attributes #0 = {{ {attributes} }}", ""])
