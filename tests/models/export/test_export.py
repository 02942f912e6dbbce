"""Exported models are run by other tools, and give what ours gives; no name leaves its place."""

import ctypes
import functools
import json
import runpy
import shutil
import subprocess

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import output_cases
import pytest
from jax.scipy.linalg import cho_factor, cho_solve

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects.curve import Curve, InputCurve
from eoi_jax.models.effects.library import standard
from eoi_jax.models.effects.signals import Signal
from eoi_jax.models.export.names import comment, identifier
from eoi_jax.models.export.program import program
from eoi_jax.simulation.initial_state import owned

POINTS = 40
KNOTS = (-1.0, -0.3, 0.2, 0.6, 1.1)


# -- models -----------------------------------------------------------------------------------


def with_effects(plant, chosen):
    """A plant with effects at their first channel, their parameters somewhere in their bounds."""
    placed, values = [], {}
    for i, effect in enumerate(chosen):
        for channel in range(len(effect.channels(plant))):
            if effect.fits(plant, channel):
                placed.append(place(plant, effect, channel))
                break
        names = zip(placed[-1].names, effect.parameters, strict=True)
        values |= {name: min(0.3 + 0.1 * i, one.upper) for name, one in names}
    return augmented(plant, placed, values)


def mixed_dynamics(t, x, u, p):
    """Two outputs of degrees 2 and 1, with every kind of operation."""
    (y1, y2), (v1, _) = x.y
    bent = jnp.where((y1 > 0.2) & ~(v1 > 0.5) | (y2 == 0.0), jnp.exp(-(y1**2)), jnp.abs(y2) ** 1.5)
    rounded = jnp.round(3.0 * y1) + jnp.floor(y2) - jnp.ceil(v1) + jnp.trunc(4.0 * u[0])
    ways = jnp.where((y1 > 0) ^ (v1 > 0), 1.0, -2.0)
    other = jnp.arctan2(y2, 1.0 + u[1] ** 2) + jnp.fmod(y1, 0.7) + jnp.cbrt(v1) * jnp.exp2(y2)
    other += jnp.mod(y1, 0.7) - jnp.mod(y2, -0.9)
    smooth = jnp.tanh(y1) + jnp.arcsinh(y2) + jnp.log1p(y1**2) - jnp.expm1(-(v1**4))
    return jnp.stack(
        [p.k * bent + rounded - ways, other + smooth * p.m - (y1 - (v1 - y2)) / (p.k / (p.m * y1))]
    )


def arm(t, x, u, p):
    """Two joints with a full mass matrix, and a table of gravity."""
    (_, q2), (v1, v2) = x.y
    coupling = p.m * (0.5 + jnp.cos(q2))
    mass = jnp.array([[2.0 + 2.0 * coupling, coupling], [coupling, 1.0]])
    weight = jnp.interp(q2, jnp.array([-1.0, 0.0, 0.8]), jnp.array([0.3, -0.2, 0.5]))
    return jnp.linalg.solve(mass, u - jnp.array([p.k * v1, p.k * v2 + weight]))


def coupled(solved):
    """Two joints, M(q) q'' = τ - C(q, q') q' - D q', with M inverted in one of several ways."""

    def dynamics(t, x, u, p):
        q, v = x.y
        cosine, sine = p.b * jnp.cos(q[1]), p.b * jnp.sin(q[1])
        mass = jnp.array([[p.a + 2.0 * cosine, p.d + cosine], [p.d + cosine, p.d]])
        coriolis = jnp.array([[-sine * v[1], -sine * (v[0] + v[1])], [sine * v[0], 0.0]])
        return solved(mass, u - coriolis @ v - jnp.array([p.c1, p.c2]) * v)

    values = {"a": 2.0, "b": 0.5, "d": 0.7, "c1": 0.1, "c2": 0.2}
    return eoi.Plant(dynamics, values, 2, ("t1", "t2"), ("q1", "q2"), name="arm")


def mixed():
    return eoi.Plant(
        mixed_dynamics, {"k": 2.0, "m": -0.7}, (2, 1), ("u1", "u2"), ("y1", "y2"), name="mixed"
    )


def exchanger(t, x, u, p):
    flow, power = u
    return p.a * flow * (p.inlet - x.y[0]) + p.b * (p.steam - x.y[0]) + p.c * power


