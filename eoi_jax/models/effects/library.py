"""The standard library of effects."""

from eoi_jax.models.effects.capacity import RateAsymmetry, VaryingCapacity
from eoi_jax.models.effects.disturbance import ConstantOffset, Drift, SinusoidalDisturbance
from eoi_jax.models.effects.effect import AbstractEffect
from eoi_jax.models.effects.friction import (
    AsymmetricFriction,
    AsymmetricViscousFriction,
    CoulombFriction,
    CubicDamping,
    DisplacementDamping,
    InputDamping,
    InternalFriction,
    LoadFriction,
    QuadraticDrag,
    RateFriction,
    StribeckFriction,
    ViscousFriction,
)
from eoi_jax.models.effects.inputs import (
    ActuatorLag,
    CurrentLimit,
    ErrorSaturation,
    InputAsymmetry,
    InputDeadZone,
    InputDelay,
    InputModulation,
    InputPlay,
    InputQuadratic,
    InputRate,
    InputSaturation,
    InputYield,
    RateLimit,
    ValveFlow,
)
from eoi_jax.models.effects.memory import (
    Hysteresis,
    MaxwellElement,
    Relaxation,
    SecondMass,
    SecondNode,
)
from eoi_jax.models.effects.outflow import (
    InternalOverflow,
    Leak,
    Overflow,
    PowerLoss,
    Radiation,
    SaturatingLoss,
)
from eoi_jax.models.effects.products import Product
from eoi_jax.models.effects.series import CellsInSeries, SensorCurve, SensorLag
from eoi_jax.models.effects.stiffness import (
    CubicStiffness,
    EndStop,
    FreePlay,
    Gravity,
    GravityTilt,
    LinearStiffness,
    PositionRipple,
    QuadraticStiffness,
)


def standard() -> tuple[AbstractEffect, ...]:
    """Every canonical effect; `discover` tries those that fit the plant.

    Five names have several forms: `end_stop` (above, below), `gravity` and `gravity_tilt` (of an
    angle in radians, in degrees), `input_quadratic` (odd, even) and `overflow` (of an output; of an
    internal state, caught in part or not at all).

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
        InternalFriction(),
        LinearStiffness(),
        QuadraticStiffness(),
        CubicStiffness(),
        Gravity(),
        Gravity(degrees=True),
        GravityTilt(),
        GravityTilt(degrees=True),
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
        InputAsymmetry(),
        ActuatorLag(),
        Hysteresis(),
        Leak(),
        Overflow(),
        InternalOverflow(caught=True),
        InternalOverflow(caught=False),
    )


def wider() -> tuple[AbstractEffect, ...]:
    """Effects that `discover` tries in free runs alone, where nothing else is an answer.

    Products of signals, damping with the square of the displacement, with the size of the input,
    dry friction with that, or of a motion of which the output is the speed, a second mass (damped
    in the spring, in its bearing), a second store, a spring and a damper in series, a loss with a
    power of the output, one that saturates, radiation, a yield law, a limited control error, a
    limited current, a valve, a limited rate of the actuator, a response to the rate of the input, a
    lag of the sensor, cells in series (two; a fit goes on to 3, 6 and 12), a capacity that varies,
    a rate that differs between rising and falling, a bent sensor.

    Returns:
        One object of each form.
    """
    return (
        Product("u", "y"),
        Product("u", "v"),
        Product("y", "v"),
        Product("y", "y"),
        Product("u", "y", "y"),
        Product("y", "y", "y"),
        Product("y", "v", "v"),
        DisplacementDamping(),
        InputDamping(),
        LoadFriction(),
        RateFriction(),
        SecondMass(),
        SecondMass(in_bearing=True),
        SecondNode(),
        MaxwellElement(),
        PowerLoss(),
        SaturatingLoss(),
        Radiation(celsius=False),
        Radiation(celsius=True),
        InputYield(),
        ErrorSaturation(),
        CurrentLimit(of_position=False),
        CurrentLimit(of_position=True),
        ValveFlow(),
        RateLimit(),
        InputPlay(),
        InputRate(),
        SensorLag(),
        CellsInSeries(),
        VaryingCapacity("linear"),
        VaryingCapacity("even"),
        VaryingCapacity("power"),
        RateAsymmetry(),
        SensorCurve(),
    )


def rare() -> tuple[AbstractEffect, ...]:
    """Effects that `discover` tries only where the standard ones leave a residual unexplained.

    Viscous friction that differs between the two directions: |v| is hard to distinguish from a
    constant offset, which is far more common. Relaxation of an output that shows its input at once:
    where that takes all of the input it is a lag of the actuator.

    Returns:
        One object of each form.
    """
    return (AsymmetricViscousFriction(), Relaxation())


def on_request() -> tuple[AbstractEffect, ...]:
    """Effects that `discover` tries where they are asked for by name.

    A gain of an input that follows the past of an input (a fit goes on to a store that both move):
    of a rig with a lag it may stand in for most characteristics of an actuator.

    Returns:
        One object of each form.
    """
    return (InputModulation(),)
