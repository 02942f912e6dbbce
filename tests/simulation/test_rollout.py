"""The free run inside JAX code: that of `simulate`, and its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi

H = 0.01
TIME = H * np.arange(200)
INPUT = 5.0 * np.round(np.sin(4.0 * TIME))


def stuck(t, x, u, p):
    rate = x.y[1, 0]
    return u[0] - p.k * x.y[0, 0] - p.d * rate - p.c * jnp.sign(rate)


# Friction of 3 of 5: it comes to rest, and breaks away again.
ROUGH = eoi.Plant(stuck, {"k": 8.0, "d": 0.5, "c": 3.0}, 2)
SMOOTH = eoi.plants.mass_spring_damper()


def differences(function, at, step=1e-6):
    """Central differences."""
    sides = [
        (function(at + one) - function(at - one)) / (2 * step) for one in step * np.eye(len(at))
    ]
    return np.asarray(sides)


def lagged(t, u, p):
    """A first-order lag with time constant p.T, of the means over the steps."""
    share = jnp.exp(-(t[1] - t[0]) / p.T)

    def step(v, value):
        v = share * v + (1.0 - share) * value
        return v, v

    return jax.lax.scan(step, jnp.zeros_like(u[0]), u)[1]


def with_accelerometer(t, x, u, p):
    acceleration = u[0] - p.k * x.y[0, 0]
    return jnp.stack([acceleration, acceleration - p.g])


PLANTS = {
    "tanks": eoi.plants.cascaded_tanks(),
    "masses": eoi.plants.three_mass_spring_damper(),
    "friction": ROUGH,
    "lag and accelerometer": eoi.Plant(
        with_accelerometer,
        {"k": 9.0, "g": 1.0, "T": 0.05},
        (2, 0),
        outputs=("position", "acceleration"),
        actuator=lagged,
    ),
}


@pytest.mark.parametrize(("name", "hold"), [*zip(PLANTS, ["zero", "linear"] * 2, strict=True)])
def test_it_is_the_run_of_simulate(name, hold):
    plant = PLANTS[name]
    inputs = np.stack([np.sign(np.sin((3.0 + i) * TIME)) for i in range(len(plant.inputs))], 1)
    record = eoi.simulate(plant, TIME, 2.0 + inputs, hold=hold, substeps=2)
    states = eoi.rollout(plant, None, None, 2.0 + inputs, H, hold=hold, substeps=2)
    np.testing.assert_allclose(states.y[:, 0], record.outputs, rtol=1e-9, atol=1e-12)


def test_a_start_is_an_array_or_a_state():
    run = eoi.simulate(ROUGH, TIME, INPUT, [0.3, -1.0], hold="zero", substeps=1)
    states = eoi.rollout(ROUGH, None, [0.3, -1.0], INPUT, H)
    np.testing.assert_allclose(states.y[:, 0], run.outputs, rtol=1e-12)
    middle = jax.tree.map(lambda leaf: leaf[100], states)
    later = eoi.rollout(ROUGH, None, middle, INPUT[100:], H, t0=TIME[100])
    np.testing.assert_allclose(later.y, states.y[100:], rtol=1e-9, atol=1e-12)


def rough_cost(theta):
    y = eoi.rollout(ROUGH, theta, None, INPUT, H).y[:, 0, 0]
    return jnp.mean(y**2)


def rough_slopes():
    want = differences(jax.jit(rough_cost), ROUGH.theta)
    assert np.all(np.abs(want) > 1e-4)
    return want


def test_dry_friction_sticks_and_forward_derivatives_equal_differences():
    theta = jnp.asarray(ROUGH.theta)
    rates = eoi.rollout(ROUGH, theta, None, INPUT, H).y[:, 1, 0]
    assert 0.1 < np.mean(np.asarray(rates) == 0.0) < 0.9
    for direction, want in zip(np.eye(3), rough_slopes(), strict=True):
        slope = jax.jvp(rough_cost, (theta,), (jnp.asarray(direction),))[1]
        np.testing.assert_allclose(slope, want, rtol=1e-6)


@pytest.mark.slow
def test_reverse_derivatives_with_dry_friction_equal_differences():
    got = jax.jit(jax.grad(rough_cost))(jnp.asarray(ROUGH.theta))
    np.testing.assert_allclose(got, rough_slopes(), rtol=1e-6)


def test_derivatives_by_input_and_start_equal_differences():
    def end(levels):
        u = jnp.repeat(levels[2:], 50)
        return eoi.rollout(SMOOTH, {}, levels[:2], u, H, hold="linear").y[-1, 0, 0]

    at = np.array([0.1, -0.2, 1.0, -1.0, 0.5, 2.0])
    got = jax.grad(end)(jnp.asarray(at))
    np.testing.assert_allclose(got, differences(end, at), rtol=1e-6, atol=1e-9)


def test_vmap_over_inputs_and_parameters_equals_single_runs():
    name = SMOOTH.names[0]
    values = jnp.asarray(SMOOTH.theta[0] * np.array([0.8, 1.0, 1.3]))
    inputs = jnp.stack([jnp.asarray(INPUT), 0.5 * jnp.asarray(INPUT)])

    def run(value, u):
        return eoi.rollout(SMOOTH, {name: value}, None, u, H).y[:, 0, 0]

    grid = jax.jit(jax.vmap(jax.vmap(run, (0, None)), (None, 0)))(values, inputs)
    assert grid.shape == (2, 3, len(TIME))
    for i in range(2):
        for j in range(3):
            np.testing.assert_allclose(grid[i, j], run(values[j], inputs[i]), rtol=1e-9, atol=1e-12)


def test_it_runs_in_a_scan_of_the_user():
    def window(x, u):
        states = eoi.rollout(ROUGH, None, x, u, H)
        return jax.tree.map(lambda leaf: leaf[-1], states), states.y[:-1, 0, 0]

    start = eoi.State(jnp.zeros((2, 1)), jnp.zeros(0))
    # Windows of 20 steps share their last sample with the first of the next.
    index = 20 * np.arange(9)[:, None] + np.arange(21)
    _, parts = jax.lax.scan(window, start, jnp.asarray(INPUT[index]))
    whole = eoi.rollout(ROUGH, None, None, INPUT, H).y[:, 0, 0]
    np.testing.assert_allclose(parts.ravel(), whole[:180], rtol=1e-9, atol=1e-12)


def test_a_plant_takes_traced_parameters():
    @jax.jit
    def last(k):
        plant = ROUGH.with_parameters({"k": k})
        return plant.theta, eoi.rollout(plant, None, None, INPUT, H).y[-1, 0, 0]

    theta, end = last(9.0)
    np.testing.assert_array_equal(theta, [9.0, 0.5, 3.0])
    want = eoi.rollout(ROUGH, [9.0, 0.5, 3.0], None, INPUT, H).y[-1, 0, 0]
    np.testing.assert_allclose(end, want, rtol=1e-12)


@pytest.mark.parametrize("transform", [jax.jit, jax.grad])
def test_simulate_in_traced_code_names_rollout(transform):
    def by_input(scale):
        return jnp.sum(eoi.simulate(SMOOTH, TIME, scale * INPUT).outputs)

    def by_parameter(value):
        plant = SMOOTH.with_parameters({SMOOTH.names[0]: value})
        return jnp.sum(eoi.simulate(plant, TIME, INPUT).outputs)

    for function in (by_input, by_parameter):
        with pytest.raises(ValueError, match=r"use `rollout\(plant, theta, x0, u, h\)`"):
            transform(function)(1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((SMOOTH, None, None, np.ones((5, 2)), H), r"`u` must have shape \(any, 1\)"),
        ((SMOOTH, None, None, eoi.simulate(SMOOTH, TIME, INPUT), H), r"a Record. Give its `.inp"),
        ((SMOOTH, None, None, np.ones((3, 200)), H), r"got shape \(3, 200\)\. .* use `jax.vmap`"),
        ((SMOOTH, None, None, INPUT, 0.0), "`h` must be positive and finite, got 0.0"),
        ((SMOOTH, None, None, INPUT, -H), "`h` must be positive and finite, got -0.01"),
        ((SMOOTH, None, {"angle": 1.0}, INPUT, H), "`initial` must be one of position, got"),
        ((SMOOTH, None, None, np.ones(1), H), "`u` must have at least two samples, got 1"),
        ((SMOOTH, None, np.ones(3), INPUT, H), r"`initial` must have shape \(2, 1\)"),
        ((SMOOTH, {"kk": 1.0}, None, INPUT, H), "`parameters` must be one of"),
        ((SMOOTH, [1.0], None, INPUT, H), "`parameters` must be"),
        ((SMOOTH, None, eoi.State(np.zeros((2, 1)), np.zeros(1)), INPUT, H), r"`x0.z` must have"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        eoi.rollout(*arguments)


def test_a_wrong_hold_or_number_of_steps_is_named():
    with pytest.raises(ValueError, match="`hold` must be one of zero, linear, got 'smooth'"):
        eoi.rollout(SMOOTH, None, None, INPUT, H, hold="smooth")
    with pytest.raises(ValueError, match="`substeps` must be an integer ≥ 1, got 0"):
        eoi.rollout(SMOOTH, None, None, INPUT, H, substeps=0)


def test_a_start_by_name_is_that_of_the_array_and_has_its_derivative():
    def end(position):
        start = {"position": (position, 0.3)}
        return eoi.rollout(SMOOTH, None, start, INPUT, H).y[-1, 0, 0]

    array = eoi.rollout(SMOOTH, None, [0.2, 0.3], INPUT, H).y[-1, 0, 0]
    assert jax.jit(end)(0.2) == pytest.approx(float(array), rel=1e-12)
    slope = (float(end(1.2)) - float(end(-0.8))) / 2.0  # the plant is linear
    assert float(jax.grad(end)(0.2)) == pytest.approx(slope, rel=1e-9)


@pytest.mark.parametrize("slope", [jax.grad, jax.jacfwd])
def test_derivatives_at_a_jump_have_that_of_the_instant(slope):
    """y'' = -d beyond y = 1, entered at 1/v: y(1) = v - d (1 - 1/v)² / 2."""

    def zone(t, x, u, p):
        return -jnp.where(x.y[0, 0] > 1.0, p.d, 0.0)

    plant, still = eoi.Plant(zone, {"d": 1.0}, 2, inputs=[]), np.zeros((101, 0))

    def end(v, d):
        return eoi.rollout(plant, {"d": d}, jnp.stack([0.0, v]), still, 0.01).y[-1, 0, 0]

    np.testing.assert_allclose(end(2.0, 1.0), 1.875, rtol=1e-12)
    np.testing.assert_allclose(slope(end)(2.0, 1.0), 0.875, rtol=1e-9)
    np.testing.assert_allclose(slope(end, 1)(2.0, 1.0), -0.125, rtol=1e-9)
