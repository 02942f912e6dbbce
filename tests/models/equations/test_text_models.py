"""A plant of text is the plant that Python would make; what does not fit together is named."""

import re
import textwrap
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax._schema import struct
from eoi_jax.cli import build, config
from eoi_jax.compiler.programs import jit
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects.effect import internal_names
from eoi_jax.models.equations.display import equation_latex, equation_text
from eoi_jax.models.equations.expression import FUNCTIONS
from eoi_jax.models.equations.text_model import ModelTable, plant_of

PENDULUM = {
    "derivatives": {"angle": "rate", "rate": "-a*sin(angle) - b*rate - c*sign(rate) + d*voltage"},
    "outputs": ["angle"],
    "inputs": ["voltage"],
}
TEXTS = {
    "pendulum": PENDULUM,
    "level_tank": {
        "derivatives": {"level": "-alpha*sqrt(2*g*level) + beta*voltage"},
        "definitions": {"g": "9.81"},
        "outputs": ["level"],
        "inputs": ["voltage"],
    },
    "mass_spring_damper": {
        "derivatives": {"position": "v", "v": "-alpha*position - beta*v + rho*voltage"},
        "outputs": ["position"],
        "inputs": ["voltage"],
    },
    "three_mass_spring_damper": {
        "derivatives": {
            "position_1": "v1",
            "position_2": "v2",
            "position_3": "v3",
            "v1": "-a2*position_1 + a3*position_2 - a4*v1 + a1*force",
            "v2": "b1*position_1 - b2*position_2 + b3*position_3 - b4*v2",
            "v3": "c1*position_2 - c2*position_3 - c3*v3",
        },
        "outputs": ["position_1", "position_2", "position_3"],
        "inputs": ["force"],
    },
    "positioning_system": {
        "derivatives": {"position": "rate", "rate": "(force - friction - offset)/mass"},
        "definitions": {"friction": "viscous_friction*rate + coulomb_friction*sign(rate)"},
        "outputs": ["position"],
        "inputs": ["force"],
    },
    "cascaded_tanks": {
        "derivatives": {
            "lower_level": "k2*sqrt(upper) - k3*sqrt(lower_level)",
            "upper": "-k1*sqrt(upper) + k4*pump",
        },
        "initial": {"upper": "upper_initial"},
        "outputs": ["lower_level"],
        "inputs": ["pump"],
    },
    "duffing_oscillator": {
        "derivatives": {
            "displacement": "rate",
            "rate": "gain*drive - damping*rate - stiffness*displacement"
            " - cubic_stiffness*displacement**3 + offset",
        },
        "outputs": ["displacement"],
        "inputs": ["drive"],
    },
}


def both(name):
    """The plant of text, and the library's."""
    plant = getattr(eoi.plants, name)()
    limits = zip(plant.names, plant.lower, plant.upper, strict=True)
    text = eoi.plant_from_text(
        **TEXTS[name],
        parameters=plant.parameters,
        bounds={key: (float(low), float(high)) for key, low, high in limits},
        fixed=plant.fixed,
    )
    return text, plant


def point(plant, seed):
    draw = np.random.default_rng(seed)
    y = draw.uniform(-1.0, 2.0, (plant.relative_degree, len(plant.outputs)))
    z = draw.uniform(-0.5, 3.0, len(plant.internal_start(jnp.asarray(plant.theta))))
    u = draw.uniform(-1.0, 1.0, len(plant.inputs))
    return jnp.asarray(0.3), eoi.State(jnp.asarray(y), jnp.asarray(z)), jnp.asarray(u)


@jit
def evaluated(plant, part, t, x, u):
    """A method of a plant, at its nominal parameters."""
    return getattr(plant, part)(t, x, u, jnp.asarray(plant.theta))


@pytest.mark.parametrize("name", TEXTS)
def test_a_plant_of_text_equals_the_one_of_python(name):
    text, plant = both(name)
    theta = jnp.asarray(plant.theta)
    assert text.degrees == plant.degrees
    assert text.dry_friction == plant.dry_friction
    assert text.is_affine == plant.is_affine
    np.testing.assert_array_equal(text.internal_start(theta), plant.internal_start(theta))
    for seed in range(2):
        at = point(plant, seed)
        for part in ("derivative", "internal_rate", "regressor"):
            mine, theirs = (evaluated(one, part, *at) for one in (text, plant))
            # Sums in another order: a few units of the last place of the largest term.
            np.testing.assert_allclose(
                mine, theirs, rtol=1e-13, atol=1e-12 * np.max(np.abs(theirs), initial=1.0)
            )


