"""Machine code of loops: compiled by LLVM once, kept, and never a reason for an error.

JAX runs every loop. So whatever goes wrong on the way to machine code, an operation that is no
arithmetic, a part of JAX that has another name in this version, LLVM that fails or is missing, is
the reason why JAX runs it; it is never an error of the caller's.
"""

import ctypes.util
import functools
import hashlib
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax

from eoi_jax.compiler import code_cache
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.llvm import llvm


def cached_translation(function: Callable, maxsize: int = 64) -> Callable:
    """A translation that is done once for the same arguments; so is one that fails.

    Args:
        function: of hashable arguments.
        maxsize: translations that are kept; the least recently used go first.

    Returns:
        The same function; it raises `Untranslatable`, whatever the failure was.
    """

    @functools.lru_cache(maxsize=maxsize)
    def attempt(*arguments: Hashable) -> Any:
        try:
            return function(*arguments)
        except Untranslatable as reason:
            return _Failure(str(reason))
        except Warning:  # of a caller whose warnings are errors
            raise
        except Exception as error:
            text = str(error).strip().split("\n")[0]
            return _Failure(f"translation failed, {type(error).__name__}: {text}")

    @functools.wraps(function)
    def translate(*arguments: Hashable) -> Any:
        result = attempt(*arguments)
        if isinstance(result, _Failure):
            raise Untranslatable(result.reason)
        return result

    translate.__dict__["cache_clear"] = attempt.cache_clear
    return translate


class _Failure:
    """Why a translation failed."""

    def __init__(self, reason: str):
        self.reason = reason


@functools.lru_cache(maxsize=64)
def machine_code(text: str, slp: bool) -> Any:
    """Compiled code, from the disk if it is there, and its memory.

    Args:
        text: in LLVM's language.
        slp: whether LLVM looks for like operations side by side, to make vectors of them.

    Returns:
        Its owner: `get_function_address` says where a function is, as long as the owner lives.

    Raises:
        Untranslatable: a function that this machine's C library does not have; no LLVM.
    """
    machine, binding = _machine(), llvm()
    for line in text.splitlines():
        if line.startswith("declare") and "@llvm." not in line:
            name = line.split("@")[1].split("(")[0]
            if binding.address_of_symbol(name) is None:  # LLVM would end the process
                raise Untranslatable(f"{name}: not in this machine's C library")
    engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
    engine.add_object_file(binding.ObjectFileRef.from_data(_object_code(text, machine, slp)))
    engine.finalize_object()
    return engine


def _machine() -> Any:
    binding = llvm()
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    library = ctypes.util.find_library("m")
    if library:
        binding.load_library_permanently(library)
    target = binding.Target.from_default_triple()
    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=cpu, features=features, opt=3, jit=True)


def _object_code(text: str, machine: Any, slp: bool) -> bytes:
    """From the disk, or compiled and kept there."""
    cpu = (llvm().get_host_cpu_name(), llvm().get_host_cpu_features().flatten())
    key = (text, cpu, version("llvmlite"), slp)
    name = hashlib.sha256(repr(key).encode()).hexdigest()
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    path = Path(folder) / "native" / f"{name}.o" if folder else None
    if path is None or not code_cache.usable(path.parent):
        return _compile(text, machine, slp)
    code = code_cache.read(path)
    if code is None:
        code = _compile(text, machine, slp)
        code_cache.keep(path, code)
    return code


def _compile(text: str, machine: Any, slp: bool) -> bytes:
    module = llvm().parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm().create_pipeline_tuning_options(speed_level=3)
    options.slp_vectorization = slp
    builder = llvm().create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)
