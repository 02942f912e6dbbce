"""Free runs of one plant, one after the other in one compiled loop.

A row of the loop is a step; where a run begins its row holds the start. So the whole record, its
windows and the many short runs that initial states are fitted by share one program, whatever their
number and length. What cannot be compiled is scanned (`integrator.chained`).
"""

import functools
from dataclasses import dataclass
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.loop import AbstractLoop, shapes_of
from eoi_jax.compiler.runtime import CompiledLoop, Run, compiled_loop, numbers
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.integrator import (
    Drive,
    advanced,
    chained,
    first_outputs,
    free_run,
    output_of,
)


class _Row(eqx.Module):
    """One step.

    Attributes:
        time: of its start [s].
        inputs: at its start, middle and end, shape (3, nu).
        begins: 1 where a run begins.
        start: the state there; anything finite elsewhere.
        following: inputs from the end of the step on, (nu,); None if no output depends on them.
    """

    time: Any
    inputs: Any
    begins: Any
    start: State
    following: Any = None


class _Model(eqx.Module):
    """The equations, and which outputs stick."""

    plant: Plant
    friction: tuple[int, ...] = eqx.field(static=True)


@dataclass(frozen=True, eq=False)
class _Chain(AbstractLoop):
    """What is traced. There is one lane, and nothing of it is a lane's own.

    Attributes:
        shows: ``"outputs"`` after each step, or the whole state, ``"states"``.
    """

    model: _Model
    lane: Any
    step: _Row
    dtype: np.dtype
    shows: str
    branches: ClassVar[bool] = True  # a stop of dry friction is rare, and costs two steps

    @property
    def fixed(self) -> tuple:
        """The plant and the length of a step."""
        return self.model, jax.ShapeDtypeStruct((), self.dtype)

    def begin(self, lane: Any, fixed: tuple) -> State:
        """Before the first row, in which the first run begins."""
        del lane, fixed
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, self.dtype), self.step.start)

    def advance(self, lane: Any, fixed: tuple, carry: State, row: _Row) -> tuple[State, Any]:
        """One step, and what is shown after it."""
        del lane
        (model, h), first = fixed, row.begins > 0
        x = jax.tree.map(lambda old, new: jnp.where(first, new, old), carry, row.start)
        plant = model.plant
        x = advanced(plant, jnp.asarray(plant.theta), row.time, h, row.inputs, x, model.friction)
        if self.shows == "states":
            return x, jnp.concatenate([x.y.ravel(), x.z])
        theta, end = jnp.asarray(plant.theta), row.time + h
        return x, output_of(plant, theta, end, x, row.following, model.friction)

    def result(self, carry: State) -> Any:
        """Nothing: all of it is shown."""
        del carry
        return ()


def outputs_of(
    plant: Plant, drives: Drive, starts: State, friction: tuple[int, ...]
) -> Float[np.ndarray, "runs time ny"]:
    """Outputs of several runs of one length and one step, at the plant's own parameters.

    Args:
        plant: the equations.
        drives: runs on the leading axis.
        starts: likewise, NumPy arrays.
        friction: which outputs stick, see `integrator.frictional`.

    Returns:
        Outputs at every sample, the first one too.
    """
    return Chain(plant, friction).outputs(drives, starts)


def states_along(plant: Plant, drives: Drive, starts: State, friction: tuple[int, ...]) -> State:
    """States of several runs before each step and after the last; arguments as of `outputs_of`."""
    runs, (rows, ny) = len(starts.y), starts.y.shape[1:]
    try:
        width = rows * ny + starts.z.shape[1]
        moved = Chain(plant, friction).shown(drives, starts, "states", width)
    except Untranslatable:
        return _stepped(plant, drives, starts, friction)
    y, z = np.split(moved, [rows * ny], axis=2)
    y = np.concatenate([starts.y[:, None], y.reshape(runs, -1, rows, ny)], axis=1)
    return State(y, np.concatenate([starts.z[:, None], z], axis=1))


