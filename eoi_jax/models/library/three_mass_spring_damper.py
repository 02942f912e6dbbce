r"""Three masses in series with springs between them, the first driven: eq. (18) of the paper.

$$\ddot y_1 = -a_2 y_1 + a_3 y_2 - a_4 \dot y_1 + a_1 u$$
$$\ddot y_2 = b_1 y_1 - b_2 y_2 + b_3 y_3 - b_4 \dot y_2$$
$$\ddot y_3 = c_1 y_2 - c_2 y_3 - c_3 \dot y_3$$
"""

from typing import Any

import jax.numpy as jnp

from eoi_jax.models.plant import Plant, State

_NOMINAL = {
    "a1": 5.0, "a2": 1100.0, "a3": 600.0, "a4": 1.5,
    "b1": 400.0, "b2": 666.67, "b3": 266.67, "b4": 1.0,
    "c1": 533.33, "c2": 533.33, "c3": 3.0,
}  # fmt: skip
_INCREMENTS = {
    "a1": 0.05, "a2": 10.0, "a3": -3.0, "a4": 1.0,
    "b1": -5.0, "b2": 12.0, "b3": 1.0, "b4": 0.4,
    "c1": -5.0, "c2": 5.0, "c3": 1.0,
}  # fmt: skip


def three_mass_spring_damper_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Eq. (18): accelerations of the three masses [m/s²]."""
    del t
    (y1, y2, y3), (v1, v2, v3) = x.y
    return jnp.stack([
        -p.a2 * y1 + p.a3 * y2 - p.a4 * v1 + p.a1 * u[0],
        p.b1 * y1 - p.b2 * y2 + p.b3 * y3 - p.b4 * v2,
        p.c1 * y2 - p.c2 * y3 - p.c3 * v3,
    ])  # fmt: skip


def three_mass_spring_damper(*, true: bool = False) -> Plant:
    """The paper's plant with three degrees of freedom, section 5.2.

    Args:
        true: the plant of the numerical experiment (nominal plus the paper's increments) instead
            of the nominal model.

    Returns:
        Plant of relative degree 2 in each of the outputs ``position_1`` … ``position_3`` [m];
        input ``force`` (the paper's u; its unit is not given, a1 scales it).
    """
    truth = {key: value + _INCREMENTS[key] for key, value in _NOMINAL.items()}
    units = dict.fromkeys(("a2", "a3", "b1", "b2", "b3", "c1", "c2"), "1/s²")
    units |= dict.fromkeys(("a4", "b4", "c3"), "1/s")
    units |= {f"position_{i}": "m" for i in (1, 2, 3)}
    return Plant(
        three_mass_spring_damper_dynamics,
        parameters=truth if true else _NOMINAL,
        relative_degree=2,
        inputs=("force",),
        outputs=("position_1", "position_2", "position_3"),
        units=units,
        name="three masses",
    )