def heated():
    values = {"a": 0.3, "inlet": 0.5, "b": 0.2, "steam": 1.5, "c": 0.4}
    return eoi.Plant(exchanger, values, 1, ("flow", "power"), ("temperature",), name="exchanger")


def called_z(t, x, u, p):
    return u - p.z2 * x.y[0] + x.z[0]


def called_like_states():
    """Channels and a parameter with the names that internal states have in other models."""
    model = eoi.Plant(
        called_z, {"z2": 0.3}, 1, ("z",), ("z1",),
        internal=lambda t, x, u, p: u - p.z2 * x.z, internal_initial=(0.2,),
    )  # fmt: skip
    return with_effects(model, [effects.SensorLag(), effects.ConstantOffset()])


def every_term(plant):
    """All effects that are terms, or change an input in an instant."""
    slow = (effects.ActuatorLag, effects.InputDelay)
    fitting = [one for one in standard() if not isinstance(one, slow)]
    return [one for one in fitting if one.channels(plant) and one.fits(plant, 0)]


MODELS = {
    "pendulum": eoi.plants.pendulum,
    "level_tank": eoi.plants.level_tank,
    "three_masses": eoi.plants.three_mass_spring_damper,
    "positioning": eoi.plants.positioning_system,
    "tanks": eoi.plants.cascaded_tanks,
    "propeller": eoi.plants.propeller_arm,
    "duffing": eoi.plants.duffing_oscillator,
    "mixed": mixed,
    "arm": lambda: eoi.Plant(arm, {"m": 0.4, "k": 0.7}, 2, ("a", "b"), ("q1", "q2"), name="arm"),
    "arm_by_solve": lambda: coupled(jnp.linalg.solve),
    "arm_by_inverse": lambda: coupled(lambda mass, force: jnp.linalg.inv(mass) @ force),
    "arm_by_cholesky": lambda: coupled(
        lambda mass, force: cho_solve(cho_factor(mass, lower=True), force)
    ),
    "arm_by_einsum": lambda: coupled(
        lambda mass, force: jnp.einsum("ij,j->i", jnp.linalg.inv(mass), force)
    ),
    "curves": lambda: with_effects(
        eoi.plants.pendulum(),
        [Curve("y", KNOTS, slope=True), Curve("v", KNOTS), InputCurve(KNOTS)],
    ),
    "mechanics_with_all_effects": lambda: with_effects(
        eoi.plants.pendulum(), every_term(eoi.plants.pendulum())
    ),
    "tank_with_all_effects": lambda: with_effects(
        eoi.plants.cascaded_tanks(), every_term(eoi.plants.cascaded_tanks())
    ),
    "coefficients": lambda: with_effects(
        heated(),
        [effects.ParameterDependence("b", "temperature", (Signal("flow", 0, None),), 0.2, 1.0),
         effects.ParameterDependence("c", "temperature", (), 0.5, 1.0, "s", "linear"),
         effects.ConstantOffset()],
    ),
    "cells": lambda: with_effects(
        heated(), [effects.CellsInSeries(4), effects.ConstantOffset(), effects.SensorLag()]
    ),
    "lagged_sensor": lambda: with_effects(
        eoi.plants.mass_spring_damper(), [effects.SensorLag(), effects.LinearStiffness()]
    ),
    "lagged": lambda: with_effects(
        eoi.plants.mass_spring_damper(), [effects.InputDelay(), effects.ActuatorLag()]
    ),
    "called_like_states": called_like_states,
    "text": lambda: eoi.plant_from_text(
        {"x": "v", "v": "-k*x - w*sqrt(x) + z if t > 0.4 else w", "z": "-z + clip(x, -1, 1)"},
        {"k": 2.0, "start": 0.5}, ["x"], definitions={"w": "k*x*x"}, initial={"z": "2*start"},
    ),
    "cell": output_cases.battery,
    "accelerometer": lambda: with_effects(
        output_cases.accelerometer(), [effects.ActuatorLag(), effects.ConstantOffset()]
    ),
    "position_and_acceleration": output_cases.mixed,
    "cell_of_text": lambda: eoi.plant_from_text(
        {"soc": "-i/Q", "v1": "(i - v1/R)/C"}, {"Q": 2.0, "R": 0.5, "C": 3.0}, ["v", "w"], ["i"],
        output={"v": "ocv - i*R - v1", "w": "2*v"}, definitions={"ocv": "sqrt(soc) + soc"},
        initial={"soc": 0.8, "v1": 0.0},
    ),
}  # fmt: skip


