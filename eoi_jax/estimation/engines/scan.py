"""The reference engine: `lax.scan` over the steps, `vmap` over a tile of lanes, on any device.

Lanes go in tiles whose carry stays in a core's cache; the tiles run one after the other inside the
compiled function, and spread over the devices by `shard_map` (`eoi_jax.configure(devices=…)` makes
several of one CPU).
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from eoi_jax.compiler.programs import jit
from eoi_jax.estimation.engines.engine import AbstractEngine, Lanes, in_precision
from eoi_jax.estimation.kernel import Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Scan(AbstractEngine):
    """Lanes in tiles under `lax.scan`.

    Attributes:
        tile: lanes that step together.
        devices: how many of JAX's devices to use; all if None.
    """

    tile: int = 64
    devices: int | None = None

    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane; compiled once for a number of lanes rounded up."""
        count, devices = len(lanes), jax.devices()[: self.devices]
        # Few sizes, so that lanes that end early do not make new shapes to compile.
        tile = next(n for n in (1, 8, self.tile) if n >= self.tile or n * len(devices) >= count)
        used = -(-count // (tile * len(devices)))  # tiles of each device
        room = tile * len(devices) * 2 ** int(np.ceil(np.log2(used)))
        unsplit = (lanes.padded(room), lowpass, steps)
        tiles, lowpass, steps = in_precision(unsplit, lanes.theta.dtype)
        tiles = jax.tree.map(lambda leaf: leaf.reshape(-1, tile, *leaf.shape[1:]), tiles)
        # Tiles go to the devices in turn, so that those that are only padding come last on each.
        order = np.arange(room // tile).reshape(-1, len(devices)).T.ravel()
        tiles = jax.tree.map(lambda leaf: leaf[order], tiles)
        sums = _tiles(plant, tiles, lowpass, steps, store, jnp.asarray(used), tuple(devices))
        original_order = np.argsort(order)
        return jax.tree.map(
            lambda leaf: np.asarray(leaf)[original_order].reshape(room, *leaf.shape[2:])[:count],
            sums,
        )


@jit
def _tiles(
    plant: Plant,
    tiles: Lanes,
    lowpass: DiscreteFilter,
    steps: Steps,
    store: str,
    used: jax.Array,
    devices: tuple,
) -> Sums:
    """The first `used` tiles of each device; leading axes (tiles, lanes)."""
    plain, structure = eqx.partition(plant, eqx.is_array)

    def run(
        plain: Any, lanes: Lanes, lowpass: DiscreteFilter, steps: Steps, used: jax.Array
    ) -> Sums:
        plant = eqx.combine(plain, structure)

        def lane(single_lane: Lanes) -> Sums:
            emphasis = None if single_lane.emphasis is None else jnp.asarray(single_lane.emphasis)
            return single_lane.kernel(plant, lowpass, store).run(steps, emphasis)[0]

        def tile(i: jax.Array, sums: Sums) -> Sums:
            lanes_of_tile = jax.tree.map(lambda leaf: leaf[i], lanes)
            new = jax.vmap(lane)(lanes_of_tile)
            return jax.tree.map(lambda stored, update: stored.at[i].set(update), sums, new)

        shape = jax.eval_shape(jax.vmap(jax.vmap(lane)), lanes)
        start = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape)
        return jax.lax.fori_loop(0, used, tile, start)

    if len(devices) > 1:
        mesh = Mesh(np.array(devices), ("devices",))
        split, replicated = PartitionSpec("devices"), PartitionSpec()
        run = jax.shard_map(
            run,
            mesh=mesh,
            in_specs=(replicated, split, replicated, replicated, replicated),
            out_specs=split,
            check_vma=False,
        )
    return run(plain, tiles, lowpass, steps, used)
