"""The estimator sample by sample: the pass and the recursion of whole records, in C, its alarm."""

import ctypes
import re
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import eoi_jax as eoi
from eoi_jax.estimation.online_export import estimator_text
from eoi_jax.models.augmented import augmented, place
from eoi_jax.models.effects.effect import AbstractActuator
from eoi_jax.models.sampled_states import SampledStates

H = 0.01
SAMPLES = 1200


def oscillator(t, x, u, p):
    return [p.g * u[0] - p.c * x.y[1, 0] - p.k * x.y[0, 0]]


def with_friction(t, x, u, p):
    return [u[0] - p.c * jnp.sign(x.y[1, 0]) - p.k * x.y[0, 0]]


def heated(t, x, u, p):
    """A temperature beside a store that is not measured."""
    return [p.k * u[0] - p.a * (x.y[0, 0] - x.z[0])]


def store(t, x, u, p):
    return [p.b * (x.y[0, 0] - x.z[0])]


def two_masses(t, x, u, p):
    (q1, q2), (v1, v2) = x.y
    spring = p.k * (q1 - q2) + p.c * (v1 - v2)
    return [u[0] - spring, p.m * spring - jnp.sin(q2)]


def cell(t, x, u, p):
    """A voltage over that without current: a function of the current and of a state."""
    return [-p.r * u[0] - x.z[0]]


def high_cell(t, x, u, p):
    """The same as it is measured: it hardly varies around a large value."""
    return [3.6 - p.r * u[0] - x.z[0]]


def relaxing(t, x, u, p):
    return [p.a * (p.d * u[0] - x.z[0])]


def make(name):
    """A plant with nominal parameters, and an observer."""
    second = eoi.observers.SecondOrder(5.0, 20.0, 10.0)
    made = {
        "oscillator": (oscillator, {"g": 1.2, "c": 0.3, "k": 5.0}, 2, second, {}),
        "friction": (with_friction, {"c": 0.2, "k": 5.0}, 2,
                     eoi.observers.SuperTwisting(6.0, 20.0), {}),
        "heated": (heated, {"k": 1.0, "a": 0.5}, 1, eoi.observers.FirstOrder(8.0, 1.0),
                   {"internal": store, "internal_initial": [0.0]}),
        "two_masses": (two_masses, {"k": 8.0, "c": 0.2, "m": 0.7}, (2, 2), second, {}),
        "cell": (cell, {"r": 0.05, "a": 1.0, "d": 0.02}, 0, eoi.observers.Measurement(),
                 {"internal": relaxing, "internal_initial": [0.0]}),
    }  # fmt: skip
    made["high_cell"] = (high_cell, *made["cell"][1:])
    f, values, degree, observer, options = made[name]
    outputs = ("q1", "q2") if name == "two_masses" else ("y",)
    if name == "heated":
        values |= {"b": 0.3}
    plant = eoi.Plant(f, values, degree, inputs=("u",), outputs=outputs, name=name, **options)
    return plant, observer


PLANTS = ("oscillator", "friction", "heated", "two_masses", "cell")


def recorded(plant, scale=1.1, noise=1e-4, seed=0):
    time = H * np.arange(SAMPLES)
    u = eoi.excitation.random_steps(time, -1.0, 1.0, 0.4, seed=seed)
    truth = plant.with_parameters({name: scale * v for name, v in plant.parameters.items()})
    record = eoi.simulate(truth, time, u, hold="zero")
    draw = np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return record.with_outputs(record.outputs + noise * draw, "run")


def estimator_of(name, **options):
    plant, observer = make(name)
    lowpass = eoi.LowPass(8.0, plant.relative_degree + 1)
    return eoi.OnlineEstimator(plant, observer, lowpass, H, noise=1e-4, **options), lowpass


@jax.jit
def run(estimator, y, u):
    def body(state, sample):
        return estimator.step(state, *sample)

    return jax.lax.scan(body, estimator.init(), (y, u))[1]


def ours(estimator, record):
    return of_samples(estimator, record.outputs, record.inputs)


def of_samples(estimator, y, u):
    return jax.tree.map(np.asarray, run(estimator, y, u))


