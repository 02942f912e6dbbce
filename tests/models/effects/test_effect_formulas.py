"""Every effect computes what its docstring says, also at rest and at ties."""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax import effects
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractCascade,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractTerm,
    At,
)
from eoi_jax.models.effects.products import ModulatedSinusoid, Product

ALL = (
    effects.InputSquare(odd=True), effects.InputSquare(odd=False),
    *effects.standard(), *effects.rare(), *effects.wider(), *effects.on_request(),
    effects.Drift(start=2.5),
)  # fmt: skip
TERMS = [one for one in ALL if isinstance(one, AbstractTerm)]
INPUTS = [one for one in ALL if isinstance(one, AbstractInputEffect)]
INTERNAL = [one for one in ALL if isinstance(one, AbstractInternalEffect)]


def label(effect: AbstractEffect) -> str:
    return "-".join([effect.name, *(str(value) for value in vars(effect).values())])


# Written from the literature in plain NumPy: (t, y, v, u, z), gains, shapes.
CLOSED: dict[AbstractEffect, Callable[..., Any]] = {
    effects.ViscousFriction(): lambda t, y, v, u, z, g, s: -g[0] * v,
    effects.CoulombFriction(): lambda t, y, v, u, z, g, s: -np.copysign(g[0], v) * (v != 0),
    effects.AsymmetricFriction(): lambda t, y, v, u, z, g, s: (
        -g[0] if v > 0 else g[1] if v < 0 else 0.0
    ),
    effects.AsymmetricViscousFriction(): lambda t, y, v, u, z, g, s: -g[0] * np.hypot(v, 0.0),
    effects.StribeckFriction(): lambda t, y, v, u, z, g, s: (
        -(g[0] + g[1] / np.exp(v * v / s[0] ** 2)) * np.sign(v)
    ),
    effects.QuadraticDrag(): lambda t, y, v, u, z, g, s: -g[0] * np.copysign(v * v, v),
    effects.CubicDamping(): lambda t, y, v, u, z, g, s: -g[0] * v * v * v,
    effects.InternalFriction(): lambda t, y, v, u, z, g, s: 0.0,
    effects.LinearStiffness(): lambda t, y, v, u, z, g, s: -g[0] * y,
    effects.QuadraticStiffness(): lambda t, y, v, u, z, g, s: -g[0] * y * y,
    effects.CubicStiffness(): lambda t, y, v, u, z, g, s: -g[0] * y * y * y,
    effects.Gravity(): lambda t, y, v, u, z, g, s: -g[0] * np.cos(y - np.pi / 2.0),
    effects.Gravity(degrees=True): lambda t, y, v, u, z, g, s: -g[0] * np.cos(np.deg2rad(y - 90.0)),
    effects.GravityTilt(): lambda t, y, v, u, z, g, s: g[0] * np.sin(y + np.pi / 2.0),
    effects.GravityTilt(degrees=True): lambda t, y, v, u, z, g, s: (
        g[0] * np.sin(np.deg2rad(y + 90.0))
    ),
    effects.PositionRipple(): lambda t, y, v, u, z, g, s: (
        np.hypot(*g) * np.cos(s[0] * y - np.arctan2(g[0], g[1]))
    ),
    effects.EndStop(+1): lambda t, y, v, u, z, g, s: -g[0] * (y - s[0]) if y > s[0] else 0.0,
    effects.EndStop(-1): lambda t, y, v, u, z, g, s: g[0] * (s[0] - y) if y < s[0] else 0.0,
    effects.FreePlay(): lambda t, y, v, u, z, g, s: (
        g[0] * y if abs(y) < s[0] else g[0] * s[0] * np.sign(y)
    ),
    effects.ConstantOffset(): lambda t, y, v, u, z, g, s: g[0],
    effects.Drift(): lambda t, y, v, u, z, g, s: g[0] * t,
    effects.Drift(start=2.5): lambda t, y, v, u, z, g, s: g[0] * (t - 2.5),
    effects.SinusoidalDisturbance(): lambda t, y, v, u, z, g, s: (
        np.hypot(*g) * np.cos(s[0] * t - np.arctan2(g[0], g[1]))
    ),
    effects.Hysteresis(): lambda t, y, v, u, z, g, s: -g[0] * z[0],
    effects.Relaxation(): lambda t, y, v, u, z, g, s: -g[0] * z[0],
    effects.SecondMass(): lambda t, y, v, u, z, g, s: (
        g[0] * (s[0] * s[0] * z[0] + s[1] * (z[1] - v))
    ),
    effects.SecondMass(in_bearing=True): lambda t, y, v, u, z, g, s: g[0] * s[0] * s[0] * z[0],
    effects.SecondNode(): lambda t, y, v, u, z, g, s: g[0] * z[0],
    effects.MaxwellElement(): lambda t, y, v, u, z, g, s: g[0] * z[0],
    effects.Product("u", "y"): lambda t, y, v, u, z, g, s: g[0] * u * y,
    effects.Product("u", "v"): lambda t, y, v, u, z, g, s: g[0] * u * v,
    effects.Product("y", "v"): lambda t, y, v, u, z, g, s: g[0] * y * v,
    effects.Product("u", "y", "y"): lambda t, y, v, u, z, g, s: g[0] * u * y * y,
    effects.Product("y", "y"): lambda t, y, v, u, z, g, s: g[0] * y * y,
    effects.Product("y", "y", "y"): lambda t, y, v, u, z, g, s: g[0] * y * y * y,
    effects.Product("y", "v", "v"): lambda t, y, v, u, z, g, s: g[0] * y * v * v,
    effects.LoadFriction(): lambda t, y, v, u, z, g, s: -g[0] * abs(u) * np.sign(v),
    effects.InputDamping(): lambda t, y, v, u, z, g, s: -g[0] * abs(u) * v,
    effects.DisplacementDamping(): lambda t, y, v, u, z, g, s: -g[0] * y * y * v,
    effects.RateFriction(): lambda t, y, v, u, z, g, s: -g[0] * v / (s[0] * np.cosh(y / s[0]) ** 2),
    effects.ErrorSaturation(): lambda t, y, v, u, z, g, s: y + sorted((-s[0], u - y, s[0]))[1],
    effects.CurrentLimit(of_position=False): lambda t, y, v, u, z, g, s: sorted(
        (s[0] * y - s[1], u, s[0] * y + s[1])
    )[1],
    effects.CurrentLimit(of_position=True): lambda t, y, v, u, z, g, s: sorted(
        (s[0] * v - s[1], u, s[0] * v + s[1])
    )[1],
    effects.ValveFlow(): lambda t, y, v, u, z, g, s: (
        u * max(1.0 - np.sign(u) * y / s[0], 1e-6) ** 0.5
    ),
    effects.InputYield(): lambda t, y, v, u, z, g, s: sorted((-s[0], u, s[0]))[1] + s[1] * u,
    effects.Leak(): lambda t, y, v, u, z, g, s: -g[0] * y,
    effects.Overflow(): lambda t, y, v, u, z, g, s: -g[0] * (y - s[0]) if y > s[0] else 0.0,
    effects.Radiation(): lambda t, y, v, u, z, g, s: g[0] * (s[0] ** 4 - y**4) / 1e8,
    effects.Radiation(celsius=True): lambda t, y, v, u, z, g, s: (
        g[0] * (s[0] - y) * (s[0] + y + 546.3) * ((s[0] + 273.15) ** 2 + (y + 273.15) ** 2) / 1e8
    ),
    effects.PowerLoss(): lambda t, y, v, u, z, g, s: -g[0] * abs(y) ** s[0] * np.sign(y),
    effects.SaturatingLoss(): lambda t, y, v, u, z, g, s: (
        -g[0] / (s[0] / abs(y) + 1.0) * np.sign(y) if y else 0.0
    ),
    effects.InternalOverflow(caught=True): lambda t, y, v, u, z, g, s: (
        g[0] * s[0] * (y - s[1]) if y > s[1] else 0.0
    ),
    effects.InternalOverflow(caught=False): lambda t, y, v, u, z, g, s: 0.0,
    effects.InputDeadZone(): lambda t, y, v, u, z, g, s: (
        u - s[0] if u > s[0] else u + s[0] if u < -s[0] else 0.0
    ),
    effects.InputSaturation(): lambda t, y, v, u, z, g, s: sorted((-s[0], u, s[0]))[1],
    effects.InputSquare(odd=True): lambda t, y, v, u, z, g, s: np.copysign(u * u, u),
    effects.InputSquare(odd=False): lambda t, y, v, u, z, g, s: u * u,
    effects.InputQuadratic(odd=True): lambda t, y, v, u, z, g, s: u + s[0] * np.copysign(u * u, u),
    effects.InputQuadratic(odd=False): lambda t, y, v, u, z, g, s: u + s[0] * u * u,
    effects.InputAsymmetry(): lambda t, y, v, u, z, g, s: (
        (1.0 + s[0]) * u if u > 0 else (1.0 - s[0]) * u
    ),
}


