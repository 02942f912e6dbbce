"""Records to other packages' objects and back; what does not fit is named."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import eoi_jax as eoi

N = 60
T = 0.02 * np.arange(N)
U = np.sign(np.sin(9 * T))
Y = np.c_[np.sin(T), np.cos(T)]


def record():
    return eoi.Record(
        T, U, Y, "rig", input_names=["volt"], output_names=["angle", "speed"],
        units={"volt": "V", "angle": "rad", "time": "s"}, hold="zero",
    )  # fmt: skip


def check_same(one, other):
    np.testing.assert_allclose(one.time, other.time, atol=1e-12)
    np.testing.assert_array_equal(one.inputs, other.inputs)
    np.testing.assert_array_equal(one.outputs, other.outputs)
    assert (one.input_names, one.output_names) == (other.input_names, other.output_names)
    assert one.units["volt"] == other.units["volt"]


def test_pandas_there_and_back():
    frame = eoi.record_to_pandas(record())
    assert list(frame.columns) == ["volt", "angle", "speed"]
    assert frame.index.name == "time"
    back = eoi.record_from_pandas(frame, "volt", ["angle", "speed"], name="rig", hold="zero")
    check_same(back, record())


def test_xarray_there_and_back():
    whole = eoi.record_to_xarray(record())
    assert whole["angle"].attrs == {"role": "output", "units": "rad"}
    assert whole.attrs["sample_period"] == pytest.approx(0.02)
    back = eoi.record_from_xarray(whole, ["volt"], ["angle", "speed"], hold="zero")
    check_same(back, record())


def test_masked_samples_are_nan_outside_and_masked_again():
    holed = Y.copy()
    holed[7, 0] = np.nan
    with pytest.warns(eoi.RecordWarning):
        given = eoi.Record(T, U, holed)
    frame = eoi.record_to_pandas(given)
    assert frame.isna().sum().to_dict() == {"u": 0, "y1": 1, "y2": 0}
    assert np.isnan(eoi.record_to_xarray(given)["y1"].values[7])
    with pytest.warns(eoi.RecordWarning):
        back = eoi.record_from_pandas(frame, "u", ["y1", "y2"])
    np.testing.assert_array_equal(back.valid, given.valid)
    np.testing.assert_array_equal(back.output_valid, given.output_valid)


def test_dates_of_an_index_a_column_or_none_are_time():
    frame = pd.DataFrame({"u": U, "y": Y[:, 0]})
    stamps = pd.Timestamp("2024-05-01") + pd.to_timedelta(T, unit="s")
    cases: list[tuple[pd.DataFrame, dict[str, Any]]] = [
        (frame.set_index(stamps), {}),
        (frame.assign(when=stamps), {"time": "when"}),
        (frame, {"sample_period": 0.02}),
    ]
    for given, options in cases:
        made = eoi.record_from_pandas(given, "u", "y", **options)
        np.testing.assert_allclose(made.time - made.time[0], T, atol=1e-9)


def test_a_variable_with_labels_is_as_many_channels():
    whole = xr.Dataset(
        {"q": (("joint", "time"), Y.T), "u": ("time", U)},
        coords={"time": T, "joint": ["hip", "knee"]},
    )
    made = eoi.record_from_xarray(whole, "u", "q")
    assert made.output_names == ("q_hip", "q_knee")
    np.testing.assert_array_equal(made.outputs, Y)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"outputs": ()}, "`outputs` must name at least one column, got none. .* u, y"),
        ({"outputs": "yy"}, r"`outputs` must be one of those present \(u, y\), got `yy`. Did you"),
        ({"inputs": ["v"]}, "`inputs` must be one of"),
        ({"time": "t"}, "`time` must be one of"),
        ({"sample_period": None}, "`time, sample_period` must not be both given .*RangeIndex"),
        ({"time": "u"}, "`time, sample_period` must not be both given or both omitted"),
    ],
)
def test_what_a_frame_does_not_hold_is_named(options, message):
    frame = pd.DataFrame({"u": U, "y": Y[:, 0]})
    given = {"inputs": "u", "outputs": "y", "sample_period": 0.02} | options
    with pytest.raises(ValueError, match=message):
        eoi.record_from_pandas(frame, **given)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"outputs": ()}, "`outputs` must name at least one variable, got none. .* u, y"),
        ({"outputs": "q"}, "`outputs` must be one of those present"),
        ({"time": "t"}, r"`time` must be one of those present \(time\), got `t`"),
        ({"inputs": "mass"}, "`inputs` must be a variable over `time`"),
    ],
)
def test_what_a_dataset_does_not_hold_is_named(options, message):
    whole = xr.Dataset({"u": ("time", U), "y": ("time", Y[:, 0]), "mass": 2.0}, coords={"time": T})
    with pytest.raises(ValueError, match=message):
        eoi.record_from_xarray(whole, **({"inputs": "u", "outputs": "y"} | options))


def test_a_benchmark_object_is_a_record_with_its_unscored_start():
    benchmarks = pytest.importorskip(
        "nonlinear_benchmarks", reason="nonlinear_benchmarks is not installed"
    )
    data = benchmarks.Input_output_data(
        U, Y, sampling_time=0.02, name="tanks", state_initialization_window_length=5
    )
    made = eoi.record_from_benchmark(data, input_names="volt")
    assert (made.name, made.sample_period, made.burn_in) == ("tanks", 0.02, pytest.approx(0.1))
    assert (made.input_names, made.output_names) == (("volt",), ("y1", "y2"))
    np.testing.assert_array_equal(made.outputs, Y)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ((1, 2), r"`data` must have u, y and sampling_time, got a tuple.*\(train, test\)"),
        (SimpleNamespace(u=U, y=Y, sampling_time=None), "`data.sampling_time` must be a number"),
        (SimpleNamespace(u=U, y=Y, sampling_time="discrete"), "`data.sampling_time` must be"),
    ],
)
def test_other_objects_are_named(data, message):
    with pytest.raises(ValueError, match=message):
        eoi.record_from_benchmark(data)