@pytest.mark.parametrize("name", [name for name in PLANTS if name != "friction"])
def test_it_is_the_pass_and_the_recursion_of_a_whole_record(name):
    estimator, lowpass = estimator_of(name, transient=2.0)
    plant, observer = make(name)
    record = recorded(plant)
    online = ours(estimator, record)
    p = eoi.observe(
        plant, observer, None, H, record.outputs, record.inputs, lowpass=lowpass, noise=1e-4,
        transient=2.0,
    )  # fmt: skip
    size = np.max(np.abs(p.injection))
    np.testing.assert_allclose(online.injection[1:], p.injection, atol=1e-12 * size)
    history, _ = eoi.recursive(p.regressors, p.injection, p.score)
    # From few samples parameters are sums of numbers that cancel.
    known = plant.theta + history[400:]
    np.testing.assert_allclose(online.parameters[401:], known, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("forgetting", [1.0, 0.995])
def test_its_scan_is_the_recursion_of_identify(forgetting):
    """Parameters over time at the estimate, in one traced pass over the record."""
    plant, observer = make("oscillator")
    record, lowpass = recorded(plant), eoi.LowPass(8.0, 3)
    fit = eoi.identify(
        plant, record, observer, lowpass, recursive=True, forgetting=forgetting, transient=2.0,
        substeps=1, smoothing=False, instruments=False,
    )  # fmt: skip
    estimator = eoi.OnlineEstimator(
        fit.plant, observer, lowpass, H, forgetting=forgetting, transient=2.0
    )
    assert fit.history is not None
    online = ours(estimator, record).parameters[400:]
    np.testing.assert_allclose(online, fit.history.values[0][400:], rtol=1e-9)


def test_fixed_parameters_stay_and_the_others_are_those_without_their_columns():
    plant, observer = make("oscillator")
    record, lowpass = recorded(plant, scale=1.0), eoi.LowPass(8.0, 3)
    fixed = plant.with_parameters({"c": 0.5, "k": 4.0}).declared_anew(fixed=("g",))
    estimator = eoi.OnlineEstimator(fixed, observer, lowpass, H, transient=2.0)
    last = ours(estimator, record).parameters[-1]
    p = eoi.observe(fixed, observer, None, H, record.outputs, record.inputs, lowpass=lowpass,
                    transient=2.0)  # fmt: skip
    history, _ = eoi.recursive(p.regressors[..., 1:], p.injection, p.score)
    np.testing.assert_allclose(last, [1.2, *(fixed.theta[1:] + history[-1])], rtol=1e-12)
    np.testing.assert_allclose(last, plant.theta, rtol=3e-3)


def test_it_converges_to_the_parameters_of_a_plant_with_dry_friction():
    estimator, _ = estimator_of("friction", transient=2.0)
    plant, _ = make("friction")
    last = ours(estimator, recorded(plant)).parameters[-1]
    np.testing.assert_allclose(last, [1.1 * 0.2, 1.1 * 5.0], rtol=0.005)


# -- delays and lags of inputs ------------------------------------------------------------------

DELAY, LAG, RATE = eoi.effects.InputDelay(), eoi.effects.ActuatorLag(), eoi.effects.InputRate()
ACTED = {
    "delay": ("oscillator", {DELAY: [0.0537]}),
    "delay of less than a sample": ("oscillator", {DELAY: [0.0037]}),
    "lag": ("oscillator", {LAG: [0.083]}),
    "rate": ("oscillator", {RATE: [0.02, 0.06]}),
    "lag and delay": ("heated", {LAG: [0.083], DELAY: [0.0537]}),
    "delay and lag": ("two_masses", {DELAY: [0.0537], LAG: [0.083]}),
    "a voltage behind a delay": ("cell", {DELAY: [0.0537]}),
    "a voltage behind a lag": ("cell", {LAG: [0.083]}),
    "a voltage behind both": ("cell", {DELAY: [0.0537], LAG: [0.083]}),
}


def acted(case):
    """A plant with actuators, its observer, and a record of one with other parameters."""
    name, chain = ACTED[case]
    plant, observer = make(name)
    for effect, shapes in chain.items():
        placed = place(plant, effect, 0)
        plant = augmented(plant, [placed], dict(zip(placed.names, shapes, strict=True)))
    return plant, observer, recorded(plant, scale=1.05)


@pytest.mark.parametrize(
    ("case", "hold"),
    [*((case, "zero") for case in ACTED), ("lag and delay", "linear"),
     ("a voltage behind both", "linear")],
)  # fmt: skip
def test_behind_delays_and_lags_it_is_the_pass_and_the_recursion(case, hold):
    """With their regressors, so that the recursion follows them too."""
    plant, observer, record = acted(case)
    lowpass = eoi.LowPass(8.0, plant.relative_degree + 1)
    estimator = eoi.OnlineEstimator(plant, observer, lowpass, H, transient=2.0, hold=hold)
    online = ours(estimator, record)
    p = eoi.observe(plant, observer, None, H, record.outputs, record.inputs, lowpass=lowpass,
                    transient=2.0, hold=hold)  # fmt: skip
    size = np.max(np.abs(p.injection))
    np.testing.assert_allclose(online.injection[1:], p.injection, atol=1e-12 * size)
    known = plant.theta + eoi.recursive(p.regressors, p.injection, p.score)[0]
    np.testing.assert_allclose(online.parameters[401:], known[400:], rtol=1e-7, atol=1e-9)


# -- inputs with a hold each ---------------------------------------------------------------------

SWITCHED = {"valve": "zero", "weather": "linear"}


def kept(t, x, u, p):
    """A temperature between a heater and the weather."""
    return [p.k * u[0] + p.a * (u[1] - x.y[0, 0])]


def sensed(t, x, u, p):
    """A voltage that takes part in both inputs at once."""
    return [p.a * u[1] - p.k * u[0] - x.z[0]]


def with_two_inputs(algebraic=False):
    """A plant with delays of both inputs, its observer, and a record of one beside it."""
    names = {"inputs": ("valve", "weather"), "outputs": ("y",)}
    if algebraic:
        plant = eoi.Plant(sensed, {"k": 0.5, "a": 0.3, "b": 1.0}, 0, name="sensed", **names,
                          internal=lambda t, x, u, p: [p.b * (u[0] - x.z[0])],
                          internal_initial=[0.0])  # fmt: skip
        observer = eoi.observers.Measurement()
    else:
        plant = eoi.Plant(kept, {"k": 2.0, "a": 0.8}, 1, name="kept", **names)
        observer = eoi.observers.FirstOrder(8.0, 1.0)
    for channel, shapes in enumerate(([0.0537], [0.0213])):
        placed = place(plant, DELAY, channel)
        plant = augmented(plant, [placed], dict(zip(placed.names, shapes, strict=True)))
    time = H * np.arange(SAMPLES)
    valve = eoi.excitation.random_steps(time, -1.0, 1.0, 0.1, seed=1)
    weather = eoi.excitation.multisine(time, 1.0, (0.2, 4.0), 20, seed=2)
    record = eoi.simulate(plant, time, np.c_[valve, weather], hold=SWITCHED)
    return plant, observer, record


@pytest.mark.parametrize("algebraic", [False, True])
def test_inputs_with_a_hold_each_are_those_of_the_pass_and_of_the_file(algebraic, tmp_path):
    plant, observer, record = with_two_inputs(algebraic)
    lowpass = eoi.LowPass(8.0, plant.relative_degree + 1)
    estimator = eoi.OnlineEstimator(plant, observer, lowpass, H, transient=2.0, hold=SWITCHED)
    online = ours(estimator, record)
    p = eoi.observe(plant, observer, None, H, record.outputs, record.inputs, lowpass=lowpass,
                    transient=2.0, hold=SWITCHED)  # fmt: skip
    size = np.max(np.abs(record.outputs))
    np.testing.assert_allclose(online.injection[1:], p.injection, atol=1e-11 * size)
    known = plant.theta + eoi.recursive(p.regressors, p.injection, p.score)[0]
    np.testing.assert_allclose(online.parameters[401:], known[400:], rtol=1e-6, atol=1e-8)
    theirs = Exported(estimator, tmp_path, "double").run(record.outputs, record.inputs)
    np.testing.assert_allclose(
        theirs[400:, : len(plant.names)], online.parameters[400:], rtol=1e-10
    )
    assert "inputs zero for valve, linear for weather between samples" in str(estimator)


def test_an_input_that_is_held_acts_at_once_beside_one_that_goes_on():
    """Taken as linear, the valve would seem late by half a sample more: 58.7 ms."""
    plant, _, record = with_two_inputs()
    started = plant.with_parameters({"k": 2.1, plant.names[-2]: 0.0512})
    estimator = eoi.online_estimator(
        eoi.identify(started, record, instruments=False), record, false_alarms=None
    )
    assert estimator.hold == ("zero", "linear")
    parameters = ours(estimator, record).parameters[-1]
    np.testing.assert_allclose(parameters, plant.theta, rtol=2e-3, atol=2e-4)


def test_it_finds_a_delay_that_is_not_fixed_and_leaves_one_that_is():
    plant, observer, _ = acted("delay")
    record = recorded(plant, scale=1.0)
    guess = {"input_delay": 0.0512, "k": 4.9}
    for fixed in (("input_delay",), ()):
        started = plant.with_parameters(guess).declared_anew(fixed=fixed)
        estimator = eoi.OnlineEstimator(started, observer, eoi.LowPass(8.0, 3), H, transient=2.0)
        found = dict(zip(plant.names, ours(estimator, record).parameters[-1], strict=True))
        expected = 0.0512 if fixed else pytest.approx(0.0537, abs=1e-4)
        assert found["input_delay"] == expected
        assert fixed or found["k"] == pytest.approx(5.0, rel=1e-3)


def test_gaps_behind_a_delay_cost_the_transient():
    plant, observer, record = acted("delay and lag")
    lowpass = eoi.LowPass(8.0, 3)
    estimator = eoi.OnlineEstimator(plant, observer, lowpass, H, transient=2.0)
    online = of_samples(estimator, with_gap(record), record.inputs)
    p = eoi.observe(plant, observer, None, H, record.outputs, record.inputs, lowpass=lowpass)
    assert np.all(np.diff(online.parameters[GAP.start : GAP.stop + 200], axis=0) == 0.0)
    assert np.all(np.any(np.diff(online.parameters[GAP.stop + 201 :], axis=0) != 0.0, axis=1))
    later = slice(GAP.stop + 560, None)
    size = np.max(np.abs(p.injection))
    np.testing.assert_allclose(online.injection[1:][later], p.injection[later], atol=1e-12 * size)


# -- missing samples ----------------------------------------------------------------------------

GAP = slice(500, 540)


def with_gap(record, output=0):
    """Outputs with samples of one of them missing."""
    y = np.array(record.outputs)
    y[GAP, output] = np.nan
    return y


@pytest.mark.parametrize("name", ["oscillator", "two_masses"])
def test_a_gap_of_any_output_divides_a_record_in_two(name):
    """Of a model without internal states: information adds up over `observe` of both parts."""
    plant, observer = make(name)
    estimator, lowpass = estimator_of(name, transient=2.0)
    record = recorded(plant)
    y, u = with_gap(record, len(plant.outputs) - 1), record.inputs
    online = of_samples(estimator, y, u)
    parts = [
        eoi.observe(plant, observer, None, H, y[part], u[part], lowpass=lowpass, noise=1e-4,
                    transient=transient, t0=H * part.start)
        for part, transient in ((slice(0, GAP.start), 2.0), (slice(GAP.stop, SAMPLES), 0.0))
    ]  # fmt: skip
    injections = online.injection[1 : GAP.start], online.injection[GAP.stop + 1 :]
    for injection, part in zip(injections, parts, strict=True):
        size = np.max(np.abs(part.injection))
        np.testing.assert_allclose(injection, part.injection, atol=1e-12 * size)
    assert not np.any(online.injection[GAP.start : GAP.stop + 1])
    regressors, injection, score = (
        np.concatenate([np.asarray(getattr(part, field)) for part in parts])
        for field in ("regressors", "injection", "score")
    )
    history = plant.theta + eoi.recursive(regressors, injection, score)[0]
    steps = np.r_[1 : GAP.start, GAP.stop + 1 : SAMPLES]
    np.testing.assert_allclose(online.parameters[steps][400:], history[400:], rtol=1e-9)
    np.testing.assert_allclose(online.parameters[-1], history[-1], rtol=1e-12)
    before = online.parameters[GAP.start - 1]
    np.testing.assert_array_equal(
        online.parameters[GAP], np.broadcast_to(before, (40, len(before)))
    )


@pytest.mark.parametrize("name", ["oscillator", "heated", "two_masses", "cell", "explicit"])
def test_steps_count_as_in_the_pass_over_a_record_with_the_same_gaps(name):
    plant, observer = make("oscillator" if name == "explicit" else name)
    if name == "explicit":
        observer = eoi.observers.SuperTwisting(6.0, 20.0, scheme="explicit")
    lowpass = eoi.LowPass(8.0, plant.relative_degree + 1)
    estimator = eoi.OnlineEstimator(plant, observer, lowpass, H, transient=2.0)
    record = recorded(plant)
    y = with_gap(record)
    y[[3, 220, 300]] = np.inf
    valid = np.isfinite(y)
    following = np.maximum.accumulate(np.where(valid, np.arange(SAMPLES)[:, None], 0), axis=0)
    bridged = np.take_along_axis(y, following, axis=0)  # the last that was measured
    reference = eoi.observe(plant, observer, None, H, bridged, record.inputs, lowpass=lowpass,
                            transient=2.0, valid=valid)  # fmt: skip

    def body(state, sample):
        return estimator.step(state, *sample)

    def counted(state, sample):
        after, estimate = body(state, sample)
        return after, (estimate, after.kernel.sums.count)

    _, (online, counts) = jax.jit(jax.lax.scan, static_argnums=0)(
        counted, estimator.init(), (y, record.inputs)
    )
    np.testing.assert_array_equal(np.diff(counts, axis=0), reference.score)
    # Beyond the memory of the filter the pass has forgotten that its weight fell before the gap.
    size = np.max(np.abs(reference.injection))
    injection = np.asarray(online.injection)[1:]
    later = slice(GAP.stop + 560, None)
    np.testing.assert_allclose(injection[later], reference.injection[later], atol=1e-12 * size)
    assert np.all(np.isfinite(online.parameters))


def test_an_input_that_is_no_number_keeps_its_last_value():
    estimator, _ = estimator_of("oscillator", transient=2.0)
    record = recorded(estimator.plant)
    held, y, u = np.array(record.inputs), np.array(record.outputs), np.array(record.inputs)
    u[GAP], held[GAP], y[GAP] = np.nan, held[GAP.start - 1], np.nan
    lost, same = of_samples(estimator, record.outputs, u), of_samples(estimator, y, held)
    np.testing.assert_array_equal(lost.parameters, same.parameters)


def test_samples_may_be_missing_from_the_first_one_on():
    estimator, _ = estimator_of("oscillator", transient=2.0)
    record = recorded(estimator.plant)
    y = np.array(record.outputs)
    y[:100] = np.nan
    online = of_samples(estimator, y, record.inputs)
    np.testing.assert_array_equal(online.parameters[:200], 0.0 * online.parameters[:200] +
                                  estimator.plant.theta)  # fmt: skip
    expected = [1.1 * value for value in estimator.plant.theta]
    np.testing.assert_allclose(online.parameters[-1], expected, rtol=0.005)


@pytest.mark.parametrize("missing", ["samples now and then", "a long time"])
def test_gaps_bias_no_parameter(missing):
    """A filter that remembered the half of a second difference would: errors of 1 %, not 0.05 %."""
    estimator, _ = estimator_of("oscillator", transient=2.0)
    record = recorded(estimator.plant, seed=2)
    y = np.array(record.outputs)
    for first in range(250, SAMPLES, 150):
        y[first : first + (1 if missing == "samples now and then" else 60)] = np.nan
    last = of_samples(estimator, y, record.inputs).parameters[-1]
    np.testing.assert_allclose(last, 1.1 * estimator.plant.theta, rtol=0.003)


class Exported:
    """An estimator in C, compiled, called sample by sample."""

    def __init__(self, estimator, folder, precision):
        compiler = shutil.which("gcc") or shutil.which("cc")
        if compiler is None:
            pytest.skip("no C compiler here (gcc or cc)")
        source = eoi.export_estimator(estimator, folder / "rig.c", precision)
        flags = ["-std=c99", "-Wall", "-Wextra", "-Wno-unused-variable", "-Werror", "-O1"]
        flags += ["-Wdouble-promotion"] * (precision == "single")
        library = folder / "rig.so"
        command = [compiler, *flags, "-shared", "-fPIC", source, "-o", library, "-lm"]
        subprocess.run([str(part) for part in command], check=True)
        self.number = ctypes.c_double if precision == "double" else ctypes.c_float
        self.library = ctypes.CDLL(str(library))
        text = source.read_text()
        self.size = int(re.findall(r"memory\[(\d+)\];\n} rig_state", text)[0])
        fields = [
            ("parameters", self.number * len(estimator.plant.names)),
            ("injection", self.number * len(estimator.plant.outputs)),
            ("power", self.number),
            ("alarm", ctypes.c_int),
        ]
        self.estimate = type("Estimate", (ctypes.Structure,), {"_fields_": fields})()

    def run(self, outputs, inputs):
        state = (self.number * self.size)()
        self.library.rig_init(state)
        rows = []
        for y, u in zip(outputs, inputs, strict=True):
            sample = (self.number * len(y))(*y), (self.number * len(u))(*u)
            self.library.rig_step(state, *sample, ctypes.byref(self.estimate))
            one = self.estimate
            rows.append([*one.parameters, *one.injection, one.power, one.alarm])
        return np.asarray(rows)


def alarmed(name):
    plant, _ = make(name)
    power = np.full(len(plant.outputs), 1e-4)
    return estimator_of(name, alarm=eoi.Alarm(power, 0.5, 5.0), transient=1.0)[0]


# A voltage of 3.6 V has 2e-7 V in single precision: of its changes, 0.05 V, that is a lot.
AGREEMENT = [
    *((name, "double", 1e-12) for name in (*PLANTS, "high_cell")),
    *((name, "single", 1e-5) for name in PLANTS),
    ("high_cell", "single", 5e-5),
]


@pytest.mark.parametrize(("precision", "tolerance"), [("double", 1e-12), ("single", 1e-5)])
@pytest.mark.parametrize("case", ["lag and delay", "a voltage behind both"])
def test_the_exported_estimator_has_delays_and_lags(case, precision, tolerance, tmp_path):
    plant, observer, record = acted(case)
    plant = plant.declared_anew(fixed=plant.names[-1:])
    lowpass = eoi.LowPass(8.0, plant.relative_degree + 1)
    estimator = eoi.OnlineEstimator(plant, observer, lowpass, H, transient=1.0)
    y = with_gap(record)
    if precision == "single":
        y = y.astype(np.float32).astype(float)
    theirs = Exported(estimator, tmp_path, precision).run(y, record.inputs)
    online = of_samples(estimator, y, record.inputs)
    size = len(plant.names)
    np.testing.assert_allclose(theirs[400:, :size], online.parameters[400:], rtol=tolerance)


@pytest.mark.parametrize(("name", "precision", "tolerance"), AGREEMENT)
def test_the_exported_estimator_is_ours_step_by_step(name, precision, tolerance, tmp_path):
    estimator = alarmed(name)
    record = recorded(estimator.plant)
    if precision == "single":  # the same numbers for both
        record = record.with_outputs(record.outputs.astype(np.float32).astype(float), "run")
    y = with_gap(record)
    theirs = Exported(estimator, tmp_path, precision).run(y, record.inputs)
    online = of_samples(estimator, y, record.inputs)
    size, ny = len(estimator.plant.names), len(estimator.plant.outputs)
    # The injection is a difference: its rounding is that of the derivative that it is one of.
    speed = np.max(np.abs(np.gradient(np.gradient(record.outputs, H, axis=0), H, axis=0)))
    injection = theirs[:, size : size + ny]
    np.testing.assert_allclose(injection, online.injection, atol=tolerance * max(speed, 1.0))
    np.testing.assert_allclose(theirs[400:, :size], online.parameters[400:], rtol=tolerance)
    assert np.all(np.isfinite(theirs))
    if precision == "double":
        np.testing.assert_array_equal(theirs[:, -1], online.alarm)
        np.testing.assert_allclose(theirs[:, -2], online.power, rtol=1e-9)


def test_the_file_says_that_delays_are_in_it():
    plant, observer, _ = acted("delay")
    estimator = eoi.OnlineEstimator(plant, observer, eoi.LowPass(8.0, 3), H)
    sentence = "Delays and lags of inputs are part of the state: pass inputs as they are sent."
    assert sentence in estimator_text(estimator, "rig")
    assert sentence not in estimator_text(alarmed("oscillator"), "rig")


def test_an_estimator_without_an_alarm_is_exported_too(tmp_path):
    estimator, _ = estimator_of("oscillator")
    record = recorded(estimator.plant)
    theirs = Exported(estimator, tmp_path, "double").run(record.outputs, record.inputs)
    np.testing.assert_allclose(theirs[-1, :3], ours(estimator, record).parameters[-1], rtol=1e-12)
    assert not np.any(theirs[:, -2:])


def test_the_file_allocates_nothing_and_says_what_it_is():
    text = estimator_text(alarmed("oscillator"), "rig")
    assert re.findall(r"#include <(.*)>", text) == ["math.h"]
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|printf)\b", text)
    assert "outputs[1]: y, as measured at the sample; NaN where one is missing" in text
    assert "inputs[1]: u, as they are from the sample on" in text
    assert " *   parameters[0] g: 1.2" in text
    assert "double" not in estimator_text(alarmed("oscillator"), "rig", "single").split("math.h")[1]


