"""A sensor that froze is told from what rests, stops at a limit or is coarse."""

import numpy as np
import pytest

from eoi_jax.data.inspection import inspect
from eoi_jax.data.standstill import standstill_notes

N = 800
K = np.arange(N)
NOISY = np.round(20.0 + np.sin(0.02 * K) + 0.1 * np.random.default_rng(1).standard_normal(N), 2)


def frozen(values, start=300, stop=420):
    return np.where((start <= K) & (stop > K), values[start], values)


def test_a_channel_that_stands_still_once_is_told_with_its_rows(tmp_path):
    values = frozen(NOISY)
    values[100:105] = np.nan
    (note,) = standstill_notes("T", values)
    assert "from row 300 to 419" in note
    path = tmp_path / "run.csv"
    rows = "".join(f"{k},{k // 50 % 2},{y}\n" for k, y in zip(K, frozen(NOISY), strict=True))
    path.write_text("t,u,T\n" + rows)
    assert note in inspect(path).advice


SWING = 100.0 * np.exp(-0.01 * K) * np.cos(0.2 * K)  # of an encoder, which comes to rest
STEPS = 50.0 * np.round(np.sin(0.01 * K)) + 2.0 * np.sin(0.02 * K)
QUIET = {
    "noise alone": NOISY,
    "a short one": frozen(NOISY, 300, 320),
    "two, as of a drive that goes from place to place": frozen(frozen(NOISY), 500, 600),
    "at a limit": np.minimum(NOISY, np.sort(NOISY)[-200]),
    "at zero": np.where((K >= 300) & (K < 420), 0.0, NOISY - 20.0),
    "a start at rest": frozen(NOISY, 0, 120),
    "an end at rest": frozen(NOISY, 680, N),
    "an encoder that comes to rest": np.round(SWING),
    "a coarse sensor": np.round(STEPS),
    "a held input": np.repeat(np.arange(8.0), 100),
    "slow and coarse": np.round(NOISY, 0),
    "empty": np.full(N, np.nan),
    "constant": np.ones(N),
    "numbers that are close to rest": np.round(20 * np.tanh(0.02 * (K - 300)) ** 3),
}


@pytest.mark.parametrize("values", QUIET.values(), ids=QUIET)
def test_what_rests_is_not_told(values):
    assert not standstill_notes("T", values)
