r"""A pivoted arm lifted by a propeller: a pendulum driven by a quadratic thrust.

$\ddot\vartheta = -a \sin\vartheta - b\,\dot\vartheta + c\,u|u| + \text{offset}$,
angle in radians from the hanging position, u the command as a fraction of its full range.
"""

from typing import Any

import jax.numpy as jnp

from eoi_jax.models.plant import Plant, State


def propeller_arm_dynamics(t: Any, x: State, u: Any, p: Any) -> Any:
    """Angular acceleration [rad/s²]."""
    del t
    angle, rate = x.y
    return -p.a * jnp.sin(angle) - p.b * rate + p.c * u * jnp.abs(u) + p.offset


def propeller_arm(*, reference: bool = False) -> Plant:
    """The quarter drone: a propeller on a pivoted arm.

    Args:
        reference: values near the optimum (regression on the record of steps, with the command
            delayed by 0.1 s, which this model does not contain) instead of a rough guess.

    Returns:
        Plant of relative degree 2; input ``command`` [1], output ``angle`` [rad].
    """
    guess = {"a": 6.0, "b": 0.5, "c": 30.0, "offset": 0.0}
    fitted = {"a": 8.08, "b": 0.73, "c": 41.6, "offset": -0.18}
    return Plant(
        propeller_arm_dynamics,
        parameters=fitted if reference else guess,
        relative_degree=2,
        inputs=("command",),
        outputs=("angle",),
        units={
            "a": "1/s²",
            "b": "1/s",
            "c": "rad/s²",
            "offset": "rad/s²",
            "command": "1",
            "angle": "rad",
        },
        name="propeller arm",
    )
