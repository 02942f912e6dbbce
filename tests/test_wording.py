"""Counts in sentences."""

import pytest

from eoi_jax._checks import counted, is_or_are, percent, timed


@pytest.mark.parametrize(
    ("number", "noun", "text"),
    [
        (1, "gap", "1 gap"),
        (0, "gap", "0 gaps"),
        (2, "pass", "2 passes"),
        (1, "pass", "1 pass"),
        (3, "single missing sample", "3 single missing samples"),
    ],
)
def test_a_noun_is_in_the_plural_unless_there_is_one(number: int, noun: str, text: str):
    assert counted(number, noun) == text


def test_samples_come_with_their_time():
    assert timed(250, 0.01) == "250 samples (2.5 s)"
    assert timed(1, 0.5, "grid point") == "1 grid point (0.5 s)"


def test_the_verb_follows_the_number():
    assert [is_or_are(number) for number in (0, 1, 2)] == ["are", "is", "are"]


@pytest.mark.parametrize(
    ("share", "text"),
    [(0.0534, "5.3 %"), (0.0012, "0.12 %"), (0.994, "99 %"), (0.999, "100 %"), (1.0, "100 %"),
     (8.334, "833 %"), (0.0, "0 %"), (-3.2, "-320 %")],
)  # fmt: skip
def test_a_percentage_has_no_power_of_ten(share: float, text: str):
    assert percent(share) == text


def test_a_percentage_of_more_digits_is_not_cut():
    assert [percent(share, 3) for share in (0.12345, 9.996, 12.346)] == [
        "12.3 %",
        "1000 %",
        "1235 %",
    ]
