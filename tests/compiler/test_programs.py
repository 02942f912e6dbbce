"""Programs are shared by what they compute, and let go with their memory."""

import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.compiler import programs as compilation
from eoi_jax.compiler.programs import MemorySettings, _digest_value, fingerprint, jit


@pytest.fixture(autouse=True)
def usual_limit():
    before = compilation._limit
    yield
    compilation.limit(before)


def traced(function, *arguments):
    return fingerprint(jax.make_jaxpr(function)(*arguments))


def polynomial(*coefficients):
    """A new function at each call."""
    return lambda x: sum(c * x**i for i, c in enumerate(coefficients))


@jit
def applied(function, x, label):
    return function(x), {"label": label, "size": x.shape}


def test_results_are_those_of_the_function_itself():
    x = jnp.arange(4.0)
    value, about = applied(polynomial(1.0, 2.0, 3.0), x, "y")
    np.testing.assert_allclose(value, 1.0 + 2.0 * x + 3.0 * x**2, 1e-15)
    assert about == {"label": "y", "size": (4,)}


def test_functions_that_compute_the_same_share_a_program():
    compilation.limit(compilation.count() + 10)  # room, whatever other tests have compiled
    applied(polynomial(1.5, 0.25, 7.0), np.arange(11.0), "a")
    before = compilation.count()
    value, about = applied(polynomial(1.5, 0.25, 7.0), np.arange(11.0), "b")
    assert compilation.count() == before
    assert about["label"] == "b"
    np.testing.assert_allclose(value, 1.5 + 0.25 * np.arange(11) + 7.0 * np.arange(11) ** 2, 1e-14)
    applied(polynomial(1.5, 0.25, 7.5), np.arange(11.0), "a")  # another constant
    applied(polynomial(1.5, 0.25, 7.0), np.arange(12.0), "a")  # another shape
    assert compilation.count() == before + 2


def test_a_program_that_was_let_go_is_compiled_again_and_gives_the_same():
    function, x = polynomial(0.1, 0.2, 0.3, 0.4), np.linspace(-1.0, 1.0, 9)
    first, _ = applied(function, x, "")
    compilation.limit(1)
    applied(polynomial(5.0, 6.0), x, "")
    assert compilation.count() == 1
    again, _ = applied(function, x, "")
    np.testing.assert_array_equal(again, first)


def test_memory_that_compilation_freed_is_given_back_every_so_often(monkeypatch):
    compilation.limit(1)
    applied(polynomial(0.0, 1.0), np.ones(3), "")
    given_back = []
    monkeypatch.setattr(compilation, "_give_back", lambda: given_back.append(compilation.count()))
    monkeypatch.setattr(compilation, "_SETTINGS", MemorySettings(release_interval=3))
    monkeypatch.setattr(compilation, "_compiled_count", 0)
    for i in range(7):  # each takes the place of the one before
        applied(polynomial(float(i), 2.0), np.ones(3), "")
    assert given_back == [1, 1]


