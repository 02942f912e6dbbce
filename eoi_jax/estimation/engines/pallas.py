"""An engine for GPUs: the whole loop over a record is one kernel, a lane is a thread.

Under `lax.scan` every step of a record launches kernels anew, and the launches take longer than
the arithmetic. Here a Pallas kernel runs over the record with its carry in registers. What it
computes is a lane program (`loop.py`), number by number, for Triton knows neither small
arrays nor sizes that are no powers of two. A kernel of one thread goes before it: through all that
depends on the record alone, of which it writes what the lanes need, one row a step.

Experimental: compared with the scan by interpretation on a CPU, and lowered for CUDA; no speed
has been measured on a GPU. JAX 0.12 warns that the Triton backend, which this needs, will be
removed.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental import pallas as pl

from eoi_jax._checks import check
from eoi_jax.compiler.graph import Node, Untranslatable, topological_order
from eoi_jax.compiler.loop import (
    BLOCK,
    CARRY,
    Body,
    LaneProgram,
    inputs_of,
    lane_program,
    shapes_of,
)
from eoi_jax.compiler.programs import jit
from eoi_jax.estimation.engines.engine import AbstractEngine, Lanes, in_precision
from eoi_jax.estimation.engines.pass_loop import Pass
from eoi_jax.estimation.kernel import Step, Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant

_WARP = 32  # threads of a GPU that run in step
Number = Any  # of all lanes of a tile, or one that they share


@dataclass(frozen=True)
class OneKernel(AbstractEngine):
    """Lanes across the threads of one Pallas kernel; experimental.

    Attributes:
        tile: lanes of one block of threads, a power of two.
        interpret: run the kernel under XLA instead of compiling it for a GPU; where JAX has only
            a CPU if None.
        memory: for the inputs behind actuators, which differ between lanes [bytes]; more lanes
            than fit go in several launches.

    Raises:
        ValueError: a tile that is no power of two.
    """

    tile: int = _WARP
    interpret: bool | None = None
    memory: int = 2**30

    def __post_init__(self) -> None:
        """Check the tile."""
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
        """One pass of every lane; compiled once for a number of tiles rounded up to 2ⁿ.

        A lane with a NaN among its gains or parameters has NaN in all its sums.

        Raises:
            Untranslatable: the plant or the observer does what a scalar program cannot.
        """
        count, lanes_per_launch = len(lanes), len(lanes)
        if row := _driven(plant):
            size = np.shape(steps.u)[0] * row * lanes.theta.dtype.itemsize
            lanes_per_launch = max(self.memory // size, self.tile)
        parts = []
        for first in range(0, count, lanes_per_launch):
            part = lanes[first : first + lanes_per_launch]
            sums = self.launch(plant, part, lowpass, steps, store)
            parts.append(jax.tree.map(functools.partial(_first, len(part)), sums))
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)

    def launch(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """The sums as JAX arrays, without waiting for them; also for use inside `jit`.

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
        padded = lanes.padded(room)
        interpret = jax.default_backend() == "cpu" if self.interpret is None else self.interpret
        traced_pass = _pass(plant, lanes, lowpass, steps, store)
        used = jnp.asarray(used, jnp.int32).reshape(1)
        return _launch(traced_pass, plant, padded, lowpass, steps, used, self.tile, interpret)


def _first(count: int, leaf: jax.Array) -> np.ndarray:
    return np.asarray(leaf)[:count]


def _driven(plant: Plant) -> int:
    """Count of the numbers of a step that differ between lanes: driven inputs and their ∂/∂θ."""
    return 0 if plant.actuator is None else len(plant.inputs) * (1 + len(plant.names))


# -- what is traced ---------------------------------------------------------------------------


def _pass(plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str) -> Pass:
    """The pass with shapes in place of arrays, which may be traced."""
    if plant.actuator is not None and plant.has_algebraic:
        raise Untranslatable("an output of relative degree 0 with inputs behind an actuator")
    dtype = np.dtype(lanes.theta.dtype)
    rows, _ = eqx.filter_eval_shape(_rows, plant, lanes, lowpass, steps, store)
    lane, step = _shapes(lanes.without_emphasis(), dtype, 1), _shapes(rows, dtype, 1)
    return Pass(_shapes(plant, dtype), lane, _shapes(lowpass, dtype), step, store, dtype)


def _shapes(tree: Any, dtype: np.dtype, skip: int = 0) -> Any:
    def stand_in(leaf: Any) -> Any:
        abstract = isinstance(leaf, jax.Array | jax.ShapeDtypeStruct) and leaf.dtype.kind in "fb"
        return np.broadcast_to(np.zeros((), leaf.dtype), leaf.shape) if abstract else leaf

    return shapes_of(jax.tree.map(stand_in, tree), dtype, skip)