def points(effect: AbstractEffect, seed: int = 0):
    """Instants, gains, shapes: all signs, small and large, on the corners, at rest."""
    random = np.random.default_rng(seed)
    for i in range(40):
        t, y, v, u = random.standard_normal(4) * 10.0 ** random.uniform(-1.0, 1.0, 4)
        gains = random.uniform(0.2, 3.0, len(effect.gains))
        shapes = random.uniform(0.2, 2.0, len(effect.shapes))
        z = random.uniform(-1.0, 1.0, effect.states)
        if i % 5 == 0:
            v = 0.0
        if i % 5 == 1 and len(shapes):
            y = v = u = shapes[-1] * (-1.0) ** i
        yield (abs(t), y, v, u, z), gains, shapes


def value_of(effect: AbstractEffect, at: At, gains: Any, shapes: Any) -> Any:
    if isinstance(effect, AbstractInputEffect):
        return effect.changed(at, shapes)
    assert isinstance(effect, AbstractTerm | AbstractInternalEffect)
    return effect.term(at, gains, shapes)


@pytest.mark.parametrize("effect", [*TERMS, *INTERNAL, *INPUTS], ids=label)
def test_effect_is_its_closed_form(effect):
    for at, gains, shapes in points(effect):
        got = value_of(effect, At(*map(jnp.asarray, at)), gains, shapes)
        assert got == pytest.approx(CLOSED[effect](*at, gains, shapes), rel=1e-12, abs=1e-13)


