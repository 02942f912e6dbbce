"""Internal states whose start is free, in the modes of a record: what they can move says nothing.

What a start moves, ∂f/∂z₀ along the record, is of a few directions among all modes. Without these a
residual is that of any start, on the records of the fit and on held-out ones, and so is what an
effect would take of it.
"""

from dataclasses import dataclass, replace

import numpy as np

from eoi_jax.data.record import Record
from eoi_jax.discovery.cosine_modes import ModalRecord, model_rows
from eoi_jax.estimation.free_starts import first_starts
from eoi_jax.estimation.regression.orthonormal import orthonormal
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class FreeStartSettings:
    """Numbers of the derivatives with the starts.

    Attributes:
        difference: step, over the size of a start, or absolute at zero.
        tolerance: of directions that are no rounding.
    """

    difference: float = 1e-4
    tolerance: float = 1e-6


_SETTINGS = FreeStartSettings()


def with_free_starts(plant: Plant, prepared: ModalRecord, record: Record) -> ModalRecord:
    """A prepared record without what free starts can move in it; itself where none is free.

    Args:
        plant: the model.
        prepared: the record, prepared for it.
        record: as measured, with its hold.
    """
    starts = first_starts(plant, [record])
    if starts is None:
        return prepared
    begin = starts[0, :, 0]
    begun = replace(prepared, z_start=begin)
    base, columns = model_rows(plant, [begun])[0][0], []
    for state in np.flatnonzero(plant.free_internal):
        step, moved = _SETTINGS.difference * (abs(begin[state]) or 1.0), begin.copy()
        moved[state] += step
        rows = model_rows(plant, [replace(begun, z_start=moved)])[0][0]
        columns.append((rows - base) / step)
    parts = np.split(np.stack(columns, axis=1), len(plant.outputs))
    modes = tuple(orthonormal(part, _SETTINGS.tolerance) for part in parts)
    return replace(begun, start_modes=modes)
