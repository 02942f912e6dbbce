"""Free runs: closed forms, an independent solver, and friction that sticks."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import stiff_response
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax.compiler.programs import jit
from eoi_jax.models.library import (
    Plant,
    State,
    cascaded_tanks,
    duffing_oscillator,
    pendulum,
    three_mass_spring_damper,
)
from eoi_jax.simulation.integrator import (
    REACHES,
    Drive,
    chained,
    free_run,
    frictional,
    trajectory,
)
from eoi_jax.simulation.rates import first_zero
from eoi_jax.simulation.simulate import drive, simulate


def block_dynamics(t, x, u, p):
    position, rate = x.y
    return u - p.stiffness * position - p.viscous * rate - p.coulomb * jnp.sign(rate)


def block(stiffness=0.0, viscous=0.0, coulomb=1.0):
    parameters = {"stiffness": stiffness, "viscous": viscous, "coulomb": coulomb}
    return Plant(block_dynamics, parameters, relative_degree=2)


def convergence_order(error_at, counts=(40, 320)):
    """Slope of log error against log h from the coarsest to the finest grid."""
    errors = [error_at(np.linspace(0.0, 4.0, count + 1)) for count in counts]
    return np.log2(errors[0] / errors[-1]) / np.log2(counts[-1] / counts[0])


def free(plant, time, initial):
    return simulate(plant, time, np.zeros_like(time), initial, substeps=1).outputs[:, 0]


# -- smooth plants ------------------------------------------------------------------------


def oscillation(plant, time):
    """Damped oscillation of `block(stiffness, viscous, 0)` from y = 1, ẏ = 0."""
    p = plant.parameters
    decay = 0.5 * p["viscous"]
    w = np.sqrt(p["stiffness"] - decay**2)
    return np.exp(-decay * time) * (np.cos(w * time) + decay / w * np.sin(w * time))


def test_smooth_plant_converges_at_fourth_order():
    plant = block(9.0, 0.4, 0.0)

    def error(time):
        return np.max(np.abs(free(plant, time, [1.0, 0.0]) - oscillation(plant, time)))

    assert convergence_order(error) > 3.9


def test_substeps_equal_a_finer_grid():
    plant, time = block(9.0, 0.4, 0.3), np.linspace(0.0, 4.0, 41)
    fine = np.linspace(0.0, 4.0, 161)
    coarse = simulate(plant, time, np.sin(time), [1.0, 0.0], hold="linear", substeps=4)
    u = np.interp(fine, time, np.sin(time))
    same = simulate(plant, fine, u, [1.0, 0.0], hold="linear", substeps=1)
    # The same steps up to rounding of the grid.
    np.testing.assert_allclose(coarse.outputs, same.outputs[::4], atol=1e-12)


HOLDS = {
    "zero": lambda t, time, u: u[np.clip(np.searchsorted(time, t, "right") - 1, 0, len(u) - 2)],
    "linear": lambda t, time, u: np.interp(t, time, u),
    "smooth": lambda t, time, u: np.sin(3.0 * t),
}


@pytest.mark.parametrize("solver", ["fixed", "adaptive"])
@pytest.mark.parametrize("hold", list(HOLDS))
def test_duffing_oscillator_agrees_with_scipy_for_every_hold(hold, solver):
    plant = duffing_oscillator().with_parameters(
        {"gain": 2.0, "damping": 0.3, "stiffness": 4.0, "cubic_stiffness": 3.0, "offset": 0.1}
    )
    time = np.arange(201) * 0.02
    u = np.sin(3.0 * time)
    got = simulate(plant, time, u, [0.4, -1.0], hold=hold, solver=solver, substeps=4)

    def field(t, x):
        force = 2.0 * HOLDS[hold](t, time, u)
        return [x[1], force - 0.3 * x[1] - 4.0 * x[0] - 3.0 * x[0] ** 3 + 0.1]

    want = [np.asarray([0.4, -1.0])]
    for k in range(200):  # from sample to sample: the input has a kink at each
        end = np.nextafter(time[k + 1], 0.0)
        want.append(solve_ivp(field, (time[k], end), want[-1], rtol=1e-11, atol=1e-13).y[:, -1])
    # Runge-Kutta at h = 5 ms and |λ| = 2…5: (hλ)^4 / 120 of a signal of size 1, over some periods.
    np.testing.assert_allclose(got.outputs[:, 0], np.asarray(want)[:, 0], atol=2e-8)
    assert (got.hold, got.hold_declared) == (hold, True)


def test_a_simulated_record_declares_the_hold_that_was_used():
    time = 0.1 * np.arange(50)
    steps = simulate(block(), time, np.repeat(np.arange(5.0), 10))
    ramp = simulate(block(), time, time)
    assert [steps.hold, ramp.hold] == ["zero", "linear"]
    assert steps.hold_declared
    assert ramp.hold_declared


def test_three_masses_agree_with_matrix_exponential():
    from scipy.linalg import expm

    plant = three_mass_spring_damper(true=True)
    p = plant.parameters
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, [0, 1, 3]] = -p["a2"], p["a3"], -p["a4"]
    A[4, [0, 1, 2, 4]] = p["b1"], -p["b2"], p["b3"], -p["b4"]
    A[5, [1, 2, 5]] = p["c1"], -p["c2"], -p["c3"]
    initial = np.asarray([[0.01, -0.02, 0.005], [0.1, 0.0, -0.2]])
    time = np.arange(301) * 1e-3
    got = simulate(plant, time, np.zeros(301), initial).outputs
    step = expm(A * 1e-3)
    x, want = initial.ravel(), [initial.ravel()]
    for _ in range(300):
        x = step @ x
        want.append(x)
    # hω = 0.04: (hω)^4 ωt / 120 = 3e-7 of 0.02.
    np.testing.assert_allclose(got, np.asarray(want)[:, :3], atol=1e-8)


def test_internal_states_agree_with_scipy():
    plant = cascaded_tanks()
    time = np.arange(101) * 2.0
    u = 2.0 + np.sin(0.1 * time)
    got = simulate(plant, time, u, 3.0, internal=[4.0], hold="linear")

    def field(t, x):
        upper = 0.05 * np.sqrt(x[1])
        return [upper - 0.05 * np.sqrt(x[0]), 0.05 * np.interp(t, time, u) - upper]

    want = solve_ivp(field, (0, 200), [3.0, 4.0], t_eval=time, rtol=1e-10, atol=1e-10, max_step=2)
    np.testing.assert_allclose(got.outputs[:, 0], want.y[0], atol=1e-7)  # the field is slow: 1e-8
    default = simulate(plant, time, u, 3.0)
    own = simulate(plant, time, u, 3.0, internal=[5.0])  # the plant's own start
    np.testing.assert_array_equal(default.outputs, own.outputs)


def test_mixed_relative_degrees_agree_with_scipy():
    def dynamics(t, x, u, p):
        position, level = x.y[0]
        return jnp.stack([u[0] - p.k * position - 0.2 * x.y[1, 0] + level, -level + position])

    plant = Plant(dynamics, {"k": 4.0}, relative_degree=(2, 1), outputs=("position", "level"))
    time = np.linspace(0.0, 3.0, 301)
    initial = [[0.5, 1.0], [0.1, 7.0]]  # the 7 belongs to no state: level has degree 1
    got = simulate(plant, time, np.ones(301), initial)

    def field(t, x):
        return [x[1], 1.0 - 4.0 * x[0] - 0.2 * x[1] + x[2], -x[2] + x[0]]

    want = solve_ivp(field, (0, 3), [0.5, 0.1, 1.0], t_eval=time, rtol=1e-11, atol=1e-12).y
    np.testing.assert_allclose(got.outputs, want[[0, 2]].T, atol=1e-8)


# -- dry friction -------------------------------------------------------------------------


def test_coulomb_friction_alone_is_exact_at_any_step():
    """Deceleration c from v0: y = v0 t − c t²/2 until v0/c; Runge-Kutta is exact on parabolas."""
    for count in (20, 77):
        time = np.linspace(0.0, 4.0, count + 1)
        until = np.minimum(time, 1.3)
        got = free(block(), time, [0.0, 1.3])
        np.testing.assert_allclose(got, 1.3 * until - until**2 / 2, atol=1e-13)


def sliding(time, v0=1.3, b=0.7, c=1.0):
    """Viscous and Coulomb friction: v = (v0 + c/b) e^(−bt) − c/b until it is zero."""
    until = np.minimum(time, np.log(1 + b * v0 / c) / b)
    return (v0 + c / b) / b * (1 - np.exp(-b * until)) - c / b * until


def spring_and_coulomb(time, y0=0.37, stiffness=30.0, c=1.0):
    """Half cycles around ∓c/k; at rest for good at the first turn within that dead band."""
    w, band = np.sqrt(stiffness), c / stiffness
    amplitude, since, y = y0, 0.0, np.full_like(time, np.nan)
    while abs(amplitude) > band:
        centre = np.sign(amplitude) * band
        now = (time >= since) & (time <= since + np.pi / w)
        y[now] = centre + (amplitude - centre) * np.cos(w * (time[now] - since))
        amplitude, since = 2 * centre - amplitude, since + np.pi / w
    y[time >= since] = amplitude
    return y


def breakaway(time, ramp=0.7, c=1.0):
    """Force ramp·t from rest: nothing until c/ramp, then y = ramp (t − c/ramp)³ / 6."""
    return ramp * np.maximum(time - c / ramp, 0.0) ** 3 / 6


def test_stopping_converges_at_fourth_order():
    def error(time):
        got = free(block(viscous=0.7), time, [0.0, 1.3])
        return np.max(np.abs(got - sliding(time)))

    assert convergence_order(error) > 3.5


def test_spring_with_coulomb_friction_converges_at_fourth_order():
    def error(time):
        got = free(block(stiffness=30.0), time, [0.37, 0.0])
        return np.max(np.abs(got - spring_and_coulomb(time)))

    assert convergence_order(error) > 3.5


def test_breakaway_under_a_ramp_is_late_by_less_than_a_step():
    """Leaving rest is decided at the start of a step: second order, ½ ramp h² of velocity."""
    for count in (40, 320):
        time = np.linspace(0.0, 4.0, count + 1)
        got = simulate(block(), time, 0.7 * time, hold="linear").outputs[:, 0]
        h, moving = 4.0 / count, 4.0 - 1.0 / 0.7
        # δ < h late: y misses ramp (δ (t−t0)²/2 − …) less the part of the force that is not lost.
        bound = 0.5 * 0.7 * h**2 * moving + 0.7 * h**3
        assert np.max(np.abs(got - breakaway(time))) <= bound


def braked(t, x, u, p):
    """A speed with viscous and Coulomb friction."""
    return u - p.b * x.y[0] - p.c * jnp.sign(x.y[0])


SPEED = Plant(braked, {"b": 0.7, "c": 1.0}, 1, outputs=("speed",))


def test_a_speed_with_dry_friction_comes_to_rest_and_breaks_away():
    time = np.linspace(0.0, 4.0, 201)
    got = simulate(SPEED, time, np.zeros(201), 1.3).outputs[:, 0]
    want = np.maximum((1.3 + 1.0 / 0.7) * np.exp(-0.7 * time) - 1.0 / 0.7, 0.0)
    np.testing.assert_allclose(got, want, atol=1e-9)
    stop = np.log(1.0 + 0.7 * 1.3) / 0.7
    assert np.all(got[time > stop] == 0.0)
    pushed = simulate(SPEED, time, np.where(time < 2.0, 0.99, 1.01), hold="zero").outputs[:, 0]
    assert np.all(pushed[time <= 2.0] == 0.0)
    later = np.maximum(time - 2.0, 0.0)
    np.testing.assert_allclose(pushed, 0.01 / 0.7 * (1.0 - np.exp(-0.7 * later)), atol=1e-9)


def test_a_speed_and_a_position_stick_each_on_its_own():
    """Side by side in one plant as each alone, though they stop at different times."""

    def both(t, x, u, p):
        block = u[0] - p.c * jnp.sign(x.y[1, 1])
        return jnp.stack([u[0] - p.b * x.y[0, 0] - p.c * jnp.sign(x.y[0, 0]), block])

    plant = Plant(both, {"b": 0.7, "c": 1.0}, (1, 2), outputs=("speed", "position"))
    time = np.linspace(0.0, 6.0, 301)
    push = 2.0 * np.sin(2.0 * time)
    start = np.array([[1.3, 0.0], [0.0, 1.3]])
    got = simulate(plant, time, push, start, hold="zero").outputs
    alone = simulate(SPEED, time, push, 1.3, hold="zero").outputs[:, 0]
    slid = simulate(block(), time, push, [0.0, 1.3], hold="zero").outputs[:, 0]
    np.testing.assert_allclose(got, np.stack([alone, slid], axis=1), atol=1e-12)
    assert np.sum(alone == 0.0) > 5


def test_a_stuck_block_stays_exactly_put():
    time = np.linspace(0.0, 10.0, 501)
    force = 0.95 * np.sin(40.0 * time)  # below the friction level of 1
    got = simulate(block(stiffness=1.0, coulomb=1.3), time, force, [0.2, 0.0], hold="linear")
    np.testing.assert_array_equal(got.outputs, np.full((501, 1), 0.2))
    stopped = free(block(), time, [0.0, 0.5])
    assert len(np.unique(stopped[time > 0.53])) == 1


def test_energy_never_increases_without_input():
    plant, time = block(stiffness=30.0), np.linspace(0.0, 16.0, 641)
    start = State(jnp.asarray([[1.0], [0.5]]), jnp.zeros(0))
    still = drive(time, np.zeros((641, 1)), "zero")
    y, _ = free_run(plant, jnp.asarray(plant.theta), still, start, frictional(plant))
    energy = np.asarray(0.5 * y[:, 1, 0] ** 2 + 15.0 * y[:, 0, 0] ** 2)
    assert np.max(np.diff(energy)) <= 1e-12 * energy[0]
    assert energy[-1] < 0.01 * energy[0]


def test_outputs_that_stop_within_the_same_step_both_stop_where_they_should():
    def dynamics(t, x, u, p):
        return -p.c * jnp.sign(x.y[1])

    plant = Plant(dynamics, {"c": 1.0}, relative_degree=2, inputs=(), outputs=("y1", "y2", "y3"))
    time, v0 = np.linspace(0.0, 2.0, 11), np.asarray([1.01, -1.05, 1.05])
    got = simulate(plant, time, np.zeros((11, 0)), np.stack([np.zeros(3), v0]))
    want = np.sign(v0) * v0**2 / 2
    np.testing.assert_allclose(got.outputs[-1], want, atol=1e-13)  # parabolas: exact


def test_reversal_within_a_step_is_not_smeared():
    """A force beyond the friction turns the block round: deceleration 3, then acceleration −1."""
    time = np.linspace(0.0, 3.0, 8)
    got = simulate(block(), time, np.full(8, -2.0), [0.0, 2.0]).outputs[:, 0]
    turn = 2.0 / 3.0
    before = 2.0 * time - 1.5 * time**2
    after = 2.0 / 3.0 - 0.5 * (time - turn) ** 2
    np.testing.assert_allclose(got, np.where(time < turn, before, after), atol=1e-13)


def branch(u, direction, p):
    """Motion in one direction with scipy, and the event that ends it."""

    def field(_, x):
        drag = p["b"] * x[1] + p["c"] * direction
        return [x[1], p["d"] * u - p["a"] * np.sin(x[0]) - drag]

    def stop(_, x):
        return direction * x[1]

    stop.terminal, stop.direction = True, -1
    return field, stop


def pendulum_by_events(time, u, p):
    """The paper's pendulum with scipy: integrate a branch, stop at an event, choose the next."""
    angle, rate, direction, result = 0.0, 0.0, 0, [0.0]
    for k in range(len(time) - 1):
        t = time[k]
        while t < time[k + 1]:
            force = p["d"] * u[k] - p["a"] * np.sin(angle)
            if direction == 0:
                direction = int(np.sign(force)) if abs(force) > p["c"] else 0
            if direction == 0:
                break  # the input is held: stuck until the next sample

            field, stop = branch(u[k], direction, p)
            # From exact rest the event would fire at once: start an instant into the motion.
            x0 = [angle, rate if rate else direction * 1e-13]
            run = solve_ivp(field, (t, time[k + 1]), x0, events=stop, rtol=1e-10, atol=1e-12)
            t, (angle, rate) = run.t[-1], run.y[:, -1]
            if run.status == 1:
                rate, direction = 0.0, 0
        result.append(angle)
    return np.asarray(result)


