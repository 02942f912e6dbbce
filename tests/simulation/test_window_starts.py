"""Windows of a model with a store that is not measured: where that store starts in each of them."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.models.augmented import augmented, place
from eoi_jax.simulation import planned_runs
from eoi_jax.simulation.validate import judged_runs

GAIN, AMBIENT, TAU, EXCHANGE, RATE = 0.44, 20.0, 50.0, 0.01, 0.011
PERIOD, NOISE = 2.0, 0.2
PLATE = eoi.Plant(
    lambda t, x, u, p: p.k * u - (x.y[0] - p.ambient) / p.tau + p.a * x.z[0],
    {"k": GAIN, "ambient": AMBIENT, "tau": TAU, "a": EXCHANGE, "b": RATE},
    inputs=("voltage",), outputs=("temperature",),
    internal=lambda t, x, u, p: -p.b * x.z[0]
    - (p.k * u - (x.y[0] - p.ambient) / p.tau + p.a * x.z[0]),
    internal_initial=[0.0],
)  # fmt: skip


ROOM = eoi.Plant(
    lambda t, x, u, p: u - p.loss * x.y[0] + p.a * x.z[0], {"loss": 0.007, "a": 0.034, "b": 0.019},
    inputs=("heating",), outputs=("temperature",),
    internal=lambda t, x, u, p: -p.b * x.z[0] - (u - p.loss * x.y[0] + p.a * x.z[0]),
    internal_initial=[0.0],
)  # fmt: skip


def heated(samples, seed):
    """Temperatures of plate and housing at held voltages, by the matrix exponential, with noise."""
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(3.0, 9.0, -(-samples // 40)), 40)[:samples]
    rates = [[-1.0 / TAU - EXCHANGE, EXCHANGE], [RATE, -RATE]]
    drive = [[AMBIENT / TAU, GAIN], [0.0, 0.0]]
    step = expm(PERIOD * np.block([[np.array(rates), np.array(drive)], [np.zeros((2, 4))]]))
    x, y = np.array([60.0, 60.0]), np.zeros(samples)
    for i in range(samples):
        y[i] = x[0]
        x = step[:2, :2] @ x + step[:2, 2:] @ [1.0, voltage[i]]
    y += NOISE * rng.standard_normal(samples)
    return eoi.Record.from_period(PERIOD, voltage, y, hold="zero")


def warm_room(samples, seed, stray, memory):
    """Temperatures of a room with walls, exact; errors of `stray` rms that fade over `memory`."""
    rng = np.random.default_rng(seed)
    heating = np.repeat(rng.uniform(0.0, 1.0, -(-samples // 12)), 12)[:samples]
    rates = np.array([[-0.007 - 0.034, 0.034], [0.019, -0.019]])
    step = expm(np.block([[rates, np.array([[1.0], [0.0]])], [np.zeros((1, 3))]]))
    fading, error = np.exp(-1.0 / memory), np.zeros(samples)
    x, y = np.array([40.0, 40.0]), np.zeros(samples)
    for i in range(samples):
        error[i] = fading * error[i - 1] + np.sqrt(1.0 - fading**2) * stray * rng.normal()
        y[i] = x[0] + error[i]
        x = step[:2, :2] @ x + step[:2, 2] * heating[i]
    return eoi.Record.from_period(1.0, heating, y, hold="zero")


@pytest.mark.parametrize("seed", range(3))
def test_short_windows_of_the_true_model_miss_by_little_more_than_the_noise(seed):
    """Five noisy samples tell the temperature of the plate to NOISE/√5, of the housing nothing."""
    runs = judged_runs(PLATE, heated(400, seed), initial_samples=6, window=20 * PERIOD)
    assert runs.rmse[0] < 1.2 * NOISE


def test_a_window_whose_first_samples_tell_the_state_of_the_store_starts_there():
    """A store that something unknown heats in the middle of the record: no run along it knows."""
    part = heated(200, 0)
    inputs, outputs = (np.concatenate([values] * 2) for values in (part.inputs, part.outputs))
    jumped = eoi.Record.from_period(PERIOD, inputs, outputs, hold="zero")
    runs = judged_runs(PLATE, jumped, initial_samples=60, window=100 * PERIOD)
    assert runs.rmse[0] < 1.5 * NOISE


@pytest.mark.parametrize("seed", range(4))
def test_where_errors_are_slow_first_samples_do_not_tell_the_store(seed):
    """Six neighbouring samples whose errors are alike fit a store that is far off, and closely.

    Windows started there miss by twice as much as a run along the record.
    """
    record = warm_room(400, seed, stray=0.2, memory=2.0)
    runs = judged_runs(ROOM, record, initial_samples=6, window=20.0)
    assert runs.rmse[0] < 1.3 * judged_runs(ROOM, record, initial_samples=50).rmse[0]


def test_where_a_run_along_the_record_diverges_windows_start_as_the_model_says():
    unstable = eoi.Plant(
        lambda t, x, u, p: p.a * x.z[0] ** 3 + u, {"a": 1.0}, inputs=("u",), outputs=("y",),
        internal=lambda t, x, u, p: x.y[0] + x.z[0], internal_initial=[0.0],
    )  # fmt: skip
    swing = 0.1 * np.sin(0.02 * np.arange(2000))
    record = eoi.Record.from_period(0.01, np.ones(2000), swing, hold="zero")
    assert not np.isfinite(judged_runs(unstable, record).rmse[0])
    assert np.isfinite(judged_runs(unstable, record, window=0.6).rmse[0])


PAIR = eoi.Plant(
    lambda t, x, u, p: np.array([[-4.0, 1.0], [1.0, -9.0]]) @ x.y[0] + p.gain * u,
    {"gain": 1.0}, relative_degree=2, inputs=("force",), outputs=("first", "second"),
)  # fmt: skip


def swinging(sizes, seed):
    """Two coupled masses that start with displacements of these sizes, with noise on both."""
    time = 0.02 * np.arange(500)
    record = eoi.simulate(PAIR, time, np.sin(3.0 * time)[:, None], sizes, hold="linear")
    noise = 0.05 * np.random.default_rng(seed).standard_normal(record.outputs.shape)
    return record.with_outputs(record.outputs + noise, record.name)


@pytest.mark.parametrize("plant", [PLATE, PAIR])
def test_records_side_by_side_start_as_each_by_itself(plant, monkeypatch):
    """To the last bit: also where the outputs of one are far larger than those of another."""
    records = [heated(600, 0), heated(400, 1)]
    if plant is PAIR:
        records = [swinging([[5.0, 0.0], [0.0, 0.0]], 0), swinging([[0.0, 0.1], [0.0, 0.0]], 1)]
    window, calls, fit = 120 * records[0].sample_period, [], planned_runs.window_starts
    apart = [judged_runs(plant, record, 30, window).predictions[0] for record in records]
    monkeypatch.setattr(planned_runs, "window_starts", lambda *args: calls.append(1) or fit(*args))
    together = judged_runs(plant, records, 30, window).predictions
    for prediction, alone in zip(together, apart, strict=True):
        np.testing.assert_array_equal(prediction.outputs, alone.outputs)
    assert len(calls) == (2 if plant is PAIR else 1)  # of several outputs from two weightings


@pytest.mark.parametrize("seed", range(3))
def test_a_difference_from_an_output_goes_on_where_the_output_moves_fast(seed):
    """Doses of a drug: where a window begins behind one, blood and tissue are far apart.

    Fitted to the first samples without that difference, blood would start far from where it is.
    """
    rng = np.random.default_rng(seed)
    dose = np.zeros(400)
    for start in range(47, 400, 50):  # of which a sample or two lie before the next window
        dose[start : start + 4] = rng.uniform(100.0, 300.0)
    rates = np.array([[-0.35 - 0.8, 0.8], [0.3, -0.3]])
    step = expm(0.1 * np.block([[rates, np.array([[1.0 / 12.0], [0.0]])], [np.zeros((1, 3))]]))
    x, y = np.zeros(2), np.zeros(400)
    for i in range(400):
        y[i] = x[0]
        x = step[:2, :2] @ x + step[:2, 2] * dose[i]
    noise = 0.1
    y += noise * rng.standard_normal(400)
    blood = eoi.plant_from_text(
        {"c": "dose/V - k*c"}, {"V": 12.0, "k": 0.35}, ["c"], ["dose"], name="blood"
    )
    tissue = place(blood, effects.SecondNode(), 0)
    model = augmented(blood, (tissue,), dict(zip(tissue.names, [0.8, 0.3], strict=True)))
    record = eoi.Record.from_period(0.1, dose, y, hold="zero")
    assert judged_runs(model, record, initial_samples=8, window=2.5).rmse[0] < 1.2 * noise


def test_a_window_that_starts_late_may_do_so_after_the_last_one():
    """Of three windows the second one begins at 60 for 49; the last, which reaches back, at 56."""
    record = heated(106, 3)
    outputs = record.outputs.copy()
    outputs[46:60] = np.nan
    with pytest.warns(eoi.RecordWarning):
        gap = eoi.Record.from_period(PERIOD, record.inputs, outputs, hold="zero")
    runs = judged_runs(PLATE, gap, initial_samples=15, window=49 * PERIOD)
    assert len(runs.notes) == 1
    assert runs.rmse[0] < 2.0 * NOISE


def drive_model(speed, outputs=("angle", "speed")):
    """A turning mass with friction, its angle, and its speed times a factor."""
    return eoi.plant_from_text(
        {"angle": "rate", "rate": "(torque - 0.4*rate)/J"}, {"J": 0.35}, outputs=list(outputs),
        inputs=["torque"], output={"speed": f"{speed}*rate"} if "speed" in outputs else None,
    )  # fmt: skip


def turning(seed, angle_noise, speed_noise):
    rng = np.random.default_rng(seed)
    torque = np.repeat(rng.uniform(-5.0, 5.0, 15), 80)[:, None]
    record = eoi.simulate(drive_model(9.5), 0.01 * np.arange(1200), torque, hold="zero")
    noise = rng.standard_normal(record.outputs.shape) * [angle_noise, speed_noise]
    return record.with_outputs(record.outputs + noise, record.name)


@pytest.mark.parametrize("seed", range(3))
def test_a_noisy_speed_does_not_spoil_the_starts_of_an_exact_angle(seed):
    record = turning(seed, 2e-4, 0.5)
    angle = eoi.Record(record.time, record.inputs, record.outputs[:, 0], hold="zero",
                       input_names=["torque"], output_names=["angle"])  # fmt: skip
    alone = judged_runs(drive_model(9.5, ["angle"]), angle, window=1.2)
    both = judged_runs(drive_model(9.5), record, window=1.2)
    assert both.rmse[0] < 1.05 * alone.rmse[0]


@pytest.mark.parametrize(("noise", "limit"), [((5e-4, 0.5), 1.2), ((0.005, 0.1), 4.0)])
def test_an_output_that_the_model_misses_does_not_rule_the_starts(noise, limit):
    """The factor of the speed is wrong by a tenth, that is by 2.6 in its unit.

    By their spread alone outputs would have angles of 148 and 15 times their noise, by their noise
    alone of 1.4 and 15.
    """
    runs = judged_runs(drive_model(10.5), turning(1, *noise), window=1.2)
    assert runs.rmse[0] < limit * noise[0]


def test_a_free_start_is_found_on_a_table():
    """Full steps from 0 end behind the table, where the voltage shows the charge no longer."""
    charges = jnp.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    volts = jnp.array([3.0, 3.32, 3.45, 3.55, 3.6, 3.64, 3.7, 3.79, 3.88, 3.97, 4.07, 4.18])

    def cell(start):
        return eoi.Plant(
            lambda t, x, u, p: jnp.interp(x.z[0], charges, volts) - p.R0 * u[0] - x.z[1] - x.z[2],
            {"R0": 0.03, "R1": 0.02, "R2": 0.015, "Q": 9360.0}, 0,
            internal=lambda t, x, u, p: jnp.stack(
                [-u[0] / p.Q, (p.R1 * u[0] - x.z[1]) / 30.0, (p.R2 * u[0] - x.z[2]) / 300.0]
            ),
            internal_initial=[start, 0.0, 0.0],
        )  # fmt: skip

    draw = np.random.default_rng(6)
    amperes = np.repeat(draw.choice([0.0, 0.0, 1.3, 2.6, -1.3, 3.9], 121), 45)[:5400]
    record = eoi.simulate(cell(0.85), np.arange(5400.0), amperes, hold="zero")
    noise = 4e-4 * draw.standard_normal((5400, 1))
    record = record.with_outputs(record.outputs + noise, record.name)
    assert eoi.validate(cell(None), record, window=540.0).rmse[0] < 4.4e-4
