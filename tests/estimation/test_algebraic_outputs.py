"""Passes over outputs that are functions of the states: injection, regressors, estimate."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from output_cases import (
    ACCELEROMETER,
    BATTERY,
    accelerometer,
    battery,
    battery_record,
    cell_states,
    current,
    mixed,
    shaken,
)

from eoi_jax import plants
from eoi_jax.compiler.graph import Untranslatable
from eoi_jax.data.record import Record
from eoi_jax.estimation.engines import Lanes, Native, OneKernel, Scan
from eoi_jax.estimation.engines.single import single_pass
from eoi_jax.estimation.identify import identify
from eoi_jax.estimation.kernel import run_pass
from eoi_jax.estimation.lowpass import LowPass
from eoi_jax.estimation.observers import FirstOrder, Measurement, PerOutput, SecondOrder
from eoi_jax.estimation.preparation import prepare_steps, step_inputs
from eoi_jax.estimation.sweep.sweep import sweep
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects import InputDelay
from eoi_jax.models.plant import Plant
from eoi_jax.models.storage import load

# So wide that what is filtered is what went in.
OPEN = LowPass(1e6, order=1)


def signals(plant, record, observer=None, lowpass=OPEN, substeps=1) -> Any:
    """Injection, weight and Φ of each step of one pass, and its steps."""
    observer = observer or Measurement()
    fine = record.resample(substeps)
    taps = len(np.atleast_2d(np.asarray(observer.kernel))[0])
    steps = prepare_steps(
        plant, [fine], [step_inputs(fine, False)], taps, 0.0, 0.0, [np.zeros(len(plant.outputs))],
        False, 0.0, substeps=substeps,
    )  # fmt: skip
    filters = jax.tree.map(
        lambda leaf: np.asarray(leaf)[None], lowpass.discretise(fine.sample_period)
    )
    theta = jnp.asarray(plant.theta)
    _, trace = run_pass(plant, observer, filters, steps, theta, store="signals")
    return jax.tree.map(lambda leaf: np.asarray(leaf)[0], trace), steps


# -- the injection and its instant ------------------------------------------------------------


def test_the_injection_is_the_output_minus_the_model_at_each_sample():
    """R0 10 % too small: y - h = -0.003 i[k], also where i has just jumped."""
    record = battery_record(noise=0.0)
    trace, _ = signals(battery(R0=0.9 * BATTERY["R0"]), record)
    amperes = current(1)
    assert np.count_nonzero(np.diff(amperes)) > 10
    want = -0.1 * BATTERY["R0"] * amperes[:-1]
    # The states are exact but for the rounding and the Runge-Kutta step of h/30 s.
    np.testing.assert_allclose(trace.injection[:, 0], want, atol=1e-7)
    np.testing.assert_array_equal(trace.weight, 1.0)


def test_an_input_that_jumps_is_not_averaged_over_the_jump():
    """The same record, its current said to be linear in between, misses the jumps by half."""
    record = battery_record(noise=0.0)
    ramp: Any = Record(
        record.time, record.inputs, record.outputs, hold="linear", input_names=("current",),
        output_names=("voltage",),
    )  # fmt: skip
    held, _ = signals(battery(), record)
    straight, _ = signals(battery(), ramp)
    assert np.max(np.abs(held.injection)) < 1e-7
    assert np.max(np.abs(straight.injection)) < 2e-2  # R0 i itself is right: only the states differ


def test_regressors_are_total_derivatives():
    record, step = battery_record(noise=0.0), 1e-6
    plant = battery(R0=0.02, R1=0.03, C1=1000.0, Q=7000.0)
    trace, _ = signals(plant, record)
    for i, (name, value) in enumerate(plant.parameters.items()):
        above, below = (
            signals(plant.with_parameters({name: value * (1.0 + sign * step)}), record)[0]
            for sign in (1.0, -1.0)
        )
        slope = (below.injection - above.injection)[:, 0] / (2.0 * step * value)
        size = np.max(np.abs(slope))
        assert size > 0
        np.testing.assert_allclose(trace.Phi[:, 0, i], slope, atol=1e-7 * size)


def test_known_states_give_the_least_squares_of_a_line():
    """R0 alone unknown: Δ = Σ φ (y - h)/Σ φ² with φ = -i, by hand."""
    record = battery_record(noise=1e-3)
    plant: Any = battery(R0=0.02)
    fixed: Any = plant.declared_anew(fixed=("R1", "C1", "Q"))
    result = identify(fixed, record, lowpass=OPEN, passes=3, transient=0.0)
    amperes = current(1)
    soc, v1 = cell_states(amperes).T
    error = (record.outputs[:, 0] - (3.4 + 0.7 * soc - 0.02 * amperes - v1))[:-1]
    want = 0.02 - amperes[:-1] @ error / (amperes[:-1] @ amperes[:-1])
    np.testing.assert_allclose(result.parameters["R0"], want, rtol=1e-6)


def test_a_static_curve_is_exact_in_one_pass():
    draw = np.random.default_rng(0)
    u = draw.uniform(-1.0, 1.0, 400)
    record = Record.from_period(0.1, u, 1.0 + 2.0 * u + 3.0 * u**2, hold="zero")

    def curve(t, x, u, p):
        return p.a + p.b * u[0] + p.c * u[0] ** 2

    plant: Any = Plant(curve, {"a": 0.0, "b": 0.0, "c": 0.0}, relative_degree=0)
    result = identify(plant, record)
    assert result.status.ok
    np.testing.assert_allclose(list(result.parameters.values()), [1.0, 2.0, 3.0], rtol=1e-11)
    assert result.index[1, 0] < 1e-25


def test_several_sensors_of_one_state_share_its_parameters():
    record = shaken(noise=0.0, outputs=("x", "acc"))
    record = Record(
        record.time, record.inputs, record.outputs, hold="linear", input_names=("base",),
        output_names=("place", "acc"),
    )  # fmt: skip

    def sensors(t, x, u, p):
        return jnp.stack([p.scale * x.z[0], (-p.b * x.z[1] - p.k * (x.z[0] - u[0])) / 3.0])

    plant: Any = Plant(
        sensors,
        {"b": 3.0, "k": 80.0, "scale": 0.8},
        relative_degree=0,
        inputs=("base",),
        outputs=("place", "acc"),
        internal=lambda t, x, u, p: jnp.stack(
            [x.z[1], (-p.b * x.z[1] - p.k * (x.z[0] - u[0])) / 3.0]
        ),
        internal_initial=(0.0, 0.0),
    )
    result = identify(plant, record)
    # The base is a sum of sines up to 15 rad/s, taken as linear over 10 ms: (0.15)²/12 of it.
    np.testing.assert_allclose(list(result.parameters.values()), [4.0, 100.0, 1.0], rtol=2e-3)


# -- the two cases ----------------------------------------------------------------------------


def test_a_cell_is_identified_from_its_terminal_voltage():
    start = battery(R0=0.02, R1=0.03, C1=1000.0, Q=7000.0)
    result = identify(start, battery_record())
    assert result.status.code == "converged"
    assert result.engine.name == "native"
    for name, value in BATTERY.items():
        error = abs(result.parameters[name] - value)
        assert error < 4.0 * result.standard_errors[name]
        assert error < 0.02 * value
    assert "as no output is differentiated" in result.reasons[0]
    assert not any("instrumental" in reason for reason in result.reasons)


def test_a_mass_is_identified_from_its_acceleration():
    result = identify(accelerometer(b=3.0, k=80.0), shaken())
    assert result.status.code == "converged"
    for name in ("b", "k"):
        error = abs(result.parameters[name] - ACCELEROMETER[name])
        assert error < 4.0 * result.standard_errors[name]
        assert error < 2e-3 * ACCELEROMETER[name]


@pytest.mark.parametrize("k", [80.0, 20.0])  # of 100: a start from which the modes look slow
def test_steps_follow_the_modes_of_the_states(k):
    """At 20 Hz and 5.8 rad/s: steps of a sample miss 0.4 % of the mode, 4 errors of b."""
    record = shaken(noise=0.02, period=0.05).with_hold("smooth")
    result = identify(accelerometer(b=3.0, k=k), record)
    for name in ("b", "k"):
        error = abs(result.parameters[name] - ACCELEROMETER[name])
        assert error < 3.0 * result.standard_errors[name]
    assert any("6 sub-steps a sample" in reason for reason in result.reasons)


@pytest.mark.parametrize(
    "observer", [None, PerOutput((SecondOrder(18.0, 170.0, 25.0), Measurement()))]
)
def test_degrees_may_be_mixed(observer):
    """Position (degree 2) and acceleration (0): the row of h reads the other output's state."""
    record = shaken(noise=0.0, outputs=("x", "acc"))
    result = identify(mixed(b=3.0, k=80.0, gain=0.8), record, observer)
    assert result.status.ok
    got = [result.parameters[name] for name in ("b", "k", "gain")]
    np.testing.assert_allclose(got, [4.0, 100.0, 1.0], rtol=1e-3)
    assert result.injection[0].shape == record.outputs.shape


