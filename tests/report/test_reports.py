"""Tables and figures show what the result holds."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from eoi_jax.data import excitation
from eoi_jax.estimation.identify import Identification, identify
from eoi_jax.models.library import mass_spring_damper, three_mass_spring_damper
from eoi_jax.models.plant import Plant
from eoi_jax.refinement.refine import refine
from eoi_jax.report import figures, tables
from eoi_jax.simulation.simulate import simulate


@pytest.fixture(scope="module")
def result() -> Identification:
    plant = three_mass_spring_damper()
    time = 0.002 * np.arange(4000)
    inputs = excitation.chirp(time, 1.0, 0.2, 8.0)
    return identify(plant, simulate(three_mass_spring_damper(true=True), time, inputs), passes=3)


@pytest.fixture(scope="module")
def partly_fixed() -> Identification:
    plant = mass_spring_damper()
    nominal = {**plant.parameters, "beta": 0.0}
    from eoi_jax.models.library import Plant

    model = Plant(plant.dynamics, nominal, 2, fixed=("rho",), outputs=("y",))
    time = 0.002 * np.arange(3000)
    return identify(model, simulate(plant, time, excitation.square(time, 1.0, 0.5)), passes=2)


def test_every_parameter_has_a_line_with_its_nominal_and_estimated_value(result: Identification):
    lines = tables.parameter_table(result).splitlines()
    assert lines[0].split() == ["parameter", "nominal", "estimate", "±", "std.", "error",
                                "change", "unit"]  # fmt: skip
    assert [line.split()[0] for line in lines[1:]] == list(result.parameters)
    a2 = lines[1 + list(result.parameters).index("a2")].split()
    assert float(a2[1]) == 1100
    assert float(a2[2]) == pytest.approx(result.parameters["a2"], rel=1e-5)
    assert float(a2[3]) == pytest.approx(result.standard_errors["a2"], rel=0.05)
    change = 100 * (result.parameters["a2"] / 1100 - 1)
    assert float(a2[4]) == pytest.approx(change, abs=0.005)
    assert a2[-1] == "1/s²"


def test_a_fixed_parameter_says_so_and_one_from_zero_has_no_percentage(
    partly_fixed: Identification,
):
    lines = {line.split()[0]: line for line in
             tables.parameter_table(partly_fixed).splitlines()}  # fmt: skip
    assert "fixed" in lines["rho"]
    assert "new" in lines["beta"]


def test_a_parameter_on_its_bound_says_so_in_place_of_an_error():
    plant = Plant(lambda t, x, u, p: u[0] - p.damping * x.y[0], {"damping": 0.3}, inputs="u")
    time = 0.02 * np.arange(600)
    record = simulate(plant, time, np.sign(np.sin(2.0 * time)), hold="zero")
    bounded = plant.declared_anew({"damping": 0.7}, bounds={"damping": (0.5, np.inf)})
    for text in (str(identify(bounded, record)), str(refine(bounded, record))):
        (line,) = (line for line in text.splitlines() if line.startswith("damping"))
        assert "0.5  on its bound" in line


def test_passes_count_from_one_and_only_the_best_is_marked(result: Identification):
    first_part = tables.index_table(result).split("\n\n")[0].splitlines()
    assert first_part[0].split()[:4] == ["pass", "P(position_1)", "P(position_2)", "P(position_3)"]
    numbers = [line.split()[0] for line in first_part[1:]]
    wanted = [str(i + 1) + "*" * (i == result.best_pass) for i in range(len(result.index))]
    assert numbers == wanted
    shown = np.array([[float(cell) for cell in line.split()[1:4]] for line in first_part[1:]])
    np.testing.assert_allclose(shown, result.index, rtol=1e-3)  # four digits are shown


def test_all_increments_are_shown_in_tables_narrow_enough_to_read(result: Identification):
    text = tables.index_table(result)
    assert max(map(len, text.splitlines())) <= 100
    heads = [part.splitlines()[0].split() for part in text.split("\n\n")]
    shown = [name for head in heads for name in head if name.startswith("Δ")]
    assert shown == [f"Δ{name}" for name in result.parameters]


def test_the_text_of_a_result_holds_status_gains_and_reasons(result: Identification):
    text = tables.identification_text(result)
    assert text.startswith(f"three masses: {result.status.code}")
    assert "SecondOrder(c1 " in text
    assert f"LowPass(cutoff {result.lowpass.cutoff:.4g}, order {result.lowpass.order})" in text
    for line in (*result.reasons, *result.notes):
        assert line in text
    assert str(result) == text


def test_the_figure_has_the_index_and_one_panel_for_each_output(result: Identification):
    panels = result.plot().axes
    assert len(panels) == 4
    index = panels[0]
    assert index.get_yscale() == "log"
    for j in range(3):
        np.testing.assert_array_equal(index.lines[j].get_ydata(), result.index[:, j])
    assert "position_1 [m/s²]" in panels[1].get_ylabel()
    assert panels[-1].get_xlabel() == "time [s]"
    legend = [text.get_text() for text in panels[1].get_legend().get_texts()]
    assert legend == ["pass 1", f"pass {result.best_pass + 1} (best)"]


def test_an_index_of_passes_that_run_away_is_drawn_as_far_as_it_says_something(result):
    """On an axis to 1e300 the others would be one line, and its ends no floating-point numbers."""
    lost = np.repeat([[1e300], [np.inf], [np.nan]], 3, axis=1)
    count = len(result.parameters)
    longer = replace(
        result, index=np.r_[result.index, lost],
        increments=np.r_[result.increments, np.zeros((3, count))],
        parameter_history=np.r_[result.parameter_history, np.zeros((3, count))],
    )  # fmt: skip
    figure = figures.index_figure([(longer, "")])
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert low < np.min(result.index) < np.max(result.index) < high < 1e12 * np.max(result.index)
    drawn = np.asarray(axes.lines[0].get_ydata())
    np.testing.assert_array_equal(drawn[:-3], result.index[:, 0])
    assert np.all(drawn[-3:-1] > high)
    assert np.isnan(drawn[-1])


def test_the_drawn_injection_reaches_the_peaks_of_the_computed_one(result: Identification):
    for j, axes in enumerate(figures.identification_figure(result).axes[1:]):
        for line, whole in zip(axes.lines, (result.first_injection, result.injection), strict=True):
            drawn = np.asarray(line.get_ydata())
            assert np.nanmax(drawn) == np.nanmax(whole[0][:, j])
            assert np.nanmin(drawn) == np.nanmin(whole[0][:, j])
            assert len(drawn) < len(whole[0])


def test_an_output_without_unit_has_none_in_the_figure(partly_fixed: Identification):
    axes = figures.identification_figure(partly_fixed).axes[1]
    assert axes.get_ylabel() == "injection of\ny"
