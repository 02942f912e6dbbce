"""Figures cost no answer; names are text, whatever stands in them."""

import dataclasses
import io

import numpy as np
import pytest
from found import discovery
from report_runs import discovered

import eoi_jax as eoi
from eoi_jax._checks import FigureWarning
from eoi_jax.models.equations.display import equation_latex
from eoi_jax.models.equations.printer import name_latex
from eoi_jax.report import discovery_figures
from eoi_jax.report.drawing import draw_or_warn, save_figure

NAMES = r"y_{$x} % ^2", r"volt $\frac{a}"


def fails(*_):
    raise RuntimeError("no ink")


def test_what_cannot_be_drawn_is_said_with_its_reason_and_left_out(tmp_path):
    with pytest.warns(FigureWarning, match=r"`map` cannot be drawn and is omitted \(RuntimeError"):
        assert draw_or_warn("map", fails) is None
    assert draw_or_warn("map", lambda: 3) == 3


def test_no_half_written_file_of_a_figure_stays(tmp_path):
    class Figure:
        def savefig(self, path):
            path.write_text("half")
            fails()

    with pytest.warns(FigureWarning, match="`half`"):
        save_figure(tmp_path / "half.png", Figure)
    assert not list(tmp_path.iterdir())


def test_a_figure_that_fails_costs_neither_result_nor_page(tmp_path, monkeypatch):
    monkeypatch.setattr(discovery_figures, "_draw_map", fails)
    with pytest.warns(FigureWarning, match="no ink"):
        run = discovered(tmp_path / "run", discovery())
    assert isinstance(eoi.load(run / "result.npz"), eoi.Discovery)
    assert not (run / "effect.png").exists()
    assert (run / "residual.png").exists()
    page = (run / "report.html").read_text(encoding="utf-8")
    assert "could not be drawn and is omitted" in page
    assert 'id="effect"' not in page


@pytest.mark.parametrize("kept", [0, 1, 7, 100])
def test_a_residual_of_few_samples_has_fewer_bins(kept):
    """Where no sample is in a bin there is no mean of it."""
    found = discovery()
    residual = [np.full_like(part, np.nan) for part in found.declared.residual]
    residual[0][-kept:] = found.declared.residual[0][-kept:] if kept else np.nan
    few = dataclasses.replace(found.declared, residual=residual)
    figure = discovery_figures.effect_figure(dataclasses.replace(found, declared=few))
    means = figure.axes[0].lines[0].get_xdata()
    shown = np.isfinite(found.found.residual[0][-kept:]) if kept else np.zeros(1, bool)
    assert len(means) == min(int(np.sum(shown)), 40)


@pytest.mark.parametrize(("degree", "panels"), [(1, 1), (2, 2)])
def test_one_panel_shows_what_depends_on_an_output_and_on_its_velocity(degree, panels):
    """An output of relative degree one is its own velocity."""
    tried = eoi.effects.CoulombFriction(), eoi.effects.CubicStiffness()
    (first, *_), found = discovery().added, discovery()
    plant = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, degree,
                      outputs=("position",))  # fmt: skip
    added = tuple(dataclasses.replace(first, effect=effect) for effect in tried)
    changed = dataclasses.replace(found, plant=plant, added=added)
    assert len(discovery_figures._maps(changed)) == panels


def test_names_are_text_in_figures_and_in_equations():
    def spring(t, x, u, p):
        return p.b * u - p.k * x.y[0] - p.d * x.y[1]

    (output, drive), values = NAMES, {"b": 20.0, "k": 30.0, "d": 1.5}
    plant = eoi.Plant(spring, values, 2, inputs=(drive,), outputs=(output,))
    time = 0.01 * np.arange(400)
    record = eoi.simulate(plant, time, eoi.excitation.square(time, 1.0, 0.7))
    result = eoi.identify(plant, record)
    for one in (record, result, eoi.validate(result.plant, record), eoi.diagnose(result)):
        figure = one.plot()
        figure.savefig(io.BytesIO())  # names are read as mathematics only when they are drawn
        assert any(name in text.get_text() for text in figure.findobj(_text()) for name in NAMES)
    formula = equation_latex(plant)
    assert r"\text{y\_\{\$x\} \% \textasciicircum{}2}" in formula
    assert r"\text{volt \$\textbackslash{}frac\{a\}}" in formula
    assert "$x" not in formula.replace(r"\$", "")


def _text():
    from matplotlib.text import Text

    return Text


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("alpha_2", r"\alpha_{2}"),
        ("mass_1", r"\mathrm{mass}_{1}"),
        ("$", r"\text{\$}"),
        ("a#b&c~", r"\text{a\#b\&c\textasciitilde{}}"),
        ("a\nb", r"\text{a b}"),
    ],
)
def test_only_identifiers_are_formulas(name, wanted):
    assert name_latex(name) == wanted
