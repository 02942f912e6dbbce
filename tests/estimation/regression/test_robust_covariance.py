"""Covariance from coloured scores: against what is known of AR(1), and of resonances."""

import numpy as np
import pytest
from scipy.signal import lfilter

from eoi_jax.estimation.degrees_of_freedom import student
from eoi_jax.estimation.regression.noise_autocorrelation import ljung_box
from eoi_jax.estimation.regression.robust_covariance import (
    correlation_time,
    covariance_of_estimate,
    long_run,
    uncorrelated,
)

TRIALS = 600
SIGMA = np.sqrt(0.95 * 0.05 / TRIALS)


def ar1(a: float, count: int, rng: np.random.Generator) -> np.ndarray:
    white = rng.standard_normal(count + 400)
    return np.asarray(lfilter([1.0], [1.0, -a], white))[400:]


def resonant(count: int, rng: np.random.Generator, damping: float = 0.02) -> np.ndarray:
    """Noise through an oscillator of twenty samples a period."""
    pole = np.exp(-damping + 2j * np.pi / 20)
    coefficients = [1.0, -2.0 * pole.real, abs(pole) ** 2]
    return np.asarray(lfilter([1.0], coefficients, rng.standard_normal(count + 1000)))[1000:]


def covered(phi: np.ndarray, error: np.ndarray) -> tuple[bool, bool]:
    """Whether the interval of a least-squares slope holds the truth: by `long_run`, and naively."""
    (slope,), (half,), residual = fitted(phi[:, None], error)
    naive = np.sqrt(np.mean(residual**2) / np.sum(phi**2))
    return bool(abs(slope) < half), bool(abs(slope) < 1.96 * naive)