def test_pendulum_with_friction_agrees_with_event_driven_scipy():
    # Ten times the paper's friction, so that it comes to rest at either input.
    plant = pendulum(true=True).with_parameters({"c": 3.0})
    time = np.arange(1501) * 4e-3
    u = np.where(time < 3.0, 0.2, -0.05)
    got = simulate(plant, time, u, hold="zero", substeps=2).outputs[:, 0]
    want = pendulum_by_events(time, u, plant.parameters)
    # hω = 0.02 over 50 rad: (hω)^4 / 120 * 50 = 7e-8.
    np.testing.assert_allclose(got, want, atol=5e-7)
    assert len(np.unique(got[-100:])) == 1  # it has come to rest


# A crane: the friction of its trolley acts on the load through the inertia of both.
CRANE = {"drag": 2.0, "dry": 1.2, "mass": 1.3, "damping": 0.05}


def crane_dynamics(t, x, u, p):
    (_, angle), (v, w) = x.y
    s, c = jnp.sin(angle), jnp.cos(angle)
    push = u[0] - p.drag * v - p.dry * jnp.sign(v) + 0.12 * w**2 * s
    fall, inertia = -9.81 * s - p.damping * w, 0.4 * p.mass - 0.12 * c * c
    return jnp.stack(
        [(0.4 * push - 0.12 * c * fall) / inertia, (p.mass * fall - c * push) / inertia]
    )


