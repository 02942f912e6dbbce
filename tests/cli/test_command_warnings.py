"""Warnings at a terminal: a line each, once, without the place in the program."""

import warnings

import numpy as np
import pytest

from eoi_jax.cli.terminal import debug, failures

pytestmark = pytest.mark.filterwarnings("default")  # not errors, as everywhere else in the tests


def test_a_warning_is_a_line_said_once(capsys):
    with failures(False):
        for _ in range(3):
            warnings.warn("the figure `map` is left out", UserWarning, stacklevel=1)
    said = capsys.readouterr().err
    assert said == "note: the figure `map` is left out\n"


def test_what_overflows_is_said_in_words_and_without_paths(capsys):
    with failures(False):
        np.exp(np.asarray([1e4]))
    said = capsys.readouterr().err
    assert said.startswith("note: some numbers left the range of double precision (overflow")
    assert said.count("\n") == 1
    assert ".py" not in said


def test_debug_shows_where_they_come_from(capsys, recwarn):
    debug(True)
    try:
        with failures(False):
            warnings.warn("here", UserWarning, stacklevel=1)
    finally:
        debug(False)
    assert capsys.readouterr().err == ""
    (one,) = recwarn
    assert one.filename == __file__
