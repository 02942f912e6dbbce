"""Identified values in joints: formulas, their errors, units, and what is refused."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from found import DECLARED

import eoi_jax as eoi
from eoi_jax.uncertainty.uncertainty import Uncertainty

URDF = """<robot name="arm">
  <joint name="shoulder" type="revolute"><dynamics damping="0.1"/></joint>
  <joint name="slider" type="prismatic"><dynamics damping="0.1"/></joint>
</robot>
"""
UNITS = {"b": "N m s/rad", "c": "rad/s²", "J": "kg m²", "g": "N m s/deg", "n": "N m"}
KNOWN = Uncertainty(
    {"b": 0.3, "c": 2.0, "J": 0.05, "g": 0.01, "n": -0.02, "free": 4.0},
    np.diag([0.01, 0.2, 0.002, 0.001, 0.03, 0.5]) ** 2,
    np.full(6, np.inf),
    np.zeros((6, 0)),
    (),
    UNITS,
)


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path


def exported(robot, joints, result: Any = KNOWN):
    return eoi.export_robot(result, robot, robot.with_name("new.urdf"), joints)


def test_formulas_become_values_with_errors_by_the_delta_method(robot):
    written = exported(robot, {"shoulder": {"damping": "b", "friction": "c*J"}})
    assert written.parameters == {"shoulder.damping": 0.3, "shoulder.friction": 2.0 * 0.05}
    error = np.hypot(0.05 * 0.2, 2.0 * 0.002)
    assert written.standard_errors["shoulder.friction"] == pytest.approx(error, rel=1e-12)
    assert written.units == {"shoulder.damping": "N m s/rad", "shoulder.friction": "N m"}
    assert written.unclear == ()
    text = robot.with_name("new.urdf").read_text()
    assert text == URDF.replace('damping="0.1"', 'damping="0.3" friction="0.1"', 1)
    assert robot.read_text() == URDF


def test_a_number_stands_for_itself(robot):
    written = exported(robot, {"shoulder": {"damping": 0.25, "friction": "0"}})
    assert written.parameters == {"shoulder.damping": 0.25, "shoulder.friction": 0.0}
    assert written.standard_errors == {"shoulder.damping": 0.0, "shoulder.friction": 0.0}


def test_what_has_no_unit_is_said(robot):
    written = exported(robot, {"shoulder": {"damping": "free", "friction": "c*0.05"}})
    assert written.unclear == (
        "shoulder.damping: free is taken to be in N m s/rad; its unit is not known",
        "shoulder.friction: c*0.05 is taken to be in N m; its unit is not known",
    )
    assert "- shoulder.damping: free is taken" in str(written)


@pytest.mark.parametrize("formula", ["c*J", "J*c", "-J*-c", "J**2*c/J"])
def test_units_of_products_are_worked_out(robot, formula):
    written = exported(robot, {"shoulder": {"friction": formula}})
    assert written.parameters["shoulder.friction"] == pytest.approx(0.1)
    assert written.unclear == ()


ASK = "Multiply by what makes a force or torque of it, such as the inertia."
IN_DEGREES = (
    "`joints[shoulder].damping` must be in N m s/rad, got g with g in N m s/deg. "
    "Write (g)*57.29577951."
)
PERHAPS_ZERO = (
    "`joints[shoulder].friction` must not be negative, got -0.02 of n, 95 % interval -0.0787989 … "
    "0.0387989. Simulators refuse or ignore it. The interval contains 0: write 0 or give the "
    "parameter bounds."
)
NEGATIVE = (
    "`joints[shoulder].damping` must not be negative, got -0.3 of -b, 95 % interval -0.3196 … "
    "-0.2804. Simulators refuse or ignore it."
)
REFUSED = [
    (
        {"shoulder": {"friction": "c"}},
        f"`joints[shoulder].friction` must be in N m, got c with c in rad/s². {ASK}",
    ),
    (
        {"slider": {"damping": "b"}},
        f"`joints[slider].damping` must be in N s/m, got b with b in N m s/rad. {ASK}",
    ),
    ({"shoulder": {"damping": "g"}}, IN_DEGREES),
    ({"shoulder": {"friction": "n"}}, PERHAPS_ZERO),
    ({"shoulder": {"damping": "-b"}}, NEGATIVE),
    ({"shoulder": {"damping": "b/(J - J)"}}, "`joints[shoulder].damping` must be finite, got inf"),
    (
        {"shoulder": {"damping": "bb"}},
        "`joints[shoulder].damping` must use declared names, got bb, at column 1:",
    ),
    (
        {"shoulder": {"damping": "b*t"}},
        "`joints[shoulder].damping` must use parameters only, got t.",
    ),
    (
        {"shoulder": {"damping": "b.__class__"}},
        "`joints[shoulder].damping` must not hold ., at column 2:",
    ),
    (
        {"shoulder": {"damping": None}},
        "`joints[shoulder].damping` must be a number or a formula of parameters, got None.",
    ),
    ({}, "`joints` must be a dict of attributes by joint, "),
    ({"wrist": {"damping": "b"}}, "`joints` must be one of shoulder, slider, got 'wrist'."),
]


@pytest.mark.parametrize(("joints", "message"), REFUSED)
def test_what_cannot_be_written_is_refused_and_nothing_is_written(robot, joints, message):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        exported(robot, joints)
    assert [path.name for path in robot.parent.iterdir()] == ["arm.urdf"]


def test_no_file_is_replaced(robot):
    with pytest.raises(ValueError, match="`path` must be a file that does not exist, got"):
        eoi.export_robot(KNOWN, robot, robot, {"shoulder": {"damping": "b"}})
    missing = robot.parent / "none" / "new.urdf"
    with pytest.raises(ValueError, match=r"`path` must be writable \(No such file"):
        eoi.export_robot(KNOWN, robot, missing, {"shoulder": {"damping": "b"}})


def test_a_plant_has_values_without_errors(robot):
    joints = {"slider": {"damping": "viscous"}}
    written = exported(robot, joints, DECLARED)
    assert written.parameters == {"slider.damping": 1.5}
    assert np.isnan(written.standard_errors["slider.damping"])
    with pytest.raises(ValueError, match="`result` must be a Plant or a result with an estimate"):
        exported(robot.with_name("other.urdf"), joints, 3.0)


def test_derived_quantities_can_be_written(robot):
    derived = KNOWN.physical(lambda p: {"torque": p.c * p.J}, units={"torque": "N m"})
    written = exported(robot, {"shoulder": {"friction": "torque"}}, derived)
    assert written.standard_errors["shoulder.friction"] == derived.standard_errors["torque"]


def test_bounds_of_parameters_do_not_hide_a_sign(robot):
    bounded = replace(KNOWN, lower=np.full(6, -1.0), upper=np.full(6, 9.0))
    with pytest.raises(ValueError, match="must not be negative"):
        exported(robot, {"shoulder": {"friction": "n"}}, bounded)