def test_a_plant_of_text_is_identified_like_any_other():
    text, plant = both("pendulum")
    time = np.arange(0.0, 8.0, 2e-3)
    rig = plant.with_parameters({"a": 81.0, "b": 1.7, "c": 0.3, "d": 99.0})
    record = eoi.simulate(rig, time, eoi.excitation.square(time, 0.2, 0.25))
    mine, theirs = (eoi.identify(one, record, passes=3) for one in (text, plant))
    for name, value in theirs.parameters.items():
        # The relay may switch a sample apart where rounding differs: far below the estimate's own.
        assert mine.parameters[name] == pytest.approx(value, rel=1e-6)


def test_delays_and_lags_of_inputs_are_those_of_the_effects():
    lagged = eoi.plant_from_text(
        {"x": "-k*x + u"}, {"k": 1.0, "T": 0.05, "tau": 0.02}, ["x"], ["u"],
        input_lag={"u": "T"}, input_delay={"u": "tau"},
    )  # fmt: skip
    # By hand: the lag as a state of its own, the input shifted by two samples.
    by_hand = eoi.plant_from_text(
        {"x": "-k*x + z", "z": "(u - z)/T"}, {"k": 1.0, "T": 0.05}, ["x"], ["u"], initial={"z": 0.0}
    )
    time = np.arange(0.0, 2.0, 1e-2)
    u = eoi.excitation.square(time, 1.0, 1.0)
    u[:10] = 0.0
    mine = eoi.simulate(lagged, time, u, hold="zero").outputs
    theirs = eoi.simulate(by_hand, time, np.r_[0.0, 0.0, u[:-2]], hold="zero", substeps=10).outputs
    # The actuator hands over means over a step: an error of second order in h/T = 0.2.
    np.testing.assert_allclose(mine, theirs, atol=0.2**2 / 12)


def test_without_inputs_and_with_time_a_plant_of_text_simulates():
    plant = eoi.plant_from_text({"x": "a*cos(t)"}, {"a": 2.0}, ["x"])
    time = np.arange(0.0, 3.0, 1e-2)
    found = eoi.simulate(plant, time, np.zeros((len(time), 0))).outputs[:, 0]
    np.testing.assert_allclose(found, 2.0 * np.sin(time), atol=1e-8)  # Runge-Kutta 4, h⁴


def test_single_precision_stays_single():
    text, _ = both("cascaded_tanks")
    x = eoi.State(jnp.ones((1, 1), jnp.float32), jnp.ones(1, jnp.float32))
    arguments = jnp.float32(0.0), x, jnp.ones(1, jnp.float32), jnp.asarray(text.theta, jnp.float32)
    assert jax.eval_shape(text.derivative, *arguments).dtype == jnp.float32
    assert jax.eval_shape(text.internal_rate, *arguments).dtype == jnp.float32
    assert jax.eval_shape(text.internal_start, arguments[3]).dtype == jnp.float32


def test_the_equation_is_shown_with_definitions_put_in():
    text, _ = both("positioning_system")
    assert equation_text(text) == (
        "position'' = (force - viscous_friction·position' - coulomb_friction·sign(position')"
        " - offset)/mass"
    )
    tanks, _ = both("cascaded_tanks")
    assert equation_text(tanks).splitlines()[1] == "upper' = -k1·sqrt(upper) + k4·pump"
    assert r"\frac" in equation_latex(text)


def test_definitions_that_grow_are_not_written_out():
    doubling = {f"w{i}": f"w{i - 1}*w{i - 1}" if i else "k*x" for i in range(60)}
    plant = eoi.plant_from_text({"x": "-w59"}, {"k": 0.1}, ["x"], definitions=doubling)
    first, *parts = equation_text(plant).splitlines()
    assert first == "x' = -w59"
    assert parts == ["where w0 = k·x", *(f"where w{i} = w{i - 1}·w{i - 1}" for i in range(1, 60))]
    assert np.isfinite(plant.derivative(*point(plant, 0), jnp.asarray(plant.theta)))