def crane():
    return Plant(crane_dynamics, CRANE, 2, outputs=("trolley", "angle"))


def smoothed_crane(u, h, width):
    """LSODA with the sign of the velocity made a hyperbolic tangent of that width."""

    def rate(x, push):
        _, angle, v, w = x
        s, c = np.sin(angle), np.cos(angle)
        push = push - 2.0 * v - 1.2 * np.tanh(v / width) + 0.12 * w * w * s
        fall, inertia = -9.81 * s - 0.05 * w, 0.52 - 0.12 * c * c
        return [v, w, (0.4 * push - 0.12 * c * fall) / inertia, (1.3 * fall - c * push) / inertia]

    return stiff_response(rate, u, h)[:, :2]


def crane_push(time):
    return 2.0 * np.sin(1.7 * time) + 1.5 * np.sin(5.1 * time + 1.0)


def test_a_trolley_that_sticks_holds_what_hangs_from_it():
    time = 4e-3 * np.arange(751)
    u = crane_push(time)
    got = simulate(crane(), time, u, substeps=4, hold="zero").outputs
    stuck = np.diff(got[:, 0]) == 0.0
    assert 0.1 < np.mean(stuck) < 0.6
    assert np.min(np.abs(np.diff(got[:, 1])[stuck][10:])) > 0.0  # while the load swings
    wide, narrow = (np.max(np.abs(smoothed_crane(u, 4e-3, w) - got)) for w in (1e-3, 1e-4))
    # What is smoothed tends to it in proportion to the width.
    assert narrow < 0.2 * wide
    assert narrow < 3e-4


