"""What no record of a plant tells apart, from its equations alone."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.common_factors import CommonFactor, common_factors, without_common_factors


def body(equation, fixed=(), **parameters):
    return eoi.plant_from_text({"y": "v", "v": equation}, parameters, ["y"], ["u"], fixed=fixed)


FORCES = {"J": 0.5, "K": 10.0, "b": 1.0, "k": 30.0}


def forces(fixed=()):
    return body("(K*u - b*v - k*y)/J", fixed, **FORCES)


def test_forces_over_an_inertia_are_determined_over_it():
    (factor,) = common_factors(forces())
    assert factor == CommonFactor(("J", "K", "b", "k"), ("K/J", "b/J", "k/J"), ("J",))
    assert factor.sentence == (
        "J, K, b and k have a common factor and cannot be told apart by any record, only K/J, b/J "
        'and k/J are determined: fix J (`fixed = ["J"]`)'
    )
    for name in FORCES:
        assert common_factors(forces((name,))) == ()


def test_a_divisor_is_named_whatever_the_order_of_the_parameters():
    plant = body("(K*u - b*v - k*y)/J", K=10.0, b=1.0, k=30.0, J=0.5)
    (factor,) = common_factors(plant)
    assert factor.fix == ("J",)


def test_products_sums_and_what_has_no_effect():
    plant = body("-(k1 + k2)*y - d*v + a*b*u + 0*q", k1=1.0, k2=1.0, d=3.0, a=1.0, b=1.0, q=2.0)
    factors = {factor.parameters: factor for factor in common_factors(plant)}
    assert factors[("k1", "k2")].combinations == ("k1 + k2",)
    assert factors[("a", "b")].combinations == ("a·b",)
    assert factors[("q",)].sentence == (
        'no trace in the data of q: no output depends on it, fix q (`fixed = ["q"]`)'
    )
    assert len(factors) == 3


def test_a_parameter_of_a_condition_has_no_derivative_though_outputs_depend_on_it():
    (factor,) = common_factors(body("-d*v + (u if t > late else 0)", d=3.0, late=0.6))
    assert factor.sentence.startswith(
        "no derivative by late: it stands in a condition alone, which jumps"
    )
    assert factor.sentence.endswith('(t - t0)/w)), or fix late (`fixed = ["late"]`)')


def test_a_pendulum_of_unknown_mass_and_length():
    """m·l² alone is in it where only the torque of gravity is known beside."""
    equation = "({}*u - b*v - m*9.81*l*sin(y))/(m*l**2)"
    values = {"m": 0.5, "b": 1.0, "l": 0.3}
    assert common_factors(body(equation.format("1.0"), **values)) == ()
    (factor,) = common_factors(body(equation.format("K"), K=1.0, **values))
    assert set(factor.parameters) == {"m", "b", "K"}
    assert factor.combinations == ("K/m", "b/m")
    both = body("(K*u - b*v - m*g*l*sin(y))/(m*l**2)", K=1.0, g=9.0, **values)
    (factor,) = common_factors(both)
    assert len(factor.fix) == 2
    assert sorted(factor.combinations) == ["K/(m·l²)", "b/(m·l²)", "g/l"]


@pytest.mark.parametrize(
    ("start", "parameters"), [(0.0, ("b", "d")), (1.0, ()), ("z0", ("b", "d", "z0"))]
)
def test_an_internal_state_may_be_measured_in_any_unit(start, parameters):
    """ẏ = -a y + b z: twice the z with half the b, unless z starts at a known value."""
    values = {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0} | ({"z0": 0.7} if start == "z0" else {})
    plant = eoi.plant_from_text(
        {"y": "-a*y + b*z", "z": "-c*z + d*u"}, values, ["y"], ["u"], initial={"z": start}
    )
    factors = common_factors(plant)
    assert tuple(name for factor in factors for name in factor.parameters) == parameters


def test_a_lag_of_an_input_hides_no_factor():
    plant = eoi.plant_from_text(
        {"y": "-a*y + b*c*u"}, {"a": 1.0, "b": 2.0, "c": 3.0, "tau": 0.1}, ["y"], ["u"],
        input_lag={"u": "tau"},
    )  # fmt: skip
    (factor,) = common_factors(plant)
    assert factor.parameters == ("b", "c")


@pytest.mark.parametrize("gap", [1e-6, 0.3, 1e6])
def test_a_stop_far_out_is_no_parameter_without_effect(gap):
    assert common_factors(body("-a*y + u - s*max(y - gap, 0)", a=1.0, s=50.0, gap=gap)) == ()


@pytest.mark.parametrize("name", ["pendulum", "level_tank", "cascaded_tanks", "duffing_oscillator"])
def test_the_plants_of_the_library_have_none(name):
    assert common_factors(getattr(eoi.plants, name)()) == ()


def test_time_and_saturation_do_not_look_like_factors():
    assert common_factors(body("-a*y + c*sin(w*t + p)", a=1.0, c=3.0, w=4.0, p=1.0)) == ()
    assert common_factors(body("-a*y - F*tanh(k*v) + u", a=1.0, F=0.5, k=1e4)) == ()


def test_one_parameter_of_each_is_held():
    plant = forces()
    held = without_common_factors(plant, common_factors(plant))
    assert held.fixed == ("J",)
    assert held.parameters == FORCES
    assert without_common_factors(held, ()) is held
    alone = body("-y - v + u + 0*q", q=1.0)  # nothing would be left to estimate
    assert without_common_factors(alone, common_factors(alone)) is alone


@pytest.fixture(scope="module")
def record():
    time = 0.01 * np.arange(3000)
    u = np.repeat(np.random.default_rng(0).uniform(-1.0, 1.0, 100), 30)
    plant = body("9*u - 2*v - 50*y - 0.3*sign(v) + 0*c", c=1.0)
    clean = eoi.simulate(plant, time, u, hold="zero", substeps=8)
    noise = 1e-4 * np.random.default_rng(1).standard_normal(clean.outputs.shape)
    return eoi.Record(time, u, clean.outputs + noise, hold="zero")


def test_identify_says_it_first_and_leaves_the_combinations_right(record):
    plant = body("(K*u - b*v - k*y - F*sign(v))/J", F=0.1, **FORCES)
    result = eoi.identify(plant, record)
    assert result.status.code == "unidentifiable"
    first = str(result).splitlines()[0]
    assert "F, J, K, b and k have a common factor" in first
    assert 'fix J (`fixed = ["J"]`)' in first
    assert "excite" not in first
    assert result.common_factors == common_factors(plant)
    values = result.parameters
    assert values["K"] / values["J"] == pytest.approx(9.0, rel=5e-3)
    assert values["k"] / values["J"] == pytest.approx(50.0, rel=5e-3)
    assert all(error == np.inf for error in result.standard_errors.values())
    fixed = eoi.identify(plant.declared_anew(fixed=("J",)), record)
    assert fixed.status.ok
    assert fixed.common_factors == ()


def test_what_the_record_lacks_is_said_beside_what_no_record_has(record):
    """Without the input K has no trace, which an input would give it."""
    plant = forces()
    silent = eoi.Record(record.time, 0.0 * record.inputs, record.outputs, hold="zero")
    text = eoi.identify(plant, silent).status.message
    assert "have a common factor" in text
    assert "no trace in the data of" in text


def test_refine_says_it_first(record):
    result = eoi.refine(forces(), record[:1500])
    assert result.status.code == "unidentifiable"
    assert "have a common factor" in str(result).splitlines()[0]
    assert result.common_factors[0].fix == ("J",)


def test_discover_holds_one_and_says_so_first(record, tmp_path):
    discovery = eoi.discover(forces(), record, 0.3)
    first = str(discovery).splitlines()[0]
    assert first.startswith("J, K, b and k have a common factor")
    assert "here J was held at 0.5" in first
    assert discovery.effects == ("coulomb_friction",)
    assert discovery.plant.parameters["J"] == 0.5
    assert np.isfinite(discovery.found.standard_errors["K"])
    discovery.save(tmp_path / "discovery")
    loaded = eoi.load(next(tmp_path.iterdir()))
    assert loaded.common_factors == discovery.common_factors


def test_a_plant_as_a_function_is_judged_like_its_text():
    def dynamics(t, x, u, p):
        return (p.K * u[0] - p.b * x.y[1, 0] - p.k * jnp.sin(x.y[0, 0])) / p.J

    (factor,) = common_factors(eoi.Plant(dynamics, FORCES, 2))
    assert factor.combinations == ("K/J", "b/J", "k/J")