def test_a_result_is_stored_with_its_text(tmp_path):
    text, _ = both("cascaded_tanks")
    time = np.arange(0.0, 400.0, 1.0)
    record = eoi.simulate(text, time, eoi.excitation.square(time, 1.0, 0.01) + 2.0)
    result = eoi.identify(text, record, passes=2)
    result.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    again = eoi.simulate(back.plant, time, record.inputs)
    np.testing.assert_array_equal(
        again.outputs, eoi.simulate(result.plant, time, record.inputs).outputs
    )
    assert back.plant.dynamics == text.dynamics


def test_effects_on_a_model_of_text_are_stored_with_it(tmp_path):
    """And its internal states keep their names beside those of the effects."""
    text, _ = both("cascaded_tanks")
    leak = place(text, effects.Leak(), 0)
    both_of_them = augmented(text, [leak], {leak.names[0]: 0.01})
    assert internal_names(both_of_them) == ("upper",)
    time = np.arange(0.0, 400.0, 1.0)
    record = eoi.simulate(both_of_them, time, eoi.excitation.square(time, 1.0, 0.01) + 2.0)
    result = eoi.identify(both_of_them, record, passes=1)
    result.save(tmp_path / "run.npz")
    back = eoi.load(tmp_path / "run.npz")
    again = eoi.load(eoi.export(back, tmp_path / "run.json"))
    at = point(again, 0)
    np.testing.assert_allclose(
        again.derivative(*at, jnp.asarray(again.theta)),
        result.plant.derivative(*at, jnp.asarray(result.plant.theta)),
        rtol=1e-13,
    )


# -- mistakes ---------------------------------------------------------------------------------


RATE = PENDULUM["derivatives"]["rate"]
FOUR = {"a": 1.0, "b": 1.0, "c": 1.0, "d": 1.0}
LAG = {"z": "-z"}


def changed(rate=RATE, more=None, **changes):
    """Arguments with one mistake."""
    rates = {"angle": "rate", "rate": rate, **(more or {})}
    return {**PENDULUM, "parameters": FOUR, "derivatives": rates, **changes}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (changed("-a*angl"), "`model.derivatives.rate` must use.*angl, at column 4"),
        (changed(parameters={**FOUR, "e": 1.0}), "`model.parameters.e` must be used.*Use it in"),
        (changed(definitions={"e": "2*a"}), "`model.definitions.e` must be used"),
        (changed("e", definitions={"e": "f", "f": "e"}), "in a circle, got . → . → ."),
        (changed("e", definitions={"e": "e"}), "in a circle, got e → e"),
        (changed(definitions={"e": "a +"}), "`model.definitions.e` must be one expression"),
        (changed(more=LAG, initial={"z": 0.0}), "`model.derivatives.z` must be used on the way to"),
        (changed(RATE + "+ z", LAG), "`model.initial` must have the internal state z"),
        (changed(initial={"angle": "2*a"}), "got .2.a.*internal state, which `.model.output.` sho"),
        (changed(initial={"speed": 1.0}), r"must have states only \(angle, rate\), got .speed."),
        (changed(RATE + "+ z", LAG, initial={"z": "angle"}), "`model.initial.z`.*got angle"),
        (changed(derivatives={"rate": "-a"}), "`model.derivatives` must have angle.*Add it: angle"),
        (changed(outputs=[]), "`model.outputs` must name at least one"),
        (changed(outputs=["angle", "angle"]), "`model.outputs` must have different names"),
        (changed(inputs=["lambda"]), "got 'lambda'.* and so has lambda in Python: take lambda_"),
        (changed(inputs=["sin"]), "`model.inputs` must have names that are identifiers.*functions"),
        (changed(inputs=["t"]), "`model.inputs` must have names"),
        (changed(inputs=["my input"]), "`model.inputs` must have names"),
        (changed(inputs=["angle"]), "`model.derivatives` must not have the input angle: what is"),
        (changed(units={"anglee": "rad"}), "`model.units` must be one of.*Did you mean `angle`"),
        (changed(input_lag={"volt": "a"}), "`model.input_lag` must be one of voltage"),
        (changed(input_delay={"voltage": "x"}), "`model.input_delay.voltage` must be one of a, b"),
        (changed(bounds={"a": (2.0, None)}), r"`parameters\[a\]` must lie in its bounds"),
        (changed(definitions={"e": "1" * 40_001}), "at most 40000 characters"),
    ],
)
def test_what_does_not_fit_together_is_named(arguments, message):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        eoi.plant_from_text(**arguments)


