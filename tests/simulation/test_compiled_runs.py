"""Compiled free runs against the same recursion by JAX, and against the trajectories themselves."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np
import pytest

from eoi_jax import plants
from eoi_jax.compiler.llvm import ARCHITECTURES
from eoi_jax.models.plant import Plant, State
from eoi_jax.refinement.problem import kernel_of
from eoi_jax.simulation import compiled_runs
from eoi_jax.simulation.integrator import frictional, trajectory
from eoi_jax.simulation.sensitivity import RunLane, RunRow
from eoi_jax.simulation.simulate import drive

PERIOD = 2e-3
TIME = np.arange(1201) * PERIOD


def two_with_dry_friction() -> Plant:
    def blocks(t, x, u, p):
        y, v = x.y
        pull = p.k * (y[1] - y[0])
        forces = jnp.stack([u[0] + pull, -pull]) - p.d * v
        return forces - jnp.stack([p.c1, p.c2]) * jnp.sign(v)

    values = {"k": 30.0, "d": 0.3, "c1": 0.4, "c2": 0.15}
    return Plant(blocks, values, 2, ("u",), ("y1", "y2"))


def trolley_with_a_load():
    """The friction of the first one acts on the second one too."""

    def both(t, x, u, p):
        (one, two), (v1, _) = x.y
        force = u[0] - p.k * one - p.c * jnp.sign(v1)
        return jnp.stack([force + p.d * two, -0.4 * force - 30.0 * two])

    return Plant(both, {"k": 30.0, "d": 3.0, "c": 0.4}, 2, ("u",), ("y1", "y2"))


def between_stops():
    """A model that branches at a stop on either side."""

    def mass(t, x, u, p):
        y, v = x.y[:, 0]
        left, right = (
            jax.lax.cond(side * y > 0.05, lambda: p.push, lambda: 0.0 * p.push)
            for side in (-1.0, 1.0)
        )
        return u[0] - p.k * y - p.d * v + left - right

    return Plant(mass, {"k": 10.0, "d": 0.5, "push": 5.0}, 2, ("u",), ("y",))


CASES: dict[str, Any] = {
    "pendulum, dry friction": (plants.pendulum(), [0.4, 0.0]),
    "two masses, dry friction in both": (two_with_dry_friction(), [0.3, 0.0, 0.0, 0.2]),
    "tanks, an internal state": (plants.cascaded_tanks(), [3.0, 4.0]),
    "friction that acts on another mass": (trolley_with_a_load(), [0.3, 0.0, 0.0, 0.2]),
    "stops on both sides": (between_stops(), [0.0, 0.0]),
}


def table_of(inputs, y, use):
    """Rows of a record in the order of `RunRow`."""
    parts = (TIME, inputs, y, use)
    return np.concatenate([part.reshape(len(TIME), -1) for part in parts], axis=1)


def case_of(name, lanes=1):
    """Rows of a record that the plant itself did not make, and lanes spread around its values."""
    plant, start = CASES[name]
    inputs = 0.2 + 0.8 * np.sign(np.sin(4.0 * TIME))[:, None]
    driven_by = drive(TIME, inputs, "zero")
    ny = len(plant.outputs)
    y = 0.1 + np.sin(3.0 * TIME)[:, None] * np.ones(ny)
    use = (np.arange(len(TIME)) % 7 > 0).astype(float)[:, None] * np.ones(ny)
    inside = np.minimum(np.arange(len(TIME)), len(TIME) - 2)
    table = table_of(np.asarray(driven_by.inputs)[inside], y, use)
    draw = np.random.default_rng(0)
    theta = np.asarray(plant.theta) * draw.uniform(0.8, 1.2, (lanes, len(plant.names)))
    starts = np.asarray(start) * draw.uniform(0.9, 1.1, (lanes, len(start)))
    ones = np.ones(lanes)
    scale = np.linspace(1.0, 2.0, ny) * ones[:, None]
    return plant, driven_by, table, RunLane(theta, starts, 0.0 * ones, scale, np.inf * ones)


def of_lane(lanes, i):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf[i]), lanes)


def summed(plant, table, lanes):
    several = jax.tree.map(lambda leaf: leaf[:, None], lanes)
    kernel = kernel_of(plant, "sums")
    return compiled_runs.summed(
        kernel, several, table[None], np.array([PERIOD]), np.array([len(table)])
    )


def shown(plant, table, lane):
    one = jax.tree.map(lambda leaf: np.asarray(leaf)[None, None], lane)
    return compiled_runs.signals(
        kernel_of(plant, "signals"), one, table[None], np.array([PERIOD]), np.array([len(table)]), 1
    )[0]


def rows_of(plant, table):
    nu, ny = len(plant.inputs), len(plant.outputs)
    time, u, y, use = np.split(table, np.cumsum([1, 3 * nu, ny]), axis=1)
    return RunRow(*map(jnp.asarray, (time[:, 0], u.reshape(-1, 3, nu), y, use)))


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "threshold"),
    list(zip(CASES, (0.3, np.inf, 0.3, 0.3, np.inf), strict=True)),
    ids=[*CASES],
)
def test_sums_of_many_lanes_equal_the_scan(name, threshold):
    plant, _, table, lanes = case_of(name, lanes=5)
    lanes = dataclasses.replace(lanes, threshold=np.full(5, threshold))
    found = summed(plant, table, lanes)[:, 0]
    kernel, rows = kernel_of(plant, "sums"), rows_of(plant, table)
    scan = jax.jit(lambda lane: kernel.run(lane, rows, jnp.asarray(PERIOD))[0])
    for i in range(5):
        expected = np.asarray(scan(of_lane(lanes, i)))
        size = np.sqrt(np.diagonal(expected))
        # Rounding alone: the compiled loop contracts products and sums.
        assert np.all(np.abs(found[i] - expected) <= 1e-9 * np.outer(size, size))
    alone = summed(plant, table, jax.tree.map(lambda leaf: leaf[3:4], lanes))[0, 0]
    np.testing.assert_allclose(alone, found[3], rtol=1e-9, atol=1e-9 * np.max(alone))


@pytest.mark.parametrize("name", [*CASES][::2])
def test_what_is_shown_is_the_weighed_error_of_the_trajectory(name):
    plant, driven_by, table, lanes = case_of(name)
    lane, kernel = of_lane(lanes, 0), kernel_of(plant, "signals")
    signals = shown(plant, table, lane)
    start = kernel.start(jnp.asarray(lane.start), jnp.asarray(lane.theta), 0.0)
    y_hat = trajectory(plant, jnp.asarray(lane.theta), driven_by, start, frictional(plant))[0][:, 0]
    ny = len(plant.outputs)
    y, use = table[:, -2 * ny : -ny], table[:, -ny:]
    expected = use * np.asarray(lane.scale) * (y - np.asarray(y_hat))
    np.testing.assert_allclose(signals[..., -1], expected, atol=1e-11)
    square = np.einsum("kji,kjl->il", signals, signals)
    sums = summed(plant, table, lanes)[0, 0]
    np.testing.assert_allclose(sums, square, rtol=1e-9, atol=1e-9 * np.max(np.abs(square)))


def test_lanes_step_by_step_stop_where_they_should():
    """A vector in which a single lane stops must not disturb the others."""
    plant, _, table, lanes = case_of("pendulum, dry friction", lanes=33)
    moved = np.asarray(lanes.start).copy()
    moved[::2, 0] = 0.0  # at rest, stuck; the others swing and stop at times of their own
    lanes = dataclasses.replace(lanes, start=moved)
    together = summed(plant, table, lanes)[:, 0]
    for i in (0, 1, 31, 32):
        alone = summed(plant, table, jax.tree.map(lambda leaf, i=i: leaf[i : i + 1], lanes))[0, 0]
        np.testing.assert_allclose(together[i], alone, rtol=1e-8, atol=1e-9 * np.max(alone))


@pytest.mark.parametrize("rows", [1200, 1201])
def test_nothing_beyond_the_last_row_is_read(rows):
    """Behind the last row lie others of the same table, which must not count."""
    plant, _, table, lanes = case_of("tanks, an internal state", lanes=20)
    several = jax.tree.map(lambda leaf: leaf[:, None], lanes)
    kernel, step = kernel_of(plant, "sums"), np.array([PERIOD])
    short = compiled_runs.summed(kernel, several, table[None, :rows], step, np.array([rows]))
    spoilt = np.concatenate([table[:rows], np.full_like(table[:9], 7.0)])
    for _ in range(20):  # memory that was freed is not always clean
        found = compiled_runs.summed(kernel, several, spoilt[None], step, np.array([rows]))
        np.testing.assert_array_equal(found, short)
        _ = np.full((rows + 1, 64), 7.0)


def test_a_lane_that_is_no_number_spoils_no_other():
    plant, _, table, lanes = case_of("tanks, an internal state", lanes=5)
    theta = np.asarray(lanes.theta).copy()
    theta[2, 0] = np.nan
    sums = summed(plant, table, dataclasses.replace(lanes, theta=theta))[:, 0]
    assert np.all(np.isnan(sums[2]))
    assert np.all(np.isfinite(np.delete(sums, 2, axis=0)))


def test_what_cannot_be_compiled_is_named():
    def looping(t, x, u, p):
        turns = jax.lax.while_loop(lambda k: k < x.y[0][0], lambda k: k + 1.0, 0.0)
        return -p.a * x.y[0] + turns

    kernel = kernel_of(Plant(looping, {"a": 1.0}, 1), "sums")
    assert "while" in (compiled_runs.supports(kernel) or "")
    assert compiled_runs.supports(kernel_of(plants.pendulum(), "sums")) is None


def test_the_start_is_the_plants_own_where_it_declares_one():
    plant, _, table, lanes = case_of("tanks, an internal state")
    kernel = kernel_of(plant, "signals")
    lane = dataclasses.replace(of_lane(lanes, 0), declared=jnp.ones(()))
    signals = shown(plant, table, lane)
    x = kernel.start(lane.start, jnp.asarray(lane.theta), lane.declared)
    assert isinstance(x, State)
    np.testing.assert_allclose(x.z, plant.internal_start(jnp.asarray(lane.theta)))
    # Its own unknown is then no unknown.
    np.testing.assert_array_equal(signals[:, 0, 1], 0.0)


def test_what_has_died_away_is_zero_and_the_caller_s_arithmetic_stays_as_it_was():
    """Derivatives with the initial state, after 800 time constants: below 1e-308 they are slow."""
    damped = Plant(lambda t, x, u, p: u - p.d * x.y[0], {"d": 1000.0}, 1, ("u",), ("y",))
    table = table_of(np.zeros((len(TIME), 3)), np.ones(len(TIME)), np.ones(len(TIME)))
    never, squares = np.asarray(0.0), np.asarray(np.inf)
    lane = RunLane(np.array([1000.0]), np.array([1.0]), never, np.ones(1), squares)
    smallest = np.finfo(float).smallest_normal
    slopes = shown(damped, table, lane)[:, 0, 0]
    assert np.all((slopes == 0) | (np.abs(slopes) >= smallest))
    assert slopes[0] == -1.0
    assert slopes[-1] == 0.0
    assert np.multiply(smallest, 0.5 * np.ones(1))[0] > 0


@pytest.mark.parametrize("name", ["x86_64", "aarch64"])
def test_subnormal_numbers_are_flushed_in_words_that_llvm_knows(name):
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    words = ARCHITECTURES[name]
    body = ["define void @f() {", words.begin, words.end, "  ret void", "}", *words.declarations]
    module = llvm.parse_assembly("\n".join(body))
    module.triple = f"{name}-unknown-linux-gnu"
    machine = llvm.Target.from_triple(module.triple).create_target_machine()
    written = machine.emit_assembly(module)
    assert {"x86_64": "ldmxcsr", "aarch64": "msr\tFPCR"}[name].lower() in written.lower()
