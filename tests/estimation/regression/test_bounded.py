"""Least squares within bounds, against an active-set method of another library."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from eoi_jax.estimation.regression.bounded import bounded, leaves_bounds

LANES, SIZE = 200, 5


def normal(matrices, targets):
    information = np.einsum("lra,lrb->lab", matrices, matrices)
    return information, np.einsum("lra,lr->la", matrices, targets)


def solver(information):
    """Least squares of each lane in the directions that its free parameters leave a trace in."""

    def solve(rhs, inside):
        masks = inside[:, :, None] & inside[:, None, :]
        parts = np.where(masks, information, 0.0)
        return np.einsum("lab,lb->la", np.linalg.pinv(parts, hermitian=True), rhs * inside)

    return solve


def test_it_agrees_with_bounded_variable_least_squares():
    """Of columns that go together what is put on a bound first must often leave it again."""
    random = np.random.default_rng(3)
    mixed = np.eye(SIZE) + 0.6 * random.standard_normal((LANES, SIZE, SIZE))
    matrices = random.standard_normal((LANES, 12, SIZE)) @ mixed
    targets = 3.0 * random.standard_normal((LANES, 12))
    low, high = -random.uniform(0.0, 0.5, (LANES, SIZE)), random.uniform(0.0, 0.5, (LANES, SIZE))
    high[:, 0] = np.inf
    information, rhs = normal(matrices, targets)
    solve = solver(information)
    free = solve(rhs, np.ones((LANES, SIZE), bool))
    assert leaves_bounds(free, (low, high))
    found, side = bounded(solve, information, rhs, free, (low, high))
    pairs = zip(matrices, targets, low, high, strict=True)
    known = [lsq_linear(a, b, (lo, hi), method="bvls", tol=1e-14) for a, b, lo, hi in pairs]
    np.testing.assert_allclose(found, [one.x for one in known], atol=1e-9)
    np.testing.assert_array_equal(side, [one.active_mask for one in known])


def test_lanes_that_bounds_leave_alone_keep_their_solution():
    random = np.random.default_rng(4)
    information, rhs = normal(random.standard_normal((2, 9, 2)), random.standard_normal((2, 9)))
    solve = solver(information)
    free = solve(rhs, np.ones((2, 2), bool))
    high = np.array([free[0] + 1.0, free[1] - [0.1, -1.0]])
    found, side = bounded(solve, information, rhs, free, (np.full((2, 2), -np.inf), high))
    np.testing.assert_allclose(found[0], free[0], rtol=1e-12)
    np.testing.assert_array_equal(side, [[0, 0], [1, 0]])
    assert found[1, 0] == high[1, 0]


@pytest.mark.parametrize("limit", [0.3, 2.0])
def test_directions_without_a_trace_end_within_the_bounds(limit):
    """Two equal columns: any split of their sum is as good, as far as the bounds allow."""
    information, rhs = np.ones((1, 2, 2)), np.full((1, 2), 2.0)
    solve = solver(information)
    free = solve(rhs, np.ones((1, 2), bool))
    room = (np.zeros((1, 2)), np.array([[limit, 1.5]]))
    found, _ = bounded(solve, information, rhs, free, room)
    assert not leaves_bounds(found, room)
    assert np.sum(found) == pytest.approx(min(2.0, limit + 1.5))
