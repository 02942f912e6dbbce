import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eoi_jax.data.resampling import (
    fill,
    hold_inputs,
    low_pass,
    low_pass_noise,
    runs,
    spline,
    staircase_to_smooth,
    uniform_grid,
)


def test_stamps_of_a_rounded_clock_are_on_the_grid():
    stamps = np.round(np.arange(5000) / 610.35, 4)  # 6 % of a period of rounding
    grid = uniform_grid(stamps)
    assert grid.index is not None
    np.testing.assert_array_equal(grid.index, np.arange(5000))
    assert grid.sample_period == pytest.approx(1 / 610.35, rel=1e-6)
    assert grid.resolution == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("rate", "digit"), [(25_600.0, 1e-5), (300.0, 1e-3), (1 / 1.7e-3, 1e-3), (1 / 1.3e-3, 1e-3)]
)
@pytest.mark.parametrize("rounding", [np.round, np.floor], ids=["rounded", "cut off"])
def test_digits_as_coarse_as_the_period_are_no_jitter(rate, digit, rounding):
    stamps = digit * rounding(np.arange(5000) / rate / digit + 1e-9)
    grid = uniform_grid(stamps)
    np.testing.assert_array_equal(grid.index, np.arange(5000))
    assert grid.sample_period == pytest.approx(1 / rate, rel=1e-5)
    assert grid.resolution == pytest.approx(digit)


@pytest.mark.parametrize("jitter", [1, 2])
def test_whole_digits_of_jitter_are_no_rounding(jitter):
    draw = np.random.default_rng(2)
    moved = 10 * np.arange(3000) + draw.integers(-jitter, jitter + 1, 3000)
    assert uniform_grid(1e-3 * moved).index is None


def test_a_period_with_hidden_digits_does_not_drift():
    # The median of the spacings is 33 or 34 ms; after 3000 samples it would be 1000 ms off.
    stamps = np.round(np.arange(3000) / 30, 3)
    grid = uniform_grid(stamps)
    assert np.max(np.abs(grid.time - np.arange(3000) / 30)) < 1e-4


def test_missing_stamps_leave_holes_and_move_nothing():
    index = np.delete(np.arange(1000), [3, 4, 500])
    grid = uniform_grid(0.25 + 0.01 * index)
    assert grid.index is not None
    np.testing.assert_array_equal(grid.index, index)
    assert grid.sample_period == 0.01
    assert len(grid.time) == 1000


def test_jitter_beyond_the_clock_s_digits_asks_for_interpolation():
    rng = np.random.default_rng(0)
    stamps = np.cumsum(rng.integers(7, 14, 2000)) * 1e-3  # 10 ms nominal, whole milliseconds
    assert uniform_grid(stamps).index is None


@pytest.mark.parametrize("scale", [1e-3, 1.0, 250.0])
def test_a_grid_between_stamps_ends_within_a_period_of_the_last_one(scale):
    """Whatever the unit of time: jitter about a line, and spacings that follow no line."""
    draw = np.random.default_rng(1)
    for spacing in (draw.uniform(0.7, 1.3, 500), draw.uniform(0.5, 2.0, 500)):
        stamps = scale * (3.0 + np.cumsum(spacing))
        grid = uniform_grid(stamps)
        assert grid.index is None
        np.testing.assert_allclose(np.diff(grid.time), grid.sample_period, rtol=1e-9)
        assert stamps[0] <= grid.time[0] < stamps[0] + grid.sample_period
        rest = (stamps[-1] - grid.time[-1]) / grid.sample_period
        assert -1e-6 < rest < 1.0 + 1e-6


def test_jitter_just_below_the_tolerance_is_no_jitter():
    rng = np.random.default_rng(0)
    noise = rng.uniform(-1, 1, 1000)
    assert uniform_grid(1e-3 * (np.arange(1000) + 0.9e-3 * noise)).index is not None
    assert uniform_grid(1e-3 * (np.arange(1000) + 1.5e-3 * noise)).index is None


def test_a_long_pause_is_an_error_that_asks_to_split():
    stamps = np.concatenate([np.arange(100), 1e6 + np.arange(100)]) * 1e-3
    with pytest.raises(ValueError, match=r"`time` must be sampled regularly.*Split the record"):
        uniform_grid(stamps)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 60.0])
def test_stamps_without_a_usual_spacing_are_all_on_a_finer_grid(scale):
    """Blood samples: often at first, seldom later. Their median spacing would lose half of them."""
    hours = np.array([0, 0.08, 0.25, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24])
    grid = uniform_grid(scale * hours)
    assert grid.scattered
    assert grid.index is not None
    assert grid.sample_period == pytest.approx(0.01 * scale)
    np.testing.assert_allclose(grid.time[grid.index], scale * hours, atol=1e-9 * scale)


