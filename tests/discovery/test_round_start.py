"""What a round of discovery starts from."""

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.round_start import physical
from eoi_jax.models.augmented import augmented, place

MASS = eoi.Plant(lambda t, x, u, p: u[0] - p.k * x.y[0], {"k": 4.0}, 2)


def test_parameters_of_a_set_without_another_effect_stay_physical():
    """Left alone, a rise of Stribeck friction may be negative: the model must still be made."""
    placed = place(MASS, effects.StribeckFriction(), 0)
    numbers = physical(placed, (0.4, -29.0, 0.1))
    assert numbers == (0.4, 0.0, 0.1)
    plant = augmented(MASS, [placed], dict(zip(placed.names, numbers, strict=True)))
    assert plant.parameters["stribeck_friction_rise"] == 0.0
