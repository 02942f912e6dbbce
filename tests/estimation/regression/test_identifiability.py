"""What can be told, in words, of directions whose answer is known by algebra."""

import numpy as np
import pytest

from eoi_jax.estimation.regression.identifiability import (
    _product,
    format_direction,
    identifiable_combinations,
)

THETA = np.asarray([3.7, 0.21, 58.0, -1.3])
NAMES = ("a", "b", "c", "d")
EXACT = 1e-3


def along(*exponents):
    """Directions in which parameters scale with these exponents."""
    return np.stack([THETA * np.asarray(one) for one in exponents], axis=1)


@pytest.mark.parametrize(
    ("directions", "involved", "combinations"),
    [
        (along((1, 1, 1, 0)), ("a", "b", "c"), ("a/c", "b/c")),
        (along((1, -1, 0, 0)), ("a", "b"), ("a·b",)),
        (along((1, 2, 0, 0)), ("a", "b"), ("a²/b",)),
        (along((0, 1, -2, -1)), ("b", "c", "d"), ("b·d", "c/d²")),
        (along((1, 1, 0, 0), (0, 1, 1, 0)), ("a", "b", "c"), ("a·c/b",)),
        (along((1, 0, 1, 0), (0, 1, 0, 1)), ("a", "b", "c", "d"), ("a/c", "b/d")),
        (np.asarray([[1.0, -1.0, 0.0, 0.0]]).T, ("a", "b"), ("a + b",)),
        (np.asarray([[1.0, 0.0, 2.0, 1.0]]).T, ("a", "c", "d"), ("a - d", "c - 2 d")),
        # Neither a product nor a sum of small whole numbers.
        (along((1, 0.37, 0, 0)), ("a", "b"), ()),
        (along((1, 5, 0, 0)), ("a", "b"), ()),
    ],
)
def test_products_and_sums_are_found(directions, involved, combinations):
    assert identifiable_combinations(directions, THETA, NAMES, EXACT) == (involved, combinations)


def test_every_combination_named_is_constant_along_the_direction():
    rng = np.random.default_rng(0)
    for _ in range(50):
        exponents = rng.integers(-2, 3, 4)
        if np.count_nonzero(exponents) < 2:
            continue
        _, combinations = identifiable_combinations(along(exponents), THETA, NAMES, EXACT)
        for text in combinations:
            python = text.replace("·", "*").replace("²", "**2").replace("³", "**3")

            def at(scale, python=python, exponents=exponents):
                moved = THETA * scale ** exponents.astype(float)
                return eval(python, dict(zip(NAMES, moved, strict=True)))

            assert at(1.3) == pytest.approx(at(1.0), rel=1e-12), (text, exponents)


def test_any_basis_of_the_directions_says_the_same():
    directions = along((1, 1, 0, 0), (0, 1, 1, 0))
    mixed = directions @ np.asarray([[0.3, -2.0], [1.1, 0.4]])
    assert identifiable_combinations(mixed, THETA, NAMES, EXACT) == identifiable_combinations(
        directions, THETA, NAMES, EXACT
    )


def test_where_a_product_and_a_sum_fit_alike_neither_is_named():
    """One point does not tell a + b from a·b if a = b."""
    equal = np.ones(2)
    assert identifiable_combinations(np.asarray([[1.0], [-1.0]]), equal, ("a", "b"), EXACT) == (
        ("a", "b"),
        (),
    )


def test_a_parameter_of_zero_takes_no_part_in_products():
    theta = np.asarray([0.0, 2.0])
    assert identifiable_combinations(np.asarray([[1.0], [-1.0]]), theta, ("a", "b"), EXACT) == (
        ("a", "b"),
        ("a + b",),
    )


def test_a_direction_is_written_in_its_own_units():
    assert format_direction(np.asarray([-2.0, 0.0, 1.0, 1e-9]), THETA, NAMES) == "+1·a -0.5·c"


def test_a_product_is_written_with_its_first_name_above_the_line():
    assert _product([("a", -1), ("b", 1)]) == "a/b"
    assert _product([("a", -2), ("b", -1), ("c", 3)]) == "a²·b/c³"
