"""Candidate effects as columns of a regression: each effect at each point of its shape grid.

A term is linear in its gains: its columns are the term at unit gain, projected on the modes. An
effect of an input or of an internal state changes the declared part of the model: the columns of
*all* parameters change, and the physical model itself is fitted, not a linearisation in the effect.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

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
    AbstractParameterEffect,
    AbstractTerm,
    Grid,
    Seen,
)
from eoi_jax.models.effects.instants import ChangedInput, UnitTerms
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
        slopes: ∂f/∂θ of the declared parameters for that target, shape (rows, np).
    """

    placed: Placed
    shape: tuple[float, ...]
    columns: Float[np.ndarray, "rows gains"]
    target: Float[np.ndarray, " rows"] | None = None
    slopes: Float[np.ndarray, "rows np"] | None = None

    @property
    def key(self) -> tuple[str, bool, int, int | None, int | None]:
        """Kind and channel: a model never contains two atoms with the same key."""
        placed = self.placed
        return placed.effect.kind, placed.on_state, placed.channel, placed.against, placed.through


def seen_at(
    plant: Plant,
    placed: Placed,
    stretches: Sequence[ModalRecord],
    band: float,
    peaks: Float[np.ndarray, " peaks"],
    lags: Float[np.ndarray, " lags"],
    wavenumbers: Float[np.ndarray, " wavenumbers"] | None = None,
) -> Seen:
    """The signals and scales of the records at the channel of an effect."""
    input_index = placed.channel if placed.on_input else 0
    row = min(placed.row, plant.rows - 1)
    outputs = [placed.output, *([] if placed.against is None else [placed.against])]
    levels = [placed.coordinate(record.y[:, 0]) for record in stretches]
    if placed.on_state:
        levels = [internal_along(plant, record)[:, placed.channel] for record in stretches]
    return Seen(
        np.concatenate(levels),
        np.concatenate([placed.coordinate(record.y[:, row]) for record in stretches]),
        np.concatenate(
            [
                record.u[:, input_index] if plant.inputs else 0.0 * record.time
                for record in stretches
            ]
        ),
        placed.row == 0,
        max(float(np.linalg.norm(record.state_noise[outputs])) for record in stretches),
        max(record.duration for record in stretches),
        max(record.original_period for record in stretches),
        band,
        peaks,
        lags,
        plant.kinds[plant.outputs[placed.output]],
        np.zeros(0) if wavenumbers is None else wavenumbers,
    )


def atoms(
    plant: Plant,
    placed: Placed,
    shapes: Grid,
    stretches: Sequence[ModalRecord],
    delay: str | None = None,
) -> list[CandidateColumns]:
    """An effect at several values of its shape parameters.

    Args:
        plant: the model.
        placed: the effect.
        shapes: (grid, shapes).
        stretches: of the records.
        delay: name of a plant parameter that delays the same input as the effect. The slopes are
            taken where the sum of both delays equals this parameter: a delay is strongly nonlinear,
            and the part of the effect that the parameter has absorbed must be recoverable.
    """
    # A state that is faster than the steps diverges, and an input that a shape makes zero may be
    # divided by: that shape is left out.
    with np.errstate(all="ignore"):
        candidates = _of_all_shapes(plant, placed, shapes, stretches, delay) if len(shapes) else []
        return [candidate for candidate in candidates if _finite(candidate)]


def _of_all_shapes(
    plant: Plant,
    placed: Placed,
    shapes: Grid,
    stretches: Sequence[ModalRecord],
    delay: str | None,
) -> list[CandidateColumns]:
    values = [tuple(float(value) for value in row) for row in shapes]
    if delay is not None:
        return [_with_shorter_delay(plant, placed, value, stretches, delay) for value in values]
    if placed.on_input:
        inputs = [_changed_inputs(placed, shapes, record) for record in stretches]
        target, slopes = model_rows(plant, stretches, inputs, _smoothed(placed))
        no_gains = np.zeros((target.shape[1], 0))
        return [
            CandidateColumns(placed, value, no_gains, target[i], slopes[i])
            for i, value in enumerate(values)
        ]
    if placed.on_state or isinstance(placed.effect, AbstractParameterEffect):
        return _changed_models(plant, placed, values, stretches)
    columns = _term_rows(plant, placed, shapes, stretches)
    return [CandidateColumns(placed, value, columns[i]) for i, value in enumerate(values)]