# -- the alarm ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def identified():
    plant, _ = make("oscillator")
    record = recorded(plant, noise=1e-3)
    return eoi.identify(plant, record, instruments=False), record


def test_the_power_is_one_on_average_and_seldom_above_the_threshold(identified):
    result, _ = identified
    record = recorded(make("oscillator")[0], noise=1e-3, seed=3)
    estimator = eoi.online_estimator(result, record)
    online = ours(estimator, record)
    assert not np.any(online.alarm)
    assert 0.6 < np.mean(online.power[400:]) < 1.4


def test_gaps_set_no_alarm_off(identified):
    result, record = identified
    estimator = eoi.online_estimator(result, record)
    assert estimator.alarm is not None
    for seed in range(3, 7):
        run_ = recorded(make("oscillator")[0], noise=1e-3, seed=seed)
        y = np.array(run_.outputs)
        for first in range(130, SAMPLES, 170):
            y[first : first + 1 + first % 40] = np.nan
        online = of_samples(estimator, y, run_.inputs)
        assert not np.any(online.alarm)
        assert np.max(online.power) < 0.5 * estimator.alarm.threshold


@pytest.mark.parametrize("rate", [1.0 / 36.0, 1.0 / 3.6])
def test_the_rate_of_false_alarms_is_what_was_asked_for(rate):
    """On noise of the correlation that the filter gives it, many hours at once."""
    from eoi_jax.estimation.online import _correlation, _independent, _threshold

    draw, pole, memory, count = np.random.default_rng(1), 0.9, 0.5, 400_000
    noise = np.zeros(count)
    white = draw.standard_normal(count)
    for k in range(1, count):
        noise[k] = pole * noise[k - 1] + white[k]
    noise /= np.std(noise)
    power = np.ones(count)
    for k in range(1, count):
        power[k] = power[k - 1] + H / memory * (noise[k] ** 2 - power[k - 1])
    signals = noise[:, None]
    correlation = _correlation([signals], 200) / count
    independent = _independent(correlation, np.array([float(count)]))
    threshold = _threshold(correlation, independent, H, memory, rate)
    above = power > threshold
    starts = np.flatnonzero(above[1:] & ~above[:-1])
    alarms = np.sum(np.diff(starts, prepend=-1000) > memory / H)  # one for each excursion
    assert 0.3 < alarms / (count * H * rate) < 2.0


