"""How JAX is set up: precision, compilation cache, and the two XLA options that matter.

Importing the library changes nothing. The CLI, the benchmarks and the tests call `configure`.
"""

import mmap
import os
import warnings
from pathlib import Path

import jax
import jaxlib

from eoi_jax.checks import check, check_count

# XLA's CPU backend runs a `lax.scan` as one compiled function only below a size limit; above it,
# every step pays a few microseconds of dispatch. Raising the limit makes a pass about ten times
# faster. It is read once, when the backend starts, and cannot be set for one `jit` alone.
_WHOLE_LOOPS = "xla_cpu_small_while_loop_byte_threshold=100000000"
# XLA's newer way to compile fusions takes half as long again; what comes of it is no faster here.
_NEW_FUSIONS = "xla_cpu_use_fusion_emitters"


def configure(float64: bool = True, cache: bool = True, devices: int | None = None) -> None:
    """Set up JAX for estimation; call it before anything else uses JAX.

    Args:
        float64: switch on double precision. Second differences of a finely sampled record lose
            most of single precision's digits.
        cache: keep compiled kernels on disk between processes, in `$EOI_CACHE` or
            `~/.cache/eoi_jax`.
        devices: make this many devices of the CPU, over which `engines.Scan` spreads its lanes.

    Raises:
        ValueError: fewer devices than one, or too late to make them.

    Warns:
        RuntimeWarning: the backend runs already, so that the loop option has no effect;
            everything works, slower.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _WHOLE_LOOPS not in flags:
        if _backend_runs():
            warnings.warn(
                "JAX runs already, so whole-loop compilation cannot be switched on: passes will "
                "be several times slower. Call `eoi_jax.configure()` before using JAX.",
                RuntimeWarning,
                stacklevel=2,
            )
        else:
            options = [flags, f"--xla_backend_extra_options={_WHOLE_LOOPS}"]
            if _NEW_FUSIONS not in flags and _has_option(_NEW_FUSIONS):
                options.append(f"--{_NEW_FUSIONS}=false")
            os.environ["XLA_FLAGS"] = " ".join(options).strip()
    if devices is not None:
        devices = check_count("devices", devices)
        _make_devices(devices)
    jax.config.update("jax_enable_x64", float64)
    if cache:
        folder = os.environ.get("EOI_CACHE", str(Path.home() / ".cache" / "eoi_jax"))
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def _has_option(name: str) -> bool:
    """Whether this XLA has it: one that it does not know would end the process."""
    library = next(Path(jaxlib.__path__[0]).glob("*jax_common*"), None)
    if library is None:
        return False
    with library.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as code:
        return code.find(name.encode()) >= 0


def _make_devices(count: int) -> None:
    late = _backend_runs() and jax.device_count("cpu") != count
    check(
        not late,
        "devices",
        "must be asked for before JAX is used",
        f"{count}, after JAX made {jax.device_count('cpu') if late else 0}",
        "Call `eoi_jax.configure()` first of all.",
    )
    if not _backend_runs():
        jax.config.update("jax_num_cpu_devices", count)


def _backend_runs() -> bool:
    # No public question exists for this; without the private one, assume that it does not run.
    try:
        from jax._src.xla_bridge import backends_are_initialized
    except ImportError:
        return False
    return backends_are_initialized()