def fitted(phi: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients of least squares, half widths of their 95 % intervals, the residual."""
    inverse = np.linalg.inv(phi.T @ phi)
    slopes = inverse @ phi.T @ error
    residual = error - phi @ slopes
    covariance, freedom = long_run(phi * residual[:, None], phi[:, None, :], inverse)
    return slopes, student(0.95, freedom) * np.sqrt(np.diagonal(covariance)), residual


@pytest.mark.parametrize("a", [0.0, 0.5, 0.9])
def test_mean_of_ar1_noise_is_covered(a: float):
    rng = np.random.default_rng(0)
    share, naive = np.mean(
        [covered(np.ones(1000), ar1(a, 1000, rng)) for _ in range(TRIALS)], axis=0
    )
    assert abs(share - 0.95) < 3 * SIGMA
    if a == 0.9:  # nineteen times the variance that white noise would have
        assert naive < 0.5


def test_slope_is_covered_where_regressor_and_residual_share_a_resonance():
    """Half of the score's power lies at twice the frequency: the reason for the width 8/3."""
    rng = np.random.default_rng(0)
    shares = [covered(resonant(2000, rng), resonant(2000, rng)) for _ in range(TRIALS)]
    share, naive = np.mean(shares, axis=0)
    # 2000 samples are 40 decay times of 50: what bias the spectrum's bend leaves is below 2 %.
    assert 0.95 - 0.02 - 3 * SIGMA < share < 0.95 + 3 * SIGMA
    assert naive < 0.7


@pytest.mark.parametrize("a", [0.0, 0.9])
def test_regressors_as_slow_as_the_cosines_are_covered(a: float):
    """A transient, and steps through slow lags: the fit takes up to half of what S is made of."""
    t, rng = np.arange(1500), np.random.default_rng(0)
    levels = np.repeat(rng.choice([-1.0, 1.0], 15), 100)
    cases = {
        "transient": [np.exp(-t / 200), np.sin(t / 60) * np.exp(-t / 300), t * np.cos(t / 99)],
        "steps": [lfilter([1], [1, -0.98], levels), lfilter([1], [1, -0.995], levels), 0 * t + 1],
    }  # fmt: skip
    trials = TRIALS // 2
    sigma = np.sqrt(0.95 * 0.05 / trials)
    for columns in cases.values():
        phi = np.stack(columns, axis=1)
        inside = []
        for _ in range(trials):
            slopes, half, _ = fitted(phi, ar1(a, 1500, rng))
            inside.append(np.abs(slopes) < half)
        share = np.mean(inside, axis=0)
        # A transient that is over before the slowest cosine has turned leaves one or two degrees of
        # freedom; the matching of two moments is then on the safe side.
        assert np.all(share > 0.95 - 3.5 * sigma)
        assert np.all(share < 1.0)


def test_what_the_estimate_took_is_given_back():
    """Against the definitions, with matrices over all samples: G, and both moments of ε'(…)ε."""
    t, rng = np.arange(60), np.random.default_rng(0)
    phi = np.stack([np.exp(-t / 20.0), t / 60.0], axis=1)
    inverse = np.linalg.inv(phi.T @ phi)
    half = np.linalg.cholesky(inverse)  # phi @ half is orthonormal
    maker = np.eye(60) - phi @ inverse @ phi.T
    residual = maker @ rng.standard_normal(60)
    scores = phi * residual[:, None]
    count = round(0.4 * (60 / (8 / 3 * correlation_time(scores))) ** (2 / 3))
    cosines = np.cos(np.pi * np.outer(np.arange(1, count + 1), (t + 0.5) / 60))
    own = cosines[:, :, None] * (phi @ half)  # D_j Φ
    values, vectors = np.linalg.eigh(
        2.0 / count * np.einsum("jta,ts,jsb->ab", own, maker, own, optimize=True)
    )
    moved = half @ vectors / np.sqrt(values) @ vectors.T
    sums = np.einsum("jta,t->ja", own, residual)
    covariance, freedom = long_run(scores, phi[:, None, :], inverse)
    want = 2.0 / count * moved @ sums.T @ sums @ moved.T
    np.testing.assert_allclose(covariance, want, rtol=1e-9)
    for i, row in enumerate(moved):
        form = sum(np.outer(one, one) for one in (maker @ each @ row for each in own))
        assert freedom[i] == pytest.approx(np.trace(form) ** 2 / np.sum(form * form), rel=1e-9)


def test_correlation_time_is_that_of_closed_form():
    rng = np.random.default_rng(0)
    for a in (0.0, 0.5, 0.9):
        # Σ a^(2|l|) = (1 + a²)/(1 - a²)
        time = np.mean([correlation_time(ar1(a, 5000, rng)[:, None]) for _ in range(50)])
        assert time == pytest.approx((1 + a**2) / (1 - a**2), rel=0.05)


def test_the_most_correlated_column_counts_and_scale_does_not():
    rng = np.random.default_rng(0)
    slow, fast = ar1(0.95, 3000, rng), ar1(0.0, 3000, rng)
    both = np.stack([slow, 1e6 * fast, np.zeros(3000)], axis=1)
    assert correlation_time(both) == pytest.approx(correlation_time(slow[:, None]), rel=1e-9)


def test_white_scores_give_the_textbook_covariance():
    rng = np.random.default_rng(0)
    phi = rng.standard_normal((20_000, 2)) @ np.asarray([[1.0, 0.6], [0.0, 0.5]])
    inverse = np.linalg.inv(phi.T @ phi)
    scores = phi * rng.standard_normal((20_000, 1))
    covariance, freedom = long_run(scores, phi[:, None, :], inverse)
    # Over a hundred cosines: 1/√(2·100) of each error, three sigma.
    assert np.all(freedom > 100)
    np.testing.assert_allclose(covariance, inverse, rtol=0.4)
    assert np.sqrt(np.diagonal(covariance)) == pytest.approx(np.sqrt(np.diagonal(inverse)), rel=0.2)


def test_scores_of_zero_leave_no_doubt_and_too_few_leave_much():
    covariance, freedom = long_run(np.zeros((100, 2)), np.ones((100, 1, 2)), np.eye(2))
    np.testing.assert_array_equal(covariance, 0.0)
    assert np.all(freedom == np.inf)
    slow = np.cos(np.pi * np.arange(100) / 99.0)[:, None]  # half a period is all there is
    assert np.all(long_run(slow, np.full((100, 1, 1), 0.1), np.eye(1))[1] == pytest.approx(2.0))


def test_what_is_not_estimated_has_no_variance_and_takes_nothing():
    rng = np.random.default_rng(0)
    phi, error = rng.standard_normal((500, 3)), rng.standard_normal(500)
    inverse = np.zeros((3, 3))
    inverse[:2, :2] = np.linalg.inv(phi[:, :2].T @ phi[:, :2])
    got, freedom = long_run(phi * error[:, None], phi[:, None, :], inverse)
    alone = long_run(phi[:, :2] * error[:, None], phi[:, None, :2], inverse[:2, :2])
    np.testing.assert_allclose(got[:2, :2], alone[0], rtol=1e-9)
    np.testing.assert_array_equal(got[2], 0.0)
    np.testing.assert_allclose(freedom, [*alone[1], np.inf], rtol=1e-9)


def test_a_parameter_without_trace_takes_nothing_though_rounding_makes_it_look_estimated():
    rng = np.random.default_rng(0)
    phi, error = rng.standard_normal((500, 3)), rng.standard_normal(500)
    phi[:, 2] = 0.0
    inverse = np.zeros((3, 3))
    inverse[:2, :2] = np.linalg.inv(phi[:, :2].T @ phi[:, :2])
    inverse[2, 2] = 1e-17
    got, _ = long_run(phi * error[:, None], phi[:, None, :], inverse)
    alone = long_run(phi[:, :2] * error[:, None], phi[:, None, :2], inverse[:2, :2])
    np.testing.assert_allclose(got[:2, :2], alone[0], rtol=1e-9)
    np.testing.assert_array_equal(got[2], 0.0)


LENGTHS = (500, 250, 60, 190)


def several_records(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Regressors of records that differ in length, as slow as the cosines, and their errors."""
    columns = [
        np.stack([np.sin(np.arange(n) / (40.0 + 9.0 * i)), np.ones(n)], axis=1)
        for i, n in enumerate(LENGTHS)
    ]
    return np.concatenate(columns), np.concatenate([ar1(0.9, n, rng) for n in LENGTHS])


def test_errors_do_not_depend_on_the_order_of_the_records():
    phi, error = several_records(np.random.default_rng(0))
    inverse = np.linalg.inv(phi.T @ phi)
    residual = error - phi @ (inverse @ phi.T @ error)
    parts = np.split(np.arange(len(phi)), np.cumsum(LENGTHS)[:-1])
    results = []
    for order in ([0, 1, 2, 3], [2, 0, 3, 1], [3, 2, 1, 0]):
        at = np.concatenate([parts[i] for i in order])
        lengths = [LENGTHS[i] for i in order]
        scores = phi[at] * residual[at, None]
        results.append(long_run(scores, phi[at][:, None, :], inverse, lengths))
    for covariance, freedom in results[1:]:
        np.testing.assert_allclose(covariance, results[0][0], rtol=1e-9)
        np.testing.assert_allclose(freedom, results[0][1], rtol=1e-9)


def test_slopes_of_several_records_are_covered_with_more_degrees_of_freedom():
    """The sum of each record's scores is one more thing known, however short the record."""
    rng, inside, freedoms, strung = np.random.default_rng(0), [], [], []
    for _ in range(TRIALS):
        phi, error = several_records(rng)
        inverse = np.linalg.inv(phi.T @ phi)
        slopes = inverse @ phi.T @ error
        scores = phi * (error - phi @ slopes)[:, None]
        covariance, freedom = long_run(scores, phi[:, None, :], inverse, LENGTHS)
        half = student(0.95, freedom) * np.sqrt(np.diagonal(covariance))
        inside.append(np.abs(slopes) < half)
        freedoms.append(freedom)
        strung.append(long_run(scores, phi[:, None, :], inverse)[1])
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) < 3 * SIGMA)
    assert np.all(np.mean(freedoms, axis=0) > np.mean(strung, axis=0))


