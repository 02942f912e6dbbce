"""Whatever goes wrong on the way to machine code, the scan runs, and the result says why."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax._status import NATIVE, EngineUsed
from eoi_jax.compiler import jit, llvm, runtime, trace
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.compiler.jit import cached_translation


def oscillator(t, x, u, p):
    position, rate = x.y
    return -p.a * position - p.b * rate + u


@pytest.fixture
def case():
    """A plant that no other test has compiled, and a record of it."""

    def dynamics(t, x, u, p):
        return oscillator(t, x, u, p)

    plant = eoi.Plant(dynamics, {"a": 20.0, "b": 1.0}, relative_degree=2)
    time = 0.01 * np.arange(800)
    record = eoi.simulate(plant, time, np.sign(np.sin(3 * time)))
    return plant.with_parameters({"a": 25.0, "b": 1.5}), record


@pytest.fixture
def nothing_kept():
    """What other tests have translated is forgotten, and what this one fails to is not kept."""
    caches = runtime.compiled_loop, runtime.cached_program
    for one in caches:
        one.cache_clear()
    yield
    for one in caches:
        one.cache_clear()


def renamed(*_):
    raise KeyError("num_consts")


def unwilling(*_):
    raise RuntimeError("LLVM: cannot select\nmore of it")


FAULTS = {
    "a parameter of an equation is renamed": (trace, "_equation", renamed),
    "LLVM fails": (jit, "_compile", unwilling),
    "the code cannot be loaded": (runtime, "machine_code", unwilling),
    "LLVM is missing": (llvm, "_llvm", None),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_any_failure_of_the_translation_falls_back_to_the_scan(
    fault, case, nothing_kept, monkeypatch
):
    plant, record = case
    wanted = eoi.identify(plant, record), eoi.refine(plant, record)
    assert {one.engine for one in wanted} == {NATIVE}
    for one in (runtime.compiled_loop, runtime.cached_program):
        one.cache_clear()
    jit.machine_code.cache_clear()
    monkeypatch.setattr(*FAULTS[fault])
    monkeypatch.setattr(llvm, "_FAULT", "LLVM cannot be loaded: ImportError: no library")
    found = eoi.identify(plant, record), eoi.refine(plant, record)
    for one, other in zip(found, wanted, strict=True):
        assert one.engine.name == "scan"
        assert ("LLVM cannot be loaded" if "missing" in fault else "translation failed") in (
            one.engine.reason
        )
        assert one.engine.reason in str(one)
        assert one.engine.reason not in str(other)
        np.testing.assert_allclose(
            list(one.parameters.values()), list(other.parameters.values()), 1e-6
        )
    assert "more of it" not in str(found[0])


def test_a_sweep_says_which_engine_ran(case, nothing_kept, monkeypatch):
    plant, record = case
    observers = eoi.observers.gains(
        eoi.observers.SecondOrder, {"c1": 50.0, "c2": 60.0, "c3": np.array([300.0, 900.0])}
    )
    fast = eoi.sweep(plant, record, observers, eoi.LowPass(20.0))
    assert (fast.attrs["engine"], fast.attrs["engine_reason"]) == ("native", "")
    for one in (runtime.compiled_loop, runtime.cached_program):
        one.cache_clear()
    monkeypatch.setattr(trace, "_equation", renamed)
    slow = eoi.sweep(plant, record, observers, eoi.LowPass(20.0))
    assert slow.attrs["engine"] == "scan"
    assert "KeyError" in slow.attrs["engine_reason"]
    np.testing.assert_allclose(slow["parameters"], fast["parameters"], 1e-6)
    asked = eoi.sweep(plant, record, observers, eoi.LowPass(20.0), engine=eoi.engines.Scan(tile=8))
    assert (asked.attrs["engine"], asked.attrs["engine_reason"]) == ("scan", "")


def test_a_model_beyond_arithmetic_runs_on_the_scan_and_says_so():
    def solved(t, x, u, p):
        matrix = jnp.array([[2.0, 0.5], [0.5, 1.0]]) + p.a * jnp.eye(2)
        return jnp.linalg.pinv(matrix)[:1] @ jnp.array([u[0], -x.y[0, 0]])

    plant = eoi.Plant(solved, {"a": 0.3})
    time = 0.02 * np.arange(400)
    record = eoi.simulate(plant, time, np.sin(time))
    found = eoi.identify(plant.with_parameters({"a": 0.4}), record)
    assert found.engine.name == "scan"
    assert found.engine.reason in str(found)
    np.testing.assert_allclose(found.parameters["a"], 0.3, 1e-3)


def test_a_failure_is_kept_like_a_result():
    calls = []

    @cached_translation
    def half(number):
        calls.append(number)
        if number % 2:
            raise Untranslatable("odd")
        return number // 2

    assert [half(4), half(4)] == [2, 2]
    for _ in range(3):
        with pytest.raises(Untranslatable, match=r"^odd$"):
            half(3)
    assert calls == [4, 3]


def test_a_warning_that_is_an_error_is_no_failure_of_the_translation():
    @cached_translation
    def translate(number):
        warnings.warn(f"folder {number}", UserWarning, stacklevel=2)
        return number

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="folder 3"):
            translate(3)
    with pytest.warns(UserWarning, match="folder 3"):
        assert translate(3) == 3  # nothing was kept


def test_an_engine_is_told_only_where_it_is_slow():
    assert NATIVE.notes == ()
    assert EngineUsed("scan").notes == ()
    (line,) = EngineUsed("scan", "the operation qr").notes
    assert "with the same numbers" in line
    assert "scan" in line
    assert "the operation qr" in line