def test_rates_of_other_outputs_are_taken_at_the_sample():
    """y2 = ẏ1 at the sample, not half a step later: an error of h²/6 of the third derivative."""

    def speed(t, x, u, p):
        return jnp.stack([p.a * u[0], x.y[1, 0]])

    errors = []
    for h in (0.02, 0.01):
        t = h * np.arange(round(8.0 / h))
        outputs = np.stack([np.sin(2.0 * t), 2.0 * np.cos(2.0 * t)], axis=1)
        record = Record(t, -4.0 * np.sin(2.0 * t), outputs, hold="linear",
                        input_names=("u",), output_names=("x", "v"))  # fmt: skip
        plant: Any = Plant(speed, {"a": 1.0}, relative_degree=(2, 0), outputs=("x", "v"))
        observer = PerOutput((SecondOrder(20.0, 100.0, 100.0), Measurement()))
        trace, steps = signals(plant, record, observer)
        scored = np.asarray(steps.use)[0, :, 1] > 0
        errors.append(np.max(np.abs(trace.injection[scored, 1])))
    assert np.log2(errors[0] / errors[1]) > 1.9
    assert errors[1] < 0.01**2 / 6.0 * 8.0 * 1.1


def test_only_samples_count_where_steps_are_finer():
    """Sub-steps interpolate y over a jump; they have no weight, and those that do are exact."""
    record = battery_record(noise=0.0)
    trace, steps = signals(battery(R0=0.02), record, substeps=4)
    use = np.asarray(steps.use)[0, :, 0]
    np.testing.assert_array_equal(use[: 4 * 1790 : 4], 4.0)
    assert np.count_nonzero(use) == len(record) - 1
    at_samples = trace.injection[::4, 0] / trace.weight[::4, 0]
    np.testing.assert_allclose(at_samples, -0.01 * current(1)[:-1], atol=1e-9)