# Two joints whose frictions act on each other: an inertia matrix that couples them strongly.
INERTIA = np.array([[2.0, 0.9], [0.9, 0.6]])


def joints_dynamics(t, x, u, p):
    y, v = x.y
    push = u - 3.0 * y - 0.2 * v - jnp.stack([p.first, p.second]) * jnp.sign(v)
    return jnp.asarray(np.linalg.inv(INERTIA)) @ push


def joints(first=0.8, second=0.5):
    levels = {"first": first, "second": second}
    return Plant(joints_dynamics, levels, 2, inputs=("a", "b"), outputs=("one", "two"))


def joints_push(time):
    slow, fast = np.sin(1.3 * time), np.sin(4.1 * time + 1.0)
    return np.stack([1.2 * slow + 0.5 * fast, 0.7 * np.cos(1.3 * time) * fast], axis=1)


def smoothed_joints(u, h, width):
    """LSODA with hyperbolic tangents for the signs."""
    inverse = np.linalg.inv(INERTIA)

    def rate(x, push):
        dry = np.array([0.8, 0.5]) * np.tanh(x[2:] / width)
        return [*x[2:], *(inverse @ (push - 3.0 * x[:2] - 0.2 * x[2:] - dry))]

    return stiff_response(rate, u, h)[:, :2]


