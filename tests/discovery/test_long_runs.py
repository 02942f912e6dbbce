"""Lengths of free runs in a discovery: whole records, or windows of an unstable plant."""

import pytest

import eoi_jax as eoi
from eoi_jax import effects
from tests.discovery.upright_pendulum import PLANT, upright


@pytest.fixture(scope="module")
def found():
    tried = [effects.ViscousFriction(), effects.CubicStiffness(), effects.ConstantOffset()]
    return eoi.discover(PLANT, upright(1), upright(2), tried)


def test_an_unstable_plant_is_judged_in_windows_and_its_friction_found(found):
    """Errors of a start grow with e^(3 t): over 12 s the declared model falls over."""
    assert found.effects == ("viscous_friction",)
    assert found.plant.parameters["viscous_friction"] == pytest.approx(0.6, rel=0.05)
    assert found.before.window == found.after.window <= 4.0 / 3.0
    assert found.windows_before.window <= 0.5 * found.before.window + 0.01
    assert found.after.rmse[0] < 0.5 * found.before.rmse[0] < 0.2


def test_the_report_says_over_what_the_errors_are(found):
    assert f"held-out RMSE of angle in windows of {found.before.window:.3g} s" in str(found)
    assert f"data in windows of {found.before.window:.3g} s" in str(found).splitlines()[0]


def test_test_errors_are_over_windows_of_the_same_length():
    once = eoi.discover(PLANT, upright(1), upright(2), [effects.ViscousFriction()], test=upright(3))
    lengths = {runs and runs.window for runs in (once.test_before, once.test_after, once.before)}
    assert len(lengths) == 1
    assert None not in lengths
