"""What an engine is: it runs the pass of `kernel.py` for many lanes over one record.

All engines run the same observers, plants and filter; they differ in who compiles the loop and for
what. The scan (`scan.py`) is the reference of the others.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.estimation.kernel import Kernel, Steps, Sums
from eoi_jax.estimation.lowpass import DiscreteFilter
from eoi_jax.estimation.observers.observer import AbstractObserver
from eoi_jax.models.plant import Plant


class Lanes(eqx.Module):
    """What differs between passes over one record; every array has a leading axis (lanes,).

    Attributes:
        observer: all of one class and scheme, their gains stacked.
        theta: θ of each lane, shape (lanes, np).
        increment: Δθ with which the scores are formed, shape (lanes, np).
        weights: of each output in the scores, shape (lanes, ny).
        emphasis: factor on the scores of each block of the record, shape (lanes, blocks); ones if
            left out.
    """

    observer: AbstractObserver
    theta: Float[Array | np.ndarray, "*lanes np"]
    increment: Float[Array | np.ndarray, "*lanes np"]
    weights: Float[Array | np.ndarray, "*lanes ny"]
    emphasis: Float[Array | np.ndarray, "*lanes blocks"] | None = None

    def __len__(self) -> int:
        return self.theta.shape[0]

    def __getitem__(self, index: Any) -> "Lanes":
        """Some of the lanes, by slice or indices."""
        return jax.tree.map(lambda leaf: leaf[index], self)

    def padded(self, room: int) -> "Lanes":
        """As many lanes as there is room for, the last one repeated."""
        return self[np.minimum(np.arange(room), len(self) - 1)]

    def without_emphasis(self) -> "Lanes":
        """What a lane is traced from: how often a block counts is read step by step."""
        return Lanes(self.observer, self.theta, self.increment, self.weights)

    def kernel(self, plant: Plant, lowpass: DiscreteFilter, store: str) -> Kernel:
        """The loop of one lane; of a single one, or inside `vmap`."""
        theta, increment, weights = map(jnp.asarray, (self.theta, self.increment, self.weights))
        return Kernel(plant, self.observer, lowpass, theta, increment, weights, store)


def in_precision(tree: Any, dtype: Any) -> Any:
    """Numbers of a tree in the precision of the lanes, as JAX arrays; flags as they are."""

    def cast(leaf: Any) -> jax.Array:
        array = jnp.asarray(leaf)
        return array.astype(dtype) if jnp.issubdtype(array.dtype, jnp.floating) else array

    return jax.tree.map(cast, tree)


class AbstractEngine(abc.ABC):
    """Interface of every engine."""

    @abc.abstractmethod
    def run(
        self,
        plant: Plant,
        lanes: Lanes,
        lowpass: DiscreteFilter,
        steps: Steps,
        store: str = "nothing",
    ) -> Sums:
        """One pass of every lane over one record.

        Args:
            plant: the model; parameters come from `lanes`.
            lanes: gains and θ; their dtype is that of the loop.
            lowpass: F, shared by all.
            steps: of one record, without a leading axis.
            store: ``"nothing"``, or ``"scores"`` for their covariance, `Sums.meat`.

        Returns:
            Sums as NumPy arrays, the lanes as leading axis.
        """