@pytest.mark.slow
def test_two_joints_hold_and_release_each_other():
    time = 4e-3 * np.arange(1501)
    u = joints_push(time)
    assert frictional(joints()) == (2, 2)
    got = simulate(joints(), time, u, substeps=2, hold="zero").outputs
    stuck = np.diff(got, axis=0) == 0.0
    one, two = stuck.T
    for share in (np.mean(one & two), np.mean(one & ~two), np.mean(two & ~one)):
        assert 0.02 < share < 0.9
    wide, narrow = (np.max(np.abs(smoothed_joints(u, 4e-3, w) - got)) for w in (1e-3, 1e-4))
    assert narrow < 0.2 * wide
    assert narrow < 1e-4 * time[-1]  # below its level the smoothed one creeps at its width


@pytest.mark.parametrize("push", [(0.85, 0.1), (0.7, 0.45), (-0.2, 0.62), (1.4, -0.9), (0.9, 0.6)])
def test_joints_leave_rest_as_a_stiff_friction_lets_them(push):
    """A level may be exceeded by what the friction of the other joint passes on."""
    time, u = 1e-3 * np.arange(21), np.tile(push, (21, 1))
    got = simulate(joints(), time, u, hold="zero").outputs[-1]
    want = smoothed_joints(u, 1e-3, 1e-6)[-1]
    np.testing.assert_allclose(got, want, atol=2e-7)
    assert list(np.sign(got)) == list(np.where(np.abs(want) < 2e-7, 0.0, np.sign(want)))


def test_three_frictions_that_act_on_each_other_are_refused():
    matrix = jnp.asarray(np.linalg.inv(np.eye(3) + 0.2))
    plant = Plant(
        lambda t, x, u, p: matrix @ (u - p.c * jnp.sign(x.y[1])),
        {"c": 0.5},
        2,
        inputs=("a", "b", "c"),
        outputs=("one", "two", "three"),
    )
    with pytest.raises(ValueError, match=r"no more than two outputs .* got one, two, three"):
        simulate(plant, TIME, np.zeros((11, 3)))


# -- derivatives, compilation -------------------------------------------------------------


def test_forward_derivatives_pass_through_a_stop():
    """Stopping distance v0² / (2c): its derivatives with c and v0."""
    plant, time = block(), np.linspace(0.0, 4.0, 41)
    still, friction = drive(time, np.zeros((41, 1)), "zero"), frictional(plant)

    def end(values):
        c, v0 = values
        theta = jnp.stack([jnp.zeros_like(c), jnp.zeros_like(c), c])
        start = State(jnp.stack([jnp.zeros_like(v0), v0])[:, None], jnp.zeros(0))
        return trajectory(plant, theta, still, start, friction)[0][-1, 0, 0]

    got = jax.jit(jax.jacfwd(end))(jnp.asarray([1.0, 1.33]))
    np.testing.assert_allclose(got, [-(1.33**2) / 2, 1.33], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("plant", "time", "push"),
    [
        (pendulum(true=True), np.arange(801) * 5e-3, np.full(801, 0.2)),
        (SPEED, np.linspace(0.0, 6.0, 301), 2.0 * np.sin(np.linspace(0.0, 12.0, 301))),
        (crane(), 4e-3 * np.arange(751), crane_push(4e-3 * np.arange(751))),
        (joints(), 4e-3 * np.arange(751), joints_push(4e-3 * np.arange(751))),
    ],
    ids=["pendulum", "speed that stops", "crane", "joints"],
)
def test_sensitivities_equal_differences(plant: Plant, time: np.ndarray, push: np.ndarray):
    driven_by = drive(time, push.reshape(len(time), -1), "zero")
    friction = frictional(plant)
    start = State(jnp.zeros((plant.relative_degree, len(plant.outputs))), jnp.zeros(0))

    @jax.jit
    def run(theta):
        return jnp.ravel(trajectory(plant, theta, driven_by, start, friction)[0][:, 0])

    theta = jnp.asarray(plant.theta)
    got = np.asarray(jax.jit(jax.jacfwd(run))(theta))
    for i, size in enumerate(1e-6 * np.asarray(theta)):
        move = np.eye(len(theta))[i] * size
        after, before = (np.asarray(run(plant.theta + sign * move)) for sign in (1.0, -1.0))
        want = (after - before) / (2 * size)
        # The difference itself is good to 1e-6 of the sensitivity.
        np.testing.assert_allclose(got[:, i], want, atol=1e-5 * np.max(np.abs(want)))


def test_vmap_over_parameters_equals_a_loop():
    plant, time = pendulum(), np.arange(301) * 1e-2
    push = drive(time, np.full((301, 1), 0.1), "zero")
    friction, start = frictional(plant), State(jnp.zeros((2, 1)), jnp.zeros(0))
    thetas = jnp.asarray(np.outer([0.9, 1.0, 1.1], plant.theta))

    @jax.jit
    def run(theta):
        return trajectory(plant, theta, push, start, friction)[0]

    together = jax.jit(jax.vmap(run))(thetas)
    for theta, lane in zip(thetas, together, strict=True):
        # Fused differently: rounding, amplified over 3 s.
        np.testing.assert_allclose(lane, run(theta), atol=1e-11)