def test_half_of_the_samples_is_half_of_the_information():
    record = battery_record()
    thin = np.array(record.outputs)
    thin[1::2] = np.nan
    half: Any = Record(
        record.time, record.inputs, thin, hold="zero", input_names=("current",),
        output_names=("voltage",),
    )  # fmt: skip
    full, _ = signals(battery(), record)
    less, _ = signals(battery(), half)
    square = np.sum(full.Phi**2, axis=0), np.sum(less.Phi**2, axis=0)
    np.testing.assert_allclose(square[1] / square[0], 0.5, rtol=0.02)


# -- engines, batches, files --------------------------------------------------------------------

CASES = {
    "cell": (battery, battery_record, Measurement()),
    "mass": (accelerometer, shaken, Measurement()),
    "mixed": (
        mixed,
        lambda: shaken(outputs=("x", "acc")),
        PerOutput((SecondOrder(18.0, 170.0, 25.0), Measurement())),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_all_engines_give_the_same_sums(name):
    build, record_of, observer = CASES[name]
    plant, record = build(), record_of()
    lowpass = LowPass(0.2 / record.sample_period)
    noise, taps = [np.zeros(len(plant.outputs))], len(np.atleast_2d(observer.kernel)[0])
    inputs = [step_inputs(record, False)]
    batch = prepare_steps(plant, [record], inputs, taps, 0.1, 0.1, noise, False, 0.02)
    steps = jax.tree.map(lambda leaf: leaf[0], batch)
    count = 5
    spread = np.linspace(0.9, 1.1, count)[:, None]
    gains = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], count, 0), observer)
    lanes = Lanes(gains, spread * plant.theta, 0.01 * spread * plant.theta,
                  np.ones((count, len(plant.outputs))))  # fmt: skip
    discrete = lowpass.discretise(record.sample_period)
    blocks = int(np.sum(steps.block_end))
    drawn = np.random.default_rng(0).integers(0, 3, (count, blocks)).astype(float)
    resampled = replace(lanes, emphasis=drawn)
    for some in (lanes, resampled):
        scan = Scan().run(plant, some, discrete, steps, "scores")
        engines = (Native(), OneKernel(tile=4)) if name == "cell" else (Native(),)
        for engine in engines:
            sums = engine.run(plant, some, discrete, steps, "scores")
            for one, other in zip(jax.tree.leaves(sums), jax.tree.leaves(scan), strict=True):
                np.testing.assert_allclose(one, other, rtol=0, atol=1e-10 * np.max(np.abs(other)))
    native = Native().run(plant, lanes, discrete, steps)
    filters = jax.tree.map(lambda leaf: np.asarray(leaf)[None], discrete)
    single = single_pass(plant, observer, filters, batch)
    assert single.used.name == "native"
    alone, _ = single(np.asarray(lanes.theta[0]), "signals")
    np.testing.assert_allclose(alone.information[0], native.information[0], rtol=1e-8)
    np.testing.assert_allclose(alone.square[0], native.square[0], rtol=1e-8)


