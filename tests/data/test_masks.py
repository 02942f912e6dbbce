"""Which samples count: valid ones behind the transient, and the steps between them."""

import numpy as np
import pytest

from eoi_jax.data.masks import (
    beyond_starts,
    consecutive,
    direction_of_motion,
    longest_run,
    moving,
    scored_samples,
    transient_samples,
    valid_steps,
)
from eoi_jax.data.record import Record

H = 0.1


def record_of(missing=(), burn_in=0.0):
    y = np.sin(np.arange(20.0))
    y[list(missing)] = np.nan
    if not len(missing):
        return Record.from_period(H, np.zeros(20), y, burn_in=burn_in)
    with pytest.warns(UserWarning, match="not finite"):
        return Record.from_period(H, np.zeros(20), y, burn_in=burn_in)


@pytest.mark.parametrize(("transient", "count"), [(0.0, 5), (0.3, 5), (0.72, 7), (9.0, 90)])
def test_longer_of_method_and_record_is_the_transient(transient, count):
    assert transient_samples(record_of(burn_in=0.5), transient) == count


def test_scored_samples_are_valid_and_behind_the_transient():
    record = record_of(missing=(8, 9, 10), burn_in=0.3)
    np.testing.assert_array_equal(np.flatnonzero(~scored_samples(record)), [0, 1, 2, 8, 9, 10])
    np.testing.assert_array_equal(np.flatnonzero(~scored_samples(record, 1)), [0, 8, 9, 10])
    assert record.valid[0]  # the record itself is as it was


def test_steps_at_a_missing_sample_are_not_valid():
    np.testing.assert_array_equal(np.flatnonzero(~valid_steps(record_of(missing=(8,)))), [7, 8])
    assert longest_run(record_of(missing=(8,))) == (9, 20)


def test_consecutive_asks_for_the_steps_before():
    good = np.array([1, 1, 1, 0, 1, 1, 1, 1], bool)[:, None]
    want = np.array([1, 1, 1, 0, 0, 0, 1, 1], bool)[:, None]
    np.testing.assert_array_equal(consecutive(good, 3), want)


def test_steps_beyond_each_start():
    starts = np.array([1, 0, 0, 0, 1, 0, 0], bool)
    np.testing.assert_array_equal(beyond_starts(starts, 2), np.array([0, 0, 1, 1, 0, 0, 1], bool))


def test_motion_is_certain_beyond_its_noise_and_away_from_reversals():
    """A position of noise 0.1, and a speed of noise 0.5."""
    y = np.array([[0.0, 9.0], [1.0, 9.0], [2.0, 9.0], [2.01, 1.0], [1.0, 1.0], [0.0, 1.0]])
    noise = np.array([0.1 * np.sqrt(2.0) / H, 0.5])
    direction = direction_of_motion((2, 1), y[:-1], y[1:], H, noise)
    np.testing.assert_array_equal(direction.T, [[1, 1, 0, -1, -1], [1, 1, 1, 0, 0]])
    want = [[True, False, False, False, True], [True, True, False, False, False]]
    np.testing.assert_array_equal(moving((2, 1), y, H, noise).T, want)