def _rows(
    plant: Plant, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, store: str
) -> tuple[Step, Any]:
    """The steps of a record for the first lane, and all lanes' inputs if behind an actuator."""
    steps = in_precision(steps, lanes.theta.dtype)

    def rows(lane: Lanes) -> Step:
        emphasis = None if lane.emphasis is None else jnp.asarray(lane.emphasis)
        return lane.kernel(plant, lowpass, store).rows(steps, emphasis)

    def inputs(lane: Lanes) -> tuple[jax.Array, jax.Array | None]:
        return rows(lane).u, rows(lane).slope

    return rows(lanes[0]), None if plant.actuator is None else jax.vmap(inputs)(lanes)


def _columns(tree: Any, leading: int, dtype: np.dtype) -> jax.Array:
    """Real numbers and flags as one array, shape (…, columns), in the order of `shapes_of`."""
    leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    flat = [
        leaf.astype(dtype).reshape(*leaf.shape[:leading], -1)
        for leaf in leaves
        if not jnp.issubdtype(leaf.dtype, jnp.integer)
    ]
    return jnp.concatenate(flat, axis=-1)


@functools.lru_cache(maxsize=64)
def _program(traced_pass: Pass) -> LaneProgram:
    return lane_program(traced_pass)


# -- the loops --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class _Loop:
    """What one kernel computes, and where its inputs are.

    Attributes:
        body: of the loop; its general path, for threads that branch apart gain nothing.
        written: numbers of the carries that it writes after the last step.
        fixed: place of each node in the table of what all lanes and steps share.
        lane_constants: place of each node in the table of what is constant for a lane.
        driven: place of each input behind an actuator, which differs between lanes and steps.
    """

    body: Body
    written: tuple[int, ...]
    fixed: dict[Node, int]
    lane_constants: dict[Node, int]
    driven: dict[Node, int] = field(default_factory=dict)

    @property
    def carries(self) -> tuple[int, ...]:
        """Numbers of the carries."""
        return (*self.body.vectors, *self.body.scalars)

    @property
    def updates(self) -> tuple[Node, ...]:
        """Update of each carry."""
        return (*self.body.general.vectors, *self.body.general.scalars)

    @property
    def outputs(self) -> tuple[Node, ...]:
        """Rows that the shared loop writes in each step; none for the loop of the lanes."""
        return self.body.general.outputs if not self.body.vectors else ()

    @functools.cached_property
    def row(self) -> dict[Node, int]:
        """Place of each node in the table of what each step has for all lanes."""
        used = set(topological_order([*self.updates, *self.outputs]))
        columns = self.body.columns.items()
        return {node: i for node, i in columns if node in used and node not in self.driven}

    @functools.cached_property
    def carried(self) -> dict[Node, int]:
        """Place of each carried number before the step."""
        places = {i: place for place, i in enumerate(self.carries)}
        inputs = inputs_of([*self.updates, *self.outputs], CARRY)
        return {node: places[i] for node, i in inputs.items() if i in places}

    @functools.cached_property
    def emphasis(self) -> dict[Node, int]:
        """The factor on the scores of a block, if there is one."""
        return inputs_of(self.updates, BLOCK)


def _loops(program: LaneProgram, driven: int) -> tuple[_Loop | None, _Loop]:
    """The loop that lanes share, and that of the lanes; only the latter if inputs are driven.

    Args:
        program: of both.
        driven: how many numbers of a step are inputs behind an actuator; they come first.
    """
    sums = {
        program.representatives[i] for leaf in jax.tree.leaves(program.result) for i in leaf.ravel()
    }
    fixed, lane_constants = _numbered(program.fixed), _numbered(program.lane_constants)

    def loop(body: Body, inputs: dict[Node, int]) -> _Loop:
        written = tuple(i for i in (*body.vectors, *body.scalars) if i in sums)
        return _Loop(body, written, fixed, lane_constants if body.vectors else {}, inputs)

    if driven:
        body = program.whole_body
        return None, loop(body, {node: i for node, i in body.columns.items() if i < driven})
    return loop(program.shared_body, {}), loop(program.lane_body, {})


def _numbered(nodes: Sequence[Node]) -> dict[Node, int]:
    return {node: place for place, node in enumerate(nodes)}


# -- both kernels -----------------------------------------------------------------------------


