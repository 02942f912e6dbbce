"""Two lags in series: which of them is the sensor's, where the records tell one alone."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.exchanged_lags import exchanged
from eoi_jax.discovery.free_run_trials import Search
from eoi_jax.discovery.judge import Judge
from eoi_jax.models.augmented import augmented, place
from eoi_jax.simulation.simulate import simulate

PERIOD = 2.0
HEATER = eoi.Plant(
    lambda t, x, u, p: p.gain * u - (x.y[0] - p.outside) / p.tau,
    {"gain": 0.4, "tau": 60.0, "outside": 20.0},
    fixed=["outside"], inputs=("power",), outputs=("temperature",),
)  # fmt: skip
NO_LOSS = {"gain": 0.5, "tau": 90.0, "outside": 20.0}


def heated(seed: int, samples: int, truth: tuple[float, float, float]) -> eoi.Record:
    """Gain [K/s], time constants of the store and of its thermometer [s]; power in steps."""
    gain, store, sensor = truth
    draw = np.random.default_rng(seed)
    steps = np.append(0, draw.integers(0, 3, samples // 30))  # at rest first: in steady state
    power = np.repeat(steps, 30)[:samples].astype(float)
    time = PERIOD * np.arange(samples)

    def rates(t, x):
        u = power[min(int(t / PERIOD + 1e-9), samples - 1)]
        return [gain * u - (x[0] - 20.0) / store, (x[0] - x[1]) / sensor]

    run = solve_ivp(
        rates, (0.0, time[-1]), [20.0, 20.0], t_eval=time, max_step=PERIOD, rtol=1e-8, atol=1e-8
    )
    noise = 0.02 * draw.standard_normal(samples)
    return eoi.Record(
        time, power, run.y[1] + noise, input_names=("power",), output_names=("temperature",)
    )


@pytest.mark.parametrize("kind", [effects.SensorLag, effects.ActuatorLag])
def test_the_same_outputs_follow_from_both_orders(kind):
    plant = HEATER.with_parameters(NO_LOSS)
    lag = place(plant, kind(), 0)
    record = heated(1, 200, (0.5, 400.0, 25.0))
    values = exchanged(plant, lag, 900.0, [record])
    assert values is not None
    assert values[lag.names[0]] == pytest.approx(90.0)
    assert values["tau"] == pytest.approx(900.0, rel=1e-4)
    assert values["gain"] == pytest.approx(0.5 * 90.0 / 900.0, rel=1e-4)
    runs = [
        simulate(augmented(HEATER.with_parameters(np.array(of)), (lag,), {lag.names[0]: time}),
                 record.time, record.inputs, [20.0]).outputs
        for of, time in (((0.5, 90.0, 20.0), 900.0),
                         ((values["gain"], values["tau"], 20.0), values[lag.names[0]]))
    ]  # fmt: skip
    assert np.ptp(runs[0]) > 1.0
    np.testing.assert_allclose(runs[0], runs[1], rtol=0.0, atol=1e-3 * np.ptp(runs[0]))


def test_what_does_not_commute_is_not_exchanged():
    record = heated(1, 200, (0.5, 400.0, 25.0))
    plant = HEATER.with_parameters(NO_LOSS)
    lag = place(plant, effects.SensorLag(), 0)
    assert exchanged(plant, lag, 45.0, [record]) is None  # the plant is the slow one already
    offset = place(plant, effects.ConstantOffset(), 0)
    assert exchanged(plant, offset, 900.0, [record]) is None
    overflowing = plant.with_parameters({"gain": np.inf})
    assert exchanged(overflowing, lag, 900.0, [record]) is None
    held = plant.declared_anew(fixed=["tau"])
    assert exchanged(held, lag, 900.0, [record]) is None
    bent = eoi.Plant(
        lambda t, x, u, p: p.gain * u - p.loss * x.y[0] ** 2,
        {"gain": 0.5, "loss": 1e-4}, inputs=("power",), outputs=("temperature",),
    )  # fmt: skip
    assert exchanged(bent, place(bent, effects.SensorLag(), 0), 900.0, [record]) is None


def test_a_fit_that_takes_the_loss_for_the_lag_of_the_sensor_is_set_right():
    """From a slow lag it ends in one whose size is not told: a store that hardly loses heat."""
    truth = 0.05, 2e4, 60.0
    records = heated(1, 160, truth), heated(2, 160, truth)
    start = HEATER.declared_anew({"gain": 0.5}, bounds={"tau": (1.0, np.inf)})
    judge = Judge.of(records[1:], start)
    search = Search.begun([start], records[:1], judge) if judge else None
    assert search is not None
    lag = place(start, effects.SensorLag(), 0)
    slow = augmented(start, (lag,), {lag.names[0]: 5000.0})
    trial = search.fitted(slow, (lag,), search.base)
    assert trial is not None
    values, errors = trial.refinement.parameters, trial.refinement.standard_errors
    assert abs(values["sensor_lag"] - 60.0) < 3.0 * errors["sensor_lag"] < 30.0
    assert values["tau"] > 1000.0