# -- configs ----------------------------------------------------------------------------------


CONFIG = """
name = "text"

[model]
outputs = ["x"]
inputs = ["u"]
parameters = { k = 1.0, g = 2.0 }
bounds = { k = [0.0, inf] }
fixed = ["g"]
derivatives = { x = "-k*x + g*u" }

[data]
files = ["a.csv"]
time = "t"
inputs = ["u"]
outputs = ["y"]
"""


def loaded(tmp_path, text):
    (tmp_path / "a.toml").write_text(textwrap.dedent(text), encoding="utf-8")
    return config.load(tmp_path / "a.toml")


def test_a_config_may_hold_the_equations(tmp_path):
    plant = build.plant(loaded(tmp_path, CONFIG), tmp_path)
    assert (plant.name, plant.outputs, plant.fixed) == ("text", ("x",), ("g",))
    assert plant.lower[0] == 0.0


def test_the_parameters_table_changes_a_model_of_text_as_any_other(tmp_path):
    more = "\n[parameters]\nnominal = { k = 3.0 }\n"
    plant = build.plant(loaded(tmp_path, CONFIG + more), tmp_path)
    assert plant.parameters == {"k": 3.0, "g": 2.0}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[model]", 'plant = "pendulum"\n[model]', r"`plant` and the table \[model\], got both"),
        ("derivatives", "derivative", "must be one of.*Did you mean `derivatives`"),
        ('outputs = ["x"]', "", "`model.outputs` must be given"),
        ('"-k*x + g*u"', "3", "`model.derivatives.x` must be a text, got 3"),
        ("k = 1.0", 'k = "1"', "`model.parameters.k` must be a number"),
        ("-k*x", "-k^x", r"(?s)`model.derivatives.x` must not hold \^, at column 3"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_table_names_the_field(tmp_path, old, new, message):
    with pytest.raises(ValueError, match=message):
        build.plant(loaded(tmp_path, CONFIG.replace(old, new, 1)), tmp_path)


def test_the_models_of_the_documentation_are_models():
    page = Path(__file__).resolve().parents[3] / "docs" / "equations.md"
    tables = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    first, second, released, anywhere, battery, third = tables
    swing = {**tomllib.loads(released)["model"], "outputs": ["angle"]}
    swing["parameters"] = {"a": 1.0, "b": 1.0}
    plant = plant_of(struct(ModelTable, swing, "model"), "swing")
    assert plant.initial == {"angle": (None, 0.0)}
    cell = plant_of(struct(ModelTable, tomllib.loads(battery)["model"], "model"), "cell")
    assert cell.degrees == (0,)
    runs = tomllib.loads(battery)["model"] | tomllib.loads(anywhere)["model"]
    assert plant_of(struct(ModelTable, runs, "model"), "cell").free_internal.tolist() == [1, 0]
    pendulum = tomllib.loads(first)["model"]
    assert plant_of(struct(ModelTable, pendulum, "model"), "rig").dry_friction == (True,)
    channels = {"outputs": ["lower"], "inputs": ["pump"]}
    names = ("k1", "k2", "k3", "k4", "upper_initial", "tau", "T")
    tanks = {**tomllib.loads(second + third)["model"], **channels}
    tanks["parameters"] = dict.fromkeys(names, 1.0)
    assert plant_of(struct(ModelTable, tanks, "model"), "rig").internal is not None
    text = page.read_text("utf-8")
    start = text.index("| functions | ") + len("| functions | ")
    listed = text[start : text.index(" |", start)].split()
    assert {*listed, "where"} == set(FUNCTIONS)


def test_a_config_without_plant_and_model_is_refused(tmp_path):
    with pytest.raises(
        ValueError, match=r"exactly one of `plant` and the table \[model\], got none"
    ):
        loaded(tmp_path, 'name = "a"\n' + CONFIG[CONFIG.index("[data]") :])