@dataclass(frozen=True)
class Chain:
    """Free runs of a plant at its own parameters; what they need of it is found once.

    Attributes:
        plant: the equations.
        friction: which outputs stick, see `integrator.frictional`.
        chunk: steps at a time, because of the memory of their rows.
    """

    plant: Plant
    friction: tuple[int, ...]
    chunk: int = 8192

    def outputs(self, drives: Drive, starts: State) -> Float[np.ndarray, "runs time ny"]:
        """`outputs_of` the plant."""
        shows = "outputs" if self.plant.has_algebraic else "states"  # whose first ones are y
        try:
            y = self.shown(drives, starts, shows, len(self.plant.outputs))
        except Untranslatable:
            return _scanned(self.plant, drives, starts, self.friction)
        last_substeps = slice(drives.substeps - 1, None, drives.substeps)
        first_sample = first_outputs(self.plant, drives, starts)
        return np.concatenate([first_sample, y[:, last_substeps]], axis=1)

    def shown(
        self, drives: Drive, starts: State, shows: str, width: int
    ) -> Float[np.ndarray, "runs steps shown"]:
        """What a chain shows after every step, the first `width` numbers."""
        plant, (runs, steps) = self.plant, np.shape(drives.time)
        begun, parts = self._begun(float(np.asarray(drives.step)[0]), starts.z.shape[1], shows), []
        time, inputs = (
            np.reshape(drives.time, (-1, 1)),
            np.reshape(drives.inputs, (runs * steps, -1)),
        )
        first = np.concatenate([starts.y.reshape(runs, -1), starts.z.reshape(runs, -1)], axis=1)
        following = [np.reshape(drives.following, (len(time), -1))] if plant.has_algebraic else []
        for at in range(0, len(time), self.chunk):
            part = slice(at, min(at + self.chunk, len(time)))
            begins = np.arange(-(-at // steps), -(-part.stop // steps))  # numbers of runs
            starting = np.zeros((part.stop - at, 1 + first.shape[1]))
            starting[begins * steps - at, 0], starting[begins * steps - at, 1:] = 1.0, first[begins]
            columns = time[part], inputs[part], starting, *(column[part] for column in following)
            (shown,) = begun.outputs(np.concatenate(columns, axis=1), part.stop - at)
            parts.append(shown[:, :width].copy())  # not the whole vector
        return np.concatenate(parts).reshape(runs, steps, -1)

    def _begun(self, step: float, internal: int, shows: str) -> Run:
        """The compiled chain; a run begins in the first row, so that nothing is left of others."""
        key = step, internal, shows
        if key not in self._first_rows:
            code = _code(_Structure(self.plant), internal, self.friction, shows)
            fixed = numbers((self.plant, np.asarray(step)), float)
            self._first_rows[key] = code.begin(np.zeros((1, 1)), fixed)
        return self._first_rows[key]

    @functools.cached_property
    def _first_rows(self) -> dict[tuple, Run]:
        return {}


def _stepped(plant: Plant, drives: Drive, starts: State, friction: tuple[int, ...]) -> State:
    """The same by scans, run by run."""
    theta, runs = jnp.asarray(plant.theta), []
    for i in range(len(starts.y)):
        own = (drives.time, drives.step, drives.inputs, drives.last)
        time, step, inputs, last = (np.asarray(part)[i] for part in own)
        start = State(starts.y[i], starts.z[i])
        driven_by = Drive(time, step, inputs, 1, last)
        runs.append(free_run(plant, theta, driven_by, start, friction))
    y, z = (np.stack(part) for part in zip(*runs, strict=True))
    return State(y, z)


class _Structure:
    """A plant as its programs see it: equal, and hashed alike, where one program serves both."""

    def __init__(self, plant: Plant):
        self.plant = plant
        leaves, structure = jax.tree.flatten(plant)
        kinds = [np.asarray(leaf) for leaf in leaves]
        self._key = (
            structure,
            *(
                (array.shape, array.dtype.kind) if array.dtype.kind in "fb" else array.tobytes()
                for array in kinds
            ),
        )
        self._hash = hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Structure) and self._key == other._key

    def __hash__(self) -> int:
        return self._hash


@functools.lru_cache(maxsize=16)
def _code(
    structure: _Structure, internal: int, friction: tuple[int, ...], shows: str
) -> CompiledLoop:
    """The compiled chain: looked up here by far less than its trees of shapes."""
    plant, dtype, zero = structure.plant, np.dtype(float), np.zeros(())
    start = State(np.zeros((plant.rows, len(plant.outputs))), np.zeros(internal))
    nu = len(plant.inputs)
    following = np.zeros(nu) if plant.has_algebraic else None
    row = _Row(zero, np.zeros((3, nu)), zero, start, following)
    model, lane, step = shapes_of((_Model(plant, friction), zero, row), dtype)
    columns = 2 + 3 * nu + start.y.size + internal + (nu if plant.has_algebraic else 0)
    return compiled_loop(_Chain(model, lane, step, dtype, shows), columns, 1, True)


def _scanned(
    plant: Plant, drives: Drive, starts: State, friction: tuple[int, ...], multiple: int = 8
) -> Float[np.ndarray, "runs time ny"]:
    """The same; runs are filled up to a multiple of a number: few lengths, few compilations."""
    runs = len(drives.time)
    count = -(-runs // multiple) * multiple if runs > 1 else 1
    index = np.minimum(np.arange(count), runs - 1)
    padded_drives = Drive(
        np.asarray(drives.time)[index],
        np.asarray(drives.step)[index],
        np.asarray(drives.inputs)[index],
        drives.substeps,
        np.asarray(drives.last)[index],
    )
    begun = State(starts.y[index], starts.z[index])
    return chained(plant, jnp.asarray(plant.theta), padded_drives, begun, friction)[:runs]