def test_a_plant_that_is_slower_has_the_same_alarm_slower(identified):
    result, record = identified
    fast = eoi.online_estimator(result, record, false_alarms=1e-3).alarm
    assert fast is not None
    assert fast.memory == pytest.approx(3.0 / result.lowpass.cutoff)
    values = make("oscillator")[0].parameters
    powers = {"g": 2, "c": 1, "k": 2}  # of 1/s in the unit of a parameter
    slower = eoi.Plant(
        oscillator, {name: value * 1e-3 ** powers[name] for name, value in values.items()}, 2,
        inputs=("u",), outputs=("y",),
    )  # fmt: skip
    slow_record = eoi.Record(1e3 * record.time, record.inputs, record.outputs, hold="zero")
    found = eoi.identify(slower, slow_record, instruments=False)
    slow = eoi.online_estimator(found, slow_record, false_alarms=1e-6)
    assert slow.sample_period == pytest.approx(1e3 * H)
    assert slow.alarm is not None
    assert slow.alarm.memory == pytest.approx(1e3 * fast.memory)
    assert slow.alarm.threshold == pytest.approx(fast.threshold, rel=1e-3)


@pytest.mark.parametrize("kind", ["friction", "offset"])
def test_what_begins_in_the_middle_of_a_run_sets_it_off(identified, kind):
    result, record = identified
    time, begin = H * np.arange(SAMPLES), 7.0
    force = eoi.excitation.random_steps(time, -1.0, 1.0, 0.4, seed=5)
    added = {"friction": lambda x: -0.1 * jnp.tanh(x.y[1, 0] / 1e-3), "offset": lambda x: 0.1}[kind]
    changed = eoi.Plant(
        lambda t, x, u, p: [oscillator(t, x, u, p)[0] + jnp.where(t > begin, added(x), 0.0)],
        {name: 1.1 * value for name, value in make("oscillator")[0].parameters.items()}, 2,
        inputs=("u",), outputs=("y",),
    )  # fmt: skip
    clean = eoi.simulate(changed, time, force, hold="zero", substeps=10)
    noise = 1e-3 * np.random.default_rng(5).standard_normal(clean.outputs.shape)
    run = clean.with_outputs(clean.outputs + noise, "run")
    alarm = ours(eoi.online_estimator(result, record), run).alarm
    first = time[np.flatnonzero(alarm)[0]]
    assert begin < first < begin + 2.0


