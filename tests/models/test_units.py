"""Units as text in SI base units."""

import math

import pytest

from eoi_jax.models.units import dimension, same_unit, units_agree

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
        ("kWh", 3.6e6, TORQUE),
        ("kΩ", 1e3, {"kg": 1, "m": 2, "s": -3, "A": -2}),
        ("l/min", 1e-3 / 60.0, {"m": 3, "s": -1}),
        ("knots", 1852.0 / 3600.0, {"m": 1, "s": -1}),
        ("mbar", 100.0, {"kg": 1, "m": -1, "s": -2}),
    ],
)
def test_factors_and_powers(unit, factor, powers):
    known = dimension(unit)
    assert known is not None
    assert known.factor == pytest.approx(factor, rel=1e-12)
    assert known.powers == powers


@pytest.mark.parametrize(
    "unit", ["", " ", "px", "% RH", "barg", "bar (g)", "Nm3/h", "N m)", "2 N", "m²²"]
)
def test_what_is_not_understood_is_none(unit):
    assert dimension(unit) is None


@pytest.mark.parametrize(
    "spellings",
    [
        ("N m", "Nm", "N·m", "N*m", "N  m", "m N", "kN mm", "J"),
        ("m/s²", "m/s^2", "m/s2", "m s^-2", "m s⁻²", "m/s**2"),
        ("deg", "°", "degrees"),
        ("deg/s", "°/s"),
        ("rad/s", "rad s⁻¹"),
        ("rpm", "rev/min"),
        ("\N{MICRO SIGN}m", "\N{GREEK SMALL LETTER MU}m", "um"),
        ("\N{MICRO SIGN}Pa", "\N{GREEK SMALL LETTER MU}Pa"),
        ("°C", "degC"),
        ("m³/h", "m^3/h", "m3/h", "m³ h⁻¹"),
        ("kn", "kt", "kts", "knots"),
        ("km/h", "kph", "kmh"),
        ("%", " %"),
        ("10 bar", "10  bar"),
        ("",),
    ],
    ids=lambda spellings: spellings[0],
)
def test_a_unit_is_the_same_in_every_spelling(spellings):
    assert all(same_unit(one, other) for one in spellings for other in spellings)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("N m", "nm"),
        ("N m", "N m/rad"),
        ("m", "mm"),
        ("m/s", "m/s²"),
        ("K", "°C"),
        ("deg", "degC"),
        ("rad", "deg"),
        ("rad/s", "1/s"),  # which may count revolutions
        ("rpm", "1/min"),
        ("0.1 bar", "1.0 bar"),  # the same signs in another order
        ("bar", "mbar"),
        ("%", "1"),
        ("m", ""),
    ],
)
def test_units_that_differ_stay_different(first, second):
    assert not same_unit(first, second)
    assert not same_unit(second, first)


@pytest.mark.parametrize(
    ("first", "second", "agree"),
    [
        ("mm", "cm", False),
        ("deg/s", "rad/s", False),
        ("°F", "°C", False),
        ("degF", "°F", True),
        ("C", "°C", True),
        ("K", "°C", False),
        ("W/K", "W/°C", True),
        ("kN", "N", False),
        ("N m", "Nm", True),
        ("l/min", "m³/h", False),
        ("kn", "m/s", False),
        ("kts", "km/h", False),
        ("L/min", "l/min", True),
        ("gpm", "l/min", False),
        ("bar", "Pa", False),
        ("psi", "bar", False),
        ("kg/h", "kg/s", False),
        ("t/d", "kg/h", False),
        ("W", "MW", False),
        ("BTU/h", "kW", False),
        ("rpm", "rad/s", False),
        ("1/min", "rad/s", False),
        ("rpm", "1/min", True),  # revolutions are counted
        ("U/min", "rpm", True),
        ("Hz", "1/s", True),
        ("rad/s", "1/s", True),
        ("Hz", "rad/s", False),
        ("A", "V", False),
        ("%", "kW", False),
        ("cm", "°C", False),
        ("l/min", "%", False),
        ("min", "s", False),
        ("min", "°C", None),  # a minimum
        ("in", "bar", None),  # an inlet
        ("barg", "Pa", None),
        ("raw", "V", None),
        ("counts", "counts", True),
        ("%", "1", None),
        ("%", "-", None),
        ("-", "ppm", None),
        ("-", "V", True),
        ("bar", "bar(g)", None),
        ("", "V", True),
    ],
)
def test_whether_a_channel_in_one_unit_may_be_in_another(first, second, agree):
    assert units_agree(first, second) is agree
    assert units_agree(second, first) is agree
