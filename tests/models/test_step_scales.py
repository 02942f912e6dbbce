"""Which parameters are affine, and how a step moves the others."""

import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.models.affine import affine_parameters
from eoi_jax.models.equations.text_model import plant_from_text
from eoi_jax.models.plant import Plant
from eoi_jax.models.step_scales import (
    LINEAR,
    LOGARITHMIC,
    RECIPROCAL,
    SIGNED_RECIPROCAL,
    StepScales,
    coordinates,
    linear_step,
    scaled_step,
    shortened,
    step_room,
    step_scales,
)


def body(equation, bounds=None, fixed=(), **parameters):
    return plant_from_text(
        {"y": "v", "v": equation}, parameters, ["y"], ["u"], bounds=bounds, fixed=fixed
    )


def alone(*scales):
    """No parameter multiplies another."""
    return StepScales(scales, ((0.0,) * len(scales),) * len(scales))


def test_a_parameter_is_affine_where_the_others_being_constant_f_is():
    plant = body("(K*u - b*v - F*sign(v) - w**2*y*J)/J + a*c", J=2.0, K=1.0, b=0.5, F=0.1,
                 w=3.0, a=1.0, c=2.0)  # fmt: skip
    flags = dict(zip(plant.names, affine_parameters(plant), strict=True))
    assert flags == {"J": False, "K": True, "b": True, "F": True, "w": False, "a": True, "c": True}
    assert not plant.is_affine  # together they are not


def test_what_acts_through_states_and_actuators_is_not_affine():
    lagged = plant_from_text(
        {"y": "-a*y + b*z", "z": "(u - z)*c"}, {"a": 1.0, "b": 2.0, "c": 3.0, "z0": 0.5}, ["y"],
        ["u"], initial={"z": "z0"},
    )  # fmt: skip
    np.testing.assert_array_equal(affine_parameters(lagged), [True, True, False, False])
    delayed = plant_from_text(
        {"y": "-a*y + b*u"}, {"a": 1.0, "b": 2.0, "d": 0.1}, ["y"], ["u"], input_delay={"u": "d"}
    )
    np.testing.assert_array_equal(affine_parameters(delayed), [True, True, False])


def test_a_plant_is_affine_if_it_is_in_its_free_parameters():
    values = {"J": 2.0, "K": 1.0, "b": 0.5}
    assert not body("(K*u - b*v)/J", **values).is_affine
    assert body("(K*u - b*v)/J", fixed=("J",), **values).is_affine
    assert not body("(K*u - b*v)/J", fixed=("K",), **values).is_affine


def test_a_divisor_moves_by_its_reciprocal_and_others_that_keep_their_sign_by_their_logarithm():
    values = {"J": 2.0, "b": 0.5, "w": 3.0, "k": 4.0, "o": 0.1}
    equation = "(u - b*v)/J - w**2*y - tanh(k*v) - sin(y - o)"
    free = body(equation, **values)
    assert step_scales(free).scales == (SIGNED_RECIPROCAL, LINEAR, LINEAR, LINEAR, LINEAR)
    bounds = {"b": (0.0, None), "w": (0.0, None), "k": (1.0, None), "o": (-1.0, 1.0),
              "J": (None, 9.0)}  # fmt: skip
    kept = body(equation, bounds, **values)
    assert step_scales(kept).scales == (RECIPROCAL, LINEAR, LOGARITHMIC, LOGARITHMIC, LINEAR)
    negative = body(equation, {"w": (None, 0.0)}, **{**values, "w": -3.0})
    assert step_scales(negative).scales[2] == LOGARITHMIC


def test_what_overflows_beside_a_parameter_says_nothing_about_it():
    """Warnings are errors here: exp(y/w) is infinite at some of the points."""
    diode = body("(u - y - k*exp(y/w))/C", bounds={"w": (0.0, None)}, k=1e-8, w=0.05, C=2.0)
    assert step_scales(diode).scales == (LINEAR, LOGARITHMIC, SIGNED_RECIPROCAL)


def test_a_step_of_a_reciprocal_is_exact_where_f_is_affine_in_it():
    """f = 1/θ, from 2 to 8: Gauss-Newton's step is (1/8 - 1/2)/(-1/4) = 1.5."""
    for start, target in ((2.0, 8.0), (8.0, 2.0), (-2.0, -3.0)):
        step = (1.0 / target - 1.0 / start) / (-1.0 / start**2)
        moved = scaled_step(np.array([start]), np.array([step]), alone(RECIPROCAL))
        np.testing.assert_allclose(start + moved, [target], rtol=1e-12)


