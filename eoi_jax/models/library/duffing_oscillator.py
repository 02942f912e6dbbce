r"""Duffing oscillator, such as the electronic circuit of the Silverbox benchmark.

$\ddot y = \text{gain}\,u - \text{damping}\,\dot y - \text{stiffness}\,y -
\text{cubic\_stiffness}\,y^3 + \text{offset}$

Source of the measured data set: T. Wigren, J. Schoukens, *Three free data sets for development and
benchmarking in nonlinear system identification*, European Control Conference 2013.
"""

from typing import Any

from eoi_jax.models.plant import Plant, State


def duffing_oscillator_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Acceleration [V/s²]; the displacement is measured as a voltage."""
    del t
    y, rate = x.y
    spring = p.stiffness * y + p.cubic_stiffness * y**3
    return p.gain * u - p.damping * rate - spring + p.offset


def duffing_oscillator(*, reference: bool = False) -> Plant:
    """The Silverbox circuit.

    Args:
        reference: values near the optimum (regression on spectral derivatives of the record)
            instead of a rough linear guess without cubic stiffness or offset.

    Returns:
        Plant of relative degree 2; input ``drive`` [V], output ``displacement`` [V].
    """
    guess = {
        "gain": 1.5e5,
        "damping": 60.0,
        "stiffness": 1.5e5,
        "cubic_stiffness": 0.0,
        "offset": 0.0,
    }
    fitted = {
        "gain": 1.861e5,
        "damping": 41.93,
        "stiffness": 1.850e5,
        "cubic_stiffness": 6.48e5,
        "offset": -991.0,
    }
    return Plant(
        duffing_oscillator_dynamics,
        parameters=fitted if reference else guess,
        relative_degree=2,
        inputs=("drive",),
        outputs=("displacement",),
        units={
            "gain": "1/s²",
            "damping": "1/s",
            "stiffness": "1/s²",
            "cubic_stiffness": "1/(s² V²)",
            "offset": "V/s²",
            "drive": "V",
            "displacement": "V",
        },
        name="Duffing oscillator",
    )
