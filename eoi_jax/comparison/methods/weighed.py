r"""Least squares and instrumental variables from filtered rows, with standard errors.

With instruments Ψ (the regressors Φ themselves for least squares) and outputs weighted by the
inverse power w of their residuals:

    A = Σ w ΨᵀΦ      B = Σ w ΨᵀΨ      Δθ = [Aᵀ B⁻¹ A]⁻¹ Aᵀ B⁻¹ Σ w Ψᵀ e

which for Ψ = Φ is eq. (11). Residuals are coloured: the covariance is a sandwich over blocks of
samples that are longer than the memory of the filter.

Source: T. Söderström, P. Stoica, *Instrumental Variable Methods for System Identification*, 1983.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eoi_jax.comparison.methods.filtered import Rows
from eoi_jax.estimation.regression.least_squares import Solution, least_squares


@dataclass(frozen=True)
class WeightedSolution:
    """Solution of the weighted normal equations.

    Attributes:
        increment: Δθ, shape (np,).
        solution: with the identified directions.
        projection: Aᵀ B⁻¹, from scores to right-hand sides.
        weights: of the outputs, shape (ny,).
        power: of the residuals before the step, shape (ny,).
    """

    increment: Float[np.ndarray, " np"]
    solution: Solution
    projection: Float[np.ndarray, "np np"]
    weights: Float[np.ndarray, " ny"]
    power: Float[np.ndarray, " ny"]

    @property
    def cost(self) -> float:
        """Σ_j log of the residuals' power."""
        return float(np.sum(np.log(np.maximum(self.power, np.finfo(float).tiny))))


def solve(rows: Rows, instruments: Rows, free: Float[np.ndarray, " np"]) -> WeightedSolution:
    """Δθ of rows at some θ.

    Args:
        rows: both sides of the regression.
        instruments: whose `phi` is Ψ; `rows` itself for least squares.
        free: 1 for an estimated parameter.
    """
    power = np.mean(np.concatenate(rows.error) ** 2, axis=0)
    # A residual below rounding errors has no meaning.
    floor = np.maximum(1e-24 * rows.highest**2, np.finfo(float).tiny)
    weights = 1.0 / np.maximum(power, floor)
    weights = weights / np.max(weights)
    np_ = len(free)
    a, b, rhs = np.zeros((np_, np_)), np.zeros((np_, np_)), np.zeros(np_)
    for phi, psi, error in zip(rows.phi, instruments.phi, rows.error, strict=True):
        weighed = (psi * weights[:, None]).reshape(-1, np_).T
        a += weighed @ phi.reshape(-1, np_)
        b += weighed @ psi.reshape(-1, np_)
        rhs += weighed @ error.ravel()
    scale = np.sqrt(np.diagonal(b))
    scale = np.where(scale > 0, scale, 1.0)
    inverse = np.linalg.pinv(b / np.outer(scale, scale), rcond=1e-13, hermitian=True)
    projection = a.T @ (inverse / np.outer(scale, scale))
    information = projection @ a
    solution = least_squares(0.5 * (information + information.T), projection @ rhs, free)
    return WeightedSolution(np.asarray(solution.increment), solution, projection, weights, power)


def covariance(
    solved: WeightedSolution,
    rows: Rows,
    instruments: Rows,
    memory: int,
    max_blocks: int = 50,
    min_blocks: int = 3,
) -> Float[np.ndarray, "np np"]:
    """Sandwich over blocks of scores; NaN where the records are too short for them.

    Args:
        solved: at the estimate.
        rows: there.
        instruments: there.
        memory: of the filter [samples]; a block is as long, or longer.
        max_blocks: about, of a long record.
        min_blocks: of which a covariance says something.
    """
    total = sum(len(error) for error in rows.error)
    length = max(total // max_blocks, memory, 1)
    scores = []
    for error, psi, phi in zip(rows.error, instruments.phi, rows.phi, strict=True):
        count = len(error) // length
        residual = error - phi @ solved.increment
        score = np.einsum("kj,j,kja->ka", residual, solved.weights, psi)[: count * length]
        # Hann window (mean square one): differences of white noise would leak over sharp edges.
        phase = (np.arange(length) + 0.5) / length
        window = np.sqrt(8.0 / 3.0) * np.sin(np.pi * phase) ** 2
        scores.append(np.einsum("bka,k->ba", score.reshape(count, length, score.shape[1]), window))
    blocks = np.concatenate(scores)
    inverse = np.asarray(solved.solution.inverse)
    if len(blocks) < min_blocks:
        return np.where(inverse != 0, np.nan, 0.0)
    meat = blocks.T @ blocks * total / (len(blocks) * length) * len(blocks) / (len(blocks) - 1)
    return inverse @ solved.projection @ meat @ solved.projection.T @ inverse
