"""Files for `idnlgrey`: the function gives the model's rates and outputs, the script builds it."""

import re
import shutil
import subprocess

import jax.numpy as jnp
import numpy as np
import output_cases
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.export.program import program
from eoi_jax.simulation.initial_state import owned


def delayed():
    plant = eoi.plants.mass_spring_damper()
    placed = [place(plant, effect, 0) for effect in (effects.InputDelay(), effects.ActuatorLag())]
    return augmented(plant, placed, {"input_delay": 0.25, "actuator_lag": 0.5})


def letters():
    """Names that the function itself uses."""

    def f(t, x, u, p):
        return jnp.stack([p.x * x.y[1, 0] - u[0], jnp.where(x.y[0, 1] > p.u, x.y[0, 0], -p.x)])

    return eoi.Plant(
        f, {"x": 2.0, "u": 0.1}, (2, 1), ("dx",), ("y", "t2"), bounds={"x": (0.0, 9.0)},
        fixed=("u",), units={"x": "it's", "y": "m"}, name="let'ters",
        initial={"y": (None, 0.5)},
    )  # fmt: skip


PLANTS = {
    "pendulum": eoi.plants.pendulum,
    "masses": eoi.plants.three_mass_spring_damper,
    "tanks": eoi.plants.cascaded_tanks,
    "mixed": output_cases.mixed,
    "delayed": delayed,
    "letters": letters,
}


def points(plant):
    """States, inputs, and what the plant's own functions give there."""
    draw, form = np.random.default_rng(2), program(plant)
    x = draw.uniform(0.1, 1.5, (5, len(form.states)))
    u = draw.uniform(-1.0, 1.0, (5, len(plant.inputs)))
    rows, columns = owned(plant)
    nz = len(plant.initial_internal)
    rates, outputs = [], []
    theta = jnp.asarray(plant.theta)
    for state, drive in zip(x, u, strict=True):
        y = np.zeros((plant.rows, len(plant.outputs)))
        y[rows, columns] = state[: len(rows)]
        z, lags = state[len(rows) : len(rows) + nz], state[len(rows) + nz :]
        passed = lags if len(lags) else drive
        at = jnp.asarray(0.3), eoi.State(jnp.asarray(y), jnp.asarray(z)), jnp.asarray(passed)
        f, g = np.asarray(plant.derivative(*at, theta)), plant.internal_rate(*at, theta)
        chained = []
        for j, degree in enumerate(plant.degrees):
            chained += [*y[1:degree, j], *([f[j]] if degree else [])]
        lagged = (drive - lags) / plant.parameters["actuator_lag"] if len(lags) else []
        rates.append([*chained, *g, *lagged])
        outputs.append(plant.output(*at, theta))
    return x, u, np.asarray(rates), np.asarray(outputs)


def column(text, field):
    """Entries of a field of a structure in the script."""
    found = re.search(rf"'{field}', {{(.*?)}}(?:, \.\.\.|\))", text)
    assert found is not None
    entries = found[1]
    return [entry.strip() for entry in re.split(r";(?=(?:[^']*'[^']*')*[^']*$)", entries)]


def number(text):
    return {"Inf": np.inf, "-Inf": -np.inf}.get(text) or float(text)


def evaluated(text, t, x, u, values):
    """The function of the file by Python, in which arithmetic is written alike."""
    head = re.match(r"function \[dx, y\] = \w+\((.*)\)\n", text)
    assert head is not None
    names = head[1].split(", ")
    assert names[:2] == ["t", "x"]
    assert names[-1] == "varargin"
    parameters = [name for name in names[2:-1] if name != "u"]
    scope = {
        "t": t, "x": lambda k: x[k - 1], "u": lambda k: u[k - 1], "sin": np.sin, "sqrt": np.sqrt,
        "max": max, "sign": np.sign, "choose": lambda c, a, b: a if c else b,
        "zeros": lambda n, _: np.zeros(n), **dict(zip(parameters, values, strict=True)),
    }  # fmt: skip
    body = text[head.end() :].split("\nend\n")[0]
    for line in body.splitlines():
        if not line.startswith("%"):
            code = re.sub(r"^(dx|y)\((\d+)\) =", lambda m: f"{m[1]}[{int(m[2]) - 1}] =", line)
            exec(code.replace("^", "**"), {}, scope)
    return scope["dx"], scope["y"]


@pytest.mark.parametrize("name", PLANTS)
def test_the_function_gives_rates_and_all_outputs(name, tmp_path):
    plant = PLANTS[name]()
    path = eoi.export(plant, tmp_path / "rig.m", language="idnlgrey")
    script = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8")
    values = [number(entry) for entry in column(script.split("initial_states")[0], "Value")]
    x, u, rates, outputs = points(plant)
    for k in range(len(x)):
        dx, y = evaluated(path.read_text(encoding="utf-8"), 0.3, x[k], u[k], values)
        np.testing.assert_allclose(dx, rates[k], rtol=1e-12)
        np.testing.assert_allclose(y, outputs[k], rtol=1e-12)


