"""Whether a residual is that of a parameter which changes with time.

Where the input has no mean, such a residual has none either, at any time: -Δp(t) ∂f/∂p changes its
sign with the regressor. So it is no function of time, and a map of its means shows nothing.
"""

import numpy as np
from jaxtyping import Float

from eoi_jax.discovery.residual import views_of
from eoi_jax.estimation.identify import Identification
from eoi_jax.estimation.regression.least_squares import Solution, least_squares
from eoi_jax.estimation.regression.robust_covariance import covariance_of_estimate


def drift_of_parameters(identification: Identification, level: float) -> float:
    """Share of the residual's power that parameters linear in time take; 0 if that may be chance.

    The regressors F[φ], each times the time from the middle on, stand beside the regressors. One of
    their coefficients must be significant, with the errors of coloured residuals.

    Args:
        identification: the estimate.
        level: chance of a false alarm, over all parameters.
    """
    from scipy.special import stdtr  # only discovery needs it

    views, _ = views_of(identification)
    middle = np.mean([view.record.time.mean() for view in views])
    power = np.nanmean(np.concatenate([view.residual**2 for view in views]), axis=0)
    errors = [view.residual[:: view.thin] / np.sqrt(power) for view in views]
    error = np.concatenate(errors)
    phi = np.concatenate([view.Phi[:: view.thin] for view in views]) / np.sqrt(power)[:, None]
    time = np.concatenate([view.record.time[:: view.thin] for view in views]) - middle
    rows = np.concatenate([phi, phi * time[:, None, None]], axis=-1)
    rows, error = np.where(np.isfinite(error)[..., None], rows, 0.0), np.nan_to_num(error)
    free = np.asarray(identification.plant.free)
    constant, _ = _fitted(rows, error, np.concatenate([free, 0.0 * free]))
    remaining, solution = _fitted(rows, error, np.concatenate([free, free]))
    lengths = [len(part) for part in errors]
    pieces = np.split(remaining, np.cumsum(lengths)[:-1])
    residuals = [
        np.where(np.isfinite(part[:, j]), piece[:, j], np.nan)
        for part, piece in zip(errors, pieces, strict=True)
        for j in range(part.shape[1])
    ]
    scores = np.einsum("sja,sj->sa", rows, remaining)
    inverse = np.asarray(solution.inverse)
    count = 2 * int(np.sum(free))
    covariance, freedom = covariance_of_estimate(scores, rows, inverse, lengths, residuals, count)
    variances = np.diagonal(covariance)[len(free) :]
    slopes = np.asarray(solution.increment)[len(free) :]
    estimated = variances > 0.0
    ratios = np.abs(slopes[estimated]) / np.sqrt(variances[estimated])
    chances = 2.0 * stdtr(np.minimum(freedom[len(free) :][estimated], 1e9), -ratios)
    if not np.any(chances * len(chances) < level):
        return 0.0
    return float(1.0 - np.sum(remaining**2) / np.sum(constant**2))


def _fitted(
    rows: Float[np.ndarray, "samples ny columns"],
    error: Float[np.ndarray, "samples ny"],
    free: Float[np.ndarray, " columns"],
) -> tuple[Float[np.ndarray, "samples ny"], Solution]:
    """What least squares on the free columns leaves, and its solution."""
    information = np.einsum("sja,sjb->ab", rows, rows)
    solution = least_squares(information, np.einsum("sja,sj->a", rows, error), free)
    return error - rows @ np.asarray(solution.increment), solution
