r"""Covariance of an estimate whose residual is coloured, and its degrees of freedom.

$C = I^{-1} S I^{-1}$, with I the information and S the covariance of the sum of all scores φᵀe.
S is N times the spectrum of the scores at frequency zero, here the mean over the B slowest cosines:

$$S = \frac{2}{B}\sum_{j=1}^{B} c_j c_j^\top, \quad
c_j = \sum_{k=0}^{N-1} \cos\!\left(\pi j \frac{k+1/2}{N}\right) s_k$$

The cosines know nothing of a constant, which the estimate has set to zero. The c_j are independent
and nearly normal, so an error over its standard error has the t distribution with B degrees of
freedom. More cosines make it steadier, as long as the spectrum is flat below the fastest of them:
B = 0.4 n^(2/3), n the number of independent scores: N over their correlation time. That is the
inverse width of their spectrum at zero. The width of all of it, 1/Σ ρ², is up to 8/3 times that: of
two oscillations of one frequency, as regressor and residual near a resonance are, half of the
product lies at zero, and a quarter at twice the frequency on either side.

**Source.** E. Lazarus, D. Lewis, J. Stock, M. Watson, Journal of Business & Economic Statistics 36
(2018) 541 (equal-weighted cosines, and B).
"""

import numpy as np
from jaxtyping import Float

_FEWEST = 2  # cosines: with fewer there are no errors to speak of
_PEAKS = 8.0 / 3.0  # ((1/2)² + (1/4)² + (1/4)²)⁻¹: of the width of all peaks over that of one


def long_run(
    scores: Float[np.ndarray, "time np"], inverse: Float[np.ndarray, "np np"]
) -> tuple[Float[np.ndarray, "np np"], float]:
    """Covariance of an estimate from its scores, and its degrees of freedom.

    Args:
        scores: s = Σ_j φ_jᵀ e_j of each sample over all outputs, in order of time, one record (or
            run) after the other; zero where not scored. At the estimate they sum to zero.
        inverse: I⁻¹ = [Σ φᵀφ]⁻¹, with the weights that are in the scores.

    Returns:
        C, and B. Infinite degrees of freedom, with C = 0, where all scores are zero.
    """
    if not np.any(scores):
        return np.zeros_like(inverse), np.inf
    independent = len(scores) / (_PEAKS * correlation_time(scores))
    count = min(max(round(0.4 * independent ** (2.0 / 3.0)), _FEWEST), len(scores) - 1)
    phase = np.pi * (np.arange(len(scores)) + 0.5) / len(scores)
    sums = np.stack([np.cos(j * phase) @ scores for j in range(1, count + 1)])
    spread = 2.0 / count * sums.T @ sums
    return inverse @ spread @ inverse, float(count)


def correlation_time(scores: Float[np.ndarray, "time np"]) -> float:
    """Σ ρ(l)² over all lags, of the most correlated column [samples]; one for white noise.

    Inverse width of the whole spectrum, wherever its peaks lie.

    By Parseval the mean square of the spectrum over its squared mean; a periodogram's square is
    twice the spectrum's.
    """
    used = scores[:, np.any(scores != 0, axis=0)]
    # The constant and the highest frequency, which have no pair, are left out.
    power = np.abs(np.fft.rfft(used, axis=0)[1 : (len(used) + 1) // 2]) ** 2
    ratio = np.mean(power**2, axis=0) / np.mean(power, axis=0) ** 2
    return float(max(0.5 * np.max(ratio), 1.0))