@pytest.mark.parametrize("name", PLANTS)
def test_the_script_declares_orders_parameters_and_starts(name, tmp_path):
    plant = PLANTS[name]()
    eoi.export(plant, tmp_path / "rig.m", language="idnlgrey")
    script = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8")
    form = program(plant)
    orders = len(plant.outputs), len(plant.inputs), len(form.states)
    call = "idnlgrey('rig', [{} {} {}], parameters, initial_states, 0,".format(*orders)
    assert call in script
    parameters, states = script.split("initial_states = struct")
    keys = [key for key in plant.names if key != "input_delay"]
    rows = [plant.names.index(key) for key in keys]
    assert column(parameters, "Name") == [f"'{key}'" for key in keys]
    for field, wanted in (
        ("Value", plant.theta),
        ("Minimum", plant.lower),
        ("Maximum", plant.upper),
    ):
        entries = [number(entry) for entry in column(parameters, field)]
        np.testing.assert_array_equal(entries, wanted[rows])
    assert column(parameters, "Fixed") == [str(key in plant.fixed).lower() for key in keys]
    units = [plant.units.get(key, "").replace("'", "''") for key in keys]
    assert column(parameters, "Unit") == [f"'{unit}'" for unit in units]
    for field in ("Name", "Unit", "Value", "Minimum", "Maximum", "Fixed"):
        assert len(column(states, field)) == len(form.states)
    assert column(states.split("model = ")[1], "OutputName") == [
        f"'{key}'" for key in plant.outputs
    ]


def test_known_starts_are_fixed_and_a_delay_is_left_to_the_data(tmp_path):
    eoi.export(letters(), tmp_path / "rig.m", language="idnlgrey")
    states = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8").split("initial_states")[1]
    assert column(states, "Fixed") == ["false", "true", "false"]
    assert [number(entry) for entry in column(states, "Value")] == [0.0, 0.5, 0.0]
    started = eoi.plant_from_text(
        {"x": "-z", "z": "-k*z"}, {"k": 2.0, "z0": 0.5}, ["x"], initial={"z": "2*z0"}
    )
    eoi.export(started, tmp_path / "rig.m", language="idnlgrey")
    script = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8")
    assert "% z starts where parameters say: here at their values." in script
    assert "idnlgrey('rig', [1 0 2]" in script
    function = (tmp_path / "rig.m").read_text(encoding="utf-8")
    assert function.startswith("function [dx, y] = rig(t, x, k, z0, varargin)\n")  # no inputs
    eoi.export(delayed(), tmp_path / "rig.m", language="idnlgrey")
    script = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8")
    assert "% The input voltage acts 0.25 s late: delay it in the data." in script


def test_an_output_without_a_known_start_begins_where_the_first_record_does(tmp_path):
    """A rate of level^-2 is infinite at zero."""
    tank = eoi.plant_from_text({"level": "a*feed - b*sqrt(level)"}, {"a": 1.0, "b": 0.2}, ["level"],
                               inputs=["feed"])  # fmt: skip
    time = 0.1 * np.arange(400)
    feed = eoi.excitation.random_steps(time, 0.5, 1.5, 2.0, seed=0)
    record = eoi.simulate(tank, time, feed, {"level": 49.5}, hold="zero")
    result = eoi.identify(tank, record, instruments=False)
    eoi.export(result, tmp_path / "rig.m", language="idnlgrey")
    states = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8").split("initial_states")[1]
    assert [number(entry) for entry in column(states, "Value")] == pytest.approx([49.5], rel=1e-3)
    assert column(states, "Fixed") == ["false"]
    text = eoi.export(result, tmp_path / "rig.py").read_text(encoding="utf-8")
    assert re.search(r"states\[0\] level: the first record begins at 49\.[45]", text)
    known = tank.declared_anew(initial={"level": 50.0})
    text = eoi.export(eoi.identify(known, record, instruments=False), tmp_path / "rig.py")
    assert "level: starts at 50.0" in text.read_text(encoding="utf-8")


def test_octave_runs_both_files(tmp_path):
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("no GNU Octave here")
    # Octave has no idnlgrey: in its place a function that shows what it is given.
    (tmp_path / "idnlgrey.m").write_text(
        "function m = idnlgrey(file, order, parameters, initial_states, varargin)\n"
        "m.order = order; m.p = {parameters.Value}; m.x = {initial_states.Value};\nend\n"
    )
    lines, expected = [], []
    for name, make in PLANTS.items():
        plant = make()
        eoi.export(plant, tmp_path / f"{name}_rig.m", language="idnlgrey")
        x, u, rates, outputs = points(plant)
        state, drive = (np.array2string(v[0], precision=17, max_line_width=9999) for v in (x, u))
        lines.append(
            f"{name}_rig_idnlgrey; [dx, y] = {name}_rig(0.3, {state}', {drive}', "
            "model.p{:}, {}); printf('%.17g ', model.order, dx, y); printf('\\n');"
        )
        orders = len(plant.outputs), len(plant.inputs), x.shape[1]
        expected.append([*orders, *rates[0], *outputs[0]])
    (tmp_path / "run_them.m").write_text("\n".join(lines), encoding="utf-8")
    command = [octave, "--no-gui", "--no-init-file", "--quiet", "run_them.m"]
    done = subprocess.run(command, cwd=tmp_path, timeout=100, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    for line, values in zip(done.stdout.decode().splitlines(), expected, strict=True):
        np.testing.assert_allclose([float(entry) for entry in line.split()], values, rtol=1e-10)


def test_a_limit_of_the_rate_is_left_to_the_data(tmp_path):
    plant = eoi.plants.mass_spring_damper()
    placed = place(plant, effects.RateLimit(), 0)
    eoi.export(
        augmented(plant, (placed,), {"rate_limit": 0.5}), tmp_path / "rig.m", language="idnlgrey"
    )
    script = (tmp_path / "rig_idnlgrey.m").read_text(encoding="utf-8")
    assert f"% The input {plant.inputs[0]} of the data must first become" in script
    assert "what moves towards it by 0.5 in a second at most" in script
    assert "'rate_limit'" not in script
