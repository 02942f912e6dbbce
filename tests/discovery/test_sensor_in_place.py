"""A lag of the sensor is told from lags and delays of the inputs, and the other way round."""

import numpy as np
import pytest

import eoi_jax as eoi

TANK = eoi.plant_from_text(
    {"T": "a*valve*(supply - T) - b*(T - cellar)"}, {"a": 3e-2, "b": 3e-4}, ["T"],
    ["valve", "supply", "cellar"],
)  # fmt: skip


def heated(seed: int, sensor: float = 0.0, actuator: float = 0.0) -> eoi.Record:
    """A tank between 50 and 55 °C behind a thermostat, minute by minute, in steps of 2.5 s."""
    draw, count, steps = np.random.default_rng(seed), 5000, 24
    wave, day = draw.uniform(0.0, 6.0, 2)
    x, shown, supply, opened, valve, rows = 52.0, 52.0, 65.0, 0.0, 0.0, []
    for minute in range(count):
        valve = 1.0 if shown < 50.0 else 0.0 if shown > 55.0 else valve
        cellar = 16.0 + 1.5 * np.sin(2.0 * np.pi * minute / 1440.0 + day)
        rows.append([valve, supply, cellar, shown])
        for step in range(steps):
            time = minute + step / steps
            target = 60.0 + 5.0 * np.sin(time / 24.0 + wave) + 3.0 * np.sin(time / 106.0)
            supply += (target - supply) / (5.0 * steps)
            opened = opened + (valve - opened) / (actuator * steps) if actuator else valve
            x += (0.0215 * opened * (supply - x) - 1.67e-4 * (x - cellar)) / steps
            shown = shown + (x - shown) / (sensor * steps) if sensor else x
    columns = np.array(rows)
    columns[:, 1:] += draw.standard_normal((count, 3)) * [0.1, 0.05, 0.04]
    return eoi.Record(np.arange(count) * 1.0, columns[:, :3], columns[:, 3], str(seed),
                      input_names=TANK.inputs, output_names="T")  # fmt: skip


@pytest.mark.slow
def test_a_lag_of_the_sensor_is_no_lag_of_two_inputs():
    found = eoi.discover(TANK, heated(1, sensor=4.0), validation=heated(2, sensor=4.0))
    assert found.effects == ("sensor_lag",)
    (lag,) = found.added
    (value,) = lag.parameters.values()
    assert value == pytest.approx(4.0, abs=0.1)  # of the simulator's steps: 0.02
    assert found.after is not None
    assert found.after.rmse[0] < 0.045


@pytest.mark.slow
def test_a_lag_of_one_input_stays_one():
    found = eoi.discover(TANK, heated(1, actuator=4.0), validation=heated(2, actuator=4.0))
    assert [(item.effect.name, item.output) for item in found.added] == [("actuator_lag", "valve")]