def test_one_trace_per_shape():
    traces = []

    def dynamics(t, x, u, p):
        traces.append(None)
        return p.a * u - x.y[0]

    plant, time = Plant(dynamics, {"a": 1.0}), np.linspace(0.0, 1.0, 11)
    simulate(plant, time, np.ones(11))
    other = plant.with_parameters({"a": 2.0})
    count = len(traces)
    got = simulate(other, time, np.sin(time), 0.3, hold="linear").outputs
    # `dry_friction` of a plant without velocity does not evaluate f.
    assert len(traces) == count
    assert not np.allclose(got, simulate(plant, time, np.sin(time), 0.3, hold="linear").outputs)


# -- the record it returns, and its errors ------------------------------------------------


def test_record_carries_names_units_and_hold():
    plant, time = pendulum(), np.linspace(0.0, 1.0, 101)
    record = simulate(plant, time, np.where(time < 0.5, 0.0, 0.1), name="swing")
    assert (record.name, record.input_names, record.output_names) == (
        "swing",
        ("voltage",),
        ("angle",),
    )
    assert record.units == {"voltage": "V", "angle": "rad"}
    assert record.hold == "zero"
    assert simulate(plant, time, np.sin(time)).hold == "linear"
    np.testing.assert_array_equal(record.outputs[:50], 0.0)  # hangs at rest until it is pushed


TIME = np.linspace(0.0, 1.0, 11)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time": TIME[:3], "inputs": TIME[:3]}, "`time` must be a line of at least 8 samples"),
        ({"time": TIME**2}, "`time` must be a uniform grid"),
        ({"time": TIME[::-1]}, "`time` must increase"),
        ({"time": np.where(TIME == 0, np.nan, TIME)}, "`time` must be finite"),
        ({"inputs": np.zeros((11, 2))}, r"`inputs` must have shape \(11, 1\)"),
        ({"inputs": np.full(11, np.nan)}, "`inputs` must be finite"),
        ({"initial": np.zeros((3, 1))}, r"`initial` must have shape \(2, 1\)"),
        ({"initial": [np.inf, 0.0]}, "`initial` must be finite"),
        ({"internal": [1.0]}, r"`internal` must have shape \(0\)"),
        ({"hold": "cubic"}, "`hold` must be one of auto, zero, linear, smooth"),
        ({"solver": "euler"}, "`solver` must be one of fixed, adaptive"),
        ({"solver": "adaptive"}, '`solver` must be "fixed" for a plant with dry friction'),
        ({"substeps": 0}, "`substeps` must be an integer ≥ 1"),
    ],
)
def test_wrong_calls_name_field_rule_and_value(change, message):
    call = {"time": TIME, "inputs": np.zeros(11)} | change
    with pytest.raises(ValueError, match=message):
        simulate(pendulum(), **call)


def test_internal_start_must_be_finite():
    with pytest.raises(ValueError, match="`internal` must be finite"):
        simulate(cascaded_tanks(), TIME, np.zeros(11), internal=[np.nan])


def test_a_jump_that_cannot_stick_is_refused():
    def dynamics(t, x, u, p):
        return u - p.c * jnp.sign(x.y[1])

    plant = Plant(dynamics, {"c": 1.0}, relative_degree=3)
    with pytest.raises(ValueError, match="must have relative degree 2 or 1 wherever f jumps"):
        simulate(plant, TIME, np.zeros(11))


def test_divergence_names_the_first_time_that_is_not_finite():
    def dynamics(t, x, u, p):
        return p.a * x.y[0] ** 2

    plant = Plant(dynamics, {"a": 1.0})  # 1 / (1 − t): escapes at t = 1
    time = np.linspace(0.0, 5.0, 501)
    with pytest.raises(
        ValueError, match=r"must stay finite, got NaN or infinity from t = 1\.\d+ s"
    ):
        simulate(plant, time, np.zeros(501), 1.0)


@pytest.mark.parametrize("inputs", [("u",), ()])
def test_runs_in_one_chain_are_those_one_by_one(inputs: tuple[str, ...]):
    """With dry friction; the length is rounded up, and each run starts where it is told."""
    plant = Plant(
        lambda t, x, u, p: -p.k * x.y[0] - p.c * jnp.sign(x.y[1]) + jnp.sum(u) + jnp.cos(3.0 * t),
        {"k": 4.0, "c": 0.2},
        relative_degree=2,
        inputs=inputs,
    )
    runs, steps, theta = 3, 217, jnp.asarray(plant.theta)
    random = np.random.default_rng(8)
    push = np.repeat(random.standard_normal((runs, steps, 1, len(inputs))), 3, axis=2)
    clock = 0.01 * np.arange(steps) + np.array([[0.0], [2.0], [5.0]])
    drives = Drive(clock, np.full(runs, 0.01), push, 7, push[:, -1, 2])
    starts = jax.vmap(State)(
        jnp.asarray(random.standard_normal((runs, 2, 1))), jnp.zeros((runs, 0))
    )
    together = chained(plant, theta, drives, starts, (True,))
    run = jit(lambda drive, start: trajectory(plant, theta, drive, start, (True,))[0])
    for i in range(runs):
        alone, start = (jax.tree.map(lambda leaf: leaf[i], one) for one in (drives, starts))  # noqa: B023
        np.testing.assert_allclose(
            together[i], np.asarray(run(alone, start))[:, 0], rtol=1e-12, atol=1e-12
        )