@jit
def _launch(
    traced_pass: Pass,
    plant: Plant,
    lanes: Lanes,
    lowpass: DiscreteFilter,
    steps: Steps,
    used: jax.Array,
    tile: int,
    interpret: bool,
) -> Sums:
    """Both loops, that of the lanes over the first `used` tiles."""
    program, dtype, count = _program(traced_pass), traced_pass.dtype, len(lanes)
    shared_rows, driven = _rows(plant, lanes, lowpass, steps, traced_pass.store)
    begin = shared_rows.y[0], shared_rows.y_next[0], steps.z_start
    all_lanes = (plant, lowpass, steps.sample_period, *begin)
    inputs = {
        "fixed": _columns(all_lanes, 0, dtype),
        "lane": _columns(lanes.without_emphasis(), 1, dtype).T,
    }

    def table(nodes: Sequence[Node], *lanes: int) -> jax.Array:
        """Values before the first step, shape (nodes, *lanes)."""
        places = [
            (node, group, i) for group in inputs for node, i in inputs_of(nodes, group).items()
        ]
        input_values = {node: inputs[group][i] for node, group, i in places}
        values = [
            _wide(_real(value, dtype), *lanes) for value in _computed(nodes, input_values, dtype)
        ]
        # A row of nothing, here and below: kernels take no empty arrays.
        return jnp.stack(values or [jnp.zeros(lanes, dtype)])

    def start(loop: _Loop, lanes: int) -> jax.Array:
        return table([program.initial[i] for i in loop.carries], lanes)

    ends, fixed = jnp.asarray(steps.block_end), table(program.fixed)
    blocks, rows = (jnp.cumsum(ends) - ends).astype(jnp.int32), _columns(shared_rows, 1, dtype)
    first, second = _loops(program, _driven(plant))
    carried = {}
    if first is not None:
        common, unused = (jnp.ones(1, jnp.int32), blocks, fixed, rows), table((), 1)
        final_values, row_outputs = _call(
            first, common, (start(first, 1), unused, unused, unused[None]), 1, interpret
        )
        carried, rows = dict(zip(first.written, final_values, strict=False)), row_outputs[..., 0]
    unused, lane_constants = table((), count), table(program.lane_constants, count)
    emphasis = unused if lanes.emphasis is None else jnp.asarray(lanes.emphasis, dtype).T
    driven_inputs = (
        unused[None] if driven is None else jnp.moveaxis(_columns(driven, 2, dtype), 0, -1)
    )
    by_lane = (start(second, count), lane_constants, emphasis, driven_inputs)
    final_values, _ = _call(second, (used, blocks, fixed, rows), by_lane, tile, interpret)
    carried |= dict(zip(second.written, final_values, strict=False))
    return _sums(program, carried, jnp.isnan(lane_constants).any(0))


def _sums(program: LaneProgram, carried: dict[int, jax.Array], spoilt: jax.Array) -> Sums:
    """Sums of all lanes from carried numbers; those not written keep their initial value."""
    dtype = next(iter(carried.values())).dtype
    places = [
        program.representatives[i] for leaf in jax.tree.leaves(program.result) for i in leaf.ravel()
    ]
    initial_values = {i: program.initial[i].value for i in places if i not in carried}
    values = carried | {i: jnp.asarray(value, dtype) for i, value in initial_values.items()}
    row = {i: place for place, i in enumerate(values)}
    table = jnp.stack([jnp.where(spoilt, np.nan, value).astype(dtype) for value in values.values()])

    def gathered(leaf: np.ndarray) -> jax.Array:
        rows = np.reshape([row[program.representatives[i]] for i in leaf.ravel()], leaf.shape)
        return jnp.moveaxis(table[rows], -1, 0)

    return jax.tree.map(gathered, program.result)