@pytest.mark.parametrize("scale", [LOGARITHMIC, RECIPROCAL])
@pytest.mark.parametrize("xp", [np, jnp])
def test_no_step_changes_the_sign_or_is_longer_than_a_factor_of_eight(scale, xp):
    theta = np.array([3.0, 3.0, -3.0, -3.0, 3.0])
    step = np.array([-1e9, 1e9, -1e9, 1e9, 3e-9])
    moved = theta + np.asarray(scaled_step(theta, step, alone(*[scale] * 5), xp))
    np.testing.assert_allclose(moved, [0.375, 24.0, -24.0, -0.375, 3.0 + 3e-9], rtol=1e-12)


@pytest.mark.parametrize("xp", [np, jnp])
def test_a_divisor_without_bounds_passes_through_infinity(xp):
    """f = 1/θ from 2 to -5: 1/θ goes from 0.5 through 0 to -0.2; none goes beyond a factor of 8."""
    theta = np.array([2.0, 2.0, -2.0, 2.0])
    step = theta * np.array([1.4, 1.0 + 1e-9, 1.4, 1e9])
    moved = theta + np.asarray(scaled_step(theta, step, alone(*[SIGNED_RECIPROCAL] * 4), xp))
    np.testing.assert_allclose(moved, [-5.0, -16.0, 5.0, -0.25], rtol=1e-12)


@pytest.mark.parametrize("xp", [np, jnp])
def test_a_step_is_shortened_where_a_reciprocal_would_grow_beyond_the_factor(xp):
    """1/θ of the first from 0.5 to 50 or to -50: so far as to 4 or to -4, and so the second."""
    scales, theta = alone(SIGNED_RECIPROCAL, LINEAR), np.array([2.0, 1.0])
    for target in (50.0, -50.0):
        step = np.array([2.0 * (1.0 - target / 0.5), 3.0])
        part = np.asarray(shortened(theta, step, scales, xp))
        moved = theta + scaled_step(theta, part, scales)
        np.testing.assert_allclose(1.0 / moved[0], np.sign(target) * 4.0)
        share = (np.sign(target) * 4.0 - 0.5) / (target - 0.5)
        np.testing.assert_allclose(moved[1], 1.0 + 3.0 * share)
    small = np.array([1.9, 3.0])
    np.testing.assert_array_equal(shortened(theta, small, scales, xp), small)


@pytest.mark.parametrize("xp", [np, jnp])
@pytest.mark.parametrize("mass", [0.5, -5.0])
def test_a_scaled_step_that_nothing_shortens_is_undone(mass, xp):
    plant = body("(K*u - b*v)/J + g*exp(w*y)*y", J=2.0, K=1.0, b=0.5, g=3.0, w=1.5)
    scales, theta = step_scales(plant), np.asarray(plant.theta)
    assert scales.scales == (SIGNED_RECIPROCAL, LINEAR, LINEAR, LINEAR, LINEAR)
    step = np.array([2.0 * (1.0 - 2.0 / mass), -0.3, 0.8, 0.1, 0.2])
    change = scaled_step(theta, step, scales, xp)
    np.testing.assert_allclose((theta + change)[0], mass)
    np.testing.assert_allclose(linear_step(theta, change, scales, xp), step, rtol=1e-10)


def test_what_is_zero_moves_on_a_linear_scale():
    moved = scaled_step(np.zeros(1), np.array([0.5]), alone(LOGARITHMIC))
    np.testing.assert_array_equal(moved, [0.5])


def test_room_is_where_a_scaled_step_ends_on_the_bounds():
    theta, lower, upper = np.full(3, 2.0), np.full(3, 1.0), np.full(3, 5.0)
    scales = alone(LINEAR, LOGARITHMIC, RECIPROCAL)
    for room, bound in zip(step_room(theta, lower, upper, scales), (lower, upper), strict=True):
        np.testing.assert_allclose(theta + scaled_step(theta, room, scales), bound)


def test_a_bound_of_zero_is_no_limit_of_a_step_that_cannot_reach_it():
    theta = np.full(3, 2.0)
    scales = alone(LINEAR, LOGARITHMIC, RECIPROCAL)
    low, high = step_room(theta, np.zeros(3), np.full(3, np.inf), scales)
    np.testing.assert_array_equal(low, [-2.0, -np.inf, -np.inf])
    np.testing.assert_array_equal(high, [np.inf, np.inf, np.inf])


