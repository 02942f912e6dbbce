r"""Covariance of an estimate whose residual is coloured, and its degrees of freedom.

$C = I^{-1} S I^{-1}$, with I the information and S the covariance of the sum of all scores φᵀe.
S is N times the spectrum of the scores at frequency zero, here the mean over the B slowest cosines:

$$S = \frac{2}{B}\sum_{j=1}^{B} c_j c_j^\top, \quad
c_j = \sum_{k=0}^{N-1} \cos\!\left(\pi j \frac{k+1/2}{N}\right) s_k$$

N is rounded up, with scores of zero, to a length without large factors, of which a transform takes
a tenth of the time. The cosines know nothing of a constant, which the estimate has set to zero. The
c_j are independent and nearly normal. More cosines make S steadier, as long as the spectrum is flat
below the fastest of them: B = 0.4 n^(2/3), n the number of independent scores: N over their
correlation time. That is the inverse width of their spectrum at zero. The width of all of it,
1/Σ ρ², is up to 8/3 times that: of two oscillations of one frequency, as regressor and residual
near a resonance are, half of the product lies at zero, and a quarter at twice the frequency on
either side.

**What the estimate has taken.** It has made the residual e = Mε smaller than the noise ε, by all
that the regressors can follow: M = 1 - ΦI⁻¹Φᵀ. With regressors as slow as the cosines that takes a
good part of c_j = ΦᵀD_j e (D_j the cosine). Were ε white of variance one, then with Φ made
orthonormal, and O_j = ΦᵀD_jΦ the cosine sums of its squares,

$$E[c_j c_k^\top] = \Phi^\top D_j M D_k \Phi = \tfrac12\,(O_{j+k} + O_{|j-k|}) - O_j O_k$$

in place of ½ δ_jk. So S is multiplied from both sides by G^(-1/2), $G = E[S]$, and the variance of
an estimate a'θ is a quadratic form in ε: with κ the B values of its matrix K_jk, it has
(Σκ)²/Σκ² degrees of freedom. Regressors that never repeat leave few of the B.

**Sources.** E. Lazarus, D. Lewis, J. Stock, M. Watson, Journal of Business & Economic Statistics 36
(2018) 541 (equal-weighted cosines, and B); R. Bell, D. McCaffrey, Survey Methodology 28 (2002) 169
(both corrections, there for clusters in place of cosines).
"""

import numpy as np
from jaxtyping import Float

_FEWEST = 2  # cosines: with fewer there are no errors to speak of
_PEAKS = 8.0 / 3.0  # ((1/2)² + (1/4)² + (1/4)²)⁻¹: of the width of all peaks over that of one
_LEFT = 0.05  # of a score, below which what the estimate left of it is not scaled up any more
_MANY = 1000  # cosines, from which on all degrees of freedom are alike
_ROUNDING = 1e-12  # an eigenvalue of the scaled information below it is none


def long_run(
    scores: Float[np.ndarray, "time np"],
    rows: Float[np.ndarray, "time ny np"],
    inverse: Float[np.ndarray, "np np"],
) -> tuple[Float[np.ndarray, "np np"], Float[np.ndarray, " np"]]:
    """Covariance of an estimate from its scores, and the degrees of freedom of each variance.

    Args:
        scores: s = Σ_j φ_jᵀ e_j of each sample over all outputs, in order of time, one record (or
            run) after the other; zero where not scored. At the estimate they sum to zero.
        rows: φ_j, or ζ_j of instrumental variables, times the root of the weights that are in the
            scores; all those that a sample's score is the sum of.
        inverse: I⁻¹ = [Σ φᵀφ]⁻¹ with these weights; of instrumental variables [Σ ζᵀψ]⁻¹, which is
            not symmetric. Zero for what was not estimated.

    Returns:
        C, and the degrees of freedom. Infinite ones, with C = 0, where all scores are zero.
    """
    size = len(inverse)
    if not np.any(scores):
        return np.zeros_like(inverse), np.full(size, np.inf)
    independent = len(scores) / (_PEAKS * correlation_time(scores))
    count = min(max(round(0.4 * independent ** (2.0 / 3.0)), _FEWEST), len(scores) - 1)
    estimated = np.any(inverse != 0, axis=0)
    flat = (rows if np.all(estimated) else rows[..., estimated]).reshape(-1, np.sum(estimated))
    unit = _orthonormal(flat)
    squares = _overlaps((flat @ unit).reshape(*rows.shape[:2], -1), count)
    sums = _cosine_sums(unit.T @ scores[:, estimated].T)[:, 1 : count + 1]
    spread = 2.0 / count * sums @ sums.T
    values, vectors = np.linalg.eigh(_expected(squares, count))
    restored = vectors / np.sqrt(np.maximum(values, _LEFT)) @ vectors.T
    # θ moves by `inverse` times the sum of the scores: unit⁻ᵀ times those made orthonormal.
    moved = inverse[:, estimated] @ np.linalg.pinv(unit).T @ restored
    return moved @ spread @ moved.T, _freedom(squares, moved, count)