def _call(
    loop: _Loop, common: tuple, by_lane: tuple, tile: int, interpret: bool
) -> Sequence[jax.Array]:
    """Final carries, shape (written, lanes), and rows of the steps, (steps, outputs, lanes)."""
    length, (_, count) = common[-1].shape[0], by_lane[0].shape
    output_shape = (length, len(loop.outputs), count) if loop.outputs else (1, 1, count)
    shapes = ((max(len(loop.written), 1), count), output_shape)
    call = pl.pallas_call(
        functools.partial(_kernel, loop, length, tile),
        out_shape=[jax.ShapeDtypeStruct(shape, by_lane[0].dtype) for shape in shapes],
        grid=(count // tile,),
        in_specs=[pl.BlockSpec() for _ in common]
        + [_tiled(table.shape, tile) for table in by_lane],
        out_specs=[_tiled(shape, tile) for shape in shapes],
        compiler_params=None if interpret else _compiler(tile),
        interpret=interpret,
    )
    return call(*common, *by_lane)


def _compiler(tile: int) -> Any:
    from jax.experimental.pallas import triton  # only here: not every build of JAX has it

    return triton.CompilerParams(num_warps=max(tile // _WARP, 1))


def _tiled(shape: tuple[int, ...], tile: int) -> pl.BlockSpec:
    """Blocks of lanes, the last axis."""
    return pl.BlockSpec((*shape[:-1], tile), lambda i: (0,) * (len(shape) - 1) + (i,))


def _kernel(
    loop: _Loop,
    length: int,
    tile: int,
    used: Any,
    blocks: Any,
    fixed: Any,
    row: Any,
    start: Any,
    lane_constants: Any,
    emphasis: Any,
    driven: Any,
    final_values: Any,
    row_outputs: Any,
) -> None:
    """One tile over the record; from `used` on these are references to memory."""
    dtype = np.dtype(start.dtype)

    def go() -> None:
        constants = {node: _read(node, fixed[c]) for node, c in loop.fixed.items()}
        constants |= {
            node: _read(node, lane_constants[c, :]) for node, c in loop.lane_constants.items()
        }

        def step(k: Any, numbers: tuple[Number, ...]) -> tuple[Number, ...]:
            node_values = constants | {node: numbers[place] for node, place in loop.carried.items()}
            node_values |= {node: _read(node, row[k, c]) for node, c in loop.row.items()}
            node_values |= {node: _read(node, driven[k, c, :]) for node, c in loop.driven.items()}
            for node in loop.emphasis:
                node_values[node] = emphasis[blocks[k], :]
            values = _computed([*loop.updates, *loop.outputs], node_values, dtype)
            values = [_wide(_real(value, dtype), tile) for value in values]
            for c, value in enumerate(values[len(loop.updates) :]):
                row_outputs[k, c, :] = value
            return tuple(values[: len(loop.updates)])

        begun = tuple(start[c, :] for c in range(len(loop.carries)))
        ended = lax.fori_loop(np.int32(0), np.int32(length), step, begun)
        last = dict(zip(loop.carries, ended, strict=True))
        for c, i in enumerate(loop.written):
            final_values[c, :] = last[i]

    # Tiles beyond those in use pad the grid to a power of two.
    pl.when(pl.program_id(0) < used[0])(go)


# -- numbers ----------------------------------------------------------------------------------


def _computed(nodes: Sequence[Node], initial: dict[Node, Number], dtype: np.dtype) -> list[Number]:
    """Values of nodes from `initial` ones, whose own arguments are not computed."""
    values, waiting = dict(initial), list(nodes)[::-1]
    while waiting:
        node = waiting[-1]
        missing = [arg for arg in node.args if arg not in values]
        if node in values:
            waiting.pop()
        elif node.op == "constant":
            values[node] = np.asarray(node.value, bool if node.is_bool else dtype)[()]
        elif missing:
            waiting.extend(missing)
        else:
            values[node] = _applied(node.op, [values[arg] for arg in node.args])
    return [values[node] for node in nodes]


def _applied(op: str, numbers: Sequence[Number]) -> Number:
    """One operation; numbers that all lanes share stay single while they can."""
    shape = max((np.shape(number) for number in numbers), key=len)
    function = _FORMS.get(op) or getattr(lax, op)
    return function(*(_wide(number, *shape) for number in numbers))


def _wide(number: Number, *shape: int) -> Number:
    return number if np.shape(number) == shape else jnp.full(shape, number)


def _read(node: Node, number: Number) -> Number:
    """A number from memory, where flags are stored as numbers."""
    return number != 0 if node.is_bool else number


def _real(value: Number, dtype: np.dtype) -> Number:
    return value if value.dtype == dtype else jnp.where(value, dtype.type(1), dtype.type(0))


def _trunc(x: Number) -> Number:
    return lax.sign(x) * lax.floor(lax.abs(x))


def _round_even(x: Number) -> Number:
    """Halves to the even neighbour."""
    low = lax.floor(x)
    fraction, odd = x - low, low - 2 * lax.floor(low / 2)
    return low + jnp.where(fraction == 0.5, odd, (fraction > 0.5).astype(x.dtype))


# What JAX calls otherwise, or Triton does not know.
_FORMS = {
    "and": lax.bitwise_and,
    "or": lax.bitwise_or,
    "xor": lax.bitwise_xor,
    "not": lax.bitwise_not,
    "trunc": _trunc,
    "round_even": _round_even,
}
