"""Each annotation is checked: of arguments and results, sizes across them, in nested functions."""

import dataclasses
import threading

import numpy as np
import pytest
from jaxtyping import Float, TypeCheckError

from tests.checked_types import checked

Row = Float[np.ndarray, "n"]
TWO, THREE = np.ones(2), np.ones(3)


@checked
def first(row: Row, other: Row, count: int | None = None) -> Row:
    return row[:count]


def scaled_by(factor: float):
    @checked
    def scaled(row: Row, other: Row, count: int | None = None) -> Row:
        return factor * row[:count]

    return scaled


@checked
@dataclasses.dataclass
class Pair:
    row: Row
    other: Row

    @checked
    def longer(self, row: Row, other: "Pair") -> Row:
        return np.append(row, other.row)


@pytest.mark.parametrize("function", [first, scaled_by(2.0), scaled_by(3.0)])
def test_arguments_and_the_result_are_checked(function):
    assert function(TWO, TWO).shape == (2,)
    assert function(THREE, THREE, count=3).shape == (3,)  # the size is one of each call
    for wrong in ((TWO, THREE), (TWO, [1.0, 1.0]), (TWO, TWO, "1"), (THREE, THREE, 1)):
        with pytest.raises(TypeCheckError):
            function(*wrong)


def test_functions_of_the_same_lines_keep_their_own_values():
    twice, thrice = scaled_by(2.0), scaled_by(3.0)
    assert [float(f(TWO, TWO)[0]) for f in (twice, thrice, twice)] == [2.0, 3.0, 2.0]
    found = []
    threads = [
        threading.Thread(target=lambda f=f: found.append({f(TWO, TWO)[0] for _ in range(99)}))
        for f in (twice, thrice)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(found, key=str) == [{2.0}, {3.0}]


def test_classes_are_checked():
    pair = Pair(TWO, TWO)
    with pytest.raises(TypeCheckError):
        Pair(TWO, THREE)
    for wrong in ((TWO, 1), (TWO, pair)):  # no pair; a longer row
        with pytest.raises(TypeCheckError):
            pair.longer(*wrong)
