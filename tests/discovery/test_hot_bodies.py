"""Radiation of a hot body whose model has surroundings of its own."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import eoi_jax as eoi
from eoi_jax import effects
from eoi_jax.refinement.refine import refine_once
from eoi_jax.refinement.remaining import remaining

PERIOD, COUNT = 5.0, 600
GAIN, LOSS, AMBIENT, COEFFICIENT = 8.0, 2e-3, 25.0, 3e-4
FURNACE = eoi.Plant(
    lambda t, x, u, p: p.gain * u - p.loss * (x.y[0] - p.ambient),
    {"gain": 5.0, "loss": 5e-3, "ambient": 20.0},
    relative_degree=1, inputs=("power",), outputs=("temperature",),
    units={"power": "kW", "temperature": "°C"},
)  # fmt: skip


def heated(seed):
    """A furnace that also radiates, by SciPy."""
    random = np.random.default_rng(seed)
    power, time = np.repeat(random.uniform(0.0, 1.0, COUNT // 60), 60), PERIOD * np.arange(COUNT)

    def rate(t, x):
        radiated = ((x + 273.15) / 100.0) ** 4 - ((AMBIENT + 273.15) / 100.0) ** 4
        drive = GAIN * power[min(int(t / PERIOD), COUNT - 1)]
        return drive - LOSS * (x - AMBIENT) - COEFFICIENT * radiated

    run = solve_ivp(rate, (0.0, time[-1]), [AMBIENT], t_eval=time, max_step=PERIOD, rtol=1e-8)
    noise = 0.5 * random.standard_normal(COUNT)
    return eoi.Record(time, power, run.y[0] + noise, hold="zero", input_names=("power",),
                      output_names=("temperature",), units=FURNACE.units)  # fmt: skip


def test_of_surroundings_that_do_the_same_the_first_ones_are_nominated():
    """Beside surroundings of the model those of the radiation are a constant and no more."""
    refined = refine_once(FURNACE, (heated(1),), None)
    (radiation,) = remaining(refined, [effects.Radiation(celsius=True)]).ranking
    assert radiation.values["radiation_ambient"] == np.min(heated(1).outputs)


@pytest.mark.slow
def test_radiation_is_found_beside_surroundings_of_the_model():
    found = eoi.discover(FURNACE, heated(1), validation=heated(2))
    assert found.effects == ("radiation",)
    assert found.status.code == "complete"
    values = found.plant.parameters
    assert values["radiation_coefficient"] == pytest.approx(COEFFICIENT, rel=0.01)
    assert values["loss"] == pytest.approx(LOSS, rel=0.02)
    assert values["gain"] == pytest.approx(GAIN, rel=0.01)
    assert "radiation_ambient" in found.plant.fixed
    assert any(note.startswith("radiation_ambient is fixed at") for note in found.notes)
    assert values["ambient"] == pytest.approx(AMBIENT, abs=10.0)
    # Of both levels together the loss at the true surroundings is told.
    ambient = values["radiation_ambient"]
    level = LOSS * AMBIENT + COEFFICIENT * ((AMBIENT + 273.15) / 100.0) ** 4
    told = values["loss"] * values["ambient"]
    told += values["radiation_coefficient"] * ((ambient + 273.15) / 100.0) ** 4
    assert told == pytest.approx(level, abs=1e-3 * GAIN)
