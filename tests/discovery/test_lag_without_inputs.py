"""A sensor's lag of what nothing drives: any mode of the plant's own looks like it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.discovery.additions import sensor_notes
from eoi_jax.discovery.result import Added
from eoi_jax.models.placements import placements

PERIOD = 0.01
SPRING = eoi.Plant(
    lambda t, x, u, p: -p.stiffness * x.y[0] - p.damping * x.y[1],
    {"stiffness": 310.0, "damping": 7.0},
    relative_degree=2, inputs=(), outputs=("position",),
)  # fmt: skip


def swing(position: float, velocity: float, seed: int) -> eoi.Record:
    """A mass between springs of which one relaxes, behind a perfect sensor."""

    def rates(t, x):
        position, velocity, stretched = x
        return [velocity, -300.0 * position - 2.0 * velocity - 200.0 * stretched,
                velocity - 8.0 * stretched]  # fmt: skip

    time = PERIOD * np.arange(140)
    run = solve_ivp(
        rates, (0.0, time[-1]), [position, velocity, 0.0], t_eval=time, rtol=1e-9, atol=1e-9
    )
    noise = 0.2 * np.random.default_rng(seed).standard_normal(len(time))
    return eoi.Record.from_period(PERIOD, np.zeros((len(time), 0)), (run.y[0] + noise)[:, None])


@pytest.mark.slow
def test_a_spring_that_relaxes_is_no_lag_of_the_sensor():
    """A sensor that lags would fit to the noise: its lag is but a third pole."""
    found = eoi.discover(SPRING, swing(150.0, 0.0, 1), validation=swing(-130.0, 1500.0, 2))
    assert "sensor_lag" not in [added.effect.name for added in found.added]


def test_what_swings_needs_an_input_or_another_output_that_a_lag_is_behind():
    pair = eoi.Plant(
        lambda t, x, u, p: -p.k * (x.y[0] - x.y[0, ::-1]), {"k": 1.0},
        relative_degree=(2, 2), inputs=(), outputs=("first", "second"),
    )  # fmt: skip
    lag = [effects.SensorLag()]
    assert placements(SPRING, lag) == []
    assert [placed.channel for placed in placements(pair, lag)] == [0, 1]


def test_a_lag_of_a_store_that_empties_is_named_with_its_rival():
    tank = eoi.Plant(lambda t, x, u, p: -p.k * x.y[0], {"k": 1.0}, 1, (), ("charge",))
    assert len(placements(tank, [effects.SensorLag()])) == 1
    lag = effects.SensorLag()
    added = [Added(lag, "charge", {"sensor_lag": 0.3}, {"sensor_lag": 0.01}, lag.sentence)]
    (note,) = sensor_notes(tank, added)
    assert note.startswith("a second store does the same as the lag of the sensor of charge")
    assert sensor_notes(tank, []) == []


def test_a_lag_that_is_asked_for_says_what_it_needs():
    with pytest.raises(ValueError, match=r"sensor_lag must act on .* input or another output"):
        eoi.discover(SPRING, swing(150.0, 0.0, 1), effects=["sensor_lag"])
