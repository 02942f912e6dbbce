"""Codes that instruments write where a value overflows are no values."""

import warnings

import numpy as np
import pytest

from eoi_jax.data.inspection import inspect
from eoi_jax.data.record import Record, RecordWarning

N, H = 400, 0.05
T = H * np.arange(N)
Y = np.sin(T) + 0.01 * np.random.default_rng(1).standard_normal(N)
U = np.cos(T)


def spoilt(signal, code, rows):
    changed = signal.copy()
    changed[rows] = code
    return changed


@pytest.mark.parametrize("code", [9.9e37, -9.9e37, 9.91e37, 1e37, 3.4028235e38])
def test_codes_side_by_side_are_masked_and_told(code):
    rows = [100, 101, 102, 300, 301]
    told = rf"5 samples of `y` are a code that instruments write .*\({code:.4g}\): read as NaN"
    with pytest.warns(RecordWarning, match=told.replace("+", "[+]")):
        record = Record(T, U, spoilt(Y, code, rows), output_names=["y"], hold="linear")
    assert np.flatnonzero(~record.output_valid[:, 0]).tolist() == rows
    assert np.max(np.abs(record.outputs)) < 2.0
    assert record.noise[0] < 0.02


def test_codes_of_an_input_leave_it_unknown():
    with pytest.warns(RecordWarning, match="3 samples of `u` are a code"):
        record = Record(T, spoilt(U, 9.9e37, slice(50, 53)), Y, input_names=["u"], hold="linear")
    assert np.flatnonzero(~record.input_valid).tolist() == [50, 51, 52]


def test_numbers_as_large_as_all_others_are_values():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = Record(T, U, 2e30 * (Y + 2.0), hold="linear")
        near = Record(T, U, 1e27 * (Y + 2.0) + 1e30 * (T > 10.0), hold="linear")
        grows = Record(T, U, 10.0 ** (2.0 * T), hold="linear")
    assert record.output_valid.all()
    assert grows.output_valid.all()
    assert near.output_valid.all()


def test_inspection_tells_of_codes_and_of_the_range_without_them(tmp_path):
    path = tmp_path / "codes.csv"
    table = np.column_stack([T, U, spoilt(Y, 9.9e37, [100, 101, 102])])
    np.savetxt(path, table, delimiter=",", header="time,force,x", comments="")
    found = inspect(path)
    assert found.advice[0].startswith("3 samples of `x` are a code that instruments write")
    (x,) = [channel for channel in found.channels if channel.name == "x"]
    assert (x.missing, x.high) == (3, pytest.approx(np.max(Y[103:]), rel=0.1))
