"""Free runs whose outputs are functions of the states: instants, derivatives, refinement."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from output_cases import (
    ACCELEROMETER,
    BATTERY,
    accelerometer,
    battery,
    battery_record,
    cell_states,
    current,
    mixed,
    shaken,
)

from eoi_jax.data.record import Record
from eoi_jax.estimation.identify import identify
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import InputDelay
from eoi_jax.models.plant import Plant, State
from eoi_jax.refinement.problem import kernel_of
from eoi_jax.refinement.refine import refine
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.chained_runs import _scanned, outputs_of
from eoi_jax.simulation.integrator import Drive, free_run, frictional
from eoi_jax.simulation.simulate import acted, drive, simulate
from eoi_jax.simulation.validate import validate


def test_a_sample_has_the_input_that_holds_from_there_on():
    amperes = current(3)
    soc, v1 = cell_states(amperes).T
    got = simulate(battery(), np.arange(1800.0), amperes, hold="zero")
    want = 3.4 + 0.7 * soc - BATTERY["R0"] * amperes - v1
    np.testing.assert_allclose(got.outputs[:, 0], want, atol=2e-8)  # of the Runge-Kutta step
    assert amperes[-1] == amperes[-60]
    amperes[-1] = 7.0  # a jump at the last sample, after which there is no step
    last = simulate(battery(), np.arange(1800.0), amperes, hold="zero").outputs[-1, 0]
    np.testing.assert_allclose(last - want[-1], -0.03 * (7.0 - amperes[-2]), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [1, 3])
def test_all_ways_to_run_agree(substeps):
    record = shaken(noise=0.0, outputs=("x", "acc"))
    for plant in (accelerometer(), mixed()):
        driven = drive(record.time, record.inputs, "linear", substeps)
        y0 = np.zeros((plant.rows, len(plant.outputs)))
        start = State(y0, np.zeros(len(plant.initial_internal)))
        pair = (driven, start)
        drives, starts = jax.tree.map(lambda leaf: np.asarray(leaf)[None], pair)
        friction = frictional(plant)
        compiled = outputs_of(plant, drives, starts, friction)[0]
        scanned = _scanned(plant, drives, starts, friction)[0]
        y, _ = free_run(plant, jnp.asarray(plant.theta), driven, start, friction)
        adaptive = simulate(plant, record.time, record.inputs, hold="linear", solver="adaptive")
        for other, tolerance in ((scanned, 1e-11), (np.asarray(y)[:, 0], 1e-11),
                                 (adaptive.outputs, 2e-5)):  # fmt: skip
            np.testing.assert_allclose(compiled, other, atol=tolerance)
        # The base is linear between samples here, and a sum of sines there.
        columns = record.outputs[:, -len(plant.outputs) :]
        assert np.max(np.abs(compiled - columns)) < 2e-3 * np.ptp(columns)


def test_validation_starts_where_the_model_declares_and_knows_the_noise():
    found = validate(battery(), battery_record(seed=2))
    np.testing.assert_allclose(found.rmse, 1e-3, rtol=0.06)
    windows = validate(battery(), battery_record(seed=2), window=300.0)
    np.testing.assert_allclose(windows.rmse, 1e-3, rtol=0.06)
    assert np.max(np.abs(found.predictions[0].outputs - battery_record(2).outputs)) < 6e-3


def test_sensitivities_of_outputs_are_their_derivatives():
    """Compiled and scanned alike: -∂ŷ/∂θ of each sample, the last one of a record too."""
    record = battery_record(noise=0.0, samples=180)
    plant: Any = battery(R0=0.02, C1=1000.0)
    from eoi_jax.refinement.free_run_sums import signals
    from eoi_jax.refinement.problem import Unknowns, problem_of
    from eoi_jax.refinement.spans import spans_of

    spans = spans_of([record], None)
    problem = problem_of(plant, [record], spans, 1)
    assert problem.compiled
    unknowns = Unknowns(np.asarray(plant.theta), np.tile(plant.initial_internal, (1, 1)))
    rows = signals(unknowns, problem)[0][:, 0]
    assert compiled_runs.used(kernel_of(plant, "sums")).name == "native"
    predicted = lambda plant: simulate(  # noqa: E731
        plant, record.time, record.inputs, hold="zero"
    ).outputs[:, 0]
    scale = float(np.asarray(problem.scale)[0])
    np.testing.assert_allclose(
        rows[:, -1], scale * (record.outputs[:, 0] - predicted(plant)), atol=1e-8
    )
    for i, (name, value) in enumerate(plant.parameters.items()):
        step = 1e-6 * value
        above, below = (
            predicted(plant.with_parameters({name: value + sign * step})) for sign in (1.0, -1.0)
        )
        slope = -scale * (above - below) / (2.0 * step)
        column = rows[:, 2 + i]  # behind the two internal states, which the model declares
        np.testing.assert_allclose(column, slope, atol=1e-6 * np.max(np.abs(slope)))


@pytest.mark.parametrize("window", [None, 450.0])
def test_a_cell_is_refined(window):
    start = battery(R0=0.02, R1=0.03, C1=1000.0, Q=7000.0)
    result = refine(start, battery_record(), window=window)
    assert result.status.ok
    for name in ("R0", "R1", "C1"):
        error = abs(result.parameters[name] - BATTERY[name])
        assert error < 4.0 * result.standard_errors[name]
        assert error < 0.03 * BATTERY[name]


def test_a_mass_is_refined_from_its_acceleration_and_position():
    result = refine(accelerometer(b=3.0, k=80.0), shaken())
    both = refine(mixed(b=3.0, k=80.0, gain=0.9), shaken(noise=0.0, outputs=("x", "acc")))
    for name in ("b", "k"):
        error = abs(result.parameters[name] - ACCELEROMETER[name])
        assert error < 4.0 * result.standard_errors[name]
        np.testing.assert_allclose(both.parameters[name], ACCELEROMETER[name], rtol=2e-3)
    np.testing.assert_allclose(both.parameters["gain"], 1.0, rtol=2e-3)


def test_a_delayed_input_is_held_as_it_was():
    """Whole samples of delay of a held input: the output jumps at a sample, not around it."""
    plant: Any = battery()
    late = augmented(plant, [place(plant, InputDelay(), 0)], {"input_delay": 2.0})
    amperes = current(5)
    driven = acted(late, drive(np.arange(1800.0), amperes[:, None], "zero", 1))
    before = np.concatenate([[amperes[0]] * 2, amperes[:-2]])
    np.testing.assert_allclose(driven.inputs[:, :, 0], before[:-1, None] * np.ones(3), atol=1e-12)
    np.testing.assert_allclose(driven.last, before[-1:], atol=1e-12)
    got = simulate(late, np.arange(1800.0), amperes, hold="zero")
    want = simulate(plant, np.arange(1800.0), before, hold="zero")
    np.testing.assert_allclose(got.outputs, want.outputs, atol=1e-12)


def test_runs_side_by_side_go_on_into_what_follows_them():
    record = battery_record(noise=0.0)
    whole = drive(record.time, record.inputs, "zero", 1)
    y, z = free_run(battery(), jnp.asarray(battery().theta), whole,
                    State(np.zeros((1, 1)), np.asarray([0.8, 0.0])), (0,))  # fmt: skip
    steps = np.asarray([0, 59, 60, 600])[:, None] + np.arange(60)
    parts = Drive(whole.time[steps], np.ones(4), whole.inputs[steps], 1,
                  whole.following[steps[:, -1]])  # fmt: skip
    starts = State(np.zeros((4, 1, 1)), np.asarray(z)[steps[:, 0]])
    got = outputs_of(battery(), parts, starts, (0,))
    for run, first in zip(got, steps[:, 0], strict=True):
        np.testing.assert_allclose(run, np.asarray(y)[first : first + 61, 0], atol=1e-12)


def rubbing_block(t, x, u, p):
    """Position and acceleration of a block with dry friction."""
    a = (u[0] - p.c * jnp.sign(x.y[1, 0])) / p.m
    return jnp.stack([a, a])


BLOCK: Any = Plant(
    rubbing_block, {"m": 2.0, "c": 1.5}, (2, 0), ("force",), ("x", "acc"), name="block"
)


def test_an_acceleration_is_zero_while_the_mass_sticks():
    """A force that rises to 3 N, is held and goes: at rest, |F| < c, the block does not move."""
    time = np.arange(0.0, 6.0, 0.01)
    force = np.interp(time, [0.0, 3.0, 3.5], [0.0, 3.0, 0.5])
    got = simulate(BLOCK, time, force, hold="linear")
    acceleration, stuck = got.outputs[:, 1], (time < 2.0) & (force <= 1.5)
    assert np.ptp(got.outputs[stuck, 0]) == 0.0
    np.testing.assert_allclose(acceleration[stuck], 0.0, atol=1e-12)
    moving = (time > 1.6) & (time < 3.0)
    np.testing.assert_allclose(acceleration[moving], (force[moving] - 1.5) / 2.0, atol=1e-9)
    at_end = time > 5.0
    assert np.ptp(got.outputs[at_end, 0]) == 0.0  # it has come to rest again
    np.testing.assert_allclose(acceleration[at_end], 0.0, atol=1e-12)


@pytest.mark.slow
def test_friction_is_found_from_position_and_acceleration():
    time = np.arange(0.0, 20.0, 0.01)
    force = 4.0 * np.sin(1.3 * time) + 2.0 * np.sin(3.1 * time)
    record = simulate(BLOCK, time, force, hold="linear")
    start = BLOCK.with_parameters({"m": 3.0, "c": 1.0})
    for result in (identify(start, record), refine(start, record)):
        got = result.parameters
        np.testing.assert_allclose([got["m"], got["c"]], [2.0, 1.5], rtol=5e-3)


def test_the_start_of_such_an_output_is_not_asked_for():
    got: Record = simulate(battery(), np.arange(60.0), np.ones(60), 99.0, hold="zero")
    np.testing.assert_allclose(got.outputs[0], 3.4 + 0.56 - 0.03)
    assert isinstance(battery(), Plant)
