"""What `refine` answers with: the refined estimate, and the point it started from."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from eoi_jax._display import Result
from eoi_jax._status import NOT_RECORDED, EngineUsed, Status
from eoi_jax._types import WHERE_SET
from eoi_jax.data.record import Record
from eoi_jax.estimation.common_factors import CommonFactor
from eoi_jax.models.plant import Plant


@dataclass(frozen=True)
class Start:
    """Estimated initial state of one run.

    Attributes:
        record: name of the record.
        time: of its first sample [s].
        y: outputs and their derivatives, shape (r, ny).
        z: internal states, shape (nz,).
        past: of a plant with delays or lags, the levels of its inputs before the record less their
            first values, shape (nu,); else None.
    """

    record: str
    time: float
    y: Float[np.ndarray, "r ny"]
    z: Float[np.ndarray, " nz"]
    past: Float[np.ndarray, " nu"] | None = field(default=None, metadata=WHERE_SET)

    def unknowns(self, rows: Sequence[int], columns: Sequence[int]) -> Float[np.ndarray, " own"]:
        """What a run estimates of its start, in the order of `RunLane.start`.

        Args:
            rows: of `y` that are states, with `columns`.
            columns: of each.
        """
        past = np.zeros(0) if self.past is None else self.past
        return np.concatenate([self.y[list(rows), list(columns)], self.z, past])


@dataclass(frozen=True, eq=False, repr=False)
class Refinement(Result):
    """Output-error estimate, and the point it started from.

    `plot` shows measured and free run, residual, and the parameters' intervals.

    Attributes:
        parameters: estimate by name.
        standard_errors: by name; from the slowest cosines of the scores, so that they know that
            residuals are coloured, or from all where these pass as white
            (`regression/robust_covariance.py`). NaN for a parameter on its bound, infinite for one
            that the data leave open, 0 for a fixed one.
        covariance: of the parameters, shape (np, np).
        plant: with the estimate; `nominal` is the one it started from.
        starts: estimated initial state of each run.
        rmse: over all scored samples, shape (ny,). before: the same at the starting point, with
            initial states fitted to the first samples of each run.
        cost: Σ_j log rmse_j², which is minimised. cost_before: the same at the starting point.
        residual: y - ŷ, one array (N, ny) per record, NaN where not scored.
        steps: of the solver. window: length of the runs [s] as used, their mean where records
            differ; None for whole records.
        status: how it ended.
        notes: what else there is to know.
        information: Σ φᵀφ over the scored samples, φ the derivative of the free runs with the
            parameters where their initial states follow them, each output over its rms residual,
            shape (np, np); None where it was not kept.
        degrees_of_freedom: of the variance of each parameter, shape (np,); None where they were
            not kept.
        residual_before: as `residual`, at the starting point; empty where it was not kept.
        records: as given; empty where they were not kept.
        substeps: steps of the simulation per sample.
        engine: that ran the simulations, and why where it was not the fast one.
        common_factors: parameters that no record tells apart, where the estimate leaves some open.
        in_loop: whether a controller drove the runs by what they simulate.
    """

    parameters: dict[str, float]
    standard_errors: dict[str, float]
    covariance: Float[np.ndarray, "np np"]
    plant: Plant
    nominal: Plant
    starts: tuple[Start, ...]
    rmse: Float[np.ndarray, " ny"]
    before: Float[np.ndarray, " ny"]
    cost: float
    cost_before: float
    residual: list[np.ndarray]
    steps: int
    window: float | None
    status: Status
    notes: tuple[str, ...]
    information: Float[np.ndarray, "np np"] | None = None
    degrees_of_freedom: Float[np.ndarray, " np"] | None = None
    residual_before: tuple[np.ndarray, ...] = ()
    records: tuple[Record, ...] = ()
    substeps: int = 4
    engine: EngineUsed = NOT_RECORDED
    common_factors: tuple[CommonFactor, ...] = ()
    in_loop: bool = field(default=False, metadata=WHERE_SET)