@functools.cache
def case(name):
    """A model, and dx/dt of it at some points."""
    plant = MODELS[name]()
    return plant, points(plant)


@pytest.fixture(params=MODELS)
def model(request):
    return request.param, *case(request.param)


def points(plant):
    """States, inputs and times at random, and dx/dt there by the plant itself."""
    form = program(plant)
    draw = np.random.default_rng(1)
    t = draw.uniform(0.0, 1.0, POINTS)
    x = draw.uniform(-1.5, 1.5, (POINTS, len(form.states)))
    u = draw.uniform(-1.0, 1.0, (POINTS, len(form.inputs)))
    return t, x, u, ours(plant, t, x, u)


def ours(plant, times, states, inputs):
    """dx/dt from the plant's own functions, with chains and lags put together by hand."""
    theta = jnp.asarray(plant.theta)
    nz = len(plant.internal_start(theta))

    @eqx.filter_jit
    def rates(t, y, z, u):
        x = eoi.State(y, z)
        return plant.derivative(t, x, u, theta), plant.internal_rate(t, x, u, theta)

    out = np.zeros_like(states)
    for k, (t, x, u) in enumerate(zip(times, states, inputs, strict=True)):
        y = np.zeros((plant.rows, len(plant.outputs)))
        place_of, first = [], 0
        for j, degree in enumerate(plant.degrees):
            y[:degree, j] = x[first : first + degree]
            inner = max(degree - 1, 0)
            out[k, first : first + inner] = x[first + 1 : first + 1 + inner]
            first += degree
            place_of += [first - 1] * (degree > 0)
        behind = x[first + nz :]
        driven = u.copy()
        if len(behind):
            out[k, first + nz :] = (u - behind) / plant.parameters["actuator_lag"]
            driven = behind
        f, g = rates(t, jnp.asarray(y), jnp.asarray(x[first : first + nz]), jnp.asarray(driven))
        chained = np.asarray(plant.degrees) > 0
        out[k, place_of], out[k, first : first + nz] = np.asarray(f)[chained], g
    return out


def our_outputs(plant, times, states, inputs):
    """Outputs that are functions of the states, from the plant's own functions."""
    theta, ny = jnp.asarray(plant.theta), len(plant.outputs)
    rows, columns = owned(plant)
    nz, lagged = len(plant.internal_start(theta)), len(rows) + len(plant.internal_start(theta))
    out = []
    for t, x, u in zip(times, states, inputs, strict=True):
        y = np.zeros((plant.rows, ny))
        y[rows, columns] = x[: len(rows)]
        driven = x[lagged:] if len(x) > lagged else u
        state = eoi.State(jnp.asarray(y), jnp.asarray(x[len(rows) : len(rows) + nz]))
        out.append(plant.output(jnp.asarray(t), state, jnp.asarray(driven), theta))
    return np.asarray(out)[:, plant.algebraic]


def agree(found, wanted):
    # Sums in another order and another library's functions: some units of the last place of the
    # largest term, which may be a hundred times the sum.
    size = np.maximum(np.max(np.abs(wanted), axis=0), 1.0)
    np.testing.assert_allclose(np.asarray(found) / size, wanted / size, rtol=0.0, atol=1e-12)


# -- languages --------------------------------------------------------------------------------


def test_the_python_function_agrees(model, tmp_path):
    name, plant, (t, x, u, wanted) = model
    function = runpy.run_path(str(eoi.export(plant, tmp_path / f"{name}_rates.py")))[
        f"{name}_rates"
    ]
    agree([function(*one) for one in zip(t, x, u, strict=True)], wanted)
    agree(function(t, x.T, u.T).T, wanted)  # many points at once
    if plant.has_algebraic:
        outputs = runpy.run_path(str(tmp_path / f"{name}_rates.py"))[f"{name}_rates_outputs"]
        agree(outputs(t, x.T, u.T).T, our_outputs(plant, t, x, u))
        agree(outputs(t[0], x[0], u[0])[None], our_outputs(plant, t[:1], x[:1], u[:1]))


