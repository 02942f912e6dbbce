"""Numbers below the smallest normal one, taken for zero by compiled loops.

What dies away ends among them, and a core takes ten times as long for each operation on one. XLA
does the same. What the caller's arithmetic does with them stays as it was.
"""

from dataclasses import dataclass

import llvmlite.binding as llvm


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
    """That of this machine; nothing where it is not known."""
    return ARCHITECTURES.get(llvm.get_process_triple().split("-")[0], Flushing())
