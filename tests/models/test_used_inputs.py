"""How inputs enter the equations of a plant."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import ActuatorLag, InputPlay, RateLimit
from eoi_jax.models.effects.products import input_actions
from eoi_jax.models.used_inputs import affine_inputs, product_inputs, used_inputs


@pytest.mark.parametrize(
    ("term", "affine"),
    [
        (lambda x, u: 2.0 * u[0] - u[1] + x.y[1], (True, True)),
        (lambda x, u: u[0] ** 2 + 3.0 * u[1], (False, True)),
        (lambda x, u: u[0] * u[1], (False, False)),
        (lambda x, u: jnp.maximum(u[0], 0.0) + u[1], (False, True)),
        (lambda x, u: jnp.sqrt(u[0]) + u[1], (False, True)),
        (lambda x, u: u[0] * x.y[0] + u[1] * jnp.sign(x.y[1]), (True, True)),
        (lambda x, u: u[0], (True, True)),
    ],
)
def test_inputs_are_affine_where_no_slope_depends_on_an_input(term, affine):
    plant = eoi.Plant(lambda t, x, u, p: p.a * term(x, u), {"a": 1.5}, 2, inputs=("u", "w"))
    assert tuple(affine_inputs(plant)) == affine


def test_an_input_that_drives_an_internal_state_squared_is_not_affine():
    def rate(t, x, u, p):
        return u**2 - x.z

    options = {"internal": rate, "internal_initial": [0.0]}
    plant = eoi.Plant(lambda t, x, u, p: p.a * x.z[0], {"a": 1.0}, **options)
    np.testing.assert_array_equal(affine_inputs(plant), [False])
    np.testing.assert_array_equal(used_inputs(plant), [[True]])
    assert affine_inputs(eoi.Plant(lambda t, x, u, p: p.a, {"a": 1.0}, inputs=())).size == 0


def test_an_input_that_only_multiplies_others_is_in_products_alone():
    """A boost converter: its duty multiplies the voltage and the current, its supply does not."""

    def converter(t, x, u, p):
        current, voltage = x.y[0]
        opened = 1.0 - u[0]
        return jnp.stack(
            [(u[1] - opened * voltage) / p.coil, (opened * current - voltage) / p.store]
        )

    plant = eoi.Plant(converter, {"coil": 2e-4, "store": 1e-4}, (1, 1), inputs=("duty", "supply"),
                      outputs=("current", "voltage"))  # fmt: skip
    np.testing.assert_array_equal(product_inputs(plant), [[True, False], [True, False]])
    duty, supply = input_actions(plant)
    assert [duty.fits(plant, j) for j in (0, 1)] == [True, True]
    assert [supply.fits(plant, j) for j in (0, 1)] == [False, True]


@pytest.mark.parametrize(
    ("effect", "affine"), [(ActuatorLag(), True), (RateLimit(), False), (InputPlay(), False)]
)
def test_a_plant_is_affine_in_an_input_with_a_linear_actuator_only(effect, affine):
    """Of a smoothed command a limit of the rate is not the smoothed ramp."""
    plant = eoi.Plant(lambda t, x, u, p: p.a * u[0] + u[1], {"a": 1.0}, inputs=("u", "w"))
    at = place(plant, effect, 0)
    plant = augmented(plant, [at], dict.fromkeys(at.names, 0.5))
    assert tuple(affine_inputs(plant)) == (affine, True)
