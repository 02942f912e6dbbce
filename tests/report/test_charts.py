"""Charts embed what they draw: to five digits, with every peak, within their share of the page."""

import base64
import dataclasses
import io
import json
import re
from importlib.resources import files

import numpy as np
import pytest
from found import HELD_OUT, discovery

import eoi_jax as eoi
from eoi_jax.report import discovery_figures, page
from eoi_jax.report.charts import ChartLimits, chart_data
from eoi_jax.report.contents import discovery_contents
from eoi_jax.report.estimate_figures import refined_runs
from eoi_jax.report.figures import record_series
from eoi_jax.report.free_runs import (
    free_run_series,
    validation_runs,
    worst_series,
    worst_window,
)
from eoi_jax.report.residual_correlation import residual_correlation_figure
from eoi_jax.report.saved_models import (
    LargestCorrelation,
    correlation_text,
    largest_correlations,
)
from eoi_jax.report.time_series import Panel, Signal, TimeSeries, time_series_figure


def chart(*values: np.ndarray, limits: tuple[float, float] | None = None) -> TimeSeries:
    time = 0.5 + 0.01 * np.arange(len(values[0]))
    signals = tuple(Signal(f"line {i}", one) for i, one in enumerate(values))
    return TimeSeries(time, (Panel("y [m]", signals, 1.0, limits),), "hash")


def decoded(data: dict, name: str, line: int = 0, panel: int = 0) -> np.ndarray:
    """The values as the browser reads them."""
    entry = data["charts"][name]["panels"][panel]["signals"][line]
    stored = data["signals"][entry["signal"]]
    codes = np.frombuffer(base64.b64decode(stored["data"]), "<i2").astype(float)
    return np.where(codes == -32768, np.nan, stored["low"] + (codes + 32767) * stored["unit"])


def test_a_short_signal_is_embedded_sample_by_sample_to_five_digits():
    values = np.cumsum(np.random.default_rng(0).standard_normal(500))
    values[30:40] = np.nan
    data = chart_data({"one": chart(values)})
    assert data is not None
    assert json.loads(json.dumps(data, allow_nan=False)) == json.loads(json.dumps(data))
    entry = data["charts"]["one"]
    assert (entry["start"], entry["count"], entry["size"]) == (0.5, 500, 1)
    assert entry["step"] == pytest.approx(0.01)
    found = decoded(data, "one")
    np.testing.assert_array_equal(np.isnan(found), np.isnan(values))
    span = np.nanmax(values) - np.nanmin(values)
    np.testing.assert_allclose(found, values, atol=0.51 * span / 65534)


