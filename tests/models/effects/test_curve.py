"""Curves: natural cubic splines, with the straight line apart."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import Curve, InputCurve
from eoi_jax.models.effects.curve import knots_of, varies
from eoi_jax.models.effects.effect import At
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.storage import save

KNOTS = (-2.0, -1.1, -0.4, 0.3, 1.0, 1.7, 2.5, 4.0)
PINNED = (2, 5)  # a quarter and three quarters of eight


def at(y: Any = 0.0, v: Any = 0.0, u: Any = 0.0) -> At:
    return At(jnp.zeros(()), jnp.asarray(y), jnp.asarray(v), jnp.asarray(u), jnp.zeros(0))


def whole(values):
    """Values at all knots."""
    every = np.zeros(len(KNOTS))
    every[[i for i in range(len(KNOTS)) if i not in PINNED]] = values
    return every


@pytest.fixture(scope="module")
def values():
    return np.random.default_rng(3).standard_normal(len(KNOTS) - len(PINNED))


def test_curve_is_the_natural_cubic_spline(values):
    spline = CubicSpline(KNOTS, whole(values), bc_type="natural")
    x = np.linspace(KNOTS[0], KNOTS[-1], 101)
    got = Curve("y", KNOTS, offset=False).term(at(y=x), list(values), ())
    np.testing.assert_allclose(got, spline(x), atol=1e-12)
    np.testing.assert_allclose(np.asarray(got)[[0, -1]], values[[0, -1]], atol=1e-12)


def test_curve_goes_on_straight_beyond_its_ends(values):
    spline = CubicSpline(KNOTS, whole(values), bc_type="natural")
    curve = Curve("v", KNOTS, offset=False)
    for end, sign in ((KNOTS[0], -1.0), (KNOTS[-1], 1.0)):
        x = end + sign * np.array([0.5, 3.0, 40.0])
        straight = spline(end) + spline(end, 1) * (x - end)
        np.testing.assert_allclose(curve.term(at(v=x), list(values), ()), straight, rtol=1e-9)


def test_offset_slope_and_factor(values):
    x, u = np.linspace(-3.0, 5.0, 17), np.linspace(1.0, 2.0, 17)
    plain = Curve("y", KNOTS, offset=False).term(at(y=x), list(values), ())
    both = Curve("y", KNOTS, times="u", offset=True, slope=True)
    got = both.term(at(y=x, u=u), [0.7, -1.3, *values], ())
    np.testing.assert_allclose(got, (0.7 - 1.3 * (x - KNOTS[0]) + plain) * u, rtol=1e-12)
    assert [part.name for part in both.gains[:3]] == ["y_offset", "y_slope", "y_1"]
    straight = Curve("y", (), offset=False, slope=True)
    np.testing.assert_allclose(straight.term(at(y=x), [2.0], ()), 2.0 * x)


def test_a_friction_whose_level_follows_the_output(values):
    y, v = np.linspace(-3.0, 5.0, 17), np.tile([1.5, -0.2], 9)[:17]
    level = Curve("y", KNOTS, offset=False).term(at(y=y), list(values), ())
    friction = Curve("y", KNOTS, times="sign")
    got = friction.term(at(y=y, v=v), [-2.0, *values], ())
    np.testing.assert_allclose(got, (level - 2.0) * np.sign(v), rtol=1e-12)
    assert friction.form == "of y, times sign(y')"
    assert friction.sentence.startswith("dry friction whose level is a function of the output")
    assert {gain.unit for gain in friction.gains} == {"{f}"}
    first_order = eoi.Plant(lambda t, x, u, p: -p.a * x.y[0], {"a": 1.0})
    assert not friction.fits(first_order, 0)
    assert friction.fits(eoi.Plant(lambda t, x, u, p: -p.a * x.y[0], {"a": 1.0}, 2), 0)


def test_a_plant_with_such_a_friction_rests_where_it_holds(values):
    """Level 3 everywhere: a push of 2.9 does not move it, one of 3.5 accelerates it with 0.5."""
    mass = eoi.Plant(lambda t, x, u, p: p.b * u, {"b": 1.0}, 2, inputs=("u",), outputs=("y",))
    placed = place(mass, Curve("y", KNOTS, times="sign"), 0)
    rubbing = augmented(mass, [placed], dict(zip(placed.names, [-3.0, *0.0 * values], strict=True)))
    time = np.arange(0.0, 1.0, 0.01)
    for push, distance in ((2.9, 0.0), (3.5, 0.25)):
        run = eoi.simulate(rubbing, time, np.full(100, push), hold="zero")
        assert run.outputs[-1, 0] == pytest.approx(distance * time[-1] ** 2, abs=1e-9)


def test_input_curve_adds_to_the_input(values):
    u = np.linspace(-3.0, 5.0, 17)
    spline = Curve("y", KNOTS, offset=False).term(at(y=u), list(values), ())
    got = InputCurve(KNOTS).changed(at(u=u), [0.4, *values])
    np.testing.assert_allclose(got, u + 0.4 + spline, rtol=1e-12)


def test_gradient_is_finite_at_a_knot(values):
    slope = jax.grad(lambda y: Curve("y", KNOTS).term(at(y=y), [0.0, *values], ()))
    spline = CubicSpline(KNOTS, whole(values), bc_type="natural")
    for knot in KNOTS:
        assert slope(knot) == pytest.approx(float(spline(knot, 1)), abs=1e-10)


def test_what_varies_by_rounding_alone_gets_no_curve():
    constant = np.full(50, 100.0)
    constant[::3] = np.nextafter(100.0, 101.0)
    assert not varies(constant)
    assert not varies(np.zeros(50))
    assert varies(constant + 1e-6 * np.arange(50))
    Curve("u", knots_of(constant + 1e-6 * np.arange(50), 5))  # knots that rise


def test_knots_lie_between_equal_distances_and_equal_shares():
    signal = np.random.default_rng(0).exponential(1.0, 5000)
    knots = np.array(knots_of(signal, 9))
    assert knots[0] == np.min(signal)
    assert knots[-1] == np.max(signal)
    assert np.all(np.diff(knots) >= 0.5 * np.ptp(signal) / 8)
    assert np.mean(signal < knots[4]) > np.mean(signal < np.median(signal))


@pytest.mark.parametrize("knots", [(0.0, 1.0, 2.0), (0.0, 1.0, 1.0, 2.0), (3.0, 2.0, 1.0, 0.0)])
def test_knots_that_do_not_rise_are_refused(knots):
    for effect in (InputCurve, lambda knots: Curve("y", knots)):
        with pytest.raises(ValueError, match=r"knots.*4 or more that rise"):
            effect(knots)


def test_signals_are_checked():
    with pytest.raises(ValueError, match=r"over.*w"):
        Curve("w", KNOTS)
    with pytest.raises(ValueError, match=r"times.*y"):
        Curve("y", KNOTS, "y")


def test_curve_of_an_input_needs_one():
    released = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 2, inputs=())
    assert not Curve("u", KNOTS).fits(released, 0)
    assert Curve("y", KNOTS).fits(released, 0)


def sprung(t, x, u, p):
    return u - p.k * x.y[0]


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        (Curve("y", KNOTS), "y'' = u - k·y + curve(y)"),
        (Curve("v", KNOTS), "y'' = u - k·y + curve(y')"),
        (Curve("y", KNOTS, "v"), "y'' = u - k·y + curve(y)·y'"),
        (Curve("y", KNOTS, "u"), "y'' = u - k·y + curve(y)·u"),
        (Curve("u", KNOTS), "y'' = u - k·y + curve(u)"),
        (InputCurve(KNOTS), "y'' = u - k·y\nwith u → u + curve(u)"),
    ],
)
def test_equation_names_the_curve(effect, text):
    plant = eoi.Plant(sprung, {"k": 4.0}, 2, inputs=("u",), outputs=("y",))
    names = place(plant, effect, 0).names
    channel = "u" if isinstance(effect, InputCurve) else "y"
    item = SimpleNamespace(
        effect=effect, output=channel, parameters=dict.fromkeys(names, 1.0), against="", through=""
    )
    assert equation_text(plant, [item]) == text


def test_plant_with_a_curve_runs_compiled_and_keeps_its_free_run(tmp_path):
    plant = eoi.Plant(sprung, {"k": 4.0}, 2, inputs=("u",), outputs=("y",))
    placed = [place(plant, Curve("v", KNOTS), 0), place(plant, InputCurve(KNOTS), 0)]
    random = np.random.default_rng(5)
    gains = {name: -0.2 * random.random() for item in placed for name in item.names}
    curved = augmented(plant, placed, gains)
    time = 0.01 * np.arange(500)
    signal = np.sin(3.0 * time)
    run = eoi.simulate(curved, time, signal, hold="zero")
    save(curved, tmp_path / "curved.npz")
    again = eoi.simulate(eoi.load(tmp_path / "curved.npz", plant), time, signal, hold="zero")
    np.testing.assert_array_equal(run.outputs, again.outputs)
