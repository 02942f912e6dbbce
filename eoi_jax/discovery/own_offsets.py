"""A model with a constant of its own in each record, and all other parameters in common.

Slopes of the road, loads, tares, the temperature of the room: what was not recorded may stand still
in a record and differ in the next. The model gets one more input, the number of the record, and by
it an offset of each.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.models.parameters import parameter_type
from eoi_jax.models.plant import Dynamics, Plant, State
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.result import Refinement

_NUMBER = "record_number"  # the further input
_OFFSET = "offset_of_record_{}"
# Part of a constant that the parameters leave, from which on it is none of theirs. Derivatives by
# differences of noisy outputs are used nowhere: of exact ones rounding is left.
_ROUNDING = 1e-6
_POINTS = 200  # samples of each record at which that is seen


@dataclass(frozen=True)
class OwnOffsets:
    """A fit with offsets of the records.

    Attributes:
        refinement: of the model with them.
        names: of the parameters that are offsets. The first record has none where a parameter of
            the model is a constant already: only differences are known then.
        records: number of the record that each belongs to.
    """

    refinement: Refinement
    names: tuple[str, ...]
    records: tuple[int, ...]

    @property
    def deviation(self) -> float:
        """Differences of the offsets over their standard errors, root mean square."""
        fit = self.refinement
        places = [fit.plant.names.index(name) for name in self.names]
        values, covariance = fit.plant.theta[places], fit.covariance[np.ix_(places, places)]
        if not np.all(np.isfinite(covariance)):
            return 0.0
        weights = np.linalg.pinv(covariance, hermitian=True)
        if 0 in self.records:  # from their mean, weighted by what is known of each
            unit = np.ones(len(values))
            values = values - (unit @ weights @ values) / (unit @ weights @ unit)
        return float(np.sqrt(max(values @ weights @ values, 0.0) / len(values)))


def with_own_offsets(
    plant: Plant, output: int, records: Sequence[Record], window: float | None
) -> OwnOffsets | None:
    """The fit of a model with an offset of its own in each record at one output.

    Args:
        plant: at the values to start from.
        output: index of the output, of relative degree one or more.
        records: several.
        window: length of the runs [s]; None: whole records.

    Returns:
        None for a plant with actuators or states that change at samples, and without a fit.
    """
    if plant.actuator is not None or plant.sampled is not None:
        return None
    numbers = tuple(range(int(_has_constant(plant, output, records)), len(records)))
    names = tuple(_OFFSET.format(number + 1) for number in numbers)
    model = _model(plant, output, numbers, names)
    numbered = tuple(_numbered(record, number) for number, record in enumerate(records))
    fit = refine_once(model, numbered, window)
    return OwnOffsets(fit, names, numbers) if fit.status.fits else None


def _model(plant: Plant, output: int, numbers: tuple[int, ...], names: tuple[str, ...]) -> Plant:
    """The plant with one more input, the number of the record, and offsets by it."""
    limits = zip(plant.names, plant.lower, plant.upper, strict=True)
    internal, start = plant.internal, plant.internal_initial
    return Plant(
        _Offsets(plant.dynamics, plant.names, output, len(plant.outputs), numbers, names),
        {**plant.parameters, **dict.fromkeys(names, 0.0)},
        relative_degree=plant.degrees,
        inputs=(*plant.inputs, _NUMBER),
        outputs=plant.outputs,
        internal=None if internal is None else _Unnumbered(internal, plant.names),
        internal_initial=None
        if internal is None
        else (_DeclaredStart(start, plant.names) if callable(start) else start),
        bounds={name: (float(low), float(high)) for name, low, high in limits},
        fixed=plant.fixed,
        kinds=dict(plant.kind_items),
        initial=plant.initial,
        name=plant.name,
    )


def _numbered(record: Record, number: int) -> Record:
    """A record with its number as one more input, which is held."""
    inputs = np.column_stack([record.inputs, np.full(len(record), float(number))])
    names, skew = (*record.input_names, _NUMBER), np.append(record.skew, 0.0)
    return record.with_inputs(inputs, names, skew, (*record.holds, "zero"))


def _has_constant(plant: Plant, output: int, records: Sequence[Record]) -> bool:
    """Whether free parameters of the model can make a constant at an output of all records."""
    theta, free = jnp.asarray(plant.theta), np.asarray(plant.free, bool)
    z = plant.internal_start(theta)

    def slopes(y: Any, u: Any) -> Any:
        return plant.regressor(jnp.zeros(()), State(y, z), u, theta)

    columns = []
    for record in records:
        chosen = np.unique(np.linspace(0, len(record) - 1, _POINTS).astype(int))
        y = np.zeros((len(chosen), plant.rows, len(plant.outputs)))
        y[:, 0] = np.nan_to_num(record.outputs[chosen])
        for row in range(1, plant.rows):
            y[:, row] = np.gradient(y[:, row - 1], record.time[chosen], axis=0)
        rows = jax.vmap(slopes)(jnp.asarray(y), jnp.asarray(np.nan_to_num(record.inputs[chosen])))
        columns.append(np.asarray(rows)[:, output, free])
    table = np.concatenate(columns)
    size = np.linalg.norm(table, axis=0)
    table = table / np.where(size > 0.0, size, 1.0)
    constant = np.ones(len(table))
    residue = constant - table @ np.linalg.lstsq(table, constant, rcond=1e-9)[0]
    return bool(np.sqrt(np.mean(residue**2)) < _ROUNDING)


@dataclass(frozen=True)
class _Offsets:
    """f with the offset of the record; equal (and compiled once) for equal plants."""

    base: Dynamics
    declared: tuple[str, ...]
    output: int
    outputs: int
    numbers: tuple[int, ...]
    names: tuple[str, ...]

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        f = _Unnumbered(self.base, self.declared)(t, x, u, p)
        f = jnp.reshape(jnp.asarray(f), (self.outputs,))
        offset = sum(
            jnp.where(u[-1] == number, getattr(p, name), 0.0)
            for number, name in zip(self.numbers, self.names, strict=True)
        )
        return f.at[self.output].add(offset)


@dataclass(frozen=True)
class _Unnumbered:
    """A function of the model, without the number of the record and the offsets."""

    base: Dynamics
    declared: tuple[str, ...]

    @property
    def states(self) -> tuple[str, ...] | None:
        """Names of the internal states."""
        return getattr(self.base, "states", None)

    def __call__(self, t: Any, x: State, u: Any, p: Any) -> Any:
        return self.base(t, x, u[:-1], _DeclaredStart.parameters(self.declared, p))


@dataclass(frozen=True)
class _DeclaredStart:
    """Internal states at the start, as functions of the declared parameters."""

    base: Any
    declared: tuple[str, ...]

    @staticmethod
    def parameters(names: tuple[str, ...], p: Any) -> Any:
        """Those of the declared model, by name."""
        return parameter_type(names)(*(getattr(p, name) for name in names))

    def __call__(self, p: Any) -> Any:
        return self.base(self.parameters(self.declared, p))
