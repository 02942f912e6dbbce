"""What `refine` answers with: the refined estimate, and the point it started from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from eoi_jax.data.record import Record
from eoi_jax.plants.plant import Plant
from eoi_jax.results import NOT_RECORDED, EngineUsed, Status


@dataclass(frozen=True)
class Start:
    """Estimated initial state of one run.

    Attributes:
        record: name of the record.
        time: of its first sample [s].
        y: outputs and their derivatives, shape (r, ny).
        z: internal states, shape (nz,).
    """

    record: str
    time: float
    y: Float[np.ndarray, "r ny"]
    z: Float[np.ndarray, " nz"]


@dataclass(frozen=True)
class Refinement:
    """Output-error estimate, and the point it started from.

    Attributes:
        parameters: estimate by name.
        standard_errors: by name; from the slowest cosines of the scores, so that they know that
            residuals are coloured (`regression/long_run.py`). NaN for a parameter on its bound,
            infinite for one that the data leave open, 0 for a fixed one.
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

    def __str__(self) -> str:
        """A short table."""
        wide = max(len(name) for name in self.parameters)
        units, old = self.plant.units, self.nominal.parameters
        lines = [
            f"{self.plant.name}: {self.status}",
            f"{'parameter':<{wide}}  {'before':>11}  {'refined':>11}  {'± std. error':>12}  unit",
        ]
        for name, value in self.parameters.items():
            fixed = name in self.plant.fixed
            error = "fixed" if fixed else f"{self.standard_errors[name]:.2g}"
            row = f"{name:<{wide}}  {old[name]:>11.6g}  {value:>11.6g}  {error:>12}"
            lines.append(f"{row}  {units.get(name, '')}".rstrip())
        length = "whole records" if self.window is None else f"windows of {self.window:g} s"
        lines.append(f"rmse of {len(self.starts)} run(s), {length}:")
        for name, old_rmse, rmse in zip(self.plant.outputs, self.before, self.rmse, strict=True):
            lines.append(f"  {name}: {old_rmse:.5g} → {rmse:.5g} {units.get(name, '')}".rstrip())
        return "\n".join([*lines, *(f"- {note}" for note in (*self.notes, *self.engine.notes))])

    def plot(self) -> Any:
        """Measured and free run, residual, and the parameters' intervals: a matplotlib figure."""
        from eoi_jax.report.estimate_figures import refinement_figure

        return refinement_figure(self)

    def save(self, path: str | Path) -> None:
        """Write to one `.npz` file that `eoi_jax.load` reads back; nothing in it is pickled."""
        from eoi_jax.store import save

        save(self, path)
