r"""Level of a tank with a pump and an orifice, eqs. (15)-(17) of the paper.

$\dot x = -\alpha \sqrt{2 g x} + \beta V$, with $\alpha = a/A$, $\beta = k/A$ (orifice over tank
area, pump constant over tank area) and $g$ = 9.81 m/s², known.
"""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from eoi_jax.models.plant import Plant, State

GRAVITY = 9.81  # [m/s²]


def square_root(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """√max(x, 0), with derivative 0 (not infinite or NaN) for x ≤ 0.

    An empty tank has no outflow, and regressors and sensitivities must not become NaN when a noisy
    level or an intermediate stage of a solver falls below zero.
    """
    wet = x > 0
    # The inner `where` keeps the derivative of the branch not taken finite.
    return jnp.where(wet, jnp.sqrt(jnp.where(wet, x, 1.0)), 0.0)


def level_tank_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Eq. (16): rate of the level [m/s]."""
    del t
    return -p.alpha * square_root(2.0 * GRAVITY * x.y[0]) + p.beta * u


def level_tank(*, true: bool = False) -> Plant:
    """The paper's level tank, section 5.1.

    Args:
        true: the plant of the numerical experiment (nominal plus the paper's increments) instead
            of the nominal model. The increment of α is +1: the paper's text says −1, which
            contradicts its Table 1 and would make the outflow an inflow.

    Returns:
        Plant of relative degree 1; input ``voltage`` [V], output ``level`` [m].
    """
    nominal = {"alpha": 0.6047, "beta": 3.0075e-3}
    truth = {"alpha": 0.6047 + 1.0, "beta": 3.0075e-3 + 0.5}
    return Plant(
        level_tank_dynamics,
        parameters=truth if true else nominal,
        relative_degree=1,
        inputs=("voltage",),
        outputs=("level",),
        units={"alpha": "1", "beta": "m/(s V)", "voltage": "V", "level": "m"},
        name="level tank",
    )
