"""What acts on a whole equation: capacity, a rate for each way, a bent sensor; and a ramp."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.equations.display import equation_text
from eoi_jax.models.plant import State

LAWS = {
    "linear": lambda y, a: 1.0 + a * y,
    "even": lambda y, a: 1.0 + a * y * y,
    "power": lambda y, a: y**a,
}


def tank(t, x, u, p):
    return p.gain * u - p.outflow * jnp.sqrt(jnp.maximum(x.y[0], 1e-9))


TANK = eoi.Plant(tank, {"gain": 1.0, "outflow": 0.8}, 1, ("pump",), ("level",))


@pytest.mark.parametrize("law", LAWS)
def test_all_that_acts_on_the_output_is_divided(law):
    """Also a leak that is added later, and one that was there before."""
    capacity = effects.VaryingCapacity(law)
    parts = [(capacity, {capacity.name: 0.7}), (effects.Leak(), {"leak": 0.3})]
    for order in (parts, parts[::-1]):
        plant = TANK
        for effect, values in order:
            at = place(plant, effect, 0)
            plant = augmented(plant, (at,), dict(zip(at.names, values.values(), strict=True)))
        for level in (0.4, 1.0, 2.5):
            state = State(jnp.array([[level]]), jnp.zeros(0))
            slope = plant.dynamics(0.0, state, jnp.array([1.5]), plant.named(plant.theta))
            expected = (1.5 - 0.8 * np.sqrt(level) - 0.3 * level) / LAWS[law](level, 0.7)
            assert slope[0] == pytest.approx(expected, rel=1e-12)


def test_what_is_not_stored_has_no_capacity():
    force = eoi.Plant(tank, {"gain": 1.0, "outflow": 0.8}, 1, ("v",), ("f",), kinds={"f": "force"})
    for effect in (effects.VaryingCapacity(), effects.RateAsymmetry()):
        assert effect.fits(TANK, 0)
        assert not effect.fits(force, 0)


def test_the_equation_has_it_in_front_of_all():
    capacity = effects.VaryingCapacity("linear")
    at = place(TANK, capacity, 0)
    plant = augmented(TANK, (at,), {"varying_capacity": 0.7})
    assert "varying_capacity·level" in equation_text(plant)


@pytest.mark.parametrize("asymmetry", [-0.5, 0.4])
def test_what_rises_has_another_rate_than_what_falls(asymmetry):
    at = place(TANK, effects.RateAsymmetry(), 0)
    plant = augmented(TANK, (at,), {"rate_asymmetry": asymmetry})
    for level, pump in ((0.4, 1.5), (2.5, 0.3)):
        state = State(jnp.array([[level]]), jnp.zeros(0))
        rate = pump - 0.8 * np.sqrt(level)
        slope = plant.dynamics(0.0, state, jnp.array([pump]), plant.named(plant.theta))
        assert slope[0] == pytest.approx(rate * (1.0 + asymmetry * np.sign(rate)), rel=1e-12)


@pytest.mark.parametrize("bend", [-0.08, 0.25])
@pytest.mark.parametrize("degree", [1, 2])
def test_a_bent_sensor_shows_the_image_of_the_motion(degree, bend):
    """By the chain rule, of y = x + c x²."""

    def law(t, x, u, p):
        return u - p.k * x.y[0] - (p.c * x.y[1] if degree == 2 else 0.0)

    plain = eoi.Plant(law, {"k": 4.0, "c": 0.6}, degree)
    at = place(plain, effects.SensorCurve(), 0)
    plant = augmented(plain, (at,), {"sensor_curve": bend})
    for x, rate in ((0.7, -1.3), (-0.6, 0.4), (1.5, 2.0)):
        force = 0.9 - 4.0 * x - (0.6 * rate if degree == 2 else 0.0)
        slope = 1.0 + 2.0 * bend * x
        seen = [[x + bend * x**2], [slope * rate]][:degree]
        highest = slope * force + (2.0 * bend * rate**2 if degree == 2 else 0.0)
        state = State(jnp.array(seen), jnp.zeros(0))
        got = plant.dynamics(0.0, state, jnp.array([0.9]), plant.named(plant.theta))
        assert got[0] == pytest.approx(highest, rel=1e-12)


def test_a_limited_actuator_ramps_to_its_input():
    """Its mean over each step: a trapezium where it arrives within the step."""
    time, u = np.array([0.05, 0.15, 0.25, 0.35, 0.45]), np.array([0.0, 1.0, 1.0, 1.0, -9.0])
    ramp = effects.RateLimit().along(time, jnp.asarray(u), [4.0])
    np.testing.assert_allclose(ramp, [0.0, 0.2, 0.6, 0.95, 0.8], atol=1e-12)


def test_a_limited_actuator_steps_as_it_runs_along():
    time, u = np.arange(40) * 0.1, np.random.default_rng(1).uniform(-1.0, 1.0, 40)
    limit, memory, means = effects.RateLimit(), jnp.asarray(u[:1]), []
    assert limit.memory(0.1, [3.0]) == 1
    for value in u:
        memory, mean = limit.step(memory, value, 0.1, [3.0])
        means.append(mean)
    np.testing.assert_allclose(limit.along(time, jnp.asarray(u), [3.0]), means, rtol=1e-12)


def test_a_play_follows_half_its_gap_late_and_stays_at_a_reversal():
    time, u = 0.1 * np.arange(6), jnp.array([0.0, 0.1, 1.0, 0.8, 0.5, -0.5])
    played = effects.InputPlay().along(time, u, [0.4])
    np.testing.assert_allclose(played, [0.0, 0.0, 0.8, 0.8, 0.7, -0.3], atol=1e-12)


def test_a_play_steps_as_it_runs_along():
    time, u = 0.1 * np.arange(40), np.random.default_rng(1).uniform(-1.0, 1.0, 40)
    play, memory, means = effects.InputPlay(), jnp.asarray(u[:1]), []
    assert play.memory(0.1, [0.5]) == 1
    for value in u:
        memory, mean = play.step(memory, value, 0.1, [0.5])
        means.append(mean)
    np.testing.assert_allclose(play.along(time, jnp.asarray(u), [0.5]), means, rtol=1e-12)


def cone(seed, count=1200, period=0.1):
    """A cone-shaped tank (its section grows with the square of the level) by SciPy."""
    random = np.random.default_rng(seed)
    pump = np.repeat(random.uniform(0.5, 1.3, count // 40), 40)
    level, run = 1.0, np.empty(count)
    for i in range(count):
        run[i] = level
        level = solve_ivp(
            lambda _, y, u=pump[i]: (u - 0.8 * np.sqrt(y)) / y**2, (0.0, period), [level], rtol=1e-9
        ).y[0, -1]
    noisy = run + 2e-3 * np.std(run) * random.normal(size=count)
    return eoi.Record(
        period * np.arange(count), pump, noisy, f"run {seed}", hold="zero",
        input_names="pump", output_names="level",
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.long
def test_the_section_of_a_cone_is_found_with_its_exponent():
    answer = eoi.discover(TANK, cone(1), validation=cone(2))
    assert answer.effects == ("varying_capacity",)
    assert answer.status.code == "complete"
    found = answer.plant.parameters
    assert found["varying_capacity_exponent"] == pytest.approx(2.0, rel=0.02)
    assert found["gain"] == pytest.approx(1.0, rel=0.02)


def driven(law, count=1000, period=0.02, seed=3):
    """What hides a limit of the current, a valve, or friction under load, by SciPy's integrator."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-3.0, 3.0, count // 25), 25)
    x, run = np.zeros(2 if law is loaded else 1), np.empty(count)
    for i in range(count):
        run[i] = x[0]
        x = solve_ivp(
            lambda _, x, u=u[i]: law(x, u), (0.0, period), x, rtol=1e-8, atol=1e-10, max_step=0.01
        ).y[:, -1]
    noisy = run + 2e-3 * np.std(run) * random.normal(size=count)
    return eoi.Record.from_period(period, u, noisy, f"run {seed}", hold="zero")


