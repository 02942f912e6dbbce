"""What the unknowns of a refined model, its parameters and starts, can do to the errors of runs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.estimation.regression.orthonormal import orthonormal

Columns = Float[np.ndarray, "all_rows columns"]


@dataclass(frozen=True)
class OwnUnknowns:
    """The space of the errors that they span: a start has a part in the rows of its run alone.

    Attributes:
        starts: orthonormal columns of each run; zero where a start has fewer directions.
        parameters: orthonormal columns over all rows, orthogonal to those of the starts.
    """

    starts: Float[np.ndarray, "runs rows size"]
    parameters: Float[np.ndarray, "all_rows columns"]

    @classmethod
    def of(
        cls, slopes: Float[np.ndarray, "runs rows size"], start_size: int, tolerance: float
    ) -> "OwnUnknowns":
        """From the slopes of the errors.

        Args:
            slopes: with the start of each run, then with the parameters.
            start_size: unknowns of a start.
            tolerance: singular value of columns of length one below which a direction is rounding.
        """
        starts = np.zeros((*slopes.shape[:2], start_size))
        for run, columns in enumerate(slopes[..., :start_size]):
            basis = orthonormal(columns, tolerance)
            starts[run, :, : basis.shape[1]] = basis
        columns = slopes[..., start_size:].reshape(-1, slopes.shape[-1] - start_size)
        size = np.linalg.norm(columns, axis=0)
        reduced = cls(starts, np.zeros((len(columns), 0))).removed_from(columns)
        reduced = reduced / np.where(size > 0, size, 1.0)
        vectors, values, _ = np.linalg.svd(reduced, full_matrices=False)
        return cls(starts, vectors[:, values > tolerance])

    def removed_from(self, columns: Columns) -> Columns:
        """Columns less what the unknowns can do to them."""
        runs, rows, _ = self.starts.shape
        by_run = columns.reshape(runs, rows, -1)
        by_run = by_run - self.starts @ (np.swapaxes(self.starts, 1, 2) @ by_run)
        columns = by_run.reshape(len(columns), -1)
        return columns - self.parameters @ (self.parameters.T @ columns)