def _orthonormal(rows: Float[np.ndarray, "rows np"]) -> Float[np.ndarray, "np k"]:
    """U such that the columns of `rows` @ U are orthonormal; those without information are gone."""
    information = rows.T @ rows
    length = np.sqrt(np.diagonal(information))
    length = np.where(length > 0, length, 1.0)
    values, vectors = np.linalg.eigh(information / np.outer(length, length))
    kept = values > _ROUNDING * values[-1]
    return vectors[:, kept] / np.sqrt(values[kept]) / length[:, None]


def _cosine_sums(signals: Float[np.ndarray, "k time"]) -> Float[np.ndarray, "k cosines"]:
    """c_j of each row, all j from 0."""
    from scipy.fft import dct

    return 0.5 * np.asarray(dct(signals, type=2, n=_rounded_up(signals.shape[1])))


def _rounded_up(count: int) -> int:
    """The next length without large factors."""
    from scipy.fft import next_fast_len

    return int(next_fast_len(count, real=True) or count)


def _overlaps(rows: Float[np.ndarray, "time ny k"], count: int) -> Float[np.ndarray, "cosines k k"]:
    """O_j, j = 0 … 2B, of orthonormal regressors."""
    # Time last: transforms and products then run along the memory, in half the time.
    size, along = rows.shape[2], np.ascontiguousarray(np.moveaxis(rows, 0, 2))
    squares = np.zeros((2 * count + 1, size, size))
    for a in range(size):
        products = np.einsum("jt,jbt->bt", along[:, a], along[:, a:])
        sums = _cosine_sums(products)[:, : 2 * count + 1].T
        squares[: len(sums), a, a:] = squares[: len(sums), a:, a] = sums
    return squares


def _expected(squares: Float[np.ndarray, "cosines k k"], count: int) -> Float[np.ndarray, "k k"]:
    """G: what S is expected to be, times what it should be; one without any loss."""
    j = np.arange(1, count + 1)
    taken = np.einsum("jab,jbc->ac", squares[j], squares[j])
    return 2.0 / count * (0.5 * np.sum(squares[2 * j] + squares[0], axis=0) - taken)


def _freedom(
    squares: Float[np.ndarray, "cosines k k"], moved: Float[np.ndarray, "np k"], count: int
) -> Float[np.ndarray, " np"]:
    """(tr K)²/tr(K²) for each parameter; infinite for what has no variance."""
    if count > _MANY:
        return np.where(np.any(moved != 0, axis=1), float(count), np.inf)
    j = np.arange(1, count + 1)
    freedom = np.full(len(moved), np.inf)
    for i in np.flatnonzero(np.any(moved != 0, axis=1)):
        along = squares @ moved[i]
        own, taken = along @ moved[i], along[j]
        kernel = 0.5 * (own[j[:, None] + j] + own[np.abs(j[:, None] - j)]) - taken @ taken.T
        freedom[i] = np.trace(kernel) ** 2 / np.sum(kernel**2)
    return freedom


def correlation_time(scores: Float[np.ndarray, "time np"]) -> float:
    """Σ ρ(l)² over all lags, of the most correlated column [samples]; one for white noise.

    Inverse width of the whole spectrum, wherever its peaks lie.

    By Parseval the mean square of the spectrum over its squared mean; a periodogram's square is
    twice the spectrum's.
    """
    used, count = scores[:, np.any(scores != 0, axis=0)], _rounded_up(len(scores))
    # The constant and the highest frequency, which have no pair, are left out.
    power = np.abs(np.fft.rfft(used, count, axis=0)[1 : (count + 1) // 2]) ** 2
    ratio = np.mean(power**2, axis=0) / np.mean(power, axis=0) ** 2
    return float(max(0.5 * np.max(ratio), 1.0))
