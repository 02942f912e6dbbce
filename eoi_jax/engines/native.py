"""The engine of CPUs: the loop compiled whole, as C would be, and lanes spread over the cores.

The step of the pass is traced for one lane (`scalars.py`), sorted by what depends on what
(`lane_program.py`) and written for LLVM (`machine_code.py`). Here it is compiled, kept, and run.
"""

import ctypes
import ctypes.util
import functools
import hashlib
import os
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import llvmlite
import llvmlite.binding as llvm
import numpy as np

from eoi_jax.engines.engine import AbstractEngine, Lanes
from eoi_jax.engines.lane_program import LaneProgram, Pass, lane_program, shapes_of
from eoi_jax.engines.machine_code import Layout, layout, source
from eoi_jax.engines.scalars import Untranslatable, evaluated
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.passes import Step, Steps, Sums
from eoi_jax.plants.plant import Plant

_TILE_BYTES = 24_000  # of lanes that step together: half of a first-level cache
_CHUNK_BYTES = 16_000_000  # of what the lanes share of the record, at a time
_LINE = 64  # bytes that caches move at a time
# Between tiles: what a core fetches ahead of its own it would take from the core that writes there.
# At 0, 1, 4 and 8 kB two cores are 1.4, 1.3, 1.6 and 1.9 times as fast as one.
_APART = 8192 + _LINE


@dataclass(frozen=True)
class Native(AbstractEngine):
    """Lanes as vectors of a compiled loop, in tiles on all cores.

    About ten times as fast as the scan, and compiled in half a second. Code is kept for the life
    of the process, and on disk where JAX keeps its own (`eoi_jax.configure(cache=True)`).

    Attributes:
        threads: how many cores to use; all that this process may use if None.
    """

    threads: int | None = None

    def supports(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> str | None:
        """Why a pass cannot be run here (`Scan` runs any); None if it can.

        Args:
            plant: as in `run`, like all others.
            lanes: one is enough.
            lowpass: F.
            steps: of one record.
            store: what is added up.

        Returns:
            What is not supported, by its name in JAX.
        """
        try:
            _compiled(*_pass(plant, lanes, lowpass, steps, store))
        except Untranslatable as reason:
            return str(reason)
        return None

    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane; compiled once for all numbers of lanes and steps.

        A lane with a NaN among its gains or parameters has NaN in all its sums.

        Raises:
            Untranslatable: what `supports` says.
        """
        what, columns = _pass(plant, lanes, lowpass, steps, store)
        run = _Run(_compiled(what, columns), what, lanes, self.threads or _cores())
        run.go(plant, lowpass, steps)
        return run.sums()


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


# -- what is compiled -------------------------------------------------------------------------


@dataclass(frozen=True)
class _Compiled:
    program: LaneProgram
    where: Layout
    steps: Callable
    lanes: Callable
    owner: Any  # of the code's memory


def _pass(
    plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str
) -> tuple[Pass, int]:
    """What is traced, and the number of columns of the record."""
    if plant.actuator is not None:
        raise Untranslatable("inputs behind an actuator")
    dtype = np.dtype(lanes.theta.dtype)
    columns = [np.asarray(getattr(steps, name)) for name in _step_names()]
    shapes = shapes_of(columns, dtype, skip=1)
    if lanes.emphasis is not None:
        shapes.append(jax.ShapeDtypeStruct((), dtype))
    step = jax.tree.unflatten(_step_structure(lanes.emphasis is not None), shapes)
    lane = shapes_of(lanes.without_emphasis(), dtype, skip=1)
    what = Pass(shapes_of(plant, dtype), lane, shapes_of(lowpass, dtype), step, store, dtype)
    return what, sum(int(np.prod(column.shape[1:])) for column in columns)


@functools.cache
def _step_structure(emphasis: bool) -> Any:
    """A step whose inputs are the record's own."""

    def step() -> Step:
        one, flag = jnp.zeros(()), jnp.zeros((), bool)
        some = one[None]
        last = one if emphasis else None
        return Step(some, None, one, some, some, some, some, flag, one, flag, last)

    return jax.tree.structure(jax.eval_shape(step))


@functools.cache
def _step_names() -> list[str]:
    """Of its parts that are taken from `Steps` as they are, in the order of the leaves."""
    structure = _step_structure(False)
    step = jax.tree.unflatten(structure, range(structure.num_leaves))
    return [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(step)]


@functools.lru_cache(maxsize=256)
def _compiled(what: Pass, columns: int) -> _Compiled:
    program = lane_program(what)
    where = layout(program, columns, what.dtype)
    return _Compiled(program, where, *_functions(source(program, where, what.dtype)))


@functools.lru_cache(maxsize=256)
def _functions(text: str) -> tuple[Callable, Callable, Any]:
    """The two functions of a source, and what must live as long as they do."""
    machine = _machine()
    for line in text.splitlines():
        if line.startswith("declare") and "@llvm." not in line:
            name = line.split("@")[1].split("(")[0]
            if llvm.address_of_symbol(name) is None:  # LLVM would end the process
                raise Untranslatable(f"{name}: not in this machine's C library")
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
    engine.add_object_file(llvm.ObjectFileRef.from_data(_object_code(text, machine)))
    engine.finalize_object()
    pointer, number = ctypes.c_void_p, ctypes.c_int64
    steps = ctypes.CFUNCTYPE(None, *[pointer] * 4, number)
    lanes = ctypes.CFUNCTYPE(None, pointer, *[number] * 3, *[pointer] * 6, number, number)
    return (
        steps(engine.get_function_address("steps")),
        lanes(engine.get_function_address("lanes")),
        engine,
    )


def _machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.util.find_library("m")
    if library:
        llvm.load_library_permanently(library)
    target = llvm.Target.from_default_triple()
    cpu, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=cpu, features=features, opt=3, jit=True)


