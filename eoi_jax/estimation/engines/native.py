"""The engine of CPUs: the loop compiled whole, as C would be, and lanes spread over the cores.

The step of the pass is traced for one lane (`graph.py`), sorted by what depends on what
(`loop.py`) and written for LLVM (`instructions.py`). Here it is compiled, kept, and run.
"""

import functools
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import shapes_of
from eoi_jax.compiler.runtime import RowFlags, compiled_loop, cores, numbers
from eoi_jax.estimation.engines.engine import AbstractEngine, Lanes
from eoi_jax.estimation.engines.pass_loop import Pass
from eoi_jax.estimation.kernel import Step, Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Native(AbstractEngine):
    """Lanes as vectors of a compiled loop, on all cores.

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
            compiled_loop(*pass_of(plant, lanes, lowpass, steps, store))
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
        loop, columns = pass_of(plant, lanes, lowpass, steps, store)
        code, dtype = compiled_loop(loop, columns), loop.dtype
        lane = numbers(lanes.without_emphasis(), dtype, skip=1).reshape(len(lanes), -1)
        fixed = numbers((plant, lowpass, steps.sample_period, *steps.begin), dtype)
        run = code.begin(lane.T, fixed)
        run.advance(rows_of(steps, dtype), _flags(lanes, steps, store), self.threads or cores())
        return run.result()


# -- what is compiled -------------------------------------------------------------------------


def pass_of(
    plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str
) -> tuple[Pass, int]:
    """What is traced, and the number of columns of the record; arguments as of `Native.run`.

    Raises:
        Untranslatable: inputs behind an actuator.
    """
    if plant.actuator is not None:
        raise Untranslatable("inputs behind an actuator")
    dtype = np.dtype(lanes.theta.dtype)
    columns = [np.asarray(getattr(steps, name)) for name in _step_names(_at_starts(steps))]
    shapes = shapes_of(columns, dtype, skip=1)
    if lanes.emphasis is not None:
        shapes.append(jax.ShapeDtypeStruct((), dtype))
    with_emphasis = lanes.emphasis is not None
    step = jax.tree.unflatten(_step_structure(with_emphasis, _at_starts(steps)), shapes)
    lane = shapes_of(lanes.without_emphasis(), dtype, skip=1)
    z_start = shapes_of(steps.z_start, dtype)
    filtered = shapes_of(lowpass, dtype)
    loop = Pass(shapes_of(plant, dtype), lane, filtered, step, store, dtype, z_start)
    return loop, sum(int(np.prod(column.shape[1:])) for column in columns)


def _at_starts(steps: Steps) -> bool:
    return steps.u_start is not None


@functools.cache
def _step_structure(emphasis: bool, at_starts: bool) -> Any:
    """A step whose inputs are the record's own; with those at its start if asked for."""

    def step() -> Step:
        number, flag = jnp.zeros(()), jnp.zeros((), bool)
        row = number[None]
        last, start = number if emphasis else None, row if at_starts else None
        return Step(row, None, number, row, row, row, row, flag, number, flag, start, None, last)

    return jax.tree.structure(jax.eval_shape(step))


@functools.cache
def _step_names(at_starts: bool) -> list[str]:
    """Of its parts that are taken from `Steps` as they are, in the order of the leaves."""
    structure = _step_structure(False, at_starts)
    step = jax.tree.unflatten(structure, range(structure.num_leaves))
    return [path[0].name for path, _ in jax.tree_util.tree_leaves_with_path(step)]


def rows_of(steps: Steps, dtype: Any) -> np.ndarray:
    """What is read of each step of one record, shape (S, columns)."""
    parts = [np.asarray(getattr(steps, name)) for name in _step_names(_at_starts(steps))]
    columns = [part.reshape(len(part), -1) for part in parts]
    return np.concatenate(columns, axis=1, dtype=dtype, casting="unsafe")


def _flags(lanes: Lanes, steps: Steps, store: str) -> RowFlags:
    """Where a step is more than the next one, the block of each step, the lanes' emphasis."""
    ends = np.asarray(steps.block_end)
    flags = np.asarray(steps.restart).copy()
    if store == "scores" or lanes.emphasis is not None:
        flags |= ends
    if lanes.emphasis is None:
        return RowFlags(flags)
    return RowFlags(flags, np.cumsum(ends) - ends, np.asarray(lanes.emphasis))
