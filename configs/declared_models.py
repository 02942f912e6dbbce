"""Models that lack something, for `eoi discover`: what a user would write down first."""

from eoi_jax import Plant


def mass_with_viscous_friction(t, x, u, p):
    """A motor that moves a load: acceleration [m/s²]."""
    del t
    _, rate = x.y
    return (u - p.viscous_friction * rate) / p.mass


def positioning():
    """The positioning system without dry friction and without the offset of its drive."""
    return Plant(
        mass_with_viscous_friction,
        {"mass": 130.0, "viscous_friction": 120.0},
        relative_degree=2,
        inputs=("force",),
        outputs=("position",),
        bounds={"mass": (1e-3, float("inf"))},  # it divides
        units={"mass": "kg", "viscous_friction": "N s/m", "force": "N", "position": "m"},
        name="positioning system",
    )


def linear_oscillator(t, x, u, p):
    """Mass, spring and damper: acceleration [V/s²], the displacement is measured as a voltage."""
    del t
    displacement, rate = x.y
    return p.gain * u - p.damping * rate - p.stiffness * displacement


def oscillator():
    """The Silverbox as a linear oscillator."""
    return Plant(
        linear_oscillator,
        {"gain": 1.5e5, "damping": 60.0, "stiffness": 1.5e5},
        relative_degree=2,
        inputs=("drive",),
        outputs=("displacement",),
        units={
            "gain": "1/s²",
            "damping": "1/s",
            "stiffness": "1/s²",
            "drive": "V",
            "displacement": "V",
        },
        name="silverbox",
    )
