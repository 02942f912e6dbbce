r"""Electro-mechanical positioning system (EMPS): a motor moving a load on a ball screw.

$M \ddot y = \tau - F_v \dot y - F_c\,\mathrm{sign}(\dot y) - \mathrm{offset}$

The parameters are the physical ones: the mass enters nonlinearly, and the iterations are
Gauss-Newton. Source of the model and of the measured data set: A. Janot, M. Gautier, M. Brunot,
*Data Set and Reference Models of EMPS*, Workshop on Nonlinear System Identification Benchmarks,
2019.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

from eoi_jax.models.plant import Plant, State


def positioning_system_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Acceleration of the load [m/s²]."""
    del t
    _, rate = x.y
    friction = p.viscous_friction * rate + p.coulomb_friction * jnp.sign(rate)
    return (u - friction - p.offset) / p.mass


def positioning_system(*, reference: bool = False) -> Plant:
    """The positioning system of the EMPS benchmark.

    Args:
        reference: the published values (IDIM-LS) instead of nominal values that differ by 40 %.

    Returns:
        Plant of relative degree 2 with dry friction; input ``force`` [N], output ``position`` [m].
    """
    published = {
        "mass": 95.1089,
        "viscous_friction": 203.5034,
        "coulomb_friction": 20.3935,
        "offset": -3.1648,
    }
    # Different factors: a common factor could be explained by a wrong gain of the force.
    factors = {"mass": 1.4, "viscous_friction": 0.6, "coulomb_friction": 0.6, "offset": 1.4}
    nominal = {key: value * factors[key] for key, value in published.items()}
    return Plant(
        positioning_system_dynamics,
        parameters=published if reference else nominal,
        relative_degree=2,
        inputs=("force",),
        outputs=("position",),
        bounds={"mass": (1e-3, np.inf)},  # f divides by it
        units={
            "mass": "kg",
            "viscous_friction": "N s/m",
            "coulomb_friction": "N",
            "offset": "N",
            "force": "N",
            "position": "m",
        },
        name="positioning system",
    )
