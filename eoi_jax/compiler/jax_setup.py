"""How JAX is set up: precision, compilation cache, and the two XLA options that matter.

Importing the library changes nothing. The CLI, the benchmarks and the tests call `configure`.
"""

import gc
import os
import warnings
from pathlib import Path

import jax

from eoi_jax._checks import check, check_count
from eoi_jax.compiler.jax_private import backend_runs
from eoi_jax.compiler.programs import limit

# XLA's CPU backend runs a `lax.scan` as one compiled function only below a size limit; above it,
# every step pays a few microseconds of dispatch. Raising the limit makes a free run with
# sensitivities about ten times faster. It is read once, when the backend starts, and is no option
# of one `jit`.
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000"
# XLA's newer way to compile fusions takes half as long again; what comes of it is no faster here.
_OLD_FUSIONS = "--xla_cpu_use_fusion_emitters=false"
# A flag that XLA does not know ends the process, so each is set only for releases that were tried:
# 0.7.2, 0.8.0, 0.9.0, 0.10.2, 0.11.0, 0.11.2. The second one is gone from 0.11.1 on; from 0.12 on
# XLA compiles whole loops by itself.
_KNOWN_TO = {_WHOLE_LOOPS: ((0, 7), (0, 12)), _OLD_FUSIONS: ((0, 7), (0, 11, 1))}

_OBJECTS = 50_000  # new ones after which Python collects garbage


def configure(
    float64: bool = True,
    cache: bool = True,
    devices: int | None = None,
    programs: int | None = None,
) -> None:
    """Set up JAX for estimation; call it before anything else uses JAX.

    Python's garbage collector is made to run after 50 000 new objects, not after 700 or 2000: the
    traces of JAX are millions that stay, and to look through them takes a sixth of a discovery.

    Args:
        float64: switch on double precision. Second differences of a finely sampled record lose
            most of single precision's digits.
        cache: keep compiled kernels on disk between processes, in `$EOI_CACHE` or
            `~/.cache/eoi_jax`; not where neither can be written.
        devices: make this many devices of the CPU, over which `engines.Scan` spreads its lanes.
        programs: keep so many compiled programs in memory at most, 128 by default; the least
            recently used go first. A refinement of a new kind of plant needs some twenty, of
            2 to 5 MB each.

    Raises:
        ValueError: fewer devices or programs than one, or too late to make the devices.

    Warns:
        RuntimeWarning: the backend runs already, so that the loop option has no effect;
            everything works, slower; or compiled kernels cannot be kept.
    """
    _set_options()
    first, *later = gc.get_threshold()
    if 0 < first < _OBJECTS:  # zero: somebody has switched it off
        gc.set_threshold(_OBJECTS, *later)
    if programs is not None:
        limit(programs)
    if devices is not None:
        devices = check_count("devices", devices)
        _make_devices(devices)
    jax.config.update("jax_enable_x64", float64)
    if cache:
        jax.config.update("jax_compilation_cache_dir", _cache_folder())
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)


def _cache_folder() -> str | None:
    """Where compiled kernels are kept; None where no folder can be written."""
    variable = os.environ.get("EOI_CACHE")
    try:
        folder = Path(variable) if variable else Path.home() / ".cache" / "eoi_jax"
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(f"{folder} must not be written")
    except (OSError, RuntimeError) as error:
        warnings.warn(
            f"compiled code is not kept from run to run, which then start slower ({error}). Set "
            "EOI_CACHE to a folder of yours",
            RuntimeWarning,
            stacklevel=3,
        )
        return None
    return str(folder)


def check_process() -> None:
    """JAX must not have been used before this process was forked from another.

    Raises:
        ValueError: it was. Its threads, and ours, are gone: work would be waited for for ever.
    """
    check(
        not _FORKED_LATE,
        "process",
        "must be started anew, not forked from one that has used JAX",
        f"process {os.getpid()}, a fork of {os.getppid()}",
        "Start processes with `multiprocessing.get_context('spawn')`, or fork before anything is "
        "computed.",
    )


_FORKED_LATE: list[int] = []  # this process, if it is a fork of one in which JAX ran


def _forked() -> None:
    if backend_runs():
        _FORKED_LATE[:] = [os.getpid()]


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forked)


def _set_options() -> None:
    """The options of XLA, beside those of the caller; his own settings of them stay."""
    flags = os.environ.get("XLA_FLAGS", "")
    options = [
        option
        for option, (first, end) in _KNOWN_TO.items()
        if first <= jax.__version_info__ < end and _name(option) not in flags
    ]
    if _WHOLE_LOOPS not in options:
        return
    if backend_runs():
        warnings.warn(
            "JAX runs already, so whole-loop compilation cannot be switched on: passes will "
            "be several times slower. Call `eoi_jax.configure()` before using JAX.",
            RuntimeWarning,
            stacklevel=3,
        )
        return
    os.environ["XLA_FLAGS"] = " ".join([flags, *options]).strip()


def _name(option: str) -> str:
    """Of a flag of XLA, or of the one that it holds."""
    return option.lstrip("-").removeprefix("xla_backend_extra_options=").split("=")[0]


def _make_devices(count: int) -> None:
    late = backend_runs() and jax.device_count("cpu") != count
    check(
        not late,
        "devices",
        "must be asked for before JAX is used",
        f"{count}, after JAX made {jax.device_count('cpu') if late else 0}",
        "Call `eoi_jax.configure()` first of all.",
    )
    if not backend_runs():
        jax.config.update("jax_num_cpu_devices", count)
