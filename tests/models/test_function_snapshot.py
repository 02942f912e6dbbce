"""A model with numbers from outside, which change between two plants, as in a notebook."""

import pickle
import types

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.function_snapshot import FunctionSnapshot

GRAVITY = 9.81
TABLE = np.full(200_000, 1.0)
SIZES = {"mass": [2.0]}


def drag(rate):
    return GRAVITY * rate


def falling(t, x, u, p):
    return -p.a * drag(x.y[0]) + u * jnp.asarray(TABLE)[7] * SIZES["mass"][0]


def plant():
    return eoi.Plant(falling, {"a": 0.1}, relative_degree=1)


def end(model, level=1.0):
    time = np.arange(0.0, 1.0, 0.01)
    inputs = np.full_like(time, level)
    return float(eoi.simulate(model, time, inputs, initial=0.0, hold="zero").outputs[-1, 0])


def reached(gravity, level=1.0, mass=2.0):
    rate = 0.1 * gravity
    return level * mass / rate * (1.0 - np.exp(-rate * 0.99))


def test_a_plant_has_the_values_of_its_time_in_every_call(monkeypatch):
    first = plant()
    assert end(first) == pytest.approx(reached(9.81), rel=1e-6)
    monkeypatch.setitem(globals(), "GRAVITY", 1.62)  # read by a function that the model calls
    monkeypatch.setitem(SIZES, "mass", [5.0])
    try:
        TABLE[:] = 3.0
        second = plant()
        jax.clear_caches()
        assert end(first.with_parameters({"a": 0.2})) == pytest.approx(reached(19.62), rel=1e-6)
        rolled = eoi.rollout(first, None, None, np.ones(100), 0.01)
        assert float(rolled.y[-1, 0, 0]) == pytest.approx(reached(9.81), rel=1e-6)
    finally:
        TABLE[:] = 1.0
    assert end(second) == pytest.approx(reached(1.62, 3.0, 5.0), rel=1e-6)


def test_equal_values_are_one_model_and_are_compiled_once(monkeypatch):
    first = plant()
    monkeypatch.setitem(globals(), "GRAVITY", 3.7)
    second = plant()
    assert second.dynamics != first.dynamics
    assert plant().dynamics == second.dynamics
    assert second.with_parameters({"a": 1.0}).dynamics is second.dynamics
    assert second.declared_anew({"a": 1.0}).dynamics is second.dynamics
    monkeypatch.undo()
    assert plant().dynamics == first.dynamics
    assert hash(plant().dynamics) == hash(first.dynamics)


def test_functions_with_derivatives_of_their_authors_are_compiled_once():
    def smooth(t, x, u, p):
        return u - p.a * jax.nn.relu(x.y[0])

    first, second = (eoi.Plant(smooth, {"a": 1.0}) for _ in range(2))
    assert first.dynamics == second.dynamics


def test_a_derivative_of_the_authors_is_read_too():
    steepness = 1.0

    def model(t, x, u, p):
        @jax.custom_jvp
        def step(y):
            return jnp.where(y > 0, 1.0, 0.0)

        slope = steepness
        step.defjvp(lambda y, dy: (step(*y), slope * dy[0]))
        return u - p.a * step(x.y[0])

    first = eoi.Plant(model, {"a": 1.0})
    steepness = 2.0
    assert eoi.Plant(model, {"a": 1.0}).dynamics != first.dynamics


class Callable:
    factor = 1.0

    def __init__(self, rate):
        self.rate = rate

    def __call__(self, t, x, u, p):
        return u - p.a * self.rate * self.factor * x.y[0]

    def method(self, t, x, u, p):
        return self(t, x, u, p)


def test_attributes_of_objects_of_classes_and_of_modules_are_read(monkeypatch):
    model, module = Callable(1.0), types.ModuleType("sizes")

    def by_module(t, x, u, p):
        return u - p.a * module.rate * x.y[0]

    for rate in (1.0, 2.0, 1.0, 3.0):
        model.rate = rate
        monkeypatch.setattr(module, "rate", rate, raising=False)
        for function in (model, model.method, Callable(rate), by_module):
            assert end(eoi.Plant(function, {"a": 0.1})) == pytest.approx(
                reached(rate, 1.0, 1.0), rel=1e-6
            )
    monkeypatch.setattr(Callable, "factor", 2.0)
    assert end(eoi.Plant(model, {"a": 0.1})) == pytest.approx(reached(6.0, 1.0, 1.0), rel=1e-6)


class Module(eqx.Module):
    rate: jax.Array

    def __call__(self, t, x, u, p):
        return u - p.a * self.rate[0] * x.y[0]


def test_modules_with_arrays_are_models():
    for rate in (1.0, 2.0):
        module = Module(jnp.array([rate]))
        for function in (module, module.__call__):
            assert end(eoi.Plant(function, {"a": 0.1})) == pytest.approx(
                reached(rate, 1.0, 1.0), rel=1e-6
            )


def test_all_functions_of_a_plant_are_read():
    gain, rate, start = 1.0, 1.0, 0.0

    def lagging():
        return eoi.Plant(
            lambda t, x, u, p: p.a * x.z[0] - x.y[0],
            {"a": 1.0},
            internal=lambda t, x, u, p: rate * (u - x.z),
            internal_initial=lambda p: [start * p.a],
            actuator=lambda t, u, p: gain * u,
        )

    def after(model):  # z of a constant input, and y of both lags
        return float(model.internal_start(jnp.ones(1))[0]), end(model)

    values = [after(lagging())]
    gain = 2.0
    values.append(after(lagging()))
    gain, rate = 1.0, 3.0
    values.append(after(lagging()))
    rate, start = 1.0, 4.0
    values.append(after(lagging()))
    assert len(set(values)) == 4
    start = 0.0
    assert after(lagging()) == values[0]


def test_an_actuator_that_changed_is_refused_where_it_must_be_read_again():
    gain = 1.0
    model = eoi.Plant(
        lambda t, x, u, p: u - p.a * x.y[0], {"a": 1.0}, actuator=lambda t, u, p: gain * u
    )
    assert end(model) == pytest.approx(1.0 - np.exp(-0.99), rel=1e-6)
    gain = 2.0
    assert end(model, 2.0) == pytest.approx(2.0 - 2.0 * np.exp(-0.99), rel=1e-6)
    with pytest.raises(ValueError, match="`actuator` must read the same values outside"):
        eoi.simulate(model, np.arange(0.0, 2.0, 0.01), np.ones(200), initial=0.0)


def test_a_changed_plant_keeps_its_name_and_can_be_pickled(monkeypatch):
    plant()
    monkeypatch.setitem(globals(), "GRAVITY", 5.0)
    copied = pickle.loads(pickle.dumps(plant()))
    assert copied.name == "falling"
    assert end(copied) == pytest.approx(reached(5.0), rel=1e-6)


def test_what_is_no_function_of_the_user_stays():
    library = eoi.plants.mass_spring_damper()
    assert not isinstance(library.dynamics, FunctionSnapshot)
    assert library.internal is None
