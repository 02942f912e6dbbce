"""Compiled code and its memory: what every loop that LLVM compiles needs from the host."""

import ctypes
import ctypes.util
import functools
import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import llvmlite
import llvmlite.binding as llvm
import numpy as np

from eoi_jax.compiler import code_cache
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.instructions import Layout, layout, source
from eoi_jax.compiler.loop import AbstractLoop, LaneProgram, lane_program
from eoi_jax.compiler.translation import kept_translation

LINE = 64  # bytes that caches move at a time


@dataclass(frozen=True)
class Compiled:
    """A loop as code of this machine.

    Attributes:
        program: what it computes. where: its numbers lie.
        steps, lanes: the functions of `instructions.py`.
        owner: of the code's memory.
    """

    program: LaneProgram
    where: Layout
    steps: Callable
    lanes: Callable
    owner: Any


@kept_translation
def translated(what: AbstractLoop, columns: int, width: int | None = None) -> Compiled:
    """Trace, sort and compile a loop, once.

    Args:
        what: the loop.
        columns: numbers in a row of its record.
        width: lanes in one vector; what fills two registers if None.

    Raises:
        Untranslatable: what a scalar program cannot express.
    """
    program = program_of(what)
    where = layout(program, columns, what.dtype, width)
    return Compiled(program, where, *functions(source(program, where, what.dtype)))


@kept_translation
def program_of(what: AbstractLoop) -> LaneProgram:
    """Traced and sorted, once; the same for vectors of any width."""
    return lane_program(what)


def cores() -> int:
    """How many this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def functions(text: str) -> tuple[Callable, Callable, Any]:
    """The two functions of a source, and what must live as long as they do."""
    # Of lanes one by one (`compiled_runs.py`) like operations side by side become vectors.
    engine = engine_of(text, slp=True)
    pointer, number = ctypes.c_void_p, ctypes.c_int64
    steps = ctypes.CFUNCTYPE(None, *[pointer] * 4, number)
    lanes = ctypes.CFUNCTYPE(None, pointer, *[number] * 3, *[pointer] * 6, number, number)
    return (
        steps(engine.get_function_address("steps")),
        lanes(engine.get_function_address("lanes")),
        engine,
    )


@functools.lru_cache(maxsize=64)
def engine_of(text: str, slp: bool) -> Any:
    """Compiled code, from the disk if it is there, and its memory.

    Args:
        text: in LLVM's language.
        slp: whether LLVM looks for like operations side by side, to make vectors of them.

    Raises:
        Untranslatable: a function that this machine's C library does not have.
    """
    machine = _machine()
    for line in text.splitlines():
        if line.startswith("declare") and "@llvm." not in line:
            name = line.split("@")[1].split("(")[0]
            if llvm.address_of_symbol(name) is None:  # LLVM would end the process
                raise Untranslatable(f"{name}: not in this machine's C library")
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(_object_code(text, machine, slp)))
    engine.finalize_object()
    return engine


def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.util.find_library("m")
    if library:
        llvm.load_library_permanently(library)
    target = llvm.Target.from_default_triple()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=cpu, features=features, opt=3, jit=True)


def _object_code(text: str, machine: Any, slp: bool) -> bytes:
    """From the disk, or compiled and kept there."""
    cpu = (llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    key = (text, cpu, llvmlite.__version__, slp)
    name = hashlib.sha256(repr(key).encode()).hexdigest()
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    path = Path(folder) / "native" / f"{name}.o" if folder else None
    if path is None or not code_cache.usable(path.parent):
        return _translate(text, machine, slp)
    code = code_cache.read(path)
    if code is None:
        code = _translate(text, machine, slp)
        code_cache.keep(path, code)
    return code


def _translate(text: str, machine: Any, slp: bool) -> bytes:
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.slp_vectorization = slp
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)


def aligned(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Zeros that begin with a line of the cache."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + LINE, np.uint8)
    start = -raw.ctypes.data % LINE
    return raw[start : start + size].view(dtype).reshape(shape)


def copied(array: np.ndarray) -> np.ndarray:
    """A copy that begins with a line of the cache."""
    out = aligned(array.shape, array.dtype)
    out[...] = array
    return out


def numbers(tree: Any, dtype: Any, skip: int = 0) -> np.ndarray:
    """The real numbers and flags of a tree in the order in which `shapes_of` counts them."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    flat = [
        one.astype(dtype).reshape(*one.shape[:skip], -1) for one in arrays if one.dtype.kind in "fb"
    ]
    return np.concatenate(flat, axis=-1)


def spread(values: Sequence[Any], count: int, dtype: Any) -> np.ndarray:
    """One row for each value, shape (values, count): it is a number, or has one for each lane."""
    out = np.empty((len(values), count), dtype)
    for row, value in zip(out, values, strict=True):
        row[...] = value
    return out


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")


if hasattr(os, "register_at_fork"):  # threads do not come along
    os.register_at_fork(after_in_child=_pool.cache_clear)


def together(job: Callable[[], None], threads: int) -> None:
    """The same call in several threads; compiled code runs without Python's lock."""
    others = [_pool(threads - 1).submit(job) for _ in range(threads - 1)] if threads > 1 else []
    job()
    for other in others:
        other.result()
