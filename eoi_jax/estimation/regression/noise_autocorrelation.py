r"""Tests of coloured residuals: whitened by a known spectrum, then tested as white noise.

Missing samples are NaN; only results that need them are missing too.

**Sources.** Ljung and Box, Biometrika 65 (1978) 297; Durbin and Watson, Biometrika 37 (1950) 409;
Box and Jenkins, *Time Series Analysis* (whitening before cross-correlation);
Newey and West, Econometrica 55 (1987) 703 (errors of means).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

ORDER = 12  # of the linear predictions that whiten
LAGS = 20  # that are tested
FEWEST = 50  # samples for a test


def prediction_from(covariance: Float[np.ndarray, " lags"]) -> Float[np.ndarray, " order"]:
    """Linear prediction from the last `ORDER` samples, from an autocovariance."""
    from scipy.linalg import solve_toeplitz

    if covariance[0] <= 0:
        return np.zeros(len(covariance) - 1)
    scaled = covariance / covariance[0]
    first = scaled[:-1].copy()
    first[0] += 1e-9  # a spectrum with zeros has no exact prediction
    return solve_toeplitz(first, scaled[1:])


def whitened(
    values: Float[np.ndarray, " n"], prediction: Float[np.ndarray, " order"]
) -> Float[np.ndarray, " n"]:
    """Each sample less its prediction; NaN where a sample that this needs is missing."""
    white = values.copy()
    white[: len(prediction)] = np.nan
    for lag, weight in enumerate(prediction, start=1):
        white[lag:] -= weight * values[:-lag]
    return white


def whitened_inputs(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """An input less its linear prediction from its own past, by least squares.

    White noise 30 dB below the input is assumed: a few sines can be predicted exactly, and the
    remainder would be rounding.
    """
    parts = [part - np.mean(part) for part in parts]
    rows = [
        np.stack([part[ORDER - i : len(part) - i] for i in range(ORDER + 1)], axis=1)
        for part in parts
        if len(part) > ORDER
    ]
    if not rows:
        return list(parts)
    moments = np.sum([row.T @ row for row in rows], axis=0)
    moments = moments + 1e-3 * moments[0, 0] * np.eye(ORDER + 1)
    if moments[0, 0] <= 0:
        return [np.full_like(part, np.nan) for part in parts]
    prediction = np.linalg.solve(moments[1:, 1:], moments[1:, 0])
    return [whitened(part, prediction) for part in parts]


def correlations(
    pairs: Sequence[tuple[np.ndarray, np.ndarray]], lags: Sequence[int]
) -> tuple[Float[np.ndarray, " lag"], Float[np.ndarray, " lag"]]:
    """Mean of a(t) b(t - lag) over all records, normalised, and its number of samples."""
    sums, counts = np.zeros(len(lags)), np.zeros(len(lags))
    powers = [
        sum(float(np.nansum(pair[i] ** 2)) for pair in pairs)
        / max(sum(int(np.sum(np.isfinite(pair[i]))) for pair in pairs), 1)
        for i in (0, 1)
    ]
    for a, b in pairs:
        for i, lag in enumerate(lags):
            product = a[lag:] * b[: max(len(b) - lag, 0)] if lag >= 0 else a[:lag] * b[-lag:]
            good = np.isfinite(product)
            sums[i] += np.sum(product[good])
            counts[i] += np.sum(good)
    size = np.sqrt(powers[0] * powers[1])
    return sums / np.maximum(counts, 1) / (size if size > 0 else 1.0), counts


def ljung_box(parts: Sequence[np.ndarray]) -> tuple[Float[np.ndarray, " lag"], float]:
    """Autocorrelation of a whitened residual, and the p-value of Σ n (n + 2) / n_k ρ_k².

    Source: Ljung and Box (1978), with n_k pairs at lag k in place of n - k, for gaps.
    """
    from scipy.special import gammaincc

    total = sum(int(np.sum(np.isfinite(part))) for part in parts)
    lags = range(1, LAGS + 1)
    rho, counts = correlations([(part, part) for part in parts], lags)
    if total < FEWEST:
        return rho, np.nan
    used = (np.arange(LAGS) < total // 5) & (counts > 0)
    statistic = np.sum(((total + 2.0) / total * counts * rho**2)[used])
    return rho, float(gammaincc(0.5 * np.sum(used), 0.5 * statistic))


def lag_one(parts: Sequence[np.ndarray], estimated: int) -> float:
    """p-value of a correlation at lag 1 above that which a fit leaves of white noise.

    One-sided, and of any number of samples: of n of them a fit of slow regressors leaves white
    noise a correlation of -p/n, which scatters by 1/√n.

    Source: J. Durbin, G. Watson, Biometrika 37 (1950) 409, with the moments of slow regressors.

    Args:
        parts: residuals, NaN where missing.
        estimated: p, how many numbers were fitted, initial values too.
    """
    from scipy.special import ndtr

    total = sum(int(np.sum(np.isfinite(part))) for part in parts)
    (rho,), (count,) = correlations([(part, part) for part in parts], [1])
    return float(ndtr(-(rho + estimated / max(total, 1)) * np.sqrt(count)))


def largest(rho: np.ndarray, counts: np.ndarray, tested: np.ndarray) -> tuple[float, float, int]:
    """Correlation of the most significant lag, its p-value over all lags tested, and its index."""
    from scipy.special import ndtr

    if np.min(counts[tested]) < FEWEST:
        return 0.0, np.nan, int(np.argmax(tested))
    strength = np.where(tested, np.abs(rho) * np.sqrt(counts), 0.0)
    index = int(np.argmax(strength))
    chance = 2.0 * ndtr(-strength[index]) * np.sum(tested)
    return float(rho[index]), float(min(chance, 1.0)), index


def wald(
    mean: Float[np.ndarray, " bin"], covariance: Float[np.ndarray, "bin bin"], freedom: float
) -> tuple[float, float]:
    """Statistic over its degrees of freedom, and p-value for equal means."""
    from scipy.special import chdtrc, fdtrc

    weights = np.linalg.pinv(covariance, rcond=1e-10, hermitian=True)
    total = np.sum(weights)
    level = np.sum(weights @ mean) / total if total > 0 else 0.0
    count = len(mean) - 1
    wald = float((mean - level) @ weights @ (mean - level))
    if np.isinf(freedom):
        return wald / count, float(chdtrc(count, wald))
    remaining = max(freedom - count + 1.0, 1.0)
    return wald / count, float(fdtrc(count, remaining, wald / count * remaining / freedom))


class Means(NamedTuple):
    """Means by label, and two covariances of them.

    `coloured` is estimated from the values (Newey and West, Bartlett weights), `null` is that of
    noise alone, whose autocovariance is known. A finding must be significant under both: the first
    allows for slow discrepancies, the second is exact if there is none.
    """

    mean: np.ndarray
    coloured: np.ndarray
    null: np.ndarray
    counts: np.ndarray


def coloured_means(
    values: Sequence[np.ndarray],
    labels: Sequence[np.ndarray],
    bins: int,
    null: Sequence[np.ndarray],
) -> Means:
    """Means of all records' values by label.

    Args:
        values: of each record, (n,); NaN where the label is −1.
        labels: from 0; −1 for none.
        bins: how many labels there are.
        null: autocovariance of noise alone for each record, at lags from 0.
    """
    members = [label[:, None] == np.arange(bins) for label in labels]
    values = [np.nan_to_num(record_values) for record_values in values]
    counts = np.sum([np.sum(flags, axis=0) for flags in members], axis=0)
    mean = np.sum([e @ flags for e, flags in zip(values, members, strict=True)], axis=0)
    mean = mean / np.maximum(counts, 1)
    lags = max_lag(int(np.sum(counts)))
    coloured, noise = np.zeros((2, bins, bins))
    for record_values, flags, autocovariance in zip(values, members, null, strict=True):
        flagged = flags.astype(float)
        rows = flagged * (record_values[:, None] - mean)
        for lag in range(min(lags, len(rows) - 1) + 1):
            ends = len(rows) - lag
            part = (1.0 - lag / (lags + 1.0)) * rows[lag:].T @ rows[:ends]
            coloured += part if lag == 0 else part + part.T
            if lag < len(autocovariance):
                part = autocovariance[lag] * flagged[lag:].T @ flagged[:ends]
                noise += part if lag == 0 else part + part.T
    size = np.maximum(np.outer(counts, counts), 1)
    return Means(mean, coloured / size, noise / size, counts)


def max_lag(total: int) -> int:
    """Largest lag of correlated values: that of the noise, or of slower discrepancies."""
    return max(ORDER, round(0.5 * np.sqrt(total)))
