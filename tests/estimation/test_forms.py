"""The answer does not depend on how the equation of a plant is written."""

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from benchmarks.independent import body
from eoi_jax.estimation.instrumental_variables import refusal
from eoi_jax.estimation.kernel import Sums

TRUE = {"a": 40.0, "b": 2.0, "c": 12.0}
NOMINAL = {"a": 75.0, "b": 1.1, "c": 7.0}
PERIOD = 0.01

# Equation, nominal values of its parameters, what is known, and the affine coefficients.
FORMS = {
    "scaled": (
        "0.01*c*u - 1000*a*y - b*v",
        {"a": 0.075, "b": 1.1, "c": 700.0},
        (),
        lambda p: {"a": 1000 * p["a"], "b": p["b"], "c": 0.01 * p["c"]},
    ),
    "forces, known gain": (
        "(K*u - d*v - k*y)/m",
        {"m": 0.5, "K": 3.5, "d": 0.55, "k": 37.5},
        ("K",),
        lambda p: {"a": p["k"] / p["m"], "b": p["d"] / p["m"], "c": p["K"] / p["m"]},
    ),
    "forces, known mass": (
        "(K*u - d*v - k*y)/m",
        {"m": 0.5, "K": 3.5, "d": 0.55, "k": 37.5},
        ("m",),
        lambda p: {"a": p["k"] / p["m"], "b": p["d"] / p["m"], "c": p["K"] / p["m"]},
    ),
    "sums": (
        "c*u - (p - q)*v - (p + q)*y",
        {"p": 38.05, "q": 36.95, "c": 7.0},
        (),
        lambda p: {"a": p["p"] + p["q"], "b": p["p"] - p["q"], "c": p["c"]},
    ),
    "products": (
        "K*w**2*u - 2*zeta*w*v - w**2*y",
        {"w": 75.0**0.5, "zeta": 0.55 / 75.0**0.5, "K": 7.0 / 75.0},
        (),
        lambda p: {"a": p["w"] ** 2, "b": 2 * p["zeta"] * p["w"], "c": p["K"] * p["w"] ** 2},
    ),
    "reciprocals": (
        "u/r - v/s - y/q",
        {"q": 1 / 75.0, "s": 1 / 1.1, "r": 1 / 7.0},
        (),
        lambda p: {"a": 1 / p["q"], "b": 1 / p["s"], "c": 1 / p["r"]},
    ),
}


def written(equation, values, bounds=None, fixed=()):
    return eoi.plant_from_text(
        {"y": "v", "v": equation}, values, ["y"], ["u"], bounds=bounds, fixed=fixed
    )


def measured(level, noise=1e-3, seed=0):
    """A mass on a spring, with dry friction or without, solved by SciPy."""
    draw = np.random.default_rng(seed)
    time = PERIOD * np.arange(3000)
    u = np.repeat(draw.uniform(-1.0, 1.0, 100), 30)
    y = body(lambda y, v, u: TRUE["c"] * u - TRUE["b"] * v - TRUE["a"] * y, level, time, u)
    y += noise * np.std(y) * draw.standard_normal(y.shape)
    return eoi.Record(time, u, y, "run", hold="zero")


@pytest.fixture(scope="module")
def clean():
    return measured(0.0)


@pytest.fixture(scope="module")
def rubbing():
    return measured(0.8)


@pytest.fixture(scope="module")
def affine():
    return written("c*u - b*v - a*y", NOMINAL)


@pytest.fixture(scope="module")
def references(affine, clean, rubbing):
    return [eoi.identify(affine, record) for record in (clean, rubbing)]


def moved(form, fit):
    """Affine coefficients of a fit, and their covariance by central differences."""
    values = fit.parameters
    slopes = []
    for name, value in values.items():
        step = 1e-6 * abs(value)
        ends = [form({**values, name: value + sign * step}) for sign in (1, -1)]
        slopes.append([(ends[0][key] - ends[1][key]) / (2 * step) for key in NOMINAL])
    slope = np.asarray(slopes).T
    return form(values), slope @ fit.covariance @ slope.T