def test_a_sweep_over_starts_needs_no_observer():
    starts = [{"R0": 0.02}, {"R0": 0.05, "R1": 0.01}]
    got = sweep(battery(), battery_record(), starts=starts)
    np.testing.assert_allclose(got.parameters.squeeze().to_numpy()[:, 0], BATTERY["R0"], rtol=0.01)


def test_an_estimate_is_saved_with_its_measurement(tmp_path):
    result = identify(battery(R0=0.02), battery_record(), passes=3)
    result.save(tmp_path / "cell.npz")
    again: Any = load(tmp_path / "cell.npz", plant=battery())
    assert isinstance(again.observer, Measurement)
    assert again.parameters == result.parameters
    assert "voltage" in str(again)


def test_one_kernel_says_that_it_does_not_run_such_a_plant_behind_an_actuator():
    late = augmented(battery(), [place(battery(), InputDelay(), 0)], {"input_delay": 1.0})
    record, observer = battery_record(samples=120), Measurement()
    batch = prepare_steps(
        late, [record], [step_inputs(record, False)], 1, 0.0, 0.1, [np.zeros(1)], False, 0.0
    )
    lanes = Lanes(observer, np.asarray(late.theta)[None], np.zeros((1, 5)), np.ones((1, 1)))
    steps = jax.tree.map(lambda leaf: leaf[0], batch)
    with pytest.raises(Untranslatable, match="relative degree 0 with inputs behind an actuator"):
        OneKernel(tile=1).run(late, lanes, LowPass(0.5).discretise(1.0), steps)
    assert Scan().run(late, lanes, LowPass(0.5).discretise(1.0), steps).count[0, 0] == 119


# -- what is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("plant", "observer", "message"),
    [
        (
            battery(),
            FirstOrder(3.0),
            (
                "`observer` must be left out for voltage, a function of the states .relative "
                "degree 0., which takes none, got FirstOrder"
            ),
        ),
        (
            mixed(),
            PerOutput((SecondOrder(1.0, 1.0, 1.0), FirstOrder(1.0))),
            "`observer` must be left out for acc, .* Put `Measurement..` in its place",
        ),
        (plants.level_tank(), Measurement(), "`observer` must have the relative degree"),
    ],
)
def test_an_output_of_degree_zero_takes_no_observer(plant, observer, message):
    record = shaken(outputs=("x", "acc")) if len(plant.outputs) == 2 else battery_record()
    if plant.name not in ("battery", "mixed"):
        record = Record.from_period(0.1, np.ones(200), np.linspace(0.1, 0.2, 200))
    with pytest.raises(ValueError, match=message):
        identify(plant, record, observer)


def test_such_an_output_is_not_smoothed():
    with pytest.raises(ValueError, match="`smoothing` must be False where an output is a function"):
        identify(battery(), battery_record(), smoothing=0.5)


def test_instrumental_variables_say_why_they_do_not_follow():
    result = identify(battery(R0=0.02), battery_record(), instruments=True)
    assert any("no instrumental variables: an output of relative" in r for r in result.reasons)
