"""Importing changes nothing; `configure` sets up JAX, each in a fresh process."""

import gc
import os
import subprocess
import sys

import jax
import pytest

import eoi_jax

OPTION = "xla_cpu_small_while_loop_byte_threshold"
FUSIONS = "xla_cpu_use_fusion_emitters"
GIVEN = int(jax.__version_info__ < (0, 12))  # from then on XLA needs no option
old_jax = pytest.mark.skipif(not GIVEN, reason="from JAX 0.12 on no option is set")


def fresh(code, **environment):
    """Standard output of `code` in a new interpreter that fails on any other warning."""
    clean = {key: value for key, value in os.environ.items() if key != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env=clean | {"JAX_PLATFORMS": "cpu"} | environment,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def test_importing_prints_nothing_and_changes_no_setting():
    code = """
import os
import jax
before, flags = dict(jax.config.values), os.environ.get("XLA_FLAGS")
import eoi_jax
after = dict(jax.config.values)
assert before == {key: after[key] for key in before}, "jax.config"
assert os.environ.get("XLA_FLAGS") == flags, "XLA_FLAGS"
from eoi_jax.compiler.jax_private import backend_runs
assert not backend_runs(), "backend"
"""
    assert fresh(code) == ("", "")


def test_importing_leaves_heavy_modules_alone():
    code = """
import sys
import eoi_jax
heavy = ("matplotlib", "pandas", "diffrax", "optimistix", "h5py", "rich", "typer", "xarray", "zarr",
         "numba")
print([name for name in heavy if name in sys.modules])
"""
    assert fresh(code)[0].strip() == "[]"


def test_configure_sets_precision_and_whole_loops_before_the_backend_starts(tmp_path):
    code = f"""
import os, warnings
warnings.simplefilter("error")
import eoi_jax
eoi_jax.configure()
eoi_jax.configure()
assert os.environ.get("XLA_FLAGS", "").count("{OPTION}") == {GIVEN}, "once"
import jax, jax.numpy as jnp
print(jnp.ones(1).dtype, jax.config.jax_compilation_cache_dir)
"""
    shown, _ = fresh(code, EOI_CACHE=str(tmp_path))
    assert shown.split() == ["float64", str(tmp_path)]


def test_configure_lets_python_collect_garbage_less_often():
    usual, later = gc.get_threshold()[0], gc.get_threshold()[1:]
    try:
        for before, after in ((700, 50_000), (2000, 50_000), (80_000, 80_000), (0, 0)):
            gc.set_threshold(before, *later)
            eoi_jax.configure(cache=False)
            assert gc.get_threshold() == (after, *later)
    finally:
        gc.set_threshold(usual, *later)


def test_configure_keeps_flags_that_are_set_already():
    code = f"""
import os
import eoi_jax
eoi_jax.configure(float64=False, cache=False)
assert "--xla_force_host_platform_device_count=2" in os.environ["XLA_FLAGS"].split()
assert os.environ["XLA_FLAGS"].count("{OPTION}") == {GIVEN}
import jax, jax.numpy as jnp
print(jnp.ones(1).dtype, jax.device_count(), jax.config.jax_compilation_cache_dir)
"""
    shown, _ = fresh(code, XLA_FLAGS="--xla_force_host_platform_device_count=2")
    assert shown.split() == ["float32", "2", "None"]


def test_no_option_is_set_for_a_jax_that_does_not_know_it():
    """XLA would end the process: 0.11.1 has dropped the second one, 0.12 needs neither."""
    known = {
        (0, 11, 0): [OPTION, FUSIONS],
        (0, 11, 1): [OPTION],
        (0, 11, 2): [OPTION],
        (0, 12): [],
    }
    code = f"""
import os
import jax
import eoi_jax
for version in {list(known)}:
    jax.__version_info__ = version
    os.environ.pop("XLA_FLAGS", None)
    eoi_jax.configure(cache=False)
    print(os.environ.get("XLA_FLAGS", ""))
"""
    *shown, _ = fresh(code)[0].split("\n")
    for flags, options in zip(shown, known.values(), strict=True):
        assert [option for option in (OPTION, FUSIONS) if option in flags] == options


@old_jax
def test_an_option_that_is_set_already_stays():
    code = """
import os
import eoi_jax
eoi_jax.configure(cache=False)
print(os.environ["XLA_FLAGS"].count("fusion_emitters"))
"""
    assert fresh(code, XLA_FLAGS="--xla_cpu_use_fusion_emitters=true")[0].strip() == "1"


@old_jax
def test_configure_warns_when_the_backend_runs_already():
    code = """
import os, warnings
import jax.numpy as jnp
jnp.ones(1).block_until_ready()
import eoi_jax
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    eoi_jax.configure(cache=False)
(one,) = caught
assert one.category is RuntimeWarning
print(one.message)
assert "XLA_FLAGS" not in os.environ
assert jnp.ones(1).dtype == "float64"
"""
    shown, _ = fresh(code)
    assert "Call `eoi_jax.configure()` before using JAX" in shown


@pytest.mark.slow
@pytest.mark.long
def test_lanes_spread_over_devices_add_up_to_the_same():
    code = """
import numpy as np
import eoi_jax as eoi
eoi.configure(cache=False, devices=2)
import jax
from eoi_jax.estimation.engines import Scan
from eoi_jax.estimation.observers import SecondOrder, gains
assert len(jax.devices()) == 2
plant = eoi.plants.mass_spring_damper(true=True)
t = 4e-3 * np.arange(600)
record = eoi.simulate(plant, t, np.sin(3 * t) + np.sign(np.sin(t)))
for sets in (1, 2, 5, 70):
    given = gains(SecondOrder, {"c1": 60.0, "c2": 2e3, "c3": np.linspace(50.0, 90.0, sets)})
    one, two = (eoi.sweep(eoi.plants.mass_spring_damper(), record, given, eoi.LowPass(20.0),
                          passes=2, substeps=1, engine=Scan(devices=n)) for n in (1, 2))
    for name in one.data_vars:
        np.testing.assert_allclose(one[name], two[name], 1e-9, 1e-18, err_msg=f"{sets} {name}")
try:
    eoi.configure(devices=3)
except ValueError as error:
    print(error)
"""
    shown, _ = fresh(code)
    assert "must be asked for before JAX is used" in shown


def test_devices_are_at_least_one():
    code = """
import eoi_jax
try:
    eoi_jax.configure(devices=0)
except ValueError as error:
    print(error)
"""
    assert "`devices` must be an integer ≥ 1" in fresh(code)[0]


HOMELESS = """
import os, pathlib, warnings
import jax, eoi_jax as eoi
def homeless():
    raise RuntimeError("Could not determine home directory.")
known = pathlib.Path.home
for forget, home in {cases}:
    pathlib.Path.home = homeless if forget else known
    os.environ["HOME"] = home
    jax.config.update("jax_compilation_cache_dir", "/as/before")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        eoi.configure()
    print(jax.config.jax_compilation_cache_dir, *(one.message for one in caught))
"""


def test_without_a_home_nothing_is_kept_and_that_is_said():
    cases = {
        (True, "/nowhere"): "Could not determine home directory.",  # no HOME, no such user
        (False, "/proc/1"): "/proc/1/.cache",  # where nobody can make a folder
        (False, "/dev/null"): "Not a directory",
    }
    if not os.path.exists("/proc/1"):
        del cases[False, "/proc/1"]
    shown = fresh(HOMELESS.format(cases=list(cases)), EOI_CACHE="")[0].splitlines()
    for out, why in zip(shown, cases.values(), strict=True):
        assert out.startswith("None compiled code is not kept")
        assert why in out
        assert "Set EOI_CACHE to a folder of yours" in out
