"""Where the equations of a plant jump with the state: a contact with damping, a zone of drag.

What jumps compares something that depends on the state (`comparisons.py`). Whether a comparison
moves the equations by a jump is seen at its border, found by bisection between two states on its
two sides: beside a jump they change by the same over any distance, beside a kink by less over a
smaller one.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from eoi_jax.compiler.comparisons import COMPARED, comparisons
from eoi_jax.compiler.jax_private import operations_of
from eoi_jax.compiler.pointwise import along
from eoi_jax.models.plant import Plant, State
from eoi_jax.simulation.rates import rate_of

Rows = tuple[Any, ...]  # x, t, u, θ, each with an axis of rows


@dataclass(frozen=True)
class StateJumpRules:
    """How jumps are looked for.

    Attributes:
        most: comparisons of a plant; of one with more none is looked at.
        points: states at which they are evaluated.
        magnitudes: of all states and inputs there, on both sides of zero.
        pairs: of states on both sides of a comparison, between which its border is looked for.
        halvings: of the distance in each pair, and how many after them.
        share: of the change over the first distance that is there over the last one as well.
        smallest: jump that counts, over the size of the equations.
    """

    most: int = 16
    points: int = 128
    magnitudes: tuple[float, float] = (1e-3, 1e2)
    pairs: int = 12
    halvings: tuple[int, int] = (20, 28)
    share: float = 0.9
    smallest: float = 1e-9


_RULES = StateJumpRules()


def state_jumps(plant: Plant) -> tuple[int, ...]:
    """Which comparisons of a plant's equations these jump with, by their number.

    Not those of dry friction, and none of a plant that has it: its steps end at its stops. They are
    looked for at parameters around one, whatever the plant's own: a damping of the nominal value
    zero has its jump too.

    Args:
        plant: the equations.

    Returns:
        Numbers as of `comparisons` of `rate_of`, ascending.
    """
    return _state_jumps(jax.tree.structure(plant), jnp.result_type(float))


@functools.lru_cache(maxsize=256)
def _state_jumps(structure: Any, dtype: Any) -> tuple[int, ...]:
    del dtype  # part of the cache key: the probes are computed in this type
    names = jax.tree.unflatten(structure, [None] * structure.num_leaves).names
    plant: Plant = jax.tree.unflatten(structure, [np.ones(len(names))] * structure.num_leaves)
    rows, evaluate = _points(plant), _Evaluated(plant)
    one_row = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], float), rows)
    if operations_of(jax.make_jaxpr(evaluate.slopes)(one_row).jaxpr).isdisjoint(COMPARED):
        return ()
    count = jax.eval_shape(lambda row: evaluate(row)[0], one_row).shape[0]
    if not 0 < count <= _RULES.most or any(plant.dry_friction):
        return ()
    jumps = _jumping(lambda rows: along(evaluate, ("rows",), rows), rows, count)
    return tuple(np.flatnonzero(jumps).tolist())


@dataclass(frozen=True)
class _Evaluated:
    """What a plant compares at one point, and its slopes without those of algebraic outputs."""

    plant: Plant

    def slopes(self, row: Rows) -> State:
        """dx/dt."""
        x, t, u, theta = row
        return rate_of(self.plant, theta, t, x, u)

    def __call__(self, row: Rows) -> tuple[Any, Any]:
        x, t, u, theta = row
        plant = self.plant

        def slopes(x: State) -> State:
            return rate_of(plant, theta, t, x, u)

        differences = comparisons(slopes, x)[0]
        if not len(differences):
            return differences, jnp.zeros(0)
        rates = slopes(x)
        y = jnp.where(plant.algebraic, 0.0, rates.y)
        return differences, jnp.concatenate([jnp.ravel(y), rates.z])

    @functools.cached_property
    def _key(self) -> Any:
        return jax.tree.structure(self.plant)

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Evaluated) and self._key == other._key


def _points(plant: Plant) -> Rows:
    """Fixed pseudo-random states, inputs and parameters."""
    draw, count = np.random.default_rng(0), _RULES.points
    ny, nu = len(plant.outputs), len(plant.inputs)
    theta = draw.uniform(0.8, 1.2, (count, len(plant.names)))
    nz = jax.eval_shape(plant.internal_start, jax.ShapeDtypeStruct(theta[0].shape, float)).shape[0]
    low, high = np.log(_RULES.magnitudes)

    def signed(*shape: int) -> np.ndarray:
        return draw.choice([-1.0, 1.0], shape) * np.exp(draw.uniform(low, high, shape))

    x = State(signed(count, plant.rows, ny), signed(count, nz))
    return x, np.full(count, 0.3), signed(count, nu), theta


def _jumping(
    evaluate: Callable[[Rows], tuple[Any, Any]], rows: Rows, count: int
) -> Bool[np.ndarray, " comparisons"]:
    """Whether the slopes jump at the border of each comparison."""
    x, *signals = rows
    number, negative, positive = _pairs(evaluate(rows)[0], count)
    if not len(number):
        return np.zeros(count, bool)
    begin, end = (
        jax.tree.map(lambda leaf, side=side: leaf[side], x) for side in (negative, positive)
    )
    fixed = tuple(part[negative] for part in signals)

    def border(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        def mixed(a: np.ndarray, b: np.ndarray) -> np.ndarray:
            part = share.reshape(-1, *[1] * (a.ndim - 1))
            return (1.0 - part) * a + part * b

        differences, slopes = evaluate((jax.tree.map(mixed, begin, end), *fixed))
        return differences[np.arange(len(number)), number], slopes

    low, high, changes = np.zeros(len(number)), np.ones(len(number)), []
    # Both ends with the parameters of the first: some pairs have no border between them.
    is_bracket = (border(low)[0] < 0) & (border(high)[0] > 0)
    for halvings in _RULES.halvings:
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            rises = border(middle)[0] > 0
            low, high = np.where(rises, low, middle), np.where(rises, middle, high)
        changes.append(_change(border(low)[1], border(high)[1]))
    (first_change, first_size), (change, size) = changes
    jumps = (change > _RULES.smallest * size) & (change > _RULES.share * first_change)
    jumps &= size < first_size / _RULES.share  # beside a pole there are no limits
    of_each = np.zeros(count, bool)
    np.logical_or.at(of_each, number, is_bracket & np.any(jumps, axis=1))
    return of_each


def _change(
    low: Float[np.ndarray, "pairs slopes"], high: Float[np.ndarray, "pairs slopes"]
) -> tuple[Float[np.ndarray, "pairs slopes"], Float[np.ndarray, "pairs slopes"]]:
    with np.errstate(invalid="ignore"):
        return np.abs(high - low), np.abs(high) + np.abs(low)


def _pairs(
    differences: Float[np.ndarray, "points comparisons"], count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of comparisons, and of points at which what is compared is negative and positive."""
    number, negative, positive = [], [], []
    for i in range(count):
        low, high = (np.flatnonzero(side * differences[:, i] > 0) for side in (-1, 1))
        size = min(len(low), len(high), _RULES.pairs)
        number += [i] * size
        negative += low[:size].tolist()
        positive += high[:size].tolist()
    return np.array(number, int), np.array(negative, int), np.array(positive, int)
