"""Equations in traced functions: traced once, the same values, and not kept for ever."""

import gc
import weakref

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun

import eoi_jax as eoi
from eoi_jax.models.augmented import augmented
from eoi_jax.models.effects import CoulombFriction
from eoi_jax.models.placements import placements
from eoi_jax.models.traced_equations import _traced_once
from eoi_jax.refinement.first_runs import first_runs
from eoi_jax.refinement.spans import spans_of


class Counted:
    """A mass behind a spring, and how often Python evaluates it."""

    def __init__(self):
        self.calls = 0

    def __call__(self, t, x, u, p):
        self.calls += 1
        return (u - p.damping * x.y[1] - p.stiffness * jnp.sin(x.y[0])) / p.mass


def plant_of(equations):
    values = {"mass": 1.3, "damping": 0.4, "stiffness": 5.0}
    return eoi.Plant(equations, values, 2, ("force",), ("position",))


POINT = (
    jnp.asarray(0.3, float),
    eoi.State(jnp.asarray([[0.2], [-0.5]]), jnp.zeros(0)),
    jnp.asarray([0.7]),
)


def test_they_are_traced_once_for_values_derivatives_and_batches():
    equations = Counted()
    plant, (t, x, u) = plant_of(equations), POINT
    calls = equations.calls

    def f(theta):
        return plant.derivative(t, x, u, theta)

    theta = jnp.asarray(plant.theta)
    for function in (f, jax.jacfwd(f), lambda theta: f(theta) + f(2.0 * theta)):
        jax.make_jaxpr(function)(theta)
    jax.make_jaxpr(jax.vmap(f))(jnp.stack([theta, theta]))
    assert equations.calls == calls


def test_a_fit_evaluates_equal_equations_no_more():
    """Other values, and effects that were added anew, are the same equations."""
    equations = Counted()
    plant, time = plant_of(equations), 0.02 * np.arange(200)
    record = eoi.Record(time, np.sin(3.0 * time), 0.1 * np.sin(2.0 * time), hold="zero")
    (placed,) = placements(plant, [CoulombFriction()])

    def begun(mass: float, level: float):
        moved = plant.with_parameters({"mass": mass})
        model = augmented(moved, (placed,), dict.fromkeys(placed.names, level))
        return first_runs(model, [record], spans_of([record], None), 2)

    begun(1.3, 0.1)
    calls = equations.calls
    begun(1.5, 0.2)
    assert equations.calls == calls


def test_their_values_are_those_of_python():
    plant, (t, x, u) = plant_of(Counted()), POINT
    theta = jnp.asarray(plant.theta)
    direct = plant.derivative(t, x, u, theta)
    np.testing.assert_allclose(
        jax.jit(lambda *args: plant.derivative(*args))(t, x, u, theta), direct, rtol=1e-15
    )


def test_equations_without_a_hash_are_traced_each_time():
    class Listed(Counted):
        __hash__ = None  # type: ignore[assignment]

    plant, (t, x, u) = plant_of(Listed()), POINT
    theta = jnp.asarray(plant.theta)
    found = jax.make_jaxpr(lambda *args: plant.derivative(*args))(t, x, u, theta)
    value = jaxpr_as_fun(found)(t, x.y, x.z, u, theta)[0]
    np.testing.assert_allclose(value, plant.derivative(t, x, u, theta), rtol=1e-15)


def test_models_of_long_ago_are_forgotten():
    def traced(equations):
        plant = plant_of(equations)
        jax.make_jaxpr(lambda *args: plant.derivative(*args))(*POINT, jnp.asarray(plant.theta))

    equations = Counted()
    kept = weakref.ref(equations)
    traced(equations)
    del equations
    most = _traced_once.cache_info().maxsize or 0
    for _ in range(most):
        traced(Counted())
    assert _traced_once.cache_info().currsize <= most
    gc.collect()
    assert kept() is None