def limited(x, u):
    return [3.0 * np.clip(u - 0.5 * x[0], -1.0, 1.0) - 0.3 * x[0]]


def throttled(x, u):
    return [0.7 * u * np.sqrt(max(5.0 - np.sign(u) * x[0], 0.0)) - 1.0 * x[0]]


def one_way(x, u):
    return [(1.0 if 2.0 * u > x[0] else 0.4) * (2.0 * u - x[0])]


def loaded(x, u):
    return [x[1], 2.0 * u - 10.0 * x[0] - 0.8 * x[1] - 0.3 * abs(u) * np.tanh(x[1] / 1e-2)]


def bent(count=1000, period=0.05, seed=3):
    """A first-order plant behind a sensor of y = x + 0.25 x²; exact between its samples."""
    random = np.random.default_rng(seed)
    u, x, run = np.repeat(random.uniform(0.0, 2.0, count // 25), 25), 0.5, np.empty(count)
    for i in range(count):
        run[i] = x + 0.25 * x**2
        x = u[i] / 0.7 + (x - u[i] / 0.7) * np.exp(-0.7 * period)
    noisy = run + 2e-3 * np.std(run) * random.normal(size=count)
    return eoi.Record.from_period(period, u, noisy, f"run {seed}", hold="zero")


@pytest.mark.slow
@pytest.mark.long
def test_a_bent_sensor_is_named_and_measured():
    plant = eoi.Plant(lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 0.8, "k": 1.0}, 1)
    answer = eoi.discover(plant, bent(), validation=bent(seed=4))
    assert answer.effects == ("sensor_curve",)
    assert answer.plant.parameters["sensor_curve"] == pytest.approx(0.25, rel=0.02)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "name", "values"),
    [
        (limited, "current_limit", {"current_limit_back_emf": 0.5, "current_limit_level": 1.0}),
        (throttled, "valve_flow", {"valve_flow_supply": 5.0}),
        (loaded, "load_friction", {"load_friction": 0.3}),
        (one_way, "rate_asymmetry", {"rate_asymmetry": 3.0 / 7.0}),
    ],
)
def test_laws_of_input_and_output_are_named_and_measured(law, name, values):
    if law is loaded:
        plant = eoi.Plant(
            lambda t, x, u, p: p.b * u - p.k * x.y[0] - p.c * x.y[1],
            {"b": 1.5, "k": 8.0, "c": 1.0}, 2,
        )  # fmt: skip
    else:
        plant = eoi.Plant(lambda t, x, u, p: p.b * u - p.k * x.y[0], {"b": 1.0, "k": 1.0}, 1)
    answer = eoi.discover(plant, driven(law), validation=driven(law, seed=4))
    assert answer.effects == (name,)
    for parameter, value in values.items():
        assert answer.plant.parameters[parameter] == pytest.approx(value, rel=0.02)


def test_a_capacity_that_grows_without_bound_ends_in_a_power():
    """1 + q y is q y there, a power of exponent one; an even law is one of both signs."""
    assert effects.VaryingCapacity("linear").limit() == effects.VaryingCapacity("power")
    assert effects.VaryingCapacity("even").limit() is None
    assert effects.VaryingCapacity("power").limit() is None
