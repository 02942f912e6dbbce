"""One look: colours that everybody can tell apart, themes, and long signals with their peaks."""

import itertools

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex, to_rgb

from eoi_jax.report import style
from eoi_jax.report.decimate import decimate
from eoi_jax.report.svg import inline, variables

# Linear RGB as seen without the long, the middle, the short cones (G. Machado, M. Oliveira,
# L. Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291, severity 1).
SEEN = {
    "all cones": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def linear(colour: str) -> np.ndarray:
    c = np.asarray(to_rgb(colour))
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    """CIELAB of linear sRGB, white point D65."""
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], LUMINANCE, [0.0193, 0.1192, 0.9505]])
    ratio = to_xyz @ np.clip(rgb, 0.0, 1.0) / (to_xyz @ np.ones(3))
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one: str, other: str) -> float:
    low, high = sorted(float(LUMINANCE @ linear(colour)) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


@pytest.fixture(params=[False, True], ids=["light", "dark"])
def colours(request) -> dict[str, str]:
    return variables(request.param)


@pytest.mark.parametrize("how", SEEN)
def test_curves_are_told_apart_by_colour_blind_readers(colours, how):
    curves = [colours[name] for name in ("--ink", *(f"--s{i}" for i in range(6)))]
    seen = [lab(SEEN[how] @ linear(colour)) for colour in curves]
    # A difference of 2.3 is just noticeable side by side; ten of them are told apart across a page.
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) > 23


def test_curves_and_text_stand_out_from_the_page(colours):
    for name in ("--ink", *(f"--s{i}" for i in range(6))):
        # Web Content Accessibility Guidelines 2.2: 3 for graphics, 4.5 for text.
        assert contrast(colours[name], colours["--page"]) >= (4.5 if name == "--ink" else 3.0)


@style.themed()
def some_figure():
    figure = style.new_figure(3.0, 2.0)
    axes = figure.add_subplot()
    axes.plot([0.0, 1.0], [1e-3, 10.0], color=style.series(style.ACCENT), label="<b>&")
    style.logarithmic(axes.yaxis)
    axes.set_xlabel("price [$/$]")
    style.legend_above(axes)
    return style.fix_theme(figure)


def test_a_figure_takes_the_theme_that_surrounds_it_and_keeps_it():
    light = some_figure()
    with matplotlib.rc_context({"figure.facecolor": "black"}):
        dark = some_figure()
    for figure, theme in ((light, variables(False)), (dark, variables(True))):
        assert to_hex(figure.get_facecolor()) == theme["--page"]
        (axes,) = figure.axes
        assert to_hex(axes.lines[0].get_color()) == theme["--s1"]
        figure.draw_without_rendering()  # ticks are made now, under nobody's theme
        assert to_hex(axes.get_yticklabels()[0].get_color()) == theme["--ink"]


def test_a_style_of_the_callers_is_left_as_it_was():
    before = dict(matplotlib.rcParams)
    some_figure()
    assert dict(matplotlib.rcParams) == before


def test_dollars_in_names_are_dollars_and_powers_are_characters():
    drawn = inline(some_figure(), "one", "title")
    assert "price [$/$]" in drawn
    assert "10⁻³" in drawn


def test_an_inline_figure_has_the_pages_colours_its_own_names_and_no_markup_of_the_users():
    drawn = inline(some_figure(), "one", 'a "title" <i>')
    assert "var(--s1)" in drawn
    assert variables(False)["--s1"] not in drawn
    assert "&lt;b&gt;&amp;" in drawn
    assert "<b>" not in drawn
    assert "<i>" not in drawn
    assert drawn.count(' id="') == drawn.count(' id="one-')
    assert drawn.startswith("<svg")
    assert "http" not in drawn.replace('"http://www.w3.org/', "")


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 5000), st.integers(1, 40), st.integers(0, 2**31))
def test_decimation_keeps_extremes_order_and_points_of_the_signal(
    samples: int, columns: int, seed: int
):
    values = np.random.default_rng(seed).standard_normal(samples)
    time = np.arange(samples, dtype=float)
    t, v = decimate(time, values, columns)
    assert v.max() == values.max()
    assert v.min() == values.min()
    assert np.all(np.diff(t) >= 0)
    np.testing.assert_array_equal(v, values[t.astype(int)])
    assert len(v) <= 2 * columns


def test_a_peak_of_one_sample_survives_decimation_a_thousand_to_one():
    values = np.zeros(1_000_000)
    values[123_457], values[765_431] = 1.0, -1.0
    t, v = decimate(np.arange(1e6), values)
    assert t[v == 1.0] == 123_457
    assert t[v == -1.0] == 765_431
    assert len(v) <= 2000


def test_decimation_leaves_gaps_as_gaps():
    values = np.ones(1000)
    values[200:700] = np.nan
    _, v = decimate(np.arange(1000.0), values, 10)
    assert np.isnan(v).sum() == 10
    assert np.nansum(v) == 10


def test_a_unit_is_said_once():
    assert style.with_unit("angle", "rad") == "angle [rad]"
    assert style.with_unit("angle [rad]", "rad") == "angle [rad]"
    assert style.with_unit("angle", None) == "angle"
