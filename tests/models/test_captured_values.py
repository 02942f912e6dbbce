"""A model with a constant from outside, which changes between two plants, as in a notebook."""

import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.captured_values import with_present_values

GRAVITY = 9.81
TABLE = np.array([0.0, 1.0])
SIZES = {"mass": [2.0]}


def drag(rate):
    return GRAVITY * rate


def falling(t, x, u, p):
    return -p.a * drag(x.y[0]) + jnp.interp(u, jnp.asarray([0.0, 1.0]), TABLE) * SIZES["mass"][0]


def plant():
    return eoi.Plant(falling, {"a": 0.1}, relative_degree=1)


def end(model):
    time = np.arange(0.0, 1.0, 0.01)
    return float(eoi.simulate(model, time, np.ones_like(time), initial=0.0).outputs[-1, 0])


def reached(gravity, level=1.0, mass=2.0):
    rate = 0.1 * gravity
    return level * mass / rate * (1.0 - np.exp(-rate * 0.99))


def test_a_plant_has_the_values_of_its_time(monkeypatch):
    assert end(plant()) == pytest.approx(reached(9.81), rel=1e-6)
    monkeypatch.setitem(globals(), "GRAVITY", 1.62)  # read by a function that the model calls
    assert end(plant()) == pytest.approx(reached(1.62), rel=1e-6)
    monkeypatch.setitem(globals(), "TABLE", np.array([0.0, 3.0]))
    assert end(plant()) == pytest.approx(reached(1.62, 3.0), rel=1e-6)
    SIZES["mass"][0] = 5.0
    try:
        assert end(plant()) == pytest.approx(reached(1.62, 3.0, 5.0), rel=1e-6)
    finally:
        SIZES["mass"][0] = 2.0


def test_equal_values_are_one_model_and_are_compiled_once(monkeypatch):
    first = plant()
    monkeypatch.setitem(globals(), "GRAVITY", 3.7)
    second = plant()
    assert second.dynamics is not first.dynamics
    assert plant().dynamics is second.dynamics
    assert second.with_parameters({"a": 1.0}).dynamics is second.dynamics
    monkeypatch.undo()
    assert plant().dynamics is first.dynamics


def test_a_closure_is_read_too():
    models = []
    for gain in (1.0, 2.0):

        def model(t, x, u, p):
            return gain * u - p.a * x.y[0]  # noqa: B023

        models.append(eoi.Plant(model, {"a": 1.0}, relative_degree=1))
    assert end(models[1]) == pytest.approx(2.0 * (1.0 - np.exp(-0.99)), rel=1e-6)

    gain = 4.0
    again = eoi.Plant(model, {"a": 1.0}, relative_degree=1)
    assert end(again) == pytest.approx(4.0 * (1.0 - np.exp(-0.99)), rel=1e-6)


def test_a_changed_plant_keeps_its_name_and_can_be_pickled(monkeypatch):
    plant()
    monkeypatch.setitem(globals(), "GRAVITY", 5.0)
    copied = pickle.loads(pickle.dumps(plant()))
    assert copied.name == "falling"
    assert end(copied) == pytest.approx(reached(5.0), rel=1e-6)


def test_what_is_no_function_stays():
    assert with_present_values(None) is None
    assert with_present_values(np.sin) is np.sin