def test_adaptive_solver_refuses_a_plant_behind_an_actuator():
    plant = Plant(lambda t, x, u, p: -p.k * x.y[0] + u, {"k": 1.0}, actuator=lambda t, u, p: u)
    time = np.linspace(0.0, 1.0, 50)
    with pytest.raises(ValueError, match='must be "fixed" for a plant with a delay or lag'):
        simulate(plant, time, np.zeros(50), solver="adaptive")


def test_actuator_of_a_wrong_shape_is_found_when_the_plant_is_made():
    with pytest.raises(ValueError, match="`actuator` must return as many inputs as it gets"):
        Plant(lambda t, x, u, p: p.k * u, {"k": 1.0}, actuator=lambda t, u, p: u[:, 0])


def test_stops_are_where_the_parabola_of_the_velocity_falls_through_zero():
    draw = np.random.default_rng(0)
    # Down to speeds that are all but rest: a root as a difference would have no digits left.
    v0, v1 = 10.0 ** draw.uniform(-13.0, 0.0, 200), -draw.uniform(0.1, 1.0, 200)
    dv = draw.uniform(-3.0, 3.0, 200)
    way = draw.choice([-1.0, 1.0], 200)
    stops = draw.uniform(size=200) < 0.8
    found = np.asarray(jit(first_zero)(way * v0, way * dv, way * v1, way, stops))
    assert np.all((found >= 0.0) & (found <= 1.0) & (stops | (found == 1.0)))
    bend = v1 - v0 - dv
    left = v0 + dv * found + bend * found**2
    size = v0 + np.abs(dv) * found + np.abs(bend) * found**2
    assert np.all(np.abs(left[stops]) < 1e-12 * size[stops])


def test_internal_states_go_on_while_friction_reaches_another_output():
    """The load of a trolley with friction, and beside them z' = 1 - z, w' = z."""

    def all_three(t, x, u, p):
        (one, two, _), (speed, _, _) = x.y
        force = u[0] - p.k * one - p.c * jnp.sign(speed)
        return jnp.stack([force, -0.4 * force - 30.0 * two, x.z[0]])

    plant = Plant(
        all_three, {"k": 30.0, "c": 0.4}, (2, 2, 1), ("u",), ("y1", "y2", "w"),
        internal=lambda t, x, u, p: jnp.stack([1.0 - x.z[0]]), internal_initial=(0.0,),
    )  # fmt: skip
    assert REACHES in frictional(plant)
    time = 2e-3 * np.arange(1001)
    start = np.zeros((2, 3))
    found = simulate(plant, time, np.sign(np.sin(4.0 * time)), start).outputs[:, 2]
    np.testing.assert_allclose(found, time - 1.0 + np.exp(-time), atol=1e-10)


def test_a_start_by_name_fills_up_known_starts_and_zeros():
    plant = eoi.plants.three_mass_spring_damper().declared_anew(
        initial={"position_2": (None, 0.5), "position_3": 0.1}
    )
    time, force = np.arange(0.0, 0.5, 0.01), np.zeros(50)
    start = {"position_1": 0.2, "position_3": (0.3, -1.0)}
    by_name = eoi.simulate(plant, time, force, initial=start)
    by_array = eoi.simulate(plant, time, force, initial=[[0.2, 0.0, 0.3], [0.0, 0.5, -1.0]])
    np.testing.assert_array_equal(by_name.outputs, by_array.outputs)


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({"positon": 0.1}, r"`initial` must be one of position, got 'positon'. Did you mean"),
        ({"position": (1.0, 2.0, 3.0)}, r"`initial\[position\]` must be at most 2 values"),
        ({"position": "0.1"}, r"`initial\[position\]` must hold finite numbers"),
        ("rest", r"`initial` must be numbers of shape \(2, 1\) or a dict by output, got rest"),
        (object, r"Write \{'position': \(value, rate, …\)\}"),
    ],
)
def test_a_wrong_start_says_what_is_expected(initial, message):
    time = np.arange(0.0, 0.5, 0.01)
    with pytest.raises(ValueError, match=message):
        eoi.simulate(eoi.plants.mass_spring_damper(), time, np.zeros(50), initial=initial)


def test_a_jump_of_the_equations_in_time_is_told():
    time, still = np.arange(0.0, 3.0, 0.25), np.zeros((12, 0))
    plant = eoi.plant_from_text({"y": "a*(t > 0.6) - y"}, {"a": 1.0}, ["y"])
    with pytest.warns(RuntimeWarning, match=r"jump at t = 0.6 s.*Give more `substeps`"):
        simulate(plant, time, still)
    exact = np.where(time > 0.6, 1.0 - np.exp(0.6 - time), 0.0)
    for result in (
        simulate(plant, time, still, substeps=100),
        simulate(plant, time, still, solver="adaptive"),
    ):
        np.testing.assert_allclose(result.outputs[:, 0], exact, atol=2e-3)
    simulate(plant.with_parameters({"a": 0.0}), time, still)
    for term in ("tanh(t/0.01)", "sin(8*pi*t)"):  # the last one alike at all samples
        smooth = eoi.plant_from_text({"y": f"a*{term} - y"}, {"a": 1.0}, ["y"])
        simulate(smooth, time, still)


