"""Lengths of free runs in a discovery: whole records, or windows of an unstable plant."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects

PLANT = eoi.Plant(
    lambda t, x, u, p: p.a * jnp.sin(x.y[0]) + p.b * u, {"a": 9.0, "b": 1.0}, 2,
    inputs=("torque",), outputs=("angle",),
)  # fmt: skip


def upright(seed, count=1200, period=0.01, friction=0.6):
    """A pendulum with viscous friction that a controller keeps upright, by SciPy."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-0.5, 0.5, count // 60), 60)
    x, angles, torques = np.zeros(2), [], []
    for target in command:
        torque = -40.0 * (x[0] - target) - 12.0 * x[1]
        angles.append(x[0])
        torques.append(torque)
        run = solve_ivp(
            lambda t, x, u: [x[1], 9.0 * np.sin(x[0]) - friction * x[1] + u], (0.0, period), x,
            args=(torque,), rtol=1e-7,
        )  # fmt: skip
        x = run.y[:, -1]
    noise = 5e-4 * random.standard_normal(count)
    return eoi.Record.from_period(
        period, np.array(torques), np.array(angles) + noise, hold="zero",
        input_names=("torque",), output_names=("angle",),
    )  # fmt: skip


@pytest.fixture(scope="module")
def found():
    tried = [effects.ViscousFriction(), effects.CubicStiffness(), effects.ConstantOffset()]
    return eoi.discover(PLANT, upright(1), upright(2), tried)


def test_an_unstable_plant_is_judged_in_windows_and_its_friction_found(found):
    """Errors of a start grow with e^(3 t): over 12 s the declared model falls over."""
    assert found.effects == ("viscous_friction",)
    assert found.plant.parameters["viscous_friction"] == pytest.approx(0.6, rel=0.05)
    assert found.before.window == found.after.window <= 4.0 / 3.0
    assert found.windows_before.window <= 0.5 * found.before.window + 0.01
    assert found.after.rmse[0] < 0.5 * found.before.rmse[0] < 0.2


def test_the_report_says_over_what_the_errors_are(found):
    assert f"held-out RMSE of angle in windows of {found.before.window:.3g} s" in str(found)
    assert f"data in windows of {found.before.window:.3g} s" in str(found).splitlines()[0]


def test_test_errors_are_over_windows_of_the_same_length():
    once = eoi.discover(PLANT, upright(1), upright(2), [effects.ViscousFriction()], test=upright(3))
    lengths = {runs and runs.window for runs in (once.test_before, once.test_after, once.before)}
    assert len(lengths) == 1
    assert None not in lengths