def _object_code(text: str, machine: Any) -> bytes:
    """From the disk, or compiled and kept there."""
    cpu = (llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten())
    name = hashlib.sha256(repr((text, cpu, llvmlite.__version__)).encode()).hexdigest()
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    path = Path(folder) / "native" / f"{name}.o" if folder else None
    try:
        if path is not None and path.is_file():
            return path.read_bytes()
    except OSError:
        pass
    code = _translate(text, machine)
    if path is not None:
        _keep(path, code)
    return code


def _translate(text: str, machine: Any) -> bytes:
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)


def _keep(path: Path, code: bytes) -> None:
    """Write at once or not at all; a folder that cannot be written is no error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(code)
        os.replace(file.name, path)
    except OSError:
        pass


# -- one run ----------------------------------------------------------------------------------


def _aligned(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Zeros that begin with a line of the cache."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + _LINE, np.uint8)
    start = -raw.ctypes.data % _LINE
    return raw[start : start + size].view(dtype).reshape(shape)


class _Run:
    """Memory of one run of a compiled pass."""

    def __init__(self, compiled: _Compiled, what: Pass, lanes: Lanes, threads: int):
        self._code, self._what, self._lanes, self._threads = compiled, what, lanes, threads
        width = compiled.where.width
        self._vectors = -(-len(lanes) // width)
        self._memory = self._tiles()
        # Beyond the last lane it is repeated: any numbers do, but these cost no slow path.
        room = self._memory.shape[0] * self._memory.shape[1] * width
        self._padding = np.minimum(np.arange(room), len(lanes) - 1)
        self._carries = np.zeros(0)
        self._spoilt = np.zeros(len(lanes), bool)

    def _tiles(self) -> np.ndarray:
        """Zeros, (tiles, vectors, rows, width): tiles that fit the cache, some for every thread."""
        where, dtype = self._code.where, self._what.dtype
        block = where.rows * where.width
        tiles = -(-self._vectors // max(1, _TILE_BYTES // (block * dtype.itemsize)))
        size = -(-self._vectors // (self._threads * -(-tiles // self._threads)))
        tiles = -(-self._vectors // size)
        whole = _aligned((tiles, size * block + _APART // dtype.itemsize), dtype)
        return whole[:, : size * block].reshape(tiles, size, where.rows, where.width)

    def go(self, plant: Plant, lowpass: DiscreteFilter, steps: Steps) -> None:
        """Fill the memory, and go through the record."""
        where, dtype = self._code.where, self._what.dtype
        fixed = self._start(plant, lowpass, steps)
        record = self._record(steps)
        rare, block, emphasis = self._events(steps)
        tiles, size = self._memory.shape[:2]
        count = max(1, _CHUNK_BYTES // (max(len(where.shared), 1) * dtype.itemsize))
        shared = _aligned((min(count, len(record)), max(len(where.shared), 1)), dtype)
        for first in range(0, len(record), count):
            last = min(first + count, len(record))
            self._code.steps(
                record[first:].ctypes.data,
                fixed.ctypes.data,
                self._carries.ctypes.data,
                shared.ctypes.data,
                last - first,
            )
            now = rare[first:last].copy()
            now[max(0, len(now) - where.together + 1) :] = 1  # no pair reaches into the next chunk
            taken = np.zeros(1, np.int64)
            _together(
                functools.partial(
                    self._code.lanes,
                    self._memory.ctypes.data,
                    self._vectors,
                    size,
                    self._memory.strides[0] // dtype.itemsize,
                    taken.ctypes.data,
                    shared.ctypes.data,
                    now.ctypes.data,
                    fixed.ctypes.data,
                    emphasis.ctypes.data,
                    block[first:].ctypes.data,
                    emphasis.shape[1],
                    last - first,
                ),
                min(self._threads, tiles),
            )

    def sums(self) -> Sums:
        """What has been added up."""
        return jax.tree.map(self._gathered, self._code.program.sums)

    def _gathered(self, places: np.ndarray) -> np.ndarray:
        program, where, count = self._code.program, self._code.where, len(self._lanes)
        out = np.empty((count, *places.shape), self._what.dtype)
        for at in np.ndindex(places.shape):
            i = program.same[places[at]]
            if i in where.carries:
                value = self._memory[:, :, where.carries[i]].reshape(-1)[:count]
            elif i in where.steps:
                value = self._carries[where.steps[i]]
            else:
                value = program.initial[i].value
            out[(slice(None), *at)] = value
        out[self._spoilt] = np.nan
        return out

    def _start(self, plant: Plant, lowpass: DiscreteFilter, steps: Steps) -> np.ndarray:
        """Write carries and constants of the lanes; returns what all lanes share."""
        program, dtype = self._code.program, self._what.dtype
        lane = _numbers(self._lanes.without_emphasis(), dtype, skip=1).reshape(len(self._lanes), -1)
        ends = np.asarray(steps.y)[0], np.asarray(steps.y_next)[0]
        all_lanes = _numbers((plant, lowpass, steps.sample_period, *ends), dtype)
        groups = {"lane": lane.T, "fixed": all_lanes}
        wanted = [*(program.initial[i] for i in program.lane_carries), *program.own]
        values = evaluated(wanted, lambda at: groups[at[0]][at[1]], dtype)
        for row, value in enumerate(values):
            whole = np.broadcast_to(value, len(self._lanes))
            if row >= len(program.lane_carries):
                self._spoilt |= np.isnan(whole)
            target = self._memory[:, :, row]
            target[...] = whole[self._padding].reshape(target.shape)
        carries = [program.initial[i] for i in program.step_carries]
        fixed, self._carries = (
            np.array([*evaluated(nodes, lambda at: all_lanes[at[1]], dtype), 0.0], dtype)
            for nodes in (program.fixed, carries)
        )
        return fixed

    def _record(self, steps: Steps) -> np.ndarray:
        parts = [np.asarray(getattr(steps, name)) for name in _step_names()]
        columns = [part.reshape(len(part), -1) for part in parts]
        return np.concatenate(columns, axis=1, dtype=self._what.dtype, casting="unsafe")

    def _events(self, steps: Steps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the next few steps hold a flag, the block of each step, the lanes' emphasis."""
        ends = np.asarray(steps.block_end)
        flags = np.asarray(steps.restart).copy()
        if self._what.store != "nothing" or self._lanes.emphasis is not None:
            flags |= ends
        rare = flags.copy()
        for ahead in range(1, self._code.where.together):
            rare[:-ahead] |= flags[ahead:]
        if self._lanes.emphasis is None:
            return rare.astype(np.uint8), np.zeros(len(ends), np.int64), np.zeros((1, 1))
        emphasis = np.asarray(self._lanes.emphasis, self._what.dtype)
        block = np.minimum(np.cumsum(ends) - ends, emphasis.shape[1] - 1)
        lines = emphasis[self._padding].reshape(-1, self._code.where.width, emphasis.shape[1])
        return rare.astype(np.uint8), block.astype(np.int64), _copied(lines.transpose(0, 2, 1))


def _copied(array: np.ndarray) -> np.ndarray:
    out = _aligned(array.shape, array.dtype)
    out[...] = array
    return out


def _numbers(tree: Any, dtype: Any, skip: int = 0) -> np.ndarray:
    """The real numbers and flags of a tree in the order in which `shapes_of` counts them."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    flat = [
        one.astype(dtype).reshape(*one.shape[:skip], -1) for one in arrays if one.dtype.kind in "fb"
    ]
    return np.concatenate(flat, axis=-1)


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")


def _together(job: Callable[[], None], threads: int) -> None:
    """The same call in several threads; compiled code runs without Python's lock."""
    others = [_pool(threads - 1).submit(job) for _ in range(threads - 1)] if threads > 1 else []
    job()
    for other in others:
        other.result()