def test_of_several_records_too_what_the_estimate_took_is_given_back():
    """As of one record; the functions are zero outside their record, and have mean square one."""
    rng, lengths, count = np.random.default_rng(0), (40, 30), 70
    t = np.arange(count)
    phi = np.stack([np.exp(-t / 20.0), t / 60.0], axis=1)
    inverse = np.linalg.inv(phi.T @ phi)
    half = np.linalg.cholesky(inverse)
    maker = np.eye(count) - phi @ inverse @ phi.T
    scores = phi * (maker @ rng.standard_normal(count))[:, None]
    cosines = round(0.4 * (count / (8 / 3 * correlation_time(scores, lengths))) ** (2 / 3))
    functions = []
    for first, length in ((0, 40), (40, 30)):
        number = round(max(cosines, 2) * length / count)
        for j in range(number + 1):
            one = np.zeros(count)
            wave = np.cos(np.pi * j * (np.arange(length) + 0.5) / length)
            one[first : first + length] = (np.sqrt(2.0) if j else 1.0) * wave
            functions.append(one / np.sqrt(number + 1))
    own = np.stack(functions)[:, :, None] * (phi @ half)
    expected = np.einsum("jta,ts,jsb->ab", own, maker, own, optimize=True)
    values, vectors = np.linalg.eigh(expected)
    moved = half @ vectors / np.sqrt(values) @ vectors.T
    sums = np.stack(functions) @ scores @ half
    covariance, freedom = long_run(scores, phi[:, None, :], inverse, lengths)
    np.testing.assert_allclose(covariance, moved @ sums.T @ sums @ moved.T, rtol=1e-9)
    for i, row in enumerate(moved):
        form = sum(np.outer(one, one) for one in (maker @ each @ row for each in own))
        assert freedom[i] == pytest.approx(np.trace(form) ** 2 / np.sum(form * form), rel=1e-9)