@pytest.mark.parametrize("name", FORMS)
@pytest.mark.parametrize("bounded", [False, True])
def test_every_form_has_the_estimate_of_the_affine_one(name, bounded, references, clean, rubbing):
    equation, values, fixed, form = FORMS[name]
    bounds = dict.fromkeys(values, (0.0, None)) if bounded else None
    for reference, record in zip(references, (clean, rubbing), strict=True):
        fit = eoi.identify(written(equation, values, bounds, fixed), record)
        assert fit.status.code == "converged"
        coefficients, covariance = moved(form, fit)
        for i, key in enumerate(NOMINAL):
            error = reference.standard_errors[key]
            assert abs(coefficients[key] - reference.parameters[key]) < 0.1 * error
            assert np.sqrt(covariance[i, i]) == pytest.approx(error, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["forces, known gain", "products", "reciprocals"])
def test_every_form_has_the_effects_of_the_affine_one(name, rubbing):
    equation, values, fixed, form = FORMS[name]
    bounds = dict.fromkeys(values, (0.0, None))
    discovery = eoi.discover(written(equation, values, bounds, fixed), rubbing, 0.3)
    assert discovery.effects == ("coulomb_friction",)
    coefficients = form(discovery.plant.parameters)
    for key, value in TRUE.items():
        assert coefficients[key] == pytest.approx(value, rel=2e-2)
    (friction,) = discovery.added
    assert next(iter(friction.parameters.values())) == pytest.approx(0.8, rel=1e-2)


def test_forms_refine_to_one_estimate(affine, clean):
    reference = eoi.refine(affine, clean[:1500])
    equation, values, fixed, form = FORMS["forces, known gain"]
    bounds = dict.fromkeys(values, (0.0, None))
    fit = eoi.refine(written(equation, values, bounds, fixed), clean[:1500])
    coefficients, covariance = moved(form, fit)
    for i, key in enumerate(NOMINAL):
        error = reference.standard_errors[key]
        assert abs(coefficients[key] - reference.parameters[key]) < 0.1 * error
        assert np.sqrt(covariance[i, i]) == pytest.approx(error, rel=0.3)


# -- far guesses, zero, and what runs off --------------------------------------------------------


@pytest.mark.parametrize("factor", [1 / 6, 6])
def test_a_mass_six_times_off_is_found_without_a_bound(factor, references, clean):
    equation, values, _, form = FORMS["forces, known gain"]
    start = {**values, "m": values["K"] / TRUE["c"] * factor}
    fit = eoi.identify(written(equation, start, fixed=("K",)), clean)
    assert fit.status.code == "converged"
    assert np.all(fit.parameter_history[:, 0] > 0.0)
    coefficients = form(fit.parameters)
    for key, value in references[0].parameters.items():
        assert coefficients[key] == pytest.approx(value, rel=1e-6)


@pytest.mark.slow
def test_a_friction_that_is_not_there_ends_on_its_bound_of_zero(clean):
    """Beside a mass that divides, whose scale never reaches zero."""
    values = {"m": 0.5, "K": 3.5, "d": 0.55, "k": 37.5, "F": 0.3}
    model = written("(K*u - d*v - k*y - F*sign(v))/m", values,
                    dict.fromkeys(values, (0.0, None)), ("K",))  # fmt: skip
    simple = written("(K*u - d*v - k*y)/m", {"m": 0.5, "K": 3.5, "d": 0.55, "k": 37.5},
                     fixed=("K",))  # fmt: skip
    without = eoi.identify(simple, clean)
    for fit in (eoi.identify(model, clean), eoi.refine(model, clean[:1500])):
        assert fit.status.ok
        low, high = eoi.uncertainty(fit).intervals()["F"]
        if fit.parameters["F"] == 0.0:
            assert any(note.startswith("F ended on its bound, 0") for note in fit.notes)
            assert np.isnan(low)
        else:  # by chance of the noise
            assert 0.0 <= low <= fit.parameters["F"] <= high
            assert fit.parameters["F"] < 3.0 * fit.standard_errors["F"]
        for name in ("m", "d", "k"):
            assert fit.parameters[name] == pytest.approx(without.parameters[name], rel=1e-2)
            assert np.isfinite(fit.standard_errors[name])


