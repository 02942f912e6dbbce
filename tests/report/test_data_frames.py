"""Results as pandas and xarray objects: their numbers are those of the result."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from found import discovery

import eoi_jax as eoi
from eoi_jax._display import Result, data_frame
from eoi_jax.models.augmented import place
from eoi_jax.observers import SecondOrder, SuperTwisting, gains
from eoi_jax.refinement.remaining import Remaining
from eoi_jax.refinement.score_test import Candidate
from eoi_jax.report.displays import TABLES
from eoi_jax.uncertainty.profile_likelihood import Profile

PLANT = eoi.plant_from_text(
    {"angle": "rate", "rate": "-a*sin(angle) - b*rate - c*sign(rate) + d*voltage"},
    {"a": 70.0, "b": 2.5, "c": 0.5, "d": 100.0},
    outputs=["angle"],
    inputs=["voltage"],
    fixed=["c"],
    units={"angle": "rad", "voltage": "V", "a": "1/s²", "d": "rad/s²/V"},
    name="pendulum",
)


@pytest.fixture(scope="module")
def fit():
    """Of two records, whose samples follow each other."""
    records = []
    for name, count in (("first", 400), ("second", 300)):
        time = 0.01 * np.arange(count)
        drive = eoi.excitation.square(time, 0.2, 0.7)
        clean = eoi.simulate(PLANT.with_parameters({"a": 76.0}), time, drive, hold="zero")
        noise = 1e-4 * np.random.default_rng(count).standard_normal(clean.outputs.shape)
        records.append(clean.with_outputs(clean.outputs + noise, name))
    return eoi.identify(PLANT, records, passes=2)


def test_a_row_for_each_parameter(fit):
    frame = fit.to_pandas()
    assert list(frame.index) == list(fit.parameters)
    assert frame["estimate"].to_dict() == fit.parameters
    assert frame["standard_error"].to_dict() == fit.standard_errors
    assert frame.loc["a", "nominal"] == 70.0
    assert frame["unit"].to_dict() == {"a": "1/s²", "b": "", "c": "", "d": "rad/s²/V"}
    assert frame["estimated"].to_dict() == {"a": True, "b": True, "c": False, "d": True}
    for name, ends in eoi.uncertainty(fit).intervals().items():
        assert tuple(frame.loc[name, ["low", "high"]]) == ends
    assert frame.attrs == {"model": "pendulum", "status": fit.status.code, "level": 0.95}


def test_the_same_rows_of_its_uncertainty(fit):
    frame = eoi.uncertainty(fit).to_pandas()
    pd.testing.assert_frame_equal(frame, fit.to_pandas()[list(frame.columns)])


def test_signals_of_all_records_follow_each_other(fit):
    dataset = fit.to_xarray()
    second = dataset.sel(sample=dataset["record"] == "second")
    np.testing.assert_array_equal(second["time"], fit.records[1].time)
    np.testing.assert_array_equal(second["injection"].sel(output="angle"), fit.injection[1][:, 0])
    np.testing.assert_array_equal(second["residual"].sel(output="angle"), fit.residual[1][:, 0])
    assert float(dataset["estimate"].sel(parameter="d")) == fit.parameters["d"]
    assert list(dataset["pass"]) == list(range(1, 1 + len(fit.index)))
    np.testing.assert_array_equal(dataset["index"], fit.index)


def test_an_estimate_without_an_answer_has_no_errors(fit):
    frame = replace(fit, status=eoi.Status("diverged", "It ran off.")).to_pandas()
    assert frame.loc["a", ["standard_error", "low", "high"]].isna().all()
    assert frame.loc["c", "standard_error"] == 0.0
    assert frame.attrs["status"] == "diverged"


def test_free_runs_beside_what_was_measured(fit):
    result = eoi.validate(fit, fit.records)
    assert result.to_pandas().loc["angle", "rmse"] == result.rmse[0]
    dataset = result.to_xarray()
    assert dataset.sizes["sample"] == sum(len(record) for record in fit.records)
    error = (dataset["measured"] - dataset["simulated"]).dropna("sample")
    assert float(np.sqrt((error**2).mean())) == pytest.approx(result.rmse[0], rel=0.05)


def test_a_refinement_has_its_residual(fit):
    result = eoi.refine(fit, fit.records)
    frame = result.to_pandas()
    assert frame["standard_error"].to_dict() == result.standard_errors
    assert frame["nominal"].to_dict() == fit.parameters
    residual = result.to_xarray()["residual"].sel(output="angle")
    np.testing.assert_array_equal(residual, np.concatenate(result.residual)[:, 0])


def test_a_record_has_nan_where_nothing_was_measured(fit):
    outputs = fit.records[0].outputs.copy()
    outputs[50:60] = np.nan
    with pytest.warns(eoi.RecordWarning):
        record = eoi.Record(fit.records[0].time, fit.records[0].inputs, outputs)
    frame = record.to_pandas()
    assert list(np.flatnonzero(frame["y"].isna())) == list(range(50, 60))
    assert list(np.flatnonzero(np.isnan(record.to_xarray()["y"]))) == list(range(50, 60))
    assert frame.attrs["hold"] == record.hold


def test_other_results_have_the_rows_that_they_print(fit):
    diagnosis = eoi.diagnose(fit)
    assert diagnosis.to_pandas().loc["angle", "residual_rms"] == diagnosis.residual_rms[0]
    compared = eoi.compare(fit.nominal, fit.records, methods=["plain_implicit", "svf"])
    frame = compared.to_pandas()
    assert frame.loc["svf", "parameters[a]"] == (compared["svf"].parameters or {})["a"]
    assert frame.loc["svf", "rmse[angle]"] == compared["svf"].rmse[0]
    points = np.array([1.0, 2.0]), np.array([3.0, 0.0]), np.zeros((2, 1))
    profile = Profile("a", *points, 2.0, 0.1, 3.8, 0.95, (1.0, 3.0), 9.0, (), "N")
    assert profile.to_pandas()["statistic"].to_dict() == {1.0: 3.0, 2.0: 0.0}
    assert profile.to_xarray()["statistic"].sel(value=1.0) == 3.0


def test_an_inspection_and_a_score_test_have_a_row_for_each_entry(fit, tmp_path):
    fit.records[0].to_pandas().to_csv(tmp_path / "run.csv")
    seen = eoi.inspect(tmp_path / "run.csv")
    assert list(seen.to_pandas()["role"]) == [channel.role for channel in seen.channels]
    placed = place(PLANT, eoi.effects.Gravity(), 0), place(PLANT, eoi.effects.QuadraticDrag(), 0)
    first, both = Candidate(placed[:1], {}, 0.3, 1e-5), Candidate(placed, {}, 0.4, 0.02)
    frame = Remaining(PLANT, (first,), (both,), np.ones(1), 0.01).to_pandas()
    assert frame["share"].to_dict() == {"gravity": 0.3, "gravity + quadratic_drag": 0.4}
    assert list(frame["significant"]) == [True, False]


def test_every_result_that_prints_itself_is_a_table_too():
    # A model and an estimator print themselves, but are no results.
    kinds = set(TABLES) - {eoi.Plant, eoi.OnlineEstimator}
    assert all(hasattr(kind, "to_pandas") for kind in kinds)
    for kind in kinds:
        assert data_frame._implementations.dispatch(kind) is not (
            data_frame._implementations.dispatch(object)
        )
    with pytest.raises(TypeError, match="no data frame is registered for Result"):
        Result().to_pandas()


@pytest.fixture(scope="module")
def swept(fit):
    sets = [gains(SecondOrder, {"c1": [10.0, 50.0], "c2": 60.0, "c3": 20.0}), SuperTwisting(300.0)]
    return eoi.sweep(fit.nominal, list(fit.records), sets, passes=2)


def test_a_row_for_each_gain_set_and_record(swept):
    frame = eoi.sweep_to_pandas(swept)
    assert len(frame) == swept["status"].size == 6
    row = frame[(frame["record"] == "second") & (frame["c1"] == 50.0)].iloc[0]
    lane = swept.sel(record="second", observer=1).squeeze()
    assert row["parameters[a]"] == float(lane["parameters"].sel(parameter="a"))
    assert row["standard_error[d]"] == float(lane["standard_error"].sel(parameter="d"))
    assert row["common_index[angle]"] == float(lane["common_index"])
    assert row["status"] in swept["status"].attrs["flag_meanings"].split()
    assert frame["kind"].value_counts().to_dict() == {"SecondOrder": 4, "SuperTwisting": 2}
    assert frame.attrs["plant"] == "pendulum"


def test_the_best_lane_of_a_sweep_is_a_row_too(swept):
    frame = eoi.sweep_to_pandas(eoi.best(swept))
    assert len(frame) == 2
    assert set(frame["record"]) == {"first", "second"}


def test_what_is_no_sweep_is_refused(fit):
    with pytest.raises(ValueError, match="`sweep` must be what `sweep` returned, got Identif"):
        eoi.sweep_to_pandas(fit)


def test_an_added_effect_that_is_refused_by_itself_is_told_so():
    found = discovery()
    ranking = [replace(one, remark="wrong sign") for one in found.ranking]
    table = replace(found, ranking=tuple(ranking)).to_pandas()
    remarks = {True: "by itself: wrong sign", False: "wrong sign"}
    assert table["added"].any()
    assert table["remark"].tolist() == [remarks[bool(one)] for one in table["added"]]
