r"""One mass, spring and damper, eq. (21) of the paper.

$\ddot y = -\alpha y - \beta\,\dot y + \rho\,u$
"""

from typing import Any

from eoi_jax.models.plant import Plant, State


def mass_spring_damper_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Eq. (21): acceleration [m/s²]."""
    del t
    position, rate = x.y
    return -p.alpha * position - p.beta * rate + p.rho * u


def mass_spring_damper(*, true: bool = False) -> Plant:
    """The paper's plant for the comparison with other methods, section 6.

    Args:
        true: the final values of the paper instead of its initial values, those of the system
            identification toolbox.

    Returns:
        Plant of relative degree 2; input ``voltage`` [V], output ``position`` [m].
    """
    nominal = {"alpha": 174.2, "beta": 12.570, "rho": 2.567}
    truth = {"alpha": 140.903, "beta": 10.0086, "rho": 2.249}
    return Plant(
        mass_spring_damper_dynamics,
        parameters=truth if true else nominal,
        relative_degree=2,
        inputs=("voltage",),
        outputs=("position",),
        units={
            "alpha": "1/s²",
            "beta": "1/s",
            "rho": "m/(s² V)",
            "voltage": "V",
            "position": "m",
        },
        name="mass, spring and damper",
    )
