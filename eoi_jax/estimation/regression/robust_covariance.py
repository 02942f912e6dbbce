r"""Covariance of an estimate whose residual is coloured, and its degrees of freedom.

$C = I^{-1} S I^{-1}$, with I the information and S the covariance of the sum of all scores φᵀe.
Records are independent, whatever their order: S is the sum over them of N_r times the spectrum of
the scores of record r at frequency zero. That is here the mean over its constant and its B_r
slowest cosines, each of mean square one:

$$S = \sum_r \frac{1}{B_r + 1} \sum_{j=0}^{B_r} c_{rj} c_{rj}^\top, \quad
c_{rj} = a_j \sum_{k=0}^{N_r-1} \cos\!\left(\pi j \frac{k+1/2}{N_r}\right) s_{rk}, \quad
a_0 = 1,\ a_j = \sqrt 2$$

N_r is rounded up, with scores of zero, to a length without large factors, of which a transform
takes a tenth of the time. The c_rj are independent and nearly normal. More cosines make S steadier,
as long as the spectrum is flat below the fastest of them. All records have the same bandwidth:
B_r = B N_r / N, rounded, with N samples in all records, B = 0.4 n^(2/3), and n the number of
independent scores: N over their correlation time. That is the inverse width of their spectrum at
zero. The width of all of it, 1/Σ ρ², is up to 8/3 times that: of two oscillations of one frequency,
as regressor and residual near a resonance are, half of the product lies at zero, and a quarter at
twice the frequency on either side. Of short records the constant is all that counts: the sum of
their scores.

**Correction for the fit.** The sum of all scores is zero, so that the constant of a single record
carries no information. Further, the fit has made the residual e = Mε smaller than the noise ε, by
the part that the regressors can follow: M = 1 - ΦI⁻¹Φᵀ. With regressors as slow as the cosines
that removes a good part of c_i = ΦᵀD_i e, i = (r, j), D_i the cosine, zero outside its
record. Were ε white of variance one, then with Φ made orthonormal, and O_i = ΦᵀD_iΦ the cosine sums
of its squares,

$$E[c_i c_k^\top] = \Phi^\top D_i M D_k \Phi = \Phi^\top D_i D_k \Phi - O_i O_k, \quad
\Phi^\top D_{rj} D_{rk} \Phi = \frac{a_j a_k}{2}
\left(\frac{O_{r,j+k}}{a_{j+k}} + \frac{O_{r,|j-k|}}{a_{j-k}}\right)$$

instead of δ_ik times the share of record r in I. So S is multiplied from both sides by G^(-1/2),
$G = E[S]$, and the variance of an estimate a'θ is a quadratic form in ε: with κ the eigenvalues of
its matrix K_ik, it has (Σκ)²/Σκ² degrees of freedom. Few remain for regressors that do not repeat.

**White residuals.** With all cosines, B_r = N_r - 1, S is by Parseval the sum of s sᵀ over samples,
and D_i keeps a single sample: c_t = Φ_tᵀe_t, O_t = Φ_tᵀΦ_t, and W is diagonal. That is what
`uncorrelated` computes. It has many more degrees of freedom, of 31 samples ten in place of two, and
is right where residuals of different times are uncorrelated. `covariance_of_estimate` takes it
where nothing speaks against that: neither the portmanteau test of the residuals, which sees what is
short, nor the ratio of both variances of a parameter, which sees what is as slow as the regressors.
Below 50 samples a portmanteau test sees too little, and the correlation at lag 1 is tested, for a
positive one: a negative one only makes errors smaller. Of two parameters that decay, 3000 records
each, so many of 100 intervals of 95 % hold the truth (the scatter over the median error of white
noise falls from 1.5 to 1.2 of 12 samples, from 1.4 to 1.1 of 25 and more):

| samples | white: `long_run`, with the test | AR(1) of 0.5: `long_run`, with the test, as white |
|---|---|---|
| 12 | 95, 96 | 94, 92, 78 |
| 25 | 96, 97 | 95, 94, 75 |
| 49 | 95, 97 | 95, 95, 75 |

**Sources.** E. Lazarus, D. Lewis, J. Stock, M. Watson, Journal of Business & Economic Statistics 36
(2018) 541 (equal-weighted cosines, and B); R. Bell, D. McCaffrey, Survey Methodology 28 (2002) 169
(both corrections, there for clusters in place of cosines); G. Ljung, G. Box, Biometrika 65 (1978)
297 (portmanteau test); J. Durbin, G. Watson, Biometrika 37 (1950) 409 (lag 1).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view

from eoi_jax.estimation.regression.noise_autocorrelation import lag_one, ljung_box
from eoi_jax.estimation.regression.orthonormal import informative_directions


@dataclass(frozen=True)
class LongRunSettings:
    """Numbers of `long_run`; those of the formula for B are in the module's docstring."""

    min_cosines: int = 2
    max_cosines: int = 1000  # beyond, all variances have the degrees of freedom of the cosines
    min_share: float = 0.05  # of a score left by the estimate, for which it is scaled up
    white_level: float = 0.2  # of both tests: an AR(1) of 0.3 in 50 samples keeps 93 % of 95 %
    lag_one_level: float = 0.4  # of that of fewer: an AR(1) of 0.5 in 16 samples keeps 90 %


