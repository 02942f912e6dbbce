"""Gauss-Newton with halved steps against closed forms."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from eoi_jax.simulation.gauss_newton import gauss_newton


class Scalar(NamedTuple):
    """A point x whose error is one number."""

    cost: float
    x: float


def descend(error, slope, starts, most=50, lengths=30):
    """Each start by itself; the error is one function of one variable."""
    asked = []

    def point(x):
        return Scalar(error(x) ** 2, x)

    def linearise(points):
        steps = [-error(p.x) / slope(p.x) for p in points]
        return list(zip(steps, [p.cost for p in points], strict=True))

    def trials(start, step):
        for i in range(lengths):
            asked.append(i)
            yield point(start.x + 0.5**i * step)

    def evaluate(points, steps):
        return [trials(start, step) for start, step in zip(points, steps, strict=True)]

    return gauss_newton([point(x) for x in starts], linearise, evaluate, 1e-12, most), asked


def test_linear_problem_takes_one_full_step():
    descent, asked = descend(lambda x: 3.0 * x - 6.0, lambda x: 3.0, [10.0])
    assert descent.points[0].x == pytest.approx(2.0)
    assert asked == [0]
    assert descent.exhausted == []


@pytest.mark.parametrize("start", [2.0, -20.0])
def test_step_is_halved_where_newton_overshoots(start):
    """atan x: from |x| > 1.39 full steps diverge."""
    descent, asked = descend(math.atan, lambda x: 1.0 / (1.0 + x**2), [start])
    assert abs(descent.points[0].x) < 1e-6
    assert max(asked) > 0


def test_problems_do_not_know_of_each_other():
    starts = [2.0, 0.3, -5.0]
    together, _ = descend(math.atan, lambda x: 1.0 / (1.0 + x**2), starts)
    alone = [descend(math.atan, lambda x: 1.0 / (1.0 + x**2), [x])[0] for x in starts]
    assert together.points == [descent.points[0] for descent in alone]
    assert together.rounds == max(descent.rounds for descent in alone)


def test_slopes_that_point_uphill_leave_the_start():
    descent, _ = descend(lambda x: x, lambda x: -1.0, [1.0])
    assert descent.points[0].x == 1.0
    assert descent.exhausted == []


def test_start_that_is_not_finite_is_no_problem_of_the_others():
    def error(x):
        return np.inf if x > 5.0 else x - 1.0

    descent, _ = descend(error, lambda x: 1.0, [9.0, 0.0])
    assert [point.x for point in descent.points] == [9.0, pytest.approx(1.0)]


def test_too_few_rounds_are_said():
    descent, _ = descend(lambda x: x**2, lambda x: 2.0 * x, [1.0], most=3)
    assert descent.exhausted == [0]
    assert descent.rounds == 3