@pytest.fixture(scope="module")
def rubbing():
    """A result, and of a noise its record: a velocity of one step has 140 times as much of it."""
    plant, _ = make("friction")

    def made(noise):
        return recorded(plant, noise=noise)

    return eoi.identify(plant, made(1e-4), instruments=False), made


def test_few_samples_beside_dry_friction_make_no_alarm(rubbing):
    """A threshold of 1e300 would never be reached, and nobody would know."""
    result, made = rubbing
    usual = eoi.online_estimator(result, made(1e-4)).alarm
    assert usual is not None
    assert usual.threshold < 20.0
    few = made(1e-3)
    message = (
        "`records` must hold at least 10 independent samples of the injection for an alarm, got .*"
        "of the steps of y count, those away from velocities below .* of y, 4 standard deviations "
        "of their noise.*Give longer records.*`false_alarms=None`"
    )
    with pytest.raises(ValueError, match=message):
        eoi.online_estimator(result, few)
    without = eoi.online_estimator(result, few, false_alarms=None)
    assert without.alarm is None
    with pytest.raises(ValueError, match="`records` must have steps that count, got 0 of the st"):
        eoi.online_estimator(result, made(1e-2), false_alarms=None)


def test_records_that_are_too_short_make_no_alarm(identified):
    result, record = identified
    with pytest.raises(ValueError, match=r"independent samples .* behind the transient and gaps"):
        eoi.online_estimator(result, record[: SAMPLES // 8])


def test_an_estimator_prints_what_it_does(identified):
    result, record = identified
    text = str(eoi.online_estimator(result, record, forgetting=0.999))
    assert "oscillator: estimator in real time, a step each 0.01 s, inputs held" in text
    assert "memory of the parameters  about 10 s, forgetting 0.999" in text
    assert re.search(r"alarm  where the power of the injection over .* s is above .* times", text)
    text = str(eoi.online_estimator(result, record, false_alarms=None))
    assert text.endswith("alarm  none")
    assert "memory of the parameters  all samples" in text


# -- what is refused ----------------------------------------------------------------------------


def test_wrong_arguments_are_named(identified, tmp_path):
    result, record = identified
    estimator = eoi.online_estimator(result, record)
    for arguments, message in (
        ({"memory": 0.0}, r"`memory` must be positive \[s\], got 0.0"),
        (
            {"memory": 0.1 * H},
            f"`memory` must be at least a sample period, {H:g} s, got {0.1 * H:g}",
        ),
        ({"memory": 0.5 * H}, "`memory` must be at least a sample period"),
        ({"false_alarms": -1.0}, r"`false_alarms` must be positive \[1/s\]"),
        ({"forgetting": 2.0}, r"`forgetting` must lie in \(0, 1\]"),
    ):
        with pytest.raises(ValueError, match=message):
            eoi.online_estimator(result, record, **arguments)
    slower = eoi.Record(2 * record.time, record.inputs, record.outputs, hold="zero")
    with pytest.raises(ValueError, match="`records` must have one sample period"):
        eoi.online_estimator(result, [record, slower])
    with pytest.raises(ValueError, match=r"`path` must end in \.c"):
        eoi.export_estimator(estimator, tmp_path / "rig.py")
    with pytest.raises(ValueError, match="`path` must be named as a function can be"):
        eoi.export_estimator(estimator, tmp_path / "my rig.c")
    with pytest.raises(ValueError, match="`precision` must be"):
        eoi.export_estimator(estimator, tmp_path / "rig.c", "half")


def test_wrong_estimators_are_named():
    plant, observer = make("oscillator")
    lowpass = eoi.LowPass(8.0, 3)
    for arguments, message in (
        ({"sample_period": 0.0}, r"`sample_period` must be positive \[s\]"),
        ({"hold": "smooth"}, "`hold` must be one of zero, linear, got 'smooth'"),
        ({"hold": {"u": "smooth"}}, r"`hold\[u\]` must be one of zero, linear, got 'smooth'"),
        ({"theta": [1.0]}, "`theta` must"),
        ({"weights": [1.0, 2.0]}, "`weights` must"),
    ):
        with pytest.raises(ValueError, match=message):
            eoi.OnlineEstimator(plant, observer, lowpass, **{"sample_period": H, **arguments})


def test_a_sample_of_another_shape_is_named():
    estimator, _ = estimator_of("oscillator")
    state = estimator.init()
    with pytest.raises(ValueError, match=r"`y` must have shape \(1\): one number an output, got"):
        estimator.step(state, 0.0, [0.0])
    with pytest.raises(ValueError, match=r"`u` must have shape \(1\): one number an input, got sh"):
        estimator.step(state, [0.0], [0.0, 1.0])


def test_a_wrong_alarm_is_named():
    for arguments, message in (
        (([0.0], 0.5, 5.0), r"`power` must be positive and finite, got \[0.0\]. It is the mean"),
        (([1.0], -1.0, 5.0), "`memory` must be positive and finite, got -1.0. It is a time in sec"),
        (([1.0], 0.5, np.nan), "`threshold` must be positive and finite, got nan. Where the model"),
    ):
        with pytest.raises(ValueError, match=message):
            eoi.Alarm(*arguments)
    for alarm, message in (
        (eoi.Alarm([1.0, 1.0], 0.5, 5.0), r"`alarm.power` must have shape \(1\): one number an"),
        (eoi.Alarm([1.0], 0.1 * H, 5.0), "`alarm.memory` must be at least a sample period, 0.01 s"),
    ):
        with pytest.raises(ValueError, match=message):
            estimator_of("oscillator", alarm=alarm)


def test_an_alarm_may_be_traced(identified):
    """The power with half the noise is twice as large, at any threshold."""
    _, record = identified

    def last(power, threshold):
        estimator, _ = estimator_of("oscillator", alarm=eoi.Alarm(power, 0.5, threshold))
        return run(estimator, record.outputs, record.inputs).power[-1]

    once, twice = jax.jit(jax.vmap(last))(jnp.array([[1e-4], [5e-5]]), jnp.array([5.0, 6.0]))
    np.testing.assert_allclose(twice, 2.0 * once, rtol=1e-3)


def test_an_actuator_that_is_a_function_is_refused():
    plant, observer = make("oscillator")
    own = eoi.Plant(oscillator, plant.parameters, 2, actuator=lambda t, u, p: u)
    with pytest.raises(ValueError, match="`actuator` must be made of delays and lags"):
        eoi.OnlineEstimator(own, observer, eoi.LowPass(8.0, 3), H)


def test_an_actuator_without_a_step_is_refused():
    class Doubled(AbstractActuator):
        name = "doubled"
        sentence = "twice the input"

        def along(self, time, u, shape):
            return 2.0 * u

    plant, observer = make("oscillator")
    twice = augmented(plant, [place(plant, Doubled(), 0)], {})
    with pytest.raises(ValueError, match="`doubled` must have `memory` and `step` to run sample"):
        eoi.OnlineEstimator(twice, observer, eoi.LowPass(8.0, 3), H)


def test_states_that_change_at_samples_are_refused():
    plant, observer = make("heated")
    last = SampledStates(lambda t, x, u, p: u, 1, H)
    sampled = eoi.Plant(heated, plant.parameters, 1, internal=store, internal_initial=[0.0],
                        sampled=last)  # fmt: skip
    with pytest.raises(ValueError, match="`plant` must have no states that change at samples"):
        eoi.OnlineEstimator(sampled, observer, eoi.LowPass(8.0, 2), H)


def test_a_model_that_is_no_arithmetic_is_refused(tmp_path):
    _, observer = make("oscillator")
    sorted_ = eoi.Plant(
        lambda t, x, u, p: jnp.sort(x.y[0]) * p.k + u, {"k": -1.0}, 2, inputs=("u",),
        outputs=("y",),
    )  # fmt: skip
    estimator = eoi.OnlineEstimator(sorted_, observer, eoi.LowPass(8.0, 3), H)
    with pytest.raises(ValueError, match="`estimator` must be arithmetic on measurements"):
        eoi.export_estimator(estimator, tmp_path / "rig.c")