def two_outputs(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rows of two parameters that move slowly, and I⁻¹."""
    time = np.linspace(0.0, 1.0, count)
    rows = rng.standard_normal((2, 2)) + np.exp(-3.0 * time)[:, None, None] * np.array(
        [[1.0, -2.0], [0.5, 1.0]]
    )
    flat = rows.reshape(-1, 2)
    return rows, np.linalg.inv(flat.T @ flat)


def test_uncorrelated_residuals_are_all_cosines_and_their_freedom_is_that_of_the_quadratic_form():
    rng = np.random.default_rng(0)
    count = 40
    rows, inverse = two_outputs(count, rng)
    flat = rows.reshape(-1, 2)
    maker = np.eye(2 * count) - flat @ inverse @ flat.T
    error = (maker @ rng.standard_normal(2 * count)).reshape(count, 2)
    scores = np.einsum("tj,tjk->tk", error, rows)
    covariance, freedom = uncorrelated(scores, rows, inverse)

    # The same by definition: residuals maker @ noise, scores of each sample, corrected by G.
    values, vectors = np.linalg.eigh(inverse)
    half = vectors * np.sqrt(values) @ vectors.T
    maps = np.stack([half @ rows[t].T @ maker[2 * t : 2 * t + 2] for t in range(count)])
    expected = np.einsum("tki,tli->kl", maps, maps)
    scaled = np.einsum("tk,tl->kl", scores @ half, scores @ half)
    values, vectors = np.linalg.eigh(expected)
    root = vectors / np.sqrt(values) @ vectors.T
    moved = half @ root
    np.testing.assert_allclose(covariance, moved @ scaled @ moved.T, rtol=1e-9)
    for i in range(2):
        forms = np.einsum("k,tki->ti", moved[i], maps)
        kappa = np.linalg.eigvalsh(forms @ forms.T)
        np.testing.assert_allclose(freedom[i], np.sum(kappa) ** 2 / np.sum(kappa**2), rtol=1e-9)


@pytest.mark.parametrize(("a", "least"), [(0.0, 0.95), (0.3, 0.92)])
def test_few_samples_are_covered_and_white_ones_with_steady_errors(a: float, least: float):
    rng = np.random.default_rng(0)
    flat, inverse = few_rows(rng)
    held, errors = [], []
    for _ in range(TRIALS):
        noise = ar1(a, 62, rng)
        estimate = inverse @ flat.T @ noise
        residual = noise - flat @ estimate
        covariance, freedom = of_estimate(flat, inverse, residual)
        errors.append(np.sqrt(np.diagonal(covariance)))
        held.append(np.abs(estimate) < student(0.95, freedom) * errors[-1])
    assert np.min(np.mean(held, axis=0)) > least - 3 * SIGMA
    scatter = np.std(errors, axis=0) / np.mean(errors, axis=0)
    if a == 0.0:  # of `long_run` alone they scatter by half
        assert np.max(scatter) < 0.4


@pytest.mark.parametrize(("a", "least"), [(0.0, 0.95), (0.5, 0.92)])
def test_below_fifty_samples_white_residuals_give_steady_errors_and_coloured_ones_coverage(
    a: float, least: float
):
    """Without a test of so few, scatter over median error is 1.4; as if white, 75 % are covered."""
    rng = np.random.default_rng(0)
    time = np.linspace(0.0, 1.0, 25)
    flat = np.stack([np.exp(-3.0 * time), time * np.exp(-3.0 * time)], axis=1)
    inverse = np.linalg.inv(flat.T @ flat)
    held, errors, estimates = [], [], []
    for _ in range(TRIALS):
        noise = ar1(a, 25, rng)
        estimates.append(inverse @ flat.T @ noise)
        covariance, freedom = of_estimate(flat, inverse, noise - flat @ estimates[-1])
        errors.append(np.sqrt(np.diagonal(covariance)))
        held.append(np.abs(estimates[-1]) < student(0.95, freedom) * errors[-1])
    assert np.min(np.mean(held, axis=0)) > least - 3 * SIGMA
    if a == 0.0:
        assert np.max(np.std(estimates, axis=0) / np.median(errors, axis=0)) < 1.2


def few_rows(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """62 rows of two parameters that decay and rise, and I⁻¹."""
    rows = two_outputs(31, rng)[0][:, 0]
    flat = np.concatenate([rows, rows[::-1]])
    return flat, np.linalg.inv(flat.T @ flat)


def of_estimate(
    flat: np.ndarray, inverse: np.ndarray, residual: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    scores = residual[:, None] * flat
    return covariance_of_estimate(
        scores, flat[:, None], inverse, [len(flat)], [residual], len(inverse)
    )


def is_robust(flat: np.ndarray, inverse: np.ndarray, residual: np.ndarray) -> bool:
    """Whether the answer is that of `long_run`."""
    robust = long_run(residual[:, None] * flat, flat[:, None], inverse)
    return np.allclose(of_estimate(flat, inverse, residual)[0], robust[0])


def test_noise_that_is_far_from_white_is_not_taken_for_white():
    rng = np.random.default_rng(0)
    flat, inverse = few_rows(rng)
    for _ in range(50):
        noise = ar1(0.9, 62, rng)
        assert is_robust(flat, inverse, noise - flat @ (inverse @ flat.T @ noise))


def test_a_slow_rest_below_what_a_portmanteau_test_sees_is_not_taken_for_white():
    rng = np.random.default_rng(0)
    flat, inverse = np.ones((1500, 1)), np.array([[1.0 / 1500]])
    slow, tests = 0.2 * np.cos(np.pi * np.arange(1500) / 300), []
    for _ in range(20):
        residual = rng.standard_normal(1500) + slow
        residual -= np.mean(residual)
        tests.append(ljung_box([residual])[1])
        assert is_robust(flat, inverse, residual)
    assert np.max(tests) > 0.2