def test_scattered_stamps_in_multiples_of_more_than_a_digit_have_a_coarse_grid():
    grid = uniform_grid(np.array([0.0, 15, 30, 45, 90, 180, 240, 480, 960, 1440]))
    assert (grid.scattered, grid.sample_period) == (True, 15.0)


def test_scattered_stamps_of_many_digits_are_rounded_to_a_part_of_their_smallest_spacing():
    """A thermometer that is read off: half of the samples would be lost at their median spacing."""
    hours = np.array([0, 0.172064, 0.383619, 0.490808, 0.992902, 1.32293, 1.830666, 2.702279,
                      4.107021, 8.087124, 8.293041, 9.999605]) * np.pi  # fmt: skip
    grid = uniform_grid(hours)
    assert grid.scattered
    assert grid.index is not None
    moved = np.abs(grid.time[grid.index] - hours)
    assert moved.max() <= 0.0201 * np.diff(hours).min()
    assert grid.deviation == pytest.approx(moved.max() / grid.sample_period)


BY_HAND = np.array([0, 14, 31, 60, 89, 122, 181, 239, 361, 484, 485, 512, 542, 603, 719, 963, 1441])


@pytest.mark.parametrize(
    ("parts", "first", "digits"),
    [(60, 0.0, 17), (60, 0.0, 4), (60, 8.25, 3), (1440, 0.0, 17), (1440, 3.1, 17), (1440, 3.1, 5)],
)
def test_minutes_counted_in_hours_or_days_are_a_grid(parts, first, digits):
    grid = uniform_grid(np.round(first + BY_HAND / parts, digits))
    assert grid.scattered
    np.testing.assert_array_equal(grid.index, BY_HAND)
    assert grid.sample_period == pytest.approx(1.0 / parts)
    assert grid.deviation < 0.15


def test_stamps_that_need_too_many_points_are_rounded_up_to_a_quarter_of_their_smallest_spacing():
    stamps = np.sort(np.append(60.0 * BY_HAND, 512.0 * 60.0 + 11.0))  # to the second, over a day
    grid = uniform_grid(stamps)
    assert grid.scattered
    assert len(grid.time) <= 20_000
    moved = np.abs(grid.time[grid.index] - stamps)
    assert moved.max() <= 0.25 * 11.0
    assert not uniform_grid(np.sort(np.append(60.0 * BY_HAND, 30721.0))).scattered


@pytest.mark.parametrize("month", [1, 3])
def test_months_are_points_of_a_grid_of_days(month):
    dates = np.arange("1958-01", "2024-01", month, dtype="datetime64[M]").astype("datetime64[D]")
    days = (dates - dates[0]).astype(float)
    grid = uniform_grid(86400.0 * (days + 0.5))
    assert (grid.sample_period, grid.scattered) == (86400.0, True)
    np.testing.assert_array_equal(grid.index, days)


def test_years_are_a_uniform_clock_to_their_rounding_to_days():
    dates = np.arange("1950", "2050", dtype="datetime64[Y]").astype("datetime64[D]")
    grid = uniform_grid(86400.0 * (dates - dates[0]).astype(float))
    np.testing.assert_array_equal(grid.index, np.arange(100))
    assert grid.resolution == pytest.approx(86400.0)


def test_scattered_stamps_that_would_need_too_fine_a_grid_have_none():
    draw = np.random.default_rng(0)
    stamps = np.cumsum(draw.exponential(1.0, 200))
    assert not uniform_grid(stamps).scattered


def test_the_grid_of_a_regular_clock_has_the_period_that_was_meant():
    assert uniform_grid(np.arange(24841) * 0.001).sample_period == 0.001
    assert uniform_grid(1e5 + np.arange(24841) * 0.001).sample_period == pytest.approx(1e-3)


@given(
    seed=st.integers(0, 10_000),
    jitter=st.floats(0.0, 0.45),
    count=st.integers(8, 60),
    degree=st.sampled_from([1, 3, 5]),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_splines_reproduce_polynomials_of_their_degree(seed, jitter, count, degree):
    rng = np.random.default_rng(seed)
    position = np.arange(count) + jitter * rng.uniform(-1, 1, count)
    coefficients = rng.uniform(-1, 1, degree + 1)
    query = np.linspace(position[0], position[-1], 200)
    found = spline(
        position, np.polyval(coefficients, position / count)[:, None], [(0, count)], query, degree
    )
    # Not-a-knot ends at the worst jitter amplify rounding by some thousands.
    np.testing.assert_allclose(found[:, 0], np.polyval(coefficients, query / count), atol=1e-10)


def test_a_spline_does_not_look_across_a_gap():
    position = np.arange(40.0)
    values = np.where(position < 20, 0.0, 100.0)[:, None]
    segments = [(0, 20), (20, 40)]
    query = np.arange(0, 39.01, 0.25)
    found = spline(position, values, segments, query, 5)[:, 0]
    outside = (query <= 19) | (query >= 20)
    np.testing.assert_allclose(found[outside], np.where(query < 19.5, 0.0, 100.0)[outside])
    np.testing.assert_allclose(found[~outside], 100 * (query[~outside] - 19))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 6])
