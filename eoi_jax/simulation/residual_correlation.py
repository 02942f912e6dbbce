"""Correlation of a residual with itself and with an input, with bounds.

For a residual e that is white noise the autocorrelation at any lag but zero is within ± z/√N with
the probability of z. For a residual that is independent of the input u, white or not, so is the
cross-correlation within ± z √(Σ R_e(k) R_u(k) / N), normalised by R_e(0) R_u(0).

Source: L. Ljung, System Identification: Theory for the User, 2nd ed., 1999, section 16.6.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from eoi_jax._checks import check, check_count, counted, real
from eoi_jax.data.record import Record


class Correlation(NamedTuple):
    """A correlation function with its bound.

    Attributes:
        lags: [samples]; positive where the residual follows the input.
        values: normalised, −1 … 1.
        bound: |value| that independent signals exceed at a lag with probability 1 − level.
    """

    lags: Int[np.ndarray, " lag"]
    values: Float[np.ndarray, " lag"]
    bound: float


def autocorrelation(
    residual: Float[np.ndarray, " time"], lags: int = 50, level: float = 0.99
) -> Correlation:
    """Autocorrelation of a residual at lags 1 … `lags`, with the bound of white noise.

    Args:
        residual: on a uniform grid, (N,); NaN where it is unknown.
        lags: largest lag [samples], less than N.
        level: of the bound, 0 … 1.

    Returns:
        Lags (lags,), values (lags,) and bound; NaN if the residual is constant.

    Raises:
        ValueError: `lags` not below the number of samples.

    Source: the docstring of the module.
    """
    residual = _checked(residual, "residual", lags, level)
    values = _centred(residual)
    with np.errstate(invalid="ignore", divide="ignore"):
        normalised = lagged_products(values, values)[1 : lags + 1] / np.sum(values**2)
        bound = _quantile(level) / np.sqrt(np.sum(np.isfinite(residual)))
    return Correlation(np.arange(1, lags + 1), normalised, float(bound))


def cross_correlation(
    residual: Float[np.ndarray, " time"],
    input: Float[np.ndarray, " samples"],
    lags: int = 50,
    level: float = 0.99,
) -> Correlation:
    """Correlation of a residual with an input at lags −`lags` … `lags`, with its bound.

    Positive lags: the residual follows the input, dynamics that the model lacks. Negative lags: the
    input follows the residual, feedback.

    Args:
        residual: on a uniform grid, (N,); NaN where it is unknown.
        input: on the same grid, (N,); NaN where it is unknown.
        lags: largest lag [samples], less than N.
        level: of the bound, 0 … 1.

    Returns:
        Lags (2 lags + 1,), values (2 lags + 1,) and bound; NaN if a signal is constant.

    Raises:
        ValueError: signals of different lengths, `lags` not below the number of samples.

    Source: the docstring of the module.
    """
    residual = _checked(residual, "residual", lags, level)
    driving = _checked(input, "input", lags, level)
    rule = f"must have the length of the residual, {len(residual)}"
    check(len(driving) == len(residual), "input", rule, len(driving))
    valid = np.isfinite(residual) & np.isfinite(driving)
    e, u = (_centred(np.where(valid, signal, np.nan)) for signal in (residual, driving))
    shifts = np.arange(-lags, lags + 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.sqrt(np.sum(e**2) * np.sum(u**2))
        values = lagged_products(e, u)[shifts] / scale
        bound = _quantile(level) * np.sqrt(_common_power(e, u) / np.sum(valid)) / scale
    return Correlation(shifts, values, float(bound))


def error_correlation(
    record: Record,
    prediction: Float[np.ndarray, "time ny"],
    output: int,
    input: int | None = None,
    shortest: int = 50,
    longest: int = 500,
) -> tuple[Correlation, float]:
    """Correlation of the error of a free run with itself, or with an input, with 99 % bounds.

    Lags span a twentieth of the record, `shortest` to `longest` samples. Of an output that is
    measured rarely only its own samples count.

    Args:
        record: the measurement.
        prediction: ŷ on its grid, (N, ny); NaN where nothing was simulated.
        output: number of the output.
        input: number of the input; None: the autocorrelation.
        shortest: number of lags of a short record.
        longest: number of lags of a long record.

    Returns:
        The correlation, and the time of one lag [s].
    """
    mask = record.output_valid[:, output]
    error = np.where(mask, record.outputs[:, output] - prediction[:, output], np.nan)
    valid = np.flatnonzero(np.isfinite(error))
    stride = int(np.median(np.diff(valid))) if len(valid) > 1 else 1
    used = slice(valid[0] if len(valid) else 0, None, stride)
    error = error[used]
    lags = max(min(len(error) - 1, max(shortest, min(len(error) // 20, longest))), 1)
    period = stride * record.sample_period
    if input is None:
        return autocorrelation(error, lags), period
    driving = np.where(record.input_valid, record.inputs[:, input], np.nan)
    return cross_correlation(error, driving[used], lags), period


def _common_power(e: np.ndarray, u: np.ndarray, part: float = 0.2) -> float:
    """Σ R_e(k) R_u(k) over the lags of this part of the record.

    Weights of Bartlett: at longer lags there are only products of chance, and no sum is negative.
    """
    count = max(round(part * len(e)), 1)
    products = lagged_products(e, e)[:count] * lagged_products(u, u)[:count]
    weights = 2.0 * (1.0 - np.arange(count) / count)
    weights[0] = 1.0
    return float(weights @ products)


def _checked(signal: np.ndarray, name: str, lags: int, level: float) -> np.ndarray:
    signal = np.asarray(signal, dtype=float)
    check(signal.ndim == 1, name, "must be one signal over time, (N,)", f"shape {signal.shape}")
    check_count("lags", lags)
    check(0.0 < real(level) < 1.0, "level", "must lie in (0, 1)", level)
    check(lags < len(signal), "lags", f"must be less than {counted(len(signal), 'sample')}", lags)
    return signal


def _centred(signal: np.ndarray) -> np.ndarray:
    """Less its mean; zero, which adds nothing to a sum of products, where it is unknown."""
    valid = np.isfinite(signal)
    if not np.any(valid):
        return np.zeros_like(signal)
    return np.where(valid, signal - np.mean(signal[valid]), 0.0)


def lagged_products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Σ first(t + k) second(t) at index k; negative lags count from the end.

    Args:
        first: a signal, (N,).
        second: another one, or the same, (N,).
    """
    length = 2 ** int(np.ceil(np.log2(2 * len(first))))  # no lag wraps round
    spectra = (np.fft.rfft(signal, length) for signal in (first, second))
    return np.fft.irfft(next(spectra) * np.conj(next(spectra)), length)


def _quantile(level: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * level))
