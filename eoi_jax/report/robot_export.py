"""Identified parameters in the joints of a robot description, URDF or MJCF."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax._checks import check, real
from eoi_jax.models.equations.expression import (
    Expression,
    Number,
    Operation,
    Symbol,
    symbols_of,
    value_of,
)
from eoi_jax.models.equations.parser import parse
from eoi_jax.models.export.files import write_content
from eoi_jax.models.export.joints import RobotFile, read_robot
from eoi_jax.models.units import Dimension, dimension
from eoi_jax.report.parameters import LEVEL, estimate_of
from eoi_jax.uncertainty.uncertainty import Uncertainty

JointMap = Mapping[str, Mapping[str, Any]]


def export_robot(result: Any, robot: str | Path, path: str | Path, joints: JointMap) -> Uncertainty:
    """Write a robot description whose joints have identified friction, damping, inertia, stiffness.

    The file is a copy of `robot` in which these attributes are set, in double precision; everything
    else keeps every byte. In URDF they are ``damping`` and ``friction`` of ``<dynamics>``, which is
    added where it is missing; in MJCF ``damping``, ``frictionloss``, ``armature`` and ``stiffness``
    of ``<joint>``, where they override those of a default class. Units are SI: N m s/rad, N m,
    kg m² and N m/rad of a joint that turns, N s/m, N, kg and N/m of one that slides. They are
    compared with the units of the parameters where a value is a product of parameters; a note says
    where they are not known.

    Args:
        result: of `identify`, `refine`, `discover` or `uncertainty`; or a `Plant`.
        robot: URDF or MJCF file; files that it includes are not read.
        path: of the file to write, which does not exist; relative paths in `robot` hold in the same
            folder only.
        joints: attributes by joint, and for each attribute a number, or a formula of parameters as
            in a model of text: ``{"shoulder": {"damping": "b*J", "friction": "c*J"}}``.

    Returns:
        The values that were written, as ``joint.attribute``, with standard errors and intervals.

    Raises:
        ValueError: no XML, neither URDF nor MJCF, an unknown joint, attribute or parameter, a value
            that is negative or not finite, a unit that is another one, a file that exists.

    Source: URDF, http://wiki.ros.org/urdf/XML/joint; MJCF,
        https://mujoco.readthedocs.io/en/stable/XMLreference.html; errors by the delta method.
    """
    estimates, path = estimate_of(result), Path(path)
    check(not path.exists(), "path", "must be a file that does not exist", path)
    rule = 'must be a dict of attributes by joint, {"shoulder": {"damping": "b"}}'
    good = isinstance(joints, Mapping) and all(isinstance(row, Mapping) for row in joints.values())
    check(good and any(joints.values()), "joints", rule, joints)
    file = read_robot(robot)
    targets = tuple(_targets(file, estimates, joints))
    written = _quantities(estimates, targets)
    _check_signs(written, targets)
    notes = [note for target in targets for note in _unit_notes(target, estimates.units)]
    content: dict[str, dict[str, float]] = {}
    for target in targets:
        content.setdefault(target.joint, {})[target.attribute] = written.parameters[target.name]
    write_content(path, file.with_values(content))
    return replace(written, unclear=tuple(notes))


@dataclass(frozen=True)
class _Target:
    """An attribute of a joint, and the formula of its value.

    Attributes:
        joint, attribute: names.
        unit: of the attribute in the file; "" where a default decides what the joint is.
        text, formula: as given, and its tree; its symbols are parameters.
    """

    joint: str
    attribute: str
    unit: str
    text: str
    formula: Expression

    @property
    def name(self) -> str:
        return f"{self.joint}.{self.attribute}"

    @property
    def field(self) -> str:
        return f"joints[{self.joint}].{self.attribute}"

    def value(self, values: Mapping[str, Any], m: Any) -> Any:
        """The value of the formula, from those of the parameters."""
        return value_of(self.formula, {Symbol(name): value for name, value in values.items()}, m)


def _targets(file: RobotFile, estimates: Uncertainty, joints: JointMap) -> Iterator[_Target]:
    names = {name: Symbol(name) for name in estimates.parameters}
    for joint, attributes in joints.items():
        file.check_joint(joint)
        for attribute, entry in attributes.items():
            file.check_attribute(joint, attribute)
            field = f"joints[{joint}].{attribute}"
            number = not isinstance(entry, str)
            rule = "must be a number or a formula of parameters"
            check(not number or np.isfinite(real(entry)), field, rule, entry)
            formula = Number(float(entry)) if number else parse(entry, names, field)
            strangers = [symbol.name for symbol in symbols_of(formula) if symbol.name not in names]
            check(not strangers, field, "must use parameters only", ", ".join(strangers))
            yield _Target(joint, attribute, file.unit(joint, attribute), str(entry), formula)


def _quantities(estimates: Uncertainty, targets: Sequence[_Target]) -> Uncertainty:
    """The values with their covariance."""
    theta = {name: np.float64(value) for name, value in estimates.parameters.items()}
    with np.errstate(all="ignore"):
        values = {target.name: float(target.value(theta, np)) for target in targets}
    for target in targets:
        value = values[target.name]
        check(bool(np.isfinite(value)), target.field, "must be finite", f"{value} of {target.text}")
    units = {target.name: target.unit for target in targets}
    quantities = estimates.physical(
        lambda p: {target.name: target.value(p._asdict(), jnp) for target in targets}, units
    )
    return replace(quantities, parameters=values)  # in double precision, whatever that of JAX


def _check_signs(written: Uncertainty, targets: Sequence[_Target]) -> None:
    intervals = written.intervals(LEVEL)
    for target in targets:
        value, (low, high) = written.parameters[target.name], intervals[target.name]
        text = f"{value:.6g} of {target.text}, {100 * LEVEL:g} % interval {low:.6g} … {high:.6g}"
        advice = "Simulators refuse or ignore it."
        if low <= 0.0 <= high:
            advice += " The interval contains 0: write 0 or give the parameter bounds."
        check(value >= 0.0, target.field, "must not be negative", text, advice)


# -- units ------------------------------------------------------------------------------------


def _unit_notes(target: _Target, units: Mapping[str, str]) -> Iterator[str]:
    """A sentence where the unit of a value is not known; an error where it is another one."""
    wanted, entry = dimension(target.unit), _dimension_of(target.formula, units)
    names = sorted(symbol.name for symbol in symbols_of(target.formula))
    if wanted is None or entry is None:
        if names:
            unit = f" in {target.unit}" if target.unit else " in SI units"
            yield f"{target.name}: {target.text} is taken to be{unit}; its unit is not known"
        return
    listed = ", ".join(f"{name} in {units[name]}" for name in names)
    rule = f"must be in {target.unit}"
    advice = "Multiply by what makes a force or torque of it, such as the inertia."
    check(entry.powers == wanted.powers, target.field, rule, f"{target.text} with {listed}", advice)
    equal = np.isclose(entry.factor, wanted.factor, rtol=1e-9)
    advice = f"Write ({target.text})*{entry.factor / wanted.factor:.10g}."
    check(bool(equal), target.field, rule, f"{target.text} with {listed}", advice)


def _dimension_of(formula: Expression, units: Mapping[str, str]) -> Dimension | None:
    """The unit of a product of parameters; None of what has numbers in it, whose unit they hide."""
    match formula:
        case Symbol(name=name):
            return dimension(units.get(name, ""))
        case Operation(sign="-", lhs=Number(value=0.0), rhs=rhs):
            return _dimension_of(rhs, units)
        case Operation(sign="*" | "/" as sign, lhs=lhs, rhs=rhs):
            first, second = _dimension_of(lhs, units), _dimension_of(rhs, units)
            if first is None or second is None:
                return None
            return first.times(second, 1 if sign == "*" else -1)
        case Operation(sign="^", lhs=lhs, rhs=Number(value=power)) if power == int(power):
            base = _dimension_of(lhs, units)
            return None if base is None else Dimension().times(base, int(power))
    return None
