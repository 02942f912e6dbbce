"""Gain sets: what stacks, in which order, and what is refused."""

import functools
from typing import Any

import numpy as np
import pytest

from eoi_jax.estimation.observers import (
    FirstOrder,
    HighOrder,
    PerOutput,
    SecondOrder,
    SuperTwisting,
    gains,
)
from eoi_jax.estimation.observers.gain_sets import gain_sets


def test_a_grid_is_every_combination_the_last_gain_fastest():
    sets: Any = gains(SecondOrder, {"c1": 5.0, "c2": [1.0, 2.0], "c3": [7.0, 8.0, 9.0]}, grid=True)
    assert len(sets) == 6
    np.testing.assert_array_equal(sets.labels["c1"], [5.0] * 6)
    np.testing.assert_array_equal(sets.labels["c2"], [1, 1, 1, 2, 2, 2])
    np.testing.assert_array_equal(sets.labels["c3"], [7, 8, 9, 7, 8, 9])
    np.testing.assert_array_equal(sets.observer.c3, sets.labels["c3"])


def test_without_a_grid_values_go_side_by_side_and_one_number_serves_all():
    sets: Any = gains(SecondOrder, {"c1": 5.0, "c2": [1.0, 2.0], "c3": [[7.0, 8.0], [9.0, 10.0]]})
    assert len(sets) == 2
    np.testing.assert_array_equal(sets.observer.c1, [5.0, 5.0])
    assert sets.observer.c3.shape == (2, 2)  # one value an output
    np.testing.assert_array_equal(sets[1:].labels["c3"], [[9.0, 10.0]])


def test_gains_that_an_observer_chooses_from_others_are_chosen_in_each_set():
    sets: Any = gains(SuperTwisting, {"alpha": [4.0, 100.0]})
    np.testing.assert_allclose(sets.observer.lambda1, [3.0, 15.0])


def test_the_scheme_and_fixed_arguments_are_kept():
    assert (
        gains(SecondOrder, {"c1": 1, "c2": 1, "c3": [1, 2]}, "explicit").observer.scheme
        == "explicit"
    )
    third: Any = gains(functools.partial(HighOrder, degree=3), {"bound": [1.0, 2.0]})
    assert third.observer.degree == 3
    assert third.kind == "HighOrder"


def test_sets_that_are_not_positive_are_known():
    sets: Any = gains(FirstOrder, {"delta": [1.0, 0.0, -1.0, np.nan, np.inf]})
    np.testing.assert_array_equal(sets.valid, [True, False, False, False, False])


def test_observers_stack_where_they_are_alike_and_keep_their_order():
    mixed = [
        SecondOrder(1.0, 2.0, 3.0),
        SecondOrder(1.0, 2.0, [3.0, 4.0]),  # one an output: the first is spread
        SecondOrder(1.0, 2.0, 3.0, "explicit"),
        gains(SecondOrder, {"c1": 1.0, "c2": 2.0, "c3": [5.0, 6.0]}),
        PerOutput((FirstOrder(3.0), SecondOrder(1.0, 2.0, 3.0))),
    ]
    groups = gain_sets(mixed, 2)
    assert [(one.kind, len(one)) for one in groups] == [
        ("SecondOrder", 2), ("SecondOrder", 1), ("SecondOrder", 2), ("PerOutput", 1),
    ]  # fmt: skip
    np.testing.assert_array_equal(groups[0].labels["c3"], [[3.0, 3.0], [3.0, 4.0]])
    assert groups[1].observer.scheme == "explicit"
    assert set(groups[3].labels) >= {"0.delta", "1.c3"}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"c1": [1, 2], "c2": [1, 2, 3], "c3": 1}, r"as many values.*c1: 2, c2: 3.*grid=True"),
        ({"c1": [], "c2": 1, "c3": 1}, "`c1` must hold at least one value.*no lane"),
        ({"c9": 1}, r"`c9` must be a gain of the observer \(c1, c2, c3\)"),
        ({"c1": 1}, "`gains` must give c1, c2, c3, got no c2, c3"),
        ({"c1": np.ones((1, 1, 1)), "c2": 1, "c3": 1}, r"`c1` must be a number, \(sets,\)"),
    ],
)
def test_values_that_make_no_sets_are_refused(values, message):
    with pytest.raises(ValueError, match=message):
        gains(SecondOrder, values)