def test_every_effect_has_a_closed_form_here():
    along = {one for one in ALL if isinstance(one, AbstractActuator)}
    in_series = {one for one in ALL if isinstance(one, AbstractCascade)}
    assert set(ALL) - along - in_series == set(CLOSED)
    assert {one.name for one in along} == {
        "input_delay",
        "actuator_lag",
        "input_rate",
        "input_modulation",
        "rate_limit",
        "input_play",
    }  # test_effects.py
    assert {one.name for one in in_series} == {
        "cells_in_series",
        "sensor_lag",
        "sensor_curve",
        "varying_capacity",
        "rate_asymmetry",
    }  # test_series.py, test_capacity.py


SPILLS = [one for one in INTERNAL if isinstance(one, effects.InternalOverflow)]


@pytest.mark.parametrize("effect", SPILLS, ids=label)
def test_spill_of_an_internal_state_is_lost_above_the_brim(effect):
    for (t, y, v, u, z), _, shapes in points(effect, 2):
        rate = effect.change(At(*map(jnp.asarray, (t, y, v, u, z))), shapes)
        assert rate == pytest.approx(-shapes[0] * max(y - shapes[1], 0.0), abs=1e-13)


def test_friction_of_a_part_that_is_not_measured_is_against_its_speed():
    effect = effects.InternalFriction()
    for (t, y, v, u, z), _, shapes in points(effect, 2):
        rate = effect.change(At(*map(jnp.asarray, (t, y, v, u, z))), shapes)
        steep = np.exp(-2.0 * abs(y) / shapes[1])
        assert rate == pytest.approx(-shapes[0] * np.sign(y) * (1.0 - steep) / (1.0 + steep))


def test_hysteresis_follows_bouc_and_wen():
    """On each side of v = 0 and z = 0 the loop's slope δ dz/dy is 1 - (β ± (1 - β)) |z|."""
    effect = effects.Hysteresis()
    for (t, y, v, u, z), _, (size, _) in points(effect, 3):
        share = 0.3
        same = np.sign(v) == np.sign(z[0])
        slope = 1.0 - abs(z[0]) * (1.0 if same else 1.0 - 2.0 * share)
        rate = effect.rate(At(*map(jnp.asarray, (t, y, v, u, z))), (size, share))
        np.testing.assert_allclose(rate, [v * slope / size], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("one", "other"), [("y", "v"), ("v", "u"), ("u", "u")])
def test_terms_without_a_name_are_products(one, other):
    random = np.random.default_rng(4)
    for _ in range(10):
        values = dict(zip("tyvu", random.standard_normal(4), strict=True))
        at, (a, b, w) = At(**values, z=np.zeros(0)), random.standard_normal(3)
        assert Product(one, other).term(at, [a], ()) == pytest.approx(
            a * values[one] * values[other]
        )
        swing = a * np.sin(w * values["t"]) + b * np.cos(w * values["t"])
        got = ModulatedSinusoid(one).term(at, [a, b], [w])
        assert float(got) == pytest.approx(swing * values[one])