def test_short_segments_keep_their_samples(count):
    position = np.arange(8.0)
    values = np.random.default_rng(0).normal(size=(8, 2))
    found = spline(position, values, [(0, count)], position, 5)
    np.testing.assert_allclose(found, values, atol=1e-12)


def test_runs_are_the_stretches_of_true():
    good = np.array([True, True, False, True, False, False, True, True])
    assert runs(good) == [(0, 2), (3, 4), (6, 8)]
    joined = np.array([False, True, True, True, True, True, True])
    assert runs(good, joined) == [(0, 1), (1, 2), (3, 4), (6, 8)]
    assert runs(np.zeros(4, dtype=bool)) == []


def test_fill_goes_straight_across_what_is_not_finite():
    values = np.array([[0.0, np.nan], [np.nan, np.inf], [2.0, 5.0], [3.0, np.nan]])
    filled = fill(np.arange(4.0), values, np.arange(4.0))
    np.testing.assert_allclose(filled, [[0, 5], [1, 5], [2, 5], [3, 5]])


def test_holds_differ_between_samples_and_agree_on_them():
    position, u = np.arange(30.0), np.sin(0.3 * np.arange(30.0))[:, None]
    query = np.arange(0, 29.01, 0.5)
    found = {
        h: hold_inputs(position, u, [(0, 30)], query, h)[:, 0] for h in ("zero", "linear", "smooth")
    }
    for values in found.values():
        np.testing.assert_allclose(values[::2], u[:, 0], atol=1e-12)
    np.testing.assert_array_equal(found["zero"][1::2], u[:-1, 0])
    np.testing.assert_allclose(found["linear"][1::2], 0.5 * (u[1:, 0] + u[:-1, 0]))
    np.testing.assert_allclose(found["smooth"], np.sin(0.3 * query), atol=2e-5)


def test_an_unknown_hold_is_named():
    u = np.zeros((9, 1))
    with pytest.raises(ValueError, match="`hold` must be one of zero, linear, smooth, got 'foh'"):
        hold_inputs(np.arange(9.0), u, [(0, 9)], np.arange(9.0), "foh")


def test_the_slow_part_of_a_staircase_lags_by_half_a_sample():
    # Response of a held sine at its own frequency: e^{-jθ/2} sin(θ/2)/(θ/2).
    theta = 0.3
    k = np.arange(200)
    smooth = staircase_to_smooth(np.sin(theta * k)[:, None])[:, 0]
    expected = np.sin(theta / 2) / (theta / 2) * np.sin(theta * (k - 0.5))
    # Sixth-order spline: θ⁶/30240 of 1, and the ends are left out.
    np.testing.assert_allclose(smooth[20:-20], expected[20:-20], atol=1e-6)
    np.testing.assert_allclose(staircase_to_smooth(np.full((20, 2), 3.0)), 3.0)
    assert staircase_to_smooth(np.zeros((20, 0))).shape == (20, 0)


def test_the_low_pass_has_no_phase_and_half_amplitude_at_cut_off():
    k = np.arange(4000.0)
    filtered = low_pass(np.cos(0.1 * np.pi * k)[:, None], 0.1)[:, 0]
    middle = slice(500, -500)
    expected = 0.5 * np.cos(0.1 * np.pi * k)
    np.testing.assert_allclose(filtered[middle], expected[middle], atol=1e-6)


def test_the_low_pass_leaves_the_noise_that_is_announced():
    noise = np.random.default_rng(0).normal(size=(200_000, 1))
    # 200 000 samples hold about 20 000 independent ones after the filter: 0.5 % of their rms.
    assert low_pass(noise, 0.1).std() == pytest.approx(low_pass_noise(0.1), rel=0.02)


def test_short_segments_pass_the_filter():
    for count in (1, 2, 5):
        assert low_pass(np.ones((count, 1)), 0.01) == pytest.approx(1.0)


def test_a_grid_on_the_stamps_begins_at_the_first():
    """Whole microseconds, cut off: the line through them begins a little off zero."""
    stamps = 1e-6 * (0.02 * np.arange(1500) * 1e6).astype(int)
    assert np.any(np.diff(stamps) != np.diff(stamps)[0])
    grid = uniform_grid(stamps)
    assert grid.index is not None
    assert grid.time[0] == 0.0
