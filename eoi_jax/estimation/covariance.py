"""Covariance and standard errors of an estimate, computed when they are first read.

An estimate that only starts another one never needs them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eoi_jax._process import one_thread
from eoi_jax._status import Status
from eoi_jax.estimation.iteration import Iteration, group_by_sample, sample_counts
from eoi_jax.estimation.regression.least_squares import standard_errors
from eoi_jax.estimation.regression.robust_covariance import long_run
from eoi_jax.models.plant import Plant
from eoi_jax.models.stored_classes import stored_form


@dataclass(frozen=True)
class Certainty:
    """Uncertainty of an estimate.

    Attributes:
        covariance: of the parameters, shape (np, np).
        degrees_of_freedom: of the variance of each, shape (np,); None where they are not known.
        standard_errors: by name.
    """

    covariance: Float[np.ndarray, "np np"]
    degrees_of_freedom: Float[np.ndarray, " np"] | None
    standard_errors: dict[str, float]


class DeferredCertainty:
    """A `Certainty` that is computed once, when `value` is first read.

    Args:
        compute: returns it; dropped afterwards, with the signals that it holds.
    """

    def __init__(self, compute: Callable[[], Certainty]):
        self._compute: Callable[[], Certainty] | None = compute

    @cached_property
    def value(self) -> Certainty:
        """The certainty."""
        assert self._compute is not None
        certainty, self._compute = self._compute(), None
        return certainty


def computed(certainty: Certainty | DeferredCertainty) -> Certainty:
    """A certainty, computed now if it was deferred."""
    return certainty.value if isinstance(certainty, DeferredCertainty) else certainty


@stored_form.register
def _stored_value(certainty: DeferredCertainty) -> Certainty:
    return certainty.value


@one_thread()
def certainty_of_estimate(
    plant: Plant,
    covariance_of: Callable[[], tuple[np.ndarray, np.ndarray]],
    bound: Bool[np.ndarray, " np"],
    status: Status,
    information: Float[np.ndarray, "np np"],
) -> Certainty:
    """The certainty of an estimate, from a function that computes its covariance.

    Args:
        plant: with the estimate.
        covariance_of: returns the covariance, shape (np, np), and its degrees of freedom.
        bound: which parameters are on a bound.
        status: how the estimate ended.
        information: Σ φᵀφ at the estimate.
    """
    covariance, freedom = covariance_of()
    covariance = np.where(bound | bound[:, None], np.nan, covariance)
    errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    if status.code not in ("no_data", "diverged"):
        errors = standard_errors(covariance, information, np.where(bound, 0.0, plant.free))
    pairs = zip(plant.names, errors, strict=True)
    return Certainty(covariance, freedom, {name: float(error) for name, error in pairs})


def least_squares_covariance(
    plant: Plant,
    best: Iteration,
    Phi: np.ndarray,
    residual: np.ndarray,
    use: Any,
    score: Any,
    substeps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the least-squares estimate and its degrees of freedom; NaN if not finite.

    Args:
        plant: with the estimate.
        best: its iteration.
        Phi: F[φ] of each step.
        residual: F[u_eq] - F[φ] Δθ of each step.
        use: as of `Steps`.
        score: likewise.
        substeps: steps per sample.
    """
    inverse, free = np.asarray(best.solution.inverse[0]), np.asarray(plant.free)
    root_weight = np.sqrt(best.weights[0] * np.asarray(score))
    pair = weighted(root_weight, residual), weighted(root_weight[..., None], Phi)
    error, rows = (group_by_sample(values, use, substeps) for values in pair)
    rows *= np.where(best.bound[0], 0.0, 1.0)  # on a bound the scores do not sum to zero
    scores = np.einsum("sj,sja->sa", error, rows)
    if not (np.all(np.isfinite(scores)) and np.any(inverse)):
        return np.where(np.outer(free, free) > 0, np.nan, 0.0), np.zeros(len(free))
    return long_run(scores, rows, inverse, sample_counts(use, substeps).tolist())


def weighted(root: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values times weight; zero where the weight is zero, even if the value is not finite."""
    with np.errstate(invalid="ignore"):
        product = root * values
    return product if np.all(np.isfinite(product)) else np.where(root > 0, product, 0.0)