def test_a_slope_at_rest_that_runs_off_is_held_and_named(rubbing):
    """F tanh(k v) is dry friction from some k on."""
    values = {"a": 35.0, "b": 1.5, "c": 9.0, "F": 0.5, "k": 200.0}
    model = written("c*u - b*v - a*y - F*tanh(k*v)", values)
    fit = eoi.identify(model, rubbing)
    if "k" not in fit.plant.fixed:  # it need not run off where the passes keep it
        assert abs(fit.parameters["k"]) < 10.0 * values["k"]
        return
    (note,) = [note for note in fit.notes if note.startswith("k ran off to ")]
    assert "any larger value fits as well: it is held at" in note
    assert fit.status.code == "converged"
    assert fit.nominal.parameters["k"] == 200.0
    assert fit.nominal.fixed == ()
    assert fit.standard_errors["k"] == 0.0
    for name in ("a", "b", "c", "F"):
        assert 0.0 < fit.standard_errors[name] < 0.05 * abs(fit.parameters[name])
    assert fit.parameters["c"] == pytest.approx(TRUE["c"], rel=1e-2)


def test_a_python_function_is_a_form_like_any_other(references, clean):
    def dynamics(t, x, u, p):
        return (u[0] - x.y[0, 0] / p.gain - 2 * p.zeta * p.tau * x.y[1, 0]) / p.tau**2

    # 1/(gain τ²) = a, 2 ζ/τ = b, 1/τ² = c
    start = {"tau": 7.0**-0.5, "gain": 7.0 / 75.0, "zeta": 0.55 * 7.0**-0.5}
    fit = eoi.identify(eoi.Plant(dynamics, start, 2), clean)
    values = fit.parameters
    assert values["tau"] ** -2 == pytest.approx(references[0].parameters["c"], rel=1e-6)
    stiffness = 1 / (values["gain"] * values["tau"] ** 2)
    assert stiffness == pytest.approx(references[0].parameters["a"], rel=1e-6)


def test_instruments_are_refused_where_errors_grow_along_the_runs():
    """A pendulum that turns over: its linearised inverse has no bounded answer."""
    time, u = 0.02 * np.arange(3000), np.repeat(np.random.default_rng(3).uniform(-1, 1, 100), 30)
    y = body(lambda y, v, u: 45.0 * u - 0.35 * v - 10.7 * np.sin(y), 0.0, time, u)
    y += 1e-3 * np.std(y) * np.random.default_rng(4).standard_normal(y.shape)
    model = eoi.Plant(
        lambda t, x, u, p: p.c * u[0] - p.b * x.y[1, 0] - p.a * jnp.sin(x.y[0, 0]),
        {"a": 9.0, "b": 0.5, "c": 30.0}, 2,
    )  # fmt: skip
    fit = eoi.identify(model, eoi.Record(time, u, y, hold="zero"), instruments=True)
    assert np.ptp(y) > 4.0 * np.pi
    assert any("errors grow along its free runs" in reason for reason in fit.reasons)
    assert not np.any(fit.correction)
    assert fit.parameters["c"] == pytest.approx(45.0, rel=2e-2)
    assert fit.standard_errors["c"] < 1.0


def test_a_mode_faster_than_the_samples_is_put_down_to_the_parameters_that_set_it(clean):
    lagged = eoi.plant_from_text(
        {"y": "v", "v": "c*z - b*v - a*y", "z": "(u - z)/tau"}, {**NOMINAL, "tau": 0.1}, ["y"],
        ["u"], initial={"z": 0.0},
    )  # fmt: skip
    fit = eoi.identify(lagged, clean)
    assert fit.status.code == "undersampled"
    assert "set by tau (0.1 at first, now " in fit.status.message
    assert " and " not in fit.status.message.split("set by")[1].split(")")[0]


def test_an_estimate_by_instruments_that_fits_far_worse_is_refused():
    def at(index):
        one, none = np.ones(2), np.zeros((2, 3))
        square = np.zeros((3, 3))
        return Sums(np.zeros((2, 3, 3)), none, np.asarray(index), one, one, one, one, square)

    before = np.array([2.0, 3.0])
    assert refusal(before, at([8.0, 12.0]), ("x", "y")) == ""
    text = refusal(before, at([8.0, 90.0]), ("x", "y"))
    assert text.startswith("no instrumental variables: with them the index of y is 30 times")
    assert refusal(np.zeros(2), at([1.0, 1.0]), ("x", "y")) == ""  # nothing to compare with
