"""Which plants are evaluated in several threads, and what becomes of the tasks of the others."""

import threading

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.discovery.side_by_side import concurrently, map_in_threads, waits


def arm(t, x, u, p):
    bend = 0.3 * jnp.cos(x.y[0, 1])
    inertia = jnp.array([[p.first + 2.0 * bend, 0.2 + bend], [0.2 + bend, 0.2]])
    return jnp.linalg.solve(inertia, u)


ARM = eoi.Plant(arm, {"first": 1.0}, 2, inputs=("a", "b"), outputs=("one", "two"))


@pytest.mark.parametrize(
    "plant", [eoi.plants.pendulum(), eoi.plants.cascaded_tanks(), eoi.plants.positioning_system()]
)
def test_plants_of_elementary_functions_are_evaluated_in_several_threads(plant):
    assert not waits(plant)


def test_plants_that_solve_equations_are_not():
    assert waits(ARM)


@pytest.mark.slow
def test_a_discovery_of_a_plant_that_solves_equations_comes_to_an_end():
    """Two evaluations at once would wait for each other on two cores."""
    time, draw = 2e-3 * np.arange(3000), np.random.default_rng(0)
    torque = np.stack([np.sin(3.0 * time), 0.3 * np.cos(7.0 * time)], axis=1)
    clean = eoi.simulate(ARM, time, torque)
    noise = 1e-4 * draw.standard_normal(clean.outputs.shape)
    record = eoi.Record(time, torque, clean.outputs + noise, input_names=ARM.inputs,
                        output_names=ARM.outputs)  # fmt: skip
    found = eoi.discover(ARM, record, 0.3, ["input_delay", "input_dead_zone", "input_saturation"])
    assert found.effects == ()


@pytest.mark.parametrize("threads", [0, 2])
def test_results_come_in_order_and_errors_as_they_are(threads):
    def thread_of(number: int) -> tuple[int, int]:
        return number, threading.get_ident()

    got = map_in_threads(threads, thread_of, [3, 1, 2])
    assert [number for number, _ in got] == [3, 1, 2]
    with concurrently(threads, threading.get_ident) as there:
        got.append((0, there()))
    own = threading.get_ident()
    assert all((ident == own) == (threads == 0) for _, ident in got)
    with pytest.raises(ZeroDivisionError):
        map_in_threads(threads, lambda one: 1 / one, [0])
