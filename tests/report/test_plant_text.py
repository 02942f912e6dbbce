"""A plant prints as the model that it is."""

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest

import eoi_jax as eoi
from eoi_jax import Plant


def spring(t, x, u, p):
    position, speed = x.y
    return (u - p.damping * speed - p.stiffness * position) / p.mass


PLANT = Plant(
    spring,
    {"mass": 1.0, "damping": 2.0, "stiffness": 60.0},
    2,
    inputs=["force"],
    outputs=["position"],
    bounds={"mass": (0.0, 5.0)},
    fixed=("stiffness",),
    units={"force": "N", "position": "m", "mass": "kg"},
)


@pytest.mark.parametrize("written", [str, repr])
def test_a_plant_prints_channels_equations_and_parameters(written):
    assert written(PLANT).splitlines() == [
        "Plant `spring`: input force [N]; output position [m]",
        "  position'' = (force - damping·position' - stiffness·position)/mass",
        "",
        "parameter  value  bounds         unit",
        "mass           1  [0, 5]         kg",
        "damping        2",
        "stiffness     60          fixed",
    ]


def test_a_plant_of_text_with_internal_states_prints_their_equations():
    printed = str(eoi.plants.cascaded_tanks())
    assert "z' = -k1·sqrt(z) + k4·pump" in printed
    assert "upper_initial      5  [0, inf]" in printed


def test_a_model_without_formula_is_a_function_of_names():
    def counted(t, x, u, p):
        return u - p.a * jax.lax.fori_loop(
            0, x.y[0, 0].astype(int), lambda i, total: total + 1.0, 0.0
        )

    assert "y' = f(y, u, a)" in str(Plant(counted, {"a": 1.0}))


def test_printing_compiles_nothing():
    def own(t, x, u, p):
        return -p.a * jnp.tanh(x.y[0]) + u

    plant = Plant(own, {"a": 1.0})
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    try:
        assert "y' = -a·tanh(y) + u" in str(plant)
    finally:
        jax.monitoring.clear_event_listeners()
    assert not compiled


def test_traced_values_and_values_side_by_side_print_as_their_type():
    printed = []

    def looked_at(theta):
        printed.append(repr(PLANT.with_parameters(theta)))
        return theta

    jax.jit(looked_at)(jnp.ones(3))
    assert "mass       f64[3]  [0, 5]         kg" in printed[0]
    side_by_side = eqx.tree_at(lambda plant: plant.theta, PLANT, jnp.ones((4, 3)))
    assert "damping    f64[4,3]" in repr(side_by_side)
    assert "mass        None" in repr(eqx.filter(PLANT, lambda leaf: False))
