"""Rigs with published parameters or errors: models with the friction that their sources declare.

`measured_cases.py` has the same rigs as declared without it, for discovery.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import eoi_jax as eoi
from benchmarks.measured.measured_cases import (
    Case,
    air_track_mass,
    dfki_double_pendulum,
    dfki_simple_pendulum,
    double_pendulum,
    driven_pendulum,
    free_mass,
    free_pendulum,
    hinge_pendulum,
)


@dataclass(frozen=True)
class Rig:
    """A case beside what is published of it.

    Attributes:
        case: the model with its friction, records, split.
        reference: published parameters by name. source: whose, in a word.
        remark: what to know of them.
    """

    case: Case
    reference: Mapping[str, float]
    source: str
    remark: str


# -- DFKI: double pendulum, two designs; pendulum ---------------------------------------------

# Of both designs the README lists these beside the moments that `measured_cases` starts from.
_FRICTION = {"C1": (0.001, 0.001, 0.16, 0.12), "A0": (0.001, 0.001, 0.093, 0.078)}
_AWAY = 0.7  # start: share of the published values


def double_pendulum_with_friction(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    """Torque of joint j: u_j − d_j q_j' − c_j sign q_j' (README of the set)."""
    rate = x.y[1]
    damping = jnp.stack([p.damping_1, p.damping_2])
    friction = jnp.stack([p.friction_1, p.friction_2])
    return double_pendulum(t, x, u - damping * rate - friction * jnp.sign(rate), p)


def dfki_arm(folder: Path, design: str) -> Rig:
    """Published: mass parameters and friction of the design's model."""
    case = dfki_double_pendulum(folder, design)
    names = ("damping_1", "damping_2", "friction_1", "friction_2")
    units = {key: "N m s" if "damping" in key else "N m" for key in names}
    reference = case.plant.parameters | dict(zip(names, _FRICTION[design], strict=True))
    start = {key: _AWAY * value for key, value in reference.items()}
    plant = _extended(case.plant, double_pendulum_with_friction, start, units)
    remark = "Published: the mass parameters and frictions of the model that its owners control by."
    return Rig(replace(case, plant=plant), reference, "published", remark)


def pendulum_with_friction(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    rate = x.y[1]
    return driven_pendulum(t, x, u - p.friction * jnp.sign(rate) - p.offset, p)


def dfki_pendulum(folder: Path) -> Rig:
    """Published: inertia and moment from the parameter files; friction belongs to another rig."""
    case = dfki_simple_pendulum(folder)
    nominal = {"inertia": 0.169, "moment": 0.338}
    start = {key: _AWAY * value for key, value in nominal.items()}
    start |= {"damping": 0.03, "friction": 0.1, "offset": 0.0}
    plant = _extended(
        case.plant, pendulum_with_friction, start, {"friction": "N m", "offset": "N m"}
    )
    remark = "Nominal: from the parameter files; no friction is published for this mounting."
    return Rig(replace(case, plant=plant), nominal, "nominal", remark)


# -- Schmidt and Lipson: free oscillators -----------------------------------------------------


def damped_mass(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    return free_mass(t, x, u, p) - p.damping * x.y[1] + p.offset


def damped_pendulum(t: Any, x: eoi.State, u: Any, p: Any) -> Any:
    return free_pendulum(t, x, u, p) - p.damping * x.y[1]


def air_track(folder: Path) -> Rig:
    """README: regression of the accelerations that the authors supply."""
    case = air_track_mass(folder)
    start = {"stiffness": 5.0, "damping": 0.0, "offset": 0.0}
    units = {"damping": "1/s", "offset": "video unit/s²"}
    plant = _extended(case.plant, damped_mass, start, units)
    remark = "README: regression on the accelerations that its authors smoothed."
    return Rig(replace(case, plant=plant), {"stiffness": 6.035}, "README", remark)


def hinge(folder: Path) -> Rig:
    """README: as on the air track, in the record's own time."""
    case = hinge_pendulum(folder)
    start = {"gravity": 1.0, "damping": 0.0}
    plant = _extended(case.plant, damped_pendulum, start, {})
    remark = (
        "README: regression on the authors' smoothed derivatives; their rate is 4 % below the "
        "difference quotient of the angle, which is worth 8 % of this parameter."
    )
    return Rig(replace(case, plant=plant), {"gravity": 1.262}, "README", remark)


def _extended(
    plant: eoi.Plant,
    dynamics: Callable[..., Any],
    start: Mapping[str, float],
    units: Mapping[str, str],
) -> eoi.Plant:
    return eoi.Plant(
        dynamics, dict(start), plant.relative_degree, plant.inputs, plant.outputs,
        units={**plant.units, **units},
        bounds={key: (1e-3, np.inf) for key in start if "inertia" in key},
    )  # fmt: skip


RIGS: Mapping[str, Callable[[Path], Rig]] = {
    "dfki_double_pendulum, C.1": lambda folder: dfki_arm(folder, "C1"),
    "dfki_double_pendulum, A.0": lambda folder: dfki_arm(folder, "A0"),
    "dfki_simple_pendulum": dfki_pendulum,
    "schmidt_lipson, one mass": air_track,
    "schmidt_lipson, pendulum": hinge,
}
