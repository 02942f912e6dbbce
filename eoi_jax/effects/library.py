"""The standard library of effects."""

from eoi_jax.effects.disturbance import ConstantOffset, Drift, SinusoidalDisturbance
from eoi_jax.effects.effect import AbstractEffect
from eoi_jax.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    CubicDamping,
    QuadraticDrag,
    StribeckFriction,
    ViscousFriction,
)
from eoi_jax.effects.inputs import (
    ActuatorLag,
    InputDeadZone,
    InputDelay,
    InputQuadratic,
    InputSaturation,
)
from eoi_jax.effects.memory import Hysteresis
from eoi_jax.effects.outflow import InternalOverflow, Leak, Overflow
from eoi_jax.effects.stiffness import (
    CubicStiffness,
    EndStop,
    FreePlay,
    Gravity,
    LinearStiffness,
    PositionRipple,
    QuadraticStiffness,
)


def standard() -> tuple[AbstractEffect, ...]:
    """Every canonical effect; `discover` tries those that fit the plant.

    Three names have several forms: `end_stop` (above, below), `input_quadratic` (odd, even) and
    `overflow` (of an output; of an internal state, caught in part or not at all).
    `AsymmetricViscousFriction` is not among them: |v| and a constant offset are hard to tell apart,
    and the offset is far more common. Name it in `effects` to have it tried.

    Returns:
        One object of each form.
    """
    return (
        ViscousFriction(),
        CoulombFriction(),
        AsymmetricFriction(),
        StribeckFriction(),
        QuadraticDrag(),
        CubicDamping(),
        LinearStiffness(),
        QuadraticStiffness(),
        CubicStiffness(),
        Gravity(),
        PositionRipple(),
        EndStop(+1),
        EndStop(-1),
        FreePlay(),
        ConstantOffset(),
        Drift(),
        SinusoidalDisturbance(),
        InputDeadZone(),
        InputSaturation(),
        InputDelay(),
        InputQuadratic(odd=True),
        InputQuadratic(odd=False),
        ActuatorLag(),
        Hysteresis(),
        Leak(),
        Overflow(),
        InternalOverflow(caught=True),
        InternalOverflow(caught=False),
    )