_SETTINGS = LongRunSettings()


def long_run(
    scores: Float[np.ndarray, "time np"],
    rows: Float[np.ndarray, "time ny np"],
    inverse: Float[np.ndarray, "np np"],
    lengths: Sequence[int] | None = None,
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """Covariance of an estimate from its scores, and the degrees of freedom of each variance.

    Args:
        scores: s = Σ_j φ_jᵀ e_j of each sample over all outputs, in order of time, one record
            after the other; zero where not scored. At the estimate they sum to zero.
        rows: φ_j, or ζ_j of instrumental variables, times the square root of the weights of the
            scores; all rows whose products make up a sample's score.
        inverse: I⁻¹ = [Σ φᵀφ]⁻¹ with these weights; of instrumental variables [Σ ζᵀψ]⁻¹, which is
            not symmetric. Zero for parameters that were not estimated.
        lengths: samples of each record; a single record by default.

    Returns:
        C, and the degrees of freedom. Infinite ones, with C = 0, where all scores are zero.
    """
    if not np.any(scores):
        return _exact(inverse)
    lengths = _lengths(scores, lengths)
    count = max(cosine_count(independent_samples(scores, lengths)), _SETTINGS.min_cosines)
    scores, rows, inverse, unit = _orthonormal(scores, rows, inverse)
    projected = scores @ unit
    groups = [
        _sums(projected[places], rows[places], unit, count / len(scores))
        for places in _of_one_length(lengths)
    ]
    spread = np.sum([group.spread for group in groups], axis=0)
    moved = _moved(inverse, unit, np.sum([group.expected for group in groups], axis=0))
    return moved @ spread @ moved.T, _degrees_of_freedom(groups, moved)


def uncorrelated(
    scores: Float[np.ndarray, "time np"],
    rows: Float[np.ndarray, "time ny np"],
    inverse: Float[np.ndarray, "np np"],
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """As `long_run`, of residuals that are uncorrelated in time, whatever their variances.

    Args:
        scores: s of each sample.
        rows: φ_j.
        inverse: I⁻¹.
    """
    if not np.any(scores):
        return _exact(inverse)
    scores, rows, inverse, unit = _orthonormal(scores, rows, inverse)
    projected, rows = scores @ unit, rows @ unit
    leverage = rows @ np.swapaxes(rows, 1, 2)  # Φ_t Φ_tᵀ, of the outputs of a sample
    expected = np.eye(unit.shape[1]) - np.einsum("tik,tij,tjl->kl", rows, leverage, rows)
    moved = _moved(inverse, unit, expected)
    freedom = np.full(len(moved), np.inf)
    for i in np.flatnonzero(np.any(moved != 0, axis=1)):
        along = rows @ moved[i]
        reached = np.einsum("tjk,tj->tk", rows, along)  # O_t m, m a row of `moved`
        own, explained = np.sum(along**2, axis=1), np.sum(reached**2, axis=1)
        square = np.sum(own**2 - 2.0 * own * explained) + np.sum((reached.T @ reached) ** 2)
        freedom[i] = np.sum(own - explained) ** 2 / square
    return moved @ (projected.T @ projected) @ moved.T, freedom


def covariance_of_estimate(
    scores: Float[np.ndarray, "time np"],
    rows: Float[np.ndarray, "time ny np"],
    inverse: Float[np.ndarray, "np np"],
    lengths: Sequence[int],
    residuals: Sequence[np.ndarray],
    estimated: int,
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """That of `uncorrelated` where the residuals pass as white, else that of `long_run`.

    Args:
        scores: s of each sample.
        rows: φ_j.
        inverse: I⁻¹.
        lengths: samples of each record.
        residuals: of each output of each run, (samples,), of equal size; NaN where not scored.
        estimated: how many numbers were fitted, initial values too.
    """
    from scipy.special import fdtrc

    robust, freedom = long_run(scores, rows, inverse, lengths)
    if not _pass_as_white(residuals, estimated):
        return robust, freedom
    white, white_freedom = uncorrelated(scores, rows, inverse)
    varies = np.diagonal(white) > 0
    ratio = np.diagonal(robust)[varies] / np.diagonal(white)[varies]
    chance = fdtrc(freedom[varies], white_freedom[varies], ratio) * np.sum(varies)
    is_white = bool(np.all(chance > _SETTINGS.white_level))
    return (white, white_freedom) if is_white else (robust, freedom)


def _pass_as_white(residuals: Sequence[np.ndarray], estimated: int) -> bool:
    """Whether the portmanteau test, or of few samples that of lag 1, finds no correlation."""
    _, chance = ljung_box(residuals)
    if np.isnan(chance):
        return lag_one(residuals, estimated) > _SETTINGS.lag_one_level
    return chance > _SETTINGS.white_level


def _exact(inverse: Float[np.ndarray, "np np"]) -> tuple[np.ndarray, np.ndarray]:
    return np.zeros_like(inverse), np.full(len(inverse), np.inf)


def _lengths(scores: np.ndarray, lengths: Sequence[int] | None) -> list[int]:
    return [len(scores)] if lengths is None else [int(n) for n in lengths if n > 0]


def _orthonormal(
    scores: Float[np.ndarray, "time np"],
    rows: Float[np.ndarray, "time ny np"],
    inverse: Float[np.ndarray, "np np"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Scores, rows and I⁻¹ of what was estimated; rows times the last one are orthonormal."""
    estimated = np.any(inverse != 0, axis=0)
    if not np.all(estimated):
        scores, rows, inverse = scores[:, estimated], rows[..., estimated], inverse[:, estimated]
    flat = rows.reshape(-1, rows.shape[2])
    directions, eigenvalues = informative_directions(flat.T @ flat)
    return scores, rows, inverse, directions / np.sqrt(eigenvalues)


def _moved(
    inverse: Float[np.ndarray, "np j"],
    unit: Float[np.ndarray, "j k"],
    expected: Float[np.ndarray, "k k"],
) -> Float[np.ndarray, "np k"]:
    """How scores made orthonormal, and corrected for the fit, move the estimate."""
    values, vectors = np.linalg.eigh(expected)
    restored = vectors / np.sqrt(np.maximum(values, _SETTINGS.min_share)) @ vectors.T
    # θ moves by `inverse` times the sum of the scores: unit⁻ᵀ times those made orthonormal.
    return inverse @ np.linalg.pinv(unit).T @ restored


def _of_one_length(lengths: Sequence[int], max_samples: int = 100_000) -> list[Any]:
    """Indices that give the samples of some records of one length, shape (records, time).

    Groups have about `max_samples`, because of the memory of their transforms.
    """
    if len(lengths) == 1:
        return [None]  # a new axis, without a copy
    ends, groups = np.cumsum(lengths), []
    for length in np.unique(lengths):
        first = ends[np.asarray(lengths) == length] - length
        places = first[:, None] + np.arange(length)
        groups += np.array_split(places, -(-places.size // max_samples))
    return groups


@dataclass(frozen=True)
class _Sums:
    """Sums over all records of one length, each with the functions j = 0 … B.

    Attributes:
        spread: part of S.
        expected: part of G.
        squares: O_rj without the factor a_j, j = 0 … 2B, shape (records, 2B + 1, k, k).
    """

    spread: Float[np.ndarray, "k k"]
    expected: Float[np.ndarray, "k k"]
    squares: Float[np.ndarray, "records cosines k k"]

    @property
    def functions(self) -> int:
        """B + 1."""
        return (self.squares.shape[1] + 1) // 2

    def forms(
        self, m: Float[np.ndarray, " k"]
    ) -> Iterator[tuple[Float[np.ndarray, "j j"], Float[np.ndarray, "j k"]]]:
        """For each record m'ΦᵀD_jD_kΦm and O_j m, both times the square root of 1/(B + 1)."""
        a = _factors(self.functions) / np.sqrt(self.functions)
        for rows in self.squares @ m:
            diagonal = rows @ m
            mirrored = np.concatenate(
                [diagonal[self.functions - 1 : 0 : -1], diagonal[: self.functions]]
            )
            at_sum = sliding_window_view(diagonal, self.functions)  # O at j + k
            at_difference = sliding_window_view(mirrored, self.functions)[::-1]  # at |j - k|
            form = at_sum + at_difference
            form *= 0.5 * a
            form *= a[:, None]
            yield form, a[:, None] * rows[: self.functions]


def _sums(
    scores: Float[np.ndarray, "records time k"],
    rows: Float[np.ndarray, "records time ny np"],
    unit: Float[np.ndarray, "np k"],
    bandwidth: float,
) -> _Sums:
    """Sums over records of one length; `bandwidth` is the number of cosines per sample."""
    (count, length, outputs, _), size = rows.shape, unit.shape[1]
    functions = min(round(bandwidth * length), length - 1) + 1
    a = _factors(functions)
    sums = a * cosine_sums(np.moveaxis(scores, 1, 2), functions)
    # Time last: transforms and products along contiguous memory take half the time.
    projected = np.empty((count, outputs, size, length))
    for j in range(outputs):
        np.matmul(unit.T, np.swapaxes(rows[:, :, j], 1, 2), out=projected[:, j])
    squares = np.zeros((len(rows), 2 * functions - 1, size, size))
    for i in range(size):
        products = np.einsum("rjt,rjbt->rbt", projected[:, :, i], projected[:, :, i:])
        sums_of_products = np.moveaxis(cosine_sums(products, 2 * functions - 1), 1, 2)
        squares[:, :, i, i:] = squares[:, :, i:, i] = sums_of_products
    doubled, first = squares[:, 0 : 2 * functions - 1 : 2], squares[:, :functions]
    full = 0.5 * np.sum(a[:, None, None] ** 2 * (doubled + squares[:, :1]), axis=(0, 1))
    explained = np.sum(a[:, None, None] ** 2 * (first @ first), axis=(0, 1))
    spread = np.sum(sums @ np.moveaxis(sums, 1, 2), axis=0)
    return _Sums(spread / functions, (full - explained) / functions, squares)


def _factors(functions: int) -> Float[np.ndarray, " j"]:
    """a_j: all functions have a mean square of one."""
    return np.where(np.arange(functions) == 0, 1.0, np.sqrt(2.0))


def cosine_sums(
    signals: Float[np.ndarray, "*k time"], functions: int
) -> Float[np.ndarray, "*k cosines"]:
    """Σ_k cos(πj(k + ½)/N) times each signal, j from 0; zero from j = N on.

    Args:
        signals: along the last axis.
        functions: number of cosines.
    """
    from scipy.fft import dct

    if functions == 1:
        return np.sum(signals, axis=-1, keepdims=True)
    sums = 0.5 * np.asarray(dct(signals, type=2, n=_rounded_up(signals.shape[-1]), axis=-1))
    missing = [(0, 0)] * (sums.ndim - 1) + [(0, max(functions - sums.shape[-1], 0))]
    return np.pad(sums, missing) if missing[-1][1] else sums[..., :functions]


def _rounded_up(count: int) -> int:
    """The next length without large factors."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(count, real=True) or count)


def _degrees_of_freedom(
    groups: Sequence[_Sums], moved: Float[np.ndarray, "np k"]
) -> Float[np.ndarray, " np"]:
    """(tr K)²/tr(K²) for each parameter; infinite for a parameter without variance."""
    count = sum(len(group.squares) * group.functions for group in groups)
    varies = np.any(moved != 0, axis=1)
    if count > _SETTINGS.max_cosines:
        return np.where(varies, float(count - 1), np.inf)
    freedom = np.full(len(moved), np.inf)
    for i in np.flatnonzero(varies):
        # K = W - TTᵀ, W within records alone, so that tr K² = tr W² - 2 tr TᵀWT + tr (TᵀT)².
        trace, square, explained = 0.0, 0.0, 0.0
        row = moved[i] / np.max(np.abs(moved[i]))  # K counts by its shape, whatever its size
        for form, rows in (pair for group in groups for pair in group.forms(row)):
            trace += np.trace(form)
            square += np.vdot(form, form) - 2.0 * np.vdot(rows, form @ rows)
            explained = explained + rows.T @ rows
        spread = square + np.vdot(explained, explained)
        if spread > 0.0:  # else all that the sums show is explained
            freedom[i] = (trace - np.trace(explained)) ** 2 / spread
    return freedom


def independent_samples(
    scores: Float[np.ndarray, "time np"], lengths: Sequence[int] | None = None
) -> float:
    """Number of samples over the correlation time of the noise, as in B of the module's docstring.

    Args:
        scores: one record after the other.
        lengths: of each record; a single record by default.
    """
    peaks = 1.0 / (0.5**2 + 0.25**2 + 0.25**2)  # width of all peaks over that of one peak
    return len(scores) / (peaks * correlation_time(scores, lengths))


def cosine_count(independent: float) -> int:
    """B of the module's docstring, for a number of independent samples."""
    return round(0.4 * independent ** (2.0 / 3.0))


def correlation_time(
    scores: Float[np.ndarray, "time np"], lengths: Sequence[int] | None = None
) -> float:
    r"""Σ ρ(l)² over all lags, of the most correlated column [samples]; one for white noise.

    Inverse width of the whole spectrum, wherever its peaks lie: by Parseval the mean square of the
    spectrum over its squared mean. With the periodogram P_r of each record, of which E P² = 2 (E
    P)², the square of their sum is without bias $(\sum P_r)^2 - \tfrac12 \sum P_r^2$.

    Args:
        scores: one record after the other.
        lengths: of each record; a single record by default.
    """
    lengths = [len(scores)] if lengths is None else list(lengths)
    # Periodograms are summed on a common grid of frequencies, that of the longest record.
    count = _rounded_up(max(lengths))
    size = scores.shape[1]
    total, squares = np.zeros(((count + 1) // 2 - 1, size)), np.zeros(size)
    for places in _of_one_length(lengths):
        for record_scores in scores[places]:
            # Without the constant and the highest frequency, which have no conjugate.
            waves = np.fft.rfft(record_scores, count, axis=0)[1 : (count + 1) // 2]
            power = waves.real**2
            power += waves.imag**2
            total += power
            squares += np.einsum("tk,tk->k", power, power)
    mean_square = (np.einsum("tk,tk->k", total, total) - 0.5 * squares) / len(total)
    squared_mean = np.mean(total, axis=0) ** 2
    used = squared_mean != 0.0  # NaN stays
    return float(np.max(mean_square[used] / squared_mean[used], initial=1.0))