def _with_shorter_delay(
    plant: Plant,
    placed: Placed,
    shape: tuple[float, ...],
    stretches: Sequence[ModalRecord],
    delay: str,
) -> CandidateColumns:
    i, theta = plant.names.index(delay), np.array(plant.theta)
    theta[i] = np.clip(theta[i] - shape[0], plant.lower[i], plant.upper[i])
    shapes = np.reshape(shape, (1, -1))
    inputs = [_changed_inputs(placed, shapes, record) for record in stretches]
    target, slopes = model_rows(plant.with_parameters(theta), stretches, inputs, _smoothed(placed))
    # f(θ) = f(θ') + ∂f/∂θ (θ - θ'): increments are relative to θ, as those of all atoms.
    target = target[0] - slopes[0] @ (np.asarray(plant.theta) - theta)
    return CandidateColumns(placed, shape, np.zeros((len(target), 0)), target, slopes[0])


def _smoothed(placed: Placed) -> int | None:
    """The input that does not stay held behind an effect."""
    effect = placed.effect
    is_smooth = isinstance(effect, AbstractActuator) and not effect.keeps_steps
    return placed.channel if is_smooth else None


def _finite(candidate: CandidateColumns) -> bool:
    arrays = [
        array
        for array in (candidate.columns, candidate.target, candidate.slopes)
        if array is not None
    ]
    # A comparison with NaN is False.
    return all(bool(np.max(np.abs(array), initial=0.0) < _OVERFLOW) for array in arrays)


def _changed_models(
    plant: Plant, placed: Placed, shapes: list[tuple[float, ...]], stretches: Sequence[ModalRecord]
) -> list[CandidateColumns]:
    """Columns of the augmented model at zero gains, one candidate for each shape."""
    gains, declared = len(placed.effect.gains), len(plant.names)
    gain_columns, candidates = slice(declared, declared + gains), []
    initial = dict(zip(placed.names, (0.0,) * gains + shapes[0], strict=True))
    augmented_plant = augmented(plant, [placed], initial)
    for shape in shapes:
        changed = augmented_plant.with_parameters(
            np.concatenate([augmented_plant.theta[: gain_columns.stop], shape])
        )
        target, slopes = model_rows(changed, stretches)
        candidates.append(
            CandidateColumns(
                placed, shape, slopes[0][:, gain_columns], target[0], slopes[0][:, :declared]
            )
        )
    return candidates


def _term_rows(
    plant: Plant, placed: Placed, shapes: Grid, stretches: Sequence[ModalRecord]
) -> Float[np.ndarray, "grid rows gains"]:
    effect = placed.effect
    assert isinstance(effect, AbstractTerm)
    parts = []
    for record in stretches:
        signals, change = _signals(record, placed)
        z = states_along(effect, shapes, signals, change, record.sample_period)
        pushes = _pushes(plant, placed, record)
        for k, degree in enumerate(plant.degrees):
            push = pushes[:, k]
            if np.any(push):
                rows = signals if degree else _at_start(signals, change, placed, record)
                rows = rows, (record.y, record.u), push
                terms = [
                    _thinned_term(effect, rows, *batch, degree, record, k)
                    for batch in _batches(shapes, z)
                ]
                parts.append(record.rows(np.concatenate(terms), k))
            else:
                parts.append(np.zeros((len(shapes), len(effect.gains), len(record.omega))))
    return np.moveaxis(np.concatenate(parts, axis=-1), 1, 2)


