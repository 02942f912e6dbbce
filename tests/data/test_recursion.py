"""Linear recursions as banded systems, beside the loop and SciPy's filters."""

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from eoi_jax.data.recursion import states
from eoi_jax.data.resampling import low_pass

DRAW = np.random.default_rng(0)


@pytest.mark.parametrize("order", [1, 2, 3])
def test_states_are_those_of_the_loop(order):
    transition = 0.4 * DRAW.normal(size=(order, order))
    entry, inputs = DRAW.normal(size=order), DRAW.normal(size=(40, 2))
    x = start = DRAW.normal(size=(order, 2))
    for found, u in zip(states(transition, entry, inputs, start), inputs, strict=True):
        x = transition @ x + entry[:, None] * u
        np.testing.assert_allclose(found, x, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("samples", [2, 5, 3000])
@pytest.mark.parametrize("cutoff", [0.02, 0.3, 0.9])
def test_the_low_pass_is_that_of_scipy(samples, cutoff):
    values = 5.0 + np.cumsum(DRAW.normal(size=(samples, 2)), axis=0)
    pad = min(int(np.ceil(4 / cutoff)) + 15, samples - 1)
    wanted = sosfiltfilt(butter(4, cutoff, output="sos"), values, axis=0, padlen=pad)
    # Rounding is of the size of the whole signal, and more the lower the cut-off.
    size = np.max(np.abs(values))
    np.testing.assert_allclose(low_pass(values, cutoff), wanted, rtol=0, atol=1e-12 * size)


def test_without_columns_there_is_nothing_to_solve():
    found = states(np.eye(2), np.ones(2), np.zeros((40, 0)))
    assert found.shape == (40, 2, 0)