def test_the_c_function_agrees(model, tmp_path):
    name, plant, (t, x, u, wanted) = model
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here (gcc or cc)")
    source = eoi.export(plant, tmp_path / f"{name}_rates.c")
    library = tmp_path / "model.so"
    # Every warning is an error: unused names, shadowed functions, comments inside comments.
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wshadow", "-pedantic", "-Werror", "-O1"]
    command = [compiler, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    subprocess.run(command, check=True, timeout=60)
    function = getattr(ctypes.CDLL(str(library)), f"{name}_rates")
    array = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    function.argtypes, function.restype = [ctypes.c_double, array, array, array], None
    found = np.zeros_like(wanted)
    for k in range(POINTS):
        # At least one element: an array of none has no address.
        function(t[k], x[k], np.append(u[k], 0.0), found[k])
    agree(found, wanted)
    if plant.has_algebraic:
        outputs = getattr(ctypes.CDLL(str(library)), f"{name}_rates_outputs")
        outputs.argtypes, outputs.restype = function.argtypes, None
        given = our_outputs(plant, t, x, u)
        shown = np.zeros(given.shape)
        for k in range(POINTS):
            outputs(t[k], x[k], u[k], shown[k])
        agree(shown, given)


@pytest.fixture(scope="module")
def octave():
    program = shutil.which("octave-cli") or shutil.which("octave")
    if program is None:
        pytest.skip("no GNU Octave here")
    return [program, "--no-gui", "--no-init-file", "--quiet"]


def test_the_matlab_functions_agree(octave, tmp_path):
    """All models in one start of Octave, which takes longer than they do."""
    wanted, script, outputs = {}, [], {}
    for name in MODELS:
        plant, (t, x, u, wanted[name]) = case(name)
        if plant.has_algebraic:
            outputs[name] = our_outputs(plant, t, x, u)
        eoi.export(plant, tmp_path / f"{name}_rates.m")
        np.savetxt(tmp_path / f"{name}.txt", np.column_stack([t, x, u]), fmt="%.17g")
        n = x.shape[1]
        script.append(
            f"a = load('{name}.txt'); r = zeros({POINTS}, {n}); for k = 1:{POINTS}, "
            f"r(k, :) = {name}_rates(a(k, 1), a(k, 2:{n + 1})', a(k, {n + 2}:end)')'; end; "
            f"dlmwrite('{name}_out.txt', r, 'precision', '%.17g', 'delimiter', ' ');"
        )
        if plant.has_algebraic:
            script.append(
                f"r = zeros({POINTS}, {outputs[name].shape[1]}); for k = 1:{POINTS}, [d, y] = "
                f"{name}_rates(a(k, 1), a(k, 2:{n + 1})', a(k, {n + 2}:end)'); r(k, :) = y'; end; "
                f"dlmwrite('{name}_y.txt', r, 'precision', '%.17g', 'delimiter', ' ');"
            )
    (tmp_path / "run_them.m").write_text("\n".join(script), encoding="utf-8")
    done = subprocess.run([*octave, "run_them.m"], cwd=tmp_path, timeout=100, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    for name, values in wanted.items():
        agree(np.loadtxt(tmp_path / f"{name}_out.txt", ndmin=2).reshape(values.shape), values)
    for name, values in outputs.items():
        agree(np.loadtxt(tmp_path / f"{name}_y.txt", ndmin=2).reshape(values.shape), values)


@pytest.mark.parametrize("field", ["inputs", "outputs"])
def test_a_channel_with_the_name_of_the_time_is_refused(tmp_path, field):
    names: dict[str, Any] = {field: ("t",)}
    plant = eoi.Plant(lambda t, x, u, p: jnp.sin(t) - p.a * x.y[0], {"a": 1.0}, **names)
    rule = rf"`plant.{field}` must not be called t to be exported, .* got t. Give it another name"
    with pytest.raises(ValueError, match=rule):
        eoi.export(plant, tmp_path / "model.py")


def test_json_reads_back_to_a_plant_that_agrees(model, tmp_path):
    _, plant, (t, x, u, wanted) = model
    back = eoi.load(eoi.export(plant, tmp_path / "model.json"))
    assert isinstance(back, eoi.Plant)
    assert back.parameters == plant.parameters
    assert (back.outputs, back.inputs, back.fixed) == (plant.outputs, plant.inputs, plant.fixed)
    np.testing.assert_array_equal(back.lower, plant.lower)
    np.testing.assert_array_equal(back.upper, plant.upper)
    assert back.units == plant.units
    assert back.dry_friction == plant.dry_friction
    agree(ours(back, t, x, u), wanted)
    if plant.has_algebraic:
        assert back.degrees == plant.degrees
        agree(our_outputs(back, t, x, u), our_outputs(plant, t, x, u))
    theta = jnp.asarray(plant.theta)
    np.testing.assert_allclose(back.internal_start(theta), plant.internal_start(theta))


def test_a_model_read_back_simulates_equally(tmp_path):
    plant = with_effects(
        eoi.plants.pendulum(),
        [effects.CoulombFriction(), effects.ActuatorLag(), effects.InputDelay()],
    )
    back = eoi.load(eoi.export(plant, tmp_path / "model.json"))
    time = np.arange(0.0, 3.0, 1e-3)
    u = eoi.excitation.square(time, 0.2, 0.7)
    mine, theirs = (eoi.simulate(one, time, u).outputs for one in (back, plant))
    # Friction sticks at the same samples; between them, rounding grows slowly.
    np.testing.assert_allclose(mine, theirs, atol=1e-9)


def test_latex_balances_and_names_every_parameter(model, tmp_path):
    _, plant, _ = model
    text = eoi.export(plant, tmp_path / "model.tex").read_text(encoding="utf-8")
    assert text.count("{") - text.count(r"\{") == text.count("}") - text.count(r"\}")
    assert text.count(r"\left") == text.count(r"\right")
    assert text.count(r"\begin") == text.count(r"\end")
    table = text.split(r"\begin{tabular}")[1]
    assert table.count(r"\\") == len(plant.names)


def limited(*chosen):
    """v' = 2·u - v behind a limit of the rate, a play, or both."""
    plant = eoi.Plant(lambda t, x, u, p: p.b * u[0] - x.y[0], {"b": 2.0}, 1, ("valve",), ("v",))
    return with_effects(plant, chosen)


def test_behind_a_limit_of_the_rate_the_program_simulates_equally(tmp_path):
    """Its input goes through the limit before, as the file says."""
    plant, h, substeps = limited(effects.RateLimit(), effects.ActuatorLag()), 0.1, 20
    path = eoi.export(plant, tmp_path / "model.py")
    text = path.read_text(encoding="utf-8")
    assert "valve: what moves towards it by rate_limit in a second at most, from its first" in text
    assert "rate_limit = 0.3: a limit of the rate" in text
    rates = runpy.run_path(str(path))["model"]
    time = h * np.arange(100)
    u = np.repeat([0.0, 1.0, -0.5, 0.2], 25)
    moved, state, speeds = 0.0, np.zeros(2), []
    for level in u:
        speeds.append(state[0])
        for _ in range(substeps):
            step = h / substeps
            start = moved
            moved += np.clip(level - moved, -0.3 * step, 0.3 * step)
            middle = np.array([0.5 * (start + moved)])
            k1 = rates(0.0, state, middle)
            state = state + step * rates(0.0, state + 0.5 * step * k1, middle)
    simulated = eoi.simulate(plant, time, u, hold="zero").outputs[:, 0]
    np.testing.assert_allclose(speeds, simulated, atol=2e-3)


def test_a_play_before_the_model_is_said_in_each_language(tmp_path):
    plant = limited(effects.InputDelay(), effects.InputPlay())
    for name in ("model.py", "model.c", "model.m"):
        text = eoi.export(plant, tmp_path / name).read_text(encoding="utf-8")
        said = "seconds ago, then what it takes along where they are half of input_play apart"
        assert said in text
    assert "play before" in eoi.export(plant, tmp_path / "model.tex").read_text(encoding="utf-8")


# -- what a file says -------------------------------------------------------------------------


def test_a_file_says_what_its_numbers_are(tmp_path):
    plant = with_effects(eoi.plants.pendulum(), [effects.InputDelay(), effects.Hysteresis()])
    text = eoi.export(plant, tmp_path / "model.c").read_text(encoding="utf-8")
    assert "states[1] angle_rate [rad/s]: derivative 1 of angle" in text
    assert "states[2] z: internal state, not measured; starts at 0.0, or where a free" in text
    assert "inputs[0] voltage [V]: its value input_delay seconds ago" in text
    assert "input_delay = 0.3 [s]: a delay" in text
    assert "at angle_rate = 0 the right-hand side is set-valued" in text
    assert "const double a = 76.0; /* 1/s² */" in text


def test_a_file_says_which_starts_free_runs_estimate(tmp_path):
    """A second store: the errors of the answer are those of runs that start it elsewhere."""
    tank = eoi.Plant(lambda t, x, u, p: p.k * u[0] - p.a * x.y[0], {"k": 1.0, "a": 0.1}, 1,
                     ("heat",), ("T",), initial={"T": 20.0})  # fmt: skip
    plant = with_effects(tank, [effects.SecondNode()])
    assert plant.open_internal.tolist() == [True]
    for name in ("model.py", "model.c", "model.m"):
        text = eoi.export(plant, tmp_path / name).read_text(encoding="utf-8")
        (line,) = [line for line in text.splitlines() if "T" in line and "starts at" in line]
        assert line.endswith("starts at 20.0")
        (line,) = [line for line in text.splitlines() if "z: internal state" in line]
        assert "; starts at 0.0, or where a free run estimates it for its record" in line


def test_a_result_is_exported_by_its_plant(tmp_path):
    class Result:
        plant = eoi.plants.pendulum()

    text = eoi.export(Result(), tmp_path / "a", language="latex").read_text(encoding="utf-8")
    assert r"\ddot{\mathrm{angle}}" in text


# -- hostile names ----------------------------------------------------------------------------

HOSTILE = [
    "*/ int evil; /*",
    "a\nimport os; os.abort() #",
    "coding: utf-7",
    "%{\nsystem('ls')\n%}",
    "\\\n*/",
    r"\input{secret}",
    '"""',
    "}",
    "??/",
    "\u2028x = 1",
    "for",
    "states",
    "x",
    "if",
    "",
]


def hostile():
    def f(t, x, u, p):
        return -p.int * x.y[0] - p.end * x.y[0] + p.pi * u.sum()

    names = (*HOSTILE, *(f"{one} 2" for one in HOSTILE[:3]))
    units = dict.fromkeys((*names, "int", "end", "pi", "y*/"), HOSTILE[0] + HOSTILE[1] + HOSTILE[3])
    return eoi.Plant(f, {"int": 1.0, "end": 2.0, "pi": 3.0}, 1, names, ("y*/",), units=units,
                     name=HOSTILE[1])  # fmt: skip


def test_no_name_or_unit_leaves_its_place(tmp_path):
    plant = hostile()
    t, x, u, wanted = points(plant)
    function = runpy.run_path(str(eoi.export(plant, tmp_path / "odd.py")))["odd"]
    agree(function(t, x.T, u.T).T, wanted)
    back = eoi.load(eoi.export(plant, tmp_path / "odd.json"))
    agree(ours(back, t, x, u), wanted)
    tex = eoi.export(plant, tmp_path / "odd.tex").read_text(encoding="utf-8")
    assert r"\input" not in tex
    source = eoi.export(plant, tmp_path / "odd.c")
    code = source.read_text(encoding="utf-8")
    assert code.count("*/") == code.count("/*")
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here (gcc or cc)")
    for language in ("c", "c++"):
        flags = ["-x", language, "-fsyntax-only", "-Wall", "-Wextra", "-trigraphs", "-Werror"]
        subprocess.run([compiler, *flags, str(source)], check=True, timeout=60)


def test_hostile_names_are_safe_in_octave(octave, tmp_path):
    plant = hostile()
    t, x, u, wanted = points(plant)
    eoi.export(plant, tmp_path / "odd.m")
    np.savetxt(tmp_path / "u.txt", u[0], fmt="%.17g")
    call = f"printf('%.17g', odd({t[0]:.17g}, {x[0, 0]:.17g}, load('u.txt')))"
    done = subprocess.run([*octave, "--eval", call], cwd=tmp_path, timeout=60, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    assert float(done.stdout) == pytest.approx(wanted[0, 0], rel=1e-10)


@pytest.mark.parametrize("text", HOSTILE)
def test_identifiers_and_comments_hold_nothing_else(text):
    assert identifier(text).isascii()
    assert identifier(text).isidentifier()
    assert identifier(text, [identifier(text)]) != identifier(text)
    line = comment(text)
    assert line.isprintable() or not line
    assert "*/" not in line
    assert "/*" not in line
    assert "\\" not in line


def test_greek_is_spelled_out_and_accents_are_left_out():
    assert identifier("α_Ω") == "alpha_omega"
    assert identifier("Füllstand é") == "Fullstand_e"
    assert identifier("Außentemperatur") == "Aussentemperatur"


# -- what cannot be exported ------------------------------------------------------------------


def simple(dynamics, **more):
    return eoi.Plant(dynamics, {"a": 1.0}, 1, ("u",), ("y",), **more)


def linear(t, x, u, p):
    return p.a * u


def lookup(t, x, u, p):
    return p.a * jnp.arange(100.0)[jnp.int32(jnp.abs(x.y[0, 0]))]


def largest(t, x, u, p):
    matrix = jnp.array([[p.a, x.y[0, 0]], [x.y[0, 0], 2.0]])
    return jnp.linalg.eigvalsh(matrix)[1]


@pytest.mark.parametrize(
    ("plant", "name", "message"),
    [
        (lambda: simple(lookup), "a.c", "`plant` must be arithmetic on.*places that depend on"),
        (lambda: simple(largest), "a.c", "operation eigh. It belongs to `jax.numpy.linalg`"),
        (lambda: simple(lambda t, x, u, p: p.a * x.y[0], actuator=lambda t, u, p: u), "a.c",
         "`actuator` must be made of the effects"),
        (lambda: augmented(simple(linear), [place(simple(linear), effects.InputRate(), 0)],
                           {"input_rate_lead": 0.1, "input_rate_lag": 0.05}), "a.c",
         "`actuator` must be made of the effects.*got input_rate. Export the model without"),
        (lambda: limited(effects.RateLimit()), "a.json",
         "`effect rate_limit` of valve has no place in a model as text.*Export a program"),
        (lambda: limited(effects.ActuatorLag(), effects.RateLimit()), "a.c",
         "`rate_limit` must act before the lag of valve to be exported"),
        (lambda: with_effects(eoi.plants.pendulum(), [effects.ActuatorLag()]).with_parameters(
            {"actuator_lag": 0.0}), "a.c", r"`parameters\[actuator_lag\]` must be positive"),
        (lambda: simple(lambda t, x, u, p: x.y[0] + 0 * p.a), "a.json",
         r"`parameters\[a\]` must be used"),
        (lambda: simple(lambda t, x, u, p: p.a * jnp.minimum(x.y[0], jnp.inf)), "a.c",
         "finite constants"),
        (eoi.plants.pendulum, "a.txt", "`path` must end in .py, .c"),
        (eoi.plants.pendulum, "for.c", "`path` must be named as a function can be.*for_"),
        (eoi.plants.pendulum, "my model.m", "For example my_model"),
        (eoi.plants.pendulum, "none/a.c", "`path` must be writable"),
        (lambda: 3, "a.c", "`model` must be a Plant or a result that has one, got int"),
    ],
)  # fmt: skip
def test_what_cannot_be_exported_is_refused_with_the_reason(plant, name, message, tmp_path):
    with pytest.raises(ValueError, match=f"(?s){message}"):
        eoi.export(plant(), tmp_path / name)
    assert not list(tmp_path.iterdir())  # nothing half-written


def test_an_unknown_language_is_refused(tmp_path):
    with pytest.raises(ValueError, match="`language` must be one of python, c, matlab"):
        eoi.export(eoi.plants.pendulum(), tmp_path / "a.c", language="fortran")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "must be a model that `export` wrote, got no JSON"),
        ("[" * 5000, "got no JSON"),
        ('{"a": 1}', "got other JSON"),
        (
            '{"kind": "eoi_jax model", "format": 9, "version": "7"}',
            "format 9, written by eoi_jax 7",
        ),
        ('{"kind": "eoi_jax model", "format": 1, "model": 3}', "`model` must be a table"),
        ('{"kind": "eoi_jax model", "format": 1, "model": {}}', "`model.outputs` must be given"),
    ],
)
def test_what_is_no_model_is_refused_on_reading(text, message, tmp_path):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ValueError, match=message):
        eoi.load(tmp_path / "a.json")


def test_a_model_that_was_changed_by_hand_is_read_like_any_text(tmp_path):
    path = eoi.export(eoi.plants.pendulum(), tmp_path / "a.json")
    content = json.loads(path.read_text(encoding="utf-8"))
    content["model"]["derivatives"]["angle_rate"] = "__import__('os').abort()"
    path.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"`model.derivatives.angle_rate` must not hold"):
        eoi.load(path)


def test_code_replaces_code_that_was_written_here_only(tmp_path):
    plant, path = eoi.plants.level_tank(), tmp_path / "tank.c"
    eoi.export(plant, path)
    eoi.export(plant, path)
    path.write_text("int main(void) { return 0; }\n")
    with pytest.raises(ValueError, match=r"not be a file that eoi_jax did not write, got .*tank"):
        eoi.export(plant, path)
    assert path.read_text().startswith("int main")