def _at_start(signals: Signals, change: Signals, placed: Placed, record: ModalRecord) -> Signals:
    """Signals at the start of each step, where an output of relative degree 0 is evaluated."""
    t, y, v, _ = (signal - 0.5 * moved for signal, moved in zip(signals, change, strict=True))
    channel = placed.channel if placed.on_input else 0
    u = record.at(0)[2]
    return t, y, v, u[:, channel] if u.shape[1] else 0.0 * t


def _batches(shapes: Grid, z: Float[np.ndarray, "grid S states"]) -> Iterator[tuple[Grid, Any]]:
    """Batches of shapes with their states."""
    for first in range(0, len(shapes), _SHAPES):
        part = slice(first, first + _SHAPES)
        yield shapes[part], z[part]


def _thinned_term(
    effect: AbstractTerm,
    rows: tuple,
    shapes: Grid,
    z: Any,
    degree: int,
    record: ModalRecord,
    output: int,
) -> Float[np.ndarray, "grid gains nodes"]:
    """The term at unit gains along a record, averaged, weighted and thinned like y^(r).

    Args:
        effect: the term.
        rows: its signals, state and inputs of the plant, and the change of y^(r) of the output for
            a unit of the term.
        shapes: shape parameters of the effect.
        z: states of the effect at each shape.
        degree: relative degree of the output.
        record: the record.
        output: index of the output.
    """
    term = Along(_Term(effect), ("rows", "grid", "grid rows"), rows, shapes, z)

    def values(part: slice) -> Float[np.ndarray, "grid gains part"]:
        return np.moveaxis(term(part), 2, 1)

    batch = len(shapes), len(effect.gains)
    return averaged_and_thinned(values, batch, degree, record.weight[output], record.kernel)


@dataclass(frozen=True)
class _Term:
    """The contribution of an effect to y^(r) at an instant, for a unit of each gain."""

    effect: AbstractTerm

    def __call__(self, row: tuple, shape: Any, z: Any) -> Array:
        *signals, push = row
        return UnitTerms(self.effect)(tuple(signals), shape, z) * push


def _pushes(plant: Plant, placed: Placed, record: ModalRecord) -> Float[np.ndarray, "S ny"]:
    """The change of y^(r) of each output for a unit of an effect."""
    if placed.through is not None:
        return input_slopes(plant, record.time, record.y, record.u, placed.through)
    acts_on = np.arange(len(plant.outputs)) == placed.channel
    return np.broadcast_to(acts_on.astype(float), (len(record.time), len(acts_on)))


def _changed_inputs(
    placed: Placed, shapes: Grid, record: ModalRecord
) -> Float[np.ndarray, "grid S nu"]:
    """The inputs that the model receives, for each shape."""
    effect, (signals, change) = placed.effect, _signals(record, placed)
    inputs = np.repeat(record.u[None], len(shapes), axis=0)
    if isinstance(effect, AbstractActuator):
        inputs[:, :, placed.channel] = effect.sampled(record.time, signals[3], shapes)
        return inputs
    assert isinstance(effect, AbstractInputEffect)
    z = states_along(effect, shapes, signals, change, record.sample_period)
    axes = ("rows", "grid", "grid rows")
    inputs[:, :, placed.channel] = along(ChangedInput(effect), axes, signals, shapes, z)
    return inputs


def _signals(record: ModalRecord, placed: Placed) -> tuple[Signals, Signals]:
    """Time, output, velocity and an input in the middle of each step, and their change over it."""
    row, channel = placed.row, placed.channel if placed.on_input else 0
    has_velocity = row < record.y.shape[1]
    time, y, u = record.change

    def selected(t: Any, y: Any, u: Any) -> Signals:
        v = (
            placed.coordinate(y[:, row]) if has_velocity else 0.0 * t
        )  # of relative degree 1: no velocity
        input_signal = u[:, channel] if u.shape[1] else 0.0 * t
        return t, placed.coordinate(y[:, 0]), v, input_signal

    return selected(record.time, record.y, record.u), selected(time, y, u)
