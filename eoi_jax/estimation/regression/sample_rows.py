"""The rows that the least squares (11) adds up, by sample, and their normal equations."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from eoi_jax.estimation.iteration import group_by_sample, sample_counts


@dataclass(frozen=True)
class SampleRows:
    """Rows of the least squares, those of each sample together, times the root of their weights.

    Attributes:
        error: e, shape (samples, rows).
        regressors: φ, shape (samples, rows, np); zero for parameters that are not estimated.
        instruments: ζ, likewise; None: φ.
        record: index of the record of each sample, in order.
        sample: index in the record of the sample that the rows lead to.
    """

    error: Float[np.ndarray, "samples rows"]
    regressors: Float[np.ndarray, "samples rows np"]
    instruments: Float[np.ndarray, "samples rows np"] | None
    record: Int[np.ndarray, " samples"]
    sample: Int[np.ndarray, " samples"]

    @property
    def zeta(self) -> Float[np.ndarray, "samples rows np"]:
        """What the rows are multiplied with: instruments, or the regressors themselves."""
        return self.regressors if self.instruments is None else self.instruments

    @property
    def scored(self) -> Bool[np.ndarray, " samples"]:
        """Samples with a row that counts."""
        return np.any(self.zeta != 0.0, axis=(1, 2))


def sample_rows(
    error: Float[np.ndarray, "runs S ny"],
    regressors: Float[np.ndarray, "runs S ny np"],
    instruments: Float[np.ndarray, "runs S ny np"] | None,
    use: Any,
    substeps: int,
    record: Sequence[int],
    first: Sequence[int],
) -> SampleRows:
    """Rows of all steps, grouped by sample.

    Args:
        error: e, by run, step and output.
        regressors: φ, zero for parameters that are not estimated.
        instruments: ζ; None: φ.
        use: of `kernel.Steps`.
        substeps: steps per sample.
        record: index of the record of each run, in order.
        first: index in that record of the run's first sample.
    """
    counts = sample_counts(use, substeps)

    def grouped(part: np.ndarray) -> np.ndarray:
        return group_by_sample(part, use, substeps)

    led = [start + 1 + np.arange(count) for start, count in zip(first, counts, strict=True)]
    return SampleRows(
        grouped(error),
        grouped(regressors),
        None if instruments is None else grouped(instruments),
        np.repeat(np.asarray(record), counts),
        np.concatenate(led),
    )


@dataclass(frozen=True)
class NormalEquations:
    """A = Σ ζᵀφ, J = Σ ζᵀζ and Σ ζᵀe over some samples."""

    cross: Float[np.ndarray, "k k"]
    information: Float[np.ndarray, "k k"]
    rhs: Float[np.ndarray, " k"]

    def __add__(self, part: "NormalEquations") -> "NormalEquations":
        """Those of both together."""
        matrices = self.cross + part.cross, self.information + part.information
        return NormalEquations(*matrices, self.rhs + part.rhs)

    def __sub__(self, part: "NormalEquations") -> "NormalEquations":
        """Those of the samples without a part of them."""
        matrices = self.cross - part.cross, self.information - part.information
        return NormalEquations(*matrices, self.rhs - part.rhs)

    def determined(self, max_condition: float = 1e10) -> bool:
        """Whether A can be inverted.

        Args:
            max_condition: of A, its parameters scaled to one.
        """
        powers = np.diagonal(self.information)
        if not (len(powers) and np.all(np.isfinite(self.cross)) and np.all(powers > 0)):
            return False
        scale = np.sqrt(powers)
        return bool(np.linalg.cond(self.cross / np.outer(scale, scale)) < max_condition)

    @property
    def estimate(self) -> Float[np.ndarray, " k"]:
        """A⁻¹ Σ ζᵀe."""
        return np.linalg.solve(self.cross, self.rhs)

    @property
    def covariance(self) -> Float[np.ndarray, "k k"]:
        """A⁻¹ J A⁻ᵀ, that of the estimate for σ² = 1."""
        inverse = np.linalg.inv(self.cross)
        return inverse @ self.information @ inverse.T


def normal_equations(
    error: Float[np.ndarray, "samples rows"],
    phi: Float[np.ndarray, "samples rows k"],
    zeta: Float[np.ndarray, "samples rows k"],
) -> NormalEquations:
    """The sums over some samples.

    Args:
        error: e.
        phi: regressors.
        zeta: instruments, or the regressors again.
    """
    return NormalEquations(
        np.einsum("sja,sjb->ab", zeta, phi),
        np.einsum("sja,sjb->ab", zeta, zeta),
        np.einsum("sja,sj->a", zeta, error),
    )
