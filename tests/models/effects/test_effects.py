"""What every effect must do, and what single ones promise."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.compiler.programs import jit
from eoi_jax.discovery.candidates import atoms
from eoi_jax.discovery.cosine_modes import modal_record
from eoi_jax.discovery.regression import fitted
from eoi_jax.discovery.round_start import base_of
from eoi_jax.models.augmented import Placed, augmented, place, unit
from eoi_jax.models.effects.effect import (
    AbstractActuator,
    AbstractEffect,
    AbstractInputEffect,
    AbstractInternalEffect,
    AbstractTerm,
    At,
    Seen,
)
from eoi_jax.models.placements import placements

# Gravity in degrees is checked against that in radians: its grid is empty over a few degrees.
EFFECTS = (
    *(one for one in effects.standard() if not getattr(one, "degrees", False)),
    effects.AsymmetricViscousFriction(),
)
TERMS = [one for one in EFFECTS if isinstance(one, AbstractTerm)]
INTERNAL = [one for one in EFFECTS if isinstance(one, AbstractInternalEffect)]
INPUT_EFFECTS = [one for one in EFFECTS if isinstance(one, AbstractInputEffect)]


def label(effect: AbstractEffect) -> str:
    return "-".join([effect.name, *(str(value) for value in vars(effect).values())])


def each(several: Any) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("effect", several, ids=label)


def spring(t, x, u, p):
    position, rate = x.y
    return -p.k * position - p.c * rate + p.b * u


def tank(t, x, u, p):
    return -p.k * x.y[0] + p.b * u


def swinging(unit_of_position: str) -> eoi.Plant:
    return eoi.Plant(
        spring,
        {"k": 20.0, "c": 0.8, "b": 2.0},
        relative_degree=2,
        inputs=("voltage",),
        outputs=("position",),
        units={"voltage": "V", "position": unit_of_position},
    )


MASS = swinging("m")
TANK = eoi.Plant(
    tank,
    {"k": 0.5, "b": 0.3},
    inputs=("flow",),
    outputs=("level",),
    units={"flow": "m³/s", "level": "m"},
)


CASCADE = eoi.Plant(
    lambda t, x, u, p: p.k * (x.z[0] - x.y[0]),
    {"k": 0.5, "b": 0.3},
    inputs=("flow",),
    outputs=("level",),
    internal=lambda t, x, u, p: p.b * u - p.k * x.z,
    internal_initial=(0.0,),
    units={"flow": "m³/s", "level": "m", "z": "m"},
)


def plant_for(effect: AbstractEffect) -> eoi.Plant:
    if isinstance(effect, AbstractInternalEffect):
        return CASCADE
    return MASS if effect.fits(MASS, 0) else TANK


def seen(seed: int = 0) -> Seen:
    random = np.random.default_rng(seed)
    y, v, u = random.standard_normal((3, 5000))
    return Seen(y, v, 2.0 * u, False, 1e-4, 40.0, 5e-3, 10.0, np.array([1.0, 3.0]))


def somewhere(effect: AbstractEffect, seed: int = 0) -> At:
    random = np.random.default_rng(seed)
    t, y, v, u = (jnp.asarray(value) for value in random.uniform(0.1, 2.0, 4))
    return At(t, y, -v, u, jnp.asarray(random.uniform(-0.5, 0.5, effect.states)))


# -- every effect ---------------------------------------------------------------------------------


@each(EFFECTS)
def test_grid_is_finite_and_within_the_bounds(effect: AbstractEffect):
    grid = effect.grid(seen())
    assert grid.ndim == 2
    assert grid.shape[0] >= 1
    assert grid.shape[1] == len(effect.shapes)
    assert np.all(np.isfinite(grid))
    for values, parameter in zip(grid.T, effect.shapes, strict=True):
        assert np.all((values >= parameter.lower) & (values <= parameter.upper))
    assert len(np.unique(grid, axis=0)) == len(grid)


@each(EFFECTS)
def test_grid_survives_signals_that_do_not_move(effect: AbstractEffect):
    still, none = np.zeros(200), np.zeros(0)
    grid = effect.grid(Seen(still, still, still, False, 0.0, 1.0, 5e-3, 10.0, none))
    assert grid.ndim == 2
    assert grid.shape[1] == len(effect.shapes)


@each(TERMS)
def test_term_is_linear_in_its_gains(effect: AbstractTerm):
    random = np.random.default_rng(1)
    first, second = random.standard_normal((2, len(effect.gains)))
    at = somewhere(effect)
    term = jit(effect.term)
    for shape in effect.grid(seen())[::3]:
        both = float(term(at, 2.0 * first - second, shape))
        apart = 2.0 * float(term(at, first, shape)) - float(term(at, second, shape))
        assert both == pytest.approx(apart, rel=1e-12, abs=1e-12)


@each(TERMS)
def test_term_without_gain_leaves_the_plant_as_it_is(effect: AbstractTerm):
    plant = plant_for(effect)
    placed = place(plant, effect, 0)
    shape = effect.grid(seen())[0]
    values = dict(zip(placed.names, [*(0.0 for _ in effect.gains), *shape], strict=True))
    assert_same_derivative(plant, augmented(plant, [placed], values))


NEUTRAL = {
    "input_dead_zone": 0.0,
    "input_saturation": 1e9,
    "input_quadratic": 0.0,
    "input_asymmetry": 0.0,
}


@each([one for one in INPUT_EFFECTS if one.name in NEUTRAL])
def test_input_effect_at_its_neutral_shape_leaves_the_plant_as_it_is(effect: AbstractInputEffect):
    placed = place(MASS, effect, 0)
    assert_same_derivative(MASS, augmented(MASS, [placed], {effect.name: NEUTRAL[effect.name]}))


def assert_same_derivative(plant: eoi.Plant, new: eoi.Plant):
    random = np.random.default_rng(3)
    for _ in range(3):
        y = random.standard_normal((plant.relative_degree, 1))
        u, t = random.standard_normal(1), np.asarray(random.uniform(0.0, 9.0))
        old, got = derivative(plant, t, y, u), derivative(new, t, y, u)
        np.testing.assert_allclose(got, old, rtol=1e-14)


@jit
def derivative(plant: eoi.Plant, t: Any, y: Any, u: Any) -> Any:
    """At the nominal parameters; internal states as they are at the start."""
    theta = jnp.asarray(plant.theta)
    return plant.derivative(t, eoi.State(y, plant.internal_start(theta)), u, theta)


@each(EFFECTS)
def test_own_states_start_at_zero_and_move_with_the_right_shape(effect: AbstractEffect):
    plant = plant_for(effect)
    placed = place(plant, effect, 0)
    shape = effect.grid(seen())[0]
    values = dict(zip(placed.names, [*(1.0 for _ in effect.gains), *shape], strict=True))
    new = augmented(plant, [placed], values)
    start = new.internal_start(jnp.asarray(new.theta))
    assert start.shape == (effect.states + (plant is CASCADE),)
    assert not np.any(start)
    assert jnp.shape(effect.rate(somewhere(effect), shape)) == (effect.states,)


@each(EFFECTS)
def test_units_are_complete_or_absent(effect: AbstractEffect):
    plant = plant_for(effect)
    placed = place(plant, effect, 0)
    for parameter in effect.parameters:
        text = unit(plant, placed, parameter.unit)
        assert text
        assert "{" not in text
        bare = eoi.Plant(
            plant.dynamics,
            plant.parameters,
            relative_degree=plant.degrees,
            internal=plant.internal,
            internal_initial=plant.internal_initial if plant.internal else None,
        )
        # A quotient by what f is a derivative of needs no unit.
        pattern = parameter.unit.replace("{f/v}", "1/s").replace("{f/y}", "1/s")
        assert unit(bare, placed, parameter.unit) == ("" if "{" in pattern else pattern)


@each(EFFECTS)
def test_the_sentence_of_an_effect_is_the_rest_of_one(effect: AbstractEffect):
    assert effect.sentence
    assert not effect.sentence.endswith(".")


@each(EFFECTS)
def test_effects_are_equal_by_value(effect: AbstractEffect):
    twin = type(effect)(**vars(effect))
    assert twin == effect
    assert hash(twin) == hash(effect)
    assert sum(other == effect for other in EFFECTS) == 1


def test_contained_effects_have_canonical_names():
    names = {one.name for one in effects.standard()}
    ends = {end.name for one in EFFECTS if (end := one.limit())}
    assert ends <= {"input_square", "varying_capacity"}
    assert all(set(one.contains) <= names | ends for one in EFFECTS)


def test_a_power_of_a_speed_ends_in_dry_friction():
    """As the exponent goes to zero; of a level that is no law."""
    power = effects.PowerLoss()
    assert power.limit("speed") == effects.CoulombFriction()
    assert power.limit("level") is None
    speed = np.array([-2.0, 0.3])
    at = At(0.0, speed, speed, 0.0, ())
    friction = effects.CoulombFriction().term(at, (1.5,), ())
    np.testing.assert_allclose(power.term(at, (1.5,), (1e-9,)), friction, rtol=1e-8)


# -- on a record: the columns of the regression are what a free run does --------------------------

# None of them on a grid.
SHAPES = {
    "stribeck_friction": (0.17,),
    "position_ripple": (33.0,),
    "end_stop": (0.33,),
    "free_play": (0.21,),
    "sinusoidal_disturbance": (2.345,),
    "input_dead_zone": (0.7,),
    "input_saturation": (4.1,),
    "input_delay": (0.043,),
    "input_quadratic": (0.06,),
    "input_asymmetry": (0.23,),
    "actuator_lag": (0.057,),
    "hysteresis": (0.09, 0.62),
    "overflow": (0.13,),
}
GAINS = {
    "viscous_friction": 0.4,
    "coulomb_friction": 0.5,
    "asymmetric_friction": 0.4,
    "stribeck_friction": 0.4,
    "quadratic_drag": 0.3,
    "cubic_damping": 0.1,
    "linear_stiffness": 4.0,
    "quadratic_stiffness": 5.0,
    "cubic_stiffness": 12.0,
    "gravity": 3.0,
    "gravity_tilt": 0.7,
    "position_ripple": 0.6,
    "end_stop": 9.0,
    "free_play": 6.0,
    "constant_offset": 0.5,
    "drift": 0.02,
    "sinusoidal_disturbance": 0.6,
    "hysteresis": 0.9,
    "leak": 0.2,
    "overflow": 0.4,
}


def truth(effect: AbstractEffect) -> tuple[list[float], tuple[float, ...]]:
    gains = [GAINS[effect.name] * (1.0 + 0.4 * i) for i in range(len(effect.gains))]
    shape = SHAPES.get(effect.name, ())
    if isinstance(effect, effects.EndStop):
        shape = (effect.side * shape[0],)
    return gains, shape


def simulated(plant: eoi.Plant, placed: Placed, samples: int = 3000) -> eoi.Record:
    gains, shape = truth(placed.effect)
    true = augmented(plant, [placed], dict(zip(placed.names, [*gains, *shape], strict=True)))
    time = 8e-3 * np.arange(samples)
    drive = eoi.excitation.multisine(time, 3.0, (0.1, 2.0), 16, seed=4)
    return eoi.simulate(true, time, drive, substeps=4, hold="linear")


# A spring, a damper or a leak beside one that is declared: only their sum is known.
ALIKE = ("viscous_friction", "linear_stiffness", "leak")


@each([one for one in EFFECTS if one.name not in ALIKE and one not in INTERNAL])
def test_regression_on_the_columns_of_an_effect_finds_the_true_parameters(effect: AbstractEffect):
    """All rows at once: a free run, its modes, the columns at the true shape."""
    plant = plant_for(effect)
    placed, (gains, shape) = place(plant, effect, 0), truth(effect)
    one = modal_record(plant, simulated(plant, placed), 40.0)
    declared = plant.with_parameters(0.8 * np.asarray(plant.theta))
    (atom,) = atoms(declared, placed, np.reshape(shape, (1, -1)), [one])
    base = base_of(declared, [one])
    found = fitted(base, [atom], one.noise[:, 0] + 1e-6 * base.local)
    # Jumps are averaged to second order in the step only: below one per cent here.
    theta = declared.theta[base.free] + found.theta[: len(base.free)]
    np.testing.assert_allclose(theta, plant.theta, rtol=1e-2)
    if gains:
        np.testing.assert_allclose(found.gains[0], gains, rtol=1e-2)


@each(INTERNAL)
def test_spill_of_an_internal_state_leaves_nothing_at_the_true_parameters(
    effect: AbstractInternalEffect,
):
    placed = place(CASCADE, effect, 0)
    own = dict(zip(placed.names, [0.6, 0.9, 0.2][-len(placed.names) :], strict=True))
    true, time = augmented(CASCADE, [placed], own), 0.02 * np.arange(4000)
    drive = 1.0 + eoi.excitation.multisine(time, 2.0, (0.02, 0.5), 16, seed=4)
    record = eoi.simulate(true, time, drive, substeps=4, hold="linear")
    one = modal_record(CASCADE, record, 10.0)
    (atom,) = atoms(CASCADE, placed, np.array([list(own.values())[-2:]]), [one])
    base = base_of(CASCADE, [one])
    found = fitted(base, [atom], one.noise[:, 0] + 1e-6 * base.local)
    # The state starts where the model says, and moves the output all along.
    assert np.sum(found.residual**2) < 1e-6 * np.sum(base.target**2)
    np.testing.assert_allclose(found.gains[0], list(own.values())[:-2], rtol=1e-3)


@each([one for one in TERMS if one.name in ALIKE])
def test_effect_that_repeats_a_declared_term_shares_its_column(effect: AbstractTerm):
    plant = plant_for(effect)
    placed = place(plant, effect, 0)
    one = modal_record(plant, simulated(plant, placed, 1000), 40.0)
    (atom,) = atoms(plant, placed, np.zeros((1, 0)), [one])
    declared = base_of(plant, [one]).columns
    alike = [np.allclose(atom.columns[:, 0], column, rtol=1e-6) for column in declared.T]
    assert sum(alike) == 1


AFFINE = (effects.CoulombFriction(), effects.CubicStiffness(), effects.ConstantOffset())


@each(AFFINE)
def test_identify_finds_the_gain_of_an_affine_effect(effect: AbstractTerm):
    placed = place(MASS, effect, 0)
    model = augmented(MASS.with_parameters({"k": 26.0, "b": 1.5}), [placed], {effect.name: 0.0})
    found = eoi.identify(model, simulated(MASS, placed))
    gains, _ = truth(effect)
    assert found.parameters[effect.name] == pytest.approx(gains[0], rel=1e-2)


def test_identify_finds_shape_and_gain_of_an_effect_with_a_state():
    effect = effects.Hysteresis()
    placed, (gains, shape) = place(MASS, effect, 0), truth(effect)
    start = dict(zip(placed.names, [0.5, 0.12, 0.5], strict=True))
    found = eoi.identify(augmented(MASS, [placed], start), simulated(MASS, placed))
    estimate = [found.parameters[name] for name in placed.names]
    # The state is driven by measured signals at the record's step: a few per cent in its shape.
    np.testing.assert_allclose(estimate, [*gains, *shape], rtol=0.05)


# -- promises of single effects -------------------------------------------------------------------


def states_along(effect: AbstractEffect, time, y, v, u, shape):
    """Own states by the fourth-order Runge-Kutta rule on fine steps."""
    h = float(time[1] - time[0])
    rows = tuple(jnp.asarray(one) for one in (time, y, v, u))

    def rate(z, row):
        t, y, v, u = row
        return effect.rate(At(t, y, v, u, z), shape)

    def step(z, pair):
        before, after = pair
        middle = jax.tree.map(lambda a, b: 0.5 * (a + b), before, after)
        first = rate(z, before)
        second = rate(z + 0.5 * h * first, middle)
        third = rate(z + 0.5 * h * second, middle)
        fourth = rate(z + h * third, after)
        new = z + h / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
        return new, new

    pairs = (tuple(one[:-1] for one in rows), tuple(one[1:] for one in rows))
    start = np.zeros(effect.states)
    states = jit(lambda start, pairs: jax.lax.scan(step, start, pairs)[1])(start, pairs)
    return np.concatenate([start[None], states])


def test_delay_is_the_shift_of_the_input():
    delay, tau = effects.InputDelay(), 0.2013
    time = np.arange(0.0, 12.0, 2e-3)
    u = np.sin(2.0 * time) ** 3 * (time > 0)
    shifted = np.where(time > tau, np.sin(2.0 * (time - tau)) ** 3, 0.0)
    along = np.asarray(jit(delay.along)(time, u, np.array([tau])))
    # Exact but for the linear interpolation between samples: h² u''/8.
    assert np.max(np.abs(along - shifted)) < 2e-3**2 * 30.0 / 8.0


@pytest.mark.parametrize("tau", [1e3, 1e300, np.inf])
def test_a_delay_longer_than_the_record_leaves_the_first_value(tau):
    # Trials of a fit may be as long; their steps are more than an integer holds.
    time = 0.01 * np.arange(50)
    u = 2.0 + np.sin(9.0 * time)
    delayed = effects.InputDelay().sampled(time, u, np.array([[tau], [0.01]]))
    np.testing.assert_allclose(delayed[0], u[0])
    np.testing.assert_allclose(delayed[1], np.concatenate([u[:1], u[:-1]]))
    assert np.all(np.isnan(effects.InputDelay().sampled(time, u, np.array([[np.nan]]))))


@pytest.mark.parametrize("effect", [effects.InputDelay(), effects.ActuatorLag()], ids=label)
@pytest.mark.parametrize("tau", [0.0004, 0.0573])
def test_slope_of_an_actuator_with_its_time_is_that_of_differences(
    effect: AbstractActuator, tau: float
):
    """Also where it is shorter than a step."""
    time = jnp.asarray(np.arange(0.0, 4.0, 0.01))
    u = jnp.asarray(np.cumsum(np.random.default_rng(5).standard_normal(len(time))))

    def along(tau: Any) -> Any:
        return effect.along(time, u, tau[None])

    slope = jit(jax.jacfwd(along))(np.asarray(tau))
    small = 1e-7 * tau
    after, before = (jit(along)(np.asarray(tau + sign * small)) for sign in (1.0, -1.0))
    expected = np.asarray(after - before) / (2.0 * small)
    np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-4 * np.max(np.abs(expected)))


@pytest.mark.parametrize(
    ("effect", "shape"),
    [(effects.InputDelay(), [0.0004]), (effects.InputDelay(), [0.0573]),
     (effects.ActuatorLag(), [0.0004]), (effects.ActuatorLag(), [0.0573]),
     (effects.InputRate(), [-0.02, 0.0573]), (effects.InputRate(), [0.02, 0.0])],
)  # fmt: skip
def test_an_actuator_step_by_step_is_that_along_a_record(
    effect: AbstractActuator, shape: list[float]
):
    h = 0.01
    u = np.random.default_rng(6).standard_normal(300)
    along = jit(effect.along)(h * np.arange(len(u)), u, np.asarray(shape))
    start = jnp.full(effect.memory(h, shape), u[0])

    def step(memory: Any, u: Any) -> tuple[Any, Any]:
        return effect.step(memory, u, h, jnp.asarray(shape))

    _, stepped = jax.lax.scan(step, start, jnp.asarray(u))
    np.testing.assert_allclose(stepped, along, atol=1e-13)


@pytest.mark.parametrize("effect", [effects.InputDelay(), effects.ActuatorLag()], ids=label)
def test_effect_in_time_vanishes_with_its_time(effect: AbstractActuator):
    time = np.arange(0.0, 1.0, 0.01)
    u = np.sin(9.0 * time)
    np.testing.assert_allclose(jit(effect.along)(time, u, np.array([1e-9])), u, atol=1e-6)


def test_lag_along_a_record_is_the_analytic_answer_to_a_step():
    h, lag = 0.01, 0.07
    start = np.arange(-h, 1.0, h)
    step = np.where(start > -0.5 * h, 1.0, 0.0)
    answer = jit(effects.ActuatorLag().along)(start + 0.5 * h, step, np.array([lag]))
    # Mean of 1 - exp(-t/T) over each step.
    mean = step * (1.0 - lag / h * (np.exp(-start / lag) - np.exp(-(start + h) / lag)))
    np.testing.assert_allclose(answer, mean, rtol=1e-12)


def test_response_to_the_rate_of_a_ramp_is_its_slope_times_the_lead():
    """u + L/T (u - z) of u = c t behind a lag that has settled: c t + c L; by NumPy and by JAX."""
    h, slope, lead, lag = 0.01, 3.0, -0.08, 0.05
    middles = h * (np.arange(200) + 0.5)
    shapes = np.array([[lead, lag]])
    effect = effects.InputRate()
    sampled = effect.sampled(middles, slope * middles, shapes)[0]
    settled = middles > 20.0 * lag
    expected = slope * middles + slope * lead
    np.testing.assert_allclose(sampled[settled], expected[settled], rtol=1e-6)
    along = effect.along(jnp.asarray(middles), jnp.asarray(slope * middles), shapes[0])
    np.testing.assert_allclose(along, sampled, rtol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 0.01, 0.05])
def test_fast_changes_behind_a_response_to_the_rate_do_not_grow(lag):
    """A lead of -0.2 s: behind a step u is -u at most, and the response is that of Padé."""
    effect, period = effects.InputRate(), 1e-3
    time = period * (np.arange(400) + 0.5)
    step = np.where(time < 0.1, 0.0, 1.0)
    response = np.asarray(effect.along(jnp.asarray(time), jnp.asarray(step), [-0.2, lag]))
    expected = 1.0 - 2.0 * np.exp(-(time - 0.1) / 0.1)
    assert np.min(response) > -1.0
    np.testing.assert_allclose(response[time > 0.1], expected[time > 0.1], atol=1e-4)
    np.testing.assert_allclose(effect.sampled(time, step, np.array([[-0.2, lag]]))[0], response)


@pytest.mark.parametrize("share", [0.4, 0.8, 1.0])
def test_hysteresis_stays_within_its_yield_force(share: float):
    time = np.arange(0.0, 20.0, 2e-3)
    y, v = np.sin(time) + 0.3 * np.sin(4.1 * time), np.cos(time) + 1.23 * np.cos(4.1 * time)
    z = states_along(effects.Hysteresis(), time, y, v, 0 * y, (0.1, share))
    assert np.max(np.abs(z)) <= 1.0 + 1e-6  # Runge-Kutta's own error
    assert np.max(z) > 0.99
    assert np.min(z) < -0.99


def test_asymmetric_friction_is_one_level_and_an_offset_while_it_moves():
    at = [somewhere(effects.ConstantOffset())._replace(v=jnp.asarray(v)) for v in (-0.7, 0.7)]
    both = effects.AsymmetricFriction().term, effects.CoulombFriction().term
    for one in at:
        levels = both[0](one, (0.5, 0.3), ())
        assert levels == pytest.approx(float(both[1](one, (0.4,), ())) + 0.5 * (0.3 - 0.5))


@pytest.mark.parametrize("gravity", [effects.Gravity(), effects.GravityTilt()], ids=label)
def test_gravity_is_not_tried_at_small_angles(gravity):
    small = replace(seen(), y=0.3 * np.tanh(seen().y))
    assert len(gravity.grid(small)) == 0
    assert len(gravity.grid(seen())) == 1


@pytest.mark.parametrize("unit_of_angle", ["deg", "°", "degrees"])
def test_gravity_of_an_angle_in_degrees_is_that_in_radians(unit_of_angle):
    forms = effects.Gravity(), effects.Gravity(degrees=True)
    plain, turned = forms
    for degrees in (30.0, 90.0, 200.0):
        at = somewhere(plain)._replace(y=jnp.asarray(degrees))
        same = at._replace(y=jnp.deg2rad(degrees))
        assert turned.term(at, (2.0,), ()) == pytest.approx(float(plain.term(same, (2.0,), ())))
    for degrees, tried in ((40.0, 0), (60.0, 1)):
        assert len(turned.grid(replace(seen(), y=degrees * np.tanh(seen().y)))) == tried
    fitting = [one.effect for one in placements(swinging(unit_of_angle), forms)]
    assert fitting == [turned]
    assert [one.effect for one in placements(MASS, effects.standard())].count(plain) == 1
    assert turned not in [one.effect for one in placements(MASS, effects.standard())]


SHAFT = eoi.Plant(
    lambda t, x, u, p: (u[0] - p.k * x.z[0]) / p.motor,
    {"motor": 0.004, "k": 60.0, "load": 0.02},
    inputs=("torque",),
    outputs=("speed",),
    internal=lambda t, x, u, p: jnp.stack([x.y[0, 0] - x.z[1], p.k * x.z[0] / p.load]),
    internal_initial=(0.0, 0.0),
)


def test_a_part_that_is_not_measured_has_friction_where_torques_move_it():
    friction = effects.InternalFriction()
    (placed,) = placements(SHAFT, [friction])
    assert placed.channel == 1  # the twist moves as the speeds say
    assert not placements(CASCADE, [friction])  # a level has no friction
    new = augmented(SHAFT, [placed], dict(zip(placed.names, (20.0, 0.1), strict=True)))
    state, theta = eoi.State(jnp.zeros((1, 1)), jnp.array([0.0, 0.5])), jnp.asarray(new.theta)
    rates = new.internal_rate(jnp.zeros(()), state, jnp.zeros(1), theta)
    np.testing.assert_allclose(rates, [-0.5, -20.0 * np.tanh(5.0)])
    assert friction.shows(seen())
    assert not friction.shows(replace(seen(), y=np.abs(seen().y)))


def test_dry_friction_of_a_rate_turns_its_derivative_and_keeps_a_width_that_steps_resolve():
    """∫ dF/dt over a turn is 2 F, whatever the width; a fit may change that by half."""
    law, (level, width) = effects.RateFriction(), (0.7, 0.2)
    time = np.linspace(-0.5, 0.5, 4001)
    y, v = 3.0 * time, np.full(time.shape, 3.0)
    force = np.array([law.term(At(t, y, v, 0.0, ()), [level], [width])
                      for t, y, v in zip(time, y, v, strict=True)])  # fmt: skip
    assert np.sum(force) * (time[1] - time[0]) == pytest.approx(-2.0 * level, rel=1e-3)
    swing = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 9.0}, 2, inputs=(),
                      outputs=("rate",), units={"rate": "rad/s"})  # fmt: skip
    (placed,) = placements(swing, [law])
    plant = augmented(swing, [placed], dict(zip(placed.names, (level, width), strict=True)))
    limits = dict(zip(plant.names, zip(plant.lower, plant.upper, strict=True), strict=True))
    assert limits["rate_friction_level"] == (0.0, np.inf)
    assert limits["rate_friction_width"] == pytest.approx((width / 1.5, 1.5 * width))
    angle = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 9.0}, 2, inputs=(),
                      outputs=("angle",), units={"angle": "rad"})  # fmt: skip
    assert not placements(angle, [law])


def test_an_input_of_one_sign_has_one_gain():
    asymmetry = effects.InputAsymmetry()
    assert len(asymmetry.grid(seen())) > 1
    assert len(asymmetry.grid(replace(seen(), u=np.abs(seen().u)))) == 0


def test_end_stop_below_pushes_up():
    at = somewhere(effects.EndStop())._replace(y=-1.0)
    assert effects.EndStop(-1).term(at, (3.0,), (-0.5,)) == pytest.approx(1.5)
    assert effects.EndStop(+1).term(at, (3.0,), (0.5,)) == pytest.approx(0.0)


def test_ripple_finer_than_the_noise_is_not_tried():
    ripple, known = effects.PositionRipple(), seen()
    noisy = replace(known, noise=0.05 * np.ptp(known.y))
    assert np.max(ripple.grid(noisy)) < np.max(ripple.grid(known))


def test_what_a_speed_loses_in_proportion_is_friction_and_no_leak():
    y = np.linspace(1.0, 9.0, 50)  # of one sign, as a level
    seen = Seen(y, y, y, True, 1e-4, 40.0, 5e-3, 10.0, np.array([1.0]))
    friction, leak = effects.ViscousFriction(), effects.Leak()
    assert leak.shows(seen)
    assert not friction.shows(seen)
    speed = replace(seen, kind="speed")
    assert friction.shows(speed)
    assert not leak.shows(speed)
    assert leak.shows(replace(seen, kind="temperature"))


@pytest.mark.parametrize("levels", [(0.0, 0.03), (-2.0, 2.0), (1.0, 3.0)])
def test_an_input_of_two_levels_shows_no_law_of_it_alone(levels):
    """A line goes through both: a gain, with an offset."""
    laws = (effects.InputDeadZone(), effects.InputSaturation(), effects.InputQuadratic(),
            effects.InputAsymmetry(), effects.InputYield(), effects.InputSquare())  # fmt: skip
    two = replace(seen(), u=np.tile(levels, 2500))
    three = replace(two, u=np.append(two.u[1:], np.mean(levels)))
    for law in laws:
        assert not law.shows(two)
        assert law.shows(three)
    assert effects.ErrorSaturation().shows(two)  # of the output, too
    assert effects.ActuatorLag().shows(two)


def test_noise_around_zero_is_no_other_sign():
    level = np.r_[np.linspace(5.0, 0.0, 20), np.tile([0.1, -0.1], 8)]
    seen = Seen(level, level, level, True, 0.0, 40.0, 5e-3, 10.0, np.array([1.0]))
    for law in (effects.SaturatingLoss(), effects.PowerLoss(), effects.Leak(), effects.Overflow()):
        assert not law.shows(seen)
        assert law.shows(replace(seen, noise=0.08))
        assert law.shows(replace(seen, measured_y=level, measured_noise=0.08))
        turning = replace(seen, y=np.sin(np.arange(36.0)), noise=1.0)  # motion, and no noise
        assert not law.shows(turning)


def test_losses_go_by_the_sign_that_is_measured_where_the_simulation_of_a_wrong_model_turns():
    simulated, measured = np.linspace(-3.0, 9.0, 50), np.linspace(0.5, 9.0, 50)
    seen = Seen(simulated, simulated, simulated, True, 1e-4, 40.0, 5e-3, 10.0, np.array([1.0]))
    for law in (effects.SaturatingLoss(), effects.PowerLoss(), effects.Leak(), effects.Overflow()):
        assert not law.shows(seen)
        assert law.shows(replace(seen, measured_y=measured))
        assert not law.shows(replace(seen, measured_y=simulated))