def test_half_as_long_steps_agree_by_default():
    """A friction and a wall of one plant: the steps end at the stops alone."""

    def wall(t, x, u, p):
        q, v = x.y[:, 0]
        return (
            u[0]
            - 13.0 * q
            - 0.1 * jnp.sign(v)
            - jnp.where(q > 0.1, 900.0 * (q - 0.1) + 6.0 * v, 0.0)
        )

    plant, time = Plant(wall, {"none": 0.0}, 2), 0.004 * np.arange(1000)
    inputs = 4.0 * np.round(np.sin(3.0 * time))
    run, exact, single = (
        simulate(plant, time, inputs, hold="zero", substeps=count).outputs
        for count in (None, 500, 1)
    )
    spread = np.std(exact)
    assert np.sqrt(np.mean((single - exact) ** 2)) > 5e-4 * spread
    assert np.sqrt(np.mean((run - exact) ** 2)) < 2e-4 * spread


def test_a_run_that_no_steps_settle_says_so():
    """The equations of Lorenz over twenty times the length in which an error grows tenfold."""

    def lorenz(t, x, u, p):
        a, b, c = x.y[0]
        return jnp.stack([10.0 * (b - a), a * (28.0 - c) - b, a * b - 8.0 / 3.0 * c])

    plant = Plant(lorenz, {"none": 0.0}, 1, inputs=[], outputs=["a", "b", "c"])
    time, start = 0.02 * np.arange(2500), np.array([[1.0, 1.0, 20.0]])
    with pytest.warns(
        RuntimeWarning, match=r"changes [abc] by .*What is returned has 1 step a samp"
    ):
        run = simulate(plant, time, np.zeros((2500, 0)), start)
    by_hand = simulate(plant, time, np.zeros((2500, 0)), start, substeps=1)
    np.testing.assert_array_equal(run.outputs, by_hand.outputs)


# -- jumps with the state -------------------------------------------------------------------


def contact(t, x, u, p):
    q, v = x.y[:, 0]
    pull = u[0] - 1.2 * v - 13.0 * q
    return pull - jnp.where(q > 0.1, p.k * (q - 0.1) + p.d * v, 0.0)


def test_a_contact_with_damping_converges_at_fourth_order():
    plant = Plant(contact, {"k": 900.0, "d": 6.0}, 2)
    time = 0.005 * np.arange(400)
    inputs = 2.0 * np.sin(4.0 * time)
    events = np.empty(400)
    state, inside = np.zeros(2), False
    for i, u in enumerate(inputs):
        events[i], remaining = state[0], 0.005
        while remaining > 1e-15:

            def rate(t, z, u=u, inside=inside):
                wall = 900.0 * (z[0] - 0.1) + 6.0 * z[1] if inside else 0.0
                return [z[1], u - 1.2 * z[1] - 13.0 * z[0] - wall]

            def border(t, z, inside=inside):
                return z[0] - 0.1 if t > 1e-9 else (1.0 if inside else -1.0)

            border.terminal, border.direction = True, -1 if inside else 1
            span = 0.0, remaining
            run: Any = solve_ivp(rate, span, state, "DOP853", events=border, rtol=1e-12, atol=1e-14)
            state, remaining = run.y[:, -1], remaining - run.t[-1]
            inside ^= bool(run.t_events[0].size)
    errors = [
        np.max(
            np.abs(simulate(plant, time, inputs, hold="zero", substeps=n).outputs[:, 0] - events)
        )
        for n in (1, 4)
    ]
    assert errors[0] < 1e-6  # of 0.12
    assert errors[1] < errors[0] / 100.0  # 256 in the limit


def test_several_jumps_of_vectors_and_signs_are_crossed():
    """A tent: uniform slopes on both sides of a ridge, with a ditch on one of them."""

    def tent(t, x, u, p):
        q = x.y[0]
        return p.g * jnp.sign(q) - jnp.where((q > 1.0) & (q < 2.0), p.d, jnp.zeros(1))

    plant = Plant(tent, {"g": 1.0, "d": 0.5}, 2, inputs=[])
    time = np.linspace(0.0, 4.0, 9)
    run = simulate(plant, time, np.zeros((9, 0)), {"y": (-0.5, 1.5)}, substeps=1).outputs[:, 0]
    # From -0.5 to 0 with an acceleration of -1, on to 1 with +1 + 0, and to 2 with 1 - 0.5.
    speeds = np.sqrt([1.25, 3.25, 4.25])
    at = np.cumsum([1.5 - speeds[0], speeds[1] - speeds[0], (speeds[2] - speeds[1]) / 0.5])
    later = time[time > at[2]] - at[2]
    exact = 2.0 + speeds[2] * later + 0.5 * later**2
    np.testing.assert_allclose(run[time > at[2]], exact, rtol=1e-9)


def test_equations_without_numbers_beyond_a_jump_take_the_step_as_it_is():
    """A vessel that runs empty: beyond its bottom the root is no number."""

    def vessel(t, x, u, p):
        level = x.y[0, 0]
        return -jnp.where(level > 0.0, p.k + jnp.sqrt(level), 0.0)

    plant, time = Plant(vessel, {"k": 0.5}, 1, inputs=[]), 0.01 * np.arange(200)
    run = simulate(plant, time, np.zeros((200, 0)), {"y": 0.5}, substeps=4).outputs[:, 0]
    np.testing.assert_allclose(run[-20:], 0.0, atol=0.01)
