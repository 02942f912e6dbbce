"""Units as text in SI base units."""

import math

import pytest

from eoi_jax.models.units import dimension

TORQUE = {"kg": 1, "m": 2, "s": -2}


@pytest.mark.parametrize("unit", ["N m", "Nm", "N·m", "N*m", "kg m²/s²", "J", "kg*m^2/s**2", "W s"])
def test_spellings_of_a_torque_are_the_same(unit):
    torque = dimension(unit)
    assert torque is not None
    assert (torque.factor, torque.powers) == (1.0, TORQUE)


@pytest.mark.parametrize(
    ("unit", "factor", "powers"),
    [
        ("1", 1.0, {}),
        ("rad/s²", 1.0, {"s": -2}),
        ("rad/(s² V)", 1.0, {"kg": -1, "m": -2, "s": 1, "A": 1}),
        ("rad/s²/V", 1.0, {"kg": -1, "m": -2, "s": 1, "A": 1}),
        ("N/(m/s)", 1.0, {"kg": 1, "s": -1}),
        ("Nms/rad", 1.0, {"kg": 1, "m": 2, "s": -1}),
        ("s⁻¹", 1.0, {"s": -1}),
        ("mN m", 1e-3, TORQUE),
        ("kN mm", 1.0, TORQUE),
        ("deg", math.pi / 180.0, {}),
        ("N m s/deg", 180.0 / math.pi, {"kg": 1, "m": 2, "s": -1}),
        ("min", 60.0, {"s": 1}),
    ],
)
def test_factors_and_powers(unit, factor, powers):
    known = dimension(unit)
    assert known is not None
    assert known.factor == pytest.approx(factor, rel=1e-12)
    assert known.powers == powers


@pytest.mark.parametrize("unit", ["", " ", "px", "%", "lbf", "N m)", "2 N", "m²²"])
def test_what_is_not_understood_is_none(unit):
    assert dimension(unit) is None