def test_of_a_long_signal_the_extremes_of_each_interval_are_embedded():
    values = np.random.default_rng(1).standard_normal(100_003)
    values[[777, 90_001]] = 50.0, -60.0  # peaks of a single sample
    limits = ChartLimits(values=10_000, smallest=10)
    data = chart_data({"one": chart(values, -values)}, limits)
    assert data is not None
    size = data["charts"]["one"]["size"]
    found = decoded(data, "one")
    assert len(found) == 2 * -(-len(values) // size) <= 5000 + 2
    for i in range(0, len(values) // size, 97):
        interval = values[i * size : (i + 1) * size]
        wanted = [np.min(interval), np.max(interval)]
        np.testing.assert_allclose(np.sort(found[2 * i : 2 * i + 2]), wanted, atol=2e-3)
    assert np.max(found) == pytest.approx(50.0, abs=2e-3)
    assert np.min(found) == pytest.approx(-60.0, abs=2e-3)
    np.testing.assert_allclose(np.max(decoded(data, "one", 1)), 60.0, atol=2e-3)


def test_a_signal_that_two_charts_show_is_embedded_once():
    values = np.arange(100.0)
    data = chart_data({"one": chart(values), "other": chart(values, values**2)})
    assert data is not None
    assert len(data["signals"]) == 2


def test_a_run_that_diverges_keeps_the_digits_of_the_others_and_ends_outside_the_panel():
    wild = np.exp(np.arange(700.0))
    data = chart_data({"one": chart(wild, limits=(-1.0, 3.0))})
    assert data is not None
    found = decoded(data, "one")
    assert np.sum(np.isfinite(found)) == 2  # 1, e; e² is beyond the panel and its height
    constant = chart_data({"one": chart(np.full(50, 4.0)), "two": chart(np.full(50, np.nan))})
    assert constant is not None
    np.testing.assert_allclose(decoded(constant, "one"), 4.0)
    assert np.all(np.isnan(decoded(constant, "two")))


def test_nothing_over_time_needs_no_chart():
    assert chart_data({}) is None


@pytest.mark.parametrize("count", [1, 40])
def test_the_size_of_the_page_does_not_grow_with_the_record(count):
    values = [np.random.default_rng(i).standard_normal(200_000) for i in range(count)]
    data = chart_data({"one": chart(*values)})
    assert data is not None
    assert len(json.dumps(data)) < 3e6


# -- free runs --------------------------------------------------------------------------------


def test_errors_are_measurement_less_run_and_figure_and_chart_show_the_same():
    runs = discovery_figures.free_runs(discovery())
    assert runs is not None
    content = free_run_series(runs)
    upper, lower = content.panels
    measured, before, after = (signal.values for signal in upper.signals)
    np.testing.assert_array_equal(lower.signals[0].values, measured - before)
    np.testing.assert_array_equal(lower.signals[1].values, measured - after)
    data = chart_data({"free_run": content, "data": record_series(HELD_OUT)})
    assert data is not None
    axes = time_series_figure(content).axes
    for k, panel in enumerate(axes):
        for i, line in enumerate(panel.lines):
            found = decoded(data, "free_run", i, k)
            drawn = np.asarray(line.get_ydata())
            assert np.nanmax(found) == pytest.approx(np.nanmax(drawn), abs=1e-5)
    charts = data["charts"]
    assert charts["free_run"]["record"] == charts["data"]["record"]  # linked
    first = charts["free_run"]["panels"][0]["signals"][0]["signal"]
    assert first == charts["data"]["panels"][0]["signals"][0]["signal"]  # stored once


@pytest.fixture(scope="module")
def seldom():
    """A decay from 1 at a rate of 0.3/s, refined from 0.2/s; sampled at times of one's own."""
    time = np.array([0.0, 0.1, 0.3, 0.6, 1.0, 2.0, 4.0, 8.0, 9.0, 12.0])
    with pytest.warns(eoi.RecordWarning, match="without a usual spacing"):
        record = eoi.Record(time, np.zeros((len(time), 0)), np.exp(-0.3 * time))
    decay = eoi.plant_from_text({"y": "-k*y"}, {"k": 0.2}, ["y"])
    return eoi.refine(decay, record)


def test_runs_of_an_output_that_was_measured_seldom_are_drawn_between_its_samples(seldom):
    upper, lower = free_run_series(refined_runs(seldom)).panels
    measured, before, after = upper.signals
    time = seldom.records[0].time
    assert (measured.dots, after.dots) == (True, False)
    samples = np.isfinite(measured.values)
    assert samples.sum() == 10
    np.testing.assert_allclose(after.values, np.exp(-0.3 * time), rtol=1e-5)
    np.testing.assert_allclose(before.values, before.values[0] * np.exp(-0.2 * time), rtol=1e-5)
    assert np.isfinite(lower.signals[1].values).sum() == 10  # errors at samples only


@pytest.mark.parametrize("change", [{"in_loop": True}, {"nominal": 0.4}])
def test_runs_that_cannot_be_made_again_are_lines_between_the_samples(seldom, change):
    """In a closed loop, or where the starting point was compared in other runs."""
    nominal = seldom.nominal.with_parameters({"k": change.get("nominal", 0.2)})
    changed = dataclasses.replace(seldom, nominal=nominal, in_loop=change.get("in_loop", False))
    measured, before, _ = free_run_series(refined_runs(changed)).panels[0].signals
    samples = np.isfinite(measured.values)
    time = seldom.records[0].time
    lines = np.interp(time, time[samples], before.values[samples])
    np.testing.assert_allclose(before.values, lines)


def test_the_detail_is_the_second_in_which_the_error_of_the_answer_has_most_power():
    runs = discovery_figures.free_runs(discovery())
    assert runs is not None
    last = runs.runs[-1]
    outputs = last.outputs.copy()
    outputs[4000:4100] += 0.01
    changed = dataclasses.replace(runs, runs=(*runs.runs[:-1], last._replace(outputs=outputs)))
    window = worst_window(changed)
    assert window is not None
    assert window.start <= 4000 < 4100 <= window.stop
    assert window.stop - window.start == 500  # one second
    detail = worst_series(changed)
    assert detail is not None
    np.testing.assert_array_equal(detail.time, HELD_OUT.time[window])
    np.testing.assert_array_equal(detail.panels[0].signals[0].values, HELD_OUT.outputs[window, 0])
    assert worst_window(changed, duration=7.0, most=4000) is None  # more than half of 12 s
    assert worst_window(dataclasses.replace(changed, measured=False)) is None


def test_the_correlation_of_the_errors_is_drawn_with_its_bounds_for_each_input():
    runs = discovery_figures.free_runs(discovery())
    assert runs is not None
    auto, cross = residual_correlation_figure(runs).axes
    before, after = (np.asarray(line.get_ydata()) for line in auto.lines[:2])
    bound = auto.patches[0].get_height() / 2
    assert bound == pytest.approx(2.576 / np.sqrt(len(HELD_OUT)), rel=0.01)
    assert before[0] > 0.9  # what the model lacks is far from white
    assert np.mean(np.abs(after) > bound) < 0.1  # noise of the sensor is left
    assert auto.get_xlabel() == cross.get_xlabel() == "lag [s]"
    assert np.asarray(cross.lines[0].get_xdata())[0] == pytest.approx(-0.6)


def test_the_badge_is_empty_where_the_noise_is_not_known():
    found = discovery()
    extra = {"diagnosis": eoi.diagnose(found.found)}
    assert discovery_contents(found, extra).badge.startswith("held-out error")
    clean = eoi.Record(HELD_OUT.time, HELD_OUT.inputs, HELD_OUT.outputs * 0 + 1.0, name="clean")
    assert found.after is not None
    after = dataclasses.replace(found.after, records=(clean,))
    assert discovery_contents(dataclasses.replace(found, after=after), extra).badge == ""
    in_sample = dataclasses.replace(found, in_sample=True)
    assert discovery_contents(in_sample, extra).badge.startswith("in-sample error")


# -- the page ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "state", "label"),
    [
        ("complete", "good", "complete"),
        ("nothing_missing", "good", "nothing missing"),
        ("partial", "note", "partial: more than noise is left"),
        ("unexplained", "attention", "unexplained"),
        ("converged", "good", "converged"),
        ("diverged", "attention", "diverged"),
        ("passes_exhausted", "attention", "passes exhausted"),
    ],
)
def test_the_badge_tells_what_the_status_tells(code, state, label):
    status = {"code": code, "message": "what is left is noise"}
    shown = page._outcome({"status": status, "answer": "An answer."})
    assert (shown["state"], shown["status"]) == (state, label)
    assert shown["message"] == "What is left is noise."
    repeated = page._outcome({"status": status, "answer": "No answer: what is left is noise."})
    assert repeated["message"] == ""


def test_the_library_of_the_charts_is_that_of_its_notice_with_its_licence():
    folder = files("eoi_jax.report") / "uplot"
    version = re.search(r"\(v([\d.]+)\)", (folder / "uPlot.iife.min.js").read_text())
    assert version is not None
    notice = (folder / "NOTICE").read_text()
    assert f"uPlot {version[1]} (MIT" in notice
    assert f"uplot-{version[1]}.tgz" in notice
    assert (folder / "LICENSE").read_text().startswith("The MIT License")


def test_no_text_in_the_data_of_the_charts_ends_their_element():
    wicked = "</script><script>hacked=1</script>"
    content = dataclasses.replace(chart(np.arange(10.0)), label=wicked)
    data = chart_data({"one": content})
    assert data is not None
    assert "<" not in page._json(data)
    assert json.loads(page._json(data))["charts"]["one"]["label"] == wicked


def test_a_constant_measurement_clips_nothing():
    time = np.arange(0.0, 1.0, 0.01)
    record = eoi.Record(time, np.zeros((100, 0)), np.full(100, 2.0))
    decay = eoi.plant_from_text({"y": "-k*y"}, {"k": 0.2}, ["y"])
    content = free_run_series(validation_runs((eoi.validate(decay, record), "free run")))
    assert [panel.limits for panel in content.panels] == [None, None]


def predicted_beyond_the_first_samples():
    """A shift of 400 samples of which only the first 40 were measured, near the start."""
    time = np.arange(400.0)
    plant = eoi.plant_from_text({"y": "a*u - k*y"}, {"a": 0.02, "k": 0.005}, ["y"], inputs=["u"])
    record = eoi.simulate(plant, time, np.ones(400), hold="zero")
    outputs = np.where(time[:, None] < 40, record.outputs, np.nan)
    part = eoi.Record(time, record.inputs, outputs, "tomorrow", hold="zero")
    return eoi.validate(plant, part, initial_samples=10)


def test_a_prediction_beyond_the_measurement_is_in_the_picture():
    judged = predicted_beyond_the_first_samples()
    limits = free_run_series(validation_runs((judged, "free run"))).panels[0].limits
    assert limits is not None
    assert limits[1] >= np.nanmax(judged.predictions[0].known_outputs) > 3.0


def test_the_time_that_is_scored_ends_where_nothing_is_measured():
    judged = predicted_beyond_the_first_samples()
    assert str(judged).startswith("Free run, 1 record, 30 samples (30 s) scored")


def test_a_correlation_with_a_constant_is_neither_inside_nor_outside():
    rows = largest_correlations(predicted_beyond_the_first_samples())
    assert [row.is_inside for row in rows if row.input is not None] == [None]
    assert "one is constant: no correlation" in correlation_text(rows)
    assert "nan" not in correlation_text(rows)


def test_of_few_samples_the_correlation_tells_nothing():
    """No correlation exceeds 1: a bound above it says neither inside nor outside."""
    few = LargestCorrelation("run", "y", None, -0.365, 3.75, 1.487, 0.0)
    assert few.is_inside is None
    text = correlation_text([few])
    assert "too few samples to tell" in text
    assert "inside" not in text
    assert few._replace(bound=0.5).is_inside


def test_labels_of_panels_are_within_the_figure():
    """Ticks of the lower panel get longer where the time axis takes height from it."""
    error = np.array([0.47, 0.6, 0.36, -0.3, -0.65, -0.87, -1.18, -1.08, -0.72, -0.27])
    panels = (
        Panel("conc [mg/l]", (Signal("measured", error + 3.0, None, dots=True),), 1.54),
        Panel("error [mg/l]", (Signal("error", error, 0, dots=True),), 0.96),
    )
    figure = time_series_figure(TimeSeries(np.arange(10.0), panels, "run"))
    figure.savefig(io.BytesIO())
    for axes in figure.axes:
        assert axes.yaxis.label.get_window_extent().x0 >= 0.0