def test_a_bound_of_the_other_sign_is_no_limit_of_a_divisor():
    theta, scales = np.full(2, 2.0), alone(RECIPROCAL, LOGARITHMIC)
    low, high = step_room(theta, np.full(2, -10.0), np.full(2, 8.0), scales)
    np.testing.assert_array_equal(low, [-np.inf, -np.inf])
    np.testing.assert_allclose(theta + scaled_step(theta, high, scales), [8.0, 8.0])


def test_scales_of_an_affine_plant_are_linear_whatever_the_bounds():
    plant = Plant(lambda t, x, u, p: -p.a * x.y[0] + p.b * u[0], {"a": 1.0, "b": 2.0},
                  bounds={"a": (0.0, np.inf)})  # fmt: skip
    assert step_scales(plant).trivial


def test_what_starts_a_state_or_enters_its_rate_linearly_may_end_at_zero():
    plant = plant_from_text(
        {"y": "-a*y + z/m", "z": "-c*z + u"}, {"a": 1.0, "c": 3.0, "m": 2.0, "z0": 0.5}, ["y"],
        ["u"], initial={"z": "z0"}, bounds=dict.fromkeys(("a", "c", "m", "z0"), (0.0, None)),
    )  # fmt: skip
    assert step_scales(plant).scales == (LINEAR, LINEAR, RECIPROCAL, LINEAR)


# -- products ---------------------------------------------------------------------------------


def test_powers_by_which_a_parameter_is_multiplied_are_found():
    plant = body("(K*u - b*v)/J + g*w**2*y - d*tanh(w*v)", J=2.0, K=1.0, b=0.5, g=3.0, w=3.0, d=1.0)
    powers = np.asarray(step_scales(plant).exponents)
    expected = np.zeros((6, 6))
    expected[[1, 2], 0] = -1.0  # K and b by 1/J
    expected[3, 4] = 2.0  # g by w²; d by no power of w
    np.testing.assert_allclose(powers, expected, atol=1e-9)


def test_a_fixed_parameter_is_not_moved_by_what_divides_it():
    plant = body("(K*u - b*v)/J", fixed=("K",), J=2.0, K=1.0, b=0.5)
    scales, theta = step_scales(plant), np.asarray(plant.theta)
    moved = scaled_step(theta, np.array([-30.0, 0.0, 0.1]), scales)
    np.testing.assert_allclose(moved[:2], [-1.75, 0.0])


@pytest.mark.parametrize("xp", [np, jnp])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_is_exact_for_forces_over_a_mass(sign, xp):
    """K/J, b/J and 1/J from one Gauss-Newton step, whatever the distance and the signs."""
    plant = body("(K*u - b*v - k*y)/J", fixed=("k",), J=2.0, K=1.0, b=0.5, k=8.0)
    theta, true = np.asarray(plant.theta), np.array([sign * 0.5, sign * 6.0, 2.0, 8.0])

    def coefficients(p):
        return p[..., 1:] / p[..., :1]

    jacobian = np.array(
        [[-1.0 / 4.0, 0.5, 0.0, 0.0], [-0.5 / 4.0, 0.0, 0.5, 0.0], [-8.0 / 4.0, 0.0, 0.0, 0.5]]
    )
    step = np.zeros(4)
    step[:3] = np.linalg.solve(jacobian[:, :3], coefficients(true) - coefficients(theta))
    moved = theta + np.asarray(scaled_step(theta, step, step_scales(plant), xp))
    np.testing.assert_allclose(moved, true, rtol=1e-12)


def test_a_bound_of_zero_is_met_in_the_coordinates_of_the_products():
    plant = body("(K*u - b*v)/J", fixed=("K",), J=2.0, K=1.0, b=0.5)
    scales, theta = step_scales(plant), np.asarray(plant.theta)
    for share in (-1.0, -0.5, 3.0):
        step = coordinates(theta, scales) @ np.array([0.7, 0.0, share * theta[2]])
        moved = theta + scaled_step(theta, step, scales)
        ratio = moved[0] / theta[0]
        np.testing.assert_allclose(moved[2], (1.0 + share) * theta[2] * ratio, atol=1e-12)
