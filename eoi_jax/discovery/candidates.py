"""Candidate effects as columns of a regression: each effect at each point of its shape grid.

A term is linear in its gains: its columns are the term at unit gain, projected on the modes. An
effect of an input or of an internal state replaces the declared part of the model: the columns of
*all* parameters change, and what is fitted is the physical model itself, not a linearisation in the
effect.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from eoi_jax.compiler.pointwise import Along, along
from eoi_jax.discovery.cosine_modes import ModalRecord, internal_along, model_rows
from eoi_jax.discovery.own_states import Signals, states_along
from eoi_jax.discovery.thinning import averaged_and_thinned
from eoi_jax.models.augmented import Placed, augmented
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractInputEffect,
    AbstractTerm,
    At,
    Grid,
    Seen,
)
from eoi_jax.models.jacobians import input_slopes
from eoi_jax.models.plant import Plant

_OVERFLOW = 1e100
_SHAPES = 16  # of a grid, evaluated at once


@dataclass(frozen=True)
class CandidateColumns:
    """One effect at one value of its shape parameters, as columns.

    Attributes:
        placed: the effect and its channel.
        shape: its shape parameters.
        columns: one for each gain, shape (rows, gains).
        target: y^(r) - f with the changed input or internal state; None for a term.
        slopes: ∂f/∂θ of the declared parameters then, shape (rows, np).
    """

    placed: Placed
    shape: tuple[float, ...]
    columns: Float[np.ndarray, "rows gains"]
    target: Float[np.ndarray, " rows"] | None = None
    slopes: Float[np.ndarray, "rows np"] | None = None

    @property
    def key(self) -> tuple[str, bool, int, int | None, int | None]:
        """Kind and channel: two atoms of one key are never in one model."""
        one = self.placed
        return one.effect.kind, one.on_state, one.channel, one.against, one.through


def seen_at(
    plant: Plant,
    placed: Placed,
    stretches: Sequence[ModalRecord],
    band: float,
    peaks: Float[np.ndarray, " peaks"],
    lags: Float[np.ndarray, " lags"],
) -> Seen:
    """What the records show at the channel of an effect."""
    u = placed.channel if placed.on_input else 0
    row = min(placed.row, plant.relative_degree - 1)
    ends = [placed.output, *([] if placed.against is None else [placed.against])]
    levels = [placed.coordinate(one.y[:, 0]) for one in stretches]
    if placed.on_state:
        levels = [internal_along(plant, one)[:, placed.channel] for one in stretches]
    return Seen(
        np.concatenate(levels),
        np.concatenate([placed.coordinate(one.y[:, row]) for one in stretches]),
        np.concatenate([one.u[:, u] if plant.inputs else 0.0 * one.time for one in stretches]),
        placed.row == 0,
        max(float(np.linalg.norm(one.state_noise[ends])) for one in stretches),
        max(one.duration for one in stretches),
        max(one.original_period for one in stretches),
        band,
        peaks,
        lags,
    )


def atoms(
    plant: Plant,
    placed: Placed,
    shapes: Grid,
    stretches: Sequence[ModalRecord],
    late: str | None = None,
) -> list[CandidateColumns]:
    """An effect at several values of its shape parameters.

    Args:
        plant: the model.
        placed: the effect.
        shapes: (grid, shapes).
        stretches: of the records.
        late: a parameter of the plant by which it delays the input that the effect delays too. The
            slopes are taken where both together delay as much as this one did: a delay is far
            from linear, and what it had taken of the effect it must be able to give back.
    """
    values = [tuple(float(value) for value in row) for row in shapes]
    if not values:
        return []
    if late is not None:
        made = [_later(plant, placed, value, stretches, late) for value in values]
    elif placed.on_input:
        inputs = [_changed_inputs(placed, shapes, one) for one in stretches]
        target, slopes = model_rows(plant, stretches, inputs)
        none = np.zeros((target.shape[1], 0))
        made = [
            CandidateColumns(placed, value, none, target[i], slopes[i])
            for i, value in enumerate(values)
        ]
    elif placed.on_state:
        made = _changed_states(plant, placed, values, stretches)
    else:
        columns = _term_rows(plant, placed, shapes, stretches)
        made = [CandidateColumns(placed, value, columns[i]) for i, value in enumerate(values)]
    # A state that is faster than the steps does not stay finite: that shape cannot be tried.
    return [one for one in made if _finite(one)]


def _later(
    plant: Plant,
    placed: Placed,
    shape: tuple[float, ...],
    stretches: Sequence[ModalRecord],
    late: str,
) -> CandidateColumns:
    i, theta = plant.names.index(late), np.array(plant.theta)
    theta[i] = np.clip(theta[i] - shape[0], plant.lower[i], plant.upper[i])
    shapes = np.reshape(shape, (1, -1))
    inputs = [_changed_inputs(placed, shapes, one) for one in stretches]
    target, slopes = model_rows(plant.with_parameters(theta), stretches, inputs)
    # f(θ) = f(θ') + ∂f/∂θ (θ - θ'), for increments that count from θ as those of all atoms do.
    target = target[0] - slopes[0] @ (np.asarray(plant.theta) - theta)
    return CandidateColumns(placed, shape, np.zeros((len(target), 0)), target, slopes[0])


def _finite(one: CandidateColumns) -> bool:
    parts = [part for part in (one.columns, one.target, one.slopes) if part is not None]
    # Not a number compares as False.
    return all(bool(np.max(np.abs(part), initial=0.0) < _OVERFLOW) for part in parts)


def _changed_states(
    plant: Plant, placed: Placed, shapes: list[tuple[float, ...]], stretches: Sequence[ModalRecord]
) -> list[CandidateColumns]:
    """The model with the effect in it at gains of zero: its columns are all of them."""
    gains, declared = len(placed.effect.gains), len(plant.names)
    own, made = slice(declared, declared + gains), []
    first = dict(zip(placed.names, (0.0,) * gains + shapes[0], strict=True))
    whole = augmented(plant, [placed], first)
    for shape in shapes:
        changed = whole.with_parameters(np.concatenate([whole.theta[: own.stop], shape]))
        target, slopes = model_rows(changed, stretches)
        made.append(
            CandidateColumns(placed, shape, slopes[0][:, own], target[0], slopes[0][:, :declared])
        )
    return made


def _term_rows(
    plant: Plant, placed: Placed, shapes: Grid, stretches: Sequence[ModalRecord]
) -> Float[np.ndarray, "grid rows gains"]:
    effect = placed.effect
    assert isinstance(effect, AbstractTerm)
    parts = []
    for one in stretches:
        signals, change = _signals(one, placed)
        z = states_along(effect, shapes, signals, change, one.sample_period)
        pushes = _pushes(plant, placed, one)
        for k, degree in enumerate(plant.degrees):
            push = pushes[:, k]
            if np.any(push):
                part = [
                    _thinned_term(effect, (signals, push), *some, degree, one, k)
                    for some in _in_parts(shapes, z)
                ]
                parts.append(one.rows(np.concatenate(part)))
            else:
                parts.append(np.zeros((len(shapes), len(effect.gains), len(one.omega))))
    return np.moveaxis(np.concatenate(parts, axis=-1), 1, 2)


def _in_parts(shapes: Grid, z: Float[np.ndarray, "grid S states"]) -> Iterator[tuple[Grid, Any]]:
    """A few shapes at a time, and their states."""
    for first in range(0, len(shapes), _SHAPES):
        part = slice(first, first + _SHAPES)
        yield shapes[part], z[part]


def _thinned_term(
    effect: AbstractTerm, rows: tuple, shapes: Grid, z: Any, degree: int, one: ModalRecord, k: int
) -> Float[np.ndarray, "grid gains nodes"]:
    """The term at unit gains along a stretch, averaged, weighted and thinned as y^(r) is.

    Args:
        effect: the term.
        rows: its signals, and what one unit of it adds to y^(r) of output `k`.
        shapes: of the effect.
        z: its states at each shape.
        degree: of that output.
        one: the stretch.
        k: which output.
    """
    term = Along(_Term(effect), ("rows", "grid", "grid rows"), rows, shapes, z)

    def values(part: slice) -> Float[np.ndarray, "grid gains part"]:
        return np.moveaxis(term(part), 2, 1)

    batch = len(shapes), len(effect.gains)
    return averaged_and_thinned(values, batch, degree, one.weight[k], one.kernel)


@dataclass(frozen=True)
class _Term:
    """What an effect adds to y^(r) at one instant, for one unit of each gain."""

    effect: AbstractTerm

    def __call__(self, row: tuple, shape: Any, z: Any) -> Array:
        (t, y, v, u), push = row
        at, count = At(t, y, v, u, z), len(self.effect.gains)
        units = np.eye(count).tolist()
        terms = [jnp.asarray(self.effect.term(at, unit, shape)) * push for unit in units]
        return jnp.stack(terms)


@dataclass(frozen=True)
class _Changed:
    """The input that the model gets at one instant."""

    effect: AbstractInputEffect

    def __call__(self, row: tuple, shape: Any, z: Any) -> Any:
        t, y, v, u = row
        return self.effect.changed(At(t, y, v, u, z), shape)


def _pushes(plant: Plant, placed: Placed, one: ModalRecord) -> Float[np.ndarray, "S ny"]:
    """What one unit of an effect adds to y^(r) of each output."""
    if placed.through is not None:
        return input_slopes(plant, one.time, one.y, one.u, placed.through)
    own = np.arange(len(plant.outputs)) == placed.channel
    return np.broadcast_to(own.astype(float), (len(one.time), len(own)))


def _changed_inputs(
    placed: Placed, shapes: Grid, one: ModalRecord
) -> Float[np.ndarray, "grid S nu"]:
    """The inputs as the model gets them."""
    effect, (signals, change) = placed.effect, _signals(one, placed)
    inputs = np.repeat(one.u[None], len(shapes), axis=0)
    if isinstance(effect, AbstractActuator):
        inputs[:, :, placed.channel] = effect.sampled(one.time, signals[3], shapes)
        return inputs
    assert isinstance(effect, AbstractInputEffect)
    z = states_along(effect, shapes, signals, change, one.sample_period)
    axes = ("rows", "grid", "grid rows")
    inputs[:, :, placed.channel] = along(_Changed(effect), axes, signals, shapes, z)
    return inputs


def _signals(one: ModalRecord, placed: Placed) -> tuple[Signals, Signals]:
    """Time, output, velocity and an input, in the middle of each step; their change over it."""
    row, channel = placed.row, placed.channel if placed.on_input else 0
    known = row < one.y.shape[1]
    time, y, u = one.change

    def chosen(t: Any, y: Any, u: Any) -> Signals:
        v = placed.coordinate(y[:, row]) if known else 0.0 * t  # an output without one has none
        own = u[:, channel] if u.shape[1] else 0.0 * t
        return t, placed.coordinate(y[:, 0]), v, own

    return chosen(one.time, one.y, one.u), chosen(time, y, u)
