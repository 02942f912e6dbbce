import numpy as np
import pytest

from eoi_jax.data import excitation

TIME = 5.0 + 1e-3 * np.arange(10_000)


def test_square_waves_have_their_period_duty_and_levels():
    u = excitation.square(TIME, 2, 0.5, offset=1.0, duty=0.25)
    assert set(np.unique(u)) == {-1.0, 3.0}
    assert np.mean(u == 3.0) == 0.25
    np.testing.assert_array_equal(u[:2000], u[2000:4000])
    assert np.flatnonzero(np.diff(u))[0] == 499  # up for 500 samples, by rounding not for 499


def test_prbs_switches_only_on_its_clock_and_repeats_with_its_seed():
    u = excitation.prbs(TIME, 0.7, 0.05, seed=3)
    assert u.dtype == np.float64
    assert set(np.unique(u)) == {-0.7, 0.7}
    switches = np.flatnonzero(np.diff(u)) + 1
    assert np.all(switches % 50 == 0)
    assert len(switches) > 50  # of 199 chances
    np.testing.assert_array_equal(u, excitation.prbs(TIME, 0.7, 0.05, seed=3))
    assert np.any(u != excitation.prbs(TIME, 0.7, 0.05, seed=4))


def test_chirps_sweep_from_start_to_stop():
    u = excitation.chirp(TIME, 1.5, 0.5, 10.0)
    assert np.max(np.abs(u)) == pytest.approx(1.5, rel=1e-3)
    crossings = np.flatnonzero(np.diff(np.sign(u[1:])))
    # The phase is the mean frequency times the duration: 5.25 Hz × 10 s, two crossings a turn.
    assert len(crossings) == pytest.approx(2 * 5.25 * 10, abs=1)
    assert crossings[1] - crossings[0] > 5 * (crossings[-1] - crossings[-2])


def test_multisines_have_their_rms_and_stay_in_their_band():
    u = excitation.multisine(TIME, 0.3, (1.0, 5.0), 9, seed=0)
    assert np.sqrt(np.mean(u**2)) == pytest.approx(0.3, rel=1e-9)
    size = np.abs(np.fft.rfft(u)) / len(u) * 2
    lines = np.flatnonzero(size > 1e-9)
    np.testing.assert_array_equal(lines, np.arange(10, 51, 5))
    np.testing.assert_allclose(size[lines], 0.3 * np.sqrt(2 / 9))
    np.testing.assert_array_equal(u, excitation.multisine(TIME, 0.3, (1.0, 5.0), 9, seed=0))


def test_steps_hold_each_level_and_keep_the_last():
    u = excitation.steps(TIME, [0, 2, -1], 0.3)
    np.testing.assert_array_equal(u[:300], 0.0)
    np.testing.assert_array_equal(u[300:600], 2.0)
    np.testing.assert_array_equal(u[600:], -1.0)


def test_random_steps_stay_in_their_range():
    u = excitation.random_steps(TIME, -1, 3, 0.25, seed=1)
    assert np.all((u >= -1) & (u <= 3))
    assert len(np.unique(u)) == 40
    assert np.all((np.flatnonzero(np.diff(u)) + 1) % 250 == 0)
    np.testing.assert_array_equal(u, excitation.random_steps(TIME, -1, 3, 0.25, seed=1))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: excitation.square([0.0], 1, 1), "`time` must have shape"),
        (lambda: excitation.square([0.0, 1.0, 0.5], 1, 1), "`time` must be finite and increasing"),
        (lambda: excitation.square([0.0, np.nan], 1, 1), "`time` must be finite and increasing"),
        (lambda: excitation.square(TIME, np.nan, 1), "`amplitude` must be finite, got nan"),
        (lambda: excitation.square(TIME, 1, 0), "`frequency` must be positive and finite, got 0"),
        (lambda: excitation.square(TIME, 1, 1, offset=np.inf), "`offset` must be finite"),
        (lambda: excitation.square(TIME, 1, 1, duty=1.0), r"`duty` must lie in \(0, 1\), got 1.0"),
        (lambda: excitation.prbs(TIME, 1, -0.1, 0), "`switching_period` must be positive"),
        (lambda: excitation.prbs(TIME, 1, 0.1, -1), "`seed` must be an integer ≥ 0, got -1"),
        (lambda: excitation.chirp(TIME, 1, 0, 5), "`start` must be positive"),
        (lambda: excitation.chirp(TIME, 1, 1, np.inf), "`stop` must be positive and finite"),
        (lambda: excitation.multisine(TIME, 1, (1, 600), 5, 0), "`frequencies` must be .* 500 Hz"),
        (lambda: excitation.multisine(TIME, 1, (5, 1), 5, 0), "`frequencies` must be"),
        (lambda: excitation.multisine(TIME, 1, (1, 5), 0, 0), "`components` must be an integer"),
        (lambda: excitation.multisine(TIME, 1, (1, 2), 50, 0), "`components` must fit .* 0.1 Hz"),
        (lambda: excitation.multisine(TIME, 1, (1, 2), 50, 0), "got 50. Take 11, a wider band or"),
        (
            lambda: excitation.multisine(TIME, 1, (0.02, 3), 3, 0),
            r"`frequencies` must begin at 1/duration, 0.1 Hz, or above, got \(0.02, 3.0\). A lower",
        ),
        (lambda: excitation.steps(TIME, [], 1), "`levels` must be a list of finite numbers"),
        (lambda: excitation.steps(TIME, [1, np.nan], 1), "`levels` must be a list of finite"),
        (lambda: excitation.steps(TIME, [1], 0), "`holding_time` must be positive"),
        (lambda: excitation.random_steps(TIME, 2, 1, 1, 0), "`low` must be below `high` = 1"),
    ],
)
def test_arguments_out_of_range_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()
