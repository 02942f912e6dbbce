"""A small force moves the simulation as the linear response says, also through stops."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.models.plant import State
from eoi_jax.simulation.integrator import free_run, frictional
from eoi_jax.simulation.linear_response import response_of
from eoi_jax.simulation.simulate import drive

PERIOD, SAMPLES = 0.01, 400
TIME = np.arange(SAMPLES + 1) * PERIOD
SMALL = 1e-5


def rubbing(t, x, u, p):
    return u[0] - p.friction * jnp.sign(x.y[1]) - 4.0 * x.y[0] + u[1]


def coupled(t, x, u, p):
    first, second = x.y[0]
    pull = p.stiffness * (second - first) + 0.3 * x.z[0]
    return (u[0] + pull - 0.2 * x.y[1, 0] + u[1], -pull - first**3 - 0.1 * x.y[1, 1] + u[2])


def lagging(t, x, u, p):
    return (-5.0 * x.z[0] + x.y[1, 0],)


RUBBING = eoi.Plant(rubbing, {"friction": 0.6}, 2, ("u", "w"), ("y",))
COUPLED = eoi.Plant(
    coupled, {"stiffness": 9.0}, 2, ("u", "w", "w2"), ("y1", "y2"),
    internal=lagging, internal_initial=lambda p: np.array([0.1]),
)  # fmt: skip


def run(plant, force, substeps):
    """States at every step from rest; u is a sine."""
    u = np.concatenate([2.0 * np.sin(3.0 * TIME)[:, None], force], axis=1)
    driven = drive(TIME, u, "linear", substeps)
    theta = jnp.asarray(plant.theta)
    start = State(jnp.zeros((2, len(plant.outputs))), plant.internal_start(theta))
    every = type(driven)(driven.time, driven.step, driven.inputs, 1, driven.last)
    y, z = free_run(plant, theta, every, start, frictional(plant))
    return driven, np.asarray(y), np.asarray(z)


def response(plant, driven, y, z, substeps):
    time, inputs = np.asarray(driven.time)[None], np.asarray(driven.inputs)[None]
    step = np.array([float(driven.step)])
    return response_of(plant, time, inputs, y[None, :-1], z[None, :-1], step, substeps)


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [1, 3, 4])
@pytest.mark.parametrize(
    ("plant", "output"),
    [(RUBBING, 0), (COUPLED, 0), (COUPLED, 1)],
    ids=["stops", "coupled, first", "coupled, second"],
)
def test_the_response_is_the_derivative_of_the_simulation(plant, output, substeps):
    force = np.stack([np.cos(2.0 * TIME), 1.0 + 0.0 * TIME], axis=1)
    push = np.eye(len(plant.inputs) - 1)[output]
    driven, y, z = run(plant, np.zeros((len(TIME), len(push))), substeps)
    along = response(plant, driven, y, z, substeps)
    middle = 0.5 * (force[:-1] + force[1:])
    stages = np.stack([force[:-1], middle, force[1:]], axis=1)
    moved = along.to(stages[None], output)[0]
    assert moved.shape == (len(TIME), len(plant.outputs), 2)
    for i in range(2):
        ends = [run(plant, side * SMALL * force[:, i, None] * push, substeps)[1][::substeps, 0]
                for side in (1.0, -1.0)]  # fmt: skip
        slope = (ends[0] - ends[1]) / (2.0 * SMALL)
        assert np.max(np.abs(moved[..., i] - slope)) < 2e-4 * np.max(np.abs(slope))


@pytest.mark.slow
def test_many_forces_go_as_well_as_one():
    driven, y, z = run(RUBBING, np.zeros((len(TIME), 1)), 1)
    along = response(RUBBING, driven, y, z, 1)
    forces = np.random.default_rng(0).normal(size=(1, SAMPLES, 3, 37))
    together = along.to(forces, 0)
    assert together.shape == (1, SAMPLES + 1, 1, 37)
    assert np.allclose(together[..., 36:], along.to(forces[..., 36:], 0), rtol=1e-12)
    assert np.allclose(together[..., 16:17], along.to(forces[..., 16:17], 0), rtol=1e-12)


def test_a_thousand_steps_of_a_sample():
    """Unrolled, they overflowed the stack of XLA's compiler: the process ended without an error."""
    decaying = eoi.Plant(lambda t, x, u, p: -p.rate * x.y[0], {"rate": 1.0}, 1, ())
    runs, samples, substeps, period = 12, 27, 1024, 0.2
    still = np.zeros((runs, samples * substeps, 1, 1))
    nothing = np.zeros((runs, samples * substeps, 3, 0)), still, still[:, :, 0, :0]
    steps = np.full(runs, period / substeps)
    along = response_of(decaying, still[:, :, 0, 0], *nothing, steps, substeps)
    assert np.allclose(along.free, np.exp(-period), rtol=1e-9)
    moved = along.to(np.ones((runs, samples, 3, 1)), 0)
    assert np.allclose(moved[:, -1], 1.0 - np.exp(-period * samples), rtol=1e-9)
