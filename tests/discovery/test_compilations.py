"""What a first discovery compiles: with XLA nothing, however many candidates it tries.

Counted in fresh processes, for what is compiled once is known after it.
"""

import os
import subprocess
import sys

import pytest

COUNTED = """
import sys
import numpy as np
from jax._src import compiler

counts = {"compile_or_get_cached": 0}
whole = compiler.compile_or_get_cached

def counted(*args, **kwargs):
    counts["compile_or_get_cached"] += 1
    return whole(*args, **kwargs)

compiler.compile_or_get_cached = counted

import eoi_jax as eoi
from eoi_jax.compiler import jit
from eoi_jax.models.augmented import augmented, place

made = []
compile_loop = jit._compile
jit._compile = lambda *given: made.append(1) or compile_loop(*given)
eoi.configure()


def found(plant, increments, seed):
    rig = plant.with_parameters({k: v + increments[k] for k, v in plant.parameters.items()})
    friction = place(rig, eoi.effects.CoulombFriction(), 0)
    hidden = augmented(rig, [friction], {friction.names[0]: 0.2})
    draw = np.random.default_rng(seed)
    time = 2e-3 * np.arange(8000)
    drive = np.repeat(draw.uniform(-3.0, 3.0, 40), 200)
    record = eoi.simulate(hidden, time, drive)
    noise = 1e-5 * draw.normal(size=record.outputs.shape)
    return eoi.discover(plant, record.with_outputs(record.outputs + noise, "rig"), 0.25)


def oscillator(t, x, u, p):
    position, rate = x.y
    return p.b * u - p.a * position - p.d * rate

for plant, increments, seed in (
    (eoi.plants.mass_spring_damper(), {"alpha": -30.0, "beta": -2.5, "rho": -0.3}, 5),
    (eoi.Plant(oscillator, {"a": 90.0, "b": 1.0, "d": 2.0}, 2), {"a": 9.0, "b": 0.1, "d": -0.5}, 6),
):
    result = found(plant, increments, seed)
    print(*result.effects, counts["compile_or_get_cached"], len(made))
    counts["compile_or_get_cached"] = 0
    made.clear()
"""


def discovered(folder) -> list[tuple[str, int, int]]:
    """Of two plants one after the other: what was found, programs of XLA, machine code made."""
    done = subprocess.run(
        [sys.executable, "-c", COUNTED], capture_output=True, text=True, timeout=500, check=False,
        env=os.environ | {"EOI_CACHE": str(folder), "JAX_PLATFORMS": "cpu"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    return [(effect, int(programs), int(code)) for effect, programs, code in lines]


@pytest.fixture(scope="module")
def cold_and_warm(tmp_path_factory) -> list[list[tuple[str, int, int]]]:
    """Two processes with one cache."""
    folder = tmp_path_factory.mktemp("cache")
    return [discovered(folder) for _ in range(2)]


def test_a_discovery_compiles_nothing_with_xla(cold_and_warm):
    for process in cold_and_warm:
        assert [(effect, programs) for effect, programs, _ in process] == [
            ("coulomb_friction", 0),
            ("coulomb_friction", 0),
        ]


def test_machine_code_is_of_few_loops_and_kept(cold_and_warm):
    (_, _, first), (_, _, second) = cold_and_warm[0]
    # A pass, free runs and the same of the augmented model, and the states of hysteresis.
    assert 0 < first <= 8
    assert second < first
    assert [code for _, _, code in cold_and_warm[1]] == [0, 0]
