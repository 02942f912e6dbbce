"""The step that `export` writes in C moves states as `rollout` does, sample by sample."""

import ctypes
import shutil
import subprocess
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place

H, SAMPLES, PIECE = 1e-2, 240, 30  # sample period [s]; inputs change at each piece


def pendulum_with_friction():
    plant = eoi.plants.pendulum()
    placed = [place(plant, effects.CoulombFriction(), 0)]
    return augmented(plant, placed, dict.fromkeys(placed[0].names, 30.0))


def arm_with_friction():
    """Two joints whose frictions act on each other through the inertia."""

    def dynamics(t, x, u, p):
        q, v = x.y
        coupling = p.b * jnp.cos(q[1])
        mass = jnp.array([[p.a + 2.0 * coupling, p.d + coupling], [p.d + coupling, p.d]])
        friction = jnp.stack([p.c1, p.c2]) * jnp.sign(v)
        return jnp.linalg.solve(mass, u - friction - 0.2 * v)

    values = {"a": 2.0, "b": 0.5, "d": 0.7, "c1": 0.6, "c2": 0.4}
    return eoi.Plant(dynamics, values, 2, ("t1", "t2"), ("q1", "q2"), name="arm")


def shaken_mass():
    """Position and acceleration of a mass with dry friction: at rest the sensor shows zero."""

    def dynamics(t, x, u, p):
        acceleration = u[0] - p.c * jnp.sign(x.y[1, 0]) - p.k * x.y[0, 0]
        return jnp.stack([acceleration, acceleration])

    return eoi.Plant(dynamics, {"c": 0.8, "k": 3.0}, (2, 0), ("force",), ("x", "acc"))


def timed_tank():
    """A state that is not measured, and a formula that depends on time."""
    return eoi.plant_from_text(
        {"x": "-k*sqrt(x) + z*(1 + 0.3*sin(9*t))", "z": "(q - z)/T"},
        {"k": 0.4, "T": 0.2}, ["x"], ["q"], initial={"z": 0.1},
    )  # fmt: skip


# A plant, its start (outputs, then their rates) and the size of its inputs.
PLANTS = {
    "sticking": (pendulum_with_friction, [[0.3], [0.0]], 0.5),
    "smooth": (eoi.plants.three_mass_spring_damper, [[0.1, 0.2, 0.0], [0.0, -0.3, 0.0]], 1.0),
    "joints": (arm_with_friction, [[0.1, -0.2], [0.3, 0.0]], 0.9),
    "shaken": (shaken_mass, [[0.4, 0.0], [0.0, 0.0]], 2.0),
    "timed": (timed_tank, [[0.5]], 1.0),
}


