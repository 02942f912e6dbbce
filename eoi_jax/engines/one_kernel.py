"""An engine for GPUs: the whole loop over a record is one kernel, a lane is a thread.

Under `lax.scan` every step of a record launches kernels anew, and the launches take longer than
the arithmetic. Here one Pallas kernel runs over the record with its carry in registers. It is
traced from the same `Kernel.init` and `Kernel.step` as every engine, number by number
(`components.py`), for Triton knows neither small arrays nor sizes that are no powers of two.

Experimental: compared with the scan by interpretation on a CPU, and lowered for CUDA; no speed
has been measured on a GPU. Compiled by Triton 3.9 for compute capability 9.0, a step of the
pendulum is some 210 instructions in 71 registers (143 in float64), none of them spilled. Of seven
plants only the three masses spill, in float64.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import pallas as pl
from jax.extend.core import ClosedJaxpr

from eoi_jax.checks import check
from eoi_jax.engines.components import Components, Number, evaluate
from eoi_jax.engines.engine import AbstractEngine, Lanes
from eoi_jax.lowpass import DiscreteFilter
from eoi_jax.passes import Carry, Kernel, Step, Steps, Sums
from eoi_jax.plants.plant import Plant

_WARP = 32  # threads


@dataclass(frozen=True)
class OneKernel(AbstractEngine):
    """Lanes across the threads of one Pallas kernel; experimental.

    Attributes:
        tile: lanes of one block of threads, a power of two.
        interpret: run the kernel under XLA instead of compiling it for a GPU; where JAX has only
            a CPU if None.
        memory: for the inputs behind actuators, which differ between lanes [bytes]; more lanes
            than fit go in several launches.
    """

    tile: int = _WARP
    interpret: bool | None = None
    memory: int = 2**30

    def __post_init__(self) -> None:
        """A wrong tile is found here."""
        good = self.tile >= 1 and self.tile & (self.tile - 1) == 0
        check(good, "tile", "must be a power of two", self.tile)

    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane; compiled once for a number of tiles rounded up to 2ⁿ."""
        count, most = len(lanes), len(lanes)
        if plant.actuator is not None:
            row = np.shape(steps.u)[0] * len(plant.inputs) * (1 + len(plant.names))
            most = max(self.memory // (row * lanes.theta.dtype.itemsize), self.tile)
        parts = []
        for first in range(0, count, most):
            some = lanes[first : first + most]
            sums = self.launch(plant, some, lowpass, steps, store)
            parts.append(jax.tree.map(functools.partial(_first, len(some)), sums))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def launch(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """The same as JAX arrays, on whose completion nothing waits; for use inside `jit` too.

        Args:
            plant: as in `run`.
            lanes: as in `run`.
            lowpass: as in `run`.
            steps: as in `run`.
            store: as in `run`.

        Returns:
            Sums of the lanes and of padding after them.
        """
        count = len(lanes)
        used = -(-count // self.tile)
        room = self.tile * 2 ** int(np.ceil(np.log2(used)))
        padded = lanes[np.minimum(np.arange(room), count - 1)]
        interpret = jax.default_backend() == "cpu" if self.interpret is None else self.interpret
        return _launch(
            plant, padded, lowpass, steps, store, jnp.asarray(used), self.tile, interpret
        )


def _first(count: int, leaf: jax.Array) -> np.ndarray:
    return np.asarray(leaf)[:count]


@eqx.filter_jit
def _launch(
    plant: Plant,
    lanes: Lanes,
    lowpass: DiscreteFilter,
    steps: Steps,
    store: str,
    used: jax.Array,
    tile: int,
    interpret: bool,
) -> Sums:
    """The kernel over the first `used` tiles of lanes."""
    dtype, count, emphasis = lanes.theta.dtype, len(lanes), lanes.emphasis
    plain, structure = eqx.partition(plant, eqx.is_array)
    shared = (plain, lowpass, jnp.asarray(steps.sample_period))
    gains = Lanes(lanes.observer, lanes.theta, lanes.increment, lanes.weights)
    row, own = _rows(plant, lanes, lowpass, steps, store)
    loop = _loop(structure, store, (shared, gains, row, own), emphasis is not None, dtype)
    ends = jnp.asarray(steps.block_end)
    common = [
        used.astype(jnp.int32).reshape(1),
        (jnp.cumsum(ends) - ends).astype(jnp.int32),
        _packed(shared, 0, dtype),
        _packed(row, 1, dtype),
    ]
    by_lane = [  # a dummy where there is nothing: kernels take no empty arrays
        _packed(gains, 1, dtype).T,
        jnp.zeros((1, count), dtype) if emphasis is None else jnp.asarray(emphasis, dtype).T,
        jnp.moveaxis(_packed(own, 2, dtype), 0, -1) if own else jnp.zeros((1, 1, count), dtype),
    ]
    places = _places(loop)
    size = places.sums
    call = pl.pallas_call(
        functools.partial(_kernel, loop, places, ends.shape[0], tile),
        out_shape=jax.ShapeDtypeStruct((size, count), dtype),
        grid=(count // tile,),
        in_specs=[pl.BlockSpec() for _ in common] + [_tiled(one.shape, tile) for one in by_lane],
        out_specs=_tiled((size, count), tile),
        compiler_params=None if interpret else _compiler(tile),
        interpret=interpret,
    )
    return _sums(loop.carry.sums, places, call(*common, *by_lane))


def _sums(shapes: Sums, places: "_Places", table: jax.Array) -> Sums:
    """Sums of all lanes from those of their numbers that the loop kept, shape (numbers, lanes)."""
    leaves, structure = jax.tree.flatten(shapes)
    where = places.where[-sum(leaf.size for leaf in leaves) :]
    known = np.array([isinstance(place, np.generic) for place in where])
    first = len(places.kept) - places.sums
    rows = np.array([0 if isinstance(place, np.generic) else place - first for place in where])
    values = np.where(known, where, 0).astype(table.dtype)
    numbers = jnp.where(known[:, None], values[:, None], table[rows])
    parts = jnp.split(numbers, np.cumsum([leaf.size for leaf in leaves])[:-1])
    return jax.tree.unflatten(
        structure,
        [part.T.reshape(-1, *leaf.shape) for part, leaf in zip(parts, leaves, strict=True)],
    )


def _compiler(tile: int) -> Any:
    from jax.experimental.pallas import triton  # only here: not every build of JAX has it

    return triton.CompilerParams(num_warps=max(tile // _WARP, 1))


def _tiled(shape: tuple[int, ...], tile: int) -> pl.BlockSpec:
    """Blocks of lanes, the last axis."""
    return pl.BlockSpec((*shape[:-1], tile), lambda i: (0,) * (len(shape) - 1) + (i,))


# -- packing ----------------------------------------------------------------------------------


def _rows(
    plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str
) -> tuple[dict, dict]:
    """Fields of `Step` along the record: those that all lanes share, and those of each lane."""
    every = lanes[0].kernel(plant, lowpass, store).rows(steps)
    row = {key: value for key, value in vars(every).items() if value is not None}
    if plant.actuator is None:
        return row, {}

    def inputs(lane: Lanes) -> dict:
        here = lane.kernel(plant, lowpass, store).rows(steps)
        return {"u": here.u, "slope": here.slope}

    own = jax.vmap(inputs)(lanes)
    return {key: value for key, value in row.items() if key not in own}, own


def _packed(tree: Any, leading: int, dtype: Any) -> jax.Array:
    """All leaves as one array, shape (…, columns) after so many leading axes; flags as 0 and 1."""
    leaves = [jnp.asarray(leaf).astype(dtype) for leaf in jax.tree.leaves(tree)]
    flat = [leaf.reshape(*leaf.shape[:leading], -1) for leaf in leaves]
    return jnp.concatenate(flat, axis=-1)


def _unpacked(shapes: Any, column: Callable[[int], Number]) -> list[Components]:
    """The leaves of one lane or step from the columns of `_packed`."""
    values, first = [], 0
    for shape in jax.tree.leaves(shapes):
        items = [column(first + i) for i in range(shape.size)]
        if shape.dtype == bool:
            items = [item != 0 for item in items]
        values.append(Components(shape.shape, tuple(items)))
        first += shape.size
    return values


# -- the loop ---------------------------------------------------------------------------------


class _Loop(NamedTuple):
    """One lane's loop as jaxprs, and the shapes of what it takes."""

    start: ClosedJaxpr  # of shared, gains, row
    step: ClosedJaxpr  # of shared, gains, carry, row, own, emphasis
    shared: Any
    gains: Any
    row: Any
    own: Any
    emphasis: Any
    carry: Carry


def _loop(structure: Any, store: str, arrays: tuple, weighed: bool, dtype: Any) -> _Loop:
    def shapes(tree: Any, leading: int) -> Any:
        def shape(leaf: Any) -> jax.ShapeDtypeStruct:
            kind = bool if leaf.dtype == bool else dtype
            return jax.ShapeDtypeStruct(leaf.shape[leading:], kind)

        return jax.tree.map(shape, tree)

    shared, gains, row, own = (
        shapes(tree, n) for tree, n in zip(arrays, (0, 1, 1, 2), strict=True)
    )
    emphasis = {"emphasis": jax.ShapeDtypeStruct((), dtype)} if weighed else {}

    def kernel_of(shared: tuple, gains: Lanes) -> Kernel:
        return gains.kernel(eqx.combine(shared[0], structure), shared[1], store)

    def start(shared: tuple, gains: Lanes, row: dict) -> Carry:
        return kernel_of(shared, gains).init(row["y"], row["y_next"], shared[2])

    def step(
        shared: tuple, gains: Lanes, carry: Carry, row: dict, own: dict, emphasis: dict
    ) -> Carry:
        now = Step(**{"slope": None, **row, **own, **emphasis})
        return kernel_of(shared, gains).step(carry, now, shared[2])[0]

    first, carry = jax.make_jaxpr(start, return_shape=True)(shared, gains, row)
    then = jax.make_jaxpr(step)(shared, gains, carry, row, own, emphasis)
    return _Loop(first, then, shared, gains, row, own, emphasis, carry)


def _kernel(
    loop: _Loop,
    places: "_Places",
    length: int,
    tile: int,
    used: Any,
    blocks: Any,
    shared: Any,
    row: Any,
    gains: Any,
    emphasis: Any,
    own: Any,
    out: Any,
) -> None:
    """One tile over the record; from `used` on these are references to memory."""

    def at(numbers: tuple[Number, ...], i: int) -> Number:
        place = places.where[i]
        return place if isinstance(place, np.generic) else numbers[place]

    def go() -> None:
        fixed = _unpacked(loop.shared, lambda c: shared[c])
        fixed += _unpacked(loop.gains, lambda c: gains[c, :])

        def now(k: Any) -> list[Components]:
            return _unpacked(loop.row, lambda c: row[k, c])

        def packed(carry: list[Components]) -> tuple[Number, ...]:
            items = _items(carry)
            return tuple(_wide(items[i], tile) for i in places.kept)

        def step(k: Any, numbers: tuple[Number, ...]) -> tuple[Number, ...]:
            values = fixed + _unpacked(loop.carry, lambda i: at(numbers, i)) + now(k)
            values += _unpacked(loop.own, lambda c: own[k, c, :])
            values += _unpacked(loop.emphasis, lambda _: emphasis[blocks[k], :])
            return packed(evaluate(loop.step, values, _apply))

        begun = packed(evaluate(loop.start, fixed + now(0), _apply))
        ended = jax.lax.fori_loop(np.int32(0), np.int32(length), step, begun)
        for i, number in enumerate(ended[-places.sums :]):
            out[i, :] = number

    # Tiles beyond those in use pad the grid to a power of two.
    pl.when(pl.program_id(0) < used[0])(go)


class _Places(NamedTuple):
    """Which numbers of the carry the loop keeps, and for each number which of these it is.

    A number that never changes (the derivative of an output with a parameter of another one, sums
    of it, scores that nobody asked for) stays known; its place is its value. Two leaves are
    symmetric matrices, most of what there is to carry: their lower half is the upper one.

    Attributes:
        kept: their indices in the carry.
        where: index in `kept` of each number of the carry, or its value.
        sums: how many of those kept are sums; they come last.
    """

    kept: list[int]
    where: list[Any]
    sums: int


def _places(loop: _Loop) -> _Places:
    leaves, structure = jax.tree.flatten(loop.carry)
    starts = np.cumsum([0] + [leaf.size for leaf in leaves])
    numbers = [
        np.arange(first, first + leaf.size).reshape(leaf.shape)
        for first, leaf in zip(starts, leaves, strict=False)
    ]
    numbered = jax.tree.unflatten(structure, numbers)
    twins = eqx.tree_at(
        lambda one: (one.sums.information, one.sums.meat), numbered, replace_fn=_upper
    )
    twin = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(twins)]).tolist()
    known = _constants(loop)
    kept = [i for i, other in enumerate(twin) if i == other and i not in known]
    order = {number: place for place, number in enumerate(kept)}
    where = [known[i] if i in known else order[i] for i in twin]
    first = len(twin) - sum(leaf.size for leaf in jax.tree.leaves(loop.carry.sums))
    return _Places(kept, where, sum(i >= first for i in kept))


def _upper(numbers: np.ndarray) -> np.ndarray:
    return np.minimum(numbers, np.swapaxes(numbers, -1, -2))


def _constants(loop: _Loop) -> dict[int, np.generic]:
    """Numbers of the carry that are known at the start and by no step changed."""

    def unknown(*shapes: Any) -> list[Components]:
        return [
            Components(shape.shape, tuple(object() for _ in range(shape.size)))
            for shape in jax.tree.leaves(shapes)
        ]

    def after(jaxpr: ClosedJaxpr, values: list[Components]) -> dict[int, np.generic]:
        results = evaluate(jaxpr, values, lambda *_: object())
        return {i: one for i, one in enumerate(_items(results)) if isinstance(one, np.generic)}

    fixed, row = unknown(loop.shared, loop.gains), unknown(loop.row)
    known, before = after(loop.start, fixed + row), None
    while known != before:
        carry = _unpacked(loop.carry, lambda i, known=known: known.get(i, object()))
        values = fixed + carry + row + unknown(loop.own, loop.emphasis)
        then = after(loop.step, values)
        before, known = known, {i: one for i, one in known.items() if then.get(i) == one}
    return known


def _items(values: Sequence[Components]) -> list[Number]:
    return [item for value in values for item in value.items]


def _apply(primitive: Any, numbers: Sequence[Number], params: dict) -> Number:
    """Arithmetic on lanes; numbers that all of them share stay single while they can."""
    shape = max((np.shape(number) for number in numbers), key=len)
    return primitive.bind(*(_wide(number, *shape) for number in numbers), **params)


def _wide(number: Number, *shape: int) -> Number:
    return number if np.shape(number) == shape else jnp.full(shape, number)
