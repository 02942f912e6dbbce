import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from eoi_jax.data.resampling import inputs_within_steps
from eoi_jax.data.uniform_spline import within_steps

FRACTIONS = np.linspace(0.0, 1.0, 9)


@pytest.mark.parametrize("degree", [1, 3, 5])
@pytest.mark.parametrize("count", [2, 3, 4, 6, 9, 13, 14, 15, 16, 20, 300])
def test_shared_weights_are_those_of_the_spline_itself(count, degree):
    samples = np.random.default_rng(count).standard_normal((count, 2))
    allowed = max(k for k in (1, 3, 5) if k <= min(degree, count - 1))
    spline = make_interp_spline(np.arange(count), samples, k=allowed)
    expected = spline(np.arange(count - 1)[:, None] + FRACTIONS)
    found = within_steps(samples, FRACTIONS, degree)
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.max(np.abs(expected)))


def test_polynomials_come_back():
    grid = np.arange(40.0)
    samples = np.polyval([1e-4, -3e-3, 0.02, 1.0, -2.0, 0.5], grid)[:, None]
    places = grid[:-1, None] + FRACTIONS
    expected = np.polyval([1e-4, -3e-3, 0.02, 1.0, -2.0, 0.5], places)
    found = within_steps(samples, FRACTIONS, 5)[..., 0]
    np.testing.assert_allclose(found, expected, rtol=1e-9)


@pytest.mark.parametrize("hold", ["zero", "linear", "smooth"])
def test_the_end_of_a_step_is_still_part_of_it(hold):
    inputs = np.array([[1.0], [3.0], [2.0], [5.0], [0.0], [1.0], [1.0], [4.0], [2.0]])
    found = inputs_within_steps(inputs, np.array([0.0, 1.0]), hold)
    np.testing.assert_allclose(found[:, 0], inputs[:-1], atol=1e-12)
    np.testing.assert_allclose(found[:, 1], inputs[:-1] if hold == "zero" else inputs[1:],
                               atol=1e-12)  # fmt: skip
