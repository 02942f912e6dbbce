"""Free runs with the controller in the loop, against loops that SciPy simulates."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import eoi_jax as eoi
from tests.simulation.closed_loops import GAINS, PERIOD, Pid, controller, double, measured

# Four Runge-Kutta steps a sample of modes of 5/s: 0.01 * 5 / 4 = 0.0125 per step, errors of 1e-10.
EXACT = 1e-7


def test_a_whole_run_of_an_unstable_plant_follows_its_loop():
    run = eoi.validate(double(), measured(), controller=controller())
    assert run.window is None
    assert run.in_loop
    assert run.rmse[0] < EXACT
    # The same run with the recorded input is lost, for rounding of the start grows by e^(4.5 t).
    assert eoi.validate(double(), measured().without_inputs("r"), window=np.inf).rmse[0] > 1.0


def test_the_prediction_has_the_inputs_of_the_plant():
    record = measured()
    run = eoi.validate(double(), record, controller=controller())
    (prediction,) = run.predictions
    assert prediction.input_names == ("current",)
    assert np.array_equal(prediction.inputs[:, 0], record.inputs[:, 0])
    assert run.records[0].input_names == ("current",)


def test_limits_and_a_sum_that_stands_still_at_them():
    record = measured(law=Pid(limit=12.0))
    assert np.mean(np.abs(record.inputs[:, 0]) == 12.0) > 0.02
    run = eoi.validate(double(), record, controller=controller(limits=(-12.0, 12.0)))
    assert run.rmse[0] < EXACT


@pytest.mark.parametrize("delay", [1, 2])
def test_a_delay_of_the_controller(delay):
    record = measured(delay=delay, law=Pid(proportional=14.0, integral=0.0))
    pid = controller(proportional=14.0, integral=0.0, delay=delay)
    assert eoi.validate(double(), record, controller=pid).rmse[0] < EXACT


def test_in_windows_the_controller_starts_in_the_state_that_it_had():
    record = measured(noise=1e-3)
    run = eoi.validate(double(), record, window=1.0, initial_samples=20, controller=controller())
    assert run.window == 1.0
    assert run.rmse[0] < 2e-3


def test_the_error_of_the_true_model_is_the_sensitivity_times_the_noise():
    noise = 1e-3
    record = measured(noise=noise, count=6000)
    run = eoi.validate(double(), record, controller=controller())
    error = (record.outputs - run.predictions[0].outputs)[2000:, 0]
    # S of the sampled loop at each frequency, from the exact discretisation.
    z = np.exp(2j * np.pi * np.fft.rfftfreq(4000))
    plant = np.array([[0.0, 1.0, 0.0], [25.0, -1.0, 4.0], [0.0, 0.0, 0.0]])
    step = expm(plant * PERIOD)
    transfer = np.array([
        (np.linalg.inv(value * np.eye(2) - step[:2, :2]) @ step[:2, 2])[0] for value in z
    ])  # fmt: skip
    decay = GAINS["filter_time"] / (GAINS["filter_time"] + PERIOD)
    difference = (1 - 1 / z) / (GAINS["filter_time"] + PERIOD) / (1 - decay / z)
    with np.errstate(divide="ignore", invalid="ignore"):
        law = GAINS["proportional"] + GAINS["derivative"] * difference
        law = law + GAINS["integral"] * PERIOD / (z - 1)
        sensitivity = np.abs(1 / (1 + transfer * law))[1:]
    spectrum = np.abs(np.fft.rfft(error))[1:] ** 2 / (4000 * noise**2)
    ratio = spectrum / sensitivity**2
    # 2000 independent ordinates of exponential distribution: their mean errs by 2.2 %.
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.12)
    assert np.mean(sensitivity**2) > 1.05


def test_an_input_that_the_controller_does_not_drive_is_as_recorded():
    record = measured(push=0.5)
    plant = double(("current", "push"))
    run = eoi.validate(plant, record, controller=controller(inputs="current"))
    assert run.rmse[0] < EXACT


def test_a_law_without_a_state_and_a_set_point():
    def law(t, r, y, s):
        return 40.0 * (0.5 - y[0])

    # y' = 2 y + 0.1 u, unstable, proportional: a loop of y' = -2 y + 2, sampled.
    period, count = 0.05, 200
    grow, push = np.exp(2 * period), (np.exp(2 * period) - 1) / 2 * 0.1
    y, u = np.zeros(count), np.zeros(count)
    for k in range(count):
        u[k] = 40.0 * (0.5 - y[k])
        if k + 1 < count:
            y[k + 1] = grow * y[k] + push * u[k]
    record = eoi.Record(period * np.arange(count), u, y)

    def first_order(t, x, u, p):
        return p.a * x.y[0] + p.b * u[0]

    plant = eoi.Plant(first_order, {"a": 2.0, "b": 0.1})
    run = eoi.validate(plant, record, controller=eoi.Controller(law), initial_samples=20)
    assert run.rmse[0] < EXACT
    assert run.records[0].hold == "zero"
    assert "a controller holds them (zero)" in run.notes[-1]


def test_rounding_of_the_input_is_taken_over():
    class Rounded(Pid):
        def __call__(self, error):
            return 0.5 * np.round(super().__call__(error) / 0.5)

    record = measured(law=Rounded())
    run = eoi.validate(double(), record, controller=controller())
    # The rounding is added as recorded; where the simulated y differs nothing else does.
    assert run.rmse[0] < EXACT


def test_a_dither_below_the_tolerance_is_taken_over():
    dither = 0.05 * np.random.default_rng(5).standard_normal(1500)
    run = eoi.validate(double(), measured(dither=dither), controller=controller())
    assert run.rmse[0] < EXACT
    assert "It reproduces the recorded current of run 1 to" in run.notes[-1]


def test_dry_friction_sticks_in_the_loop():
    """A mass with Coulomb friction under PD control, against small steps that stop at rest."""
    period, count, fine = 0.01, 600, 400
    gains = {"proportional": 30.0, "derivative": 4.0, "filter_time": 0.02}
    law, r = Pid(**gains, integral=0.0), np.repeat([0.0, 1.0, 0.2, 0.9, -0.3, 0.4], 100)
    y, u, x, v = np.zeros(count), np.zeros(count), 0.0, 0.0
    for k in range(count):
        y[k], u[k] = x, law(r[k] - x)
        for _ in range(fine):
            h = period / fine
            force = u[k] - 0.5 * v
            if v == 0.0 and abs(force) <= 3.0:
                continue
            way = np.sign(v) if v != 0.0 else np.sign(force)
            new = v + h * (force - 3.0 * way)
            new = 0.0 if way * new < 0 else new
            x, v = x + 0.5 * h * (v + new), new
    assert np.mean(np.diff(y) == 0.0) > 0.1
    record = eoi.Record(period * np.arange(count), np.stack([u, r], 1), y, hold="zero",
                        input_names=("u", "r"))  # fmt: skip

    def mass(t, x, u, p):
        return u[0] - p.b * x.y[1] - p.c * jnp.sign(x.y[1])

    plant = eoi.Plant(mass, {"b": 0.5, "c": 3.0}, relative_degree=2)
    pd = eoi.Controller.pid(30.0, 0.0, 4.0, period=period, filter_time=0.02)
    run = eoi.validate(plant, record, controller=pd)
    # Steps of 25 µs of the reference: first order, about 1e-4 of the motion.
    assert run.rmse[0] < 1e-3 * np.std(y)


def test_internal_states_of_the_plant_stay_what_they_are():
    """An actuator of first order between controller and plant, an internal state."""
    period, count = 0.02, 500
    r = np.repeat(np.random.default_rng(4).uniform(-1, 1, 10), 50)
    x, y, u = np.zeros(2), np.zeros(count), np.zeros(count)
    for k in range(count):
        y[k], u[k] = x[0], 3.0 * (r[k] - x[0])

        def rate(t, x, u=u[k]):
            return [x[0] + x[1], (u - x[1]) / 0.1]

        x = solve_ivp(rate, (0, period), x, rtol=1e-10, atol=1e-12).y[:, -1]
    record = eoi.Record(period * np.arange(count), np.stack([u, r], 1), y, hold="zero",
                        input_names=("u", "r"))  # fmt: skip

    def plant_rate(t, x, u, p):
        return p.a * x.y[0] + x.z[0]

    def lag(t, x, u, p):
        return (u[0] - x.z[0]) / p.tau

    plant = eoi.Plant(plant_rate, {"a": 1.0, "tau": 0.1}, internal=lag, internal_initial=[0.0])
    law = eoi.Controller(lambda t, r, y, s: 3.0 * (r[0] - y[0]), "r")
    assert eoi.validate(plant, record, controller=law).rmse[0] < EXACT
    better = eoi.refine(plant.with_parameters({"a": 0.7, "tau": 0.15}), record, controller=law)
    assert better.parameters["tau"] == pytest.approx(0.1, rel=1e-5)
    assert better.starts[0].z.shape == (1,)


def test_a_run_starts_again_behind_a_gap_of_the_input():
    record = measured(noise=1e-3)
    inputs = record.inputs.copy()
    inputs[700:730] = np.nan
    with pytest.warns(eoi.RecordWarning):
        gap = eoi.Record(record.time, inputs, record.outputs, hold="zero",
                         input_names=record.input_names)  # fmt: skip
    run = eoi.validate(double(), gap, controller=controller())
    assert run.rmse[0] < 2e-3
    assert any("start" in note for note in run.notes)


@pytest.mark.slow
@pytest.mark.long
def test_what_cannot_be_compiled_runs_on_the_scan():
    def law(t, r, y, s):
        gain = jax.lax.while_loop(lambda g: g < 17.9, lambda g: g + 18.0, 0.0 * y[0])
        return gain * (r[0] - y[0]) - 3.0 * (y[0] - s[0]) / PERIOD, y

    system = np.array([[0.0, 1.0, 0.0], [25.0, -1.0, 4.0], [0.0, 0.0, 0.0]])
    transition, x, count = expm(system * PERIOD), np.zeros(2), 400
    r, y, u, before = np.repeat([0.0, 1.0, -0.5, 0.3], 100), np.zeros(400), np.zeros(400), 0.0
    for k in range(count):
        y[k] = x[0]
        u[k] = 18.0 * (r[k] - y[k]) - 3.0 * (y[k] - before) / PERIOD
        before, x = y[k], (transition @ [*x, u[k]])[:2]
    record = eoi.Record(PERIOD * np.arange(count), np.stack([u, r], 1), y, hold="zero",
                        input_names=("current", "r"), output_names=("position",))  # fmt: skip
    loop = eoi.Controller(law, "r", states=1)
    assert eoi.validate(double(), record, controller=loop).rmse[0] < EXACT
    better = eoi.refine(double(a=24.0), record, controller=loop)
    assert better.engine.name == "scan"
    assert better.engine.reason
    assert better.parameters["a"] == pytest.approx(25.0, rel=1e-5)


# -- refused ------------------------------------------------------------------------------


def refused(match, record=None, plant=None, **changes):
    with pytest.raises(ValueError, match=match):
        eoi.validate(plant or double(), measured() if record is None else record,
                     controller=controller(**changes))  # fmt: skip


def test_a_controller_that_does_not_reproduce_the_input_is_refused_with_how_much_and_when():
    # Another gain of the derivative: neither a delay, nor a factor, nor an offset.
    refused(r"must reproduce the recorded input current of run 1 .* difference of .* A rms \(.* %"
            r".*largest at t = .* Neither a delay .* `Record.from_period`",
            derivative=1.0)  # fmt: skip


def test_a_difference_of_many_times_the_deviation_is_written_out():
    refused(r"rms \(\d{4,} % of its standard deviation\)", derivative=200.0)


def test_a_factor_is_named():
    refused(r"With a factor of 1\.5 ", proportional=12.0, integral=20.0 / 3.0, derivative=2.0)


def test_a_delay_is_named():
    record = measured(delay=1, law=Pid(proportional=14.0, integral=0.0))
    refused("With a delay of 1 sample", record, proportional=14.0, integral=0.0)


def test_an_offset_is_named():
    law = eoi.Controller(lambda t, r, y, s: 18.0 * (r[0] - y[0]), "r")
    record = measured(law=lambda error: 18.0 * error + 1.0, a=-5.0)
    with pytest.raises(ValueError, match="an offset of 1 the law"):
        eoi.validate(double(), record, controller=law)


def test_a_relay_is_not_taken_for_rounding():
    record = measured(law=lambda error: 20.0 * np.sign(error), count=400, a=-5.0)
    refused("must reproduce the recorded input", record)


def test_references_are_inputs_of_the_record():
    refused(r"controller\.reference \(input of run 1\)", reference="set_point")


def test_the_other_inputs_are_those_of_the_plant():
    refused("must have 1 channel", measured(push=0.5))


def test_what_it_drives_are_inputs_of_the_plant():
    refused(r"controller\.inputs", inputs="voltage")


def test_a_hold_that_is_no_converter_is_refused():
    refused("must be zero: a digital controller holds", measured().with_hold("linear"))


def test_inputs_that_act_later_are_refused():
    refused("at the instants of the samples", measured().with_delayed_inputs([0.002, 0.0]))


def test_records_of_different_sampling_are_refused():
    record = measured()
    slow = eoi.Record(2.0 * record.time, record.inputs, record.outputs, hold="zero",
                      input_names=record.input_names)  # fmt: skip
    with pytest.raises(ValueError, match="must have the same sample period"):
        eoi.validate(double(), [record, slow], controller=controller())


def test_a_state_of_the_controller_needs_every_output():
    record = measured()
    outputs = record.outputs.copy()
    outputs[300:310] = np.nan
    with pytest.warns(eoi.RecordWarning):
        gap = eoi.Record(record.time, record.inputs, outputs, hold="zero",
                         input_names=record.input_names)  # fmt: skip
    refused("10 missing samples", gap)
    law = eoi.Controller(lambda t, r, y, s: 40.0 * (r[0] - y[0]), "r")
    stable = measured(law=lambda error: 40.0 * error, a=-5.0)
    outputs = stable.outputs.copy()
    outputs[300:310] = np.nan
    with pytest.warns(eoi.RecordWarning):
        gap = eoi.Record(stable.time, stable.inputs, outputs, hold="zero",
                         input_names=stable.input_names)  # fmt: skip
    assert eoi.validate(double(a=-5.0), gap, controller=law).rmse[0] < EXACT


def test_plants_that_no_loop_covers_are_refused():
    delayed = eoi.Plant(lambda t, x, u, p: p.b * u[0] - x.y[0], {"b": 1.0},
                        actuator=lambda t, u, p: u)  # fmt: skip
    record = measured()
    refused("must act on the plant at once", record, delayed)
    algebraic = eoi.Plant(lambda t, x, u, p: p.b * x.z[0], {"b": 1.0}, relative_degree=0,
                          internal=lambda t, x, u, p: u[0] - x.z[0],
                          internal_initial=[0.0])  # fmt: skip
    refused("must be states", record, algebraic)


@pytest.mark.parametrize(
    ("law", "states", "match"),
    [
        (lambda t, r, y, s: y[0], 1, r"must return \(u, next state\)"),
        (lambda t, r, y, s: (y[0], s), 0, "must return u alone"),
        (lambda t, r, y, s: y[:0], 0, r"must return u of shape \(1,\)"),
        (lambda t, r, y, s: (y[0], s[:1]), 2, r"must return state of shape \(2,\)"),
    ],
)
def test_laws_of_wrong_shapes_are_refused(law, states, match):
    loop = eoi.Controller(law, "r", states=states)
    with pytest.raises(ValueError, match=match):
        eoi.validate(double(), measured(), controller=loop)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: eoi.Controller(print, ("r", "r")), "different names"),
        (lambda: eoi.Controller(print, states=-1), "`states`"),
        (lambda: eoi.Controller(print, states=2, initial=[0.0]), "must hold 2 finite values"),
        (lambda: eoi.Controller(print, tolerance=1.5), r"must lie in \(0, 1\)"),
        (lambda: controller(period=0.0), "`period`"),
        (lambda: controller(proportional=np.inf), "must be finite numbers"),
        (lambda: controller(limits=(1.0, -1.0)), "lower < upper"),
    ],
)
def test_settings_of_a_controller_are_checked(make, match):
    with pytest.raises(ValueError, match=match):
        make()


def test_inputs_are_left_out_by_name():
    record = measured(push=0.5)
    assert record.without_inputs("r").input_names == ("current", "push")
    assert record.without_inputs("r", "push").inputs.shape == (1500, 1)
    assert record.without_inputs().input_names == ()
    with pytest.raises(ValueError, match="`names` must be one of"):
        record.without_inputs("reference")