def compiled(plant, folder, name="rig"):
    """The functions of an exported plant; every warning of the compiler is an error."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here (gcc or cc)")
    source, library = eoi.export(plant, folder / f"{name}.c"), folder / f"{name}.so"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wshadow", "-pedantic", "-Werror"]
    command = [compiler, *flags, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
    subprocess.run(command, check=True, timeout=60)
    functions = ctypes.CDLL(str(library))
    array = np.ctypeslib.ndpointer(dtype=np.float64, flags="C_CONTIGUOUS")
    step = getattr(functions, f"{name}_step")
    step.argtypes = [ctypes.c_double, ctypes.c_double, ctypes.c_int, array, array, array]
    step.restype = None
    outputs = getattr(functions, f"{name}_outputs", None) if plant.has_algebraic else None
    if outputs is not None:
        outputs.argtypes, outputs.restype = [ctypes.c_double, array, array, array], None
    return SimpleNamespace(step=step, outputs=outputs)


def drive(plant, count, seed=3):
    """Levels of the inputs that change now and then, by which friction sticks and slides."""
    levels = np.random.default_rng(seed).uniform(-1.0, 1.0, (count // PIECE, len(plant.inputs)))
    return np.repeat(levels, PIECE, axis=0)


def walked(functions, start, u, hold="zero", substeps=1):
    """The states at all samples by the C function, one call a sample."""
    states, rows = np.asarray(start, float), []
    for k in range(len(u)):
        rows.append(states.copy())
        following = u[min(k + 1, len(u) - 1)] if hold == "linear" else u[k]
        functions.step(k * H, H, substeps, states, u[k], following)
    return np.asarray(rows)


def chains(plant, y):
    """Outputs and their derivatives, (N, r, ny), as columns in the order of the file."""
    return np.column_stack(
        [y[:, i, j] for j, degree in enumerate(plant.degrees) for i in range(degree)]
    )


def agree(computed, wanted):
    np.testing.assert_allclose(computed, wanted, rtol=0.0, atol=1e-12 * np.max(np.abs(wanted)))


@pytest.mark.parametrize(
    ("name", "hold", "substeps"),
    [*((name, "zero", 1) for name in PLANTS), ("sticking", "linear", 3), ("timed", "linear", 3)],
)
def test_a_run_by_the_step_in_c_is_that_of_simulate(name, hold, substeps, tmp_path):
    make, initial, size = PLANTS[name]
    plant = make()
    functions = compiled(plant, tmp_path)
    u = size * drive(plant, SAMPLES)
    time = H * np.arange(SAMPLES)
    wanted = eoi.simulate(plant, time, u, np.array(initial), hold=hold, substeps=substeps).outputs
    start = [*chains(plant, np.array(initial)[None])[0], *plant.initial_internal]
    states = walked(functions, start, u, hold, substeps)
    first = np.cumsum([0, *plant.degrees])[:-1]
    shown = [states[:, k] for k, degree in zip(first, plant.degrees, strict=True) if degree]
    if plant.has_algebraic:
        outputs = np.zeros((SAMPLES, 1))
        for k in range(SAMPLES):
            functions.outputs(time[k], states[k], u[k], outputs[k])
        shown.append(outputs[:, 0])
    agree(np.column_stack(shown), wanted)
    for j in np.flatnonzero(plant.dry_friction):
        at_rest = states[:, first[j] + 1] == 0.0
        assert 0.05 < np.mean(at_rest) < 0.95  # it slides, and it sticks
        if plant.has_algebraic:
            # The force that friction balances shows in no acceleration.
            assert np.mean(np.abs(outputs[at_rest]) < 1e-12) > 0.5


def test_all_states_are_those_of_rollout(tmp_path):
    plant, (_, initial, size) = pendulum_with_friction(), PLANTS["sticking"]
    u = size * drive(plant, SAMPLES)
    wanted = eoi.rollout(plant, None, np.array(initial), u, H, hold="linear", substeps=2)
    states = walked(compiled(plant, tmp_path), np.ravel(initial), u, "linear", 2)
    agree(states, chains(plant, np.asarray(wanted.y)))


def test_a_lag_is_a_state_of_the_step(tmp_path):
    """`simulate` follows it exactly; Runge-Kutta steps come nearer by their fourth order."""
    plant = eoi.plants.mass_spring_damper()
    placed = [place(plant, effects.ActuatorLag(), 0)]
    plant = augmented(plant, placed, dict.fromkeys(placed[0].names, 0.2))
    u = np.ones((SAMPLES, 1))
    wanted = eoi.simulate(plant, H * np.arange(SAMPLES), u, hold="zero", substeps=16).outputs
    functions = compiled(plant, tmp_path)
    start = [0.0, 0.0, 1.0]  # the lag starts settled
    coarse, fine = (
        np.max(np.abs(walked(functions, start, u, substeps=n)[:, :1] - wanted)) for n in (1, 2)
    )
    assert coarse < 1e-5 * np.max(np.abs(wanted))
    assert 12.0 < coarse / fine < 20.0


def test_where_the_simulation_does_not_cover_friction_the_file_says_why(tmp_path):
    plant = eoi.Plant(
        lambda t, x, u, p: u - p.c * jnp.sign(x.y[1]), {"c": 0.5}, 3, ("force",), ("x",)
    )
    text = eoi.export(plant, tmp_path / "rig.c").read_text(encoding="utf-8")
    assert "rig_step" not in text
    assert "No function for a step: `plant` must have relative degree 2 or 1 wherever" in text
