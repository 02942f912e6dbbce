"""The grey-box model: its regressor, its structure found by probing, what it refuses."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from eoi_jax.models.equations.text_model import plant_from_text
from eoi_jax.models.library import Plant, State
from eoi_jax.models.units import derivative_unit

POINT = (jnp.asarray(0.4), State(jnp.array([[0.3], [-0.7]]), jnp.zeros(0)), jnp.array([1.2]))


def spring(t, x, u, p):
    return -p.k * x.y[0] - p.d * x.y[1] + p.g * u


def shaped(t, x, u, p):
    return -jnp.exp(p.k) * x.y[0] - p.d * jnp.tanh(p.g * x.y[1]) + u * p.k * p.g


PARAMETERS = {"k": 2.0, "d": 0.5, "g": 1.5}
SPRING = Plant(spring, PARAMETERS, 2)
SHAPED = Plant(shaped, PARAMETERS, 2)


# -- the equations ----------------------------------------------------------------------------


@pytest.mark.parametrize("plant", [SPRING, SHAPED], ids=["affine", "nonlinear"])
def test_regressor_is_the_derivative_of_f(plant):
    theta, step = jnp.asarray(plant.theta), 1e-6
    got = plant.regressor(*POINT, theta)
    assert got.shape == (1, 3)
    for i in range(3):
        shift = step * jnp.eye(3)[i]
        ends = [float(plant.derivative(*POINT, theta + sign * shift)[0]) for sign in (1.0, -1.0)]
        assert float(got[0, i]) == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-8)


def test_regressor_of_an_affine_plant_holds_its_columns():
    got = SPRING.regressor(*POINT, jnp.asarray(SPRING.theta))
    np.testing.assert_allclose(got, [[-0.3, 0.7, 1.2]], rtol=1e-14)


def test_regressor_of_several_outputs_has_a_row_each():
    def two(t, x, u, p):
        return jnp.stack([-p.k * (x.y[0, 0] - x.y[0, 1]), p.k * (x.y[0, 0] - x.y[0, 1])])

    plant = Plant(two, {"k": 3.0}, outputs=("left", "right"))
    x = State(jnp.array([[0.5, 0.2]]), jnp.zeros(0))
    got = plant.regressor(jnp.asarray(0.0), x, jnp.zeros(1), jnp.asarray(plant.theta))
    np.testing.assert_allclose(got, [[-0.3], [0.3]], rtol=1e-14)


def test_a_scalar_does_for_one_output():
    plant = Plant(lambda t, x, u, p: p.a * u[0], {"a": 2.0})
    x = State(jnp.zeros((1, 1)), jnp.zeros(0))
    f = plant.derivative(jnp.asarray(0.0), x, jnp.array([3.0]), jnp.array([2.0]))
    np.testing.assert_allclose(f, [6.0])


def test_parameters_are_reached_by_name_in_their_order():
    values = SPRING.named(np.array([1.0, 2.0, 3.0]))
    assert (values.k, values.d, values.g) == (1.0, 2.0, 3.0)
    assert SPRING.parameters == PARAMETERS
    assert SPRING.names == ("k", "d", "g")


def test_other_parameters_leave_everything_else():
    other = SPRING.with_parameters({"d": 9.0})
    assert other.parameters == {"k": 2.0, "d": 9.0, "g": 1.5}
    assert SPRING.parameters == PARAMETERS
    again = SPRING.with_parameters(np.array([1.0, 2.0, 3.0]))
    assert again.parameters == {"k": 1.0, "d": 2.0, "g": 3.0}
    assert jax.tree.structure(again) == jax.tree.structure(SPRING)


def test_internal_states_have_their_rate_and_their_start():
    plant = Plant(
        lambda t, x, u, p: p.a * x.z[0],
        {"a": 2.0, "z0": 0.7},
        internal=lambda t, x, u, p: -p.a * x.z + u,
        internal_initial=lambda p: jnp.stack([p.z0]),
    )
    theta = jnp.asarray(plant.theta)
    np.testing.assert_allclose(plant.internal_start(theta), [0.7])
    x = State(jnp.zeros((1, 1)), jnp.array([0.5]))
    rate = plant.internal_rate(jnp.asarray(0.0), x, jnp.array([3.0]), theta)
    np.testing.assert_allclose(rate, [2.0])
    given = Plant(plant.dynamics, {"a": 1.0}, internal=plant.internal, internal_initial=[0.2])
    np.testing.assert_allclose(given.internal_start(jnp.asarray([1.0])), [0.2])


def test_without_internal_states_there_is_no_rate():
    assert SPRING.internal_rate(*POINT, jnp.asarray(SPRING.theta)).shape == (0,)
    assert SPRING.internal_start(jnp.asarray(SPRING.theta)).shape == (0,)


def test_fixed_parameters_are_not_free():
    plant = Plant(spring, PARAMETERS, 2, fixed="d")
    np.testing.assert_array_equal(plant.free, [1.0, 0.0, 1.0])
    np.testing.assert_array_equal(Plant(spring, PARAMETERS, 2, fixed=("k", "g")).free, [0, 1, 0])


def test_the_same_equations_share_one_structure():
    """jit compares static parts: a plant built twice must be compiled once."""
    again = Plant(spring, {"k": 5.0, "d": 6.0, "g": 7.0}, 2)
    assert jax.tree.structure(again) == jax.tree.structure(SPRING)


# -- structure found by probing ---------------------------------------------------------------


def test_a_plant_is_affine_where_its_parameters_enter_linearly():
    assert SPRING.is_affine
    offset = Plant(lambda t, x, u, p: p.a * jnp.sin(x.y[0]) + 3.0 * u, {"a": 1.0})
    assert offset.is_affine
    assert not SHAPED.is_affine
    product = Plant(lambda t, x, u, p: p.a * p.b * x.y[0] + u, {"a": 1.0, "b": 1.0})
    assert not product.is_affine
    internal = Plant(
        lambda t, x, u, p: x.z,
        {"a": 1.0},
        internal=lambda t, x, u, p: -p.a * x.z + u,
        internal_initial=[0.0],
    )
    assert not internal.is_affine  # its sensitivity depends on a


LINEAR = {
    "jump of the state": lambda y, p: jnp.where(y > 2.0, p.k, -p.d * y),
    "table of parameters": lambda y, p: jnp.interp(y, jnp.arange(2.0), jnp.stack([p.k, p.d])),
    "inertia that moves": lambda y, p: jnp.linalg.solve(
        jnp.eye(2) * (2.0 + y**2), jnp.stack([p.k, p.d])
    )[0],
    "branches": lambda y, p: jax.lax.cond(y > 0, lambda: p.k * y, lambda: p.d * y),
}
BENT = {
    "end stop far off": lambda y, p: p.k * jnp.maximum(y - 1e4 * p.d, 0.0),
    "end stop near": lambda y, p: p.k * jnp.maximum(y - 1e-4 * p.d, 0.0),
    "saturation": lambda y, p: jnp.clip(p.k * y, -1e6, 1e6) + p.d,
    "table with a knot": lambda y, p: jnp.interp(y, jnp.stack([0.0, p.d]), jnp.arange(2.0)) * p.k,
    "switch at a parameter": lambda y, p: p.k * jnp.sign(y - p.d),
}


def single(force):
    return Plant(lambda t, x, u, p: force(x.y[0, 0], p) + u[0], {"k": 1.0, "d": 1.0}, 2)


@pytest.mark.parametrize("force", LINEAR.values(), ids=LINEAR)
def test_what_switches_with_the_state_is_affine(force):
    assert single(force).is_affine


@pytest.mark.parametrize("force", BENT.values(), ids=BENT)
def test_what_bends_with_a_parameter_is_not_affine_however_far_off(force):
    assert not single(force).is_affine


def coulomb(p, v):
    return p.c * jnp.sign(v)


FRICTION = {
    "Coulomb": coulomb,
    "Stribeck": lambda p, v: (p.c + p.s * jnp.exp(-((v / 0.1) ** 2))) * jnp.sign(v),
    "asymmetric": lambda p, v: jnp.where(v > 0, p.c, -p.s),
    "with viscous": lambda p, v: p.s * v + p.c * jnp.sign(v),
    "one-sided": lambda p, v: p.c * jnp.heaviside(v, 0.5),
}
SMOOTH = {
    "none": lambda p, v: 0.0 * p.c * v + 0.0 * p.s,
    "viscous": lambda p, v: p.c * v + p.s * v**3,
    "boundary layer": lambda p, v: p.c * jnp.tanh(v / 1e-3),
    "quadratic drag": lambda p, v: p.c * v * jnp.abs(v),
}


def rubbing(friction, c=0.7):
    def dynamics(t, x, u, p):
        return -10.0 * x.y[0] - friction(p, x.y[1]) + u

    return Plant(dynamics, {"c": c, "s": 0.4}, 2)


@pytest.mark.parametrize("friction", FRICTION.values(), ids=FRICTION)
@pytest.mark.parametrize("level", [0.7, 0.0])
def test_dry_friction_is_found_even_at_a_nominal_level_of_zero(friction, level):
    assert rubbing(friction, level).dry_friction == (True,)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 50.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_dry_friction_that_acts_only_beyond_a_position_is_found_in_every_unit(unit, side):
    def rail(t, x, u, p):
        (y,), (v,) = x.y
        return -p.k * y - p.c * jnp.sign(v) * (side * y > 2.0 * unit) + u[0]

    assert Plant(rail, {"k": 4.0, "c": unit}, 2).dry_friction == (True,)


@pytest.mark.parametrize("friction", SMOOTH.values(), ids=SMOOTH)
def test_smooth_friction_is_not_taken_for_dry(friction):
    assert rubbing(friction).dry_friction == (False,)


def test_dry_friction_is_found_for_the_output_that_has_it():
    def two(t, x, u, p):
        return jnp.stack([-p.k * x.y[0, 0], -p.k * x.y[0, 1] - p.c * jnp.sign(x.y[1, 1])])

    assert Plant(two, {"k": 1.0, "c": 0.0}, 2, outputs=("a", "b")).dry_friction == (False, True)


def test_an_output_of_degree_one_is_a_speed_itself():
    def braked(t, x, u, p):
        return -p.a * jnp.sign(x.y[0])

    assert Plant(braked, {"a": 1.0}).dry_friction == (True,)
    both = Plant(braked, {"a": 1.0}, (1, 2), outputs=("speed", "position"))
    assert both.dry_friction == (True, False)  # a relay of the position is no friction


def test_a_level_that_empties_is_no_dry_friction():
    def tank(t, x, u, p):
        return u - p.k * jnp.sqrt(jnp.maximum(x.y[0], 0.0))

    assert Plant(tank, {"k": 1.0}).dry_friction == (False,)


@pytest.mark.parametrize("exponent", [0.3, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("feed", [0.0, 0.1])
def test_a_vessel_that_narrows_to_a_point_is_no_dry_friction(exponent, feed):
    """The rate has a pole where it is empty, of either sign."""
    values = {"fill": feed, "drain": 0.3, "n": exponent}
    flows = "fill*feed - drain*valve*sqrt(level)"
    if not feed:
        flows, values = "-drain*valve*sqrt(level)", {"drain": 0.3, "n": exponent}
    text = {"level": f"({flows})/max(abs(level), 1e-300)**n"}
    plant = plant_from_text(text, values, outputs=["level"], inputs=["feed", "valve"])
    assert plant.dry_friction == (False,)


def test_what_switches_with_the_sign_of_another_speed_is_no_friction():
    def relay(t, x, u, p):
        return jnp.stack([u[0] - x.y[0, 0], jnp.sign(x.y[0, 0]) - p.k * x.y[0, 1]])

    assert not np.any(Plant(relay, {"k": 1.0}, 1, outputs=("drive", "driven")).jumps)


@pytest.mark.parametrize(
    ("unit", "order", "derivative"),
    [("m", 1, "m/s"), ("m", 2, "m/s²"), ("rad/s", 1, "rad/s²"), ("m/s²", 1, "m/s³"), ("", 2, ""),
     (None, 1, ""), ("1/min", 1, "1/min/s"), ("m", 5, "m/s^5"), ("rad/s", 0, "rad/s")],
)  # fmt: skip
def test_units_of_derivatives(unit, order, derivative):
    assert derivative_unit(unit, order) == derivative


def test_dry_friction_of_a_stiff_plant_is_found():
    def stiff(t, x, u, p):
        return -p.k * x.y[0] - p.c * jnp.sign(x.y[1]) + u

    assert Plant(stiff, {"k": 1e6, "c": 1.0}, 2).dry_friction == (True,)


def test_at_rest_gives_f_on_both_sides_of_zero_velocity():
    plant = rubbing(coulomb)
    x = State(jnp.array([[0.1], [5.0]]), jnp.zeros(0))
    above, below = plant.at_rest(jnp.asarray(0.0), x, jnp.array([0.5]), jnp.asarray(plant.theta))
    np.testing.assert_allclose(above, [-1.0 - 0.7 + 0.5], rtol=1e-12)
    np.testing.assert_allclose(below, [-1.0 + 0.7 + 0.5], rtol=1e-12)


def test_at_rest_moves_each_output_alone():
    def two(t, x, u, p):
        v = x.y[1]
        return jnp.stack([-jnp.sign(v[0]) * p.c + 10.0 * v[1], -jnp.sign(v[1]) * p.c + v[0]])

    plant = Plant(two, {"c": 2.0}, 2, outputs=("a", "b"))
    x = State(jnp.array([[0.0, 0.0], [3.0, 4.0]]), jnp.zeros(0))
    above, below = plant.at_rest(jnp.asarray(0.0), x, jnp.zeros(1), jnp.array([2.0]))
    np.testing.assert_allclose(above, [-2.0 + 40.0, -2.0 + 3.0])
    np.testing.assert_allclose(below, [2.0 + 40.0, 2.0 + 3.0])


def test_at_rest_of_a_speed_is_f_at_zero():
    plant = Plant(lambda t, x, u, p: -p.a * jnp.sign(x.y[0]) + u, {"a": 2.0})
    x = State(jnp.array([[0.5]]), jnp.zeros(0))
    above, below = plant.at_rest(jnp.asarray(0.0), x, jnp.array([3.0]), jnp.array([2.0]))
    np.testing.assert_allclose([above, below], [[1.0], [5.0]])


# -- wrong calls ------------------------------------------------------------------------------


def build(**change):
    call = {"dynamics": spring, "parameters": PARAMETERS, "relative_degree": 2} | change
    return Plant(**call)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"parameters": {}}, "`parameters` must name at least one parameter"),
        ({"parameters": {"k 1": 1.0}}, "`parameters` must have names that are Python identifiers"),
        (
            {"parameters": {"lambda": 1.0}},
            "Python identifiers without an underscore in front, got 'lambda'. The model reads",
        ),
        ({"parameters": {"_k": 1.0}}, "without an underscore in front, got '_k'"),
        ({"parameters": {"k": np.nan}}, "`parameters` must be finite"),
        ({"fixed": ("dd",)}, "`fixed` must be one of k, d, g, got 'dd'. Did you mean `d`"),
        ({"fixed": ("k", "d", "g")}, "`fixed` must leave a parameter to estimate, got k, d, g"),
        ({"bounds": {"kk": (0.0, 1.0)}}, "`bounds` must be one of k, d, g, got 'kk'"),
        (
            {"bounds": {"k": (3.0, 1.0)}},
            r"`bounds\[k\]` must be \(lower, upper\) with lower < upper",
        ),
        (
            {"bounds": {"k": (0.0, 1.0)}},
            r"`parameters\[k\]` must lie in its bounds \[0, 1\], got 2",
        ),
        ({"relative_degree": -1}, "`relative_degree` must be an integer ≥ 0, or 1 of them"),
        ({"relative_degree": 0}, "`relative_degree` must be 1 or more .* itself depends on y"),
        ({"relative_degree": (1, 2)}, r"`relative_degree` must be .* got \(1, 2\)"),
        ({"internal_initial": [0.0]}, "`internal_initial` must be left out without `internal`"),
        (
            {"internal": spring},
            "`internal_initial` must be given with `internal`, got none. Give z",
        ),
        (
            {"dynamics": lambda t, x, u, p: jnp.zeros(3)},
            r"`dynamics` must return shape \(1,\), one value for each of the outputs y, got shape",
        ),
        (
            {"dynamics": lambda t, x, u, p: jnp.zeros(2)},  # dx of both states
            r"got shape \(2,\)\. The lower ones follow from the highest: return that of each",
        ),
        (
            {"internal": lambda t, x, u, p: jnp.zeros(3), "internal_initial": [0.0, 1.0]},
            r"`internal` must return the shape of `internal_initial` \(2,\), got shape \(3,\)",
        ),
    ],
)
def test_wrong_calls_name_field_rule_and_value(change, message):
    with pytest.raises(ValueError, match=message):
        build(**change)


def test_other_parameters_must_be_known():
    with pytest.raises(ValueError, match="`parameters` must be one of k, d, g, got 'kk'"):
        SPRING.with_parameters({"kk": 1.0})


def test_other_parameters_must_be_as_many():
    with pytest.raises(ValueError, match="parameters"):
        SPRING.with_parameters(np.ones(2))


def test_outputs_must_have_different_names():
    with pytest.raises(ValueError, match="outputs"):
        Plant(lambda t, x, u, p: p.a * x.y[0], {"a": 1.0}, outputs=("y", "y"))


def test_declared_anew_keeps_what_is_not_named():
    def late(t, u, p):
        return u * p.gain

    def dynamics(t, x, u, p):
        return -p.a * x.y[0] + u

    plant = Plant(dynamics, {"a": 1.0, "gain": 2.0}, 1, ("u",), ("y",), bounds={"a": (0.0, 5.0)},
                  fixed=("gain",), units={"a": "1/s"}, actuator=late)  # fmt: skip
    new = plant.declared_anew({"a": 3.0}, {"gain": (0.0, 9.0)})
    assert new.parameters == {"a": 3.0, "gain": 2.0}
    assert (new.lower.tolist(), new.upper.tolist()) == ([0.0, 0.0], [5.0, 9.0])
    assert new.fixed == ("gain",)
    assert new.actuator is not None
    assert new.actuator.function is late
    assert new.units == plant.units
    with pytest.raises(ValueError, match="must lie in its bounds"):
        plant.declared_anew({"a": 7.0})


def test_a_plant_is_called_as_its_function_or_else_a_model():
    def spring(t, x, u, p):
        return -p.k * x.y[0]

    assert Plant(spring, {"k": 1.0}).name == "spring"
    assert Plant(spring, {"k": 1.0}, name="coil").name == "coil"
    assert Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}).name == "model"
    assert Plant(functools.partial(spring), {"k": 1.0}).name == "model"


def test_parameter_values_of_a_plant_cannot_be_changed_in_place():
    plant = Plant(lambda t, x, u, p: u - p.a * x.y[0], {"a": 1.0})
    values = np.array([2.0])
    for model in (plant, plant.with_parameters({"a": 2.0}), plant.with_parameters(values)):
        with pytest.raises(ValueError, match="read-only"):
            model.theta[0] = 9.0
    model = plant.with_parameters(values)
    values[0] = 9.0
    assert model.parameters == {"a": 2.0}
