"""Laws that contain a simpler one: two carts with dry friction, each given a Stribeck law."""

import jax.numpy as jnp
import numpy as np
import pytest
from problems import noisy, stiff_response

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery import parsimony
from eoi_jax.discovery.refit import free_runs
from eoi_jax.discovery.task import Task
from eoi_jax.estimation.identify import estimate
from eoi_jax.estimation.preparation import prepare_records
from eoi_jax.models.augmented import augmented, place

STEP, DRY = 4e-3, np.array([0.8, 0.5])


def carts(t, x, u, p):
    return p.b * u - jnp.stack([p.c1, p.c2]) * x.y[1]


PLANT = eoi.Plant(
    carts,
    {"b": 1.2, "c1": 1.0, "c2": 1.0},
    2,
    inputs=("pull", "push"),
    outputs=("near", "far"),
)


def record(seed: int, offset: float = 0.0) -> eoi.Record:
    draw, time = np.random.default_rng(seed), STEP * np.arange(2500)
    lines = 2.0 * np.pi * draw.uniform(0.3, 2.0, (2, 6))
    forces = np.sum(np.sin(time[:, None, None] * lines + draw.uniform(0.0, 6.3, (2, 6))), axis=2)

    def rate(x: np.ndarray, u: np.ndarray) -> list[float]:
        push = u - 0.5 * x[2:] - DRY * np.tanh(x[2:] / 1e-4)
        return [*x[2:], push[0] + offset, push[1]]

    y = stiff_response(rate, forces, STEP, tolerance=1e-7)[:, :2]
    return eoi.Record(
        time, forces, noisy(y, 1e-3, draw), f"run {seed}", hold="zero",
        input_names=PLANT.inputs, output_names=PLANT.outputs,
    )  # fmt: skip


@pytest.mark.slow
def test_each_of_two_wider_laws_is_made_plain(monkeypatch):
    """Whatever free runs say: the second exchange must not undo the first."""
    monkeypatch.setattr(parsimony, "as_good", lambda *_: True)
    fit, held = (record(1),), (record(2),)
    prepared = prepare_records(PLANT, fit)
    library = (effects.CoulombFriction(), effects.StribeckFriction())
    declared = estimate(PLANT, prepared)
    task = Task(PLANT, prepared, fit, held, library, declared, 0.01, 3, None)
    wide = tuple(place(PLANT, effects.StribeckFriction(), j) for j in range(2))
    values = {
        name: value
        for one, level in zip(wide, DRY, strict=True)
        for name, value in zip(one.names, (level, 0.1, 0.02), strict=True)
    }
    found = estimate(augmented(declared.plant, wide, values), prepared)
    runs = free_runs(task, found.plant)
    placed, fewer, _, laws = parsimony.with_simpler_laws(task, wide, found, runs)
    assert [one.effect.name for one in placed] == ["coulomb_friction"] * 2
    assert set(fewer.parameters) == {
        "b", "c1", "c2", "coulomb_friction_near", "coulomb_friction_far"
    }  # fmt: skip
    levels = [fewer.parameters[f"coulomb_friction_{name}"] for name in PLANT.outputs]
    np.testing.assert_allclose(levels, DRY, rtol=0.01)
    assert set(laws) == set(wide)


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "kept"), [(0.0, False), (0.3, True)])
def test_an_offset_that_may_as_well_be_zero_is_left_out_beside_dry_friction(offset, kept):
    """Asymmetric friction is read as a level and an offset; the level alone is the simpler law."""
    fit, held = (record(1, offset),), (record(2, offset),)
    prepared = prepare_records(PLANT, fit)
    library = (effects.CoulombFriction(), effects.ConstantOffset())
    task = Task(PLANT, prepared, fit, held, library, estimate(PLANT, prepared), 0.01, 3, None)
    far = place(PLANT, effects.CoulombFriction(), 1)
    both = tuple(place(PLANT, one, 0) for one in library)
    values = {"coulomb_friction_near": 0.8, "constant_offset_near": 0.02, far.names[0]: 0.5}
    placed = (*both, far)
    found = estimate(augmented(PLANT, placed, values), prepared)
    runs = free_runs(task, found.plant)
    left, *_ = parsimony.with_simpler_laws(task, placed, found, runs)
    assert left == (placed if kept else (both[0], far))


def fan(seed, count=1000, period=0.02):
    """A pendulum that a fan drives: y'' = 3 u|u| - 9 sin(y) - 0.6 y', in small steps."""
    draw = np.random.default_rng(seed)
    command = np.repeat(draw.uniform(-1.6, 1.6, count // 50), 50)
    state, y, fine = np.zeros(2), np.empty(count), 10

    def rate(x, u):
        return np.array([x[1], 3.0 * u * abs(u) - 9.0 * np.sin(x[0]) - 0.6 * x[1]])

    for i in range(count):
        y[i] = state[0]
        for _ in range(fine):
            h, u = period / fine, command[i]
            first = rate(state, u)
            middle = rate(state + 0.5 * h * first, u)
            again = rate(state + 0.5 * h * middle, u)
            last = rate(state + h * again, u)
            state = state + h / 6.0 * (first + 2.0 * middle + 2.0 * again + last)
    y += 1e-3 * np.std(y) * draw.standard_normal(count)
    return eoi.Record(
        period * np.arange(count), command, y, hold="zero", input_names="cmd", output_names="angle"
    )


@pytest.mark.slow
def test_a_drive_with_the_square_of_its_input_has_no_linear_part():
    """The quadratic characteristic takes all, and no record tells its size beside a linear one."""
    plant = eoi.Plant(
        lambda t, x, u, p: p.b * u[0] - p.g * jnp.sin(x.y[0]) - p.d * x.y[1],
        {"b": 3.0, "g": 8.0, "d": 0.5}, 2, inputs=("cmd",), outputs=("angle",),
    )  # fmt: skip
    found = eoi.discover(plant, fan(1), validation=fan(2))
    assert [added.label for added in found.added] == ["input_square (odd)"]
    assert found.status.code == "complete"
    assert found.added[0].parameters == {}
    for name, value in {"b": 3.0, "g": 9.0, "d": 0.6}.items():
        assert found.plant.parameters[name] == pytest.approx(value, rel=5e-3)
