"""Errors of free runs: what `validate` answers with."""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._display import Result
from eoi_jax._types import WHERE_SET
from eoi_jax.data.record import Record
from eoi_jax.models.plant import Plant

PerOutput = Float[np.ndarray, " ny"]


@dataclass(frozen=True, eq=False, repr=False)
class Validation(Result):
    """Free-run errors, each of shape (ny,), over the scored samples of all records.

    `plot` shows free run against the measurement, and its error.

    Attributes:
        rmse: root mean square of y − ŷ [unit of y]; infinite if a run diverges.
        nrmse: `rmse` over the standard deviation of y.
        fit: 100 (1 − ‖y − ŷ‖ / ‖y − mean y‖) [%].
        predictions: ŷ, one record for each one given.
        scored: number of samples at which an output is scored.
        outputs: names.
        units: of the outputs, "" where unknown.
        notes: sentences on what limits the numbers.
        records: that it was judged on.
        window: length of the runs [s]; None for whole records.
        in_loop: whether a controller drove the runs by what they simulate.
        scored_at: which samples of each record are scored, where an output was measured; empty in
            a result of an earlier version.
        substeps: steps of the simulation per sample; 0 in a result of an earlier version.
    """

    rmse: PerOutput
    nrmse: PerOutput
    fit: PerOutput
    predictions: tuple[Record, ...]
    scored: int
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    notes: tuple[str, ...]
    records: tuple[Record, ...] = ()
    window: float | None = None
    in_loop: bool = field(default=False, metadata=WHERE_SET)
    scored_at: tuple[Bool[np.ndarray, " time"], ...] = field(default=(), metadata=WHERE_SET)
    substeps: int = field(default=0, metadata=WHERE_SET)

    @property
    def scored_masks(self) -> tuple[Bool[np.ndarray, " time"], ...]:
        """`scored_at`; of a result of an earlier version all samples."""
        return self.scored_at or tuple(np.ones(len(record), bool) for record in self.records)

    @property
    def residual(self) -> list[Float[np.ndarray, "time ny"]]:
        """y − ŷ, one array (N, ny) for each record, NaN where not scored [unit of y]."""
        return [
            np.where(samples[:, None], record.known_outputs - prediction.outputs, np.nan)
            for record, prediction, samples in zip(
                self.records, self.predictions, self.scored_masks, strict=True
            )
        ]


@runtime_checkable
class FittedModel(Protocol):
    """A result with a model in it: of `identify`, `refine` or `discover`."""

    @property
    def plant(self) -> Plant:
        """The model with the estimate."""
        ...

    @property
    def records(self) -> tuple[Record, ...]:
        """Records of the fit, as it used them."""
        ...
