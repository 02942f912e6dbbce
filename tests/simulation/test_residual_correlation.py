"""Correlation of residuals: where they follow an input, and how often noise exceeds the bounds."""

import numpy as np
import pytest

from eoi_jax.simulation.residual_correlation import autocorrelation, cross_correlation

RNG = np.random.default_rng(3)


def coloured(count: int, pole: float) -> np.ndarray:
    """AR(1) noise, whose autocorrelation is pole^k."""
    noise, values = RNG.standard_normal(count + 200), [0.0]
    for one in noise:
        values.append(pole * values[-1] + one)
    return np.array(values[-count:])


def test_the_autocorrelation_is_that_of_the_definition_without_the_unknown_samples():
    e = coloured(300, 0.8)
    e[40:60] = np.nan
    found = autocorrelation(e, 20)
    centred = np.where(np.isnan(e), 0.0, e - np.nanmean(e))
    wanted = [np.sum(centred[k:] * centred[:-k]) / np.sum(centred**2) for k in range(1, 21)]
    np.testing.assert_array_equal(found.lags, np.arange(1, 21))
    np.testing.assert_allclose(found.values, wanted, atol=1e-12)
    assert found.bound == pytest.approx(2.5758 / np.sqrt(280), rel=1e-4)


def test_coloured_noise_has_the_autocorrelation_of_its_filter():
    found = autocorrelation(coloured(40_000, 0.9), 10)
    np.testing.assert_allclose(found.values, 0.9 ** np.arange(1, 11), atol=0.03)


def test_white_noise_exceeds_the_bound_as_rarely_as_the_level_says():
    exceeded = [
        np.abs(found.values) > found.bound
        for found in (autocorrelation(RNG.standard_normal(2000), 40, 0.9) for _ in range(100))
    ]
    assert np.mean(exceeded) == pytest.approx(0.1, abs=0.02)  # of 4000: ± 4 standard errors


def test_coloured_noise_beside_a_coloured_input_exceeds_the_bound_as_rarely():
    """The bound ± z/√N of white noise would be exceeded in more than half of the lags."""
    exceeded = []
    for _ in range(200):
        found = cross_correlation(coloured(2000, 0.95), coloured(2000, 0.95), 5, 0.9)
        exceeded.append(np.abs(found.values) > found.bound)
        assert found.bound > 3 * 1.645 / np.sqrt(2000)
    assert np.mean(exceeded) == pytest.approx(0.1, abs=0.06)  # lags of one record go together


@pytest.mark.parametrize("lag", [-7, 0, 12])
def test_a_residual_that_follows_the_input_stands_out_at_its_lag(lag):
    u = RNG.standard_normal(3000)
    e = np.roll(u, lag) + 0.5 * RNG.standard_normal(3000)
    u[100:200] = np.nan
    found = cross_correlation(e, u, 20)
    assert found.lags[np.argmax(found.values)] == lag
    assert np.max(found.values) == pytest.approx(1 / np.sqrt(1.25), abs=0.05)  # the gap takes pairs
    others = np.abs(found.values[found.lags != lag])
    assert np.mean(others > found.bound) < 0.1
    assert found.bound < 0.06


def test_signals_that_say_nothing_have_no_correlation():
    assert np.all(np.isnan(autocorrelation(np.full(100, np.nan), 5).values))
    assert np.all(np.isnan(cross_correlation(RNG.standard_normal(100), np.ones(100), 5).values))


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda e: autocorrelation(e, 100), "`lags` must be less than 100 samples, got 100"),
        (lambda e: autocorrelation(e, 0), "`lags` must be an integer ≥ 1, got 0"),
        (lambda e: autocorrelation(e, 5, 1.0), r"`level` must lie in \(0, 1\), got 1.0"),
        (lambda e: cross_correlation(e, e[1:], 5), "`input` must have the length of the residual"),
    ],
)
def test_wrong_calls_say_what_is_wrong(call, said):
    with pytest.raises(ValueError, match=said):
        call(np.arange(100.0))