FREED = """
from pathlib import Path
from eoi_jax.compiler import programs as compilation
def resident():
    return int(Path("/proc/self/statm").read_text().split()[1])
blocks = [bytes(3000) + bytes([i % 256]) for i in range(50_000)]
kept = blocks[::100]  # between what is freed, so that the heap does not shrink by itself
del blocks
before = resident()
compilation._give_back()
print(before - resident())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc is asked")
def test_freed_memory_goes_back_to_the_system():
    done = subprocess.run(
        [sys.executable, "-c", FREED], capture_output=True, text=True, timeout=120, check=True
    )
    assert int(done.stdout) * 4096 > 50e6  # of 150 MB


@pytest.mark.parametrize("programs", [0, -3])
def test_a_limit_below_one_is_refused(programs):
    with pytest.raises(ValueError, match="`programs` must be an integer ≥ 1"):
        eoi.configure(cache=False, programs=programs)


def test_inside_transformations_the_function_is_traced_into_the_other():
    function, before = polynomial(0.0, 0.0, 1.0), compilation.count()
    gradient = jax.grad(lambda x: jnp.sum(applied(function, x, "")[0]))(jnp.arange(3.0))
    np.testing.assert_allclose(gradient, 2.0 * np.arange(3.0))
    many = jax.vmap(lambda x: applied(function, x, "")[0])(jnp.ones((2, 3)))
    np.testing.assert_allclose(many, np.ones((2, 3)))
    inside = jax.jit(lambda: applied(function, jnp.full(3, 2.0), "")[0])()  # no argument shows it
    np.testing.assert_allclose(inside, np.full(3, 4.0))
    assert compilation.count() == before


@jit(static=("power", "kind"))
def powered(x, scale, power, kind=None):
    return scale * x**power if kind is None else jnp.asarray(kind)


def test_named_arguments_are_static_wherever_they_stand():
    x = np.array([1.0, 2.0])
    np.testing.assert_allclose(powered(x, 3.0, 2), 3.0 * x**2)
    np.testing.assert_allclose(powered(x, scale=2, power=3), 2.0 * x**3)
    before = compilation.count()
    np.testing.assert_allclose(powered(x, 5.0, power=2), 5.0 * x**2)  # numbers are arguments
    assert compilation.count() == before


def test_static_values_that_are_equal_but_of_other_types_are_told_apart():
    kinds = [powered(np.ones(1), 1.0, 1, kind=one).dtype.kind for one in (1, 1.0, True)]
    assert kinds == ["i", "f", "b"]


def test_a_number_that_jax_traces_is_told_apart_by_its_address():
    """Rules for derivatives may hold some of the function around them (loops in JAX 0.12)."""
    digests = []

    def function(x):
        for value in (x, x, x + 1.0):
            parts: list[bytes] = []
            _digest_value(value, parts.append)
            digests.append(b"".join(parts))
        return x

    jax.make_jaxpr(function)(1.0)
    assert digests[0] == digests[1] != digests[2]


def test_fingerprints_are_of_what_is_computed():
    a, b = np.arange(5000.0), np.arange(5000.0)
    b[2500] = -1.0  # where a printed array is cut
    x = jnp.ones(5000)
    assert traced(lambda x: x + a, x) != traced(lambda x: x + b, x)
    assert traced(lambda x: x + a, x) == traced(lambda y: y + a.copy(), x)
    assert traced(lambda x: x - 2.0, 1.0) != traced(lambda x: 2.0 - x, 1.0)
    assert traced(lambda x, y: x, 1.0, 2.0) != traced(lambda x, y: y, 1.0, 2.0)
    assert traced(jnp.sin, 1.0) != traced(jnp.sin, np.float32(1.0))
    loops = [
        traced(lambda x, k=k: jax.lax.fori_loop(0, 9, lambda _, v: k * v, x), 1.0)
        for k in (2.0, 3.0, 2.0)
    ]
    assert loops[0] == loops[2] != loops[1]
    gathered = [
        traced(lambda x, i=i: x[np.asarray(i)], jnp.ones(4)) for i in ([0, 1], [0, 2], [0, 1])
    ]
    assert gathered[0] == gathered[2] != gathered[1]


MANY = """
import gc, sys
import numpy as np
import eoi_jax as eoi
eoi.configure(cache=False)
time = 0.01 * np.arange(700)
drive = np.repeat(np.random.default_rng(1).uniform(-2.0, 2.0, 14), 50)

def plant_of(power, factor):
    def dynamics(t, x, u, p):
        position, rate = x.y
        return factor * u - p.a * position * abs(position) ** power - p.b * rate
    return eoi.Plant(dynamics, {"a": 20.0, "b": 1.0}, relative_degree=2)

maps = []
for i in range(22):
    plant = plant_of(i, 1.0 + i)
    record = eoi.simulate(plant.with_parameters({"a": 23.0, "b": 1.2}), time, drive)
    found = eoi.identify(plant, record)
    eoi.refine(found, record)
    eoi.validate(found.plant, record)
    gc.collect()
    with open("/proc/self/maps") as file:
        maps.append(sum(1 for _ in file))
print(*maps)
"""


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="only Linux shows its mappings")
def test_new_plants_do_not_pile_up():
    done = subprocess.run(
        [sys.executable, "-c", MANY], capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, done.stderr
    maps = np.array(done.stdout.split(), int)
    # A program for every plant adds 5 to 10 % of what the first plant took; programs are shared,
    # and what a plant adds is its machine code. Now and then a new shape is compiled.
    added = np.diff(maps)
    assert np.median(added) < 0.01 * maps[0], maps
    assert np.count_nonzero(added > 0.01 * maps[0]) < 5, maps
