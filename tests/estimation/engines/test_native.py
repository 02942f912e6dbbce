"""The compiled engine: the sums of the scan, for every observer and plant, whatever the lanes."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from problems import LEVEL, SWAY, grid

from eoi_jax import plants
from eoi_jax.compiler import jit, llvm, loop, runtime
from eoi_jax.compiler.graph import Untranslatable, topological_order
from eoi_jax.data.record import Record
from eoi_jax.estimation.engines import Lanes, Native, Scan, native
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import (
    FirstOrder,
    HighOrder,
    PerOutput,
    SecondOrder,
    SuperTwisting,
)
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.models.library import Plant

SAMPLES, PERIOD = 300, 5e-3
PENDULUM = plants.pendulum()
RELAY = SecondOrder(20.0, 100.0, 500.0)


def steps_of(plant, observer, samples=SAMPLES, hole=slice(150, 156)) -> Any:
    """One record with a gap, its motion prescribed: what moved it does not matter here."""
    t = grid(samples, PERIOD)
    motion = LEVEL if plant.relative_degree == 1 else SWAY
    y = np.stack([motion(t + 0.3 * j) for j in range(len(plant.outputs))], 1)
    u = np.stack([np.sin(3.0 * t + j) for j in range(len(plant.inputs))], 1)
    use = np.ones(samples, bool)
    use[hole] = False
    record = Record.from_period(PERIOD, u, np.where(use[:, None], y, np.nan))
    explicit = observer.scheme == "explicit"
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    noise = [np.zeros(len(plant.outputs))]
    inputs = [step_inputs(record, explicit)]
    batch = prepare_steps(plant, [record], inputs, taps, 0.1, 0.1, noise, explicit, 0.02)
    return jax.tree.map(lambda leaf: leaf[0], batch)


def lanes_of(plant, observer, count, dtype: Any = np.float64, blocks=0) -> Any:
    """Gains and θ spread around those given; with blocks, each lane has drawn its own."""
    spread = np.linspace(0.8, 1.3, count)
    gains = jax.tree.map(
        lambda leaf: np.multiply.outer(spread, np.asarray(leaf)).astype(dtype), observer
    )
    theta = np.linspace(0.9, 1.1, count)[:, None] * plant.theta
    drawn = np.random.default_rng(0).integers(0, 3, (count, blocks)) if blocks else None
    return Lanes(
        gains,
        theta.astype(dtype),
        (0.01 * theta).astype(dtype),
        np.linspace(1.0, 2.0, count)[:, None].repeat(len(plant.outputs), 1).astype(dtype),
        None if drawn is None else drawn.astype(dtype),
    )


LOWPASS = LowPass(40.0).discretise(PERIOD)


def close(one, other, rtol=1e-11, skip=()):
    """Sums agree; the largest of each kind bounds its rounding."""
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(one), jax.tree.leaves(other), strict=True
    ):
        assert a.shape == b.shape
        assert a.dtype == b.dtype
        size = np.max(np.abs(b), initial=1e-300)
        np.testing.assert_allclose(a, b, rtol=0, atol=rtol * size, err_msg=path[0].name)


@pytest.fixture(scope="module")
def swinging() -> Any:
    return steps_of(PENDULUM, RELAY)


# -- the scan's sums --------------------------------------------------------------------------

CASES = {
    "pendulum": (PENDULUM, RELAY),
    "pendulum, explicit": (PENDULUM, SecondOrder(20.0, 100.0, 500.0, "explicit")),
    "level": (plants.level_tank(), FirstOrder(200.0)),
    "level, explicit": (plants.level_tank(), FirstOrder(200.0, scheme="explicit")),
    "tanks": (plants.cascaded_tanks(), FirstOrder(200.0)),
    "masses": (plants.three_mass_spring_damper(), RELAY),
    "mass": (plants.mass_spring_damper(), SuperTwisting(500.0)),
    "spring": (plants.duffing_oscillator(), SuperTwisting(500.0, scheme="explicit")),
    "axis": (plants.positioning_system(), HighOrder(500.0, 2)),
    "arm": (plants.propeller_arm(), PerOutput((RELAY,))),
}


@pytest.mark.parametrize("name", list(CASES))
def test_sums_are_those_of_the_scan(name):
    """With a gap, scores and emphasis: all that can be asked of a pass at once."""
    plant, observer = CASES[name]
    steps = steps_of(plant, observer)
    lanes = lanes_of(plant, observer, 5, blocks=int(np.sum(steps.block_end)))
    one = Native().run(plant, lanes, LOWPASS, steps, "scores")
    assert np.all(np.asarray(one.square) > 0)
    assert np.all(np.abs(one.meat).max(axis=(1, 2)) > 0)
    close(one, Scan().run(plant, lanes, LOWPASS, steps, "scores"))


@pytest.mark.parametrize("count", [1, 7, 64, 65])
def test_any_number_of_lanes_and_threads(count, swinging):
    """Each lane by itself: bit by bit what it is among a thousand."""
    lanes = lanes_of(PENDULUM, RELAY, 1000)
    many = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    for threads in (1, 2, 5):
        few = Native(threads).run(PENDULUM, lanes[:count], LOWPASS, swinging)
        for one, whole in zip(jax.tree.leaves(few), jax.tree.leaves(many), strict=True):
            np.testing.assert_array_equal(one, whole[:count])


def test_a_thousand_lanes_are_those_of_the_scan(swinging):
    lanes = lanes_of(PENDULUM, RELAY, 1000)
    some = np.array([0, 1, 500, 999])
    whole = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    scan = Scan().run(PENDULUM, lanes[some], LOWPASS, swinging)
    close(jax.tree.map(lambda leaf: leaf[some], whole), scan)


def test_single_precision(swinging):
    """Rounding of 2⁻²⁴ in y, over h² = 2.5e-5: 2e-3 of an injection of order one."""
    lanes = lanes_of(PENDULUM, RELAY, 3, np.float32)
    one = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    double = Native().run(PENDULUM, lanes_of(PENDULUM, RELAY, 3), LOWPASS, swinging)
    assert one.rhs.dtype == np.float32
    np.testing.assert_allclose(one.information, double.information, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(one.square, double.square, rtol=2e-3)
    with jax.enable_x64(False):
        scan = Scan().run(PENDULUM, lanes, LOWPASS, swinging)
    np.testing.assert_allclose(one.square, scan.square, rtol=2e-3)


def test_a_record_in_pieces(swinging, monkeypatch):
    lanes = lanes_of(PENDULUM, RELAY, 3)
    whole = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    in_pieces = functools.partialmethod(runtime.Run.advance, chunk_size=2000)
    monkeypatch.setattr(runtime.Run, "advance", in_pieces)
    close(Native().run(PENDULUM, lanes, LOWPASS, swinging), whole)


# -- lanes that fail --------------------------------------------------------------------------


@pytest.mark.parametrize("spoil", ["gain", "theta"])
def test_a_bad_lane_leaves_the_others_alone(spoil, swinging):
    lanes = lanes_of(PENDULUM, RELAY, 40)
    good = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    leaf = lanes.observer.c3 if spoil == "gain" else lanes.theta
    leaf[7] = np.nan
    bad = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    others = np.arange(40) != 7
    for one, other in zip(jax.tree.leaves(bad), jax.tree.leaves(good), strict=True):
        np.testing.assert_array_equal(one[others], other[others])
    assert np.all(np.isnan(bad.square[7]))


def test_a_diverged_lane_shows_that_it_is(swinging):
    """An explicit observer with a huge gain overflows; in the scan its sums are no numbers."""
    wild = SecondOrder(20.0, 100.0, 500.0, "explicit")
    lanes = lanes_of(PENDULUM, wild, 4)
    lanes.observer.c2[2] = 1e9
    steps = steps_of(PENDULUM, wild)
    one, scan = (engine.run(PENDULUM, lanes, LOWPASS, steps) for engine in (Native(), Scan()))
    np.testing.assert_array_equal(np.isfinite(one.square), np.isfinite(scan.square))
    assert not np.isfinite(one.square[2, 0])
    close(*(jax.tree.map(lambda leaf: leaf[:2], sums) for sums in (one, scan)))


# -- what is computed, and how often ----------------------------------------------------------


def program_of(plant, observer, steps, store="nothing"):
    lanes = lanes_of(plant, observer, 1)
    what, _ = native.pass_of(plant, lanes, LOWPASS, steps, store)
    return loop.lane_program(what)


def each_lane_and_step(program):
    nodes = topological_order(program.common.vectors)
    return [node.op for node in nodes if program.level(node) == loop.LANE_ROW and node.args]


def test_what_the_record_decides_is_computed_once_for_all_lanes(swinging):
    program = program_of(PENDULUM, RELAY, swinging)
    lanes = each_lane_and_step(program)
    shared = [node.op for node in topological_order(program.general.scalars)]
    assert "sin" in shared
    assert "sin" not in lanes
    assert "div" not in lanes
    # Two filter states of two columns of φ; three columns of the rest less the weight: 8 of 14.
    # Of the normal equations 4·5/2 + 4 sums, less three of the record's own; three more sums.
    # The observer's three, and the three that the average remembers.
    assert len(program.lane_carries) == 8 + 11 + 3 + 3 + 3
    assert len(lanes) < 130  # before products and sums are contracted; C takes no fewer


def test_sums_that_are_equal_are_added_once(swinging):
    program = program_of(PENDULUM, RELAY, swinging)
    same = np.array(program.representatives)[program.result.information[0]]
    np.testing.assert_array_equal(same, same.T)


def test_what_stays_is_not_computed():
    """Masses in a row: the parameters of one are not in the equations of another."""
    plant = plants.three_mass_spring_damper()
    program = program_of(plant, RELAY, steps_of(plant, RELAY))
    information = program.result.information
    kept = {program.representatives[i] for i in information.ravel()} & {
        *program.lane_carries,
        *program.shared_carries,
    }
    assert len(kept) == 4 * 5 // 2 + 4 * 5 // 2 + 3 * 4 // 2


def test_one_compilation_for_all_lanes_and_lengths(monkeypatch):
    def dynamics(t, x, u, p):
        return -p.k * jnp.tanh(x.y[0]) - p.d * x.y[1] + u

    compiled, original = [], jit._compile
    monkeypatch.setattr(jit, "_compile", lambda *a: compiled.append(1) or original(*a))
    plant = Plant(dynamics, {"k": 5.0, "d": 0.4}, 2)
    for count, samples in ((3, 200), (40, 200), (3, 321)):
        steps = steps_of(plant, RELAY, samples)
        Native().run(plant, lanes_of(plant, RELAY, count), LOWPASS, steps)
        changed = plant.with_parameters({"k": 7.0})
        Native().run(changed, lanes_of(changed, RELAY, count), LOWPASS, steps)
    assert len(compiled) == 1


def test_code_is_kept_on_disk(tmp_path, monkeypatch, swinging):
    lanes = lanes_of(PENDULUM, RELAY, 3)
    before = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    runtime.compiled_loop.cache_clear()
    jit.machine_code.cache_clear()
    Native().run(PENDULUM, lanes, LOWPASS, swinging)
    assert len(list((tmp_path / "native").iterdir())) == 1
    runtime.compiled_loop.cache_clear()
    jit.machine_code.cache_clear()
    monkeypatch.setattr(jit, "_compile", lambda *a: pytest.fail("compiled again"))
    again = Native().run(PENDULUM, lanes, LOWPASS, swinging)
    close(again, before, rtol=0)


def test_a_folder_that_cannot_be_written_is_no_obstacle(tmp_path, swinging):
    (tmp_path / "native").write_text("a file where the folder should be")
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    runtime.compiled_loop.cache_clear()
    jit.machine_code.cache_clear()
    with pytest.warns(RuntimeWarning, match="cannot be made"):
        Native().run(PENDULUM, lanes_of(PENDULUM, RELAY, 2), LOWPASS, swinging)


# -- what it cannot do ------------------------------------------------------------------------


def settled(t, x, u, p):
    def going(v):
        return v[0] > 1.0

    return jax.lax.while_loop(going, lambda v: 0.5 * v, p.k * x.y[0] + u)


def late(t, u, p):
    return u * p.k


REFUSED = {
    "while": Plant(settled, {"k": 1.0}, 1),
    "behind an actuator": Plant(lambda t, x, u, p: u, {"k": 1.0}, 1, actuator=late),
}


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_is_not_supported_has_a_name(name):
    plant, observer = REFUSED[name], FirstOrder(200.0)
    steps, lanes = steps_of(plants.level_tank(), observer), lanes_of(plant, observer, 2)
    assert name in (Native().supports(plant, lanes, LOWPASS, steps) or "")
    with pytest.raises(Untranslatable, match=name):
        Native().run(plant, lanes, LOWPASS, steps)


def test_a_function_that_the_machine_lacks_has_a_name(monkeypatch):
    missing = {**llvm.LIBRARY, "tanh": "no_such_tanh"}
    monkeypatch.setattr(llvm, "LIBRARY", missing)
    plant = Plant(lambda t, x, u, p: u - p.k * jnp.tanh(x.y[0] / 3.0), {"k": 1.0}, 1)
    steps, observer = steps_of(plants.level_tank(), FirstOrder(200.0)), FirstOrder(200.0)
    reason = Native().supports(plant, lanes_of(plant, observer, 2), LOWPASS, steps)
    assert "no_such_tanh" in (reason or "")


def test_what_it_supports_it_says(swinging):
    lanes = lanes_of(PENDULUM, RELAY, 1)
    assert Native().supports(PENDULUM, lanes, LOWPASS, swinging, "scores") is None
